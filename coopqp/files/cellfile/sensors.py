"""Wrist sensors in a cell file: what is known of them, and what the physics plant simulates."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le, Len
from pydantic import Field

from coopqp.files.cellfile.basic import Name
from coopqp.files.cellfile.strict import Table
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.simulation.plants.disturbances import Disturbances

_Size = Annotated[float, Ge(-1e6), Le(1e6)]
_Three = Annotated[list[_Size], Len(3, 3)]
_Row = Annotated[list[Annotated[float, Ge(-1.0), Le(1.0)]], Len(3, 3)]


class SensorTable(Table):
    """A wrist sensor: it reads the wrench at its tool, turned, times a gain, plus a bias."""

    reads: Name | None = Field(default=None, description="arm whose wrenches it reads (default: its own)")
    axes: Annotated[list[_Row], Len(3, 3)] | None = Field(
        default=None, description="rows of the rotation from the tool's axes to the sensor's"
    )
    force_gain: _Size = Field(default=1.0, description="gain of forces; negative for a wrong sign")
    torque_gain: _Size = Field(default=1.0, description="gain of torques; 1000 for N·mm")
    bias_force_n: _Three = Field(default=[0.0, 0.0, 0.0], description="forces it reads too much [N]")
    bias_torque_nm: _Three = Field(default=[0.0, 0.0, 0.0], description="torques it reads too much [N·m]")
    delay_s: Annotated[float, Ge(0.0), Le(10.0)] = Field(default=0.0, description="age of a reading when it arrives")


class DisturbancesTable(Table):
    """What the physics plant simulates besides the model."""

    wrench_noise_n: Annotated[float, Ge(0.0), Le(1e6)] = Field(
        default=0.0, description="standard deviation of measured forces [N]; of torques a tenth of it [N·m]"
    )
    wrench_drop_share: Annotated[float, Ge(0.0), Le(0.99)] = Field(default=0.0, description="share of lost wrenches")
    sensors: dict[Name, SensorTable] = Field(default={}, description="how wrist sensors really read, by arm")
    seed: Annotated[int, Ge(0)] = Field(default=0, description="seed of the random numbers")


def build_sensor(table: SensorTable) -> WristSensor:
    """The sensor of a table."""
    return WristSensor(
        reads=table.reads,
        rotation=table.axes,
        force_gain=table.force_gain,
        torque_gain=table.torque_gain,
        bias=[*table.bias_force_n, *table.bias_torque_nm],
        delay=table.delay_s,
    )


def sensor_table(sensor: WristSensor) -> dict[str, Any]:
    """The table of a sensor; it reads back bit for bit."""
    table: dict[str, Any] = {} if sensor.reads is None else {"reads": sensor.reads}
    if not np.array_equal(sensor.rotation, np.eye(3)):
        table["axes"] = np.clip(sensor.rotation, -1.0, 1.0).tolist()
    return table | {
        "force_gain": sensor.force_gain,
        "torque_gain": sensor.torque_gain,
        "bias_force_n": sensor.bias[:3].tolist(),
        "bias_torque_nm": sensor.bias[3:].tolist(),
        "delay_s": sensor.delay,
    }


def build_disturbances(table: DisturbancesTable) -> Disturbances:
    """The disturbances of the plant."""
    return Disturbances(
        wrench_noise=table.wrench_noise_n,
        wrench_drop_share=table.wrench_drop_share,
        sensors={name: build_sensor(sensor) for name, sensor in table.sensors.items()},
        seed=table.seed,
    )
