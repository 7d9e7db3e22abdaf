"""Row F, the part without timing: steps create no work for the garbage collector.

Reference counting frees the objects of a step. The collector, if it runs, visits only the youngest objects and frees
nothing, independently of other objects. ``benchmarks/latency.py`` measures times.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import QPController, QPOptions, SupervisionOptions
from coopqp.scenarios import Scenario, fast_lift, paper_lift


def no_feed(q: Any) -> Any:
    return None


def noisy(q: Any) -> Any:
    return q + 1e-6 * np.sin(1e6 * q)


def broken(q: Any) -> Any:
    return q * np.nan


#: Scenario, options, and the measured configuration as a function of the commanded one.
CASES: dict[str, tuple[Callable[[], Scenario], dict[str, Any], Callable[[Any], Any]]] = {
    "nominal": (paper_lift, {}, no_feed),
    "measured": (paper_lift, {}, noisy),
    "servos watched": (paper_lift, {"supervision": SupervisionOptions(stiffness=1e5)}, noisy),
    "slowed": (fast_lift, {}, no_feed),
    "a QP at every step": (fast_lift, {"shortcut": False}, no_feed),
    "held": (paper_lift, {}, broken),
}


@pytest.fixture
def collections() -> Iterator[list[tuple[int, int]]]:
    """Generation and number of freed objects of each collection, with the collector on."""
    ran: list[tuple[int, int]] = []

    def watch(phase: str, info: dict[str, int]) -> None:
        if phase == "stop":
            ran.append((info["generation"], info["collected"] + info["uncollectable"]))

    gc.enable()
    gc.callbacks.append(watch)
    yield ran
    gc.callbacks.remove(watch)


@pytest.mark.slow
def test_steps_leave_nothing_to_collect(collections: list[tuple[int, int]], catalogue: Any, count: Any) -> None:
    steps, cases, left = count(1000), 0, 0
    for make, options, measure in CASES.values():
        task = replace(make(), dt=1e-3)
        made = QPOptions(**options)
        controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=made)
        controller.reset(task.q_start)
        step = controller.step()
        gc.collect()
        collections.clear()
        for _ in range(steps):
            step = controller.step(measure(step.q_next))
        assert all(generation < 2 for generation, _ in collections)
        gc.collect()
        left += sum(freed for _, freed in collections)
        cases += steps
    name = "objects of steps that only the garbage collector could free"
    catalogue.row("F", name, cases=cases, measured=left, target=0)


def test_the_count_would_see_a_cycle(collections: list[tuple[int, int]]) -> None:
    gc.collect()
    collections.clear()
    for _ in range(10):
        cycle: list[Any] = []
        cycle.append(cycle)
    del cycle
    gc.collect()
    assert sum(freed for _, freed in collections) >= 10
