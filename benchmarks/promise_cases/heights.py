"""How far arms on a torso could raise what they hold: a search of its own, which shares no code with the planner.

Where a torso lifts both arms straight up by s, what an arm can do for a bar at the height z depends on d = z − s alone.
So the search looks over d for configurations of each arm inside its limits, off singularities, and for what is
connected: in one level along the self-motion, and from level to level. From a start at z the torso at rest at s lets d
rise from z − s; the torso that moves lets d stay as low as it likes, and ends at its top: its rise is at most the
highest connected d, more the torso's top, less z. So all that a torso can add is what its top at the start would cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from coopqp.spatial import Array

#: Distance of levels [m]; motion of the joints along a self-motion, and of those that are neighbours [rad].
LEVEL, _STRIDE, _NEAR = 0.01, 0.06, 0.15
#: Random seeds of a level, self-motions that are traced, and how far apart they begin [rad].
_SEEDS, _LINES, _APART = 120, 24, 0.3
#: Least singular value, and how exactly a pose is reached [m, rad].
_SINGULAR, _EXACT = 2e-3, 1e-7
#: Newton steps from a seed and along a self-motion, and the longest of them [rad].
_STEPS, _FEW_STEPS, _LONGEST = 25, 6, 0.3
#: Every so many points of a level are seeds of the next one.
_EVERY = 4

Flags = npt.NDArray[np.bool_]


@final
class TurningArm:
    """One arm of joints that turn, behind a torso at its zero.

    Args:
        model: the whole robot.
        tool: the arm's tool frame.
        torso: the joint that lifts it, along the world's z axis.

    Attributes:
        lower, upper: limits of its joints (n,) [rad].
        stroke: lowest and highest position of the torso [m].
    """

    def __init__(self, model: pin.Model, tool: str, torso: str) -> None:
        chain = list(model.supports[model.frames[model.getFrameId(tool)].parentJoint])[1:]
        lift = model.getJointId(torso)
        assert lift in chain, "the arm is behind the torso"
        columns = pin.computeJointJacobians(model, model.createData(), pin.neutral(model))
        assert np.allclose(columns[:, model.joints[lift].idx_v], [0, 0, 1, 0, 0, 0]), "it lifts straight up"
        i = model.joints[lift].idx_q
        self.stroke = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
        own = [model.names[i] for i in chain[chain.index(lift) + 1 :]]
        rest = [i for i in range(1, model.njoints) if model.names[i] not in own]
        alone = pin.buildReducedModel(model, rest, pin.neutral(model))
        assert alone.nq == alone.nv == len(own), "joints with limits, one after the other"
        data = alone.createData()
        pin.computeJointJacobians(alone, data, pin.neutral(alone))
        places = [data.oMi[i].rotation for i in range(1, alone.njoints)]
        self._axes = [R.T @ J for R, J in zip(places, data.J[3:].T, strict=True)]
        self._placements = [T.homogeneous for T in list(alone.jointPlacements)[1:]]
        self._tool = alone.frames[alone.getFrameId(tool)].placement.homogeneous
        self.lower, self.upper = alone.lowerPositionLimit.copy(), alone.upperPositionLimit.copy()

    def tools(self, q: Array) -> tuple[Array, Array]:
        """Poses of the tool (M, 4, 4) and their Jacobians (M, 6, n) in the world at q (M, n)."""
        T = np.tile(np.eye(4), (len(q), 1, 1))
        points, axes = [], []
        for own, axis, x in zip(self._placements, self._axes, q.T, strict=True):
            T = T @ own
            points.append(T[:, :3, 3])
            axes.append(T[:, :3, :3] @ axis)
            turn = np.tile(np.eye(4), (len(q), 1, 1))
            K = pin.skew(axis)
            turn[:, :3, :3] += np.sin(x)[:, None, None] * K + (1.0 - np.cos(x))[:, None, None] * (K @ K)
            T = T @ turn
        T = T @ self._tool
        w, p = np.array(axes).transpose(1, 0, 2), np.array(points).transpose(1, 0, 2)
        return T, np.concatenate([np.cross(w, T[:, None, :3, 3] - p), w], axis=2).transpose(0, 2, 1)

    def solved(self, goal: Array, q: Array, steps: int) -> tuple[Array, Flags]:
        """Configurations near q (M, n) that have the tool at a goal (4, 4), and which of them do."""
        for _ in range(steps):
            error, J = self._error(goal, q)
            if np.abs(error).max() < 1e-2 * _EXACT:
                break
            G = J @ J.transpose(0, 2, 1) + 1e-8 * np.eye(6)
            step = (J.transpose(0, 2, 1) @ np.linalg.solve(G, error[:, :, None]))[:, :, 0]
            q = q + step * np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        return q, np.abs(self._error(goal, q)[0]).max(axis=1) < _EXACT

    def _error(self, goal: Array, q: Array) -> tuple[Array, Array]:
        T, J = self.tools(q)
        D = goal[:3, :3] @ T[:, :3, :3].transpose(0, 2, 1)
        axis = 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1)
        sine, cosine = np.linalg.norm(axis, axis=1), 0.5 * (np.trace(D, axis1=1, axis2=2) - 1.0)
        size = np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(sine, 1e-9), 1.0)
        return np.concatenate([goal[:3, 3] - T[:, :3, 3], size[:, None] * axis], axis=1), J

    def inside(self, q: Array) -> Flags:
        """Which of q (M, n) are inside the limits."""
        inside: Flags = ((q >= self.lower) & (q <= self.upper)).all(axis=1)
        return inside

    def configurations(self, goal: Array, seeds: Array, rng: np.random.Generator) -> Array:
        """Configurations inside the limits that have the tool at a goal (4, 4), along the self-motions (P, n)."""
        seeds = np.vstack([rng.uniform(self.lower, self.upper, (_SEEDS, len(self.lower))), seeds])
        q, good = self.solved(goal, seeds, _STEPS)
        q -= 2.0 * np.pi * np.round((q - 0.5 * (self.lower + self.upper)) / (2.0 * np.pi))
        q = q[good & self.inside(q)]
        first: list[Array] = []
        rest = q
        while len(rest) and len(first) < _LINES:
            first.append(rest[0])
            rest = rest[np.abs(rest - rest[0]).max(axis=1) > _APART]
        if first:
            q = np.vstack([q, self._traced(goal, np.array(first))])
        return q[np.sort(np.unique(np.round(q / _STRIDE), axis=0, return_index=True)[1])]

    def _traced(self, goal: Array, first: Array) -> Array:
        """The self-motions through configurations (M, n), both ways, to the limits or once around."""
        q = np.vstack([first, first])
        found, last = [q], np.zeros_like(q)
        last[: len(first)], last[len(first) :] = self._along(first)[0], -self._along(first)[0]
        alive = np.arange(len(q))
        for _ in range(math.ceil(2.4 * np.pi / _STRIDE)):
            along, sigma = self._along(q[alive])
            along = np.where((along * last[alive]).sum(axis=1, keepdims=True) < 0.0, -along, along)
            ahead = q[alive] + _STRIDE * along / np.abs(along).max(axis=1, keepdims=True)
            new, good = self.solved(goal, ahead, _FEW_STEPS)
            good &= self.inside(new) & (sigma > _SINGULAR) & (np.abs(new - q[alive]).max(axis=1) < 3.0 * _STRIDE)
            last[alive] = along
            alive, new = alive[good], new[good]
            if not len(alive):
                break
            q[alive] = new
            found.append(new)
        return np.vstack(found)

    def _along(self, q: Array) -> tuple[Array, Array]:
        """Directions of the self-motion (M, n), and the least singular values (M,)."""
        _, sigma, Vt = np.linalg.svd(self.tools(q)[1])
        return Vt[:, 6], sigma[:, 5]


class Rises(NamedTuple):
    """The highest rises that were found possible [m]: with the torso at the best height, and with it moving."""

    at_rest: float
    moving: float


@dataclass
class Levels:
    """What is connected: islands of each level, and pairs of them from a level to the next."""

    islands: list[int]
    links: list[npt.NDArray[np.intp]]

    def top(self, level: int) -> int:
        """The highest level that is reached from one, always upward."""
        reached = np.arange(self.islands[level])
        for pairs in self.links[level:]:
            reached = np.unique(pairs[np.isin(pairs[:, 0], reached), 1])
            if not len(reached):
                return level
            level += 1
        return level

    def highest(self, low: int, high: int) -> int:
        """The highest level that is connected with one of some, up and down."""
        first = np.cumsum([0, *self.islands])
        pairs = np.vstack(
            [np.empty((0, 2), dtype=np.intp), *(own + first[i : i + 2] for i, own in enumerate(self.links))]
        )
        parts = _parts(pairs, int(first[-1]))
        good = np.flatnonzero(np.isin(parts, parts[first[low] : first[min(high, len(self.islands) - 1) + 1]]))
        return int(np.searchsorted(first, good.max(), side="right")) - 1


def _parts(pairs: Array, count: int) -> npt.NDArray[np.intp]:
    """The part of each of some nodes that pairs connect (count,)."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def _levels(arm: TurningArm, pose: Callable[[float], Array], start: float, end: float) -> Levels:
    """What an arm can do from one d to another, up to the first level at which it can do nothing."""
    rng, found = np.random.default_rng(3), Levels([], [])
    before: tuple[KDTree, npt.NDArray[np.intp]] | None = None
    for d in np.arange(start, end, LEVEL).tolist():
        seeds = np.empty((0, len(arm.lower))) if before is None else before[0].data[::_EVERY]
        q = arm.configurations(pose(d), seeds, rng)
        if not len(q) and found.islands and found.islands[-1]:
            break
        tree = KDTree(q)
        island = _parts(tree.query_pairs(_NEAR, p=np.inf, output_type="ndarray"), len(q))
        if before is not None:
            near = before[0].query_ball_tree(tree, _NEAR, p=np.inf)
            pairs = [(before[1][i], island[j]) for i, own in enumerate(near) for j in own]
            found.links.append(np.unique(np.array(pairs, dtype=np.intp).reshape(-1, 2), axis=0))
        found.islands.append(int(island.max(initial=-1)) + 1)
        before = tree, island
    return found


def rises(arms: Sequence[tuple[TurningArm, Callable[[float], Array]]], z: float, highest: float) -> Rises:
    """The highest rises from a height.

    Args:
        arms: each arm, and T_world_tool (4, 4) for the bar at a height [m].
        z: height of the bar at the start [m].
        highest: no higher rise is looked for [m].
    """
    low, top = arms[0][0].stroke
    every = [_levels(arm, pose, z - top, z + highest - top + LEVEL) for arm, pose in arms]
    starts = range(min(round((top - low) / LEVEL) + 1, *(len(own.islands) for own in every)))
    at_rest = max(min(own.top(i) for own in every) - i for i in starts)
    return Rises(LEVEL * at_rest, LEVEL * min(own.highest(0, starts[-1]) for own in every))
