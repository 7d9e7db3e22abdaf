"""Result of a path check for one arm: the checked branch, its margins, and its obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.model.branches import amount
from coopqp.paths.certificate import PathVerdict, follows
from coopqp.planning.branch_checks import BranchCheck
from coopqp.shown import Brief


@dataclass(frozen=True, kw_only=True, eq=False)
class UndecidedInterval:
    """An interval of the path on which nothing is proved about an arm.

    Attributes:
        arm: its name.
        start, end: clocks [s].
    """

    arm: str
    start: float
    end: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ArmCheck(Brief):
    """Result for one arm.

    Attributes:
        arm: its name.
        joints: names of the joints that move its tool, n of them.
        slides: True for prismatic joints (n,).
        chosen: the branch that is checked; None if the arm does not reach its grasp at the start of the path.
        branches: all branches at the start of the path, the best first; of a redundant arm the best samples. Only the
            given one if a start was given.
        trouble: why the arm cannot follow the path: a sentence; empty otherwise.
    """

    arm: str
    joints: tuple[str, ...]
    slides: tuple[bool, ...]
    chosen: BranchCheck | None
    branches: tuple[BranchCheck, ...]
    trouble: str

    @property
    def verdict(self) -> PathVerdict:
        """The verdict on this arm."""
        return PathVerdict.INFEASIBLE if self.chosen is None else self.chosen.verdict

    @property
    def follows(self) -> bool:
        """Whether a way along the whole path was found, proved or not."""
        return self.chosen is not None and not self.trouble

    def explain(self) -> str:
        """The verdict, the tightest joint with its margin, and σ_min, each with its clock."""
        if self.trouble or self.chosen is None:
            return f"{self.trouble}."
        b = self.chosen
        follow = sum(follows(x.verdict) for x in self.branches)
        if len(self.branches) > 1:
            text = f"arm {self.arm}: {follow} of {len(self.branches)} branches follow the path"
            open_ = sum(x.verdict is PathVerdict.UNDECIDED for x in self.branches)
            text += f", {open_} {'is' if open_ == 1 else 'are'} not decided" if open_ else ""
        else:
            text = f"arm {self.arm} {'follows the path' if follow else 'may not follow the path'}"
        i, m = int(b.sigma_min.argmin()), int(b.manipulability.argmin())
        text += (
            f"; least margin {self._margin(b)}; σ_min {b.sigma_min[i]:.3g} ({b.clocks[i]:.2f} s); "
            f"manipulability {b.manipulability[m]:.3g} ({b.clocks[m]:.2f} s)."
        )
        if b.why:
            text += f" It {b.why}."
        return text

    def _margin(self, branch: BranchCheck) -> str:
        j = branch.tightest
        if not np.isfinite(branch.margins[j]):
            return "none: its joints have no limits"
        size = amount(branch.margins[j], slides=self.slides[j])
        return f"{size} at {self.joints[j]} ({branch.margin_clocks[j]:.2f} s)"

    def table(self) -> list[list[str]]:
        """The branches as rows of text: verdict, least margin with joint and clock, σ_min, and what is against it."""
        rows = [["branch", "verdict", "least margin", "σ_min", "because it"]]
        for i, b in enumerate(self.branches):
            mark = f"{i + 1}*" if b is self.chosen else f"{i + 1}"
            rows.append([mark, b.verdict.value.lower(), self._margin(b), f"{b.sigma_min.min():.3g}", b.why])
        return rows


def arm_record(arm: ArmCheck) -> dict[str, Any]:
    """Plain data for JSON."""
    return {
        "name": arm.arm,
        "verdict": arm.verdict.value,
        "reason": arm.trouble,
        "joints": list(arm.joints),
        "chosen": None if arm.chosen is None else arm.branches.index(arm.chosen),
        "branches": [_branch_record(branch) for branch in arm.branches],
    }


def _branch_record(branch: BranchCheck) -> dict[str, Any]:
    i, m = int(branch.sigma_min.argmin()), int(branch.manipulability.argmin())
    return {
        "verdict": branch.verdict.value,
        "reason": branch.why,
        "until_s": branch.until,
        "q": branch.q[0].tolist(),
        "margins": [x if np.isfinite(x) else None for x in branch.margins.tolist()],
        "margin_clocks_s": branch.margin_clocks.tolist(),
        "sigma_min": float(branch.sigma_min[i]),
        "sigma_min_clock_s": float(branch.clocks[i]),
        "sigma_min_bound": branch.sigma_bound or None,
        "manipulability": float(branch.manipulability[m]),
        "manipulability_clock_s": float(branch.clocks[m]),
        "certified_s": branch.certified.tolist(),
        "undecided_s": branch.undecided.tolist(),
    }
