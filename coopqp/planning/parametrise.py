"""The fastest speed profile along knots under limits that are lines in (s̈, ṡ²).

The parametrisation is TOPP-RA of the library toppra (H. Pham, Q.-C. Pham: A New Approach to Time-Optimal Path
Parameterization Based on Reachability Analysis, IEEE T-RO 34(3), 2018), with exact derivatives and with limits that
hold at both ends of each interval (its scheme "interpolation"; collocation breaks limits between knots).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.errors import MissingExtraError, UndecidedError
from coopqp.planning.knots import Knots
from coopqp.spatial import Array

#: s is scaled to one of these lengths for toppra, whose tolerances are absolute; the next is tried where one fails.
_LENGTHS = (10.0, 1.0, 50.0)


#: Bound of ṡ² where no speed makes one, in toppra's s.
_LARGEST = 1e6


@dataclass(frozen=True, eq=False)
class Lines:
    """Limits ``|a s̈ + b ṡ² + c| ≤ bound`` of m quantities at K knots.

    Attributes:
        a, b, c: (K, m).
        bound: (m,), > 0.
        owner: what each is a limit of (m,): index of the joint.
    """

    a: Array
    b: Array
    c: Array
    bound: Array
    owner: Any


@dataclass(frozen=True, eq=False)
class Limited:
    """What bounds the speed along knots.

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


def require_toppra() -> None:
    """Raises MissingExtraError unless toppra can be imported."""
    try:
        import toppra  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("planning", "toppra") from error


def fastest(limited: Limited) -> Array:
    """The largest ṡ² at each knot (K,), from rest to rest.

    Raises:
        UndecidedError: toppra fails.
    """
    require_toppra()
    for length in _LENGTHS:
        speeds = _by_toppra(limited, length / limited.knots.s[-1])
        if speeds is not None and np.isfinite(speeds).all():
            squares: Array = np.asarray(speeds, dtype=float) ** 2
            squares[0] = squares[-1] = 0.0
            return squares
    raise UndecidedError("the parametrisation failed in numbers; give another number of knots")


def _by_toppra(limited: Limited, scale: float) -> Array | None:
    """ṡ at each knot (K,), by toppra with s in units of 1/``scale``; None if it finds none."""
    from toppra import constraint
    from toppra.algorithm import TOPPRA
    from toppra.interpolator import AbstractGeometricPath

    knots = limited.knots
    grid = knots.s * scale

    class KnotPath(AbstractGeometricPath):  # type: ignore[misc]
        """The knots, with exact derivatives; toppra asks at its grid points only."""

        dof, path_interval, waypoints = knots.q.shape[1], np.array([grid[0], grid[-1]]), None

        def __call__(self, positions: Any, order: int = 0) -> Array:
            at = np.searchsorted(grid, np.asarray(positions))
            rows: Array = (knots.q, knots.slope / scale, knots.curvature / scale**2)[order][at]
            return rows

    class SpeedBound(constraint.LinearConstraint):  # type: ignore[misc]
        """ṡ² by the joints' speeds."""

        def compute_constraint_params(self, path: Any, gridpoints: Any) -> Any:
            bound = np.minimum(limited.square_bound() * scale**2, _LARGEST)
            return None, None, None, None, None, None, np.column_stack([np.zeros(len(bound)), bound])

    class LineBound(constraint.LinearConstraint):  # type: ignore[misc]
        """Lines at both ends of each interval, in shares of their bounds: rows of one size."""

        def __init__(self, lines: Lines, *, one_sided: bool = False) -> None:
            super().__init__()
            self.lines, self.one_sided, self.identical = lines, one_sided, True

        def compute_constraint_params(self, path: Any, gridpoints: Any) -> Any:
            lines = self.lines
            a, b, c = (x / lines.bound for x in (lines.a / scale, lines.b / scale**2, lines.c))
            size = a.shape[1]
            F, g = np.eye(size), np.ones(size)
            if not self.one_sided:
                F, g = np.vstack([F, -F]), np.ones(2 * size)
            return constraint.canlinear_colloc_to_interpolate(a, b, c, F, g, None, None, gridpoints, identical=True)

    bounds = [SpeedBound(), *(LineBound(x) for x in (limited.acceleration, limited.torque) if x is not None)]
    if limited.further is not None:
        bounds.append(LineBound(limited.further, one_sided=True))
    logging.getLogger("toppra").setLevel(logging.ERROR)  # what it warns of is told by the answer
    speeds = TOPPRA(bounds, KnotPath(), gridpoints=grid, solver_wrapper="seidel").compute_parameterization(0.0, 0.0)[1]
    return None if speeds is None else np.asarray(speeds, dtype=float) / scale
