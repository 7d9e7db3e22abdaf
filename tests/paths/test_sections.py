"""Parts of paths, forwards and backwards, and paths that go over to shifted ones; as Python has them and as numbers."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from coopqp import HoldPath, InvalidInputError, LinePath, ObjectPath, TimedPath, WaypointPath
from coopqp.paths import PathGeometry, Section, ShiftedPath, SpeedProfile, TimeLaw
from coopqp.paths.shifted import clock_after, unshifted
from coopqp.spatial import Array

vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
poses = st.builds(lambda w, p: pin.SE3(pin.exp3(w), p), vectors, vectors)
laws = st.sampled_from(list(TimeLaw))
shares = st.floats(0.0, 1.0)


def timed(a: pin.SE3, b: pin.SE3) -> TimedPath:
    """A plan with a profile of three slopes along a line."""
    line = LinePath(a, b, duration=1.0).straight()
    if line is None:
        line = LinePath(a, pin.SE3(a.rotation, a.translation + 1.0), duration=1.0).straight()
    assert line is not None
    s = np.array([0.0, 0.2, 0.5, 0.6, 1.0]) * line.length
    return TimedPath(PathGeometry((line,)), SpeedProfile(s, np.array([0.0, 0.8, 0.8, 0.3, 0.0])))


lines = st.builds(
    lambda a, b, d, law: LinePath(a, b, duration=d, time_law=law), poses, poses, st.floats(0.2, 5.0), laws
)
zigzags = st.builds(
    lambda a, b, c, law: WaypointPath([a, b, c, a], durations=[0.5, 1.0, 0.7], time_law=law), poses, poses, poses, laws
)
plans = st.builds(timed, poses, poses)
paths = st.one_of(lines, zigzags, plans, st.builds(lambda T: HoldPath(T, duration=2.0), poses))


def by_numbers(numbers: Array, clock: float) -> pin.SE3:
    """The pose that packed numbers stand for, by the text of ObjectPath.packed."""
    rows = numbers[3 + int(numbers[1]) :].reshape(int(numbers[2]), 29)
    row = rows[max(int(np.searchsorted(rows[:, 18], clock, side="right")) - 1, 0)]
    x = min(max((clock - row[18]) / row[19], 0.0), 1.0)
    u = {0: x, 1: x**3 * (10.0 - 15.0 * x + 6.0 * x * x), 3: x * (row[21] + (1.0 - row[21]) * x)}[int(row[20])]
    return pin.SE3(row[:9].reshape(3, 3) @ pin.exp3(u * row[12:15]), row[9:12] + u * row[15:18])


def near(a: pin.SE3, b: pin.SE3, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=tolerance)


@given(paths, shares, shares, shares)
def test_a_section_is_the_path_there_in_either_direction(path: Any, a: float, b: float, x: float) -> None:
    begin, end = a * path.duration, b * path.duration
    if abs(begin - end) < 1e-3:
        return
    section = Section(path, begin, end)
    u = x * section.duration
    near(section.pose(u), path.pose(section.clock_of(u)))
    near(section.pose(section.duration + 1.0), path.pose(end))
    assert section.clock_of(section.duration) == pytest.approx(end, abs=1e-12)
    packed = section.packed()
    assert packed is not None
    assert packed[0] == section.duration
    near(by_numbers(packed, u), section.pose(u))
    near(by_numbers(packed, section.duration), path.pose(end))


@given(plans, shares)
def test_a_plan_along_a_line_is_numbers(path: TimedPath, x: float) -> None:
    packed = path.packed()
    assert packed is not None
    near(by_numbers(packed, x * path.duration), path.pose(x * path.duration))


@given(st.one_of(lines, zigzags, plans), shares, shares)
def test_twists_of_a_section_are_those_of_its_poses(path: ObjectPath, a: float, x: float) -> None:
    begin = a * path.duration
    for end in (0.0, path.duration):
        if abs(begin - end) < 0.05:
            continue
        section, h = Section(path, begin, end), 1e-6
        assert not section.twist(section.duration).any()
        u = h + x * (section.duration - 2.0 * h)
        ahead, marks = section.next_breakpoint(u - 2.0 * h), [0.0, section.duration]
        if abs(ahead - u) < 4.0 * h or min(abs(u - m) for m in marks) < 4.0 * h:
            continue
        change = np.asarray(pin.log6(section.pose(u - h).actInv(section.pose(u + h))).vector) / (2.0 * h)
        np.testing.assert_allclose(section.twist(u), change, atol=1e-4)


@given(zigzags)
def test_a_breakpoint_has_the_twist_after_it(path: WaypointPath) -> None:
    back = Section(path, path.duration, 0.0)
    marks = [back.next_breakpoint(0.0)]
    while marks[-1] < back.duration:
        marks.append(back.next_breakpoint(marks[-1]))
    assert len(marks) == 3
    np.testing.assert_allclose(marks, [path.duration - mark for mark in (1.5, 0.5, 0.0)])
    for mark, after in pairwise(marks):
        np.testing.assert_allclose(back.twist(mark), back.twist(mark + 1e-7), atol=1e-4)
        assert after > mark


@given(st.one_of(lines, zigzags), poses, shares)
def test_a_shift_comes_in_between_two_clocks(path: Any, shift: pin.SE3, x: float) -> None:
    begin, end = 0.2 * path.duration, 0.6 * path.duration
    moved = ShiftedPath(path, shift, begin=begin, end=end)
    near(moved.pose(0.5 * begin), path.pose(0.5 * begin))
    near(moved.pose(0.8 * path.duration), shift * path.pose(0.8 * path.duration), 1e-9)
    u, h = begin + x * (end - begin), 1e-6
    if abs(path.next_breakpoint(u - 3.0 * h) - u) < 4.0 * h:
        return
    change = np.asarray(pin.log6(moved.pose(u - h).actInv(moved.pose(u + h))).vector) / (2.0 * h)
    np.testing.assert_allclose(moved.twist(u), change, atol=1e-3)


def test_a_length_along_a_path_and_its_end() -> None:
    start = pin.SE3.Identity()
    path = LinePath.displaced(start, translation=(0.5, 0.0, 0.0), duration=2.0, time_law="linear")
    assert clock_after(path, 0.4, 0.1) == pytest.approx(0.8, abs=1e-6)
    assert clock_after(path, 1.9, 0.1) == 2.0
    assert clock_after(HoldPath(start), 0.0, 0.1) == 0.0


def test_sections_and_shifts_of_nothing_are_refused() -> None:
    path = LinePath.displaced(pin.SE3.Identity(), translation=(0.5, 0.0, 0.0), duration=2.0)
    for begin, end in ((0.5, 0.5), (-0.1, 1.0), (0.0, 2.1), (np.nan, 1.0)):
        with pytest.raises(InvalidInputError):
            Section(path, begin, end)
    with pytest.raises(InvalidInputError, match="before it begins"):
        ShiftedPath(path, pin.SE3.Identity(), begin=1.0, end=0.5)


@given(plans, shares)
def test_a_plan_is_at_its_grid_points_and_between_them_at_their_clocks(path: TimedPath, x: float) -> None:
    np.testing.assert_allclose(path.clocks(path.profile.s), path.profile.clocks, atol=1e-6 * path.duration)
    clock = x * path.duration
    s = path.at(clock)[0]
    (found,) = path.clocks(np.array([s]))
    assert abs(path.at(float(found))[0] - s) <= 1e-12
    assert abs(found - clock) <= 1e-5 * path.duration  # near its ends the object hardly moves


def test_a_shifted_path_without_its_shifts_is_the_same_with_them(rng: np.random.Generator) -> None:
    """Also back, and along a part in which a shift comes in: what the core is given."""
    path: ObjectPath = LinePath.displaced(
        pin.SE3.Identity(), translation=(0.1, 0.2, 0.3), rotation=(0.2, 0.4, 0.3), duration=2.0
    )
    for begin, end in ((0.3, 0.8), (0.6, 1.9), (1.0, 1.2)):
        path = ShiftedPath(path, pin.exp6(0.1 * rng.normal(size=6)), begin=begin, end=end)
    for part in (path, Section(path, 0.5, 1.5), Section(path, 1.5, 0.25)):
        base, shifts = unshifted(part)
        assert len(shifts) == 3
        for clock in np.linspace(0.0, part.duration, 41):
            T = base.pose(clock)
            for begin, end, *log in shifts:
                T = pin.exp6(TimeLaw.QUINTIC.value_at((clock - begin) / (end - begin)) * np.array(log)) * T
            np.testing.assert_allclose(T.homogeneous, part.pose(clock).homogeneous, atol=1e-12)
