"""A tree of poses that all arms reach, and the straight edges between poses."""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.collision.edges import STEP, Edges, Stop
from coopqp.core._core import TURN_LENGTH
from coopqp.spatial import Array

#: So many steps of an edge, of length STEP, lie between nodes; 1 rad counts as 0.3 m.
NODE_STEPS = 5
#: By so much more than its length an edge may be longer, by rounding.
_ENLARGED = 1e-9


class Pose(NamedTuple):
    """A pose of the object: origin (3,) [m], and rotation (3, 3)."""

    p: Array
    R: Array

    @staticmethod
    def of(T: pin.SE3) -> Pose:
        """From a placement."""
        return Pose(T.translation.copy(), T.rotation.copy())

    @staticmethod
    def of_row(row: Array) -> Pose:
        """From R (9), p (3)."""
        return Pose(row[9:], row[:9].reshape(3, 3))

    def row(self) -> Array:
        """R (9), p (3)."""
        return np.concatenate([self.R.ravel(), self.p])

    def placement(self) -> pin.SE3:
        """As a placement."""
        return pin.SE3(self.R, self.p)


def between(a: Pose, b: Pose) -> tuple[Array, Array]:
    """Displacement (3,) [m] in the world and rotation vector (3,) [rad] in the first frame from one pose to another."""
    return b.p - a.p, np.asarray(pin.log3(a.R.T @ b.R))


def size_of(v: Array) -> float:
    """Length of a vector (3,)."""
    return math.sqrt(v.dot(v))


def length_of(way: Array, turn: Array) -> float:
    """Length of a motion [m]."""
    return math.sqrt(way.dot(way) + TURN_LENGTH**2 * turn.dot(turn))


def distance(a: Pose, b: Pose) -> float:
    """Length of the straight edge between two poses [m]."""
    return length_of(*between(a, b))


def part_of(a: Pose, b: Pose, share: float) -> Pose:
    """The pose at a share of the straight edge."""
    way, turn = between(a, b)
    return Pose(a.p + share * way, a.R @ np.asarray(pin.exp3(share * turn)))


class Node(NamedTuple):
    """A pose with the arms' joint positions (nv,) [rad or m] and the rooms (P,) [m] of all pairs there."""

    pose: Pose
    x: Array
    rooms: Array


class Edge(NamedTuple):
    """The free part of a straight edge: nodes behind its first one, and whether it is all of it."""

    nodes: list[Node]
    complete: bool
    stop: Stop


def straight(edges: Edges, start: Node, goal: Pose) -> Edge:
    """Walk from a node straight to a pose, as far as it is free."""
    way, turn = between(start.pose, goal)
    steps = max(math.ceil(length_of(way, turn) / STEP), 1)
    rows = edges.line(start.pose.row(), goal.row(), steps)
    motion = np.empty((steps, 2))
    motion[:] = (1.0 + _ENLARGED) * size_of(way) / steps, (1.0 + _ENLARGED) * size_of(turn) / steps
    found = edges.walk(rows, motion, start.x, start.rooms)
    last = len(found.positions) - 1
    marks = list(range(NODE_STEPS, last, NODE_STEPS)) + ([last] if last else [])
    nodes = [Node(Pose.of_row(rows[i]), found.positions[i], found.rooms[i]) for i in marks]
    return Edge(nodes, last == steps, found.stop)


@final
class Tree:
    """Nodes with their parents, roots first.

    Attributes:
        nodes: the nodes.
        parents: index of each one's parent; −1 for roots.
    """

    def __init__(self, roots: list[Node]) -> None:
        self.nodes: list[Node] = []
        self.parents: list[int] = []
        self._p, self._q = np.empty((64, 3)), np.empty((64, 4))
        for root in roots:
            self.add(root, -1)

    def __len__(self) -> int:
        return len(self.nodes)

    def add(self, node: Node, parent: int) -> int:
        """Add a node; returns its index."""
        i = len(self.nodes)
        if i == len(self._p):
            self._p, self._q = (np.vstack([x, np.empty_like(x)]) for x in (self._p, self._q))
        self._p[i], self._q[i] = node.pose.p, pin.Quaternion(node.pose.R).coeffs()
        self.nodes.append(node)
        self.parents.append(parent)
        return i

    def distances(self, pose: Pose) -> Array:
        """Lengths of the straight edges from all nodes to a pose [m]."""
        n = len(self.nodes)
        away = self._p[:n] - pose.p
        cosine = np.minimum(np.abs(self._q[:n] @ pin.Quaternion(pose.R).coeffs()), 1.0)
        out: Array = np.sqrt((away * away).sum(axis=1) + (2.0 * TURN_LENGTH * np.arccos(cosine)) ** 2)
        return out

    def nearest(self, pose: Pose) -> int:
        """Index of the node with the shortest straight edge to a pose."""
        return int(self.distances(pose).argmin())

    def chain(self, i: int) -> list[Node]:
        """The nodes from a root to node ``i``."""
        out = []
        while i >= 0:
            out.append(self.nodes[i])
            i = self.parents[i]
        return out[::-1]

    def extend(self, edges: Edges, i: int, goal: Pose, stops: Counter[Stop]) -> tuple[int, bool]:
        """Grow straight from node ``i`` to a pose, as far as it is free.

        Returns:
            the last node, and whether it is at the pose.
        """
        edge = straight(edges, self.nodes[i], goal)
        for node in edge.nodes:
            i = self.add(node, i)
        if not edge.complete:
            stops[edge.stop] += 1
        return i, edge.complete
