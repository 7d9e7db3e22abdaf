"""The convex geometries of the bodies of a scene, and remarks on meshes that are not convex."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from coopqp.collision.coal_geometry import LARGE_HULL, convex, geometry_of
from coopqp.collision.decomposition import convex_parts, require_decomposer
from coopqp.collision.pairs import Names
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.shapes import Body

#: Convex parts that leave out more of their mesh than this are named [m].
_UNCOVERED = 1e-4


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
