"""A cell and its object as a MuJoCo model, built from the arms' own Pinocchio models.

No file is read a second time, so URDF, MJCF and hand-made models are treated alike. Joint placements, axes and inertias
are copied; primitive visual shapes are drawn, meshes are not. Pads of palms touch the object; there are no other
collisions, no joint stops and no torque limits: the controller has to respect the limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.errors import ModelError
from coopqp.forces.grips import Grip
from coopqp.lazy import needed
from coopqp.model.cell import Arm, RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.links import joint_axes
from coopqp.simulation.plants.physics_options import PhysicsOptions, Servos
from coopqp.spatial import Array

OBJECT, STAND = "object", "stand"
#: Half the thickness of a palm's pad and of the stand [m].
_PAD, STAND_HALF = 0.005, 0.01
#: solref and solimp of contacts of palms: rubber. Between stiffer pads the box rattles.
_CONTACT = ((0.02, 1.0), (0.9, 0.97, 0.0005, 0.5, 2.0))
#: Stiffness of friction over the normal's, and number of solver passes against creep.
_FRICTION_STIFFER, _NO_SLIP_ITERATIONS = 10.0, 10
#: Smallest mass and inertia of a link [kg, kg·m²]; smaller ones are raised, because the engine needs positive values.
_LEAST_MASS, _LEAST_INERTIA = 1e-6, 1e-9


def require_mujoco() -> Any:
    """The mujoco module.

    Raises:
        MissingExtraError: mujoco is not installed.
    """
    return needed("mujoco", "mujoco", "mujoco")


def tool_site(arm: str) -> str:
    """Name of the site at an arm's tool, and of its body, weld and sensors."""
    return f"{arm}:tool"


def grip_site(arm: str) -> str:
    """Name of the site on the object at the weld of an arm's tool."""
    return f"{arm}:grip"


def build_spec(
    cell: RobotCell,
    grasp: Grasp,
    *,
    object_size: Array,
    object_mass: float,
    T_object_body: pin.SE3,
    servos: Servos,
    options: PhysicsOptions,
    base_offset: Mapping[str, pin.SE3],
    palms: Mapping[str, Grip] | None = None,
) -> Any:
    """Build the ``mujoco.MjSpec``: arms at their real bases, the object as a free box, welds from tools to grip sites.

    With ``palms`` pads press on the box in place of the welds, with contacts and friction, and the box lies on a smooth
    stand at first.

    The body frame of the object is the object frame: the generalized force of its free joint is the wrench there.
    Joints have the names of the cell. Each has a position servo or a motor of the same name.
    """
    mujoco = require_mujoco()
    spec = mujoco.MjSpec()
    spec.modelname = "coopqp cell"
    compiler = spec.compiler
    compiler.degree, compiler.autolimits, compiler.discardvisual, compiler.fusestatic = False, False, False, False
    compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    compiler.boundmass, compiler.boundinertia, compiler.balanceinertia = _LEAST_MASS, _LEAST_INERTIA, True
    option = spec.option
    option.timestep, option.gravity = options.timestep, options.gravity
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.tolerance, option.iterations = options.tolerance, options.iterations
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if palms is None:
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    else:
        option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _FRICTION_STIFFER
        option.noslip_iterations = _NO_SLIP_ITERATIONS
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 720
    spec.worldbody.add_light(pos=[0.0, 0.0, 4.0], dir=[0.0, 0.0, -1.0])
    _add_geom(spec.worldbody, mujoco.mjtGeom.mjGEOM_PLANE, [10.0, 10.0, 0.1], pin.SE3.Identity(), (0.9, 0.9, 0.92, 1.0))

    box = _add_body(spec.worldbody, OBJECT, pin.SE3.Identity())
    box.add_freejoint(name=OBJECT)
    _set_inertia(box, T_object_body.act(pin.Inertia.FromBox(object_mass, *object_size)))
    _add_geom(box, mujoco.mjtGeom.mjGEOM_BOX, 0.5 * object_size, T_object_body, (0.30, 0.52, 0.75, 1.0))

    if palms is not None:
        _touches(box.geoms[0], object_=True)
        stand = _add_body(spec.worldbody, STAND, pin.SE3.Identity())  # reset places it below the object
        half = 0.5 * object_size + [0.0, 0.0, STAND_HALF - 0.5 * object_size[2]]
        _add_geom(stand, mujoco.mjtGeom.mjGEOM_BOX, half, pin.SE3.Identity(), (0.6, 0.6, 0.6, 1.0))
        _touches(stand.geoms[0], object_=False)
        stand.geoms[0].name, stand.geoms[0].friction, stand.geoms[0].priority = STAND, [0.05, 0.005, 0.0001], 2
        stand.geoms[0].solref, stand.geoms[0].solimp = _CONTACT
    bodies: dict[str, Any] = {}
    for k, (arm, X) in enumerate(zip(cell.arms, grasp.T_object_tool, strict=True)):
        box.add_site(name=grip_site(arm.name), pos=X.translation, quat=quaternion(X.rotation))  # reset moves it
        tool = _add_arm(mujoco, spec, cell, k, bodies, servos, options, base_offset, welded=palms is None)
        if palms is not None:
            _add_pad(mujoco, tool, palms[arm.name])
    return spec


def compile_spec(spec: Any) -> Any:
    """Compile the ``mujoco.MjModel``.

    Raises:
        ModelError: the engine refuses the model; the message gives the reason.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise ModelError(
            f"MuJoCo cannot use the cell's model: {error}. Check the links' masses and inertias."
        ) from error


def _add_arm(
    mujoco: Any,
    spec: Any,
    cell: RobotCell,
    k: int,
    there: dict[str, Any],
    servos: Servos,
    options: PhysicsOptions,
    base_offset: Mapping[str, pin.SE3],
    *,
    welded: bool,
) -> Any:
    """Add arm k, and its weld to the object unless it has a palm. Returns the body of its tool.

    Bodies that are ``there`` by their names are not added again: the base and the shared joints of arms that share
    joints. What is new is added to them.
    """
    arm = cell.arms[k]
    model, base = arm.model, f"{arm.robot if arm.shared else arm.name}:base"
    twists, servoed = joint_axes(model), options.servo == "position"
    known = set(there)
    if base not in known:
        T_base = arm.T_world_base * base_offset.get(arm.name, pin.SE3.Identity())
        there[base] = _add_body(spec.worldbody, base, T_base)
        _set_inertia(there[base], model.inertias[0])
    names = [base, *(cell.joint_names[j] for j in cell.columns[k][[joint.idx_v for joint in model.joints][1:]])]
    for i in range(1, model.njoints):
        name = names[i]
        if name in known:
            continue
        j = cell.columns[k][model.joints[i].idx_v]
        body = there[name] = _add_body(there[names[model.parents[i]]], name, model.jointPlacements[i])
        body.gravcomp = options.assumed_mass if options.gravity_compensation and servoed else 0.0
        _set_inertia(body, model.inertias[i])
        axis, slides = _axis(arm, i, twists[model.joints[i].idx_v])
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
            axis=axis,
            armature=float(servos.armature[j]),
        )
        actuator = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        kp, kd = float(servos.stiffness[j]), float(servos.damping[j])
        gains = (kp, -kp, -kd) if servoed else (1.0, 0.0, 0.0)
        actuator.gainprm[0], actuator.biasprm[1], actuator.biasprm[2] = gains
    if arm.visual is not None:
        for item in arm.visual.geometryObjects:
            if names[item.parentJoint] not in known:
                _add_shape(mujoco, there[names[item.parentJoint]], item)
    frame = model.frames[model.getFrameId(arm.tool_frame)]
    site = tool_site(arm.name)
    tool = _add_body(there[names[frame.parentJoint]], site, frame.placement)  # massless, carries the sensors
    tool.gravcomp = float(servoed)
    tool.add_site(name=site)
    if welded:
        weld = spec.add_equality(name=site, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_SITE)
        weld.name1, weld.name2 = grip_site(arm.name), site
        weld.solref, weld.solimp = options.weld_solref, options.weld_solimp
    for kind, sensor in (("force", mujoco.mjtSensor.mjSENS_FORCE), ("torque", mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=f"{arm.name}:{kind}", type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)
    return tool


def _add_pad(mujoco: Any, tool: Any, palm: Grip) -> None:
    """A square pad around the palm's disc, whose face is at the tool's origin."""
    normal = np.asarray(palm.normal)
    x = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    x /= np.linalg.norm(x)
    T = pin.SE3(np.column_stack([x, np.cross(normal, x), normal]), -_PAD * normal)
    half = max(palm.radius, 0.01)
    _add_geom(tool, mujoco.mjtGeom.mjGEOM_BOX, [half, half, _PAD], T, (0.2, 0.2, 0.22, 1.0))
    pad = tool.geoms[-1]
    _touches(pad, object_=False)
    pad.condim, pad.friction, pad.priority = 3, [palm.friction, 0.005, 0.0001], 1
    pad.solref, pad.solimp = _CONTACT


def _touches(geom: Any, *, object_: bool) -> None:
    """The object touches the pads, and nothing else touches."""
    geom.contype, geom.conaffinity = (2, 1) if object_ else (1, 2)


def _axis(arm: Arm, i: int, twist: Array) -> tuple[Array, bool]:
    """Axis of joint ``i`` in its own frame, and True if the joint is prismatic."""
    slides, turns = np.linalg.norm(twist[:3]) > 1e-12, np.linalg.norm(twist[3:]) > 1e-12
    if slides and turns:
        raise ModelError(
            f"arm '{arm.name}': joint '{arm.model.names[i]}' turns and slides at once; the physics plant has no such "
            "joint. Model it as a revolute or a prismatic joint."
        )
    return (twist[:3] if slides else twist[3:]), bool(slides)


def _add_body(parent: Any, name: str, T: pin.SE3) -> Any:
    return parent.add_body(name=name, pos=T.translation, quat=quaternion(T.rotation))


def _set_inertia(body: Any, inertia: pin.Inertia) -> None:
    body.explicitinertial = True
    body.mass = max(inertia.mass, _LEAST_MASS)
    body.ipos = inertia.lever
    moments, axes = np.linalg.eigh(0.5 * (inertia.inertia + inertia.inertia.T))
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    body.iquat, body.inertia = quaternion(axes), np.maximum(moments, _LEAST_INERTIA)


def _add_geom(body: Any, kind: Any, size: Any, T: pin.SE3, rgba: tuple[float, ...]) -> None:
    full = np.zeros(3)
    full[: len(size)] = size
    body.add_geom(type=kind, size=full, pos=T.translation, quat=quaternion(T.rotation), rgba=rgba,
                  contype=0, conaffinity=0, mass=0.0)  # fmt: skip


def _add_shape(mujoco: Any, body: Any, item: pin.GeometryObject) -> None:
    """Add a primitive visual shape. Other shapes are left out."""
    shape, kinds = item.geometry, mujoco.mjtGeom
    read: dict[str, tuple[Any, Callable[[], list[float]]]] = {
        "Box": (kinds.mjGEOM_BOX, lambda: list(shape.halfSide)),
        "Sphere": (kinds.mjGEOM_SPHERE, lambda: [shape.radius]),
        "Cylinder": (kinds.mjGEOM_CYLINDER, lambda: [shape.radius, shape.halfLength]),
        "Capsule": (kinds.mjGEOM_CAPSULE, lambda: [shape.radius, shape.halfLength]),
        "Ellipsoid": (kinds.mjGEOM_ELLIPSOID, lambda: list(shape.radii)),
    }
    if found := read.get(type(shape).__name__):
        _add_geom(body, found[0], found[1](), item.placement, tuple(float(c) for c in item.meshColor))


def quaternion(R: Array) -> Array:
    """Quaternion (w, x, y, z) of a rotation matrix, in MuJoCo's order."""
    x, y, z, w = pin.Quaternion(np.ascontiguousarray(R)).normalized().coeffs()
    return np.array([w, x, y, z])


def placement(position: Array, matrix: Array) -> pin.SE3:
    """SE3 from MuJoCo's position (3,) and flat rotation matrix (9,)."""
    return pin.SE3(np.array(matrix, dtype=float).reshape(3, 3), np.array(position, dtype=float))
