"""The bodies that stand around the arms, and those that the object is made of, in a recording for pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.model.shapes import Box
from coopqp.simulation.recording.scene import (
    MAX_SHAPES,
    SceneError,
    describe_object,
    describe_shape,
    read_geometry,
    reading,
)
from coopqp.spatial import as_placement

#: Colour of bodies in pictures (red, green, blue).
SAND: tuple[float, float, float] = (0.80, 0.68, 0.47)


def describe_bodies(scene: CollisionScene) -> list[dict[str, Any]]:
    """The bodies that stand in the world, as plain JSON for the entry ``bodies`` of a recording's metadata."""
    built, names = scene.built, {body.name for body in scene.obstacles}
    return [
        _described(name, shape.placement, shape.geometry)
        for name, shape in zip(built.names, built.geometry.geometryObjects, strict=True)
        if name in names and not shape.parentJoint and not shape.parentFrame
    ]


def describe_carried(scene: CollisionScene, box: Any) -> list[dict[str, Any]]:
    """The bodies of the object in its frame, for the entry ``carried``; empty if they are the object's box alone.

    Args:
        scene: whose bodies they are.
        box: the entry ``object`` of the metadata.
    """
    names = {body.name for body in scene.carried}
    boxes = [(body.shape.size, body.placement) for body in scene.carried if isinstance(body.shape, Box)]
    if len(scene.carried) == 1 and [describe_object(*one) for one in boxes] == [box]:
        return []
    cell, built = scene.cell, scene.built
    T_object_joint = scene.grasp.T_object_tool[0] * cell.T_joint_tool[0].inverse()
    return [
        _described(name, T_object_joint * shape.placement, shape.geometry)
        for name, shape in zip(built.names, built.geometry.geometryObjects, strict=True)
        if name in names and shape.parentFrame == cell.tool_frames[0]
    ]


def _described(name: str, T: pin.SE3, geometry: Any) -> dict[str, Any]:
    drawn = pin.GeometryObject(name, 0, T, geometry)
    drawn.meshColor = np.array([*SAND, 1.0])
    return describe_shape(drawn)


def read_bodies(metadata: Mapping[str, Any], key: str = "bodies") -> list[tuple[str, Any, pin.SE3]]:
    """Names, coal geometries and placements of the bodies of a recording.

    Args:
        metadata: of the recording.
        key: ``"bodies"`` for those in the world, ``"carried"`` for those of the object, placed in its frame.

    Raises:
        SceneError: the entry is damaged.
    """
    entries = metadata.get(key) or []
    found = []
    with reading(f"{key} are"):
        if len(entries) > MAX_SHAPES:
            raise SceneError(f"the recording has more than {MAX_SHAPES} bodies.")
        for entry in entries:
            if entry["kind"] == "mesh":  # none is written
                continue
            geometry = read_geometry(entry, "the surroundings")
            if geometry is not None:
                found.append((str(entry["name"]), geometry, as_placement(entry["placement"], "body")))
    return found
