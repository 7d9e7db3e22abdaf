"""The program of a cell file, from its phases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError
from coopqp.files.cellfile.basic import PlacementTable
from coopqp.files.cellfile.build_arm import build_placement, in_radians
from coopqp.files.cellfile.phases import FollowsJointsTable, PhaseLineTable, PhaseSearchTable, PhaseTable
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.joint_path import JointPath
from coopqp.paths.path import HoldPath, ObjectPath, WaypointPath
from coopqp.planning.route.of_phase import Search
from coopqp.programs.program import Phase, Program
from coopqp.programs.roles import Follows, FollowsJoints, Holds, Role, Slides, Travels, Turns, Waits, Works
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene
    from coopqp.files.cellfile.schema import CellFile


def build_program(
    file: CellFile,
    cell: RobotCell,
    grasp: Grasp,
    q_start: Array | None,
    scene: CollisionScene | None,
    build_path: Callable[[Any], ObjectPath],
) -> Program:
    """The program of a cell file.

    Args:
        file: its phases, signals, and how near a tool attaches.
        cell, grasp: the arms, and how they hold the object when it begins.
        q_start: the start (nq,), if the file gives one.
        scene: its bodies; None without.
        build_path: makes a path from its table.
    """
    phases: list[Phase] = []
    end: pin.SE3 | None = None
    for table in file.phases:
        path: ObjectPath | Search | None = None
        if isinstance(table.path, PhaseSearchTable):
            path = _search(table.path, table.name, scene)
            end = build_placement(table.path.goal)
        elif table.path is not None:
            path = build_path(_begun(table, end))
            end = path.pose(path.duration)
        roles = {name: _role(role, cell, name, build_path) for name, role in table.arms.items()}
        phases.append(Phase(table.name, path=path, duration=table.duration_s, arms=roles, until=table.until))
    near = {"attach_m": 1e-3 * file.attach.distance_mm, "attach_rad": float(np.deg2rad(file.attach.angle_deg))}
    made = Program(cell, grasp, phases, signals=dict(file.signals_s), q_start=q_start, **near)
    made.planned_share = _planned_share(made)
    return made


def _planned_share(program: Program) -> float | None:
    """The share of the limits that all that moves in a program was planned with; None if something was not."""
    paths = [phase.path for phase in program.phases]
    paths += [role.on for phase in program.phases for role in phase.arms.values() if isinstance(role, Follows)]
    others = {type(role) for phase in program.phases for role in phase.arms.values()} - {Follows, Holds, Waits}
    moving = [path for path in paths if isinstance(path, ObjectPath) and not isinstance(path, HoldPath)]
    shares = [path.planned_share for path in moving]
    return None if others or not shares or None in shares else min(share for share in shares if share is not None)


def first_pose(tables: Sequence[PhaseTable], build_path: Callable[[Any], ObjectPath]) -> pin.SE3:
    """Where the object is when the program begins: at the start of its first path."""
    for table in tables:
        if isinstance(table.path, PhaseSearchTable):
            if table.path.start is None:
                raise InvalidInputError(
                    "its search has no start",
                    f"phases '{table.name}': path",
                    "The first path of a program needs start.",
                )
            return build_placement(table.path.start)
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


def _search(table: PhaseSearchTable, name: str, scene: CollisionScene | None) -> Search:
    """The search of a phase."""
    where = f"phases '{name}': path"
    if scene is None:
        raise InvalidInputError("it is searched, and no bodies are known", where, "Add a table [collision].")
    if table.goal.free:
        raise InvalidInputError("its goal has free turns", where, "Give a goal without: the next phase begins there.")
    start = None if table.start is None else build_placement(table.start)
    return Search(build_placement(table.goal), scene, speed=table.speed_m_per_s, options=table.options, start=start)


def _way(table: FollowsJointsTable, cell: RobotCell, name: str) -> JointPath:
    """The way of an arm's joints."""
    degrees = table.positions_deg is not None
    where = f"arms.{name}.positions_{'deg' if degrees else 'rad'}"
    rows = table.positions_deg or table.positions_rad or []
    kinematics = ArmKinematics(cell.arms[cell.index(name)])
    slides = kinematics.slides.tolist()
    positions = [in_radians(row, slides, where, degrees=degrees) for row in rows]
    if table.speeds_rad_per_s is None:
        return JointPath(positions, table.durations_s)
    clocks = np.concatenate([[0.0], np.cumsum(table.durations_s)])
    return JointPath.through(clocks, positions, table.speeds_rad_per_s)


def _role(table: Any, cell: RobotCell, name: str, build_path: Callable[[Any], ObjectPath]) -> Role:
    if table.kind == "follows":
        on, frame = build_path(table.path), build_placement(table.frame)
        return Follows(on, frame, holds=table.holds, holds_after=table.holds_after)
    if table.kind == "follows_joints":
        return FollowsJoints(_way(table, cell, name))
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
