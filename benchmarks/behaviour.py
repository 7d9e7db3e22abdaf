"""Difficult tasks with the pseudo-inverse, the QP with independent arms and the cooperative QP.

Every run is judged from its configurations only. Each run has one flat record:

* ``case``, ``variant``, ``controller`` (pseudo_inverse, independent, cooperative), ``solver`` ("none" without a QP);
* ``chain_mm``, ``chain_deg``: largest distance and angle between the object poses of any two arms during the run. In
  the case ``mismatch`` this is the initial 5 mm; ``chain_final_mm`` is the remaining error, and ``chain_rise_mm`` the
  largest growth in one step (0 if the error falls monotonically);
* ``path_mm``, ``path_deg``: largest distance and angle between any arm's object pose and the path at its clock;
* ``failures``: number of steps with the status holding or fault, or with a velocity that is not finite;
* ``finished``: true if the object's clock reached the end of its path; a path into a limit or a singularity has no
  reachable end. ``came_back``: true if the object returned to its start afterwards (if requested);
* ``rate_min``: smallest share σ of the path's nominal rate;
* ``limit_excess``: largest excess over a position limit [rad or m] or velocity limit [rad/s or m/s]. For a joint that
  starts outside its limit (case ``outside``), the excess counts relative to the start until the joint is inside;
* ``blocked_arm``, ``blocked_joint``: names in the last step of a blocked run; ``named``: true if an independent inverse
  kinematics along the path finds the same (null without a block);
* ``recovery_ratio``: time to return inside, relative to the time of the joint alone at the recovery speed;
* ``eps_p_mm``, ``acceleration_excess`` (share), ``arms``, ``steps``, ``qp_steps`` (steps with a QP), ``note``;
* ``missed``: the missed targets of the cooperative QP.

A figure that is not finite is null.
"""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from behaviour_cases import CASES, DWELL, OUTSIDE, Key, Run, build, keys_of, way_back
from common import Record
from coopqp.core._core import RECOVERY_SHARE

from coopqp import ControlStep, QPController, QPOptions, Status
from coopqp.baselines import IndependentQPController, IndependentQPOptions, PseudoInverseController
from coopqp.control import Controller
from coopqp.errors import StartWarning
from coopqp.simulation import limit_excess, relative_positioning_error, tool_placements
from coopqp.solvers import available_solvers
from coopqp.spatial import Array

#: QP solvers; the installed ones are run.
KEPT = ("daqp", "proxqp", "osqp")
CONTROLLERS = ("pseudo_inverse", "independent", "cooperative")
#: With --quick, number of runs per case of all controllers except the cooperative QP with the first solver.
QUICK_OTHERS = 1
#: With --quick, cases in which the independent QP runs with all solvers.
QUICK_ALL_SOLVERS = ("fast", "paper")
#: Targets of every run of the cooperative QP.
ALWAYS: dict[str, float | bool] = {"failures": 0, "limit_excess": 1e-9, "acceleration_excess": 1e-6}
COLUMNS = (
    "case", "controller", "solver", "runs", "chain_mm", "chain_final_mm", "chain_deg", "path_mm", "path_deg",
    "failures", "finished", "rate_min", "limit_excess", "named", "verdict",
)  # fmt: skip


def make_controller(run: Run, controller: str, solver: str) -> Controller:
    """Build a controller for a run."""
    task = run.task
    if controller == "pseudo_inverse":
        return PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt)
    if controller == "independent":
        alone = IndependentQPOptions(solver=solver)
        return IndependentQPController(task.cell, task.grasp, task.path, dt=task.dt, options=alone)
    together = QPOptions(solver=solver, **run.options)
    return QPController(task.cell, task.grasp, task.path, dt=task.dt, options=together)


def drive(run: Run, controller: Controller) -> list[ControlStep]:
    """Run until the path is finished, the object has waited for a while, or the time is over; then run back."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StartWarning)  # some cases start off the grasp, or outside limits
        controller.reset(run.task.q_start)
    steps = list(_until_rest(controller, run.longest))
    if run.back and isinstance(controller, QPController):
        controller.follow(way_back(run.task, steps[-1].clock_next))
        steps += _until_rest(controller, run.longest)
    return steps


def _until_rest(controller: Controller, longest: float) -> Iterator[ControlStep]:
    waited, elapsed = 0, 0.0
    while waited < DWELL and elapsed < longest:
        step = controller.step()
        yield step
        waited = waited + 1 if step.status is Status.BLOCKED else 0
        elapsed += step.dt
        if step.finished:
            return


def judge(run: Run, steps: Sequence[ControlStep]) -> Record:
    """The figures of one run."""
    cell, grasp = run.task.cell, run.task.grasp
    q = np.array([steps[0].q, *(s.q_next for s in steps)])
    v = np.array([s.velocity for s in steps])
    tools = tool_placements(cell, q)
    views = _homogeneous(tools) @ np.linalg.inv(_homogeneous(grasp.T_object_tool))  # O_k, (T, N, 4, 4)
    poses = _homogeneous([s.path.pose(s.clock_next) for s in steps])
    pairs = [(i, j) for i in range(len(cell)) for j in range(i)]
    chain = np.max([_apart(views[:, i], views[:, j]) for i, j in pairs], axis=0)
    path = np.max([_apart(views[1:, k], poses) for k in range(len(cell))], axis=0)
    forth = [s for s in steps if s.path is run.task.path]
    end = forth[-1]
    blocked = end.binding[0] if end.status is Status.BLOCKED and end.binding else None
    change = np.abs(np.diff(np.vstack([np.zeros(cell.nv), v]), axis=0)) / steps[0].dt
    return {
        "chain_mm": 1e3 * float(np.max(chain[:, 0])),
        "chain_deg": float(np.rad2deg(np.max(chain[:, 1]))),
        "chain_final_mm": 1e3 * float(chain[-1, 0]),
        "chain_rise_mm": 1e3 * max(0.0, float(np.diff(chain[:, 0]).max())),
        "path_mm": 1e3 * float(np.max(path[:, 0])),
        "path_deg": float(np.rad2deg(np.max(path[:, 1]))),
        "failures": sum(s.status in (Status.HOLDING, Status.FAULT) or not np.isfinite(s.velocity).all() for s in steps),
        "finished": end.finished,
        "came_back": steps[-1].finished if len(forth) < len(steps) else None,
        "rate_min": min(s.rate for s in steps),
        "limit_excess": _limit_excess(run, q, v),
        "acceleration_excess": max(0.0, float((change / cell.limits.acceleration).max()) - 1.0),
        "blocked_arm": blocked.arm if blocked else None,
        "blocked_joint": (blocked.joint or None) if blocked else None,
        "named": _named(run, end),
        "recovery_ratio": _recovery_ratio(run, q),
        "eps_p_mm": 1e3 * max(relative_positioning_error(T, grasp) for T in tools) if len(cell) == 3 else None,
        "arms": len(cell),
        "steps": len(steps),
        "qp_steps": sum(s.solver.name != "none" for s in steps),
        "note": end.explain() if end.status is not Status.TRACKING else "",
    }


def _homogeneous(placements: Any) -> Array:
    """Nested lists of placements as one array (…, 4, 4)."""
    if isinstance(placements, pin.SE3):
        return np.asarray(placements.homogeneous)
    return np.array([_homogeneous(T) for T in placements])


def _apart(A: Array, B: Array) -> Array:
    """Distance [m] and angle [rad] between placements (n, 4, 4), as columns (n, 2); NaN if a placement has NaN."""
    R = A[:, :3, :3].transpose(0, 2, 1) @ B[:, :3, :3]
    sine = 0.5 * np.linalg.norm(R[:, [2, 0, 1], [1, 2, 0]] - R[:, [1, 2, 0], [2, 0, 1]], axis=1)
    cosine = 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)
    return np.column_stack([np.linalg.norm(A[:, :3, 3] - B[:, :3, 3], axis=1), np.arctan2(sine, cosine)])


def _limit_excess(run: Run, q: Array, v: Array) -> float:
    if run.outside is None:
        return limit_excess(run.task.cell, q, v)
    way = _way_out(run, q)
    inside = np.flatnonzero(way <= 0.0)
    back = int(inside[0]) if inside.size else len(way)
    further_out = max(0.0, float(np.diff(way[:back]).max(initial=0.0)))
    others = run.task.cell.with_limits(
        lower=np.minimum(run.task.cell.limits.lower, q[0]), upper=np.maximum(run.task.cell.limits.upper, q[0])
    )
    return max(further_out, limit_excess(run.task.cell, q[back:], []), limit_excess(others, q, v))


def _way_out(run: Run, q: Array) -> Array:
    """Excess over its limit of the joint that started outside, at every sample [rad]; negative inside."""
    assert run.outside is not None
    limits, x = run.task.cell.limits, q[:, run.outside]
    return np.asarray(np.maximum(x - limits.upper[run.outside], limits.lower[run.outside] - x))


def _recovery_ratio(run: Run, q: Array) -> float | None:
    """Time to return inside relative to a motion at recovery speed and full acceleration; inf without return."""
    if run.outside is None:
        return None
    limits = run.task.cell.limits
    acceleration = float(limits.acceleration[run.outside])
    speed = RECOVERY_SHARE * float(limits.velocity[run.outside])
    if 0.5 * speed * speed / acceleration < OUTSIDE:  # the joint reaches this speed
        ideal = OUTSIDE / speed + 0.5 * speed / acceleration
    else:
        ideal = float(np.sqrt(2.0 * OUTSIDE / acceleration))
    inside = np.flatnonzero(_way_out(run, q) <= 0.0)
    return float(inside[0] * run.task.dt / ideal) if inside.size else np.inf


def _named(run: Run, end: ControlStep) -> bool | None:
    """True if the last step names the arm and a joint of the oracle."""
    if run.expected is None:
        return None
    arm, joints, _ = run.expected
    if end.status is not Status.BLOCKED:
        return False
    if not joints:
        return any(b.arm == arm for b in end.binding)
    return any(f"{b.arm}/{b.joint}" in joints for b in end.binding)


def plain(value: Any) -> Any:
    """A value for JSON. A number that is not finite becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def missed_targets(run: Run, record: Record) -> list[str]:
    """The missed targets of the cooperative QP in a record, in words."""
    missed = []
    for name, target in {**ALWAYS, **run.targets}.items():
        value = record[name]
        met = bool(value) == target if isinstance(target, bool) else value is not None and value <= target
        if not met:
            missed.append(f"{name} {common.cell_text(value)} (target {common.cell_text(target)})")
    return missed


def run_one(case: str, key: Key, controller: str, solver: str) -> Record:
    """Build, drive and judge one run."""
    run = build(case, key)
    steps = drive(run, make_controller(run, controller, solver))
    record = judge(run, steps)
    missed = missed_targets(run, record) if controller == "cooperative" else []
    return {
        "case": case,
        "variant": run.variant,
        "controller": controller,
        "solver": solver,
        **{name: plain(value) for name, value in record.items()},
        "missed": "; ".join(missed),
    }


def plan(cases: Sequence[str], *, quick: bool, solvers: Sequence[str]) -> list[tuple[str, Key, str, str]]:
    """All runs: (case, key, controller, solver)."""
    pairs = [("cooperative", s) for s in solvers] + [("pseudo_inverse", "none")] + [("independent", s) for s in solvers]
    jobs = []
    for case, (controller, solver) in itertools.product(cases, pairs):
        keys = keys_of(case, quick=quick)
        if quick and (controller, solver) != pairs[0]:
            keys = keys[:QUICK_OTHERS]
            if controller == "independent" and solver != solvers[0] and case not in QUICK_ALL_SOLVERS:
                keys = []
        jobs += [(case, key, controller, solver) for key in keys]
    return jobs


def run_all(jobs: Sequence[tuple[str, Key, str, str]], workers: int) -> list[Record]:
    """Run the jobs in separate processes in any order. Returns the records in the order of the jobs."""
    records: dict[int, Record] = {}
    progress = common.Progress(len(jobs))
    with ProcessPoolExecutor(max_workers=workers) as pool:
        futures = {pool.submit(run_one, *job): i for i, job in enumerate(jobs)}
        for future in as_completed(futures):
            i = futures[future]
            records[i] = future.result()
            progress.advance(" ".join((jobs[i][0], *jobs[i][2:])))
    progress.close()
    return [records[i] for i in range(len(jobs))]


def summary(records: Sequence[Record]) -> list[Record]:
    """The worst figures of each case, controller and solver."""
    rows = []
    for (case, controller, solver), group in itertools.groupby(
        records, key=lambda r: (r["case"], r["controller"], r["solver"])
    ):
        runs = list(group)
        worst = {
            name: max(np.inf if r[name] is None else r[name] for r in runs)
            for name in ("chain_mm", "chain_final_mm", "chain_deg", "path_mm", "path_deg", "limit_excess")
        }
        named = [r["named"] for r in runs if r["named"] is not None]
        missed = sum(bool(r["missed"]) for r in runs)
        rows.append(
            {
                "case": case,
                "controller": controller,
                "solver": solver,
                "runs": len(runs),
                **worst,
                "failures": sum(r["failures"] for r in runs),
                "finished": f"{sum(r['finished'] for r in runs)}/{len(runs)}",
                "rate_min": min(r["rate_min"] for r in runs),
                "named": f"{sum(named)}/{len(named)}" if named else None,
                "verdict": None if controller != "cooperative" else f"{missed} missed" if missed else "met",
            }
        )
    return rows


def report(records: Sequence[Record]) -> str:
    """A table of the worst figures, and every missed target."""
    rows = summary(records)
    lines = [common.markdown_table(rows, COLUMNS), ""]
    missed = [r for r in records if r["missed"]]
    lines += [f"missed: {r['case']}, {r['variant']}, {r['solver']}: {r['missed']}" for r in missed]
    count = sum(r["controller"] == "cooperative" for r in records)
    lines.append(f"The cooperative QP met its targets in {count - len(missed)} of {count} runs.")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES, help="which cases (all)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (one per core)")
    args = parser.parse_args(argv)
    solvers = [name for name in KEPT if name in available_solvers()]
    description = common.describe(
        "behaviour", {"cases": " ".join(args.cases), "solvers": " ".join(solvers), "pinocchio": pin.__version__}
    )
    print(common.header(description), flush=True)
    records = run_all(plan(args.cases, quick=args.quick, solvers=solvers), max(1, args.workers))
    text = report(records)
    print("\n" + text)
    files = {"behaviour.md": text.encode()}
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
