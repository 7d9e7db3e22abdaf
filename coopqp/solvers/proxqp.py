"""ProxQP, persistent: a proximal augmented Lagrangian method for dense problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.checks import as_options
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings, Workspace
from coopqp.solvers.polish import finish
from coopqp.solvers.problem import QpProblem, SolverStatus

_ATTEMPTS = ("warm", "cold", "fixed penalties")


@dataclass(frozen=True, kw_only=True)
class ProxqpSettings(SolverSettings):
    """Settings of ProxQP; all others keep ProxQP's defaults.

    Attributes:
        eps_abs: largest primal and dual residual, and largest duality gap if it is checked.
        eps_infeasible: accuracy of ProxQP's infeasibility certificate. With ProxQP's default 1e-4, and even with 1e-9,
            feasible problems with nearly parallel rows are called infeasible. For most infeasible problems the
            multipliers at the iteration cap prove it.
        max_iter, max_iter_in: largest numbers of outer iterations and of inner iterations per outer one. ProxQP holds
            the interpreter lock during its iterations, so nothing else could stop it.
        max_iter_warm, max_iter_in_warm: the same numbers after a warm start; long warm-started runs rarely succeed.
        check_duality_gap: also check the duality gap. Without this check a persistent ProxQP repeats its last solution
            when bounds only relax.
        accuracy: largest accepted optimality error (:func:`~coopqp.solvers.polish.measure`). A worse
            solution is polished, then solved again from scratch. The duality gap alone accepts an error of √eps_abs.
        polish: solve the equations of the active set for solutions that are exact up to rounding.
        update_preconditioner: scale the problem again at every solve. This costs more than it gains unless rows change
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


class ProxqpSolver(QpSolver):
    """``proxsuite.proxqp.dense.QP``, updated between solves and warm started.

    The solver makes up to three attempts: warm, from scratch, and from scratch with a fixed penalty schedule. The fixed
    schedule solves most problems that the adaptive one cannot. Results repeat up to 1e-13, not bit for bit.
    """

    name = "proxqp"

    def __init__(self, settings: ProxqpSettings | None = None) -> None:
        from proxsuite import proxqp

        self.settings: ProxqpSettings = as_options(ProxqpSettings, settings, f"solver '{self.name}': settings")
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
                # One proof by multipliers is enough; ProxQP has to report infeasibility twice.
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
        # With more rows than unknowns ProxQP would choose the other factorisation, which takes three times as many
        # iterations.
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
        # Copy: the next solve changes ProxQP's memory. Its z is [rows; box].
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
