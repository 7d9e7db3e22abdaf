"""From an approximate answer to an exact one: solve the equations of the constraints that the multipliers point at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopqp.solvers.base import INFINITE, Array, Outcome, QpProblem, SolverStatus, Workspace

#: A residual up to this is rounding: nothing is left to polish.
_EXACT = 1e-13
#: Active sets tried; more than a few mean that the answer was not near.
_ROUNDS = 8
#: Unknowns of this size are no answer to anything: a proof up to here is one of infeasibility.
_REACH = 1e5
#: Regularisation of the equations, taken out again by refinement.
_DELTA = 1e-10
_REFINEMENTS = 3


def finish(problem: QpProblem, work: Workspace, outcome: Outcome, accuracy: float, *, polished: bool) -> float:
    """Judge what an iterative solver reached and, if asked to, polish it in place.

    A residual within the accuracy makes the outcome ``SOLVED`` whatever the solver thought of it: it is measured. And
    multipliers that grew without end in a solve that hit its cap often prove that there is no answer.

    Returns:
        The :func:`kkt_residual` of the outcome; infinite if it holds no numbers.
    """
    if outcome.x is None or outcome.y is None:
        return np.inf
    residual = kkt_residual(problem, work, outcome.x, outcome.y)
    if not residual < np.inf:
        outcome.x = outcome.y = None
        if outcome.status is SolverStatus.SOLVED:
            outcome.status, outcome.message = SolverStatus.FAILED, "answer is not finite"
        return np.inf
    raw = outcome.y
    if polished and residual > _EXACT:
        residual = _polish(problem, work, outcome, residual)
    if residual <= accuracy:
        outcome.status, outcome.message = SolverStatus.SOLVED, ""
    elif outcome.status is SolverStatus.MAX_ITERATIONS and excluded_ball(problem, work, raw) > _REACH:
        outcome.status = SolverStatus.INFEASIBLE
        outcome.message = f"infeasible: the multipliers prove that no x up to {_REACH:.0e} meets the constraints"
    elif outcome.status is SolverStatus.SOLVED:
        outcome.message = f"optimal to {residual:.1e} only"
    return residual


def kkt_residual(problem: QpProblem, work: Workspace, x: Array, y: Array) -> float:
    """How far x (n,) and y (n + p + m,), stacked as in the workspace, are from optimal: 0 at an optimum.

    The largest of: a violated constraint, min(|y|, distance to the bound that y pushes from), and the gradient of the
    Lagrangian, the last over 1 + the largest |y|. NaN where x or y is. Leaves x, C x, A x in the workspace.
    """
    n, _, p = work.sizes
    violation, _ = work.violation(problem, x)
    bounded = n + p
    size = np.abs(y)
    gap = work.upper - work.values
    np.subtract(work.values, work.lower, out=gap, where=y <= 0.0)
    np.abs(gap, out=gap)
    np.minimum(gap, size, out=gap)
    gap[bounded:] = 0.0
    slope = problem.H @ x
    slope += problem.g
    slope += y[:n]
    if p:
        slope += y[n:bounded] @ problem.C
    if y.size > bounded:
        slope += y[bounded:] @ problem.A
    np.abs(slope, out=slope)
    # x[x.argmax()] is x.max(), NaN and all, at a quarter of the cost.
    parts = (violation, float(gap[gap.argmax()]), float(slope[slope.argmax()] / (1.0 + size[size.argmax()])))
    return max(parts) if sum(parts) < np.inf else np.nan


def excluded_ball(problem: QpProblem, work: Workspace, y: Array) -> float:
    """Size of the unknowns, max |x|, below which y (n + p + m,) proves that no x meets the constraints.

    Every feasible x has yᵀ G x ≤ s, with G the stacked rows and s the sum of y times the bound on its side; so if
    s < 0, then max |x| ≥ −s / Σ|Gᵀ y|. Zero or less proves nothing.
    """
    n, _, p = work.sizes
    y = np.where((y > 0.0) & (work.upper >= INFINITE) | (y < 0.0) & (work.lower <= -INFINITE), 0.0, y)
    support = float(y @ np.where(y > 0.0, work.upper, work.lower))
    slope = float(np.abs(y[:n] + y[n : n + p] @ problem.C + y[n + p :] @ problem.A).sum())
    return -support / slope if slope > 0.0 else (np.inf if support < 0.0 else 0.0)


def _polish(problem: QpProblem, work: Workspace, outcome: Outcome, residual: float) -> float:
    """Steps of a primal-dual active-set method from x and y of the outcome; keeps the best, returns its residual.

    Expects x, C x, A x of the outcome in the workspace, where :func:`kkt_residual` leaves them.
    """
    assert outcome.x is not None
    assert outcome.y is not None
    n, m, p = work.sizes
    y = outcome.y
    fixed = work.lower == work.upper
    previous: NDArray[np.int8] | None = None
    for _ in range(_ROUNDS):
        # Active where the multiplier outweighs the distance to its bound.
        at_upper = work.upper - work.values < y
        at_upper |= fixed
        side = at_upper.astype(np.int8)
        side[(work.values - work.lower < -y) & ~at_upper] = -1
        if previous is not None and np.array_equal(side, previous):
            break
        previous = side
        active = np.flatnonzero(side)
        solved = _equations(problem, work, active, side) if active.size <= n + m else None
        if solved is None:
            break
        x, multipliers = solved
        y = np.zeros(n + p + m)
        y[active] = multipliers
        after = kkt_residual(problem, work, x, y)
        if after < residual:
            outcome.x, outcome.y, residual = x, y, after
        if residual <= _EXACT:
            break
    return residual


def _equations(
    problem: QpProblem, work: Workspace, active: NDArray[np.intp], side: NDArray[np.int8]
) -> tuple[Array, Array] | None:
    """The minimum with the active constraints at their bounds, and their multipliers; None if it is not finite."""
    n, _, p = work.sizes
    k = active.size
    first, second = np.searchsorted(active, (n, n + p))
    exact = np.zeros((n + k, n + k))
    rows = exact[n:, :n]
    rows[np.arange(first), active[:first]] = 1.0
    rows[first:second] = problem.C[active[first:second] - n]
    rows[second:] = problem.A[active[second:] - (n + p)]
    exact[:n, n:] = rows.T
    exact[:n, :n] = problem.H
    right = np.concatenate([-problem.g, np.where(side[active] > 0, work.upper[active], work.lower[active])])
    shifted = exact.copy()
    diagonal = np.einsum("ii->i", shifted)
    diagonal[:n] += _DELTA
    diagonal[n:] -= _DELTA
    try:
        inverse = np.linalg.inv(shifted)
    except np.linalg.LinAlgError:
        return None
    solution = inverse @ right
    for _ in range(_REFINEMENTS):
        solution += inverse @ (right - exact @ solution)
    if not np.isfinite(solution).all():
        return None
    return solution[:n], solution[n:]
