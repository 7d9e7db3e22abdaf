"""Distances of convex bodies by another way than coal's, with a proof of each figure.

A body is a core and a radius about it: a sphere is a point, a capsule a segment. The distance of two cores is the least
norm over their difference A − B, whose furthest point in a direction is known. The method of P. Wolfe, "Finding the
nearest point in a polytope", Mathematical Programming 11 (1976): the least-norm point x of the hull of the corners
found so far is in A − B; the furthest point against x is the next corner. ``‖x‖`` bounds the distance from above, that
point's component along x from below. (SciPy's ``nnls`` would do for the hull, but that of 1.15, the last for Python
3.10, is wrong: its issue 25389.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coopqp.spatial import Array

#: Upper and lower bound of a distance differ by less [m].
GAP = 1e-10
#: Largest number of corners of one search.
_MOST_CORNERS = 200
#: Cores whose difference comes this close to 0 overlap [m].
_OVERLAP = 1e-9
#: Of no more points than this the furthest is found one by one: an array takes longer.
_FEW = 8
#: The plane of a disc about the z axis.
_PLANE = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
#: Squared sine of an angle below which three edges are solved with the SVD.
_FLAT = 1e-8
_TINY = float(np.finfo(float).tiny)

Point = list[float]  # three coordinates [m]


class Core(NamedTuple):
    """A convex body in its own frame: points, each with a disc about the z axis, and a ball about all of it.

    Attributes:
        points: (n, 3) [m].
        disc: radius of the disc [m].
        radius: radius of the ball [m].
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


def furthest(points: Array | list[Point], disc: float, plane: Sequence[Point], way: Point) -> Point:
    """The furthest point in a direction of points (n, 3), each with a disc in a plane of two axes; all in one frame."""
    if isinstance(points, list):
        best, point = -math.inf, points[0]
        for one in points:
            along = _dot(one, way)
            if along > best:
                best, point = along, one
    else:
        point = points[(points @ way).argmax()].tolist()
    if disc > 0.0:
        x, y = _dot(plane[0], way), _dot(plane[1], way)
        across = math.hypot(x, y)
        if across > 0.0:
            point = _less(_less(point, plane[0], -x * disc / across), plane[1], -y * disc / across)
    return point


def distance(a: Core, b: Core, Ra: Array, pa: Array, Rb: Array, pb: Array) -> float:
    """Distance of two bodies [m], to within ``GAP``; where their cores overlap, the negative sum of their radii.

    The lower bound is returned: bodies are never closer.
    """
    return separate(a, b, Ra, pa, Rb, pb, math.inf)[0]


def separate(
    a: Core, b: Core, Ra: Array, pa: Array, Rb: Array, pb: Array, enough: float, way: Point | None = None
) -> tuple[float, Point]:
    """A lower bound of a distance, which :func:`distance` returns unless the bound is ``enough`` before [m].

    Args:
        a, b: the bodies.
        Ra, pa, Rb, pb: their orientations (3, 3) and origins (3,) [m].
        enough: a bound that ends the search [m].
        way: direction from b to a, in the frame of a, to begin with; between the origins by default.

    Returns:
        the bound, and the direction that it is along, for a search close by.
    """
    R, p = Ra.T @ Rb, Ra.T @ (pb - pa)  # b as a has it; all points are in the frame of a
    at_b, plane_b = b.points @ R.T + p, R.T.tolist()
    points_a: Array | list[Point] = a.points if len(a.points) > _FEW else a.points.tolist()
    points_b: Array | list[Point] = at_b if len(at_b) > _FEW else at_b.tolist()

    def corner(way: Point) -> Point:
        """The point of A − B furthest against a direction."""
        back = [-way[0], -way[1], -way[2]]
        return _less(furthest(points_a, a.disc, _PLANE, back), furthest(points_b, b.disc, plane_b, way))

    radii = a.radius + b.radius
    x: Point = (-p).tolist() if way is None else way
    first = corner(x)
    corners, shares = [first], [1.0]
    lower = max(0.0, _dot(first, x) / max(math.sqrt(_dot(x, x)), _TINY))
    for _ in range(_MOST_CORNERS):
        if lower - radii >= enough:
            break
        x = [0.0, 0.0, 0.0]
        for share, known in zip(shares, corners, strict=True):
            x = _less(x, known, -share)
        size = math.sqrt(_dot(x, x))
        if size < _OVERLAP:
            return -radii, first
        new = corner(x)
        lower = max(lower, _dot(new, x) / size)
        if size - lower <= GAP:
            break
        corners, shares = least_norm([*corners, new], [*shares, 0.0])
    return lower - radii, x


def least_norm(corners: list[Point], shares: list[float]) -> tuple[list[Point], list[float]]:
    """The point of least norm in the hull of corners: the corners it lies between, and their shares.

    Args:
        corners: corners that are affinely independent, except perhaps the last.
        shares: shares of the corners in a first point of the hull.
    """
    while True:
        # The point of least norm in the plane of the corners, then as far towards it as the hull reaches.
        rest = _least_square([_less(corner, corners[0]) for corner in corners[1:]], corners[0])
        there = [1.0 - sum(rest), *rest]
        if min(there) > 0.0:
            return corners, there
        way, first = min(
            (s / max(s - t, _TINY), k) for k, (s, t) in enumerate(zip(shares, there, strict=True)) if t <= 0.0
        )
        shares = [s + min(1.0, way) * (t - s) for s, t in zip(shares, there, strict=True)]
        shares[first] = 0.0
        kept = [k for k, share in enumerate(shares) if share > 0.0]
        whole = sum(shares[k] for k in kept)
        corners, shares = [corners[k] for k in kept], [shares[k] / whole for k in kept]


def _least_square(edges: list[Point], corner: Point) -> list[float]:
    """The shares of up to three edges that lead from a corner closest to 0.

    By hand, each edge less what the ones before it reach: arrays of three numbers take longer than their sums.
    """
    if not edges:
        return []
    a = edges[0]
    aa = max(_dot(a, a), _TINY)
    of_a = -_dot(corner, a) / aa
    if len(edges) == 1:
        return [of_a]
    b = edges[1]
    ab = _dot(a, b) / aa
    c = _less(b, a, ab)  # across a
    cc = _dot(c, c)
    if len(edges) == 2 and cc > 1e-12 * _dot(b, b):
        of_b = -_dot(corner, c) / cc
        return [of_a - ab * of_b, of_b]
    if len(edges) == 3 and cc > _FLAT * _dot(b, b):
        e = edges[2]
        ae, ce = _dot(a, e) / aa, _dot(c, e) / cc
        d = _less(_less(e, a, ae), c, ce)  # across a and b
        dd = _dot(d, d)
        if dd > _FLAT * _dot(e, e):
            of_e = -_dot(corner, d) / dd
            of_b = -_dot(corner, c) / cc - ce * of_e
            return [of_a - ab * of_b - ae * of_e, of_b, of_e]
    found: list[float] = np.linalg.lstsq(np.array(edges).T, -np.array(corner), rcond=None)[0].tolist()
    return found


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _less(a: Point, b: Point, times: float = 1.0) -> Point:
    return [a[0] - times * b[0], a[1] - times * b[1], a[2] - times * b[2]]
