"""A simulation in real time, on a clock that waits for nobody: calls, reset, recording, and how late it is."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from coopqp import ControlStep, InvalidInputError, QPController, Status, simulate
from coopqp.drivers import LoopOptions
from coopqp.drivers.real_time import RealTimeRun
from coopqp.drivers.timing import ManualTime
from coopqp.scenarios import Scenario
from coopqp.simulation import differs_from, events_of, operating


class Late(ManualTime):
    """A clock by which each period begins late."""

    def sleep_until(self, moment: float) -> None:
        super().sleep_until(moment + 0.012)


def _run(task: Scenario, **options: Any) -> RealTimeRun:
    controller = QPController(task.cell.with_limits(acceleration=5.0), task.grasp, task.path, dt=0.01)
    return RealTimeRun(controller, task.q_start, time=options.pop("time", ManualTime()), **options)


def _until(run: RealTimeRun, done: Callable[[ControlStep], bool], most: int = 3000) -> ControlStep:
    seen: list[ControlStep] = []

    def look(step: ControlStep) -> None:
        seen.append(step)
        if done(step) or len(seen) >= most:
            run.stop()

    run._stopped = False  # it goes on
    run.run(look)
    assert done(seen[-1]), seen[-1]
    return seen[-1]


def test_it_begins_paused_and_goes_on_when_told(paper: Scenario) -> None:
    run = _run(paper)
    for _ in range(3):
        assert _until(run, lambda step: True).status is Status.PAUSED
    run.call("forward")
    _until(run, lambda step: step.finished)
    run.call("reverse", 1.0)
    step = _until(run, lambda step: step.status is Status.PAUSED)
    assert step.clock_next == pytest.approx(1.0, abs=1e-9)


def test_what_it_records_is_repeated_bit_for_bit(paper: Scenario) -> None:
    run = _run(paper, records=True)
    run.call("forward")
    _until(run, lambda step: step.clock > 0.8)
    run.call("jog", [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], frame="world")
    _until(run, lambda step: step.status is Status.JOGGING)
    run.call("return_to_path")
    _until(run, lambda step: step.status is Status.TRACKING)
    first = run.recording({"scenario": "by hand"})
    again = QPController(paper.cell.with_limits(acceleration=5.0), paper.grasp, paper.path, dt=0.01)
    again.pause()
    second = simulate(again, q_start=paper.q_start, duration=first.time[-1], operate=operating(events_of(first)))
    assert differs_from(first, second) is None
    assert first.metadata["scenario"] == "by hand"


def test_a_reset_ends_a_fault_where_the_arms_are(paper: Scenario) -> None:
    run = _run(paper, records=True)
    run.call("forward")
    _until(run, lambda step: step.clock > 0.5)
    far = run._measured.copy()
    for _ in range(3):
        far[0] += 0.1
        run._measured = far
        _until(run, lambda step: True)
    _until(run, lambda step: step.status is Status.FAULT and np.abs(step.velocity).max() < 1e-9)
    here, clock = run.controller.commanded.copy(), run.controller.program_clock
    run.call("reset")
    step = _until(run, lambda step: step.status is Status.PAUSED)
    assert np.abs(step.q_next - here).max() < 1e-6
    assert step.clock == clock
    assert run.recorded == 1  # a recording begins anew


def test_a_reset_off_the_program_begins_again(paper: Scenario) -> None:
    run = _run(paper)
    for _ in range(60):
        run.call("jog", [0.0, 0.0, 0.2, 0.0, 0.0, 0.0], frame="world")
        _until(run, lambda step: True)
    assert np.abs(run.controller.commanded - paper.q_start).max() > 0.01
    run.call("reset")
    step = _until(run, lambda step: step.status is Status.PAUSED)
    np.testing.assert_allclose(step.q_next, paper.q_start, atol=1e-9)


def test_bad_calls_are_named(paper: Scenario) -> None:
    run = _run(paper)
    with pytest.raises(InvalidInputError, match="no call 'step'"):
        run.call("step")
    with pytest.raises(InvalidInputError, match="set_override"):
        run.call("set_override", 2.0)
    with pytest.raises(InvalidInputError, match="records=True"):
        run.recording()
    with pytest.raises(InvalidInputError, match="Give a QPController"):
        RealTimeRun(object(), paper.q_start)


def test_late_periods_are_counted_and_not_made_up_for(paper: Scenario) -> None:
    run = _run(paper, time=Late())
    assert run.lateness() == (0.0, 0.0, 0.0)
    for _ in range(5):
        _until(run, lambda step: True)
    assert run.missed == 5
    assert run.lateness()[2] == pytest.approx(0.012)
    assert run.lateness(1)[1] == pytest.approx(0.012)


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="this system has no such schedulers")
def test_the_real_time_scheduler_is_asked_for_and_given_back(paper: Scenario) -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    run, seen = _run(paper, realtime=7), []
    assert run.scheduler == "ordinary"

    def look(_: ControlStep) -> None:
        seen.append((os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))
        run.stop()

    run.run(look)
    granted = run.scheduler == "FIFO, priority 7"
    assert granted or run.scheduler.startswith("not granted")
    assert seen == [(os.SCHED_FIFO, 7) if granted else before]
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


@pytest.mark.parametrize("bad", [0, 100, 1.5, "high"])
def test_priorities_that_are_none_are_named(paper: Scenario, bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="RealTimeRun: realtime"):
        _run(paper, realtime=bad)
    with pytest.raises(InvalidInputError, match="LoopOptions: realtime"):
        LoopOptions(realtime=bad)
