"""Cells of two to sixty-four arms of four to seven joints.

The robots come with coopqp; the well-known ones of ``panda_bar`` and ``ur5_table`` with the extra ``robots``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.paths.path import WaypointPath
from coopqp.paths.scenario import Scenario
from coopqp.paths.time_law import TimeLaw
from coopqp.scenarios.stations import STANCES, Station, facing, moved, put_together
from coopqp.scenarios.units import Radians, Seconds


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
    path = moved(0.25, translation, rotation, duration, time_law)
    stations = facing("arm7", 0.30)
    return put_together("dual_arm7", stations, path, object_size=(0.60, 0.05, 0.05), object_mass=1.2)


def mixed_cell(*, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Four different arms move a plate: six joints (one of them continuous), seven, and six on a rail.

    Because of the continuous joint, the configuration has one number more than the velocity.
    """
    path = moved(0.35, (0.06, -0.05, 0.15), (0.15, -0.12, 0.20), duration, time_law)
    stations = [
        Station("rx90l", "rx90l", (-0.45, 0.0), 0.0),
        Station("arm7", "arm7", (0.0, 0.45), -90.0),
        Station("arm6c", "arm6c", (0.45, 0.0), 180.0),
        Station("gantry7", "gantry7", (0.0, -0.45), 90.0),
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
    stance = STANCES[robot]._replace(height=0.25)
    radius = max(0.50, 0.50 * arms / (2.0 * np.pi))
    tilt = 0.10 / radius
    turn = (0.6 * tilt, 0.6 * tilt, 0.5 * tilt)
    path = moved(stance.height, (0.05, 0.03, 0.18), turn, duration, time_law)
    stations = []
    for k in range(arms):
        angle = 360.0 * k / arms
        point = radius * math.cos(math.radians(angle)), radius * math.sin(math.radians(angle))
        stations.append(Station(robot, f"arm_{k + 1}", point, angle + 180.0, stance))
    size = 2.0 * radius
    return put_together("ring", stations, path, object_size=(size, size, 0.05), object_mass=5.0 * arms)


def scara_pair(*, tilt: Radians = 0.0, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Two four-joint arms move a bar. They can shift, lift and turn it, but always keep it level.

    Args:
        tilt: rotation of the path about the bar's axis [rad]; these arms cannot follow it.
        duration: duration of the path [s].
        time_law: time law of the path.
    """
    path = moved(0.12, (0.05, 0.08, 0.06), (tilt, 0.0, 0.30), duration, time_law)
    stations = facing("scara4", 0.20)
    return put_together("scara_pair", stations, path, object_size=(0.45, 0.04, 0.04), object_mass=0.8)


def five_joint_pair(*, duration: Seconds = 4.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Two five-joint arms in one vertical plane lift and pitch a bar in the plane, then roll it about its own axis.

    Together the arms can do only these motions. The path has two segments.
    """
    start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.25]))
    lifted = pin.SE3(pin.exp3(np.array([0.0, 0.20, 0.0])), np.array([0.04, 0.0, 0.35]))
    rolled = pin.SE3(lifted.rotation @ pin.exp3(np.array([0.40, 0.0, 0.0])), lifted.translation)
    path = WaypointPath([start, lifted, rolled], durations=[0.6 * duration, 0.4 * duration], time_law=time_law)
    stations = facing("arm5", 0.25)
    return put_together("five_joint_pair", stations, path, object_size=(0.50, 0.04, 0.04), object_mass=1.0)


def panda_bar(*, geometry: bool = True, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Two seven-joint pandas with locked fingers and their acceleration limits move a bar of 1 m and 3 kg.

    Args:
        geometry: also load the meshes (about half a second, once).
        duration: duration of the path [s].
        time_law: time law of the path.

    Raises:
        MissingExtraError: ``example-robot-data`` is not installed.
    """
    path = moved(0.30, (0.06, 0.10, 0.20), (0.30, 0.15, 0.20), duration, time_law)
    return put_together(
        "panda_bar", facing("panda", 0.40), path, object_size=(1.00, 0.04, 0.04), object_mass=3.0, geometry=geometry
    )


def ur5_table(*, geometry: bool = True, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Four UR5 along the long sides of a table top of 1.2 x 0.8 m and 12 kg move it.

    Args:
        geometry: also load the meshes (about half a second, once).
        duration: duration of the path [s].
        time_law: time law of the path.

    Raises:
        MissingExtraError: ``example-robot-data`` is not installed.
    """
    path = moved(0.30, (0.08, 0.05, 0.15), (0.15, -0.12, 0.10), duration, time_law)
    stations = [
        Station("ur5", f"ur5_{k + 1}", (x, y), -90.0 if y > 0.0 else 90.0)
        for k, (x, y) in enumerate(((-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4)))
    ]
    return put_together(
        "ur5_table", stations, path, object_size=(1.20, 0.80, 0.03), object_mass=12.0, geometry=geometry
    )
