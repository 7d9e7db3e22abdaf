"""The paper's Figures 4 and 5 of any run.

Each function returns a Matplotlib figure without a window and without global state;
:func:`coopqp.visualization.style.save_figure` writes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array
from coopqp.visualization.renderer import View, body_solids, cell_solids, name_places, object_solids, render
from coopqp.visualization.style import COLOURS, DASHES, GRID, INK, WIDTH, drawn, label, new_figure, plain, text_width

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Quantity = Literal["position", "orientation"]

_TITLE: dict[str, Any] = {"fontsize": 13, "fontweight": "bold"}
#: Lower edge of the axis of errors [mm or deg].
_FLOOR = 1e-11
#: Height of the times above the pictures [inches], and room for names in a picture, a share of its height.
_BAND, _HEADROOM = 0.32, 0.06
#: Corners of the upper face of a box in :mod:`coopqp.visualization.renderer`, as a closed line.
_TOP_FACE = (1, 3, 7, 5, 1)
_PLATE = (0.30, 0.52, 0.75)


def relative_errors(cell: RobotCell, recording: Recording, quantity: Quantity) -> Array:
    """ε_p [mm] or ε_o [deg] of the commanded configurations at every sample, (T+1,)."""
    grasp = recording.grasp
    errors = []
    for part in recording.parts(len(recording.time)):
        tools = metrics.tool_matrices(cell, recording.q_command[part])
        if quantity == "position":
            errors.append(1e3 * metrics.positioning_errors(tools, grasp))
        else:
            angles = metrics.gaps(metrics.object_poses(tools, grasp))[1]
            errors.append(np.rad2deg(metrics.orientation_errors(angles)))
    return np.concatenate(errors)


def planned_steps(recording: Recording) -> int:
    """N, the number of steps of the run without slowing."""
    return round(float(recording.metadata["duration"]) / float(recording.metadata["dt"]))


def error_figure(
    cell: RobotCell, runs: Mapping[str, Sequence[Recording]], *, quantity: Quantity = "position"
) -> Figure:
    """The paper's Figure 5: the error between the arms over time, on a logarithmic axis.

    Args:
        cell: cell of the runs.
        runs: recordings by the name of their method. Each method has its own line style (first solid, then dashed),
            each number of steps its own colour.
        quantity: ``"position"`` for ε_p [mm], ``"orientation"`` for ε_o [deg].

    Raises:
        InvalidInputError: no recording, or an unknown quantity.
    """
    if quantity not in ("position", "orientation"):
        raise InvalidInputError(f"'{quantity}' is no quantity", "error_figure", "Give 'position' or 'orientation'.")
    steps = sorted({planned_steps(recording) for recordings in runs.values() for recording in recordings})
    if not steps:
        raise InvalidInputError("no recording", "error_figure", "Give at least one.")
    figure = new_figure(10.0, 5.0, layout="constrained")
    axes = figure.add_subplot()
    colours = {n: COLOURS[i % len(COLOURS)] for i, n in enumerate(steps)}
    longest = max(float(recording.time[-1]) for recordings in runs.values() for recording in recordings)
    symbol, unit, name = {
        "position": (r"$\varepsilon_p$", " mm", "position"),
        "orientation": (r"$\varepsilon_o$", "°", "orientation"),
    }[quantity]
    largest: dict[tuple[str, int], float] = {}
    for method, dashes in zip(runs, _cycle(DASHES, len(runs)), strict=True):
        for recording in runs[method]:
            error = relative_errors(cell, recording, quantity)
            n = planned_steps(recording)
            if error.max() >= metrics.ROUNDING:  # a smaller one is said, not drawn
                axes.plot(*drawn(recording.time[1:], error[1:]), color=colours[n], ls=dashes, lw=2.0)
            largest[method, n] = max(float(error.max()), largest.get((method, n), 0.0))
    axes.set_yscale("log")
    if axes.lines:
        axes.set_ylim(bottom=max(axes.get_ylim()[0], _FLOOR))
    else:
        axes.set_ylim(metrics.ROUNDING, 1.0)
    axes.set_xlim(0.0, longest)
    axes.set_xlabel("time [s]", fontsize=12, color=INK)
    axes.set_ylabel(f"error of relative {name} {symbol} [{unit.strip()}]", fontsize=12, color=INK)
    axes.grid(True, which="major", color=GRID, lw=0.8)
    plain(axes)
    _error_legend(figure, list(runs), steps, colours, largest, unit)
    return figure


def _error_legend(
    figure: Figure,
    methods: Sequence[str],
    steps: Sequence[int],
    colours: Mapping[int, str],
    largest: Mapping[tuple[str, int], float],
    unit: str,
) -> None:
    """Add the largest errors as a table, one row per method: above the plot, or beside it for many step numbers."""
    from matplotlib.lines import Line2D

    entries: dict[tuple[str, int | None], tuple[Any, str]] = {}
    for method, dashes in zip(methods, _cycle(DASHES, len(methods)), strict=True):
        entries[method, None] = Line2D([], [], ls="none"), label(method)
        for n in steps:
            known = (method, n) in largest
            text = f"N = {n}: {_at_most(largest[method, n], unit)}" if known else ""
            drawn = known and largest[method, n] >= metrics.ROUNDING
            entries[method, n] = Line2D([], [], color=colours[n], ls=dashes if drawn else "none", lw=2.0), text
    columns: list[int | None] = [None, *steps]
    if len(steps) <= 3:  # Matplotlib fills the legend column by column
        cells = [entries[method, n] for n in columns for method in methods]
        place: dict[str, Any] = {
            "loc": "outside upper center",
            "ncols": len(columns),
            "columnspacing": 1.6,
            "handlelength": 2.4,
        }
    else:
        cells = [entries[method, n] for method in methods for n in columns if n is None or (method, n) in largest]
        place = {"loc": "outside right upper"}
    handles, labels = zip(*cells, strict=True)
    legend = figure.legend(handles, labels, frameon=False, fontsize=11, labelcolor=INK, **place)
    names = [label(method) for method in methods]
    for entry in legend.get_texts():
        if entry.get_text() in names:
            entry.set_fontweight("bold")


def motion_figure(
    cell: RobotCell,
    recording: Recording,
    *,
    object_size: tuple[float, float, float],
    T_object_body: pin.SE3,
    frames: int = 4,
    columns: int = 2,
    azimuth: float = 125.0,
    elevation: float = 22.0,
    pixels: int = 1000,
) -> Figure:
    """The paper's Figure 4: the arms and the object at evenly spaced times of a run.

    The object is drawn at the pose of the first arm: the bodies that its file calls carried, else its box. The upper
    outline at the start is dashed.

    Args:
        cell, recording: the run.
        object_size: side lengths of the box that represents the object [m].
        T_object_body: placement of the box's centre in the object frame.
        frames, columns: number of pictures, and number of pictures side by side.
        azimuth, elevation: direction to the camera [deg].
        pixels: width of one picture [px].

    Raises:
        InvalidInputError: no picture, or arms without shapes.
    """
    if frames < 1 or columns < 1 or pixels < 1:
        raise InvalidInputError(
            f"frames = {frames}, columns = {columns}, pixels = {pixels}", "motion_figure", "Give numbers ≥ 1."
        )
    samples = np.round(np.linspace(0, recording.n_steps, frames)).astype(int)
    configurations = recording.q[samples]
    grasps = [recording.grasps_at(int(i))[0] for i in samples]
    poses = [T[0] * X.inverse() for T, X in zip(metrics.tool_placements(cell, configurations), grasps, strict=True)]
    carried, corners = object_solids(recording.metadata, np.array(object_size), T_object_body, _PLATE)
    solids = cell_solids(cell, configurations)
    standing = body_solids(recording.metadata)
    for scene, T in zip(solids, poses, strict=True):
        scene += [*(solid.placed(T) for solid in carried), *standing]
    view = View.around(solids, azimuth=azimuth, elevation=elevation)
    view = replace(view, top=view.top + _HEADROOM * (view.top - view.bottom))
    pictures = render(solids, view, width=pixels)

    height, width = pictures[0].shape[:2]
    columns = min(columns, frames)
    rows = -(-frames // columns)
    gap, inches = 0.06, WIDTH
    cell_width = (inches - (columns - 1) * gap) / columns
    cell_height = cell_width * height / width
    total = rows * (cell_height + _BAND)
    figure = new_figure(inches, total)
    start = view.pixels(corners @ poses[0].rotation.T + poses[0].translation, width, height)
    for i, picture in enumerate(pictures):
        row, column = divmod(i, columns)
        left, bottom = column * (cell_width + gap), total - (row + 1) * (cell_height + _BAND)
        axes = figure.add_axes((left / inches, bottom / total, cell_width / inches, cell_height / total))
        axes.imshow(picture, aspect="auto", interpolation="antialiased", extent=(0.0, width, height, 0.0))
        axes.set_axis_off()
        moment = f"t = {recording.time[samples[i]]:.1f} s"
        axes.text(0.5, 1.0, moment, transform=axes.transAxes, ha="center", va="bottom", color=INK, **_TITLE)
        if i:
            axes.plot(*start[_TOP_FACE, :2].T, color=INK, ls=(0, (4, 3)), lw=1.0, alpha=0.5)
        else:
            _name_arms(axes, cell, configurations[0], view, width, height)
    return figure


def _name_arms(axes: Any, cell: RobotCell, q: Array, view: View, width: int, height: int) -> None:
    """Write each arm's name above its highest joint, inside the picture."""
    size = 11.0
    scale = width / (72.0 * axes.get_position().width * axes.figure.get_figwidth())  # pixels of a point
    for name, place in zip(cell.arm_names, name_places(cell, q), strict=True):
        text = label(name)
        x, y, _ = view.pixels(place[None], width, height)[0]
        wide = scale * text_width(text, size=size)
        x = min(max(float(x), 0.5 * wide + 4.0), width - 0.5 * wide - 4.0)
        y = max(float(y), scale * size * (1.3 * text.count("\n") + 1.2))
        axes.text(x, y, text, ha="center", va="bottom", fontsize=size, color=INK)


def _cycle(items: Sequence[Any], n: int) -> list[Any]:
    return [items[i % len(items)] for i in range(n)]


def _at_most(value: float, unit: str) -> str:
    """A text: errors are at most a value, with three digits; a small one has two digits and a power of ten."""
    if not metrics.ROUNDING <= value < 1e-3:
        return ("≤ " if value >= metrics.ROUNDING else "") + metrics.error_text(value, unit)
    mantissa, exponent = f"{value:.1e}".split("e")
    return rf"≤ ${mantissa}\cdot 10^{{{int(exponent)}}}${unit}"
