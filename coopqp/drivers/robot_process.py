"""The process of a robot: it waits for the robot's states, and sends it what the commands are at the present time."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from typing import Any, Protocol

from coopqp.drivers.driver import Condition, RobotState
from coopqp.drivers.packets import COMMAND, ORDER, pack_error, pack_state, unpack_command, unpack_order
from coopqp.drivers.stamped import StampedCommands
from coopqp.drivers.timing import ClockOffset
from coopqp.errors import CoopqpError
from coopqp.spatial import Array

#: The robot has this time to stop before its process ends [s].
_STOPPING = 1.0


class HostedRobot(Protocol):
    """A robot as its library sees it. In its own process it may block.

    Attributes:
        interpolates: it takes commands with the time at which they hold, by :meth:`send_at`; else positions that hold
            now, by :meth:`send`.
    """

    interpolates: bool

    def connect(self) -> None:
        """Get ready to read and to send.

        Raises:
            DriverError: it cannot.
        """
        ...

    def read(self) -> RobotState | None:
        """Wait for the next state, for a few periods at most; None if none came."""
        ...

    def send(self, q: Array) -> None:
        """Send positions that hold now (n,) [rad or m]."""
        ...

    def send_at(self, at: float, q: Array, now: float) -> None:
        """Send positions (n,) [rad or m] that hold at a time; that, and the present time, on the robot's clock [s]."""
        ...

    def stop(self) -> None:
        """Bring it to rest."""
        ...


def serve(robot: HostedRobot, settings: dict[str, Any]) -> None:
    """Be the robot's process until its driver is gone, is silent for too long, or says that it ends.

    Args:
        robot: the robot.
        settings: ``port`` of the driver, and ``silence``: the robot is stopped when no command has come for this time,
            after the first one [s].
    """
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    link.setblocking(False)
    driver, parent = ("127.0.0.1", settings["port"]), os.getppid()
    try:
        robot.connect()
    except CoopqpError as error:
        link.sendto(pack_error(str(error)), driver)
        return
    try:
        _serve(robot, link, driver, parent, settings["silence"])
    finally:
        # The robot's library may wait for minutes for a robot that is gone, and have threads that do not end.
        stopping = threading.Thread(target=robot.stop, daemon=True)
        stopping.start()
        stopping.join(_STOPPING)
        os._exit(0)


def _serve(
    robot: HostedRobot, link: socket.socket, driver: tuple[str, int], parent: int, longest_silence: float
) -> None:
    clock, way, heard = ClockOffset(), None, None
    stopped = False
    while os.getppid() == parent:
        state = robot.read()
        now = time.monotonic()
        if state is not None:
            clock.take(state.stamp, now)
            if way is None:
                way = StampedCommands(state.q if state.target is None else state.target)
            with contextlib.suppress(OSError):
                link.sendto(pack_state(state), driver)
        while select.select([link], [], [], 0.0)[0]:
            try:
                packet = link.recv(65536)
            except OSError:  # the driver's socket is closed
                return
            if packet[:1] == COMMAND and way is not None:
                heard = now
                at, q = unpack_command(packet)
                if not robot.interpolates:
                    way.push(at, q)
                elif not stopped:
                    robot.send_at(at, q, now - clock.offset)
            elif packet[:1] == ORDER:
                stopped = True
                if unpack_order(packet)["order"] == "end":
                    return
                robot.stop()
        if heard is not None and now - heard > longest_silence:
            return
        if heard is None or way is None or stopped or state is None or robot.interpolates:
            continue
        if state.condition is Condition.RUNNING:
            robot.send(way.at(now - clock.offset))
