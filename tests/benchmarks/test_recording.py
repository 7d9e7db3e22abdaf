"""The benchmarks of long recordings, imports and bad numbers: their records are complete, whatever the machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bad_numbers
import importing
import pytest
import recording


@pytest.mark.slow
def test_every_stage_is_recorded(tmp_path: Path) -> None:
    file = tmp_path / "recording.json"
    assert recording.main(["--quick", "--steps", "6000", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [r["stage"] for r in records] == list(recording.STAGES)
    assert all(set(r) == set(recording.KEYS) and r["good"] for r in records)
    assert (tmp_path / "out" / "recording.md").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("benchmark", "key", "all_of"),
    [(importing, "what", importing.CONTESTANTS), (bad_numbers, "numbers", bad_numbers.TARGETS)],
)
def test_every_case_is_recorded(benchmark: Any, key: str, all_of: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "records.json"
    assert benchmark.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) in (0, 1)
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [r[key] for r in records] == list(all_of)
    assert all(set(r) == set(benchmark.KEYS) for r in records)
