"""Targets that move at run time: how far is the object off its path, and how far behind?

See benchmarks/README.md.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
import target_cases as cases
from common import Record

from coopqp import QPController, ServoPath
from coopqp.scenarios import Scenario

KEYS = (
    "case", "targets", "acceleration", "hertz", "seed", "chain_mm", "off_path_mm", "flips", "nameless", "swing_mm",
    "lag_mm", "retarget_us",
)  # fmt: skip
#: Acceleration limits of all joints [rad/s² or m/s²].
ACCELERATIONS = (5.0, np.inf)
#: Seeds of a case.
SEEDS, QUICK_SEEDS = 20, 1
#: Number of targets whose cost is measured; each round takes the least.
TIMED, ROUND = 400, 8


def tasks(seeds: int, names: Sequence[str]) -> Iterator[tuple[str, str, float, int, int]]:
    """Every run: cell, kind of targets, acceleration limit, targets a second, seed."""
    kinds = (cases.IN_REACH, cases.OUT_OF_REACH)
    yield from itertools.product(names, kinds, ACCELERATIONS, cases.STEPS_PER_S, range(seeds))


def measured(name: str, kind: str, acceleration: float, hertz: int, seed: int) -> Record:
    """What came of a run."""
    seen = cases.chase(cases.CELLS[name](), kind, acceleration, hertz, seed)
    found = {
        "case": name, "targets": kind, "acceleration": acceleration if np.isfinite(acceleration) else None,
        "hertz": hertz, "seed": seed, "chain_mm": 1e3 * seen.apart, "off_path_mm": 1e3 * seen.off,
        "flips": seen.flips, "nameless": seen.nameless, "swing_mm": 1e3 * seen.swing,
        "lag_mm": 1e3 * float(np.median(seen.lags)) if seen.lags else None,
    }  # fmt: skip
    return {**dict.fromkeys(KEYS), **found}


def cost(name: str, make: Callable[[], Scenario], acceleration: float) -> Record:
    """Time of a new target: the median of the least of some in a row [µs]."""
    task = make()
    cell, start, dt = task.cell.with_limits(acceleration=acceleration), task.path.pose(0.0), 1e-3
    controller = QPController(cell, task.grasp, ServoPath(start), dt=dt)
    controller.reset(task.q_start)
    times = np.empty(TIMED)
    for i in range(TIMED):
        angle = cases.SPEED * i * dt / 0.1
        goal = pin.SE3(start.rotation, start.translation + 0.1 * np.array([np.sin(angle), np.cos(angle) - 1.0, 0.0]))
        began = time.perf_counter()
        controller.retarget(goal)
        times[i] = time.perf_counter() - began
        controller.step()
    least = times.reshape(-1, ROUND).min(axis=1)
    found = {"case": f"cost: {name}", "targets": cases.IN_REACH, "hertz": 1000, "retarget_us": 1e6 * np.median(least)}
    limit = acceleration if np.isfinite(acceleration) else None
    return {**dict.fromkeys(KEYS), **found, "acceleration": limit}


def summary(records: Sequence[Record]) -> list[Record]:
    """A line per kind of targets, limit and stream, over all cells and seeds."""
    lines = []
    groups = itertools.product(
        (cases.IN_REACH, cases.OUT_OF_REACH), (*(a if np.isfinite(a) else None for a in ACCELERATIONS),),
        cases.STEPS_PER_S,
    )  # fmt: skip
    for kind, acceleration, hertz in groups:
        own = [
            r
            for r in records
            if (r["targets"], r["acceleration"], r["hertz"]) == (kind, acceleration, hertz) and r["seed"] is not None
        ]
        lags = [r["lag_mm"] for r in own if r["lag_mm"] is not None]
        line: Record = {"targets": kind, "limits": f"{acceleration:g} rad/s²" if acceleration else "none", "Hz": hertz}
        line |= {"runs": len(own)}
        line |= {key: max(r[key] for r in own) for key in ("chain_mm", "off_path_mm", "swing_mm")}
        line |= {key: sum(r[key] for r in own) for key in ("flips", "nameless")}
        lines.append(line | {"lag_mm": float(np.median(lags)) if lags else None})
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    args = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    names = ("paper_lift", "dual_arm7") if args.quick else tuple(cases.CELLS)
    runs = list(tasks(QUICK_SEEDS if args.quick else SEEDS, names))
    description = common.describe("targets", {"runs": len(runs), "seconds": cases.SECONDS})
    print(common.header(description), flush=True)
    progress = common.Progress(len(runs) + 2 * len(names))
    records = []
    for name, acceleration in itertools.product(names, ACCELERATIONS):
        records.append(cost(name, cases.CELLS[name], acceleration))
        progress.advance(f"cost of a target: {name}")
    for run in runs:
        records.append(measured(*run))
        progress.advance(run[0])
    progress.close()
    lines, costs = summary(records), [r for r in records if r["retarget_us"] is not None]
    text = "## Targets that move\n\n" + common.markdown_table(lines, tuple(lines[0])) + "\n"
    text += "\nA new target costs:\n\n" + common.markdown_table(costs, ("case", "acceleration", "retarget_us")) + "\n"
    print("\n" + text)
    files = {"targets.md": text.encode()} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
