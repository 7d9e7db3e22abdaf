"""Cells of one robot whose arms share joints, and configurations of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Grasp, Robot, RobotCell
from coopqp.model import CellState
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import find_branches
from coopqp.planning.on_shared import OnShared, group_joints
from coopqp.scenarios import robot_path
from coopqp.spatial import Array

#: Axes of the six joints of an arm, and the offsets of their frames [m].
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
OFFSETS = ("0 0 0.1", "0 0 0.1", "0 0 0.4", "0.1 0 0", "0.35 0 0", "0.1 0 0")


def joint(name: str, kind: str, parent: str, child: str, axis: str, xyz: str, rpy: str = "0 0 0") -> str:
    limit = "" if kind == "continuous" else 'lower="-2.9" upper="2.9" '
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/><limit {limit}velocity="2" effort="100"/></joint>'
    )


def two_arms(torso: tuple[tuple[str, str], ...]) -> str:
    """A URDF of a torso, joints by kind and axis, with two arms of six joints and a head."""
    text, last = '<robot name="both"><link name="base"/>', "base"
    for i, (kind, axis) in enumerate(torso):
        text += joint(f"torso_{i}", kind, last, f"chest_{i}", axis, "0 0 0.3")
        last = f"chest_{i}"
    text += joint("neck", "revolute", last, "head", "0 0 1", "0 0 0.6")
    for side, y in (("left", 0.3), ("right", -0.3)):
        before = last
        for i, (axis, xyz) in enumerate(zip(AXES, OFFSETS, strict=True)):
            place = f"0 {y} 0.4" if i == 0 else xyz
            text += joint(f"{side}_{i}", "revolute", before, f"{side}_link_{i}", axis, place)
            before = f"{side}_link_{i}"
    return text + "</robot>"


def robot_of(torso: tuple[tuple[str, str], ...], folder: Path, **options: object) -> Robot:
    """The robot of :func:`two_arms`."""
    file = folder / "both.urdf"
    file.write_text(two_arms(torso))
    tools = {side: f"{side}_link_5" for side in ("left", "right")}
    return Robot(file, tools, name="torso", geometry=False, **options)  # type: ignore[arg-type]


def lift_cell(**options: object) -> tuple[RobotCell, Grasp]:
    """The lift with two arms, which hold a bar along y from its ends."""
    tools = {"left": "left_tool", "right": "right_tool"}
    limits = {"acceleration_limits": 5.0, "geometry": False, **options}
    robot = Robot(robot_path("lift2"), tools, name="lift", **limits)  # type: ignore[arg-type]
    ends = ((0.3, 0.5 * np.pi), (-0.3, -0.5 * np.pi))
    grasp = Grasp(tuple(pin.SE3(pin.rpy.rpyToMatrix(a, 0.0, 0.0), np.array([0.0, y, 0.0])) for y, a in ends))
    return RobotCell([robot]), grasp


def held(cell: RobotCell, grasp: Grasp, T_world_object: pin.SE3, s: Array) -> Array:
    """A configuration (nq,) at which all arms of one group hold the object, with the shared joints at ``s`` (S,)."""
    (group,) = cell.groups
    joints = group_joints(cell, group)
    x = np.zeros(cell.nv)
    for k in group:
        arm = OnShared(cell.arms[k], cell.columns[k], joints)
        pose = (T_world_object * grasp.T_object_tool[k]).homogeneous[None]
        found = find_branches(arm.alone, pin.SE3(arm.seen(s[None], pose)[0]))
        x[cell.columns[k][arm.whole.columns]] = arm.joined(s[None], found.q[:1])[0]
    return cell.configuration(x)


def kinematics_of(cell: RobotCell) -> list[ArmKinematics]:
    """The kinematics of each arm."""
    return [ArmKinematics(arm) for arm in cell.arms]


def regular(cell: RobotCell, rng: np.random.Generator) -> Array:
    """A configuration in which no arm's own joints are near a singularity."""
    while True:
        q = cell.configuration(rng.uniform(-1.2, 1.2, cell.nv))
        state, own = CellState(cell, q), [~np.isin(columns, cell.shared) for columns in cell.columns]
        if min(np.linalg.svd(state.jacobian(k)[:, own[k]])[1][5] for k in range(len(cell))) > 0.1:
            return q


def columns_of(cell: RobotCell, q: Array, R: pin.SE3) -> Array:
    """Twists of the object by each arm, in R, for all joints (6 N, nv): 0 where a joint does not move the tool."""
    state, out = CellState(cell, q), np.zeros((len(cell), 6, cell.nv))
    for k, joint in enumerate(cell.tool_joints):
        J = pin.computeJointJacobian(cell.model, cell.model.createData(), q, joint)
        out[k] = R.actInv(state.T_world_tool[k] * cell.T_joint_tool[k].inverse()).action @ J
    return out.reshape(-1, cell.nv)
