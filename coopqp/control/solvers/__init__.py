"""QP solvers behind one interface. Every problem is checked before, and every answer after the solve.

The solvers ``proxqp``, ``osqp`` and ``daqp`` persist: they keep memory, factorisation and warm start between solves.
All other installed backends of qpsolvers work by their names; they are rebuilt for every solve. ``qpsolvers:proxqp``
forces this route for a persistent backend.
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

#: Names of the persistent backends, and their packages.
_KEPT = {"proxqp": "proxsuite", "osqp": "osqp", "daqp": "daqp"}
_GENERIC = "qpsolvers:"


def available_solvers() -> tuple[str, ...]:
    """Names of the installed solvers: first the persistent ones, then the other backends of qpsolvers."""
    kept = tuple(name for name, package in _KEPT.items() if find_spec(package) is not None)
    return kept + tuple(name for name in _backends() if name not in _KEPT)


def make_solver(name: str, settings: Any = None) -> QpSolver:
    """Build a new solver.

    Args:
        name: one of :func:`available_solvers`, or ``qpsolvers:<backend>`` for a backend that is rebuilt every solve.
        settings: ``ProxqpSettings``, ``OsqpSettings``, ``DaqpSettings``, or ``GenericSettings`` for other backends,
            from the module of the backend; None for the defaults.

    Raises:
        UnknownNameError: no such solver.
        MissingExtraError: the package of a persistent solver is not installed.
        InvalidInputError: the settings belong to another backend.
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
    """Installed backends of qpsolvers."""
    import qpsolvers

    return tuple(sorted(qpsolvers.available_solvers))
