"""Wrench sensors of a plant: late, flipped, noisy and lost as the disturbances say, each arm by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from coopqp import RobotCell
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.simulation import Disturbances
from coopqp.simulation.plants.sensors import WrenchSensors
from coopqp.spatial import Array

DT = 0.01


@pytest.fixture(scope="module")
def cell(make_cell: Callable[..., RobotCell]) -> RobotCell:
    return make_cell(["scara4", "arm5", "arm5"])


def readings(cell: RobotCell, truth: Array, **disturbances: Any) -> Array:
    """What the sensors of a cell say of wrenches (T, N, 6) at every hundredth of a second."""
    sensors = WrenchSensors(cell, Disturbances(**disturbances))
    return np.array([sensors.read(w, DT * i) for i, w in enumerate(truth)])


def test_each_arm_s_wrench_comes_as_late_as_its_sensor_is(cell: RobotCell, rng: np.random.Generator) -> None:
    truth = rng.normal(size=(30, 3, 6))
    np.testing.assert_array_equal(readings(cell, truth), truth)
    own = {cell.arm_names[1]: WristSensor(delay=0.03), cell.arm_names[2]: WristSensor(delay=0.005)}
    found = readings(cell, truth, wrench_latency=0.02, sensors=own)
    for arm, late in enumerate((2, 5, 3)):  # in samples: what has not arrived is not heard
        np.testing.assert_array_equal(found[late:, arm], truth[: 30 - late, arm])
        np.testing.assert_array_equal(found[:late, arm], np.tile(truth[0, arm], (late, 1)))


def test_gains_and_constant_errors_are_those_of_an_arm(cell: RobotCell, rng: np.random.Generator) -> None:
    truth = rng.normal(size=(5, 3, 6))
    gained = readings(cell, truth, wrench_gain={cell.arm_names[1]: -1.0, cell.arm_names[2]: 0.0})
    np.testing.assert_array_equal(gained, truth * np.array([1.0, -1.0, 0.0])[:, None])
    errors = readings(cell, truth, wrench_bias=4.0) - truth
    np.testing.assert_allclose(errors, np.tile(errors[0], (5, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(errors[0, :, :3], axis=1), 4.0)
    np.testing.assert_allclose(np.linalg.norm(errors[0, :, 3:], axis=1), 0.4)
    assert np.abs(errors[0, 0] - errors[0, 1]).max() > 0.1, "each arm has its own"
    other = readings(cell, truth, wrench_bias=4.0, seed=1) - truth
    assert np.abs(other[0] - errors[0]).max() > 0.1


def test_noise_has_the_size_that_is_told_and_starts_anew_at_a_reset(cell: RobotCell) -> None:
    sensors = WrenchSensors(cell, Disturbances(wrench_noise=2.0, wrench_latency=0.05))
    still = np.zeros((3, 6))
    found = np.array([sensors.read(still, DT * i) for i in range(2000)])
    np.testing.assert_allclose(found[:, :, :3].std(axis=0), 2.0, rtol=0.1)
    np.testing.assert_allclose(found[:, :, 3:].std(axis=0), 0.2, rtol=0.1)
    assert np.abs(found.mean(axis=0)[:, :3]).max() < 0.2
    sensors.reset()
    again = np.array([sensors.read(still + i, DT * i) for i in range(5)])
    np.testing.assert_array_equal(again, found[:5])  # a late sensor hears the first wrench since the reset


def test_a_lost_wrench_is_not_a_number_and_the_others_are_untouched(cell: RobotCell, rng: np.random.Generator) -> None:
    truth = rng.normal(size=(1500, 3, 6))
    found = readings(cell, truth, wrench_drop_share=0.3)
    lost = np.isnan(found)
    assert (lost == lost[..., :1]).all(), "a wrench is lost as a whole"
    gone = lost[..., 0]
    np.testing.assert_allclose(gone.mean(axis=0), 0.3, atol=0.05)
    assert (gone[:, 0] & gone[:, 1]).mean() == pytest.approx(0.09, abs=0.03)
    np.testing.assert_array_equal(found[~lost], truth[~lost])
