"""The benchmark of promises: one record for each, with its bound, and the exit code of all."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import promises
import pytest
from promise_cases import Promise


def made(*values: float) -> Iterator[Promise]:
    for value in values:
        yield Promise(f"case {value}", value, 1.0, "mm")


@pytest.fixture(name="groups")
def _groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Promises that are kept, one at its bound; in another group one that is broken and one that is no number."""
    kept, broken = (lambda quick: made(0.5, 1.0)), (lambda quick: made(1.5, float("nan")))
    monkeypatch.setattr(promises, "GROUPS", {"chain": (kept, lambda quick: made(0.0)), "clock": (broken,)})


@pytest.mark.usefixtures("groups")
def test_a_value_holds_up_to_its_bound(tmp_path: Path) -> None:
    file = tmp_path / "promises.json"
    given = ["--quick", "--json", str(file), "--out", str(tmp_path / "out")]
    assert promises.main([*given, "--group", "chain"]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert all(tuple(record) == ("group", "case", "value", "bound", "unit", "holds") for record in records)
    assert [(r["group"], r["value"], r["bound"], r["unit"], r["holds"]) for r in records] == [
        ("chain", 0.5, 1.0, "mm", True), ("chain", 1.0, 1.0, "mm", True), ("chain", 0.0, 1.0, "mm", True)
    ]  # fmt: skip
    assert (tmp_path / "out" / "promises.md").is_file()


@pytest.mark.usefixtures("groups")
def test_one_that_is_broken_or_not_a_number_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "promises.json"
    assert promises.main(["--json", str(file), "--out", str(tmp_path)]) == 1
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [r["holds"] for r in records] == [True, True, True, False, False]
    said = capsys.readouterr().out
    assert said.count("BROKEN") == 2
    assert "5 promises, 2 broken" in said


def test_every_module_of_cases_is_in_a_group() -> None:
    folder = Path(promises.__file__).with_name("promise_cases")
    given = {function.__module__ for functions in promises.GROUPS.values() for function in functions}
    found = {
        f"promise_cases.{file.stem}"
        for file in folder.glob("*.py")
        if "\ndef promises(" in file.read_text(encoding="utf-8")
    }
    assert given == found
    groups = ["chain", "forces", "planning", "clock", "operator", "programs", "screen", "shared", "robot"]
    assert list(promises.GROUPS) == groups


@pytest.mark.slow
def test_the_clock_keeps_its_promises_in_short(tmp_path: Path) -> None:
    file = tmp_path / "promises.json"
    promises.main(["--quick", "--group", "clock", "--json", str(file), "--out", str(tmp_path)])
    records = json.loads(file.read_text(encoding="utf-8"))
    assert all(set(record) == set(promises.KEYS) and record["group"] == "clock" for record in records)
    assert not [record for record in records if not record["holds"] and record["unit"] != "ms"]  # no test of time
