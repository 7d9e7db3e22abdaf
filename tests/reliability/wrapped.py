"""Paths of a user: the same poses and twists, and nothing else known."""

from __future__ import annotations

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
