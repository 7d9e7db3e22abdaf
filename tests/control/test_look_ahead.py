"""What steps rest on when they ask the look-ahead: rises, falls, free ways, copies, and work in small pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_but_first

from coopqp import LimitKind, LinePath, QPController, Status
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, at_singularity, paper_lift

# -- paths that are too quick for their joints -------------------------------------------------------------------------


def time_along(task: Scenario, quickness: float, law: TimeLaw) -> float:
    """Time in which a path that is so many times quicker than the task's is finished [s]; NaN if it is not."""
    first, last, dt = task.path.pose(0.0), task.path.pose(task.path.duration), 0.005
    path = LinePath(first, last, duration=task.path.duration / quickness, time_law=law)
    controller = QPController(task.cell, task.grasp, path, dt=dt)
    controller.reset(task.q_start)
    for i in range(600):
        if controller.step().finished:
            return i * dt
    return np.nan


@pytest.mark.parametrize("law", slow_but_first([TimeLaw.QUINTIC, TimeLaw.LINEAR]))
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_a_path_too_quick_for_its_joints_is_followed_at_their_own_pace(acceleration: float, law: TimeLaw) -> None:
    """How quick it is says nothing: far from singularities it was BLOCKED by one from a hundred times on."""
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    own = time_along(task, 30.0, law)
    assert own < 1.2
    for quickness in (300.0, 1e3, 1e4):
        assert time_along(task, quickness, law) == pytest.approx(own, abs=0.011)


@pytest.mark.parametrize("kind", ["elbow", "reach"])
def test_a_singularity_ends_a_path_that_is_too_quick_where_it_ends_a_slow_one(kind: str) -> None:
    task, ends = at_singularity(kind, acceleration=10.0), []
    for quickness in (1.0, 100.0, 1e4):
        path = LinePath(
            task.path.pose(0.0), task.path.pose(task.path.duration), duration=task.path.duration / quickness,
            time_law=TimeLaw.LINEAR,
        )  # fmt: skip
        controller = QPController(task.cell, task.grasp, path, dt=0.005)
        controller.reset(task.q_start)
        for _ in range(600):
            step = controller.step()
        assert step.status is Status.BLOCKED
        assert step.rate == 0.0
        assert {limit.kind for limit in step.binding} <= {LimitKind.SINGULARITY, LimitKind.REACH}
        ends.append(step.clock / path.duration)
    assert np.ptp(ends) < 1e-3
