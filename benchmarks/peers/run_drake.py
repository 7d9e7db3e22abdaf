"""Drake: DifferentialInverseKinematicsSystem, a QP in C++ with soft tasks of all tools, and limits of the joints."""

from __future__ import annotations

from typing import Any

import numpy as np
from protocol import Array, Task, Timed, serve
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsSystem as InverseKinematics
from pydrake.multibody.math import SpatialVelocity
from pydrake.planning import DofMask, JointLimits, RobotDiagramBuilder, SceneGraphCollisionChecker
from pydrake.systems.framework import BusValue

#: A clamp that never acts [rad/s, m/s].
_ANY_SPEED = np.full(6, 1e3)


class _Motion(Timed):
    def __init__(self, task: Task, robot: Drake) -> None:
        self._task, self._order = task, robot.order
        plant, checker = robot.plant, robot.checker
        active = DofMask(plant.num_positions(), True)
        recipe = InverseKinematics.Recipe()
        recipe.AddIngredient(InverseKinematics.LeastSquaresCost(InverseKinematics.LeastSquaresCost.Config()))
        recipe.AddIngredient(  # without it redundant arms have no unique answer
            InverseKinematics.JointCenteringCost(InverseKinematics.JointCenteringCost.Config(posture_gain=0.0))
        )
        recipe.AddIngredient(
            InverseKinematics.JointVelocityLimitConstraint(
                InverseKinematics.JointVelocityLimitConstraint.Config(), JointLimits(plant)
            )
        )
        self._system = InverseKinematics(
            recipe, "world", checker, active, task.dt, 1.0, SpatialVelocity(_ANY_SPEED[:3], _ANY_SPEED[3:])
        )
        self._context = self._system.CreateDefaultContext()
        self._output = self._system.get_output_port()
        self._ports = {name: self._system.GetInputPort(name) for name in (
            "position", "nominal_posture", "desired_cartesian_poses")}  # fmt: skip
        self._targets = []
        for row in task.targets:
            wanted = BusValue()
            for name, T in zip(robot.frames, row, strict=True):
                wanted.Set(name, Value(RigidTransform(T)))
            self._targets.append(wanted)
        self.start()

    def start(self) -> None:
        self._x = np.zeros(len(self._order))
        self._x[self._order] = self._task.q_start
        self._ports["nominal_posture"].FixValue(self._context, self._x)

    def step(self, i: int, reading: Array | None) -> Array:
        x = self._x
        if reading is not None:
            x[self._order] = reading
        self._ports["position"].FixValue(self._context, x)
        self._ports["desired_cartesian_poses"].FixValue(self._context, self._targets[i])
        x += self._task.dt * self._output.Eval(self._context)
        q: Array = x[self._order]
        return q


class Drake:
    package = "drake"
    modes: tuple[str, ...] = ("soft",)

    def load(self, task: Task) -> None:
        self._task = task
        builder = RobotDiagramBuilder(time_step=0.0)
        (instance,) = builder.parser().AddModels(task.urdf)
        builder.plant().Finalize()
        self.checker: Any = SceneGraphCollisionChecker(
            model=builder.Build(), robot_model_instances=[instance], edge_step_size=0.05
        )
        self.plant: Any = self.checker.plant()
        self.order = [self.plant.GetJointByName(name).position_start() for name in task.joints]
        name = self.plant.GetModelInstanceName(instance)
        self.frames = [f"{name}::{tool}" for tool in task.tools]
        self._context = self.plant.CreateDefaultContext()
        self._tools = [self.plant.GetFrameByName(tool) for tool in task.tools]

    def tools_at(self, q: Array) -> Array:
        x = np.zeros(len(self.order))
        x[self.order] = q
        self.plant.SetPositions(self._context, x)
        return np.array([tool.CalcPoseInWorld(self._context).GetAsMatrix4() for tool in self._tools])

    def motion(self, mode: str) -> _Motion:
        return _Motion(self._task, self)


if __name__ == "__main__":
    serve(Drake())
