"""A deviation that all arms share: what a lag makes of it is none, what a stopped arm in rigid grips makes of it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden

from coopqp import Cause, ControlStep, HoldPath, LinePath, QPController, RobotCell, Status, SupervisionOptions
from coopqp.model import CellState
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array

FOUND = "seems to have stopped in its grip"


def run(*, late: float, follows: float, at: float, until: float, told: bool = False) -> list[ControlStep]:
    """All arms are where their commands were ``late`` seconds ago, and go on at a share of their speed from ``at``."""
    task = paper_lift(time_law="quintic", duration=2.0)
    supervision = SupervisionOptions(stiffness=1e6 if told else None, force_limit=1e9)
    made = QPController(task.cell, task.grasp, task.path, dt=task.dt, options={"supervision": supervision})
    made.reset(task.q_start)
    past: list[Array] = [task.q_start]
    steps: list[ControlStep] = []
    age, now = late / task.dt, 0.0
    while now < until:
        age += (1.0 - follows) if now > at else 0.0
        place = max(len(past) - 1 - age, 0.0)
        i = int(place)
        measured = past[i] + (place - i) * (past[min(i + 1, len(past) - 1)] - past[i])
        steps.append(made.step(measured))
        past.append(steps[-1].q_next)
        now += task.dt
    return steps


def test_a_lag_is_no_stop_but_a_growing_one_is() -> None:
    steps = run(late=0.02, follows=0.6, at=0.8, until=0.9)
    dt = steps[0].dt
    found = [i for i, step in enumerate(steps) if FOUND in step.reason]
    assert found
    assert 0.8 <= found[0] * dt <= 0.9
    held = next(step for step in steps[found[0] :] if step.status is Status.HOLDING)
    assert held.cause is Cause.TRACKING
    assert not any(FOUND in step.reason for step in run(late=0.02, follows=1.0, at=9.0, until=1.0))


@pytest.mark.core
def test_a_stop_in_a_grip_as_recorded(golden: Golden) -> None:
    done = golden.of(None)
    for step in run(late=0.01, follows=0.5, at=0.7, until=0.85):
        done.add(step)


def test_told_servos_are_asked_instead() -> None:
    steps = run(late=0.02, follows=0.6, at=0.8, until=0.9, told=True)
    assert not any(FOUND in step.reason for step in steps)


@pytest.mark.core
def test_what_the_deviation_is_at_rest_is_averaged_over_a_tenth_of_a_second() -> None:
    """After 0.9 mm, 1.7 mm; 2.3 mm are a millimetre beyond what they have become in one step of 50 ms, not in two."""
    task = paper_lift()
    start, dt = task.path.pose(0.0), 0.05
    rise = LinePath.displaced(start, translation=(0.0, 0.0, 3e-3), duration=1.0, time_law="linear")
    raised = QPController(task.cell, task.grasp, rise, dt=dt)
    raised.reset(task.q_start)
    way = [raised.step() for _ in range(20)]
    heights, q = [3e-3 * step.clock_next for step in way], np.array([step.q_next for step in way]).T
    watch = SupervisionOptions(noise_margin=0.0, filter_time=0.0, stall_samples=None)
    options = {"supervision": watch, "path_gain": 0.0, "grasp_gain": 0.0}
    for lasts, found in ((1, True), (2, False)):
        made = QPController(task.cell, task.grasp, HoldPath(start, duration=9.0), dt=dt, options=options)
        made.reset(task.q_start)
        for i, height in enumerate([0.9e-3] * 6 + [1.7e-3] * lasts + [2.3e-3]):
            step = made.step(np.array([np.interp(height, heights, joint) for joint in q]) + 1e-9 * i)
        assert (FOUND in step.reason) is found


def aside(cell: RobotCell, q: Array, moved: Sequence[Array]) -> Array:
    """Configuration (nq,) at which each arm's tool has moved by so much (3,) in the world, to first order [m]."""
    state, x = CellState(cell, q), np.zeros(cell.nv)
    for k, (columns, way) in enumerate(zip(cell.columns, moved, strict=True)):
        R = state.T_world_tool[k].rotation
        x[columns] = np.linalg.solve(state.jacobian(k), np.concatenate([R.T @ way, np.zeros(3)]))
    return pin.integrate(cell.model, q, x)


@pytest.mark.core
@pytest.mark.parametrize("margin", [4.0, 6.0])
def test_of_the_noise_of_all_arms_the_mean_is_accepted(margin: float) -> None:
    """At rest all arms stand 3 mm higher: they are 1 mm and noise_margin times the noise / √N less than that off."""
    task, size, rise, dt = paper_lift(), 1e-4, 3e-3, 0.01
    watch = SupervisionOptions(noise_margin=margin, filter_time=0.0, stall_samples=None, slow_from=0.05, hold_from=0.06)
    options = {"supervision": watch, "path_gain": 0.0, "grasp_gain": 0.0}
    path = HoldPath(task.path.pose(0.0), duration=9.0)
    made = QPController(task.cell, task.grasp, path, dt=dt, options=options)
    made.reset(task.q_start)
    heights = []
    for i in range(60):
        noise = size * (-1.0) ** i * np.array([1.0, -1.0, 0.0])  # the mean of the arms has none
        heights.append(noise + (rise if i == 59 else 0.0))
        step = made.step(aside(task.cell, task.q_start, [np.array([0.0, 0.0, z]) for z in heights[-1]]))
    square = np.zeros(3)
    for i, bend in enumerate(np.diff(heights, n=2, axis=0), start=1):  # of noise that is white: 6 σ² in the mean
        square += (bend**2 - square) / min(i, 0.2 / dt - 2.0)
    off = rise - 1e-3 - margin * np.sqrt(square.max() / 6.0 / len(task.cell))
    assert FOUND in step.reason
    assert float(step.reason.split(" mm")[0].split()[-1]) == pytest.approx(1e3 * off, abs=0.02)


@pytest.mark.core
@pytest.mark.parametrize(("slope", "found"), [(0.015, False), (0.06, True)])
def test_what_posture_makes_of_the_deviation_grows_with_the_way(slope: float, found: bool) -> None:
    """By no more than 0.02 of it: then 3 mm aside are no stop, else 2 mm are one."""
    task = paper_lift()
    start, speed = task.path.pose(0.0), 0.1
    path = LinePath.displaced(start, translation=(0.0, 0.0, 0.25), duration=2.5, time_law="linear")
    watch = SupervisionOptions(noise_margin=0.0, filter_time=0.0, stall_samples=None)
    options = {"supervision": watch, "path_gain": 0.0, "grasp_gain": 0.0}
    made = QPController(task.cell, task.grasp, path, dt=0.01, options=options)
    made.reset(task.q_start)
    step, reasons = made.step(task.q_start), []
    while step.clock_next < path.duration:
        far = slope * speed * max(step.clock_next - 0.3, 0.0)
        step = made.step(aside(task.cell, step.q_next, [np.array([far, 0.0, 0.0])] * len(task.cell)))
        reasons.append(step.reason)
        if FOUND in step.reason:
            break
    assert any(FOUND in reason for reason in reasons) is found
