"""ProxQP, kept: a proximal augmented Lagrangian method for dense problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.control.solvers.base import (
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
from coopqp.control.solvers.polish import finish

_ATTEMPTS = ("warm", "cold", "fixed penalties")


@dataclass(frozen=True, kw_only=True)
class ProxqpSettings(SolverSettings):
    """Settings of ProxQP; those not named here keep ProxQP's defaults.

    Attributes:
        eps_abs: bound on the primal and the dual residual, and on the duality gap if that is checked.
        eps_infeasible: accuracy of ProxQP's certificate of infeasibility. Its own 1e-4, and even 1e-9, call feasible
            problems with nearly parallel rows infeasible; most that are, the multipliers prove at the cap.
        max_iter, max_iter_in: caps on the outer iterations and on the inner ones of each outer one. ProxQP holds
            the interpreter lock while it iterates, so that nothing else could stop it.
        max_iter_warm, max_iter_in_warm: the same after a warm start, where long runs do not end well.
        check_duality_gap: without it a kept ProxQP returns the last answer again when bounds only relax.
        accuracy: an answer farther than this from optimal (:func:`~coopqp.control.solvers.polish.kkt_residual`) is
            polished, then solved again from scratch. The duality gap alone lets an error of √eps_abs pass.
        polish: solve the equations of the active set, so that answers are exact to rounding.
        update_preconditioner: scale the problem anew at every solve; costs more than it gains unless rows change
            their magnitudes.
    """

    eps_abs: float = 1e-9
    eps_infeasible: float = 1e-15
    max_iter: int = 60
    max_iter_in: int = 10
    max_iter_warm: int = 30
    max_iter_in_warm: int = 10
    check_duality_gap: bool = True
    accuracy: float = 1e-8
    polish: bool = True
    update_preconditioner: bool = False

    def __post_init__(self) -> None:
        SolverSettings.__post_init__(self)
        require_positive(self, "eps_abs", "eps_infeasible", "accuracy")
        require_count(self, "max_iter", "max_iter_in", "max_iter_warm", "max_iter_in_warm")


class ProxqpSolver(QpSolver):
    """``proxsuite.proxqp.dense.QP``, updated between solves and started from its previous result.

    Up to three attempts are made: warm, from scratch, and from scratch with a fixed penalty schedule in place of the
    adaptive one, which solves most of what the adaptive one cannot. Not repeatable to the last bit (1e-13).
    """

    name = "proxqp"

    def __init__(self, settings: ProxqpSettings | None = None) -> None:
        from proxsuite import proxqp

        self.settings: ProxqpSettings = settings_of(settings, ProxqpSettings, self.name)
        self._module = proxqp
        self._forget()

    def _forget(self) -> None:
        self._qp: Any = None

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        iterations = infeasible = 0
        best, least = Outcome(SolverStatus.FAILED), np.inf
        for attempt in _ATTEMPTS[self._qp is None :]:
            self._load(problem, work, attempt)
            self._qp.solve()
            outcome = self._read(work)
            iterations += outcome.iterations
            residual = finish(problem, work, outcome, self.settings.accuracy, polished=self.settings.polish)
            solved = outcome.status is SolverStatus.SOLVED
            if residual < least if solved else best.status not in (SolverStatus.SOLVED, SolverStatus.INFEASIBLE):
                best, least = outcome, residual if solved else np.inf
            if outcome.status is SolverStatus.INFEASIBLE:
                # One proof of ours settles it; ProxQP's word is taken when given twice.
                infeasible += 1 if outcome.y is None else 2
            if residual <= self.settings.accuracy or infeasible >= 2:
                break
        best.iterations = iterations
        return best

    def _load(self, problem: QpProblem, work: Workspace, attempt: str) -> None:
        n, m, p = work.sizes
        bounds = work.lower[n : n + p], work.upper[n : n + p], work.lower[:n], work.upper[:n]
        data = (problem.H, problem.g, problem.A, problem.b, problem.C, *bounds)
        own = self.settings
        if attempt == "warm":
            self._qp.settings.max_iter = own.max_iter_warm
            self._qp.settings.max_iter_in = own.max_iter_in_warm
            self._qp.update(*data, update_preconditioner=own.update_preconditioner)
            return
        dense = self._module.dense
        # ProxQP would choose the other factorisation where rows outnumber unknowns, and takes three times as many
        # iterations with it.
        self._qp = dense.QP(n, m, p, True, dense_backend=dense.DenseBackend.PrimalDualLDLT)
        theirs = self._qp.settings
        theirs.initial_guess = self._module.WARM_START_WITH_PREVIOUS_RESULT
        theirs.eps_abs = theirs.eps_duality_gap_abs = own.eps_abs
        theirs.eps_rel = theirs.eps_duality_gap_rel = 0.0
        theirs.eps_primal_inf = theirs.eps_dual_inf = own.eps_infeasible
        theirs.max_iter, theirs.max_iter_in = own.max_iter, own.max_iter_in
        theirs.check_duality_gap = own.check_duality_gap
        theirs.bcl_update = attempt != "fixed penalties"
        self._qp.init(*data)

    def _read(self, work: Workspace) -> Outcome:
        proxqp, results = self._module, self._qp.results
        status, iterations = results.info.status, int(results.info.iter)
        # ProxQP's own memory would change with the next solve; its z is [rows; box].
        n, _, p = work.sizes
        z = results.z
        x, y = np.array(results.x), np.concatenate([z[p : p + n], z[:p], results.y])
        if status == proxqp.PROXQP_SOLVED:
            return Outcome(SolverStatus.SOLVED, x, y, iterations)
        if status == proxqp.PROXQP_MAX_ITER_REACHED:
            return Outcome(SolverStatus.MAX_ITERATIONS, x, y, iterations, "ProxQP: iteration cap")
        if status == proxqp.PROXQP_PRIMAL_INFEASIBLE:
            return Outcome(SolverStatus.INFEASIBLE, iterations=iterations, message="ProxQP: infeasible")
        reason = "unbounded" if status == proxqp.PROXQP_DUAL_INFEASIBLE else str(status)
        return Outcome(SolverStatus.FAILED, iterations=iterations, message=f"ProxQP: {reason}")
