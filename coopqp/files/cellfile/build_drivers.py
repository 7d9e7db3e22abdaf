"""The drivers of a cell file: which joints each has, and what is wrong with its tables."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coopqp.drivers.driver import RobotDriver
from coopqp.drivers.kinds import DRIVER_KINDS
from coopqp.drivers.robots import arms_of, driven_joints, driver_names
from coopqp.errors import InvalidInputError
from coopqp.files.cellfile.error import CellFileError
from coopqp.files.cellfile.strict import build_options
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array


def make_drivers(
    cell: RobotCell, tables: Mapping[str, Any], q_start: Array, kind: str | None, file: Path | None
) -> dict[str, RobotDriver]:
    """A new driver for each robot.

    Args:
        cell: the arms.
        tables: the file's, by the name of a robot or an arm.
        q_start: where robots in simulation stand (nq,).
        kind: this kind for every robot; None for that of its table.
        file: the file, for messages.

    Raises:
        CellFileError: a robot without a driver, a driver without a robot, or one that does not fit its robot.
        MissingExtraError: a kind whose extra is not installed.
    """
    names = driver_names(cell)
    for name in tables:
        if name not in names:
            raise CellFileError(f"{file}: drivers: no {_listed(cell, name)}.")
    joints = driven_joints(cell, tables)
    for name in tables:
        if name not in joints:
            raise CellFileError(
                f"{file}: drivers.{name}: every arm of this robot has a driver of its own. Leave it out."
            )
    x, made = cell.positions(q_start), dict[str, RobotDriver]()
    for name, own in joints.items():
        if kind is None and name not in tables:
            what = f"arm '{name}'" if name in cell.arm_names else f"robot '{name}' ({', '.join(_parts(cell, own))})"
            raise CellFileError(f"{file}: {what} has no driver. Give a table [drivers.{name}], or --driver sim.")
        table = tables[name] if name in tables and kind in (None, tables[name].kind) else None
        chosen = kind or str(tables[name].kind)
        _refuse_several(cell, name, chosen, own, file)
        # A robot has one description, so that the joints' own names tell them apart.
        own_names = [cell.joint_names[j].partition("/")[2] for j in own]
        try:
            options = {} if table is None else build_options(DRIVER_KINDS[chosen].options, table)
            made[name] = DRIVER_KINDS[chosen].make(own_names, x[own], options)
        except InvalidInputError as error:
            raise CellFileError(f"{file}: drivers.{name}: {error}") from error
    return made


def _listed(cell: RobotCell, name: str) -> str:
    """A name that nothing of the cell has, and those that there are."""
    robots = [known for known in driver_names(cell) if known not in cell.arm_names]
    arms = f"arms: {', '.join(cell.arm_names)}"
    if not robots:
        return f"arm named '{name}'; {arms}"
    return f"robot or arm named '{name}'; robots: {', '.join(robots)}; {arms}"


def _parts(cell: RobotCell, joints: npt.NDArray[np.intp]) -> list[str]:
    """The joints that arms share among velocity coordinates (n,), and the arms that have own ones there."""
    return [*(cell.joint_names[j] for j in joints if j in cell.shared), *arms_of(cell, joints)]


def _refuse_several(cell: RobotCell, name: str, kind: str, joints: npt.NDArray[np.intp], file: Path | None) -> None:
    """Raise where a driver of one arm has more.

    Raises:
        CellFileError: it has joints of several arms, or joints that arms share.
    """
    parts, arms = _parts(cell, joints), arms_of(cell, joints)
    if not DRIVER_KINDS[kind].one_arm or parts == list(arms[:1]):
        return
    remedy = f"each arm a table of its own, {', '.join(f'[drivers.{arm}]' for arm in arms)}" if arms else ""
    if len(parts) > len(arms):
        rest = f"[drivers.{name}] another kind for {', '.join(parts[: -len(arms) or None])}"
        remedy = f"{remedy}, and {rest}" if remedy else rest
    raise CellFileError(
        f"{file}: drivers.{name}: a driver '{kind}' has one arm, and this robot has {', '.join(parts)}. Give {remedy}."
    )
