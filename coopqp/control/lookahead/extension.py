"""Extension of the horizon: grid points as far on as the chain can be followed, one Newton step at a time.

The extension ends at a position limit, at an impassable singularity, at the end of the reach, where a constraint
allows no rate, and at the path's end. The core's counterpart is ``growth.cpp``.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Generator, Iterator
from typing import final

import numpy as np

from coopqp.control.lookahead.closed_chain import ClosedChainAhead, LookAheadTrouble
from coopqp.control.lookahead.horizon import GridPoint, Horizon
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.model.cell import RobotCell
from coopqp.model.chain import parts
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.native.constants import (
    BESIDE_KINK,
    GROWTH,
    JUST_BEFORE,
    KINK_CELL,
    LONGEST_WAY,
    MOST_KINKS,
    MOST_KNOTS,
    PASSABLE,
    SAME_CLOCK,
)
from coopqp.paths.guarded import GuardedPath


@final
class HorizonExtension:
    """See the module's description.

    Args:
        cell: the cell.
        path: the object's path.
        chain: the chain ahead.
        horizon: takes the knots.
        plan: planning limits.
        options: settings.

    Attributes:
        begin_at: clock from which on the next knot is begun, before it is needed.
        done: pieces of work of the knot that is under way, each a Newton step or a look for jumps; 0 if none is.
        jump: the clock at which the path jumps, where that is the end [s], and by how far [m]; None if it does not.
        trouble: why the latest Newton step failed; empty if it did not.
    """

    def __init__(
        self,
        cell: RobotCell,
        path: GuardedPath,
        chain: ClosedChainAhead,
        horizon: Horizon,
        plan: PlanLimits,
        options: PreviewOptions,
    ) -> None:
        self._cell, self._path, self._chain, self._horizon = cell, path, chain, horizon
        self._plan, self._options, self._duration = plan, options, path.duration
        self._low, self._high = cell.limits.lower, cell.limits.upper
        self.breakpoints = list[float]()
        self._kinks, self._kinks_kept = list[float](), list[float]()
        self._way = list[GridPoint]()  # past a singularity, while it is looked for
        self.trouble = ""
        self.jump: tuple[float, float] | None = None
        self.rest()

    def begin(self, breakpoints: list[float]) -> None:
        """Begin along a path after a first knot, with the clocks at which the path declares jumps of its twist."""
        self.rest()
        self.breakpoints = breakpoints
        self._kinks, self._kinks_kept, self.jump = [], [], None

    def memory(self) -> tuple[list[float], list[float], float, int, tuple[float, float] | None]:
        """State for a copy: as before the knot under way, with the number of its Newton steps."""
        kinks = self._kinks if self._growing is None else self._kinks_kept
        return list(self.breakpoints), list(kinks), self.begin_at, self.done, self.jump

    def restore(self, memory: tuple[list[float], list[float], float, int, tuple[float, float] | None]) -> None:
        """Go on from what :meth:`memory` returned; growth that was under way is done again up to there."""
        breakpoints, kinks, begin_at, done, self.jump = memory
        jump = self.jump
        self.begin(list(breakpoints))
        self._kinks, self.jump = list(kinks), jump
        for _ in range(done):
            self.step()
        self.begin_at = begin_at

    def rest(self) -> None:
        """No knot is under way."""
        self._growing: Iterator[None] | None = None
        self._way.clear()
        self.done, self.begin_at = 0, np.inf

    @property
    def under_way(self) -> bool:
        """Whether a knot has been begun."""
        return self._growing is not None

    def step(self) -> bool:
        """One piece of work: a control step need not make a whole knot. False where growth has to wait."""
        self.trouble = ""
        if len(self._horizon.knots) + len(self._way) + 2 > MOST_KNOTS:
            return False
        try:
            if self._growing is None:
                self._kinks_kept = list(self._kinks)
                self._growing = self._grow(self._horizon.knots[-1])
                next(self._growing)  # up to its first piece
            self.done += 1
            next(self._growing)
        except StopIteration:
            self.rest()
        except LookAheadTrouble as trouble:  # the next step tries again
            self.trouble = str(trouble)
            self.rest()
            return False
        return True

    def _grow(self, last: GridPoint) -> Iterator[None]:
        """Add a knot; pauses before every piece of work."""
        if self._duration - last.clock <= 1e-12:
            end = self._chain.at_end(last)
            if end is not None:
                self._horizon.push(end)
            self._horizon.finish()
            return
        knot = yield from self._next(last)
        if self._chain.no_horizon:
            return
        if knot is None and self._half_way(last) < 2.0 * self._options.shortest:
            self._horizon.push(last._replace(cap=0.0, span=0.0, binding=self._chain.beyond))
            return
        if knot is None:
            self._horizon.push(last._replace(cap=0.0, span=0.0, binding=self._why_no_further(last)))
            return
        crossing = None if knot.inside else self._limit_crossing(last, knot)
        if crossing is not None:
            self._horizon.push(crossing)
            return
        way = [knot]
        if knot.uncapped < self._options.singular_rate**2 and knot.fastest > last.fastest:
            way = yield from self._past(knot)
            if not way:
                # If the last knot is singular, too, the object stays: else it would creep on with every new path.
                stop = last._replace(span=0.0) if last.uncapped < self._options.singular_rate**2 else knot
                self._horizon.push(stop._replace(cap=0.0, binding=self._arm_limit(knot, LimitKind.SINGULARITY)))
                return
        breakpoint_ = self.next_breakpoint(last.clock)
        if abs(way[-1].clock - breakpoint_) < SAME_CLOCK and breakpoint_ < self._duration:
            way[-1] = self._chain.corner(way[-1])
        for knot in way:
            self._horizon.push(knot)

    def _next(self, last: GridPoint) -> Generator[None, None, GridPoint | None]:
        """The knot after ``last``, as far on as the chain can be followed in one go; None where it cannot."""
        options = self._options
        h = min(options.cell, self._duration - last.clock)
        if last.fastest > 0.0:
            h = min(h, options.joint_step / last.fastest)
        if last.span > 0.0 and not last.corner:
            h = min(h, GROWTH * last.span)
        breakpoint_ = self.next_breakpoint(last.clock)
        if last.clock + h > breakpoint_ - 1e-9:
            h = breakpoint_ - last.clock
        half_way = self._half_way(last)
        if half_way < options.shortest:
            return None
        h, sought = min(h, half_way), False
        while True:
            knot = yield from self._chain.attempt(last, h)
            if knot is None and self._path.own and h <= KINK_CELL and not (self._way or self._chain.no_horizon):
                yield
                self.jump = yield from self._path.jumps(last.clock, last.clock + h)
                if self.jump is not None:
                    return None
                kink = None
                if not sought:
                    yield
                    sought, kink = True, (yield from self._kink(last.clock, h))
                if self.jump is not None:
                    return None
                if kink is not None and kink <= last.clock + SAME_CLOCK:
                    return self._chain.corner(last)._replace(span=0.0)
                if kink is not None:
                    h = kink - last.clock
                    continue
            h *= 0.5
            if knot is not None or h < options.shortest or self._chain.no_horizon:
                return knot

    def _kink(self, clock: float, h: float) -> Generator[None, None, float | None]:
        """Where a user's twist jumps within ``h`` after a knot, undeclared [s]: a breakpoint from now on.

        Unless the path jumps with it.
        """
        kink = yield from self._path.kinks(max(clock - JUST_BEFORE, 0.0), clock + h)
        if kink is not None:
            yield
            self.jump = yield from self._path.jumps(kink - BESIDE_KINK, kink + BESIDE_KINK)
        if kink is not None and self.jump is None:
            self._kinks = [*self._kinks[1 - MOST_KINKS :], kink]
        return kink

    def _half_way(self, last: GridPoint) -> float:
        """Half of the time from a knot to the clock at which a constraint allows no rate [s]."""
        return 0.5 * (self._chain.beyond_at - last.clock)

    def _past(self, knot: GridPoint) -> Generator[None, None, list[GridPoint]]:
        """The knots from ``knot``, near a singularity, to where the joints slow down; none if there is no way."""
        least = (PASSABLE * self._options.singular_rate) ** 2
        end = self.next_breakpoint(knot.clock) - 1e-9
        way = self._way
        way.append(knot)
        while len(way) < LONGEST_WAY and way[-1].clock < end:
            ahead = yield from self._next(way[-1])
            if ahead is None or not ahead.inside or ahead.uncapped < least or ahead.clock > end:
                return []
            way.append(ahead)
            if ahead.fastest < way[-2].fastest:
                return list(way)
        return []

    def next_breakpoint(self, clock: float) -> float:
        """First clock after ``clock`` at which the twist jumps, the end at the latest [s]."""
        after = self._duration
        for clocks in (self.breakpoints, self._kinks):
            i = bisect_right(clocks, clock + SAME_CLOCK)
            after = min(after, clocks[i]) if i < len(clocks) else after
        return after

    def _limit_crossing(self, last: GridPoint, knot: GridPoint) -> GridPoint | None:
        """Where the first joint meets a position limit between two knots, as a knot at which the object rests."""
        x, ahead = self._cell.positions(last.q), self._cell.positions(knot.q)
        # A joint outside may come back in; only going further out is the end.
        over = (ahead > np.maximum(self._high, x)) & (ahead > self._high)
        under = (ahead < np.minimum(self._low, x)) & (ahead < self._low)
        crossed = np.flatnonzero(over | under)
        if not crossed.size:
            return None
        limit = np.where(over[crossed], self._high[crossed], self._low[crossed])
        shares = np.clip((limit - x[crossed]) / (ahead[crossed] - x[crossed]), 0.0, 1.0)
        first = int(shares.argmin())
        j = int(crossed[first])
        at = self._knot_where(last, knot, j, float(limit[first]))
        return at._replace(cap=0.0, span=at.clock - last.clock, binding=self._cell.joint_limit(j, LimitKind.POSITION))

    def _knot_where(self, last: GridPoint, beyond: GridPoint, j: int, position: float) -> GridPoint:
        """The knot at which joint ``j`` is at ``position``, between two knots: regula falsi on the chain itself."""
        positions = self._cell.positions
        start, end = last.clock, beyond.clock
        miss_start, miss_end = (positions(k.q)[j] - position for k in (last, beyond))
        if miss_start * miss_end >= 0.0:
            return last  # it is there already
        best = beyond
        for _ in range(8):
            clock = start - miss_start * (end - start) / (miss_end - miss_start)
            knot = _whole(self._chain.attempt(last, clock - last.clock)) if clock - last.clock > 1e-9 else last
            if knot is None:
                break
            best, miss = knot, float(positions(knot.q)[j] - position)
            if abs(miss) < 1e-9:
                break
            if miss * miss_end > 0.0:
                end, miss_end = clock, miss
            else:
                start, miss_start = clock, miss
        return best

    def _why_no_further(self, last: GridPoint) -> BindingLimit:
        """Why the chain cannot be followed past a knot: a user's path jumps there, or an arm's reach ends."""
        if self.jump is not None:
            return BindingLimit("", "", LimitKind.PATH_JUMP)
        if last.steps_to_reach_end.min() < 2.0:
            part = parts(self._cell)[int(last.steps_to_reach_end.argmin())]
            return BindingLimit(self._cell.arm_names[part[0]], "", LimitKind.REACH)
        return self._arm_limit(last, LimitKind.REACH)

    def _arm_limit(self, knot: GridPoint, kind: LimitKind) -> BindingLimit:
        """A limit of the arm whose joints are fastest at a knot."""
        share = np.abs(knot.slope) / np.where(np.isfinite(self._plan.speed), self._plan.speed, 1.0)
        return BindingLimit(self._cell.arm_names[self._cell.arm_of_joint(int(share.argmax()))], "", kind)


def _whole(pieces: Generator[None, None, GridPoint | None]) -> GridPoint | None:
    """The result of work that pauses, without the pauses."""
    while True:
        try:
            next(pieces)
        except StopIteration as done:
            knot: GridPoint | None = done.value
            return knot
