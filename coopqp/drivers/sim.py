"""The driver ``sim``: a simulated robot in a process of its own, over the loopback network."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, final

from coopqp.checks import ArrayLike, Doc, as_options, as_vector, documented, keep_scalars
from coopqp.drivers.driver import Command, Condition, DriverError, RobotState
from coopqp.drivers.packets import pack_command, pack_order, unpack_state
from coopqp.errors import InvalidInputError

#: Longest start of the robot's process [s].
_START = 30.0


@documented
@dataclass(frozen=True, kw_only=True)
class SimOptions:
    """Settings of a simulated robot and of its link."""

    period: Annotated[float, Doc("time between two states [s]")] = 0.002
    lag: Annotated[float, Doc("first-order lag of its joints [s]")] = 0.01
    delay: Annotated[float, Doc("time until a command has an effect, beside the lag [s]")] = 0.0
    tells_lag: Annotated[bool, Doc("the driver tells the lag; else the loop learns it")] = True
    tells_target: Annotated[bool, Doc("the robot tells what its servos track")] = True
    latency: Annotated[float, Doc("least age of a packet when it arrives [s]")] = 0.0
    jitter: Annotated[float, Doc("largest further age of a packet [s]")] = 0.0
    loss: Annotated[float, Doc("share of the packets that never arrive")] = 0.0
    clock_offset: Annotated[float, Doc("what its clock shows when its process begins [s]")] = 0.0
    seed: Annotated[int, Doc("seed of jitter and losses")] = 0

    def __post_init__(self) -> None:
        keep_scalars(self, "period", high=1.0)
        keep_scalars(self, "lag", "delay", "latency", "jitter", high=1.0, open_low=False)
        keep_scalars(self, "loss", high=0.9, open_low=False)


@final
class SimDriver:
    """A simulated robot. Its process begins with :meth:`connect` and ends with :meth:`close`, or with this program.

    Args:
        joint_names: names of its joints.
        q: where it stands (n,) [rad or m].
        options: settings, or a dictionary of them.
    """

    commands: Literal["position", "velocity"] = "position"

    def __init__(self, joint_names: Sequence[str], q: ArrayLike, options: Any = None) -> None:
        self.joint_names = tuple(joint_names)
        if not self.joint_names:
            raise InvalidInputError("no joints", "SimDriver", "Give their names.")
        self.options = as_options(SimOptions, options, "SimDriver: options")
        self._q = as_vector(q, len(self.joint_names), "SimDriver: q")
        self.period, self.delay = self.options.period, self.options.delay
        self.lag: float | None = self.options.lag if self.options.tells_lag else None
        self._link: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._robot: tuple[str, int] | None = None
        self._stopped = False

    def connect(self) -> None:
        """Start the robot's process and wait for its first state.

        Raises:
            DriverError: it does not start.
        """
        if self._process is not None:
            return
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.bind(("127.0.0.1", 0))
        self._link.setblocking(False)
        o = self.options
        settings = {name: getattr(o, name) for name in o.__dataclass_fields__}
        settings |= {"q": self._q.tolist(), "port": self._link.getsockname()[1]}
        # It does nothing that a threaded BLAS would help with.
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "coopqp.drivers.sim_process", json.dumps(settings)], env=environment
        )
        if not select.select([self._link], [], [], _START)[0]:
            self.close()
            raise DriverError("the simulated robot does not start. Look at what its process printed.")

    def read(self) -> RobotState | None:
        """The newest state that has arrived."""
        link, newest = self._link, None
        if link is None:
            return None
        with contextlib.suppress(OSError):  # nothing more has come
            while True:
                packet, self._robot = link.recvfrom(65536)
                state = unpack_state(packet, len(self.joint_names))
                if state is not None and (newest is None or state.stamp > newest.stamp):
                    newest = state
        return newest

    def _tell(self, packet: bytes) -> None:
        if self._link is not None and self._robot is not None:
            with contextlib.suppress(OSError):  # it is gone: that is seen by its silence
                self._link.sendto(packet, self._robot)

    def send(self, command: Command) -> None:
        """Send a command."""
        if not self._stopped:
            self._tell(pack_command(command.at, command.q))

    def stop(self) -> None:
        """Have the robot stand."""
        self._stopped = True
        self._tell(pack_order("halt", says=Condition.STOPPED.value))

    # -- what may happen to a robot --------------------------------------------------------------------------------

    def halt(self, *, says: Condition = Condition.RUNNING) -> None:
        """The robot stands from now on, and says so or not."""
        self._tell(pack_order("halt", says=says.value))

    def release(self) -> None:
        """The robot follows its commands again."""
        self._tell(pack_order("release"))

    def limit(self, speed: float | None) -> None:
        """The robot moves at this speed at most (norm of the joints' velocities) [rad/s]; None without a limit."""
        self._tell(pack_order("limit", speed=speed))

    def kill(self) -> None:
        """End the robot's process as a loss of power would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def close(self) -> None:
        """End the robot's process, and give its socket back."""
        self.kill()
        if self._link is not None:
            self._link.close()
        self._process = self._link = None
