"""The control loop: a controller commands, a plant moves, a Recording stores the run."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.checks import as_scalar, read_only
from coopqp.control.command import Controller, ControlStep, Status
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.output import OutputError, write_files
from coopqp.planning.starts import find_start
from coopqp.simulation.notes import Notes
from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
from coopqp.simulation.scene import describe_cell, describe_path
from coopqp.spatial import Array

#: Largest accepted recording [bytes, unpacked].
MAX_RECORDING_BYTES = 2_000_000_000
#: Time until a run with a stopped object ends, by default [s].
PATIENCE = 1.0
#: An object off its path stands at a rate below this.
_AT_REST = 1e-3
#: Called during a run with the numbers of steps (done, total).
ProgressCallback = Callable[[int, int], None]


class RecordingError(CoopqpError):
    """A file is not a recording, or it cannot be read or written."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A run as arrays. T steps have T + 1 samples of the configuration.

    Attributes:
        time: time of each sample [s], (T+1,).
        q: measured configuration (T+1, nq).
        q_command: commanded configuration (T+1, nq).
        velocity: commanded joint velocities (T, nv).
        clock: the object's clock at each sample [s], (T+1,).
        rate: σ (T,).
        status: :attr:`Status.code` of each step (T,).
        reference: the path's pose at each sample, 4x4 matrices (T+1, 4, 4).
        T_object_tool: the grasp, (N, 4, 4).
        notes: one entry ``"step: explanation"`` per change of status or binding limits; one for many
            changes to and fro.
        metadata: controller, solver, names of arms and joints; description of the cell and the path (``scene``,
            ``path``: :mod:`coopqp.simulation.scene`); binding limits over time (``binding``); the plant, and whether
            the arms held one object at the end (``gripped``); entries of the caller.
    """

    time: Array
    q: Array
    q_command: Array
    velocity: Array
    clock: Array
    rate: Array
    status: Array
    reference: Array
    T_object_tool: Array
    notes: tuple[str, ...]
    metadata: dict[str, Any]

    @property
    def n_steps(self) -> int:
        """T, the number of steps."""
        return len(self.rate)

    @property
    def grasp(self) -> Grasp:
        """The grasp of the run."""
        return Grasp(tuple(self.T_object_tool))

    @property
    def statuses(self) -> list[Status]:
        """Status of each step."""
        order = list(Status)
        return [order[int(code)] for code in self.status]

    @property
    def bindings(self) -> list[tuple[BindingLimit, ...]]:
        """The binding limits of each step; empty if the recording does not contain them.

        Raises:
            RecordingError: the entry ``binding`` of the metadata is damaged.
        """
        changes = self.metadata.get("binding", [])
        try:
            named = {
                int(step): tuple(BindingLimit(a, j, LimitKind(k), *name) for a, j, k, *name in limits)
                for step, limits in changes
            }
        except (TypeError, ValueError) as error:
            raise RecordingError(f"'binding' in the recording's metadata is damaged ({error}).") from error
        now: tuple[BindingLimit, ...] = ()
        return [now := named.get(step, now) for step in range(self.n_steps)]

    @property
    def finished(self) -> bool:
        """True if the object's clock reached the end of its path."""
        return bool(self.metadata.get("finished", False))

    def save(self, path: str | Path) -> Path:
        """Write a ``.npz`` file, atomically.

        Raises:
            RecordingError: the folder does not exist or cannot be written.
        """
        file = Path(path)
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        try:
            text = json.dumps({"format": 1, "notes": list(self.notes), "metadata": self.metadata})
        except (TypeError, ValueError) as error:
            raise RecordingError(f"cannot write {file}: the metadata are not JSON ({error}).") from error
        if not file.parent.is_dir():
            raise RecordingError(f"cannot write {file}: no such folder. Check that its folder exists.")
        buffer = io.BytesIO()
        try:
            np.savez_compressed(buffer, text=np.array(text), **arrays)
            write_files({file: buffer.getvalue()})
        except (OSError, OutputError) as error:
            raise RecordingError(f"cannot write {file}: {error}") from error
        return file

    @staticmethod
    def load(path: str | Path) -> Recording:
        """Read a ``.npz`` file of :meth:`save`. No code in it is executed.

        Raises:
            RecordingError: the file is missing, too large, not a recording, or inconsistent.
        """
        file = Path(path)
        try:
            with zipfile.ZipFile(file) as archive:
                size = sum(info.file_size for info in archive.infolist())
            if size > MAX_RECORDING_BYTES:
                raise RecordingError(f"{file} unpacks to {size} bytes, more than {MAX_RECORDING_BYTES}; not read.")
            with np.load(file, allow_pickle=False) as data:
                text = json.loads(str(data["text"]))
                arrays = {name: read_only(data[name]) for name in _ARRAYS}
            recording = Recording(notes=tuple(map(str, text["notes"])), metadata=dict(text["metadata"]), **arrays)
        except _UNREADABLE as error:
            raise RecordingError(f"{file} is not a coopqp recording ({type(error).__name__}: {error}).") from error
        recording._check(file)
        return recording

    def _check(self, file: Path) -> None:
        steps, samples = self.rate.size, self.rate.size + 1
        expected: dict[str, tuple[int | None, ...]] = {  # None: any size
            "rate": (steps,),
            "status": (steps,),
            "velocity": (steps, None),
            "time": (samples,),
            "clock": (samples,),
            "q": (samples, None),
            "q_command": (samples, None),
            "reference": (samples, 4, 4),
            "T_object_tool": (None, 4, 4),
        }
        for name, shape in expected.items():
            got = getattr(self, name).shape
            if len(got) != len(shape) or any(n is not None and n != m for n, m in zip(shape, got, strict=True)):
                want = ", ".join("any" if n is None else str(n) for n in shape)
                raise RecordingError(f"{file}: '{name}' has shape {got}, not ({want}); it is cut or was changed.")
        if not np.isin(self.status, np.arange(len(Status))).all():
            raise RecordingError(f"{file}: 'status' has unknown codes; it was changed or comes from a newer coopqp.")


#: Exceptions that reading a damaged file can raise.
_UNREADABLE = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    KeyError,
    ValueError,
    TypeError,
    EOFError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
)
_ARRAYS = ("time", "q", "q_command", "velocity", "clock", "rate", "status", "reference", "T_object_tool")


def simulate(
    controller: Controller,
    plant: Plant | None = None,
    *,
    q_start: Any = None,
    duration: float | None = None,
    settle: float = 0.0,
    patience: float | None = PATIENCE,
    progress: ProgressCallback | None = None,
    observe: Callable[[ControlStep], None] | None = None,
    metadata: dict[str, Any] | None = None,
) -> Recording:
    """Run a controller on a plant until the object reaches the end of its path.

    Args:
        controller: the controller; it is reset at the plant's measured configuration.
        plant: the plant; by default an ideal :class:`KinematicPlant`.
        q_start: start configuration (nq,); by default :func:`coopqp.planning.find_start` finds one.
        duration: longest run [s]; by default ten times the path's duration, because a slowed object takes longer.
        settle: time that the run continues after the end of the path [s].
        patience: the run ends when the object was blocked, held, stopped or at rest off its path for this time [s];
            None for never. A pause does not count.
        progress: called as ``progress(steps done, steps of an unslowed run)``.
        observe: called with every :class:`ControlStep`.
        metadata: entries stored in the recording; must be JSON.

    Raises:
        InvalidInputError: bad ``q_start`` or durations, or the arms do not hold the object at the start.
        NoStartError: no ``q_start`` is given and there is none.
    """
    for thing, methods, name in ((controller, ("reset", "step"), "controller"), (plant, ("reset", "apply"), "plant")):
        if thing is not None and not all(callable(getattr(thing, method, None)) for method in methods):
            raise InvalidInputError(
                f"a {type(thing).__name__}", f"simulate: {name}", f"Give an object with {' and '.join(methods)}."
            )
    cell: RobotCell = controller.cell
    plant = KinematicPlant(cell) if plant is None else plant
    endless = not np.isfinite(controller.path.duration)
    if duration is None and endless:
        raise InvalidInputError("the path has no end", "simulate: duration", "Say how long to run [s].")
    longest = 10.0 * controller.path.duration if duration is None else as_scalar(duration, "simulate: duration")
    after = as_scalar(settle, "simulate: settle", open_low=False)
    enough = np.inf if patience is None else as_scalar(patience, "simulate: patience")
    try:
        json.dumps(metadata)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"not JSON ({error})", "simulate: metadata", "Give plain values.") from error
    if metadata is not None and not isinstance(metadata, dict):
        raise InvalidInputError(f"a {type(metadata).__name__}", "simulate: metadata", "Give a dictionary.")
    if q_start is None:
        q_start = find_start(cell, controller.grasp, controller.path).q
    measured = plant.reset(q_start)
    controller.reset(measured)
    steps: list[ControlStep] = []
    q_measured = [measured]
    notes = Notes()
    nominal = max(1, round((longest if endless else controller.path.duration + after) / controller.dt))
    elapsed, rest, still = 0.0, 0.0, 0.0
    while elapsed < longest - 1e-9 * longest:
        step = controller.step(measured)
        measured = plant.apply(step)
        steps.append(step)
        q_measured.append(measured)
        elapsed += step.dt
        notes.take(step)
        if observe is not None:
            observe(step)
        if progress is not None:
            progress(len(steps), nominal)
        if step.finished:
            if rest >= after - 1e-12:
                break
            rest += step.dt
        still = still + step.dt if _stands(step) else 0.0
        if still >= enough:
            break
    held = {"plant": type(plant).__name__, "gripped": getattr(plant, "gripped", None)}
    return _record(controller, steps, q_measured, notes.lines(), {**held, **(metadata or {})})


def _stands(step: ControlStep) -> bool:
    """Whether the object waits for something that its operator did not ask for."""
    if step.status is Status.OFF_PATH:
        return step.rate < _AT_REST
    return step.status in (Status.BLOCKED, Status.HOLDING, Status.FAULT)


def _record(
    controller: Controller,
    steps: list[ControlStep],
    q_measured: list[Array],
    notes: tuple[str, ...],
    metadata: dict[str, Any],
) -> Recording:
    cell = controller.cell
    clock = np.array([steps[0].clock, *(s.clock_next for s in steps)])
    return Recording(
        time=np.concatenate([[0.0], np.cumsum([s.dt for s in steps])]),
        q=np.array(q_measured),
        q_command=np.array([steps[0].q, *(s.q_next for s in steps)]),
        velocity=np.array([s.velocity for s in steps]),
        clock=clock,
        rate=np.array([s.rate for s in steps]),
        status=np.array([float(s.status.code) for s in steps]),
        reference=np.array([controller.path.pose(c).homogeneous for c in clock]),
        T_object_tool=np.array([X.homogeneous for X in controller.grasp.T_object_tool]),
        notes=notes,
        metadata={
            "controller": type(controller).__name__,
            "dt": controller.dt,
            "duration": controller.path.duration,
            "arms": list(cell.arm_names),
            "joints": list(cell.joint_names),
            "sources": [arm.source for arm in cell.arms],
            "scene": describe_cell(cell),
            "path": describe_path(controller.path),
            "binding": _binding_changes(steps),
            "finished": steps[-1].finished,
            "failures": sum(s.status in (Status.HOLDING, Status.FAULT) for s in steps),
            **metadata,
        },
    )


def _binding_changes(steps: list[ControlStep]) -> list[list[Any]]:
    """``[step, [[arm, joint, kind], …]]`` for every step with other binding limits than the step before.

    A limit of a user's constraint has its name as a fourth entry.
    """
    changes: list[list[Any]] = []
    last: tuple[BindingLimit, ...] = ()
    for i, step in enumerate(steps):
        if step.binding != last:
            changes.append([i, [[b.arm, b.joint, b.kind.value, *([b.name] if b.name else [])] for b in step.binding]])
            last = step.binding
    return changes
