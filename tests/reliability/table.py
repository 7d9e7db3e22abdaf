"""Write the measured catalogue into docs/reliability.md: ``python tests/reliability/table.py FILE [PAGE]``."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

from catalogue import Row

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


#: Texts that stand beside so many lines stand once, below the table.
OFTEN = 3


#: Part of a test whose cases are spread over several processes.
PART = re.compile(r"[,:] \d+ of (\d+)")


def whole(rows: list[Row]) -> list[Row]:
    """The parts of a test in one line: all their cases, the worst of what they measured, and a note if all have it."""
    tests: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        tests.setdefault((row.row, PART.sub("", row.test)), []).append(row)
    return [
        replace(
            max(parts, key=lambda r: r.measured),
            test=test,
            cases=sum(r.cases for r in parts),
            note=parts[0].note if len({r.note for r in parts}) == 1 else "",
        )
        for (_, test), parts in tests.items()
    ]


def table(rows: list[dict[str, object]]) -> str:
    lines = whole([Row(**r) for r in rows])  # type: ignore[arg-type]
    told = [(line.note, f"target: {line.reason}" if line.far else "") for line in lines]
    return with_notes([_cells(line) for line in lines], told)


def _cells(line: Row) -> str:
    unit = f" {line.unit}" if line.unit else ""
    missed = "" if line.met else "missed. "
    numbers = f"{line.cases:,} | {line.measured:.3g}{unit} | {line.target:.3g}{unit}"
    return f"| {line.row} | {line.test} | {numbers} | {missed}"


def with_notes(lines: list[str], told: list[tuple[str, str]]) -> str:
    """The table of lines with what is told beside them: a note, and why the target is so far away."""
    counts = Counter(text for texts in told for text in texts if text)
    often = {text: i for i, text in enumerate((text for text, n in counts.items() if n >= OFTEN), start=1)}

    def said(text: str) -> str:
        where = "target: " if text.startswith("target: ") else ""
        return f"{where}see {often[text]}" if text in often else text

    body = [f"{line}{'; '.join(map(said, filter(None, texts)))} |" for line, texts in zip(lines, told, strict=True)]
    head = ["| | test | cases | measured | target | |", "|---|---|---:|---:|---:|---|"]
    below = [f"{i}. {text.removeprefix('target: ')}" for text, i in often.items()]
    return "\n".join([*head, *body, *(["", *below] if below else [])])


def main(source: str, page: str = str(PAGE)) -> None:
    rows = json.loads(Path(source).read_text(encoding="utf-8"))
    text = Path(page).read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    Path(page).write_text(f"{before}{BEGIN}\n{table(rows)}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
