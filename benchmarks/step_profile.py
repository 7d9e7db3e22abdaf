"""A step from Python beside the compiled core alone, and where the time of the plain definition goes.

Arms round a ring. ``step``: ``step(reading)`` of a controller, its status and its next command as an array.
``core alone``: the same steps by the same core without Python in between; readings are handed over one by one, so that
measured steps have a call each. Both start with a reset before each block and take turns; means of a block.
``profile``: each part of the plain definition's steps without the parts inside it. See benchmarks/README.md.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from unittest.mock import patch

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases
from common import Record

from coopqp import ControlStep, QPController
from coopqp.control import LinearisedStep, PathPreview, PlainLoop, StepProgram, StepSolver, VelocityBox
from coopqp.model import Chain
from coopqp.native import available_kernels
from coopqp.solvers import QpSolver
from coopqp.spatial import Array

KEYS = ("what", "case", "arms", "step_us", "core_us", "ratio", "met", "part", "p50_us", "share", "samples")
#: Target: a step from Python in multiples of the core alone.
RATIO = 3.0
#: Cases of the comparison and of the profile, see :mod:`peer_cases`.
CASES, PROFILED = ("nominal", "measured", "qp"), ("nominal", "measured", "zigzag", "qp")
#: Methods and functions of the plain definition, and their parts. What else they call is in the part of the caller.
PARTS: tuple[tuple[Any, str, str], ...] = (
    (PlainLoop, "observe", "observe"),
    *((PathPreview, name, "preview") for name in ("cap", "reference")),
    *((Chain, name, "kinematics") for name in ("carried", "evaluate")),
    (sys.modules[PlainLoop.__module__], "view_errors", "errors"),
    (Chain, "invert", "inverse"),
    (VelocityBox, "update", "box"),
    (LinearisedStep, "answer", "corrections"),
    (StepSolver, "answer", "ranks"),
    (StepProgram, "pieces", "pieces"),
    *((StepProgram, name, "QP") for name in ("condensed", "read_condensed")),
    (QpSolver, "solve", "solver"),
    (PlainLoop, "propose", "rate and path"),
    (PlainLoop, "commit", "commit"),
    (ControlStep, "__init__", "ControlStep"),
    (QPController, "step", "rest"),
)
#: Steps after a reset that do not count.
WARM_UP = 20


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Numbers of arms, of blocks and of steps per block, and of profiled steps."""

    arms: tuple[int, ...] = (3, 8, 16)
    blocks: int = 100
    steps: int = 200
    profiled: int = 1500


FULL, QUICK = Plan(), Plan(blocks=15, profiled=200)


class Loop:
    """A controller of one case, and its readings from a reset on."""

    def __init__(self, case: str, arms: int, steps: int, kernel: str) -> None:
        built = peer_cases.build(case, arms)
        s, options = built.scenario, replace(built.options, kernel=kernel)
        self.controller = QPController(s.cell, s.grasp, s.path, dt=s.dt, options=options)
        self._q_start, self._readings = s.q_start, [None] * (WARM_UP + steps)  # type: tuple[Array, list[Array | None]]
        if built.noise is not None:  # the command of one sample ago with noise
            noise = np.random.default_rng(0).uniform(-built.noise, built.noise, (WARM_UP + steps, s.cell.nq))
            self.controller.reset(s.q_start)
            before = command = s.q_start
            for i, row in enumerate(noise):
                self._readings[i] = before + row
                before, command = command, np.array(self.controller.step(self._readings[i]).q_next)

    def block(self, run: Callable[[Sequence[Array | None]], object]) -> list[float]:
        """Mean CPU time of the same steps in each call [µs]."""
        self.controller.reset(self._q_start)
        run(self._readings[:WARM_UP])
        readings = self._readings[WARM_UP:]
        began = time.thread_time_ns()
        run(readings)
        return [1e-3 * (time.thread_time_ns() - began) / len(readings)]

    def from_python(self, readings: Sequence[Array | None]) -> None:
        """Steps with their status and their next command."""
        step = self.controller.step
        for reading in readings:
            result = step(reading)
            _ = result.status, result.q_next

    def core_alone(self, readings: Sequence[Array | None]) -> None:
        """The same steps without Python's part."""
        loop: Any = self.controller._loop
        advance, n = loop._core.advance, len(readings)
        if n != (advance(n, None) if readings[0] is None else sum(advance(1, reading) for reading in readings)):
            raise RuntimeError("the core left a step open")


def compare(plan: Plan, case: str, arms: int, progress: common.Progress) -> Record:
    """Medians of a step from Python, of the core alone, and of the ratio of successive blocks."""
    loop = Loop(case, arms, plan.steps, "compiled")
    both = {"step": partial(loop.block, loop.from_python), "core alone": partial(loop.block, loop.core_alone)}
    step, core = common.interleaved(both, rounds=plan.blocks, progress=progress, frozen=True).values()
    medians = [round(float(np.median(times)), 3) for times in (step, core, step / core)]
    values = ("step / core alone", case, arms, *medians, medians[2] <= RATIO)
    return dict(zip(KEYS, values, strict=False), samples=plan.blocks)


class Stopwatch:
    """Time of every part without the parts inside it; one row per step [ns]."""

    def __init__(self) -> None:
        self.rows: list[dict[str, int]] = []
        self._now: dict[str, int] = {}
        self._inside: list[int] = []

    def watch(self, owner: Any, name: str, part: str) -> None:
        """Count calls of this method of an object or a class as the part."""
        original = getattr(owner, name)
        clock, inside = time.perf_counter_ns, self._inside

        def timed(*args: Any, **keywords: Any) -> Any:
            inside.append(0)
            began = clock()
            try:
                return original(*args, **keywords)
            finally:
                took = clock() - began
                self._now[part] = self._now.get(part, 0) + took - inside.pop()
                if inside:
                    inside[-1] += took

        setattr(owner, name, timed)

    def next_row(self) -> None:
        """End the row of the present step."""
        self.rows.append(self._now.copy())
        self._now.clear()


def profile(case: str, plan: Plan) -> list[Record]:
    """Medians of the parts of successive steps of three arms."""
    loop, watch = Loop(case, 3, plan.profiled, "plain"), Stopwatch()

    def steps(readings: Sequence[Array | None]) -> None:
        for reading in readings:
            loop.controller.step(reading)
            watch.next_row()

    with ExitStack() as restored:
        for owner, name, part in PARTS:
            restored.enter_context(patch.object(owner, name, getattr(owner, name)))
            watch.watch(owner, name, part)
        loop.block(steps)
    rows = watch.rows[-plan.profiled :]
    times = {part: 1e-3 * float(np.median([row.get(part, 0) for row in rows])) for _, _, part in PARTS}
    keys = {"what": "profile", "case": case, "arms": 3, "samples": len(rows)}
    shares = np.array(list(times.values())) / sum(times.values())
    return [{**keys, "part": p, "p50_us": times[p], "share": float(x)} for p, x in zip(times, shares, strict=True)]


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    args = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    plan = QUICK if args.quick else FULL
    description = common.describe("step_profile", {"dt": "1 ms", "clock": "CPU time of the thread", **vars(plan)})
    print(common.header(description), flush=True)
    pairs = [(case, arms) for case in CASES for arms in plan.arms if "compiled" in available_kernels()]
    progress = common.Progress(2 * plan.blocks * len(pairs))
    compared = [compare(plan, *pair, progress) for pair in pairs]
    progress.close()
    profiles = [record for case in PROFILED for record in profile(case, plan)]
    records = [{key: r.get(key) for key in KEYS} for r in (*compared, *profiles)]
    table: dict[str, Record] = {}
    for r in profiles:
        table.setdefault(r["part"], {"part": r["part"]})[r["case"]] = r["p50_us"]
    text = f"## Target: a step from Python ≤ {RATIO:g} × the core alone (medians)\n\n"
    text += common.markdown_table(compared, KEYS[1 : KEYS.index("part")])
    text += "\n\n## The plain definition, three arms (medians [µs], wall; the stopwatch costs about 0.3 µs a call)\n\n"
    text += common.markdown_table(list(table.values()), ("part", *PROFILED)) + "\n"
    print("\n" + text)
    written = {"step_profile.md": text.encode()}
    for file in common.save(records, description, json_file=args.json, out=args.out, files=written):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
