"""Object paths: poses, twists and increments are consistent; the paper's screw is a special case."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from coopqp import HoldPath, InvalidInputError, LinePath, ObjectPath, ServoPath, WaypointPath
from coopqp.errors import UnknownNameError
from coopqp.paths import TimeLaw
from coopqp.paths.path import ScrewParameters
from coopqp.paths.time_law import as_time_law
from coopqp.planning.remedies import shifted
from coopqp.spatial import adjoint

Array = NDArray[np.float64]

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
poses = st.builds(lambda w, p: pin.SE3(pin.exp3(0.9 * w), p), vectors, vectors)
laws = st.sampled_from(list(TimeLaw))
durations = st.floats(0.01, 100.0)
lines = st.builds(
    lambda a, b, d, law: LinePath(a, b, duration=d, time_law=law), poses, poses, durations, laws
)  # fmt: skip


@st.composite
def waypoints(draw: st.DrawFn) -> WaypointPath:
    n = draw(st.integers(2, 5))
    return WaypointPath(
        draw(st.lists(poses, min_size=n, max_size=n)),
        durations=draw(st.lists(st.floats(0.1, 5.0), min_size=n - 1, max_size=n - 1)),
        time_law=draw(laws),
    )


paths = st.one_of(lines, waypoints(), st.builds(lambda T, d: HoldPath(T, duration=d), poses, durations))
shares = st.floats(0.0, 1.0)


def close(a: Any, b: Any, tolerance: float = 1e-13) -> None:
    np.testing.assert_allclose(getattr(a, "homogeneous", a), getattr(b, "homogeneous", b), rtol=0, atol=tolerance)


def exp(xi: Array) -> pin.SE3:
    return pin.exp6(pin.Motion(xi))


# -- time laws -------------------------------------------------------------------------------------------------------


@given(laws, shares, shares)
def test_a_time_law_rises_from_0_to_1(law: TimeLaw, a: float, b: float) -> None:
    assert law.value_at(0.0) == 0.0
    assert law.value_at(1.0) == 1.0
    low, high = sorted((a, b))
    assert 0.0 <= law.value_at(low) <= law.value_at(high) + 2e-14
    assert law.value_at(high) <= 1.0
    assert law.value_at(a) + law.value_at(1.0 - a) == pytest.approx(1.0, abs=2e-14)
    assert law.value_at(-a) == 0.0
    assert law.value_at(1.0 + a) == 1.0
    assert law.slope_at(1.0 + a) == 0.0
    assert law.slope_at(-a - 1e-300) == 0.0


@given(laws, st.floats(0.001, 0.999))
def test_its_slope_is_its_derivative(law: TimeLaw, x: float) -> None:
    h = 1e-5
    assert (law.value_at(x + h) - law.value_at(x - h)) / (2 * h) == pytest.approx(law.slope_at(x), abs=1e-8)


def test_quintic_starts_and_ends_at_rest_without_acceleration() -> None:
    for x in (1e-4, 1.0 - 1e-4):
        assert TimeLaw.QUINTIC.slope_at(x) < 31e-8
    assert TimeLaw.QUINTIC.slope_at(0.5) == 1.875
    assert as_time_law("quintic") is as_time_law(TimeLaw.QUINTIC) is TimeLaw.QUINTIC


# -- every path ------------------------------------------------------------------------------------------------------


@given(paths, shares)
def test_a_twist_is_the_derivative_of_the_pose(path: ObjectPath, x: float) -> None:
    """Central differences, away from the corners."""
    shortest = min([s.duration for s in getattr(path, "segments", [path])])
    clock, h = x * path.duration, 1e-5 * shortest
    corners = getattr(path, "_starts", [0.0])
    if min(abs(clock - c) for c in [*corners, path.duration]) <= h:
        return
    made = pin.log6(path.pose(clock - h).actInv(path.pose(clock + h))).vector / (2 * h)
    close(made * shortest, path.twist(clock) * shortest, 1e-7)


@given(paths, shares, st.floats(1e-6, 1.0))
def test_an_increment_makes_exactly_one_step(path: ObjectPath, x: float, share: float) -> None:
    clock, dt = x * path.duration, share * path.duration
    moved = path.pose(clock) * exp(path.increment(clock, dt) * dt)
    close(moved, path.pose(clock + dt), 1e-9)


@given(paths, st.floats(0.0, 1e9))
def test_the_object_rests_at_the_ends(path: ObjectPath, t: float) -> None:
    close(path.pose(-t), path.pose(0.0), 0.0)
    close(path.pose(path.duration + t), path.pose(path.duration), 1e-12)
    for clock in (-t - 1e-9, path.duration * (1.0 + 1e-15) + t):
        close(path.twist(clock), np.zeros(6), 0.0)
    close(path.increment(path.duration, 1.0 + t), np.zeros(6), 1e-12)


@given(paths, shares)
def test_rotations_stay_rotations(path: ObjectPath, x: float) -> None:
    R = path.pose(x * path.duration).rotation
    close(R @ R.T, np.eye(3), 1e-13)


@given(paths, shares)
def test_poses_are_the_callers(path: ObjectPath, x: float) -> None:
    before = path.pose(x * path.duration).homogeneous.copy()
    if not isinstance(path, HoldPath):
        path.pose(x * path.duration).translation[:] = 7.0
    close(path.pose(x * path.duration), before, 0.0)


# -- lines -----------------------------------------------------------------------------------------------------------


@given(poses, poses, durations, laws)
def test_a_line_joins_its_ends(a: pin.SE3, b: pin.SE3, duration: float, law: TimeLaw) -> None:
    path = LinePath(a, b, duration=duration, time_law=law)
    close(path.pose(0.0), a, 1e-15)
    close(path.pose(duration), b, 1e-13)
    close(path.start, a, 0.0)
    close(path.goal, b, 0.0)


@given(poses, poses, poses, shares)
def test_a_moved_line_is_the_line_moved(G: pin.SE3, a: pin.SE3, b: pin.SE3, x: float) -> None:
    here, there = (LinePath(T * a, T * b, duration=1.0) for T in (pin.SE3.Identity(), G))
    if here.screw.angle > np.pi - 1e-6:
        return  # the sign of the axis is free
    close(there.pose(x), G * here.pose(x), 1e-8 / (np.pi - here.screw.angle))
    close(there.twist(x), here.twist(x), 1e-7 / (np.pi - here.screw.angle))


@given(poses, poses, shares)
def test_back_is_the_same_way(a: pin.SE3, b: pin.SE3, x: float) -> None:
    there, back = LinePath(a, b, duration=1.0, time_law="linear"), LinePath(b, a, duration=1.0, time_law="linear")
    if there.screw.angle < np.pi - 1e-6:
        close(there.pose(x), back.pose(1.0 - x), 1e-8 / (np.pi - there.screw.angle))


@given(lines, shares)
def test_a_lines_spatial_motion(path: LinePath, x: float) -> None:
    """In the world the motion is straight and about one fixed axis; the time law governs both."""
    u, slope = path.time_law.value_at(x), path.time_law.slope_at(x) / path.duration
    T = path.pose(x * path.duration)
    close(T.translation, path.start.translation + u * (path.goal.translation - path.start.translation), 1e-12)
    at_A = pin.SE3(T.rotation, np.zeros(3))
    v = adjoint(at_A) @ path.twist(x * path.duration)
    if 1e-9 < x < 1.0 - 1e-9:
        close(v[:3] / slope, path.goal.translation - path.start.translation, 1e-9)
        close(v[3:] / slope, path.start.rotation @ path.screw.r * path.screw.angle, 1e-9)


@given(poses, vectors, vectors)
def test_a_displacement_is_in_the_world_and_about_the_objects_origin(T: pin.SE3, shift: Array, turn: Array) -> None:
    path = LinePath.displaced(T, translation=shift, rotation=turn, duration=1.0)
    close(path.goal.translation, T.translation + shift, 1e-13)
    close(path.goal.rotation, pin.exp3(turn) @ T.rotation, 1e-13)
    close(LinePath.displaced(T, duration=1.0).pose(1.0), T)


@pytest.mark.parametrize("degrees", [-720.0, -350.0, -180.0, -170.0, 180.0, 190.0, 360.0, 1000.0])
def test_a_displacement_turns_as_told_also_beyond_half_a_turn(degrees: float) -> None:
    start = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.9])), np.array([0.1, 0.2, 0.3]))
    axis = np.array([0.6, 0.0, 0.8])
    path = LinePath.displaced(start, translation=(0, 0, 0.1), rotation=np.deg2rad(degrees) * axis, duration=4.0)
    moved = shifted(path, np.array([0.0, 1.0, 0.0]))
    line = path.geometry()
    assert line is not None
    for poses in (
        [path.pose(t).rotation for t in np.linspace(0.0, 4.0, 401)],
        [moved.pose(t).rotation for t in np.linspace(0.0, 4.0, 401)],
        [*line.poses(np.linspace(0.0, line.length, 401))[0]],
    ):
        turned = sum(axis @ pin.log3(b @ a.T) for a, b in itertools.pairwise(poses))
        assert np.rad2deg(turned) == pytest.approx(degrees, abs=1e-6)


@given(poses, poses)
def test_screw_parameters(a: pin.SE3, b: pin.SE3) -> None:
    screw = ScrewParameters.between(a, b)
    assert 0.0 <= screw.angle <= np.pi
    norm = np.linalg.norm(screw.r)
    assert norm == pytest.approx(1.0, abs=1e-12) or (norm == 0.0 and screw.angle == 0.0)
    close(a.rotation @ pin.exp3(screw.angle * screw.r), b.rotation, 1e-13)
    close(a.act(screw.p), b.translation, 1e-12)


# -- waypoints -------------------------------------------------------------------------------------------------------


@given(st.lists(poses, min_size=2, max_size=6), laws)
def test_waypoints_are_passed_on_time(stations: list[pin.SE3], law: TimeLaw) -> None:
    times = [0.5 + 0.25 * i for i in range(len(stations) - 1)]
    path = WaypointPath(stations, durations=times, time_law=law)
    assert path.duration == pytest.approx(sum(times))
    assert len(path.segments) == len(times)
    for station, clock in zip(stations, np.cumsum([0.0, *times]), strict=True):
        close(path.pose(clock), station, 1e-11)
        if law is TimeLaw.QUINTIC:
            close(path.twist(clock), np.zeros(6), 1e-9)


@given(waypoints(), shares)
def test_waypoints_join_lines(path: WaypointPath, x: float) -> None:
    clock, start = x * path.duration, 0.0
    for segment in path.segments:
        if clock < start + segment.duration - 1e-9 and clock > start + 1e-9:
            close(path.pose(clock), segment.pose(clock - start), 1e-12)
            close(path.twist(clock), segment.twist(clock - start), 1e-9)
        start += segment.duration


@given(waypoints(), shares)
def test_a_path_has_no_gap(path: WaypointPath, x: float) -> None:
    clock, h = x * path.duration, 1e-9
    fastest = max(2.0 * np.linalg.norm(s.goal.translation - s.start.translation) / s.duration for s in path.segments)
    step = np.linalg.norm(path.pose(clock + h).translation - path.pose(clock).translation)
    assert step <= 1.01 * fastest * h + 1e-12


@given(waypoints(), shares)
def test_a_breakpoint_is_the_next_corner(path: WaypointPath, x: float) -> None:
    clock = x * path.duration
    corners = np.cumsum([s.duration for s in path.segments])
    expected = next((c for c in corners[:-1] if c > clock + 1e-9), path.duration)
    assert path.next_breakpoint(clock) == pytest.approx(expected, abs=1e-12)
    assert path.segments[0].next_breakpoint(0.0) == path.segments[0].duration
    assert path.next_breakpoint(path.duration) == path.duration


# -- the same as numbers -----------------------------------------------------------------------------------------------


def moving(start: pin.SE3, target: pin.SE3, clock: float) -> ServoPath:
    path = ServoPath(start)
    path.set_target(target, clock=clock)
    return path


def unpacked(numbers: Array, clock: float) -> pin.SE3:
    """The pose that the numbers of ``ObjectPath.packed`` stand for."""
    first = 3 + int(numbers[1])
    segments = numbers[first:].reshape(int(numbers[2]), 29)
    segment = next((s for s in segments[::-1] if s[18] <= clock), segments[0])
    share = min(max((clock - segment[18]) / segment[19], 0.0), 1.0)
    law = int(segment[20])
    assert law != 2 or not segment[21:].any(), "from rest: no ramps"
    u = share**3 * (10.0 - 15.0 * share + 6.0 * share**2) if law == 1 else share
    R, turn, way = segment[:9].reshape(3, 3), segment[12:15], segment[15:18]
    return pin.SE3(R @ pin.exp3(u * turn), segment[9:12] + u * way)


@given(st.one_of(paths, st.builds(moving, poses, poses, st.floats(0.0, 20.0))), shares)
def test_the_numbers_of_a_path_say_what_the_path_says(path: ObjectPath, x: float) -> None:
    numbers, corners = path.packed(), [path.next_breakpoint(0.0)]
    assert numbers is not None
    while corners[-1] < path.duration:
        corners.append(path.next_breakpoint(corners[-1]))
    close(numbers[3 : 3 + int(numbers[1])], np.array(corners[:-1]))
    assert numbers[0] == path.duration == corners[-1]
    for clock in (x * min(path.duration, 50.0), *corners[:-1], -1.0, 1e3):
        close(unpacked(numbers, clock), path.pose(clock), 1e-12)


# -- targets that move -------------------------------------------------------------------------------------------------


@given(poses, st.lists(st.tuples(poses, st.floats(0.01, 3.0)), min_size=1, max_size=4))
def test_a_servo_path_never_jumps(start: pin.SE3, targets: list[tuple[pin.SE3, float]]) -> None:
    """When the target moves, the object goes on from its pose and motion at bounded speed and spin, and arrives."""
    path, clock = ServoPath(start, speed=0.5, spin=1.0), 0.0
    close(path.pose(0.0), start)
    assert path.known_ahead
    for target, wait in targets:
        before, moving = path.pose(clock), path.twist(clock)
        path.set_target(target, clock=clock)
        close(path.pose(clock), before, 1e-12)
        if np.abs(moving).max() > 1e-6:  # from rest it begins at its speed, and the rate at 0
            close(path.twist(clock), moving, 1e-12)
        for t in np.linspace(clock, clock + wait, 7):
            v = path.twist(t)
            assert np.linalg.norm(v[:3]) <= 0.5 + 1e-9
            assert np.linalg.norm(v[3:]) <= 1.0 + 1e-9
        clock += wait
    close(path.pose(clock + 100.0), targets[-1][0], 1e-12)
    close(path.twist(clock + 100.0), np.zeros(6), 0.0)


@given(poses, poses, st.floats(0.0, 50.0), shares)
def test_a_servo_path_jumps_once_at_the_target(start: pin.SE3, target: pin.SE3, clock: float, x: float) -> None:
    path = ServoPath(start, speed=0.5, spin=1.0)
    path.set_target(target, clock=clock)
    end = path.next_breakpoint(clock)
    way = ScrewParameters.between(start, target)
    assert end - clock == pytest.approx(max(np.linalg.norm(way.p) / 0.5, way.angle, 1e-4), rel=1e-6)
    assert path.next_breakpoint(clock + x * max(end - clock - 1e-6, 0.0)) == end
    for passed in (end - 1e-12, end, end + 1.0):  # a corner that rounding has not quite reached is passed
        assert path.next_breakpoint(passed) == path.duration == np.inf
    close(path.pose(end), target, 1e-9)


@given(poses, poses, poses)
def test_a_servo_path_begun_again_is_a_new_one_that_rests(a: pin.SE3, b: pin.SE3, c: pin.SE3) -> None:
    path, new = moving(a, b, 3.0), ServoPath(c)
    path.restart(c)
    numbers = new.packed()
    close(path.packed(), numbers, 0.0)
    assert numbers[3 + 1 + 18] == 0.0  # the line begins at clock 0
    close(unpacked(numbers, 1e3), c, 1e-15)


@given(poses, poses, poses, st.floats(0.05, 0.95), st.floats(0.1, 1.0), st.floats(0.02, 0.98))
def test_the_twist_of_a_servo_path_is_the_change_of_its_pose(
    start: pin.SE3, first: pin.SE3, then: pin.SE3, when: float, rate: float, x: float
) -> None:
    path = ServoPath(start, speed=0.5, spin=1.0)
    path.set_target(first, clock=1.0)
    clock = 1.0 + when
    here, moving = path.pose(clock), path.twist(clock)
    path.set_target(then, clock=clock, rate=rate)
    if np.abs(moving).max() > 1e-5:
        close(path.pose(clock), here, 1e-12)
        close(path.twist(clock), rate * moving, 1e-12)
    t, h = clock + 3.0 * x, 1e-6
    change = pin.log6(path.pose(t - h).actInv(path.pose(t + h))).vector / (2.0 * h)
    corner = abs(path.next_breakpoint(clock) - t) < 2.0 * h
    assert corner or np.abs(change - path.twist(t)).max() < 1e-3


def test_a_servo_path_changes_its_motion_as_slowly_as_it_is_told() -> None:
    """With ramp times of 2 s per m/s a change by 0.25 m/s takes half a second; the way ends at rest."""
    path, ramp_times = ServoPath(np.eye(4), speed=0.25), np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    path.set_target(pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])), clock=0.0)
    path.set_target(pin.SE3(np.eye(3), np.array([0.0, 5.0, 0.0])), clock=1.0, ramp_times=ramp_times)
    clocks = np.linspace(1.0, path.next_breakpoint(1.0) - 1e-9, 4001)
    velocities = np.array([path.twist(t)[:3] for t in clocks])  # the frame does not turn
    close(velocities[0], np.array([0.25, 0.0, 0.0]), 1e-12)
    close(velocities[-1], np.zeros(3), 1e-8)
    changes = np.abs(np.diff(velocities, axis=0)).max(axis=1) / np.diff(clocks)
    assert changes.max() == pytest.approx(1.0 / 2.0, rel=1e-3)
    assert np.linalg.norm(velocities, axis=1).max() == pytest.approx(0.25, rel=1e-9)


@pytest.mark.parametrize("bad", [-1.0, np.nan, None, "fast"])
def test_a_bad_rate_or_effort_of_a_target_leaves_the_old_one(bad: Any) -> None:
    path = ServoPath(np.eye(4))
    with pytest.raises(InvalidInputError, match=r"set_target: rate"):
        path.set_target(np.eye(4), clock=0.0, rate=bad)
    with pytest.raises(InvalidInputError, match=r"set_target: ramp_times"):
        path.set_target(pin.SE3.Random(), clock=0.0, ramp_times=np.full((3, 6), np.nan))
    close(path.target, np.eye(4), 0.0)


@pytest.mark.parametrize("bad", [None, 2.0 * np.eye(4), np.full((4, 4), np.nan), "there"])
def test_a_bad_target_leaves_the_old_one(bad: Any) -> None:
    path, target = ServoPath(np.eye(4)), pin.SE3(np.eye(3), np.ones(3))
    path.set_target(target, clock=0.0)
    with pytest.raises(InvalidInputError, match=r"ServoPath\.set_target"):
        path.set_target(bad, clock=1.0)
    close(path.pose(100.0), target, 1e-15)
    with pytest.raises(InvalidInputError, match="ServoPath"):
        ServoPath(bad)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, None])
def test_a_servo_path_needs_speeds(bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="ServoPath: speed"):
        ServoPath(np.eye(4), speed=bad)
    with pytest.raises(InvalidInputError, match="ServoPath: spin"):
        ServoPath(np.eye(4), spin=bad)


# -- bad input -------------------------------------------------------------------------------------------------------

BAD_POSES = [None, "goal", np.eye(3), 2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan)]
BAD_TIMES = [0.0, -1.0, np.nan, np.inf, None, "soon", [1.0, 2.0]]


@pytest.mark.parametrize("bad", BAD_POSES)
def test_bad_poses(bad: Any) -> None:
    good = np.eye(4)
    with pytest.raises(InvalidInputError, match="LinePath: start"):
        LinePath(bad, good, duration=1.0)
    with pytest.raises(InvalidInputError, match="LinePath: goal"):
        LinePath(good, bad, duration=1.0)
    with pytest.raises(InvalidInputError, match=r"LinePath\.displaced: start"):
        LinePath.displaced(bad, duration=1.0)
    with pytest.raises(InvalidInputError, match=r"WaypointPath: placements\[1\]"):
        WaypointPath([good, bad], durations=[1.0])
    with pytest.raises(InvalidInputError, match="HoldPath"):
        HoldPath(bad)
    with pytest.raises(InvalidInputError, match="ScrewParameters: goal"):
        ScrewParameters.between(good, bad)


@pytest.mark.parametrize("bad", BAD_TIMES)
def test_bad_durations(bad: Any) -> None:
    good = np.eye(4)
    makers: list[Callable[[], Any]] = [
        lambda: LinePath(good, good, duration=bad),
        lambda: HoldPath(good, duration=bad),
        lambda: WaypointPath([good, good], durations=[bad]),
    ]
    for make in makers:
        with pytest.raises(InvalidInputError, match="duration"):
            make()


@pytest.mark.parametrize("bad", [None, 1.0, [1.0], [1.0, np.nan, 0.0], "up", np.zeros((3, 1)), np.zeros(6)])
def test_bad_displacements(bad: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"LinePath\.displaced: translation"):
        LinePath.displaced(np.eye(4), translation=bad, duration=1.0)
    with pytest.raises(InvalidInputError, match=r"LinePath\.displaced: rotation"):
        LinePath.displaced(np.eye(4), rotation=bad, duration=1.0)


@pytest.mark.parametrize("bad", ["cubic", "LINEAR", None, 3])
def test_an_unknown_time_law_lists_what_there_is(bad: Any) -> None:
    with pytest.raises(UnknownNameError, match="Available: linear, quintic"):
        LinePath(np.eye(4), np.eye(4), duration=1.0, time_law=bad)


@pytest.mark.parametrize(
    ("placements", "times"),
    [([], []), ([np.eye(4)], []), ([np.eye(4)] * 2, []), ([np.eye(4)] * 2, [1.0, 1.0]), (5, [1.0]),
     ([np.eye(4)] * 2, 1.0), ([np.eye(4)] * 2, None), (None, [1.0])],
)  # fmt: skip
def test_bad_waypoints(placements: Any, times: Any) -> None:
    with pytest.raises(InvalidInputError, match="WaypointPath"):
        WaypointPath(placements, durations=times)


def test_bad_clocks() -> None:
    path = LinePath(np.eye(4), np.eye(4), duration=1.0)
    joined = WaypointPath([np.eye(4)] * 3, durations=[1.0, 1.0])
    for any_path in (path, joined):
        for read in (any_path.pose, any_path.twist):
            with pytest.raises(InvalidInputError, match="clock is NaN"):
                read(np.nan)
        for dt in (0.0, np.nan, np.inf):
            with pytest.raises(InvalidInputError, match=r"ObjectPath\.increment"):
                any_path.increment(0.5, dt)
        for clock in (np.inf, -np.inf, 1e300):
            close(any_path.pose(clock), np.eye(4), 0.0)
