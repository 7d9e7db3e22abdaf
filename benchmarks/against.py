"""coopqp beside coopqp of another commit: the cases of cost of compare_peers.py, both in one run.

A copy of that commit is built beside, with this Python and its packages. Each of the two runs in a process of its own,
with its own benchmarks/peers/run_coopqp.py; they take turns in short rounds, hot and at 1 kHz; several pairs of
processes do so, one after the other. Records have the keys

``case``, ``arms``, ``pacing``, ``commit``   the row;
``p50_us``, ``p50_us_there``                 median of all steps here, and there;
``p99_us``, ``p99_us_there``   their 99th percentiles;
``ratio``          here / there: the median over the rounds of the ratio of their medians;
``p99_ratio``      the same of their 99th percentiles;
``more_us``        here − there: the median over the rounds of the difference of their medians;
``good``           ratio ≤ :data:`MOST_RATIO` or more_us ≤ :data:`MOST_US`, and, paced, p99_ratio ≤ :data:`MOST_P99`;
``failures``, ``note``   steps that failed here or there, and the first one's reason.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import common  # first: it limits BLAS to one thread
import numpy as np
import peer_cases
from common import Record
from contestants import HERE, PACES, Contestant, NotAvailable, hand_over, ratio

#: A row is good if it takes at most this much of the other commit's time, or at most this much longer [µs], and a paced
#: one also if its 99th percentile takes at most this much. The median of all rows is good at 1.
MOST_RATIO, MOST_US, MOST_P99 = 1.03, 0.1, 1.05
#: Pairs of processes: two of one commit differ, by where their memory lies, as long as they run.
PAIRS = 5
KEYS = (
    "case", "arms", "pacing", "commit", "p50_us", "p50_us_there", "p99_us", "p99_us_there", "ratio", "p99_ratio",
    "more_us", "good", "failures", "note",
)  # fmt: skip
#: On PYTHONPATH, lets a copy of the package be imported in place of an editable installation.
_ELSEWHERE = HERE.parent / "tests" / "elsewhere"

#: One round of a contestant: its times [µs], failed steps, the first one's reason.
Round = tuple[list[float], int, str]


def _said(command: Sequence[str], why: str, **options: object) -> bytes:
    """What a program prints.

    Raises:
        NotAvailable: it fails.
    """
    try:
        done = subprocess.run(list(command), capture_output=True, check=False, timeout=900, **options)  # type: ignore[call-overload]
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotAvailable(f"{why}: {type(error).__name__}") from error
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        raise NotAvailable(f"{why}: {(lines or ['no reason given'])[-1][:160]}")
    found: bytes = done.stdout
    return found


def checkout(commit: str, cache: Path, repository: Path = HERE.parent) -> Path:
    """Folder of a copy of ``commit`` with its core built; made once a commit.

    Raises:
        NotAvailable: there is no such commit, or its core cannot be built.
    """
    git = ["git", "-C", str(repository)]
    name = _said([*git, "rev-parse", "--verify", f"{commit}^{{commit}}"], "there is no such commit").decode().strip()
    folder = cache / f"coopqp-{name[:12]}"
    if (folder / "built").is_file():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with tarfile.open(fileobj=io.BytesIO(_said([*git, "archive", name], "it cannot be copied"))) as archive:
        if hasattr(tarfile, "data_filter"):
            archive.extractall(folder, filter="data")
        else:  # Python 3.10 and 3.11 before their last security releases
            archive.extractall(folder)
    cmake = shutil.which("cmake", path=os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", ""))))
    build, why = str(folder / "build"), "its core cannot be built"
    for arguments in (
        ("-S", str(folder), "-B", build, f"-DPython_EXECUTABLE={sys.executable}"),
        ("--build", build, "--parallel", "2"),
        ("--install", build, "--prefix", str(folder)),
    ):
        _said([cmake or "cmake", *arguments], why)
    (folder / "built").touch()
    return folder


def start(folder: Path) -> Contestant:
    """coopqp of a copy in its process.

    Raises:
        NotAvailable: it cannot run.
    """
    path = os.pathsep.join((str(_ELSEWHERE), str(folder)))
    script = folder / "benchmarks" / "peers" / "run_coopqp.py"
    return Contestant("coopqp", Path(sys.executable), script=script, environment={"PYTHONPATH": path})


def rounds_of(
    here: Callable[[], Round], there: Callable[[], Round], number: int, *, begin: int = 0
) -> tuple[list[Round], list[Round]]:
    """Rounds of both by turns, the order reversed in every other one; ``begin`` is the number of the first."""
    found: tuple[list[Round], list[Round]] = ([], [])
    for i in range(begin, begin + number):
        for k in (0, 1) if i % 2 == 0 else (1, 0):
            found[k].append((here, there)[k]())
    return found


def judged(here: Sequence[Round], there: Sequence[Round], *, paced: bool = False) -> Record:
    """The figures of a row."""
    own, other = ([times for times, _, _ in rounds] for rounds in (here, there))
    more = [float(np.median(a) - np.median(b)) for a, b in zip(own, other, strict=True) if a and b]
    share, tail, longer = ratio(own, other), ratio(own, other, share=99.0), float(np.median(more)) if more else None
    good = share is not None and longer is not None and (share <= MOST_RATIO or longer <= MOST_US)
    mine, theirs = (common.percentiles([x for times in rounds for x in times]) for rounds in (own, other))
    return {
        **mine,
        **{f"{key}_there": value for key, value in theirs.items()},
        "ratio": share,
        "p99_ratio": tail,
        "more_us": longer,
        "good": good and (not paced or (tail is not None and tail <= MOST_P99)),
        "failures": sum(failed for _, failed, _ in (*here, *there)),
        "note": next((note for _, _, note in (*here, *there) if note), ""),
    }


def compare(
    commit: str, cache: Path, *, cases: Sequence[str], arms: Sequence[int], rounds: int, steps: int, round_s: float
) -> list[Record]:
    """All rows: ``rounds`` of each of :data:`PAIRS` pairs, of ``steps`` steps each, that end after ``round_s`` seconds.

    Raises:
        NotAvailable: the other commit cannot run.
    """
    folder = checkout(commit, cache)
    rows = [(case, count, pacing) for count in arms for case in cases for pacing in PACES]
    found: dict[tuple[str, int, str], tuple[list[Round], list[Round]]] = {row: ([], []) for row in rows}
    progress = common.Progress(PAIRS * len(rows))
    with tempfile.TemporaryDirectory(prefix="against_") as temporary:
        for number in range(PAIRS):
            with contextlib.ExitStack() as stack:
                pair = [Contestant.start("coopqp", cache, install=False)]
                stack.callback(pair[0].stop)
                pair.append(start(folder))
                stack.callback(pair[1].stop)
                for case, count, pacing in rows:
                    progress.advance(f"{case}, {count} arms, {pacing}")
                    file = Path(temporary) / f"{case}_{count}" / "task.json"
                    if not file.exists():
                        hand_over(peer_cases.build(case, count), file.parent)
                    here, there = (_rounds(one, file, steps, PACES[pacing], round_s) for one in pair)
                    for all_rounds, more in zip(
                        found[case, count, pacing], rounds_of(here, there, rounds, begin=number), strict=True
                    ):
                        all_rounds += more
    progress.close()
    name = folder.name.partition("-")[2]
    return [
        {
            **{"case": case, "arms": count, "pacing": pacing, "commit": name},
            **judged(*found[case, count, pacing], paced=PACES[pacing] > 0.0),
        }
        for case, count, pacing in rows
    ]


def _rounds(contestant: Contestant, file: Path, steps: int, period: float, round_s: float) -> Callable[[], Round]:
    """Rounds of a task that a contestant loads here."""
    contestant.load(file)
    return lambda: _round(contestant, contestant.modes[0], steps, period, round_s)


def _round(contestant: Contestant, mode: str, steps: int, period: float, round_s: float) -> Round:
    answer = contestant.ask(do="time", mode=mode, steps=steps, period=period, budget=round_s, timeout=120.0)
    return answer["us"], answer["failures"], answer["note"]


def report(records: Sequence[Record]) -> str:
    """The rows as Markdown, how many are good, and the median of all."""
    good = sum(bool(r["good"]) for r in records)
    commit = records[0]["commit"] if records else "no commit"
    bound = f"≤ {MOST_RATIO:g} × or ≤ {MOST_US:g} µs more, paced p99 ≤ {MOST_P99:g} ×: {good} of {len(records)} rows"
    ratios = [r["ratio"] for r in records if r["ratio"] is not None]
    tails = [r["p99_ratio"] for r in records if PACES[r["pacing"]] > 0.0 and r["p99_ratio"] is not None]
    medians = "\n".join(
        f"- median of {what}: {np.median(values):.3f}, largest {max(values):.3f}"
        for what, values in (("all rows", ratios), ("the p99 of the paced rows", tails))
        if values
    )
    return f"## Here ÷ {commit}\n\n{bound}\n\n{medians}\n\n{common.markdown_table(records, KEYS)}\n"
