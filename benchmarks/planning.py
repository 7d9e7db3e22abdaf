"""What stands before the motion: batch kinematics, starts of whole cells, and the check of a path.

The cases take turns in one run: trust the ratios. See benchmarks/README.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import check_cases
import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
import user_cells
from common import Record

from coopqp import NoStartError
from coopqp.model.batch import ArmKinematics, batch_kernels
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.planning import find_start
from coopqp.scenarios import paper_lift, ring

KEYS = ("case", "method", "arms", "time_s", "ratio", "per_s", "found", "verdict", "note")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Poses of a batch, poses that the kept chain solves in a round, rounds, sizes of rings."""

    poses: int = 2000
    alone: int = 200
    rounds: int = 8
    rings: tuple[int, ...] = (8, 32)


FULL = Plan()
QUICK = Plan(poses=1000, alone=100, rounds=4, rings=(8,))


def batch(plan: Plan, progress: common.Progress) -> list[Record]:
    """Inverse kinematics of object poses near a start, three arms each: seconds per object pose."""
    lift = paper_lift()
    rng = np.random.default_rng(0)
    near = [
        lift.path.pose(0.0) * pin.exp6(pin.Motion(rng.uniform(-1.0, 1.0, 6) * [0.03, 0.03, 0.03, 0.1, 0.1, 0.1]))
        for _ in range(plan.poses)
    ]
    chain = Chain(lift.cell, lift.grasp)
    tools = [np.array([(T * X).homogeneous for T in near]) for X in lift.grasp.T_object_tool]
    starts = [np.tile(lift.q_start[s], (plan.poses, 1)) for s in lift.cell.q_slices]
    missed = {"kept chain": 0}

    def kept() -> Iterable[float]:
        began = time.perf_counter()
        for T in near[: plan.alone]:
            errors = newton(chain, T, lift.q_start, tolerance=1e-9, max_iter=40)[1]
            missed["kept chain"] += int(np.abs(errors).max() > 1e-9)
        yield (time.perf_counter() - began) / plan.alone

    def of(kernel: Any) -> Callable[[], Iterable[float]]:
        arms = [ArmKinematics(arm, kernel=kernel) for arm in lift.cell.arms]
        missed[kernel] = 0

        def run() -> Iterable[float]:
            began = time.perf_counter()
            for arm, T, q in zip(arms, tools, starts, strict=True):
                missed[kernel] += int((~arm.solve(T, q).reached).sum())
            yield (time.perf_counter() - began) / plan.poses

        return run

    contestants = {"kept chain": kept, **{kernel: of(kernel) for kernel in batch_kernels()}}
    samples = common.interleaved(contestants, rounds=plan.rounds, progress=progress)
    base = samples["kept chain"]
    note = "object poses of three arms; the batch also has σ_min and margins"
    return [
        record(
            "batch", name, 3, float(np.median(times)), ratio=float(np.median(base / times)),
            per_s=1.0 / float(np.median(times)), found=missed[name] == 0, note=note,
        )
        for name, times in samples.items()
    ]  # fmt: skip


def starts(plan: Plan, progress: common.Progress) -> list[Record]:
    """Time of find_start on cells as users would build them, and on rings."""
    tasks: dict[str, Any] = {name: user_cells.build(name) for name in user_cells.CELLS}
    for arms in plan.rings:
        task = ring(arms=arms)
        tasks[f"ring of {arms}"] = (task.cell, task.grasp, task.path)
    records = []
    for name, (cell, grasp, path) in tasks.items():
        progress.label = name
        progress.show()
        times, found, note = [], True, name
        for _ in range(min(3, plan.rounds)):
            began = time.perf_counter()
            try:
                find_start(cell, grasp, path)
            except NoStartError as error:
                found, note = False, f"{name}: {error}"
            times.append(time.perf_counter() - began)
        records.append(record("starts", "find_start", len(cell), float(np.median(times)), found=found, note=note))
        progress.advance()
    return records


def record(case: str, method: str, arms: int, time_s: float, **values: object) -> Record:
    """A record. Keys that do not apply are None."""
    return {**dict.fromkeys(KEYS), "case": case, "method": method, "arms": arms, "time_s": time_s, **values}


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    args = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    plan = QUICK if args.quick else FULL
    description = common.describe("planning", {"poses": plan.poses, "rounds": plan.rounds})
    print(common.header(description), flush=True)
    total = plan.rounds * (1 + len(batch_kernels())) + len(user_cells.CELLS) + 2 * len(plan.rings) + 3
    progress = common.Progress(total)
    records = [*batch(plan, progress), *starts(plan, progress)]
    checked = check_cases.checks(plan.rings, plan.rounds, progress)
    records += [{**dict.fromkeys(KEYS), **record} for record in checked]
    progress.close()
    text = "## Before the motion\n\n" + common.markdown_table(records, KEYS) + "\n"
    print("\n" + text)
    files = {"planning.md": text.encode()} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
