"""Time of one step over the number of arms (1 to 64) and the joints per arm; installed peers take part up to 32 arms.

Rounds of each size alternate with rounds of coopqp with four such arms: sizes are comparable in spite of slow phases of
the machine. Every contestant runs in a separate process. See benchmarks/README.md.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import common  # first: it limits BLAS to one thread
import peer_cases
from common import Record
from contestants import CACHE, PACES, PINS, Contestant, NotAvailable, hand_over, pinned, ratio

#: The size that others are compared with.
REFERENCE = 4
#: Largest number of arms for peers: their cost grows with its cube.
PEER_ARMS = 32
#: One mode of each peer, with a hard chain if available.
PEER_MODES = {"pink": "hard daqp", "mink": "hard daqp", "placo": "hard scaled", "oink": "soft", "drake": "soft"}
#: Memory of a controller [bytes / nv³]: about eight Pinocchio data with four tensors of nv³ numbers each.
_BYTES = 8 * 4 * 8
KEYS = ("peer", "version", "mode", "arms", "joints", "pacing", "p50_us", "p99_us", "ratio_4", "steps", "note")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Sizes, rounds, and steps per round; a round ends after ``round_s`` seconds."""

    arms: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
    peers: tuple[int, ...] = (3, 8, 16, 32)
    rounds: int = 8
    steps: int = 100
    round_s: float = 0.5


FULL = Plan()
QUICK = Plan(arms=(1, 2, 4, 8, 16), peers=(4, 16), rounds=4, steps=30, round_s=0.1)


def free_memory() -> float:
    """Available memory [bytes]; infinite if the system does not report it."""
    meminfo = Path("/proc/meminfo")
    lines = meminfo.read_text().splitlines() if meminfo.is_file() else []
    found = [float(line.split()[1]) * 1024.0 for line in lines if line.startswith("MemAvailable")]
    return found[0] if found else float("inf")


class Scaling:
    """The run; it adds to ``records``."""

    def __init__(self, plan: Plan, folder: Path, progress: common.Progress) -> None:
        self.plan, self.folder, self.progress = plan, folder, progress
        self.records: list[Record] = []

    def record(self, contestant: Contestant, **values: object) -> None:
        """Add a record. Keys that do not apply are None."""
        record: Record = dict.fromkeys(KEYS)
        record.update(peer=contestant.name, version=contestant.version, **values)
        self.records.append(record)

    def joints(self, joints: int, own: Contestant, reference: Contestant, peers: Sequence[Contestant]) -> None:
        """Measure all sizes of arms with this number of joints."""
        reference.load(hand_over(peer_cases.build("nominal", REFERENCE, joints), self.folder / f"reference_{joints}"))
        for arms in self.plan.arms:
            self.progress.label = f"{arms} arms of {joints} joints"
            self.progress.show()
            needed = _BYTES * float(arms * joints) ** 3
            if needed > 0.8 * free_memory():
                note = f"needs about {needed / 2**30:.0f} GiB of memory"
                self.record(own, arms=arms, joints=joints, note=note)
                self.progress.advance()
                continue
            file = hand_over(peer_cases.build("nominal", arms, joints), self.folder / f"ring_{arms}_{joints}")
            along = [own]
            if joints == 6 and arms in self.plan.peers and arms <= PEER_ARMS:
                along += peers
            for contestant in along:
                self._one(contestant, file, arms, joints, reference)
            self.progress.advance()

    def _one(self, contestant: Contestant, file: Path, arms: int, joints: int, reference: Contestant) -> None:
        """Measure every mode of one contestant on one size."""
        own = contestant.name == "coopqp"
        size = {"arms": arms, "joints": joints}
        try:
            contestant.load(file)
        except NotAvailable as error:
            self.record(contestant, **size, note=str(error))
            return
        for mode in contestant.modes if own else (PEER_MODES[contestant.name],):
            against = mode if own else reference.modes[0]
            for pacing, period in PACES.items():
                rounds = max(2, self.plan.rounds // 2) if period else self.plan.rounds
                try:
                    times, others = self._rounds(contestant, mode, reference, against, rounds, period)
                except NotAvailable as error:
                    self.record(contestant, **size, mode=mode, pacing=pacing, note=str(error))
                    continue
                self.record(
                    contestant,
                    **size,
                    mode=mode,
                    pacing=pacing,
                    **common.percentiles([x for row in times for x in row]),
                    ratio_4=ratio(times, others),
                    steps=sum(len(row) for row in times),
                )
            with contextlib.suppress(NotAvailable):
                contestant.ask(do="forget", timeout=60.0)

    def _rounds(
        self, contestant: Contestant, mode: str, reference: Contestant, against: str, rounds: int, period: float
    ) -> tuple[list[list[float]], list[list[float]]]:
        """Times [µs] of alternating rounds of a contestant and of the reference."""
        plan = self.plan
        times: tuple[list[list[float]], list[list[float]]] = ([], [])
        for _ in range(rounds):
            for rows, who, how in zip(times, (contestant, reference), (mode, against), strict=True):
                answer = who.ask(
                    do="time", mode=how, steps=plan.steps, period=period, budget=plan.round_s, timeout=300.0
                )
                if answer["failures"]:
                    raise NotAvailable(f"{answer['failures']} of {len(answer['us'])} steps failed: {answer['note']}")
                rows.append(answer["us"])
        return times


def scale(peers: Sequence[str], plan: Plan, cache: Path) -> list[Record]:
    """Run everything. Peers that are not installed get a record with a note."""
    progress = common.Progress(2 * len(plan.arms))
    with tempfile.TemporaryDirectory(prefix="scaling_") as temporary, contextlib.ExitStack() as stack:
        scaling = Scaling(plan, Path(temporary), progress)
        started: list[Contestant] = []
        for name in ("coopqp", "coopqp", *peers):
            try:
                started.append(Contestant.start(name, cache, install=False))
                stack.callback(started[-1].stop)
            except NotAvailable as error:
                missing = {**dict.fromkeys(KEYS), "peer": name, "version": pinned(name)}
                scaling.records.append({**missing, "note": f"{error}; compare_peers.py installs it"})
        own, reference, *others = started
        for joints in (6, 7):
            scaling.joints(joints, own, reference, others)
    progress.close()
    return scaling.records


def plot(records: Sequence[Record]) -> dict[str, bytes]:
    """Plot the hot medians over the number of arms."""
    curves: dict[str, list[tuple[float, float]]] = {}
    for r in records:
        if r["pacing"] == "hot" and r["p50_us"]:
            curves.setdefault(f"{r['peer']} ({r['mode']}), {r['joints']} joints", []).append((r["arms"], r["p50_us"]))
    return common.log_log_plot("scaling.png", curves, x="arms", y="one step, hot, nominal: median [µs]")


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = common.arguments(__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--peers", nargs="*", choices=tuple(PINS), default=("pink", "placo"), help="which go along")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the peers' environments")
    args = parser.parse_args(argv)
    plan = QUICK if args.quick else FULL
    settings = {"times": "CPU time of the process", "dt": "1 ms", "rounds": plan.rounds, "steps a round": plan.steps}
    description = common.describe("scaling", settings)
    print(common.header(description), flush=True)
    records = scale(args.peers, plan, args.cache)
    text = f"## One step against the number of arms (ratio_4: to coopqp on {REFERENCE} arms)\n\n"
    text += common.markdown_table(records, KEYS) + "\n"
    print("\n" + text)
    files = {"scaling.md": text.encode(), **plot(records)} if args.out is not None else None
    for file in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {file}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
