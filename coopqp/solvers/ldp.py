"""The compiled core's own solver of least-distance problems, for every strictly convex QP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checks import as_options
from coopqp.core import _core
from coopqp.core._core import LARGEST_X
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings, Workspace
from coopqp.solvers.polish import finish
from coopqp.solvers.problem import INFINITE, Array, QpProblem, SolverStatus

#: An answer this far from optimal is not worth a message.
_ACCURACY = 1e-8
#: H counts as positive definite above this ratio of the squares of its Cholesky factor's pivots.
_DEFINITE = 1e-12

#: Code of the core for a problem that it has proved infeasible.
_INFEASIBLE = -1


@dataclass(frozen=True, kw_only=True)
class LdpSettings(SolverSettings):
    """Settings of the least-distance solver; its tolerance of a row of unit norm is 1e-10."""


class _Memory:
    """Arrays of one size of least-distance problem.

    Attributes:
        A, low, high: rows (m, n) and their bounds (m,).
        lb, ub: bounds of the unknowns (n,).
        x, y: answer (n,), and multipliers of rows and bounds (m + n,).
    """

    __slots__ = ("A", "_program", "high", "lb", "low", "ub", "x", "y")

    def __init__(self, n: int, m: int) -> None:
        self.A, self.low, self.high = np.zeros((m, n)), np.full(m, -np.inf), np.full(m, np.inf)
        self.lb, self.ub, self.x, self.y = np.full(n, -np.inf), np.full(n, np.inf), np.zeros(n), np.zeros(m + n)
        work = np.zeros(2 * n * (n + 3))
        self._program = _core.LeastDistance(self.A, self.low, self.high, self.lb, self.ub, self.x, self.y, work)

    def solve(self, reach: float) -> int:
        """Fill x and y; returns the iterations, or the code of a failure."""
        return self._program.solve(reach)


class LdpSolver(QpSolver):
    """Dual active-set method of the compiled core. Nothing is carried from solve to solve: repeatable bit for bit.

    With H = s L Lᵀ, x₀ = −H⁻¹ g and z = Lᵀ (x − x₀) a strictly convex QP is a least-distance problem in z, where a row
    a becomes L⁻¹ a. H = 1 and g = 0 need no change of unknowns, and keep bounds of x apart from rows.
    """

    name = "ldp"
    strictly_convex_only = True

    def __init__(self, settings: LdpSettings | None = None) -> None:
        self.settings: LdpSettings = as_options(LdpSettings, settings, f"solver '{self.name}': settings")
        self._forget()

    def _forget(self) -> None:
        self._direct: _Memory | None = None
        self._general: _Memory | None = None
        self._factored, self._identity, self._scale = b"", False, 1.0
        self._inverse: Array | None = None

    def _solve(self, problem: QpProblem, work: Workspace) -> Outcome:
        self._factor(problem.H)
        if self._inverse is None:
            return Outcome(SolverStatus.FAILED, message="ldp: H is not positive definite")
        if self._identity and not problem.g.any():
            outcome = self._solve_direct(problem, work)
            if outcome.status is not SolverStatus.MAX_ITERATIONS:
                return outcome
        return self._solve_general(problem, work, self._inverse)

    def _factor(self, H: Array) -> None:
        """L⁻¹ and s of H; no L⁻¹ if H is not positive definite."""
        data = H.tobytes()
        if data == self._factored:
            return
        n = len(H)
        self._factored, self._inverse = data, None
        self._identity = bool(np.array_equal(H, np.eye(n)))
        self._scale = float(H.diagonal().max())
        if not self._scale > 0.0:
            return
        try:
            L = np.linalg.cholesky(H / self._scale)
        except np.linalg.LinAlgError:
            return
        pivots = L.diagonal()
        if pivots.min() ** 2 > _DEFINITE * pivots.max() ** 2:
            self._inverse = np.tril(np.linalg.inv(L))

    def _solve_direct(self, problem: QpProblem, work: Workspace) -> Outcome:
        n, m, p = work.sizes
        memory = self._direct
        if memory is None:
            memory = self._direct = _Memory(n, p + m)
        memory.A[:p], memory.A[p:] = problem.C, problem.A
        memory.low[:], memory.high[:] = work.lower[n:], work.upper[n:]
        memory.lb[:], memory.ub[:] = work.lower[:n], work.upper[:n]
        code = memory.solve(LARGEST_X)
        y = memory.y
        return _outcome(code, memory.x.copy(), np.concatenate([y[p + m :], y[: p + m]]))

    def _solve_general(self, problem: QpProblem, work: Workspace, inverse: Array) -> Outcome:
        n, m, p = work.sizes
        memory = self._general
        if memory is None:
            memory = self._general = _Memory(n, n + p + m)
        rows = memory.A
        rows[:n], rows[n : n + p], rows[n + p :] = inverse.T, problem.C @ inverse.T, problem.A @ inverse.T
        lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
        lengths[lengths < np.finfo(float).tiny] = 1.0
        rows /= lengths[:, None]
        start: Array = -(inverse.T @ (inverse @ (problem.g / self._scale)))
        values = np.concatenate([start, problem.C @ start, problem.A @ start])
        for bounds, side, out in ((work.lower, -1.0, memory.low), (work.upper, 1.0, memory.high)):
            np.divide(bounds - values, lengths, out=out)
            out[side * bounds >= INFINITE] = side * np.inf
        # ‖L‖ ≤ √n, as no pivot of H / s is above 1.
        reach = n * LARGEST_X + float(np.linalg.norm(start)) * np.sqrt(n)
        code = memory.solve(reach)
        x = start + inverse.T @ memory.x
        outcome = _outcome(code, x, self._scale * memory.y[: n + p + m] / lengths)
        if outcome.status is SolverStatus.SOLVED:
            finish(problem, work, outcome, _ACCURACY, polished=True)
        return outcome


def _outcome(code: int, x: Array, y: Array) -> Outcome:
    if code >= 0:
        return Outcome(SolverStatus.SOLVED, x, y, code)
    if code == _INFEASIBLE:
        return Outcome(SolverStatus.INFEASIBLE, message="ldp: infeasible")
    return Outcome(SolverStatus.MAX_ITERATIONS, message="ldp: iteration cap")
