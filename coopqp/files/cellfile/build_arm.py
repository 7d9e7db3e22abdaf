"""Building an arm of a cell file: its model, its placement, its limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.files.cellfile.basic import PlacementTable
from coopqp.files.cellfile.paths import resolve
from coopqp.files.cellfile.schema import ArmTable, LimitsTable, RobotTable
from coopqp.model.cell import Arm, Robot, RobotCell, slides
from coopqp.model.description import description_file, read_urdf
from coopqp.model.joint_limits import LIMIT_FIELDS
from coopqp.model.mjcf import read_mjcf
from coopqp.scenarios.arms import robot_arm, robot_file
from coopqp.scenarios.robots import robot_path
from coopqp.spatial import Array, as_placement

#: In place of a model's limits, which may be none that a joint could keep: to learn its joints before they are given.
_NO_LIMITS: dict[str, Any] = {"lower_limits": -np.inf, "upper_limits": np.inf, "velocity_limits": np.inf}


def build_placement(table: PlacementTable) -> pin.SE3:
    """The placement of a table."""
    if table.matrix is not None:
        return as_placement(np.array(table.matrix), "matrix")
    angles = np.deg2rad(table.rpy_deg) if table.rpy_deg is not None else np.array(table.rpy_rad or (0.0, 0.0, 0.0))
    return pin.SE3(exact_turns(pin.rpy.rpyToMatrix(angles)), np.array(table.xyz_m or (0.0, 0.0, 0.0)))


def exact_turns(R: Array) -> Array:
    """A rotation matrix (3, 3) whose quarter turns are exact: entries within rounding of a whole number are whole."""
    whole = np.round(R)
    return np.where(np.abs(R - whole) < 4e-16, whole, R)


def in_radians(given: Any, sliding: Sequence[bool], where: str, *, degrees: bool) -> Array:
    """Joint values (n,) in radians (prismatic joints in metres), from one number or n numbers."""
    n = len(sliding)
    values = np.array(given, dtype=float)
    if values.ndim and values.shape != (n,):
        raise CoopqpError(f"{where} has {values.size} numbers for {n} joints.")
    values = np.array(np.broadcast_to(values, (n,)))
    return np.where(sliding, values, np.deg2rad(values)) if degrees else values


def build_arm(table: ArmTable, folder: Path) -> Arm:
    """The arm of a table; its files are relative to ``folder``."""
    base, where = build_placement(table.base), f"arm '{table.name}'"
    dirs = [resolve(d, folder, f"{where}: package_dirs") for d in table.package_dirs]
    common: dict[str, Any] = {"T_world_base": base, "tool_frame": table.tool_frame, "geometry": table.geometry}
    if table.robot is not None:
        common["locked_joints"] = _locked(table, lambda: _urdf(robot_file(str(table.robot)), table.name))
        arm = robot_arm(table.robot, name=table.name, **common)
        changes = _limits_of(table, arm)
        try:
            return arm.with_limits(**changes) if changes else arm
        except InvalidInputError as error:
            raise CoopqpError(f"{where}: {error}") from error
    if table.urdf is not None:
        file = resolve(table.urdf, folder, f"{where}: urdf", package_dirs=dirs)
        common |= {"locked_joints": _locked(table, lambda: _urdf(file, table.name)), "package_dirs": dirs}
        read: Callable[..., Arm] = Arm.from_urdf
    else:
        file = resolve(str(table.mjcf), folder, f"{where}: mjcf", package_dirs=dirs)
        common["locked_joints"] = _locked(table, lambda: _mjcf(file, table.name))
        read = Arm.from_mjcf
    if table.limits == LimitsTable():
        return read(table.name, file, **common)
    changes = _limits_of(table, read(table.name, file, **{**common, "geometry": False}, **_NO_LIMITS))
    return read(table.name, file, **common, **{f"{field}_limits": values for field, values in changes.items()})


def _limits_of(table: ArmTable, arm: Arm) -> dict[str, Array]:
    """The limits that an arm's table gives, one per joint of the arm."""
    alone = RobotCell([arm])
    sliding = slides(alone)
    changes: dict[str, Array] = {}
    for name, per in (("lower", ""), ("upper", ""), ("velocity", "_per_s"), ("acceleration", "_per_s2")):
        for unit in ("deg", "rad"):
            value = getattr(table.limits, f"{name}_{unit}{per}")
            if value is not None:
                where = f"arm '{table.name}': limits.{name}_{unit}{per}"
                if np.isfinite(value).all():
                    _check_kinds(value, alone, where, f"m{per.replace('_per_', '/').replace('s2', 's²')}")
                changes[name] = in_radians(value, sliding, where, degrees=unit == "deg")
    return changes


def build_cell(arms: Sequence[ArmTable], robots: Sequence[RobotTable], folder: Path) -> RobotCell:
    """The cell of the tables of a file; its files are relative to ``folder``."""
    made: dict[str, Arm] = {}
    for table in robots:
        tools = {arm.name: str(arm.tool_frame) for arm in arms if arm.of == table.name}
        made |= {arm.name: arm for arm in _robot(table, tools, folder).arms}
    return RobotCell([build_arm(arm, folder) if arm.of is None else made[arm.name] for arm in arms])


def _robot(table: RobotTable, tools: dict[str, str], folder: Path) -> Robot:
    """The robot of a table, with its arms and their tool frames."""
    where = f"robot '{table.name}'"
    dirs = [resolve(d, folder, f"{where}: package_dirs") for d in table.package_dirs]
    if table.robot is not None:
        file = robot_path(table.robot)
    else:
        file = resolve(str(table.urdf), folder, f"{where}: urdf", package_dirs=dirs)
    locked = _locked(table, lambda: _urdf(file, table.name))
    common: dict[str, Any] = {
        "name": table.name, "T_world_base": build_placement(table.base), "package_dirs": dirs,
        "geometry": table.geometry, "locked_joints": locked,
    }  # fmt: skip
    if not table.limits:
        return Robot(file, tools, **common)
    alone = RobotCell([Robot(file, tools, **{**common, "geometry": False}, **_NO_LIMITS).arms[0]])
    kinds = {name.partition("/")[2]: slide for name, slide in zip(alone.joint_names, slides(alone), strict=True)}
    changes: dict[str, dict[str, float]] = {field: {} for field in LIMIT_FIELDS}
    for joint in sorted(table.limits, key=lambda name: name != "*"):
        limits = table.limits[joint]
        if joint != "*" and joint not in kinds:
            raise CoopqpError(f"{where}: limits: the model has no joint '{joint}'; joints: {', '.join(kinds)}.")
        meant = [name for name, slide in kinds.items() if not slide] if joint == "*" else [joint]
        for field, per in (("lower", ""), ("upper", ""), ("velocity", "_per_s"), ("acceleration", "_per_s2")):
            for unit in ("deg", "rad"):
                value = getattr(limits, f"{field}_{unit}{per}")
                if value is None:
                    continue
                if isinstance(value, list):
                    raise CoopqpError(f"{where}: limits.{joint}.{field}_{unit}{per}: give one number.")
                for name in meant:
                    changes[field][name] = float(np.deg2rad(value)) if unit == "deg" and not kinds[name] else value
    common |= {f"{field}_limits": values for field, values in changes.items() if values}
    return Robot(file, tools, **common)


def build_stiffness(tables: Sequence[ArmTable], cell: RobotCell) -> Array | None:
    """Kp of all joint servos (nv,) [N·m/rad or N/m]; None if no arm tells it.

    Raises:
        CoopqpError: some arms tell it and others do not, or in another number than that of their joints; or two arms
            tell two numbers of a joint that they share.
    """
    silent = [table.name for table in tables if table.stiffness_nm_per_rad is None]
    if len(silent) == len(tables):
        return None
    if silent:
        raise CoopqpError(
            f"arm '{silent[0]}': stiffness_nm_per_rad is missing. Forces are read from the servos of all arms or of "
            "none: give it for every arm."
        )
    out = np.full(cell.nv, np.nan)
    for table, arm, columns in zip(tables, cell.arms, cell.columns, strict=True):
        alone, where = RobotCell([arm]), f"arm '{table.name}': stiffness_nm_per_rad"
        _check_kinds(table.stiffness_nm_per_rad, alone, where, "N/m")
        row = in_radians(table.stiffness_nm_per_rad, slides(alone), where, degrees=False)
        other = np.flatnonzero(np.isfinite(out[columns]) & (out[columns] != row))
        if other.size:
            told = out[columns[other[0]]]
            raise CoopqpError(
                f"{where}: {row[other[0]]:g} for '{cell.joint_names[columns[other[0]]]}', which another arm shares and "
                f"has {told:g}. Give the same number for both."
            )
        out[columns] = row
    return out


def _check_kinds(value: Any, alone: RobotCell, where: str, unit: str) -> None:
    """Refuse one number for joints that turn and joints that slide, whose unit is another."""
    sliding = slides(alone)
    if np.ndim(value) == 0 and len(set(sliding)) == 2:
        slide = alone.joint_names[sliding.index(True)].partition("/")[2]
        raise CoopqpError(
            f"{where}: one number would be for joints that turn and for '{slide}', which slides "
            f"[{unit}]. Give a list with one number per joint: {len(sliding)}."
        )


def _urdf(file: Path, arm: str) -> pin.Model:
    read_urdf(description_file(file, arm), arm)
    return pin.buildModelFromUrdf(str(file))


def _mjcf(file: Path, arm: str) -> pin.Model:
    return read_mjcf(description_file(file, arm), arm).model


def _locked(table: ArmTable | RobotTable, model: Callable[[], pin.Model]) -> dict[str, float] | None:
    """Positions of the locked joints [rad or m]; prismatic joints are in metres under the keys of either unit."""
    locked = dict(table.locked_joints_rad)
    if table.locked_joints_deg:
        try:
            whole = model()
        except (ValueError, RuntimeError):  # the reader of the arm names the fault
            return {**locked, **table.locked_joints_deg}
        for name, value in table.locked_joints_deg.items():
            if name in locked:
                raise CoopqpError(f"'{table.name}': '{name}' is in locked_joints_deg and in locked_joints_rad.")
            known = whole.existJointName(name)
            slide = known and whole.joints[whole.getJointId(name)].shortname().startswith("JointModelP")
            locked[name] = value if slide else float(np.deg2rad(value))
    return locked or None
