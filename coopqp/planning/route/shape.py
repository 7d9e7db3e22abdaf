"""The shape of a way: straight lines with rounded corners, moved about where that makes the motion faster."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.collision.edges import Edges, Samples
from coopqp.core._core import TURN_LENGTH
from coopqp.model.joint_limits import JointLimits
from coopqp.paths.geometry import PathGeometry
from coopqp.planning.route.duration import estimated_duration
from coopqp.planning.route.sampling import rounded
from coopqp.planning.route.tree import Node, Pose, distance, part_of
from coopqp.spatial import Array

#: Largest deviation at a corner [m], with an angle of it over 0.3 m; a corner with less than the least is not rounded.
WIDEST, _LEAST = 0.3, 1e-3
#: Twists of the same direction within this make no corner.
_STRAIGHT = 1e-6
#: Size of changes that are tried [m]: the smallest, the first and the largest; it grows and shrinks by these factors.
_SIZES, _UP, _DOWN = (0.01, 0.06, 0.15), 1.5, 0.9
#: Share of the changes that leave a corner out, and of those that move the corners beside one, too, by a share of it.
_LEFT_OUT, _TOGETHER, _BESIDE = 0.1, 0.5, 0.5
#: A corner is left out where that costs less than this share of the duration.
_WORTH_A_CORNER = 0.01


class Shape(NamedTuple):
    """Lines between poses, with rounded corners, that are free.

    Attributes:
        poses: of both ends and of the corners between them.
        deviations: largest deviation at each corner [m].
        start: where the arms start.
        s: of samples along it (K,) [m].
        rows: the object's pose there, rows of R (9), p (3): (K, 12).
        positions: joint positions there (K, nv) [rad or m].
        rooms: lower bounds of distance less what is required (K, P) [m].
        duration: about how long the motion takes [s].
    """

    poses: tuple[Pose, ...]
    deviations: Array
    start: Node
    s: Array
    rows: Array
    positions: Array
    rooms: Array
    duration: float

    def geometry(self) -> PathGeometry:
        """Its lines and blends."""
        return rounded(self.poses, self.deviations)


def corners_of(way: Sequence[Node]) -> tuple[Pose, ...]:
    """Both ends of a way, and its corners: nodes on a straight line are left out."""
    poses = [way[0].pose]
    last = way[0].pose
    for node in way[1:]:
        if distance(last, node.pose) <= _STRAIGHT:
            continue
        if last is not poses[-1] and _bends(poses[-1], last, node.pose):
            poses.append(last)
        last = node.pose
    return (*poses, way[-1].pose)


def _bends(a: Pose, b: Pose, c: Pose) -> bool:
    """Whether b is off the straight edge from a to c."""
    first, second = distance(a, b), distance(b, c)
    return distance(part_of(a, c, first / (first + second)), b) > _STRAIGHT


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Shaper:
    """Shapes of ways.

    Attributes:
        edges: walks of the arms.
        limits: of the joints.
        speed: of the object at the start [m/s], along the first line.
        fixed: poses at the start, besides the first, that no change moves.
    """

    edges: Edges
    limits: JointLimits
    speed: float = 0.0
    fixed: int = 0

    def shaped(self, start: Node, poses: Sequence[Pose], widest: float) -> Shape | None:
        """Lines between poses with corners rounded off as far as it is free; None if even the lines are not.

        Args:
            start: where the arms start.
            poses: both ends, and the corners.
            widest: largest deviation at a corner [m]. Where the way stops, that of the nearest corner is halved.
        """
        deviations = np.full(len(poses) - 2, widest)
        corners = np.array([pose.p for pose in poses[1:-1]])
        while True:
            shape = self._free(start, poses, deviations)
            if isinstance(shape, Shape) or not deviations.any():
                return shape if isinstance(shape, Shape) else None
            open_ = np.flatnonzero(deviations > 0.0)
            k = open_[int(np.linalg.norm(corners[open_] - shape.p, axis=1).argmin())]
            deviations[k] = 0.5 * deviations[k] if deviations[k] > _LEAST else 0.0

    def faster(self, shape: Shape, rng: np.random.Generator, until: float, *, changes: int) -> Shape:
        """A shape whose motion takes less time: corners are moved about, left out, or rounded off more.

        A change that gains is made again, and the next ones are larger; those behind one that does not are smaller.

        Args:
            shape: where it begins.
            rng: random numbers.
            until: :func:`time.perf_counter` when no more is tried [s].
            changes: that are tried.
        """
        first = self.fixed + 1
        for k in range(len(shape.poses) - 2, first - 1, -1):
            if time.perf_counter() < until:
                others = shape.poses[:k] + shape.poses[k + 1 :]
                most = (1.0 + _WORTH_A_CORNER) * shape.duration
                shape = self._changed(shape, others, np.delete(shape.deviations, k - 1), most) or shape
        size = _SIZES[1]
        again: _Change | None = None
        for _ in range(changes):
            if len(shape.poses) < first + 2 or time.perf_counter() >= until:
                break
            poses, deviations = list(shape.poses), shape.deviations.copy()
            corners = range(first, len(poses) - 1)
            change = again or _random_change(rng, corners, size)
            k = change.corner
            if again is None and rng.random() < _LEFT_OUT:
                del poses[k]
                deviations = np.delete(deviations, k - 1)
            else:
                for i, share in ((k - 1, change.beside), (k, 1.0), (k + 1, change.beside)):
                    if i in corners and share > 0.0:
                        turned = poses[i].R @ np.asarray(pin.exp3(share * change.turn))
                        poses[i] = Pose(poses[i].p + share * change.move, turned)
                deviations[k - 1] = min(max(2.0 * deviations[k - 1], _LEAST), WIDEST)
                again = change
            changed = self._changed(shape, poses, deviations, shape.duration)
            if changed is not None:
                shape, size = changed, min(_UP * size, _SIZES[2])
            else:
                size, again = max(_DOWN * size, _SIZES[0]), None
        return shape

    def _free(self, start: Node, poses: Sequence[Pose], deviations: Array) -> Shape | Pose:
        """The shape; where it is not free, the pose that it is free to."""
        s, rows, motion = self._samples(poses, deviations)
        found = self.edges.walk(rows, motion, start.x, start.rooms)
        if len(found.positions) < len(rows):
            return Pose.of_row(rows[len(found.positions) - 1])
        duration = estimated_duration(self.limits, s, found.positions, speed=self.speed)
        return Shape(tuple(poses), deviations.copy(), start, s, rows, found.positions, found.rooms, duration)

    def _changed(self, known: Shape, poses: Sequence[Pose], deviations: Array, most: float) -> Shape | None:
        """What a shape becomes by a change; None if it is not free or its motion takes no less than ``most`` [s].

        It is free as far as it is the known one. What costs least goes first: the object alone, as most changes end in
        that, then the arms, then all distances.
        """
        s, rows, motion = self._samples(poses, deviations)
        i = _last_alike(known.rows, rows)
        ahead, way, x, rooms = rows[i:], motion[i:], known.positions[i], known.rooms[i]
        if self.edges.object_along(ahead, way, rooms) < len(ahead):
            return None
        followed = self.edges.arms_along(ahead, x)
        positions = np.vstack([known.positions[:i], followed])
        if len(positions) < len(rows):
            return None
        duration = estimated_duration(self.limits, s, positions, speed=self.speed)
        if not duration < most or len((found := self.edges.walk(ahead, way, x, rooms)).positions) < len(ahead):
            return None
        rooms = np.vstack([known.rooms[:i], found.rooms])
        return Shape(tuple(poses), deviations, known.start, s, rows, positions, rooms, duration)

    def _samples(self, poses: Sequence[Pose], deviations: Array) -> Samples:
        return self.edges.samples(np.array([pose.row() for pose in poses]), deviations)


def _last_alike(a: Array, b: Array) -> int:
    """The last of the poses (K, 12) from the first one on that two ways share."""
    size = min(len(a), len(b))
    differ = np.flatnonzero((a[:size] != b[:size]).any(axis=1))
    return max(int(differ[0]) - 1, 0) if len(differ) else size - 1


class _Change(NamedTuple):
    """A corner that is moved: its displacement (3,) [m] and turn (3,) [rad], of which those beside it make a share."""

    corner: int
    move: Array
    turn: Array
    beside: float


def _random_change(rng: np.random.Generator, corners: Sequence[int], size: float) -> _Change:
    """A change of about this size [m]."""
    corner = corners[int(rng.integers(len(corners)))]
    beside = _BESIDE if rng.random() < _TOGETHER else 0.0
    return _Change(corner, size * rng.normal(size=3), size / TURN_LENGTH * rng.normal(size=3), beside)
