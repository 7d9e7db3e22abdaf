"""The figures of a sweep over its varied settings: medians, and the span of the draws."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.studies.sweeping import Sweep
from coopqp.studies.table import FIGURES, OK, cell_text
from coopqp.studies.units import name_and_unit
from coopqp.visualization.style import COLOURS, DASHES, GRID, INK, add_legend, label, legend_columns, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Most lines of a panel.
_MOST_LINES = 12
#: Numbers along an axis that are written out.
_MOST_TICKS = 7
#: Values that differ by more than this ratio are drawn in decades.
_DECADES = 12.0


def sweep_figure(sweep: Sweep) -> Figure:
    """A panel for each of the study's ``figures``: the median of the draws, and the span of 80 % of them.

    Numbers along the axis with most values; a line for each combination of the others.

    Raises:
        MissingExtraError: matplotlib is missing.
    """
    study = sweep.study
    rows = [row for row in sweep.rows if row["outcome"] == OK]
    choices = {key: values for key, values in _choices(sweep).items() if len(values) > 1}
    along = max(choices, key=lambda key: (_is_numeric(choices[key]), len(choices[key])), default="")
    units = {key: name_and_unit(study, key) for key in choices}
    name_along, unit_along = units.pop(along, (along, ""))
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(_name(row, units), []).append(row)
    names = list(groups)[:_MOST_LINES]
    panels = study.figures or ("chain_mm",)
    figure = new_figure(3.4 * max(2, len(panels)), 4.3, layout="constrained")
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    parts: Any = figure.subfigures(2, 1, height_ratios=(6, 1))
    top, bottom = parts
    for axes, column in zip(np.atleast_1d(top.subplots(1, len(panels))), panels, strict=True):
        positions = choices.get(along, [""])
        numeric = _is_numeric(positions)
        decades = []
        for i, name in enumerate(names):
            x, low, middle, high = _spans(groups[name], along, positions, column)
            style = {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i // len(COLOURS) % len(DASHES)]}
            axes.fill_between(x, low, high, color=style["color"], alpha=0.15, linewidth=0)
            axes.plot(x, middle, marker="o", markersize=3.5, label=label(name), **style)
            decades += [v for v in (*low, *high) if np.isfinite(v)]
        if decades and min(decades) > 0.0 and max(decades) > _DECADES * min(decades):
            axes.set_yscale("log")
            wide = max(decades) > 100.0 * min(decades)
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.0e}" if v < 1e-3 else f"{v:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
        if numeric and min(positions) > 0.0 and max(positions) > _DECADES * min(positions):
            axes.set_xscale("log")
        if numeric and len(positions) <= _MOST_TICKS:
            axes.set_xticks(positions, [f"{x:.3g}" for x in positions])
            axes.set_xticks([], minor=True)
        if not numeric:
            axes.set_xticks(range(len(positions)), [label(cell_text(p), width=14) for p in positions])
        axes.set_xlabel(label(f"{name_along} [{unit_along}]" if unit_along else name_along, width=30), color=INK)
        axes.set_title(textwrap.fill(FIGURES[column], 36), fontsize=9.5, color=INK, loc="left")
        axes.grid(color=GRID, linewidth=0.7)
        axes.set_axisbelow(True)
        plain(axes)
    handles, _ = np.atleast_1d(top.axes)[0].get_legend_handles_labels()
    if units and handles:
        labels = [label(name, width=44) for name in names]
        add_legend(bottom.subplots(), handles, labels, legend_columns(labels, 3.4 * len(panels), size=9.5), size=9.5)
    drawn = study.draws * study.repeats
    title = f"{study.name}: {len(rows)} of {len(sweep.rows)} runs"
    figure.suptitle(label(title + (f"; lines: median, bands: 80 % of {drawn} draws" if drawn > 1 else ""), width=110),
                    fontsize=10.5, color=INK)  # fmt: skip
    return figure


def _choices(sweep: Sweep) -> dict[str, list[Any]]:
    found = {"case": [name for name, _ in sweep.study.cases]} if sweep.study.cases else {}
    return {**found, **{key: list(values) for key, values in sweep.study.axes}}


def _is_numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def _name(row: Mapping[str, Any], units: Mapping[str, tuple[str, str]]) -> str:
    """Values of a row, each with its name and unit."""
    return ", ".join(
        f"{name} {_short(row[key])} {unit}".rstrip() if key != "case" else str(row[key])
        for key, (name, unit) in units.items()
    )


def _short(value: Any) -> str:
    if isinstance(value, dict) and "kind" in value:
        return str(value["kind"])
    return f"{value:.4g}" if isinstance(value, float) else cell_text(value)


def _spans(
    rows: Sequence[Mapping[str, Any]], along: str, positions: Sequence[Any], column: str
) -> tuple[list[float], list[float], list[float], list[float]]:
    """Positions, and the 10 %, 50 % and 90 % quantiles of a column there."""
    x, low, middle, high = [], [], [], []
    for i, position in enumerate(positions):
        values = [float(row[column]) for row in rows if not along or row[along] == position]
        values = [v for v in values if np.isfinite(v)]
        if values:
            a, b, c = np.quantile(values, (0.1, 0.5, 0.9))
            x.append(float(position) if _is_numeric(positions) else float(i))
            low.append(float(a))
            middle.append(float(b))
            high.append(float(c))
    return x, low, middle, high
