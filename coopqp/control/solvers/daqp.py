"""DAQP, kept: a dual active-set method, exact and quick where few constraints are active."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopqp.control.solvers.base import (
    INFINITE,
    Array,
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
from coopqp.errors import MissingExtraError

# Marks of a constraint in DAQP's ``sense``.
_ACTIVE_UPPER, _ACTIVE_LOWER, _EQUALITY = 1, 3, 5

# DAQP's exit flags. 4 is an optimum that exceeds primal_tol somewhere: our own test of the answer decides.
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


#: A polished answer this far from optimal is not worth a message.
_ACCURACY = 1e-8


def _is_singular(H: Array) -> bool:
    """Whether H is positive definite no more than rounding allows to tell."""
    try:
        diagonal = np.linalg.cholesky(H).diagonal()
    except np.linalg.LinAlgError:
        return True
    return bool(diagonal.min() ** 2 <= 1e-12 * diagonal.max() ** 2)


@dataclass(frozen=True, kw_only=True)
class DaqpSettings(SolverSettings):
    """Settings of DAQP; those not named here keep DAQP's defaults.

    Attributes:
        primal_tol: violation of a constraint that counts as none, in the constraint's own units. It also decides
            whether a constraint becomes active, so it bounds the error of x; DAQP's own default is 1e-6.
        dual_tol: wrong sign of a multiplier that counts as none.
        eta_prox: accuracy of the proximal iterations that DAQP takes where H is singular.
        iter_limit: cap on the changes of the active set in one attempt.
        polish: where H is singular, solve the equations of the active set. DAQP takes proximal iterations there, which
            stop early along directions of little curvature.
    """

    primal_tol: float = 1e-10
    dual_tol: float = 1e-12
    eta_prox: float = 1e-12
    iter_limit: int = 1000
    polish: bool = True

    def __post_init__(self) -> None:
        SolverSettings.__post_init__(self)
        require_positive(self, "primal_tol", "dual_tol", "eta_prox")
        require_count(self, "iter_limit")


class DaqpSolver(QpSolver):
    """DAQP with its memory and active set kept. Bit for bit repeatable.

    A failure after a warm start is solved once more from scratch before it is reported: a stale active set can make
    DAQP call a feasible problem infeasible.
    """

    name = "daqp"

    def __init__(self, settings: DaqpSettings | None = None) -> None:
        try:
            import daqp
        except ImportError as error:
            raise MissingExtraError("solvers", "daqp") from error
        self.settings: DaqpSettings = settings_of(settings, DaqpSettings, self.name)
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
                A=self._rows if self._rows.size else None,  # DAQP looks at the first entry
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
        """A new model, and buffers of our own: DAQP keeps pointers to what it is given."""
        n, m, p = work.sizes
        self._model = self._module.Model()
        self._model.settings = {
            "primal_tol": self.settings.primal_tol,
            "dual_tol": self.settings.dual_tol,
            "iter_limit": self.settings.iter_limit,
            "eta_prox": self.settings.eta_prox,
            # Eliminate the equalities also after a warm start: without it H = 0 on some unknowns costs six digits.
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
        """The active set of the last answer, less the bounds that are no more.

        DAQP would keep its own, and step to a bound at infinity.
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
