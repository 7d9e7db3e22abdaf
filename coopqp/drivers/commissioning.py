"""Commission wrist sensors through drivers: the robots hold the object, press, and the readings tell the sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from coopqp.control.interface import ControlStep
from coopqp.drivers.driver import RobotDriver
from coopqp.drivers.loop import ControlLoop
from coopqp.drivers.options import LoopOptions
from coopqp.drivers.timing import LoopTime
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.paths.scenario import Scenario
from coopqp.simulation.commissioning import Commissioning, commissioning_of, pressing_controller
from coopqp.spatial import Array

#: What ends the run when the sensors are found.
_FOUND = "the sensors are found"


def commission_sensors_by_drivers(
    scenario: Scenario,
    drivers: Mapping[str, RobotDriver],
    *,
    stiffness: Array | None,
    known: Mapping[str, WristSensor] | None = None,
    options: LoopOptions | Mapping[str, Any] | None = None,
    time: LoopTime | None = None,
    begun: Callable[[ControlLoop], AbstractContextManager[Any]] | None = None,
) -> Commissioning:
    """Press robots against each other that hold the object at the start of a scenario, and identify the wrist sensors.

    As :func:`coopqp.simulation.commission_sensors` does in the engine. The robots move: it is no safety function.

    Args:
        scenario: the cell, the grasp, the start and the object.
        drivers: a driver by the name of its arm or robot; its states have wrenches.
        stiffness: what is known of the joint servos (nv,) [N·m/rad or N/m].
        known: what is known of the sensors, by arm.
        options: of the loop.
        time: the clock; the machine's by default.
        begun: called with the loop; its context is around the run, as for a signal handler.

    Raises:
        DriverError: a robot cannot be reached, tells no wrench, or the cell is not driven as it is.
        InvalidInputError: no stiffness, drivers that do not fit the cell, or a known sensor is dead.
    """
    known = dict(known or {})
    controller = pressing_controller(scenario, known=known, stiffness=stiffness)
    felt: list[float] = []

    class Presses:
        """Ends the run when the sensors are found, and notes what the presses add."""

        rest: Array | None = None

        def take(self, moment: float, measured: Array, sent: Array, step: ControlStep, clock: float) -> None:
            told = [watch.wrench(arm) for watch in loop.watches for arm in watch.robot.arms]
            wrenches = np.array([np.full(6, np.nan) if own is None else own for own in told])
            if np.isfinite(wrenches).all():
                self.rest = wrenches if self.rest is None else self.rest
                felt.append(float(np.linalg.norm((wrenches - self.rest)[:, :3], axis=1).max()))
            if controller.sensors is not None:
                loop.stop(_FOUND)

    loop = ControlLoop(controller, drivers, options, recorder=Presses(), time=time)
    with nullcontext() if begun is None else begun(loop):
        report = loop.run()
    return commissioning_of(controller, known=known, reason=report.reason, added=max(felt, default=0.0))
