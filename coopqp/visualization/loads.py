"""Picture of the demands of a motion on the arms: torques, grips and internal forces over time. Needs ``plot``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.forces.utilisation import LoadUse
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation.wrenches import RunLoads
from coopqp.spatial import Array
from coopqp.visualization.style import COLOURS, FAINT, INK, drawn, label, legend_beside, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
        if what == "joint torque":
            _most_used_joints(axes, cell, use.time, shares)
        else:
            _lines(axes, use.time, 100.0 * shares, cell.arm_names)
        _limit(axes, 100.0)
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
        used = np.minimum(100.0 * palms, 200.0)
        used[: loads.moves] = np.nan
        _lines(panels[1], loads.time, used, cell.arm_names)
        _limit(panels[1], 100.0)
        panels[1].set(ylim=(0.0, 120.0), ylabel="friction of the palm\n[% of what holds]")
    _most_used_joints(torque, cell, loads.time, loads.torque_use)
    _lines(force, loads.time, loads.internal, cell.arm_names)
    torque.set_title("Most used joint of each arm, and forces beside the load", loc="left", color=INK)
    _limit(torque, 100.0)
    torque.set(ylim=(0.0, max(110.0, 105.0 * float(loads.torque_use.max()))), ylabel="joint torque\n[% of its limit]")
    if np.isfinite(loads.internal_limit):
        _limit(force, loads.internal_limit, label="accepted in motion")
    force.set(ylim=(0.0, None), ylabel="internal force [N]" if palms is None else "squeeze [N]", xlabel="time [s]")
    if 0 < loads.moves < len(loads.time):
        force.axvspan(0.0, loads.time[loads.moves], color=FAINT, alpha=0.2, lw=0.0, label="before it moves")
    for axes in panels:
        legend_beside(axes)
    force.set_xlim(0.0, float(loads.time[-1]))
    return figure


def _most_used_joints(axes: Axes, cell: RobotCell, time: Array, shares: Array) -> None:
    """The shares of limits (T, nv) of the joint of each arm that uses most [%]."""
    joints = [own.start + int(shares[:, own].max(axis=0).argmax()) for own in cell.v_slices]
    _lines(axes, time, 100.0 * shares[:, joints], [cell.joint_names[j] for j in joints])


def _lines(axes: Axes, time: Array, values: Array, names: Sequence[str]) -> None:
    """One line (T, N) per arm."""
    for k, name in enumerate(names):
        axes.plot(*drawn(time, values[:, k]), color=COLOURS[k % len(COLOURS)], lw=1.6, label=label(name))


def _limit(axes: Axes, height: float, **options: Any) -> None:
    axes.axhline(height, color=INK, lw=1.0, ls=(0, (4, 3)), **options)


def write_load_use(use: LoadUse, file: str | Path, *, dpi: int = 200) -> Path:
    """Draw :func:`load_figure` into a ``.png``, ``.pdf`` or ``.svg`` file.

    Raises:
        InvalidInputError: another kind of file.
        OutputError: it cannot be written.
        MissingExtraError: matplotlib is missing.
    """
    return save_figure(load_figure(use), file, dpi=dpi)
