"""The box of admissible joint velocities: it is never empty, joints stop in time, and it names the binding limit.

The tests simulate the joints' motion as an oracle. The joints of a box are independent, so one box holds many states.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from coopqp.core._core import RECOVERY_SHARE
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from coopqp import BindingLimit, JointLimits, LimitKind, RobotCell
from coopqp.control.step.velocity_bounds import VelocityBox

Array = NDArray[np.float64]
STEPS = [0.001, 0.002, 0.01]  # [s]
OVERSHOOT = 1e-6  # [rad]


def box_of(lower: Any, upper: Any, velocity: Any, acceleration: Any) -> VelocityBox:
    """A box of joints without a cell."""
    arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in (lower, upper, velocity, acceleration)))
    limits = JointLimits(*(np.atleast_1d(a) for a in arrays))
    n = len(limits.lower)
    names = tuple(f"arm/joint_{j}" for j in range(n))
    return VelocityBox(SimpleNamespace(limits=limits, nv=n, joint_names=names))  # type: ignore[arg-type]


def random_box(rng: np.random.Generator, n: int, *, unlimited: float = 0.2) -> VelocityBox:
    """Limits over several orders of magnitude; a share of them is missing."""

    def missing(values: Array, sign: float = 1.0) -> Array:
        return np.where(rng.uniform(size=n) < unlimited, sign * np.inf, values)

    middle, half = rng.normal(size=n), 10.0 ** rng.uniform(-4, 1, n)
    return box_of(
        missing(middle - half, -1.0),
        missing(middle + half),
        missing(10.0 ** rng.uniform(-2, 1, n)),
        missing(10.0 ** rng.uniform(-2, 3, n)),
    )


def limits_of(box: VelocityBox) -> JointLimits:
    return box.limits


def random_positions(box: VelocityBox, rng: np.random.Generator) -> Array:
    """Inside, at a limit, a little outside and far outside."""
    limits = limits_of(box)
    low = np.where(np.isfinite(limits.lower), limits.lower, np.minimum(limits.upper, 0.0) - 3.0)
    high = np.where(np.isfinite(limits.upper), limits.upper, np.maximum(low, 0.0) + 3.0)
    choices = np.array(
        [rng.uniform(low, high), low, high, low - 10.0 ** rng.uniform(-9, 1, len(low)), high + 1e-3, high - 1e-12]
    )
    return np.asarray(choices[rng.integers(len(choices), size=len(low)), np.arange(len(low))])


# -- never empty -------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.floats(1e-5, 1.0))
def test_the_box_is_never_empty(seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng, 500)
    x = random_positions(box, rng)
    v = rng.choice([0.0, 1.0], 500) * rng.normal(size=500) * 10.0 ** rng.uniform(-6, 2, 500)
    x_before, v_before = x.copy(), v.copy()
    with np.errstate(invalid="ignore"):
        box.update(x, v, dt)
    assert not np.isnan(box.lower).any()
    assert not np.isnan(box.upper).any()
    assert (box.lower <= box.upper).all()
    reach = limits_of(box).acceleration * dt
    slack = 1e-12 * (1.0 + np.abs(v))
    assert (box.upper <= v + reach + slack).all(), "acceleration wins"
    assert (box.lower >= v - reach - slack).all(), "acceleration wins"
    assert np.array_equal(x, x_before)
    assert np.array_equal(v, v_before)


@given(st.integers(0, 2**32 - 1), st.sampled_from(STEPS))
def test_at_rest_the_box_keeps_every_limit(seed: int, dt: float) -> None:
    """From rest, every velocity in the box keeps the velocity and position limits. Zero is always in the box."""
    rng = np.random.default_rng(seed)
    box = random_box(rng, 500)
    limits, x = limits_of(box), random_positions(box, rng)
    with np.errstate(invalid="ignore"):
        box.update(x, np.zeros(500), dt)
    assert (box.lower <= 0.0).all()
    assert (box.upper >= 0.0).all()
    assert (box.upper <= limits.velocity).all()
    assert (-box.lower <= limits.velocity).all()
    above, below = x > limits.upper, x < limits.lower
    assert (box.upper[above] == 0.0).all()
    assert (box.lower[below] == 0.0).all()
    assert np.array_equal(box.outside, above | below)
    inside = ~box.outside
    rounding = 1e-14 * (1.0 + np.abs(x))
    assert (x + box.upper * dt <= limits.upper + rounding)[inside].all()
    assert (x + box.lower * dt >= limits.lower - rounding)[inside].all()


@given(st.integers(0, 2**32 - 1), st.sampled_from(STEPS))
def test_a_joint_has_its_own_box_whatever_the_others_have(seed: int, dt: float) -> None:
    """The box of a joint is the same if all, some or no other joints have acceleration limits."""
    rng = np.random.default_rng(seed)
    n = 50
    v = rng.normal(size=n)
    low, high = np.where(rng.uniform(size=(2, n)) < 0.2, np.inf, 10.0 ** rng.uniform(-6, 1, (2, n))) * [[-1], [1]]
    x = np.where(rng.uniform(size=n) < 0.1, np.where(np.isfinite(high), high, 0.0) + 0.01, 0.0)
    speed, acceleration = 10.0 ** rng.uniform(-2, 1, n), 10.0 ** rng.uniform(-2, 3, n)
    together = box_of(low, high, speed, acceleration)
    together.update(x, v, dt)
    more = box_of(
        *(
            np.append(limit, last)
            for limit, last in zip((low, high, speed, acceleration), (-1.0, 1.0, 1.0, np.inf), strict=True)
        )
    )
    more.update(np.append(x, 0.0), np.append(v, 0.0), dt)
    for name in ("lower", "upper", "recovery", "outside"):
        np.testing.assert_allclose(getattr(together, name), getattr(more, name)[:n], rtol=1e-13, atol=1e-300)
    assert together.any_outside == together.outside.any()


@pytest.mark.parametrize("dt", [1e-3, 0.01])
def test_without_any_limit_a_joint_moves_by_so_much_in_a_step_and_a_hold_brakes_it(dt: float) -> None:
    box = box_of([-np.inf] * 3, np.inf, np.inf, np.inf)
    x, v = np.array([0.0, 1e6, -1e6]), np.array([0.0, 4.0, -1e9])
    box.update(x, v, dt)
    np.testing.assert_allclose(dt * box.upper, 0.05)
    np.testing.assert_array_equal(box.lower, -box.upper)
    assert box.kind_of(1, 1.0, v, dt) is LimitKind.VELOCITY
    box.update(x, v, dt, hold=True)
    np.testing.assert_allclose(box.upper, [1.0, 2.0, 0.05 / dt])  # half as fast in each step, down to 1 rad/s
    np.testing.assert_array_equal(box.lower, -box.upper)
    assert not box.accelerates
    assert not box.outside.any()


def test_without_acceleration_limits_the_last_step_ends_at_the_limit() -> None:
    box = box_of([-1.0, -1.0, -np.inf], [1.0, 1.0, 2.0], [3.0, np.inf, np.inf], np.inf)
    box.update(np.array([0.99, -0.5, 0.0]), np.full(3, 99.0), 0.01)
    np.testing.assert_allclose(box.upper, [1.0, 5.0, 5.0], rtol=1e-12)  # 0.05 rad in a step without a velocity limit
    np.testing.assert_allclose(box.lower, [-3.0, -5.0, -5.0], rtol=1e-12)


# -- stopping distance -------------------------------------------------------------------------------------------------


def stoppable(box: VelocityBox, x: Array, rng: np.random.Generator, dt: float) -> Array:
    """Random velocities from which the joints can stop: v dt + v²/(2a) ≤ the remaining distance."""
    limits = limits_of(box)
    a = limits.acceleration
    sides = []
    for distance in (limits.upper - x, x - limits.lower):
        with np.errstate(over="ignore", invalid="ignore"):
            top = np.where(np.isfinite(a), -a * dt + np.sqrt((a * dt) ** 2 + 2.0 * a * distance), distance / dt)
        sides.append(np.minimum(np.minimum(top, limits.velocity), 10.0))
    return np.asarray(rng.uniform(-sides[1], sides[0]))


@given(st.floats(1e-4, 1.0), st.floats(1e-3, 10.0), st.floats(1e-2, 1e3), st.sampled_from(STEPS), st.floats(0.0, 1.0))
def test_full_braking_from_the_bound_ends_before_the_limit(
    distance: float, speed: float, acceleration: float, dt: float, share: float
) -> None:
    """With full braking from the bound v dt + v²/(2a) ≤ d the joint stops before the limit."""
    box = box_of([-1e3], [0.0], [speed], [acceleration])
    box.update(np.array([-distance]), np.array([speed]), dt)  # this bound does not depend on the velocity
    v = min(speed, -acceleration * dt + np.sqrt((acceleration * dt) ** 2 + 2.0 * acceleration * distance)) * share
    x = -distance + v * dt
    steps = int(np.ceil(v / (acceleration * dt))) + 1
    travelled = v * dt + sum(max(v - i * acceleration * dt, 0.0) * dt for i in range(1, min(steps, 3000)))
    assert -distance + travelled <= 1e-9
    box.update(np.array([x]), np.array([v]), dt)
    assert box.lower[0] <= max(v - acceleration * dt, -speed) + 1e-12, "full braking is in the box"


@pytest.mark.parametrize("dt", STEPS)
def test_the_bound_is_tight(dt: float) -> None:
    distance, a = np.logspace(-6, 0, 50), 2.0
    box = box_of(np.full(50, -10.0), np.zeros(50), np.inf, a)
    free = np.full(50, 1e3)
    v = np.asarray([box_of([-10.0], [0.0], [np.inf], [a])._stopping_speed(np.array([d]), dt)[0] for d in distance])
    np.testing.assert_allclose(v * dt + v * v / (2 * a), distance, rtol=1e-12)
    box.update(-distance, free, dt)
    np.testing.assert_allclose(box.upper, free - a * dt)  # too fast to stop: full braking


def test_acceleration_wins_over_position_and_velocity() -> None:
    a, dt = 5.0, 0.01
    box = box_of([-1.0] * 4, 1.0, 2.0, a)
    v = np.array([3.0, -3.0, 1.5, -1.5])
    box.update(np.array([0.0, 0.0, 0.999, -0.999]), v, dt)
    np.testing.assert_allclose(box.upper, [2.95, -2.95, 1.45, -1.45], rtol=1e-12)
    np.testing.assert_allclose(box.lower, box.upper, rtol=1e-12)


# -- from outside ------------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.sampled_from(STEPS), st.floats(1e-9, 0.5), st.booleans())
def test_from_outside_no_further_out(seed: int, dt: float, away: float, accelerates: bool) -> None:
    """From rest, for every choice in the box, the distance never grows, and a joint inside stays inside."""
    rng = np.random.default_rng(seed)
    n = 100
    side = rng.choice([-1.0, 1.0], n)
    a: Any = 10.0 ** rng.uniform(-1, 2, n) if accelerates else np.inf
    box = box_of([-1.0] * n, 1.0, rng.uniform(0.1, 5.0, n), a)
    x, v = side * (1.0 + away), np.zeros(n)
    excess = np.abs(x) - 1.0
    for _ in range(60):
        box.update(x, v, dt)
        v = box.lower + rng.uniform(size=n) * (box.upper - box.lower)
        x = x + v * dt
        now = np.maximum(np.abs(x) - 1.0, 0.0)
        assert (now <= np.maximum(excess, OVERSHOOT)).all()
        excess = now


def test_outside_and_moving_out_brakes_as_hard_as_allowed() -> None:
    a, dt = 4.0, 0.01
    box = box_of([-1.0, -1.0], 1.0, 2.0, a)
    x, v = np.array([1.1, -1.1]), np.array([1.0, -1.0])
    for step in range(1, 60):
        box.update(x, v, dt)
        v = np.where(x > 0, box.upper, box.lower)
        x = x + v * dt
        assert v[0] == pytest.approx(max(1.0 - step * a * dt, 0.0), abs=1e-12)
        assert v[1] == -v[0]


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("acceleration", [np.inf, 5.0, 100.0])
@pytest.mark.parametrize("away", [1e-5, 1e-3, 0.2])
def test_recovery_leads_back_in(dt: float, acceleration: float, away: float) -> None:
    speed = 2.0
    box = box_of([-1.0] * 4, 1.0, speed, acceleration)
    x, v = np.array([1.0 + away, -1.0 - away, 0.5, -1.0]), np.zeros(4)
    share = RECOVERY_SHARE * speed
    allowed = 1.35 * (away / share + share / acceleration) + 12 * dt
    for _ in range(int(allowed / dt) + 2):
        box.update(x, v, dt)
        if not box.outside.any():
            break
        assert (box.lower <= box.recovery).all()
        assert (box.recovery <= box.upper).all()
        assert (np.abs(box.recovery) <= share + acceleration * dt + 1e-12).all() or np.isinf(acceleration)
        assert (box.recovery[2:] == 0.0).all()
        v = box.recovery.copy()
        x = x + v * dt
    assert not box.outside.any()
    assert (np.abs(x) <= 1.0).all()
    box.update(x, v, dt)
    assert not box.recovery.any()


def test_recovery_is_zero_elsewhere_even_without_limits() -> None:
    """A joint without limits gets no recovery velocity while another joint is outside."""
    box = box_of([-1.0, -np.inf, -np.inf, 0.0], [1.0, np.inf, 1.0, np.inf], 2.0, [10.0, 10.0, np.inf, np.inf])
    box.update(np.array([1.5, 0.0, 0.0, 0.0]), np.zeros(4), 0.01)
    assert box.recovery[0] < 0.0
    assert np.array_equal(box.recovery[1:], np.zeros(3))


# -- rates that a box admits ------------------------------------------------------------------------------------------


# -- names -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("x", "v", "sign", "kind"),
    [
        (0.0, 2.0, 1.0, LimitKind.VELOCITY),
        (0.0, -2.0, -1.0, LimitKind.VELOCITY),
        (0.0, 0.0, 1.0, LimitKind.ACCELERATION),
        (0.0, 0.0, -1.0, LimitKind.ACCELERATION),
        (0.0, 1.0, -1.0, LimitKind.ACCELERATION),
        (0.0, 3.0, 1.0, LimitKind.ACCELERATION),  # too fast: the acceleration limit binds
        (1.0, 0.0, 1.0, LimitKind.POSITION),
        (-1.0, 0.0, -1.0, LimitKind.POSITION),
        (1.2, 0.0, 1.0, LimitKind.POSITION),
        (0.9999, 0.01, 1.0, LimitKind.POSITION),  # braking distance
        (-0.9999, -0.01, -1.0, LimitKind.POSITION),
    ],
)
def test_kind_of_names_the_limit_that_binds(x: float, v: float, sign: float, kind: LimitKind) -> None:
    dt = 0.01
    box = box_of([-1.0], [1.0], [2.0], [5.0])
    v_prev = np.array([v])
    box.update(np.array([x]), v_prev, dt)
    assert box.kind_of(0, sign, v_prev, dt) is kind


@given(st.integers(0, 2**32 - 1), st.sampled_from(STEPS))
def test_without_that_limit_the_bound_is_wider(seed: int, dt: float) -> None:
    """Without the named limit, the bound is wider."""
    rng = np.random.default_rng(seed)
    lower, upper, speed, acceleration = -1.0, 1.0, rng.uniform(0.5, 3.0), rng.uniform(1.0, 50.0)
    box = box_of([lower], [upper], [speed], [acceleration])
    x = np.array([rng.choice([rng.uniform(-1, 1), 1 - 1e-4, -1 + 1e-4])])
    v = stoppable(box, x, rng, dt)
    box.update(x, v, dt)
    for sign in (1.0, -1.0):
        kind, bound = box.kind_of(0, sign, v, dt), sign * (box.upper if sign > 0 else box.lower)[0]
        without = {  # the acceleration limit also determines braking: do not remove it alone
            LimitKind.POSITION: box_of([-1e5], [1e5], [speed], [acceleration]),
            LimitKind.VELOCITY: box_of([lower], [upper], [1e5], [acceleration]),
        }
        for other, freed in without.items():
            freed.update(x, v, dt)
            moved = sign * (freed.upper if sign > 0 else freed.lower)[0]
            assert moved > bound if other is kind else moved >= bound - 1e-12


def test_names_of_what_binds(mixed_cell: RobotCell) -> None:
    box = VelocityBox(mixed_cell)
    low, high, at_rest = mixed_cell.limits.lower, mixed_cell.limits.upper, np.zeros(mixed_cell.nv)
    middle = np.zeros(mixed_cell.nv)
    np.add(0.5 * low, 0.5 * high, out=middle, where=np.isfinite(high))
    box.update(middle, at_rest, 0.01)
    limit = box.binding(7, 1.0, at_rest, 0.01)
    assert limit == BindingLimit("1_rx90l", "joint_1", LimitKind.VELOCITY)
    assert str(limit) == "arm 1_rx90l joint joint_1: velocity"
    assert str(BindingLimit("left", "", LimitKind.REACH)) == "arm left: reach"
    for j, name in enumerate(mixed_cell.joint_names):
        assert name == "{0.arm}/{0.joint}".format(box.binding(j, -1.0, at_rest, 0.01))


def test_a_cells_own_limits(mixed_cell: RobotCell) -> None:
    """The continuous joint has no position limit at any angle."""
    box = VelocityBox(mixed_cell)
    x = np.zeros(mixed_cell.nv)
    x[-1] = 1e4
    box.update(x, np.zeros(mixed_cell.nv), 0.001)
    assert box.upper[-1] == -box.lower[-1] == mixed_cell.limits.velocity[-1]
    assert not box.outside.any()
