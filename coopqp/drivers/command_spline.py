"""The controller's commands as a curve: control points of a uniform quadratic B-spline.

With points x_i and the controller's period T the curve's velocity is a convex mixture of (x_{i+1} − x_i)/T, and its
acceleration is (x_{i+2} − 2 x_{i+1} + x_i)/T²: the curve keeps the velocity and acceleration limits that the commands
keep. It passes the commands at a distance of at most a T²/8.
"""

from __future__ import annotations

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
        for _ in range(3):
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
        return (self.count - 2) * self.period

    @property
    def tail(self) -> float:
        """The smallest σ at which the curve is kept [s]; −∞ while nothing is forgotten."""
        return (self.count - self._size) * self.period if self.count > self._size else -np.inf

    @property
    def last(self) -> Array:
        """The last command (n,)."""
        return self.points[(self.count - 1) % self._size, :-1]

    def _weights(self, sigma: float) -> tuple[Array, float]:
        """The three points that matter at σ (3, n + 1), and the share of the way between their middles."""
        s = sigma / self.period
        i = min(max(int(np.floor(s)), 0, self.count - self._size), self.count - 3)
        at = i % self._size
        return self.points[at : at + 3], min(max(s - i, 0.0), 1.0)

    def at(self, sigma: float) -> Array:
        """H(σ) (n,), then the controller's clock there [s]: (n + 1,)."""
        (before, middle, after), u = self._weights(sigma)
        w = 1.0 - u
        # In differences, whose weights add up to 1 without rounding: at rest it is the point itself.
        value: Array = middle + 0.5 * w * w * (before - middle) + 0.5 * u * u * (after - middle)
        return value

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
        points, u = self._weights(sigma)
        value: Array = ((1.0 - u) * (points[1] - points[0]) + u * (points[2] - points[1])) / self.period
        return value[:-1]

    def values(self, sigmas: Array) -> Array:
        """H at several σ (m,) → (m, n) [rad or m]."""
        s = sigmas / self.period
        i = np.clip(np.floor(s).astype(int), max(0, self.count - self._size), self.count - 3)
        u = np.clip(s - i, 0.0, 1.0)[:, None]
        at = i % self._size
        a, b, c = self.points[at, :-1], self.points[at + 1, :-1], self.points[at + 2, :-1]
        w = 1.0 - u
        value: Array = 0.5 * w * w * a + (0.5 + u * w) * b + 0.5 * u * u * c
        return value
