"""How long does a step take whose input or QP holds NaN, infinities or absurd numbers?

Each solver runs in a process of its own the cases that tests/reliability/test_bad_numbers.py judges. Times are CPU
time of the thread: for bad numbers the middle one of three tries, for absurd ones (1e-310 to 1e300) the longest of all.
``slowest`` names the case. See benchmarks/README.md.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from pathlib import Path

import common  # first: it limits BLAS to one thread
from common import Record

from coopqp.solvers import available_solvers

PROGRAM = Path(__file__).parents[1] / "tests" / "reliability" / "programs" / "bad_numbers.py"
KEYS = ("solver", "numbers", "cases", "median_ms", "slowest_ms", "target_ms", "slowest")
#: A step at 100 Hz has 10 ms; an absurd number must not make a solver hang.
TARGETS = {"bad": 10.0, "wild": 1000.0}


def main(argv: list[str] | None = None) -> int:
    """Measure and print. Returns 1 if a target is missed."""
    options = common.arguments(__doc__.partition("\n")[0]).parse_args(argv)
    solvers = ("ldp",) if options.quick else available_solvers()
    description = common.describe("Bad numbers", {"solvers": ", ".join(solvers)})
    print(common.header(description))
    records: list[Record] = []
    for solver in solvers:
        line = [sys.executable, str(PROGRAM), solver, "3"]
        done = subprocess.run(line, capture_output=True, text=True, timeout=600, check=True)
        for numbers, tally in json.loads(done.stdout.splitlines()[-1]).items():
            times = tally["middle_ms" if numbers == "bad" else "longest_ms"]
            slowest = max(times, key=times.__getitem__)
            records.append(
                {
                    "solver": solver,
                    "numbers": numbers,
                    "cases": tally["cases"],
                    "median_ms": round(statistics.median(times.values()), 3),
                    "slowest_ms": round(times[slowest], 3),
                    "target_ms": TARGETS[numbers],
                    "slowest": slowest,
                }
            )
    print(table := common.markdown_table(records, KEYS))
    files = {"bad_numbers.md": table.encode()}
    common.save(records, description, json_file=options.json, out=options.out, files=files)
    return int(any(r["slowest_ms"] > r["target_ms"] for r in records))


if __name__ == "__main__":
    sys.exit(main())
