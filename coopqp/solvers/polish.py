"""Polishing of an approximate solution: the multipliers select the active constraints, whose equations are solved."""

from __future__ import annotations

from dataclasses import dataclass

import eigenpy  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from coopqp.core._core import LARGEST_X
from coopqp.solvers.base import Outcome, Workspace
from coopqp.solvers.problem import INFINITE, Array, QpProblem, SolverStatus

#: Largest absolute and relative residuals that count as rounding; polishing stops there.
_EXACT, _EXACT_RELATIVE = 1e-13, 1e-10
#: Largest multiplier that counts as zero.
_NO_MULTIPLIER = 1e-8
#: Largest number of tried active sets. If a few do not suffice, the solution was not near the optimum.
_ROUNDS = 8
#: Regularisation of the equations, taken out again by refinement: a handful of times where H is nearly singular on
#: the directions that the active constraints leave free, as near a singularity.
_DELTA = 1e-10
_REFINEMENTS = 20
_CONVERGED = 1e-15


@dataclass(slots=True)
class Residual:
    """Optimality error of a solution.

    Attributes:
        absolute: error of the optimality conditions, see :func:`measure`.
        relative: the same residual, but with all terms of the multipliers divided by the largest multiplier. If all
            multipliers are tiny, the absolute residual is small even far from the optimum.
    """

    absolute: float
    relative: float

    @property
    def exact(self) -> bool:
        """True if only rounding is left."""
        return self.absolute <= _EXACT and self.relative <= _EXACT_RELATIVE

    def __lt__(self, other: Residual) -> bool:
        """Compare optimality; absolute residuals below rounding count as equal."""
        mine, theirs = max(self.absolute, _EXACT), max(other.absolute, _EXACT)
        return mine < theirs or (mine == theirs and self.relative < other.relative)


def finish(problem: QpProblem, work: Workspace, outcome: Outcome, accuracy: float, *, polished: bool) -> float:
    """Judge the result of a solver and, if ``polished``, polish it in place.

    If the measured residual is within the accuracy, the status becomes ``SOLVED``, even if the solver reports
    otherwise. If a solve hit its cap with multipliers that grow without bound, these often prove that
    no solution exists.

    Returns:
        The optimality error (:func:`measure`) of the outcome; infinite without finite numbers.
    """
    if outcome.x is None or outcome.y is None:
        return np.inf
    residual = measure(problem, work, outcome.x, outcome.y)
    if not residual.absolute < np.inf:
        outcome.x = outcome.y = None
        if outcome.status is SolverStatus.SOLVED:
            outcome.status, outcome.message = SolverStatus.FAILED, "answer is not finite"
        return np.inf
    raw = outcome.y
    if polished and not residual.exact:
        residual = _polish(problem, work, outcome, residual)
    if residual.absolute <= accuracy:
        outcome.status, outcome.message = SolverStatus.SOLVED, ""
    elif outcome.status is SolverStatus.MAX_ITERATIONS and excluded_ball(problem, work, raw) > LARGEST_X:
        outcome.status = SolverStatus.INFEASIBLE
        outcome.message = f"infeasible: the multipliers prove that no x up to {LARGEST_X:.0e} meets the constraints"
    elif outcome.status is SolverStatus.SOLVED:
        outcome.message = f"optimal to {residual.absolute:.1e} only"
    return residual.absolute


def measure(problem: QpProblem, work: Workspace, x: Array, y: Array) -> Residual:
    """Optimality error of x (n,) and y (n + p + m,), stacked as in the workspace; 0 at an optimum.

    The absolute error is the largest violation of a constraint, min(|y|, distance to the active bound of y), or entry
    of the Lagrangian's gradient divided by 1 + max|y|. NaN if x or y contain NaN. Writes x, C x, A x into the
    workspace.
    """
    n, m, p = work.sizes
    violation, _ = work.violation(problem, x)
    bounded = n + p
    size = np.abs(y)
    # x[x.argmax()] equals x.max(), also for NaN, at a quarter of the cost.
    largest, widest = size.item(size.argmax()), 0.0
    slope = np.dot(problem.H, x)
    slope += problem.g
    if largest != 0.0:
        gap = np.where(y > 0.0, work.above, work.below)
        np.abs(gap, out=gap)
        np.minimum(gap, size, out=gap)
        if m:
            gap[bounded:] = 0.0
            slope += np.dot(y[bounded:], problem.A)
        if p:
            slope += np.dot(y[n:bounded], problem.C)
        slope += y[:n]
        widest = gap.item(gap.argmax())
    np.abs(slope, out=slope)
    steepest = slope.item(slope.argmax())
    absolute = max(violation, widest, steepest / (1.0 + largest))
    if not violation + widest + steepest + largest < np.inf:
        return Residual(np.nan, np.nan)
    return Residual(absolute, max(widest, steepest) / max(largest, _NO_MULTIPLIER))


def excluded_ball(problem: QpProblem, work: Workspace, y: Array) -> float:
    """Radius r such that y (n + p + m,) proves: no x with max|x| < r satisfies the constraints.

    Every feasible x satisfies yᵀ G x ≤ s, with the stacked rows G and the sum s of y times the bound on its side. So if
    s < 0, then max|x| ≥ −s / Σ|Gᵀ y|. A result ≤ 0 proves nothing.
    """
    n, _, p = work.sizes
    y = np.where((y > 0.0) & (work.upper >= INFINITE) | (y < 0.0) & (work.lower <= -INFINITE), 0.0, y)
    support = float(y @ np.where(y > 0.0, work.upper, work.lower))
    slope = float(np.abs(y[:n] + y[n : n + p] @ problem.C + y[n + p :] @ problem.A).sum())
    return -support / slope if slope > 0.0 else (np.inf if support < 0.0 else 0.0)


def _polish(problem: QpProblem, work: Workspace, outcome: Outcome, residual: Residual) -> Residual:
    """Do steps of a primal-dual active-set method from x and y of the outcome. Keeps the best; returns its residual.

    The workspace must contain x, C x, A x of the outcome, as after :func:`measure`.
    """
    assert outcome.x is not None
    assert outcome.y is not None
    n, m, p = work.sizes
    y = outcome.y
    fixed = work.lower == work.upper
    previous = b""
    for _ in range(_ROUNDS):
        # A constraint is active if its multiplier exceeds the distance to its bound.
        at_upper = work.above + y > 0.0
        at_upper |= fixed
        at_lower = work.below - y > 0.0
        at_lower &= ~at_upper
        now = at_upper.tobytes() + at_lower.tobytes()
        if now == previous:
            break
        previous = now
        active = np.flatnonzero(at_upper | at_lower)
        if active.size > n + m:
            break
        solved = _equations(problem, work, active, at_upper)
        if solved is None:
            break
        x, multipliers = solved
        y = np.zeros(n + p + m)
        y[active] = multipliers
        after = measure(problem, work, x, y)
        if after < residual:
            outcome.x, outcome.y, residual = x, y, after
        if residual.exact:
            break
    return residual


def _equations(
    problem: QpProblem, work: Workspace, active: NDArray[np.intp], at_upper: NDArray[np.bool_]
) -> tuple[Array, Array] | None:
    """The minimum with the active constraints at their bounds, and the multipliers; None if it is not finite."""
    n, _, p = work.sizes
    k = active.size
    first, second = np.searchsorted(active, (n, n + p)).tolist()
    exact = np.zeros((n + k, n + k))
    exact[:n, :n] = problem.H
    rows = exact[n:, :n]
    rows[np.arange(first), active[:first]] = 1.0
    if second > first:
        rows[first:second] = problem.C[active[first:second] - n]
    if k > second:
        rows[second:] = problem.A[active[second:] - (n + p)]
    exact[:n, n:] = rows.T
    right = np.empty(n + k)
    np.negative(problem.g, out=right[:n])
    right[n:] = np.where(at_upper, work.upper, work.lower)[active]
    shifted = exact.copy()
    diagonal = shifted.reshape(-1)[:: n + k + 1]
    diagonal[:n] += _DELTA
    diagonal[n:] -= _DELTA
    factors = eigenpy.PartialPivLU(shifted)
    solution: Array = factors.solve(right).reshape(n + k)  # eigenpy returns a matrix for a single number
    last, size = np.inf, float(np.vdot(solution, solution))
    for _ in range(_REFINEMENTS):
        correction = factors.solve(right - np.dot(exact, solution)).reshape(n + k)
        length = float(np.vdot(correction, correction))
        if not length < 0.25 * last:
            break  # limited by rounding, or not finite
        solution += correction
        if length <= _CONVERGED**2 * size:
            break
        last = length
    if not np.vdot(solution, solution) < np.inf:
        return None
    return solution[:n].copy(), solution[n:]
