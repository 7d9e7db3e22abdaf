"""Any backend of qpsolvers, by its name. It is rebuilt for every solve; use it for comparisons."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from coopqp.checks import as_options
from coopqp.errors import InvalidInputError
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings, Workspace
from coopqp.solvers.polish import finish
from coopqp.solvers.problem import INFINITE, Array, QpProblem, SolverStatus

# Default options for backends with defaults that are too inaccurate for commands. Through qpsolvers, ProxQP's cap on
# inner iterations and its accuracy of an infeasibility certificate cannot be set.
_TIGHT: Mapping[str, Mapping[str, Any]] = {
    "daqp": {"primal_tol": 1e-10, "iter_limit": 1000},
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 4000, "adaptive_rho_interval": 50},
    "proxqp": {
        "eps_abs": 1e-9,
        "eps_rel": 0.0,
        "max_iter": 100,
        "check_duality_gap": True,
        "eps_duality_gap_abs": 1e-9,
    },
}


@dataclass(frozen=True, kw_only=True)
class GenericSettings(SolverSettings):
    """Settings of a backend of qpsolvers.

    Attributes:
        accuracy: largest optimality error (:func:`~coopqp.solvers.polish.measure`) without a message.
        polish: solve the equations of the active set if the solution is not exact up to rounding.
        options: keyword arguments for the backend; they replace the defaults of this module or of the backend.
    """

    accuracy: float = 1e-8
    polish: bool = True
    options: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        SolverSettings.__post_init__(self)
        if self.options is None:
            return
        if not isinstance(self.options, Mapping) or not all(isinstance(k, str) for k in self.options):
            raise InvalidInputError(f"options = {self.options!r}", "GenericSettings", "Give a mapping of keywords.")
        object.__setattr__(self, "options", MappingProxyType(dict(self.options)))


class GenericSolver(QpSolver):
    """``qpsolvers.solve_problem`` with one backend. Every solve builds a new solver of the backend.

    Rows and bounds become one-sided inequalities, without infinite ones. Rows with equal bounds become equalities.
    Backends without support for dense matrices get ``scipy.sparse.csc_matrix``.
    """

    def __init__(self, backend: str, settings: GenericSettings | None = None) -> None:
        import qpsolvers
        from qpsolvers.exceptions import QPError

        self.name = f"qpsolvers:{backend}"
        self.settings: GenericSettings = as_options(GenericSettings, settings, f"solver '{self.name}': settings")
        self._backend = backend
        self._module = qpsolvers
        # TypeError: an option unknown to the backend. AssertionError: osqp's checks of its input.
        self._raises = (*QpSolver._raises, QPError, TypeError, AssertionError)
        if backend == "osqp":
            from osqp import OSQPException

            self._raises = (*self._raises, OSQPException)
        options = self.settings.options
        self._options = dict(_TIGHT.get(backend, {}) if options is None else options)

    def _forget(self) -> None:
        pass

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        n, m, p = work.sizes
        lower, upper = work.lower[: n + p], work.upper[: n + p]
        rows = np.vstack([np.eye(n), problem.C])
        equal = lower == upper
        above, below = ~equal & (upper < INFINITE), ~equal & (lower > -INFINITE)
        G, h = np.vstack([rows[above], -rows[below]]), np.concatenate([upper[above], -lower[below]])
        A, b = np.vstack([problem.A, rows[equal]]), np.concatenate([problem.b, upper[equal]])
        stated = self._module.Problem(
            self._matrix(problem.H),
            problem.g.copy(),
            self._matrix(G) if h.size else None,
            h if h.size else None,
            self._matrix(A) if b.size else None,
            b if b.size else None,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # some backends report their status as a warning; the message replaces it
            solution = self._module.solve_problem(stated, self._backend, **self._options)
        info = solution.extras.get("info") if isinstance(solution.extras, dict) else None
        iterations = getattr(info, "iter", 0)
        iterations = int(iterations) if isinstance(iterations, (int, np.integer)) else 0
        if not solution.found or solution.x is None:
            reason = str(getattr(info, "status", "")) or "no solution found"
            return Outcome(self._status(reason), iterations=iterations, message=f"{self._backend}: {reason}")
        y: Array | None = None
        z, y_equal = solution.z, solution.y
        if (z is not None or not h.size) and (y_equal is not None or not b.size):
            y = np.zeros(n + p + m)
            k = int(above.sum())
            if z is not None and h.size:
                y[: n + p][above] += z[:k]
                y[: n + p][below] -= z[k:]
            if y_equal is not None and b.size:
                y[n + p :] = y_equal[:m]
                y[: n + p][equal] = y_equal[m:]
        outcome = Outcome(SolverStatus.SOLVED, np.array(solution.x, dtype=np.float64), y, iterations)
        finish(problem, work, outcome, self.settings.accuracy, polished=self.settings.polish)
        return outcome

    def _matrix(self, dense: Array) -> Any:
        """A copy of the matrix (backends may overwrite their input), sparse if the backend needs it."""
        if self._backend in self._module.dense_solvers:
            return np.array(dense, order="C")
        from scipy import sparse

        return sparse.csc_matrix(dense)

    def _status(self, reason: str) -> SolverStatus:
        text = reason.lower().replace("_", " ")
        # qpsolvers returns no status of quadprog. Infeasibility is quadprog's only failure.
        if self._backend == "quadprog":
            return SolverStatus.INFEASIBLE
        if "dual" not in text and "inaccurate" not in text and "infeasible" in text:
            return SolverStatus.INFEASIBLE
        if "max" in text or "limit" in text or "inaccurate" in text:
            return SolverStatus.MAX_ITERATIONS
        return SolverStatus.FAILED
