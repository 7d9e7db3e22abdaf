"""Timing before the motion: against an independent linear program, under every limit, and as a controller runs it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import limited

from coopqp import (
    HoldPath,
    InvalidInputError,
    LimitKind,
    LinePath,
    ObjectPath,
    QPController,
    QPOptions,
    ServoPath,
    Status,
    TimedPath,
    WaypointPath,
)
from coopqp.errors import UnreachableError
from coopqp.model import CellState
from coopqp.paths import PathGeometry, SpeedProfile
from coopqp.paths.geometry import blended, piece_of
from coopqp.planning import Payload, time_path
from coopqp.planning.jerk import jerk_limited
from coopqp.planning.knots import Knots, follow
from coopqp.planning.parametrise import Limited, Lines, fastest, outermost
from coopqp.planning.payload import torque_lines
from coopqp.planning.timing import limits_along
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift, ring

UM = 1e-6


def plan_of(scenario: Scenario, **options: Any) -> TimedPath:
    return time_path(scenario.cell, scenario.grasp, scenario.path, q_start=scenario.q_start, **options)


@pytest.mark.parametrize("length", [1e-4, 2e-3, 6e-3])
def test_short_lines_have_plans_that_are_those_of_long_ones(length: float) -> None:
    """At accelerations alone a line of a share of the length takes its square root of the time, twice as long each."""
    task = limited(dual_arm7(), 10.0)
    cell = task.cell.with_limits(velocity=100.0)
    T = task.path.pose(0.0)
    times = [
        time_path(
            cell, task.grasp, LinePath.displaced(T, translation=(0.0, 0.0, way), duration=1.0), q_start=task.q_start
        ).duration
        for way in (length, 0.25 * length)
    ]
    assert times[0] / times[1] == pytest.approx(2.0, rel=2e-2)


def test_a_polyline_of_many_short_lines_has_a_plan(rng: Any) -> None:
    task = limited(paper_lift(), 5.0)
    poses = [task.path.pose(0.0)]
    for length in 10.0 ** rng.uniform(-5.0, -3.0, 12):
        way = rng.normal(size=3)
        poses.append(pin.SE3(poses[0].rotation, poses[-1].translation + length * way / np.linalg.norm(way)))
    path = time_path(
        task.cell, task.grasp, WaypointPath(poses, durations=[1.0] * 12), q_start=task.q_start, knots=60
    )  # fmt: skip
    assert 0.0 < path.duration < 1.0
    assert path.profile.use.max() < 1.01


# -- lines that never bind ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("m", [1, 4, 60])
def test_lines_that_are_left_out_never_bind(m: int, rng: Any) -> None:
    """What the others leave free is free of them: at the ends of rays from rest in all directions, at every knot."""
    a, b = rng.normal(size=(2, 20, m)) * rng.uniform(0.01, 100.0, (2, 20, 1))
    a[3], b[4], a[:, m // 2] = 0.0, 0.0, b[:, m // 2]
    kept = outermost(a, b)
    assert m < 20 or len(kept) < m
    angle = rng.uniform(0.0, np.pi, 400)
    x, y = np.cos(angle)[:, None], np.sin(angle)[:, None]
    for i in range(20):
        ray = x * a[i] / max(np.abs(a[i]).max(), 1e-9) + y * b[i] / max(np.abs(b[i]).max(), 1e-9)
        reach = np.abs(ray)
        np.testing.assert_allclose(reach[:, kept].max(axis=1), reach.max(axis=1), rtol=1e-9, atol=1e-9)


# -- the optimum -----------------------------------------------------------------------------------------------------


def optimum(along: Limited) -> np.ndarray:
    """The largest ṡ² at every knot by one linear program over all of them, solved by HiGHS.

    Feasible profiles are closed under the maximum of two, so the largest sum is the largest everywhere.
    """
    from scipy.optimize import linprog
    from scipy.sparse import coo_matrix

    s = along.knots.s
    h, K = np.diff(s), len(s)
    rows, columns, values, right, count = [], [], [], [], 0
    for lines in (along.acceleration, along.torque):
        if lines is None:
            continue
        m = len(lines.bound)
        for i in range(K - 1):
            for end in (i, i + 1):
                own = np.zeros((2, m))  # coefficients of ṡ² at i and i + 1; s̈ = (z[i+1] − z[i]) / 2h
                own[0], own[1] = -lines.a[end] / (2.0 * h[i]), lines.a[end] / (2.0 * h[i])
                own[end - i] += lines.b[end]
                for sign in (1.0, -1.0):
                    for side in (0, 1):
                        rows.append(np.arange(count, count + m))
                        columns.append(np.full(m, i + side))
                        values.append(sign * own[side] / lines.bound)
                    right.append(1.0 - sign * lines.c[end] / lines.bound)
                    count += m
    A = coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(count, K))
    top = along.square_bound()
    top[0] = top[-1] = 0.0
    tight = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    found = linprog(
        -np.ones(K), A_ub=A.tocsr(), b_ub=np.concatenate(right), bounds=list(zip(np.zeros(K), top, strict=True)),
        method="highs", options=tight,
    )  # fmt: skip
    assert found.status == 0
    return np.maximum(found.x, 0.0)


def duration(s: np.ndarray, squares: np.ndarray) -> float:
    return SpeedProfile(s, squares).duration


def stretch_of(scenario: Scenario, count: int, payload: Payload | None = None) -> Limited:
    geometry = scenario.path.geometry()
    assert geometry is not None
    cell, grasp = scenario.cell, scenario.grasp
    knots = follow(cell, grasp, geometry, cell.positions(scenario.q_start), count=count)
    return limits_along(cell, grasp, knots, payload=payload)


@pytest.mark.parametrize("build", [dual_arm7, mixed_cell, paper_lift])
@pytest.mark.parametrize("mass", [None, 4.0])
def test_the_profile_is_that_of_a_linear_program(build: Any, mass: float | None) -> None:
    scenario = limited(build(), 3.0)
    # Arms without torque limits in their models get some, so that they bind.
    torque = None if mass is None else Payload(mass=mass, torque=1e9)
    if mass is not None:
        c = stretch_of(scenario, 20, torque).torque
        assert c is not None
        torque = Payload(mass=mass, torque=1.15 * np.abs(c.c).max(axis=0).max())
    along = stretch_of(scenario, 120, torque)
    mine, best = fastest(along), optimum(along)
    assert duration(along.knots.s, mine) == pytest.approx(duration(along.knots.s, best), rel=1e-6)


def test_torques_are_those_of_inverse_dynamics_along_the_motion() -> None:
    scenario = dual_arm7()
    cell, grasp = scenario.cell, scenario.grasp
    payload = Payload(mass=3.0, centre=(0.1, 0.0, 0.05), inertia=0.02 * np.eye(3))
    along = stretch_of(scenario, 12, payload)
    a, b, c = torque_lines(cell, grasp, payload, along.knots)
    loaded = cell.model.copy()
    half = pin.Inertia(1.5, np.array([0.1, 0.0, 0.05]), 0.01 * np.eye(3))
    for joint, T, X in zip(cell.tool_joints, cell.T_joint_tool, grasp.T_object_tool, strict=True):
        loaded.inertias[joint] = loaded.inertias[joint] + (T * X.inverse()).act(half)
    data = loaded.createData()
    speed, slope = 0.7, -0.4
    knots = along.knots
    for i in range(len(knots.s)):
        v, acc = knots.slope[i] * speed, knots.slope[i] * slope + knots.curvature[i] * speed**2
        expected = pin.rnea(loaded, data, cell.configuration(knots.q[i]), v, acc)
        np.testing.assert_allclose(a[i] * slope + b[i] * speed**2 + c[i], expected, atol=1e-9)
    # Both arms together hold the whole object against gravity.
    empty = cell.model.createData()
    q = cell.configuration(knots.q[0])
    extra = c[0] - pin.rnea(cell.model, empty, q, np.zeros(cell.nv), np.zeros(cell.nv))
    state = CellState(cell, q)
    lift = np.zeros(cell.nv)
    O = scenario.path.pose(0.0)
    for k, own in enumerate(cell.v_slices):
        point = O.act(np.array([0.1, 0.0, 0.05])) - state.T_world_tool[k].translation
        J = state.jacobian(k, pin.LOCAL_WORLD_ALIGNED)
        force = np.array([0.0, 0.0, 1.5 * 9.81])
        lift[own] = J.T @ np.concatenate([force, np.cross(point, force)])
    np.testing.assert_allclose(extra, lift, atol=1e-9)


def rounded(scenario: Scenario, count: int, size: float) -> PathGeometry:
    """Straight lines near the start of a scenario's path, their corners rounded off."""
    rng, start = np.random.default_rng(3), scenario.path.pose(0.0)
    way = [start]
    for _ in range(count):
        turn, step = rng.uniform(-0.15, 0.15, 3), rng.uniform(-0.08, 0.08, 3)
        way.append(pin.SE3(start.rotation @ pin.exp3(turn), start.translation + step))
    path = WaypointPath(way, durations=[1.0] * count)
    return blended([s for x in path.segments if (s := x.straight())], distance=size, angle=size / 0.3)


@pytest.mark.parametrize(
    ("build", "knots", "corners", "excess"),
    [(dual_arm7, 400, 0, 1e-4), (mixed_cell, 400, 0, 1e-4), (dual_arm7, 60, 4, 3e-3)],
)
def test_no_limit_is_broken_between_knots(build: Any, knots: int, corners: int, excess: float) -> None:
    """Joint velocities and accelerations of the path on a grid of its own; sparse knots get company."""
    scenario = limited(build(), 5.0)
    cell = scenario.cell if not corners else scenario.cell.with_limits(velocity=0.3)
    way = rounded(scenario, corners, 0.01) if corners else scenario.path
    path = time_path(cell, scenario.grasp, way, q_start=scenario.q_start, knots=knots)
    assert path.planned_share == 0.98
    geometry = path.geometry()
    fine = follow(cell, scenario.grasp, geometry, cell.positions(scenario.q_start), count=1500)
    for i in range(1, len(fine.s) - 1):
        _, speed, slope = path.at(path.clocks(fine.s[i : i + 1])[0])
        assert np.abs(fine.slope[i] * speed).max() <= cell.limits.velocity.max()
        assert (np.abs(fine.slope[i] * speed) / cell.limits.velocity).max() <= 0.98 + excess
        acceleration = fine.slope[i] * slope + fine.curvature[i] * speed**2
        assert (np.abs(acceleration) / cell.limits.acceleration).max() <= 0.98 + excess


def one_joint(length: float, *, v: float, a: float, count: int = 150) -> Limited:
    """A joint that moves as the object does."""
    x = np.linspace(0.0, 1.0, count)
    s = length * x**3 * (10.0 + x * (6.0 * x - 15.0))
    one = np.ones((count, 1))
    knots = Knots(s, s[:, None], one, 0.0 * one)
    return Limited(knots, np.array([v]), Lines(one, 0.0 * one, 0.0 * one, np.array([a]), np.array([0])))


@pytest.mark.parametrize(
    ("v", "a", "jerk", "expected"),
    [
        (1e3, 1e3, 32.0, 1.0),  # by jerk alone: T = ∛(32 L/J)
        (1.0, 4.0, 40.0, 1.0 + 1.0 / 4.0 + 4.0 / 40.0),  # by all three: L/v + v/a + a/J
        (1.0, 4.0, 1e9, 1.0 + 1.0 / 4.0),
    ],
)
def test_jerk_limits_give_the_times_of_textbooks(v: float, a: float, jerk: float, expected: float) -> None:
    along = one_joint(1.0, v=v, a=a)
    squares = jerk_limited(along, fastest(along), np.array([jerk]))
    assert duration(along.knots.s, squares) == pytest.approx(expected, rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "jerk", "used"), [(lambda: ring(arms=2), 50.0, 0.95), (paper_lift, 5.0, 0.8), (dual_arm7, 50.0, 0.9)]
)
def test_joints_keep_their_jerk_limits_in_a_controller(make: Any, jerk: float, used: float) -> None:
    scenario, dt = limited(make(), 5.0), 0.002
    path = plan_of(scenario, jerk=jerk)
    assert path.duration > 1.1 * plan_of(scenario).duration
    assert LimitKind.JERK in {b.kind for b in path.profile.binding if b}
    assert path.profile.use is not None
    assert np.quantile(path.profile.use, 0.1) > used
    assert path.profile.use.max() <= 1.0 + 1e-6
    steps, chain, _ = run(scenario, path, dt=dt)
    assert {s.status for s in steps} == {Status.TRACKING}
    assert chain < UM
    v = np.array([np.zeros(scenario.cell.nv), *(s.velocity for s in steps), np.zeros(scenario.cell.nv)])
    w = 5  # 10 ms, as the limit is meant
    a = (v[w:] - v[:-w]) / (w * dt)
    assert np.abs(a[w:] - a[:-w]).max() / (w * dt) <= jerk
    for bad in (0.0, [1.0, 2.0], "fast"):
        with pytest.raises(InvalidInputError, match="jerk"):
            plan_of(scenario, jerk=bad)


def test_the_profile_names_what_binds() -> None:
    scenario = limited(dual_arm7(), 5.0)
    profile = plan_of(scenario).profile
    assert len(profile.binding) == len(profile.s) - 1
    assert {b.kind for b in profile.binding if b} <= {LimitKind.VELOCITY, LimitKind.ACCELERATION}
    assert profile.use is not None
    # Time-optimal: one limit is used up everywhere.
    assert np.quantile(profile.use, 0.02) > 0.98
    assert profile.use.max() <= 1.0 + 1e-6
    slow = limited(replace(scenario, cell=scenario.cell.with_limits(velocity=0.2)), 50.0)
    assert LimitKind.VELOCITY in {b.kind for b in plan_of(slow).profile.binding if b}


def test_of_arms_that_move_alike_the_first_is_named() -> None:
    """On a straight lift in the middle of a ring the limits of all arms are used alike, up to rounding."""
    scenario = ring(arms=4)
    path = LinePath.displaced(scenario.path.pose(0.0), translation=(0.0, 0.0, 0.2), duration=1.0)
    acceleration = np.full(scenario.cell.nv, 5.0)
    acceleration[scenario.cell.v_slices[0]] *= 1.0 + 1e-12
    cell = scenario.cell.with_limits(acceleration=acceleration)
    profile = plan_of(replace(scenario, cell=cell, path=path)).profile
    assert {b.arm for b in profile.binding if b} == {"arm_1"}


# -- the path --------------------------------------------------------------------------------------------------------


def test_poses_twists_and_clocks_belong_together() -> None:
    path = plan_of(limited(dual_arm7(), 5.0))
    assert not path.twist(0.0).any()
    assert not path.twist(path.duration).any()
    h = 1e-6
    for clock in np.random.default_rng(0).uniform(10 * h, path.duration - 10 * h, 40):
        change = pin.log6(path.pose(clock - h).actInv(path.pose(clock + h))).vector / (2.0 * h)
        np.testing.assert_allclose(path.twist(clock), change, atol=1e-5)
        s, _, _ = path.at(clock)
        assert path.clocks(np.array([s]))[0] == pytest.approx(clock, abs=1e-9)
    np.testing.assert_array_equal(path.pose(-1.0).homogeneous, path.pose(0.0).homogeneous)
    np.testing.assert_array_equal(path.pose(path.duration + 1.0).homogeneous, path.pose(path.duration).homogeneous)
    with pytest.raises(InvalidInputError, match="NaN"):
        path.pose(float("nan"))


def test_a_path_is_made_again_from_its_numbers() -> None:
    scenario = limited(dual_arm7(), 5.0)
    end = scenario.path.pose(scenario.path.duration)
    corner = WaypointPath([scenario.path.pose(0.0), end, scenario.path.pose(1.0)], durations=[1.0, 1.0])
    geometry = blended([s for x in corner.segments if (s := x.straight())], distance=0.02, angle=0.1)
    path = time_path(scenario.cell, scenario.grasp, geometry, q_start=scenario.q_start, knots=80)
    record = path.record()
    again = TimedPath.of_record(record)
    assert again.record() == record
    assert again.planned_share == path.planned_share
    assert again.duration == path.duration
    assert again.profile.binding == path.profile.binding
    for clock in np.linspace(0.0, path.duration, 30):
        np.testing.assert_array_equal(again.pose(clock).homogeneous, path.pose(clock).homogeneous)
        np.testing.assert_array_equal(again.twist(clock), path.twist(clock))
    for bad in (
        {},
        {**record, "squares": [0.0]},
        {**record, "pieces": [[1.0]]},
        {**record, "s": "abc"},
        {**record, "binding": [{"from_s": 0.0, "to_s": 1.0, "arm": "a", "joint": "b", "limit": "none"}]},
    ):
        with pytest.raises(InvalidInputError):
            TimedPath.of_record(bad)
    with pytest.raises(InvalidInputError):
        piece_of(np.zeros(19))


@pytest.mark.parametrize(
    ("s", "squares"),
    [
        ([0.0, 1.0], [0.0, 1.0]),
        ([0.0, 1.0, 2.0], [0.0, -1.0, 0.0]),
        ([0.0, 1.0], [0.0, 0.0]),
        ([1.0, 2.0], [0.0, 0.0]),
        ([0.0, 2.0, 1.0], [0.0, 1.0, 0.0]),
        ([0.0, np.nan, 1.0], [0.0, 1.0, 0.0]),
    ],
)
def test_bad_profiles_are_refused(s: list[float], squares: list[float]) -> None:
    with pytest.raises(InvalidInputError):
        SpeedProfile(np.array(s), np.array(squares))


def test_a_path_rests_at_corners() -> None:
    scenario = limited(dual_arm7(), 5.0)
    poses = [scenario.path.pose(t) for t in (0.0, 3.0)]
    poses.append(pin.SE3(poses[1].rotation, poses[1].translation + np.array([0.0, -0.05, 0.0])))
    path = time_path(scenario.cell, scenario.grasp, WaypointPath(poses, durations=[1.0, 1.0]), q_start=scenario.q_start)
    corner = path.geometry().marks[1]
    clock = path.clocks(np.array([corner]))[0]
    np.testing.assert_allclose(path.pose(clock).homogeneous, poses[1].homogeneous, atol=1e-9)
    assert np.abs(path.twist(clock)).max() < 1e-6
    squares = np.where(path.profile.s == corner, 0.01, path.profile.squares)
    with pytest.raises(InvalidInputError, match="corner"):
        TimedPath(path.geometry(), SpeedProfile(path.profile.s, squares))


# -- in the controller -----------------------------------------------------------------------------------------------


def run(scenario: Scenario, path: ObjectPath, *, dt: float) -> tuple[list[Any], float, float]:
    """Steps to the end, and the largest chain and path errors [m]."""
    controller = QPController(scenario.cell, scenario.grasp, path, dt=dt)  # type: ignore[arg-type]
    controller.reset(scenario.q_start)
    steps, chain, away = [], 0.0, 0.0
    while not steps or not steps[-1].finished:
        steps.append(controller.step())
        state = CellState(scenario.cell, steps[-1].q_next)
        chain = max(chain, np.abs(scenario.grasp.relative_errors(state)[:, :3]).max())
        here = scenario.grasp.carried(state)[0].translation
        away = max(away, float(np.linalg.norm(here - path.pose(steps[-1].clock_next).translation)))
        assert len(steps) < 10_000
    return steps, chain, away


@pytest.mark.parametrize("build", [lambda: ring(arms=2), dual_arm7, mixed_cell])
def test_a_controller_tracks_it_at_full_rate_all_along(build: Any) -> None:
    scenario = limited(build(), 5.0)
    path = plan_of(scenario)
    steps, chain, away = run(scenario, path, dt=0.004)
    assert {s.status for s in steps} == {Status.TRACKING}
    assert all(s.rate == 1.0 for s in steps)
    assert chain < UM
    assert away < UM
    best = plan_of(scenario, share=1.0).duration
    assert len(steps) * 0.004 <= 1.03 * best
    assert not np.isnan(steps[-1].q_next).any()


def test_the_own_time_law_of_a_path_counts_for_nothing() -> None:
    scenario = limited(dual_arm7(), 5.0)
    assert isinstance(scenario.path, LinePath)
    other = LinePath(scenario.path.start, scenario.path.goal, duration=17.0, time_law="linear")
    a, b = plan_of(scenario), plan_of(replace(scenario, path=other))
    assert a.record() == b.record()


class OwnPath(ObjectPath):
    """A path of a user: poses and twists, no geometry."""

    def __init__(self, inner: ObjectPath, *, twist: Any = None, says_corners: bool = True) -> None:
        self.duration, self._inner, self._twist, self._says_corners = inner.duration, inner, twist, says_corners

    def pose(self, clock: float) -> pin.SE3:
        return self._inner.pose(clock)

    def twist(self, clock: float) -> np.ndarray:
        return self._inner.twist(clock) if self._twist is None else self._twist

    def next_breakpoint(self, clock: float) -> float:
        return self._inner.next_breakpoint(clock) if self._says_corners else self.duration


@pytest.mark.slow
def test_a_corner_that_a_path_of_ones_own_does_not_tell_is_found() -> None:
    scenario = limited(dual_arm7(), 5.0)
    start = scenario.path.pose(0.0)
    ways = np.array([[0.0, 0.0, 0.0], [0.02, 0.03, 0.06], [0.0, 0.04, 0.05], [0.01, 0.0, 0.0]])
    poses = [pin.SE3(start.rotation, start.translation + way) for way in ways]
    line = WaypointPath(poses, durations=[0.31, 0.7, 0.2], time_law="linear")
    paths = [OwnPath(line, says_corners=says) for says in (True, False)]
    said, unsaid = (plan_of(replace(scenario, path=path), knots=60) for path in paths)
    assert unsaid.geometry().corners == said.geometry().corners == (1, 2)
    assert unsaid.duration == pytest.approx(said.duration, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("time_law", ["linear", "quintic"])
def test_a_path_of_ones_own_takes_as_long_as_one_that_knows_its_geometry(time_law: str) -> None:
    scenario = limited(dual_arm7(), 5.0)
    start = scenario.path.pose(0.0)
    across = pin.SE3(start.rotation, start.translation + np.array([0.05, 0.08, 0.1]))
    back = pin.SE3(pin.exp3(np.array([0.1, 0.0, 0.2])) @ start.rotation, start.translation + np.array([0.0, 0.1, 0.05]))
    known = WaypointPath([start, across, back], durations=[2.0, 1.0], time_law=time_law)
    own = replace(scenario, path=OwnPath(known))
    expected, found = plan_of(replace(scenario, path=known)), plan_of(own)
    assert found.duration == pytest.approx(expected.duration, rel=1e-3)
    assert found.geometry().corners == (1,)
    steps, chain, _ = run(own, found, dt=0.004)
    assert {s.status for s in steps} == {Status.TRACKING}
    assert chain < UM
    with pytest.raises(InvalidInputError, match="cannot be written"):
        found.record()


def test_a_path_of_ones_own_may_say_what_it_was_planned_with() -> None:
    """Without the share the look-ahead keeps its own margins, and slows the same path down."""
    scenario = limited(ring(arms=2), 5.0)
    planned = plan_of(scenario)
    own, unsaid = OwnPath(planned), OwnPath(planned)
    own.planned_share = planned.planned_share
    assert {s.status for s in run(scenario, own, dt=0.01)[0]} == {Status.TRACKING}
    assert Status.SLOWED in {s.status for s in run(scenario, unsaid, dt=0.01)[0]}
    for bad in (2.0, 0.0, "much"):
        own.planned_share = bad  # type: ignore[assignment]
        with pytest.raises(InvalidInputError, match="planned_share"):
            QPController(scenario.cell, scenario.grasp, own, dt=0.01)


def test_the_settings_of_a_planned_path_end_with_it() -> None:
    scenario = limited(dual_arm7(), 5.0)
    options = QPOptions(posture={"gain": 1.0})  # type: ignore[arg-type]
    fresh = QPController(scenario.cell, scenario.grasp, scenario.path, dt=0.01, options=options)
    used = QPController(scenario.cell, scenario.grasp, plan_of(scenario), dt=0.01, options=options)
    used.reset(scenario.q_start)
    used.follow(scenario.path)
    for controller in (fresh, used):
        controller.reset(scenario.q_start)
    for _ in range(60):
        a, b = fresh.step(), used.step()
        np.testing.assert_array_equal(a.q_next, b.q_next)
    copied = pickle.loads(pickle.dumps(used))
    used.follow(plan_of(scenario))
    copied.follow(plan_of(scenario))
    np.testing.assert_array_equal(used.step().q_next, copied.step().q_next)


# -- errors ----------------------------------------------------------------------------------------------------------


def test_what_cannot_be_timed_is_named() -> None:
    scenario = limited(dual_arm7(), 5.0)
    pose = scenario.path.pose(0.0)
    for path in (HoldPath(pose), ServoPath(pose)):
        with pytest.raises(InvalidInputError, match="geometry"):
            plan_of(replace(scenario, path=path))
    with pytest.raises(InvalidInputError, match="no acceleration limit"):
        plan_of(dual_arm7())
    for options in ({"share": 0.0}, {"share": 1.1}, {"knots": 0}, {"payload": 3.0}):
        with pytest.raises(InvalidInputError):
            plan_of(scenario, **options)
    with pytest.raises(InvalidInputError, match="twist"):
        plan_of(replace(scenario, path=OwnPath(scenario.path, twist=np.ones(6))))
    with pytest.raises(InvalidInputError, match="geometry"):
        plan_of(replace(scenario, path=OwnPath(HoldPath(pose))))
    far = pin.SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, 3.0]))
    with pytest.raises(UnreachableError, match=r"only to .* of its way"):
        plan_of(replace(scenario, path=LinePath(pose, far, duration=1.0)))
    tight = scenario.cell.with_limits(upper=scenario.cell.positions(scenario.q_start) + 0.02)
    with pytest.raises(UnreachableError, match=r"leaves its position limits .* s of it\): .*° outside"):
        plan_of(replace(scenario, cell=tight))
    with pytest.raises(UnreachableError, match=r"joint .* needs .* to hold its share of the payload still"):
        plan_of(scenario, payload=Payload(mass=1e4, torque=50.0))
    for bad in ({"mass": -1.0}, {"mass": 1.0, "inertia": np.diag([1.0, 1.0, -1.0])}, {"mass": 1.0, "centre": [1.0]}):
        with pytest.raises(InvalidInputError):
            Payload(**bad)
    with pytest.raises(InvalidInputError):
        plan_of(scenario, payload=Payload(mass=1.0, torque=[1.0, 2.0]))


def test_a_geometry_can_be_timed_as_well_as_a_path() -> None:
    scenario = limited(dual_arm7(), 5.0)
    geometry = scenario.path.geometry()
    assert isinstance(geometry, PathGeometry)
    path = time_path(scenario.cell, scenario.grasp, geometry, q_start=scenario.q_start)
    assert path.duration == plan_of(scenario).duration
