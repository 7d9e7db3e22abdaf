"""The robot descriptions: kinematics, limits, inertias and shapes agree with the figures in this file."""

from __future__ import annotations

import functools
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from coopqp import CoopqpError
from coopqp.errors import MissingExtraError, UnknownNameError
from coopqp.scenarios import ROBOT_NAMES, ROBOTS, robot_arm, robot_file, robot_path, robot_table
from coopqp.scenarios.arms import robot_data_path
from coopqp.scenarios.robots import SEVERAL_ARMS

Array = NDArray[np.float64]


def rotation(axis: int, angle: float) -> Array:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T = np.eye(4)
    T[i, i] = T[j, j] = np.cos(angle)
    T[i, j], T[j, i] = -np.sin(angle), np.sin(angle)
    return T


def translation(axis: int, distance: float) -> Array:
    T = np.eye(4)
    T[axis, 3] = distance
    return T


Rx, Ry, Rz = (functools.partial(rotation, axis) for axis in range(3))
Tx, Ty, Tz = (functools.partial(translation, axis) for axis in range(3))

# Pose of the end frame in the base frame, as in the header of each file.
CHAINS: dict[str, Callable[[Array], Array]] = {
    "rx90l": lambda q: (
        Tz(0.420) @ Rz(q[0]) @ Ry(q[1]) @ Tz(0.450) @ Ry(q[2]) @ Rz(q[3]) @ Tz(0.650) @ Ry(q[4])
        @ Tz(0.085) @ Rz(q[5])
    ),
    "kr16_2": lambda q: (
        Tz(0.675) @ Rz(-q[0]) @ Tx(0.260) @ Ry(q[1]) @ Tx(0.680) @ Ry(q[2]) @ Tx(0.670) @ Tz(-0.035) @ Rx(-q[3])
        @ Ry(q[4]) @ Tx(0.158) @ Rx(-q[5]) @ Ry(np.pi / 2)
    ),
    "irb1600": lambda q: (
        Tz(0.4865) @ Rz(q[0]) @ Tx(0.150) @ Ry(q[1]) @ Tz(0.475) @ Ry(q[2]) @ Tx(0.600) @ Rx(q[3]) @ Ry(q[4])
        @ Tx(0.065) @ Rx(q[5]) @ Ry(np.pi / 2)
    ),
    "arm7": lambda q: (
        Tz(0.30) @ Rz(q[0]) @ Ry(q[1]) @ Rz(q[2]) @ Tz(0.32) @ Ry(q[3]) @ Tz(0.36) @ Rz(q[4]) @ Ry(q[5])
        @ Rz(q[6]) @ Tz(0.22)
    ),
    "scara4": lambda q: (
        Tz(0.30) @ Rz(q[0]) @ Tx(0.32) @ Rz(q[1]) @ Tx(0.28) @ Tz(q[2]) @ Rz(q[3]) @ Tz(-0.15) @ Rx(np.pi)
    ),
    "arm5": lambda q: (
        Tz(0.20) @ Rz(q[0]) @ Ry(q[1]) @ Tz(0.30) @ Ry(q[2]) @ Tz(0.28) @ Ry(q[3]) @ Rz(q[4]) @ Tz(0.17)
    ),
    "gantry7": lambda q: (
        Tx(q[0]) @ Tz(0.45) @ Rz(q[1]) @ Ry(q[2]) @ Tz(0.40) @ Ry(q[3]) @ Rz(q[4]) @ Tz(0.42) @ Ry(q[5])
        @ Rz(q[6]) @ Tz(0.13)
    ),
    "arm6c": lambda q: (
        Tz(0.16) @ Rz(q[0]) @ Ty(0.13) @ Ry(q[1]) @ Ty(-0.12) @ Tz(0.42) @ Ry(q[2]) @ Tz(0.39) @ Ry(q[3])
        @ Ty(0.12) @ Rz(q[4]) @ Tz(0.10) @ Ry(q[5]) @ Ty(0.10) @ Rx(-np.pi / 2)
    ),
}  # fmt: skip

SIZES = {  # nq, nv, joint types
    "rx90l": (6, 6, ["revolute"] * 6),
    "kr16_2": (6, 6, ["revolute"] * 6),
    "irb1600": (6, 6, ["revolute"] * 6),
    "arm7": (7, 7, ["revolute"] * 7),
    "scara4": (4, 4, ["revolute", "revolute", "prismatic", "revolute"]),
    "arm5": (5, 5, ["revolute"] * 5),
    "gantry7": (7, 7, ["prismatic"] + ["revolute"] * 6),
    "arm6c": (7, 6, ["revolute"] * 5 + ["continuous"]),
}

#: The robots of manufacturers, with the load that they hold [kg].
MADE = {"rx90l": 6.0, "kr16_2": 16.0, "irb1600": 6.0}

# Modified Denavit-Hartenberg tables as they are published: α, a, d, θ, in mm; and the senses of the joints.
TABLES = {
    "kr16_2": (
        [[0, 0, 675, 0], [-90, 260, 0, 0], [0, 680, 0, -90], [-90, -35, 670, 0], [90, 0, 0, 0], [-90, 0, 158, 180]],
        [-1, 1, 1, -1, 1, -1],
    ),
    "irb1600": (
        [[0, 0, 486.5, 0], [-90, 150, 0, -90], [0, 475, 0, 0], [-90, 0, 600, 0], [90, 0, 0, 0], [-90, 0, 65, 180]],
        [1, 1, 1, 1, 1, 1],
    ),
}
# Lower and upper limits and speeds, in degrees and degrees per second.
LIMITS = {
    "kr16_2": (
        [-185, -155, -130, -350, -130, -350],
        [185, 35, 154, 350, 130, 350],
        [156, 156, 156, 330, 330, 615],
    ),
    "irb1600": (
        [-180, -63, -235, -200, -115, -400],
        [180, 110, 55, 200, 115, 400],
        [150, 160, 170, 320, 400, 450],
    ),
}

# The table of the RX-90L, in degrees, degrees per second and kg (links 2 to 6).
RX90L_LOWER = [-160, -137.5, -142.5, -270, -105, -270]
RX90L_UPPER = [160, 137.5, 142.5, 270, 120, 270]
RX90L_SPEED = [236, 200, 286, 401, 320, 580]
RX90L_MASSES = [18.04, 16.37, 11.36, 0.58, 0.30]
#: Poses of the paper's lift, and others; in degrees.
POSES = {
    "kr16_2": [
        [0, 0, 0, 0, 0, 0],
        [0, -38.5, 83.4, 0, -44.9, -90],
        [-29.9, -40.6, 88.2, -38.0, -54.2, -65.5],
        [29.9, -40.6, 88.2, 38.0, -54.2, -114.5],
        [90, -90, 90, 0, 0, 0],
        [-120, -120, 130, 90, 90, 200],
    ],
    "irb1600": [
        [0, 0, 0, 0, 0, 0],
        [0, 55.7, -6.6, 0, -49.2, 90],
        [25.6, 55.0, -5.1, 32.1, -54.5, 70.0],
        [-25.6, 55.0, -5.1, -32.1, -54.5, 110.0],
        [90, 0, -90, 0, 0, 0],
        [-120, -40, 40, 90, 90, 200],
    ],
    "rx90l": [
        [0, 0, 0, 0, 0, 0],
        [0, 65.4, 76.0, 180, 51.3, -90],
        [13.8, 67.4, 71.9, -162.1, 50.7, -101.6],
        [-13.8, 67.4, 71.9, 162.1, 50.7, -78.4],
        [90, 90, 0, 0, 0, 0],
        [-120, -40, 140, 30, -100, 200],
    ],
}
POSED = [(name, np.radians(pose)) for name, poses in POSES.items() for pose in poses]


def load(name: str) -> pin.Model:
    return pin.buildModelFromUrdf(str(robot_path(name)))


def load_floating(name: str) -> pin.Model:
    """The model on a floating base, which keeps the inertia of the base link."""
    return pin.buildModelFromUrdf(str(robot_path(name)), pin.JointModelFreeFlyer())


def load_shapes(name: str, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    return pin.buildGeomFromUrdf(model, str(robot_path(name)), kind)


def end_frame(name: str, model: pin.Model) -> int:
    frame = "flange" if name in MADE else "tool"
    assert model.existFrame(frame)
    return int(model.getFrameId(frame))


def random_angles(model: pin.Model, rng: np.random.Generator) -> tuple[Array, Array]:
    """One number per joint within the limits (any angle for continuous joints), and Pinocchio's configuration."""
    angles, q = np.empty(model.nv), np.empty(model.nq)
    for joint in model.joints[1:]:
        if joint.nq == joint.nv:
            angles[joint.idx_v] = rng.uniform(
                model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            )
            q[joint.idx_q] = angles[joint.idx_v]
        else:
            angles[joint.idx_v] = rng.uniform(-np.pi, np.pi)
            q[joint.idx_q : joint.idx_q + 2] = np.cos(angles[joint.idx_v]), np.sin(angles[joint.idx_v])
    return angles, q


def half_extents(shape: coal.CollisionGeometry) -> Array:
    """Half the size of a primitive's bounding box in its own frame [m]."""
    if isinstance(shape, coal.Box):
        return np.array(shape.halfSide)
    if isinstance(shape, coal.Cylinder):
        return np.array([shape.radius, shape.radius, shape.halfLength])
    assert isinstance(shape, coal.Sphere), f"{type(shape).__name__} is not a primitive"
    return np.full(3, shape.radius)


def distance_to_point(shape: coal.CollisionGeometry, point: Array) -> float:
    """Distance from a point, in the shape's frame, to the solid [m]; 0 inside."""
    half = half_extents(shape)
    if isinstance(shape, coal.Box):
        outside = np.maximum(np.abs(point) - half, 0.0)
    elif isinstance(shape, coal.Cylinder):
        radial, axial = np.hypot(point[0], point[1]) - half[0], abs(point[2]) - half[2]
        outside = np.maximum([radial, axial], 0.0)
    else:
        outside = np.maximum([np.linalg.norm(point) - half[0]], 0.0)
    return float(np.linalg.norm(outside))


def solid_inertia(shape: coal.CollisionGeometry, density: float) -> pin.Inertia:
    if isinstance(shape, coal.Box):
        x, y, z = 2.0 * np.array(shape.halfSide)
        return pin.Inertia.FromBox(density * x * y * z, x, y, z)
    if isinstance(shape, coal.Cylinder):
        radius, length = shape.radius, 2.0 * shape.halfLength
        return pin.Inertia.FromCylinder(density * np.pi * radius**2 * length, radius, length)
    assert isinstance(shape, coal.Sphere)
    return pin.Inertia.FromSphere(density * 4.0 / 3.0 * np.pi * shape.radius**3, shape.radius)


def add_pairs(shapes: pin.GeometryModel, wanted: Callable[[int], bool]) -> None:
    """Pair all shapes with a ``wanted`` number of joints between their links, the shape nearer the base first."""
    for i, first in enumerate(shapes.geometryObjects):
        for j, second in enumerate(shapes.geometryObjects):
            if wanted(second.parentJoint - first.parentJoint):
                shapes.addCollisionPair(pin.CollisionPair(i, j))


def joint_limits(name: str) -> list[dict[str, str]]:
    return [dict(limit.attrib) for limit in ET.parse(robot_path(name)).getroot().iterfind("joint/limit")]


# --- the files


def test_names_are_the_files() -> None:
    folder = robot_path("rx90l").parent
    assert sorted(ROBOT_NAMES) == sorted(CHAINS)
    assert sorted(path.stem for path in folder.glob("*.urdf")) == sorted((*ROBOT_NAMES, *SEVERAL_ARMS))


def test_path_is_an_existing_file() -> None:
    for name in ROBOT_NAMES:
        path = robot_path(name)
        assert isinstance(path, Path)
        assert path.is_file()
        assert ET.parse(path).getroot().get("name") == name


@pytest.mark.parametrize("name", ["rx90", "", "../errors", "RX90L"])
def test_unknown_name_lists_what_there_is(name: str) -> None:
    with pytest.raises(UnknownNameError) as caught:
        robot_path(name)
    for available in ROBOT_NAMES:
        assert available in str(caught.value)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_needs_no_other_file(name: str) -> None:
    text = robot_path(name).read_text(encoding="utf-8")
    assert "package://" not in text
    assert "<mesh" not in text


# --- kinematics


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_sizes_joints_and_end_frame(name: str) -> None:
    model = load(name)
    nq, nv, types = SIZES[name]
    assert (model.nq, model.nv) == (nq, nv)
    assert list(model.names)[1:] == [f"joint_{k + 1}" for k in range(nv)]
    joints = ET.parse(robot_path(name)).getroot().findall("joint")
    assert [joint.get("type") for joint in joints] == [*types, "fixed"]
    end_frame(name, model)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_forward_kinematics_is_the_chain(name: str) -> None:
    model = load(name)
    data = model.createData()
    frame = end_frame(name, model)
    rng = np.random.default_rng(90)
    for _ in range(200):
        angles, q = random_angles(model, rng)
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(data.oMf[frame].homogeneous, CHAINS[name](angles), rtol=0.0, atol=1e-12)


def denavit_hartenberg(table: list[list[float]], angles: Array) -> Array:
    """Product of modified Denavit-Hartenberg transforms, written out element by element, not as rotations."""
    T = np.eye(4)
    for (alpha_deg, a_mm, d_mm, theta_deg), q in zip(table, angles, strict=True):
        (ca, cq), (sa, sq) = ((f(np.radians(alpha_deg)), f(np.radians(theta_deg) + q)) for f in (np.cos, np.sin))
        a, d = 1e-3 * a_mm, 1e-3 * d_mm
        T = T @ np.array(
            [
                [cq, -sq, 0.0, a],
                [sq * ca, cq * ca, -sa, -sa * d],
                [sq * sa, cq * sa, ca, ca * d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return T


@pytest.mark.parametrize("name", TABLES)
def test_forward_kinematics_is_the_product_of_the_published_table(name: str) -> None:
    """The table's last frame is the flange, but for a turn about its axis."""
    model, (table, senses) = load(name), TABLES[name]
    data = model.createData()
    frame = end_frame(name, model)
    rng = np.random.default_rng(94)
    turns = []
    for _ in range(100):
        angles, q = random_angles(model, rng)
        pin.framesForwardKinematics(model, data, q)
        T = denavit_hartenberg(table, np.array(senses) * angles)
        found = data.oMf[frame].homogeneous
        np.testing.assert_allclose(found[:, 2:], T[:, 2:], rtol=0.0, atol=1e-12)
        turns.append(T[:3, :3].T @ found[:3, :3])
    np.testing.assert_allclose(turns, np.broadcast_to(turns[0], (100, 3, 3)), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", LIMITS)
def test_limits_are_the_published_ones(name: str) -> None:
    model, (lower, upper, speed) = load(name), LIMITS[name]
    np.testing.assert_allclose(np.degrees(model.lowerPositionLimit), lower, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(model.upperPositionLimit), upper, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(model.velocityLimit), speed, rtol=0.0, atol=1e-12)


def test_rx90l_determinant_has_the_closed_form() -> None:
    model = load("rx90l")
    data = model.createData()
    frame = end_frame("rx90l", model)
    rng = np.random.default_rng(91)
    for _ in range(200):
        _, q = random_angles(model, rng)
        det = abs(np.linalg.det(pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)))
        _, q2, q3, _, q5, _ = q
        reach = abs(0.45 * np.sin(q2) + 0.65 * np.sin(q2 + q3))
        expected = 0.45 * 0.65 * abs(np.sin(q3)) * reach * abs(np.sin(q5))
        # The absolute term is the rounding of a determinant near a singularity.
        assert det == pytest.approx(expected, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_jacobian_has_full_rank_somewhere(name: str) -> None:
    model = load(name)
    data = model.createData()
    frame = end_frame(name, model)
    rng = np.random.default_rng(92)
    smallest = 0.0
    for _ in range(20):
        _, q = random_angles(model, rng)
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        smallest = max(smallest, float(np.linalg.svd(J, compute_uv=False)[min(6, model.nv) - 1]))
    assert smallest > 0.05


# --- limits


def test_rx90l_limits_are_the_table() -> None:
    model = load("rx90l")
    np.testing.assert_allclose(np.degrees(model.lowerPositionLimit), RX90L_LOWER, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(model.upperPositionLimit), RX90L_UPPER, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(model.velocityLimit), RX90L_SPEED, rtol=0.0, atol=1e-12)


#: The arm stretched out, as far as it can, in degrees.
STRETCHED = {
    "rx90l": ([0, 90, 0, 0, 0, 0], [0, 90, 0, 0, 90, 0], [0, 90, 0, 90, 90, 0], [0, 0, 90, 0, 0, 0]),
    "kr16_2": ([0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 90, 0], [0, 0, 0, 90, 90, 0], [0, -90, 90, 0, 0, 0]),
    "irb1600": ([0, 90, -90, 0, 0, 0], [0, 90, -90, 0, 90, 0], [0, 90, -90, 90, 90, 0], [0, 0, 0, 0, 0, 0]),
}


@pytest.mark.parametrize("name", MADE)
def test_effort_holds_the_stretched_arm_with_its_load(name: str) -> None:
    model = load(name)
    data = model.createData()
    frame = end_frame(name, model)
    force = np.array([0.0, 0.0, MADE[name] * 9.81, 0.0, 0.0, 0.0])  # [N], on the load, world axes
    for pose in STRETCHED[name]:
        q = np.radians(pose)
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        torque = pin.computeGeneralizedGravity(model, data, q) + J.T @ force
        assert np.all(np.abs(torque) < model.effortLimit)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_limits_are_usable(name: str) -> None:
    model = load(name)
    assert np.all((model.velocityLimit > 0.0) & (model.velocityLimit < 20.0))
    assert np.all((model.effortLimit > 0.0) & (model.effortLimit <= 2000.0))
    neutral = pin.neutral(model)
    for limit, joint in zip(joint_limits(name), model.joints[1:], strict=True):
        if "lower" not in limit:
            assert joint.nq == 2  # continuous: no position limit
            continue
        assert float(limit["lower"]) < neutral[joint.idx_q] < float(limit["upper"])


def test_gantry_rail_is_two_metres() -> None:
    model = load("gantry7")
    assert model.upperPositionLimit[0] - model.lowerPositionLimit[0] == 2.0


# --- inertias


def test_rx90l_masses_are_the_table() -> None:
    assert [inertia.mass for inertia in load("rx90l").inertias][2:] == RX90L_MASSES


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_inertias_are_physical(name: str) -> None:
    for inertia in list(load_floating(name).inertias)[1:]:
        assert inertia.mass > 0.0
        moments = np.linalg.eigvalsh(inertia.inertia)
        assert moments[0] > 0.0
        assert moments[0] + moments[1] > moments[2]


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_inertias_are_those_of_the_collision_solids(name: str) -> None:
    model = load_floating(name)
    shapes = load_shapes(name, model, pin.GeometryType.COLLISION).geometryObjects
    for joint, inertia in list(enumerate(model.inertias))[1:]:
        own = [shape for shape in shapes if shape.parentJoint == joint]
        density = inertia.mass / sum(solid_inertia(shape.geometry, 1.0).mass for shape in own)
        expected = pin.Inertia.Zero()
        for shape in own:
            expected += shape.placement.act(solid_inertia(shape.geometry, density))
        np.testing.assert_allclose(inertia.matrix(), expected.matrix(), rtol=1e-8, atol=1e-10)


# --- shapes


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("kind", [pin.GeometryType.VISUAL, pin.GeometryType.COLLISION])
def test_shapes_are_primitives_on_every_link(name: str, kind: pin.GeometryType) -> None:
    model = load(name)
    shapes = load_shapes(name, model, kind)
    count = dict.fromkeys(range(model.njoints), 0)
    for shape in shapes.geometryObjects:
        assert np.all(half_extents(shape.geometry) > 0.0)
        count[shape.parentJoint] += 1
    assert min(count.values()) >= 1
    if kind == pin.GeometryType.COLLISION:
        assert max(count.values()) <= 2


def test_rx90l_stands_from_the_floor_to_its_flange() -> None:
    model = load("rx90l")
    for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION):
        shapes = load_shapes("rx90l", model, kind)
        data, placed = model.createData(), shapes.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        pin.updateGeometryPlacements(model, data, shapes, placed)
        centre = np.array([M.translation for M in placed.oMg])
        half = np.array(
            [
                np.abs(M.rotation) @ half_extents(shape.geometry)
                for shape, M in zip(shapes.geometryObjects, placed.oMg, strict=True)
            ]
        )
        low, high = np.min(centre - half, axis=0), np.max(centre + half, axis=0)
        assert low[2] == pytest.approx(0.0, abs=1e-9)
        assert high[2] == pytest.approx(1.605, abs=1e-9)
        assert np.all(high[:2] - low[:2] < 0.5)


@pytest.mark.parametrize(("name", "q"), POSED)
def test_shapes_reach_the_joints(name: str, q: Array) -> None:
    model = load(name)
    shapes = load_shapes(name, model, pin.GeometryType.COLLISION)
    data, placed = model.createData(), shapes.createData()
    pin.forwardKinematics(model, data, q)
    pin.updateGeometryPlacements(model, data, shapes, placed)
    points = [M.translation for M in list(data.oMi)[1:]]
    for point in points:  # the last one is the flange
        nearest = min(
            distance_to_point(shape.geometry, M.actInv(point))
            for shape, M in zip(shapes.geometryObjects, placed.oMg, strict=True)
        )
        assert nearest < 1e-9


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_neighbouring_links_leave_no_gap(name: str) -> None:
    model = load(name)
    shapes = load_shapes(name, model, pin.GeometryType.COLLISION)
    add_pairs(shapes, lambda steps: steps == 1)
    parents = [shapes.geometryObjects[pair.second].parentJoint for pair in shapes.collisionPairs]
    data, placed = model.createData(), shapes.createData()
    rng = np.random.default_rng(93)
    for _ in range(5):
        _, q = random_angles(model, rng)
        pin.computeDistances(model, data, shapes, placed, q)
        gap = dict.fromkeys(range(1, model.njoints), np.inf)
        for parent, result in zip(parents, placed.distanceResults, strict=True):
            gap[parent] = min(gap[parent], result.min_distance)
        assert max(gap.values()) < 5e-3


@pytest.mark.parametrize(("name", "q"), POSED)
def test_the_arm_does_not_hit_itself(name: str, q: Array) -> None:
    model = load(name)
    shapes = load_shapes(name, model, pin.GeometryType.COLLISION)
    add_pairs(shapes, lambda steps: steps > 1)
    assert not pin.computeCollisions(model, model.createData(), shapes, shapes.createData(), q, False)


# -- robots by name ------------------------------------------------------------------------------------------------


def _installed() -> bool:
    try:
        return robot_data_path("urdf/panda.urdf").is_file()
    except MissingExtraError:
        return False


needs_robots = pytest.mark.skipif(not _installed(), reason="needs the extra robots")


def test_the_robots_of_coopqp_have_names() -> None:
    assert {name for name, robot in ROBOTS.items() if not robot.extra} == set(ROBOT_NAMES)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_is_what_its_entry_says(name: str) -> None:
    """Joints, tool frame and limits; the fingers are locked; every program gets its own placement and limits."""
    robot = ROBOTS[name]
    if robot.extra and not _installed():
        pytest.skip("needs the extra robots")
    base = pin.SE3(np.eye(3), np.array([1.0, 2.0, 3.0]))
    arm = robot_arm(name, name="mine", geometry=False, T_world_base=base.homogeneous, velocity=0.5)
    assert (arm.name, arm.model.nv, arm.tool_frame) == ("mine", robot.joints, robot.tool_frame)
    np.testing.assert_array_equal(arm.T_world_base.homogeneous, base.homogeneous)
    np.testing.assert_array_equal(arm.limits.velocity, 0.5)
    assert (robot_arm(name, geometry=False).limits.velocity != 0.5).all()
    np.testing.assert_array_equal(arm.limits.acceleration, robot.acceleration or np.inf)
    assert robot_file(name).is_file()
    line = next(line for line in robot_table().splitlines() if line.split()[0].rstrip("*") == name)
    assert all(word in line for word in (str(robot.joints), robot.licence, robot.source))


@needs_robots
def test_every_single_arm_of_the_package_has_a_name() -> None:
    """An arm is a chain of four joints or more that ends in one tool or in a gripper, and nothing else."""
    folder = next(path for path in robot_data_path("urdf/panda.urdf").parents if path.name == "robots")
    named = {str(robot_file(name)) for name, robot in ROBOTS.items() if robot.extra}
    arms = set()
    others = {"panda_collision", "hextilt_flying_arm_5"}  # the same arm with other shapes; an arm that flies
    for file in folder.rglob("*.urdf"):
        if 'robot name=""' in file.read_text() or not ET.parse(file).getroot().get("name"):
            continue
        model = pin.buildModelFromUrdf(str(file))
        longest = max((list(support)[1:] for support in model.supports), key=len)
        fingers = [i for i in range(1, model.njoints) if i not in longest]
        hand = all(model.parents[i] in longest[-2:] or model.parents[i] in fingers for i in fingers)
        if len(longest) >= 4 and len(fingers) <= 6 and hand and model.nv <= 13 and file.stem not in others:
            arms.add(str(file))
    assert arms == named


@needs_robots
def test_a_robot_has_its_meshes() -> None:
    arm = robot_arm("xarm7")
    assert len(arm.visual.geometryObjects) == 8
    assert all(Path(shape.meshPath).is_file() for shape in arm.visual.geometryObjects)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"robot": "rx90"}, "Did you mean 'rx90l'"),
        ({"robot": 3}, "no robot named '3'"),
        ({"robot": "arm7", "tool_frame": "tol"}, "Did you mean 'tool'"),
        ({"robot": "arm7", "locked_joints": {"joint_9": 0.0}}, "no joint named 'joint_9'"),
        ({"robot": "arm7", "locked_joints": {"joint_1": [1]}}, "joint_1"),
        ({"robot": "arm7", "locked_joints": 3}, "locked_joints is a int"),
        ({"robot": "arm7", "speed": 3}, "no limit named 'speed'"),
        ({"robot": "arm7", "name": "a/b"}, "'a/b' is not a name"),
        ({"robot": "arm7", "name": "a\x1b[2J"}, "has control characters"),
        ({"robot": "arm7", "T_world_base": 3}, "T_world_base"),
    ],
)
def test_a_wrong_request_is_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(CoopqpError, match=message):
        robot_arm(**arguments)  # type: ignore[arg-type]
