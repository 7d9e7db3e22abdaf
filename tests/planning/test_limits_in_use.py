"""Which limit binds along a profile, and how much of each is used, against motions known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from runs import limited
from scipy.interpolate import CubicHermiteSpline

from coopqp import Arm, BindingLimit, InvalidInputError, LimitKind, RobotCell, WaypointPath
from coopqp.errors import UnreachableError
from coopqp.paths import SpeedProfile
from coopqp.planning import Payload, time_path
from coopqp.planning.jerk import jerk_use, smoothed
from coopqp.planning.knots import Knots
from coopqp.planning.parametrise import Limited, Lines, outermost
from coopqp.planning.timing import binding_limits, kept_within, motion_over_clock, use_between
from coopqp.scenarios import dual_arm7, paper_lift, robot_path
from coopqp.spatial import Array

K = 201
S = np.linspace(0.0, 1.0, K)
#: From rest to rest with 2 1/s², at most 0.8 1/s.
TRAPEZIUM = np.minimum(0.64, np.minimum(4.0 * S, 4.0 * (1.0 - S)))


def lines(a: Array, b: Array, c: Array, bound: float, owner: list[int]) -> Lines:
    return Lines(a, b, c, np.full(a.shape[1], bound), np.array(owner))


def along(*, v: float, a: float, joints: int = 3) -> Limited:
    """Joint 1 moves as s does, joint 2 half as fast back, joint 0 stays; limits of 1."""
    slope = np.tile([0.0, 1.0, -0.5][:joints], (K, 1))
    zero = np.zeros_like(slope)
    moving = [1, 2]
    acceleration = lines(slope[:, moving], zero[:, moving], zero[:, moving], a, moving)
    return Limited(Knots(S, slope * S[:, None], slope, zero), np.full(joints, v), acceleration)


@pytest.fixture(scope="module")
def cell() -> RobotCell:
    return paper_lift().cell


def test_speed_binds_in_the_middle_and_acceleration_at_the_ends(cell: RobotCell) -> None:
    names, use = binding_limits(cell, along(v=0.8, a=2.0), TRAPEZIUM)
    accelerates, moves = (cell.joint_limit(1, kind) for kind in (LimitKind.ACCELERATION, LimitKind.VELOCITY))
    np.testing.assert_allclose(use, 1.0, rtol=1e-12)
    assert names[:32] == [accelerates] * 32
    # At both ends of the middle part they are used alike, and the one that bound before counts.
    assert names[32:169] == [moves] * 137
    assert names[169:] == [accelerates] * 31


def test_use_is_a_share_of_each_limit(cell: RobotCell) -> None:
    """A quarter of ṡ² uses half of a speed and a quarter of an acceleration."""
    names, use = binding_limits(cell, along(v=1.6, a=1e9), 0.25 * TRAPEZIUM)
    np.testing.assert_allclose(use, 0.5 * np.sqrt(np.maximum(TRAPEZIUM[1:], TRAPEZIUM[:-1])) / 1.6)
    assert set(names) == {cell.joint_limit(1, LimitKind.VELOCITY)}
    names, use = binding_limits(cell, along(v=1e9, a=1.0), 0.25 * TRAPEZIUM)
    np.testing.assert_allclose(use[:32], 0.5, rtol=1e-9)
    np.testing.assert_allclose(use[33:167], 0.0, atol=1e-7)
    assert names[0] == cell.joint_limit(1, LimitKind.ACCELERATION)


def test_torques_and_further_bounds_are_named_where_they_bind(cell: RobotCell) -> None:
    class Named:
        def __init__(self, name: str) -> None:
            self.name = name

    zero, one = np.zeros((K, 1)), np.ones((K, 1))
    torque = lines(2.0 * one, zero, 3.0 * one, 5.0, [2])  # 2 s̈ + 3 of 5
    own = np.hstack([np.where(S[:, None] < 0.5, 4.0, 0.0), np.where(S[:, None] < 0.5, 0.0, 4.0)])
    further = Lines(0.0 * own, own, 0.0 * own, np.ones(2), np.tile([0, 1], (K, 1)))
    loaded = replace(along(v=1e9, a=1e9), torque=torque, further=further)
    names, use = binding_limits(cell, loaded, TRAPEZIUM, bounds=[Named("first"), Named("second")])  # type: ignore[list-item]
    assert names[0] == cell.joint_limit(2, LimitKind.TORQUE)
    assert use[0] == pytest.approx((2.0 * 2.0 + 3.0) / 5.0)
    assert use[-1] == pytest.approx(abs(-2.0 * 2.0 + 3.0) / 5.0)
    assert names[80] == BindingLimit("", "", LimitKind.CONSTRAINT, "first")
    assert names[120] == BindingLimit("", "", LimitKind.CONSTRAINT, "second")
    assert use[80] == use[120] == pytest.approx(4.0 * 0.64)


def test_a_profile_is_slowed_down_as_a_whole_until_it_keeps_every_limit() -> None:
    jerk = np.full(3, 1e9)
    within = kept_within(along(v=0.9, a=3.0), TRAPEZIUM, jerk)
    np.testing.assert_array_equal(within, TRAPEZIUM)
    np.testing.assert_allclose(kept_within(along(v=0.4, a=3.0), TRAPEZIUM, jerk), 0.25 * TRAPEZIUM)
    np.testing.assert_allclose(kept_within(along(v=0.9, a=0.5), TRAPEZIUM, jerk), 0.25 * TRAPEZIUM)


def test_between_knots_the_joints_motion_is_a_cubic() -> None:
    """With q = s²/2 and z = 1 + s the speed is s √z, the acceleration s / 2 + z."""
    s = np.array([0.2, 0.6, 1.4])
    one = np.ones((3, 1))
    used: Callable[[float], float]
    for v, a, used in (
        (2.0, 1e9, lambda s: float(s * np.sqrt(1.0 + s) / 2.0)),
        (1e9, 5.0, lambda s: (0.5 * s + 1.0 + s) / 5.0),
    ):
        knots = Knots(s, 0.5 * s[:, None] ** 2, s[:, None], one)
        acceleration = lines(s[:, None], one, 0.0 * one, a, [0])
        use = use_between(Limited(knots, np.array([v]), acceleration), 1.0 + s)
        np.testing.assert_allclose(use, [used(0.5), used(1.2)], rtol=1e-12)  # three quarters of the way


# -- jerk ------------------------------------------------------------------------------------------------------------


def s_curve(jerk: float, count: int = 2000) -> tuple[Array, Array]:
    """s and ṡ² over 1 m, up and down by ±jerk in four equal times."""
    T = np.cbrt(32.0 / jerk)
    t = np.linspace(0.0, 0.5 * T, count)
    early = t <= 0.25 * T
    r = t - 0.25 * T
    v = np.where(early, 0.5 * jerk * t**2, jerk * (T**2 / 32.0 + 0.25 * T * r - 0.5 * r**2))
    s = np.where(early, jerk * t**3 / 6.0, jerk * (T**3 / 384.0 + T**2 / 32.0 * r + T / 8.0 * r**2 - r**3 / 6.0))
    return np.append(s, 1.0 - s[-2::-1]), np.append(v, v[-2::-1]) ** 2


def test_the_use_of_a_jerk_limit_is_the_jerk_over_it() -> None:
    s, squares = s_curve(4.0)
    slope = np.column_stack([np.ones_like(s), np.full_like(s, -0.5)])
    knots = Knots(s, slope * s[:, None], slope, 0.0 * slope)
    limited = Limited(knots, np.full(2, 1e9), lines(slope, 0.0 * slope, 0.0 * slope, 1e9, [0, 1]))
    use = jerk_use(limited, squares, np.array([5.0, 8.0]))
    assert use.shape == (len(s) - 1, 2)
    for inner in (slice(100, 900), slice(1100, 1900), slice(2100, 2900), slice(3100, 3900)):
        np.testing.assert_allclose(use[inner], np.tile([0.8, 0.25], (800, 1)), rtol=2e-3)
    assert use.max() <= 0.8 * (1.0 + 2e-3)


def test_a_smoothed_profile_is_a_moving_average_over_time() -> None:
    """Against a box filter of the speed over time; it takes longer by its width, and goes as far."""
    s = np.linspace(0.0, 1.0, 51)
    squares = np.minimum(0.64, np.minimum(4.0 * s, 4.0 * (1.0 - s)))
    v = np.sqrt(squares)
    spans = 2.0 * np.diff(s) / (v[1:] + v[:-1])
    clocks, width = np.append(0.0, np.cumsum(spans)), spans.max()
    x, z = smoothed(s, squares)
    assert x[0] == z[0] == z[-1] == 0.0
    assert x[-1] == 1.0
    assert (np.diff(x) > 0.0).all()
    t = np.linspace(-width, clocks[-1] + width, 40001)
    speed = np.interp(t, clocks, v, left=0.0, right=0.0)
    total = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t)))
    there = np.interp(t + 0.5 * width, t, total) - np.interp(t - 0.5 * width, t, total)
    way = np.append(0.0, np.cumsum(0.5 * (there[1:] + there[:-1]) * np.diff(t))) / width
    np.testing.assert_allclose(np.sqrt(z), np.interp(x, way, there / width), atol=2e-3)
    took = (2.0 * np.diff(x) / (np.sqrt(z[1:]) + np.sqrt(z[:-1]))).sum()
    assert took == pytest.approx(clocks[-1] + width, rel=2e-2)
    assert len(x) > 4 * len(s) - 8


# -- lines, torques and messages -------------------------------------------------------------------------------------


def test_which_lines_may_bind_does_not_hang_on_their_size() -> None:
    a, b = np.random.default_rng(5).normal(size=(2, 3, 40))
    kept = outermost(a, b)
    assert 4 <= len(kept) < 40
    for size in (2.0**-60, 2.0**60):
        np.testing.assert_array_equal(outermost(size * a, size * b), kept)


def effort_cell(effort: list[float]) -> RobotCell:
    model = Arm.from_urdf("arm", robot_path("rx90l"), tool_frame="flange").model.copy()
    model.effortLimit = np.array(effort)
    return RobotCell([Arm.from_model("arm", model, tool_frame="flange")])


def test_torque_limits_are_the_models_unless_given() -> None:
    cell = effort_cell([0.0, 0.5, 5.0, 1e9, 2e9, 9e8])
    none = np.inf
    np.testing.assert_array_equal(Payload(mass=1.0).limits(cell), [none, 0.5, 5.0, none, none, 9e8])
    np.testing.assert_array_equal(Payload(mass=1.0, torque=7.0).limits(cell), np.full(6, 7.0))
    given = [1.0, 2.0, np.inf, 0.25, 5.0, 6.0]
    np.testing.assert_array_equal(Payload(mass=1.0, torque=given).limits(cell), given)


@pytest.mark.parametrize("torque", [0.0, -0.5, np.nan, [1.0, 2.0, 3.0, 4.0, 5.0, 0.0]])
def test_torque_limits_have_to_be_above_zero(torque: object) -> None:
    with pytest.raises(InvalidInputError, match=r"Payload: torque: (entries ≤ 0|is NaN)\."):
        Payload(mass=1.0, torque=torque).limits(effort_cell([1.0] * 6))


def test_where_a_joint_leaves_its_limits_is_told_along_the_whole_path() -> None:
    """In the second of two stretches: the length of the first one counts."""
    task = limited(dual_arm7(), 5.0)
    start = task.path.pose(0.0)
    ways = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05], [0.0, -0.05, 0.15]])
    poses = [pin.SE3(start.rotation, start.translation + way) for way in ways]
    path = WaypointPath(poses, durations=[1.0, 1.0])
    geometry = path.geometry()
    assert geometry is not None
    free = time_path(task.cell, task.grasp, path, q_start=task.q_start, knots=60)
    assert free.elbows is not None
    x, s = free.elbows.x, np.array([free.at(clock)[0] for clock in free.elbows.clocks])
    moved = np.abs(x - x[0])
    corner, end = geometry.marks[1:]
    j = int((moved[-1] - moved[s <= corner].max(axis=0)).argmax())
    bound = 0.5 * (moved[s <= corner, j].max() + moved[-1, j])
    up = x[-1, j] > x[0, j]
    ends = (task.cell.limits.upper if up else task.cell.limits.lower).copy()
    ends[j] = x[0, j] + (bound if up else -bound)
    cell = task.cell.with_limits(**{"upper" if up else "lower": ends})
    arm, _, joint = cell.joint_names[j].partition("/")
    with pytest.raises(UnreachableError) as caught:
        time_path(cell, task.grasp, path, q_start=task.q_start, knots=60)
    text = str(caught.value)
    assert text.startswith(f"arm {arm} leaves its position limits ")
    assert f": {joint} goes {np.rad2deg(moved[:, j].max() - bound):.1f}° outside." in text
    told = float(text.split("limits ")[1].split(" m")[0])
    first = float(s[np.flatnonzero(moved[:, j] > bound)[0]])
    assert corner < told < end
    assert told == pytest.approx(first, abs=0.02)
    clock = float(text.split("(")[1].split(" s")[0])
    assert clock == pytest.approx(float(path.clocks(np.array([told]))[0]), abs=0.02)


def test_a_payload_that_cannot_be_held_is_told_with_joint_torque_and_place() -> None:
    task = limited(dual_arm7(), 5.0)
    with pytest.raises(UnreachableError) as caught:
        time_path(task.cell, task.grasp, task.path, q_start=task.q_start, payload=Payload(mass=40.0, torque=30.0))
    text = str(caught.value)
    assert "along the path, and may take 29.4." in text  # 98 % of it
    assert "still 0 m" in text
    needed = float(text.split("needs ")[1].split(" N")[0])
    assert needed > 29.4


def test_the_motion_over_the_clock_has_few_knots_and_is_exact_at_all() -> None:
    """The joints go as sines of s along the trapezium; knots that cubics know without them are left out."""
    slow = np.array([1.0, 0.3])
    x, slopes = np.sin(S[:, None] * slow), np.cos(S[:, None] * slow) * slow
    profile = SpeedProfile(S, TRAPEZIUM)
    found = motion_over_clock(profile, x, slopes)
    assert 3 < len(found.clocks) < 150
    assert np.isin(found.clocks, profile.clocks).all()
    assert found.clocks[0] == 0.0
    assert found.clocks[-1] == profile.clocks[-1]
    speed = np.sqrt(TRAPEZIUM)[:, None] * slopes
    np.testing.assert_allclose(CubicHermiteSpline(found.clocks, found.x, found.slopes)(profile.clocks), x, atol=1e-8)
    own = np.isin(profile.clocks, found.clocks)
    np.testing.assert_array_equal(found.x, x[own])
    np.testing.assert_array_equal(found.slopes, speed[own])
