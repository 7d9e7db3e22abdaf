"""benchmarks/: the recorded QPs, all solvers on them, a step beside the core alone; with small counts."""

from __future__ import annotations

import json
from pathlib import Path

import common
import compare_solvers
import numpy as np
import pytest
import recorded_qps
import step_profile
from marks import slow_unless

from coopqp import QPController, QPOptions
from coopqp.solvers import available_solvers, make_solver

CONTRACT = {
    *("solver", "mode", "case", "arms", "p50_us", "p99_us", "p999_us", "max_us"),
    *("failures", "error_rad_s", "chain_mm"),
}


class TestRecorded:
    @pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
    @pytest.mark.parametrize(
        "case", slow_unless(lambda case: case not in ("elbow", "near_singular"), recorded_qps.CASES)
    )
    def test_their_answers_are_what_the_controller_commands(self, case: str) -> None:
        one = recorded_qps.record(case, 3, 3)
        assert len(one.qps) == 3
        task = recorded_qps.scenario_of(case, 3)
        options = QPOptions(shortcut=False)
        controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)
        controller.reset(task.q_start)
        commands = [controller.step().velocity for _ in range(one.qps[-1].step + 1)]
        for qp, best in zip(one.qps, compare_solvers.best_answers(one), strict=True):
            assert np.abs(best - commands[qp.step]).max() < 1e-9

    def test_hard_cases_are_hard(self) -> None:
        for case in ("saturated", "corner", "outside"):
            one = recorded_qps.record(case, 3, 2).qps[0]
            x = make_solver("daqp").solve(one.problem).x
            assert np.abs(x).max() > 1e-6, case  # the unconstrained optimum is the origin

    def test_chain_error(self) -> None:
        one = recorded_qps.record("nominal", 3, 1).qps[0]
        assert one.chain_mm(one.velocity(np.zeros(one.B.shape[1])) * 0.0) == 0.0
        common_motion = one.B[:, 0] / np.linalg.norm(one.B[:, 0])  # off the path, all arms alike
        assert one.chain_mm(common_motion) < 1e-9
        alone = common_motion.copy()
        alone[:6] = 0.0
        twist = one.jacobians[1] @ alone
        assert one.chain_mm(alone) == pytest.approx(1e3 * one.dt * np.linalg.norm(twist[:3]), rel=1e-9)

    def test_export(self, tmp_path: Path) -> None:
        import qpsolvers

        recorded = recorded_qps.record("corner", 3, 4)
        files = recorded_qps.export([recorded], tmp_path, each=2)
        assert files[0].name == "cooperative_arms.py"
        compile(files[0].read_text(), "cooperative_arms.py", "exec")
        assert len(files) == 1 + 2
        (file,) = (tmp_path / "problems").glob("corner_3_0001.npz")
        with np.load(file) as stored:
            data = {key: stored.get(key) for key in ("P", "q", "G", "h", "A", "b", "lb", "ub")}
        x = qpsolvers.solve_problem(qpsolvers.Problem(**data), "daqp", primal_tol=1e-10).x
        own = recorded.qps[0]
        assert np.allclose(own.velocity(x), own.velocity(make_solver("daqp").solve(own.problem).x), atol=1e-8)


@pytest.mark.filterwarnings("ignore:The default value of raise_error:PendingDeprecationWarning")  # of qpsolvers
def test_compare_solvers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    plan = compare_solvers.Plan(recordings=(("saturated", 3, 3),), rounds=1, round_s=0.0)
    monkeypatch.setattr(compare_solvers, "QUICK", plan)
    file, out, exported = tmp_path / "r.json", tmp_path / "out", tmp_path / "set"
    argv = ["--quick", "--json", str(file), "--out", str(out), "--export", str(exported)]
    assert compare_solvers.main(argv) == 0
    assert "clock CPU time of the thread" in capsys.readouterr().out
    records = json.loads(file.read_text())
    assert all(set(r) >= CONTRACT for r in records)
    assert {r["solver"] for r in records} == set(available_solvers())
    assert {r["mode"] for r in records} == {"kept", "rebuilt"}
    for r in records:
        assert r["failures"] == 0, r
        rough = r["mode"] == "rebuilt" and r["solver"] in ("proxqp", "osqp")
        assert r["error_rad_s"] < (1e-2 if rough else 1e-7 if r["solver"] == "proxqp" else 1e-9), r
        assert r["max_us"] >= r["p50_us"] > 0.0
    assert (out / "solvers.md").is_file()
    assert len(list((exported / "problems").glob("*.npz"))) == 3


def test_failures_without_an_answer_are_counted() -> None:
    recorded = recorded_qps.record("saturated", 3, 1)
    broken = recorded.qps[0]
    broken.problem.u[:] = np.nan
    way = compare_solvers.Way(solver="ldp", mode="kept", start="warm")
    run = compare_solvers.Run(way, recorded.qps, [None], 0.0)
    assert len(list(run.round())) == 1
    assert (run.solves, run.failures) == (1, 1)
    assert "u" in run.message


class TestProfile:
    @pytest.mark.slow
    def test_quick_run(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        plan = step_profile.Plan(arms=(3,), blocks=3, steps=20)
        monkeypatch.setattr(step_profile, "QUICK", plan)
        file, out = tmp_path / "r.json", tmp_path / "out"
        assert step_profile.main(["--quick", "--json", str(file), "--out", str(out)]) == 0
        records = json.loads(file.read_text())
        assert all(set(r) == set(step_profile.KEYS) for r in records)
        assert {r["case"] for r in records} == set(step_profile.CASES)
        for r in records:
            assert min(r["step_us"], r["core_us"], r["ratio"]) > 0.0
            assert r["met"] is (r["ratio"] <= step_profile.RATIO)
        assert f"≤ {step_profile.RATIO:g} × the core alone" in (out / "step_profile.md").read_text()

    @pytest.mark.parametrize("case", step_profile.CASES)
    def test_core_alone_makes_the_same_steps(self, case: str) -> None:
        loop = step_profile.Loop(case, 2, 30)
        ends = []
        for run in (loop.from_python, loop.core_alone):
            loop.block(run)
            ends.append(loop.controller.step().q)
        assert np.array_equal(*ends)
        assert np.abs(ends[0] - common.ring(arms=2).q_start).max() > 1e-5  # the arms have moved
