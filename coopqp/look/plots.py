"""Plots of runs: the paper's Figures 4 and 5, and the joints with their limits.

Each function returns a Matplotlib figure without a window and without global state. :func:`save_figure` writes it. The
functions need the extra ``plot``.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError, MissingExtraError
from coopqp.look.render import View, box_solid, cell_solids, render
from coopqp.model.cell import RobotCell
from coopqp.output import write_files
from coopqp.simulation import metrics
from coopqp.simulation.recording import Recording
from coopqp.spatial import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Quantity = Literal["position", "orientation"]

_COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#7a5195",
)  # distinguishable for colour-blind readers
_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
_INK, _FAINT = "#222222", "#8a8f98"
_TITLE: dict[str, Any] = {"fontsize": 15, "fontweight": "bold"}
#: Corners of the upper face of a box in :mod:`coopqp.look.render`, as a closed line.
_TOP_FACE = (1, 3, 7, 5, 1)
_PLATE = (0.30, 0.52, 0.75)
#: Smallest drawn error [mm or deg]; smaller ones are rounding.
_FLOOR = 1e-11
#: Spans of time of a drawn curve, more than a page has pixels.
DRAWN_SPANS = 4000


def require_matplotlib() -> None:
    """Raise MissingExtraError unless Matplotlib can be imported."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("plot", "matplotlib") from error


def _new_figure(width: float, height: float, **options: Any) -> Figure:
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), facecolor="white", **options)


def relative_errors(cell: RobotCell, recording: Recording, quantity: Quantity) -> Array:
    """ε_p [mm] or ε_o [deg] of the commanded configurations at every sample, (T+1,)."""
    grasp = recording.grasp
    errors = []
    for part in recording.parts(len(recording.time)):
        tools, _ = metrics.tool_matrices(cell, recording.q_command[part])
        if quantity == "position":
            errors.append(1e3 * metrics.positioning_errors(tools, grasp))
        else:
            errors.append(np.rad2deg(metrics.orientation_errors(tools, grasp)))
    return np.concatenate(errors)


def drawn(time: Array, values: Array, *, spans: int = DRAWN_SPANS) -> tuple[Array, Array]:
    """Curves as they are drawn: of long ones the least and the largest value of each of many equal spans.

    Args:
        time: (T,) [s].
        values: (T,), or (T, n) for n curves.
        spans: number of spans, at least 1.
    """
    if len(time) <= 4 * spans:
        return time, values
    first = np.linspace(0, len(time), spans, endpoint=False).astype(int)
    ends = np.stack([np.fmin.reduceat(values, first), np.fmax.reduceat(values, first)], axis=1)
    return np.repeat(time[first], 2), ends.reshape(-1, *values.shape[1:])


def drawn_rows(recording: Recording, count: int, rows: Callable[[slice], Array]) -> tuple[Array, Array]:
    """Times and rows of ``count`` samples or steps as they are drawn, from ``rows(part)`` (T, n) of one part after the
    other.
    """
    if count <= 4 * DRAWN_SPANS:
        return recording.time[:count], rows(slice(0, count))
    curves = [
        drawn(recording.time[part], rows(part), spans=max(1, (part.stop - part.start) * DRAWN_SPANS // count))
        for part in recording.parts(count)
    ]
    times, values = zip(*curves, strict=True)
    return np.concatenate(times), np.concatenate(values)


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
    figure = _new_figure(10.0, 5.0, layout="constrained")
    axes = figure.add_subplot()
    colours = {n: _COLOURS[i % len(_COLOURS)] for i, n in enumerate(steps)}
    longest = max(float(recording.time[-1]) for recordings in runs.values() for recording in recordings)
    symbol, unit, name = {
        "position": (r"$\varepsilon_p$", " mm", "position"),
        "orientation": (r"$\varepsilon_o$", "°", "orientation"),
    }[quantity]
    largest: dict[tuple[str, int], float] = {}
    for method, dashes in zip(runs, _cycle(_DASHES, len(runs)), strict=True):
        for recording in runs[method]:
            error = np.maximum(relative_errors(cell, recording, quantity), _FLOOR)
            n = planned_steps(recording)
            axes.semilogy(*drawn(recording.time[1:], error[1:]), color=colours[n], ls=dashes, lw=2.0)
            largest[method, n] = float(error.max())
    axes.set_xlim(0.0, longest)
    axes.set_xlabel("time [s]", fontsize=12, color=_INK)
    axes.set_ylabel(f"error of relative {name} {symbol} [{unit.strip()}]", fontsize=12, color=_INK)
    axes.grid(True, which="major", color="#e3e6ea", lw=0.8)
    _plain(axes)
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
    for method, dashes in zip(methods, _cycle(_DASHES, len(methods)), strict=True):
        entries[method, None] = Line2D([], [], ls="none"), method
        for n in steps:
            known = (method, n) in largest
            label = f"N = {n}: ≤ {_short(largest[method, n])}{unit}" if known else ""
            entries[method, n] = Line2D([], [], color=colours[n], ls=dashes if known else "none", lw=2.0), label
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
    legend = figure.legend(handles, labels, frameon=False, fontsize=11, labelcolor=_INK, **place)
    for text in legend.get_texts():
        if text.get_text() in methods:
            text.set_fontweight("bold")


def joint_figure(cell: RobotCell, recording: Recording) -> Figure:
    """Joint positions (0 mid-range, ±1 the limits) and joint speeds (share of the limit), one column per arm."""
    n_arms = len(cell)
    figure = _new_figure(max(10.0, 3.2 * n_arms), 5.2, layout="constrained")
    panels = figure.subplots(2, n_arms, sharex=True, sharey="row", squeeze=False)
    limits = cell.limits

    def positions(part: slice) -> Array:
        q = cell.positions(recording.q_command[part])
        with np.errstate(invalid="ignore"):
            share: Array = (2.0 * q - limits.upper - limits.lower) / (limits.upper - limits.lower)
        return share  # NaN without limit

    times, position = drawn_rows(recording, len(recording.time), positions)
    starts, speed = drawn_rows(
        recording, recording.n_steps, lambda part: 100.0 * recording.velocity[part] / limits.velocity
    )
    starts, speed = np.append(starts, recording.time[-1]), np.concatenate([speed, speed[-1:]])
    reach = 1.15 * max(5.0, float(np.nanmax(np.abs(speed), initial=0.0)))
    names = [name.split("/", 1)[1] for name in cell.joint_names]
    longest = max(cell.v_slices, key=lambda s: s.stop - s.start)
    for k, (arm, joints) in enumerate(zip(cell.arm_names, cell.v_slices, strict=True)):
        top, bottom = panels[:, k]
        for i, j in enumerate(range(joints.start, joints.stop)):
            colour = _COLOURS[i % len(_COLOURS)]
            top.plot(times, position[:, j], color=colour, lw=1.8)
            bottom.step(starts, speed[:, j], where="post", color=colour, lw=1.8)
        top.set_title(arm.replace("_", " "), fontsize=12, color=_INK, fontweight="bold")
        for panel, edge in ((top, 1.0), (bottom, 100.0)):
            for side in (-edge, edge):
                panel.axhline(side, color="#b00020", lw=1.4)
            panel.axhline(0.0, color="#d6dae0", lw=0.8, zorder=0)
            _plain(panel)
        bottom.set_xlabel("time [s]", fontsize=11, color=_INK)
        bottom.locator_params(axis="x", nbins=4)
    panels[0, 0].set_ylim(-1.15, 1.15)
    panels[0, 0].set_yticks([-1, -0.5, 0, 0.5, 1], ["lower limit", "", "mid-range", "", "upper limit"])
    panels[1, 0].set_ylim(-reach, reach)
    panels[1, 0].set_xlim(0.0, float(recording.time[-1]))
    figure.align_ylabels(panels[:, 0])
    panels[0, 0].set_ylabel("joint position", fontsize=11, color=_INK)
    panels[1, 0].set_ylabel("joint speed [% of limit]", fontsize=11, color=_INK)
    lines = panels[0, cell.v_slices.index(longest)].lines[: longest.stop - longest.start]
    figure.legend(
        lines, [n.replace("_", " ") for n in names[longest]], loc="outside lower center", ncols=len(lines),
        frameon=False, fontsize=11, labelcolor=_INK,
    )  # fmt: skip
    return figure


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

    The object is drawn at the pose of the first arm. Its outline at the start is dashed.

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
    X = recording.grasp.T_object_tool[0].inverse()
    bodies = [T[0] * X * T_object_body for T in metrics.tool_placements(cell, configurations)]
    solids = cell_solids(cell, configurations)
    for scene, T_world_body in zip(solids, bodies, strict=True):
        scene.append(box_solid(object_size, T_world_body, _PLATE))
    view = View.around(solids, azimuth=azimuth, elevation=elevation)
    pictures = render(solids, view, width=pixels)

    height, width = pictures[0].shape[:2]
    columns = min(columns, frames)
    rows = -(-frames // columns)
    gap = 0.006  # gap between pictures, as a share of the figure's width
    inches = 10.0
    cell_width = (1.0 - (columns - 1) * gap) / columns * inches
    cell_height = cell_width * height / width
    total = rows * cell_height + (rows - 1) * gap * inches
    figure = _new_figure(inches, total)
    start = view.pixels(solids[0][-1].vertices, width, height)
    for i, picture in enumerate(pictures):
        row, column = divmod(i, columns)
        left, bottom = column * (cell_width + gap * inches), total - row * (cell_height + gap * inches) - cell_height
        axes = figure.add_axes((left / inches, bottom / total, cell_width / inches, cell_height / total))
        axes.imshow(picture, aspect="auto", interpolation="antialiased", extent=(0.0, width, height, 0.0))
        axes.set_axis_off()
        label = f"t = {recording.time[samples[i]]:.1f} s"
        axes.text(0.97, 0.95, label, transform=axes.transAxes, ha="right", va="top", color=_INK, **_TITLE)
        if i:
            axes.plot(*start[_TOP_FACE, :2].T, color=_INK, ls=(0, (4, 3)), lw=1.0, alpha=0.5)
        else:
            _name_arms(axes, cell, configurations[0], view, width, height)
    return figure


def _name_arms(axes: Any, cell: RobotCell, q: Array, view: View, width: int, height: int) -> None:
    """Write each arm's name above its highest joint."""
    data = cell.model.createData()
    pin.forwardKinematics(cell.model, data, q)
    joints = view.pixels(np.array([data.oMi[j + 1].translation for j in range(cell.nv)]), width, height)
    for name, own in zip(cell.arm_names, cell.v_slices, strict=True):
        x, y, _ = min(joints[own], key=lambda point: float(point[1]))
        side = "right" if x < 0.5 * width else "left"  # outwards, away from the other arms
        axes.text(x, y - 0.1 * height, name.replace("_", " "), ha=side, va="bottom", fontsize=11, color=_INK)


def figure_bytes(figure: Figure, *, kind: str = "png", dpi: int = 200) -> bytes:
    """The figure as the bytes of a ``"png"``, ``"pdf"`` or ``"svg"`` file."""
    if kind not in ("png", "pdf", "svg"):
        raise InvalidInputError(f"'{kind}' is no kind of picture", "figure_bytes", "Use png, pdf or svg.")
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=dpi)
    return stream.getvalue()


def save_figure(figure: Figure, path: str | Path, *, dpi: int = 200) -> Path:
    """Write a figure as ``.png``, ``.pdf`` or ``.svg``, atomically.

    Raises:
        InvalidInputError: another file ending.
        OutputError: the file cannot be written.
    """
    file = Path(path)
    write_files({file: figure_bytes(figure, kind=file.suffix[1:].lower(), dpi=dpi)})
    return file


def _plain(axes: Any) -> None:
    """Set a plain style of ticks and frame."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_FAINT)
    axes.tick_params(colors=_INK, labelsize=10.5, which="both")


def _cycle(items: Sequence[Any], n: int) -> list[Any]:
    return [items[i % len(items)] for i in range(n)]


def _short(value: float) -> str:
    """A number with three digits; a small one with two digits and a power of ten."""
    if value >= 1e-3:
        return f"{value:#.3g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"
