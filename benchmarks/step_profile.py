"""Time of the parts of one step, the tail of its distribution, and a lower bound of its cost.

The cell has three arms around a ring. Each kernel alternates with an empty loop ("null spin") of the same length. See
benchmarks/README.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from common import Record
from recorded_qps import record as record_qps

from coopqp import QPController, QPOptions, available_kernels, make_solver
from coopqp.control import Outcome
from coopqp.scenarios import Scenario

KEYS = ("what", "kernel", "case", "part", "clock", "p50_us", "p99_us", "p999_us", "max_us", "share", "ratio", "samples")
#: Parts of a step in the order of the code. A fused kernel does the errors, the assembly and the checks of limits.
PARTS = ("inputs", "kinematics", "errors", "assembly", "solve", "kernel", "report", "rest")
#: Methods of the NumPy kernel, and their parts; "solve" is the check of limits and the ray.
_NUMPY_PARTS = {
    **dict.fromkeys(("_errors", "_corrections"), "errors"),
    **dict.fromkeys(("_admissible", "_look_ahead", "_ray", "_at_limits"), "solve"),
    "step": "assembly",
}
#: The kernel "qp" is the step without shortcuts, with a QP every time.
ALWAYS_QP = "qp"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Numbers of steps per tail, per profile and per turn."""

    steps: int = 100_000
    profiled: int = 4000
    block: int = 1000


FULL = Plan()
QUICK = Plan(steps=5000, profiled=600, block=500)


# -- parts -------------------------------------------------------------------------------------------------------------


class Stopwatch:
    """Time of every part without the parts inside it; one row per step."""

    def __init__(self) -> None:
        self.rows: list[dict[str, int]] = []
        self._now: dict[str, int] = {}
        self._inside: list[int] = []

    def watch(self, owner: Any, name: str, part: str) -> None:
        """Count calls of this method of this object as the part."""
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

        vars(owner)[name] = timed

    def next_row(self) -> None:
        """End the row of the present step."""
        self.rows.append(self._now.copy())
        self._now.clear()


def controller_of(scenario: Scenario, kernel: str) -> QPController:
    """A controller with this kernel, or with a QP at every step."""
    options = QPOptions(shortcut=False) if kernel == ALWAYS_QP else QPOptions(kernel=kernel)
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, options=options)
    controller.reset(scenario.q_start)
    return controller


def watched(controller: QPController) -> Stopwatch:
    """A stopwatch on the parts of a controller's step."""
    watch, chain, solver, kernel = Stopwatch(), controller._chain, controller._solver, controller._kernel
    for owner, names, part in (
        (controller, ("_guard", "_prepare"), "inputs"),
        (chain, ("place", "evaluate", "carried", "linearise"), "kinematics"),
        (chain, ("errors",), "errors"),
        (controller._linearised, ("_terms",), "errors"),
        (controller._box, ("update",), "assembly"),
        (solver.program, ("pieces", "condensed", "read_condensed"), "assembly"),
        (solver, ("settle",), "report"),
        (solver._solver, ("solve",), "solve"),
        (solver._slack_solver, ("solve",), "solve"),
        (controller, ("_finish",), "report"),
    ):
        for name in names:
            watch.watch(owner, name, part)
    if controller._rows is not None:
        watch.watch(controller, "_rows", "kernel")
    if kernel is not None and kernel.name == "numpy":
        for name, part in _NUMPY_PARTS.items():
            if hasattr(kernel, name):
                watch.watch(kernel, name, part)
    elif kernel is not None:
        watch.watch(kernel, "step", "kernel")
    watch.watch(controller, "step", "rest")
    return watch


def profile(scenario: Scenario, kernel: str, case: str, plan: Plan, progress: common.Progress) -> list[Record]:
    """Medians of the parts of successive steps, without resets."""
    controller = controller_of(scenario, kernel)
    for _ in range(20):
        controller.step()
    watch = watched(controller)
    for i in range(plan.profiled):
        finished = controller.step().finished
        watch.next_row()
        if finished and i + 1 < plan.profiled:
            controller.reset(scenario.q_start)
            controller.step()
            watch._now.clear()
    progress.advance()
    times = {part: 1e-3 * np.array([row.get(part, 0) for row in watch.rows]) for part in PARTS}
    times = {part: samples for part, samples in times.items() if samples.any()}
    total = np.sum(list(times.values()), axis=0)
    common_keys = {"what": "profile", "kernel": kernel, "case": case, "clock": "wall", "samples": total.size}
    medians = {part: float(np.median(samples)) for part, samples in times.items()}
    whole = sum(medians.values())
    return [
        {**common_keys, **tail(samples), "part": part, "share": round(medians[part] / whole, 3)}
        for part, samples in times.items()
    ] + [{**common_keys, **tail(total), "part": "step, watched"}]


def tail(samples: Any) -> Record:
    """Percentiles and the largest sample [µs]."""
    values = np.asarray(samples)
    return {**common.percentiles(values, shares=(50.0, 99.0, 99.9)), "max_us": round(float(values.max()), 3)}


# -- tails and the limit -----------------------------------------------------------------------------------------------

#: Wall time and CPU time of the thread [ns]; the CPU time excludes other processes.
Sample: TypeAlias = tuple[int, int]
wall, cpu = time.perf_counter_ns, time.thread_time_ns


def median_us(samples: Sequence[Sample]) -> float:
    """Median of the wall time [µs]."""
    return float(1e-3 * np.median([sample[0] for sample in samples]))


class Stepping:
    """Blocks of steps of one controller, each step with its time. Resets are not timed, the steps after them are."""

    def __init__(self, scenario: Scenario, kernel: str) -> None:
        self._scenario, self.controller = scenario, controller_of(scenario, kernel)

    def block(self, size: int) -> list[Sample]:
        step, samples = self.controller.step, []
        for _ in range(size):
            spent, began = cpu(), wall()
            result = step()
            samples.append((wall() - began, cpu() - spent))
            if result.finished:
                self.controller.reset(self._scenario.q_start)
        return samples


class Spin:
    """An empty loop of about the length of a step. Its tail is due to the machine."""

    def __init__(self, length_us: float) -> None:
        self._turns = 1
        while median_us(self.block(200)) < length_us:
            self._turns += max(1, self._turns // 16)

    def block(self, size: int) -> list[Sample]:
        turns, samples = range(self._turns), []
        for _ in range(size):
            spent, began = cpu(), wall()
            for _ in turns:
                pass
            samples.append((wall() - began, cpu() - spent))
        return samples


class Limit:
    """The necessary parts of any step: placements, Jacobians, and the kernel's errors, command and check of limits."""

    def __init__(self, scenario: Scenario, kernel: str) -> None:
        self._controller = controller_of(scenario, kernel)
        for _ in range(int(0.25 * scenario.path.duration / scenario.dt)):
            self._controller.step()
        # The start of the next step, which is repeated.
        ws = self._controller._ws
        self._q, self._middle = np.array(self._controller._q), np.array(self._controller._midpoint)
        self._state = [(array, array.copy()) for array in (ws.positions, ws.v_prev, ws.predicted)]
        self._clock = self._controller._clock
        self._controller.step()

    def block(self, size: int) -> list[Sample]:
        controller, q, middle, clock = self._controller, self._q, self._middle, self._clock
        chain, kernel, span, samples = controller._chain, controller._kernel, controller.dt, []
        assert kernel is not None
        model, placements, jacobians, run = controller.cell.model, chain._data, chain._jacobian_data, kernel.step
        place, evaluate = pin.forwardKinematics, pin.computeJointJacobians
        for _ in range(size):
            for array, before in self._state:
                array[:] = before
            spent, began = cpu(), wall()
            place(model, placements, q)
            evaluate(model, jacobians, middle)
            outcome = run(1.0, clock, span)
            samples.append((wall() - began, cpu() - spent))
            if outcome != Outcome.NOMINAL:
                raise RuntimeError("the limit needs a nominal step, but this step is not nominal")
        return samples


class LeastQp:
    """Jacobians and a minimal persistent QP: DAQP on the condensed form, without checks of data and solution."""

    def __init__(self, scenario: Scenario) -> None:
        self._model, self._data = scenario.cell.model, scenario.cell.model.createData()
        self._q = scenario.q_start
        problem = record_qps("saturated", len(scenario.cell), 2)[0].qps[0].problem
        self._solver = make_solver("daqp")
        if not self._solver.solve(problem).usable:
            raise RuntimeError("the least QP has no answer")
        self._bounds = np.concatenate([problem.ub, problem.u]), np.concatenate([problem.lb, problem.l])

    def block(self, size: int) -> list[Sample]:
        daqp, (upper, lower), samples = vars(self._solver)["_model"], self._bounds, []
        upper, lower = np.minimum(upper, 1e20), np.maximum(lower, -1e20)
        model, data, q, evaluate = self._model, self._data, self._q, pin.computeJointJacobians
        for _ in range(size):
            spent, began = cpu(), wall()
            evaluate(model, data, q)
            daqp.update(bupper=upper, blower=lower)
            daqp.solve()
            samples.append((wall() - began, cpu() - spent))
        return samples


def tails(scenario: Scenario, plan: Plan, progress: common.Progress) -> list[Record]:
    """Steps of every kernel, spins of the same lengths, and the limits, in turn."""
    contestants: dict[tuple[str, str], Callable[[int], list[Sample]]] = {}
    for kernel in available_kernels():
        stepping = Stepping(scenario, kernel)
        stepping.block(200)
        contestants["step", kernel] = stepping.block
        contestants["null spin", kernel] = Spin(median_us(stepping.block(400))).block
        contestants["limit: kinematics + nominal test", kernel] = Limit(scenario, kernel).block
    contestants["limit: Jacobians + least QP", ""] = LeastQp(scenario).block

    def one_block(block: Callable[[int], list[Sample]]) -> Iterable[float]:
        return (x for sample in block(plan.block) for x in sample)

    names = {f"{what}, {kernel}": (what, kernel) for what, kernel in contestants}
    rounds = {name: partial(one_block, contestants[key]) for name, key in names.items()}
    number = max(1, plan.steps // plan.block)
    samples = common.interleaved(rounds, rounds=number, progress=progress, frozen=True)
    records = []
    for name, (what, kernel) in names.items():
        for clock, times in zip(("wall", "cpu"), 1e-3 * samples[name].reshape(-1, 2).T, strict=True):
            row = {"what": what, "kernel": kernel, "case": "nominal", "clock": clock, **tail(times)}
            row["ratio"] = round(row["p999_us"] / row["p50_us"], 2)
            records.append({**row, "samples": times.size})
    # Ratios of successive blocks: slow phases of the machine cancel.
    medians = {name: np.median(samples[name].reshape(-1, plan.block, 2)[:, :, 0], axis=1) for name in names}
    for kernel in available_kernels():
        for other in (f"limit: kinematics + nominal test, {kernel}", "limit: Jacobians + least QP, "):
            ratio = float(np.median(medians[f"step, {kernel}"] / medians[other]))
            part = other.strip(", ").removesuffix(f", {kernel}")
            records.append(
                {"what": "step / limit", "kernel": kernel, "case": "nominal", "part": part, "ratio": round(ratio, 2)}
            )
    return records


def measure(plan: Plan) -> list[Record]:
    """All profiles, then all tails."""
    kernels = available_kernels()
    nominal, zigzag = common.ring(arms=3), common.ring(arms=3, path="zigzag")
    profiles = [(s, k, c) for s, c in ((nominal, "nominal"), (zigzag, "zigzag")) for k in (*kernels, ALWAYS_QP)]
    blocks = max(1, plan.steps // plan.block) * (3 * len(kernels) + 1)
    progress = common.Progress(len(profiles) + blocks, label="profiles")
    records: list[Record] = []
    for scenario, kernel, case in profiles:
        records += profile(scenario, kernel, case, plan, progress)
    records += tails(nominal, plan, progress)
    progress.close()
    return [{key: r.get(key) for key in KEYS} for r in records]


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    args = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    plan = QUICK if args.quick else FULL
    settings = {"arms": 3, "dt": "1 ms", "steps": plan.steps, "a block": plan.block, "profiled steps": plan.profiled}
    settings |= {"garbage": "gc.freeze() before, collector on", "clock": "wall, and CPU time of the thread"}
    description = common.describe("step_profile", settings)
    print(common.header(description), flush=True)
    records = measure(plan)
    profiles = [r for r in records if r["what"] == "profile"]
    others = [r for r in records if r["what"] != "profile"]
    text = "\n\n".join(
        [
            "## Where a step's time goes (wall; the stopwatch itself costs about 0.3 µs a call)",
            common.markdown_table(profiles, ("kernel", "case", "part", "p50_us", "p99_us", "share")),
            "## Tails (ratio: p99.9 / p50), and how far a step is from its limit (ratio of medians)",
            common.markdown_table(others, [key for key in KEYS if key not in ("case", "share")]),
        ]
    )
    print("\n" + text)
    files = {"step_profile.md": (text + "\n").encode()} if args.out is not None else None
    out: Path | None = args.out
    for file in common.save(records, description, json_file=args.json, out=out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
