"""Poses of the object that are pushed off the bodies that stand around it, whatever the arms do."""

from __future__ import annotations

from typing import Any, NamedTuple, final

import coal
import numpy as np
import pinocchio as pin

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.distances import new_request
from coopqp.core._core import DEEPEST, FARTHEST_POINT, TURN_LENGTH
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array, cross

#: Pushes of one pose, and the longest of them [m], where 1 rad counts as 0.3 m.
_PUSHES, _LONGEST = 12, 0.1
#: A push leads this much beyond what is required [m].
_BEYOND = 1e-3


class ObjectPair(NamedTuple):
    """A pair of the object, or what it carries, with a body that stands.

    Attributes:
        number: of the pair in the scene.
        held, other: their geometries.
        T_object_held, T_world_other: where they are.
        sign: −1 where the held one is the first of the pair, else 1.
    """

    number: int
    held: Any
    T_object_held: pin.SE3
    other: Any
    T_world_other: pin.SE3
    sign: float


def object_pairs(built: BuiltScene, grasp: Grasp) -> list[ObjectPair]:
    """The pairs of a scene whose distance is a function of the object's pose, whatever the arms do."""
    cell, shapes, pairs = built.cell, built.geometry.geometryObjects, built.geometry.collisionPairs
    found = []
    for k in np.flatnonzero(np.isfinite(built.levers) & ~built.moves):
        first, second = shapes[pairs[int(k)].first], shapes[pairs[int(k)].second]
        held, other, sign = (first, second, -1.0) if first.parentJoint else (second, first, 1.0)
        arm = next(i for i, joint in enumerate(cell.tool_joints) if joint == held.parentJoint)
        T_object_held = grasp.T_object_tool[arm] * cell.T_joint_tool[arm].inverse() * held.placement
        found.append(ObjectPair(int(k), held.geometry, T_object_held, other.geometry, other.placement, sign))
    return found


@final
class ObjectGaps:
    """Distances of the object from the bodies that stand, by coal, as functions of its pose.

    Args:
        built: the scene.
        grasp: how the arms hold the object.

    Attributes:
        pairs: that have such a distance.
    """

    def __init__(self, built: BuiltScene, grasp: Grasp) -> None:
        self.pairs = object_pairs(built, grasp)
        self._request, self._result = new_request(), coal.DistanceResult()

    def distance(self, pair: ObjectPair, T_world_object: pin.SE3) -> float:
        """Distance of a pair [m]."""
        T_held, T_other = (
            coal.Transform3s(T.rotation, T.translation)
            for T in (T_world_object * pair.T_object_held, pair.T_world_other)
        )
        shapes = (pair.held, T_held, pair.other, T_other)
        self._result.clear()  # it keeps the least of its distances
        d = coal.distance(*(shapes if pair.sign < 0.0 else shapes[2:] + shapes[:2]), self._request, self._result)
        return max(d, DEEPEST)

    def pushed(self, T_world_object: pin.SE3, along: Array, required: Array) -> pin.SE3 | None:
        """The pose pushed across a line until all pairs keep their distance; None if it does not get there.

        Args:
            T_world_object: the pose.
            along: unit vector of the line (3,), along which it is not pushed.
            required: distance of each pair of the scene (P,) [m].
        """
        T = pin.SE3(T_world_object)
        for _ in range(_PUSHES):
            rows, missing = self._missing(T, along, required)
            if not missing:
                return T
            A = np.array(rows)
            A[:, 3:] /= TURN_LENGTH
            push = np.linalg.lstsq(A, np.array(missing), rcond=1e-3)[0]
            size = float(np.linalg.norm(push))
            if not 0.0 < size < np.inf:
                return None
            push *= min(1.0, _LONGEST / size)
            T = pin.SE3(pin.exp3(push[3:] / TURN_LENGTH) @ T.rotation, T.translation + push[:3])
        return None

    def _missing(self, T: pin.SE3, along: Array, required: Array) -> tuple[list[Array], list[float]]:
        """Of pairs that are too close what they lack [m], and its gradient by the object's motion (6,)."""
        rows, missing = [], []
        for pair in self.pairs:
            lacks = required[pair.number] - self.distance(pair, T)
            if lacks <= 0.0:
                continue
            n, p = np.array(self._result.normal), np.array(self._result.getNearestPoint2())
            if not (np.abs(n) < FARTHEST_POINT).all() or not (np.abs(p) < FARTHEST_POINT).all():
                n = p = np.zeros(3)
            across = n - along * float(along @ n)
            rows.append(pair.sign * np.concatenate([across, cross(p - T.translation, n)]))
            missing.append(lacks + _BEYOND)
        return rows, missing
