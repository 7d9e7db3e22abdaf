"""What a control loop tells other ROS 2 nodes, and the targets that they give it (extra ``ros2``).

It tells its status (``diagnostic_msgs/DiagnosticArray``) and the object's pose (``geometry_msgs/PoseStamped``), and
takes poses of a hand, a tracker or a policy (``PoseStamped``). A process of its own takes part in the domain: the loop
only copies numbers into shared memory. It is no safety function.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, as_options, documented
from coopqp.control.interface import ControlStep, Status
from coopqp.control.operator.hands import HAND_SILENCE
from coopqp.drivers.ring import RowRing
from coopqp.drivers.ros2_domain import OneSender, Participant, check_domain, check_topic, require_cyclone, taken
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.drivers.loop import ControlLoop

#: Rows of the ring: at 30 a second the process may be away for 2 s. How often it looks [s].
_SLOTS, _LOOK = 64, 0.005
#: Statuses and poses are told so often [1/s].
_RATE = 30.0
#: Numbers of a row: the object's pose (x, y, z and a quaternion), and in what follows the status as JSON.
_POSE, _TEXT, _WIDTH = slice(0, 7), 7, 7 + 256
#: Longest start and end of the process [s].
_START, _END = 30.0, 3.0
_LEVELS = {Status.HOLDING: 1, Status.BLOCKED: 1, Status.OFF_PATH: 1, Status.FAULT: 2}


@documented
@dataclass(frozen=True, kw_only=True)
class Ros2BoardOptions:
    """Topics of a control loop."""

    status_topic: Annotated[str, Doc("topic of its status, a DiagnosticArray; empty for none")] = "/diagnostics"
    object_topic: Annotated[str, Doc("topic of the object's commanded pose, a PoseStamped; empty for none")] = (
        "/coopqp/object_pose"
    )
    target_topic: Annotated[str, Doc("topic of a hand's PoseStamped that the object follows; empty for none")] = ""
    frame: Annotated[str, Doc("frame_id of the cell's world; targets in another frame are ignored")] = "world"
    domain: Annotated[int, Doc("ROS_DOMAIN_ID, 0 to 232")] = 0
    localhost: Annotated[bool, Doc("speak to this machine alone")] = False

    def __post_init__(self) -> None:
        for name in ("status_topic", "object_topic", "target_topic"):
            check_topic(getattr(self, name), name, "Ros2BoardOptions", may_be_empty=True)
        check_domain(self.domain, "Ros2BoardOptions")
        if not isinstance(self.frame, str) or not self.frame:
            raise InvalidInputError(f"frame is {self.frame!r}", "Ros2BoardOptions", "Give the frame_id of the world.")


@final
class Ros2Board:
    """Tells the steps of a loop over ROS 2, and gives it the targets that come.

    The object follows a hand relatively: with the first target after a silence of 0.25 s it does not leap, and from
    then on it moves as the targets do. In silence it pauses.

    Args:
        loop: the loop; :meth:`observe` has to get its steps.
        name: of the cell, as statuses say it.
        options: settings, or a dictionary of them.

    Attributes:
        targets: number of targets that were taken.

    Raises:
        InvalidInputError: bad settings.
        MissingExtraError: cyclonedds is not installed.
        CoopqpError: the process does not start.
    """

    def __init__(self, loop: ControlLoop, name: str, options: Any = None) -> None:
        o = self.options = as_options(Ros2BoardOptions, options, "Ros2Board: options")
        require_cyclone()
        self._loop, self.targets = loop, 0
        self._due, self._heard = -math.inf, -math.inf
        self._ring = RowRing(_WIDTH, _SLOTS)
        settings = {**asdict(o), "ring": self._ring.handle, "name": name}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "coopqp.drivers.ros2_board", json.dumps(settings)],
            stdout=subprocess.PIPE, text=True, start_new_session=True, pass_fds=[self._ring.handle],
        )  # fmt: skip
        said = self._first_line()
        if said != "ready":
            self._process.kill()
            self._ring.close()
            raise CoopqpError(f"ROS 2: {said or 'its process does not start'}.")
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _first_line(self) -> str:
        assert self._process.stdout is not None
        late = threading.Timer(_START, self._process.kill)
        late.start()
        said = self._process.stdout.readline().strip()
        late.cancel()
        return said

    def observe(self, step: ControlStep) -> None:
        """Tell a step, 30 times a second."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + 1.0 / _RATE
        values = {
            "status": step.status.value, "clock": f"{step.clock_next:.3f}", "rate": f"{step.rate:.4f}",
            "cause": "" if step.cause is None else step.cause.value,
        }  # fmt: skip
        said = {"level": _LEVELS.get(step.status, 0), "message": step.explain()[:1000], "values": values}
        row = self._ring.row()
        row[_POSE] = pin.SE3ToXYZQUAT(self._loop.controller.grasp.carried(step.state)[0])
        _write(row[_TEXT:], said)
        self._ring.push()

    def _listen(self) -> None:
        """Give the loop the targets: lines of seven numbers."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            T = pin.XYZQUATToSE3(np.array(json.loads(line)))
            now = time.monotonic()
            call = self._loop.target if now - self._heard < HAND_SILENCE else self._loop.engage
            self._heard = now
            call(T)
            self.targets += 1

    def close(self) -> None:
        """End the process."""
        self._ring.end()
        try:
            self._process.wait(_END)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join(_END)
        self._ring.close()


def _write(row: Array, said: dict[str, Any]) -> None:
    """Write a value into numbers, as JSON that ends with a zero."""
    text, room = json.dumps(said).encode(), row.view(np.uint8)
    if len(text) >= len(room):
        text = json.dumps({**said, "message": said["message"][:200]}).encode()
    room[: len(text)], room[len(text)] = np.frombuffer(text, np.uint8), 0


def _read(row: Array) -> dict[str, Any]:
    """What :func:`_write` wrote."""
    found: dict[str, Any] = json.loads(row.tobytes().partition(b"\0")[0])
    return found


@final
class _Board:
    """The process that takes part in the domain."""

    def __init__(self, name: str, options: Ros2BoardOptions) -> None:
        from coopqp.drivers import ros2_messages as messages

        o, self._messages, self._name = options, messages, name
        self._frame, self._told = o.frame, False
        self._hand = OneSender("targets", silence=HAND_SILENCE)
        participant = self._participant = Participant(o.domain, localhost=o.localhost)
        self._status = participant.writer(o.status_topic, messages.DiagnosticArray) if o.status_topic else None
        self._object = participant.writer(o.object_topic, messages.PoseStamped) if o.object_topic else None
        self._targets = participant.reader(o.target_topic, messages.PoseStamped) if o.target_topic else None

    def tell(self, row: Array) -> None:
        """Publish a row of the ring."""
        m, now = self._messages, time.time()
        stamp = m.Time(math.floor(now), int(1e9 * (now % 1.0)))
        if self._object is not None:
            x, y, z, *turn = row[_POSE].tolist()
            pose = m.Pose(m.Point(x, y, z), m.Quaternion(*turn))
            self._object.write(m.PoseStamped(m.Header(stamp, self._frame), pose))
        if self._status is not None:
            said = _read(row[_TEXT:])
            values = [m.KeyValue(key, value) for key, value in said["values"].items()]
            part = m.DiagnosticStatus(
                said["level"], f"coopqp: {self._name}", said["message"], hardware_id="", values=values
            )
            self._status.write(m.DiagnosticArray(m.Header(stamp), [part]))

    def newest_target(self) -> list[float] | None:
        """The newest target in the world, as x, y, z and a unit quaternion; None if none came."""
        found = None
        for sample in [] if self._targets is None else taken(self._targets, self._messages.PoseStamped):
            if sample.header.frame_id.lstrip("/") != self._frame.lstrip("/"):
                if not self._told:
                    self._told = True
                    text = f"ROS 2: targets in frame '{sample.header.frame_id}' are ignored; frame is '{self._frame}'"
                    print(text, file=sys.stderr, flush=True)
                continue
            if not self._hand.passes(sample):
                continue
            p, r = sample.pose.position, sample.pose.orientation
            turn = np.array([r.x, r.y, r.z, r.w])
            numbers = np.array([p.x, p.y, p.z, *turn / max(float(np.linalg.norm(turn)), 1e-12)])
            if np.isfinite(numbers).all() and np.linalg.norm(numbers[3:]) > 0.5:
                found = numbers.tolist()
        return found


def _serve(ring: RowRing, board: _Board, parent: int) -> None:
    """Tell the newest rows and pass on targets, until no more rows come or who makes them is gone."""
    while not ring.ended and os.getppid() == parent:
        rows = ring.read()
        if len(rows):
            board.tell(rows[-1])
        target = board.newest_target()
        if target is not None:
            print(json.dumps(target), flush=True)
        time.sleep(_LOOK)


def main(settings: dict[str, Any]) -> None:
    """Be the process."""
    ring = RowRing(_WIDTH, _SLOTS, handle=settings.pop("ring"))
    board = _Board(settings.pop("name"), Ros2BoardOptions(**settings))
    print("ready", flush=True)
    _serve(ring, board, os.getppid())
    ring.close()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
