"""The QP of a step: the condensed form, the full form and the ray agree; the form with slack."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from marks import slow_but_first, slow_unless

from coopqp import InvalidInputError, PreviewOptions, QPController, QPOptions
from coopqp.constraints.velocity import Rows, no_rows
from coopqp.control import RankWeights
from coopqp.control.interface import NO_SOLVE
from coopqp.control.step.formulations import Answer, Pieces, StepProgram, StepTerms
from coopqp.control.step.priorities import StepAnswer, StepSolver, _least_broken
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.model.chain import Chain
from coopqp.native import available_kernels
from coopqp.scenarios import (
    LOADED,
    PROGRAMS,
    SCENARIOS,
    SHARED_JOINTS,
    Scenario,
    at_singularity,
    dual_arm7,
    five_joint_pair,
    mixed_cell,
    paper_lift,
    scara_pair,
)
from coopqp.solvers import QpSolver, SolverSettings, make_solver
from coopqp.spatial import Array

#: Random boxes per recorded step.
BOXES = 50 if os.environ.get("HYPOTHESIS_PROFILE") == "nightly" else 5
#: The promise: both forms give the same velocities [rad/s or m/s].
AGREEMENT = 1e-8


@dataclass(eq=False)
class Recorded:
    """The problem of a step, with its linearised chain."""

    program: StepProgram
    terms: StepTerms
    box: VelocityBox

    @property
    def chain(self) -> Chain:
        return self.program.chain

    @property
    def pieces(self) -> Pieces:
        return self.program.pieces(self.terms)

    def ranked(self) -> StepAnswer:
        """The ranked answer: nominal, else the fastest rate on the path, else the QP."""
        solver = StepSolver(self.chain, self.box, QPOptions())
        return solver.answer(self.terms, np.zeros(self.chain.nv), 0.02, no_rows(self.chain.nv))

    def condensed(self, box: Any = None, weights: RankWeights | None = None) -> Answer:
        program = self.program if weights is None else StepProgram(self.chain, weights)
        problem, base, B = program.condensed(self.terms, self.pieces, box or self.box)
        solution = make_solver("daqp").solve(problem)
        assert solution.usable, solution
        return program.read_condensed(solution.x, self.terms, base, B)

    def parted(self, box: Any) -> Answer:
        """The answer whose chain may part."""
        problem, base, B = self.program.condensed(self.terms, self.pieces, box, parts=True)
        solution = make_solver("ldp").solve(problem)
        assert solution.usable, solution
        return self.program.read_condensed(solution.x, self.terms, base, B)

    def full(self, box: Any = None, *, solver: str = "daqp") -> Answer:
        solution = make_solver(solver).solve(self.program.full(self.terms, box or self.box))
        assert solution.usable, solution
        return self.program.read_full(solution.x, self.terms)


def steps(
    task: Scenario, monkeypatch: pytest.MonkeyPatch, *, every: int = 5, dt: float = 0.02, **given: Any
) -> Iterator[Recorded]:
    """Record every ``every``-th step of a run, before it is solved."""
    asked: list[Recorded] = []
    condensed = StepProgram.condensed

    def spy(self: StepProgram, terms: StepTerms, pieces: Pieces, box: VelocityBox, *others: Any, **named: Any) -> Any:
        asked[:] = [Recorded(self, terms, box)]
        return condensed(self, terms, pieces, box, *others, **named)

    options = QPOptions(shortcut=False, kernel="plain", **given)
    controller = QPController(task.cell, task.grasp, task.path, dt=dt, options=options)
    controller.reset(task.q_start)
    for number in range(10_000):
        asked.clear()
        with monkeypatch.context() as patch:  # whoever asks for the recorded problem is not spied on
            patch.setattr(StepProgram, "condensed", spy)
            step = controller.step()
        if number % every == 0:
            yield asked[0]
        if step.finished or number * dt > 2.0 * task.path.duration:
            return


@dataclass(eq=False)
class Box:
    """A box with given bounds: the part of a VelocityBox that the program reads."""

    lower: Array
    upper: Array
    outside: Array
    recovery: Array

    @property
    def any_outside(self) -> bool:
        return bool(self.outside.any())


def a_box(rng: np.random.Generator, recorded: Recorded, *, width: float, outside: int = 0) -> Box:
    """A random box that contains a command that keeps the chain, but not the nominal command."""
    chain, terms, pieces = recorded.chain, recorded.terms, recorded.pieces
    program = recorded.program
    _, _, B = program.condensed(terms, pieces, recorded.box)
    shares = rng.uniform(size=3)
    off = rng.normal(size=6) * [0.02, 0.02, 0.02, 0.06, 0.06, 0.06]
    if terms.admissible is not None:
        off = terms.admissible @ (terms.admissible.T @ off)
    inside = pieces.fixed + shares[0] * terms.rate_cap * pieces.along + shares[1] * pieces.grasp
    inside = inside + shares[2] * pieces.path + chain.joint_columns(terms.to_world @ off[:, None])[:, 0]
    if chain.redundancy:
        inside = inside + B[:, -chain.redundancy :] @ rng.normal(size=chain.redundancy) * 1e-3
    n = chain.nv
    lower, upper = inside - width * rng.uniform(size=n), inside + width * rng.uniform(size=n)
    flags = np.zeros(n, dtype=bool)
    flags[rng.choice(n, size=outside, replace=False)] = True
    recovery = np.where(flags, rng.uniform(lower, upper), 0.0)
    return Box(lower, upper, flags, recovery)


# -- condensed against full --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell])
def test_every_condensed_command_keeps_the_chain_of_the_full_form(
    make: Any, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Whatever the unknowns: A x = b of the full form, for corrections and offsets of any size and each arm's own."""
    recorded = next(steps(make(), monkeypatch))
    chain, program = recorded.chain, recorded.program
    for _ in range(5):
        terms = replace(
            recorded.terms,
            path_correction=rng.normal(size=6),
            grasp_corrections=rng.normal(size=(chain.n_arms, 6)),
            offsets=rng.normal(size=(chain.n_arms, 6)),
            rate_cap=rng.uniform(0.3, 1.0),
        )
        condensed, base, B = program.condensed(terms, program.pieces(terms), recorded.box)
        x = rng.normal(size=B.shape[1])
        problem = program.full(terms, recorded.box)
        both = np.concatenate([base + B @ x, x[:9]])
        np.testing.assert_allclose(problem.A @ both, problem.b, rtol=0.0, atol=1e-9)
        shares = chain.nv + 6
        np.testing.assert_allclose(problem.ub[shares : shares + 3], condensed.ub[6:9])  # σ ≥ 0, ρ_g ≥ 0, ρ_p ≥ 0
        assert not problem.lb[shares : shares + 3].any()
        one, other = (
            program.read_condensed(x, terms, base, B),
            program.read_full(both, terms),
        )
        np.testing.assert_allclose(one.velocity, other.velocity)
        np.testing.assert_allclose(one.off_path, other.off_path)
        assert (one.rate, one.grasp_share, one.path_share) == (other.rate, other.grasp_share, other.path_share)
        assert program.parting(one, terms) < 1e-9


def test_the_rows_of_the_condensed_form_have_unit_norm(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Those of joints, of further rows, and of rows that may give way, with their own unknown."""
    recorded = next(steps(mixed_cell(), monkeypatch))
    nv = recorded.chain.nv
    soft = np.array([True, False, True])
    G = rng.normal(size=(3, nv)) * np.array([[1.0], [1.0], [0.0]])  # the last has but its own unknown
    rows = Rows(G, np.full(3, -1.0), np.full(3, 2.0), soft, np.arange(3))
    for relax in (False, True):
        problem, base, B = recorded.program.condensed(recorded.terms, recorded.pieces, recorded.box, rows, relax=relax)
        assert problem.C.shape == (nv + 3, B.shape[1] + (2 if relax else 0))
        norms = np.ones(nv + 3) if relax else np.append(np.ones(nv + 2), 0.0)
        np.testing.assert_allclose(np.linalg.norm(problem.C, axis=1), norms, rtol=1e-12)
        x = rng.normal(size=problem.C.shape[1])
        v, given = base + B @ x[: B.shape[1]], np.zeros(3)
        given[soft] = x[B.shape[1] :] * 1e-3 if relax else 0.0  # clearance 1e6: one unit costs 1
        made = np.concatenate([v, rows.G @ v - given])
        lower, upper = (
            np.concatenate([recorded.box.lower, rows.lower]),
            np.concatenate([recorded.box.upper, rows.upper]),
        )
        room = problem.u - problem.C @ x
        np.testing.assert_allclose(room * (upper - lower), (upper - made) * (problem.u - problem.l), rtol=1e-9)


#: Those of LOADED move the arms as the paper's lift does.
NAMES = [name for name in SCENARIOS if name not in (*LOADED, *PROGRAMS, *SHARED_JOINTS)]


@pytest.mark.parametrize(
    "limits",
    slow_but_first([{}, {"velocity": 0.2}, {"acceleration": 2.0}]),
    ids=["own", "slow", "accelerating"],
)
@pytest.mark.parametrize("name", slow_unless(lambda name: name in ("dual_arm7", "scara_pair"), NAMES))
def test_both_forms_agree_on_every_scenario(name: str, limits: dict[str, float], monkeypatch: Any) -> None:
    task = SCENARIOS[name]()
    task = replace(task, cell=task.cell.with_limits(**limits) if limits else task.cell)
    count = 0
    for recorded in steps(task, monkeypatch, every=7):
        a, b = recorded.condensed(), recorded.full()
        assert np.abs(a.velocity - b.velocity).max() < AGREEMENT
        assert abs(a.rate - b.rate) < 1e-6
        count += 1
    assert count >= 3


@pytest.mark.slow
def test_both_forms_agree_on_the_way_to_a_singular_elbow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Near the elbow, some velocities hardly change the cost of the full form."""
    task = at_singularity("elbow")
    weakest, compared = np.inf, 0
    nearer = PreviewOptions(singular_rate=2e-3)  # until a joint alone would move the object 500 times as fast
    for recorded in steps(task, monkeypatch, every=1, dt=task.dt, preview=nearer):
        J = recorded.chain.dense().reshape(3, 6, 18)
        weakest = float(np.linalg.svd(J, compute_uv=False).min())
        if weakest > 0.03:
            continue
        a = recorded.condensed()
        for solver in ("daqp", "proxqp", "osqp", "qpsolvers:daqp"):
            assert np.abs(a.velocity - recorded.full(solver=solver).velocity).max() < AGREEMENT, solver
        compared += 1
        if compared == 90:
            break
    assert weakest < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("outside", [0, 2])
@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell, scara_pair, five_joint_pair])
def test_both_forms_agree_in_random_boxes(
    make: Any, outside: int, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """The chain is possible in these boxes, but the object must leave its path."""
    off_path = 0
    for recorded in steps(make(), monkeypatch, every=40):
        for _ in range(BOXES):
            box = a_box(rng, recorded, width=10.0 ** rng.uniform(-3.0, 0.0), outside=outside)
            a, b = recorded.condensed(box), recorded.full(box)
            assert np.abs(a.velocity - b.velocity).max() < AGREEMENT
            assert np.maximum(a.velocity - box.upper, box.lower - a.velocity).max() < 1e-8
            off_path += np.linalg.norm(a.off_path) > 1e-4
    assert off_path > 3


def test_another_solver_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(velocity=0.2))
    for recorded in steps(task, monkeypatch, every=20):
        assert np.abs(recorded.full().velocity - recorded.full(solver="proxqp").velocity).max() < 1e-7


@pytest.mark.parametrize("make", slow_but_first([paper_lift, dual_arm7, mixed_cell, scara_pair, five_joint_pair]))
def test_every_answer_keeps_the_chain(make: Any, monkeypatch: Any, rng: np.random.Generator) -> None:
    """A_k v_k = σν + s + ρ_p c_p + ρ_g c_k + b_k for every arm, with any values of s, σ and ρ."""
    for recorded in steps(make(), monkeypatch, every=40):
        terms = recorded.terms
        terms.grasp_corrections = rng.normal(size=terms.grasp_corrections.shape) * 0.01
        for k, P in terms.ranges:
            terms.grasp_corrections[k] = P @ terms.grasp_corrections[k]
        answer = recorded.condensed(a_box(rng, recorded, width=0.1))
        assert recorded.program.parting(answer, terms) < 1e-9
        common = answer.rate * terms.along + answer.off_path + answer.path_share * terms.path_correction
        wanted = common + answer.grasp_share * terms.grasp_corrections + terms.offsets
        made = recorded.chain.twists(answer.velocity) @ np.linalg.inv(terms.to_world).T
        assert np.abs(made - wanted).max() < 1e-9


def test_pieces_add_up_to_the_command(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    for recorded in steps(mixed_cell(), monkeypatch, every=40):
        terms, chain = recorded.terms, recorded.chain
        terms.path_correction, rate = rng.normal(size=6) * 0.01, rng.uniform()
        v = recorded.pieces.command(rate)
        wanted = rate * terms.along + terms.path_correction + terms.grasp_corrections + terms.offsets
        assert np.abs(chain.twists(v) - wanted @ terms.to_world.T).max() < 1e-12


# -- the ray -----------------------------------------------------------------------------------------------------------


def test_joints_that_are_free_go_along_at_any_rate_for_nothing(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Full form: at a rate σ of the object the motion σ z′ of the free joints has no cost, only the late object has."""
    recorded = next(steps(dual_arm7(), monkeypatch))
    chain, weights = recorded.chain, recorded.program.weights
    along = chain.null_basis() @ rng.normal(size=chain.redundancy)
    terms = replace(recorded.terms, null_along=along, null_offset=None)
    problem, costs = recorded.program.full(terms, recorded.box), []
    for share in (0.0, 0.5, 1.0):
        late = (1.0 - share) * terms.rate_cap
        x = np.zeros(len(problem.g))
        x[: chain.nv], x[chain.nv + 6] = share * terms.rate_cap * along, late * np.sqrt(weights.rate)
        costs.append(0.5 * x @ problem.H @ x + problem.g @ x - 0.5 * weights.rate * late**2)
    assert costs[0] < 0.0  # the square that is left out where no joint moves
    np.testing.assert_allclose(costs, costs[0], rtol=1e-6)


@pytest.mark.slow
def test_the_ray_is_what_the_weights_tend_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ray solves the strict ranks. The distance of the weighted QP is proportional to rate cost / off-path cost."""
    task = paper_lift(time_law="quintic")
    task = replace(task, cell=task.cell.with_limits(velocity=0.15))
    apart: dict[float, list[float]] = {1e-4: [], 1e-6: [], 1e-8: []}
    used = 0
    for recorded in steps(task, monkeypatch, every=3):
        on_path = recorded.ranked()
        assert on_path.exact
        assert on_path.report is NO_SOLVE
        if on_path.rate > 0.999 * recorded.terms.rate_cap:
            continue
        used += 1
        for ratio, distances in apart.items():
            solved = recorded.condensed(weights=RankWeights(rate=1e4 * ratio, grasp=1e8, path=1e6))
            distances.append(np.abs(solved.velocity - on_path.velocity).max())
        default = recorded.condensed()
        assert np.abs(default.velocity - on_path.velocity).max() < 5e-6
        assert on_path.active
    assert used > 10
    worst = {ratio: max(d) for ratio, d in apart.items()}
    assert worst[1e-6] < 2e-2 * worst[1e-4]
    assert worst[1e-8] < 2e-2 * worst[1e-6]


# -- the form whose chain may part -------------------------------------------------------------------------------------


def test_slack_changes_nothing_where_the_chain_can_be_kept(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    for recorded in steps(paper_lift(), monkeypatch, every=60):
        box = a_box(rng, recorded, width=0.1)
        relaxed = recorded.parted(box)
        assert recorded.program.parting(relaxed, recorded.terms) < 1e-5
        assert np.abs(relaxed.velocity - recorded.full(box).velocity).max() < 1e-3


def test_slack_parts_the_arms_no_more_than_it_must(monkeypatch: pytest.MonkeyPatch) -> None:
    """One arm is fixed and a joint of another arm must move: the third arm does not move."""
    recorded = next(steps(paper_lift(), monkeypatch))
    n = recorded.chain.nv
    lower, upper = np.full(n, -1.0), np.full(n, 1.0)
    lower[:6] = upper[:6] = 0.0
    lower[6] = 0.1
    box = Box(lower, upper, np.zeros(n, dtype=bool), np.zeros(n))
    problem, _, _ = recorded.program.condensed(recorded.terms, recorded.pieces, box)  # type: ignore[arg-type]
    assert not make_solver("daqp").solve(problem).usable
    answer = recorded.parted(box)
    parted = recorded.program.parting(answer, recorded.terms)
    assert 1e-4 < parted < 0.1
    assert np.all(answer.velocity >= lower - 1e-8)
    twists = recorded.chain.twists(answer.velocity) @ np.linalg.inv(recorded.terms.to_world).T
    assert np.abs(twists[0]).max() < 1e-9
    apart = np.linalg.norm(twists[1] - twists[0]), np.linalg.norm(twists[2] - twists[0])
    assert apart[1] < apart[0]


@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell, scara_pair])
def test_slack_always_has_an_answer(make: Any, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """The form with slack is solvable in boxes without a closed chain, with and without joints outside their limits."""
    for recorded in steps(make(), monkeypatch, every=40):
        n = recorded.chain.nv
        for _ in range(BOXES):
            middle, width = rng.normal(size=n) * 0.3, 10.0 ** rng.uniform(-4.0, 0.0)
            flags = rng.uniform(size=n) < 0.2
            box = Box(middle - width, middle + width, flags, middle * flags)
            answer = recorded.parted(box)  # asserts that it is solved
            assert np.maximum(answer.velocity - box.upper, box.lower - answer.velocity).max() < 1e-6
            assert answer.rate > -1e-9
            assert np.isfinite(recorded.program.parting(answer, recorded.terms))


# -- arms with few joints, weights -------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [scara_pair, five_joint_pair])
def test_off_path_motion_is_one_that_all_arms_can_follow(
    make: Any, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    for recorded in steps(make(), monkeypatch, every=40):
        Z = recorded.terms.admissible
        assert Z is not None
        assert Z.shape[1] == 4
        s = recorded.condensed(a_box(rng, recorded, width=0.01)).off_path
        assert np.abs(s - Z @ (Z.T @ s)).max() < 1e-9


class Raising(QpSolver):
    """Raises, whatever it is asked."""

    name = "raising"
    settings = SolverSettings()

    def solve(self, problem: Any) -> Any:
        raise RuntimeError("no licence")

    def _solve(self, problem: Any, work: Any) -> Any:
        raise NotImplementedError

    def _forget(self) -> None:
        pass


@pytest.mark.parametrize("kernel", available_kernels())
def test_what_a_solver_raises_is_reported(kernel: Any) -> None:
    task = paper_lift()
    options = QPOptions(kernel=kernel, solver=Raising(), shortcut=False)
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01, options=options)
    controller.reset(task.q_start)
    step = controller.step()
    report = step.solver
    assert (report.name, report.status, report.iterations, report.time_s) == ("raising", "failed", 0, 0.0)
    assert "no licence" in report.message
    assert "no licence" in step.reason
    assert np.abs(step.velocity).max() < 1e-9  # the arms stay at rest, but for the rounding of the grasp


def test_an_answer_names_the_limits_at_which_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """By joint and side: those of a QP, and the one that makes the rate on the path."""
    sides = set()
    for recorded in steps(paper_lift(), monkeypatch, every=20):
        n, terms = recorded.chain.nv, recorded.terms
        v = recorded.pieces.command(terms.rate_cap)
        if np.abs(v).max() < 0.05:
            continue
        for joint in (None, *range(n)):  # the way of all joints is halved, or of one
            room = np.abs(v) + 0.1
            room[slice(None) if joint is None else joint] = 0.5 * np.abs(v[slice(None) if joint is None else joint])
            box = Box(-room - 1e-4, room + 1e-4, np.zeros(n, dtype=bool), np.zeros(n))
            for shortcut in (True, False):
                solver = StepSolver(recorded.chain, box, QPOptions(shortcut=shortcut))  # type: ignore[arg-type]
                answer = solver.answer(terms, np.zeros(n), 0.02, no_rows(n))
                at = {(j, 1.0) for j in np.flatnonzero(box.upper - answer.velocity < 1e-8)}
                at |= {(j, -1.0) for j in np.flatnonzero(answer.velocity - box.lower < 1e-8)}
                assert set(answer.active) == at
                sides |= {(shortcut, side) for _, side in at}
    assert len(sides) == 4


class Boundless(Raising):
    """Solves as if there were no limits, and says that it kept them."""

    name = "boundless"

    def solve(self, problem: Any) -> Any:
        n = problem.g.size
        free = replace(
            problem, C=np.zeros((0, n)), l=np.zeros(0), u=np.zeros(0), lb=np.full(n, -np.inf), ub=np.full(n, np.inf)
        )
        return make_solver("daqp").solve(free)


def test_a_solver_that_breaks_limits_is_not_believed(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    """Cut off at a limit its answer would tear at the grasp; another command keeps chain and limits."""
    for recorded in steps(paper_lift(), monkeypatch, every=60):
        box = a_box(rng, recorded, width=0.1)
        solver = StepSolver(recorded.chain, box, QPOptions(shortcut=False))  # type: ignore[arg-type]
        solver._solver = Boundless()
        answer = solver.answer(recorded.terms, np.zeros(18), 0.02, no_rows(18))
        assert not answer.braked
        assert ((answer.velocity >= box.lower) & (answer.velocity <= box.upper)).all()
        shares = answer.rate, answer.grasp_share, answer.path_share
        assert recorded.program.parting(Answer(answer.velocity, *shares, answer.off_path), recorded.terms) < 1e-5


def test_an_object_that_must_go_on_faster_than_its_cap_does_so_along_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no joint can be as slow as the cap asks, the least rate that they can follow is kept."""
    for recorded in steps(paper_lift(), monkeypatch, every=60):
        terms, n = replace(recorded.terms, rate_cap=0.3), recorded.chain.nv
        pieces = recorded.program.pieces(terms)
        base = pieces.fixed + pieces.grasp + pieces.path
        ends = base + 0.5 * pieces.along, base + 0.7 * pieces.along
        box = Box(np.minimum(*ends), np.maximum(*ends), np.zeros(n, dtype=bool), np.zeros(n))
        solver = StepSolver(recorded.chain, box, QPOptions())  # type: ignore[arg-type]
        answer = solver.answer(terms, np.zeros(n), 0.02, no_rows(n))
        assert answer.rate == pytest.approx(0.5, abs=1e-6)
        np.testing.assert_allclose(answer.velocity, ends[0], atol=1e-9)


def test_a_reset_forgets_what_was_solved_with_slack_too(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Where no answer keeps the chain both programs are solved; both solvers are as new afterwards."""
    recorded = next(steps(paper_lift(), monkeypatch))
    n, v = recorded.chain.nv, rng.normal(size=recorded.chain.nv)
    box = Box(v - 1e-3, v + 1e-3, np.zeros(n, dtype=bool), np.zeros(n))
    solver = StepSolver(recorded.chain, box, QPOptions(shortcut=False))  # type: ignore[arg-type]
    kept = [solver._solver, solver._slack_solver]
    assert solver.answer(recorded.terms, np.zeros(n), 0.02, no_rows(n)).chain > 0.1
    assert all(one._workspace is not None for one in kept)
    solver.reset()
    assert all(one._workspace is None for one in kept)


def test_rows_that_may_give_way_are_broken_by_the_least(rng: np.random.Generator) -> None:
    """Of the shares from ``low`` to 1 the first that breaks no row, else the one whose worst excess is least."""
    kinds = set()
    for _ in range(100):
        G, base, along = rng.normal(size=(3, 4)), rng.normal(size=4), rng.normal(size=4)
        low, middle = rng.uniform(0.0, 0.5), rng.normal(size=3)
        rows = Rows(G, middle - 1.0, middle + 1.0, np.ones(3, dtype=bool), np.zeros(3, dtype=int))
        shares = np.linspace(low, 1.0, 2001)
        values = G @ (base + shares[:, None] * along).T
        excess = np.maximum(values - rows.upper[:, None], rows.lower[:, None] - values).max(axis=0)
        share, broken = _least_broken(rows, base, along, low, 1.0)
        step = np.abs(G @ along).max() * (shares[1] - shares[0])
        assert low <= share <= 1.0
        if (excess <= 0.0).any():
            kinds.add("kept")
            assert broken == 0.0
            assert share == pytest.approx(shares[(excess <= 0.0).argmax()], abs=2.0 * (shares[1] - shares[0]))
        else:
            kinds.add("broken")
            assert broken == pytest.approx(excess.min(), abs=step)
    assert kinds == {"kept", "broken"}


def braking(task: Scenario, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Recorded, Array]]:
    """Steps of a motion, and joint velocities that follow the path at full rate."""
    seen = 0
    for recorded in steps(task, monkeypatch, every=20):
        chain, terms = recorded.chain, recorded.terms
        v = chain.joint_velocities(np.tile(terms.to_world @ terms.along, (chain.n_arms, 1)))
        if np.abs(v).max() > 0.1:
            seen += 1
            yield recorded, v
    assert seen > 3


def brake(recorded: Recorded, v: Array, lower: Array, upper: Array) -> StepAnswer:
    n = recorded.chain.nv
    box = Box(lower, upper, np.zeros(n, dtype=bool), np.zeros(n))
    solver = StepSolver(recorded.chain, box, QPOptions(solver=Raising(), shortcut=False))  # type: ignore[arg-type]
    answer = solver.answer(recorded.terms, v, 0.02, no_rows(n))
    assert answer.braked
    assert answer.grasp_share == answer.path_share == 0.0  # nothing is promised but to slow down
    assert ((answer.velocity >= lower) & (answer.velocity <= upper)).all()
    return answer


def test_arms_brake_along_the_path_where_a_rate_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for recorded, v in braking(paper_lift(), monkeypatch):
        width = 1e-6 + 0.1 * np.abs(v)
        answer = brake(recorded, v, 0.8 * v - width, 0.8 * v + width)
        assert 0.69 < answer.rate < 0.71
        pieces = recorded.pieces
        expected = pieces.fixed + pieces.grasp + answer.rate * pieces.along
        np.testing.assert_allclose(answer.velocity, expected, atol=1e-12)


@pytest.mark.parametrize("width", [0.04, 1.0])
def test_arms_slow_down_by_one_factor_where_no_motion_of_the_object_will_do(
    width: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One joint is sent back, against the motion of them all."""
    task = paper_lift()
    for recorded, v in braking(replace(task, cell=task.cell.with_limits(acceleration=2.0)), monkeypatch):
        back = int(np.abs(v).argmax())
        lower, upper = v - width, v + width
        lower[back], upper[back] = np.sort([-0.5 * v[back], -0.1 * v[back]])
        expected = v * (1.0 - 2.0 * 0.02 / np.abs(v).max())
        expected[back] = -0.1 * v[back]
        answer = brake(recorded, v, lower, upper)
        np.testing.assert_allclose(answer.velocity, np.clip(expected, lower, upper), atol=1e-12)
        assert (answer.rate, answer.grasp_share) == (0.0, 0.0)


def test_ratios_of_at_least_100_keep_the_ranks_apart() -> None:
    w = RankWeights()
    for upper, lower in itertools.pairwise((w.chain, w.recovery, w.off_path, w.grasp, w.path, w.rate, w.posture)):
        assert upper >= 99.9 * lower
    assert w.clearance == w.recovery
    assert w.posture >= 1e-14 * w.chain  # solvers manage no more
    assert 0.1 <= w.length <= 1.0


@pytest.mark.parametrize("name", RankWeights.__dataclass_fields__)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "much"])
def test_weights_must_be_positive(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"RankWeights: {name}"):
        RankWeights(**{name: value})
