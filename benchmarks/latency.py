"""The longest time of a step: the tail of its distribution, compared with an empty loop, and garbage collector pauses.

A step is ``step(reading)``, its status, and its next command as an array. Records of the first kind, CPU time of the
thread [µs], in turn with a null spin of about the same length, whose tail is the machine's (``case`` "null spin: …").
Left out are the first steps of a turn, which find the caches cold, and the first one after a reset, which is
``first_us`` below:

``nominal``   three arms round a ring, always within the limits;
``measured``  the same, with readings one sample late and noisy, which the supervision watches;
``watched``   the same, and the force at the grasps is read from the servos;
``slowed``    a zigzag at 0.6 m/s with joints limited to 1 rad/s: slowed at most steps;
``corner``    the same with joints limited to 10 rad/s² too: the preview brakes ahead of every corner;
``qp``        a QP at every step of the zigzag;
``pole``      three arms past a wrist singularity, missed by 2 mrad, 5 rad/s²: the preview needs many small cells;
``own``       nominal, with a user's own constraint in Python, whose own time is left out;
``few: …``    the ready scenarios whose arms have fewer than six joints.

Records ``1 kHz: …`` are of the same steps, one every millisecond, when caches have gone cold.
``ratio`` is p99.9 / p50. Records of the second kind (``case`` "lap: …") are of one lap from reset to the path's end,
each step the median of the same step in several laps: their own time, without the machine's part.
``first_us`` is the first step after a reset, which ``max_us`` and the percentiles leave out. Records of the third kind
(``case`` "garbage: …") have 10⁶ objects alive besides, with and without ``gc.freeze()``, the steps dropped or kept by
the caller: ``gc_pause_ms`` is the longest pause, ``collections`` how many there were, ``full`` how many of them of
everything, ``unreachable`` how many objects they freed.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from common import Record
from peer_cases import NOISE, READ, options_of

from coopqp import ControlStep, QPController, Rank, Status
from coopqp.model import CellState
from coopqp.scenarios import Scenario, at_singularity, conveyor, five_joint_pins, positioner, scara_pair
from coopqp.spatial import Array

ARMS = 3
FEW = {f"few: {make.__name__}": make for make in (positioner, conveyor, scara_pair, five_joint_pins)}
CASES = ("nominal", "measured", "watched", "slowed", "corner", "qp", "pole", "own", *FEW)
KEYS = (
    "case", "arms", "p50_us", "p99_us", "p999_us", "max_us", "ratio", "steps", "first_us",
    "gc_pause_ms", "collections", "full", "unreachable",
)  # fmt: skip
ACCELERATION = 10.0
#: Number of omitted steps at the beginning of a turn.
WARM_UP = 20
#: Targets: p99.9 in multiples of p50, the longest pause of the collector [ms], and, by themselves, the first step after
#: a reset and the longest one past a pole [µs].
RATIO, PAUSE_MS, LONGEST_US = 3.0, 1.0, 150.0
#: Targets: p50 and p99 of arms with few joints at 1 kHz, and p50 beyond a user's own constraint [µs].
FEW_US, FEW_P99_US, OWN_US = 40.0, 100.0, 200.0
#: Period of the paced steps [s].
PERIOD = 1e-3
_NO_COMMAND = (Status.HOLDING, Status.FAULT)
cpu = time.thread_time_ns


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Numbers of steps per tail, per turn, at 1 kHz, of laps, of steps with garbage, and of other objects."""

    steps: int = 100_000
    block: int = 1000
    paced: int = 4000
    laps: int = 15
    garbage_steps: int = 50_000
    alive: int = 1_000_000


FULL = Plan()
QUICK = Plan(steps=2000, block=500, paced=400, laps=3, garbage_steps=5000)


def scenario_of(case: str) -> Scenario:
    """The task of a case."""
    if case in ("nominal", "measured", "watched", "own"):
        return common.ring(arms=ARMS)
    if case in FEW:
        return FEW[case]()
    if case == "pole":
        return at_singularity("wrist", 0, acceleration=5.0, miss=2e-3)
    zigzag = common.ring(arms=ARMS, path="zigzag")
    if case == "corner":
        return replace(zigzag, cell=zigzag.cell.with_limits(acceleration=ACCELERATION))
    return zigzag


class Ceiling:
    """A height that the first arm's tool keeps below, as a user writes it; far above here.

    Attributes:
        spent_ns: CPU time inside, all in all.
    """

    name, rank, spent_ns = "ceiling", Rank.LIMITS, 0

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        began = cpu()
        G = np.zeros((1, state.cell.nv))
        G[0, state.cell.v_slices[0]] = state.jacobian(0, pin.LOCAL_WORLD_ALIGNED)[2]
        room = 3.0 - state.T_world_tool[0].translation[2]
        self.spent_ns += cpu() - began
        return G, np.array([-np.inf]), np.array([room / dt])


class Loop:
    """Steps of one controller, timed one by one; ``last`` is the latest."""

    last: ControlStep
    _before: Array
    _command: Array

    def __init__(self, case: str) -> None:
        task = self._task = scenario_of(case)
        self._own = Ceiling()
        self.controller = QPController(
            task.cell, task.grasp, task.path, dt=task.dt, options=options_of(case, task.dt),
            constraints=[self._own] if case == "own" else (),
        )  # fmt: skip
        self._noise: Array | None = None
        if case in READ:
            self._noise = np.random.default_rng(0).uniform(-NOISE, NOISE, (997, task.cell.nq))
        self._count = 0
        self._restart()

    def block(self, size: int, period: float = 0.0) -> list[float]:
        """CPU time of ``size`` steps in motion [µs], a period apart [s]; without one they follow one another."""
        samples: list[float] = []
        due = time.perf_counter()
        for number in range(-WARM_UP, size):
            if period and number >= 0:
                due = max(due + period, time.perf_counter())
                time.sleep(max(0.0, due - time.perf_counter()))
            time_us, finished = self.step()
            if number >= 0:
                samples.append(time_us)
            if finished:
                self._restart()
                self.step()
        return samples

    def lap(self) -> list[float]:
        """CPU time of every step from a reset to the path's end [µs]."""
        self._restart()
        self._count, samples, finished = 0, [], False
        while not finished:
            time_us, finished = self.step()
            samples.append(time_us)
        return samples

    def step(self) -> tuple[float, bool]:
        """CPU time of one step [µs], and whether it is the path's last."""
        self._count += 1
        reading = None if self._noise is None else self._before + self._noise[self._count % len(self._noise)]
        run, spent = self.controller.step, self._own.spent_ns
        began = cpu()
        result = run(reading)
        command = result.q_next if result.status not in _NO_COMMAND else None
        time_us = 1e-3 * (cpu() - began - (self._own.spent_ns - spent))
        if command is None:
            raise RuntimeError(result.explain())
        self._before, self._command, self.last = self._command, np.array(command), result
        return time_us, result.finished

    def _restart(self) -> None:
        self.controller.reset(self._task.q_start)
        self._before = self._command = self._task.q_start


class Spin:
    """An empty loop of about the length of a step. Its tail is due to the machine."""

    def __init__(self, length_us: float) -> None:
        self._turns = 1
        while np.median(self.block(200)) < length_us:
            self._turns += max(1, self._turns // 16)

    def block(self, size: int) -> list[float]:
        """CPU time of ``size`` loops [µs]."""
        turns, samples = range(self._turns), []
        for _ in range(WARM_UP + size):
            began = cpu()
            for _ in turns:
                pass
            samples.append(1e-3 * (cpu() - began))
        return samples[WARM_UP:]


def tail(samples: Any) -> Record:
    """Percentiles and the largest sample [µs]."""
    values = np.asarray(samples)
    return {**common.percentiles(values, shares=(50.0, 99.0, 99.9)), "max_us": round(float(values.max()), 3)}


def tails(plan: Plan, cases: Sequence[str], progress: common.Progress) -> tuple[list[Record], dict[str, Array]]:
    """One record per case and spin; and all samples [µs] by case."""
    turns: dict[str, Callable[[], Iterable[float]]] = {}
    for case in cases:
        loop = Loop(case)
        length = float(np.median(loop.block(min(plan.block, 400))))
        turns[case] = partial(loop.block, plan.block)
        turns[f"null spin: {case}"] = partial(Spin(length).block, plan.block)
    number = max(1, plan.steps // plan.block)
    samples = common.interleaved(turns, rounds=number, progress=progress, frozen=True)
    records = []
    for case, times in samples.items():
        arms = len(scenario_of(case.removeprefix("null spin: ")).cell)
        row = {"case": case, "arms": arms, **tail(times), "steps": times.size}
        records.append({**row, "ratio": round(row["p999_us"] / row["p50_us"], 2)})
    return records, samples


def paced(plan: Plan, cases: Sequence[str], progress: common.Progress) -> list[Record]:
    """One record per case at 1 kHz."""
    records = []
    for case in cases:
        progress.advance(f"1 kHz: {case}")
        loop = Loop(case)
        row = {"case": f"1 kHz: {case}", "arms": len(loop.controller.cell), **tail(loop.block(plan.paced, PERIOD))}
        records.append({**row, "ratio": round(row["p999_us"] / row["p50_us"], 2), "steps": plan.paced})
    return records


def laps(plan: Plan, cases: Sequence[str], progress: common.Progress) -> list[Record]:
    """One record per case: medians of the same step over the laps."""
    records = []
    for case in cases:
        loop = Loop(case)
        first, *rest = np.median([loop.lap() for _ in range(plan.laps)], axis=0)
        row = {"case": f"lap: {case}", "arms": len(loop.controller.cell), **tail(rest), "steps": len(rest)}
        records.append(row | {"ratio": round(row["p999_us"] / row["p50_us"], 2), "first_us": round(first, 1)})
        progress.advance(f"lap: {case}")
    return records


# -- garbage -----------------------------------------------------------------------------------------------------------


@dataclass
class Pauses:
    """Activity of the collector."""

    longest_ms: float = 0.0
    collections: int = 0
    full: int = 0
    unreachable: int = 0


@contextmanager
def watched_collector() -> Iterator[Pauses]:
    """Count and time the collections."""
    seen, began = Pauses(), [0]

    def watch(phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            began[0] = time.perf_counter_ns()
            return
        seen.longest_ms = max(seen.longest_ms, 1e-6 * (time.perf_counter_ns() - began[0]))
        seen.collections += 1
        seen.full += info["generation"] == 2
        seen.unreachable += info["collected"] + info["uncollectable"]

    gc.callbacks.append(watch)
    try:
        yield seen
    finally:
        gc.callbacks.remove(watch)


def garbage(plan: Plan, progress: common.Progress) -> list[Record]:
    """The longest pause while a controller runs and the caller keeps many objects."""
    records = []
    for keep in (False, True):
        for frozen in (False, True):
            alive = [[i] for i in range(plan.alive)]
            loop = Loop("measured")
            step, q = loop.controller.step, scenario_of("measured").q_start
            loop.block(100)
            loop.controller.reset(q)
            gc.collect()
            if frozen:
                gc.freeze()
            kept, samples = [], []
            try:
                with watched_collector() as seen:
                    for _ in range(plan.garbage_steps):
                        began = cpu()
                        result = step(q + 0.0)
                        samples.append(1e-3 * (cpu() - began))
                        q = result.q_next
                        if keep:
                            kept.append(result)
            finally:
                gc.unfreeze()
            case = f"garbage: steps {'kept' if keep else 'dropped'}{', frozen' if frozen else ''}"
            row = {"case": case, "arms": ARMS, **tail(samples)}
            row |= {"ratio": round(row["p999_us"] / row["p50_us"], 2), "steps": plan.garbage_steps}
            row |= {"gc_pause_ms": round(seen.longest_ms, 3), "collections": seen.collections}
            records.append({**row, "full": seen.full, "unreachable": seen.unreachable})
            del alive, kept
            progress.advance(case)
    return records


# -- the run -----------------------------------------------------------------------------------------------------------


def verdict(records: Sequence[Record]) -> str:
    """The targets, in words."""
    lines = []
    by_case = {r["case"]: r for r in records}
    for case, r in by_case.items():
        spin = by_case.get(f"null spin: {case}")
        if spin is not None:
            met = "met" if r["ratio"] <= RATIO else "missed"
            alone = by_case[f"lap: {case}"]["ratio"]
            shares = f"p99.9 / p50 = {r['ratio']:.3g} (null spin {spin['ratio']:.3g}, by itself {alone:.3g})"
            lines.append(f"{case}: {shares}: {met}")
    for r in (r for r in longest(records) if r["case"] != "own"):
        for what, key in (("first step after a reset", "first_us"), ("longest step", "longest_us")):
            if key == "first_us" or r["case"] == "pole":
                met = "met" if r[key] <= LONGEST_US else "missed"
                lines.append(f"{r['case']}: {what}, by itself, {r[key]:.3g} µs: {met}")
    bounds = [(f"1 kHz: {case}", key, most) for case in FEW for key, most in (("p50", FEW_US), ("p99", FEW_P99_US))]
    for case, key, most in (*bounds, ("own", "p50", OWN_US)):
        if found := by_case.get(case):
            met = "met" if found[f"{key}_us"] <= most else "missed"
            lines.append(f"{case}: {key} {found[f'{key}_us']:.3g} µs (≤ {most:g}): {met}")
    dropped = [r for r in records if r["case"].startswith("garbage: steps dropped")]
    if dropped:
        pause, freed = max(r["gc_pause_ms"] for r in dropped), sum(r["unreachable"] for r in dropped)
        met = "met" if pause <= PAUSE_MS and freed == 0 else "missed"
        lines.append(f"steps dropped by the caller: longest pause {pause:.3g} ms, {freed} unreachable objects: {met}")
    return "\n".join(f"- {line}" for line in lines)


def longest(records: Sequence[Record]) -> list[Record]:
    """The first step after a reset and the longest of the others, by themselves, of every case."""
    return [
        {
            "case": r["case"].removeprefix("lap: "),
            "first_us": r["first_us"],
            "longest_us": r["max_us"],
        }
        for r in records
        if r["case"].startswith("lap: ")
    ]


def report(records: Sequence[Record]) -> str:
    """Three tables and the targets."""
    latency = [r for r in records if "gc_pause_ms" not in r or r["gc_pause_ms"] is None]
    pauses = [r for r in records if r["gc_pause_ms"] is not None]
    return "\n\n".join(
        [
            "## A step (CPU time of the thread; ratio: p99.9 / p50)",
            common.markdown_table(latency, KEYS[: KEYS.index("gc_pause_ms")]),
            "## The first step after a reset, and the longest of the others (medians of the same step in several laps)",
            common.markdown_table(longest(records), ("case", "first_us", "longest_us")),
            "## Garbage collection beside 10⁶ live objects (time: wall)",
            common.markdown_table(pauses, ("case", "p50_us", "max_us", *KEYS[KEYS.index("gc_pause_ms") :])),
            f"## Targets: p99.9 ≤ {RATIO:g} × p50, no pause over {PAUSE_MS:g} ms by the library's own garbage, "
            f"≤ {LONGEST_US:g} µs for a first step and past a pole",
            verdict(records),
        ]
    )


def plot(samples: dict[str, Array]) -> dict[str, bytes]:
    """Share of steps above a time, over the time; dashed for null spins of the same length."""
    curves, spins = {}, {}
    for case, times in samples.items():
        shares = np.geomspace(0.5, 1.0 / times.size, 20)
        curves[case] = [(float(share), float(np.quantile(times, 1.0 - share))) for share in shares]
        if case.startswith("null spin: "):
            spins[case] = case.removeprefix("null spin: ")
    ordered = dict(sorted(curves.items(), key=lambda curve: curve[0] in spins))
    return common.log_log_plot(
        "latency.png",
        ordered,
        x="share of the steps that take longer (dashed: a loop that does nothing, of the same length)",
        y="CPU time [µs]",
        ticks=[10.0**-k for k in range(1, 6) if any(x <= 10.0**-k for points in curves.values() for x, _ in points)],
        dashed=spins,
    )


def measure(plan: Plan, cases: Sequence[str] = CASES) -> tuple[list[Record], dict[str, Array]]:
    """All records, and the samples of the tails."""
    turns = 2 * len(cases) * max(1, plan.steps // plan.block)
    progress = common.Progress(turns + 2 * len(cases) + 4, label="tails")
    records, samples = tails(plan, cases, progress)
    records += paced(plan, cases, progress)
    records += laps(plan, cases, progress)
    records += garbage(plan, progress)
    progress.close()
    return [{key: r.get(key) for key in KEYS} for r in records], samples


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES, help="which cases (all)")
    args = parser.parse_args(argv)
    plan = QUICK if args.quick else FULL
    settings = {"arms": ARMS, "dt": "1 ms", "steps": plan.steps, "a block": plan.block, "objects alive": plan.alive}
    settings |= {"garbage": "gc.freeze() before, collector on", "clock": "CPU time of the thread"}
    description = common.describe("latency", settings)
    print(common.header(description), flush=True)
    records, samples = measure(plan, args.cases)
    text = report(records)
    print("\n" + text)
    files = {"latency.md": (text + "\n").encode(), **plot(samples)} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
