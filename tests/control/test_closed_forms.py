"""Parts of a step and of its supervision, by closed forms and few lines of NumPy."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import with_mismatch

from coopqp import (
    BindingLimit,
    CommonError,
    HoldPath,
    InvalidInputError,
    Knot,
    LimitKind,
    LinePath,
    PreviewOptions,
    QPController,
    QPOptions,
    RobotCell,
    ServoPath,
)
from coopqp.control import StallBound
from coopqp.control.lookahead.options import PlanLimits
from coopqp.control.monitoring.stress import servo_wrenches, whole_compliance
from coopqp.control.operator.hands import BELT_FILTER, BELT_SILENCE, HAND_FILTER, LAG_GAIN, Clutch, Gear
from coopqp.control.operator.trail import Trail
from coopqp.control.step.contact import refused
from coopqp.control.step.decoding import reason
from coopqp.control.step.start import check_start, held_command, rate_into, start_warning
from coopqp.core import _core
from coopqp.errors import StartWarning, StiffnessWarning
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.model.shapes import too_close
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.scenarios import Scenario
from coopqp.spatial import Array

# -- rates -------------------------------------------------------------------------------------------------------------


def knot_of(task: Scenario, slope: Array) -> Any:
    return Knot(0.0, CellState(task.cell, task.q_start), slope, 0.0 * slope)


def test_arms_part_by_the_distance_at_the_rate_of_a_stall_bound(paper: Scenario, rng: np.random.Generator) -> None:
    """v T/2 + n dt v with the fastest grasp and the joint that takes longest to rest; 5 samples by default."""
    cell = paper.cell.with_limits(acceleration=rng.uniform(3.0, 9.0, paper.cell.nv))
    task = Scenario("", cell, paper.grasp, paper.path, paper.q_start, 0.01)
    state, slope = CellState(cell, task.q_start), rng.normal(size=cell.nv)
    fastest = max(float(np.linalg.norm((state.jacobian(k) @ slope[own])[:3])) for k, own in enumerate(cell.columns))
    longest = float((np.abs(slope) / cell.limits.acceleration).max())
    for samples, known in ((None, 5), (2, 2)):
        for distance in (1e-3, 0.02):
            factors, fixed, squares = StallBound(distance, dt=0.01, samples=samples).lines(knot_of(task, slope))
            rate = math.sqrt(squares.item())
            parted = rate * fastest * (0.5 * rate * longest + known * 0.01)
            assert parted == pytest.approx(distance, rel=1e-9)
            assert (factors.tolist(), fixed.tolist()) == ([1.0], [0.0])
    for array in StallBound(0.01, dt=0.01).lines(knot_of(task, 0.0 * slope)):
        assert array.shape == (0,)  # who rests may go on at any rate
    assert StallBound(0.01, dt=0.01).name == "stall"


def test_the_rate_into_another_path_is_the_closest_one(rng: np.random.Generator) -> None:
    """By a search over all rates; rotation weighs with the length."""
    rates = np.linspace(0.0, 1.0, 100_001)
    for length in (0.1, 1.0):
        weights = np.repeat([1.0, length], 3)
        for _ in range(5):
            now, ahead = rng.normal(size=(2, 6))
            found = rate_into(0.6, now, ahead, length=length)
            off = np.linalg.norm((0.6 * now - rates[:, None] * ahead) * weights, axis=1)
            assert found == pytest.approx(rates[off.argmin()], abs=1e-4)
        assert rate_into(0.6, now, 2.0 * now, length=length) == pytest.approx(0.3)
        assert rate_into(0.6, now, 0.5 * now, length=length) == 1.0
        assert rate_into(0.6, now, -now, length=length) == 0.0
    both = np.array([now, np.zeros(6)]), np.array([2.0 * now, np.zeros(6)])  # of tools on the object, too
    assert rate_into(0.6, *both, length=0.3) == pytest.approx(0.3)
    rest = np.full(6, 1e-8)
    assert rate_into(0.6, rest, rest, length=0.3) == 0.6
    assert rate_into(0.6, now, rest, length=0.3) is None
    assert rate_into(0.6, rest, now, length=0.3) == pytest.approx(0.0, abs=1e-6)
    assert rate_into(0.0, now, now, length=0.3) is None


@pytest.mark.parametrize("limited", [True, False])
def test_a_change_of_motion_takes_as_long_as_the_joints_need(paper: Scenario, limited: bool) -> None:
    """From rest the way itself ends for joints without acceleration limit; in motion it begins and ends as they can."""
    acceleration = np.linspace(2.0, 8.0, 18) if limited else np.inf
    speed = np.where(np.arange(18) == 4, np.inf, np.linspace(1.0, 3.0, 18))
    cell, dt = paper.cell.with_limits(acceleration=acceleration, velocity=speed), 0.01
    usable = 0.7 * PlanLimits.of(cell, PreviewOptions(), dt=dt).acceleration
    path = ServoPath(paper.path.pose(0.0), speed=0.1, spin=0.2)
    controller = QPController(cell, paper.grasp, path, dt=dt)
    controller.reset(paper.q_start)

    def times(way: Any, twist: Array) -> Array:
        """Seconds that each joint takes for a world twist about the object's origin, where the way begins."""
        chain = Chain(cell, paper.grasp)
        chain.linearise(controller.commanded, way.start.translation)
        found: Array = chain.joint_columns(twist[:, None])[:, 0] / usable
        return found

    controller.retarget(path.pose(0.0) * pin.exp6(np.array([0.02, 0.01, 0.0, 0.0, 0.1, 0.0])))
    way: Any = path._way
    nominal, full = way._straight(path.speed, path.spin)
    stops = np.where(np.isfinite(speed), speed, 1.0) / usable
    needs = 0.0 if limited else np.minimum(np.abs(times(way, full)), stops).max()
    assert (way.begin, way.end) == (0.0, pytest.approx(needs, rel=1e-9))
    assert way.duration == pytest.approx(nominal + 0.5 * way.end)
    if not limited:
        return
    for _ in range(12):
        controller.step()
    aside = path.pose(controller.program_clock)
    controller.retarget(aside * pin.exp6(np.array([0.2, 0.2, 0.0, 0.0, 0.1, 0.1])))
    way = path._way
    nominal, full = way._straight(path.speed, path.spin)
    before, after = times(way, way.twist), times(way, full)
    share = nominal / (way.duration - 0.5 * (way.begin + way.end))
    assert way.end == pytest.approx(share * np.abs(after).max(), rel=1e-6)
    assert way.begin == pytest.approx(np.abs(share * after - before).max(), rel=0.02)  # of the pass before


# -- supervision -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [False, True])
def test_wrenches_bend_the_servos_by_what_is_seen(shared: bool, rng: np.random.Generator) -> None:
    own = np.array([a @ a.T + np.eye(6) for a in rng.normal(size=(3, 6, 6))])
    common = rng.normal(size=(18, 4))
    both = common @ common.T if shared else None
    wrenches = rng.normal(size=(3, 6))
    whole = np.zeros((18, 18)) if both is None else both.copy()
    for k in range(3):
        whole[6 * k : 6 * (k + 1), 6 * k : 6 * (k + 1)] += own[k]
    if both is not None:
        np.testing.assert_allclose(whole_compliance(own, both), whole, atol=1e-12)
    bent = ((whole + _core.STRUCTURE * np.eye(18)) @ wrenches.ravel()).reshape(3, 6)
    np.testing.assert_allclose(servo_wrenches(own, bent, both), wrenches, atol=1e-9)


def there(found: Array | None) -> Array:
    """What is not None."""
    assert found is not None
    return found


# -- starts ------------------------------------------------------------------------------------------------------------


def test_a_start_says_how_far_each_arm_is_from_the_path(paper: Scenario) -> None:
    shares = CommonError.leaderless().shares(paper.cell)
    pose, q = paper.path.pose(0.0), paper.q_start
    assert start_warning(paper.cell, paper.grasp, shares, pose, q) == ()
    task = with_mismatch(paper, 1, (0.0, 3e-3, 0.0))
    off, beside = start_warning(task.cell, task.grasp, shares, pose, q)
    assert off == "arm slave_1 started off its grasp: it is 2.00 mm off"
    assert beside == "the object started off its path: it is 1.00 mm off"
    assert start_warning(task.cell, task.grasp, shares, None, q) == (off,)
    turned = with_mismatch(paper, 2, (0.0, 0.0, 0.0), (0.0, 0.0, np.deg2rad(1.2)))
    assert "arm slave_2 started off its grasp" in start_warning(turned.cell, turned.grasp, shares, pose, q)[0]
    moved = pin.SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, 1e-3]))
    assert start_warning(paper.cell, paper.grasp, shares, moved, q) == (
        "the object started off its path: it is 1.00 mm off",
    )
    beyond = pin.SE3(pose.rotation, pose.translation + np.array([0.0, 0.03, 0.0]))
    far = LinePath.displaced(beyond, translation=(0, 0, 0.1), duration=1.0)
    with pytest.raises(InvalidInputError, match=r"arm 'master' holds the object 30\.0 mm and 0\.00° from the start of"):
        check_start(paper.cell, paper.grasp, far, q)
    with pytest.raises(InvalidInputError, match=r"from its path at 0\.5 s \(tolerance 20 mm, 3°\)"):
        check_start(paper.cell, paper.grasp, paper.path, q, clock=0.5)
    with pytest.raises(InvalidInputError, match=r"arm 'slave_2' .* 1\.20° .*tolerance 20 mm, 0\.5°"):
        check_start(turned.cell, turned.grasp, paper.path, q, tolerance_rad=np.deg2rad(0.5))
    given = check_start(paper.cell, paper.grasp, paper.path, np.array([q, q]), tolerance_m=1e-6, tolerance_rad=1e-6)
    np.testing.assert_allclose(given, q)
    assert not given.flags.writeable


def test_warnings_of_a_start_point_at_the_line_that_starts(paper: Scenario) -> None:
    task = with_mismatch(paper, 1, (0.0, 3e-3, 0.0))
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    for readings, kinds in ((task.q_start, [StartWarning]), ([task.q_start] * 2, [StartWarning, StiffnessWarning])):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            controller.reset(readings)
        assert [(w.category, w.filename) for w in told] == [(kind, __file__) for kind in kinds]


def test_what_robots_hold_is_near_what_is_measured(paper: Scenario) -> None:
    q = paper.q_start
    held = q.copy()
    held[7] += 0.02
    np.testing.assert_array_equal(held_command(paper.cell, q, held, 0.02 + 1e-12), held)
    name = paper.cell.joint_names[7]
    with pytest.raises(InvalidInputError, match=rf"joint {name} is measured 0\.02 rad \(or m\) from its command"):
        held_command(paper.cell, q, held, 0.019)


# -- contact -----------------------------------------------------------------------------------------------------------


def letting_go() -> GraspMotion:
    """The second arm lets go at 1 s and holds again from 2 s on."""
    return GraspMotion(
        ((), (), ()), ((0.0, (True,) * 3), (1.0, (True, False, True)), (2.0, (True,) * 3)),
        attach_m=1e-3, attach_rad=0.01,
    )  # fmt: skip


def test_an_arm_attaches_where_it_grasps_only(paper: Scenario) -> None:
    here, motion = paper.path.pose(0.0), letting_go()
    place = here * paper.grasp.T_object_tool[1]

    def carried(far: float, turn: float) -> list[pin.SE3]:
        """The second arm's tool is off its grasp by a way and a turn about itself."""
        off = pin.SE3(pin.exp3(np.array([0.0, turn, 0.0])), np.array([far, 0.0, 0.0]))
        return [here, place * off * paper.grasp.T_object_tool[1].inverse(), here]

    def said_at(clock: float, taken: float, far: float, turn: float) -> str:
        return refused(paper.cell, paper.grasp, motion, carried(far, turn), clock=clock, taken=taken)

    for far, turn, held in ((9e-4, 9e-3, False), (1.1e-3, 0.0, True), (0.0, 0.011, True), (0.0, 0.0, False)):
        assert said_at(2.0, 1.5, far, turn) == (
            f"arm {paper.cell.arm_names[1]} is {1e3 * far:.2f} mm and {np.rad2deg(turn):.2f}° from its grasp where it "
            "attaches (at most 1 mm and 0.57°)"
            if held
            else ""
        )
    assert said_at(1.5, 0.5, 0.1, 0.0) == ""  # it lets go
    assert said_at(2.5, 2.2, 0.1, 0.0) == ""  # it held before


def test_fewer_arms_are_filtered_more_and_hand_over_without_a_jump(paper: Scenario) -> None:
    """Where an arm lets go the object's measured error stays, and its filter is slower by (N/h)²."""
    path, dt, T = HoldPath(paper.path.pose(0.0), duration=5.0), 0.01, QPOptions().measurement_time
    path.grasps = letting_go()
    options = QPOptions(common_error=CommonError.leaderless())
    controller = QPController(paper.cell, paper.grasp, path, dt=dt, options=options)
    controller.reset(paper.q_start)
    at, off = controller._loop.at, np.linspace(-1e-4, 1e-4, 18)
    while controller.program_clock < 1.0 - 1e-9:
        controller.step(controller.commanded + off)
    before, drift = at["shares"].reshape(3, 6).copy(), at["drift"].copy()
    controller.step(controller.commanded + off)  # from 1 s on
    now, away = at["shares"].reshape(3, 6), at["measured_away"].reshape(3, 6)
    assert np.abs(now - before).max() > 0.1
    kept = ((before - now) * away).sum(axis=0)
    np.testing.assert_allclose(at["latched"], kept, rtol=0.0, atol=1e-15)
    share = dt / (dt + T * (3 / 2) ** 2)
    error = (now * at["errors"].reshape(3, 6)).sum(axis=0)
    found = (now * (away + at["errors"].reshape(3, 6))).sum(axis=0) - error
    np.testing.assert_allclose(at["drift"] - drift, share * (found + kept - drift), rtol=0.0, atol=1e-12)


# -- hands, belts and trails -------------------------------------------------------------------------------------------


def test_a_belt_is_followed_through_its_filter() -> None:
    """A belt at constant speed is found, whatever its first speed was told to be; then it lags no more."""
    gear, speed, dt = Gear(0.0, 0.2), 0.8, 0.01
    for i in range(1, 60):
        for _ in range(2):
            gear = gear.later(0.5 * dt)
        assert gear.age == pytest.approx(dt)
        gear = gear.measured(speed * dt * i)
    assert (gear.position, gear.speed, gear.age) == pytest.approx((speed * dt * 59, speed, 0.0), abs=1e-6)
    assert gear.share(gear.position) == pytest.approx(speed, abs=1e-5)
    assert gear.share(gear.position + 0.01) == pytest.approx(speed - 0.01 * LAG_GAIN, abs=1e-5)
    assert gear.share(gear.position - 0.1) == 1.0
    assert gear.share(gear.position + 1.0) == 0.0
    again = gear.measured(9.0)  # in the same step: the latest counts
    assert (again.position, again.speed) == (9.0, gear.speed)
    left = math.exp(-dt / BELT_FILTER)
    one = Gear(0.0, 0.0, dt).measured(1.0)
    assert (one.position, one.speed) == pytest.approx((1.0 - left**2, (1.0 - left) ** 2 / dt))
    late = gear.later(BELT_SILENCE - 1e-6)
    assert not late.silent
    assert late.share(late.position) > 0.7
    assert late.later(2e-6).silent
    assert late.later(2e-6).share(late.position) == 0.0


def test_a_hand_leads_by_how_far_it_has_moved(rng: np.random.Generator) -> None:
    hand, here = (pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    clutch, goal = Clutch(hand).goal(here)
    assert goal.isApprox(here, 1e-12)
    turn, way = pin.exp3(np.array([0.1, 0.2, -0.1])), np.array([0.01, 0.02, 0.03])
    there = pin.SE3(turn @ hand.rotation, hand.translation + way)
    share = 1.0 - math.exp(-0.02 / HAND_FILTER)
    part = clutch.measured(there, 0.02).goal(here)[1]
    np.testing.assert_allclose(part.translation, here.translation + share * way)
    np.testing.assert_allclose(pin.log3(part.rotation @ here.rotation.T), share * pin.log3(turn), atol=1e-9)
    whole = clutch.measured(there, math.inf).goal(here)[1]
    np.testing.assert_allclose(whole.translation, here.translation + way)
    np.testing.assert_allclose(whole.rotation, turn @ here.rotation, atol=1e-12)
    assert Clutch(hand).measured(there, 0.02).hand is there  # nothing follows it yet


def test_a_trail_leads_back_over_whole_turns(mixed_cell: RobotCell) -> None:
    """Positions, and velocities over the clock of the way back; a continuous joint goes back as far as it came."""
    cell = mixed_cell
    joint, dt = int(np.flatnonzero(cell.continuous)[0]), 0.004
    trail, x0 = Trail(cell, dt=dt), np.linspace(-0.5, 0.5, cell.nv)
    speed = np.linspace(0.5, 1.0, cell.nv)
    speed[joint] = 9.0
    assert trail.stride == 8
    assert trail.back(0.0) is None
    trail.begin(0.0, x0)
    assert trail.back(1.0) is None
    for i in range(1, 41):
        x = x0 + 0.05 * i * speed
        x[joint] = (x[joint] + np.pi) % (2.0 * np.pi) - np.pi  # as it is measured
        trail.note(0.05 * i, x, 0.5 * speed, 0.5)
    assert len(trail) == 41
    back = trail.back(2.0)
    assert back is not None
    for at in (0.0, 0.52, 1.1):
        position, slope = back.at(at)
        np.testing.assert_allclose(position, x0 + (2.0 - at) * speed, atol=1e-9)
        np.testing.assert_allclose(slope, -speed, atol=1e-9)
    kept = trail.copy()
    trail.cut(1.0, x0 + 1.0 * speed)
    assert (len(trail), len(kept)) == (21, 41)
    trail.note(1.0 + 5e-5, x0 + 1.0 * speed, speed, 1.0)
    assert len(trail) == 21  # too near to the last one, in whose place it is
    slow = Trail(cell, dt=dt)
    slow.begin(0.0, x0)
    for i in range(1, 4):
        slow.note(0.05 * i, x0 + 0.05 * i * speed, 100.0 * speed, 0.01)  # so slow that the velocity says nothing
    gone = slow.back(0.15)
    assert gone is not None
    np.testing.assert_allclose(gone.at(0.07)[1], -speed, atol=1e-6)


# -- words -------------------------------------------------------------------------------------------------------------

SAID = [
    ("NOT_FINITE", (3, np.nan, 0), "joint {joint} has no finite measured position"),
    ("OFF_CIRCLE", (3, 1.2345, 0), "q_measured[3] and [4] are no cosine and sine (norm 1.23)"),
    ("JUMPED", (3, 0.45678, 0), "joint {joint} is measured 0.457 rad (or m) from its command"),
    ("CHAIN_APART", (1, 2.34e-3, 2), "arms slave_1 and slave_2 are commanded 2.3 mm apart"),
    ("OUT_OF_STEP_BY", (1, 2.34567e-3, 0), "arm slave_1 is 2.35 mm out of step with the others"),
    ("WAS_OUT_OF_STEP", (1, 0, 0), "arm slave_1 was out of step"),
    ("STALLED", (2, 0, 0), "arm slave_2 does not follow its command (stalled)"),
    ("FORCE", (0, 123.4, 0), "123 N at the grasp of arm master by its servos (limit 250 N)"),
    ("FORCE_GROWS", (0, 123.4, 310.2), "123 N at the grasp of arm master by its servos, soon 310 N (limit 250 N)"),
    ("OFF_SERVOS", (1, 2e-3, 0), "arm slave_1 is 2.00 mm from where its wrench puts its servos"),
    ("HANGS_BEHIND", (1, 2e-3, 45.6), "arm slave_1 does not follow its command: it hangs 2 mm behind, and the others "
     "pull it with 46 N"),
    ("PATH_FAILED", (-1, 1.25, 0), "the path has no pose at its clock 1.25 s"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "numbers", "words"), SAID)
def test_what_the_core_says_names_arm_joint_and_numbers(
    paper: Scenario, name: str, numbers: tuple[float, float, float], words: str
) -> None:
    said = reason(paper.cell, 250.0, _core.REASONS.index(name), *numbers)
    assert said == words.replace("{joint}", paper.cell.joint_names[3])


def test_pairs_inside_their_margin_are_said_with_their_distance() -> None:
    def pair(distance: float) -> BindingLimit:
        return BindingLimit("", "", LimitKind.COLLISION, between=("a", "b"), distance=distance)

    assert too_close(()) == ""
    assert too_close((pair(0.0034),)) == "a and b are 3.4 mm from each other, inside their margin"
    assert too_close((pair(_core.DEEPEST),)) == "a and b overlap"  # coal found no depth
    assert too_close((pair(-0.0034),) * 2) == "a and b overlap by 3.4 mm, and 1 other pair"
    assert too_close((pair(0.0),) * 3) == "a and b are 0.0 mm from each other, inside their margin, and 2 other pairs"
