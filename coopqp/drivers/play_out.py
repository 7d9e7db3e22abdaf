"""What each arm is sent: commands that put joints with different lags and delays at the same point of the curve.

With c = H(σ), P its first-order low pass of time constant M, and p that of σ: a first-order servo of lag L ≤ M that is
sent (1 − r) P + r c with r = L/M, which is P + L Ṗ, stands at P. P and c keep the limits, and so does each fixed convex
mixture of them. A small addition with limits of its own puts the arms at H(p), where the tools agree, in place of P.
"""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.drivers.command_spline import CommandSpline
from coopqp.spatial import Array

#: Smallest time constant of the low pass [s].
LEAST_TIME_CONSTANT = 1e-4
#: The addition closes a difference within this time where its limits allow it [s].
_CLOSING_TIME = 0.01


@final
class Follower:
    """A vector that follows a target, each entry within its own limits of velocity and acceleration.

    Args:
        velocity, acceleration: limits (n,) [1/s, 1/s²] of the quantity.
        period: [s].
    """

    def __init__(self, velocity: Array, acceleration: Array, period: float) -> None:
        self._v, self._a, self._h = velocity, acceleration, period
        self.value, self.speed = np.zeros(len(velocity)), np.zeros(len(velocity))
        self._target = self.value

    def step(self, target: Array, share: float) -> Array:
        """Go on by one period, with a share of the limits. Returns the value (n,)."""
        h = self._h
        away = self._target - self.value
        # The speed from which the rest of the way is enough to stop, beside the target's own speed.
        room = np.abs(away)
        braking = share * self._a
        most = np.minimum(np.sqrt(2.0 * braking * room), room / _CLOSING_TIME)
        moves = (target - self._target) / h
        self._target = target
        wanted = np.clip(moves + np.sign(away) * most, -share * self._v, share * self._v)
        # A higher share may have left a higher speed.
        self.speed = self.speed + np.clip(wanted - self.speed, -braking * h, braking * h)
        self.value = self.value + self.speed * h
        return self.value


@final
class PlayOut:
    """Turns the shared clock's point c into the commands of all joints.

    Args:
        x: where it begins, at rest (n,) [rad or m].
        lag, delay: of each joint (n,) [s].
        velocity, acceleration: limits (n,).
        period: h [s].

    Attributes:
        time_constant: M [s].
        parameter: p [s], the low pass of σ.
        rate: ṗ.
        guarded: in how many periods the sum of mixture and addition had to be cut to the limits.
    """

    def __init__(
        self, x: Array, *, lag: Array, delay: Array, velocity: Array, acceleration: Array, period: float
    ) -> None:
        self._h = period
        self._v, self._a = velocity, acceleration
        self._most, self._most_change = velocity * period, acceleration * period**2
        self.addition = Follower(velocity, acceleration, period)
        self._low, self.parameter, self.rate = x.copy(), 0.0, 0.0
        self._sent = self._sent_before = self._wanted = x.copy()
        self.guarded = 0
        wait = float(delay.max(initial=0.0)) - delay
        self._back, self._part = np.floor(wait / period).astype(int), wait / period - np.floor(wait / period)
        self._ring = np.tile(x, (int(self._back.max(initial=0)) + 2, 1))
        self._at, self._joints = 0, np.arange(len(x))
        self._delayed = bool((wait > 0.0).any())
        self.retune(lag)

    def retune(self, lag: Array) -> None:
        """Take other lags (n,) [s]; at rest only, where c and P are the same."""
        self.lag = lag
        self.time_constant = max(float(lag.max(initial=0.0)), LEAST_TIME_CONSTANT)
        self._share = lag / self.time_constant
        # Then σ − p = M ṗ, exactly.
        self._alpha = self._h / (self._h + self.time_constant)

    def restart(self) -> None:
        """Count σ and p from 0 again, at rest."""
        self.parameter = 0.0

    def mixture(self, c: Array) -> Array:
        """Take the next point c (n,); return the convex mixture of each joint (n,)."""
        self._low = self._low + self._alpha * (c - self._low)
        value: Array = (1.0 - self._share) * self._low + self._share * c
        return value

    def step(self, c: Array, sigma: float, spline: CommandSpline, lag: Array, share: float) -> Array:
        """The commands of one period (n,).

        Args:
            c, sigma: the shared clock's point and σ.
            spline: the curve.
            lag: the best known lags (n,) [s]; where they are not those of :meth:`retune` the addition makes up.
            share: of the limits, for the addition.
        """
        mixture = self.mixture(c)
        before = self.parameter
        self.parameter += self._alpha * (sigma - before)
        self.rate = (sigma - self.parameter) / self.time_constant
        wanted = spline.value(self.parameter) + lag * (self.rate * spline.slope(self.parameter))
        sent = mixture + self.addition.step(wanted - mixture, share)
        return self._delay(self._guard(sent))

    def _guard(self, wanted: Array) -> Array:
        """The commands (n,) that keep the limits after the last two and come nearest to what is wanted.

        Going on evenly always keeps them. What is cut off is made up for so that it does not swing.
        """
        last = self._sent
        gap = self._wanted - last
        making_up = np.sqrt(self._most_change * np.abs(gap))
        step = wanted - self._wanted + np.clip(gap, -making_up, making_up)
        self._wanted = wanted
        even = last - self._sent_before
        kept = np.clip(step, even - self._most_change, even + self._most_change)
        kept = np.clip(kept, -self._most, self._most)
        self.guarded += int(np.abs(kept - step).max(initial=0.0) > 1e-12)
        self._sent_before, self._sent = last, last + kept
        return self._sent

    def _delay(self, sent: Array) -> Array:
        """Each joint's command of as long ago as it is faster than the slowest (n,)."""
        if not self._delayed:
            return sent
        size = len(self._ring)
        self._at = (self._at + 1) % size
        self._ring[self._at] = sent
        newer = self._ring[(self._at - self._back) % size, self._joints]
        older = self._ring[(self._at - self._back - 1) % size, self._joints]
        value: Array = newer + self._part * (older - newer)
        return value
