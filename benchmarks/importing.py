"""How long does it take to import coopqp, and until its first step?

Each contestant is a fresh process; they take turns. Modules are compiled before, as in every second process of a user,
whatever PYTHONDONTWRITEBYTECODE says. ``names`` is the first line of a control program: controller,
loop, recording, monitor and a ready cell. ``first_step`` goes on to a controller's first step. Medians of CPU time, and
of time on the clock beside them; ``beyond_s`` is what such a process takes beyond an empty one, or beyond Pinocchio
alone. See benchmarks/README.md.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

import common
import numpy as np
from common import Record

KEYS = ("what", "cpu_s", "clock_s", "beyond", "beyond_s", "target_s", "rounds")
ROUNDS, QUICK = 11, 3
_NAMES = (
    "from coopqp import Grasp, QPController, Recording, RobotCell, simulate; "
    "from coopqp.scenarios import paper_lift; from coopqp.simulation import Monitor"
)
CONTESTANTS = {
    "nothing": "",
    "pinocchio": "import pinocchio",
    "coopqp": "import coopqp",
    "names": _NAMES,
    "first_step": f"{_NAMES}\ns = paper_lift()\n"
    "controller = QPController(s.cell, s.grasp, s.path, dt=s.dt)\ncontroller.reset(s.q_start)\ncontroller.step()",
}
#: Targets: the contestant beyond which the time counts, which clock, and the most [s].
TARGETS = {
    "coopqp": ("nothing", "clock", 0.03),
    "names": ("pinocchio", "cpu", 0.25),
    "first_step": ("nothing", "clock", 0.8),
}
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def timed(program: str) -> tuple[float, float]:
    """CPU time and time on the clock of a fresh process [s]."""
    before, began = os.times(), time.perf_counter()
    subprocess.run([sys.executable, "-c", program], check=True, env=ENVIRONMENT)
    after, clock = os.times(), time.perf_counter() - began
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return cpu, clock


def main(argv: list[str] | None = None) -> int:
    """Measure and print. Returns 1 if a target is missed."""
    options = common.arguments(__doc__.partition("\n")[0]).parse_args(argv)
    rounds = QUICK if options.quick else ROUNDS
    description = common.describe("Imports", {"rounds": rounds})
    print(common.header(description))
    for program in CONTESTANTS.values():
        timed(program)  # files come into the cache
    samples: dict[str, list[tuple[float, float]]] = {name: [] for name in CONTESTANTS}
    for _ in range(rounds):
        for name, program in CONTESTANTS.items():
            samples[name].append(timed(program))
    medians = {
        name: dict(zip(("cpu", "clock"), np.median(times, axis=0), strict=True)) for name, times in samples.items()
    }
    records: list[Record] = []
    for name, median in medians.items():
        other, clock, most = TARGETS.get(name, (None, "cpu", None))
        records.append(
            {
                "what": name,
                "cpu_s": round(float(median["cpu"]), 3),
                "clock_s": round(float(median["clock"]), 3),
                "beyond": f"{other}, {clock}" if other else None,
                "beyond_s": round(float(median[clock] - medians[other][clock]), 3) if other else None,
                "target_s": most,
                "rounds": rounds,
            }
        )
    table = common.markdown_table(records, KEYS)
    print(table)
    common.save(records, description, json_file=options.json, out=options.out, files={"importing.md": table.encode()})
    return int(any(r["target_s"] is not None and r["beyond_s"] > r["target_s"] for r in records))


if __name__ == "__main__":
    sys.exit(main())
