"""Bounds of an arm's motion along one interval, against dense samples of it, for joints that turn and that slide."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import LinePath
from coopqp.model.batch import ArmKinematics
from coopqp.paths.certificate import Tubes, between, tubes
from coopqp.paths.segments import Segments
from coopqp.scenarios import mixed_cell, paper_lift
from coopqp.spatial import Array

#: Six joints that turn; seven of which the first slides.
ARMS = pytest.mark.parametrize("arm", ["rx90l", "gantry7"])


@functools.cache
def placed(arm: str) -> tuple[ArmKinematics, Array]:
    task, k = (paper_lift(), 0) if arm == "rx90l" else (mixed_cell(), 3)
    kinematics = ArmKinematics(task.cell.arms[k])
    return kinematics, task.cell.positions(task.q_start)[task.cell.columns[k][kinematics.columns]]


class Interval:
    """The first part of a line of an object that is below the tool, turns about the vertical and goes some way."""

    def __init__(self, arm: str, below: Any, way: Any, *, turn: float, high: float, off: float = 0.0) -> None:
        self.kinematics, x = placed(arm)
        T = pin.SE3(self.kinematics.tool_poses(x[None])[0])
        start = pin.SE3(np.eye(3), T.translation + np.array(below))
        path = LinePath.displaced(start, translation=way, rotation=(0.0, 0.0, turn), duration=1.0)
        geometry = path.geometry()
        assert geometry is not None
        n = len(geometry.pieces)
        self.segments = Segments(geometry.pieces, np.arange(float(n)), np.ones(n), np.zeros(n, dtype=bool))
        self.offset, self.high = np.array((start.inverse() * T).homogeneous), high
        ends = self.poses(np.array([0.0, high]))
        q = self.kinematics.walk(ends, self.kinematics.solve(ends[:1], x[None], tolerance=1e-12).q, tolerance=1e-12).q
        self.qa, self.qb = q[0][:1], q[0][1:].copy()
        self.qb[0, 0] += off

    def poses(self, share: Array) -> Array:
        T: Array = self.segments.poses(np.zeros(len(share), dtype=int), share) @ self.offset
        return T

    def tube(self) -> Tubes:
        ends = np.array([0.0]), np.array([self.high])
        return tubes(self.kinematics, self.segments, self.offset, np.zeros(1, dtype=int), *ends, self.qa, self.qb)

    def motion(self, count: int = 41) -> Array:
        """Positions (count, n) along the interval."""
        u = np.linspace(0.0, 1.0, count)
        ends = np.tile(self.qa, (count, 1)), np.tile(self.qb, (count, 1))
        q, _, solved = between(self.kinematics, self.poses(self.high * u), *ends, u)
        assert solved.all()
        return q


WAYS = [
    ((0.0, 0.0, -0.1), (0.0, 0.0, 0.1), 0.4),
    ((0.1, -0.2, -0.05), (0.08, -0.05, 0.02), -0.3),
    ((0.0, 0.0, 0.0), (0.1, 0.1, 0.0), 0.0),
]


@ARMS
@pytest.mark.parametrize(("below", "way", "turn"), WAYS)
@pytest.mark.parametrize("high", [0.04, 0.12])
def test_bounds_hold_along_the_interval_and_are_close(arm: str, below: Any, way: Any, turn: float, high: float) -> None:
    interval = Interval(arm, below, way, turn=turn, high=high)
    found, q = interval.tube(), interval.motion()
    assert found.good.all()
    assert found.between.all()
    middle = len(q) // 2
    np.testing.assert_allclose(found.q[0], q[middle], atol=1e-9)
    speed = np.abs(np.diff(q, axis=0)).max(axis=0) / (high / (len(q) - 1))
    assert (speed <= found.rate[0] + 1e-9).all()
    assert (found.rate[0] <= speed + 0.15 * speed.max()).all()
    sigma = interval.kinematics.singular_values(q)[:, -1]
    assert found.sigma_middle[0] == pytest.approx(sigma[middle])
    assert 0.75 * sigma.min() <= found.sigma_min[0] <= sigma.min() + 1e-12
    share = np.linspace(0.0, 1.0, middle + 1)[:, None]
    farthest = 0.0
    for first, last in ((0, middle), (middle, len(q) - 1)):
        chord = (1.0 - share) * q[first] + share * q[last]
        away = np.abs(q[first : last + 1] - chord).max(axis=0)
        one_way = (np.diff(q, axis=0) > 0.0).all(axis=0) | (np.diff(q, axis=0) < 0.0).all(axis=0)
        assert ((away <= found.sway[0] + 1e-9) | one_way).all()
        farthest = max(farthest, float(away.max()))
    assert found.sway.max() <= 1.5 * farthest + 1e-6


@ARMS
def test_a_turn_about_an_axis_through_the_tool_moves_it_no_further(arm: str) -> None:
    """The tool's lever lies along the axis, so its length hardly counts."""
    way = (0.0, 0.0, 0.1)
    near, above = (Interval(arm, below, way, turn=0.4, high=0.04).tube() for below in ((0, 0, 0), (0, 0, -1.0)))
    lost = [1.0 - float(found.sigma_min[0] / found.sigma_middle[0]) for found in (near, above)]
    assert lost[1] < 1.35 * lost[0]


@ARMS
def test_half_the_interval_has_a_quarter_of_the_sway_and_half_the_loss(arm: str) -> None:
    tubes_of = [Interval(arm, *WAYS[1][:2], turn=0.3, high=high).tube() for high in (0.02, 0.04, 0.08)]
    lost = [1.0 - float(found.sigma_min[0] / found.sigma_middle[0]) for found in tubes_of]
    assert lost[0] == pytest.approx(0.5 * lost[1], rel=0.1)
    assert lost[1] == pytest.approx(0.5 * lost[2], rel=0.2)
    sway = [found.sway[0] for found in tubes_of]
    bent = (sway[0] > 0.0) & (sway[1] > 0.0)
    np.testing.assert_allclose(sway[0][bent], 0.25 * sway[1][bent], rtol=0.15)


@ARMS
def test_ends_on_another_branch_or_a_jump_prove_nothing(arm: str) -> None:
    off = Interval(arm, *WAYS[0][:2], turn=0.4, high=0.04, off=0.3).tube()
    assert not off.good.any()
    assert np.isinf(off.rate).all()
    assert off.sigma_min[0] == 0.0
    jump = Interval(arm, *WAYS[0][:2], turn=0.4, high=0.0).tube()
    assert not jump.good.any()
    assert jump.sigma_middle[0] > 0.0
