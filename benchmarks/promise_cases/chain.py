"""The distance between the arms' views of the object, as commanded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from coopqp import ControlStep, LinePath, ObjectPath, QPController, Status
from coopqp.scenarios import Scenario, at_singularity, five_joint_pair, scara_pair
from coopqp.spatial import Array
from promise_cases import Promise
from promise_cases.chain_cells import Run, Task, few_joints, long_steps, run

#: Lengths of a step [ms], and the largest distance of the arms [µm].
LENGTHS = {1: 1.0, 2: 1.0, 5: 5.0, 10: 10.0, 20: 20.0, 40: 50.0, 60: 150.0}
#: Seeds of the cells with few joints, of those with long steps; cells among the latter of a UR3 and a Panda.
FEW, LONG, PAIRS = range(1000, 1060), range(2000, 2100), 4
ROTATIONS = ((0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3))


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    yield from known_pairs(quick)
    yield from few(quick)
    yield from lengths(quick)
    yield from without_limits(quick)


def known_pairs(quick: bool) -> Iterator[Promise]:
    """Lines that two arms of four or five joints cannot follow."""
    makes: tuple[Callable[[], Scenario], ...] = (five_joint_pair,) if quick else (five_joint_pair, scara_pair)
    for make in makes:
        task, largest = make(), 0.0
        for rotation in ROTATIONS[2:] if quick else ROTATIONS:
            path = LinePath.displaced(
                task.path.pose(0.0), translation=(0.03, 0.05, 0.06), rotation=rotation, duration=2.0
            )
            dt = 0.004 if quick else 0.001
            controller = QPController(task.cell, task.grasp, path, dt=dt)
            made = run(controller, Task(task.cell, task.grasp, path, task.q_start), int(2.2 / dt), every=5)
            largest = max(largest, made.apart)
        yield Promise(f"{task.name}: lines that it cannot follow, arms apart", 1e3 * largest, 0.05, "mm")


def few(quick: bool) -> Iterator[Promise]:
    """Random cells of arms with four to six joints on lines that they cannot all follow."""
    for acceleration, words in ((None, "no acceleration limits"), (5.0, "5 rad/s²")):
        runs: list[Run] = []
        for seed in FEW[:2] if quick else FEW:
            task = few_joints(seed, acceleration)
            dt = 0.002
            steps = int((1.2 if quick else 2.2) * task.path.duration / dt)
            runs.append(run(QPController(task.cell, task.grasp, task.path, dt=dt), task, steps, every=5))
        case = f"{len(runs)} cells of arms with 4 to 6 joints, {words}"
        apart = np.array([made.apart for made in runs])
        yield Promise(f"{case}: more than 0.05 mm apart", 100.0 * float((apart > 5e-5).mean()), 5.0, "%")
        unnamed = max(made.unnamed for made in runs)
        yield Promise(f"{case}: apart, but in a named hold", 1e3 * unnamed, 0.2, "mm")


def lengths(quick: bool) -> Iterator[Promise]:
    """Random cells of six- and seven-joint robots, half of them leaving a singularity, by the length of a step."""
    seeds = LONG[:6] if quick else LONG
    tasks = [long_steps(seed, ("ur3_limited", "panda") if seed % PAIRS == 0 else ()) for seed in seeds]
    for ms, bound in LENGTHS.items():
        if quick and ms < 20:
            continue
        dt, every = 1e-3 * ms, max(1, 10 // ms)
        largest = 0.0
        for task in tasks:
            controller = QPController(task.cell, task.grasp, task.path, dt=dt)
            largest = max(largest, run(controller, task, int(2.0 * task.path.duration / dt), every=every).apart)
        yield Promise(f"{len(tasks)} random cells, steps of {ms} ms: apart", 1e6 * largest, bound, "µm")


class Blind(ObjectPath):
    """A path that is not known ahead."""

    known_ahead = False

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration = path, path.duration

    def pose(self, clock: float) -> object:
        return self._path.pose(clock)

    def twist(self, clock: float) -> Array:
        return self._path.twist(clock)


@dataclass
class Speeds:
    """The longest move of a joint in a step, and the largest speed after 0.1 s of a hold."""

    dt: float
    move: float = 0.0
    held: float = 0.0
    since: int = 0

    def take(self, step: ControlStep) -> None:
        """Look at a step."""
        speed = float(np.abs(step.velocity).max())
        self.move = max(self.move, speed * self.dt)
        self.since = self.since + 1 if step.status is Status.HOLDING else 0
        if self.since * self.dt > 0.1:
            self.held = max(self.held, speed)


def without_limits(quick: bool) -> Iterator[Promise]:
    """Joints with neither velocity nor acceleration limits, led out of reach on a path that is not known ahead."""
    dt = 0.002
    seen = Speeds(dt)
    kinds: tuple[Literal["elbow", "reach", "wrist"], ...] = ("elbow", "reach", "wrist")
    for kind in kinds[:1] if quick else kinds:
        task = at_singularity(kind)
        task = replace(task, cell=task.cell.with_limits(velocity=np.inf, acceleration=np.inf), path=Blind(task.path))
        controller = QPController(task.cell, task.grasp, task.path, dt=dt)
        given = Task(task.cell, task.grasp, task.path, task.q_start)
        run(controller, given, 800 if quick else 3000, every=5, on=seen.take)
    yield Promise("joints without limits out of reach: move in a step", seen.move, 0.0501, "rad")
    yield Promise("joints without limits out of reach: speed after 0.1 s of a hold", seen.held, 1.0, "rad/s")
