"""The known grid points ahead of the clock, K at each of them, and the largest rate that K admits for a step.

The core's counterpart is ``horizon.cpp``.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, final

import numpy as np

from coopqp.control.lookahead.backward_pass import Interval, Share, largest_square
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.native.constants import KNOTS_PER_PASS, LEAST_RATE, MOST_GUESSES, SHORT_OF, SHORTER
from coopqp.spatial import Array


class GridPoint(NamedTuple):
    """The chain at one clock."""

    clock: float
    q: Array
    slope: Array  # q′ (nv,)
    curvature: Array  # mean of q″ (nv,) since the knot before
    bending: Array  # its change per second since the interval before (nv,); zeros where there is none
    span: float  # since the knot before [s]; 0 where there is none, or the knot is the same one again
    cap: float  # largest σ² here, whatever is ahead
    uncapped: float  # bound of σ² that speed and curvature would make, whether speed makes the cap or not
    binding: BindingLimit | None  # what makes the cap
    fastest: float  # largest |q′|
    change: float  # largest change of a slope since the knot before, less the change that is always allowed
    to_reach_end: Array  # joint motion to where each part's reach ends, of the joints that move the tools, part by part
    steps_to_reach_end: Array  # the largest of each part, as a multiple of the joint's motion in two steps
    inside: bool  # all joints are inside their position limits
    corner: bool = False  # q′ jumps here
    fall: float = np.inf  # largest fall of σ by further constraints [1/s]
    rise: float = np.inf  # largest rise of σ by them [1/s]
    square: float = 0.0  # K: largest σ² here from which the object can go on
    cause: BindingLimit | None = None  # what makes K
    stops: bool = False  # it stops the object for good
    share: Share | None = None  # how K follows from K at the next knot
    since: float = 0.0  # K at the next knot that it was found from

    def __deepcopy__(self, memo: object) -> GridPoint:
        return self  # nobody writes into its arrays


class Least(NamedTuple):
    """The least K along a step.

    Attributes:
        square: K.
        slope: its slope over the step's rate.
        cause: the knot that makes it.
    """

    square: float
    slope: float
    cause: GridPoint

    def met_by(self, rate: float) -> float:
        """The rate σ with ``σ² = K + slope (σ − rate)``."""
        half = 0.5 * self.slope
        return half + math.sqrt(max(half * half + self.square - self.slope * rate, 0.0))


@final
class Horizon:
    """See the module's description.

    Args:
        cell: names the joints.
        acceleration: planned accelerations (nv,).
        slope_cap: largest change of the rate [1/s].
        doubt: see :class:`coopqp.control.lookahead.options.PreviewOptions`.

    Attributes:
        knots: in the order of their clocks; the first is at or before the object's.
        known: number of first knots whose K is known for good.
        complete: nothing comes after the last knot.
    """

    def __init__(self, cell: RobotCell, acceleration: Array, slope_cap: float, doubt: float) -> None:
        self._cell, self._acceleration, self._slope_cap, self._doubt = cell, acceleration, slope_cap, doubt
        self.knots: deque[GridPoint] = deque()
        self.known = self._fresh = 0  # knots since the last backward pass
        self.complete = False

    def clear(self) -> None:
        """Forget all knots."""
        self.knots.clear()
        self.known, self._fresh, self.complete = 0, 0, False

    def memory(self) -> tuple[list[GridPoint], int, int, bool]:
        """State for a copy."""
        return list(self.knots), self.known, self._fresh, self.complete

    def restore(self, memory: tuple[list[GridPoint], int, int, bool]) -> None:
        """Go on from what :meth:`memory` returned."""
        knots, self.known, self._fresh, self.complete = memory
        self.knots = deque(knots)

    def admits(self, clock: float, dt: float, rate: float) -> bool:
        """Whether K admits a rate for a step already: it only rises as more knots become known."""
        if rate > 1.0 or self._fresh or len(self.knots) < 2:
            return False
        if self.knots[-2].clock < clock + dt:  # there the object would rest
            return False
        return rate * rate <= self.least(clock, rate, dt).square

    # -- from knot to knot ---------------------------------------------------------------------------------------

    def push(self, knot: GridPoint) -> None:
        """Add a knot."""
        self.knots.append(knot)
        self._fresh += 1
        if knot.cap == 0.0:
            self.complete = True  # nothing comes after a stop
        if self.complete or self._fresh >= KNOTS_PER_PASS:
            self.look_back()

    def finish(self) -> None:
        """Nothing comes after the last knot."""
        self.complete = True
        self.look_back()

    def leave_behind(self, clock: float) -> None:
        """Drop the knots that another follows before ``clock``."""
        while len(self.knots) > 1 and self.knots[1].clock <= clock:
            self.knots.popleft()
            self.known = max(self.known - 1, 0)

    def reaches(self, clock: float, dt: float) -> bool:
        """Whether K is final along a step from ``clock``: the horizon's end does not make it."""
        return self.known > 0 and self.knots[self.known - 1].clock > clock + 2.0 * dt

    def knot_before(self, clock: float) -> int:
        """Number of the last knot at or before ``clock``."""
        knots = self.knots
        i = 0
        while i + 1 < len(knots) and knots[i + 1].clock <= clock:
            i += 1
        return i

    def joints_at(self, clock: float) -> tuple[Array, Array]:
        """q′ and q″ (nv,) at a clock, from the knots around it.

        q′ is linear between two knots. A knot keeps the mean of q″ since the one before, which belongs to the middle:
        from middle to middle it is linear, but for corners.
        """
        knots, i = self.knots, self.knot_before(clock)
        here = knots[i]
        if i + 1 >= len(knots) or not knots[i + 1].clock > here.clock:
            return here.slope, here.curvature
        ahead, after = knots[i + 1], knots[min(i + 2, len(knots) - 1)]
        share = (clock - here.clock) / (ahead.clock - here.clock)
        border, other = (here, here) if share < 0.5 else (ahead, after)
        towards = 0.0 if border.corner or other.span == 0.0 else abs(share - 0.5)
        curvature = ahead.curvature + towards * (other.curvature - ahead.curvature)
        return here.slope + (clock - here.clock) * ahead.curvature, curvature

    # -- K -------------------------------------------------------------------------------------------------------

    def look_back(self) -> None:
        """Find K from the last knot back to the first one whose K is known for good.

        Where more knots may come the object rests at the last knot but one: q″ is not known at the last. K only rises
        from one pass to the next, and a knot keeps how its K follows from the one ahead.
        """
        self._fresh = 0
        knots = self.knots
        end = len(knots) - (1 if self.complete else 2)
        if end < 0:
            return
        last, settled = knots[end], 0
        if self.complete:
            knots[end] = last._replace(square=last.cap, cause=last.binding, stops=last.cap == 0.0)
            settled = len(knots)
        for i in range(end - 1, self.known - 1, -1):
            here, ahead = knots[i], knots[i + 1]
            share, since = here.share, here.since
            if share is None or not since <= ahead.square <= share.until or ahead.square >= 1.0:
                share, since = self._share(i), ahead.square
            square = share.square + share.gain * (ahead.square - since)
            for_good = not share.ahead
            if for_good and not settled:
                settled = i + 1
            if share.ahead and (ahead.square < 1.0 or share.joint < 0):
                cause, stops = ahead.cause, ahead.stops
            elif share.joint >= 0:
                cause, stops = self._cell.joint_limit(share.joint, LimitKind.ACCELERATION), False
            else:
                cause, stops = here.binding, here.cap == 0.0
            knots[i] = here._replace(square=square, cause=cause, stops=stops, share=share, since=since)
        self.known = max(settled, self.known)

    def _share(self, i: int) -> Share:
        """K at knot ``i`` from K at the next one."""
        here, ahead = self.knots[i], self.knots[i + 1]
        if ahead.span == 0.0:  # the same knot again, with a lower cap
            return Share(ahead.square, 1.0, np.inf, -1)
        chord, span = ahead.curvature, ahead.span
        bend = bend_ahead = chord
        if here.span > 0.0 and not here.corner:
            bend = (here.curvature * span + chord * here.span) / (here.span + span)
        if i + 2 < len(self.knots) and not ahead.corner:
            beyond = self.knots[i + 2]
            if beyond.span > 0.0:
                bend_ahead = (chord * beyond.span + beyond.curvature * span) / (span + beyond.span)
        interval = Interval(
            span,
            here.slope,
            here.slope + chord * span,
            chord,
            bend,
            bend_ahead,
            min(self._slope_cap, here.fall, ahead.fall),
            min(self._slope_cap, here.rise, ahead.rise),
        )
        return largest_square(interval, self._acceleration, here.cap, ahead.square, doubt=self._doubt)

    # -- the rate of a step --------------------------------------------------------------------------------------

    def largest_rate(self, clock: float, dt: float, least: Least) -> tuple[float, GridPoint]:
        """Rate line search: the largest rate below 1 that K admits for a step, and the knot that limits it.

        ``least`` is that of rate 1; rate 0 is always admissible. K is linear between knots: the next guess is where σ²
        meets the line of the least K, or half way. After a miss guesses stay shorter: beside a clock a small rate has
        few digits.
        """
        low, high, rate, short_of, cause = 0.0, 1.0, 1.0, SHORT_OF, least.cause
        for _ in range(MOST_GUESSES):
            guess = (1.0 - short_of) * least.met_by(rate)
            inside = low < guess < high
            rate = guess if inside else 0.5 * (low + high)
            least = self.least(clock, rate, dt)
            if rate * rate > least.square:
                high, short_of = rate, short_of * (SHORTER if inside else 1.0)
                continue
            low, cause = rate, least.cause
            if (1.0 - 2.0 * short_of) * least.met_by(rate) <= rate:
                break
        return low if low >= LEAST_RATE else 0.0, cause

    def least(self, clock: float, rate: float, dt: float) -> Least:
        """The least K of a step: in its middle, at its end, and at the knots on its way."""
        knots = self.knots
        i = self.knot_before(clock)
        least = Least(np.inf, 0.0, knots[i])
        for part in (0.5 * dt, dt):
            at = clock + rate * part
            while i + 1 < len(knots) and knots[i + 1].clock <= at:
                i += 1
                if knots[i].square < least.square:
                    least = Least(knots[i].square, 0.0, knots[i])
            square, slope, made_by = self._square_after(i, at)
            if square < least.square:
                least = Least(square, slope * part, made_by)
        return least

    def _square_after(self, i: int, clock: float) -> tuple[float, float, GridPoint]:
        """K between knot ``i`` and the next one, its slope over the clock, and the knot that makes it."""
        here = self.knots[i]
        if i + 1 == len(self.knots):
            return here.square, 0.0, here
        ahead = self.knots[i + 1]
        slope = (ahead.square - here.square) / (ahead.clock - here.clock)
        return here.square + (clock - here.clock) * slope, slope, ahead if slope < 0.0 else here

    def free_until(self, margin: float) -> float:
        """Clock until which the known horizon lets the object go on at full rate, less a margin [s]."""
        clock = -np.inf
        for knot in self.knots:
            if knot.square < 1.0:
                return clock - margin
            clock = knot.clock
        return np.inf if self.complete else clock - margin
