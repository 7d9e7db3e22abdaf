"""What a proof says of an arm's way, against dense samples of the way: it holds, and it is not much too careful."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import WaypointPath
from coopqp.model.batch import ArmKinematics
from coopqp.paths.certificate import Proof, between, exactness, prove
from coopqp.paths.geometry import blended
from coopqp.paths.joint_trajectories import ArmTrajectory
from coopqp.paths.segments import Segments
from coopqp.scenarios import dual_arm7, paper_lift


@functools.cache
def proved(make: Any) -> tuple[ArmKinematics, Segments, np.ndarray, Proof]:
    """An arm of a scenario along lines and a rounded corner that begin where its object is."""
    task = make()
    kinematics, X = ArmKinematics(task.cell.arms[0]), task.grasp.T_object_tool[0]
    start = task.path.pose(0.0)
    ways, turns = [[0.0, 0.0, 0.0], [0.0, 0.03, 0.12], [0.05, 0.1, 0.1]], [[0.0] * 3, [0.1, 0.0, 0.1], [0.2, 0.1, 0.0]]
    poses = [
        pin.SE3(pin.exp3(np.array(turn)) @ start.rotation, start.translation + np.array(way))
        for way, turn in zip(ways, turns, strict=True)
    ]
    lines = [s for x in WaypointPath(poses, durations=[1.0, 1.0]).segments if (s := x.straight())]
    geometry = blended(lines, distance=0.02, angle=0.05)
    n = len(geometry.pieces)
    segments = Segments(geometry.pieces, np.arange(float(n)), np.ones(n), np.zeros(n, dtype=bool))
    segment, share = segments.knots(X, distance=0.03, angle=0.1, pieces=4)
    offset = np.array(X.homogeneous)
    x = task.cell.positions(task.q_start)[task.cell.columns[0][kinematics.columns]]
    T = segments.poses(segment, share) @ offset
    q = kinematics.walk(T, kinematics.solve(T[:1], x[None], tolerance=1e-12).q, tolerance=1e-12)
    assert q.reached[0] == len(T) - 1
    return kinematics, segments, offset, prove(kinematics, segments, offset, segment, share, q.q[0])


ARMS = pytest.mark.parametrize("make", [paper_lift, dual_arm7])


@ARMS
def test_intervals_cover_the_whole_path_in_order(make: Any) -> None:
    _, segments, _, found = proved(make)
    assert found.proved.all()
    assert found.on_branch.all()
    assert found.between.all()
    assert found.outside is None
    low, high = found.segment + found.low, found.segment + found.high
    np.testing.assert_allclose(low[1:], high[:-1], atol=1e-12)
    assert low[0] == 0.0
    assert high[-1] == len(segments)
    np.testing.assert_array_equal(found.q_low[1:], found.q_high[:-1])
    assert len(found.low) <= 100


@ARMS
def test_speeds_margins_and_singular_values_are_bounded_closely(make: Any) -> None:
    kinematics, segments, offset, found = proved(make)
    trajectory = ArmTrajectory.proved(kinematics, offset, found)
    for i in range(0, len(found.low), 3):
        share = np.linspace(found.low[i], found.high[i], 21)
        segment = np.full(21, found.segment[i])
        T = segments.poses(segment, share)
        guess = np.array([np.interp(share, [found.low[i], found.high[i]], ends) for ends in _pairs(found, i)]).T
        q, _, solved = between(
            kinematics, T @ offset, np.tile(found.q_low[i], (21, 1)), np.tile(found.q_high[i], (21, 1)),
            np.linspace(0.0, 1.0, 21),
        )  # fmt: skip
        assert solved.all()
        assert np.abs(kinematics.tool_poses(q) - T @ offset).max() < 1e-9
        assert np.abs(q - guess).max() < 0.02
        speed = np.abs(np.diff(q, axis=0)).max(axis=0) / (share[1] - share[0])
        assert (speed <= found.rate[i] + 1e-9).all()
        assert found.rate[i].max() <= 1.5 * speed.max()
        margins = kinematics.margins(q).min(axis=0)
        assert (found.margins[i] <= margins + 1e-10).all()
        finite = np.isfinite(margins)
        assert (found.margins[i] >= margins - 0.05)[finite].all()
        sigma = kinematics.singular_values(q)[:, -1].min()
        assert 0.4 * sigma <= found.sigma_min[i] <= sigma + 1e-12
        np.testing.assert_allclose(found.q[i], q[10], atol=1e-9)
        if found.segment[i] + found.high[i] < len(segments):
            place = found.segment[i] + share[1:-1]
            x, reached = trajectory.at(place, T[1:-1])
            assert reached.all()
            np.testing.assert_allclose(x, q[1:-1], atol=1e-9)
            moved = trajectory.motion(place[:1], place[-1:])[0]
            np.testing.assert_allclose(moved, found.rate[i] * (place[-1] - place[0]))


def _pairs(found: Proof, i: int) -> list[tuple[float, float]]:
    return list(zip(found.q_low[i].tolist(), found.q_high[i].tolist(), strict=True))


def test_solutions_are_less_exact_far_from_the_origin() -> None:
    T = np.tile(np.eye(4), (3, 1, 1))
    assert exactness(T) == 1e-11
    for axis in range(3):
        far = T.copy()
        far[1, axis, 3] = -5000.0
        assert exactness(far) == pytest.approx(1e-11 + 5e-11)


def test_an_arm_that_stays_has_one_place() -> None:
    """Whoever asks gets the position it has, and no motion."""
    kinematics = ArmKinematics(paper_lift().cell.arms[0])
    q = np.arange(6.0)[None]
    still = ArmTrajectory.sampled(kinematics, np.eye(4), np.zeros(1), q)
    x, solved = still.at(np.array([0.0, 1.0, 7.0]), np.tile(np.eye(4), (3, 1, 1)))
    np.testing.assert_array_equal(x, np.tile(q, (3, 1)))
    assert solved.all()
    np.testing.assert_array_equal(still.motion(np.zeros(2), np.ones(2)), np.zeros((2, 6)))
    moving = ArmTrajectory.sampled(kinematics, np.eye(4), np.arange(2.0), np.vstack([q, q]))
    assert np.isinf(moving.motion(np.zeros(1), np.ones(1))).all()
