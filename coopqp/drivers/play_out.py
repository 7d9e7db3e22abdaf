"""What each arm is sent: commands that put joints with different lags and delays at the same point of the curve.

With c = H(σ), P its first-order low pass of time constant M, and p that of σ: a first-order servo of lag L ≤ M that is
sent (1 − r) P + r c with r = L/M, which is P + L Ṗ, stands at P. P and c keep the limits, and so does each fixed convex
mixture m of them. A small addition A puts the arms at H(p), where the tools agree, in place of P. With a share s of the
limits for A + s m, what is sent, (1 − s) m + (A + s m), keeps the limits as well.
"""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.drivers.command_spline import CommandSpline
from coopqp.spatial import Array, Flags

#: Smallest time constant of the low pass [s].
LEAST_TIME_CONSTANT = 1e-4
#: Both time constants of the addition behind its target [s].
_CLOSING_TIME = 0.02
#: With this time t a target is out of reach beyond s a t² [s]; and that in which one within reach is taken up [s].
_REACH, _UPTAKE = 0.02, 1.0
#: Position limits are no further than this [rad or m]: a share of 0 of them is 0.
_FAR = 1e6
#: The least share with which it goes back to 0 where it has none.
_LEAST_SHARE = 0.05
#: Differences that count as rest, in shares of a h².
_REST = 1e-3


@final
class Addition:
    """A vector that follows a target within what the mixture leaves of the limits.

    All joints are cut by the same factor: one of them alone, cut to its own limits, would part the tools. Joints that
    several arms share have one of their own: they move the tools together. Where the target is out of reach, as after
    each jump of a quick motion's acceleration, and the value is off it by more than half of it, the addition fades
    to 0. One for lags that the mixture does not know never fades.

    Args:
        velocity, acceleration: limits of a period (n,): v h and a h² [rad or m].
        period: h [s].
        lower, upper: limits of the positions (n,) [rad or m]; outside them a joint moves inwards only.
        shared: which joints several arms share (n,).

    Attributes:
        value: A (n,) [rad or m].
        cut: in how many periods it was cut to what the limits left.
    """

    def __init__(
        self,
        velocity: Array,
        acceleration: Array,
        period: float,
        *,
        lower: float | Array,
        upper: float | Array,
        shared: Flags | None,
    ) -> None:
        self._most, self._most_change, self._h = velocity, acceleration, period
        self._shared = np.zeros(len(velocity), dtype=bool) if shared is None else shared
        self._lower, self._upper = np.maximum(lower, -_FAR), np.minimum(upper, _FAR)
        self.cut = 0
        self.rest(np.zeros(len(velocity)))

    def rest(self, value: Array) -> None:
        """Begin again with a value (n,) at rest, while the mixture rests too."""
        self.value, self._step, self._target = value, np.zeros(len(value)), np.zeros(len(value))
        self._mixture_step, self._taken = np.zeros(len(value)), 1.0

    @property
    def short(self) -> Array:
        """What the value has left to its target (n,) [rad or m]."""
        return self._target - self.value

    def follow(self, target: Array, mixture: Array, mixture_step: Array, share: float, *, fades: bool) -> Array:
        """Go on by one period, with a share of the limits. Returns the value (n,).

        Args:
            target: T (n,).
            mixture, mixture_step: m and its last step (n,).
            share: s, of the limits.
            fades: whether the value may fade to 0 where the target is out of reach.
        """
        if share == 0.0:
            if not self.value.any():
                return self.value
            share, target = _LEAST_SHARE, np.zeros(len(target))
        most, most_change = share * self._most, share * self._most_change
        if not fades:
            self._taken = 1.0
        elif self._misleads(target, most_change):
            self._taken = 0.0
        else:
            self._taken = min(self._taken + self._h / _UPTAKE, 1.0)
        gap = self._taken * target - self.value
        moves, self._target = self._taken * (target - self._target), target
        # Ȧ goes to Ṫ + (T − A)/2τ within τ/2, with the period's end on the right; no faster than it may brake.
        k = self._h / _CLOSING_TIME
        closing = min(0.5 * k, float((np.abs(gap) / most_change).max()) ** -0.5 if gap.any() else 1.0)
        wanted = (self._step + 2.0 * k * (moves + closing * gap)) / (1.0 + 2.0 * k * (1.0 + closing))
        # The limits are those of A + s m, for its step and for the change of it, and where it stands.
        own, place = share * mixture_step, share * (mixture - mixture_step) + self.value
        high = np.minimum(most, _largest_step(share * self._upper - place, most_change)) - own
        low = -np.minimum(most, _largest_step(place - share * self._lower, most_change)) - own
        # Nor does what is sent leave the limits, or go further out where it starts outside, as the mixture does then.
        stands = mixture + self.value
        high = np.minimum(high, np.maximum(np.maximum(self._upper - stands, -mixture_step), 0.0))
        low = np.maximum(low, np.minimum(np.minimum(self._lower - stands, -mixture_step), 0.0))
        wanted = wanted * self._factors(wanted, low, high)
        turn = own - share * self._mixture_step
        self._mixture_step = mixture_step
        more, less = most_change - turn, -most_change - turn
        change = wanted - self._step
        factor = self._factors(change, less, more)
        self.cut += int((factor < 1.0).any())
        change = np.clip(np.clip(factor * change, low - self._step, high - self._step), less, more)
        self._step = self._step + change
        self.value = self.value + self._step
        return self.value

    def _factors(self, vector: Array, low: Array, high: Array) -> Array:
        """Of each joint (n,) the largest factor, at most 1, with which all of its kind keep bounds with 0 inside."""
        bound = np.where(vector > 0.0, high, low)
        factors, over = np.ones(len(vector)), np.abs(vector) > np.abs(bound)
        for kind in (self._shared, ~self._shared):
            if (cut := over & kind).any():
                factors[kind] = max(float((bound[cut] / vector[cut]).min()), 0.0)
        return factors

    def _misleads(self, target: Array, most_change: Array) -> bool:
        """Whether the target is out of reach, and the value is off it by more than half of it."""
        away, whole = (float((np.abs(x) / most_change).max()) for x in (target - self.value, target))
        return away * self._h**2 > _REACH**2 and away > 0.5 * whole


def _largest_step(room: Array, change: Array) -> Array:
    """The largest step (n,) after which a brake by ``change`` (n,) a period ends within some room (n,); 0 without."""
    left = np.maximum(room - 0.125 * change, 0.0)
    value: Array = 0.5 * (np.sqrt(change * change + 8.0 * change * left) - change)
    return value


@final
class PlayOut:
    """Turns the shared clock's point c into the commands of all joints.

    Args:
        x: where it begins, at rest (n,) [rad or m].
        lag, delay: of each joint (n,) [s].
        velocity, acceleration: limits (n,).
        period: h [s].
        lower, upper: limits of the positions (n,) [rad or m]; outside them a joint moves inwards only.
        shared: which joints several arms share (n,); none by default.

    Attributes:
        time_constant: M [s].
        parameter: p [s], the low pass of σ.
        rate: ṗ.
        addition: A.
    """

    def __init__(
        self,
        x: Array,
        *,
        lag: Array,
        delay: Array,
        velocity: Array,
        acceleration: Array,
        period: float,
        lower: float | Array = -np.inf,
        upper: float | Array = np.inf,
        shared: Flags | None = None,
    ) -> None:
        self._h = period
        self._most_change = acceleration * period**2
        self.addition = Addition(velocity * period, self._most_change, period, lower=lower, upper=upper, shared=shared)
        self._low, self.parameter, self.rate = x.copy(), 0.0, 0.0
        self._c = self._last = self._mixture = x.copy()
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

    def halt(self, sent: Array, sigma: float) -> None:
        """Go on from rest at what was sent (n,), and lead the addition from there to the shared clock's point c."""
        self._low, self._last, self._mixture = self._c, self._c, self._c
        self.parameter, self.rate = sigma, 0.0
        self.addition.rest(sent - self._c)
        self._ring[:] = sent

    def mixture(self, c: Array) -> Array:
        """Take the next point c (n,); return the convex mixture of each joint (n,)."""
        self._last, self._c = self._c, c
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
        last = self._mixture
        self._mixture = mixture = self.mixture(c)
        before = self.parameter
        self.parameter += self._alpha * (sigma - before)
        self.rate = (sigma - self.parameter) / self.time_constant
        wanted = spline.value(self.parameter) + lag * (self.rate * spline.slope(self.parameter))
        fades = bool((lag == self.lag).all())
        return self._delay(
            mixture + self.addition.follow(wanted - mixture, mixture, mixture - last, share, fades=fades)
        )

    def rests(self) -> bool:
        """Whether c rests, and low pass and addition have come to it."""
        away = np.abs(self._c - self._last) + np.abs(self._c - self._low) + np.abs(self.addition.value)
        return bool((away <= _REST * self._most_change).all())

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
