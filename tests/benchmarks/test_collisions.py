"""The benchmark of collisions: its parts make one file, whichever are run when."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import collisions
import pytest


def record(case: str, controller: str = "clearance", **more: Any) -> dict[str, Any]:
    return dict.fromkeys(collisions.KEYS) | {"case": case, "controller": controller} | more


def test_a_part_is_run_again_and_the_others_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"clearance_mm": 6.0, "margin_mm": 5.0, "chain_mm": 1e-5, "path_mm": 1e-5, "chain_slack": 0.0}
    post = record("random posts, 3 arms, 7", **found, finished=True, check="CERTIFIED", dense_mm=6.0)
    older = [record("skip: 12 jumps", status="old"), post, record("elbows", "pink hard"), record("elbows")]
    file = tmp_path / "collisions.json"
    file.write_text(json.dumps(older))
    monkeypatch.setattr(collisions, "QUICK", collisions.Plan(posts=1, jumps=50, rounds=1))
    given = ["--quick", "--case", "skip", "--json", str(file), "--out", str(tmp_path), "--workers", "1"]
    assert collisions.main(given) == 0
    records = json.loads(file.read_text())
    assert [collisions.part_of(r) for r in records] == ["known", "posts-3", "peers", "skip"]
    assert records[-1]["status"].startswith("0 violations")
    assert records[:-1] == [older[3], older[1], older[2]]
    text = (tmp_path / "collisions.md").read_text(encoding="utf-8")
    assert "1 random posts: 0 inside the margin, 0 with chain slack, 1 finished" in text
    assert "certifies 1 of 1" in text


def test_every_part_has_jobs_of_its_own() -> None:
    plan, parts = collisions.Plan(posts=3), collisions.PARTS
    counts = [len(collisions.jobs([part], plan)) for part in parts]
    assert counts == [4 * len(list(collisions.cases())), 8, 3, 3, 3, 3, 0, 0, 0]
    assert len(collisions.jobs(parts, plan)) == sum(counts)
