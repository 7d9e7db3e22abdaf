"""Poses of the object that are pushed off the bodies that stand around it, whatever the arms do."""

from __future__ import annotations

from typing import final

import coal
import numpy as np
import pinocchio as pin

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.distances import new_request
from coopqp.model.grasp import Grasp
from coopqp.native.constants import DEEPEST, FARTHEST_POINT, TURN_LENGTH
from coopqp.spatial import Array, cross

#: Pushes of one pose, and the longest of them [m], where 1 rad counts as 0.3 m.
_PUSHES, _LONGEST = 12, 0.1
#: A push leads this much beyond what is required [m].
_BEYOND = 1e-3


@final
class ObjectGaps:
    """Distances of the object from the bodies that stand, by coal, as functions of its pose.

    Args:
        built: the scene.
        grasp: how the arms hold the object.
    """

    def __init__(self, built: BuiltScene, grasp: Grasp) -> None:
        cell, shapes, pairs = built.cell, built.geometry.geometryObjects, built.geometry.collisionPairs
        self._request, self._result = new_request(), coal.DistanceResult()
        self._pairs = []
        for k in np.flatnonzero(np.isfinite(built.levers) & ~built.moves):
            first, second = shapes[pairs[int(k)].first], shapes[pairs[int(k)].second]
            held, other, sign = (first, second, -1.0) if first.parentJoint else (second, first, 1.0)
            arm = next(i for i, joint in enumerate(cell.tool_joints) if joint == held.parentJoint)
            T_object_shape = grasp.T_object_tool[arm] * cell.T_joint_tool[arm].inverse() * held.placement
            self._pairs.append((int(k), held.geometry, T_object_shape, other.geometry, other.placement, sign))

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
        for k, held, T_object_shape, other, T_other, sign in self._pairs:
            place = T * T_object_shape
            shapes = (held, place, other, T_other) if sign < 0.0 else (other, T_other, held, place)
            a, T_a, b, T_b = shapes
            self._result.clear()  # it keeps the least of its distances
            d = coal.distance(
                a, coal.Transform3s(T_a.rotation, T_a.translation), b, coal.Transform3s(T_b.rotation, T_b.translation),
                self._request, self._result,
            )  # fmt: skip
            lacks = required[k] - max(d, DEEPEST)
            if lacks <= 0.0:
                continue
            n, p = np.array(self._result.normal), np.array(self._result.getNearestPoint2())
            if not (np.abs(n) < FARTHEST_POINT).all() or not (np.abs(p) < FARTHEST_POINT).all():
                n = p = np.zeros(3)
            across = n - along * float(along @ n)
            rows.append(sign * np.concatenate([across, cross(p - T.translation, n)]))
            missing.append(lacks + _BEYOND)
        return rows, missing
