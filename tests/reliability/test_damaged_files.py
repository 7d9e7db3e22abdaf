"""I10: files of every kind that were cut, overwritten, or got odd values end in a result or in one named error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import damage
import pytest

from coopqp.studies import StudyError, load_study
from coopqp.studies.journal import Journal


@pytest.mark.slow
def test_damaged_files_end_in_a_result_or_a_named_error(count: Callable[[int], int], catalogue: Any) -> None:
    said: list[str] = []
    found = list(damage.damaged(count(400), seed=2, said=said.append))
    assert not said, said[0]
    catalogue.row(
        "I10",
        "damaged files that end in a traceback: cells, studies, places, journals, recordings",
        cases=sum(number for _, number, _ in found),
        measured=sum(wrong for *_, wrong in found),
        target=0,
        note="`benchmarks/promises.py --group screen` takes 20,000",
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("low = 1, high = 100", "low = 0, high = 1", "one sign"),
        ("low = 1, high = 100", "low = 1, high = 0", "one sign"),
        ("low = 1, high = 100", "low = -1, high = 2", "one sign"),
        ("[set]\n", "[set]\ndisturbances = 2\n", "give a table, not 2"),
    ],
)
def test_studies_that_raised_other_errors_are_refused_by_name(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(damage.CELL, encoding="utf-8")
    file = tmp_path / "study.toml"
    assert old in damage.STUDY
    file.write_text(damage.STUDY.replace(old, new), encoding="utf-8")
    with pytest.raises(StudyError, match=said):
        load_study(file)


def test_no_changed_line_of_a_journal_is_taken(tmp_path: Path) -> None:
    """Any other byte in any line is found by the line's checksum; a cut last line is taken off."""
    file = tmp_path / "journal"
    entries = [{"row": i, "columns": {"outcome": "ok", "x": 0.1 * i}, "seconds": 0.5} for i in range(2)]
    with Journal(file) as journal:
        journal.append(entries)
    content = file.read_bytes()
    for at in range(len(content) - 1):
        for bit in (1, 16):
            changed = content[:at] + bytes([content[at] ^ bit]) + content[at + 1 :]
            file.write_bytes(changed)
            with pytest.raises(StudyError, match=r"line \d is damaged"), Journal(file):
                pass
            assert file.read_bytes() == changed
