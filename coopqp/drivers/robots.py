"""The robots of a cell: drivers with the joints that they drive, by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coopqp.drivers.driver import RobotDriver
from coopqp.drivers.options import LONGEST_PERIOD
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

_METHODS = ("connect", "read", "send", "stop")


@dataclass(frozen=True, eq=False)
class Robot:
    """A driver in a cell.

    Attributes:
        name: the robot's name.
        driver: its driver.
        joints: index of each of the driver's joints among the cell's velocity coordinates (n,).
        arms: names of the arms whose own joints are among these; none where all are joints that arms share.
    """

    name: str
    driver: RobotDriver
    joints: npt.NDArray[np.intp]
    arms: tuple[str, ...]


def driver_names(cell: RobotCell) -> tuple[str, ...]:
    """What a driver of a cell may be named after: the robots with several arms, then the arms."""
    robots = [arm.robot for arm in cell.arms if arm.robot]
    return tuple(dict.fromkeys([*(name for name in robots if robots.count(name) > 1), *cell.arm_names]))


def driven_joints(cell: RobotCell, names: Iterable[str] = ()) -> dict[str, npt.NDArray[np.intp]]:
    """The joints of each driver of a cell, as velocity coordinates (n,), by the name of its robot or arm.

    The own joints of an arm belong to the driver of its name. What arms share, and the joints of arms without a driver
    of their own, belong to the driver of their robot.

    Args:
        cell: the arms.
        names: drivers that there are, of :func:`driver_names`. Arms that none of them has have one by themselves, and
            arms that share joints one for their robot.
    """
    given = set(names)
    owners = [""] * cell.nv
    for arm, columns, own in zip(cell.arms, cell.columns, cell.v_slices, strict=True):
        by_robot = arm.name not in given and bool(arm.shared or arm.robot in given)
        for j in columns:
            owners[j] = arm.robot if by_robot or not own.start <= j < own.stop else arm.name
    return {name: np.flatnonzero(np.array(owners) == name) for name in dict.fromkeys(owners)}


def arms_of(cell: RobotCell, joints: npt.NDArray[np.intp]) -> tuple[str, ...]:
    """Names of the arms that have own joints among velocity coordinates (n,)."""
    having = zip(cell.arm_names, cell.v_slices, strict=True)
    return tuple(name for name, own in having if ((joints >= own.start) & (joints < own.stop)).any())


def robots_of(cell: RobotCell, drivers: Mapping[str, RobotDriver]) -> tuple[Robot, ...]:
    """The robots of a cell, with their joints by name.

    Args:
        cell: the arms.
        drivers: a driver by the name of its arm or robot. Its joints are named as in the cell, ``arm/joint`` and
            ``robot/joint``; or without the name of the driver, or that of an arm of the robot whose name it has.

    Raises:
        InvalidInputError: no driver, a joint that the cell does not have, one with two drivers or with none, or two
            drivers of one robot or of the same joints on one topic.
    """
    if not isinstance(drivers, Mapping) or not drivers:
        raise InvalidInputError("no drivers", "ControlLoop: drivers", "Give a mapping from arm to driver.")
    found: list[Robot] = []
    owner: dict[str, str] = {}
    claimed: dict[str, str] = {}
    for name, driver in drivers.items():
        where = f"ControlLoop: driver '{name}'"
        missing = [m for m in _METHODS if not callable(getattr(driver, m, None))]
        if isinstance(driver, type) or missing:
            raise InvalidInputError(
                f"a {type(driver).__name__} without {', '.join(missing) or 'an instance'}", where, "Give a RobotDriver."
            )
        joints = []
        for joint in driver.joint_names:
            full = _full_name(cell, name, joint)
            if full not in cell.joint_names:
                raise InvalidInputError(
                    f"the cell has no joint '{full}'", where, f"Its joints: {', '.join(cell.joint_names)}."
                )
            if full in owner:
                raise InvalidInputError(
                    f"joint '{full}' also has the driver '{owner[full]}'", where, "Give each joint one driver."
                )
            owner[full] = name
            joints.append(cell.joint_names.index(full))
        for claim in getattr(driver, "claims", ()):
            if claim in claimed:
                raise InvalidInputError(
                    f"{claim}: the driver '{claimed[claim]}' has the same",
                    where,
                    "Give each robot an address, or topics, or a joint_prefix of its own.",
                )
            claimed[claim] = name
        index = np.array(joints, dtype=np.intp)
        found.append(Robot(name, driver, index, arms_of(cell, index)))
    none = [joint for joint in cell.joint_names if joint not in owner]
    if none:
        raise InvalidInputError(
            f"no driver has the joint '{none[0]}'" + (f" nor {len(none) - 1} more" if len(none) > 1 else ""),
            "ControlLoop: drivers",
            f"Give one for each of {', '.join(driven_joints(cell, set(drivers) & set(driver_names(cell))))}.",
        )
    return tuple(found)


def _full_name(cell: RobotCell, driver: str, joint: str) -> str:
    """The name in the cell of a driver's joint; of one that the cell does not have, as if it were the driver's own."""
    owners = [driver, *(arm.name for arm in cell.arms if arm.robot == driver)]
    names = [joint, *(f"{owner}/{joint}" for owner in owners)]
    return next((name for name in names if name in cell.joint_names), f"{driver}/{joint}")


def turned(cell: RobotCell, x: Array, joints: npt.NDArray[np.intp] | None = None) -> Array:
    """Differences of joint positions (n,), of all joints or of some; those of continuous joints in (−π, π]."""
    if cell.euclidean:
        return x
    continuous = cell.continuous if joints is None else cell.continuous[joints]
    return np.where(continuous, np.remainder(x + np.pi, 2.0 * np.pi) - np.pi, x)


def refusals(controller: Any, robots: tuple[Robot, ...], *, period: float, tells_target: bool) -> list[str]:
    """Why a cell is not driven, a sentence each; empty if it may be.

    Args:
        controller: the controller.
        robots: the robots.
        period: of the loop [s].
        tells_target: all robots tell what their servos track.
    """
    cell: RobotCell = controller.cell
    said = []
    unlimited = np.flatnonzero(~np.isfinite(cell.limits.acceleration))
    if unlimited.size:
        names = ", ".join(cell.joint_names[j] for j in unlimited[:3])
        said.append(
            f"joints without acceleration limits ({names}{' …' if unlimited.size > 3 else ''}): brakes would be jumps. "
            "Give acceleration_limits."
        )
    endless = np.flatnonzero(~np.isfinite(cell.limits.velocity))
    if endless.size:
        said.append(f"joint {cell.joint_names[endless[0]]} has no velocity limit. Give velocity_limits.")
    if period > LONGEST_PERIOD:
        said.append(f"the period is {1e3 * period:g} ms: {1e3 * LONGEST_PERIOD:g} ms at most.")
    inner = getattr(controller, "controller", controller)
    stiffness = getattr(getattr(getattr(inner, "options", None), "supervision", None), "stiffness", None)
    if (
        not tells_target
        and stiffness is None
        and len(cell) > 1
        and any(robot.driver.commands == "position" for robot in robots)
    ):
        said.append(
            "a position servo tells no target, and nothing is told of its stiffness: a rigid grip would hide an arm "
            "that stops. Give SupervisionOptions(stiffness=…)."
        )
    if getattr(getattr(getattr(inner, "options", None), "supervision", None), "servo_delay", 0.0) > 0.0:
        said.append("SupervisionOptions: servo_delay is told: the loop itself aligns measurements. Leave it at 0.")
    for robot in robots:
        if robot.driver.period > LONGEST_PERIOD:
            said.append(f"robot '{robot.name}' tells its state every {1e3 * robot.driver.period:g} ms: 20 ms at most.")
        limits = getattr(robot.driver, "limits", None)
        if limits is None:
            continue
        for name, more in (("velocity", True), ("acceleration", True), ("lower", False), ("upper", True)):
            own, ours = np.asarray(getattr(limits, name)), getattr(cell.limits, name)[robot.joints]
            wide = ours > own + 1e-9 if more else ours < own - 1e-9
            if wide.any():
                j = int(np.argmax(wide))
                said.append(
                    f"joint {cell.joint_names[robot.joints[j]]}: its {name} limit {ours[j]:g} is wider than the "
                    f"robot's {own[j]:g}. Give the robot's."
                )
    return said
