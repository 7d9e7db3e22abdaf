"""The process of a robot: it waits for the robot's states, and sends it what the commands are at the present time."""

from __future__ import annotations

import os
import threading
import time
from typing import Any, Protocol

from coopqp.drivers.driver import Condition, RobotState
from coopqp.drivers.packet_pair import PacketEnd
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
        settings: number of the process's end of its ``link``, and ``silence``: the robot is stopped when no command
            has come for this time, after the first one [s].
    """
    link, parent = PacketEnd.inherited(settings["link"]), os.getppid()
    try:
        robot.connect()
    except CoopqpError as error:
        link.send(pack_error(str(error)))
        return
    try:
        _serve(robot, link, parent, settings["silence"])
    except EOFError:  # the driver has closed the link
        pass
    finally:
        # The robot's library may wait for minutes for a robot that is gone, and have threads that do not end.
        stopping = threading.Thread(target=robot.stop, daemon=True)
        stopping.start()
        stopping.join(_STOPPING)
        os._exit(0)


def _serve(robot: HostedRobot, link: PacketEnd, parent: int, longest_silence: float) -> None:
    clock, way, heard = ClockOffset(), None, None
    stopped = False
    while os.getppid() == parent:
        state = robot.read()
        now = time.monotonic()
        if state is not None:
            clock.take(state.stamp, now)
            if way is None:
                way = StampedCommands(state.q if state.target is None else state.target)
            link.send(pack_state(state))
        for packet in link.packets():
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
            robot.send(way.at(state.stamp))  # not at the present time, which jitters
