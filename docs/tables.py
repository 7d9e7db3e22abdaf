"""Write the measured tables of the pages, from the records of ``make tables``, between marks.

    python docs/tables.py out/bench

The folder holds behaviour.json, compare_peers.json and promises.json; a table without its records stays.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

Record = Mapping[str, Any]
ROOT = Path(__file__).parents[1]
ARMS = (3, 8, 16)


def difficult(records: Sequence[Record]) -> str:
    """Largest distances in three cases of behaviour.py [mm], of all their runs."""
    rows = []
    for case, words, key in (
        ("fast", "object at 0.6 m/s, joints limited to 1 rad/s; also to 5 rad/s²", "chain_mm"),
        ("limit", "a joint runs into its limit, 5 rad/s² (50 directions)", "chain_mm"),
        ("mismatch", "5 mm grasp mismatch at the start: error at the end", "chain_final_mm"),
    ):

        def worst(controller: str, key: str, case: str = case) -> float:
            return max(float(r[key]) for r in records if (r["case"], r["controller"]) == (case, controller))

        off = "" if case == "mismatch" else figure(worst("cooperative", "path_mm"))
        alone, together = (figure(worst(name, key)) for name in ("independent", "cooperative"))
        rows.append({"case": words, "each arm alone": alone, "cooperative": together, "off the path": off})
    return markdown(rows)


def period(records: Sequence[Record]) -> str:
    """One period of a paced loop that is closed on readings, of coopqp's compiled core beside PlaCo."""
    rows = []
    for arms in ARMS:
        (own,) = (
            r
            for r in records
            if (r["peer"], r["case"], r["arms"], r["mode"], r["pacing"])
            == ("coopqp", "measured", arms, "compiled", "1 kHz")
        )
        rows.append(
            {
                "arms": arms,
                "coopqp, median [µs]": figure(own["p50_us"]),
                "99th percentile [µs]": figure(own["p99_us"]),
                "PlaCo (hard, scaled), median [µs]": figure(own["placo_p50_us"]),
                "coopqp ÷ PlaCo": figure(own["ratio_placo"]),
            }
        )
    return "CPU time from a noisy reading to the next command in a 1 kHz loop in Python:\n\n" + markdown(rows)


def steps(records: Sequence[Record]) -> str:
    """How far apart the arms are commanded, by the length of a step, of promises.py."""
    found = [(re.search(r"steps of (\d+) ms: apart$", str(r["case"])), r) for r in records]
    rows = [
        {"dt [ms]": m[1], "largest [µm]": figure(float(r["value"])), "promised [µm]": figure(float(r["bound"]))}
        for m, r in found
        if m
    ]
    return markdown(rows)


def figure(value: float) -> str:
    """Two digits; whole numbers from 100 on, powers of ten below 0.01."""
    if value >= 99.5:
        return f"{value:.0f}"
    if value >= 0.01 or value == 0.0:
        return f"{value:.2g}"
    digits, power = f"{value:.1e}".split("e")
    return f"{float(digits):g}e{int(power)}"


def markdown(rows: Sequence[Record]) -> str:
    """Rows with the same keys as a table."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *([str(value) for value in row.values()] for row in rows)]
    return "\n".join(("| " + " | ".join(line) + " |").replace("|  |", "| |") for line in lines)


#: The file, the mark and the records of each table.
TABLES: dict[tuple[str, str], tuple[str, Callable[[Sequence[Record]], str]]] = {
    ("docs/measured.md", "difficult"): ("behaviour.json", difficult),
    ("docs/measured.md", "period"): ("compare_peers.json", period),
    ("docs/reliability.md", "steps"): ("promises.json", steps),
}


def replaced(text: str, mark: str, table: str) -> str:
    """The text with another table between the marks.

    Raises:
        ValueError: the marks are not there exactly once.
    """
    begin, end = f"<!-- measured: {mark} -->", f"<!-- measured: end of {mark} -->"
    text, count = re.subn(f"(?s){re.escape(begin)}.*?{re.escape(end)}", lambda _: f"{begin}\n{table}\n{end}", text)
    if count != 1:
        raise ValueError(f"{begin} … {end} is there {count} times")
    return text


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("records", type=Path, metavar="DIR", help="folder of the records")
    parser.add_argument("--into", type=Path, default=ROOT, metavar="DIR", help="folder of docs (this repository)")
    args = parser.parse_args(argv)
    for (file, mark), (records, table) in TABLES.items():
        if not (args.records / records).is_file():
            print(f"{file}, {mark}: no {records}, unchanged")
            continue
        page = args.into / file
        text = replaced(
            page.read_text(encoding="utf-8"),
            mark,
            table(json.loads((args.records / records).read_text(encoding="utf-8"))),
        )
        page.write_text(text, encoding="utf-8")
        print(f"{file}, {mark}: written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
