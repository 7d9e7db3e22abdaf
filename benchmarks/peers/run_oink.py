"""roboplan-oink: QP inverse kinematics in C++ (a kept ProxQP); soft frame tasks, no relative ones, so no hard chain."""

from __future__ import annotations

from typing import Any

import numpy as np
from protocol import Array, Task, Timed, serve
from roboplan.core import CartesianConfiguration, Scene, loadUrdfSceneDescription
from roboplan.optimal_ik import FrameTask, Oink, PositionLimit, VelocityLimit


class _Motion(Timed):
    def __init__(self, scene: Any, task: Task) -> None:
        self._scene, self._task = scene, task
        self._oink = Oink(scene)
        self._tasks = []
        for tool, T in zip(task.tools, task.targets[0], strict=True):
            goal = CartesianConfiguration("world", tool, np.asfortranarray(T))
            self._tasks.append(FrameTask(self._oink, scene, goal))
        self._limits = [PositionLimit(self._oink), VelocityLimit(self._oink, task.dt, task.speed)]
        self._targets = [[np.asfortranarray(T) for T in row] for row in task.targets]
        self._delta = np.zeros(self._oink.num_variables)
        self.start()

    def start(self) -> None:
        self._q = self._task.q_start.copy()

    def step(self, i: int, reading: Array | None) -> Array:
        q = self._q if reading is None else reading
        for frame, target in zip(self._tasks, self._targets[i], strict=True):
            frame.setTargetFrameTransform(target)
        self._oink.solveIk(q, self._tasks, self._limits, self._delta)
        self._q = np.asarray(self._scene.integrate(q, self._delta))
        return self._q


class OinkRunner:
    package = "roboplan-oink"
    modes: tuple[str, ...] = ("soft",)

    def load(self, task: Task) -> None:
        self._task = task
        self._scene = Scene("cell", loadUrdfSceneDescription(task.urdf))
        if list(self._scene.getJointNames()) != task.joints:
            raise ValueError("the joints are in another order")

    def tools_at(self, q: Array) -> Array:
        return np.array([self._scene.forwardKinematics(q, t) for t in self._task.tools])

    def motion(self, mode: str) -> _Motion:
        return _Motion(self._scene, self._task)


if __name__ == "__main__":
    serve(OinkRunner())
