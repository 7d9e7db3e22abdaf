"""The fit of wrist sensors: known arms, axes, gains, delays, biases and drifts come back from their own readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.forces.presses import PressPlan, of_grip
from coopqp.forces.sensor_fit import SensorFit, proper
from coopqp.scenarios import Scenario, paper_lift, ring
from coopqp.spatial import Array

DT = 0.02


@dataclass(frozen=True)
class Sensed:
    """A sensor as it is: arm, axes, gains of forces and torques, delay [s], bias and drift."""

    arm: int
    turn: Sequence[float]
    gains: tuple[float, float]
    bias: Sequence[float] = (0.0,) * 6
    drift: Sequence[float] = (0.0,) * 6
    delay: float = 0.0

    @property
    def rotation(self) -> Array:
        return np.asarray(pin.exp3(np.array(self.turn, dtype=float)))

    @property
    def map(self) -> Array:
        out = np.zeros((6, 6))
        out[:3, :3], out[3:, 3:] = self.gains[0] * self.rotation, self.gains[1] * self.rotation
        return out


class World:
    """Arms that press, what their sensors read, and the fit of that."""

    def __init__(self, task: Scenario, sensors: Sequence[Sensed], *, stiffer: Any, lead: float = 0.0, dt: float = DT):
        rng, n = np.random.default_rng(5), len(task.grasp)
        ways = np.linalg.qr(rng.normal(size=(n, 6, 6)))[0]
        self.soft = ways @ np.diag([1e-5, 2e-5, 5e-6, 1e-5, 5e-5, 2e-5]) @ ways.swapaxes(1, 2)
        plan = PressPlan(task.grasp, self.soft)
        self.times = np.arange(0.0, plan.duration, dt)
        self.motions = np.array([plan.shift(t, 1.0) for t in self.times])
        self.to_tools = np.array([X.action.T for X in task.grasp.T_object_tool])
        self.middle = self.times - 0.5 * (self.times[0] + self.times[-1])
        G = of_grip(self.soft / np.array(stiffer)[:, None, None])
        objects = (self.motions.reshape(len(self.times), -1) @ G.T).reshape(self.motions.shape)
        self.wrenches = np.einsum("kij,tkj->tki", self.to_tools, objects)
        self.wrenches += lead * np.gradient(self.wrenches, self.times, axis=0)
        self.readings = np.array([self.read(s, self.late(s.delay)[:, s.arm]) for s in sensors]).swapaxes(0, 1)

    def late(self, delay: float) -> Array:
        """The wrenches at the tools, some time ago (T, N, 6)."""
        flat = self.wrenches.reshape(len(self.times), -1).T
        return np.array([np.interp(self.times - delay, self.times, y) for y in flat]).T.reshape(self.wrenches.shape)

    def read(self, sensor: Sensed, wrenches: Array) -> Array:
        return wrenches @ sensor.map.T + sensor.bias + np.outer(self.middle, sensor.drift)

    def fit(self) -> SensorFit:
        fit = SensorFit(self.times, self.readings, self.motions, self.soft, self.to_tools)
        while not fit.go_on():
            pass
        return fit


#: Two sensors are swapped; one has a wrong sign, one other axes.
SENSORS = (
    Sensed(
        0, (0.1, -0.05, 0.08), (1.1, 0.9), (5.0, -3.0, 20.0, 0.3, -0.2, 0.1), (0.5, 0.2, -0.3, 0.02, 0, 0.01), 0.015
    ),
    Sensed(2, (0.3, 0.9, -0.6), (-0.7, 1.3), (1.0, 2.0, -9.0, 0.1, 0.5, 0.0), (0.0, -1.0, 0.0, 0.0, 0.03, 0.0), 0.025),
    Sensed(1, (0.0, 0.0, 0.0), (2.0, -1.6), (0.0, 0.0, 4.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.7, 0.0, 0.0, 0.0), 0.04),
)
STIFFER, SHARED, LEAD = np.array([1.25, 0.8, 1.0]), 1.5, 0.032


@pytest.fixture(scope="module")
def world() -> World:
    """Three sensors, of which one loses samples."""
    made = World(paper_lift(), SENSORS, stiffer=SHARED * STIFFER, lead=LEAD)
    made.readings[7::31, 1] = np.nan
    return made


@pytest.fixture(scope="module")
def found(world: World) -> SensorFit:
    return world.fit()


def test_every_number_of_a_sensor_comes_back(found: SensorFit) -> None:
    """Exactly, but for what gains and stiffness are held by where nothing tells them."""
    np.testing.assert_array_equal(found.arms, [s.arm for s in SENSORS])
    np.testing.assert_allclose(found.rotations, [s.rotation for s in SENSORS], atol=3e-4)
    np.testing.assert_allclose(found.gains, [np.multiply(SHARED, s.gains) for s in SENSORS], rtol=5e-4)
    np.testing.assert_allclose(found.stiffer, STIFFER, rtol=2e-4)
    np.testing.assert_allclose(found.offsets, [s.bias for s in SENSORS], atol=2e-4)
    np.testing.assert_allclose(found.slopes, [s.drift for s in SENSORS], atol=2e-4)
    np.testing.assert_allclose(found.delays, [s.delay for s in SENSORS], atol=3e-4)
    assert found.lead == LEAD
    assert found.misfit.max() < 1e-6


def test_lost_samples_are_counted(world: World, found: SensorFit) -> None:
    lost = np.isnan(world.readings[:, 1, 0]).mean()
    assert 0.0 < lost < 0.1
    np.testing.assert_allclose(found.lost, [0.0, lost, 0.0])


def without_pace(world: World, delay: float, values: Array) -> Array:
    """What remains of signals (T, m) beside a level, a slope, and what follows the motions' pace."""
    pace = np.gradient(world.motions.reshape(len(world.times), -1), world.times, axis=0)
    late = np.array([np.interp(world.times - delay, world.times, y) for y in pace.T]).T
    known = np.column_stack([np.ones(len(late)), world.middle, late])
    return np.asarray(values - known @ np.linalg.lstsq(known, values, rcond=1e-9)[0])


def test_axes_are_as_doubtful_as_the_noise_makes_them(world: World, found: SensorFit) -> None:
    """By the information of what is heard about a turn: none about the wrenches' own axis."""
    for k in (0, 2):
        s = SENSORS[k]
        read, told = (without_pace(world, s.delay, y) for y in (world.readings[:, k], world.late(s.delay)[:, s.arm]))
        H = np.zeros((3, 3))
        for part, noise, gain in zip((slice(0, 3), slice(3, 6)), found.noise[k], s.gains, strict=True):
            variance = noise**2 + 0.05**2 * (read[:, part] ** 2).sum() / len(read)
            H += gain**2 * told[:, part].T @ told[:, part] / variance
        assert found.doubts[k] == pytest.approx(1.0 / np.sqrt(np.linalg.eigvalsh(H)[:2].sum()), rel=2e-3)


def test_what_no_arm_explains_is_told_as_a_share() -> None:
    """A slow swing beside the wrenches: its share of the squares of forces, noise left out."""
    sensors = [Sensed(k, (0.0, 0.0, 0.0), (1.0, 1.0)) for k in range(2)]
    world = World(ring(arms=2), sensors, stiffer=[1.0, 1.0])
    swing = 2.0 * np.sin(9.0 * world.times)
    world.readings[:, 1, 0] += swing
    fit = world.fit()
    read = world.readings[:, 1, :3]
    model = fit.gains[1, 0] * world.late(float(fit.delays[1]))[:, 1, :3] @ fit.rotations[1].T
    left, all_of = (without_pace(world, float(fit.delays[1]), y) for y in (read - model, read))
    noise = 3.0 * len(read) * fit.noise[1, 0] ** 2
    assert fit.misfit[0] < 1e-3 < 0.05 < fit.misfit[1] < 0.95
    assert fit.misfit[1] == pytest.approx(((left**2).sum() - noise) / (all_of**2).sum(), rel=0.03)


def test_noise_is_told_by_its_deviation() -> None:
    """The largest of the three axes, forces and torques apart; lost samples do not count."""
    rng, T, sizes = np.random.default_rng(2), 6000, np.array([[0.5, 2.0, 1.0, 0.05, 0.1, 0.2], [3.0] * 3 + [0.02] * 3])
    times = np.linspace(0.0, 12.0, T)
    readings = sizes * rng.normal(size=(T, 2, 6)) + 50.0 + 3.0 * times[:, None, None]
    readings[::50, 1] = np.nan
    soft, to_tools = np.tile(1e-5 * np.eye(6), (2, 1, 1)), np.tile(np.eye(6), (2, 1, 1))
    fit = SensorFit(times, readings, np.zeros((T, 2, 6)), soft, to_tools)
    np.testing.assert_allclose(fit.noise, [[2.0, 0.2], [3.0, 0.02]], rtol=0.06)
    np.testing.assert_allclose(fit.lost, [0.0, 0.02])
    still = SensorFit(times, 0.0 * readings, np.zeros((T, 2, 6)), soft, to_tools)
    np.testing.assert_array_equal(still.noise, [[0.1, 0.01]] * 2)


def test_a_sensor_that_says_nothing_has_no_gain() -> None:
    """Neither one that is lost all the time, nor one that never changes; the other is found."""
    sensors = [Sensed(k, (0.0, 0.0, 0.0), (1.0, 1.0)) for k in range(2)]
    for nothing in (np.nan, 4.0):
        world = World(ring(arms=2), sensors, stiffer=[1.0, 1.0], dt=0.04)
        world.readings[:, 1] = nothing
        fit = world.fit()
        assert np.abs(fit.gains[1]).max() < 1e-3
        np.testing.assert_allclose(fit.gains[0], 1.0, atol=0.02)
        assert fit.lost[1] == float(np.isnan(nothing))


@pytest.mark.parametrize(("delay", "close"), [(0.0, 0.0), (0.0575, 3e-4), (0.2, 0.0)])
def test_a_delay_is_found_between_and_up_to_the_ends_of_what_is_tried(delay: float, close: float) -> None:
    """Less the time by which damping leads: between the delays that are tried, both can be exchanged."""
    sensors = [Sensed(k, (0.0, 0.0, 0.0), (1.0, 1.0), delay=delay) for k in range(2)]
    fit = World(ring(arms=2), sensors, stiffer=[1.0, 1.0], dt=0.01).fit()
    np.testing.assert_allclose(fit.delays - fit.lead, delay, rtol=0.0, atol=close + 1e-12)


def test_the_proper_rotation_is_the_best_one() -> None:
    rng = np.random.default_rng(3)
    others = [np.asarray(pin.exp3(w)) for w in rng.uniform(-3.0, 3.0, (50, 3))]
    for _ in range(20):
        M = rng.normal(size=(3, 3))
        R = proper(M)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert all(np.trace(R.T @ M) >= np.trace(other.T @ M) for other in others)
        near = [np.asarray(pin.exp3(w)) @ R for w in 1e-3 * np.vstack([np.eye(3), -np.eye(3)])]
        assert all(np.trace(R.T @ M) >= np.trace(other.T @ M) for other in near)
