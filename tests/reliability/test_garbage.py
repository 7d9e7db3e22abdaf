"""Row F, its part that no clock decides: steps leave nothing behind for the garbage collector.

What a step makes is freed by counting references, so the collector, where it runs at all, finds the youngest objects
only and nothing to free, whatever else is alive. Times are measured by ``benchmarks/latency.py``.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import QPController, QPOptions, SupervisionOptions, available_kernels
from coopqp.scenarios import Scenario, fast_lift, paper_lift


def no_feed(q: Any) -> Any:
    return None


def noisy(q: Any) -> Any:
    return q + 1e-6 * np.sin(1e6 * q)


def broken(q: Any) -> Any:
    return q * np.nan


#: Scenario, options, and what is measured of a commanded configuration.
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
    """Of each collection that runs, with the collector on: its generation, and how many objects it freed."""
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
    for kernel in available_kernels():
        for make, options, measure in CASES.values():
            task = replace(make(), dt=1e-3)
            made = QPOptions(kernel=kernel, **options)
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
