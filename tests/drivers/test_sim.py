"""The driver sim: a robot in another process. The tests wait on states, not on clocks."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from promise_cases.strangers import doors
from robots import joints_of

from coopqp import InvalidInputError, QPController
from coopqp.drivers import Command, Condition, ControlLoop, DriverError, RobotState
from coopqp.drivers.packets import pack_command, pack_state, unpack_command, unpack_state
from coopqp.drivers.sim import SimDriver, SimOptions
from coopqp.planning import check_path
from coopqp.scenarios import dual_arm7, torso_lift

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]


@pytest.fixture
def robot():
    driver = SimDriver(["a", "b"], [0.1, -0.2], SimOptions(clock_offset=1000.0, lag=0.0))
    driver.connect()
    yield driver
    driver.close()


def _until(driver, holds):
    """The first state that is as it should be; the suite's own limit ends a wait in vain."""
    while True:
        state = driver.read()
        if state is not None and holds(state):
            return state


def test_packets_come_back_as_they_were():
    q, v, t = np.arange(3.0), np.arange(3.0) + 0.5, np.arange(3.0) - 7.0
    w = np.arange(6.0) - 2.5
    for target in (t, None):
        for wrench in (w, None):
            given = RobotState(q, v, 12.5, target=target, wrench=wrench, scaling=0.25, condition=Condition.PROTECTIVE)
            packet = pack_state(given)
            state = unpack_state(packet, 3)
            for name in ("q", "velocity", "stamp", "target", "wrench", "scaling", "condition"):
                np.testing.assert_array_equal(getattr(given, name), getattr(state, name))
            assert unpack_state(packet, 4) is None
    for junk in (b"", b"S", b"S" * 34, b"X" * 82, b"S" * 67):
        assert unpack_state(junk, 3) is None
    at, back = unpack_command(pack_command(3.25, q))
    assert at == 3.25
    np.testing.assert_array_equal(back, q)


def test_a_command_before_the_first_reading_arrives(robot):
    robot.send(Command(np.array([0.11, -0.19]), np.zeros(2), 1000.0))
    _until(robot, lambda s: np.abs(s.q - [0.11, -0.19]).max() < 1e-9)


def test_a_robot_goes_where_it_is_sent_stops_and_says_so(robot):
    state = _until(robot, lambda s: True)
    assert state.stamp > 999.0
    np.testing.assert_allclose(state.q, [0.1, -0.2], atol=1e-12)
    robot.send(Command(np.array([0.11, -0.19]), np.zeros(2), state.stamp + 0.02))
    _until(robot, lambda s: np.abs(s.q - [0.11, -0.19]).max() < 1e-9)
    robot.halt(says=Condition.PROTECTIVE)
    state = _until(robot, lambda s: s.condition is Condition.PROTECTIVE)
    robot.send(Command(np.array([0.5, 0.5]), np.zeros(2), state.stamp + 0.02))
    state = _until(robot, lambda s, after=state.stamp + 0.1: s.stamp > after)
    np.testing.assert_allclose(state.q, [0.11, -0.19], atol=1e-9)
    robot.release()
    _until(robot, lambda s: s.condition is Condition.RUNNING and np.abs(s.q - 0.5).max() < 1e-9)
    robot.stop()
    robot.stop()
    _until(robot, lambda s: s.condition is Condition.STOPPED)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_no_other_process_can_reach_a_robot_or_its_driver():
    before = doors(os.getpid())
    robot = SimDriver(["a"], [0.1])
    robot.connect()
    try:
        (child,) = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()[-1:]
        assert "sim_process" in Path(f"/proc/{child}/cmdline").read_text()
        assert doors(child) == set()
        assert doors(os.getpid()) == before
    finally:
        robot.close()


def test_bad_settings_are_refused():
    for bad in ({"loss": 1.0}, {"lag": -1.0}, {"period": 0.0}, {"seed": -5}, {"seed": 0.5}):
        with pytest.raises(InvalidInputError):
            SimOptions(**bad)


@pytest.fixture(scope="module")
def bar():
    scenario = dual_arm7(duration=1.0)
    return scenario, scenario.cell.with_limits(acceleration=15.0)


def _driven(bar, options=None, recorder=None, gone_after=0.1):
    scenario, cell = bar
    x = cell.positions(scenario.q_start)
    drivers = {
        name: SimDriver(joints_of(cell, k), x[cell.v_slices[k]], {"seed": k, **(options or {})})
        for k, name in enumerate(cell.arm_names)
    }
    controller = QPController(cell, scenario.grasp, scenario.path, dt=0.004)
    return ControlLoop(controller, drivers, {"gone_after": gone_after}, recorder=recorder), drivers


def _closed(drivers):
    for driver in drivers.values():
        driver.close()


def test_two_robots_behind_a_bad_link_finish(bar):
    loop, drivers = _driven(bar, {"latency": 5e-4, "jitter": 5e-4, "loss": 0.01, "clock_offset": 77.0}, gone_after=2.0)
    try:
        report = loop.run()
    finally:
        _closed(drivers)
    assert report.finished, report.reason
    assert report.acceleration <= 1.0 + 1e-9
    assert report.apart < 0.02  # on a machine that may stall


class _Killer:
    """Kills a robot in the middle of a run."""

    def __init__(self):
        self.drivers, self.number = {}, 0

    def take(self, moment, measured, sent, step, clock):
        self.number += 1
        if self.number == 100:
            self.drivers["right"].kill()


def test_a_robot_that_is_killed_ends_the_run(bar):
    killer = _Killer()
    loop, drivers = _driven(bar, recorder=killer)
    killer.drivers = {"right": list(drivers.values())[1]}
    name = list(drivers)[1]
    try:
        report = loop.run()
    finally:
        _closed(drivers)
    assert not report.finished
    assert f"robot '{name}' told no state" in report.reason
    assert report.statuses["holding"] > 0


# -- a robot whose arms share a lift -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tower():
    scenario = torso_lift(duration=3.0)
    check = check_path(scenario.cell, scenario.grasp, scenario.path, q_start=scenario.q_start)
    return replace(scenario, path=check.led_path())


def _of_tower(scenario, recorder, *, gone_after, **link):
    """The loop, and the robot, which has its description's names of joints."""
    names = [name.partition("/")[2] for name in scenario.cell.joint_names]
    robot = SimDriver(names, scenario.cell.positions(scenario.q_start), {"tells_lag": False, "seed": 5, **link})
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt)
    return ControlLoop(controller, {"lift": robot}, {"gone_after": gone_after}, recorder=recorder), robot


class _Trouble:
    """The robot is slower than told for a while, stops to be safe, and is let go once all stand."""

    def __init__(self):
        self.number, self.stood, self.lifts = 0, 0, []

    def take(self, moment, measured, sent, step, clock):
        self.number += 1
        self.lifts.append(measured[0])
        if self.number == 100:
            self.robot.limit(1.0)
        elif self.number == 150:
            self.robot.limit(None)
        elif self.number == 250:
            self.robot.halt(says=Condition.PROTECTIVE)
        if self.loop.stands:
            self.stood += 1
            self.robot.release()
            self.loop.resume()


def test_a_robot_with_a_lift_is_slow_stops_and_goes_on(tower):
    trouble = _Trouble()
    loop, robot = _of_tower(tower, trouble, gone_after=2.0, latency=5e-4, jitter=5e-4, loss=0.01, clock_offset=77.0)
    trouble.loop, trouble.robot = loop, robot
    try:
        report = loop.run()
    finally:
        robot.close()
    assert report.finished, report.reason
    assert report.stops == 1
    assert trouble.stood >= 1
    assert report.acceleration <= 1.0 + 1e-9
    assert np.nanmax(trouble.lifts) == pytest.approx(0.5, abs=1e-3)
    assert report.apart < 0.02  # on a machine that may stall


def test_a_robot_with_a_lift_that_is_killed_ends_the_run(tower):
    killer = _Killer()
    loop, robot = _of_tower(tower, killer, gone_after=0.1)
    killer.drivers = {"right": robot}
    try:
        report = loop.run()
    finally:
        robot.close()
    assert not report.finished
    assert "robot 'lift' told no state" in report.reason
    assert report.statuses["holding"] > 0


def test_a_robot_that_does_not_start_is_said(monkeypatch):
    import coopqp.drivers.sim as sim

    monkeypatch.setattr(sim, "_START", 0.0)
    with pytest.raises(DriverError, match="does not start"):
        SimDriver(["a"], [0.0]).connect()
