"""Samples of a path: as close to each other as the tools move, with all breakpoints and both ends among them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from user_paths import Jumping, OnlyMarked, Opaque

from coopqp import Grasp, HoldPath, LinePath, ObjectPath, ServoPath, WaypointPath
from coopqp.constraints.samples import sample_path
from coopqp.paths.grasp_motion import GraspMotion, GraspPiece
from coopqp.paths.moving_grasps import pieces_of
from coopqp.spatial import Array

HERE = pin.SE3.Identity()


def place(x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> pin.SE3:
    """A pose in the plane z = 0, turned about z."""
    return pin.SE3(pin.exp3(np.array([0.0, 0.0, turn])), np.array([x, y, 0.0]))


def grasp(*levers: float) -> Grasp:
    """Tools on the object's x-axis, at these distances [m]."""
    return Grasp(tuple(place(x) for x in levers))


def line(goal: pin.SE3, duration: float = 1.0) -> LinePath:
    return LinePath(HERE, goal, duration=duration, time_law="linear")


def still(second: tuple[GraspPiece, ...]) -> HoldPath:
    """An object at rest for 1 s, on which the second of two tools moves."""
    path = HoldPath(place(0.3, 0.2, 0.4), duration=1.0)
    path.grasps = GraspMotion(((), second), ((0.0, (True, False)),))
    return path


def moving(goal: pin.SE3, start: float = 0.0, duration: float = 1.0) -> tuple[GraspPiece, ...]:
    return pieces_of(line(goal, duration), start=start, before=HERE, frame=HERE, where="a test")


# 8 pieces, each halved until the tools move by 0.02 m and 0.05 rad at most
MOTIONS = pytest.mark.parametrize(
    ("goal", "lever", "pieces"),
    [
        (HERE, 0.0, 8),
        (place(0.15), 0.0, 8),
        (place(0.0, 1.0), 0.0, 64),
        (place(turn=0.39), 0.0, 8),
        (place(turn=1.0), 0.0, 32),
        (place(turn=-1.0), 0.0, 32),
        (place(turn=0.39), 1.0, 32),
        (place(0.0, -0.39, 0.39), 1.0, 8),  # a turn about the tool
    ],
)


@MOTIONS
def test_samples_are_as_close_as_the_tools_move(goal: pin.SE3, lever: float, pieces: int) -> None:
    path = line(goal)
    samples = sample_path(path, grasp(lever))
    np.testing.assert_allclose(samples.clocks, np.linspace(0.0, 1.0, pieces + 1), atol=1e-15)
    for clock, T in zip(samples.clocks, samples.poses, strict=True):
        assert T.isApprox(path.pose(clock), 1e-12)


@MOTIONS
def test_samples_are_as_close_as_a_tool_moves_on_an_object_at_rest(goal: pin.SE3, lever: float, pieces: int) -> None:
    path = still(moving(goal))
    samples = sample_path(path, grasp(0.5, lever))
    np.testing.assert_allclose(samples.clocks, np.linspace(0.0, 1.0, pieces + 1), atol=1e-15)
    first, second = samples.of_arm(0), samples.of_arm(1)
    assert first.motion is second.motion is None
    for clock, T, U in zip(samples.clocks, first.poses, second.poses, strict=True):
        assert T.isApprox(path.pose(0.0), 1e-12)
        assert U.isApprox(path.pose(0.0) * line(goal).pose(clock), 1e-12)


def test_a_tool_that_stays_in_the_world_while_the_object_moves_needs_few_samples() -> None:
    path = line(place(1.0))
    path.grasps = GraspMotion((moving(place(-1.0)),), ((0.0, (False,)),))
    assert len(sample_path(path, grasp(0.0)).clocks) == 9
    path.grasps = GraspMotion(((),), ((0.0, (False,)),))  # it rests on the object
    assert len(sample_path(path, grasp(0.0)).clocks) == 65
    assert sample_path(path, grasp(0.0)).motion is None


def test_both_ends_of_a_tools_motion_are_among_the_samples() -> None:
    clocks = sample_path(still(moving(place(0.01), start=0.3, duration=0.2)), grasp(0.5, 0.0)).clocks
    expected = np.concatenate([np.linspace(0.0, 0.3, 9), np.linspace(0.3, 0.5, 9)[1:], np.linspace(0.5, 1.0, 9)[1:]])
    np.testing.assert_allclose(clocks, expected, atol=1e-12)


def test_breakpoints_and_both_ends_are_among_the_samples() -> None:
    stations = [place(0.0), place(0.01), place(0.01, 0.01), place(0.0)]
    path = WaypointPath(stations, durations=[0.5, 1.0, 0.25], time_law="linear")
    samples = sample_path(path, grasp(0.0, 0.1))
    assert len(samples.clocks) == len(samples.poses) == 25
    np.testing.assert_allclose(samples.clocks[::8], [0.0, 0.5, 1.5, 1.75], atol=1e-15)
    assert samples.of_arm(1) is samples


class Repeating(OnlyMarked):
    """It tells a mark again when it is asked at the mark."""

    def next_breakpoint(self, clock: float) -> float:
        return min((mark for mark in self._marks if mark >= clock), default=self.duration)


@pytest.mark.parametrize("kind", [OnlyMarked, Repeating])
def test_a_breakpoint_that_is_told_twice_does_not_end_the_samples(kind: type[OnlyMarked]) -> None:
    clocks = sample_path(kind(line(place(0.1)), 0.5), grasp(0.0)).clocks
    assert clocks[0] == 0.0
    assert clocks[-1] == 1.0
    assert 0.5 in clocks
    assert (np.diff(clocks) > 0.0).all()


@pytest.mark.parametrize("at", [1e-300, 0.3, 1.0])
def test_samples_of_a_path_that_jumps_end(at: float) -> None:
    """The piece with the jump is halved seven times."""
    samples = sample_path(Jumping(HoldPath(HERE, duration=1.0), at, np.array([0.0, 0.0, 1.0])), grasp(0.0))
    assert len(samples.clocks) == 8 + 7 + 1
    assert np.diff(samples.clocks).min() == 2.0**-10
    heights = [T.translation[2] for T in samples.poses]
    assert heights == [float(clock >= at) for clock in samples.clocks]


@pytest.mark.parametrize(
    "path",
    [ServoPath(place(0.2)), Opaque(line(place(1.0)), known_ahead=False)],
)
def test_of_a_path_that_is_not_known_ahead_the_start_is_sampled(path: ObjectPath) -> None:
    samples = sample_path(path, grasp(0.0))
    assert samples.clocks.tolist() == [0.0]
    assert samples.poses[0].isApprox(path.pose(0.0), 1e-12)


def test_tool_poses_are_the_object_with_the_tool_on_it() -> None:
    samples, X = sample_path(line(place(0.3, 0.1, 1.0)), grasp(0.0)), place(0.2, 0.1, 0.3)
    expected: list[Array] = [(T * X).homogeneous for T in samples.poses]
    np.testing.assert_allclose(samples.tool_poses(X), expected, atol=1e-15)


class EverywhereMarked(HoldPath):
    """A path with a breakpoint each 20 µs."""

    def next_breakpoint(self, clock: float) -> float:
        return clock + 2e-5


@pytest.mark.slow
def test_a_path_with_more_breakpoints_than_are_kept_is_sampled_to_its_end() -> None:
    clocks = sample_path(EverywhereMarked(HERE, duration=1.0), grasp(0.0)).clocks
    assert clocks[-1] == 1.0
    assert np.diff(clocks).max() < 2e-5


def test_breakpoints_a_microsecond_apart_are_all_among_the_samples() -> None:
    marks = (0.3, 0.3 + 1e-6, 0.7)
    clocks = sample_path(OnlyMarked(line(place(0.1)), *marks), grasp(0.0)).clocks
    assert {*marks} <= {*clocks.tolist()}
