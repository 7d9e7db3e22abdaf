"""OSQP, kept: an operator-splitting method for sparse problems, finished by a polishing step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.solvers.base import (
    Outcome,
    QpProblem,
    QpSolver,
    SolverSettings,
    SolverStatus,
    Workspace,
    require_count,
    require_positive,
    settings_of,
)
from coopqp.solvers.polish import finish


@dataclass(frozen=True, kw_only=True)
class OsqpSettings(SolverSettings):
    """Settings of OSQP; those not named here keep OSQP's defaults.

    Attributes:
        eps_abs, eps_rel: bounds on the residuals before polishing.
        eps_infeasible: accuracy of a certificate of infeasibility.
        max_iter: cap on the iterations of one attempt.
        check_termination: iterations between two tests of the residuals.
        adaptive_rho_interval: iterations between two updates of the penalty; fixed, so that runs repeat bit for bit.
        accuracy: an answer farther than this from optimal (:func:`coopqp.solvers.polish.kkt_residual`) says so in its
            message.
        polish: solve the equations of the active set, so that answers are exact to rounding. OSQP alone takes
            thousands of iterations to get near that.
    """

    eps_abs: float = 1e-7
    eps_rel: float = 1e-7
    eps_infeasible: float = 1e-9
    max_iter: int = 4000
    check_termination: int = 25
    adaptive_rho_interval: int = 50
    accuracy: float = 1e-8
    polish: bool = True

    def __post_init__(self) -> None:
        SolverSettings.__post_init__(self)
        require_positive(self, "eps_abs", "eps_rel", "eps_infeasible", "accuracy")
        require_count(self, "max_iter", "check_termination", "adaptive_rho_interval")


class OsqpSolver(QpSolver):
    """``osqp.OSQP``, updated between solves and started from its previous result. Bit for bit repeatable.

    Matrices are passed with every entry stored, so that the pattern never changes.
    """

    name = "osqp"
    _infinity = 1e30

    def __init__(self, settings: OsqpSettings | None = None) -> None:
        import osqp

        self.settings: OsqpSettings = settings_of(settings, OsqpSettings, self.name)
        self._module = osqp
        self._raises = (*QpSolver._raises, osqp.OSQPException)
        self._forget()

    def _forget(self) -> None:
        self._osqp: Any = None

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        if self._osqp is None:
            self._start(problem, work)
        else:
            self._load(problem)
            self._osqp.update(q=problem.g, l=work.lower, u=work.upper)
            self._osqp.update(Px=self._P, Ax=self._A)
        outcome = self._read(self._osqp.solve(raise_error=False))
        finish(problem, work, outcome, self.settings.accuracy, polished=self.settings.polish)
        return outcome

    def _start(self, problem: QpProblem, work: Workspace) -> None:
        from scipy import sparse

        n, m, p = work.sizes
        # Upper triangle of H, column by column.
        self._upper: NDArray[np.intp] = np.concatenate([np.arange(j + 1) * n + j for j in range(n)])
        self._P = np.empty(self._upper.size)
        self._A = np.empty((n, 1 + p + m))
        self._load(problem)
        rows = np.concatenate([np.append(j, np.arange(n, n + p + m)) for j in range(n)])
        A = sparse.csc_matrix((self._A.ravel(), rows, np.arange(n + 1) * (1 + p + m)), shape=(n + p + m, n))
        columns = np.concatenate([np.arange(j + 1) for j in range(n)])
        P = sparse.csc_matrix((self._P, columns, np.cumsum([0, *range(1, n + 1)])), shape=(n, n))
        own = self.settings
        self._osqp = self._module.OSQP()
        self._osqp.setup(
            P,
            problem.g.copy(),
            A,
            work.lower.copy(),
            work.upper.copy(),
            verbose=False,
            eps_abs=own.eps_abs,
            eps_rel=own.eps_rel,
            eps_prim_inf=own.eps_infeasible,
            eps_dual_inf=own.eps_infeasible,
            max_iter=own.max_iter,
            check_termination=own.check_termination,
            adaptive_rho_interval=own.adaptive_rho_interval,
            # OSQP's own polishing prints to the terminal, verbose or not, whenever no constraint is active.
            polishing=False,
        )

    def _load(self, problem: QpProblem) -> None:
        """Copy H and the stacked rows [I; C; A] into OSQP's order: by columns, every entry."""
        p = problem.l.size
        np.take(problem.H.reshape(-1), self._upper, out=self._P)
        self._A[:, 0] = 1.0
        self._A[:, 1 : 1 + p] = problem.C.T
        self._A[:, 1 + p :] = problem.A.T

    def _read(self, result: Any) -> Outcome:
        status, iterations = result.info.status_val, int(result.info.iter)
        statuses = self._module.SolverStatus
        message = f"OSQP: {result.info.status}"
        if status == statuses.OSQP_SOLVED:
            return Outcome(SolverStatus.SOLVED, np.array(result.x), np.array(result.y), iterations)
        short = (
            statuses.OSQP_MAX_ITER_REACHED,
            statuses.OSQP_TIME_LIMIT_REACHED,
            statuses.OSQP_SOLVED_INACCURATE,
            statuses.OSQP_PRIMAL_INFEASIBLE_INACCURATE,
        )
        if status in short:
            x, y = np.array(result.x), np.array(result.y)
            return Outcome(SolverStatus.MAX_ITERATIONS, x, y, iterations, message)
        kind = SolverStatus.INFEASIBLE if status == statuses.OSQP_PRIMAL_INFEASIBLE else SolverStatus.FAILED
        return Outcome(kind, iterations=iterations, message=message)
