"""Torques of joints that arms share, by inverse dynamics of the robot's own description with forces at its tools."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp
from coopqp.errors import UnreachableError
from coopqp.forces import LoadShare
from coopqp.model import CellState
from coopqp.planning import Payload, plan
from coopqp.planning.knots import Knots
from coopqp.planning.payload import torque_lines
from coopqp.scenarios import Scenario, robot_path, torso_lift, two_on_a_rail
from coopqp.spatial import Array

ROBOTS = {"torso_lift": (torso_lift, "lift2"), "two_on_a_rail": (two_on_a_rail, "rail2")}
PAYLOAD = Payload(mass=7.0, centre=(0.02, 0.05, -0.03), inertia=np.diag([0.3, 0.1, 0.2]))


class Whole:
    """The robot as its URDF has it, moved as the cell is, with wrenches of its tools on an object."""

    def __init__(self, s: Scenario, urdf: Path) -> None:
        self.model = pin.buildModelFromUrdf(str(urdf))
        self._data = self.model.createData()
        self._cell, self._grasp = s.cell, s.grasp
        names = [joint.partition("/")[2] for joint in s.cell.joint_names]
        self._at = [self.model.joints[self.model.getJointId(name)].idx_v for name in names]
        self._tools = [self.model.getFrameId(arm.tool_frame) for arm in s.cell.arms]

    def spread(self, v: Array) -> Array:
        out = np.empty(len(v))
        out[self._at] = v
        return out

    def torques(self, q: Array, v: Array, dv: Array, wrenches: Array) -> Array:
        """Of all joints (nv,) in the cell's order, for wrenches (N, 6) on the object in its own frame."""
        x = pin.integrate(self.model, pin.neutral(self.model), self.spread(self._cell.positions(q)))
        forces = [pin.Force.Zero() for _ in range(self.model.njoints)]
        for frame, X, w in zip(self._tools, self._grasp.T_object_tool, wrenches, strict=True):
            tool = self.model.frames[frame]
            at_joint = (tool.placement * X.inverse()).act(pin.Force(-w))
            forces[tool.parentJoint] = forces[tool.parentJoint] + at_joint
        own: Array = pin.rnea(self.model, self._data, x, self.spread(v), self.spread(dv), forces)
        return own[self._at]


def random_of(name: str, seed: int) -> tuple[Scenario, Whole, np.random.Generator, Grasp, Array]:
    """A configuration at random, and the grasp of the arms there."""
    make, urdf = ROBOTS[name]
    s, rng = make(), np.random.default_rng(seed)
    x = s.cell.positions(s.q_start) + rng.uniform(-0.3, 0.3, s.cell.nv)
    q = s.cell.configuration(x)
    grasp = Grasp.from_configuration(s.cell, q, pin.exp6(rng.normal(size=6)))
    s = dataclasses.replace(s, grasp=grasp)
    return s, Whole(s, robot_path(urdf)), rng, grasp, q


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("seed", range(5))
def test_shared_loads_are_those_of_the_whole_robot(name: str, seed: int) -> None:
    s, whole, rng, grasp, q = random_of(name, seed)
    load = LoadShare(s.cell, grasp, PAYLOAD, internal_force=1e9)
    V, a = 0.3 * rng.normal(size=6), rng.normal(size=6)
    v, dv = load.joint_motion(q, twist=V, acceleration=a)
    moved = load.object_motion(q, v, dv)
    np.testing.assert_allclose(moved, (V, a), atol=1e-9)
    shared = load.share(q, twist=V, acceleration=a)
    expected = whole.torques(q, v, dv, shared.wrenches)
    np.testing.assert_allclose(shared.torques, expected, atol=1e-9 * np.abs(expected).max())
    # Both arms move the object: the second as the first.
    state, h = CellState(s.cell, q), 1e-7
    after = CellState(s.cell, s.cell.moved(q, h * v))
    for X, T, T_after in zip(grasp.T_object_tool, state.T_world_tool, after.T_world_tool, strict=True):
        twist = pin.log6((T * X.inverse()).actInv(T_after * X.inverse())).vector / h
        np.testing.assert_allclose(twist, V, atol=1e-5)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_squeeze_costs_a_shared_joint_nothing(name: str) -> None:
    s, whole, rng, grasp, q = random_of(name, 11)
    load = LoadShare(s.cell, grasp, dataclasses.replace(PAYLOAD, torque=1e9), internal_force=1e9)
    still, joints = load.share(q), s.cell.shared
    wanted = 600.0 * rng.normal(size=6)
    squeezed = load.share(q, internal=[wanted, -wanted])
    assert np.linalg.norm(squeezed.internal[0, :3]) > 50.0
    scale = np.abs(squeezed.torques).max()
    np.testing.assert_allclose(squeezed.torques[joints], still.torques[joints], atol=1e-10 * scale)
    assert np.abs(squeezed.torques - still.torques).max() > 10.0
    # Gravity behind it, and the weight of the load.
    zero = np.zeros(s.cell.nv)
    alone = whole.torques(q, zero, zero, np.zeros((2, 6)))
    if name == "torso_lift":
        np.testing.assert_allclose(squeezed.torques[joints] - alone[joints], PAYLOAD.mass * 9.81, rtol=1e-9)


def test_a_lift_that_is_too_weak_is_named() -> None:
    s = torso_lift()
    weak = Payload(mass=20.0, torque=[700.0, *[1e4] * 12])  # the lift bears 62 kg, and the load
    shared = LoadShare(s.cell, s.grasp, weak, internal_force=50.0).share(s.q_start)
    assert not shared.feasible
    assert str(shared.binding[0]) == "arm lift joint lift: torque"
    load = LoadShare(s.cell, s.grasp, Payload(mass=20.0, torque=[600.0, *[1e4] * 12]), internal_force=50.0)
    with pytest.raises(UnreachableError, match="arm lift: joint lift needs 610"):
        load.share(s.q_start)


@pytest.mark.parametrize("name", ROBOTS)
def test_torques_along_a_path_are_those_of_the_whole_robot(name: str) -> None:
    s, whole, rng, grasp, q = random_of(name, 5)
    slope, curvature = rng.normal(size=(2, s.cell.nv))
    x = s.cell.positions(q)
    knots = Knots(np.zeros(1), x[None], slope[None], curvature[None])
    a, b, c = torque_lines(s.cell, grasp, PAYLOAD, knots)
    speed, change = 0.7, -1.3
    v, dv = speed * slope, change * slope + speed**2 * curvature
    wrenches = carried(s, grasp, q, v, dv)
    expected = whole.torques(q, v, dv, wrenches)
    np.testing.assert_allclose((a * change + b * speed**2 + c)[0], expected, atol=1e-9 * np.abs(expected).max())


def carried(s: Scenario, grasp: Grasp, q: Array, v: Array, dv: Array) -> Array:
    """Newton and Euler of each arm's half of the payload on its own tool: wrenches (N, 6) in the object frame."""
    model, data = s.cell.model, s.cell.model.createData()
    pin.forwardKinematics(model, data, q, v, dv)
    m, c, J = 0.5 * PAYLOAD.mass, np.asarray(PAYLOAD.centre), 0.5 * np.asarray(PAYLOAD.inertia)
    out = []
    for X, frame in zip(grasp.T_object_tool, s.cell.tool_frames, strict=True):
        T = pin.updateFramePlacement(model, data, frame)
        R = (T * X.inverse()).rotation
        V = X.action @ pin.getFrameVelocity(model, data, frame, pin.LOCAL).vector
        A = X.action @ pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
        w, dw = V[3:], A[3:]
        origin = A[:3] + np.cross(w, V[:3])
        force = m * (origin + np.cross(dw, c) + np.cross(w, np.cross(w, c)) - R.T @ [0.0, 0.0, -9.81])
        out.append(np.concatenate([force, J @ dw + np.cross(w, J @ w) + np.cross(c, force)]))
    return np.array(out)


@pytest.mark.slow
def test_a_plan_keeps_the_torque_of_the_lift() -> None:
    """The lift may give little more than the weight: it binds, and no torque of the whole robot is above its limit."""
    s = torso_lift()
    data = s.cell.model.createData()
    weight = pin.computeGeneralizedGravity(s.cell.model, data, s.q_start)[0] + s.object_mass * 9.81
    torque = np.asarray(s.cell.model.effortLimit).copy()
    free = plan(s.cell, s.grasp, s.path, q_start=s.q_start)
    torque[0] = weight + 15.0
    kept = plan(s.cell, s.grasp, s.path, q_start=s.q_start, payload=Payload(mass=s.object_mass, torque=torque))
    assert kept.path.duration > free.path.duration
    assert "lift" in {b.joint for b in kept.path.profile.binding if b is not None and b.kind.name == "TORQUE"}
