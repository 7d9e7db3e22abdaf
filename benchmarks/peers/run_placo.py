"""PlaCo: QP inverse kinematics in C++, with hard, scaled and soft tasks; a floating base that is masked."""

from __future__ import annotations

from typing import Any

import numpy as np
import placo
from protocol import Array, Task, Timed, serve


class _Motion(Timed):
    def __init__(self, task: Task, *, mode: str) -> None:
        self._task = task
        robot = self._robot = _robot(task)
        self._offset = robot.get_joint_offset(task.joints[0])
        solver = self._solver = placo.KinematicsSolver(robot)
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        solver.dt = task.dt
        tools, first = task.tools, task.targets[0]
        if mode == "soft":
            self._tasks = [solver.add_frame_task(tool, first[k]) for k, tool in enumerate(tools)]
            for tool, frame in zip(tools, self._tasks, strict=True):
                frame.configure(tool, "soft", 1.0, 1.0)
        else:
            self._tasks = [solver.add_frame_task(tools[0], first[0])]
            self._tasks[0].configure("object", "scaled" if mode == "hard scaled" else "soft", 1.0, 1.0)
            self._chain = [
                solver.add_relative_frame_task(tools[0], tools[k], task.relative(k)) for k in range(1, task.arms)
            ]
            for k, chain in enumerate(self._chain):
                chain.configure(f"chain_{k}", "hard", 1.0, 1.0)
        self._scaled = mode == "hard scaled"
        self._targets = [list(row[: len(self._tasks)]) for row in task.targets]
        self.start()

    def start(self) -> None:
        self._robot.reset()
        _put(self._robot, self._task, self._task.q_start)

    def step(self, i: int, reading: Array | None) -> Array:
        robot = self._robot
        if reading is not None:  # at once: joint by joint takes ten times as long
            robot.state.q[self._offset :] = reading
            robot.update_kinematics()
        for frame, target in zip(self._tasks, self._targets[i], strict=True):
            frame.T_world_frame = target
        self._solver.solve(True)
        if reading is None:  # otherwise the next reading does it
            robot.update_kinematics()
        q: Array = robot.state.q
        return q[self._offset :]

    def rate(self) -> float:
        return float(self._solver.scale) if self._scaled else 1.0


def _robot(task: Task) -> Any:
    return placo.RobotWrapper(task.urdf, placo.Flags.ignore_collisions)


def _put(robot: Any, task: Task, q: Array) -> None:
    for name, position in zip(task.joints, q, strict=True):
        robot.set_joint(name, float(position))
    robot.update_kinematics()


class Placo:
    package = "placo"
    #: hard scaled: hard chain, the object's motion is scaled; hard soft: hard chain, the object's task is soft.
    modes: tuple[str, ...] = ("hard scaled", "hard soft", "soft")

    def load(self, task: Task) -> None:
        self._task, self._robot = task, _robot(task)
        offset = self._robot.get_joint_offset(task.joints[0])
        if [self._robot.get_joint_offset(name) - offset for name in task.joints] != list(range(len(task.joints))):
            raise ValueError("the joints are in another order")

    def tools_at(self, q: Array) -> Array:
        _put(self._robot, self._task, q)
        return np.array([self._robot.get_T_world_frame(t) for t in self._task.tools])

    def motion(self, mode: str) -> _Motion:
        return _Motion(self._task, mode=mode)


if __name__ == "__main__":
    serve(Placo())
