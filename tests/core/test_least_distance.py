"""The compiled core's least-distance solver: optimal, as others, and sure of what it calls infeasible."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import recorded_qps
from coopqp.core._core import LARGEST_X
from hypothesis import given, strategies as st

from coopqp import InvalidInputError, QPController, QPOptions
from coopqp.baselines import IndependentQPController, IndependentQPOptions
from coopqp.core import _core as native
from coopqp.errors import MissingSolverError, UnknownNameError
from coopqp.scenarios import fast_lift
from coopqp.solvers import (
    QpProblem,
    QpSolution,
    SolverStatus,
    available_solvers,
    default_solver,
    make_solver,
)
from coopqp.solvers.generic import DaqpSettings, GenericSolver

pytestmark = pytest.mark.core
OTHERS = [name for name in ("daqp", "quadprog") if name in available_solvers()]
SEEDS = st.integers(0, 2**32 - 1)


def qp(C: Any, l: Any, u: Any, *, A: Any = None, b: Any = None, lb: Any = None, ub: Any = None) -> QpProblem:
    """A least-distance problem, rows of unit norm."""
    n = np.shape(C)[1]
    A, b = (np.zeros((0, n)), np.zeros(0)) if A is None else (A, b)
    lb, ub = np.full(n, -np.inf) if lb is None else lb, np.full(n, np.inf) if ub is None else ub
    return QpProblem(np.eye(n), np.zeros(n), A, b, C, l, u, lb, ub)


def unit_rows(rng: np.random.Generator, count: int, n: int) -> np.ndarray:
    rows = rng.normal(size=(count, n))
    return rows / np.linalg.norm(rows, axis=1)[:, None]


def with_point(rng: np.random.Generator) -> tuple[QpProblem, np.ndarray]:
    """As those of a step: three unknowns with bounds, some rows that cut the origin off, and a point inside."""
    n, p = int(rng.integers(9, 20)), int(rng.integers(12, 80))
    C, inside = unit_rows(rng, p, n), rng.normal(size=n) * 10.0 ** rng.uniform(-3.0, 0.5, size=n)
    inside[6:9] = 10.0 ** rng.uniform(-3.0, 0.0, size=3)
    v = C @ inside
    wide = np.where(rng.random(p) < rng.uniform(0.0, 0.4), 0.0, 2.0 * np.abs(v) + 1.0)
    room = 10.0 ** rng.uniform(-3.0, 1.0, size=(2, p))
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    lb[6:9], ub[6:9] = 0.0, 2.0 * inside[6:9]
    return qp(C, v - wide - room[0], v + wide + room[1], lb=lb, ub=ub), inside


def feasible(rng: np.random.Generator) -> QpProblem:
    return with_point(rng)[0]


def with_equalities(rng: np.random.Generator) -> QpProblem:
    """Up to four equalities, the first of them stated twice, and a sum of all of them."""
    n, p, k = int(rng.integers(6, 12)), int(rng.integers(4, 30)), int(rng.integers(1, 5))
    A, C, inside = unit_rows(rng, k, n), unit_rows(rng, p, n), rng.normal(size=n)
    total = A.sum(axis=0) / np.linalg.norm(A.sum(axis=0))
    A = np.vstack([A, A[:1], total])
    v = C @ inside
    return qp(C, v - rng.random(p), v + rng.random(p), A=A, b=A @ inside)


def vertex(rng: np.random.Generator) -> QpProblem:
    """Many more rows than unknowns meet in one point, the normals of some of them parallel."""
    n = int(rng.integers(4, 10))
    C = rng.integers(-2, 3, size=(4 * n, n)).astype(float)
    C = C[np.abs(C).sum(axis=1) > 0.0]
    C /= np.linalg.norm(C, axis=1)[:, None]
    v, up = C @ rng.normal(size=n), rng.random(len(C)) < 0.5
    return qp(C, np.where(up, -np.inf, v), np.where(up, v, np.inf))


def doubled(rng: np.random.Generator) -> QpProblem:
    """Every row twice: once more as it is, or turned by 1e-9 or less."""
    problem = feasible(rng)
    turned = problem.C + rng.choice([0.0, 1e-12, 1e-9], size=(len(problem.l), 1)) * rng.normal(size=problem.C.shape)
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    C, l, u = np.vstack([problem.C, -turned]), np.append(problem.l, -problem.u), np.append(problem.u, -problem.l)
    return qp(C, l, u, lb=problem.lb, ub=problem.ub)


def gap(rng: np.random.Generator, sign: float) -> QpProblem:
    """One row must be below a number and above another, which leave 1e-8 … 1e-2 between them, or overlap by as much."""
    problem, inside = with_point(rng)
    i, margin = int(rng.integers(len(problem.l))), sign * 10.0 ** rng.uniform(-8.0, -2.0)
    at = float(problem.C[i] @ inside)
    l, u = np.append(problem.l, -np.inf), np.append(problem.u, -at + 0.5 * margin)
    l[i], u[i] = -np.inf, at + 0.5 * margin
    return qp(np.vstack([problem.C, -problem.C[i]]), l, u, lb=problem.lb, ub=problem.ub)


def infeasible(rng: np.random.Generator) -> QpProblem:
    """Rows whose normals add up to nothing, and whose bounds do not."""
    n = int(rng.integers(3, 12))
    k = int(rng.integers(2, n + 2))
    normals, shares = unit_rows(rng, k, n), rng.random(k - 1) + 0.01
    last = -shares @ normals[:-1]
    length = float(np.linalg.norm(last))
    normals[-1] = last / length
    bounds = rng.normal(size=k)
    bounds[-1] = (-shares @ bounds[:-1] + 10.0 ** rng.uniform(-7.0, 0.0)) / length
    others = unit_rows(rng, 10, n)
    return qp(
        np.vstack([others, normals]),
        np.append(np.full(10, -3.0), bounds),
        np.append(np.full(10, 3.0), np.full(k, np.inf)),
    )


def residual(problem: QpProblem, solution: QpSolution) -> float:
    """Optimality error: of the constraints, of multipliers at inactive bounds, and of the gradient over 1 + max|y|."""
    assert solution.y_eq is not None
    assert solution.y_rows is not None
    assert solution.y_box is not None
    largest = np.abs(np.concatenate([solution.y_box, solution.y_rows, solution.y_eq])).max()
    slope = solution.dual_residual(problem) / (1.0 + float(largest))
    return max(solution.primal_residual(problem), solution.complementarity(problem), slope)


# -- answers -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [feasible, with_equalities, vertex, doubled])
@given(seed=SEEDS)
def test_optimal_and_as_others(make: Callable[[np.random.Generator], QpProblem], seed: int) -> None:
    problem = make(np.random.default_rng(seed))
    solution = make_solver("ldp").solve(problem)
    assert solution.usable, solution.message
    assert residual(problem, solution) <= 1e-12
    for name in OTHERS:
        other = make_solver(name).solve(problem)
        if other.usable:  # quadprog calls some of these infeasible
            # Rows 1e-9 apart: what is within the tolerance of each reaches farther along them.
            assert np.abs(other.x - solution.x).max() <= (1e-5 if make is doubled else 1e-9)


@given(seed=SEEDS)
def test_large_problems(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(30, 51)), int(rng.integers(100, 251))
    C, inside = unit_rows(rng, p, n), rng.normal(size=n)
    problem = qp(C, C @ inside - 0.2 * rng.random(p), C @ inside + rng.random(p))
    assert residual(problem, make_solver("ldp").solve(problem)) <= 1e-12


@given(seed=SEEDS)
def test_the_order_of_rows_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = feasible(rng)
    order = rng.permutation(len(problem.l))
    other = qp(problem.C[order], problem.l[order], problem.u[order], lb=problem.lb, ub=problem.ub)
    first, second = (make_solver("ldp").solve(each) for each in (problem, other))
    np.testing.assert_allclose(second.x, first.x, rtol=0.0, atol=1e-9)


@given(seed=SEEDS)
def test_the_answer_turns_with_the_unknowns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = feasible(rng)
    n = len(problem.g)
    C = np.vstack([problem.C, np.eye(n)])
    l, u = np.append(problem.l, problem.lb), np.append(problem.u, problem.ub)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    first, second = (make_solver("ldp").solve(each) for each in (problem, qp(C @ turn.T, l, u)))
    np.testing.assert_allclose(turn.T @ second.x, first.x, rtol=0.0, atol=1e-9)


@given(seed=SEEDS, spread=st.floats(0.0, 3.0))
def test_any_strictly_convex_cost(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    n, p, m = int(rng.integers(2, 10)), int(rng.integers(0, 20)), int(rng.integers(0, 2))
    turn, inside = np.linalg.qr(rng.normal(size=(n, n)))[0], rng.normal(size=n)
    H = turn * 10.0 ** rng.uniform(-spread, spread, size=n) @ turn.T
    C, A = rng.normal(size=(p, n)), rng.normal(size=(m, n))
    v, none = C @ inside, np.full(p, -np.inf)
    problem = QpProblem(
        0.5 * (H + H.T), rng.normal(size=n), A, A @ inside, C, none, v + rng.random(p), inside - 1.0, inside + 1.0
    )
    solution = make_solver("ldp").solve(problem)
    assert solution.usable, solution.message
    assert residual(problem, solution) <= 1e-10
    for name in OTHERS:
        assert np.abs(make_solver(name).solve(problem).x - solution.x).max() <= 1e-7


@pytest.mark.parametrize("case", ["corner", "near_singular", "outside", "redundant", "saturated"])
def test_recorded_problems(case: str) -> None:
    for one in recorded_qps.record(case, 3, 12).qps:
        solution = make_solver("ldp").solve(one.problem)
        assert residual(one.problem, solution) <= 1e-13
        for name in OTHERS:
            apart = one.velocity(solution.x) - one.velocity(make_solver(name).solve(one.problem).x)
            assert np.abs(apart).max() <= 1e-8


def test_nothing_is_carried_from_solve_to_solve() -> None:
    solver, rng = make_solver("ldp"), np.random.default_rng(3)
    for problem in [feasible(rng) for _ in range(5)] + [infeasible(rng), with_equalities(rng)]:
        kept = [solver.solve(problem).x.tobytes() for _ in range(2)]
        assert kept == [make_solver("ldp").solve(problem).x.tobytes()] * 2


# -- no answers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
@given(seed=SEEDS)
def test_the_sign_of_a_small_gap_decides(sign: float, seed: int) -> None:
    problem = gap(np.random.default_rng(seed), sign)
    solution = make_solver("ldp").solve(problem)
    if sign < 0.0:
        assert solution.status is SolverStatus.INFEASIBLE
    else:
        assert solution.usable
        assert residual(problem, solution) <= 1e-9


def core(problem: QpProblem, reach: float = LARGEST_X) -> tuple[int, np.ndarray, np.ndarray]:
    """Code, answer and multipliers (rows, then bounds) of the core."""
    n, p = len(problem.g), len(problem.l)
    x, y = np.zeros(n), np.zeros(p + n)
    arrays = (problem.C, problem.l, problem.u, problem.lb, problem.ub, x, y, np.zeros(2 * n * (n + 3)))
    return native.LeastDistance(*arrays).solve(reach), x, y


@given(seed=SEEDS)
def test_infeasible_is_proved(seed: int) -> None:
    """Every x that is feasible has y·(C x) ≤ s, so that −s over the length of Cᵀ y is the length of x at least."""
    problem = infeasible(np.random.default_rng(seed))
    assert make_solver("ldp").solve(problem).status is SolverStatus.INFEASIBLE
    code, _, y = core(problem)
    assert code == -1
    p = len(problem.l)
    used = np.flatnonzero(y)
    low, high = np.append(problem.l, problem.lb), np.append(problem.u, problem.ub)
    s = float(y[used] @ np.where(y > 0.0, high, low)[used])
    assert -s > 0.9 * LARGEST_X * float(np.linalg.norm(problem.C.T @ y[:p] + y[p:]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none(bad: float) -> None:
    problem = feasible(np.random.default_rng(0))
    problem.C[3, 2] = bad
    assert core(problem)[0] == -2
    assert make_solver("ldp").solve(problem).status is SolverStatus.INVALID


def test_the_core_tests_its_arrays() -> None:
    """What it is given is an array of the right kind and length: no address, which a wrong number would be."""
    n, m = 3, 4
    shapes = ((m, n), (m,), (m,), (n,), (n,), (n,), (m + n,), (2 * n * (n + 3),))
    good = [np.zeros(shape) for shape in shapes]
    assert native.LeastDistance(*good).solve(LARGEST_X) == 0
    for i, array in enumerate(good):
        with pytest.raises(ValueError, match="do not fit"):
            native.LeastDistance(*good[:i], np.zeros(array.size + 1), *good[i + 1 :])
        for bad in (
            array.astype(np.float32),
            np.zeros(2 * array.size)[::2],
            array.tolist(),
            array.ctypes.data,
            7,
            None,
        ):
            with pytest.raises(TypeError):
                native.LeastDistance(*good[:i], bad, *good[i + 1 :])
    for i in (5, 6, 7):
        frozen = good[i].copy()
        frozen.flags.writeable = False
        with pytest.raises(TypeError):
            native.LeastDistance(*good[:i], frozen, *good[i + 1 :])
    with pytest.raises(TypeError):
        native.LeastDistance()
    nothing = [np.zeros(size) for size in (0, 0, 0, 0, 0, 0, 0, 0)]
    with pytest.raises(ValueError, match="do not fit"):
        native.LeastDistance(*nothing)


@pytest.mark.parametrize("diagonal", [[1.0, 0.0], [1.0, -1.0], [0.0, 0.0], [1.0, 1e-14]])
def test_costs_that_are_not_strictly_convex_are_refused(diagonal: list[float]) -> None:
    problem = QpProblem(
        np.diag(diagonal), np.zeros(2), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros(0),
        -np.ones(2), np.ones(2),
    )  # fmt: skip
    solution = make_solver("ldp").solve(problem)
    assert solution.status is SolverStatus.FAILED
    assert "positive definite" in solution.message


# -- choosing a solver -------------------------------------------------------------------------------------------------


def test_the_default() -> None:
    assert default_solver() == make_solver("auto").name == "ldp"
    assert default_solver(strictly_convex=False) == "daqp"
    assert "ldp" in available_solvers()


def test_a_backend_that_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qpsolvers.available_solvers", [])
    with pytest.raises(MissingSolverError, match=r"pip install 'qpsolvers\[clarabel\]'"):
        make_solver("clarabel")
    with pytest.raises(UnknownNameError):
        make_solver("clarabelle")


def test_a_solver_is_taken_as_it_is() -> None:
    solver = GenericSolver("daqp")
    assert make_solver(solver) is solver
    with pytest.raises(InvalidInputError, match="settings beside a GenericSolver"):
        make_solver(solver, DaqpSettings())
    with pytest.raises(InvalidInputError, match="is a float"):
        make_solver(3.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("make", [lambda: make_solver("ldp"), lambda: make_solver("daqp")])
def test_controllers_take_a_solver(make: Callable[[], Any]) -> None:
    lift = fast_lift()
    commands = []
    for solver in (make(), make().name):
        options = QPOptions(solver=solver, shortcut=False)
        controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, options=options)
        controller.reset(lift.q_start)
        steps = [controller.step() for _ in range(5)]
        assert {step.solver.name for step in steps} == {make().name}
        commands.append(steps[-1].q_next.tobytes())
    assert commands[0] == commands[1]


def test_independent_arms_may_share_a_solver() -> None:
    lift = fast_lift()
    commands = []
    for solver in (GenericSolver("daqp"), "daqp"):
        options = IndependentQPOptions(solver=solver)
        controller = IndependentQPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, options=options)
        controller.reset(lift.q_start)
        commands.append([controller.step() for _ in range(5)][-1].q_next)
    np.testing.assert_allclose(commands[0], commands[1], rtol=0.0, atol=1e-12)
