"""A run as arrays, in memory or in a file: returned by :func:`coopqp.simulate`, saved and loaded."""

from __future__ import annotations

import json
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.control.interface import Status
from coopqp.errors import CoopqpError, OutputError, printable
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.output import Interrupts, whole_file
from coopqp.reading import check_depth, open_file
from coopqp.shown import Shown
from coopqp.simulation.recording.rows import parts, read_archive, unpacked_bytes, write_archive
from coopqp.simulation.recording.scene import read_cell
from coopqp.spatial import Array

#: Largest accepted recording [bytes, uncompressed].
MAX_RECORDING_BYTES = 2_000_000_000
#: Recordings with more bytes are not compressed, so that they can be read in parts.
MAX_COMPRESSED_BYTES = 64 * 2**20


#: Largest accepted nesting depth of what a recording says beside its arrays.
_MOST_DEPTH = 100
#: Bound of the size of a file, which is bounded by what it unpacks to.
_ANY_SIZE = 2**63
#: Time at which no recording ends [s]: a century.
LONGEST = 3e9


class RecordingError(CoopqpError):
    """A file is not a recording, or it cannot be read or written."""


@dataclass(frozen=True, eq=False)
class Recording(Shown):
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
        notes: one entry ``"step: explanation"`` per change of status or binding limits; one for many changes that
            alternate.
        metadata: controller, solver, names of arms and joints; description of the cell and the path (``scene``,
            ``path``: :mod:`coopqp.simulation.recording.scene`); binding limits over time (``binding``); the plant, and
            whether the arms held one object at the end (``gripped``); entries of the caller.
        wrenches: wrenches of the arms on the object after each step, at the origins and in the axes of the tools
            (T, N, 6) [N, N·m], as sensors without errors read them; None for a run recorded without loads.
        shift: motion by which each grasp had given way in each step (T, N, 6) [m, rad], in the object frame; None for
            controllers whose grasps stay.
        torques: torques of the joints after each step (T, nv) [N·m or N]; None for a run recorded without loads.
        meshes: whether the mesh files that the description of the cell names may be opened. False after :meth:`load`,
            unless asked for: a stranger's recording may name any file of your disk.
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
    meshes: bool = True
    wrenches: Array | None = None
    torques: Array | None = None
    shift: Array | None = None

    def __repr__(self) -> str:
        end = "finished" if self.finished else "not finished"
        made = self.metadata.get("controller", "unknown controller")
        span = float(self.time[-1]) if len(self.time) else 0.0
        arms = f"{len(self.T_object_tool)} arm{'s' * (len(self.T_object_tool) != 1)}"
        return f"Recording({printable(str(made))}, {arms}, {self.n_steps} steps, {span:.4g} s, {end})"

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
            named = {int(step): tuple(_limit(*entries) for entries in limits) for step, limits in changes}
        except (TypeError, ValueError, OverflowError) as error:
            raise RecordingError(f"'binding' in the recording's metadata is damaged ({error}).") from error
        now: tuple[BindingLimit, ...] = ()
        return [now := named.get(step, now) for step in range(self.n_steps)]

    @property
    def finished(self) -> bool:
        """True if the object's clock reached the end of its path."""
        return bool(self.metadata.get("finished", False))

    def sample_at(self, seconds: float) -> int:
        """The last sample at or before a time [s]; the first one for earlier times. Also fast in a long recording."""
        return max(int(np.searchsorted(self.time, seconds, side="right")) - 1, 0)

    def cell(self, *, shapes: bool = True) -> RobotCell:
        """The cell of the run, from the description in the metadata.

        Args:
            shapes: also read the visual shapes; mesh files are opened only if :attr:`meshes` says so.

        Raises:
            SceneError: the description is missing or damaged, or a mesh file is missing.
        """
        return read_cell(self.metadata, shapes=shapes, meshes=self.meshes)

    def parts(self, count: int) -> Iterator[slice]:
        """Slices that cover ``count`` samples or steps, for sums over long runs: one part is in memory at a time."""
        return parts(count, self._arrays().values())

    def shift_at(self, samples: slice) -> Array | None:
        """By how much the grasps had given way at samples (M, N, 6), for a command at each; None as :attr:`shift`."""
        if self.shift is None or not self.n_steps:
            return None
        return self.shift[np.maximum(np.arange(samples.start, samples.stop) - 1, 0)]

    def grasps_at(self, sample: int) -> tuple[pin.SE3, ...]:
        """T_object_tool of each arm at a sample: as at the start, or where the tools have moved to on the object."""
        moved = self.shift_at(slice(sample, sample + 1))
        if moved is None:
            return self.grasp.T_object_tool
        return tuple(pin.exp6(d) * X for d, X in zip(moved[0], self.grasp.T_object_tool, strict=True))

    def _arrays(self) -> dict[str, Array]:
        """The arrays of this run, by name."""
        asked = [name for name in _OPTIONAL if getattr(self, name) is not None]
        return {name: getattr(self, name) for name in (*_ARRAYS, *asked)}

    def save(self, path: str | Path) -> Path:
        """Write a ``.npz`` file, atomically; a failure or an interrupt leaves what was there.

        A recording of more than :data:`MAX_COMPRESSED_BYTES` is not compressed, so that :meth:`load` reads parts of it.

        Raises:
            RecordingError: the folder does not exist or cannot be written.
        """
        file = Path(path)
        try:
            text = json.dumps({"format": 1, "notes": list(self.notes), "metadata": self.metadata})
        except (TypeError, ValueError) as error:
            raise RecordingError(f"cannot write {file}: the metadata are not JSON ({error}).") from error
        if not file.parent.is_dir():
            raise RecordingError(f"cannot write {file}: no such folder. Check that its folder exists.")
        arrays = {"text": np.array(text), **self._arrays()}
        compress = sum(array.nbytes for array in arrays.values()) <= MAX_COMPRESSED_BYTES
        try:
            with Interrupts() as interrupts, whole_file(file) as stream:
                write_archive(stream, arrays, compress=compress, between=interrupts.check)
        except (OSError, OutputError) as error:
            raise RecordingError(f"cannot write {file}: {error}") from error
        return file

    @staticmethod
    def load(path: str | Path, *, meshes: bool = False) -> Recording:
        """Read a ``.npz`` file of :meth:`save`. No code in it is executed.

        Long arrays stay in the file, and are read where they are looked at.

        Args:
            path: the file.
            meshes: :attr:`meshes`; True for files from those whom you trust.

        Raises:
            RecordingError: the file is missing, too large, not a recording, or inconsistent.
        """
        file = Path(path)
        try:
            open_file(file, _ANY_SIZE).close()
        except OSError as error:
            there = "there is no such file" if isinstance(error, FileNotFoundError) else error.strerror
            raise RecordingError(f"cannot read {error.filename}: {there}. Check the path.") from error
        try:
            size = unpacked_bytes(file)
            if size > MAX_RECORDING_BYTES:
                raise RecordingError(f"{file} unpacks to {size} bytes, more than {MAX_RECORDING_BYTES}; not read.")
            content = read_archive(file, ("text", *_ARRAYS), _OPTIONAL)
            text = json.loads(str(content.pop("text")))
            check_depth(text, _MOST_DEPTH)
            recording = Recording(
                notes=tuple(map(str, text["notes"])), metadata=dict(text["metadata"]), meshes=meshes, **content
            )
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
        asked = {"wrenches": (steps, len(self.T_object_tool), 6), "torques": (steps, self.velocity.shape[-1])}
        asked["shift"] = asked["wrenches"]
        expected |= {name: shape for name, shape in asked.items() if getattr(self, name) is not None}
        for name, shape in expected.items():
            got = getattr(self, name).shape
            if len(got) != len(shape) or any(n is not None and n != m for n, m in zip(shape, got, strict=True)):
                want = ", ".join("any" if n is None else str(n) for n in shape)
                raise RecordingError(f"{file}: '{name}' has shape {got}, not ({want}); it is cut or was changed.")
        rises = np.isfinite(self.time).all() and (np.diff(self.time) >= 0.0).all()
        if not (rises and np.abs(self.time).max() < LONGEST):
            raise RecordingError(f"{file}: 'time' is no rising time in seconds; it is damaged or was changed.")
        known = all(np.isin(self.status[part], np.arange(len(Status))).all() for part in self.parts(steps))
        if not known:
            raise RecordingError(f"{file}: 'status' has unknown codes; it was changed or comes from a newer coopqp.")


#: Exceptions that reading a damaged file can raise.
_UNREADABLE = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,  # NumPy, of a header that does not parse
    KeyError,
    ValueError,
    TypeError,
    EOFError,
    ArithmeticError,
    RuntimeError,
    MemoryError,
)
_ARRAYS = ("time", "q", "q_command", "velocity", "clock", "rate", "status", "reference", "T_object_tool")

#: Arrays of runs that were recorded with loads, or whose grasps give way.
_OPTIONAL = ("wrenches", "torques", "shift")


def entries_of(limit: BindingLimit) -> list[Any]:
    """A limit as plain values: arm, joint, kind, then the name of a constraint, the names of two bodies."""
    more: list[Any] = [limit.name] if limit.name or limit.between else []
    return [limit.arm, limit.joint, limit.kind.value, *more, *([list(limit.between)] if limit.between else [])]


def _limit(arm: str, joint: str, kind: str, name: str = "", between: Sequence[str] = ()) -> BindingLimit:
    pair = (str(between[0]), str(between[1])) if between else ()
    return BindingLimit(arm, joint, LimitKind(kind), name, pair)
