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
#: A target may be this many times as large as what was measured; beyond, a reason stands beside it.
FAR = 10.0
_ROUNDING = "rounding, which other processors and versions do otherwise"
_OPERATOR = "what an operator may see; other cells may need more"
#: Reasons for targets that are far above what was measured: row, beginning of a test, and why.
REASONS: tuple[tuple[str, str, str], ...] = (
    ("A2", "", _ROUNDING),
    ("A3", "", "one target for all rows; several joints outside, and other solvers, need most"),
    ("A4", "", _ROUNDING),
    ("A7", "unreachable", "how soon depends on the way in; ten steps are few to an operator"),
    ("A9", "", "one target for all rows; random paths need most"),
    ("B", "5 %", _ROUNDING + ": lost samples change nothing where the encoders are true"),
    ("B", "base off by 1 mm and 0.1°, 0.3 m up and down for 10 min: drift", _ROUNDING),
    ("B", "grasp off", _ROUNDING + ": what is latched is kept"),
    ("B", "measurements", _ROUNDING + ": delays change nothing where the encoders are true"),
    ("B", "periods", _ROUNDING + ": so do periods"),
    ("C", "files that mean no good: memory", "the limit of the process that reads them; none comes near"),
    ("D", "", _ROUNDING),
    ("E", "", _ROUNDING),
    ("G", "soak: reported", _ROUNDING),
    ("I1", "", "3 % of new cells may fail, none did"),
    ("I2", "", _OPERATOR),
    ("I4", "", _OPERATOR),
    ("I6", "", "lengths of 10 km have a rounding of 1e-12 m, which a singularity magnifies"),
)


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
    def reason(self) -> str:
        """Why the target is as far above what was measured as it is; empty if nothing says so."""
        found = (why for row, test, why in REASONS if row == self.row and self.test.startswith(test))
        return next(found, "")

    @property
    def far(self) -> bool:
        """Whether the target is far above what was measured."""
        return self.target > FAR * self.measured

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
