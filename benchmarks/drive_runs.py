"""Runs of ``drive.py``: the control loop on simulated robots, on time that nothing waits for, and what befalls them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np

from coopqp import QPController
from coopqp.drivers import ControlLoop, EngineCell, LoopReport, ManualTime, SimulatedRobot
from coopqp.drivers.robots import driven_joints
from coopqp.errors import StiffnessWarning
from coopqp.model.state import CellState
from coopqp.paths.scenario import Scenario
from coopqp.scenarios import paper_lift
from coopqp.simulation import PhysicsPlant
from coopqp.spatial import Array

DT = 0.002
LIFT = paper_lift(time_law="quintic")
CELL = LIFT.cell.with_limits(acceleration=10.0)
LIFT_WITH_LIMITS = replace(LIFT, cell=CELL)
#: Shares of the limits that the runs so far have sent: velocity, acceleration.
SENT: list[tuple[float, float]] = []
Event = tuple[float, Callable[[Any, ControlLoop], object]]


@dataclass(frozen=True)
class Row:
    """One figure beside its bound."""

    case: str
    value: float
    bound: float
    unit: str


@dataclass
class Run:
    """A run, with what its robots really did in each period."""

    scenario: Scenario
    report: LoopReport
    time: Array
    q: Array
    sent: Array
    holding: Array
    forces: Array
    force_time: Array

    def apart(self) -> Array:
        """Largest distance between the arms' views of the object, every fifth period [m]."""
        found = []
        for x in self.q[::5]:
            cell = self.scenario.cell
            errors = self.scenario.grasp.relative_errors(CellState(cell, cell.configuration_of(x)))
            found.append(np.linalg.norm(errors[:, :3], axis=1).max())
        return np.array(found)

    def force(self, begin: float = 0.0, end: float = np.inf) -> float:
        """Largest force of an arm on the object in a time, its share of the load included [N]."""
        return float(self.forces[(self.force_time >= begin) & (self.force_time < end)].max())


def drive(
    lags: Sequence[float], *, events: Sequence[Event] = (), told: bool = True, gripped: bool = False,
    constraints: Sequence[Any] = (), observe: Callable[[float], None] | None = None,
    scenario: Scenario = LIFT_WITH_LIMITS,
) -> Run:  # fmt: skip
    """Run the lift, or another scenario; in the engine where the arms hold the object."""
    clock = ManualTime()
    cell = scenario.cell
    x = cell.positions(scenario.q_start)
    engine: EngineCell | None = None
    robots: dict[str, Any]
    if gripped:
        engine = EngineCell(PhysicsPlant.of(scenario), scenario.q_start, time=clock, period=DT, lags=lags)
        robots = dict(engine.robots(told=told))
    else:
        robots = {
            name: SimulatedRobot(
                [cell.joint_names[j] for j in own], x[own], time=clock, lag=lag, told_lag="lag" if told else None
            )
            for (name, own), lag in zip(driven_joints(cell).items(), lags, strict=True)
        }
    controller = QPController(cell, scenario.grasp, scenario.path, dt=DT, constraints=constraints)
    moments: list[float] = []
    q: list[Array] = []
    sent_all: list[Array] = []
    holding: list[bool] = []
    waiting = list(events)

    class Recorder:
        def take(self, moment: float, measured: Array, sent: Array, step: Any, clock: float) -> None:
            moments.append(moment)
            now = moment - moments[0]
            real = measured.copy()
            for robot in loop.robots if engine is None else ():
                real[robot.joints] = robots[robot.name].servo.q
            q.append(real)
            sent_all.append(sent.copy())
            holding.append(step.status.value == "holding")
            for event in [e for e in waiting if now >= e[0]]:
                event[1](robots, loop)
                waiting.remove(event)
            if observe is not None:
                observe(now)
            if now > scenario.path.duration + 12.0:
                loop.stop("too long")

    loop = ControlLoop(controller, robots, recorder=Recorder(), time=clock)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffnessWarning)
        report = loop.run()
    SENT.append((report.velocity, report.acceleration))
    began = moments[0]
    return Run(
        scenario, report, np.array(moments) - began, np.array(q), np.array(sent_all), np.array(holding),
        np.zeros((0, 3)) if engine is None else np.array(engine.forces),
        np.zeros(0) if engine is None else np.array(engine.times) - began,
    )  # fmt: skip


def limit(k: int, speed: float | None) -> Callable[[Any, ControlLoop], object]:
    """Event: a robot moves at a speed at most (norm of its joints' velocities)."""
    return lambda robots, loop: list(robots.values())[k].servo.limit(speed)


def halt(k: int, deceleration: float = np.inf) -> Callable[[Any, ControlLoop], object]:
    """Event: a robot stands, and does not say so."""
    return lambda robots, loop: list(robots.values())[k].servo.halt(deceleration=deceleration)


def release(k: int) -> Callable[[Any, ControlLoop], object]:
    """Event: a robot follows its commands again."""
    return lambda robots, loop: list(robots.values())[k].servo.release()


def kill(k: int) -> Callable[[Any, ControlLoop], object]:
    """Event: nothing is heard of a robot again."""
    return lambda robots, loop: list(robots.values())[k].kill()


def resume(robots: Any, loop: ControlLoop) -> None:
    """Event: on by hand."""
    loop.resume()


def time_of(run: Run) -> float:
    """How long a run took [s]; NaN where it did not finish."""
    return run.report.time if run.report.finished else np.nan
