"""Disturbances that plants can simulate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, as_seed, keep_scalars, require
from coopqp.errors import InvalidInputError
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Placement, as_placement


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbances:
    """Deviations of a plant from the ideal one. Arms are given by name.

    Attributes:
        encoder_noise: amplitude of the uniform noise of measured joint positions [rad or m].
        latency: age of a measurement at its arrival [s].
        drop_share: share of lost samples; the last sample is then repeated.
        drops_by_arm: True if every arm loses its own samples, False if all arms lose the same ones.
        dt_jitter: amplitude of the variation of periods, as a share; for loops that take the period from the plant.
        base_offset: real placement of an arm's base in its nominal base frame, by arm; of arms that share joints by one
            of them.
        lag: time constant of the joints' response to commands [s], by arm.
        stall: time at which an arm stops moving [s], by arm.
        wrench_noise, wrench_bias: standard deviation and constant error of measured wrenches [N]; of torques a tenth
            of it [N·m].
        wrench_latency: age of a wrench at its arrival [s].
        wrench_drop_share: share of lost wrenches.
        wrench_gain: a sensor's reading as a multiple of the wrench, by arm: −1 if it is flipped, 0 if dead.
        sensors: how wrist sensors really read, by arm (:class:`coopqp.forces.WristSensor`); their delays add to
            ``wrench_latency``.
        object_growth, growth_period: the object's lengths grow by the share ``object_growth · sin(2π t / period)``, the
            period in seconds; for plants with forces.
        seed: seed of the random numbers.
    """

    encoder_noise: float = 0.0
    latency: float = 0.0
    drop_share: float = 0.0
    drops_by_arm: bool = False
    dt_jitter: float = 0.0
    base_offset: Mapping[str, Placement] = field(default_factory=dict)
    lag: Mapping[str, float] = field(default_factory=dict)
    stall: Mapping[str, float] = field(default_factory=dict)
    wrench_noise: float = 0.0
    wrench_bias: float = 0.0
    wrench_latency: float = 0.0
    wrench_drop_share: float = 0.0
    wrench_gain: Mapping[str, float] = field(default_factory=dict)
    sensors: Mapping[str, WristSensor] = field(default_factory=dict)
    object_growth: float = 0.0
    growth_period: float = 12.0
    seed: int = 0

    def __post_init__(self) -> None:
        keep_scalars(self, "encoder_noise", "latency", open_low=False)
        keep_scalars(self, "growth_period")
        object.__setattr__(
            self, "object_growth", as_scalar(self.object_growth, "Disturbances: object_growth", low=-0.5, high=0.5)
        )
        keep_scalars(self, "wrench_noise", "wrench_bias", "wrench_latency", open_low=False)
        keep_scalars(self, "drop_share", "dt_jitter", "wrench_drop_share", high=0.99, open_low=False)
        as_seed(self.seed, "Disturbances")
        for name in ("lag", "stall"):
            for arm, value in getattr(self, name).items():
                as_scalar(value, f"Disturbances: {name}['{arm}']", open_low=False)
        for arm, value in self.wrench_gain.items():
            as_scalar(value, f"Disturbances: wrench_gain['{arm}']", low=-np.inf)
        for arm, sensor in self.sensors.items():
            require(sensor, WristSensor, f"Disturbances: sensors['{arm}']", "Give a coopqp.forces.WristSensor.")
        for arm, placement in self.base_offset.items():
            as_placement(placement, f"Disturbances: base_offset['{arm}']")

    def base_offsets(self, cell: RobotCell) -> dict[str, pin.SE3]:
        """``base_offset`` by the arms' names, of arms that share joints by the first of them: they have one base.

        Raises:
            UnknownNameError: no such arm.
            InvalidInputError: the arms of one base are given two placements.
        """
        firsts = {k: group[0] for group in cell.groups for k in group}
        out: dict[str, pin.SE3] = {}
        for arm, given in self.base_offset.items():
            k = cell.index(arm)
            name, offset = cell.arm_names[firsts.get(k, k)], as_placement(given, "base_offset")
            if not out.setdefault(name, offset).isApprox(offset, 1e-12):
                raise InvalidInputError(
                    f"robot '{cell.arms[k].robot}' has one base and is given two offsets",
                    "Disturbances: base_offset",
                    "Give that of one of its arms.",
                )
        return out


def misplaced(cell: RobotCell, grasp: Grasp, offsets: Mapping[str, Placement]) -> Grasp:
    """A misplaced grasp: ``T_object_tool`` of each named arm times its offset.

    Args:
        cell: cell with the names of the arms.
        grasp: the intended grasp.
        offsets: placement error in the tool's frame, by arm.

    Raises:
        UnknownNameError: no such arm.
        InvalidInputError: an offset is not a placement.
    """
    grasp.check_arms(cell)
    tools = list(grasp.T_object_tool)
    for arm, offset in offsets.items():
        k = cell.index(arm)
        tools[k] = tools[k] * as_placement(offset, f"misplaced: '{arm}'")
    return Grasp(tuple(tools))
