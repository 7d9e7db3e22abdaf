"""The driver ``ur``: a robot of Universal Robots over RTDE, by the package ur_rtde (extra ``ur``).

Nothing here was run on a real robot; the tests drive a stand-in that speaks RTDE. It is no safety function.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, as_options, documented, keep_scalars
from coopqp.drivers.driver import Condition, DriverError, RobotState
from coopqp.drivers.process_link import ProcessDriver
from coopqp.drivers.robot_process import serve
from coopqp.errors import InvalidInputError
from coopqp.lazy import needed
from coopqp.spatial import Array

#: Joints of every robot of this maker.
_JOINTS = 6
#: What is asked for of the robot.
_VARIABLES = (
    "timestamp", "actual_q", "actual_qd", "target_q", "speed_scaling", "target_speed_fraction", "safety_mode",
    "safety_status_bits", "robot_status_bits", "runtime_state", "robot_mode", "actual_TCP_pose", "actual_TCP_force",
)  # fmt: skip
#: Safety modes that let it move, and those that it comes back from: protective stop; safeguard stop.
_SAFE, _PROTECTIVE, _SAFEGUARD = (1, 2), 3, 5
#: Runtime states of its program: playing; pausing, paused and resuming.
_PLAYING, _PAUSED = 2, (3, 4, 5)
_MODULES = ("rtde_receive", "rtde_control")
#: Longest start of the process, with the program on the robot [s].
_START = 60.0
#: Longest time until the robot's states tell that the program runs [s].
_PROGRAM = 1.0
#: How many periods a state is waited for, and how often it is looked for [s].
_PATIENCE, _POLL = 3, 5e-4


@documented
@dataclass(frozen=True, kw_only=True)
class UrOptions:
    """Settings of a robot of Universal Robots."""

    address: Annotated[str, Doc("address of the robot's controller; has to be given")] = ""
    period: Annotated[float, Doc("time between two states [s]; 0.002 for the e-series, 0.008 before")] = 0.002
    lookahead: Annotated[float, Doc("lookahead_time of servoJ, by about which the joints lag [s], 0.03 to 0.2")] = 0.03
    gain: Annotated[float, Doc("gain of servoJ, 100 to 2000")] = 300.0
    delay: Annotated[float, Doc("time until a command has its first effect, beside the lag [s]")] = 0.0
    tells_lag: Annotated[bool, Doc("the driver tells the lookahead as its lag; else the loop learns the lag")] = True
    tells_wrench: Annotated[
        bool, Doc("the states have the force at the robot's TCP, which has to be set to the tool of the cell")
    ] = False

    def __post_init__(self) -> None:
        if not isinstance(self.address, str):
            raise InvalidInputError("address is no text", "UrOptions", "Give that of the robot's controller.")
        keep_scalars(self, "period", high=0.02)
        keep_scalars(self, "delay", high=1.0, open_low=False)
        keep_scalars(self, "lookahead", "gain")
        for name, low, high in (("lookahead", 0.03, 0.2), ("gain", 100.0, 2000.0)):
            if not low <= getattr(self, name) <= high:
                raise InvalidInputError(
                    f"{name} is {getattr(self, name):g}", "UrOptions", f"Give a number from {low:g} to {high:g}."
                )


@final
class UrDriver(ProcessDriver):
    """A robot of Universal Robots. A process of its own sends it the program of ur_rtde, which follows the commands.

    Args:
        joint_names: names of its six joints, from the base on.
        options: settings, or a dictionary of them.

    Raises:
        InvalidInputError: bad settings, or not six joints.
        MissingExtraError: ur_rtde is not installed.
    """

    def __init__(self, joint_names: Sequence[str], options: Any) -> None:
        names = tuple(joint_names)
        if len(names) != _JOINTS:
            raise InvalidInputError(f"{len(names)} joints", "UrDriver", f"Give the names of {_JOINTS}.")
        o = self.options = as_options(UrOptions, options, "UrDriver: options")
        if not o.address:
            raise InvalidInputError("no address", "UrDriver", "Give that of the robot's controller.")
        for module in _MODULES:
            needed(module, "ur", "ur_rtde")
        super().__init__(names, "coopqp.drivers.ur", asdict(o), start=_START)
        self.claims = (f"the robot at {o.address}",)
        self.period, self.delay = o.period, o.delay
        self.lag: float | None = o.lookahead if o.tells_lag else None


@final
class UrRobot:
    """The robot in its process, by ur_rtde."""

    interpolates = False

    def __init__(self, options: UrOptions) -> None:
        self._options = options
        self._receiving, self._controlling = (needed(module, "ur", "ur_rtde") for module in _MODULES)
        self._states: Any = None
        self._control: Any = None
        self._stamp = -np.inf

    def connect(self) -> None:
        """Reach the robot, and start the program on it that follows the commands.

        Raises:
            DriverError: it cannot be reached, or does not run programs from outside.
        """
        o = self._options
        try:
            self._states = self._receiving.RTDEReceiveInterface(o.address, 1.0 / o.period, list(_VARIABLES))
            self._control = self._controlling.RTDEControlInterface(o.address, 1.0 / o.period)
        except Exception as error:  # the library raises RuntimeError and others
            raise DriverError(
                f"the robot at {o.address} cannot be driven: {error}. Look at its address, switch it on, release its "
                "brakes, and set it to remote control."
            ) from error
        until = time.monotonic() + _PROGRAM  # its states tell a little later that the program runs
        while self._states.getRuntimeState() != _PLAYING and time.monotonic() < until:
            time.sleep(_POLL)

    def read(self) -> RobotState | None:
        """The next state; None if none comes within a few periods."""
        until = time.monotonic() + _PATIENCE * self._options.period
        while time.monotonic() < until:
            if self._states.getTimestamp() > max(self._stamp, 0.0):
                return self._state()
            time.sleep(_POLL)
        return None

    def _state(self) -> RobotState | None:
        states = self._states
        for _ in range(3):  # the values are read one by one, and another packet may come between
            stamp = states.getTimestamp()
            q, velocity, target = (
                np.array(value) for value in (states.getActualQ(), states.getActualQd(), states.getTargetQ())
            )
            fraction = states.getTargetSpeedFraction()
            scaling = states.getSpeedScaling() * fraction
            condition = condition_of(states.getSafetyMode(), states.getRuntimeState(), fraction)
            wrench = self._wrench() if self._options.tells_wrench else None
            if states.getTimestamp() == stamp:
                break
        self._stamp = stamp
        return RobotState(q, velocity, stamp, target=target, wrench=wrench, scaling=scaling, condition=condition)

    def _wrench(self) -> Array:
        """Of the arm on the object, at the TCP and in its axes; the robot tells what acts on it, in its base's axes."""
        R_base_tool = pin.exp3(np.array(self._states.getActualTCPPose()[3:]))
        acts = np.array(self._states.getActualTCPForce()).reshape(2, 3)
        return -(acts @ R_base_tool).ravel()

    def send(self, q: Array) -> None:
        """Send positions that hold now (6,) [rad]."""
        o = self._options
        self._control.servoJ(q.tolist(), 0.0, 0.0, o.period, o.lookahead, o.gain)

    def send_at(self, at: float, q: Array, now: float) -> None:
        """Not used: ``servoJ`` takes no time."""
        raise NotImplementedError

    def stop(self) -> None:
        """Bring the robot to rest, and end the program on it."""
        if self._control is not None and self._control.isProgramRunning():
            self._control.servoStop()
            self._control.stopScript()


def condition_of(safety: int, runtime: int, fraction: float) -> Condition:
    """What the robot says: its safety mode, its program's state, and its slider."""
    if safety == _PROTECTIVE:
        return Condition.PROTECTIVE
    if safety == _SAFEGUARD:
        return Condition.STOPPED
    if safety not in _SAFE:
        return Condition.FAULT
    if runtime in _PAUSED or fraction <= 0.0:
        return Condition.STOPPED
    return Condition.RUNNING if runtime == _PLAYING else Condition.FAULT


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    serve(UrRobot(UrOptions(**{name: given[name] for name in UrOptions.__dataclass_fields__})), given)
