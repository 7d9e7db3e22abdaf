"""The benchmark of the control loop: a record for each figure, what is left out by name, and the exit code of all."""

from __future__ import annotations

import json
from pathlib import Path

import drive
import drive_cases
import drive_peers
import pytest
from drive_runs import SENT, Row


def test_a_figure_holds_up_to_its_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [Row("one", 1.0, 1.0, "mm"), Row("two", 1.5, 1.0, "s"), Row("three", float("nan"), 1.0, "N")]
    monkeypatch.setattr(drive_cases, "QUICK", (lambda: iter(rows[:1]),))
    file = tmp_path / "drive.json"
    given = ["--quick", "--json", str(file), "--out", str(tmp_path / "out")]
    assert drive.main(given) == 0
    monkeypatch.setattr(drive_cases, "QUICK", (lambda: iter(rows[:1]), lambda: iter(rows[1:])))
    assert drive.main(given) == 1
    records = json.loads(file.read_text(encoding="utf-8"))
    assert all(tuple(record) == ("case", "value", "bound", "unit", "holds") for record in records)
    assert [record["holds"] for record in records] == [True, False, False]
    said = capsys.readouterr().out
    assert said.count("BROKEN") == 2
    assert said.count("left out:") == 2 * len(drive.ELSEWHERE + drive_cases.LONGER + drive_peers.PEERS)


def test_what_lacks_its_peer_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(drive_peers, "ROS", "")
    monkeypatch.setattr(drive_peers, "PEERS", (drive_peers.echo, drive_peers.minutes))
    monkeypatch.setattr(drive_cases, "QUICK", ())
    monkeypatch.setattr(drive_cases, "LONGER", ())
    assert drive.main([]) == 0
    assert capsys.readouterr().out.count(drive_peers.NEEDS_ROS) == 2


def test_hostile_rates_keep_the_limits() -> None:
    SENT.append((1.0, 1.0))
    assert all(row.value <= row.bound for row in drive_cases.hostile(runs=3))
