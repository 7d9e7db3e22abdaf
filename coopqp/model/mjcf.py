"""MJCF as MuJoCo itself reads it: the model that MuJoCo compiles, in Pinocchio's terms."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.errors import ModelError
from coopqp.lazy import needed
from coopqp.model.description import check_mjcf
from coopqp.model.followers import Follower
from coopqp.spatial import Array

#: Groups of geoms that MuJoCo's viewer shows by default: those below this one.
_SHOWN_GROUPS = 3


@dataclass(frozen=True, eq=False)
class MjcfModel:
    """What an MJCF describes.

    Attributes:
        model: its bodies and joints; the root is MuJoCo's world.
        visual, collision: shapes of the geoms that are shown, and of those that may touch others.
        followers: joints that follow others, by their names.
        loops: what holds bodies together beside their joints, with the names of the joints that depend on each other.
    """

    model: pin.Model
    visual: pin.GeometryModel
    collision: pin.GeometryModel
    followers: dict[str, Follower]
    loops: dict[str, frozenset[str]]


def read_mjcf(file: Path, arm: str) -> MjcfModel:
    """Read an MJCF file. Planes and height fields, which have no end, are no shapes of it.

    Raises:
        ModelError: MuJoCo cannot read it.
        MissingExtraError: mujoco is not installed.
    """
    check_mjcf(file, arm)
    mujoco = needed("mujoco", "mujoco", "mujoco")
    said = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # by default it writes a file into the folder where the program runs
    try:
        m = mujoco.MjModel.from_xml_path(str(file))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise ModelError(f"arm '{arm}': {file} is not a readable MJCF ({' '.join(str(error).split())})") from error
    finally:
        mujoco.set_mju_user_warning(said)
    reader = _Reader(mujoco, m)
    return MjcfModel(reader.model, reader.visual, reader.collision, reader.followers(), reader.loops())


class _Reader:
    """A Pinocchio model of a compiled MuJoCo model."""

    def __init__(self, mujoco: Any, m: Any) -> None:
        self._mujoco, self._m = mujoco, m
        self.model, self.visual, self.collision = pin.Model(), pin.GeometryModel(), pin.GeometryModel()
        self.model.name = "mjcf"
        self._joints = [m.joint(j).name or f"joint_{j}" for j in range(m.njnt)]
        self._carrier: list[tuple[int, pin.SE3]] = []  # of each body: its joint, and its place in that one's frame
        self._frames: list[int] = []
        for body in range(m.nbody):
            self._add_body(body)
        for site in range(m.nsite):
            self._add_frame(
                m.site(site).name or f"site_{site}", int(m.site_bodyid[site]), m.site_pos, m.site_quat, site
            )
        for geom in range(m.ngeom):
            self._add_geom(geom)

    def _add_body(self, body: int) -> None:
        m, model = self._m, self.model
        if body == 0:  # the world
            self._carrier.append((0, pin.SE3.Identity()))
            self._frames.append(0)
            return
        parent = int(m.body_parentid[body])
        carrier, place = self._carrier[parent]
        place = place * _placed(m.body_pos[body], m.body_quat[body])
        frame = self._frames[parent]
        for j in range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body]):
            joint, at, own = self._joint(j)
            carrier = model.addJoint(carrier, joint, place * at, self._joints[j], *self._bounds(j))
            frame, place = int(model.addJointFrame(carrier, frame)), own
        name = m.body(body).name or f"body_{body}"
        frame = int(model.addFrame(pin.Frame(name, carrier, frame, place, pin.FrameType.BODY), False))
        self._carrier.append((carrier, place))
        self._frames.append(frame)
        if m.body_mass[body] > 0.0:
            inertial = _placed(m.body_ipos[body], m.body_iquat[body])
            moments = inertial.rotation @ np.diag(m.body_inertia[body]) @ inertial.rotation.T
            inertia = pin.Inertia(float(m.body_mass[body]), inertial.translation, moments)
            model.appendBodyToJoint(carrier, inertia, place)

    def _joint(self, j: int) -> tuple[Any, pin.SE3, pin.SE3]:
        """A joint, its place in the body's frame before it, and the body's frame after it in the joint's own."""
        kinds, m = self._mujoco.mjtJoint, self._m
        kind, axis, anchor = int(m.jnt_type[j]), np.array(m.jnt_axis[j]), np.array(m.jnt_pos[j])
        zero = float(m.qpos0[m.jnt_qposadr[j]])  # the joint's position where the file places the body
        to, back = pin.SE3(np.eye(3), anchor), pin.SE3(np.eye(3), -anchor)
        if kind == int(kinds.mjJNT_HINGE):
            return (
                _along(axis, "R", pin.JointModelRevoluteUnaligned),
                to * pin.SE3(pin.exp3(-zero * axis), np.zeros(3)),
                back,
            )
        if kind == int(kinds.mjJNT_SLIDE):
            return _along(axis, "P", pin.JointModelPrismaticUnaligned), to * pin.SE3(np.eye(3), -zero * axis), back
        if kind == int(kinds.mjJNT_BALL):
            return pin.JointModelSpherical(), to, back
        return pin.JointModelFreeFlyer(), pin.SE3.Identity(), pin.SE3.Identity()

    def _bounds(self, j: int) -> tuple[Array, ...]:
        """Largest effort and velocity, and the least and largest position of a joint."""
        m, kinds = self._m, self._mujoco.mjtJoint
        if int(m.jnt_type[j]) not in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)):
            nq, nv = (4, 3) if int(m.jnt_type[j]) == int(kinds.mjJNT_BALL) else (7, 6)
            return np.full(nv, np.inf), np.full(nv, np.inf), np.full(nq, -np.inf), np.full(nq, np.inf)
        low, high = m.jnt_range[j] if m.jnt_limited[j] else (-np.inf, np.inf)
        effort = float(np.abs(m.jnt_actfrcrange[j]).max()) if m.jnt_actfrclimited[j] else np.inf
        return np.array([effort]), np.array([np.inf]), np.array([low]), np.array([high])

    def _add_frame(self, name: str, body: int, pos: Array, quat: Array, i: int) -> None:
        carrier, place = self._carrier[body]
        at = place * _placed(pos[i], quat[i])
        self.model.addFrame(pin.Frame(name, carrier, self._frames[body], at, pin.FrameType.OP_FRAME), False)

    def _add_geom(self, geom: int) -> None:
        m = self._m
        shape, body = self._shape(geom), int(m.geom_bodyid[geom])
        if shape is None:
            return
        carrier, place = self._carrier[body]
        name = m.geom(geom).name or f"{m.body(body).name}_geom_{geom}"
        at = place * _placed(m.geom_pos[geom], m.geom_quat[geom])
        for shapes, there in (
            (self.visual, m.geom_group[geom] < _SHOWN_GROUPS),
            (self.collision, bool(m.geom_contype[geom] or m.geom_conaffinity[geom])),
        ):
            if there:
                added = pin.GeometryObject(name, carrier, at, shape)
                added.parentFrame = self._frames[body]
                material = int(m.geom_matid[geom])
                added.meshColor = np.array(m.geom_rgba[geom] if material < 0 else m.mat_rgba[material], dtype=float)
                shapes.addGeometryObject(added)

    def _shape(self, geom: int) -> Any:
        """A coal geometry; None for planes and height fields."""
        import coal

        m, kinds = self._m, self._mujoco.mjtGeom
        kind, size = int(m.geom_type[geom]), m.geom_size[geom].tolist()
        if kind == int(kinds.mjGEOM_SPHERE):
            return coal.Sphere(size[0])
        if kind == int(kinds.mjGEOM_CAPSULE):
            return coal.Capsule(size[0], 2.0 * size[1])
        if kind == int(kinds.mjGEOM_CYLINDER):
            return coal.Cylinder(size[0], 2.0 * size[1])
        if kind == int(kinds.mjGEOM_ELLIPSOID):
            return coal.Ellipsoid(*size)
        if kind == int(kinds.mjGEOM_BOX):
            return coal.Box(*(2.0 * half for half in size))
        mesh = int(m.geom_dataid[geom])
        if kind not in (int(kinds.mjGEOM_MESH), int(kinds.mjGEOM_SDF)) or mesh < 0:
            return None
        vertices, faces = int(m.mesh_vertadr[mesh]), int(m.mesh_faceadr[mesh])
        made = coal.BVHModelOBBRSS()
        made.beginModel(int(m.mesh_facenum[mesh]), int(m.mesh_vertnum[mesh]))
        made.addVertices(np.array(m.mesh_vert[vertices : vertices + m.mesh_vertnum[mesh]], dtype=float))
        made.addTriangles(np.array(m.mesh_face[faces : faces + m.mesh_facenum[mesh]]))
        made.endModel()
        return made

    # -- equalities ------------------------------------------------------------------------------------------------

    def _active(self, *kinds: int) -> list[int]:
        m = self._m
        return [e for e in range(m.neq) if m.eq_active0[e] and int(m.eq_type[e]) in kinds]

    def followers(self) -> dict[str, Follower]:
        """Joints that follow another, or are held where they are, by their names."""
        m, out = self._m, {}
        for e in self._active(int(self._mujoco.mjtEq.mjEQ_JOINT)):
            own, leader = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            first, *others = m.eq_data[e][:5].tolist()
            zero = float(m.qpos0[m.jnt_qposadr[own]])
            if leader < 0:
                out[self._joints[own]] = Follower("", (zero + first,))
                continue
            coefficients = (zero + first, *others)
            out[self._joints[own]] = Follower(self._joints[leader], coefficients, float(m.qpos0[m.jnt_qposadr[leader]]))
        return out

    def loops(self) -> dict[str, frozenset[str]]:
        """Joints that connected bodies or tendons hold together, by what does so."""
        m, mujoco, out = self._m, self._mujoco, {}
        kinds = mujoco.mjtEq
        for e in self._active(int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)):
            ends = [int(m.eq_obj1id[e]), int(m.eq_obj2id[e])]
            if int(m.eq_objtype[e]) == int(mujoco.mjtObj.mjOBJ_SITE):
                ends = [int(m.site_bodyid[site]) for site in ends]
            one, other = (self._joints_to(body) for body in ends)
            names = " and ".join(f"'{m.body(body).name}'" if body else "the world" for body in ends)
            out[f"an equality of the bodies {names}"] = one ^ other
        for e in self._active(int(kinds.mjEQ_TENDON)):
            held: set[str] = set()
            for tendon in (int(m.eq_obj1id[e]), int(m.eq_obj2id[e])):
                if tendon >= 0:
                    wraps = range(m.tendon_adr[tendon], m.tendon_adr[tendon] + m.tendon_num[tendon])
                    for w in wraps:
                        if int(m.wrap_type[w]) == int(mujoco.mjtWrap.mjWRAP_JOINT):
                            held.add(self._joints[int(m.wrap_objid[w])])
                        elif int(m.wrap_type[w]) == int(mujoco.mjtWrap.mjWRAP_SITE):
                            held |= self._joints_to(int(m.site_bodyid[int(m.wrap_objid[w])]))
            out[f"an equality of the tendon '{m.tendon(int(m.eq_obj1id[e])).name}'"] = frozenset(held)
        return out

    def _joints_to(self, body: int) -> frozenset[str]:
        carrier = self._carrier[max(body, 0)][0]
        return frozenset(self.model.names[j] for j in self.model.supports[carrier] if j)


def _placed(pos: Array, quat: Array) -> pin.SE3:
    """A placement from a position and MuJoCo's quaternion (w, x, y, z)."""
    w, x, y, z = quat.tolist()
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(pos, dtype=float))


def _along(axis: Array, kind: str, other: Any) -> Any:
    """A joint that turns about or slides along an axis, one of its frame's where that fits."""
    for name, unit in zip("XYZ", np.eye(3), strict=True):
        if np.array_equal(axis, unit):
            return getattr(pin, f"JointModel{kind}{name}")()
    return other(axis)
