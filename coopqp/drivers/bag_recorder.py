"""A run on robots as a ROS 2 bag (MCAP, extra ``bags``), written while it goes on by a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from coopqp.control.interface import ControlStep
from coopqp.drivers.ring import RowRing
from coopqp.errors import OutputError
from coopqp.lazy import needed
from coopqp.output import check_bag
from coopqp.spatial import Array

#: Rows of the ring: at 500 Hz the writer may be away for 16 s.
_SLOTS = 8192
#: How often the writer looks [s], how long it may take to begin and to end [s].
_LOOK, _START, _END = 0.02, 30.0, 10.0
_TOPICS = ("/joint_states", "/joint_commands")


@final
class BagRecorder:
    """Writes ``/joint_states`` and ``/joint_commands`` (``sensor_msgs/JointState``) of every period into a bag.

    The loop only copies its numbers into shared memory. When the writer is killed, or its disk is full, the loop goes
    on, and :meth:`close` says how much is missing. Joints have the names ``arm/joint``; what is not measured is NaN.
    Stamps are of the machine's clock since the epoch, as other bags have them.

    Args:
        joint_names: of the cell.
        folder: of the bag; it must not exist.

    Raises:
        MissingExtraError: rosbags is not installed.
        OutputError: the folder exists, or its writer does not start.
    """

    def __init__(self, joint_names: Sequence[str], folder: str | Path) -> None:
        needed("rosbags.rosbag2", "bags", "rosbags")
        self.folder = Path(folder)
        check_bag(self.folder)
        self._n = len(joint_names)
        self._closed: tuple[int, str] | None = None
        self._epoch: float | None = None
        self._ring = RowRing(1 + 2 * self._n, _SLOTS)
        settings = {"ring": self._ring.handle, "joints": list(joint_names), "folder": str(self.folder)}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "coopqp.drivers.bag_recorder", json.dumps(settings)],
            stdout=subprocess.PIPE, text=True, start_new_session=True, pass_fds=[self._ring.handle],
        )  # fmt: skip
        assert self.process.stdout is not None
        said = self.process.stdout.readline().strip()
        if said != "ready":
            self.process.kill()
            self._ring.close()
            raise OutputError(f"cannot write the bag {folder}: {said or 'its writer does not start'}.")

    def take(self, moment: float, measured: Array, sent: Array, step: ControlStep, clock: float) -> None:
        """One period."""
        row, n = self._ring.row(), self._n
        if self._epoch is None:  # the loop's clock begins anywhere
            self._epoch = time.time() - moment
        row[0], row[1 : 1 + n], row[1 + n :] = self._epoch + moment, measured, sent
        self._ring.push()

    def close(self) -> tuple[int, str]:
        """End the bag; return how many periods it does not have, and why if it is not whole. May be called twice."""
        if self._closed is None:
            self._closed = self._close()
        return self._closed

    def _close(self) -> tuple[int, str]:
        written = self._ring.written
        self._ring.end()
        try:
            said, _ = self.process.communicate(timeout=_END)
        except subprocess.TimeoutExpired:
            self.process.kill()
            said, _ = self.process.communicate()
        self._ring.close()
        try:
            report = json.loads(said.strip().splitlines()[-1])
        except (IndexError, ValueError):
            return written, "its writer was killed"
        return written - int(report["written"]), str(report["error"])


def write_rows(ring: RowRing, writer: Any, joints: Sequence[str], parent: int) -> tuple[int, str]:
    """Write rows until no more come, or who makes them is gone; return how many, and what went wrong."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    kinds, state = store.types, "sensor_msgs/msg/JointState"
    connections = [writer.add_connection(topic, state, typestore=store) for topic in _TOPICS]
    n, count, none = len(joints), 0, np.zeros(0)
    while True:
        last = ring.ended or os.getppid() != parent
        for row in ring.read():
            moment = round(1e9 * row[0])
            stamp = kinds["builtin_interfaces/msg/Time"](sec=moment // 10**9, nanosec=moment % 10**9)
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            for connection, values in zip(connections, (row[1 : 1 + n], row[1 + n :]), strict=True):
                message = kinds[state](header=header, name=list(joints), position=values, velocity=none, effort=none)
                writer.write(connection, moment, store.serialize_cdr(message, state))
            count += 1
        if last:
            return count, f"{ring.lost} came faster than they were written" if ring.lost else ""
        time.sleep(_LOOK)


def main(settings: dict[str, Any]) -> None:
    """Be the writer."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    parent, joints = os.getppid(), settings["joints"]
    ring = RowRing(1 + 2 * len(joints), _SLOTS, handle=settings["ring"])
    written, error = 0, ""
    try:
        with Writer(settings["folder"], version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            print("ready", flush=True)
            written, error = write_rows(ring, writer, joints, parent)
    except OSError as failed:
        error = failed.strerror or str(failed)
    print(json.dumps({"written": written if not error or "faster" in error else 0, "error": error}), flush=True)
    ring.close()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
