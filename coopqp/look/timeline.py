"""One figure of a whole run over time: errors, rate, and binding limits. Needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.control.command import Status
from coopqp.look.plots import drawn, require_matplotlib
from coopqp.model.limits import BindingLimit
from coopqp.simulation.assessment import Readings
from coopqp.simulation.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_INK, _FAINT, _ALERT = "#222222", "#8a8f98", "#b00020"
_ERRORS = (
    ("eps_p_mm", r"$\varepsilon_p$, the paper's", "#0072b2", "-"),
    ("chain_mm", "arms against each other", "#d55e00", (0, (4, 1.5))),
    ("object_mm", "object against its path", "#009e73", (0, (1, 1.2))),
)
_BANDS = {
    Status.PAUSED: "#dbe4f3",
    Status.BLOCKED: "#f7dcc4",
    Status.OFF_PATH: "#e9d3f0",
    Status.HOLDING: "#f4c2c2",
    Status.FAULT: "#e58e8e",
}
#: Smallest drawn error [mm].
_FLOOR = 1e-8
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


def limit_name(limit: BindingLimit) -> str:
    """Name of a limit for the plot, e.g. ``slave_1/joint_3 velocity``."""
    return " ".join(part for part in ("/".join(p for p in (limit.arm, limit.joint) if p), limit.kind.value) if part)


def timeline_figure(recording: Recording, readings: Readings) -> Figure:
    """Errors [mm] on a logarithmic axis, the rate σ in front of the statuses, and the limits that bound."""
    require_matplotlib()
    from matplotlib.figure import Figure

    limits = bound_limits(recording)[:MAX_LIMITS]
    rows = [3.0, 1.5] + ([0.25 + 0.22 * len(limits)] if limits else [])
    figure = Figure(figsize=(10.0, 0.9 + sum(rows)), facecolor="white", layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(rows), 1, sharex=True, height_ratios=rows))
    _draw_errors(panels[0], recording, readings)
    _draw_rate(panels[1], recording)
    if limits:
        _draw_limits(panels[2], limits)
    for panel in panels:
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
        for side in ("left", "bottom"):
            panel.spines[side].set_color(_FAINT)
        panel.tick_params(colors=_INK, labelsize=10, which="both")
    panels[-1].set_xlim(0.0, max(float(recording.time[-1]), 1e-9))
    panels[-1].set_xlabel("time [s]", fontsize=11, color=_INK)
    figure.align_ylabels(panels[:2])
    return figure


def _draw_errors(axes: Any, recording: Recording, readings: Readings) -> None:
    for name, label, colour, dashes in _ERRORS:
        times, errors = drawn(recording.time, np.maximum(getattr(readings, name), _FLOOR))
        axes.semilogy(times, errors, color=colour, ls=dashes, lw=1.9, label=label)
    axes.set_ylabel("error [mm]", fontsize=11, color=_INK)
    axes.grid(True, which="major", color="#e3e6ea", lw=0.8)
    axes.legend(frameon=False, fontsize=10, labelcolor=_INK, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def _draw_rate(axes: Any, recording: Recording) -> None:
    status = list(Status)
    codes = recording.status.astype(int)
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    named: set[Status] = set()
    for i, j in zip(starts, [*starts[1:], recording.n_steps], strict=True):
        now = status[codes[i]]
        if now in _BANDS:
            label = now.value if now not in named else None
            axes.axvspan(recording.time[i], recording.time[j], color=_BANDS[now], lw=0, label=label)
            named.add(now)
    times, rates = drawn(recording.time[:-1], 100.0 * recording.rate)
    axes.stairs(rates, np.append(times, recording.time[-1]), color=_INK, lw=1.6, baseline=None)
    axes.set_ylim(-4.0, 108.0)
    axes.set_ylabel("rate σ [%]", fontsize=11, color=_INK)
    axes.grid(True, axis="y", color="#e3e6ea", lw=0.8)
    if named:
        axes.legend(frameon=False, fontsize=10, labelcolor=_INK, loc="center right")


def _draw_limits(axes: Any, limits: Sequence[Bound]) -> None:
    for row, bound in enumerate(limits):
        axes.broken_barh([(a, b - a) for a, b in bound.spans], (row - 0.36, 0.72), color=_ALERT, lw=0)
    axes.set_yticks(range(len(limits)), [limit_name(bound.limit) for bound in limits])
    axes.set_ylim(len(limits) - 0.4, -0.6)
    axes.set_title("limits that bound", fontsize=11, color=_INK, loc="left")
