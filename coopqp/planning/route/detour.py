"""A way round from a place ahead of an object in motion: it leaves the path along its tangent, and ends at its end."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
import pinocchio as pin

from coopqp.collision.edges import SPARE, EdgeLimits, Edges, columns_of, limits_with
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.geometry import PathGeometry, Straight
from coopqp.paths.path import ObjectPath
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.route.duration import estimated_squares
from coopqp.planning.route.ends import ends_at
from coopqp.planning.route.search import Search, Searched, SearchLimits
from coopqp.planning.route.shape import WIDEST, Shape, Shaper, corners_of
from coopqp.planning.route.shorten import shortened
from coopqp.planning.route.tree import Node, Pose, between, distance, length_of, size_of, straight
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: The object's origin keeps within this of the box of both ends, below and above [m].
_BELOW, _ABOVE = 0.3, 0.4
#: A detour begins so far before the place where it leaves the path [m], for its profile to begin at rest.
_LEAD_IN = 1e-3
#: Lengths of the tangent along which the path is left that are tried [m].
_TANGENTS = (0.06, 0.03, 0.015)
#: Changes that make a detour faster, at most; share of the time in which ways are searched.
_CHANGES, _SEARCHING = 300, 0.4
#: An object that rests goes back so far [m] where bodies have less than so many times the spare; steps of that.
_BEHIND, _BACKS, _STEPS_BACK = 0.05, 2.0, 10
#: Distances are known to within this [m].
_ROUNDING = 1e-7
#: An object slower than this rests [m/s].
_RESTS = 1e-3
#: Motion between samples of a path that is looked along is longer than their chords by at most this share.
_BENT = 0.02
#: A path is looked along at samples so far apart [s], no further ahead than this [s].
_APART, _HORIZON = 0.02, 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Where the object is, and where it goes.

    Attributes:
        path: its path.
        clock: the clock of the path [s].
        rate: share of the path's speed.
        x: joint positions there (nv,) [rad or m].
    """

    path: ObjectPath
    clock: float
    rate: float
    x: Array


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Detour:
    """A way round from a place ahead.

    Attributes:
        leaves: clock of the old path at which it leaves it [s].
        path: the detour, with its lead-in.
        begins: clock of the detour at that place [s].
    """

    leaves: float
    path: TimedPath
    begins: float


@final
class Detours:
    """Looks ahead along a path among bodies that stand, and searches detours.

    Args:
        cell, grasp: the arms, and how they hold the object.
        scene: the bodies.
        clearance: distance that detours keep beyond the margins [m].
        fastest: largest speed along a detour [m/s].
        rng: random numbers.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        scene: CollisionScene,
        *,
        clearance: float,
        fastest: float,
        rng: np.random.Generator,
    ) -> None:
        self._cell, self._grasp, self._scene, self._rng = cell, grasp, scene, rng
        self._fastest, self._clearance = fastest, clearance
        self._arms = [ArmKinematics(arm) for arm in cell.arms]

    def blocked(self, motion: Motion) -> tuple[float, str] | None:
        """The clock at which the way ahead is no longer free [s], and what stops it; None if it is free."""
        required, _ = self._scene.required_at(motion.x[None])
        edges, _ = self._edges(motion.x, required)
        clocks, rows = _samples(motion.path, motion.clock)
        found = edges.walk(rows, _chords(rows), motion.x, edges.rooms(motion.x))
        last = len(found.positions) - 1
        if last == len(rows) - 1 or found.stop.kind != "pair":
            return None
        return float(clocks[last]), " and ".join(self._scene.labels[found.stop.number])

    def detour(self, motion: Motion, *, leaves: float, until: float) -> Detour | None:
        """The fastest detour that is found from a clock of the path on; None if there is none.

        Args:
            motion: the object's motion.
            leaves: clock at which it leaves the path [s]. The present one is for an object that rests: where bodies are
                near it first goes back a little.
            until: :func:`time.perf_counter` when the search ends [s].
        """
        path, began = motion.path, time.perf_counter()
        rests = leaves <= motion.clock
        required, _ = self._scene.required_at(motion.x[None])
        edges, _ = self._edges(motion.x, required + self._clearance)
        rooms = edges.rooms(motion.x)
        backs = rests and rooms.min(initial=np.inf) < _BACKS * SPARE
        if backs:  # bounds of distances cannot show that bodies part that have nothing to spare
            edges, _ = self._edges(motion.x, required + self._clearance + np.minimum(rooms - SPARE, 0.0))
            rooms = edges.rooms(motion.x)
        back = _line_back(path, motion.clock) if backs else None
        rows = _samples(path, motion.clock, leaves)[1] if back is None else _rows_of(back)
        found = edges.walk(rows, _chords(rows), motion.x, rooms)
        if len(found.positions) < len(rows):
            return None
        there, x = Pose.of_row(rows[-1]), found.positions[-1]
        V = np.zeros(6) if rests else path.twist(leaves) * motion.rate
        speed = length_of(V[:3], V[3:])
        speed = speed if speed > _RESTS else 0.0
        task, start, goals = self._task(there, x, Pose.of(path.pose(path.duration)))
        if not goals:
            return None
        shaper = Shaper(edges=task.edges, limits=self._cell.limits, speed=speed, fixed=1 if speed else 0)
        shape = self._shape(task, shaper, start, goals, V / speed if speed else None, began, until)
        if shape is None:
            return None
        return self._timed(shape, speed, leaves, back, found.positions)

    def _task(self, there: Pose, x: Array, end: Pose) -> tuple[Searched, Node, list[Node]]:
        """What is searched from a pose to another: the start, and the goals, none if there is none."""
        required, _ = self._scene.required_at(x[None])
        edges, kept = self._edges(x, required + self._clearance)
        start = Node(there, x, edges.rooms(x))
        ends = ends_at(self._cell, self._arms, self._grasp, end.placement(), self._scene, edges, near=x)
        goals = [Node(end, *row) for row in zip(ends.x, ends.rooms, strict=True)]
        rooms = np.array([node.rooms for node in (start, *goals)]).min(axis=0)
        kept.spare[:] = np.clip(rooms - _ROUNDING, 0.0, SPARE)
        p = np.array([there.p, end.p])
        region = np.array([p.min(axis=0) - _BELOW, p.max(axis=0) + _ABOVE])
        task = Searched(
            arms=self._arms, grasp=self._grasp, columns=columns_of(self._cell, self._arms), scene=self._scene,
            edges=edges, kept=kept, region=region,
        )  # fmt: skip
        return task, start, goals

    def _shape(
        self,
        task: Searched,
        shaper: Shaper,
        start: Node,
        goals: list[Node],
        unit: Array | None,
        began: float,
        until: float,
    ) -> Shape | None:
        """The fastest shape that is found; ``unit``: twist per metre at the start, None for an object that rests."""
        best: Shape | None = None
        searching = began + _SEARCHING * (until - began)
        for tangent in itertools.cycle(_TANGENTS if unit is not None else (0.0,)):
            if time.perf_counter() >= (searching if best else until):
                break
            line = (start, start) if unit is None else _tangent(task.edges, start, unit, tangent)
            way = self._way(task, line[1], goals, searching if best else until) if line else []
            if not line or not way:
                continue
            poses = corners_of(way) if unit is None else (line[0].pose, *corners_of(way))
            shape = shaper.shaped(line[0], poses, WIDEST)
            if shape is None or shape.geometry().corners:  # it would rest at a corner that is not rounded
                continue
            if best is None or shape.duration < best.duration:
                best = shape
        return None if best is None else shaper.faster(best, self._rng, until, changes=_CHANGES)

    def _way(self, task: Searched, start: Node, goals: list[Node], until: float) -> list[Node]:
        """A way from a node to a goal; empty if none is found."""
        edge = straight(task.edges, start, goals[0].pose)
        if edge.complete:
            return [start, *edge.nodes]
        limits = SearchLimits(nodes=None, until=until)
        way = Search(task, [start], goals, self._rng).run(limits).way
        return shortened(task.edges, way, self._rng, until) if way else []

    def _timed(
        self, shape: Shape, speed: float, leaves: float, back: Straight | None, positions: Array
    ) -> Detour | None:
        """A shape in its time, after a line back with joint ``positions`` along it; None if the speed is too high."""
        limits = self._cell.limits
        squares = estimated_squares(limits, shape.s, shape.positions, speed=speed)
        if speed and squares[0] < (1.0 - 1e-9) * speed * speed:
            return None
        most = max(self._fastest, speed) ** 2
        s, squares, geometry = shape.s, np.minimum(squares, most), shape.geometry()
        if speed:
            s, squares = np.insert(s, 1, _LEAD_IN), np.concatenate([[0.0, speed * speed], squares[1:]])
        if back is not None:
            s_back = np.linspace(0.0, back.length, len(positions))
            first = np.minimum(estimated_squares(limits, s_back, positions), most)
            s, squares = np.append(s_back, back.length + s[1:]), np.append(first, squares[1:])
            geometry = PathGeometry((back, *geometry.pieces))
        path = TimedPath(geometry, SpeedProfile(s, squares))
        return Detour(leaves=leaves, path=path, begins=float(path.profile.clocks[1]) if speed else 0.0)

    def _edges(self, x: Array, required: Array) -> tuple[Edges, EdgeLimits]:
        """Edges from positions (nv,) that keep distances, with nothing to spare, and what they keep."""
        kept = limits_with(self._cell, x[None], required)
        kept.spare[:] = 0.0
        return self._scene.edges(self._arms, self._grasp, kept), kept


def _line_back(path: ObjectPath, clock: float) -> Straight | None:
    """A line to where the object was a little before a clock [s]; None where the path has only begun."""
    here, before = Pose.of(path.pose(clock)), clock
    behind = here
    while before > 0.0 and distance(behind, here) < _BEHIND:
        before = max(before - _APART, 0.0)
        behind = Pose.of(path.pose(before))
    way, turn = between(here, behind)
    length = length_of(way, turn)
    return Straight(here.R, here.p, turn, way, length) if length > _LEAD_IN else None


def _samples(path: ObjectPath, clock: float, end: float = np.inf) -> tuple[Array, Array]:
    """Clocks (K,) [s] from a clock on, and the poses there, rows of R (9), p (3): (K, 12)."""
    end = min(end, path.duration, clock + _HORIZON)
    clocks = np.linspace(clock, end, max(math.ceil((end - clock) / _APART), 1) + 1)
    return clocks, np.array([Pose.of(path.pose(float(t))).row() for t in clocks])


def _rows_of(line: Straight) -> Array:
    """Poses along a line, rows of R (9), p (3): (K, 12)."""
    R, p = line.poses(np.linspace(0.0, line.length, _STEPS_BACK + 1))
    return np.hstack([R.reshape(-1, 9), p])


def _chords(rows: Array) -> Array:
    """Bounds of the object's motion between poses (K, 12): of its origin [m] and its turn [rad] (K − 1, 2)."""
    out = []
    for a, b in itertools.pairwise(map(Pose.of_row, rows)):
        way, turn = between(a, b)
        out.append(((1.0 + _BENT) * size_of(way), (1.0 + _BENT) * size_of(turn)))
    return np.array(out).reshape(-1, 2)


def _tangent(edges: Edges, there: Node, unit: Array, length: float) -> tuple[Node, Node] | None:
    """Both ends of a line through a node: just before it, and a length [m] behind it; None if it is not free.

    Args:
        edges: walks of the arms.
        there: the node.
        unit: twist per metre of the line, in the object's own frame (6,).
        length: of the line behind the node [m].
    """
    found = []
    for way in (-_LEAD_IN, length):
        R = there.pose.R
        edge = straight(edges, there, Pose(there.pose.p + R @ unit[:3] * way, R @ np.asarray(pin.exp3(unit[3:] * way))))
        if not edge.complete:
            return None
        found.append(edge.nodes[-1])
    return found[0], found[1]
