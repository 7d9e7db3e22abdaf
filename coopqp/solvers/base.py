"""The interface of QP solvers: a solver maps a problem to a solution with a status. Run-time data raise no errors."""

from __future__ import annotations

import abc
import time
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from coopqp.checks import Refusing, keep_scalars
from coopqp.errors import InvalidInputError, shown
from coopqp.solvers.problem import Array, QpProblem, QpSolution, SolverStatus, Stacked, blame

_EXACT = "Leave it out: an answer is as exact as the solver makes it, by its own polishing and tolerances."
_EACH = "Leave it out: each attempt has max_iter and max_iter_in."


@dataclass(frozen=True, kw_only=True)
class SolverSettings(Refusing):
    """Settings of every backend.

    Attributes:
        feasibility_tol: largest accepted violation of a constraint, in the constraint's units; a larger violation
            gives the status ``FAILED``.
    """

    removed = {  # noqa: RUF012  # of version 0.2
        **dict.fromkeys(("accuracy", "polish"), _EXACT),
        **dict.fromkeys(("max_iter_warm", "max_iter_in_warm"), _EACH),
        "eps_infeasible": "Leave it out: for OSQP it is eps_prim_inf and eps_dual_inf, for ProxQP eps_primal_inf.",
        "check_duality_gap": "Leave it out: the gap is checked.",
        "update_preconditioner": "Leave it out: a problem is scaled once.",
    }

    feasibility_tol: float = 1e-6

    @property
    def own(self) -> dict[str, Any]:
        """The settings that the backend gets, by its names."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "feasibility_tol"}

    def __post_init__(self) -> None:
        """Check the numbers by the type of their defaults: tolerances are > 0, numbers of iterations 1 or more."""
        for field in fields(self):
            if type(field.default) is float:
                keep_scalars(self, field.name)
            elif type(field.default) is int:
                value = getattr(self, field.name)
                if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value < 2**31:
                    raise InvalidInputError(
                        f"{field.name} = {shown(value)}", type(self).__name__, "Give a whole number above zero."
                    )


@dataclass(slots=True)
class Outcome:
    """Result of a backend: x (n,) and multipliers in the order of :class:`Stacked`, in their own memory."""

    status: SolverStatus
    x: Array | None = None
    y: Array | None = None
    iterations: int = 0
    message: str = ""


class QpSolver(abc.ABC):
    """A QP solver. One instance solves one sequence of problems in one thread.

    Up to the accuracy of the backend, a solution depends on its problem only. Through the warm start, its last bits may
    depend on earlier problems.

    Attributes:
        name: name for :func:`coopqp.solvers.make_solver`.
        settings: settings of the backend.
    """

    name: str
    settings: SolverSettings
    #: It takes QPs with a positive definite H only.
    strictly_convex_only: bool = False

    #: Exceptions of the backend for bad data.
    _raises: tuple[type[Exception], ...] = (ValueError, RuntimeError, ArithmeticError)
    _sizes: tuple[int, int, int] | None = None

    def solve(self, problem: QpProblem) -> QpSolution:
        """Solve one problem. Every failure is a status; the values of the data never raise an error."""
        began = time.perf_counter()
        if problem.sizes != self._sizes:
            self.reset()
            self._sizes = problem.sizes
        wrong, violation = blame(problem), float("nan")
        if wrong:
            outcome = Outcome(SolverStatus.INVALID, message=wrong)
        else:
            rows = problem.stacked()
            outcome = self._attempt(problem, rows)
            if outcome.x is not None:
                violation, wrong = rows.violation(outcome.x)
                if not violation <= self.settings.feasibility_tol:
                    outcome = Outcome(SolverStatus.FAILED, None, None, outcome.iterations, f"answer breaks {wrong}")
            if outcome.status is not SolverStatus.SOLVED:
                self._forget()  # the state of a failed solve is no warm start
        n, _, p = problem.sizes
        x, y = outcome.x, outcome.y
        return QpSolution(
            np.full(n, np.nan) if x is None else x,
            outcome.status,
            None if y is None else y[n + p :],
            None if y is None else y[n : n + p],
            None if y is None else y[:n],
            outcome.iterations,
            time.perf_counter() - began,
            outcome.message,
            float("nan") if x is None else max(violation, 0.0),
        )

    def reset(self) -> None:
        """Forget the warm start and the set-up. The next solve is like the first."""
        self._sizes = None
        self._forget()

    def _attempt(self, problem: QpProblem, rows: Stacked) -> Outcome:
        try:
            outcome = self._solve(problem, rows)
        except self._raises as error:
            reason = str(error).partition("\n")[0][:200]
            return Outcome(SolverStatus.FAILED, message=f"{self.name} raised {type(error).__name__}: {reason}")
        if outcome.status is not SolverStatus.SOLVED:
            return Outcome(outcome.status, iterations=outcome.iterations, message=outcome.message)
        if outcome.x is None or outcome.x.shape != problem.g.shape or not np.isfinite(outcome.x).all():
            return Outcome(SolverStatus.FAILED, message=f"{self.name} returned no finite answer")
        outcome.message = ""
        if outcome.y is not None and not np.vdot(outcome.y, outcome.y) < np.inf:
            outcome.y, outcome.message = None, "multipliers are not finite"
        return outcome

    @abc.abstractmethod
    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        """Solve checked data. May raise the exceptions in :attr:`_raises`."""

    @abc.abstractmethod
    def _forget(self) -> None:
        """Drop the set-up and the warm start."""
