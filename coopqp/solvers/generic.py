"""Any backend of qpsolvers, by its name. It is built anew for every solve."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coopqp.checks import as_options
from coopqp.errors import InvalidInputError
from coopqp.solvers.base import Outcome, QpSolver, SolverSettings
from coopqp.solvers.problem import INFINITE, QpProblem, SolverStatus, Stacked

#: Prefix of the name of a backend that could be kept, too.
ROUTE = "qpsolvers:"
#: Options of kept backends that are built anew: their defaults are too inaccurate for commands.
_TIGHT: Mapping[str, Mapping[str, Any]] = {
    "osqp": {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 4000, "adaptive_rho_interval": 50},
    "proxqp": {
        "eps_abs": 1e-9,
        "eps_rel": 0.0,
        "max_iter": 100,
        "check_duality_gap": True,
        "eps_duality_gap_abs": 1e-9,
    },
}
#: What a reason of a backend has, in this order, and its status.
_SAYS = {
    "dual infeasible": SolverStatus.FAILED,
    "inaccurate": SolverStatus.MAX_ITERATIONS,
    "infeasible": SolverStatus.INFEASIBLE,
    "max": SolverStatus.MAX_ITERATIONS,
    "limit": SolverStatus.MAX_ITERATIONS,
}


@dataclass(frozen=True, kw_only=True)
class GenericSettings(SolverSettings):
    """Settings of a backend of qpsolvers.

    Attributes:
        options: keyword arguments for the backend, beside the defaults of this module or of the backend.
    """

    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        SolverSettings.__post_init__(self)
        if not isinstance(self.options, Mapping) or not all(isinstance(k, str) for k in self.options):
            raise InvalidInputError(f"options = {self.options!r}", "GenericSettings", "Give a mapping of keywords.")
        object.__setattr__(self, "options", dict(self.options))


@dataclass(frozen=True, kw_only=True)
class DaqpSettings(SolverSettings):
    """Settings of DAQP, by its own names; all others keep DAQP's defaults.

    Attributes:
        primal_tol: violation of a constraint that counts as zero, in the constraint's units. It also decides whether a
            constraint becomes active, so it bounds the error of x. DAQP's default is 1e-6.
        dual_tol: multiplier of the wrong sign that counts as zero.
        eta_prox: accuracy of DAQP's proximal iterations for a singular H.
        iter_limit: largest number of changes of the active set.
    """

    primal_tol: float = 1e-10
    dual_tol: float = 1e-12
    eta_prox: float = 1e-12
    iter_limit: int = 1000


class GenericSolver(QpSolver):
    """``qpsolvers.solve_problem`` with one backend.

    Rows become one-sided inequalities, without infinite ones; bounds of unknowns, too: they have multipliers in every
    backend. Rows with equal bounds become equalities.
    """

    def __init__(self, name: str, settings: SolverSettings | None = None) -> None:
        import qpsolvers
        from qpsolvers.exceptions import QPError

        self.name, backend = name, name.removeprefix(ROUTE)
        kind: type[SolverSettings] = DaqpSettings if backend == "daqp" else GenericSettings
        self.settings = as_options(kind, settings, f"solver '{self.name}': settings")
        self._backend, self._module = backend, qpsolvers
        # TypeError: an option unknown to the backend. AssertionError: osqp's checks of its input.
        self._raises = (*QpSolver._raises, QPError, TypeError, AssertionError)
        own = self.settings.own
        self._options = {**_TIGHT.get(backend, {}), **(own.pop("options", None) or {}), **own}

    def _forget(self) -> None:
        pass

    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        G, low, high, _ = rows
        equal = low == high
        above, below = ~equal & (high < INFINITE), ~equal & (low > -INFINITE)
        C, d = np.vstack([G[above], -G[below]]), np.concatenate([high[above], -low[below]])
        data = [problem.H.copy(), problem.g.copy(), C, d, G[equal], high[equal]]
        if self._backend not in self._module.dense_solvers:
            from scipy import sparse

            data[::2] = map(sparse.csc_matrix, data[::2])
        stated = self._module.Problem(*(None if not part.size else part for part in data))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # some backends report their status as a warning; the message replaces it
            found = self._module.solve_problem(stated, self._backend, **self._options)
        info = found.extras.get("info") if isinstance(found.extras, dict) else None
        iterations = int(getattr(info, "iter", 0))
        if not found.found or found.x is None:
            # qpsolvers returns no status of quadprog, whose only failure is that there is no answer.
            reason = str(getattr(info, "status", "infeasible" if self._backend == "quadprog" else "no solution found"))
            text = reason.lower().replace("_", " ")
            status = next((status for word, status in _SAYS.items() if word in text), SolverStatus.FAILED)
            return Outcome(status, iterations=iterations, message=f"{self._backend}: {reason}")
        y = np.zeros(low.size)
        for chosen, sign, multipliers in (
            (above, 1.0, None if found.z is None else found.z[: above.sum()]),
            (below, -1.0, None if found.z is None else found.z[above.sum() :]),
            (equal, 1.0, found.y),
        ):
            if chosen.any():
                y[chosen] += sign * (np.nan if multipliers is None else multipliers)
        return Outcome(SolverStatus.SOLVED, np.array(found.x, dtype=np.float64), y, iterations)
