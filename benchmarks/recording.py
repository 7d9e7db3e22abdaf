"""How much memory does a long run take to record, load, judge, report and export, and how fast is a sample found?

Three arms lift and lower a plate. Each stage has a process of its own, which first imports what it needs. What counts
is the largest resident memory of the stage above that start (Linux: ``VmHWM``, set back at the start; mapped files
count). See benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import matplotlib.backends.backend_agg
import matplotlib.backends.backend_svg
import matplotlib.figure
import matplotlib.pyplot  # noqa: F401
import numpy as np
from common import Record

from coopqp import QPController, Recording, WaypointPath, simulate
from coopqp.files import write_bag, write_csv
from coopqp.scenarios import paper_lift
from coopqp.simulation import check_run, evaluate, read_run
from coopqp.visualization import write_report

KEYS = ("stage", "steps", "arms", "memory_MB", "target_MB", "cpu_s", "file_MB", "good")
#: Target: resident memory of a stage above its start [MB], at any length of the run.
MOST_MB = 200.0
STEPS, QUICK = 1_000_000, 20_000
DT = 1e-3
#: Samples that are looked up in the stage ``seek``.
_LOOKED_UP = 1000


def task(steps: int) -> tuple[QPController, Any]:
    """A controller that lifts and lowers the plate for that many steps, and its start."""
    lift = paper_lift()
    ends = [lift.path.pose(0.0), lift.path.pose(lift.path.duration)]
    turns = max(1, round(steps * DT / lift.path.duration))
    path = WaypointPath([ends[i % 2] for i in range(turns + 1)], durations=[steps * DT / turns] * turns)
    return QPController(lift.cell, lift.grasp, path, dt=DT), lift.q_start


def resident_mb(field: str = "VmRSS") -> float:
    """Resident memory now, or at most since :func:`forget_most` (``VmHWM``) [MB]."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    (line,) = (line for line in status.splitlines() if line.startswith(f"{field}:"))
    return float(line.split()[1]) * 1024.0 / 1e6


def forget_most() -> None:
    """Set ``VmHWM`` back to the memory of now."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def record(file: Path, steps: int) -> bool:
    """Run and save."""
    controller, q_start = task(steps)
    run = simulate(controller, q_start=q_start, duration=2.0 * steps * DT)
    run.save(file)
    return run.finished and run.n_steps == steps


def load(file: Path, steps: int) -> bool:
    """Load, and look at every number once."""
    run = Recording.load(file)
    sums = [np.abs(run.q[part]).max() for part in run.parts(steps + 1)]
    return run.n_steps == steps and bool(np.isfinite(sums).all())


def seek(file: Path, steps: int) -> bool:
    """Load, and look up samples by their time."""
    run = Recording.load(file)
    for seconds in np.random.default_rng(1).uniform(0.0, steps * DT, _LOOKED_UP):
        if not abs(run.time[run.sample_at(seconds)] - seconds) <= DT:
            return False
    return True


def judged(file: Path, steps: int) -> bool:
    """Load, and judge by both: the verdict of a report, and the independent monitor."""
    run = Recording.load(file)
    cell = run.cell(shapes=False)
    findings = evaluate(cell, run, read_run(cell, run))
    return all(finding.holds for finding in findings) and check_run(run, cell).ok


def report(file: Path, steps: int) -> bool:
    """Load, and write the report."""
    page = write_report(Recording.load(file), file.with_suffix(".html"))
    return "Everything held." in page.read_text(encoding="utf-8")


def table(file: Path, steps: int) -> bool:
    """Load, and export a table."""
    written = write_csv(Recording.load(file), file.with_suffix(".csv"))
    with written.open("rb") as stream:
        lines = sum(1 for _ in stream)
    written.unlink()
    return lines == steps + 2


def bag(file: Path, steps: int) -> bool:
    """Load, and export a bag."""
    written = write_bag(Recording.load(file), file.with_suffix(".bag"))
    described = (written / "metadata.yaml").read_text(encoding="utf-8")
    shutil.rmtree(written)
    return f"message_count: {3 * (steps + 1)}" not in described and f"message_count: {steps + 1}" in described


STAGES: dict[str, Callable[[Path, int], bool]] = {
    "record": record,
    "load": load,
    "seek": seek,
    "judge": judged,
    "report": report,
    "csv": table,
    "bag": bag,
}


def stage(name: str, file: Path, steps: int) -> Record:
    """One stage, measured in this process."""
    forget_most()
    start, began = resident_mb(), time.process_time()
    good = STAGES[name](file, steps)
    seconds = time.process_time() - began
    return {
        "stage": name,
        "steps": steps,
        "arms": 3,
        "memory_MB": round(resident_mb("VmHWM") - start, 1),
        "target_MB": MOST_MB,
        "cpu_s": round(seconds / _LOOKED_UP, 7) if name == "seek" else round(seconds, 2),
        "file_MB": round(file.stat().st_size / 1e6, 1),
        "good": good,
    }


def main(argv: list[str] | None = None) -> int:
    parser = common.arguments(__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, metavar="N", help=f"length of the run ({STEPS}; --quick: {QUICK})")
    parser.add_argument("--stage", choices=STAGES, help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    steps = options.steps or (QUICK if options.quick else STEPS)
    if options.stage:
        print(json.dumps(stage(options.stage, options.file, steps)))
        return 0
    description = common.describe("Long recordings", {"steps": steps})
    print(common.header(description))
    records: list[Record] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in STAGES:
            command = [sys.executable, __file__, "--stage", name, "--file", f"{folder}/run.npz", "--steps", str(steps)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                print(done.stderr, file=sys.stderr)
                return 1
            records.append(json.loads(done.stdout.splitlines()[-1]))
    table = common.markdown_table(records, KEYS)
    print(table)
    common.save(records, description, json_file=options.json, out=options.out, files={"recording.md": table.encode()})
    return 0 if all(r["good"] and r["memory_MB"] <= MOST_MB for r in records) else 1


if __name__ == "__main__":
    sys.exit(main())
