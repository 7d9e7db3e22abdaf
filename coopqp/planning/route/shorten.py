"""A way made shorter, and its corners rounded off."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence

import numpy as np

from coopqp.native.constants import TURN_LENGTH
from coopqp.paths.geometry import PathGeometry, Straight, blended
from coopqp.planning.route.edges import Edges
from coopqp.planning.route.tree import STEP, Node, Pose, between, distance, length_of, part_of, straight
from coopqp.spatial import Array

#: Shortcuts that are tried, and tries in a row without a gain after which no more are.
_TRIES, _IN_VAIN = 400, 60
#: A shortcut gains at least this share of the length.
_GAIN = 1e-3
#: Joint positions that differ by less are the same [rad or m].
_SAME = 1e-6
#: A corner with less deviation is not rounded off [m].
_LEAST_DEVIATION = 1e-3
#: Twists of the same direction within this make no corner.
_STRAIGHT = 1e-6


def length_along(way: Sequence[Node]) -> float:
    """Length of a way [m]."""
    return sum(distance(a.pose, b.pose) for a, b in itertools.pairwise(way))


def shortened(edges: Edges, way: list[Node], rng: np.random.Generator, until: float) -> list[Node]:
    """A shorter way between the same ends: first to the farthest node that is seen, then between random points.

    Args:
        edges: walks of the arms.
        way: nodes from the start to the goal.
        rng: random numbers.
        until: :func:`time.perf_counter` when no more is tried [s].
    """
    way = _farthest_first(edges, way, until)
    in_vain = 0
    for _ in range(_TRIES):
        if in_vain >= _IN_VAIN or len(way) < 3 or time.perf_counter() >= until:
            break
        better = _between_random_points(edges, way, rng)
        in_vain = 0 if better else in_vain + 1
        way = better or way
    return way


def _farthest_first(edges: Edges, way: list[Node], until: float) -> list[Node]:
    """From each corner straight to the farthest node that is free."""
    i = 0
    while i < len(way) - 2 and time.perf_counter() < until:
        marks = np.cumsum([0.0, *(distance(a.pose, b.pose) for a, b in itertools.pairwise(way))])
        for j in range(len(way) - 1, i + 1, -1):
            if distance(way[i].pose, way[j].pose) > (1.0 - _GAIN) * (marks[j] - marks[i]):
                continue
            rest = len(way) - j
            better = _replaced(edges, way, i, way[i].pose, j, way[j].pose)
            if better:
                way = better
                i = len(way) - rest - 1
                break
        i += 1
    return way


def _between_random_points(edges: Edges, way: list[Node], rng: np.random.Generator) -> list[Node] | None:
    lengths = np.array([distance(a.pose, b.pose) for a, b in itertools.pairwise(way)])
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    low, high = np.sort(rng.uniform(0.0, marks[-1], 2))
    i, j = (int(np.clip(np.searchsorted(marks, s, side="right") - 1, 0, len(lengths) - 1)) for s in (low, high))
    if i == j:
        return None
    a, b = (part_of(way[k].pose, way[k + 1].pose, float((s - marks[k]) / lengths[k])) for k, s in ((i, low), (j, high)))
    if distance(a, b) > high - low - _GAIN * marks[-1]:
        return None
    return _replaced(edges, way, i, a, j, b)


def _replaced(edges: Edges, way: list[Node], i: int, a: Pose, j: int, b: Pose) -> list[Node] | None:
    """The way with a straight edge from pose a, behind node i, to pose b, behind node j; None if it is not free."""
    new = way[: i + 1]
    for pose in (a, b):
        edge = straight(edges, new[-1], pose)
        if not edge.complete:
            return None
        new = new + edge.nodes
    rest = way[j + 1 :]
    for k, node in enumerate(rest):
        edge = straight(edges, new[-1], node.pose)
        if not edge.complete:
            return None
        new = new + edge.nodes
        if np.abs(new[-1].x - node.x).max() < _SAME:
            return new + rest[k + 1 :]
    return new


def lines_of(way: Sequence[Node]) -> list[Straight]:
    """Straight lines along a way: nodes on a line are left out."""
    lines: list[Straight] = []
    corner, last = way[0].pose, way[0].pose
    for node in way[1:]:
        if distance(last, node.pose) <= 1e-9:
            continue
        if last is not corner and _bends(corner, last, node.pose):
            lines.append(_line(corner, last))
            corner = last
        last = node.pose
    if last is not corner:
        lines.append(_line(corner, last))
    return lines


def _bends(a: Pose, b: Pose, c: Pose) -> bool:
    """Whether b is off the straight edge from a to c."""
    share = distance(a, b) / max(distance(a, b) + distance(b, c), 1e-12)
    return distance(part_of(a, c, share), b) > _STRAIGHT


def _line(a: Pose, b: Pose) -> Straight:
    way, turn = between(a, b)
    return Straight(a.R, a.p, turn, way, length_of(way, turn))


def rounded(edges: Edges, start: Node, lines: Sequence[Straight], deviation: float) -> PathGeometry:
    """Lines with corners rounded off as far as it is free.

    Args:
        edges: walks of the arms.
        start: where they start.
        lines: the lines.
        deviation: largest deviation at a corner [m], and over 0.3 m its angle. Where the way stops, that of the nearest
            corner is halved.
    """
    limits = np.full(max(len(lines) - 1, 0), deviation)
    corners = np.array([line.p + line.way for line in lines[:-1]])
    while True:
        geometry = blended(lines, distance=limits, angle=limits / TURN_LENGTH)
        nodes, complete = along(edges, start, geometry)
        if complete or not limits.any():
            return geometry
        open_ = np.flatnonzero(limits > 0.0)
        k = open_[int(np.linalg.norm(corners[open_] - nodes[-1].pose.p, axis=1).argmin())]
        limits[k] = 0.5 * limits[k] if limits[k] > _LEAST_DEVIATION else 0.0


def along(edges: Edges, start: Node, geometry: PathGeometry) -> tuple[list[Node], bool]:
    """Nodes along a geometry as far as it is free, and whether all of it is."""
    rows: list[Array] = []
    motion: list[Array] = []
    for piece in geometry.pieces:
        count = max(math.ceil(piece.length / STEP), 4)
        s = np.linspace(0.0, piece.length, count + 1)
        R, p = piece.poses(s)
        bounds = piece.bounds(s[:-1], s[1:])
        assert bounds is not None
        motion.append(np.column_stack([bounds.way, bounds.turn]) * np.diff(s)[:, None])
        rows.append(np.hstack([R.reshape(-1, 9), p])[0 if not rows else 1 :])
    poses = np.ascontiguousarray(np.vstack(rows))
    found = edges.walk(poses, np.ascontiguousarray(np.vstack(motion)), start.x, start.rooms)
    nodes = [
        Node(Pose(row[9:], row[:9].reshape(3, 3)), x, rooms)
        for row, x, rooms in zip(poses, found.positions, found.rooms, strict=False)
    ]
    return nodes, len(nodes) == len(poses)
