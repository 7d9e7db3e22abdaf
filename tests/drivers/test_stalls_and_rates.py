"""A loop that stands for a while goes on from rest; robots whose states, clocks or servos are not as told are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_but_first
from robots import simulated_robots

from coopqp import QPController, QPOptions, SupervisionOptions
from coopqp.drivers import Command, ControlLoop, DriverError, ManualTime
from coopqp.scenarios import paper_lift

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning", "ignore::coopqp.errors.StartWarning")
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
    """What was sent; it ends a run whose arms stand behind a robot that stopped, or that goes on for too long."""

    def __init__(self):
        self.times, self.sent, self.loop = [], [], None

    def take(self, moment, measured, sent, step, clock):
        self.times.append(moment)
        self.sent.append(sent.copy())
        if self.loop.stands or len(self.times) > 10_000:
            self.loop.stop("the test ends it")


def _run(lift, time, drivers, **options):
    recorder = _Sent()
    supervision = SupervisionOptions(stiffness=1e4)
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.002, options=QPOptions(supervision=supervision))
    loop = ControlLoop(controller, drivers, options, recorder=recorder, time=time)
    recorder.loop = loop
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


def _hanging(sag, halts=np.inf):
    """Without a target; joints that hang off their commands by sag(q), and that stay where they are from a state on."""
    stays = []

    def shown(n, state):
        q = state.q - sag(state.q)
        if n >= halts:
            stays.append(q)
            return replace(state, q=stays[0], velocity=np.zeros(len(q)), target=None)
        return replace(state, q=q, target=None)

    return shown


def _at(joint, far):
    return lambda q: far * np.eye(len(q))[joint]


@pytest.mark.parametrize(
    "sag",
    slow_but_first([
        _at(2, 4e-4),
        _at(2, -4e-4),
        _at(0, 3e-4),
        _at(4, -1e-3),
        lambda q: 4e-4 * np.cos(q) * np.eye(len(q))[1],
        lambda q: 1e-4 * np.sin(3.0 * q),
    ]),
)  # fmt: skip
def test_a_servo_that_hangs_off_its_commands_has_not_stopped(lift, sag):
    report, _, _ = _run(lift, *_with(lift, shown=_hanging(sag)))
    assert report.finished, report.reason
    assert report.stops == 0


@pytest.mark.parametrize("sag", slow_but_first([_at(2, 4e-4), _at(4, -1e-3), _at(2, 0.0)]))
def test_a_robot_that_stops_is_named_however_it_hangs(lift, sag):
    report, _, _ = _run(lift, *_with(lift, shown=_hanging(sag, halts=400)))
    assert report.reason == "the test ends it"
    assert report.stops == 1
    assert "robot 'slave_1' did not follow its commands" in " ".join(report.lines())


def test_a_servo_that_hangs_too_far_ends_the_run_with_the_joints_name(lift):
    report, _, sent = _run(lift, *_with(lift, shown=_hanging(_at(2, 8e-3))))
    assert not report.finished
    assert f"joint {lift.cell.joint_names[8]} hangs" in report.reason
    assert "its servo" in report.reason
    assert np.abs(sent - sent[0]).max() < 1e-4


def test_a_joint_that_hangs_at_the_end_of_the_path_is_named(lift):
    report, _, _ = _run(lift, *_with(lift, shown=_hanging(_at(2, 6e-4))), end_tolerance_m=1e-4)
    assert not report.finished
    assert "the tool of arm slave_1 stands" in report.reason
    assert f"joint {lift.cell.joint_names[8]} hangs 0.6 mrad" in report.reason


@pytest.mark.parametrize("tells", slow_but_first([False, True]))
@pytest.mark.parametrize("lag", slow_but_first([0.0, 0.02]))
def test_a_robot_whose_states_come_late_is_named(lift, lag, tells):
    time = ManualTime()
    robots = simulated_robots(lift.cell, lift.q_start, time, (lag,) * 3, tells_target=tells)
    robots["slave_1"].latency = 0.1
    report, times, _ = _run(lift, time, robots)
    assert not report.finished
    assert "robot 'slave_1'" in report.reason
    assert "its states come late" in report.reason
    assert times[-1] < 3.0
