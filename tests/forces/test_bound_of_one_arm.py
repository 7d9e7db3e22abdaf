"""The bound of the speed by the load, where it has a closed form: one arm, whose torques are lines in σ² and σ̇."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from coopqp import Grasp, Knot, RobotCell
from coopqp.forces import LoadBound, LoadShare
from coopqp.model import CellState
from coopqp.planning import Payload
from coopqp.spatial import Array


class Arm:
    """An arm that moves a body along a path, and its torques ``c + b z + a σ̇``: those with the body on it."""

    def __init__(self, make_cell: Callable[..., RobotCell], seed: int, speed: float) -> None:
        rng = np.random.default_rng(seed)
        self.cell, self.speed = make_cell(["arm7"]), speed
        self.q = self.cell.configuration([0.1, 0.5, -0.2, -1.2, 0.3, 0.8, 0.2])
        self.grasp = Grasp((pin.SE3(pin.exp3(np.array([0.3, 0.1, -0.2])), np.array([0.05, 0.02, 0.1])),))
        half = rng.normal(size=(3, 3))
        inertia, centre = 0.05 * half @ half.T, rng.uniform(-0.1, 0.1, 3)
        self.slope, self.curvature = speed * rng.normal(size=7), speed**2 * rng.normal(size=7)
        model = self.cell.model.copy()
        joint, T, X = self.cell.tool_joints[0], self.cell.T_joint_tool[0], self.grasp.T_object_tool[0]
        model.inertias[joint] = model.inertias[joint] + (T * X.inverse()).act(pin.Inertia(4.0, centre, inertia))
        data, none = model.createData(), np.zeros(7)
        self.c = np.array(pin.rnea(model, data, self.q, none, none))
        self.b = np.array(pin.rnea(model, data, self.q, self.slope, self.curvature)) - self.c
        self.a = np.array(pin.rnea(model, data, self.q, none, self.slope)) - self.c
        self.limits = np.abs(self.c) + rng.uniform(10.0, 60.0, 7)
        payload = Payload(mass=4.0, centre=centre, inertia=inertia, torque=self.limits)
        self.load = LoadShare(self.cell, self.grasp, payload, internal_force=1e3)
        self.knot = Knot(0.0, CellState(self.cell, self.q), self.slope, self.curvature)

    def used(self, z: float, change: float) -> float:
        return float((np.abs(self.c + self.b * z + self.a * change) / self.limits).max())

    def furthest(self, way: Any) -> Array:
        """The admissible (z, σ̇) that is furthest in a direction."""
        rows = np.vstack([np.column_stack([self.b, self.a]), -np.column_stack([self.b, self.a])])
        room = np.concatenate([self.limits - self.c, self.limits + self.c])
        found = linprog(-np.asarray(way), A_ub=rows, b_ub=room, bounds=[(0.0, None), (None, None)])
        assert found.status == 0
        return np.asarray(found.x)


@pytest.fixture(params=[(1, 0.5), (2, 3.0)], ids=["slow", "quick"])
def arm(request: pytest.FixtureRequest, make_cell: Callable[..., RobotCell]) -> Arm:
    return Arm(make_cell, *request.param)


def test_corners_use_all_of_a_torque(arm: Arm) -> None:
    """From the least change at rest to the largest one; between them as many as there are directions."""
    bound = LoadBound(arm.load)
    corners = bound.polygon(arm.knot)
    assert corners is not None
    assert corners.shape == (bound.directions + 2, 2)
    np.testing.assert_allclose([arm.used(z, change) for z, change in corners], 1.0, atol=1e-6)
    at_rest = np.concatenate([(s * arm.limits - arm.c) / arm.a for s in (-1.0, 1.0)])
    least, most = at_rest[at_rest < 0.0].max(), at_rest[at_rest > 0.0].min()
    np.testing.assert_allclose(corners[[0, -1]], [[0.0, least], [0.0, most]], rtol=1e-6, atol=1e-9)
    assert corners[:, 0].min() >= 0.0


def test_more_directions_leave_less_of_what_is_admissible(arm: Arm) -> None:
    scale = np.abs([arm.furthest(way) for way in ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0))]).max(axis=0)
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 91)
    exact = np.array([arm.furthest(np.array([np.cos(x), np.sin(x)]) / scale) for x in angles])
    whole = ConvexHull(np.vstack([exact, [0.0, exact[0, 1]], [0.0, exact[-1, 1]]]) / scale).volume
    shares = []
    for directions in (3, 9, 40):
        corners = LoadBound(arm.load, directions=directions).polygon(arm.knot)
        assert corners is not None
        assert len(corners) == directions + 2
        shares.append(ConvexHull(corners / scale, qhull_options="QJ").volume / whole)
    assert 0.2 < shares[0] <= shares[1] + 1e-6 <= shares[2] + 2e-6 < 1.01
    assert shares[2] > (0.97 if arm.speed == 0.5 else 0.4), (
        "what is quick is long and thin: few directions meet a corner"
    )
    assert LoadBound(arm.load).directions == 9
    assert LoadBound(arm.load, directions=1).directions == 3


def test_lines_are_the_sides_of_the_polygon(arm: Arm) -> None:
    """Each through two corners, and all corners and rest on its one side."""
    bound = LoadBound(arm.load)
    corners = bound.polygon(arm.knot)
    assert corners is not None
    a, b, c = bound.lines(arm.knot)
    room = c[:, None] - np.outer(a, corners[:, 0]) - np.outer(b, corners[:, 1])
    scale = np.abs(np.outer(a, corners[:, 0])).max(axis=1) + np.abs(c)
    assert (room / scale[:, None] > -1e-7).all()
    assert ((room / scale[:, None] < 1e-7).sum(axis=1) >= 2).all()
    assert (c > 0.0).all()
    middle = corners.mean(axis=0)
    for z, change in middle + 1.01 * (corners[1:-1] - middle):
        assert (a * z + b * change > c).any()
    for z, change in middle + 0.99 * (corners - middle):
        assert (a * z + b * change < c).all()
    np.testing.assert_allclose(LoadBound(arm.load, share=0.5).lines(arm.knot)[2], 0.5 * c)


def test_what_moves_nothing_is_bounded_all_the_same(make_cell: Callable[..., RobotCell]) -> None:
    """At a point where the path rests, and joints do not move: no line is nan, and rest is admissible."""
    arm = Arm(make_cell, 1, 1.0)
    a, b, c = LoadBound(arm.load).lines(Knot(0.0, arm.knot.state, np.zeros(7), np.zeros(7)))
    assert np.isfinite([a, b, c]).all()
    assert (c >= 0.0).all()
