"""The shape of a way: straight lines with rounded corners, moved about where that makes the motion faster."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.model.joint_limits import JointLimits
from coopqp.native.constants import TURN_LENGTH
from coopqp.paths.geometry import PathGeometry, Straight, blended
from coopqp.planning.route.duration import estimated_duration
from coopqp.planning.route.edges import Edges
from coopqp.planning.route.sampling import samples_of
from coopqp.planning.route.tree import Node, Pose, between, distance, length_of, part_of
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
        geometry: what follows from them.
        start: where the arms start.
        s: of samples along it (K,) [m].
        rows: the object's pose there, rows of R (9), p (3): (K, 12).
        positions: joint positions there (K, nv) [rad or m].
        rooms: lower bounds of distance less what is required (K, P) [m].
        duration: about how long the motion takes [s].
    """

    poses: tuple[Pose, ...]
    deviations: Array
    geometry: PathGeometry
    start: Node
    s: Array
    rows: Array
    positions: Array
    rooms: Array
    duration: float


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


def lines_between(poses: Sequence[Pose]) -> list[Straight]:
    """Straight lines from each pose to the next."""
    lines = []
    for a, b in itertools.pairwise(poses):
        way, turn = between(a, b)
        lines.append(Straight(a.R, a.p, turn, way, length_of(way, turn)))
    return lines


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
            changes: that are tried; fewer with slow edges.
        """
        first = self.fixed + 1
        for k in range(len(shape.poses) - 2, first - 1, -1):
            if time.perf_counter() < until:
                others = shape.poses[:k] + shape.poses[k + 1 :]
                fewer = self._free(shape.start, others, np.delete(shape.deviations, k - 1), known=shape)
                if isinstance(fewer, Shape) and fewer.duration < (1.0 + _WORTH_A_CORNER) * shape.duration:
                    shape = fewer
        size = _SIZES[1]
        again: _Change | None = None
        for _ in range(math.ceil(self.edges.effort * changes)):
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
            changed = self._free(shape.start, poses, deviations, known=shape)
            if isinstance(changed, Shape) and changed.duration < shape.duration:
                shape, size = changed, min(_UP * size, _SIZES[2])
            else:
                size, again = max(_DOWN * size, _SIZES[0]), None
        return shape

    def _free(
        self, start: Node, poses: Sequence[Pose], deviations: Array, *, known: Shape | None = None
    ) -> Shape | Pose:
        """The shape; where it is not free, the pose that it is free to. It is free as far as it is a known one's."""
        geometry = blended(lines_between(poses), distance=deviations, angle=deviations / TURN_LENGTH)
        s, rows, motion = samples_of(geometry)
        i = 0 if known is None else _last_alike(known.rows, rows)
        x, room = (start.x, start.rooms) if known is None else (known.positions[i], known.rooms[i])
        found = self.edges.walk(rows[i:], motion[i:], x, room)
        last = i + len(found.positions) - 1
        if last < len(rows) - 1:
            return Pose.of_row(rows[last])
        positions, rooms = found.positions, found.rooms
        if known is not None:
            positions, rooms = np.vstack([known.positions[:i], positions]), np.vstack([known.rooms[:i], rooms])
        duration = estimated_duration(self.limits, s, positions, speed=self.speed)
        return Shape(tuple(poses), deviations.copy(), geometry, start, s, rows, positions, rooms, duration)


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
