"""pink: QP inverse kinematics on Pinocchio, any solver of qpsolvers, rebuilt each step."""

from __future__ import annotations

import logging
import warnings
from typing import Any

import coal
import numpy as np
import pink
import pinocchio as pin
from pink.barriers import SelfCollisionBarrier
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, RelativeFrameTask
from protocol import Array, Task, Timed, serve

#: As in pink's example of self-collision: its gain, and the number of nearest pairs that the barrier sees.
BARRIER_GAIN, MOST_PAIRS = 20.0, 10


def _geometry(scene: dict[str, Any]) -> pin.GeometryModel:
    """The shapes that keep distances, as pink wants them."""
    make = {
        "box": lambda half: coal.Box(*(2.0 * np.array(half))),
        "sphere": lambda half: coal.Sphere(half[0]),
        "capsule": lambda half: coal.Capsule(half[0], 2.0 * half[1]),
        "cylinder": lambda half: coal.Cylinder(half[0], 2.0 * half[1]),
    }
    geometry = pin.GeometryModel()
    for i, shape in enumerate(scene["shapes"]):
        T = pin.SE3(np.array(shape["placement"]))
        made = make[shape["kind"]](shape["half"])
        geometry.addGeometryObject(pin.GeometryObject(f"shape_{i}", shape["joint"], T, made))
    for first, second in scene["pairs"]:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry


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
        scene = task.spec.get("scene")
        self._geometry, self._barriers = None, []
        if scene is not None:
            self._geometry = _geometry(scene)
            most = min(MOST_PAIRS, len(scene["pairs"]))
            self._barriers = [SelfCollisionBarrier(most, gain=BARRIER_GAIN, d_min=scene["margin"])]
        self.start()

    def start(self) -> None:
        shapes: dict[str, Any] = {}
        if self._geometry is not None:
            shapes = {"collision_model": self._geometry, "collision_data": self._geometry.createData()}
        self._configuration = pink.Configuration(self._model, self._model.createData(), self._task.q_start, **shapes)

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
            barriers=self._barriers or None,
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
