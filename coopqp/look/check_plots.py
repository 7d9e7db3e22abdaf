"""Picture of a check: margins and σ_min of each arm along the path, with the intervals that are proved."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from coopqp.look.plots import _COLOURS, _INK, _new_figure, _plain
from coopqp.model.batch import ArmKinematics
from coopqp.planning.branch_checks import BranchCheck
from coopqp.planning.certificate import LEAST_SIGMA
from coopqp.planning.check import PathCheck

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Largest number of arms in a picture: those with the least margins.
_MOST_ARMS = 6
_PROVED, _OPEN, _RED = "#dcefe1", "#f6d7b0", "#b00020"


def check_figure(check: PathCheck) -> Figure:
    """Margins and σ_min of the branch that is judged, one column per arm; at most six arms, the tightest.

    Margins are shares of a joint's half range: 100 % in its middle, 0 % at a limit. The background is green where the
    arm is proved to follow the path, and orange where it is not decided.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    shown = [k for k, arm in enumerate(check.arms) if arm.chosen is not None]
    shown = sorted(sorted(shown, key=lambda k: _tightness(check, k))[:_MOST_ARMS])
    figure = _new_figure(max(7.0, 3.6 * len(shown)), 5.6, layout="constrained")
    if not shown:
        figure.text(0.5, 0.5, "No arm reaches its grasp at the start of the path.", ha="center", color=_INK)
        return figure
    panels = figure.subplots(2, len(shown), sharex=True, sharey="row", squeeze=False)
    if len(shown) < len(check.arms):
        figure.suptitle(f"the tightest {len(shown)} of {len(check.arms)} arms", fontsize=12, color=_INK)
    names: dict[str, Any] = {}
    for (top, bottom), k in zip(panels.T, shown, strict=True):
        arm = check.arms[k]
        branch = arm.chosen
        assert branch is not None
        kinematics = ArmKinematics(check.cell.arms[k])
        share = 100.0 * kinematics.margins(branch.q) / (0.5 * (kinematics.upper - kinematics.lower))
        for j in np.flatnonzero(kinematics.bounded):
            (line,) = top.plot(branch.clocks, share[:, j], color=_COLOURS[j % len(_COLOURS)], lw=1.8)
            names.setdefault(f"joint {j + 1}", line)
        top.axhline(0.0, color=_RED, lw=1.4)
        bottom.semilogy(branch.clocks, np.maximum(branch.sigma_min, 1e-6), color=_INK, lw=1.8)
        bottom.axhline(LEAST_SIGMA, color=_RED, lw=1.4)
        _bands(top, branch)
        _bands(bottom, branch)
        top.set_title(
            f"{arm.arm.replace('_', ' ')}: {arm.verdict.value.lower()}", fontsize=12, color=_INK, fontweight="bold"
        )
        bottom.set_xlabel("clock of the path [s]", fontsize=11, color=_INK)
        for panel in (top, bottom):
            _plain(panel)
    panels[0, 0].set_ylim(max(panels[0, 0].get_ylim()[0], -40.0), 105.0)
    panels[0, 0].set_xlim(0.0, max(_end(check, k) for k in shown))
    panels[0, 0].set_ylabel("margin [% of half range]", fontsize=11, color=_INK)
    panels[1, 0].set_ylabel("σ_min", fontsize=11, color=_INK)
    figure.align_ylabels(panels[:, 0])
    _legend(figure, names)
    return figure


def _tightness(check: PathCheck, k: int) -> float:
    branch = check.arms[k].chosen
    assert branch is not None
    return float(branch.margins.min())


def _end(check: PathCheck, k: int) -> float:
    branch = check.arms[k].chosen
    assert branch is not None
    return float(check.path.duration if np.isfinite(check.path.duration) else branch.clocks[-1]) or 1.0


def _bands(axes: Any, branch: BranchCheck) -> None:
    for intervals, colour in ((branch.certified, _PROVED), (branch.undecided, _OPEN)):
        for a, b in intervals:
            axes.axvspan(a, b, color=colour, lw=0.0, zorder=0)


def _legend(figure: Figure, names: dict[str, Any]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries = {
        **names,
        "limit, least σ_min": Line2D([], [], color=_RED, lw=1.4),
        "proved": Patch(color=_PROVED),
        "not decided": Patch(color=_OPEN),
    }
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=min(len(entries), 6), frameon=False,
        fontsize=10.5, labelcolor=_INK,
    )  # fmt: skip
