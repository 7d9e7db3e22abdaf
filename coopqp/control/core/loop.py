"""The loop of one controller: the core's step, over memory that Python and the core share.

The core calls back for a path, a constraint, or a solver of the user's, and with a step that numbers do not describe.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_floats
from coopqp.constraints.cause import Cause
from coopqp.constraints.rate import Knot
from coopqp.constraints.velocity import ConstraintTrouble, Rows
from coopqp.control.core.force_memory import relaxation_scalars
from coopqp.control.core.memory import build_memory, check_kinematics, put_options
from coopqp.control.interface import ControlStep, SolverReport, Status
from coopqp.control.operator.way import Way
from coopqp.control.options import QPOptions
from coopqp.control.step.constraint_set import Constraints
from coopqp.control.step.contact import refused
from coopqp.control.step.decoding import STATUSES, RecordReader
from coopqp.control.step.other_solver import StepSolver
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.core import _core
from coopqp.core._core import MOST_RELAXING, SAME_CLOCK, SEGMENT
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
        self._forces: Any = None
        numbers = memory.options
        numbers.own_solver = self.solver.name == "ldp"
        self._report: SolverReport | None = None
        if not numbers.own_solver:
            self._core.bind(solve=self._solve)
        self._certified = constraints.certified
        numbers.certified = self._certified is not None
        numbers.leaves_path = constraints.gives_way
        self._loop.override_rate = self._loop.posture_blend = 1.0
        self._share: float | None = math.nan  # of the accelerations that the path's options are for; none yet
        check_kinematics(chain, self._core.linearise)
        target = options.posture.target
        self._target = None if target is None else cell.check_configuration(target, "PostureOptions: target")
        #: Faults of this step in words, by the code of the reason; for faults that numbers do not describe.
        self._said: dict[int, str] = {}
        self._held_by = Cause.INPUT
        self._core.bind(as_measured=self._as_measured, attach=self._attaches, say=self._say, said=self._said)
        self._evades: Callable[[], bool] | None = self._evade if constraints.evades else None
        if constraints:
            self._core.bind(bound_node=self._bound_node)
        if constraints.velocity:
            self._core.bind(ask_for_rows=self._put_rows, tighten=self._tighten if constraints.evades else None)
        if self._certified is not None and not cell.groups:  # distances in the core's memory know each arm by itself
            self._proposal.dt = dt  # of the first step, for what it prepares
            rows = self._certified.in_memory(self._memory.of_rows())
            ahead = None if rows is None else self._certified.in_memory(self._memory.of_rows(), ahead=True)
            if rows is not None and ahead is not None:
                self._evades = ahead.evade
                self._core.bind(clear=rows.clear, further_rows=rows.rows, tightened=rows.tightened)
                self._core.bind(survey_here=rows.surveys, survey_ahead=ahead.surveys, stopping=ahead.stopping)
        self.step, self.try_step, self.may_rest = self._core.step, self._core.try_step, self._core.may_rest
        self.hold, self.release = self._core.hold, self._core.release
        self.steps_here, self.steps_elsewhere = self._core.steps_here, self._core.steps_elsewhere

    def call(self, *, poll: Callable[[Any], None], look: Callable[[ControlStep, bool], None]) -> None:
        """Let the core call what is due at a step: each one while :attr:`polled`, else in :attr:`steps_until_poll`.

        Args:
            poll: before a step of a length that is asked for, while each is polled.
            look: with the step, and whether :attr:`steps_until_poll` are over.
        """
        self._core.bind(poll=poll, look=look)

    @property
    def steps_until_poll(self) -> int:
        """Steps until ``look`` is due, see :meth:`call`."""
        steps: int = self._core.steps_until_poll
        return steps

    @steps_until_poll.setter
    def steps_until_poll(self, steps: int) -> None:
        self._core.steps_until_poll = steps

    @property
    def polled(self) -> bool:
        """Whether ``poll`` and ``look`` are called in each step."""
        polled: bool = self._core.polled
        return polled

    @polled.setter
    def polled(self, polled: bool) -> None:
        self._core.polled = polled

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
        if self._forces is not None:
            self._forces.look_at = -math.inf
        had = self._motion is not None
        self._motion = motion
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

    def bind_forces(self, memory: Array, **calls: Callable[..., None]) -> Callable[..., ControlStep]:
        """The core's step with wrenches: see :meth:`coopqp.QPController.bind_forces`."""
        if len(self.cell) > MOST_RELAXING:
            raise InvalidInputError(f"{len(self.cell)} arms", "ForceController", f"Give at most {MOST_RELAXING}.")
        self._core.bind_forces(memory)
        self._core.bind(**calls)
        self._forces = relaxation_scalars(memory)
        step: Callable[..., ControlStep] = self._core.step_with_wrenches
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
        override, paused = self.override
        return 0.0 if self._box.accelerates or paused else override

    def set_override(self, override: float, *, paused: bool) -> None:
        """Set override and pause from the next step on."""
        self._loop.override_rate, self._loop.paused = override, paused

    @property
    def override(self) -> tuple[float, bool]:
        """Override, and whether the object is paused."""
        return self._loop.override_rate, bool(self._loop.paused)

    def retarget(self, path: ServoPath, goal: pin.SE3, rate: float) -> bool:
        """Go over to a way to a target at a rate, if the first step along it keeps that rate and no joint jumps."""
        numbers, elbows = np.empty(4 + SEGMENT), self._guarded.elbows
        if elbows is not None:
            numbers = np.concatenate([numbers, elbows.packed()])
        taken = self._core.retarget(_numbers_of(goal), numbers, path.speed, path.spin, rate) > 0
        if taken:
            path.take(goal, numbers[4 : 4 + SEGMENT])
        return taken

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

    def memory(self) -> Any:
        """All that a copy of this loop needs beside its arguments and its path."""
        return self.at["state"].copy()

    def restore(self, memory: Any) -> None:
        """Go on from what :meth:`memory` of the same version returned."""
        self.at["state"][:] = memory
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
        return STATUSES[int(self._loop.status)]

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

    def _bound_node(self, slot: int) -> bool:
        """Lower the cap and the decrease of a new knot as the constraints demand; False if they allow no rate.

        A constraint that fails makes the cap NaN.
        """
        at, nv, numbers = self.at, self.cell.nv, self._core.node(slot)
        vectors = slice(nv * slot, nv * slot + nv)
        q = self.cell.configuration_of(at["node_positions"][vectors])
        slope, curvature = (at[f"node_{name}"][vectors].copy() for name in ("slope", "curvature"))
        preview = self.options.preview
        share = 1.0 if preview is None else preview.curvature_share
        knot = Knot(numbers.clock, CellState(self.cell, q), slope, curvature, numbers.span)
        try:
            found = self.constraints.bound(knot, self.dt, share)
            if self._certified is not None:
                quiet = self._certified.quiet_ahead
                at["quiet_ahead_centre"][:], at["quiet_ahead_reach"][:] = quiet.centre, quiet.reach
                self._loop.quiet_ahead_slack = quiet.slack
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

    # -- what numbers do not describe ------------------------------------------------------------------------------

    def _say(self, step: ControlStep) -> None:
        """Put words into a step: why it holds, and what a solver of the user's has said."""
        p = self._proposal
        report = self._report if p.asked_solver else None
        self._reader.put_words(step, int(p.reason), self._said, report=report, held_by=self._held_by)

    def _hold(self, why: str, cause: Cause) -> None:
        """The step holds, unless something else holds it."""
        p = self._proposal
        if p.watch_cap > 0.0:
            self._said[_CONSTRAINT_FAILED], self._held_by = why, cause
            p.watch_cap, p.hold = 0.0, True
            p.reason, p.reason_index = _CONSTRAINT_FAILED, -1

    def _attaches(self) -> bool:
        """Whether all arms that attach are where they grasp; else the step holds."""
        assert self._motion is not None
        carried = [_pose_of(numbers) for numbers in self.at["measured_carried"].reshape(-1, 12)]
        taken = self.at["changed_at"].item()
        reason = refused(self.cell, self.grasp, self._motion, carried, clock=self.clock, taken=taken)
        if reason:
            self._hold(reason, Cause.TRACKING)
        return not reason

    def _as_measured(self, q: Any) -> Array:
        """Another object than the core reads as a measured configuration (nq,); NaN if it is none."""
        nq = self.cell.nq
        try:
            measured = q if type(q) is np.ndarray and q.dtype == np.float64 else as_floats(q)
        except NOT_NUMBERS:
            fault = f"q_measured is {type(q).__name__}, not {nq} numbers"
        else:
            if measured.shape == (nq,):
                return np.ascontiguousarray(measured)
            fault = f"q_measured must have shape ({nq},), got {measured.shape}"
        self._said[_NOT_FINITE] = fault
        return np.full(nq, np.nan)

    def _put_rows(self) -> int:
        """Ask the constraints and put their rows into the core's memory. If one fails the step holds."""
        at = self.at
        try:
            rows = self.constraints.rows(self.q, self._proposal.dt, blind=not self._looks_ahead)
        except ConstraintTrouble as trouble:
            self._hold(str(trouble), trouble.cause)
            if trouble.rows is None:
                return 0
            rows = trouble.rows
        m = len(rows)
        at["further"][: m * self.cell.nv] = rows.G.ravel()
        at["further_lower"][:m], at["further_upper"][:m], at["further_soft"][:m] = rows.lower, rows.upper, rows.soft
        at["further_owner"][:m] = rows.owner
        if self._certified is not None:
            at["quiet_centre"][:], at["quiet_reach"][:], *slack = self._certified.quiet
            self._loop.quiet_slack, self._loop.quiet_approach = slack
        return m

    def _rows(self) -> Rows:
        """The rows of the constraints that stand in the core's memory, and those that brake all arms together."""
        at, m, nv = self.at, int(self._proposal.rows), self.cell.nv
        lower, upper, soft, owner = (at[f"further_{name}"][:m].copy() for name in ("lower", "upper", "soft", "owner"))
        return Rows(at["further"][: m * nv].reshape(m, nv).copy(), lower, upper, soft, owner.astype(int))

    def _tighten(self) -> bool:
        """Raise lower bounds where the command keeps the rows and breaks their constraints; whether it does."""
        h, v, rows = self._proposal.dt, self.at["command"], self._rows()
        tighter = self.constraints.tightened(rows, self.cell.moved(self.q, h * v), v, h)
        if tighter is not None:
            self.at["further_lower"][: len(rows)] = tighter.lower
        return tighter is not None

    def _solve(self, relax: int, width: int) -> bool:
        """The condensed QP that the core has filled in, by a solver of the user's choice; False without an answer."""
        at, nv, further = self.at, self.cell.nv, self._rows()
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
