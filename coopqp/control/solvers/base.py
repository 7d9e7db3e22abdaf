"""The interface of QP solvers: a solver maps a problem to a solution with a status. Run-time data raise no errors."""

from __future__ import annotations

import abc
import enum
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from coopqp.checks import as_options
from coopqp.errors import InvalidInputError, shown

Array: TypeAlias = NDArray[np.float64]

#: Smallest number that counts as infinite. As a bound it means "no bound"; in a matrix or vector it is invalid.
INFINITE = 1e20

_FIELDS = ("H", "g", "A", "b", "C", "l", "u", "lb", "ub")
_FLOAT = np.dtype(np.float64)


class SolverStatus(enum.Enum):
    """Result of a solve. Only ``SOLVED`` has a solution."""

    SOLVED = "solved"  #: the solution satisfies every constraint within the tolerance of the settings
    INFEASIBLE = "infeasible"  #: the solver reports that no x satisfies the constraints
    MAX_ITERATIONS = "iteration cap reached"  #: also for a time limit or insufficient accuracy
    INVALID = "invalid data"  #: NaN or infinite entries, or crossed bounds; the solver was not called
    FAILED = "failed"  #: any other failure; also a solution that is not finite or violates a constraint


@dataclass(frozen=True, slots=True, eq=False)
class QpProblem:
    """Minimise ½ xᵀ H x + gᵀ x subject to A x = b, l ≤ C x ≤ u, lb ≤ x ≤ ub.

    The arrays may be preallocated views that the caller rewrites before every solve: no solver keeps or modifies them.
    The constructor checks shapes and types, the solver checks the values before every solve.

    Attributes:
        H: quadratic cost (n, n), symmetric positive semidefinite; only :meth:`check` tests this.
        g: linear cost (n,).
        A, b: equality rows (m, n) and their right-hand side (m,); m may be 0.
        C, l, u: inequality rows (p, n) and their bounds (p,); p may be 0, and bounds may be ±inf.
        lb, ub: bounds of x (n,); they may be ±inf.
    """

    H: Array
    g: Array
    A: Array
    b: Array
    C: Array
    l: Array
    u: Array
    lb: Array
    ub: Array

    def __post_init__(self) -> None:
        H, g, A, b, C, l, u, lb, ub = self.H, self.g, self.A, self.b, self.C, self.l, self.u, self.lb, self.ub
        for name, array in (
            ("H", H),
            ("g", g),
            ("A", A),
            ("b", b),
            ("C", C),
            ("l", l),
            ("u", u),
            ("lb", lb),
            ("ub", ub),
        ):
            if not isinstance(array, np.ndarray) or array.dtype != _FLOAT:
                kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
                raise InvalidInputError(f"{name} is {kind}", "QpProblem", "Give a NumPy array of float64.")
        n, m, p = g.size, b.size, l.size
        found = (H.shape, g.shape, A.shape, b.shape, C.shape, l.shape, u.shape, lb.shape, ub.shape)
        if found != ((n, n), (n,), (m, n), (m,), (p, n), (p,), (p,), (n,), (n,)) or n == 0:
            raise InvalidInputError(
                f"shapes of H, g, A, b, C, l, u, lb, ub are {found}",
                "QpProblem",
                "They must be (n, n), (n,), (m, n), (m,), (p, n), (p,), (p,), (n,), (n,) with n > 0.",
            )

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers (n, m, p) of unknowns, equality rows and inequality rows."""
        return self.g.size, self.b.size, self.l.size

    def check(self) -> None:
        """Check that the problem is convex. Solvers do not check this.

        Raises:
            InvalidInputError: H is not symmetric, or not positive semidefinite, by more than rounding.
        """
        scale = float(np.abs(self.H).max())
        skew = float(np.abs(self.H - self.H.T).max())
        if not skew <= 1e-12 * scale:
            raise InvalidInputError(
                f"H differs from its transpose by {skew:.3g}", "QpProblem", "Give ½ (H + Hᵀ), which costs the same."
            )
        lowest = float(np.linalg.eigvalsh(self.H)[0])
        if lowest < -1e-10 * scale:
            raise InvalidInputError(
                f"H has an eigenvalue of {lowest:.3g}", "QpProblem", "A cost must not fall without end: mind its sign."
            )


@dataclass(frozen=True, slots=True, eq=False)
class QpSolution:
    """The result of a solve. It owns its arrays.

    Attributes:
        x: the solution (n,); NaN unless :attr:`usable`.
        status: status of the solve.
        y_eq, y_rows, y_box: multipliers (m,), (p,), (n,) with H x + g + Aᵀ y_eq + Cᵀ y_rows + y_box = 0; positive at
            an active upper bound, negative at an active lower bound. None if the backend reports none or fails.
        iterations: iterations of the backend, over all attempts.
        solve_time_s: wall time of the whole call including all checks [s].
        message: reason of a failure, or a remark; normally empty.
        violation: largest violation of a constraint by x, as in :meth:`primal_residual`; NaN unless usable.
    """

    x: Array
    status: SolverStatus
    y_eq: Array | None
    y_rows: Array | None
    y_box: Array | None
    iterations: int
    solve_time_s: float
    message: str = ""
    violation: float = float("nan")

    @property
    def usable(self) -> bool:
        """True if the solution exists and satisfies every constraint."""
        return self.status is SolverStatus.SOLVED

    def primal_residual(self, problem: QpProblem) -> float:
        """Largest violation of a constraint of ``problem`` by x; 0 if all hold, NaN unless usable."""
        Cx = problem.C @ self.x
        return _largest(
            np.abs(problem.A @ self.x - problem.b),
            Cx - problem.u,
            problem.l - Cx,
            self.x - problem.ub,
            problem.lb - self.x,
        )

    def dual_residual(self, problem: QpProblem) -> float:
        """Largest entry of |H x + g + Aᵀ y_eq + Cᵀ y_rows + y_box|; NaN without multipliers."""
        if self.y_eq is None or self.y_rows is None or self.y_box is None:
            return float("nan")
        gradient = problem.H @ self.x + problem.g
        return _largest(np.abs(gradient + problem.A.T @ self.y_eq + problem.C.T @ self.y_rows + self.y_box))

    def complementarity(self, problem: QpProblem) -> float:
        """Largest min(|y|, distance to the active bound of y); NaN without multipliers.

        Only this residual detects a stale solution: after bounds relax, the old x and y have no other residual.
        """
        if self.y_rows is None or self.y_box is None:
            return float("nan")
        Cx = problem.C @ self.x
        y = np.concatenate([self.y_box, self.y_rows])
        above = np.concatenate([problem.ub - self.x, problem.u - Cx])
        below = np.concatenate([self.x - problem.lb, Cx - problem.l])
        return _largest(np.minimum(np.abs(y), np.abs(np.where(y > 0.0, above, below))))


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """Settings of every backend.

    Attributes:
        feasibility_tol: largest accepted violation of a constraint, in the constraint's units; a larger violation
            gives the status ``FAILED``.
    """

    feasibility_tol: float = 1e-6

    def __post_init__(self) -> None:
        require_positive(self, "feasibility_tol")


def require_positive(settings: object, *names: str) -> None:
    """Raise InvalidInputError unless the named settings are finite numbers > 0."""
    for name in names:
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= sys.float_info.max:
            raise InvalidInputError(f"{name} = {shown(value)}", type(settings).__name__, "Give a number above zero.")


def require_count(settings: object, *names: str) -> None:
    """Raise InvalidInputError unless the named settings are integers > 0."""
    for name in names:
        value = getattr(settings, name)
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value < 2**31:
            raise InvalidInputError(
                f"{name} = {shown(value)}", type(settings).__name__, "Give a whole number above zero."
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
        name: name for :func:`coopqp.control.solvers.make_solver`.
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
            outcome = Outcome(SolverStatus.INVALID, message=_blame(problem))
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


def settings_of(settings: Any, wanted: type[Any], name: str) -> Any:
    """Return the given settings or the defaults. Raises InvalidInputError for settings of another backend."""
    if settings is None or isinstance(settings, Mapping):
        return as_options(wanted, settings, f"solver '{name}': settings")
    if not isinstance(settings, wanted):
        raise InvalidInputError(
            f"settings are {type(settings).__name__}", f"solver '{name}'", f"Give {wanted.__name__} or nothing."
        )
    return settings


def _largest(*parts: Array) -> float:
    """Largest entry of all arrays, at least 0; NaN if any entry is NaN."""
    return float(np.max([0.0, *(part.max() for part in parts if part.size)]))


def _blame(problem: QpProblem) -> str:
    """Name the invalid array. This runs only for invalid data, so it need not be fast."""
    for name in ("H", "g", "A", "b", "C"):
        array = getattr(problem, name)
        if not np.isfinite(array).all():
            return f"{name} has entries that are not finite"
        if not np.linalg.norm(array) < INFINITE:
            return f"{name} has entries of the order of {INFINITE:g}"
    for low, high in (("l", "u"), ("lb", "ub")):
        lower, upper = getattr(problem, low), getattr(problem, high)
        for name, array, wrong in ((low, lower, np.inf), (high, upper, -np.inf)):
            if np.isnan(array).any() or (array == wrong).any():
                return f"{name} has entries that are NaN or infinite on the wrong side"
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            return f"{low}[{i}] = {lower[i]:g} is above {high}[{i}] = {upper[i]:g}"
    return f"a bound beyond {INFINITE:g} excludes every x"
