"""The controller's commands as a curve: control points of a uniform cubic B-spline.

With points x_i and the controller's period T the curve's velocity is a convex mixture of (x_{i+1} − x_i)/T, and its
acceleration, which is continuous, one of (x_{i+2} − 2 x_{i+1} + x_i)/T²: the curve keeps the velocity and acceleration
limits that the commands keep. It passes the commands at a distance of at most a T²/6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from coopqp.spatial import Array


@final
class CommandSpline:
    """Commands as a curve H(σ), with the controller's own clock along it.

    It keeps the last ``size`` points. Before the first one the curve rests.

    Args:
        x: where it begins, at rest (n,) [rad or m].
        clock: the controller's clock there [s].
        period: T, the time between two commands [s].
        size: how many points are kept.

    Attributes:
        points: the control points, and the clock at each as the last number (2 size, n + 1); both halves are the same
            ring.
        count: how many points came so far.
    """

    def __init__(self, x: Array, *, clock: float, period: float, size: int = 4096) -> None:
        self.period = period
        # A second copy of every row spares a window across the ring's end.
        self.points = np.empty((2 * size, len(x) + 1))
        self._size = size
        self.restart(x, clock)

    def restart(self, x: Array, clock: float) -> None:
        """Begin again at rest, at σ = 0."""
        self.count = 0
        for _ in range(4):
            self.append(x, clock)

    def append(self, x: Array, clock: float) -> None:
        """Add the next command (n,), and the controller's clock at it [s]."""
        at = self.count % self._size
        row = self.points[at]
        row[:-1], row[-1] = x, clock
        self.points[at + self._size] = row
        self.count += 1

    @property
    def head(self) -> float:
        """The largest σ at which the curve is known [s]."""
        return (self.count - 3) * self.period

    @property
    def tail(self) -> float:
        """The smallest σ at which the curve is kept [s]; −∞ while nothing is forgotten."""
        return (self.count - self._size) * self.period if self.count > self._size else -np.inf

    @property
    def last(self) -> Array:
        """The last command (n,)."""
        return self.points[(self.count - 1) % self._size, :-1]

    def _weights(self, sigma: float) -> tuple[Array, float]:
        """The four points that matter at σ (4, n + 1), and the share of the way from the second to the third."""
        s = sigma / self.period
        i = min(max(int(np.floor(s)), 0, self.count - self._size), self.count - 4)
        at = i % self._size
        return self.points[at : at + 4], min(max(s - i, 0.0), 1.0)

    def at(self, sigma: float) -> Array:
        """H(σ) (n,), then the controller's clock there [s]: (n + 1,)."""
        points, u = self._weights(sigma)
        return _mean(points, u)

    def value(self, sigma: float) -> Array:
        """H(σ) (n,) [rad or m]."""
        return self.at(sigma)[:-1]

    def clock(self, sigma: float) -> float:
        """The controller's clock at σ [s]."""
        return float(self.at(sigma)[-1])

    def slope(self, sigma: float) -> Array:
        """H′(σ) (n,) [rad/s or m/s]; 0 outside what is known."""
        if sigma < 0.0 or sigma > self.head:
            return np.zeros(self.points.shape[1] - 1)
        (a, b, c, d), u = self._weights(sigma)
        w = 1.0 - u
        value: Array = (0.5 * w * w * (b - a) + (0.5 + u * w) * (c - b) + 0.5 * u * u * (d - c)) / self.period
        return value[:-1]

    def values(self, sigmas: Array) -> Array:
        """H at several σ (m,) → (m, n) [rad or m]."""
        s = sigmas / self.period
        i = np.clip(np.floor(s).astype(int), max(0, self.count - self._size), self.count - 4)
        at = i % self._size
        return _mean([self.points[at + k, :-1] for k in range(4)], np.clip(s - i, 0.0, 1.0)[:, None])


def _mean(points: Sequence[Array] | Array, u: float | Array) -> Array:
    """The point of the curve at a share u of the way from the second of four points to the third."""
    a, b, c, d = points
    w = 1.0 - u
    # In differences, whose weights add up to 1 without rounding: at rest it is the point itself.
    value: Array = b + (w**3 * (a - b) + (3.0 * w * w * (w - 2.0) + 4.0) * (c - b) + u**3 * (d - b)) / 6.0
    return value
