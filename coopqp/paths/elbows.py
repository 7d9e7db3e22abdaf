"""A motion of redundant arms along a path, which a controller follows in their null-space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from coopqp.checks import ArrayLike, as_floats
from coopqp.errors import InvalidInputError
from coopqp.shown import Brief
from coopqp.spatial import Array

#: Samples of a motion that is smoothed, and the standard deviation of its mean as a share of the duration.
_SAMPLES, _WIDTH = 60, 0.04


@final
@dataclass(frozen=True, eq=False, repr=False)
class Elbows(Brief):
    """Joint positions over a path's clock: cubics without overshoot through grid points.

    Attributes:
        clocks: of the grid points (K,), rising [s].
        x: joint positions there (K, nv) [rad or m]; continuous joints go on over whole turns.
        slopes: their speeds there (K, nv), per second of the clock.
    """

    clocks: Array
    x: Array
    slopes: Array

    @staticmethod
    def through(clocks: ArrayLike, x: ArrayLike) -> Elbows:
        """The motion through positions (K, nv) at clocks (K,) [s], K of two or more.

        Raises:
            InvalidInputError: the clocks do not rise, or the positions are not one row a clock.
        """
        at, rows = as_floats(clocks), as_floats(x)
        _check(at, rows)
        return Elbows(at, rows, _slopes(at, rows))

    def record(self) -> dict[str, list[Any]]:
        """The motion as plain lists of numbers, from which :meth:`of_record` makes it again, bit for bit."""
        return {"clocks": self.clocks.tolist(), "x": self.x.tolist(), "slopes": self.slopes.tolist()}

    @staticmethod
    def of_record(record: Mapping[str, Any]) -> Elbows:
        """The motion that :meth:`record` describes.

        Raises:
            InvalidInputError: it describes none.
            KeyError, TypeError, ValueError: it is no record.
        """
        clocks, x, slopes = (as_floats(record[name]) for name in ("clocks", "x", "slopes"))
        if x.shape != slopes.shape or not (np.isfinite(x).all() and np.isfinite(slopes).all()):
            raise InvalidInputError("positions and speeds differ in size", "Elbows", "Make it with Elbows.record.")
        _check(clocks, x)
        return Elbows(clocks, x, slopes)

    def smoothed(self) -> Elbows:
        """Nearly the same motion without its kinks, where joints would wait for their accelerations; the same ends."""
        from scipy.ndimage import gaussian_filter1d

        clocks = np.linspace(self.clocks[0], self.clocks[-1], _SAMPLES)
        x = np.array([self.at(clock)[0] for clock in clocks.tolist()])
        wide = np.pad(x, ((_SAMPLES - 1, _SAMPLES - 1), (0, 0)), mode="reflect", reflect_type="odd")
        mean = gaussian_filter1d(wide, _WIDTH * _SAMPLES, axis=0)[_SAMPLES - 1 : 2 * _SAMPLES - 1]
        return Elbows.through(clocks, mean)

    def at(self, clock: float) -> tuple[Array, Array]:
        """Positions and speeds (nv,) at a clock [s]; those of an end beyond it."""
        t, x, v = self.clocks, self.x, self.slopes
        i = min(max(int(np.searchsorted(t, clock, side="right")) - 1, 0), len(t) - 2)
        h = t[i + 1] - t[i]
        u, way = min(max((clock - t[i]) / h, 0.0), 1.0), x[i + 1] - x[i]
        bend, twist = 3.0 * way - h * (2.0 * v[i] + v[i + 1]), h * (v[i] + v[i + 1]) - 2.0 * way
        return x[i] + u * (h * v[i] + u * (bend + u * twist)), v[i] + u * (2.0 * bend + 3.0 * u * twist) / h

    def turning_points(self) -> Array:
        """Positions (4, nv) with the lowest and the highest that each joint has between grid points, and at them."""
        h, a, b, way = np.diff(self.clocks)[:, None], self.slopes[:-1], self.slopes[1:], np.diff(self.x, axis=0)
        bend, twist = 3.0 * way - h * (2.0 * a + b), h * (a + b) - 2.0 * way
        half = bend + np.copysign(np.sqrt(np.maximum(bend**2 - 3.0 * twist * h * a, 0.0)), bend)
        rows = [self.x.min(axis=0), self.x.max(axis=0)]
        with np.errstate(divide="ignore", invalid="ignore"):  # a joint turns where h a + 2 bend u + 3 twist u² = 0
            turns = [-h * a / half, -half / (3.0 * twist)]
        u = np.array([np.where((turn > 0.0) & (turn < 1.0), turn, 0.0) for turn in turns])
        x = self.x[:-1] + u * (h * a + u * (bend + u * twist))
        return np.array([*rows, x.min(axis=(0, 1)), x.max(axis=(0, 1))])

    def packed(self) -> Array:
        """As numbers: the clocks, the positions and the slopes row by row."""
        return np.concatenate([self.clocks, self.x.ravel(), self.slopes.ravel()])


def _check(clocks: Array, x: Array) -> None:
    """Clocks (K,) that rise, and one row of positions (K, nv) each."""
    if clocks.ndim != 1 or x.ndim != 2 or not 2 <= len(clocks) == len(x) or not (np.diff(clocks) > 0.0).all():
        raise InvalidInputError("the clocks do not rise, one a row", "Elbows", "Give rising clocks [s].")


def _slopes(clocks: Array, x: Array) -> Array:
    """Slopes (K, nv) of cubics without overshoot, by Fritsch and Butland.

    They are those of SciPy's PchipInterpolator; a controller asks for them in a step, where nothing may be imported.
    """
    h, m = np.diff(clocks)[:, None], np.diff(x, axis=0) / np.diff(clocks)[:, None]
    if len(m) == 1:
        return np.repeat(m, 2, axis=0)
    before, after = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (before + after) / (before / m[:-1] + after / m[1:])
    inner = np.where(m[:-1] * m[1:] > 0.0, mean, 0.0)
    return np.vstack([_end_slope(h[0], h[1], m[0], m[1]), inner, _end_slope(h[-1], h[-2], m[-1], m[-2])])


def _end_slope(h: Array, next_h: Array, m: Array, next_m: Array) -> Array:
    """The slope at an end (nv,), from the intervals and the slopes of the first and the second piece."""
    slope = ((2.0 * h + next_h) * m - h * next_m) / (h + next_h)
    slope = np.where(slope * m > 0.0, slope, 0.0)
    overshoots = (np.sign(m) != np.sign(next_m)) & (np.abs(slope) > 3.0 * np.abs(m))
    return np.where(overshoots, 3.0 * m, slope)
