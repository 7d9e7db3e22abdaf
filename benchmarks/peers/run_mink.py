"""mink: QP inverse kinematics on MuJoCo, any solver of qpsolvers, rebuilt each step."""

from __future__ import annotations

from typing import Any

import mink
import mujoco
import numpy as np
from protocol import Array, Task, Timed, serve

#: A pair is seen this far beyond its margin [m].
SEEN = 0.1


class _Motion(Timed):
    def __init__(self, model: Any, task: Task, *, hard: bool, solver: str) -> None:
        self._task, self._solver = task, solver
        self._configuration = mink.Configuration(model)
        tools = task.tools
        free = tools[:1] if hard else tools
        self._tasks = [mink.FrameTask(tool, "site", position_cost=1.0, orientation_cost=1.0) for tool in free]
        self._constraints = []
        if hard:
            for k in range(1, task.arms):
                chain = mink.RelativeFrameTask(
                    tools[k], "site", tools[0], "site", position_cost=1.0, orientation_cost=1.0
                )
                chain.set_target(mink.SE3.from_matrix(task.relative(k)))
                self._constraints.append(chain)
        self._targets = [[mink.SE3.from_matrix(T) for T in row[: len(free)]] for row in task.targets]
        speeds = {name: float(speed) for name, speed in zip(task.joints, task.speed, strict=True)}
        self._limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
        scene = task.spec.get("scene")
        if scene is not None:
            pairs = [([f"shape_{i}"], [f"shape_{j}"]) for i, j in scene["pairs"]]
            margin = scene["margin"]
            self._limits.append(
                mink.CollisionAvoidanceLimit(
                    model, pairs, minimum_distance_from_collisions=margin, collision_detection_distance=margin + SEEN
                )
            )
        self.start()

    def start(self) -> None:
        self._configuration.update(self._task.q_start)

    def step(self, i: int, reading: Array | None) -> Array:
        dt = self._task.dt
        if reading is not None:
            self._configuration.update(reading)
        for frame, target in zip(self._tasks, self._targets[i], strict=True):
            frame.set_target(target)
        v = mink.solve_ik(
            self._configuration,
            self._tasks,
            dt,
            solver=self._solver,
            limits=self._limits,
            constraints=self._constraints or None,
        )
        if not np.isfinite(v).all():
            raise ArithmeticError("the velocity is not finite")
        if reading is None:
            self._configuration.integrate_inplace(v, dt)
        command: Array = self._configuration.q if reading is None else self._configuration.integrate(v, dt)
        return command


class Mink:
    package = "mink"
    modes: tuple[str, ...] = ("hard daqp", "soft daqp")

    def load(self, task: Task) -> None:
        self._task = task
        self._model = mujoco.MjModel.from_xml_path(task.mjcf)
        if [self._model.joint(j).name for j in range(self._model.njnt)] != task.joints:
            raise ValueError("the joints are in another order")

    def tools_at(self, q: Array) -> Array:
        configuration = mink.Configuration(self._model, q)
        return np.array([configuration.get_transform_frame_to_world(t, "site").as_matrix() for t in self._task.tools])

    def motion(self, mode: str) -> _Motion:
        kind, solver = mode.split()
        return _Motion(self._model, self._task, hard=kind == "hard", solver=solver)


if __name__ == "__main__":
    serve(Mink())
