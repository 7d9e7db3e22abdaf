"""A way made shorter: straight from one of its points to another wherever that is free."""

from __future__ import annotations

import itertools
import time

import numpy as np

from coopqp.collision.edges import Edges
from coopqp.planning.route.tree import Node, Pose, distance, part_of, straight

#: Shortcuts that are tried, and tries in a row without a gain after which no more are.
_TRIES, _IN_VAIN = 150, 25
#: A shortcut gains at least this share of the length.
_GAIN = 1e-3
#: Joint positions that differ by less are the same [rad or m].
_SAME = 1e-6


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
