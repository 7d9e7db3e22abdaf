"""The guess of tool frame and fingers: right for every robot of the list, and by rule for descriptions made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm
from coopqp.errors import MissingExtraError, ModelError
from coopqp.model.tool_guess import axis_out, guess_tool
from coopqp.scenarios import ROBOTS, robot_arm, robot_file


def tree(*joints: tuple[str, str, str, str], limit: str = 'lower="0.2" upper="0.6"') -> str:
    """A URDF of joints (name, kind, parent, child), each 0.1 m above the one before."""
    links = dict.fromkeys(["base", *(child for *_, child in joints)])
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    parts = [f'<link name="{link}">{mass}</link>' for link in links]
    for name, kind, parent, child in joints:
        mimic = '<mimic joint="drive"/>' if name.startswith("follower") else ""
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0.1"/><axis xyz="1 0 0"/><limit {limit} effort="1" velocity="1"/>{mimic}'
            "</joint>"
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


ARM = (("a", "revolute", "base", "one"), ("b", "revolute", "one", "two"), ("c", "revolute", "two", "three"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "tree.urdf"


@pytest.mark.parametrize("name", ROBOTS)
def test_the_guess_is_what_the_list_of_robots_says(name: str) -> None:
    try:
        made = guess_tool(robot_file(name))
    except MissingExtraError:
        pytest.skip("needs the extra robots")
    assert made.tool_frame == ROBOTS[name].tool_frame
    assert made.locked == dict(ROBOTS[name].locked)
    assert made.tool_frame not in made.others


def test_fingers_beside_each_other_are_locked_whatever_their_names(file: Path) -> None:
    file.write_text(tree(*ARM, ("l", "prismatic", "three", "left"), ("r", "prismatic", "three", "right")))
    made = guess_tool(file)
    assert (made.tool_frame, made.locked) == ("three", {"l": 0.4, "r": 0.4})


def test_a_joint_beside_one_that_mimics_it_is_a_finger_and_all_behind_it(file: Path) -> None:
    hand = (
        ("drive", "revolute", "three", "d"), ("follower", "revolute", "three", "f"), ("tip", "revolute", "d", "t"),
        ("fixed", "fixed", "three", "my_tcp"),
    )  # fmt: skip
    file.write_text(tree(*ARM, *hand))
    made = guess_tool(file)
    assert made.tool_frame == "my_tcp"
    assert made.others == ("three",)
    assert made.locked == {"drive": 0.2, "tip": 0.2}, "zero is outside their limits; the follower goes with its drive"


def test_a_frame_that_is_given_is_kept(file: Path) -> None:
    file.write_text(tree(*ARM, ("gripper", "prismatic", "three", "jaw")))
    assert guess_tool(file, tool_frame="two").locked == {"gripper": 0.4}
    assert guess_tool(file, tool_frame="jaw").locked == {}, "the tool may be on a finger"
    with pytest.raises(ModelError, match="has no frame 'four': base, one, two, three, jaw"):
        guess_tool(file, tool_frame="four")


def test_several_ends_are_named(file: Path) -> None:
    other = (("x", "revolute", "base", "u"), ("y", "revolute", "u", "v"), ("z", "revolute", "v", "w"))
    file.write_text(tree(*ARM, *other))
    with pytest.raises(ModelError, match=r"several ends: three, w\. Say which: tree\.urdf:three"):
        guess_tool(file)


def test_what_cannot_be_an_arm_is_refused(file: Path) -> None:
    file.write_text(tree(("fixed", "fixed", "base", "one")))
    with pytest.raises(ModelError, match="nothing moves"):
        guess_tool(file)
    file.write_text("<robot")
    with pytest.raises(ModelError, match="not a readable URDF"):
        guess_tool(file)


def test_the_axis_out_of_the_hand_points_away_from_the_last_joint() -> None:
    for name in ("rx90l", "arm5", "gantry7"):
        arm = robot_arm(name, geometry=False)
        frame = arm.model.frames[arm.model.getFrameId(arm.tool_frame)]
        offset = frame.placement.rotation.T @ frame.placement.translation
        assert np.dot(axis_out(arm), offset) == pytest.approx(np.abs(offset).max())


@pytest.mark.parametrize(
    ("kind", "limit", "at"),
    [
        ("prismatic", 'lower="0.2" upper="0.6"', 0.4),
        ("prismatic", 'lower="-0.03" upper="0.01"', -0.01),
        ("prismatic", 'lower="0" upper="0.0000024"', 1e-6),
        ("prismatic", 'lower="0.6" upper="0.2"', 0.0),
        ("prismatic", 'lower="-1e300" upper="0.2"', 0.0),
        ("prismatic", 'lower="-1e6" upper="-0.2"', -0.2),
        ("prismatic", 'lower="0.2" upper="1e6"', 0.2),
        ("prismatic", 'lower="-999990" upper="999998"', 4.0),
        ("revolute", 'lower="-0.5" upper="0.5"', 0.0),
        ("revolute", 'lower="0.2" upper="0.6"', 0.2),
        ("revolute", 'lower="-0.6" upper="-0.2"', -0.2),
        ("revolute", 'lower="0.6" upper="0.2"', 0.0),
        ("continuous", "", 0.0),
    ],
)
def test_a_finger_rests_in_the_middle_of_its_way_or_nearest_to_zero(
    kind: str, limit: str, at: float, file: Path
) -> None:
    """A way without an end has no middle, and a range that is reversed says nothing."""
    file.write_text(tree(*ARM, ("finger", kind, "three", "tip"), limit=limit))
    assert guess_tool(file).locked == {"finger": at}


@pytest.mark.parametrize(
    ("frames", "best"),
    [
        (("my_tcp", "tool0", "hand"), "my_tcp"),
        (("tool0", "tool_center_point", "flange"), "tool_center_point"),
        (("tool_mount", "tool0"), "tool0"),
        (("end_effector", "tool_mount", "flange"), "tool_mount"),
        (("flange", "arm_ee", "hand"), "arm_ee"),
        (("gripper_base", "FLANGE"), "FLANGE"),
        (("plate", "hand_base"), "hand_base"),
        (("plate", "cover"), "cover"),
        (("eel", "plate"), "plate"),
    ],
)
def test_the_name_of_a_frame_decides_and_then_how_far_out_it_is(frames: tuple[str, ...], best: str, file: Path) -> None:
    """Each frame stands on the one before it: of those that say nothing the farthest out is taken."""
    fixed = zip(("three", *frames), frames, strict=False)
    file.write_text(tree(*ARM, *((f"fixed_{name}", "fixed", before, name) for before, name in fixed)))
    made = guess_tool(file)
    assert made.tool_frame == best
    assert {made.tool_frame, *made.others} == {"three", *frames}
    assert made.locked == {}


@pytest.mark.parametrize("name", ["left_finger", "GRIP_2", "upper_jaw", "knuckle", "thumb", "claw_a"])
def test_fingers_are_known_by_their_names(name: str, file: Path) -> None:
    file.write_text(tree(*ARM, (name, "revolute", "three", "tip")))
    made = guess_tool(file)
    assert (made.tool_frame, made.locked) == ("three", {name: 0.2})


def test_the_longest_chain_has_the_tool(file: Path) -> None:
    file.write_text(tree(("head", "revolute", "base", "eye"), *ARM))
    assert guess_tool(file).tool_frame == "three"
    file.write_text(tree(*ARM, ("x", "revolute", "base", "u"), ("y", "revolute", "u", "v")))
    made = guess_tool(file)
    assert (made.tool_frame, made.locked) == ("three", {}), "what stands beside an arm at its base is no finger"


def test_an_arm_of_fingers_alone_has_no_tool(file: Path) -> None:
    file.write_text(tree(("finger_1", "revolute", "base", "one"), ("finger_2", "revolute", "one", "two")))
    with pytest.raises(ModelError, match="no joints besides those of fingers"):
        guess_tool(file)
    file.write_text(tree(*ARM).replace("robot", "model"))
    with pytest.raises(ModelError, match=r"arm 'tree': .*tree\.urdf is not a readable URDF"):
        guess_tool(file)


@pytest.mark.parametrize("turn", ["x", "y", "z"])
def test_the_axis_out_of_the_hand_has_a_sign(turn: str) -> None:
    """A tool frame is placed on either side of the last joint, along each of its own axes, and turned."""
    R = pin.utils.rotate(turn, 0.5 * np.pi)
    for axis in range(3):
        for sign, expected in ((1.0, 1.0), (-1.0, -1.0)):
            own = sign * np.eye(3)[axis]
            assert axis_out(_with_tool(pin.SE3(R, R @ (0.02 * own)))) == tuple(expected * np.eye(3)[axis])
            assert axis_out(_with_tool(pin.SE3(R, R @ (0.009 * own)))) == (0.0, 0.0, 1.0), "too near to tell"


def _with_tool(T_joint_tool: pin.SE3) -> Arm:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint")
    model.addFrame(pin.Frame("tool", joint, 0, T_joint_tool, pin.FrameType.OP_FRAME))
    return Arm.from_model("arm", model, tool_frame="tool", lower_limits=-1.0, upper_limits=1.0, velocity_limits=1.0)
