"""The loop of one controller: three calls of the core, over memory that Python and the core share.

The core calls back for a path, a constraint, or a solver of the user's. It leaves a step open where rows of constraints
may bind that Python has not given yet.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Callable
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_floats
from coopqp.constraints.cause import Cause
from coopqp.constraints.rate import Knot
from coopqp.constraints.velocity import ConstraintTrouble, Rows, no_rows
from coopqp.control.core.force_memory import minding_scalars
from coopqp.control.core.memory import build_memory, check_kinematics, put_options
from coopqp.control.interface import ControlStep, SolverReport, Status, amend
from coopqp.control.operator.way import Way
from coopqp.control.options import QPOptions
from coopqp.control.step.constraint_set import Constraints
from coopqp.control.step.contact import Contact, filter_time, handed
from coopqp.control.step.decoding import STATUSES, RecordReader, unsolved
from coopqp.control.step.other_solver import StepSolver
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.core import _core
from coopqp.core._core import MOST_MINDING, MOST_TIGHTENINGS, SAME_CLOCK, SEGMENT
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.guarded import GuardedPath, is_known
from coopqp.paths.path import ObjectPath
from coopqp.paths.servo import ServoPath
from coopqp.paths.shifted import unshifted
from coopqp.spatial import Array

_NOT_FINITE, _PATH_FAILED, _LOOK_AHEAD_FAILED, _CONSTRAINT_FAILED = (
    _core.REASONS.index(name) for name in ("NOT_FINITE", "PATH_FAILED", "LOOK_AHEAD_FAILED", "CONSTRAINT_FAILED")
)
_NO_SHIFTS = np.zeros(0)
_ASK = _core.OUTCOMES.index("ASK")


@final
class CoreLoop:
    """Observes, proposes and commits, over the memory of one core.

    Args:
        cell, grasp: the arms, and how they hold the object.
        dt: nominal length of a step [s].
        options: settings.
        constraints: further constraints.
        arithmetic: ``"plain"`` for instructions that every processor has; ``"auto"`` for the fastest.

    Raises:
        ModelError: the cell has too many joints, or arms that share some, or joints that move as no known kind does.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        *,
        dt: float,
        options: QPOptions,
        constraints: Constraints,
        arithmetic: str = "auto",
    ) -> None:
        self.cell, self.grasp, self.dt, self.options = cell, grasp, dt, options
        self.constraints = constraints
        chain, box = Chain(cell, grasp), VelocityBox(cell)
        shares = options.common_error.shares(cell)
        self.solver = StepSolver(chain, box, options)
        self._chain, self._box = chain, box
        unit = self.solver.program.units
        memory = self._memory = build_memory(chain, box, shares, unit, options, dt, arithmetic=arithmetic)
        self.at, self._core, self._loop, self._proposal = memory.at, memory.core, memory.loop, memory.proposal
        self._shift: Array | None = None
        self._motion: GraspMotion | None = None
        self._shifted = False  # whether the core has shifts of the path
        self._minding: Any = None
        numbers = memory.options
        numbers.own_solver = self.solver.name == "ldp"
        self._report: SolverReport | None = None
        if not numbers.own_solver:
            self._core.bind(solve=self._solve)
        self._certified = constraints.certified
        numbers.certified = self._certified is not None
        numbers.leaves_path = constraints.gives_way
        self._loop.overridden = self._loop.ease = 1.0
        self._share: float | None = math.nan  # of the accelerations that the path's options are for; none yet
        check_kinematics(chain, self._core.linearise)
        target = options.posture.target
        self._target = None if target is None else cell.check_configuration(target, "PostureOptions: target")
        self._no_rows = no_rows(cell.nv)
        self._nan = np.full(cell.nq, math.nan)
        self._further = self._no_rows
        #: Bodies stand in the core's memory, which asks for their rows and for what stops the object itself.
        self._knows_bodies = False
        self._evades: Callable[[], bool] | None = self._evade if constraints.evades else None
        if constraints:
            self._core.bind(bound_knot=self._bound_knot)
        if self._certified is not None and not cell.groups:  # distances in the core's memory know each arm by itself
            self._proposal.dt = dt  # of the first step, for what it prepares
            rows = self._certified.in_memory(self._memory.of_rows())
            ahead = None if rows is None else self._certified.in_memory(self._memory.of_rows(), ahead=True)
            if rows is not None and ahead is not None:
                self._knows_bodies, self._evades = True, ahead.evade
                self._core.bind(clear=rows.clear, further_rows=rows.rows, tightened=rows.tightened)
                self._core.bind(survey_here=rows.surveys, survey_ahead=ahead.surveys, stopping=ahead.stopping)
        self.step = self._core.step
        self.hold, self.release = self._core.hold, self._core.release
        self.steps_here, self.steps_elsewhere = self._core.steps_here, self._core.steps_elsewhere
        #: Faults of this step in words, by the code of the reason; for faults that numbers do not describe.
        self._said: dict[int, str] = {}
        self._held_by = Cause.INPUT

    @property
    def looks_in(self) -> int:
        """Steps until ``look`` is due, see :meth:`take_look`."""
        steps: int = self._core.looks_in
        return steps

    @looks_in.setter
    def looks_in(self, steps: int) -> None:
        self._core.looks_in = steps

    def take_look(self, look: Callable[[ControlStep], None]) -> None:
        """Let the core's own step count, and call ``look`` with a step where it is due."""
        self._core.bind(look=look)

    # -- starting --------------------------------------------------------------------------------------------------

    def follow(self, path: ObjectPath, way: Way | None = None) -> None:
        """Take a path, as a way along a program; it begins with :meth:`start_path`."""
        self.path = path
        self._guarded = GuardedPath(path)
        share = self._guarded.planned_share
        if share != self._share:
            put_options(self._memory, self._chain, self._box, self.options.on(share), self.dt)
            self._share = share
        if self.options.preview is not None:
            self._memory.options.shortest = self.options.preview.along(self._guarded.duration).shortest
        elbows = self._guarded.elbows
        self._memory.options.elbows = 0 if elbows is None else len(elbows.clocks)
        self._reader = RecordReader(
            self.cell, self.grasp, way or Way.of(path), solver=self.solver.name, constraints=self.constraints,
            dt=self.dt, supervision=self.options.supervision,
        )  # fmt: skip
        evades = None if self._guarded.keeps_clear else self._evades
        self._core.bind(step_type=ControlStep, context=self._reader, status_names=self._reader.statuses, evade=evades)
        self._take_motion()
        self.take_path()

    def take_path(self) -> None:
        """Hand the path's numbers to the core: again where a target has moved."""
        path, duration = self._guarded, self._guarded.duration
        looks_ahead = self._looks_ahead = self.options.preview is not None and path.known_ahead
        base, shifts = unshifted(self.path) if is_known(self.path) else (self.path, _NO_SHIFTS)
        numbers, own = base.packed() if is_known(base) else None, None
        if numbers is None:
            breakpoints, own, shifts = path.breakpoints(), self._ask_path, _NO_SHIFTS
            numbers = np.array([duration, len(breakpoints), 0.0, *breakpoints])
        if path.elbows is not None:
            numbers = np.concatenate([numbers, path.elbows.packed()])
        self._core.bind(own_path=own)
        self._core.set_path(numbers, duration, looks_ahead, not is_known(self.path))
        if len(shifts) or self._shifted:
            self._core.set_shifts(shifts.ravel() if len(shifts) else None)
        self._shifted = bool(len(shifts))

    def _take_motion(self) -> None:
        """Hand the core how the tools move on the object along the path, and who holds it when."""
        at, motion, cell = self.at, self._guarded.grasps, self.cell
        if self._minding is not None:
            self._minding.look_at = -math.inf
        had = self._motion is not None
        self._motion = motion
        self.contact = None if motion is None else Contact(cell, self.grasp, motion)
        if motion is None:
            at["latched"][:] = 0.0
            if had:
                at["object"][:], at["shares"][:], at["holding"][:] = at["places"], self._shares_of(None), 1.0
            self._core.set_grasps(None)
            if had and self._shift is not None:
                self._core.shift_grasp(self._shift)
            return
        numbers, n = motion.packed(), len(cell)
        contact = [[clock, *self._shares_of(holds), *holds] for clock, holds in motion.contact]
        self._core.set_grasps(np.concatenate([numbers[:n], [len(contact)], np.ravel(contact), numbers[n:]]))

    def _shares_of(self, holds: tuple[bool, ...] | None) -> Array:
        """Shares (6 N,) in the common error while some arms hold; None: all do."""
        given = self.options.common_error
        return np.ravel(given.shares(self.cell) if holds is None else given.shares_of(self.cell, holds))

    def take_shift(self, shift: Array) -> Callable[[], bool]:
        """Returns a function that reads ``shift`` (N, 6) and moves the grasps; it returns False if not finite."""
        self._shift = shift
        return functools.partial(self._core.shift_grasp, shift)

    @property
    def reference(self) -> pin.SE3:
        """Where the last step has asked for the object."""
        return _pose_of(self.at["pose"])

    def take_minding(self, memory: Array, tell: Callable[[ControlStep], None]) -> Callable[..., Any] | None:
        """The core's step with wrenches: see :meth:`coopqp.QPController.take_minding`."""
        if len(self.cell) > MOST_MINDING:
            return None
        self._core.bind(tell=tell)
        self._core.bind_minding(memory)
        self._minding = minding_scalars(memory)
        step: Callable[..., Any] = self._core.step_minding
        return step

    def start(self, q: Array) -> None:
        """At rest at ``q``; forgets everything."""
        self.solver.reset()
        x = self.cell.positions(q)
        self._core.start(x)
        self.at["posture_target"][:] = x if self._target is None else self.cell.positions(self._target)

    def start_path(self, clock: float = 0.0, rate: float | None = None) -> None:
        """Along the path from ``clock`` on."""
        self._core.start_path(clock, self._starting_rate() if rate is None else rate)
        self.at["changed_at"][0] = clock - SAME_CLOCK

    def _starting_rate(self) -> float:
        override, paused = self.reins
        return 0.0 if self._box.accelerates or paused else override

    def set_reins(self, override: float, *, paused: bool) -> None:
        """Set override and pause from the next step on."""
        self._loop.overridden, self._loop.pause = override, paused

    @property
    def reins(self) -> tuple[float, bool]:
        """Override, and whether the object is paused."""
        return self._loop.overridden, bool(self._loop.pause)

    def look_ahead_again(self, rate: float | None = None) -> None:
        """The path ahead has changed; the object moves along it at a rate."""
        loop = self._loop
        kept = copy.copy(loop)
        if rate is not None:
            kept.rate, kept.rate_slope = rate, 0.0
        self.take_path()
        self._core.start_path(kept.clock, kept.rate)
        kept.quiet_ahead = loop.quiet_ahead
        self._loop.assign(kept)

    def retarget_motion(self, path: ServoPath, goal: pin.SE3, rate: float) -> bool | None:
        """Take the way to a new target as :class:`coopqp.QPController` does; None where an attempt has to say."""
        if self._guarded.elbows is not None:  # which the core's own numbers lack
            return None
        rows = self._rows_here()
        if rows is None:
            return None
        numbers = np.empty(4 + SEGMENT)
        taken: int = self._core.go_over(_numbers_of(goal), numbers, path.speed, path.spin, rate, rows)
        if taken > 0:
            path.take(goal, numbers[4:])
        return None if taken < 0 else taken > 0

    def _rows_here(self) -> int | None:
        """Put the rows of the constraints for a step from here into the core's memory; None if one fails.

        -1 where the core asks for them itself.
        """
        if not self.constraints.velocity or self._loop.rate == 0.0:
            return 0
        if self._knows_bodies:
            return -1
        kept = copy.copy(self._loop)
        self._core.observe(None, None)
        rows = self._put_rows()
        failed = bool(self._said)
        self._said.clear()
        kept.quiet_slack, kept.quiet_approach = self._loop.quiet_slack, self._loop.quiet_approach
        self._loop.assign(kept)
        return None if failed else rows

    def keep_travels(self, stride: int, *, anew: bool) -> None:
        """Keep the end of every so many steps from now on for :meth:`travels`, 0: of none; ``anew``: forget others."""
        kept = self._memory.travels
        kept.stride = stride
        if anew:
            kept.left, kept.count = stride, 0.0

    def travels(self) -> list[tuple[float, float, Array, Array]]:
        """What was kept since the last time: clock [s], σ, joint positions and velocities (nv,)."""
        kept, nv = self._memory.travels, self.cell.nv
        count, width = int(kept.count), 2 + 2 * nv
        kept.count = 0.0
        rows = self.at["travelled"][: count * width].copy().reshape(count, width)
        return [(row.item(0), row.item(1), row[2 : 2 + nv], row[2 + nv :]) for row in rows]

    def try_step(self) -> tuple[float, Array]:
        """σ that a step from here keeps, and the change of velocity (nv,); nothing is committed."""
        self._core.observe(None, None)
        self._core.propose(self._put_rows(), False)
        self._keep_rows()
        self._said.clear()
        p = self._proposal
        rate = 0.0 if p.braked else min(p.cap, p.new_rate)
        return rate, self.at["command"] - self.at["velocity"]

    def memory(self) -> Any:
        """All that a copy of this loop needs beside its arguments and its path."""
        return self.at["state"].copy()

    def restore(self, memory: Any) -> None:
        """Go on from what :meth:`memory` returned.

        Raises:
            InvalidInputError: it comes from another version.
        """
        state = self.at["state"]
        if memory.shape != state.shape:
            raise InvalidInputError("its memory is of another version", "QPController", "Build and reset a new one.")
        state[:] = memory
        if self._motion is not None:
            holds = self._motion.holds(self.clock)
            self.at["shares"][:], self.at["holding"][:] = self._shares_of(holds), holds

    @property
    def clock(self) -> float:
        """The object's clock [s]."""
        clock: float = self._loop.clock
        return clock

    @property
    def rate(self) -> float:
        """σ of the last step."""
        rate: float = self._loop.rate
        return rate

    @property
    def status(self) -> Status:
        """Status of the last step."""
        return STATUSES[int(self._loop.said)]

    @property
    def q(self) -> Array:
        """Commanded configuration (nq,)."""
        return self.cell.configuration_of(self.at["positions"])

    @property
    def positions(self) -> Array:
        """Commanded joint positions (nv,)."""
        return self.at["positions"]

    @property
    def velocity(self) -> Array:
        """Commanded joint velocities of the last step (nv,)."""
        return self.at["velocity"]

    @property
    def held(self) -> tuple[GraspMotion, float, float] | None:
        """How tools move on the object and who holds it, the clock of that, and up to which changes are taken [s]."""
        return None if self._motion is None else (self._motion, self.clock, self.at["changed_at"].item())

    # -- callbacks of the core -------------------------------------------------------------------------------------

    def _ask_path(self, clock: float, twist: int) -> bool:
        found = self._guarded.twist(clock) if twist else self._guarded.pose(clock)
        if found is None:
            return self._cannot_say(self._guarded.problem)
        self.at["own_pose"][: 6 if twist else 12] = found if twist else _numbers_of(found)
        return True

    def _cannot_say(self, why: str) -> bool:
        """Remember why the path or its look-ahead failed; the first failure of a step is its reason."""
        for code in (_PATH_FAILED, _LOOK_AHEAD_FAILED):
            self._said.setdefault(code, why)
        return False

    def _bound_knot(self, slot: int) -> bool:
        """Lower the cap and the decrease of a new knot as the constraints demand; False if they allow no rate.

        A constraint that fails makes the cap NaN.
        """
        at, nv, numbers = self.at, self.cell.nv, self._core.knot(slot)
        vectors = slice(nv * slot, nv * slot + nv)
        q = self.cell.configuration_of(at["knot_positions"][vectors])
        slope, curvature = (at[f"knot_{name}"][vectors].copy() for name in ("slope", "curvature"))
        preview = self.options.preview
        share = 1.0 if preview is None else preview.curvature_share
        knot = Knot(numbers.clock, CellState(self.cell, q), slope, curvature, numbers.span)
        try:
            found = self.constraints.bound(knot, self.dt, share)
            if self._certified is not None:
                quiet = self._certified.quiet_ahead
                at["quiet_ahead_centre"][:], at["quiet_ahead_reach"][:] = quiet.centre, quiet.reach
                self._loop.quiet_ahead = quiet.slack
        except ConstraintTrouble as trouble:
            numbers.cap = math.nan
            return self._cannot_say(str(trouble))
        if not found.cap > 0.0:
            numbers.limit_by(found.which)
            return False
        if found.cap < numbers.cap:
            numbers.cap = found.cap
            numbers.limit_by(found.which)
        numbers.fall, numbers.rise = found.decrease, found.rise
        return True

    def _evade(self) -> bool:
        """Self-motion at a knot that is tried; False if a constraint fails."""
        at = self.at
        try:
            slope = self.constraints.evaded(self.cell.configuration_of(at["evading_positions"]), at["evading_slope"])
        except ConstraintTrouble as trouble:
            return self._cannot_say(str(trouble))
        at["evading_slope"][:] = slope
        return True

    # -- the step, where Python takes part ---------------------------------------------------------------------------

    def careful_step(self, q_measured: Any, dt: Any) -> ControlStep:
        """A step whose input may be anything, whose path may fail, or that has further rows."""
        self._said.clear()
        measured = None if q_measured is None else self._as_measured(q_measured)
        before = (bool(self._loop.drifted), self.at["shares"].copy()) if self.contact_due else None
        self._core.observe(measured, dt)
        if before is not None:
            self._take_contact(*before)
        self._further = self._no_rows
        outcome = self._core.settle() if self._knows_bodies else self._core.propose(self._put_rows(), False)
        return self.finish(outcome)

    @property
    def contact_due(self) -> bool:
        """Whether a change of contact is not taken yet."""
        return self.contact is not None and self.contact.due(self.clock, self.at["changed_at"].item())

    def _take_contact(self, drifted: bool, shares: Array) -> None:
        """Take changes of contact that are due, or hold where an arm that attaches is not where it grasps."""
        at, p, contact = self.at, self._proposal, self.contact
        assert contact is not None
        measured = bool(p.has_measured) and self._loop.drifted != 0.0
        if measured and drifted:  # as it went on under the shares of the step before
            kept = handed(*(x.reshape(-1, 6) for x in (at["shares"], shares, at["measured_away"])))
            change = p.dt / (p.dt + filter_time(self.options.measurement_time, at["holding"])) * kept
            at["latched"][:] += kept
            at["drift"][:] += change
            at["measured"][:] += (0.0 if p.hold else p.watch_cap) * change
        carried = at["measured_carried" if measured else "carried"].reshape(-1, 12)
        reason = contact.refused(self.clock, at["changed_at"].item(), [_pose_of(numbers) for numbers in carried])
        if not reason:
            at["changed_at"][0] = self.clock + SAME_CLOCK
        elif p.watch_cap > 0.0:
            self._said[_CONSTRAINT_FAILED], self._held_by = reason, Cause.TRACKING
            p.watch_cap, p.hold = 0.0, 1.0
            p.reason, p.reason_arm = _CONSTRAINT_FAILED, -1.0
            at["measured"][:] = 0.0

    def finish(self, outcome: int | None = None) -> ControlStep:
        """Answer an open step, and commit it with what a solver of the user's has said."""
        p = self._proposal
        outcome = int(p.outcome) if outcome is None else outcome
        if outcome == _ASK:
            rows, held = self._put_rows(), _CONSTRAINT_FAILED in self._said
            outcome = self._core.propose(rows, not held)
        reason = self._said.get(int(p.reason), "")
        self._said.clear()
        self._keep_rows()
        report, braked = self._report if p.solved else None, p.braked and not p.reason
        step: ControlStep = self._core.commit()
        if report is not None and braked:
            reason = unsolved(report)
        if report is not None or reason:
            if reason and step.status is Status.OFF_PATH:  # how far it is off comes first
                reason = f"{step.reason.partition('; ')[0]}; {reason}"
            amend(step, **({} if report is None else {"solver": report}), **({"reason": reason} if reason else {}))
        if p.reason == _CONSTRAINT_FAILED:
            amend(step, cause=self._held_by)
        return step

    def _keep_rows(self) -> None:
        """Answer again with tighter rows where the command breaks their constraints."""
        for _ in range(MOST_TIGHTENINGS if len(self._further) else 0):
            h, v = self._proposal.dt, self.at["command"]
            rows = self.constraints.tightened(self._further, self.cell.moved(self.q, h * v), v, h)
            if rows is None:
                break
            self._further = rows
            self.at["further_lower"][: len(rows)] = rows.lower
            self._core.propose(len(rows), True)

    def _as_measured(self, q: Any) -> Array:
        if type(q) is np.ndarray and q.dtype == np.float64 and q.shape == (self.cell.nq,) and q.flags.c_contiguous:
            return q
        measured, trouble = _as_configuration(self.cell, q)
        if measured is None:
            self._said[_NOT_FINITE] = trouble
            return self._nan
        return measured

    def _put_rows(self) -> int:
        """Ask the constraints and put their rows into the core's memory. If one fails the step holds."""
        self._further = self._no_rows
        if not self.constraints.velocity:
            return 0
        at, p = self.at, self._proposal
        try:
            rows = self.constraints.rows(self.q, p.dt, blind=not self._looks_ahead)
        except ConstraintTrouble as trouble:
            if p.watch_cap > 0.0:
                self._said[_CONSTRAINT_FAILED], self._held_by = str(trouble), trouble.cause
                p.watch_cap, p.hold = 0.0, 1.0
                p.reason, p.reason_arm = _CONSTRAINT_FAILED, -1.0
            if trouble.rows is None:
                return 0
            rows = trouble.rows
        m = len(rows)
        at["further"][: m * self.cell.nv] = rows.G.ravel()
        at["further_lower"][:m], at["further_upper"][:m], at["further_soft"][:m] = rows.lower, rows.upper, rows.soft
        at["further_owner"][:m] = rows.owner
        self._further = rows
        if self._certified is not None:
            at["quiet_centre"][:], at["quiet_reach"][:], *slack = self._certified.quiet
            self._loop.quiet_slack, self._loop.quiet_approach = slack
        return m

    def _all_rows(self) -> Rows:
        """The rows of the constraints, and those that brake all arms together."""
        at, m, nv = self.at, int(self._proposal.rows), self.cell.nv
        if m == len(self._further):
            return self._further
        lower, upper, soft, owner = (at[f"further_{name}"][:m].copy() for name in ("lower", "upper", "soft", "owner"))
        return Rows(at["further"][: m * nv].reshape(m, nv).copy(), lower, upper, soft, owner.astype(int))

    def _solve(self, relax: int, width: int) -> bool:
        """The condensed QP that the core has filled in, by a solver of the user's choice; False without an answer."""
        at, nv, further = self.at, self.cell.nv, self._all_rows()
        rows, unknowns = nv + len(further), self.solver.program.units.size
        box = self._box  # as the core has found it
        box.lower[:], box.upper[:], box.recovery[:] = at["lower"], at["upper"], at["recovery"]
        box.outside[:] = at["outside"] != 0.0
        base, columns = at["base"][:rows], at["columns"][: rows * width].reshape(rows, width)
        solution, self._report = self.solver.solve(
            base, columns, further, cap=self._proposal.cap, relax=bool(relax), parts=width > unknowns
        )
        if not solution.usable:
            return False
        at["x"][:width] = solution.x[:width]
        if width > unknowns:
            return True
        pull = self.solver.program.pull(solution, columns, box) if self._chain.redundancy else None
        at["pull"][:] = 0.0 if pull is None else pull
        return True


def _numbers_of(pose: pin.SE3) -> Array:
    """R (9), p (3)."""
    return np.concatenate([pose.rotation.ravel(), pose.translation])


def _pose_of(numbers: Array) -> pin.SE3:
    """The reverse."""
    return pin.SE3(numbers[:9].reshape(3, 3), numbers[9:])


def _as_configuration(cell: RobotCell, q: Any) -> tuple[Array | None, str]:
    """A measured configuration as an array (nq,), or None and the fault of its type or shape."""
    try:
        measured = q if type(q) is np.ndarray and q.dtype == np.float64 else as_floats(q)
    except NOT_NUMBERS:
        return None, f"q_measured is {type(q).__name__}, not {cell.nq} numbers"
    if measured.shape != (cell.nq,):
        return None, f"q_measured must have shape ({cell.nq},), got {measured.shape}"
    return np.ascontiguousarray(measured), ""
