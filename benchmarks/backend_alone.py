"""Persistent solvers compared with rebuilt ones: only the calls of ProxQP and OSQP, without coopqp's checks.

Persistent: update and solve, warm. Rebuilt: ``qpsolvers.solve_problem`` at the same accuracy. No checks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
from common import Record
from recorded_qps import Recorded

from coopqp.solvers import QpProblem

_PROXQP = {"eps_abs": 1e-9, "eps_rel": 0.0, "check_duality_gap": True, "eps_duality_gap_abs": 1e-9}
_OSQP = {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 4000}
_INFINITE = 1e20


def _stated(problem: QpProblem, *, sparse: bool) -> Any:
    """The problem in the notation of qpsolvers."""
    import qpsolvers
    from scipy.sparse import csc_matrix

    above, below = np.isfinite(problem.u), np.isfinite(problem.l)
    G = np.vstack([problem.C[above], -problem.C[below]])
    h = np.concatenate([problem.u[above], -problem.l[below]])
    form = csc_matrix if sparse else np.array
    rows = (form(G), h) if h.size else (None, None)
    equal = (form(problem.A), problem.b.copy()) if problem.b.size else (None, None)
    return qpsolvers.Problem(form(problem.H), problem.g.copy(), *rows, *equal, problem.lb, problem.ub)


def _proxqp(problems: Sequence[QpProblem]) -> Callable[[QpProblem], Callable[[], object]]:
    from proxsuite import proxqp

    def data(problem: QpProblem) -> tuple[Any, ...]:
        bounds = (problem.l, problem.u, problem.lb, problem.ub)
        clipped = [np.clip(bound, -_INFINITE, _INFINITE) for bound in bounds]
        return (problem.H, problem.g, problem.A, problem.b, problem.C, *clipped)

    qp = proxqp.dense.QP(*problems[0].sizes, True, dense_backend=proxqp.dense.DenseBackend.PrimalDualLDLT)
    qp.settings.initial_guess = proxqp.WARM_START_WITH_PREVIOUS_RESULT
    for key, value in {**_PROXQP, "eps_duality_gap_rel": 0.0, "max_iter": 60, "max_iter_in": 10}.items():
        setattr(qp.settings, key, value)
    qp.init(*data(problems[0]))
    qp.solve()

    def ready(problem: QpProblem) -> Callable[[], object]:
        given = data(problem)

        def solve() -> None:
            qp.update(*given, update_preconditioner=False)
            qp.solve()

        return solve

    return ready


def _osqp(problems: Sequence[QpProblem]) -> Callable[[QpProblem], Callable[[], object]]:
    import osqp
    from scipy.sparse import csc_matrix

    def data(problem: QpProblem) -> tuple[Any, Any, Any, Any]:
        rows = problem.stacked()
        low = np.where(rows.low <= -_INFINITE, -np.inf, rows.low)
        high = np.where(rows.high >= _INFINITE, np.inf, rows.high)
        return problem.H.T[upper.T], rows.G.T.ravel(), low, high

    upper = np.triu(np.ones_like(problems[0].H, dtype=bool))
    entries = csc_matrix(upper, dtype=float), csc_matrix(np.ones_like(problems[0].stacked().G))  # any may come
    kept = osqp.OSQP()
    kept.setup(entries[0], problems[0].g, entries[1], *data(problems[0])[2:], verbose=False, **_OSQP)

    def ready(problem: QpProblem) -> Callable[[], object]:
        H, G, low, high = data(problem)

        def solve() -> None:
            kept.update(q=problem.g, l=low, u=high)
            kept.update(Px=H, Ax=G)
            kept.solve(raise_error=False)

        return solve

    return ready


def backend_alone(recorded: Sequence[Recorded]) -> list[Record]:
    """Medians and their ratios over successive QPs, persistent and rebuilt in turn; CPU time of the thread."""
    import qpsolvers

    records: list[Record] = []
    for one in recorded:
        # Persistent memory has one size; a joint on its way back from outside its limits adds an unknown.
        sizes = [qp.problem.sizes for qp in one.qps]
        usual = max(set(sizes), key=sizes.count, default=None)
        problems = [qp.problem for qp in one.qps if qp.problem.sizes == usual]
        for name, start, options in (("proxqp", _proxqp, _PROXQP), ("osqp", _osqp, _OSQP)):
            if name not in qpsolvers.available_solvers or len(problems) < 2:
                continue
            ready, times = start(problems), ([], [])  # type: tuple[Any, tuple[list[float], list[float]]]
            for problem in problems[1:]:
                kept, stated = ready(problem), _stated(problem, sparse=name == "osqp")
                began = time.thread_time_ns()
                kept()
                between = time.thread_time_ns()
                qpsolvers.solve_problem(stated, name, **options)
                times[0].append(1e-3 * (between - began))
                times[1].append(1e-3 * (time.thread_time_ns() - between))
            medians = [common.percentiles(row, shares=(50.0,))["p50_us"] or np.nan for row in times]
            keys = {"solver": name, "case": one.case, "arms": one.arms}
            ratio = round(medians[0] / medians[1], 3)
            records.append({**keys, "kept_us": medians[0], "rebuilt_us": medians[1], "ratio": ratio})
    return records
