"""The fastest speed profile along knots under limits that are lines in (s̈, ṡ²).

The parametrisation is TOPP-RA of the library toppra (H. Pham, Q.-C. Pham: A New Approach to Time-Optimal Path
Parameterization Based on Reachability Analysis, IEEE T-RO 34(3), 2018), with exact derivatives and with limits that
hold at both ends of each interval (its scheme "interpolation"; collocation breaks limits between knots).
"""

from __future__ import annotations

import itertools
import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coopqp.errors import UndecidedError
from coopqp.lazy import needed
from coopqp.planning.knots import Knots
from coopqp.spatial import Array

#: toppra, whose tolerances are absolute, gets s in units in which the path has this length, and time in units in which
#: s̈ of the hardest knot is 1: so a path of a millimetre is to it as one of a metre.
_LENGTH = 10.0
#: Directions in half a turn that give corners of the lines' hull, and the rounding of points on it.
_DIRECTIONS, _ON_THE_HULL = 8, 1e-12
#: Bound of ṡ² where no speed makes one, in toppra's s.
_LARGEST = 1e6


@dataclass(frozen=True, eq=False)
class Lines:
    """Limits ``|a s̈ + b ṡ² + c| ≤ bound`` of m quantities at K knots.

    Attributes:
        a, b, c: (K, m).
        bound: (m,), > 0.
        owner: index of the joint of each limit (m,).
    """

    a: Array
    b: Array
    c: Array
    bound: Array
    owner: Any

    def take(self, which: Any) -> Lines:
        """The lines that ``which`` selects."""
        return Lines(self.a[:, which], self.b[:, which], self.c[:, which], self.bound[which], self.owner[which])


@dataclass(frozen=True, eq=False)
class Limited:
    """Bounds of the speed along knots.

    Attributes:
        knots: the knots.
        speed: largest speeds of the joints (nv,), inf without.
        acceleration: limits of the joints with an acceleration limit.
        torque: limits of the joints with a torque limit; None without payload.
        further: rate bounds, ``a s̈ + b ṡ² ≤ 1``: one side only; None without.
    """

    knots: Knots
    speed: Array
    acceleration: Lines
    torque: Lines | None = None
    further: Lines | None = None

    def square_bound(self) -> Array:
        """Largest ṡ² by the joints' speeds (K,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            out: Array = ((self.speed / np.abs(self.knots.slope)) ** 2).min(axis=1)
        return out


def outermost(a: Array, b: Array) -> Any:
    """Which of lines ``|a_j s̈ + b_j ṡ²| ≤ 1`` at K knots (K, m) may bind at some knot (m,): all others never do.

    The admissible set is the polar of the convex hull of the points ±(a_j, b_j): a point inside the hull bounds
    nothing. The hull is taken from within, as a polygon of the points that are outermost in some directions.
    """
    x, y = (v / np.maximum(np.abs(v).max(axis=1, keepdims=True), 1e-300) for v in (a, b))
    rows, corners = np.arange(len(x)), []
    kept = np.zeros(x.shape[1], dtype=bool)
    for angle in np.pi / _DIRECTIONS * np.arange(_DIRECTIONS):
        reach = np.cos(angle) * x + np.sin(angle) * y
        outer = np.abs(reach).argmax(axis=1)
        kept[outer] = True
        sign = np.sign(reach[rows, outer])
        corners.append((sign * x[rows, outer], sign * y[rows, outer]))
    corners.append((-corners[0][0], -corners[0][1]))
    for here, after in itertools.pairwise(corners):
        normal = after[1] - here[1], here[0] - after[0]
        width = normal[0] * here[0] + normal[1] * here[1] + _ON_THE_HULL
        beyond = np.abs(normal[0][:, None] * x + normal[1][:, None] * y) > width[:, None]
        kept |= beyond.any(axis=0)
    return np.flatnonzero(kept)


def require_toppra() -> None:
    """Raises MissingExtraError unless toppra can be imported."""
    needed("toppra", "planning", "toppra")


def fastest(limited: Limited) -> Array:
    """The largest ṡ² at each knot (K,), from rest to rest.

    Raises:
        UndecidedError: toppra fails.
    """
    require_toppra()
    lines = limited.acceleration
    binding = lines.take(outermost(lines.a / lines.bound, lines.b / lines.bound)) if lines.owner.size else lines
    limited = replace(limited, acceleration=binding)
    speeds = _by_toppra(limited)
    if speeds is None or not np.isfinite(speeds).all():
        raise UndecidedError(
            "the parametrisation of the path failed numerically, so its fastest motion is not known. Run the path as "
            "it is, in its own time."
        )
    squares: Array = speeds**2
    squares[0] = squares[-1] = 0.0
    return squares


def _by_toppra(limited: Limited) -> Array | None:
    """ṡ at each knot (K,), by toppra; None if it finds none."""
    from toppra import constraint
    from toppra.algorithm import TOPPRA
    from toppra.interpolator import AbstractGeometricPath

    knots, lines = limited.knots, limited.acceleration
    scale = _LENGTH / knots.s[-1]
    hardest = float(np.abs(lines.a / lines.bound).max(initial=0.0)) / scale
    tempo = np.sqrt(hardest) if hardest > 0.0 else 1.0  # toppra's unit of time [s]
    grid = knots.s * scale

    class KnotPath(AbstractGeometricPath):  # type: ignore[misc]
        """The knots, with exact derivatives; toppra asks at its grid points only."""

        dof, path_interval, waypoints = knots.q.shape[1], np.array([grid[0], grid[-1]]), None

        def __call__(self, positions: Any, order: int = 0) -> Array:
            at = np.searchsorted(grid, np.asarray(positions))
            return (knots.q, knots.slope / scale, knots.curvature / scale**2)[order][at]

    class SpeedBound(constraint.LinearConstraint):  # type: ignore[misc]
        """ṡ² by the joints' speeds."""

        def compute_constraint_params(self, path: Any, gridpoints: Any) -> Any:
            bound = np.minimum(limited.square_bound() * (scale * tempo) ** 2, _LARGEST)
            return None, None, None, None, None, None, np.column_stack([np.zeros(len(bound)), bound])

    class LineBound(constraint.LinearConstraint):  # type: ignore[misc]
        """Lines at both ends of each interval, in shares of their bounds: rows of one size."""

        def __init__(self, lines: Lines, *, one_sided: bool = False) -> None:
            super().__init__()
            self.lines, self.one_sided, self.identical = lines, one_sided, True

        def compute_constraint_params(self, path: Any, gridpoints: Any) -> Any:
            lines = self.lines
            a, b = lines.a / (scale * tempo**2), lines.b / (scale * tempo) ** 2
            a, b, c = (x / lines.bound for x in (a, b, lines.c))
            size = a.shape[1]
            F, g = np.eye(size), np.ones(size)
            if not self.one_sided:
                F, g = np.vstack([F, -F]), np.ones(2 * size)
            return constraint.canlinear_colloc_to_interpolate(a, b, c, F, g, None, None, gridpoints, identical=True)

    bounds = [SpeedBound(), *(LineBound(x) for x in (limited.acceleration, limited.torque) if x is not None)]
    if limited.further is not None:
        bounds.append(LineBound(limited.further, one_sided=True))
    logging.getLogger("toppra").setLevel(logging.ERROR)  # the answer tells the same as its warnings
    speeds = TOPPRA(bounds, KnotPath(), gridpoints=grid, solver_wrapper="seidel").compute_parameterization(0.0, 0.0)[1]
    return None if speeds is None else np.asarray(speeds, dtype=float) / (scale * tempo)
