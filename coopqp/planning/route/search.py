"""The search for a way: two trees, from the start and from the goal, that grow towards each other."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.planning.route.edges import Edges, Stop
from coopqp.planning.route.tree import Node, Pose, Tree, distance, part_of
from coopqp.spatial import Array

#: Longest edge towards a sample [m].
_LONGEST = 0.6
#: Samples turn by at most half a turn from a pose between start and goal, and rather less: angle = π u^POWER.
_POWER = 2.5


@dataclass(frozen=True, kw_only=True)
class SearchLimits:
    """What ends a search that finds nothing.

    Attributes:
        nodes: number of nodes of both trees, samples that lead to none included; None for any.
        until: :func:`time.perf_counter` then [s].
    """

    nodes: int | None
    until: float


@dataclass(eq=False)
class SearchResult:
    """What a search found.

    Attributes:
        way: nodes from a start to a goal; empty if none was found.
        trees: both trees as they grew.
        stops: how often each stop ended an edge.
        closest: the shortest distance between the trees [m].
        tried: samples.
    """

    way: list[Node] = field(default_factory=list)
    trees: tuple[Tree, Tree] | None = None
    stops: Counter[Stop] = field(default_factory=Counter)
    closest: float = np.inf
    tried: int = 0

    @property
    def nodes(self) -> int:
        """Number of nodes of both trees."""
        return sum(map(len, self.trees)) if self.trees else 0


@final
class Search:
    """A search between start and goal.

    Args:
        edges: walks of the arms.
        starts, goals: roots of the trees.
        region: lowest and highest origin of the object (2, 3) [m].
        rng: random numbers.
    """

    def __init__(
        self, edges: Edges, starts: list[Node], goals: list[Node], region: Array, rng: np.random.Generator
    ) -> None:
        self._edges, self._region, self._rng = edges, region, rng
        self._starts, self._goals = starts, goals
        self.result = SearchResult(trees=(Tree(starts), Tree(goals)))

    def run(self, limits: SearchLimits) -> SearchResult:
        """Search until a way is found or a limit is reached."""
        found = self.result
        assert found.trees is not None
        turn = 0
        while not found.way and not self._is_over(limits):
            found.tried += 1
            grows, other = found.trees[turn], found.trees[1 - turn]
            sample = self._sample()
            i, near = self._towards(grows, sample)
            if near:
                self._connect(grows, i, other, from_start=turn == 0)
            turn = 1 - turn
        return found

    def forget(self) -> None:
        """Drop the way that was found; the trees stay."""
        self.result.way = []

    def _is_over(self, limits: SearchLimits) -> bool:
        if limits.nodes is not None and self.result.nodes + self.result.tried >= limits.nodes:
            return True
        return time.perf_counter() >= limits.until

    def _sample(self) -> Pose:
        """A random pose in the region, turned from one between start and goal."""
        rng = self._rng
        base = part_of(self._starts[0].pose, self._goals[rng.integers(len(self._goals))].pose, rng.random())
        axis = rng.normal(size=3)
        angle = np.pi * rng.random() ** _POWER
        R = base.R @ np.asarray(pin.exp3(angle * axis / np.linalg.norm(axis)))
        low, high = self._region
        return Pose(low + (high - low) * rng.random(3), R)

    def _towards(self, tree: Tree, sample: Pose) -> tuple[int, bool]:
        """Grow a tree towards a sample; the last node, and whether anything grew."""
        i = tree.nearest(sample)
        length = float(tree.distances(sample)[i])
        goal = sample if length <= _LONGEST else part_of(tree.nodes[i].pose, sample, _LONGEST / length)
        last, _ = tree.extend(self._edges, i, goal, self.result.stops)
        return last, last != i

    def _connect(self, tree: Tree, i: int, other: Tree, *, from_start: bool) -> None:
        """Grow the other tree to node ``i`` of a tree; where they meet the way is walked from the start."""
        pose = tree.nodes[i].pose
        j, complete = other.extend(self._edges, other.nearest(pose), pose, self.result.stops)
        if not complete:
            away = distance(other.nodes[j].pose, pose)
            self.result.closest = min(self.result.closest, away)
            return
        self._join(*((tree, i, other, j) if from_start else (other, j, tree, i)))

    def _join(self, starts: Tree, i: int, goals: Tree, j: int) -> None:
        """From node ``i`` of the starts' tree walk along the chain of node ``j`` of the other, at the same pose."""
        self.result.closest = 0.0
        for node in goals.chain(j)[::-1][1:]:
            i, complete = starts.extend(self._edges, i, node.pose, self.result.stops)
            if not complete:
                return
        self.result.way = starts.chain(i)
