"""Commands between their times: a curve with a continuous second derivative, and what the driver franka answers."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from coopqp.drivers.franka import FrankaOptions, FrankaRobot
from coopqp.drivers.stamped import StampedCommands

_PERIOD = 0.002
#: Published limits of a Panda [rad/s², rad/s³], and where it stands [rad].
_A = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
_J = np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0])
_START = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.7])


def _bends(seed, number, period):
    """Commands whose second differences are anything up to a T², a = 10."""
    rng = np.random.default_rng(seed)
    x, step, found = np.zeros(2), np.zeros(2), [np.zeros(2)] * 8
    for _ in range(number):
        step = step + rng.uniform(-1.0, 1.0, 2) * 10.0 * period**2
        x = x + step
        found.append(x)
    return found


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.002, 0.004, 0.01]), st.floats(0.0, 1.0))
def test_the_curve_keeps_the_acceleration_of_its_commands_at_any_tick(seed, period, phase):
    commands = _bends(seed, 40, period)
    way, sent, heard = StampedCommands(commands[0]), [], 0
    for tick in range(int(44 * period / 1e-3)):
        now = (tick + phase) * 1e-3
        while heard * period <= now and heard < len(commands):
            way.push((heard + 3) * period, commands[heard])  # a lead of three periods
            heard += 1
        sent.append(way.at(now))
    accelerations = np.diff(sent, 2, axis=0) / 1e-6
    assert np.abs(accelerations).max() <= 10.0 * (1.0 + 1e-6)
    assert np.abs(np.diff(accelerations, axis=0)).max() <= 2.0 * 10.0 * 1e-3 / period * (1.0 + 1e-6)


def test_the_curve_passes_even_commands_and_goes_on_evenly_for_two_periods():
    way, line = StampedCommands(np.zeros(1)), StampedCommands(np.zeros(1))
    for i in range(20):
        for each in (way, line):
            each.push(0.01 * i, np.array([0.01 * i]))
    for moment in np.arange(0.15, 0.19, 0.0007):
        assert way.at(moment) == pytest.approx(moment, abs=1e-12)
        assert line.line(moment) == pytest.approx(moment, abs=1e-12)
    assert way.at(0.195) == pytest.approx(0.195)
    assert way.at(0.3) == pytest.approx(0.21)  # then it stands
    assert line.line(0.3) == pytest.approx(0.19)
    way.push(0.1, np.array([9.0]))  # older than the last
    assert way.at(0.3) == pytest.approx(0.21)


def test_one_command_is_led_over_to_from_where_the_robot_stands():
    way = StampedCommands(np.zeros(1))
    assert way.at(1.0) == way.line(1.0) == 0.0
    way.push(1.0, np.array([1e-3]))
    assert way.at(0.97) == pytest.approx(0.0)
    assert way.line(0.995) == pytest.approx(5e-4)
    assert np.abs(np.diff([way.at(t)[0] for t in np.arange(0.97, 1.0, 1e-3)])).max() <= 1.1e-4


class _Library(types.ModuleType):
    """What the driver uses of pylibfranka; the robot follows velocities exactly, under a load, and notes them."""

    RealtimeConfig = types.SimpleNamespace(kEnforce=0, kIgnore=1)
    ControllerMode = types.SimpleNamespace(JointImpedance=0)
    RobotMode = types.SimpleNamespace(Reflex=5, UserStopped=6, Guiding=7)

    def __init__(self, sag):
        super().__init__("pylibfranka")
        self.target, self.time, self.sent, self._sag = _START.copy(), 0.0, [], sag

    def Robot(self, address, kernel):
        return self

    def start_joint_velocity_control(self, mode):
        return self

    def JointVelocities(self, v):
        return np.array(v)

    def readOnce(self):
        time = types.SimpleNamespace(to_sec=lambda now=self.time: now)
        q = self.target - self._sag
        return types.SimpleNamespace(q=q, dq=np.zeros(7), q_d=self.target, time=time, robot_mode=2), None

    def writeOnce(self, command):
        self.sent.append(command)
        self.target = self.target + 1e-3 * command
        self.time += 1e-3


@pytest.mark.parametrize("share", [0.01, 0.3, 0.95])
@pytest.mark.parametrize("period", [0.002, 0.004, 0.01])
def test_franka_answers_within_its_limits_where_its_commands_are_smooth(monkeypatch, share, period):
    """A quintic of one joint with a share of its acceleration limit; the arm hangs 1 mrad below its target."""
    library = _Library(sag=1e-3)
    monkeypatch.setitem(sys.modules, "pylibfranka", library)
    robot = FrankaRobot(FrankaOptions(address="x"))
    robot.connect()
    duration = np.sqrt(5.7735 * 0.3 / (share * _A[1]))

    def wanted(t):
        u = np.clip((t - 0.1) / duration, 0.0, 1.0)
        return _START + np.eye(7)[1] * 0.3 * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)

    way, heard = StampedCommands(_START), 0
    while library.time < duration + 0.3:  # as the process of a robot does
        state = robot.read()
        while heard * period <= state.stamp:
            way.push((heard + 3) * period, wanted((heard + 3) * period))
            heard += 1
        robot.send(way.at(state.stamp))
    accelerations = np.diff(library.sent, axis=0) / 1e-3
    assert (np.abs(accelerations) / _A).max() <= 1.0
    assert (np.abs(np.diff(accelerations, axis=0)) / 1e-3 / _J).max() <= 1.0
    np.testing.assert_allclose(library.target, wanted(np.inf), atol=1e-9)
