"""Bases of robots whose arms share joints: one base for all its arms, judged by one model of the whole robot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from torsos import lift_cell, two_arms

from coopqp import Arm, CollisionScene, Grasp, InvalidInputError, LinePath, Robot, RobotCell, check_path
from coopqp.cli import main as cli
from coopqp.model.batch import ArmKinematics
from coopqp.planning.remedies import with_remedies
from coopqp.scenarios import robot_path, torso_lift
from coopqp.spatial import Array
from coopqp.studies import CellPlaced, Placer, StudyError, load_place_study


def level(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


RISE = LinePath(level(0.55, 0.0, 0.2), level(0.55, 0.0, 1.7), duration=8.0)


def placer_of(path: LinePath = RISE) -> Placer:
    return Placer(*lift_cell(), path)


def whole_tools(placed: CellPlaced, x: Array, placer: Placer) -> list[pin.SE3]:
    """Where the tools are at joint positions (nv,) of the cell, by one model of the whole robot on its base."""
    model = pin.buildModelFromUrdf(str(robot_path("lift2")))
    data, q = model.createData(), pin.neutral(model)
    for name, value in zip(placer.cell.joint_names, x, strict=True):
        joint = model.joints[model.getJointId(name.partition("/")[2])]
        q[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
    pin.framesForwardKinematics(model, data, q)
    return [placed.bases[0] * data.oMf[model.getFrameId(arm.tool_frame)] for arm in placer.cell.arms]


@pytest.mark.parametrize("base", [level(0.0, 0.0, 0.0), level(0.1, 0.03, 0.05), level(0.0, 0.05, 0.2)])
def test_what_is_placed_is_followed_by_one_robot(base: pin.SE3) -> None:
    """The motion behind the figures: the tools are on the object, inside the limits, with the least margin told."""
    placer = placer_of()
    placed = placer.cell_at([base, base], quick=False)
    assert placed.feasible
    found = placer._placed(0, base, quick=False)
    x = placer._way(placed.bases, placed.arms, [found.way, found.way])
    limits = placer.cell.limits
    assert (x >= limits.lower - 1e-9).all()
    assert (x <= limits.upper + 1e-9).all()
    for row, T in zip(x[::7], placer.samples.poses[::7], strict=True):
        for tool, X in zip(whole_tools(placed, row, placer), placer.grasp.T_object_tool, strict=True):
            np.testing.assert_allclose((T * X).homogeneous, tool.homogeneous, rtol=0, atol=1e-8)
    for k, arm in enumerate(placed.arms):
        own = placer.cell.columns[k][placer.arms[k].columns]
        room = np.minimum(x - limits.lower, limits.upper - x)[:, own]
        j = placer.arms[k].joints.index(arm.tightest)
        assert room[:, j].min() == pytest.approx(arm.margin, abs=1e-9)
        J = ArmKinematics(placer.cell.arms[k].placed(base)).jacobians(x[:, own])
        assert np.linalg.svd(J, compute_uv=False)[:, -1].min() == pytest.approx(arm.sigma_min, abs=1e-9)
    speed = (np.abs(np.diff(x, axis=0)) / limits.velocity).max(axis=1).sum()
    assert placed.time_s == pytest.approx(speed, rel=1e-9)
    assert "joints that arms share: lift/lift from" in placed.explain()


@pytest.mark.slow
def test_the_check_of_the_cell_built_there_agrees() -> None:
    cell, grasp = lift_cell()
    placer = Placer(cell, grasp, RISE)
    for base in (level(0.1, 0.0, 0.05), level(-0.1, 0.0, 0.1), level(0.6, 0.0, 0.0), level(0.0, 0.3, 0.0)):
        built = RobotCell([arm.placed(base) for arm in cell.arms])
        assert placer.cell_at([base, base], quick=False).follows is check_path(built, grasp, RISE).feasible


@pytest.mark.slow
def test_the_robot_moves_as_a_whole() -> None:
    placer = placer_of()
    with pytest.raises(InvalidInputError, match="arms of robot 'lift' on several bases"):
        placer.cell_at([level(0.0, 0.0, 0.0), level(0.1, 0.0, 0.0)])
    far = placer.cell_at([level(-0.2, 0.0, 0.0)] * 2)
    assert not far.follows
    assert "left" in far.why
    (text,) = placer.remedies(far)
    assert text.startswith("robot lift needs ")
    assert text.endswith(" cm more toward the object")
    moved = level(-0.2 + 0.01 * float(text.split()[3]), 0.0, 0.0)
    assert placer.cell_at([moved, moved], quick=False).follows
    nowhere = placer.cell_at([level(0.0, 0.0, 3.0)] * 2)
    assert "which share joints" in nowhere.why


def test_moving_the_robot_and_the_path_together_changes_nothing() -> None:
    rng = np.random.default_rng(5)
    T = pin.SE3(pin.utils.rotate("z", float(rng.uniform(-3, 3))), rng.normal(size=3))
    other = placer_of(LinePath(T * RISE.start, T * RISE.goal, duration=8.0))
    a, b = placer_of().cell_at([level(0.0, 0.0, 0.0)] * 2), other.cell_at([T, T])
    np.testing.assert_allclose([arm.shares for arm in a.arms], [arm.shares for arm in b.arms], atol=1e-6)
    assert a.time_s == pytest.approx(b.time_s, abs=1e-9)
    assert a.shared == b.shared


def test_distances_are_those_of_the_robot_built_there() -> None:
    """Links of the lift, and what stands on its base, move with the robot."""
    lift = torso_lift()
    placer, base = Placer.of(lift), level(0.1, 0.02, 0.05)
    placed = placer.cell_at([base, base])
    assert placed.follows
    built = RobotCell([arm.placed(base) for arm in lift.cell.arms])
    scene = CollisionScene.of(lift, cell=built)
    way = placer._placed(0, base, quick=True).way
    x = placer._way(placed.bases, placed.arms, [way, way])
    least = min(scene.distances(built.configuration(row))[0].distance for row in x)
    assert placed.clearance == pytest.approx(least, abs=1e-6)


def test_a_robot_without_shared_joints_has_one_base_too(tmp_path: Path) -> None:
    file = tmp_path / "both.urdf"
    file.write_text(two_arms(()), encoding="utf-8")
    tools = {side: f"{side}_link_5" for side in ("left", "right")}
    grasp = Grasp((level(0.0, 0.2, 0.0), level(0.0, -0.2, 0.0)))
    path = LinePath(level(0.6, 0.0, 0.5), level(0.6, 0.0, 0.7), duration=2.0)
    one = RobotCell([Robot(file, tools, name="both", geometry=False)])
    two = RobotCell([Arm.from_urdf(side, file, tool_frame=tool, geometry=False) for side, tool in tools.items()])
    assert one.bases == ((0, 1),)
    assert two.bases == ((0,), (1,))
    bases = [level(0.0, 0.05, 0.0)] * 2
    a, b = Placer(one, grasp, path).cell_at(bases), Placer(two, grasp, path).cell_at(bases)
    assert [arm.shares for arm in a.arms] == [arm.shares for arm in b.arms]
    far = LinePath(level(1.1, 0.0, 0.5), level(1.1, 0.0, 0.7), duration=2.0)
    kinds = {remedy.kind: remedy for remedy in with_remedies(check_path(one, grasp, far)).remedies}
    assert "robot both" in kinds["base"].text


STUDY = """
name = "where the lift stands"
cell = "cell.toml"
axes = {{ x = {{ low = -0.2, high = 0.0, number = 2, now = -0.2 }} }}
[[bases]]
{base}
xyz_m = ["x", 0, 0]
yaw_deg = 0
"""


def study(folder: Path, base: str = 'robot = "lift"') -> Path:
    cell = Path(robot_path("lift2")).parents[1] / "cells" / "torso_lift.toml"
    (folder / "cell.toml").write_text(cell.read_text(encoding="utf-8"), encoding="utf-8")
    file = folder / "place.toml"
    file.write_text(STUDY.format(base=base), encoding="utf-8")
    return file


@pytest.mark.slow
def test_the_command_places_a_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert cli.main(["place", str(study(tmp_path)), "--out", str(out)]) == 3  # as built it is impossible
    printed = capsys.readouterr().out
    assert "robot lift needs" in printed
    assert "joints that arms share: lift/lift from" in printed
    best = json.loads((out / "place.json").read_text(encoding="utf-8"))["best"]
    assert best["feasible"]
    assert best["shared"][0].startswith("lift/lift from")
    assert list(best["bases"]) == ["lift"]
    text = (tmp_path / "cell.toml").read_text(encoding="utf-8")
    matrix = best["bases"]["lift"]["matrix"]
    (tmp_path / "there.toml").write_text(
        text.replace('robot = "lift2"', f'robot = "lift2"\nbase = {{ matrix = {matrix} }}'), encoding="utf-8"
    )
    assert cli.main(["check", str(tmp_path / "there.toml")]) == 0
    assert matrix[0][3] == best["values"]["x"]


@pytest.mark.parametrize(
    ("base", "said"),
    [
        ('arm = "left"', "stands on the base of robot 'lift', which moves as a whole. Give robot = \"lift\""),
        ('robot = "lifd"', "no robot named 'lifd' in bases. Did you mean 'lift'?"),
        ('robot = "lift"\narm = "left"', "arm"),
        ("", "arm"),
    ],
)
def test_a_base_that_is_no_robots_is_refused_by_name(base: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"place\.toml") as caught:
        load_place_study(study(tmp_path, base))
    assert said in str(caught.value)


def test_a_robot_with_two_tables_is_refused(tmp_path: Path) -> None:
    file = study(tmp_path)
    table = '[[bases]]\nrobot = "lift"\nxyz_m = [0, 0, 0]\n'
    file.write_text(file.read_text(encoding="utf-8") + table, encoding="utf-8")
    with pytest.raises(StudyError, match="a robot has two tables"):
        load_place_study(file)
