"""Runs of the control loop on simulated robots, on time that nothing waits for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coopqp import QPController
from coopqp.drivers import ControlLoop, LoopReport, ManualTime, SimulatedRobot
from coopqp.drivers.robots import driven_joints
from coopqp.model.state import CellState

#: What happens at a time of a run [s]: called with the robots by name and the loop.
Event = tuple[float, Callable[[dict[str, SimulatedRobot], ControlLoop], Any]]
#: A run that lasts longer is stopped [s].
_LONGEST = 12.0


@dataclass
class DrivenRun:
    """A run, with the robots' real positions in each period."""

    report: LoopReport
    time: np.ndarray
    q: np.ndarray
    sent: np.ndarray
    statuses: list[str]
    apart: np.ndarray = field(repr=False)


def joints_of(cell: Any, k: int) -> list[str]:
    """Names of an arm's joints in its own model."""
    return [name.split("/", 1)[1] for name in cell.joint_names[cell.v_slices[k]]]


def simulated_robots(
    cell: Any, q: Any, time: Any, lags: Sequence[float], *, names: Sequence[str] = (), **options: Any
) -> dict[str, SimulatedRobot]:
    """A robot for each arm, and for arms that share joints, with lags of their servos [s]; or one of each name."""
    x, joints = cell.positions(q), driven_joints(cell, names)
    return {
        name: SimulatedRobot(
            [cell.joint_names[j].partition("/")[2] for j in own], x[own], time=time, lag=lag, **options
        )
        for (name, own), lag in zip(joints.items(), lags, strict=True)
    }


def drive(
    cell: Any, scenario: Any, lags: Sequence[float], *, events: Sequence[Event] = (), constraints: Sequence[Any] = (),
    options: Any = None, dt: float = 0.002, **robots: Any,
) -> DrivenRun:  # fmt: skip
    """Run a scenario's path on robots whose servos lag."""
    time = ManualTime()
    arms = simulated_robots(cell, scenario.q_start, time, lags, **robots)
    controller = QPController(cell, scenario.grasp, scenario.path, dt=dt, constraints=constraints)
    moments, q, sent_all, statuses, waiting = [], [], [], [], list(events)
    began: list[float] = []

    class Recorder:
        def take(self, moment, measured, sent, step, clock):
            began.append(moment)
            now = moment - began[0]
            moments.append(now)
            real = np.empty(cell.nv)
            for robot in loop.robots:
                real[robot.joints] = robot.driver.servo.q
            q.append(real)
            sent_all.append(sent.copy())
            statuses.append(step.status.value)
            for event in [e for e in waiting if now >= e[0]]:
                event[1](arms, loop)
                waiting.remove(event)
            if now > _LONGEST:
                loop.stop("too long")

    loop = ControlLoop(controller, arms, options, recorder=Recorder(), time=time)
    report = loop.run()
    apart = [
        np.linalg.norm(scenario.grasp.relative_errors(CellState(cell, cell.configuration_of(x)))[:, :3], axis=1).max()
        for x in q[::5]
    ]
    return DrivenRun(report, np.array(moments), np.array(q), np.array(sent_all), statuses, np.array(apart))
