"""The driver ``ros2``: an arm behind ROS 2 topics, by Cyclone DDS (extra ``ros2``), without a ROS installation.

It reads ``sensor_msgs/JointState`` and ``geometry_msgs/WrenchStamped``, and sends ``trajectory_msgs/JointTrajectory``
or ``std_msgs/Float64MultiArray``. It is no safety function.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, final

import numpy as np

from coopqp.checks import Doc, as_options, documented, keep_scalars
from coopqp.drivers.driver import RobotState
from coopqp.drivers.process_link import ProcessDriver
from coopqp.drivers.robot_process import serve
from coopqp.drivers.ros2_domain import OneSender, Participant, check_domain, check_topic, require_cyclone, taken
from coopqp.errors import InvalidInputError
from coopqp.spatial import Array

#: Longest start of the process [s].
_START = 30.0
#: How many periods a state is waited for, and after how many a wrench is old.
_PATIENCE, _OLD = 3, 5
SendsAs = Literal["trajectory", "forward"]


@documented
@dataclass(frozen=True, kw_only=True)
class Ros2Options:
    """Settings of an arm behind ROS 2 topics."""

    command_topic: Annotated[
        str, Doc("topic of its commands, as /left_controller/joint_trajectory; has to be given")
    ] = ""
    sends: Annotated[
        SendsAs, Doc("trajectory: JointTrajectory, whose points hold at times; forward: Float64MultiArray, at once")
    ] = "trajectory"
    states_topic: Annotated[str, Doc("topic of its JointState; it may have other joints, in any order")] = (
        "/joint_states"
    )
    wrench_topic: Annotated[str, Doc("topic of its WrenchStamped, at the tool and in its axes; empty for none")] = ""
    wrench_acts_on: Annotated[
        Literal["arm", "object"], Doc("on what the measured wrench acts; a wrist sensor feels what acts on the arm")
    ] = "arm"
    joint_prefix: Annotated[str, Doc("what its joints' names have in ROS before those of the cell's model")] = ""
    period: Annotated[float, Doc("time between two states [s]")] = 0.002
    lag: Annotated[float | None, Doc("first-order lag of its joints [s]; None to learn it")] = None
    delay: Annotated[float, Doc("time until a command has its first effect, beside the lag [s]")] = 0.0
    domain: Annotated[int, Doc("ROS_DOMAIN_ID, 0 to 232")] = 0
    localhost: Annotated[bool, Doc("speak to this machine alone")] = False

    def __post_init__(self) -> None:
        keep_scalars(self, "period", high=0.02)
        keep_scalars(self, "delay", high=1.0, open_low=False)
        if self.lag is not None:
            keep_scalars(self, "lag", high=1.0, open_low=False)
        for name in ("command_topic", "states_topic", "wrench_topic"):
            check_topic(getattr(self, name), name, "Ros2Options", may_be_empty=name != "states_topic")
        check_domain(self.domain, "Ros2Options")
        for name, values in (("sends", ("trajectory", "forward")), ("wrench_acts_on", ("arm", "object"))):
            if getattr(self, name) not in values:
                raise InvalidInputError(
                    f"{name} is {getattr(self, name)!r}", "Ros2Options", f"Give {' or '.join(values)}."
                )


@final
class Ros2Driver(ProcessDriver):
    """An arm behind ROS 2 topics. A process of its own takes part in the domain.

    Args:
        joint_names: names of its joints, without the prefix.
        options: settings, or a dictionary of them.

    Raises:
        InvalidInputError: bad settings.
        MissingExtraError: cyclonedds is not installed.
    """

    def __init__(self, joint_names: Sequence[str], options: Any) -> None:
        names = tuple(joint_names)
        if not names:
            raise InvalidInputError("no joints", "Ros2Driver", "Give their names.")
        o = self.options = as_options(Ros2Options, options, "Ros2Driver: options")
        if not o.command_topic:
            raise InvalidInputError("no command_topic", "Ros2Driver", "Give the topic of the arm's commands.")
        require_cyclone()
        super().__init__(names, "coopqp.drivers.ros2", {**asdict(o), "joints": names}, start=_START)
        self.period, self.lag, self.delay = o.period, o.lag, o.delay
        joints = [o.joint_prefix + name for name in names]
        commands = [f"joint '{joint}' of {o.command_topic}" for joint in joints]
        claims = [f"joint '{joint}' of {o.states_topic}" for joint in joints]
        claims += commands if o.sends == "trajectory" else [f"the commands of {o.command_topic}"]
        claims += [f"the wrenches of {o.wrench_topic}"] if o.wrench_topic else []
        self.claims = tuple(f"{claim} in domain {o.domain}" for claim in claims)


@final
class Ros2Robot:
    """The arm in its process."""

    def __init__(self, joints: Sequence[str], options: Ros2Options) -> None:
        self._options, self.interpolates = options, options.sends == "trajectory"
        self._names = [options.joint_prefix + joint for joint in joints]
        self._sender, self._wrench_sender = OneSender("the joints of this robot"), OneSender("its wrench")
        self._last: tuple[float, Array] | None = None
        self._wrench: tuple[float, Array] | None = None

    def connect(self) -> None:
        """Take part in the domain."""
        from cyclonedds.util import duration

        from coopqp.drivers import ros2_messages as messages

        o, self._messages = self._options, messages
        participant = self._participant = Participant(o.domain, localhost=o.localhost)
        self._states = participant.reader(o.states_topic, messages.JointState)
        self._wrenches = participant.reader(o.wrench_topic, messages.WrenchStamped) if o.wrench_topic else None
        kind = messages.JointTrajectory if self.interpolates else messages.Float64MultiArray
        self._commands = participant.writer(o.command_topic, kind)
        self._waiting = participant.waiting(self._states)
        self._patience = duration(seconds=_PATIENCE * o.period)

    def read(self) -> RobotState | None:
        """The next state; None if none comes within a few periods."""
        self._waiting.wait(self._patience)
        self._read_wrench()
        newest: RobotState | None = None
        for sample in taken(self._states, self._messages.JointState):
            newest = self._state(sample) or newest
        return newest

    def _state(self, sample: Any) -> RobotState | None:
        names = list(sample.name)
        try:
            order = [names.index(name) for name in self._names]
        except ValueError:  # another robot's
            return None
        if len(sample.position) != len(names) or not self._sender.passes(sample):
            return None
        q = np.array(sample.position)[order]
        stamp = sample.header.stamp.seconds or time.monotonic()
        last, self._last = self._last, (stamp, q)
        if len(sample.velocity) == len(names):
            velocity = np.array(sample.velocity)[order]
        elif last is not None and stamp > last[0]:
            velocity = (q - last[1]) / (stamp - last[0])
        else:
            velocity = np.zeros(len(q))
        return RobotState(q, velocity, stamp, wrench=self._known_wrench())

    def _read_wrench(self) -> None:
        if self._wrenches is None:
            return
        sign = 1.0 if self._options.wrench_acts_on == "object" else -1.0
        for sample in taken(self._wrenches, self._messages.WrenchStamped):
            if not self._wrench_sender.passes(sample):
                continue
            f, t = sample.wrench.force, sample.wrench.torque
            self._wrench = time.monotonic(), sign * np.array([f.x, f.y, f.z, t.x, t.y, t.z])

    def _known_wrench(self) -> Array | None:
        """The newest wrench; NaN where it is old."""
        if self._wrenches is None:
            return None
        if self._wrench is None or time.monotonic() - self._wrench[0] > _OLD * self._options.period:
            return np.full(6, np.nan)
        return self._wrench[1]

    def send(self, q: Array) -> None:
        """Send positions that hold now (n,) [rad or m]."""
        self._commands.write(self._messages.Float64MultiArray(data=q.tolist()))

    def send_at(self, at: float, q: Array, now: float) -> None:
        """Send positions (n,) [rad or m] that hold at a time on the robot's clock [s]."""
        m = self._messages
        point = m.JointTrajectoryPoint(positions=q.tolist(), time_from_start=m.Duration(*_parts(max(at - now, 0.0))))
        header = m.Header(stamp=m.Time(*_parts(now)))
        self._commands.write(m.JointTrajectory(header=header, joint_names=self._names, points=[point]))

    def stop(self) -> None:
        """Bring it to rest: a trajectory without points; positions simply stay."""
        if self.interpolates:
            self._commands.write(self._messages.JointTrajectory(joint_names=self._names))


def _parts(seconds: float) -> tuple[int, int]:
    """Whole seconds and nanoseconds."""
    whole = math.floor(seconds)
    return whole, min(round(1e9 * (seconds - whole)), 999_999_999)


if __name__ == "__main__":
    given = json.loads(sys.argv[1])
    serve(Ros2Robot(given["joints"], Ros2Options(**{n: given[n] for n in Ros2Options.__dataclass_fields__})), given)
