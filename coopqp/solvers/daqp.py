"""DAQP, persistent: a dual active-set method, exact, and fast with few active constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.checks import as_options
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings, Workspace
from coopqp.solvers.polish import finish
from coopqp.solvers.problem import INFINITE, Array, QpProblem, SolverStatus

# Marks of a constraint in DAQP's ``sense``.
_ACTIVE_UPPER, _ACTIVE_LOWER, _EQUALITY = 1, 3, 5

# DAQP's exit flags. 4 is an optimum that violates primal_tol: the check of the solution decides.
_STATUS = {
    1: SolverStatus.SOLVED,
    4: SolverStatus.SOLVED,
    -1: SolverStatus.INFEASIBLE,
    -4: SolverStatus.MAX_ITERATIONS,
    -7: SolverStatus.MAX_ITERATIONS,
}
_REASON = {
    -1: "infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "iteration cap",
    -5: "H is not positive semidefinite",
    -6: "equalities depend on each other",
    -7: "time limit",
    -8: "unsupported",
}


#: Largest optimality error of a polished solution without a message.
_ACCURACY = 1e-8


def _is_singular(H: Array) -> bool:
    """True if H is singular up to rounding."""
    try:
        diagonal = np.linalg.cholesky(H).diagonal()
    except np.linalg.LinAlgError:
        return True
    return bool(diagonal.min() ** 2 <= 1e-12 * diagonal.max() ** 2)


@dataclass(frozen=True, kw_only=True)
class DaqpSettings(SolverSettings):
    """Settings of DAQP; all others keep DAQP's defaults.

    Attributes:
        primal_tol: violation of a constraint that counts as zero, in the constraint's units. It also decides whether a
            constraint becomes active, so it bounds the error of x. DAQP's default is 1e-6.
        dual_tol: multiplier of the wrong sign that counts as zero.
        eta_prox: accuracy of DAQP's proximal iterations for a singular H.
        iter_limit: largest number of changes of the active set in one attempt.
        polish: for a singular H, solve the equations of the active set. DAQP's proximal iterations stop early in
            directions of small curvature.
    """

    primal_tol: float = 1e-10
    dual_tol: float = 1e-12
    eta_prox: float = 1e-12
    iter_limit: int = 1000
    polish: bool = True


class DaqpSolver(QpSolver):
    """DAQP with persistent memory and active set. Repeatable bit for bit.

    After a failed warm start the solver tries once more from scratch: with a stale active set DAQP can call a feasible
    problem infeasible.
    """

    name = "daqp"

    def __init__(self, settings: DaqpSettings | None = None) -> None:
        import daqp

        self.settings: DaqpSettings = as_options(DaqpSettings, settings, f"solver '{self.name}': settings")
        self._module = daqp
        self._forget()

    def _forget(self) -> None:
        self._model: Any = None

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        iterations = 0
        if self._model is not None:
            self._load(problem)
            flag = self._model.update(
                H=self._H,
                f=self._g,
                A=self._rows if self._rows.size else None,  # DAQP reads the first entry
                bupper=work.upper,
                blower=work.lower,
                sense=self._warm_sense(work),
            )
            if flag >= 0:
                x, _, flag, info = self._model.solve()
                iterations = info["iterations"]
                if _STATUS.get(flag) is SolverStatus.SOLVED:
                    return self._solved(problem, work, x, info["lam"], iterations)
        self._start(problem, work)
        flag, _ = self._model.setup(self._H, self._g, self._rows, work.upper, work.lower, self._sense)
        if flag < 0:
            return self._report(flag, iterations)
        x, _, flag, info = self._model.solve()
        iterations += info["iterations"]
        if _STATUS.get(flag) is not SolverStatus.SOLVED:
            return self._report(flag, iterations)
        return self._solved(problem, work, x, info["lam"], iterations)

    def _solved(self, problem: QpProblem, work: Workspace, x: Array, y: Array, iterations: int) -> Outcome:
        self._y = y
        outcome = Outcome(SolverStatus.SOLVED, x, y, iterations)
        if self._singular and self.settings.polish:
            finish(problem, work, outcome, _ACCURACY, polished=True)
        return outcome

    def _start(self, problem: QpProblem, work: Workspace) -> None:
        """Build a new model and private buffers: DAQP keeps pointers to its input."""
        n, m, p = work.sizes
        self._model = self._module.Model()
        self._model.settings = {
            "primal_tol": self.settings.primal_tol,
            "dual_tol": self.settings.dual_tol,
            "iter_limit": self.settings.iter_limit,
            "eta_prox": self.settings.eta_prox,
            # Also eliminate the equalities after a warm start: otherwise H = 0 on some unknowns costs six digits.
            "eq_reduction": 1,
        }
        self._H, self._g, self._rows = np.full((n, n), np.nan), np.empty(n), np.empty((p + m, n))
        self._singular = False
        self._sense: NDArray[np.intc] = np.zeros(n + p + m, dtype=np.intc)
        self._sense[n + p :] = _EQUALITY
        self._load(problem)

    def _load(self, problem: QpProblem) -> None:
        p = problem.l.size
        if not np.array_equal(self._H, problem.H):
            self._H[:] = problem.H
            self._singular = _is_singular(problem.H)
        self._g[:] = problem.g
        self._rows[:p] = problem.C
        self._rows[p:] = problem.A

    def _warm_sense(self, work: Workspace) -> NDArray[np.intc]:
        """The active set of the last solution without bounds that became infinite.

        DAQP's own active set would keep them and step to infinity.
        """
        n, _, p = work.sizes
        sense = self._sense
        sense[: n + p] = 0
        for i in np.flatnonzero(self._y[: n + p]):
            if self._y[i] > 0.0:
                if work.upper[i] < INFINITE:
                    sense[i] = _ACTIVE_UPPER
            elif work.lower[i] > -INFINITE:
                sense[i] = _ACTIVE_LOWER
        return sense

    @staticmethod
    def _report(flag: int, iterations: int) -> Outcome:
        status = _STATUS.get(flag, SolverStatus.FAILED)
        return Outcome(status, iterations=iterations, message=f"DAQP: {_REASON.get(flag, f'exit flag {flag}')}")
