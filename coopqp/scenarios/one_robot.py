"""Robots whose arms share a joint: a lift, and a rail, with two arms each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.model.robot import Robot
from coopqp.paths.path import LinePath, ObjectPath, WaypointPath
from coopqp.paths.scenario import Scenario
from coopqp.scenarios.robots import SEVERAL_ARMS, robot_path
from coopqp.scenarios.units import Seconds
from coopqp.spatial import Array


def _cell(robot: str, name: str, turning: float, sliding: float) -> RobotCell:
    """A robot with accelerations of the joints that turn [rad/s²], and of the first one, which slides [m/s²]."""
    cell = RobotCell([Robot(robot_path(robot), SEVERAL_ARMS[robot], name=name)])
    return cell.with_limits(acceleration=np.where(np.isin(np.arange(cell.nv), cell.shared), sliding, turning))


def _ends(half: float) -> Grasp:
    """Two tools that point at the ends of a bar along y, ``half`` [m] from its middle."""
    return Grasp(
        tuple(pin.SE3(pin.utils.rotate("x", side * np.pi / 2), np.array([0.0, side * half, 0.0])) for side in (1, -1))
    )


def torso_lift(*, duration: Seconds = 8.0) -> Scenario:
    """A lift with two arms raises a bar by 1.5 m: more than its arms can at any one height of the lift.

    Args:
        duration: duration of the path.
    """
    cell, grasp = _cell("lift2", "lift", np.deg2rad(300.0), 0.5), _ends(0.30)
    path = LinePath.displaced(
        pin.SE3(np.eye(3), np.array([0.55, 0.0, 0.20])), translation=(0.0, 0.0, 1.5), duration=duration
    )
    left = np.array([-2.7397, -2.2544, -0.6063, -0.2808, 0.4019, 0.0])
    near = np.concatenate([[0.3], left, [0.4019], -left[1:-1], [0.0]])
    return _held("torso_lift", cell, grasp, path, near, width=0.60, mass=3.0)


def two_on_a_rail(*, duration: Seconds = 6.0) -> Scenario:
    """Two arms of seven joints that face each other on one rail carry a bar along it by 1.6 m and up.

    Args:
        duration: duration of the path.
    """
    cell, grasp = _cell("rail2", "gantry", np.deg2rad(600.0), 2.0), _ends(0.15)
    places = ((-0.8, 0.50, 0.0), (0.0, 0.75, 10.0), (0.8, 0.60, 0.0))
    poses = [pin.SE3(pin.utils.rotate("y", np.deg2rad(tilt)), np.array([x, 0.0, z])) for x, z, tilt in places]
    path = WaypointPath(poses, durations=[0.5 * duration, 0.5 * duration])
    left = [-1.6502, 0.9511, 0.2692, 0.9432, 1.3860, 1.4296, -0.3016]
    near = np.array([-0.2, *left, 1.7401, 0.9795, -0.4651, 0.9432, -1.2337, 1.3616, 0.2831])
    return _held("two_on_a_rail", cell, grasp, path, near, width=0.30, mass=2.0)


def _held(
    name: str, cell: RobotCell, grasp: Grasp, path: ObjectPath, near: Array, *, width: float, mass: float
) -> Scenario:
    """The scenario of a bar along y, from a start near positions (nv,)."""
    q_start = inverse_kinematics(cell, grasp, path.pose(0.0), cell.configuration(near))
    return Scenario(name, cell, grasp, path, q_start, dt=0.005, object_size=(0.05, width, 0.05), object_mass=mass)


#: Scenarios whose arms share joints.
SHARED_JOINTS: Mapping[str, Callable[[], Scenario]] = MappingProxyType(
    {make.__name__: make for make in (torso_lift, two_on_a_rail)}
)
