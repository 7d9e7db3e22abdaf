"""Paths of users that jump or bend without a word: the object stops by name, and a step asks them a few times only."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from marks import slow_but_first

from coopqp import ObjectPath, QPController, Status
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array

#: Questions to the path in a step of 2 ms: for its reference, for what is ahead, at a corner.
MOST_ASKED = 12


class Told(ObjectPath):
    """A share of the way by the clock, with twists by finite differences; counts its own calls."""

    duration = 3.0

    def __init__(self, start: pin.SE3, kind: str) -> None:
        self._start, self._kind, self.calls = start, kind, 0

    def _share(self, clock: float) -> float:
        x = min(max(clock, 0.0), self.duration) / self.duration
        if self._kind == "root":
            return math.sqrt(x)
        if self._kind == "kinks":
            i = math.floor(300.0 * x)
            return (i + (0.3 if i % 2 else 1.7) * (300.0 * x - i) + 0.7 * (i % 2)) / 300.0
        ramp = 0.5 if self._kind == "ramps and stairs" else 0.0
        return ramp * x + (1.0 - ramp) * math.floor(6.0 * x) / 6.0

    def _pose(self, clock: float) -> pin.SE3:
        share = self._share(clock)
        turn = pin.exp3(np.array([0.0, 0.0, 0.1 * share]))
        return pin.SE3(turn @ self._start.rotation, self._start.translation + share * np.array([0.0, 0.02, 0.2]))

    def pose(self, clock: float) -> pin.SE3:
        self.calls += 1
        return self._pose(clock)

    def twist(self, clock: float) -> Array:
        self.calls += 1
        before, after = max(clock - 1e-6, 0.0), min(clock + 1e-6, self.duration)
        return np.asarray(pin.log6(self._pose(before).actInv(self._pose(after))).vector) / (after - before)


def controller_on(kind: str, acceleration: float) -> tuple[QPController, Told]:
    task = paper_lift()
    path = Told(task.path.pose(0.0), kind)
    cell = task.cell.with_limits(acceleration=acceleration)
    controller = QPController(cell, task.grasp, path, dt=0.002)
    controller.reset(task.q_start)
    return controller, path


@pytest.mark.parametrize("acceleration", slow_but_first([8.0, np.inf]))
@pytest.mark.parametrize("kind", ["stairs", "ramps and stairs", "root", "kinks"])
def test_a_step_asks_a_path_a_few_times_and_says_what_stops_it(kind: str, acceleration: float) -> None:
    controller, path = controller_on(kind, acceleration)
    unnamed = 0
    for _ in range(700):
        path.calls = 0
        step = controller.step()
        assert path.calls <= MOST_ASKED
        waits = step.status is Status.SLOWED and step.rate < 1e-3 and not step.binding
        unnamed = unnamed + 1 if waits else 0
        assert unnamed <= 20
    if kind in ("stairs", "ramps and stairs"):
        assert step.status is Status.BLOCKED
        by = "38.5" if kind == "stairs" else "19.2"
        assert step.reason.startswith(f"the path jumps by {by} mm at its clock 0.500 s")
        assert 0.49 < step.clock < 0.5


def test_a_path_that_starts_like_a_root_is_too_steep_and_jumps_not() -> None:
    for acceleration in (np.inf, 8.0):
        controller, path = controller_on("root", acceleration)
        for _ in range(60):
            path.calls = 0
            step = controller.step()
            assert path.calls <= MOST_ASKED
        assert step.status is Status.BLOCKED
        assert step.reason == "the path is too steep at its clock 0.000 s: it moves by 0.1 mm within 1 µs"


@pytest.mark.core
@pytest.mark.parametrize("kind", ["ramps and stairs", "root", pytest.param("kinks", marks=pytest.mark.slow)])
@pytest.mark.parametrize("acceleration", slow_but_first([8.0, np.inf]))
def test_paths_that_jump_and_bend_as_recorded(kind: str, acceleration: float, golden: Golden) -> None:
    golden.of(controller_on(kind, acceleration)[0], 1e-8).run(330)


def test_a_path_that_fails_and_answers_again_is_looked_at_a_little_at_a_time() -> None:
    controller, path = controller_on("ramps and stairs", 8.0)
    share: Any = path._share
    for i in range(160):
        path._share = (lambda clock: math.nan) if 50 <= i < 60 else share  # type: ignore[method-assign]
        path.calls = 0
        step = controller.step()
        assert path.calls <= MOST_ASKED
        assert (step.status is Status.HOLDING) == (50 <= i < 60)
    assert step.status is Status.TRACKING
