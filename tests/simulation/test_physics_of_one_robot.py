"""The engine with arms that share joints: one robot with each joint once, and what its drives carry."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp, InvalidInputError, QPController, RobotCell, Status
from coopqp.model import CellState
from coopqp.scenarios import Scenario, paper_lift, torso_lift, two_on_a_rail
from coopqp.simulation import Disturbances, PhysicsPlant
from coopqp.spatial import Array


def tools_off(plant: PhysicsPlant) -> float:
    """How far the engine's tools are from the kinematics of its joints [m, and rotation matrix entries]."""
    state = CellState(plant.cell, plant.cell.configuration(plant.positions))
    placed = zip(state.T_world_tool, plant.T_world_tool, strict=True)
    return max(float(np.abs(own.homogeneous - seen.homogeneous).max()) for own, seen in placed)


@pytest.mark.slow
@pytest.mark.parametrize(("make", "squeeze"), [(torso_lift, 8.0), (two_on_a_rail, 3.0)])
def test_a_robot_with_shared_joints_runs_to_its_end(make: Callable[[], Scenario], squeeze: float) -> None:
    s = make()
    plant = PhysicsPlant.of(s)
    model = plant.mj_model
    moving = [model.joint(j).name for j in range(model.njnt) if model.joint(j).name != "object"]
    assert sorted(moving) == sorted(s.cell.joint_names)
    assert model.body_subtreemass[0] == pytest.approx(pin.computeTotalMass(s.cell.model) + base(s) + s.object_mass)
    controller = QPController(s.cell, s.grasp, s.path, dt=s.dt)
    q = plant.reset(s.q_start)
    controller.reset(q)
    steps, off, forces = 0, 0.0, list[Array]()
    while not (step := controller.step(q)).finished:
        q, steps = plant.apply(step), steps + 1
        assert step.status in (Status.TRACKING, Status.SLOWED)
        assert step.rate > 0.5
        off = max(off, tools_off(plant))
        wrenches = plant.wrenches()
        forces.append(0.5 * (wrenches[0] - wrenches[1])[:3])
    assert steps * s.dt == pytest.approx(s.path.duration, rel=0.05)
    assert off < 1e-12
    assert np.linalg.norm(forces, axis=1).max() < squeeze
    end = s.path.pose(s.path.duration).actInv(plant.T_world_object)
    assert np.linalg.norm(end.translation) < 5e-4


def base(s: Scenario) -> float:
    """Mass of the links that no joint moves [kg]."""
    return float(s.cell.arms[0].model.inertias[0].mass)


@pytest.mark.parametrize("make", [torso_lift, two_on_a_rail])
def test_at_rest_the_servos_carry_nothing(make: Callable[[], Scenario]) -> None:
    """The drives know the weight of the robot and of the load: a shared joint bears both arms and the object."""
    s = make()
    plant = PhysicsPlant.of(s)
    q = plant.reset(s.q_start)
    np.testing.assert_allclose(q, s.q_start, atol=1e-8)
    np.testing.assert_allclose(plant.servo_torques, 0.0, atol=1e-3)
    # The weight of all that hangs on each joint, by the engine's own masses: object and arms as one tree.
    model = s.cell.model.copy()
    share = pin.Inertia.FromBox(0.5 * s.object_mass, *s.object_size)
    for joint, T, X in zip(s.cell.tool_joints, s.cell.T_joint_tool, s.grasp.T_object_tool, strict=True):
        model.inertias[joint] = model.inertias[joint] + (T * X.inverse()).act(share)
    weight = pin.computeGeneralizedGravity(model, model.createData(), q)
    shared = s.cell.shared
    np.testing.assert_allclose(plant.joint_torques[shared], weight[shared], atol=1e-3)


@pytest.mark.parametrize("servo", ["computed torque", "disturbance observer"])
def test_torques_drive_shared_joints(servo: str) -> None:
    s = torso_lift()
    plant = PhysicsPlant.of(s, options={"servo": servo})
    controller = QPController(s.cell, s.grasp, s.path, dt=s.dt)
    q = plant.reset(s.q_start)
    controller.reset(q)
    for _ in range(100):
        step = controller.step(q)
        q = plant.apply(step)
    assert tools_off(plant) < 1e-12
    away = s.path.pose(step.clock_next).actInv(plant.T_world_object)
    assert np.linalg.norm(away.translation) < 1e-3
    squeeze = 0.5 * (plant.wrenches()[0] - plant.wrenches()[1])
    assert np.linalg.norm(squeeze[:3]) < 5.0


def test_a_robot_has_one_base() -> None:
    s = torso_lift()
    offset = pin.SE3(np.eye(3), np.array([1e-3, 0.0, 0.0]))
    plants = [
        PhysicsPlant.of(s, disturbances=Disturbances(base_offset=given))
        for given in ({"left": offset}, {"right": offset}, {"left": offset, "right": offset})
    ]
    for plant in plants:
        plant.reset(s.q_start)
        placed = zip(plant.T_world_tool, CellState(s.cell, s.q_start).T_world_tool, strict=True)
        for real, nominal in placed:
            np.testing.assert_allclose(real.translation - nominal.translation, [1e-3, 0.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(plant.servo_torques, 0.0, atol=1e-3)  # nothing parts the arms
    two = Disturbances(base_offset={"left": offset, "right": offset.inverse()})
    with pytest.raises(InvalidInputError, match="robot 'lift' has one base and is given two offsets"):
        PhysicsPlant.of(s, disturbances=two)


def test_an_arm_beside_a_robot_keeps_its_own_base() -> None:
    s, other = torso_lift(), paper_lift()
    cell = RobotCell([other.cell.arms[0], *s.cell.arms])
    q = cell.configuration(np.concatenate([other.q_start[:6], s.cell.positions(s.q_start)]))
    grasp = Grasp.from_configuration(cell, q, s.path.pose(0.0))
    plant = PhysicsPlant(cell, grasp, object_size=(0.05, 0.6, 0.05), object_mass=3.0)
    np.testing.assert_allclose(plant.reset(q), q, atol=1e-6)
    np.testing.assert_allclose(plant.servo_torques, 0.0, atol=1e-2)
    assert tools_off(plant) < 1e-12
