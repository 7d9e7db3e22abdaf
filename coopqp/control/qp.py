"""The cooperative QP controller: the chain holds, the object stays on its path, a command always comes.

A step observes (is the input plausible, are the arms in step), proposes (the rate that the path ahead allows, the
wanted motion, and the strictly ranked answer: the nominal command if it is admissible; else the fastest rate on the
path; else the QP; else the QP whose chain may part; else a synchronised brake) and commits. The core does it
(coopqp/core). See docs/derivations.md.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_options, as_scalar, as_step, require
from coopqp.control.core.loop import CoreLoop
from coopqp.control.interface import ControlStep, Status, amend, short_text
from coopqp.control.lock import alone
from coopqp.control.operator.calls import OperatorCalls
from coopqp.control.operator.operator import Operator
from coopqp.control.operator.waiting import RATE_CALLS, Waiting, kind_of
from coopqp.control.options import QPOptions
from coopqp.control.step.constraint_set import Constraints
from coopqp.control.step.start import check_path, check_start, held_command, rate_into, start_warning
from coopqp.errors import BusyError, InvalidInputError, StartWarning, StiffnessWarning
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp, held_at
from coopqp.model.state import CellState
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.moving_grasps import grasp_at
from coopqp.paths.path import HoldPath, ObjectPath
from coopqp.paths.servo import ServoPath
from coopqp.spatial import Array
from coopqp.version import __version__


@final
class QPController(OperatorCalls):
    """Cooperative QP controller for any number of arms that hold one object.

    A copy (``copy.copy``, ``copy.deepcopy``, pickle) goes on bit for bit where the original stands; with another solver
    than the default one, up to that solver's accuracy. ``copy.copy`` shares a path and constraints of the user's own.

    Args:
        cell, grasp, path: the arms, how they hold the object, and its path.
        dt: nominal length of a step [s], 0.5 at most.
        options: settings, or a dictionary of them.
        constraints: further constraints, see :class:`coopqp.VelocityConstraint` and :class:`coopqp.RateBound`.

    Attributes:
        solver: name of the solver that a QP step uses.

    Raises:
        InvalidInputError, UnknownNameError, MissingExtraError: bad settings, an unknown or missing solver, a wrong
            path or constraint.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        *,
        dt: float,
        options: QPOptions | Mapping[str, Any] | None = None,
        constraints: Sequence[Any] = (),
    ) -> None:
        require(grasp, Grasp, "QPController: grasp", "Give a Grasp of the placements.")
        grasp.check_arms(cell)
        GuardedPath(path).check("QPController: path")
        self._build(cell, grasp, path, dt, options, constraints)

    def _build(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        dt: float,
        options: QPOptions | Mapping[str, Any] | None,
        constraints: Sequence[Any],
    ) -> None:
        self.cell, self.grasp = cell, grasp
        self.dt = as_step(dt, "QPController: dt")
        self.options = as_options(QPOptions, options, "QPController: options")
        self._checked = Constraints(cell, constraints)
        self.constraints = self._checked.given
        self._loop = CoreLoop(cell, grasp, dt=self.dt, options=self.options, constraints=self._checked)
        self.solver = self._loop.solver.name
        self._operator = Operator(cell, grasp, self._loop, path, dt=self.dt, options=self.options)
        self._loop.call(poll=self._before, look=self._after)
        #: The core's step.
        self._step = self._loop.step
        self.started = self._outside = False
        #: The memory of what relaxes the forces between the arms; None if nothing does.
        self.forces: Array | None = None
        #: By how much the tools are elsewhere on the object than the grasp says (N, 6); None if they are not.
        self._shift: Array | None = None
        #: An operator's calls from another thread than the one that steps: made in the next step.
        self._waiting: Waiting[tuple[str, Callable[[], object]]] = Waiting()
        self._take(path)

    @property
    def path(self) -> ObjectPath:
        """The object's program: the path that was given, followed or shifted last."""
        return self._operator.way.program

    @property
    def kernel(self) -> str:
        """Gone since version 0.3."""
        raise AttributeError("QPController.kernel is gone: the core makes every step.")

    @property
    def _lock(self) -> Any:
        return self._loop

    def _check_path(self, path: ObjectPath) -> None:
        shifted = self._shift is not None and bool(np.any(self._shift))
        check_path(self.cell, path, self.constraints, shifted=shifted, relaxes=self.forces is not None)

    def _take(self, path: ObjectPath, clock: float = 0.0) -> float:
        self._check_path(path)
        begin = self._operator.restart(path, clock)
        self._loop.follow(self._operator.way.path, self._operator.way)
        self._attend()
        return begin

    def _attend(self) -> None:
        """Let the core call in each step, where an operator or a start has something to say."""
        self._loop.polled = not self.started or self._outside or not self._operator.quiet
        if self._waiting:  # also what has come meanwhile
            self._loop.polled = True

    def _soon(self, name: str, value: Any, call: Callable[[], object]) -> None:
        """Make an operator's call: at once, or in the next step where another thread steps this controller."""
        loop = self._loop
        try:
            waits = loop.steps_elsewhere()
            if not waits:
                loop.hold()
        except BusyError:
            waits = True
        if waits:
            self._waiting.put(kind_of(name, value), (name, call))
            self._loop.polled = True
            return
        try:
            self._catch_up()  # what others have asked for before
            call()
        finally:
            loop.release()

    def _catch_up(self, *, in_step: bool = False) -> None:
        """Make the calls of other threads; in a step as far as one looks at another path, which costs more than it."""
        for calls in self._waiting.take():
            name, call = calls[-1]
            if in_step and self._operator.looked and name not in RATE_CALLS:
                return
            self._operator.make(name, call)

    def __repr__(self) -> str:
        return short_text(self)

    # -- starting --------------------------------------------------------------------------------------------------

    @alone
    def reset(self, q: ArrayLike, *, commanded: ArrayLike | None = None, clock: float = 0.0) -> None:
        """Start at rest at ``q``, at the object's ``clock`` [s]; ends a fault, but no pause and no override.

        A later reset with a :class:`ServoPath` starts where the arms hold the object, and rests there until the next
        target. With any other path the arms have to be where it is at ``clock``: give the clock of the last step to go
        on in mid-path, or :meth:`follow` a path that starts where they are.

        Args:
            q: measured configuration (nq,), or readings at rest (n, nq), whose mean has less noise.
            commanded: configuration (nq,) that the robots' own controllers hold now. Commands go on from there, and the
                start itself changes no force. None: commands begin at ``q``.
            clock: where the object is on its path [s].

        Raises:
            InvalidInputError: as :class:`Controller`, or a joint is measured too far from where it is commanded.

        Warns:
            StartWarning: a joint is outside its limits, an arm off its grasp, or the object off its path. The steps say
                so until it is mended.
            StiffnessWarning: readings or ``commanded`` are given, so arms are measured, and nothing is told of the
                stiffness of their servos.
        """
        self._catch_up()
        o = self.options
        clock = _on(self.path, clock, "reset: clock")
        given, q = q, self.cell.at_rest(q, "reset: q")
        begin = q if commanded is None else held_command(self.cell, q, commanded, self.options.supervision.joint_jump)
        again = self.started and isinstance(self.path, ServoPath)
        path = HoldPath(self._held_at(begin)) if again else self.path
        start = check_start(
            self.cell,
            self.grasp,
            path,
            begin,
            tolerance_m=o.start_tolerance_m,
            tolerance_rad=o.start_tolerance_rad,
            clock=clock,
        )
        self._checked.check(start, self.dt)
        if isinstance(self.path, ServoPath) and again:
            self.path.restart(path.pose(0.0))
        warned = self._start_warnings(start, GuardedPath(path).pose(clock), clock)
        self._operator.restart(self.path, clock)
        self._operator.take_events()
        self.started, self._outside = True, bool(warned)
        self._loop.start(start)
        first = self._take(self.path, clock)
        self._loop.start_path(first, self._first_rate(clock))
        self._operator.begin_trail()
        if warned:
            warnings.warn("; ".join(warned), StartWarning, stacklevel=3)
        unknown = o.supervision.stiffness is None and self.forces is None and len(self.cell) > 1
        if unknown and (commanded is not None or np.ndim(given) > 1):
            warnings.warn(
                "a rigid grip hides an arm that stops from what is measured: the others drag it along. Tell the "
                "servos' stiffness: QPOptions(supervision=SupervisionOptions(stiffness=…)), in a cell file "
                "stiffness_nm_per_rad of [[arms]]",
                StiffnessWarning,
                stacklevel=3,
            )

    def _first_rate(self, clock: float) -> float | None:
        """The rate that a path begins with: full where the object rests there; None for the loop's own."""
        motion = GuardedPath(self.path).motion(clock)
        if motion is None or np.any(motion):
            return None
        return 0.0 if self.paused else self.override

    def _start_warnings(self, q: Array, pose: pin.SE3 | None, clock: float) -> tuple[str, ...]:
        grasp = grasp_at(self.grasp, self.path, clock)
        return start_warning(self.cell, grasp, self.options.common_error.shares(self.cell), pose, q)

    def _held_at(self, q: ArrayLike) -> pin.SE3:
        """Where the arms hold the object at ``q``: by their shares in the common error, from the first one's view."""
        return held_at(self.grasp, self.options.common_error.shares(self.cell), CellState(self.cell, q))

    def follow(self, path: ObjectPath, *, clock: float = 0.0) -> None:
        """Go on from the present command along another path, from ``clock`` [s] on; the motion is not interrupted.

        The rate goes on as the one that comes closest to the object's present motion. The path should be where the
        object is. If it is not, the path correction leads the object there while the clock runs, and the status is
        OFF_PATH until then; :meth:`pause` first to have the clock wait for the object.

        Raises:
            InvalidInputError: not a path, or the clock is not on it; the old path goes on.
        """
        self.operate("follow", None, self.following(path, clock))

    def following(self, path: ObjectPath, clock: float) -> Callable[[Operator], None]:
        """What :meth:`follow` asks for, checked as there."""
        GuardedPath(path).check("follow")
        clock = _on(path, clock, "follow: clock")
        self._check_path(path)
        return lambda operator: self._follow(path, clock)

    def _follow(self, path: ObjectPath, clock: float) -> None:
        rate = self._rate_into(path, clock) if self.started else None
        begin = self._take(path, clock)
        if self.started:
            self._loop.start_path(begin, self._first_rate(clock) if rate is None else rate)
            self._operator.begin_trail()

    def _rate_into(self, path: ObjectPath, clock: float) -> float | None:
        """The rate on the new path; None for the rate of a start."""
        loop = self._loop
        if not np.isfinite(self.cell.limits.acceleration).any():
            return max(loop.rate, 0.0 if self.paused else self.override)
        now, ahead = GuardedPath(self._operator.way.path).motion(loop.clock), GuardedPath(path).motion(clock)
        if now is None or ahead is None:
            return None
        if now.ndim + ahead.ndim > 2:  # tools move on the object, too
            now, ahead = (
                np.zeros((1 + len(self.cell), 6)) + np.eye(1 + len(self.cell), 1) * x if x.ndim == 1 else x
                for x in (now, ahead)
            )
        return rate_into(loop.rate, now, ahead, length=self.options.weights.length)

    # -- speed override and pause ----------------------------------------------------------------------------------

    def set_override(self, share: float) -> None:
        """The largest rate σ from now on: 1 for the path's own speed, 0 for rest.

        The object slows down as fast as the joints can follow, on its path. A reset or another path changes nothing.

        Raises:
            InvalidInputError: not a number from 0 to 1; the old override stays.
        """
        share = as_scalar(share, "set_override: share", open_low=False, high=1.0)

        def set_it(operator: Operator) -> None:
            operator.gear = None
            operator.override = share

        self.operate("set_override", share, set_it)

    def lower_rate(self, share: float) -> None:
        """The largest rate σ that forces allow, in the thread that steps; it is no call of an operator.

        Raises:
            InvalidInputError: not a number from 0 to 1; the old one stays.
        """
        if not (type(share) is float and 0.0 <= share <= 1.0):
            share = as_scalar(share, "lower_rate: share", open_low=False, high=1.0)
        self._operator.override = share

    @property
    def geared(self) -> float | None:
        """The path speed σ that a belt asks for, see :meth:`gear`; None if none does."""
        return self._operator.geared()

    @property
    def shares(self) -> Array:
        """Share of each arm in the object's pose (N, 6), by ``options.common_error``."""
        return self.options.common_error.shares(self.cell)

    def shares_while(self, holds: Sequence[bool]) -> Array:
        """The same while only some arms hold the object (N,)."""
        return self.options.common_error.shares_of(self.cell, holds)

    @property
    def held(self) -> tuple[GraspMotion, float, float] | None:
        """How tools move on the object and who holds it, on the way that is followed; its clock, and that up to which
        changes are taken [s]. None where all grasps are fixed.
        """
        return self._loop.held

    @property
    def sense(self) -> int:
        """1 along the program, −1 back along it, 0 away from it, by hand."""
        return self._operator.way.sense

    @property
    def override(self) -> float:
        """The largest rate σ that is asked for, while the object is not paused."""
        return self._operator.override

    @property
    def paused(self) -> bool:
        """Whether the object is asked to rest; once it does the status of a step is PAUSED."""
        return self._operator.paused

    @property
    def _commanded(self) -> QPController:
        return self

    @property
    def program_clock(self) -> float:
        """The object's clock on its program [s]."""
        return self._operator.clock

    def operate(self, call: str, value: Any, act: Callable[[Operator], None], *, started: bool = False) -> None:
        """Make an operator's call: at once, or in the next step where another thread steps.

        Of calls of one kind that come between two steps the next step makes the last one. What cannot be done any more
        by then changes nothing, and is an event of its own: see :meth:`take_events`.

        Args:
            call, value: the call's name and its value, for recordings.
            act: what it does; it raises InvalidInputError before it changes anything.
            started: it needs a reset before.

        Raises:
            InvalidInputError: before the first :meth:`reset`, for a call that needs it.
        """
        if started and not self.started:
            raise InvalidInputError("nothing moves before reset", call, "Call reset(q) first.")

        def done() -> None:
            clock = self._operator.clock
            act(self._operator)
            self._operator.note(call, value, clock)
            self._attend()

        self._soon(call, value, done)

    def shift_grasp(self, shift: ArrayLike) -> None:
        """Hold the object at shifted places of the tools from the next step on: ``exp(d_k) X_k`` for ``X_k`` of grasp.

        For small moves, as :class:`coopqp.ForceController` makes them to relax the forces between the arms. The arms go
        there as fast as the chain's errors are corrected; :attr:`grasp` stays.

        Args:
            shift: d, of each tool in the object frame (N, 6) [m, rad]; zeros lead back.

        Raises:
            InvalidInputError: not six finite numbers per arm.
        """
        try:
            d = np.array(shift, dtype=float)
        except NOT_NUMBERS:
            d = np.zeros(0)
        if d.shape != (len(self.cell), 6) or not np.isfinite(d).all():
            raise InvalidInputError(
                "no six finite numbers per arm", "shift_grasp", f"Give an array ({len(self.cell)}, 6)."
            )
        self._refuse_shift("shift_grasp")

        def shift_it() -> None:
            self._refuse_shift("shift_grasp")  # another path may be followed since
            self.take_shift(d)()

        self._soon("shift_grasp", None, shift_it)

    def _refuse_shift(self, where: str) -> None:
        if self.path.grasps is not None and self.path.grasps.moves:
            raise InvalidInputError(
                "tools move on the object along this path", where, "Give the tools' motion in the program."
            )

    def take_shift(self, shift: Array) -> Callable[[], bool]:
        """As :meth:`shift_grasp`, for a shift that its owner goes on to change in place.

        Args:
            shift: as there, an array of finite numbers (N, 6) that stays.

        Returns:
            What to call after each change, in the thread that steps.
        """
        self._shift = shift
        taken: Callable[[], bool] = self._loop.take_shift(shift)
        return taken

    def bind_forces(self, memory: Array, **calls: Callable[..., None]) -> Callable[..., ControlStep]:
        """A step with wrenches, for :class:`coopqp.ForceController`: ``(q_measured, dt, wrenches) → ControlStep``.

        Args:
            memory: numbers of ``ForceRelaxation`` in ``force_relaxation.h``, and the vectors behind them.
            calls: ``before_forces`` of the same arguments, and ``after_forces`` of the step, where the core does not
                let the grasps give way itself; ``tell`` of a step that forces have something to say of.
        """
        self.forces = memory
        return self._loop.bind_forces(memory, **calls)

    def accepted_dt(self, dt: Any) -> float:
        """Length of a step that is asked for [s]: the nominal one where none is, or it is refused."""
        low, high = (share * self.dt for share in self.options.supervision.dt_range)
        try:
            return self.dt if dt is None else as_scalar(dt, "dt", low=low, high=high, open_low=False)
        except InvalidInputError:
            return self.dt

    @property
    def reference(self) -> pin.SE3:
        """Where the last step has asked for the object: the path's pose at its clock, if there is one."""
        return self._loop.reference

    def take_events(self) -> list[tuple[str, Any, float]]:
        """The operator's calls since the last time: name, value as plain data, and the program's clock then [s].

        One that could not be made in its step is ``"refused"``, and its value says in a sentence why. At most the last
        hundred: a recorder asks in every step.
        """
        return self._operator.take_events()

    @property
    def asked_pose(self) -> pin.SE3 | None:
        """Where the operator asks for the object by hand, at the end of the last step; None along the program."""
        way = self._operator.way
        return way.path.pose(self._loop.clock) if way.sense == 0 else None

    @property
    def commanded(self) -> Array:
        """Commanded configuration at the end of the last step (nq,)."""
        return self._loop.q

    # -- the step --------------------------------------------------------------------------------------------------

    def step(self, q_measured: ArrayLike | None = None, *, dt: float | None = None) -> ControlStep:
        """Compute the command of one period.

        The chain error is taken from the *commanded* configuration and the object's error from the measured one:
        once the object is gripped the measured chain error hides in servo deflection, and feeding it back into an
        integrated command would wind up without bound.

        Args:
            q_measured: measured configuration (nq,); None where commands are followed exactly.
            dt: length of this step [s], if not the nominal one.

        Raises:
            InvalidInputError: before the first :meth:`reset`. Never for run-time data: those lead to a status.
            BusyError: another thread steps, resets or copies this controller; nothing was changed. What an operator
                asks for from another thread (:meth:`pause`, :meth:`resume`, :meth:`set_override`, :meth:`retarget`,
                :meth:`follow`, :meth:`shift_grasp`) is no such call: it waits for the next step.
        """
        core_step = self._step  # two lines: Python finds an attribute sooner than a method
        return core_step(q_measured, dt)

    def _before(self, dt: Any) -> None:
        """What is due before a step, where the core calls: of calls from other threads, and of an operator."""
        if not self.started:
            raise InvalidInputError("step before reset", "QPController", "Call reset(q) first.")
        operator = self._operator
        if self._waiting:
            operator.looked = False
            self._catch_up(in_step=True)
        if operator.gear is not None and self.forces is None:
            operator.override = operator.override if (share := operator.geared()) is None else share
        operator.before(self.accepted_dt(dt))

    def _after(self, step: ControlStep, due: bool) -> None:
        """What there is to say of a step, where the core calls."""
        self._operator.tell(step)
        if due:
            self._operator.look(step)  # on the way that this step has gone, which may be new
        if self._outside:  # it started there: say so until it is mended
            off_path = step.status is Status.OFF_PATH or step.status in (Status.HOLDING, Status.FAULT)
            by_hand = off_path or step.status is Status.JOGGING
            pose = None if by_hand else GuardedPath(self.path).pose(step.clock)
            warned = self._start_warnings(step.q, pose, step.clock)
            if warned or off_path:
                amend(step, reason="; ".join(filter(None, (step.reason, *warned))))
            else:
                self._outside = False
        self._attend()

    # -- copies ----------------------------------------------------------------------------------------------------

    @alone
    def __getstate__(self) -> dict[str, Any]:
        self._catch_up()
        names = ("cell", "grasp", "dt", "options", "constraints")
        state = {name: getattr(self, name) for name in names}
        own = {"started": self.started, "outside": self._outside, "operator": self._operator.memory()}
        own["shift"] = None if self._shift is None else self._shift.copy()
        return state | own | {"memory": self._loop.memory(), "version": __version__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if state.pop("version", "0.2.0") != __version__:  # also where it has as many bytes
            raise InvalidInputError("its memory is of another version", "QPController", "Build and reset a new one.")
        names = ("started", "outside", "operator", "shift", "memory")
        started, outside, operator, shift, memory = (state.pop(name) for name in names)
        # the path may fail for a while: that is no reason not to be copied
        self._build(path=operator["way"].program, **state)
        self.started, self._outside = started, outside
        self._operator.restore(operator)
        self._loop.restore(memory)
        self._attend()
        if shift is not None:
            self.take_shift(shift)()

    def __copy__(self) -> QPController:
        state = self.__getstate__()
        state["operator"]["way"] = self._operator.way.apart()
        return self._copied(state)

    def __deepcopy__(self, memo: dict[int, Any]) -> QPController:
        state = self.__getstate__()
        for name in ("operator", "constraints"):
            state[name] = copy.deepcopy(state[name], memo)
        return self._copied(state)

    @staticmethod
    def _copied(state: dict[str, Any]) -> QPController:
        other = object.__new__(QPController)
        other.__setstate__(state)
        return other


def _on(path: ObjectPath, clock: Any, where: str) -> float:
    """A clock on a path [s]."""
    return as_scalar(clock, where, open_low=False, high=GuardedPath(path).duration)
