"""Whatever the rates, lags and delays: what is sent keeps velocity and acceleration limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from coopqp.core import _core
from coopqp.drivers.command_spline import CommandSpline
from coopqp.drivers.limited_clock import LimitedClock
from coopqp.drivers.play_out import PlayOut

_JOINTS, _PERIOD, _ROUNDING = 4, 0.002, 1e-9


def _commands(rng, velocity, acceleration, number):
    """Commands of a controller that uses its limits up: it changes its mind every 80 ms."""
    x, speed, goal, found = np.zeros(_JOINTS), np.zeros(_JOINTS), np.zeros(_JOINTS), [np.zeros(_JOINTS)]
    for i in range(number):
        if i % 40 == 0:
            goal = rng.uniform(-1.0, 1.0, _JOINTS) * velocity
        most = acceleration * _PERIOD
        speed = speed + np.clip(goal - speed, -most, most)
        x = x + speed * _PERIOD
        found.append(x)
    return found


def _excess(sent, velocity, acceleration):
    steps = np.diff(np.array(sent), axis=0)
    fastest = np.abs(steps).max(axis=0) / (velocity * _PERIOD)
    hardest = np.abs(np.diff(steps, axis=0)).max(axis=0) / (acceleration * _PERIOD**2)
    return max(fastest.max(), hardest.max()) - 1.0


def _drive(seed, share, number=500, size=4096):
    """Points of the clock, mixtures and commands of a run with hostile rates, and its parts."""
    rng = np.random.default_rng(seed)
    velocity, acceleration = rng.uniform(0.2, 2.0, _JOINTS), rng.uniform(0.8, 40.0, _JOINTS)
    commands = _commands(rng, velocity, acceleration, number)
    spline = CommandSpline(commands[0], clock=0.0, period=_PERIOD, size=size)
    clock = LimitedClock(spline, period=_PERIOD, velocity=velocity, acceleration=acceleration)
    lag, delay = rng.uniform(0.005, 0.15, _JOINTS), rng.uniform(0.0, 29.0, _JOINTS) * _PERIOD
    parts = {"delay": delay, "velocity": velocity, "acceleration": acceleration, "period": _PERIOD}
    play_out = PlayOut(commands[0], lag=lag, **parts)
    alone = PlayOut(commands[0], lag=lag, **parts)
    rest = [commands[0]] * 2
    points, mixtures, sent = list(rest), list(rest), list(rest)
    used, wanted = 1, 1.0
    for i in range(number):
        if i % int(rng.integers(1, 60)) == 0:
            wanted = rng.uniform(-1.0, 1.0) if rng.random() < 0.5 else 1.0
        while spline.head < clock.sigma + 1.001 * _PERIOD and used < len(commands):
            spline.append(commands[used], 0.0)
            used += 1
        if used == len(commands):
            break
        points.append(clock.step(wanted))
        mixtures.append(alone.mixture(points[-1]))
        sent.append(play_out.step(points[-1], clock.sigma, spline, lag, share))
    return points, mixtures, sent, velocity, acceleration


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_clock_the_mixtures_and_what_is_sent_keep_the_limits_at_hostile_rates(seed):
    points, mixtures, sent, velocity, acceleration = _drive(seed, 0.05)
    assert _excess(points, velocity, acceleration) <= _ROUNDING
    assert _excess(mixtures, velocity, acceleration) <= _ROUNDING
    assert _excess(sent, velocity, acceleration) <= _ROUNDING


@pytest.mark.core
@pytest.mark.parametrize("seed", range(3))
def test_the_rate_is_the_nearest_of_those_tried_that_keeps_the_limits(seed, monkeypatch):
    """Of 32 between the wanted rate and the last one, then of 32 between the nearest of them and the next."""
    points, clocks = _drive(seed, 0.05, size=64)[0], []

    def nearest(clock, wanted):
        clocks.append(clock)
        rates = [wanted]
        for _ in range(3):
            steps = clock._spline.values(clock.sigma + np.array(rates) * _PERIOD) - clock.point
            changes = steps - (clock.point - clock._before)
            kept = ((np.abs(steps) <= clock._most) & (np.abs(changes) <= clock._most_change)).all(axis=1)
            kept[-1] |= len(rates) > 1  # the last rate, or one that was found to be allowed
            best = int(kept.argmax())
            if len(rates) == 1 and kept[0]:
                return wanted
            high, low = (rates[max(best - 1, 0)], rates[best]) if len(rates) > 1 else (wanted, clock.rate)
            rates = low + np.linspace(1.0, 0.0, 33) * (high - low)
        return float(low)

    monkeypatch.setattr(LimitedClock, "_limited", nearest)
    np.testing.assert_allclose(points, _drive(seed, 0.05, size=64)[0], rtol=0.0, atol=1e-12)
    assert len(clocks) > 300


@pytest.mark.core
def test_the_clock_in_the_core_tests_its_numbers():
    n, rows = 3, 8
    good = [np.zeros((rows, n + 1)), 5, 0.002, *np.zeros((4, n)), 0.0, 0.002, 1.0, 0.5]
    rate = _core.limited_rate
    assert rate(*good) == 1.0
    assert rate(*good[:7], np.nan, *good[8:]) == 0.5  # no place on the curve; the last rate always keeps the limits
    for i, bad in ((0, np.zeros((rows, n))), (1, 2), (3, np.zeros(n + 1)), (6, np.zeros(n - 1))):
        with pytest.raises(ValueError, match="do not fit"):
            rate(*good[:i], bad, *good[i + 1 :])


def test_an_addition_that_asks_for_too_much_is_cut():
    _, _, sent, velocity, acceleration = _drive(3, 0.5)
    assert _excess(sent, velocity, acceleration) <= _ROUNDING


@pytest.mark.parametrize("seed", range(3))
def test_the_curve_stays_near_its_commands_and_its_clock_runs_with_them(seed):
    rng = np.random.default_rng(seed)
    velocity, acceleration = np.full(_JOINTS, 1.0), np.full(_JOINTS, 10.0)
    commands = _commands(rng, velocity, acceleration, 200)
    spline = CommandSpline(commands[0], clock=0.0, period=_PERIOD, size=64)
    for i, x in enumerate(commands[1:], 1):
        spline.append(x, i * _PERIOD)
    sigma = np.arange(190, 200) * _PERIOD
    at = np.array(commands)[np.round(sigma / _PERIOD).astype(int) - 2]  # the points of the largest weight
    assert np.abs(spline.values(sigma) - at).max() <= acceleration[0] * _PERIOD**2 / 6.0 + 1e-15
    assert spline.clock(199.5 * _PERIOD) == pytest.approx(197.5 * _PERIOD)
    fine = np.arange(190.0 * _PERIOD, 199.0 * _PERIOD, _PERIOD / 64.0)
    bends = np.diff(spline.values(fine), 2, axis=0) * (64.0 / _PERIOD) ** 2  # its second derivative
    assert np.abs(bends).max() <= acceleration[0] * (1.0 + 1e-6)
    assert np.abs(np.diff(bends, axis=0)).max() <= 2.0 * acceleration[0] / 64.0 * (1.0 + 1e-3)  # without jumps
    for s in sigma:
        h = 1e-7
        slope = (spline.value(s + h) - spline.value(s - h)) / (2.0 * h)
        np.testing.assert_allclose(spline.slope(s), slope, atol=1e-6)
        np.testing.assert_allclose(spline.value(s), spline.values(np.array([s]))[0], rtol=0, atol=1e-15)
    assert spline.tail > 0.0


def test_servos_with_different_lags_stand_at_the_same_point_at_any_rate():
    """Against an integration of ẏ = (u − y)/L that knows nothing of the play-out."""
    velocity, acceleration = np.full(_JOINTS, 2.0), np.full(_JOINTS, 20.0)
    lag = np.array([0.004, 0.02, 0.05, 0.11])
    start = np.zeros(_JOINTS)
    spline = CommandSpline(start, clock=0.0, period=_PERIOD)
    limits = {"velocity": velocity, "acceleration": acceleration, "period": _PERIOD}
    clock = LimitedClock(spline, **limits)
    play_out = PlayOut(start, lag=lag, delay=np.zeros(_JOINTS), **limits)
    y, last, apart = start, start, 0.0
    for i in range(1500):
        while spline.head < clock.sigma + 1.001 * _PERIOD:
            t = (spline.head / _PERIOD + 2) * _PERIOD
            spline.append(np.full(_JOINTS, 0.3 * (1.0 - np.cos(2.0 * t))), t)
        c = clock.step(1.0 if i % 400 < 250 else 0.2)
        sent = play_out.step(c, clock.sigma, spline, lag, 0.0)  # the mixture alone
        for part in np.linspace(0.0, 1.0, 20, endpoint=False):
            u = last + (part + 0.025) * (sent - last)
            y = y + (1.0 - np.exp(-_PERIOD / 20.0 / lag)) * (u - y)
        last = sent
        apart = max(apart, float(np.ptp(y)))
    assert apart < 3.0 * acceleration[0] * _PERIOD**2  # straight lines between commands; lags alone: 0.05 rad
