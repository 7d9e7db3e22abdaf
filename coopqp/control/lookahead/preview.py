"""The look-ahead: where limits and singularities bind ahead of the object's clock, and how fast the object may go.

Under acceleration limits no single step can keep both the chain and the path at a limit: all arms have to brake
together, ahead of it. The preview runs the chain's own inverse kinematics ahead of the clock, knot by knot, and stores
the joints' derivatives with respect to the clock, ``q′ = A⁻¹ν`` and ``q″``. With rate σ the joints move at ``q′σ`` and
accelerate at ``q′σ̇ + q″σ²``. Speeds bound ``z = σ²`` at each knot. A backward pass over the knots finds K, the
largest z from which the object can go on within the accelerations (see :mod:`coopqp.control.lookahead.backward_pass`),
down to a stop at the end of the known horizon. The rate of a step keeps ``σ² ≤ K`` in its middle and at its end. It is
path timing on a rolling horizon: as long as the object needs to stop, and no longer. The core's counterpart is
``preview.cpp``.
"""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.control.lookahead.closed_chain import ClosedChainAhead, Evade, KnotBound, LookAheadTrouble
from coopqp.control.lookahead.extension import HorizonExtension
from coopqp.control.lookahead.horizon import Horizon
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.model.chain import Chain
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.posture import Posture
from coopqp.native.constants import (
    ASKED_PER_TIME,
    LEAST_ASKED,
    NEWTON_STEPS_AT_START,
    SHORT_STEP,
    STEPS_TO_ASK,
    STEPS_TO_GROW,
)
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array


@final
class PathPreview:
    """Rolling preview of one path for one chain.

    Args:
        chain: a workspace; its content is overwritten.
        path: the object's path.
        posture: null-space motion of redundant arms.
        dt: nominal length of a control step [s].
        options: settings.
        bound: bound of the rate at a knot by further constraints.
        evade: self-motion that keeps redundant arms clear of bodies ahead.
        shift: by how much the tools are elsewhere on the object than the grasp says (N, 6) [m, rad]; read again
            whenever a knot is begun. None if they never are.

    Attributes:
        horizon: the known knots.
        ends: the cause of the latest cap stops the object for good.
        trouble: why the latest look ahead failed; empty if it did not.
    """

    def __init__(
        self,
        chain: Chain,
        path: ObjectPath,
        posture: Posture,
        *,
        dt: float,
        options: PreviewOptions | None = None,
        bound: KnotBound | None = None,
        evade: Evade | None = None,
        shift: Array | None = None,
    ) -> None:
        self._path, self._dt, self._cell = GuardedPath(path), dt, chain.cell
        self._links, self._shift = chain, np.zeros((chain.n_arms, 6)) if shift is None else shift
        self._taken = self._shift.copy()
        if shift is not None:
            chain.shift_grasp(shift)
        self.options = options or PreviewOptions()
        plan = self._plan = PlanLimits.of(chain.cell, self.options, dt=dt)
        self.accelerates = plan.accelerates
        self.horizon = Horizon(chain.cell, plan.acceleration, plan.slope_cap, self.options.doubt)
        self._chain = ClosedChainAhead(chain, self._path, posture, plan, self.options, bound, evade)
        self._growth = HorizonExtension(chain.cell, self._path, self._chain, self.horizon, plan, self.options)
        self._begun = pin.neutral(chain.cell.model)
        self._most_asked = LEAST_ASKED + max(0, int(ASKED_PER_TIME * (dt - SHORT_STEP))) if self._path.own else math.inf
        self._ahead_of_need = STEPS_TO_ASK if self._path.own or bound is not None else STEPS_TO_GROW
        # Beside bodies growth goes on before the rate is no longer known to be free.
        self._early = 0.0 if bound is None else self._ahead_of_need * dt
        self._free_until = -np.inf  # clock until which the rate is known to be free
        self.ends, self.trouble = False, ""

    def reset(self, q: Array, clock: float, *, later: bool = False, rate: float = math.inf) -> None:
        """Start at a configuration on (or near) the path, and look ahead as far as the first step needs.

        With ``later`` that is left to the steps; with a rate as far as the first step needs to keep that.
        """
        self._take_grasps()
        self.horizon.clear()
        self._chain.forget()
        self._growth.begin(self._path.breakpoints())
        self._free_until, self.ends, self._begun = -np.inf, False, q
        try:
            self.horizon.push(self._chain.first(q, clock))
        except LookAheadTrouble as trouble:  # nothing is known ahead: the object rests, and the next step tries again
            self.trouble = str(trouble)
            return
        if not later:
            self._extend(clock, self._dt, rate, NEWTON_STEPS_AT_START, math.inf)

    @property
    def jump(self) -> tuple[float, float] | None:
        """The clock at which the path jumps [s], and by how far [m]; None where it does not, as far as it is known."""
        return self._growth.jump

    def _take_grasps(self) -> None:
        """Go on with the present grasps: those that give way while a knot is found would be pursued for ever."""
        if not np.array_equal(self._taken, self._shift):
            self._taken = self._shift.copy()
            self._links.shift_grasp(self._taken)

    @property
    def knows(self) -> bool:
        """Whether anything is known ahead."""
        return len(self.horizon.knots) > 0

    @property
    def no_horizon(self) -> bool:
        """Arms with fewer than six joints cannot follow the path; nothing is known ahead."""
        return self._chain.no_horizon

    def memory(self) -> Any:
        """State for a copy of this preview."""
        chain, growth = self._chain, self._growth
        return (
            self.horizon.memory(), self.ends, chain.no_horizon, chain.beyond, chain.beyond_at, self._free_until,
            self._begun, self._taken, growth.memory(),
        )  # fmt: skip

    def restore(self, memory: Any) -> None:
        """Go on from what :meth:`memory` returned."""
        chain = self._chain
        (
            horizon, self.ends, chain.no_horizon, chain.beyond, chain.beyond_at, self._free_until,
            self._begun, self._taken, growth,
        ) = memory  # fmt: skip
        self._links.shift_grasp(self._taken)
        self.horizon.restore(horizon)
        self._growth.restore(growth)

    # -- what is ahead -------------------------------------------------------------------------------------------

    def cap(self, clock: float, dt: float, most: float = math.inf) -> tuple[float, BindingLimit | None]:
        """Largest admissible rate σ at ``clock`` for a step of ``dt``, and its cause if it is below 1.

        1 if more than ``most`` is admissible before K is final: what the step will not exceed for other reasons.
        """
        self.trouble = ""
        if self.no_horizon:
            return 1.0, None
        if not self._growth.under_way:
            self._take_grasps()
        if not self.knows:
            self.reset(self._begun, clock, later=True)
            if not self.knows:
                return 0.0, None
        if clock < self._free_until - self._early and dt <= self._dt:
            if clock >= self._growth.begin_at:
                self._growth.step()
            return 1.0, None
        self._extend(clock, dt, most, self.options.newton_steps, self._most_asked)
        needs = not self.horizon.complete and not self.horizon.reaches(clock + self._ahead_of_need * dt, dt)
        if needs and not self._path.asked:  # else a user's path was asked enough in this step
            self._growth.step()
        self.ends = False
        least = self.horizon.least(clock, 1.0, dt)
        if least.square >= 1.0:
            self._free_until = self.horizon.free_until(2.0 * max(dt, self._dt))
            self._growth.begin_at = self._free_until - self._ahead_of_need * self._dt
            return 1.0, None
        if not self._settled(clock, dt) and self.horizon.admits(clock, dt, most):
            return 1.0, None
        rate, cause = self.horizon.largest_rate(clock, dt, least)
        self.ends = cause.stops
        return rate, cause.cause

    def reaches_corner(self, clock: float, way: float) -> bool:
        """Whether the twist jumps within ``way`` [s] of the clock, or the path ends."""
        return self._growth.next_breakpoint(clock) <= clock + way

    def rise(self, clock: float) -> tuple[float, BindingLimit | None]:
        """Largest rise of σ near a clock [1/s], and the joint's limit that makes it; None where a constraint does.

        Further constraints bound it, and the planned accelerations of joints without acceleration limits.
        """
        if not self.knows:
            return np.inf, None
        i = self.horizon.knot_before(clock)
        here, ahead = self.horizon.knots[i], self.horizon.knots[min(i + 1, len(self.horizon.knots) - 1)]
        rise = min(here.rise, ahead.rise)
        if self.accelerates:
            return rise, None
        share = np.maximum(np.abs(here.slope), np.abs(ahead.slope)) / self._plan.acceleration
        j = int(share.argmax())
        if share[j] == 0.0 or 1.0 / share[j] >= rise:
            return rise, None
        return 1.0 / float(share[j]), self._cell.joint_limit(j, LimitKind.ACCELERATION)

    def brake(self, clock: float, dt: float, rate: float) -> float:
        """D, the fastest fall of σ from ``rate`` with which the joints still follow the path [1/s]; it may be negative.

        Between two steps of rates σ and σ − x a joint's velocity changes by ``q″ (σ − x/2)² dt − q′ x``. With
        ``c = q″ sign q′`` its limit is kept up to ``x = dt (η a + c σ²) / (|q′| + max(c, 0) σ dt)``, by the tangent at
        x = 0.
        A corner takes the whole acceleration: the rate stays while it is passed.
        """
        if self._growth.next_breakpoint(clock - rate * dt) <= min(clock + rate * dt, self._path.duration - 1e-9):
            return 0.0
        slope, curvature = self.horizon.joints_at(clock)
        speed, bend = np.abs(slope), curvature * np.sign(slope)
        moving = speed > 0.0
        fall = (self._plan.acceleration + bend * rate**2) / (speed + np.maximum(bend, 0.0) * (rate * dt) + ~moving)
        return float(fall[moving].min(initial=np.inf))

    def led(self, clock: float, q: Array, span: float) -> Array | None:
        """Null-space motion (nv,) of elbows that are led, over a step that takes ``span`` of the clock; or None."""
        return self._chain.elbow_velocity(clock, q, span=span) if self._chain.led else None

    def reference(self, clock: float) -> tuple[Array, Array]:
        """Previewed configuration (nq,) and q′ (nv,) at ``clock``: what redundant arms follow."""
        if not self.knows:
            return self._begun, np.zeros(self._cell.nv)
        self.horizon.leave_behind(clock)
        here = self.horizon.knots[0]
        ahead = self.horizon.knots[1] if len(self.horizon.knots) > 1 else here
        span = ahead.clock - here.clock
        share = min(max((clock - here.clock) / span, 0.0), 1.0) if span > 0.0 else 0.0
        model = self._cell.model
        slope = here.slope + share * (ahead.slope - here.slope)
        # Quadratic from the knot before: exact to second order, continuous to third.
        q = pin.integrate(model, here.q, 0.5 * (here.slope + slope) * (share * span))
        return q, slope

    def _settled(self, clock: float, dt: float) -> bool:
        """Whether K is final along a step."""
        return self.horizon.complete or self.horizon.reaches(clock, dt)

    def _extend(self, clock: float, dt: float, rate: float, newton_steps: int, most_asked: float) -> None:
        """Extend the horizon until K is final along a step, or admits a rate for it.

        It takes so many Newton steps and calls of a path at most.
        """
        self._path.asked = 0
        for _ in range(newton_steps):
            self.horizon.leave_behind(clock)
            if (
                self._settled(clock, dt)
                or self.no_horizon
                or self.horizon.admits(clock, dt, rate)
                or self._path.asked >= most_asked
            ):
                return
            if not self._growth.step():
                self.trouble = self._growth.trouble
                return
