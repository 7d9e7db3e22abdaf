"""The driver ``franka``: a robot of Franka Robotics over its control interface, by pylibfranka (extra ``franka``).

Nothing here was run on a real robot; the tests drive the robots of franky-sim. It is no safety function.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, final

import numpy as np

from coopqp.checks import Doc, as_options, documented, keep_scalars
from coopqp.drivers.driver import Condition, DriverError, RobotState
from coopqp.drivers.process_link import ProcessDriver
from coopqp.drivers.robot_process import serve
from coopqp.errors import InvalidInputError
from coopqp.lazy import needed
from coopqp.spatial import Array

#: Joints of every robot of this maker.
_JOINTS = 7
#: Longest start of the process [s].
_START = 60.0
#: Time between two states of the robot [s].
_PERIOD = 0.001


@documented
@dataclass(frozen=True, kw_only=True)
class FrankaOptions:
    """Settings of a robot of Franka Robotics."""

    address: Annotated[str, Doc("address of the robot; has to be given")] = ""
    gain: Annotated[
        float, Doc("velocity that is added for each radian by which its target is behind its commands [1/s]")
    ] = 20.0
    lag: Annotated[float | None, Doc("first-order lag of its joints [s]; None to learn it")] = 0.0
    delay: Annotated[float, Doc("time until a command has its first effect, beside the lag [s]")] = 0.0
    enforces_realtime: Annotated[bool, Doc("refuse a kernel that is not a real-time one")] = True
    stamps_arrival: Annotated[
        bool, Doc("states are stamped when they arrive: for simulators, whose clocks may be slower than real time")
    ] = False
    tells_wrench: Annotated[
        bool,
        Doc("the states have the robot's estimate of the force at its stiffness frame K, which has to be the tool"),
    ] = False

    def __post_init__(self) -> None:
        if not isinstance(self.address, str):
            raise InvalidInputError("address is no text", "FrankaOptions", "Give that of the robot.")
        keep_scalars(self, "gain", high=100.0)
        keep_scalars(self, "delay", high=1.0, open_low=False)
        if self.lag is not None:
            keep_scalars(self, "lag", high=1.0, open_low=False)


@final
class FrankaDriver(ProcessDriver):
    """A robot of Franka Robotics. A process of its own answers each of its states, at 1 kHz, with joint velocities.

    Args:
        joint_names: names of its seven joints, from the base on.
        options: settings, or a dictionary of them.

    Raises:
        InvalidInputError: bad settings, or not seven joints.
        MissingExtraError: pylibfranka is not installed.
    """

    def __init__(self, joint_names: Sequence[str], options: Any) -> None:
        names = tuple(joint_names)
        if len(names) != _JOINTS:
            raise InvalidInputError(f"{len(names)} joints", "FrankaDriver", f"Give the names of {_JOINTS}.")
        o = self.options = as_options(FrankaOptions, options, "FrankaDriver: options")
        if not o.address:
            raise InvalidInputError("no address", "FrankaDriver", "Give that of the robot.")
        needed("pylibfranka", "franka", "pylibfranka")
        super().__init__(names, "coopqp.drivers.franka", asdict(o), start=_START)
        self.claims = (f"the robot at {o.address}",)
        # A velocity has moved the target by the next state.
        self.period, self.lag, self.delay = _PERIOD, o.lag, o.delay + _PERIOD


@final
class FrankaRobot:
    """The robot in its process, by pylibfranka."""

    interpolates = False

    def __init__(self, options: FrankaOptions) -> None:
        self._options = options
        self._library = needed("pylibfranka", "franka", "pylibfranka")
        self._robot: Any = None
        self._control: Any = None
        #: What it was sent last, and the time of the state that this answered [s].
        self._sent: tuple[float, Array] | None = None
        self._newest: Any = None
        self._answered, self._failed = True, False

    def connect(self) -> None:
        """Reach the robot, and begin to answer it: it stays where it is.

        Raises:
            DriverError: it cannot be reached, or does not take commands.
        """
        library, o = self._library, self._options
        kernel = library.RealtimeConfig.kEnforce if o.enforces_realtime else library.RealtimeConfig.kIgnore
        try:
            self._robot = library.Robot(o.address, kernel)
            self._control = self._robot.start_joint_velocity_control(library.ControllerMode.JointImpedance)
        except Exception as error:
            raise DriverError(
                f"the robot at {o.address} cannot be driven: {error}. Look at its address, unlock its joints, activate "
                "FCI and let go of its buttons."
            ) from error

    def read(self) -> RobotState | None:
        """Wait for the next state, after an answer to the last one."""
        if self._failed:
            time.sleep(_PERIOD)
            return None
        try:
            if not self._answered:
                self._answer(np.zeros(_JOINTS))
            state, _ = self._control.readOnce()
        except Exception as error:  # a reflex, a user stop, or the robot is gone: its motion is at its end
            print(f"franka: {error}", file=sys.stderr)
            self._failed = True
            return self._fault()
        self._newest, self._answered = state, False
        return self._state(state, _condition(state.robot_mode, self._library.RobotMode))

    def _state(self, state: Any, condition: Condition) -> RobotState:
        wrench = -np.array(state.K_F_ext_hat_K) if self._options.tells_wrench else None  # told: what acts on the robot
        stamp = time.monotonic() if self._options.stamps_arrival else state.time.to_sec()
        return RobotState(
            np.array(state.q), np.array(state.dq), stamp, target=np.array(state.q_d), wrench=wrench,
            condition=condition,
        )  # fmt: skip

    def _fault(self) -> RobotState | None:
        """The last state once more, as that of a robot that will not move again."""
        newest = self._newest
        if newest is None:
            return None
        state = self._state(newest, Condition.FAULT)
        return RobotState(state.q, np.zeros(_JOINTS), state.stamp + _PERIOD, target=state.target,
                          wrench=state.wrench, condition=Condition.FAULT)  # fmt: skip

    def send(self, q: Array) -> None:
        """Answer the last state, so that the robot's target comes to positions (7,) [rad].

        The gain acts on the target, not on what is measured: that has noise, and hangs below it under a load.
        """
        state = self._newest
        moment, target = state.time.to_sec(), np.array(state.q_d)
        before, last = (moment - _PERIOD, q) if self._sent is None else self._sent
        self._sent = moment, q
        self._answer((q - last) / max(moment - before, _PERIOD) + self._options.gain * (last - target))

    def send_at(self, at: float, q: Array, now: float) -> None:
        """Not used: the robot's commands have no time."""
        raise NotImplementedError

    def _answer(self, velocity: Array) -> None:
        """Answer the last state with joint velocities (7,) [rad/s]."""
        self._control.writeOnce(self._library.JointVelocities(velocity.tolist()))
        self._answered = True

    def stop(self) -> None:
        """End the motion: the robot brakes by itself."""
        if self._robot is not None:
            self._failed = True
            self._robot.stop()


def _condition(mode: Any, modes: Any) -> Condition:
    """What the robot says by its mode."""
    if mode == modes.Reflex:
        return Condition.PROTECTIVE
    if mode in (modes.UserStopped, modes.Guiding):
        return Condition.STOPPED
    return Condition.RUNNING


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    serve(FrankaRobot(FrankaOptions(**{n: given[n] for n in FrankaOptions.__dataclass_fields__})), given)
