"""Row I2: targets that move, in and out of reach, streamed with noise and jumps: the object never leaves its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import QPController, ServoPath, Status, chain_error, object_error, tool_placements
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, panda_bar, paper_lift, ring, ur5_table

pytestmark = pytest.mark.slow

DT, SECONDS = 0.002, 3.0
MM = 1e-3
CELLS = (paper_lift, dual_arm7, mixed_cell, panda_bar, ur5_table, lambda: ring(arms=2), lambda: ring(arms=8))
#: How fast the targets move [m/s], and after this long the object should be on its way [s].
SPEED, STARTED = 0.2, 0.5


@dataclass
class Chase:
    """What came of a run.

    Attributes:
        apart, off: largest chain error, and distance of the object from its path [m].
        flips: steps whose change of velocity is more than the joints' acceleration allows (v_max/8 without).
        nameless: steps that are BLOCKED or HOLDING and do not say why.
        swing: largest way of the object in BLOCKED steps that follow each other, but for the first ten [m].
        lags: distances of the path from the target [m].
    """

    apart: float = 0.0
    off: float = 0.0
    flips: int = 0
    nameless: int = 0
    swing: float = 0.0
    lags: list[float] = field(default_factory=list)


def target_at(kind: str, start: pin.SE3, rng: np.random.Generator) -> Callable[[float], pin.SE3]:
    """Where the target is at a time."""
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    side = np.cross(way, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    turn, there, radius = 0.2 * rng.normal(size=3), 0.3 * rng.normal(size=3), 0.1

    def near(t: float) -> pin.SE3:  # round a circle at 0.2 m/s
        angle = SPEED * t / radius
        return pin.SE3(
            start.rotation, start.translation + radius * (np.sin(angle) * way + (np.cos(angle) - 1.0) * side)
        )

    def far(t: float) -> pin.SE3:  # out of reach, then elsewhere
        x = 2.0 * way * np.sin(t) if t < 0.6 * SECONDS else there
        noise = 1e-4 * rng.normal(size=3)
        return pin.SE3(start.rotation @ pin.exp3(np.sin(t) * turn), start.translation + x + noise)

    return near if kind == "in reach" else far


def chase(task: Scenario, kind: str, acceleration: float, hertz: float, seed: int) -> Chase:
    cell = task.cell.with_limits(acceleration=acceleration)
    start, seen = task.path.pose(0.0), Chase()
    path, target = ServoPath(start), target_at(kind, start, np.random.default_rng(seed))
    controller = QPController(cell, task.grasp, path, dt=DT)
    controller.reset(task.q_start)
    velocity = np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0)
    most = acceleration * DT * np.ones(cell.nv) if np.isfinite(acceleration) else velocity / 8.0
    before, stood = np.zeros(cell.nv), list[Any]()
    every = max(1, round(1.0 / (hertz * DT)))
    for i in range(int(SECONDS / DT)):
        t = i * DT
        if i % every == 0:
            goal = target(t)
            controller.retarget(goal)
        step = controller.step()
        tools, reference = tool_placements(cell, [step.q_next])[0], path.pose(step.clock_next)
        seen.apart = max(seen.apart, chain_error(tools, task.grasp)[0])
        seen.off = max(seen.off, object_error(tools, task.grasp, reference)[0])
        seen.flips += bool((np.abs(step.velocity - before) > most * (1.0 + 1e-6) + 1e-9).any())
        before = step.velocity
        blocked = step.status is Status.BLOCKED
        seen.nameless += (blocked or step.status is Status.HOLDING) and not (step.binding or step.reason)
        stood = [*stood, reference.translation] if blocked else []
        if len(stood) > 10:
            seen.swing = max(seen.swing, float(np.ptp(np.array(stood[10:]), axis=0).max()))
        if kind == "in reach" and t > STARTED:
            seen.lags.append(float(np.linalg.norm(reference.translation - goal.translation)))
    return seen


@pytest.mark.parametrize("acceleration", [5.0, np.inf], ids=["5 rad/s²", "no acceleration limits"])
@pytest.mark.parametrize("kind", ["in reach", "out of reach"])
def test_targets_are_chased_on_the_path(
    kind: str, acceleration: float, count: Callable[[int], int], catalogue: Any
) -> None:
    runs = [
        chase(make(), kind, acceleration, hertz, seed)
        for make in CELLS
        for seed in range(count(1))
        for hertz in (100.0, 1.0 / DT)
    ]
    name = f"targets {kind}, {'5 rad/s²' if np.isfinite(acceleration) else 'no acceleration limits'}"
    steps = len(runs) * int(SECONDS / DT)

    def row(test: str, measured: float, target: float, unit: str = "") -> None:
        catalogue.row("I2", f"{name}: {test}", cases=steps, measured=measured, target=target, unit=unit)

    row("chain error", max(r.apart for r in runs) / MM, 0.01, "mm")
    row("off the path", max(r.off for r in runs) / MM, 0.01, "mm")
    row("changes of velocity beyond a·dt or v/8", sum(r.flips for r in runs), 0)
    row("stops without a name", sum(r.nameless for r in runs), 0)
    row("swing while blocked", max(r.swing for r in runs) / MM, 0.01, "mm")
    if kind == "in reach" and np.isfinite(acceleration):
        lags = np.concatenate([r.lags for r in runs])
        row("median lag behind 0.2 m/s", float(np.median(lags)) / MM, 20.0, "mm")
