"""The bodies that stand around the arms, in a recording as plain JSON, for pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.simulation.scene import MAX_SHAPES, SceneError, describe_shape, read_geometry, reading
from coopqp.spatial import as_placement

#: Colour of bodies in pictures (red, green, blue).
SAND: tuple[float, float, float] = (0.80, 0.68, 0.47)


def describe_bodies(scene: CollisionScene) -> list[dict[str, Any]]:
    """The bodies that stand in the world, as plain JSON for the entry ``bodies`` of a recording's metadata."""
    built, names = scene.built, {body.name for body in scene.obstacles}
    found = []
    for name, shape in zip(built.names, built.geometry.geometryObjects, strict=True):
        if name in names and not shape.parentJoint and not shape.parentFrame:
            drawn = pin.GeometryObject(name, 0, shape.placement, shape.geometry)
            drawn.meshColor = np.array([*SAND, 1.0])
            found.append(describe_shape(drawn))
    return found


def read_bodies(metadata: Mapping[str, Any]) -> list[tuple[str, Any, pin.SE3]]:
    """Names, coal geometries and placements in the world of the bodies of a recording.

    Raises:
        SceneError: the entry is damaged.
    """
    entries = metadata.get("bodies") or []
    found = []
    with reading("bodies are"):
        if len(entries) > MAX_SHAPES:
            raise SceneError(f"the recording has more than {MAX_SHAPES} bodies.")
        for entry in entries:
            if entry["kind"] == "mesh":  # none is written
                continue
            geometry = read_geometry(entry, "the surroundings")
            if geometry is not None:
                found.append((str(entry["name"]), geometry, as_placement(entry["placement"], "body")))
    return found
