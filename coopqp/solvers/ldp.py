"""The compiled core's own solver of least-distance problems, for every strictly convex QP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checks import as_options
from coopqp.core import _core
from coopqp.core._core import LARGEST_X
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings
from coopqp.solvers.problem import INFINITE, Array, QpProblem, SolverStatus, Stacked

#: H counts as positive definite above this ratio of the squares of its Cholesky factor's pivots.
_DEFINITE = 1e-12
#: Code of the core for a problem that it has proved infeasible.
_INFEASIBLE = -1


@dataclass(frozen=True, kw_only=True)
class LdpSettings(SolverSettings):
    """Settings of the least-distance solver; its tolerance of a row of unit norm is 1e-10."""


class LdpSolver(QpSolver):
    """Dual active-set method of the compiled core. Nothing is carried from solve to solve: repeatable bit for bit.

    With H = s L Lᵀ, x₀ = −H⁻¹ g and z = Lᵀ (x − x₀) a strictly convex QP is a least-distance problem in z, where a row
    a becomes L⁻¹ a.
    """

    name = "ldp"
    strictly_convex_only = True

    def __init__(self, settings: LdpSettings | None = None) -> None:
        self.settings: LdpSettings = as_options(LdpSettings, settings, f"solver '{self.name}': settings")

    def _forget(self) -> None:
        pass

    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        n, m = problem.g.size, rows.low.size
        inverse, scale = _factor(problem.H)
        if inverse is None:
            return Outcome(SolverStatus.FAILED, message="ldp: H is not positive definite")
        G = rows.G @ inverse.T
        lengths = np.linalg.norm(G, axis=1)
        lengths[lengths < np.finfo(float).tiny] = 1.0
        G /= lengths[:, None]
        start = -(inverse.T @ (inverse @ (problem.g / scale)))
        value = rows.G @ start
        low = np.where(rows.low <= -INFINITE, -np.inf, (rows.low - value) / lengths)
        high = np.where(rows.high >= INFINITE, np.inf, (rows.high - value) / lengths)
        z, y, free = np.zeros(n), np.zeros(m + n), np.full(n, np.inf)
        # ‖L‖ ≤ √n, as no pivot of H / s is above 1.
        reach = n * LARGEST_X + float(np.linalg.norm(start)) * np.sqrt(n)
        code = _core.LeastDistance(G, low, high, -free, free, z, y, np.zeros(2 * n * (n + 3))).solve(reach)
        if code >= 0:
            return Outcome(SolverStatus.SOLVED, start + inverse.T @ z, scale * y[:m] / lengths, code)
        if code == _INFEASIBLE:
            return Outcome(SolverStatus.INFEASIBLE, message="ldp: infeasible")
        return Outcome(SolverStatus.MAX_ITERATIONS, message="ldp: iteration cap")


def _factor(H: Array) -> tuple[Array | None, float]:
    """L⁻¹ and s of H; no L⁻¹ if H is not positive definite."""
    unit = np.eye(len(H))
    if np.array_equal(H, unit):
        return unit, 1.0
    scale = float(H.diagonal().max())
    try:
        L = np.linalg.cholesky(H / scale) if scale > 0.0 else np.zeros_like(H)
    except np.linalg.LinAlgError:
        L = np.zeros_like(H)
    pivots = L.diagonal()
    if not pivots.min() ** 2 > _DEFINITE * pivots.max() ** 2:
        return None, scale
    return np.tril(np.linalg.inv(L)), scale
