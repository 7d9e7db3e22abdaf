"""What steps rest on when they ask the look-ahead: rises, falls, free ways, copies, and work in small pieces."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from runs import preview_of
from user_paths import OnlyMarked

from coopqp import LimitKind, LinePath, PreviewOptions, QPController, QPOptions, Status, WaypointPath, plan
from coopqp.control.lookahead.closed_chain import ClosedChainAhead
from coopqp.control.lookahead.horizon import Horizon
from coopqp.control.lookahead.preview import PathPreview
from coopqp.control.step.rate_cap import RateCap
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.native import available_kernels
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, at_singularity, paper_lift
from coopqp.spatial import Array

DT = 0.002


def cornered(acceleration: float) -> Scenario:
    """Up, aside and back at constant speed: corners at 0.3 s and 0.6 s."""
    task = paper_lift()
    start = task.path.pose(0.0)
    places = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.05), (0.03, 0.0, 0.05), (0.03, 0.03, 0.05))
    poses = [pin.SE3(start.rotation, start.translation + np.array(p)) for p in places]
    path = WaypointPath(poses, durations=[0.3] * 3, time_law=TimeLaw.LINEAR)
    return replace(task, path=path, cell=task.cell.with_limits(acceleration=acceleration))


def on_the_path(task: Scenario, clock: float) -> Array:
    """The configuration (nq,) at a clock, along the path from its start."""
    chain, q = Chain(task.cell, task.grasp), task.q_start
    for at in np.linspace(0.0, clock, 25).tolist():
        q, errors = newton(chain, task.path.pose(at), q, tolerance=1e-13, max_iter=12)
        assert np.abs(errors).max() < 1e-9
    return q


def test_the_rate_rises_no_faster_than_the_knots_on_both_sides_allow() -> None:
    preview = preview_of(cornered(5.0))
    knots = preview.horizon.knots
    here, ahead = knots[0], knots[1]
    middle = 0.5 * (here.clock + ahead.clock)
    for rises in ((0.5, 3.0), (3.0, 0.5)):
        knots[0], knots[1] = here._replace(rise=rises[0]), ahead._replace(rise=rises[1])
        assert preview.rise(middle) == (0.5, None)
    preview.horizon.clear()
    assert preview.rise(0.0) == (np.inf, None)  # nothing is known: nothing is forbidden


def test_joints_that_no_step_limits_bound_the_rise() -> None:
    """A rise of σ by u accelerates joint j by q′ u: the joint with the largest share of its acceleration is named."""
    task = cornered(np.inf)
    preview = preview_of(task)
    knots, acceleration = preview.horizon.knots, preview._plan.acceleration
    for first, second in ((1.0, 0.2), (0.2, 1.0)):
        slopes = first * knots[0].slope, second * knots[0].slope
        here, ahead = (knots[i]._replace(slope=slope, rise=np.inf) for i, slope in enumerate(slopes))
        knots[0], knots[1] = here, ahead
        expected = acceleration / np.maximum(np.abs(here.slope), np.abs(ahead.slope))
        rise, limit = preview.rise(0.5 * (here.clock + ahead.clock))
        assert rise == pytest.approx(expected.min())
        assert limit is not None
        assert limit.kind is LimitKind.ACCELERATION
        assert f"{limit.arm}/{limit.joint}" == task.cell.joint_names[int(expected.argmin())]
        knots[0] = knots[0]._replace(slope=slopes[0] / first)
    knots[1] = knots[1]._replace(rise=0.5 * rise)
    assert preview.rise(here.clock) == (0.5 * rise, None)


def followed(preview: PathPreview, task: Scenario, until: float) -> float:
    """The clock once the object has followed the caps up to ``until`` [s]."""
    preview.reset(task.q_start, 0.0)
    clock = 0.0
    while clock < until:
        clock += max(preview.cap(clock, DT)[0], 0.01) * DT
    return clock


def test_the_rate_stays_while_a_corner_is_passed() -> None:
    """A corner takes the acceleration: within a step's way before and behind it the rate does not fall as well."""
    task = cornered(5.0)
    preview = preview_of(task)
    followed(preview, task, 0.28)
    rate = 0.5
    for away, passing in ((-1.5, False), (-0.5, True), (0.5, True), (1.5, False)):
        fall = preview.brake(0.3 + away * rate * DT, DT, rate)
        assert (fall == 0.0) == passing, away


def test_the_rate_may_fall_up_to_the_end_of_the_path() -> None:
    """Nothing comes after it that the rate would have to stay for."""
    task = cornered(5.0)
    preview, rate = preview_of(task), 0.5
    followed(preview, task, 0.89)
    falls = [preview.brake(task.path.duration - steps * rate * DT, DT, rate) for steps in (2.0, 0.5)]
    assert falls == pytest.approx([falls[0]] * 2, rel=1e-2)
    assert falls[0] > 0.0


@pytest.mark.parametrize("rate", [0.3, 1.0])
def test_the_fastest_fall_takes_one_joint_to_its_acceleration(rate: float) -> None:
    """Steps at σ and σ − x: velocities change by q″ (σ − x/2)² h − q′ x, of one joint by almost η a h."""
    task = cornered(5.0)
    preview = preview_of(task)
    clock = followed(preview, task, 0.15)
    slope, bend = preview.horizon.joints_at(clock)
    x = DT * preview.brake(clock, DT, rate)
    change = bend * (rate - 0.5 * x) ** 2 * DT - slope * x
    back = np.maximum(-change * np.sign(slope), 0.0) / (preview._plan.acceleration * DT)  # those that brake
    assert 0.98 < back.max() <= 1.0 + 1e-9


@pytest.mark.parametrize("rate", [0.3, 1.0])
def test_the_fastest_fall_leaves_room_for_the_bend(rate: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where q″σ² takes almost half of the acceleration, with the motion or against it; a joint that rests sets none."""
    preview = preview_of(cornered(5.0))
    most = preview._plan.acceleration
    for share in (0.45, -0.45):
        slope = np.linspace(-1.0, 1.0, len(most)) * (np.arange(len(most)) > 2)
        bend = share * most / rate**2 * np.sign(slope)
        monkeypatch.setattr(preview.horizon, "joints_at", lambda clock, known=(slope, bend): known)
        x = DT * preview.brake(0.15, DT, rate)
        change = bend * (rate - 0.5 * x) ** 2 * DT - slope * x
        back = np.maximum(-change * np.sign(slope), 0.0) / (most * DT)
        assert 0.98 < back.max() <= 1.0 + 1e-9


def test_a_rate_keeps_to_what_is_known_ahead_in_steps_of_any_length() -> None:
    """σ² ≤ K in the middle and at the end of every step, whatever the lengths of the steps before."""
    task = cornered(20.0)
    preview = preview_of(task)
    clock, slowed = 0.0, 0
    while clock < task.path.duration - 2.0 * DT:
        rates = []
        for dt in (0.1 * DT, DT, 0.5 * DT, DT):  # a short step first: what it says is free has to be so for a long one
            rate, _ = preview.cap(clock, dt)
            assert rate**2 <= preview.horizon.least(clock, rate, dt).square + 1e-12
            rates.append(rate)
        slowed += min(rates) < 1.0
        clock += max(rates[0], 0.01) * 0.1 * DT
    assert slowed > 100


def test_a_copy_knows_the_same_corners_and_goes_on_alike() -> None:
    """Also one that is taken while a knot is under way."""
    task = cornered(5.0)
    preview, clock, taken = preview_of(task), 0.0, 0
    preview.reset(task.q_start, 0.0)
    for step in range(400):
        if step % 20 == 7:
            other = preview_of(task)
            other.restore(copy.deepcopy(preview.memory()))
            at, fellow = clock, copy.deepcopy(preview.memory())
            for _ in range(60):
                cap = preview.cap(at, DT)
                assert other.cap(at, DT) == cap
                assert other.reaches_corner(at, 0.05) == preview.reaches_corner(at, 0.05)
                at += max(cap[0], 0.01) * DT
            preview.restore(fellow)
            taken += 1
        clock += max(preview.cap(clock, DT)[0], 0.01) * DT
    assert clock > 0.35  # past a corner
    assert taken == 20


@pytest.mark.slow
def test_a_copy_within_a_knot_knows_the_corners_that_were_found_before() -> None:
    """The path does not tell them. Each knot takes some Newton steps, and a copy is taken after each step."""
    task = replace(cornered(5.0), path=OnlyMarked(cornered(5.0).path))
    preview, taken = preview_of(task), 0
    preview.reset(task.q_start, 0.0)
    while preview.horizon.knots[-1].clock < 0.85:
        assert preview._growth.step()
        if preview._growth.done:
            other = preview_of(task)
            other.restore(copy.deepcopy(preview.memory()))
            np.testing.assert_equal(other.memory(), preview.memory())
            found = [preview.reaches_corner(clock, 0.1) for clock in (0.25, 0.55)]
            assert [other.reaches_corner(clock, 0.1) for clock in (0.25, 0.55)] == found
            taken += any(found)
    assert taken > 5


def test_corners_that_a_path_does_not_tell_are_found_where_they_are() -> None:
    """Also a slight one after a sharp one."""
    task = cornered(5.0)
    start = task.path.pose(0.0)
    places = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.05), (0.05, 0.0, 0.0), (0.1, 0.0, -0.055))
    poses = [pin.SE3(start.rotation, start.translation + np.array(p)) for p in places]
    path = WaypointPath(poses, durations=[0.3] * 3, time_law=TimeLaw.LINEAR)
    preview = preview_of(replace(task, path=OnlyMarked(path)))
    preview.reset(task.q_start, 0.0)
    while not preview.horizon.complete:
        assert preview._growth.step()
    corners = [knot.clock for knot in preview.horizon.knots if knot.corner]
    np.testing.assert_allclose(corners, [0.3, 0.6], rtol=0.0, atol=1e-10)


def test_a_jump_of_a_path_is_found_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    task = cornered(5.0)
    jumping = OnlyMarked(task.path)
    monkeypatch.setattr(
        jumping, "pose", lambda clock: pin.SE3(np.eye(3), np.full(3, 0.1 * (clock > 0.2037))) * task.path.pose(clock)
    )
    preview = preview_of(replace(task, path=jumping))
    preview.reset(task.q_start, 0.0)
    while not preview.horizon.complete:
        assert preview._growth.step()
    last = preview.horizon.knots[-1]
    assert 0.2037 - 2e-3 < last.clock < 0.2037
    assert last.binding is not None
    assert last.binding.kind is LimitKind.PATH_JUMP
    assert preview.jump == pytest.approx((0.2037, 0.1 * np.sqrt(3.0)), abs=2e-6)


def test_no_step_looks_far_ahead_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """K is found for four knots at a time. One is there before it is needed: three Newton steps at most at once."""
    task = paper_lift()
    preview = preview_of(task)
    newton_step, calls = preview._chain._newton_step, [0]

    def counted(clock: float, q: Array, **options: Any) -> Any:
        calls[0] += 1
        return newton_step(clock, q, **options)

    monkeypatch.setattr(preview._chain, "_newton_step", counted)
    most = 0
    for clock in np.arange(0.0, task.path.duration, DT).tolist():
        calls[0] = 0
        assert preview.cap(clock, DT) == (1.0, None)
        most = max(most, calls[0])
    assert 0 < most <= 3


def test_a_path_asked_for_faster_than_joints_follow_takes_no_more_knots() -> None:
    """Where σ² ≤ a / |q″| keeps the object slow, knots lie as far apart on the way however fast it is asked for."""
    task = paper_lift()
    start = task.path.pose(0.0)
    ends = [start, pin.SE3(start.rotation, start.translation + np.array([0.0, 0.05, 0.15]))]

    def knots(duration: float) -> int:
        path = WaypointPath(ends, durations=[duration], time_law=TimeLaw.LINEAR)
        preview = preview_of(replace(task, path=path, cell=task.cell.with_limits(acceleration=0.5)))
        preview.reset(task.q_start, 0.0)
        clock, known = 0.0, set()
        while clock < duration:
            clock += max(preview.cap(clock, DT)[0], 0.01) * DT
            known |= {knot.clock for knot in preview.horizon.knots}
        return len(known)

    slow = knots(0.2)
    assert slow > 10
    assert knots(0.1) <= slow + 1
    assert knots(0.05) <= slow + 1


@pytest.mark.parametrize("mark", [None, 0.7487])
def test_a_way_past_a_singularity_is_known_as_a_whole_or_not_at_all(mark: float | None) -> None:
    """Knots at which the joints only turn faster are no end. A mark on the way hides what comes after it: a stop."""
    task = at_singularity("wrist", 2, miss=5e-4, acceleration=10.0)
    at = [share * task.path.duration for share in (0.745, 0.7487, 0.7505)]
    preview = preview_of(replace(task, path=OnlyMarked(task.path, *at[1:2] if mark else ())))
    preview.reset(on_the_path(task, at[0]), at[0])
    knots = preview.horizon.knots
    while knots[-1].clock < at[2] and not preview.horizon.complete:
        assert preview._growth.step()
        before, last = list(knots)[-2:]
        singular = last.uncapped < preview.options.singular_rate**2
        assert not (singular and last.fastest > before.fastest) or preview.horizon.complete
    assert preview.horizon.complete == (mark is not None)
    if mark:
        assert knots[-1].clock < at[1]
        assert knots[-1].cap == 0.0
        assert knots[-1].binding is not None
        assert knots[-1].binding.kind is LimitKind.SINGULARITY


def test_where_the_path_fails_nothing_is_known_and_the_object_rests_until_it_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    path = OnlyMarked(task.path)
    preview = preview_of(replace(task, path=path))
    with monkeypatch.context() as failing:
        failing.setattr(path, "pose", lambda clock: None)
        preview.reset(task.q_start, 0.0)
        assert preview.cap(0.0, DT) == (0.0, None)
        assert "NoneType" in preview.trouble
        assert not preview.knows
        assert preview.rise(0.0) == (np.inf, None)
        q, slope = preview.reference(0.0)
        assert np.array_equal(q, task.q_start)
        assert not slope.any()
    for _ in range(10):  # a step looks ahead a little at a time
        cap = preview.cap(0.0, DT)
        assert preview.trouble == ""
        assert preview.knows
    assert cap == (1.0, None)


def test_a_twist_that_fails_ahead_is_told_and_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    path = OnlyMarked(task.path)
    preview = preview_of(replace(task, path=path))
    preview.reset(task.q_start, 0.0)
    known = preview.horizon.knots[-1].clock
    with monkeypatch.context() as failing:
        failing.setattr(path, "twist", lambda clock: None if clock > known + 0.05 else task.path.twist(clock))
        while preview._growth.step():
            pass
        assert "twist" in preview._growth.trouble
        assert not preview.horizon.complete
    while preview.horizon.knots[-1].clock < known + 0.2:
        assert preview._growth.step()


def test_a_mark_where_the_path_does_not_bend_costs_nothing() -> None:
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    task = replace(task, path=OnlyMarked(task.path, 0.4), cell=task.cell.with_limits(acceleration=5.0))
    preview = preview_of(task)
    followed(preview, task, 0.38)
    corner = next(knot for knot in preview.horizon.knots if knot.corner)
    assert corner.clock == pytest.approx(0.4, abs=1e-9)
    assert corner.cap == 1.0
    assert corner.binding is None


def test_a_look_ahead_that_begins_on_the_way_goes_on_from_there() -> None:
    """q′ of its first knot is that of its own clock."""
    task, clock, h = paper_lift(time_law=TimeLaw.QUINTIC), 0.8, 1e-5
    preview = preview_of(task)
    q = on_the_path(task, clock)
    preview.reset(q, clock)
    chain = Chain(task.cell, task.grasp)
    around = [newton(chain, task.path.pose(clock + x), q, tolerance=1e-14, max_iter=12)[0] for x in (-h, h)]
    slope = pin.difference(task.cell.model, *around) / (2.0 * h)
    np.testing.assert_allclose(preview.horizon.knots[0].slope, slope, rtol=0.0, atol=1e-7)


def test_a_corner_into_a_rest_is_passed_as_slowly_as_joints_can_stop() -> None:
    """σ² of the corner: within one step no joint changes its velocity q′σ by more than a dt."""
    task = paper_lift()
    start = task.path.pose(0.0)
    up = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 0.05]))
    path = WaypointPath([start, up, up], durations=[0.3, 0.3], time_law=TimeLaw.LINEAR)
    task = replace(task, path=path, cell=task.cell.with_limits(acceleration=5.0))
    preview = preview_of(task)
    followed(preview, task, 0.25)
    corner = next(knot for knot in preview.horizon.knots if knot.corner)
    assert corner.clock == pytest.approx(0.3, abs=1e-9)
    assert not corner.slope.any()
    q, chain, h = on_the_path(task, 0.3), Chain(task.cell, task.grasp), 1e-5
    before = newton(chain, path.pose(0.3 - h), q, tolerance=1e-14, max_iter=12)[0]
    slope = pin.difference(task.cell.model, before, q) / h
    assert corner.cap == pytest.approx(1.0 / float((np.abs(slope) / preview._plan.jump).max()) ** 2, rel=1e-3)
    assert 0.0 < corner.cap < 0.1


def test_nearly_every_knot_of_a_plan_takes_one_newton_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """The joints are expected as q′ and q″ go on. As q″ stood in the last interval it took two of nearly every knot."""
    task = paper_lift()
    cell = task.cell.with_limits(acceleration=5.0)
    planned = plan(cell, task.grasp, task.path, q_start=task.q_start).path
    controller = QPController(cell, task.grasp, planned, dt=DT, options=QPOptions(kernel="plain"))
    done = {"steps": 0, "knots": 0}
    for kind, name, key in ((ClosedChainAhead, "_newton_step", "steps"), (Horizon, "push", "knots")):
        own = getattr(kind, name)

        def counted(*arguments: Any, own: Any = own, key: str = key, **more: Any) -> Any:
            done[key] += 1
            return own(*arguments, **more)

        monkeypatch.setattr(kind, name, counted)
    controller.reset(task.q_start)
    for _ in range(200):
        controller.step()
    assert done["knots"] > 20
    assert done["steps"] < 1.3 * done["knots"]


def test_a_step_that_looks_no_further_than_it_needs_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """K only rises as more becomes known: where it admits all that a step may do, more changes nothing."""
    task = paper_lift()
    cell = task.cell.with_limits(acceleration=5.0)

    def run() -> tuple[Array, int]:
        controller = QPController(cell, task.grasp, task.path, dt=DT, options=QPOptions(kernel="plain"))
        controller.reset(task.q_start)
        q, known = [], 0
        for i in range(260):
            if i == 40:
                controller.set_override(0.3)
            if i == 100:
                controller.set_override(1.0)
            if i in (140, 146):
                (controller.pause, controller.resume)[i > 140]()
            if i >= 180 and i % 8 == 0:
                controller.jog([0.02, 0.01 * np.sin(0.1 * i), 0.03, 0.0, 0.0, 0.1])
            q.append(controller.step().q_next)
            known += len(controller._loop._preview.horizon.knots)
        return np.array(q), known

    own, few = run()
    monkeypatch.setattr(RateCap, "_most", lambda *_: np.inf)
    other, more = run()
    assert few < more
    assert np.abs(own - other).max() < 1e-12


@pytest.mark.parametrize("joint", [0, 7])
def test_the_joint_that_bends_most_is_named_with_the_rate_that_it_allows(joint: int) -> None:
    """z = a / q″, with q′ = 0 there; knots that come later change nothing of it, one at which the object stops does."""
    task = cornered(5.0)
    horizon, way = preview_of(task).horizon, np.eye(18)[joint]
    knot = horizon.knots[0]._replace(square=0.0, cause=None, share=None)
    most = 4.0 * PreviewOptions().margin * 5.0

    def put(numbers: range, cap: float = 1.0) -> None:
        for i in numbers:
            binding = task.cell.joint_limit(3, LimitKind.VELOCITY) if cap < 1.0 else None
            bends = {"slope": 0.1 * i * most * way, "curvature": most * way, "bending": 0.0 * way}
            horizon.push(knot._replace(clock=0.1 * i, span=0.1 * (i > 0), cap=cap, binding=binding, **bends))

    horizon.clear()
    put(range(4))
    horizon.look_back()
    first = horizon.knots[0]
    assert first.square == pytest.approx(0.25, rel=1e-6)
    assert first.cause == task.cell.joint_limit(joint, LimitKind.ACCELERATION)
    assert not first.stops
    assert not horizon.complete
    assert horizon.least(0.0, 0.0, 0.01).square == pytest.approx(0.25, rel=1e-6)
    assert horizon.knots[3].square == 0.0  # what is beyond is not known
    put(range(4, 5), cap=0.0)
    assert horizon.complete
    last = horizon.knots[4]
    assert (last.square, last.stops, last.cause) == (0.0, True, task.cell.joint_limit(3, LimitKind.VELOCITY))
    assert horizon.knots[3].cause == last.cause
    assert horizon.knots[3].stops
    horizon.leave_behind(0.25)
    assert [round(10.0 * k.clock) for k in horizon.knots] == [2, 3, 4]
    assert horizon.known == 3
    horizon.leave_behind(9.0)
    assert (len(horizon.knots), horizon.known) == (1, 1)


def test_the_horizon_is_free_up_to_the_last_knot_at_full_rate() -> None:
    horizon = preview_of(cornered(5.0)).horizon
    knot = horizon.knots[0]
    horizon.clear()
    for i, square in enumerate((1.0, 1.0, 1.0, 0.9, 1.0)):
        horizon.knots.append(knot._replace(clock=0.1 * i, square=square))
    assert horizon.free_until(0.01) == pytest.approx(0.19)
    horizon.knots[3] = knot._replace(clock=0.3, square=1.0)
    assert horizon.free_until(0.01) == pytest.approx(0.39)
    horizon.complete = True
    assert horizon.free_until(0.01) == np.inf


# -- paths that are too quick for their joints -------------------------------------------------------------------------


def time_along(task: Scenario, quickness: float, law: TimeLaw, kernel: str) -> float:
    """Time in which a path that is so many times quicker than the task's is finished [s]; NaN if it is not."""
    first, last, dt = task.path.pose(0.0), task.path.pose(task.path.duration), 0.005
    path = LinePath(first, last, duration=task.path.duration / quickness, time_law=law)
    controller = QPController(task.cell, task.grasp, path, dt=dt, options=QPOptions(kernel=kernel))
    controller.reset(task.q_start)
    for i in range(600):
        if controller.step().finished:
            return i * dt
    return np.nan


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
@pytest.mark.parametrize("law", slow_but_first([TimeLaw.QUINTIC, TimeLaw.LINEAR]))
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_a_path_too_quick_for_its_joints_is_followed_at_their_own_pace(
    acceleration: float, law: TimeLaw, kernel: str
) -> None:
    """How quick it is says nothing: far from singularities it was BLOCKED by one from a hundred times on."""
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    own = time_along(task, 30.0, law, kernel)
    assert own < 1.2
    for quickness in (300.0, 1e3, 1e4):
        assert time_along(task, quickness, law, kernel) == pytest.approx(own, abs=0.011)


@pytest.mark.parametrize("kind", ["elbow", "reach"])
def test_a_singularity_ends_a_path_that_is_too_quick_where_it_ends_a_slow_one(kind: str) -> None:
    task, ends = at_singularity(kind, acceleration=10.0), []
    for quickness in (1.0, 100.0, 1e4):
        path = LinePath(
            task.path.pose(0.0), task.path.pose(task.path.duration), duration=task.path.duration / quickness,
            time_law=TimeLaw.LINEAR,
        )  # fmt: skip
        controller = QPController(task.cell, task.grasp, path, dt=0.005)
        controller.reset(task.q_start)
        for _ in range(600):
            step = controller.step()
        assert step.status is Status.BLOCKED
        assert step.rate == 0.0
        assert {limit.kind for limit in step.binding} <= {LimitKind.SINGULARITY, LimitKind.REACH}
        ends.append(step.clock / path.duration)
    assert np.ptp(ends) < 1e-3
