"""A quadratic program and its solution."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from coopqp.errors import InvalidInputError

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


class Stacked(NamedTuple):
    """The constraints low ≤ G x ≤ high of a problem, in the order [bounds of x (n); rows (p); equalities (m)].

    Attributes:
        G: rows (n + p + m, n).
        low, high: their bounds (n + p + m,), at most ±:data:`INFINITE`.
        p: number of rows of C.
    """

    G: Array
    low: Array
    high: Array
    p: int

    def violation(self, x: Array) -> tuple[float, str]:
        """Largest excess of G x over a bound (NaN if x is not finite), and its row and size in words."""
        value, n, p = self.G @ x, x.size, self.p
        excess = np.maximum(value - self.high, self.low - value)
        worst = int(excess.argmax())  # argmax stops at the first NaN
        name = f"row {worst - n} of C" if worst < n + p else f"equality {worst - n - p}"
        return excess.item(worst), f"{name if worst >= n else f'bound of x[{worst}]'} by {excess[worst]:.3g}"


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
        for name in _FIELDS:
            array = getattr(self, name)
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

    def stacked(self) -> Stacked:
        """All constraints as one set of rows."""
        return Stacked(
            np.vstack([np.eye(self.g.size), self.C, self.A]),
            np.maximum(np.concatenate([self.lb, self.l, self.b]), -INFINITE),
            np.minimum(np.concatenate([self.ub, self.u, self.b]), INFINITE),
            self.l.size,
        )

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
        return max(problem.stacked().violation(self.x)[0], 0.0)

    def dual_residual(self, problem: QpProblem) -> float:
        """Largest entry of |H x + g + Aᵀ y_eq + Cᵀ y_rows + y_box|; NaN without multipliers."""
        if self.y_eq is None or self.y_rows is None or self.y_box is None:
            return float("nan")
        gradient = problem.H @ self.x + problem.g
        return float(np.abs(gradient + problem.A.T @ self.y_eq + problem.C.T @ self.y_rows + self.y_box).max())

    def complementarity(self, problem: QpProblem) -> float:
        """Largest min(|y|, distance to the active bound of y); NaN without multipliers.

        Only this residual detects a stale solution: after bounds relax, the old x and y have no other residual.
        """
        if self.y_rows is None or self.y_box is None:
            return float("nan")
        y, rows = np.concatenate([self.y_box, self.y_rows]), problem.stacked()
        value, low, high = (each[: y.size] for each in (rows.G @ self.x, rows.low, rows.high))
        room = np.where(y > 0.0, high - value, value - low)
        return float(np.minimum(np.abs(y), np.abs(room)).max())


def blame(problem: QpProblem) -> str:
    """What is wrong with the data of a problem, in words; empty if nothing is."""
    for name in ("H", "g", "A", "b", "C"):
        array = getattr(problem, name)
        if not np.vdot(array, array) < INFINITE * INFINITE:
            return f"{name} has entries that are not finite, or of the order of {INFINITE:g}"
    for low, high in (("l", "u"), ("lb", "ub")):
        lower, upper = getattr(problem, low), getattr(problem, high)
        # False for NaN, lower bounds of +inf and upper bounds of -inf.
        fits = np.maximum(lower, -INFINITE) <= np.minimum(upper, INFINITE)
        if not fits.all():
            i = int(fits.argmin())
            return f"{low}[{i}] = {lower[i]:g} and {high}[{i}] = {upper[i]:g} are no bounds, or the lower is above"
    return ""
