"""Arms, object and other bodies that keep clear of each other while they move."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Clearance, CollisionScene, QPController
from coopqp.collision import Body, Box, Capsule, Cylinder, NearPair, Sphere
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift, ring
from promise_cases import Promise

#: Cells, and how many bodies stand beside each.
_CELLS: dict[str, Callable[[], Scenario]] = {
    "3 arms": partial(paper_lift, time_law="quintic"),
    "8 arms": partial(ring, arms=8),
    "mixed": mixed_cell,
    "2 redundant": dual_arm7,
}
_COUNTS = (1, 10, 100)
#: Step [s]; margin, how far bodies are from the arms at the start, and how far outside the margin they pass [m].
_DT, _MARGIN, _CLEAR, _PASSES = 0.002, 0.005, 0.1, 0.005


def _body(rng: np.random.Generator, number: int, middle: Any) -> Body:
    """A body of a random shape and size, 0.3 to 2 m from the object."""
    a, b, c = rng.uniform(0.02, 0.1, 3)
    shapes = (Box((2 * a, 2 * b, 2 * c)), Sphere(a), Capsule(a, 2 * b), Cylinder(a, 2 * b))
    way = rng.normal(size=3)
    place = middle + way / np.linalg.norm(way) * rng.uniform(0.3, 2.0)
    return Body(f"body {number}", shapes[number % 4], pin.SE3(pin.exp3(rng.normal(size=3)), place))


def _motion(task: Scenario) -> Iterator[Any]:
    """Configurations of the run without bodies, every 100 ms."""
    controller = QPController(task.cell, task.grasp, task.path, dt=_DT)
    controller.reset(task.q_start)
    for i in range(round(1.5 * task.path.duration / _DT)):
        step = controller.step()
        if i % 50 == 0 or step.finished:
            yield step.q_next
        if step.finished:
            break


def _beside(task: Scenario, count: int, seed: int) -> CollisionScene:
    """A scene with that many bodies, none of them near where the arms start or in the way of the run without them."""
    rng, middle = np.random.default_rng(seed), task.path.pose(0.0).translation
    ignored = [("object", arm) for arm in task.cell.arm_names]
    bodies = [_body(rng, i, middle) for i in range(4 * count + 4)]
    scene = CollisionScene.of(task, obstacles=bodies, margin=_MARGIN, ignored=ignored)
    near = _within(scene.distances(task.q_start), _CLEAR)
    for q in _motion(task):
        near |= _within(scene.distances(q), _MARGIN + _PASSES)
    clear = [body for body in bodies if body.name not in near][:count]
    scene = CollisionScene.of(task, obstacles=clear, margin=_MARGIN, ignored=ignored)
    touch = [(p.first, p.second) for p in scene.distances(task.q_start) if p.distance < _MARGIN + 1e-4]
    return CollisionScene.of(task, obstacles=clear, margin=_MARGIN, ignored=[*ignored, *touch])


def _within(pairs: Sequence[NearPair], distance: float) -> set[str]:
    """Names of pairs that are closer."""
    return {name for pair in pairs if pair.distance < distance for name in (pair.first, pair.second)}


def _times(task: Scenario, scenes: Sequence[CollisionScene | None], runs: int) -> list[tuple[Any, bool]]:
    """For each scene the steps' times [µs], each the least of equal runs in the thread's own time; finished or not."""
    least: list[Any] = [None] * len(scenes)
    finished = [False] * len(scenes)
    gc.collect()
    gc.disable()
    for _ in range(runs):
        for i, scene in enumerate(scenes):
            constraints = [] if scene is None else [Clearance(scene)]
            controller = QPController(task.cell, task.grasp, task.path, dt=_DT, constraints=constraints)
            controller.reset(task.q_start)
            times = []
            for _ in range(round(1.5 * task.path.duration / _DT)):
                began = time.thread_time_ns()
                step = controller.step()
                times.append(1e-3 * (time.thread_time_ns() - began))
                if step.finished:
                    break
            finished[i] = step.finished
            least[i] = np.array(times) if least[i] is None else np.minimum(least[i], times)
    gc.enable()
    return list(zip(least, finished, strict=True))


def tails(quick: bool) -> Iterator[Promise]:
    """The tail of a step beside bodies that do not stop the object, over that without any."""
    for name in list(_CELLS)[: 1 if quick else None]:
        task = _CELLS[name]()
        for count in _COUNTS[: 2 if quick else None]:
            for seed in range(8):  # bodies that the object runs into make it wait: others then
                (without, _), (beside, finished) = _times(task, [None, _beside(task, count, seed)], 2 if quick else 5)
                if finished:
                    break
            p99 = float(np.percentile(beside, 99) / np.percentile(without, 99)) if finished else np.nan
            longest = float(beside.max() / without.max()) if finished else np.nan
            yield Promise(f"step beside {count} bodies, {name}: p99 over that without", p99, 1.5, "")
            yield Promise(f"step beside {count} bodies, {name}: longest over that without", longest, 3.0, "")


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    yield from tails(quick)
