"""Knots of all arms along a path: joint positions with exact first and second derivatives, before the motion.

With the object's path given each arm follows its own tool's path, ``J(q) q′ = V(s)``; the joints' derivatives come
from :meth:`coopqp.model.batch.ArmKinematics.derivatives`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.errors import UnreachableError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.geometry import PathGeometry
from coopqp.paths.segments import Indices
from coopqp.planning.arm_starts import why_it_ends
from coopqp.planning.on_shared import OnShared, group_joints
from coopqp.spatial import Array, cross

#: A knot is reached within this [m, rad]; then Newton's method goes on to rounding.
_REACHED, _EXACT = 1e-9, 1e-14
#: Knots of the first look, before they are spread.
_FIRST_LOOK = 80
#: Knots within each piece, at the first look and then, where there are several pieces.
_LOOKS, _LEAST_IN_A_PIECE = 5, 11
#: Share of the knots that is spread evenly over s, whatever the joints do.
_EVEN = 0.3
#: A batch solution this far from where it was expected is on another branch [rad or m].
_FAR = 0.05
#: Passes of a redundant arm's way, and the change that ends them [rad or m].
_PASSES, _SETTLED = 60, 1e-11
#: Derivatives of a led arm are differences over this share of the length.
_DIFFERENCE = 2e-4

#: Joint positions (K, nv) to which redundant arms are led, smooth over s (K,).
Lead = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class ArmKnots:
    """One arm along a geometry.

    Attributes:
        q, slope, curvature: positions and derivatives with respect to s at each knot (K, n), in the order of the joints
            of :class:`ArmKinematics`; continuous joints go on over whole turns.
        reached: index of the last knot that is reached without passing a singularity; later rows have no meaning.
    """

    q: Array
    slope: Array
    curvature: Array
    reached: int


@dataclass(frozen=True, eq=False)
class Knots:
    """All arms along one smooth geometry.

    Attributes:
        s: the knots (K,) [m], increasing.
        q: joint positions (K, nv) [rad or m].
        slope, curvature: q′ and q″ with respect to s (K, nv).
    """

    s: Array
    q: Array
    slope: Array
    curvature: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """The object along a geometry: s (K,), rotations (K, 3, 3), origins (K, 3), twists and their derivatives (K, 6)."""

    s: Array
    R: Array
    p: Array
    V: Array
    slope: Array

    @staticmethod
    def of(geometry: PathGeometry, s: Array) -> Motion:
        """At s (K,) [m]."""
        return Motion(s, *geometry.poses(s), *geometry.twists(s))

    def tool(self, X: pin.SE3) -> tuple[Array, Array, Array]:
        """T_world_tool as rows of R (9), p (3) with T_object_tool ``X``; the tool's twist in world axes and its slope.

        With r from the object's origin to the tool: ``v + ω × r``, and ``v′ + ω′ × r + ω × (ω × r)``.
        """
        r = self.R @ X.translation
        T = np.concatenate([(self.R @ X.rotation).reshape(-1, 9), self.p + r], axis=1)
        V, dV = self.V.copy(), self.slope.copy()
        whirl = cross(V[:, 3:], r)
        V[:, :3] += whirl
        dV[:, :3] += cross(dV[:, 3:], r) + cross(V[:, 3:], whirl)
        return T, V, dV


def arm_knots(kinematics: ArmKinematics, T_object_tool: pin.SE3, motion: Motion, q0: Array) -> ArmKnots:
    """Follow an arm's tool along a motion without corners, from ``q0`` (n,), which need only be near its start.

    A redundant arm moves as :class:`coopqp.model.chain.Chain` has it: least ``Σ (q′_j / v_j)²`` with the joints'
    largest speeds v, and no posture.
    """
    T, V, dV = motion.tool(T_object_tool)
    first, residual = kinematics.newton(T[:1], q0[None], tolerance=_EXACT, steps=20)
    if not residual[0] <= _REACHED:
        nothing = np.zeros((len(T), len(q0)))
        return ArmKnots(nothing + q0, nothing, nothing, -1)
    ways, last = kinematics.trajectories(T, first, tolerance=_REACHED)
    q, reached = ways[0], int(last[0])
    q[: reached + 1] = kinematics.newton(T[: reached + 1], q[: reached + 1], tolerance=_EXACT, steps=2)[0]
    return _derived(kinematics, T, V, dV, motion.s, q, reached)


def spread_knots(
    kinematics: ArmKinematics, T_object_tool: pin.SE3, motion: Motion, coarse_s: Array, coarse: ArmKnots
) -> ArmKnots:
    """Knots of an arm at other s, from known knots: all at once, without the walk."""
    T, V, dV = motion.tool(T_object_tool)
    guess = hermite(coarse_s, coarse.q, coarse.slope, motion.s)
    q, residual = kinematics.newton(T, guess, tolerance=_EXACT, steps=6)
    if not residual.max() <= _REACHED or np.abs(q - guess).max() > _FAR:
        return arm_knots(kinematics, T_object_tool, motion, coarse.q[0])
    return _derived(kinematics, T, V, dV, motion.s, q, len(T) - 1)


def led_knots(
    newton: Callable[[Array, Array], tuple[Array, Array]],
    T_object_tool: pin.SE3,
    geometry: PathGeometry,
    s: Array,
    lead: Lead,
) -> ArmKnots:
    """Knots of a redundant arm at s (K,): at each Newton's method goes the least way from what ``lead`` says there.

    So positions are a smooth function of s, and their derivatives are differences over neighbours. ``newton`` has
    positions and residuals from rows of poses and guesses; joints that arms share it leaves as they are led.
    """

    def solved(at: Array) -> tuple[Array, Array]:
        R, p = geometry.poses(at)
        T = np.concatenate([(R @ T_object_tool.rotation).reshape(-1, 9), p + R @ T_object_tool.translation], axis=1)
        return newton(T, lead(at))

    q, residual = solved(s)
    far = ~(residual <= _REACHED)
    away = _DIFFERENCE * geometry.length
    middle = np.clip(s, away, geometry.length - away)
    (before, _), (here, _), (after, _) = (solved(middle + step) for step in (-away, 0.0, away))
    curvature = (after - 2.0 * here + before) / away**2
    slope = (after - before) / (2.0 * away) + curvature * (s - middle)[:, None]
    return ArmKnots(q, slope, curvature, int(far.argmax()) - 1 if far.any() else len(s) - 1)


def hermite(s: Array, q: Array, slope: Array, at: Array) -> Array:
    """Cubic interpolation (M, n) of rows (K, n) with slopes at s (K,): a guess between knots, never a path."""
    from scipy.interpolate import CubicHermiteSpline  # takes long to import

    return CubicHermiteSpline(s, q, slope)(at)


@final
class Following:
    """All arms followed along one geometry without corners: first at a few knots, then at any others.

    Args:
        cell, grasp: the arms, and how they hold.
        geometry: without corners.
        x0: joint positions (nv,) near its start [rad or m].
        lead: where redundant arms are led to; by default they move as little as they can.

    Raises:
        UnreachableError: an arm does not follow; the message names it, and where its way ends.
    """

    def __init__(
        self, cell: RobotCell, grasp: Grasp, geometry: PathGeometry, x0: Array, *, lead: Lead | None = None
    ) -> None:
        self._cell, self._grasp, self._geometry, self._x0, self._lead = cell, grasp, geometry, x0, lead
        self._arms = [ArmKinematics(arm) for arm in cell.arms]
        self._columns = [own[arm.columns] for own, arm in zip(cell.columns, self._arms, strict=True)]
        self._on_shared = {
            cell.arm_names[k]: OnShared(cell.arms[k], cell.columns[k], group_joints(cell, group))
            for group in cell.groups
            for k in group
        }
        self._first = Motion.of(geometry, merged(np.linspace(0.0, geometry.length, _FIRST_LOOK), self._within(_LOOKS)))
        self._coarse: list[ArmKnots] = []
        for name, arm, X, own in zip(cell.arm_names, self._arms, grasp.T_object_tool, self._columns, strict=True):
            found = self._led(arm, X, own, self._first.s) or arm_knots(arm, X, self._first, x0[own])
            if found.reached < len(self._first.s) - 1:
                share = self._first.s[max(found.reached, 0)] / geometry.length
                where = "its start" if found.reached < 0 else f"{100.0 * share:.0f} % of its way"
                last = max(found.reached, 0)
                here, ahead = ((geometry.pose(float(s)) * X).homogeneous for s in self._first.s[last : last + 2])
                end = why_it_ends(arm, found.q[last], here, ahead)
                raise UnreachableError(
                    f"arm '{name}' follows the path only to {where}, {end}. "
                    "Start from another branch (coopqp.find_start), or move the path or the arm's base."
                )
            self._coarse.append(found)

    def spread(self, count: int, *, gather: bool = False) -> Array:
        """s of ``count`` knots, spread evenly over the joints' motion, not over time; those of the pieces are added.

        The arm that moves most counts, in the unit of its speeds.

        Args:
            count: number of knots.
            gather: more of them near both ends, as a motion with bounded jerk needs.
        """
        s = self._first.s
        uses = [np.abs(a.slope / arm.scale).max(axis=1) for a, arm in zip(self._coarse, self._arms, strict=True)]
        motion, step = np.max(uses, axis=0), np.diff(s)
        part = 0.5 * (motion[1:] + motion[:-1]) * step
        done = np.concatenate([[0.0], np.cumsum((1.0 - _EVEN) * part / part.sum() + _EVEN * step / s[-1])])
        share = np.linspace(0.0, 1.0, count)
        if gather:  # s grows as t³ from rest
            share = share**3 * (10.0 + share * (6.0 * share - 15.0))
        return merged(np.interp(share, done / done[-1], s), self._within(_LEAST_IN_A_PIECE))

    def at(self, s: Array) -> Knots:
        """Knots at s (K,) [m], increasing from 0 to the end."""
        motion = Motion.of(self._geometry, s)
        x = np.tile(self._x0, (len(s), 1))
        slope, curvature = np.zeros_like(x), np.zeros_like(x)
        for arm, X, own, known in zip(self._arms, self._grasp.T_object_tool, self._columns, self._coarse, strict=True):
            found = self._led(arm, X, own, s) or spread_knots(arm, X, motion, self._first.s, known)
            x[:, own], slope[:, own], curvature[:, own] = found.q, found.slope, found.curvature
        return Knots(s, x, slope, curvature)

    def _led(self, arm: ArmKinematics, T_object_tool: pin.SE3, own: Indices, s: Array) -> ArmKnots | None:
        """Knots of an arm that is led; None for others."""
        lead = self._lead
        if lead is None or arm.n <= 6:
            return None
        alone = functools.partial(arm.newton, tolerance=_EXACT, steps=12)
        newton = self._on_shared[arm.arm.name].newton if len(arm.shared) else alone
        return led_knots(newton, T_object_tool, self._geometry, s, lambda at: lead(at)[:, own])

    def with_marks(self, s: Array) -> Array:
        """s with the marks between pieces."""
        return merged(s, self._geometry.marks)

    def _within(self, count: int) -> Array:
        """The marks, and ``count`` knots within each of several pieces."""
        marks = self._geometry.marks
        if len(marks) == 2:
            return marks
        share = np.arange(count + 1) / (count + 1.0)
        inner = marks[:-1, None] + share * np.diff(marks)[:, None]
        return np.append(inner.ravel(), marks[-1])


def follow(cell: RobotCell, grasp: Grasp, geometry: PathGeometry, x0: Array, *, count: int) -> Knots:
    """Knots of all arms along one geometry without corners, see :class:`Following`."""
    following = Following(cell, grasp, geometry, x0)
    return following.at(following.spread(count))


def merged(s: Array, others: Array) -> Array:
    """s with other knots in it; knots that all but coincide with one of them give way."""
    close = np.abs(s[:, None] - others).min(axis=1) < 0.1 * np.diff(s).min()
    return np.sort(np.concatenate([s[~close], others]))


def _derived(kinematics: ArmKinematics, T: Array, V: Array, dV: Array, s: Array, q: Array, reached: int) -> ArmKnots:
    if kinematics.n > 6 and reached == len(s) - 1:
        q = _least_motion(kinematics, T, V, dV, s, q)
    slope, curvature = kinematics.derivatives(q, V, dV)
    good = np.isfinite(slope).all(axis=1) & np.isfinite(curvature).all(axis=1)
    if not good.all():
        reached = min(reached, int(np.flatnonzero(~good)[0]) - 1)
    return ArmKnots(q, slope, curvature, reached)


def _least_motion(kinematics: ArmKinematics, T: Array, V: Array, dV: Array, s: Array, q: Array) -> Array:
    """The way ``dq/ds = J⁺V`` of a redundant arm by Picard's iteration over all knots at once, led back to the poses.

    ``∫ f = h (f_0 + f_1)/2 + h² (f_0′ − f_1′)/12`` between knots is exact to the fifth power of h.
    """
    h = np.diff(s)[:, None]
    for _ in range(_PASSES):
        f, df = kinematics.derivatives(q, V, dV)
        way = np.cumsum(0.5 * h * (f[1:] + f[:-1]) + h * h / 12.0 * (df[:-1] - df[1:]), axis=0)
        ahead = np.vstack([q[:1], q[0] + way])
        ahead = kinematics.newton(T, ahead, tolerance=_EXACT, steps=6)[0]
        if not np.isfinite(ahead).all():
            return q
        change, q = float(np.abs(ahead - q).max()), ahead
        if change < _SETTLED:
            break
    return q
