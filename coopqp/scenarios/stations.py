"""Scenarios of arms that stand around an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from coopqp.model.cell import Arm, RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.paths.path import ObjectPath
from coopqp.paths.scenario import Scenario
from coopqp.spatial import Array

#: Tool orientation in the base frame: the tool points forward along x (a turn by 90° about y).
FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
#: Tool orientation in the base frame: the tool points forward along x, its own x axis sideways along y.
FORWARD_SIDEWAYS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
#: Tool orientation in the base frame: the tool points down.
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Station:
    """The place of one arm: an upright base that faces the object, and a grasp point.

    Attributes:
        arm: the arm, with its name in the cell.
        point: grasp point in the object frame at the start [m].
        yaw: direction that the arm faces, about the world's z axis [deg].
        reach: horizontal distance from the base's axis to the grasp point [m].
        height: height of the tool above the base [m].
        tool: orientation of the tool in the base frame, a rotation matrix (3, 3).
        near: joint positions near the start (n,) [deg or m]; inverse kinematics makes them exact.
    """

    arm: Arm
    point: tuple[float, float, float]
    yaw: float
    reach: float
    height: float
    near: Sequence[float]
    tool: Array = field(default_factory=lambda: FORWARD)

    def placed(self, T_world_object: pin.SE3) -> tuple[Arm, pin.SE3]:
        """The arm at its base placement, and T_object_tool."""
        turn = pin.utils.rotate("z", float(np.deg2rad(self.yaw)))
        hold = T_world_object.act(np.array(self.point))
        base = hold - turn @ np.array([self.reach, 0.0, self.height])
        T_world_tool = pin.SE3(turn @ self.tool, hold)
        return self.arm.placed(pin.SE3(turn, base)), T_world_object.actInv(T_world_tool)

    @property
    def near_positions(self) -> Array:
        """:attr:`near` in radians; prismatic joints in metres."""
        joints = list(self.arm.model.joints)[1:]  # the first is the world
        prismatic = [joint.shortname().startswith("JointModelP") for joint in joints]
        x = np.array(self.near, dtype=float)
        return np.where(prismatic, x, np.deg2rad(x))


def put_together(
    name: str,
    stations: Sequence[Station],
    path: ObjectPath,
    *,
    dt: float = 0.002,
    object_size: tuple[float, float, float],
    object_mass: float,
) -> Scenario:
    """Build a scenario of arms that stand around the object at the start of ``path``."""
    start = path.pose(0.0)
    arms, tools = zip(*(station.placed(start) for station in stations), strict=True)
    cell, grasp = RobotCell(arms), Grasp(tools)
    near = cell.configuration(np.concatenate([station.near_positions for station in stations]))
    return Scenario(
        name=name,
        cell=cell,
        grasp=grasp,
        path=path,
        q_start=inverse_kinematics(cell, grasp, start, near),
        dt=dt,
        object_size=object_size,
        object_mass=object_mass,
    )
