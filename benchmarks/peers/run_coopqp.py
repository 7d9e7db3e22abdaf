"""coopqp itself, run like a peer: its own process, the same commands. Only its public interface is used."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import export_cell
import numpy as np
import peer_cases
from protocol import Array, Task, serve

from coopqp import ControlStep, QPController, QPOptions, Status, available_kernels
from coopqp.scenarios import Scenario

#: Every step through the QP, without the shortcuts that settle most steps exactly.
ALWAYS_QP = "always a QP"
#: The solver, the same in every mode; the shortcut's steps need none.
SOLVER = "daqp"

_NO_COMMAND = (Status.HOLDING, Status.FAULT)


class _Motion:
    def __init__(self, scenario: Scenario, mode: str) -> None:
        options = QPOptions(solver=SOLVER, shortcut=mode != ALWAYS_QP, kernel="auto" if mode == ALWAYS_QP else mode)
        self._controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, options=options)
        self._q_start: Array = scenario.q_start
        self.start()

    def start(self) -> None:
        self._controller.reset(self._q_start)
        self._step: ControlStep | None = None

    def over(self, i: int) -> bool:
        return self._step is not None and self._step.finished

    def step(self, i: int) -> float:
        self._step = step = self._controller.step()
        if step.status in _NO_COMMAND:
            raise RuntimeError(step.explain())
        return step.rate

    def q(self) -> Array:
        return self._q_start if self._step is None else np.array(self._step.q_next)


class Coopqp:
    package = "coopqp"
    modes: tuple[str, ...] = (*available_kernels(), ALWAYS_QP)

    def load(self, task: Task) -> None:
        self._scenario = peer_cases.build(task.spec["case"], task.arms, task.spec["joints_each"]).scenario

    def tools_at(self, q: Array) -> Array:
        return np.array([T.homogeneous for T in export_cell.tools_at(self._scenario.cell, q)])

    def motion(self, mode: str) -> _Motion:
        return _Motion(self._scenario, mode)


if __name__ == "__main__":
    serve(Coopqp())
