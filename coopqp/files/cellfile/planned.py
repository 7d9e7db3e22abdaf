"""The cell file of a plan: the file that was planned for, with the timed path and the start."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from coopqp.files.cellfile.build import DEFAULT_DT, CellRun
from coopqp.files.cellfile.paths import resolve
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
                table[key] = _relative(resolve(table[key], folder, f"{where}: {key}", package_dirs=dirs), into)
        if dirs:
            table["package_dirs"] = [_relative(d, into) for d in dirs]
    record = plan.path.record()
    tables["path"] = {
        "kind": "timed",
        **({} if record["planned_share"] is None else {"planned_share": record["planned_share"]}),
        "pieces": record["pieces"],
        "s_m": record["s"],
        "squares": record["squares"],
    }
    x = cell.positions(plan.q_start)
    positions = {name: x[own].tolist() for name, own in zip(cell.arm_names, cell.v_slices, strict=True)}
    tables["start"] = {"positions_rad": positions, "inverse_kinematics": False}
    if tables.pop("steps", None) is not None or run.scenario.dt != DEFAULT_DT:
        tables["dt_s"] = run.scenario.dt
    # What is long comes last.
    order = sorted(tables, key=lambda key: key == "path")
    head = f"# {plan.path.duration:.4g} s from rest to rest, planned by coopqp. Its time law is in the table [path]."
    return "\n".join([head, *_lines({key: tables[key] for key in order})]) + "\n"


def _relative(path: Path, into: Path) -> str:
    try:
        return Path(os.path.relpath(path.absolute(), into.absolute())).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()


def _lines(tables: Mapping[str, Any], place: str = "") -> Iterator[str]:
    """TOML: the keys of a table, then the tables inside it."""
    inner = {}
    for key, value in tables.items():
        if isinstance(value, Mapping) or (isinstance(value, list) and value and isinstance(value[0], Mapping)):
            inner[key] = value
        else:
            yield f"{_key(key)} = {_value(value)}"
    for key, value in inner.items():
        name = f"{place}.{_key(key)}" if place else _key(key)
        for table in value if isinstance(value, list) else [value]:
            yield ""
            yield f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
            yield from _lines(table, name)


def _key(key: str) -> str:
    plain = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if plain else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)  # the shortest text that reads back to the same number; inf and nan are TOML, too
    if isinstance(value, int):
        return str(value)
    if isinstance(value, (list, tuple)):
        texts = [_value(item) for item in value]
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
