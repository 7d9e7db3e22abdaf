"""The table of a study: CSV, and Parquet where pyarrow is installed. The same rows give the same bytes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any

#: Names of the tables.
CSV, PARQUET = "runs.csv", "runs.parquet"

#: Columns of a run's figures, and their meaning.
FIGURES: Mapping[str, str] = {
    "time_s": "time that the run took [s]",
    "steps": "number of steps",
    "rate_min": "smallest rate of the object's clock",
    "eps_p_mm": "largest ε_p of the commands [mm]",
    "eps_o_deg": "largest ε_o of the commands [deg]",
    "chain_mm": "largest distance between the object poses of any two arms, as commanded [mm]",
    "chain_deg": "the same as an angle [deg]",
    "true_chain_mm": "the same, as the disturbed arms really stand [mm]",
    "true_chain_deg": "the same as an angle [deg]",
    "object_mm": "largest distance of the object from its path, as measured [mm]",
    "object_deg": "the same as an angle [deg]",
    "object_end_mm": "distance of the object from its path at the end [mm]",
    "sigma_min": "smallest singular value of any arm's tool Jacobian",
    "margin_deg": "least distance of a turning joint from its position limits [deg]",
    "margin_mm": "least distance of a sliding joint from its position limits [mm]",
    "speed_share": "largest joint speed, as a share of its limit",
    "unrest_deg_per_s": "change of turning joints' commanded speeds from step to step, rms [deg/s]",
    "closest_mm": "least distance of bodies, where the task has bodies that keep distances [mm]",
}
#: Columns before the figures.
OUTCOMES = ("outcome", "reason", "status", "finished", "verdict")
OK, FAILED, LOST = "ok", "failed", "lost"


def cell_text(value: Any) -> str:
    """A value in a table: numbers with all their digits, nothing for None, JSON for lists and tables."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False, sort_keys=True) if isinstance(value, list | dict) else str(value)


def csv_bytes(columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> bytes:
    """Rows as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([cell_text(row.get(name)) for name in columns] for row in rows)
    return text.getvalue().encode()


def has_parquet() -> bool:
    """Whether Parquet can be written."""
    return find_spec("pyarrow") is not None


def parquet_bytes(columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> bytes:
    """Rows as Parquet. A column of numbers only holds numbers, any other text."""
    import pyarrow
    from pyarrow import parquet

    table = {}
    for name in columns:
        values = [row.get(name) for row in rows]
        plain = all(
            value is None or (isinstance(value, int | float) and not isinstance(value, bool)) for value in values
        )
        whole = plain and all(value is None or isinstance(value, int) for value in values)
        kind = (pyarrow.int64() if whole else pyarrow.float64()) if plain else pyarrow.string()
        cells = values if plain else [None if value is None else cell_text(value) for value in values]
        table[name] = pyarrow.array(cells, type=kind)
    stream = io.BytesIO()
    parquet.write_table(pyarrow.table(table), stream)
    return stream.getvalue()
