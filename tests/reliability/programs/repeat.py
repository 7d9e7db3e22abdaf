"""Hash the commands of many steps: ``python repeat.py SOLVER STEPS FILE``.

Prints the SHA-256 over all commands, and writes the joint velocities of the steps with a QP to FILE (.npy).
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import LinePath, QPController, QPOptions, ServoPath
from coopqp.scenarios import Scenario, at_limit, at_singularity, dual_arm7, fast_lift, mixed_cell, paper_lift


def to_and_fro(task: Scenario, steps: int, options: QPOptions, noise: float = 0.0) -> Iterator[Any]:
    path = task.path
    assert isinstance(path, LinePath)
    ways = [path, LinePath(path.goal, path.start, duration=path.duration, time_law=path.time_law)]
    rng = np.random.default_rng(11)
    controller = QPController(task.cell, task.grasp, path, dt=0.001, options=options)
    controller.reset(task.q_start)
    q = None
    for _ in range(steps):
        step = controller.step(q)
        yield step
        if noise:
            q = step.q_next + noise * rng.standard_normal(step.q_next.size)
        if step.finished:
            ways = ways[::-1]
            controller.follow(ways[0])


def once(task: Scenario, steps: int, options: QPOptions) -> Iterator[Any]:
    """Run the task again from the start whenever the object cannot move on."""
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)
    controller.reset(task.q_start)
    waited = 0
    for _ in range(steps):
        step = controller.step()
        yield step
        waited = waited + 1 if step.rate < 1e-3 else 0
        if waited > 100 or step.finished:
            controller.reset(task.q_start)
            waited = 0


def chase(task: Scenario, steps: int, options: QPOptions) -> Iterator[Any]:
    """Follow a target that moves every 50 steps."""
    start = task.path.pose(0.0)
    rng = np.random.default_rng(12)
    controller = QPController(task.cell, task.grasp, ServoPath(start), dt=0.002, options=options)
    controller.reset(task.q_start)
    for i in range(steps):
        if i % 50 == 0:
            shift, turn = 0.2 * rng.standard_normal(3), 0.3 * rng.standard_normal(3)
            controller.retarget(pin.SE3(start.rotation @ pin.exp3(turn), start.translation + shift))
        yield controller.step()


def all_steps(solver: str, n: int) -> Iterator[Any]:
    """About ``n`` steps: most with default options, some with a QP in every step."""
    usual, solving = QPOptions(solver=solver), QPOptions(solver=solver, shortcut=False)
    plain = QPOptions(solver=solver, shortcut=False)
    limited = at_limit()
    yield from to_and_fro(paper_lift(), int(0.5 * n), usual)
    yield from to_and_fro(dual_arm7(), int(0.2 * n), usual)
    yield from to_and_fro(mixed_cell(), int(0.1 * n), usual)
    yield from to_and_fro(mixed_cell(), int(0.01 * n), usual, noise=1e-4)
    yield from once(limited, int(0.1 * n), usual)
    yield from once(at_singularity("elbow"), int(0.05 * n), usual)
    yield from chase(limited, int(0.02 * n), usual)
    yield from once(fast_lift(), int(0.005 * n), solving)
    yield from once(dual_arm7(), int(0.005 * n), solving)
    yield from once(fast_lift(), int(0.005 * n), plain)
    yield from once(dual_arm7(), int(0.005 * n), plain)


def main(solver: str, n: int, file: str) -> None:
    digest, solved, count = hashlib.sha256(), [], 0
    for step in all_steps(solver, n):
        count += 1
        digest.update(step.velocity.tobytes())
        digest.update(step.q_next.tobytes())
        digest.update(f"{step.clock_next!r} {step.rate!r} {step.status} {step.binding}".encode())
        if step.solver.name != "none":
            solved.append(np.resize(step.velocity, 26))
    np.save(file, np.array(solved))
    print(count, digest.hexdigest())


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
