"""Recordings that are longer than the memory: the same run, judged the same, and read where it is looked at."""

from __future__ import annotations

import gc
import math
import mmap
import tempfile
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from coopqp import QPController, Recording, simulate
from coopqp.scenarios import Scenario, at_limit
from coopqp.simulation import Monitor, RecordingError, evaluate, read_run
from coopqp.simulation.recording import recording as recordings, rows
from coopqp.visualization import style

ARRAYS = ("time", "q", "q_command", "velocity", "clock", "rate", "status", "reference", "T_object_tool")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return at_limit()


def simulated(scenario: Scenario) -> Recording:
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt)
    return simulate(controller, q_start=scenario.q_start, duration=0.8)


@pytest.fixture(scope="module")
def run(scenario: Scenario) -> Recording:
    return simulated(scenario)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Nearly no memory: everything goes into files, in parts of seven rows. The folder for temporary files."""
    monkeypatch.setattr(rows, "MOST_IN_MEMORY", 200)
    monkeypatch.setattr(rows, "BLOCK_ROWS", 7)
    monkeypatch.setattr(recordings, "MAX_COMPRESSED_BYTES", 0)
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def mapped(array: Any) -> bool:
    while isinstance(array, np.ndarray):
        array = array.base
    return isinstance(array, mmap.mmap)


def assert_same(a: Recording, b: Recording) -> None:
    assert (a.notes, a.metadata) == (b.notes, b.metadata)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


# -- recorded, saved, loaded -------------------------------------------------------------------------------------------


def test_a_run_in_files_is_the_run_in_memory(run: Recording, scenario: Scenario, small: Path) -> None:
    assert not mapped(run.q)
    long = simulated(scenario)
    assert mapped(long.q)
    assert_same(long, run)
    assert list(small.iterdir()) == [], "its files have no name: nothing can be left behind"
    with pytest.raises(ValueError, match="read-only"):
        long.q[0] = 1.0


def test_what_is_saved_can_be_loaded_and_is_read_in_place(run: Recording, tmp_path: Path, small: Path) -> None:
    file = run.save(tmp_path / "run.npz")
    loaded = Recording.load(file)
    assert_same(loaded, run)
    for name in ("q", "q_command", "velocity", "reference"):
        array = getattr(loaded, name)
        assert mapped(array), name
        assert array.flags.aligned
    assert list(small.iterdir()) == []
    assert_same(Recording.load(loaded.save(file)), run)
    with np.load(file, allow_pickle=False) as plain:
        for name in ARRAYS:
            np.testing.assert_array_equal(plain[name], getattr(run, name))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archives_of_others_are_loaded_too(run: Recording, tmp_path: Path, small: Path, save: Any) -> None:
    """Compressed ones are unpacked into files without a name."""
    with zipfile.ZipFile(run.save(tmp_path / "run.npz")) as archive, archive.open("text.npy") as member:
        text = np.lib.format.read_array(member, allow_pickle=False)
    save(tmp_path / "other.npz", text=text, **{name: getattr(run, name) for name in ARRAYS})
    loaded = Recording.load(tmp_path / "other.npz")
    assert mapped(loaded.q)
    assert_same(loaded, run)
    assert list(small.iterdir()) == []


@pytest.mark.parametrize("change", [np.float32, np.int64, ">f8", np.asfortranarray])
def test_numbers_of_other_types_are_read_as_numbers(run: Recording, tmp_path: Path, small: Path, change: Any) -> None:
    q = change(run.q) if callable(change) and not isinstance(change, type) else run.q.astype(change)
    content = {name: getattr(run, name) for name in ARRAYS}
    text = np.array('{"notes": [], "metadata": {}}')
    np.savez(tmp_path / "other.npz", text=text, **{**content, "q": q})
    loaded = Recording.load(tmp_path / "other.npz")
    assert loaded.q.dtype == np.float64
    np.testing.assert_array_equal(loaded.q, q)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_long_file_that_is_cut_is_refused(run: Recording, tmp_path: Path, small: Path, share: float) -> None:
    content = run.save(tmp_path / "run.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[: int(share * len(content))])
    with pytest.raises(RecordingError):
        Recording.load(tmp_path / "cut.npz")


def test_an_array_whose_header_does_not_parse_is_refused(run: Recording, tmp_path: Path) -> None:
    with zipfile.ZipFile(run.save(tmp_path / "run.npz")) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    content["text.npy"] = content["text.npy"].replace(b"'shape': ()", b"'shape': N)")
    with zipfile.ZipFile(tmp_path / "other.npz", "w") as archive:
        for name, array in content.items():
            archive.writestr(name, array)
    with pytest.raises(RecordingError, match="is not a coopqp recording"):
        Recording.load(tmp_path / "other.npz")


def test_the_files_end_with_the_recording(scenario: Scenario, small: Path) -> None:
    def handles() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    if not Path("/proc/self/fd").exists():
        return
    gc.collect()
    before = handles()
    long = simulated(scenario)
    assert handles() > before or mapped(long.q)
    del long
    gc.collect()
    assert handles() <= before


# -- judged and drawn --------------------------------------------------------------------------------------------------


def test_parts_are_judged_as_the_whole(run: Recording, scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with steps that are not finite, limits that are broken, and a jump at the seam of two parts."""
    q, v = run.q_command.copy(), run.velocity.copy()
    q[29:31], v[49:52] = np.nan, 1e3
    q[35] += 0.1
    for made in (run, replace(run, q_command=q, velocity=v)):
        whole = read_run(scenario.cell, made)
        findings, verdict = evaluate(scenario.cell, made, whole), judged(made, scenario)
        with monkeypatch.context() as patched:
            patched.setattr(rows, "BLOCK_ROWS", 7)
            apart = read_run(scenario.cell, made)
            for field in fields(whole):
                a, b = (getattr(readings, field.name) for readings in (whole, apart))
                np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13, err_msg=field.name)
            assert evaluate(scenario.cell, made, whole) == findings
            again = judged(made, scenario)
        assert again == verdict
        assert bool(again) == (made is not run)


def judged(run: Recording, scenario: Scenario) -> set[Any]:
    monitor = Monitor(scenario.cell, run.grasp, keep=10_000)
    return {(v.kind, v.step, v.arm, v.joint) for v in monitor.check_recorded(run).violations}


@given(
    arrays.arrays(float, st.tuples(st.integers(1, 300), st.integers(1, 3)), elements=st.floats(-1e3, 1e3)),
    st.integers(1, 20),
)
def test_a_drawn_curve_keeps_its_extremes(values: Any, spans: int) -> None:
    time = np.arange(float(len(values)))
    times, curve = style.drawn(time, values, spans=spans)
    assert len(times) == len(curve) <= max(4 * spans, 2)
    np.testing.assert_array_equal(curve.max(axis=0), values.max(axis=0))
    np.testing.assert_array_equal(curve.min(axis=0), values.min(axis=0))
    assert (np.diff(times) >= 0.0).all()


# -- found by time -----------------------------------------------------------------------------------------------------


@given(st.floats(-1.0, 2.0))
@settings(max_examples=50)
def test_a_sample_is_found_by_its_time(run: Recording, seconds: float) -> None:
    sample = run.sample_at(seconds)
    assert 0 <= sample <= run.n_steps
    assert run.time[sample] <= max(seconds, 0.0)
    assert sample == run.n_steps or seconds < run.time[sample + 1]


def test_nothing_is_found_before_the_start_or_after_the_end(run: Recording) -> None:
    assert (run.sample_at(-math.inf), run.sample_at(math.inf)) == (0, run.n_steps)
