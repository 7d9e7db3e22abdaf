"""A robot whose arms share joints is driven as one: in simulated time, judged by the robot's own description."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from robots import drive, simulated_robots

from coopqp import (
    Arm,
    Grasp,
    InvalidInputError,
    LinePath,
    QPController,
    QPOptions,
    Robot,
    RobotCell,
    SupervisionOptions,
)
from coopqp.control import StallBound
from coopqp.drivers import Condition, ControlLoop, DriverError, ManualTime, SimulatedRobot
from coopqp.drivers.robots import driven_joints, driver_names, robots_of
from coopqp.drivers.start import begin
from coopqp.paths.scenario import Scenario
from coopqp.planning import check_path
from coopqp.scenarios import SCENARIOS, robot_path

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")
_KEPT = 1.0 + 1e-9
_DT = 0.004


@cache
def _led(name, duration):
    """A scenario of one robot, along the motion of its shared joint that is proved."""
    s = SCENARIOS[name](duration=duration)
    check = check_path(s.cell, s.grasp, s.path, q_start=s.q_start)
    assert check.verdict.value == "CERTIFIED"
    return replace(s, path=check.led_path())


class _Seen:
    """The robot as its URDF has it, by Pinocchio alone: where the left tool sees the right one."""

    def __init__(self, urdf, scenario):
        self.model = pin.buildModelFromUrdf(str(robot_path(urdf)))
        self.data = self.model.createData()
        left, right = scenario.grasp.T_object_tool[:2]
        self.T_left_right = left.inverse() * right
        # The cell's names are ``owner/joint``; the description has the joint's alone.
        names = scenario.cell.joint_names[: self.model.njoints - 1]
        index = [self.model.getJointId(name.partition("/")[2]) for name in names]
        assert sorted(index) == list(range(1, self.model.njoints))
        self.joints = [self.model.joints[i] for i in index]

    def apart(self, rows):
        """Largest distance between the tools from what the object makes of them, at rows of positions (T, nv) [m]."""
        found = []
        for x in rows:
            q = pin.neutral(self.model)
            for joint, value in zip(self.joints, x, strict=True):
                turns = joint.nq == 2  # a continuous joint
                q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if turns else value
            pin.framesForwardKinematics(self.model, self.data, q)
            left, right = (self.data.oMf[self.model.getFrameId(f"{side}_tool")] for side in ("left", "right"))
            found.append(np.linalg.norm(((left * self.T_left_right).inverse() * right).translation))
        return np.array(found)


def _kept(run):
    assert run.report.velocity <= _KEPT
    assert run.report.acceleration <= _KEPT


@pytest.mark.parametrize(("name", "urdf", "duration"), [("torso_lift", "lift2", 8.0), ("two_on_a_rail", "rail2", 6.0)])
def test_one_robot_carries_the_bar_as_long_as_planned(name, urdf, duration):
    s = _led(name, duration)
    run = drive(s.cell, s, (0.02,), dt=_DT)
    assert run.report.finished, run.report.reason
    assert list(run.report.lags) == [s.cell.arms[0].robot]
    assert run.report.time <= duration + 0.3
    assert np.ptp(run.q[:, s.cell.shared]) > 0.15
    assert _Seen(urdf, s).apart(run.q[::10]).max() <= 3e-4
    _kept(run)


def test_a_lag_that_nobody_tells_is_learnt():
    s = _led("torso_lift", 4.0)
    run = drive(s.cell, s, (0.04,), dt=_DT, told_lag=None)
    assert run.report.finished, run.report.reason
    assert run.report.lags["lift"] == pytest.approx(0.04, abs=2e-3)
    assert _Seen("lift2", s).apart(run.q[::10]).max() <= 1e-3
    _kept(run)


def _servo(name, call, *given, **more):
    return lambda robots, loop: getattr(robots[name].servo, call)(*given, **more)


def _resume(robots, loop):
    loop.resume()


@pytest.mark.slow
def test_a_robot_slower_than_told_slows_the_object():
    s = _led("torso_lift", 4.0)
    free = drive(s.cell, s, (0.0,), dt=_DT)
    fastest = np.linalg.norm(np.diff(free.q, axis=0), axis=1).max() / _DT
    events = [(1.0, _servo("lift", "limit", 0.5 * fastest)), (3.0, _servo("lift", "limit", None))]
    run = drive(s.cell, s, (0.0,), dt=_DT, events=events)
    assert run.report.finished, run.report.reason
    assert run.report.time > free.report.time + 0.2
    assert run.report.lost_time["lift"] > 0.2
    assert _Seen("lift2", s).apart(run.q[::10]).max() <= 2e-3
    _kept(run)


@pytest.mark.slow
@pytest.mark.parametrize("says", [Condition.RUNNING, Condition.PROTECTIVE])
@pytest.mark.parametrize(("name", "urdf"), [("torso_lift", "lift2"), ("two_on_a_rail", "rail2")])
def test_after_a_stop_the_robot_goes_on_by_hand(name, urdf, says):
    s = _led(name, 4.0)
    robot = s.cell.arms[0].robot
    events = [(1.5, _servo(robot, "halt", says=says)), (3.0, _servo(robot, "release")), (3.2, _resume)]
    run = drive(s.cell, s, (0.0,), dt=_DT, events=events)
    assert run.report.finished, run.report.reason
    assert run.report.stops == 1
    stands = run.q[(run.time > 2.8) & (run.time < 3.0)]
    assert np.ptp(stands, axis=0).max() < 1e-5
    assert _Seen(urdf, s).apart(run.q[::10]).max() <= 1e-3
    _kept(run)


def test_a_robot_that_is_silent_ends_the_run():
    s = _led("torso_lift", 4.0)
    events = [(1.5, lambda robots, loop: robots["lift"].kill())]
    run = drive(s.cell, s, (0.0,), dt=_DT, events=events, constraints=[StallBound(0.005, dt=_DT)])
    assert not run.report.finished
    assert "robot 'lift' told no state" in run.report.reason
    assert run.time[run.statuses.index("holding")] - 1.5 <= 0.015
    assert np.abs(run.sent[-1] - run.sent[-2]).max() < 1e-8
    _kept(run)


@pytest.mark.slow
def test_the_lift_and_its_arms_may_have_drivers_of_their_own():
    """The lift has a slow servo; an arm stops, and the lift and the other arm go back to it."""
    s = _led("torso_lift", 4.0)
    parts = ("left", "right")
    run = drive(s.cell, s, (0.12, 0.0, 0.03), dt=_DT, names=parts)
    assert run.report.finished, run.report.reason
    assert list(run.report.lags) == ["lift", "left", "right"]
    assert _Seen("lift2", s).apart(run.q[::10]).max() <= 5e-4
    events = [(1.5, _servo("right", "halt")), (3.0, _servo("right", "release")), (3.2, _resume)]
    run = drive(s.cell, s, (0.0,) * 3, dt=_DT, names=parts, events=events)
    assert run.report.finished, run.report.reason
    assert max(run.report.lost_time, key=run.report.lost_time.get) == "right"
    apart = _Seen("lift2", s).apart(run.q)
    assert apart.max() > 2e-3  # the others brake
    assert apart[(run.time > 2.5) & (run.time < 3.0)].max() <= 5e-4
    _kept(run)


# -- robots and arms in one cell ---------------------------------------------------------------------------------------


@cache
def _tower():
    """A lift with two arms, and an arm on a base of its own, raise a bar by 1.4 m."""
    limits = {"geometry": False, "acceleration_limits": 10.0}
    tools = {side: f"{side}_tool" for side in ("left", "right")}
    faces = pin.SE3(pin.utils.rotate("z", np.pi), np.array([1.65, 0.0, 0.4]))
    east = Arm.from_urdf("east", robot_path("kr16_2"), tool_frame="flange", T_world_base=faces, **limits)
    cell = RobotCell([Robot(robot_path("lift2"), tools, name="tower", **limits), east])
    placed = ((90, 0, 0.0, 0.3), (-90, 0, 0.0, -0.3), (0, -90, 0.05, 0.0))
    grasp = Grasp(
        [pin.SE3(pin.rpy.rpyToMatrix(*np.deg2rad([r, p, 0.0])), np.array([x, y, 0.0])) for r, p, x, y in placed]
    )
    start = pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.2]))
    check = check_path(cell, grasp, LinePath.displaced(start, translation=(0.0, 0.0, 1.4), duration=4.0))
    assert check.verdict.value == "CERTIFIED"
    return Scenario("tower", cell, grasp, check.led_path(), check.q_start, dt=_DT)


@pytest.mark.slow
def test_a_robot_and_an_arm_beside_it_wait_for_each_other():
    s = _tower()
    assert driver_names(s.cell) == ("tower", "left", "right", "east")
    assert list(driven_joints(s.cell)) == ["tower", "east"]
    free = drive(s.cell, s, (0.01, 0.05), dt=_DT)
    assert free.report.finished, free.report.reason
    assert free.report.time <= 4.3
    assert free.apart.max() <= 3e-4
    assert _Seen("lift2", s).apart(free.q[::10, :13]).max() <= 3e-4
    for slow in ("tower", "east"):
        joints = driven_joints(s.cell)[slow]
        fastest = np.linalg.norm(np.diff(free.q[:, joints], axis=0), axis=1).max() / _DT
        events = [(0.2, _servo(slow, "limit", 0.5 * fastest)), (2.5, _servo(slow, "limit", None))]
        run = drive(s.cell, s, (0.01, 0.05), dt=_DT, events=events)
        assert run.report.finished, run.report.reason
        assert max(run.report.lost_time, key=run.report.lost_time.get) == slow
        assert run.apart.max() <= 2.5e-3
        _kept(run)


@pytest.mark.parametrize("stops", ["tower", "east"])
def test_the_others_go_back_to_the_one_that_stops(stops):
    s = _tower()
    events = [(1.5, _servo(stops, "halt", says=Condition.PROTECTIVE)), (3.0, _servo(stops, "release")), (3.2, _resume)]
    run = drive(s.cell, s, (0.0, 0.0), dt=_DT, events=events)
    assert run.report.finished, run.report.reason
    assert run.report.stops == 1
    times = run.time[::5]
    assert run.apart[(times > 2.5) & (times < 3.0)].max() <= 5e-4
    assert run.apart[times > 3.2].max() <= 1e-3
    _kept(run)


# -- names and refusals ------------------------------------------------------------------------------------------------


def _loop(scenario, drivers, **options):
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=_DT)
    return ControlLoop(controller, drivers, **options)


def test_joints_are_named_as_in_the_cell_or_as_in_the_description_in_any_order():
    s, time = _tower(), ManualTime()
    cell, x = s.cell, s.cell.positions(s.q_start)
    order = np.random.default_rng(3).permutation(13)
    own = [name.partition("/")[2] for name in cell.joint_names]
    for names in (cell.joint_names, own):
        drivers = {
            "tower": SimulatedRobot([names[j] for j in order], x[order], time=time),
            "east": SimulatedRobot(names[13:], x[13:], time=time),
        }
        tower, east = robots_of(cell, drivers)
        np.testing.assert_array_equal(tower.joints, order)
        assert (tower.arms, east.arms) == (("left", "right"), ("east",))
        assert _loop(s, drivers, time=time).refused() == []


def test_joints_that_no_driver_has_or_two_have_are_refused():
    s, time = _tower(), ManualTime()
    robots = simulated_robots(s.cell, s.q_start, time, (0.0, 0.0))
    lift = SimulatedRobot(["lift"], [0.3], time=time)
    for drivers, words in (
        ({"tower": robots["tower"]}, "no driver has the joint 'east/joint_1' nor 5 more.*each of tower, east"),
        ({"east": robots["east"], "tower": lift}, "no driver has the joint 'left/left_joint_1'"),
        ({**robots, "lift": SimulatedRobot(["tower/lift"], [0.3], time=time)}, "'tower/lift' also has the driver"),
        ({**robots, "tower": SimulatedRobot(["torso"], [0.3], time=time)}, "no joint 'tower/torso'"),
        ({**robots, "other": lift}, "no joint 'other/lift'"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            _loop(s, drivers)


def test_blind_servos_are_refused_unless_their_stiffness_is_told():
    s, time = _tower(), ManualTime()
    robots = simulated_robots(s.cell, s.q_start, time, (0.0, 0.0), tells_target=False)
    (said,) = _loop(s, robots, time=time).refused()
    assert said.endswith("Give SupervisionOptions(stiffness=…).")
    options = QPOptions(supervision=SupervisionOptions(stiffness=np.where(np.arange(s.cell.nv) == 0, 1e6, 1e5)))
    controller = QPController(s.cell, s.grasp, s.path, dt=0.002, options=options)
    assert ControlLoop(controller, robots, time=time).refused() == []


def test_which_joints_each_driver_has():
    s = _tower()
    size = {name: len(joints) for name, joints in driven_joints(s.cell).items()}
    assert size == {"tower": 13, "east": 6}
    size = {name: len(joints) for name, joints in driven_joints(s.cell, ["left", "tower", "east"]).items()}
    assert size == {"tower": 7, "left": 6, "east": 6}
    # Without shared joints each arm has a driver; or their robot one.
    limits = {"geometry": False, "acceleration_limits": 10.0, "locked_joints": {"lift": 0.3}}
    cell = RobotCell([Robot(robot_path("lift2"), {"a": "left_tool", "b": "right_tool"}, name="two", **limits)])
    assert not cell.groups
    assert list(driven_joints(cell)) == ["a", "b"]
    assert {name: len(joints) for name, joints in driven_joints(cell, ["two"]).items()} == {"two": 12}


class _Feels:
    """A controller that asks for wrenches, and ends the run when it has some."""

    needs_wrenches = True

    def __init__(self, inner):
        self._inner = inner

    def __getattr__(self, name):
        return getattr(self._inner, name)

    def step(self, q, *, wrenches):
        self.wrenches = wrenches
        self.stop("felt")
        return self._inner.step(q)


def test_a_robots_wrenches_are_told_by_arm():
    s, time = _tower(), ManualTime()
    wrench = np.arange(6.0)
    for told, words in (
        (None, "'tower' tells no wrenches by arm.*each of left, right"),
        (wrench, "'tower' tells no wrenches by arm.*each of left, right"),
        ({"left": wrench}, "'tower' tells no wrench of arm 'right'"),
        ({"left": wrench, "right": 2.0 * wrench}, ""),
    ):
        robots = simulated_robots(s.cell, s.q_start, time, (0.0, 0.0))
        for name, own in (("tower", told), ("east", 3.0 * wrench)):
            read = robots[name].read
            robots[name].read = lambda read=read, own=own: (
                None if (state := read()) is None else replace(state, wrench=own)
            )
        feels = _Feels(QPController(s.cell, s.grasp, s.path, dt=_DT))
        loop = ControlLoop(feels, robots, time=time)
        said = loop.refused()
        assert bool(words) == bool(said)
        for line in said:
            assert re.search(words, line)
    feels.stop = loop.stop
    assert loop.run().largest_force == pytest.approx(np.linalg.norm(3.0 * wrench[:3]))
    np.testing.assert_array_equal(feels.wrenches, [wrench, 2.0 * wrench, 3.0 * wrench])


def test_a_lift_away_from_its_command_is_told_in_millimetres():
    s, time = _led("torso_lift", 4.0), ManualTime()
    robots = simulated_robots(s.cell, s.q_start, time, (0.0,), tells_target=False)
    loop = _loop(s, robots, time=time)
    loop.refused()
    targets = s.cell.positions(s.q_start)
    targets[0] += 0.008
    with pytest.raises(DriverError, match=r"lift/lift is 8\.0 mm from"):
        begin(loop.controller, loop.watches, [s.q_start], targets, tolerance=0.005)
