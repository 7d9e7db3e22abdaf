"""Signed distances of the pairs of a scene, their normals, and bounds of how fast they change."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: coal's own tolerance leaves gradients wrong by 0.2; with this one by 2e-4.
_TOLERANCE = 1e-9
_MOST_ITERATIONS = 1000
#: Where bodies overlap coal's search of the depth may fail, and answers the smallest number that there is [m].
_DEEPEST = -1.0

#: Pairs that are asked at most to sharpen bounds, and a room that counts as none [m].
_MOST_ASKED, _LEAST_ROOM = 20, 1e-9

Indices = npt.NDArray[np.intp]


class Gradient(NamedTuple):
    """Of the distances of m pairs.

    Attributes:
        rows: derivative with respect to joint positions (m, nv).
        normals: unit vectors from the first body to the second (m, 3).
        points: a point of each second body that is nearest to the first (m, 3) [m].
    """

    rows: Array
    normals: Array
    points: Array


@final
class Distances:
    """Distances at one configuration after the other; owns what coal writes.

    Args:
        scene: whose pairs they are.
    """

    def __init__(self, scene: CollisionScene) -> None:
        built, self._cell = scene.built, scene.cell
        self._geometry = built.geometry.copy()
        self._data, self._placed = scene.cell.model.createData(), self._geometry.createData()
        for request in self._placed.distanceRequests:
            request.enable_signed_distance = True
            request.gjk_tolerance = request.epa_tolerance = _TOLERANCE
            request.gjk_max_iterations = request.epa_max_iterations = _MOST_ITERATIONS
        self._results = [self._placed.distanceResults[k] for k in range(len(built.labels))]
        self._kinds = built.kinds

    def put(self, shape: int, T_world_shape: pin.SE3) -> None:
        """Move a shape that stands in the world, from the next :meth:`place` on."""
        self._geometry.geometryObjects[shape].placement = T_world_shape

    def place(self, q: Array) -> None:
        """Put all shapes where they are at a configuration (nq,)."""
        pin.computeJointJacobians(self._cell.model, self._data, q)
        pin.updateGeometryPlacements(self._cell.model, self._data, self._geometry, self._placed)

    def one(self, pair: int) -> float:
        """Distance of a pair where the shapes are placed [m]."""
        pin.computeDistance(self._geometry, self._placed, pair)
        return max(float(self._results[pair].min_distance), _DEEPEST)

    def all(self, q: Array) -> Array:
        """Distances of all pairs (P,) at a configuration [m]."""
        self.place(q)
        pin.computeDistances(self._geometry, self._placed)
        return np.maximum([result.min_distance for result in self._results], _DEEPEST)

    def nearest_points(self, pair: int) -> tuple[Array, Array]:
        """The points of both bodies that are nearest to each other, of a pair asked last here [m]."""
        result = self._results[pair]
        return np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def gradient(self, pairs: Indices | list[int]) -> Gradient:
        """Of the distances of pairs that were asked where the shapes are placed.

        With the unit normal n from the first to the second body and a nearest point p the distance grows by
        ``n · (v₂ − v₁)``; a world twist (v, ω) moves p by ``v + ω × p``. Both bodies' nearest points give the same.
        """
        results = [self._results[k] for k in pairs]
        n = np.array([r.normal for r in results]).reshape(-1, 3)
        p = np.array([r.getNearestPoint2() for r in results]).reshape(-1, 3)
        W = np.concatenate([n, np.cross(p, n)], axis=1)
        return Gradient((W @ self._data.J) * self._kinds[pairs], n, p)


@final
class LowerBounds:
    """Lower bounds of all distances, which follow the joints without asking coal.

    A joint that moves by δ changes the distance of a pair by at most its reach times |δ|.

    Args:
        scene: whose pairs they are.
        distances: where they are asked.
    """

    def __init__(self, scene: CollisionScene, distances: Distances) -> None:
        built = scene.built
        self._reach, self._margins, self._distances = built.reach, built.margins, distances
        self._most = built.reach.sum(axis=1)
        self._continuous = scene.cell.continuous
        self.rooms = np.full(len(built.margins), -np.inf)  # at least this far from the margin (P,) [m]
        self.positions = np.zeros(scene.cell.nv)
        self.forget()

    def forget(self) -> None:
        """Nothing is known: a body has moved."""
        self.rooms[:] = -np.inf

    def follow(self, positions: Array) -> None:
        """The joints are at positions (nv,) now."""
        way = np.abs(positions - self.positions)
        if self._continuous.any():
            turn = self._continuous
            way[turn] = np.minimum(way[turn], np.abs(2.0 * np.pi - way[turn]))
        self.rooms -= self._reach @ way
        self.positions = positions

    def ask(self, pairs: Iterable[int]) -> None:
        """Ask coal for pairs, where the shapes are placed."""
        for k in pairs:
            self.rooms[k] = self._distances.one(k) - self._margins[k]

    def sharpen(self) -> None:
        """Ask for pairs until the one that may use up its room first, as far as is known, has been asked."""
        asked = set[int]()
        while len(asked) < _MOST_ASKED:
            k = int((self._most / np.maximum(self.rooms, _LEAST_ROOM)).argmax())
            if k in asked:
                return
            self.ask([k])
            asked.add(k)

    def certificate(self, spare: float = 0.0) -> tuple[Array, float]:
        """Reach (nv,) and slack of a :class:`coopqp.control.constraints.Quiet` about :attr:`positions`.

        A pair with room d and reach ρ keeps its margin where ``Σ ρ |δ| ≤ d``; all do where ``Σ max(ρ / d) |δ| ≤ 1``.

        Args:
            spare: room that is kept for something else [m].
        """
        rooms = self.rooms - spare
        if not len(rooms):
            return np.zeros(self._reach.shape[1]), 1.0
        if not rooms.min() > 0.0:
            return np.zeros(self._reach.shape[1]), -1.0
        return (self._reach / rooms[:, None]).max(axis=0), 1.0
