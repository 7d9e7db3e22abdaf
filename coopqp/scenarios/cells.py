"""Cells of the robots that come with coopqp: two to sixty-four arms of four to seven joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.paths.path import LinePath, TimeLaw, WaypointPath
from coopqp.paths.scenario import Scenario
from coopqp.scenarios.arms import robot_arm
from coopqp.scenarios.stations import DOWN, FORWARD, Station, put_together
from coopqp.scenarios.units import Radians, Seconds
from coopqp.spatial import Array

#: Postures at the start [deg or m]. arm7 holds from above, the other arms from the side.
ARM7_NEAR = (0.0, 14.0, 0.0, 105.0, 0.0, 31.0, 0.0)
ARM7_TOOL = pin.utils.rotate("y", np.deg2rad(150.0))
RX90L_NEAR = (0.0, 38.0, 102.0, 0.0, -50.0, 0.0)
_ARM6C_NEAR = (-19.0, 4.3, 113.0, 62.7, 71.0, -90.0)
_GANTRY7_NEAR = (0.0, 0.0, 45.0, 97.0, 0.0, -52.0, 0.0)


def facing(
    robot: str, half: float, *, reach: float, height: float, near: Sequence[float], tool: Array = FORWARD
) -> list[Station]:
    """Two arms of one kind that face each other, "left" at −half and "right" at +half [m] on the object's x axis.

    The other arguments are as in :class:`Station`.
    """
    return [
        Station(
            arm=robot_arm(robot, name=name),
            point=(x, 0.0, 0.0),
            yaw=yaw,
            reach=reach,
            height=height,
            near=near,
            tool=tool,
        )
        for name, x, yaw in (("left", -half, 0.0), ("right", half, 180.0))
    ]


def _at(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def dual_arm7(
    *,
    translation: Sequence[float] = (0.05, 0.08, 0.20),
    rotation: Sequence[float] = (0.25, 0.15, 0.20),
    duration: Seconds = 3.0,
    time_law: TimeLaw | str = TimeLaw.QUINTIC,
) -> Scenario:
    """Two seven-joint arms that face each other move a bar of 1.2 kg. Needs no other package.

    Args:
        translation: translation of the bar [m].
        rotation: rotation of the bar, a rotation vector in world axes [rad].
        duration: duration of the path [s].
        time_law: time law of the path.
    """
    path = LinePath.displaced(
        _at(0.0, 0.0, 0.25), translation=translation, rotation=rotation, duration=duration, time_law=time_law
    )
    stations = facing("arm7", 0.30, reach=0.50, height=0.25, near=ARM7_NEAR, tool=ARM7_TOOL)
    return put_together("dual_arm7", stations, path, object_size=(0.60, 0.05, 0.05), object_mass=1.2)


def mixed_cell(*, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Four different arms move a plate: six joints (one of them continuous), seven, and six on a rail.

    Because of the continuous joint, the configuration has one number more than the velocity.
    """
    path = LinePath.displaced(
        _at(0.0, 0.0, 0.35),
        translation=(0.06, -0.05, 0.15),
        rotation=(0.15, -0.12, 0.20),
        duration=duration,
        time_law=time_law,
    )
    stations = [
        Station(
            arm=robot_arm("rx90l"),
            point=(-0.45, 0.0, 0.0),
            yaw=0.0,
            reach=0.80,
            height=0.30,
            near=RX90L_NEAR,
        ),
        Station(
            arm=robot_arm("arm7"),
            point=(0.0, 0.45, 0.0),
            yaw=-90.0,
            reach=0.50,
            height=0.25,
            near=ARM7_NEAR,
            tool=ARM7_TOOL,
        ),
        Station(
            arm=robot_arm("arm6c"),
            point=(0.45, 0.0, 0.0),
            yaw=180.0,
            reach=0.50,
            height=0.30,
            near=_ARM6C_NEAR,
        ),
        Station(
            arm=robot_arm("gantry7"),
            point=(0.0, -0.45, 0.0),
            yaw=90.0,
            reach=0.60,
            height=0.35,
            near=_GANTRY7_NEAR,
        ),
    ]
    return put_together("mixed_cell", stations, path, object_size=(0.90, 0.90, 0.03), object_mass=8.0)


def ring(
    *,
    arms: int = 8,
    robot: Literal["rx90l", "arm7"] = "rx90l",
    duration: Seconds = 3.0,
    time_law: TimeLaw | str = TimeLaw.QUINTIC,
) -> Scenario:
    """Arms at equal distances around a ring, whose size grows with their number. The benchmarks scale this cell.

    The ring rises and tilts. No grasp moves by more than about 0.3 m.

    Args:
        arms: number of arms, 2 to 64.
        robot: ``"rx90l"`` (six joints) or ``"arm7"`` (seven).
        duration: duration of the path [s].
        time_law: time law of the path.

    Raises:
        InvalidInputError: another number of arms.
        UnknownNameError: another robot.
    """
    if isinstance(arms, bool) or not isinstance(arms, (int, np.integer)) or not 2 <= arms <= 64:
        raise InvalidInputError(f"arms is {arms!r}", "ring", "Give a whole number from 2 to 64.")
    if robot not in ("rx90l", "arm7"):
        raise UnknownNameError("robot", str(robot), ("rx90l", "arm7"), "ring")
    six = robot == "rx90l"
    reach, height = (0.80, 0.25) if six else (0.50, 0.25)
    radius = max(0.50, 0.50 * arms / (2.0 * np.pi))
    tilt = 0.10 / radius
    path = LinePath.displaced(
        _at(0.0, 0.0, height),
        translation=(0.05, 0.03, 0.18),
        rotation=(0.6 * tilt, 0.6 * tilt, 0.5 * tilt),
        duration=duration,
        time_law=time_law,
    )
    angles = 360.0 * np.arange(arms) / arms
    stations = [
        Station(
            arm=robot_arm(robot, name=f"arm_{k + 1}"),
            point=(float(radius * np.cos(np.deg2rad(a))), float(radius * np.sin(np.deg2rad(a))), 0.0),
            yaw=float(a) + 180.0,
            reach=reach,
            height=height,
            near=RX90L_NEAR if six else ARM7_NEAR,
            tool=FORWARD if six else ARM7_TOOL,
        )
        for k, a in enumerate(angles)
    ]
    size = 2.0 * radius
    return put_together("ring", stations, path, object_size=(size, size, 0.05), object_mass=5.0 * arms)


def scara_pair(*, tilt: Radians = 0.0, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Two four-joint arms move a bar. They can shift, lift and turn it, but always keep it level.

    Args:
        tilt: rotation of the path about the bar's axis [rad]; these arms cannot follow it.
        duration: duration of the path [s].
        time_law: time law of the path.
    """
    path = LinePath.displaced(
        _at(0.0, 0.0, 0.12),
        translation=(0.05, 0.08, 0.06),
        rotation=(tilt, 0.0, 0.30),
        duration=duration,
        time_law=time_law,
    )
    stations = facing("scara4", 0.20, reach=0.42, height=0.12, near=(41.0, -91.0, -0.03, 50.0), tool=DOWN)
    return put_together("scara_pair", stations, path, object_size=(0.45, 0.04, 0.04), object_mass=0.8)


def five_joint_pair(*, duration: Seconds = 4.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Two five-joint arms in one vertical plane lift and pitch a bar in the plane, then roll it about its own axis.

    Together the arms can do only these motions. The path has two segments.
    """
    start = _at(0.0, 0.0, 0.25)
    lifted = pin.SE3(pin.exp3(np.array([0.0, 0.20, 0.0])), np.array([0.04, 0.0, 0.35]))
    rolled = pin.SE3(lifted.rotation @ pin.exp3(np.array([0.40, 0.0, 0.0])), lifted.translation)
    path = WaypointPath([start, lifted, rolled], durations=[0.6 * duration, 0.4 * duration], time_law=time_law)
    stations = facing("arm5", 0.25, reach=0.48, height=0.25, near=(0.0, 10.0, 115.0, -35.0, 0.0))
    return put_together("five_joint_pair", stations, path, object_size=(0.50, 0.04, 0.04), object_mass=1.0)
