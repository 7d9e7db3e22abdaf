"""Many steps of several controllers in one process; prints the resources of the process after each round as JSON.

``python soak.py ROUNDS``: a round has 100 000 steps, mostly back and forth along paths. Some steps have measurements,
QPs in every step, bad numbers, resets, or moving targets.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import LinePath, QPController, QPOptions, ServoPath
from coopqp.scenarios import Scenario, at_limit, dual_arm7, mixed_cell, paper_lift

#: Number of steps between two checks of placements.
EVERY = 997


class Shuttle:
    """A controller that moves its object back and forth."""

    def __init__(self, task: Scenario, **options: Any) -> None:
        path = task.path
        assert isinstance(path, LinePath)
        back = LinePath(path.goal, path.start, duration=path.duration, time_law=path.time_law)
        self.ways, self.steps, self.defect = (path, back), 0, 0.0
        self.controller = QPController(task.cell, task.grasp, path, dt=0.001, options=QPOptions(**options))
        self.task = task
        self.controller.reset(task.q_start)

    def go(self, steps: int, *, noise: float = 0.0, rng: np.random.Generator | None = None) -> None:
        controller, q = self.controller, None
        for _ in range(steps):
            step = controller.step(q)
            self.steps += 1
            if rng is not None:
                q = step.q_next + noise * rng.standard_normal(step.q_next.size)
            if step.finished:
                self.ways = self.ways[::-1]
                controller.follow(self.ways[0])
            if self.steps % EVERY == 0:
                self.look(step)

    def restart(self) -> None:
        """Start again at the start of the first way."""
        if self.ways[0] is not self.task.path:
            self.ways = self.ways[::-1]
        self.controller.follow(self.ways[0])
        self.controller.reset(self.task.q_start)

    def look(self, step: Any) -> None:
        """Measure the deviation of placements from rotations, and of continuous joints from the unit circle."""
        cell = step.cell
        for T in (*step.state.T_world_tool, *step.grasp.carried(step.state), step.path.pose(step.clock_next)):
            self.defect = max(self.defect, float(np.abs(T.rotation @ T.rotation.T - np.eye(3)).max()))
        for j in np.flatnonzero(cell.continuous):
            i = cell.position_index[j]
            self.defect = max(self.defect, abs(float(np.hypot(*step.q_next[i : i + 2])) - 1.0))


def round_of(shuttles: list[Shuttle], limit: Scenario, servo: QPController, rng: np.random.Generator) -> None:
    """Run 100 000 steps."""
    nominal, redundant, mixed, solving, own = shuttles
    nominal.go(69_700)
    redundant.go(15_000)
    mixed.go(11_000)
    mixed.go(500, noise=1e-5, rng=rng)
    nominal.go(1_000, noise=1e-5, rng=rng)
    nominal.restart()
    solving.go(500)
    own.go(300)
    bad = nominal.task.q_start.copy()
    bad[0] = np.nan
    for _ in range(500):
        nominal.controller.step(bad)
        nominal.controller.step(dt=np.inf)
    for _ in range(5):  # into a limit, with a new controller each time
        blocked = QPController(limit.cell, limit.grasp, limit.path, dt=0.002)
        blocked.reset(limit.q_start)
        for _ in range(100):
            blocked.step()
    start = servo.path.pose(0.0)
    for _ in range(50):
        servo.retarget(pin.SE3(start.rotation, start.translation + 0.02 * rng.standard_normal(3)))
        for _ in range(10):
            servo.step()


def held() -> dict[str, int]:
    """Resources of the process: resident memory [bytes], open files, objects tracked by Python.

    Without the pages of files, which the system loads when it likes, and without free memory that malloc keeps.
    """
    gc.collect()
    getattr(ctypes.CDLL(None), "malloc_trim", lambda pad: 0)(0)
    resident, of_files = (int(pages) for pages in Path("/proc/self/statm").read_text().split()[1:3])
    return {
        "resident": (resident - of_files) * os.sysconf("SC_PAGE_SIZE"),
        "files": len(list(Path("/proc/self/fd").iterdir())),
        "objects": len(gc.get_objects()),
    }


def main(rounds: int) -> None:
    rng = np.random.default_rng(7)
    lift = paper_lift()
    shuttles = [
        Shuttle(lift),
        Shuttle(dual_arm7()),
        Shuttle(mixed_cell()),
        Shuttle(lift, shortcut=False, solver="daqp"),
        Shuttle(lift, shortcut=False),
    ]
    servo_task = replace(lift, path=ServoPath(lift.path.pose(0.0)))
    servo = QPController(lift.cell, lift.grasp, servo_task.path, dt=0.001)
    servo.reset(lift.q_start)
    limit = at_limit()
    samples = []
    for _ in range(rounds):
        round_of(shuttles, limit, servo, rng)
        samples.append(held())
    print(json.dumps({"samples": samples, "defect": max(s.defect for s in shuttles)}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
