"""Rows that brake all arms together, where no look-ahead covers the motion."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from marks import slow_but_first
from promise_cases.braking import ACCELERATIONS, STEPS_WITHOUT, beside_cart, blind, line
from user_paths import Opaque

from coopqp import LimitKind, LinePath, QPController, Status
from coopqp.model import CellState
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, ring
from coopqp.spatial import Array


def out_of_reach(number: int, acceleration: float) -> Scenario:
    """A line that ends where not all arms reach, known only while it is followed."""
    rng = np.random.default_rng(700 + number)
    task = [partial(ring, arms=2), dual_arm7, mixed_cell][number % 3]()
    way = rng.normal(size=3)
    path = LinePath.displaced(
        task.path.pose(0.0), translation=1.2 * way / np.linalg.norm(way), duration=2.4, time_law="quintic"
    )
    cell = task.cell.with_limits(acceleration=acceleration)
    return replace(task, cell=cell, path=Opaque(path, known_ahead=False))


def apart(task: Scenario, q: Array) -> float:
    """Largest distance between the object's origins as the arms carry it [m], by Pinocchio."""
    state = CellState(task.cell, q)
    tools = zip(state.T_world_tool, task.grasp.T_object_tool, strict=True)
    origins = np.array([(T * X.inverse()).translation for T, X in tools])
    return float(np.linalg.norm(origins - origins[0], axis=1).max())


@pytest.mark.parametrize(("number", "acceleration"), [(0, np.inf), (1, 5.0)])
def test_a_path_that_is_not_known_ahead_runs_out_of_reach_and_the_arms_stay_together(
    number: int, acceleration: float
) -> None:
    task, dt = out_of_reach(number, acceleration), 0.008
    controller = QPController(task.cell, task.grasp, task.path, dt=dt)
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(300)]
    assert steps[-1].status in (Status.BLOCKED, Status.SLOWED)
    assert not any(step.status is Status.HOLDING for step in steps)
    assert max(apart(task, step.q_next) for step in steps) < 2e-5
    changes = sum(a.status is not b.status for a, b in pairwise(steps))
    assert changes <= 2.0 * len(steps) * dt
    assert {limit.kind for step in steps[-20:] for limit in step.binding} & {LimitKind.SINGULARITY, LimitKind.POSITION}


@pytest.mark.parametrize("number", slow_but_first([6, 9, 29]))
def test_rows_take_no_time_where_the_bend_leaves_enough_of_the_accelerations(number: int) -> None:
    task, dt = line(number, ACCELERATIONS[number % 3], 0.15), 0.008
    run = blind(task, dt)
    assert run.finished
    assert run.time <= 1.03 * STEPS_WITHOUT[number] * dt
    assert run.chain < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("number", [67, 146])
def test_arms_that_could_stay_clear_of_a_cart_are_not_slowed_by_their_bend_until_it_touches(number: int) -> None:
    """Without any rows they stay 20 mm away, and together."""
    run = beside_cart(number, 15.0)
    assert run.least > 0.01
    assert run.chain < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(("number", "acceleration"), [(79, 15.0), (83, 15.0), (133, 5.0)])
def test_arms_stay_together_where_a_cart_pushes_on_after_it_has_touched(number: int, acceleration: float) -> None:
    run = beside_cart(number, acceleration)
    assert run.least < 0.0
    assert run.chain < 1e-5
