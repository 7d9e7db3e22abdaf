"""Ways round: how soon is the first one found, how soon is it proved, how long is it, and does anything touch?

Each problem of :mod:`route_cases` is searched with many seeds, all turns of the object allowed; its scene is built
before. Random scenes follow, starts and goals that are impossible, and bodies that come into the way of an object in
motion. See benchmarks/README.md.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import common  # first: it limits BLAS to one thread
import numpy as np
import ompl_routes
import route_ahead
import route_shelves
from common import Record
from route_cases import PROBLEMS, Problem, impossible, random_scene

from coopqp import find_path
from coopqp.errors import CoopqpError
from coopqp.planning import Route

KEYS = (
    "problem", "seed", "engine", "found", "first_s", "total_s", "length_m", "check", "duration_s", "clearance_mm",
    "length_rad", "their_length_rad",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Seeds of problems and of queries, random scenes, bodies ahead, seeds of the peer, and the longest search [s]."""

    seeds: int = 100
    shelves: int = 34
    scenes: int = 300
    ahead: int = 100
    peer_seeds: int = 10
    time_limit: float = 10.0


FULL, QUICK = Plan(), Plan(seeds=3, shelves=1, scenes=4, ahead=2, peer_seeds=1, time_limit=5.0)


def searched(name: str, seed: int, problem: Problem, time_limit: float) -> tuple[Record, Route]:
    """The record of one search, and its answer."""
    cell, grasp, start, goal, scene, q_start = problem
    route = find_path(cell, grasp, start, goal, scene, q_start=q_start, seed=seed, time_limit=time_limit)
    record = dict.fromkeys(KEYS) | {
        "problem": name, "seed": seed, "engine": "coopqp", "found": route.found, "first_s": route.first_s,
        "total_s": route.total_s, "check": route.verdict.value,
    }  # fmt: skip
    if route.check is not None and route.check.clearance is not None:
        pair = route.check.clearance.pair
        record |= {
            "length_m": route.length, "check": route.check.verdict.value,
            "clearance_mm": None if pair is None else 1e3 * pair.distance,
            "length_rad": None if route.joints is None else route_shelves.joint_length(route.joints),
        }  # fmt: skip
    return record, route


def duration(route: Route) -> float | None:
    """Duration of the timed motion [s]; None where the timing fails."""
    try:
        return route.timed().path.duration if route.found else None
    except CoopqpError:
        return None


def problems(plan: Plan, names: Sequence[str], seeds: Sequence[int], progress: common.Progress) -> Iterator[Record]:
    """Problems with every seed."""
    for name in names:
        problem = PROBLEMS[name]()
        for seed in seeds:
            progress.advance(name)
            record, route = searched(name, seed, problem, plan.time_limit)
            yield record | {"duration_s": duration(route)}


def shelves(plan: Plan, seeds: Sequence[int], progress: common.Progress) -> Iterator[Record]:
    """The published problem of two arms that reach into shelves."""
    for query in route_shelves.QUERIES:
        name, problem = route_shelves.name_of(query), route_shelves.problem(query)
        for seed in seeds:
            progress.advance(name)
            record, route = searched(name, seed, problem, plan.time_limit)
            theirs = route_shelves.length_in_their_coordinates
            yield record | {
                "duration_s": duration(route),
                "their_length_rad": None if route.joints is None else theirs(problem.cell, route.joints),
            }


def scenes(plan: Plan, numbers: Sequence[int], progress: common.Progress) -> Iterator[Record]:
    """Random scenes; where the proof refutes a way, the check of the record is REFUTED."""
    for seed in numbers:
        progress.advance("random")
        record, route = searched("random", seed, random_scene(seed), plan.time_limit)
        yield record | ({"check": "REFUTED"} if "INFEASIBLE" in route.refused else {})


def bodies_ahead(numbers: Sequence[int], progress: common.Progress) -> Iterator[Record]:
    """Runs in which a body comes into the way of an object in motion; see :mod:`route_ahead` for their ``check``."""
    for seed in numbers:
        progress.advance(route_ahead.NAME)
        yield dict.fromkeys(KEYS) | route_ahead.run(seed)


def impossibles(progress: common.Progress) -> Iterator[Record]:
    """Starts and goals that are impossible: the time until that is said."""
    for name, problem in impossible().items():
        progress.advance(name)
        record, _ = searched(name, 0, problem, 10.0)
        yield record


def peers(plan: Plan, progress: common.Progress) -> Iterator[Record]:
    """OMPL on every problem; nothing where it is not installed."""
    for name in PROBLEMS if ompl_routes.available() else ():
        problem = PROBLEMS[name]()
        for seed in range(plan.peer_seeds):
            progress.advance(f"ompl, {name}")
            for row in ompl_routes.rows(name, seed, problem, plan.time_limit):
                yield dict.fromkeys(KEYS) | row


def part_of(record: Record) -> str:
    """The part of the benchmark that makes a record."""
    if record["engine"] != "coopqp":
        return "ompl"
    name = str(record["problem"])
    if name == route_ahead.NAME:
        return "ahead"
    if name in map(route_shelves.name_of, route_shelves.QUERIES):
        return "shelves"
    return name if name in (*PROBLEMS, "random") else "impossible"


def report(records: Sequence[Record]) -> str:
    """A row for each problem and engine."""
    rows = []
    for name, engine in dict.fromkeys((r["problem"], r["engine"]) for r in records):
        own = [r for r in records if (r["problem"], r["engine"]) == (name, engine)]
        first, total = (np.array([r[key] for r in own]) for key in ("first_s", "total_s"))
        durations = [r["duration_s"] for r in own if r["duration_s"]]
        rows.append(
            {
                "problem": name,
                "engine": engine,
                "found": f"{sum(r['found'] for r in own)}/{len(own)}",
                "without a stop": f"{sum(r['check'] == 'ROUND' for r in own)}/{len(own)}"
                if name == route_ahead.NAME
                else None,
                "certified": f"{sum(r['check'] == 'CERTIFIED' for r in own)}/{len(own)}",
                "refuted": sum(r["check"] == "REFUTED" or (r["check"] == "INFEASIBLE" and r["found"]) for r in own),
                "first 50/99/max [s]": "/".join(f"{x:.3f}" for x in np.percentile(first, [50, 99, 100])),
                "total 50 [s]": float(np.median(total)),
                "length 50 [m]": _median(r["length_m"] for r in own),
                "joints' length 50 [rad]": _median(r["length_rad"] for r in own),
                "their length 50 [rad]": _median(r["their_length_rad"] for r in own),
                "duration 50 [s]": _median(durations),
                "over the best": float(np.median(durations) / min(durations)) if durations else None,
                "least clearance [mm]": min((r["clearance_mm"] for r in own if r["clearance_mm"]), default=None),
            }
        )
    text = f"## Ways round\n\n{common.markdown_table(rows, list(rows[0]))}\n"
    if not any(r["engine"].startswith("ompl") for r in records):
        text += f"\nLeft out: the rows of {', '.join(ompl_routes.ENGINES)}: {ompl_routes.REMEDY}\n"
    return text


def _median(values: object) -> float | None:
    numbers = [v for v in values if v is not None]  # type: ignore[attr-defined]
    return float(np.median(numbers)) if numbers else None


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parts = [*PROBLEMS, "shelves", "random", "impossible", "ahead", "ompl"]
    parser.add_argument(
        "--case", nargs="+", choices=parts, default=parts, help="parts to run (all); the others in --json FILE are kept"
    )
    parser.add_argument(
        "--seeds", nargs=2, type=int, metavar=("LOW", "HIGH"), help="seeds LOW … HIGH − 1 only; the others are kept"
    )
    parser.add_argument(
        "--processor-time", action="store_true", help="count processor time, the limits' too: for a busy machine"
    )
    args = parser.parse_args(argv)
    if args.processor_time:
        time.perf_counter = time.process_time
    plan = QUICK if args.quick else FULL
    description = common.describe("routes", {"seeds": plan.seeds, "random scenes": plan.scenes})
    print(common.header(description), flush=True)
    kept = json.loads(args.json.read_text()) if args.json is not None and args.json.is_file() else []
    if any(set(record) != set(KEYS) for record in kept):
        parser.error(f"{args.json} holds records of something else: give another file")
    names = [name for name in PROBLEMS if name in args.case]
    counts = {**dict.fromkeys(names, plan.seeds), "shelves": plan.shelves, "random": plan.scenes, "ahead": plan.ahead}
    numbers = {part: range(*(args.seeds or (0, most))) for part, most in counts.items() if part in args.case}
    progress = common.Progress(sum(map(len, numbers.values())) + 2 * len(numbers.get("shelves", ())))
    again = {(part, seed) for part, seeds in numbers.items() for seed in seeds}
    whole = {"impossible", "ompl"} & {*args.case}
    records = [r for r in kept if part_of(r) not in whole and (part_of(r), r["seed"]) not in again]
    for name in names:
        records += problems(plan, [name], numbers[name], progress)
    records += shelves(plan, numbers["shelves"], progress) if "shelves" in numbers else []
    records += scenes(plan, numbers["random"], progress) if "random" in numbers else []
    records += bodies_ahead(numbers["ahead"], progress) if "ahead" in numbers else []
    records += impossibles(progress) if "impossible" in args.case else []
    records += peers(plan, progress) if "ompl" in args.case else []
    records.sort(key=lambda r: (parts.index(part_of(r)), r["engine"], r["seed"]))
    progress.close()
    print("\n" + report(records))
    files = {"routes.md": report(records).encode()} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
