"""Damaged files: those of every kind that coopqp reads are cut, overwritten, or get odd numbers, texts and tables.

Each ends in a result or in one named error. :func:`damaged` counts others; the tests use it with fewer files.
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
import os
import random
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coopqp import CoopqpError, QPController, Recording, load_cell_file, simulate
from coopqp.files.cellfile import load_cell_task
from coopqp.files.cellfile.text import read_tables
from coopqp.files.export import csv_parts
from coopqp.scenarios import paper_lift
from coopqp.simulation import describe_object, evaluate, read_run
from coopqp.simulation.evaluation.assessment import run_figures, why
from coopqp.simulation.evaluation.closeness import default_scene, with_clearance
from coopqp.studies import Study, load_place_study, load_study
from coopqp.studies.journal import Journal
from coopqp.studies.row import RowTask
from coopqp.studies.sweeping import rows_found, table_of_rows
from coopqp.studies.table import csv_bytes
from coopqp.visualization.joints import joint_figure
from coopqp.visualization.panel_page import panel_page
from coopqp.visualization.report import report_html
from coopqp.visualization.run_panel import RunPanel
from coopqp.visualization.run_view import Stage
from coopqp.visualization.timeline import timeline_figure

#: A small cell in TOML: every kind of table that reads without meshes.
CELL = """
name = "damaged"
dt_s = 0.05
settle_s = 0.1
[[arms]]
name = "a"
robot = "arm7"
geometry = false
limits = { velocity_deg_per_s = 90.0, acceleration_deg_per_s2 = [300, 300, 300, 300, 300, 300, 300] }
[[arms]]
name = "b"
robot = "arm7"
geometry = false
base = { xyz_m = [1.0, 0.0, 0.0], rpy_deg = [0, 0, 180] }
[grasp]
kind = "tools"
tools.a = { xyz_m = [-0.1, 0, 0], rpy_deg = [0, 90, 0] }
tools.b = { xyz_m = [0.1, 0, 0], rpy_deg = [0, -90, 0] }
[path]
kind = "waypoints"
poses = [{ xyz_m = [0.5, 0, 0.5] }, { xyz_m = [0.5, 0, 0.52] }]
durations_s = [0.4]
[start]
positions_deg.a = [0, 23, 0, 122, 0, -55, 0]
positions_deg.b = [0, 23, 0, 122, 0, -55, 0]
[object]
size_m = [0.2, 0.05, 0.05]
mass_kg = 2.0
[controller]
kind = "qp"
solver = "daqp"
path_gain = 5.0
[collision]
avoid = false
obstacles = [{ name = "post", shape = "capsule", radius_m = 0.05, length_m = 1.0, at = { xyz_m = [0.5, 3.0, 0.5] } }]
carried = [{ name = "bar", shape = "box", size_m = [0.2, 0.05, 0.05] }]
ignored = [["bar", "post"]]
[verdict]
chain_mm = 0.1
[output]
folder = "here"
csv = true
"""
STUDY = """
name = "damaged"
cell = "cell.toml"
seed = 3
draws = 2
repeats = 2
figures = ["chain_mm", "time_s"]
[set]
dt_s = 0.2
[axes]
controller.path_gain = { low = 1, high = 100, number = 3, log = true }
disturbances.encoder_noise_rad = [1e-6, 1e-5]
object.mass_kg = [1.0, 2.0]
[disturbances]
latency_s = 0.0
lag_s = { uniform = [0.0, 0.01] }
base_offset_mm = { normal = 0.1 }
[[cases]]
name = "slow"
set = { "arms.a.limits.velocity_deg_per_s" = 30.0 }
[[cases]]
name = "fast"
set = { "arms.a.limits.velocity_deg_per_s" = 60.0 }
"""
PLACE = """
name = "damaged"
scenario = "paper_lift"
seed = 1
[axes]
h = { low = 3.5, high = 3.7, number = 2, now = 3.6 }
b = { low = 0.4, high = 0.6, number = 2, now = 0.5 }
[[bases]]
arm = "slave_1"
xyz_m = ["h", "b", 0]
yaw_deg = 180
[[bases]]
arm = "slave_2"
xyz_m = ["h", "-b", 0]
yaw_deg = 180
[goals]
sigma_min = 0.1
"""
#: What is put in place of a value.
ODD: tuple[Any, ...] = (
    0, -1, 1, 2, 0.5, -0.0, 1e300, -1e300, 1e308, 5e-324, 1e-9, 10**30, 10**400, True, False, None, "", "a", "x" * 200,
    "../x", "1e400", float("nan"), float("inf"), -float("inf"), [], [1], [[]], [[1.0, 2.0], [3.0]], {}, {"a": 1},
    "\x1b[2J",
    [1e300] * 3, [None, 1], ["a", "b"], {"low": 0, "high": 1, "number": 3, "log": True}, {"uniform": [1, 0]}, 2**63,
)  # fmt: skip


def _places(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The place of every value in plain data."""
    if here:
        yield here
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in entries:
        yield from _places(inner, (*here, key))


def _odd(data: Any, rng: random.Random) -> Any:
    """Plain data with some values replaced, doubled or left out."""
    data = copy.deepcopy(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(data))
        if not places:
            return data
        *way, last = rng.choice(places)
        inner = data
        for key in way:
            inner = inner[key]
        turn = rng.random()
        if turn < 0.12:
            del inner[last]
        elif turn < 0.2 and isinstance(inner, list):
            inner.append(copy.deepcopy(inner[last]))
        else:
            inner[last] = copy.deepcopy(rng.choice(ODD))
    return data


def _broken(content: bytes, rng: random.Random) -> bytes:
    """Bytes that are cut, overwritten, or repeated somewhere."""
    turn, at = rng.random(), rng.randrange(len(content))
    if turn < 0.25:
        return content[:at]
    if turn < 0.5:
        end = min(len(content), at + rng.randrange(1, 40))
        return content[:at] + rng.randbytes(end - at) + content[end:]
    if turn < 0.75:
        return content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :]
    end = min(len(content), at + rng.randrange(1, 60))
    return content[:at] + (content[at:end] * 2 if turn < 0.9 else b"") + content[end:]


def _toml(value: Any) -> str:
    """A value in the notation of TOML; tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value if v is not None) + "]"
    return json.dumps(value) if isinstance(value, str) else repr(value)


def _toml_file(data: Any) -> bytes:
    return "\n".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in data.items() if v is not None).encode()


# -- the kinds of files --------------------------------------------------------------------------------------------


def _tables(text: str) -> Callable[[random.Random], bytes]:
    """Damaged files of TOML."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "file.toml"
        file.write_text(text, encoding="utf-8")
        data = read_tables(file)
    return lambda rng: _toml_file(_odd(data, rng)) if rng.random() < 0.75 else _broken(text.encode(), rng)


class _Nodes:
    """In place of viser's scene."""

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *arguments, **options: type("Node", (), {"text": "", **options})()


def _recording() -> Recording:
    lift = paper_lift()
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.3)
    box = describe_object(lift.object_size, lift.T_object_body)
    run = simulate(controller, q_start=lift.q_start, duration=1.5, metadata={"scenario": "damaged", "object": box})
    run.metadata["settings"] = {"verdict": {"chain_mm": 0.1}, "name": "damaged"}
    run.metadata["binding"] = [[1, [["slave_1", "joint_3", "velocity"]]], [3, []]]
    for arm in run.metadata["scene"]["arms"]:
        arm["shapes"] = arm["shapes"][:1]
    return with_clearance(run, default_scene(lift), avoided=False)


def _damaged_recording(run: Recording, whole: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.2:
        return _broken(whole, rng)
    arrays: dict[str, Any] = {name: np.array(value) for name, value in run._arrays().items()}
    text = {"format": 1, "notes": list(run.notes), "metadata": run.metadata}
    if rng.random() < 0.6:
        text = _odd(text, rng)
    else:
        name = rng.choice(list(arrays))
        if rng.random() < 0.8:
            for _ in range(rng.choice((1, 1, 3))):
                values = (1e300, -1e300, 1e155, np.nan, np.inf, 1e18, -1.0, 0.0, 1e8)
                arrays[name].flat[rng.randrange(arrays[name].size)] = rng.choice(values)
        else:
            arrays[name] = rng.choice((arrays[name][:-1], arrays[name].astype(str), np.zeros(0), arrays[name].T))
    stream = io.BytesIO()
    np.savez(stream, text=np.array(json.dumps(text)), **arrays)
    return stream.getvalue()


def _use_recording(file: Path, turn: int) -> None:
    run = Recording.load(file)
    cell = run.cell()
    readings = read_run(cell, run)
    run_figures(cell, run, readings)
    why(evaluate(cell, run, readings))
    for _ in csv_parts(run):
        pass
    stage = Stage(_Nodes(), run)
    panel = RunPanel(stage.cell, run, stage.readings)
    panel_page(panel, [panel.moment(sample) for sample in (0, run.n_steps)], until=panel.end)
    for sample in (0, run.n_steps // 2, run.n_steps):
        stage.show(sample)
        panel.moment(sample)
    if turn % 40 == 0:
        for figure in (timeline_figure(run, readings), joint_figure(cell, run)):
            figure.savefig(io.BytesIO(), dpi=20)
    if turn % 200 == 20:
        report_html(run)


def _journal(folder: Path) -> bytes:
    """The journal of a small study, whose rows are run here."""
    (folder / "cell.toml").write_text(CELL, encoding="utf-8")
    file = folder / "study.toml"
    file.write_text('name = "small"\ncell = "cell.toml"\nrepeats = 3\n[set]\ndt_s = 0.2\n', encoding="utf-8")
    task = RowTask(load_study(file))
    (folder / "swept").mkdir()
    with Journal(folder / "swept" / "journal.jsonl") as journal:
        journal.append({"row": i, "columns": task(i), "seconds": 0.1} for i in range(3))
    return journal.file.read_bytes()


def _damaged_journal(content: bytes, rng: random.Random) -> bytes:
    lines = content.splitlines(keepends=True)
    turn = rng.random()
    if turn < 0.4:
        return _broken(content, rng)
    i = rng.randrange(len(lines))
    if turn < 0.9:
        lines[i] = json.dumps(_odd(json.loads(lines[i]), rng)).encode() + b"\n"
    else:
        rng.shuffle(lines)
        lines.append(lines[i])
    return b"".join(lines)


def _use_journal(file: Path, study: Study) -> None:
    """Read a journal as --resume does, and make the table of its rows; missing rows are not run."""
    with Journal(file) as journal:
        found = rows_found(journal, len(study))
    columns, rows = table_of_rows(study, [found[row] for row in sorted(found)])
    csv_bytes(columns, rows)


@contextlib.contextmanager
def inside(folder: str) -> Iterator[None]:
    """Work in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def damaged(number: int, *, seed: int = 1, said: Callable[[str], None] | None = None) -> Iterator[tuple[str, int, int]]:
    """Damage files of each kind, ``number`` in all, and read them.

    Yields:
        the kind, how many were read, and how many ended otherwise than in a result or a named error.
    """
    with tempfile.TemporaryDirectory() as place, inside(place):
        folder = Path(place)
        journal, run = _journal(folder), _recording()
        whole = run.save(folder / "whole.npz").read_bytes()
        study = load_study(folder / "study.toml")
        cells, studies, places = _tables(CELL), _tables(STUDY), _tables(PLACE)
        journals = partial(_damaged_journal, journal)
        kinds: dict[str, tuple[int, str, Callable[[random.Random], bytes], Callable[[Path, int], Any]]] = {
            "cell files": (4, "one.toml", cells, lambda file, _: load_cell_file(file)),
            "cell files of a check": (2, "two.toml", cells, lambda file, _: load_cell_task(file).exact_start()),
            "studies": (4, "three.toml", studies, lambda file, _: load_study(file)),
            "studies of places": (3, "four.toml", places, lambda file, _: load_place_study(file)),
            "journals": (3, "swept/journal.jsonl", journals, lambda file, _: _use_journal(file, study)),
            "recordings": (4, "five.npz", partial(_damaged_recording, run, whole), _use_recording),
        }
        total = sum(share for share, *_ in kinds.values())
        for i, (kind, (share, name, damage, use)) in enumerate(kinds.items()):
            rng, wrong, count = random.Random(f"{seed} {i}"), 0, max(1, number * share // total)
            for turn in range(count):
                (folder / name).write_bytes(damage(rng))
                try:
                    with warnings.catch_warnings(), np.errstate(all="ignore"):
                        warnings.simplefilter("ignore")
                        use(folder / name, turn)
                except CoopqpError:
                    pass
                except Exception:
                    wrong += 1
                    if said is not None:
                        said(f"{kind}, {turn}: {traceback.format_exc()}")
            yield kind, count, wrong
