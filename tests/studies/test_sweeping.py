"""The folder of a sweep: its files, what is refused, and what comes back when it is resumed."""

from __future__ import annotations

import contextlib
import csv
import json
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any

import pytest

from coopqp.errors import OutputError
from coopqp.studies import Engine, Study, StudyError, load_study, run_rows, sweep
from coopqp.studies.journal import Journal, read_journal
from coopqp.studies.study import versions
from coopqp.studies.sweeping import rows_found, table_of_rows
from coopqp.studies.table import FIGURES, OUTCOMES, has_parquet

TEXT = """
name = "two lifts"
scenario = "paper_lift"
repeats = 2
[set]
steps = 3
[axes]
controller.kind = ["pseudo_inverse"]
scenario.duration = [1.0, 2.0]
"""


class Here(Engine):
    """Runs rows in this process; rows above ``end`` end it."""

    chunk_s, tries, workers = 1.0, 2, 1

    def __init__(self, end: int = 100) -> None:
        self.end, self.asked, self.chunks = end, list[int](), list[int]()

    @contextlib.contextmanager
    def open(self, workers: int) -> Iterator[Executor]:
        yield At(self)

    def has_died(self, error: BaseException) -> bool:
        return isinstance(error, BrokenExecutor)

    def is_broken(self, error: BaseException) -> bool:
        return False


class At(Executor):
    def __init__(self, engine: Here) -> None:
        self.engine = engine

    def submit(self, function: Any, /, *arguments: Any, **_: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.engine.asked.extend(arguments[1])
        self.engine.chunks.append(len(arguments[1]))
        if max(arguments[1]) > self.engine.end:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(function(*arguments))
        return future


def study_of(folder: Path, text: str = TEXT) -> Study:
    folder.mkdir(exist_ok=True)
    file = folder / "study.toml"
    file.write_text(text, encoding="utf-8")
    return load_study(file)


def table(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_sweep_writes_its_tables_its_description_and_its_journal(tmp_path: Path) -> None:
    study, out = study_of(tmp_path), tmp_path / "out"
    told: list[tuple[int, int]] = []
    made = sweep(study, Here(), out, chunk=1, progress=lambda done, total: told.append((done, total)))
    assert told == [(i, 4) for i in range(5)]
    assert made.complete
    assert made.outcomes == {"ok": 4}
    assert made.study is study
    assert made.columns == (
        "row", "controller.kind", "scenario.duration", "draw", "repeat", *OUTCOMES, *FIGURES,
    )  # fmt: skip
    rows = table(out / "runs.csv")
    assert tuple(rows[0]) == made.columns
    assert [row["row"] for row in rows] == ["0", "1", "2", "3"]
    assert [row["scenario.duration"] for row in rows] == ["1.0", "1.0", "2.0", "2.0"]
    assert [row["repeat"] for row in rows] == ["0", "1", "0", "1"]
    assert [row["time_s"] for row in rows] == ["1.0", "1.0", "2.0", "2.0"]
    assert [row["chain_mm"] for row in rows] == [repr(row["chain_mm"]) for row in made.rows]
    times = table(out / "times.csv")
    assert [row["row"] for row in times] == ["0", "1", "2", "3"]
    assert tuple(float(row["seconds"]) for row in times) == made.seconds
    assert min(made.seconds) > 0.0
    description = json.loads((out / "study.json").read_text(encoding="utf-8"))
    assert description == {"name": "two lifts", "study": study.digest, "rows": 4, "versions": versions()}
    entries, _ = read_journal(out / "journal.jsonl")
    assert sorted(entry["row"] for entry in entries) == [0, 1, 2, 3]
    names = ["study.json", "runs.csv", "times.csv", *(["runs.parquet"] if has_parquet() else [])]
    assert sorted(made.files) == sorted(out / name for name in names)
    assert sorted(path.name for path in out.iterdir()) == sorted([*names, "journal.jsonl"])


def test_what_is_resumed_runs_only_the_rows_that_are_missing(tmp_path: Path) -> None:
    study, out = study_of(tmp_path), tmp_path / "out"
    whole = sweep(study, Here(), out, chunk=1)
    table_of_all = (out / "runs.csv").read_bytes()
    with pytest.raises(StudyError, match=r"has a study\. Go on with it by --resume"):
        sweep(study, Here(), out)
    lines = (out / "journal.jsonl").read_bytes().splitlines(keepends=True)
    kept = [line for line in lines if json.loads(line)["row"] in (1, 3)]
    (out / "journal.jsonl").write_bytes(b"".join(kept))
    told: list[int] = []
    engine = Here()
    again = sweep(study, engine, out, resume=True, progress=lambda done, _: told.append(done))
    assert sorted(engine.asked) == [0, 2]
    assert told[0] == 2
    assert told[-1] == 4
    assert (out / "runs.csv").read_bytes() == table_of_all
    assert (again.seconds[1], again.seconds[3]) == (whole.seconds[1], whole.seconds[3])
    done = Here()
    assert sweep(study, done, out, resume=True).complete
    assert done.asked == []
    fresh = tmp_path / "fresh"
    assert sweep(study, Here(), fresh, resume=True).complete  # nothing is there yet
    assert (fresh / "runs.csv").read_bytes() == table_of_all


def test_a_row_that_ends_its_worker_is_lost_with_its_reason(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    made = sweep(study, Here(end=2), tmp_path / "out")
    assert made.outcomes == {"ok": 3, "lost": 1}
    assert not made.complete
    lost = table(tmp_path / "out" / "runs.csv")[3]
    assert (lost["outcome"], lost["reason"]) == ("lost", "its worker died each time, alone")
    assert (lost["scenario.duration"], lost["repeat"], lost["chain_mm"], lost["verdict"]) == ("2.0", "1", "", "")
    assert made.seconds[3] == 0.0


def test_a_study_whose_first_row_nobody_can_build_is_refused_before_its_folder_is_made(tmp_path: Path) -> None:
    wrong = study_of(tmp_path, TEXT.replace("[1.0, 2.0]", "[-1.0, 2.0]"))
    with pytest.raises(Exception, match="duration"):
        sweep(wrong, Here(), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    far = study_of(tmp_path, TEXT.replace("scenario.duration = [1.0, 2.0]", "scenario.h = [9.0, 3.6]"))
    made = sweep(far, Here(), tmp_path / "out")  # out of reach is a row like others
    assert [row["outcome"] for row in made.rows] == ["failed", "failed", "ok", "ok"]
    assert "Unreachable" in made.rows[0]["reason"]
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(OutputError, match="is a file, not a folder"):
        sweep(far, Here(), tmp_path / "file" / "out")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"study": "0"}, r"has another study, 'earlier'\. Give another folder\."),
        ({"rows": 5}, r"has another study, 'earlier'\. Give another folder\."),
        ({"versions": {**versions(), "numpy": "1.0"}}, r"begun with numpy 1\.0 \(now [\d.]+\): rows would differ"),
        ({"versions": {k: v for k, v in versions().items() if k != "solver"}}, r"begun with solver None \(now \w+\):"),
        ({"versions": 3}, r"study\.json is damaged \(.*Start the study anew"),
        ({"rows": None, "study": None, "versions": {}}, "has another study"),
    ],
)
def test_a_folder_of_another_study_or_another_program_is_refused(
    change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    study = study_of(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    described = {"name": "earlier", "study": study.digest, "rows": 4, "versions": versions(), **change}
    (out / "study.json").write_text(json.dumps(described), encoding="utf-8")
    engine = Here()
    with pytest.raises(StudyError, match=said):
        sweep(study, engine, out, resume=True)
    assert engine.asked == []
    assert [path.name for path in out.iterdir()] == ["study.json"]


@pytest.mark.parametrize("text", ["", "{}", "[1]", "{", '{"study": "x", "rows": 1}'])
def test_a_damaged_description_is_told(text: str, tmp_path: Path) -> None:
    study, out = study_of(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "study.json").write_text(text, encoding="utf-8")
    with pytest.raises(StudyError, match=r"study\.json is damaged"):
        sweep(study, Here(), out, resume=True)


@pytest.mark.parametrize(("row", "fits"), [(-1, False), (0, True), (3, True), (4, False)])
def test_a_journal_has_rows_of_its_study_only(row: int, fits: bool, tmp_path: Path) -> None:
    with Journal(tmp_path / "journal") as journal:
        journal.append([{"row": 1, "columns": {}, "seconds": 0.5}, {"row": row, "columns": {}, "seconds": 0.25}])
    with Journal(tmp_path / "journal") as journal:
        if fits:
            assert {i: entry["seconds"] for i, entry in rows_found(journal, 4).items()} == {1: 0.5, row: 0.25}
        else:
            with pytest.raises(StudyError, match=r"journal is damaged \(line 2 is no row of this study\)"):
                rows_found(journal, 4)


def test_a_row_of_the_table_has_its_settings_before_its_figures(tmp_path: Path) -> None:
    study = study_of(tmp_path)
    columns, rows = table_of_rows(study, [{"row": 3, "columns": {"outcome": "ok", "steps": 7}}])
    assert columns[:5] == ("row", "controller.kind", "scenario.duration", "draw", "repeat")
    assert rows == [{
        "row": 3, "controller.kind": "pseudo_inverse", "scenario.duration": 2.0, "draw": 0, "repeat": 1,
        "outcome": "ok", "steps": 7,
    }]  # fmt: skip


def test_rows_that_take_no_time_are_shared_out_to_what_the_workers_have_in_hand() -> None:
    """Two chunks each: of the nine that are left after the first two rows five are sent, then two."""
    engine = Here()
    run_rows(lambda row: {"x": row}, range(11), engine, take=lambda _: None)
    assert engine.asked == list(range(11))
    assert engine.chunks[:4] == [1, 1, 5, 2]
