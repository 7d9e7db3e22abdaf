"""An operator's calls: back, on, to a clock, to a mark, by hand, aside, after a belt."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from marks import slow_but_first
from runs import built, cooperative, limited_once

from coopqp import (
    Cause,
    ControlStep,
    InvalidInputError,
    LimitKind,
    QPController,
    ServoPath,
    Status,
    WaypointPath,
    plan,
)
from coopqp.errors import UnknownNameError
from coopqp.scenarios import dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import Monitor, check_run, simulate

DT = 0.005
MOST = 4000


def lift(make: Any = paper_lift, **more: Any) -> QPController:
    return built(limited_once(make, 5.0), dt=DT, **more)


def steps(controller: QPController, count: int) -> list[ControlStep]:
    return [controller.step() for _ in range(count)]


def until(controller: QPController, status: Status) -> list[ControlStep]:
    done = [controller.step()]
    while done[-1].status is not status:
        done.append(controller.step())
        assert len(done) < MOST, done[-1]
    return done


def to_the_end(controller: QPController) -> list[ControlStep]:
    done = [controller.step()]
    while not done[-1].finished:
        done.append(controller.step())
        assert len(done) < MOST, done[-1]
    return done


def off_path() -> tuple[QPController, list[ControlStep]]:
    """A lift whose first arm was seen elsewhere: the object is off its path."""
    controller = lift()
    far = controller.commanded.copy()
    far[controller.cell.q_slices[0]] += 0.1
    return controller, [controller.step(far)]


def kept(controller: QPController, done: list[ControlStep], *, moving: bool = False) -> None:
    """All limits are kept, the arms hold the object, and it is on its path."""
    monitor = Monitor(controller.cell, controller.grasp)
    monitor.observe_all(done[1:] if moving else done)
    assert monitor.verdict().ok, monitor.verdict()


@pytest.mark.core
@pytest.mark.parametrize(("make", "nearly"), [(paper_lift, 1e-9), (dual_arm7, 1e-4)])
def test_back_through_the_same_configurations(make: Any, nearly: float) -> None:
    controller = lift(make)
    start = controller.commanded.copy()
    there = steps(controller, 250)
    controller.reverse()
    back = until(controller, Status.PAUSED)
    falling = [step for step in back if step.sense < 0]
    assert falling
    assert all(step.clock_next <= step.clock for step in falling)
    assert back[-1].clock == 0.0
    assert np.abs(back[-1].q_next - start).max() < nearly
    way = {round(step.clock, 9): step.q for step in there}
    for step in falling[20:-20:10]:
        after = min(way, key=lambda clock: abs(clock - step.clock))
        ahead = abs(after - step.clock)
        assert np.abs(way[after] - step.q).max() < 2.0 * ahead + 10.0 * nearly
    kept(controller, there + back)


def test_on_again_as_if_it_had_never_gone_back() -> None:
    alone, led = lift(), lift()
    expected = to_the_end(alone)[-1]
    done = steps(led, 200)
    led.reverse(0.2)
    done += until(led, Status.PAUSED)
    assert done[-1].clock == 0.2
    led.forward()
    done += to_the_end(led)
    np.testing.assert_allclose(done[-1].q_next, expected.q_next, atol=1e-9)
    kept(led, done)


def test_a_reversal_that_turns_on_the_way() -> None:
    controller = lift()
    done = steps(controller, 200)
    controller.reverse()
    done += steps(controller, 120)
    assert done[-1].sense == -1
    controller.forward()
    done += steps(controller, 150)
    assert done[-1].sense == 1
    assert done[-1].clock > done[-100].clock
    kept(controller, done)


def test_to_a_clock_in_motion_and_on_with_resume() -> None:
    controller = lift()
    done = steps(controller, 100)
    controller.run_to(1.0)
    done += steps(controller, 1)
    assert done[-1].rate == pytest.approx(done[-2].rate, abs=0.05)  # nothing brakes for it yet
    done += until(controller, Status.PAUSED)
    assert done[-1].clock == 1.0
    controller.resume()
    done += to_the_end(controller)
    assert done[-1].clock_next == controller.path.duration
    kept(controller, done)


def test_the_rate_of_a_step_that_a_section_ends_early() -> None:
    """An arm was seen elsewhere, so the object is off its path: its last step would lead beyond where it is to rest."""
    controller, done = off_path()
    controller.run_to(0.5 * controller.path.duration)
    done += until(controller, Status.PAUSED)
    controller.reverse()
    controller.step()
    done += until(controller, Status.PAUSED)
    assert max(abs(s.clock_next - s.clock - s.sense * s.rate * s.dt) for s in done) < 1e-12


def test_the_rate_of_the_first_step_back_that_is_the_last() -> None:
    """The object is off its path and the start of the way back is its end."""
    controller, done = off_path()
    for i in range(18):
        controller.gear(controller.program_clock + 0.005 * i)
        done += steps(controller, 1)
    controller.set_override(1.0)
    controller.run_to(0.0)
    done += steps(controller, 5)
    assert done[-4].sense == -1
    assert max(abs(s.clock_next - s.clock - s.sense * s.rate * s.dt) for s in done) < 1e-12


def test_a_clock_too_near_to_stop_at_is_passed_and_come_back_to() -> None:
    controller = lift()
    done = steps(controller, 200)
    controller.run_to(done[-1].clock_next + 0.002)
    goal = done[-1].clock_next + 0.002
    done += until(controller, Status.PAUSED)
    assert done[-1].clock == goal
    assert {step.sense for step in done} == {1, -1}
    kept(controller, done)


def test_from_mark_to_mark() -> None:
    task = limited_once(paper_lift, 5.0)
    low, high = task.path.pose(0.0), task.path.pose(task.path.duration)
    middle = pin.SE3(low.rotation, low.translation + np.array([0.03, -0.02, 0.05]))
    path = WaypointPath([low, middle, high], durations=[0.5, 1.0], time_law="linear")
    controller = built(task, dt=DT, path=path)
    done: list[ControlStep] = []
    for mark in (0.5, 1.5):
        controller.step_to_mark()
        done += until(controller, Status.PAUSED) if mark < path.duration else to_the_end(controller)
        assert done[-1].clock_next == mark
    controller.reverse()
    done += until(controller, Status.PAUSED)
    assert done[-1].clock == 0.0
    kept(controller, done)


@pytest.mark.core
@pytest.mark.parametrize("frame", slow_but_first(["world", "object", "B"]))
def test_by_hand_and_back(frame: str) -> None:
    controller = lift(mixed_cell)
    frame = controller.cell.arm_names[1] if frame == "B" else frame
    done = steps(controller, 150)
    for i in range(200):
        if i % 8 == 0:
            controller.jog([0.05, 0.0, 0.0, 0.0, 0.0, 0.1], frame=frame)
        done += steps(controller, 1)
    assert done[-1].status is Status.JOGGING
    assert done[-1].cause is Cause.OPERATOR
    left = done[-1].clock
    still = until_rest(controller)
    assert len(still) * DT < 0.1 + 0.3
    done += still
    assert "return_to_path" in done[-1].reason
    off = controller.grasp.carried(done[-1].state)[0].translation - controller.path.pose(left).translation
    assert 0.01 < np.linalg.norm(off) < 0.05
    controller.return_to_path()
    done += to_the_end(controller)
    assert all(step.clock == left for step in done if step.status is Status.JOGGING)
    kept(controller, done)


def until_rest(controller: QPController) -> list[ControlStep]:
    done = [controller.step()]
    while np.abs(done[-1].velocity).max() > 1e-6:
        done.append(controller.step())
        assert len(done) < MOST
    return done


def test_axes_of_a_jog() -> None:
    """The object moves as the twist says, in the axes of the frame."""
    controller = lift()
    controller.pause()
    until(controller, Status.PAUSED)
    T = controller.path.pose(controller.program_clock)
    axes = {
        "world": np.eye(3),
        "object": T.rotation,
        controller.cell.arm_names[0]: T.rotation @ controller.grasp.T_object_tool[0].rotation,
    }
    for frame, R in axes.items():
        other = copy.copy(controller)
        for _ in range(10):
            other.jog([0.0, 0.03, 0.0, 0.0, 0.0, 0.0], frame=frame)
            step = steps(other, 4)[-1]
        way = other.grasp.carried(step.state)[0].translation - T.translation
        np.testing.assert_allclose(way / np.linalg.norm(way), R[:, 1], atol=1e-5)


def test_a_jog_stops_at_a_limit_by_name_and_leads_away_again() -> None:
    controller = lift()
    done: list[ControlStep] = []

    def lead(x: float, count: int) -> ControlStep:
        for _ in range(count):
            controller.jog([0.0, 0.0, x, 0.0, 0.0, 0.0], frame="world", deadman_s=0.5)
            done.extend(steps(controller, 80))
        return done[-1]

    step = lead(0.5, 9)
    assert step.status is Status.JOGGING
    assert np.abs(step.velocity).max() < 1e-3
    assert step.cause in (Cause.LIMIT, Cause.SINGULARITY)
    assert any(limit.arm and limit.kind is not LimitKind.OVERRIDE for limit in step.binding)
    there = controller.grasp.carried(step.state)[0].translation[2]
    assert controller.grasp.carried(lead(-0.1, 2).state)[0].translation[2] < there - 0.01
    kept(controller, done)


def test_the_program_moves_aside() -> None:
    controller = lift()
    before = controller.path
    shift = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.03])), np.array([0.01, 0.0, 0.0]))
    done = steps(controller, 150)
    controller.shift_path(shift, over=0.05)
    done += to_the_end(controller)
    end = controller.path.pose(controller.path.duration)
    assert end.isApprox(shift * before.pose(before.duration), 1e-12)
    assert controller.grasp.carried(done[-1].state)[0].isApprox(end, 1e-3)
    controller.reverse()
    done += until(controller, Status.PAUSED)
    assert controller.grasp.carried(done[-1].state)[0].isApprox(before.pose(0.0), 1e-6)
    kept(controller, done)


def test_a_belt_sets_the_pace() -> None:
    controller = lift()
    done: list[ControlStep] = []
    lags = []
    for i in range(400):
        controller.gear(0.5 * DT * i, speed=0.5)
        done += steps(controller, 1)
        lags.append(0.5 * DT * (i + 1) - done[-1].clock_next)
    assert np.abs(lags[200:]).max() < 1e-3
    silent = steps(controller, 120)
    assert silent[-1].status is Status.PAUSED
    assert "belt" in silent[-1].reason
    controller.set_override(1.0)
    done += silent + to_the_end(controller)
    kept(controller, done)


def test_a_hand_leads_without_a_leap() -> None:
    controller = lift(dual_arm7)
    done = steps(controller, 100)
    hand = pin.SE3.Random()
    controller.engage(hand)
    for i in range(300):
        if i % 6 == 0:
            controller.target(pin.SE3(hand.rotation, hand.translation + np.array([2e-4 * i, 0.0, 0.0])))
        done += steps(controller, 1)
    begun = controller.path.pose(controller.program_clock).translation
    way = controller.grasp.carried(done[-1].state)[0].translation - begun
    assert abs(way[0] - 0.06) < 0.03
    assert np.abs(way[1:]).max() < 1e-4
    done += steps(controller, 120)  # silence
    assert np.abs(done[-1].velocity).max() < 1e-6
    controller.release()
    controller.target(hand)  # nothing follows it any more
    done += steps(controller, 20)
    assert np.abs(done[-1].velocity).max() < 1e-6
    controller.return_to_path()
    done += to_the_end(controller)
    kept(controller, done)


def test_bad_values_change_nothing() -> None:
    controller = lift()
    steps(controller, 100)
    other = copy.copy(controller)
    calls: list[Any] = [
        lambda: controller.reverse(-0.1),
        lambda: controller.reverse(2.0),
        lambda: controller.reverse(float("nan")),
        lambda: controller.run_to(1e3),
        lambda: controller.jog([0.0] * 5),
        lambda: controller.jog([0.0, np.inf, 0.0, 0.0, 0.0, 0.0]),
        lambda: controller.jog([0.1] * 6, deadman_s=0.0),
        lambda: controller.shift_path(np.zeros((4, 4))),
        lambda: controller.shift_path(pin.SE3.Identity(), over=0.0),
        lambda: controller.gear(float("nan")),
        lambda: controller.gear(0.0, speed=-1.0),
        lambda: controller.engage(np.zeros(3)),
        lambda: controller.target(np.zeros(3)),
    ]
    for call in calls:
        with pytest.raises(InvalidInputError):
            call()
    with pytest.raises(UnknownNameError, match="frame"):
        controller.jog([0.1] * 6, frame="tool")
    for mine, theirs in zip(steps(controller, 100), steps(other, 100), strict=True):
        assert np.array_equal(mine.q_next, theirs.q_next)


def test_before_the_first_reset_and_without_an_end() -> None:
    task = limited_once(paper_lift, 5.0)
    fresh = cooperative(task, dt=DT)
    for call in (fresh.forward, fresh.reverse, fresh.return_to_path, fresh.release):
        with pytest.raises(InvalidInputError, match="reset"):
            call()
    endless = built(task, dt=DT, path=ServoPath(task.path.pose(0.0)))
    for call in (endless.reverse, endless.step_to_mark):
        with pytest.raises(InvalidInputError, match="no end"):
            call()


def test_targets_by_hand_and_programs_of_targets() -> None:
    """A servo path can be left by hand, too; a target that comes meanwhile waits for the way back."""
    task = limited_once(paper_lift, 5.0)
    start = task.path.pose(0.0)
    controller = built(task, dt=DT, path=ServoPath(start))
    done: list[ControlStep] = []
    for _ in range(20):
        controller.jog([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
        done += steps(controller, 4)
    goal = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.02, 0.03]))
    controller.retarget(goal)
    done += steps(controller, 150)
    assert done[-1].status is Status.JOGGING
    controller.return_to_path()
    done += steps(controller, 600)
    assert controller.grasp.carried(done[-1].state)[0].isApprox(goal, 1e-6)
    kept(controller, done)


@pytest.mark.core
@pytest.mark.parametrize("call", ["reverse", "jog", "return_to_path", "engage", "shift_path"])
def test_a_fault_keeps_a_call_and_a_reset_discards_it(call: str) -> None:
    controller = lift()
    steps(controller, 100)
    for _ in range(4):
        far = controller.commanded.copy()
        far[controller.cell.q_slices[-1]] += 0.1
        step = controller.step(far)
    assert step.status is Status.FAULT
    until_rest(controller)
    arguments: dict[str, tuple[Any, ...]] = {
        "jog": ([0.1, 0.0, 0.0, 0.0, 0.0, 0.0],), "engage": (pin.SE3.Identity(),),
        "shift_path": (pin.SE3(np.eye(3), np.array([0.01, 0.0, 0.0])),),
    }  # fmt: skip
    alone = copy.copy(controller)
    getattr(controller, call)(*arguments.get(call, ()))
    for mine, theirs in zip(steps(controller, 60), steps(alone, 60), strict=True):
        assert mine.status is Status.FAULT
        np.testing.assert_array_equal(mine.q_next, theirs.q_next)
    controller.reset(controller.commanded, clock=controller.program_clock)
    assert {step.sense for step in to_the_end(controller)} == {1}


@pytest.mark.parametrize("way", slow_but_first([lambda c: pickle.loads(pickle.dumps(c)), copy.deepcopy, copy.copy]))
def test_copies_in_the_middle(way: Any) -> None:
    """A copy at any moment of back, hand and shift goes on bit for bit, and shares nothing that changes."""
    controller = lift(dual_arm7)
    calls: dict[int, Any] = {
        80: lambda c: c.reverse(0.1), 150: lambda c: c.forward(), 230: lambda c: c.jog([0.1, 0.0, 0.0, 0.0, 0.0, 0.2]),
        260: lambda c: c.jog([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]), 330: lambda c: c.return_to_path(),
        520: lambda c: c.shift_path(pin.SE3(np.eye(3), np.array([0.0, 0.01, 0.0]))),
        560: lambda c: c.gear(c.program_clock, speed=0.5), 600: lambda c: c.run_to(0.3),
    }  # fmt: skip
    for i in range(650):
        if i in calls:
            calls[i](controller)
        if i % 13 == 0:
            other = way(controller)
            ahead = [step.q_next for step in steps(way(controller), 12)]
            assert all(np.array_equal(a, b.q_next) for a, b in zip(ahead, steps(other, 12), strict=True))
            expected = ahead
        after = controller.step().q_next
        if i % 13 < 12 and not any(j in calls for j in range(i - i % 13 + 1, i + 1)):
            assert np.array_equal(after, expected[i % 13]), i


def test_a_long_run_keeps_few_knots() -> None:
    controller = lift(dual_arm7)
    trail = controller._operator.trail
    assert trail is not None
    q, rng = controller.commanded, np.random.default_rng(0)
    for i in range(100_000):
        if i % trail.stride == 0:
            trail.note(1e-2 * i, q, rng.normal(size=controller.cell.nv), 1.0)
    assert 500 < len(trail) <= 1024


def test_the_trail_rises_and_a_copy_has_all_of_it(golden: Golden) -> None:
    done = golden.of(lift(dual_arm7))
    done.run(150)
    done.ask(lambda controller: controller.reverse(0.2))
    while done.take().status is not Status.PAUSED:
        pass
    done.ask(lambda controller: controller.forward())
    done.run(60)
    operator = copy.copy(done.controller)._operator
    assert operator.trail is not None
    clocks = np.array([knot[0] for knot in operator.trail._knots])
    assert len(clocks) > 15
    assert (np.diff(clocks) > 0.0).all()


def test_a_command_that_repeats_the_last_one_takes_no_new_way(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = lift()
    done = steps(controller, 100)
    operator, ways = controller._operator, []
    retarget = operator.retarget
    monkeypatch.setattr(operator, "retarget", lambda *way: ways.append(way) or retarget(*way))
    twist = np.array([0.03, 0.0, 0.02, 0.0, 0.0, 0.1])
    for i in range(300):
        if i % 5 == 0:
            controller.jog(twist, frame="world")
        done.append(controller.step())
    taken = len(ways)
    assert taken <= 6  # 60 commands in 1.5 s
    first, last = (controller._held_at(done[i].q) for i in (-100, -1))
    went = last.translation - first.translation
    assert went == pytest.approx(99 * DT * twist[:3], abs=1e-6)  # at full speed all the time
    controller.jog(-twist, frame="world")
    assert len(ways) == taken + 1
    kept(controller, done)


def test_a_recording_of_back_and_hand_is_in_order() -> None:
    task = limited_once(paper_lift, 5.0)
    controller = cooperative(task, dt=DT)
    count = iter(range(10_000))

    def led(step: ControlStep) -> None:
        i = next(count)
        if i == 150:
            controller.reverse(0.1)
        if 400 <= i < 500 and i % 5 == 0:
            controller.jog([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
        if i == 600:
            controller.return_to_path()
        if i == 900:
            controller.forward()

    run = simulate(controller, q_start=task.q_start, observe=led)
    assert run.finished
    assert {Status.JOGGING, Status.PAUSED} <= set(run.statuses)
    assert (np.diff(run.clock) < 0.0).any()
    verdict = check_run(run, task.cell)
    assert verdict.ok, verdict


@pytest.mark.slow
def test_a_plan_and_its_way_back_as_recorded(golden: Golden) -> None:
    task = limited_once(dual_arm7, 5.0)
    path = plan(task.cell, task.grasp, task.path, q_start=task.q_start).path
    done = golden.of(built(task, dt=DT, path=path)).run(100)
    done.ask(lambda controller: controller.reverse())
    while done.take().status is not Status.PAUSED:
        pass
    kept(done.controller, done.steps)


def test_a_way_that_begins_at_rest_in_mid_path_begins_slowly() -> None:
    """The program itself moves there: from 0 the rate rises by what the joints' accelerations allow."""
    task = limited_once(lambda: paper_lift(time_law="linear"), 5.0)
    controller = built(task, dt=DT)
    steps(controller, 60)
    controller.pause()
    until_rest(controller)
    for call in (controller.reverse, controller.forward):
        before = controller.program_clock
        call()
        done = steps(controller, 40)
        rates = [step.rate for step in done]
        assert 0.0 <= rates[0] < 0.3
        assert max(np.diff([0.0, *rates])) < 0.3
        assert max(rates) > 0.5
        assert {step.sense for step in done} == {-1 if call == controller.reverse else 1}
        assert (controller.program_clock - before) * done[0].sense > 0.0
        kept(controller, done)
        controller.pause()
        until_rest(controller)


def test_a_reset_in_mid_path_begins_the_trail_anew() -> None:
    """The way back is the one travelled since then."""
    task = limited_once(dual_arm7, 5.0)
    controller = built(task, dt=DT)
    steps(controller, 25)
    q, clock = controller.commanded.copy(), controller.program_clock
    other = built(task, dt=DT)
    other.reset(q, clock=clock)
    controller.reset(q, clock=clock)
    ways = []
    for made in (controller, other):
        there = steps(made, 25)
        made.reverse(clock)
        back = until(made, Status.PAUSED)
        np.testing.assert_allclose(back[-1].q_next, q, atol=2e-3)
        assert back[-1].clock_next == pytest.approx(clock, abs=1e-9)
        ways.append([step.q_next for step in (*there, *back)])
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-12)
