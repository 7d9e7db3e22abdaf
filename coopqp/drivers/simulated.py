"""Robots in simulation: servos that interpolate stamped commands, lag, run at reduced speed and stop."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Literal, final

import numpy as np

from coopqp.checks import ArrayLike, as_scalar, as_vector
from coopqp.drivers.driver import Command, Condition, RobotState
from coopqp.drivers.stamped import StampedCommands
from coopqp.drivers.timing import LoopTime
from coopqp.errors import InvalidInputError
from coopqp.spatial import Array

#: Time in which a servo that was limited or stopped comes back to its commands [s].
_RELEASE = 0.1
#: Longest step of the servo [s].
_STEP = 5e-4


@final
class ServoModel:
    """Joints with one servo: it interpolates its commands, and its joints follow with a first-order lag.

    Args:
        q: where it begins, at rest (n,) [rad or m].
        lag: time constant of the joints behind the target [s].
        delay: time until a command has an effect [s].

    Attributes:
        lag, delay: as given.
        q, velocity: real positions and velocities of the joints (n,).
        target: what they follow (n,).
        condition: what the robot says of itself.
    """

    def __init__(self, q: Array, *, lag: float, delay: float, now: float = 0.0) -> None:
        self.q, self.velocity, self.target = q.copy(), np.zeros(len(q)), q.copy()
        self.condition = Condition.RUNNING
        self.now = now
        self.lag, self.delay = lag, delay
        self._commands = StampedCommands(q)
        self._speed: float | None = None
        self._halted, self._deceleration, self._speeds = False, np.inf, np.zeros(len(q))
        self._offset, self._released = np.zeros(len(q)), -np.inf

    def push(self, at: float, q: Array) -> None:
        """Take a command that holds at a time [s]; one that is older than the last is ignored."""
        self._commands.push(at, q)

    def limit(self, speed: float | None) -> None:
        """Follow commands at this speed at most (norm of the joints' velocities) [rad/s]; None without a limit."""
        if speed is None and self._speed is not None:
            self._begin_release()
        self._speed = speed

    def halt(self, *, says: Condition = Condition.RUNNING, deceleration: float = np.inf) -> None:
        """Stand from now on, and say so or not; the target stops with a deceleration [rad/s² or m/s²], or at once."""
        self._halted, self.condition, self._deceleration = True, says, deceleration

    def release(self) -> None:
        """Follow the commands again, within 0.1 s."""
        if self._halted:
            self._begin_release()
        self._halted, self.condition = False, Condition.RUNNING

    def _begin_release(self) -> None:
        self._offset, self._released = self.target - self._wanted(self.now), self.now

    def advance(self, now: float) -> None:
        """Go on to a time [s]."""
        while self.now < now - 1e-12:
            h = min(_STEP, now - self.now)
            self.now += h
            self._step(h)

    def _wanted(self, now: float) -> Array:
        return self._commands.line(now - self.delay)

    def _step(self, h: float) -> None:
        wanted = self._wanted(self.now)
        left = 1.0 - (self.now - self._released) / _RELEASE
        if left > 0.0:
            wanted = wanted + left * self._offset
        if self._halted:
            speed = float(np.abs(self._speeds).max())
            self._speeds = (
                self._speeds * max(0.0, 1.0 - self._deceleration * h / speed) if speed > 0.0 else self._speeds
            )
            self.target = self.target + h * self._speeds
        else:
            way = wanted - self.target
            length = float(np.linalg.norm(way))
            if self._speed is not None and length > self._speed * h:
                way = way * (self._speed * h / length)
            self.target = self.target + way
            self._speeds = way / h
        before = self.q
        share = 1.0 if self.lag == 0.0 else -np.expm1(-h / self.lag)
        self.q = before + share * (self.target - before)
        self.velocity = (self.q - before) / h


@final
class SimulatedRobot:
    """A robot in this process, whose time is the loop's: runs are the same each time.

    Args:
        joint_names: names of its joints.
        q: where it stands (n,) [rad or m].
        time: the loop's clock.
        period: time between two states [s].
        lag, delay: of its servo [s].
        told_lag: the lag that the driver tells, None for unknown; "lag" for the real one.
        tells_target: its states have the target.
        latency: age of a state when it arrives [s].
        clock_offset: its clock minus the loop's [s].
    """

    commands: Literal["position", "velocity"] = "position"

    def __init__(
        self,
        joint_names: Sequence[str],
        q: ArrayLike,
        *,
        time: LoopTime,
        period: float = 0.002,
        lag: float = 0.0,
        delay: float = 0.0,
        told_lag: float | Literal["lag"] | None = "lag",
        tells_target: bool = True,
        latency: float = 0.0,
        clock_offset: float = 0.0,
    ) -> None:
        self.joint_names = tuple(joint_names)
        if not self.joint_names:
            raise InvalidInputError("no joints", "SimulatedRobot", "Give their names.")
        where = "SimulatedRobot: "
        self.period = as_scalar(period, where + "period")
        real_lag = as_scalar(lag, where + "lag", open_low=False)
        self.lag = real_lag if told_lag == "lag" else told_lag
        self.delay = as_scalar(delay, where + "delay", open_low=False)
        self.latency = as_scalar(latency, where + "latency", open_low=False)
        self.servo = ServoModel(
            as_vector(q, len(self.joint_names), where + "q"), lag=real_lag, delay=self.delay, now=time.now()
        )
        self._time, self._tells, self._offset = time, tells_target, clock_offset
        self._states: deque[RobotState] = deque()
        self._next = time.now()
        self.silent = self.stopped = False

    def connect(self) -> None:
        """Nothing to do."""

    def read(self) -> RobotState | None:
        """The newest state that has arrived."""
        now, servo = self._time.now(), self.servo
        while self._next <= now + 1e-12:
            servo.advance(self._next)
            if not self.silent:
                target = servo.target if self._tells else None
                self._states.append(
                    RobotState(
                        servo.q, servo.velocity, servo.now + self._offset, target=target, condition=servo.condition
                    )
                )
            self._next += self.period
        servo.advance(now)
        arrived = now - self.latency + self._offset
        newest = None
        while self._states and self._states[0].stamp <= arrived + 1e-9:
            newest = self._states.popleft()
        return newest

    def send(self, command: Command) -> None:
        """Take a command."""
        if not self.stopped and not self.silent:
            self.servo.push(command.at - self._offset, command.q)

    def stop(self) -> None:
        """Stand."""
        self.stopped = True
        self.servo.halt(says=Condition.STOPPED)

    def kill(self) -> None:
        """As if its controller lost its power: it stands, and nothing is heard of it again."""
        self.silent = True
        self.servo.halt(says=Condition.FAULT)
