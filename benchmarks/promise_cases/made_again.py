"""Runs with an operator's random calls, recorded, and made again in another process, bodies and forces among them."""

from __future__ import annotations

import multiprocessing
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from coopqp import Clearance, CollisionScene, ForceController, QPController, Recording, simulate
from coopqp.errors import StiffnessWarning
from coopqp.planning import Payload
from coopqp.scenarios import dual_arm7, elbow_and_knob, mixed_cell, paper_lift, plate_and_post
from coopqp.simulation import PhysicsPlant, differs_from, events_of, operating

Operate = Callable[[Any, int], None]
#: Kinds of runs, and seconds between two calls.
KINDS, _BETWEEN = ("free", "bodies", "forces"), 0.2


def _call(controller: Any, rng: np.random.Generator) -> None:
    """One call of any kind."""
    end = controller.path.duration
    twist = rng.normal(size=6) * np.repeat([0.08, 0.15], 3)
    calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
        ("pause", (), {}), ("resume", (), {}), ("set_override", (float(rng.uniform(0.2, 1.0)),), {}),
        ("reverse", (), {}), ("forward", (), {}), ("run_to", (float(rng.uniform(0.0, end)),), {}),
        ("step_to_mark", (), {}), ("return_to_path", (), {}),
        ("jog", (twist.tolist(),), {"deadman_s": 0.2, "frame": "world"}),
    ]  # fmt: skip
    call, values, named = calls[int(rng.integers(len(calls)))]
    getattr(controller, call)(*values, **named)


def _free(seed: int, operate: Operate) -> Recording:
    task = (paper_lift, dual_arm7, mixed_cell)[seed % 3]()
    cell = task.cell.with_limits(acceleration=5.0)
    controller = QPController(cell, task.grasp, task.path, dt=0.004)
    return simulate(controller, q_start=task.q_start, duration=4.0, operate=operate)


def _bodies(seed: int, operate: Operate) -> Recording:
    task = (plate_and_post, elbow_and_knob)[seed % 2]()
    cell = task.cell.with_limits(acceleration=5.0)
    constraints = [Clearance(CollisionScene.of(task, cell=cell))]
    controller = QPController(cell, task.grasp, task.path, dt=0.008, constraints=constraints)
    return simulate(controller, q_start=task.q_start, duration=2.0, operate=operate)


def _forces(seed: int, operate: Operate) -> Recording:
    task = paper_lift(time_law="quintic")
    plant = PhysicsPlant.of(task)
    inner = QPController(task.cell.with_limits(acceleration=5.0), task.grasp, task.path, dt=task.dt)
    payload = Payload(mass=plant.object_mass, centre=task.T_object_body.translation)
    controller = ForceController(inner, {"stiffness": plant.stiffness, "payload": payload, "presses": False})
    return simulate(controller, plant, q_start=task.q_start, duration=1.0, operate=operate)


_MADE = dict(zip(KINDS, (_free, _bodies, _forces), strict=True))


def recorded(kind: str, seed: int) -> Recording:
    """A run with random calls."""
    rng = np.random.default_rng(seed)

    def calls(controller: Any, done: int) -> None:
        if done % round(_BETWEEN / controller.dt) == 10:
            _call(controller, rng)

    return _quietly(lambda: _MADE[kind](seed, calls))


def first_difference(kind: str, seed: int, file: Path) -> int | None:
    """Make a run again that a file holds; the first step in which it differs in a bit, None if none does."""
    first = Recording.load(file)
    return differs_from(first, _quietly(lambda: _MADE[kind](seed, operating(events_of(first)))))


def elsewhere(runs: Sequence[tuple[str, int]]) -> Iterator[int | None]:
    """Record runs, and make them again in one other process; the first step in which each differs."""
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(1, mp_context=context) as pool:
        for i, (kind, seed) in enumerate(runs):
            file = recorded(kind, seed).save(Path(folder) / f"{i}.npz")
            yield pool.submit(first_difference, kind, seed, file).result()


def _quietly(make: Callable[[], Recording]) -> Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffnessWarning)
        return make()
