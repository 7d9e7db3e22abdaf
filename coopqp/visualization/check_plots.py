"""Picture of a check: margins and σ_min of each arm along the path, the least distance, and the proved intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.collision.clearance_check import ClearanceCheck
from coopqp.model.batch import ArmKinematics
from coopqp.paths.certificate import LEAST_SIGMA, PathVerdict
from coopqp.planning.branch_checks import BranchCheck
from coopqp.planning.check import PathCheck
from coopqp.visualization.style import (
    COLOURS,
    INK,
    RED,
    add_legend,
    arm_grid,
    arm_panels,
    label,
    legend_columns,
    legend_height,
    new_figure,
    plain,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Largest number of arms in a picture: those with the least margins.
_MOST_ARMS = 6
_SIZE = 9.5  # type of the legends [pt]
#: Height of the panel of distances [in].
_DISTANCES = 2.2
_PROVED, _OPEN = "#dcefe1", "#f6d7b0"


def check_figure(check: PathCheck) -> Figure:
    """Margins and σ_min of the branch that is checked, one column per arm; at most six arms, the tightest.

    Margins are shares of a joint's half range: 100 % in its middle, 0 % at a limit. The background is green where the
    arm is proved to follow the path, and orange where it is not decided. Where distances were checked, the least one is
    below, with the margin of the pair that comes nearest to its own.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    shown = [k for k, arm in enumerate(check.arms) if arm.chosen is not None]
    shown = sorted(sorted(shown, key=lambda k: _branch(check, k).margins.min())[:_MOST_ARMS])
    columns, blocks, width = arm_grid(len(shown))
    kinematics = {k: ArmKinematics(check.cell.arms[k]) for k in shown}
    names = {
        k: [label(n) for n, b in zip(check.arms[k].joints, kinematics[k].bounded, strict=True) if b] for k in shown
    }
    fits = {k: legend_columns(names[k], (width - 1.0) / columns, size=_SIZE) for k in shown if names[k]}
    legend = max((legend_height(names[k], fits[k], size=_SIZE) for k in fits), default=0.3)
    bodies = check.clearance if check.clearance is not None and check.clearance.pair is not None else None
    height = blocks * (5.0 + legend) + 0.6 + (_DISTANCES if bodies else 0.0)
    figure = new_figure(width, height, layout="constrained")
    if not shown:
        figure.text(0.5, 0.5, "No arm reaches its grasp at the start of the path.", ha="center", color=INK)
        return figure
    heights = [2.2, 1.8, legend] * blocks + ([_DISTANCES] if bodies else [])
    cells = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    grid = np.array([[figure.add_subplot(cells[r, c]) for c in range(columns)] for r in range(3 * blocks)])
    panels = arm_panels(grid, len(shown))
    if len(shown) < len(check.arms):
        figure.suptitle(f"the tightest {len(shown)} of {len(check.arms)} arms", fontsize=12, color=INK)
    lowest = 0.0
    for place, (k, (top, bottom, below)) in enumerate(zip(shown, panels, strict=True)):
        arm, branch, own = check.arms[k], _branch(check, k), kinematics[k]
        joints = np.flatnonzero(own.bounded)
        share = 100.0 * own.margins(branch.q)[:, joints] / (0.5 * (own.upper - own.lower)[joints])
        lines = [
            top.plot(branch.clocks, row, color=COLOURS[i % len(COLOURS)], lw=1.8)[0] for i, row in enumerate(share.T)
        ]
        lowest = min(lowest, float(share.min(initial=0.0)))
        top.axhline(0.0, color=RED, lw=1.4)
        bottom.semilogy(branch.clocks, np.maximum(branch.sigma_min, 1e-6), color=INK, lw=1.8)
        bottom.axhline(LEAST_SIGMA, color=RED, lw=1.4)
        verdict = arm.verdict.value.lower()
        if arm.verdict is PathVerdict.INFEASIBLE:
            verdict += f" after {branch.until:.2f} s" if branch.until > 0.0 else " from the start"
        top.set_title(
            label(f"{arm.arm}: {verdict}", width=72 // (columns + 1)), fontsize=12, color=INK, fontweight="bold"
        )
        bottom.set_xlabel("clock of the path [s]", fontsize=11, color=INK)
        for panel in (top, bottom):
            _bands(panel, branch)
            plain(panel)
            panel.set_xlim(0.0, max(_end(check, k) for k in shown))
        if names[k]:
            add_legend(below, lines, names[k], fits[k], size=_SIZE)
        below.set_axis_off()
        if place % columns == 0:
            top.set_ylabel("margin [% of half range]", fontsize=11, color=INK)
            bottom.set_ylabel("σ_min", fontsize=11, color=INK)
    least, most = np.transpose([bottom.get_ylim() for _, bottom, _ in panels])
    for top, bottom, _ in panels:
        top.set_ylim(max(1.1 * lowest - 3.0, -40.0), 105.0)
        bottom.set_ylim(least.min(), most.max())
    figure.align_ylabels(grid[:, 0])
    if bodies:
        _distances(figure.add_subplot(cells[-1, :]), bodies, max(_end(check, k) for k in shown))
    _legend(figure, distances=bodies is not None)
    return figure


def _distances(axes: Any, found: ClearanceCheck, end: float) -> None:
    """The least distance along the path."""
    assert found.pair is not None
    axes.plot(found.clocks, 1e3 * found.distances, color=INK, lw=1.8)
    axes.axhline(1e3 * found.margin, color=RED, lw=1.4)
    axes.plot([found.clock], [1e3 * found.pair.distance], "o", color=INK, ms=6)
    if found.stop is not None:
        axes.axvline(found.stop, color=RED, lw=1.4, ls=":")
    if found.verdict is PathVerdict.CERTIFIED:
        axes.axvspan(found.clocks[0], found.clocks[-1], color=_PROVED, lw=0.0, zorder=0)
    for a, b in found.undecided:
        axes.axvspan(a, b, color=_OPEN, lw=0.0, zorder=0)
    pair = " and ".join(label(name) for name in (found.pair.first, found.pair.second))
    head = f"distances: {found.verdict.value.lower()}; closest {pair}"
    axes.set_title(head, fontsize=12, color=INK, fontweight="bold")
    axes.set_xlabel("clock of the path [s]", fontsize=11, color=INK)
    axes.set_ylabel("least distance [mm]", fontsize=11, color=INK)
    axes.set_xlim(0.0, end)
    axes.set_ylim(min(0.0, 1.1e3 * float(found.distances.min())), None)
    plain(axes)


def _branch(check: PathCheck, k: int) -> BranchCheck:
    branch = check.arms[k].chosen
    assert branch is not None
    return branch


def _end(check: PathCheck, k: int) -> float:
    return float(check.path.duration if np.isfinite(check.path.duration) else _branch(check, k).clocks[-1]) or 1.0


def _bands(axes: Any, branch: BranchCheck) -> None:
    for intervals, colour in ((branch.certified, _PROVED), (branch.undecided, _OPEN)):
        for a, b in intervals:
            axes.axvspan(a, b, color=colour, lw=0.0, zorder=0)


def _legend(figure: Figure, *, distances: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries = {
        f"limit, {'margin, ' if distances else ''}and least σ_min": Line2D([], [], color=RED, lw=1.4),
        "proved": Patch(color=_PROVED),
        "not decided": Patch(color=_OPEN),
    }
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=min(len(entries), 6), frameon=False,
        fontsize=10.5, labelcolor=INK,
    )  # fmt: skip
