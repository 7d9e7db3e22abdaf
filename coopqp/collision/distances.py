"""Signed distances of the pairs of a scene, their normals, and bounds of how fast they change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple, final

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.coal_geometry import core_shape
from coopqp.core import _core
from coopqp.core._core import DEEPEST, FARTHEST_POINT, LEAST_CLEARANCE
from coopqp.model.chain import moving_columns
from coopqp.spatial import Array

#: coal's own tolerance leaves gradients wrong by 0.2; with this one by 2e-4.
_TOLERANCE = 1e-9
#: And that of the depth of an overlap [m]. With 1e-9 one in a hundred was not found, or wrong by decimetres.
_DEPTH_TOLERANCE = 1e-6
_MOST_ITERATIONS = 1000

#: Pairs that are asked at most to sharpen bounds.
_MOST_ASKED = 20
#: Placements that differ by less are the same [m].
_SAME_PLACE = 1e-9


def new_request() -> coal.DistanceRequest:
    """What coal is asked for. Unlike Pinocchio's it keeps no guess: an answer does not depend on those before."""
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    request.gjk_tolerance, request.epa_tolerance = _TOLERANCE, _DEPTH_TOLERANCE
    request.gjk_max_iterations = request.epa_max_iterations = _MOST_ITERATIONS
    return request


_REQUEST = new_request()

Indices = npt.NDArray[np.intp]


class Gradient(NamedTuple):
    """Gradient of the distances of m pairs.

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
        built: the scene of the pairs.
    """

    def __init__(self, built: BuiltScene) -> None:
        self._cell = built.cell
        self._geometry = built.geometry.copy()
        self._data, self._placed = built.cell.model.createData(), self._geometry.createData()
        for k in range(len(built.labels)):
            self._placed.distanceRequests[k] = _REQUEST
        self._results = [self._placed.distanceResults[k] for k in range(len(built.labels))]
        self._kinds = np.ascontiguousarray(built.kinds)
        self._nothing = np.zeros(len(built.labels))
        self._at = b""  # the configuration where the shapes are
        self._known: dict[int, float] = {}  # distances there

    def put(self, shape: int, T_world_shape: pin.SE3) -> None:
        """Move a shape that stands in the world, from the next :meth:`place` on."""
        self._geometry.geometryObjects[shape].placement = T_world_shape
        self._at = b""

    def place(self, q: Array) -> None:
        """Put all shapes where they are at a configuration (nq,)."""
        at = q.tobytes()
        if at == self._at:
            return
        self._at, self._known = at, {}
        pin.computeJointJacobians(self._cell.model, self._data, q)
        pin.updateGeometryPlacements(self._cell.model, self._data, self._geometry, self._placed)

    def one(self, pair: int) -> float:
        """Distance of a pair where the shapes are placed [m]; coal is asked once."""
        found = self._known.get(pair)
        if found is None:
            pin.computeDistance(self._geometry, self._placed, pair)
            found = self._known[pair] = max(self._results[pair].min_distance, DEEPEST)
        return found

    def all(self, q: Array) -> Array:
        """Distances of all pairs (P,) at a configuration [m]."""
        self.place(q)
        pin.computeDistances(self._geometry, self._placed)
        d: Array = np.maximum([result.min_distance for result in self._results], DEEPEST)
        self._known = dict(enumerate(d.tolist()))
        return d

    def nearest_points(self, pair: int) -> tuple[Array, Array]:
        """The points of both bodies that are nearest to each other, of a pair asked last here [m]."""
        result = self._results[pair]
        return np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())

    def nearby(self, bounds: LowerBounds, arrays: Mapping[str, Array], settings: tuple[float, ...]) -> Any:
        """The native object that holds these distances in a compiled step, alone.

        Args:
            bounds: the bounds that it keeps up to date.
            arrays, settings: as ``nearby.h`` lists them, without those that are known here.

        Returns:
            None if coal copies normals, or the core cannot place the shapes.
        """
        cell, results = self._cell, self._results
        normals = [result.normal for result in results]
        if any(normal.flags.owndata for normal in [*normals, self._data.J]):
            return None  # the core would read copies, and nobody writes them again
        model, geometry, placed = cell.model, self._geometry, self._placed
        q, continuous = pin.neutral(model), cell.continuous.astype(float)
        coal_asked = {
            "owner": (self._data, placed),
            "placing": [
                partial(pin.computeJointJacobians, model, self._data, q),
                partial(pin.updateGeometryPlacements, model, self._data, geometry, placed),
            ],
            "ask": pin.computeDistance,
            "questions": [(geometry, placed, k) for k in range(len(results))],
            "answers": results,
            "points": [result.getNearestPoint2 for result in results],
            "normals": normals,
            "q": q,
            "q_index": cell.position_index.astype(float),
            "continuous": continuous,
        }
        carries = np.zeros(cell.nv)  # 1 for joints by which an arm evades: those that move its tool
        carries[np.concatenate(moving_columns(cell))] = not cell.groups
        own = {
            **bounds.arrays(),
            "kinds": self._kinds,
            "continuous": continuous,
            # A pair moves with two arms at most, and with what they share: then all joints count as one arm's.
            "arm": np.array([0 if cell.groups else cell.arm_of_joint(j) for j in range(cell.nv)], dtype=float),
            "carries": carries,
            "jacobian": self._data.J.T,
        }
        shapes = core_shapes(model, geometry)
        found = _core.Nearby({**own, **arrays}, settings, coal_asked, shapes)
        return found if self._are_placed_by(found) else None

    def _are_placed_by(self, nearby: Any) -> bool:
        """Whether the core places all shapes as Pinocchio does, at seeded random configurations."""
        rng, found = np.random.default_rng(0), np.empty(12)
        for _ in range(2):
            x = rng.uniform(-2.0, 2.0, self._cell.nv)
            self.place(self._cell.configuration(x))
            for i, T in enumerate(self._placed.oMg):
                nearby.placement(x, i, found)
                centre = core_shape(self._geometry.geometryObjects[i].geometry).centre
                away = np.abs(found - np.concatenate([T.rotation.ravel(), T.act(centre)])).max()
                if not away < _SAME_PLACE * (1.0 + np.abs(T.translation).max()):
                    return False
        return True

    def gradient(self, pairs: Iterable[int]) -> Gradient:
        """Gradient of the distances of pairs that were asked where the shapes are placed.

        With the unit normal n from the first to the second body and a nearest point p the distance grows by
        ``n · (v₂ − v₁)``; a world twist (v, ω) moves p by ``v + ω × p``. Both bodies' nearest points give the same.
        """
        return self.rows([int(k) for k in pairs], self._nothing, 0.0)[0]

    def rows(self, pairs: list[int], clearances: Array, approach: float) -> tuple[Gradient, Array]:
        """Gradient of m pairs, and lower bounds of ḋ: −ξ times the clearance.

        Args:
            pairs: their numbers.
            clearances: of all pairs (P,) [m].
            approach: ξ [1/s].
        """
        ends = []
        for k in pairs:
            result = self._results[k]
            ends.append(result.normal.tolist() + result.getNearestPoint2().tolist())
        both, lower = np.array(ends).reshape(-1, 6), np.empty(len(ends))
        both[~(np.abs(both) < FARTHEST_POINT).all(axis=1)] = 0.0  # of an overlap whose depth coal did not find
        G = np.empty((len(ends), self._cell.nv))
        _core.rows(both, self._data.J.T, self._kinds, clearances, pairs, approach, G, lower)
        return Gradient(G, both[:, :3], both[:, 3:]), lower


@final
class LowerBounds:
    """Lower bounds of all distances, which follow the joints without asking coal.

    A joint that moves by δ changes the distance of a pair by at most its reach times |δ|.

    Args:
        built: the scene of the pairs.
        distances: the distances that are asked.
    """

    def __init__(self, built: BuiltScene, distances: Distances) -> None:
        self._margins, self.distances = built.margins, distances
        self._reach = np.ascontiguousarray(built.reach.T)  # as the core reads it
        self._most = built.reach.sum(axis=1)
        self._continuous = built.cell.continuous.astype(float)
        self._shares, self._weights = np.empty(len(built.margins)), np.zeros(built.cell.nv)
        self.clearances = np.full(len(built.margins), -np.inf)  # at least this far from the margin (P,) [m]
        self.positions = np.zeros(built.cell.nv)

    def arrays(self) -> dict[str, Array]:
        """Its memory for the core; ``most`` is what a unit of motion takes of each clearance at most."""
        return {
            "clearances": self.clearances, "at": self.positions, "reach": self._reach, "margins": self._margins,
            "most": self._most,
        }  # fmt: skip

    def start(self, distances: Array, positions: Array) -> None:
        """Begin where all distances (P,) are known."""
        self.clearances[:] = distances - self._margins
        self.positions[:] = positions

    def follow(self, positions: Array) -> None:
        """The joints are at positions (nv,) now."""
        _core.follow(self.clearances, self._reach, self.positions, positions, self._continuous)

    def near(self, watch: Array) -> list[int]:
        """Pairs nearer to their margin than this (P,) where shapes are placed; coal is asked for those that may be."""
        asked = _core.near(self.clearances, watch)
        self.ask(asked)
        return [k for k in asked if self.clearances[k] < watch[k]]

    def ask(self, pairs: Iterable[int]) -> None:
        """Ask coal for pairs, where the shapes are placed."""
        for k in pairs:
            self.clearances[k] = self.distances.one(k) - self._margins[k]

    def sharpen(self, asked: Iterable[int] = ()) -> None:
        """Ask for pairs until the distance of the pair that may use up its clearance first is known."""
        known = set(asked)
        while len(known) < min(_MOST_ASKED, self.clearances.size):
            k = _core.soonest(self.clearances, self._most, LEAST_CLEARANCE)
            if k in known:
                return
            self.ask([k])
            known.add(k)

    def certificate(self, spare: float = 0.0) -> tuple[Array, float]:
        """Reach (nv,) and slack of a :class:`coopqp.constraints.velocity.Quiet` about :attr:`positions`.

        A pair with clearance d and reach ρ keeps its margin where ``Σ ρ |δ| ≤ d``. All pairs do where
        ``Σ max(ρ / d) |δ| ≤ 1``.

        Args:
            spare: clearance that is kept for something else [m].
        """
        weights = self._weights
        known = _core.certify(self.clearances, self._reach, spare, self._shares, weights)
        return weights.copy(), 1.0 if known else -1.0


def core_shapes(model: pin.Model, geometry: pin.GeometryModel) -> dict[str, Any]:
    """Joints, shapes and pairs as ``nearby.h`` takes them."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateGeometryPlacements(model, data, geometry, placed := geometry.createData())
    shapes, corners = [], []
    for part, T in zip(geometry.geometryObjects, placed.oMg, strict=True):
        own = core_shape(part.geometry)
        place = np.concatenate([T.rotation.ravel(), T.act(own.centre)])
        shapes.append(np.array([own.kind, part.parentJoint - 1, *own.half, own.radius, *place], dtype=float))
        corners.append(np.ascontiguousarray(own.corners).ravel())
    return {
        "axes": np.ascontiguousarray(data.J.T),
        "carriers": np.array([model.parents[i + 1] - 1 for i in range(model.nv)], dtype=float),
        "shapes": np.array(shapes),
        "corners": corners,
        "pairs": np.array([(pair.first, pair.second) for pair in geometry.collisionPairs], dtype=float).reshape(-1),
    }
