"""Arms and cells that several tests need, and scenarios with other arms, grasps and objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, RobotCell
from coopqp.planning import Payload
from coopqp.scenarios import Scenario, robot_path


def rx90l(name: str = "arm", **options: Any) -> Arm:
    """The paper's arm, with options of :meth:`coopqp.Arm.from_urdf`."""
    return Arm.from_urdf(name, robot_path("rx90l"), tool_frame="flange", **options)


def on_another_joint(name: str, below: Any, T_world_base: pin.SE3) -> Arm:
    """An arm of eight joints: arm7 on a joint below it, a rail or a turntable, with ends at ±2."""
    own = Arm.from_urdf("arm7", robot_path("arm7"), tool_frame="tool", geometry=False)
    model, ends = pin.Model(), np.full(1, 2.0)
    joint = model.addJoint(0, below, T_world_base, "below", np.array([50.0]), np.array([1.0]), -ends, ends)
    frame = model.addFrame(pin.Frame("platform", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Arm.from_model(name, pin.appendModel(model, own.model, frame, pin.SE3.Identity()), tool_frame="tool")


def reordered(task: Scenario, order: Sequence[int]) -> Scenario:
    """The same arms in another order."""
    return replace(
        task,
        cell=RobotCell([task.cell.arms[k] for k in order]),
        grasp=Grasp(tuple(task.grasp.T_object_tool[k] for k in order)),
        q_start=np.concatenate([task.q_start[task.cell.q_slices[k]] for k in order]),
    )


def with_mismatch(task: Scenario, arm: int, shift: Sequence[float], turn: Sequence[float] = (0, 0, 0)) -> Scenario:
    """The same start, with another assumed grasp of an arm: shifted [m] and turned [rad] in the object's frame."""
    tools = list(task.grasp.T_object_tool)
    tools[arm] = pin.SE3(pin.exp3(np.array(turn, dtype=float)), np.array(shift, dtype=float)) * tools[arm]
    return replace(task, grasp=Grasp(tuple(tools)))


def box_of(task: Scenario, mass: float, **limits: Any) -> Payload:
    """The scenario's object as a homogeneous box of a mass [kg], with limits of its payload."""
    x, y, z = task.object_size
    inertia = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    return Payload(mass=mass, centre=task.T_object_body.translation, inertia=inertia, **limits)
