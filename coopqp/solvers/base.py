"""The interface of QP solvers: a solver maps a problem to a solution with a status. Run-time data raise no errors."""

from __future__ import annotations

import abc
import time
from dataclasses import dataclass, fields

import numpy as np

from coopqp.checks import keep_scalars
from coopqp.errors import InvalidInputError, shown
from coopqp.solvers.problem import INFINITE, Array, QpProblem, QpSolution, SolverStatus, blame


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """Settings of every backend.

    Attributes:
        feasibility_tol: largest accepted violation of a constraint, in the constraint's units; a larger violation
            gives the status ``FAILED``.
    """

    feasibility_tol: float = 1e-6

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


class Workspace:
    """Bounds and row values for problems of one size, stacked in the order [box (n); rows (p); equalities (m)].

    Attributes:
        sizes: the sizes (n, m, p).
        lower, upper: all bounds (n + p + m,), clipped to ± the backend's infinity.
        values: x, C x and A x (n + p + m,) of the last tested solution.
        above, below: excess of the values over their upper bounds and below their lower bounds (n + p + m,).
    """

    __slots__ = (
        "_ends",
        "_judged",
        "_ordered",
        "_sections",
        "_worst",
        "above",
        "below",
        "lower",
        "sizes",
        "upper",
        "values",
    )

    def __init__(self, sizes: tuple[int, int, int]) -> None:
        n, m, p = sizes
        self.sizes = sizes
        self.lower, self.upper, self.values, self.above, self.below = (np.zeros(n + p + m) for _ in range(5))
        self._sections = [(a[:n], a[n : n + p], a[n + p :]) for a in (self.lower, self.upper, self.values)]
        self._ordered = np.zeros(n + p + m, dtype=bool)
        self._ends: tuple[float, Array, Array] = (0.0, np.zeros(0), np.zeros(0))
        self._judged: Array | None = None
        self._worst = (0.0, 0)

    def load(self, problem: QpProblem, infinity: float) -> bool:
        """Copy the bounds. False if an entry is NaN, a matrix or vector is infinite, or bounds are crossed."""
        n, m, p = self.sizes
        self._judged = None
        (lb, l, lower_b), (ub, u, upper_b), _ = self._sections
        if infinity != self._ends[0]:
            far = np.full(max(n, p), infinity)  # np.minimum is faster with an array than with a number
            self._ends = infinity, far, -far
        _, far, far_below = self._ends
        np.minimum(problem.ub, far[:n], out=ub)
        np.minimum(problem.u, far[:p], out=u)
        np.maximum(problem.lb, far_below[:n], out=lb)
        np.maximum(problem.l, far_below[:p], out=l)
        if m:
            lower_b[:] = upper_b[:] = problem.b
        # NaN in either operand fails the comparison; so do lower bounds of +inf and upper bounds of -inf.
        np.less_equal(self.lower, self.upper, out=self._ordered)
        limit = INFINITE * INFINITE
        return bool(
            np.count_nonzero(self._ordered) == self._ordered.size
            and np.vdot(problem.H, problem.H) < limit
            and np.vdot(problem.g, problem.g) < limit
            and np.vdot(problem.C, problem.C) < limit
            and (m == 0 or (np.vdot(problem.A, problem.A) < limit and np.vdot(problem.b, problem.b) < limit))
        )

    def violation(self, problem: QpProblem, x: Array) -> tuple[float, int]:
        """Largest excess of x, C x, A x over a bound (NaN if x is not finite), and the index of that entry.

        Also updates ``values``, ``above`` and ``below``. The result for the same array x is cached until the next
        problem is loaded.
        """
        if x is self._judged:
            return self._worst
        box, rows, equalities = self._sections[2]
        box[:] = x
        np.dot(problem.C, x, out=rows)
        if equalities.size:
            np.dot(problem.A, x, out=equalities)
        np.subtract(self.values, self.upper, out=self.above)
        np.subtract(self.lower, self.values, out=self.below)
        excess = np.maximum(self.above, self.below)
        worst = int(excess.argmax())  # argmax stops at the first NaN
        self._judged, self._worst = x, (excess.item(worst), worst)
        return self._worst

    def name(self, index: int) -> str:
        """Name of an entry of the stacked vectors, for messages."""
        n, _, p = self.sizes
        if index < n:
            return f"bound of x[{index}]"
        return f"row {index - n} of C" if index < n + p else f"equality {index - n - p}"


@dataclass(slots=True)
class Outcome:
    """Result of a backend: x (n,) and multipliers in the order of :class:`Workspace`, in their own memory."""

    status: SolverStatus
    x: Array | None = None
    y: Array | None = None
    iterations: int = 0
    message: str = ""
    violation: float = float("nan")


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

    #: Infinite bound of the backend.
    _infinity: float = INFINITE
    #: Exceptions of the backend for bad data.
    _raises: tuple[type[Exception], ...] = (ValueError, RuntimeError, ArithmeticError)
    _workspace: Workspace | None = None

    def solve(self, problem: QpProblem) -> QpSolution:
        """Solve one problem. Every failure is a status; the values of the data never raise an error."""
        began = time.perf_counter()
        work = self._workspace
        if work is None or work.sizes != problem.sizes:
            self.reset()
            work = self._workspace = Workspace(problem.sizes)
        if work.load(problem, self._infinity):
            outcome = self._attempt(problem, work)
        else:
            outcome = Outcome(SolverStatus.INVALID, message=blame(problem))
        x, y = outcome.x, outcome.y
        n, _, p = work.sizes
        if outcome.status is not SolverStatus.SOLVED or x is None:
            x, y = np.full(n, np.nan), None
        return QpSolution(
            x,
            outcome.status,
            None if y is None else y[n + p :],
            None if y is None else y[n : n + p],
            None if y is None else y[:n],
            outcome.iterations,
            time.perf_counter() - began,
            outcome.message,
            outcome.violation,
        )

    def reset(self) -> None:
        """Forget the warm start and the set-up. The next solve is like the first."""
        self._workspace = None
        self._forget()

    def _attempt(self, problem: QpProblem, work: Workspace) -> Outcome:
        try:
            outcome = self._solve(problem, work)
        except self._raises as error:
            reason = str(error).partition("\n")[0][:200]
            outcome = Outcome(SolverStatus.FAILED, message=f"{self.name} raised {type(error).__name__}: {reason}")
        if outcome.status is SolverStatus.SOLVED:
            if outcome.x is None or outcome.x.shape != (work.sizes[0],):
                outcome = Outcome(SolverStatus.FAILED, message=f"{self.name} returned no answer")
            else:
                excess, worst = work.violation(problem, outcome.x)
                if not excess <= self.settings.feasibility_tol:
                    message = f"answer breaks {work.name(worst)} by {excess:.3g}"
                    outcome = Outcome(SolverStatus.FAILED, iterations=outcome.iterations, message=message)
                else:
                    outcome.violation = max(excess, 0.0)
                if outcome.y is not None and not np.vdot(outcome.y, outcome.y) < np.inf:
                    outcome.y, outcome.message = None, "multipliers are not finite"
        if outcome.status is not SolverStatus.SOLVED:
            # The state of a failed solve is no warm start.
            self._forget()
        return outcome

    @abc.abstractmethod
    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        """Solve checked data. May raise the exceptions in :attr:`_raises`."""

    @abc.abstractmethod
    def _forget(self) -> None:
        """Drop the set-up and the warm start."""
