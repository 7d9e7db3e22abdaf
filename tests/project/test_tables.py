"""The measured tables of docs/measured.md and of the reliability page come from records, and only from there."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from tables import ROOT, TABLES, figure, main, replaced

BEHAVIOUR = [
    {"case": case, "controller": controller, "chain_mm": chain, "chain_final_mm": 0.1 * chain, "path_mm": 0.5}
    for case in ("fast", "limit", "mismatch")
    for controller, chains in (("independent", (12.0, 345.0)), ("cooperative", (1e-4, 2e-4)))
    for chain in chains
]
PEERS = [
    {
        "peer": "coopqp", "case": case, "arms": arms, "mode": "compiled", "pacing": pacing, "p50_us": 1.5 * arms,
        "p99_us": 40.0, "placo_p50_us": 75.0, "ratio_placo": 0.02 * arms,
    }
    for case in ("nominal", "measured") for arms in (3, 8, 16) for pacing in ("hot", "1 kHz")
]  # fmt: skip


PROMISES = [
    {"group": "chain", "case": f"100 random cells, steps of {ms} ms: apart", "value": 0.012 * ms, "bound": 20.0}
    for ms in (5, 20)
] + [{"group": "forces", "case": "lifts", "value": 1.0, "bound": 2.0}]


def test_tables_are_the_worst_of_their_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "docs").mkdir()
    shutil.copyfile(ROOT / "docs/measured.md", tmp_path / "docs/measured.md")
    before = (tmp_path / "docs/measured.md").read_text(encoding="utf-8")
    shutil.copyfile(ROOT / "docs/reliability.md", tmp_path / "docs/reliability.md")
    assert main([str(tmp_path), "--into", str(tmp_path)]) == 0  # no records: nothing changes
    assert (tmp_path / "docs/measured.md").read_text(encoding="utf-8") == before
    (tmp_path / "behaviour.json").write_text(json.dumps(BEHAVIOUR), encoding="utf-8")
    (tmp_path / "compare_peers.json").write_text(json.dumps(PEERS), encoding="utf-8")
    (tmp_path / "promises.json").write_text(json.dumps(PROMISES), encoding="utf-8")
    assert main([str(tmp_path), "--into", str(tmp_path)]) == 0
    assert capsys.readouterr().out.count("written") == len(TABLES)
    text = (tmp_path / "docs/measured.md").read_text(encoding="utf-8")
    assert "| object at 0.6 m/s, joints limited to 1 rad/s; also to 5 rad/s² | 345 | 2e-4 | 0.5 |" in text
    assert "error at the end | 34 | 2e-5 | |" in text
    assert "| 16 | 24 | 40 | 75 | 0.32 |" in text
    page = (tmp_path / "docs/reliability.md").read_text(encoding="utf-8")
    assert "| 5 | 0.06 | 20 |\n| 20 | 0.24 | 20 |\n<!--" in page
    assert main([str(tmp_path), "--into", str(tmp_path)]) == 0  # once more: the same
    assert (tmp_path / "docs/measured.md").read_text(encoding="utf-8") == text


def test_a_table_without_its_marks_is_an_error() -> None:
    with pytest.raises(ValueError, match="measured: period -->"):
        replaced("no marks", "period", "table")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.4e-4, "1.4e-4"), (9.96e-5, "1e-4"), (0.0123, "0.012"), (9.7, "9.7"), (99.4, "99"), (412.3, "412")],
)
def test_figures_are_short(value: float, text: str) -> None:
    assert figure(value) == text
