"""The torques that carry the object: of the arms that bear it, and on the way from some arms to others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.model import CellState
from coopqp.scenarios import Scenario
from coopqp.simulation import PhysicsOptions
from coopqp.simulation.plants.load_feed_forward import LoadFeedForward
from coopqp.spatial import Array

MASS, CENTRE = 7.0, np.array([0.05, -0.1, 0.2])


def made(task: Scenario, **options: Any) -> LoadFeedForward:
    return LoadFeedForward(
        task.cell, task.grasp, PhysicsOptions(**options), object_mass=MASS, centre=CENTRE, load=None,
        armature=np.zeros(task.cell.nv),
    )  # fmt: skip


def wrenches_of(task: Scenario, torque: Array) -> tuple[Array, Array]:
    """Of torques (nv,): each arm's force on the object, and its moment about the centre of mass (N, 3)."""
    state = CellState(task.cell, task.q_start)
    O = state.T_world_tool[0] * task.grasp.T_object_tool[0].inverse()
    centre, forces, moments = O.act(CENTRE), [], []
    for k, (T, own) in enumerate(zip(state.T_world_tool, task.cell.v_slices, strict=True)):
        w = np.linalg.solve(state.jacobian(k).T, torque[own])  # at the tool, in its axes
        f, m = T.rotation @ w[:3], T.rotation @ w[3:]
        forces.append(f)
        moments.append(m + np.cross(T.translation - centre, f))
    return np.array(forces), np.array(moments)


@pytest.mark.parametrize("bears", [(True, True, True), (True, False, True), (False, True, False)])
@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (1.0, -2.0, -3.0)])
def test_the_arms_that_bear_the_object_carry_its_weight_and_no_moment_is_left(
    lift: Scenario, bears: tuple[bool, ...], gravity: Any
) -> None:
    drives = made(lift, gravity=gravity)
    drives.hand_over(bears, lift.grasp, 1.0)
    forces, moments = wrenches_of(lift, drives.torque(lift.q_start))
    weight = -MASS * np.array(gravity)
    np.testing.assert_allclose(forces.sum(axis=0), weight, atol=1e-9)
    np.testing.assert_allclose(moments.sum(axis=0), 0.0, atol=1e-9)
    idle = ~np.array(bears)
    np.testing.assert_allclose(forces[idle], 0.0, atol=1e-9)
    np.testing.assert_allclose(moments[idle], 0.0, atol=1e-9)


def test_the_load_goes_over_evenly_and_stays_where_it_went(lift: Scenario) -> None:
    """In parts of the way, however long each is; the last one ends it. A way may begin in the middle of another."""
    drives, q = made(lift), lift.q_start
    whole = drives.torque(q)
    two, one = made(lift), made(lift)
    two.hand_over((True, False, True), lift.grasp, 1.0)
    one.hand_over((False, True, False), lift.grasp, 1.0)
    done = 0.0
    for part in (0.1, 0.25, 0.5, 0.4, 0.3):
        drives.hand_over((True, False, True), lift.grasp, part)
        done = min(done + part, 1.0)
        np.testing.assert_allclose(drives.torque(q), whole + done * (two.torque(q) - whole), atol=1e-9)
    for part, expected in ((0.5, 0.5), (0.25, 0.75)):
        drives.hand_over((False, True, False), lift.grasp, part)
        np.testing.assert_allclose(
            drives.torque(q), two.torque(q) + expected * (one.torque(q) - two.torque(q)), atol=1e-9
        )
    begun = drives.torque(q)
    drives.hand_over((True, True, True), lift.grasp, 0.5)
    np.testing.assert_allclose(drives.torque(q), 0.5 * (begun + whole), atol=1e-9)
    drives.reset()
    np.testing.assert_allclose(drives.torque(q), whole, atol=1e-12)


def test_shares_that_are_told_are_kept_and_the_moment_they_leave_is_shared(lift: Scenario) -> None:
    shares = (0.5, 0.2, 0.3)
    drives = made(lift, load_shares=shares)
    forces, moments = wrenches_of(lift, drives.torque(lift.q_start))
    np.testing.assert_allclose(forces, np.outer(shares, [0.0, 0.0, 9.81 * MASS]), atol=1e-9)
    np.testing.assert_allclose(moments.sum(axis=0), 0.0, atol=1e-9)
    before = drives.torque(lift.q_start)
    drives.hand_over((True, False, True), lift.grasp, 1.0)
    drives.hand_over((True, True, True), lift.grasp, 1.0)
    np.testing.assert_allclose(drives.torque(lift.q_start), before, atol=1e-9)


def test_what_the_drives_assume_of_the_load_scales_what_they_feed_forward(lift: Scenario) -> None:
    whole = made(lift).torque(lift.q_start)
    assert np.abs(whole).max() > 1.0
    np.testing.assert_allclose(made(lift, assumed_payload=0.4).torque(lift.q_start), 0.4 * whole)
    assert not made(lift, load_feed_forward=False).torque(lift.q_start).any()


def test_where_the_tools_have_moved_on_the_object_the_moment_follows(lift: Scenario) -> None:
    """An arm that bears the object alone, at another place on it than its grasp says."""
    moved = pin.SE3(np.eye(3), np.array([0.1, 0.2, -0.05]))
    drives, still = made(lift), made(lift)
    drives.hand_over((False, True, False), lift.grasp.moved_by([moved] * 3), 1.0)
    still.hand_over((False, True, False), lift.grasp, 1.0)
    (there, turned), (here, level) = (wrenches_of(lift, d.torque(lift.q_start)) for d in (drives, still))
    np.testing.assert_allclose(there, here, atol=1e-9)
    O = CellState(lift.cell, lift.q_start).T_world_tool[0] * lift.grasp.T_object_tool[0].inverse()
    before = lift.grasp.T_object_tool[1]
    off = O.rotation @ ((moved * before).translation - before.translation)
    np.testing.assert_allclose((turned - level)[1], np.cross(-off, here[1]), atol=1e-8)
