"""A user's path behind checks: faults have a sentence, jumps and corners a clock, and the library's own pass."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from user_paths import Jumping, Marked, OnlyMarked, Opaque

from coopqp import InvalidInputError, LinePath, ObjectPath, WaypointPath
from coopqp.paths.guarded import GuardedPath, jump, pose_distance, twist_distance
from coopqp.spatial import Array

H = 0.01
START = pin.SE3.Identity()
LINE = LinePath(START, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), duration=1.0, time_law="linear")
ZIGZAG = WaypointPath([START, LINE.goal, START], durations=[0.3, 0.7], time_law="linear")


def jumping(at: float, by: float, path: ObjectPath = LINE) -> GuardedPath:
    """A guarded path that jumps sideways at a clock [s], by a distance [m]."""
    return GuardedPath(Jumping(path, at, np.array([0.0, by, 0.0])))


def result(search: Generator[None, None, Any]) -> tuple[Any, int]:
    """What a search finds, and how often it paused."""
    pauses = 0
    while True:
        try:
            next(search)
        except StopIteration as done:
            return done.value, pauses
        pauses += 1


def test_distances_of_poses_and_twists_count_a_turn_of_1_rad_as_30_cm() -> None:
    T = pin.SE3(pin.exp3(np.array([0.0, 0.5, 0.0])), np.array([0.3, 0.0, -0.4]))
    assert pose_distance(START, T) == pytest.approx(0.5 + 0.3 * 0.5)
    assert pose_distance(T, START) == pytest.approx(0.5 + 0.3 * 0.5)
    assert pose_distance(T, T) == pytest.approx(0.0, abs=1e-8)
    assert pose_distance(START, pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))) == pytest.approx(0.3 * np.pi)
    assert twist_distance(np.ones(6), np.array([1.0, 4.0, 5.0, 1.0, 1.0, 3.0])) == pytest.approx(5.0 + 0.3 * 2.0)


@pytest.mark.parametrize(
    ("far", "says"),
    [
        (0.998, "the path jumps by 998 mm at its clock 1.235 s (a turn of 1 rad counts as 0.3 m)"),
        (1.0, "the path jumps by 1 m at its clock 1.235 s (a turn of 1 rad counts as 0.3 m)"),
        (2.5, "the path jumps by 2.5 m at its clock 1.235 s (a turn of 1 rad counts as 0.3 m)"),
        (-0.998, "the path is too steep at its clock 1.235 s: it moves by 998 mm within 1 µs"),
    ],
)
def test_a_jump_is_told_with_its_distance_and_clock(far: float, says: str) -> None:
    assert jump(far, 1.23456) == says


@pytest.mark.parametrize("at", [0.1, 0.37, 0.9])
def test_a_jump_is_found_at_its_clock(at: float) -> None:
    found, pauses = result(jumping(at, 0.25).jumps(at - 0.004, at + 0.005))
    assert found[0] == pytest.approx(at, abs=1e-10)
    assert found[1] == pytest.approx(0.25, abs=1e-6)
    assert 20 < pauses < 40


class Steep(Opaque):
    """It moves aside by a distance [m] within a time [s], from a clock on [s]."""

    def __init__(self, at: float, by: float, within: float) -> None:
        super().__init__(LINE)
        self._at, self._by, self._within = at, by, within

    def pose(self, clock: float) -> pin.SE3:
        share = float(np.clip((clock - self._at) / self._within, 0.0, 1.0))
        pose = LINE.pose(clock)
        return pin.SE3(pose.rotation, pose.translation + np.array([0.0, share * self._by, 0.0]))


def test_a_path_that_is_only_too_steep_does_not_jump() -> None:
    (clock, far), _ = result(GuardedPath(Steep(0.5, 0.2, 4e-7)).jumps(0.497, 0.502))
    assert clock == pytest.approx(0.5, abs=1e-6)
    assert far == pytest.approx(-0.2, rel=0.5)
    assert result(GuardedPath(Steep(0.5, 0.2, 0.02)).jumps(0.49, 0.53))[0] is None  # 10 m/s are no jump
    assert result(GuardedPath(Steep(0.5, 0.2, 0.004)).jumps(0.499, 0.505))[0] is None  # fast, but no jump


def test_where_nothing_jumps_no_jump_is_found() -> None:
    assert result(GuardedPath(Opaque(LINE)).jumps(0.2, 0.4)) == (None, 0)
    assert result(jumping(0.3, 1e-5).jumps(0.3 - 1e-9, 0.3 + 1e-9)) == (None, 0)  # less than 0.05 mm


def test_a_corner_is_found_at_its_clock() -> None:
    path = GuardedPath(Opaque(ZIGZAG))
    for span in ((0.29, 0.31), (0.2999, 0.4), (0.25, 0.30001)):
        assert path.kink(*span) == pytest.approx(0.3, abs=5e-11)
    assert path.kink(0.1, 0.2) is None
    smooth = LinePath(START, LINE.goal, duration=1.0)  # its twist changes, without a corner
    assert GuardedPath(Opaque(smooth)).kink(0.1, 0.2) is None
    assert GuardedPath(ZIGZAG).kink(0.29, 0.31) is None  # the library's own tell their corners
    assert result(path.kinks(0.29, 0.31))[1] > 20


def test_breakpoints_are_those_before_the_end_that_go_on() -> None:
    assert GuardedPath(OnlyMarked(LINE, 0.2, 0.7)).breakpoints() == [0.2, 0.7]
    assert GuardedPath(Marked(ZIGZAG, mark=0.6)).breakpoints() == [0.3, 0.6]
    assert GuardedPath(ZIGZAG).breakpoints() == [0.3]
    assert GuardedPath(LINE).breakpoints() == []


class Wrong(Opaque):
    """It gives a value, or raises it, from a clock on [s]."""

    def __init__(self, kind: str, value: Any, *, at: float = 0.0) -> None:
        super().__init__(LINE)
        self._kind, self._value, self._at = kind, value, at

    def _given(self, kind: str, clock: float, value: Any) -> Any:
        if kind != self._kind or clock < self._at:
            return value
        if isinstance(self._value, Exception):
            raise self._value
        return self._value

    def pose(self, clock: float) -> pin.SE3:
        pose: pin.SE3 = self._given("pose", clock, super().pose(clock))
        return pose

    def twist(self, clock: float) -> Array:
        twist: Array = self._given("twist", clock, super().twist(clock))
        return twist


FAR = pin.SE3(np.eye(3), np.array([0.0, -2e9, 0.0]))
SHEARED = pin.SE3(np.eye(3) + np.eye(3, k=1), np.zeros(3))


@pytest.mark.parametrize(
    ("kind", "value", "says"),
    [
        ("pose", ValueError("no"), "the path raised ValueError: no at its clock 0.5 s"),
        ("pose", None, "the path's pose at its clock 0.5 s is a NoneType, no pinocchio.SE3"),
        ("pose", FAR, "the path's pose at its clock 0.5 s is 2e+09 m away"),
        ("pose", SHEARED, "the path's pose at its clock 0.5 s is no placement: "),
        ("twist", KeyError("x"), "the path raised KeyError: 'x' at its clock 0.5 s"),
        ("twist", np.zeros(5), "the path's twist at its clock 0.5 s is no twist: "),
        ("twist", np.array([0.0, 0.0, -1e9, 0.0, 0.0, 0.0]), "the path's twist at its clock 0.5 s is 1e+09"),
    ],
)
def test_a_bad_value_is_none_with_a_sentence_until_the_next_good_one(kind: str, value: Any, says: str) -> None:
    path = GuardedPath(Wrong(kind, value, at=0.5))
    ask = getattr(path, kind)
    assert ask(0.4) is not None
    assert path.problem == ""
    assert ask(0.5) is None
    assert path.problem.startswith(says)
    assert says.endswith(": ") or path.problem == says
    assert ask(0.4) is not None
    assert path.problem == ""
    assert path.asked == 3


@pytest.mark.parametrize(
    ("at", "by", "says"),
    [
        (2.0, 0.3, ""),
        (0.505, 0.3, "the path jumps by 300 mm at its clock 0.500 s"),  # within the step ahead
        (0.495, 0.3, "the path jumps by 300 mm at its clock 0.500 s"),  # since the step before
        (0.505, 0.1, ""),  # 20 m/s and less
        (0.505, 3.0, "the path jumps by 3 m at its clock 0.500 s"),
    ],
)
def test_a_step_over_a_jump_is_trouble(at: float, by: float, says: str) -> None:
    told, away = jumping(at, by).trouble(0.5, H, LINE.pose(0.5), 0.0)
    assert told.startswith(says)
    assert bool(told) == bool(says)
    assert away == pytest.approx(0.0, abs=1e-7)


def test_the_distance_of_the_object_from_its_path_is_told_on() -> None:
    path, held = GuardedPath(Opaque(LINE)), pin.SE3(np.eye(3), np.array([0.25, 0.0, 0.1]))
    for before in (np.inf, 0.05):
        told, away = path.trouble(0.5, H, held, before)
        assert told == ""
        assert away == pytest.approx(0.1)
    assert GuardedPath(LINE).trouble(0.5, H, held, 7.0) == ("", 7.0)  # the library's own are not asked
    for clock in (0.5, 0.495):  # here, and at the end of the step
        told, away = GuardedPath(Wrong("pose", None, at=0.5)).trouble(clock, H, held, 7.0)
        assert "is a NoneType" in told
        assert away == 7.0


def test_only_a_users_path_is_asked_and_counted() -> None:
    own, users = GuardedPath(LINE), GuardedPath(Opaque(LINE))
    for path in (own, users):
        path.check("here")
        motion = path.motion(0.5)
        assert motion is not None
        np.testing.assert_allclose(motion, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    assert not own.own
    assert own.asked == 0
    assert users.own
    assert users.asked > 9


class Odd(Opaque):
    """It has attributes that a test chooses."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(LINE)
        for name, value in attributes.items():
            setattr(self, name, value)


@pytest.mark.parametrize(
    ("path", "says"),
    [
        (3, "the path is a int"),
        (Odd(duration=0.0), "the path's duration is 0 s"),
        (Odd(duration=-1.0), "the path's duration is -1 s"),
        (Odd(duration=np.nan), "the path's duration is nan s"),
        (Odd(duration="long"), "cannot be read: ValueError"),
        (Odd(planned_share=1.5), "cannot be read: .*planned_share"),
        (Odd(elbows=3), "cannot be read: TypeError: elbows is no Elbows"),
        (Odd(grasps=3), "cannot be read: TypeError: grasps is no GraspMotion"),
        (Wrong("pose", None, at=1.0), "pose at its clock 1 s is a NoneType"),
        (Wrong("twist", np.zeros(5), at=1.0), "twist at its clock 1 s is no twist"),
        (Wrong("twist", np.array([0.0, 0.5, 0, 0, 0, 0])), r"twist is \[.*\], but its poses change by \[.*\] a second"),
        (Wrong("twist", np.array([0.5, 0, 0, 0, 0, 0.4])), r"twist is \[.*\], but its poses change by \[.*\] a second"),
        (Wrong("twist", np.zeros(6)), r"at its clock 0.8756 s the path's twist is \[0. 0. 0. 0. 0. 0.\]"),
    ],
)
def test_a_bad_path_is_refused_with_what_is_wrong(path: Any, says: str) -> None:
    with pytest.raises(InvalidInputError, match=says) as error:
        GuardedPath(path).check("here")
    assert "here" in str(error.value)


@pytest.mark.parametrize(
    "path",
    [
        Wrong("twist", np.array([0.52, 0, 0, 0, 0, 0])),  # within 10 % of both
        Wrong("twist", np.zeros(6), at=0.7),  # wrong at less than half of the clocks
        Odd(duration=np.inf),
        Odd(planned_share=0.5),
        Jumping(LINE, 0.3, np.ones(3)),
    ],
)
def test_a_path_that_is_mostly_right_is_taken(path: ObjectPath) -> None:
    GuardedPath(path).check("here")


def test_a_path_that_is_not_known_ahead_is_asked_at_its_start_alone() -> None:
    path = GuardedPath(Opaque(LINE, known_ahead=False))
    path.check("here")
    assert path.asked == 2
