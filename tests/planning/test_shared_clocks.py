"""Object and tool on one clock: which share they have in common, and where both stand while the other moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import LinePath
from coopqp.paths.grasp_motion import GraspPiece
from coopqp.paths.moving_grasps import pieces_of
from coopqp.planning.tools_on_object import common_share
from coopqp.spatial import Array


def motion(start: float = 1.0, duration: float = 2.0, law: float = 0.0, first: float = 0.0) -> Array:
    """The numbers of a segment: by (0.3, 0, 0.4) m and 0.5 rad."""
    segment = np.zeros(29)
    segment[:9] = pin.exp3(np.array([0.2, 0.1, 0.0])).ravel()
    segment[9:12], segment[12:15], segment[15:18] = (1.0, 2.0, 3.0), (0.0, 0.0, 0.5), (0.3, 0.0, 0.4)
    segment[18:22] = start, duration, law, first
    return segment


def placed(segment: Array, u: float) -> tuple[Array, Array]:
    return segment[:9].reshape(3, 3) @ pin.exp3(u * segment[12:15]), segment[9:12] + u * segment[15:18]


def tool(segment: Array) -> GraspPiece:
    return GraspPiece(pin.SE3.Identity(), pin.SE3.Identity(), segment)


@pytest.mark.parametrize(
    ("law", "shares"), [(0.0, (0.25, 0.75)), (1.0, (0.103515625, 0.896484375)), (3.0, (0.15625, 0.65625))]
)
def test_a_moving_object_leads_a_tool_that_rests(law: float, shares: tuple[float, float]) -> None:
    """From a quarter to three quarters of its time; a law that begins faster or slower begins with half the speed."""
    object_ = motion(law=law, first=0.5)
    found = common_share(object_, None, 1.5, 2.5)
    assert found is not None
    (row, other, low, high), time = found
    np.testing.assert_array_equal(row, object_)
    assert not other[12:18].any()
    assert (low, high) == pytest.approx(shares)
    for clock in np.linspace(1.0, 3.0, 9):
        u = time.share(clock)
        assert time.clocks(np.array([u]))[0] == pytest.approx(clock, abs=1e-6)
    assert time.share(0.0) == 0.0
    assert time.share(9.0) == 1.0


@pytest.mark.parametrize(("a", "b", "u"), [(0.0, 1.0, 0.0), (3.0, 4.0, 1.0)])
def test_what_rests_stands_at_the_end_of_its_motion_that_is_nearer(a: float, b: float, u: float) -> None:
    object_, moving = motion(), motion(start=0.0, duration=4.0)
    found = common_share(object_, tool(moving), a, b)
    assert found is not None
    (row, other, low, high), _ = found
    R, p = placed(object_, u)
    np.testing.assert_allclose(row[:9].reshape(3, 3), R)
    np.testing.assert_allclose(row[9:12], p)
    assert not row[12:18].any()
    np.testing.assert_array_equal(other, moving)
    assert (low, high) == pytest.approx((a / 4.0, b / 4.0))


def test_where_both_rest_time_goes_by_evenly() -> None:
    found = common_share(motion(), tool(motion(start=5.0)), 3.0, 4.5)
    assert found is not None
    (row, other, low, high), time = found
    assert not row[12:18].any()
    assert not other[12:18].any()
    np.testing.assert_allclose(other[9:12], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(row[9:12], [1.3, 2.0, 3.4])
    assert (low, high) == (0.0, 1.0)
    assert [time.share(clock) for clock in (3.0, 3.75, 4.5)] == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize(
    "other", [{"start": 0.9}, {"duration": 2.1}, {"law": 1.0}, {"law": 3.0, "first": 0.5}], ids=str
)
def test_two_motions_share_a_clock_only_if_it_is_the_same(other: dict[str, Any]) -> None:
    assert common_share(motion(), tool(motion()), 1.2, 1.8) is not None
    assert common_share(motion(), tool(motion(**other)), 1.2, 1.8) is None


def test_a_law_that_is_not_known_is_not_shared() -> None:
    assert common_share(motion(law=2.0), None, 1.2, 1.8) is None


def test_a_line_of_a_tool_is_the_line_it_was_made_of() -> None:
    line = LinePath(pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0])), duration=2.0)
    (piece,) = pieces_of(line, start=1.0, before=pin.SE3.Identity(), frame=pin.SE3.Identity(), where="")
    found = common_share(motion(start=7.0), piece, 1.0, 3.0)
    assert found is not None
    (_, other, low, high), time = found
    assert (low, high) == pytest.approx((0.0, 1.0))
    u = time.share(1.8)
    np.testing.assert_allclose(placed(other, u)[1], line.pose(0.8).translation, atol=1e-12)
