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

#: A project whose build copies its core in place of compiling one.
BUILD = """cmake_minimum_required(VERSION 3.26)
project(copied LANGUAGES NONE)
add_custom_target(core ALL COMMAND ${CMAKE_COMMAND} -E copy ${CMAKE_CURRENT_SOURCE_DIR}/core.txt built.txt)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/built.txt DESTINATION coopqp/core)
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
        assert (row["p99_us"], row["p99_us_there"], row["p99_ratio"]) == (10.0, 8.0, 1.0)

    @pytest.mark.parametrize(
        ("here", "there", "good"), [(10.2, 10.0, True), (10.4, 10.0, False), (1.09, 1.0, True), (1.2, 1.0, False)]
    )
    def test_small_shares_and_small_times_are_good(self, here: float, there: float, good: bool) -> None:
        assert against.judged(rounds(here, here), rounds(there, there))["good"] is good

    def test_a_paced_row_keeps_its_tail_too(self) -> None:
        here, there = [([1.0] * 98 + [last] * 2, 0, "") for last in (5.4, 5.0)]
        row = against.judged([here], [there], paced=True)
        assert row["ratio"] == 1.0
        assert row["p99_ratio"] == pytest.approx(1.08)
        assert not row["good"]
        assert against.judged([here], [there])["good"]

    def test_failures_are_no_figures(self) -> None:
        row = against.judged([([], 5, "it fell over")], rounds(1.0))
        assert (row["ratio"], row["good"], row["failures"], row["note"]) == (None, False, 5, "it fell over")
        assert row["p99_us"] is row["p99_ratio"] is None


class Fake:
    modes = ("default",)

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
        text = against.report(records)
        assert "0 of 4 rows" in text
        assert "- median of all rows: 2.000, largest 2.000\n- median of the p99 of the paced rows: 2.000" in text

    def test_another_copy_is_what_runs_there(self, tmp_path: Path) -> None:
        """Its own runner and its own package."""
        for file, text in {
            "coopqp/__init__.py": "modes = ['of the copy']",
            "benchmarks/peers/run_coopqp.py": (
                "import json, coopqp; print(json.dumps({'version': '0', 'modes': coopqp.modes}), flush=True); input()"
            ),
        }.items():
            (tmp_path / file).parent.mkdir(parents=True)
            (tmp_path / file).write_text(text, encoding="utf-8")
        contestant = against.start(tmp_path)
        try:
            assert contestant.modes == ("of the copy",)
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
        built = folder / "coopqp" / "core" / "built.txt"
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
