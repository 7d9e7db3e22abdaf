"""Parts of a search for a way: straight edges, trees, goals, rounded samples and corners, and what a route says."""

from __future__ import annotations

import itertools
import json
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from path_samples import samples_of

from coopqp import InvalidInputError
from coopqp.collision.edges import columns_of, limits_with
from coopqp.errors import UnknownNameError
from coopqp.model.batch import ArmKinematics
from coopqp.paths.geometry import Blend
from coopqp.planning import ArmGoal, FreeTurn, Route, RouteVerdict, TurnedGoal
from coopqp.planning.route.goals import goal_poses
from coopqp.planning.route.sampling import rounded
from coopqp.planning.route.shape import corners_of
from coopqp.planning.route.tree import Node, Pose, Tree, between, distance, part_of
from coopqp.scenarios import paper_lift

TURN = 0.3  # metres that a turn by 1 rad counts as


def pose(p: Any, turn: Any = (0.0, 0.0, 0.0)) -> Pose:
    return Pose(np.array(p, dtype=float), np.asarray(pin.exp3(np.array(turn, dtype=float))))


def random_poses(count: int, seed: int = 2) -> list[Pose]:
    rng = np.random.default_rng(seed)
    return [pose(rng.normal(size=3) * 0.3, rng.normal(size=3)) for _ in range(count)]


def node(at: Pose) -> Node:
    return Node(at, np.zeros(2), np.zeros(1))


# -- straight edges and trees ------------------------------------------------------------------------------------------


def test_the_length_of_an_edge_counts_way_and_turn() -> None:
    assert distance(pose([0, 0, 0]), pose([0, 3, 4])) == pytest.approx(5.0)
    assert distance(pose([1, 1, 1]), pose([1, 1, 1], [0.0, 0.5, 0.0])) == pytest.approx(0.5 * TURN)
    assert distance(pose([0, 0, 0]), pose([0.4, 0, 0], [0.0, 0.0, 1.0])) == pytest.approx(0.5)


def test_a_share_of_an_edge_lies_on_it() -> None:
    a, b = random_poses(2)
    way, turn = between(a, b)
    np.testing.assert_allclose(a.p + way, b.p)
    np.testing.assert_allclose(a.R @ pin.exp3(turn), b.R, atol=1e-12)
    part = part_of(a, b, 0.3)
    assert distance(a, part) == pytest.approx(0.3 * distance(a, b))
    assert distance(part, b) == pytest.approx(0.7 * distance(a, b))


def test_a_pose_is_a_row_and_a_placement() -> None:
    a = random_poses(1)[0]
    for same in (Pose.of_row(a.row()), Pose.of(a.placement())):
        np.testing.assert_array_equal(same.p, a.p)
        np.testing.assert_array_equal(same.R, a.R)


def test_a_tree_knows_distances_the_nearest_node_and_the_way_to_it() -> None:
    poses = random_poses(150)
    tree = Tree([node(poses[0]), node(poses[1])])
    for i in range(2, 150):
        assert tree.add(node(poses[i]), i - 2) == i
    assert len(tree) == 150
    for goal in random_poses(5, seed=8):
        expected = [distance(goal, p) for p in poses]
        np.testing.assert_allclose(tree.distances(goal), expected, atol=1e-7)
        assert tree.nearest(goal) == int(np.argmin(expected))
    assert [n.pose for n in tree.chain(7)] == [poses[i] for i in (1, 3, 5, 7)]
    assert [n.pose for n in tree.chain(0)] == [poses[0]]


# -- rounded lines -----------------------------------------------------------------------------------------------------


def test_samples_of_rounded_lines_are_its_poses_and_bound_its_motion() -> None:
    geometry = rounded(random_poses(4), np.array([0.05, 0.08]))
    assert sum(isinstance(piece, Blend) for piece in geometry.pieces) == 2
    samples = samples_of(geometry)
    assert samples.s[0] == 0.0
    assert samples.s[-1] == geometry.length
    assert (np.diff(samples.s) > 0.0).all()
    assert np.abs(samples.s[:, None] - geometry.marks).min(axis=0).max() < 1e-12  # both ends of each piece
    assert np.diff(samples.s).max() <= 0.02 + 1e-12
    poses = [geometry.pose(float(s)) for s in samples.s]
    rows = np.array([Pose.of(T).row() for T in poses])
    np.testing.assert_allclose(samples.poses, rows, atol=1e-9)
    for i in range(len(rows) - 1):
        inner = [geometry.pose(float(s)) for s in np.linspace(samples.s[i], samples.s[i + 1], 9)]
        way = sum(float(np.linalg.norm(b.translation - a.translation)) for a, b in itertools.pairwise(inner))
        turn = sum(float(np.linalg.norm(pin.log3(a.rotation.T @ b.rotation))) for a, b in itertools.pairwise(inner))
        assert way <= samples.motion[i, 0] + 1e-9
        assert turn <= samples.motion[i, 1] + 1e-9
        piece = geometry.pieces[int(np.searchsorted(geometry.marks, samples.s[i] + 1e-9)) - 1]
        close = 4.0 if isinstance(piece, Blend) else 1.0 + 1e-6
        assert samples.motion[i, 0] <= close * way + 1e-9
        assert samples.motion[i, 1] <= close * turn + 1e-9


def test_a_short_line_has_at_least_four_parts() -> None:
    samples = samples_of(rounded([pose([0, 0, 0]), pose([1e-3, 0, 0])], np.zeros(0)))
    np.testing.assert_allclose(samples.s, 1e-3 * np.linspace(0.0, 1.0, 5))
    np.testing.assert_allclose(samples.motion, np.tile([2.5e-4, 0.0], (4, 1)), atol=1e-15)


def test_nodes_on_a_straight_line_are_no_corners() -> None:
    a, b, c = pose([0, 0, 0]), pose([1, 0, 0], [0.0, 0.0, 0.5]), pose([1, 1, 0])
    way = [a, part_of(a, b, 0.2), part_of(a, b, 0.7), b, b, part_of(b, c, 0.5), c]
    found = corners_of([node(at) for at in way])
    assert max(distance(at, expected) for at, expected in zip(found, (a, b, c), strict=True)) < 1e-12
    assert len(corners_of([node(a), node(b)])) == 2
    turned = pose([2, 0, 0], [0.0, 0.0, 0.5])  # goes on straight, but turns no more
    assert len(corners_of([node(a), node(b), node(turned)])) == 3


# -- goals and limits --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("turn", "degrees"),
    [
        (FreeTurn("rz", 0.0, np.deg2rad(60.0)), [0.0, 30.0, 60.0]),
        (FreeTurn("rz", np.deg2rad(-40.0), np.deg2rad(40.0)), [-40.0, -40.0 / 3.0, 0.0, 40.0 / 3.0, 40.0]),
        (FreeTurn("rz", np.deg2rad(10.0), np.deg2rad(20.0)), [10.0, 20.0]),
        (FreeTurn("rx"), np.linspace(-180.0, 180.0, 13)),
    ],
)
def test_angles_of_a_free_turn_are_close_and_have_its_ends(turn: FreeTurn, degrees: Any) -> None:
    np.testing.assert_allclose(np.rad2deg(turn.angles()), degrees, atol=1e-9)


def test_free_turns_are_applied_one_after_the_other() -> None:
    T = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([1.0, 2.0, 3.0]))
    goal = TurnedGoal(T, [FreeTurn("rx", 0.2, 0.2), FreeTurn("rz", 0.4, 0.4)])
    expected = T.rotation @ pin.exp3(np.array([0.2, 0.0, 0.0])) @ pin.exp3(np.array([0.0, 0.0, 0.4]))
    for found in goal.poses():
        np.testing.assert_allclose(found.rotation, expected, atol=1e-12)
        np.testing.assert_array_equal(found.translation, T.translation)
    assert len(TurnedGoal(T, [FreeTurn("rx"), FreeTurn("ry"), FreeTurn("rz")]).poses()) == 64
    assert len(TurnedGoal(T, [FreeTurn("ry", 0.0, np.pi)]).poses()) == 7


def test_bad_free_turns_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="axis"):
        FreeTurn("z")  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="low is above high"):
        FreeTurn("rz", 0.2, 0.1)
    for bad in (7.0, np.nan):
        with pytest.raises(InvalidInputError, match="FreeTurn: high"):
            FreeTurn("rz", 0.0, bad)


def test_goals_are_tried_from_the_nearest_on() -> None:
    task = paper_lift()
    arms = [ArmKinematics(arm) for arm in task.cell.arms]
    start = task.path.pose(0.0)

    def poses(goal: Any) -> tuple[list[Any], bool]:
        return goal_poses(goal, task.cell, task.grasp, arms, start)

    near, far = (pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, z])) for z in (0.1, 0.3))
    found, every = poses([far, near])
    assert [goal.T for goal in found] == [near, far]
    assert [goal.arm for goal in found] == [-1, -1]
    assert every
    assert poses(near.homogeneous)[1]
    assert not poses(TurnedGoal(near, [FreeTurn("rz", 0.0, 0.1)]))[1]
    with pytest.raises(InvalidInputError, match="no pose"):
        poses([])
    with pytest.raises(InvalidInputError, match="the goal is the start"):
        poses([far, start])
    name = task.cell.arm_names[1]
    q = task.cell.positions(task.q_start)[task.cell.v_slices[1]]
    (own,), every = poses(ArmGoal(name, q))
    assert every
    assert own.arm == 1
    np.testing.assert_array_equal(own.positions, q)
    np.testing.assert_allclose(own.T.homogeneous, start.homogeneous, atol=1e-6)


def test_edges_keep_off_joint_limits_unless_they_begin_there() -> None:
    cell = paper_lift().cell
    arms = [ArmKinematics(arm) for arm in cell.arms]
    for k, columns in enumerate(columns_of(cell, arms)):
        np.testing.assert_array_equal(columns, np.arange(6 * k, 6 * k + 6))
    middle = 0.5 * (cell.limits.lower + cell.limits.upper)
    kept = limits_with(cell, middle[None], np.array([0.01, 0.02]))
    np.testing.assert_allclose(kept.lower, cell.limits.lower + 0.05)
    np.testing.assert_allclose(kept.upper, cell.limits.upper - 0.05)
    np.testing.assert_array_equal(kept.spare, [0.003, 0.003])
    low, high = middle.copy(), middle.copy()
    low[3], high[5] = cell.limits.lower[3] + 0.01, cell.limits.upper[5] - 0.02
    near = limits_with(cell, np.array([low, high]), np.zeros(1))
    assert near.lower[3] == low[3]
    assert near.upper[5] == high[5]
    assert np.flatnonzero(near.lower != kept.lower).tolist() == [3]
    assert np.flatnonzero(near.upper != kept.upper).tolist() == [5]


# -- what a route says -------------------------------------------------------------------------------------------------


def test_a_route_without_a_way_says_why() -> None:
    route = Route(verdict=RouteVerdict.NOT_FOUND, reason="none was found in 2 s", nodes=17, first_s=2.0, total_s=2.5)
    assert not route.found
    assert route.explain() == "none was found in 2 s"
    assert repr(route) == "Route(not_found; 17 nodes)"
    assert json.loads(json.dumps(route.record())) == {
        "verdict": "NOT_FOUND",
        "reason": "none was found in 2 s",
        "length_m": None,
        "nodes": 17,
        "first_s": 2.0,
        "total_s": 2.5,
        "check": None,
    }
    with pytest.raises(InvalidInputError, match="there is no way"):
        route.timed()


def test_a_route_with_a_way_tells_its_length() -> None:
    path: Any = paper_lift().path
    found = Route(verdict=RouteVerdict.FOUND, path=path, length=1.2345, nodes=3)
    assert found.found
    assert found.explain() == "A way of 1.23 m was found."
    assert repr(found) == "Route(found, 1.23 m; 3 nodes)"
    assert found.record()["length_m"] == 1.2345
    straight = Route(verdict=RouteVerdict.STRAIGHT, path=path, length=0.5)
    assert straight.explain() == "The straight way is free."
