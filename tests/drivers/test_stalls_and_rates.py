"""A loop that stands for a while goes on from rest; robots whose states or clocks are not as told are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_but_first
from robots import simulated_robots

from coopqp import QPController
from coopqp.drivers import Command, ControlLoop, DriverError, ManualTime
from coopqp.scenarios import paper_lift

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")
_ACCELERATION = 10.0


@pytest.fixture(scope="module")
def lift():
    lift = paper_lift(time_law="quintic", duration=1.0)
    return replace(lift, cell=lift.cell.with_limits(acceleration=_ACCELERATION))


class _LeapingTime:
    """Time that goes on when it is waited for; once it leaps."""

    def __init__(self, at, by):
        self._now, self._at, self._by = 0.0, at, by
        self.back = np.inf

    def now(self):
        return self._now

    def sleep_until(self, moment):
        self._now = max(self._now, moment)
        if self._now > self._at and self.back == np.inf:
            self._now += self._by
            self.back = self._now


class _Sent:
    def __init__(self):
        self.times, self.sent = [], []

    def take(self, moment, measured, sent, step, clock):
        self.times.append(moment)
        self.sent.append(sent.copy())


def _run(lift, time, drivers, **options):
    recorder = _Sent()
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.002)
    loop = ControlLoop(controller, drivers, options, recorder=recorder, time=time)
    return loop.run(), np.array(recorder.times), np.array(recorder.sent)


@pytest.mark.parametrize("stall", slow_but_first([0.05, 0.008, 0.3]))
@pytest.mark.parametrize("lags", slow_but_first([(0.007, 0.032, 0.047), (0.0, 0.0, 0.0)]))
def test_after_a_stall_the_arms_go_on_from_rest(lift, stall, lags):
    time = _LeapingTime(0.6, stall)
    report, times, sent = _run(lift, time, simulated_robots(lift.cell, lift.q_start, time, lags))
    assert report.finished
    assert report.stalls == 1
    assert any("ran out" in line for line in report.lines())
    at = int(np.searchsorted(times, time.back - 1e-9))
    steps = np.diff(sent, axis=0) / 0.002
    assert np.abs(steps[at - 2]).max() > 0.3  # in full motion, until the loop stood
    change = np.diff(np.vstack([np.zeros(lift.cell.nv), steps[at - 1 :]]), axis=0) / 0.002
    assert np.abs(change).max() <= _ACCELERATION * (1.0 + 1e-6)


def test_a_stall_that_is_long_ends_the_run(lift):
    time = _LeapingTime(0.6, 60.0)
    report, times, sent = _run(lift, time, simulated_robots(lift.cell, lift.q_start, time, (0.007, 0.032, 0.047)))
    assert not report.finished
    assert "the loop stood for 60.00 s" in report.reason
    at = int(np.searchsorted(times, time.back - 1e-9)) - 1
    fastest = np.abs(np.diff(sent[:at], axis=0)).max() / 0.002
    moved = np.abs(sent[-1] - sent[at])
    assert moved.max() < 0.06 * fastest  # to the point at which the arms agree, with the longest lag and the lead


class _Told:
    """A robot that tells its driver's period, states and clock wrongly."""

    commands, lag, delay = "position", 0.0, 0.0

    def __init__(self, robot, *, period=0.002, shown=lambda n, state: state):
        self._robot, self._shown, self._read = robot, shown, 0
        self.joint_names, self.period = robot.joint_names, period
        self.connect, self.stop = robot.connect, robot.stop
        self._back = 0.0

    def read(self):
        state = self._robot.read()
        if state is None:
            return None
        self._read += 1
        shown = self._shown(self._read, state)
        self._back = 0.0 if shown is None else state.stamp - shown.stamp
        return shown

    def send(self, command):
        self._robot.send(Command(command.q, command.velocity, command.at + self._back))


def _with(lift, period=0.002, **told):
    time = ManualTime()
    robots = simulated_robots(lift.cell, lift.q_start, time, (0.0, 0.0, 0.0))
    name = "slave_1"
    if period != 0.002:
        robots[name] = simulated_robots(lift.cell, lift.q_start, time, (0.0,) * 3, period=period)[name]
    robots[name] = _Told(robots[name], **told)
    return time, robots


def _stamps(factor):
    return lambda n, state: replace(state, stamp=factor * state.stamp)


@pytest.mark.parametrize(
    ("robot", "words"),
    [
        ({"period": 0.008}, "every 8 ms, and its driver says 2 ms"),
        ({"period": 0.012}, "every 12 ms, and its driver says 2 ms"),
        ({"shown": _stamps(1e3)}, "stamps its states 2e\\+03 ms apart, and they come every 2 ms"),
        ({"shown": lambda n, state: state if n == 1 else None}, "one state, and then none"),
    ],
)
def test_states_that_are_not_as_told_are_refused_by_name(lift, robot, words):
    real = robot.get("period", 0.002)
    time, robots = _with(lift, real, shown=robot.get("shown", lambda n, state: state))
    with pytest.raises(DriverError, match=f"robot 'slave_1' .*{words}"):
        _run(lift, time, robots)


def _back(by, first=300):
    return lambda n, state: replace(state, stamp=state.stamp - by) if n > first else state


@pytest.mark.parametrize(
    "case",
    slow_but_first([
        (_back(0.05), "its clock was set back by 48 ms"),
        (_back(0.5), "no state of use (a stamp of"),
        (lambda n, state: state if n < 300 or n % 4 == 0 else None, "every 8 ms, and its driver says 2 ms"),
        (lambda n, state: state if n < 300 or n % 60 < 20 else None, "they come late or too seldom"),
    ]),
)  # fmt: skip
def test_states_that_go_wrong_in_motion_end_the_run_with_the_robots_name(lift, case):
    shown, words = case
    report, _, _ = _run(lift, *_with(lift, shown=shown))
    assert not report.finished
    assert "robot 'slave_1'" in report.reason
    assert words in report.reason
    assert "nan" not in report.reason
    assert any("slave_1" in line and "new enough" in line for line in report.lines())


@pytest.mark.parametrize(
    "shown",
    slow_but_first([
        lambda n, state: None if 300 <= n < 320 else state,  # 40 ms of silence
        _back(-0.05),
        lambda n, state: None if n % 50 == 0 else state,
    ]),
)  # fmt: skip
def test_states_that_come_back_are_enough(lift, shown):
    report, _, _ = _run(lift, *_with(lift, shown=shown))
    assert report.finished, report.reason
