"""The cell file of a plan: the file that was planned for, with the timed path and the start."""

from __future__ import annotations

from pathlib import Path

from coopqp.files.cellfile.build import DEFAULT_DT, ELBOWS, CellRun
from coopqp.files.cellfile.write import file_text, move_files
from coopqp.planning.planner import Plan


def planned_text(run: CellRun, plan: Plan, *, folder: Path, into: Path) -> str:
    """The plan as a cell file in TOML. It reads back to the same numbers, bit for bit.

    Args:
        run: the run of the cell file that was planned for.
        plan: start and path.
        folder: folder of that file.
        into: folder of the new file.
    """
    tables = run.settings.model_dump(exclude_none=True, exclude_unset=True)
    cell = run.scenario.cell
    move_files(tables["arms"], run.settings.arms, folder, into)
    record = plan.path.record()
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
    x = cell.positions(plan.q_start)
    positions = {name: x[own].tolist() for name, own in zip(cell.arm_names, cell.v_slices, strict=True)}
    tables["start"] = {"positions_rad": positions, "inverse_kinematics": False}
    if tables.pop("steps", None) is not None or run.scenario.dt != DEFAULT_DT:
        tables["dt_s"] = run.scenario.dt
    head = f"{plan.path.duration:.4g} s from rest to rest, planned by coopqp. Its time law is in the table [path]."
    return file_text([head], tables)
