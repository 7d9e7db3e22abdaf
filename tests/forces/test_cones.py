"""Points under limits on norms: nearest and furthest ones in closed form, and polyhedra inside the limits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from coopqp.forces.cones import Cone, Cones
from coopqp.spatial import Array


def ball(centre: Array, radius: float, *, per_value: Array | None = None, size: float = 1.0) -> Cone:
    """``|y − centre − value · per_value| ≤ radius``, both sides times a size."""
    n = len(centre)
    last = np.zeros(n) if per_value is None else -per_value
    return Cone(size * np.column_stack([np.eye(n), last]), -size * centre, np.zeros(n + 1), size * radius)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_nearest_point_of_a_ball(n: int, size: float) -> None:
    """Whatever the units of a limit; a target inside stays."""
    rng = np.random.default_rng(n)
    centre, target = rng.normal(size=n), 3.0 * rng.normal(size=n)
    away = target - centre
    for radius in (0.5, 2.0 * float(np.linalg.norm(away))):
        found = Cones([ball(centre, radius, size=size)]).nearest(target, 0.0)
        assert found is not None
        expected = centre + away * min(1.0, radius / float(np.linalg.norm(away)))
        np.testing.assert_allclose(found, expected, atol=1e-4 * radius)
        assert np.linalg.norm(found - centre) <= radius * (1.0 + 1e-8) + 2e-9


def test_weights_count_in_the_distance() -> None:
    """On ``y_0 + y_1 ≤ 1`` the way there is shared as one over the weights."""
    plane = Cone(np.zeros((1, 3)), np.zeros(1), np.array([-1.0, -1.0, 0.0]), 1.0)
    box = ball(np.zeros(2), 100.0)
    found = Cones([plane, box]).nearest(np.array([3.0, 2.0]), 0.0, weights=np.array([1.0, 3.0]))
    assert found is not None
    np.testing.assert_allclose(found, [3.0 - 4.0 * 0.75, 2.0 - 4.0 * 0.25], atol=1e-7)


def test_a_friction_cone_is_met_where_the_nearest_point_lies_on_it() -> None:
    """``|(x, y)| ≤ μ z``: from a point beside it square to the side; from below, the tip."""
    mu = 0.5
    cone = Cone(np.eye(4)[:2], np.zeros(2), mu * np.eye(4)[2], 0.0)
    cones = Cones([cone, ball(np.zeros(3), 1e3)])
    side = np.array([0.6 * mu, 0.8 * mu, 1.0]) / np.hypot(mu, 1.0)
    for target in (np.array([3.0, 4.0, 2.0]), np.array([6.0, 8.0, -1.0])):
        found = cones.nearest(target, 0.0)
        assert found is not None
        np.testing.assert_allclose(found, side * (side @ target), atol=2e-4)
    tip = cones.nearest(np.array([0.1, 0.0, -3.0]), 0.0)
    assert tip is not None
    np.testing.assert_allclose(tip, 0.0, atol=1e-3)


def test_the_value_shifts_the_limits_and_none_is_found_where_they_do_not_meet() -> None:
    way = np.array([0.6, 0.8])
    cones = Cones([ball(np.zeros(2), 1.0), ball(np.zeros(2), 0.5, per_value=3.0 * way)])
    found = cones.nearest(np.zeros(2), 0.4)
    assert found is not None
    np.testing.assert_allclose(found, 0.7 * way, atol=1e-4)
    assert cones.nearest(np.zeros(2), 0.51) is None
    largest = cones.largest()
    assert largest is not None
    np.testing.assert_allclose(largest[0], way, atol=1e-3)
    assert 0.5 - 2e-7 < largest[1] <= 0.5 + 1e-8
    whole = Cones([ball(np.zeros(2), 4.0), ball(np.zeros(2), 0.5, per_value=3.0 * way)]).largest()
    assert whole is not None
    assert whole[1] > 1.0 - 2e-7
    apart = Cones([ball(np.zeros(2), 1.0), ball(np.array([3.0, 0.0]), 0.5)])
    assert apart.largest() is None


def test_without_a_target_for_the_value_it_is_a_coordinate_as_others() -> None:
    cones = Cones(
        [ball(np.zeros(2), 0.5, per_value=np.array([1.0, 0.0])), Cone(np.eye(3)[2:], np.zeros(1), np.zeros(3), 2.0)]
    )
    found = cones.nearest(np.array([3.0, 0.0, 9.0]))
    assert found is not None
    np.testing.assert_allclose(found, [2.5, 0.0, 2.0], atol=1e-6)


def test_the_used_share_of_a_limit() -> None:
    """Of a norm, of friction, and of a least force: floor over what stands on it; nothing used of nothing is none."""
    norm = Cone(2.0 * np.eye(3)[:2], np.zeros(2), np.zeros(3), 20.0)
    friction = Cone(np.eye(3)[:1], np.zeros(1), np.array([0.0, 0.5, 0.0]), 0.0)
    floor = Cone(np.zeros((1, 3)), np.zeros(1), np.array([0.0, 1.0, 0.0]), -2.0)
    used = Cones([norm, friction, floor]).use(np.array([3.0, 8.0]), 1.0)
    np.testing.assert_allclose(used, [np.hypot(3.0, 8.0) / 10.0, 0.75, 0.25])
    np.testing.assert_allclose(Cones([norm, friction]).use(np.array([0.0, 0.0]), 0.0), [0.0, 0.0])
    np.testing.assert_array_equal(Cones([friction, floor]).use(np.array([1.0, -1.0]), 0.0), [np.inf, np.inf])
    shifted = Cone(np.eye(3)[:1], np.array([1.0]), np.zeros(3), 4.0)
    np.testing.assert_allclose(Cones([shifted]).use(np.array([1.0, 0.0]), 0.0), [0.5])


def reach(way: Array) -> float:
    """How far a polyhedron inside the unit ball goes in a direction."""
    cone = Cone(np.column_stack([way, np.zeros(len(way))]), np.zeros(len(way)), np.zeros(2), 1.0)
    found = Cones([cone], inside=True).nearest(np.array([10.0]), 0.0)
    assert found is not None
    return float(found[0])


@pytest.mark.parametrize(("n", "least"), [(1, 1.0), (2, np.cos(np.pi / 16.0)), (3, 0.93)])
def test_a_polyhedron_inside_a_ball_leaves_little_of_it(n: int, least: float) -> None:
    rng = np.random.default_rng(n)
    ways = rng.normal(size=(150, n))
    found = np.array([reach(way / np.linalg.norm(way)) for way in ways])
    assert found.max() <= 1.0 + 1e-8
    assert found.min() >= least - 1e-8
    assert found.max() > 0.985, "its corners are on the ball"


def test_the_polyhedron_in_three_dimensions_is_that_of_an_icosahedron() -> None:
    """The planes across corners and edges are the closest ones, all alike; it is the same from all sides."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corner = np.array([0.0, 1.0, golden])
    edge = np.array([0.0, 0.0, 1.0])
    closest = reach(edge)
    assert 0.93 < closest < 0.95
    for way in (corner, edge, np.array([golden, 1.0, golden + 1.0])):
        for shift, signs in itertools.product(range(3), itertools.product((1.0, -1.0), repeat=3)):
            turned = np.roll(way * signs, shift)
            assert reach(turned / np.linalg.norm(turned)) == pytest.approx(closest, abs=1e-8)


def test_limits_with_an_offset_and_friction_are_kept_from_inside() -> None:
    """A ball that is not at the origin, and a friction cone: points inside keep them and nearly use them."""
    rng, centre = np.random.default_rng(0), np.array([1.0, -2.0, 0.5])
    inside = Cones([ball(centre, 2.0)], inside=True)
    cone = Cone(np.eye(4)[:2], np.zeros(2), 0.5 * np.eye(4)[2], 0.0)
    friction = Cones([cone, Cone(np.eye(4)[2:3], np.zeros(1), np.zeros(4), 4.0)], inside=True)
    for way in rng.normal(size=(20, 3)):
        found = inside.nearest(centre + 50.0 * way, 0.0)
        assert found is not None
        assert 0.92 * 2.0 < np.linalg.norm(found - centre) <= 2.0 + 1e-8
        pushed = friction.nearest(np.array([*(9.0 * way[:2] / np.linalg.norm(way[:2])), 4.0]), 0.0)
        assert pushed is not None
        assert 0.97 * 0.5 * pushed[2] < np.linalg.norm(pushed[:2]) <= 0.5 * pushed[2] + 1e-8
    assert inside.nearest(np.zeros(3), 0.0) is not None
