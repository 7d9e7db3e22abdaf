"""The search for a way: two trees, from the start and from the goal, that grow towards each other."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

import numpy as np
import pinocchio as pin

from coopqp.collision.edges import EdgeLimits, Edges, Stop
from coopqp.model.batch import REACHED, ArmKinematics
from coopqp.model.grasp import Grasp
from coopqp.planning.route.tree import Node, Pose, Tree, distance, part_of, size_of, straight
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Longest edge towards a sample [m].
_LONGEST = 0.6
#: Samples turn by at most half a turn from a pose between start and goal, and rather less: angle = π u^POWER.
_POWER, _POWER_IN_GAPS = 2.5, 4.0
#: Of samples, the share in gaps grows from none to the most while so many samples find no way.
_MOST_GAPS, _GAPS_AFTER = 0.5, 60
#: Nearest nodes of a tree that are tried for the ends of a gap, and share of samples that go through a known one.
_NEAREST, _TO_GAPS = 6, 0.2


@dataclass(frozen=True, kw_only=True)
class SearchLimits:
    """What ends a search that finds nothing.

    Attributes:
        nodes: number of nodes of both trees, samples that lead to none included; None for any.
        until: :func:`time.perf_counter` then [s].
        meetings: number of poses in which the trees meet with other joints; None for any.
        watch: is told the number of nodes now and then; a true answer ends the search. None: nobody watches.
    """

    nodes: int | None
    until: float
    meetings: int | None = None
    watch: Callable[[int], bool | None] | None = None


@dataclass(eq=False)
class SearchResult:
    """What a search found.

    Attributes:
        trees: both trees as they grew.
        way: nodes from a start to a goal; empty if none was found.
        stops: how often each stop ended an edge.
        closest: the shortest distance between the trees [m].
        tried: samples.
        meetings: ways from a start and from a goal to poses in which the trees met, where the joints of the first do
            not get through on the second.
    """

    trees: tuple[Tree, Tree]
    way: list[Node] = field(default_factory=list)
    stops: Counter[Stop] = field(default_factory=Counter)
    closest: float = np.inf
    tried: int = 0
    meetings: list[tuple[list[Node], list[Node]]] = field(default_factory=list)

    @property
    def nodes(self) -> int:
        """Number of nodes of both trees."""
        return sum(map(len, self.trees))


@dataclass(frozen=True, kw_only=True, eq=False)
class Searched:
    """What is searched: the arms, the bodies and where the object may go.

    Attributes:
        arms, grasp: kinematics of the arms, and how they hold the object.
        columns: columns of each arm's joints.
        scene, edges, kept: the bodies, walks of the arms among them, and what these keep.
        region: lowest and highest origin of the object (2, 3) [m].
    """

    arms: Sequence[ArmKinematics]
    grasp: Grasp
    columns: Sequence[Array]
    scene: CollisionScene
    edges: Edges
    kept: EdgeLimits
    region: Array


@final
class Search:
    """A search between start and goal.

    Args:
        task: what is searched.
        starts, goals: roots of the trees.
        rng: random numbers.
    """

    def __init__(self, task: Searched, starts: list[Node], goals: list[Node], rng: np.random.Generator) -> None:
        self._task, self._edges, self._rng = task, task.edges, rng
        self._starts, self._goals = starts, goals
        self._gaps: list[list[Pose]] = []
        self.result = SearchResult((Tree(starts), Tree(goals)))

    def run(self, limits: SearchLimits) -> SearchResult:
        """Search until a way is found or a limit is reached."""
        found, turn = self.result, 0
        while not found.way and not self._is_over(limits):
            found.tried += 1
            if self._rng.random() < _MOST_GAPS * found.tried / (found.tried + _GAPS_AFTER):
                gap = self._look_for_gap()
                if gap:
                    self._gaps.append(gap)
                    self._pass(gap, turn)
            elif self._gaps and self._rng.random() < _TO_GAPS:
                self._pass(self._gaps[self._rng.integers(len(self._gaps))], turn)
            else:
                i, grown = self._towards(found.trees[turn], self._sample())
                if grown:
                    self._connect(turn, i)
            turn = 1 - turn
        return found

    def forget(self) -> None:
        """Drop the way that was found, and the meetings; the trees stay."""
        self.result.way, self.result.meetings = [], []

    def _is_over(self, limits: SearchLimits) -> bool:
        if limits.nodes is not None and self.result.nodes + self.result.tried >= limits.nodes:
            return True
        if limits.watch is not None and limits.watch(self.result.nodes):
            return True
        if limits.meetings is not None and len(self.result.meetings) >= limits.meetings:
            return True
        return time.perf_counter() >= limits.until

    def _line(self) -> tuple[Pose, Pose]:
        """A start and a goal."""
        return self._starts[0].pose, self._goals[self._rng.integers(len(self._goals))].pose

    def _turned(self, R: Array, power: float) -> Array:
        """A rotation turned about a random axis by a random angle."""
        axis, angle = self._rng.normal(size=3), np.pi * self._rng.random() ** power
        out: Array = R @ np.asarray(pin.exp3(angle / size_of(axis) * axis))
        return out

    def _sample(self) -> Pose:
        """A random pose in the region, turned from one between start and goal."""
        base = part_of(*self._line(), self._rng.random())
        low, high = self._task.region
        return Pose(low + (high - low) * self._rng.random(3), self._turned(base.R, _POWER))

    def _towards(self, tree: Tree, sample: Pose) -> tuple[int, bool]:
        """Grow a tree towards a sample; the last node, and whether anything grew."""
        away = tree.distances(sample)
        i = int(away.argmin())
        length = float(away[i])
        goal = sample if length <= _LONGEST else part_of(tree.nodes[i].pose, sample, _LONGEST / length)
        last, _ = tree.extend(self._edges, i, goal, self.result.stops)
        return last, last != i

    def _reached(self, tree: Tree, pose: Pose, tries: int) -> int:
        """Grow a tree to a pose from the nodes nearest to it; the node there, or −1."""
        for i in np.argsort(tree.distances(pose), kind="stable")[:tries].tolist():
            j, complete = tree.extend(self._edges, i, pose, self.result.stops)
            if complete:
                return j
            self.result.closest = min(self.result.closest, distance(tree.nodes[j].pose, pose))
        return -1

    def _connect(self, turn: int, i: int, tries: int = 1) -> None:
        """Grow the other tree to node ``i`` of a tree; where they meet the way is walked from the start."""
        starts, goals = self.result.trees
        j = self._reached(goals if turn == 0 else starts, self.result.trees[turn].nodes[i].pose, tries)
        if j >= 0:
            self._join(starts, *((i, goals, j) if turn == 0 else (j, goals, i)))

    def _join(self, starts: Tree, i: int, goals: Tree, j: int) -> None:
        """From node ``i`` of the starts' tree walk along the chain of node ``j`` of the other, at the same pose."""
        self.result.closest = 0.0
        met = starts.chain(i), goals.chain(j)
        for node in goals.chain(j)[::-1][1:]:
            i, complete = starts.extend(self._edges, i, node.pose, self.result.stops)
            if not complete:
                self.result.meetings.append(met)
                return
        self.result.way = starts.chain(i)

    # -- gaps --------------------------------------------------------------------------------------------------------

    def _pass(self, gap: list[Pose], turn: int) -> None:
        """Grow a tree to the end of a gap on its side, through the gap, and the other tree to where it comes out."""
        tree = self.result.trees[turn]
        ahead = gap if turn == 0 else gap[::-1]
        i = self._reached(tree, ahead[0], _NEAREST)
        for pose in ahead[1:] if i >= 0 else ():
            i, complete = tree.extend(self._edges, i, pose, self.result.stops)
            if not complete:
                return
        if i >= 0:
            self._connect(turn, i, _NEAREST)

    def _look_for_gap(self) -> list[Pose]:
        """Poses straight through a gap: one pushed off the bodies across the line from start to goal, and its ends.

        The ends are as far along the line as start and goal, or as far as it is free. Empty if there is none.
        """
        start, goal = self._line()
        middle = part_of(start, goal, self._rng.random())
        length = size_of(goal.p - start.p)
        if length == 0.0:
            return []
        along = (goal.p - start.p) / length
        low, high = self._task.region
        away = low + (high - low) * self._rng.random(3) - middle.p
        pose = Pose(middle.p + away - along * float(along @ away), self._turned(middle.R, _POWER_IN_GAPS))
        pushed = self._task.scene.pushed(pose.placement(), along, self._task.kept.required + self._task.kept.spare)
        node = None if pushed is None else self._held(Pose.of(pushed))
        if node is None:
            return []
        ends = []
        for end in (start, goal):
            way = along * float(along @ (end.p - node.pose.p))
            out = straight(self._edges, node, Pose(node.pose.p + way, node.pose.R))
            ends.append(out.nodes[-1].pose if out.nodes else node.pose)
        return [ends[0], node.pose, ends[1]]

    def _held(self, pose: Pose) -> Node | None:
        """The arms at a pose, from joint positions of the nearest nodes; None where they cannot be."""
        task = self._task
        for tree in self.result.trees:
            for i in np.argsort(tree.distances(pose), kind="stable")[:1]:
                x = tree.nodes[i].x.copy()
                for arm, own, X in zip(task.arms, task.columns, task.grasp.T_object_tool, strict=True):
                    q, residual = arm.newton(Pose.of(pose.placement() * X).row()[None], x[None, own])
                    if not residual[0] <= REACHED:
                        break
                    x[own] = q[0]
                else:
                    if ((x >= task.kept.lower) & (x <= task.kept.upper)).all():
                        rooms = self._edges.rooms(x)
                        if (rooms >= task.kept.spare).all():
                            return Node(pose, x, rooms)
        return None
