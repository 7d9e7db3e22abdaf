"""The distance between the arms that the commands make: said, and held where it grows too large."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from promise_cases.chain_cells import Oracle

from coopqp import (
    Cause,
    ControlStep,
    Grasp,
    InvalidInputError,
    QPController,
    QPOptions,
    RobotCell,
    Status,
    SupervisionOptions,
)
from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import Scenario, five_joint_pair, paper_lift
from coopqp.simulation import Monitor
from coopqp.spatial import Array


def controller(task: Scenario, **supervision: Any) -> QPController:
    options = QPOptions(supervision=SupervisionOptions(**supervision))
    return QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)


def pulled_apart(made: QPController, joint: int, by: float) -> None:
    """A fault that no command shows: the controller believes to have commanded another position of one joint."""
    made._loop.at["positions"][joint] += by


def lengths_at_grasps(cell: RobotCell, grasp: Grasp, q: Array) -> float:
    """The same as ``commanded_apart`` for a displacement without a turn: the object's origins, from Pinocchio alone."""
    points = np.array(Oracle(cell, grasp).points(q))
    n = len(points)
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()) * n / (n - 1)


# -- in a run ---------------------------------------------------------------------------------------------------------


def test_arms_that_are_parted_hold_until_they_are_together_again() -> None:
    task = paper_lift()
    made = controller(task)
    made.reset(task.q_start)
    first = [made.step() for _ in range(10)]
    assert max(step.commanded_apart for step in first) < 1e-7
    assert not any(step.reason for step in first)
    pulled_apart(made, task.cell.v_slices[1].start + 1, 5e-4)
    steps: list[ControlStep] = []
    for _ in range(200):
        steps.append(made.step())
        if len(steps) > 1 and steps[-1].status is not Status.HOLDING:
            break
    held = steps[:-1]
    assert all((step.status, step.cause) == (Status.HOLDING, Cause.COMMANDED_CHAIN) for step in held)
    assert "master and slave_1" in held[0].reason or "slave_1 and slave_2" in held[0].reason
    assert held[0].commanded_apart > 2e-4
    assert held[-1].commanded_apart > 1e-4
    assert steps[-1].commanded_apart <= 1e-4
    assert len(held) < 30  # the correction at rest goes on
    assert "are commanded" in steps[-1].reason  # as long as it is more than 10 µm
    for step in steps:
        assert step.commanded_apart == pytest.approx(lengths_at_grasps(task.cell, task.grasp, step.q), rel=0.3)


def test_a_small_distance_is_said_and_slows_nothing() -> None:
    task = paper_lift()
    made = controller(task)
    made.reset(task.q_start)
    before = made.step()
    pulled_apart(made, task.cell.v_slices[1].start + 1, 6e-5)
    step = made.step()
    assert 1e-5 < step.commanded_apart < 2e-4
    assert "commanded" in step.reason
    assert step.status is before.status
    assert step.rate == before.rate


def test_a_larger_distance_or_none_may_be_chosen() -> None:
    task = paper_lift()
    for apart_from in (2e-3, None):
        made = controller(task, apart_from=apart_from)
        made.reset(task.q_start)
        made.step()
        pulled_apart(made, task.cell.v_slices[1].start + 1, 5e-4)
        step = made.step()
        assert step.status is not Status.HOLDING
        assert step.commanded_apart > 2e-4
    with pytest.raises(InvalidInputError, match="apart_from"):
        SupervisionOptions(apart_from=0.0)


def test_a_start_off_the_grasp_and_shifted_grasps_are_no_fault() -> None:
    task = paper_lift()
    made = controller(task)
    q = task.q_start.copy()
    q[task.cell.q_slices[1].start + 1] += 3e-3
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made.reset(q)
    seen = [made.step() for _ in range(60)]
    shift = np.zeros((3, 6))
    for i in range(100):
        shift[1, 2], shift[2, 0] = 2e-5 * i, -1e-5 * i
        made.shift_grasp(shift)
        seen.append(made.step())
    assert not any(step.status is Status.HOLDING for step in seen)
    assert max(step.commanded_apart for step in seen) < 1e-5


@pytest.mark.parametrize("seed", range(3))
def test_grasps_that_shift_to_and_fro_are_no_fault(seed: int) -> None:
    """As presses shift them: faster than the chain's errors are corrected, and back before they are; also in motion."""
    task, rng = paper_lift(time_law="quintic"), np.random.default_rng(seed)
    made = controller(task)
    made.reset(task.q_start)
    ways, periods = rng.normal(size=(2, 3, 6)), rng.uniform(0.1, 0.3, size=2)
    monitor = Monitor(task.cell, task.grasp)
    ways -= ways.mean(axis=1, keepdims=True)  # what all have in common would move the object
    steps, shifts = [], []
    for i in range(80):
        swing = np.sin(2.0 * np.pi * task.dt * i / periods)
        shifts.append(5e-4 * (swing[0] * ways[0] + swing[1] * ways[1]))
        made.shift_grasp(shifts[-1])
        steps.append(made.step(dt=task.dt * rng.uniform(0.6, 1.4)))
    assert max(step.commanded_apart for step in steps) < 5e-6
    monitor.observe_all(steps, shifts=shifts)
    assert monitor.verdict().worst.chain_m < 5e-6, "the arms follow in the same step, and not beyond"


def test_arms_with_few_joints_do_not_hold_for_what_they_cannot_mend() -> None:
    """A tilt that none of the arms can take away was there at the start, and stays."""
    task = five_joint_pair()
    made = controller(task)
    q = task.q_start.copy()
    q[task.cell.q_slices[1].start] += 2e-3  # the base joint turns the arm out of the common plane
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made.reset(q)
    assert not any(made.step().status is Status.HOLDING for _ in range(60))


def test_other_controllers_do_not_watch() -> None:
    task = paper_lift()
    made = PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt)
    made.reset(task.q_start)
    assert np.isnan(made.step().commanded_apart)
