"""The branches of one arm along a whole path: which stay inside the limits, with what margin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.constraints.samples import PathSamples
from coopqp.model.batch import ArmKinematics, Walks
from coopqp.model.branches import AT_LIMIT, Branches, amount, find_branches
from coopqp.planning.on_shared import OnShared
from coopqp.shown import Brief
from coopqp.spatial import Array

#: Good margin, as a share of a joint's half range, and good σ_min: the units of a branch's score.
GOOD_MARGIN, GOOD_SIGMA = 1.0 / 3.0, 0.2
#: Below this σ_min a branch counts as singular: no arm follows a path there.
_SINGULAR = 1e-3
#: Steps that lead redundant arms away from their limits: number, length of the first and of the last [rad or m].
_RELAXATIONS, _FIRST_STEP, _LAST_STEP = 16, 0.3, 0.02
#: Largest number of a redundant arm's configurations that are walked.
_MOST_WALKS = 192
#: Configurations of a redundant arm that are closer to each other count as one [rad or m].
_SAME = 1e-3
#: An arm with fewer than six joints cannot make a motion if it misses more than this share of it.
_LEFT_OUT = 1e-2
#: Largest number of branches outside the limits that are kept; they are not walked.
_MOST_OUTSIDE = 64


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BranchAlongPath(Brief):
    """One branch of an arm at the path's start, and its way along the path.

    Attributes:
        roll: turn of the tool about its own z axis [rad].
        q: joint positions at the start (n,) [rad or m], at the whole turns with the largest margins.
        hits: seeds that ended in this branch.
        reached: last clock [s] that is reached without a singularity.
        complete: the whole path is reached.
        margins: least margin of each joint along the way (n,) [rad or m]; negative outside, inf without limits.
        clocks: clock at which each joint has its least margin (n,) [s].
        sigma_min: smallest singular value of the tool's Jacobian at each sample of the path (K,).
        score: the smaller of margin and σ_min, each divided by a good value; the best branch has the largest.
        end: why the way ends before the path does; empty if it does not.
    """

    roll: float
    q: Array
    hits: int
    reached: float
    complete: bool
    margins: Array
    clocks: Array
    sigma_min: Array
    score: float
    end: str = ""

    @property
    def inside(self) -> bool:
        """All joints stay inside their limits as far as the path is reached."""
        return bool(self.margins.min(initial=np.inf) >= -AT_LIMIT)

    @property
    def feasible(self) -> bool:
        """The arm follows the whole path inside its limits and away from singularities."""
        return self.complete and self.inside and bool(self.sigma_min.min() >= _SINGULAR)

    @property
    def tightest(self) -> int:
        """Index of the joint with the least margin."""
        return int(self.margins.argmin())


@dataclass(frozen=True, eq=False)
class ArmOnPath:
    """All branches of one arm on a path, the best first.

    Attributes:
        kinematics: the arm.
        branches: the branches.
        closest: smallest residual at the start [m, rad]: the remaining error where there is no branch.
    """

    kinematics: ArmKinematics
    branches: tuple[BranchAlongPath, ...]
    closest: float

    @property
    def feasible(self) -> tuple[BranchAlongPath, ...]:
        """The branches that the arm can take, the best first."""
        return tuple(b for b in self.branches if b.feasible)


def rolled(T: pin.SE3, angle: float) -> pin.SE3:
    """A pose turned about its own z axis by an angle [rad]."""
    return T * pin.SE3(pin.exp3(np.array([0.0, 0.0, angle])), np.zeros(3)) if angle else T


def arm_on_path(
    kinematics: ArmKinematics,
    samples: PathSamples,
    X: pin.SE3,
    *,
    near: Array,
    roll: float = 0.0,
    seed_factor: int = 1,
    quick: bool = False,
) -> ArmOnPath:
    """Find all branches at the start of a path and walk each along it.

    Args:
        kinematics: the arm.
        samples: the path.
        X: T_object_tool.
        near: further seeds (S, n) [rad or m].
        roll: turn of the tool about its own z axis [rad].
        seed_factor: multiplies the number of seeds.
        quick: a first look, with few seeds: branches may be missing.
    """
    poses = samples.tool_poses(rolled(X, roll))
    found = find_branches(kinematics, poses[0], seed_factor=seed_factor, near=near, quick=quick)
    q, hits = found.q, found.hits
    if kinematics.n > 6 and len(q):
        q, hits = _self_motions(kinematics, poses[0], found, _MOST_WALKS * seed_factor)
    inside = kinematics.margins(q).min(axis=1, initial=np.inf) >= -AT_LIMIT
    rows = []
    for group, along in ((np.flatnonzero(inside), poses), (np.flatnonzero(~inside)[:_MOST_OUTSIDE], poses[:1])):
        if len(group):
            walks = kinematics.walk(along, q[group])
            rows += [_row(kinematics, samples, along, walks, m, roll, int(hits[i])) for m, i in enumerate(group)]
    away = np.where(kinematics.bounded & kinematics.turns, 1.0, 0.0)
    # Mirrored branches differ by rounding only: the one nearer to the middle comes first.
    rows.sort(key=lambda row: (not row.feasible, -row.score, round(float(away @ np.abs(row.q - kinematics.middle)), 6)))
    return ArmOnPath(kinematics, tuple(rows), found.closest)


def arm_on_shared(arm: OnShared, samples: PathSamples, poses: Array, s: Array, starts: Array) -> ArmOnPath:
    """Branches of an arm whose shared joints are at ``s`` (K, S) at the samples, in the order of its starts (B, n).

    Args:
        arm: the arm.
        samples: the path.
        poses: T_world_tool at the samples (K, 4, 4).
        s: positions of the joints that its group shares (K, S).
        starts: positions of its own joints.
    """
    walks = arm.alone.walk(arm.seen(s, poses), starts)
    rows = []
    for m in range(len(starts)):
        q = arm.joined(s, walks.q[m])
        whole = Walks(q[None], walks.reached[m : m + 1], arm.whole.singular_values(q)[None, :, -1])
        rows.append(_row(arm.whole, samples, poses, whole, 0, 0.0, 1))
    return ArmOnPath(arm.whole, tuple(rows), 0.0)


def _row(
    kinematics: ArmKinematics, samples: PathSamples, poses: Array, walks: Walks, m: int, roll: float, hits: int
) -> BranchAlongPath:
    last = int(walks.reached[m])
    way = walks.q[m, : last + 1]
    low, high = way.min(axis=0), way.max(axis=0)
    # Whole turns with the most room for the whole way.
    turn = np.round((kinematics.middle - 0.5 * (low + high)) / (2.0 * np.pi))
    shift = np.where(kinematics.turns & kinematics.bounded, 2.0 * np.pi * turn, 0.0)
    margins = kinematics.margins(way + shift)
    sigma = walks.sigma_min[m, : last + 1]
    half = np.where(kinematics.bounded, 0.5 * (kinematics.upper - kinematics.lower), np.inf)
    finite = np.isfinite(half)
    share = (margins.min(axis=0)[finite] / np.minimum(half[finite], np.pi)).min(initial=1.0)
    return BranchAlongPath(
        roll=roll,
        q=way[0] + shift,
        hits=hits,
        reached=float(samples.clocks[last]),
        complete=last == len(samples.clocks) - 1,
        margins=margins.min(axis=0),
        clocks=samples.clocks[margins.argmin(axis=0)],
        sigma_min=np.concatenate([sigma, np.zeros(len(samples.clocks) - len(sigma))]),
        score=round(float(min(share / GOOD_MARGIN, sigma.min() / GOOD_SIGMA)), 9),
        end=why_it_ends(kinematics, way[-1], poses[last], poses[last + 1]) if last + 1 < len(poses) else "",
    )


def why_it_ends(kinematics: ArmKinematics, q: Array, T: Array, ahead: Array) -> str:
    """Why the way of an arm at ``q`` (n,), with its tool at T (4, 4), does not go on to the pose ahead."""
    if kinematics.n < 6:
        J = kinematics.jacobians(q[None])[0]
        motion = np.append(ahead[:3, 3] - T[:3, 3], pin.log3(ahead[:3, :3] @ T[:3, :3].T))
        left = motion - J @ np.linalg.lstsq(J, motion, rcond=None)[0]
        if np.linalg.norm(left) > _LEFT_OUT * np.linalg.norm(motion):
            return f"where it would need a motion that {kinematics.n} joints cannot make"
    return "where its reach ends or it is singular"


def _self_motions(
    kinematics: ArmKinematics, T: Array, found: Branches, most: int
) -> tuple[Array, npt.NDArray[np.intp]]:
    """Configurations of a redundant arm: those found, and the same led away from the limits along the self-motion."""
    q = found.q[: most // 2]
    relaxed = q.copy()
    for length in np.geomspace(_FIRST_STEP, _LAST_STEP, _RELAXATIONS):
        relaxed = away_from_limits(kinematics, T, relaxed, length)
    both, hits = np.vstack([q, relaxed]), np.tile(found.hits[: len(q)], 2)
    # Many end at the same configuration.
    kept = np.sort(np.unique(np.round(both / _SAME), axis=0, return_index=True)[1])
    return both[kept], hits[kept]


def away_from_limits(kinematics: ArmKinematics, T: Array, q: Array, length: float) -> Array:
    """Configurations of a redundant arm (M, n) a step further from the limits, at the same tool pose (4, 4).

    Args:
        kinematics: the arm.
        T: T_world_tool.
        q: joint positions (M, n) [rad or m] that reach it.
        length: largest motion of a joint [rad or m].
    """
    half = np.where(kinematics.bounded, 0.5 * (kinematics.upper - kinematics.lower), np.inf)
    J = kinematics.jacobians(q)
    g = -(((q - kinematics.middle) / half) ** 5) / half
    G = J @ J.transpose(0, 2, 1) + 1e-9 * np.eye(6)
    g -= (J.transpose(0, 2, 1) @ np.linalg.solve(G, J @ g[:, :, None]))[:, :, 0]
    largest = np.abs(g).max(axis=1, keepdims=True)
    step = np.where(largest > 1e-12, length * g / np.maximum(largest, 1e-12), 0.0)
    answer = kinematics.solve(T, q + step, steps=6)
    better = answer.reached & (answer.margins.min(axis=1) > kinematics.margins(q).min(axis=1))
    return np.where(better[:, None], answer.q, q)


def trouble(arm: ArmOnPath) -> str:
    """Why the arm has no start: a sentence for a message."""
    name = arm.kinematics.arm.name
    if not arm.branches:
        d = arm.closest
        return f"arm {name} does not reach its grasp at the start of the path ({d:.2g} m or rad remain)"

    def names(row: BranchAlongPath) -> tuple[str, str]:
        j = row.tightest
        return amount(-row.margins[j], slides=bool(arm.kinematics.slides[j])), arm.kinematics.joints[j]

    started = [row for row in arm.branches if row.margins.min() >= -AT_LIMIT or row.clocks[row.tightest] > 0.0]
    if not started:
        how_far, joint = names(max(arm.branches, key=lambda row: float(row.margins.min())))
        return f"arm {name} starts {how_far} outside {joint}"
    row = max(started, key=lambda row: (row.complete, float(min(row.margins.min(), 0.0)), row.reached))
    if not row.inside:
        how_far, joint = names(row)
        return f"arm {name} goes {how_far} outside {joint} at {row.clocks[row.tightest]:.2f} s of the path"
    if not row.complete:
        return f"arm {name} follows the path until {row.reached:.2f} s, {row.end}"
    return f"arm {name} is singular on the path (σ_min {row.sigma_min.min():.1g})"
