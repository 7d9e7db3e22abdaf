"""What a sweep costs beyond its runs: loky, Dask, two workers over one, the figures of a run.

Costs are slopes of processor time between two numbers of rows: the start of workers does not count, and a busy machine
changes them little. The gain of a second worker is wall time: it needs a quiet machine. See benchmarks/README.md.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
from common import Record
from figures_0_1 import figures_0_1

from coopqp import QPController, simulate
from coopqp.scenarios import paper_lift
from coopqp.simulation import read_run
from coopqp.studies import Cluster, Engine, Local, run_rows

KEYS = ("case", "rows", "task_ms", "cost_ms", "ratio", "target")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Fewest and most rows of 1 ms (loky), of 10 ms (Dask), of 20 ms (two workers over one), and rounds."""

    loky: tuple[int, int] = (500, 4500)
    dask: tuple[int, int] = (400, 2000)
    scaling: tuple[int, int] = (40, 240)
    rounds: int = 3


FULL = Plan()
QUICK = Plan(loky=(250, 1250), dask=(400, 1200), scaling=(20, 80), rounds=1)


def spinning(milliseconds: float) -> Callable[[int], dict[str, Any]]:
    """A task that takes a given processor time on any machine, and returns a row of figures."""

    def spin(row: int) -> dict[str, Any]:
        import time

        end = time.thread_time() + 1e-3 * milliseconds
        while time.thread_time() < end:
            pass
        return {"outcome": "ok", **{f"figure_{i}": 0.1 * i + row for i in range(20)}}

    return spin


def into(file: Path) -> Callable[[Any], None]:
    """Takes rows as a sweep does: into a journal on the disk."""

    def take(done: Any) -> None:
        with file.open("a") as stream:
            stream.writelines(f"{json.dumps({'row': one.row, 'columns': one.columns})}\n" for one in done)
            stream.flush()
            os.fsync(stream.fileno())

    return take


def processor_time(pids: Sequence[int]) -> float:
    """Processor time of this process, its ended children, and other processes with theirs [s]."""
    mine = os.times()
    total = mine.user + mine.system + mine.children_user + mine.children_system
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        total += sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return total


def cost(
    engine: Engine,
    task_ms: float,
    sizes: tuple[int, int],
    file: Path,
    pids: Callable[[], list[int]],
    chunk: int | None = None,
) -> float:
    """Processor time of a row [ms]."""
    spent = []
    for rows in sizes:
        before = processor_time(pids())
        run_rows(spinning(task_ms), range(rows), engine, take=into(file), chunk=chunk)
        spent.append(processor_time(pids()) - before)
    return 1e3 * (spent[1] - spent[0]) / (sizes[1] - sizes[0])


def local(plan: Plan, file: Path, progress: common.Progress) -> Record:
    progress.label = "loky, rows of 1 ms"
    costs = []
    for _ in range(plan.rounds):
        costs.append(cost(Local(2), 1.0, plan.loky, file, list))
        progress.advance()
    return record("loky, 2 workers", plan.loky[1], 1.0, min(costs), min(costs), "≤ 1.10")


def clustered(plan: Plan, file: Path, progress: common.Progress) -> list[Record]:
    """Nothing without Dask."""
    if find_spec("distributed") is None:
        return []
    progress.label = "Dask, rows of 10 ms"
    with dask() as (address, pids):
        engine = Cluster(address)
        costs = []
        for _ in range(plan.rounds):
            costs.append(cost(engine, 10.0, plan.dask, file, pids, chunk=200))
            progress.advance()
    ratio = min(costs) / 10.0
    return [record("Dask, 2 workers, chunks of 2 s", plan.dask[1], 10.0, min(costs), ratio, "≤ 1.20")]


@contextlib.contextmanager
def dask() -> Iterator[tuple[str, Callable[[], list[int]]]]:
    """A scheduler and two workers of this machine; their address, and the numbers of their processes."""
    program = Path(sys.executable).with_name("dask")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        words = [
            ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)],
            *[["worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-nanny", "--no-dashboard"]] * 2,
        ]
        quiet: dict[str, Any] = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        started = []
        for line in words:
            started.append(subprocess.Popen([program, *line], **quiet))
            while not (file.exists() and file.stat().st_size):
                time.sleep(0.1)
        try:
            address = json.loads(file.read_text())["address"]
            while workers_at(address) < 2:
                time.sleep(0.2)
            yield address, lambda: [process.pid for process in started]
        finally:
            for process in reversed(started):
                process.terminate()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(timeout=10)
                process.kill()  # one that has ended takes no notice
                process.wait()


def workers_at(address: str) -> int:
    from coopqp.studies import EngineError

    try:
        return Cluster(address).workers
    except EngineError:
        return 0


def scaling(plan: Plan, file: Path, progress: common.Progress) -> Record:
    """Wall time of rows of 20 ms with one worker over that with two, per worker; interleaved."""
    progress.label = "two workers over one"
    gains, fewest, most = [], *plan.scaling
    for _ in range(plan.rounds):
        walls = {}
        for workers in (1, 2):
            times = []
            for rows in (fewest, most):
                began = time.perf_counter()
                run_rows(spinning(20.0), range(rows), Local(workers), take=into(file), chunk=5)
                times.append(time.perf_counter() - began)
            walls[workers] = times[1] - times[0]
        gains.append(walls[1] / walls[2] / 2.0)
        progress.advance()
    return record("2 workers over 1, wall", most, 20.0, None, float(np.median(gains)), "≥ 0.90 on a quiet machine")


def figures(plan: Plan, progress: common.Progress) -> Record:
    """read_run of a run of 400 steps and three arms, over what version 0.1 did for the same figures; they take turns.

    Raises:
        AssertionError: the figures differ by more than rounding.
    """
    progress.label = "figures of a run"
    lift = paper_lift()
    run = simulate(QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt), q_start=lift.q_start)
    found, expected = read_run(lift.cell, run), figures_0_1(lift.cell, run)
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=0.0, atol=1e-10, err_msg=name)
    spent, reference = [], []
    for _ in range(plan.rounds + 1):
        reference.append(processor_ms(lambda: figures_0_1(lift.cell, run)))
        spent.append(min(processor_ms(lambda: read_run(lift.cell, run)) for _ in range(10)))
        progress.advance()
    ratio = min(spent) / min(reference)
    return record("figures of 400 steps, over version 0.1", 1, None, min(spent), ratio, "≤ 40 ms and ≤ 0.05")


def processor_ms(compute: Callable[[], object]) -> float:
    """Processor time of this thread [ms]."""
    began = time.thread_time()
    compute()
    return 1e3 * (time.thread_time() - began)


def record(case: str, rows: int, task_ms: float | None, cost_ms: float | None, ratio: float, target: str) -> Record:
    """A record."""
    return dict(zip(KEYS, (case, rows, task_ms, cost_ms, ratio, target), strict=True))


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    args = common.arguments(__doc__.partition("\n")[0] if __doc__ else "").parse_args(argv)
    plan = QUICK if args.quick else FULL
    description = common.describe("sweeps", {"rounds": plan.rounds, "load": os.getloadavg()[0]})
    print(common.header(description), flush=True)
    progress = common.Progress(4 * plan.rounds + 1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "journal"
        records = [figures(plan, progress), local(plan, file, progress), *clustered(plan, file, progress)]
        records.append(scaling(plan, file, progress))
    progress.close()
    text = "## Sweeps\n\n" + common.markdown_table(records, KEYS) + "\n"
    print("\n" + text)
    files = {"sweeps.md": text.encode()} if args.out is not None else None
    for written in common.save(records, description, json_file=args.json, out=args.out, files=files):
        print(f"wrote {written}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
