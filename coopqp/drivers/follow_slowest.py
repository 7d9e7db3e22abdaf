"""The rate of the shared clock: as fast as the slowest arm, and back along the way when an arm has stopped.

The lateness e of an arm is the time along the way by which it is behind the point where all arms should be. The clock
runs at w = 1 − g (e − e₀)⁺ − I, with an integral I that leaks; with w ≈ 0 and an arm at rest the clock goes back until
the others stand where it stands. e₀ is 1 ms and what a small distance makes of it: no servo stands exactly where it
should, and near the end of a way a little distance is much time.

An arm that stands while the clock stands has stopped if it fell behind: its commands went on, and it did not. Else it
hangs off its commands, as servos do under load; waiting brings it no nearer, and the clock goes on without counting it.
"""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.spatial import Array

#: Lateness that costs no rate [s], and what the rest costs [1/s].
FREE, GAIN = 1e-3, 100.0
#: The integral of lateness: its gain [1/s²], and the time in which it is forgotten [s].
INTEGRAL_GAIN, FORGETTING = 1500.0, 0.2
#: The clock takes up a rate in this time [s].
UPTAKE = 0.06
#: Rates of the clock.
SLOWEST, FASTEST = -0.5, 1.0
#: An arm stands below the first rate, and moves again above the second; the clock stands below the third.
STANDS, MOVES, CLOCK_STANDS = 0.05, 0.15, 0.01
#: An arm has stopped where the way that it lacks makes up this share of its lateness.
FELL = 0.5
#: The way back to an arm that stopped: gain [1/s], and how far from it the others stay [s].
BACK_GAIN, BACK_FREE = 12.0, 1e-4
#: How often an arm moved on is forgotten in this time [s].
_OF_LATE = 2.0
#: Filter of an arm's own rate [s].
_RATE_FILTER = 0.02


@final
class FollowSlowest:
    """The law of the shared clock.

    Args:
        arms: number of arms.
        period: h [s].

    Attributes:
        rate: w, the rate that the slowest arm allows; negative on the way back.
        slowest: index of the arm that is furthest behind.
        stopped: an arm has stopped.
        hangs: arms stand off their commands at rest, and none has stopped: the clock waits until that is taken into
            account.
        lost: time that each arm cost (arms,) [s].
        moved_on: how often each arm that had been taken for stopped moved on of late (arms,).
    """

    def __init__(self, arms: int, *, period: float) -> None:
        self._h = period
        self.rate, self.slowest, self.stopped, self.hangs = 1.0, 0, False, False
        self.lost = np.zeros(arms)
        self.moved_on = np.zeros(arms)
        self._integral = 0.0
        self._own = np.ones(arms)

    def restart(self) -> None:
        """Forget what was behind, at rest."""
        self.rate, self.stopped, self.hangs, self._integral = 1.0, False, False, 0.0
        self._own[:] = 1.0

    def step(self, lateness: Array, allowed: Array, own: Array, fell: Array, said: Array) -> float:
        """Take what is known of the arms; return w.

        Args:
            lateness: e of each arm (arms,) [s]; NaN where it is not known.
            allowed: the lateness of an arm that stands as exactly as servos do (arms,) [s].
            own: the rate at which each arm goes along the way (arms,).
            fell: by how much its commands went further along the way than each arm of late (arms,) [s].
            said: whether each arm says that it has stopped (arms,).
        """
        known = np.isfinite(lateness)
        share = self._h / (_RATE_FILTER + self._h)
        self._own += np.where(known, share * (own - self._own), 0.0)
        e = over = 0.0
        if known.any():
            beyond = lateness - FREE - allowed
            furthest = int(np.nanargmax(beyond))
            # On the way back to an arm that stopped, one that is merely inexact does not take its place.
            if not self.stopped or beyond[furthest] > 0.0 or not known[self.slowest]:
                self.slowest = furthest
            e, over = float(lateness[self.slowest]), max(float(beyond[self.slowest]), 0.0)
        self._integral += self._h * (INTEGRAL_GAIN * over - self._integral / FORGETTING)
        self._integral = min(max(self._integral, 0.0), 1.0)
        w = 1.0 - GAIN * over - self._integral
        own_rate = abs(float(self._own[self.slowest]))
        self.moved_on *= 1.0 - self._h / _OF_LATE
        if said.any():
            self.stopped = True
        elif self.stopped:
            self.stopped = own_rate < MOVES
            self.moved_on[self.slowest] += not self.stopped
        elif self.hangs or (w < CLOCK_STANDS and own_rate < STANDS and over > 0.0):
            self.stopped = not self.hangs and bool(fell[self.slowest] >= FELL * e)
            self.hangs = not self.stopped and e > FREE
            w, self._integral = 0.0, 0.0
        if self.stopped:
            self.hangs = False
            if said.any():
                told = np.where(said & known, lateness, -np.inf)
                self.slowest = int(np.argmax(told)) if (said & known).any() else int(np.argmax(said))
                e = float(told[self.slowest]) if np.isfinite(told[self.slowest]) else 0.0
            w = -BACK_GAIN * (e - BACK_FREE)
            w = min(w, 0.0)
        self.rate = min(max(w, SLOWEST if self.stopped else 0.0), FASTEST)
        self.lost[self.slowest] += self._h * (1.0 - max(self.rate, 0.0))
        return self.rate

    def clock_rate(self, parameter: float, time_constant: float, sigma: float) -> float:
        """σ̇ that brings the curve's parameter p to the rate w, for a low pass of a time constant [s]."""
        wanted = self.rate + (parameter + time_constant * self.rate - sigma) / UPTAKE
        return min(max(wanted, SLOWEST), FASTEST)
