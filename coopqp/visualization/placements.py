"""A map of base placements: the score of each, the figures behind it, and impossible ones. Needs ``plot``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.studies.placed import CellPlaced
from coopqp.visualization.style import INK, RED, label, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours of placements at which an arm does not follow the path, and at which bodies come too close.
_NOWHERE, _TOUCHES = "#e3e6ea", "#f3c9b8"


def placement_figure(
    name: str,
    found: Sequence[CellPlaced],
    *,
    units: Mapping[str, str],
    now: CellPlaced | None = None,
    best: CellPlaced | None = None,
) -> Figure:
    """A map over two axes, or curves over one.

    Args:
        name: name of the study.
        found: the cell at all combinations of the values of its axes, the last one innermost.
        units: unit of each axis, as :attr:`coopqp.studies.PlaceStudy.units`.
        now, best: placements to mark.

    Raises:
        MissingExtraError: matplotlib is missing.
    """
    axes = list(found[0].values)
    texts = [f"{label(axis)} [{units[axis]}]" for axis in axes]
    if len(axes) == 1:
        return _curves(name, found, axes[0], texts[0], now, best)
    xs, ys = (sorted({placed.values[axis] for placed in found}) for axis in axes)
    shape = len(xs), len(ys)

    def table(read: Any) -> Any:
        return np.array([read(placed) for placed in found], dtype=float).reshape(shape).T

    figure = new_figure(10.0, 4.4, layout="constrained")
    from matplotlib.colors import ListedColormap
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    score, sigma, margin = figure.subplots(1, 3, sharey=True)
    state = table(lambda p: 2.0 if p.feasible else 1.0 if p.follows else 0.0)
    panels = (
        (score, table(lambda p: p.score), "worst share of the goals: 1 is good", 1.0),
        (sigma, table(lambda p: min(a.sigma_min for a in p.arms) if p.feasible else np.nan), "smallest σ_min", None),
        (margin, table(lambda p: _least_margin(p) if p.feasible else np.nan), "least joint margin [deg]", None),
    )
    impossible = ListedColormap([_NOWHERE, _TOUCHES])
    marked = [(now, "s", "none", "as built"), (best, "*", RED, "best")]
    for panel, values, title, high in panels:
        edges = [_edges(xs), _edges(ys)]
        panel.pcolormesh(*edges, np.where(state < 2, state, np.nan), cmap=impossible, vmin=0, vmax=1)
        picture = panel.pcolormesh(*edges, values, cmap="viridis", vmin=0.0, vmax=high)
        figure.colorbar(picture, ax=panel, location="bottom", shrink=0.9, pad=0.02)
        if np.isfinite(values).sum() > 3:
            panel.contour(xs, ys, values, levels=5, colors="white", linewidths=0.5)
        panel.set_title(title, fontsize=10, color=INK, loc="left")
        panel.set_xlabel(texts[0])
        for placed, marker, face, _ in marked:
            if placed is not None:
                x, y = (placed.values[axis] for axis in axes)
                panel.plot(x, y, marker, color=RED, markersize=11, markerfacecolor=face)
        plain(panel)
    score.set_ylabel(texts[1])
    handles: list[Any] = [
        Line2D([], [], linestyle="", marker=marker, color=RED, markerfacecolor=face, markersize=10, label=text)
        for placed, marker, face, text in marked
        if placed is not None
    ]
    handles.append(Patch(color=_NOWHERE, label="an arm does not follow the path"))
    handles.append(Patch(color=_TOUCHES, label="bodies too close"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9.5)
    figure.suptitle(label(name, width=100), fontsize=11, color=INK)
    return figure


def _least_margin(placed: CellPlaced) -> float:
    turning = [np.rad2deg(arm.margin) for arm in placed.arms if not arm.slides]
    return float(min(turning, default=np.nan))


def _edges(values: Sequence[float]) -> Any:
    x = np.asarray(values)
    middle = 0.5 * (x[1:] + x[:-1])
    return np.concatenate([[2 * x[0] - middle[0]], middle, [2 * x[-1] - middle[-1]]])


def _curves(
    name: str, found: Sequence[CellPlaced], axis: str, text: str, now: CellPlaced | None, best: CellPlaced | None
) -> Figure:
    figure = new_figure(7.0, 3.8, layout="constrained")
    panel = figure.subplots()
    x = [placed.values[axis] for placed in found]
    for k, arm in enumerate(found[0].arms):
        shares = [min(p.arms[k].shares) if p.arms[k].feasible else np.nan for p in found]
        panel.plot(x, shares, label=label(arm.arm))
    panel.plot(x, [p.score for p in found], color=INK, linewidth=2.5, alpha=0.35, label="the cell")
    for placed, which, dashes in ((now, "as built", "--"), (best, "best", "-")):
        if placed is not None:
            panel.axvline(placed.values[axis], color=RED, linestyle=dashes, linewidth=1, label=which)
    panel.set(xlabel=text, ylabel="worst share of the goals", title=label(name, width=80))
    panel.legend(frameon=False)
    plain(panel)
    return figure
