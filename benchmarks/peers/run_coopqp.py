"""coopqp itself, run like a peer: its own process, the same commands. Only its public interface is used."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import export_cell
import numpy as np
import peer_cases
from protocol import Array, Task, serve

from coopqp import ControlStep, QPController, Status

_NO_COMMAND = (Status.HOLDING, Status.FAULT)


class _Motion:
    def __init__(self, case: peer_cases.Case) -> None:
        s = case.scenario
        self._controller = QPController(s.cell, s.grasp, s.path, dt=s.dt, options=case.options)
        self._q_start: Array = s.q_start
        self.start()

    def start(self) -> None:
        self._controller.reset(self._q_start)
        self._step: ControlStep | None = None
        self._failed = False

    def over(self, i: int) -> bool:
        return self._step is not None and self._step.finished

    def step(self, i: int, reading: Array | None) -> Array:
        self._step = step = self._controller.step(reading)
        self._failed = step.status in _NO_COMMAND
        return step.q_next

    def failure(self) -> str:
        return "" if self._step is None or not self._failed else self._step.explain()

    def rate(self) -> float:
        return 1.0 if self._step is None else self._step.rate


class Coopqp:
    package = "coopqp"
    modes: tuple[str, ...] = ("default",)

    def load(self, task: Task) -> None:
        self._case = peer_cases.build(task.spec["case"], task.arms, task.spec["joints_each"])

    def tools_at(self, q: Array) -> Array:
        return np.array([T.homogeneous for T in export_cell.tools_at(self._case.scenario.cell, q)])

    def motion(self, mode: str) -> _Motion:
        return _Motion(self._case)


if __name__ == "__main__":
    serve(Coopqp())
