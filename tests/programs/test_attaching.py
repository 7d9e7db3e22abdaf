"""An arm that attaches has to be where it grasps: refused beyond a tolerance, and latched where it is within it."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import limited_once

from coopqp import Cause, ControlStep, InvalidInputError, QPController, Status, inverse_kinematics
from coopqp.programs import Phase, Program, Travels
from coopqp.scenarios import paper_lift

ATTACHES = 2.0
DT = 0.005


def regrasp(**more: Any) -> tuple[Any, Program]:
    """The third arm grasps elsewhere in 2 s while the plate rests; then all three lift it."""
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    X = task.grasp.T_object_tool[2]
    there = pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0]))
    phases = [
        Phase("regrasp", arms={"slave_2": Travels(to=there)}, duration=ATTACHES),
        Phase("lift", path=task.path),
    ]
    return task, Program(task.cell, task.grasp, phases, **more)


def away(task: Any, program: Program, step: ControlStep, way: tuple[float, float, float]) -> Any:
    """What is measured where the third arm's tool is elsewhere on the object than commanded [m, in its frame]."""
    clock = step.clock_next
    grasp = program.grasp_at(task.grasp, clock)
    X = list(grasp.T_object_tool)
    X[2] = pin.SE3(X[2].rotation, X[2].translation + np.array(way))
    return inverse_kinematics(task.cell, type(grasp)(tuple(X)), program.pose(clock), step.q_next)


def controller_of(task: Any, program: Program) -> QPController:
    options = {"supervision": {"slow_from": None, "stall_samples": None}}
    controller = QPController(task.cell, task.grasp, program, dt=DT, options=options)
    controller.reset(task.q_start)
    return controller


def to_the_attachment(
    task: Any, program: Program, controller: QPController, way: tuple[float, float, float]
) -> tuple[list[ControlStep], Any]:
    """Steps until 20 after the arm attaches; the tool is elsewhere in all of them."""
    steps, measured = [controller.step(task.q_start)], task.q_start
    for _ in range(round(ATTACHES / DT) + 60):
        measured = away(task, program, steps[-1], way) if steps[-1].clock_next > ATTACHES - 0.1 else steps[-1].q_next
        steps.append(controller.step(measured))
    return steps, measured


def test_an_arm_too_far_from_its_grasp_is_not_attached() -> None:
    task, program = regrasp()
    controller = controller_of(task, program)
    steps, _ = to_the_attachment(task, program, controller, (0.003, 0.0, 0.0))
    held = [step for step in steps if step.status is Status.HOLDING]
    assert held
    assert held[0].clock == pytest.approx(ATTACHES, abs=1.01 * DT)
    assert "arm slave_2 is 3.00 mm and 0.00° from its grasp where it attaches (at most 2 mm" in held[0].explain()
    assert held[0].cause is Cause.TRACKING
    assert steps[-1].status is Status.HOLDING
    assert steps[-1].clock_next < ATTACHES + 0.02  # the object waits there
    other = copy.copy(controller)
    for one in (controller, other):  # the tool has come: the object goes on
        steps = [one.step(one.commanded) for _ in range(10)]
        assert steps[0].status is not Status.HOLDING
        assert steps[-1].clock_next > ATTACHES + 0.02 or steps[-1].rate > 0.1


def test_an_arm_near_its_grasp_is_latched_where_it_is() -> None:
    """The commands do not change, though the third arm's view of the object counts from then on."""
    task, program = regrasp()
    straight, elsewhere = (controller_of(task, program) for _ in range(2))
    steps, _ = to_the_attachment(task, program, elsewhere, (0.0015, 0.0, 0.001))
    assert all(step.status is not Status.HOLDING for step in steps)
    same = [straight.step(straight.commanded) for _ in steps]
    assert steps[-1].clock_next > ATTACHES + 0.1
    assert np.abs(steps[-1].q_next - same[-1].q_next).max() < 1e-9


def test_the_tolerance_is_the_programs() -> None:
    task, program = regrasp(attach_m=0.001)
    steps, _ = to_the_attachment(task, program, controller_of(task, program), (0.0015, 0.0, 0.0))
    assert steps[-1].status is Status.HOLDING
    task, program = regrasp(attach_m=0.01, attach_rad=0.001)
    steps, _ = to_the_attachment(task, program, controller_of(task, program), (0.0015, 0.0, 0.0))
    assert steps[-1].status is not Status.HOLDING


def test_a_tolerance_is_more_than_nothing() -> None:
    for name in ("attach_m", "attach_rad"):
        with pytest.raises(InvalidInputError, match=name):
            regrasp(**{name: 0.0})


@pytest.mark.core
def test_where_arms_let_go_and_attach_as_recorded(golden: Golden) -> None:
    """Also on the way back, and where measured arms are elsewhere by different amounts."""
    task, program = regrasp()
    done = golden.of(controller_of(task, program))
    for i in range(700):
        if i == 500:
            done.ask(lambda controller: controller.reverse(0.5))
        noise = 2e-5 * np.sin(0.1 * i + np.arange(task.cell.nq)) + 1e-4 * np.cos(np.arange(task.cell.nq))
        done.take(done.controller.commanded + noise)
