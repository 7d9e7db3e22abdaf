"""Arms and robots of a cell file: units of their limits and locked joints, where their models lie, and their words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import RobotCell, load_cell_file
from coopqp.files.cellfile import load_cell_task
from coopqp.files.cellfile.error import CellFileError
from coopqp.files.cellfile.explain import in_words_of_the_file
from coopqp.files.cellfile.paths import check_inside, resolve
from coopqp.files.cellfile.text import read_tables
from coopqp.files.cellfile.write import file_text
from coopqp.scenarios import robot_path

REST: dict[str, Any] = {
    "name": "arms", "grasp": {"kind": "latched"}, "path": {"kind": "hold", "pose": {}, "duration_s": 1.0},
}  # fmt: skip
GANTRY = [0.25, 0.0, 0.5, 1.5, 0.0, -0.8, 0.0]


def cell_of(folder: Path, arms: list[dict[str, Any]], start: dict[str, Any], robots: Any = ()) -> RobotCell:
    """The arms of a file."""
    tables = REST | {"arms": arms, "start": {"positions_rad": start}} | ({"robots": robots} if robots else {})
    file = folder / "cell.toml"
    file.write_text(file_text([], tables), encoding="utf-8")
    return load_cell_task(file).cell


def arm(**more: Any) -> dict[str, Any]:
    return {"name": "a", "geometry": False, **more}


@pytest.mark.parametrize(
    ("field", "per", "unit"),
    [("lower", "", "m"), ("upper", "", "m"), ("velocity", "_per_s", "m/s"), ("acceleration", "_per_s2", "m/s²")],
)
def test_limits_of_an_arm_have_their_units(field: str, per: str, unit: str, tmp_path: Path) -> None:
    """Degrees and radians of joints that turn, metres of those that slide, under either key."""
    sign = -1.0 if field == "lower" else 1.0
    degrees = [sign * x for x in (2.0, 91.0, 92.0, 170.0, 172.0, 100.0, 173.0)]
    radians = [degrees[0], *np.deg2rad(degrees[1:]).tolist()]
    for key, values in ((f"{field}_deg{per}", degrees), (f"{field}_rad{per}", radians)):
        given = arm(robot="gantry7", limits={key: values})
        found = getattr(cell_of(tmp_path, [given], {"a": GANTRY}).limits, field)
        np.testing.assert_allclose(found, radians, rtol=1e-15)
        with pytest.raises(CellFileError) as caught:
            cell_of(tmp_path, [arm(robot="gantry7", limits={key: sign * 2.0})], {"a": GANTRY})
        assert f"arm 'a': limits.{key}: one number would be for joints that turn and for 'joint_1'" in str(caught.value)
        assert f"which slides [{unit}]. Give a list with one number per joint: 7." in str(caught.value)
    turning = cell_of(tmp_path, [arm(robot="arm7", limits={f"{field}_deg{per}": sign * 172.0})], {"a": [0.5] * 7})
    np.testing.assert_allclose(getattr(turning.limits, field), sign * np.deg2rad(172.0))


def test_a_placement_is_exact_at_quarter_turns_and_kept_elsewhere(tmp_path: Path) -> None:
    """No cosine of 90° of 6e-17; other numbers are those of the angles."""
    for angles in ([0, 0, 90], [90, 0, 180], [0, -90, 0], [270, 90, 0]):
        cell = cell_of(tmp_path, [arm(robot="arm7", base={"rpy_deg": angles})], {"a": [0.1] * 7})
        R = cell.arms[0].T_world_base.rotation
        np.testing.assert_array_equal(R, np.round(R))
        np.testing.assert_allclose(R, pin.rpy.rpyToMatrix(*np.deg2rad(angles)), atol=1e-15)
    small = cell_of(tmp_path, [arm(robot="arm7", base={"rpy_rad": [0.0, 0.0, 1e-9]})], {"a": [0.1] * 7})
    assert small.arms[0].T_world_base.rotation[1, 0] == pytest.approx(1e-9, rel=1e-12)
    bare = cell_of(tmp_path, [arm(robot="arm7")], {"a": [0.1] * 7})
    np.testing.assert_array_equal(bare.arms[0].T_world_base.homogeneous, np.eye(4))


MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="b"><joint name="turn" axis="0 0 1"/>
<geom size="1" mass="1"/><body name="c"><joint name="slide" type="slide" axis="0 0 1"/><geom size="1" mass="1"/>
<body name="tip"><joint name="last" axis="0 1 0"/><geom size="1" mass="1"/></body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("source", ["robot", "urdf", "mjcf"])
def test_joints_are_locked_in_degrees_radians_and_metres(source: str, tmp_path: Path) -> None:
    """As the same joint moved there: the tool's place says it."""
    if source == "mjcf":
        pytest.importorskip("mujoco")
        (tmp_path / "model").write_text(MJCF, encoding="utf-8")
        given, slide, turn, start = arm(mjcf="model", tool_frame="tip"), "slide", "turn", [0.3]
    else:
        (tmp_path / "model").write_bytes(robot_path("gantry7").read_bytes())
        where = {"robot": "gantry7"} if source == "robot" else {"urdf": "model", "tool_frame": "tool"}
        given, slide, turn, start = arm(**where), "joint_1", "joint_3", [0.2, 1.2, 0.3, -0.9, 0.1]
    places, free = [], cell_of(tmp_path, [given], {"a": [0.1] * (len(start) + 2)})
    for locked in (
        {"locked_joints_deg": {slide: 0.3, turn: 30.0}},
        {"locked_joints_rad": {slide: 0.3, turn: np.pi / 6}},
        {"locked_joints_deg": {slide: 0.3}, "locked_joints_rad": {turn: np.pi / 6}},
    ):
        cell = cell_of(tmp_path, [given | locked], {"a": start})
        assert [name for name in free.joint_names if name not in cell.joint_names] == sorted(
            [f"a/{slide}", f"a/{turn}"], key=free.joint_names.index
        )
        places.append(tool_at(cell, dict(zip(cell.joint_names, start, strict=True))))
    whole = dict(zip(cell.joint_names, start, strict=True)) | {f"a/{slide}": 0.3, f"a/{turn}": np.pi / 6}
    for place in places:
        np.testing.assert_allclose(place, tool_at(free, whole), atol=1e-12)
    both = {"locked_joints_deg": {turn: 30.0}, "locked_joints_rad": {turn: 0.5}}
    with pytest.raises(CellFileError, match=f"'a': '{turn}' is in locked_joints_deg and in locked_joints_rad"):
        cell_of(tmp_path, [given | both], {"a": start})
    with pytest.raises(CellFileError, match="no_joint"):
        cell_of(tmp_path, [given | {"locked_joints_deg": {"no_joint": 30.0}}], {"a": start})


def tool_at(cell: RobotCell, x: dict[str, float]) -> Any:
    """The tool's placement where the joints are at positions by name."""
    q = cell.configuration(np.array([x[name] for name in cell.joint_names]))
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, q)
    return data.oMf[cell.tool_frames[0]].homogeneous


LEFT = {"name": "left", "of": "tower", "tool_frame": "left_tool"}
RIGHT = {"name": "right", "of": "tower", "tool_frame": "right_tool"}
AT = {"tower": [0.15], "left": [0.1] * 6, "right": [0.1] * 6}


def tower(**more: Any) -> list[dict[str, Any]]:
    return [{"name": "tower", "robot": "lift2", "geometry": False, **more}]


def test_limits_of_a_robot_are_by_joint_and_the_star_is_for_joints_that_turn(tmp_path: Path) -> None:
    """What is said of one joint goes before what is said of all, wherever it stands."""
    limits = {
        "left_joint_2": {"velocity_deg_per_s": 10.0, "upper_rad": 0.5},
        "lift": {"velocity_deg_per_s": 0.07, "acceleration_rad_per_s2": 0.4, "lower_deg": 0.1, "upper_deg": 1.2},
        "*": {"velocity_deg_per_s": 20.0, "acceleration_rad_per_s2": 3.0, "lower_deg": -150.0},
    }
    cell = cell_of(tmp_path, [LEFT, RIGHT], AT, tower(limits=limits))
    own = cell.joint_names.index("left/left_joint_2")
    velocity = np.full(13, np.deg2rad(20.0))
    velocity[0], velocity[own] = 0.07, np.deg2rad(10.0)
    np.testing.assert_allclose(cell.limits.velocity, velocity)
    np.testing.assert_allclose(cell.limits.acceleration, [0.4, *[3.0] * 12])
    np.testing.assert_allclose(cell.limits.lower, [0.1, *[np.deg2rad(-150.0)] * 12])
    assert (cell.limits.upper[0], cell.limits.upper[own]) == (1.2, 0.5)
    plain = cell_of(tmp_path, [LEFT, RIGHT], AT, tower())
    np.testing.assert_array_equal(np.delete(cell.limits.upper, [0, own]), np.delete(plain.limits.upper, [0, own]))
    for bad, message in (
        (
            {"lft": {"upper_deg": 1.0}},
            r"robot 'tower': limits: the model has no joint 'lft'; joints: lift, left_joint_1",
        ),
        ({"lift": {"upper_deg": [1.0]}}, r"robot 'tower': limits\.lift\.upper_deg: give one number\."),
        ({"*": {"velocity_rad_per_s": [1.0] * 13}}, r"robot 'tower': limits\.\*\.velocity_rad_per_s: give one number"),
        ({"velocity_deg_per_s": 1.0}, r"limits of a robot are by joint: give 'limits\.\"\*\"\.velocity_deg_per_s'"),
    ):
        with pytest.raises(CellFileError, match=message):
            cell_of(tmp_path, [LEFT, RIGHT], AT, tower(limits=bad))


def test_a_robot_stands_and_is_locked_where_its_table_says(tmp_path: Path) -> None:
    base = {"xyz_m": [1.0, 2.0, 0.0], "rpy_deg": [0, 0, 90]}
    start = {name: x for name, x in AT.items() if name != "tower"}
    places = []
    for locked in ({"locked_joints_deg": {"lift": 0.15}}, {"locked_joints_rad": {"lift": 0.15}}):
        cell = cell_of(tmp_path, [RIGHT, LEFT], start, tower(base=base, **locked))
        assert cell.nv == 12
        assert cell.arm_names == ("right", "left")  # in the order of the arms
        places.append(tool_at(cell, dict.fromkeys(cell.joint_names, 0.1)))
    free = cell_of(tmp_path, [RIGHT, LEFT], AT, tower(base=base))
    placed = tool_at(free, dict.fromkeys(free.joint_names, 0.1) | {"tower/lift": 0.15})
    np.testing.assert_allclose(places, [placed] * 2, atol=1e-12)
    still = cell_of(tmp_path, [RIGHT, LEFT], AT, tower())
    T = pin.SE3(pin.utils.rotate("z", np.pi / 2), np.array([1.0, 2.0, 0.0])).homogeneous
    alone = tool_at(still, dict.fromkeys(still.joint_names, 0.1) | {"tower/lift": 0.15})
    np.testing.assert_allclose(placed, T @ alone, atol=1e-12)


def test_a_robot_may_stand_beside_other_arms(tmp_path: Path) -> None:
    own = arm(robot="arm7", base={"xyz_m": [3.0, 0.0, 0.0]})
    cell = cell_of(tmp_path, [LEFT, own, RIGHT], AT | {"a": [0.1] * 7}, tower())
    assert cell.arm_names == ("left", "a", "right")
    assert cell.nv == 20


def test_a_model_is_looked_for_where_the_file_says(tmp_path: Path) -> None:
    """Of an arm and of a robot; a missing one is named with its key."""
    (tmp_path / "packages" / "mine").mkdir(parents=True)
    for name, robot in (("arm", "arm7"), ("lift", "lift2")):
        (tmp_path / "packages" / "mine" / f"{name}.urdf").write_bytes(robot_path(robot).read_bytes())
    dirs = {"package_dirs": ["packages"]}
    alone = arm(urdf="package://mine/arm.urdf", tool_frame="tool")
    assert cell_of(tmp_path, [alone | dirs], {"a": [0.1] * 7}).nv == 7
    pair: dict[str, Any] = {"name": "tower", "geometry": False, "urdf": "package://mine/lift.urdf"}
    assert cell_of(tmp_path, [LEFT, RIGHT], AT, [pair | dirs]).nv == 13
    for tables, robots, message in (
        ([alone], (), r"arm 'a': urdf: there is no package 'mine'"),
        ([alone | {"package_dirs": ["$NO_SUCH"]}], (), r"arm 'a': package_dirs: the environment variable \$NO_SUCH is"),
        ([arm(mjcf="~no_such_user/x.xml", tool_frame="t")], (), r"arm 'a': mjcf: '~no_such_user' has no home folder"),
        ([LEFT, RIGHT], [pair], r"robot 'tower': urdf: there is no package 'mine'"),
        ([LEFT, RIGHT], [pair | {"package_dirs": ["$NO_SUCH"]}], r"robot 'tower': package_dirs: the environment var"),
        ([arm(urdf="none.urdf", tool_frame="t", locked_joints_deg={"j": 1.0})], (), r"none\.urdf"),
    ):
        with pytest.raises(CellFileError, match=message):
            cell_of(tmp_path, tables, AT if robots else {"a": [0.1] * 7}, robots)


# -- stiffness ---------------------------------------------------------------------------------------------------------


def test_one_stiffness_is_no_stiffness_of_joints_that_turn_and_joints_that_slide(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    tables = REST | {"arms": [arm(robot="gantry7", stiffness_nm_per_rad=1e4)]}
    file.write_text(file_text([], tables | {"start": {"positions_rad": {"a": GANTRY}}}), encoding="utf-8")
    with pytest.raises(
        CellFileError, match=r"stiffness_nm_per_rad: one number .* 'joint_1', which slides \[N/m\]\. .* 7"
    ):
        load_cell_file(file)


# -- words and files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("of_the_code", "of_the_file"),
    [
        ("QPOptions: grasp_gain: -3 is outside", "controller: grasp_gain: -3 is outside"),
        ("SupervisionOptions: x; PreviewOptions: y", "controller.supervision: x; controller.preview: y"),
        ("Give locked_joints={'a': 0.5, 'b': -1}", 'Give locked_joints_rad = {"a" = 0.5, "b" = -1}'),
        ("LinePath.displaced: goal", "path: goal"),
        ("Set T_world_base of RobotCell", "Set base of arms"),
        ("the margin of Tolerances, of OsqpSettings", "the margin of verdict, of controller.solver_settings"),
        ("ignored=[['a', 'b']]", "collision.ignored = [['a', 'b']]"),
        ("bad \x1b[2J text", r"bad \x1b[2J text"),
        ("nothing to change", "nothing to change"),
    ],
)
def test_a_message_of_the_code_is_said_in_words_of_the_file(of_the_code: str, of_the_file: str) -> None:
    assert in_words_of_the_file(of_the_code) == of_the_file


def test_a_file_is_read_up_to_its_size_and_depth(tmp_path: Path) -> None:
    """A million bytes of TOML, a hundred thousand of YAML nested 50 deep; no more."""
    for name, most in (("cell.toml", 1_000_000), ("cell.yaml", 100_000), ("cell.yml", 100_000)):
        file = tmp_path / name
        file.write_bytes(b"#" * (most - 1) + b"\n")
        assert not read_tables(file)
        file.write_bytes(b"#" * most + b"\n")
        with pytest.raises(CellFileError, match=f"cannot read .*: it is larger than {most} bytes"):
            read_tables(file)
    file = tmp_path / "deep.yaml"
    file.write_text("[" * 50 + "]" * 50, encoding="utf-8")
    assert read_tables(file)
    file.write_text("\n" + "[" * 51 + "]" * 51, encoding="utf-8")
    with pytest.raises(CellFileError, match="line 2 is nested more than 50 deep"):
        read_tables(file)
    file.write_text("[[1], [2], {a: {b: 3}}]\n" * 1 + "#" * 100, encoding="utf-8")
    assert read_tables(file) == [[1], [2], {"a": {"b": 3}}]
    file.write_text("\n\na: [1,\n", encoding="utf-8")
    with pytest.raises(CellFileError, match=r"deep\.yaml, line \d is not YAML"):
        read_tables(file)


def test_a_path_may_be_written_in_every_form(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PARTS", "in parts")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for text, wanted in (
        ("a/b.urdf", tmp_path / "a/b.urdf"),
        ("../b", tmp_path / "../b"),
        ("/abs/b", Path("/abs/b")),
        ("$PARTS/b", tmp_path / "in parts/b"),
        ("${PARTS}b", tmp_path / "in partsb"),
        ("~/b", tmp_path / "home/b"),
        ("a~b", tmp_path / "a~b"),
    ):
        assert resolve(text, tmp_path, "key") == wanted


@pytest.mark.parametrize(
    ("folder", "inside"),
    [
        ("out/run 1", True), ("a..b", True), ("/out", False), ("\\out", False), ("C:out", False), ("a/../b", False),
        ("a\\..\\b", False), ("..", False), ("~", False), ("a$b", False), ("a~", True),
    ],
)  # fmt: skip
def test_a_folder_of_results_lies_below_the_working_directory(folder: str, inside: bool) -> None:
    assert (check_inside(folder) is None) is inside
