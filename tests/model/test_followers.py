"""Joints that follow others: they stand where Pinocchio's own reading puts them, or are refused, never locked alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, Robot
from coopqp.errors import ModelError
from coopqp.model.tool_guess import guess_tool

LIMIT = '<limit lower="{low}" upper="2.5" velocity="2" effort="1"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", low: float = -2.5, mimic: str = "") -> str:
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.05 0.2" rpy="0.3 0.2 0.1"/><axis xyz="0 1 0"/>{LIMIT.format(low=low)}{mimic}</joint>'
    )


def follows(leader: str, multiplier: Any = 1, offset: Any = 0) -> str:
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def arm_with(*further: str) -> str:
    """A URDF of an arm a1, a2, a3 with the links 1, 2, 3, and further joints."""
    arm = "".join(joint(f"a{i + 1}", str(i), str(i + 1)) for i in range(3))
    return f'<robot name="r"><link name="0"/>{arm}{"".join(further)}</robot>'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "r.urdf"


def place(model: pin.Model, frame: str, q: Any) -> Any:
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.asarray(q, dtype=float))
    return data.oMf[model.getFrameId(frame)].homogeneous


def test_fingers_stand_where_the_finger_that_they_follow_takes_them(file: Path, rng: np.random.Generator) -> None:
    """By Pinocchio's own reading with mimic joints; in any order of the file, and one after the other."""
    for _ in range(40):
        kinds = rng.choice(["revolute", "prismatic"], size=3)
        numbers = rng.uniform(-1.5, 1.5, size=(2, 2)).round(3)
        hand = [
            joint("drive", "3", "A", kinds[0]),  # Pinocchio goes by names: it needs the leader first
            joint("first", "3", "F", kinds[1], mimic=follows("drive", *numbers[0])),
            joint("second", "F", "S", kinds[2], mimic=follows("drive", *numbers[1])),
        ]
        file.write_text(arm_with(*hand))
        whole = pin.buildModelFromUrdf(str(file), True)
        file.write_text(arm_with(*[hand[i] for i in rng.permutation(3)]))
        x, q = float(rng.uniform(-1, 1)), rng.uniform(-1, 1, size=3)
        arm = Arm.from_urdf("a", file, tool_frame="3", locked_joints={"drive": x})
        assert list(arm.model.names)[1:] == ["a1", "a2", "a3"]
        for link in "AFS":
            expected = place(whole, link, [*q, x])
            np.testing.assert_allclose(place(arm.model, link, q), expected, rtol=0, atol=1e-12)
        alone = Arm.from_urdf("a", file, tool_frame="3")
        np.testing.assert_allclose(place(alone.model, "S", q), place(whole, "S", [*q, 0.0]), rtol=0, atol=1e-12)


def test_a_line_of_followers(file: Path) -> None:
    hand = (
        joint("c", "3", "C", mimic=follows("b", 2, 0.1)),
        joint("b", "3", "B", mimic=follows("drive", -1, 0.2)),
        joint("drive", "3", "L", low=0.3),
    )
    file.write_text(arm_with(*hand))
    plain = pin.buildModelFromUrdf(str(file))
    for locked, at in (({}, 0.3), ({"drive": 0.5}, 0.5)):
        arm = Arm.from_urdf("a", file, tool_frame="3", locked_joints=locked)
        q = pin.neutral(plain)
        q[plain.joints[plain.getJointId("c")].idx_q] = 2 * (0.2 - at) + 0.1
        np.testing.assert_allclose(place(arm.model, "C", np.zeros(3)), place(plain, "C", q), rtol=0, atol=1e-12)
    assert guess_tool(file).locked == {"drive": 0.3}


def test_a_linkage_that_moves_the_tool_is_refused_with_the_truth(file: Path) -> None:
    file.write_text(arm_with(joint("bent", "3", "4", mimic=follows("a2", -1)), joint("a5", "4", "5")))
    for locked in (None, {"bent": 0.0}, {"bent": 0.4, "a1": 0.0}):
        with pytest.raises(ModelError, match="'bent' follows joint 'a2', which moves the tool with it") as caught:
            Arm.from_urdf("a", file, tool_frame="5", locked_joints=locked)
        assert "{" not in str(caught.value), "no line to copy: locked alone it would be another arm"
    with pytest.raises(ModelError, match="'bent' follows joint 'a2'"):
        Robot(file, {"one": "2", "two": "5"})
    whole = pin.buildModelFromUrdf(str(file), True)
    arm = Arm.from_urdf("a", file, tool_frame="5", locked_joints={"a2": 0.7})
    assert list(arm.model.names)[1:] == ["a1", "a3", "a5"]
    np.testing.assert_allclose(
        place(arm.model, "5", [0.1, 0.2, 0.3]), place(whole, "5", [0.1, 0.7, 0.2, 0.3]), rtol=0, atol=1e-12
    )
    with pytest.raises(ModelError, match=r"'bent' .* stands at -0\.7 where that one is locked at 0\.7, not at 0\."):
        Arm.from_urdf("a", file, tool_frame="5", locked_joints={"a2": 0.7, "bent": 0.0})


def test_a_bar_that_follows_the_arm_is_no_part_that_stands(file: Path) -> None:
    file.write_text(arm_with(joint("bar", "0", "B", mimic=follows("a2"))))
    for locked in (None, {"bar": 0.0}):
        with pytest.raises(ModelError, match=r"'bar' follows joint 'a2', which moves the tool\. .*fixed joint"):
            Arm.from_urdf("a", file, tool_frame="3", locked_joints=locked)
    assert Arm.from_urdf("a", file, tool_frame="1").model.nv == 2, "a1 and a3: a2 and the bar stand"


def test_a_tool_on_a_finger_needs_a_place(file: Path) -> None:
    file.write_text(arm_with(joint("drive", "3", "A"), joint("tip", "3", "T", mimic=follows("drive", 2))))
    with pytest.raises(ModelError, match=r"'tip' follows joint 'drive' and moves the tool\. Lock 'drive'"):
        Arm.from_urdf("a", file, tool_frame="T")
    whole = pin.buildModelFromUrdf(str(file), True)
    for locked in ({"drive": 0.2}, {"drive": 0.2, "tip": 0.4}):
        arm = Arm.from_urdf("a", file, tool_frame="T", locked_joints=locked)
        np.testing.assert_allclose(place(arm.model, "T", np.zeros(3)), place(whole, "T", [0, 0, 0, 0.2]), atol=1e-12)


@pytest.mark.parametrize(
    ("mimic", "says"),
    [
        (follows("nobody"), r"'f' follows 'nobody', which is no moving joint .*Say where it stands"),
        (follows("f"), "'f' follows itself"),
        (follows("g"), "'f' follows itself|'g' follows itself"),
        (follows("a1", "two"), "mimic element of joint 'f' has bad numbers"),
        (follows("a1", "nan"), "mimic element of joint 'f' needs a joint and finite numbers"),
        ("<mimic/>", "mimic element of joint 'f' needs a joint"),
    ],
)
def test_followers_of_nobody(file: Path, mimic: str, says: str) -> None:
    file.write_text(arm_with(joint("f", "3", "F", mimic=mimic), joint("g", "3", "G", mimic=follows("f"))))
    with pytest.raises(ModelError, match=f"arm 'a': .*({says})"):
        Arm.from_urdf("a", file, tool_frame="3")


def test_a_follower_of_nobody_can_be_said_to_stand(file: Path) -> None:
    file.write_text(arm_with(joint("f", "3", "F", mimic=follows("nobody"))))
    assert Arm.from_urdf("a", file, tool_frame="3", locked_joints={"f": 0.1}).model.nv == 3
