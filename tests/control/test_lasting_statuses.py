"""Statuses last a moment: they do not flicker where σ is near 0 or 1."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_unless

from coopqp import ControlStep, LinePath, ObjectPath, QPController, ServoPath, Status
from coopqp.scenarios import Scenario, mixed_cell, ring


class Unknown(ObjectPath):
    """A path that may not be asked ahead of the clock."""

    known_ahead = False

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration = path, path.duration

    def pose(self, clock: float) -> pin.SE3:
        return self._path.pose(clock)

    def twist(self, clock: float) -> np.ndarray:
        return self._path.twist(clock)


def far(task: Scenario, seed: int, acceleration: float) -> Scenario:
    """A straight way of 0.7 m, which ends out of reach."""
    rng = np.random.default_rng(seed)
    way, turn = rng.normal(size=3), rng.normal(size=3)
    way *= 0.7 / np.linalg.norm(way)
    turn *= rng.uniform(0.0, 0.4) / np.linalg.norm(turn)
    path = LinePath.displaced(
        task.path.pose(0.0), translation=way, rotation=turn, duration=0.7 / rng.uniform(0.1, 0.5), time_law="linear"
    )
    return replace(task, cell=task.cell.with_limits(acceleration=acceleration), path=path)


def changes(steps: list[ControlStep], some: set[Status]) -> int:
    """Changes from one of these statuses to another of them."""
    return sum(a.status is not b.status and {a.status, b.status} <= some for a, b in pairwise(steps))


@pytest.mark.parametrize("seed", slow_unless(lambda seed: seed == 3, (3, 5)))
def test_a_blocked_object_is_called_so_while_its_target_trembles(seed: int) -> None:
    """Out of reach, a target moves by a millimetre 20 times a second; while BLOCKED the object does not go on."""
    task, dt = far(ring(arms=2), seed, 5.0), 0.001
    controller = QPController(task.cell, task.grasp, ServoPath(task.path.pose(0.0)), dt=dt)
    controller.reset(task.q_start)
    rng, goal, steps = np.random.default_rng(seed), task.path.pose(task.path.duration), list[ControlStep]()
    for i in range(3000):
        if i % 50 == 0:
            controller.retarget(goal * pin.exp6(1e-3 * rng.normal(size=6)))
        steps.append(controller.step())
    assert sum(step.status is Status.BLOCKED for step in steps) > 500
    for i in range(0, 2600, 200):
        assert changes(steps[i : i + 400], {Status.SLOWED, Status.BLOCKED}) <= 10
    for before, step in pairwise(steps):
        if before.status is step.status is Status.BLOCKED:
            assert (step.clock_next - step.clock) / dt < 0.01


@pytest.mark.parametrize("seed", slow_unless(lambda seed: seed == 1, range(1, 3)))
def test_on_an_unknown_path_a_status_changes_less_than_twice_a_second(seed: int) -> None:
    task, dt = far(mixed_cell(), seed, 15.0), 0.008
    controller = QPController(task.cell, task.grasp, Unknown(task.path), dt=dt)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < 300:
        steps.append(controller.step())
    assert changes(steps, set(Status)) <= 2.0 * len(steps) * dt
    at_full_rate = 0.0
    for step in steps:
        at_full_rate = at_full_rate + dt if step.rate == 1.0 else 0.0
        assert step.status is not Status.SLOWED or at_full_rate < 0.051 + dt
        assert step.status is not Status.TRACKING or step.rate == 1.0


def test_an_object_that_was_blocked_is_slowed_as_soon_as_it_goes_on() -> None:
    task = far(ring(arms=2), 1, np.inf)
    start, target = task.path.pose(0.0), task.path.pose(task.path.duration)
    controller = QPController(task.cell, task.grasp, ServoPath(start, speed=1.0), dt=0.01)
    controller.reset(task.q_start)
    controller.retarget(target)
    steps = [controller.step() for _ in range(300)]
    assert steps[-1].status is Status.BLOCKED
    controller.retarget(start)
    gone = 0.0
    for _ in range(30):
        step = controller.step()
        gone += step.rate * step.dt if step.status is Status.BLOCKED else 0.0
    assert gone <= 2e-5
    assert step.status in (Status.SLOWED, Status.TRACKING)
    assert step.rate > 0.1
