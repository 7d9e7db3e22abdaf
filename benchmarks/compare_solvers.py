"""Every installed QP solver on recorded QPs: persistent and rebuilt, warm and cold.

The time of ``solve`` includes the checks before and after it. It is CPU time of the thread, without other processes.
See benchmarks/README.md.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import common  # first: it limits BLAS to one thread
import numpy as np
from backend_alone import backend_alone
from common import Record
from recorded_qps import Recorded, RecordedQp, export, record

from coopqp.solvers import QpSolver, available_solvers, make_solver
from coopqp.spatial import Array

KEYS = (
    "solver",
    "mode",
    "case",
    "arms",
    "p50_us",
    "p99_us",
    "p999_us",
    "max_us",
    "failures",
    "error_rad_s",
    "chain_mm",
    # additional keys
    "start",
    "solves",
    "iterations",
    "without_answer",
    "message",
)
#: Persistent solvers, and those among them that qpsolvers does not know.
KEPT, ONLY_KEPT = ("ldp", "proxqp", "osqp"), ("ldp",)
#: Backends with solutions that are exact up to rounding. Their best solution is the reference.
ACTIVE_SET = ("ldp", "daqp", "quadprog")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Recordings as (case, arms, number of QPs), and rounds of at most ``round_s`` seconds."""

    recordings: tuple[tuple[str, int, int], ...]
    rounds: int
    round_s: float


FULL = Plan(
    recordings=(
        *((case, 3, 250) for case in ("nominal", "saturated", "corner", "near_singular", "elbow")),
        *((case, 3, 250) for case in ("outside", "mismatch", "redundant")),
        *((case, arms, count) for arms, count in ((8, 100), (16, 50), (32, 25)) for case in ("nominal", "saturated")),
    ),
    rounds=4,
    round_s=0.12,
)
QUICK = Plan(
    recordings=(
        *((case, 3, 60) for case in ("nominal", "saturated", "near_singular", "outside", "mismatch")),
        ("saturated", 8, 20),
        ("saturated", 32, 4),
    ),
    rounds=2,
    round_s=0.06,
)


@dataclass(frozen=True, kw_only=True)
class Way:
    """One way to solve: a solver with its settings and its start."""

    solver: str
    mode: str
    start: str

    @property
    def name(self) -> str:
        return f"{self.solver} {self.mode} {self.start}"

    def make(self) -> QpSolver:
        """A new solver."""
        return make_solver(self.solver if self.mode == "kept" else f"qpsolvers:{self.solver}")


def ways() -> list[Way]:
    """Persistent solvers warm and from scratch, and all backends rebuilt by qpsolvers."""
    found = []
    for solver in available_solvers():
        if solver in KEPT:
            found += [Way(solver=solver, mode="kept", start=start) for start in ("warm", "cold")]
        if solver not in ONLY_KEPT:
            found.append(Way(solver=solver, mode="rebuilt", start="cold"))
    return found


class Run:
    """One way to solve, on one recording."""

    def __init__(self, way: Way, qps: Sequence[RecordedQp], best: Sequence[Array | None], round_s: float) -> None:
        self.way, self._qps, self._best, self._round_s = way, qps, best, round_s
        self._solver, self._next = way.make(), 0
        self.failures = self.iterations = self.solves = 0
        self.error = self.chain_mm = 0.0
        self.message = ""

    def round(self) -> Iterable[float]:
        """Solve successive QPs until the end of the round; yields times [µs]."""
        solver, warm = self._solver, self.way.start == "warm"
        samples = []
        ends = time.perf_counter() + self._round_s
        while True:
            i = self._next
            self._next = (i + 1) % len(self._qps)
            if i == 0 or not warm:
                solver.reset()
            if i == 0 and warm:
                solver.solve(self._qps[-1 if len(self._qps) == 1 else 1].problem)  # the first solve is cold
            qp = self._qps[i]
            began = time.thread_time_ns()
            solution = solver.solve(qp.problem)
            samples.append(1e-3 * (time.thread_time_ns() - began))
            self.solves += 1
            self.iterations += solution.iterations
            if not solution.usable:
                self.failures += 1
                self.message = self.message or solution.message
            else:
                self._judge(qp, solution.x, self._best[i])
            if time.perf_counter() > ends:
                return samples

    def _judge(self, qp: RecordedQp, x: Array, best: Array | None) -> None:
        if best is not None:
            dv = qp.velocity(x) - best
            self.error = max(self.error, float(np.abs(dv).max()))
            self.chain_mm = max(self.chain_mm, qp.chain_mm(dv))


def best_answers(recorded: Recorded) -> list[Array | None]:
    """Velocities (nv,) of the active-set solution with the smallest KKT residual; None without a solution."""
    names = [name for name in ACTIVE_SET if name in available_solvers()]
    answers: list[Array | None] = []
    for qp in recorded.qps:
        least, best = np.inf, None
        for name in names:
            solution = make_solver(name).solve(qp.problem)
            residual = max(
                solution.primal_residual(qp.problem),
                solution.dual_residual(qp.problem),
                solution.complementarity(qp.problem),
            )
            if solution.usable and residual < least:
                least, best = residual, qp.velocity(solution.x)
        answers.append(best)
    return answers


def compare(plan: Plan) -> tuple[list[Record], list[Recorded]]:
    """Solve everything. Returns records and recordings."""
    each = ways()
    progress = common.Progress(len(plan.recordings) * (1 + len(each) * plan.rounds))
    records: list[Record] = []
    recordings: list[Recorded] = []
    for case, arms, count in plan.recordings:
        progress.label = f"recording {case}, {arms} arms"
        progress.show()
        one = record(case, arms, count)
        progress.advance()
        recordings.append(one)
        answers = best_answers(one)
        runs = {way.name: Run(way, one.qps, answers, plan.round_s) for way in each}
        gc.collect()
        gc.disable()
        try:
            rounds = {name: partial(run.round) for name, run in runs.items()}
            samples = common.interleaved(rounds, rounds=plan.rounds, progress=progress)
        finally:
            gc.enable()
        missing = sum(answer is None for answer in answers)
        records += [_record(run, one, samples[name], missing) for name, run in runs.items()]
    progress.close()
    return records, recordings


def _record(run: Run, one: Recorded, samples: Array, missing: int) -> Record:
    way, solved = run.way, run.solves > run.failures
    return {
        "solver": way.solver,
        "mode": way.mode,
        "case": one.case,
        "arms": one.arms,
        **common.percentiles(samples, shares=(50.0, 99.0, 99.9)),
        "max_us": round(float(samples.max()), 3),
        "failures": run.failures,
        "error_rad_s": run.error if solved else None,
        "chain_mm": run.chain_mm if solved else None,
        "start": way.start,
        "solves": run.solves,
        "iterations": round(run.iterations / run.solves, 1),
        "without_answer": missing,
        "message": run.message,
    }


def kept_ratios(records: Sequence[Record]) -> list[Record]:
    """Ratio of the medians persistent and warm / rebuilt, for the same recording."""
    times = {(r["solver"], r["case"], r["arms"], r["mode"], r["start"]): r for r in records}
    found = []
    for (solver, case, arms, mode, start), r in times.items():
        if (mode, start) == ("kept", "warm") and solver not in ONLY_KEPT:
            other = times[solver, case, arms, "rebuilt", "cold"]
            found.append(
                {
                    "solver": solver,
                    "case": case,
                    "arms": arms,
                    "kept_us": r["p50_us"],
                    "rebuilt_us": other["p50_us"],
                    "ratio": round(r["p50_us"] / other["p50_us"], 3),
                    "failures": f"{r['failures']} / {other['failures']}",
                }
            )
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--export", type=Path, metavar="DIR", help="write the QPs as a test set for qpbenchmark")
    args = parser.parse_args(argv)
    plan = QUICK if args.quick else FULL
    settings = {
        "solvers": ", ".join(available_solvers()),
        "clock": "CPU time of the thread",
        "rounds": plan.rounds,
        "round": f"{plan.round_s} s",
        "settings": "defaults",
    }
    description = common.describe("compare_solvers", settings)
    print(common.header(description), flush=True)
    records, recordings = compare(plan)
    ratios, alone = kept_ratios(records), backend_alone([one for one in recordings if one.arms == 3])
    text = "\n\n".join(
        [
            "## Solvers on recorded QPs\n",
            common.markdown_table(records, KEYS),
            "## Kept over rebuilt (medians; failures kept / rebuilt)\n",
            common.markdown_table(ratios, list(ratios[0])),
            "## The same for the backends' calls alone: no tests, 3 arms\n",
            common.markdown_table(alone, list(alone[0])),
        ]
    )
    print("\n" + text)
    files = {"solvers.md": (text + "\n").encode()} if args.out is not None else None
    written = common.save(records, description, json_file=args.json, out=args.out, files=files)
    if args.export is not None:
        written += export(recordings, args.export)[:1]
    for file in written:
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
