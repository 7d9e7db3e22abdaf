"""Two groups with clocks of their own: how far apart they are is what the step says, and less than without coupling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ControlStep, Grasp, InvalidInputError, LinePath, QPController, RobotCell, inverse_kinematics
from coopqp.control import Coupling, couple
from coopqp.scenarios import paper_lift

DT = 0.005


def groups() -> tuple[QPController, QPController]:
    """Two arms lift the plate; the third, in a group of its own and slower, goes along at its edge."""
    task = paper_lift(time_law="linear")
    X, path = task.grasp.T_object_tool, task.path
    assert isinstance(path, LinePath)
    pair, alone = RobotCell(task.cell.arms[:2]), RobotCell(task.cell.arms[2:])
    pair, alone = pair.with_limits(acceleration=5.0), alone.with_limits(acceleration=0.5)
    made = []
    for cell, grasp in ((pair, Grasp(X[:2])), (alone, Grasp(X[2:]))):
        own = [task.cell.arm_names.index(name) for name in cell.arm_names]
        x = task.cell.positions(task.q_start)
        guess = cell.configuration(np.concatenate([x[task.cell.v_slices[k]] for k in own]))
        controller = QPController(cell, grasp, path, dt=DT)
        controller.reset(inverse_kinematics(cell, grasp, path.pose(0.0), guess))
        made.append(controller)
    return made[0], made[1]


def apart(first: QPController, second: QPController, steps: tuple[ControlStep, ControlStep]) -> float:
    """How far the third tool is from its place on the plate that the others carry [m], by Pinocchio's frames."""
    views = []
    for controller, step in zip((first, second), steps, strict=True):
        data = controller.cell.model.createData()
        pin.framesForwardKinematics(controller.cell.model, data, step.q_next)
        views.append(data.oMf[controller.cell.tool_frames[0]] * controller.grasp.T_object_tool[0].inverse())
    X = second.grasp.T_object_tool[0]
    return float(np.linalg.norm((views[0] * X).translation - (views[1] * X).translation))


def run(stepping: Any, first: QPController, second: QPController) -> tuple[float, list[Any]]:
    most, steps = 0.0, list[Any]()
    for _ in range(2000):
        steps.append(stepping())
        most = max(most, apart(first, second, steps[-1]))
        if all(step.finished for step in steps[-1]):
            break
    return most, steps


def test_groups_stay_together_within_what_their_steps_say() -> None:
    first, second = groups()
    free, _ = run(lambda: (first.step(), second.step()), first, second)
    first, second = groups()
    coupled = couple(first, second)
    assert isinstance(coupled, Coupling)
    bounds: list[tuple[float, float]] = []

    def stepping() -> tuple[ControlStep, ControlStep]:
        steps = coupled.step()
        bounds.append((apart(first, second, steps), coupled.bound))
        return steps

    held, steps = run(stepping, first, second)
    assert all(step.finished for step in steps[-1])
    assert held < 0.2 * free
    assert all(far <= bound + 1e-6 for far, bound in bounds)
    said = [step.reason for pair in steps for step in pair if "the other group" in step.reason]
    assert said
    assert "ms ahead of the other group's: up to" in "".join(said)


def test_a_group_waits_for_one_that_is_paused_and_an_override_is_for_both() -> None:
    first, second = groups()
    coupled = couple(first, second)
    for _ in range(100):
        coupled.step()
    second.pause()
    steps = [coupled.step() for _ in range(300)]
    assert steps[-1][0].rate < 0.03
    assert abs(coupled.lag) < 0.01
    second.resume()
    coupled.set_override(0.4)
    steps = [coupled.step() for _ in range(300)]
    assert max(step.rate for pair in steps[100:] for step in pair) <= 0.4 + 1e-9
    coupled.pause()
    steps = [coupled.step() for _ in range(300)]
    assert {step.status.name for step in steps[-1]} == {"PAUSED"}
    coupled.resume()


def test_what_cannot_be_coupled_is_refused() -> None:
    first, second = groups()
    with pytest.raises(InvalidInputError, match="same controller twice"):
        couple(first, first)
    with pytest.raises(InvalidInputError, match="couple"):
        couple(first, "second")  # type: ignore[arg-type]
    other = QPController(second.cell, second.grasp, second.path, dt=0.002)
    with pytest.raises(InvalidInputError, match="two lengths"):
        couple(first, other)
