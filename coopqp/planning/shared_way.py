"""Where joints that several arms share stand along a path: a way that all arms of the group can take.

With the positions s of the shared joints given along the path, each arm of a group is an arm by itself on a base that
moves, and is looked at by itself. So a table per arm and branch says, over the path and a grid of s, how far the arm is
from its limits and from singularities; a way through the tables of all arms is chosen: constant, else linear along each
segment, else from sample to sample. The time that the shared joints need comes first, the least margin second.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.constraints.samples import PathSamples
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import AT_LIMIT, find_branches
from coopqp.model.cell import RobotCell
from coopqp.paths.segments import Indices, Segments
from coopqp.planning.arm_starts import GOOD_MARGIN, GOOD_SIGMA, away_from_limits
from coopqp.planning.on_shared import OnShared, group_joints
from coopqp.spatial import Array

#: Positions of one shared joint in the grid, of each of two, of three, and of more.
_GRID = (13, 7, 4, 3)
#: Samples of the path in a table, and the most branches of an arm.
MOST_SAMPLES, _MOST_BRANCHES = 48, 8
#: Samples of another table, where none of the ways in the first is good: of a redundant arm it may reach further.
FEW = 16
#: Longest step of a joint between neighbours of a table [rad or m], and Newton steps for it.
_STEP, _STEPS = 0.8, 12
#: A way is taken if the score of all arms is at least this, the first one that is found.
_WANTED = (0.1, 0.02)
#: Peak of a quintic time law's speed over its mean.
_PEAK = 1.875
#: Steps that lead a redundant arm away from its limits: at the start, and in a table where it is close to one.
_RELAXED, _LEADS, _CLOSE = (0.3, 0.2, 0.1, 0.05), (0.1, 0.05), 0.35


@final
@dataclass(frozen=True, eq=False)
class SharedWay:
    """Positions of the shared joints of a group along a path, linear between places.

    Attributes:
        arms: indices of the group's arms.
        joints: velocity coordinates of the shared joints in the cell (S,).
        places: rising (W,); see :mod:`coopqp.paths.joint_trajectories`.
        s: positions there (W, S) [rad or m].
    """

    arms: tuple[int, ...]
    joints: Indices
    places: Array
    s: Array

    def at(self, places: Array) -> Array:
        """Positions (M, S) at places (M,)."""
        return np.column_stack([np.interp(places, self.places, own) for own in self.s.T])

    @property
    def stands(self) -> bool:
        """Whether no shared joint moves."""
        return bool((self.s == self.s[0]).all())


class _Tables(NamedTuple):
    """Scores of one arm's branches (B, K, H), and their positions at the first sample (B, H, n)."""

    scores: Array
    starts: Array


def ways(
    cell: RobotCell,
    arms: Sequence[OnShared],
    group: tuple[int, ...],
    tool_paths: Sequence[tuple[Array, Array]],
    duration: Array,
    *,
    at_start: Array | None = None,
    near: Sequence[Array] | None = None,
) -> Iterator[tuple[SharedWay, list[Array]]]:
    """Ways of the shared joints, the best kind first, each with starts (B, n) of the own joints of each arm.

    The last one is that on which the arms get furthest, where none is good for the whole path.

    Args:
        cell: the cell.
        arms: the arms of the group.
        group: their indices.
        tool_paths: per arm the places of the samples (K,) and T_world_tool there (K, 4, 4).
        duration: of the time between samples (K − 1,) [s].
        at_start: where the shared joints are at the start (S,); free by default.
        near: positions of each arm's own joints at the start (n,), with ``at_start``: the branch to take.
    """
    joints = group_joints(cell, group)
    grid, neighbours = _grid(cell, joints, at_start)
    tables = [
        _table(arm, poses, grid, neighbours, None if near is None else near[i])
        for i, (arm, (_, poses)) in enumerate(zip(arms, tool_paths, strict=True))
    ]
    if any(not len(table.scores) for table in tables):
        return
    places = tool_paths[0][0]
    search = _Search(places, duration, grid, neighbours, cell.limits.velocity[joints], at_start)
    order = [np.argsort(-np.maximum(t.scores, 0.0).sum(axis=(1, 2)), kind="stable")[:_MOST_BRANCHES] for t in tables]
    choices = list(itertools.islice(itertools.product(*order), _MOST_BRANCHES**2))
    together = [np.min([t.scores[b] for t, b in zip(tables, choice, strict=True)], axis=0) for choice in choices]
    for kind in (search.constant, search.by_segment, search.by_sample, search.as_far):
        found = [(answer, choice) for choice, S in zip(choices, together, strict=True) if (answer := kind(S))]
        if not found:
            continue
        (_, _, at, which), choice = min(found, key=lambda f: (round(f[0][0], 6), -f[0][1]))
        way = SharedWay(tuple(group), joints, at, grid[which])
        starts = []
        for table, b in zip(tables, choice, strict=True):
            others = [i for i in range(len(table.starts)) if i != b]
            rows = table.starts[[b, *others], which[0]]
            starts.append(rows[np.isfinite(rows).all(axis=1)])
        yield way, starts


def ways_at(
    cell: RobotCell,
    arms: Sequence[OnShared],
    group: tuple[int, ...],
    samples: PathSamples,
    segments: Segments | None,
    poses: Sequence[Array],
    numbers: Sequence[int],
    *,
    at_start: Array | None = None,
    near: Sequence[Array] | None = None,
) -> Iterator[tuple[SharedWay, list[Array]]]:
    """:func:`ways` through tables of several numbers of samples, one after the other.

    Args:
        cell, arms, group, at_start, near: as of :func:`ways`.
        samples, segments: the path.
        poses: T_world_tool of each arm at the samples (K, 4, 4).
        numbers: of samples in a table.
    """
    for most in numbers if len(samples.clocks) > min(numbers) else numbers[:1]:
        chosen, places = few_samples(samples, segments, most=most)
        tools = [(places, T[chosen]) for T in poses]
        yield from ways(cell, arms, group, tools, np.diff(samples.clocks[chosen]), at_start=at_start, near=near)


def _grid(cell: RobotCell, joints: Indices, at_start: Array | None) -> tuple[Array, list[list[int]]]:
    """Positions of the shared joints (H, S), and the neighbours of each."""
    low, high = cell.limits.lower[joints], cell.limits.upper[joints]
    count = _GRID[min(len(joints), len(_GRID)) - 1]
    axes = []
    for j, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        a, b = a if np.isfinite(a) else -np.pi, b if np.isfinite(b) else np.pi
        axis = np.linspace(a, b, count)
        inset = 0.02 * (b - a)
        axis[0], axis[-1] = a + inset, b - inset
        if at_start is not None:
            axis = np.unique(np.append(axis, at_start[j]))
        axes.append(axis)
    index = list(itertools.product(*(range(len(axis)) for axis in axes)))
    grid = np.array([[axis[i] for axis, i in zip(axes, point, strict=True)] for point in index])
    number = {point: n for n, point in enumerate(index)}
    neighbours = []
    for point in index:
        near = [
            number[(*point[:j], point[j] + step, *point[j + 1 :])]
            for j in range(len(axes))
            for step in (-1, 1)
            if 0 <= point[j] + step < len(axes[j])
        ]
        neighbours.append(near)
    return grid, neighbours


def _table(arm: OnShared, poses: Array, grid: Array, neighbours: list[list[int]], near: Array | None) -> _Tables:
    """Scores of an arm's branches over the samples of the path and the grid."""
    kin, K, H = arm.alone, len(poses), len(grid)
    seen = np.array([arm.seen(np.tile(s, (K, 1)), poses) for s in grid])  # (H, K, 4, 4)
    classes: list[Array] = []
    starts: list[Array] = []
    seeds = [near[None]] if near is not None else []
    order = np.argsort(np.abs(np.arange(H) - 0.5 * (H - 1)), kind="stable")
    for h in order.tolist():
        if near is None:
            found = find_branches(kin, pin.SE3(seen[h, 0]), quick=kin.n > 6)
            rows = found.q[found.margins.min(axis=1, initial=np.inf) >= -AT_LIMIT]
            if kin.n > 6:
                rows = _relaxed(kin, seen[h, 0], rows[: 3 * _MOST_BRANCHES])
        else:
            answer = kin.solve(seen[h, 0][None], seeds[0])
            rows = answer.q[answer.reached]
        for row in rows[:_MOST_BRANCHES]:
            if len(classes) >= 2 * _MOST_BRANCHES:
                break
            known = [q[h, 0] for q in classes if np.isfinite(q[h, 0]).all()]
            if known and kin.same(np.array(known), row, within=0.05 if kin.n <= 6 else 0.5).any():
                continue
            q = _flooded(kin, seen, neighbours, h, row)
            classes.append(q)
            starts.append(q[:, 0])
        if near is not None and classes:
            break
    if not classes:
        return _Tables(np.empty((0, K, H)), np.empty((0, H, kin.n)))
    scores = np.array([_scores(kin, q).T for q in classes])
    return _Tables(scores, np.array(starts))


def _relaxed(kin: ArmKinematics, T: Array, q: Array) -> Array:
    """Configurations of a redundant arm led away from its limits, the best first."""
    for length in _RELAXED if len(q) else ():
        q = away_from_limits(kin, T, q, length)
    return q[np.argsort(-kin.margins(q).min(axis=1), kind="stable")] if len(q) else q


def _flooded(kin: ArmKinematics, seen: Array, neighbours: list[list[int]], h: int, start: Array) -> Array:
    """Positions (H, K, n) of one branch, from where it starts, over all of the table that it reaches; NaN elsewhere."""
    H, K = seen.shape[:2]
    q = np.full((H, K, kin.n), np.nan)
    q[h, 0] = start

    def solve(to: list[tuple[int, int]], since: list[tuple[int, int]]) -> list[tuple[int, int]]:
        if not to:
            return []
        a, b = np.array(to), np.array(since)
        seeds = q[b[:, 0], b[:, 1]]
        answer = kin.solve(seen[a[:, 0], a[:, 1]], seeds, steps=_STEPS, longest=_STEP)
        good = answer.reached & (np.abs(answer.q - seeds).max(axis=1) <= _STEP) & (answer.sigma_min > 1e-3)
        rows, poses = answer.q[good], seen[a[good, 0], a[good, 1]]
        if kin.n > 6 and len(rows):
            close = kin.margins(rows).min(axis=1) < _CLOSE
            for length in _LEADS if close.any() else ():
                rows[close] = away_from_limits(kin, poses[close], rows[close], length)
        q[a[good, 0], a[good, 1]] = rows
        return [cell for cell, fine in zip(to, good.tolist(), strict=True) if fine]

    tried: set[tuple[tuple[int, int], tuple[int, int]]] = set()
    front = [(h, 0)]
    while front:
        to: dict[tuple[int, int], tuple[int, int]] = {}
        for cell in front:
            i, k = cell
            for other in [(n, k) for n in neighbours[i]] + [(i, m) for m in (k - 1, k + 1) if 0 <= m < K]:
                if np.isfinite(q[other]).all() or (cell, other) in tried or other in to:
                    continue
                tried.add((cell, other))
                to[other] = cell
        front = solve(list(to), list(to.values()))
    return q


def _scores(kin: ArmKinematics, q: Array) -> Array:
    """Scores (H, K) of positions (H, K, n), as in :mod:`coopqp.planning.arm_starts`; −inf where there are none."""
    there = np.isfinite(q).all(axis=-1)
    scores = np.full(q.shape[:2], -np.inf)
    rows = q[there]
    if len(rows):
        half = np.where(kin.bounded, 0.5 * (kin.upper - kin.lower), np.inf)
        share = (kin.margins(rows) / np.minimum(half, np.pi))[:, np.isfinite(half)].min(axis=1, initial=1.0)
        scores[there] = np.minimum(share / GOOD_MARGIN, kin.singular_values(rows)[:, -1] / GOOD_SIGMA)
    return scores


#: Time beyond that of the path [s], least score, places (W,), and numbers in the grid there (W,).
_Answer = tuple[float, float, Array, Indices]


class _Search:
    """Ways through a table of scores (K, H)."""

    def __init__(
        self, places: Array, duration: Array, grid: Array, neighbours: list[list[int]], speed: Array,
        at_start: Array | None,
    ) -> None:  # fmt: skip
        self._places, self._duration, self._grid = places, duration, grid
        H = len(grid)
        span = np.max(np.ptp(grid, axis=0)) or 1.0
        far = np.abs(grid[:, None] - grid[None])
        self._needs = (far / np.where(np.isfinite(speed), speed, span)).max(axis=2)  # [s] (H, H)
        self._beside = np.eye(H, dtype=bool)
        for i, near in enumerate(neighbours):
            self._beside[i, near] = True
        self._first = np.ones(H, dtype=bool) if at_start is None else (grid == at_start).all(axis=1)
        #: Samples at the ends of segments.
        whole = np.abs(places - np.round(places)) < 1e-9
        self._marks = np.unique(np.r_[0, np.flatnonzero(whole), len(places) - 1])

    def constant(self, S: Array) -> _Answer | None:
        """The shared joints stand where the least score is largest."""
        least = np.where(self._first, S.min(axis=0), -np.inf)
        h = int(least.argmax())
        if not least[h] >= _WANTED[0]:
            return None
        ends = np.array([0, len(S) - 1]) if len(S) > 1 else np.array([0])
        return 0.0, float(least[h]), self._places[ends], np.full(len(ends), h)

    def as_far(self, S: Array) -> _Answer | None:
        """They stand where the arms get furthest, if not to the end."""
        out = (S < 0.0) | ~self._first
        far = np.where(out.any(axis=0), out.argmax(axis=0), len(S))
        h = int(far.argmax())
        if far[h] == 0:
            return None
        ends = np.array([0, len(S) - 1]) if len(S) > 1 else np.array([0])
        return float(len(S) - far[h]), -np.inf, self._places[ends], np.full(len(ends), h)

    def by_segment(self, S: Array) -> _Answer | None:
        """They move linearly along each segment."""
        if len(S) < 2:
            return None
        values, times = [], []
        for a, b in itertools.pairwise(self._marks.tolist()):
            share = (self._places[a : b + 1] - self._places[a]) / (self._places[b] - self._places[a])
            values.append(self._along(S[a : b + 1], share))
            times.append(np.maximum(_PEAK * self._needs - float(self._duration[a:b].sum()), 0.0))
        return self._best(self._marks, values, times)

    def by_sample(self, S: Array) -> _Answer | None:
        """They move linearly from sample to sample."""
        if len(S) < 2:
            return None
        values = [np.where(self._beside, np.minimum(a[:, None], b[None]), -np.inf) for a, b in itertools.pairwise(S)]
        times = [np.maximum(self._needs - d, 0.0) for d in self._duration.tolist()]
        return self._best(np.arange(len(S)), values, times)

    def _along(self, S: Array, share: Array) -> Array:
        """Least score of linear motions between any two points of the grid (H, H)."""
        H = len(self._grid)
        size = np.where(np.ptp(self._grid, axis=0) > 0.0, np.ptp(self._grid, axis=0), 1.0)
        least = np.full((H, H), np.inf)
        for x, row in zip(share.tolist(), S, strict=True):
            at = (1.0 - x) * self._grid[:, None] + x * self._grid[None]
            away = (np.abs(at[:, :, None] - self._grid) / size).max(axis=3)
            least = np.minimum(least, row[away.argmin(axis=2)])
        return least

    def _best(self, marks: Indices, values: Sequence[Array], times: Sequence[Array]) -> _Answer | None:
        """The way with the least time, or where that is none the least motion; of those with the largest score."""
        for wanted in _WANTED:
            quickest = self._way(values, times, wanted)
            if quickest is None:
                continue
            best = quickest
            levels = np.unique(np.concatenate([v[np.isfinite(v) & (v >= wanted)] for v in values]))
            low, high = 0, len(levels) - 1
            while low <= high:
                middle = (low + high) // 2
                found = self._way(values, times, float(levels[middle]))
                if found is not None and found[0] <= quickest[0] * 1.01 + 1e-9:
                    best, low = found, middle + 1
                else:
                    high = middle - 1
            time, which = best
            score = min(float(v[a, b]) for v, a, b in zip(values, which, which[1:], strict=False))
            return time, score, self._places[marks], which
        return None

    def _way(self, values: Sequence[Array], times: Sequence[Array], wanted: float) -> tuple[float, Indices] | None:
        """The quickest way whose score is nowhere below the wanted one; of equal ones the one that moves least."""
        cost = np.where(self._first, 0.0, np.inf)
        before = []
        for value, time in zip(values, times, strict=True):
            total = cost[:, None] + np.where(value >= wanted, time + 1e-6 * self._needs, np.inf)
            before.append(total.argmin(axis=0))
            cost = total.min(axis=0)
        h = int(cost.argmin())
        if not np.isfinite(cost[h]):
            return None
        which = [h]
        for rows in reversed(before):
            which.append(int(rows[which[-1]]))
        return float(cost.min()), np.array(which[::-1])


def places_of(samples: PathSamples, segments: Segments | None) -> Array:
    """Places of samples of a path (K,), of those between the ends of its segments nearly."""
    if segments is None:
        return samples.clocks
    share = np.linspace(0.0, 1.0, 257)
    every = np.arange(len(segments))
    dense = [segments.clocks(np.full(len(share), s), share) for s in every]
    places = np.interp(samples.clocks, np.concatenate(dense), np.concatenate([s + share for s in every]))
    whole = np.round(places)
    return np.where(np.abs(places - whole) < 1e-6, whole, places)


def few_samples(samples: PathSamples, segments: Segments | None, *, most: int = MOST_SAMPLES) -> tuple[Indices, Array]:
    """Numbers of ``most`` samples of a path and of its corners, and the places of these (K,)."""
    clocks, places = samples.clocks, places_of(samples, segments)
    chosen = np.unique(np.linspace(0, len(clocks) - 1, min(most, len(clocks))).astype(np.intp))
    if segments is not None:
        chosen = np.union1d(chosen, np.flatnonzero(places == np.round(places)))
    chosen = chosen[np.r_[True, np.diff(places[chosen]) > 0.0]]
    return chosen, places[chosen]
