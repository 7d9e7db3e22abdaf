"""coopqp beside pink, mink, PlaCo, roboplan-oink and Drake: the same cells, starts, targets and limits, in one run.

Every peer runs in a process and a virtual environment of its own, made here; the cell goes to it as a URDF or an MJCF.
Cost is measured in interleaved rounds, behaviour on the paper's three arms. See benchmarks/README.md.

What is timed is a period of a control loop. coopqp: ``step(reading)``, its status, and its next command as an array.
Peers: the reading into their state where there is one, targets (ready made), kinematics, solve, integrate, and the next
command as an array. Readings are made, and commands kept, outside the timed part. Records of cost have

``case``, ``arms``, ``mode``, ``pacing``   see :mod:`peer_cases`; coopqp has one mode; "hot" or "1 kHz";
``ratio``                           coopqp / this record, where both do the case;
``ratio_placo``, ``p99_ratio_placo``  coopqp's record / PlaCo's mode ``hard scaled`` in the same rounds, with the same
                                    pacing: of ``measured`` in that case, of ``nominal`` in all others;
``placo_p50_us``, ``placo_p99_us``    of that PlaCo in those rounds.

Ratios are the median over the rounds of each round's ratio.

With ``--against COMMIT`` the cases of cost run beside coopqp of that commit instead: see :mod:`against`.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import against
import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases
import pinocchio as pin
from common import Record
from contestants import CACHE, PACES, PINS, Contestant, NotAvailable, hand_over, pinned, ratio

from coopqp import QPOptions
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation.metrics import tool_placements
from coopqp.spatial import Array

#: Modes that --quick runs; all others need the full run.
QUICK_MODES = {
    "pink": ("hard daqp", "soft daqp"),
    "mink": ("hard daqp", "soft daqp"),
    "placo": ("hard scaled", "soft"),
    "oink": ("soft",),
    "drake": ("soft",),
}
#: Keys of every record.
KEYS = (
    "peer", "version", "case", "arms", "mode", "pacing", "p50_us", "p99_us", "ratio", "ratio_placo", "p99_ratio_placo",
    "placo_p50_us", "placo_p99_us", "chain_mm", "chain_end_mm", "path_mm", "path_deg", "failures", "steps", "finished",
    "rate_min", "limit_excess", "note",
)  # fmt: skip
#: The peer and its mode that coopqp's records are compared with, and its case by coopqp's, where it is not "nominal".
REFERENCE, REFERENCE_MODE, REFERENCE_CASES = "placo", "hard scaled", {"measured": "measured"}

#: Beside another commit rounds are shorter by this factor; the ring has at most so many arms.
AGAINST_SHORTER, MOST_ARMS_AGAINST = 4, 8


@dataclass(frozen=True)
class Target:
    """A figure of coopqp's records, and the most that it should be."""

    case: str
    pacing: str
    key: str
    most: float
    arms: int = 3


TARGETS = (
    Target("nominal", "hot", "ratio_placo", 0.20),
    Target("nominal", "1 kHz", "ratio_placo", 0.40),
    Target("measured", "hot", "ratio_placo", 0.30),
    Target("measured", "1 kHz", "ratio_placo", 0.35),
    Target("watched", "hot", "ratio_placo", 0.35),
    Target("watched", "1 kHz", "ratio_placo", 0.40),
    Target("qp", "hot", "ratio_placo", 0.45),
    Target("qp", "1 kHz", "ratio_placo", 0.50),
    Target("measured", "1 kHz", "p99_ratio_placo", 0.60),
    Target("measured", "1 kHz", "ratio_placo", 0.15, arms=8),
    Target("measured", "1 kHz", "ratio_placo", 0.07, arms=16),
)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is run.

    Attributes:
        arms: numbers of arms round the ring.
        cases: of behaviour and of cost.
        rounds: of each contestant, with each pacing.
        steps: of each round.
        round_s: a round ends after this time [s].
        behave_s: a run of behaviour ends after this time [s].
        all_modes: also the modes that are not in QUICK_MODES.
    """

    arms: tuple[int, ...] = (3, 8, 16, 32)
    cases: tuple[str, ...] = (*peer_cases.BEHAVIOUR, *peer_cases.COST)
    rounds: int = 8
    steps: int = 400
    round_s: float = 0.5
    behave_s: float = 10.0
    all_modes: bool = True


FULL = Plan()
QUICK = Plan(arms=(3, 8), rounds=4, steps=50, round_s=0.1, behave_s=0.3, all_modes=False)


# -- what a run was worth ----------------------------------------------------------------------------------------------


def judge(case: peer_cases.Case, rows: Any) -> Record:
    """Measures of a run from its configurations alone (T, nv).

    ``chain_mm``: largest distance between any two arms' views of the object; ``path_mm``, ``path_deg``: distance and
    angle of the object, as the first arm carries it, from the nearest point of its path.
    """
    s = case.scenario
    tools = tool_placements(s.cell, rows)
    views = [[T * X.inverse() for T, X in zip(row, s.grasp.T_object_tool, strict=True)] for row in tools]
    p = np.array([[O.translation for O in row] for row in views])
    chain = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1).max(axis=(1, 2))
    clocks = np.linspace(0.0, s.path.duration, 2001)
    poses = [s.path.pose(float(clock)) for clock in clocks]
    away, turned = _off_path(p[:, 0], [row[0].rotation for row in views], poses)
    end = float(np.linalg.norm(p[-1, 0] - poses[-1].translation))
    v = np.abs(np.diff(np.asarray(rows), axis=0)).max(initial=0.0, axis=0) / s.dt
    return {
        "chain_mm": 1e3 * float(chain.max()),
        "chain_end_mm": 1e3 * float(chain[-1]),
        "path_mm": 1e3 * float(away.max()),
        "path_deg": float(np.rad2deg(turned.max())),
        "finished": bool(end < 1e-3) if case.name == "fast" else None,
        "limit_excess": _excess(s.cell, np.asarray(rows[-1]), v),
    }


def _excess(cell: RobotCell, q: Array, v: Array) -> float:
    """Largest excess over a velocity limit during the run or a position limit at its end; 0 if none."""
    limits = cell.limits
    return float(max(0.0, (v - limits.velocity).max(), (q - limits.upper).max(), (limits.lower - q).max()))


def _off_path(points: Array, rotations: Sequence[Array], poses: Sequence[pin.SE3]) -> tuple[Array, Array]:
    """Distance to the polyline through the poses, and the angle to the pose that is nearest on it."""
    corners = np.array([T.translation for T in poses])
    ways = np.diff(corners, axis=0)
    squares = np.maximum((ways * ways).sum(axis=1), 1e-30)
    away, turned = [], []
    for point, R in zip(points, rotations, strict=True):
        share = np.clip(((point - corners[:-1]) * ways).sum(axis=1) / squares, 0.0, 1.0)
        distance = np.linalg.norm(point - corners[:-1] - share[:, None] * ways, axis=1)
        i = int(distance.argmin())
        nearest = poses[i].rotation @ pin.exp3(share[i] * pin.log3(poses[i].rotation.T @ poses[i + 1].rotation))
        away.append(float(distance[i]))
        turned.append(float(np.linalg.norm(pin.log3(nearest.T @ R))))
    return np.array(away), np.array(turned)


# -- the run -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Entry:
    """One way of doing a case of cost, its times [µs] round by round, its failed steps and the first one's reason."""

    contestant: Contestant
    mode: str
    rounds: list[list[float]] = field(default_factory=list)
    failures: int = 0
    note: str = ""

    def clear(self) -> None:
        """Forget the times."""
        self.rounds, self.failures, self.note = [], 0, ""

    def run(self, plan: Plan, period: float) -> None:
        """One round more; ``period`` in s, 0 for hot."""
        steps = plan.steps
        try:
            answer = self.contestant.ask(
                do="time", mode=self.mode, steps=steps, period=period, budget=plan.round_s, timeout=120.0
            )
        except NotAvailable as error:
            answer = {"us": [], "failures": steps, "note": str(error)}
        self.rounds.append(answer["us"])
        self.failures += answer["failures"]
        self.note = self.note or answer["note"]

    def percentiles(self) -> dict[str, float | None]:
        """Over all rounds."""
        return common.percentiles([x for times in self.rounds for x in times])


@dataclass
class Comparison:
    """Contestants, and the records so far.

    Attributes:
        reference: the peer that coopqp's records are compared with, in a second process, where it does another case
            than coopqp; None where it does not run.
    """

    plan: Plan
    contestants: list[Contestant]
    folder: Path
    progress: common.Progress
    records: list[Record] = field(default_factory=list)
    reference: Contestant | None = None

    def modes(self, contestant: Contestant) -> tuple[str, ...]:
        """Modes of a contestant that the plan runs."""
        quick = QUICK_MODES.get(contestant.name)
        if self.plan.all_modes or quick is None:
            return contestant.modes
        return tuple(mode for mode in contestant.modes if mode in quick)

    def record(self, contestant: Contestant, case: str, arms: int, **values: Any) -> Record:
        """Add a record; keys that do not apply are None."""
        record: Record = dict.fromkeys(KEYS)
        record.update(peer=contestant.name, version=contestant.version, case=case, arms=arms, **values)
        self.records.append(record)
        return record

    def _file(self, case: peer_cases.Case) -> Path:
        """The task's file, written when first asked for."""
        folder = self.folder / f"{case.name}_{len(case.scenario.cell)}"
        return folder / "task.json" if folder.exists() else hand_over(case, folder)

    def _load(self, case: peer_cases.Case) -> Iterator[Contestant]:
        """Contestants that have read the case; those that cannot are recorded."""
        arms = len(case.scenario.cell)
        file = self._file(case)
        for contestant in self.contestants:
            if contestant.name != "coopqp" and case.name in peer_cases.COST and case.name not in peer_cases.PEER_COST:
                continue
            try:
                contestant.load(file)
            except NotAvailable as error:
                self.record(contestant, case.name, arms, note=str(error))
            else:
                yield contestant

    def _behave(self, contestant: Contestant, case: peer_cases.Case, mode: str) -> Record:
        """One run from the start, within the time; None if the runner gives up."""
        limit = self.plan.behave_s
        if case.name == "fast":
            limit *= 3.0
        try:
            run = contestant.ask(do="behave", mode=mode, steps=case.steps, budget=limit, timeout=limit + 120.0)
        except NotAvailable as error:
            return {"failures": case.steps, "note": str(error)}
        worth = judge(case, run["q"])
        return {
            **worth,
            **common.percentiles(run["us"]),
            "failures": run["failures"],
            "steps": len(run["us"]),
            "rate_min": run["least"],
            "note": run["note"],
        }

    def behaviour(self, name: str) -> None:
        """One case of behaviour: every contestant, every mode."""
        case = peer_cases.build(name)
        for contestant in self._load(case):
            for mode in self.modes(contestant):
                self.progress.label = f"{name}: {contestant.name} {mode}"
                self.progress.show()
                worth = self._behave(contestant, case, mode)
                self.record(contestant, name, len(case.scenario.cell), mode=mode, **worth)
        self.progress.advance()

    def cost(self, name: str, arms: int) -> None:
        """One case of cost: first the errors of the motion, then its time in interleaved rounds."""
        case = peer_cases.build(name, arms)
        ready = list(self._load(case))
        entries = [Entry(contestant, mode) for contestant in ready for mode in self.modes(contestant)]
        own = [entry for entry in entries if entry.contestant.name == "coopqp"]
        reference = self._reference(name, arms, entries)
        worth = [self._behave(entry.contestant, case, entry.mode) for entry in entries]
        running = entries if reference is None or reference in entries else [*entries, reference]
        for pacing, period in PACES.items():
            self.progress.label = f"{name}, {arms} arms, {pacing}"
            self.progress.show()
            for entry in running:
                entry.clear()
            for number in range(self.plan.rounds):
                for entry in reversed(running) if number % 2 else running:
                    entry.run(self.plan, period)
            for entry, found in zip(entries, worth, strict=True):
                values = {k: v for k, v in found.items() if not k.endswith("_us")}
                values["failures"] = values["failures"] + entry.failures
                values["note"] = values["note"] or entry.note
                values["steps"] = sum(len(times) for times in entry.rounds)
                values["ratio"] = ratio(own[0].rounds, entry.rounds) if own else None
                if entry in own and reference is not None:
                    values["ratio_placo"] = ratio(entry.rounds, reference.rounds)
                    values["p99_ratio_placo"] = ratio(entry.rounds, reference.rounds, share=99.0)
                    values |= {f"placo_{key}": value for key, value in reference.percentiles().items()}
                values |= entry.percentiles()
                self.record(entry.contestant, name, arms, mode=entry.mode, pacing=pacing, **values)
            self.progress.advance()

    def _reference(self, name: str, arms: int, entries: Sequence[Entry]) -> Entry | None:
        """What coopqp's records of a case are compared with: one of the entries, or one that runs along."""
        wanted = REFERENCE_CASES.get(name, "nominal")
        if wanted == name:
            key = (REFERENCE, REFERENCE_MODE)
            return next((entry for entry in entries if (entry.contestant.name, entry.mode) == key), None)
        if self.reference is None:
            return None
        try:
            self.reference.load(self._file(peer_cases.build(wanted, arms)))
        except NotAvailable:  # a record of its own case says why
            return None
        return Entry(self.reference, REFERENCE_MODE)


def compare(peers: Sequence[str], plan: Plan, cache: Path, *, install: bool) -> list[Record]:
    """Run everything; peers that are not available are in the records, with a note."""
    behaviour = [case for case in peer_cases.BEHAVIOUR if case in plan.cases]
    cost = [case for case in peer_cases.COST if case in plan.cases]
    progress = common.Progress(len(peers) + len(behaviour) + len(PACES) * len(cost) * len(plan.arms))
    with tempfile.TemporaryDirectory(prefix="compare_peers_") as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        missing: list[Record] = []
        contestants: list[Contestant] = []
        reference: Contestant | None = None
        for name in ("coopqp", *peers):
            progress.label = f"installing {name}"
            progress.show()
            try:
                contestants.append(Contestant.start(name, cache, install=install))
            except NotAvailable as error:
                missing.append({**dict.fromkeys(KEYS), "peer": name, "version": pinned(name), "note": str(error)})
            else:
                stack.callback(contestants[-1].stop)
                if name == REFERENCE and any(REFERENCE_CASES.get(case, "nominal") != case for case in cost):
                    reference = Contestant.start(name, cache, install=False)
                    stack.callback(reference.stop)
            if name != "coopqp":
                progress.advance()
        comparison = Comparison(plan, contestants, folder, progress, missing, reference)
        for case in behaviour:
            comparison.behaviour(case)
        for arms in plan.arms:
            for case in cost:
                comparison.cost(case, arms)
    progress.close()
    return comparison.records


# -- tables ------------------------------------------------------------------------------------------------------------


def report(records: Sequence[Record]) -> str:
    """Behaviour and cost as Markdown."""
    missing = [r for r in records if r["mode"] is None]
    parts = []
    behaviour = [r for r in records if r["case"] in peer_cases.BEHAVIOUR and r["mode"]]
    columns = (
        "case", "peer", "mode", "failures", "steps", "chain_mm", "chain_end_mm", "path_mm", "path_deg", "finished",
        "rate_min", "limit_excess", "note",
    )  # fmt: skip
    if behaviour:
        title = "## Behaviour: three arms, joints limited to 1 rad/s"
        parts.append(f"{title}\n\n" + common.markdown_table(behaviour, columns))
    timing = (
        "peer", "mode", "p50_us", "p99_us", "ratio", "ratio_placo", "p99_ratio_placo", "failures", "chain_mm",
        "path_mm",
    )  # fmt: skip
    for case in peer_cases.COST:
        for arms in sorted({r["arms"] for r in records if r["case"] == case and r["mode"]}):
            for pacing in PACES:
                rows = [r for r in records if (r["case"], r["pacing"], r["arms"]) == (case, pacing, arms)]
                title = f"## Cost of one step: {case}, {arms} arms, {pacing} (ratio: coopqp / peer)"
                parts.append(f"{title}\n\n" + common.markdown_table(rows, timing))
    if any(r["case"] in peer_cases.COST for r in records):
        parts.append(against_placo(records))
    if missing:
        parts.append("## Not run\n\n" + common.markdown_table(missing, ("peer", "version", "case", "arms", "note")))
    return "\n\n".join(parts) + "\n"


def against_placo(records: Sequence[Record]) -> str:
    """coopqp ÷ PlaCo as a table; targets stand beside the figures."""
    targets = {(t.case, t.arms, t.pacing, t.key): t.most for t in TARGETS}
    rows: list[Record] = []
    for r in records:
        if r["peer"] != "coopqp" or r["pacing"] is None:
            continue
        row = {**r, "placo_case": REFERENCE_CASES.get(r["case"], "nominal")}
        for key in ("ratio_placo", "p99_ratio_placo"):
            row[key] = _beside(r[key], targets.get((r["case"], r["arms"], r["pacing"], key)))
        rows.append(row)
    if not rows:
        return "## coopqp ÷ PlaCo\n\ncoopqp has no cost."
    columns = (
        "case", "arms", "pacing", "ratio_placo", "p99_ratio_placo", "p50_us", "placo_p50_us", "placo_case", "steps",
        "failures",
    )  # fmt: skip
    note = "In brackets: the most that is wanted. `placo_p50_us` is PlaCo (hard, scaled) in the same rounds."
    return f"## coopqp ÷ PlaCo\n\n{note}\n\n{common.markdown_table(rows, columns)}"


def _beside(found: float | None, most: float | None) -> str | None:
    """A figure with its target."""
    if found is None or most is None:
        return None if found is None else common.cell_text(found)
    return f"{common.cell_text(found)} (≤ {most:g}: {'met' if found <= most else 'missed'})"


def plot(records: Sequence[Record]) -> dict[str, bytes]:
    """Cost against the number of arms, as PNG; nothing without Matplotlib."""
    names = {"nominal": "", "qp": ", a QP every step"}
    curves: dict[str, list[tuple[float, float]]] = {}
    for r in records:
        if (
            r["case"] in names
            and r["pacing"] == "hot"
            and r["p50_us"]
            and r["mode"] in QUICK_MODES.get(r["peer"], (r["mode"],))
        ):
            label = f"{r['peer']} ({r['mode']}){names[r['case']]}"
            curves.setdefault(label, []).append((r["arms"], r["p50_us"]))
    if not curves:
        return {}
    return common.log_log_plot("peers.png", curves, x="arms", y="one step, hot, nominal: median [µs]")


def run_against(args: argparse.Namespace, plan: Plan) -> int:
    """The cases of cost beside another commit. Returns 1 if that cannot run."""
    cases = [case for case in peer_cases.COST if case in plan.cases]
    arms = args.arms or [n for n in plan.arms if n <= MOST_ARMS_AGAINST]
    settings = {"times": "CPU time of the process", "commit": args.against, "rounds": against.PAIRS * plan.rounds}
    description = common.describe("compare_peers --against", settings)
    print(common.header(description), flush=True)
    try:
        records = against.compare(
            args.against, args.cache, cases=cases, arms=arms, rounds=plan.rounds,
            steps=plan.steps // AGAINST_SHORTER, round_s=plan.round_s,
        )  # fmt: skip
    except NotAvailable as error:
        print(f"{args.against} is not compared: {error}")
        return 1
    text = against.report(records)
    print("\n" + text)
    files = {"against.md": text.encode()} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--peers", nargs="*", choices=tuple(PINS), default=tuple(PINS), help="which peers (all)")
    parser.add_argument("--cases", nargs="+", choices=FULL.cases, help="which cases (all)")
    parser.add_argument("--arms", nargs="+", type=int, metavar="N", help="how many arms in the cases of cost")
    parser.add_argument("--no-install", action="store_true", help="only peers that are installed already")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the peers' environments")
    parser.add_argument("--against", metavar="COMMIT", help="instead of peers: coopqp of this commit, built beside")
    args = parser.parse_args(argv)
    plan = QUICK if args.quick else FULL
    plan = replace(plan, cases=tuple(args.cases or plan.cases), arms=tuple(args.arms or plan.arms))
    if args.against is not None:
        return run_against(args, plan)
    settings = {
        "times": "CPU time of the process",
        "dt of cost cases": "1 ms",
        "readings": f"one sample late, ±{peer_cases.NOISE:g} rad",
        "coopqp solver": QPOptions().solver,
        "rounds": plan.rounds,
        "steps a round": plan.steps,
    }
    description = common.describe("compare_peers", {**settings, **{p: " ".join(PINS[p]) for p in args.peers}})
    print(common.header(description), flush=True)
    records = compare(args.peers, plan, args.cache, install=not args.no_install)
    text = report(records)
    print("\n" + text)
    files = {"peers.md": text.encode(), **plot(records)} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
