"""Blends and straight pieces: twists are derivatives, bounds hold and are no guesses, numbers come back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import InvalidInputError
from coopqp.paths.geometry import Blend, Straight, piece_of

SIZES = pytest.mark.parametrize("size", [0.0, 0.3, 2.0, 8.0])


def blend(rng: np.random.Generator, size: float) -> Blend:
    """A blend whose lines turn by about this much [rad]."""
    turns = rng.normal(size=(2, 3))
    turns *= size / np.linalg.norm(turns, axis=1)[:, None]
    return Blend(pin.exp3(rng.normal(size=3)), rng.normal(size=3), turns, rng.normal(size=(2, 3)), 0.7)


def straight(rng: np.random.Generator, size: float) -> Straight:
    turn = rng.normal(size=3)
    turn *= size / np.linalg.norm(turn)
    return Straight(pin.exp3(rng.normal(size=3)), rng.normal(size=3), turn, rng.normal(size=3), 0.7)


MADE = pytest.mark.parametrize("made", [blend, straight])


@SIZES
@MADE
def test_twists_and_their_changes_are_derivatives(rng: np.random.Generator, made: Any, size: float) -> None:
    piece, h = made(rng, size), 1e-6
    s = np.linspace(0.01, 0.69, 9)
    V, dV = piece.twists(s)
    np.testing.assert_allclose(dV, (piece.twists(s + h)[0] - piece.twists(s - h)[0]) / (2.0 * h), atol=1e-4)
    for at, twist in zip(s.tolist(), V, strict=True):
        before, after = piece.pose(at - h), piece.pose(at + h)
        np.testing.assert_allclose(twist[:3], (after.translation - before.translation) / (2.0 * h), atol=1e-6)
        np.testing.assert_allclose(twist[3:], pin.log3(after.rotation @ before.rotation.T) / (2.0 * h), atol=1e-6)
        np.testing.assert_allclose(piece.twist(at), twist, atol=1e-12)
        R, p = piece.poses(np.array([at]))
        assert piece.pose(at).isApprox(pin.SE3(R[0], p[0]), 1e-12)


@SIZES
@MADE
def test_bounds_of_a_piece_hold_on_each_stretch(rng: np.random.Generator, made: Any, size: float) -> None:
    piece, h = made(rng, size), 1e-5
    low = np.linspace(0.0, 0.6, 13)
    high = low + 0.1
    bounds = piece.bounds(low, high)
    for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        s = np.linspace(a, b, 11).clip(h, 0.7 - h)
        V = piece.twists(s)[0]
        change = (piece.twists(s + h)[1] - piece.twists(s - h)[1]) / (2.0 * h)
        for part, bound in ((V[:, :3], bounds.way[i]), (V[:, 3:], bounds.turn[i])):
            assert np.linalg.norm(part, axis=1).max() <= bound * (1.0 + 1e-9)
        for part, bound in ((change[:, :3], bounds.way_change[i]), (change[:, 3:], bounds.turn_change[i])):
            assert np.linalg.norm(part, axis=1).max() <= bound * (1.0 + 1e-3) + 1e-5


@pytest.mark.parametrize("place", [1e-9, 0.25, 0.5, 0.75, 1.0 - 1e-9])
def test_bounds_of_a_stretch_of_no_length_are_the_terms_at_its_place(rng: np.random.Generator, place: float) -> None:
    """By the text of Blend.bounds, with the ramp's derivatives by hand."""
    piece = blend(rng, 1.5)
    s, half = np.array([0.7 * place]), 0.35
    x = 2.0 * place - 1.0
    beta = np.poly1d([-1.0 / 16.0, 0.0, 3.0 / 8.0, 0.5, 3.0 / 16.0])
    b1, b2, b3 = (float(beta.deriv(n)(x)) for n in (1, 2, 3))
    a, a1 = abs(x - float(beta(x))), 1.0 - b1
    (e0, e1), (w0, w1) = piece.ways, piece.turns
    c, norm = np.linalg.norm(np.cross(w0, w1)), np.linalg.norm
    bounds = piece.bounds(s, s)
    np.testing.assert_allclose(bounds.way, (a1 * norm(e0) + b1 * norm(e1)) / half)
    np.testing.assert_allclose(bounds.turn, (a1 * norm(w0) + b1 * norm(w1)) / half)
    np.testing.assert_allclose(bounds.way_change, abs(b3) * norm(e1 - e0) / half**3)
    most = abs(b3) * (norm(w1 - w0) + a * c) + b2 * max(2.0 * a1, b1) * c + a1 * a1 * b1 * norm(w0) * c
    np.testing.assert_allclose(bounds.turn_change, most / half**3)


@MADE
def test_a_piece_comes_back_from_its_numbers_bit_for_bit(rng: np.random.Generator, made: Any) -> None:
    piece = made(rng, 0.5)
    again = piece_of(piece.numbers())
    assert type(again) is type(piece)
    assert again.numbers().tobytes() == piece.numbers().tobytes()
    assert again.pose(0.3) == piece.pose(0.3)


@MADE
def test_numbers_of_no_piece_are_refused(rng: np.random.Generator, made: Any) -> None:
    good = made(rng, 0.5).numbers()
    for place, value in ((-1, 0.0), (-1, -0.7), (-1, np.nan), (10, np.inf), (0, 2.0)):
        bad = good.copy()
        bad[place] = value
        with pytest.raises(InvalidInputError, match="piece of a geometry"):
            piece_of(bad)
    for bad in (good[:-1], good[None], np.append(good, 1.0)):
        with pytest.raises(InvalidInputError, match="not 19 or 25 finite numbers"):
            piece_of(bad)
