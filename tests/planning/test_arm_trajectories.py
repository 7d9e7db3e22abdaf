"""Joint trajectories of all arms along a checked path, at places and between them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from user_paths import Opaque

from coopqp import InvalidInputError, WaypointPath, check_path
from coopqp.constraints.samples import sample_path
from coopqp.model import CellState
from coopqp.paths.joint_trajectories import ArmTrajectory, HeldTrajectory
from coopqp.paths.segments import Segments, segments_of
from coopqp.planning import PathVerdict
from coopqp.planning.clear_elbows import smooth
from coopqp.planning.knots import hermite, merged
from coopqp.planning.planner import some_timing
from coopqp.planning.shared_way import SharedWay, few_samples, places_of
from coopqp.scenarios import Scenario, paper_lift


def task() -> Scenario:
    """The paper's arms along two lines."""
    lift = paper_lift()
    start = lift.path.pose(0.0)
    ways = np.array([[0.0, 0.0, 0.0], [0.0, 0.02, 0.05], [0.02, 0.02, 0.1]])
    poses = [pin.SE3(start.rotation, start.translation + way) for way in ways]
    return replace(lift, path=WaypointPath(poses, durations=[1.0, 0.5], time_law="quintic"))


@pytest.fixture(scope="module")
def proved() -> tuple[Scenario, Segments, list[ArmTrajectory]]:
    own = task()
    check = check_path(own.cell, own.grasp, own.path, q_start=own.q_start)
    assert check.verdict is PathVerdict.CERTIFIED
    segments = segments_of(own.path)
    assert segments is not None
    return own, segments, [arm.chosen.trajectory for arm in check.arms if arm.chosen is not None]


def held(proved: Any, **changes: Any) -> HeldTrajectory:
    own, segments, arms = proved
    values = {"segments": segments, "arms": arms, **changes}
    return HeldTrajectory(own.cell, own.path, values["segments"], values["arms"], own.cell.positions(own.q_start))


def test_at_every_place_all_tools_hold_the_object(proved: Any) -> None:
    own = proved[0]
    way = held(proved)
    assert way.complete
    assert way.duration == 1.5
    assert way.places[0] == 0.0
    assert way.places[-1] == 2.0
    assert 1.0 in way.places
    places = np.linspace(0.0, 2.0, 15)
    x, solved = way.positions(places)
    assert solved.all()
    T, clocks = way.poses(places), way.clocks(places)
    for row, pose, clock in zip(x, T, clocks, strict=True):
        np.testing.assert_allclose(own.path.pose(float(clock)).homogeneous, pose, atol=1e-9)
        state = CellState(own.cell, own.cell.configuration(row))
        for tool, X in zip(state.T_world_tool, own.grasp.T_object_tool, strict=True):
            np.testing.assert_allclose(tool.homogeneous, pose @ X.homogeneous, atol=1e-8)


def test_at_its_own_places_an_arm_is_exactly_where_it_is_proved(proved: Any) -> None:
    own, _, arms = proved
    way = held(proved)
    for k in range(3):
        x, solved = way.positions(arms[k].places)
        assert solved.all()
        np.testing.assert_array_equal(x[:, own.cell.columns[k]], arms[k].q)


def test_one_arm_that_does_not_reach_the_object_is_told(proved: Any) -> None:
    """Its tool is said to be where no arm gets."""
    arms = list(proved[2])
    for k in range(3):
        offset = arms[k].offset.copy()
        offset[2, 3] += 9.0
        others = [*arms[:k], replace(arms[k], offset=offset), *arms[k + 1 :]]
        way = held(proved, arms=others)
        between = 0.5 * (way.places[0] + way.places[1])
        assert not way.positions(np.array([between]))[1].any()


def test_what_moves_between_places_is_bounded_arm_by_arm(proved: Any) -> None:
    own, _, arms = proved
    way = held(proved)
    low, high = way.places[:-1], way.places[1:]
    motion = way.motion(low, high)
    for k in range(3):
        np.testing.assert_array_equal(motion[:, own.cell.columns[k]], arms[k].motion(low, high))
        half = arms[k].motion(low[:1], 0.5 * (low + high)[:1])
        np.testing.assert_allclose(half, 0.5 * motion[:1, own.cell.columns[k]])
    distance, turn = way.object_motion(low, high)
    poses = way.poses(way.places)
    np.testing.assert_allclose(distance, np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1), atol=1e-12)
    np.testing.assert_allclose(turn, 0.0, atol=1e-12)


def test_the_way_of_all_arms_is_as_long_as_the_shortest(proved: Any) -> None:
    arms = list(proved[2])
    last = int(np.searchsorted(arms[1].places, 1.0))
    arms[1] = replace(arms[1], places=arms[1].places[: last + 1], q=arms[1].q[: last + 1], rates=arms[1].rates[:last])
    way = held(proved, arms=arms)
    assert not way.complete
    assert way.places[-1] == 1.0


def test_positions_near_others_reach_a_pose_or_there_are_none(proved: Any) -> None:
    own = proved[0]
    way = held(proved)
    x = way.positions(np.array([0.5]))[0][0]
    T = way.poses(np.array([0.55]))[0]
    found = way.reached(x, T)
    assert found is not None
    state = CellState(own.cell, own.cell.configuration(found))
    for tool, X in zip(state.T_world_tool, own.grasp.T_object_tool, strict=True):
        np.testing.assert_allclose(tool.homogeneous, T @ X.homogeneous, atol=1e-9)
    far = T.copy()
    far[2, 3] += 9.0
    assert way.reached(x, far) is None


def test_without_segments_places_are_clocks(proved: Any) -> None:
    own, _, arms = proved
    clocks = np.linspace(0.0, own.path.duration, 4)
    sampled = [ArmTrajectory.sampled(arm.kinematics, arm.offset, clocks, np.tile(arm.q[0], (4, 1))) for arm in arms]
    way = held(proved, segments=None, arms=sampled)
    assert way.complete
    np.testing.assert_array_equal(way.clocks(clocks), clocks)
    np.testing.assert_array_equal(way.poses(clocks)[2], own.path.pose(float(clocks[2])).homogeneous)
    assert np.isinf(way.motion(clocks[:1], clocks[1:2])).all()
    assert np.isinf(way.object_motion(clocks[:1], clocks[1:2])[0]).all()


@pytest.mark.parametrize(
    ("way", "turn", "said"),
    [((0.0, 0.003, 0.004), 0.0, "5.0 mm and 0.00°"), ((0.0, 0.0, 0.0), 0.02, "0.0 mm and 1.15°")],
)
def test_how_far_a_start_is_from_the_object_is_told(way: tuple[float, ...], turn: float, said: str) -> None:
    """The arms hold the object where the path does not begin, or turned about the first tool."""
    own = paper_lift()
    state = CellState(own.cell, own.q_start)
    tool = state.T_world_tool[0]
    moved = pin.SE3(pin.exp3(np.array([0.0, 0.0, turn])), np.array(way))
    about = pin.SE3(np.eye(3), tool.translation)
    start, goal = (about * moved * about.inverse() * own.path.pose(t) for t in (0.0, own.path.duration))
    path = WaypointPath([start, goal], durations=[1.0])
    with pytest.raises(InvalidInputError) as caught:
        check_path(own.cell, own.grasp, path, q_start=own.q_start)
    assert f"arm '{own.cell.arm_names[0]}' is {said} away from its grasp at the start of the path" in str(caught.value)


# -- shared joints -----------------------------------------------------------------------------------------------------


def test_shared_joints_go_straight_from_place_to_place() -> None:
    way = SharedWay((0, 1), np.array([3, 7]), np.array([0.0, 1.0, 3.0]), np.array([[0.0, 1.0], [2.0, 1.0], [0.0, 0.0]]))
    np.testing.assert_allclose(way.at(np.array([0.5, 1.0, 2.0, 3.0])), [[1.0, 1.0], [2.0, 1.0], [1.0, 0.5], [0.0, 0.0]])
    assert not way.stands
    assert replace(way, s=np.tile([0.5, 0.2], (3, 1))).stands
    assert not replace(way, s=np.array([[0.5, 0.2], [0.5, 0.2], [0.5, 0.3]])).stands


def test_samples_have_the_places_of_their_clocks() -> None:
    own = task()
    samples, segments = sample_path(own.path, own.grasp), segments_of(own.path)
    places = places_of(samples, segments)
    assert segments is not None
    np.testing.assert_allclose(segments.clocks(*segments.split(places)), samples.clocks, atol=5e-3)
    assert (places[0], places[-1]) == (0.0, 2.0)
    assert 1.0 in places
    chosen, few = few_samples(samples, segments, most=5)
    np.testing.assert_array_equal(few, places[chosen])
    assert {0.0, 1.0, 2.0} <= set(few.tolist())
    assert 5 <= len(few) <= 6
    assert (np.diff(few) > 0.0).all()
    opaque = sample_path(Opaque(own.path), own.grasp)
    np.testing.assert_array_equal(places_of(opaque, None), opaque.clocks)


# -- what is smoothed and interpolated ---------------------------------------------------------------------------------


def test_cubics_between_knots_are_cubics() -> None:
    s, at = np.array([0.0, 0.4, 1.0]), np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(hermite(s, s[:, None] ** 3, 3.0 * s[:, None] ** 2, at), at[:, None] ** 3, atol=1e-12)


def test_of_knots_that_all_but_coincide_the_marks_stay() -> None:
    s, marks = np.linspace(0.0, 1.0, 6), np.array([0.0, 0.405, 0.5, 1.0])
    np.testing.assert_allclose(merged(s, marks), [0.0, 0.2, 0.405, 0.5, 0.6, 0.8, 1.0])


def test_a_smoothed_motion_keeps_its_ends_and_straight_lines() -> None:
    s = np.linspace(0.0, 2.0, 81)
    straight = np.column_stack([1.0 + 3.0 * s, -s])
    np.testing.assert_allclose(smooth(s, straight, 0.03)(s), straight, atol=1e-9)
    bent = np.abs(s - 1.0)[:, None]
    found = smooth(s, bent, 0.05)(s)
    np.testing.assert_allclose(found[[0, -1]], bent[[0, -1]], atol=1e-3)
    # The mean distance of a normal distribution of 0.1 m from its middle.
    assert found[40, 0] == pytest.approx(0.1 * 81.0 / 80.0 * np.sqrt(2.0 / np.pi), rel=0.02)


def test_some_timing_rests_at_corners_and_goes_at_most_a_metre_a_second() -> None:
    geometry = task().path.geometry()
    assert geometry is not None
    path = some_timing(geometry)
    marks = geometry.marks
    np.testing.assert_allclose(path.profile.s, [0.0, 0.5 * marks[1], marks[1], 0.5 * (marks[1] + marks[2]), marks[2]])
    np.testing.assert_array_equal(path.profile.squares, [0.0, 1.0, 0.0, 1.0, 0.0])
    assert path.duration == pytest.approx(2.0 * marks[2])
