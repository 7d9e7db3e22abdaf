"""A part of a path, forwards or backwards."""

from __future__ import annotations

from bisect import bisect_right
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.core._core import SAME_CLOCK, SEGMENT
from coopqp.errors import InvalidInputError
from coopqp.paths.elbows import Elbows
from coopqp.paths.grasp_motion import of_section
from coopqp.paths.path import HoldPath, LinePath, ObjectPath, WaypointPath
from coopqp.paths.timed import TimedPath
from coopqp.spatial import Array

#: Breakpoints that are asked for, at most.
_MOST_BREAKPOINTS = 10_000
#: Paths of segments.
_SEGMENTS = (LinePath, WaypointPath, HoldPath, TimedPath)


@final
class Section(ObjectPath):
    """The part of a path from one clock to another; backwards where it ends before it begins.

    Its own clock u begins at 0: the path's clock is ``begin + u``, or ``begin − u`` backwards. The object rests at both
    ends. A section of a line, of waypoints or of a rest is such numbers as they are, for the compiled core.

    Args:
        path: the whole path.
        begin, end: clocks on it [s].
        elbows: a motion of redundant arms over the section's own clock; None for the path's.
        keeps_clear: whether the arms' motion is known to keep clear of bodies; None: as the path.

    Raises:
        InvalidInputError: clocks that are not on the path, or are the same.
    """

    def __init__(
        self,
        path: ObjectPath,
        begin: float,
        end: float,
        *,
        elbows: Elbows | None = None,
        keeps_clear: bool | None = None,
    ) -> None:
        self.path = path
        self.begin = as_scalar(begin, "Section: begin", open_low=False, high=path.duration)
        self.end = as_scalar(end, "Section: end", open_low=False, high=path.duration)
        if self.begin == self.end:
            raise InvalidInputError("it ends where it begins", "Section", "Give two clocks.")
        #: 1 forwards, −1 backwards.
        self.sense = 1 if self.end > self.begin else -1
        self.duration = abs(self.end - self.begin)
        self.known_ahead, self.planned_share = path.known_ahead, path.planned_share
        self.keeps_clear = path.keeps_clear if keeps_clear is None else keeps_clear
        own = path.elbows
        self.elbows = self._turned(own) if elbows is None and own is not None else elbows
        self.grasps = None if path.grasps is None else path.grasps.section(self.begin, self.end)
        self._marks = breakpoints(path, min(self.begin, self.end), max(self.begin, self.end))
        breaks = [self.sense * (mark - self.begin) for mark in self._marks]
        self._breaks = breaks if self.sense > 0 else breaks[::-1]

    def _turned(self, elbows: Elbows) -> Elbows:
        clocks = self.sense * (elbows.clocks - self.begin)
        return Elbows(*(rows[:: self.sense] for rows in (clocks, elbows.x, self.sense * elbows.slopes)))

    def clock_of(self, u: float) -> float:
        """The path's clock [s] at the section's own clock u [s]."""
        return self.begin + self.sense * min(max(u, 0.0), self.duration)

    def next_breakpoint(self, clock: float) -> float:
        """See :meth:`ObjectPath.next_breakpoint`."""
        i = bisect_right(self._breaks, clock + SAME_CLOCK)
        return self._breaks[i] if i < len(self._breaks) else self.duration

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        return self.path.pose(self.end if clock >= self.duration else self.clock_of(clock))

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]; at a breakpoint the one after it, as this section goes."""
        if clock < 0.0 or clock >= self.duration:
            return np.zeros(6)
        at = self.clock_of(clock)
        if self.sense > 0:
            return self.path.twist(at)
        i = bisect_right(self._marks, at + SAME_CLOCK) - 1
        if i >= 0 and at - self._marks[i] <= SAME_CLOCK:
            at = self._marks[i] - SAME_CLOCK
        elif at >= self.path.duration:
            at = self.path.duration - SAME_CLOCK
        return -self.path.twist(at)

    def packed(self) -> Array | None:
        """See :meth:`ObjectPath.packed`: the segments of the path that the section touches, then one of rest."""
        numbers = self.path.packed() if type(self.path) in _SEGMENTS or self.path.of_segments else None
        if numbers is None:
            return None
        segments = numbers[3 + int(numbers[1]) :].reshape(-1, SEGMENT)
        low, high = min(self.begin, self.end), max(self.begin, self.end)
        touched = segments[(segments[:, 18] < high) & (segments[:, 18] + segments[:, 19] > low)]
        made = of_section(touched, self.begin, self.sense)
        rest = self.pose(self.duration)
        still = LinePath(rest, rest, duration=1.0).segment(self.duration)
        return np.concatenate([[self.duration, len(self._breaks), len(made) + 1], self._breaks, *made, still])


def breakpoints(path: ObjectPath, low: float, high: float) -> list[float]:
    """Clocks between two others at which a path's twist jumps [s]."""
    found: list[float] = []
    clock = low
    while len(found) < _MOST_BREAKPOINTS:
        ahead = float(path.next_breakpoint(clock))
        if not clock < ahead < high - SAME_CLOCK:
            return found
        found.append(ahead)
        clock = ahead
    return found
