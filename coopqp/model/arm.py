"""One arm: its model, its tool frame, and the placement of its base.

Models are copied. The user's objects are never modified.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_vector, require
from coopqp.errors import InvalidInputError, ModelError, UnknownNameError, has_controls, nearest, shown
from coopqp.model.description import description_file, mesh_folders, read_urdf
from coopqp.model.followers import Follower, followers_locked, refuse_loops, urdf_followers
from coopqp.model.joint_limits import JointLimits, model_limits, narrow_to_soft_limits
from coopqp.model.links import joint_axes
from coopqp.model.meshes import load_mesh, mesh_unit
from coopqp.model.mjcf import read_mjcf
from coopqp.model.urdf_faults import urdf_fault
from coopqp.spatial import Placement, as_placement


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm: its model, its tool frame, and the placement of its base.

    Build it with :meth:`from_urdf`, :meth:`from_mjcf` or :meth:`from_model`.

    Attributes:
        name: name of the arm; prefix of its joints and frames in the cell.
        model: Pinocchio model of the arm, a copy, with the base at the origin.
        tool_frame: name of the frame that is rigidly attached to the object.
        T_world_base: placement of the base in the world.
        limits: joint limits.
        visual, collision: geometry models, or None.
        source: origin of the model (a file or a model name), for messages and recordings.
        robot: name of the :class:`Robot` whose arm it is; empty for an arm that is a robot by itself.
        shared: names of the joints that it shares with other arms of its robot, as a cell has found them.
    """

    name: str
    model: pin.Model
    tool_frame: str
    T_world_base: pin.SE3
    limits: JointLimits
    visual: pin.GeometryModel | None = None
    collision: pin.GeometryModel | None = None
    source: str = ""
    robot: str = ""
    shared: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Arm({self.name}: {self.model.nv} joints, tool {self.tool_frame}, {shown(self.source)})"

    @staticmethod
    def from_urdf(
        name: str,
        path: str | Path,
        *,
        tool_frame: str,
        T_world_base: Placement | None = None,
        package_dirs: Sequence[str | Path] = (),
        geometry: bool = True,
        locked_joints: Mapping[str, float] | None = None,
        velocity_limits: ArrayLike | None = None,
        acceleration_limits: ArrayLike | None = None,
        lower_limits: ArrayLike | None = None,
        upper_limits: ArrayLike | None = None,
    ) -> Arm:
        """Build an arm from a URDF file.

        Args:
            name: unique name in the cell.
            path: path of the URDF file.
            tool_frame: link or frame that grasps the object.
            T_world_base: placement of the model's root in the world (identity by default).
            package_dirs: folders in which ``package://`` mesh paths are resolved, before those that are found: the
                folders above the file, ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH``.
            geometry: also load the visual and collision shapes.
            locked_joints: joints to lock, with their positions [rad or m], e.g. gripper fingers. A joint that mimics
                another stands where that one takes it. Without a word here both are locked at zero, or at the nearest
                limit, if they move no tool.
            velocity_limits, acceleration_limits, lower_limits, upper_limits: replace the limits of the model; a scalar
                or one number per remaining joint. Of a ``safety_controller`` the soft position limits count where they
                are the narrower ones: a robot's own controllers stop there. URDF has no acceleration limits: they are
                infinite unless given here.

        Raises:
            ModelError: the file is missing, too large, not a robot, or has joints that coopqp cannot drive.
            UnknownNameError: no such tool frame or locked joint.
            InvalidInputError: bad limits or placement.
        """
        return urdf_arm(
            name, path, (tool_frame,), T_world_base, package_dirs, geometry, locked_joints,
            (velocity_limits, acceleration_limits, lower_limits, upper_limits),
        )  # fmt: skip

    @staticmethod
    def from_mjcf(
        name: str,
        path: str | Path,
        *,
        tool_frame: str,
        T_world_base: Placement | None = None,
        geometry: bool = True,
        locked_joints: Mapping[str, float] | None = None,
        velocity_limits: ArrayLike | None = None,
        acceleration_limits: ArrayLike | None = None,
        lower_limits: ArrayLike | None = None,
        upper_limits: ArrayLike | None = None,
    ) -> Arm:
        """Build an arm from an MJCF file, as MuJoCo reads it. Arguments and errors as in :meth:`from_urdf`.

        The model's root is MuJoCo's world. Planes and height fields, which have no end, are no shapes of the arm. Files
        of meshes are needed also without ``geometry``. MJCF has no velocity limits: give ``velocity_limits``.

        Raises:
            MissingExtraError: the extra ``mujoco`` is not installed.
        """
        source = description_file(path, name)
        read = read_mjcf(source, name)
        shapes = {"visual": read.visual if geometry else None, "collision": read.collision if geometry else None}
        return built_arm(
            name, read.model, (tool_frame,), T_world_base, locked_joints, shapes, str(source),
            (velocity_limits, acceleration_limits, lower_limits, upper_limits), read.followers, loops=read.loops,
        )  # fmt: skip

    @staticmethod
    def from_model(
        name: str,
        model: pin.Model,
        *,
        tool_frame: str,
        T_world_base: Placement | None = None,
        visual: pin.GeometryModel | None = None,
        collision: pin.GeometryModel | None = None,
        locked_joints: Mapping[str, float] | None = None,
        velocity_limits: ArrayLike | None = None,
        acceleration_limits: ArrayLike | None = None,
        lower_limits: ArrayLike | None = None,
        upper_limits: ArrayLike | None = None,
    ) -> Arm:
        """Build an arm from a copy of a :class:`pinocchio.Model`; see :meth:`from_urdf`."""
        require(model, pin.Model, f"arm '{name}': model", "Give a pinocchio.Model, or use from_urdf for a file.")
        shapes = {
            "visual": None if visual is None else visual.copy(),
            "collision": None if collision is None else collision.copy(),
        }
        return built_arm(
            name, pin.Model(model), (tool_frame,), T_world_base, locked_joints, shapes, "pinocchio.Model",
            (velocity_limits, acceleration_limits, lower_limits, upper_limits),
        )  # fmt: skip

    def placed(self, T_world_base: Placement, *, name: str | None = None) -> Arm:
        """Return a copy with another base placement and, if given, another name."""
        _check_name(self.name if name is None else name)
        return replace(
            self,
            name=self.name if name is None else name,
            T_world_base=as_placement(T_world_base, f"arm '{name or self.name}': T_world_base"),
        )

    def with_tool(self, tool_frame: str, *, name: str) -> Arm:
        """Return an arm of the same model with another tool frame and name.

        Raises:
            InvalidInputError, UnknownNameError, ModelError: as :meth:`from_urdf`.
        """
        _check_name(name)
        _check_tool(name, self.model, tool_frame, self.source)
        return replace(self, name=name, tool_frame=tool_frame)

    def with_limits(self, **changes: ArrayLike) -> Arm:
        """Return a copy with other limits (keywords of :class:`JointLimits`; a scalar applies to every joint)."""
        return replace(self, limits=self.limits.replace(**changes))


def urdf_arm(
    name: str,
    path: str | Path,
    tools: Sequence[str],
    T_world_base: Placement | None,
    package_dirs: Sequence[str | Path],
    geometry: bool,
    locked_joints: Mapping[str, float] | None,
    limits: tuple[Any, Any, Any, Any],
    robot: str = "",
) -> Arm:
    """:meth:`Arm.from_urdf` for the first of ``tools``, all of which are moved.

    ``limits`` are those of velocity, acceleration, lower and upper, as :func:`model_limits` takes them; by the joints'
    names for a ``robot``.
    """
    _check_locked(name, locked_joints)
    source = description_file(path, name)
    root = read_urdf(source, name)
    followers = urdf_followers(root, f"arm '{name}'")
    try:
        model = pin.buildModelFromUrdf(str(source))
    except (ValueError, RuntimeError) as error:
        why = urdf_fault(root) or _cause(error)
        raise ModelError(f"arm '{name}': {source} is not a readable URDF ({why})") from error
    if len([j for j in root.findall("joint") if j.get("type") != "fixed"]) != model.njoints - 1:
        why = urdf_fault(root) or "some of its joints do not hang together with its root"
        raise ModelError(f"arm '{name}': {source} is not a readable URDF ({why})")
    narrow_to_soft_limits(model, root)
    shapes: dict[str, pin.GeometryModel | None] = {"visual": None, "collision": None}
    if geometry:
        kinds = {"visual": pin.GeometryType.VISUAL, "collision": pin.GeometryType.COLLISION}
        dirs = mesh_folders(root, source, package_dirs)
        for key, kind in kinds.items():
            try:
                shapes[key] = _in_metres(pin.buildGeomFromUrdf(model, str(source), kind, package_dirs=dirs))
            except (OSError, ValueError, RuntimeError) as error:
                raise ModelError(
                    f"arm '{name}': the {key} geometry of {source} cannot be read ({_cause(error)}). "
                    "Give package_dirs, or geometry=False to do without."
                ) from error
    return built_arm(name, model, tools, T_world_base, locked_joints, shapes, str(source), limits, followers, robot)


def _in_metres(shapes: pin.GeometryModel) -> pin.GeometryModel:
    """Shapes whose meshes have the unit of their files. Raises as :func:`coopqp.model.meshes.load_mesh`."""
    for shape in shapes.geometryObjects:
        if Path(shape.meshPath).suffix.lower() == ".dae" and mesh_unit(Path(shape.meshPath)) != 1.0:
            shape.geometry = load_mesh(Path(shape.meshPath), shape.meshScale)
    return shapes


def built_arm(
    name: str,
    model: pin.Model,
    tools: Sequence[str],
    T_world_base: Placement | None,
    locked_joints: Mapping[str, float] | None,
    shapes: dict[str, pin.GeometryModel | None],
    source: str,
    limits: tuple[Any, Any, Any, Any],
    followers: Mapping[str, Follower] | None = None,
    robot: str = "",
    loops: Mapping[str, frozenset[str]] | None = None,
) -> Arm:
    """An arm with the first of ``tools``, from a model that nobody else has."""
    _check_name(name)
    _check_locked(name, locked_joints)
    base = pin.SE3.Identity() if T_world_base is None else as_placement(T_world_base, f"arm '{name}': T_world_base")
    mimics = [n for n, joint in zip(model.names, model.joints, strict=True) if "Mimic" in joint.shortname()]
    if mimics:
        raise ModelError(
            f"arm '{name}': joint '{mimics[0]}' mimics another. Build the model without mimic joints and lock it where "
            "it stands, or read its URDF with Arm.from_urdf, which does so."
        )
    _separate_frames(model)
    locked = _positions(name, model, locked_joints or {})
    if followers:
        locked = followers_locked(f"arm '{name}'", model, followers, tools, locked)
    if loops:
        refuse_loops(f"arm '{name}'", model, loops, tools, locked)
    if locked:
        _check_unique(name, model)
        model, shapes = _lock(model, shapes, locked)
    _check_joints(name, model)
    _separate_frames(model)
    _check_tool(name, model, tools[0], source)
    own = model_limits(f"robot '{robot}'" if robot else f"arm '{name}'", model, *limits, by_name=bool(robot))
    return Arm(name, model, tools[0], base, own, shapes["visual"], shapes["collision"], source, robot)


def _check_name(name: Any) -> None:
    if not isinstance(name, str) or not name or "/" in name:
        raise InvalidInputError(f"{shown(name)} is not a name", "Arm.name", "Give a non-empty name without '/'.")
    if has_controls(name):
        raise InvalidInputError(f"{shown(name)} has control characters", "Arm.name", "Give plain text.")


def _check_tool(name: str, model: pin.Model, tool_frame: Any, source: str) -> None:
    if not isinstance(tool_frame, str) or not model.existFrame(tool_frame):
        names = [f.name for f in model.frames if f.name != "universe"]
        near = nearest(str(tool_frame), names, most=12, cutoff=0.0)
        raise UnknownNameError("frame", str(tool_frame), near, f"arm '{name}' ({source})")
    if model.frames[model.getFrameId(tool_frame)].parentJoint == 0:
        raise ModelError(f"arm '{name}': no joint moves the tool frame '{tool_frame}' ({source}).")


def _check_locked(name: str, locked: Any) -> None:
    if locked is not None:
        require(locked, Mapping, f"arm '{name}': locked_joints", "Give a dictionary of joints and their positions.")


def _positions(name: str, model: pin.Model, locked: Mapping[str, float]) -> dict[str, float]:
    """Positions of locked joints, all of which are there and have one degree of freedom."""
    out = {}
    for joint, position in locked.items():
        if not model.existJointName(joint):
            raise UnknownNameError("joint", joint, list(model.names)[1:], f"arm '{name}', locked_joints")
        j = model.joints[model.getJointId(joint)]
        out[joint] = float(as_vector([position], 1, f"arm '{name}': locked_joints['{joint}']")[0])
        if j.nv != 1:
            raise ModelError(
                f"arm '{name}': joint '{joint}' has {j.nv} degrees of freedom; joints with one can be locked."
            )
    return out


def _lock(
    model: pin.Model, shapes: dict[str, pin.GeometryModel | None], locked: Mapping[str, float]
) -> tuple[pin.Model, dict[str, pin.GeometryModel | None]]:
    q = pin.neutral(model)
    for joint, at in locked.items():
        j = model.joints[model.getJointId(joint)]
        # a continuous joint is stored as (cos, sin)
        q[j.idx_q : j.idx_q + j.nq] = [at] if j.nq == 1 else [np.cos(at), np.sin(at)]
    ids = [model.getJointId(joint) for joint in locked]
    bodies = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for i in ids:
        if model.names[i] in bodies:  # a locked joint becomes a frame, whose name must be its own
            model.names[i] += " (joint)"
    keys = [key for key, shape in shapes.items() if shape is not None]
    reduced, geometries = pin.buildReducedModel(model, [shapes[k] for k in keys], ids, q)
    before = {f.parentJoint: f.parentFrame for f in model.frames if f.type == pin.FrameType.JOINT}
    for i in ids:  # Pinocchio makes the frame of a locked joint its own parent
        frame = reduced.frames[reduced.getFrameId(model.names[i], pin.FrameType.FIXED_JOINT)]
        name = model.frames[before[i]].name if i in before else "universe"
        frame.parentFrame = reduced.getFrameId(f"{name} (joint)" if not reduced.existFrame(name) else name)
    return reduced, {**dict.fromkeys(shapes), **dict(zip(keys, geometries, strict=True))}


def _check_unique(name: str, model: pin.Model) -> None:
    """Joints are found by their names, and the first one is Pinocchio's world, ``universe``."""
    names = list(model.names)
    if len(set(names)) != len(names):
        raise ModelError(f"arm '{name}': joint names are not unique: {names}.")


def _check_joints(name: str, model: pin.Model) -> None:
    if model.nv == 0:
        raise ModelError(f"arm '{name}': the model has no moving joint. Lock fewer joints, or check the description.")
    names = list(model.names)
    _check_unique(name, model)
    odd = [joint for joint in names if has_controls(joint)]
    if odd:
        raise ModelError(f"arm '{name}': the joint name {odd[0]!r} has control characters. Rename it in the model.")
    for joint, joint_name in list(zip(model.joints, names, strict=True))[1:]:
        if joint.nv > 1:
            raise ModelError(
                f"arm '{name}': joint '{joint_name}' ({joint.shortname()}) has {joint.nv} degrees of freedom; an arm "
                "has a fixed base and one degree of freedom per joint. Remove the floating base, set T_world_base."
            )
    for i, axis in enumerate(joint_axes(model), start=1):
        if not abs(max(np.linalg.norm(axis[:3]), np.linalg.norm(axis[3:])) - 1.0) < 1e-6:
            raise ModelError(
                f"arm '{name}': joint '{names[i]}' has no valid axis or origin ({axis.tolist()}). Give both as "
                "finite numbers, the axis not zero."
            )


def _cause(error: Exception) -> str:
    """Message of a parser's error, without the file and line of the parser's source."""
    return " ".join(str(error).rpartition("message:")[2].split()).rstrip(".")


def _separate_frames(model: pin.Model) -> None:
    """Make frame names unique. If a link and a joint share a name, the link keeps it."""
    taken: set[str] = set()
    order = {pin.FrameType.BODY: 0, pin.FrameType.JOINT: 2}
    for frame in sorted(model.frames, key=lambda frame: order.get(frame.type, 1)):
        if frame.name in taken:
            frame.name = f"{frame.name} ({str(frame.type).lower()})"
        taken.add(frame.name)
