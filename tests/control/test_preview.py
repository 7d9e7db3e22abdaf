"""The preview: its caps agree with brute-force path timing; stops at limits, corners, ends and singularities."""

from __future__ import annotations

import functools
import itertools
import os
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from runs import preview_of
from user_paths import Jumping, Opaque

from coopqp import (
    BindingLimit,
    HoldPath,
    InvalidInputError,
    LimitKind,
    LinePath,
    ObjectPath,
    PreviewOptions,
    QPController,
    QPOptions,
    ServoPath,
    Status,
    WaypointPath,
)
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.native import available_kernels
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, at_limit, at_singularity, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import chain_error, path_error, tool_placements
from coopqp.spatial import Array

pytestmark = pytest.mark.core

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"
DIRECTIONS = 40 if NIGHTLY else 6
DT = 0.002


class Joints:
    """q(τ) along a path by warm-started inverse kinematics of the chain."""

    def __init__(self, task: Scenario) -> None:
        self._task, self._chain, self._q = task, Chain(task.cell, task.grasp), task.q_start

    def at(self, clock: float) -> Array:
        q, errors = newton(self._chain, self._task.path.pose(clock), self._q, tolerance=1e-13, max_iter=12)
        assert np.abs(errors).max() < 1e-9
        self._q = q
        return self._task.cell.positions(q)

    def table(self, clocks: Array) -> Array:
        return np.array([self.at(float(c)) for c in clocks])


def driven(task: Scenario, *, longest: float) -> tuple[Array, Array, Any]:
    """Clocks and rates of an object that follows the caps, and the binding limit at the end.

    The rate rises slowly: the limits of a step bound the rise, not the preview.
    """
    preview = preview_of(task, rate_slope=1.0)
    clock, rate, binding = 0.0, 0.0, None
    clocks, rates = [0.0], []
    for _ in range(int(longest / DT)):
        cap, binding = preview.cap(clock, DT)
        rate = min(cap, rate + preview.options.rate_slope * DT) if preview.accelerates else cap
        rate = min(rate, (task.path.duration - clock) / DT)
        clock += rate * DT
        clocks.append(clock)
        rates.append(rate)
        if rate < 1e-9 or clock >= task.path.duration - 1e-12:
            break
    return np.array(clocks), np.array(rates), binding


# -- the caps ----------------------------------------------------------------------------------------------------------


@functools.cache
def dense_lift() -> tuple[Scenario, float, Array, Array]:
    """A lift, and its joints at clocks so far from each other [s]."""
    task, h = paper_lift(time_law=TimeLaw.QUINTIC, duration=1.5), 0.002
    clocks = np.arange(0.0, task.path.duration + h / 2, h)
    return task, h, clocks, Joints(task).table(clocks)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed", "acceleration"), [(0.4, 3.0), pytest.param(np.inf, 0.6, marks=pytest.mark.slow), (0.25, 20.0)]
)
def test_caps_are_those_of_path_timing_by_brute_force(speed: float, acceleration: float) -> None:
    """K(τ): the largest z = σ² from which an admissible σ̇ leads to K a little later, backwards over a table of q(τ)."""
    task, h, clocks, q = dense_lift()
    task = replace(task, cell=task.cell.with_limits(velocity=speed, acceleration=acceleration))
    slope = np.gradient(q, h, axis=0)
    slope[np.abs(slope) < 1e-12] = 1e-12
    bend = np.gradient(slope, h, axis=0)
    o = PreviewOptions()
    a, most = o.margin * acceleration, 0.9 * o.rate_slope
    cap = np.minimum(1.0, ((o.margin * speed / np.maximum(np.abs(slope), 1e-12)) ** 2).min(axis=1))
    K = cap.copy()
    for i in range(len(K) - 2, -1, -1):
        low, high = 0.0, float(cap[i])
        for z in (high, *[np.nan] * 40):
            z = 0.5 * (low + high) if np.isnan(z) else z
            ends = np.array([-a - bend[i] * z, a - bend[i] * z]) / slope[i]  # of σ̇
            down, up = ends.min(axis=0).max(), ends.max(axis=0).min()
            if max(down, -most) <= min(up, most, (K[i + 1] - z) / (2.0 * h)):
                low = z
            else:
                high = z
        K[i] = low
    assert K.min() < 0.7  # the limits matter
    preview = preview_of(task, cell=h, slope_step=0.01, newton_steps=1000)
    for clock in np.arange(0.0, 1.45, 0.0137):
        rate, binding = preview.cap(float(clock), 1e-9)
        # What is not known of q″ between knots costs a little.
        assert 0.92 < rate**2 / np.interp(clock, clocks, K) < 1.01
        assert (binding is None) == (rate == 1.0)


def test_an_easy_path_is_not_slowed() -> None:
    task = paper_lift()
    preview = preview_of(task)
    assert all(preview.cap(float(c), DT) == (1.0, None) for c in np.arange(0.0, task.path.duration, DT))


def test_the_horizon_rolls_along() -> None:
    """As long as the object needs to stop, and no longer: knots ahead stay few."""
    for acceleration in (np.inf, 5.0):
        task = paper_lift(time_law=TimeLaw.QUINTIC)
        task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
        preview = preview_of(task)
        ahead = []
        for clock in np.arange(0.0, 2.5, DT):
            preview.cap(float(clock), DT)
            ahead.append(preview.horizon.knots[-1].clock - clock)
        assert min(ahead) > 0.0
        assert max(ahead) < 1.2
        assert len(preview.horizon.knots) < 1500


@pytest.mark.slow
def test_many_passes_find_what_one_finds() -> None:
    """A knot keeps how K follows from the one ahead. A pass over the same knots that knows nothing agrees."""
    task = at_singularity("wrist", 0, acceleration=5.0, miss=2e-3)  # many small intervals
    preview, clock, compared = preview_of(task, newton_steps=5), 1.2, 0
    preview.reset(Joints(task).table(np.linspace(0.0, clock, 25))[-1], clock)
    horizon, anew = preview.horizon, preview_of(task).horizon
    for _ in range(100):
        clock += preview.cap(clock, DT)[0] * DT
        anew.restore(horizon.memory())
        for k in range(anew.known, len(anew.knots)):
            anew.knots[k] = anew.knots[k]._replace(share=None)
        before = np.array([knot.square for knot in horizon.knots])
        for look in (horizon, anew):
            look.look_back()
        found, expected = (np.array([knot.square for knot in look.knots]) for look in (horizon, anew))
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)
        assert (found >= before - 1e-15).all()  # K only rises
        compared += len(found) - horizon.known
    assert compared > 1000


def test_slopes_and_curvatures_between_knots() -> None:
    """q′ of the second degree over even knots: interpolated at the knots, and q″ exact at any clock but by a corner."""
    preview = preview_of(paper_lift())
    knot, horizon, h = preview.horizon.knots[0], preview.horizon, 0.01
    a, b, c = np.random.default_rng(2).normal(size=(3, 18))

    def slope(clock: float) -> Array:
        return a + b * clock + c * clock**2

    clocks = h * np.arange(7)
    for corner in (None, 3):
        horizon.clear()
        for i, clock in enumerate(clocks):
            mean = (slope(clock) - slope(clock - h)) / h
            horizon.knots.append(
                knot._replace(clock=clock, slope=slope(clock), curvature=mean, span=h, corner=i == corner)
            )
        for clock in np.linspace(h, 5.0 * h, 41):
            i = horizon.knot_before(clock)
            x = (clock - clocks[i]) / h
            found, bend = horizon.joints_at(clock)
            np.testing.assert_allclose(found, (1.0 - x) * slope(clocks[i]) + x * slope(clocks[i] + h), atol=1e-12)
            if i + (x >= 0.5) == corner:  # nothing from beyond it counts
                np.testing.assert_allclose(bend, b + 2.0 * c * (clocks[i] + 0.5 * h), atol=1e-9)
            else:
                np.testing.assert_allclose(bend, b + 2.0 * c * clock, atol=1e-9)
    found, bend = horizon.joints_at(1.0)  # beyond the last knot
    np.testing.assert_allclose(found, slope(clocks[-1]))
    np.testing.assert_allclose(bend, horizon.knots[-1].curvature)


# -- stops -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", slow_but_first(range(DIRECTIONS)))
def test_caps_lead_to_a_stop_exactly_at_the_limit(number: int) -> None:
    rng = np.random.default_rng(number)
    rotation = tuple(rng.normal(size=3) * (0.4 if number % 2 else 0.0))
    task = at_limit(direction=tuple(rng.normal(size=3)), rotation=rotation, margin=rng.uniform(0.1, 0.4, size=18))
    limits = task.cell.limits
    clocks, rates, binding = driven(task, longest=6.0)
    assert rates[-1] < 1e-6
    q = Joints(task).table(clocks)
    margin = np.minimum(q - limits.lower, limits.upper - q).min(axis=1)
    assert margin.min() > -1e-7
    assert margin[-1] < 1e-5
    assert binding.kind is LimitKind.POSITION
    j = int(np.minimum(q[-1] - limits.lower, limits.upper - q[-1]).argmin())
    assert f"{binding.arm}/{binding.joint}" == task.cell.joint_names[j]
    v = np.diff(q, axis=0) / DT
    change = np.abs(np.diff(np.vstack([np.zeros(18), v, np.zeros(18)]), axis=0)) / DT
    assert (change / limits.acceleration).max() < 1.0
    assert (np.abs(v) / limits.velocity).max() < 1.0


@pytest.mark.parametrize("dt", [0.002, 0.06, 0.1, 0.15])
def test_long_steps_lead_to_the_limit_too(dt: float) -> None:
    """Where arriving too fast is not admissible, a lower rate is: the object does not stop short of the limit."""
    task = at_limit()
    preview, clock, rates = preview_of(task, dt=dt), 0.0, [1.0]
    for _ in range(400):
        rates.append(preview.cap(clock, dt)[0])
        clock += rates[-1] * dt
    assert rates[-1] < 1e-6
    q, limits = Joints(task).at(clock), task.cell.limits
    assert -1e-7 < np.minimum(q - limits.lower, limits.upper - q).min() < 1e-5
    assert all(after > 0.0 for before, after in itertools.pairwise(rates) if before > 0.1)


def test_curvature_may_take_all_of_the_acceleration() -> None:
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(acceleration=1.0))
    preview, clock = preview_of(task, curvature_share=1.0), 0.0
    for _ in range(4000):
        clock += preview.cap(clock, DT)[0] * DT
    assert clock > 0.9 * task.path.duration


def test_without_acceleration_limits_too() -> None:
    task = at_limit(acceleration=np.inf)
    clocks, rates, binding = driven(task, longest=6.0)
    q = Joints(task).table(clocks)[-1]
    margin = np.minimum(q - task.cell.limits.lower, task.cell.limits.upper - q)
    assert rates[-1] < 1e-6
    assert -1e-7 < margin.min() < 1e-5
    assert binding.kind is LimitKind.POSITION


@pytest.mark.parametrize("acceleration", slow_but_first([np.inf, 5.0]))
@pytest.mark.parametrize("kind", ["elbow", "reach"])
def test_a_singularity_ends_the_path_and_is_named(kind: Any, acceleration: float) -> None:
    task = at_singularity(kind, 1, acceleration=acceleration)
    clocks, rates, binding = driven(task, longest=8.0)
    assert rates[-1] < 1e-6
    assert binding.kind in (LimitKind.SINGULARITY, LimitKind.REACH)
    assert binding.arm == "arm_2"
    assert binding.joint == ""
    Joints(task).table(clocks)  # asserts that the arms carry the object


@pytest.mark.parametrize("kind", ["elbow", "reach"])
def test_every_arm_keeps_away_from_the_end_of_its_reach_by_what_joints_cover_in_a_step(kind: Any) -> None:
    """Two of the three arms are far from theirs."""
    preview = preview_of(at_singularity(kind, 1, acceleration=10.0), dt=0.05)
    while not preview.horizon.complete:
        assert preview._growth.step()
    rooms = np.array([knot.steps_to_reach_end for knot in preview.horizon.knots])
    assert 1.0 < rooms.min() < 2.0
    assert (rooms[-1] > 10.0).sum() == 2
    assert preview.horizon.knots[-1].binding == BindingLimit("arm_2", "", LimitKind.REACH)


@pytest.mark.parametrize("kind", ["elbow", "reach"])
def test_the_way_back_from_the_end_of_a_reach_is_free(kind: Any) -> None:
    """Other arms come nearer to the ends of theirs meanwhile, from far away."""
    out = at_singularity(kind, 1, acceleration=10.0)
    preview = preview_of(out)
    while not preview.horizon.complete:
        assert preview._growth.step()
    last = preview.horizon.knots[-1]
    path = LinePath(out.path.pose(last.clock), out.path.pose(0.0), duration=1.0, time_law=TimeLaw.QUINTIC)
    preview = preview_of(replace(out, path=path, q_start=last.q), dt=0.05)
    while not preview.horizon.complete:
        assert preview._growth.step()
    rooms = np.array([knot.steps_to_reach_end for knot in preview.horizon.knots])
    assert rooms[0].min() < 1.0 < rooms[-1].min()
    assert (np.diff(rooms, axis=0).min(axis=0) < 0.0).any()
    assert preview.horizon.knots[-1].clock == path.duration


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_limits_the_object_stops_at_the_first(order: int) -> None:
    """Two joints would meet theirs between the same two knots."""
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    task = replace(task, cell=task.cell.with_limits(acceleration=5.0))
    preview, clock = preview_of(task), 0.0
    while clock < 0.8:
        clock += preview.cap(clock, DT)[0] * DT
    before, after = (knot.clock for knot in list(preview.horizon.knots)[:2])
    early, late = before + (after - before) * np.array([0.4, 0.6])
    q = Joints(task).table(np.array([early, late]))
    rising = np.flatnonzero((q[1] > q[0] + 1e-5) & (q[0] > 0.0))
    first, second = rising[[0, -1]][::order]
    assert first != second
    upper = task.cell.limits.upper.copy()
    upper[first], upper[second] = q[0, first], q[1, second]
    clocks, rates, binding = driven(replace(task, cell=task.cell.with_limits(upper=upper)), longest=6.0)
    assert rates[-1] < 1e-6
    assert clocks[-1] == pytest.approx(early, abs=1e-6)
    assert f"{binding.arm}/{binding.joint}" == task.cell.joint_names[first]


@pytest.mark.parametrize("by", slow_but_first([(0.1, 0.0, 0.0), (0.0, 0.5, 0.5)]))
def test_the_object_stops_ahead_of_a_jump(by: Any) -> None:
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    path = Jumping(task.path, 0.5 * task.path.duration, np.array(by))
    task = replace(task, path=path, cell=task.cell.with_limits(acceleration=5.0))
    clocks, rates, binding = driven(task, longest=8.0)
    assert rates[-1] < 1e-6
    assert 0.49 < clocks[-1] / path.duration < 0.5
    assert binding.kind is LimitKind.PATH_JUMP
    v = np.diff(Joints(task).table(clocks), axis=0) / DT
    change = np.abs(np.diff(np.vstack([np.zeros(18), v, np.zeros(18)]), axis=0)) / DT
    assert (change / 5.0).max() < 1.0


def test_a_path_that_starts_out_of_reach() -> None:
    task = paper_lift()
    start = task.path.pose(0.0)
    far = pin.SE3(start.rotation, start.translation + np.array([3.0, 0.0, 0.0]))
    preview = preview_of(replace(task, path=LinePath(far, start, duration=1.0)))
    rate, binding = preview.cap(0.0, DT)
    assert rate == 0.0
    assert binding is not None
    assert binding.kind is LimitKind.REACH
    assert binding.arm in task.cell.arm_names


# -- corners, ends, standstill -----------------------------------------------------------------------------------------


def zigzag(start: pin.SE3) -> WaypointPath:
    shifts = ((0.0, 0.0, 0.0), (0.06, 0.0, 0.05), (0.0, 0.05, 0.0), (-0.05, 0.0, 0.05))
    poses = [pin.SE3(start.rotation, start.translation + np.array(s)) for s in shifts]
    return WaypointPath(poses, durations=[0.3, 0.3, 0.3], time_law=TimeLaw.LINEAR)


@pytest.mark.slow
def test_corners_are_taken_at_a_speed_that_the_joints_can_jump() -> None:
    task = paper_lift()
    path = zigzag(task.path.pose(0.0))
    task = replace(task, path=path, cell=task.cell.with_limits(acceleration=5.0))
    clocks, rates, _ = driven(task, longest=8.0)
    assert clocks[-1] == pytest.approx(path.duration)
    v = np.diff(Joints(task).table(clocks), axis=0) / DT
    change = np.abs(np.diff(np.vstack([np.zeros(18), v, np.zeros(18)]), axis=0)) / DT
    assert (change / 5.0).max() < 1.0
    for corner in (0.3, 0.6):
        assert rates[np.abs(clocks[:-1] - corner).argmin()] < 0.05
    assert rates.max() > 0.3


def test_a_corner_is_taken_no_faster_than_the_joints_may_go_on() -> None:
    """From a line into one that is faster than a joint: the corner's cap is by that joint, and named after it."""
    task = paper_lift()
    start = task.path.pose(0.0)
    poses = [pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, z])) for z in (0.0, 0.01, 0.2)]
    path = WaypointPath(poses, durations=[0.3, 0.3], time_law=TimeLaw.LINEAR)
    task = replace(task, path=path, cell=task.cell.with_limits(velocity=0.4, acceleration=1e4))
    preview, clock = preview_of(task), 0.0
    corner = None
    while corner is None:
        clock += preview.cap(clock, DT)[0] * DT
        corner = next((knot for knot in preview.horizon.knots if knot.corner), None)
    q = Joints(task).table(np.array([0.3, 0.3 + 1e-5]))
    use = np.abs(np.diff(q, axis=0)[0]) / 1e-5 / (preview.options.margin * 0.4)
    assert use.max() > 1.2
    assert corner.cap == pytest.approx(1.0 / use.max() ** 2, rel=1e-3)
    assert corner.binding is not None
    assert corner.binding.kind is LimitKind.VELOCITY
    assert f"{corner.binding.arm}/{corner.binding.joint}" == task.cell.joint_names[int(use.argmax())]


def test_an_end_with_velocity_is_reached_slowly_enough_to_stop() -> None:
    task = paper_lift(duration=1.0)
    task = replace(task, cell=task.cell.with_limits(acceleration=5.0))
    clocks, rates, binding = driven(task, longest=8.0)
    assert clocks[-1] == pytest.approx(1.0)
    v = np.diff(Joints(task).table(clocks), axis=0) / DT
    change = np.abs(np.diff(np.vstack([v, np.zeros(18)]), axis=0)) / DT
    assert (change / 5.0).max() < 1.0
    assert rates.max() > 0.9
    assert binding is not None
    assert binding.kind is LimitKind.PATH_END


def test_an_object_that_rests_has_no_cap() -> None:
    task = paper_lift()
    task = replace(task, path=HoldPath(task.path.pose(0.0), duration=0.5), cell=task.cell.with_limits(acceleration=5.0))
    preview = preview_of(task)
    assert all(preview.cap(float(c), DT)[0] == 1.0 for c in np.arange(0.0, 0.5, DT))


# -- the reference of redundant arms -----------------------------------------------------------------------------------


def test_the_reference_is_on_the_path() -> None:
    for task in (paper_lift(), mixed_cell(), dual_arm7()):
        preview, chain = preview_of(task), Chain(task.cell, task.grasp)
        for clock in np.arange(0.0, 1.0, 0.0137):
            preview.cap(float(clock), DT)
            q, slope = preview.reference(float(clock))
            errors = chain.errors(chain.carried(q), task.path.pose(float(clock)))
            assert np.abs(errors).max() < 1e-6
            pose = task.path.pose(float(clock))
            chain.linearise(q, about=pose.translation)
            made = (chain.twists(slope).reshape(-1, 2, 3) @ pose.rotation).reshape(-1, 6)
            assert np.abs(made - task.path.twist(float(clock))).max() < 1e-3


@pytest.mark.parametrize("joint", [0, 2, 4, 6, 7, 9, 13])
def test_redundant_arms_use_their_freedom_at_limits(joint: int) -> None:
    """A limit that least norm would meet half way: the arm moves past it, on its path and inside all limits."""
    task = dual_arm7(duration=1.5)
    wanted = run_through(task)[:, joint] - task.q_start[joint]
    lower, upper = task.cell.limits.lower.copy(), task.cell.limits.upper.copy()
    half_way = 0.5 * float(wanted[np.abs(wanted).argmax()])
    side = upper if half_way > 0.0 else lower
    side[joint] = task.q_start[joint] + half_way
    cell = task.cell.with_limits(lower=lower, upper=upper, acceleration=10.0)
    x = run_through(replace(task, cell=cell))
    assert (x <= cell.limits.upper + 1e-9).all()
    assert (x >= cell.limits.lower - 1e-9).all()
    O = Chain(cell, task.grasp)
    assert np.abs(O.errors(O.carried(x[-1]), task.path.pose(task.path.duration))).max() < 1e-6


def run_through(task: Scenario) -> Array:
    """Positions (T, nv) of a run that is finished."""
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished:
        steps.append(controller.step())
        assert len(steps) < 2000, steps[-1].explain()
    return np.array([s.q_next for s in steps])


# -- in the controller -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
def test_an_object_that_stops_for_good_is_blocked_a_little_before(kernel: Any) -> None:
    """From ten times the blocked rate on; until then it is slowed."""
    task = at_limit()
    options = QPOptions(kernel=kernel)
    controller = QPController(task.cell, task.grasp, task.path, dt=DT, options=options)
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(1500)]
    first = next(i for i, step in enumerate(steps) if step.status is Status.BLOCKED)
    assert steps[first].rate < 10.0 * options.blocked_rate <= steps[first - 1].rate
    assert {step.status for step in steps[first:]} == {Status.BLOCKED}


def test_what_the_preview_is_for() -> None:
    """Under acceleration limits and without preview, the object leaves its path at a corner. The chain holds."""
    task = paper_lift()
    cell, path = task.cell.with_limits(acceleration=5.0), zigzag(task.path.pose(0.0))
    off_path = {}
    for preview in (PreviewOptions(), None):
        controller = QPController(cell, task.grasp, path, dt=DT, options=QPOptions(preview=preview))
        controller.reset(task.q_start)
        steps = [controller.step() for _ in range(600)]
        tools = tool_placements(cell, [s.q_next for s in steps])
        assert max(chain_error(T, task.grasp)[0] for T in tools) < 1e-6
        off_path[preview is None] = max(
            path_error(T, task.grasp, path, s.clock_next)[0] for T, s in zip(tools, steps, strict=True)
        )
    assert off_path[False] < 1e-6
    assert off_path[True] > 1e-3


def test_at_a_velocity_limit_the_rate_does_not_chatter() -> None:
    """One joint's speed slows most of the path. The rate changes direction only if the path requires it."""
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(velocity=0.35, acceleration=5.0))
    controller = QPController(task.cell, task.grasp, task.path, dt=DT)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished:
        steps.append(controller.step())
    rates = np.array([s.rate for s in steps])
    slowed = rates < 0.999
    assert slowed.mean() > 0.5
    change = np.diff(rates)[np.abs(np.diff(rates)) > 1e-4]
    assert (np.sign(change[1:]) != np.sign(change[:-1])).sum() <= 4
    acceleration = np.diff([s.velocity for s in steps], axis=0) / DT
    assert np.sqrt((acceleration**2).mean()) < 0.4  # of 5 rad/s²; 0.7 with chatter


@pytest.mark.parametrize("acceleration", [5.0, np.inf])
def test_the_object_keeps_its_path_at_corners(acceleration: float) -> None:
    task = paper_lift()
    cell, path = task.cell.with_limits(acceleration=acceleration), zigzag(task.path.pose(0.0))
    controller = QPController(cell, task.grasp, path, dt=DT)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < 3000:
        steps.append(controller.step())
    assert steps[-1].finished
    assert all(s.given_up.off_path == (0.0,) * 6 for s in steps)
    for tools, s in zip(tool_placements(cell, [s.q_next for s in steps]), steps, strict=True):
        assert path_error(tools, task.grasp, path, s.clock_next)[0] < 3e-6


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
def test_an_object_that_almost_stops_at_a_corner_can_go_on(kernel: Any) -> None:
    """Where joints take a corner at less than 1e-3 of the rate."""
    task = paper_lift()
    start = task.path.pose(0.0)
    poses = [
        pin.SE3(start.rotation, start.translation + np.array(way)) for way in ([0, 0, 0], [0.01, 0, 0], [0, 0, 0.01])
    ]
    path = WaypointPath(poses, durations=[0.03, 0.03], time_law="linear")
    cell = task.cell.with_limits(acceleration=0.2)
    controller = QPController(cell, task.grasp, path, dt=0.0005, options=QPOptions(kernel=kernel))
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < 5000:
        steps.append(controller.step())
    assert steps[-1].finished
    assert min(s.rate for s in steps[20:]) < 1e-3
    assert {s.status for s in steps} <= {Status.SLOWED, Status.TRACKING}


class Fold(ObjectPath):
    """Out on a straight line and back on another, at full speed over the corner; it may not tell the corner."""

    def __init__(self, start: pin.SE3, angle: float, *, says: bool) -> None:
        self.duration, self._start, self._says = 1.3, start, says
        end = pin.SE3(start.rotation, start.translation + np.array([0.2, 0.0, 0.0]))
        self._law = WaypointPath([start, end], durations=[1.3])
        self._ways = np.array([[0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]])

    def pose(self, clock: float) -> pin.SE3:
        far = self._law.pose(clock).translation[0] - self._start.translation[0]
        way = min(far, 0.08) * self._ways[0] + max(far - 0.08, 0.0) * self._ways[1]
        return pin.SE3(self._start.rotation, self._start.translation + way)

    def twist(self, clock: float) -> Array:
        far = self._law.pose(clock).translation[0] - self._start.translation[0]
        speed = (self._start.rotation @ self._law.twist(clock)[:3])[0]
        return np.append(self._start.rotation.T @ self._ways[int(far >= 0.08)] * speed, np.zeros(3))

    def next_breakpoint(self, clock: float) -> float:
        if not self._says:
            return self.duration
        low, high = 0.0, self.duration  # clock of the corner
        for _ in range(60):
            middle = 0.5 * (low + high)
            far = self._law.pose(middle).translation[0] - self._start.translation[0]
            low, high = (middle, high) if far < 0.08 else (low, middle)
        return high if clock < high else self.duration


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
@pytest.mark.parametrize("angle", [0.2, 3.0])
def test_a_corner_that_a_users_path_does_not_tell_is_taken_like_a_told_one(angle: float, kernel: Any) -> None:
    """An almost reversed one stopped the object for good, and was called an end of the reach."""
    task, times = paper_lift(), []
    cell = task.cell.with_limits(acceleration=5.0)
    for says in (True, False):
        path = Fold(task.path.pose(0.0), angle, says=says)
        controller = QPController(cell, task.grasp, path, dt=0.004, options=QPOptions(kernel=kernel))
        controller.reset(task.q_start)
        steps = [controller.step()]
        while not steps[-1].finished and len(steps) < 600:
            steps.append(controller.step())
        times.append(len(steps))
        assert steps[-1].finished
        assert {b.kind for s in steps for b in s.binding} <= {LimitKind.ACCELERATION, LimitKind.VELOCITY}
        for tools, s in zip(tool_placements(cell, [s.q_next for s in steps]), steps, strict=True):
            assert path_error(tools, task.grasp, path, s.clock_next)[0] < 3e-7
    assert abs(times[1] - times[0]) <= 1


class Looked:
    """A bound on the rate that bounds nothing, and keeps the clocks that it is asked for."""

    name = "looked"

    def __init__(self) -> None:
        self.clocks: list[float] = []

    def lines(self, knot: Any) -> tuple[Array, Array, Array]:
        self.clocks.append(knot.clock)
        return np.zeros(0), np.zeros(0), np.zeros(0)


@pytest.mark.parametrize("kernel", available_kernels())
def test_paths_that_are_not_known_ahead_have_no_preview(kernel: str) -> None:
    task = paper_lift()
    start = task.path.pose(0.0)
    paths: list[tuple[ObjectPath, bool]] = [
        (Opaque(task.path, known_ahead=False), False),
        (ServoPath(start), True),
        (task.path, True),
    ]
    for path, known in paths:
        looked = Looked()
        controller = QPController(
            task.cell, task.grasp, path, dt=DT, options=QPOptions(kernel=kernel), constraints=[looked]
        )
        controller.reset(task.q_start)
        steps = [controller.step() for _ in range(20)]
        assert any(clock > 0.0 for clock in looked.clocks) is known
        if known:
            assert max(looked.clocks) > steps[-1].clock_next + 20 * DT
    controller = QPController(
        task.cell, task.grasp, task.path, dt=DT, options=QPOptions(kernel=kernel, preview=None), constraints=[looked]
    )
    controller.reset(task.q_start)
    looked.clocks.clear()  # reset asks once, to see whether it answers
    controller.step()
    assert not looked.clocks


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell", 0.0),
        ("cell", "long"),
        ("joint_step", -1.0),
        ("shortest", np.nan),
        ("rate_slope", np.inf),
        ("margin", 1.5),
        ("curvature_share", 0.0),
        ("singular_rate", 2.0),
        ("newton_steps", 0),
    ],
)
def test_bad_options(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"PreviewOptions: {name}"):
        PreviewOptions(**{name: value})
