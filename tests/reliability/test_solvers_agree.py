"""Solvers agree with each other on recorded and random QPs; the tests compute optimality themselves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import recorded_qps
from checks import FaultySolver
from runs import cooperative

from coopqp import Status
from coopqp.scenarios import fast_lift
from coopqp.solvers import QpProblem, QpSolution, SolverStatus, available_solvers, make_solver

#: How far joint velocities may be apart [rad/s], and answers from optimal.
TARGET = {"ldp": 1e-8, "daqp": 1e-8, "quadprog": 1e-8, "proxqp": 1e-6, "osqp": 1e-3}
SOLVERS = [name for name in TARGET if name in available_solvers()]
REFERENCE = "quadprog" if "quadprog" in SOLVERS else "daqp"
CASES = ("corner", "near_singular", "elbow", "outside", "mismatch", "redundant", "saturated")


def kkt_residual(problem: QpProblem, solution: QpSolution) -> float:
    """The largest violation of a constraint, relative gradient, or multiplier at an inactive bound."""
    x = solution.x
    assert solution.y_eq is not None
    assert solution.y_rows is not None
    assert solution.y_box is not None
    y = np.concatenate([solution.y_eq, solution.y_rows, solution.y_box])
    G = np.vstack([problem.A, problem.C, np.eye(x.size)])
    low = np.concatenate([problem.b, problem.l, problem.lb])
    high = np.concatenate([problem.b, problem.u, problem.ub])
    value = G @ x
    broken = max(0.0, float((value - high).max()), float((low - value).max()))
    slope = float(np.abs(problem.H @ x + problem.g + G.T @ y).max()) / (1.0 + float(np.abs(y).max()))
    m = len(problem.b)
    distance = np.where(y > 0.0, high - value, value - low)[m:]
    loose = float(np.minimum(np.abs(y[m:]), np.abs(distance)).max(initial=0.0))
    return max(broken, slope, loose)


class Tally:
    def __init__(self) -> None:
        self.cases = 0
        self.residual = dict.fromkeys(SOLVERS, 0.0)
        self.apart = dict.fromkeys(SOLVERS, 0.0)
        self.failed = dict.fromkeys(SOLVERS, 0)
        self.solved = dict.fromkeys(SOLVERS, 0)
        self.disagreements: list[tuple[str, QpSolution]] = []

    def compare(self, problem: QpProblem, solvers: dict[str, Any], velocity: Callable[[Any], Any]) -> None:
        """Solve with each solver. If some succeed and others fail, record the statuses of the others.

        Velocities are compared with those of the reference solver.
        """
        self.cases += 1
        found = {name: solver.solve(problem) for name, solver in solvers.items()}
        if not any(s.usable for s in found.values()):
            return
        best = found.get(REFERENCE)
        right = velocity(best.x) if best is not None and best.usable else None
        for name, solution in found.items():
            if not solution.usable:
                self.failed[name] += 1
                self.disagreements.append((name, solution))
                continue
            self.residual[name] = max(self.residual[name], kkt_residual(problem, solution))
            self.solved[name] += 1
            if right is not None:
                self.apart[name] = max(self.apart[name], float(np.abs(velocity(solution.x) - right).max()))

    def rows(self, catalogue: Any, what: str) -> None:
        for name in SOLVERS:
            for figures, kind, unit in ((self.apart, "velocities apart", "rad/s"), (self.residual, "KKT residual", "")):
                if not self.solved[name] or (name == REFERENCE and figures is self.apart):
                    continue
                catalogue.row(
                    "D",
                    f"{what}, {name}: {kind}",
                    cases=self.solved[name],
                    measured=figures[name],
                    target=TARGET[name],
                    unit=unit,
                    note=f"from {REFERENCE}; no answer to {self.failed[name]} that another solver found one to",
                )


@pytest.mark.slow
def test_on_recorded_problems(count: Callable[[int], int], catalogue: Any) -> None:
    tally = Tally()
    for case in CASES:
        solvers = {name: make_solver(name) for name in SOLVERS}  # kept along a recording, as in a loop
        for one in recorded_qps.record(case, 3, count(25)).qps:
            tally.compare(one.problem, solvers, one.velocity)
    assert tally.cases >= 20 * len(CASES)
    tally.rows(catalogue, "recorded QPs")
    assert_holding(tally, catalogue, "recorded QPs")


def random_problem(rng: np.random.Generator) -> QpProblem:
    """A feasible least-distance problem like in a step: unit rows, three bounded shares."""
    n, p = int(rng.integers(9, 13)), int(rng.choice([12, 18, 24, 48]))
    C = rng.normal(size=(p, n))
    C /= np.linalg.norm(C, axis=1)[:, None]
    inside = rng.normal(size=n) * 10.0 ** rng.uniform(-3, 0.5, size=n)
    inside[6:9] = 10.0 ** rng.uniform(-3, 0, size=3)
    v = C @ inside
    cuts = rng.random(p) < rng.uniform(0.0, 0.4)  # these rows may exclude the origin
    wide = np.where(cuts, 0.0, 2.0 * np.abs(v) + 1.0)
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    lb[6:9], ub[6:9] = 0.0, inside[6:9] + 10.0 ** rng.uniform(-3, 0, size=3)
    room = 10.0 ** rng.uniform(-3, 1, size=(2, p))
    none = np.zeros((0, n)), np.zeros(0)
    return QpProblem(np.eye(n), np.zeros(n), *none, C, v - wide - room[0], v + wide + room[1], lb, ub)


def hardly_feasible(rng: np.random.Generator) -> QpProblem:
    """One row twice, with bounds that overlap by 10⁻¹² … 10⁻³ or leave such a gap."""
    problem = random_problem(rng)
    margin = float(rng.choice([-1.0, 1.0])) * 10.0 ** rng.uniform(-12.0, -3.0)
    i = int(rng.integers(len(problem.l)))
    row, at = problem.C[i], float(rng.uniform(problem.l[i], problem.u[i]))
    C = np.vstack([problem.C, -row * (1.0 + 1e-9 * rng.normal())])
    l, u = np.append(problem.l, -np.inf), np.append(problem.u, -at + margin)
    u[i] = min(u[i], at + margin)
    return QpProblem(problem.H, problem.g, problem.A, problem.b, C, l, u, problem.lb, problem.ub)


@pytest.mark.slow
def test_on_random_problems(rng: np.random.Generator, count: Callable[[int], int], catalogue: Any) -> None:
    tally = Tally()
    solvers = {name: make_solver(name) for name in SOLVERS}
    for _ in range(count(500)):
        problem = random_problem(rng)
        tally.compare(problem, solvers, lambda x, C=problem.C: C @ x)
    tally.rows(catalogue, "random QPs")
    assert_holding(tally, catalogue, "random QPs")


@pytest.mark.slow
def test_on_problems_at_the_border_of_feasibility(
    rng: np.random.Generator, count: Callable[[int], int], catalogue: Any
) -> None:
    """Solvers may disagree on feasibility here, but none may return a wrong solution."""
    tally = Tally()
    solvers = {name: make_solver(name) for name in SOLVERS}
    for _ in range(count(500)):
        tally.compare(hardly_feasible(rng), solvers, lambda x: x)
    assert tally.disagreements
    catalogue.row(
        "D",
        "QPs at the border of feasibility: KKT residual, all solvers",
        cases=tally.cases,
        measured=max(tally.residual[name] / TARGET[name] for name in SOLVERS),
        target=1.0,
        unit="of its target",
    )
    assert_holding(tally, catalogue, "QPs at the border of feasibility")


def says(solution: QpSolution) -> Callable[[Any, QpProblem], QpSolution]:
    """A fault: the recorded result of another solver."""

    def said(_: Any, problem: QpProblem) -> QpSolution:
        s, nothing = solution, np.full(problem.g.size, np.nan)
        return QpSolution(nothing, s.status, None, None, None, s.iterations, s.solve_time_s, s.message)

    return said


def assert_holding(tally: Tally, catalogue: Any, what: str) -> None:
    """A controller holds with every recorded result of a solver that failed while others succeeded."""
    task, not_held = fast_lift(), 0
    said = {(name, s.status, s.message): s for name, s in tally.disagreements}
    for solution in said.values():
        assert solution.status is not SolverStatus.SOLVED
        double = FaultySolver("daqp", says(solution))
        controller = cooperative(task, shortcut=False, solver=double)
        controller.reset(task.q_start)
        controller.step()
        double.broken = True
        step = controller.step()
        not_held += step.status is not Status.HOLDING
    catalogue.row(
        "D",
        f"{what}: disagreement on feasibility, not held",
        cases=tally.cases,
        measured=not_held,
        target=0,
        note=f"{len(tally.disagreements)} disagreements, in {len(said)} different words",
    )
