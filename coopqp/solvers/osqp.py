"""OSQP, kept: an operator-splitting method for sparse problems, with a final polishing step of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.checks import as_options
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings
from coopqp.solvers.problem import INFINITE, QpProblem, SolverStatus, Stacked

#: Cost of the unknown that is always at its bound: too small to take iterations.
_OWN = 1e-6


@dataclass(frozen=True, kw_only=True)
class OsqpSettings(SolverSettings):
    """Settings of OSQP, by its own names; all others keep OSQP's defaults, but it polishes.

    Attributes:
        eps_abs, eps_rel: largest absolute and relative residuals before polishing.
        eps_prim_inf, eps_dual_inf: accuracy of the certificates that there is no answer.
        max_iter: largest number of iterations of one attempt.
        check_termination: number of iterations between two tests of the residuals.
        adaptive_rho_interval: number of iterations between two updates of the penalty; fixed, for runs that repeat bit
            for bit.
    """

    eps_abs: float = 1e-9
    eps_rel: float = 1e-9
    eps_prim_inf: float = 1e-9
    eps_dual_inf: float = 1e-9
    max_iter: int = 20000
    check_termination: int = 25
    adaptive_rho_interval: int = 50


class OsqpSolver(QpSolver):
    """``osqp.OSQP``, updated between solves and warm started. Repeatable bit for bit.

    It keeps the pattern of nonzero entries, and is set up again where a problem has others. One more unknown t, at the
    cost of ½ t² − t times 1e-6 and with t ≤ 0, is always at its bound: without an active constraint OSQP prints that it
    need not polish.
    """

    name = "osqp"

    def __init__(self, settings: OsqpSettings | None = None) -> None:
        import osqp

        self.settings: OsqpSettings = as_options(OsqpSettings, settings, f"solver '{self.name}': settings")
        self._osqp, self._raises = osqp, (*QpSolver._raises, osqp.OSQPException)
        self._forget()

    def _forget(self) -> None:
        self._kept: Any = None

    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        n, m = problem.g.size, rows.low.size
        P, A = _OWN * np.eye(n + 1), np.zeros((m + 1, n + 1))
        P[:n, :n], A[:m, :n], A[m, n] = np.triu(problem.H), rows.G, 1.0
        q = np.append(problem.g, -_OWN)
        low, high = np.append(rows.low, -INFINITE), np.append(rows.high, 0.0)
        low[low <= -INFINITE], high[high >= INFINITE] = -np.inf, np.inf
        if self._kept is None or P[~self._in_P].any() or A[~self._in_A].any():
            self._set_up(P, q, A, low, high)
        else:
            self._kept.update(q=q, l=low, u=high)
            self._kept.update(Px=P.T[self._in_P.T], Ax=A.T[self._in_A.T])
        found = self._kept.solve(raise_error=False)
        status, names = found.info.status_val, self._osqp.SolverStatus
        kind = {
            names.OSQP_SOLVED: SolverStatus.SOLVED,
            names.OSQP_PRIMAL_INFEASIBLE: SolverStatus.INFEASIBLE,
            names.OSQP_MAX_ITER_REACHED: SolverStatus.MAX_ITERATIONS,
            names.OSQP_SOLVED_INACCURATE: SolverStatus.MAX_ITERATIONS,
            names.OSQP_PRIMAL_INFEASIBLE_INACCURATE: SolverStatus.MAX_ITERATIONS,
        }.get(status, SolverStatus.FAILED)
        return Outcome(kind, found.x[:n].copy(), found.y[:m].copy(), int(found.info.iter), f"OSQP: {found.info.status}")

    def _set_up(self, P: Any, q: Any, A: Any, low: Any, high: Any) -> None:
        from scipy import sparse

        self._in_P, self._in_A = P != 0.0, A != 0.0
        P, A = sparse.csc_matrix(P), sparse.csc_matrix(A)
        self._kept = self._osqp.OSQP()
        self._kept.setup(P, q, A, low, high, verbose=False, polishing=True, **self.settings.own)
