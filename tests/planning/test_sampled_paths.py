"""Geometry of a path that is known by poses and twists alone, against that of the same path's own lines."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from user_paths import Marked, Opaque

from coopqp import HoldPath, InvalidInputError, WaypointPath
from coopqp.paths import PathGeometry
from coopqp.planning.sampled import sampled_geometry


def lines(time_law: str) -> WaypointPath:
    poses = [
        pin.SE3(pin.exp3(np.array(turn)), np.array(p))
        for turn, p in (
            ([0.1, 0.0, 0.2], [0.3, 0.1, 0.5]),
            ([0.4, -0.3, 0.2], [0.35, 0.3, 0.6]),
            ([0.0, -0.3, 0.5], [0.3, 0.4, 0.4]),
        )
    ]
    return WaypointPath(poses, durations=[1.3, 0.7], time_law=time_law)


def pair(time_law: str) -> tuple[PathGeometry, PathGeometry]:
    known = lines(time_law)
    own, sampled = known.geometry(), sampled_geometry(Marked(known))
    assert own is not None
    assert sampled is not None
    return own, sampled


@pytest.mark.parametrize("time_law", ["linear", "quintic"])
def test_pieces_have_the_length_and_the_poses_of_the_lines(time_law: str) -> None:
    own, sampled = pair(time_law)
    assert len(sampled.pieces) == 2
    for mine, its in zip(own.pieces, sampled.pieces, strict=True):
        assert its.length == pytest.approx(mine.length, rel=1e-5)
        share = np.linspace(0.0, 1.0, 23)
        R, p = mine.poses(share * mine.length)
        S, r = its.poses(share * its.length)
        np.testing.assert_allclose(r, p, atol=1e-5)
        np.testing.assert_allclose(S, R, atol=1e-5)
        np.testing.assert_allclose(r[[0, -1]], p[[0, -1]], atol=1e-9)


@pytest.mark.parametrize("time_law", ["linear", "quintic"])
def test_twists_are_those_of_the_lines_and_the_change_of_poses(time_law: str) -> None:
    own, sampled = pair(time_law)
    share = np.linspace(0.02, 0.98, 25)
    for mine, its in zip(own.pieces, sampled.pieces, strict=True):
        V = its.twists(share * its.length)[0]
        np.testing.assert_allclose(V, mine.twists(share * mine.length)[0], atol=2e-3)
        h = 1e-5 * its.length
        change = (its.poses(share * its.length + h)[1] - its.poses(share * its.length - h)[1]) / (2.0 * h)
        np.testing.assert_allclose(V[:, :3], change, atol=1e-6)
        V_ends = its.twists(np.array([0.0, its.length]))[0]
        np.testing.assert_allclose(V_ends, mine.twists(np.array([0.0, mine.length]))[0], atol=2e-2)


@pytest.mark.parametrize("time_law", ["linear", "quintic"])
def test_derivatives_of_twists_are_their_differences(time_law: str) -> None:
    _, sampled = pair(time_law)
    share = np.linspace(0.02, 0.98, 25)
    for piece in sampled.pieces:
        h = 1e-4 * piece.length
        ahead, behind = (piece.twists(share * piece.length + way)[0] for way in (h, -h))
        slope = piece.twists(share * piece.length)[1]
        np.testing.assert_allclose(slope, (ahead - behind) / (2.0 * h), atol=2e-2)


def test_a_path_that_stays_has_no_geometry() -> None:
    assert sampled_geometry(Opaque(HoldPath(pin.SE3.Identity(), duration=1.0))) is None


def test_a_rest_in_between_is_no_piece() -> None:
    poses = [pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in (0.0, 0.1, 0.1, 0.3)]
    known = WaypointPath(poses, durations=[1.0, 0.5, 1.0])
    sampled = sampled_geometry(Marked(known))
    assert sampled is not None
    np.testing.assert_allclose([piece.length for piece in sampled.pieces], [0.1, 0.2], rtol=1e-5)


def test_pieces_of_ones_own_path_are_not_written() -> None:
    _, sampled = pair("quintic")
    with pytest.raises(InvalidInputError, match=r"path of your own cannot be written.*Give lines or placements"):
        sampled.pieces[0].numbers()
