"""The closed chain ahead of the clock: inverse kinematics and bounds of the rate at one clock, as a grid point.

The core's counterpart is ``chain_ahead.cpp``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.control.lookahead.backward_pass import largest_alone
from coopqp.control.lookahead.horizon import GridPoint
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.control.lookahead.redundancy import LimitAvoidance
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.posture import Posture
from coopqp.native.constants import (
    BEND_CHANGE,
    BRANCH_WAY,
    CONVERGED,
    ELBOW_GAIN,
    FEW_FOLLOW,
    FINE_BEND,
    FINE_CELL,
    JUST_BEFORE,
    MOST_TRIES,
    OTHER_BRANCH,
    STARTING_STEPS,
    TURN_LENGTH,
)
from coopqp.paths.guarded import GuardedPath
from coopqp.spatial import Array, for_twists


class KnotBounds(NamedTuple):
    """Bounds by further constraints at a knot.

    Attributes:
        cap: largest σ²; negative where not even rest is admissible.
        decrease, rise: largest changes of σ [1/s].
        binding: the limit that makes the cap; None if none does.
    """

    cap: float
    decrease: float
    rise: float
    binding: BindingLimit | None


#: Bounds by further constraints at a knot, from its clock, q, q′, q″ and the time since the knot before [s]. It may
#: raise :class:`LookAheadTrouble`.
KnotBound = Callable[[float, Array, Array, Array, float], KnotBounds]
#: Slopes (nv,) at (q, q′) with self-motion that keeps redundant arms clear of bodies ahead.
Evade = Callable[[Array, Array], Array]


class _NewtonStep(NamedTuple):
    """Errors of the arms (N, 6) at a configuration, Newton's step from there, and q′ (nv,)."""

    errors: Array
    step: Array
    slope: Array


class LookAheadTrouble(Exception):  # noqa: N818
    """A user's path or a further constraint fails ahead of the clock. The extension waits; the next step asks again."""


@final
class ClosedChainAhead:
    """See the module's description.

    Args:
        chain: a workspace; its content is overwritten.
        path: the object's path.
        posture: null-space motion of redundant arms.
        plan: planning limits.
        options: settings.
        bound: bound of the rate at a knot by further constraints.
        evade: self-motion that keeps redundant arms clear of bodies ahead.

    Attributes:
        no_horizon: arms with fewer than six joints cannot follow the path; nothing is known ahead.
        beyond, beyond_at: a constraint that allows no rate, and the clock; None and infinite where none is known.
    """

    def __init__(
        self,
        chain: Chain,
        path: GuardedPath,
        posture: Posture,
        plan: PlanLimits,
        options: PreviewOptions,
        bound: KnotBound | None,
        evade: Evade | None = None,
    ) -> None:
        self._chain, self._path, self._posture, self._bound, self._evade = chain, path, posture, bound, evade
        self._duration, self._options, self._plan = path.duration, options, plan
        self._cell, self._avoidance = chain.cell, LimitAvoidance(chain)
        self._motion = path.grasps
        self._low, self._high = chain.cell.limits.lower, chain.cell.limits.upper
        #: The joints that move the tools, part by part of the chain, and the first index of each part.
        self._moving = np.concatenate(chain.part_columns)
        self._starts = np.cumsum([0, *(len(columns) for columns in chain.part_columns[:-1])]).tolist()
        self.forget()

    def forget(self) -> None:
        """Nothing is known yet."""
        self.no_horizon, self.beyond_at = False, np.inf
        self.beyond: BindingLimit | None = None

    def first(self, q: Array, clock: float) -> GridPoint:
        """The knot at a clock, from a configuration near; the object rests there if the chain does not reach it."""
        pose = self._path.pose(clock)
        if pose is None:
            raise LookAheadTrouble(self._path.problem)
        self._place_grasps(clock)
        q, errors = newton(self._chain, pose, q, tolerance=1e-10, max_iter=STARTING_STEPS)
        self.no_horizon = self._beyond_few_joints(errors)
        if not np.abs(errors).max() < 1e-6 and not self.no_horizon:
            arm = int(np.abs(errors).max(axis=1).argmax())
            reach = BindingLimit(self._cell.arm_names[arm], "", LimitKind.REACH)
            return self._knot_at(clock, q, np.zeros(self._chain.nv), None)._replace(cap=0.0, binding=reach)
        step = self._newton_step(clock, q, before=0.0)
        return self._knot_at(clock, q, np.zeros(self._chain.nv) if step is None else step.slope, None)

    def attempt(self, last: GridPoint, h: float) -> Generator[None, None, GridPoint | None]:
        """The chain at ``last.clock + h``, or None if Newton's method or the joints' slopes do not follow."""
        clock, options = last.clock + h, self._options
        q = self._cell.moved(last.q, self._expected(last, h))
        for _ in range(MOST_TRIES):
            yield
            step = self._newton_step(clock, q)
            if step is None:
                return None
            farthest = float(np.abs(step.step).max())
            if not farthest < options.joint_step:
                return None
            q = self._cell.moved(q, step.step)
            if farthest < CONVERGED:
                break
        else:
            return None
        if self._beyond_few_joints(step.errors):
            self.no_horizon = True
            return None
        knot = self._knot_at(clock, q, step.slope, last)
        if not knot.cap > 0.0:
            return None  # numbers overflow
        if h > options.shortest and not h * knot.fastest <= 1.5 * options.joint_step:
            return None
        fine = h <= FINE_CELL
        if h > options.shortest and not knot.change <= (OTHER_BRANCH if fine else options.slope_step) * knot.fastest:
            return None
        if not self._bends_slowly(knot, last):
            return None
        if self._ends_reach(knot, last):
            return None
        return self._constrained(knot)

    def _expected(self, last: GridPoint, h: float) -> Array:
        """The joints' way (nv,) in ``h`` after a knot: as q′ and q″ go on, or with the elbows that lead them."""
        elbows = self._path.elbows
        if not self.led or elbows is None:
            bends = 0.0 if last.corner else 0.5 * h
            more = bends * (0.5 * last.span + h / 3.0)
            way: Array = (last.curvature * bends + last.bending * more + last.slope) * h
            return way
        before, after = elbows.at(last.clock)[0], elbows.at(last.clock + h)[0]
        away = pin.difference(self._cell.model, last.q, self._cell.configuration_of(before))
        led: Array = after - before + min(ELBOW_GAIN * h, 1.0) * away
        return led

    def _ends_reach(self, knot: GridPoint, last: GridPoint) -> bool:
        """Whether an arm comes too close to where its reach ends.

        Joint speeds do not tell the distance: on a way along the end no joint is fast. Within the distance that the
        joints cover in two steps, a step would miss the end. Past it Newton's method is on another branch.
        """
        now, then = knot.to_reach_end, last.to_reach_end
        too_close = (knot.steps_to_reach_end < 1.0) & (knot.steps_to_reach_end < last.steps_to_reach_end)
        near = np.maximum.reduceat(np.maximum(np.abs(now), np.abs(then)), self._starts)
        turned_round = np.add.reduceat(now * then, self._starts) < 0.0
        passed = (near < BRANCH_WAY * self._options.joint_step) & turned_round
        return bool((too_close | passed).any())

    def _bends_slowly(self, knot: GridPoint, last: GridPoint) -> bool:
        """Whether q″ has changed by a small share of the accelerations since the interval before.

        Fine intervals count, too, where the object creeps and needs longer for them. Where q′ changes steeply with q,
        as beside the end of a reach that a slow shared joint extends, longer ones would overshoot, to and fro.
        """
        fine, least = knot.span <= FINE_CELL, max(FINE_CELL * math.sqrt(knot.cap), 2.0 * self._options.shortest)
        if last.span == 0.0 or last.corner or (fine and not knot.span > least):
            return True
        change = float((np.abs(knot.curvature - last.curvature) / self._plan.acceleration).max())
        if fine:
            return self._path.own or change * knot.cap <= FINE_BEND  # a user's path is asked rarely
        if change <= BEND_CHANGE:
            return True  # at any rate
        z = largest_alone(knot.slope, knot.curvature, self._plan.acceleration, self._plan.slope_cap, knot.cap)
        return change * z <= BEND_CHANGE

    def _constrained(self, knot: GridPoint) -> GridPoint | None:
        """A knot under the further constraints; None where they allow no rate."""
        if self._bound is None:
            return knot
        bounds = self._bound(knot.clock, knot.q, knot.slope, knot.curvature, knot.span)
        if not bounds.cap > 0.0:
            self.beyond, self.beyond_at = bounds.binding, knot.clock
            return None
        if bounds.cap < knot.cap:
            knot = knot._replace(cap=bounds.cap, binding=bounds.binding)
        return knot._replace(fall=bounds.decrease, rise=bounds.rise)

    def _beyond_few_joints(self, errors: Array) -> bool:
        """Whether the remaining errors (N, 6) are too large for arms with fewer than six joints."""
        few = self._chain.deficient
        return bool(few) and not np.abs(errors[list(few)]).max() < FEW_FOLLOW

    def _newton_step(self, clock: float, q: Array, *, before: float = JUST_BEFORE) -> _NewtonStep | None:
        """Newton's step from ``q`` to the pose at ``clock``, and q′ there; None if singular.

        q′ is that for the twist a moment ``before`` the clock [s], which tells the sides of a jump apart.
        """
        chain, path = self._chain, self._path
        pose = path.pose(clock)
        twist = None if pose is None else path.twist(max(min(clock, self._duration) - before, 0.0))
        if pose is None or twist is None:
            raise LookAheadTrouble(path.problem)
        self._place_grasps(clock, before)
        errors = chain.errors(chain.carried(q), pose)
        if not np.abs(errors).max() < np.inf:
            return None
        chain.linearise(q, about=pose.translation)
        to_world = for_twists(pose.rotation)
        step = chain.joint_velocities(-errors @ to_world.T)
        if self._motion is None:
            slope = chain.joint_columns((to_world @ twist)[:, None])[:, 0]
        else:  # each tool also moves on the object
            own = twist + self._motion.twists(max(min(clock, self._duration) - before, 0.0))
            slope = chain.joint_velocities(own @ to_world.T)
        if chain.redundancy:
            elbows_led = path.elbows is not None
            slope += chain.null_part(self.elbow_velocity(clock, q) if elbows_led else self._posture.velocity(q))
            if self._evade is not None:
                slope = self._evade(q, slope)
            if not elbows_led:
                slope = self._avoidance.led_away(self._cell.positions(q), slope)
        if chain.apart:
            self._along_own_ways(clock, before, q, step, slope)
        return _NewtonStep(errors, step, slope) if step @ step + slope @ slope < np.inf else None

    def _along_own_ways(self, clock: float, before: float, q: Array, step: Array, slope: Array) -> None:
        """Newton's step and q′ of arms that follow their joints' own way."""
        motion, x = self._motion, self._cell.positions(q)
        assert motion is not None
        for k in self._chain.apart:
            columns, way = self._chain.moving_columns[k], motion.leading(k, self._side(clock, before))
            assert way is not None
            step[columns] = way.at(clock)[0] - x[columns]
            slope[columns] = way.at(clock - before)[1]

    def _side(self, clock: float, before: float) -> float:
        """A clock a moment ``before`` another, on the path [s]."""
        return max(min(clock, self._duration) - before, 0.0)

    def _place_grasps(self, clock: float, before: float = 0.0) -> None:
        """Place the tools where they are on the object at a clock [s]; which arms follow it, a moment ``before``."""
        if self._motion is not None:
            self._chain.place(self._motion.placements(min(clock, self._duration)))
            self._chain.apart = self._motion.apart(self._side(clock, before))

    @property
    def led(self) -> bool:
        """Whether the elbows go where they are led to, and not away from bodies."""
        return self._path.elbows is not None and self._evade is None and bool(self._chain.redundancy)

    def elbow_velocity(self, clock: float, q: Array, *, span: float = 0.0) -> Array:
        """Null-space motion (nv,) along the elbows half a ``span`` later, per second of the clock; to be projected."""
        elbows = self._path.elbows
        assert elbows is not None
        x, slope = elbows.at(clock)[0], elbows.at(clock + 0.5 * span)[1]
        reference: Array = slope + ELBOW_GAIN * pin.difference(self._cell.model, q, self._cell.configuration_of(x))
        return reference

    def _knot_at(self, clock: float, q: Array, slope: Array, last: GridPoint | None) -> GridPoint:
        """Bounds at a configuration on the path, from the slopes there and at the last grid point."""
        to_reach_end = self._chain.to_reach_end()[self._moving]
        steps_to_end = np.abs(to_reach_end) / self._plan.room[self._moving]
        before, span = (slope, 1.0) if last is None else (last.slope, clock - last.clock)
        speed, curvature = np.abs(slope), (slope - before) / span
        bending = np.zeros_like(slope)
        if last is not None and last.span > 0.0 and not last.corner:
            bending = 2.0 / (span + last.span) * (curvature - last.curvature)
        bend = np.abs(curvature)
        # Use of each joint's limits at full rate: z is at most 1 over the speed's square, and 1 over the curvature's.
        use_speed, use_bend = speed / self._plan.speed, bend / (self._options.curvature_share * self._plan.acceleration)
        j_speed, j_bend = int(use_speed.argmax()), int(use_bend.argmax())
        by_speed, by_bend = float(use_speed[j_speed]) ** 2, float(use_bend[j_bend])
        # Without acceleration limits the step itself finds the cap by speed; by curvature it changes slowly.
        if self._plan.accelerates:
            cap, joint, kind = 1.0 / max(by_speed, 1.0), j_speed, LimitKind.VELOCITY
        else:
            cap, joint, kind = 1.0 / max(by_bend, 1.0), j_bend, LimitKind.ACCELERATION
        uncapped = 1.0 / max(by_speed, by_bend, 1.0)
        if uncapped < self._options.singular_rate**2:
            uncapped = max(uncapped, float(1.0 / np.float64(self._against_each_other(slope))))
        x = self._cell.positions(q)
        return GridPoint(
            clock=clock,
            q=q,
            slope=slope,
            curvature=curvature,
            bending=bending,
            span=0.0 if last is None else span,
            cap=cap,
            uncapped=uncapped,
            binding=self._cell.joint_limit(joint, kind) if cap < 1.0 else None,
            fastest=float(speed.max()),
            change=float((bend * span - self._plan.slope_change).max()),
            to_reach_end=to_reach_end,
            steps_to_reach_end=np.maximum.reduceat(steps_to_end, self._starts),
            inside=bool(((x <= self._high) & (x >= self._low)).all()),
        )

    def _against_each_other(self, slope: Array) -> float:
        """Square of the most by which one joint alone would move the object faster than all together do.

        Near a singularity joints move against each other. It does not change with the path's clock.
        """
        chain, most = self._chain, 0.0
        for k, (J, columns) in enumerate(zip(chain.jacobians, chain.moving_columns, strict=True)):
            own = (J * slope[columns]) * np.array([[1.0]] * 3 + [[TURN_LENGTH]] * 3)
            alone, together = float((own**2).sum(axis=0).max()), float((own.sum(axis=1) ** 2).sum())
            if k not in chain.apart and alone > 0.0:
                most = max(most, alone / together if together > 0.0 else np.inf)
        return most

    def corner(self, knot: GridPoint) -> GridPoint:
        """A knot where the twist jumps: slopes after it, and the rate at which the joints can take the jump."""
        step = self._newton_step(knot.clock + 1e-9, knot.q)
        after = np.zeros_like(knot.slope) if step is None else step.slope
        cap, binding = knot.cap, knot.binding
        if self._plan.accelerates:
            use_speed = np.abs(after) / self._plan.speed
            by_speed = 1.0 / max(float(use_speed.max()) ** 2, 1.0)
            if by_speed < cap:
                cap, binding = by_speed, self._cell.joint_limit(int(use_speed.argmax()), LimitKind.VELOCITY)
            jump = self._jump_cap(after, knot.slope)
            if jump < cap:
                j = int((np.abs(after - knot.slope) / self._plan.jump).argmax())
                cap, binding = jump, self._cell.joint_limit(j, LimitKind.ACCELERATION)
        fastest = float(np.abs(after).max())
        return knot._replace(slope=after, cap=cap, binding=binding, corner=True, fastest=fastest)

    def _jump_cap(self, after: Array, before: Array) -> float:
        """Largest σ² at which every joint can change its slope within one step."""
        jump = np.abs(after - before)
        moving = jump > 1e-9
        if not moving.any():
            return np.inf
        return float((self._plan.jump[moving] / jump[moving]).min() ** 2)

    def at_end(self, knot: GridPoint) -> GridPoint | None:
        """The same knot where the path ends moving: the joints have one step to stop in; None if the cap suffices."""
        if not self._plan.accelerates:
            return None
        cap = self._jump_cap(np.zeros_like(knot.slope), knot.slope)
        if cap >= knot.cap:
            return None
        return knot._replace(cap=cap, span=0.0, binding=BindingLimit("", "", LimitKind.PATH_END))
