"""A motion of redundant arms: positions and speeds belong together, and its turning points are its extremes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from coopqp import InvalidInputError
from coopqp.paths.elbows import Elbows


def random_motion(rng: np.random.Generator, size: float, *, clocks: int = 4, nv: int = 5) -> Elbows:
    """A motion whose joints turn between grid points."""
    t = np.cumsum(rng.uniform(0.2, 1.0, clocks))
    return Elbows(t, size * rng.normal(size=(clocks, nv)), 3.0 * size * rng.normal(size=(clocks, nv)))


@pytest.mark.parametrize("size", [1e-3, 0.1, 3.0])
def test_turning_points_are_the_extremes_of_the_motion(rng: np.random.Generator, size: float) -> None:
    motion = random_motion(rng, size)
    found = motion.turning_points()
    dense = np.array([motion.at(t)[0] for t in np.linspace(motion.clocks[0], motion.clocks[-1], 4001)])
    np.testing.assert_array_equal(found[0], motion.x.min(axis=0))
    np.testing.assert_array_equal(found[1], motion.x.max(axis=0))
    np.testing.assert_allclose(found.min(axis=0), dense.min(axis=0), atol=1e-5 * size)
    np.testing.assert_allclose(found.max(axis=0), dense.max(axis=0), atol=1e-5 * size)


def test_turning_points_of_a_parabola_and_of_a_line() -> None:
    """x = t (1 − t) turns at ½, and t and 2 do not turn."""
    motion = Elbows(
        np.array([0.0, 1.0]), np.array([[0.0, 0.0, 2.0], [0.0, 1.0, 2.0]]), np.array([[1, 1, 0], [-1, 1, 0]])
    )
    found = motion.turning_points()
    np.testing.assert_allclose(found.max(axis=0), [0.25, 1.0, 2.0], atol=1e-15)
    np.testing.assert_allclose(found.min(axis=0), [0.0, 0.0, 2.0], atol=1e-15)


def test_speeds_are_the_change_of_positions_and_the_ends_are_kept(rng: np.random.Generator) -> None:
    motion, h = random_motion(rng, 1.0), 1e-6
    for clock in rng.uniform(motion.clocks[0] + h, motion.clocks[-1] - h, 20).tolist():
        change = (motion.at(clock + h)[0] - motion.at(clock - h)[0]) / (2.0 * h)
        np.testing.assert_allclose(motion.at(clock)[1], change, atol=1e-3)
    for clock, x, v in zip(motion.clocks.tolist(), motion.x, motion.slopes, strict=True):
        np.testing.assert_allclose(motion.at(clock), (x, v), atol=1e-12)
    np.testing.assert_allclose(motion.at(motion.clocks[0] - 9.0), (motion.x[0], motion.slopes[0]), atol=1e-12)
    np.testing.assert_allclose(motion.at(motion.clocks[-1] + 9.0), (motion.x[-1], motion.slopes[-1]), atol=1e-12)


def test_a_motion_through_positions_does_not_overshoot(rng: np.random.Generator) -> None:
    clocks, x = np.array([0.0, 0.5, 0.7, 2.0]), rng.normal(size=(4, 3))
    motion = Elbows.through(clocks, x)
    np.testing.assert_array_equal(motion.x, x)
    low, high, lowest, highest = motion.turning_points()
    assert (lowest >= low - 1e-12).all()
    assert (highest <= high + 1e-12).all()


def test_a_motion_comes_back_from_its_record_bit_for_bit(rng: np.random.Generator) -> None:
    motion = random_motion(rng, 1.0)
    again = Elbows.of_record(motion.record())
    assert again.record() == motion.record()
    packed = np.concatenate([motion.clocks, motion.x.ravel(), motion.slopes.ravel()])
    np.testing.assert_array_equal(again.packed(), packed)


def test_a_smoothed_motion_has_the_same_ends_and_smaller_kinks() -> None:
    clocks = np.array([1.0, 2.0, 3.0])
    kinked = Elbows.through(clocks, np.array([[0.0, 5.0], [1.0, 5.0], [0.0, 5.0]]))
    smooth = kinked.smoothed()
    t = np.linspace(1.0, 3.0, 201)
    x, y = (np.array([motion.at(clock)[0] for clock in t.tolist()]) for motion in (kinked, smooth))
    np.testing.assert_allclose(y[[0, -1]], x[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(y[:, 1], 5.0, atol=1e-12)
    assert 1e-3 < np.abs(y - x).max() < 0.05
    np.testing.assert_allclose(y, y[::-1], atol=1e-9)


RECORD: dict[str, Any] = {"clocks": [0.0, 1.0], "x": [[0.0], [1.0]], "slopes": [[0.0], [0.0]]}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"x": [[0.0], [np.nan]]}, "positions and speeds"),
        ({"slopes": [[0.0], [np.inf]]}, "positions and speeds"),
        ({"slopes": [[0.0]]}, "positions and speeds"),
        ({"clocks": [0.0, 0.0]}, "the clocks do not rise"),
        ({"clocks": [1.0, 0.0]}, "the clocks do not rise"),
        ({"clocks": [0.0, np.nan]}, "the clocks do not rise"),
        ({"clocks": [0.0, 1.0, 2.0]}, "one a row"),
        ({"clocks": [[0.0, 1.0]]}, "one a row"),
        ({"x": [0.0, 1.0], "slopes": [0.0, 0.0]}, "one a row"),
        ({"clocks": [0.0], "x": [[0.0]], "slopes": [[0.0]]}, "one a row"),
    ],
)
def test_a_record_of_no_motion_is_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidInputError, match=says):
        Elbows.of_record(RECORD | change)
    if "positions" not in says:
        with pytest.raises(InvalidInputError, match=says):
            Elbows.through((RECORD | change)["clocks"], (RECORD | change)["x"])


def test_slopes_are_those_of_scipy(rng: np.random.Generator) -> None:
    for _ in range(50):
        k = int(rng.integers(2, 12))
        clocks, x = np.cumsum(rng.uniform(0.01, 1.0, k)), rng.integers(-1, 2, (k, 5)) * rng.uniform(size=(k, 5))
        expected = PchipInterpolator(clocks, x).derivative()(clocks)
        np.testing.assert_allclose(Elbows.through(clocks, x).slopes, expected, rtol=1e-12, atol=1e-12)
