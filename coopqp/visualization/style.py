"""Common parts of all figures: colours, type, files, legends that fit, long curves."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.control.interface import Status
from coopqp.errors import InvalidInputError, printable
from coopqp.lazy import needed
from coopqp.output import write_files
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#7a5195",
)  # distinguishable for colour-blind readers
DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
#: Colour of each status. Any two differ for readers without red, green or blue cones, too: CIELAB distance above 20.
STATUS_COLOURS = {
    Status.TRACKING: "#1a58cc",
    Status.SLOWED: "#40cefd",
    Status.BLOCKED: "#ee9406",
    Status.HOLDING: "#bb4408",
    Status.FAULT: "#591635",
    Status.PAUSED: "#deb1b6",
    Status.OFF_PATH: "#a24f93",
    Status.JOGGING: "#009a5e",
    Status.WAITING: "#fffe3d",
}
INK, FAINT, GRID, RED = "#222222", "#8a8f98", "#e3e6ea", "#b00020"
#: Largest width of a figure [inches]; wider ones are hard to read on a page.
WIDTH = 10.0
#: Longest line of a label in characters; longer labels are broken, none is cut.
LABEL = 34
_HANDLE, _PAD, _LINE = 24.0, 14.0, 1.45  # widths of a legend's handle and gap [pt], height of its lines [of the type]
#: Spans of time of a drawn curve, more than a page has pixels.
DRAWN_SPANS = 4000
#: Numbers beyond this are drawn there: Matplotlib cannot draw 1e300.
_FAR = 1e12


def paler(colour: str, share: float = 0.55) -> str:
    """A colour mixed with a share of white, behind curves."""
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round((1.0 - share) * part + share * 255.0):02x}" for part in parts)


def require_matplotlib() -> None:
    """Raise MissingExtraError unless Matplotlib can be imported."""
    needed("matplotlib.figure", "plot", "matplotlib")


def new_figure(width: float, height: float, **options: Any) -> Figure:
    """A white figure [inches] without a window.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), facecolor="white", **options)


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


def open_frame(axes: Axes) -> None:
    """Leave the frame open at the top and on the right."""
    axes.spines[["top", "right"]].set_visible(False)


def plain(axes: Axes) -> None:
    """Set a plain style of ticks and frame."""
    open_frame(axes)
    axes.spines[["left", "bottom"]].set_color(FAINT)
    axes.tick_params(colors=INK, labelsize=10.5, which="both")


def legend_beside(axes: Axes, **options: Any) -> None:
    """The legend on the right of the axes, whose frame is open."""
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=9, **options)
    open_frame(axes)


def arm_grid(shown: int, *, most: int = 3) -> tuple[int, int, float]:
    """Columns (at most so many) and blocks of rows for a block of panels an arm, and the figure's width [inches]."""
    columns = min(most, shown) or 1
    return columns, max(-(-shown // columns), 1), WIDTH if columns > 1 else 7.0


def arm_panels(grid: Any, shown: int) -> list[Any]:
    """Three panels of a column for each arm that is shown, from a grid of panels (3 B, C). The others are hidden."""
    places = [block[:, column] for block in np.split(grid, len(grid) // 3) for column in range(grid.shape[1])]
    for panel in (panel for place in places[shown:] for panel in place):
        panel.set_axis_off()
    return places[:shown]


def label(name: str, *, width: int = LABEL) -> str:
    """A name as text of a figure: without underscores and markup, in lines of at most ``width`` characters."""
    text = printable(name).replace("_", " ").replace("$", "\\$")
    return "\n".join(textwrap.wrap(text, width, break_on_hyphens=False)) or text


def text_width(text: str, *, size: float) -> float:
    """Width [pt] of the longest line of a text of a size [pt]."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    font, measure = FontProperties(size=size), TextToPath()
    lines = text.replace("\\$", "S").splitlines() or [""]
    return max(float(measure.get_text_width_height_descent(line, font, ismath=False)[0]) for line in lines)


def legend_columns(labels: Sequence[str], width: float, *, size: float) -> int:
    """Number of columns in which a legend of labels of a size [pt] fits into a width [inches]."""
    widest = max(text_width(text, size=size) for text in labels)
    return max(1, min(len(labels), int(72.0 * width / (widest + _HANDLE + _PAD))))


def legend_height(labels: Sequence[str], columns: int, *, size: float) -> float:
    """Height [inches] of a legend of labels of a size [pt] in columns."""
    rows = -(-len(labels) // columns)
    lines = max(text.count("\n") + 1 for text in labels)
    return (rows * lines * _LINE * size + size) / 72.0


def add_legend(axes: Axes, handles: Sequence[Any], labels: Sequence[str], columns: int, *, size: float) -> None:
    """Fill axes of their own with a legend."""
    axes.set_axis_off()
    axes.legend(
        handles, labels, loc="upper center", ncols=columns, frameon=False, fontsize=size, labelcolor=INK,
        handlelength=1.5, handletextpad=0.5, columnspacing=1.0, borderaxespad=0.0, borderpad=0.0,
    )  # fmt: skip


def drawn(time: Array, values: Array, *, spans: int = DRAWN_SPANS) -> tuple[Array, Array]:
    """Curves as they are drawn: of long ones the least and the largest value of each of many equal spans.

    Args:
        time: (T,) [s].
        values: (T,), or (T, n) for n curves.
        spans: number of spans, at least 1.
    """
    values = np.clip(values, -_FAR, _FAR)
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
        return recording.time[:count], np.clip(rows(slice(0, count)), -_FAR, _FAR)
    curves = [
        drawn(recording.time[part], rows(part), spans=max(1, (part.stop - part.start) * DRAWN_SPANS // count))
        for part in recording.parts(count)
    ]
    times, values = zip(*curves, strict=True)
    return np.concatenate(times), np.concatenate(values)
