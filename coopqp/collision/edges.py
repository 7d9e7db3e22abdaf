"""Edges of a search for the object's path: the core walks them (``edges.cpp``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.coal_geometry import core_shape
from coopqp.collision.gaps import ObjectPair, object_pairs
from coopqp.core import _core
from coopqp.model.batch import ArmKinematics
from coopqp.model.grasp import Grasp
from coopqp.planning.route.edges import EdgeLimits, Samples, Stop, Walked, columns_of
from coopqp.planning.route.sampling import LEAST_SAMPLES
from coopqp.planning.route.tree import STEP
from coopqp.spatial import Array

#: Kinds of stops in the order of ``edges.h``.
_KINDS = ("", "reach", "limit", "singular", "pair")
#: Samples of a geometry that there is room for at first.
_FEW_SAMPLES = 200
#: Joints are taken to move this many times the straight way between two poses.
_BENT = 1.1
#: Lever of pairs that have none [m]: 0 times infinity is no number.
_FAR = 1e9


@final
class SceneEdges:
    """See :class:`coopqp.planning.route.edges.Edges`.

    A room is a lower bound of a pair's distance less what is required. A step between two poses takes at most
    ``drop = min(Σ ρ_j |δ_j|, |Δp| + lever · angle)`` of it. Where the room at its start is more than that and the
    spare, the room at its end is what is left; else the distance is asked. The step keeps the pair's distance where
    ``room_a + room_b ≥ drop``; else it is halved.

    Args:
        built: the scene.
        shapes: what :func:`coopqp.collision.distances.core_shapes` tells of it.
        arms: kinematics of each arm of its cell.
        grasp: how they hold the object.
        limits: what the edges keep.
    """

    def __init__(
        self,
        built: BuiltScene,
        shapes: dict[str, Any],
        arms: Sequence[ArmKinematics],
        grasp: Grasp,
        limits: EdgeLimits,
    ) -> None:
        numbers = {
            "reach": np.ascontiguousarray(built.reach.T),
            "levers": np.minimum(built.levers, _FAR),
            "required": limits.required, "spare": limits.spare, "lower": limits.lower, "upper": limits.upper,
            "held": np.array([_numbers_of(pair) for pair in object_pairs(built, grasp)], dtype=float),
            "settings": np.array([limits.sigma_min, _BENT]),
        }  # fmt: skip
        of_arms = [
            {
                "numbers": arm.numbers,
                "columns": columns.astype(float),
                "T_object_tool": np.concatenate([X.rotation.ravel(), X.translation]),
            }
            for arm, columns, X in zip(arms, columns_of(built.cell, arms), grasp.T_object_tool, strict=True)
        ]
        self._samples = _room_for(_FEW_SAMPLES)
        self._pairs = len(built.labels)
        self._native = _core.Edges(numbers, of_arms, shapes)

    def walk(self, poses: Array, motion: Array, x: Array, rooms: Array) -> Walked:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        positions, kept, stop = np.empty((len(poses), len(x))), np.empty((len(poses), len(rooms))), np.empty(2)
        positions[0], kept[0] = x, rooms
        reached = self._native.walk(poses, motion, positions, kept, stop) + 1
        return Walked(positions[:reached], kept[:reached], Stop(_KINDS[int(stop[0])], int(stop[1])))

    def object_along(self, poses: Array, motion: Array, rooms: Array) -> int:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        return int(self._native.object_along(poses, motion, rooms)) + 1

    def arms_along(self, poses: Array, x: Array) -> Array:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        positions = np.empty((len(poses), len(x)))
        positions[0] = x
        return positions[: self._native.arms_along(poses, positions) + 1]

    def line(self, start: Array, goal: Array, steps: int) -> Array:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        poses = np.empty((steps + 1, 12))
        _core.line(start, goal, poses)
        return poses

    def samples(self, poses: Array, deviations: Array) -> Samples:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        settings = np.array([STEP, LEAST_SAMPLES])
        while True:
            size = len(self._samples[0])
            found = _core.rounded(poses, deviations, settings, *self._samples)
            if found <= size:
                s, rows, motion = self._samples
                return Samples(s[:found].copy(), rows[:found].copy(), motion[: found - 1].copy())
            self._samples = _room_for(2 * found)

    def rooms(self, x: Array) -> Array:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        out = np.empty(self._pairs)
        self._native.measure(np.ascontiguousarray(x), out)
        return out


def _numbers_of(pair: ObjectPair) -> list[float]:
    """Its number, and where the held shape's core is in the object, R (9), p (3)."""
    T = pair.T_object_held
    return [pair.number, *T.rotation.ravel(), *T.act(core_shape(pair.held).centre)]


def _room_for(samples: int) -> Samples:
    """Memory of samples that are not known yet."""
    return Samples(np.empty(samples), np.empty((samples, 12)), np.empty((samples - 1, 2)))
