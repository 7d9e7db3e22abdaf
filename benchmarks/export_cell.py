"""Export of a cell as one URDF and one MJCF, with all arms under a common world link, from its Pinocchio model.

Joints have the names ``a00_j0``, ``a00_j1`` … in the order of the cell's velocity coordinates, tools ``a00_tool`` …:
parsers that sort by name keep the order. Every link has the same token mass. Without a collision scene there is no
geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from coopqp import CollisionScene, RobotCell
from coopqp.spatial import Array

_TOKEN_INERTIA = {"ixx": "0.01", "iyy": "0.01", "izz": "0.01", "ixy": "0", "ixz": "0", "iyz": "0"}


@dataclass(frozen=True)
class _Joint:
    name: str
    parent: int  #: index of the parent joint, -1 for the world
    placement: pin.SE3  #: placement in the parent joint's frame
    axis: Array
    prismatic: bool
    lower: float
    upper: float
    speed: float


def names(cell: RobotCell) -> tuple[list[str], list[str]]:
    """Names of the joints (one per velocity coordinate) and of the tools in the exported files."""
    joints = [f"a{k:02d}_j{i}" for k, s in enumerate(cell.v_slices) for i in range(s.stop - s.start)]
    return joints, [f"a{k:02d}_tool" for k in range(len(cell))]


def tools_at(cell: RobotCell, q: Array) -> list[pin.SE3]:
    """Placement of each tool in the world, from the arms' own models, which need little memory."""
    placements = []
    for arm, span in zip(cell.arms, cell.q_slices, strict=True):
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, q[span])
        placements.append(arm.T_world_base * data.oMf[arm.model.getFrameId(arm.tool_frame)])
    return placements


def _joints(cell: RobotCell) -> list[_Joint]:
    if cell.continuous.any():
        raise ValueError("continuous joints are not exported")
    model, limits = cell.model, cell.limits
    # The small model of an arm gives the axes; the data of the cell would be large.
    axes: list[Array] = []
    for arm in cell.arms:
        data = arm.model.createData()
        pin.computeJointJacobians(arm.model, data, pin.neutral(arm.model))
        own = [pin.getJointJacobian(arm.model, data, i, pin.LOCAL) for i in range(1, arm.model.njoints)]
        axes += [J[:, i] for i, J in enumerate(own)]
    found = []
    for j, (name, S) in enumerate(zip(names(cell)[0], axes, strict=True)):
        prismatic = not S[3:].any()
        found.append(
            _Joint(
                name=name,
                parent=int(model.parents[j + 1]) - 1,
                placement=model.jointPlacements[j + 1].copy(),
                axis=S[:3] if prismatic else S[3:],
                prismatic=prismatic,
                lower=float(limits.lower[j]),
                upper=float(limits.upper[j]),
                speed=float(limits.velocity[j]),
            )
        )
    return found


def _numbers(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(x)) for x in values)


def urdf(cell: RobotCell) -> str:
    """One robot with all arms under the link ``world``."""
    root = Element("robot", name="cell")
    SubElement(root, "link", name="world")

    def link(name: str) -> None:
        inertial = SubElement(SubElement(root, "link", name=name), "inertial")
        SubElement(inertial, "mass", value="1")
        SubElement(inertial, "inertia", _TOKEN_INERTIA)

    def joint(name: str, kind: str, parent: str, child: str, T: pin.SE3) -> Element:
        element = SubElement(root, "joint", name=name, type=kind)
        SubElement(element, "parent", link=parent)
        SubElement(element, "child", link=child)
        rpy = pin.rpy.matrixToRpy(T.rotation)
        SubElement(element, "origin", xyz=_numbers(T.translation), rpy=_numbers(rpy))
        return element

    joints = _joints(cell)
    for j in joints:
        parent = "world" if j.parent < 0 else f"{joints[j.parent].name}_link"
        link(f"{j.name}_link")
        element = joint(j.name, "prismatic" if j.prismatic else "revolute", parent, f"{j.name}_link", j.placement)
        SubElement(element, "axis", xyz=_numbers(j.axis))
        bounds = {"lower": repr(j.lower), "upper": repr(j.upper), "velocity": repr(j.speed), "effort": "1000"}
        SubElement(element, "limit", bounds)
    for tool, carrier, T in zip(names(cell)[1], cell.tool_joints, cell.T_joint_tool, strict=True):
        link(tool)
        joint(f"{tool}_fixed", "fixed", f"{joints[carrier - 1].name}_link", tool, T)
    indent(root)
    return tostring(root, encoding="unicode")


def shapes(scene: CollisionScene) -> list[dict[str, Any]]:
    """Each primitive of a scene: its joint (0: the world), its placement there, its kind and its half sizes [m].

    Raises:
        ValueError: a shape that is no primitive.
    """
    sizes: dict[str, Callable[[Any], list[float]]] = {
        "Box": lambda g: np.asarray(g.halfSide).tolist(),
        "Sphere": lambda g: [g.radius],
        "Capsule": lambda g: [g.radius, g.halfLength],
        "Cylinder": lambda g: [g.radius, g.halfLength],
    }
    found = []
    for shape in scene.built.geometry.geometryObjects:
        kind = type(shape.geometry).__name__
        if kind not in sizes:
            raise ValueError(f"a {kind} is not exported")
        found.append({
            "joint": int(shape.parentJoint), "placement": shape.placement.homogeneous.tolist(),
            "kind": kind.lower(), "half": sizes[kind](shape.geometry),
        })  # fmt: skip
    return found


def mjcf(cell: RobotCell, scene: CollisionScene | None = None) -> str:
    """One robot with all arms for MuJoCo; tools are sites, shapes are geoms ``shape_0`` …"""
    root = Element("mujoco", model="cell")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    world = SubElement(SubElement(root, "worldbody"), "body", name="world_link")  # some parsers need one root body
    joints = _joints(cell)
    bodies: list[Element] = []

    def place(T: pin.SE3) -> dict[str, str]:
        x, y, z, w = pin.Quaternion(T.rotation).coeffs()
        return {"pos": _numbers(T.translation), "quat": _numbers([w, x, y, z])}

    for j in joints:
        parent = world if j.parent < 0 else bodies[j.parent]
        body = SubElement(parent, "body", {"name": f"{j.name}_link", **place(j.placement)})
        SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="0.01 0.01 0.01")
        limits = {"range": _numbers([j.lower, j.upper])} if np.isfinite([j.lower, j.upper]).all() else {}
        kind = "slide" if j.prismatic else "hinge"
        SubElement(body, "joint", {"name": j.name, "type": kind, "axis": _numbers(j.axis), **limits})
        bodies.append(body)
    for tool, carrier, T in zip(names(cell)[1], cell.tool_joints, cell.T_joint_tool, strict=True):
        SubElement(bodies[carrier - 1], "site", {"name": tool, **place(T)})
    for i, shape in enumerate(() if scene is None else shapes(scene)):
        body = bodies[shape["joint"] - 1] if shape["joint"] else world
        given = {"name": f"shape_{i}", "type": shape["kind"], "size": _numbers(shape["half"])}
        SubElement(body, "geom", {**given, **place(pin.SE3(np.array(shape["placement"])))})
    indent(root)
    return tostring(root, encoding="unicode")
