"""The guess of tool frame and fingers: right for every robot of the list, and by rule for descriptions made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coopqp.errors import MissingExtraError, ModelError
from coopqp.model.tool_guess import axis_out, guess_tool
from coopqp.scenarios import ROBOTS, robot_arm, robot_file


def tree(*joints: tuple[str, str, str, str]) -> str:
    """A URDF of joints (name, kind, parent, child), each 0.1 m above the one before."""
    links = dict.fromkeys(["base", *(child for *_, child in joints)])
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    parts = [f'<link name="{link}">{mass}</link>' for link in links]
    for name, kind, parent, child in joints:
        mimic = '<mimic joint="drive"/>' if name.startswith("follower") else ""
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0.1"/><axis xyz="1 0 0"/><limit lower="0.2" upper="0.6" effort="1" velocity="1"/>{mimic}'
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
    assert made.locked == {"drive": 0.2, "follower": 0.2, "tip": 0.2}, "zero is outside their limits"


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
