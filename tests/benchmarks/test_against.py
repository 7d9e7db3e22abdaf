"""benchmarks/against.py: coopqp beside coopqp of another commit."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import against
import compare_peers
import pytest
from contestants import PACES, NotAvailable
from places import BENCHMARKS

#: A project whose build copies its core in place of compiling one.
BUILD = """cmake_minimum_required(VERSION 3.26)
project(copied LANGUAGES NONE)
add_custom_target(core ALL COMMAND ${CMAKE_COMMAND} -E copy ${CMAKE_CURRENT_SOURCE_DIR}/core.txt built.txt)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/built.txt DESTINATION coopqp/native)
"""


def rounds(*medians: float) -> list[against.Round]:
    return [([us] * 3, 0, "") for us in medians]


class TestRow:
    def test_rounds_alternate(self) -> None:
        order: list[str] = []

        def contestant(name: str) -> Any:
            return lambda: order.append(name) or ([float(len(order))], 0, "")

        here, there = against.rounds_of(contestant("here"), contestant("there"), 3)
        assert order == ["here", "there", "there", "here", "here", "there"]
        assert [times for times, _, _ in here] == [[1.0], [4.0], [5.0]]
        assert [times for times, _, _ in there] == [[2.0], [3.0], [6.0]]
        against.rounds_of(contestant("here"), contestant("there"), 1, begin=3)
        assert order[6:] == ["there", "here"]

    def test_figures_are_of_each_round(self) -> None:
        row = against.judged(rounds(1.0, 10.0, 3.0), rounds(1.0, 8.0, 4.0))  # the machine slows down in the second
        assert row["ratio"] == 1.0
        assert row["more_us"] == 0.0
        assert (row["p50_us"], row["p50_us_there"]) == (3.0, 4.0)

    @pytest.mark.parametrize(
        ("here", "there", "good"), [(10.4, 10.0, True), (10.6, 10.0, False), (1.09, 1.0, True), (1.2, 1.0, False)]
    )
    def test_small_shares_and_small_times_are_good(self, here: float, there: float, good: bool) -> None:
        assert against.judged(rounds(here, here), rounds(there, there))["good"] is good

    def test_failures_are_no_figures(self) -> None:
        row = against.judged([([], 5, "it fell over")], rounds(1.0))
        assert (row["ratio"], row["good"], row["failures"], row["note"]) == (None, False, 5, "it fell over")


class Fake:
    modes = ("compiled",)

    def __init__(self, us: float) -> None:
        self._us, self.stopped = us, False

    @classmethod
    def start(cls, name: str, cache: Path, *, install: bool) -> Fake:
        return cls(2.0)

    def load(self, file: Path) -> None:
        assert file.is_file()

    def ask(self, *, do: str, steps: int, timeout: float, **command: Any) -> dict[str, Any]:
        return {"us": [self._us] * steps, "failures": 0, "note": ""}

    def stop(self) -> None:
        self.stopped = True


class TestCompare:
    def test_every_row_has_a_ratio(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        others: list[Fake] = []
        monkeypatch.setattr(against, "checkout", lambda commit, cache: tmp_path / "coopqp-0123456789ab")
        monkeypatch.setattr(against, "start", lambda folder: others.append(Fake(1.0)) or others[-1])
        monkeypatch.setattr(against, "Contestant", Fake)
        records = against.compare("HEAD", tmp_path, cases=("nominal", "qp"), arms=(3,), rounds=2, steps=3, round_s=1.0)
        assert [(r["case"], r["pacing"]) for r in records] == [(c, p) for c in ("nominal", "qp") for p in PACES]
        assert all(set(r) == set(against.KEYS) for r in records)
        assert {(r["ratio"], r["commit"], r["good"]) for r in records} == {(2.0, "0123456789ab", False)}
        assert len(others) == against.PAIRS
        assert all(other.stopped for other in others)
        assert "0 of 4 rows" in against.report(records)

    @pytest.mark.slow
    def test_another_copy_is_what_runs_there(self, tmp_path: Path) -> None:
        unbuilt = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
        for name in ("coopqp", "benchmarks"):
            shutil.copytree(BENCHMARKS.parent / name, tmp_path / name, ignore=unbuilt)
        contestant = against.start(tmp_path)
        try:
            assert contestant.modes == ("plain",)  # that copy has no core
        finally:
            contestant.stop()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")
class TestCheckout:
    @pytest.fixture
    def repository(self, tmp_path: Path) -> Path:
        folder = tmp_path / "repository"
        folder.mkdir()
        (folder / "CMakeLists.txt").write_text(BUILD)
        (folder / "core.txt").write_text("first")
        git = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b"]
        for command in (["init"], ["add", "."], ["commit", "-m", "first"]):
            subprocess.run([*git, *command], check=True, capture_output=True)
        return folder

    def test_the_commit_is_built_once_and_not_what_is_being_edited(self, repository: Path, tmp_path: Path) -> None:
        (repository / "core.txt").write_text("edited")
        folder = against.checkout("HEAD", tmp_path / "cache", repository)
        built = folder / "coopqp" / "native" / "built.txt"
        assert built.read_text() == "first"
        built.write_text("kept")
        assert against.checkout("HEAD", tmp_path / "cache", repository) == folder
        assert built.read_text() == "kept"

    def test_what_cannot_be_built_is_said(self, repository: Path, tmp_path: Path) -> None:
        (repository / "CMakeLists.txt").write_text("nonsense")
        subprocess.run(
            ["git", "-C", str(repository), "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-am", "second"],
            check=True,
            capture_output=True,
        )
        with pytest.raises(NotAvailable, match="cannot be built"):
            against.checkout("HEAD", tmp_path / "cache", repository)

    def test_a_commit_that_does_not_exist(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert compare_peers.main(["--against", "no-such-commit", "--cache", str(tmp_path)]) == 1
        assert "no-such-commit is not compared: there is no such commit" in capsys.readouterr().out
