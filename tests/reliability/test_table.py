"""The table of the catalogue: a missed target fails, and the page shows the measured figures."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from catalogue import FAR


@pytest.fixture(name="table")
def _table() -> Any:
    spec = importlib.util.spec_from_file_location("table", Path(__file__).with_name("table.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_missed_target_fails(catalogue: Any) -> None:
    fresh = type(catalogue)()
    fresh.row("A1", "met", cases=3, measured=1.0, target=1.0)
    with pytest.raises(AssertionError, match=r"A1 missed: 1\.1 mm, target 1"):
        fresh.row("A1", "missed", cases=3, measured=1.1, target=1.0, unit="mm")
    with pytest.raises(AssertionError, match="nothing was tried"):
        fresh.row("A1", "empty", cases=0, measured=0.0, target=1.0)
    with pytest.raises(AssertionError, match="nan"):
        fresh.row("A1", "not a number", cases=1, measured=float("nan"), target=1.0)
    assert len(fresh.rows) == 4


def test_the_page_shows_what_was_measured(tmp_path: Path, table: Any, count: Callable[[int], int]) -> None:
    page, source = tmp_path / "page.md", tmp_path / "rows.json"
    page.write_text(f"Head.\n{table.BEGIN}\nold\n{table.END}\nTail.\n", encoding="utf-8")
    line = {"row": "A1", "test": "t", "cases": 1000, "measured": 2.0, "target": 1.0, "unit": "mm", "note": "why"}
    source.write_text(json.dumps([line]), encoding="utf-8")
    table.main(str(source), str(page))
    text = page.read_text(encoding="utf-8")
    assert "| A1 | t | 1,000 | 2 mm | 1 mm | missed. why |" in text
    assert "old" not in text
    assert text.startswith("Head.")
    assert text.endswith("Tail.\n")
    assert count(7) in (7, 70)


def test_parts_are_one_line_and_texts_that_many_lines_have_stand_below(table: Any) -> None:
    line = {"row": "A1", "cases": 2, "target": 3.0, "unit": "", "note": "why"}
    parts = [{**line, "test": f"t, {i} of 3: x", "measured": float(i)} for i in (1, 3, 2)]
    others = [{**line, "test": name, "measured": 1.0} for name in "uv"]
    body, _, below = table.table([*parts, *others]).partition("\n\n")
    assert body.splitlines()[2:] == [
        f"| A1 | {test} | see 1 |" for test in ("t: x | 6 | 3 | 3", "u | 2 | 1 | 3", "v | 2 | 1 | 3")
    ]
    assert below == "1. why"


@pytest.mark.slow
def test_lines_of_every_worker_arrive(tmp_path: Path) -> None:
    """Also the line of a test that misses its target, whichever process ran it."""
    (tmp_path / "test_lines.py").write_text(
        "import os\n"
        "import pytest\n"
        "@pytest.mark.parametrize('i', range(8))\n"
        "def test_a_line(i, catalogue):\n"
        "    catalogue.row('A1', f'line {i}', cases=1, measured=i, target=6, note=os.environ['PYTEST_XDIST_WORKER'])\n",
        encoding="utf-8",
    )
    file = tmp_path / "rows.json"
    options = ["-p", "catalogue", "-n", "2", "--dist", "load", "--reliability-json", str(file), str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-c", os.devnull, "--rootdir", str(tmp_path), *options],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )
    assert "7 passed" in done.stdout, done.stdout + done.stderr
    assert "reliability: 8 cases in 8 lines" in done.stdout
    rows = json.loads(file.read_text(encoding="utf-8"))
    assert [r["test"] for r in rows] == [f"line {i}" for i in range(8)]
    assert {r["note"] for r in rows} == {"gw0", "gw1"}


def far_rows(page: str) -> list[str]:
    """Lines of the page's table whose target is far above what was measured, and that do not say why."""
    lines = [line.strip("| ").split(" | ") for line in page.splitlines() if re.match(r"\| [A-I]\d* \| ", line)]
    measured, target = ([float(cells[k].split()[0]) for cells in lines] for k in (3, 4))
    return [
        cells[1]
        for cells, m, t in zip(lines, measured, target, strict=True)
        if t > FAR * m and "target: " not in " | ".join(cells[5:])
    ]


def test_a_target_far_above_what_was_measured_has_a_reason(table: Any) -> None:
    """A target that any code meets shows nothing."""
    text = table.PAGE.read_text(encoding="utf-8")
    assert len(re.findall(r"^\| [A-I]\d* \| ", text, re.MULTILINE)) > 180
    assert far_rows(text) == []
    assert far_rows("| A1 | t | 3 | 0.1 mm | 1.1 mm |  |\n| A1 | u | 3 | 0.1 mm | 1 mm |  |\n") == ["t"]
    line = {"row": "D", "test": "t", "cases": 1, "measured": 1e-9, "target": 1.0, "unit": "", "note": ""}
    assert far_rows(table.table([line])) == []
    assert far_rows(table.table([{**line, "row": "A1"}])) == ["t"]
