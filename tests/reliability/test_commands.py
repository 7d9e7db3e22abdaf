"""A1: for any input the command is safe to send, and no input or output array is modified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from checks import rough_steps
from runs import cooperative, limited

from coopqp import Status
from coopqp.scenarios import Scenario, dual_arm7, five_joint_pair, mixed_cell, paper_lift, ring, scara_pair

#: Tests that the steps are spread over, so that several processes can share them.
PARTS = 2


def rough_task(task: Scenario, rng: np.random.Generator) -> Scenario:
    """The scenario with another step length and other limits; sometimes joints start outside."""
    limits, x = task.cell.limits, task.cell.positions(task.q_start)
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    if rng.uniform() < 0.3:
        joints = ~task.cell.continuous & (rng.uniform(size=task.cell.nv) < 0.3)
        upper[joints] = np.minimum(upper, x + rng.uniform(-0.1, 0.5, task.cell.nv))[joints]
        lower[joints] = np.minimum(lower, upper - 0.5)[joints]
    return limited(
        replace(task, dt=float(rng.choice([0.001, 0.002, 0.005]))),
        lower=lower,
        upper=upper,
        velocity=np.array(limits.velocity) * 10.0 ** rng.uniform(-1.0, 0.0),
        acceleration=np.inf if rng.uniform() < 0.5 else 10.0 ** rng.uniform(0.0, 1.5, task.cell.nv),
    )


@pytest.mark.slow
@pytest.mark.parametrize("part", [pytest.param(1, marks=pytest.mark.core), *range(2, PARTS + 1)])
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_any_command_may_be_sent(
    part: int, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    """400 000 steps in all, some of arms with fewer than six joints."""
    usual, few = [paper_lift(), dual_arm7(), mixed_cell(), ring(arms=4)], [scara_pair(), five_joint_pair()]
    steps = 0
    violations: Counter[str] = Counter()
    statuses: Counter[Status] = Counter()
    for i in range(count(20 // PARTS)):
        runs = [(usual[i % 4], 19_500)]
        if i % 5 == 0:
            runs.append((few[i // 5 % 2], 2_500))
        for task, n in runs:
            found = rough_steps(cooperative, rough_task(task, rng), rng, n, measured=0.03)
            steps += found.steps
            violations += found.violations
            statuses += found.statuses
    late = violations.pop("HOLDING", 0)
    longer = f"{late} steps held longer than 1.1 v/a + 2 dt, after a new path in motion or at a singularity"
    catalogue.row(
        "A1",
        f"form, finiteness, limits, continuity, clock, data modified: {part} of {PARTS}",
        cases=steps,
        measured=violations.total(),
        target=0,
        note=longer,
    )
    assert not violations
    operated = {Status.JOGGING, Status.WAITING}  # no operator calls here, and no path has gates
    assert set(statuses) == set(Status) - operated, "each status was seen"
    assert min(statuses[s] for s in (Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.HOLDING)) > 0.01 * steps
