"""The link between a driver and its robot's process, over a pair of sockets that nobody else can reach.

A robot's own library may block, start threads or end the program when its robot is gone: it runs in a process of its
own, and the loop sees a robot that is silent.
"""

from __future__ import annotations

import abc
import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Literal, final

from coopqp.drivers.driver import Command, Condition, DriverError, RobotState
from coopqp.drivers.packet_pair import PacketEnd
from coopqp.drivers.packets import ERROR, pack_command, pack_order, unpack_state

#: A robot stops when its process has got no command for this time, after the first one [s].
_SILENCE = 0.2
#: How often a process that starts is asked whether it has ended [s].
_ASKED_EVERY = 0.1


@final
class ProcessLink:
    """A process that is a robot, or speaks to one, and the socket to it.

    Args:
        module: what the process runs; it gets the settings as JSON, with the number of its end of the link as ``link``.
        settings: must be JSON.
        joints: number of the robot's joints.
    """

    def __init__(self, module: str, settings: Mapping[str, Any], joints: int) -> None:
        self._module, self._settings, self._joints = module, settings, joints
        self._link: PacketEnd | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def runs(self) -> bool:
        """Whether the process was started."""
        return self._process is not None

    def start(self, longest: float) -> None:
        """Start the process, and wait for its first state for ``longest`` [s].

        Raises:
            DriverError: the process says why not, or does not start.
        """
        self._link, theirs = PacketEnd.pair()
        settings = json.dumps({**self._settings, "silence": _SILENCE, "link": theirs.fileno()})
        # It does nothing that a threaded BLAS would help with.
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        # A session of its own: Ctrl-C in a terminal reaches the loop alone, which brakes all arms together.
        self._process = subprocess.Popen(
            [sys.executable, "-m", self._module, settings], env=environment, start_new_session=True,
            pass_fds=[theirs.fileno()],
        )  # fmt: skip
        theirs.close()
        until = time.monotonic() + longest
        ended = False  # asked ahead of the link: what it said before it ended is there
        while not self._link.waits(_ASKED_EVERY):
            if ended or time.monotonic() > until:
                break
            ended = self._process.poll() is not None
        try:
            packet = self._link.first()
        except OSError:  # nothing has come
            packet = b""
        if not packet:
            self.close()
            raise DriverError("its process does not start. Look at what it printed.")
        if packet[:1] == ERROR:
            self.close()
            raise DriverError(packet[1:].decode())

    def newest(self) -> RobotState | None:
        """The newest state that has arrived."""
        newest = None
        if self._link is None:
            return None
        with contextlib.suppress(EOFError):  # it has ended: that is seen by its silence
            for packet in self._link.packets():
                state = unpack_state(packet, self._joints)
                if state is not None and (newest is None or state.stamp > newest.stamp):
                    newest = state
        return newest

    def tell(self, packet: bytes) -> None:
        """Send a packet to the process."""
        if self._link is not None:
            self._link.send(packet)

    def kill(self) -> None:
        """End the process as a loss of power would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def finish(self, longest: float) -> None:
        """Wait for the process to end by itself, for ``longest`` [s], and end it then."""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(longest)
        self.close()

    def close(self) -> None:
        """End the process, and give its socket back."""
        self.kill()
        if self._link is not None:
            self._link.close()
        self._process = self._link = None


class ProcessDriver(abc.ABC):
    """A driver whose robot is reached by a process of its own: :func:`coopqp.drivers.robot_process.serve`.

    Args:
        joint_names: names of its joints.
        module: what the process runs.
        settings: what it gets; must be JSON.
        start: longest start of the process, the connection to the robot included [s].
    """

    commands: Literal["position", "velocity"] = "position"
    period: float
    lag: float | None
    delay: float

    def __init__(self, joint_names: Sequence[str], module: str, settings: Mapping[str, Any], *, start: float) -> None:
        self.joint_names = tuple(joint_names)
        self._link = ProcessLink(module, settings, len(self.joint_names))
        self._longest_start = start
        self._stopped = False

    def connect(self) -> None:
        """Start the robot's process, which connects to the robot, and wait for its first state.

        Raises:
            DriverError: it cannot be reached, or does not take commands; the message has the remedy.
        """
        if not self._link.runs:
            self._link.start(self._longest_start)

    def read(self) -> RobotState | None:
        """The newest state that has arrived."""
        return self._link.newest()

    def send(self, command: Command) -> None:
        """Send a command."""
        if not self._stopped:
            self._link.tell(pack_command(command.at, command.q))

    def stop(self) -> None:
        """Bring the robot to rest; nothing is sent again."""
        self._stopped = True
        self._link.tell(pack_order("halt", says=Condition.STOPPED.value))

    def kill(self) -> None:
        """End the robot's process as a loss of power would: the robot stands by its own means."""
        self._link.kill()

    def close(self) -> None:
        """Stop the robot, and end its process."""
        if self._link.runs:
            self.stop()
            self._link.tell(pack_order("end"))
            self._link.finish(2.0)
