"""What came out of a run on robots."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False)
class LoopReport:
    """A run of a :class:`coopqp.drivers.ControlLoop`.

    Attributes:
        finished: the object reached the end of its path, and the tools are measured there.
        reason: in a sentence, how it ended.
        time: from the first command to the end [s].
        lost_time: time that each robot cost, by name [s].
        slowest_rate: smallest rate of the shared clock; negative on a way back.
        stops: how often all arms came to rest behind a robot that had stopped.
        stop_reasons: which robot stopped, and where on the path, a sentence each.
        stalls: how often the loop stood until its commands had run out; the arms went on from rest.
        periods, late, missed: periods of the loop; those that began half a period late; those left out after overruns.
        lateness: of the periods' beginnings, p50, p99 and the largest [s].
        lost: states that were never read, by robot: they did not come, or a newer one came before they were read.
        missing: periods in which a robot's state was too old, by robot.
        lags: first-order lag of each robot as told or learnt [s].
        commands: number of commands sent to each robot.
        guarded: periods in which the addition was cut to what the limits left for it.
        velocity, acceleration: largest velocity and acceleration sent, as a share of the limits.
        apart: largest distance between the grasps that was measured, corrected for nothing [m]; NaN without states.
        largest_force: largest force at a grasp that was measured [N]; NaN without sensors.
        statuses: number of controller's steps with each status.
        process: what was asked of the operating system, and what came of it.
        refused_calls: operators' calls that the controller refused, a sentence each, the first hundred.
        failures: what recorders, pages, callers and drivers raised while the run went on, a sentence each.
    """

    finished: bool
    reason: str
    time: float
    lost_time: dict[str, float]
    slowest_rate: float
    stops: int
    stop_reasons: tuple[str, ...]
    stalls: int
    periods: int
    late: int
    missed: int
    lateness: tuple[float, float, float]
    lost: dict[str, int]
    missing: dict[str, int]
    lags: dict[str, float]
    commands: int
    guarded: int
    velocity: float
    acceleration: float
    apart: float
    largest_force: float
    statuses: dict[str, int] = field(default_factory=dict)
    process: dict[str, str] = field(default_factory=dict)
    refused_calls: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """The run in a few lines."""
        p50, p99, most = (1e6 * x for x in self.lateness)
        slow = {name: t for name, t in self.lost_time.items() if t > 0.05}
        text = [("finished" if self.finished else "not finished") + f" after {self.time:.2f} s: {self.reason}"]
        if slow:
            text.append("time lost to " + ", ".join(f"{name}: {t:.2f} s" for name, t in slow.items()))
        text.append(f"slowest rate of the shared clock {self.slowest_rate:.2f}, stops {self.stops}")
        text += self.stop_reasons
        if np.isfinite(self.apart):
            text.append(f"arms apart by {1e3 * self.apart:.2f} mm at most, as measured")
        if np.isfinite(self.largest_force):
            text.append(f"largest force at a grasp {self.largest_force:.0f} N")
        text.append(
            f"{self.periods} periods, late p50 {p50:.0f}, p99 {p99:.0f}, largest {most:.0f} µs; "
            f"{self.late} late by half a period, {self.missed} left out"
        )
        if self.stalls:
            text.append(f"the commands ran out {self.stalls} times while the loop stood; the arms went on from rest")
        text.append(f"{self.commands} commands to each robot; {_each(self.lost) or 0} states lost or overtaken")
        if missing := _each(self.missing):
            text.append(f"periods without a state that is new enough: {missing}")
        text.append("lags " + ", ".join(f"{name} {1e3 * lag:.0f} ms" for name, lag in self.lags.items()))
        if "realtime" in self.process:
            text.append(f"real-time scheduler: {self.process['realtime']}")
        text += [f"refused {call}" for call in self.refused_calls]
        text += [f"failed: {failure}" for failure in self.failures]
        text.append("statuses: " + ", ".join(f"{name} {count}" for name, count in self.statuses.items()))
        return text

    def record(self) -> dict[str, Any]:
        """The numbers by name, for JSON."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def _each(counts: dict[str, int]) -> str:
    """The counts that are not 0, with their robots' names."""
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count)


def largest_apart(cell: RobotCell, grasp: Grasp, positions: Iterable[Array]) -> float:
    """Largest distance between the arms' views of the object at joint positions (nv,) [m]; NaN without any."""
    found = math.nan
    for x in positions:
        if np.isfinite(x).all():
            errors = grasp.relative_errors(CellState(cell, cell.configuration_of(x)))
            most = float(np.linalg.norm(errors[:, :3], axis=1).max(initial=0.0))
            found = most if math.isnan(found) else max(found, most)
    return found
