"""Arms let go and attach in the physics engine: grips latch where tools are, and the drives hand the weight over."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import limited_once

from coopqp import ControlStep, InvalidInputError, LinePath, QPController
from coopqp.programs import Phase, Program, Travels
from coopqp.scenarios import draw_on_plate, hand_over, paper_lift, pliers
from coopqp.simulation import PhysicsPlant, simulate

pytest.importorskip("mujoco")


def three_two_three() -> Any:
    """Up with three arms; the third goes over while two hold; up with three."""
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    X, here = task.grasp.T_object_tool[2], task.path.start
    over = {"slave_2": Travels(to=pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0])))}
    up = LinePath.displaced(here, translation=(0.0, 0.0, 0.05), duration=1.0)
    on = LinePath.displaced(up.goal, translation=(0.0, 0.0, 0.05), duration=1.0)
    phases = [Phase("up", path=up), Phase("over", arms=over, duration=1.5), Phase("on", path=on)]
    return replace(task, path=Program(task.cell, task.grasp, phases))


@pytest.mark.parametrize("make", [three_two_three, hand_over])
def test_forces_after_an_arm_has_attached_are_those_before_it_let_go(make: Any) -> None:
    task = make()
    plant = PhysicsPlant.of(task)
    (leaves, attaches), forces = task.path.grasps.changes, list[tuple[float, Any]]()

    def see(step: ControlStep) -> None:
        forces.append((step.clock, np.linalg.norm(plant.wrenches()[:, :3], axis=1)))

    controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
    recording = simulate(controller, plant, q_start=task.q_start, observe=see, settle=0.5)
    assert recording.finished
    assert plant.gripped
    before = max(f.max() for clock, f in forces if clock < leaves - 0.01)
    after = max(f.max() for clock, f in forces if clock >= attaches)
    assert after < 1.3 * before
    weight = 9.81 * task.object_mass
    apart = 0 if make is hand_over else 2
    for clock, f in forces:
        if leaves + 0.01 < clock < attaches - 0.01:
            assert f[apart] < 1.0  # its grip is open
            assert f.sum() > 0.9 * weight
    moved = task.path.grasp_at(task.grasp, task.path.duration).T_object_tool[apart]
    there = plant.T_world_object.actInv(plant.T_world_tool[apart])
    assert np.linalg.norm(there.translation - moved.translation) < 2e-3


def test_an_arm_that_does_not_hold_at_first_bears_nothing_from_the_start() -> None:
    task = draw_on_plate()
    plant = PhysicsPlant.of(task)
    plant.reset(task.q_start)
    forces = plant.wrenches()[:, :3]
    assert np.abs(forces[2]).max() == 0.0
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, 9.81 * task.object_mass], atol=0.5)
    for holds in ((True, False), (False, False, False)):
        with pytest.raises(InvalidInputError, match="holds"):
            PhysicsPlant.of(task, holds=holds)


def test_an_object_does_not_swing_on_the_arms_that_still_hold_it() -> None:
    """The measured path correction takes damping from the drives: slower while fewer arms hold, it leaves enough."""
    task = hand_over()
    plant, turned = PhysicsPlant.of(task), list[tuple[float, float]]()

    def see(step: ControlStep) -> None:
        away = task.path.pose(step.clock).actInv(plant.T_world_object)
        turned.append((step.clock, float(np.linalg.norm(pin.log3(away.rotation)))))

    simulate(QPController(task.cell, task.grasp, task.path, dt=0.004), plant, q_start=task.q_start, observe=see)
    early, late = (max(x for at, x in turned if low < at < low + 0.3) for low in (0.9, 2.0))
    assert late < 1.05 * early  # 4 times as much with the time constant of three arms


def test_what_the_engine_cannot_follow_is_refused_by_name() -> None:
    task = pliers()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
    with pytest.raises(InvalidInputError, match="moves on the object while it holds it, and the object is rigid"):
        simulate(controller, PhysicsPlant.of(task), q_start=task.q_start)
