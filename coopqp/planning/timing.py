"""Timing before the motion: the fastest way along a path under the joints' limits, as a path of its own.

With the object's path given the joint trajectories are known (:mod:`coopqp.planning.knots`). What remains to be chosen
is the speed ṡ along them. In ``z = ṡ²`` and s̈ all limits are lines: ``q̇ = q′ ṡ``, ``q̈ = q′ s̈ + q″ z``,
``τ = a s̈ + b z + c``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coopqp.checks import ArrayLike, as_count, as_scalar, one_each, require
from coopqp.constraints.rate import BoundTrouble, Knot, RateBound, lines_of
from coopqp.errors import InvalidInputError, UnreachableError
from coopqp.model.branches import AT_LIMIT, amount
from coopqp.model.cell import RobotCell, slides
from coopqp.model.chain import moving_columns
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.state import CellState
from coopqp.paths.elbows import Elbows
from coopqp.paths.geometry import PathGeometry
from coopqp.paths.guarded import is_known
from coopqp.paths.moving_grasps import refuse_motion
from coopqp.paths.path import ObjectPath
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.jerk import jerk_limited, jerk_use, smoothed
from coopqp.planning.knots import Following, Knots, Lead
from coopqp.planning.parametrise import Limited, Lines, fastest, require_toppra
from coopqp.planning.payload import Payload, torque_lines
from coopqp.planning.sampled import sampled_geometry
from coopqp.spatial import Array

#: Planned share of the limits; the rest is for a controller's corrections.
SHARE = 0.98
#: Limits used by at least this share of the most used one count as used alike.
_EQUAL = 0.99
#: Largest excess of limits between knots, as a share; above it knots are added, in this many rounds at most.
_EXCESS, _ROUNDS = 2e-3, 6
#: Slack of a rate bound at rest, as a share of its coefficients, that counts as rounding.
_LEAST_SLACK = 1e-9
#: Knots of the elbows are left out where their motion is known this well without them [rad or m].
_KNOWN = 1e-8
#: Knots of a path, and least knots of a stretch between corners.
KNOTS, LEAST_KNOTS = 400, 60
JERK_KNOTS = 150


def time_path(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath | PathGeometry,
    *,
    q_start: ArrayLike,
    payload: Payload | None = None,
    bounds: Sequence[RateBound] = (),
    jerk: ArrayLike | None = None,
    share: float = SHARE,
    knots: int | None = None,
) -> TimedPath:
    """The fastest way along a path, from rest to rest, under the joints' velocity and acceleration limits.

    Only the geometry of ``path`` counts, not its time law. The object rests at its corners. Redundant arms
    are planned with their least motion, ``Σ (q̇_j / v_j)²``; the path has it as its ``elbows``, and a
    :class:`coopqp.QPController` leads them along it, without posture.

    Args:
        cell, grasp: the arms, and how they hold the object.
        path: the path. Your own path gives poses and twists; derivatives of its twists are differences.
        q_start: configuration (nq,) near the start of the path; it decides the branches.
        payload: with it the joints' torques stay within their limits, too; each arm carries an equal part.
        bounds: further rate bounds (:class:`coopqp.RateBound`), such as :class:`coopqp.forces.LoadBound`, which shares
            the payload among the arms. Not with ``jerk``.
        jerk: largest jerk of the joints, one number or one per joint (nv,) [rad/s³ or m/s³]: the change between mean
            accelerations of 10 ms, over 10 ms. The profile then comes from successive linear programs, see
            :mod:`coopqp.planning.jerk`; this takes a second.
        share: share of the limits that is used, in (0, 1].
        knots: number of knots; 400 by default, 150 with ``jerk``.

    Returns:
        The path; its profile names the limit that binds between knots.

    Raises:
        InvalidInputError: bad arguments, a path without geometry, or joints without acceleration limits.
        UnreachableError: an arm cannot follow the path, leaves its position limits, or cannot hold the payload.
        UndecidedError: the parametrisation fails numerically.
        MissingExtraError: toppra is missing: install coopqp[planning].
    """
    return timed_motion(
        cell, grasp, path, q_start=q_start, payload=payload, bounds=bounds, jerk=jerk, share=share, knots=knots
    ).path


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A timed path and the motion of the joints it was timed with.

    Attributes:
        path: the path.
        x: joint positions (K, nv) at the knots of its profile [rad or m].
        slopes: their derivatives there with respect to s (K, nv).
    """

    path: TimedPath
    x: Array
    slopes: Array


def timed_motion(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath | PathGeometry,
    *,
    q_start: ArrayLike,
    payload: Payload | None,
    bounds: Sequence[Any],
    jerk: ArrayLike | None,
    share: float,
    knots: int | None,
    lead: Lead | None = None,
) -> TimedMotion:
    """The path of :func:`time_path`, and its joint motion.

    With ``lead`` redundant arms go where it leads them, at each s of the whole path, in place of their least motion.
    """
    require_toppra()
    grasp.check_arms(cell)
    where = "time_path"
    if lead is None:  # nobody says where shared joints are
        cell.refuse_shared(where)
    share = as_scalar(share, f"{where}: share", high=1.0)
    count = as_count(knots if knots is not None else KNOTS if jerk is None else JERK_KNOTS, f"{where}: knots")
    jerks = None if jerk is None else _as_jerks(jerk, cell.nv, where)
    x = cell.positions(cell.check_configuration(q_start, f"{where}: q_start"))
    geometry = geometry_of(path, where)
    if jerk is not None and len(bounds):
        raise InvalidInputError("rate bounds beside jerk limits", where, "Give one of them.")
    if payload is not None:
        require(payload, Payload, f"{where}: payload", "Give a Payload.")
    _check_limits(cell, where)
    s, squares, binding, use = [np.zeros(1)], [np.zeros(1)], list[BindingLimit | None](), list[Array]()
    rows, slopes = list[Array](), list[Array]()
    mark, pace = 0.0, _pace(path, geometry)
    for stretch in geometry.stretches():
        own = max(LEAST_KNOTS, round(count * stretch.length / geometry.length))
        following = Following(cell, grasp, stretch, x, lead=None if lead is None else _beyond(lead, mark))
        own_s = following.spread(own, gather=jerks is not None)
        for _ in range(_ROUNDS):
            found = following.at(own_s)
            _check_positions(cell, path, found, mark)
            limited = limits_along(cell, grasp, found, payload=payload, share=share)
            further = further_lines(cell, bounds, found, share, mark=mark, pace=pace)
            limited = replace(limited, further=further)
            _check_weight(cell, limited, mark)
            z = fastest(limited)
            over = use_between(limited, z) > 1.0 + _EXCESS
            if not over.any():
                break
            own_s = np.sort(np.concatenate([own_s, (own_s[:-1] + 0.5 * np.diff(own_s))[over]]))
        if jerks is not None:
            own_s, z = smoothed(own_s, jerk_limited(limited, z, share * jerks))
            found = following.at(following.with_marks(own_s))
            z = np.interp(found.s, own_s, z)
            limited = limits_along(cell, grasp, found, payload=payload, share=share)
            z = kept_within(limited, z, share * jerks)
        names, shares = binding_limits(cell, limited, z, None if jerks is None else share * jerks, bounds)
        s.append(mark + found.s[1:])
        squares.append(z[1:])
        slopes.append(found.slope[1:] if rows else found.slope)
        rows.append(found.q[1:] if rows else found.q)
        binding += names
        use.append(shares)
        mark, x = mark + stretch.length, found.q[-1]
    profile = SpeedProfile(np.concatenate(s), np.concatenate(squares), tuple(binding), np.concatenate(use))
    q, q_slopes, elbows = np.vstack(rows), np.vstack(slopes), None
    if any(len(columns) > 6 for columns in moving_columns(cell)):
        elbows = motion_over_clock(profile, q, q_slopes)
    return TimedMotion(TimedPath(geometry, profile, planned_share=share, elbows=elbows), q, q_slopes)


def motion_over_clock(profile: SpeedProfile, x: Array, slopes: Array) -> Elbows:
    """The motion of the joints over the path's clock, with no more knots than it takes."""
    from scipy.interpolate import CubicHermiteSpline  # takes long to import

    clocks, speeds = profile.clocks, np.sqrt(profile.squares)
    speed = slopes * speeds[:, None]
    kept = speeds == 0.0
    while not kept.all():
        knots = np.flatnonzero(kept)
        known = CubicHermiteSpline(clocks[knots], x[knots], speed[knots])(clocks)
        wrong = np.flatnonzero(np.abs(known - x).max(axis=1) > _KNOWN)
        if not wrong.size:
            break
        gaps = np.unique(np.searchsorted(knots, wrong))
        kept[(knots[gaps - 1] + knots[gaps]) // 2] = True
    return Elbows(clocks[kept], x[kept], speed[kept])


def _beyond(lead: Lead, mark: float) -> Lead:
    """The lead by the s of a stretch that begins at a mark [m]."""
    return lambda s: lead(mark + s)


def _as_jerks(jerk: ArrayLike, nv: int, where: str) -> Array:
    """Limits of the jerk (nv,)."""
    remedy = f"Give one number, or {nv} [rad/s³ or m/s³]."
    given = one_each(jerk, nv, f"{where}: jerk", finite=False, remedy=remedy)
    if not (given > 0.0).all():
        raise InvalidInputError("entries ≤ 0", f"{where}: jerk", remedy)
    return given


def geometry_of(path: ObjectPath | PathGeometry, where: str) -> PathGeometry:
    """The geometry of a path.

    Raises:
        InvalidInputError: it has none.
    """
    if isinstance(path, PathGeometry):
        return path
    require(path, ObjectPath, f"{where}: path", "Give an ObjectPath.")
    refuse_motion(path, where, "Time a program with coopqp.planning.time_program.")
    geometry = None
    if path.known_ahead and np.isfinite(path.duration):
        geometry = path.geometry() if is_known(path) else path.geometry() or sampled_geometry(path)
    if geometry is None:
        raise InvalidInputError(
            f"a {type(path).__name__} has no geometry to be timed",
            where,
            "Give a path of lines: it has to move, and to end.",
        )
    return geometry


def use_between(limited: Limited, squares: Array) -> Array:
    """Share of the speeds and accelerations that is used between knots, by cubic interpolation of q′ (K − 1,)."""
    from scipy.interpolate import CubicHermiteSpline  # takes long to import

    knots, lines = limited.knots, limited.acceleration
    between, h = CubicHermiteSpline(knots.s, knots.slope, knots.curvature), np.diff(knots.s)
    slope = 0.5 * np.diff(squares)[:, None] / h[:, None]
    most = np.zeros(len(h))
    for x in (0.25, 0.5, 0.75):
        at = knots.s[:-1] + x * h
        z = squares[:-1, None] + 2.0 * x * h[:, None] * slope
        q1, q2 = between(at), between(at, 1)
        acceleration = np.abs(q1 * slope + q2 * z)[:, lines.owner] / lines.bound
        speed = np.abs(q1) * np.sqrt(z) / limited.speed
        most = np.maximum(most, np.maximum(speed.max(axis=1), acceleration.max(axis=1, initial=0.0)))
    return most


def limits_along(
    cell: RobotCell, grasp: Grasp, knots: Knots, *, payload: Payload | None = None, share: float = SHARE
) -> Limited:
    """Bounds of the speed along knots, as lines."""
    limits = cell.limits
    moving = np.abs(knots.slope).max(axis=0) > 0.0

    def lines(a: Array, b: Array, c: Array, bound: Array) -> Lines:
        own = np.flatnonzero(np.isfinite(bound) & moving)
        return Lines(a[:, own], b[:, own], c[:, own], share * bound[own], own)

    acceleration = lines(knots.slope, knots.curvature, np.zeros_like(knots.slope), limits.acceleration)
    torque = None if payload is None else lines(*torque_lines(cell, grasp, payload, knots), payload.limits(cell))
    return Limited(knots, share * limits.velocity, acceleration, torque)


def _pace(path: ObjectPath | PathGeometry, geometry: PathGeometry) -> float:
    """Time per length along a path that is run at constant speed in its own duration [s/m]; of a geometry 1 s/m."""
    return path.duration / geometry.length if isinstance(path, ObjectPath) and path.duration > 0.0 else 1.0


def further_lines(
    cell: RobotCell,
    bounds: Sequence[RateBound],
    knots: Knots,
    share: float,
    *,
    mark: float = 0.0,
    pace: float = 1.0,
) -> Lines | None:
    """Rate bounds at knots as lines ``a s̈ + b ṡ² ≤ 1``, one row of each knot padded with zeros; None without bounds.

    A bound is evaluated over the clock τ = P s of a run at constant speed: ``dq/dτ = q′/P``, ``σ = P ṡ``.

    Args:
        cell: the arms.
        bounds: the rate bounds.
        knots: where the bounds are evaluated, with derivatives with respect to s.
        share: share of the bounds that is used.
        mark: where the knots begin on the path [m].
        pace: P [s/m].

    Raises:
        UnreachableError: a bound does not allow the object to rest at a knot.
        InvalidInputError: a bound raises, or returns something else than lines.
    """
    if not len(bounds):
        return None
    found: list[tuple[Array, Array, Array]] = []
    spans = np.diff(knots.s, prepend=knots.s[0])
    for i, (s, span) in enumerate(zip(knots.s.tolist(), spans.tolist(), strict=True)):
        state = CellState(cell, cell.configuration(knots.q[i]))
        knot = Knot(pace * (mark + s), state, knots.slope[i] / pace, knots.curvature[i] / pace**2, pace * span)
        parts = []
        for number, bound in enumerate(bounds):
            try:
                a, b, c = lines_of(bound, knot)
            except BoundTrouble as trouble:
                raise InvalidInputError(
                    f"the rate bound {bound.name}{trouble}", "time_path: bounds", "See coopqp.RateBound."
                ) from trouble
            a, b = a * pace**2, b * pace
            least = _LEAST_SLACK * (np.abs(a) + np.abs(b))
            if (c < -least).any():
                raise UnreachableError(
                    f"{bound.name}: the object cannot rest {mark + s:.3g} m along the path, so it cannot pass there. "
                    "Take a lighter payload, or move the path."
                )
            slack = share * np.maximum(c, least + 1e-300)
            parts.append((b / slack, a / slack, np.full(len(a), float(number))))
        found.append(tuple(np.concatenate(x) for x in zip(*parts, strict=True)))  # type: ignore[arg-type]
    most = max(len(a) for a, _, _ in found)
    a, b, owner = (
        np.array([np.pad(rows[i], (0, most - len(rows[i])), constant_values=fill) for rows in found])
        for i, fill in ((0, 0.0), (1, 0.0), (2, -1.0))
    )
    return Lines(a, b, np.zeros_like(a), np.ones(most), owner.astype(int))


def binding_limits(
    cell: RobotCell,
    limited: Limited,
    squares: Array,
    jerk: Array | None = None,
    bounds: Sequence[RateBound] = (),
) -> tuple[list[BindingLimit | None], Array]:
    """The most used limit between knots, and its use as a share of the planned limit (K − 1,).

    Among limits used alike, the one that bound before counts, else the first.
    """
    uses = _uses(limited, squares, jerk)
    kinds = [kind for kind, owner, _ in uses for _ in owner]
    owners = [int(j) for _, owner, _ in uses for j in owner]
    use = np.hstack([own for _, _, own in uses])
    most = use.max(axis=1)
    names: list[BindingLimit | None] = []
    last = -1
    for row, top in zip(use, most, strict=True):
        if last < 0 or row[last] < _EQUAL * top:
            last = int((row >= _EQUAL * top).argmax())  # the first: what is alike may not hang on rounding
        if owners[last] < 0:
            names.append(BindingLimit("", "", kinds[last], bounds[-1 - owners[last]].name))
            continue
        names.append(cell.joint_limit(owners[last], kinds[last]))
    return names, most


def _uses(limited: Limited, squares: Array, jerk: Array | None) -> list[tuple[LimitKind, Any, Array]]:
    """Each kind of limits, their owners (m,), and the share of them that is used between knots (K − 1, m).

    An owner is a joint, or ``−1 − k`` for further bound ``k``.
    """
    knots = limited.knots
    slope = 0.5 * np.diff(squares) / np.diff(knots.s)
    speeds = np.abs(knots.slope) * np.sqrt(squares)[:, None] / limited.speed
    joints = np.arange(knots.q.shape[1])
    found: list[tuple[LimitKind, Any, Array]] = [(LimitKind.VELOCITY, joints, np.maximum(speeds[:-1], speeds[1:]))]
    for kind, lines in ((LimitKind.ACCELERATION, limited.acceleration), (LimitKind.TORQUE, limited.torque)):
        if lines is not None:
            ends = [
                np.abs(lines.a[part] * slope[:, None] + lines.b[part] * squares[part, None] + lines.c[part])
                / lines.bound
                for part in (slice(None, -1), slice(1, None))
            ]
            found.append((kind, lines.owner, np.maximum(*ends)))
    further = limited.further
    if further is not None:
        for number in range(int(further.owner.max()) + 1):
            ends = [
                np.where(
                    further.owner[part] == number,
                    further.a[part] * slope[:, None] + further.b[part] * squares[part, None],
                    0.0,
                ).max(axis=1, keepdims=True, initial=0.0)
                for part in (slice(None, -1), slice(1, None))
            ]
            found.append((LimitKind.CONSTRAINT, np.array([-1 - number]), np.maximum(*ends)))
    if jerk is not None:
        found.append((LimitKind.JERK, joints, jerk_use(limited, squares, jerk)))
    return found


#: ṡ² is divided by this power of the used share of a limit where that exceeds 1.
_POWERS = {LimitKind.VELOCITY: 2.0, LimitKind.ACCELERATION: 1.0, LimitKind.TORQUE: 1.0, LimitKind.JERK: 2.0 / 3.0}


def kept_within(limited: Limited, squares: Array, jerk: Array) -> Array:
    """A profile (K,), slowed down as a whole until it exceeds no limit."""
    for _ in range(_ROUNDS):
        uses = _uses(limited, squares, jerk)
        excess = max(float(own.max(initial=0.0)) ** _POWERS[kind] for kind, _, own in uses)
        if excess <= 1.0:
            break
        squares = squares / excess
    return squares


def _check_limits(cell: RobotCell, where: str) -> None:
    free = np.flatnonzero(~np.isfinite(cell.limits.acceleration))
    if free.size:
        raise InvalidInputError(
            f"joint {cell.joint_names[free[0]]} has no acceleration limit",
            where,
            "Give limits with cell.with_limits(acceleration=…), or in the cell file under [arms.limits].",
        )


def _check_positions(cell: RobotCell, path: ObjectPath | PathGeometry, knots: Knots, mark: float) -> None:
    """Every joint stays inside its position limits at every knot."""
    margins = np.minimum(knots.q - cell.limits.lower, cell.limits.upper - knots.q)
    margins[:, cell.continuous] = np.inf
    if margins.min() >= -AT_LIMIT:
        return
    j = int(margins.min(axis=0).argmin())
    at = mark + knots.s[np.flatnonzero(margins[:, j] < -AT_LIMIT)[0]]
    arm, _, joint = cell.joint_names[j].partition("/")
    when = f" ({path.clocks(np.array([at]))[0]:.2f} s of it)" if isinstance(path, ObjectPath) and is_known(path) else ""
    raise UnreachableError(
        f"arm {arm} leaves its position limits {at:.3g} m along the path{when}: {joint} goes "
        f"{amount(-float(margins[:, j].min()), slides=slides(cell)[j])} outside. Start from another branch "
        "(coopqp.find_start), or move the path or the arm's base."
    )


def _check_weight(cell: RobotCell, limited: Limited, mark: float) -> None:
    """Every joint holds its share of the payload still at every knot: an object that has to stop may rest anywhere."""
    lines = limited.torque
    if lines is None or not (np.abs(lines.c) > lines.bound).any():
        return
    i, column = np.argwhere(np.abs(lines.c) > lines.bound)[0]
    arm, _, joint = cell.joint_names[lines.owner[column]].partition("/")
    needed, allowed, at = abs(lines.c[i, column]), lines.bound[column], mark + limited.knots.s[i]
    raise UnreachableError(
        f"arm {arm}: joint {joint} needs {needed:.3g} N·m (or N) to hold its share of the payload still {at:.3g} m "
        f"along the path, and may take {allowed:.3g}. Take a lighter payload, or move the path."
    )
