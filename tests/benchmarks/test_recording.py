"""The benchmarks of long recordings, imports and bad numbers: their records are complete, whatever the machine."""

from __future__ import annotations

import json
from pathlib import Path

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
def test_every_import_is_recorded(tmp_path: Path) -> None:
    file = tmp_path / "importing.json"
    assert importing.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) in (0, 1)
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [r["what"] for r in records] == list(importing.CONTESTANTS)
    assert all(set(r) == set(importing.KEYS) for r in records)


@pytest.mark.slow
def test_steps_of_bad_numbers_are_recorded(tmp_path: Path) -> None:
    file = tmp_path / "bad_numbers.json"
    assert bad_numbers.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) in (0, 1)
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [r["numbers"] for r in records] == list(bad_numbers.TARGETS)
    assert all(set(r) == set(bad_numbers.KEYS) for r in records)
