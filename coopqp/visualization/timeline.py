"""One figure of a whole run over time: errors, rate, and binding limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.control.interface import Status
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.simulation.evaluation.assessment import Tolerances
from coopqp.simulation.evaluation.metrics import Readings
from coopqp.simulation.recording.recording import LONGEST, Recording
from coopqp.simulation.recording.scene import SceneError, reading
from coopqp.visualization.style import (
    FAINT,
    GRID,
    INK,
    RED,
    STATUS_COLOURS,
    WIDTH,
    drawn,
    label,
    new_figure,
    paler,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ERRORS = (
    ("eps_p_mm", r"$\varepsilon_p$, the paper's", "#0072b2", "-"),
    ("chain_mm", "arms against each other", "#d55e00", (0, (4, 1.5))),
    ("object_mm", "object against its path", "#009e73", (0, (1, 1.2))),
)
#: Colours behind the steps of each status.
BANDS: dict[Status, str] = {
    status: paler(colour) for status, colour in STATUS_COLOURS.items() if status not in (Status.TRACKING, Status.SLOWED)
}
#: Smallest drawn error [mm]: a nanometre. What is smaller all the time is said, not drawn.
_FLOOR = 1e-6
#: Largest number of drawn limits; the limits that bound longest are drawn.
MAX_LIMITS = 14


@dataclass(frozen=True)
class Bound:
    """A limit and the times at which it bound.

    Attributes:
        limit: the limit.
        spans: start and end of each time span [s].
    """

    limit: BindingLimit
    spans: tuple[tuple[float, float], ...]

    @property
    def seconds(self) -> float:
        """Total time [s]."""
        return sum(end - start for start, end in self.spans)


def bound_limits(recording: Recording) -> list[Bound]:
    """All limits that bound, in descending order of time."""
    spans: dict[BindingLimit, list[tuple[float, float]]] = {}
    began: dict[BindingLimit, float] = {}
    bindings: Sequence[tuple[BindingLimit, ...]] = [*recording.bindings, ()]
    for i, limits in enumerate(bindings):
        now = float(recording.time[i])
        for limit in [limit for limit in began if limit not in limits]:
            spans.setdefault(limit, []).append((began.pop(limit), now))
        for limit in limits:
            began.setdefault(limit, now)
    found = [Bound(limit, tuple(times)) for limit, times in spans.items()]
    return sorted(found, key=lambda bound: (-bound.seconds, str(bound.limit)))


def marked_spans(recording: Recording) -> Iterator[tuple[Status, int, int]]:
    """Each span of steps [i, j) of one status that :data:`BANDS` marks: the status, i and j."""
    statuses, codes = list(Status), recording.status.astype(int)
    starts = np.flatnonzero(np.diff(codes, prepend=-1)).tolist()
    for i, j in zip(starts, [*starts[1:], recording.n_steps], strict=True):
        if statuses[codes[i]] in BANDS:
            yield statuses[codes[i]], i, j


def limit_name(limit: BindingLimit) -> str:
    """Name of a limit for the plot, e.g. ``slave_1/joint_3 velocity``, ``object and post``, ``constraint speed``."""
    if limit.between or limit.kind is LimitKind.CONSTRAINT:
        return " and ".join(limit.between) or f"{limit.kind.value} {limit.name}"
    return " ".join(part for part in ("/".join(p for p in (limit.arm, limit.joint) if p), limit.kind.value) if part)


def timeline_figure(recording: Recording, readings: Readings, *, tolerances: Tolerances | None = None) -> Figure:
    """Errors [mm] on a logarithmic axis, the rate σ in front of the statuses, distances, and the limits that bound.

    Distances are drawn where the recording has them; see :func:`coopqp.simulation.evaluation.closeness.with_clearance`.

    Args:
        recording, readings: the run and its errors.
        tolerances: accepted errors, drawn as lines; by default :meth:`Tolerances.of` the recording.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    limits = bound_limits(recording)[:MAX_LIMITS]
    names = [label(limit_name(bound.limit)) for bound in limits]
    lines = sum(name.count("\n") + 1 for name in names)
    clearance = recording.metadata.get("clearance")
    if not isinstance(clearance, Mapping) or "closest_m" not in clearance:  # there all pairs were left out
        clearance = None
    rows = [3.0, 1.5] + ([1.5] if clearance else []) + ([0.25 + 0.22 * lines] if limits else [])
    figure = new_figure(WIDTH, 0.9 + sum(rows), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(rows), 1, sharex=True, height_ratios=rows))
    _draw_errors(panels[0], recording, readings, tolerances or Tolerances.of(recording))
    _draw_rate(panels[1], recording)
    if clearance:
        _draw_clearance(panels[2], clearance)
    if limits:
        _draw_limits(panels[-1], limits, names)
    for panel in panels:
        plain(panel)
        panel.tick_params(labelsize=10, which="both")
    panels[-1].set_xlim(0.0, max(float(recording.time[-1]), 1e-9))
    panels[-1].set_xlabel("time [s]", fontsize=11, color=INK)
    figure.align_ylabels(panels[:2])
    return figure


def _draw_errors(axes: Any, recording: Recording, readings: Readings, tolerances: Tolerances) -> None:
    """The errors with their tolerances. An error below the floor all the time is an entry of the legend only."""
    from matplotlib.lines import Line2D

    handles, quiet, largest = [], 0, max(tolerances.chain_mm, tolerances.object_mm)
    for name, text, colour, dashes in _ERRORS:
        error = getattr(readings, name)
        small = bool((error < _FLOOR).all())
        quiet += small
        if not small:
            times, errors = drawn(recording.time, np.maximum(error, 0.1 * _FLOOR))
            axes.plot(times, errors, color=colour, ls=dashes, lw=1.9)
            largest = max(largest, float(np.nanmax(errors, initial=0.0)))
        entry = f"{text}: below 1e-6 mm" if small else text
        handles.append(Line2D([], [], color=colour, ls="none" if small else dashes, lw=1.9, label=entry))
    for name, text, colour in (("chain_mm", "arms", _ERRORS[1][2]), ("object_mm", "object", _ERRORS[2][2])):
        asked = getattr(tolerances, name)
        axes.axhline(asked, color=colour, lw=1.0, ls=(0, (8, 3)))
        axes.annotate(
            f"tolerance of the {text}: {asked:g} mm", (1.0, asked), (-2.0, 3.0), ha="right", va="bottom", color=colour,
            xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=9,
        )  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylim(_FLOOR, 8.0 * largest if np.isfinite(largest) else None)
    if quiet == len(_ERRORS):
        axes.text(
            0.5, 0.4, "every error is below 1e-6 mm", transform=axes.transAxes, ha="center", fontsize=12, color=INK
        )
    axes.set_ylabel("error [mm]", fontsize=11, color=INK)
    axes.grid(True, which="major", color=GRID, lw=0.8)
    axes.legend(
        handles=handles, frameon=False, fontsize=10, labelcolor=INK, ncols=2, loc="lower left",
        bbox_to_anchor=(0.0, 1.0), columnspacing=2.0,
    )  # fmt: skip


def _draw_rate(axes: Any, recording: Recording) -> None:
    named: set[Status] = set()
    for status, i, j in marked_spans(recording):
        new = status.value if status not in named else None
        axes.axvspan(recording.time[i], recording.time[j], color=BANDS[status], lw=0, label=new)
        named.add(status)
    times, rates = drawn(recording.time[:-1], 100.0 * recording.rate)
    axes.stairs(rates, np.append(times, recording.time[-1]), color=INK, lw=1.6, baseline=None)
    axes.set_ylim(-4.0, 108.0)
    axes.set_ylabel("rate σ [%]", fontsize=11, color=INK)
    axes.grid(True, axis="y", color=GRID, lw=0.8)
    if named:
        axes.legend(
            frameon=False, fontsize=10, labelcolor=INK, ncols=len(named), loc="lower right", bbox_to_anchor=(1.0, 1.0)
        )


def _draw_clearance(axes: Any, clearance: Mapping[str, Any]) -> None:
    """Least distance of all bodies over time, the closest point, and the margin."""
    with reading("clearance is"):
        times, distances = drawn(np.array(clearance["times_s"], float), 1e3 * np.array(clearance["distances_m"], float))
        at, closest = drawn(np.array([clearance["time_s"]], float), 1e3 * np.array([clearance["closest_m"]], float))
        if not np.isfinite([*times, *distances, *at, *closest]).all() or max(map(abs, [*times, *at])) > LONGEST:
            raise SceneError("the recording's clearance is damaged (its numbers are too large).")
        between = f"closest: {' and '.join(map(str, clearance['between']))}"
        axes.plot(times, distances, color=INK, lw=1.6)
        axes.plot(at, closest, "o", color=RED, ms=5, label=label(between, width=100))
        if clearance["avoided"]:
            margin = min(1e3 * float(clearance["margin_m"]), 1e4)
            axes.axhline(margin, color=FAINT, ls="--", lw=1.2, label="margin")
        axes.set_ylim(min(0.0, 1.1 * float(distances.min())), max(1.15 * float(distances.max()), 1.0))
        axes.set_ylabel("distance [mm]", fontsize=11, color=INK)
        axes.grid(True, axis="y", color=GRID, lw=0.8)
        axes.legend(frameon=False, fontsize=10, labelcolor=INK, loc="best")


def _draw_limits(axes: Any, limits: Sequence[Bound], names: Sequence[str]) -> None:
    for row, bound in enumerate(limits):
        axes.broken_barh([(a, b - a) for a, b in bound.spans], (row - 0.36, 0.72), color=RED, lw=0)
    axes.set_yticks(range(len(limits)), names)
    axes.set_ylim(len(limits) - 0.4, -0.6)
    axes.set_title("limits that bound", fontsize=11, color=INK, loc="left")
