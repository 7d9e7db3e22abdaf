"""A robot with several arms: one description, a tool frame for each arm, joints that several arms share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from coopqp.checks import require
from coopqp.errors import InvalidInputError
from coopqp.model.arm import Arm, urdf_arm
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
        given = (velocity_limits, acceleration_limits, lower_limits, upper_limits)
        (arm, _), *others = arms.items()
        first = urdf_arm(
            arm, urdf, tuple(arms.values()), T_world_base, package_dirs, geometry, locked_joints, given, robot=name
        )
        made = [first, *(first.with_tool(tool, name=other) for other, tool in others)]
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "arms", tuple(made))

    def __repr__(self) -> str:
        return f"Robot({self.name}: {', '.join(arm.name for arm in self.arms)})"
