"""The object's clock: paths with steps, operators' calls, long steps."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from coopqp import LinePath, ObjectPath, QPController, Status
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array
from promise_cases import Promise

_DT, _STEPS, _RUNS = 0.002, 900, 8
_WAY, _TURN = np.array([0.0, 0.02, 0.2]), np.array([0.0, 0.0, 0.1])


class _Uneven(ObjectPath):
    """A share of a lift by the clock, with twists by finite differences, as users write them."""

    duration = 3.0

    def __init__(self, start: pin.SE3, kind: str) -> None:
        self._start, self._kind = start, kind

    def _share(self, x: float) -> float:
        if self._kind == "root":
            return math.sqrt(x)
        if self._kind == "kinks":
            i = math.floor(300.0 * x)
            return (i + (0.3 if i % 2 else 1.7) * (300.0 * x - i) + 0.7 * (i % 2)) / 300.0
        return math.floor(6.0 * x) / 6.0

    def pose(self, clock: float) -> pin.SE3:
        share = self._share(min(max(clock, 0.0), self.duration) / self.duration)
        return pin.SE3(pin.exp3(share * _TURN) @ self._start.rotation, self._start.translation + share * _WAY)

    def twist(self, clock: float) -> Array:
        before, after = max(clock - 1e-6, 0.0), min(clock + 1e-6, self.duration)
        return np.asarray(pin.log6(self.pose(before).actInv(self.pose(after))).vector) / (after - before)


def _uneven(kind: str, acceleration: float, runs: int) -> tuple[float, int]:
    """The longest step [ms], each the least of equal runs in the thread's own time; and steps without a name."""
    lift = paper_lift()
    cell, least, unnamed = lift.cell.with_limits(acceleration=acceleration), np.full(_STEPS, np.inf), 0
    for _ in range(runs):
        controller = QPController(cell, lift.grasp, _Uneven(lift.path.pose(0.0), kind), dt=_DT)
        controller.reset(lift.q_start)
        in_a_row = unnamed = 0
        for i in range(_STEPS):
            began = time.thread_time()
            step = controller.step()
            least[i] = min(least[i], time.thread_time() - began)
            waits = step.status is Status.SLOWED and step.rate < 1e-3 and not (step.binding or step.reason)
            in_a_row = in_a_row + 1 if waits else 0
            unnamed += in_a_row > 20  # a rate may rise from 0 for a moment
    return 1e3 * float(least.max()), unnamed


def _unfinished(acceleration: float, dt: float, lines: int) -> int:
    """Number of easy lines that are not finished in four times their time."""
    lift, rng, unfinished = paper_lift(), np.random.default_rng(21), 0
    cell, start = lift.cell.with_limits(acceleration=acceleration), lift.path.pose(0.0)
    for _ in range(lines):
        way, turn, duration = 0.025 * rng.normal(size=3), 0.05 * rng.normal(size=3), float(rng.uniform(0.6, 1.5))
        line = LinePath.displaced(start, translation=way, rotation=turn, duration=duration)
        controller = QPController(cell, lift.grasp, line, dt=dt)
        controller.reset(lift.q_start)
        steps = (controller.step() for _ in range(int(4.0 * duration / dt)))
        unfinished += not any(step.finished for step in steps)
    return unfinished


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    for kind in ("stairs", "kinks", "root"):
        for acceleration in (np.inf, 8.0):
            longest, unnamed = _uneven(kind, acceleration, 4 if quick else _RUNS)
            case = f"stairs and kinks: {kind}, {acceleration:g} rad/s²"
            yield Promise(f"{case}: longest step", longest, 0.3, "ms")
            yield Promise(f"{case}: steps that wait without a name", unnamed, 0, "")
    lines = 3 if quick else 45
    for acceleration, dt in ((1e3, 0.04), (1e4, 0.01), (1e6, 0.06)):
        case = f"{lines} easy lines, {acceleration:g} rad/s², {1e3 * dt:g} ms: not finished"
        yield Promise(case, _unfinished(acceleration, dt, lines), 0, "")
