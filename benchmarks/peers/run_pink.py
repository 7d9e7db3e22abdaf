"""pink: QP inverse kinematics on Pinocchio, any solver of qpsolvers, rebuilt each step."""

from __future__ import annotations

import logging
import warnings
from typing import Any

import numpy as np
import pink
import pinocchio as pin
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, RelativeFrameTask
from protocol import Array, Task, Timed, serve


class _Motion(Timed):
    def __init__(self, model: Any, task: Task, *, hard: bool, solver: str, gain: float, safety_break: bool) -> None:
        self._model, self._task, self._solver, self._safety_break = model, task, solver, safety_break
        tools = task.tools
        free = tools[:1] if hard else tools
        self._tasks = [FrameTask(tool, position_cost=1.0, orientation_cost=1.0) for tool in free]
        self._constraints = []
        if hard:
            for k in range(1, task.arms):
                chain = RelativeFrameTask(tools[k], tools[0], position_cost=1.0, orientation_cost=1.0, gain=gain)
                chain.set_target(pin.SE3(task.relative(k)))
                self._constraints.append(chain)
        self._targets = [[pin.SE3(T) for T in row[: len(free)]] for row in task.targets]
        self._limits = [ConfigurationLimit(model), VelocityLimit(model)]
        self.start()

    def start(self) -> None:
        self._configuration = pink.Configuration(self._model, self._model.createData(), self._task.q_start)

    def step(self, i: int, reading: Array | None) -> Array:
        dt = self._task.dt
        if reading is not None:
            self._configuration.update(reading)
        for frame, target in zip(self._tasks, self._targets[i], strict=True):
            frame.set_target(target)
        v = pink.solve_ik(
            self._configuration,
            self._tasks,
            dt,
            solver=self._solver,
            limits=self._limits,
            constraints=self._constraints or None,
            safety_break=self._safety_break,
        )
        if not np.isfinite(v).all():
            raise ArithmeticError("the velocity is not finite")
        if reading is None:
            self._configuration.integrate_inplace(v, dt)
        command: Array = self._configuration.q if reading is None else self._configuration.integrate(v, dt)
        return command


class Pink:
    package = "pin-pink"
    #: hard: the relative placements are equality constraints. gentle: with a gain of 0.02 and no safety break.
    modes: tuple[str, ...] = ("hard daqp", "hard quadprog", "hard proxqp", "hard osqp", "soft daqp", "gentle daqp")

    def load(self, task: Task) -> None:
        self._task = task
        self._model = pin.buildModelFromUrdf(task.urdf)
        if list(self._model.names)[1:] != task.joints:
            raise ValueError("the joints are in another order")

    def tools_at(self, q: Array) -> Array:
        configuration = pink.Configuration(self._model, self._model.createData(), q)
        return np.array([configuration.get_transform_frame_to_world(t).homogeneous for t in self._task.tools])

    def motion(self, mode: str) -> _Motion:
        kind, solver = mode.split()
        gentle = kind == "gentle"
        return _Motion(
            self._model,
            self._task,
            hard=kind != "soft",
            solver=solver,
            gain=0.02 if gentle else 1.0,
            safety_break=not gentle,
        )


if __name__ == "__main__":
    logging.disable()  # a line per step outside the limits, and a warning per sparse conversion, would be timed too
    warnings.simplefilter("ignore")
    serve(Pink())
