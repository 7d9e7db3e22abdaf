"""Distances of convex bodies for the judges of a run: another way than the controllers', with a proof of each figure.

A body is a core and a radius about it: a sphere is a point, a capsule a segment. The distance of two cores is the least
norm over their difference A − B, whose furthest point in a direction is known. The method of P. Wolfe, "Finding the
nearest point in a polytope", Mathematical Programming 11 (1976): the least-norm point x of the hull of the corners
found so far is in A − B; the furthest point against x is the next corner. ``‖x‖`` bounds the distance from above, that
point's component along x from below. (SciPy's ``nnls`` would do for the hull, but that of 1.15, the last for Python
3.10, is wrong: its issue 25389.)
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from coopqp.spatial import Array

#: Upper and lower bound of a distance differ by less [m].
GAP = 1e-10
#: Corners of one search at most.
_MOST_CORNERS = 200
#: Cores whose difference comes this close to 0 overlap [m].
_OVERLAP = 1e-9


class Core(NamedTuple):
    """A convex body in its own frame: points, each with a disc about the z axis, and a ball about all of it.

    Attributes:
        points: (n, 3) [m].
        disc: radius of the disc [m].
        radius: of the ball [m].
        extent: largest distance of a point of the body from its origin [m].
    """

    points: Array
    disc: float
    radius: float
    extent: float


def core_of(geometry: Any) -> Core:
    """The core of a convex coal geometry, from its numbers alone.

    Raises:
        TypeError: a kind that has no core here.
    """
    kind = type(geometry).__name__
    if kind == "Sphere":
        points, disc, radius = np.zeros((1, 3)), 0.0, float(geometry.radius)
    elif kind in ("Capsule", "Cylinder"):
        half, r = float(geometry.halfLength), float(geometry.radius)
        points = np.array([[0.0, 0.0, half], [0.0, 0.0, -half]])
        disc, radius = (r, 0.0) if kind == "Cylinder" else (0.0, r)
    elif kind == "Box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        points, disc, radius = signs * np.asarray(geometry.halfSide), 0.0, 0.0
    elif kind == "Convex":
        points, disc, radius = np.array(geometry.points(), dtype=float), 0.0, 0.0
    else:
        raise TypeError(f"a {kind} has no core")
    extent = float(np.hypot(np.linalg.norm(points[:, :2], axis=1) + disc, points[:, 2]).max()) + radius
    return Core(points, disc, radius, extent)


def furthest(core: Core, R: Array, p: Array, way: Array) -> Array:
    """The core's furthest point in a world direction, placed at (R, p)."""
    own = way @ R
    point = core.points[int((core.points @ own).argmax())]
    if core.disc > 0.0:
        across = float(np.hypot(own[0], own[1]))
        if across > 0.0:
            point = point + np.array([own[0], own[1], 0.0]) * (core.disc / across)
    out: Array = R @ point + p
    return out


def distance(a: Core, b: Core, Ra: Array, pa: Array, Rb: Array, pb: Array, *, gap: float = GAP) -> float:
    """Distance of two bodies [m], to within ``gap``; where their cores overlap, the negative sum of their radii.

    The lower bound is returned: bodies are never closer.
    """
    way = pb - pa
    corners = (furthest(a, Ra, pa, way) - furthest(b, Rb, pb, -way))[None]
    shares, lower = np.ones(1), 0.0
    for _ in range(_MOST_CORNERS):
        x = shares @ corners
        size = math.sqrt(float(x @ x))
        if size < _OVERLAP:
            return -(a.radius + b.radius)
        corner = furthest(a, Ra, pa, -x) - furthest(b, Rb, pb, x)
        lower = max(lower, float(corner @ x) / size)
        if size - lower <= gap:
            break
        corners, shares = least_norm(np.vstack([corners, corner]), np.append(shares, 0.0))
    return lower - a.radius - b.radius


def least_norm(corners: Array, shares: Array) -> tuple[Array, Array]:
    """The point of least norm in the hull of corners (n, 3): the corners it lies between, and their shares.

    Args:
        corners: affinely independent but for the last.
        shares: of a point of the hull, to begin with (n,).
    """
    while True:
        # The point of least norm in the plane of the corners, then as far towards it as the hull reaches.
        rest = _least_square((corners[1:] - corners[0]).T, -corners[0])
        there = np.concatenate([[1.0 - rest.sum()], rest])
        if (there > 0.0).all():
            return corners, there
        falls = there <= 0.0
        ways = shares[falls] / np.maximum(shares[falls] - there[falls], np.finfo(float).tiny)
        shares = shares + min(1.0, float(ways.min())) * (there - shares)
        shares[np.flatnonzero(falls)[int(ways.argmin())]] = 0.0
        kept = shares > 0.0
        corners, shares = corners[kept], shares[kept] / shares[kept].sum()


def _least_square(edges: Array, goal: Array) -> Array:
    """The shares with which edges (3, n) come closest to a goal (3,). One and two by hand: most are."""
    if edges.shape[1] == 1:
        a = edges[:, 0]
        return np.array([(goal @ a) / max(float(a @ a), np.finfo(float).tiny)])
    if edges.shape[1] == 2:
        a, b = edges.T
        along = (a @ b) / max(float(a @ a), np.finfo(float).tiny)
        c = b - along * a  # across a
        if c @ c > 1e-12 * (b @ b):
            of_b = (goal @ c) / (c @ c)
            return np.array([(goal @ a) / (a @ a) - along * of_b, of_b])
    return np.asarray(np.linalg.lstsq(edges, goal, rcond=None)[0], dtype=float)
