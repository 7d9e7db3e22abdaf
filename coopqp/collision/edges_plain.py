"""Edges of a search in NumPy, with distances by coal: the definition of ``edges.cpp``."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.distances import Distances, Indices
from coopqp.collision.gaps import ObjectGaps
from coopqp.model.batch import ArmKinematics
from coopqp.model.grasp import Grasp
from coopqp.planning.route.edges import EdgeLimits, Samples, Stop, Walked, columns_of
from coopqp.planning.route.sampling import rounded, samples_of
from coopqp.planning.route.tree import Pose
from coopqp.spatial import Array, rotations

#: Joints are taken to move this many times the straight way between two poses.
BENT = 1.1
#: Lever of pairs that have none [m]: 0 times infinity is no number.
FAR = 1e9
#: Halvings of a step between two poses; ``edges.cpp`` has the same.
_MOST_HALVED = 7

_FREE = Stop("", 0)


@final
class PlainEdges:
    """See :class:`coopqp.planning.route.edges.Edges`.

    A room is a lower bound of a pair's distance less what is required. A step between two poses takes at most
    ``drop = min(Σ ρ_j |δ_j|, |Δp| + lever · angle)`` of it. Where the room at its start is more than that and the
    spare, the room at its end is what is left; else the distance is asked. The step keeps the pair's distance where
    ``room_a + room_b ≥ drop``; else it is halved.

    Args:
        built: the scene.
        arms: kinematics of each arm of its cell.
        grasp: how they hold the object.
        limits: what the edges keep.
    """

    effort = 0.05

    def __init__(self, built: BuiltScene, arms: Sequence[ArmKinematics], grasp: Grasp, limits: EdgeLimits) -> None:
        self._built, self._arms, self._limits = built, tuple(arms), limits
        self._columns = columns_of(built.cell, arms)
        self._offsets = [np.array(X.homogeneous) for X in grasp.T_object_tool]
        self._gaps = ObjectGaps(built, grasp)
        self._distances, self._levers = Distances(built), np.minimum(built.levers, FAR)

    def walk(self, poses: Array, motion: Array, x: Array, rooms: Array) -> Walked:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        positions, kept = [x], [rooms]
        T = _matrices(poses)
        for i in range(len(poses) - 1):
            after, stop = self._step(T[i], T[i + 1], positions[-1])
            ahead = None
            if after is not None:
                ahead, stop = self._clear(T[i], T[i + 1], motion[i], positions[-1], after, kept[-1])
            if after is None or ahead is None:
                return Walked(np.array(positions), np.array(kept), stop)
            positions.append(after)
            kept.append(ahead)
        return Walked(np.array(positions), np.array(kept), _FREE)

    def object_along(self, poses: Array, motion: Array, rooms: Array) -> int:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        limits, pairs = self._limits, np.array([pair.number for pair in self._gaps.pairs], dtype=int)
        room = rooms[pairs]
        for i in range(len(motion)):
            room = room - motion[i, 0] - motion[i, 1] * self._levers[pairs]
            if not (room >= limits.spare[pairs]).all():
                T = Pose.of_row(poses[i + 1]).placement()
                room = np.array([self._gaps.distance(pair, T) for pair in self._gaps.pairs]) - limits.required[pairs]
            if not (room >= limits.spare[pairs]).all():
                return i + 1
        return len(poses)

    def arms_along(self, poses: Array, x: Array) -> Array:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        positions, T = [x], _matrices(poses)
        for before, behind in itertools.pairwise(T):
            after, _ = self._step(before, behind, positions[-1])
            if after is None:
                break
            positions.append(after)
        return np.array(positions)

    def line(self, start: Array, goal: Array, steps: int) -> Array:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        share = np.linspace(0.0, 1.0, steps + 1)[:, None]
        R = start[:9].reshape(3, 3)
        turn = np.asarray(pin.log3(R.T @ goal[:9].reshape(3, 3)))
        poses = np.empty((steps + 1, 12))
        poses[:, :9] = (R @ rotations(share * turn)).reshape(-1, 9)
        poses[:, 9:] = start[9:] + share * (goal[9:] - start[9:])
        poses[-1] = goal
        return poses

    def samples(self, poses: Array, deviations: Array) -> Samples:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        return samples_of(rounded([Pose.of_row(row) for row in poses], deviations))

    def rooms(self, x: Array) -> Array:
        """See :class:`coopqp.planning.route.edges.Edges`."""
        return self._distances.all(self._built.cell.configuration(x)) - self._limits.required

    def _step(self, T: Array, ahead: Array, x: Array) -> tuple[Array | None, Stop]:
        """Joint positions at the next pose, or what stops the arms before it."""
        out = x.copy()
        for arm, columns, offset in zip(self._arms, self._columns, self._offsets, strict=True):
            q, reached = arm.trajectories(np.array([T, ahead]) @ offset, x[None, columns])
            if not reached[0]:
                return None, Stop("reach", int(columns[0]))
            q_next = q[0, 1]
            outside = (q_next < self._limits.lower[columns]) | (q_next > self._limits.upper[columns])
            if outside.any():
                return None, Stop("limit", int(columns[outside.argmax()]))
            if not arm.singular_values(q_next[None])[0, -1] >= self._limits.sigma_min:
                return None, Stop("singular", int(columns[0]))
            out[columns] = q_next
        return out, _FREE

    def _drops(self, a: Array, b: Array, motion: Array) -> Array:
        built = self._built
        out: Array = np.minimum(built.reach @ (BENT * np.abs(b - a)), motion[0] + motion[1] * self._levers)
        return out

    def _asked(self, pairs: Indices, x: Array) -> Array:
        self._distances.place(self._built.cell.configuration(x))
        return np.array([self._distances.one(int(k)) for k in pairs]) - self._limits.required[pairs]

    def _clear(
        self, T: Array, ahead: Array, motion: Array, a: Array, b: Array, rooms: Array
    ) -> tuple[Array | None, Stop]:
        """Rooms (P,) at b, or the pair that comes too close on the step from a."""
        drops, spare = self._drops(a, b, motion), self._limits.spare
        after = rooms - drops
        near = np.flatnonzero(after < spare)
        if not near.size:
            return after, _FREE
        found = self._asked(near, b)
        if (found < spare[near]).any():
            return None, Stop("pair", int(near[(found - spare[near]).argmin()]))
        after[near] = found
        still = near[rooms[near] + found < drops[near]]
        if still.size:
            at_a = self._asked(still, a)
            open_ = at_a + after[still] < drops[still]
            stop = self._halved(T, ahead, motion, a, b, still[open_], at_a[open_], after[still[open_]], 0)
            if stop.kind:
                return None, stop
        return after, _FREE

    def _halved(
        self,
        T: Array,
        ahead: Array,
        motion: Array,
        a: Array,
        b: Array,
        pairs: Indices,
        rooms_a: Array,
        rooms_b: Array,
        depth: int,
    ) -> Stop:
        """What stops some pairs on a step, by halving it."""
        if not pairs.size:
            return _FREE
        middle, half = _halfway(T, ahead), 0.5 * motion
        x, stop = self._step(T, middle, a)
        if x is None:
            return stop
        found = self._asked(pairs, x)
        left = rooms_a + found < self._drops(a, x, half)[pairs]
        right = found + rooms_b < self._drops(x, b, half)[pairs]
        lost = (found < self._limits.spare[pairs]) | ((left | right) & (depth >= _MOST_HALVED))
        if lost.any():
            return Stop("pair", int(pairs[lost.argmax()]))
        stop = self._halved(T, middle, half, a, x, pairs[left], rooms_a[left], found[left], depth + 1)
        if stop.kind:
            return stop
        return self._halved(middle, ahead, half, x, b, pairs[right], found[right], rooms_b[right], depth + 1)


def _matrices(rows: Array) -> Array:
    T = np.zeros((len(rows), 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:], 1.0
    return T


def _halfway(T: Array, ahead: Array) -> Array:
    """Halfway between two poses: along the line, about one axis."""
    out = T.copy()
    out[:3, :3] = pin.exp3(0.5 * pin.log3(ahead[:3, :3] @ T[:3, :3].T)) @ T[:3, :3]
    out[:3, 3] = 0.5 * (T[:3, 3] + ahead[:3, 3])
    return out
