"""Robots of one cell in the physics engine, in this process: they hold the object, and feel each other through it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, final

import numpy as np

from coopqp.control.interface import ControlStep, Status
from coopqp.drivers.driver import Command, Condition, RobotState
from coopqp.drivers.robots import arms_of, driven_joints
from coopqp.drivers.simulated import ServoModel
from coopqp.drivers.timing import LoopTime
from coopqp.paths.path import HoldPath
from coopqp.simulation.plants.physics import PhysicsPlant
from coopqp.spatial import Array


@final
class EngineCell:
    """A physics plant whose robots have servos with lags, driven on the loop's time.

    Args:
        plant: the plant; its arms hold the object from ``q_start`` on.
        q_start: start configuration (nq,).
        time: the loop's clock.
        period: time between two states [s].
        lags: of each robot's servo [s], an arm or all arms that share joints; one number for all.

    Attributes:
        joints: the joints of each robot, as velocity coordinates (n,), by its name.
        servos: the servo of each robot.
        forces: force of each arm on the object after each period, (arms,) [N].
        times: when [s].
    """

    def __init__(
        self, plant: PhysicsPlant, q_start: Array, *, time: LoopTime, period: float, lags: float | Sequence[float]
    ) -> None:
        self.plant, self.period, self._time = plant, period, time
        cell = plant.cell
        self._x = cell.positions(plant.reset(q_start))
        self._velocity = np.zeros(cell.nv)
        self._path = HoldPath(plant.T_world_object)
        self._wrenches = plant.measured_wrenches()
        self.now = time.now()
        self.joints = driven_joints(cell)
        each = np.broadcast_to(np.asarray(lags, dtype=float), len(self.joints))
        self.servos = [
            ServoModel(self._x[own], lag=float(lag), delay=0.0, now=self.now)
            for own, lag in zip(self.joints.values(), each, strict=True)
        ]
        self.forces: list[Array] = []
        self.times: list[float] = []

    def robots(self, *, told: bool = True) -> dict[str, EngineRobot]:
        """A driver for each robot; ``told``: it tells its lag."""
        return {name: EngineRobot(self, k, told=told) for k, name in enumerate(self.joints)}

    def advance(self) -> None:
        """Go on to the loop's time, period by period."""
        cell = self.plant.cell
        while self.now + self.period <= self._time.now() + 1e-9:
            self.now += self.period
            for servo in self.servos:
                servo.advance(self.now)
            wanted, speed = np.empty(cell.nv), np.empty(cell.nv)
            for own, servo in zip(self.joints.values(), self.servos, strict=True):
                wanted[own], speed[own] = servo.q, servo.velocity
            before = self._x
            step = self._command(before, cell.configuration_of(wanted), speed)
            self._x = cell.positions(self.plant.apply(step))
            self._velocity = (self._x - before) / self.period
            self._wrenches = self.plant.measured_wrenches()
            self.forces.append(np.linalg.norm(self._wrenches[:, :3], axis=1))
            self.times.append(self.now)

    def _command(self, x: Array, q_next: Array, velocity: Array) -> ControlStep:
        plant = self.plant
        return ControlStep(
            cell=plant.cell, grasp=plant.grasp, path=self._path, q=plant.cell.configuration_of(x), velocity=velocity,
            q_next=q_next, dt=self.period, clock=0.0, clock_next=0.0, rate=1.0, status=Status.TRACKING,
        )  # fmt: skip

    def state(self, k: int) -> RobotState:
        """State of a robot at :attr:`now`, with the wrench of each of its arms."""
        cell, servo = self.plant.cell, self.servos[k]
        own = list(self.joints.values())[k]
        wrenches = {arm: self._wrenches[cell.index(arm)] for arm in arms_of(cell, own)}
        return RobotState(
            self._x[own], self._velocity[own], self.now, target=servo.target, wrench=wrenches,
            condition=servo.condition,
        )  # fmt: skip


@final
class EngineRobot:
    """The driver of a robot of an :class:`EngineCell`."""

    commands: Literal["position", "velocity"] = "position"
    delay = 0.0

    def __init__(self, cell: EngineCell, k: int, *, told: bool) -> None:
        whole = cell.plant.cell
        self._cell, self._k = cell, k
        self.joint_names = tuple(whole.joint_names[j] for j in list(cell.joints.values())[k])
        self.period = cell.period
        self.servo = cell.servos[k]
        self.lag: float | None = self.servo.lag if told else None
        self._last = -np.inf

    def connect(self) -> None:
        """Nothing to do."""

    def read(self) -> RobotState | None:
        """The newest state."""
        self._cell.advance()
        if self._cell.now <= self._last:
            return None
        self._last = self._cell.now
        return self._cell.state(self._k)

    def send(self, command: Command) -> None:
        """Take a command."""
        self.servo.push(command.at, command.q)

    def stop(self) -> None:
        """Stand."""
        self.servo.halt(says=Condition.STOPPED)
