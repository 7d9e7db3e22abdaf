"""The description of a cell in a recording: reading restores the cell, and damage gives a named error."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, HoldPath, Recording, RobotCell, ServoPath
from coopqp.scenarios import ROBOT_NAMES, ROBOTS, robot_path
from coopqp.simulation import SceneError, describe_object, tool_placements
from coopqp.simulation.recording.scene import (
    describe_cell,
    describe_path,
    named_meshes,
    read_cell,
    read_object,
    read_path,
)
from coopqp.visualization.renderer import cell_solids


def _all_robots() -> RobotCell:
    """Revolute, prismatic and continuous joints, on turned bases, with shapes."""
    pin.seed(11)
    arms = [
        Arm.from_urdf(
            robot,
            robot_path(robot),
            tool_frame=ROBOTS[robot].tool_frame,
            T_world_base=pin.SE3.Random(),
            acceleration_limits=7.5 if robot == "arm7" else None,
        )
        for robot in ROBOT_NAMES
    ]
    return RobotCell(arms)


@pytest.fixture(scope="module")
def everything() -> RobotCell:
    return _all_robots()


@pytest.fixture
def metadata(everything: RobotCell) -> dict[str, Any]:
    """The metadata of a recording, after a round trip through JSON."""
    return json.loads(json.dumps({"scene": describe_cell(everything)}, allow_nan=False))


def test_the_cell_comes_back(
    everything: RobotCell,
    metadata: dict[str, Any],
    random_q: Callable[..., Any],
    rng: np.random.Generator,
) -> None:
    again = read_cell(metadata)
    assert again.joint_names == everything.joint_names
    assert [arm.source for arm in again.arms] == [arm.source for arm in everything.arms]
    for name in ("lower", "upper", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(again.limits, name), getattr(everything.limits, name))
    configurations = [random_q(everything, rng) for _ in range(5)]
    for ours, theirs in zip(
        tool_placements(again, configurations), tool_placements(everything, configurations), strict=True
    ):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a.homogeneous, b.homogeneous)
    ours, theirs = cell_solids(again, configurations), cell_solids(everything, configurations)
    for a, b in zip(ours[0], theirs[0], strict=True):
        np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-12)
        np.testing.assert_allclose(a.colour, b.colour, atol=1e-3)


def test_reading_is_the_inverse_of_writing(metadata: dict[str, Any]) -> None:
    assert describe_cell(read_cell(metadata)) == metadata["scene"]


def test_shapes_may_be_left_out(metadata: dict[str, Any]) -> None:
    assert all(arm.visual is None for arm in read_cell(metadata, shapes=False).arms)


def _arm_of(*joints: Any) -> pin.Model:
    model, parent = pin.Model(), 0
    for i, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3.Random(), f"joint_{i}")
    model.addFrame(pin.Frame("tool", parent, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    return model


def test_joints_along_any_axis_and_screws_come_back(rng: np.random.Generator) -> None:
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    turning = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0.6 0.8"/></joint>'
    described = pin.buildModelFromXML(f'<robot name="r"><link name="a"/><link name="b"/>{turning}</robot>')
    assert described.joints[1].shortname() == "JointModelRevoluteUnboundedUnaligned"
    model = _arm_of(
        pin.JointModelRevoluteUnaligned(axis),
        pin.JointModelPrismaticUnaligned(axis),
        described.joints[1],
        pin.JointModelHZ(0.3),
        pin.JointModelRUBX(),
    )
    cell = RobotCell([Arm.from_model("arm", model, tool_frame="tool")])
    again = read_cell({"scene": describe_cell(cell)})
    q = cell.configuration(rng.uniform(-1.0, 1.0, cell.nv))
    np.testing.assert_allclose(
        tool_placements(again, [q])[0][0].homogeneous, tool_placements(cell, [q])[0][0].homogeneous, rtol=0, atol=1e-14
    )


def _with_shape(geometry: Any, mesh: str = "") -> RobotCell:
    model = _arm_of(pin.JointModelRZ())
    shapes = pin.GeometryModel()
    shape = pin.GeometryObject("shape", 1, 0, pin.SE3.Random(), geometry)
    shape.meshPath, shape.meshScale = mesh, np.array([1.0, 2.0, 3.0])
    shapes.addGeometryObject(shape)
    return RobotCell([Arm.from_model("arm", model, tool_frame="tool", visual=shapes)])


TETRAHEDRON = """\
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def _mesh(file: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Any:
    file.write_text(TETRAHEDRON)
    return coal.MeshLoader().load(str(file), np.array(scale))


@pytest.mark.parametrize(
    "geometry",
    [coal.Sphere(0.2), coal.Capsule(0.1, 0.4), coal.Cone(0.1, 0.3), coal.Ellipsoid(0.1, 0.2, 0.3), coal.Box(1, 2, 3)],
    ids=lambda geometry: type(geometry).__name__,
)
def test_every_primitive_comes_back(geometry: Any) -> None:
    cell = _with_shape(geometry)
    again = read_cell({"scene": describe_cell(cell)})
    q = [np.array([0.3])]
    np.testing.assert_allclose(
        cell_solids(again, q)[0][0].vertices, cell_solids(cell, q)[0][0].vertices, rtol=0, atol=1e-12
    )


def test_a_mesh_is_read_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "link.obj"
    cell = _with_shape(_mesh(file, (1.0, 2.0, 3.0)), str(file))
    described = {"scene": describe_cell(cell)}
    again = read_cell(described, meshes=True)
    q = [np.array([0.3])]
    np.testing.assert_allclose(cell_solids(again, q)[0][0].vertices, cell_solids(cell, q)[0][0].vertices)
    file.unlink()
    with pytest.raises(SceneError, match=r"arm 'arm': the mesh .*link\.obj is gone.*--sticks"):
        read_cell(described, meshes=True)
    read_cell(described, shapes=False, meshes=True)
    file.write_text("no mesh")
    with pytest.raises(SceneError, match=r"link\.obj cannot be read"):
        read_cell(described, meshes=True)


def test_a_recording_from_a_file_opens_no_mesh_unless_asked(tmp_path: Path, baseline: Callable[..., Recording]) -> None:
    """A pipe in the place of the mesh: whoever opens it waits for ever. The run in memory names it too, but is ours."""
    file = tmp_path / "link.obj"
    cell = _with_shape(_mesh(file), str(file))
    run = baseline(20)
    mine = replace(run, metadata=dict(run.metadata, scene=describe_cell(cell)))
    saved = mine.save(tmp_path / "run.npz")
    file.unlink()
    os.mkfifo(file)
    strange = Recording.load(saved)
    assert not strange.meshes
    assert strange.cell().visual_model().ngeoms == 0
    assert named_meshes(strange.metadata) == [str(file)]
    file.unlink()
    _mesh(file)
    for trusted in (mine, Recording.load(saved, meshes=True), replace(strange, meshes=True)):
        assert trusted.cell().visual_model().ngeoms == 1


def test_a_mesh_without_a_file_is_kept_whole(tmp_path: Path) -> None:
    cell = _with_shape(_mesh(tmp_path / "link.obj"))
    described = json.loads(json.dumps({"scene": describe_cell(cell)}))
    (tmp_path / "link.obj").unlink()
    again = read_cell(described)
    q = [np.array([0.3])]
    for a, b in zip(cell_solids(again, q)[0], cell_solids(cell, q)[0], strict=True):
        np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-6)
        np.testing.assert_array_equal(a.triangles, b.triangles)


def test_an_unknown_shape_is_left_out() -> None:
    cell = _with_shape(coal.Plane(np.array([0.0, 0.0, 1.0]), 0.0))
    (arm,) = read_cell({"scene": describe_cell(cell)}).arms
    assert arm.visual is not None
    assert arm.visual.ngeoms == 0


def test_the_object_comes_back(paper: Any) -> None:
    entry = json.loads(json.dumps(describe_object(paper.object_size, paper.T_object_body)))
    size, body = read_object({"object": entry}, np.eye(4)[None])
    np.testing.assert_array_equal(size, paper.object_size)
    np.testing.assert_array_equal(body.homogeneous, paper.T_object_body.homogeneous)


def test_an_object_that_nobody_described_spans_the_grasps() -> None:
    X = np.tile(np.eye(4), (2, 1, 1))
    X[1, 0, 3] = 0.6
    size, body = read_object({}, X)
    np.testing.assert_allclose(size, [0.6, 0.04, 0.04])
    np.testing.assert_allclose(body.translation, [0.3, 0.0, 0.0])


def test_a_run_describes_its_cell(baseline: Callable[..., Recording], paper: Any) -> None:
    recording = baseline(40)
    again = read_cell(recording.metadata)
    for a, b in zip(tool_placements(again, recording.q)[-1], tool_placements(paper.cell, recording.q)[-1], strict=True):
        np.testing.assert_array_equal(a.homogeneous, b.homogeneous)


def _damage(path: tuple[Any, ...], value: Any) -> Callable[[dict[str, Any]], None]:
    def damage(metadata: dict[str, Any]) -> None:
        item: Any = metadata
        for key in path[:-1]:
            item = item[key]
        item[path[-1]] = value

    return damage


ARM = ("scene", "arms", 0)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_damage(("scene",), None), "does not describe its cell"),
        (_damage(("scene", "format"), 99), "format 99"),
        (_damage(("scene", "arms"), []), "0 arms"),
        (_damage(("scene", "arms"), [{}] * 1000), "1000 arms"),
        (_damage(("scene", "arms"), {"a": 1}), "damaged"),
        (_damage((*ARM, "base"), "here"), "damaged"),
        (_damage((*ARM, "base"), [[float("nan")] * 4] * 4), "damaged"),
        (_damage((*ARM, "joints"), []), "0 joints"),
        (_damage((*ARM, "joints"), [{}] * 257), "257 joints; 1 to 256 are read"),
        (_damage(("scene", "arms"), [{}] * 257), "257 arms; 1 to 256 are read"),
        (_damage((*ARM, "joints", 0, "type"), "JointModelFreeFlyer"), "is a JointModelFreeFlyer"),
        (_damage((*ARM, "joints", 0, "type"), "__class__"), "is a __class__"),
        (_damage((*ARM, "joints", 0, "type"), "JointModelRevoluteUnaligned"), "damaged"),
        (_damage((*ARM, "joints", 0, "parent"), 7), "index 7"),
        (_damage((*ARM, "joints", 0, "parent"), -1), "index -1"),
        (_damage((*ARM, "joints", 0, "parent"), True), "index True"),
        (_damage((*ARM, "joints", 0, "parent"), 0.5), "index 0.5"),
        (_damage((*ARM, "tool", "joint"), 99), "index 99"),
        (_damage((*ARM, "tool", "joint"), 0), "damaged"),
        (_damage((*ARM, "limits", "lower"), [1.0]), "damaged"),
        (_damage((*ARM, "limits", "velocity"), ["fast"] * 5), "damaged"),
        (_damage((*ARM, "shapes", 0, "joint"), 99), "index 99"),
        (_damage((*ARM, "shapes", 0, "size"), {"radius": float("inf"), "halfLength": 1.0}), "no size"),
        (_damage((*ARM, "shapes", 0, "size"), {}), "damaged"),
        (_damage((*ARM, "shapes", 0, "color"), [1]), "damaged"),
        (
            _damage((*ARM, "shapes", 0), {"name": "x", "kind": "mesh", "file": "/etc/passwd", "scale": [1, 1, 1]}),
            "mesh",
        ),
        (_damage((*ARM, "shapes"), [{}] * 5000), "more than 4096 shapes"),
        (
            _damage((*ARM, "shapes", 0), {"name": "x", "kind": "triangles", "vertices": "?", "triangles": "?"}),
            "damaged",
        ),
    ],
)
def test_a_damaged_scene_is_refused_by_name(
    metadata: dict[str, Any], damage: Callable[[dict[str, Any]], None], message: str
) -> None:
    damaged = copy.deepcopy(metadata)
    damage(damaged)
    with pytest.raises(SceneError, match=message.replace("(", r"\(")):
        read_cell(damaged, meshes=True)


@pytest.mark.parametrize("entry", [[], {"size_m": [1, 2, 3]}, {"size_m": [0, 1, 1], "T_object_body": np.eye(4)}])
def test_a_damaged_object_is_refused_by_name(entry: Any) -> None:
    with pytest.raises(SceneError, match="object is damaged"):
        read_object({"object": entry}, np.eye(4)[None])


# -- the path ------------------------------------------------------------------------------------------------------


def test_the_whole_path_comes_back(paper: Any, baseline: Callable[..., Recording]) -> None:
    poses = read_path(json.loads(json.dumps(baseline(40).metadata)))
    assert poses is not None
    for clock, pose in zip(np.linspace(0.0, 3.0, len(poses)), poses, strict=True):
        np.testing.assert_allclose(pose.homogeneous, paper.path.pose(clock).homogeneous, atol=1e-14)


def test_a_path_that_is_not_known_ahead_is_left_out() -> None:
    assert describe_path(ServoPath(pin.SE3.Identity())) is None
    assert read_path({"path": None}) is None
    assert read_path({}) is None
    assert describe_path(HoldPath(pin.SE3.Identity())) is not None


POSE = [0.1, -0.2, 0.3, 0.0, 0.6, 0.0, 0.8]


def test_a_path_may_have_one_pose_and_ten_thousand() -> None:
    rounded = [0.1, -0.2, 0.3, 0.0, 0.6, 0.0, 0.8 + 1e-7]
    for rows in ([POSE], [rounded], [POSE] * 10_000):
        poses = read_path({"path": rows})
        assert poses is not None
        assert len(poses) == len(rows)
        np.testing.assert_allclose(poses[-1].translation, POSE[:3])
        np.testing.assert_allclose(pin.Quaternion(poses[-1].rotation).coeffs(), POSE[3:], atol=1e-6)


@pytest.mark.parametrize(
    "rows",
    [
        "here",
        [[1, 2]],
        [],
        POSE,
        [[POSE]],
        [POSE[:6]],
        [[0, 0, 0, 0, 0, 0, 0]],
        [POSE, [*POSE[:6], 0.9]],
        [[*POSE[:6], 0.8 + 1e-5], POSE],
        [POSE, [float("nan")] * 7],
        [POSE, [float("inf"), *POSE[1:]]],
        [[10**400, *POSE[1:]]],
        [[0] * 6 + ["x"]],
        [POSE] * 10_001,
    ],
    ids=range(14),
)
def test_a_damaged_path_is_refused_by_name(rows: Any) -> None:
    with pytest.raises(SceneError, match="path is damaged"):
        read_path({"path": rows})
