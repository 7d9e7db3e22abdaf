"""The plant protocol, and kinematic plants: the ideal one, and one with disturbances.

The disturbances: noisy, late and lost signals; arms that lag, stall or have displaced bases. The plant distinguishes
the *true* configuration from the *measured* one. Only the commands hold the arms together:
:meth:`DisturbedPlant.chain_error` is the error that a grip would have to absorb. (A rigid grip holds the arms together
and turns this error into stress. The physics plant simulates it with the same :class:`Disturbances`.)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, Protocol, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_options, as_scalar, read_only, require
from coopqp.control.interface import ControlStep
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.simulation.evaluation.metrics import chain_error
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.simulation.plants.sensors import Encoders
from coopqp.spatial import Array


class Plant(Protocol):
    """The protocol of the plants of :func:`coopqp.simulate`."""

    def reset(self, q: ArrayLike) -> Array:
        """Put the cell at rest at ``q`` (nq,). Returns the measured configuration (nq,)."""
        ...

    def apply(self, step: ControlStep) -> Array:
        """Execute a command for its ``dt``. Returns the measured configuration (nq,) at the end."""
        ...


@final
class KinematicPlant:
    """Joints that follow their commands exactly. They hold nothing: ``gripped`` is False."""

    gripped = False

    def __init__(self, cell: RobotCell) -> None:
        require(cell, RobotCell, "KinematicPlant: cell", "Give a RobotCell.")
        self.cell = cell
        self.q: Array = cell.configuration([0.0] * cell.nv)

    def reset(self, q: ArrayLike) -> Array:
        """Put the cell at ``q`` (nq,)."""
        self.q = self.cell.check_configuration(q, "KinematicPlant.reset")
        return self.q

    def apply(self, step: ControlStep) -> Array:
        """Move the joints to ``step.q_next``."""
        self.q = step.q_next
        return self.q


@final
class DisturbedPlant:
    """Joints that follow their commands under :class:`Disturbances`.

    The grip closes at reset, at the true placements of the tools.

    Args:
        cell: the cell as the controller knows it.
        grasp: the intended grasp; it defines the object frame.
        disturbances: deviations from the ideal plant.
        command_latency: delay of the commands [s], by arm.

    Attributes:
        gripped: False: nothing but the commands holds the arms together.
        q: true configuration (nq,).
        time: time since the reset [s].

    Raises:
        UnknownNameError: a disturbance names an arm that is not in the cell.
    """

    gripped = False

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        disturbances: Disturbances | Mapping[str, Any] | None = None,
        *,
        command_latency: Mapping[str, float] | None = None,
    ) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp = cell, grasp
        d = self.disturbances = as_options(Disturbances, disturbances, "DisturbedPlant: disturbances")
        self._lag = {cell.index(arm): tau for arm, tau in d.lag.items() if tau > 0.0}
        self._stall = {cell.index(arm): time for arm, time in d.stall.items()}
        self._late = {
            cell.index(arm): as_scalar(delay, f"DisturbedPlant: command_latency['{arm}']", open_low=False)
            for arm, delay in (command_latency or {}).items()
        }
        self._displaced = [pin.SE3.Identity() for _ in cell.arms]  # in the world
        for arm, offset in d.base_offsets(cell).items():
            k = cell.index(arm)
            base = cell.arms[k].T_world_base
            for on_it in next((group for group in cell.groups if k in group), (k,)):
                self._displaced[on_it] = base * offset * base.inverse()
        self._data = cell.model.createData()
        self._encoders = Encoders(cell, d)
        self.reset(pin.neutral(cell.model))

    def reset(self, q: ArrayLike) -> Array:
        """Put the cell at rest at ``q`` (nq,) and close the grip. Returns the measured configuration (nq,)."""
        self.q = read_only(self.cell.check_configuration(q, "DisturbedPlant.reset"))
        self.time = 0.0
        self._commands: deque[tuple[float, Array]] = deque([(0.0, self.q)])
        self._last_target = self.q
        tools = self.true_tools()
        T_object_world = self.grasp.T_object_tool[0] * tools[0].inverse()
        self._grip = Grasp(tuple(T_object_world * T for T in tools))
        return self._encoders.reset(self.q)

    def measure(self) -> Array:
        """Measure the configuration (nq,) again. At rest, :meth:`RobotCell.average` of readings reduces the noise."""
        return self._encoders.read(self.q, 0.0)

    def apply(self, step: ControlStep) -> Array:
        """Execute a command for its ``dt``. Returns the measured configuration (nq,) at the end."""
        model, dt = self.cell.model, step.dt
        self._commands.append((self.time + dt, step.q_next))
        target = self._target(self.time + dt)
        if self._lag or self._stall:
            behind = pin.difference(model, self._last_target, self.q)
            pace = pin.difference(model, self._last_target, target)
            after = np.zeros(self.cell.nv)
            for k, tau in self._lag.items():
                s = self.cell.v_slices[k]  # ẋ = (target − x) / τ with a linear target
                keep = np.exp(-dt / tau)
                after[s] = keep * behind[s] - (1.0 - keep) * tau / dt * pace[s]
            for k, time in self._stall.items():
                if self.time >= time - 1e-12:
                    s = self.cell.v_slices[k]
                    after[s] = pin.difference(model, target, self.q)[s]
            self.q = read_only(pin.integrate(model, target, after))
        else:
            self.q = read_only(target)
        self._last_target = target
        self.time += dt
        return self._encoders.read(self.q, dt)

    def period(self, nominal: float) -> float:
        """Length of the next step [s] with jitter; the loop passes it to the controller."""
        return self._encoders.period(nominal)

    def true_tools(self) -> list[pin.SE3]:
        """True T_world_tool of every arm."""
        pin.framesForwardKinematics(self.cell.model, self._data, self.q)
        return [E * self._data.oMf[f] for E, f in zip(self._displaced, self.cell.tool_frames, strict=True)]

    def chain_error(self) -> tuple[float, float]:
        """Largest distance [m] and angle [rad] between the true object poses of any two arms."""
        return chain_error(self.true_tools(), self._grip)

    def _target(self, now: float) -> Array:
        """Target of the drives at ``now``: the newest command; an older one for arms with command latency."""
        target = self._commands[-1][1]
        if self._late:
            target = target.copy()
            for k, delay in self._late.items():
                s = self.cell.q_slices[k]
                target[s] = self._at(now - delay)[s]
            oldest = now - max(self._late.values())
            while len(self._commands) > 2 and self._commands[1][0] < oldest:
                self._commands.popleft()
        else:
            self._commands = deque([self._commands[-1]])
        return target

    def _at(self, time: float) -> Array:
        """The commanded configuration at a time, interpolated between commands."""
        before = self._commands[0]
        if time <= before[0]:
            return before[1]
        for after in self._commands:
            if after[0] >= time:
                share = (time - before[0]) / (after[0] - before[0])
                return np.asarray(pin.interpolate(self.cell.model, before[1], after[1], share))
            before = after
        return before[1]
