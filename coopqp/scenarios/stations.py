"""Scenarios of arms that stand around an object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.model.cell import Arm, RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.paths.path import LinePath, ObjectPath
from coopqp.paths.scenario import Scenario
from coopqp.paths.time_law import TimeLaw
from coopqp.scenarios.arms import robot_arm
from coopqp.spatial import Array

#: Tool orientation in the base frame: the tool points forward along x (a turn by 90° about y).
FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
#: Tool orientation in the base frame: the tool points forward along x, its own x axis sideways along y.
FORWARD_SIDEWAYS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
#: Tool orientation in the base frame: the tool points down.
DOWN = np.diag([1.0, -1.0, -1.0])


class Stance(NamedTuple):
    """How an arm stands to its grasp point.

    Attributes:
        reach: horizontal distance from the base's axis to the grasp point [m].
        height: height of the tool above the base [m].
        near: joint positions near the start (n,) [deg or m]; inverse kinematics makes them exact.
        tool: orientation of the tool in the base frame, a rotation matrix (3, 3).
    """

    reach: float
    height: float
    near: tuple[float, ...]
    tool: Array = FORWARD


#: How each robot stands, unless a cell says otherwise. arm7 holds from above at a slant, the others from one side.
STANCES = {
    "rx90l": Stance(0.80, 0.30, (0.0, 38.0, 102.0, 0.0, -50.0, 0.0)),
    "arm5": Stance(0.48, 0.25, (0.0, 10.0, 115.0, -35.0, 0.0)),
    "arm6c": Stance(0.50, 0.30, (-19.0, 4.3, 113.0, 62.7, 71.0, -90.0)),
    "arm7": Stance(0.50, 0.25, (0.0, 14.0, 0.0, 105.0, 0.0, 31.0, 0.0), pin.utils.rotate("y", np.deg2rad(150.0))),
    "gantry7": Stance(0.60, 0.35, (0.0, 0.0, 45.0, 97.0, 0.0, -52.0, 0.0)),
    "scara4": Stance(0.42, 0.12, (41.0, -91.0, -0.03, 50.0), DOWN),
    "panda": Stance(0.48, 0.30, (0.0, -10.0, 0.0, -135.0, 0.0, 125.0, 45.0), DOWN),
    "ur5": Stance(0.50, 0.30, (-15.1, -86.1, 103.6, -17.6, 74.9, 0.0), FORWARD_SIDEWAYS),
}


class Station(NamedTuple):
    """The place of one arm: an upright base that faces the object, and a grasp point.

    Attributes:
        robot: name of the robot.
        name: name of the arm in the cell.
        point: grasp point in the object frame at the start, x and y [m].
        yaw: direction that the arm faces, about the world's z axis [deg].
        stance: how it stands; by default as in :data:`STANCES`.
    """

    robot: str
    name: str
    point: tuple[float, float]
    yaw: float
    stance: Stance | None = None


def facing(robot: str, half: float, stance: Stance | None = None) -> list[Station]:
    """Two arms of one kind that face each other, "left" at −half and "right" at +half [m] on the object's x axis."""
    return [
        Station(robot, name, (x, 0.0), yaw, stance) for name, x, yaw in (("left", -half, 0.0), ("right", half, 180.0))
    ]


def _placed(station: Station, stance: Stance, arm: Arm, T_world_object: pin.SE3) -> tuple[Arm, pin.SE3]:
    """The arm of a station at its base placement, and T_object_tool."""
    turn = pin.utils.rotate("z", float(np.deg2rad(station.yaw)))
    hold = T_world_object.act(np.array([*station.point, 0.0]))
    base = hold - turn @ np.array([stance.reach, 0.0, stance.height])
    T_world_tool = pin.SE3(turn @ stance.tool, hold)
    return arm.placed(pin.SE3(turn, base), name=station.name), T_world_object.actInv(T_world_tool)


def _near(arm: Arm, near: tuple[float, ...]) -> Array:
    """Positions in radians; of prismatic joints in metres."""
    joints = list(arm.model.joints)[1:]  # the first is the world
    prismatic = [joint.shortname().startswith("JointModelP") for joint in joints]
    return np.where(prismatic, near, np.deg2rad(near))


def moved(
    height: float,
    translation: Sequence[float],
    rotation: Sequence[float],
    duration: float,
    time_law: TimeLaw | str = TimeLaw.QUINTIC,
) -> LinePath:
    """An object at a height above the origin [m] that moves by a translation [m] and a rotation vector [rad]."""
    start = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
    return LinePath.displaced(start, translation=translation, rotation=rotation, duration=duration, time_law=time_law)


def put_together(
    name: str,
    stations: Sequence[Station],
    path: ObjectPath,
    *,
    dt: float = 0.002,
    object_size: tuple[float, float, float],
    object_mass: float,
    geometry: bool = True,
) -> Scenario:
    """Build a scenario of arms that stand around the object at the start of ``path``.

    ``geometry``: also load the meshes.
    """
    start = path.pose(0.0)
    robots = {robot: robot_arm(robot, geometry=geometry) for robot in {station.robot: None for station in stations}}
    stances = [station.stance or STANCES[station.robot] for station in stations]
    both = [_placed(one, stance, robots[one.robot], start) for one, stance in zip(stations, stances, strict=True)]
    arms, tools = zip(*both, strict=True)
    cell, grasp = RobotCell(arms), Grasp(tools)
    near = cell.configuration(
        np.concatenate([_near(arm, stance.near) for arm, stance in zip(arms, stances, strict=True)])
    )
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
