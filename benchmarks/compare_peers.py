"""coopqp beside pink, mink, PlaCo and roboplan-oink: the same cells, starts, targets and limits, in one run.

Every peer runs in a process and a virtual environment of its own, made here; the cell goes to it as a URDF or an MJCF.
Cost is measured in interleaved rounds, behaviour on the paper's three arms. See benchmarks/README.md.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases
import pinocchio as pin
from common import Record
from contestants import CACHE, PACES, PINS, Contestant, NotAvailable, hand_over, pinned, ratio

from coopqp import available_kernels
from coopqp.model.cell import RobotCell
from coopqp.simulation.metrics import tool_placements
from coopqp.spatial import Array

#: Modes that --quick runs; all others need the full run.
QUICK_MODES = {
    "pink": ("hard daqp", "soft daqp"),
    "mink": ("hard daqp", "soft daqp"),
    "placo": ("hard scaled", "soft"),
    "oink": ("soft",),
}
#: Keys of every record.
KEYS = (
    "peer", "version", "case", "arms", "mode", "pacing", "p50_us", "p99_us", "ratio", "ratio_numpy", "chain_mm",
    "chain_end_mm", "path_mm", "path_deg", "failures", "steps", "finished", "rate_min", "limit_excess", "note",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is run.

    Attributes:
        arms: numbers of arms round the ring.
        rounds: of each contestant, hot; half as many, at least two, at 1 kHz.
        steps: of each round.
        round_s: a round ends after this time [s].
        behave_s: a run of behaviour ends after this time [s].
        all_modes: also the modes that are not in QUICK_MODES.
    """

    arms: tuple[int, ...] = (3, 8, 16, 32)
    rounds: int = 8
    steps: int = 300
    round_s: float = 0.5
    behave_s: float = 10.0
    all_modes: bool = True


FULL = Plan()
QUICK = Plan(arms=(3, 8), rounds=4, steps=30, round_s=0.1, behave_s=0.3, all_modes=False)


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


@dataclass
class Comparison:
    """Contestants, and the records so far."""

    plan: Plan
    contestants: list[Contestant]
    folder: Path
    progress: common.Progress
    records: list[Record] = field(default_factory=list)

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

    def _load(self, case: peer_cases.Case) -> Iterator[Contestant]:
        """Contestants that have read the case; those that cannot are recorded."""
        arms = len(case.scenario.cell)
        file = hand_over(case, self.folder / f"{case.name}_{arms}")
        for contestant in self.contestants:
            try:
                contestant.load(file)
            except NotAvailable as error:
                self.record(contestant, case.name, arms, note=str(error))
            else:
                yield contestant

    def _behave(self, contestant: Contestant, case: peer_cases.Case, mode: str) -> Record:
        """One run from the start, as far as time allows; None where the runner gave up."""
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
        """One case of cost: first what the motion is worth, then its time in interleaved rounds."""
        case = peer_cases.build(name, arms)
        ready = list(self._load(case))
        entries = [(contestant, mode) for contestant in ready for mode in self.modes(contestant)]
        worth = {(c.name, mode): self._behave(c, case, mode) for c, mode in entries}
        for pacing, period in PACES.items():
            rounds = max(2, self.plan.rounds // 2) if period else self.plan.rounds
            self.progress.label = f"{name}, {arms} arms, {pacing}"
            self.progress.show()
            samples, failures, notes = self._rounds(entries, period, rounds)
            # coopqp's first mode is its fastest kernel.
            own = next((rows for (name, _), rows in samples.items() if name == "coopqp"), [])
            own_numpy = samples.get(("coopqp", "numpy"), [])
            for contestant, mode in entries:
                key = (contestant.name, mode)
                values = {k: v for k, v in worth[key].items() if not k.endswith("_us")}
                values["failures"] = values["failures"] + failures[key]
                values["note"] = values["note"] or notes[key]
                values["steps"] = sum(len(r) for r in samples[key])
                self.record(
                    contestant, name, arms, mode=mode, pacing=pacing, **values,
                    **common.percentiles([x for r in samples[key] for x in r]),
                    ratio=ratio(own, samples[key]), ratio_numpy=ratio(own_numpy, samples[key]),
                )  # fmt: skip
            self.progress.advance()

    def _rounds(
        self, entries: Sequence[tuple[Contestant, str]], period: float, rounds: int
    ) -> tuple[dict[tuple[str, str], list[list[float]]], dict[tuple[str, str], int], dict[tuple[str, str], str]]:
        """Times [µs] of every round of every entry, in turn; failed steps; the first failure's reason."""
        keys = [(contestant.name, mode) for contestant, mode in entries]
        samples: dict[tuple[str, str], list[list[float]]] = {key: [] for key in keys}
        failures, notes = dict.fromkeys(keys, 0), dict.fromkeys(keys, "")
        plan = self.plan
        for number in range(rounds):
            for contestant, mode in reversed(entries) if number % 2 else entries:
                key = (contestant.name, mode)
                try:
                    answer = contestant.ask(
                        do="time", mode=mode, steps=plan.steps, period=period, budget=plan.round_s, timeout=120.0
                    )
                except NotAvailable as error:
                    notes[key] = notes[key] or str(error)
                    failures[key] += plan.steps
                    samples[key].append([])
                else:
                    samples[key].append(answer["us"])
                    failures[key] += answer["failures"]
                    notes[key] = notes[key] or answer["note"]
        return samples, failures, notes


def compare(peers: Sequence[str], plan: Plan, cache: Path, *, install: bool) -> list[Record]:
    """Run everything; peers that are not available are in the records, with a note."""
    progress = common.Progress(len(peers) + len(peer_cases.BEHAVIOUR) + 2 * len(peer_cases.COST) * len(plan.arms))
    with tempfile.TemporaryDirectory(prefix="compare_peers_") as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        missing: list[Record] = []
        contestants: list[Contestant] = []
        for name in ("coopqp", *peers):
            progress.label = f"installing {name}"
            progress.show()
            try:
                contestants.append(Contestant.start(name, cache, install=install))
            except NotAvailable as error:
                missing.append({**dict.fromkeys(KEYS), "peer": name, "version": pinned(name), "note": str(error)})
            else:
                stack.callback(contestants[-1].stop)
            if name != "coopqp":
                progress.advance()
        comparison = Comparison(plan, contestants, folder, progress, missing)
        for case in peer_cases.BEHAVIOUR:
            comparison.behaviour(case)
        for arms in plan.arms:
            for case in peer_cases.COST:
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
    parts.append("## Behaviour: three arms, joints limited to 1 rad/s\n\n" + common.markdown_table(behaviour, columns))
    timing = ("peer", "mode", "p50_us", "p99_us", "ratio", "ratio_numpy", "failures", "chain_mm", "path_mm")
    for case in peer_cases.COST:
        for arms in sorted({r["arms"] for r in records if r["case"] == case and r["mode"]}):
            for pacing in PACES:
                rows = [r for r in records if (r["case"], r["pacing"], r["arms"]) == (case, pacing, arms)]
                title = f"## Cost of one step: {case}, {arms} arms, {pacing} (ratio: coopqp / peer)"
                parts.append(f"{title}\n\n" + common.markdown_table(rows, timing))
    if missing:
        parts.append("## Not run\n\n" + common.markdown_table(missing, ("peer", "version", "case", "arms", "note")))
    return "\n\n".join(parts) + "\n"


def plot(records: Sequence[Record]) -> dict[str, bytes]:
    """Cost against the number of arms, as PNG; nothing without Matplotlib."""
    shown = {"coopqp": (*available_kernels(), "always a QP"), **QUICK_MODES}
    rows = [r for r in records if r["case"] == "nominal" and r["pacing"] == "hot" and r["p50_us"]]
    rows = [r for r in rows if r["mode"] in shown[r["peer"]]]
    curves = {
        f"{peer} ({mode})": [(r["arms"], r["p50_us"]) for r in rows if (r["peer"], r["mode"]) == (peer, mode)]
        for peer, mode in dict.fromkeys((r["peer"], r["mode"]) for r in rows)
    }
    return common.log_log_plot("peers.png", curves, x="arms", y="one step, hot, nominal: median [µs]")


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--peers", nargs="*", choices=tuple(PINS), default=tuple(PINS), help="which peers (all)")
    parser.add_argument("--no-install", action="store_true", help="only peers that are installed already")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the peers' environments")
    args = parser.parse_args(argv)
    plan = QUICK if args.quick else FULL
    settings = {
        "times": "CPU time of the process",
        "dt of cost cases": "1 ms",
        "coopqp solver": "daqp",
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
