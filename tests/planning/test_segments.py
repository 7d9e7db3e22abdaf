"""Segments of a path by shares: poses, twists and bounds per share, knots and clocks."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import LinePath, WaypointPath
from coopqp.constraints.samples import sample_path
from coopqp.paths.geometry import blended
from coopqp.paths.segments import Segments, segments_of
from coopqp.planning.tools_on_object import ToolPiece
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array


def way(count: int = 3, **options: Any) -> WaypointPath:
    rng = np.random.default_rng(11)
    poses = [pin.SE3(pin.exp3(rng.normal(size=3) * 0.4), rng.normal(size=3) * 0.2) for _ in range(count + 1)]
    return WaypointPath(poses, durations=[0.5 + i for i in range(count)], **options)


def rounded() -> Segments:
    """Lines and blends of different lengths."""
    geometry = blended([s for x in way().segments if (s := x.straight())], distance=0.05, angle=0.1)
    n = len(geometry.pieces)
    return Segments(geometry.pieces, np.arange(float(n)), np.ones(n), np.zeros(n, dtype=bool))


def tool_piece(low: float = 0.1, high: float = 0.8, length: float = 1.7) -> ToolPiece:
    """A tool that moves and turns on an object that does."""
    rng = np.random.default_rng(4)

    def segment() -> Array:
        R = pin.exp3(rng.normal(size=3))
        return np.concatenate([R.ravel(), *(0.5 * rng.normal(size=(3, 3))), np.zeros(11)])

    A, X = (pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3)) for _ in range(2))
    return ToolPiece(segment(), A, segment(), X, low, high, length)


def of_a_tool() -> Segments:
    pieces = (tool_piece(), tool_piece(0.0, 1.0, 0.6))
    return Segments(pieces, np.arange(2.0), np.ones(2), np.zeros(2, dtype=bool))


@pytest.mark.parametrize("make", [rounded, of_a_tool])
def test_twists_per_share_are_the_change_of_poses(make: Any) -> None:
    segments, h = make(), 1e-5
    segment = np.repeat(np.arange(len(segments)), 7)[::-1].copy()  # in any order
    share = np.tile(np.linspace(0.1, 0.9, 7), len(segments))
    T, after, before = (segments.poses(segment, share + step) for step in (0.0, h, -h))
    V, dV = segments.twists(segment, share)
    turn = [pin.log3(b[:3, :3] @ a[:3, :3].T) / (2.0 * h) for a, b in zip(before, after, strict=True)]
    np.testing.assert_allclose(V[:, :3], (after - before)[:, :3, 3] / (2.0 * h), atol=1e-7)
    np.testing.assert_allclose(V[:, 3:], turn, atol=1e-7)
    ahead, behind = (segments.twists(segment, share + step)[0] for step in (h, -h))
    np.testing.assert_allclose(dV, (ahead - behind) / (2.0 * h), atol=1e-6)
    np.testing.assert_array_equal(T[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (len(T), 1)))


@pytest.mark.parametrize("make", [rounded, of_a_tool])
def test_bounds_per_share_hold_at_dense_samples_and_are_no_guess(make: Any) -> None:
    segments, h = make(), 1e-3
    n = len(segments)
    every = np.arange(n)
    bounds = segments.bounds(every, np.full(n, 0.25), np.full(n, 0.5))
    share = np.linspace(0.25 + h, 0.5 - h, 60)
    for i in range(n):
        at = np.full(60, i)
        V = segments.twists(at, share)[0]
        slopes = [segments.twists(at, share + step)[1] for step in (h, -h)]
        third = (slopes[0] - slopes[1]) / (2.0 * h)
        for rows, bound in (
            (V[:, :3], bounds.way[i]),
            (V[:, 3:], bounds.turn[i]),
            (third[:, :3], bounds.way_change[i]),
            (third[:, 3:], bounds.turn_change[i]),
        ):
            most = float(np.linalg.norm(rows, axis=1).max())
            assert most <= bound * (1.0 + 1e-3) + 1e-5
            assert bound <= 30.0 * most + 1e-4


def test_the_bounds_of_a_tool_are_exact_where_only_one_of_both_moves() -> None:
    piece = tool_piece()
    still = np.concatenate([np.eye(3).ravel(), np.zeros(20)])
    slid = still.copy()
    slid[15:18] = 0.3, 0.0, 0.4
    per = (0.8 - 0.1) / 1.7
    ends = np.zeros(1), np.array([1.7])
    for object_, tool in ((slid, still), (still, slid)):
        alone = ToolPiece(object_, piece.A, tool, piece.X, 0.1, 0.8, 1.7).bounds(*ends)
        assert alone.way[0] == pytest.approx(0.5 * per)
        assert alone.turn[0] == alone.way_change[0] == alone.turn_change[0] == 0.0
    turned = still.copy()
    turned[12:15] = 0.0, 0.0, 2.0
    spun = ToolPiece(still, pin.SE3.Identity(), turned, pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), 0.1, 0.8, 1.7)
    bounds = spun.bounds(*ends)
    assert bounds.turn[0] == pytest.approx(2.0 * per)
    assert bounds.way[0] == pytest.approx(0.5 * 2.0 * per)
    assert bounds.way_change[0] == pytest.approx(0.5 * 8.0 * per**3)
    assert bounds.turn_change[0] == 0.0


def test_a_tool_on_an_object_is_where_both_take_it() -> None:
    piece = tool_piece()
    o, t = piece.object, piece.tool

    def moved(segment: Array, u: float) -> pin.SE3:
        R = segment[:9].reshape(3, 3) @ pin.exp3(u * segment[12:15])
        return pin.SE3(R, segment[9:12] + u * segment[15:18])

    R, p = piece.poses(np.linspace(0.0, 1.7, 5))
    for i, u in enumerate(np.linspace(0.1, 0.8, 5)):
        T = moved(o, u) * piece.A * moved(t, u) * piece.X
        np.testing.assert_allclose(R[i], T.rotation, atol=1e-12)
        np.testing.assert_allclose(p[i], T.translation, atol=1e-12)


@pytest.mark.parametrize("time_law", ["linear", "quintic"])
def test_clocks_of_shares_are_those_at_which_the_path_is_there(time_law: str) -> None:
    path = way(time_law=time_law)
    segments = segments_of(path)
    assert segments is not None
    segment, share = np.repeat(np.arange(3), 9), np.tile(np.linspace(0.0, 1.0, 9), 3)
    poses = segments.poses(segment, share)
    clocks = segments.clocks(segment, share)
    assert clocks[0] == 0.0
    assert clocks[-1] == pytest.approx(path.duration)
    for clock, T in zip(clocks, poses, strict=True):
        np.testing.assert_allclose(path.pose(float(clock)).homogeneous, T, atol=1e-9)


@pytest.mark.parametrize(("distance", "angle"), [(0.02, 1.0), (1.0, 0.05)])
def test_knots_are_close_in_space_and_in_time(distance: float, angle: float) -> None:
    """Of a tool beside the object's origin, whose way is longer than the object's."""
    path = way(time_law="quintic")
    segments = segments_of(path)
    assert segments is not None
    X = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
    segment, share = segments.knots(X, distance=distance, angle=angle, pieces=4)
    T = segments.poses(segment, share) @ X.homogeneous
    away = max(np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in itertools.pairwise(T))
    turn = max(np.linalg.norm(pin.log3(a[:3, :3].T @ b[:3, :3])) for a, b in itertools.pairwise(T))
    assert away <= distance
    assert turn <= angle * (1.0 + 1e-9)
    assert away > 0.4 * distance or turn > 0.8 * angle
    clocks = segments.clocks(segment, share)
    assert (np.diff(clocks) > 0.0).all()
    for s in range(3):
        own = clocks[segment == s]
        assert own[-1] == pytest.approx(segments.start[s] + segments.duration[s])
        assert np.diff(own).max() <= segments.duration[s] / 12.0 * 1.3


def test_a_short_line_has_its_least_number_of_pieces() -> None:
    start = paper_lift().path.pose(0.0)
    path = LinePath.displaced(start, translation=(0.0, 0.0, 1e-3), duration=1.0, time_law="linear")
    segments = segments_of(path)
    assert segments is not None
    segment, share = segments.knots(pin.SE3.Identity(), distance=0.03, angle=0.1, pieces=4)
    np.testing.assert_array_equal(segment, np.zeros(5))
    np.testing.assert_allclose(share, [0.0, 0.25, 0.5, 0.75, 1.0])
    assert len(sample_path(path, paper_lift().grasp).clocks) > 1


def test_places_are_split_into_segments_and_shares() -> None:
    segments = segments_of(way())
    assert segments is not None
    segment, share = segments.split(np.array([0.0, 0.25, 1.0, 2.75, 3.0]))
    np.testing.assert_array_equal(segment, [0, 0, 1, 2, 2])
    np.testing.assert_allclose(share, [0.0, 0.25, 0.0, 0.75, 1.0])
