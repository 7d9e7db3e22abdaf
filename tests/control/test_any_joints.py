"""Any joints that Pinocchio reads, in any order, shared by any arms: the chain holds, inside limits, on the path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at
from odd_cells import HUMANOID, ODD_CELLS, arm, arms_on_one_waist, plain_arm, posture, robot, row, turret

from coopqp import HoldPath, LinePath, QPController, RobotCell
from coopqp.collision import Body, Box, Clearance, CollisionScene
from coopqp.errors import ModelError
from coopqp.model import CellState
from coopqp.model.batch import ArmKinematics
from coopqp.paths import JointPath
from coopqp.programs import FollowsJoints, Phase, Program, Travels

DT = 0.01
#: Joints of two arms, six and seven [rad], and a place that the second one's elbow comes to [m].
ELBOW = (-0.58, -0.368, 0.422, 0.115, -0.568, -0.094, -0.029, -0.476, 0.328, -0.541, 0.023, -0.097, 0.122)
POST = np.array([0.065, 0.02, 0.624])


@pytest.mark.parametrize("acceleration", [None, 5.0])
@pytest.mark.parametrize("name", ODD_CELLS)
def test_the_arms_stay_together_inside_their_limits(name: str, acceleration: float | None, tmp_path: Path) -> None:
    """By Pinocchio's kinematics of the commands alone."""
    cell = ODD_CELLS[name](tmp_path)
    cell = cell if acceleration is None else cell.with_limits(acceleration=acceleration)
    q = posture(cell)
    grasp = grasp_at(cell, q)
    start = grasp.carried(CellState(cell, q))[0]
    path = LinePath.displaced(start, translation=(0.01, -0.02, 0.015), rotation=(0.02, 0.0, 0.03), duration=0.5)
    controller = QPController(cell, grasp, path, dt=DT)
    controller.reset(q)
    moving = np.unique(np.concatenate([cell.model.supports[joint] for joint in cell.tool_joints]))[1:] - 1
    standing = np.setdiff1d(np.arange(cell.nv), moving)
    limits, before, moved = cell.limits, np.zeros(cell.nv), 0.0
    for _ in range(30):
        step = controller.step()
        v, q = step.velocity, step.q_next
        assert (np.abs(v) <= limits.velocity * (1.0 + 1e-9)).all()
        assert (np.abs(v - before) <= DT * limits.acceleration * (1.0 + 1e-9)).all()
        assert not v[standing].any()
        moved, before = max(moved, float(np.abs(v).max())), v
        state = CellState(cell, q)
        assert np.abs(grasp.relative_errors(state)).max() < 2e-6
        if name != "five_with_a_turret":  # five joints do not follow every path
            off = pin.log6(path.pose(step.clock_next).actInv(grasp.carried(state)[0])).vector
            assert np.abs(off).max() < 1e-5
    assert moved > 1e-3


def test_a_joint_that_moves_no_tool_changes_nothing(tmp_path: Path) -> None:
    """The same arms without it, and the robot's arms in another order, make the same motion."""
    with_it = ODD_CELLS["one_on_the_first_of_two"](tmp_path)
    without, arms = HUMANOID.replace('type="continuous"', 'type="fixed"'), {"left": "l", "right": "r", "head": "h"}
    backwards = dict(reversed(arms.items()))
    others = [RobotCell([robot(*given, tmp_path)]) for given in ((without, arms), (HUMANOID, backwards))]
    x = dict(zip(with_it.joint_names, with_it.positions(posture(with_it)), strict=True))

    def velocities(cell: RobotCell) -> list[dict[str, float]]:
        q = cell.configuration([x[name] for name in cell.joint_names])
        left = cell.index("left")
        T = CellState(cell, q).T_world_tool[left]
        grasp = grasp_at(cell, q)
        grasp = type(grasp)(tuple(T.actInv(X) for X in CellState(cell, q).T_world_tool))
        path = LinePath.displaced(T, translation=(0.03, -0.02, 0.04), rotation=(0.1, 0.0, 0.05), duration=0.5)
        controller = QPController(cell, grasp, path, dt=DT)
        controller.reset(q)
        return [dict(zip(cell.joint_names, controller.step().velocity, strict=True)) for _ in range(20)]

    expected = velocities(with_it)
    for cell in others:
        for now, then in zip(velocities(cell), expected, strict=True):
            assert now == pytest.approx({name: then[name] for name in now}, abs=1e-9)


def test_an_arm_follows_a_way_of_the_joints_that_move_its_tool(tmp_path: Path) -> None:
    """While it holds nothing, and then takes the object again; a turret between its joints stands."""
    arms = ODD_CELLS["joints_that_move_no_tool"](tmp_path).arms
    third = arm("third", row("j", "base", 6, "0 0 0.1"), "j_link_5", tmp_path, -1.0)
    cell = RobotCell([*arms, third]).with_limits(acceleration=20.0)
    q = posture(cell)
    grasp = grasp_at(cell, q)
    own = [cell.joint_names.index(f"arm/j_{i}") for i in range(6)]
    x = cell.positions(q)[own]
    way, here = JointPath([x, x + 0.1, x], 1.0), grasp.carried(CellState(cell, q))[0]
    program = Program(cell, grasp, [
        Phase("go", arms={"arm": FollowsJoints(way)}, path=HoldPath(here, duration=2.0)),
        Phase("back", arms={"arm": Travels(to=grasp.T_object_tool[0], retreat_m=0.0)}, duration=0.2),
    ])  # fmt: skip
    controller = QPController(cell, grasp, program, dt=DT)
    controller.reset(q)
    away = 0.0
    for _ in range(400):
        step = controller.step()
        x = cell.positions(step.q_next)
        if step.clock_next < way.duration - 1e-9:
            expected = way.at(step.clock_next)[0]
            assert np.abs(x[own] - expected).max() < 1e-5
            away = max(away, float(np.abs(expected - way.at(0.0)[0]).max()))
        assert not step.velocity[[cell.joint_names.index(f"arm/{name}") for name in ("a_base", "a_mast")]].any()
        if step.finished:
            break
    assert step.finished
    assert away > 0.09
    assert np.abs(grasp.relative_errors(CellState(cell, step.q_next))).max() < 1e-5


def test_an_arm_evades_by_the_joints_that_move_its_tool(tmp_path: Path) -> None:
    """A turret on it stands, and the elbow keeps off a post as it does without: the object goes on."""
    made = []
    for kind in ("continuous", "fixed"):
        text = row("j", "base", 7, "0 0 0.1") + turret("a_mast", "j_link_3").replace("continuous", kind)
        cell = RobotCell([plain_arm(tmp_path), arm("arm", text, "j_link_6", tmp_path)]).with_limits(acceleration=5.0)
        x = dict(zip([n for n in cell.joint_names if "mast" not in n], ELBOW, strict=True))
        q = cell.configuration([x.get(name, 0.3) for name in cell.joint_names])
        grasp = grasp_at(cell, q)
        start = grasp.carried(CellState(cell, q))[0]
        path = LinePath.displaced(start, translation=(0.15, 0.15, 0.1), duration=1.0)
        post = Body("post", Box((0.04, 0.04, 0.04)), pin.SE3(np.eye(3), POST))
        on_links = {"arm/j_link_3": [Body("elbow", Box((0.1, 0.1, 0.1)))]}
        scene = CollisionScene(cell=cell, grasp=grasp, obstacles=[post], on_links=on_links)
        controller = QPController(cell, grasp, path, dt=DT, constraints=[Clearance(scene)])
        controller.reset(q)
        steps = [controller.step() for _ in range(60)]
        made.append([dict(zip(cell.joint_names, step.velocity, strict=True)) for step in steps])
    assert "elbow and post" in steps[-1].explain()
    for with_it, without in zip(*made, strict=True):
        assert with_it.pop("arm/a_mast") == 0.0
        assert with_it == pytest.approx(without, abs=1e-7)


def test_too_many_joints_or_arms_are_named(tmp_path: Path) -> None:
    long = arm("eel", row("j", "base", 65, "0 0 0.1"), "j_link_64", tmp_path)
    for cell, words in (
        (RobotCell([long, plain_arm(tmp_path)]), r"arm 'eel': 65 joints move its tool.* 64.*locked_joints"),
        (arms_on_one_waist(tmp_path, 9), r"robot 'whole': 9 arms with 55 joints share.* 8 such arms.*locked_joints"),
    ):
        q = posture(cell)
        grasp = grasp_at(cell, q)
        path = LinePath.displaced(grasp.carried(CellState(cell, q))[0], translation=(0.01, 0.0, 0.0), duration=1.0)
        with pytest.raises(ModelError, match=words):
            QPController(cell, grasp, path, dt=DT)
    with pytest.raises(ModelError, match="arm 'eel': 65 joints"):
        ArmKinematics(long)
