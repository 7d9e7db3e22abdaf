"""The benchmark of sweeps: its records are complete, whatever the machine."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import sweeps


@pytest.mark.slow
def test_every_case_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = sweeps.Plan(loky=(20, 60), dask=(4, 10), scaling=(2, 6), rounds=1)
    monkeypatch.setattr(sweeps, "QUICK", small)
    monkeypatch.setattr(sweeps, "clustered", lambda *_: [])  # test_studies starts a cluster
    file = tmp_path / "sweeps.json"
    assert sweeps.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [tuple(r) for r in records] == [sweeps.KEYS] * 3
    assert all(math.isfinite(r["ratio"]) for r in records)  # so few rows cost less than a tick of the system's clock
    assert (tmp_path / "out" / "sweeps.md").is_file()
