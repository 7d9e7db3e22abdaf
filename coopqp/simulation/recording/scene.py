"""The description of a cell in a recording. With it a run can be measured and shown again, also on another machine.

A scene is plain JSON: the joints of every arm and their limits, the tools, the bases, the visual shapes, and the box
that represents the object. Shapes are stored by their dimensions. A mesh from a file is stored by the file's name: the
file must exist when the run is shown, and it is opened only if the reader asks for it.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import math
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import as_vector
from coopqp.errors import CoopqpError
from coopqp.model.cell import Arm, RobotCell
from coopqp.model.meshes import load_mesh
from coopqp.paths.path import ObjectPath
from coopqp.reading import open_file
from coopqp.spatial import Array, Placement, as_placement

#: Version of the format.
FORMAT = 1
#: Largest accepted numbers of arms, of joints and shapes of an arm; largest mesh file and embedded mesh [bytes].
MAX_ARMS, MAX_JOINTS, MAX_SHAPES = 256, 256, 4096
MAX_MESH_BYTES = 100_000_000
#: Number of stored poses of a path, and the largest number accepted when reading.
PATH_POSES, MAX_PATH_POSES = 101, 10_000

_PLAIN_JOINTS = {f"JointModel{kind}{axis}" for kind in ("R", "P", "RUB") for axis in "XYZ"}
_AXIS_JOINTS = {f"JointModel{kind}Unaligned" for kind in ("Revolute", "Prismatic", "RevoluteUnbounded")}
_SCREW_JOINTS = {f"JointModelH{axis}" for axis in "XYZ"}
_MESH_ENDINGS = {".stl", ".dae", ".obj", ".ply", ".glb", ".gltf", ".off", ".3ds"}
#: Attributes with the dimensions of a shape, by the name of its class in coal.
_SIZES = {
    "Box": ("halfSide",),
    "Sphere": ("radius",),
    "Cylinder": ("radius", "halfLength"),
    "Capsule": ("radius", "halfLength"),
    "Cone": ("radius", "halfLength"),
    "Ellipsoid": ("radii",),
}
_GREY = [0.6, 0.6, 0.6, 1.0]


class SceneError(CoopqpError):
    """A recording does not describe its cell, or a file of the description is missing."""


@contextlib.contextmanager
def reading(what: str) -> Iterator[None]:
    """Errors of damaged data become a :class:`SceneError`: "the recording's ``what`` damaged"."""
    try:
        yield
    except SceneError:
        raise
    except (CoopqpError, KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise SceneError(f"the recording's {what} damaged ({type(error).__name__}: {error}).") from error


# -- writing ------------------------------------------------------------------------------------------------------


def describe_cell(cell: RobotCell) -> dict[str, Any]:
    """The cell as plain JSON; :func:`read_cell` is the inverse.

    Placements are 4x4 matrices, lengths are in metres, angles in radians. A missing limit is null.
    """
    return {"format": FORMAT, "arms": [_describe_arm(arm) for arm in cell.arms]}


def describe_object(size: Any, T_object_body: Placement) -> dict[str, Any]:
    """The box that represents the object, as plain JSON for the entry ``object`` of a recording's metadata.

    Args:
        size: side lengths [m], shape (3,).
        T_object_body: placement of the box's centre in the object frame.
    """
    body = as_placement(T_object_body, "describe_object: T_object_body")
    return {"size_m": as_vector(size, 3, "describe_object: size").tolist(), "T_object_body": _matrix(body)}


def describe_path(path: ObjectPath) -> list[list[float]] | None:
    """Poses along the whole path, even beyond the end of the run: rows x, y, z [m], qx, qy, qz, qw.

    None for a path that is not known ahead.
    """
    if not (path.known_ahead and math.isfinite(path.duration)):
        return None
    poses = [path.pose(float(clock)) for clock in np.linspace(0.0, path.duration, PATH_POSES)]
    return [np.asarray(pin.SE3ToXYZQUAT(T), dtype=float).tolist() for T in poses]


def _describe_arm(arm: Arm) -> dict[str, Any]:
    model, limits = arm.model, arm.limits
    joints = []
    for i in range(1, model.njoints):
        joint = model.joints[i]
        entry = {
            "name": model.names[i],
            "type": joint.shortname(),
            "parent": int(model.parents[i]),
            "placement": _matrix(model.jointPlacements[i]),
        }
        if entry["type"] in _AXIS_JOINTS:
            entry["axis"] = _axis(joint)
        elif entry["type"] in _SCREW_JOINTS:
            entry["pitch"] = float(joint.extract().pitch)
        joints.append(entry)
    tool = model.frames[model.getFrameId(arm.tool_frame)]
    shapes = [] if arm.visual is None else [describe_shape(shape) for shape in arm.visual.geometryObjects]
    return {
        "name": arm.name,
        "source": arm.source,
        **({"robot": arm.robot} if arm.robot else {}),
        "base": _matrix(arm.T_world_base),
        "tool": {"name": arm.tool_frame, "joint": int(tool.parentJoint), "placement": _matrix(tool.placement)},
        "joints": joints,
        "limits": {
            name: [float(x) if math.isfinite(x) else None for x in getattr(limits, name)]
            for name in ("lower", "upper", "velocity", "acceleration")
        },
        "shapes": shapes,
    }


def _axis(joint: Any) -> list[float]:
    """The axis of a revolute or prismatic joint in its own frame, from its motion subspace (6,)."""
    data = joint.createData()
    joint.calc(data, np.array([1.0, 0.0])[: joint.nq])
    subspace = np.asarray(data.S, dtype=float).reshape(6)
    return (subspace[:3] + subspace[3:]).tolist()


def describe_shape(shape: Any) -> dict[str, Any]:
    """A Pinocchio geometry object as plain JSON."""
    geometry, kind = shape.geometry, type(shape.geometry).__name__
    entry = {
        "name": shape.name,
        "joint": int(shape.parentJoint),
        "placement": _matrix(shape.placement),
        "color": [round(float(c), 4) for c in shape.meshColor],
        "kind": kind,
    }
    if kind in _SIZES:
        entry["size"] = {name: np.asarray(getattr(geometry, name), dtype=float).tolist() for name in _SIZES[kind]}
    elif Path(shape.meshPath).suffix.lower() in _MESH_ENDINGS:
        entry["kind"], entry["file"] = "mesh", str(Path(shape.meshPath).absolute())
        entry["scale"] = np.asarray(shape.meshScale, dtype=float).tolist()
    elif kind == "Convex":
        entry |= _triangles(geometry.points(), map(geometry.polygons, range(geometry.num_polygons)))
    elif kind.startswith("BVHModel"):
        entry |= _triangles(geometry.vertices(), map(geometry.tri_indices, range(geometry.num_tris)))
    return entry


def _triangles(vertices: Any, triangles: Iterable[Any]) -> dict[str, str]:
    """The entries of a mesh: its vertices (V, 3) [m], and the indices of each triangle's corners (F, 3)."""
    corners = np.array([[t[0], t[1], t[2]] for t in triangles], dtype="<i4").reshape(-1, 3)
    return {"kind": "triangles", "vertices": _packed(np.array(vertices, dtype="<f4")), "triangles": _packed(corners)}


def _matrix(T: pin.SE3) -> list[list[float]]:
    return np.asarray(T.homogeneous, dtype=float).tolist()


def _packed(array: Any) -> str:
    return base64.b64encode(zlib.compress(array.tobytes(), 6)).decode("ascii")


# -- reading ------------------------------------------------------------------------------------------------------


def read_cell(metadata: Mapping[str, Any], *, shapes: bool = True, meshes: bool = False) -> RobotCell:
    """The cell of a recording, from the entry ``scene`` of its metadata.

    Args:
        metadata: metadata of the recording.
        shapes: also read the visual shapes.
        meshes: open the mesh files that the scene names; without, their shapes are left out. A stranger's scene may
            name any file of your disk.

    Raises:
        SceneError: the scene is missing or damaged, or a mesh file is missing.
    """
    scene = metadata.get("scene")
    if not isinstance(scene, Mapping):
        raise SceneError("the recording does not describe its cell (no 'scene' in its metadata). Run it again.")
    if scene.get("format") != FORMAT:
        raise SceneError(f"the recording's scene has format {scene.get('format')!r}, not {FORMAT}. Run it again.")
    with reading("scene is"):
        entries = scene["arms"]
        if not 1 <= len(entries) <= MAX_ARMS:
            raise SceneError(f"the recording's scene has {len(entries)} arms; 1 to {MAX_ARMS} are read.")
        return RobotCell([_read_arm(entry, shapes, meshes) for entry in entries])


def read_object(metadata: Mapping[str, Any], T_object_tool: Array) -> tuple[Array, pin.SE3]:
    """The box that represents the object of a recording: side lengths (3,) [m] and ``T_object_body``.

    By default this is a box around the grasps.

    Args:
        metadata: metadata of the recording.
        T_object_tool: grasp of the recording (N, 4, 4).

    Raises:
        SceneError: the entry is damaged.
    """
    entry = metadata.get("object")
    if entry is None:
        points = np.asarray(T_object_tool)[:, :3, 3]
        low, high = points.min(axis=0), points.max(axis=0)
        return np.maximum(high - low, 0.04), pin.SE3(np.eye(3), 0.5 * (low + high))
    with reading("object is"):
        size = as_vector(entry["size_m"], 3, "size_m")
        body = as_placement(entry["T_object_body"], "T_object_body")
    if not (size > 0.0).all():
        raise SceneError(f"the recording's object is damaged (its size is {size.tolist()}).")
    return size, body


def read_path(metadata: Mapping[str, Any]) -> list[pin.SE3] | None:
    """Poses along the whole path of a recording; None if the recording has none.

    Raises:
        SceneError: the entry is damaged.
    """
    rows = metadata.get("path")
    if rows is None:
        return None
    try:
        table = np.array(rows, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"the recording's path is damaged ({error}).") from error
    unit = table.ndim == 2 and table.shape[1] == 7 and 1 <= len(table) <= MAX_PATH_POSES
    if not unit or not np.abs(np.linalg.norm(table[:, 3:], axis=1) - 1.0).max() < 1e-6 or not np.isfinite(table).all():
        raise SceneError("the recording's path is damaged (it is no list of poses).")
    return [pin.XYZQUATToSE3(row) for row in table]


def named_meshes(metadata: Mapping[str, Any]) -> list[str]:
    """The mesh files that a recording names; empty if it does not describe its cell."""
    try:
        arms = metadata["scene"]["arms"]
        return sorted({str(s["file"]) for arm in arms for s in arm["shapes"] if s["kind"] == "mesh"})
    except (KeyError, TypeError):
        return []


def _read_arm(entry: Mapping[str, Any], with_shapes: bool, meshes: bool) -> Arm:
    joints, limits, tool = entry["joints"], entry["limits"], entry["tool"]
    if not 1 <= len(joints) <= MAX_JOINTS:
        raise SceneError(
            f"arm '{entry['name']}' of the recording has {len(joints)} joints; 1 to {MAX_JOINTS} are read."
        )
    model = pin.Model()
    for i, joint in enumerate(joints):
        parent = _index(joint["parent"], i + 1)
        placement = as_placement(joint["placement"], f"joint '{joint['name']}'")
        added = model.addJoint(parent, _joint_model(joint, entry["name"]), placement, str(joint["name"]))
        model.addJointFrame(added)
    carrier = _index(tool["joint"], len(joints) + 1)
    placement = as_placement(tool["placement"], "tool")
    model.addFrame(pin.Frame(str(tool["name"]), carrier, 0, placement, pin.FrameType.OP_FRAME))
    arm = Arm.from_model(
        str(entry["name"]),
        model,
        tool_frame=str(tool["name"]),
        T_world_base=as_placement(entry["base"], "base"),
        visual=_read_shapes(entry, model, meshes) if with_shapes else None,
        lower_limits=_limits(limits["lower"], -np.inf, len(joints)),
        upper_limits=_limits(limits["upper"], np.inf, len(joints)),
        velocity_limits=_limits(limits["velocity"], np.inf, len(joints)),
        acceleration_limits=_limits(limits["acceleration"], np.inf, len(joints)),
    )
    return replace(arm, source=str(entry["source"]), robot=str(entry.get("robot", "")))


def _joint_model(joint: Mapping[str, Any], arm: str) -> Any:
    kind = joint["type"]
    if kind in _PLAIN_JOINTS:
        return getattr(pin, kind)()
    if kind in _AXIS_JOINTS:
        axis = as_vector(joint["axis"], 3, "axis")
        if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-6:
            raise SceneError(f"joint '{joint['name']}' of arm '{arm}': its axis is not of unit length.")
        return _unbounded(axis) if "Unbounded" in kind else getattr(pin, kind)(axis)
    if kind in _SCREW_JOINTS:
        return getattr(pin, kind)(float(joint["pitch"]))
    raise SceneError(f"joint '{joint['name']}' of arm '{arm}' is a {kind}; a recording cannot describe it.")


def _unbounded(axis: Array) -> Any:
    """A continuous joint about any axis. Pinocchio's Python interface can only build it from a description."""
    xyz = " ".join(repr(float(x)) for x in axis)
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="{}"/></joint>'
    model = pin.buildModelFromXML(f'<robot name="r"><link name="a"/><link name="b"/>{joint.format(xyz)}</robot>')
    return model.joints[1]


def _limits(values: Any, absent: float, n: int) -> Array:
    if len(values) != n:
        raise SceneError(f"the recording's scene is damaged ({len(values)} limits for {n} joints).")
    return np.array([absent if x is None else float(x) for x in values])


def _index(value: Any, bound: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < bound:
        raise SceneError(f"the recording's scene is damaged (index {value!r} of {bound}).")
    return value


def _read_shapes(entry: Mapping[str, Any], model: pin.Model, meshes: bool) -> pin.GeometryModel:
    shapes = pin.GeometryModel()
    if len(entry["shapes"]) > MAX_SHAPES:
        raise SceneError(f"arm '{entry['name']}' of the recording has more than {MAX_SHAPES} shapes.")
    for shape in entry["shapes"]:
        if shape["kind"] == "mesh" and not meshes:
            continue
        geometry = read_geometry(shape, str(entry["name"]))
        if geometry is None:
            continue
        joint = _index(shape["joint"], model.njoints)
        placement = as_placement(shape["placement"], f"shape '{shape['name']}'")
        added = pin.GeometryObject(str(shape["name"]), joint, placement, geometry)
        added.parentFrame = model.getFrameId(model.names[joint])  # otherwise Pinocchio reads past its frames
        added.meshColor = np.clip(as_vector(shape.get("color", _GREY), 4, "color"), 0.0, 1.0)
        if shape["kind"] == "mesh":
            added.meshPath, added.meshScale = str(shape["file"]), as_vector(shape["scale"], 3, "scale")
        shapes.addGeometryObject(added)
    return shapes


def read_geometry(shape: Mapping[str, Any], arm: str) -> Any:
    """The shape as a coal geometry; None for kinds that cannot be drawn (planes, height fields)."""
    import coal

    kind = shape["kind"]
    if kind in _SIZES:
        size = [np.asarray(shape["size"][name], dtype=float) for name in _SIZES[kind]]
        if not all(np.isfinite(x).all() and (x >= 0.0).all() for x in size):
            raise SceneError(f"shape '{shape['name']}' of arm '{arm}' has no size.")
        if kind in ("Box", "Ellipsoid"):
            return getattr(coal, kind)(*((2.0 if kind == "Box" else 1.0) * as_vector(size[0], 3, "size")).tolist())
        radius, *half_length = (float(x) for x in size)
        return getattr(coal, kind)(radius, *(2.0 * h for h in half_length))
    if kind == "mesh":
        return _mesh_from_file(Path(str(shape["file"])), as_vector(shape["scale"], 3, "scale"), arm)
    if kind == "triangles":
        vertices = np.frombuffer(_unpacked(shape["vertices"]), dtype="<f4").reshape(-1, 3)
        triangles = np.frombuffer(_unpacked(shape["triangles"]), dtype="<i4").reshape(-1, 3)
        if not np.isfinite(vertices).all() or (triangles < 0).any() or (triangles >= len(vertices)).any():
            raise SceneError(f"shape '{shape['name']}' of arm '{arm}' has triangles without corners.")
        mesh = coal.BVHModelOBBRSS()
        mesh.beginModel(len(triangles), len(vertices))
        mesh.addVertices(np.asarray(vertices, dtype=float))
        mesh.addTriangles(np.asarray(triangles, dtype=np.int64))
        mesh.endModel()
        return mesh
    return None


def _unpacked(text: Any) -> bytes:
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(base64.b64decode(str(text), validate=True), MAX_MESH_BYTES)
    except (zlib.error, binascii.Error) as error:
        raise SceneError(f"the recording's scene is damaged (a mesh: {error}).") from error
    if stream.unconsumed_tail:
        raise SceneError(f"the recording's scene has a mesh of more than {MAX_MESH_BYTES} bytes; not read.")
    return data


def _mesh_from_file(file: Path, scale: Array, arm: str) -> Any:
    if file.suffix.lower() not in _MESH_ENDINGS:
        raise SceneError(f"arm '{arm}': {file} is not a mesh file.")
    try:
        open_file(file, MAX_MESH_BYTES).close()
    except FileNotFoundError as error:
        raise SceneError(
            f"arm '{arm}': the mesh {error.filename} is gone. Put it back, or show the run without shapes (--sticks)."
        ) from error
    except OSError as error:
        raise SceneError(f"arm '{arm}': the mesh {error.filename} was not read: {error.strerror}.") from error
    try:
        return load_mesh(file, scale)
    except (OSError, ValueError, RuntimeError) as error:
        raise SceneError(f"arm '{arm}': the mesh {file} cannot be read ({error}).") from error
