"""The QP solvers: optimality conditions, agreement with each other, and invalid data."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import pickle
import textwrap
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from processes import output

from coopqp import InvalidInputError
from coopqp.errors import MissingExtraError, UnknownNameError
from coopqp.solvers import (
    DaqpSettings,
    GenericSettings,
    OsqpSettings,
    ProxqpSettings,
    QpProblem,
    QpSolution,
    QpSolver,
    SolverSettings,
    SolverStatus,
    Stacked,
    available_solvers,
    make_solver,
)
from coopqp.solvers.base import Outcome

KEPT = ["proxqp", "osqp", "ldp"]
SEMIDEFINITE = [name for name in ("proxqp", "osqp", "daqp") if name in available_solvers()]
REBUILT = ["qpsolvers:osqp", "qpsolvers:proxqp", *(n for n in ("daqp", "quadprog") if n in available_solvers())]
EVERY = KEPT + REBUILT
# Built anew by qpsolvers OSQP does not polish, and ProxQP calls some feasible problems infeasible, because qpsolvers
# cannot set the accuracy of its certificate.
SURE = [name for name in EVERY if name not in ("qpsolvers:osqp", "qpsolvers:proxqp")]
needs_daqp = pytest.mark.skipif("daqp" not in EVERY, reason="daqp is not installed")


# -- problems --------------------------------------------------------------------------------------------------------


def qp(H: Any, g: Any, *, A: Any = None, b: Any = None, C: Any = None, l: Any = None, u: Any = None,
       lb: Any = None, ub: Any = None) -> QpProblem:  # fmt: skip
    """A problem from the given parts; the other parts are empty."""
    n = len(g)
    given_ = {"H": H, "g": g, "A": A, "b": b, "C": C, "l": l, "u": u, "lb": lb, "ub": ub}
    none = {
        "A": np.zeros((0, n)),
        "b": np.zeros(0),
        "C": np.zeros((0, n)),
        "l": np.zeros(0),
        "u": np.zeros(0),
        "lb": np.full(n, -np.inf),
        "ub": np.full(n, np.inf),
    }
    return QpProblem(**{k: none[k] if v is None else np.array(v, dtype=float) for k, v in given_.items()})


def condensed(seed: int, *, spread: float = 1.0) -> QpProblem:
    """A feasible least-distance problem of size up to 10**spread: H = I, unit rows, three bounded unknowns."""
    rng = np.random.default_rng(seed)
    n, p = 9 + seed % 9, int(rng.choice([18, 48, 96, 200]))
    C = rng.normal(size=(p, n)) * 10 ** rng.uniform(-1.5, 1.5, size=n)
    C /= np.linalg.norm(C, axis=1)[:, None]
    inside = rng.normal(size=n) * 10 ** rng.uniform(-3, spread, size=n)
    inside[6:9] = 10 ** rng.uniform(-3, 0, size=3)
    v = C @ inside
    room = 10 ** rng.uniform(-3, 1, size=(2, p))
    # A few rows cut the origin off, the others leave it inside.
    cuts = rng.permutation(p)[: int(rng.integers(0, 13))]
    around = 2 * np.abs(v) + 1
    around[cuts] = 0.0
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    lb[6:9], ub[6:9] = 0.0, inside[6:9] + 10 ** rng.uniform(-3, 0, size=3)
    return qp(np.eye(n), np.zeros(n), C=C, l=v - around - room[0], u=v + around + room[1], lb=lb, ub=ub)


def arms(seed: int, n_arms: int) -> dict[str, Any]:
    """Jacobians, path twist and corrections of arms that hold one object, and the joints' speed limits."""
    rng = np.random.default_rng(seed)
    J = []
    for _ in range(n_arms):
        U, V = (np.linalg.qr(rng.normal(size=(6, 6)))[0] for _ in range(2))
        J.append(U @ np.diag(np.geomspace(1.2, 10 ** rng.uniform(-1.3, -0.5), 6)) @ V)
    return {
        "J": np.array(J),
        "along": rng.normal(size=6) * rng.uniform(0.05, 0.3),
        "path": rng.normal(size=6) * 10 ** rng.uniform(-5, -2),
        "grasp": rng.normal(size=(n_arms, 6)) * 10 ** rng.uniform(-6, -2),
        "speed": rng.uniform(0.8, 2.5),
    }


def full(state: dict[str, Any], *, joint: float = 1e-8) -> QpProblem:
    """Unknowns: joint velocities, twist off the path, three shares. Six equalities per arm, everything bounded."""
    J = state["J"]
    n_arms = len(J)
    nv = 6 * n_arms
    n = nv + 9
    h = np.concatenate([np.full(nv, joint), np.full(6, 1e4), [1e-4, 1.0, 1e-2]])
    h[nv + 3 : nv + 6] *= 0.09
    g = np.zeros(n)
    g[-3:] = -h[-3:]
    A = np.zeros((nv, n))
    for k in range(n_arms):
        rows = slice(6 * k, 6 * k + 6)
        A[rows, rows], A[rows, nv : nv + 6] = J[k], -np.eye(6)
        A[rows, -3], A[rows, -2], A[rows, -1] = -state["along"], -state["grasp"][k], -state["path"]
    lb = np.concatenate([np.full(nv, -state["speed"]), np.full(6, -10.0), np.zeros(3)])
    ub = np.concatenate([np.full(nv, state["speed"]), np.full(6, 10.0), np.ones(3)])
    return qp(np.diag(h), g, A=A, b=np.zeros(nv), lb=lb, ub=ub)


def cornered(seed: int, n_arms: int, joint: float, *, scaled: bool) -> QpProblem:
    """The full form with narrow velocity ranges off the path, as under acceleration limits: nearly a vertex.

    ``scaled`` scales the twist and the shares to unit cost.
    """
    state = arms(seed, n_arms)
    rng = np.random.default_rng(seed)
    problem = full(state, joint=joint)
    twist = 0.3 * rng.normal(size=6)
    v = np.concatenate([np.linalg.solve(J, twist) for J in state["J"]])
    lb, ub = problem.lb.copy(), problem.ub.copy()
    lb[: v.size] = v - 10 ** rng.uniform(-3, -1, size=v.size)
    ub[: v.size] = v + 10 ** rng.uniform(-3, -1, size=v.size)
    if not scaled:
        return dataclasses.replace(problem, lb=lb, ub=ub)
    h = np.diag(problem.H)
    d = np.where(h > 1e-6, 1.0 / np.sqrt(np.maximum(h, 1e-6)), 1.0)
    return qp(problem.H * d * d[:, None], problem.g * d, A=problem.A * d, b=problem.b, lb=lb / d, ub=ub / d)


def loop(problem_of: Callable[[int, float], QpProblem], steps: int = 60) -> Iterator[QpProblem]:
    """Slowly changing data with bounds that are in turn tight, wide and absent."""
    for k in range(steps):
        yield problem_of(k, (1.0, 50.0, np.inf)[(k // 10) % 3])


def condensed_loop(seed: int, steps: int = 60) -> Iterator[QpProblem]:
    base = condensed(seed)
    rng = np.random.default_rng(seed)
    C = base.C.copy()

    def at(k: int, room: float) -> QpProblem:
        nonlocal C
        C = C + 1e-3 * rng.normal(size=C.shape)
        C /= np.linalg.norm(C, axis=1)[:, None]
        extra = 0.0 if room == 1.0 else room
        return dataclasses.replace(base, C=C.copy(), l=base.l - extra, u=base.u + extra)

    # The rows turn: keep only the feasible problems.
    return (p for p in loop(at, steps) if np.isinf(p.l).all() or make_solver(REFERENCE).solve(p).usable)


def full_loop(seed: int, steps: int = 60, joint: float = 1e-8) -> Iterator[QpProblem]:
    state = arms(seed, 3)
    rng = np.random.default_rng(seed)

    def at(k: int, room: float) -> QpProblem:
        state["J"] = state["J"] + 1e-3 * rng.normal(size=state["J"].shape)
        state["along"] = state["along"] + 1e-3 * rng.normal(size=6)
        problem = full(state, joint=joint)
        nv = 18
        lb, ub = problem.lb.copy(), problem.ub.copy()
        lb[:nv] *= 0.3 * room
        ub[:nv] *= 0.3 * room
        return dataclasses.replace(problem, lb=lb, ub=ub)

    return loop(at, steps)


REFERENCE = "quadprog" if "quadprog" in EVERY else KEPT[-1]


# -- the conditions of optimality, in the test's own words ----------------------------------------------------------


def assert_optimal(problem: QpProblem, solution: QpSolution, tol: float) -> None:
    """KKT: feasible, stationary, multipliers of the right sign and only at active bounds."""
    assert solution.status is SolverStatus.SOLVED, solution.message
    x = solution.x
    assert x.shape == problem.g.shape
    assert np.isfinite(x).all()
    assert np.abs(problem.A @ x - problem.b).max(initial=0.0) <= tol
    assert solution.y_eq is not None
    assert solution.y_rows is not None
    assert solution.y_box is not None
    gradient = problem.H @ x + problem.g
    scale = 1.0 + max(np.abs(y).max(initial=0.0) for y in (solution.y_eq, solution.y_rows, solution.y_box))
    balance = gradient + problem.A.T @ solution.y_eq + problem.C.T @ solution.y_rows + solution.y_box
    assert np.abs(balance).max() <= tol * scale
    for value, y, low, high in (
        (x, solution.y_box, problem.lb, problem.ub),
        (problem.C @ x, solution.y_rows, problem.l, problem.u),
    ):
        assert (value >= low - tol).all()
        assert (value <= high + tol).all()
        assert (np.minimum(np.maximum(y, 0.0), high - value) <= tol).all()
        assert (np.minimum(np.maximum(-y, 0.0), value - low) <= tol).all()


@pytest.mark.parametrize("name", SURE)
@pytest.mark.parametrize("seed", range(24))
def test_condensed_optimal(name: str, seed: int) -> None:
    problem = condensed(seed)
    assert_optimal(problem, make_solver(name).solve(problem), 1e-8)


def test_condensed_covers_free_and_busy_optima() -> None:
    """The generated problems include optima without active constraints and with six or more."""
    active = []
    for seed in range(24):
        problem = condensed(seed)
        x = make_solver(REFERENCE).solve(problem).x
        Cx = problem.C @ x
        active.append(int(((Cx > problem.u - 1e-9) | (Cx < problem.l + 1e-9)).sum()))
    assert min(active) == 0
    assert max(active) >= 6


@pytest.mark.parametrize("name", [n for n in SURE if n not in ("quadprog", "ldp")])
@pytest.mark.parametrize("n_arms", [3, 4, 8])
def test_full_optimal(name: str, n_arms: int) -> None:
    for seed in range(3):
        problem = full(arms(seed, n_arms))
        assert_optimal(problem, make_solver(name).solve(problem), 1e-7)


@pytest.mark.parametrize("joint", [1e-8, 0.0])
@pytest.mark.parametrize("n_arms", [3, 6])
@pytest.mark.parametrize(("name", "scaled"), [("daqp", False), ("daqp", True), ("proxqp", False)])
def test_full_with_many_limits_met(name: str, joint: float, n_arms: int, scaled: bool) -> None:
    """On these problems OSQP reaches its cap, and ProxQP sometimes."""
    if name not in EVERY:
        pytest.skip(f"{name} is not installed")
    solver = make_solver(name)
    active = []
    for seed in range(6):
        problem = cornered(seed, n_arms, joint, scaled=scaled)
        for _ in range(2):
            solution = solver.solve(problem)
            assert_optimal(problem, solution, 1e-9)
        active.append(int(((solution.x < problem.lb + 1e-9) | (solution.x > problem.ub - 1e-9)).sum()))
    assert min(active) >= 6


@pytest.mark.parametrize("name", [n for n in SURE if n != "osqp"])
def test_large_and_small_unknowns(name: str) -> None:
    """The solution has entries of the orders 1e3 and 1e-3. On one of these problems OSQP reaches its cap."""
    for seed in range(40, 46):
        problem = condensed(seed, spread=3.0)
        assert_optimal(problem, make_solver(name).solve(problem), 1e-6)


@st.composite
def convex(draw: st.DrawFn) -> QpProblem:
    """A strictly convex, feasible problem; some rows are fixed, some free, some bounds infinite."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 10))
    m, p = draw(st.integers(0, n // 2)), draw(st.integers(0, 20))
    B = rng.normal(size=(n, n))
    H = B @ B.T + np.eye(n) if draw(st.booleans()) else np.diag(rng.uniform(0.1, 10.0, size=n))
    inside = rng.normal(size=n)
    A, C = rng.normal(size=(m, n)), rng.normal(size=(p, n))

    def bounds(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high = v - rng.uniform(0.01, 2.0, size=v.size), v + rng.uniform(0.01, 2.0, size=v.size)
        low[rng.random(v.size) < 0.3] = -np.inf
        high[rng.random(v.size) < 0.3] = np.inf
        return low, high

    (l, u), (lb, ub) = bounds(C @ inside), bounds(inside)
    return qp(H, rng.normal(size=n) * 3.0, A=A, b=A @ inside, C=C, l=l, u=u, lb=lb, ub=ub)


@given(convex())
@pytest.mark.parametrize("name", SURE)
def test_random_convex_optimal(name: str, problem: QpProblem) -> None:
    problem.check()
    assert_optimal(problem, make_solver(name).solve(problem), 1e-7)


# -- agreement -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SURE)
def test_agree_on_condensed(name: str) -> None:
    reference = make_solver(REFERENCE)
    for seed in range(24, 44):
        problem = condensed(seed)
        assert np.abs(make_solver(name).solve(problem).x - reference.solve(problem).x).max() <= 1e-8


@needs_daqp
@pytest.mark.parametrize("name", ["proxqp", "osqp"])
@pytest.mark.parametrize("joint", [1e-8, 0.0])
def test_agree_on_full(name: str, joint: float) -> None:
    """Weights from 1e-4 to 1e4, with a tiny or zero weight of the joint velocities."""
    for seed in range(6):
        problem = full(arms(seed, 3), joint=joint)
        apart = make_solver(name).solve(problem).x - make_solver("daqp").solve(problem).x
        assert np.abs(apart).max() <= 1e-6


@pytest.mark.parametrize("name", EVERY)
def test_closed_form(name: str) -> None:
    """min ½|x − c|²: a bound at each end, a row, an equality, and the multipliers' signs."""
    solver = make_solver(name)
    c = np.array([2.0, -3.0, 0.5])
    box = solver.solve(qp(np.eye(3), -c, lb=[-1.0] * 3, ub=[1.0] * 3))
    np.testing.assert_allclose(box.x, [1.0, -1.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(box.y_box, [1.0, -2.0, 0.0], atol=1e-9)
    row = solver.solve(qp(np.eye(3), -c, C=[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], l=[-2.0, -np.inf], u=[np.inf, 0.5]))
    np.testing.assert_allclose(row.x, [0.5, -2.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(row.y_rows, [-1.0, 1.5], atol=1e-9)
    line = solver.solve(qp(np.eye(3), -c, A=[[1.0, 1.0, 1.0]], b=[0.0]))
    np.testing.assert_allclose(line.x, c + 1.0 / 6.0, atol=1e-9)
    np.testing.assert_allclose(line.y_eq, [-1.0 / 6.0], atol=1e-9)
    assert box.usable
    assert line.iterations >= 0
    assert line.solve_time_s > 0.0


@pytest.mark.parametrize("name", SURE)
def test_residual_methods(name: str) -> None:
    """The residuals of a solution agree with the definition, also for another problem."""
    problem = condensed(3)
    solution = make_solver(name).solve(problem)
    assert max(solution.primal_residual(problem), solution.dual_residual(problem)) <= 1e-8
    assert solution.complementarity(problem) <= 1e-8
    assert solution.violation == pytest.approx(solution.primal_residual(problem), abs=1e-14)
    shifted = dataclasses.replace(problem, ub=np.where(np.isinf(problem.ub), solution.x - 0.25, problem.ub))
    assert solution.primal_residual(shifted) == pytest.approx(0.25, abs=1e-9)
    for missing in ("y_rows", "y_box"):
        assert np.isnan(dataclasses.replace(solution, **{missing: None}).complementarity(problem))
        assert np.isnan(dataclasses.replace(solution, **{missing: None}).dual_residual(problem))
    heavier = dataclasses.replace(problem, g=problem.g + 0.5)
    assert solution.dual_residual(heavier) == pytest.approx(0.5, abs=1e-7)


@pytest.mark.parametrize("name", ["proxqp", "ldp"])
def test_iterations_are_those_of_the_backend(name: str) -> None:
    """These begin at 0, which is the answer."""
    assert make_solver(name).solve(qp(np.eye(2), np.zeros(2))).iterations == 0


# -- sequences -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", KEPT)
def test_bounds_relax(name: str) -> None:
    """Only the bounds relax: the old solution stays feasible and stationary, but is wrong."""
    solver = make_solver(name)
    c = np.array([2.0, -3.0, 0.5, 1.0])
    C = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    for width in (0.1, 0.5, 1.0, 2.0, 0.3, 1e3, 0.1, np.inf):
        problem = qp(np.eye(4), -c, C=C, l=[-width] * 2, u=[width] * 2, lb=[-2 * width] * 4, ub=[2 * width] * 4)
        assert_optimal(problem, solver.solve(problem), 1e-8)
    np.testing.assert_allclose(solver.solve(problem).x, c, atol=1e-8)


@needs_daqp
@pytest.mark.parametrize("name", KEPT)
@pytest.mark.parametrize("seed", [2, 5])
def test_warm_equals_cold_condensed(name: str, seed: int) -> None:
    warm = make_solver(name)
    for problem in condensed_loop(seed):
        solution = warm.solve(problem)
        assert_optimal(problem, solution, 1e-8)
        assert np.abs(solution.x - make_solver("daqp").solve(problem).x).max() <= 1e-8


@needs_daqp
@pytest.mark.parametrize("name", SEMIDEFINITE)
@pytest.mark.parametrize("joint", [1e-8, 0.0])
def test_warm_equals_cold_full(name: str, joint: float) -> None:
    warm = make_solver(name)
    for problem in full_loop(1, joint=joint):
        solution = warm.solve(problem)
        assert_optimal(problem, solution, 1e-7)
        assert np.abs(solution.x - make_solver("daqp").solve(problem).x).max() <= 1e-6


@pytest.mark.parametrize("name", [n for n in KEPT if n != "proxqp"])
def test_repeatable_to_the_last_bit(name: str) -> None:
    def run(solver: QpSolver) -> list[bytes]:
        return [solver.solve(p).x.tobytes() for p in (*condensed_loop(2, 30), *full_loop(1, 20))]

    solver = make_solver(name)
    first = run(solver)
    assert run(make_solver(name)) == first
    solver.reset()
    assert run(solver) == first


@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_sizes_change(name: str) -> None:
    solver = make_solver(name)
    for seed in (0, 1, 4, 0, 8):
        problem = condensed(seed)
        assert_optimal(problem, solver.solve(problem), 1e-8)
        problem = full(arms(seed, 3))
        assert_optimal(problem, solver.solve(problem), 1e-7)


@pytest.mark.parametrize("name", EVERY)
def test_no_rows(name: str) -> None:
    """Problems without equalities, without inequalities, without bounds, and with one unknown."""
    solver = make_solver(name)
    for _ in range(2):
        free = solver.solve(qp([[2.0]], [-4.0]))
        np.testing.assert_allclose(free.x, [2.0], atol=1e-9)
        assert free.y_eq is not None
        assert free.y_eq.shape == (0,)
        np.testing.assert_allclose(solver.solve(qp([[2.0]], [-4.0], ub=[1.0])).x, [1.0], atol=1e-9)
        np.testing.assert_allclose(solver.solve(qp([[2.0]], [-4.0], A=[[1.0]], b=[3.0])).x, [3.0], atol=1e-9)
        np.testing.assert_allclose(solver.solve(qp([[2.0]], [-4.0], C=[[2.0]], l=[5.0], u=[6.0])).x, [2.5], atol=1e-9)


@pytest.mark.parametrize("name", EVERY)
def test_fixed_unknowns_and_rows(name: str) -> None:
    """Bounds that coincide are equalities."""
    solver = make_solver(name)
    problem = qp(np.eye(3), [-1.0, -1.0, -1.0], C=[[1.0, 1.0, 0.0]], l=[0.5], u=[0.5], lb=[0.2, -1, -1], ub=[0.2, 1, 1])
    for _ in range(2):
        solution = solver.solve(problem)
        np.testing.assert_allclose(solution.x, [0.2, 0.3, 1.0], atol=1e-9)
        assert_optimal(problem, solution, 1e-8)


@pytest.mark.parametrize("name", KEPT)
def test_redundant_equalities(name: str) -> None:
    """An arm of five joints leaves one of its six rows dependent on the others."""
    base = full(arms(0, 3), joint=1e-2)
    u = np.random.default_rng(0).normal(size=6)
    P = np.eye(6) - np.outer(u, u) / (u @ u)
    A = base.A.copy()
    A[:6] = P @ A[:6]
    problem = dataclasses.replace(base, A=A)
    solver = make_solver(name)
    for _ in range(2):
        assert_optimal(problem, solver.solve(problem), 1e-7)


# -- failures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("what", ["rows", "row and box", "equality and box", "equalities"])
def test_infeasible(name: str, what: str) -> None:
    solver = make_solver(name)
    good = qp(np.eye(2), [-1.0, -1.0], C=[[1.0, 1.0], [1.0, 1.0]], l=[-9.0] * 2, u=[1.0, 9.0], A=[[1.0, -1.0]], b=[0.0])
    bad = {
        "rows": dataclasses.replace(good, l=np.array([-9.0, 3.0])),
        "row and box": dataclasses.replace(good, l=np.array([0.5, 0.5]), ub=np.zeros(2)),
        "equality and box": dataclasses.replace(good, b=np.array([4.0]), lb=np.zeros(2), ub=np.ones(2)),
        "equalities": dataclasses.replace(good, b=np.array([0.0, 1.0]), A=np.array([[1.0, -1.0], [1.0, -1.0]])),
    }[what]
    for problem in (good, bad, bad, good):
        solution = solver.solve(problem)
        if problem is good:
            np.testing.assert_allclose(solution.x, [0.5, 0.5], atol=1e-8)
        else:
            assert not solution.usable
            assert np.isnan(solution.x).all()
            assert solution.message
            # qpsolvers does not return DAQP's reason. ProxQP, whose certificate would take feasible problems for
            # infeasible ones, stops at its cap.
            if name == "proxqp":
                assert solution.status in (SolverStatus.INFEASIBLE, SolverStatus.MAX_ITERATIONS)
            else:
                assert solution.status is (SolverStatus.FAILED if name == "daqp" else SolverStatus.INFEASIBLE)


@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_hard_is_not_called_infeasible(name: str) -> None:
    """A solver may fail on these problems, but each has a solution."""
    for seed in range(12):
        problem = cornered(seed, 6, 0.0, scaled=True)
        solution = make_solver(name).solve(problem)
        assert solution.status in (SolverStatus.SOLVED, SolverStatus.MAX_ITERATIONS)
        if solution.usable:
            assert_optimal(problem, solution, 1e-8)


_INVALID = """
    import json, sys
    import numpy as np
    from coopqp.solvers import QpProblem, make_solver

    fields = ("H", "g", "A", "b", "C", "l", "u", "lb", "ub")
    def good():
        return dict(H=np.eye(4), g=np.ones(4), A=np.ones((1, 4)), b=np.zeros(1), C=np.eye(4)[:2],
                    l=-np.ones(2), u=np.ones(2), lb=-np.ones(4), ub=np.ones(4))
    results = []
    for warm in (False, True):
        solver = make_solver(sys.argv[1])
        for field in fields:
            for bad in (np.nan, np.inf, -np.inf, 1e200):
                data = good()
                if warm:
                    solver.solve(QpProblem(**data))
                data[field].flat[-1] = bad
                solution = solver.solve(QpProblem(**data))
                results.append([field, repr(bad), solution.status.name, solution.message])
        assert solver.solve(QpProblem(**good())).usable
    print(json.dumps(results))
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_data_that_hang_solvers(name: str) -> None:
    """NaN, infinities and overflow in every array. The test uses another process: ProxQP alone would hang."""
    results = json.loads(output("-c", textwrap.dedent(_INVALID), name).splitlines()[-1])
    harmless = {("l", "-inf"), ("lb", "-inf"), ("u", "inf"), ("ub", "inf"), ("u", "1e+200"), ("ub", "1e+200")}
    assert len(results) == 2 * 9 * 4
    for field, bad, status, message in results:
        if (field, bad) in harmless:
            assert status == "SOLVED", (field, bad, message)
        else:
            assert status == "INVALID", (field, bad, message)
            assert field in message.replace("is above", "").split("[")[0].split() or "bound" in message


@pytest.mark.parametrize("name", EVERY)
def test_crossed_bounds(name: str) -> None:
    solver = make_solver(name)
    for fields in ({"l": [1.0], "u": [0.0]}, {"lb": [0.0, 1.0], "ub": [0.0, 1.0 - 1e-12]}):
        problem = qp(np.eye(2), np.zeros(2), **({"C": [[1.0, 1.0]]} if "l" in fields else {}), **fields)
        solution = solver.solve(problem)
        assert solution.status is SolverStatus.INVALID
        assert "above" in solution.message


@pytest.mark.parametrize("name", EVERY)
def test_inputs_stay_as_they_are(name: str) -> None:
    """Read-only arrays, transposed and strided views are neither changed nor kept."""
    base = condensed(7)
    fields = {f.name: getattr(base, f.name) for f in dataclasses.fields(base)}
    views = {}
    for key, array in fields.items():
        wide = np.zeros((*array.shape[:-1], 2 * array.shape[-1])) if array.ndim else array
        wide[..., ::2] = array
        views[key] = wide[..., ::2] if key != "C" else np.asfortranarray(array)
        views[key].setflags(write=False)
    solver = make_solver(name)
    expected = make_solver(name).solve(base).x
    for _ in range(3):
        solution = solver.solve(QpProblem(**views))
        np.testing.assert_allclose(solution.x, expected, atol=1e-9)
    for key, array in fields.items():
        assert np.array_equal(views[key], array)


@pytest.mark.parametrize("name", EVERY)
def test_caller_rewrites_its_arrays(name: str) -> None:
    """One problem object over changing arrays: each solution belongs to the data at its solve and never changes."""
    one, other = condensed(4), condensed(13)
    assert one.g.size == other.g.size
    p = min(one.l.size, other.l.size)
    one, other = (dataclasses.replace(q, C=q.C[:p].copy(), l=q.l[:p].copy(), u=q.u[:p].copy()) for q in (one, other))
    expected = [make_solver(name).solve(q).x for q in (one, other)]
    buffers = {f.name: getattr(one, f.name).copy() for f in dataclasses.fields(one)}
    shared = QpProblem(**buffers)
    solver = make_solver(name)
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    for k in (0, 1, 0, 0, 1, 1):
        for field, array in buffers.items():
            array[...] = getattr((one, other)[k], field)
        kept.append((solver.solve(shared).x, expected[k]))
        buffers["H"][...] = np.nan
    for x, wanted in kept:
        np.testing.assert_allclose(x, wanted, atol=1e-8)


_CAPPED: dict[str, Any] = {
    "proxqp": ProxqpSettings(max_iter=1, max_iter_in=1),
    "osqp": OsqpSettings(max_iter=25),
}


@pytest.mark.parametrize("name", _CAPPED)
def test_iteration_cap(name: str) -> None:
    solver = make_solver(name, _CAPPED[name])
    seen = set()
    for seed in range(24):
        problem = condensed(seed)
        solution = solver.solve(problem)
        seen.add(solution.status)
        if solution.usable:
            assert solution.primal_residual(problem) <= 1e-6
        else:
            assert np.isnan(solution.x).all()
    assert SolverStatus.MAX_ITERATIONS in seen
    assert seen <= {SolverStatus.SOLVED, SolverStatus.MAX_ITERATIONS, SolverStatus.FAILED}


class _Scripted(QpSolver):
    """Returns given results, like a defective backend."""

    name = "scripted"

    def __init__(self, answer: Any, tol: float = 1e-6) -> None:
        self.settings = SolverSettings(feasibility_tol=tol)
        self.answer = answer
        self.forgotten = 0

    def _solve(self, problem: QpProblem, rows: Stacked) -> Outcome:
        if isinstance(self.answer, Exception):
            raise self.answer
        x = None if self.answer is None else np.array(self.answer, dtype=float)
        return Outcome(SolverStatus.SOLVED, x, None, 1)

    def _forget(self) -> None:
        self.forgotten += 1


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ([1.1, 0.0], "bound of x[0]"),
        ([0.0, -1.1], "bound of x[1]"),
        ([np.nan, 0.0], "no finite answer"),
        ([0.0, np.inf], "no finite answer"),
        ([0.9, 0.9], "row 0 of C"),
        ([0.3, -0.3], "equality 0"),
        ([0.0, 0.0, 0.0], "no finite answer"),
        (None, "no finite answer"),
        (RuntimeError("broken\nin two lines"), "RuntimeError: broken"),
        (ValueError("odd"), "ValueError: odd"),
        (ZeroDivisionError("by zero"), "by zero"),
    ],
)
def test_answers_are_tested(answer: Any, says: str) -> None:
    """The solver checks a solution even if the backend reports "solved"."""
    solver = _Scripted(answer)
    box = {"lb": [-1.0, -1.0], "ub": [1.0, 1.0], "C": [[1.0, 1.0]], "l": [-1.5], "u": [1.5]}
    rows = {"A": [[1.0, -1.0]], "b": [0.0]} if says == "equality 0" else {}
    solution = solver.solve(qp(np.eye(2), np.zeros(2), **box, **rows))
    assert solution.status is SolverStatus.FAILED
    assert says in solution.message
    assert np.isnan(solution.x).all()
    assert solution.y_box is None
    assert np.isnan(solution.dual_residual(qp(np.eye(2), np.zeros(2))))
    assert solver.forgotten >= 2  # once for the new size, once because a failed solve is no warm start


def test_feasibility_tolerance() -> None:
    problem = qp(np.eye(1), [0.0], ub=[1.0])
    assert _Scripted([1.0 + 9e-7]).solve(problem).usable
    assert not _Scripted([1.0 + 2e-6]).solve(problem).usable
    assert _Scripted([1.0 + 2e-6], tol=1e-5).solve(problem).usable
    with pytest.raises(MemoryError):
        _Scripted(MemoryError()).solve(problem)


@pytest.mark.slow
@pytest.mark.parametrize("name", KEPT)
def test_wild_data_end_in_a_status(name: str) -> None:
    """Magnitudes from 1e-18 to 1e18, H of any rank and sign: the result is a status without exception or hang."""
    solver = make_solver(name)
    for seed in range(150):
        rng = np.random.default_rng(seed)
        n, m, p = int(rng.integers(1, 9)), int(rng.integers(0, 3)), int(rng.integers(0, 9))

        def wild(*shape: int, rng: np.random.Generator = rng) -> np.ndarray:
            values: np.ndarray = rng.normal(size=shape) * 10 ** rng.uniform(
                -18, 18, size=shape if rng.random() < 0.3 else ()
            )
            return np.where(rng.random(shape) < 0.2, 0.0, values)

        B = wild(n, n)
        H = (np.eye(n), B @ B.T / (1.0 + np.abs(B).max()), np.zeros((n, n)))[seed % 3]
        ends = [np.sort([wild(k), wild(k)], axis=0) for k in (p, n)]
        problem = qp(H, wild(n), A=wild(m, n), b=wild(m), C=wild(p, n),
                     l=ends[0][0], u=ends[0][1], lb=ends[1][0], ub=ends[1][1])  # fmt: skip
        solution = solver.solve(problem)
        assert isinstance(solution.status, SolverStatus)
        if solution.usable:
            assert solution.primal_residual(problem) <= 1e-6


@pytest.mark.parametrize("name", EVERY)
def test_nothing_is_printed(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    solver = make_solver(name)
    for problem in (condensed(0), condensed(0), *full_loop(1, 12), qp(np.eye(2), np.zeros(2))):
        solver.solve(problem)
    out, err = capfd.readouterr()
    assert out == ""
    assert err == ""


# -- building --------------------------------------------------------------------------------------------------------


def test_import_is_light() -> None:
    code = """
        import sys, types, pathlib
        import coopqp.errors
        before = set(sys.modules)
        import coopqp.solvers
        heavy = {"osqp", "proxsuite", "daqp", "qpsolvers", "scipy"}
        print(sorted(heavy & (set(sys.modules) - before)))
    """
    assert output("-c", textwrap.dedent(code)).strip() == "[]"


def test_names() -> None:
    names = available_solvers()
    assert names[: len(KEPT)] == tuple(KEPT)
    assert len(set(names)) == len(names)
    for name in names:
        assert make_solver(name).name in (name, f"qpsolvers:{name}")
    for name in ("proxpq", "qpsolvers:nothing", "", "qpsolvers:"):
        with pytest.raises(UnknownNameError) as caught:
            make_solver(name)
        assert caught.value.available == names
    assert "Did you mean 'proxqp'" in str(UnknownNameError("QP solver", "proxpq", names))


def test_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr("coopqp.solvers.choice.find_spec", lambda name: None if name == "osqp" else real(name))
    with pytest.raises(MissingExtraError, match="osqp"):
        make_solver("osqp")


@pytest.mark.parametrize(
    ("build", "match"),
    [
        (lambda: SolverSettings(feasibility_tol=0.0), "feasibility_tol"),
        (lambda: ProxqpSettings(eps_abs=-1.0), "eps_abs"),
        (lambda: ProxqpSettings(max_iter=0), "max_iter"),
        (lambda: ProxqpSettings(max_iter_in=2.5), "max_iter_in"),  # type: ignore[arg-type]
        (lambda: OsqpSettings(eps_rel=float("nan")), "eps_rel"),
        (lambda: OsqpSettings(adaptive_rho_interval=0), "adaptive_rho_interval"),
        (lambda: DaqpSettings(primal_tol=float("inf")), "primal_tol"),
        (lambda: DaqpSettings(iter_limit=True), "iter_limit"),
        (lambda: GenericSettings(options=3), "options"),  # type: ignore[arg-type]
        (lambda: make_solver("osqp", ProxqpSettings()), "OsqpSettings"),
        (lambda: make_solver("qpsolvers:osqp", OsqpSettings()), "GenericSettings"),
    ],
)
def test_settings_are_checked(build: Callable[[], Any], match: str) -> None:
    with pytest.raises(InvalidInputError, match=match):
        build()


@pytest.mark.parametrize("kind", [OsqpSettings, ProxqpSettings, DaqpSettings, GenericSettings])
def test_settings_that_version_02_pickled_are_used(kind: Any) -> None:
    """They have fields that are no more, and lack some."""
    settings = kind()
    vars(settings).update(polish=True, accuracy=1e-8, eps_infeasible=1e-9)
    vars(settings).pop("eps_prim_inf", None)
    if kind is GenericSettings:
        vars(settings)["options"] = None
    name = kind.__name__.removesuffix("Settings").lower().replace("generic", "quadprog")
    solver = make_solver(name, pickle.loads(pickle.dumps(settings)))
    assert solver.solve(qp(np.eye(2), [-1.0, -1.0], ub=[0.5, 0.5])).usable


def test_generic_options() -> None:
    problem = qp(np.eye(2), [-1.0, -1.0], ub=[0.5, 0.5])
    capped = make_solver("qpsolvers:proxqp", GenericSettings(options={"max_iter": 1, "eps_abs": 1e-12}))
    assert capped.solve(problem).status is SolverStatus.MAX_ITERATIONS
    unknown = make_solver("qpsolvers:proxqp", GenericSettings(options={"no_such_option": 1}))
    assert unknown.solve(problem).status is SolverStatus.FAILED


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"H": np.eye(3)}, "shapes"),
        ({"g": np.zeros((2, 1))}, "shapes"),
        ({"b": np.zeros(1)}, "shapes"),
        ({"u": np.zeros(1)}, "shapes"),
        ({"lb": np.zeros(3)}, "shapes"),
        ({"H": np.eye(2, dtype=np.float32)}, "H is float32"),
        ({"ub": [1.0, 1.0]}, "ub is list"),
        ({"g": np.zeros(2, dtype=int)}, "g is int"),
    ],
)
def test_problem_is_checked_when_built(change: dict[str, Any], match: str) -> None:
    with pytest.raises(InvalidInputError, match=match):
        dataclasses.replace(qp(np.eye(2), np.zeros(2)), **change)


def test_check_tests_convexity() -> None:
    qp([[1.0, 1.0], [1.0, 1.0]], [0.0, 0.0]).check()
    with pytest.raises(InvalidInputError, match="transpose"):
        qp([[1.0, 0.1], [0.0, 1.0]], [0.0, 0.0]).check()
    with pytest.raises(InvalidInputError, match="eigenvalue"):
        qp([[1.0, 2.0], [2.0, 1.0]], [0.0, 0.0]).check()
    with pytest.raises(InvalidInputError, match="shapes"):
        qp(np.zeros((0, 0)), np.zeros(0))
