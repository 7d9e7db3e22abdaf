"""A proof for intervals of a path: along each of them the arm moves inside a known tube.

With A the Jacobian of the object's origin on the tool in world axes, the joints follow ``A(q) q' = ν``. At the middle
of an interval of half-width h stand q, ``Y = A⁻¹`` and ``v = Y ν``. If r is such that ``E (|v| + r) + D ≤ r``, where E
bounds the entries of ``|Y A(q + δ) − I|`` over all ``δ = t y``, ``|t| ≤ h``, ``|y − v| ≤ r``, and D those of
``|Y (ν(t) − ν)|``, then ``|q' − v| ≤ r`` on the whole interval: ``q' = Y ν(t) − (Y A − I) q'`` and the spectral radius
of E is below 1, so the joints cannot leave this tube. E comes from the first derivatives of A, which are Lie brackets
of its columns, and from a bound of the second ones. On a straight segment ν is constant; else ``D = h |Y ν'| + ½ h²
(|Y_lin| ‖p‴‖ + |Y_ang| ‖ω″‖)``, with norms of the rows of Y and bounds over the interval
(:meth:`coopqp.paths.geometry.Piece.bounds`). A redundant arm gets one more row for each further joint: a combination of
joints that moves at a constant rate along the interval. The first of these are the joints that it shares with other
arms, one by one, so that all of them prove the same motion of these joints.

Source: the tube argument is that of interval methods for differential equations (Moore, Kearfott, Cloud: Introduction
to Interval Analysis, 2009), with real bounds in place of interval arithmetic. It is a proof up to rounding.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import AT_LIMIT
from coopqp.paths.segments import Indices, Segments
from coopqp.spatial import Array, Flags, cross

#: Rounds of the search for r, growth of r in each, and floor of |v| as a share of its largest entry.
_ROUNDS, _GROWTH, _FLOOR = 6, 1.1, 1e-3
#: Solutions reach their poses within this [m, rad], and more by this share of the distance from the world's origin.
_EXACT, _EXACT_SHARE = 1e-11, 1e-14
#: Ends of intervals lie in the tube within this [rad or m].
_INSIDE = 1e-8


class PathVerdict(enum.Enum):
    """Verdict of :func:`coopqp.check_path`, the best first."""

    CERTIFIED = "CERTIFIED"  #: proved at every point of the path
    SAMPLED = "SAMPLED"  #: followed at samples; nothing is proved between them
    UNDECIDED = "UNDECIDED"  #: not proved on some intervals
    INFEASIBLE = "INFEASIBLE"  #: an arm cannot follow the path


def worst(verdicts: list[PathVerdict]) -> PathVerdict:
    """The worst verdict."""
    return max(verdicts, key=list(PathVerdict).index)


def follows(verdict: PathVerdict) -> bool:
    """True for the verdicts on a path that is followed, with a proof or at samples."""
    return verdict in (PathVerdict.CERTIFIED, PathVerdict.SAMPLED)


@dataclass(frozen=True, eq=False)
class Tubes:
    """Proved properties of M intervals.

    Attributes:
        q: joint positions in the middle (M, n) [rad or m].
        between: q reaches its pose, and lies between the ends or near them (M,).
        good: the tube holds, so q is on the branch of the ends (M,).
        sway: the joints leave the straight line between an end and the middle by at most this (M, n) [rad or m]; 0
            for joints that move one way only, whose extremes are at the ends.
        rate: largest speed of each joint (M, n) per share of the segment; infinite where nothing is proved.
        sigma_min: lower bound of the tool Jacobian's smallest singular value (M,).
        sigma_middle: its value in the middle (M,).
    """

    q: Array
    between: Flags
    good: Flags
    sway: Array
    rate: Array
    sigma_min: Array
    sigma_middle: Array


def tubes(
    kinematics: ArmKinematics, segments: Segments, offset: Array, segment: Indices, a: Array, b: Array, qa: Array,
    qb: Array,
) -> Tubes:  # fmt: skip
    """Prove tubes for intervals of a path, where possible.

    Args:
        kinematics: the arm, of six joints or more.
        segments: the path.
        offset: T_object_tool (4, 4).
        segment: segment of each interval (M,).
        a, b: shares of the segment at its ends (M,).
        qa, qb: joint positions at its ends (M, n) [rad or m].
    """
    n, half = kinematics.n, 0.5 * (b - a)
    has_length = half > 0.0  # else it is a jump
    half = np.where(has_length, half, 1.0)
    T_world_object = segments.poses(segment, 0.5 * (a + b))
    q, rows, solved = between(kinematics, T_world_object @ offset, qa, qb, np.full(len(qa), 0.5))
    arm = T_world_object[:, :3, :3] @ offset[:3, 3]  # from the object's origin to the tool
    J = kinematics.jacobians(q).transpose(0, 2, 1)  # (M, n, 6)
    A = J.copy()
    A[:, :, :3] += cross(arm[:, None], J[:, :, 3:])
    system = np.concatenate([A.transpose(0, 2, 1), rows], axis=1)
    twists, changes = segments.twists(segment, 0.5 * (a + b))
    nu = np.concatenate([twists, (rows @ (qb - qa)[:, :, None])[:, :, 0] / (2.0 * half)[:, None]], 1)
    Y, regular = _inverses(system)
    v = (Y @ nu[:, :, None])[:, :, 0]
    Y = np.ascontiguousarray(Y[:, :, :6])

    H = _derivatives(A)  # (M, j, i, 6): derivative of column i by joint j
    brackets = (H.reshape(len(q), n * n, 6) @ Y.transpose(0, 2, 1)).reshape(-1, n, n, n)  # (M, j, i, k)
    signed = np.einsum("mjik,mj->mki", brackets, v)
    turning = (Y @ changes[:, :, None])[:, :, 0]  # Y ν'
    bend, D = np.abs((signed @ v[:, :, None])[:, :, 0] - turning), np.abs(signed)
    G: Array = np.abs(brackets).transpose(0, 1, 3, 2).reshape(len(q), n, n * n)
    linear, angular = np.linalg.norm(Y[:, :, :3], axis=2), np.linalg.norm(Y[:, :, 3:], axis=2)
    turns = np.linalg.norm(A[:, :, 3:], axis=2)  # 1, or 0 for joints that slide
    levers = np.linalg.norm(A[:, :, :3], axis=2)
    speed = np.abs(v) + _FLOOR * np.abs(v).max(axis=1, keepdims=True)

    h = half[:, None]
    motion = segments.bounds(segment, a, b)
    bent = h * (linear * motion.way_change[:, None] + angular * motion.turn_change[:, None])
    drifts = h * (np.abs(turning) + 0.5 * bent)  # bound of |Y (ν(t) − ν)|
    r = np.zeros_like(v)
    good = np.zeros(len(q), dtype=bool)
    for _ in range(_ROUNDS):
        z = speed + r
        E = half[:, None, None] * (D + (r[:, None, :] @ G).reshape(-1, n, n))
        reach, swung, total = _reaches(levers, turns, h * z)
        E += linear[:, :, None] * (0.5 * total * total * reach)[:, None]
        E += angular[:, :, None] * (0.5 * swung * swung)[:, None]
        need = (E @ z[:, :, None])[:, :, 0] + drifts
        good = (need <= r).all(axis=1)
        if good.all():
            break
        with np.errstate(all="ignore"):
            r = np.where(good[:, None], r, np.minimum(_GROWTH * need, 1e3 * speed))
    good &= has_length & solved & regular & np.isfinite(r).all(axis=1)
    for end, sign in ((qa, -1.0), (qb, 1.0)):  # the ends belong to the same branch
        good &= (np.abs(end - q - sign * h * v) <= h * r + _INSIDE).all(axis=1)
    E, r = np.where(good[:, None, None], E, 0.0), np.where(good[:, None], r, 0.0)

    sway = _sway(bend + bent, D, G, E, r, speed + r, reach, total, linear, angular, half)
    sway[np.abs(v) >= r] = 0.0
    sigma = kinematics.singular_values(q)[:, -1]
    # The tool's lever turns with the object: on a straight segment about a fixed axis.
    lever = np.linalg.norm(cross(twists[:, 3:], arm), axis=1)
    straight = (motion.turn_change == 0.0) & (changes[:, 3:] == 0.0).all(axis=1)
    drift = half * np.where(straight, lever, motion.turn * np.linalg.norm(arm, axis=1))
    size = np.sqrt(E.sum(axis=1).max(axis=1) * E.sum(axis=2).max(axis=1))  # ‖E‖₂ ≤ √(‖E‖₁ ‖E‖∞)
    bound = sigma * np.maximum(1.0 - size, 0.0) * np.maximum(1.0 - drift, 0.0)
    away = np.abs(q - 0.5 * (qa + qb)).max(axis=1)
    near = solved & (away <= np.abs(qb - qa).max(axis=1) + _INSIDE)
    rate = np.where(good[:, None], np.abs(v) + r, np.inf)
    return Tubes(q, near, good, sway, rate, np.where(good, bound, 0.0), sigma)


def exactness(poses: Array) -> float:
    """How closely tools reach their poses (M, 4, 4) in a proof [m, rad]."""
    return _EXACT + _EXACT_SHARE * float(np.abs(poses[:, :3, 3]).max(initial=0.0))


def between(
    kinematics: ArmKinematics, poses: Array, qa: Array, qb: Array, share: Array, *, given: Array | None = None
) -> tuple[Array, Array, Flags]:
    """Configurations that reach poses between two ends, the further rows of a redundant arm, and flags.

    Args:
        kinematics: the arm.
        poses: T_world_tool (M, 4, 4).
        qa, qb: joint positions at the ends (M, n) [rad or m].
        share: where the poses are between the ends (M,), 0 to 1.
        given: positions of the joints that other arms share (M, S); by default those between the ends.
    """
    n, exact, x = kinematics.n, exactness(poses), share[:, None]
    guess = (1.0 - x) * qa + x * qb
    shared = kinematics.shared
    if given is not None:
        guess[:, shared] = given
    if n <= 6:
        answer = kinematics.solve(poses, guess, tolerance=exact, steps=8)
        return answer.q, np.empty((len(guess), 0, 6)), answer.residual <= exact
    rows = _further_rows(kinematics.jacobians(0.5 * (qa + qb)), shared)
    q, solved = guess.copy(), np.zeros(len(guess), dtype=bool)
    for _ in range(8):
        J, T = kinematics.jacobians(q), kinematics.tool_poses(q)
        error = np.concatenate([poses[:, :3, 3] - T[:, :3, 3], _small_turns(poses[:, :3, :3], T[:, :3, :3])], axis=1)
        solved = np.abs(error).max(axis=1) <= exact
        if solved.all():
            break
        wanted = np.concatenate([error, (rows @ (guess - q)[:, :, None])[:, :, 0]], axis=1)
        inverse, regular = _inverses(np.concatenate([J, rows], axis=1))
        step = (inverse @ wanted[:, :, None])[:, :, 0]
        q = q + np.where(regular[:, None] & np.isfinite(step), np.clip(step, -1.0, 1.0), 0.0)
        q[:, shared] = guess[:, shared]  # to the last bit, as for the other arms that share them
    return q, rows, solved


def _further_rows(J: Array, shared: Indices) -> Array:
    """Rows (M, n − 6, n) that make Jacobians (M, 6, n) square: of joints that arms share, then of the null-space."""
    if not len(shared):
        return np.linalg.svd(J)[2][:, 6:]
    given = np.zeros((len(J), len(shared), J.shape[2]))
    given[:, np.arange(len(shared)), shared] = 1.0
    rest = np.linalg.svd(np.concatenate([J, given], axis=1))[2][:, 6 + len(shared) :]
    return np.concatenate([given, rest], axis=1)


def _small_turns(R: Array, S: Array) -> Array:
    """Axis times the sine of the angle of ``R Sᵀ`` in world axes (M, 3): zero where both are the same."""
    D = R @ S.transpose(0, 2, 1)
    return 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1)


def _inverses(systems: Array) -> tuple[Array, Flags]:
    """Inverses, 0 for singular matrices, and True for regular ones."""
    try:
        inverse = np.linalg.inv(systems)
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(systems)
        regular = np.linalg.matrix_rank(systems) == systems.shape[1]
    else:
        regular = np.isfinite(inverse).all(axis=(1, 2))
    return np.where(regular[:, None, None], inverse, 0.0), regular


def _derivatives(A: Array) -> Array:
    """Derivative of each column i of A by each joint j, (M, j, i, 6): Lie brackets of the columns (M, n, 6)."""
    n = A.shape[1]
    first, last = np.minimum.outer(np.arange(n), np.arange(n)), np.maximum.outer(np.arange(n), np.arange(n))
    linear, angular = A[:, :, :3], A[:, :, 3:]
    H = np.empty((len(A), n, n, 6))
    H[:, :, :, :3] = cross(angular[:, first], linear[:, last])
    H[:, :, :, 3:] = cross(angular[:, :, None], angular[:, None])
    H[:, :, :, 3:] *= (np.arange(n)[:, None] < np.arange(n))[:, :, None]
    return H


def _reaches(levers: Array, turns: Array, moved: Array) -> tuple[Array, Array, Array]:
    """Over joint motions up to ``moved`` (M, n): bounds for the second derivatives of the columns.

    Returns:
        For the linear part of each column the largest lever of the joints from it on (M, n), for its angular part the
        sum of the motions of the joints before it (M, n), and the sum of all motions (M, 1).
    """
    total = moved.sum(axis=1, keepdims=True)
    reach = np.empty_like(levers)
    behind = np.zeros(len(levers))
    largest = np.zeros(len(levers))
    for j in reversed(range(levers.shape[1])):
        lever = np.where(turns[:, j] > 0.5, levers[:, j] + behind, 1.0)
        behind = behind + moved[:, j] * lever
        largest = np.maximum(largest, lever)
        reach[:, j] = largest
    swung = np.cumsum(moved * turns, axis=1) - moved * turns
    return reach, swung * turns, total


def _sway(
    bend: Array, D: Array, G: Array, E: Array, r: Array, z: Array, reach: Array, total: Array, linear: Array,
    angular: Array, half: Array,
) -> Array:  # fmt: skip
    """Largest distance from the chords of both halves: h²/8 times a bound of |q''| = |A⁻¹ (ν' − (Σ_j ∂_jA q'_j) q')|.

    ``bend`` is |Y (ν' − (Σ_j ∂_jA v_j) v)| in the middle, and by how much Y ν' changes.
    """
    n = z.shape[1]
    changed = bend + (D @ r[:, :, None])[:, :, 0]
    changed += ((r[:, None, :] @ G).reshape(-1, n, n) @ z[:, :, None])[:, :, 0]
    rate = z.sum(axis=1, keepdims=True)
    changed += linear * (total * rate * (reach * z).sum(axis=1, keepdims=True))
    changed += angular * (total * rate * rate)
    bound = np.linalg.solve(np.eye(n) - E, changed[:, :, None])[:, :, 0]
    return np.maximum(bound, 0.0) * (half * half)[:, None] / 8.0


#: A proof needs this much of σ_min, so a wrist that is passed at a milliradian is never certified.
LEAST_SIGMA = 2e-3
#: A bound of a margin is looser than this only where another interval has a smaller margin [rad or m].
_LOOSE = 2e-3
#: Knots at one place of the path are the same up to this [rad or m].
_SAME_KNOT = 1e-9
#: The bound of σ_min is at least this share of the smallest value found.
_SIGMA_SHARE = 0.6
#: Most halvings of an interval, and most intervals of each way.
_HALVINGS, _MOST = 24, 4000
#: Halvings of intervals with less than the least σ_min, to locate the ends of such a region.
_SINGULAR_HALVINGS = 9


@dataclass(frozen=True, eq=False)
class Proof:
    """Proved properties of one way of an arm along a path.

    Attributes:
        segment, low, high: segment, and the shares at both ends, of the last intervals, in their order (I,).
        proved: True where the joints are proved to follow the path inside the limits (I,).
        margins: lower bound of each joint's margin in each interval (I, n) [rad or m]; valid where proved.
        sigma_min: lower bound of σ_min in each interval (I,); 0 where nothing is proved.
        q: joint positions in the middle of each interval (I, n) [rad or m].
        q_low, q_high: the same at its ends.
        rate: largest speed of each joint in each interval (I, n) per share; infinite where it is not on its branch.
        between, on_branch: True where they are between the ends, and proved to be on their branch (I,).
        outside: segment and share at which a joint is outside its limits; None if none was found.
    """

    segment: Indices
    low: Array
    high: Array
    proved: Flags
    margins: Array
    sigma_min: Array
    q: Array
    q_low: Array
    q_high: Array
    rate: Array
    between: Flags
    on_branch: Flags
    outside: tuple[int, float] | None


def prove(
    kinematics: ArmKinematics, segments: Segments, offset: Array, segment: Indices, share: Array, q: Array
) -> Proof:
    """Prove that an arm follows a path on its way through given configurations, inside its limits.

    Args:
        kinematics: the arm, of six joints or more.
        segments: the path.
        offset: T_object_tool (4, 4).
        segment, share: the knots: ends of the first intervals; the first is the start of a segment (K,).
        q: joint positions at the knots (K, n) [rad or m].
    """
    low = np.where(segment[1:] == segment[:-1], share[:-1], 0.0)
    s, high, qa, qb = segment[1:], share[1:], q[:-1], q[1:]
    moves = (high > low) | (np.abs(qb - qa) > _SAME_KNOT).any(axis=1)  # a knot that repeats the one before says nothing
    s, low, high, qa, qb = s[moves], low[moves], high[moves], qa[moves], qb[moves]
    least = kinematics.margins(q).min(axis=0)
    parts: list[tuple[npt.NDArray[Any], ...]] = []
    outside: tuple[int, float] | None = None
    looked_at, smallest = 0, np.inf
    for halving in range(_HALVINGS + 1):
        tube = tubes(kinematics, segments, offset, s, low, high, qa, qb)
        looked_at += len(s)
        middle = kinematics.margins(tube.q)
        ends = np.minimum(np.minimum(kinematics.margins(qa), kinematics.margins(qb)), middle)
        if tube.good.any():
            least = np.minimum(least, middle[tube.good].min(axis=0))
            beyond = np.where(tube.good[:, None], middle, np.inf)
            if beyond.min() < -AT_LIMIT:
                i = int(beyond.min(axis=1).argmin())
                outside = int(s[i]), float(0.5 * (low[i] + high[i]))
            smallest = min(smallest, float(tube.sigma_middle[tube.good].min()))
        margins = ends - tube.sway
        inside = tube.good & (margins >= -AT_LIMIT).all(axis=1) & (tube.sigma_min >= LEAST_SIGMA)
        loose = ((tube.sway > _LOOSE) & (margins < least - _LOOSE)).any(axis=1)
        loose |= tube.sigma_min < _SIGMA_SHARE * smallest
        weak = np.where(tube.good, tube.sigma_min, tube.sigma_middle) < LEAST_SIGMA
        hopeless = weak & (halving >= _SINGULAR_HALVINGS)
        hopeless |= (halving == _HALVINGS) | (looked_at > _MOST)
        if outside is not None:  # open question: does the branch still belong to the start?
            hopeless |= tube.good
        split = (~inside | loose) & ~hopeless
        done = ~split
        kept = s, low, high, inside, margins, tube.sigma_min, tube.q, qa, qb, tube.rate, tube.between, tube.good
        parts.append(tuple(values[done] for values in kept))
        if not split.any():
            break
        mid, qm = 0.5 * (low[split] + high[split]), tube.q[split]
        low, high = np.concatenate([low[split], mid]), np.concatenate([mid, high[split]])
        qa, qb = np.concatenate([qa[split], qm]), np.concatenate([qm, qb[split]])
        s = np.concatenate([s[split], s[split]])
    every = [np.concatenate(values) for values in zip(*parts, strict=True)]
    order = np.lexsort((every[1], every[0]))
    segment, low, high, inside, margins, sigma, middle, qa, qb, rate, near, good = (values[order] for values in every)
    return Proof(segment, low, high, inside, margins, sigma, middle, qa, qb, rate, near, good, outside)
