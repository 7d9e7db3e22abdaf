"""One clock σ for all arms: what is sent is H(σ), and it keeps velocity and acceleration limits at any rate.

From c_{n−1} = H(σ_{n−1}) and c_{n−2} the next step of σ is sought between the last one and the wanted one. The last one
is always allowed: with |σ̇| ≤ 1 the second difference of H over equal steps is at most a (σ̇ h)² ≤ a h².
"""

from __future__ import annotations

from typing import final

from coopqp.core import _core
from coopqp.drivers.command_spline import CommandSpline
from coopqp.spatial import Array


@final
class LimitedClock:
    """The clock σ of all arms along a :class:`CommandSpline`.

    Args:
        spline: the commands; it has to be known up to σ + h before each step.
        period: h, the time between two steps [s].
        velocity, acceleration: limits (n,) [rad/s, rad/s²]; the commands have to keep them.

    Attributes:
        sigma: σ [s].
        rate: σ̇ of the last step, −1 to 1.
        point: c = H(σ) (n,) [rad or m].
    """

    def __init__(self, spline: CommandSpline, *, period: float, velocity: Array, acceleration: Array) -> None:
        self._spline, self._h = spline, period
        self._most, self._most_change = velocity * period, acceleration * period**2
        self.restart()

    def restart(self) -> None:
        """Rest at σ = 0, after the spline began again."""
        self.sigma, self.point = 0.0, self._spline.value(0.0)
        self.halt()

    def halt(self) -> None:
        """Rest where it is."""
        self.rate, self._before = 0.0, self.point

    def step(self, wanted: float) -> Array:
        """Go on by one period, at a rate as near to the wanted one, −1 to 1, as the limits allow. Returns c (n,)."""
        self.rate = self._limited(min(max(wanted, -1.0), 1.0))
        self.sigma += self.rate * self._h
        self._before, self.point = self.point, self._spline.value(self.sigma)
        return self.point

    def _limited(self, wanted: float) -> float:
        """The rate nearest to the wanted one that keeps the limits: ``limited_clock.cpp``."""
        points, count, every = self._spline.points, self._spline.count, self._spline.period
        last, limits = (self.point, self._before), (self._most, self._most_change)
        rate: float = _core.limited_rate(points, count, every, *last, *limits, self.sigma, self._h, wanted, self.rate)
        return rate
