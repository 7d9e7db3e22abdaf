"""Whole turns, starts outside the limits, states of another robot: refused, or gone on from; the end is measured."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from robots import simulated_robots

from coopqp import InvalidInputError, QPController
from coopqp.drivers import ControlLoop, DriverError, ManualTime, MemoryRecorder, SimulatedRobot
from coopqp.files.export import JointPositions
from coopqp.scenarios import mixed_cell, paper_lift

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning", "ignore::coopqp.errors.StartWarning")
_LAGS = (0.007, 0.032, 0.047)


@pytest.fixture(scope="module")
def lift():
    return paper_lift(time_law="quintic", duration=0.5)


@pytest.fixture(scope="module")
def cell(lift):
    return lift.cell.with_limits(acceleration=20.0)


class Sent:
    """Keeps what is measured and sent."""

    def __init__(self, *others):
        self.measured, self.sent, self.others = [], [], others

    def take(self, moment, measured, sent, step, clock):
        self.measured.append(measured.copy())
        self.sent.append(sent.copy())
        for other in self.others:
            other.take(moment, measured, sent, step, clock)


def _loop(cell, scenario, change=lambda robots: None, *, lags=_LAGS, recorder=None, move=None, options=None):
    time = ManualTime()
    robots = simulated_robots(cell, scenario.q_start, time, lags)
    if move is not None:
        x = cell.positions(scenario.q_start) + move
        robots = {
            name: SimulatedRobot(robot.joint_names, x[own], time=time, lag=lag)
            for (name, robot), own, lag in zip(robots.items(), cell.v_slices, lags, strict=True)
        }
    change(robots)
    controller = QPController(cell, scenario.grasp, scenario.path, dt=0.002)
    return ControlLoop(controller, robots, options, recorder=recorder, time=time), robots


@pytest.mark.parametrize("seed", range(3))
def test_commands_and_recordings_count_on_from_the_servos_turn_for_turn(seed):
    scenario = mixed_cell(duration=0.8)
    turning = scenario.cell.with_limits(acceleration=20.0)
    endless = np.flatnonzero(turning.continuous)
    turns = np.zeros(turning.nv)
    turns[endless] = np.random.default_rng(seed).integers(-5, 6, len(endless))
    start = turning.positions(scenario.q_start) + math.tau * turns
    memory = MemoryRecorder(None)
    seen = Sent(memory)
    loop, _ = _loop(turning, scenario, lags=(0.01, 0.03, 0.02, 0.0), recorder=seen, move=math.tau * turns)
    memory._controller = loop.controller
    report = loop.run()
    assert report.finished, report.reason
    sent = np.array([start, start, *seen.sent])
    assert np.abs(np.diff(sent, axis=0)).max() <= turning.limits.velocity.max() * 0.002
    assert np.abs(np.array(seen.measured) - seen.sent).max() < 0.3
    recording = memory.recording({})
    measured, commanded = JointPositions(turning, recording)(slice(None))
    np.testing.assert_allclose(commanded, np.array(seen.sent), atol=1e-9)
    assert np.abs(measured - commanded).max() < 0.3


def test_a_joint_that_stands_outside_its_limits_is_refused_by_name(cell, lift):
    x, upper = cell.positions(lift.q_start), cell.limits.upper
    for place, words in ((upper[5] + 0.01, r"0\.57° outside"), (upper[5] - 0.2 + math.tau, "1 whole turn from inside")):
        move = (place - x) * np.eye(cell.nv)[5]
        loop, robots = _loop(cell, lift, move=move)
        (said,) = loop.refused()
        assert "joint master/" in said
        assert "outside its limits" in said
        with pytest.raises(DriverError, match=words):
            loop.run()
        assert all(robot.stopped for robot in robots.values())


@pytest.mark.parametrize("outside", [0.5e-3, 1.9e-3])
def test_a_joint_a_little_outside_its_limits_moves_inwards_only(cell, lift, outside):
    x = cell.positions(lift.q_start)
    j = 3
    lower, upper = cell.limits.lower.copy(), cell.limits.upper.copy()
    upper[j] = x[j] - outside
    narrow = cell.with_limits(upper=upper, lower=lower)
    seen = Sent()
    loop, _ = _loop(narrow, lift, recorder=seen)
    report = loop.run()
    sent = np.array(seen.sent)[:, j]
    assert sent.max() <= x[j] + 1e-9
    assert np.maximum(np.diff(sent), 0.0)[sent[1:] > upper[j]].max(initial=0.0) <= 1e-9
    assert report.finished or report.reason


def test_a_run_has_finished_only_where_the_tools_are_measured_at_the_end(cell, lift):
    def sags(robots):
        for robot in robots.values():
            read = robot.read

            def sagged(read=read):
                state = read()
                return None if state is None else replace(state, q=state.q - 5e-4)

            robot.read = sagged

    for tolerance, finished in ((5e-3, True), (2e-4, False)):
        loop, _ = _loop(cell, lift, sags, options={"end_tolerance_m": tolerance})
        report = loop.run()
        assert report.finished is finished
        assert finished or re.search(r"the tool of arm master stands \d\.\d mm", report.reason)


def test_states_of_another_robot_between_are_refused_or_end_the_run(cell, lift):
    def mixed(away, begin):
        def change(robots):
            read, number = robots["slave_1"].read, [0]

            def both():
                state = read()
                number[0] += 1
                if state is None or number[0] < begin or number[0] % 2:
                    return state
                return replace(state, q=state.q + away, target=None if state.target is None else state.target + away)

            robots["slave_1"].read = both

        return change

    loop, _ = _loop(cell, lift, mixed(0.05, 0))
    with pytest.raises(DriverError, match="'slave_1' does not stand"):
        loop.run()
    loop, _ = _loop(cell, lift, mixed(0.05, 150))
    report = loop.run()
    assert not report.finished
    assert "'slave_1' leap faster than it can move: does another robot" in report.reason


def test_two_drivers_of_one_robot_are_refused(cell, lift):
    def one_topic(robots):
        for name in ("master", "slave_2"):
            robots[name].claims = ("joint 'a' of /joint_states in domain 0",)

    with pytest.raises(InvalidInputError, match=r"'slave_2'.*joint 'a' of /joint_states.*'master' has the same"):
        _loop(cell, lift, one_topic)


def test_states_whose_targets_or_velocities_do_not_fit_are_named(cell, lift):
    for change, words in (({"target": np.zeros(5)}, r"a target of shape \(5,\) for 6"),
                          ({"velocity": np.zeros(7)}, r"velocities of shape \(7,\) for 6")):  # fmt: skip

        def spoilt(robots, change=change):
            read = robots["master"].read
            robots["master"].read = lambda: None if (state := read()) is None else replace(state, **change)

        loop, _ = _loop(cell, lift, spoilt)
        with pytest.raises(DriverError, match=words):
            loop.refused()
