"""The benchmark of what stands before the motion: its records are complete, whatever the machine."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import planning


@pytest.mark.slow
def test_every_case_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "QUICK", planning.Plan(poses=20, alone=5, rounds=1, rings=(2,)))
    file = tmp_path / "planning.json"
    assert planning.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert all(set(r) == set(planning.KEYS) for r in records)
    checks = {r["case"]: r["verdict"] for r in records if r["case"].startswith("check: ")}
    others = [r for r in records if r["case"] not in checks]
    assert {r["case"] for r in others} == {"batch", "starts"}
    assert all(r["found"] for r in others), "every pose is reached, every cell has a start"
    assert {r["method"] for r in others} == {"kept chain", "find_start", *planning.batch_kernels()}
    assert checks["check: paper_lift"] == checks["check: ring of 2"] == "certified"
    assert (tmp_path / "out" / "planning.md").is_file()
