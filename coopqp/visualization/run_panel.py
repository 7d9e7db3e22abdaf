"""What stands beside the scene of a run: curves over time, the statuses, one sentence, and the joints at a moment.

Numbers and words only; :mod:`coopqp.visualization.panel_page` makes a page of them, the same one live and recorded.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.control.interface import Status
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation.metrics import Readings
from coopqp.simulation.evaluation.wrenches import RunLoads, read_loads
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import SceneError, reading
from coopqp.spatial import Array
from coopqp.visualization.binding_words import Why
from coopqp.visualization.style import drawn

#: Spans of time of a drawn curve: two points each, about as many as the panel has pixels.
SPANS = 150
#: Values beyond this are drawn there.
_FAR = 1e9
#: Height of a plot, as a multiple of its largest value.
_HEADROOM = 1.35
#: Lengths below this are written in micrometres [mm]; below the second they are rounding.
_MICRO, _ROUNDING = 0.01, 1e-6


@dataclass(frozen=True, eq=False)
class Curve:
    """A quantity over the time of a run, as it is drawn.

    Attributes:
        title: its name.
        time: (K,) [s].
        values: (K, n) in :attr:`unit`, one column per line.
        names: of the lines; empty for a single one.
        unit: unit of the drawn values.
        bound: height of a dashed line, in the same unit; None for none.
        bound_name: what the dashed line is.
        least_top: the plot is at least as high, so that rounding errors look as small as they are.
        text: the value at a time [s], in words with its unit.
    """

    title: str
    time: Array
    values: Array
    unit: str
    text: Callable[[float], str]
    names: tuple[str, ...] = ()
    bound: float | None = None
    bound_name: str = ""
    least_top: float = 1e-9

    @property
    def largest(self) -> float:
        """The largest drawn value."""
        return float(np.nanmax(self.values, initial=0.0))

    @property
    def largest_text(self) -> str:
        """The largest drawn value with its unit."""
        rounding = self.unit == "µm" and self.largest < 1e3 * _ROUNDING
        return "below 0.001 µm" if rounding else f"{self.largest:.3g} {self.unit}"

    @property
    def top(self) -> float:
        """Upper end of the plot: above the largest value, with space for words."""
        near = self.bound if self.bound is not None and self.bound < 4.0 * self.largest else 0.0
        return _HEADROOM * max(self.largest, near, self.least_top)

    @property
    def bottom(self) -> float:
        """Lower end of the plot: zero, or below the least value where that is negative."""
        return min(0.0, 1.08 * float(np.nanmin(self.values, initial=0.0)))


@dataclass(frozen=True)
class Joint:
    """A joint of the panel.

    Attributes:
        name: without the name of its arm.
        limited: whether it has position limits.
    """

    name: str
    limited: bool


@dataclass(frozen=True)
class Moment:
    """A run at a sample.

    Attributes:
        time: [s].
        clock: time and share of the path, in words.
        status: status of the step that starts there.
        why: one sentence: what the object does, and what binds.
        values: value of each curve, in words.
        joints: place of each joint in its range, −1 at the lower and 1 at the upper limit; NaN without limits.
        bound: numbers of the joints with a limit that binds.
    """

    time: float
    clock: str
    status: Status
    why: str
    values: tuple[str, ...]
    joints: tuple[float, ...]
    bound: tuple[int, ...]


class RunPanel:
    """The panel of a run.

    Args:
        cell, recording, readings: the run and its errors.

    Attributes:
        end: time at its end [s].
        curves: what is drawn over time: path speed, chain error, and where the run has them distances and forces.
        statuses: each span of one status: the status, start and end [s].
        arms: names of the arms with their joints; and robots of several arms with those that these share.

    Raises:
        SceneError, RecordingError: the recording is damaged.
    """

    def __init__(self, cell: RobotCell, recording: Recording, readings: Readings) -> None:
        self._cell, self._run = cell, recording
        self._why = Why(recording)
        self.end = max(float(recording.time[-1]), 1e-9)
        self.curves = _curves(cell, recording, readings)
        self.statuses = _statuses(recording)
        self.arms = _owners(cell)

    def moment(self, sample: int) -> Moment:
        """The run at a sample (0 to T)."""
        run, limits = self._run, self._cell.limits
        q = np.nan_to_num(self._cell.positions(run.q_command[sample]), posinf=_FAR, neginf=-_FAR)
        with np.errstate(invalid="ignore", over="ignore"):
            place = (2.0 * q - limits.upper - limits.lower) / (limits.upper - limits.lower)
        bound = {f"{limit.arm}/{limit.joint}" for limit in self._why.limits(sample) if limit.joint}
        time = float(run.time[sample])
        planned = run.metadata.get("duration", run.clock[-1])
        end = float(planned) if isinstance(planned, (int, float)) else np.inf
        share = 100.0 * float(run.clock[sample]) / end if 0.0 < end < np.inf else np.nan
        return Moment(
            time=time,
            clock=f"t = {time:.2f} s" + (f" · {share:.0f} % of the path" if abs(share) < _FAR else ""),
            status=self._why.status(sample),
            why=self._why(sample),
            values=tuple(curve.text(time) for curve in self.curves),
            joints=tuple(np.clip(place, -1.1, 1.1).tolist()),
            bound=tuple(j for j, name in enumerate(self._cell.joint_names) if name in bound),
        )


def _owners(cell: RobotCell) -> tuple[tuple[str, tuple[Joint, ...]], ...]:
    """The joints of each arm, and of each robot those that move several of its arms, in the order of the cell."""
    limited = (np.isfinite(cell.limits.lower) & np.isfinite(cell.limits.upper)).tolist()
    owned = [(*name.split("/", 1), has) for name, has in zip(cell.joint_names, limited, strict=True)]
    groups = itertools.groupby(owned, key=lambda joint: joint[0])
    return tuple(
        (str(owner), tuple(Joint(str(name), bool(has)) for _, name, has in joints)) for owner, joints in groups
    )


def _statuses(recording: Recording) -> tuple[tuple[Status, float, float], ...]:
    codes, order = recording.status.astype(int), list(Status)
    starts = np.flatnonzero(np.diff(codes, prepend=-1)).tolist()
    ends = [*starts[1:], recording.n_steps]
    time = recording.time
    return tuple((order[codes[i]], float(time[i]), float(time[j])) for i, j in zip(starts, ends, strict=True) if j > i)


def _curves(cell: RobotCell, recording: Recording, readings: Readings) -> tuple[Curve, ...]:
    found = [_speed(recording), _chain(recording, readings)] if recording.n_steps else []
    nearest = _nearest(recording.metadata)
    loads = read_loads(cell, recording)
    return tuple(curve for curve in (*found, nearest, _forces(cell, loads)) if curve is not None)


def _speed(recording: Recording) -> Curve:
    rate = 100.0 * np.nan_to_num(recording.rate, posinf=_FAR, neginf=-_FAR)

    def text(time: float) -> str:
        return f"{round(float(rate[min(recording.sample_at(time), len(rate) - 1)]), 1) + 0.0:g} %"

    time, values = drawn(recording.time, np.append(rate, rate[-1]), spans=SPANS)
    return Curve("path speed σ", time, values[:, None], "%", text)


def _chain(recording: Recording, readings: Readings) -> Curve:
    error = np.nan_to_num(readings.chain_mm, nan=_FAR, posinf=_FAR)
    small = float(error.max(initial=0.0)) < _MICRO
    time, values = drawn(recording.time, (1e3 if small else 1.0) * error, spans=SPANS)

    def text(time: float) -> str:
        return length_text(float(error[recording.sample_at(time)]))

    return Curve("chain error", time, values[:, None], "µm" if small else "mm", text, least_top=1.0 if small else 1e-9)


def nearest_pairs(metadata: Mapping[str, Any]) -> tuple[Array, Array, tuple[str, ...]] | None:
    """The nearest pair over a recorded run: times (T,) [s], distances (T,) [m], names; None if it was not measured.

    Raises:
        SceneError: the entry ``clearance`` of the metadata is damaged.
    """
    entry = metadata.get("clearance")
    if not isinstance(entry, Mapping) or "distances_m" not in entry:
        return None
    with reading("nearest pairs are"):
        times, distances = (np.array(entry[key], dtype=float) for key in ("times_s", "distances_m"))
        names = tuple(f"{first} – {second}".replace("_", " ") for first, second in entry.get("pairs", ()))
    if times.ndim != 1 or times.shape != distances.shape or not len(times) or len(names) not in (0, len(times)):
        raise SceneError("the recording's nearest pairs are damaged.")
    return times, np.nan_to_num(distances), names


def _nearest(metadata: Mapping[str, Any]) -> Curve | None:
    found = nearest_pairs(metadata)
    if found is None:
        return None
    times, distances, names = found
    entry = metadata["clearance"]
    with reading("clearance is"):
        margin = 1e3 * float(entry["margin_m"]) if entry.get("avoided") else None

    def text(time: float) -> str:
        i = int(np.abs(times - time).argmin())
        return f"{1e3 * distances[i]:.4g} mm" + (f", {names[i]}" if names else "")

    time, values = drawn(times, 1e3 * distances, spans=SPANS)
    bound = margin if margin is not None and 0.0 < margin < _FAR else None
    return Curve("nearest pair", time, values[:, None], "mm", text, bound=bound, bound_name="margin")


def _forces(cell: RobotCell, loads: RunLoads | None) -> Curve | None:
    if loads is None:
        return None
    internal = np.nan_to_num(np.minimum(loads.internal, _FAR), nan=_FAR)

    def text(time: float) -> str:
        row = internal[max(0, int(np.searchsorted(loads.time, time + 1e-9, side="right")) - 1)]
        return f"{row.max():.3g} N, {cell.arm_names[int(row.argmax())]}".replace("_", " ")

    time, values = drawn(loads.time, internal, spans=SPANS)
    bound = loads.internal_limit if np.isfinite(loads.internal_limit) else None
    names = tuple(name.replace("_", " ") for name in cell.arm_names)
    title = "internal force" if loads.palm_use is None else "squeeze"
    return Curve(title, time, values, "N", text, names=names, bound=bound, bound_name="accepted in motion")


def length_text(mm: float) -> str:
    """A length in millimetres, or in micrometres if it is small."""
    if mm < _ROUNDING:
        return "below 0.001 µm"
    return f"{1e3 * mm:.2g} µm" if mm < _MICRO else f"{mm:.3g} mm"
