"""An operator's calls to a running loop, from any thread: the arms stay together, and keep the limits."""

from __future__ import annotations

import asyncio
import contextlib
import threading

import numpy as np
import pytest
from robots import drive, simulated_robots

from coopqp import CoopqpError, InvalidInputError, QPController
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


def _run_with(cell, lift, recorder, *shows, drivers=lambda arms: arms, **options):
    """A run whose recorder is made of its loop; and the commands of all periods."""
    time, sent = ManualTime(), []
    arms = drivers(simulated_robots(cell, lift.q_start, time, NONE))

    class Sees:
        def take(self, moment, measured, commands, step, clock):
            sent.append(commands.copy())
            recorder(loop, len(sent))

    controller = QPController(cell, lift.grasp, lift.path, dt=0.002)
    loop = ControlLoop(controller, arms, recorder=Sees(), time=time, **options)
    loop.shows.extend(shows)
    return loop.run(), np.array(sent)


@pytest.fixture(scope="module")
def alone(cell, lift):
    """The commands of a run that nobody calls."""
    report, sent = _run_with(cell, lift, lambda loop, n: None)
    assert report.finished, report.reason
    return sent


def test_no_call_ends_the_loop_whatever_its_caller_does(cell, lift, alone):
    """Cancelled, waited for too shortly, answered by the caller itself, of no use: the run is that without calls."""
    told = []

    def rude(future):
        future.set_result(None)

    calls = {
        100: lambda loop: loop.pause().cancel(),
        110: lambda loop: asyncio.run(_impatient(loop.set_override(0.5))),
        120: lambda loop: rude(loop.set_override(0.5)),
        130: lambda loop: loop.set_override(1.0).add_done_callback(lambda done: 1 / 0),
        140: lambda loop: told.append(loop.jog([0.0] * 6, frame="nobody")),
        150: lambda loop: told.append(loop.jog([0.0] * 6, frame=["world"])),
        160: lambda loop: told.append(loop.jog("abc")),
        170: lambda loop: told.append(loop.reverse(object())),
        180: lambda loop: told.append(loop.shift_path(None)),
        190: lambda loop: told.append(loop.gear(10**400)),
    }
    report, sent = _run_with(cell, lift, lambda loop, n: calls.get(n, lambda loop: None)(loop))
    assert report.finished, report.reason
    np.testing.assert_array_equal(sent, alone)
    for future in told:
        assert isinstance(future.exception(0), CoopqpError)
    assert len(report.refused_calls) == len(told)
    assert not report.failures


async def _impatient(future):
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(asyncio.wrap_future(future), 0.0)


def test_what_a_recorder_and_a_page_raise_is_said_once_and_no_command_is_left_out(cell, lift, alone):
    def fails(loop, n):
        if n % 3 == 0:
            raise OSError("disk full")

    def page(step):
        raise KeyError("browser gone")

    report, sent = _run_with(cell, lift, fails, page)
    assert report.finished, report.reason
    np.testing.assert_array_equal(sent, alone)
    assert set(report.failures) == {"page raised KeyError: 'browser gone'", "recorder Sees raised OSError: disk full"}
    assert "failed: recorder Sees raised OSError: disk full" in report.lines()


def test_of_calls_that_decide_the_same_the_last_one_is_made_and_answers_for_all(cell, lift):
    futures = []

    def asks(loop, n):
        if n == 100:
            futures.extend([loop.pause(), loop.reverse(0.0), loop.resume(), loop.run_to(0.5), loop.resume()])
            futures[-1].cancel()

    report, _ = _run_with(cell, lift, lambda loop, n: (asks(loop, n), loop.forward() if n == 400 else None))
    assert report.finished, report.reason
    assert [future.cancelled() for future in futures] == [False, False, False, False, True]
    assert [future.result(0) for future in futures[:4]] == [None] * 4
    assert report.slowest_rate >= 0.0


def test_a_driver_whose_reading_raises_is_one_that_tells_nothing(cell, lift):
    def drivers(arms):
        arm, left = next(iter(arms.values())), [700]
        read = arm.read

        def fails():
            left[0] -= 1
            if left[0] < 0:
                raise OSError("cable out")
            return read()

        arm.read = fails
        return arms

    report, sent = _run_with(cell, lift, lambda loop, n: None, drivers=drivers)
    assert not report.finished
    assert "told no state of use (its driver raised OSError: cable out)" in report.reason
    assert np.abs(sent[-1] - sent[-2]).max() < 1e-8


def test_a_controller_without_the_call_is_said_to_the_caller(cell, lift):
    class Bare:
        cell, dt = lift.cell, 0.002

        def reset(self, *given): ...

        step = pause = resume = set_override = reset

    arms = simulated_robots(lift.cell, lift.q_start, ManualTime(), LAGS)
    loop = ControlLoop(Bare(), arms, time=ManualTime())
    with pytest.raises(InvalidInputError, match=r"has no reverse\(\)"):
        loop.reverse()
