"""The cooperative QP controller: the chain holds, the object stays on its path, a command always comes.

One step, in the order in which the code reads: guards (is the input to be believed, are the arms in step), the rate
that the path ahead allows, what the step wants (errors and corrections), and the strictly ranked answer: the nominal
command if it is admissible; else the fastest rate on the path; else the QP; else the QP whose chain may part; else a
synchronised brake. The first two are fused in a kernel (:mod:`coopqp.control.core`); :mod:`coopqp.control.linearised`
does the same step by step where the kernel does not apply. See docs/derivations.md.
"""

from __future__ import annotations

import time
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.control.command import (
    NO_SOLVE,
    NOTHING,
    ControlStep,
    GivenUp,
    Status,
    check_start,
    make_step,
)
from coopqp.control.core import Outcome, Workspace, make_kernel
from coopqp.control.limits import VelocityBox
from coopqp.control.linearised import LinearisedStep
from coopqp.control.options import QPOptions
from coopqp.control.ranks import StepAnswer, StepSolver
from coopqp.control.supervision import Supervision, Watch
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.state import CellState
from coopqp.planning.preview import PathPreview
from coopqp.spatial import Array, Placement
from coopqp.task.path import HoldPath, LinePath, ObjectPath, ServoPath, WaypointPath
from coopqp.task.posture import Posture

#: Share of the accelerations that braking together ahead of a limit is planned with, where there is no preview.
_BRAKING_SHARE = 0.8
_UNBOUND: tuple[BindingLimit, ...] = ()
#: Where the object all but stands, the increment along the path is the mean over this share of a step.
_LEAST_PACE = 1e-3
# Members of an enumeration cost a look-up of a tenth of a microsecond each.
_TRACKING, _NOMINAL, _OPEN = Status.TRACKING, int(Outcome.NOMINAL), int(Outcome.OPEN)
#: An object that comes to what stops it for good counts as blocked from so many times the rate on.
_ARRIVING = 10.0
#: A rate that rises by less stands still: a QP's zero has the solver's rounding.
_RATE_ROUNDING = 1e-12
#: Nothing to watch: shared, so not to be changed.
_CLEAR = Watch()
#: Square of an off-path twist that needs no braking distance [m²/s², rad²/s²].
_NEGLIGIBLE = 1e-10
#: A pose with numbers from here on is none [m].
_FARTHEST = 1e9


@final
class QPController:
    """Cooperative QP controller for any number of arms that hold one object.

    Args:
        cell, grasp, path: what moves, how it holds, and where to.
        dt: nominal length of a step [s].
        options: settings.

    Attributes:
        kernel: name of the fused step that runs: "compiled", "numpy" or "none".

    Raises:
        InvalidInputError, UnknownNameError, MissingExtraError: bad settings, an unknown or missing solver.
    """

    def __init__(
        self, cell: RobotCell, grasp: Grasp, path: ObjectPath, *, dt: float, options: QPOptions | None = None
    ) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp, self.path = cell, grasp, path
        self.dt = as_scalar(dt, "QPController: dt")
        o = self.options = options or QPOptions()
        self._chain = Chain(cell, grasp)
        self._box = VelocityBox(cell)
        self._shares = o.common_error.shares(cell)
        self._solver = StepSolver(self._chain, self._box, o)
        self._ws = Workspace(self._chain, self._shares, self._box)
        self._ws.scalars[[self._ws.SPEED, self._ws.SPIN]] = o.correction_speed, o.correction_spin
        self._ws.unit[:] = self._solver.program.units
        fused = o.iterations == 1 and self._ws.eligible
        kernel = make_kernel(self._ws, o.kernel) if fused else None
        #: The kernel's own QP, where it fills in what is asked for.
        self._rows = None if kernel is None or o.form != "condensed" else kernel.rows
        self._kernel = kernel if o.shortcut or self._rows is not None else None
        self._shortcut = o.shortcut
        self.kernel = "none" if self._kernel is None else self._kernel.name
        self._follows_lines = self._kernel is not None and self._kernel.follows_lines
        self._linearised = LinearisedStep(self._ws, self._solver, o)
        self._line: Array | None = None
        self._gains_dt, self._has_measured = 0.0, False
        self._accelerates = self._box.accelerates
        self._rise = None if o.preview is None else o.preview.slope(accelerates=self._accelerates, dt=self.dt)
        self._late, self._keep = False, 1.0
        self._posture = Posture(cell, o.posture)
        self._supervision = Supervision(cell, grasp, o.supervision)
        self._preview = self._make_preview(path)
        self._restricted = tuple(cell.arm_names[k] for k in self._chain.deficient)
        self._started = False
        self._begin(pin.neutral(cell.model))

    def _make_preview(self, path: ObjectPath) -> PathPreview | None:
        if self.options.preview is None or not path.known_ahead:
            return None
        # The chain is shared: nothing that the preview leaves in it is used after.
        return PathPreview(self._chain, path, self._posture, dt=self.dt, options=self.options.preview)

    # -- starting --------------------------------------------------------------------------------------------------

    def reset(self, q: Any) -> None:
        """Start at ``q`` (nq,), at rest, the object's clock at 0; ends a fault. Errors as :class:`Controller`.

        A later reset with a :class:`ServoPath` starts where the arms hold the object, and rests there until the next
        target. With any other path the arms have to be at its start: :meth:`follow` one that starts where they are.
        """
        o = self.options
        again = self._started and isinstance(self.path, ServoPath)
        path = HoldPath(self._held_at(q)) if again else self.path
        start = check_start(
            self.cell, self.grasp, path, q, tolerance_m=o.start_tolerance_m, tolerance_rad=o.start_tolerance_rad
        )
        if isinstance(self.path, ServoPath) and again:
            self.path.restart(path.pose(0.0))
        self._solver.reset()
        self._supervision.reset()
        self._posture.reset(start)
        self._begin(start)
        self._start_path()
        self._started = True

    def _held_at(self, q: Any) -> pin.SE3:
        """Where the arms hold the object at ``q``: by their shares in the common error, from the first one's view."""
        O = self.grasp.carried(CellState(self.cell, q))
        errors = np.array([pin.log6(O[0].actInv(other)).vector for other in O])
        return O[0] * pin.exp6((self._shares * errors).sum(axis=0))

    def _begin(self, q: Array) -> None:
        self._q = q
        self._v, self._v_before = np.zeros(self.cell.nv), np.zeros(self.cell.nv)
        self._midpoint = q
        self._fault = ""
        self._drift, self._drifted = np.zeros(6), False
        self._correcting: Array | None = None  # off-path twist of the last step, where there was one
        self._clock, self._rate, self._fresh = 0.0, 1.0, True
        self._next_pose: tuple[float, pin.SE3] | None = None
        self._last_dt = self.dt
        ws = self._ws
        ws.positions[:], ws.v_prev[:], ws.scalars[ws.HAS_PREDICTED] = self.cell.positions(q), 0.0, 0.0

    def follow(self, path: ObjectPath) -> None:
        """Go on from the present command along another path, its clock at 0; the motion is not interrupted.

        The path should start where the object is; what is missing is made up for by the path correction.
        """
        self.path = path
        self._preview = self._make_preview(path)
        self._start_path()

    def retarget(self, T_world_object: Placement) -> None:
        """Move the target of a :class:`ServoPath`.

        Raises:
            InvalidInputError: the path is no ServoPath, or the pose is not one; the old target stays.
        """
        if not isinstance(self.path, ServoPath):
            raise InvalidInputError(
                f"the path is a {type(self.path).__name__}", "retarget", "Build the controller with a ServoPath."
            )
        self.path.set_target(T_world_object, clock=self._clock)
        self._next_pose = None
        if self._preview is not None:
            self._preview.reset(self._q, self._clock)

    def _start_path(self) -> None:
        self._clock, self._fresh, self._next_pose = 0.0, True, None
        self._own_path, self._lost = not isinstance(self.path, (LinePath, WaypointPath, HoldPath, ServoPath)), False
        self._ws.scalars[self._ws.HAS_PREDICTED] = 0.0
        self._rate = 0.0 if self._box.accelerates else 1.0
        if self._preview is not None:
            self._preview.reset(self._q, 0.0)

    # -- the step --------------------------------------------------------------------------------------------------

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        """Compute the command of one period.

        The chain error is taken from the *commanded* configuration and the object's error from the measured one:
        once the object is gripped the measured chain error hides in servo deflection, and feeding it back into an
        integrated command would wind up without bound.

        Args:
            q_measured: measured configuration (nq,); None where commands are followed exactly.
            dt: length of this step [s], if not the nominal one.

        Raises:
            InvalidInputError: before the first :meth:`reset`. Never for run-time data: those lead to a status.
        """
        if not self._started:
            raise InvalidInputError("step before reset", "QPController", "Call reset(q) first.")
        began = time.perf_counter()
        if q_measured is None and dt is None and not self._fault and not self._own_path:
            h, measured, watch = self.dt, None, _CLEAR
        else:
            h, measured, watch = self._guard(q_measured, dt)
        cap, span, binding = self._prepare(h, measured, watch)
        chain, ws = self._chain, self._ws
        chain.place(self._q)
        found: StepAnswer | None = None
        if self._kernel is not None and not self._fresh:
            chain.evaluate(self._midpoint if h == self._last_dt else self._ahead(0.5 * h))
            outcome = self._kernel.step(cap, self._clock, span) if self._shortcut else _OPEN
            if outcome != _OPEN:
                rate = cap
                if outcome != _NOMINAL:
                    rate, joint, side, _ = ws.result.tolist()
                    if joint >= 0.0:
                        binding = (self._box.binding(int(joint), side, self._v, h),)
                v = ws.velocity.copy()
                if self.cell.euclidean:
                    q_next, self._midpoint = ws.positions.copy(), ws.midpoint
                else:
                    q_next = self.cell.moved(self._q, h * v)
                    self._midpoint = pin.integrate(self.cell.model, q_next, 0.5 * h * (2.0 * v - self._v))
                    ws.positions[:] = self.cell.positions(q_next)
                return self._finish(h, v, q_next, rate, binding, watch, None, began)
            found = self._open_in_kernel(h, cap, span)
        answer = found or self._open_step(h, cap)
        v = answer.velocity
        q_next = self.cell.moved(self._q, h * v)
        step = self._finish(h, v, q_next, answer.rate, answer.binding or binding, watch, answer, began)
        self._midpoint = self._ahead(0.5 * h)
        ws.positions[:], ws.v_prev[:] = self.cell.positions(q_next), self._v
        return step

    def _ahead(self, time_ahead: float) -> Array:
        """The configuration a while ahead, at the velocity predicted for this step: half of it is its midpoint."""
        return self.cell.moved(self._q, time_ahead * (2.0 * self._v - self._v_before))

    def _guard(self, q_measured: Any, dt: Any) -> tuple[float, Array | None, Watch]:
        """Accept or refuse the inputs of a step; a refusal holds."""
        supervision, h = self._supervision, self.dt
        watch = Watch()
        if dt is not None:
            trouble = supervision.accept_dt(dt, self.dt)
            if trouble:
                watch = Watch(rate_cap=0.0, hold=True, reason=trouble)
            else:
                h = float(dt)
        measured = None
        if q_measured is not None and q_measured is not self._q:
            measured, trouble = supervision.accept_measurement(q_measured, self._q)
            if trouble:
                measured, watch = None, Watch(rate_cap=0.0, hold=True, reason=trouble)
        if self._own_path:
            trouble = self._path_trouble(h)
            self._lost = bool(trouble)
            if trouble:
                measured, watch = None, Watch(rate_cap=0.0, hold=True, reason=trouble)
        if self._fault:
            watch = Watch(rate_cap=0.0, hold=True, fault=True, reason=self._fault)
        return h, measured, watch

    def _path_trouble(self, h: float) -> str:
        """Empty, or what is wrong with the poses of a path of the user's own; the object is then held where it is."""
        for clock in (self._clock, self._clock + h):
            if not float(np.abs(self._pose(clock).homogeneous).max()) < _FARTHEST:
                self._next_pose = (self._clock, self._held_at(self._q))
                return f"the path's pose at its clock {clock:.6g} s is not finite"
        return ""

    def _prepare(self, h: float, measured: Array | None, watch: Watch) -> tuple[float, float, tuple[BindingLimit, ...]]:
        """Fill the workspace's inputs: reference pose, increment along the path, measured error, posture.

        Returns:
            Rate cap, span of the clock that the increment along the path is the mean of [s], and what makes the cap.
        """
        o, path, ws, clock = self.options, self.path, self._ws, self._clock
        has_measured = False
        if measured is not None or self._drifted or watch.hold:
            has_measured = self._let_in(h, measured, watch)
        cap, binding = self._rate_cap(h, watch)
        if self._late:
            has_measured = self._brake_correction(self._keep, has_measured)
        rest = path.duration - clock
        if rest < h * cap:
            cap = rest / h  # the last step ends at the end
        pace = cap if cap < self._rate else self._rate
        span = h * (pace if pace > _LEAST_PACE else _LEAST_PACE)
        if span > rest:
            span = rest
        if not self._on_line(span):
            self._look_along(clock, span)
        s = ws.scalars
        if h != self._gains_dt:
            self._gains_dt = s[ws.DT] = h
            # never more than the whole error in one step
            s[ws.GRASP_GAIN], s[ws.PATH_GAIN] = min(o.grasp_gain, 1.0 / h), min(o.path_gain, 1.0 / h)
        if has_measured is not self._has_measured:
            self._has_measured = has_measured
            s[ws.HAS_MEASURED] = has_measured
        if ws.redundant:
            self._wanted_posture()
            if watch.hold:
                ws.null_offset[:] = 0.0
        return cap, span, binding

    def _rate_cap(self, h: float, watch: Watch) -> tuple[float, tuple[BindingLimit, ...]]:
        """The fastest rate that what is ahead, the supervision and the last rate allow, and what makes it so."""
        cap, binding = 1.0, _UNBOUND
        if self._preview is not None:
            cap, ahead = self._preview.cap(self._clock, h)
            if ahead is not None:
                binding = (ahead,)
        self._late = False
        blind = self._preview is None or self._preview.blind
        if self._accelerates and (blind or self._correcting is not None):
            self._keep = self._brake_share(h)
            self._late = self._keep < 1.0
            if self._late and blind:
                cap = min(cap, self._keep * self._rate)
        if watch.rate_cap < cap:
            cap = watch.rate_cap
            binding = (
                () if watch.arm < 0 else (BindingLimit(self.cell.arm_names[watch.arm], "", LimitKind.OUT_OF_STEP),)
            )
        if self._rate < 1.0 and self._rise is not None:
            allowed = self._rate + self._rise * h
            if allowed < cap:
                cap, binding = allowed, ()
        return cap, binding

    def _let_in(self, h: float, measured: Array | None, watch: Watch) -> bool:
        """The object's error for the path correction, in ``ws.measured``; False if the commanded one will do.

        It is the commanded error and, let in slowly, what is measured besides. The less the arms are in step the less
        of it is corrected, and while they hold nothing: the measured error of an arm that does not move would lead
        the others away from it without end.
        """
        if measured is not None:
            found, errors = self._object_at(measured)
            commanded, told = self._object_at(self._q)
            seen = self._supervision.watch(measured, self._q, errors - told, h)
            if seen.rate_cap < watch.rate_cap or seen.fault:
                watch.rate_cap, watch.hold, watch.fault = seen.rate_cap, seen.hold, seen.fault
                watch.arm, watch.reason = seen.arm, seen.reason
            self._drift += h / (h + self.options.measurement_time) * (found - commanded - self._drift)
            self._drifted = True
        elif self._drifted and not watch.hold:
            commanded, _ = self._object_at(self._q)
        else:
            self._ws.measured[:] = 0.0
            return watch.hold
        np.multiply(commanded + self._drift, 0.0 if watch.hold else watch.rate_cap, out=self._ws.measured)
        return True

    def _object_at(self, q: Array) -> tuple[Array, Array]:
        """The object's error at a configuration (6,), and that of the object as each arm carries it (N, 6) [m, rad]."""
        chain, ws = self._chain, self._ws
        if self._kernel is not None and not self._fresh:
            chain.place(q)
            if not self._on_line(0.0):
                ws.set_pose(self._pose(self._clock))
            if self._kernel.observe(self._clock):
                return ws.common.copy(), ws.errors.copy()
        errors = chain.errors(chain.carried(q), self._pose(self._clock))
        return (self._shares * errors).sum(axis=0), errors

    def _on_line(self, span: float) -> bool:
        """Whether the kernel follows the path by itself for ``span``, on a line that it is told of."""
        line = self.path.line_at(self._clock, span) if self._follows_lines and not self._fresh else None
        if line is not self._line:
            ws, self._line = self._ws, line
            ws.scalars[ws.ON_LINE] = line is not None
            if line is not None:
                ws.line[:] = line
        return line is not None

    def _brake_share(self, h: float) -> float:
        """1 if all joints, braking together after this step, stop inside their limits; else the share of their speed
        that they keep if they do so now.

        A joint's own braking distance is not enough: the others may be slower to stop, and they hold one object.
        """
        v, limits = self._v, self._box.limits
        speed = np.abs(v)
        longest = float((speed / limits.acceleration).max())  # of the times that the joints need to stop
        if longest <= 0.0:
            return 1.0
        planned = longest / _BRAKING_SHARE
        x = self.cell.positions(self._q)
        room = np.where(v > 0.0, limits.upper - x, x - limits.lower)
        late = (speed * (h + 0.5 * planned) > room) & (room >= 0.0)
        if not late.any():
            return 1.0
        left = float((room[late] / speed[late]).min())
        return max(0.0, 1.0 - h / min(max(2.0 * (left - h), longest), planned))

    def _brake_correction(self, keep: float, has_measured: bool) -> bool:
        """Limit the error that the path correction sees, so that the correction is ``keep`` of the last one."""
        ws, o = self._ws, self.options
        if not has_measured:
            ws.measured[:], _ = self._object_at(self._q)
        wanted = o.path_gain * ws.measured
        for part in (slice(0, 3), slice(3, 6)):
            now = float(np.linalg.norm(wanted[part]))
            allowed = 0.0 if self._correcting is None else keep * float(np.linalg.norm(self._correcting[part]))
            if now > allowed:
                ws.measured[part] *= allowed / now
        return True

    def _look_along(self, clock: float, span: float) -> None:
        """The reference pose, and the twist that follows the path for ``span``, where the kernel does not do it."""
        ws, pose = self._ws, self._pose(clock)
        if self._lost:
            self._next_pose = None
            ws.along[:] = 0.0
        elif span > 1e-12:
            ahead = self.path.pose(clock + span)
            self._next_pose = (clock + span, ahead)
            np.divide(pin.log6(pose.actInv(ahead)).vector, span, out=ws.along)
        else:
            ws.along[:] = 0.0
        ws.set_pose(pose)

    def _pose(self, clock: float) -> pin.SE3:
        """The path's pose; that of the last step's end is at hand."""
        if self._next_pose is not None and self._next_pose[0] == clock:
            return self._next_pose[1]
        return self.path.pose(clock)

    def _wanted_posture(self) -> None:
        """Joint velocities wanted in the null-space: along the preview, or the posture rule."""
        ws = self._ws
        if self._preview is not None and not self._preview.blind:
            q_ahead, slope = self._preview.reference(self._clock)
            ws.null_along[:] = slope
            ws.null_offset[:] = self.options.posture.gain * pin.difference(self.cell.model, self._q, q_ahead)
        else:
            ws.null_offset[:] = self._posture.velocity(self._q)

    # -- step by step, where the kernel does not settle it -----------------------------------------------------------

    def _open_in_kernel(self, h: float, cap: float, span: float) -> StepAnswer | None:
        """The QP as the kernel fills it in; None where it cannot, or where the chain cannot be kept."""
        outside = -1 if self._rows is None else self._rows(cap, self._clock, span)
        return self._solver.settle(self._ws, outside, cap, self._v, h) if outside >= 0 else None

    def _open_step(self, h: float, cap: float) -> StepAnswer:
        """The same step without the kernel."""
        answer, start = self._linearised.answer(self._q, self._v, self._v_before, h, cap, first=self._fresh)
        if self._fresh:
            # The velocities at the start and the middle of the first step stand in for those of two steps.
            self._v = 2.0 * start - answer.velocity
        return answer

    # -- the result --------------------------------------------------------------------------------------------------

    def _finish(
        self,
        h: float,
        v: Array,
        q_next: Array,
        rate: float,
        binding: tuple[BindingLimit, ...],
        watch: Watch,
        answer: StepAnswer | None,
        began: float,
    ) -> ControlStep:
        clock, duration = self._clock, self.path.duration
        rate = 0.0 if rate < 0.0 else 1.0 if rate > 1.0 else rate
        # what the last step needs is the full rate
        share = 1.0 if rate >= 1.0 or (rate * h >= duration - clock and not watch.hold) else rate
        clock_next = clock + rate * h
        if duration - clock_next < 1e-9 * duration:
            clock_next = duration
        status, given_up, reason, report = _TRACKING, NOTHING, watch.reason, NO_SOLVE
        if answer is None:
            if self._accelerates:
                ws = self._ws
                self._correcting = ws.path.copy() if ws.result.item(3) > _NEGLIGIBLE else None
        else:
            given_up, reason, report = self._given_up(answer, share), reason or answer.reason, answer.report
            twist = answer.path_share * answer.correction + answer.off_path
            self._correcting = twist if twist @ twist > _NEGLIGIBLE else None
        if share < 1.0:
            if answer is None:
                given_up = self._given_up(None, share)
            if share <= 1.0 - 1e-6:
                status = self._slow_status(share, binding)
        if watch.hold or (answer is not None and answer.braked):
            status = Status.HOLDING
            if watch.fault:
                self._fault = self._fault or watch.reason
                status = Status.FAULT
        step = make_step(
            {
                "cell": self.cell,
                "grasp": self.grasp,
                "path": self.path,
                "q": self._q,
                "velocity": v,
                "q_next": q_next,
                "dt": h,
                "clock": clock,
                "clock_next": clock_next,
                "rate": share,
                "status": status,
                "reason": reason,
                "binding": () if status is _TRACKING and answer is None else binding,
                "given_up": given_up,
                "solver": report,
                "build_time_s": time.perf_counter() - began - report.time_s,
            }
        )
        self._v_before = self._v
        self._q, self._v, self._clock, self._rate = q_next, v, clock_next, rate
        self._fresh, self._last_dt = False, h
        return step

    def _slow_status(self, rate: float, binding: tuple[BindingLimit, ...]) -> Status:
        rising = rate > self._rate + _RATE_ROUNDING
        ends = any(b.kind is LimitKind.POSITION for b in binding) or (self._preview is not None and self._preview.ends)
        arriving = ends and not rising and not self._outside()
        if rate >= self.options.blocked_rate * (_ARRIVING if arriving else 1.0):
            return Status.SLOWED
        # From rest the accelerations alone keep the rate small; it grows then, or a joint is on its way back in.
        accelerating = any(b.kind is LimitKind.ACCELERATION for b in binding)
        return Status.SLOWED if accelerating and (rising or self._outside()) else Status.BLOCKED

    def _outside(self) -> bool:
        """Whether a joint is outside its position limits."""
        x, limits = self._ws.positions, self._box.limits
        return bool(((x > limits.upper) | (x < limits.lower)).any())

    def _given_up(self, answer: StepAnswer | None, rate: float) -> GivenUp:
        if answer is None:
            return GivenUp(rate=1.0 - rate)
        if rate == 1.0 and answer.exact and not self._restricted:
            return NOTHING
        return GivenUp(
            chain=answer.chain,
            grasp=1.0 - answer.grasp_share,
            off_path=tuple(answer.off_path.tolist()),
            path=1.0 - answer.path_share,
            rate=1.0 - rate,
            restricted=self._restricted,
        )
