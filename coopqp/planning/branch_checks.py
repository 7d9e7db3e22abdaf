"""The verdict on one branch of an arm: proved along the path, sampled, undecided on intervals, or infeasible."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.constraints.samples import PathSamples
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import AT_LIMIT, amount, find_branches
from coopqp.paths.certificate import LEAST_SIGMA, PathVerdict as PathVerdict, exactness, prove
from coopqp.paths.joint_trajectories import ArmTrajectory
from coopqp.paths.segments import Indices, Segments
from coopqp.planning.arm_starts import away_from_limits, why_it_ends
from coopqp.shown import Brief
from coopqp.spatial import Array

#: Knots: largest motion of a tool between them [m, rad], and least number of pieces of a segment.
_DISTANCE, _ANGLE, _PIECES = 0.03, 0.1, 4
#: A branch continues past its end if a solution there is within this distance in every joint [rad or m].
_BEYOND = 0.6
#: A redundant arm that comes closer to a limit than this is led away from it by steps of these lengths [rad or m].
#: Longest step of its joints between knots [rad or m].
_LED, _LEADS, _STRIDE = 0.35, (0.06, 0.03, 0.015), 0.5
#: Poses at which a configuration of a redundant arm inside its limits is searched.
_ASKED = 8


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BranchCheck(Brief):
    """One branch of an arm along a path.

    Attributes:
        verdict: the verdict on this branch.
        why: reason against a better verdict; empty if it is certified.
        until: last clock until which the arm follows the path inside its limits [s]; 0 if not even at the start.
        clocks: clocks of the samples (K,) [s], as far as the branch goes.
        q: joint positions there (K, n) [rad or m]; the first row is the start.
        sigma_min: smallest singular value of the tool's Jacobian there (K,), in metres and radians.
        manipulability: √det(J Jᵀ) there (K,), the product of its singular values.
        margins: least margin of each joint (n,) [rad or m], negative outside, inf without limits: a lower bound of the
            whole path if certified, else the least of the samples.
        margin_clocks: clock at which each joint has its least margin (n,) [s].
        certified: intervals [a, b] of the clock that are proved (C, 2) [s].
        undecided: intervals [a, b] that are not decided (U, 2) [s].
        sigma_bound: lower bound of σ_min over the intervals that are proved; 0 without a proof.
        trajectory: joint motion along the path, also between the samples.
    """

    verdict: PathVerdict
    why: str
    until: float
    clocks: Array
    q: Array
    sigma_min: Array
    manipulability: Array
    margins: Array
    margin_clocks: Array
    certified: Array
    undecided: Array
    sigma_bound: float
    trajectory: ArmTrajectory

    @property
    def tightest(self) -> int:
        """Index of the joint with the least margin."""
        return int(self.margins.argmin())


@dataclass(frozen=True, eq=False)
class ToolPath:
    """The path of one tool at knots.

    Attributes:
        clocks, poses: clocks (K,) [s] and T_world_tool (K, 4, 4) of the knots.
        offset: T_object_tool (4, 4).
        segments, segment, share: the path and the place of each knot on it (K,); None if only samples are known.
        end: duration of the path [s]; 0 if it is checked by its start alone.
    """

    clocks: Array
    poses: Array
    offset: Array
    segments: Segments | None
    segment: Indices
    share: Array
    end: float

    @property
    def places(self) -> Array:
        """Places of the knots (K,); see :mod:`coopqp.paths.joint_trajectories`."""
        return self.clocks if self.segments is None else self.segment + self.share


def tool_path(segments: Segments | None, samples: PathSamples, T_object_tool: pin.SE3) -> ToolPath:
    """The path of a tool: at knots of the segments, or at the samples."""
    offset = np.array(T_object_tool.homogeneous)
    if segments is None:
        nothing = np.zeros(0, dtype=np.intp)
        return ToolPath(
            samples.clocks, samples.tool_poses(T_object_tool), offset, None, nothing, np.zeros(0), samples.clocks[-1]
        )
    segment, share = segments.knots(T_object_tool, distance=_DISTANCE, angle=_ANGLE, pieces=_PIECES)
    clocks = segments.clocks(segment, share)
    return ToolPath(clocks, segments.poses(segment, share) @ offset, offset, segments, segment, share, clocks[-1])


def path_at(tool: ToolPath, places: Array) -> ToolPath:
    """The path of a tool at other knots, places (K,) that contain the ends of its segments."""
    assert tool.segments is not None
    last = len(tool.segments) - 1
    segment = np.clip(np.ceil(places).astype(np.intp) - 1, 0, last)  # an end belongs to the segment before it
    share = places - segment
    poses = tool.segments.poses(segment, share) @ tool.offset
    return replace(tool, clocks=tool.segments.clocks(segment, share), poses=poses, segment=segment, share=share)


def check_branches(kinematics: ArmKinematics, path: ToolPath, starts: Array) -> list[BranchCheck]:
    """Verdicts on the branches that begin at ``starts`` (B, n), which reach the first pose of the path.

    Args:
        kinematics: the arm.
        path: the path of its tool.
        starts: joint positions [rad or m], at their whole turns.
    """
    if not len(starts):
        return []
    exact = exactness(path.poses)
    first = kinematics.solve(path.poses[:1], starts, tolerance=exact, steps=8).q
    walks = kinematics.walk(path.poses, first, tolerance=exact)
    trajectories = [walks.q[m, : int(walks.reached[m]) + 1] for m in range(len(starts))]
    if kinematics.n > 6:
        trajectories = [led_inside(kinematics, path, trajectory, exact) for trajectory in trajectories]
    return [check_trajectory(kinematics, path, trajectory) for trajectory in trajectories]


def not_disproved(kinematics: ArmKinematics, path: ToolPath, branches: list[BranchCheck]) -> list[BranchCheck]:
    """Make branches of a redundant arm undecided if they leave the limits or end: another elbow motion may not.

    They stay infeasible if they start outside, or if the arm has no configuration inside its limits at some pose.
    """
    lost = [b for b in branches if b.verdict is PathVerdict.INFEASIBLE]
    started = [b for b in lost if kinematics.margins(b.q[0]).min() >= -AT_LIMIT]
    if kinematics.n <= 6 or not started or path.end == 0.0:
        return branches
    ahead = np.flatnonzero(path.clocks > max(b.until for b in started))
    for k in ahead[np.unique(np.linspace(0, len(ahead) - 1, _ASKED).astype(int))] if len(ahead) else []:
        if not find_branches(kinematics, pin.SE3(path.poses[k])).inside.any():
            why = f"; at {path.clocks[k]:.2f} s no configuration inside its limits reaches the pose"
            return [replace(b, why=b.why + why) if b in started else b for b in branches]
    return [
        replace(
            b,
            verdict=PathVerdict.UNDECIDED,
            why=f"{b.why}; another motion of its elbow was not found, but is not excluded",
            undecided=np.array([[b.until, path.end]]),
        )
        if b in started
        else b
        for b in branches
    ]


def led_inside(kinematics: ArmKinematics, path: ToolPath, trajectory: Array, exact: float) -> Array:
    """The trajectory of a redundant arm (K, n); if it leaves the limits or ends, one that keeps away from them."""
    if len(trajectory) == len(path.poses) and kinematics.margins(trajectory).min() >= -AT_LIMIT:
        return trajectory
    if kinematics.margins(trajectory[0]).min() < -AT_LIMIT:
        return trajectory
    q = [trajectory[0]]
    for T in path.poses[1:]:
        answer = kinematics.solve(T[None], q[-1][None], tolerance=exact, steps=12, longest=_STRIDE)
        if answer.residual[0] > exact or np.abs(answer.q[0] - q[-1]).max() > _STRIDE:
            break
        x = answer.q
        for length in _LEADS:
            if kinematics.margins(x).min() < _LED:
                x = away_from_limits(kinematics, T, x, length)
        exactly = kinematics.solve(T[None], x, tolerance=exact, steps=6).q[0]
        q.append(exactly)
        if kinematics.margins(exactly).min() < -AT_LIMIT:
            break
    return np.array(q) if len(q) >= len(trajectory) or len(q) == len(path.poses) else trajectory


def check_trajectory(kinematics: ArmKinematics, path: ToolPath, q: Array) -> BranchCheck:
    """The verdict on one branch that is at ``q`` (K, n) at the first K knots."""
    clocks, complete = path.clocks[: len(q)], len(q) == len(path.clocks)
    nothing = np.empty((0, 2))
    certified, undecided, bounds, sigma_bound = nothing, nothing, None, 0.0
    sure, lost = np.ones(len(q), dtype=bool), np.empty(0)
    outside = kinematics.margins(q).min(axis=1) < -AT_LIMIT
    m = int(outside.argmax()) if outside.any() else len(q)  # knots until the first one outside
    trajectory = ArmTrajectory.sampled(kinematics, path.offset, path.places[: len(q)], q)
    if path.segments is not None and kinematics.n >= 6 and m > 1:
        found = prove(kinematics, path.segments, path.offset, path.segment[:m], path.share[:m], q[:m])
        trajectory = ArmTrajectory.proved(kinematics, path.offset, found)
        shares = np.concatenate([found.low, found.high, 0.5 * (found.low + found.high)])
        low, high, middle = np.split(path.segments.clocks(np.tile(found.segment, 3), shares), 3)
        certified, undecided = (_merged(low[k], high[k]) for k in (found.proved, ~found.proved))
        lost = low[~found.on_branch]  # from here on it may be another branch
        clocks = np.concatenate([clocks, middle[found.between]])
        order = np.argsort(clocks, kind="stable")
        clocks, q = clocks[order], np.concatenate([q, found.q[found.between]])[order]
        sure = np.concatenate([sure, found.on_branch[found.between]])[order]
        if found.proved.all() and complete and m == len(path.clocks):
            bounds, sigma_bound = found.margins, float(found.sigma_min.min())
    margins = kinematics.margins(q)
    values = kinematics.singular_values(q)
    least, where = margins.min(axis=0), clocks[margins.argmin(axis=0)]
    if bounds is not None:
        least = np.minimum(bounds.min(axis=0), least)
    verdict, why, until = PathVerdict.CERTIFIED, "", float(clocks[-1])
    if margins[sure].min(initial=np.inf) < -AT_LIMIT:
        why, until = _exit(kinematics, clocks[sure], margins[sure])
        if (lost < until).any():
            verdict, why = (
                PathVerdict.UNDECIDED,
                f"{_doubt(undecided, least, values[:, -1], kinematics)}; beyond it {why}",
            )
            undecided = _merged(*np.vstack([undecided, [[until, path.end]]]).T)
        else:
            verdict, undecided = PathVerdict.INFEASIBLE, nothing
    elif not complete:
        verdict, why, undecided = _ended(kinematics, path, q[-1], until, undecided)
    elif len(undecided):
        verdict, why = PathVerdict.UNDECIDED, _doubt(undecided, least, values[:, -1], kinematics)
    elif bounds is None:
        verdict, why = PathVerdict.SAMPLED, _not_proved(kinematics, path)
        weak = values[:, -1] < LEAST_SIGMA
        if weak.any():
            undecided = _merged(*_neighbours(clocks, weak))
            verdict, why = PathVerdict.UNDECIDED, _doubt(undecided, least, values[:, -1], kinematics)
    return BranchCheck(
        verdict=verdict,
        why=why,
        until=until,
        clocks=clocks,
        q=q,
        sigma_min=values[:, -1],
        manipulability=values.prod(axis=1),
        margins=least,
        margin_clocks=where,
        certified=certified,
        undecided=undecided,
        sigma_bound=sigma_bound,
        trajectory=trajectory,
    )


def _exit(kinematics: ArmKinematics, clocks: Array, margins: Array) -> tuple[str, float]:
    """Which joint leaves its limits first, and at which clock."""
    k = int((margins < -AT_LIMIT).any(axis=1).argmax())
    j = int(margins[k].argmin())
    worst_at = int(margins[:, j].argmin())
    far, joint = amount(-margins[worst_at, j], slides=bool(kinematics.slides[j])), kinematics.joints[j]
    if k == 0:
        return f"starts {amount(-margins[0, j], slides=bool(kinematics.slides[j]))} outside {joint}", 0.0
    share = margins[k - 1, j] / (margins[k - 1, j] - margins[k, j])
    at = float(clocks[k - 1] + share * (clocks[k] - clocks[k - 1]))
    return f"leaves the limits of {joint} at {at:.2f} s (it would be {far} outside at {clocks[worst_at]:.2f} s)", at


def _ended(
    kinematics: ArmKinematics, path: ToolPath, q: Array, clock: float, undecided: Array
) -> tuple[PathVerdict, str, Array]:
    """Verdict on a branch that ends at ``q`` at ``clock``: it ends there, or continues beyond a singularity."""
    ahead = path.poses[path.clocks > clock][:2]
    beyond = kinematics.solve(ahead, np.tile(q, (len(ahead), 1)))
    if (beyond.reached & (np.abs(beyond.q - q).max(axis=1) <= _BEYOND)).any():
        rest = np.vstack([undecided, [[clock, path.end]]])
        return (
            PathVerdict.UNDECIDED,
            f"passes through a singularity after {clock:.2f} s",
            _merged(rest[:, 0], rest[:, 1]),
        )
    end = why_it_ends(kinematics, q, path.poses[path.clocks <= clock][-1], ahead[0])
    why = f"follows the path until {clock:.2f} s, {end}"
    return PathVerdict.INFEASIBLE, why, undecided[:0]


def _doubt(undecided: Array, least: Array, sigma: Array, kinematics: ArmKinematics) -> str:
    a, b = undecided[0]
    more = f" and on {len(undecided) - 1} more intervals" if len(undecided) > 1 else ""
    j = int(least.argmin())
    if sigma.min() < 10.0 * LEAST_SIGMA:
        reason = f"it is nearly singular there (σ_min {sigma.min():.1g})"
    elif least[j] < np.deg2rad(1.0):
        reason = f"{kinematics.joints[j]} is close to its limit there"
    else:
        reason = "its joints turn too fast there for the proof"
    return f"is not decided on {a:.4g}–{b:.4g} s{more}: {reason}"


def _not_proved(kinematics: ArmKinematics, path: ToolPath) -> str:
    """Why there are samples only."""
    if path.end == 0.0:
        return "is judged at its start alone: the path has no end, or is not known ahead"
    if kinematics.n < 6:
        return f"is followed at samples: the proof needs six joints, and it has {kinematics.n}"
    if path.segments is None:
        return "is followed at samples: the proof knows lines, rounded corners, and pieces that tell their bounds"
    return "is followed at samples"


def _merged(low: Array, high: Array) -> Array:
    """Intervals in order, touching ones merged (I, 2)."""
    out: list[list[float]] = []
    for a, b in sorted(zip(low.tolist(), high.tolist(), strict=True)):
        if out and a <= out[-1][1] + 1e-12:
            out[-1][1] = max(out[-1][1], b)
        else:
            out.append([a, b])
    return np.array(out).reshape(-1, 2)


def _neighbours(clocks: Array, at: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
    """Intervals from the sample before to the sample after each of some samples."""
    i = np.flatnonzero(at)
    return clocks[np.maximum(i - 1, 0)], clocks[np.minimum(i + 1, len(clocks) - 1)]
