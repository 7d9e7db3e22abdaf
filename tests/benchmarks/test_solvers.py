"""benchmarks/: the recorded QPs, all solvers on them, the profile of a step; with small counts."""

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

from coopqp.native import available_kernels
from coopqp.solvers import available_solvers, make_solver

CONTRACT = {
    *("solver", "mode", "form", "case", "arms", "p50_us", "p99_us", "p999_us", "max_us"),
    *("failures", "error_rad_s", "chain_mm"),
}


class TestRecorded:
    @pytest.mark.parametrize(
        "case", slow_unless(lambda case: case not in ("elbow", "near_singular"), recorded_qps.CASES)
    )
    def test_forms_agree(self, case: str) -> None:
        condensed, full = recorded_qps.record(case, 3, 3)
        assert len(condensed.qps) == len(full.qps) == 3
        assert condensed.qps[0].problem.sizes[0] < full.qps[0].problem.sizes[0]
        best = [compare_solvers.best_answers(one) for one in (condensed, full)]
        for a, b in zip(*best, strict=True):
            assert a is not None
            assert b is not None
            assert np.abs(a - b).max() < 1e-8

    def test_hard_cases_are_hard(self) -> None:
        for case in ("saturated", "corner", "outside"):
            one = recorded_qps.record(case, 3, 2)[0].qps[0]
            x = make_solver("daqp").solve(one.problem).x
            assert np.abs(x).max() > 1e-6, case  # the unconstrained optimum is the origin

    def test_chain_error(self) -> None:
        one = recorded_qps.record("nominal", 3, 1)[0].qps[0]
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
        files = recorded_qps.export(recorded, tmp_path, each=2)
        assert files[0].name == "cooperative_arms.py"
        compile(files[0].read_text(), "cooperative_arms.py", "exec")
        assert len(files) == 1 + 2 * 2
        first = {one.form: one.qps[0] for one in recorded}
        for form in recorded_qps.FORMS:
            (file,) = (tmp_path / "problems").glob(f"corner_3_{form}_0001.npz")
            with np.load(file) as stored:
                data = {key: stored.get(key) for key in ("P", "q", "G", "h", "A", "b", "lb", "ub")}
            # In the full form H is singular, and DAQP's proximal iterations may end early.
            how = {"condensed": ("daqp", {"primal_tol": 1e-10}), "full": ("proxqp", {"eps_abs": 1e-11, "eps_rel": 0.0})}
            backend, settings = how[form]
            x = qpsolvers.solve_problem(qpsolvers.Problem(**data), backend, **settings).x
            own = first[form]
            assert np.allclose(own.velocity(x), own.velocity(make_solver("daqp").solve(own.problem).x), atol=1e-8)


@pytest.mark.filterwarnings("ignore:The default value of raise_error:PendingDeprecationWarning")  # of qpsolvers
def test_compare_solvers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    plan = compare_solvers.Plan(recordings=(("saturated", 3, 3),), rounds=1, round_s=0.0)
    monkeypatch.setattr(compare_solvers, "QUICK", plan)
    file, out, exported = tmp_path / "r.json", tmp_path / "out", tmp_path / "set"
    argv = ["--quick", "--json", str(file), "--out", str(out), "--export", str(exported)]
    assert compare_solvers.main(argv) == 0
    assert "coopqp kernel:" in capsys.readouterr().out
    records = json.loads(file.read_text())
    assert all(set(r) >= CONTRACT for r in records)
    assert {r["solver"] for r in records} == set(available_solvers())
    assert {(r["mode"], r["form"]) for r in records} == {
        (m, f) for m in ("kept", "rebuilt") for f in ("condensed", "full")
    }
    for r in records:
        # H is singular in the full form, which these two do not take: failures are in the records.
        if r["solver"] in ("quadprog", "ldp") and r["form"] == "full":
            assert r["failures"] == r["solves"] > 0
            assert r["error_rad_s"] is None
            assert r["message"]
            continue
        assert r["failures"] == 0, r
        assert r["error_rad_s"] < (1e-9 if r["polish"] else 1e-2), r
        assert r["max_us"] >= r["p50_us"] > 0.0
    assert (out / "solvers.md").is_file()
    assert len(list((exported / "problems").glob("*.npz"))) == 6


def test_failures_without_an_answer_are_counted() -> None:
    recorded = recorded_qps.record("saturated", 3, 1)[0]
    broken = recorded.qps[0]
    broken.problem.u[:] = np.nan
    way = compare_solvers.Way(solver="daqp", mode="kept", start="warm", polish=True)
    run = compare_solvers.Run(way, recorded.qps, [None], 0.0)
    assert len(list(run.round())) == 1
    assert (run.solves, run.failures) == (1, 1)
    assert "u" in run.message


class TestProfile:
    def test_stopwatch_takes_out_what_is_inside(self) -> None:
        class Thing:
            def inner(self) -> int:
                return sum(range(20000))

            def outer(self) -> int:
                return self.inner()

        thing, watch = Thing(), step_profile.Stopwatch()
        watch.watch(thing, "inner", "in")
        watch.watch(thing, "outer", "out")
        thing.outer()
        watch.next_row()
        thing.inner()
        watch.next_row()
        assert set(watch.rows[0]) == {"in", "out"}
        assert watch.rows[0]["out"] < watch.rows[0]["in"]
        assert set(watch.rows[1]) == {"in"}

    def test_profile_leaves_the_definition_as_it_was(self) -> None:
        methods = [(owner, name, vars(owner)[name]) for owner, name, _ in step_profile.PARTS]
        records = step_profile.profile("nominal", step_profile.Plan(profiled=5))
        assert {r["samples"] for r in records} == {5}
        for owner, name, method in methods:
            assert vars(owner)[name] is method, (owner, name)

    @pytest.mark.slow
    def test_quick_run(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        plan = step_profile.Plan(arms=(3,), blocks=3, steps=20, profiled=30)
        monkeypatch.setattr(step_profile, "QUICK", plan)
        file, out = tmp_path / "r.json", tmp_path / "out"
        assert step_profile.main(["--quick", "--json", str(file), "--out", str(out)]) == 0
        records = json.loads(file.read_text())
        assert all(set(r) == set(step_profile.KEYS) for r in records)
        profiles = [r for r in records if r["what"] == "profile"]
        assert {r["case"] for r in profiles} == set(step_profile.PROFILED)
        used = {}
        for case in step_profile.PROFILED:
            shares = {r["part"]: r["share"] for r in profiles if r["case"] == case}
            assert sum(shares.values()) == pytest.approx(1.0, abs=0.01)
            used[case] = {part for part, share in shares.items() if share > 0.0}
            assert used[case] >= {"kinematics", "errors", "inverse", "box", "commit", "ControlStep"}
        assert {"QP", "solver"} <= used["qp"]
        assert not {"QP", "solver"} & used["nominal"]
        compared = [r for r in records if r["what"] != "profile"]
        wanted = set(step_profile.CASES) if "compiled" in available_kernels() else set()
        assert {r["case"] for r in compared} == wanted
        for r in compared:
            assert min(r["step_us"], r["core_us"], r["ratio"]) > 0.0
            assert r["met"] is (r["ratio"] <= step_profile.RATIO)
        assert f"≤ {step_profile.RATIO:g} × the core alone" in (out / "step_profile.md").read_text()

    @pytest.mark.skipif("compiled" not in available_kernels(), reason="compares the compiled core with itself")
    @pytest.mark.parametrize("case", step_profile.CASES)
    def test_core_alone_makes_the_same_steps(self, case: str) -> None:
        loop = step_profile.Loop(case, 2, 30, "compiled")
        ends = []
        for run in (loop.from_python, loop.core_alone):
            loop.block(run)
            ends.append(loop.controller.step().q)
        assert np.array_equal(*ends)
        assert np.abs(ends[0] - common.ring(arms=2).q_start).max() > 1e-5  # the arms have moved
