"""Disturbances of a draw of a study: the same for every setting, and for any number of workers.

Each quantity of a draw has random numbers of its own, from the study's seed, the draw and the quantity. So a setting
meets the disturbances that all others meet, and a change of one amount leaves the other draws as they are.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from annotated_types import Ge, Le, Len
from pydantic import Field

from coopqp.files.cellfile.strict import Table
from coopqp.model.cell import RobotCell
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.spatial import Array

_Size = Annotated[float, Ge(0.0), Le(1e6)]


class UniformTable(Table):
    """A number drawn between two bounds."""

    uniform: Annotated[list[_Size], Len(2, 2)] = Field(description="lower and upper bound")

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        low, high = sorted(self.uniform)
        return float(rng.uniform(low, high))


class NormalTable(Table):
    """The magnitude of a normal number."""

    normal: _Size = Field(description="standard deviation")

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        return float(abs(rng.normal()) * self.normal)


Amount = _Size | UniformTable | NormalTable


class DisturbancesTable(Table):
    """Amounts of the disturbances: a number, ``{ uniform = [a, b] }`` or ``{ normal = s }``; each draw has its own."""

    encoder_noise_rad: Amount = Field(default=0.0, description="amplitude of the encoders' noise [rad or m]")
    latency_s: Amount = Field(default=0.0, description="age of a measurement")
    drop_share: Annotated[float, Ge(0.0), Le(0.99)] = Field(default=0.0, description="share of lost samples")
    base_offset_mm: Amount = Field(default=0.0, description="each base but the first is off by this, in any direction")
    base_offset_deg: Amount = Field(default=0.0, description="each base but the first is turned by this")
    lag_s: Amount = Field(default=0.0, description="time constant of each arm's servos")


#: First number of a spawn key: for values of a draw, and for the noise of each of its runs.
_OF_A_DRAW, _OF_A_RUN = 0, 1


def disturbances(
    table: DisturbancesTable, cell: RobotCell, *, seed: int, draw: int, repeat: int
) -> Disturbances | None:
    """The disturbances of one run; None for an undisturbed one.

    Args:
        table: the amounts.
        cell: the arms.
        seed: seed of the study.
        draw: number of the draw.
        repeat: number of the run within its draw; each run has noise of its own.
    """
    amounts = {}
    for quantity, name in enumerate(type(table).model_fields):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_OF_A_DRAW, draw, quantity)))
        amounts[name] = _drawn(getattr(table, name), len(cell), rng), [_direction(rng) for _ in cell.arms]
    if not any(values.any() for values, _ in amounts.values()):
        return None
    along, about = amounts["base_offset_mm"], amounts["base_offset_deg"]
    offsets = {
        name: pin.SE3(pin.exp3(np.deg2rad(about[0][k]) * about[1][k]), 1e-3 * along[0][k] * along[1][k])
        for k, name in enumerate(cell.arm_names)
        if k and (along[0][k] or about[0][k])
    }
    noise = np.random.SeedSequence(seed, spawn_key=(_OF_A_RUN, draw, repeat)).generate_state(1, np.uint64)
    lags = amounts["lag_s"][0]
    return Disturbances(
        encoder_noise=float(amounts["encoder_noise_rad"][0][0]),
        latency=float(amounts["latency_s"][0][0]),
        drop_share=float(amounts["drop_share"][0][0]),
        base_offset=offsets,
        lag={name: float(lag) for name, lag in zip(cell.arm_names, lags, strict=True) if lag},
        seed=int(noise[0]),
    )


def _drawn(amount: Any, arms: int, rng: np.random.Generator) -> Array:
    """A value for each arm; a plain number is the same for all."""
    if isinstance(amount, float | int):
        return np.full(arms, float(amount))
    return np.array([amount.draw(rng) for _ in range(arms)])


def _direction(rng: np.random.Generator) -> Array:
    """A unit vector (3,), uniform over the sphere."""
    v = rng.normal(size=3)
    return v / np.sqrt(v @ v)
