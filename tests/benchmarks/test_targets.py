"""The benchmark of targets that move: its records are complete, whatever the machine."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import target_cases
import targets


@pytest.mark.slow
def test_every_case_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target_cases, "SECONDS", 0.6)
    monkeypatch.setattr(target_cases, "STEPS_PER_S", {100: 200, 1000: 1000})
    monkeypatch.setattr(targets, "TIMED", targets.ROUND)
    file = tmp_path / "targets.json"
    assert targets.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert all(set(r) == set(targets.KEYS) for r in records)
    runs, costs = ([r for r in records if (r["retarget_us"] is None) is timed] for timed in (True, False))
    assert len(costs) == 4
    assert {(r["targets"], r["acceleration"], r["hertz"]) for r in runs} == {
        (kind, limit, hertz) for kind in ("in reach", "out of reach") for limit in (5.0, None) for hertz in (100, 1000)
    }
    assert max(max(r["chain_mm"], r["off_path_mm"]) for r in runs) < 0.01
    assert sum(r["flips"] + r["nameless"] for r in runs) == 0
    assert (tmp_path / "out" / "targets.md").is_file()


def test_a_swing_is_the_way_within_blocked_steps() -> None:
    positions = np.zeros((60, 3))
    positions[30:, 0], positions[50, 1] = 1.0, 3.0
    blocked = np.zeros(60, dtype=bool)
    assert target_cases.swing(positions, blocked) == 0.0
    blocked[5:55] = True
    assert target_cases.swing(positions, blocked) == 3.0
    blocked[31] = False
    assert target_cases.swing(positions, blocked) == 3.0
    blocked[50] = False
    assert target_cases.swing(positions, blocked) == 1.0
