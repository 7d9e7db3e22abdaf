"""The plain loop: the definition of a step in NumPy, written to be read. It runs where the core does not apply.

``observe`` takes a sample and advances the filters; ``propose`` finds the command; ``commit`` moves the state. The
core's counterpart is ``step.cpp``.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.constraints.cause import Cause
from coopqp.constraints.velocity import ConstraintTrouble, Rows, no_rows
from coopqp.control.interface import NO_SOLVE, ControlStep, Status
from coopqp.control.lock import Lock
from coopqp.control.lookahead.constraints import ConstraintsAhead
from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.control.lookahead.preview import PathPreview
from coopqp.control.monitoring.commanded import OFF_WAY, PARTED, ChainWatch, among_arms, expected
from coopqp.control.monitoring.servos import ServoWatch
from coopqp.control.monitoring.supervision import Supervision
from coopqp.control.monitoring.watch import Watch
from coopqp.control.operator.way import Way
from coopqp.control.options import QPOptions
from coopqp.control.step.braking_rows import BrakingRows
from coopqp.control.step.constraint_set import Constraints
from coopqp.control.step.contact import Contact, filter_time, handed
from coopqp.control.step.linearised import LinearisedAnswer, LinearisedStep, StepInput, mean_error
from coopqp.control.step.priorities import StepSolver
from coopqp.control.step.rate_cap import OVERRIDE, RateCap
from coopqp.control.step.state import LoopState, Observed, Proposal
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.control.step.verdict import away_from_path, cause_of, given_up, lasting, rests, slow_status, too_close
from coopqp.control.step.views import view_errors
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp, mean_pose
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.posture import Posture
from coopqp.native.constants import (
    FAR_FROM_WAY,
    LEAST_PACE,
    MOST_PACES,
    MOST_TIGHTENINGS,
    MOST_TRAVELS,
    NEGLIGIBLE,
    OFF_PACE,
    RATE_TOLERANCE,
    SAID_APART,
    SAME_CLOCK,
    SAME_PACE,
    STANDING,
    TURN_LENGTH,
)
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.guarded import GuardedPath, jump
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array

#: Twists (…, 6) in metres: a turn of 1 rad counts as :data:`TURN_LENGTH`.
_UNIT_OF_TWISTS = np.array([1.0] * 3 + [TURN_LENGTH] * 3)


def farthest(twists: Array) -> float:
    """The largest length of twists (…, 6) [m]."""
    return float(np.linalg.norm(twists * _UNIT_OF_TWISTS, axis=-1).max())


@final
class PlainLoop:
    """See the module's description.

    Args:
        cell, grasp: the arms, and how they hold the object.
        dt: nominal length of a step [s].
        options: settings.
        constraints: further constraints.
    """

    kernel = "plain"

    def __init__(
        self, cell: RobotCell, grasp: Grasp, *, dt: float, options: QPOptions, constraints: Constraints
    ) -> None:
        self.cell, self.grasp, self.dt, self.options, self._on_path = cell, grasp, dt, options, options
        lock = Lock()
        self.hold, self.release = lock.hold, lock.release
        self.steps_here, self.steps_elsewhere = lock.steps_here, lock.steps_elsewhere
        self.looks_in = 1  # steps until the operator looks
        self.constraints = constraints
        self._chain, self._ahead_chain, self._box = Chain(cell, grasp), Chain(cell, grasp), VelocityBox(cell)
        self._ahead_shift = np.zeros((len(cell), 6))
        self._fixed = [pin.SE3.Identity()] * len(cell)
        self._shares = options.common_error.shares(cell)
        self._usual_shares = self._shares.copy()
        self.solver = StepSolver(self._chain, self._box, options)
        self._step = LinearisedStep(self._chain, self._box, self._shares, self.solver, options)
        self._posture = Posture(cell, options.posture)
        self._supervision = Supervision(cell, grasp, options.supervision, dt=dt)
        self._chain_watch = ChainWatch(grasp, options.supervision.apart_from)
        self._rate_cap = RateCap(cell, self._box, options, dt=dt)
        self._restricted = tuple(cell.arm_names[k] for k in self._chain.deficient)
        self._redundant = self._chain.redundancy > 0
        self._no_rows = no_rows(cell.nv)
        plan = PlanLimits.of(cell, options.preview or PreviewOptions(), dt=dt)
        self._braking = BrakingRows(self._chain, plan.acceleration)
        self._preview: PathPreview | None = None
        self.state = LoopState(pin.neutral(cell.model), np.zeros(cell.nv), np.zeros(cell.nv))

    # -- starting --------------------------------------------------------------------------------------------------

    def follow(self, path: ObjectPath, way: Way | None = None) -> None:
        """Take a path, as a way along a program; it begins with :meth:`start_path`."""
        self.path, self._guarded, self._way = path, GuardedPath(path), way or Way.of(path)
        self._on_path = self.options.on(self._guarded.planned_share)
        self._motion = self._guarded.grasps
        self.contact = None if self._motion is None else Contact(self.cell, self.grasp, self._motion)
        if self._motion is None:
            self._chain.place(self._fixed)
            self._chain.apart = ()
            self._shares[:] = self._usual_shares
            self._supervision.hold(np.ones(len(self.cell), dtype=bool))
            self.state.latched = 0.0
        self._posture.take(self._on_path.posture)
        self._preview = None
        if self.options.preview is not None and self._guarded.known_ahead:
            ahead = ConstraintsAhead(self.cell, self.constraints, self.options.preview.curvature_share, dt=self.dt)
            self._preview = PathPreview(
                self._ahead_chain,
                path,
                self._posture,
                dt=self.dt,
                options=self._on_path.preview and self._on_path.preview.along(self._guarded.duration),
                bound=ahead.bound if self.constraints else None,
                evade=ahead.evade if self.constraints.evades and not self._guarded.keeps_clear else None,
                shift=self._ahead_shift,
            )

    def take_shift(self, shift: Array) -> Callable[[], bool]:
        """The tools hold the object shifted by (N, 6) after each call of the returned function; False if not finite."""

        def taken() -> bool:
            if not np.isfinite(shift).all():
                return False
            self._chain.shift_grasp(shift)
            self._ahead_shift[:] = shift
            s, change = self.state, among_arms(self.state.grasp_shift - shift)
            s.mismatch = change if s.mismatch is None else s.mismatch + change
            s.asked_shift = -change if s.asked_shift is None else s.asked_shift - change
            s.grasp_shift = shift.copy()
            return True

        return taken

    #: The object's reference pose in the last step.
    reference = pin.SE3.Identity()

    def take_minding(self, memory: Array) -> None:
        """Monitor forces, too: compare the arms with the wrenches that the owner of ``memory`` puts there."""
        self._supervision.servos = ServoWatch(memory, self.cell.arm_names, self.cell.groups)

    def start(self, q: Array) -> None:
        """Start at rest at ``q``; forget everything."""
        self.solver.reset()
        self._supervision.reset()
        self._posture.reset(q)
        reins = self.state.reins.started(self.options.blocked_rate)
        still, shift = np.zeros(self.cell.nv), self.state.grasp_shift
        self.state = LoopState(q, still, still.copy(), last_dt=self.dt, reins=reins, grasp_shift=shift)

    def start_path(self, clock: float = 0.0, rate: float | None = None) -> None:
        """Start along the path from ``clock`` on."""
        s = self.state
        s.clock, s.first, s.predicted, s.foreseen = clock, True, None, 0.0
        s.taken = clock - SAME_CLOCK
        s.away, s.status = math.inf, Status.TRACKING
        s.rate, s.rate_slope = (0.0 if self._box.accelerates else s.reins.share) if rate is None else rate, 0.0
        self.look_ahead_again()

    def take_path(self) -> None:
        """The path has changed: nothing of it is kept here."""

    def look_ahead_again(self, rate: float | None = None) -> None:
        """The path ahead has changed; the object moves along it at a rate."""
        if rate is not None:
            self.state.rate, self.state.rate_slope = rate, 0.0
        self._start_preview(rate=math.inf if rate is None else rate)

    def _start_preview(self, *, later: bool = False, rate: float = math.inf) -> None:
        if self._preview is not None:
            self._preview.reset(self.state.q, self.state.clock, later=later, rate=rate)

    def keep_travels(self, stride: int, *, anew: bool) -> None:
        """Keep the end of every so many steps from now on for :meth:`travels`, 0: of none; ``anew``: forget others."""
        s = self.state
        s.stride = stride
        if anew:
            s.stride_left, s.travelled = stride, []

    def travels(self) -> list[tuple[float, float, Array, Array]]:
        """What was kept since the last time: clock [s], σ, joint positions and velocities (nv,)."""
        kept, self.state.travelled = self.state.travelled, []
        return kept

    def try_step(self) -> tuple[float, Array]:
        """Path speed σ of a step from here, and the change of the joints' velocities in it (nv,); nothing is committed.

        The joints may force a higher rate than the cap; σ is the cap then.
        """
        proposal = self.propose(self.observe(None, None))
        answer = proposal.found.answer
        return 0.0 if answer.braked else min(proposal.given.cap, answer.rate), answer.velocity - self.state.v

    def memory(self) -> Any:
        """All that a copy of this loop needs beside its arguments and its path."""
        preview = None if self._preview is None else self._preview.memory()
        target = self._posture.target
        return copy.deepcopy((self.state, self._supervision.memory(), preview, target))

    def restore(self, memory: Any) -> None:
        """Go on from what :meth:`memory` returned."""
        self.state, supervision, preview, target = copy.deepcopy(memory)
        self._supervision.restore(supervision)
        self._posture.target = target
        if self._preview is not None and preview is not None:
            self._preview.restore(preview)

    def set_reins(self, override: float, *, paused: bool) -> None:
        """Set the override and the pause of the operator, from the next step on."""
        self.state.reins.override, self.state.reins.paused = override, paused

    @property
    def reins(self) -> tuple[float, bool]:
        """Override, and whether the object is paused."""
        return self.state.reins.override, self.state.reins.paused

    @property
    def clock(self) -> float:
        """The object's clock [s]."""
        return self.state.clock

    @property
    def rate(self) -> float:
        """σ of the last step."""
        return self.state.rate

    @property
    def status(self) -> Status:
        """Status of the last step."""
        return self.state.status

    @property
    def q(self) -> Array:
        """Commanded configuration (nq,)."""
        return self.state.q

    @property
    def positions(self) -> Array:
        """Commanded joint positions (nv,)."""
        return self.cell.positions(self.state.q)

    @property
    def velocity(self) -> Array:
        """Commanded joint velocities of the last step (nv,)."""
        return self.state.v

    # -- observe ---------------------------------------------------------------------------------------------------

    def observe(self, q_measured: Any, dt: Any) -> Observed:
        """Take one sample: accept or refuse the inputs, and advance the filters."""
        s, supervision, h, watch, lost = self.state, self._supervision, self.dt, Watch(), False
        if dt is not None:
            trouble = supervision.accept_dt(dt, self.dt)
            if trouble:
                watch = Watch.holding(trouble)
            else:
                h = float(dt)
        measured = None
        if q_measured is not None:
            measured, trouble = supervision.accept_measurement(q_measured, s.q)
            if trouble:
                measured, watch = None, Watch.holding(trouble)
        before = self._shares.copy()
        self._place_grasps(s.clock)
        pose, carried = self._pose(s.clock), self._chain.carried(s.q)
        trouble, s.away = self._guarded.trouble(s.clock, h, carried[0], s.away)
        if trouble:
            measured, watch, lost = None, Watch.holding(trouble), True
            s.predicted, s.foreseen = None, 0.0  # from another reference
            pose = mean_pose(carried, self._shares)
        self.reference = pose
        if s.fault:
            watch = Watch(0.0, hold=True, fault=True, arm=s.fault_arm, reason=s.fault, cause=s.fault_cause)
        seen = Observed(h, pose, carried, view_errors(carried, pose, carried[0]), watch, lost=lost)
        self._watch_chain(seen)
        seen.measured = self._measured_error(seen, measured, before)
        gain = min(self.options.path_gain, 1.0 / h)
        servos, held = supervision.servos, seen.watch.hold and seen.watch.cause is not Cause.CONTACT
        if servos is not None and servos.backs and not held and gain > 0.0:
            way = servos.way_back(pose.rotation, self._mean(seen.errors), h)
            seen.measured = way / -gain
        return seen

    def _pose(self, clock: float) -> pin.SE3:
        pose = self._guarded.pose(clock)
        return mean_pose(self._chain.carried(self.state.q), self._shares) if pose is None else pose

    def _place_grasps(self, clock: float) -> None:
        """Place the tools where they are on the object at a clock [s], and let the arms that hold it make its pose."""
        if self._motion is not None:
            self._chain.place(self._motion.placements(clock))
            self._chain.apart = self._motion.apart(clock)
            holds = self._motion.holds(clock)
            self._shares[:] = self.options.common_error.shares_of(self.cell, holds)
            self._supervision.hold(np.array(holds))

    def _along(self, pose: pin.SE3, clock: float, span: float) -> Array | None:
        """ν of each arm (N, 6), or of all (6,) where grasps are fixed: with M_k its tool's motion on the object,
        ``log(R(τ)⁻¹ R(τ + h) M_k(τ + h) M_k(τ)⁻¹) / h``. None where the path fails.
        """
        ahead = self._guarded.pose(clock + span)
        if ahead is None:
            return None
        way = pose.actInv(ahead)
        if self._motion is None:
            return np.asarray(pin.log6(way).vector) / span
        then, now = self._motion.placements(clock + span), self._motion.placements(clock)
        for k in self._chain.apart:
            then, now = ((*x[:k], pin.SE3.Identity(), *x[k + 1 :]) for x in (then, now))
        return np.array([pin.log6(way * b * a.inverse()).vector for a, b in zip(now, then, strict=True)]) / span

    def _watch_chain(self, seen: Observed) -> None:
        """Name arms that their commands lead apart; hold them where they are too far apart."""
        s, watch = self.state, seen.watch
        apart = seen.apart = self._chain_watch.look(seen.errors, s.mismatch, started=s.started, held=s.chain_held)
        if apart.distance <= SAID_APART:
            return
        arm, other = (self.cell.arm_names[k] for k in apart.arms)
        reason = PARTED.format(arm=arm, other=other, mm=1e3 * apart.distance)
        if apart.holds:
            watch.lower(Watch.holding(reason, Cause.COMMANDED_CHAIN))
        elif not watch.reason:
            watch.reason = reason

    def _mean(self, errors: Array) -> Array:
        return mean_error(self._shares, errors)

    def _measured_error(self, seen: Observed, measured: Array | None, shares: Array) -> Array | None:
        """The object's error (6,) for the path correction, with the measured one; None for the commanded one.

        It is the commanded error plus the further measured error, which fades in slowly. The correction shrinks as the
        arms get out of step, and vanishes while they hold: the measured error of an arm that does not move would lead
        the others away from it without end. ``shares`` (N, 6) are those of the step before.
        """
        s, watch, held = self.state, seen.watch, seen.carried
        if measured is not None:
            held = self._chain.carried(measured)
            away = view_errors(held, seen.pose, seen.carried[0]) - seen.errors
            if s.drift is not None and self._motion is not None:
                s.latched = s.latched + handed(self._shares, shares, away)
            drift, mean = np.zeros(6) if s.drift is None else s.drift, self._mean(away) + s.latched
            time = filter_time(self.options.measurement_time, self._supervision.holds)
            s.drift = drift + seen.h / (seen.h + time) * (mean - drift)
            twist = self._twist(seen.carried[0])
            watch.lower(self._supervision.watch(measured, s.q, away, seen.h, s.v, seen.pose.rotation, twist))
        self._take_contact(watch, held)
        self._watch_ways(watch)
        servos = self._supervision.servos
        corrects = 1.0 if servos is None else servos.corrects  # arms whose forces are monitored relax first
        if watch.hold or (s.drift is None and corrects == 1.0):
            return np.zeros(6) if watch.hold else None
        measured_error = self._mean(seen.errors) + (0.0 if s.drift is None else s.drift)
        error: Array = corrects * watch.rate_cap * measured_error
        return error

    def _take_contact(self, watch: Watch, held: list[pin.SE3]) -> None:
        """Take changes of contact that are due, or hold where an arm that attaches is not where it grasps."""
        s, contact = self.state, self.contact
        if contact is None or not contact.due(s.clock, s.taken):
            return
        if reason := contact.refused(s.clock, s.taken, held):
            watch.lower(Watch.holding(reason, Cause.TRACKING))
        else:
            s.taken = s.clock + SAME_CLOCK

    def _watch_ways(self, watch: Watch) -> None:
        """Hold where an arm is far from the way of its joints: it would rush there."""
        s = self.state
        for k in self._chain.apart:
            columns, motion = self._chain.moving_columns[k], self._motion
            way = None if motion is None else motion.leading(k, s.clock)
            assert way is not None
            off = np.abs(self.cell.positions(s.q)[columns] - way.at(s.clock)[0])
            if off.max() > FAR_FROM_WAY:
                joint = self.cell.joint_names[columns[int(off.argmax())]]
                arm, far = self.cell.arm_names[k], float(off.max())
                watch.lower(Watch.holding(OFF_WAY.format(arm=arm, joint=joint, far=far), Cause.INPUT))

    @property
    def held(self) -> tuple[GraspMotion, float, float] | None:
        """How tools move on the object and who holds it, the clock of that, and up to which changes are taken [s]."""
        return None if self._motion is None else (self._motion, self.state.clock, self.state.taken)

    @property
    def contact_due(self) -> bool:
        """Whether a change of contact is not taken yet."""
        return self.contact is not None and self.contact.due(self.state.clock, self.state.taken)

    def _twist(self, now: pin.SE3) -> Array:
        """The twist of the object in the last step as commanded, in its own frame (6,) [m/s, rad/s]."""
        s = self.state
        before = self._chain.carried(self.cell.moved(s.q, -s.last_dt * s.v))[0]
        twist: Array = np.asarray(pin.log6(before.actInv(now)).vector) / s.last_dt
        return twist

    # -- propose ---------------------------------------------------------------------------------------------------

    def propose(self, seen: Observed) -> Proposal:
        """Find the command."""
        s, h = self.state, seen.h
        further = self._no_rows
        if self.constraints.velocity:
            try:
                further = self.constraints.rows(s.q, h, blind=self._no_horizon)
            except ConstraintTrouble as trouble:
                seen.watch.lower(Watch.holding(str(trouble), trouble.cause))
                further = self._no_rows if trouble.rows is None else trouble.rows
        if s.lost and not seen.lost:
            self._start_preview(later=True)  # the known horizon is void after the path has failed
        s.lost = seen.lost
        cap, binding, keep = self._rate_cap.find(s, seen, self._preview)
        measured = seen.measured if keep >= 1.0 else self._brake_correction(keep, seen)
        rest = self._guarded.duration - s.clock
        if rest < h * cap:
            cap = rest / h  # the last step ends at the end
        pace = min(cap, max(s.rate + s.rate_slope * h, 0.0))  # it goes on to change as it did
        if self._preview is not None and self._preview.reaches_corner(s.clock, h * cap):
            pace = cap  # the mean along the path has to see the corner
        span = min(h * max(pace, LEAST_PACE), rest)
        along = np.zeros(6)
        if span > 1e-12 and not seen.lost:
            ahead = self._along(seen.pose, s.clock, span)
            if ahead is None:
                seen.watch.lower(Watch.holding(self._guarded.problem))
                cap = 0.0
            else:
                along = ahead
        if self._brakes_together:
            about, gives_way = seen.carried[0].translation, self._gives_way
            further = further.and_also(
                self._braking.rows(s.q, s.v, h, about, gives_way=gives_way, hold=seen.watch.hold)
            )
        null_along, null_offset = self._wishes(span, h, hold=seen.watch.hold)
        asked = None if s.predicted is None else s.asked_shift
        given = StepInput(
            s.q, self.cell.positions(s.q), seen.carried, seen.errors, s.v, s.v_before, h, cap, seen.pose, span, along,
            measured, s.predicted, s.foreseen, s.last_dt, asked, null_along, null_offset, further, s.first,
            seen.watch.hold,
        )  # fmt: skip
        return Proposal(seen, given, self._tightened(given, lost=seen.lost), binding)

    @property
    def _no_horizon(self) -> bool:
        """Whether no look-ahead brakes for further constraints."""
        return self._preview is None or self._preview.no_horizon

    @property
    def _brakes_together(self) -> bool:
        """Whether no look-ahead covers the motion: none has one, or arms that give way have left their path."""
        return self._no_horizon or self._gives_way

    @property
    def _gives_way(self) -> bool:
        """Whether arms that give way have left their path, under acceleration limits."""
        return self.constraints.gives_way and self._box.accelerates and self.state.correcting is not None

    def _tightened(self, given: StepInput, *, lost: bool) -> LinearisedAnswer:
        """The answer; again with tighter rows where it violates their constraints."""
        linearised = self._at_pace(given, lost=lost)
        for _ in range(MOST_TIGHTENINGS):
            v = linearised.answer.velocity
            rows = self.constraints.tightened(given.further, self.cell.moved(given.q, given.h * v), v, given.h)
            if rows is None:
                break
            given.further = rows
            linearised = self._at_pace(given, lost=lost)
        return linearised

    def _at_pace(self, given: StepInput, *, lost: bool) -> LinearisedAnswer:
        """The answer; again where it takes the object elsewhere than the path is after its share of the clock.

        ν is the mean over the share that was expected. Another share that was answered asks for another mean: where the
        cap makes it, for that over the share itself, else for that over the share at which both will be the same.
        """
        h, clock, rest = given.h, self.state.clock, self._guarded.duration - self.state.clock
        linearised, before = self._step.answer(given), None
        for _ in range(MOST_PACES):
            rate, last, span = linearised.answer.rate, given.along, given.span
            way = min(h * max(rate, LEAST_PACE), rest)
            if lost or not rate > 0.0 or abs(way - span) <= SAME_PACE * way:
                break
            along = self._along(given.pose, clock, way)
            if along is None or rate * h * farthest(along - last) <= OFF_PACE:
                break
            saved = span - way
            if rate < given.cap - RATE_TOLERANCE:
                if before is None:  # to first order, where the path is as far on as the answer leads
                    weighed, change = ((x * _UNIT_OF_TWISTS).ravel() for x in (last, along - last))
                    missed, size = way * float(weighed @ change), float(weighed @ weighed)
                    slope = size - missed / saved
                    if slope > STANDING * size:
                        way -= missed / slope
                    elif saved < 0.0:  # a larger share leads as far: the path rests
                        way = h
                else:  # by the last two answers
                    slope = (saved - before[1]) / (span - before[0]) if span != before[0] else 0.0
                    way = span - saved / slope if slope > 0.0 else way
                way = min(max(way, h * LEAST_PACE), rest, h)
                along = self._along(given.pose, clock, way)
                if along is None:
                    break
            before = (span, saved)
            given.span, given.along = way, along
            given.null_along, given.null_offset = self._wishes(way, h, hold=given.hold)
            linearised = self._step.answer(given)
        return linearised

    def _wishes(self, span: float, h: float, *, hold: bool) -> tuple[Array, Array]:
        """Wanted joint velocities in the null-space, with those of arms that follow their own way."""
        along, offset = self._null_space_reference(span, hold=hold)
        return self._own_ways(along, offset, span, h, hold=hold) if self._chain.apart else (along, offset)

    def _brake_correction(self, keep: float, seen: Observed) -> Array:
        """The error that the path correction sees, limited so that the correction is ``keep`` of the last one."""
        s = self.state
        error = self._mean(seen.errors) if seen.measured is None else seen.measured.copy()
        for part in (slice(0, 3), slice(3, 6)):
            now = self.options.path_gain * float(np.linalg.norm(error[part]))
            allowed = 0.0 if s.correcting is None else keep * float(np.linalg.norm(s.correcting[part]))
            if now > allowed:
                error[part] *= allowed / now
        return error

    def _null_space_reference(self, span: float, *, hold: bool) -> tuple[Array, Array]:
        """Wanted joint velocities in the null-space (nv,): per unit of rate, and the constant part."""
        s, nothing = self.state, np.zeros(self.cell.nv)
        if not self._redundant:
            return nothing, nothing
        if self._preview is not None and not self._preview.no_horizon:
            led = self._preview.led(s.clock, s.q, span)
            if led is not None:
                return led, nothing
            q_ahead, slope = self._preview.reference(s.clock)
            offset = self._on_path.posture.gain * pin.difference(self.cell.model, s.q, q_ahead)
        else:
            slope, offset = nothing, self._posture.velocity(s.q)
        return slope, nothing if hold else s.reins.ease * offset

    def _own_ways(self, along: Array, offset: Array, span: float, h: float, *, hold: bool) -> tuple[Array, Array]:
        """The same with the joints of arms that follow their own way."""
        s, motion = self.state, self._motion
        assert motion is not None
        along, offset, x = along.copy(), offset.copy(), self.cell.positions(s.q)
        gain = 0.0 if hold else min(self.options.grasp_gain, 1.0 / h)
        for k in self._chain.apart:
            columns, way = self._chain.moving_columns[k], motion.leading(k, s.clock)
            assert way is not None
            now, speed = way.at(s.clock)
            later = way.at(min(s.clock + span, way.end))[0]
            along[columns] = (later - now) / span if span > 1e-12 else speed
            offset[columns] = gain * (now - x[columns])
        return along, offset

    # -- commit ----------------------------------------------------------------------------------------------------

    def commit(self, proposal: Proposal, began: float) -> ControlStep:
        """Move the state by the proposed command."""
        s, seen, linearised = self.state, proposal.observed, proposal.found
        answer, h, duration = linearised.answer, seen.h, self._guarded.duration
        v, q_next = answer.velocity, self.cell.moved(s.q, h * answer.velocity)
        rate = min(max(float(answer.rate), 0.0), 1.0)
        clock_next = s.clock + rate * h
        if duration - clock_next < 1e-9 * duration:
            clock_next = duration
        # the last step needs less than the full rate, but nothing slows it
        share = 1.0 if rate >= 1.0 or (clock_next >= duration and not seen.watch.hold) else rate
        status, reason, cause, binding = self._verdict(proposal, share)
        for array in (v, q_next):
            array.flags.writeable = False  # the loop goes on from them
        step = ControlStep(
            cell=self.cell,
            grasp=self.grasp,
            path=self._way.program,
            q=s.q,
            velocity=v,
            q_next=q_next,
            dt=h,
            clock=self._way.clock_of(s.clock),
            clock_next=self._way.clock_of(clock_next),
            sense=self._way.sense,
            rate=share,
            status=self._way.status(status),
            reason=reason,
            cause=self._way.cause(status, cause, binding),
            binding=binding,
            given_up=given_up(linearised, share, self._restricted),
            solver=answer.report,
            commanded_apart=seen.apart.distance,
            clearance=self.constraints.nearest(s.q),
            build_time_s=time.perf_counter() - began - answer.report.time_s,
        )
        if answer.report is not NO_SOLVE or self._box.accelerates:
            c = linearised.correction
            s.correcting = c if c @ c > NEGLIGIBLE else None
        expects = answer.chain == 0.0 and not answer.braked and not seen.lost
        s.predicted, s.foreseen = (linearised.predicted, linearised.foreseen) if expects else (None, 0.0)
        shifted = proposal.given.asked if linearised.makes_up else None
        s.mismatch = expected(seen.apart.mismatch, shifted, linearised.closes)
        s.started, s.asked_shift, s.chain_held = True, None, seen.apart.holds
        s.v_before, s.v, s.q = linearised.stand_in, v, step.q_next
        # A start sets the rate, and where no acceleration is limited the first step may leave it by a jump: no slope.
        jumped = s.first and not self._box.accelerates
        s.rate_slope, s.rate, s.clock = 0.0 if jumped else (rate - s.rate) / h, rate, clock_next
        s.last_dt, s.first, s.status = h, False, status
        s.stride_left -= s.stride > 0
        if s.stride and s.stride_left <= 0 and len(s.travelled) < MOST_TRAVELS:
            s.stride_left = s.stride
            s.travelled.append((s.clock, s.rate, self.positions, v))
        s.reins.advance(self.options.blocked_rate, self._rate_cap.slope * h)
        return step

    def _verdict(self, proposal: Proposal, share: float) -> tuple[Status, str, Cause | None, tuple[BindingLimit, ...]]:
        """Status, reason, cause and binding limits of a step at a path speed; a fault is latched."""
        s, seen, linearised, blocked_rate = self.state, proposal.observed, proposal.found, self.options.blocked_rate
        answer, watch, preview = linearised.answer, seen.watch, self._preview
        binding = proposal.binding
        if answer.active:
            binding = self.names(answer.active, seen.h, proposal.given.further)
        binding = self.constraints.measured(binding, s.q)
        status = Status.TRACKING
        if share <= 1.0 - 1e-6:
            outside = self._box.any_outside
            status = slow_status(s, share, binding, preview, blocked_rate, outside=outside, dt=self.dt)
        status = lasting(s, status, share, binding, h=seen.h, no_horizon=self._no_horizon)
        if s.reins.share < blocked_rate and share < blocked_rate:
            status = Status.PAUSED if rests(answer.off_path) else Status.SLOWED
            binding = binding or (OVERRIDE,)
        away = away_from_path(s, linearised, self.options)
        reason = watch.reason or answer.reason
        if watch.hold or answer.braked:
            status = Status.HOLDING
        elif away:
            status, reason = Status.OFF_PATH, "; ".join(filter(None, (away, reason)))
        elif status is Status.PAUSED:
            binding = (OVERRIDE,)  # whatever else would stop it
        if inside := self.constraints.inside(s.q):
            binding = tuple(dict.fromkeys((*inside, *binding)))
            if not watch.hold:
                reason = "; ".join(filter(None, (reason, too_close(inside))))
        if watch.hold and watch.fault:
            status, s.fault, s.fault_arm, s.fault_cause = Status.FAULT, watch.reason, watch.arm, watch.cause
        stopped = status in (Status.SLOWED, Status.BLOCKED) and any(b.kind is LimitKind.PATH_JUMP for b in binding)
        if stopped and not reason and preview is not None and preview.jump is not None:
            clock_of_jump, far = preview.jump
            reason = jump(far, clock_of_jump)
        watched = Cause.SOLVER if answer.braked and not watch.hold else watch.cause
        cause = cause_of(status, watched, binding, measured=s.drift is not None)
        if status is Status.TRACKING and answer.report is NO_SOLVE:
            binding = inside
        return status, reason, cause, binding

    def names(self, active: tuple[tuple[int, float], ...], h: float, further: Rows) -> tuple[BindingLimit, ...]:
        """Limits of binding rows, by name."""
        box, nv = self._box, self.cell.nv
        return tuple(
            box.binding(row, side, self.state.v, h) if row < nv else self._label(int(further.owner[row - nv]))
            for row, side in active
        )

    def _label(self, owner: int) -> BindingLimit:
        return self.constraints.labels[owner] if owner >= 0 else self._braking.labels[-1 - owner]
