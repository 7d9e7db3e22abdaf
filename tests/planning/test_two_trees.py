"""Two trees that grow towards each other, for a point: start and goal are beside a wall with a hole."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from path_samples import samples_of

from coopqp import Grasp
from coopqp.collision.edges import EdgeLimits, Samples, Stop, Walked
from coopqp.planning.route.sampling import rounded
from coopqp.planning.route.search import Search, Searched, SearchLimits, SearchResult
from coopqp.planning.route.tree import Node, Pose, distance, part_of
from coopqp.spatial import Array

WALL = Stop("pair", 0)
HOLE = np.array([0.0, 0.3, -0.2])
REGION = np.array([[-0.6, -0.6, -0.6], [0.6, 0.6, 0.6]])
LONGEST = 0.6  # edges towards samples
LIMITS = np.array([9.0, 0.4, 9.0])  # of the joints, which are the origin


class Walled:
    """A wall across x, 0.1 m thick, with a round hole; the "arm" is where the object is."""

    def __init__(self, hole: float, ends_at: Callable[[Array], bool] = lambda _: False) -> None:
        self.hole, self.ends_at = hole, ends_at
        self.lines: list[tuple[Pose, Pose]] = []

    def rooms(self, x: Array) -> Array:
        beside = self.hole - float(np.linalg.norm(x[1:] - HOLE[1:]))
        return np.array([max(abs(float(x[0])) - 0.05, beside), 1.0])  # the other pair is far apart

    def walk(self, poses: Array, motion: Array, x: Array, rooms: Array) -> Walked:
        np.testing.assert_allclose(x, poses[0, 9:], atol=1e-12)
        free = np.array([self.rooms(p)[0] >= 0.0 and not self.ends_at(p) for p in poses[:, 9:]])
        n = len(poses) if free.all() else max(int(free.argmin()), 1)
        return Walked(poses[:n, 9:], np.array([self.rooms(p) for p in poses[:n, 9:]]), WALL)

    def object_along(self, poses: Array, motion: Array, rooms: Array) -> int:
        raise NotImplementedError

    def arms_along(self, poses: Array, x: Array) -> Array:
        return poses[:, 9:]

    def line(self, start: Array, goal: Array, steps: int) -> Array:
        a, b = Pose.of_row(start.copy()), Pose.of_row(goal.copy())
        self.lines.append((a, b))
        return np.array([part_of(a, b, i / steps).row() for i in range(steps + 1)])

    def samples(self, poses: Array, deviations: Array) -> Samples:
        return samples_of(rounded([Pose.of_row(row) for row in poses], deviations))


class PushedIntoHole:
    """Bodies that push an object that is in the wall into the hole, and leave others where they are."""

    def __init__(self, walled: Walled) -> None:
        self.walled = walled
        self.asked: list[tuple[Array, Array, Array]] = []
        self.turns: list[float] = []
        self.ends: list[Array] = []

    def pushed(self, T: pin.SE3, along: Array, required: Array) -> pin.SE3 | None:
        self.asked.append((T.translation.copy(), along.copy(), required.copy()))
        self.turns.append(float(np.linalg.norm(pin.log3(T.rotation))))
        if self.walled.hole <= 0.0:
            return None
        at = T.translation.copy()
        if abs(at[0]) < 0.05:
            at[1:] = HOLE[1:]
        self.ends.append(at)
        return pin.SE3(T.rotation, at)


class Follower:
    """Joints that are the origin of the object."""

    def newton(self, T: Array, x: Array) -> tuple[Array, Array]:
        assert T.shape == (1, 12)
        return T[:, 9:].copy(), np.zeros(len(T))


def node(*p: float) -> Node:
    x = np.array(p)
    return Node(Pose(x, np.eye(3)), x, np.ones(2))


def search_of(walled: Walled, seed: int = 3, spare: float = 0.001) -> tuple[Search, PushedIntoHole]:
    bodies: Any = PushedIntoHole(walled)
    arm: Any = Follower()
    columns: Any = [np.arange(3)]
    task = Searched(
        arms=[arm], grasp=Grasp((pin.SE3.Identity(),)), columns=columns, scene=bodies, edges=walled,
        kept=EdgeLimits(-LIMITS, LIMITS, np.array([0.002, 0.004]), np.array([spare, 0.5])), region=REGION,
    )  # fmt: skip
    return Search(task, [node(-0.5, 0.0, 0.0)], [node(0.5, 0.0, 0.0)], np.random.default_rng(seed)), bodies


def limits(nodes: int | None = 3000, seconds: float = 60.0, **more: Any) -> SearchLimits:
    return SearchLimits(nodes=nodes, until=time.perf_counter() + seconds, **more)


def between_trees(result: SearchResult) -> float:
    one, other = result.trees
    return min(distance(a.pose, b.pose) for a in one.nodes for b in other.nodes)


@pytest.mark.parametrize("seed", range(4))
def test_a_way_through_the_hole_is_found_with_few_samples(seed: int) -> None:
    walled = Walled(0.05)
    search, _ = search_of(walled, seed)
    result = search.run(limits())
    way = result.way
    np.testing.assert_array_equal(way[0].pose.p, [-0.5, 0.0, 0.0])
    np.testing.assert_allclose(way[-1].pose.p, [0.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(way[-1].pose.R, np.eye(3), atol=1e-9)
    for a, b in itertools.pairwise(way):
        assert distance(a.pose, b.pose) <= 0.1 + 1e-6
        assert all(walled.rooms(part_of(a.pose, b.pose, u).p)[0] >= 0.0 for u in (0.0, 0.5))
    assert result.closest == 0.0
    assert result.tried <= 60
    assert result.nodes == len(result.trees[0]) + len(result.trees[1])
    assert result.meetings == []
    assert result.stops[WALL] > 0
    search.forget()
    assert result.way == []
    again = search_of(Walled(0.05), seed)[0].run(limits())
    assert [tuple(n.pose.p) for n in again.way] == [tuple(n.pose.p) for n in way]


def test_bodies_push_across_the_line_from_start_to_goal() -> None:
    search, bodies = search_of(Walled(0.0))
    search.run(limits(300))
    assert len(bodies.asked) > 20
    for at, along, required in bodies.asked:
        np.testing.assert_allclose(along, [1.0, 0.0, 0.0], atol=1e-12)  # of length 1
        np.testing.assert_allclose(required, [0.003, 0.504])  # what is kept, and the spare
        assert -0.5 <= at[0] <= 0.5  # across the line it is anywhere in the region
        assert (REGION[0] <= at).all()
        assert (at <= REGION[1]).all()
    across = np.array([at[1:] for at, _, _ in bodies.asked])
    assert (np.ptp(across, axis=0) > 0.3).all()
    assert np.median(bodies.turns) < 0.5  # in gaps the object turns little, and now and then far
    assert max(bodies.turns) > 1.0


def test_a_gap_goes_straight_on_to_both_sides_from_where_the_joints_may_be() -> None:
    walled = Walled(0.05)
    search, bodies = search_of(walled, seed=1)
    search.run(limits())
    inside = [abs(at[1]) <= LIMITS[1] and walled.rooms(at)[0] >= 0.001 for at in bodies.ends]
    assert 0 < sum(inside) < len(inside)
    for at, may in zip(bodies.ends, inside, strict=True):
        ahead = sorted(round(float(b.p[0]), 9) for a, b in walled.lines if np.array_equal(a.p, at))
        if may:
            assert {-0.5, 0.5} <= set(ahead)
        else:
            assert ahead == []
    for a, b in walled.lines:
        if any(np.array_equal(a.p, at) for at in bodies.ends) and abs(b.p[0]) == 0.5 and abs(b.p[1]) > 0.0:
            np.testing.assert_allclose(b.p[1:], a.p[1:], atol=1e-12)


def test_edges_go_to_samples_of_the_region_and_are_not_long() -> None:
    walled = Walled(0.0)
    search, _ = search_of(walled)
    result = search.run(limits(300))
    assert result.way == []
    ends = np.array([b.p for _, b in walled.lines])
    assert (ends >= REGION[0] - 1e-12).all()
    assert (ends <= REGION[1] + 1e-12).all()
    assert (np.ptp(ends, axis=0) > 0.9).all()
    lengths = [distance(a, b) for a, b in walled.lines]
    assert max(lengths[:1]) <= LONGEST + 1e-9
    turns = np.array([np.linalg.norm(pin.log3(n.pose.R)) for tree in result.trees for n in tree.nodes])
    assert 0.5 < turns.max() <= np.pi + 1e-6
    assert np.median(turns) < 1.5  # rather less


def test_trees_that_do_not_meet_tell_how_near_they_came() -> None:
    search, _ = search_of(Walled(0.0))
    result = search.run(limits(250))
    assert result.way == []
    assert result.nodes + result.tried >= 250
    assert result.nodes + result.tried < 300
    assert result.closest == pytest.approx(between_trees(result), abs=0.2)
    assert result.closest >= 0.1  # the wall is between them
    assert result.stops == {WALL: result.stops[WALL]}
    for tree, side in zip(result.trees, (-1.0, 1.0), strict=True):
        assert all(side * n.pose.p[0] >= 0.05 for n in tree.nodes)
        assert len(tree) > 10


def test_a_search_ends_by_the_clock_or_by_who_watches() -> None:
    search, _ = search_of(Walled(0.0))
    assert search.run(limits(None, seconds=-1.0)).tried == 0
    seen: list[int] = []

    def watch(nodes: int) -> bool:
        seen.append(nodes)
        return len(seen) == 7

    assert search.run(limits(None, watch=watch)).tried == 6
    assert seen == sorted(seen)
    assert seen[0] == 2  # the roots
    assert search.run(limits(1)).tried == 6  # there are more already


def test_joints_that_do_not_get_through_leave_meetings(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the start no joint gets beyond the hole, although the trees meet."""
    beyond: list[bool] = []
    walled = Walled(0.1)
    search, _ = search_of(walled, seed=1)
    tree = search.result.trees[0]

    def only_from_goal(p: Array) -> bool:
        return bool(beyond) and p[0] > 0.2

    walled.ends_at = only_from_goal
    extend = tree.extend

    def watched(*arguments: Any) -> tuple[int, bool]:
        beyond.append(True)
        try:
            return extend(*arguments)
        finally:
            beyond.pop()

    monkeypatch.setattr(tree, "extend", watched)
    result = search.run(limits(meetings=2))
    assert result.way == []
    assert len(result.meetings) == 2
    assert result.closest == 0.0
    for before, behind in result.meetings:
        np.testing.assert_array_equal(before[0].pose.p, [-0.5, 0.0, 0.0])
        np.testing.assert_array_equal(behind[0].pose.p, [0.5, 0.0, 0.0])
        assert distance(before[-1].pose, behind[-1].pose) < 1e-9
    search.forget()
    assert result.meetings == []
