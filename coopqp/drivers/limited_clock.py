"""One clock σ for all arms: what is sent is H(σ), and it keeps velocity and acceleration limits at any rate.

From c_{n−1} = H(σ_{n−1}) and c_{n−2} the next step of σ is sought between the last one and the wanted one. The last one
is always allowed: with |σ̇| ≤ 1 the second difference of H over equal steps is at most a (σ̇ h)² ≤ a h².
"""

from __future__ import annotations

from typing import final

import numpy as np
import numpy.typing as npt

from coopqp.drivers.command_spline import CommandSpline
from coopqp.native import compiled
from coopqp.native.constants import RATE_CANDIDATES
from coopqp.spatial import Array

_COMPILED = compiled()
#: Candidates of each of the two passes of the search.
_CANDIDATES = np.linspace(1.0, 0.0, RATE_CANDIDATES + 1)


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
        """The rate nearest to the wanted one that keeps the limits; native/limited_clock.cpp does the same."""
        if _COMPILED is not None:
            points, count, every = self._spline.points, self._spline.count, self._spline.period
            last, limits = (self.point, self._before), (self._most, self._most_change)
            rate: float = _COMPILED.limited_rate(
                points, count, every, *last, *limits, self.sigma, self._h, wanted, self.rate
            )
            return rate
        high, low = wanted, self.rate
        if self._allowed(np.array([high]))[0]:
            return high
        for _ in range(2):
            rates = low + _CANDIDATES * (high - low)
            allowed = self._allowed(rates)
            allowed[-1] = True  # the last rate, or one that was found to be allowed
            best = int(np.argmax(allowed))
            high, low = float(rates[max(best - 1, 0)]), float(rates[best])
        return low

    def _allowed(self, rates: Array) -> npt.NDArray[np.bool_]:
        """Which of some rates (m,) keep the limits."""
        step = self._spline.values(self.sigma + rates * self._h) - self.point
        change = step - (self.point - self._before)
        fits = (np.abs(step) <= self._most) & (np.abs(change) <= self._most_change)
        return np.asarray(fits.all(axis=1))
