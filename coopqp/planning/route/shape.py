"""The shape of a way: straight lines with rounded corners, moved about where that makes the motion faster."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.model.joint_limits import JointLimits
from coopqp.native.constants import TURN_LENGTH
from coopqp.paths.geometry import PathGeometry, Straight, blended
from coopqp.planning.route.duration import estimated_duration
from coopqp.planning.route.edges import Edges
from coopqp.planning.route.tree import STEP, Node, Pose, between, distance, length_of, part_of
from coopqp.spatial import Array

#: Largest deviation at a corner [m], with an angle of it over 0.3 m; a corner with less than the least is not rounded.
WIDEST, _LEAST = 0.3, 1e-3
#: Twists of the same direction within this make no corner.
_STRAIGHT = 1e-6
#: Changes of a shape that are tried, and their size [m], from the first to the last.
_CHANGES, _SIZES = 100, (0.1, 0.01)
#: Share of the changes that leave a corner out.
_LEFT_OUT = 0.1
#: A corner is left out where that costs less than this share of the duration.
_WORTH_A_CORNER = 0.01


class Shape(NamedTuple):
    """Lines between poses, with rounded corners, that are free.

    Attributes:
        poses: of both ends and of the corners between them.
        deviations: largest deviation at each corner [m].
        geometry: what follows from them.
        nodes: the arms along it.
        duration: about how long the motion takes [s].
    """

    poses: tuple[Pose, ...]
    deviations: Array
    geometry: PathGeometry
    nodes: list[Node]
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


def _lines(poses: Sequence[Pose]) -> list[Straight]:
    lines = []
    for a, b in itertools.pairwise(poses):
        way, turn = between(a, b)
        lines.append(Straight(a.R, a.p, turn, way, length_of(way, turn)))
    return lines


def shaped(edges: Edges, limits: JointLimits, start: Node, poses: Sequence[Pose], widest: float) -> Shape | None:
    """Lines between poses with corners rounded off as far as it is free; None if even the lines are not.

    Args:
        edges: walks of the arms.
        limits: of the joints.
        start: where the arms start.
        poses: both ends, and the corners.
        widest: largest deviation at a corner [m]. Where the way stops, that of the nearest corner is halved.
    """
    deviations = np.full(len(poses) - 2, widest)
    corners = np.array([pose.p for pose in poses[1:-1]])
    while True:
        shape = _free(edges, limits, start, poses, deviations)
        if isinstance(shape, Shape) or not deviations.any():
            return shape if isinstance(shape, Shape) else None
        open_ = np.flatnonzero(deviations > 0.0)
        k = open_[int(np.linalg.norm(corners[open_] - shape.p, axis=1).argmin())]
        deviations[k] = 0.5 * deviations[k] if deviations[k] > _LEAST else 0.0


def faster(edges: Edges, limits: JointLimits, shape: Shape, rng: np.random.Generator, until: float) -> Shape:
    """A shape whose motion takes less time: corners are moved about, left out, or rounded off more.

    Args:
        edges: walks of the arms.
        limits: of the joints.
        shape: where it begins.
        rng: random numbers.
        until: :func:`time.perf_counter` when no more is tried [s].
    """
    for k in range(len(shape.poses) - 2, 0, -1):
        if time.perf_counter() < until:
            others = shape.poses[:k] + shape.poses[k + 1 :]
            fewer = _free(edges, limits, shape.nodes[0], others, np.delete(shape.deviations, k - 1))
            if isinstance(fewer, Shape) and fewer.duration < (1.0 + _WORTH_A_CORNER) * shape.duration:
                shape = fewer
    for size in np.geomspace(*_SIZES, math.ceil(edges.effort * _CHANGES)):
        if len(shape.poses) < 3 or time.perf_counter() >= until:
            break
        poses, deviations = list(shape.poses), shape.deviations.copy()
        k = int(rng.integers(1, len(poses) - 1))
        if rng.random() < _LEFT_OUT:
            del poses[k]
            deviations = np.delete(deviations, k - 1)
        else:
            move, turn = size * rng.normal(size=3), size / TURN_LENGTH * rng.normal(size=3)
            poses[k] = Pose(poses[k].p + move, poses[k].R @ np.asarray(pin.exp3(turn)))
            deviations[k - 1] = min(max(2.0 * deviations[k - 1], _LEAST), WIDEST)
        changed = _free(edges, limits, shape.nodes[0], poses, deviations)
        if isinstance(changed, Shape) and changed.duration < shape.duration:
            shape = changed
    return shape


def _free(edges: Edges, limits: JointLimits, start: Node, poses: Sequence[Pose], deviations: Array) -> Shape | Pose:
    """The shape; where it is not free, the pose that it is free to."""
    geometry = blended(_lines(poses), distance=deviations, angle=deviations / TURN_LENGTH)
    rows: list[Array] = []
    motion: list[Array] = []
    marks: list[Array] = []
    for piece, mark in zip(geometry.pieces, geometry.marks, strict=False):
        count = max(math.ceil(piece.length / STEP), 4)
        s = np.linspace(0.0, piece.length, count + 1)
        R, p = piece.poses(s)
        bounds = piece.bounds(s[:-1], s[1:])
        assert bounds is not None
        motion.append(np.column_stack([bounds.way, bounds.turn]) * np.diff(s)[:, None])
        first = 1 if rows else 0
        rows.append(np.hstack([R.reshape(-1, 9), p])[first:])
        marks.append(mark + s[first:])
    every = np.ascontiguousarray(np.vstack(rows))
    found = edges.walk(every, np.ascontiguousarray(np.vstack(motion)), start.x, start.rooms)
    last = len(found.positions) - 1
    if last < len(every) - 1:
        return Pose.of_row(every[last])
    nodes = [Node(Pose.of_row(row), x, room) for row, x, room in zip(every, found.positions, found.rooms, strict=True)]
    duration = estimated_duration(limits, np.concatenate(marks), found.positions)
    return Shape(tuple(poses), deviations.copy(), geometry, nodes, duration)
