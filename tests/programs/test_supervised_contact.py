"""Arms that hold the object are compared with each other; one that has let go slows nobody, and attaches as it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import limited_once

from coopqp import ControlStep, LinePath, QPController, Status, inverse_kinematics
from coopqp.programs import Phase, Program, Travels
from coopqp.scenarios import paper_lift

DT = 0.005


def carried_on() -> tuple[Any, Program]:
    """The third arm grasps elsewhere while the other two lift the plate; then all three turn it back."""
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    X = task.grasp.T_object_tool[2]
    there = pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0]))
    back = LinePath(task.path.pose(task.path.duration), task.path.pose(0.0), duration=task.path.duration)
    phases = [Phase("carry", path=task.path, arms={"slave_2": Travels(to=there)}), Phase("back", path=back)]
    return task, Program(task.cell, task.grasp, phases)


def controller_of(task: Any, program: Program, **supervision: Any) -> QPController:
    controller = QPController(task.cell, task.grasp, program, dt=DT, options={"supervision": supervision})
    controller.reset(task.q_start)
    return controller


def measured(task: Any, program: Program, step: ControlStep, ways: dict[int, tuple[float, float, float]]) -> Any:
    """What is measured where tools are elsewhere on the object than commanded, by arm [m, in its frame]."""
    X = list(program.grasp_at(task.grasp, step.clock_next).T_object_tool)
    for k, way in ways.items():
        X[k] = pin.SE3(X[k].rotation, X[k].translation + np.array(way))
    return inverse_kinematics(task.cell, type(task.grasp)(tuple(X)), program.pose(step.clock_next), step.q_next)


def run(task: Any, program: Program, controller: QPController, ways: Any, seconds: float) -> list[ControlStep]:
    """Steps in which tools are where ``ways(clock)`` says."""
    steps = [controller.step(task.q_start)]
    while len(steps) * DT < seconds:
        steps.append(controller.step(measured(task, program, steps[-1], ways(steps[-1].clock_next))))
    return steps


def test_an_arm_that_has_let_go_slows_nobody() -> None:
    task, program = carried_on()
    attaches = program.grasps.changes[-1]
    free = program.grasps.holds(0.5 * attaches)
    assert not free[2]
    off = lambda clock: {2: (0.0, 0.006 * np.sin(np.pi * min(clock / attaches, 1.0)), 0.0)}  # noqa: E731
    steps = run(task, program, controller_of(task, program), off, attaches + 0.5)
    assert all(step.status is Status.TRACKING and step.rate > 1.0 - 1e-6 for step in steps[3:])


def test_arms_that_hold_are_compared_while_another_has_let_go() -> None:
    task, program = carried_on()
    off = lambda clock: {1: (0.0, 0.0, min(0.002 * clock, 0.002))}  # noqa: E731
    steps = run(task, program, controller_of(task, program, let_in=0.0), off, 1.2)
    slowed = next(step for step in steps if step.status is not Status.TRACKING)
    assert "slave_1" in slowed.explain()
    assert steps[-1].rate < 0.05


def test_an_arm_that_attaches_is_in_step_where_it_is() -> None:
    """1.5 mm from its grasp, which is twice what would hold the object, it holds on there; what comes later counts."""
    task, program = carried_on()
    attaches = program.grasps.changes[-1]
    off = lambda clock: {2: (0.0015, 0.0, 0.0 if clock < attaches + 0.4 else 0.003)}  # noqa: E731
    steps = run(task, program, controller_of(task, program), off, attaches + 0.6)
    early = [step for step in steps if step.clock < attaches + 0.35]
    assert all(step.status is Status.TRACKING for step in early[3:])
    assert "slave_2" in next(step for step in steps[len(early) :] if step.status is not Status.TRACKING).explain()


@pytest.mark.core
@pytest.mark.parametrize("stiffness", [None, 3e4])
def test_arms_that_hold_are_watched_as_recorded(stiffness: float | None, golden: Golden) -> None:
    task, program = carried_on()
    done = golden.of(controller_of(task, program, stiffness=stiffness))
    attaches = program.grasps.changes[-1]
    for i in range(round((attaches + 1.0) / DT)):
        wave = 4e-4 * np.sin(0.01 * i + np.arange(task.cell.nq)) * (np.arange(task.cell.nq) >= 6 * (i // 200 % 2))
        done.take(done.controller.commanded + wave + 1e-5 * np.cos(0.7 * i))
    assert done.seen != {Status.TRACKING}
