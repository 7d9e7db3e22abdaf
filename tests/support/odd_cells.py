"""Cells whose joints are not one row of six or seven for each arm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from torsos import AXES, OFFSETS, joint

from coopqp import Arm, Robot, RobotCell
from coopqp.spatial import Array


def row(name: str, parent: str, count: int, first: str) -> str:
    """Joints one behind the other, with the axes of an arm again and again; the first at a place in its parent."""
    text, last = "", parent
    for i in range(count):
        place = first if i == 0 else OFFSETS[i % 6]
        text += joint(f"{name}_{i}", "revolute", last, f"{name}_link_{i}", AXES[i % 6], place)
        last = f"{name}_link_{i}"
    return text


def turret(name: str, parent: str) -> str:
    """A joint that moves no tool. Pinocchio sorts the children of a link by name: it comes before its siblings."""
    return joint(name, "continuous", parent, f"{name}_top", "0 0 1", "0.05 0 0")


def written(name: str, text: str, folder: Path) -> Path:
    file = folder / f"{name}.urdf"
    file.write_text(f'<robot name="{name}"><link name="base"/>{text}</robot>')
    return file


def arm(name: str, text: str, tool: str, folder: Path, y: float = 0.0, locked: dict[str, float] | None = None) -> Arm:
    base = pin.SE3(np.eye(3), np.array([0.0, y, 0.0]))
    file = written(name, text, folder)
    return Arm.from_urdf(name, file, tool_frame=tool, geometry=False, T_world_base=base, locked_joints=locked)


def plain_arm(folder: Path) -> Arm:
    return arm("other", row("j", "base", 6, "0 0 0.1"), "j_link_5", folder, 1.0)


def robot(text: str, arms: dict[str, str], folder: Path, **options: object) -> Robot:
    """A robot whose arms are rows of six joints, by the row of each."""
    tools = {name: f"{last}_link_5" for name, last in arms.items()}
    return Robot(written("whole", text, folder), tools, name="whole", geometry=False, **options)  # type: ignore[arg-type]


def joints_that_move_no_tool(folder: Path) -> RobotCell:
    """One stands between the joints of an arm, and one before them."""
    text = turret("a_base", "base") + row("j", "base", 6, "0 0 0.1") + turret("a_mast", "j_link_2")
    return RobotCell([arm("arm", text, "j_link_5", folder), plain_arm(folder)])


def seven_with_a_turret(folder: Path) -> RobotCell:
    text = row("j", "base", 7, "0 0 0.1") + turret("a_mast", "j_link_3")
    return RobotCell([plain_arm(folder), arm("arm", text, "j_link_6", folder)])


def five_with_a_turret(folder: Path) -> RobotCell:
    text = row("j", "base", 5, "0 0 0.1") + turret("a_mast", "j_link_2")
    return RobotCell([plain_arm(folder), arm("arm", text, "j_link_4", folder)])


def tool_before_the_end(folder: Path) -> RobotCell:
    """Two joints move what is behind the tool, and in another arm stand there locked."""
    long = row("j", "base", 8, "0 0 0.1")
    locked = {"j_6": 0.1, "j_7": 0.2}
    return RobotCell(
        [arm("arm", long, "j_link_5", folder), arm("other", long, "j_link_5", folder, y=1.0, locked=locked)]
    )


def snake(folder: Path) -> RobotCell:
    """An arm of twenty joints."""
    return RobotCell([arm("arm", row("j", "base", 20, "0 0 0.1"), "j_link_19", folder), plain_arm(folder)])


TORSO = joint("lift", "prismatic", "base", "c0", "0 0 1", "0 0 0.3") + joint(
    "waist", "revolute", "c0", "c1", "0 0 1", "0 0 0.3"
)
HUMANOID = (
    TORSO + row("l", "c1", 6, "0 0.3 0.4") + turret("a_mast", "l_link_2") + row("r", "c1", 6, "0 -0.3 0.4")
    + row("h", "c0", 6, "0.2 0 0.1")
)  # fmt: skip


def one_on_the_first_of_two(folder: Path) -> RobotCell:
    """A torso of two joints with two arms, and a third arm on the first of them."""
    return RobotCell([robot(HUMANOID, {"left": "l", "right": "r", "head": "h"}, folder)])


def the_same_the_other_way_round(folder: Path) -> RobotCell:
    return RobotCell([plain_arm(folder), robot(HUMANOID, {"head": "h", "right": "r", "left": "l"}, folder)])


def two_pairs_on_a_waist(folder: Path) -> RobotCell:
    """Two arms on each of two shoulders, which one waist carries."""
    text = joint("waist", "revolute", "base", "c0", "0 0 1", "0 0 0.3")
    for side, y in (("left", 0.3), ("right", -0.3)):
        text += joint(f"{side}_shoulder", "revolute", "c0", side, "0 1 0", f"0 {y} 0.3")
        text += row(f"{side[0]}0", side, 6, "0.1 0.2 0.2") + row(f"{side[0]}1", side, 6, "0.1 -0.2 0.2")
    return RobotCell([robot(text, {name: name for name in ("l0", "l1", "r0", "r1")}, folder)])


def two_lifts_of_one_robot(folder: Path) -> RobotCell:
    text = "".join(
        joint(lift, "prismatic", "base", f"{lift}_top", "0 0 1", f"{x} 0 0.3")
        + row(f"{lift}0", f"{lift}_top", 6, "0 0.3 0.4") + row(f"{lift}1", f"{lift}_top", 6, "0 -0.3 0.4")
        for lift, x in (("u", 0.0), ("v", 1.0))
    )  # fmt: skip
    return RobotCell([robot(text, {name: name for name in ("u0", "u1", "v0", "v1")}, folder)])


def arms_on_one_waist(folder: Path, count: int = 5) -> RobotCell:
    text = joint("waist", "revolute", "base", "c0", "0 0 1", "0 0 0.3")
    text += "".join(row(f"a{i}", "c0", 6, f"0 {0.3 * i - 0.6} 0.4") for i in range(count))
    return RobotCell([robot(text, {f"arm {i}": f"a{i}" for i in range(count)}, folder)])


def long_torso(folder: Path) -> RobotCell:
    """Two arms share eight joints."""
    text = row("torso", "base", 8, "0 0 0.1")
    text += row("l", "torso_link_7", 6, "0 0.3 0.4") + row("r", "torso_link_7", 6, "0 -0.3 0.4")
    return RobotCell([robot(text, {"left": "l", "right": "r"}, folder)])


def screw_and_composite(folder: Path) -> RobotCell:
    """Joints of Pinocchio that no file describes: one that screws, and one inside another, at a place in it."""
    model, last = pin.Model(), 0
    inside = pin.JointModelComposite()
    inside.addJoint(pin.JointModelRX(), pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.02, 0.03, 0.01])))
    kinds = (pin.JointModelRZ(), pin.JointModelRY(), pin.JointModelHY(0.05), inside, pin.JointModelRY(),
             pin.JointModelHelicalUnaligned(np.array([0.8, 0.6, 0.0]), -0.02))  # fmt: skip
    for i, (kind, offset) in enumerate(zip(kinds, OFFSETS, strict=True)):
        last = model.addJoint(last, kind, pin.SE3(np.eye(3), np.array([float(x) for x in offset.split()])), f"j{i}")
    model.addFrame(pin.Frame("tool", last, 0, pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0])), pin.FrameType.OP_FRAME))
    limits = {"velocity_limits": 2.0, "lower_limits": -2.9, "upper_limits": 2.9}
    return RobotCell([Arm.from_model("arm", model, tool_frame="tool", **limits), plain_arm(folder)])  # type: ignore[arg-type]


ODD_CELLS: dict[str, Callable[[Path], RobotCell]] = {
    make.__name__: make
    for make in (
        joints_that_move_no_tool, seven_with_a_turret, five_with_a_turret, tool_before_the_end, snake,
        one_on_the_first_of_two, the_same_the_other_way_round, two_pairs_on_a_waist, two_lifts_of_one_robot,
        arms_on_one_waist, long_torso, screw_and_composite,
    )
}  # fmt: skip


def posture(cell: RobotCell, seed: int = 3) -> Array:
    """A configuration (nq,) in which no arm is singular."""
    return cell.configuration(np.random.default_rng(seed).uniform(-0.7, 0.7, cell.nv))
