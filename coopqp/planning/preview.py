"""The path ahead of the object's clock: where limits and singularities bind, and how fast the object may go.

Under acceleration limits no single step can keep both the chain and the path at a limit: all arms have to brake
together, ahead of it. The preview runs the chain's own inverse kinematics ahead of the clock, knot by knot, and
stores the joints' derivatives with respect to the clock, ``q′ = A⁻¹ν`` and ``q″``. With rate σ the joints move at
``q′σ`` and accelerate at ``q′σ̇ + q″σ²``. Speeds bound ``z = σ²`` at each knot. A backward pass over the knots finds K,
the largest z from which the object can go on within the accelerations (see :mod:`coopqp.planning.sharing`), down to a
stop at the end of what is known. The rate of a step keeps ``σ² ≤ K`` in its middle and at its end. It is path timing on
a rolling horizon: as long as the object needs to stop, and no longer.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.checks import as_count, keep_scalars
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.planning.redundancy import LimitAvoidance
from coopqp.planning.sharing import Interval, Share, largest_alone, largest_square
from coopqp.spatial import Array, for_twists
from coopqp.task.guarded import FASTEST_PATH, GuardedPath, pose_distance
from coopqp.task.path import ObjectPath
from coopqp.task.posture import Posture


@dataclass(frozen=True, kw_only=True)
class PreviewOptions:
    """Settings of the preview.

    Attributes:
        cell: longest interval between knots [s of the clock].
        joint_step: largest joint motion between knots [rad or m].
        slope_step: largest change of a joint's slope between knots, as a share of the largest slope and of its speed.
        shortest: intervals between knots are not halved below this [s].
        margin: η, share of velocity and acceleration limits that is planned with where acceleration is limited.
        curvature_share: κ, share for z = σ² of a further constraint that bounds z and σ̇ at once; and of the planned
            accelerations, where no acceleration is limited.
        doubt: share of the differences of q″ at a knot that stands for what the path does between knots.
        rate_slope: σ̇_max, largest change of the rate [1/s], where acceleration is limited.
        singular_rate: a rate cap below this, while joint speeds still rise, ends the path there, unless they fall
            again before it is below 0.3 of this.
        newton_steps: the chain's Newton steps that one control step may take. Where these are too few to see as far as
            the object needs to stop, it slows down.
    """

    cell: float = 0.02
    joint_step: float = 0.02
    slope_step: float = 0.1
    shortest: float = 1e-6
    margin: float = 0.95
    curvature_share: float = 0.5
    doubt: float = 0.3
    rate_slope: float = 10.0
    singular_rate: float = 1e-2
    newton_steps: int = 40

    def __post_init__(self) -> None:
        keep_scalars(self, "cell", "joint_step", "slope_step", "shortest", "rate_slope")
        keep_scalars(self, "margin", "curvature_share", "singular_rate", high=1.0)
        keep_scalars(self, "doubt", open_low=False)
        object.__setattr__(self, "newton_steps", as_count(self.newton_steps, "PreviewOptions: newton_steps"))

    def slope(self, *, accelerates: bool, dt: float) -> float:
        """Largest change of the rate [1/s] of joints with or without acceleration limits."""
        return self.rate_slope if accelerates else 1.0 / (_STEPS_TO_FULL_SPEED * dt)


@dataclass(frozen=True, eq=False)
class PlanLimits:
    """The limits that the path ahead is planned with.

    Attributes:
        speed, acceleration: of each joint (nv,).
        jump: change of velocity that a joint can take within one step, at a corner or at the path's end (nv,).
        slope_change: change of slope between knots that is always allowed (nv,).
    """

    speed: Array
    acceleration: Array
    jump: Array
    slope_change: Array

    @staticmethod
    def of(cell: RobotCell, options: PreviewOptions, *, dt: float) -> PlanLimits:
        """A share of the cell's limits.

        A joint without acceleration limit may still not change its velocity so fast that a step's linearisation fails:
        it is planned with a change of full speed in a number of steps, and without speed cap, which the step itself
        finds. A jump of its velocity is the step's business.
        """
        limits, finite = cell.limits, np.isfinite(cell.limits.acceleration)
        speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        planned = options.margin * limits.acceleration
        return PlanLimits(
            np.where(finite, options.margin, 1.0) * limits.velocity,
            np.where(finite, planned, speed / (_STEPS_TO_FULL_SPEED * dt)),
            np.where(finite, planned, np.inf) * dt,
            options.slope_step * speed,
        )


class KnotRoom(NamedTuple):
    """What further constraints leave at a knot.

    Attributes:
        cap: largest σ²; negative where not even rest is admissible.
        decrease, rise: largest changes of σ [1/s].
        name: of the constraint that makes the cap.
    """

    cap: float
    decrease: float
    rise: float
    name: str


#: What further constraints leave at the knot at (clock, q, q′, q″). It may raise :class:`LookAheadTrouble`.
KnotBound = Callable[[float, Array, Array, Array], KnotRoom]


class LookAheadTrouble(Exception):  # noqa: N818
    """A user's path, or a further constraint, cannot say what is ahead. Growth waits; the next step asks again."""


class _Knot(NamedTuple):
    """The chain at one clock."""

    clock: float
    q: Array
    slope: Array  # q′ (nv,)
    curvature: Array  # mean of q″ (nv,) since the knot before
    span: float  # since the knot before [s]; 0 where there is none, or the knot is the same one again
    cap: float  # largest σ² here, whatever is ahead
    uncapped: float  # bound of σ² that speed and curvature would make, whether speed makes the cap or not
    binding: BindingLimit | None  # what makes the cap
    fastest: float  # largest |q′|
    change: float  # largest change of a slope since the knot before, less the change that is always allowed
    inside: bool  # all joints are inside their position limits
    corner: bool = False  # q′ jumps here
    fall: float = np.inf  # largest fall of σ by further constraints [1/s]
    rise: float = np.inf  # largest rise of σ by them [1/s]
    square: float = 0.0  # K: largest σ² here from which the object can go on
    cause: BindingLimit | None = None  # what makes K
    stops: bool = False  # it stops the object for good
    share: Share | None = None  # how K follows from that at the next knot
    since: float = 0.0  # K at the next knot that it was found from


class _Least(NamedTuple):
    """The least K of a step.

    Attributes:
        square: K.
        slope: its slope over the step's rate.
        cause: the knot that makes it.
    """

    square: float
    slope: float
    cause: _Knot

    def met_by(self, rate: float) -> float:
        """The rate σ with ``σ² = K + slope (σ − rate)``."""
        half = 0.5 * self.slope
        return half + math.sqrt(max(half * half + self.square - self.slope * rate, 0.0))


#: A joint without acceleration limit is planned to reach full speed in this many steps, and so is the rate.
_STEPS_TO_FULL_SPEED = 22
#: A singularity is passed where the rate's cap stays above this share of the one that ends the path.
_PASSABLE = 0.3
#: An interval is longer than the one before by this factor at most.
_GROWTH = 2.0
#: Intervals shorter than this are not halved for a change of slope [s].
_FINE_CELL = 1e-3
#: A slope that changes by more than this share within a short interval is of another branch.
_OTHER_BRANCH = 0.5
#: Intervals are halved where q″ changes by more than this share of the accelerations.
_BEND_CHANGE = 0.3
#: The backward pass runs once for so many knots.
_KNOTS_PER_PASS = 4
#: Guesses of the largest rate, the share by which they stay below a line's, and the smallest rate that is not 0.
_MOST_GUESSES, _SHORT_OF, _LEAST_RATE = 44, 1e-14, 1e-9
#: The twist before a corner or the end is taken this much earlier [s].
_JUST_BEFORE = 1e-10
#: A knot is begun this many steps before it is needed.
_STEPS_TO_GROW = 8
#: Newton steps that a reset may take, that its first knot may take, and that every other knot may take.
_NEWTON_STEPS_AT_START, _STARTING_STEPS, _MOST_TRIES = 1000, 8, 4
#: Knots that are kept at most, and knots of a way past a singularity.
_MOST_KNOTS, _LONGEST_WAY = 1024, 300
#: Arms with few joints can follow a path if no more than this is left where Newton's method ends [m, rad].
_FOLLOWED = 1e-4
#: Newton steps shorter than this are the last: the next would be of the square of it [rad or m].
_CONVERGED = 1e-5


class PathPreview:
    """Rolling preview of one path for one chain.

    Args:
        chain: a workspace; what it held is overwritten.
        path: the object's path.
        posture: what redundant arms do with their freedom.
        dt: nominal length of a control step [s].
        options: settings.
        bound: what further constraints leave of the rate at a knot.

    Attributes:
        ends: what makes the latest cap stops the object for good.
        blind: arms with fewer than six joints cannot follow the path; nothing is known ahead.
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
    ) -> None:
        self._chain, self._path, self._posture, self._dt = chain, GuardedPath(path), posture, dt
        self._duration = self._path.duration
        self.options = options or PreviewOptions()
        limits = chain.cell.limits
        n = chain.nv
        self._step, self._slope, self._errors = np.zeros(n), np.zeros(n), np.zeros((chain.n_arms, 6))
        self._low, self._high = limits.lower, limits.upper
        self._cell, self._bound, self._avoidance = chain.cell, bound, LimitAvoidance(chain)
        self.accelerates = bool(np.isfinite(limits.acceleration).any())
        plan = self._plan = PlanLimits.of(chain.cell, self.options, dt=dt)
        self._speed, self._acceleration = plan.speed, plan.acceleration
        self._jump, self._slope_change = plan.jump, plan.slope_change
        self._slope_cap = self.options.slope(accelerates=self.accelerates, dt=dt)
        if self.accelerates:
            self._slope_cap *= 0.9
        self._begun, self._breakpoints = pin.neutral(chain.cell.model), list[float]()
        self._knots: deque[_Knot] = deque()
        self._way: list[_Knot] = []  # past a singularity, while it is looked for
        self._known = 0  # first knots whose K is known for good
        self._fresh = 0  # knots since the last backward pass
        self._complete = self.ends = self.blind = False
        self.trouble = self._trouble = ""
        self._forget()

    def _forget(self) -> None:
        """Nothing is known of when the next knot will be needed, and none is begun."""
        self._free_until, self._begin_at = -np.inf, np.inf
        self._beyond, self._beyond_at = "", np.inf  # a constraint that allows no rate, and the clock
        self._growing: Iterator[None] | None = None
        self._grown = 0  # Newton steps of the growth that is under way
        self._way.clear()

    def reset(self, q: Array, clock: float) -> None:
        """Start at a configuration on (or near) the path, and look ahead as far as the first step needs."""
        self._knots.clear()
        self._known = self._fresh = 0
        self._complete = self.ends = self.blind = False
        self._forget()
        self._begun, self._breakpoints = q, self._path.breakpoints()
        try:
            self._start(q, clock)
        except LookAheadTrouble as trouble:  # nothing is known ahead: the object rests, and the next step tries again
            self.trouble = str(trouble)
            return
        self._extend(clock, self._dt, _NEWTON_STEPS_AT_START)

    def _start(self, q: Array, clock: float) -> None:
        """The first knot."""
        pose = self._path.pose(clock)
        if pose is None:
            raise LookAheadTrouble(self._path.problem)
        q, errors = newton(self._chain, pose, q, tolerance=1e-10, max_iter=_STARTING_STEPS)
        self.blind = self._beyond_few_joints(errors)
        if not np.abs(errors).max() < 1e-6 and not self.blind:
            arm = int(np.abs(errors).max(axis=1).argmax())
            self._slope[:] = 0.0
            self._block(self._knot_at(clock, q, None), arm, LimitKind.REACH)
            return
        if not self._newton_step(clock, q, before=0.0):
            self._slope[:] = 0.0
        self._push(self._knot_at(clock, q, None))

    @property
    def knows(self) -> bool:
        """Whether anything is known ahead."""
        return len(self._knots) > 0

    def memory(self) -> Any:
        """What a copy of this preview goes on from."""
        return (
            list(self._knots), self._known, self._fresh, self._complete, self.ends, self.blind, self._free_until,
            self._begin_at, self._beyond, self._beyond_at, self._begun, list(self._breakpoints),
            0 if self._growing is None else self._grown,
        )  # fmt: skip

    def restore(self, memory: Any) -> None:
        """Go on from what :meth:`memory` returned; growth that was under way is done again up to there."""
        knots, self._known, self._fresh, self._complete, self.ends, self.blind, *rest = memory
        self._free_until, self._begin_at, self._beyond, self._beyond_at, self._begun, self._breakpoints, grown = rest
        self._knots, self._growing = deque(knots), None
        self._way.clear()
        begin_at = self._begin_at
        for _ in range(grown):
            self._work_ahead()
        self._begin_at = begin_at

    # -- reading -------------------------------------------------------------------------------------------------

    def cap(self, clock: float, dt: float) -> tuple[float, BindingLimit | None]:
        """Largest admissible rate σ at ``clock`` for a step of ``dt``, and what ahead makes it less than 1."""
        self.trouble = ""
        if self.blind:
            return 1.0, None
        if not self._knots:
            self.reset(self._begun, clock)
            if not self._knots:
                return 0.0, None
        if clock < self._free_until and dt <= self._dt:
            if clock >= self._begin_at:
                self._work_ahead()
            return 1.0, None
        self._extend(clock, dt, self.options.newton_steps)
        if not self._complete and not self._reaches(clock + _STEPS_TO_GROW * dt, dt):
            self._work_ahead()
        self.ends = False
        least = self._least(clock, 1.0, dt)
        if least.square >= 1.0:
            self._free_until = self._free(dt)
            self._begin_at = self._free_until - _STEPS_TO_GROW * self._dt if self._free_until < np.inf else np.inf
            return 1.0, None
        rate, cause = self._largest_rate(clock, dt, least)
        self.ends = cause.stops
        return rate, cause.cause

    def _largest_rate(self, clock: float, dt: float, least: _Least) -> tuple[float, _Knot]:
        """The largest rate below 1 that K admits for a step, and the knot that makes it; 0 is always admissible.

        ``least`` is that of rate 1. K is linear between knots: the next guess is where σ² meets the line that makes
        it, or half way.
        """
        low, high, rate, cause = 0.0, 1.0, 1.0, least.cause
        for _ in range(_MOST_GUESSES):
            guess = (1.0 - _SHORT_OF) * least.met_by(rate)
            rate = guess if low < guess < high else 0.5 * (low + high)
            least = self._least(clock, rate, dt)
            if rate * rate > least.square:
                high = rate
                continue
            low, cause = rate, least.cause
            if (1.0 - 2.0 * _SHORT_OF) * least.met_by(rate) <= rate:
                break
        return low if low >= _LEAST_RATE else 0.0, cause

    def _least(self, clock: float, rate: float, dt: float) -> _Least:
        """The least K of a step: in its middle, at its end, and at the knots on its way."""
        knots = self._knots
        i = self._knot_before(clock)
        least = _Least(np.inf, 0.0, knots[i])
        for part in (0.5 * dt, dt):
            at = clock + rate * part
            while i + 1 < len(knots) and knots[i + 1].clock <= at:
                i += 1
                if knots[i].square < least.square:
                    least = _Least(knots[i].square, 0.0, knots[i])
            square, slope, made_by = self._square_after(i, at)
            if square < least.square:
                least = _Least(square, slope * part, made_by)
        return least

    def _square_after(self, i: int, clock: float) -> tuple[float, float, _Knot]:
        """K between knot ``i`` and the next one, its slope over the clock, and the knot that makes it."""
        here = self._knots[i]
        if i + 1 == len(self._knots):
            return here.square, 0.0, here
        ahead = self._knots[i + 1]
        slope = (ahead.square - here.square) / (ahead.clock - here.clock)
        return here.square + (clock - here.clock) * slope, slope, ahead if slope < 0.0 else here

    def _free(self, dt: float) -> float:
        """Clock until which the known horizon lets the object go on at full rate."""
        clock = -np.inf
        for knot in self._knots:
            if knot.square < 1.0:
                return clock - 2.0 * max(dt, self._dt)
            clock = knot.clock
        return np.inf if self._complete else clock - 2.0 * max(dt, self._dt)

    def _knot_before(self, clock: float) -> int:
        """Number of the last knot at or before ``clock``."""
        knots = self._knots
        i = 0
        while i + 1 < len(knots) and knots[i + 1].clock <= clock:
            i += 1
        return i

    def brake(self, clock: float, dt: float, rate: float) -> float:
        """D, the fastest fall of σ from ``rate`` with which the joints still follow the path [1/s]; it may be negative.

        Between two steps of rates σ and σ − x a joint's velocity changes by ``q″ (σ − x/2)² dt − q′ x``. With
        ``c = q″ sign q′`` its limit is kept up to ``x = dt (η a + c σ²) / (|q′| + max(c, 0) σ dt)``, by the tangent at
        x = 0.
        A corner takes the whole acceleration: the rate stays while it is passed.
        """
        if self._next_breakpoint(clock - rate * dt) <= min(clock + rate * dt, self._duration - 1e-9):
            return 0.0
        slope, curvature = self._joints_at(clock)
        speed, bend = np.abs(slope), curvature * np.sign(slope)
        moving = speed > 0.0
        fall = (self._acceleration + bend * rate**2) / (speed + np.maximum(bend, 0.0) * (rate * dt) + ~moving)
        return float(fall[moving].min(initial=np.inf))

    def _joints_at(self, clock: float) -> tuple[Array, Array]:
        """q′ and q″ (nv,) at a clock, from the knots around it.

        q′ is linear between two knots. A knot keeps the mean of q″ since the one before, which belongs to the middle:
        from middle to middle it is linear, but for corners.
        """
        knots, i = self._knots, self._knot_before(clock)
        here = knots[i]
        if i + 1 >= len(knots) or not knots[i + 1].clock > here.clock:
            return here.slope, here.curvature
        ahead, after = knots[i + 1], knots[min(i + 2, len(knots) - 1)]
        share = (clock - here.clock) / (ahead.clock - here.clock)
        border, other = (here, here) if share < 0.5 else (ahead, after)
        towards = 0.0 if border.corner or other.span == 0.0 else abs(share - 0.5)
        curvature = ahead.curvature + towards * (other.curvature - ahead.curvature)
        return here.slope + (clock - here.clock) * ahead.curvature, curvature

    def reference(self, clock: float) -> tuple[Array, Array]:
        """Previewed configuration (nq,) and q′ (nv,) at ``clock``: what redundant arms follow."""
        if not self._knots:
            return self._begun, np.zeros_like(self._slope)
        self._leave_behind(clock)
        here = self._knots[0]
        ahead = self._knots[1] if len(self._knots) > 1 else here
        span = ahead.clock - here.clock
        share = min(max((clock - here.clock) / span, 0.0), 1.0) if span > 0.0 else 0.0
        model = self._cell.model
        slope = here.slope + share * (ahead.slope - here.slope)
        # Quadratic from the knot before: exact to second order, continuous to third.
        q = pin.integrate(model, here.q, 0.5 * (here.slope + slope) * (share * span))
        return q, slope

    # -- building ------------------------------------------------------------------------------------------------

    def _extend(self, clock: float, dt: float, newton_steps: int) -> None:
        """Grow the horizon until K is known for good where a step goes, or by that many Newton steps."""
        for _ in range(newton_steps):
            self._leave_behind(clock)
            if self._complete or self.blind or self._reaches(clock, dt):
                return
            if not self._work_ahead():
                self.trouble = self._trouble
                return

    def _reaches(self, clock: float, dt: float) -> bool:
        """Whether K is known for good where a step from ``clock`` on goes: the horizon's end does not make it."""
        return self._known > 0 and self._knots[self._known - 1].clock > clock + 2.0 * dt

    def _work_ahead(self) -> bool:
        """One Newton step, so that no single control step has to make a whole knot; False where growth has to wait."""
        self._trouble = ""
        if len(self._knots) + len(self._way) + 2 > _MOST_KNOTS:
            return False
        try:
            if self._growing is None:
                self._growing, self._grown = self._grow(self._knots[-1]), 0
                next(self._growing)  # up to its first Newton step
            self._grown += 1
            next(self._growing)
        except StopIteration:
            self._growing, self._begin_at = None, np.inf
            self._way.clear()
        except LookAheadTrouble as trouble:  # the next step tries again
            self._trouble = str(trouble)
            self._growing, self._begin_at = None, np.inf
            self._way.clear()
            return False
        return True

    def _leave_behind(self, clock: float) -> None:
        """Drop the knots that another follows before ``clock``."""
        while len(self._knots) > 1 and self._knots[1].clock <= clock:
            self._knots.popleft()
            self._known = max(self._known - 1, 0)

    def _grow(self, last: _Knot) -> Iterator[None]:
        """Add a knot; pauses before every Newton step."""
        if self._duration - last.clock <= 1e-12:
            self._finish(last)
            return
        knot = yield from self._next(last)
        if self.blind:
            return
        if knot is None and self._half_way(last) < 2.0 * self.options.shortest:
            self._push(
                last._replace(cap=0.0, span=0.0, binding=BindingLimit("", "", LimitKind.CONSTRAINT, self._beyond))
            )
            return
        if knot is None:
            self._push(last._replace(cap=0.0, span=0.0, binding=self._why_no_further(last)))
            return
        crossing = None if knot.inside else self._limit_crossing(last, knot)
        if crossing is not None:
            self._push(crossing)
            return
        way = [knot]
        if knot.uncapped < self.options.singular_rate**2 and knot.fastest > last.fastest:
            way = yield from self._past(knot)
            if not way:
                # Where it is as bad already, the object stays: else it would creep on with every new path.
                stop = last._replace(span=0.0) if last.uncapped < self.options.singular_rate**2 else knot
                self._block(stop, self._singular_arm(knot), LimitKind.SINGULARITY)
                return
        breakpoint_ = self._next_breakpoint(last.clock)
        if abs(way[-1].clock - breakpoint_) < 1e-9 and breakpoint_ < self._duration:
            way[-1] = self._corner(way[-1])
        for knot in way:
            self._push(knot)

    def _next(self, last: _Knot) -> Generator[None, None, _Knot | None]:
        """The knot after ``last``, as far on as the chain can be followed in one go; None where it cannot."""
        options = self.options
        h = min(options.cell, self._duration - last.clock)
        if last.fastest > 0.0:
            h = min(h, options.joint_step / last.fastest)
        if last.span > 0.0 and not last.corner:
            h = min(h, _GROWTH * last.span)
        breakpoint_ = self._next_breakpoint(last.clock)
        if last.clock + h > breakpoint_ - 1e-9:
            h = breakpoint_ - last.clock
        half_way = self._half_way(last)
        if half_way < options.shortest:
            return None
        h = min(h, half_way)
        while True:
            knot = yield from self._try(last, h)
            h *= 0.5
            if knot is not None or h < options.shortest or self.blind:
                return knot

    def _half_way(self, last: _Knot) -> float:
        """Half of what is left between a knot and where a constraint allows no rate [s]."""
        return 0.5 * (self._beyond_at - last.clock)

    def _past(self, knot: _Knot) -> Generator[None, None, list[_Knot]]:
        """The knots from ``knot``, near a singularity, to where the joints slow down; none if there is no way."""
        least = (_PASSABLE * self.options.singular_rate) ** 2
        end = self._next_breakpoint(knot.clock) - 1e-9
        way = self._way
        way.append(knot)
        while len(way) < _LONGEST_WAY and way[-1].clock < end:
            ahead = yield from self._next(way[-1])
            if ahead is None or not ahead.inside or ahead.uncapped < least or ahead.clock > end:
                return []
            way.append(ahead)
            if ahead.fastest < way[-2].fastest:
                return list(way)
        return []

    def _next_breakpoint(self, clock: float) -> float:
        """First clock after ``clock`` at which the twist jumps, the end at the latest [s]."""
        i = bisect_right(self._breakpoints, clock + 1e-9)
        return self._breakpoints[i] if i < len(self._breakpoints) else self._duration

    def _try(self, last: _Knot, h: float) -> Generator[None, None, _Knot | None]:
        """The chain at ``last.clock + h``, or None if Newton's method or the joints' slopes do not follow."""
        clock, options = last.clock + h, self.options
        bend = 0.0 * last.curvature if last.corner else last.curvature
        q = self._cell.moved(last.q, (bend * (0.5 * h) + last.slope) * h)
        for _ in range(_MOST_TRIES):
            yield
            if not self._newton_step(clock, q):
                return None
            largest = float(np.abs(self._step).max())
            if not largest < options.joint_step:
                return None
            q = self._cell.moved(q, self._step)
            if largest < _CONVERGED:
                break
        else:
            return None
        if self._beyond_few_joints(self._errors):
            self.blind = True
            return None
        knot = self._knot_at(clock, q, last)
        if not knot.cap > 0.0:
            return None  # numbers overflow
        if h > options.shortest and not h * knot.fastest <= 1.5 * options.joint_step:
            return None
        fine = h <= _FINE_CELL
        if h > options.shortest and not knot.change <= (_OTHER_BRANCH if fine else options.slope_step) * knot.fastest:
            return None
        if not fine and not self._bends_slowly(knot, last):
            return None
        return self._constrained(knot)

    def _bends_slowly(self, knot: _Knot, last: _Knot) -> bool:
        """Whether q″ has changed by a small share of the accelerations since the interval before."""
        if last.span == 0.0 or last.corner:
            return True
        change = float((np.abs(knot.curvature - last.curvature) / self._acceleration).max())
        if change <= _BEND_CHANGE:
            return True  # at any rate
        z = largest_alone(knot.slope, knot.curvature, self._acceleration, self._slope_cap, knot.cap)
        return change * z <= _BEND_CHANGE

    def _constrained(self, knot: _Knot) -> _Knot | None:
        """A knot under the further constraints; None where they allow no rate."""
        if self._bound is None:
            return knot
        room = self._bound(knot.clock, knot.q, knot.slope, knot.curvature)
        if not room.cap > 0.0:
            self._beyond, self._beyond_at = room.name, knot.clock
            return None
        if room.cap < knot.cap:
            knot = knot._replace(cap=room.cap, binding=BindingLimit("", "", LimitKind.CONSTRAINT, room.name))
        return knot._replace(fall=room.decrease, rise=room.rise)

    def reaches_corner(self, clock: float, way: float) -> bool:
        """Whether the twist jumps within ``way`` [s] of the clock, or the path ends."""
        return self._next_breakpoint(clock) <= clock + way

    def rise(self, clock: float) -> tuple[float, BindingLimit | None]:
        """Largest rise of σ near a clock by further constraints, and by joints that no step limits [1/s]; the joint."""
        if not self._knots:
            return np.inf, None
        i = self._knot_before(clock)
        here, ahead = self._knots[i], self._knots[min(i + 1, len(self._knots) - 1)]
        rise = min(here.rise, ahead.rise)
        if self.accelerates:
            return rise, None
        share = np.maximum(np.abs(here.slope), np.abs(ahead.slope)) / self._acceleration
        j = int(share.argmax())
        if share[j] == 0.0 or 1.0 / share[j] >= rise:
            return rise, None
        return 1.0 / float(share[j]), self._joint_limit(j, LimitKind.ACCELERATION)

    def _beyond_few_joints(self, errors: Array) -> bool:
        """Whether errors (N, 6) are left that arms with few joints cannot make up for."""
        few = errors[list(self._chain.deficient)]
        return few.size > 0 and not np.abs(few).max() < _FOLLOWED

    def _newton_step(self, clock: float, q: Array, *, before: float = _JUST_BEFORE) -> bool:
        """Newton's step from ``q`` to the pose at ``clock``, and q′ there; False if singular.

        q′ is that for the twist a moment ``before`` the clock [s], which tells the sides of a jump apart.
        """
        chain, path = self._chain, self._path
        pose = path.pose(clock)
        twist = None if pose is None else path.twist(max(min(clock, self._duration) - before, 0.0))
        if pose is None or twist is None:
            raise LookAheadTrouble(path.problem)
        errors = self._errors = chain.errors(chain.carried(q), pose)
        if not np.abs(errors).max() < np.inf:
            return False
        chain.linearise(q, about=pose.translation)
        to_world = for_twists(pose.rotation)
        along = to_world @ twist
        step, slope = self._step, self._slope
        chain.joint_velocities(-errors @ to_world.T, step)
        chain.joint_velocities(np.broadcast_to(along, (chain.n_arms, 6)), slope)
        if chain.redundancy:
            slope += chain.null_part(self._posture.velocity(q))
            self._avoidance.lead_away(self._cell.positions(q), slope)
        return bool(step @ step + slope @ slope < np.inf)

    def _knot_at(self, clock: float, q: Array, last: _Knot | None) -> _Knot:
        """Bounds at a configuration on the path, from the slopes there (of the last Newton step) and those before."""
        slope = self._slope.copy()
        before, span = (slope, 1.0) if last is None else (last.slope, clock - last.clock)
        speed, curvature = np.abs(slope), (slope - before) / span
        bend = np.abs(curvature)
        # How often each joint's limit is used up at full rate: z may be 1 over the square, or over the curvature's.
        use_speed, use_bend = speed / self._speed, bend / (self.options.curvature_share * self._acceleration)
        j_speed, j_bend = int(use_speed.argmax()), int(use_bend.argmax())
        by_speed, by_bend = float(use_speed[j_speed]) ** 2, float(use_bend[j_bend])
        # Without acceleration limits the step itself finds the cap by speed; it changes slowly under that by curvature.
        cap = 1.0 / max(by_speed if self.accelerates else by_bend, 1.0)
        binding = None
        if cap < 1.0:
            binding = (
                self._joint_limit(j_speed, LimitKind.VELOCITY)
                if self.accelerates
                else self._joint_limit(j_bend, LimitKind.ACCELERATION)
            )
        x = self._cell.positions(q)
        return _Knot(
            clock=clock,
            q=q,
            slope=slope,
            curvature=curvature,
            span=0.0 if last is None else span,
            cap=cap,
            uncapped=1.0 / max(by_speed, by_bend, 1.0),
            binding=binding,
            fastest=float(np.abs(slope).max()),
            change=float((bend * span - self._slope_change).max()),
            inside=bool(((x <= self._high) & (x >= self._low)).all()),
        )

    def _finish(self, last: _Knot) -> None:
        """The end of the path: where it ends moving, the joints have one step to stop in."""
        if self.accelerates:
            end = self._jump_cap(np.zeros_like(last.slope), last.slope)
            if end < last.cap:
                self._push(last._replace(cap=end, span=0.0, binding=BindingLimit("", "", LimitKind.PATH_END)))
        self._complete = True
        self._look_back()

    def _corner(self, knot: _Knot) -> _Knot:
        """A knot where the twist jumps: slopes after it, and the rate at which the joints can take the jump."""
        moves = self._newton_step(knot.clock + 1e-9, knot.q)
        after = self._slope.copy() if moves else np.zeros_like(knot.slope)
        cap, binding = knot.cap, knot.binding
        if self.accelerates:
            use_speed = np.abs(after) / self._speed
            by_speed = 1.0 / max(float(use_speed.max()) ** 2, 1.0)
            if by_speed < cap:
                cap, binding = by_speed, self._joint_limit(int(use_speed.argmax()), LimitKind.VELOCITY)
            jump = self._jump_cap(after, knot.slope)
            if jump < cap:
                j = int((np.abs(after - knot.slope) / self._jump).argmax())
                cap, binding = jump, self._joint_limit(j, LimitKind.ACCELERATION)
        fastest = float(np.abs(after).max())
        return knot._replace(slope=after, cap=cap, binding=binding, corner=True, fastest=fastest)

    def _jump_cap(self, after: Array, before: Array) -> float:
        """Largest σ² at which every joint can change its slope within one step."""
        jump = np.abs(after - before)
        moving = jump > 1e-9
        if not moving.any():
            return np.inf
        return float((self._jump[moving] / jump[moving]).min() ** 2)

    def _limit_crossing(self, last: _Knot, knot: _Knot) -> _Knot | None:
        """Where the first joint meets a position limit between two knots, as a knot at which the object rests."""
        x, ahead = self._cell.positions(last.q), self._cell.positions(knot.q)
        # A joint outside may come back in; only going further out is the end.
        over = (ahead > np.maximum(self._high, x)) & (ahead > self._high)
        under = (ahead < np.minimum(self._low, x)) & (ahead < self._low)
        crossed = np.flatnonzero(over | under)
        if not crossed.size:
            return None
        limit = np.where(over[crossed], self._high[crossed], self._low[crossed])
        shares = np.clip((limit - x[crossed]) / (ahead[crossed] - x[crossed]), 0.0, 1.0)
        first = int(shares.argmin())
        j = int(crossed[first])
        at = self._knot_where(last, knot, j, float(limit[first]))
        return at._replace(cap=0.0, span=at.clock - last.clock, binding=self._joint_limit(j, LimitKind.POSITION))

    def _knot_where(self, last: _Knot, beyond: _Knot, j: int, position: float) -> _Knot:
        """The knot at which joint ``j`` is at ``position``, between two knots: regula falsi on the chain itself."""
        positions = self._cell.positions
        start, end = last.clock, beyond.clock
        miss_start, miss_end = (positions(k.q)[j] - position for k in (last, beyond))
        if miss_start * miss_end >= 0.0:
            return last  # it is there already
        best = beyond
        for _ in range(8):
            clock = start - miss_start * (end - start) / (miss_end - miss_start)
            knot = _whole(self._try(last, clock - last.clock)) if clock - last.clock > 1e-9 else last
            if knot is None:
                break
            best, miss = knot, float(positions(knot.q)[j] - position)
            if abs(miss) < 1e-9:
                break
            if miss * miss_end > 0.0:
                end, miss_end = clock, miss
            else:
                start, miss_start = clock, miss
        return best

    def _block(self, knot: _Knot, arm: int, kind: LimitKind) -> None:
        """The object stops at ``knot``."""
        self._push(knot._replace(cap=0.0, binding=self._arm_limit(arm, kind)))

    def _why_no_further(self, last: _Knot) -> BindingLimit:
        """Why the chain cannot be followed past a knot: a user's path jumps there, or an arm's reach ends."""
        ahead = min(last.clock + 2.0 * self.options.shortest, self._duration)
        here, there = self._path.pose(last.clock), self._path.pose(ahead)
        if here is None or there is None:
            raise LookAheadTrouble(self._path.problem)
        if pose_distance(here, there) > FASTEST_PATH * (ahead - last.clock):
            return BindingLimit("", "", LimitKind.PATH_JUMP)
        return self._arm_limit(self._singular_arm(last), LimitKind.REACH)

    def _singular_arm(self, knot: _Knot) -> int:
        share = np.abs(knot.slope) / np.where(np.isfinite(self._speed), self._speed, 1.0)
        return self._cell.arm_of_joint(int(share.argmax()))

    def _joint_limit(self, j: int, kind: LimitKind) -> BindingLimit:
        arm, _, joint = self._cell.joint_names[j].partition("/")
        return BindingLimit(arm, joint, kind)

    def _arm_limit(self, arm: int, kind: LimitKind) -> BindingLimit:
        return BindingLimit(self._cell.arm_names[arm], "", kind)

    def _push(self, knot: _Knot) -> None:
        self._knots.append(knot)
        self._fresh += 1
        if knot.cap == 0.0:
            self._complete = True  # nothing comes after a stop
        if self._complete or self._fresh >= _KNOTS_PER_PASS:
            self._look_back()

    # -- sharing the accelerations -------------------------------------------------------------------------------

    def _look_back(self) -> None:
        """Find K from the last knot back to the first one whose K is known for good.

        Where more knots may come the object rests at the last knot but one: q″ is not known at the last. K only rises
        from one pass to the next, and a knot keeps how its K follows from the one ahead.
        """
        self._fresh = 0
        knots = self._knots
        end = len(knots) - (1 if self._complete else 2)
        if end < 0:
            return
        last, settled = knots[end], 0
        if self._complete:
            knots[end] = last._replace(square=last.cap, cause=last.binding, stops=last.cap == 0.0)
            settled = len(knots)
        for i in range(end - 1, self._known - 1, -1):
            here, ahead = knots[i], knots[i + 1]
            share, since = here.share, here.since
            if share is None or not since <= ahead.square <= share.until or ahead.square >= 1.0:
                share, since = self._share(i), ahead.square
            square = share.square + share.gain * (ahead.square - since)
            for_good = not share.ahead
            if for_good and not settled:
                settled = i + 1
            if share.ahead and (ahead.square < 1.0 or share.joint < 0):
                cause, stops = ahead.cause, ahead.stops
            elif share.joint >= 0:
                cause, stops = self._joint_limit(share.joint, LimitKind.ACCELERATION), False
            else:
                cause, stops = here.binding, here.cap == 0.0
            knots[i] = here._replace(square=square, cause=cause, stops=stops, share=share, since=since)
        self._known = max(settled, self._known)

    def _share(self, i: int) -> Share:
        """K at knot ``i`` from that at the next one."""
        here, ahead = self._knots[i], self._knots[i + 1]
        if ahead.span == 0.0:  # the same knot again
            by_ahead = ahead.square < here.cap
            return Share(min(ahead.square, here.cap), float(by_ahead), here.cap if by_ahead else np.inf, -1)
        chord, span = ahead.curvature, ahead.span
        bend = bend_ahead = chord
        if here.span > 0.0 and not here.corner:
            bend = (here.curvature * span + chord * here.span) / (here.span + span)
        if i + 2 < len(self._knots) and not ahead.corner:
            beyond = self._knots[i + 2]
            if beyond.span > 0.0:
                bend_ahead = (chord * beyond.span + beyond.curvature * span) / (span + beyond.span)
        interval = Interval(
            span,
            here.slope,
            here.slope + chord * span,
            chord,
            bend,
            bend_ahead,
            min(self._slope_cap, here.fall, ahead.fall),
            min(self._slope_cap, here.rise, ahead.rise),
        )
        return largest_square(interval, self._acceleration, here.cap, ahead.square, doubt=self.options.doubt)


def _whole(pieces: Generator[None, None, _Knot | None]) -> _Knot | None:
    """The result of work that pauses, without the pauses."""
    while True:
        try:
            next(pieces)
        except StopIteration as done:
            knot: _Knot | None = done.value
            return knot
