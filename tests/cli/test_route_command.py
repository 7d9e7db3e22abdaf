"""``coopqp route``: its words, exit codes and files, and the path that a cell file leaves to a search."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coopqp import TimedPath, load_cell_file
from coopqp.cli import main as cli
from coopqp.files import CellFileError
from coopqp.files.cellfile import example_path, load_cell_task
from coopqp.files.cellfile.searched import SearchTask
from coopqp.planning import Route

EXAMPLE = example_path("bar_over_post")
LINE = """kind = "line"
start = { xyz_m = [0.0, -0.15, 0.30] }
goal = { xyz_m = [0.0, 0.15, 0.30] }
duration_s = 3.0"""


def cell_file(folder: Path, *changes: tuple[str, str]) -> Path:
    """The example with other text in it, and without the line that ends its search."""
    text = re.sub(r"nodes = .*\n", "", EXAMPLE.read_text(encoding="utf-8"))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "cell.toml"
    file.write_text(text, encoding="utf-8")
    return file


SEARCH = """kind = "search"
start = { xyz_m = [0.0, -0.15, 0.30] }
goal = { xyz_m = [0.0, 0.15, 0.30] }"""
WALL = ("radius_m = 0.03\nlength_m = 0.30", "size_m = [0.2, 0.03, 2.0]"), ('"capsule"', '"box"')


@pytest.mark.slow
def test_a_way_is_written_that_a_check_proves_and_a_run_follows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    way, record = tmp_path / "way.toml", tmp_path / "way.json"
    arguments = ["route", str(EXAMPLE), "--seed", "1", "--out", str(way), "--json", str(record)]
    assert cli.main(arguments) == 0
    said = capsys.readouterr().out
    assert said.startswith("FOUND\nA way of 0.")
    assert said.splitlines()[-2:] == [f"  {way}", f"  {record}"]
    answer = json.loads(record.read_text(encoding="utf-8"))
    assert answer["verdict"] == "FOUND"
    assert answer["check"]["verdict"] == "CERTIFIED"
    assert cli.main(["check", str(way)]) == 0
    assert capsys.readouterr().out.startswith("CERTIFIED")
    assert cli.main(["run", str(way), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    assert cli.main(arguments) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.slow
def test_a_search_finds_the_way_again_that_was_proved(tmp_path: Path) -> None:
    file = cell_file(tmp_path)  # without what ends the search
    first, again = (load_cell_task(file).path for _ in range(2))
    assert isinstance(first, TimedPath)
    assert isinstance(again, TimedPath)
    assert first.record() == again.record()


@pytest.mark.slow
def test_a_page_plays_the_way(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    page = tmp_path / "way.html"
    assert cli.main(["route", str(EXAMPLE), "--quiet", "--html", str(page)]) == 0
    assert "A way round of 0." in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_file_that_leaves_its_path_to_a_search_has_the_same_path_again(tmp_path: Path) -> None:
    file = cell_file(tmp_path, (SEARCH, f"{SEARCH}\nnodes = 500\nspeed_m_per_s = 0.1"))
    paths = [load_cell_file(file).scenario.path for _ in range(2)]
    one, other = (np.array([path.pose(t).homogeneous for t in np.linspace(0.0, path.duration, 9)]) for path in paths)
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one[-1, :3, 3], [0.0, 0.15, 0.30], atol=1e-9)
    assert paths[0].duration > 3.0


def test_a_blocked_line_is_offered_a_way_round(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = cell_file(tmp_path, (SEARCH, LINE))
    assert cli.main(["check", str(file)]) == 3
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith("a way round exists, of 0.")
    assert said.endswith(f"coopqp route {file}")


def test_what_is_not_found_is_not_denied_and_what_is_impossible_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walled = cell_file(tmp_path, *WALL)
    assert cli.main(["route", str(walled), "--time", "0.3"]) == 4
    said = capsys.readouterr().out
    assert said.startswith("NOT_FOUND\nNo way in 0.")
    assert "nothing is proved" in said
    outside = cell_file(tmp_path, ("goal = { xyz_m = [0.0, 0.15, 0.30] }", "goal = { xyz_m = [0.0, 3.0, 0.30] }"))
    assert cli.main(["route", str(outside), "--quiet"]) == 3
    assert "arm left does not reach its grasp" in capsys.readouterr().err
    with pytest.raises(CellFileError, match="The goal is impossible: arm left"):
        load_cell_file(outside)
    assert cli.main(["check", str(outside)]) == 3


def test_ctrl_c_ends_the_search_and_writes_what_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record, walled = tmp_path / "way.json", cell_file(tmp_path, *WALL)
    route = SearchTask.route

    def interrupted(task: SearchTask, **options: Any) -> Route:
        signal.raise_signal(signal.SIGINT)
        return route(task, **options)

    monkeypatch.setattr(SearchTask, "route", interrupted)
    before = signal.getsignal(signal.SIGINT)
    assert cli.main(["route", str(walled), "--time", "60", "--json", str(record)]) == 130
    assert json.loads(record.read_text(encoding="utf-8"))["verdict"] == "NOT_FOUND"
    assert signal.getsignal(signal.SIGINT) is before


def test_a_goal_with_free_turns_in_a_region(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    goal = (
        'goal = { xyz_m = [0.0, 0.15, 0.30], free = [{ axis = "rx", range_deg = [-20, 20] }] }\n'
        "region = { low_m = [-0.2, -0.3, 0.2], high_m = [0.2, 0.3, 0.7] }"
    )
    file = cell_file(tmp_path, ("goal = { xyz_m = [0.0, 0.15, 0.30] }", goal))
    assert cli.main(["route", str(file)]) == 0
    assert capsys.readouterr().out.startswith("FOUND")


def test_bad_input_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    bodiless = tmp_path / "bare.toml"
    bodiless.write_text(text[: text.index("[collision]")], encoding="utf-8")
    assert cli.main(["route", str(bodiless)]) == 2
    assert "add a table [collision]" in capsys.readouterr().err
    turned = cell_file(tmp_path, ("0.30] }\n\n[object]", '0.30], free = [{ axis = "z" }] }\n\n[object]'))
    assert cli.main(["route", str(turned)]) == 2
    assert "axis" in capsys.readouterr().err
    for option, value in (("--time", "0"), ("--seed", "-1")):
        assert cli.main(["route", str(EXAMPLE), f"{option}={value}"]) == 2
        assert value in capsys.readouterr().err
