"""Shapes as coal knows them, convex all of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import coal
import numpy as np

from coopqp.errors import InvalidInputError
from coopqp.model.meshes import MOST_BYTES, load_mesh
from coopqp.model.shapes import MOST_TRIANGLES, Box, Capsule, Cylinder, Hull, Mesh, Shape, Sphere
from coopqp.reading import open_file

#: A hull with more than this many times its mesh's volume is named.
LARGE_HULL = 1.5
#: Corners whose spread across a plane is less than this share of that along it lie in the plane.
_FLAT = 1e-6


def geometry_of(shape: Shape, where: str) -> Any:
    """A coal geometry, convex unless the shape is a mesh.

    Raises:
        InvalidInputError: a mesh that cannot be read, is empty or too large.
    """
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length)
    if isinstance(shape, Capsule):
        return coal.Capsule(shape.radius, shape.length)
    if isinstance(shape, Hull):
        return hull_of(shape.points, where)
    return _of_mesh(shape, where)


def _of_mesh(mesh: Mesh, where: str) -> Any:
    file = Path(mesh.file)
    try:
        with open_file(file, MOST_BYTES) as stream:
            triangles = _stl_triangles(stream, file.suffix)
    except OSError as error:
        why = f"cannot read {error.filename}: {error.strerror}"
        raise InvalidInputError(why, where, "Give a mesh of fewer bytes.") from error
    if triangles > MOST_TRIANGLES:  # before it takes a minute to read it
        raise InvalidInputError(f"{file} has {triangles} triangles", where, f"Reduce it to {MOST_TRIANGLES} or fewer.")
    try:
        return load_mesh(file, np.array(mesh.scale))
    except (OSError, ValueError, RuntimeError) as error:
        why = str(error).partition("message: ")[2].partition("\nHint")[0]  # without coal's own source lines
        said = " ".join((why or str(error)).split())
        raise InvalidInputError(f"{file} is no readable mesh ({said})", where, "Give an STL, DAE or OBJ.") from error


def _stl_triangles(stream: IO[bytes], suffix: str) -> int:
    """Number of triangles by the header of a binary STL; 0 for other files."""
    if suffix.lower() != ".stl":
        return 0
    count = int.from_bytes(stream.read(84)[80:], "little")
    return count if stream.seek(0, os.SEEK_END) == 84 + 50 * count else 0


def convex(geometry: Any, where: str) -> tuple[Any, float]:
    """The convex hull of a geometry (itself if it is convex), and how many times its volume the hull has.

    The number is infinite for a mesh that encloses no volume.

    Raises:
        InvalidInputError: an empty or too large mesh, or a geometry without end or volume.
    """
    kind = type(geometry).__name__
    if kind in ("Box", "Sphere", "Cylinder", "Capsule", "Cone", "Ellipsoid"):
        sizes = _sizes(geometry)
        if not (np.isfinite(sizes).all() and (sizes > 0.0).all()):
            raise InvalidInputError(f"a {kind} with sizes {sizes.tolist()}", where, "Give positive sizes in metres.")
        return geometry, 1.0
    if kind == "Convex":
        return geometry, 1.0
    if not kind.startswith("BVHModel"):
        raise InvalidInputError(f"a {kind}", where, "Give a box, sphere, cylinder, capsule or mesh.")
    if geometry.num_vertices < 4 or geometry.num_tris < 1:
        raise InvalidInputError("an empty mesh", where, "Give a mesh of a body, or leave the shape out.")
    if geometry.num_tris > MOST_TRIANGLES or geometry.num_vertices > MOST_TRIANGLES:
        raise InvalidInputError(
            f"a mesh of {geometry.num_tris} triangles", where, f"Reduce it to {MOST_TRIANGLES} or fewer."
        )
    points = np.asarray(geometry.vertices(), dtype=float)
    hull, volume = hull_of(points, where), abs(float(geometry.computeVolume()))  # negative if it is wound inwards
    return hull, float(hull.computeVolume()) / volume if volume > 0.0 else np.inf


def hull_of(points: Any, where: str) -> Any:
    """The convex hull of points (n, 3) as a coal geometry.

    Raises:
        InvalidInputError: points that are not finite, or lie in one plane.
    """
    corners = np.asarray(points, dtype=float)
    if not np.isfinite(corners).all():
        raise InvalidInputError("corners that are not finite", where, "Give finite numbers in metres.")
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if not spread[-1] > _FLAT * spread[0]:  # coal would end the process
        raise InvalidInputError("corners without a hull", where, "Give corners that are not in one plane.")
    try:
        return coal.Convex.convexHull(_vectors(corners), True, "Qt")
    except (ValueError, RuntimeError) as error:
        raise InvalidInputError("corners without a hull", where, "Give corners that are not in one plane.") from error


def reach_of(geometry: Any, R: Any, p: Any) -> float:
    """Largest distance of a point of a convex geometry, placed at (R, p), from the origin [m]."""
    kind = type(geometry).__name__
    if kind == "Convex":
        corners = np.asarray(geometry.points(), dtype=float)
        return float(np.linalg.norm(corners @ np.asarray(R).T + p, axis=1).max())
    if kind == "Box":
        half = np.asarray(geometry.halfSide)
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return float(np.linalg.norm((signs * half) @ np.asarray(R).T + p, axis=1).max())
    if kind == "Sphere":
        return float(np.linalg.norm(p) + geometry.radius)
    if kind in ("Cylinder", "Capsule"):
        axis = np.asarray(R)[:, 2] * geometry.halfLength
        return float(max(np.linalg.norm(p + axis), np.linalg.norm(p - axis)) + geometry.radius)
    geometry.computeLocalAABB()
    return float(np.linalg.norm(np.asarray(R) @ geometry.aabb_center + p) + geometry.aabb_radius)


def _sizes(geometry: Any) -> Any:
    names = {
        "Box": ("halfSide",),
        "Sphere": ("radius",),
        "Ellipsoid": ("radii",),
    }.get(type(geometry).__name__, ("radius", "halfLength"))
    return np.concatenate([np.atleast_1d(np.asarray(getattr(geometry, name), dtype=float)) for name in names])


def _vectors(points: Sequence[Any] | Any) -> Any:
    made = coal.StdVec_Vec3s()
    for point in points:
        made.append(np.asarray(point, dtype=float))
    return made


#: Codes of the core's shapes: a box about a radius, which may have no width; a cylinder; a hull.
_BOX, _CYLINDER, _HULL = 0, 1, 2


class CoreShape(NamedTuple):
    """A convex geometry as ``convex.h`` takes it; it lies inside, and fills it for all kinds but cones and ellipsoids.

    Attributes:
        kind: code of its core.
        half: half sizes of the core (3,) [m]; of a cylinder radius, 0, half of its length.
        radius: by which the core grows [m].
        centre: of the core in the geometry's frame (3,) [m].
        corners: of a hull (C, 3) [m].
    """

    kind: int
    half: Any
    radius: float
    centre: Any
    corners: Any


def core_shape(geometry: Any) -> CoreShape:
    """A convex geometry for the core."""
    kind, middle, none = type(geometry).__name__, np.zeros(3), np.zeros((0, 3))
    if kind == "Box":
        return CoreShape(_BOX, np.array(geometry.halfSide), 0.0, middle, none)
    if kind == "Sphere":
        return CoreShape(_BOX, np.zeros(3), geometry.radius, middle, none)
    if kind == "Capsule":
        return CoreShape(_BOX, np.array([0.0, 0.0, geometry.halfLength]), geometry.radius, middle, none)
    if kind == "Cylinder":
        return CoreShape(_CYLINDER, np.array([geometry.radius, 0.0, geometry.halfLength]), 0.0, middle, none)
    if kind == "Convex":
        return CoreShape(_HULL, np.zeros(3), 0.0, middle, np.array(geometry.points(), dtype=float))
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return CoreShape(_BOX, 0.5 * (np.array(box.max_) - box.min_), 0.0, 0.5 * (np.array(box.max_) + box.min_), none)
