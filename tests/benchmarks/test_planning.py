"""The benchmark of what stands before the motion: its records are complete, whatever the machine."""

from __future__ import annotations

import json
from pathlib import Path

import planning
import pytest


@pytest.mark.slow
def test_every_case_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "QUICK", planning.Plan(poses=20, alone=5, rounds=1, rings=(2,), paths=1))
    file = tmp_path / "planning.json"
    assert planning.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert all(set(r) == set(planning.KEYS) for r in records)
    assert {r["case"].partition(":")[0] for r in records} == {"batch", "start", "check", "path", "timing"}
    checks = {r["case"]: r["verdict"] for r in records if r["case"].startswith("check: ")}
    assert checks["check: paper_lift"] == checks["check: ring of 2"] == "CERTIFIED"
    others = [r for r in records if r["case"] not in checks]
    verdicts = {r["verdict"].partition(",")[0] for r in others}
    assert verdicts == {"all reached", "found", "finished", "planned"}, "every pose, every start, every end is reached"
    paths = {"planned", "reactive linear", "reactive quintic"}
    assert {r["method"] for r in others} == {"kept chain", "find_start", *paths, "core"}
    (mine,) = (r for r in records if r["case"].startswith("path") and r["method"] == "planned")
    assert mine["tracking_share"] == 1.0
    assert mine["ratio"] <= 1.03
    assert max(mine["chain_mm"], mine["path_mm"]) <= 1e-3
    assert (tmp_path / "out" / "planning.md").is_file()
