"""Arms that share joints relax the forces between them: in the engine, with a grip that is off."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp, QPController, QPOptions, Status, SupervisionOptions, inverse_kinematics
from coopqp.forces import ForceController, internal_wrenches
from coopqp.scenarios import Scenario, torso_lift, two_on_a_rail
from coopqp.simulation import Disturbances, PhysicsPlant, misplaced
from coopqp.simulation.engine import box_payload
from coopqp.spatial import Array

#: A grip with an error of 1 mm and 0.1°.
OFF = pin.SE3(pin.exp3(np.deg2rad(0.1) * np.ones(3) / np.sqrt(3)), 1e-3 * np.ones(3) / np.sqrt(3))


def internal(plant: PhysicsPlant, grasp: Grasp) -> float:
    """The largest internal force [N]."""
    return float(np.linalg.norm(internal_wrenches(plant.sensed_wrenches(), grasp)[:, :3], axis=1).max())


def run(s: Scenario, plant: PhysicsPlant, q_start: Array) -> tuple[ForceController, Array, int]:
    """The internal force after each step until 2 s after the path's end, and the number of steps to that end."""
    inner = QPController(s.cell, s.grasp, s.path, dt=s.dt)
    made = ForceController(inner, {"stiffness": plant.stiffness, "payload": box_payload(s)})
    q = plant.reset(q_start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it starts off its grasp
        made.reset(q)
    forces, end, w = [internal(plant, s.grasp)], 0, plant.measured_wrenches()
    while not end or (len(forces) - end) * s.dt < 2.0:
        step = made.step(q, wrenches=w)
        q, w = plant.apply(step), plant.measured_wrenches()
        forces.append(internal(plant, s.grasp))
        if not end and step.clock_next >= s.path.duration:
            end = len(forces)
        assert step.status not in (Status.FAULT, Status.HOLDING), step.reason
        assert len(forces) * s.dt < 2.0 * s.path.duration + 10.0
    return made, np.array(forces), end


@pytest.mark.slow
@pytest.mark.parametrize(("make", "arm"), [(torso_lift, "left"), (two_on_a_rail, "right"), (two_on_a_rail, "")])
def test_a_grip_that_is_off_is_relaxed(make: Callable[[], Scenario], arm: str) -> None:
    """Gripped where the tools are: from the first command on. Pulled onto the grasp: what that pulls is relaxed."""
    s = make()
    real = misplaced(s.cell, s.grasp, {arm: OFF}) if arm else s.grasp
    held = inverse_kinematics(s.cell, real, s.path.pose(0.0), s.q_start)
    made, forces, end = run(s, PhysicsPlant.of(s, real_grasp=real), held)
    assert forces.max() <= 12.0
    assert forces[end + round(1.0 / s.dt) :].max() <= 5.0
    assert made.stiffer == pytest.approx(1.0, abs=0.1)
    if arm:
        _, forces, end = run(s, PhysicsPlant.of(s, real_grasp=real), s.q_start)
        assert forces.max() <= 30.0
        assert forces[end + round(1.0 / s.dt) :].max() <= 5.0


def test_a_flipped_sensor_is_named_before_the_object_moves() -> None:
    """Presses between arms that share a joint tell what each sensor reads."""
    s = torso_lift()
    plant = PhysicsPlant.of(s, disturbances=Disturbances(wrench_gain={"right": -1.0}))
    made = ForceController(
        QPController(s.cell, s.grasp, s.path, dt=s.dt), {"stiffness": plant.stiffness, "payload": box_payload(s)}
    )
    q = plant.reset(s.q_start)
    made.reset(q)
    w, forces = plant.measured_wrenches(), [0.0]
    for _ in range(round(6.0 / s.dt)):
        step = made.step(q, wrenches=w)
        q, w = plant.apply(step), plant.measured_wrenches()
        forces.append(internal(plant, s.grasp))
    assert step.clock_next == 0.0
    assert "right" in step.reason
    assert made.sensors is not None
    assert max(forces) < 12.0


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_gripped_arm_that_stops_is_seen(arm: str) -> None:
    """Its own joints stop while the lift goes on: with the servos' stiffness the object is held at once."""
    s, stops = torso_lift(), 2.0
    plant = PhysicsPlant.of(s, disturbances=Disturbances(stall={arm: stops}))
    options = QPOptions(supervision=SupervisionOptions(stiffness=plant.stiffness))
    made = QPController(s.cell, s.grasp, s.path, dt=s.dt, options=options)
    q, forces, held = plant.reset(s.q_start), list[float](), 0.0
    made.reset(q)
    while plant.time < stops + 1.0:
        step = made.step(q)
        if step.status in (Status.HOLDING, Status.FAULT) and not held:
            assert plant.time > stops, step.reason
            held, said = plant.time, step.reason
        q = plant.apply(step)
        forces.append(internal(plant, s.grasp))
    assert 0.0 < held - stops <= 0.025
    assert arm in said
    assert max(forces) < 1700.0  # all brake together; without the stiffness it is found 30 ms later, at 2.7 kN
