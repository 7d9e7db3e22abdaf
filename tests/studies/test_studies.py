"""Studies: rows, draws, and sweeps whose table is the same wherever and however often interrupted its rows are run."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import resource
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from coopqp import CoopqpError, simulate
from coopqp.baselines import PseudoInverseController
from coopqp.cli import main as cli, terminal
from coopqp.errors import MissingExtraError, OutputError
from coopqp.scenarios import paper_lift
from coopqp.simulation import read_run
from coopqp.studies import (
    Cluster,
    Engine,
    EngineError,
    Local,
    Study,
    StudyError,
    engines as engines_module,
    load_study,
    run_rows,
    sweep,
)
from coopqp.studies.drawing import DisturbancesTable, disturbances
from coopqp.studies.journal import Journal, read_journal
from coopqp.studies.row import RowTask
from coopqp.studies.study import put
from coopqp.studies.table import FIGURES

SMALL = """
name = "small"
scenario = "paper_lift"
seed = 3
draws = 2
repeats = 2
[set]
steps = 20
[axes]
controller.kind = ["qp", "pseudo_inverse"]
scenario.duration = { low = 1.0, high = 3.0, number = 3 }
[disturbances]
encoder_noise_rad = 1e-5
base_offset_mm = { normal = 1.0 }
"""


def study_file(folder: Path, text: str = SMALL) -> Path:
    file = folder / "study.toml"
    file.write_text(text, encoding="utf-8")
    return file


# -- rows ----------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(1, 4), max_size=3), st.integers(0, 3), st.integers(1, 3), st.integers(1, 3))
def test_rows_are_all_combinations_each_once(sizes: list[int], cases: int, draws: int, repeats: int) -> None:
    study = Study(
        name="s", base={}, folder="", scenario="paper_lift",
        cases=tuple((f"case {i}", {}) for i in range(cases)),
        axes=tuple((f"k{i}", tuple(range(size))) for i, size in enumerate(sizes)),
        disturbances={}, draws=draws, repeats=repeats, seed=0, timeout_s=1.0, figures=(),
    )  # fmt: skip
    rows = [study.row(i) for i in range(len(study))]
    assert len({(tuple(row.values.values()), row.draw, row.repeat) for row in rows}) == len(study)
    assert len(study) == int(np.prod([*sizes, max(1, cases), draws, repeats]))
    assert all(tuple(row.values) == study.varied for row in rows)


def test_a_dotted_key_names_tables_entries_and_arms() -> None:
    data: dict[str, Any] = {"arms": [{"name": "left", "base": {"xyz_m": [0, 1, 2]}}, {"name": "right"}]}
    put(data, "arms.right.limits.velocity_rad_per_s", 2.0)
    put(data, "arms.left.base.xyz_m.1", 7)
    put(data, "arms.0.robot", "rx90l")
    assert data["arms"] == [
        {"name": "left", "base": {"xyz_m": [0, 7, 2]}, "robot": "rx90l"},
        {"name": "right", "limits": {"velocity_rad_per_s": 2.0}},
    ]
    for key in ("arms.middle.robot", "arms.2.robot", "arms.left.robot.x"):
        with pytest.raises(StudyError, match=r"known: left, right|is no table"):
            put(data, key, 1)


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("poses.3.x", "poses has no entry '3'; known: 0 to 2."),
        ("poses.-1.x", "poses has no entry '-1'; known: 0 to 2."),
        ("arms.middle", "arms has no entry 'middle'; known: left, right."),
        ("name.first.x", "key 'name.first.x': name is no table. Check the key."),
        ("arms.left.base.first.x", "key 'arms.left.base.first.x': arms.left.base is no table"),
    ],
)
def test_a_key_that_leads_nowhere_is_told_what_is_there(key: str, said: str) -> None:
    data: dict[str, Any] = {
        "arms": [{"name": "left", "base": 1}, {"name": "right"}],
        "poses": [1, {"x": 2}, 3],
        "name": "cell",
    }
    with pytest.raises(StudyError) as caught:
        put(data, key, 1)
    assert said in str(caught.value)
    put(data, "poses.1.x", 7)
    put(data, "poses.2", 8)
    put(data, "verdict.deep.er", 9)
    assert data["poses"] == [1, {"x": 7}, 8]
    assert data["verdict"] == {"deep": {"er": 9}}


OF_A_LIFT = 'name = "s"\nscenario = "paper_lift"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('name = "s"\nscenario = "paper_lift"\ncell = "x"', "give one of cell, scenario"),
        ('name = "s"\nscenario = "paper_left"', "Did you mean 'paper_lift'?"),
        (OF_A_LIFT + "draws = 0", "draws: must be greater than or equal to 1"),
        (OF_A_LIFT + "axes.scenario.beat = [1.0]", "Did you mean 'beta'?"),
        (OF_A_LIFT + 'axes.controller.kind = ["qp", "pq"]', "axis controller.kind: controller: there is no 'pq'"),
        (OF_A_LIFT + "axes.controller.gian = [1.0]", "unknown key 'gian'"),
        (OF_A_LIFT + "axes.scenario.beta = []", "give a list of 1"),
        (OF_A_LIFT + "axes.scenario.beta = { low = 1, high = 2 }", "axes: scenario.beta: number: is missing"),
        (OF_A_LIFT + 'figures = ["chain"]', "no column named 'chain'"),
        (OF_A_LIFT + "disturbances.latency = 1", "did you mean 'latency_s'"),
        (OF_A_LIFT + "axes.scenario.nothing.x = [1]", "no argument named 'nothing'"),
        (OF_A_LIFT + "draws = 1_000_000\nrepeats = 2", "2000000 rows"),
        (OF_A_LIFT + 'set = { "scenario.beta" = 0.3, "scenario.beta.x" = 1 }', "scenario.beta is no table"),
        ('name = "s"\ncell = "not_there.toml"', "not_there.toml"),
    ],
)
def test_a_bad_study_is_refused_by_name_before_anything_runs(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = study_file(tmp_path, text)
    assert cli.main(["sweep", str(file), "--out", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_cell_file_is_varied_by_its_keys(tmp_path: Path) -> None:
    cell = (Path(cli.__file__).parents[1] / "scenarios" / "cells" / "paper_lift.toml").read_text(encoding="utf-8")
    (tmp_path / "cell.toml").write_text(cell, encoding="utf-8")
    text = """
    name = "bases"
    cell = "cell.toml"
    [set]
    steps = 10
    [[cases]]
    name = "as printed"
    set = {}
    [[cases]]
    name = "nearer"
    set = { "arms.slave_1.base.xyz_m.0" = 3.5, "arms.slave_2.base.xyz_m.0" = 3.5 }
    [[cases]]
    name = "too far"
    set = { "arms.slave_1.base.xyz_m.0" = 9.0 }
    """
    task = RowTask(load_study(study_file(tmp_path, text)))
    printed, nearer, far = (task(i) for i in range(3))
    assert printed["outcome"] == nearer["outcome"] == "ok"
    assert printed["sigma_min"] == pytest.approx(0.1686, abs=5e-4)  # fixture F
    assert printed["margin_deg"] == pytest.approx(56.38, abs=0.05)
    assert nearer["sigma_min"] != printed["sigma_min"]
    assert far["outcome"] == "failed"
    assert "slave_1" in far["reason"]


def test_a_case_with_a_wrong_value_is_named(tmp_path: Path) -> None:
    text = """
    name = "s"
    scenario = "paper_lift"
    [[cases]]
    name = "right"
    set = { steps = 4 }
    [[cases]]
    name = "wrong"
    set = { steps = -4 }
    """
    with pytest.raises(StudyError, match="case 'wrong': "):
        load_study(study_file(tmp_path, text))


def test_the_figures_of_a_row_are_those_of_the_run(tmp_path: Path) -> None:
    text = 'name = "s"\nscenario = "paper_lift"\n[set]\nsteps = 40\ncontroller = { kind = "pseudo_inverse" }\n'
    row = RowTask(load_study(study_file(tmp_path, text)))(0)
    lift = paper_lift()
    controller = PseudoInverseController(lift.cell, lift.grasp, lift.path, dt=lift.path.duration / 40)
    run = simulate(controller, q_start=lift.q_start)
    readings = read_run(lift.cell, run)
    assert row["eps_p_mm"] == readings.eps_p_mm.max() == pytest.approx(8.70, abs=0.01)  # the paper's baseline
    assert row["chain_mm"] == readings.chain_mm.max()
    assert row["object_end_mm"] == readings.object_mm[-1]
    x = lift.cell.positions(run.q_command)
    room = np.minimum(x - lift.cell.limits.lower, lift.cell.limits.upper - x)
    assert row["margin_deg"] == np.rad2deg(room.min())
    assert {*row} == {"outcome", "reason", "status", "finished", "verdict", *FIGURES}
    assert (row["outcome"], row["verdict"], row["steps"]) == ("ok", "no", 40)


def test_a_study_with_a_name_of_version_01_is_told_the_new_one(tmp_path: Path) -> None:
    old = 'name = "s"\nscenario = "paper_lift"\n[axes]\n"controller.weights.comfort" = [1e-6, 1e-5]\n'
    with pytest.raises(StudyError, match="comfort is no longer a key; give posture"):
        load_study(study_file(tmp_path, old))


def test_a_run_that_takes_too_long_is_a_row_that_failed(tmp_path: Path) -> None:
    text = 'name = "s"\nscenario = "paper_lift"\ntimeout_s = 1e-6\n'
    row = RowTask(load_study(study_file(tmp_path, text)))(0)
    assert row["outcome"] == "failed"
    assert "timeout_s" in row["reason"]


# -- draws ---------------------------------------------------------------------------------------------------------


def amounts(**values: Any) -> DisturbancesTable:
    return DisturbancesTable.model_validate(values)


def test_draws_are_the_same_for_all_settings_and_repeats_differ_in_noise_only() -> None:
    cell = paper_lift().cell
    table = amounts(encoder_noise_rad=1e-4, base_offset_mm={"normal": 1.0}, base_offset_deg={"uniform": [0.1, 0.2]})

    def bases(found: Any) -> list[Any]:
        return [X.homogeneous.tolist() for X in found.base_offset.values()]

    one, again, repeat, other = (
        disturbances(table, cell, seed=1, draw=draw, repeat=k) for draw, k in ((0, 0), (0, 0), (0, 1), (1, 0))
    )
    assert one is not None
    assert again is not None
    assert repeat is not None
    assert other is not None
    assert (bases(one), one.seed) == (bases(again), again.seed)
    assert bases(one) == bases(repeat)
    assert one.seed != repeat.seed
    assert bases(one) != bases(other)
    assert set(one.base_offset) == {"slave_1", "slave_2"}
    more = disturbances(table.model_copy(update={"lag_s": 0.01}), cell, seed=1, draw=0, repeat=0)
    assert more is not None
    assert bases(more) == bases(one)
    assert disturbances(amounts(), cell, seed=1, draw=0, repeat=0) is None


def test_drawn_offsets_have_the_length_asked_for_and_any_direction() -> None:
    cell = paper_lift().cell
    ways = []
    for draw in range(300):
        made = disturbances(amounts(base_offset_mm=2.0), cell, seed=0, draw=draw, repeat=0)
        assert made is not None
        ways += [X.translation for X in made.base_offset.values()]
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 2e-3, rtol=1e-12)
    assert np.abs(np.mean(ways, axis=0)).max() < 4 * 2e-3 / np.sqrt(3 * len(ways))
    np.testing.assert_allclose(np.cov(np.transpose(ways)) / 4e-6, np.eye(3) / 3.0, atol=0.06)


# -- nothing is lost: the loop -------------------------------------------------------------------------------------


class Mortal(Executor):
    """Runs everything at once; some rows, and some calls, end it and all that flies."""

    def __init__(self, fatal: set[int], mishaps: Iterator[bool], breaks: bool) -> None:
        self.fatal, self.mishaps, self.breaks = fatal, mishaps, breaks
        self.flying: list[tuple[Future[Any], Any, Any]] = []
        self.dead = False

    def submit(self, function: Any, /, *arguments: Any, **_: Any) -> Future[Any]:
        if self.dead:
            raise BrokenExecutor
        future: Future[Any] = Future()
        kills = bool(self.fatal & set(arguments[1])) or next(self.mishaps)
        if not kills:
            future.set_result(function(*arguments))
        elif self.breaks:
            self.dead = True
            future.set_exception(BrokenExecutor())
        else:
            future.set_exception(BrokenExecutor())
        return future


class MortalEngine(Engine):
    chunk_s, tries = 1.0, 3

    def __init__(self, workers: int, fatal: set[int], mishaps: Iterator[bool], breaks: bool) -> None:
        self.workers, self.made = workers, (fatal, mishaps, breaks)

    @contextlib.contextmanager
    def open(self, workers: int) -> Iterator[Executor]:
        yield Mortal(*self.made)

    def has_died(self, error: BaseException) -> bool:
        return isinstance(error, BrokenExecutor)

    def is_broken(self, error: BaseException) -> bool:
        return self.made[2]


@given(
    rows=st.integers(0, 40),
    fatal=st.sets(st.integers(0, 39), max_size=4),
    mishaps=st.sets(st.integers(0, 30), max_size=2),
    workers=st.integers(1, 4),
    chunk=st.one_of(st.none(), st.integers(1, 50)),
    breaks=st.booleans(),
)
def test_every_row_comes_once_and_exactly_those_that_kill_are_lost(
    rows: int, fatal: set[int], mishaps: set[int], workers: int, chunk: int | None, breaks: bool
) -> None:
    """Two mishaps from outside cannot make a row lost: it takes three deaths alone."""
    calls = iter(i in mishaps for i in range(10**9))
    taken: list[Any] = []
    run_rows(
        lambda row: {"x": row}, range(rows), MortalEngine(workers, fatal, calls, breaks), take=taken.extend, chunk=chunk
    )
    assert sorted(done.row for done in taken) == list(range(rows))
    assert {done.row for done in taken if done.columns is None} == {row for row in fatal if row < rows}
    assert all(done.columns == {"x": done.row} for done in taken if done.columns is not None)


@pytest.mark.parametrize(
    ("seconds", "rows", "workers", "largest"),
    [(0.125, 100, 1, 8), (0.375, 100, 1, 3), (5.0, 100, 1, 1), (0.0, 10_000, 2, 1000), (2.0**-7, 64, 4, 7)],
)
def test_chunks_take_the_time_that_is_asked_for_and_leave_a_share_for_each_worker(
    seconds: float, rows: int, workers: int, largest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, chunks = iter(range(10**9)), []

    class Watched(Mortal):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
            chunks.append(len(args[1]))
            return super().submit(fn, *args, **kwargs)

    class Watching(MortalEngine):
        @contextlib.contextmanager
        def open(self, workers: int) -> Iterator[Executor]:
            yield Watched(*self.made)

    monkeypatch.setattr("coopqp.studies.dispatch.time", SimpleNamespace(thread_time=lambda: seconds * next(clock)))
    taken: list[Any] = []
    engine = Watching(workers, set(), iter(lambda: False, True), breaks=False)
    run_rows(lambda row: {"x": row}, range(rows), engine, take=taken.extend)
    assert [done.seconds for done in taken] == pytest.approx([seconds] * rows)
    assert sum(chunks) == rows
    assert chunks[0] == 1  # nothing is known of them
    assert max(chunks) == largest
    chunks.clear()
    run_rows(lambda row: {"x": row}, range(rows), engine, take=taken.extend, chunk=7)
    assert set(chunks[:-1]) <= {7}


def test_an_error_of_the_engine_is_no_lost_row() -> None:
    def unpicklable(row: int) -> dict[str, Any]:
        raise RuntimeError("no such module")

    class Broken(Mortal):
        def submit(self, function: Any, /, *arguments: Any, **_: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_exception(RuntimeError("no such module"))
            return future

    class BrokenEngine(MortalEngine):
        @contextlib.contextmanager
        def open(self, workers: int) -> Iterator[Executor]:
            yield Broken(set(), iter(()), False)

    with pytest.raises(EngineError, match="no such module"):
        run_rows(unpicklable, range(3), BrokenEngine(1, set(), iter(()), False), take=lambda _: None)


# -- nothing is lost: the journal ----------------------------------------------------------------------------------


def test_a_journal_that_was_cut_anywhere_keeps_its_complete_lines(tmp_path: Path) -> None:
    file = tmp_path / "journal"
    entries = [{"row": i, "columns": {"x": 0.1 * i, "y": float("nan") if i else "ä"}} for i in range(3)]
    with Journal(file) as journal:
        journal.append(entries)
    content = file.read_bytes()
    for cut in range(len(content) + 1):
        file.write_bytes(content[:cut])
        kept = content[:cut].count(b"\n")
        with Journal(file) as journal:
            assert repr(journal.entries) == repr(entries[:kept])
            journal.append(entries[kept:])
        assert file.read_bytes() == content
    file.write_bytes(b"x" + content)
    with pytest.raises(StudyError, match="damaged"):
        read_journal(file)


def test_one_program_at_a_time_writes_a_journal(tmp_path: Path) -> None:
    with Journal(tmp_path / "journal"), pytest.raises(StudyError, match="another program"):
        Journal(tmp_path / "journal")


# -- nothing is lost: processes ------------------------------------------------------------------------------------


def test_extras_that_are_missing_are_named_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engines_module, "find_spec", lambda _: None)
    file, out = study_file(tmp_path), tmp_path / "out"
    for option, extra in (([], "studies"), (["--cluster", "tcp://127.0.0.1:1"], "cluster")):
        assert cli.main(["sweep", str(file), "--out", str(out), *option]) == 2
        assert f"coopqp[{extra}]" in capsys.readouterr().err
    assert not out.exists()
    with pytest.raises(MissingExtraError):
        Local(2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study, run by one worker without any trouble."""
    folder = tmp_path_factory.mktemp("whole")
    made = sweep(load_study(study_file(folder)), Local(1), folder / "out")
    assert made.complete
    return folder / "out"


@pytest.mark.slow
def test_the_table_has_every_row_with_all_digits_and_no_times(whole: Path) -> None:
    with (whole / "runs.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["row"] for row in rows] == [str(i) for i in range(24)]
    assert {row["outcome"] for row in rows} == {"ok"}
    entries = {entry["row"]: entry["columns"] for entry in read_journal(whole / "journal.jsonl")[0]}
    for row in rows:
        assert float(row["chain_mm"]) == entries[int(row["row"])]["chain_mm"]
    assert not any("second" in name for name in rows[0])
    description = json.loads((whole / "study.json").read_text(encoding="utf-8"))
    assert {"solver", "coopqp", "numpy", "processor"} <= set(description["versions"])
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(whole / "runs.parquet").to_pylist()
    assert [row["chain_mm"] for row in table] == [float(row["chain_mm"]) for row in rows]


@pytest.mark.slow
def test_rows_that_fail_are_there_with_their_reason_and_the_command_ends_with_4(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = OF_A_LIFT + "set = { steps = 4 }\naxes.scenario.h = [9.0, 3.6]"
    out = tmp_path / "out"
    arguments = ["sweep", str(study_file(tmp_path, text)), "--workers", "1", "--out", str(out)]
    assert cli.main(arguments) == 4
    said = capsys.readouterr()
    assert "1 failed: UnreachableError" in said.out
    with (out / "runs.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["scenario.h"], row["outcome"]) for row in rows] == [("9.0", "failed"), ("3.6", "ok")]
    assert "arm" in rows[0]["reason"]
    assert (out / "runs.png").read_bytes().startswith(b"\x89PNG")
    assert cli.main([*arguments, "--quiet"]) == 2  # it is there
    assert "--resume" in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_with_another_study_is_refused(whole: Path, tmp_path: Path) -> None:
    study = load_study(study_file(tmp_path))
    with pytest.raises(StudyError, match="--resume"):
        sweep(study, Local(1), whole)
    other = load_study(study_file(tmp_path, SMALL.replace("seed = 3", "seed = 4")))
    with pytest.raises(StudyError, match="another study"):
        sweep(other, Local(1), whole, resume=True)
    before = (whole / "runs.csv").read_bytes()
    assert sweep(study, Local(1), whole, resume=True).complete  # nothing is left to do
    assert (whole / "runs.csv").read_bytes() == before


def start(*arguments: str, folder: Path, **options: Any) -> subprocess.Popen[str]:
    """A coordinator in a process of its own."""
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "from coopqp.cli.start import main; sys.exit(main())"
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    return subprocess.Popen(
        [sys.executable, "-c", code, "sweep", str(study_file(folder)), *arguments],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def until(condition: Callable[[], Any], seconds: float) -> bool:
    """Whether a condition holds within a time."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def workers_of(pid: int) -> set[int]:
    """Worker processes that a coordinator has started."""
    found = set()
    for place in Path("/proc").iterdir():
        if place.name.isdigit():
            try:
                words = (place / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(words[1]) == pid and b"resource_tracker" not in (place / "cmdline").read_bytes():
                found.add(int(place.name))
    return found


def alive(pid: int) -> bool:
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def lines(out: Path) -> int:
    file = out / "journal.jsonl"
    return file.read_bytes().count(b"\n") if file.exists() else 0


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")


@pytest.mark.slow
@needs_proc
def test_a_killed_coordinator_leaves_no_workers_and_its_study_goes_on(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with start("--workers", "2", "--chunk", "1", "--out", str(out), folder=tmp_path) as coordinator:
        assert until(lambda: lines(out) >= 3, 120)
        workers = workers_of(coordinator.pid)
        coordinator.kill()
    assert workers
    assert until(lambda: not any(map(alive, workers)), 10)
    assert 3 <= lines(out) < 24
    assert sweep(load_study(tmp_path / "study.toml"), Local(2), out, resume=True, chunk=5).complete
    assert (out / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()


@pytest.mark.slow
@needs_proc
def test_killed_workers_cost_no_row_and_ctrl_c_ends_with_130(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with start("--workers", "2", "--chunk", "2", "--out", str(out), folder=tmp_path) as coordinator:
        assert until(lambda: lines(out) >= 2, 120)
        for pid in workers_of(coordinator.pid):
            os.kill(pid, signal.SIGKILL)
        assert until(lambda: lines(out) >= 6, 120)
        coordinator.send_signal(signal.SIGINT)
        _, said = coordinator.communicate(timeout=60)
    assert coordinator.returncode == 130
    assert "coopqp: interrupted" in said
    assert "Traceback" not in said
    assert not (out / "runs.csv").exists()
    done = sweep(load_study(tmp_path / "study.toml"), Local(1), out, resume=True)
    assert done.complete
    assert (out / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()


@pytest.mark.slow
def test_a_full_disk_ends_the_study_by_name_and_keeps_its_rows(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    limit = 3500  # bytes of a file: a few rows, and part of one

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    with start("--workers", "1", "--out", str(out), folder=tmp_path, preexec_fn=small_files) as coordinator:
        _, said = coordinator.communicate(timeout=120)
    assert coordinator.returncode == 4
    assert "journal.jsonl" in said
    assert "--resume" in said
    assert 1 <= lines(out) < 24
    assert sweep(load_study(tmp_path / "study.toml"), Local(1), out, resume=True).complete
    assert (out / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()


@pytest.mark.slow
def test_a_row_that_always_kills_its_worker_is_the_only_one_lost() -> None:
    def task(row: int) -> dict[str, Any]:
        import os
        import signal

        if row == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"x": row}

    taken: list[Any] = []
    run_rows(task, range(12), Local(2), take=taken.extend, chunk=4)
    assert sorted(done.row for done in taken) == list(range(12))
    assert [done.row for done in taken if done.columns is None] == [5]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a scheduler with two workers, started by Dask's own commands."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("cluster")
    dask = Path(sys.executable).with_name("dask")
    environment = {
        **os.environ,
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
    }  # one death of a worker is enough
    file = folder / "scheduler.json"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    worker = ["worker", "--scheduler-file", str(file), "--nworkers", "2", "--nthreads", "1", "--no-dashboard"]
    processes = []
    with (folder / "log").open("w") as log:
        for words in (scheduler, [*worker, "--local-directory", str(folder)]):
            processes.append(
                subprocess.Popen(
                    [dask, *words], cwd=folder, env=environment, stdout=log, stderr=log, start_new_session=True
                )
            )
            assert until(lambda: file.exists() and file.stat().st_size, 60)
        try:
            address = json.loads(file.read_text(encoding="utf-8"))["address"]
            assert until(lambda: workers_there(address) == 2, 60)
            yield address
        finally:
            for process in reversed(processes):
                end_with_children(process)


def end_with_children(process: subprocess.Popen[bytes]) -> None:
    """End a leader of a process group, and its group: Dask's nanny can wait for ever for a worker that died."""
    process.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=10)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def workers_there(address: str) -> int:
    try:
        return Cluster(address).workers
    except EngineError:
        return 0


@pytest.mark.slow
def test_a_cluster_gives_the_same_table_though_a_worker_is_killed(whole: Path, cluster: str, tmp_path: Path) -> None:
    """The study was begun elsewhere, and interrupted."""
    from distributed import Client

    out = tmp_path / "out"
    out.mkdir()
    begun = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (out / "journal.jsonl").write_bytes(b"".join(begun[3:7]) + begun[9][:30])
    (out / "study.json").write_bytes((whole / "study.json").read_bytes())
    with Client(cluster, set_as_default=False) as client:
        victims = list(client.run(os.getpid).values())

    def progress(done: int, total: int) -> None:
        if done > 6 and victims:
            os.kill(victims.pop(), signal.SIGKILL)
            victims.clear()

    study = load_study(study_file(tmp_path))
    assert sweep(study, Cluster(cluster), out, resume=True, chunk=3, progress=progress).complete
    assert not victims
    assert (out / "runs.csv").read_bytes() == (whole / "runs.csv").read_bytes()


@pytest.mark.slow
def test_of_a_cluster_the_row_that_kills_is_the_only_one_lost(cluster: str) -> None:
    def task(row: int) -> dict[str, Any]:
        import os
        import signal

        if row == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"x": row}

    taken: list[Any] = []
    run_rows(task, range(6), Cluster(cluster), take=taken.extend, chunk=3)
    assert sorted(done.row for done in taken) == list(range(6))
    assert [done.row for done in taken if done.columns is None] == [2]


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_an_error_by_name() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(EngineError, match="dask scheduler"):
        Cluster("tcp://127.0.0.1:9", timeout=0.5)


def test_tls_is_passed_on_to_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    given: list[dict[str, Any]] = []

    def client(address: str, **options: Any) -> None:
        given.append({"address": address, **options})
        raise OSError("nobody")

    monkeypatch.setattr(distributed, "Client", client)
    security = distributed.Security(require_encryption=True)
    with pytest.raises(EngineError, match="nobody"):
        Cluster("tls://127.0.0.1:9", security=security)
    with pytest.raises(EngineError, match="nobody"):
        Cluster("tcp://127.0.0.1:9")
    assert given[0]["security"] is security
    assert "security" not in given[1]


def test_a_worker_that_rests_is_no_news() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with Local(1).open(1):
            warnings.warn("A worker stopped while some jobs were given to the executor.", UserWarning, stacklevel=1)
            warnings.warn("Something else.", UserWarning, stacklevel=1)
    assert [str(w.message) for w in caught] == ["Something else."]


def test_progress_is_a_line_for_each_tenth_with_the_time_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    with terminal.reporter() as report:
        for done in range(0, 201, 5):
            now[0] = 100.0 + 2.0 * done
            report.count("study", done, 200)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "study: 0 of 200"
    assert lines[1] == "study: 20 of 200, about 360 s left"
    assert lines[-1] == "study: 200 of 200"
    assert len(lines) == 11


def test_errors_of_studies_are_coopqps() -> None:
    assert issubclass(StudyError, CoopqpError)
    assert issubclass(EngineError, CoopqpError)
    assert issubclass(OutputError, CoopqpError)
