"""The QP of a step by a solver of the user's choice, where it is not the core's own.

The core fills in the rows ``base + B x`` of the condensed form (``program.cpp``); here they become a QP in the solver's
form, and the answer what the core goes on with. See "Substitution" in docs/derivations.md.
"""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.constraints.velocity import Rows
from coopqp.control.interface import SolverReport
from coopqp.control.options import QPOptions, RankWeights
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.core._core import SINGULAR_FLOOR
from coopqp.errors import said
from coopqp.model.chain import Chain
from coopqp.solvers.base import QpSolver
from coopqp.solvers.choice import make_solver
from coopqp.solvers.problem import QpProblem, QpSolution, SolverStatus
from coopqp.spatial import Array

#: Where the chain may part, self-motion costs no less than this share of it.
CALM = 1e-10


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


class StepProgram:
    """Builds and reads the QPs of one chain. Nothing is carried from step to step.

    Attributes:
        units: of the unknowns of a condensed QP, (9 + redundancy,): off-path twist s (6), (cap − σ), (1 − ρ_g),
            (1 − ρ_p), null-space motion. In these the Hessian is the identity.
        recovery_scale, relax_scale: units of the unknowns of joints that are led back, of rows that may give way.
    """

    def __init__(self, chain: Chain, weights: RankWeights) -> None:
        self.chain, w = chain, weights
        twists = 1.0 / np.sqrt(w.off_path * np.array([1.0] * 3 + [w.length**2] * 3))
        self._share_scale = 1.0 / np.sqrt([w.rate, w.grasp, w.path])
        self.recovery_scale = 1.0 / float(np.sqrt(w.recovery))
        self.relax_scale = 1.0 / float(np.sqrt(w.clearance))
        self.units = np.concatenate([twists, self._share_scale, np.full(chain.redundancy, w.posture**-0.5)])

    def least_distance(
        self,
        base: Array,
        B: Array,
        box: VelocityBox,
        further: Rows,
        *,
        rate_cap: float,
        relax: bool = False,
    ) -> QpProblem:
        """The condensed QP: the least x whose rows ``base + B x`` keep the velocity bounds and the further rows.

        Rows have unit norm. ``v_j − recovery_j`` of a joint that is led back is an unknown of its own: squared into the
        cost it would square the conditioning.
        """
        rows, own = B.shape
        outside, giving = np.flatnonzero(box.outside), np.flatnonzero(further.soft) if relax else np.arange(0)
        led_back = own + np.arange(outside.size)
        n = own + outside.size + giving.size
        C, A = np.zeros((rows, n)), np.zeros((outside.size, n))
        C[:, :own], A[:, :own] = B, B[outside]
        C[self.chain.nv + giving, n - giving.size + np.arange(giving.size)] = -self.relax_scale * further.soft[giving]
        A[np.arange(outside.size), led_back] = -self.recovery_scale
        norms = _row_norms(C)
        lower, upper = np.concatenate([box.lower, further.lower]), np.concatenate([box.upper, further.upper])
        lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
        lb[6:9] = 0.0
        ub[6:9] = np.array([rate_cap, 1.0, 1.0]) / self._share_scale
        return QpProblem(
            H=np.eye(n),
            g=np.zeros(n),
            A=A / norms[outside, None],
            b=(box.recovery[outside] - base[outside]) / norms[outside],
            C=C / norms[:, None],
            l=(lower - base) / norms,
            u=(upper - base) / norms,
            lb=lb,
            ub=ub,
        )

    def with_velocities(self, problem: QpProblem, parting: Array) -> QpProblem:
        """The condensed form whose chain may part, with the joints' velocities w as unknowns beside x.

        ``C x − w = 0`` in the rows' own scale is weighed so that a twist by which the arms part counts as 1, whatever
        joints it moves. OSQP then needs hundreds of iterations, without it 20 000 and more.

        Args:
            problem: of :meth:`least_distance`.
            parting: its columns of the twists by which the arms part, (nv, 6N).
        """
        n, nv = problem.g.size, self.chain.nv
        C, own = problem.C[:nv], problem.C[nv:]
        U, s, Vt = np.linalg.svd(parting)
        rows = U.T.copy()
        moving = s > SINGULAR_FLOOR * s[0]
        rows[: s.size][moving] /= s[moving, None]
        if s.size == len(Vt) and moving.all():  # each row is that of one twist
            rows[: s.size] = Vt.T @ rows[: s.size]
        wider = CALM * np.eye(n + nv)  # next to nothing for w: some solvers factorise H
        wider[:n, :n] = problem.H
        return QpProblem(
            H=wider,
            g=np.concatenate([problem.g, np.zeros(nv)]),
            A=np.vstack([np.hstack([problem.A, np.zeros((problem.b.size, nv))]), np.hstack([rows @ C, -rows])]),
            b=np.concatenate([problem.b, np.zeros(nv)]),
            C=np.hstack([own, np.zeros((len(own), nv))]),
            l=problem.l[nv:],
            u=problem.u[nv:],
            lb=np.concatenate([problem.lb, problem.l[:nv]]),
            ub=np.concatenate([problem.ub, problem.u[:nv]]),
        )

    def pull(self, solution: QpSolution, B: Array, box: VelocityBox) -> Array | None:
        """Multipliers of the joints' velocities (nv,), positive at an upper bound; None if the solver gives none."""
        if solution.y_rows is None or solution.y_eq is None:
            return None
        pull = solution.y_rows[: self.chain.nv].copy()
        pull[box.outside] += solution.y_eq
        scaled: Array = pull / _row_norms(B[: self.chain.nv])
        return scaled


@final
class StepSolver:
    """Owns the kept QP solvers of one controller: of its QPs, and of those whose chain may part."""

    def __init__(self, chain: Chain, box: VelocityBox, options: QPOptions) -> None:
        self._chain, self._box = chain, box
        self.program = StepProgram(chain, options.weights)
        self._solver, self._slack_solver = (make_solver(options.solver, options.solver_settings) for _ in range(2))
        self.name = self._solver.name

    def reset(self) -> None:
        """Forget warm starts."""
        self._solver.reset()
        self._slack_solver.reset()

    def solve(
        self, base: Array, columns: Array, further: Rows, *, cap: float, relax: bool, parts: bool
    ) -> tuple[QpSolution, SolverReport]:
        """The solution of the QP that the core has filled in, in the core's units."""
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


def _row_norms(rows: Array) -> Array:
    norms: Array = np.linalg.norm(rows, axis=1)
    norms[norms < 1e-12] = 1.0
    return norms
