"""Arms with fewer than six joints make only what is possible for all of them, and stay together."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from marks import slow_but_first
from promise_cases import chain_cells

from coopqp import LinePath, QPController
from coopqp.scenarios import Scenario, five_joint_pair, scara_pair

#: As far as the arms may be apart, as commanded [m].
TOGETHER = 5e-5


@pytest.mark.parametrize("rotation", slow_but_first([(0.0, 0.0, 0.3), (0.3, 0.0, 0.0), (0.0, 0.3, 0.0)]))
@pytest.mark.parametrize("make", slow_but_first([scara_pair, five_joint_pair]))
def test_a_path_that_they_cannot_follow_does_not_part_them(
    make: Callable[[], Scenario], rotation: tuple[float, float, float]
) -> None:
    """Version 0.1 parted them by 0.26 m."""
    task, dt = make(), 0.008
    path = LinePath.displaced(
        task.path.pose(0.0), translation=(0.03, 0.05, 0.06), rotation=rotation, duration=2.0, time_law="quintic"
    )
    given = chain_cells.Task(task.cell, task.grasp, path, task.q_start)
    made = chain_cells.run(QPController(task.cell, task.grasp, path, dt=dt), given, 300)
    assert made.apart <= TOGETHER


@pytest.mark.parametrize("acceleration", slow_but_first([5.0, None]))
@pytest.mark.parametrize("seed", slow_but_first([2, 0, 4]))
def test_random_arms_stay_together(seed: int, acceleration: float | None) -> None:
    task, dt = chain_cells.few_joints(seed, acceleration), 0.008
    steps = int(1.1 * task.path.duration / dt)
    made = chain_cells.run(QPController(task.cell, task.grasp, task.path, dt=dt), task, steps, every=2)
    assert made.apart <= TOGETHER
