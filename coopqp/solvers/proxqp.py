"""ProxQP, kept: a proximal augmented Lagrangian method for dense problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.checks import as_options
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings
from coopqp.solvers.problem import QpProblem, SolverStatus, Stacked

#: How many times larger residuals the attempts may leave: warm, from scratch twice, and with a fixed penalty schedule.
_MORE = (1.0, 1.0, 1e2, 1e5)


@dataclass(frozen=True, kw_only=True)
class ProxqpSettings(SolverSettings):
    """Settings of ProxQP, by its own names; all others keep ProxQP's defaults.

    Attributes:
        eps_abs: largest primal and dual residual, and largest duality gap.
        eps_primal_inf: accuracy of ProxQP's certificate that there is no answer. With its default, 1e-4, problems with
            nearly parallel rows that have one are called infeasible.
        max_iter, max_iter_in: largest numbers of outer iterations and of inner iterations per outer one. ProxQP holds
            the interpreter lock during its iterations, so nothing else could stop it.
    """

    eps_abs: float = 1e-14
    eps_primal_inf: float = 1e-15
    max_iter: int = 60
    max_iter_in: int = 10


class ProxqpSolver(QpSolver):
    """``proxsuite.proxqp.dense.QP``, updated between solves and warm started.

    The solver makes up to four attempts: warm, from scratch, from scratch with a larger residual, and with a fixed
    penalty schedule and a larger one yet. The fixed schedule solves most problems that the adaptive one cannot. Results
    repeat up to 1e-13, not bit for bit.
    """

    name = "proxqp"

    def __init__(self, settings: ProxqpSettings | None = None) -> None:
        from proxsuite import proxqp

        self.settings: ProxqpSettings = as_options(ProxqpSettings, settings, f"solver '{self.name}': settings")
        self._proxqp = proxqp
        self._forget()

    def _forget(self) -> None:
        self._qp: Any = None

    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        n, _, p = problem.sizes
        (lb, l, _), (ub, u, _) = (np.split(end, [n, n + p]) for end in (rows.low, rows.high))
        data = (problem.H, problem.g, problem.A, problem.b, problem.C, l, u, lb, ub)
        names, iterations = self._proxqp.QPSolverOutput, 0
        for attempt in range(self._qp is None, len(_MORE)):
            if attempt == 0:
                self._qp.update(*data, update_preconditioner=False)
            else:
                self._set_up(problem, more=_MORE[attempt])
                self._qp.init(*data)
            self._qp.solve()
            found, status = self._qp.results, self._qp.results.info.status
            iterations += int(found.info.iter)
            if status == names.PROXQP_SOLVED:
                break
        kind = {
            names.PROXQP_SOLVED: SolverStatus.SOLVED,
            names.PROXQP_MAX_ITER_REACHED: SolverStatus.MAX_ITERATIONS,
            names.PROXQP_PRIMAL_INFEASIBLE: SolverStatus.INFEASIBLE,
        }.get(status, SolverStatus.FAILED)
        y = np.concatenate([found.z[p:], found.z[:p], found.y])  # its z is [rows; box]
        return Outcome(kind, found.x.copy(), y, iterations, f"ProxQP: {status.name}")

    def _set_up(self, problem: QpProblem, *, more: float) -> None:
        dense = self._proxqp.dense
        # With more rows than unknowns ProxQP would choose the other factorisation: three times as many iterations.
        self._qp = dense.QP(*problem.sizes, True, dense_backend=dense.DenseBackend.PrimalDualLDLT)
        theirs, own = self._qp.settings, self.settings
        theirs.initial_guess = self._proxqp.WARM_START_WITH_PREVIOUS_RESULT
        theirs.eps_abs = theirs.eps_duality_gap_abs = own.eps_abs * more
        theirs.eps_rel = theirs.eps_duality_gap_rel = theirs.eps_abs
        theirs.eps_primal_inf = theirs.eps_dual_inf = own.eps_primal_inf
        theirs.max_iter, theirs.max_iter_in = own.max_iter, own.max_iter_in
        # Without the duality gap a kept ProxQP repeats its last answer when bounds only relax.
        theirs.check_duality_gap, theirs.bcl_update = True, more < _MORE[-1]
