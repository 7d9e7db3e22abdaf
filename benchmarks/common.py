"""Shared parts of the benchmark scripts. Import it before NumPy: it limits BLAS to one thread."""

from __future__ import annotations

import argparse
import gc
import importlib.metadata
import io
import json
import os
import platform
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

#: One thread for every BLAS, here and in child processes.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
os.environ.update(ONE_THREAD)

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402

from coopqp import Grasp, RobotCell, WaypointPath  # noqa: E402
from coopqp.output import write_files  # noqa: E402
from coopqp.paths import TimeLaw  # noqa: E402
from coopqp.scenarios import Scenario, ring as coopqp_ring  # noqa: E402
from coopqp.spatial import Array  # noqa: E402

#: One flat record of results. Each script defines its keys.
Record = dict[str, Any]


# -- the run -----------------------------------------------------------------------------------------------------------


def arguments(description: str) -> argparse.ArgumentParser:
    """A parser with the common options of all benchmarks."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a small run (under 45 s on 2 cores)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the records as a JSON list")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write tables, plots and machine.json into a folder")
    return parser


class Progress:
    """A progress bar on stderr; silent if stderr is not a terminal."""

    WIDTH = 30

    def __init__(self, total: int, *, label: str = "", stream: TextIO | None = None) -> None:
        self.total, self.done, self.label = max(total, 1), 0, label
        self._stream = sys.stderr if stream is None else stream
        self._shown = self._stream.isatty()

    def advance(self, label: str | None = None) -> None:
        """Count one unit of work; ``label`` names the next one."""
        self.done = min(self.done + 1, self.total)
        self.label = self.label if label is None else label
        self.show()

    def show(self) -> None:
        """Draw the bar."""
        if self._shown:
            full = self.WIDTH * self.done // self.total
            bar = "#" * full + "." * (self.WIDTH - full)
            self._stream.write(f"\r[{bar}] {self.done}/{self.total} {self.label[:40]:40}")
            self._stream.flush()

    def close(self) -> None:
        """Erase the bar."""
        if self._shown:
            self._stream.write("\r" + " " * (self.WIDTH + 60) + "\r")
            self._stream.flush()


def interleaved(
    contestants: Mapping[str, Callable[[], Iterable[float]]],
    *,
    rounds: int,
    progress: Progress | None = None,
    frozen: bool = False,
) -> dict[str, Array]:
    """Samples of every contestant, one round of each in turn. A slow phase of the machine then affects all of them.

    Args:
        contestants: name → function that runs one round and returns its samples.
        rounds: number of rounds; every other round has the reverse order.
        progress: progress bar, advanced once per contestant and round.
        frozen: call ``gc.freeze`` first, as in a real-time loop; the garbage collector stays on.
    """
    samples: dict[str, list[float]] = {name: [] for name in contestants}
    if frozen:
        gc.collect()
        gc.freeze()
    try:
        for number in range(rounds):
            names = list(contestants)
            for name in reversed(names) if number % 2 else names:
                if progress is not None:
                    progress.label = name
                    progress.show()
                samples[name].extend(contestants[name]())
                if progress is not None:
                    progress.advance()
    finally:
        if frozen:
            gc.unfreeze()
    return {name: np.array(values) for name, values in samples.items()}


def percentiles(samples_us: Any, *, shares: Sequence[float] = (50.0, 99.0)) -> dict[str, float | None]:
    """``{"p50_us": …, "p99_us": …}`` of samples [µs], rounded to 1 ns (None if empty); ``99.9`` gives ``p999_us``."""
    values = np.asarray(samples_us, dtype=float)
    names = [f"p{share:g}_us".replace(".", "") for share in shares]
    if values.size == 0:
        return dict.fromkeys(names)
    return dict(zip(names, (round(float(x), 3) for x in np.percentile(values, shares)), strict=True))


# -- machine and versions ----------------------------------------------------------------------------------------------


def machine() -> dict[str, str]:
    """Processor, cores, system and Python."""
    model = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = lines[0].partition(":")[2].strip() if lines else model
    return {
        "processor": model or platform.machine(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
    }


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Versions of the installed packages among ``packages``."""
    found = {}
    for package in packages:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def describe(title: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The context of a result: machine, versions, settings."""
    packages = ("coopqp", "pin", "numpy", "daqp", "proxsuite", "osqp", "quadprog", "qpsolvers", "scipy")
    return {
        "benchmark": title,
        "machine": machine(),
        "versions": versions(packages),
        "settings": {"BLAS threads": "1", **{key: str(value) for key, value in settings.items()}},
    }


def header(description: Mapping[str, Any]) -> str:
    """``describe`` as a few lines of text."""
    parts = {
        key: ", ".join(f"{name} {value}" for name, value in description[key].items())
        for key in ("machine", "versions", "settings")
    }
    return "\n".join([str(description["benchmark"]), *(f"  {key}: {text}" for key, text in parts.items())])


# -- results -----------------------------------------------------------------------------------------------------------


def cell_text(value: Any) -> str:
    """Text of a value in a table."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return str(value)


def markdown_table(records: Sequence[Record], columns: Sequence[str]) -> str:
    """Records as a Markdown table of the given keys."""
    rows = [[cell_text(record.get(column)).replace("|", "\\|") for column in columns] for record in records]
    return "\n".join("| " + " | ".join(row) + " |" for row in [list(columns), ["---"] * len(columns), *rows])


def log_log_plot(
    name: str,
    curves: Mapping[str, Sequence[tuple[float, float]]],
    *,
    x: str,
    y: str,
    ticks: Sequence[float] | None = None,
    dashed: Mapping[str, str] | None = None,
) -> dict[str, bytes]:
    """``{name: PNG}`` of the curves on logarithmic axes; empty without Matplotlib.

    Args:
        name: name of the file.
        curves: label → points.
        x, y: titles of the axes.
        ticks: ticks of the x axis; None for a tick at every point.
        dashed: label of a dashed curve → label of the curve with the same colour; the dashed curve has no legend
            entry. Curves of soft tasks are always dashed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    colours: dict[str, Any] = {}
    for label, points in curves.items():
        partner = (dashed or {}).get(label)
        (line,) = axes.loglog(*zip(*points, strict=True), "o--" if partner or "soft" in label else "o-", ms=4)
        if partner:
            line.set_color(colours[partner])
        else:
            line.set_label(label)
        colours[label] = line.get_color()
    if ticks is None:
        ticks = sorted({point[0] for points in curves.values() for point in points})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
    axes.minorticks_off()
    axes.set(xlabel=x, ylabel=y)
    axes.grid(True, alpha=0.3)
    axes.legend(fontsize="small", bbox_to_anchor=(1.02, 1.0), loc="upper left")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    return {name: stream.getvalue()}


def save(
    records: Sequence[Record],
    description: Mapping[str, Any],
    *,
    json_file: Path | None = None,
    out: Path | None = None,
    files: Mapping[str, bytes] | None = None,
) -> list[Path]:
    """Write the records to ``json_file``, and the machine and ``files`` (name → content) into ``out``."""
    contents: dict[Path, bytes] = {}
    if json_file is not None:
        contents[json_file] = (json.dumps(list(records), indent=1) + "\n").encode()
    if out is not None:
        contents[out / "machine.json"] = (json.dumps(description, indent=1) + "\n").encode()
        for name, content in (files or {}).items():
            contents[out / name] = content
    return write_files(contents)


# -- scenarios ---------------------------------------------------------------------------------------------------------


def ring(*, arms: int, joints: int = 6, path: str = "nominal", dt: float = 1e-3) -> Scenario:
    """Arms with 6 or 7 joints around a ring (:func:`coopqp.scenarios.ring`), or only the first of them.

    Args:
        arms: number of arms, 1 to 64.
        joints: number of joints of each arm: 6 (RX-90L) or 7 (arm7).
        path: ``"nominal"``: 2 s within all limits; ``"zigzag"``: 0.6 m/s around corners, joints limited to 1 rad/s.
        dt: length of a step [s].
    """
    full = coopqp_ring(arms=max(arms, 2), robot="rx90l" if joints == 6 else "arm7", duration=2.0)
    cell, grasp, q_start, motion = full.cell, full.grasp, full.q_start, full.path
    if arms == 1:
        cell, grasp, q_start = RobotCell(cell.arms[:1]), Grasp(grasp.T_object_tool[:1]), q_start[cell.q_slices[0]]
    if path == "zigzag":
        cell = cell.with_limits(velocity=1.0)
        start, shifts = motion.pose(0.0), np.array(_ZIGZAG_M)
        poses = [pin.SE3(start.rotation, start.translation + shift) for shift in shifts]
        lengths = np.linalg.norm(np.diff(shifts, axis=0), axis=1)
        motion = WaypointPath(poses, durations=lengths / _ZIGZAG_SPEED, time_law=TimeLaw.LINEAR)
    return Scenario(f"ring_{arms}x{joints}_{path}", cell, grasp, motion, q_start, dt)


#: Corners of the zigzag relative to the start [m], and the speed along it [m/s].
_ZIGZAG_M = (
    (0.0, 0.0, 0.0),
    (0.06, 0.0, 0.06),
    (0.0, 0.06, 0.0),
    (-0.06, 0.0, 0.06),
    (0.0, -0.06, 0.0),
    (0.0, 0.0, 0.0),
)
_ZIGZAG_SPEED = 0.6
