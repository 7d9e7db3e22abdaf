"""Robots as they are: endless joints and turns, ranges, servos that sag, rates and clocks of states; one random each.

A stand-in of its own follows what it is sent: straight lines between stamped commands as trajectory controllers do, or
the curve that the processes of robots send on. What judges the ends is Pinocchio's forward kinematics of each arm's own
model, at the joints' real positions.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from coopqp import QPController, QPOptions, RobotCell, SupervisionOptions
from coopqp.drivers import Command, ControlLoop, ManualTime, RobotState
from coopqp.drivers.stamped import StampedCommands
from coopqp.errors import CoopqpError
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.spatial import Array
from promise_cases import Promise
from promise_cases.chain_cells import Oracle

_DURATION, _ACCELERATION, _LONGEST = 0.6, 15.0, 30.0
#: How far a first command may be from where a servo is [rad or m], and the object from its end when a run finished [m].
_FIRST, _END = 5e-3, 6e-3
#: Arms that hang further than this apart are slowed or held by the supervision [m].
_APART = 2.5e-4
_CELLS: dict[str, Callable[[], Scenario]] = {
    "three arms": lambda: paper_lift(time_law="quintic", duration=_DURATION),
    "four arms, an endless joint": lambda: mixed_cell(duration=_DURATION),
    "two arms, 7 joints": lambda: dual_arm7(duration=_DURATION),
}
KINDS = ("turns", "ranges", "sag", "rates", "clocks", "lags")


@dataclass(kw_only=True)
class Robot:
    """What a robot does; times in s, angles in rad."""

    lag: float = 0.01
    told_lag: bool = True
    tells_target: bool = True
    smooth: bool = False
    sag: float = 0.0  #: by which joints hang below their targets
    period: float = 0.002
    rarer: float = 1.0  #: states come so many times rarer than told
    late: float = 0.0  #: age of a state when it arrives
    jump: tuple[float, float] = (math.inf, 0.0)  #: when its clock is set, by what


class StandIn:
    """A robot that follows its commands literally; it notes its largest step, as a share of what its speed allows."""

    commands: Literal["position", "velocity"] = "position"
    delay = 0.0

    def __init__(self, names: list[str], q: Array, speed: Array, time: ManualTime, does: Robot) -> None:
        self.joint_names, self.period = tuple(names), does.period
        self.lag = does.lag if does.told_lag else None
        self.q, self.target, self._speed = q - does.sag, q.copy(), speed
        self._does, self._time, self._t, self._next = does, time, time.now(), time.now()
        self._way, self._states = StampedCommands(q), deque[RobotState]()
        self._sent: tuple[float, Array] | None = None
        self.leap = self.first = 0.0

    def connect(self) -> None:
        """Nothing to do."""

    def _clock(self, now: float) -> float:
        at, by = self._does.jump
        return now + (by if now >= at else 0.0)

    def read(self) -> RobotState | None:
        """The newest state that has arrived."""
        does, now, h = self._does, self._time.now(), 5e-4
        while self._t < now - 1e-9:
            self._t += h
            moment = self._clock(self._t)
            self.target = (self._way.at if does.smooth else self._way.line)(moment)
            before = self.q
            share = 1.0 if does.lag == 0.0 else 1.0 - math.exp(-h / does.lag)
            self.q = before + share * (self.target - does.sag - before)
            if self._t >= self._next - 1e-9:
                self._next += does.period * does.rarer
                target = self.target.copy() if does.tells_target else None
                self._states.append(RobotState(self.q.copy(), (self.q - before) / h, moment, target=target))
        newest = None
        while self._states and self._states[0].stamp <= self._clock(now) - does.late + 1e-9:
            newest = self._states.popleft()
        return newest

    def send(self, command: Command) -> None:
        """Take a command."""
        if self._sent is None:
            self.first = float(np.abs(command.q - self.target).max())
        elif command.at > self._sent[0]:
            most = self._speed * (command.at - self._sent[0])
            self.leap = max(self.leap, float((np.abs(command.q - self._sent[1]) / most).max()))
        self._sent = command.at, command.q.copy()
        self._way.push(command.at, command.q)

    def stop(self) -> None:
        """It stays."""


@dataclass
class Found:
    """What came of the runs of a kind."""

    runs: int = 0
    leaps: int = 0
    false_ends: int = 0
    outwards: int = 0
    unnamed: int = 0
    stopped: int = 0
    unfinished: int = 0


def _placed(rng: np.random.Generator, cell: RobotCell, x: Array, kind: str) -> tuple[Array, RobotCell, bool]:
    """Where the robots stand, the cell with its limits, and whether it has to be refused."""
    x = x.copy()
    if kind == "turns":
        endless = np.flatnonzero(cell.continuous)
        x[endless] += math.tau * rng.integers(-4, 5, len(endless))
        moved = x + math.tau * rng.choice([-1, 1], cell.nv)
        # With room for the path, which the limits would block elsewhere.
        inside = (cell.limits.lower + 0.5 <= moved) & (moved <= cell.limits.upper - 0.5) & ~cell.continuous
        x[inside] = moved[inside]
    if kind == "ranges":
        j = int(rng.choice(np.flatnonzero(~cell.continuous)))
        outside = float(rng.choice([rng.uniform(0.0, 1.9e-3), rng.uniform(2.1e-3, 0.5), math.tau - 0.1]))
        lower, upper = cell.limits.lower.copy(), cell.limits.upper.copy()
        if rng.random() < 0.5:
            upper[j] = x[j] - outside
            lower[j] = min(lower[j], upper[j] - 1.0)
        else:
            lower[j] = x[j] + outside
            upper[j] = max(upper[j], lower[j] + 1.0)
        return x, cell.with_limits(lower=lower, upper=upper), outside > 2e-3
    return x, cell, False


def _robots(rng: np.random.Generator, kind: str, number: int) -> list[Robot]:
    made, small = [], 0.03 if kind == "sag" and rng.random() < 0.5 else 1.0
    for _ in range(number):
        does = Robot(lag=float(rng.uniform(0.0, 0.04)), smooth=bool(rng.random() < 0.5))
        does.told_lag = bool(rng.random() < 0.7)
        if kind == "sag":
            does.sag, does.tells_target = float(rng.uniform(-2e-3, 2e-3)), bool(rng.random() < 0.5)
            does.sag *= small
        elif kind == "rates":
            does.rarer = float(rng.choice([1.0, 1.0, rng.uniform(1.5, 60.0)]))
            does.late = float(rng.choice([0.0, rng.uniform(0.0, 0.1)]))
        elif kind == "clocks" and rng.random() < 0.5:
            does.jump = float(rng.uniform(0.0, 0.6)), float(rng.choice([-1.0, -0.05, 0.05, 30.0]))
        made.append(does)
    return made


def _run(rng: np.random.Generator, kind: str, found: Found) -> None:
    scenario = _CELLS[str(rng.choice(list(_CELLS)))]()
    cell = scenario.cell.with_limits(acceleration=_ACCELERATION)
    x, cell, refuse = _placed(rng, cell, cell.positions(scenario.q_start), kind)
    time, robots = ManualTime(), _robots(rng, kind, len(cell))
    drivers = {
        name: StandIn([cell.joint_names[j].partition("/")[2] for j in range(own.start, own.stop)], x[own],
                      cell.limits.velocity[own], time, does)
        for name, own, does in zip(cell.arm_names, cell.v_slices, robots, strict=True)
    }  # fmt: skip
    options = QPOptions(supervision=SupervisionOptions(stiffness=1e5))
    controller = QPController(cell, scenario.grasp, scenario.path, dt=0.002, options=options)
    outside = np.maximum(x - cell.limits.upper, cell.limits.lower - x) * ~cell.continuous

    class Watch:
        outwards = False

        def take(self, moment: float, measured: Array, sent: Array, step: Any, clock: float) -> None:
            now = np.maximum(sent - cell.limits.upper, cell.limits.lower - sent)
            self.outwards |= bool((now > np.maximum(outside, 0.0) + 1e-6).any())
            if loop.stands:
                loop.stop(f"robot '{loop.stopped_robot}' stopped")
            elif moment > _LONGEST:
                loop.stop("it never ends")

    watch = Watch()
    loop = ControlLoop(controller, drivers, recorder=watch, time=time)
    finished, reason, stops = False, "", 0
    try:
        report = loop.run()
        finished, reason, stops = report.finished, report.reason, report.stops
    except CoopqpError as error:
        reason = str(error)
    except Exception as error:
        reason = f"nan {type(error).__name__}: {error}"
    q = np.concatenate([drivers[name].q for name in cell.arm_names])
    points = np.array(Oracle(cell, scenario.grasp).points(cell.configuration_of(q)))
    off = np.linalg.norm(points - scenario.path.pose(scenario.path.duration).translation, axis=1).max()
    named = any(name in reason for name in cell.arm_names) and "nan" not in reason and "never ends" not in reason
    found.runs += 1
    found.leaps += sum(robot.leap > 1.0 + 1e-6 or robot.first > _FIRST for robot in drivers.values())
    found.false_ends += finished and bool(off > _END)
    found.outwards += watch.outwards or (refuse and any(robot.first or robot.leap for robot in drivers.values()))
    found.unnamed += not finished and not named
    found.stopped += stops > 0
    apart = np.linalg.norm(points - points[0], axis=1).max()
    found.unfinished += not finished and not (kind == "sag" and apart > _APART)


def promises(quick: bool) -> Iterator[Promise]:
    """Random starts and runs of each kind."""
    warnings.simplefilter("ignore")
    number = 2 if quick else -(-500 // len(KINDS))
    for k, kind in enumerate(KINDS):
        found = Found()
        for i in range(number):
            _run(np.random.default_rng([k, i]), kind, found)
        case = f"robots, {kind}, {found.runs} runs"
        yield Promise(f"{case}: leaps beyond what the speed allows", float(found.leaps), 0.0, "commands")
        yield Promise(f"{case}: finished, and not at the end", float(found.false_ends), 0.0, "runs")
        yield Promise(f"{case}: sent further outside the limits", float(found.outwards), 0.0, "runs")
        yield Promise(f"{case}: ended without a name and a reason", float(found.unnamed), 0.0, "runs")
        if kind in ("turns", "sag", "lags"):  # nothing hinders these robots
            yield Promise(f"{case}: taken for robots that stopped", float(found.stopped), 0.0, "runs")
            yield Promise(f"{case}: not finished", float(found.unfinished), 0.0, "runs")
