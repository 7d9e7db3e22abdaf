"""The cell file of a plan: the file that was planned for, with the timed path and the start."""

from __future__ import annotations

from pathlib import Path

from coopqp.files.cellfile.build import DEFAULT_DT, CellRun
from coopqp.files.cellfile.paths import resolve
from coopqp.files.cellfile.write import relative, toml_lines
from coopqp.planning.planner import Plan


def planned_text(run: CellRun, plan: Plan, *, folder: Path, into: Path) -> str:
    """The plan as a cell file in TOML. It reads back to the same numbers, bit for bit.

    Args:
        run: the cell file that was planned for.
        plan: start and path.
        folder: folder of that file; paths in it are relative to it.
        into: folder of the new file.
    """
    tables = run.settings.model_dump(exclude_none=True, exclude_unset=True)
    cell = run.scenario.cell
    for table, arm in zip(tables["arms"], run.settings.arms, strict=True):
        where = f"arm '{arm.name}'"
        dirs = [resolve(d, folder, f"{where}: package_dirs") for d in arm.package_dirs]
        for key in ("urdf", "mjcf"):
            if key in table:
                table[key] = relative(resolve(table[key], folder, f"{where}: {key}", package_dirs=dirs), into)
        if dirs:
            table["package_dirs"] = [relative(d, into) for d in dirs]
    record = plan.path.record()
    tables["path"] = {
        "kind": "timed",
        **({} if record["planned_share"] is None else {"planned_share": record["planned_share"]}),
        "pieces": record["pieces"],
        "s_m": record["s"],
        "squares": record["squares"],
        "binding": record["binding"],
    }
    x = cell.positions(plan.q_start)
    positions = {name: x[own].tolist() for name, own in zip(cell.arm_names, cell.v_slices, strict=True)}
    tables["start"] = {"positions_rad": positions, "inverse_kinematics": False}
    if tables.pop("steps", None) is not None or run.scenario.dt != DEFAULT_DT:
        tables["dt_s"] = run.scenario.dt
    # Long entries come last.
    order = sorted(tables, key=lambda key: key == "path")
    head = f"# {plan.path.duration:.4g} s from rest to rest, planned by coopqp. Its time law is in the table [path]."
    return "\n".join([head, *toml_lines({key: tables[key] for key in order})]) + "\n"
