"""Arms and cells that several tests need, and scenarios with other arms, grasps and objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, RobotCell
from coopqp.model import CellState
from coopqp.planning import Payload
from coopqp.scenarios import Scenario, robot_path
from coopqp.spatial import Array


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


def grasp_at(cell: RobotCell, q: Array) -> Grasp:
    """The grasp of arms that hold an object where they are; its frame is that of the first tool."""
    T = CellState(cell, q).T_world_tool
    return Grasp(tuple(T[0].actInv(X) for X in T))


def box_of(task: Scenario, mass: float, **limits: Any) -> Payload:
    """The scenario's object as a homogeneous box of a mass [kg], with limits of its payload."""
    x, y, z = task.object_size
    inertia = mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    return Payload(mass=mass, centre=task.T_object_body.translation, inertia=inertia, **limits)


_ONE_ARM = """
name = "one"
{start}
[[arms]]
name = "a"
robot = "rx90l"
[grasp]
kind = "{grasp}"
{tools}
[path]
{path}
duration_s = 1.0
"""


def one_arm_file(folder: Path, path: str, *, start: str = "", grasp: str = "tools") -> str:
    """A cell file in a folder: one arm on a path, the lines of its table but for the duration."""
    file = folder / "one.toml"
    tools = "tools.a = {}" if grasp == "tools" else ""
    file.write_text(_ONE_ARM.format(start=start, grasp=grasp, tools=tools, path=path), encoding="utf-8")
    return str(file)


def cart(name: str = "cart", **limits: Any) -> Arm:
    """A rail along x and a turntable about z on it, which has no ends; the tool is at the turntable's middle."""
    model = pin.Model()
    rail = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    turntable = model.addJoint(rail, pin.JointModelRUBZ(), pin.SE3.Identity(), "table")
    model.addFrame(pin.Frame("tool", turntable, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    given = {"lower_limits": [-5.0, -np.inf], "upper_limits": [5.0, np.inf], "velocity_limits": [2.0, 3.0], **limits}
    return Arm.from_model(name, model, tool_frame="tool", **given)
