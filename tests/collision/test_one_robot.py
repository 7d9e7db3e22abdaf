"""Arms of one description: its fixed links are there once, its SRDF holds across arms, what rests keeps nothing."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, CollisionScene, Grasp, Robot, RobotCell
from coopqp.errors import UnknownNameError
from coopqp.scenarios import robot_path

BASES = {"left": (-0.8, 0.0), "right": (0.8, np.pi)}


def base_of(side: str) -> pin.SE3:
    x, turn = BASES[side]
    return pin.SE3(pin.utils.rotate("z", turn), np.array([x, 0.0, 0.0]))


def add(parent: Any, tag: str, **words: str) -> Any:
    return ElementTree.SubElement(parent, tag, **words)


def with_base(arm: Any) -> Any:
    """The arm with a base that reaches into its first link, as that of every real robot."""
    children = {joint.find("child").get("link") for joint in arm.findall("joint")}
    (root,) = (link for link in arm.findall("link") if link.get("name") not in children)
    if root.find("collision") is None:
        shape = add(root, "collision")
        add(shape, "origin", xyz="0 0 0.1")
        add(add(shape, "geometry"), "cylinder", radius="0.08", length="0.2")
    return root


def side_by_side(one: Any) -> Any:
    """Both arms in one description: a world link, and the arms with a prefix."""
    two = ElementTree.Element("robot", name="pair")
    add(two, "link", name="world")
    root = with_base(one).get("name")
    for side in BASES:
        for item in (item for item in one if item.tag in ("link", "joint")):
            own = copy.deepcopy(item)
            own.set("name", f"{side}_{item.get('name')}")
            for end in (own.find("parent"), own.find("child")):
                if end is not None:
                    end.set("link", f"{side}_{end.get('link')}")
            two.append(own)
        mount = add(two, "joint", name=f"{side}_mount", type="fixed")
        add(mount, "parent", link="world")
        add(mount, "child", link=f"{side}_{root}")
        x, turn = BASES[side]
        add(mount, "origin", xyz=f"{x} 0 0", rpy=f"0 0 {turn!r}")
    return two


def scene(cell: RobotCell, **more: Any) -> CollisionScene:
    grasp = Grasp(tuple(pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (-0.3, 0.3)))
    return CollisionScene(cell=cell, grasp=grasp, **more)


def test_two_arms_keep_the_same_distances_in_one_file_and_in_two(tmp_path: Path) -> None:
    one = ElementTree.parse(robot_path("arm7")).getroot()
    with_base(one)
    files = {"one": tmp_path / "one.urdf", "pair": tmp_path / "pair.urdf"}
    ElementTree.ElementTree(one).write(files["one"])
    ElementTree.ElementTree(side_by_side(one)).write(files["pair"])
    in_two = RobotCell([Arm.from_urdf(s, files["one"], tool_frame="tool", T_world_base=base_of(s)) for s in BASES])
    expected = {frozenset(pair) for pair in scene(in_two).pairs}
    assert expected
    for arms in (
        [Robot(files["pair"], {s: f"{s}_tool" for s in BASES})],
        [Arm.from_urdf(s, files["pair"], tool_frame=f"{s}_tool") for s in BASES],
    ):
        pairs = scene(RobotCell(arms)).pairs
        named = [tuple(n.replace("/left_", "/").replace("/right_", "/") for n in pair) for pair in pairs]
        assert all(n.partition("/")[2].startswith(n.partition("/")[0]) for pair in pairs for n in pair)
        assert {frozenset(pair) for pair in named} == expected
        assert len(named) == len(set(named)) == len(scene(in_two).pairs)


LIMIT = '<limit lower="-2" upper="2" velocity="1" effort="1"/>'


def torso_robot(*, lifted: bool = False) -> str:
    """A torso with a camera and a head that turns, and two arms of seven joints; on a lift or not."""
    ball = '<collision><geometry><sphere radius="0.06"/></geometry></collision>'
    text = f'<robot name="body"><link name="torso">{ball}</link>'

    def joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "0 0 1") -> str:
        return (
            f'<link name="{child}">{ball}</link><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>{LIMIT}</joint>'
        )

    if lifted:
        text += (
            joint("lift", "prismatic", "torso", "chest", "0 0 0.2").replace("torso", "base").replace("chest", "torso")
        )
        text = text.replace(f'<link name="torso">{ball}</link>', f'<link name="base">{ball}</link>', 1)
    text += joint("neck", "revolute", "torso", "head", "0 0 0.05") + joint(
        "mount", "fixed", "torso", "camera", "0 0 0.1"
    )
    for side, y in (("l", 0.3), ("r", -0.3)):
        for i in range(7):
            parent, xyz = (f"{side}{i}", "0 0 0.2") if i else ("torso", f"0 {y} 0")
            text += joint(f"{side}_{i}", "revolute", parent, f"{side}{i + 1}", xyz, f"{i % 2} {1 - i % 2} 0")
    return text + "</robot>"


@pytest.fixture
def body(tmp_path: Path) -> Path:
    file = tmp_path / "body.urdf"
    file.write_text(torso_robot())
    return file


def bodies(body: Path, *, as_robot: bool) -> RobotCell:
    tools = {"left": "l7", "right": "r7"}
    if as_robot:
        return RobotCell([Robot(body, tools)])
    return RobotCell([Arm.from_urdf(name, body, tool_frame=tool) for name, tool in tools.items()])


@pytest.mark.parametrize("as_robot", [True, False])
def test_what_never_moves_to_each_other_keeps_no_distance(body: Path, as_robot: bool) -> None:
    pairs = scene(bodies(body, as_robot=as_robot)).pairs
    links = {frozenset(name.partition("/")[2] for name in pair) for pair in pairs}
    still = {"torso", "head", "camera"}
    assert not [pair for pair in links if pair <= still]
    assert len(links) == len(pairs), "no pair is there a second time under another arm's name"
    for side in "lr":
        assert frozenset(("torso", f"{side}1")) not in links
        assert frozenset(("torso", f"{side}2")) not in links, "nearer than three joints, for both arms"
        assert {frozenset((link, f"{side}{i}")) for link in ("torso", "camera") for i in range(3, 8)} <= links
        assert frozenset(("head", f"{side}7")) in links
    assert {frozenset((f"l{i}", f"r{j}")) for i in range(1, 8) for j in range(1, 8)} <= links


@pytest.mark.parametrize("as_robot", [True, False])
def test_an_srdf_holds_across_the_arms_of_its_robot(body: Path, as_robot: bool) -> None:
    cell = bodies(body, as_robot=as_robot)
    srdf = (
        '<robot name="body"><disable_collisions link1="l4" link2="r5"/><disable_collisions link1="torso" link2="r4"/>'
        '<disable_collisions link1="l1" link2="l5"/></robot>'
    )
    every = set(scene(cell).pairs)
    for given in ({"left": srdf}, {"right": srdf}, {"left": srdf, "right": srdf}):
        gone = {frozenset(n.partition("/")[2] for n in pair) for pair in every - set(scene(cell, srdf=given).pairs)}
        assert gone == {frozenset(("l4", "r5")), frozenset(("torso", "r4")), frozenset(("l1", "l5"))}


def test_an_srdf_holds_for_the_links_that_arms_share(tmp_path: Path) -> None:
    file = tmp_path / "body.urdf"
    file.write_text(torso_robot(lifted=True))
    cell = RobotCell([Robot(file, {"left": "l7", "right": "r7"}, name="body")])
    every = set(scene(cell).pairs)
    assert [pair for pair in every if "body/torso" in pair]
    srdf = '<robot name="body"><disable_collisions link1="torso" link2="r5"/></robot>'
    assert every - set(scene(cell, srdf={"left": srdf}).pairs) == {("body/torso", "right/r5")}


def test_a_link_is_meant_by_the_names_that_it_has_in_each_arm(body: Path) -> None:
    cell = bodies(body, as_robot=True)
    for torso in ("left/torso", "right/torso"):
        ignored = scene(cell, ignored=[(torso, "right/r7")])
        assert not [pair for pair in ignored.pairs if pair[0].endswith("torso") and pair[1] == "right/r7"]
        built = scene(cell, margins={(torso, "left/l7"): 0.123}).built
        wide = [label for label, margin in zip(built.labels, built.margins, strict=True) if margin == 0.123]
        assert [{name.partition("/")[2] for name in label} for label in wide] == [{"torso", "l7"}]
    with pytest.raises(UnknownNameError, match="no body named 'middle/torso'"):
        scene(cell, ignored=[("middle/torso", "right/r7")])


def test_copies_of_one_arm_are_two_robots(body: Path) -> None:
    """The same file at two places: nothing of one is of the other."""
    cell = RobotCell([
        Arm.from_urdf(name, body, tool_frame="l7", T_world_base=pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])))
        for name, x in (("left", 0.0), ("right", 2.0))
    ])  # fmt: skip
    labels = {frozenset(pair) for pair in scene(cell).pairs}
    assert frozenset(("left/torso", "right/l1")) in labels
    assert frozenset(("right/torso", "left/l1")) in labels
