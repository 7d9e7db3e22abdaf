"""How close the look-ahead comes to the fastest motion, and to version 0.1: random paths, cells and redundant cells.

``--record FILE`` writes the figures of the installed version with the optimum of every case: that made
benchmarks/data/look_ahead_0_1.json. Without it the cases run and are compared with this file. See benchmarks/README.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import common  # first: it limits BLAS to one thread
import look_ahead_cases as cases
import numpy as np
from common import Record

from coopqp import WaypointPath
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario

KEYS = ("case", "number", "arms", "time_s", "ratio", "ratio_rate", "to_0_1", "chain_um", "path_um", "qp", "finished")
#: Figures of version 0.1, with the shortest times.
RECORDED = Path(__file__).parent / "data" / "look_ahead_0_1.json"
#: Random paths and random redundant cells.
PATHS, REDUNDANT = 24, 210
#: The controller's own bound of σ̇ [1/s]; the optimum of cells that start at rest has it, too.
RATE_SLOPE = 10.0
#: Digits that are kept.
DIGITS = 6


def tasks(every: int = 1) -> Iterator[tuple[str, int, Callable[[], Scenario]]]:
    """Every case, its number and its task, or one in ``every``."""
    for law in ("linear", "quintic"):
        for i in range(0, PATHS, every):
            yield f"paths, {law}", i, partial(cases.random_path, i, law)
    for kind, (make, count) in cases.NEAR.items():
        for i in range(0, count, every):
            yield kind, i, partial(make, i)
    for i in range(0, REDUNDANT, every):
        yield "redundant", i, partial(cases.redundant, i)


def measured(kind: str, number: int, task: Scenario, end: float | None = None) -> Record:
    """What a run came to."""
    made = cases.run(task, until=end)
    return {
        "case": kind, "number": number, "arms": len(task.cell), "end": made.end, "time_s": round(made.time, DIGITS),
        "chain_um": round(made.chain_um, DIGITS), "path_um": round(made.path_um, DIGITS), "qp": made.qp,
        "held": made.held, "finished": made.finished,
    }  # fmt: skip


def with_optimum(record: Record, task: Scenario) -> Record:
    """The same with the shortest times, of any rate and of rates up to 1 [s]."""
    path, end = task.path, float(record["end"])
    record = dict(record, best_s=None, best_rate_s=None)
    if record["case"].startswith("paths"):
        assert isinstance(path, WaypointPath)
        segments = path.segments
        poses, times = [segments[0].start, *(s.goal for s in segments)], [s.duration for s in segments]
        straight = WaypointPath(poses, durations=times, time_law="linear")
        record["best_s"] = cases.optimum_of_path(replace(task, path=straight))
        if segments[0].time_law is TimeLaw.QUINTIC:
            record["best_rate_s"] = cases.optimum_of_path(task, 1.0)
    elif record["case"] != "redundant":
        stops = end if record["finished"] else end * (1.0 - 1e-9)
        inside = end if record["finished"] else end - 1e-3 * path.duration
        clocks, times_there = cases.fastest(task, end=stops, slope=RATE_SLOPE)
        record["best_rate_s"] = float(np.interp(inside, clocks, times_there))
    return record


def compared(record: Record, before: Record) -> Record:
    """A run beside the shortest times and beside version 0.1."""
    time, best, best_rate = record["time_s"], before["best_s"], before["best_rate_s"]
    comparable = record["finished"] == before["finished"]
    found = {
        "ratio": time / best if best else None,
        "ratio_rate": time / best_rate if best_rate else None,
        "to_0_1": time / before["time_s"] if comparable else None,
    }
    return {key: {**record, **found}[key] for key in KEYS}


def compare(every: int, progress: common.Progress) -> Iterator[tuple[Record, Record]]:
    """Every case: its record, and the record of version 0.1."""
    recorded = {(r["case"], r["number"]): r for r in json.loads(RECORDED.read_text(encoding="utf-8"))}
    for kind, number, make in tasks(every):
        before = recorded[kind, number]
        until = None if before["finished"] else before["end"]
        yield compared(measured(kind, number, make(), until if kind != "redundant" else None), before), before
        progress.advance(kind)


def summary(pairs: Sequence[tuple[Record, Record]]) -> list[Record]:
    """A line per kind of case."""
    lines = []
    for kind in dict.fromkeys(now["case"] for now, _ in pairs):
        these = [(now, before) for now, before in pairs if now["case"] == kind]
        line: Record = {"case": kind, "cases": len(these)}
        for key in ("ratio", "ratio_rate"):
            values = [now[key] for now, _ in these if now[key] is not None]
            shown = np.percentile(values, [50, 90, 100]) if values else []
            line[key] = " / ".join(f"{v:.3f}" for v in shown)
        line["largest to 0.1"] = max(now["to_0_1"] for now, _ in these if now["to_0_1"] is not None)
        line["chain µm"], line["path µm"] = (max(now[k] for now, _ in these) for k in ("chain_um", "path_um"))
        line["finished"] = sum(now["finished"] for now, _ in these)
        line["finished by 0.1"] = sum(before["finished"] for _, before in these)
        line["with QP"] = sum(now["qp"] > 0 for now, _ in these)
        lines.append(line)
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--record", type=Path, metavar="FILE", help="write the figures of this version, with optima")
    args = parser.parse_args(argv)
    every = 8 if args.quick else 1
    total = sum(1 for _ in tasks(every))
    progress = common.Progress(total)
    if args.record is not None:
        records = []
        for kind, number, make in tasks():
            task = make()
            records.append(with_optimum(measured(kind, number, task), task))
            progress.advance(kind)
        args.record.write_text("[\n" + ",\n".join(map(json.dumps, records)) + "\n]\n", encoding="utf-8")
        return 0
    description = common.describe("look_ahead", {"cases": total})
    print(common.header(description), flush=True)
    pairs = list(compare(every, progress))
    progress.close()
    lines = summary(pairs)
    text = "## The look-ahead\n\n" + common.markdown_table(lines, tuple(lines[0])) + "\n"
    print("\n" + text)
    files = {"look_ahead.md": text.encode()} if args.out is not None else None
    records = [now for now, _ in pairs]
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
