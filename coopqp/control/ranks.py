"""The ranked answer of one step: nominal, ray, QP, QP with slack, brake."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from coopqp.control.command import NO_SOLVE, SolverReport
from coopqp.control.core import Workspace
from coopqp.control.forms import Answer, CondensedQp, Pieces, StepProgram, StepTerms
from coopqp.control.limits import LIMIT_TOLERANCE, VelocityBox, rate_interval
from coopqp.control.options import QPOptions
from coopqp.control.solvers import QpProblem, QpSolution, QpSolver, SolverStatus, make_solver
from coopqp.model.chain import Chain
from coopqp.model.limits import BindingLimit
from coopqp.spatial import Array

#: A solver's excess over a limit up to this is clipped; more is a failure [rad/s or m/s].
RESIDUE_TOLERANCE = 1e-5

#: Distance within which a velocity stands at its limit [rad/s or m/s].
_AT_LIMIT = 1e-7

#: Cost of joint velocities in the second attempt at a chain that may part [1/(rad/s)²].
_CALM = 1e-4

_ZERO6 = np.zeros(6)
_ZERO6.flags.writeable = False


#: What a broken solver may raise; :class:`QpSolver` itself turns what its backend is known to raise into a status.
_BROKEN = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    BufferError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SystemError,
    TypeError,
    ValueError,
)


def _ask(solver: QpSolver, problem: QpProblem) -> QpSolution:
    """Solve, whatever the solver does: what raises, or answers with anything but n finite numbers, has failed."""
    try:
        solution = solver.solve(problem)
        if isinstance(solution, QpSolution) and (
            not solution.usable or (solution.x.shape == problem.g.shape and np.isfinite(solution.x).all())
        ):
            return solution
        message = "the answer is not as many finite numbers as there are unknowns"
    except _BROKEN as error:
        message = f"it raised {type(error).__name__}: {str(error)[:200]}"
    nothing = np.full(problem.g.size, np.nan)
    return QpSolution(nothing, SolverStatus.FAILED, None, None, None, 0, 0.0, message)


@dataclass(eq=False)
class StepAnswer:
    """Joint velocities inside the box, and what was given up for them; see :class:`GivenUp`."""

    velocity: Array
    rate: float
    grasp_share: float = 1.0
    path_share: float = 1.0
    off_path: Array = field(default_factory=lambda: _ZERO6)
    chain: float = 0.0
    binding: tuple[BindingLimit, ...] = ()
    report: SolverReport = NO_SOLVE
    braked: bool = False
    exact: bool = False
    reason: str = ""
    correction: Array = field(default_factory=lambda: _ZERO6)


@final
class StepSolver:
    """Finds the answer of a step whose kinematics are linearised; owns the kept QP solvers."""

    def __init__(self, chain: Chain, box: VelocityBox, options: QPOptions) -> None:
        self._chain, self._box, self._options = chain, box, options
        self.program = StepProgram(chain, options.weights)
        self._solver = make_solver(options.solver, options.solver_settings)
        self._slack_solver = make_solver(options.solver, options.solver_settings)

    def reset(self) -> None:
        """Forget warm starts."""
        self._solver.reset()
        self._slack_solver.reset()

    def answer(self, terms: StepTerms, v_prev: Array, h: float) -> StepAnswer:
        """The best admissible command; never fails."""
        box = self._box
        pieces = self.program.pieces(terms)
        if self._options.shortcut and not box.outside.any():
            found = self._on_path(terms, pieces, v_prev, h)
            if found is not None:
                return found
        solved, report = self._solve(terms, pieces)
        if solved is None:
            return self._brake(terms, v_prev, h, report)
        return StepAnswer(
            np.clip(solved.velocity, box.lower, box.upper),
            solved.rate,
            solved.grasp_share,
            solved.path_share,
            solved.off_path,
            solved.chain,
            self._active(solved.velocity, v_prev, h),
            report,
        )

    def settle(self, ws: Workspace, outside: int, cap: float, v_prev: Array, h: float) -> StepAnswer | None:
        """The answer of the condensed QP that a kernel has filled in; None if there is none to be believed.

        Args:
            ws: the kernel's workspace; the errors foreseen for the next step come out in it.
            outside: joints outside their limits, as the kernel's ``rows`` counted them.
            cap: largest rate.
            v_prev, h: velocity of the previous step (nv,), length of this one [s].
        """
        qp, unit = self._filled(ws, outside, cap), ws.unit
        solution = _ask(self._solver, qp.problem)
        if not solution.usable:
            return None
        x = solution.x[: unit.size]
        found = np.dot(ws.columns, x)
        found += ws.base
        v = np.maximum(found, ws.lower)
        np.minimum(v, ws.upper, out=v)
        excess = np.abs(found - v)
        if not excess[excess.argmax()] <= RESIDUE_TOLERANCE:
            return None
        x = x[:9] * unit[:9]
        off_path = x[:6]
        late, grasp_lost, path_lost = x[6:].tolist()
        drift = off_path + (1.0 - path_lost) * ws.path + ws.offsets
        drift += (1.0 - grasp_lost) * ws.grasp
        drift *= h
        np.add(ws.errors, drift, out=ws.predicted)
        ws.scalars[ws.HAS_PREDICTED], ws.scalars[ws.LAST_DT] = 1.0, h
        return StepAnswer(
            v,
            cap - late,
            1.0 - grasp_lost,
            1.0 - path_lost,
            off_path,
            0.0,
            self._active(found, v_prev, h),
            self._report(solution),
            correction=ws.path,
        )

    def _filled(self, ws: Workspace, outside: int, cap: float) -> CondensedQp:
        """The kernel's QP with the bounds of its unknowns; with an unknown and an equality for every joint outside."""
        qp = ws.qp
        if outside:
            qp = self.program.memory(ws.unit.size, outside)
            qp.take(ws.qp)
            qp.lead_back(ws.outside[:outside], ws.recovery, self.program.recovery_scale)
        qp.set_bounds(6, ws.unit[6:9], cap)
        return qp

    def _on_path(self, terms: StepTerms, pieces: Pieces, v_prev: Array, h: float) -> StepAnswer | None:
        """Full corrections at the fastest admissible rate, up to the cap; None if no rate will do."""
        box, cap = self._box, terms.rate_cap
        base = pieces.fixed + pieces.grasp + pieces.path
        found = rate_interval(base, pieces.along, box.lower, box.upper)
        if found is None:
            return None
        low, high, j = found
        if not (high >= max(low, 0.0) and low <= 1.0):
            return None
        rate = max(cap, low)
        binding: tuple[BindingLimit, ...] = ()
        if high < cap:
            rate = high
            binding = (box.binding(j, 1.0 if pieces.along[j] > 0.0 else -1.0, v_prev, h),)
        v = base + rate * pieces.along
        clipped = np.clip(v, box.lower, box.upper)
        if not np.abs(v - clipped).max() <= 2.0 * LIMIT_TOLERANCE:
            return None
        return StepAnswer(clipped, rate, binding=binding, exact=True)

    def _solve(self, terms: StepTerms, pieces: Pieces) -> tuple[Answer | None, SolverReport]:
        """The QP of the chosen form; where its chain cannot be kept, the one that lets the chain part."""
        program, box = self.program, self._box
        if self._options.form == "condensed":
            problem, base, B = program.condensed(terms, pieces, box)
            solution = _ask(self._solver, problem)
            answer = program.read_condensed(solution.x, terms, base, B) if solution.usable else None
        else:
            problem = program.full(terms, box)
            solution = _ask(self._solver, problem)
            answer = program.read_full(solution.x, terms) if solution.usable else None
        if answer is not None and self._believable(answer.velocity):
            return answer, self._report(solution)
        problem = program.full(terms, box, slack=True)
        relaxed = _ask(self._slack_solver, problem)
        if not relaxed.usable:
            # Without a cost of their own the joint velocities defeat some solvers near a singularity.
            joints = range(self._chain.nv)
            problem.H[joints, joints] += _CALM
            relaxed = _ask(self._slack_solver, problem)
        report = self._report(relaxed)
        if not relaxed.usable:
            return None, report
        answer = program.read_full(relaxed.x, terms)
        if not self._believable(answer.velocity):
            return None, report
        parting = program.parting(answer, terms)
        return Answer(
            answer.velocity, answer.rate, answer.grasp_share, answer.path_share, answer.off_path, parting
        ), report

    def _believable(self, v: Array) -> bool:
        """Finite, and inside the box but for the solver's residue (a NaN fails the comparison)."""
        excess = np.maximum(v - self._box.upper, self._box.lower - v)
        return bool(excess[excess.argmax()] <= RESIDUE_TOLERANCE)

    def _report(self, solution: QpSolution) -> SolverReport:
        return SolverReport(
            self._solver.name,
            solution.status.value,
            solution.iterations,
            solution.violation,
            solution.solve_time_s,
            solution.message,
        )

    def _brake(self, terms: StepTerms, v_prev: Array, h: float, report: SolverReport) -> StepAnswer:
        """All arms brake together, as hard as the box allows, without a solver.

        Along the path if a rate will do, else along the object's present motion, else by one common factor. What
        redundant arms do in their null-space fades with the rest.
        """
        box, chain, metric = self._box, self._chain, self.program.metric
        why = f"{report.status}: {report.message}" if report.message else report.status
        reason = f"the QP has no usable answer ({why}); braking"
        offsets, grasp = (
            chain.joint_velocities(twists @ terms.to_world.T, np.empty(chain.nv))
            for twists in (terms.offsets, terms.grasp_corrections)
        )
        object_twist = chain.twists(v_prev).mean(axis=0)
        present = np.linalg.solve(terms.to_world, object_twist)
        length = float(terms.along @ (metric * terms.along))
        rate = max(float(terms.along @ (metric * present)) / length, 0.0) if length > 0.0 else 0.0
        ways = chain.joint_columns(np.column_stack([rate * (terms.to_world @ terms.along), object_twist]))
        ways += chain.null_part(v_prev)[:, None]
        for along in ways.T:
            for base in (offsets + grasp, offsets):
                interval = rate_interval(base, along, box.lower, box.upper)
                if interval is not None and interval[1] >= max(interval[0], 0.0):
                    share = max(interval[0], 0.0)
                    v = np.clip(base + share * along, box.lower, box.upper)
                    return StepAnswer(v, min(share * rate, 1.0), 0.0, 0.0, report=report, braked=True, reason=reason)
        v = np.clip(v_prev * self._slowdown(v_prev, h), box.lower, box.upper)
        return StepAnswer(v, 0.0, 0.0, 0.0, report=report, braked=True, reason=reason)

    def _slowdown(self, v: Array, h: float) -> float:
        """Largest common braking: the factor that the tightest joint can follow in one step."""
        speed = np.abs(v)
        moving = speed > 1e-12
        if not moving.any():
            return 0.0
        reach = self._chain.cell.limits.acceleration[moving] * h / speed[moving]
        return float(1.0 - min(reach.min(), 1.0))

    def _active(self, v: Array, v_prev: Array, h: float) -> tuple[BindingLimit, ...]:
        """Names of the limits that a QP's answer stands at."""
        box = self._box
        above, below = v - box.upper, box.lower - v
        room = np.maximum(above, below)
        if room[room.argmax()] < -_AT_LIMIT:
            return ()
        return tuple(
            box.binding(int(j), sign, v_prev, h)
            for sign, excess in ((1.0, above), (-1.0, below))
            for j in np.flatnonzero(np.abs(excess) <= _AT_LIMIT)
        )
