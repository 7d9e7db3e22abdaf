"""A path that goes over to a shifted one."""

from __future__ import annotations

import math
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.core._core import SHIFT, TURN_LENGTH
from coopqp.errors import InvalidInputError
from coopqp.paths.path import ObjectPath
from coopqp.paths.section import Section
from coopqp.paths.time_law import TimeLaw
from coopqp.spatial import Array, Placement, as_placement

#: A length along a path is measured in pieces of at most this share of it; each takes at least one of so many parts of
#: the time that is left, and at most one of so few.
_PIECE, _SAMPLES, _FEWEST = 0.125, 400, 50
#: An endless path is looked at so far ahead [s].
_FURTHEST = 60.0


@final
class ShiftedPath(ObjectPath):
    """A path up to a clock, then more and more ``T_world_shift · path``: wholly from a later clock on.

    ``T(τ) = exp(w(τ) log T_world_shift) · path(τ)``, with the quintic w from 0 to 1 between the two clocks.

    Args:
        path: the path so far.
        T_world_shift: the shift, in the world.
        begin, end: clocks between which it comes in [s].

    Raises:
        InvalidInputError: no placement, or clocks that do not rise.
    """

    def __init__(self, path: ObjectPath, T_world_shift: Placement, *, begin: float, end: float) -> None:
        self.path = path
        self.shift = as_placement(T_world_shift, "ShiftedPath: T_world_shift")
        self.begin = as_scalar(begin, "ShiftedPath: begin", open_low=False)
        self.end = as_scalar(end, "ShiftedPath: end")
        if not self.end > self.begin:
            raise InvalidInputError("it ends before it begins", "ShiftedPath", "Give clocks that rise.")
        self.duration, self.known_ahead = path.duration, path.known_ahead
        self.planned_share, self.elbows, self.grasps = path.planned_share, path.elbows, path.grasps
        self.gates, self.signals = path.gates, dict(path.signals)
        #: The shift's logarithm (6,).
        self._log = np.asarray(pin.log6(self.shift).vector)

    def _share(self, clock: float) -> tuple[float, float]:
        span = self.end - self.begin
        x = (clock - self.begin) / span
        return TimeLaw.QUINTIC.value_at(x), TimeLaw.QUINTIC.slope_at(x) / span

    def next_breakpoint(self, clock: float) -> float:
        """See :meth:`ObjectPath.next_breakpoint`."""
        return self.path.next_breakpoint(clock)

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        return pin.exp6(self._share(clock)[0] * self._log) * self.path.pose(clock)

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]."""
        twist: Array = self.path.twist(clock)
        slope = self._share(clock)[1]
        if slope:
            twist = twist + slope * np.asarray(self.path.pose(clock).actInv(pin.Motion(self._log)).vector)
        return twist


def unshifted(path: ObjectPath) -> tuple[ObjectPath, Array]:
    """A path without its shifts, and their numbers in their order (n, 8), for the compiled core.

    Of a shift: the clocks at which it begins to come in and is in wholly, which fall on a way back [s], and its
    logarithm in the world.
    """
    if type(path) is ShiftedPath:
        base, rows = unshifted(path.path)
        return base, np.vstack([rows, np.concatenate([[path.begin, path.end], path._log])])
    if type(path) is Section:
        base, rows = unshifted(path.path)
        if len(rows):
            rows[:, :2] = path.sense * (rows[:, :2] - path.begin)
            return Section(base, path.begin, path.end, elbows=path.elbows), rows
    return path, np.zeros((0, SHIFT))


def clock_after(path: ObjectPath, clock: float, length: float) -> float:
    """The clock [s] at which a path is ``length`` [m] further than at ``clock``, a turn of 1 rad as 0.3 m; or its end.

    Returns:
        The clock; ``clock`` itself where the path goes no further.
    """
    ends = path.duration if math.isfinite(path.duration) else clock + _FURTHEST
    least, most = (ends - clock) / _SAMPLES, (ends - clock) / _FEWEST
    span, way, at, moving = least, 0.0, clock, clock
    here = path.pose(at)
    while at < ends:
        ahead = min(at + span, ends)
        there = path.pose(ahead)
        moved = _way_between(here, there)
        if moved > _PIECE * length and span > least:
            span = max(0.5 * span, least)
            continue
        if way + moved >= length:
            return at + (length - way) / moved * (ahead - at)
        if moved < 0.5 * _PIECE * length:
            span = min(2.0 * span, most)
        moving = ahead if moved > 1e-12 else moving
        at, here, way = ahead, there, way + moved
    return moving


def _way_between(a: pin.SE3, b: pin.SE3) -> float:
    """Length of the straight way between two poses [m], a turn of 1 rad as 0.3 m."""
    v = pin.log6(a.actInv(b))
    (x, y, z), (p, q, r) = v.linear.tolist(), v.angular.tolist()
    return max(math.hypot(x, y, z), TURN_LENGTH * math.hypot(p, q, r))
