"""The catalogue of docs/reliability.md as tests: the numbers of cases, and the table of measured figures.

``count(n)`` is n cases in the ``ci`` profile and ten times as many in ``nightly``. ``catalogue.row(…)`` compares a
measured figure with its target, fails if the target is missed, and adds a line to the table at the end of the run
(``--reliability-json FILE`` saves the table; ``tests/reliability/table.py FILE`` writes it into docs/reliability.md).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pytest
from hypothesis import settings

NIGHTLY_FACTOR = 10


@dataclass(frozen=True)
class Row:
    """One line of the catalogue: the test, its number of cases, the measured figure and the target."""

    row: str
    test: str
    cases: int
    measured: float
    target: float
    unit: str
    note: str = ""

    @property
    def met(self) -> bool:
        return self.measured <= self.target


@dataclass
class Catalogue:
    """The lines of one run of the tests."""

    rows: list[Row] = field(default_factory=list)

    def row(
        self, row: str, test: str, *, cases: int, measured: float, target: float, unit: str = "", note: str = ""
    ) -> None:
        """Add a line and fail if ``measured`` is above ``target`` (0 for numbers of violations or failures)."""
        line = Row(row, test, int(cases), float(measured), float(target), unit, note)
        self.rows.append(line)
        assert cases > 0, f"{row} {test}: nothing was tried"
        assert line.met, f"{row} {test}: {measured:.3g} {unit}, target {target:.3g}; {cases} cases"


_CATALOGUE = Catalogue()


@pytest.fixture(scope="session")
def catalogue() -> Catalogue:
    return _CATALOGUE


@pytest.fixture(scope="session")
def count() -> Callable[[int], int]:
    factor = NIGHTLY_FACTOR if settings.get_current_profile_name() == "nightly" else 1
    return lambda cases: cases * factor


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    rows = sorted(_CATALOGUE.rows, key=lambda r: (r.row[0], int(r.row[1:] or 0), r.test))
    if not rows:
        return
    terminalreporter.section(f"reliability: {sum(r.cases for r in rows):,} cases in {len(rows)} lines")
    for r in rows:
        verdict = "" if r.met else "  MISSED"
        terminalreporter.write_line(
            f"{r.row:4} {r.test:66.66} {r.cases:>11,}  {r.measured:9.3g} ≤ {r.target:.3g} {r.unit}{verdict}"
        )
    if file := config.getoption("--reliability-json"):
        Path(file).write_text(json.dumps([asdict(r) for r in rows], indent=1), encoding="utf-8")
