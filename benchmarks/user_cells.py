"""Ten cells as users would build them, with the arms where they seem to belong and no thought of joint limits."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, RobotCell
from coopqp.scenarios import ROBOTS, robot_data_path, robot_path

DOWN = np.diag([1.0, -1.0, -1.0])
FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}


@functools.cache
def robot(name: str) -> Arm:
    if name.startswith(("ur", "panda")):
        file = "urdf/panda.urdf" if name == "panda" else f"urdf/{name}_robot.urdf"
        tool, locked = ("panda_hand_tcp", FINGERS) if name == "panda" else ("tool0", None)
        return Arm.from_urdf(name, robot_data_path(file), tool_frame=tool, geometry=False, locked_joints=locked)
    return Arm.from_urdf(name, robot_path(name), tool_frame=ROBOTS[name].tool_frame, geometry=False)


@dataclass(frozen=True)
class Place:
    """An arm: its robot, grasp point on the object [m], where it stands from there (reach, height) and its tool."""

    robot: str
    point: tuple[float, float]
    yaw: float
    reach: float
    height: float
    tool: Any


def pair(one: str, other: str, reach: tuple[float, float], height: tuple[float, float], tools: tuple[Any, Any]) -> Any:
    places = (((-0.35, 0.0), 0.0), ((0.35, 0.0), 180.0))
    return [
        Place(r, point, yaw, reach[k], height[k], tools[k])
        for k, (r, (point, yaw)) in enumerate(zip((one, other), places, strict=True))
    ]


def four(robots: tuple[str, ...], reach: tuple[float, ...], height: float, tools: tuple[Any, ...]) -> Any:
    points = (((-0.45, -0.3), 90.0), ((0.45, -0.3), 90.0), ((0.45, 0.3), -90.0), ((-0.45, 0.3), -90.0))
    return [
        Place(r, point, yaw, reach[k], height, tools[k])
        for k, (r, (point, yaw)) in enumerate(zip(robots, points, strict=True))
    ]


CELLS: dict[str, Any] = {
    "two ur10, bar": pair("ur10_joint_limited", "ur10_joint_limited", (0.7, 0.7), (0.3, 0.3), (DOWN, DOWN)),
    "panda, ur5": pair("panda", "ur5", (0.45, 0.5), (0.3, 0.3), (DOWN, FORWARD)),
    "two panda": pair("panda", "panda", (0.5, 0.5), (0.35, 0.35), (DOWN, DOWN)),
    "two panda, two ur5": four(("panda", "ur5", "panda", "ur5"), (0.45, 0.5, 0.45, 0.5), 0.3, (DOWN,) * 4),
    "gantry7, ur5": pair("gantry7", "ur5", (0.6, 0.5), (0.35, 0.3), (FORWARD, DOWN)),
    "rx90l, ur10": pair("rx90l", "ur10", (0.8, 0.7), (0.3, 0.3), (FORWARD, DOWN)),
    "arm7, panda": pair("arm7", "panda", (0.5, 0.45), (0.25, 0.3), (DOWN, DOWN)),
    "two scara4": pair("scara4", "scara4", (0.42, 0.42), (0.12, 0.12), (DOWN, DOWN)),
    "four ur5": four(("ur5",) * 4, (0.5,) * 4, 0.3, (FORWARD,) * 4),
    "arm6c, rx90l": pair("arm6c", "rx90l", (0.5, 0.8), (0.3, 0.3), (FORWARD, FORWARD)),
}


def build(name: str, rng: Any = None) -> tuple[RobotCell, Grasp, LinePath]:
    """A cell, its grasp and its path. With random numbers, arms stand elsewhere and hold with other rolls."""
    start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
    arms, tools = [], []
    level = name == "two scara4"
    for k, place in enumerate(CELLS[name]):
        yaw, reach, height, roll = np.deg2rad(place.yaw), place.reach, place.height, 0.0
        if rng is not None:
            yaw += rng.uniform(-0.6, 0.6)
            reach *= rng.uniform(0.6, 1.35)
            height += rng.uniform(-0.2, 0.2) * (0.1 if level else 1.0)
            roll = rng.uniform(-np.pi, np.pi)
        turn = pin.utils.rotate("z", yaw)
        hold = start.act(np.array([*place.point, 0.0]))
        T_world_tool = pin.SE3(turn @ place.tool @ pin.utils.rotate("z", roll), hold)
        base = pin.SE3(turn, hold - turn @ np.array([reach, 0.0, height]))
        arms.append(robot(place.robot).placed(base, name=f"{place.robot}_{k}"))
        tools.append(start.actInv(T_world_tool))
    path = LinePath.displaced(
        start, translation=(0.05, 0.08, 0.05), rotation=(0.0 if level else 0.15, 0.0, 0.2), duration=3.0
    )
    return RobotCell(arms), Grasp(tuple(tools)), path
