"""A calibration as a picture: how far the arms part before and after, and what was corrected. Needs ``plot``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coopqp.forces.calibration import Calibration
from coopqp.visualization.style import COLOURS, INK, label, new_figure, open_frame, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_AFTER, _BEFORE = COLOURS[:2]
#: Colour of corrections that are not made.
_NOT_MADE = "0.6"
#: Smallest drawn distance [mm] and angle [°]; smaller ones are rounding.
_FLOOR = 1e-6


def calibration_figure(found: Calibration) -> Figure:
    """Loop residual over the samples on top; below, the corrections with two standard deviations.

    Raises:
        MissingExtraError: matplotlib is missing.
    """
    figure = new_figure(9.0, 6.4, layout="constrained")
    grid = figure.subplots(2, 2)
    for axes, column, scale, unit in ((grid[0, 0], 0, 1e3, "mm"), (grid[0, 1], 1, 180.0 / np.pi, "°")):
        for values, colour, when in ((found.before, _BEFORE, "before"), (found.after, _AFTER, "after")):
            shown = np.maximum(scale * values[:, column], _FLOOR)
            axes.semilogy(found.samples, shown, color=colour, linewidth=1.6, label=when)
        axes.set_xlabel("sample of the run")
        axes.set_ylabel(f"the arms part by [{unit}]")
        axes.grid(visible=True, which="major", alpha=0.3)
    grid[0, 0].legend(frameon=False)
    grid[0, 0].set_title("Does the chain close?", loc="left", color=INK)
    for axes, own, scale, unit in (
        (grid[1, 0], slice(0, 3), 1e3, "mm"),
        (grid[1, 1], slice(3, 6), 180.0 / np.pi, "°"),
    ):
        names: list[str] = []
        for arm in found.corrections:
            parts = (("base", arm.base, arm.base_deviation), ("grip", arm.grip, arm.grip_deviation))
            for part, value, spread in parts:
                at = len(names) + np.arange(3)
                names += [label(f"{arm.arm} {part} {axis}") for axis in "xyz"]
                colour, fill = (_AFTER, _AFTER) if arm.significant else (_NOT_MADE, "white")
                axes.errorbar(scale * value[own], at, xerr=2.0 * scale * spread[own], fmt="o", color=colour,
                              markerfacecolor=fill, markersize=4.0, linewidth=1.2, capsize=2.0)  # fmt: skip
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.set_yticks(range(len(names)), names, fontsize=7)
        axes.invert_yaxis()
        axes.set_xlabel(f"{'shift' if unit == 'mm' else 'turn'} [{unit}], ± 2 standard deviations")
    made = all(arm.significant for arm in found.corrections)
    title = "What was corrected" if made else "What was corrected (hollow: within its uncertainty, not made)"
    grid[1, 0].set_title(title, loc="left", color=INK)
    for axes in grid.ravel():
        open_frame(axes)
    return figure


def write_calibration(found: Calibration, file: str | Path, *, dpi: int = 200) -> Path:
    """Draw :func:`calibration_figure` into a ``.png``, ``.pdf`` or ``.svg`` file.

    Raises:
        InvalidInputError: another kind of file.
        OutputError: it cannot be written.
        MissingExtraError: matplotlib is missing.
    """
    return save_figure(calibration_figure(found), file, dpi=dpi)
