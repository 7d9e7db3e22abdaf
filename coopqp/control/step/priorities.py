"""The ranked answer of one step: nominal, fastest rate on the path, QP, QP whose chain may part, brake."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np

from coopqp.constraints.velocity import Rows
from coopqp.control.interface import NO_SOLVE, SolverReport
from coopqp.control.options import QPOptions
from coopqp.control.step.formulations import Answer, Pieces, StepProgram, StepTerms
from coopqp.control.step.velocity_bounds import VelocityBox, rate_interval
from coopqp.errors import InvalidInputError, said
from coopqp.model.chain import Chain
from coopqp.native.constants import AT_LIMIT, LIMIT_TOLERANCE, RESIDUE_TOLERANCE
from coopqp.solvers.base import QpSolver
from coopqp.solvers.choice import default_solver, make_solver
from coopqp.solvers.problem import QpProblem, QpSolution, SolverStatus
from coopqp.spatial import Array, largest

#: Cost of joint velocities in the second attempt at a chain that may part [1/(rad/s)²].
_CALM = 1e-4

#: Bisections of a share.
_BISECTIONS = 40

_ZERO6 = np.zeros(6)
_ZERO6.flags.writeable = False


def _ask(solver: QpSolver, problem: QpProblem) -> QpSolution:
    """Solve; a solver that raises, or answers with anything but n finite numbers, has failed."""
    try:
        solution = solver.solve(problem)
        if isinstance(solution, QpSolution) and (
            not solution.usable or (solution.x.shape == problem.g.shape and np.isfinite(solution.x).all())
        ):
            return solution
        message = "the answer is not as many finite numbers as there are unknowns"
    except Exception as error:
        message = f"it raised {said(error)}"
    nothing = np.full(problem.g.size, np.nan)
    return QpSolution(nothing, SolverStatus.FAILED, None, None, None, 0, 0.0, message)


def _make_solvers(options: QPOptions) -> tuple[QpSolver, QpSolver]:
    """For the QP of the chosen form, and for the slack form; the slack and the full form are semidefinite."""
    choice, settings = options.solver, options.solver_settings
    if choice == "auto" and settings is None:
        choice = default_solver(strictly_convex=options.form == "condensed")
    solver = make_solver(choice, settings)
    if not solver.strictly_convex_only:
        return solver, make_solver(choice, settings)
    if options.form != "condensed":
        raise InvalidInputError(
            f"form '{options.form}' with solver '{solver.name}', which takes strictly convex QPs only",
            "QPOptions",
            "Take form 'condensed', or a solver such as 'daqp'.",
        )
    return solver, make_solver(default_solver(strictly_convex=False))


#: A row of the box (a joint) or, from nv on, a further row; and the side on which it binds: 1 above, −1 below.
Active = tuple[int, float]


@dataclass(eq=False)
class StepAnswer:
    """Joint velocities inside the box, and what was given up for them; see :class:`GivenUp`."""

    velocity: Array
    rate: float
    grasp_share: float = 1.0
    path_share: float = 1.0
    off_path: Array = field(default_factory=lambda: _ZERO6)
    chain: float = 0.0
    active: tuple[Active, ...] = ()
    report: SolverReport = NO_SOLVE
    braked: bool = False
    exact: bool = False
    reason: str = ""


@final
class StepSolver:
    """Finds the answer of a step whose kinematics are linearised; owns the kept QP solvers."""

    def __init__(self, chain: Chain, box: VelocityBox, options: QPOptions) -> None:
        self._chain, self._box, self._options = chain, box, options
        self.program = StepProgram(chain, options.weights)
        self._solver, self._slack_solver = _make_solvers(options)
        self.name = self._solver.name

    def reset(self) -> None:
        """Forget warm starts."""
        self._solver.reset()
        self._slack_solver.reset()

    def answer(self, terms: StepTerms, v_prev: Array, h: float, further: Rows) -> StepAnswer:
        """The best admissible command; never fails."""
        box = self._box
        inside = self._options.shortcut and not box.any_outside
        if inside and not self._chain.singular:
            found = self._nominal(terms, further)
            if found is not None:
                return found
        pieces = self.program.pieces(terms)
        if inside:
            found = self._on_path(terms, pieces, further)
            if found is not None:
                return found
        solved, report = self._solve(terms, pieces, further)
        if solved is None:
            return self._brake(terms, v_prev, h, further, report)
        return StepAnswer(
            np.clip(solved.velocity, box.lower, box.upper),
            min(max(solved.rate, 0.0), terms.rate_cap),  # a solver may miss its bounds a little
            solved.grasp_share,
            solved.path_share,
            solved.off_path,
            solved.chain,
            self._active(solved.velocity, further),
            report,
        )

    def solve_filled(
        self, base: Array, columns: Array, unit: Array, cap: float, further: Rows
    ) -> tuple[Array | None, SolverReport]:
        """x of the condensed QP that the core has filled in, in the core's units; None without a usable answer."""
        problem = self.program.fill(base, columns, self._box, further)
        self.program.set_bounds(6, cap)
        solution = _ask(self._solver, problem)
        return (solution.x[: unit.size] if solution.usable else None), self._report(solution, self._solver)

    def _nominal(self, terms: StepTerms, further: Rows) -> StepAnswer | None:
        """Full corrections at the cap, if that is admissible."""
        chain, box, cap = self._chain, self._box, terms.rate_cap
        v = chain.joint_velocities(terms.twists(cap), np.zeros(chain.nv))
        if terms.null_along is not None:
            v += cap * terms.null_along
        if terms.null_offset is not None:
            v += terms.null_offset
        excess = largest(np.maximum(v - box.upper, box.lower - v))
        if not excess <= LIMIT_TOLERANCE or not _keeps(further, v, LIMIT_TOLERANCE):
            return None
        return StepAnswer(np.clip(v, box.lower, box.upper) if excess > 0.0 else v, cap, exact=True)

    def _on_path(self, terms: StepTerms, pieces: Pieces, further: Rows) -> StepAnswer | None:
        """Full corrections at the fastest admissible rate, up to the cap; None if no rate is admissible."""
        box, cap = self._box, terms.rate_cap
        base, along, lower, upper = pieces.fixed + pieces.grasp + pieces.path, pieces.along, box.lower, box.upper
        if len(further):
            base, along = np.concatenate([base, further.G @ base]), np.concatenate([along, further.G @ along])
            lower, upper = np.concatenate([lower, further.lower]), np.concatenate([upper, further.upper])
        found = rate_interval(base, along, lower, upper)
        if found is None:
            return None
        low, high, row = found
        if not (high >= max(low, 0.0) and low <= 1.0):
            return None
        rate = max(cap, low)
        active: tuple[Active, ...] = ()
        if high < cap:
            rate = high
            active = ((row, 1.0 if along[row] > 0.0 else -1.0),)
        v = (base + rate * along)[: box.lower.size]
        clipped = np.clip(v, box.lower, box.upper)
        if not largest(np.abs(v - clipped)) <= 2.0 * LIMIT_TOLERANCE or not _keeps(further, v, 10.0 * LIMIT_TOLERANCE):
            return None
        return StepAnswer(clipped, rate, active=active, exact=True)

    def _solve(self, terms: StepTerms, pieces: Pieces, further: Rows) -> tuple[Answer | None, SolverReport]:
        """The QP of the chosen form; where its chain cannot be kept, the one that lets the chain part."""
        program, box = self.program, self._box
        for relax in (False, True) if further.soft.any() else (False,):
            if self._options.form == "condensed":
                problem, base, B = program.condensed(terms, pieces, box, further, relax=relax)
                solution = _ask(self._solver, problem)
                answer = program.read_condensed(solution.x, terms, base, B) if solution.usable else None
            elif not relax:
                problem = program.full(terms, box, further)
                solution = _ask(self._solver, problem)
                answer = program.read_full(solution.x, terms) if solution.usable else None
            if answer is not None and self._believable(answer.velocity):
                return answer, self._report(solution, self._solver)
        problem = program.full(terms, box, further, slack=True)
        shared = self._slack_solver is self._solver
        self._slack_solver.reset()  # an old solution is no warm start, and a copy of the controller does not have it
        relaxed = _ask(self._slack_solver, problem)
        if not relaxed.usable:
            # Without a cost of their own the joint velocities defeat some solvers near a singularity.
            joints = range(self._chain.nv)
            problem.H[joints, joints] += _CALM
            relaxed = _ask(self._slack_solver, problem)
        if shared:
            self._solver.reset()
        report = self._report(relaxed, self._slack_solver)
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

    @staticmethod
    def _report(solution: QpSolution, solver: QpSolver) -> SolverReport:
        return SolverReport(
            solver.name,
            solution.status.value,
            solution.iterations,
            solution.violation,
            solution.solve_time_s,
            solution.message,
        )

    def _brake(self, terms: StepTerms, v_prev: Array, h: float, further: Rows, report: SolverReport) -> StepAnswer:
        """All arms brake together, as hard as the box allows, without a solver.

        Along the path if a rate is admissible, else along the object's present motion, else by one common factor. What
        redundant arms do in their null-space fades with the rest. The first of these that keeps the further rows is
        taken, else the one that breaks the soft rows by the least.
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
        soft, hard = further.only(further.soft > 0.0), further.only(further.soft == 0.0)
        for kept in (hard, further.only(np.zeros(len(further), dtype=bool))) if len(hard) else (hard,):
            best: tuple[float, Array, float] | None = None
            lower, upper = np.concatenate([box.lower, kept.lower]), np.concatenate([box.upper, kept.upper])
            for along in ways.T:
                for base in (offsets + grasp, offsets):
                    rows = np.concatenate([base, kept.G @ base]), np.concatenate([along, kept.G @ along])
                    interval = rate_interval(*rows, lower, upper)
                    if interval is None or not interval[1] >= max(interval[0], 0.0):
                        continue
                    share, broken = _least_broken(soft, base, along, max(interval[0], 0.0), interval[1])
                    if best is None or broken < best[0]:
                        best = broken, np.clip(base + share * along, box.lower, box.upper), min(share * rate, 1.0)
                    if broken == 0.0:
                        break
                if best is not None and best[0] == 0.0:
                    break
            if best is not None:
                return StepAnswer(best[1], best[2], 0.0, 0.0, report=report, braked=True, reason=reason)
        share = _least_broken(further, np.zeros(chain.nv), v_prev, self._slowdown(v_prev, h), 1.0)[0]
        v = np.clip(v_prev * share, box.lower, box.upper)
        return StepAnswer(v, 0.0, 0.0, 0.0, report=report, braked=True, reason=reason)

    def _slowdown(self, v: Array, h: float) -> float:
        """Largest common braking: the factor that the tightest joint can follow in one step."""
        speed = np.abs(v)
        moving = speed > 1e-12
        if not moving.any():
            return 0.0
        reach = self._chain.cell.limits.acceleration[moving] * h / speed[moving]
        return float(1.0 - min(reach.min(), 1.0))

    def _active(self, v: Array, further: Rows) -> tuple[Active, ...]:
        """The limits at which a QP's answer stands, and the rows that it had to break."""
        box = self._box
        above, below = v - box.upper, box.lower - v
        if len(further):
            Gv = further.G @ v
            above = np.concatenate([above, Gv - further.upper])
            below = np.concatenate([below, further.lower - Gv])
        room = np.maximum(above, below)
        if room[room.argmax()] < -AT_LIMIT:
            return ()
        broken = np.arange(room.size) >= v.size  # a further row that gave way
        return tuple(
            (int(row), sign)
            for sign, excess in ((1.0, above), (-1.0, below))
            for row in np.flatnonzero((np.abs(excess) <= AT_LIMIT) | (broken & (excess > 0.0)))
        )


def _keeps(further: Rows, v: Array, tolerance: float) -> bool:
    if not len(further):
        return True
    Gv = further.G @ v
    return bool(((Gv <= further.upper + tolerance) & (Gv >= further.lower - tolerance)).all())


def _least_broken(further: Rows, base: Array, along: Array, low: float, high: float) -> tuple[float, float]:
    """The share σ from ``low`` on, up to 1 or ``low``, with which ``base + σ along`` breaks rows least, and how much.

    If several shares break none, the smallest.
    """
    if not len(further):
        return low, 0.0
    at, slope = further.G @ base, further.G @ along
    # Rows as a − σ b ≤ 0; the largest is a convex function of σ.
    a, b = np.concatenate([further.lower - at, at - further.upper]), np.concatenate([slope, -slope])
    finite = np.isfinite(a)
    a, b = a[finite], b[finite]
    if not a.size or (a - low * b).max() <= LIMIT_TOLERANCE:
        return low, 0.0
    high = max(low, min(high, 1.0))
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        k = int((a - middle * b).argmax())
        if b[k] > 0.0 and a[k] - middle * b[k] > 0.0:
            low = middle
        else:
            high = middle
    broken = float((a - high * b).max())
    return high, broken if broken > LIMIT_TOLERANCE else 0.0
