"""The cell files that come with coopqp: listed, described on a page, and each runs from an empty folder as it is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from marks import slow_unless
from places import DOCS

from coopqp.cli import main as cli
from coopqp.cli.examples import needed_extras
from coopqp.files import CELLS, example_path
from coopqp.files.cellfile.text import read_tables

ROW = re.compile(r"^\| `(\w+)` \| ([^|]*)\| (`.+`) \|$", re.M)
#: Of the page: the extras that a cell needs, and the files that its run writes.
PAGE = {
    name: (tuple(re.findall(r"\w+", extras)), set(re.findall(r"`([^`]+)`", files)))
    for name, extras, files in ROW.findall((DOCS / "howto" / "cell-file.md").read_text(encoding="utf-8"))
}


def test_the_page_has_a_line_for_each_cell_and_names_its_extras() -> None:
    assert tuple(PAGE) == CELLS
    for name, (extras, _) in PAGE.items():
        assert needed_extras(read_tables(example_path(name))) == extras, name


def test_the_command_lists_each_cell_with_its_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["examples"]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.split() == ["cell", "robots", "extras", "what", "happens"]
    listed = {line.split()[0]: line for line in lines[: len(CELLS)]}
    assert tuple(listed) == CELLS
    assert "2 panda, 2 ur5" in listed["pandas_and_ur5s"]
    for name, line in listed.items():
        first = example_path(name).read_text(encoding="utf-8").splitlines()[0]
        assert line.endswith(first.removeprefix("# "))
        assert first.endswith("."), f"{name}.toml begins with a comment that is a sentence"


@pytest.mark.parametrize("name", slow_unless(lambda name: name == "bar", CELLS))
def test_each_cell_runs_from_an_empty_folder_and_writes_what_the_page_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["schema", "--example", name]) == 0
    Path(f"{name}.toml").write_text(capsys.readouterr().out, encoding="utf-8")
    assert cli.main(["run", f"{name}.toml", "--quiet"]) == 0
    assert {file.name for file in (tmp_path / "out" / name).iterdir()} == PAGE[name][1]
