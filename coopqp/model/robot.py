"""A robot with several arms: one description, a tool frame for each arm, joints that several arms share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from coopqp.checks import one_each, require
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.arm import Arm
from coopqp.model.joint_limits import LIMIT_FIELDS, JointLimits
from coopqp.spatial import Placement

#: A limit of all joints, or limits by the joints' names.
Limit = float | Mapping[str, float]


@final
@dataclass(frozen=True, init=False, eq=False)
class Robot:
    """A robot with several arms, for example a torso, a lift or a rail with two arms on it.

    Joints that move the tools of several arms are in the cell once, and get one command. Without such joints a robot is
    the same as its arms given one by one.

    Args:
        urdf: path of the URDF file of the whole robot.
        arms: the tool frame of each arm, by the arm's name.
        name: name of the robot; prefix of the names of joints that its arms share.
        T_world_base: placement of the model's root in the world (identity by default).
        package_dirs, geometry, locked_joints: as in :meth:`Arm.from_urdf`.
        velocity_limits, acceleration_limits, lower_limits, upper_limits: replace the limits of the model; one number
            for all joints, or numbers by the joints' names [rad or m, per s, per s²].

    Attributes:
        name: name of the robot.
        arms: its arms, each with the whole model.

    Raises:
        InvalidInputError: no arm, or bad limits or placement.
        ModelError, UnknownNameError: as in :meth:`Arm.from_urdf`; or no such joint.
    """

    name: str
    arms: tuple[Arm, ...]

    def __init__(
        self,
        urdf: str | Path,
        arms: Mapping[str, str],
        *,
        name: str = "robot",
        T_world_base: Placement | None = None,
        package_dirs: Sequence[str | Path] = (),
        geometry: bool = True,
        locked_joints: Mapping[str, float] | None = None,
        velocity_limits: Limit | None = None,
        acceleration_limits: Limit | None = None,
        lower_limits: Limit | None = None,
        upper_limits: Limit | None = None,
    ) -> None:
        where = f"robot '{name}'"
        if not isinstance(name, str) or not name or "/" in name:
            raise InvalidInputError("the name is empty or has a '/'", "Robot: name", "Give a plain name.")
        require(arms, Mapping, f"{where}: arms", "Give the tool frame of each arm: {'left': …, 'right': …}.")
        if not arms:
            raise InvalidInputError("no arm", where, "Give the tool frame of each arm: {'left': …, 'right': …}.")
        changes = dict(
            zip(LIMIT_FIELDS, (lower_limits, upper_limits, velocity_limits, acceleration_limits), strict=True)
        )
        first: Arm | None = None
        made: list[Arm] = []
        for arm, tool_frame in arms.items():
            if first is None:
                first = Arm.from_urdf(
                    arm, urdf, tool_frame=tool_frame, T_world_base=T_world_base, package_dirs=package_dirs,
                    geometry=geometry, locked_joints=locked_joints,
                )  # fmt: skip
                first = replace(first, limits=_limits(first, changes, where), robot=name)
                made.append(first)
            else:  # the same model, which nobody changes
                made.append(first.with_tool(tool_frame, name=arm))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "arms", tuple(made))

    def __repr__(self) -> str:
        return f"Robot({self.name}: {', '.join(arm.name for arm in self.arms)})"


def _limits(arm: Arm, changes: Mapping[str, Limit | None], where: str) -> JointLimits:
    """The limits of an arm with those in their place that are given."""
    names = list(arm.model.names)[1:]
    full: dict[str, Any] = {}
    for field, given in changes.items():
        if given is None:
            continue
        values = np.array(getattr(arm.limits, field))
        if isinstance(given, Mapping):
            for joint, value in given.items():
                if joint not in names:
                    raise UnknownNameError("joint", str(joint), names, f"{where}, {field}_limits")
                at = f"{where}: {field}_limits['{joint}']"
                values[names.index(joint)] = one_each(value, 1, at, finite=False)[0]
        else:
            values[:] = one_each(given, 1, f"{where}: {field}_limits", finite=False)[0]
        full[field] = values
    return arm.limits.replace(**full) if full else arm.limits
