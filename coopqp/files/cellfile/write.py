"""Cell files that are written: the file of a plan, the file of a calibration, and plain tables in TOML."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pinocchio as pin
from pydantic import ValidationError

from coopqp.checks import as_floats
from coopqp.files.cellfile.build import DEFAULT_DT, ELBOWS, CellRun, read
from coopqp.files.cellfile.error import CellFileError
from coopqp.files.cellfile.explain import explain
from coopqp.files.cellfile.paths import folder_of, resolve
from coopqp.files.cellfile.schema import ArmTable, CellFile, RobotTable
from coopqp.forces.calibration import Calibration
from coopqp.model.cell import RobotCell
from coopqp.paths.timed import TimedPath
from coopqp.planning.planner import Plan
from coopqp.programs.program import Phase, Program
from coopqp.programs.roles import Follows, FollowsJoints, Role
from coopqp.spatial import Array, as_placement


def relative(path: Path, into: Path) -> str:
    """A path in a file of the folder ``into``."""
    try:
        return Path(os.path.relpath(path.absolute(), into.absolute())).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()


def move_files(tables: list[dict[str, Any]], arms: Sequence[ArmTable | RobotTable], folder: Path, into: Path) -> None:
    """Rewrite the paths of the tables ``arms`` or ``robots`` of a cell file for another folder.

    Args:
        tables: the tables that are written.
        arms: the same tables, as they were read.
        folder: folder of the file that was read.
        into: folder of the file that is written.

    Raises:
        CoopqpError: a path leads nowhere.
    """
    for table, arm in zip(tables, arms, strict=True):
        where = f"arm '{arm.name}'"
        dirs = [resolve(d, folder, f"{where}: package_dirs") for d in arm.package_dirs]
        for key in ("urdf", "mjcf"):
            if key in table:
                table[key] = relative(resolve(table[key], folder, f"{where}: {key}", package_dirs=dirs), into)
        if dirs:
            table["package_dirs"] = [relative(d, into) for d in dirs]


def file_text(head: Sequence[str], tables: Mapping[str, Any]) -> str:
    """A cell file in TOML: comment lines, then its tables. The path comes last: its entries are long."""
    order = sorted(tables, key=lambda key: key in ("path", "phases"))
    return "\n".join([*(f"# {line}" for line in head), *toml_lines({key: tables[key] for key in order})]) + "\n"


def toml_lines(tables: Mapping[str, Any], place: str = "") -> Iterator[str]:
    """TOML: the keys of a table, then the tables inside it."""
    inner = {}
    for key, value in tables.items():
        if isinstance(value, Mapping) or (isinstance(value, list) and value and isinstance(value[0], Mapping)):
            inner[key] = value
        else:
            yield f"{toml_key(key)} = {toml_value(value)}"
    for key, value in inner.items():
        name = f"{place}.{toml_key(key)}" if place else toml_key(key)
        for table in value if isinstance(value, list) else [value]:
            yield ""
            yield f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
            yield from toml_lines(table, name)


def toml_key(key: str) -> str:
    """A key in TOML, in quotes where it needs them."""
    plain = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if plain else json.dumps(key)


def toml_value(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)  # the shortest text that reads back to the same number; inf and nan are TOML, too
    if isinstance(value, int):
        return str(value)
    if isinstance(value, (list, tuple)):
        texts = [toml_value(item) for item in value]
        if sum(map(len, texts)) < 100:
            return f"[{', '.join(texts)}]"
        return "[\n" + "".join(f"  {text},\n" for text in _rows(texts)) + "]"
    return json.dumps(str(value), ensure_ascii=False)


def _rows(texts: list[str]) -> Iterator[str]:
    """Texts put together to lines of some length."""
    row = ""
    for text in texts:
        if row and len(row) + len(text) > 110:
            yield row
            row = text
        else:
            row = f"{row}, {text}" if row else text
    yield row


def planned_text(run: CellRun, plan: Plan, *, folder: Path, into: Path) -> str:
    """The plan as a cell file in TOML. It reads back to the same numbers, bit for bit.

    Args:
        run: the run of the cell file that was planned for.
        plan: start and path.
        folder: folder of that file.
        into: folder of the new file.
    """
    dt = run.scenario.dt if run.settings.steps is not None or run.scenario.dt != DEFAULT_DT else None
    head = f"{plan.path.duration:.4g} s from rest to rest, planned by coopqp. Its time law is in the table [path]."
    return timed_text(run.settings, run.scenario.cell, plan.q_start, plan.path, head, folder=folder, into=into, dt=dt)


def planned_program_text(run: CellRun, program: Program, *, folder: Path, into: Path) -> str:
    """A program that :func:`coopqp.planning.time_program` has timed, as a cell file in TOML.

    Args:
        run: the run of the cell file that was planned for; its start stays.
        program: the timed program.
        folder, into: folders of that file, and of the new one.
    """
    task, settings = run.scenario, run.settings
    dt = task.dt if settings.steps is not None or task.dt != DEFAULT_DT else None
    head = f"{program.duration:.4g} s, each phase from rest to rest, planned by coopqp. Time laws are in its phases."
    return timed_text(settings, task.cell, task.q_start, program, head, folder=folder, into=into, dt=dt)


def timed_text(
    settings: CellFile,
    cell: RobotCell,
    q_start: Array,
    path: TimedPath | Program,
    head: str,
    *,
    folder: Path,
    into: Path,
    dt: float | None = None,
) -> str:
    """A cell file in TOML with another path and start.

    Args:
        settings: the file.
        cell: its arms.
        q_start, path: the start (nq,), and the path.
        head: a line for the reader.
        folder: folder of that file.
        into: folder of the new file.
        dt: length of a step [s]; None leaves the default, or the file's.
    """
    tables = settings.model_dump(exclude_none=True, exclude_unset=True)
    move_files(tables["arms"], settings.arms, folder, into)
    move_files(tables.get("robots", []), settings.robots, folder, into)
    if isinstance(path, Program):
        tables["phases"] = [_phase_table(phase) for phase in path.phases]
    else:
        tables["path"] = _timed_table(path)
    x = cell.positions(q_start)
    positions = {name: x[own].tolist() for name, own in cell.blocks.items()}
    tables["start"] = {"positions_rad": positions, "inverse_kinematics": False}
    tables.pop("steps", None)
    if dt is not None:
        tables["dt_s"] = dt
    return file_text([head], tables)


def _timed_table(path: TimedPath) -> dict[str, Any]:
    record = path.record()
    table = {
        "kind": "timed",
        **({} if record["planned_share"] is None else {"planned_share": record["planned_share"]}),
        "pieces": record["pieces"],
        "s_m": record["s"],
        "squares": record["squares"],
        **({"keeps_clear": True} if record["keeps_clear"] else {}),
        "binding": record["binding"],
    }
    if (elbows := record["elbows"]) is not None:
        table["elbows"] = {name: elbows[own] for name, own in ELBOWS.items()}
    return table


def _phase_table(phase: Phase) -> dict[str, Any]:
    """A phase of a planned program."""
    table: dict[str, Any] = {"name": phase.name}
    if isinstance(phase.path, TimedPath):
        table["path"] = _timed_table(phase.path)
    else:
        table["duration_s"] = phase.seconds
    if phase.until is not None:
        table["until"] = phase.until
    arms = {name: _role_table(role) for name, role in phase.arms.items()}
    return table | ({"arms": arms} if arms else {})


def _role_table(role: Role) -> dict[str, Any]:
    if isinstance(role, FollowsJoints):
        way, speeds = role.path, role.path.speeds
        return {
            "kind": "follows_joints",
            "positions_rad": way.rows.tolist(),
            **({} if speeds is None else {"speeds_rad_per_s": speeds.tolist()}),
            "durations_s": as_floats(way.durations).tolist(),
        }
    if not isinstance(role, Follows):
        return {"kind": "holds" if role.holds else "waits"}
    frame, rests = as_placement(role.frame, "Follows: frame"), not isinstance(role.on, TimedPath)
    still = {"kind": "hold", "pose": {"matrix": _matrix(role.on.pose(0.0))}, "duration_s": float(role.on.duration)}
    return {
        "kind": "follows",
        "holds": role.holds,
        **({} if role.holds_after is None else {"holds_after": role.holds_after}),
        "frame": {"matrix": _matrix(frame)},
        "path": still if rests else _timed_table(role.on),  # type: ignore[arg-type]
    }


def settings_of(metadata: Mapping[str, Any], given: Path | None) -> tuple[CellFile, Path | None]:
    """The cell file of a recording, and its folder; None for a file whose folder the recording does not know.

    Args:
        metadata: metadata of the recording.
        given: the cell file, for a recording that has none.

    Raises:
        CellFileError: the file does not exist or is no cell file, or there is none.
    """
    if given is not None:
        return read(given), folder_of(given)
    tables = metadata.get("settings")
    if not isinstance(tables, Mapping):
        raise CellFileError(
            "the recording is not one of a cell file, so there is none to correct. Give it with --cell."
        )
    try:
        return CellFile.model_validate(tables), None
    except ValidationError as error:
        said = f"the recording's own cell file: {explain(error).rstrip('.')}. Give a corrected one with --cell."
        raise CellFileError(said) from error


def calibrated_text(
    settings: CellFile, calibration: Calibration, *, sources: list[str], folder: Path | None, into: Path
) -> str:
    """The corrected cell file in TOML. Its numbers read back bit for bit; its start is corrected when it is read.

    Args:
        settings: the cell file of the run.
        calibration: the bases and grips that were found.
        sources: file of each arm's model, for paths whose folder is not known.
        folder: folder of the run's file, or None.
        into: folder of the new file.

    Raises:
        CellFileError: the file has other arms than the calibration.
    """
    cell = calibration.cell
    if tuple(arm.name for arm in settings.arms) != cell.arm_names:
        raise CellFileError(f"the cell file has other arms than the recording: {', '.join(cell.arm_names)} are needed.")
    tables = settings.model_dump(exclude_none=True, exclude_unset=True)
    for table, arm, source in zip(tables["arms"], cell.arms, sources, strict=True):
        table["base"] = {"matrix": _matrix(arm.T_world_base)}
        if folder is None:
            table |= {key: relative(Path(source), into) for key in ("urdf", "mjcf") if key in table}
    if folder is not None:
        move_files(tables["arms"], settings.arms, folder, into)
    tools = zip(cell.arm_names, calibration.grasp.T_object_tool, strict=True)
    tables["grasp"] = {"kind": "tools", "tools": {name: {"matrix": _matrix(X)} for name, X in tools}}
    if tables.get("start", {}).get("inverse_kinematics") is False:
        tables["start"]["inverse_kinematics"] = True  # the old start does not fit the corrected bases
    same = [found.arm for found in calibration.corrections if not found.significant]
    before, after = 1e3 * calibration.before[:, 0].max(), 1e3 * calibration.after[:, 0].max()
    head = [
        f"Bases and grips calibrated by coopqp from {len(calibration.samples)} configurations of a gripped run:",
        f"the arms part by {after:.3g} mm instead of {before:.3g} mm. The base and the grip of "
        f"{cell.arm_names[0]} are the reference.",
        *(f"kept, its correction is no more than its uncertainty: {arm}" for arm in same),
        *(f"not determined, kept: {name}" for name in calibration.undetermined),
    ]
    return file_text(head, tables)


def _matrix(T: pin.SE3) -> list[list[float]]:
    return T.homogeneous.tolist()
