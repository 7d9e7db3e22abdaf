"""Can the arms follow a path? The verdict before the motion, per arm and for the whole cell.

With the object's path given, each arm follows its own tool's path, so each arm is judged by itself. The verdict is
about the way, not about the speed: a joint that is too slow slows the object, it does not stop it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_count
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import amount
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.planning.arm_starts import ArmOnPath, BranchAlongPath, arm_on_path, trouble
from coopqp.planning.branch_checks import (
    BranchCheck,
    PathVerdict,
    ToolPath,
    check_branches,
    not_disproved,
    tool_path,
    worst,
)
from coopqp.planning.samples import PathSamples, sample_path
from coopqp.planning.segments import segments_of
from coopqp.planning.starts import exact_start
from coopqp.spatial import Array
from coopqp.task.guarded import GuardedPath
from coopqp.task.path import ObjectPath

if TYPE_CHECKING:
    from coopqp.planning.remedies import Remedy

#: Of a redundant arm's branches, which are samples of its self-motion, so many are judged at most.
_MOST_REDUNDANT = 8
#: A start whose tools are further from their places is refused [m, rad].
_OFF_M, _OFF_RAD = 1e-3, np.deg2rad(0.5)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmCheck:
    """What was found for one arm.

    Attributes:
        arm: its name.
        joints: names of the joints that move its tool, n of them.
        slides: True for prismatic joints (n,).
        chosen: the branch that is judged; None if the arm does not reach its grasp at the start of the path.
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

    def explain(self) -> str:
        """The verdict, the tightest joint with its margin, and σ_min, each with its clock."""
        if self.trouble or self.chosen is None:
            return f"{self.trouble}."
        b = self.chosen
        follow = sum(x.verdict in (PathVerdict.CERTIFIED, PathVerdict.SAMPLED) for x in self.branches)
        if len(self.branches) > 1:
            said = f"arm {self.arm}: {follow} of {len(self.branches)} branches follow the path"
        else:
            said = f"arm {self.arm} {'follows the path' if follow else 'may not follow the path'}"
        i, m = int(b.sigma_min.argmin()), int(b.manipulability.argmin())
        said += (
            f"; least margin {self._margin(b)}; σ_min {b.sigma_min[i]:.3g} ({b.clocks[i]:.2f} s); "
            f"manipulability {b.manipulability[m]:.3g} ({b.clocks[m]:.2f} s)."
        )
        if b.why:
            said += f" It {b.why}."
        return said

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


@dataclass(frozen=True, kw_only=True, eq=False)
class PathCheck:
    """The answer of :func:`check_path`.

    Attributes:
        verdict: the worst verdict of the arms.
        intervals: intervals that are not decided, in the order of the arms.
        arms: what was found for each arm.
        q_start: the start that is judged (nq,); None if an arm has none.
        cell, grasp, path: what was asked.
        given: True if the start was given.
        remedies: what helps, each checked; see :func:`find_remedies`.
        no_remedy: kinds of remedies that were tried in vain, and what stood in the way.
    """

    verdict: PathVerdict
    intervals: tuple[UndecidedInterval, ...]
    arms: tuple[ArmCheck, ...]
    q_start: Array | None
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    given: bool = False
    remedies: tuple[Remedy, ...] = ()
    no_remedy: tuple[str, ...] = ()

    @property
    def feasible(self) -> bool:
        """True if the arms follow the path: CERTIFIED or SAMPLED."""
        return self.verdict in (PathVerdict.CERTIFIED, PathVerdict.SAMPLED)

    def explain(self) -> str:
        """The verdict and a line per arm, in sentences; then the remedies."""
        head = {
            PathVerdict.CERTIFIED: "The arms can follow the whole path: this is proved at every point of it.",
            PathVerdict.SAMPLED: "The arms follow the path at samples; between them nothing is proved.",
            PathVerdict.UNDECIDED: f"It is not decided whether the arms can follow the path: {self._undecided()}.",
            PathVerdict.INFEASIBLE: "The arms cannot follow the path"
            + (" from this start." if self.given else ", from any start."),
        }[self.verdict]
        lines = [head, *(arm.explain() for arm in self.arms)]
        if any(len(arm.joints) > 6 and arm.verdict is PathVerdict.CERTIFIED for arm in self.arms):
            lines.append(
                "For arms with more than six joints the proof holds for one motion of their elbows; a controller may "
                "move them otherwise."
            )
        lines += [f"remedy: {remedy}." for remedy in self.remedies]
        if not self.remedies:
            lines += [f"no remedy by {why}." for why in self.no_remedy]
        return "\n".join(lines)

    def _undecided(self) -> str:
        first = [f"{i.start:.4g}–{i.end:.4g} s for arm {i.arm}" for i in self.intervals[:3]]
        more = len(self.intervals) - len(first)
        return ", ".join(first) + (f" and {more} more" if more > 0 else "")

    def __repr__(self) -> str:
        arms = ", ".join(f"{arm.arm}: {arm.verdict.value.lower()}" for arm in self.arms)
        return f"PathCheck({self.verdict.value.lower()}; {arms})"

    def record(self) -> dict[str, Any]:
        """Plain data for JSON: ``verdict``, ``intervals``, ``arms``, ``remedies``, ``no_remedy``, ``q_start``."""
        return {
            "verdict": self.verdict.value,
            "intervals": [{"arm": i.arm, "start_s": i.start, "end_s": i.end} for i in self.intervals],
            "arms": [_arm_record(arm) for arm in self.arms],
            "remedies": [remedy.record() for remedy in self.remedies],
            "no_remedy": list(self.no_remedy),
            "q_start": None if self.q_start is None else self.q_start.tolist(),
        }


def check_path(
    cell: RobotCell, grasp: Grasp, path: ObjectPath, *, q_start: ArrayLike | None = None, effort: int = 1
) -> PathCheck:
    """Can the arms follow a path inside their position limits and away from singularities?

    The library's own paths are proved between samples, too (:mod:`coopqp.planning.certificate`). Other paths, arms with
    fewer than six joints and the remaining branches of redundant arms are sampled. Collisions play no part in it.

    Args:
        cell, grasp, path: the arms, how they hold, and where to.
        q_start: the start (nq,): only its branches are judged. By default every branch of each arm is judged, as in
            :func:`find_start`, and the best one is chosen.
        effort: multiplies the number of seeds of the search for branches.

    Raises:
        InvalidInputError: bad arguments, or a start that does not hold the object at the start of the path.
    """
    grasp.check_arms(cell)
    effort = as_count(effort, "check_path: effort")
    GuardedPath(path).check("check_path: path")
    samples, segments = sample_path(path, grasp), segments_of(path)
    start = None if q_start is None else cell.check_configuration(q_start, "check_path: q_start")
    arms: list[ArmCheck] = []
    for k, (arm, X) in enumerate(zip(cell.arms, grasp.T_object_tool, strict=True)):
        kinematics, tool = ArmKinematics(arm), tool_path(segments, samples, X)
        if start is None:
            arms.append(_every_branch(kinematics, samples, X, tool, effort))
        else:
            positions = cell.positions(start)[cell.v_slices[k]][kinematics.columns]
            arms.append(_given_branch(kinematics, tool, positions))
    if start is None and all(arm.chosen is not None for arm in arms):
        start = _joined(cell, grasp, samples.poses[0], arms)
    verdict = worst([arm.verdict for arm in arms])
    return PathCheck(
        verdict=verdict,
        intervals=tuple(
            UndecidedInterval(arm=arm.arm, start=float(a), end=float(b))
            for arm in arms
            if arm.chosen is not None and arm.verdict is PathVerdict.UNDECIDED
            for a, b in arm.chosen.undecided
        ),
        arms=tuple(arms),
        q_start=None if q_start is None and verdict is PathVerdict.INFEASIBLE else start,
        cell=cell,
        grasp=grasp,
        path=path,
        given=q_start is not None,
    )


def _every_branch(kinematics: ArmKinematics, samples: PathSamples, X: pin.SE3, tool: ToolPath, effort: int) -> ArmCheck:
    """Judge all branches of an arm, or the best ones of a redundant arm."""
    found = arm_on_path(kinematics, samples, X, near=np.empty((0, kinematics.n)), effort=effort)
    rows: Sequence[BranchAlongPath] = found.branches
    if kinematics.n > 6:
        rows = sorted(rows, key=lambda row: (not row.feasible, -row.reached, -row.score))[:_MOST_REDUNDANT]
    branches = check_branches(kinematics, tool, np.array([row.q for row in rows]).reshape(-1, kinematics.n))
    if not any(branch.verdict is PathVerdict.CERTIFIED for branch in branches):
        branches = not_disproved(kinematics, tool, branches)
    ranks = list(PathVerdict)
    branches.sort(key=lambda branch: ranks.index(branch.verdict))  # within a verdict they keep their order
    chosen = branches[0] if branches else None
    return _arm_check(kinematics, chosen, branches, found)


def _given_branch(kinematics: ArmKinematics, tool: ToolPath, positions: Array) -> ArmCheck:
    """Judge the branch that begins at ``positions``."""
    exact = kinematics.solve(tool.poses[:1], positions[None], tolerance=1e-11, steps=8)
    T = kinematics.tool_poses(positions[None])[0]
    away = pin.log6(pin.SE3(T).actInv(pin.SE3(tool.poses[0]))).vector
    off_m, off_rad = float(np.linalg.norm(away[:3])), float(np.linalg.norm(away[3:]))
    if off_m > _OFF_M or off_rad > _OFF_RAD or not exact.reached[0]:
        raise InvalidInputError(
            f"arm '{kinematics.arm.name}' is {1e3 * off_m:.1f} mm and {np.rad2deg(off_rad):.2f}° away from its grasp "
            "at the start of the path",
            "check_path: q_start",
            "Give a start that holds the object there (inverse_kinematics), or none.",
        )
    branches = not_disproved(kinematics, tool, check_branches(kinematics, tool, exact.q))
    return _arm_check(kinematics, branches[0], branches, None)


def _arm_check(
    kinematics: ArmKinematics, chosen: BranchCheck | None, branches: list[BranchCheck], found: ArmOnPath | None
) -> ArmCheck:
    name = kinematics.arm.name
    said = ""
    if chosen is None:
        assert found is not None
        said = trouble(found)
    elif chosen.verdict is PathVerdict.INFEASIBLE:
        best = max(branches, key=lambda branch: (branch.until, float(branch.margins.min())))
        said = f"arm {name} {best.why}"
        if len(branches) > 1:
            said += f" (the best of its {len(branches)} branches)"
        chosen = best
    return ArmCheck(
        arm=name,
        joints=kinematics.joints,
        slides=tuple(bool(x) for x in kinematics.slides),
        chosen=chosen,
        branches=tuple(branches),
        trouble=said,
    )


def _joined(cell: RobotCell, grasp: Grasp, T_world_object: pin.SE3, arms: list[ArmCheck]) -> Array:
    """The configuration at which each arm is at the start of its chosen branch."""
    x = np.clip(np.zeros(cell.nv), cell.limits.lower, cell.limits.upper)
    for own, arm, check in zip(cell.v_slices, cell.arms, arms, strict=True):
        assert check.chosen is not None
        x[own.start + ArmKinematics(arm).columns] = check.chosen.q[0]
    return exact_start(Chain(cell, grasp), T_world_object, x)


def _arm_record(arm: ArmCheck) -> dict[str, Any]:
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
