"""Draws of disturbances: their streams of random numbers, their amounts, and what of each arm is disturbed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from pydantic import ValidationError

from coopqp.scenarios import paper_lift
from coopqp.simulation import Disturbances
from coopqp.studies.drawing import DisturbancesTable, NormalTable, UniformTable, disturbances

CELL = paper_lift().cell


def drawn(seed: int = 3, draw: int = 2, repeat: int = 1, **amounts: Any) -> Disturbances:
    made = disturbances(DisturbancesTable.model_validate(amounts), CELL, seed=seed, draw=draw, repeat=repeat)
    assert made is not None
    return made


def stream(*key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(3, spawn_key=key))


def test_each_quantity_of_a_draw_has_a_stream_of_its_own() -> None:
    """By the seed, the draw and the place of the quantity in the table; the noise by the run."""
    span = {"uniform": [0.25, 0.75]}
    made = drawn(encoder_noise_rad=span, latency_s=span, drop_share=0.5, base_offset_mm=span, lag_s=span)
    assert made.encoder_noise == stream(0, 2, 0).uniform(0.25, 0.75)
    assert made.latency == stream(0, 2, 1).uniform(0.25, 0.75)
    assert made.drop_share == 0.5
    assert list(made.lag.values()) == list(stream(0, 2, 5).uniform(0.25, 0.75, 3))
    assert list(made.lag) == list(CELL.arm_names)
    lengths = stream(0, 2, 3).uniform(0.25, 0.75, 3)
    for k, name in enumerate(CELL.arm_names[1:], start=1):
        assert np.linalg.norm(made.base_offset[name].translation) == pytest.approx(1e-3 * lengths[k])
        np.testing.assert_array_equal(made.base_offset[name].rotation, np.eye(3))
    assert made.seed == int(np.random.SeedSequence(3, spawn_key=(1, 2, 1)).generate_state(1, np.uint64)[0])


def test_a_base_is_turned_by_the_angle_about_any_axis_and_moved_along_another() -> None:
    turned = drawn(base_offset_deg=2.0, base_offset_mm=3.0)
    only = drawn(base_offset_deg=2.0)
    assert set(turned.base_offset) == set(only.base_offset) == {"slave_1", "slave_2"}
    rng = stream(0, 2, 4)
    rng_along = stream(0, 2, 3)
    axes = [v / np.linalg.norm(v) for v in rng.normal(size=(3, 3))]
    ways = [v / np.linalg.norm(v) for v in rng_along.normal(size=(3, 3))]
    for k, name in ((1, "slave_1"), (2, "slave_2")):
        np.testing.assert_allclose(pin.log3(turned.base_offset[name].rotation), np.deg2rad(2.0) * axes[k], atol=1e-12)
        np.testing.assert_allclose(turned.base_offset[name].translation, 3e-3 * ways[k], atol=1e-15)
        np.testing.assert_array_equal(only.base_offset[name].rotation, turned.base_offset[name].rotation)
        np.testing.assert_array_equal(only.base_offset[name].translation, np.zeros(3))
    none = drawn(lag_s=0.5)
    assert none.base_offset == {}
    assert none.lag == {name: 0.5 for name in CELL.arm_names}
    assert (none.encoder_noise, none.latency, none.drop_share) == (0.0, 0.0, 0.0)
    assert turned.lag == {}


def test_amounts_have_the_distribution_that_they_name() -> None:
    rng = np.random.default_rng(5)
    spread = UniformTable(uniform=[3.0, 1.0])  # in any order
    numbers = [spread.draw(rng) for _ in range(2000)]
    assert 1.0 <= min(numbers) < 1.01
    assert 2.99 < max(numbers) <= 3.0
    assert np.mean(numbers) == pytest.approx(2.0, abs=0.05)
    sizes = [NormalTable(normal=2.0).draw(rng) for _ in range(4000)]
    assert min(sizes) >= 0.0
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(2.0, rel=0.05)
    assert np.mean(sizes) == pytest.approx(2.0 * np.sqrt(2.0 / np.pi), rel=0.05)


def test_nothing_is_disturbed_by_default() -> None:
    assert set(DisturbancesTable().model_dump().values()) == {0.0}
    assert disturbances(DisturbancesTable(), CELL, seed=0, draw=0, repeat=0) is None


@pytest.mark.parametrize(
    ("amount", "fits"),
    [
        (0.0, True), (1e6, True), (1, True), (-0.5, False), (1e6 + 0.5, False), (float("nan"), False),
        ({"uniform": [0.0, 1e6]}, True), ({"uniform": [0.5]}, False), ({"uniform": [1.0, 2.0, 3.0]}, False),
        ({"uniform": [-0.5, 1.0]}, False), ({"normal": 0.0}, True), ({"normal": -0.5}, False), ({"spread": 1.0}, False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["encoder_noise_rad", "latency_s", "base_offset_mm", "base_offset_deg", "lag_s"])
def test_an_amount_is_a_number_up_to_a_million_or_a_distribution_of_such(name: str, amount: Any, fits: bool) -> None:
    if fits:
        DisturbancesTable.model_validate({name: amount})
    else:
        with pytest.raises(ValidationError, match=name):
            DisturbancesTable.model_validate({name: amount})


@pytest.mark.parametrize(("share", "fits"), [(0.0, True), (0.99, True), (0.991, False), (-0.001, False)])
def test_not_all_samples_can_be_lost(share: float, fits: bool) -> None:
    if fits:
        assert DisturbancesTable(drop_share=share).drop_share == share
    else:
        with pytest.raises(ValidationError, match="drop_share"):
            DisturbancesTable(drop_share=share)
