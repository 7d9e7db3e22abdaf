"""QP solvers behind one interface: kept between solves, guarded before and after each.

``proxqp``, ``osqp`` and ``daqp`` are kept: memory, factorisation and warm start survive from one solve to the next.
Any other backend that qpsolvers finds installed works by its name, built anew at every solve; ``qpsolvers:proxqp``
forces that route for a backend that could be kept.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from coopqp.control.solvers.base import QpProblem, QpSolution, QpSolver, SolverSettings, SolverStatus
from coopqp.errors import MissingExtraError, UnknownNameError

__all__ = [
    "QpProblem",
    "QpSolution",
    "QpSolver",
    "SolverSettings",
    "SolverStatus",
    "available_solvers",
    "make_solver",
]

#: Kept backends: the name, and the package it needs.
_KEPT = {"proxqp": "proxsuite", "osqp": "osqp", "daqp": "daqp"}
_GENERIC = "qpsolvers:"


def available_solvers() -> tuple[str, ...]:
    """Names of the installed solvers: the kept ones first, then the other backends of qpsolvers."""
    kept = tuple(name for name, package in _KEPT.items() if find_spec(package) is not None)
    return kept + tuple(name for name in _backends() if name not in _KEPT)


def make_solver(name: str, settings: Any = None) -> QpSolver:
    """A new solver.

    Args:
        name: one of :func:`available_solvers`, or ``qpsolvers:<backend>`` for a backend built anew at every solve.
        settings: ``ProxqpSettings``, ``OsqpSettings``, ``DaqpSettings``, or ``GenericSettings`` for the others, from
            the backend's module; None for the defaults.

    Raises:
        UnknownNameError: no such solver.
        MissingExtraError: a kept solver whose package is not installed.
        InvalidInputError: settings of another backend.
    """
    if name in _KEPT:
        if find_spec(_KEPT[name]) is None:
            raise MissingExtraError("solvers", _KEPT[name])
        if name == "proxqp":
            from coopqp.control.solvers.proxqp import ProxqpSolver

            return ProxqpSolver(settings)
        if name == "osqp":
            from coopqp.control.solvers.osqp import OsqpSolver

            return OsqpSolver(settings)
        from coopqp.control.solvers.daqp import DaqpSolver

        return DaqpSolver(settings)
    backend = name.removeprefix(_GENERIC)
    if backend not in _backends():
        raise UnknownNameError("QP solver", name, available_solvers())
    from coopqp.control.solvers.generic import GenericSolver

    return GenericSolver(backend, settings)


def _backends() -> tuple[str, ...]:
    """Backends that qpsolvers finds installed."""
    import qpsolvers

    return tuple(sorted(qpsolvers.available_solvers))
