"""OSQP, persistent: an operator-splitting method for sparse problems, with a final polishing step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.checks import as_options
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings, Workspace
from coopqp.solvers.polish import finish
from coopqp.solvers.problem import QpProblem, SolverStatus


@dataclass(frozen=True, kw_only=True)
class OsqpSettings(SolverSettings):
    """Settings of OSQP; all others keep OSQP's defaults.

    Attributes:
        eps_abs, eps_rel: largest absolute and relative residuals before polishing.
        eps_infeasible: accuracy of an infeasibility certificate.
        max_iter: largest number of iterations of one attempt.
        check_termination: number of iterations between two tests of the residuals.
        adaptive_rho_interval: number of iterations between two updates of the penalty; fixed, for runs that repeat bit
            for bit.
        accuracy: largest optimality error (:func:`~coopqp.solvers.polish.measure`) without a message.
        polish: solve the equations of the active set for solutions that are exact up to rounding. OSQP alone needs
            thousands of iterations for a similar accuracy.
    """

    eps_abs: float = 1e-7
    eps_rel: float = 1e-7
    eps_infeasible: float = 1e-9
    max_iter: int = 4000
    check_termination: int = 25
    adaptive_rho_interval: int = 50
    accuracy: float = 1e-8
    polish: bool = True


class OsqpSolver(QpSolver):
    """``osqp.OSQP``, updated between solves and warm started. Repeatable bit for bit.

    The solver keeps the pattern of nonzero entries. For a problem with other nonzero entries it extends the pattern and
    sets OSQP up again.
    """

    name = "osqp"
    _infinity = 1e30

    def __init__(self, settings: OsqpSettings | None = None) -> None:
        import osqp

        self.settings: OsqpSettings = as_options(OsqpSettings, settings, f"solver '{self.name}': settings")
        self._module = osqp
        self._raises = (*QpSolver._raises, osqp.OSQPException)
        self._forget()

    def _forget(self) -> None:
        self._osqp: Any = None
        self._entries: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        if self._osqp is not None and self._load(problem):
            self._osqp.update(q=problem.g, l=work.lower, u=work.upper)
            self._osqp.update(Px=self._P, Ax=self._A)
        else:
            self._start(problem, work)
        outcome = self._read(self._osqp.solve(raise_error=False))
        finish(problem, work, outcome, self.settings.accuracy, polished=self.settings.polish)
        return outcome

    def _start(self, problem: QpProblem, work: Workspace) -> None:
        """Set up OSQP for the nonzero entries of this problem and of earlier ones."""
        from scipy import sparse

        n, m, p = work.sizes
        self._stacked = np.empty((n, 1 + p + m))
        self._stacked[:, 0] = 1.0
        self._stack(problem)
        in_P, in_A = np.triu(problem.H != 0.0).T, self._stacked != 0.0
        if self._entries is not None:
            in_P, in_A = in_P | self._entries[0], in_A | self._entries[1]
        self._entries = in_P, in_A
        # Column by column: a row of each mask is a column of its matrix.
        self._upper, self._places = np.flatnonzero(in_P), np.flatnonzero(in_A)
        self._P, self._A = np.empty(self._upper.size), np.empty(self._places.size)
        if not self._load(problem):
            raise RuntimeError("an entry is missing from its own pattern")
        rows = np.column_stack([np.arange(n), np.broadcast_to(np.arange(n, n + p + m), (n, p + m))])
        ends = [np.concatenate([[0], np.cumsum(mask.sum(axis=1))]) for mask in (in_P, in_A)]
        P = sparse.csc_matrix((self._P, np.nonzero(in_P)[1], ends[0]), shape=(n, n))
        A = sparse.csc_matrix((self._A, rows[in_A], ends[1]), shape=(n + p + m, n))
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
            # OSQP's own polishing prints to the terminal if no constraint is active, even with verbose=False.
            polishing=False,
        )

    def _stack(self, problem: QpProblem) -> None:
        """Stack the rows [I; C; A] by columns, without the zeros of I."""
        p = problem.l.size
        if p:
            self._stacked[:, 1 : 1 + p] = problem.C.T
        self._stacked[:, 1 + p :] = problem.A.T

    def _load(self, problem: QpProblem) -> bool:
        """Copy the entries of H and the rows into OSQP's order. False if an entry outside the pattern is not zero."""
        self._stack(problem)
        # H is symmetric.
        np.take(problem.H.reshape(-1), self._upper, out=self._P)
        np.take(self._stacked.reshape(-1), self._places, out=self._A)
        stored = 2 * np.count_nonzero(self._P) - np.count_nonzero(problem.H.diagonal())
        return bool(
            stored == np.count_nonzero(problem.H) and np.count_nonzero(self._A) == np.count_nonzero(self._stacked)
        )

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
