"""Solvers by name: those that are kept from step to step, and every other backend that qpsolvers finds."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from coopqp.errors import InvalidInputError, MissingExtraError, MissingSolverError, UnknownNameError, shown
from coopqp.solvers.base import QpSolver
from coopqp.solvers.generic import ROUTE, GenericSolver

#: Kept solvers: the name, which is also its module's here, and the module that it needs.
_KEPT = {"proxqp": "proxsuite", "osqp": "osqp", "ldp": "coopqp.core"}


def available_solvers() -> tuple[str, ...]:
    """Names of the installed solvers: first the persistent ones, then the other backends of qpsolvers."""
    kept = tuple(name for name, package in _KEPT.items() if find_spec(package) is not None)
    return kept + tuple(name for name in _backends() if name not in _KEPT)


#: Backends of qpsolvers that the extra ``solvers`` of coopqp installs.
_OF_OUR_EXTRA = ("quadprog",)


def default_solver(*, strictly_convex: bool = True) -> str:
    """The solver that ``"auto"`` stands for: the core's own, or DAQP.

    Args:
        strictly_convex: H is positive definite; the core's own solver needs that.
    """
    return "ldp" if strictly_convex else "daqp"


def make_solver(name: str | QpSolver, settings: Any = None) -> QpSolver:
    """A new solver, or the one given.

    Args:
        name: one of :func:`available_solvers`, ``qpsolvers:<backend>`` for a backend built anew at every solve, or
            ``"auto"`` for :func:`default_solver`. A solver is returned as it is.
        settings: ``LdpSettings``, ``ProxqpSettings``, ``OsqpSettings``, ``DaqpSettings``, or ``GenericSettings`` for
            the others; None for the defaults.

    Raises:
        UnknownNameError: no such solver.
        MissingExtraError: a known solver that is not installed.
        InvalidInputError: settings of another solver, settings beside a solver, or a solver of the wrong type.
    """
    if isinstance(name, QpSolver):
        if settings is not None:
            raise InvalidInputError(
                f"settings beside a {type(name).__name__}", "make_solver", "Give them to the solver when you build it."
            )
        return name
    if not isinstance(name, str):
        raise InvalidInputError(
            f"{shown(name)} is a {type(name).__name__}", "make_solver", "Give a solver's name or a QpSolver."
        )
    if name == "auto":
        name = default_solver()
    if name in _KEPT:
        return _make_kept(name, settings)
    backend = name.removeprefix(ROUTE)
    if backend not in _backends():
        if backend in _OF_OUR_EXTRA:
            raise MissingExtraError("solvers", backend)
        extra = backend.partition("_")[0]
        from importlib.metadata import metadata  # late: it imports much

        if extra in (metadata("qpsolvers").get_all("Provides-Extra") or ()):
            raise MissingSolverError(name, f"pip install 'qpsolvers[{extra}]'")
        raise UnknownNameError("QP solver", name, available_solvers())
    return GenericSolver(name, settings)


def _make_kept(name: str, settings: Any) -> QpSolver:
    if find_spec(_KEPT[name]) is None:
        raise MissingExtraError("solvers", _KEPT[name])
    module = import_module(f"coopqp.solvers.{name}")
    return getattr(module, f"{name.capitalize()}Solver")(settings)


def _backends() -> tuple[str, ...]:
    """Installed backends of qpsolvers."""
    import qpsolvers

    return tuple(sorted(qpsolvers.available_solvers))
