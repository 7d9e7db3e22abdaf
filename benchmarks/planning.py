"""What stands before the motion: batch kinematics, starts, checks, and the fastest timing of random paths.

The cases take turns in one run: trust the ratios. See benchmarks/README.md.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import check_cases
import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
import user_cells
from common import Record

from coopqp import Grasp, LinePath, ObjectPath, QPController, RobotCell, Status, find_start, simulate
from coopqp.errors import NoStartError
from coopqp.model.batch import ArmKinematics
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.planning import time_path
from coopqp.scenarios import paper_lift, ring
from coopqp.simulation import read_run
from coopqp.spatial import Array

KEYS = (
    "case", "method", "arms", "time_s", "ratio", "tracking_share", "chain_mm", "path_mm", "plan_ms", "verdict",
)  # fmt: skip
#: Length of a step [s], and the share of the shortest time that a reactive run's path asks for: so little that its own
#: rate, at most 1, binds a linear path hardly, and a quintic one only near its ends.
DT, ASKED = 0.002, {"linear": 0.5, "quintic": 0.75}


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Poses of a batch, poses that the kept chain solves in a round, rounds, sizes of rings, random paths."""

    poses: int = 2000
    alone: int = 200
    rounds: int = 8
    rings: tuple[int, ...] = (8, 32)
    paths: int = 24


FULL = Plan()
QUICK = Plan(poses=1000, alone=100, rounds=4, rings=(8,), paths=4)


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
    missed = {"kept chain": 0, "core": 0}

    def kept() -> Iterable[float]:
        began = time.perf_counter()
        for T in near[: plan.alone]:
            errors = newton(chain, T, lift.q_start, tolerance=1e-9, max_iter=40)[1]
            missed["kept chain"] += int(np.abs(errors).max() > 1e-9)
        yield (time.perf_counter() - began) / plan.alone

    arms = [ArmKinematics(arm) for arm in lift.cell.arms]

    def core() -> Iterable[float]:
        began = time.perf_counter()
        for arm, T, q in zip(arms, tools, starts, strict=True):
            missed["core"] += int((~arm.solve(T, q).reached).sum())
        yield (time.perf_counter() - began) / plan.poses

    samples = common.interleaved({"kept chain": kept, "core": core}, rounds=plan.rounds, progress=progress)
    base = samples["kept chain"]
    records = []
    for name, times in samples.items():
        verdict = "all reached" if missed[name] == 0 else f"{missed[name]} missed"
        if name != "kept chain":  # which finds no singular values
            verdict += f", {3.0 / np.median(times):.2g} arm poses/s with σ_min"
        records.append(
            record("batch", name, 3, float(np.median(times)), ratio=float(np.median(base / times)), verdict=verdict)
        )
    return records


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
        times, verdict = [], "found"
        for _ in range(min(3, plan.rounds)):
            began = time.perf_counter()
            try:
                find_start(cell, grasp, path)
            except NoStartError as error:
                verdict = f"no start: {error}"
            times.append(time.perf_counter() - began)
        seconds = float(np.median(times))
        records.append(
            record(f"start: {name}", "find_start", len(cell), seconds, plan_ms=1e3 * seconds, verdict=verdict)
        )
        progress.advance()
    return records


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """A random straight path of a ring of arms, with random acceleration limits."""

    name: str
    cell: RobotCell
    grasp: Grasp
    path: LinePath
    q_start: Array


def random_task(seed: int) -> Task:
    """2 to 8 arms of six or seven joints; a path that has a start."""
    rng = np.random.default_rng(seed)
    while True:
        arms, robot = int(rng.integers(2, 9)), rng.choice(["rx90l", "rx90l", "arm7"])
        task = ring(arms=arms, robot=robot)
        cell = task.cell.with_limits(acceleration=rng.uniform(2.0, 12.0))
        way = rng.uniform(-1.0, 1.0, 3) * [0.15, 0.15, 0.12]
        turn = rng.uniform(-1.0, 1.0, 3) * 0.25 / max(0.5, arms / 8.0)
        path = LinePath.displaced(task.path.pose(0.0), translation=way, rotation=turn, duration=1.0)
        try:
            found = find_start(cell, task.grasp, path)
        except NoStartError:
            continue
        return Task(name=f"{robot} {seed}", cell=cell, grasp=task.grasp, path=path, q_start=found.q)


def timings(plan: Plan, progress: common.Progress) -> list[Record]:
    """Planned and reactive runs of random paths against the shortest time at the full limits."""
    records = []
    for seed in range(plan.paths):
        task = random_task(seed)
        progress.label = f"path {task.name}"
        progress.show()
        shortest = time_path(task.cell, task.grasp, task.path, q_start=task.q_start, share=1.0, knots=800).duration
        began = time.perf_counter()
        planned = time_path(task.cell, task.grasp, task.path, q_start=task.q_start)
        plan_ms = 1e3 * (time.perf_counter() - began)
        paths: dict[str, ObjectPath] = {"planned": planned}
        for law, asked in ASKED.items():
            start, goal = task.path.start, task.path.goal
            paths[f"reactive {law}"] = LinePath(start, goal, duration=asked * shortest, time_law=law)
        for method, path in paths.items():
            options = {"plan_ms": plan_ms} if method == "planned" else {}
            records.append(tracked(task, method, path, shortest, **options))
        progress.advance()
    return records


def tracked(task: Task, method: str, path: ObjectPath, shortest: float, **values: object) -> Record:
    """One run: its time against the shortest, the share of its steps that are TRACKING, its errors."""
    controller = QPController(task.cell, task.grasp, path, dt=DT)
    run = simulate(controller, q_start=task.q_start, duration=20.0 * shortest)
    errors = read_run(task.cell, run)
    seconds = DT * len(run.status)
    done = bool(run.clock[-1] >= path.duration)
    return record(
        f"path: {task.name}", method, len(task.cell), seconds,
        ratio=seconds / shortest,
        tracking_share=float(np.mean([status == Status.TRACKING for status in run.statuses])),
        chain_mm=float(errors.chain_mm.max()),
        path_mm=float(errors.object_mm.max()),
        verdict="finished" if done else "not finished",
        **values,
    )  # fmt: skip


def many_arms(plan: Plan, progress: common.Progress) -> list[Record]:
    """Time that time_path takes on rings."""
    records = []
    for arms in plan.rings:
        task = ring(arms=arms)
        cell = task.cell.with_limits(acceleration=5.0)
        progress.label = f"timing of {arms} arms"
        progress.show()
        times, path = [], None
        for _ in range(plan.rounds + 1):
            began = time.perf_counter()
            path = time_path(cell, task.grasp, task.path, q_start=task.q_start)
            times.append(time.perf_counter() - began)
        assert path is not None
        spent = 1e3 * min(times[1:])  # the first imports toppra; others share the machine
        records.append(
            record(f"timing: ring of {arms}", "planned", arms, path.duration, plan_ms=spent, verdict="planned")
        )
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
    total = plan.rounds * 2 + len(user_cells.CELLS) + 3 * len(plan.rings) + plan.paths + 3
    progress = common.Progress(total)
    records = [*batch(plan, progress), *starts(plan, progress)]
    checked = check_cases.checks(plan.rings, plan.rounds, progress)
    records += [{**dict.fromkeys(KEYS), **record} for record in checked]
    records += [*timings(plan, progress), *many_arms(plan, progress)]
    progress.close()
    text = "## Before the motion\n\n" + common.markdown_table(records, KEYS) + "\n"
    print("\n" + text)
    files = {"planning.md": text.encode()} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
