"""An unreachable target: the object is reported blocked as soon as it stands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.controllers.base import Status
from coopqp.controllers.qp import QPController
from coopqp.monitor import Monitor, MonitorTolerances
from coopqp.path import ServoPath
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift

#: Below this share of the path's rate the object counts as standing.
STANDS = 0.01
#: A run ends when the object has been blocked for so many steps.
DWELL = 100
LONGEST = 6000


class Chase:
    """A controller that is led to targets, and the oracle that judges it by its limits."""

    def __init__(self, scenario: Scenario) -> None:
        self.start = scenario.path.pose(0.0)
        self.controller = QPController(scenario.cell, scenario.grasp, ServoPath(self.start), dt=scenario.dt)
        self.controller.reset(scenario.q_start)
        nothing = {"chain_m": None, "chain_rad": None, "path_m": None, "path_rad": None}
        self.monitor = Monitor(scenario.cell, scenario.grasp, tolerances=MonitorTolerances(**nothing))

    def step(self) -> Any:
        step = self.controller.step()
        self.monitor.observe(step)
        return step

    def until_blocked(self) -> int:
        """Go on until the object is blocked for good; how long it stood without being said to [steps]."""
        standing = longest = blocked = 0
        for _ in range(LONGEST):
            step = self.step()
            standing = standing + 1 if step.rate < STANDS and step.status is not Status.BLOCKED else 0
            longest = max(longest, standing)
            blocked += step.status is Status.BLOCKED
            if blocked >= DWELL:
                return longest
        return LONGEST


def away(rng: np.random.Generator, start: pin.SE3) -> pin.SE3:
    """A pose two metres away, farther than any of the arms reach."""
    direction = rng.normal(size=3)
    turn = pin.exp3(0.3 * rng.normal(size=3))
    return pin.SE3(start.rotation @ turn, start.translation + 2.0 * direction / np.linalg.norm(direction))


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_a_standing_object_is_reported_blocked(
    acceleration: float, rng: np.random.Generator, count: Callable[[int], int], catalogue: Any
) -> None:
    longest, cases = [], 0
    for make in (paper_lift, dual_arm7, mixed_cell):
        task = make()
        task = replace(task, cell=task.cell.with_limits(acceleration=acceleration), dt=0.002)
        for _ in range(count(3)):
            chase = Chase(task)
            chase.controller.retarget(away(rng, chase.start))
            longest.append(chase.until_blocked())
            cases += 1
            assert chase.monitor.verdict().ok, chase.monitor.verdict()
    limited = "with" if np.isfinite(acceleration) else "without"
    catalogue.row(
        "A7",
        f"unreachable target, {limited} acceleration limits: steps to blocked",
        cases=cases,
        measured=max(longest),
        target=50,
        unit="steps",
        note="the longest time for which the object stood (σ < 1 %) and was not said to be blocked",
    )
