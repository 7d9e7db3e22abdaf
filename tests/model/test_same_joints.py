"""A robot with two arms that is given as two arms: no joint gets two commands, and none is certified."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from torsos import two_arms

from coopqp import Arm, InvalidInputError, RobotCell
from coopqp.cli.main import main
from coopqp.model import CellState
from coopqp.scenarios import SCENARIOS

#: Torsos of ten robots: kind and axis of each joint, from the base up.
TORSOS: tuple[tuple[tuple[str, str], ...], ...] = (
    (("prismatic", "0 0 1"),),
    (("revolute", "0 0 1"),),
    (("continuous", "0 0 1"),),
    (("revolute", "0 1 0"),),
    (("prismatic", "0 0 1"), ("revolute", "0 0 1")),
    (("revolute", "0 0 1"), ("revolute", "0 1 0")),
    (("continuous", "0 0 1"), ("prismatic", "0 0 1")),
    (("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1")),
    (("revolute", "0.6 0 0.8"),),
    (("revolute", "1 0 0"), ("revolute", "0 1 0"), ("revolute", "0 0 1")),
)


def arm_of(side: str, file: Path, **options: Any) -> Arm:
    return Arm.from_urdf(side, file, tool_frame=f"{side}_link_5", geometry=False, **options)


@pytest.mark.parametrize("torso", TORSOS)
def test_a_torso_of_two_arms_is_refused_by_name(torso: tuple[tuple[str, str], ...], tmp_path: Path) -> None:
    file = tmp_path / "both.urdf"
    file.write_text(two_arms(torso))
    base = pin.exp6(np.array([0.3, -0.2, 0.1, 0.2, 0.5, -0.4]))
    left, right = (arm_of(side, file, T_world_base=base) for side in ("left", "right"))
    with pytest.raises(InvalidInputError, match=r"torso_0.* arms 'left' and 'right'.*Lock .*locked_joints=\{'torso_0'"):
        RobotCell([left, right])
    names = [f"torso_{i}" for i in range(len(torso))]
    held = dict.fromkeys(names, 0.2)
    locked = [arm_of(side, file, T_world_base=base, locked_joints=held) for side in ("left", "right")]
    with pytest.raises(
        InvalidInputError, match=f"{names[0]}' moves the tool of arm 'left' and is locked in arm 'right'"
    ):
        RobotCell([left, locked[1]])
    other = arm_of("right", file, T_world_base=base, locked_joints={**held, names[-1]: 0.3})
    with pytest.raises(InvalidInputError, match=f"{names[-1]}' .* locked at two positions"):
        RobotCell([locked[0], other])
    cell = RobotCell(locked)  # the remedy in the messages works
    moving = [f"{side}/{side}_{i}" for side in ("left", "right") for i in range(6)]
    assert [name for name in cell.joint_names if not name.endswith("neck")] == moving
    assert set(cell.locked) == {*(f"left/right_{i}" for i in range(6)), *(f"right/left_{i}" for i in range(6)),
                                "right/neck"}  # fmt: skip
    assert "no tool of their arm: they are locked where they stand" in cell.standing_note()
    assert cell.with_limits(acceleration=5.0).joint_names == cell.joint_names


def test_arms_of_a_locked_torso_move_as_the_robot_does(tmp_path: Path, rng: np.random.Generator) -> None:
    """The tools of both arms are where one model of the whole robot has them."""
    file = tmp_path / "both.urdf"
    file.write_text(two_arms(TORSOS[6]))
    held = {"torso_0": 0.7, "torso_1": -0.2}
    cell = RobotCell([arm_of(side, file, locked_joints=held) for side in ("left", "right")])
    robot = pin.buildModelFromUrdf(str(file))
    q, x = pin.neutral(robot), rng.uniform(-1.0, 1.0, cell.nv)
    values = {**held, **{name.partition("/")[2]: value for name, value in zip(cell.joint_names, x, strict=True)}}
    for name, value in values.items():
        at = robot.joints[robot.getJointId(name)]
        q[at.idx_q : at.idx_q + at.nq] = [value] if at.nq == 1 else [np.cos(value), np.sin(value)]
    data = robot.createData()
    pin.framesForwardKinematics(robot, data, q)
    for side, T in zip(("left", "right"), CellState(cell, cell.configuration(x)).T_world_tool, strict=True):
        there = data.oMf[robot.getFrameId(f"{side}_link_5")]
        np.testing.assert_allclose(T.homogeneous, there.homogeneous, rtol=0, atol=1e-13)


def test_arms_beside_each_other_are_two_robots(tmp_path: Path) -> None:
    """The same description at two places has two torsos."""
    file = tmp_path / "both.urdf"
    file.write_text(two_arms(TORSOS[0]))
    beside = pin.SE3(np.eye(3), np.array([0.0, 2.0, 0.0]))
    cell = RobotCell([arm_of("left", file), arm_of("right", file, T_world_base=beside)])
    assert not cell.locked
    assert cell.nv == 2 * 14


def pair(torso: tuple[tuple[str, str], ...], folder: Path, *held: dict[str, float] | None, **options: Any) -> list[Arm]:
    """Both arms of a torso, with joints of each locked."""
    file = folder / "both.urdf"
    file.write_text(two_arms(torso))
    locks = [locked or None for locked in (*held, None, None)][:2]
    return [
        arm_of(side, file, locked_joints=lock, **options) for side, lock in zip(("left", "right"), locks, strict=True)
    ]


@pytest.mark.parametrize(
    ("count", "says"),
    [
        (1, "joint 'torso_0' moves the tools of arms 'left' and 'right': .* so it is one joint of one robot"),
        (2, "joints 'torso_0', 'torso_1' move the tools .* so they are joints of one robot"),
        (6, "joints 'torso_0', .*'torso_5' move the tools"),
        (7, "joints 'torso_0', .*'torso_5' and 1 more move the tools"),
        (8, "joints 'torso_0', .*'torso_5' and 2 more move the tools"),
    ],
)
def test_a_message_names_six_joints_at_most(count: int, says: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=says) as caught:
        RobotCell(pair((("revolute", "0 0 1"),) * count, tmp_path))
    assert f"Lock {'it' if count == 1 else 'them'} in both arms: locked_joints=" in caught.value.remedy
    named = {f"torso_{i}": 0.0 for i in range(min(count, 6))}
    assert str(named) in caught.value.remedy
    assert "'torso_6'" not in str(caught.value)


def test_the_remedy_locks_nearest_to_zero_inside_the_limits(tmp_path: Path) -> None:
    for ends, at in (((0.3, 1.0), 0.3), ((-1.0, -0.2), -0.2), ((-1.0, 1.0), 0.0)):
        file = tmp_path / "both.urdf"
        text = two_arms(TORSOS[0]).replace('lower="-2.9" upper="2.9"', f'lower="{ends[0]}" upper="{ends[1]}"', 1)
        file.write_text(text)
        with pytest.raises(InvalidInputError, match=rf"locked_joints=\{{'torso_0': {at}\}}"):
            RobotCell([arm_of("left", file), arm_of("right", file)])


@pytest.mark.parametrize("torso", TORSOS)
@pytest.mark.parametrize("free", [0, 1])
def test_a_joint_that_is_locked_in_one_arm_alone_is_found_wherever_it_is_locked(
    free: int, torso: tuple[tuple[str, str], ...], tmp_path: Path
) -> None:
    """Whichever of the arms has it free, and whatever comes before it is locked as in the other."""
    last = f"torso_{len(torso) - 1}"
    before = {f"torso_{i}": 0.3 for i in range(len(torso) - 1)}
    sides = ("left", "right")
    for at in (0.0, -1.3):
        held: list[dict[str, float] | None] = [{**before, last: at}, {**before, last: at}]
        held[free] = before or None
        with pytest.raises(InvalidInputError) as caught:
            RobotCell(pair(torso, tmp_path, *held))
        assert (
            f"joint '{last}' moves the tool of arm '{sides[free]}' and is locked in arm '{sides[1 - free]}', "
            "at the same place in the world" in str(caught.value)
        )
        assert f"Lock it in both arms at one position: locked_joints={{'{last}': 0.0}}" in str(caught.value)


def test_joints_that_differ_are_two() -> None:
    """In name, in kind, in axis, or in place by more than a micrometre; not by less."""

    def arm(name: str, joint: str, kind: Any, away: float, hold: float | None = None) -> Arm:
        model, at = pin.Model(), 0
        place = pin.SE3(np.eye(3), np.array([0.1 + away, 0.2, 0.3]))
        at = model.addJoint(at, kind, place, joint)
        at = model.addJoint(at, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5])), f"{name}_own")
        model.addFrame(pin.Frame("tool", at, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        locked = None if hold is None else {joint: hold}
        ends = {"lower_limits": -1.0, "upper_limits": 1.0, "velocity_limits": 1.0}
        return Arm.from_model(name, model, tool_frame="tool", locked_joints=locked, **ends)

    one = arm("a", "lift", pin.JointModelPZ(), 0.0)
    for joint, kind, away in (
        ("rise", pin.JointModelPZ(), 0.0), ("lift", pin.JointModelRZ(), 0.0), ("lift", pin.JointModelPY(), 0.0),
        ("lift", pin.JointModelPZ(), 1.1e-6), ("lift", pin.JointModelPZ(), -0.5),
    ):  # fmt: skip
        assert RobotCell([one, arm("b", joint, kind, away)]).nv == 4
    with pytest.raises(InvalidInputError, match="joint 'lift' moves the tools"):
        RobotCell([one, arm("b", "lift", pin.JointModelPZ(), 0.9e-6)])


def test_a_joint_that_moves_no_tool_of_its_arm_stays_with_the_arm_whose_tool_it_moves(tmp_path: Path) -> None:
    """The left arm's joints in the right arm's model are locked; the neck, which moves neither tool, in the second."""
    lift = {"torso_0": 0.25}
    left, right = pair(TORSOS[0], tmp_path, lift, lift)
    for arms in ([left, right], [right, left]):
        cell = RobotCell(arms)
        first, second = cell.arm_names
        assert cell.nv == 13
        assert set(cell.locked) == {
            *(f"{first}/{second}_{i}" for i in range(6)), *(f"{second}/{first}_{i}" for i in range(6)), f"{second}/neck"
        }  # fmt: skip
        assert f"{first}/neck" in cell.joint_names
        for arm in cell.arms:
            assert len(arm.limits.velocity) == arm.model.nv
            names = list(arm.model.names)[1:]
            assert [name for name in names if name != "neck"] == [f"{arm.name}_{i}" for i in range(6)]
    alone = RobotCell([left])
    assert alone.locked == ()
    assert alone.nv == 13
    note = alone.standing_note()
    assert note.startswith("left/neck, left/right_0, left/right_1 and 4 more move no tool of their arm: they are")


CELL = """name = "torso"
[[arms]]
name = "left"
urdf = "both.urdf"
tool_frame = "left_link_5"
limits = { acceleration_deg_per_s2 = ACCELERATIONS }

[[arms]]
name = "right"
urdf = "both.urdf"
tool_frame = "right_link_5"
limits = { acceleration_deg_per_s2 = ACCELERATIONS }

[grasp]
kind = "tools"
tools.left = { xyz_m = [0, 0.2, 0] }
tools.right = { xyz_m = [0, -0.2, 0] }
[path]
kind = "line"
start = { xyz_m = [0.5, 0, 0.9] }
displacement = { translation_m = [0.05, 0.0, 0.05] }
duration_s = 0.2
"""


@pytest.mark.parametrize("command", slow_but_first([["check"], ["plan", "--out", "made"], ["run"]]))
def test_every_command_refuses_a_torso_with_two_commands(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if command[0] == "plan":
        pytest.importorskip("toppra")
    monkeypatch.chdir(tmp_path)
    Path("both.urdf").write_text(two_arms(TORSOS[1]))
    text = CELL.replace("ACCELERATIONS", "300")
    Path("cell.toml").write_text(text)
    assert main([command[0], "cell.toml", *command[1:]]) == 2
    said = capsys.readouterr().err
    assert "joint 'torso_0' moves the tools of arms 'left' and 'right'" in said
    assert 'Lock it in both arms: locked_joints_rad = {"torso_0" = 0.0}' in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["both.urdf", "cell.toml"]
    Path("cell.toml").write_text(text.replace("[[arms]]", "[[arms]]\nlocked_joints_rad = { torso_0 = 0.0 }"))
    assert main([command[0], "cell.toml", *command[1:]]) == 0
    told = capsys.readouterr()
    assert "are locked where they stand" in told.out + told.err


@pytest.mark.skipif(importlib.util.find_spec("cmeel") is None, reason="the extra robots")
@pytest.mark.parametrize(
    ("robot", "tools"),
    [
        ("tiago_pro_description/robots/tiago_pro.urdf", ("arm_left_7_link", "arm_right_7_link")),
        ("pr2_description/urdf/pr2.urdf", ("l_wrist_roll_link", "r_wrist_roll_link")),
        ("talos_data/robots/talos_reduced.urdf", ("arm_left_7_link", "arm_right_7_link")),
    ],
)
def test_known_robots_with_one_torso_are_refused(robot: str, tools: tuple[str, str]) -> None:
    shared = Path(sys.prefix) / f"lib/python3.{sys.version_info[1]}/site-packages/cmeel.prefix/share"
    file = shared / "example-robot-data/robots" / robot
    if not file.exists():
        pytest.skip("the extra robots is not installed")
    whole = pin.buildModelFromUrdf(str(file), True)
    mimics = [n for n, j in zip(whole.names, whole.joints, strict=True) if "Mimic" in j.shortname()]
    locked = dict.fromkeys(mimics, 0.0)
    arms = [
        Arm.from_urdf(side, file, tool_frame=tool, geometry=False, locked_joints=locked, velocity_limits=2.0)
        for side, tool in zip(("left", "right"), tools, strict=True)
    ]
    with pytest.raises(InvalidInputError, match=r"torso.*Lock"):
        RobotCell(arms)


def test_shipped_cells_have_no_joint_twice() -> None:
    for name, make in SCENARIOS.items():
        with contextlib.suppress(ImportError):  # robots of extras
            cell = make(**({"geometry": False} if name in ("panda_bar", "ur5_table") else {})).cell
            assert not cell.locked, name
