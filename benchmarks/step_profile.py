"""A step from Python beside the core alone.

Arms round a ring. ``step``: ``step(reading)`` of a controller, its status and its next command as an array.
``core alone``: the same steps by the same core without Python in between; readings are handed over one by one, so that
measured steps have a call each. Both start with a reset before each block and take turns; means of a block. See
benchmarks/README.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases
from common import Record

from coopqp import QPController
from coopqp.spatial import Array

KEYS = ("case", "arms", "step_us", "core_us", "ratio", "met", "samples")
#: Target: a step from Python in multiples of the core alone.
RATIO = 3.0
#: Cases, see :mod:`peer_cases`.
CASES = ("nominal", "measured", "qp")
#: Steps after a reset that do not count.
WARM_UP = 20


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Numbers of arms, of blocks, and of steps per block."""

    arms: tuple[int, ...] = (3, 8, 16)
    blocks: int = 100
    steps: int = 200


FULL, QUICK = Plan(), Plan(blocks=15)


class Loop:
    """A controller of one case, and its readings from a reset on."""

    def __init__(self, case: str, arms: int, steps: int) -> None:
        built = peer_cases.build(case, arms)
        s = built.scenario
        self.controller = QPController(s.cell, s.grasp, s.path, dt=s.dt, options=built.options)
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
    loop = Loop(case, arms, plan.steps)
    both = {"step": partial(loop.block, loop.from_python), "core alone": partial(loop.block, loop.core_alone)}
    step, core = common.interleaved(both, rounds=plan.blocks, progress=progress, frozen=True).values()
    medians = [round(float(np.median(times)), 3) for times in (step, core, step / core)]
    return dict(zip(KEYS, (case, arms, *medians, medians[2] <= RATIO, plan.blocks), strict=True))


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    args = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    plan = QUICK if args.quick else FULL
    description = common.describe("step_profile", {"dt": "1 ms", "clock": "CPU time of the thread", **vars(plan)})
    print(common.header(description), flush=True)
    pairs = [(case, arms) for case in CASES for arms in plan.arms]
    progress = common.Progress(2 * plan.blocks * len(pairs))
    records = [compare(plan, *pair, progress) for pair in pairs]
    progress.close()
    text = f"## Target: a step from Python ≤ {RATIO:g} × the core alone (medians)\n\n"
    text += common.markdown_table(records, KEYS) + "\n"
    print("\n" + text)
    written = {"step_profile.md": text.encode()}
    for file in common.save(records, description, json_file=args.json, out=args.out, files=written):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
