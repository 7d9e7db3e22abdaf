"""The convex geometries of the bodies of a scene: hulls of meshes, or convex parts by CoACD (extra ``decompose``).

CoACD: Wei et al., SIGGRAPH 2022. A decomposition takes seconds; it is kept in the user's cache folder, named by a hash
of the mesh and of the settings.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from coopqp.collision.coal_geometry import LARGE_HULL, convex, geometry_of, hull_of
from coopqp.collision.pairs import Names
from coopqp.errors import InvalidInputError, MissingExtraError
from coopqp.model.cell import RobotCell
from coopqp.model.shapes import Body
from coopqp.spatial import Array

#: Convex parts that leave out more of their mesh than this are named [m].
_UNCOVERED = 1e-4
#: Concavity that is left, as a share of the mesh's size: CoACD's own default.
CONCAVITY = 0.05
#: Places on a triangle where its distance from the parts is measured, in barycentric coordinates.
_PLACES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1 / 3, 1 / 3, 1 / 3], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]
)
_SEED = 0
_EXTRA, _PACKAGE = "decompose", "coacd"


@final
class ConvexShapes:
    """Convex geometries for the bodies of a scene.

    Args:
        cell: the arms with their links' shapes.
        standing: other bodies that do not move by themselves.
        moving: those that do.
        decompose: names of the bodies that count as their convex parts.

    Attributes:
        notes: remarks by the name of the body.

    Raises:
        MissingExtraError: ``decompose`` without its extra.
        InvalidInputError, UnknownNameError: ``decompose`` names a moving body, which has one shape, or no body.
    """

    def __init__(
        self, cell: RobotCell, standing: Sequence[Body], moving: Sequence[Body], decompose: Sequence[str]
    ) -> None:
        self.notes: dict[str, str] = {}
        self._factors: dict[str, float] = {}
        self._decomposed: set[str] = set()
        if decompose:
            require_decomposer()
            moved = [body.name for body in moving if body.name in decompose]
            if moved:
                raise InvalidInputError(
                    f"{moved[0]} moves", "CollisionScene: decompose", "Give the parts of a moving body one by one."
                )
            links = [cell.model.frames[shape.parentFrame].name for shape in cell.collision_model().geometryObjects]
            known = Names([*links, *(body.name for body in (*standing, *moving))], cell.arm_names)
            for pattern in decompose:
                self._decomposed |= known.matching(pattern, "CollisionScene: decompose")

    def of_body(self, body: Body) -> Sequence[Any]:
        """The geometries of a body. Raises as :func:`coopqp.collision.coal_geometry.convex`."""
        where = f"Body '{body.name}'"
        return self.of(body.name, geometry_of(body.shape, where), where)

    def of(self, name: str, geometry: Any, where: str) -> Sequence[Any]:
        """The hull of a geometry, or its convex parts where the scene decomposes the body of this name."""
        hull, factor = convex(geometry, where)
        if factor <= 1.0 or not type(geometry).__name__.startswith("BVHModel"):
            return (hull,)
        if name in self._decomposed:
            triangles = [geometry.tri_indices(i) for i in range(geometry.num_tris)]
            parts = convex_parts(geometry.vertices(), np.array([[t[0], t[1], t[2]] for t in triangles]), where)
            if parts.uncovered > _UNCOVERED:
                missing = f"{1e3 * parts.uncovered:.2g} mm"
                self.notes[name] = f"the {len(parts.geometries)} convex parts of {name} miss its mesh by {missing}"
            return parts.geometries
        if factor > max(LARGE_HULL, self._factors.get(name, 0.0)):
            self._factors[name] = factor
            times = f"with {factor:.1f} times the volume" if np.isfinite(factor) else "and the mesh encloses no volume"
            self.notes[name] = f"{name} counts as the convex hull of its mesh, {times} (decompose takes its parts)"
        return (hull,)


@dataclass(frozen=True, eq=False)
class ConvexParts:
    """A mesh as a union of convex parts.

    Attributes:
        geometries: the parts, as coal knows them.
        uncovered: largest distance of the mesh from its parts, at seven places on each triangle [m].
    """

    geometries: tuple[Any, ...]
    uncovered: float


def convex_parts(vertices: Array, triangles: Array, where: str) -> ConvexParts:
    """Convex parts whose union is a mesh, up to :data:`CONCAVITY`.

    Args:
        vertices: corners (V, 3) [m].
        triangles: indices of each triangle's corners (T, 3).
        where: what messages call the mesh.

    Raises:
        MissingExtraError: the extra ``decompose`` is not installed.
        InvalidInputError: the mesh cannot be decomposed.
    """
    corners = np.ascontiguousarray(vertices, dtype="<f8").reshape(-1, 3)
    faces = np.ascontiguousarray(triangles, dtype="<i4").reshape(-1, 3)
    file = cache_folder() / f"{_key(corners, faces)}.npz"
    points = _read(file)
    if points is None:
        points = _decomposed(corners, faces, where)
        _keep(file, points)
    hulls = tuple(hull_of(part, where) for part in points)
    return ConvexParts(hulls, _uncovered(points, corners[faces]))


def require_decomposer() -> None:
    """Check that the packages are there.

    Raises:
        MissingExtraError: the extra ``decompose`` is not installed.
    """
    _coacd()
    cache_folder()


def cache_folder() -> Path:
    """Where decompositions are kept: ``coopqp/convex`` below the user's folder for caches.

    Raises:
        MissingExtraError: the extra ``decompose`` is not installed.
    """
    try:
        import platformdirs
    except ImportError as error:
        raise MissingExtraError(_EXTRA, "platformdirs") from error
    return Path(platformdirs.user_cache_dir("coopqp", appauthor=False)) / "convex"


def _key(corners: Array, faces: Array) -> str:
    text = f"coacd {CONCAVITY} {_SEED} {corners.shape} {faces.shape}"
    return hashlib.sha256(text.encode() + corners.tobytes() + faces.tobytes()).hexdigest()


def _coacd() -> Any:
    try:
        import coacd
    except ImportError as error:
        raise MissingExtraError(_EXTRA, _PACKAGE) from error
    return coacd


def _decomposed(corners: Array, faces: Array, where: str) -> list[Array]:
    """Corners of each part (n, 3) [m]."""
    coacd = _coacd()
    coacd.set_log_level("error")
    used, renumbered = np.unique(faces, return_inverse=True)
    merged, same = np.unique(corners[used], axis=0, return_inverse=True)  # an STL repeats each corner
    mesh = coacd.Mesh(merged, same.reshape(-1)[renumbered].reshape(-1, 3))
    try:
        parts = coacd.run_coacd(mesh, threshold=CONCAVITY, seed=_SEED)
    except RuntimeError as error:
        raise InvalidInputError(f"the mesh cannot be decomposed ({error})", where, "Mend it, or leave it.") from error
    if not parts:
        raise InvalidInputError("the mesh has no convex parts", where, "Close it, or leave it out of decompose.")
    return [np.asarray(points, dtype=float) for points, _ in parts]


def _read(file: Path) -> list[Array] | None:
    """The parts that a file keeps; None if it is missing or damaged."""
    try:
        with np.load(file, allow_pickle=False) as kept:
            parts = [kept[name] for name in kept.files]
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
    whole = parts and all(p.ndim == 2 and p.shape[1] == 3 and len(p) > 3 and np.isfinite(p).all() for p in parts)
    return parts if whole else None


def _keep(file: Path, parts: list[Array]) -> None:
    """Write at once or not at all; a cache that cannot be written is no error."""
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=".npz")
        with os.fdopen(handle, "wb") as opened:
            np.savez(opened, *parts)
        Path(name).replace(file)


def _uncovered(parts: list[Array], triangles: Array) -> float:
    """Largest distance by which a place on the triangles (T, 3, 3) lies outside all parts [m].

    It is at least the distance from the nearest face's plane, so 0 is exact.
    """
    from scipy.spatial import ConvexHull

    places = np.einsum("pk,tkc->tpc", _PLACES, triangles).reshape(-1, 3)
    outside = np.full(len(places), np.inf)
    for part in parts:
        planes = ConvexHull(part).equations
        outside = np.minimum(outside, (places @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return max(float(outside.max()), 0.0)
