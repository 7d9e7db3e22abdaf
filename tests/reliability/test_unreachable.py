"""An unreachable target, then a reachable one: the object is blocked when it stops, and moves again at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ControlStep, QPController, QPOptions, ServoPath, Status
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import Monitor, Verdict

pytestmark = pytest.mark.slow

#: Rate σ below which the object counts as stopped.
STANDS = 0.01
#: A run ends after this number of blocked steps.
DWELL = 100
LONGEST = 6000


class Chase:
    """A controller that follows targets, and the monitor of its limits."""

    def __init__(self, scenario: Scenario) -> None:
        self.start = scenario.path.pose(0.0)
        self.controller = QPController(scenario.cell, scenario.grasp, ServoPath(self.start), dt=scenario.dt)
        self.controller.reset(scenario.q_start)
        nothing = dict.fromkeys(("chain_mm", "chain_deg", "object_mm", "object_deg"), 1e9)
        self.steps: list[ControlStep] = []
        self.monitor = Monitor(scenario.cell, scenario.grasp, tolerances=nothing)

    def verdict(self) -> Verdict:
        """What the monitor says of all steps so far."""
        self.monitor.observe_all(self.steps)
        self.steps.clear()
        return self.monitor.verdict()

    def step(self) -> Any:
        step = self.controller.step()
        self.steps.append(step)
        return step

    def until_blocked(self) -> int:
        """Run until the object stays blocked. Returns the number of steps that it stopped without status BLOCKED."""
        standing = longest = blocked = 0
        for _ in range(LONGEST):
            step = self.step()
            standing = standing + 1 if step.rate < STANDS and step.status is not Status.BLOCKED else 0
            longest = max(longest, standing)
            blocked += step.status is Status.BLOCKED and step.rate < QPOptions().blocked_rate  # the object rests
            if blocked >= DWELL:
                return longest
        return LONGEST

    def until_off(self) -> int:
        """Number of steps until the object moves along its path again."""
        for n in range(1, LONGEST):
            step = self.step()
            if step.status is not Status.BLOCKED and step.rate > 1e-3 and np.abs(step.velocity).max() > 1e-3:
                return n
        return LONGEST

    def arrives(self) -> bool:
        """True if the object returns to its start."""
        for _ in range(LONGEST):
            step = self.step()
            carried = step.grasp.carried(step.state)[0]
            if np.linalg.norm(carried.translation - self.start.translation) < 1e-4:
                return True
        return False


def away(rng: np.random.Generator, start: pin.SE3) -> pin.SE3:
    """A pose two metres away, out of reach of all arms."""
    direction = rng.normal(size=3)
    turn = pin.exp3(0.3 * rng.normal(size=3))
    return pin.SE3(start.rotation @ turn, start.translation + 2.0 * direction / np.linalg.norm(direction))


def chases(acceleration: float, number: int) -> Iterator[Chase]:
    """Chases of unreachable targets by three cells, before their first step."""
    rng = np.random.default_rng(77)
    for make in (paper_lift, dual_arm7, mixed_cell):
        task = make()
        task = replace(task, cell=task.cell.with_limits(acceleration=acceleration), dt=0.002)
        for _ in range(number):
            chase = Chase(task)
            chase.controller.retarget(away(rng, chase.start))
            yield chase


@pytest.fixture(name="found", scope="module", params=[np.inf, 5.0], ids=["no acceleration limits", "5 rad/s²"])
def _found(request: pytest.FixtureRequest, count: Callable[[int], int]) -> tuple[bool, list[int], list[int], int]:
    """True if accelerations are limited; for each chase the numbers of steps until blocked and until moving again; the
    number of objects that did not return.
    """
    to_blocked, to_off, lost = [], [], 0
    for chase in chases(request.param, count(6)):
        to_blocked.append(chase.until_blocked())
        chase.controller.retarget(chase.start)
        to_off.append(chase.until_off())
        lost += not chase.arrives()
        verdict = chase.verdict()
        assert verdict.ok, verdict
    return bool(np.isfinite(request.param)), to_blocked, to_off, lost


def test_a_standing_object_is_reported_blocked(found: tuple[bool, list[int], list[int], int], catalogue: Any) -> None:
    limited, to_blocked, _, _ = found
    catalogue.row(
        "A7",
        f"unreachable target, {'with' if limited else 'without'} acceleration limits: steps to blocked",
        cases=len(to_blocked),
        measured=max(to_blocked),
        target=10,
        unit="steps",
        note="the longest time for which the object stood (σ < 1 %) and was not said to be blocked",
    )


def test_it_is_off_again_at_once(found: tuple[bool, list[int], list[int], int], catalogue: Any) -> None:
    limited, _, to_off, lost = found
    catalogue.row(
        "A7",
        f"then a reachable one, {'with' if limited else 'without'} acceleration limits: steps to off",
        cases=len(to_off),
        measured=max(to_off),
        target=10,
        unit="steps",
        note="to σ > 0.1 % and a joint that moves",
    )
    what = f"and that is not reached in the end, {'with' if limited else 'without'} acceleration limits"
    catalogue.row("A7", what, cases=len(to_off), measured=lost, target=0)
