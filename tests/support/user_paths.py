"""Paths as users write them: poses and twists of another path, and little else known of them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp import ObjectPath
from coopqp.spatial import Array


class Opaque(ObjectPath):
    """A path that is known by its poses and twists alone.

    Args:
        path: whose poses.
        known_ahead: whether it may be asked ahead of the clock.
    """

    def __init__(self, path: ObjectPath, *, known_ahead: bool = True) -> None:
        self._path, self.duration, self.known_ahead = path, path.duration, known_ahead

    def pose(self, clock: float) -> pin.SE3:
        return self._path.pose(clock)

    def twist(self, clock: float) -> Array:
        return self._path.twist(clock)


class Marked(Opaque):
    """It tells its corners, and one mark more where one might be.

    Args:
        path: whose poses and corners.
        known_ahead: whether it may be asked ahead of the clock.
        mark: clock of the mark [s]; none by default.
    """

    def __init__(self, path: ObjectPath, *, known_ahead: bool = True, mark: float = np.inf) -> None:
        super().__init__(path, known_ahead=known_ahead)
        self._mark = mark

    def next_breakpoint(self, clock: float) -> float:
        corner = self._path.next_breakpoint(clock)
        return min(corner, self._mark) if clock < self._mark else corner


class OnlyMarked(Opaque):
    """It tells the clocks of its marks [s], and no corners.

    Args:
        path: whose poses.
        marks: clocks at which there may be a corner [s].
    """

    def __init__(self, path: ObjectPath, *marks: float) -> None:
        super().__init__(path)
        self._marks = marks

    def next_breakpoint(self, clock: float) -> float:
        return min((mark for mark in self._marks if mark > clock), default=self.duration)


class Jumping(Opaque):
    """A path that jumps, and says nothing of it.

    Args:
        path: whose poses.
        at: clock of the jump [s].
        by: how far, in the world frame (3,) [m].
    """

    def __init__(self, path: ObjectPath, at: float, by: Array) -> None:
        super().__init__(path)
        self._at, self._by = at, by

    def pose(self, clock: float) -> pin.SE3:
        pose = self._path.pose(clock)
        return pin.SE3(pose.rotation, pose.translation + (clock >= self._at) * self._by)
