"""What the loop works with: drivers that read robots and send to them, recorders, and bodies that move."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from coopqp.control.interface import ControlStep
from coopqp.errors import CoopqpError
from coopqp.spatial import Array


class DriverError(CoopqpError):
    """A robot cannot be reached or driven. The message names the robot, what is wrong and a remedy."""


class Condition(enum.Enum):
    """What a robot says of itself."""

    RUNNING = "running"  #: it follows its commands
    STOPPED = "stopped"  #: it stands, and goes on by itself or by hand: paused, or its slider is at 0
    PROTECTIVE = "protective stop"  #: its safety controller stopped it; it has to be released by hand
    FAULT = "fault"  #: it will not move again in this run


#: Conditions of a robot that does not follow its commands.
STANDS = (Condition.STOPPED, Condition.PROTECTIVE, Condition.FAULT)


@dataclass(frozen=True, eq=False, slots=True)
class RobotState:
    """A robot at one time.

    Attributes:
        q: measured joint positions (n,) in the order of the driver's joints [rad or m].
        velocity: their velocities (n,) [rad/s or m/s].
        stamp: when, on the robot's own clock [s].
        target: what the robot's own servos track now (n,) [rad or m]; None if it does not tell.
        wrench: of the arm on the object, at the tool and in its axes (6,) [N, N·m]; of several arms by name.
        scaling: share of its speed at which it runs by its own settings; 1 if it does not tell.
        condition: what it says of itself.
    """

    q: Array
    velocity: Array
    stamp: float
    target: Array | None = None
    wrench: Array | Mapping[str, Array] | None = None
    scaling: float = 1.0
    condition: Condition = Condition.RUNNING


@dataclass(frozen=True, eq=False, slots=True)
class Command:
    """Where a robot's joints should be at one time.

    Attributes:
        q: joint positions (n,) in the order of the driver's joints [rad or m].
        velocity: their velocities (n,) [rad/s or m/s].
        at: when, on the robot's own clock [s]. The robot, or its driver, interpolates.
    """

    q: Array
    velocity: Array
    at: float


class RobotDriver(Protocol):
    """One robot: an arm, or all arms of one body with their shared joints.

    Attributes:
        joint_names: names of its joints, as in the model; of a robot with several arms ``arm/joint``.
        period: time between two states [s].
        lag: time constant of its joints behind what they are sent, as a first-order lag [s]; None if it is not known,
            and then learnt.
        delay: time until a command has its first effect, beside the lag [s].
        commands: what it takes.

    A driver may have the attribute ``claims`` as well: texts that name what it alone reads or commands, as "the robot
    at 10.0.0.2". Two drivers of a cell that claim the same are refused.
    """

    joint_names: tuple[str, ...]
    period: float
    lag: float | None
    delay: float
    commands: Literal["position", "velocity"]

    def connect(self) -> None:
        """Get ready to read and to send.

        Raises:
            DriverError: it cannot; the message has the remedy.
        """
        ...

    def read(self) -> RobotState | None:
        """The newest state, None if there is none yet. It never blocks and never raises."""
        ...

    def send(self, command: Command) -> None:
        """Send a command. It never blocks."""
        ...

    def stop(self) -> None:
        """Bring the robot to rest and send nothing again; idempotent, also from a signal handler and after errors."""
        ...


class LoopRecorder(Protocol):
    """Gets what each period did."""

    def take(self, moment: float, measured: Array, sent: Array, step: ControlStep, clock: float) -> None:
        """One period. Arrays change after it: copy what is kept.

        Args:
            moment: its beginning [s].
            measured: joint positions as measured (nv,); NaN where they are missing.
            sent: commanded joint positions (nv,).
            step: the controller's last step.
            clock: the controller's clock where all arms are sent to [s].
        """
        ...


class Bodies(Protocol):
    """Bodies that move by themselves, as cameras or another program see them."""

    def read(self) -> Iterable[tuple[str, Any, Any, float]]:
        """Name, placement in the world, twist in world axes (6,) [m/s, rad/s], and stamp on the loop's clock [s].

        It never blocks and never raises.
        """
        ...
