"""Picture of the demands of a motion on the arms: torques, grips and internal forces over time. Needs ``plot``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coopqp.forces.utilisation import LoadUse
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation.wrenches import RunLoads
from coopqp.visualization.style import COLOURS, FAINT, INK, drawn, legend_beside, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def load_figure(use: LoadUse) -> Figure:
    """Used shares of the limits over time: the most used joint of each arm, its internal force, and its grip if bound.

    Raises:
        MissingExtraError: matplotlib is missing.
    """
    cell, rows = use.cell, [("joint torque", use.joint), ("internal force", use.internal), ("grip", use.grip)]
    rows = [row for row in rows if row[1].max() > 0.0 or row[0] == "joint torque"]
    figure = new_figure(8.0, 1.2 + 2.0 * len(rows), layout="constrained")
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (what, shares) in zip(panels, rows, strict=True):
        for k, arm in enumerate(cell.arm_names):
            label, line = arm, shares[:, min(k, shares.shape[1] - 1)]
            if what == "joint torque":
                own = cell.v_slices[k]
                j = own.start + int(shares[:, own].max(axis=0).argmax())
                label, line = cell.joint_names[j], shares[:, j]
            axes.plot(use.time, 100.0 * line, color=COLOURS[k % len(COLOURS)], linewidth=1.6, label=label)
        axes.axhline(100.0, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
        axes.set_ylim(0.0, 110.0)
        axes.set_ylabel(f"{what}\n[% of its limit]")
        legend_beside(axes)
        if not use.feasible:
            axes.fill_between(use.time, 0.0, 110.0, where=use.share < 1.0, color=FAINT, alpha=0.3, linewidth=0.0)
    least = 100.0 * float(use.share.min())
    text = "The arms carry the load" if use.feasible else f"Too heavy where grey: {least:.0f} % of the load are carried"
    panels[0].set_title(text, loc="left", color=INK)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(use.time[0], use.time[-1])
    return figure


def run_loads_figure(cell: RobotCell, loads: RunLoads) -> Figure:
    """Torques of a run as shares of their limits, the most used joint of each arm; and the arms' internal forces.

    Raises:
        MissingExtraError: matplotlib is missing.
    """
    palms = loads.palm_use
    figure = new_figure(8.0, 5.2 if palms is None else 7.4, layout="constrained")
    panels = figure.subplots(2 if palms is None else 3, 1, sharex=True)
    torque, force = panels[0], panels[-1]
    if palms is not None:
        for k, arm in enumerate(cell.arm_names):
            used = np.where(np.arange(len(palms)) < loads.moves, np.nan, np.minimum(100.0 * palms[:, k], 200.0))
            panels[1].plot(loads.time, used, color=COLOURS[k % len(COLOURS)], lw=1.6, label=arm)
        panels[1].axhline(100.0, color=INK, lw=1.0, ls=(0, (4, 3)))
        panels[1].set(ylim=(0.0, 120.0), ylabel="friction of the palm\n[% of what holds]")
    for k, (arm, own) in enumerate(zip(cell.arm_names, cell.v_slices, strict=True)):
        j = own.start + int(loads.torque_use[:, own].max(axis=0).argmax())
        colour = COLOURS[k % len(COLOURS)]
        torque.plot(*drawn(loads.time, 100.0 * loads.torque_use[:, j]), color=colour, lw=1.6, label=cell.joint_names[j])
        force.plot(*drawn(loads.time, loads.internal[:, k]), color=colour, lw=1.6, label=arm)
    torque.set_title("Most used joint of each arm, and forces beside the load", loc="left", color=INK)
    torque.axhline(100.0, color=INK, lw=1.0, ls=(0, (4, 3)))
    torque.set(ylim=(0.0, max(110.0, 105.0 * float(loads.torque_use.max()))), ylabel="joint torque\n[% of its limit]")
    if np.isfinite(loads.internal_limit):
        force.axhline(loads.internal_limit, color=INK, lw=1.0, ls=(0, (4, 3)), label="accepted in motion")
    force.set(ylim=(0.0, None), ylabel="internal force [N]" if palms is None else "squeeze [N]", xlabel="time [s]")
    if 0 < loads.moves < len(loads.time):
        force.axvspan(0.0, loads.time[loads.moves], color=FAINT, alpha=0.2, lw=0.0, label="before it moves")
    for axes in panels:
        legend_beside(axes)
    force.set_xlim(0.0, float(loads.time[-1]))
    return figure


def write_load_use(use: LoadUse, file: str | Path, *, dpi: int = 200) -> Path:
    """Draw :func:`load_figure` into a ``.png``, ``.pdf`` or ``.svg`` file.

    Raises:
        InvalidInputError: another kind of file.
        OutputError: it cannot be written.
        MissingExtraError: matplotlib is missing.
    """
    return save_figure(load_figure(use), file, dpi=dpi)
