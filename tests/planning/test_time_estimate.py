"""About how long a motion takes, where textbooks know it exactly."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp import JointLimits
from coopqp.planning.route.duration import estimated_duration, estimated_squares


def limits(v: float, a: float, n: int = 2) -> JointLimits:
    return JointLimits(np.full(n, -10.0), np.full(n, 10.0), np.full(n, v), np.full(n, a))


def straight(length: float, count: int = 401) -> tuple[np.ndarray, np.ndarray]:
    """Two joints along a line, the second one half as far; s is a tenth of the first one's way."""
    way = np.linspace(0.0, length, count)
    return 0.1 * way, np.column_stack([way, 0.5 * way])


@pytest.mark.parametrize(
    ("v", "a", "expected"),
    [
        (0.5, 2.0, 1.0 / 0.5 + 0.5 / 2.0),  # L/v + v/a
        (100.0, 2.0, 2.0 * np.sqrt(1.0 / 2.0)),  # 2 √(L/a)
        (100.0, 8.0, 2.0 * np.sqrt(1.0 / 8.0)),
    ],
)
def test_a_straight_way_takes_as_long_as_a_trapezium(v: float, a: float, expected: float) -> None:
    assert estimated_duration(limits(v, a), *straight(1.0)) == pytest.approx(expected, rel=5e-3)


def test_the_fastest_speeds_are_those_of_the_trapezium() -> None:
    s, x = straight(1.0)
    squares = estimated_squares(limits(0.5, 2.0), s, x)
    way = 10.0 * s
    expected = np.minimum(0.25, np.minimum(4.0 * way, 4.0 * (1.0 - way))) / 100.0
    np.testing.assert_allclose(squares, expected, atol=1e-9)


def test_round_a_circle_bends_use_up_four_fifths_of_the_acceleration() -> None:
    """Speed² over the radius is at most 0.8 of the limit, wherever a joint bends most."""
    angle = np.linspace(0.0, 4.0 * np.pi, 4001)
    x = 0.3 * np.column_stack([np.cos(angle), np.sin(angle)])
    squares = estimated_squares(limits(100.0, 2.0), 0.3 * angle, x)
    aligned = [1000, 1500, 2000, 2500, 3000]  # one joint has all of the bend
    np.testing.assert_allclose(squares[aligned], 0.8 * 2.0 * 0.3, rtol=2e-3)


def test_from_a_speed_at_the_start_it_takes_less_time() -> None:
    s, x = straight(1.0)
    squares = estimated_squares(limits(0.5, 2.0), s, x, speed=0.03)
    assert squares[0] == pytest.approx(0.03**2)
    assert squares[-1] == 0.0
    moving, rest = (estimated_duration(limits(0.5, 2.0), s, x, speed=v) for v in (0.03, 0.0))
    # To 0.5 rad/s it takes 0.1 s instead of 0.25 s, over 0.04 rad instead of 0.0625 rad.
    assert rest - moving == pytest.approx(0.15 - (0.0625 - 0.04) / 0.5, abs=5e-3)


def test_a_start_too_fast_to_stop_costs_a_second_a_hundredth() -> None:
    s, x = straight(1.0)
    slow = limits(100.0, 0.02)  # from 0.2 rad/s at most
    start = np.sqrt(2.0 * 0.02) / 10.0
    squares = estimated_squares(slow, s, x, speed=2.0 * start)
    assert squares[0] == pytest.approx(start**2)
    stopping = 1.0 / (5.0 * start)
    assert estimated_duration(slow, s, x, speed=2.0 * start) == pytest.approx(50.0 + stopping, rel=5e-3)
