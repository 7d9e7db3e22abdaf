"""The program of a cell file, from its phases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError
from coopqp.files.cellfile.basic import PlacementTable
from coopqp.files.cellfile.build_arm import build_placement
from coopqp.files.cellfile.phases import PhaseLineTable, PhaseTable
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.path import ObjectPath, WaypointPath
from coopqp.programs.program import Phase, Program
from coopqp.programs.roles import Holds, Role, Slides, Travels, Turns, Waits, Works


def build_program(
    tables: Sequence[PhaseTable],
    signals: Mapping[str, float],
    cell: RobotCell,
    grasp: Grasp,
    build_path: Callable[[Any], ObjectPath],
) -> Program:
    """The program of a cell file.

    Args:
        tables, signals: of the phases; seconds after the start of a run, by the signal's name.
        cell, grasp: the arms, and how they hold the object when it begins.
        build_path: makes a path from its table.
    """
    phases: list[Phase] = []
    end: pin.SE3 | None = None
    for table in tables:
        path = None if table.path is None else build_path(_begun(table, end))
        if path is not None:
            end = path.pose(path.duration)
        roles = {name: _role(role) for name, role in table.arms.items()}
        phases.append(Phase(table.name, path=path, duration=table.duration_s, arms=roles, until=table.until))
    return Program(cell, grasp, phases, signals=dict(signals))


def first_pose(tables: Sequence[PhaseTable], build_path: Callable[[Any], ObjectPath]) -> pin.SE3:
    """Where the object is when the program begins: at the start of its first path."""
    for table in tables:
        if table.path is not None:
            return build_path(_begun(table, None)).pose(0.0)
    raise InvalidInputError("no phase has a path", "phases", "Give one a path, of kind line for example.")


def _begun(table: PhaseTable, end: pin.SE3 | None) -> Any:
    """The table of a phase's path, with its start."""
    path = table.path
    if not isinstance(path, PhaseLineTable) or path.start is not None:
        return path
    if end is None:
        raise InvalidInputError(
            "its line has no start", f"phases '{table.name}': path", "The first path of a program needs start."
        )
    start = PlacementTable.model_validate({"matrix": end.homogeneous.tolist()})
    return path.model_copy(update={"start": start})


def _role(table: Any) -> Role:
    if table.kind == "holds":
        return Holds()
    if table.kind == "waits":
        return Waits()
    if table.kind == "travels":
        return Travels(to=build_placement(table.to), retreat_m=table.retreat_m)
    if table.kind == "works":
        poses = [build_placement(pose) for pose in table.poses]
        return Works(on=WaypointPath(poses, durations=table.durations_s, time_law=table.time_law))
    if table.kind == "turns":
        angle = table.angle_rad if table.angle_deg is None else float(np.deg2rad(table.angle_deg))
        return Turns(about=table.about_m, axis=table.axis, angle=angle, holds=table.holds)
    return Slides(axis=table.axis, distance_m=table.distance_m)
