"""Exports of recordings: a CSV table, and a ROS 2 bag (MCAP) with joint states and trajectories."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError, MissingExtraError, printable
from coopqp.forces.use import LoadUse
from coopqp.model.cell import RobotCell
from coopqp.output import OutputError, check_folder, folder_of, write_files
from coopqp.simulation.assessment import Readings, check_recording, read_run, slides
from coopqp.simulation.recording import Recording
from coopqp.spatial import Array

_READINGS = ("eps_p_mm", "eps_o_deg", "chain_mm", "chain_deg", "object_mm", "object_deg")


def joint_table(cell: RobotCell, recording: Recording) -> tuple[Array, Array]:
    """Measured and commanded joint positions, (T+1, nv) each [rad or m]; continuous joints in (−π, π]."""
    check_recording(cell, recording)
    return (
        cell.positions(recording.q),
        cell.positions(recording.q_command),
    )


def csv_text(recording: Recording, *, cell: RobotCell | None = None, load: LoadUse | None = None) -> str:
    """A run as CSV: one row per sample, numbers with all digits.

    Columns: time and the object's clock; rate, status and binding limits of the step that starts at the sample (empty
    in the last row); measured position, commanded position and commanded velocity of every joint; the path's pose
    (position, quaternion); the errors of :class:`coopqp.simulation.assessment.Readings`. Units are in the names.

    Args:
        recording: the run.
        cell: cell of the run; by default read from the recording.
        load: of :func:`coopqp.forces.load_use` for the run; adds the feed-forward torque of every joint, and the share
            of the load that the arms carry.

    Raises:
        SceneError: no cell is given and the recording does not describe one.
        InvalidInputError: a load of another run.
    """
    cell = recording.cell(shapes=False) if cell is None else cell
    if load is not None and load.torques.shape != (recording.n_steps + 1, cell.nv):
        raise InvalidInputError(
            f"torques of shape {load.torques.shape} for {recording.n_steps + 1} samples of {cell.nv} joints",
            "write_csv: load",
            "Give load_use(…, recording.time, recording.q_command).",
        )
    readings = read_run(cell, recording)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    head, rows = _header(cell), _rows(cell, recording, readings)
    if load is not None:
        units = ["N" if slide else "N_m" for slide in slides(cell)]
        head += [f"{name}.torque_{unit}" for name, unit in zip(cell.joint_names, units, strict=True)] + ["load_share"]
        torques = np.column_stack([load.torques, load.share]).tolist()
        rows = ([*row, *more] for row, more in zip(rows, torques, strict=True))
    writer.writerow(map(_cell, head))
    writer.writerows(map(_cell, row) for row in rows)
    return stream.getvalue()


def _cell(value: Any) -> Any:
    """A cell of the table: texts without control characters, and none that a spreadsheet takes for a formula."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text


def _header(cell: RobotCell) -> list[str]:
    units = ["m" if slide else "rad" for slide in slides(cell)]
    joints = list(zip(cell.joint_names, units, strict=True))
    return [
        "time_s",
        "clock_s",
        "rate",
        "status",
        "binding",
        *(f"{name}.position_{unit}" for name, unit in joints),
        *(f"{name}.command_{unit}" for name, unit in joints),
        *(f"{name}.velocity_{unit}_per_s" for name, unit in joints),
        *(f"path.{axis}_m" for axis in "xyz"),
        *(f"path.q{axis}" for axis in "xyzw"),
        *_READINGS,
    ]


def _rows(cell: RobotCell, recording: Recording, readings: Readings) -> Iterator[list[Any]]:
    measured, commanded = joint_table(cell, recording)
    statuses, bindings = recording.statuses, recording.bindings
    for i, time in enumerate(recording.time):
        last = i == recording.n_steps
        step = [""] * 3 if last else [float(recording.rate[i]), statuses[i].value, "; ".join(map(str, bindings[i]))]
        velocity = [""] * cell.nv if last else recording.velocity[i].tolist()
        pose = pin.SE3(recording.reference[i])
        yield [
            float(time),
            float(recording.clock[i]),
            *step,
            *measured[i].tolist(),
            *commanded[i].tolist(),
            *velocity,
            *pose.translation.tolist(),
            *pin.Quaternion(pose.rotation).coeffs().tolist(),
            *(float(getattr(readings, name)[i]) for name in _READINGS),
        ]


def write_csv(
    recording: Recording, path: str | Path, *, cell: RobotCell | None = None, load: LoadUse | None = None
) -> Path:
    """Write :func:`csv_text` to a file, atomically.

    Raises:
        OutputError: the file cannot be written.
        SceneError, InvalidInputError: as in :func:`csv_text`.
    """
    file = Path(path)
    write_files({file: csv_text(recording, cell=cell, load=load).encode()})
    return file


def knot_velocities(recording: Recording) -> Array:
    """Velocity at each sample (T+1, nv) [rad/s or m/s]: the mean of the steps before and after it, 0 at both ends.

    Trajectory controllers that interpolate between points need these velocities.
    """
    v = np.zeros((recording.n_steps + 1, recording.velocity.shape[1]))
    v[1:-1] = 0.5 * (recording.velocity[:-1] + recording.velocity[1:])
    return v


def require_rosbags() -> None:
    """Raise MissingExtraError unless rosbags can be imported."""
    try:
        import rosbags.rosbag2
        import rosbags.typesys  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("bags", "rosbags") from error


def write_bag(recording: Recording, folder: str | Path, *, cell: RobotCell | None = None, start: float = 0.0) -> Path:
    """Write a ROS 2 bag in MCAP, atomically.

    Topics: ``/joint_states`` and ``/joint_commands`` (``sensor_msgs/JointState``, measured and commanded, with the
    velocities of :func:`knot_velocities`), ``/<arm>/joint_trajectory`` (``trajectory_msgs/JointTrajectory``, one
    message with the whole command; the stamp 0 means "start now"; continuous joints without jumps) and ``/object_path``
    (``geometry_msgs/PoseStamped``). Joints have the names ``arm/joint``.

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
    target = Path(folder)
    if target.exists():
        raise OutputError(f"cannot write the bag {target}: it exists. Remove it, or give another folder.")
    check_folder(target.parent)
    messages = _Messages(get_typestore(Stores.ROS2_JAZZY), cell, recording, start)
    temporary = target.with_name(f".{target.name}.{os.urandom(4).hex()}.tmp")
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
    metadata.write_text(metadata.read_text().replace(storage.name, f"{name}.mcap"))
    storage.rename(folder / f"{name}.mcap")


class _Messages:
    """The messages of a bag, in the order of time."""

    def __init__(self, store: Any, cell: RobotCell, recording: Recording, start: float) -> None:
        self.store, self._cell, self._recording = store, cell, recording
        self._start = round(start * 1e9)
        self._times = [round(float(t) * 1e9) for t in recording.time]
        self._measured, self._commanded = joint_table(cell, recording)
        self._velocities = knot_velocities(recording)
        turning = cell.continuous
        self._trajectory = self._commanded.copy()  # without jumps of a full turn
        self._trajectory[:, turning] = np.unwrap(self._commanded[:, turning], axis=0)

    def all(self) -> Iterator[tuple[int, str, Any]]:
        """(nanoseconds, topic, message)."""
        for topic, message in self._trajectories():
            yield self._start, topic, message
        for i, t in enumerate(self._times):
            now = self._start + t
            for topic, positions in (("/joint_states", self._measured), ("/joint_commands", self._commanded)):
                yield now, topic, self._state(now, positions[i], self._velocities[i])
            yield now, "/object_path", self._pose(now, pin.SE3(self._recording.reference[i]))

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

    def _trajectories(self) -> Iterator[tuple[str, Any]]:
        for name, own in zip(self._cell.arm_names, self._cell.v_slices, strict=True):
            points = [
                self._make(
                    "trajectory_msgs/msg/JointTrajectoryPoint",
                    positions=self._trajectory[i, own].copy(),
                    velocities=self._velocities[i, own].copy(),
                    accelerations=np.zeros(0),
                    effort=np.zeros(0),
                    time_from_start=self._time(t, "Duration"),
                )
                for i, t in enumerate(self._times)
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


def topic_name(arm: str) -> str:
    """An arm's name as a valid ROS topic: letters, digits and underscores, no digit first."""
    plain = re.sub(r"\W", "_", arm, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain
