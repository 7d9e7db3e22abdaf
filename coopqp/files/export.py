"""Exports of recordings: a CSV table, and a ROS 2 bag (MCAP) with joint states and trajectories."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.control.interface import Status
from coopqp.errors import InvalidInputError, OutputError, printable
from coopqp.forces.utilisation import LoadUse
from coopqp.lazy import needed
from coopqp.model.cell import RobotCell, slides
from coopqp.model.limits import BindingLimit
from coopqp.output import check_bag, folder_of, temporary_name, whole_file
from coopqp.simulation.evaluation.metrics import check_recording, read_part
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array

#: Most steps of one trajectory message. Longer ones are too large for memory and middleware.
MAX_TRAJECTORY_STEPS = 20_000

_READINGS = ("eps_p_mm", "eps_o_deg", "chain_mm", "chain_deg", "object_mm", "object_deg")


def csv_text(recording: Recording, *, cell: RobotCell | None = None, load: LoadUse | None = None) -> str:
    """A run as CSV: one row per sample, numbers with all digits. :func:`csv_parts` has it in parts.

    Columns: time and the object's clock; rate, status and binding limits of the step that starts at the sample (empty
    in the last row); if an operator made calls, those ahead of it; measured position, commanded position and commanded
    velocity of every joint; the path's pose
    (position, quaternion); the errors of :class:`coopqp.simulation.Readings`. Units are in the names.

    Args:
        recording: the run.
        cell: cell of the run; by default read from the recording.
        load: of :func:`coopqp.forces.load_use` for the run; adds the feed-forward torque of every joint, and the share
            of the load that the arms carry.

    Raises:
        SceneError: no cell is given and the recording does not describe one.
        InvalidInputError: a recording of another cell, or a load of another run.
    """
    return "".join(csv_parts(recording, cell=cell, load=load))


def csv_parts(recording: Recording, *, cell: RobotCell | None = None, load: LoadUse | None = None) -> Iterator[str]:
    """:func:`csv_text` in parts: a long run is read, and becomes text, where it is written.

    Raises:
        SceneError, InvalidInputError: as in :func:`csv_text`, before the first part.
    """
    cell = recording.cell(shapes=False) if cell is None else cell
    check_recording(cell, recording)
    if load is not None and load.torques.shape != (recording.n_steps + 1, cell.nv):
        raise InvalidInputError(
            f"torques of shape {load.torques.shape} for {recording.n_steps + 1} samples of {cell.nv} joints",
            "write_csv: load",
            "Give load_use(…, recording.time, recording.q_command).",
        )
    return _parts(cell, recording, load)


def _parts(cell: RobotCell, recording: Recording, load: LoadUse | None) -> Iterator[str]:
    calls = _calls(recording)
    head = _header(cell, calls=bool(calls))
    if load is not None:
        units = ["N" if slide else "N_m" for slide in slides(cell)]
        head += [f"{name}.torque_{unit}" for name, unit in zip(cell.joint_names, units, strict=True)] + ["load_share"]
    yield _lines([head])
    bindings, joints = recording.bindings, JointPositions(cell, recording)
    for part in recording.parts(len(recording.time)):
        rows = _rows(cell, recording, bindings, calls, part, joints)
        if load is not None:
            torques = np.column_stack([load.torques[part], load.share[part]]).tolist()
            rows = ([*row, *more] for row, more in zip(rows, torques, strict=True))
        yield _lines(rows)


def _lines(rows: Iterable[list[Any]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(map(_cell, row) for row in rows)
    return stream.getvalue()


def _cell(value: Any) -> Any:
    """A cell of the table: texts without control characters, and none that a spreadsheet takes for a formula."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text


def _header(cell: RobotCell, *, calls: bool) -> list[str]:
    units = ["m" if slide else "rad" for slide in slides(cell)]
    joints = list(zip(cell.joint_names, units, strict=True))
    return [
        "time_s",
        "clock_s",
        "rate",
        "status",
        "binding",
        *(["call"] if calls else []),
        *(f"{name}.position_{unit}" for name, unit in joints),
        *(f"{name}.command_{unit}" for name, unit in joints),
        *(f"{name}.velocity_{unit}_per_s" for name, unit in joints),
        *(f"path.{axis}_m" for axis in "xyz"),
        *(f"path.q{axis}" for axis in "xyzw"),
        *_READINGS,
    ]


def _calls(recording: Recording) -> dict[int, str]:
    """What an operator called, by the step ahead of which it was."""
    found: dict[int, str] = {}
    for i, call, value, _ in recording.metadata.get("calls", ()):
        said = call if value is None else f"{call} {json.dumps(value)}"
        found[int(i)] = f"{found[int(i)]}; {said}" if int(i) in found else said
    return found


def _rows(
    cell: RobotCell,
    recording: Recording,
    bindings: list[tuple[BindingLimit, ...]],
    calls: dict[int, str],
    part: slice,
    joints: JointPositions,
) -> Iterator[list[Any]]:
    """The rows of some samples."""
    readings = read_part(cell, recording, part)
    measured, commanded = joints(part)
    order = list(Status)
    for k, i in enumerate(range(part.start, part.stop)):
        last = i == recording.n_steps
        status = "" if last else order[int(recording.status[i])].value
        step = [""] * 3 if last else [float(recording.rate[i]), status, "; ".join(map(str, bindings[i]))]
        step += [calls.get(i, "")] if calls else []
        velocity = [""] * cell.nv if last else recording.velocity[i].tolist()
        pose = pin.SE3(recording.reference[i])
        yield [
            float(recording.time[i]),
            float(recording.clock[i]),
            *step,
            *measured[k].tolist(),
            *commanded[k].tolist(),
            *velocity,
            *pose.translation.tolist(),
            *pin.Quaternion(pose.rotation).coeffs().tolist(),
            *(float(getattr(readings, name)[k]) for name in _READINGS),
        ]


def write_csv(
    recording: Recording, path: str | Path, *, cell: RobotCell | None = None, load: LoadUse | None = None
) -> Path:
    """Write :func:`csv_text` to a file, atomically and in parts.

    Raises:
        OutputError: the file cannot be written.
        SceneError, InvalidInputError: as in :func:`csv_text`.
    """
    file = Path(path)
    texts = csv_parts(recording, cell=cell, load=load)
    with whole_file(file) as stream:
        for text in texts:
            stream.write(text.encode())
    return file


class JointPositions:
    """Joint positions of a recording, part after part: continuous joints are counted on, turn for turn.

    They begin at the turns of the recording's ``turns``, as :class:`coopqp.drivers.MemoryRecorder` notes them, else in
    (−π, π].
    """

    def __init__(self, cell: RobotCell, recording: Recording) -> None:
        self._cell, self._recording = cell, recording
        turns = recording.metadata.get("turns", {})
        begin = cell.positions(recording.q_command[0])
        self._last: Array = begin + math.tau * np.array([turns.get(name, 0) for name in cell.joint_names])

    def __call__(self, part: slice) -> tuple[Array, Array]:
        """Measured and commanded positions (T, nv) [rad or m] of some samples, which go on from the last part's."""
        turning = self._cell.continuous
        measured, commanded = (self._cell.positions(q[part]) for q in (self._recording.q, self._recording.q_command))
        if turning.any():
            rows = np.vstack([self._last, commanded])[:, turning]
            commanded[:, turning] = np.unwrap(rows, axis=0)[1:]
            pairs = np.stack([commanded, measured])[..., turning]
            measured[:, turning] = np.unwrap(pairs, axis=0)[1]
            self._last = commanded[-1].copy()
        return measured, commanded


def knot_velocities(recording: Recording, part: slice = slice(None)) -> Array:
    """Velocity at samples (T+1, nv) [rad/s or m/s]: the mean of the steps before and after one, 0 at both ends.

    Trajectory controllers that interpolate between points need these velocities. ``part``: of these samples only.
    """
    begin, end, _ = part.indices(recording.n_steps + 1)
    v = np.zeros((end - begin, recording.velocity.shape[1]))
    first, last = max(begin, 1), min(end, recording.n_steps)  # samples between two steps
    if first < last:
        steps = recording.velocity[first - 1 : last]
        v[first - begin : last - begin] = 0.5 * (steps[:-1] + steps[1:])
    return v


def require_rosbags() -> None:
    """Raise MissingExtraError unless rosbags can be imported."""
    needed("rosbags.rosbag2", "bags", "rosbags")


def write_bag(recording: Recording, folder: str | Path, *, cell: RobotCell | None = None, start: float = 0.0) -> Path:
    """Write a ROS 2 bag in MCAP, atomically.

    Topics: ``/joint_states`` and ``/joint_commands`` (``sensor_msgs/JointState``, measured and commanded, with the
    velocities of :func:`knot_velocities`), ``/<arm>/joint_trajectory`` (``trajectory_msgs/JointTrajectory``, one
    message with the whole command; the stamp 0 means "start now"; continuous joints without jumps), ``/object_path``
    (``geometry_msgs/PoseStamped``) and, if an operator made calls, ``/operator_calls`` (``std_msgs/String``: the name
    and the values as JSON). Joints have the names ``arm/joint``.

    A run of more than :data:`MAX_TRAJECTORY_STEPS` has a trajectory for each such part, at its time in the bag. Each
    begins where the one before ends, mostly in motion: ros2_control plays them with
    ``allow_nonzero_velocity_at_trajectory_end``.

    Args:
        recording: the run.
        folder: folder of the bag; it must not exist.
        cell: cell of the run; by default read from the recording.
        start: time of the first sample [s since the epoch].

    Raises:
        OutputError: the folder exists or cannot be written.
        InvalidInputError: a negative start.
        SceneError: no cell is given and the recording does not describe one.
        MissingExtraError: rosbags is not installed.
    """
    require_rosbags()
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if not 0.0 <= start < 4e9:
        raise InvalidInputError(f"start is {start}", "write_bag", "Give seconds since the epoch, 0 for none.")
    cell = recording.cell(shapes=False) if cell is None else cell
    check_recording(cell, recording)
    target = Path(folder)
    check_bag(target)
    messages = Messages(get_typestore(Stores.ROS2_JAZZY), cell, recording, start)
    temporary = temporary_name(target)
    with folder_of(target):
        try:
            with Writer(temporary, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
                connections: dict[str, Any] = {}
                for nanoseconds, topic, message in messages.all():
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=messages.store)
                    data = messages.store.serialize_cdr(message, message.__msgtype__)
                    writer.write(connections[topic], nanoseconds, data)
            _rename_inside(temporary, target.name)
            temporary.rename(target)
        except OSError as error:
            raise OutputError(f"cannot write the bag {target}: {error.strerror}. Check the folder.") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return target


def _rename_inside(folder: Path, name: str) -> None:
    """Rename the storage file of a bag to the bag's name, also in the bag's metadata."""
    (storage,) = folder.glob("*.mcap")
    metadata = folder / "metadata.yaml"
    text = metadata.read_text(encoding="utf-8").replace(storage.name, f"{name}.mcap")
    metadata.write_text(text, encoding="utf-8")
    storage.rename(folder / f"{name}.mcap")


class Messages:
    """The messages of a bag, in the order of time."""

    def __init__(self, store: Any, cell: RobotCell, recording: Recording, start: float) -> None:
        self.store, self._cell, self._recording = store, cell, recording
        self._start = round(start * 1e9)

    def all(self) -> Iterator[tuple[int, str, Any]]:
        """(nanoseconds, topic, message)."""
        recording = self._recording
        pieces, due, calls = self._pieces(), 0, _calls(recording)
        joints = JointPositions(self._cell, recording)
        for part in recording.parts(len(recording.time)):
            measured, commanded = joints(part)
            velocities = knot_velocities(recording, part)
            for k, i in enumerate(range(part.start, part.stop)):
                now = self._start + _nanoseconds(recording.time[i])
                if i == due and (piece := next(pieces, None)) is not None:
                    due += MAX_TRAJECTORY_STEPS
                    for topic, message in self._trajectories(*piece):
                        yield now, topic, message
                for topic, positions in (("/joint_states", measured), ("/joint_commands", commanded)):
                    yield now, topic, self._state(now, positions[k], velocities[k])
                yield now, "/object_path", self._pose(now, pin.SE3(recording.reference[i]))
                if i in calls:
                    yield now, "/operator_calls", self._make("std_msgs/msg/String", data=calls[i])

    def _pieces(self) -> Iterator[tuple[slice, Array]]:
        """Samples and commanded positions of each trajectory."""
        recording, joints = self._recording, JointPositions(self._cell, self._recording)
        for begin in range(0, max(recording.n_steps, 1), MAX_TRAJECTORY_STEPS):
            piece = slice(begin, min(begin + MAX_TRAJECTORY_STEPS, recording.n_steps) + 1)
            yield piece, joints(piece)[1]

    def _make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def _time(self, nanoseconds: int, kind: str = "Time") -> Any:
        return self._make(f"builtin_interfaces/msg/{kind}", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def _header(self, nanoseconds: int, frame: str = "") -> Any:
        return self._make("std_msgs/msg/Header", stamp=self._time(nanoseconds), frame_id=frame)

    def _state(self, nanoseconds: int, positions: Array, velocities: Array) -> Any:
        return self._make(
            "sensor_msgs/msg/JointState",
            header=self._header(nanoseconds),
            name=list(self._cell.joint_names),
            position=positions,
            velocity=velocities,
            effort=np.zeros(0),
        )

    def _pose(self, nanoseconds: int, pose: pin.SE3) -> Any:
        x, y, z, w = pin.Quaternion(pose.rotation).coeffs().tolist()
        position = self._make("geometry_msgs/msg/Point", **dict(zip("xyz", pose.translation.tolist(), strict=True)))
        turn = self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        return self._make(
            "geometry_msgs/msg/PoseStamped",
            header=self._header(nanoseconds, "world"),
            pose=self._make("geometry_msgs/msg/Pose", position=position, orientation=turn),
        )

    def _trajectories(self, piece: slice, positions: Array) -> Iterator[tuple[str, Any]]:
        velocities = knot_velocities(self._recording, piece)
        times = [_nanoseconds(t) for t in self._recording.time[piece] - self._recording.time[piece.start]]
        for name, own in self._cell.blocks.items():
            points = [
                self._make(
                    "trajectory_msgs/msg/JointTrajectoryPoint",
                    positions=positions[i, own].copy(),
                    velocities=velocities[i, own].copy(),
                    accelerations=np.zeros(0),
                    effort=np.zeros(0),
                    time_from_start=self._time(t, "Duration"),
                )
                for i, t in enumerate(times)
            ]
            yield (
                f"/{topic_name(name)}/joint_trajectory",
                self._make(
                    "trajectory_msgs/msg/JointTrajectory",
                    header=self._header(0),
                    joint_names=list(self._cell.joint_names[own]),
                    points=points,
                ),
            )


def _nanoseconds(seconds: float) -> int:
    return round(float(seconds) * 1e9)


def topic_name(arm: str) -> str:
    """An arm's name as a valid ROS topic: letters, digits and underscores, no digit first."""
    plain = re.sub(r"\W", "_", arm, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain
