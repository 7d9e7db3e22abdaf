"""Key figures of a run: its worst status without healthy ramps; and where two runs first differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import Recording, Status
from coopqp.simulation import differs_from
from coopqp.simulation.evaluation.assessment import ramps, worst_status
from coopqp.spatial import Array

STEPS = 10
ACCELERATES, ENDS, FAST = ["slave_1", "joint_2", "acceleration"], ["", "", "path end"], ["master", "", "velocity"]
SLOWED = Status.SLOWED


def run_with(
    baseline: Callable[..., Recording],
    statuses: dict[Status, Any],
    rate: Array,
    binding: list[Any],
    *,
    finished: bool = True,
) -> Recording:
    """A run of ten steps with statuses at some of them, TRACKING at the others."""
    run = baseline(STEPS)
    status = np.zeros(STEPS)
    for one, where in statuses.items():
        status[where] = one.code
    return replace(run, status=status, rate=rate, metadata={**run.metadata, "binding": binding, "finished": finished})


UP = np.r_[0.2, 0.5, 0.8, np.ones(7)]
UP_AND_DOWN = np.r_[0.2, 0.5, 0.8, np.ones(5), 0.6, 0.3]


@pytest.mark.parametrize(
    ("statuses", "rate", "binding", "finished", "expected", "worst"),
    [
        ({}, np.ones(10), [], True, (0, 0), "ok"),
        ({SLOWED: [0, 1, 2]}, UP, [[0, [ACCELERATES]], [3, []]], True, (3, 0), "ok"),
        ({SLOWED: [0, 1, 2]}, UP, [], True, (3, 0), "ok"),
        ({SLOWED: [0, 1, 2]}, UP, [[0, [ACCELERATES, FAST]], [3, []]], True, (0, 0), "slowed"),
        ({SLOWED: [0, 2]}, UP, [], True, (1, 0), "slowed"),
        ({SLOWED: [0, 2], Status.PAUSED: [1]}, UP, [], True, (0, 0), "paused"),
        ({SLOWED: [0, 1, 2]}, np.r_[0.5, 0.2, 0.8, np.ones(7)], [], True, (0, 0), "slowed"),
        (
            {SLOWED: [0, 1, 2, 8, 9]},
            UP_AND_DOWN,
            [[0, [ACCELERATES]], [3, []], [8, [ENDS]]],
            True,
            (3, 2),
            "ok",
        ),
        ({SLOWED: [8, 9]}, UP_AND_DOWN, [[8, [ENDS, FAST]], [9, [ENDS]]], True, (0, 1), "slowed"),
        ({SLOWED: [8, 9]}, UP_AND_DOWN, [[8, [ENDS]]], False, (0, 0), "slowed"),
        ({}, np.ones(10), [], False, (0, 0), "tracking"),
        ({SLOWED: [3], Status.BLOCKED: [4], Status.PAUSED: [5]}, np.ones(10), [], True, (0, 0), "paused"),
        ({Status.HOLDING: [4], Status.OFF_PATH: [5]}, np.ones(10), [], True, (0, 0), "holding"),
        ({SLOWED: slice(None)}, 0.5 * np.ones(10), [[0, [FAST]]], True, (0, 0), "slowed"),
    ],
)
def test_a_healthy_run_only_speeds_up_and_brakes_for_its_end(
    baseline: Callable[..., Recording],
    statuses: dict[Status, Any],
    rate: Array,
    binding: list[Any],
    finished: bool,
    expected: tuple[int, int],
    worst: str,
) -> None:
    run = run_with(baseline, statuses, rate, binding, finished=finished)
    assert ramps(run) == expected
    assert worst_status(run) == worst


@pytest.mark.parametrize("name", ["q", "q_command", "clock", "velocity", "rate"])
@pytest.mark.parametrize("step", [0, 4, STEPS - 1])
def test_runs_differ_first_where_a_bit_does(baseline: Callable[..., Recording], name: str, step: int) -> None:
    run = baseline(STEPS)
    assert differs_from(run, run) is None
    values = np.array(getattr(run, name))
    flat = values.reshape(len(values), -1)
    flat[step, -1] = np.nextafter(flat[step, -1], np.inf)
    flat[-1, -1] += 1.0
    changes: dict[str, Any] = {name: values}
    other = replace(run, **changes)
    assert differs_from(run, other) == differs_from(other, run) == step


@pytest.mark.parametrize("name", ["q", "q_command", "clock"])
def test_runs_may_differ_at_their_last_sample_or_in_their_length(baseline: Callable[..., Recording], name: str) -> None:
    run = baseline(STEPS)
    values = np.array(getattr(run, name))
    values.reshape(len(values), -1)[-1, 0] += 1e-9
    changes: dict[str, Any] = {name: values}
    assert differs_from(run, replace(run, **changes)) == STEPS
    samples: dict[str, Any] = {n: getattr(run, n)[:8] for n in ("time", "q", "q_command", "clock", "reference")}
    steps: dict[str, Any] = {n: getattr(run, n)[:7] for n in ("velocity", "rate", "status")}
    shorter = replace(run, **samples, **steps)
    assert differs_from(run, shorter) == differs_from(shorter, run) == 7
    assert differs_from(shorter, shorter) is None
