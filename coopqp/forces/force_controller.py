"""A cooperative controller whose arms relax the forces between them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.baselines.pseudo_inverse import PseudoInverseController
from coopqp.checks import ArrayLike, as_options, as_scalar, require
from coopqp.constraints.cause import Cause
from coopqp.control.core.force_memory import squeezes
from coopqp.control.interface import ControlStep, Status, amend, short_text
from coopqp.control.lock import alone
from coopqp.control.operator.calls import OperatorCalls
from coopqp.control.operator.changes import Change
from coopqp.control.operator.operator import Operator
from coopqp.control.qp import QPController
from coopqp.core._core import (
    BY_CONTACT,
    BY_FRICTION,
    BY_REACH,
    BY_RELEASE,
    BY_SENSOR,
    BY_STAGE,
    CHECKING,
    HEARD,
    NOTHING_MORE,
    PRESSING,
    RELAXING,
    SAME_CLOCK,
    SENSOR_SILENT,
    SENSOR_WRONG,
    STILL_OBJECT,
)
from coopqp.errors import InvalidInputError
from coopqp.forces.admittance import Relaxation
from coopqp.forces.force_options import ForceOptions
from coopqp.forces.holding import Holds, bearing, everywhere
from coopqp.forces.palms_on_path import check_squeeze
from coopqp.forces.sensor_check import SensorCheck
from coopqp.forces.sensor_findings import SensorJudgement
from coopqp.forces.wrist_sensor import SensorMaps
from coopqp.paths.grasp_motion import HAND_OVER_S, GraspMotion
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.moving_grasps import refuse_moving_holds
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array

#: Words for the stages, in their order.
_STAGES = (
    "the sensors are compared with the servos",
    "the arms press each other a little, to learn how stiff they are and what the sensors read",
    "the arms relax before the object moves",
    "the object moves",
)
#: Steps beyond the time of the comparison after which a reason says what it waits for.
_PATIENCE = 5
#: Attributes that a step changes, beside the attributes of the relaxation and of the inner controller.
_VARYING = ("_differences", "_compared", "_check", "_place", "_found", "_disturbed", "_leaves")

#: What to do where arms move on the object.
_LET_GO = "Give a path whose arms let go before they move on it: forces relax between grasps that stay."


@final
class ForceController(OperatorCalls):
    """A cooperative controller whose arms relax the forces between them, see :mod:`coopqp.forces.admittance`.

    At first the object rests. The sensors are compared with the servos; the arms press a little, to learn how stiff
    they are; they relax. Then the object moves, more slowly where an internal force grows. Three causes hold the
    object, and the reason names them: a sensor that does not agree with its servos, wrenches that do not come, and a
    grasp that cannot give way any further. :meth:`reset` ends the first two.

    Along a program the arms that hold the object do so. One that lets go hands its load over before, and makes no
    internal force until it attaches again, where its tool is then. No arm may move on the object while it holds it.

    A copy (``copy.copy``, ``copy.deepcopy``, pickle) goes on where the original stands.

    Args:
        controller: the controller that moves the arms: a QPController, or for comparison the PseudoInverseController,
            which cannot pause or take another path. Give commands to this one instead.
        options: settings, or a dictionary of them.

    Attributes:
        cell, grasp, path, dt: the controller's; the grasp is the nominal one, without relaxation.
        needs_wrenches: true: :func:`coopqp.simulate` gives it the plant's wrenches.
        needs_servos: true: :func:`coopqp.simulate` refuses torque-controlled drives, whose joints are no springs.

    Raises:
        InvalidInputError: bad settings, also those with which forces would swing; or somewhere on the path an arm moves
            on the object while it holds it, or palms lose it.
    """

    needs_wrenches = True
    needs_servos = True

    def __init__(
        self, controller: QPController | PseudoInverseController, options: ForceOptions | Mapping[str, Any]
    ) -> None:
        kinds = (QPController, PseudoInverseController)
        require(controller, kinds, "ForceController: controller", "Give a QPController or PseudoInverseController.")
        self._build(controller, as_options(ForceOptions, options, "ForceController: options"))

    def _build(self, controller: QPController | PseudoInverseController, options: ForceOptions) -> None:
        refuse_moving_holds(controller.path, "ForceController: controller", _LET_GO)
        self.controller, self.options = controller, options
        self.cell, self.grasp, self.dt = controller.cell, controller.grasp, controller.dt
        self._relaxation = Relaxation(self.cell, self.grasp, options, dt=controller.dt, shares_of=self._shares_of)
        self._memory, self._scalars = self._relaxation.memory, self._relaxation.scalars
        self._scalars.asked = controller.override
        #: What is known of the sensors; None if they read as they should.
        self._maps = SensorMaps(self.cell, options.sensors) if options.sensors else None
        if self._maps is not None:
            self._maps.check()
        check_squeeze(self.cell, self.grasp, self.path, options)
        self._shifted = controller.take_shift(self._relaxation.shift)
        self._bind()
        self._begin()

    @alone
    def _bind(self) -> None:
        """Let the controller step with these wrenches: another may have stepped it."""
        self._step = self.controller.bind_forces(
            self._memory, before_forces=self._before, after_forces=self._after, tell=self._tell
        )

    def _shares_of(self, holds: Holds) -> Array:
        """Shares in the object's pose (N, 6) while some arms hold it (N,)."""
        return self.controller.shares if all(holds) else self._commanded.shares_while(holds)

    def _begin(self) -> None:
        self._differences, self._compared = np.zeros((len(self.cell), 6)), 0
        self._check: SensorCheck | None = None
        self._found: SensorJudgement | None = None
        self._disturbed = False
        self._place = self.shift
        #: The next arm to let go, at rest: its index, and how far that is ahead on the object's clock [s].
        self._leaves: tuple[int, float] | None = None

    # -- calls of the inner controller ---------------------------------------------------------------------------

    @property
    def _lock(self) -> Any:
        return self.controller._lock

    @property
    def path(self) -> ObjectPath:
        """The controller's path."""
        return self.controller.path

    def take_events(self) -> list[tuple[str, Any, float]]:
        """See :meth:`coopqp.QPController.take_events`."""
        return self.controller.take_events() if isinstance(self.controller, QPController) else []

    @property
    def paused(self) -> bool:
        """See :attr:`coopqp.QPController.paused`."""
        return bool(getattr(self.controller, "paused", False))

    @property
    def override(self) -> float:
        """The largest rate that is asked for; forces may allow less."""
        return float(self._scalars.asked)

    @property
    def asked_pose(self) -> pin.SE3 | None:
        """See :attr:`coopqp.QPController.asked_pose`."""
        return getattr(self.controller, "asked_pose", None)

    def _takes(self, operator: Operator, change: Change) -> None:
        super()._takes(operator, change)
        self._scalars.goes_on = 1.0

    def _ending_hold(self, act: Callable[[Operator], None]) -> Callable[[Operator], None]:
        """A call that ends a hold, in the thread that steps."""

        def acts(operator: Operator) -> None:
            act(operator)
            self._scalars.goes_on = 1.0

        return acts

    @property
    def _commanded(self) -> QPController:
        """The controller within, for what only that one can do."""
        controller = self.controller
        if not isinstance(controller, QPController):
            raise InvalidInputError(f"a {type(controller).__name__}", "ForceController", "This needs a QPController.")
        return controller

    def __repr__(self) -> str:
        return short_text(self)

    @alone
    def reset(self, q: ArrayLike, *, commanded: ArrayLike | None = None, clock: float = 0.0) -> None:
        """Start at rest at ``q``, (nq,) or readings (n, nq); see :meth:`coopqp.QPController.reset`.

        The arms hold the object where they are, and the object stays where it is until they have relaxed. So the start
        itself causes no force.

        Raises:
            InvalidInputError: as in the controller's reset, or an arm holds the object farther from its grasp than the
                grasps reach; nothing is then changed.
        """
        q = self.cell.at_rest(q, "ForceController.reset: q")
        held = q if commanded is None else self.cell.check_configuration(commanded, "ForceController.reset: commanded")
        clock = as_scalar(clock, "ForceController.reset: clock", open_low=False)
        before, motion = self._relaxation.kept(), self.path.grasps
        if motion is not None:
            holds = motion.holds(clock)
            self._relaxation.start_with(holds, bearing(holds, motion, clock, 1), motion.placements(clock))
        elif not self._relaxation.holding.everywhere:
            self._relaxation.start_with(*everywhere(len(self.cell)))
        try:
            shift = self._relaxation.found(held)
        except InvalidInputError:
            self._relaxation.restore(before)
            raise
        self.controller.take_shift(shift)()
        try:
            if clock == 0.0 and commanded is None:
                self.controller.reset(q)
            else:  # only a QPController begins in mid-path, or elsewhere than it is measured
                self._commanded.reset(q, commanded=commanded, clock=clock)
            self._relaxation.begin(shift)
            self._begin()
            self._look_at_grips()
        except BaseException:
            self._relaxation.restore(before)
            raise
        finally:
            self._shifted = self.controller.take_shift(self._relaxation.shift)
            self._shifted()

    def follow(self, path: ObjectPath, *, clock: float = 0.0) -> None:
        """Take another path; see :meth:`coopqp.QPController.follow`. It ends a hold, as :meth:`resume` does."""
        refuse_moving_holds(path, "ForceController.follow: path", _LET_GO)
        check_squeeze(self.cell, self.grasp, path, self.options)
        self._commanded.operate("follow", None, self._ending_hold(self._commanded.following(path, clock)))

    def set_override(self, share: float) -> None:
        """The largest rate of the object; see :meth:`coopqp.QPController.set_override`."""
        share = as_scalar(share, "set_override: share", open_low=False, high=1.0)
        if isinstance(self.controller, QPController):
            self.controller.operate("set_override", share, lambda operator: self._override(operator, share))
        else:
            self._scalars.asked = share

    def _override(self, operator: Operator, share: float) -> None:
        operator.gear, self._scalars.asked = None, share

    # -- the wrenches --------------------------------------------------------------------------------------------

    @property
    def internal(self) -> Array:
        """Internal wrench of each arm on the object, filtered (N, 6) [N, N·m], in the object frame."""
        return self._relaxation.internal.copy()

    @property
    def shift(self) -> Array:
        """Motion by which each grasp has given way, in the object frame (N, 6) [m, rad]."""
        return self._relaxation.shift.copy()

    @property
    def stiffer(self) -> float:
        """Measured stiffness of the servos as a multiple of the given one; 1 before it is measured."""
        return self._relaxation.stiffer

    @property
    def sensors(self) -> SensorJudgement | None:
        """What the presses at the start found of each sensor; None before their end, and without presses."""
        return self._found

    # -- the step ------------------------------------------------------------------------------------------------

    def step(
        self, q_measured: ArrayLike | None = None, *, wrenches: ArrayLike | None = None, dt: float | None = None
    ) -> ControlStep:
        """The command of one period; see :meth:`coopqp.QPController.step`.

        Args:
            q_measured: measured configuration (nq,). Without it the object does not begin to move.
            wrenches: wrenches of the arms on the object, each at the origin and in the axes of its tool (N, 6)
                [N, N·m]; None or NaN for missing ones.
            dt: length of this step [s], if not the nominal one.

        Raises:
            InvalidInputError: before the first :meth:`reset`, or wrenches of another shape; nothing is then changed.
            BusyError: another thread is in a call of this controller; nothing was changed.
        """
        if self._maps is not None and wrenches is not None:
            wrenches = self._maps.wrenches(self._shaped(wrenches))
        if self.controller.forces is not self._memory:
            self._bind()
        return self._step(q_measured, dt, wrenches)

    def _before(self, q_measured: ArrayLike | None, dt: float | None, wrenches: ArrayLike | None) -> None:
        """Take wrenches before a step, and let the grasps give way, where the core does not."""
        w, length = None if wrenches is None else self._shaped(wrenches), self.controller.accepted_dt(dt)
        relaxation, stage = self._relaxation, self._stage
        gives = relaxation.gives
        relaxation.hand_on(length)
        if gives and relaxation.aged:
            relaxation.look(self.controller.commanded)
        heard = relaxation.step(w, length)
        if stage < RELAXING and not self._scalars.sensor_fault:
            self._prepare(w, q_measured, length, heard == HEARD)
        elif stage == PRESSING and self._check is not None:  # a sensor fell silent: the press ends
            relaxation.shift += min(length / self.options.ramp_time, 1.0) * (self._place - relaxation.shift)
        if gives or stage == PRESSING:
            self._shifted()
        geared = self.controller.geared if isinstance(self.controller, QPController) else None
        if geared is not None:
            self._scalars.asked = geared
        share = relaxation.allow(length)
        if self._leaves is not None and self._leaves[1] < 2.0 * length:
            share = relaxation.allow_release(self._leaves[0])
        if share != self.controller.override:
            self.controller.lower_rate(share)

    def _after(self, step: ControlStep) -> None:
        """Note what a step asked the object and the arms for, where the core does not."""
        m = self._scalars
        self._relaxation.refer(self.controller.reference, step.dt)
        m.last_rate, m.stepped = step.rate, 1.0
        m.at_end = not step.clock_next > step.clock
        m.last_speed = np.abs(step.velocity).max()
        if m.why != NOTHING_MORE:
            self._tell(step)
        self._look_at_grips()

    def _look_at_grips(self) -> None:
        """See who holds the object now and who bears its load, and when that changes next."""
        relaxation, m, program = self._relaxation, self._scalars, self.path.grasps
        held = relaxation.holding
        if program is None and held.everywhere:
            m.look_at, self._leaves = np.inf, None
            return
        controller, clock, due = self._commanded, 0.0, False
        holds, bears, moved = everywhere(len(self.cell))
        if program is not None and controller.held is not None:
            motion, clock, taken = controller.held
            holds, due = motion.holds(max(taken, 0.0)), any(taken < at <= clock + SAME_CLOCK for at in motion.changes)
            bears = bearing(holds, program, controller.program_clock, controller.sense)
            moved = held.moved if holds == held.holds else motion.placements(clock)
        relaxation.take_holding(holds, bears, moved, controller.commanded)
        left, after = self._next_change(program)
        gone = [k for k in range(len(holds)) if holds[k] and not after[k]] if np.isfinite(left) else []
        self._leaves = (gone[0], left) if gone and self._rests_in(left) else None
        m.look_at = -np.inf if held.hands_over or due else clock + left - HAND_OVER_S - 3.0 * self.dt

    def _next_change(self, program: GraspMotion | None) -> tuple[float, Holds]:
        """How far the next change of contact is ahead on the object's clock [s], and who holds the object after it."""
        now, sense = self._commanded.program_clock, self._commanded.sense
        ahead = () if program is None or sense == 0 else program.changes
        left = min((sense * (at - now) for at in ahead if sense * (at - now) > -SAME_CLOCK), default=np.inf)
        if program is None or not np.isfinite(left):
            return np.inf, ()
        return left, program.holds(now + sense * (left + 2.0 * SAME_CLOCK))

    def _rests_in(self, left: float) -> bool:
        """Whether the object is at rest on its path so far ahead [s]."""
        motion = GuardedPath(self.path).motion(self._commanded.program_clock + self._commanded.sense * left)
        return motion is not None and float(np.abs(np.atleast_2d(motion)[0]).max()) <= STILL_OBJECT

    @property
    def _stage(self) -> int:
        return int(self._scalars.stage)

    def _shaped(self, wrenches: ArrayLike) -> Array:
        w = np.ascontiguousarray(wrenches, dtype=float)
        n = len(self.cell)
        if w.shape != (n, 6):
            raise InvalidInputError(
                f"wrenches of shape {w.shape}", "ForceController.step: wrenches", f"Give one per arm, ({n}, 6)."
            )
        return w

    def _prepare(self, w: Array | None, q_measured: ArrayLike | None, dt: float, heard: bool) -> None:
        """One step of the stages before the relaxation."""
        m, q = self._scalars, None if q_measured is None else np.asarray(q_measured, dtype=float)
        if q is None or q.shape != (self.cell.nq,) or not np.isfinite(q).all():
            q = None  # the controller says so
        if self._stage == CHECKING and m.stepped and heard and q is not None:
            check = None if self._disturbed else self._relaxation.sensor_check(q, self.dt)
            if check is None:
                self._compare(q)
            else:
                self._check, self._place = check, self.shift
                self._relaxation.wait_for(None, self.dt)
                self._go_on(PRESSING)
            if m.sensor_fault:
                return
        m.stage_time += dt
        if self._stage != PRESSING:
            return
        if self._check is None:
            if self._relaxation.press(dt):
                self._go_on(RELAXING)
        elif q is not None:
            self._press(self._check, w, q, dt)

    def _press(self, check: SensorCheck, w: Array | None, q: Array, dt: float) -> None:
        """Press the sensors; in the end, say which of them are wrong."""
        m = self._scalars
        if not check.began:  # the force at the start is that before the presses
            m.start_size = max(m.start_size, m.largest_force)
        shift = check.press(w, self.controller.commanded, q, dt)
        if check.disturbed:  # sensors are compared with the servos, and the arms relax from where they are
            self._check, self._disturbed = None, True
            self._relaxation.wait_for(0.0, self.dt)
            self._go_on(CHECKING)
            return
        self._relaxation.shift[:] = self._place + shift
        found = check.judgement
        if found is None:
            return
        self._found, self._check = found, None
        self._relaxation.wait_for(max(finding.lost for finding in found.findings), self.dt)
        self._relaxation.take_stiffness(found.stiffer, found.arms_stiffer, self.controller.commanded)
        wrong = [k for k, finding in enumerate(found.findings) if not (finding.fine or finding.late)]
        if not wrong and not self._relaxation.slow_down(found.latest, self.dt):
            wrong = [k for k, finding in enumerate(found.findings) if finding.late]
        if wrong:
            m.sensor_fault, m.sensor_arm = SENSOR_WRONG, wrong[0]
        self._go_on(RELAXING)

    def _compare(self, q: Array) -> None:
        """Compare the sensors with the servos at rest; in the end, say which sensor is wrong."""
        m = self._scalars
        self._differences += self._relaxation.off_servos(self.controller.commanded, q)
        self._compared += 1
        if m.stage_time < self.options.check_time:
            return
        off = np.linalg.norm(self._differences[:, :3] / self._compared, axis=1)
        k = int(off.argmax())
        if off[k] > self.options.sensor_tolerance:
            m.sensor_fault, m.sensor_arm, m.sensor_amount = SENSOR_WRONG, k, off[k]
        self._go_on(PRESSING)

    def _go_on(self, stage: int) -> None:
        self._scalars.stage, self._scalars.stage_time = stage, 0.0

    # -- copies --------------------------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        own = {name: copy.deepcopy(getattr(self, name)) for name in _VARYING}
        return {
            "controller": self.controller,
            "options": self.options,
            "own": own,
            "relaxation": copy.deepcopy(self._relaxation.kept()),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._build(state["controller"], state["options"])
        vars(self).update(state["own"])
        self._relaxation.restore(state["relaxation"])
        self._shifted()

    def __copy__(self) -> ForceController:
        other = object.__new__(ForceController)
        other.__setstate__(self.__getstate__() | {"controller": copy.copy(self.controller)})
        return other

    # -- why -----------------------------------------------------------------------------------------------------

    def _tell(self, step: ControlStep) -> None:
        """Put the forces' reason into a step, before anyone sees it."""
        why = int(self._scalars.why)
        status, cause = step.status, step.cause
        if why == BY_STAGE and status is Status.OFF_PATH:  # it waits for its arms, and is led back when it moves
            status, cause = Status.PAUSED, Cause.OPERATOR
        if (
            why in (BY_SENSOR, BY_REACH, BY_CONTACT) or squeezes(self._scalars)
        ) and status.precedence < Status.HOLDING.precedence:
            status = Status.HOLDING
        amend(
            step,
            status=status,
            reason="; ".join(filter(None, (self._why(why), step.reason))),
            cause=self._cause(why, status, cause),
        )

    def _cause(self, why: int, status: Status, cause: Cause | None) -> Cause | None:
        """The cause of a step that forces have something to say about, by its status and the cause so far."""
        if status is Status.TRACKING:
            return None
        if why == BY_CONTACT and status is Status.HOLDING:
            return Cause.CONTACT
        if why == BY_SENSOR and cause is Cause.CONTACT:
            return Cause.SENSOR
        if self.paused or cause not in (None, Cause.OPERATOR):  # forces lower the override
            return cause
        by_sensor = why == BY_SENSOR or (why == BY_STAGE and self._stage == CHECKING)
        return Cause.SENSOR if by_sensor else Cause.LIMIT

    def _why(self, why: int) -> str:
        m = self._scalars
        if why == BY_SENSOR:
            return self._fault()
        if why == BY_CONTACT:
            return f"the object touches something: {self._relaxation.contact()}"
        if why == BY_REACH:
            return f"the grasps cannot give way any further: {self._most()}"
        if why == BY_RELEASE:
            return f"the arms relax before arm {self.cell.arm_names[int(m.why_arm)]} lets go: {self._most()}"
        if why == BY_STAGE and squeezes(m):
            return f"the arms squeeze the object further while they relax: {self._most()}"
        if why == BY_STAGE:
            waits = self._stage == CHECKING and not self._compared
            if waits and m.stage_time > self.options.check_time + _PATIENCE * self.dt:
                return "the sensors cannot be compared with the servos: give q_measured, and wrenches of all arms"
            late = self._found is not None and self._found.latest > 0.0
            slowly = f" ({self._found.explain()}; forces relax more slowly)" if late and self._found else ""
            return f"{_STAGES[self._stage]}: {self._most()}{slowly}"
        if why == BY_FRICTION:
            used, arm = m.friction_used, self.cell.arm_names[int(m.why_arm)]
            return f"{100.0 * used:.0f} % of the friction at the palm of arm {arm}"
        rises = "" if m.largest_force > m.force_slows else "; the rate rises"
        return f"{self._most()} (slower from {self.options.slow_from:g} N on){rises}"

    def _fault(self) -> str:
        m = self._scalars
        arm, amount = self.cell.arm_names[int(m.sensor_arm)], m.sensor_amount
        if m.sensor_fault == SENSOR_SILENT:
            return f"no new wrench of arm {arm} for {1e3 * amount:.0f} ms"
        if self._found is not None:
            return self._found.explain()
        return (
            f"the force sensor of arm {arm} does not agree with its servos: {amount:.0f} N apart (tolerance "
            f"{self.options.sensor_tolerance:g} N)"
        )

    def _most(self) -> str:
        """The largest internal force, and where it is."""
        k = int(np.linalg.norm(self._relaxation.internal[:, :3], axis=1).argmax())
        return f"{self._relaxation.size:.0f} N at the grasp of arm {self.cell.arm_names[k]}"
