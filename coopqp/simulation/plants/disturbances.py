"""What goes wrong on purpose, for every plant that can do it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from coopqp.checks import as_scalar, keep_scalars
from coopqp.errors import InvalidInputError, shown
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Placement, as_placement


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbances:
    """What is not ideal. Arms are given by name.

    Attributes:
        encoder_noise: measured joints are off by up to ± this, evenly distributed [rad or m].
        latency: age of a measurement when it arrives [s].
        drop_share: share of the samples that do not arrive; the one before is seen again.
        drops_by_arm: every arm loses samples of its own, instead of all arms together.
        dt_jitter: periods vary by up to ± this share, for loops that ask the plant for them.
        base_offset: where an arm really stands, in its nominal base frame.
        lag: time constant with which an arm's joints follow their commands [s].
        stall: time from which an arm does not move any more [s].
        seed: of the random numbers.
    """

    encoder_noise: float = 0.0
    latency: float = 0.0
    drop_share: float = 0.0
    drops_by_arm: bool = False
    dt_jitter: float = 0.0
    base_offset: Mapping[str, Placement] = field(default_factory=dict)
    lag: Mapping[str, float] = field(default_factory=dict)
    stall: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0

    def __post_init__(self) -> None:
        keep_scalars(self, "encoder_noise", "latency", open_low=False)
        keep_scalars(self, "drop_share", "dt_jitter", high=0.99, open_low=False)
        if isinstance(self.seed, bool) or not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise InvalidInputError(f"seed is {shown(self.seed)}", "Disturbances", "Give a whole number from 0 on.")
        for name in ("lag", "stall"):
            for arm, value in getattr(self, name).items():
                as_scalar(value, f"Disturbances: {name}['{arm}']", open_low=False)
        for arm, placement in self.base_offset.items():
            as_placement(placement, f"Disturbances: base_offset['{arm}']")


def misplaced(cell: RobotCell, grasp: Grasp, offsets: Mapping[str, Placement]) -> Grasp:
    """The grasp of arms that hold beside their points: ``T_object_tool`` of each named arm times its offset.

    Args:
        cell: for the names of the arms.
        grasp: the intended grasp.
        offsets: how far beside, in the tool's frame.

    Raises:
        UnknownNameError: no such arm. InvalidInputError: an offset that is no placement.
    """
    grasp.check_arms(cell)
    tools = list(grasp.T_object_tool)
    for arm, offset in offsets.items():
        k = cell.index(arm)
        tools[k] = tools[k] * as_placement(offset, f"misplaced: '{arm}'")
    return Grasp(tuple(tools))
