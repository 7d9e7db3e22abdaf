"""Slips in a URDF are named by the joint or link that has them."""

from __future__ import annotations

from pathlib import Path

import pytest

from coopqp import Arm, CoopqpError
from coopqp.model.tool_guess import guess_tool

LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'


def joint(name: str, parent: str, child: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>{LIMIT}</joint>'
    )


SECOND = joint("j2", "one", "two")
GOOD = (
    '<robot name="r"><link name="base"/><link name="one"/><link name="two"/><link name="tip"/>'
    f"{joint('j1', 'base', 'one')}{SECOND}{joint('j3', 'two', 'tip')}</robot>"
)


@pytest.mark.parametrize(
    ("slip", "instead", "says"),
    [
        ('<parent link="one"/>', "", "joint 'j2' has no parent link"),
        ('<child link="two"/>', "", "joint 'j2' has no child link"),
        ('link="one"', 'link="onne"', "joint 'j2': there is no link 'onne', its parent, but one named 'one'"),
        ('link="two"', 'link="9"', "joint 'j2': there is no link '9', its child"),
        ("revolute", "revolut", "joint 'j2' has the type 'revolut', which is none of revolute, continuous"),
        (LIMIT, "", "joint 'j2' needs a limit with velocity"),
        (' effort="1"', "", "joint 'j2' needs a limit with effort"),
        ('lower="-1"', 'lower="-pi"', "joint 'j2': limit lower=\"-pi\" is not a number"),
        ('velocity="1"', 'velocity="1,5"', "joint 'j2': limit velocity=\"1,5\" is not a number"),
        ('velocity="1"', 'velocity="-1"', "joint 'j2': velocity limit -1"),
        ('"0 0 0.1"', '"0 0.1"', "joint 'j2': origin xyz=\"0 0.1\" is not 3 numbers"),
        ('"0 0 0.1"', '"0 0 nan"', "joint 'j2': origin xyz=\"0 0 nan\" is not 3 numbers"),
        ('"0 1 0"', '"y"', "joint 'j2': axis xyz=\"y\" is not 3 numbers"),
        ('"0 1 0"', '"0 0 0"', "joint 'j2' has no valid axis"),
        ('name="j2"', 'name="j1"', "two joints are named 'j1'"),
        (' name="j2"', "", "joint number 2 of the file has no name"),
        ('link="one"', 'link="two"', "joint 'j2' joins the link 'two' to itself"),
        (SECOND, SECOND + joint("k", "base", "two"), "link 'two' is the child of two joints, 'j2' and 'k'"),
        (SECOND, SECOND + joint("k", "tip", "base"), "every link is the child of a joint, 'base' of 'k'"),
        (SECOND, SECOND + '<link name="base"/>', "two links are named 'base'"),
        (SECOND, SECOND + '<link name="other"/>', "the links 'base' and 'other' are the children of no joint"),
        (SECOND, SECOND.replace("j2", "j9") + "<link/>", "link number 5 of the file has no name"),
    ],
)
def test_a_slip_is_named(slip: str, instead: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(GOOD)
    assert Arm.from_urdf("a", file, tool_frame="tip").model.nv == 3
    file.write_text(GOOD.replace(SECOND, SECOND.replace(slip, instead)))
    with pytest.raises(CoopqpError) as caught:
        Arm.from_urdf("a", file, tool_frame="tip")
    assert says in str(caught.value)
    assert "arm 'a'" in str(caught.value)


def test_a_slip_is_named_where_the_tool_is_guessed(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(GOOD.replace("revolute", "revolut", 2))
    with pytest.raises(CoopqpError, match="joint 'j1' has the type 'revolut'"):
        guess_tool(file)
