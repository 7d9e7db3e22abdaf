"""A robot with several arms: each joint once, and the chain of arms that share some."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import rx90l
from torsos import held, lift_cell, robot_of, two_arms

from coopqp import Arm, Grasp, InvalidInputError, Robot, RobotCell
from coopqp.errors import UnknownNameError
from coopqp.files.cellfile import load_cell_task
from coopqp.model import CellState
from coopqp.model.chain import Chain, moving_columns, parts
from coopqp.scenarios import robot_path
from coopqp.scenarios.robots import SEVERAL_ARMS
from coopqp.simulation.evaluation.metrics import _sigma_min, tools_and_jacobians
from coopqp.simulation.recording.scene import describe_cell, read_cell

TORSOS: tuple[tuple[tuple[str, str], ...], ...] = (
    (("prismatic", "0 0 1"),),
    (("continuous", "0 0 1"),),
    (("revolute", "0 1 0"),),
    (("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1")),
)
BASE = pin.exp6(np.array([0.3, -0.2, 0.1, 0.2, 0.5, -0.4]))


@pytest.mark.parametrize("torso", TORSOS)
def test_a_robot_moves_as_its_model_does(torso: tuple[tuple[str, str], ...], tmp_path: Path) -> None:
    """Each joint is there once, and tools and Jacobians are those of one model of the whole robot."""
    cell = RobotCell([robot_of(torso, tmp_path, T_world_base=BASE)])
    assert cell.joint_names[: len(torso)] == tuple(f"torso/torso_{i}" for i in range(len(torso)))
    assert len(set(cell.joint_names)) == cell.nv == len(torso) + 1 + 12  # and the neck, which moves no tool
    assert cell.groups == ((0, 1),)
    assert cell.locked == ("right/neck",)  # all else that one arm's model has of the other moves with the other
    np.testing.assert_array_equal(cell.shared, range(len(torso)))
    whole = pin.buildModelFromUrdf(str(tmp_path / "both.urdf"))
    x, q = np.random.default_rng(3).uniform(-1.0, 1.0, cell.nv), pin.neutral(whole)
    at = [whole.joints[whole.getJointId(name.partition("/")[2])] for name in cell.joint_names]
    for j, value in zip(at, x, strict=True):
        q[j.idx_q : j.idx_q + j.nq] = [value] if j.nq == 1 else [np.cos(value), np.sin(value)]
    data = whole.createData()
    pin.computeJointJacobians(whole, data, q)
    pin.framesForwardKinematics(whole, data, q)
    state = CellState(cell, cell.configuration(x))
    for k, side in enumerate(("left", "right")):
        frame = whole.getFrameId(f"{side}_link_5")
        np.testing.assert_allclose(
            state.T_world_tool[k].homogeneous, (BASE * data.oMf[frame]).homogeneous, rtol=0, atol=1e-13
        )
        J = pin.getFrameJacobian(whole, data, frame, pin.LOCAL)[:, [at[j].idx_v for j in cell.columns[k]]]
        moving = np.isin(cell.columns[k], moving_columns(cell)[k])
        np.testing.assert_allclose(state.jacobian(k)[:, moving], J[:, moving], rtol=0, atol=1e-12)
    masses = pin.crba(cell.model, cell.model.createData(), cell.configuration(x))
    assert masses.shape == (cell.nv, cell.nv)


@pytest.mark.parametrize("name", ["lift2", "rail2"])
def test_every_link_weighs_once(name: str) -> None:
    """The weight at each joint is that in the robot's own description, whatever the arms' models were reduced to."""
    whole = pin.buildModelFromUrdf(str(robot_path(name)))
    cell = RobotCell([Robot(robot_path(name), SEVERAL_ARMS[name], name="one", geometry=False)])
    assert pin.computeTotalMass(cell.model) == pytest.approx(pin.computeTotalMass(whole))
    x = np.random.default_rng(3).uniform(-1.0, 1.0, cell.nv)
    own = [whole.joints[whole.getJointId(joint.partition("/")[2])].idx_v for joint in cell.joint_names]
    q = pin.integrate(whole, pin.neutral(whole), x[np.argsort(own)])
    weight = pin.computeGeneralizedGravity(cell.model, cell.model.createData(), cell.configuration(x))
    np.testing.assert_allclose(weight, pin.computeGeneralizedGravity(whole, whole.createData(), q)[own], atol=1e-9)


def test_a_robot_without_shared_joints_is_two_arms(tmp_path: Path) -> None:
    file = tmp_path / "both.urdf"
    file.write_text(two_arms(()))
    tools = {side: f"{side}_link_5" for side in ("left", "right")}
    one = RobotCell([Robot(file, tools, geometry=False, acceleration_limits=5.0)])
    two = RobotCell(
        [Arm.from_urdf(s, file, tool_frame=t, geometry=False, acceleration_limits=5.0) for s, t in tools.items()]
    )
    assert one.joint_names == two.joint_names
    assert one.v_slices == two.v_slices
    assert not one.groups
    q = np.random.default_rng(0).uniform(-1.0, 1.0, one.nq)
    for a, b in zip(CellState(one, q).T_world_tool, CellState(two, q).T_world_tool, strict=True):
        np.testing.assert_array_equal(a.homogeneous, b.homogeneous)
    for field in ("lower", "upper", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(one.limits, field), getattr(two.limits, field))


def test_limits_go_by_the_joints_names(tmp_path: Path) -> None:
    robot = robot_of(TORSOS[0], tmp_path, velocity_limits={"torso_0": 0.1, "left_2": 1.5}, acceleration_limits=4.0)
    cell = RobotCell([robot])
    speed = dict(zip(cell.joint_names, cell.limits.velocity, strict=True))
    assert speed["torso/torso_0"] == 0.1
    assert speed["left/left_2"] == 1.5
    assert speed["right/right_2"] == 2.0
    np.testing.assert_array_equal(cell.limits.acceleration, 4.0)
    other = cell.with_limits(acceleration=np.arange(1.0, cell.nv + 1.0))
    np.testing.assert_array_equal(other.limits.acceleration, np.arange(1.0, cell.nv + 1.0))
    with pytest.raises(UnknownNameError, match="torso_9"):
        robot_of(TORSOS[0], tmp_path, velocity_limits={"torso_9": 0.1})


def test_wrong_robots_are_refused_by_name(tmp_path: Path) -> None:
    robot = robot_of(TORSOS[0], tmp_path)
    left, right = robot.arms
    with pytest.raises(InvalidInputError, match="stand on two bases"):
        RobotCell([left, right.placed(BASE)])
    with pytest.raises(InvalidInputError, match="an arm and a robot are named 'left'"):
        RobotCell([Robot(tmp_path / "both.urdf", {"left": "left_link_5", "r": "right_link_5"}, name="left")])
    with pytest.raises(InvalidInputError, match="arm 'b' of robot 'robot' has 5 joints"):
        RobotCell([Robot(tmp_path / "both.urdf", {"a": "left_link_5", "b": "right_link_4"})])
    with pytest.raises(InvalidInputError, match="no arm"):
        Robot(tmp_path / "both.urdf", {})
    with pytest.raises(UnknownNameError, match="nowhere"):
        Robot(tmp_path / "both.urdf", {"a": "left_link_5", "b": "nowhere"})
    cell = RobotCell([robot])
    with pytest.raises(InvalidInputError, match=r"'left' and 'right' share 'torso_0'.*Lock"):
        cell.refuse_shared("here")


def test_a_recording_keeps_the_robot() -> None:
    cell, _ = lift_cell()
    again = read_cell({"scene": describe_cell(cell)})
    assert again.joint_names == cell.joint_names
    assert again.groups == cell.groups


def test_shapes_of_shared_links_are_there_once() -> None:
    tools = {"left": "left_tool", "right": "right_tool"}
    cell = RobotCell([Robot(robot_path("lift2"), tools, name="lift")])
    whole = pin.buildModelFromUrdf(str(robot_path("lift2")))
    for kind, shapes in ((pin.VISUAL, cell.visual_model()), (pin.COLLISION, cell.collision_model())):
        every = pin.buildGeomFromUrdf(whole, str(robot_path("lift2")), kind)
        assert sorted(g.name.partition("/")[2] for g in shapes.geometryObjects) == sorted(
            g.name for g in every.geometryObjects
        )
        x = np.random.default_rng(1).uniform(-0.5, 0.5, cell.nv)
        q = pin.neutral(whole)
        for name, value in zip(cell.joint_names, x, strict=True):
            j = whole.joints[whole.getJointId(name.partition("/")[2])]
            q[j.idx_q : j.idx_q + j.nq] = [value] if j.nq == 1 else [np.cos(value), np.sin(value)]
        places = {}
        for model, geometry, at in ((whole, every, q), (cell.model, shapes, cell.configuration(x))):
            placed = pin.GeometryData(geometry)
            pin.updateGeometryPlacements(model, model.createData(), geometry, placed, at)
            places[model.nframes] = {
                g.name.rpartition("/")[2]: T.homogeneous
                for g, T in zip(geometry.geometryObjects, placed.oMg, strict=True)
            }
        first, second = places.values()
        for name, T in first.items():
            np.testing.assert_allclose(T, second[name], rtol=0, atol=1e-12)


def test_a_group_is_one_redundant_arm(tmp_path: Path) -> None:
    """Its inverse and its null-space, against one dense matrix of the whole cell."""
    cell = RobotCell([robot_of(TORSOS[3], tmp_path, velocity_limits={"torso_0": 0.1})])
    grasp = Grasp(tuple(pin.SE3.Random() for _ in range(2)))
    chain, rng = Chain(cell, grasp), np.random.default_rng(5)
    q = cell.configuration(rng.uniform(-1.0, 1.0, cell.nv))
    chain.linearise(q, np.array([0.3, 0.1, 0.9]))
    A = chain.dense()
    moving = np.flatnonzero(np.abs(A).max(axis=0) > 0.0)
    D = np.diag(chain.scale[moving])
    oracle = np.zeros((cell.nv, 12))
    oracle[moving] = D @ np.linalg.pinv(A[:, moving] @ D)
    W = rng.normal(size=(2, 6))
    np.testing.assert_allclose(chain.joint_velocities(W), oracle @ W.ravel(), rtol=0, atol=1e-11)
    np.testing.assert_allclose(chain.joint_columns(W.T[None])[:, 1], oracle @ np.tile(W[1], 2), rtol=0, atol=1e-11)
    v = rng.normal(size=cell.nv)
    np.testing.assert_allclose(chain.null_part(v)[moving], v[moving] - oracle[moving] @ (A @ v), rtol=0, atol=1e-11)


def test_singular_values_of_runs_count_shared_joints() -> None:
    cell, grasp = lift_cell()
    q = held(cell, grasp, pin.SE3(np.eye(3), np.array([0.5, 0.1, 0.9])), np.array([0.2]))
    tools, J = tools_and_jacobians(cell, q[None])
    np.testing.assert_allclose(_sigma_min(cell, J, tools)[0], CellState(cell, q).sigma_min, rtol=1e-12)


@pytest.mark.parametrize("torso", TORSOS)
def test_a_robots_model_keeps_what_the_description_says_of_joints_and_frames(
    torso: tuple[tuple[str, str], ...], tmp_path: Path
) -> None:
    """Ends, speeds, efforts, frictions, dampings and gears of each joint; kind, place and weight of each frame."""
    robot = robot_of(torso, tmp_path, T_world_base=BASE)
    own = pin.Model(robot.arms[0].model)
    numbers = np.arange(1.0, own.nv + 1.0)
    fields = [f for f in ("friction", "damping", "rotorInertia", "rotorGearRatio", "armature") if hasattr(own, f)]
    for i, field in enumerate(fields):
        setattr(own, field, numbers + 0.1 * i)
    cell = RobotCell([replace(arm, model=own) for arm in robot.arms])
    whole = pin.buildModelFromUrdf(str(tmp_path / "both.urdf"))
    for i, name in enumerate(cell.model.names[1:], start=1):
        mine, theirs = cell.model.joints[i], whole.joints[whole.getJointId(name.partition("/")[2])]
        assert mine.shortname() == theirs.shortname()
        for field in ("lowerPositionLimit", "upperPositionLimit"):
            np.testing.assert_array_equal(
                getattr(cell.model, field)[mine.idx_q : mine.idx_q + mine.nq],
                getattr(whole, field)[theirs.idx_q : theirs.idx_q + theirs.nq],
            )
        for field in ("velocityLimit", "effortLimit"):
            assert getattr(cell.model, field)[mine.idx_v] == getattr(whole, field)[theirs.idx_v], field
        if hasattr(cell.model, "lowerVelocityLimit"):  # Pinocchio 4
            assert cell.model.lowerVelocityLimit[mine.idx_v] == -whole.velocityLimit[theirs.idx_v]
        for field in fields:
            assert getattr(cell.model, field)[mine.idx_v] == getattr(own, field)[theirs.idx_v], field
    names = [frame.name for frame in list(cell.model.frames)[1:]]
    assert len(set(names)) == len(names)
    for frame in list(cell.model.frames)[1:]:
        if frame.name.startswith(("torso/left", "torso/right")):
            continue  # what one arm's model has of the other is locked there
        same = whole.frames[whole.getFrameId(frame.name.partition("/")[2])]
        assert frame.type == same.type
        parent, own_parent = (m.frames[f.parentFrame].name for m, f in ((cell.model, frame), (whole, same)))
        assert parent.rpartition("/")[2] == own_parent
        placement = BASE * same.placement if frame.parentJoint == 0 else same.placement
        np.testing.assert_allclose(frame.placement.homogeneous, placement.homogeneous, rtol=0, atol=1e-15)
    assert {"torso/base", "torso/chest_0", "left/left_link_5", "right/right_link_5", "left/head"} <= set(names)


def test_a_group_beside_another_arm_has_slices_columns_and_blocks() -> None:
    """Each velocity coordinate is in one block, each position of an arm's own joint in its slice."""
    alone = rx90l("alone", geometry=False, T_world_base=pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0])))
    (group, _) = lift_cell()
    lift = Robot(robot_path("lift2"), {"left": "left_tool", "right": "right_tool"}, name="lift", geometry=False)
    for first_arm in (True, False):
        cell = RobotCell([alone, lift] if first_arm else [lift, alone])
        assert cell.blocks.keys() == {"alone", "lift", "left", "right"}
        every = np.concatenate([np.arange(cell.nv)[s] for s in cell.blocks.values()])
        np.testing.assert_array_equal(np.sort(every), range(cell.nv))
        for name, block in cell.blocks.items():
            assert all(joint.startswith(f"{name}/") for joint in cell.joint_names[block])
        first = list(cell.blocks)
        assert first.index("lift") < first.index("left") < first.index("right")
        k = cell.index("alone")
        assert cell.bases == (((0,), (1, 2)) if k == 0 else ((0, 1), (2,)))
        assert cell.groups == (tuple(i for i in range(3) if i != k),)
        np.testing.assert_array_equal(cell.columns[k], np.arange(cell.nv)[cell.v_slices[k]])
        for i, arm in enumerate(cell.arms):
            named = [cell.joint_names[j].partition("/")[2] for j in cell.columns[i]]
            assert named == list(arm.model.names)[1:]
            np.testing.assert_array_equal(arm.limits.velocity, cell.limits.velocity[cell.columns[i]])
        for j in cell.shared:
            assert cell.arm_of_joint(j) == cell.index("left")
            assert cell.joint_names[j].startswith("lift/")
        (part,) = [p for p in parts(cell) if len(p) > 1]
        assert part == cell.groups[0]
    assert list(group.blocks) == ["lift", "left", "right"]
    assert list(RobotCell([alone]).blocks) == ["alone"]
    assert RobotCell([alone]).bases == ((0,),)


def test_slices_of_a_group_count_the_two_numbers_of_a_continuous_joint(tmp_path: Path) -> None:
    cell = RobotCell([robot_of((("continuous", "0 0 1"), ("prismatic", "0 0 1")), tmp_path)])
    assert cell.nq == cell.nv + 1
    x = np.arange(1.0, cell.nv + 1.0) / 10.0
    q = cell.configuration(x)
    for q_slice, v_slice in zip(cell.q_slices, cell.v_slices, strict=True):
        np.testing.assert_array_equal(q[q_slice], x[v_slice])
    assert [s.stop - s.start for s in cell.v_slices] == [7, 6], "the left arm has the neck"
    assert cell.v_slices[0].start == 2
    assert cell.v_slices[1].stop == cell.nv


def test_the_tightest_limits_of_shared_joints_count(tmp_path: Path) -> None:
    left, right = robot_of(TORSOS[2], tmp_path, acceleration_limits=4.0).arms
    j = list(left.model.names).index("torso_0") - 1
    changed = []
    for arm, ends, speed, acceleration in ((left, (-1.0, 2.0), 0.5, 3.0), (right, (-2.0, 1.5), 0.7, 2.0)):
        values = {f: getattr(arm.limits, f).copy() for f in ("lower", "upper", "velocity", "acceleration")}
        values["lower"][j], values["upper"][j] = ends
        values["velocity"][j], values["acceleration"][j] = speed, acceleration
        changed.append(arm.with_limits(**values))
    cell = RobotCell(changed)
    at = cell.joint_names.index("torso/torso_0")
    limits = cell.limits
    assert (limits.lower[at], limits.upper[at]) == (-1.0, 1.5)
    assert (limits.velocity[at], limits.acceleration[at]) == (0.5, 2.0)


@pytest.mark.parametrize("field", ["velocity_limits", "acceleration_limits", "lower_limits", "upper_limits"])
def test_bad_limits_of_a_robot_are_named(field: str, tmp_path: Path) -> None:
    name = field.removesuffix("s")
    for bad, says in (
        ({"torso_9": 1.0}, rf"no joint named 'torso_9' in robot 'torso', {name}s\."),
        ({"torso_0": "fast"}, rf"robot 'torso': {name}s\['torso_0'\]"),
        ({"torso_0": np.nan}, rf"robot 'torso': {name}s\['torso_0'\]: is NaN"),
        ("fast", f"robot 'torso': {name}s: "),
        ([1.0, 2.0], f"robot 'torso': {name}s: "),
    ):
        with pytest.raises((InvalidInputError, UnknownNameError), match=says):
            robot_of(TORSOS[0], tmp_path, **{field: bad})


def test_a_robot_has_a_name_and_arms_by_theirs(tmp_path: Path) -> None:
    robot = robot_of(TORSOS[0], tmp_path, lower_limits=-1.0, upper_limits={"torso_0": 0.4})
    assert repr(robot) == "Robot(torso: left, right)"
    for arm in robot.arms:
        assert (arm.robot, arm.tool_frame) == ("torso", f"{arm.name}_link_5")
        np.testing.assert_array_equal(arm.limits.lower, -1.0)
        assert arm.limits.upper[list(arm.model.names).index("torso_0") - 1] == 0.4
        assert (arm.limits.upper == 0.4).sum() == 1
    file = tmp_path / "both.urdf"
    for name in ("", "a/b", None, 3):
        with pytest.raises(InvalidInputError, match=r"Robot: name: .*Give a plain name"):
            Robot(file, {"left": "left_link_5"}, name=name)  # type: ignore[arg-type]
    for arms in (["left"], None, "left"):
        with pytest.raises(InvalidInputError, match=r"robot 'robot': arms: .*tool frame of each arm"):
            Robot(file, arms)  # type: ignore[arg-type]


def test_limits_that_are_given_stand_in_place_of_those_of_a_model(tmp_path: Path) -> None:
    """Many files say velocity="0" for a speed that nobody knows, and some have an empty range."""
    file = tmp_path / "odd.urdf"
    joints = "".join(
        f'<link name="{s}{i + 1}"/><joint name="{s}_{i}" type="revolute"><parent link="{f"{s}{i}" if i else "base"}"/>'
        f'<child link="{s}{i + 1}"/><origin xyz="0.1 0 0.2"/><axis xyz="{i % 2} {1 - i % 2} 0"/>'
        '<limit lower="{low}" upper="{high}" velocity="{speed}" effort="1"/></joint>'
        for s in "lr"
        for i in range(6)
    )
    text = f'<robot name="odd"><link name="base"/>{joints}</robot>'
    names = [f"{s}_{i}" for s in "lr" for i in range(6)]
    tools = {"left": "l6", "right": "r6"}
    cases: list[tuple[dict[str, int], dict[str, Any]]] = [
        ({"low": -1, "high": 1, "speed": 0}, {"velocity_limits": 2.0}),
        ({"low": -1, "high": 1, "speed": 0}, {"velocity_limits": dict.fromkeys(names, 2.0)}),
        ({"low": 1, "high": 0, "speed": 2}, {"lower_limits": -1.0, "upper_limits": 1.0}),
    ]
    for odd, given in cases:
        file.write_text(text.format(**odd))
        with pytest.raises(InvalidInputError, match="robot 'robot', joint 'l_0': "):
            Robot(file, tools)
        limits = Robot(file, tools, **given).arms[1].limits
        assert (set(limits.lower), set(limits.upper), set(limits.velocity)) == ({-1.0}, {1.0}, {2.0})
        cell = (
            'name = "odd"\n[grasp]\nkind = "tools"\ntools.left = {}\ntools.right = {}\n'
            '[path]\nkind = "line"\nstart = {}\ndisplacement = { translation_m = [0, 0, 0.1] }\nduration_s = 1\n'
        )
        by = "velocity_rad_per_s = 2" if odd["speed"] == 0 else "lower_rad = -1\nupper_rad = 1"
        arms = "".join(
            f'[[arms]]\nname = "{n}"\nurdf = "odd.urdf"\ntool_frame = "{t}"\nbase = {{ xyz_m = [0, {y}, 0] }}\n'
            f'[arms.limits]\n{by}\n' for (n, t), y in zip(tools.items(), (0, 9), strict=True)
        )  # fmt: skip
        of = "".join(f'[[arms]]\nname = "{n}"\nof = "r"\ntool_frame = "{t}"\n' for n, t in tools.items())
        one = f'[[robots]]\nname = "r"\nurdf = "odd.urdf"\nlimits."*" = {{ {", ".join(by.splitlines())} }}\n{of}'
        for described in (arms, one):
            (tmp_path / "cell.toml").write_text(cell.replace("[grasp]", described + "[grasp]"))
            limits = load_cell_task(tmp_path / "cell.toml").cell.limits
            assert (set(limits.lower), set(limits.upper), set(limits.velocity)) == ({-1.0}, {1.0}, {2.0})
