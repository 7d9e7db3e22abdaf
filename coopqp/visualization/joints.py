"""The joints of a run against their limits, one panel per arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array
from coopqp.visualization.style import (
    COLOURS,
    INK,
    RED,
    add_legend,
    arm_grid,
    arm_panels,
    drawn_rows,
    label,
    legend_columns,
    legend_height,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Velocity coordinates of an arm's joints.
Columns = npt.NDArray[np.intp]
#: Largest number of arms in a figure: those that come closest to a limit.
MOST_ARMS = 12
_SIZE = 9.5  # type of the legends [pt]
_POSITION, _SPEED, _TITLE, _EDGE = 1.9, 1.6, 0.55, 1.3  # heights, and the width of the labels on the left [inches]


def joint_figure(cell: RobotCell, recording: Recording) -> Figure:
    """Positions [% of the range] and speeds [% of the limit] of the joints that move each arm's tool, with a legend.

    A cell of more than twelve arms shows those whose joints come closest to a limit.
    """
    limits = cell.limits

    def positions(part: slice) -> Array:
        q = cell.positions(recording.q_command[part])
        with np.errstate(invalid="ignore"):
            share: Array = 100.0 * (q - limits.lower) / (limits.upper - limits.lower)
        return share  # NaN without limit

    times, position = drawn_rows(recording, len(recording.time), positions)
    scale = np.where(np.isfinite(limits.velocity), limits.velocity, np.nan)  # NaN without limit, too
    starts, speed = drawn_rows(recording, recording.n_steps, lambda part: 100.0 * recording.velocity[part] / scale)
    starts, speed = np.append(starts, recording.time[-1]), np.concatenate([speed, speed[-1:]])
    columns_of = moving_columns(cell)
    shown = _tightest(columns_of, position, speed)
    columns, blocks, width = arm_grid(len(shown), most=2 if len(shown) == 4 else 3)
    names = {k: _names(cell, columns_of[k]) for k in shown}
    fits = {k: legend_columns(names[k], (width - _EDGE) / columns, size=_SIZE) for k in shown}
    legend = max(legend_height(names[k], fits[k], size=_SIZE) for k in shown)
    some = len(shown) < len(cell)
    height = blocks * (_TITLE + _POSITION + _SPEED + 0.45 + legend) + 0.3 * some
    figure = new_figure(width, height, layout="constrained")
    if some:
        figure.suptitle(f"the {len(shown)} of {len(cell)} arms that come closest to a limit", fontsize=12, color=INK)
    grid = figure.subplots(
        3 * blocks, columns, squeeze=False, gridspec_kw={"height_ratios": [_POSITION, _SPEED, legend] * blocks}
    )
    drawn = np.nan_to_num(np.abs(speed[:, np.concatenate([columns_of[k] for k in shown])]))
    reach = 1.15 * max(5.0, float(drawn.max(initial=0.0)))
    for place, (k, (top, bottom, below)) in enumerate(zip(shown, arm_panels(grid, len(shown)), strict=True)):
        joints = columns_of[k]
        lines = _draw(top, bottom, (times, position[:, joints]), (starts, speed[:, joints]))
        top.set_title(label(cell.arm_names[k], width=72 // (columns + 1)), fontsize=12, color=INK, fontweight="bold")
        _axes(top, bottom, end=float(recording.time[-1]), reach=reach, first=place % columns == 0)
        add_legend(below, lines, names[k], fits[k], size=_SIZE)
    figure.align_ylabels(grid[:, 0])
    return figure


def _tightest(columns: Sequence[Columns], position: Array, speed: Array) -> list[int]:
    """The arms that are shown, in their order."""
    if len(columns) <= MOST_ARMS:
        return list(range(len(columns)))
    off = np.abs(position - 50.0).max(axis=0)
    used = np.fmax(2.0 * off, np.nan_to_num(np.abs(speed)).max(axis=0, initial=0.0))
    closest = [float(np.nanmax(used[s], initial=0.0)) for s in columns]
    return sorted(sorted(range(len(columns)), key=lambda k: -closest[k])[:MOST_ARMS])


def _names(cell: RobotCell, columns: Columns) -> list[str]:
    """The names of joints; those without limits are marked."""
    limits, names = cell.limits, []
    for j in columns.tolist():
        bounded = np.isfinite(limits.lower[j]) and np.isfinite(limits.upper[j])
        lacks = [] if bounded else ["no limit"]
        lacks += [] if np.isfinite(limits.velocity[j]) else ["no speed limit"]
        name = cell.joint_names[j].split("/", 1)[1]
        names.append(label(f"{name} ({', '.join(lacks)})" if lacks else name))
    return names


def _draw(top: Any, bottom: Any, positions: tuple[Array, Array], speeds: tuple[Array, Array]) -> list[Any]:
    """Draw the curves of an arm. Returns its lines of speed: one for every joint, also without limits."""
    (times, position), (starts, speed) = positions, speeds
    lines = []
    for i in range(position.shape[1]):
        colour, dashes = COLOURS[i % len(COLOURS)], "-" if i < len(COLOURS) else "--"
        top.plot(times, position[:, i], color=colour, ls=dashes, lw=1.7)
        lines += bottom.step(starts, speed[:, i], where="post", color=colour, ls=dashes, lw=1.7)
    return lines


def _axes(top: Any, bottom: Any, *, end: float, reach: float, first: bool) -> None:
    for panel, low, middle in ((top, 0.0, 50.0), (bottom, -100.0, 0.0)):
        for side in (low, 100.0):
            panel.axhline(side, color=RED, lw=1.4)
        panel.axhline(middle, color="#d6dae0", lw=0.8, zorder=0)
        panel.set_xlim(0.0, max(end, 1e-9))
        panel.locator_params(axis="x", nbins=4)
        plain(panel)
    top.set_ylim(-7.5, 107.5)
    bottom.set_ylim(-reach, reach)
    top.set_yticks([0, 25, 50, 75, 100], ["lower limit 0", "25", "50", "75", "upper limit 100"])
    top.tick_params(labelbottom=False)
    bottom.set_xlabel("time [s]", fontsize=11, color=INK)
    if first:
        top.set_ylabel("position [% of range]", fontsize=11, color=INK)
        bottom.set_ylabel("speed [% of limit]", fontsize=11, color=INK)
    else:
        top.tick_params(labelleft=False)
        bottom.tick_params(labelleft=False)
