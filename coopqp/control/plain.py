"""The plain loop: the definition of a step in NumPy, written to be read. It runs where the core does not apply.

``observe`` advances what is filtered, once a sample; ``propose`` finds the command; ``commit`` moves the state. A veto
proposes again, with more rows or a lower cap on the rate.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.control.command import NO_SOLVE, ControlStep, Status
from coopqp.control.constraint_set import Constraints
from coopqp.control.constraints import ConstraintTrouble, Rows, no_rows
from coopqp.control.constraints_ahead import ConstraintsAhead
from coopqp.control.limits import VelocityBox
from coopqp.control.linearised import LinearisedAnswer, LinearisedStep, StepInput, averaging
from coopqp.control.loop_state import LoopState, Observed, Proposal
from coopqp.control.options import QPOptions
from coopqp.control.ranks import StepSolver
from coopqp.control.rate_cap import OVERRIDE, RateCap
from coopqp.control.supervision import Supervision, Watch
from coopqp.control.turn import Turn
from coopqp.control.verdict import away_from_path, given_up, slow_status
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp, held_at
from coopqp.model.limits import BindingLimit
from coopqp.model.state import CellState
from coopqp.planning.preview import PathPreview
from coopqp.spatial import Array
from coopqp.task.guarded import GuardedPath, is_known
from coopqp.task.path import ObjectPath
from coopqp.task.posture import Posture

#: Close to rest, the increment along the path is the mean over this share of a step.
LEAST_PACE = 1e-3
#: Further answers of a step whose command violates the constraints behind its rows.
MOST_TIGHTENINGS = 3
#: Square of an off-path twist that needs no braking distance [m²/s², rad²/s²].
NEGLIGIBLE = 1e-10


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
        turn = Turn()
        self.hold, self.release = turn.hold, turn.release
        self.constraints = constraints
        self._chain, self._ahead_chain, self._box = Chain(cell, grasp), Chain(cell, grasp), VelocityBox(cell)
        self._shares = options.common_error.shares(cell)
        self._mean = averaging(self._shares)
        self.solver = StepSolver(self._chain, self._box, options)
        self._step = LinearisedStep(self._chain, self._box, self._shares, self.solver, options)
        self._posture = Posture(cell, options.posture)
        self._supervision = Supervision(cell, grasp, options.supervision)
        self._rate_cap = RateCap(cell, self._box, options, dt=dt)
        self._restricted = tuple(cell.arm_names[k] for k in self._chain.deficient)
        self._redundant = self._chain.redundancy > 0
        self._no_rows = no_rows(cell.nv)
        self._preview: PathPreview | None = None
        self.state = LoopState(pin.neutral(cell.model), np.zeros(cell.nv), np.zeros(cell.nv))

    # -- starting --------------------------------------------------------------------------------------------------

    def follow(self, path: ObjectPath) -> None:
        """Take a path; it begins with :meth:`start_path`."""
        self.path, self._guarded = path, GuardedPath(path)
        self._on_path = self.options.on(self._guarded.planned_share)
        self._posture.take(self._on_path.posture)
        self._ahead: tuple[float, pin.SE3] | None = None
        self._preview = None
        if self.options.preview is not None and self._guarded.known_ahead:
            ahead = ConstraintsAhead(self.cell, self.constraints, self.options.preview.curvature_share, dt=self.dt)
            preview = PathPreview(
                self._ahead_chain,
                path,
                self._posture,
                dt=self.dt,
                options=self._on_path.preview,
                bound=ahead.bound if self.constraints else None,
                evade=ahead.evade if self.constraints.evades else None,
            )
            self._preview = preview

    def take_shift(self, shift: Array) -> Callable[[], bool]:
        """The tools hold the object shifted by (N, 6) after each call of the returned function; False if not finite."""

        def taken() -> bool:
            if not np.isfinite(shift).all():
                return False
            self._chain.shift_grasp(shift)
            self._ahead_chain.shift_grasp(shift)
            return True

        return taken

    def start(self, q: Array) -> None:
        """Start at rest at ``q``; forget everything."""
        self.solver.reset()
        self._supervision.reset()
        self._posture.reset(q)
        reins = self.state.reins.started(self.options.blocked_rate)
        self.state = LoopState(q, np.zeros(self.cell.nv), np.zeros(self.cell.nv), last_dt=self.dt, reins=reins)

    def start_path(self, clock: float = 0.0, rate: float | None = None) -> None:
        """Start along the path from ``clock`` on."""
        s = self.state
        s.clock, s.first, s.predicted, s.away = clock, True, None, math.inf
        s.rate = (0.0 if self._box.accelerates else s.reins.share) if rate is None else rate
        self.look_ahead_again()

    def take_path(self) -> None:
        """Forget the pose ahead: the path has changed."""
        self._ahead = None

    def look_ahead_again(self, rate: float | None = None) -> None:
        """The path ahead has changed; the object moves along it at a rate."""
        self.take_path()
        if rate is not None:
            self.state.rate = rate
        if self._preview is not None:
            self._preview.reset(self.state.q, self.state.clock)

    def try_step(self) -> tuple[float, Array]:
        """σ that a step from here keeps, its cap at most, and the change of the joints' velocities (nv,).

        Nothing is committed, and samples in it count for nothing. The joints may force a rate above the cap.
        """
        proposal = self.propose(self.observe(None, None))
        found = proposal.found.answer
        return 0.0 if found.braked else min(proposal.given.cap, found.rate), found.velocity - self.state.v

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
    def q(self) -> Array:
        """Commanded configuration (nq,)."""
        return self.state.q

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
        pose, carried = self._pose(s.clock), self._chain.carried(s.q)
        trouble, s.away = self._guarded.trouble(s.clock, h, carried[0], s.away)
        if trouble:
            measured, watch, lost = None, Watch.holding(trouble), True
            s.predicted = None  # from another reference
            pose = held_at(self.grasp, self._shares, CellState(self.cell, s.q))
        if s.fault:
            watch = Watch(0.0, hold=True, fault=True, arm=s.fault_arm, reason=s.fault)
        poses = carried if measured is None else np.concatenate([carried, self._chain.carried(measured)])
        errors = self._chain.errors(poses, pose)
        n = len(carried)
        seen = Observed(h, pose, carried, errors[:n], watch, lost=lost)
        seen.measured = self._let_in(seen, measured, errors[n:])
        return seen

    def _pose_ahead(self, clock: float) -> pin.SE3 | None:
        """The path's pose at a clock, kept: most often it is the next step's reference."""
        if self._ahead is None or self._ahead[0] != clock or not is_known(self.path):
            pose = self._guarded.pose(clock)
            self._ahead = None if pose is None else (clock, pose)
        return None if self._ahead is None else self._ahead[1]

    def _pose(self, clock: float) -> pin.SE3:
        pose = self._pose_ahead(clock)
        return held_at(self.grasp, self._shares, CellState(self.cell, self.state.q)) if pose is None else pose

    def _let_in(self, seen: Observed, measured: Array | None, errors: Array) -> Array | None:
        """The object's error for the path correction, from those as measured; None to use the commanded one.

        It is the commanded error plus the further measured error, which fades in slowly. The correction shrinks as the
        arms get out of step, and vanishes while they hold: the measured error of an arm that does not move would lead
        the others away from it without end.
        """
        s, watch = self.state, seen.watch
        if measured is not None:
            away = errors - seen.errors
            drift = np.zeros(6) if s.drift is None else s.drift
            s.drift = drift + seen.h / (seen.h + self.options.measurement_time) * (self._mean.dot(away.ravel()) - drift)
            watch.lower(self._supervision.watch(measured, s.q, away, seen.h))
        if s.drift is None or watch.hold:
            return np.zeros(6) if watch.hold else None
        error: Array = watch.rate_cap * (self._mean.dot(seen.errors.ravel()) + s.drift)
        return error

    # -- propose ---------------------------------------------------------------------------------------------------

    def propose(self, seen: Observed) -> Proposal:
        """Find the command."""
        s, h = self.state, seen.h
        further = self._no_rows
        if self.constraints.velocity:
            try:
                further = self.constraints.rows(s.q, h, blind=self._blind)
            except ConstraintTrouble as trouble:
                seen.watch.lower(Watch.holding(str(trouble)))
                further = self._no_rows if trouble.rows is None else trouble.rows
        if s.lost and not seen.lost:
            self.look_ahead_again()  # the known horizon is void after the path has failed
        s.lost = seen.lost
        cap, binding, late = self._rate_cap.find(s, seen, self._preview)
        measured = seen.measured
        if late < 1.0:
            measured = self._brake_correction(late, seen)
        rest = self._guarded.duration - s.clock
        if rest < h * cap:
            cap = rest / h  # the last step ends at the end
        pace = min(cap, s.rate)
        if self._preview is not None and self._preview.reaches_corner(s.clock, h * cap):
            pace = cap  # the mean along the path has to see the corner
        span = min(h * max(pace, LEAST_PACE), rest)
        along = np.zeros(6)
        if span > 1e-12 and not seen.lost:
            ahead = self._pose_ahead(s.clock + span)
            if ahead is None:
                seen.watch.lower(Watch.holding(self._guarded.problem))
                cap = 0.0
            else:
                along = np.asarray(pin.log6(seen.pose.actInv(ahead)).vector) / span
        null_along, null_offset = self._wishes(seen.watch.hold)
        given = StepInput(
            s.q, self.cell.positions(s.q), seen.carried, seen.errors, s.v, s.v_before, h, cap, seen.pose, along,
            measured, s.predicted, s.last_dt, null_along, null_offset, further, s.first,
        )  # fmt: skip
        return Proposal(seen, given, self._kept(given), binding)

    @property
    def _blind(self) -> bool:
        """Whether nothing brakes ahead of further constraints."""
        return self._preview is None or self._preview.blind

    def _kept(self, given: StepInput) -> LinearisedAnswer:
        """The answer; again with tighter rows where it violates their constraints."""
        found = self._step.answer(given)
        for _ in range(MOST_TIGHTENINGS):
            v = found.answer.velocity
            rows = self.constraints.tightened(given.further, self.cell.moved(given.q, given.h * v), v, given.h)
            if rows is None:
                break
            given.further = rows
            found = self._step.answer(given)
        return found

    def _brake_correction(self, keep: float, seen: Observed) -> Array:
        """The error that the path correction sees, limited so that the correction is ``keep`` of the last one."""
        s = self.state
        error = self._mean.dot(seen.errors.ravel()) if seen.measured is None else seen.measured.copy()
        for part in (slice(0, 3), slice(3, 6)):
            now = self.options.path_gain * float(np.linalg.norm(error[part]))
            allowed = 0.0 if s.correcting is None else keep * float(np.linalg.norm(s.correcting[part]))
            if now > allowed:
                error[part] *= allowed / now
        return error

    def _wishes(self, hold: bool) -> tuple[Array, Array]:
        """Joint velocities wished for in the null-space, per unit of rate and besides."""
        s, nothing = self.state, np.zeros(self.cell.nv)
        if not self._redundant:
            return nothing, nothing
        if self._preview is not None and not self._preview.blind:
            q_ahead, slope = self._preview.reference(s.clock)
            offset = self._on_path.posture.gain * pin.difference(self.cell.model, s.q, q_ahead)
        else:
            slope, offset = nothing, self._posture.velocity(s.q)
        return slope, nothing if hold else s.reins.ease * offset

    # -- commit ----------------------------------------------------------------------------------------------------

    def commit(self, proposal: Proposal, began: float) -> ControlStep:
        """Move the state by the proposed command."""
        s, seen, found = self.state, proposal.observed, proposal.found
        answer, watch, h, duration = found.answer, seen.watch, seen.h, self._guarded.duration
        v, q, clock = answer.velocity, s.q, s.clock
        q_next = self.cell.moved(q, h * v)
        binding = proposal.binding
        if answer.active:
            binding = self.names(answer.active, h, proposal.given.further)
        binding = self.constraints.measured(binding, q)
        rate = min(max(float(answer.rate), 0.0), 1.0)
        clock_next = clock + rate * h
        if duration - clock_next < 1e-9 * duration:
            clock_next = duration
        # the last step needs less than the full rate, but nothing slows it
        share = 1.0 if rate >= 1.0 or (clock_next >= duration and not watch.hold) else rate
        status, by_qp = Status.TRACKING, answer.report is not NO_SOLVE
        if share <= 1.0 - 1e-6:
            status = slow_status(
                s, share, binding, self._preview, self.options.blocked_rate, outside=self._box.any_outside, dt=self.dt
            )
        if s.reins.share < self.options.blocked_rate and share < self.options.blocked_rate:
            status = Status.PAUSED
        away = away_from_path(s, found, self.options)
        reason = watch.reason or answer.reason
        if watch.hold or answer.braked:
            status = Status.HOLDING
        elif away:
            status, reason = Status.OFF_PATH, "; ".join(filter(None, (away, reason)))
        elif status is Status.PAUSED:
            binding = (OVERRIDE,)  # whatever else would stop it
        if watch.hold and watch.fault:
            status, s.fault, s.fault_arm = Status.FAULT, watch.reason, watch.arm
        for array in (v, q_next):
            array.flags.writeable = False  # the loop goes on from them
        step = ControlStep(
            cell=self.cell,
            grasp=self.grasp,
            path=self.path,
            q=q,
            velocity=v,
            q_next=q_next,
            dt=h,
            clock=clock,
            clock_next=clock_next,
            rate=share,
            status=status,
            reason=reason,
            binding=() if status is Status.TRACKING and not by_qp else binding,
            given_up=given_up(found, share, self._restricted),
            solver=answer.report,
            clearance=self.constraints.nearest(q),
            build_time_s=time.perf_counter() - began - answer.report.time_s,
        )
        if by_qp or self._box.accelerates:
            c = found.correction
            s.correcting = c if c @ c > NEGLIGIBLE else None
        s.predicted = found.predicted if answer.chain == 0.0 and not answer.braked and not seen.lost else None
        s.v_before, s.v, s.q = found.stand_in, v, step.q_next
        s.clock, s.rate, s.last_dt, s.first = clock_next, rate, h, False
        s.reins.advance(self.options.blocked_rate, self._rate_cap.slope * h)
        return step

    def names(self, active: tuple[tuple[int, float], ...], h: float, further: Rows) -> tuple[BindingLimit, ...]:
        """Rows of a step, by name."""
        box, nv, labels = self._box, self.cell.nv, self.constraints.labels
        return tuple(
            box.binding(row, side, self.state.v, h) if row < nv else labels[int(further.owner[row - nv])]
            for row, side in active
        )
