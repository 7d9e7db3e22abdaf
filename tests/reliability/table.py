"""Write the measured catalogue into docs/reliability.md: ``python tests/reliability/table.py FILE [PAGE]``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from catalogue import Row

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def table(rows: list[dict[str, object]]) -> str:
    lines = ["| | test | cases | measured | target | |", "|---|---|---:|---:|---:|---|"]
    for r in rows:
        met = float(str(r["measured"])) <= float(str(r["target"]))
        unit, note = f" {r['unit']}" if r["unit"] else "", "" if met else "missed. "
        line = Row(**r)  # type: ignore[arg-type]
        far = f"{'; ' if line.note else ''}target: {line.reason}" if line.far else ""
        lines.append(
            f"| {r['row']} | {r['test']} | {r['cases']:,} | {r['measured']:.3g}{unit} | {r['target']:.3g}{unit} "
            f"| {note}{r['note']}{far} |"
        )
    return "\n".join(lines)


def main(source: str, page: str = str(PAGE)) -> None:
    rows = json.loads(Path(source).read_text(encoding="utf-8"))
    text = Path(page).read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    Path(page).write_text(f"{before}{BEGIN}\n{table(rows)}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
