"""How far arms and object stay from all else, and what that costs a step. See benchmarks/README.md.

Distances are judged by ``Closeness``, which shares no code with the controller's, at every step and between steps.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from common import Record
from contestants import CACHE
from peer_collisions import PEERS, peers

from coopqp import Clearance, CollisionScene, ControlStep, ObjectPath, QPController, QPOptions, check_path, simulate
from coopqp.collision import Body, Box, Sphere
from coopqp.collision.distances import Distances
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.scenarios import (
    Scenario,
    dual_arm7,
    elbow_and_knob,
    elbows,
    forearms,
    mixed_cell,
    paper_lift,
    plate_and_post,
    plate_and_table,
    random_posts,
    ring,
)
from coopqp.simulation import Closeness, check_run

KEYS = (
    "case", "controller", "clearance_mm", "margin_mm", "chain_mm", "path_mm", "chain_slack", "finished", "status",
    "pair", "check", "dense_mm", "reversals", "passes", "p50_us", "p99_us",
)  # fmt: skip
ACCELERATION = 5.0  # [rad/s²]
MARGIN = 0.02  # [m]
NEAR_MARGIN = 0.005  # of random posts and of the times of a step [m]
CART_SPEED, CART_HEIGHTS, CART_STEPS = 0.3, (0.18, 0.34), 800  # [m/s, m]
NEAR = 0.03  # beyond its margin a pair is near [m]
ARMS, SAMPLES = (2, 3, 4, 8), 401  # of the cells of random posts, and of their paths
PARTS = ("known", "carts", *(f"posts-{arms}" for arms in ARMS), "peers", "skip", "times")

#: What makes one record, in a process of its own.
Job = Callable[[], Record]


@dataclass(frozen=True)
class Plan:
    """How much is run.

    Attributes:
        posts: random cells for each number of arms.
        jumps: random jumps of the certified skip.
        rounds: runs of the times of a step.
    """

    posts: int = 50
    jumps: int = 1_000_000
    rounds: int = 5


QUICK = Plan(posts=2, jumps=5_000, rounds=1)
FULL = Plan()


class Unknown(ObjectPath):
    """A path that is not known ahead."""

    known_ahead = False

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration = path, path.duration

    def pose(self, clock: float) -> pin.SE3:
        """Its pose."""
        return self._path.pose(clock)

    def twist(self, clock: float) -> Any:
        """Its twist."""
        return self._path.twist(clock)


def inside_the_margin(side: float) -> Scenario:
    """The paper's plate 8 mm from a lid above (the path leads towards it) or below it."""
    lift = paper_lift(time_law="quintic")
    middle = (lift.path.pose(0.0) * lift.T_object_body).translation
    lid = Body("lid", Box((0.3, 0.3, 0.05)), pin.SE3(np.eye(3), middle + np.array([0.0, 0.0, side * 0.053])))
    return replace(lift, obstacles=(lid,))


def cases() -> Iterator[tuple[str, Scenario, dict[str, Any]]]:
    """Name, task and what its scene says besides."""
    yield "plate and post (capsule)", plate_and_post(), {}
    yield "plate and post (box)", plate_and_post(post="box"), {}
    yield "plate and table", plate_and_table(), {}
    yield "plate and tilted table", plate_and_table(tilt=0.1), {}
    blind = plate_and_post()
    yield "plate and post, not known ahead", replace(blind, path=Unknown(blind.path)), {}
    yield "elbow and knob", elbow_and_knob(), {}
    yield "elbows", elbows(), {}
    yield "forearms, 30 mm", forearms(), {"margin": 0.03}
    yield "start inside, towards", inside_the_margin(1.0), {"inside": [("object", "lid")]}
    yield "start inside, away", inside_the_margin(-1.0), {"inside": [("object", "lid")]}


def _scene(task: Scenario, more: dict[str, Any]) -> CollisionScene:
    return CollisionScene.of(task, **{"margin": MARGIN, **more})


def carts() -> Iterator[Job]:
    """A cart at 0.3 m/s that comes towards the plate while it is lifted; how the plate moves when it is near."""
    for acceleration in (np.inf, ACCELERATION):
        for height in CART_HEIGHTS:
            for gives_way in (True, False):
                case = f"cart {1e3 * height:.0f} mm above, " + ("gives way" if gives_way else "stays on its path")
                if acceleration < np.inf:
                    case += f", {ACCELERATION:g} rad/s²"
                yield partial(_cart, case, height, acceleration, gives_way=gives_way)


def _cart(case: str, height: float, acceleration: float, *, gives_way: bool) -> Record:
    """One of them, judged by coal where the cart is: nothing else knows."""
    lift = paper_lift(time_law="quintic")
    middle, dt = (lift.path.pose(0.0) * lift.T_object_body).translation, 4e-3

    def place(clock: float) -> pin.SE3:
        return pin.SE3(np.eye(3), middle + np.array([0.0, CART_SPEED * clock - 1.0, height]))

    cell = lift.cell.with_limits(acceleration=acceleration)
    scene = CollisionScene.of(lift, cell=cell, margin=MARGIN, moving=[Body("cart", Box((0.2, 0.2, 0.2)), place(0.0))])
    clearance = Clearance(scene, give_way=gives_way)
    controller = QPController(cell, lift.grasp, lift.path, dt=dt, constraints=[clearance])
    controller.reset(lift.q_start)
    chain, steps, distances, own, off = Chain(cell, lift.grasp), [], Distances(scene.built), [], [0.0, 0.0]
    (shape,) = scene.built.moving
    pairs = [k for k, label in enumerate(scene.built.labels) if "cart" in label]
    rows = []
    for i in range(CART_STEPS):
        clearance.move("cart", place(i * dt), (0.0, CART_SPEED, 0.0, 0.0, 0.0, 0.0))
        step = controller.step()
        distances.put(shape, place(i * dt))
        distances.place(step.q)
        d = np.array([distances.one(k) for k in pairs])
        rows.append(float(d.min()))
        own.append(float((distances.gradient([pairs[int(d.argmin())]]).rows @ step.velocity)[0]))
        errors = chain.errors(chain.carried(step.q), lift.path.pose(step.clock))[:, :3]
        off = [max(off[0], float(np.ptp(errors, axis=0).max())), max(off[1], float(np.abs(errors).max()))]
        steps.append(step)
    inside = np.array(rows) < MARGIN
    approach = max(0.0, -min(np.array(own)[inside], default=0.0))
    return {
        "case": case, "controller": "clearance", "clearance_mm": round(1e3 * min(rows), 6), "margin_mm": 1e3 * MARGIN,
        "chain_mm": 1e3 * off[0], "path_mm": 1e3 * off[1],
        "chain_slack": max(step.given_up.chain for step in steps), "finished": steps[-1].finished,
        "status": f"{approach:.0e} m/s closer by itself inside" if inside.any() else "never inside", "pair": "cart",
        "check": None, "dense_mm": None, "reversals": reversals(np.array([step.rate for step in steps])),
        "passes": None, "p50_us": None, "p99_us": None,
    }  # fmt: skip


def reversals(rate: Any) -> int:
    """How often the rate turns between rising and falling."""
    change = np.diff(rate)
    change = change[np.abs(change) > 1e-6]
    return int((np.diff(np.sign(change)) != 0).sum())


def measured(case: str, task: Scenario, scene: CollisionScene, *, avoids: bool, patience: float = 0.2) -> Record:
    """What a run came to."""
    cell = scene.cell
    steps: list[ControlStep] = []
    constraints = [Clearance(scene)] if avoids else []
    controller = QPController(cell, task.grasp, task.path, dt=task.dt, constraints=constraints)
    run = simulate(controller, q_start=task.q_start, patience=patience, observe=steps.append)
    verdict, closest = check_run(run, cell, scene=scene), Closeness(scene).closest(run.q_command, run.time)
    assert closest is not None
    named = next((" and ".join(limit.between) for limit in steps[-1].binding if limit.between), "")
    return {
        "case": case, "controller": "clearance" if avoids else "without",
        "clearance_mm": round(1e3 * closest.pair.distance, 6), "margin_mm": 1e3 * closest.margin,
        "chain_mm": 1e3 * verdict.worst.chain_m, "path_mm": 1e3 * verdict.worst.path_m,
        "chain_slack": max(step.given_up.chain for step in steps), "finished": run.finished,
        "status": steps[-1].status.name, "pair": named or f"{closest.pair.first} and {closest.pair.second}",
        "check": None, "dense_mm": None, "reversals": reversals(run.rate),
        "passes": None, "p50_us": None, "p99_us": None,
    }  # fmt: skip


def known() -> Iterator[Job]:
    """Every case with and without acceleration limits, with and without avoidance."""
    for number, (name, _, _) in enumerate(cases()):
        for acceleration in (np.inf, ACCELERATION):
            case = name if acceleration == np.inf else f"{name}, {ACCELERATION:g} rad/s²"
            for avoids in (True, False):
                yield partial(_known, number, case, acceleration, avoids=avoids)


def _known(number: int, case: str, acceleration: float, *, avoids: bool) -> Record:
    _, task, more = list(cases())[number]
    scene = CollisionScene.of(task, cell=task.cell.with_limits(acceleration=acceleration), **{"margin": MARGIN, **more})
    return measured(case, task, scene, avoids=avoids)


def _posts(arms: int, seed: int) -> Record:
    """A cell with random posts: the run, the check before it, and dense samples."""
    task = random_posts(seed, arms=arms)
    scene = CollisionScene.of(task, margin=NEAR_MARGIN)
    found = check_path(task.cell, task.grasp, task.path, q_start=task.q_start, scene=scene)
    record = measured(f"random posts, {arms} arms, {seed}", task, scene, avoids=True)
    return {**record, "check": found.verdict.value, "dense_mm": dense(task, scene)}


def jobs(parts: Sequence[str], plan: Plan) -> list[Job]:
    """What processes can do beside each other: nothing is timed there."""
    found = [*(known() if "known" in parts else ()), *(carts() if "carts" in parts else ())]
    for arms in ARMS:
        if f"posts-{arms}" in parts:
            found += [partial(_posts, arms, seed) for seed in range(plan.posts)]
    return found


def run_all(work: Sequence[Job], workers: int) -> list[Record]:
    """Their records, in their order."""
    progress, found = common.Progress(len(work)), []
    with ProcessPoolExecutor(max_workers=workers) as pool:
        for future in [pool.submit(job) for job in work]:
            found.append(future.result())
            progress.advance(found[-1]["case"])
    progress.close()
    return found


def part_of(record: Record) -> str:
    """The part of the benchmark that a record is of."""
    case = str(record["case"])
    if record["controller"].partition(" ")[0] in PEERS:
        return "peers"
    if case.startswith("random posts"):
        return f"posts-{case.split()[2]}"
    names = {"cart": "carts", "skip:": "skip", "step,": "times", "step": "times"}
    return names.get(case.split()[0], "known")


def dense(task: Scenario, scene: CollisionScene) -> float | None:
    """Least distance [mm] along the whole path at dense samples; None where the arms cannot follow it.

    The chain follows by Newton's method from sample to sample, elbows by the shortest way.
    """
    chain, q, rows = Chain(task.cell, task.grasp), task.q_start, []
    clocks = np.linspace(0.0, task.path.duration, SAMPLES)
    for clock in clocks:
        q, errors = newton(chain, task.path.pose(clock), q, tolerance=1e-10, max_iter=20)
        x = task.cell.positions(q)
        inside = ((x >= task.cell.limits.lower) & (x <= task.cell.limits.upper)).all()
        if not (inside and np.abs(errors).max() < 1e-8):
            return None
        rows.append(q)
    closest = Closeness(scene).closest(np.array(rows), clocks)
    return None if closest is None else round(1e3 * closest.pair.distance, 6)


def skipped(plan: Plan) -> Record:
    """Violations of the certified skip: distances after random jumps against what their bounds say."""
    rng, worst, violations, asked = np.random.default_rng(0), 0.0, 0, 0
    tasks = (paper_lift(), dual_arm7(), mixed_cell(), plate_and_post())
    scenes = [CollisionScene.of(task, margin=0.0) for task in tasks]
    asking = [Distances(scene.built) for scene in scenes]
    while asked < plan.jumps:
        for scene, distances in zip(scenes, asking, strict=True):
            cell, reach = scene.cell, scene.built.reach
            low, high = np.maximum(cell.limits.lower, -3.0), np.minimum(cell.limits.upper, 3.0)
            x = rng.uniform(low, high)
            step = np.clip(x + rng.normal(size=cell.nv) * 10.0 ** rng.uniform(-4.0, -0.5), low, high) - x
            before, after = (distances.all(cell.configuration(at)) for at in (x, x + step))
            apart = (before > 0.0) & (after > 0.0)
            change, bound = np.abs(after - before)[apart], (reach @ np.abs(step))[apart]
            asked += int(apart.sum())
            violations += int((change > bound + 2e-8).sum())
            moved = bound > 1e-6
            worst = max(worst, float((change[moved] / bound[moved]).max(initial=0.0)))
    return dict(
        dict.fromkeys(KEYS), case=f"skip: {asked} jumps", controller="clearance",
        status=f"{violations} violations, worst {worst:.3f} of the bound",
    )  # fmt: skip


def step_times(plan: Plan) -> Iterator[Record]:
    """CPU time of a step without a scene and with one, far from everything and near, in turns."""
    far = Body("far", Sphere(0.1), pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    far_tasks = [
        ("3 RX-90L", paper_lift(time_law="quintic")),
        ("2 seven-joint arms", dual_arm7()),
        ("4 mixed", mixed_cell()),
    ]
    for name, task in [*far_tasks, ("8 RX-90L", ring(arms=8))]:
        ignored = [("object", arm) for arm in task.cell.arm_names] if name.startswith("8") else []
        scene = CollisionScene.of(task, obstacles=[far], margin=NEAR_MARGIN, ignored=ignored)
        yield from _timed(f"step, far: {name}", task, scene, plan)
    for acceleration in (np.inf, ACCELERATION):
        task = plate_and_post()
        cell = task.cell.with_limits(acceleration=acceleration)
        scene = CollisionScene.of(task, cell=cell, margin=MARGIN)
        case = "step with rows: plate and post" + ("" if acceleration == np.inf else f", {ACCELERATION:g} rad/s²")
        yield from _timed(case, task, scene, plan, near=True)


def _timed(case: str, task: Scenario, scene: CollisionScene, plan: Plan, *, near: bool = False) -> Iterator[Record]:
    """Times of all steps; where ``near``, of those with rows, of a QP at every step, and of coal at near pairs."""
    clearance = Clearance(scene)
    contestants: dict[str, dict[str, Any]] = {"without": {}, "clearance": {"constraints": [clearance]}}
    if near:
        contestants["qp"] = {"options": QPOptions(shortcut=False)}
    times: dict[str, list[float]] = {name: [] for name in contestants}
    passes, places = None, []
    for turn in range(plan.rounds):
        for name, given in sorted(contestants.items(), reverse=bool(turn % 2)):
            controller = QPController(scene.cell, task.grasp, task.path, dt=2e-3, **given)
            controller.reset(task.q_start)
            first, steps = clearance.passes, 0
            while True:
                before, begin = clearance.passes, time.thread_time_ns()
                step = controller.step()
                took = 1e-3 * (time.thread_time_ns() - begin)
                if not near or name != "clearance" or (clearance.passes > before and clearance.binding):
                    times[name].append(took)
                    if name == "clearance" and near:
                        places.append(step.q_next)
                steps += 1
                if step.finished or steps > 5000 or (step.rate == 0.0 and steps > 200):
                    break
            passes = f"{clearance.passes - first} of {steps}" if name == "clearance" else passes
        if near:
            times.setdefault("coal", []).extend(_coal(scene, places))
            places.clear()
    for name, own in times.items():
        p = common.percentiles(own)
        yield dict(
            dict.fromkeys(KEYS), case=case, controller=name, passes=passes if name == "clearance" else None,
            p50_us=p["p50_us"], p99_us=p["p99_us"],
        )  # fmt: skip


def _coal(scene: CollisionScene, places: list[Any]) -> Iterator[float]:
    """CPU times [µs] of coal's own distances of the pairs within 30 mm of their margin at configurations."""
    distances = Distances(scene.built)
    for q in places[:: max(1, len(places) // 50)]:
        pairs = np.flatnonzero(distances.all(q) < scene.built.margins + NEAR).tolist()
        distances.place(scene.cell.moved(q, np.full(scene.cell.nv, 1e-9)))  # nothing is known there
        begin = time.thread_time_ns()
        distances.place(q)
        for k in pairs:
            distances.one(k)
        yield 1e-3 * (time.thread_time_ns() - begin)


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--peers", nargs="*", choices=PEERS, default=(), help="beside coopqp (none)")
    parser.add_argument("--no-install", action="store_true", help="only peers that are installed already")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the peers' environments")
    parser.add_argument(
        "--case", nargs="+", choices=PARTS, default=PARTS, help="parts to run (all); the others in --json FILE are kept"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (one per core)")
    args = parser.parse_args(argv)
    plan = QUICK if args.quick else FULL
    description = common.describe("collisions", {"posts": plan.posts, "jumps": plan.jumps, "rounds": plan.rounds})
    print(common.header(description), flush=True)
    new = set(args.case) - {"peers"}
    kept = json.loads(args.json.read_text()) if args.json is not None and args.json.is_file() else []
    if any(set(r) != set(KEYS) for r in kept):
        parser.error(f"{args.json} holds records of something else: give another file")
    again = args.peers if "peers" in args.case else ()
    kept = [r for r in kept if part_of(r) not in new and r["controller"].partition(" ")[0] not in again]
    records = run_all(jobs(args.case, plan), args.workers)
    if "peers" in args.case:
        tasks = [(name, task, _scene(task, more)) for name, task, more in cases() if not more.get("inside")]
        tasks = [case for case in tasks if case[1].path.known_ahead]
        beside = peers(tasks, args.peers, args.cache, install=not args.no_install)
        records += [{**dict.fromkeys(KEYS), **record} for record in beside]
    records += [skipped(plan)] if "skip" in args.case else []
    records += step_times(plan) if "times" in args.case else []
    records = sorted([*kept, *records], key=lambda r: PARTS.index(part_of(r)))
    print("\n" + report(records))
    files = {"collisions.md": report(records).encode()} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


def report(records: Sequence[Record]) -> str:
    """The table, and the results of the random posts."""
    posts = [r for r in records if r["case"].startswith("random posts")]
    shown = [r for r in records if r not in posts]
    touched = sum(r["clearance_mm"] < r["margin_mm"] - 1e-3 for r in posts)
    slack, finished = sum(r["chain_slack"] > 0.0 for r in posts), sum(r["finished"] for r in posts)
    text = f"## Collisions\n\n{common.markdown_table(shown, KEYS)}\n\n"
    if not posts:
        return text
    text += f"{len(posts)} random posts: {touched} inside the margin, {slack} with chain slack, {finished} finished, "
    text += f"chain ≤ {max(r['chain_mm'] for r in posts):.1e} mm, path ≤ {max(r['path_mm'] for r in posts):.1e} mm\n"
    clear = [r for r in posts if r["dense_mm"] is not None and r["dense_mm"] >= 5.0]
    certified = [r for r in posts if r["check"] == "CERTIFIED"]
    text += (
        f"The check before the motion certifies {sum(r in certified for r in clear)} of {len(clear)} that are clear "
    )
    ended = sum(r["finished"] for r in certified)
    text += f"by 5 mm at dense samples; {ended} of {len(certified)} certified ones finish.\n"
    return text


if __name__ == "__main__":
    raise SystemExit(main())
