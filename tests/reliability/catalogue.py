"""The catalogue of docs/reliability.md as tests: what they measured in one table, whichever process ran them.

``catalogue.row(…)`` states what was measured beside its target, fails if the target is missed, and puts the line into
the table that ends the run (``--reliability-json FILE`` keeps it; ``tests/reliability/table.py FILE`` writes it into
docs/reliability.md). Lines travel with a test's report, so those of a worker of pytest-xdist arrive as well.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pytest

PROPERTY = "reliability"


@dataclass(frozen=True)
class Row:
    """One line of the catalogue: what was tried, how often, what came out, and what had to."""

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

    @property
    def order(self) -> tuple[str, int, str]:
        """Place in the table: A2 before A10."""
        return self.row[0], int(self.row[1:] or 0), self.test


@dataclass
class Catalogue:
    """The lines of one test."""

    rows: list[Row] = field(default_factory=list)

    def row(
        self, row: str, test: str, *, cases: int, measured: float, target: float, unit: str = "", note: str = ""
    ) -> None:
        """Keep a line and fail if ``measured`` is above ``target`` (count violations or failures: target 0)."""
        line = Row(row, test, int(cases), float(measured), float(target), unit, note)
        self.rows.append(line)
        assert cases > 0, f"{row} {test}: nothing was tried"
        assert line.met, f"{row} {test}: {measured:.3g} {unit}, target {target:.3g}; {cases} cases"


@pytest.fixture
def catalogue(request: pytest.FixtureRequest) -> Iterator[Catalogue]:
    """Takes the lines of one test, and gives them to its report."""
    kept = Catalogue()
    yield kept
    request.node.user_properties.extend((PROPERTY, asdict(line)) for line in kept.rows)


class Table:
    """Gathers the lines of all tests from their reports, and prints them at the end of the run."""

    def __init__(self) -> None:
        self.rows: list[Row] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            found: list[Any] = [value for name, value in report.user_properties if name == PROPERTY]
            self.rows += [Row(**value) for value in found]

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
        rows = sorted(self.rows, key=lambda r: r.order)
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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--reliability-json", metavar="FILE", help="write what tests/reliability measured to FILE")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # the process that prints, not one of its workers
        config.pluginmanager.register(Table(), "reliability-table")
