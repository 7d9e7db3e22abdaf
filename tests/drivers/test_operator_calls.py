"""An operator's calls to a running loop, from any thread: the arms stay together, and keep the limits."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from robots import drive, simulated_robots

from coopqp import InvalidInputError, QPController
from coopqp.drivers import ControlLoop, ManualTime
from coopqp.scenarios import paper_lift

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]
LAGS, NONE = (0.007, 0.032, 0.047), (0.0, 0.0, 0.0)
#: Half the largest lag squared times the deceleration is 11 mrad, of joints up to 0.8 m from the tools [m].
BRAKED = 0.5 * 0.047**2 * 10.0 * 0.8


@pytest.fixture(scope="module")
def lift():
    return paper_lift(time_law="quintic", duration=1.5)


@pytest.fixture(scope="module")
def cell(lift):
    return lift.cell.with_limits(acceleration=10.0)


def _kept(run, apart=2e-5):
    assert run.report.finished, run.report.reason
    assert run.report.velocity <= 1.0 + 1e-9
    assert run.report.acceleration <= 1.0 + 1e-9
    assert run.apart.max() < apart


def test_back_along_the_path_and_on_again(cell, lift):
    futures = []
    run = drive(cell, lift, LAGS, events=[
        (0.9, lambda arms, loop: futures.append(loop.reverse(0.2))),
        (3.0, lambda arms, loop: futures.append(loop.run_to(0.6))),
        (5.0, lambda arms, loop: futures.append(loop.forward())),
    ])  # fmt: skip
    _kept(run, BRAKED)
    assert [future.result(0) for future in futures] == [None] * 3
    at = {time: run.q[np.searchsorted(run.time, time)] for time in (0.9, 2.9, 4.9)}
    once = drive(cell, lift, NONE)
    for time, clock in ((2.9, 0.2), (4.9, 0.6)):
        # It rests where the program is at that clock: some configuration of the run without calls.
        assert np.abs(once.q - at[time]).max(axis=1).min() < 2e-3, clock
    assert "paused" in run.statuses


def test_by_hand_away_from_the_path_and_back(cell, lift):
    jogs = [(0.5 + 0.05 * i, lambda arms, loop: loop.jog([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])) for i in range(20)]
    run = drive(cell, lift, NONE, events=[*jogs, (2.5, lambda arms, loop: loop.return_to_path())])
    _kept(run)
    assert "jogging" in run.statuses
    end = drive(cell, lift, LAGS).q[-1]
    np.testing.assert_allclose(run.q[-1], end, atol=2e-3)


def test_a_jog_ends_after_its_time_though_the_clock_of_the_loop_is_slow(cell, lift):
    """From rest the loop's clock begins at a tenth of its rate; the controller alone would go on for a second."""
    run = drive(cell, lift, NONE, events=[
        (0.5, lambda arms, loop: loop.pause()),
        (1.5, lambda arms, loop: loop.jog([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])),
        (3.0, lambda arms, loop: (loop.resume(), loop.return_to_path())),
    ])  # fmt: skip
    _kept(run)
    moves = np.abs(np.diff(run.sent, axis=0)).max(axis=1) / 0.002 > 1e-3
    times = run.time[1:][moves & (run.time[1:] > 1.45) & (run.time[1:] < 2.95)]
    assert len(times)
    assert times[-1] < 1.5 + 0.1 + 0.3


def test_a_refused_call_is_its_callers_and_the_loop_goes_on(cell, lift):
    futures = []
    run = drive(cell, lift, NONE, events=[(0.3, lambda arms, loop: futures.append(loop.reverse(1.4)))])
    _kept(run)
    with pytest.raises(InvalidInputError, match="ahead"):
        futures[0].result(0)
    assert run.report.refused_calls[0].startswith("reverse: ")
    assert "refused reverse" in "\n".join(run.report.lines())


def test_a_call_of_another_thread_is_made_between_two_periods(cell, lift):
    time = ManualTime()
    arms = simulated_robots(cell, lift.q_start, time, LAGS)
    made = []

    class Recorder:
        number = 0

        def take(self, *given):
            self.number += 1
            if self.number == 200:
                thread = threading.Thread(target=lambda: made.append(loop.reverse(0.0)))
                thread.start()
                thread.join()
            if self.number == 1200:
                loop.forward()

    loop = ControlLoop(QPController(cell, lift.grasp, lift.path, dt=0.002), arms, recorder=Recorder(), time=time)
    report = loop.run()
    assert report.finished, report.reason
    assert made[0].done()
    assert report.time > 3.5


def test_a_controller_without_the_call_is_said_to_the_caller(cell, lift):
    class Bare:
        cell, dt = lift.cell, 0.002

        def reset(self, *given): ...

        step = pause = resume = set_override = reset

    arms = simulated_robots(lift.cell, lift.q_start, ManualTime(), LAGS)
    loop = ControlLoop(Bare(), arms, time=ManualTime())
    with pytest.raises(InvalidInputError, match=r"has no reverse\(\)"):
        loop.reverse()
