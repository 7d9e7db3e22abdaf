"""Shortening and shaping a way, with arms whose joints are the object's origin, about a ball that is in the way."""

from __future__ import annotations

import itertools
import time
from collections import Counter

import numpy as np
import pytest
from path_samples import samples_of

from coopqp import JointLimits
from coopqp.collision.edges import Samples, Stop, Walked
from coopqp.planning.route.duration import estimated_duration
from coopqp.planning.route.sampling import rounded
from coopqp.planning.route.shape import Shape, Shaper
from coopqp.planning.route.shorten import shortened
from coopqp.planning.route.tree import Node, Pose, Tree, distance, part_of, straight
from coopqp.spatial import Array

LIMITS = JointLimits(np.full(3, -9.0), np.full(3, 9.0), np.full(3, 0.5), np.full(3, 2.0))
BALL = Stop("pair", 0)


class AboutBall:
    """Free is what is outside a ball of 0.2 m about the origin."""

    def __init__(self, radius: float = 0.2) -> None:
        self.radius = radius

    def rooms(self, x: Array) -> Array:
        return np.array([float(np.linalg.norm(x)) - self.radius])

    def walk(self, poses: Array, motion: Array, x: Array, rooms: Array) -> Walked:
        assert motion.shape == (len(poses) - 1, 2)
        steps = np.linalg.norm(np.diff(poses[:, 9:], axis=0), axis=1)
        assert (steps <= motion[:, 0] + 1e-12).all()
        np.testing.assert_allclose(x, poses[0, 9:], atol=1e-12)
        n = self.object_along(poses, motion, rooms)
        return Walked(poses[:n, 9:], np.array([self.rooms(p) for p in poses[:n, 9:]]), BALL)

    def object_along(self, poses: Array, motion: Array, rooms: Array) -> int:
        inside = np.linalg.norm(poses[:, 9:], axis=1) < self.radius
        return int(inside.argmax()) if inside.any() else len(poses)

    def arms_along(self, poses: Array, x: Array) -> Array:
        return poses[:, 9:]

    def line(self, start: Array, goal: Array, steps: int) -> Array:
        a, b = Pose.of_row(start), Pose.of_row(goal)
        return np.array([part_of(a, b, i / steps).row() for i in range(steps + 1)])

    def samples(self, poses: Array, deviations: Array) -> Samples:
        return samples_of(rounded([Pose.of_row(row) for row in poses], deviations))


def node(*p: float) -> Node:
    x = np.array(p)
    return Node(Pose(x, np.eye(3)), x, AboutBall().rooms(x))


def way(*points: tuple[float, float, float]) -> list[Node]:
    return [node(*p) for p in points]


def length(nodes: list[Node]) -> float:
    return sum(distance(a.pose, b.pose) for a, b in itertools.pairwise(nodes))


#: Round the ball by a long way.
ROUND = ((-0.5, 0.0, 0.0), (-0.5, 0.5, 0.0), (-0.2, 0.6, 0.0), (0.2, 0.5, 0.1), (0.5, 0.5, 0.0), (0.5, 0.0, 0.0))


def later() -> float:
    return time.perf_counter() + 60.0


# -- edges -------------------------------------------------------------------------------------------------------------


def test_a_free_edge_ends_at_its_goal_with_nodes_on_the_way() -> None:
    start, goal = node(-0.5, 0.5, 0.0), Pose(np.array([0.5, 0.5, 0.0]), np.eye(3))
    edge = straight(AboutBall(), start, goal)
    assert edge.complete
    np.testing.assert_allclose([n.pose.p[0] for n in edge.nodes], np.linspace(-0.4, 0.5, 10), atol=1e-12)
    for n in edge.nodes:
        np.testing.assert_array_equal(n.x, n.pose.p)
        np.testing.assert_allclose(n.rooms, AboutBall().rooms(n.pose.p))


def test_an_edge_that_is_not_free_ends_before_it_is_not() -> None:
    edge = straight(AboutBall(), node(-0.5, 0.01, 0.0), Pose(np.array([0.5, 0.01, 0.0]), np.eye(3)))
    assert not edge.complete
    assert edge.stop == BALL
    np.testing.assert_allclose([n.pose.p[0] for n in edge.nodes], [-0.4, -0.3, -0.2], atol=1e-12)
    blocked = straight(AboutBall(), node(-0.21, 0.0, 0.0), Pose(np.array([0.5, 0.0, 0.0]), np.eye(3)))
    assert blocked.nodes == []
    here = straight(AboutBall(), node(0.5, 0.0, 0.0), node(0.5, 0.0, 0.0).pose)
    assert here.complete
    assert len(here.nodes) == 1


def test_a_tree_grows_as_far_as_it_is_free_and_counts_what_stops_it() -> None:
    tree, stops = Tree([node(-0.5, 0.01, 0.0)]), Counter[Stop]()
    last, reached = tree.extend(AboutBall(), 0, Pose(np.array([0.5, 0.01, 0.0]), np.eye(3)), stops)
    assert not reached
    assert stops == Counter({BALL: 1})
    assert (last, tree.parents) == (3, [-1, 0, 1, 2])
    np.testing.assert_allclose(tree.nodes[last].pose.p, [-0.2, 0.01, 0.0], atol=1e-12)
    last, reached = tree.extend(AboutBall(), 0, Pose(np.array([-0.5, 0.31, 0.0]), np.eye(3)), stops)
    assert reached
    assert stops.total() == 1
    assert tree.parents[-1] == len(tree) - 2
    np.testing.assert_allclose(tree.nodes[last].pose.p, [-0.5, 0.31, 0.0], atol=1e-12)


# -- a shorter way -----------------------------------------------------------------------------------------------------


def test_a_way_round_a_ball_becomes_nearly_the_shortest() -> None:
    """Two tangents and an arc between them."""
    long = way(*ROUND)
    short = shortened(AboutBall(), long, np.random.default_rng(0), later())
    for end in (0, -1):
        np.testing.assert_array_equal(short[end].pose.p, long[end].pose.p)
    for a, b in itertools.pairwise(short):
        assert straight(AboutBall(), a, b.pose).complete
    angle = np.pi - 2.0 * np.arccos(0.2 / 0.5)
    best = 2.0 * np.sqrt(0.5**2 - 0.2**2) + 0.2 * angle
    assert best < length(short) + 2e-3
    assert length(short) < 1.06 * best
    again = shortened(AboutBall(), way(*ROUND), np.random.default_rng(0), later())
    assert length(again) == length(short)


def test_a_way_that_is_free_straight_on_becomes_one_line() -> None:
    short = shortened(AboutBall(0.01), way(*(p for p in ROUND if p[1] > 0.1)), np.random.default_rng(0), later())
    assert length(short) == pytest.approx(1.0)


def test_without_time_a_way_stays_as_it_is() -> None:
    long = way(*ROUND)
    assert shortened(AboutBall(), long, np.random.default_rng(0), time.perf_counter() - 1.0) == long


# -- its shape ---------------------------------------------------------------------------------------------------------


def shape(widest: float, *, fixed: int = 0, edges: AboutBall | None = None) -> tuple[Shaper, Shape]:
    shaper = Shaper(edges=edges or AboutBall(), limits=LIMITS, fixed=fixed)
    found = shaper.shaped(node(*ROUND[0]), [node(*p).pose for p in ROUND], widest)
    assert found is not None
    return shaper, found


def test_a_shape_is_free_and_tells_how_long_it_takes() -> None:
    _, found = shape(0.1)
    np.testing.assert_array_equal(found.deviations, np.full(4, 0.1))
    np.testing.assert_array_equal(found.positions, found.rows[:, 9:])
    assert (found.rooms >= 0.0).all()
    assert found.duration == estimated_duration(LIMITS, found.s, found.positions)
    assert found.geometry().corners == ()
    assert found.geometry().length == pytest.approx(found.s[-1])


def test_of_corners_the_one_at_which_a_way_stops_is_rounded_less() -> None:
    """The corner whose rounding would cut the ball."""
    points = ((-0.6, -0.25, 0.0), (0.0, 0.25, 0.0), (0.6, -0.25, 0.0), (0.6, -0.8, 0.0))
    shaper = Shaper(edges=AboutBall(0.185), limits=LIMITS)
    found = shaper.shaped(node(*points[0]), [node(*p).pose for p in points], 0.2)
    assert found is not None
    assert found.deviations[1] == 0.2
    assert found.deviations[0] in 0.2 * 0.5 ** np.arange(1, 5)
    assert (np.linalg.norm(found.positions, axis=1) >= 0.185).all()
    through = [node(*p).pose for p in ((-0.6, 0.0, 0.0), (0.0, 0.1, 0.0), (0.6, 0.0, 0.0))]
    assert shaper.shaped(node(-0.6, 0.0, 0.0), through, 0.2) is None


def test_changes_make_a_way_faster_and_keep_it_free() -> None:
    shaper, first = shape(0.02)
    found = shaper.faster(first, np.random.default_rng(1), later(), changes=60)
    # Less than the first joint takes for its metre is not possible: L/v + v/a.
    assert 2.25 <= found.duration < 1.001 * 2.25 < 0.8 * first.duration
    assert (found.rooms >= 0.0).all()
    np.testing.assert_array_equal(found.poses[0].p, ROUND[0])
    np.testing.assert_array_equal(found.poses[-1].p, ROUND[-1])
    assert len(found.deviations) == len(found.poses) - 2
    rows = samples_of(found.geometry()).poses
    np.testing.assert_array_equal(rows, found.rows)
    np.testing.assert_allclose(found.positions, rows[:, 9:])
    assert found.duration == pytest.approx(estimated_duration(LIMITS, found.s, found.positions))
    again = shaper.faster(first, np.random.default_rng(1), later(), changes=60)
    assert again.duration == found.duration


def test_corners_that_cost_time_are_left_out_first() -> None:
    shaper, first = shape(0.02)
    found = shaper.faster(first, np.random.default_rng(1), later(), changes=0)
    assert len(found.poses) < len(first.poses)
    assert found.duration <= first.duration
    idle = shaper.faster(first, np.random.default_rng(1), time.perf_counter() - 1.0, changes=60)
    assert idle is first


def test_poses_at_the_start_that_are_fixed_do_not_move() -> None:
    shaper, first = shape(0.02, fixed=2)
    found = shaper.faster(first, np.random.default_rng(1), later(), changes=60)
    assert found.duration < first.duration
    for i in range(3):
        np.testing.assert_array_equal(found.poses[i].p, ROUND[i])
