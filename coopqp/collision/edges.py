"""Edges of a search for the object's path: the core walks them (``edges.cpp``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.coal_geometry import core_shape
from coopqp.collision.gaps import ObjectPair, object_pairs
from coopqp.core import _core
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

#: Smallest singular value of a tool's Jacobian on the way, in metres and radians.
LEAST_SIGMA = 0.02
#: Joints stay this far inside their limits [rad or m].
JOINT_MARGIN = 0.05
#: Bodies keep this much more than their margin at the samples of an edge [m].
SPARE = 0.003
#: Longest motion of the object between samples of an edge [m]; 1 rad counts as 0.3 m. Fewest samples of a piece.
STEP, LEAST_SAMPLES = 0.02, 4
#: Kinds of stops in the order of ``edges.h``.
_KINDS = ("", "reach", "limit", "singular", "pair")
#: Samples of a geometry that there is room for at first.
_FEW_SAMPLES = 200
#: Joints are taken to move this many times the straight way between two poses.
_BENT = 1.1
#: Lever of pairs that have none [m]: 0 times infinity is no number.
_FAR = 1e9


@dataclass(frozen=True, eq=False)
class EdgeLimits:
    """What an edge keeps.

    Attributes:
        lower, upper: positions of all joints (nv,) [rad or m].
        required: distance of each pair (P,) [m].
        spare: how much more each pair keeps at samples (P,) [m].
        sigma_min: smallest singular value of a tool's Jacobian, in metres and radians.
    """

    lower: Array
    upper: Array
    required: Array
    spare: Array
    sigma_min: float = LEAST_SIGMA


class Samples(NamedTuple):
    """Samples along a geometry.

    Attributes:
        s: where they are (K,) [m].
        poses: of the object, rows of R (9), p (3): (K, 12).
        motion: between samples the origin moves by at most this [m], and the object turns by this [rad] (K − 1, 2).
    """

    s: Array
    poses: Array
    motion: Array


class Stop(NamedTuple):
    """What stops an edge.

    Attributes:
        kind: ``"reach"``, ``"limit"``, ``"singular"`` or ``"pair"``; empty where nothing stops it.
        number: the first joint of the arm, the joint, or the pair.
    """

    kind: str
    number: int


class Walked(NamedTuple):
    """An edge as far as it is free.

    Attributes:
        positions: joint positions (K, nv) at its poses [rad or m], K of them reached.
        rooms: lower bounds of distance less what is required (K, P) [m].
        stop: what stops it behind the last of these poses.
    """

    positions: Array
    rooms: Array
    stop: Stop


@final
class Edges:
    """Walks of all arms along poses of the object that keep limits and distances, between the poses, too.

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
        """Walk as far as everything is kept.

        Args:
            poses: of the object, rows of R (9), p (3): (K, 12).
            motion: between poses the origin moves by at most this [m], and the object turns by this [rad] (K − 1, 2).
            x: joint positions (nv,) at the first pose.
            rooms: rooms (P,) there.
        """
        positions, kept, stop = np.empty((len(poses), len(x))), np.empty((len(poses), len(rooms))), np.empty(2)
        positions[0], kept[0] = x, rooms
        reached = self._native.walk(poses, motion, positions, kept, stop) + 1
        return Walked(positions[:reached], kept[:reached], Stop(_KINDS[int(stop[0])], int(stop[1])))

    def object_along(self, poses: Array, motion: Array, rooms: Array) -> int:
        """How many of the poses, from the first one on, the object keeps its distances at from what stands.

        What the arms would have to do is left out, and what is between the poses: one that is not passed is not walked
        to either. Arguments as for :meth:`walk`.
        """
        return int(self._native.object_along(poses, motion, rooms)) + 1

    def arms_along(self, poses: Array, x: Array) -> Array:
        """Joint positions (K, nv) of that walk as far as the arms follow, whatever the distances."""
        positions = np.empty((len(poses), len(x)))
        positions[0] = x
        return positions[: self._native.arms_along(poses, positions) + 1]

    def line(self, start: Array, goal: Array, steps: int) -> Array:
        """Poses along the straight edge between two (12,), rows of R (9), p (3): (steps + 1, 12)."""
        poses = np.empty((steps + 1, 12))
        _core.line(start, goal, poses)
        return poses

    def samples(self, poses: Array, deviations: Array) -> Samples:
        """Samples of straight lines with corners rounded off, those of :func:`coopqp.planning.route.sampling.rounded`.

        Args:
            poses: both ends, and the corners, rows of R (9), p (3): (M, 12).
            deviations: at most this far from each corner (M − 2,) [m].
        """
        settings = np.array([STEP, LEAST_SAMPLES])
        while True:
            size = len(self._samples[0])
            found = _core.rounded(poses, deviations, settings, *self._samples)
            if found <= size:
                s, rows, motion = self._samples
                return Samples(s[:found].copy(), rows[:found].copy(), motion[: found - 1].copy())
            self._samples = _room_for(2 * found)

    def rooms(self, x: Array) -> Array:
        """Distance less what is required (P,) [m] at joint positions (nv,), or a lower bound of it."""
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


def columns_of(cell: RobotCell, arms: Sequence[ArmKinematics]) -> list[Array]:
    """Columns of each arm's joints among those of the cell."""
    return [own.start + arm.columns for own, arm in zip(cell.v_slices, arms, strict=True)]


def limits_with(cell: RobotCell, starts: Array, required: Array) -> EdgeLimits:
    """What edges keep that begin at ``starts`` (M, nv), and may begin nearer to a joint's limit than others get."""
    lower = np.minimum(cell.limits.lower + JOINT_MARGIN, starts.min(axis=0))
    upper = np.maximum(cell.limits.upper - JOINT_MARGIN, starts.max(axis=0))
    return EdgeLimits(lower, upper, required, np.full(len(required), SPARE))
