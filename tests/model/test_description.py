"""Robot descriptions: what is refused before a parser reads it, and where meshes are looked for."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

from coopqp import Arm
from coopqp.errors import ModelError
from coopqp.model.description import (
    MAX_NESTING,
    check_mjcf,
    description_file,
    find_package,
    mesh_folders,
    read_urdf,
)


@pytest.fixture(autouse=True)
def _no_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)


def made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def test_a_package_is_found_where_ros_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    near = made(tmp_path / "elsewhere/deep/urdf")
    assert find_package("arm_description", near) is None
    installed = made(tmp_path / "install/share/arm_description")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", "/nowhere", str(tmp_path / "install")]))
    assert find_package("arm_description", near) == installed
    sources = made(tmp_path / "src/arm_description")
    monkeypatch.setenv("ROS_PACKAGE_PATH", os.pathsep.join(["", str(tmp_path / "src")]))
    assert find_package("arm_description", near) == sources, "before what is installed"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(sources))
    assert find_package("arm_description", near) == sources, "the folder itself is on the path"
    beside = made(tmp_path / "elsewhere/arm_description")
    assert find_package("arm_description", near) == beside, "above the file, before the environment"
    given = made(tmp_path / "mine/arm_description")
    assert find_package("arm_description", near, [tmp_path / "mine"]) == given, "what is given comes first"
    (tmp_path / "elsewhere/deep/tool").write_text("a file, no folder")
    assert find_package("tool", near) is None


def test_a_package_around_the_file_is_found_six_folders_up(tmp_path: Path) -> None:
    package = made(tmp_path / "arm_description")
    assert find_package("arm_description", made(package / "urdf")) == package
    assert find_package("arm_description", made(tmp_path / "1/2/3/4/5/6")) == package
    assert find_package("arm_description", made(tmp_path / "a/b/c/d/e/f/g")) is None


def test_each_folder_of_meshes_is_listed_once_and_those_given_first(tmp_path: Path) -> None:
    for name in ("arm", "hand"):
        made(tmp_path / name / "meshes")
    text = (
        '<mesh filename="package://arm/meshes/a.stl"/><mesh filename="package://arm/b.stl"/>'
        "<mesh filename='package://hand/meshes/a.stl'/><mesh filename=\"package://missing/a.stl\"/>"
    )
    file = tmp_path / "arm.urdf"
    beside = str(file.parent.resolve())
    root = ElementTree.fromstring(f"<robot>{text}</robot>")
    assert mesh_folders(root, file, []) == [str(tmp_path), *([beside] if beside != str(tmp_path) else [])]
    found = mesh_folders(root, file, ["/given", tmp_path / "x"])
    assert found[:3] == ["/given", str(tmp_path / "x"), str(tmp_path)]
    assert mesh_folders(ElementTree.fromstring('<robot><mesh filename="a.stl"/></robot>'), file, []) == [beside]


def test_a_xacro_is_refused_with_the_command_that_expands_it(tmp_path: Path) -> None:
    for name, text in (
        ("arm.urdf.xacro", '<robot name="a"/>'),
        ("arm.xacro", '<robot name="a"/>'),
        ("arm.urdf", '<robot name="a"><xacro:macro name="m"/></robot>'),
        ("arm.urdf", '<robot name="a"><link name="${prefix}b"/></robot>'),
        ("arm.xml", '<robot name="a"><xacro:include filename="m"/></robot>'),
    ):
        file = tmp_path / name
        file.write_text(text)
        to = "expanded_arm.urdf" if name == "arm.urdf" else "arm.xml.urdf" if name == "arm.xml" else "arm.urdf"
        with pytest.raises(ModelError, match=rf"arm 'left': .*{name} is a xacro.*: xacro {name} > {to}$"):
            read_urdf(file, "left")  # a shell empties the file that it writes to: never the one that xacro reads


def test_the_call_of_a_macro_that_is_left_over_is_skipped(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    for head in ("", ' xmlns:xacro="http://ros.org/wiki/xacro"'):
        file.write_text(f'<robot name="a"{head}><link name="b"/><xacro:gazebo_colours prefix=""/></robot>')
        assert read_urdf(file, "left").get("name") == "a"


def test_the_root_of_a_urdf_is_a_robot_with_a_name(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text('<robot name="a"><link name="b"/><robot/></robot>')
    assert [element.tag for element in read_urdf(file, "left")] == ["link", "robot"]
    for text in ("<robot/>", '<robot name=""/>', '<model name="a"/>'):
        file.write_text(text)
        with pytest.raises(ModelError, match="its root is no <robot name=…>"):
            read_urdf(file, "left")
    for text in ("", "<robot", '<robot name="a">', '<?xml version="1.0" encoding="odd"?><robot name="a"/>'):
        file.write_text(text)
        with pytest.raises(ModelError, match=r"arm 'left': .*arm\.urdf is not a readable URDF \("):
            read_urdf(file, "left")


def test_elements_are_nested_five_hundred_deep_at_most(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    beside = "<b/>" * 2 * MAX_NESTING  # counts as one
    for depth, fits in ((MAX_NESTING - 1, True), (MAX_NESTING, False)):
        file.write_text(f"<mujoco>{'<b>' * (depth - 1)}{beside}{'</b>' * (depth - 1)}</mujoco>")
        if fits:
            check_mjcf(file, "left")
            continue
        with pytest.raises(ModelError, match=r"arm 'left': the elements of .*arm\.xml are nested more than 500 deep"):
            check_mjcf(file, "left")


def test_entities_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text('<!DOCTYPE a [<!ENTITY b "c">]><mujoco>&b;</mujoco>')
    with pytest.raises(ModelError, match=r"arm 'left': .* declares XML entities"):
        check_mjcf(file, "left")
    file.write_text("no XML")  # its reader reports that
    check_mjcf(file, "left")


def test_a_path_of_a_description_is_a_file(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text("")
    assert description_file(str(file), "left") == file
    for bad, says in (
        (tmp_path, "it is a folder"),
        (None, "None is not a path"),
        ("\0" + "x" * 100, "no path of a file"),
    ):
        with pytest.raises(ModelError, match=f"arm 'left': .*({says})"):
            description_file(bad, "left")  # type: ignore[arg-type]


def test_soft_limits_count_where_they_are_narrower(tmp_path: Path) -> None:
    """Of a file of ranges and soft limits: the narrower of both, unless that leaves no room or is no number."""
    file = tmp_path / "arm.urdf"
    for soft, expected in (
        ('soft_lower_limit="-0.5" soft_upper_limit="0.7"', (-0.5, 0.7)),
        ('soft_lower_limit="-5" soft_upper_limit="0.7"', (-1.0, 0.7)),
        ('soft_lower_limit="-0.5"', (-0.5, 1.0)),
        ('k_position="15"', (-1.0, 1.0)),
        ('soft_lower_limit="0" soft_upper_limit="0"', (-1.0, 1.0)),
    ):
        file.write_text(
            '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
            '<child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
            f'<safety_controller k_velocity="1" {soft}/></joint></robot>'
        )
        arm = Arm.from_urdf("a", file, tool_frame="b")
        assert (arm.limits.lower[0], arm.limits.upper[0]) == expected
        assert (arm.model.lowerPositionLimit[0], arm.model.upperPositionLimit[0]) == expected
        assert Arm.from_urdf("a", file, tool_frame="b", lower_limits=-0.9).limits.lower[0] == -0.9


def test_meshes_beside_a_urdf_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "arm" / "meshes").mkdir(parents=True)
    (tmp_path / "arm" / "meshes" / "a.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\n"
    )
    shape = '<collision><geometry><mesh filename="meshes/a.obj"/></geometry></collision>'
    file = tmp_path / "arm" / "arm.urdf"
    file.write_text(
        f'<robot name="r"><link name="a"/><link name="b">{shape}</link><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit velocity="1" effort="1"/></joint></robot>'
    )
    monkeypatch.chdir(tmp_path)
    for given in ((), (tmp_path,)):
        arm = Arm.from_urdf("a", "arm/arm.urdf", tool_frame="b", package_dirs=given)
        assert arm.collision is not None
        assert arm.collision.ngeoms == 1


def test_white_space_before_the_declaration_is_no_fault(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text('\n<?xml version="1.0"?><robot name="a"/>')
    assert read_urdf(file, "left").get("name") == "a"


def test_a_link_keeps_its_name_beside_a_fixed_joint_of_that_name(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(
        '<robot name="a"><link name="world"/><link name="base"/><link name="tip"/><joint name="base" type="fixed">'
        '<parent link="world"/><child link="base"/></joint><joint name="j" type="continuous"><parent link="base"/>'
        '<child link="tip"/><axis xyz="0 0 1"/><limit velocity="1" effort="1"/></joint></robot>'
    )
    model = Arm.from_urdf("a", file, tool_frame="tip").model
    kinds = {frame.name: str(frame.type) for frame in model.frames}
    assert kinds["base"] == "BODY"
    assert kinds["base (fixed_joint)"] == "FIXED_JOINT"
