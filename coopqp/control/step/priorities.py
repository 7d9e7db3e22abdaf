"""The answer of one step by priority: nominal, fastest rate on the path, QP, QP whose chain may part, brake."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from coopqp.constraints.velocity import Rows
from coopqp.control.interface import NO_SOLVE, SolverReport
from coopqp.control.options import QPOptions
from coopqp.control.step.formulations import Answer, Pieces, StepProgram, StepTerms
from coopqp.control.step.velocity_bounds import VelocityBox, rate_interval
from coopqp.errors import InvalidInputError, said
from coopqp.model.chain import Chain
from coopqp.native.constants import AT_LIMIT, BISECTIONS, LIMIT_TOLERANCE, RESIDUE_TOLERANCE
from coopqp.solvers.base import QpSolver
from coopqp.solvers.choice import default_solver, make_solver
from coopqp.solvers.problem import QpProblem, QpSolution, SolverStatus
from coopqp.spatial import Array


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
    """For the QP of the chosen form, and for that whose chain may part; the full form is semidefinite."""
    choice, settings = options.solver, options.solver_settings
    if choice == "auto" and settings is None:
        choice = default_solver(strictly_convex=options.form == "condensed")
    solver = make_solver(choice, settings)
    if solver.strictly_convex_only and options.form != "condensed":
        raise InvalidInputError(
            f"form '{options.form}' with solver '{solver.name}', which takes strictly convex QPs only",
            "QPOptions",
            "Take form 'condensed', or a solver such as 'daqp'.",
        )
    return solver, make_solver(choice, settings)


#: A row of the box (a joint) or, from nv on, a further row; and the side on which it binds: 1 above, −1 below.
Active = tuple[int, float]


@dataclass(frozen=True, eq=False)
class StepAnswer(Answer):
    """A command inside the velocity bounds.

    Attributes:
        active: limits that bind.
        report: of the QP's solver.
        braked: no solver had an answer: all arms brake.
        exact: corrections are made in full.
        reason: why the arms brake.
    """

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
        box, pieces = self._box, self.program.pieces(terms)
        if self._options.shortcut and not box.any_outside:
            shortcut = None if self._chain.singular else self._nominal(terms, pieces, further)
            shortcut = shortcut or self._fastest_on_path(terms, pieces, further)
            if shortcut is not None:
                return shortcut
        solved, report = self._solve(terms, pieces, h, further)
        if solved is None:
            return self._brake(terms, v_prev, h, further, report)
        values = vars(solved) | {
            "velocity": np.clip(solved.velocity, box.lower, box.upper),
            "rate": min(max(solved.rate, 0.0), terms.rate_cap),  # a solver may miss its bounds a little
        }
        return StepAnswer(**values, active=self._active(solved.velocity, further), report=report)

    def solve_filled(
        self, base: Array, columns: Array, further: Rows, *, cap: float, relax: bool, parts: bool
    ) -> tuple[QpSolution, SolverReport]:
        """The solution of the condensed QP that the core has filled in, in the core's units."""
        problem = self.program.least_distance(base, columns, self._box, further, rate_cap=cap, relax=relax)
        solver = self._slack_solver if parts else self._solver
        solution = self._ask_parted(problem, columns) if parts else _ask(solver, problem)
        return solution, self._report(solution, solver)

    def _ask_parted(self, problem: QpProblem, columns: Array) -> QpSolution:
        """The solution of a QP whose chain may part, with the columns of its unknowns (m, n)."""
        solver, nv, n = self._slack_solver, self._chain.nv, columns.shape[1]
        solver.reset()  # an old solution is no warm start, and a copy of the controller does not have it
        solution = _ask(solver, problem)
        if not solution.usable and not solver.strictly_convex_only:
            solver.reset()
            wider = self.program.with_velocities(problem, problem.C[:nv, n - 6 * self._chain.n_arms : n])
            solution = _ask(solver, wider)
        if solver is self._solver:
            solver.reset()
        return solution

    def _nominal(self, terms: StepTerms, pieces: Pieces, further: Rows) -> StepAnswer | None:
        """Full corrections at the cap, if that is admissible."""
        box, v = self._box, pieces.command(terms.rate_cap)
        excess = np.maximum(v - box.upper, box.lower - v).max()
        if not excess <= LIMIT_TOLERANCE or not _keeps(further, v, LIMIT_TOLERANCE):
            return None
        return StepAnswer(np.clip(v, box.lower, box.upper), terms.rate_cap, exact=True)

    def _fastest_on_path(self, terms: StepTerms, pieces: Pieces, further: Rows) -> StepAnswer | None:
        """Rate line search: full corrections at the fastest admissible rate, up to the cap; None if none is."""
        box, cap = self._box, terms.rate_cap
        along = np.concatenate([pieces.along, further.G @ pieces.along])
        interval = _rates(pieces.command(0.0), pieces.along, box, further)
        if interval is None:
            return None
        low, high, row = interval
        if not (high >= max(low, 0.0) and low <= 1.0):
            return None
        rate = high if high < cap else max(cap, low)
        v = pieces.command(rate)
        clipped = np.clip(v, box.lower, box.upper)
        if not np.abs(v - clipped).max() <= 2.0 * LIMIT_TOLERANCE or not _keeps(further, v, 10.0 * LIMIT_TOLERANCE):
            return None
        active: tuple[Active, ...] = ((row, 1.0 if along[row] > 0.0 else -1.0),) if high < cap else ()
        return StepAnswer(clipped, rate, active=active, exact=True)

    def _solve(self, terms: StepTerms, pieces: Pieces, h: float, further: Rows) -> tuple[Answer | None, SolverReport]:
        """The QP of the chosen form; where its chain cannot be kept, the one that lets the chain part."""
        program, box = self.program, self._box
        for relax in (False, True) if further.soft.any() else (False,):
            if self._options.form == "condensed":
                answer, solution = self._condensed(terms, pieces, h, further, relax=relax)
            elif not relax:
                answer, solution = self._full(terms, h, further)
            if answer is not None and self._believable(answer.velocity):
                return answer, self._report(solution, self._solver)
        problem, base, B = program.condensed(terms, pieces, box, further, relax=True, parts=True)
        parted = self._ask_parted(problem, B)
        report = self._report(parted, self._slack_solver)
        if not parted.usable:
            return None, report
        answer = program.read_condensed(parted.x, terms, base, B)
        if not self._believable(answer.velocity):
            return None, report
        return replace(answer, chain=program.parting(answer, terms)), report

    def _condensed(
        self, terms: StepTerms, pieces: Pieces, h: float, further: Rows, *, relax: bool
    ) -> tuple[Answer | None, QpSolution]:
        """The condensed form's answer, and the solver's: again in other units of self-motions that ask for them."""
        program, box = self.program, self._box
        problem, base, B = program.condensed(terms, pieces, box, further, relax=relax)
        solution = _ask(self._solver, problem)
        if not solution.usable:
            return None, solution
        units = program.units_condensed(solution, B, box, h)
        if units is not None:
            problem, base, stiffer = program.condensed(terms, pieces, box, further, relax=relax, units=units)
            again = _ask(self._solver, problem)
            if again.usable:
                solution, B = again, stiffer
        return program.read_condensed(solution.x, terms, base, B), solution

    def _full(self, terms: StepTerms, h: float, further: Rows) -> tuple[Answer | None, QpSolution]:
        """The same of the full form."""
        program, box = self.program, self._box
        solution = _ask(self._solver, program.full(terms, box, further))
        if not solution.usable:
            return None, solution
        units = program.units_full(solution, terms, box, h)
        if units is not None:
            again = _ask(self._solver, program.full(terms, box, further, units=units))
            solution = again if again.usable else solution
        return program.read_full(solution.x, terms), solution

    def _believable(self, v: Array) -> bool:
        """Finite, and inside the box but for the solver's residue (a NaN fails the comparison)."""
        return bool(np.maximum(v - self._box.upper, self._box.lower - v).max() <= RESIDUE_TOLERANCE)

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
        reason = unsolved(report)
        twists = terms.offsets, terms.grasp_corrections
        offsets, grasp = (chain.joint_velocities(w @ terms.to_world.T) for w in twists)
        object_twist = chain.twists(v_prev).mean(axis=0)
        present = terms.to_world.T @ object_twist
        along = terms.along if terms.along.ndim == 1 else terms.along.mean(axis=0)
        length = float(along @ (metric * along))
        rate = max(float(along @ (metric * present)) / length, 0.0) if length > 0.0 else 0.0
        along_world = rate * (terms.along @ terms.to_world.T)
        motions = chain.joint_columns(np.stack(np.broadcast_arrays(along_world, object_twist), axis=-1)).T
        motions = motions + chain.null_part(v_prev)
        soft, hard = further.only(further.soft > 0.0), further.only(further.soft == 0.0)
        for kept in (hard, further.only(np.zeros(len(further), dtype=bool))):
            candidates = []
            for motion, base in itertools.product(motions, (offsets + grasp, offsets)):
                interval = _rates(base, motion, box, kept)
                if interval is None or not interval[1] >= max(interval[0], 0.0):
                    continue
                share, broken = _least_broken(soft, base, motion, max(interval[0], 0.0), interval[1])
                v = np.clip(base + share * motion, box.lower, box.upper)
                candidates.append((broken, StepAnswer(v, min(share * rate, 1.0))))
            if candidates:
                best = min(candidates, key=lambda candidate: candidate[0])[1]  # the first of equals
                return replace(best, grasp_share=0.0, path_share=0.0, report=report, braked=True, reason=reason)
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
        Gv = further.G @ v
        above = np.concatenate([v - self._box.upper, Gv - further.upper])
        below = np.concatenate([self._box.lower - v, further.lower - Gv])
        may_break = np.arange(above.size) >= v.size
        return tuple(
            (int(row), sign)
            for sign, excess in ((1.0, above), (-1.0, below))
            for row in np.flatnonzero((np.abs(excess) <= AT_LIMIT) | (may_break & (excess > 0.0)))
        )


def unsolved(report: SolverReport | None) -> str:
    """Why the arms brake, with what a solver of the user's says."""
    if report is None or report.name == "ldp":
        return "the QP has no usable answer; braking"
    return f"the QP has no usable answer ({': '.join(filter(None, (report.status, report.message)))}); braking"


def _keeps(further: Rows, v: Array, tolerance: float) -> bool:
    Gv = further.G @ v
    return bool(((Gv <= further.upper + tolerance) & (Gv >= further.lower - tolerance)).all())


def _rates(base: Array, motion: Array, box: VelocityBox, further: Rows) -> tuple[float, float, int] | None:
    """Shares σ of ``motion`` with which ``base + σ motion`` keeps bounds and rows: see :func:`rate_interval`."""
    return rate_interval(
        np.concatenate([base, further.G @ base]),
        np.concatenate([motion, further.G @ motion]),
        np.concatenate([box.lower, further.lower]),
        np.concatenate([box.upper, further.upper]),
    )


def _least_broken(further: Rows, base: Array, along: Array, low: float, high: float) -> tuple[float, float]:
    """The share σ in [low, max(low, min(high, 1))] with which ``base + σ along`` breaks rows least, and by how much.

    If several shares break none, the smallest.
    """
    at, slope = further.G @ base, further.G @ along
    # Rows as a − σ b ≤ 0; the largest is a convex function of σ.
    a, b = np.concatenate([further.lower - at, at - further.upper]), np.concatenate([slope, -slope])
    finite = np.isfinite(a)
    a, b = a[finite], b[finite]
    if not a.size or (a - low * b).max() <= LIMIT_TOLERANCE:
        return low, 0.0
    high = max(low, min(high, 1.0))
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        k = int((a - middle * b).argmax())
        if b[k] > 0.0 and a[k] - middle * b[k] > 0.0:
            low = middle
        else:
            high = middle
    broken = float((a - high * b).max())
    return high, broken if broken > LIMIT_TOLERANCE else 0.0
