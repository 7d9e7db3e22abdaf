"""The loop and its recording: the recording is true, saved atomically, and only valid files are loaded."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from runs import of_the_paper

import coopqp.simulation.recording.recording
from coopqp import (
    ControlStep,
    CoopqpError,
    InvalidInputError,
    QPController,
    Recording,
    ServoPath,
    Status,
    simulate,
)
from coopqp.baselines import PseudoInverseController, PseudoInverseOptions
from coopqp.scenarios import Scenario, at_limit
from coopqp.simulation import KinematicPlant, RecordingError

Array = NDArray[np.float64]
MANY = settings(max_examples=4 * settings().max_examples)
ARRAYS = ("time", "q", "q_command", "velocity", "clock", "rate", "status", "reference", "T_object_tool")


@pytest.fixture(scope="module")
def run(paper: Scenario) -> Recording:
    return simulate(of_the_paper(paper, 20), q_start=paper.q_start, metadata={"who": "the tests", "N": 20})


def same(a: Recording, b: Recording) -> bool:
    return a.notes == b.notes and a.metadata == b.metadata and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ARRAYS
    )  # fmt: skip


# -- the loop --------------------------------------------------------------------------------------------------------


def test_a_run_is_recorded(paper: Scenario, run: Recording) -> None:
    assert run.n_steps == 20
    cell = paper.cell
    shapes = {
        "time": (21,), "q": (21, 18), "q_command": (21, 18), "velocity": (20, 18), "clock": (21,), "rate": (20,),
        "status": (20,), "reference": (21, 4, 4), "T_object_tool": (3, 4, 4),
    }  # fmt: skip
    for name, shape in shapes.items():
        assert getattr(run, name).shape == shape
    np.testing.assert_allclose(run.time, np.linspace(0.0, 3.0, 21), rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.clock, run.time, rtol=0, atol=1e-12)
    assert np.array_equal(run.q[0], paper.q_start)
    assert np.array_equal(run.q, run.q_command)
    np.testing.assert_allclose(np.diff(run.q, axis=0), run.velocity * 3.0 / 20, rtol=0, atol=1e-14)
    for clock, T in zip(run.clock, run.reference, strict=True):
        np.testing.assert_allclose(T, paper.path.pose(clock).homogeneous, rtol=0, atol=1e-15)
    for X, Y in zip(run.grasp.T_object_tool, paper.grasp.T_object_tool, strict=True):
        assert np.array_equal(X.homogeneous, Y.homogeneous)
    assert run.finished
    assert run.statuses == [Status.TRACKING] * 20
    assert run.metadata["arms"] == list(cell.arm_names)
    assert run.metadata["joints"] == list(cell.joint_names)
    assert run.metadata["controller"] == "PseudoInverseController"
    assert run.metadata["failures"] == 0
    assert (run.metadata["who"], run.metadata["N"]) == ("the tests", 20)


def test_the_loop_is_the_controller_stepped(paper: Scenario, run: Recording) -> None:
    made = of_the_paper(paper, 20)
    made.reset(paper.q_start)
    for i in range(20):
        step = made.step()
        assert np.array_equal(step.velocity, run.velocity[i])
        assert np.array_equal(step.q_next, run.q[i + 1])


def test_callbacks_see_every_step(paper: Scenario) -> None:
    seen: list[ControlStep] = []
    progress: list[tuple[int, int]] = []
    simulate(
        of_the_paper(paper, 20),
        q_start=paper.q_start,
        observe=seen.append,
        progress=lambda done, total: progress.append((done, total)),
    )
    assert progress == [(i + 1, 20) for i in range(20)]
    assert [s.clock for s in seen[1:]] == [s.clock_next for s in seen[:-1]]
    assert seen[-1].finished
    assert not seen[-2].finished


def test_duration_and_settling(paper: Scenario) -> None:
    cut = simulate(of_the_paper(paper, 20), q_start=paper.q_start, duration=1.5)
    assert cut.n_steps == 10
    assert not cut.finished
    longer = simulate(of_the_paper(paper, 20), q_start=paper.q_start, settle=0.3)
    assert longer.time[-1] == pytest.approx(3.3, abs=0.151)
    assert longer.finished
    assert not longer.velocity[20:].any()
    assert np.array_equal(longer.q[20], longer.q[-1])


def test_a_blocked_object_is_given_up_after_a_while() -> None:
    stuck = at_limit()
    made = QPController(stuck.cell, stuck.grasp, stuck.path, dt=stuck.dt)
    run = simulate(made, q_start=stuck.q_start, patience=0.1)
    blocked = np.flatnonzero(run.status == Status.BLOCKED.code)
    assert not run.finished
    assert blocked[-1] == run.n_steps - 1
    assert len(blocked) * stuck.dt == pytest.approx(0.1, abs=2 * stuck.dt)
    assert run.bindings[-1]
    with pytest.raises(InvalidInputError, match="simulate: patience"):
        simulate(made, q_start=stuck.q_start, patience=0.0)


def test_a_path_without_an_end_needs_a_duration(paper: Scenario) -> None:
    path = ServoPath(paper.path.start)
    made = PseudoInverseController(
        paper.cell, paper.grasp, path, dt=0.1, options=PseudoInverseOptions(increment="exact")
    )
    with pytest.raises(InvalidInputError, match="simulate: duration"):
        simulate(made, q_start=paper.q_start)
    progress: list[tuple[int, int]] = []
    run = simulate(made, q_start=paper.q_start, duration=1.0, progress=lambda *at: progress.append(at))
    assert (run.n_steps, run.finished) == (10, False)
    assert progress[-1] == (10, 10)


def test_a_plant_in_between_is_what_is_measured(paper: Scenario) -> None:
    class Lagging:
        """Joints that move half of the commanded way."""

        def reset(self, q: Any) -> Array:
            self.q: Array = np.array(q)
            return self.q

        def apply(self, step: ControlStep) -> Array:
            self.q = self.q + 0.5 * (step.q_next - self.q)
            return self.q

    lagged = simulate(of_the_paper(paper, 20), Lagging(), q_start=paper.q_start)
    ideal = simulate(of_the_paper(paper, 20), KinematicPlant(paper.cell), q_start=paper.q_start)
    assert np.array_equal(lagged.q_command, ideal.q)
    assert np.array_equal(lagged.q[1], 0.5 * (ideal.q[0] + ideal.q[1]))
    assert not np.array_equal(lagged.q, lagged.q_command)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"q_start": np.zeros(5)}, "expected shape (18,)"),
        ({"q_start": np.full(18, np.nan)}, "NaN"),
        ({"q_start": np.zeros(18)}, "holds the object"),
        ({"duration": 0.0}, "simulate: duration"),
        ({"duration": np.nan}, "simulate: duration"),
        ({"duration": "long"}, "simulate: duration"),
        ({"settle": -1.0}, "simulate: settle"),
        ({"settle": np.inf}, "simulate: settle"),
        ({"metadata": {"x": object()}}, "simulate: metadata"),
        ({"metadata": [1, 2]}, "simulate: metadata"),
        ({"metadata": "notes"}, "simulate: metadata"),
    ],
)
def test_bad_input(paper: Scenario, arguments: dict[str, Any], says: str) -> None:
    steps: list[ControlStep] = []
    with pytest.raises(InvalidInputError) as caught:
        simulate(of_the_paper(paper, 20), **{"q_start": paper.q_start, "observe": steps.append, **arguments})
    assert says in str(caught.value)
    assert not steps, "refused before anything moves"


# -- saving ----------------------------------------------------------------------------------------------------------


def test_round_trip(run: Recording, tmp_path: Path) -> None:
    file = run.save(tmp_path / "run.npz")
    assert file == tmp_path / "run.npz"
    loaded = Recording.load(file)
    assert same(run, loaded)
    assert loaded.finished
    assert loaded.statuses == run.statuses
    for name in ARRAYS:
        assert getattr(loaded, name).dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            getattr(loaded, name)[0] = 1.0
    asked = ["wrenches", "torques", "shift"]  # test_recorded_loads.py saves them
    known = [*ARRAYS, "notes", "metadata", "meshes", *asked]
    assert [f.name for f in fields(Recording)] == known, "a new field is saved too"


@pytest.mark.slow
@given(st.dictionaries(st.text(max_size=5), st.one_of(st.integers(), st.text(), st.booleans(), st.none()), max_size=4),
       st.lists(st.text(max_size=20), max_size=3))  # fmt: skip
@settings(max_examples=settings().max_examples // 4)
def test_any_text_survives(run: Recording, tmp_path: Path, metadata: dict[str, Any], notes: list[str]) -> None:
    recording = replace(run, metadata=metadata, notes=tuple(notes))
    assert same(Recording.load(recording.save(tmp_path / "text.npz")), recording)


def test_an_existing_file_is_replaced(run: Recording, tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    file.write_text("something else")
    run.save(str(file))
    assert same(Recording.load(str(file)), run)
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]


class FullDiskError(OSError):
    pass


@pytest.mark.parametrize("error", [FullDiskError("no space left"), KeyboardInterrupt(), MemoryError()])
@pytest.mark.parametrize("earlier", [True, False])
def test_no_half_written_file(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, earlier: bool
) -> None:
    """A failed write leaves only the earlier file."""
    file = tmp_path / "run.npz"
    if earlier:
        run.save(file)
    before = file.read_bytes() if earlier else None

    def half(stream: Any, *_: Any, **__: Any) -> None:
        stream.write(b"half of it")
        raise error

    monkeypatch.setattr(np.lib.format, "write_array", half)
    with pytest.raises(RecordingError if isinstance(error, OSError) else type(error)):
        run.save(file)
    assert [p.name for p in tmp_path.iterdir()] == (["run.npz"] if earlier else [])
    assert (file.read_bytes() if earlier else None) == before


def test_places_that_cannot_be_written(run: Recording, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nowhere.*Check that its folder exists"):
        run.save(tmp_path / "nowhere" / "run.npz")
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(RecordingError, match="cannot write"):
        run.save(folder)
    assert list(folder.iterdir()) == []
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]
    for metadata in ({"x": object()}, {"x": {1, 2}}):
        with pytest.raises(RecordingError, match="not JSON"):
            replace(run, metadata=metadata).save(tmp_path / "run.npz")
    assert issubclass(RecordingError, CoopqpError)


# -- loading ---------------------------------------------------------------------------------------------------------


def saved(run: Recording, tmp_path: Path, **changes: Any) -> Path:
    """The file of a recording with some entries replaced, or left out (None)."""
    arrays: dict[str, Any] = {name: getattr(run, name) for name in ARRAYS}
    arrays["text"] = np.array(json.dumps({"format": 1, "notes": [], "metadata": {}}))
    arrays.update(changes)
    file = tmp_path / "changed.npz"
    np.savez(file, **{name: value for name, value in arrays.items() if value is not None})
    return file


def test_a_plain_copy_loads(run: Recording, tmp_path: Path) -> None:
    assert np.array_equal(Recording.load(saved(run, tmp_path)).q, run.q)


class Bomb:
    """An object that creates a folder when it is unpickled."""

    def __init__(self, place: str) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (self.place,)


def test_pickles_are_not_executed(run: Recording, tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    file = saved(run, tmp_path, q=np.array([Bomb(str(trap))], dtype=object))
    plain = tmp_path / "plain.npz"
    plain.write_bytes(pickle.dumps(Bomb(str(trap))))
    raw = tmp_path / "array.npz"
    with raw.open("wb") as stream:
        np.save(stream, np.array([Bomb(str(trap))], dtype=object), allow_pickle=True)
    for bad in (file, plain, raw):
        with pytest.raises(RecordingError, match="not a coopqp recording"):
            Recording.load(bad)
    assert not trap.exists()


def test_a_bomb_is_not_unpacked(run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = run.save(tmp_path / "run.npz")
    unpacked = sum(info.file_size for info in zipfile.ZipFile(file).infolist())
    monkeypatch.setattr(coopqp.simulation.recording.recording, "MAX_RECORDING_BYTES", unpacked)
    Recording.load(file)
    monkeypatch.setattr(coopqp.simulation.recording.recording, "MAX_RECORDING_BYTES", unpacked - 1)
    with pytest.raises(RecordingError, match=f"unpacks to {unpacked} bytes"):
        Recording.load(file)


@pytest.mark.parametrize("content", [b"", b"PK", b"not a zip", b"\x93NUMPY", b"PK\x05\x06" + b"\0" * 18, b"\0" * 1000])
def test_what_is_no_recording(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "file.npz"
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"file\.npz is not a coopqp recording"):
        Recording.load(file)
    for missing, why in ((tmp_path / "nothing.npz", "there is no such file"), (tmp_path, "it is a folder")):
        with pytest.raises(RecordingError, match=why):
            Recording.load(missing)


@pytest.mark.parametrize(
    "changes",
    [
        *({name: None} for name in (*ARRAYS, "text")),
        {"q": np.zeros((20, 18))},
        {"q": np.zeros(21)},
        {"rate": np.float64(1.0)},
        {"rate": np.ones((20, 1))},
        {"rate": np.ones(19)},
        {"velocity": np.zeros((21, 18))},
        {"reference": np.zeros((21, 3, 3))},
        {"T_object_tool": np.zeros((3, 16))},
        {"status": np.full(20, 99.0)},
        {"status": np.full(20, -1.0)},
        {"status": np.full(20, 0.5)},
        {"status": np.full(20, np.nan)},
        {"time": np.array(["now"] * 21)},
        {"clock": np.array([b"x"] * 21)},
        {"text": np.array("{")},
        {"text": np.array("[1, 2]")},
        {"text": np.array("null")},
        {"text": np.array(json.dumps({"notes": 5, "metadata": {}}))},
        {"text": np.array(json.dumps({"notes": [], "metadata": 5}))},
        {"text": np.array(json.dumps({"notes": []}))},
    ],
)
def test_what_does_not_fit_together(run: Recording, tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(RecordingError, match=r"changed\.npz"):
        Recording.load(saved(run, tmp_path, **changes))


@pytest.fixture(scope="module")
def small(run: Recording) -> bytes:
    """The compressed file of a short recording."""
    steps, samples = ("velocity", "rate", "status"), ("time", "q", "q_command", "clock", "reference")
    cut = replace(run, **{n: getattr(run, n)[:3] for n in samples}, **{n: getattr(run, n)[:2] for n in steps})
    stream = io.BytesIO()
    text = json.dumps({"format": 1, "notes": ["0: x"], "metadata": {}})
    np.savez_compressed(stream, text=np.array(text), **{name: getattr(cut, name) for name in ARRAYS})
    return stream.getvalue()


@MANY
@given(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255), st.sampled_from(["flip", "cut", "insert", "zero"]))
def test_a_damaged_file_is_refused_or_read(small: bytes, tmp_path: Path, at: float, flip: int, how: str) -> None:
    i = int(at * len(small))
    damaged = {
        "flip": small[:i] + bytes([small[i] ^ flip]) + small[i + 1 :],
        "cut": small[:i],
        "insert": small[:i] + bytes([flip]) + small[i:],
        "zero": small[:i] + b"\0" * min(flip, len(small) - i) + small[i + flip :],
    }[how]
    file = tmp_path / "damaged.npz"
    file.write_bytes(damaged)
    try:
        recording = Recording.load(file)
    except RecordingError as error:
        refusal = str(error)
    else:
        assert recording.q.shape == (3, 18)
        return
    assert "damaged.npz" in refusal
