"""The cell file of a plan: the file that was planned for, with the timed path and the start."""

from __future__ import annotations

from pathlib import Path

from coopqp.files.cellfile.build import DEFAULT_DT, ELBOWS, CellRun
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.write import file_text, move_files
from coopqp.model.cell import RobotCell
from coopqp.paths.timed import TimedPath
from coopqp.planning.planner import Plan
from coopqp.spatial import Array


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


def timed_text(
    settings: CellFile,
    cell: RobotCell,
    q_start: Array,
    path: TimedPath,
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
    record = path.record()
    tables["path"] = {
        "kind": "timed",
        **({} if record["planned_share"] is None else {"planned_share": record["planned_share"]}),
        "pieces": record["pieces"],
        "s_m": record["s"],
        "squares": record["squares"],
        **({"keeps_clear": True} if record["keeps_clear"] else {}),
        "binding": record["binding"],
    }
    if (elbows := record["elbows"]) is not None:
        tables["path"]["elbows"] = {name: elbows[own] for name, own in ELBOWS.items()}
    x = cell.positions(q_start)
    positions = {name: x[own].tolist() for name, own in zip(cell.arm_names, cell.v_slices, strict=True)}
    tables["start"] = {"positions_rad": positions, "inverse_kinematics": False}
    tables.pop("steps", None)
    if dt is not None:
        tables["dt_s"] = dt
    return file_text([head], tables)
