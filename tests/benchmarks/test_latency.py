"""benchmarks/latency.py and physics.py: small runs."""

from __future__ import annotations

import gc
import json
from pathlib import Path

import common  # noqa: F401
import latency
import pytest

#: Steps of every kind: they track, need a QP, pass a pole, and ask a user's constraint.
CASES = ("nominal", "qp", "pole", "own")
CONTRACT = {"case", "arms", "p50_us", "p99_us", "p999_us", "max_us", "gc_pause_ms"}


@pytest.mark.slow
def test_latency(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    plan = latency.Plan(steps=40, block=20, paced=40, laps=1, garbage_steps=4000, alive=1000)
    monkeypatch.setattr(latency, "QUICK", plan)
    file, out = tmp_path / "r.json", tmp_path / "out"
    assert latency.main(["--quick", "--cases", *CASES, "--json", str(file), "--out", str(out)]) == 0
    assert "settings: BLAS threads 1" in capsys.readouterr().out
    records = json.loads(file.read_text())
    assert all(set(r) >= CONTRACT for r in records)
    tails = [r for r in records if r["gc_pause_ms"] is None]
    names = {name.format(case) for case in CASES for name in ("{}", "null spin: {}", "1 kHz: {}", "lap: {}")}
    assert {r["case"] for r in tails} == names
    for r in tails:
        assert r["steps"] > 500 if r["case"].startswith("lap: ") else r["steps"] == 40
        assert (r["first_us"] is not None) is r["case"].startswith("lap: ")
        assert 0.0 < r["p50_us"] <= r["p99_us"] <= r["p999_us"] <= r["max_us"]
    pauses = {r["case"]: r for r in records if r["gc_pause_ms"] is not None}
    assert len(pauses) == 4
    for case, r in pauses.items():  # a step creates no garbage cycles
        assert r["unreachable"] == 0, case
        assert (r["collections"] > 0) is ("kept" in case)
    text = (out / "latency.md").read_text()
    assert "## Targets" in text
    assert "pole: longest step, by itself" in text
    assert "own: p50" in text
    figures = {r["case"]: r for r in latency.longest(records)}
    assert set(figures) == set(CASES)
    for case, r in figures.items():
        lap = next(x for x in tails if x["case"] == f"lap: {case}")
        assert (r["first_us"], r["longest_us"]) == (lap["first_us"], lap["max_us"])
    assert (out / "latency.png").stat().st_size > 10_000
    assert not gc.get_freeze_count()


def test_the_cases_are_what_they_say() -> None:
    """Cases are slowed or need a QP as their names say; the watched one reads forces."""
    for case in latency.CASES:
        loop = latency.Loop(case)
        slowed = solved = 0
        for _ in range(320):
            loop.step()
            slowed += loop.last.rate < 1.0
            solved += loop.last.solver.name != "none"
        assert (slowed > 100) is (case in ("slowed", "corner", "qp")), case
        assert (solved > 250) is (case == "qp"), case
        assert (loop.controller.options.supervision.stiffness is not None) is (case == "watched")


@pytest.mark.slow
def test_physics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import physics

    file, out = tmp_path / "r.json", tmp_path / "out"
    assert physics.main(["--quick", "--parts", "loop", "--json", str(file), "--out", str(out)]) == 0
    assert "## loop" in capsys.readouterr().out
    forces = {(r["controller"], r["N"]): r["delta_force_N"] for r in json.loads(file.read_text())}
    assert forces[physics.QP, 400] < 0.02 * forces[physics.PSEUDO_INVERSE, 400]
    assert forces[physics.QP, 40] < 0.05 * forces[physics.PSEUDO_INVERSE, 40]
    assert (out / "physics.md").is_file()
