"""A sweep: run a study into a folder. Nothing is lost, and an interrupted study can be resumed."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coopqp.errors import UnreachableError
from coopqp.output import check_folder, json_bytes, write_files
from coopqp.reading import read_file
from coopqp.studies.dispatch import Done, run_rows
from coopqp.studies.engines import Engine
from coopqp.studies.errors import StudyError
from coopqp.studies.journal import ANEW, Journal
from coopqp.studies.row import RowTask, build_row
from coopqp.studies.study import Study, versions
from coopqp.studies.table import CSV, FIGURES, LOST, OK, OUTCOMES, PARQUET, csv_bytes, has_parquet, parquet_bytes

#: Largest accepted description of a study in its folder [bytes].
_MOST_BYTES = 1_000_000
#: Files of a study beside its tables.
DESCRIPTION, JOURNAL, TIMES = "study.json", "journal.jsonl", "times.csv"
_LOST = "its worker died each time, alone"


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep that is complete.

    Attributes:
        study: the study.
        columns: names of the columns.
        rows: the rows in order, by column.
        seconds: processor time that each row took [s].
        files: files that were written.
    """

    study: Study
    columns: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    seconds: tuple[float, ...]
    files: tuple[Path, ...]

    @property
    def outcomes(self) -> Counter[str]:
        """Number of rows of each outcome."""
        return Counter(str(row["outcome"]) for row in self.rows)

    @property
    def complete(self) -> bool:
        """Every run gave its figures."""
        return self.outcomes[OK] == len(self.rows)


def sweep(
    study: Study,
    engine: Engine,
    folder: str | Path,
    *,
    resume: bool = False,
    chunk: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Run every row of a study, and write its table.

    The folder gets ``runs.csv`` (``runs.parquet`` with the extra ``parquet``), ``times.csv``, ``study.json`` and
    ``journal.jsonl``, which has each row as soon as it is there.

    Args:
        study: the study.
        engine: where its rows are run; it changes nothing in the table.
        folder: the folder.
        resume: go on with a study that was interrupted in this folder.
        chunk: rows that are sent together (by default as many as take some time).
        progress: called with the numbers of rows (there, of all).

    Raises:
        StudyError: the first row cannot be built, or the folder has another study, or one that is not to be resumed.
        EngineError, OutputError: workers or disk cannot go on. Finished rows are kept.
    """
    place = Path(folder)
    check_folder(place)
    with contextlib.suppress(UnreachableError):  # a row like others
        build_row(study, 0)
    _describe(study, place, resume=resume)
    with Journal(place / JOURNAL) as journal:
        found = rows_found(journal, len(study))
        tell = progress or (lambda *_: None)
        tell(len(found), len(study))

        def take(done: list[Done]) -> None:
            entries = [_entry(one) for one in done]
            journal.append(entries)
            found.update((entry["row"], entry) for entry in entries)
            tell(len(found), len(study))

        missing = [row for row in range(len(study)) if row not in found]
        run_rows(RowTask(study), missing, engine, take=take, chunk=chunk)
    return _write(study, [found[row] for row in range(len(study))], place)


def _entry(done: Done) -> dict[str, Any]:
    columns = {"outcome": LOST, "reason": _LOST} if done.columns is None else done.columns
    return {"row": done.row, "columns": columns, "seconds": done.seconds}


def _describe(study: Study, place: Path, *, resume: bool) -> None:
    """Write the description of the study, or compare it with the one that is resumed."""
    file = place / DESCRIPTION
    now = {"name": study.name, "study": study.digest, "rows": len(study), "versions": versions()}
    if not file.exists():
        write_files({file: json_bytes(now)})
        return
    if not resume:
        raise StudyError(f"{place} has a study. Go on with it by --resume, or give another folder.")
    try:
        before = json.loads(read_file(file, _MOST_BYTES))
        other = any(before[key] != now[key] for key in ("study", "rows"))
        changed = [
            f"{name} {before['versions'].get(name)} (now {value})"
            for name, value in versions().items()
            if before["versions"].get(name) != value
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StudyError(f"{file} is damaged ({error}). Start the study anew in another folder.") from error
    if other:
        raise StudyError(f"{place} has another study, '{before.get('name')}'. Give another folder.")
    if changed:
        raise StudyError(f"{place} was begun with {', '.join(changed)}: rows would differ. Give another folder.")


def rows_found(journal: Journal, rows: int) -> dict[int, dict[str, Any]]:
    """The entries of a journal by the number of their row.

    Raises:
        StudyError: an entry is none of a study with this many rows.
    """
    found: dict[int, dict[str, Any]] = {}
    for i, entry in enumerate(journal.entries, start=1):  # their checksums hold
        row, columns, seconds = (entry.get(key) for key in ("row", "columns", "seconds"))
        if not (type(row) is int and 0 <= row < rows and isinstance(columns, dict) and type(seconds) in (int, float)):
            raise StudyError(f"{journal.file} is damaged (line {i} is no row of this study). {ANEW}")
        found[row] = entry
    return found


def table_of_rows(study: Study, entries: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], list[dict[str, Any]]]:
    """Columns of the table of a study, and its rows, from the entries of its journal."""
    columns = ("row", *study.varied, "draw", "repeat", *OUTCOMES, *FIGURES)
    rows = []
    for entry in entries:
        row = study.row(entry["row"])
        given = {"row": row.index, **row.values, "draw": row.draw, "repeat": row.repeat}
        rows.append({**given, **entry["columns"]})
    return columns, rows


def _write(study: Study, entries: list[dict[str, Any]], place: Path) -> Sweep:
    columns, rows = table_of_rows(study, entries)
    seconds = [float(entry["seconds"]) for entry in entries]
    times = [{"row": i, "seconds": s} for i, s in enumerate(seconds)]
    contents = {place / CSV: csv_bytes(columns, rows), place / TIMES: csv_bytes(("row", "seconds"), times)}
    if has_parquet():
        contents[place / PARQUET] = parquet_bytes(columns, rows)
    files = [place / DESCRIPTION, *write_files(contents)]
    return Sweep(study, columns, tuple(rows), tuple(seconds), tuple(files))
