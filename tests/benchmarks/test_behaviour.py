"""The targets of benchmarks/behaviour.py: the cooperative QP meets them, and the benchmark detects violations.

Also tests the QP with independent arms, which serves as a comparison.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import behaviour
import numpy as np
import pytest
from marks import slow_but_first
from places import BENCHMARKS
from runs import drive

from coopqp import BindingLimit, ControlStep, InvalidInputError, LimitKind, Status
from coopqp.baselines import IndependentQPController, IndependentQPOptions
from coopqp.errors import UnknownNameError
from coopqp.scenarios import (
    Scenario,
    at_limit,
    at_singularity,
    dual_arm7,
    fast_lift,
    five_joint_pair,
    mixed_cell,
    paper_lift,
)
from coopqp.simulation import chain_error, limit_excess, path_error, tool_placements
from coopqp.simulation.evaluation.metrics import chain_errors, errors_from, object_poses, tool_matrices
from coopqp.solvers import QpProblem, QpSolution, SolverStatus

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"
#: Keys and types of every flat record.
CONTRACT = {
    "case", "controller", "solver", "chain_mm", "chain_deg", "path_mm", "path_deg", "failures", "finished", "rate_min",
    "limit_excess",
}  # fmt: skip


def all_met(case: str, keys: Any, solver: str = "daqp") -> list[dict[str, Any]]:
    records = [behaviour.run_one(case, key, "cooperative", solver) for key in keys]
    missed = {r["variant"]: r["missed"] for r in records if r["missed"]}
    assert not missed
    return records


# -- the figures -------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("case", slow_but_first(["fast", "mismatch", "paper", "redundant", "mixed", "ring"]))
def test_the_cooperative_qp_meets_its_figures(case: str) -> None:
    assert all_met(case, behaviour.keys_of(case, quick=False))


@pytest.mark.slow
@pytest.mark.parametrize("tenth", range(5))
def test_it_stops_at_limits_in_every_direction(tenth: int) -> None:
    keys = behaviour.keys_of("limit", quick=False)
    assert len(keys) >= 50
    for record in all_met("limit", keys[tenth::5]):
        assert record["named"]
        assert record["blocked_joint"]


@pytest.mark.slow
@pytest.mark.parametrize("arm", [0, 1, 2])
def test_it_enters_dwells_in_and_leaves_singularities(arm: int) -> None:
    keys = [key for key in behaviour.keys_of("singular", quick=False) if key[1] == arm]
    assert {key[0] for key in keys} == {"wrist", "elbow", "reach"}
    assert {key[2] for key in keys} == {np.inf, 5.0}
    all_met("singular", keys)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_it_comes_back_from_outside_a_limit() -> None:
    """Tests some runs; tests/reliability/test_outside.py tests every joint."""
    assert len(behaviour.keys_of("outside", quick=False)) == 72
    all_met("outside", behaviour.keys_of("outside", quick=not NIGHTLY))


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["proxqp", "osqp"])
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_other_solvers_behave_the_same(solver: str) -> None:
    all_met("fast", [(np.inf, False)], solver)
    all_met("outside", [(4, "lower", np.inf), (9, "upper", 5.0)], solver)
    all_met("singular", [("elbow", 1, 5.0, 0.0)], solver)
    all_met("limit", [(3,)], solver)


@pytest.mark.slow
def test_the_others_show_what_it_is_for() -> None:
    """The baseline breaks limits and independent arms pull the object apart. The cooperative QP does neither."""
    key = (np.inf, True)
    baseline = behaviour.run_one("fast", key, "pseudo_inverse", "none")
    alone = behaviour.run_one("fast", key, "independent", "daqp")
    assert baseline["limit_excess"] > 1.0
    assert baseline["chain_mm"] > 1.0
    assert alone["limit_excess"] == 0.0
    assert alone["chain_mm"] > 5.0
    assert baseline["missed"] == alone["missed"] == ""  # only the cooperative QP has targets
    at_a_limit = behaviour.run_one("limit", (0,), "independent", "daqp")
    assert at_a_limit["chain_mm"] > 5.0
    assert at_a_limit["limit_excess"] < 1e-9


# -- the benchmark itself ----------------------------------------------------------------------------------------------


def recorded(case: str, key: Any) -> tuple[Any, list[ControlStep]]:
    run = behaviour.build(case, key)
    return run, behaviour.drive(run, behaviour.make_controller(run, "cooperative", "daqp"))


def test_the_judge_sees_what_goes_wrong() -> None:
    """Each defect added to a good run shows in its figure and as a missed target."""
    run, steps = recorded("fast", (np.inf, True))
    assert not behaviour.missed_targets(run, behaviour.judge(run, steps))

    def broken(number: int, **changes: Any) -> Any:
        bad = [*steps[:number], steps[number].replaced(**changes), *steps[number + 1 :]]
        record = behaviour.judge(run, bad)
        return record, " ".join(behaviour.missed_targets(run, record))

    q = steps[50].q_next.copy()
    q[7] += 1e-5
    record, missed = broken(50, q_next=q)
    assert record["chain_mm"] > 1e-3
    assert "chain_mm" in missed
    assert "path_mm" in missed
    v = steps[60].velocity.copy()
    v[3] = -1.0 - 1e-8
    record, missed = broken(60, velocity=v)
    assert record["limit_excess"] == pytest.approx(1e-8, rel=1e-3)
    assert "limit_excess" in missed
    v[3] = np.nan
    assert broken(60, velocity=v)[0]["failures"] == 1
    assert "failures" in broken(70, status=Status.HOLDING)[1]
    assert "path_mm" in broken(80, clock_next=steps[80].clock_next + 1e-4)[1]
    unfinished = behaviour.judge(run, steps[:-1])
    assert "finished" in " ".join(behaviour.missed_targets(run, unfinished))


def test_the_judges_figures_are_those_of_the_metrics() -> None:
    run, steps = recorded("singular", ("elbow", 1, np.inf, 0.0))
    record, task = behaviour.judge(run, steps), run.task
    tools = tool_placements(task.cell, [steps[0].q, *(s.q_next for s in steps)])
    chain = np.array([chain_error(T, task.grasp) for T in tools])
    path = [path_error(T, task.grasp, s.path, s.clock_next) for T, s in zip(tools[1:], steps, strict=True)]
    figures = [record[name] for name in ("chain_mm", "chain_final_mm", "path_mm")]
    assert figures == pytest.approx([1e3 * x for x in (chain[:, 0].max(), chain[-1, 0], max(path)[0])], abs=1e-11)
    angles = [record["chain_deg"], record["path_deg"]]
    assert angles == pytest.approx(np.rad2deg([chain[:, 1].max(), max(p[1] for p in path)]), abs=1e-9)


def test_the_judge_knows_the_right_joint() -> None:
    run, steps = recorded("limit", (0,))
    assert behaviour.judge(run, steps)["named"] is True
    wrong = BindingLimit("slave_2", "joint_6", LimitKind.POSITION)
    assert behaviour.judge(run, [*steps[:-1], steps[-1].replaced(binding=(wrong,))])["named"] is False
    assert behaviour.judge(run, [*steps[:-1], steps[-1].replaced(binding=())])["named"] is False
    assert behaviour.judge(run, [*steps[:-1], steps[-1].replaced(status=Status.SLOWED)])["named"] is False
    # The object moves as far as possible: the clock stops at the oracle's limit, within a step of the oracle.
    assert steps[-1].clock_next == pytest.approx(run.expected[2], abs=2e-4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_the_judge_of_joints_outside() -> None:
    run, steps = recorded("outside", (1, "upper", np.inf))
    record = behaviour.judge(run, steps)
    assert record["recovery_ratio"] <= 1.35
    assert record["limit_excess"] == 0.0
    q = steps[1].q_next.copy()
    q[1] += 0.01
    bad = [steps[0], steps[1].replaced(q_next=q), *steps[2:]]
    assert behaviour.judge(run, bad)["limit_excess"] > 0.005  # it moved further out
    never = behaviour.judge(run, [s.replaced(q_next=steps[0].q) for s in steps])
    assert never["recovery_ratio"] == np.inf
    assert "recovery_ratio" in " ".join(behaviour.missed_targets(run, never))


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_a_mismatch_must_not_grow() -> None:
    run, steps = recorded("mismatch", (np.inf,))
    record = behaviour.judge(run, steps)
    assert record["chain_mm"] == pytest.approx(5.0, abs=0.01)  # the initial error
    assert record["chain_final_mm"] < 1e-3
    assert record["chain_rise_mm"] < 1e-4
    back_and_forth = [*steps[:40], *steps[:40]]
    assert "chain_rise_mm" in " ".join(behaviour.missed_targets(run, behaviour.judge(run, back_and_forth)))


@pytest.mark.slow
def test_quick_runs_are_a_part_of_full_runs() -> None:
    for case in behaviour.CASES:
        assert set(behaviour.keys_of(case, quick=True)) <= set(behaviour.keys_of(case, quick=False)), case
    quick = behaviour.plan(behaviour.CASES, quick=True, solvers=("daqp", "proxqp", "osqp"))
    assert {job[0] for job in quick} == set(behaviour.CASES)
    for case in behaviour.CASES:
        assert {job[2] for job in quick if job[0] == case} == set(behaviour.CONTROLLERS)
        assert {job[3] for job in quick if job[0] == case and job[2] == "cooperative"} == {"daqp", "proxqp", "osqp"}


@pytest.mark.slow
def test_the_command_line(tmp_path: Path) -> None:
    command = [
        sys.executable,
        str(BENCHMARKS / "behaviour.py"),
        "--quick",
        "--cases",
        "fast",
        "paper",
        "--workers",
        "1",
    ]
    files = ["--json", str(tmp_path / "records.json"), "--out", str(tmp_path / "out")]
    done = subprocess.run([*command, *files], capture_output=True, text=True, timeout=120, check=True)
    records = json.loads((tmp_path / "records.json").read_text())
    assert all(set(r) >= CONTRACT and all(not isinstance(x, (dict, list)) for x in r.values()) for r in records)
    assert {r["case"] for r in records} == {"fast", "paper"}
    assert {r["controller"] for r in records} == {"pseudo_inverse", "independent", "cooperative"}
    assert {r["solver"] for r in records if r["controller"] == "pseudo_inverse"} == {"none"}
    for text in ("processor", "python", "versions", "daqp", "| fast |", "met its targets in"):
        assert text in done.stdout
    assert "Traceback" not in done.stderr
    assert json.loads((tmp_path / "out" / "machine.json").read_text())["benchmark"] == "behaviour"
    assert "| fast |" in (tmp_path / "out" / "behaviour.md").read_text()


# -- the QP with independent arms --------------------------------------------------------------------------------------


def alone(task: Scenario, *, steps: int = 300, dt: float | None = None, **options: Any) -> list[ControlStep]:
    made = IndependentQPOptions(**options)
    controller = IndependentQPController(task.cell, task.grasp, task.path, dt=dt or task.dt, options=made)
    controller.reset(task.q_start)
    return drive(controller, steps)


def errors_of(task: Scenario, steps: list[ControlStep]) -> tuple[float, float]:
    tools = tool_matrices(task.cell, np.array([s.q_next for s in steps]))
    poses = np.array([task.path.pose(s.clock_next).homogeneous for s in steps])
    away = errors_from(object_poses(tools, task.grasp), poses)[0]
    return float(chain_errors(tools, task.grasp)[0].max()), float(away.max())


@pytest.mark.slow
@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell, five_joint_pair])
def test_independent_arms_follow_an_easy_path(make: Any) -> None:
    task = make()
    steps = alone(task, dt=0.005, steps=1000)
    chain, path = errors_of(task, steps)
    assert steps[-1].finished
    assert max(chain, path) < 1e-5
    assert all(s.status is Status.TRACKING and not s.binding for s in steps)


@pytest.mark.slow
@pytest.mark.parametrize("make", [fast_lift, at_limit, at_singularity])
def test_independent_arms_keep_their_limits_and_tear_the_object(make: Any) -> None:
    task = at_singularity("elbow", 1, acceleration=5.0) if make is at_singularity else make()
    steps = alone(task, dt=0.002, steps=1000)
    assert limit_excess(task.cell, [s.q_next for s in steps], [s.velocity for s in steps]) < 1e-9
    v = np.array([np.zeros(18), *(s.velocity for s in steps)])
    assert (np.abs(np.diff(v, axis=0)) / (0.002 * task.cell.limits.acceleration)).max() < 1.0 + 1e-6
    assert errors_of(task, steps)[0] > 1e-3
    assert steps[-1].clock_next == pytest.approx(min(0.002 * len(steps), task.path.duration))  # no slower
    torn = next(s for s in steps if s.given_up.chain > 1e-3)
    assert torn.binding or make is at_singularity
    assert "the arms part at" in torn.explain()


@pytest.mark.slow
def test_solvers_of_independent_arms_agree() -> None:
    task = fast_lift()
    reference = alone(task, steps=100)
    for solver in ("proxqp", "osqp"):
        for a, b in zip(reference, alone(task, steps=100, solver=solver), strict=True):
            assert np.abs(a.velocity - b.velocity).max() < 1e-4


@pytest.mark.slow
def test_damping_bounds_the_joints_at_a_singularity() -> None:
    """A stretched elbow without limits: with and without damping."""
    task = at_singularity("elbow", 0)
    free = replace(task, cell=task.cell.with_limits(velocity=np.inf, lower=-np.inf, upper=np.inf))
    fastest = {d: max(np.abs(s.velocity).max() for s in alone(free, steps=900, damping=d)) for d in (0.0, 0.05)}
    assert fastest[0.05] < 0.5 * fastest[0.0]


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_independent_arms_come_back_from_outside(acceleration: float) -> None:
    task = paper_lift()
    upper = task.cell.limits.upper.copy()
    upper[8] = task.q_start[8] - 0.01
    task = replace(task, cell=task.cell.with_limits(upper=upper, velocity=1.0, acceleration=acceleration))
    x = np.array([s.q_next[8] for s in alone(task, dt=0.002, steps=100)])
    assert np.all(np.diff(x[x > upper[8]]) <= 1e-12)
    assert x[60:].max() <= upper[8] + 1e-9


def test_a_failed_qp_brakes(monkeypatch: pytest.MonkeyPatch) -> None:
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(acceleration=5.0))
    controller = IndependentQPController(task.cell, task.grasp, task.path, dt=0.002)
    controller.reset(task.q_start)
    for _ in range(100):
        step = controller.step()
    moving, clock = step.velocity, step.clock_next
    solver = controller._solvers[1]
    solve = solver.solve

    def fail(problem: QpProblem) -> QpSolution:
        return replace(solve(problem), status=SolverStatus.MAX_ITERATIONS, x=np.full(problem.g.size, np.nan))

    monkeypatch.setattr(solver, "solve", fail)
    for _ in range(200):
        step = controller.step()
        assert step.status is Status.HOLDING
        assert "slave_1" in step.reason
        assert step.clock_next == clock
        assert np.all(np.abs(step.velocity - moving) <= 5.0 * 0.002 + 1e-12)
        moving = step.velocity
    assert np.all(moving == 0.0)
    monkeypatch.setattr(solver, "solve", solve)
    assert controller.step().status is Status.TRACKING


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf, "soon"])
def test_a_step_of_no_length_holds(dt: Any) -> None:
    task = paper_lift()
    controller = IndependentQPController(task.cell, task.grasp, task.path, dt=0.002)
    with pytest.raises(InvalidInputError, match="step before reset"):
        controller.step()
    controller.reset(task.q_start)
    step = controller.step(dt=dt)
    assert step.status is Status.HOLDING
    assert "step: dt" in step.reason
    assert np.all(step.velocity == 0.0)
    assert controller.step(dt=0.001).status is Status.TRACKING


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"gain": -1.0}, InvalidInputError),
        ({"damping": np.nan}, InvalidInputError),
        ({"damping_from": 0.0}, InvalidInputError),
        ({"correction_speed": 0.0}, InvalidInputError),
        ({"length": "short"}, InvalidInputError),
        ({"solver": "simplex"}, UnknownNameError),
    ],
)
def test_bad_options_of_independent_arms(options: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        alone(paper_lift(), **options)
