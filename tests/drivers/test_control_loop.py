"""The control loop follows the slowest arm, stops with it and goes on by hand: simulated robots, in their own time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_but_first
from robots import drive, joints_of, simulated_robots

from coopqp import InvalidInputError, QPController, SupervisionOptions
from coopqp.control import StallBound
from coopqp.drivers import (
    Condition,
    ControlLoop,
    DriverError,
    LoopOptions,
    ManualTime,
    RobotState,
    SimulatedRobot,
)
from coopqp.drivers.follow_slowest import FollowSlowest
from coopqp.drivers.motion import RESOLUTION
from coopqp.drivers.timing import ClockOffset
from coopqp.errors import StiffnessWarning
from coopqp.scenarios import dual_arm7, mixed_cell, paper_lift

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")
_LAGS = (0.007, 0.032, 0.047)
_KEPT = 1.0 + 1e-9


@pytest.fixture(scope="module")
def lift():
    return paper_lift(time_law="quintic", duration=1.5)


@pytest.fixture(scope="module")
def cell(lift):
    return lift.cell.with_limits(acceleration=10.0)


def _kept(run):
    """What the loop counted, and what its robots were sent, keep the limits."""
    assert run.report.velocity <= _KEPT
    assert run.report.acceleration <= _KEPT


def test_lags_that_are_told_cost_neither_time_nor_distance(cell, lift):
    run = drive(cell, lift, _LAGS)
    assert run.report.finished, run.report.reason
    assert run.report.time <= 1.6
    assert run.apart.max() <= 3e-4
    _kept(run)


def test_lags_that_nobody_tells_are_learnt(cell, lift):
    run = drive(cell, lift, _LAGS, told_lag=None)
    assert run.report.finished, run.report.reason
    np.testing.assert_allclose(list(run.report.lags.values()), _LAGS, atol=2e-3)
    assert run.report.time <= 1.7
    assert run.apart.max() <= 1e-3
    _kept(run)


def test_the_fast_arms_wait_for_delays(cell, lift):
    time, delays = ManualTime(), (0.0, 0.010, 0.0043)
    robots = simulated_robots(cell, lift.q_start, time, (0.0,) * 3)
    for robot, delay in zip(robots.values(), delays, strict=True):
        robot.delay = robot.servo.delay = delay
    controller = QPController(cell, lift.grasp, lift.path, dt=0.002)
    report = ControlLoop(controller, robots, time=time).run()
    assert report.finished
    assert report.apart <= 2e-4


def test_a_loop_on_the_robots_own_clocks_with_latency(cell, lift):
    run = drive(cell, lift, _LAGS, clock_offset=1234.5, latency=0.003)
    assert run.report.finished
    assert run.apart.max() <= 1e-4


def test_a_servo_that_is_never_exact_does_not_stop_the_run_where_its_way_ends(cell, lift):
    """A fifth of a milliradian is little distance, and near the end, where the way is slow, much time."""
    own = cell.v_slices[1]
    begins = cell.positions(lift.q_start)

    def hang_behind(robots, loop):
        robot = robots["slave_1"]
        read = robot.read

        def behind():
            state = read()
            if state is None:
                return None
            off = -2e-4 * np.sign(loop.controller.cell.positions(loop.controller.commanded)[own] - begins[own])
            return replace(state, q=state.q + off, target=state.target + off)

        robot.read = behind

    run = drive(cell, lift, (0.0,) * 3, events=[(0.3, hang_behind)])
    assert run.report.finished, run.report.reason
    assert run.report.stops == 0
    assert run.report.time <= 2.0


def _turned_back(law, offset, seconds):
    """Where the clock comes to rest after the first of two arms froze at 1 s of the way [s].

    The second arm's way is slow. It is ``offset`` off its place: what it travels in this time at its largest speed [s].
    """
    h, clock, speeds = 0.002, 1.05, np.array([0.3, 0.01])
    away = speeds / (speeds**2 + 5e-3**2)  # lateness per distance, as the motion measures it
    for _ in range(round(seconds / h)):
        frozen = speeds[0] * (clock - 1.0)
        lateness = away * np.array([frozen, offset])
        own, fell = np.array([0.0, law.rate]), away * np.array([frozen, 0.0])
        rate = law.step(lateness, RESOLUTION * away, own, fell, np.zeros(2, dtype=bool))
        clock += h * rate
    return clock


@pytest.mark.parametrize("offset", [0.0, 0.5 * RESOLUTION, RESOLUTION])
def test_the_way_back_ends_at_the_arm_that_stopped_and_not_behind_an_inexact_one(offset):
    law = FollowSlowest(2, period=0.002)
    assert _turned_back(law, offset, 5.0) == pytest.approx(1.0, abs=2e-3)
    assert law.stopped
    assert law.slowest == 0


def test_a_lateness_that_is_not_known_leaves_the_way_back_to_the_others():
    law, nobody = FollowSlowest(2, period=0.002), np.zeros(2, dtype=bool)
    for _ in range(100):
        law.step(np.array([0.1, 0.0]), np.zeros(2), np.zeros(2), np.array([0.1, 0.0]), nobody)
    assert law.stopped
    law.step(np.array([np.nan, 0.05]), np.zeros(2), np.zeros(2), np.array([0.1, 0.05]), nobody)
    assert law.slowest == 1
    assert law.rate < 0.0


def test_a_robot_that_stops_just_before_the_end_is_missed(cell, lift):
    run = drive(cell, lift, (0.0,) * 3, events=[(1.35, lambda robots, loop: robots["slave_1"].servo.halt())])
    assert not run.report.finished
    assert run.report.stops == 1


def _slow(k, speed):
    return lambda robots, loop: list(robots.values())[k].servo.limit(speed)


def test_an_arm_at_half_its_speed_slows_the_others(cell, lift):
    free = drive(cell, lift, _LAGS)
    own = free.q[:, cell.v_slices[1]]
    fastest = np.linalg.norm(np.diff(own, axis=0), axis=1).max() / 0.002
    run = drive(cell, lift, _LAGS, events=[(0.4, _slow(1, 0.5 * fastest)), (1.2, _slow(1, None))])
    assert run.report.finished, run.report.reason
    assert run.report.time > free.report.time + 0.2
    assert run.apart.max() <= 2e-3
    assert max(run.report.lost_time, key=run.report.lost_time.get) == "slave_1"
    _kept(run)


def _halt(k, says=Condition.RUNNING):
    return lambda robots, loop: list(robots.values())[k].servo.halt(says=says)


def _release(k):
    return lambda robots, loop: list(robots.values())[k].servo.release()


def _resume(robots, loop):
    loop.resume()


@pytest.mark.slow
@pytest.mark.parametrize("says", [Condition.RUNNING, Condition.PROTECTIVE])
def test_the_others_go_back_to_an_arm_that_stops_and_on_by_hand(cell, lift, says):
    named = []
    look = (2.1, lambda robots, loop: named.append(loop.stopped_robot))
    run = drive(cell, lift, (0.0,) * 3, events=[(0.7, _halt(1, says)), look, (2.2, _release(1)), (2.4, _resume)])
    assert run.report.finished, run.report.reason
    assert run.report.stops == 1
    assert named == ["slave_1"]
    assert run.report.slowest_rate < 0.0
    times = run.time[::5]
    assert run.apart[(times > 1.3) & (times < 2.2)].max() <= 5e-4
    assert run.apart[times > 2.2].max() <= 1e-3
    stands = run.q[(run.time > 2.0) & (run.time < 2.2)]
    assert np.ptp(stands, axis=0).max() < 1e-5
    assert run.time[-1] > 2.4 + 0.5
    _kept(run)


def test_a_robot_that_is_silent_ends_the_run_near_the_others(cell, lift):
    run = drive(
        cell, lift, (0.0,) * 3, constraints=[StallBound(0.005, dt=0.002)],
        events=[(0.7, lambda robots, loop: robots["slave_1"].kill())],
    )  # fmt: skip
    assert not run.report.finished
    assert "slave_1" in run.report.reason
    assert "not known" in run.report.reason
    held = run.statuses.index("holding")
    assert run.time[held] - 0.7 <= 0.015
    assert run.apart.max() <= 0.005
    speed = np.abs(np.diff(run.sent, axis=0)).max(axis=1) / 0.002
    assert speed[-1] < 1e-6
    _kept(run)


def test_states_that_are_of_no_use_are_told_from_none(cell, lift):
    def broken(robots, loop):
        robot = robots["slave_1"]
        read = robot.read
        robot.read = lambda: None if (state := read()) is None else replace(state, q=state.q[:3])

    run = drive(cell, lift, (0.0,) * 3, events=[(0.7, broken)])
    assert "slave_1" in run.report.reason
    assert "no state of use (positions of shape (3,) for 6 joints)" in run.report.reason


@pytest.mark.slow
def test_operators_calls_are_made_between_periods(cell, lift):
    seen = []

    def pause(robots, loop):
        loop.pause()
        seen.append(loop.controller.paused)

    run = drive(cell, lift, _LAGS, events=[(0.5, pause), (1.2, _resume)])
    assert seen == [False]
    assert run.report.finished
    assert run.report.time > 1.5 + 0.4
    assert run.report.statuses["paused"] > 100
    _kept(run)


def _jogged(lags, seed, addition):
    """Largest distance of two arms that an operator jogs to and fro with all accelerations that they have [m]."""
    scenario = dual_arm7()
    cell = scenario.cell.with_limits(velocity=1.05, acceleration=10.5)
    rng = np.random.default_rng(seed)
    twists = np.array([0.25, 0.2, 0.15, 0.3, 0.3, 0.3]) * rng.choice([-1.0, 1.0], (4, 6))
    jogs = [(0.3 + 0.08 * i, lambda robots, loop, i=i: loop.jog(twists[i // 6], deadman_s=0.2)) for i in range(24)]
    stop = (2.3, lambda robots, loop: loop.stop())
    run = drive(cell, replace(scenario, cell=cell), lags, events=[*jogs, stop], options={"addition": addition})
    _kept(run)
    return run.apart.max()


@pytest.mark.parametrize("lags", slow_but_first([(0.03, 0.03), (0.01, 0.01), (0.007, 0.03), (0.004, 0.1)]))
def test_the_addition_does_not_part_arms_that_are_jogged(lags):
    without = _jogged(lags, 0, 0.0)
    assert 1e-5 < without < 5e-3
    assert _jogged(lags, 0, 0.05) <= 1.1 * without


def test_stop_brakes_all_arms_together(cell, lift):
    run = drive(cell, lift, (0.0,) * 3, events=[(0.7, lambda robots, loop: loop.stop())])
    assert not run.report.finished
    assert "operator" in run.report.reason
    assert run.apart.max() <= 1e-3
    assert np.abs(run.sent[-1] - run.sent[-2]).max() < 1e-8
    _kept(run)


def test_without_a_heartbeat_the_arms_brake(cell, lift):
    run = drive(cell, lift, (0.0,) * 3, options=LoopOptions(heartbeat=0.1))
    assert "heartbeat" in run.report.reason
    assert run.time[-1] < 0.5
    with pytest.raises(InvalidInputError, match="heartbeat"):
        LoopOptions(heartbeat=0.5)


def test_a_first_state_that_is_fresh_is_no_deviation(cell, lift):
    """The robots' states come between the start and the first period."""
    run = drive(cell, lift, (0.0,) * 3, period=0.0007)
    assert run.report.finished
    assert set(run.report.statuses) == {"tracking"}


class _Stubborn:
    """A driver whose send fails after a while."""

    def __init__(self, robot, at):
        self._robot, self._left = robot, at
        self.joint_names, self.period, self.lag, self.delay, self.commands = (
            robot.joint_names, robot.period, robot.lag, robot.delay, robot.commands,
        )  # fmt: skip
        self.connect, self.read = robot.connect, robot.read
        self.stops = 0

    def send(self, command):
        self._left -= 1
        if self._left < 0:
            raise OSError("cable out")
        self._robot.send(command)

    def stop(self):
        self.stops += 1
        self._robot.stop()


def test_where_one_robot_cannot_be_sent_to_all_brake_together(cell, lift):
    """Not each for itself: the others get their commands to the end."""
    time = ManualTime()
    arms = simulated_robots(cell, lift.q_start, time, (0.0,) * 3)
    robots = {name: _Stubborn(arm, 300 if k == 1 else 10**6) for k, (name, arm) in enumerate(arms.items())}
    report = ControlLoop(QPController(cell, lift.grasp, lift.path, dt=0.002), robots, time=time).run()
    name = list(robots)[1]
    assert not report.finished
    assert report.reason == f"robot '{name}' was not sent its command: driver '{name}' raised OSError: cable out"
    assert report.acceleration <= 1.0 + 1e-9
    assert next(iter(robots.values()))._left == 10**6 - report.commands
    assert [robot.stops for robot in robots.values()] == [1, 1, 1]


# -- what is refused ---------------------------------------------------------------------------------------------------


def _loop(cell, scenario, change=None, options=None, **robots):
    time = ManualTime()
    arms = simulated_robots(cell, scenario.q_start, time, (0.0,) * len(cell), **robots)
    if change is not None:
        arms = change(arms, time) or arms
    controller = QPController(cell, scenario.grasp, scenario.path, dt=0.002, options=options)
    return ControlLoop(controller, arms, time=time), arms


def test_cells_without_acceleration_limits_are_refused(lift):
    loop, robots = _loop(lift.cell, lift)
    with pytest.raises(DriverError, match="without acceleration limits"):
        loop.run()
    assert all(robot.stopped for robot in robots.values())


def test_blind_position_servos_are_refused_unless_their_stiffness_is_told(cell, lift):
    loop, _ = _loop(cell, lift, tells_target=False)
    assert any("stiffness" in line for line in loop.refused())
    told, _ = _loop(cell, lift, tells_target=False, options={"supervision": SupervisionOptions(stiffness=1e5)})
    assert told.refused() == []
    late, _ = _loop(cell, lift, options={"supervision": SupervisionOptions(stiffness=1e5, servo_delay=0.006)})
    assert any("servo_delay" in line for line in late.refused())


def test_a_first_command_far_from_the_servos_is_refused(cell, lift):
    """The first command is where the arms are measured if one tells no target; another's servo is elsewhere."""

    def sag(robots, time):
        read = robots["master"].read

        def sagged():
            state = read()
            return None if state is None else replace(state, target=state.q + 0.006)

        robots["master"].read = sagged
        robots["slave_1"]._tells = False

    options = {"supervision": SupervisionOptions(stiffness=1e5)}
    loop, _ = _loop(cell, lift, sag, options)
    with pytest.raises(DriverError, match=r"master/.* is 6\.0 mrad"):
        loop.run()


def test_other_joints_are_refused_and_names_decide_their_order(cell, lift):
    joints = joints_of(cell, 0)

    def turned(robots, time):
        x = cell.positions(lift.q_start)[cell.v_slices[0]]
        robots["master"] = SimulatedRobot(joints[::-1], x[::-1], time=time)

    loop, _ = _loop(cell, lift, turned)
    assert loop.run().finished
    for change, words in (
        (lambda r, t: {"master": r["master"]}, "no driver has"),
        (lambda r, t: {**r, "other": r["master"]}, "no joint 'other/"),
        (lambda r, t: {**r, "master": SimulatedRobot([*joints, "extra"], [0.0] * 7, time=t)}, "extra"),
        (lambda r, t: {**r, "master": SimulatedRobot(joints[:5], [0.0] * 5, time=t)}, "no driver has"),
        (lambda r, t: {**r, "slave_1": 3}, "without"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            _loop(cell, lift, change)


def test_limits_wider_than_the_robots_are_refused(cell, lift):
    def narrow(robots, time):
        robots["slave_2"].limits = cell.arms[2].limits.replace(acceleration=5.0)

    loop, _ = _loop(cell, lift, narrow)
    assert any("acceleration limit 10 is wider" in line for line in loop.refused())


def test_robots_that_say_nothing_or_stand_are_refused(cell, lift):
    def silent(robots, time):
        robots["slave_1"].silent = True

    loop, _ = _loop(cell, lift, silent)
    with pytest.raises(DriverError, match="'slave_1' tells no state"):
        loop.run()

    def stands(robots, time):
        robots["slave_1"].servo.halt(says=Condition.PROTECTIVE)

    loop, _ = _loop(cell, lift, stands)
    assert any("protective stop" in line for line in loop.refused())


def test_continuous_joints_go_round():
    scenario = mixed_cell(duration=1.5)
    turning = scenario.cell.with_limits(acceleration=20.0)
    assert turning.continuous.any()
    run = drive(turning, scenario, (0.01, 0.03, 0.02, 0.0))
    assert run.report.finished, run.report.reason
    assert run.apart.max() <= 3e-4


# -- states ------------------------------------------------------------------------------------------------------------


def test_bad_states_are_no_states(cell, lift):
    """Another number of joints, NaN, a stopped clock and stamps that come twice are left out; the run goes on."""
    spoilt = {"number": 0}

    def spoil(robots, time):
        read = robots["slave_2"].read

        def worse():
            state = read()
            spoilt["number"] += 1
            if state is None or spoilt["number"] % 7 or spoilt["number"] < 100:
                return state
            kind = spoilt["number"] // 7 % 3
            if kind == 0:
                return RobotState(np.full(6, np.nan), state.velocity, state.stamp, target=state.target)
            if kind == 1:
                return RobotState(state.q[:5], state.velocity, state.stamp)
            return RobotState(state.q, state.velocity, state.stamp - 0.5, target=state.target)

        robots["slave_2"].read = worse

    loop, _ = _loop(cell, lift, spoil)
    report = loop.run()
    assert report.finished, report.reason
    assert loop.watches[2].refused > 50
    assert report.acceleration <= _KEPT


def test_the_offset_of_a_clock_is_the_least_that_was_seen():
    clock, late = ClockOffset(window=10), [0.005, 0.003, 0.004, 0.002, *[0.006] * 9]
    found = [clock.take(10.0 + i, 3.0 + i + x) for i, x in enumerate(late)]
    expected = [min(late[max(0, i - 9) : i + 1]) - 7.0 for i in range(len(late))]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_stall_before_a_reading_makes_no_state_old(cell, lift):
    """A driver that is held up for 60 ms once: its next states are not taken for old ones."""

    def stall(robots, time):
        robot, number = robots["slave_2"], [0]
        read = robot.read

        def late():
            number[0] += 1
            if number[0] == 100:
                time.sleep_until(time.now() + 0.06)
            return read()

        robot.read = late

    loop, _ = _loop(cell, lift, stall)
    report = loop.run()
    assert report.finished, report.reason
    assert report.missing["slave_2"] <= 2
    assert report.missed >= 25


def test_starts_warn_as_those_of_the_controller_do(cell, lift):
    loop, _ = _loop(cell, lift)
    with pytest.warns(StiffnessWarning):
        loop.run()
