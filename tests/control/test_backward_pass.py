"""How fast the object may be at a knot: the largest z of a program of two variables, against another solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from coopqp.control.lookahead.backward_pass import Interval, Share, largest_alone, largest_square

pytestmark = pytest.mark.core
DOUBT = 0.3


def random_interval(rng: Any, joints: int) -> tuple[Interval, Any]:
    span = float(10.0 ** rng.uniform(-4.0, -1.5))
    slope = rng.normal(size=joints) * rng.choice([0.0, 1e-6, 0.3, 1.0], joints)
    chord = rng.normal(size=joints) * 10.0 ** rng.uniform(-2.0, 2.0)
    bend, bend_ahead = (chord * rng.normal(1.0, 0.2, joints) for _ in range(2))
    fall, rise = rng.choice([9.0, 0.5], 2)
    return Interval(span, slope, slope + chord * span, chord, bend, bend_ahead, fall, rise), rng.uniform(
        1.0, 9.0, joints
    )


def lines(interval: Interval, a: Any, ahead: float) -> tuple[Any, Any]:
    """The same program as rows of (z, u), straight from the module's description."""
    span, slope, arrival, chord, bend, bend_ahead, fall, rise = interval
    e = DOUBT * (np.abs(bend - chord) + np.abs(bend_ahead - chord))
    rows, most = [], []
    for B in (bend, chord):
        for sign in (1.0, -1.0):  # ±(q′ u + B z) + e z ≤ a
            rows += [*np.stack([sign * B + e, sign * slope], axis=1)]
            most += [*a]
    for B in (bend_ahead, chord):
        for sign in (1.0, -1.0):  # the same at the second knot, where z is z + 2 h u
            rows += [*np.stack([sign * B + e, sign * (arrival + 2 * span * B) + 2 * span * e], axis=1)]
            most += [*a]
    rows += [[0.0, 1.0], [0.0, -1.0], [1.0, 2 * span], [-1.0, -2 * span]]
    return np.array(rows), np.array([*most, rise, fall, ahead, 0.0])


@pytest.mark.parametrize("seed", range(60))
def test_the_largest_square_is_that_of_a_linear_program(seed: int) -> None:
    rng = np.random.default_rng(seed)
    interval, a = random_interval(rng, int(rng.integers(1, 12)))
    cap, ahead = float(rng.uniform(0.01, 1.0)), float(rng.choice([0.0, 0.01, 0.3, 1.0]))
    rows, most = lines(interval, a, ahead)
    found = linprog([-1.0, 0.0], rows, most, bounds=[(0.0, cap), (None, None)], method="highs")
    assert found.success
    share = largest_square(interval, a, cap, ahead, doubt=DOUBT)
    assert share.square == pytest.approx(float(found.x[0]), rel=1e-6, abs=1e-7)
    if share.square < cap:
        assert share.ahead or share.joint >= 0
    if not share.ahead:  # then more room at the next knot changes nothing
        assert largest_square(interval, a, cap, ahead + 1.0, doubt=DOUBT).square == pytest.approx(
            share.square, rel=1e-9
        )


@pytest.mark.parametrize("seed", range(20))
def test_the_largest_square_of_one_knot(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 12))
    slope, bend, a = rng.normal(size=n), rng.normal(size=n) * 10.0, rng.uniform(1.0, 9.0, n)
    rows = np.array([[s * bend[j], s * slope[j]] for j in range(n) for s in (1.0, -1.0)])
    found = linprog([-1.0, 0.0], rows, np.repeat(a, 2), bounds=[(0.0, 1.0), (-9.0, 9.0)], method="highs")
    assert largest_alone(slope, bend, a, 9.0, 1.0) == pytest.approx(float(found.x[0]), rel=1e-6)


def largest(interval: Interval, a: Any, ahead: float) -> Share:
    return largest_square(interval, a, 1.0, ahead, doubt=DOUBT)


@pytest.mark.parametrize("seed", range(60))
def test_the_largest_square_follows_the_one_ahead_along_a_line(seed: int) -> None:
    """With the same slope up to the end of the piece, and beyond it with a smaller one."""
    rng = np.random.default_rng(seed)
    interval, a = random_interval(rng, int(rng.integers(1, 12)))
    ahead = float(rng.choice([0.0, 0.01, 0.3]))
    share = largest(interval, a, ahead)
    if share.gain == 0.0:  # it never falls again: the backward pass ends here for good
        assert share.until == np.inf
        assert largest(interval, a, 2.0).square == pytest.approx(share.square, rel=1e-9)
        return
    assert share.gain > 0.0
    end = min(share.until, 2.0)
    assert end >= ahead
    for further in np.linspace(ahead, end, 5):
        expected = share.square + share.gain * (further - ahead)
        assert largest(interval, a, float(further)).square == pytest.approx(expected, rel=1e-9, abs=1e-12)
    if share.until < 2.0:
        beyond = share.until + 0.1
        assert largest(interval, a, beyond).square < share.square + share.gain * (beyond - ahead) - 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_a_rate_that_may_not_change_stays_as_it_is(seed: int) -> None:
    """Where a constraint allows no change, z is what it is ahead; never a rounding error below 0, which has no root."""
    rng = np.random.default_rng(seed)
    interval, a = random_interval(rng, int(rng.integers(1, 12)))
    interval = interval._replace(fall=0.0, rise=0.0)
    top = largest(interval, a, 2.0).square
    for ahead in rng.uniform(0.0, top, 5):
        assert largest(interval, a, float(ahead)).square == pytest.approx(float(ahead), abs=1e-12)
    for cap in rng.uniform(0.0, 1.0, 20):
        assert 0.0 <= largest_square(interval, a, float(cap), 0.0, doubt=DOUBT).square < 1e-12
