"""Can the arms follow a path? The verdict before the motion, per arm and for the whole cell.

With the object's path given, each arm follows its own tool's path, so each arm is checked by itself; only distances
between bodies concern all arms. The verdict is about the trajectory, not about the speed: a joint that is too
slow slows the object, it does not stop it.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_count
from coopqp.collision.clearance_check import ClearanceCheck as ClearanceCheck
from coopqp.constraints.samples import PathSamples, sample_path
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.paths.certificate import PathVerdict, follows, worst
from coopqp.paths.elbows import Elbows
from coopqp.paths.geometry import PathGeometry
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.joint_trajectories import CellTrajectory, HeldTrajectory
from coopqp.paths.moving_grasps import HOLD_ON, refuse_motion, refuse_ways
from coopqp.paths.path import ObjectPath
from coopqp.paths.segments import Segments, segments_of
from coopqp.paths.timed import TimedPath
from coopqp.planning.arm_check import ArmCheck, UndecidedInterval, arm_record
from coopqp.planning.arm_starts import ArmOnPath, BranchAlongPath, arm_on_path, trouble
from coopqp.planning.branch_checks import (
    BranchCheck,
    ToolPath,
    check_branches,
    check_trajectory,
    not_disproved,
    path_at,
    tool_path,
)
from coopqp.planning.joint_way_check import check_with_ways, ways_of
from coopqp.planning.moving_trajectory import MovingTrajectory
from coopqp.planning.phase_checks import PhaseCheck, explained, phase_checks
from coopqp.planning.shared_check import check_group, stands_at
from coopqp.planning.shared_way import SharedWay
from coopqp.planning.starts import check_scene, clear_rows, exact_start
from coopqp.planning.tools_on_object import tool_on_object, tools_move, why_no_scene
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Most branches of a redundant arm that are checked; they are samples of its self-motion.
_MOST_REDUNDANT = 8
#: A knot within this share of a piece from its end is at the end.
_AT_MARK = 1e-9
#: A start whose tools are further from their places is refused [m, rad].
_OFF_M, _OFF_RAD = 1e-3, np.deg2rad(0.5)


Kind = Literal["branch", "roll", "shift", "base"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Remedy:
    """A change with which the arms follow the path; checked.

    Attributes:
        kind: ``"branch"`` (another start), ``"roll"`` (of tools about their z axes), ``"shift"`` (of the path) or
            ``"base"`` (of bases).
        text: the change, in words.
        check: the check of the changed task: its ``cell``, ``grasp``, ``path`` and ``q_start`` hold the remedy.
        shift: displacement of the path, or of each base (N, 3), in the world [m]; None for other kinds.
        roll: roll of each tool (N,) [rad]; None for other kinds.
    """

    kind: Kind
    text: str
    check: PathCheck
    shift: Array | None = None
    roll: Array | None = None

    def __str__(self) -> str:
        return f"{self.text} ({self.check.verdict.value.lower()})"

    def record(self) -> dict[str, Any]:
        """The remedy as plain data for JSON."""
        return {
            "kind": self.kind,
            "text": self.text,
            "verdict": self.check.verdict.value,
            "shift_m": None if self.shift is None else self.shift.tolist(),
            "roll_rad": None if self.roll is None else self.roll.tolist(),
            "q_start": None if self.check.q_start is None else self.check.q_start.tolist(),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class PathCheck:
    """The answer of :func:`check_path`.

    Attributes:
        verdict: the worst verdict of the arms and of their distances.
        intervals: intervals on which an arm is not decided, in the order of the arms.
        arms: result for each arm.
        q_start: the start that is checked (nq,); None if an arm has none.
        cell, grasp, path: the task.
        given: True if the start was given.
        clearance: result for distances; None without a scene, or if an arm cannot follow the path.
        scene: the bodies that keep distances; None if they play no part.
        remedies: changes that help, each checked; see :func:`find_remedies`.
        no_remedy: kinds of remedies that failed, and why.
        shared: per group of arms that share joints, where these are along the path.
        tools: the segments of each tool's path where tools move on the object; None where only samples are known.
    """

    verdict: PathVerdict
    intervals: tuple[UndecidedInterval, ...]
    arms: tuple[ArmCheck, ...]
    q_start: Array | None
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    given: bool = False
    clearance: ClearanceCheck | None = None
    scene: CollisionScene | None = None
    remedies: tuple[Remedy, ...] = ()
    no_remedy: tuple[str, ...] = ()
    shared: tuple[SharedWay, ...] = ()
    tools: tuple[Segments | None, ...] = ()

    @property
    def feasible(self) -> bool:
        """True if the arms follow the path and keep their distances: CERTIFIED or SAMPLED."""
        return follows(self.verdict)

    def led_path(self) -> ObjectPath:
        """The path with the motion of the elbows that is proved: a controller leads redundant arms along it.

        From :attr:`q_start`, and clear of the bodies that were checked. Without bodies the motion is smoothed over
        4 % of the duration, which saves time and keeps inside the limits. The path itself where nothing is proved,
        or where no arm has more than six joints.
        """
        trajectory = self.proved_trajectory()
        if trajectory is None or not any(len(arm.joints) > 6 for arm in self.arms):
            return self.path
        clocks, first = np.unique(trajectory.clocks(trajectory.places), return_index=True)
        if len(clocks) < 2:
            return self.path
        path = copy.copy(self.path)
        elbows = Elbows.through(clocks, trajectory.positions(trajectory.places[first])[0])
        path.elbows = elbows.smoothed() if self.clearance is None else elbows
        path.keeps_clear = path.keeps_clear or self.clearance is not None
        return path

    def on(self, path: ObjectPath) -> PathCheck:
        """The same answer for the same path, with more on it."""
        return replace(self, path=path)

    def proved_trajectory(self) -> CellTrajectory | None:
        """The motion of all joints that is proved, over the places of the path; None where nothing is."""
        if self.verdict is not PathVerdict.CERTIFIED or self.q_start is None:
            return None
        trajectories = [arm.chosen.trajectory for arm in self.arms if arm.chosen is not None]
        rest = self.cell.positions(self.q_start)
        if tools_move(self.path):
            motion = self.path.grasps
            if any(tool is None for tool in self.tools) or motion is None or motion.leads:
                return None
            return MovingTrajectory(self.cell, self.path, trajectories, self.tools, rest)
        segments = segments_of(self.path)
        return None if segments is None else HeldTrajectory(self.cell, self.path, segments, trajectories, rest)

    def explain(self) -> str:
        """The verdict, a line per arm and one for distances, in sentences; then the remedies."""
        has_scene = self.clearance is not None and self.clearance.pair is not None
        how = " and keep their distances" if has_scene else ""
        head = {
            PathVerdict.CERTIFIED: f"The arms can follow the whole path{how}: this is proved at every point of it.",
            PathVerdict.SAMPLED: f"The arms follow the path{how} at samples; between them nothing is proved.",
            PathVerdict.UNDECIDED: f"It is not decided whether the arms can follow the path{how}: {self._undecided()}.",
            PathVerdict.INFEASIBLE: f"The arms cannot follow the path{how}"
            + (" from this start." if self.given else ", from any start."),
        }[self.verdict]
        lines = [head, *(arm.explain() for arm in self.arms), *explained(self.phases)]
        lines += [f"joints that arms share: {stands_at(self.cell, way)}." for way in self.shared]
        if self.clearance is not None:
            lines.append(self.clearance.explain())
        elif self.scene is not None:
            lines.append("distances: not looked at, since an arm cannot follow the path.")
        if any(len(arm.joints) > 6 and arm.verdict is PathVerdict.CERTIFIED for arm in self.arms):
            lines.append(
                "For arms with more than six joints the proof holds for one motion of their elbows, "
                "which coopqp run follows."
            )
        lines += self.cell.notes()
        lines += [f"remedy: {remedy}." for remedy in self.remedies]
        if not self.remedies:
            lines += [f"no remedy by {why}." for why in self.no_remedy]
        return "\n".join(lines)

    @property
    def phases(self) -> tuple[PhaseCheck, ...]:
        """The verdict on each phase of a program; none for other paths."""
        return phase_checks(self.path, self.arms, self.clearance)

    def _undecided(self) -> str:
        every = [f"{i.start:.4g}–{i.end:.4g} s for arm {i.arm}" for i in self.intervals]
        if self.clearance is not None and self.clearance.verdict is PathVerdict.UNDECIDED:
            every += [f"{a:.4g}–{b:.4g} s for distances" for a, b in self.clearance.undecided]
        first = every[:3]
        more = len(every) - len(first)
        return ", ".join(first) + (f" and {more} more" if more > 0 else "")

    def __repr__(self) -> str:
        arms = ", ".join(f"{arm.arm}: {arm.verdict.value.lower()}" for arm in self.arms)
        return f"PathCheck({self.verdict.value.lower()}; {arms})"

    def record(self) -> dict[str, Any]:
        """Plain data for JSON: ``verdict``, ``intervals``, ``arms``, ``clearance``, ``remedies``, …"""
        return {
            "verdict": self.verdict.value,
            "intervals": [{"arm": i.arm, "start_s": i.start, "end_s": i.end} for i in self.intervals],
            "arms": [arm_record(arm) for arm in self.arms],
            **({"phases": [phase.record() for phase in self.phases]} if self.phases else {}),
            "clearance": None if self.clearance is None else self.clearance.record(),
            "remedies": [remedy.record() for remedy in self.remedies],
            "no_remedy": list(self.no_remedy),
            "q_start": None if self.q_start is None else self.q_start.tolist(),
        }


def check_path(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    *,
    q_start: ArrayLike | None = None,
    scene: CollisionScene | None = None,
    seed_factor: int = 1,
) -> PathCheck:
    """Can the arms follow a path inside their position limits, away from singularities, and without touching?

    The library's own paths are proved between samples, too (:mod:`coopqp.paths.certificate`,
    :mod:`coopqp.collision.path_check`). Other paths, arms with fewer than six joints and the remaining branches of
    redundant arms are sampled.

    Args:
        cell, grasp, path: the arms, their grasps and the object's path.
        q_start: the start (nq,): only its branches are checked. By default every branch of each arm is checked, as in
            :func:`find_start`, and the best one is chosen.
        scene: the bodies that keep distances, a :class:`coopqp.CollisionScene` of the same cell; without it
            distances play no part. Without a start branches are chosen that keep clear.
        seed_factor: multiplies the number of seeds of the search for branches.

    Raises:
        InvalidInputError: bad arguments, or a start that does not hold the object at the start of the path.
    """
    grasp.check_arms(cell)
    seed_factor = as_count(seed_factor, "check_path: seed_factor")
    check_scene(cell, scene, "check_path: scene")
    GuardedPath(path).check("check_path: path")
    moves = tools_move(path)
    if scene is not None and (why := why_no_scene(cell, path)):
        raise InvalidInputError(
            why,
            "check_path: scene",
            "Let the first arm of the cell hold the object at rest on it, or check the path without a scene.",
        )
    if cell.groups:
        refuse_motion(path, "check_path: path", HOLD_ON)
    if q_start is None:
        refuse_ways(path, "check_path: q_start", "Give the start: where the way begins decides its branch.")
    samples, segments = sample_path(path, grasp), segments_of(path)
    start = None if q_start is None else cell.check_configuration(q_start, "check_path: q_start")
    arms: list[ArmCheck] = []
    tools: list[Segments | None] = []
    grouped, shared = _groups(cell, grasp, samples, segments, start)
    for k, (arm, X) in enumerate(zip(cell.arms, grasp.T_object_tool, strict=True)):
        kinematics, own = ArmKinematics(arm), samples.of_arm(k)
        tool = tool_on_object(path, own, k, X) if moves else tool_path(segments, own, X)
        tools.append(tool.segments)
        if k in grouped:
            arms.append(grouped[k])
        elif ways_of(path, k):
            assert start is not None
            positions = cell.positions(start)[cell.columns[k][kinematics.columns]]
            if ways_of(path, k)[0].start > 0.0:
                positions = _exact_at_start(kinematics, tool, positions)[0]
            branch = check_with_ways(kinematics, path, own, k, X, positions)
            arms.append(_arm_check(kinematics, branch, [branch], None))
        elif start is None:
            arms.append(_every_branch(kinematics, own, X, tool, seed_factor))
        else:
            positions = cell.positions(start)[cell.columns[k][kinematics.columns]]
            arms.append(_given_branch(kinematics, tool, positions))
    if start is None and all(arm.chosen is not None for arm in arms):
        if scene is not None and not cell.groups and not moves:
            arms = _clear(cell, grasp, samples, arms, scene)
        start = _joined(cell, grasp, samples.poses[0], arms)
    verdict, clearance = worst([arm.verdict for arm in arms]), None
    if scene is not None and moves and start is not None and verdict is not PathVerdict.INFEASIBLE:
        clearance = _distances_of_tools(cell, path, arms, tools, scene, cell.positions(start))
        verdict = worst([verdict, clearance.verdict])
    elif scene is not None and start is not None and verdict is not PathVerdict.INFEASIBLE:
        arms, clearance = _distances(
            cell, grasp, path, samples, segments, arms, scene, cell.positions(start), any_start=q_start is None
        )
    found = _result(cell, grasp, path, arms, start, clearance, scene, given=q_start is not None)
    return replace(found, shared=shared, tools=tuple(tools) if moves else ())


def _distances_of_tools(
    cell: RobotCell,
    path: ObjectPath,
    arms: Sequence[ArmCheck],
    tools: Sequence[Segments | None],
    scene: CollisionScene,
    rest: Array,
) -> ClearanceCheck:
    """Distances where tools move on the object."""
    trajectories = [arm.chosen.trajectory for arm in arms if arm.chosen is not None]
    return scene.along(MovingTrajectory(cell, path, trajectories, tools, rest))


def _groups(
    cell: RobotCell, grasp: Grasp, samples: PathSamples, segments: Segments | None, start: Array | None
) -> tuple[dict[int, ArmCheck], tuple[SharedWay, ...]]:
    """The checks of arms that share joints, by their indices, and the ways of these joints."""
    grouped: dict[int, ArmCheck] = {}
    shared: list[SharedWay] = []
    positions = None if start is None else cell.positions(start)
    for group in cell.groups:
        if positions is not None:
            for k in group:
                kinematics = ArmKinematics(cell.arms[k])
                tool = tool_path(segments, samples, grasp.T_object_tool[k])
                _exact_at_start(kinematics, tool, positions[cell.columns[k][kinematics.columns]])
        arms, branches, way = check_group(cell, grasp, samples, segments, group, positions)
        if way is not None:
            shared.append(way)
        for k, arm, own in zip(group, arms, branches, strict=True):
            chosen = own[0] if own else None
            why = "" if own else f"arm {arm.whole.arm.name} has no way that suits all arms with which it shares joints"
            grouped[k] = _arm_check(arm.whole, chosen, own, None, why=why)
    return grouped, tuple(shared)


def check_motion(cell: RobotCell, grasp: Grasp, path: TimedPath, x: Array, scene: CollisionScene) -> PathCheck | None:
    """The verdict on one motion of all arms along a planned path, with the distances of a scene.

    :func:`check_path` chooses a motion of the elbows of redundant arms; this is for a given one. Distances are looked
    at where the arms' trajectories are proved.

    Args:
        cell, grasp, path: the arms, their grasps, and the path.
        x: joint positions (K, nv) at the knots of the path's profile [rad or m].
        scene: the bodies that keep distances.

    Returns:
        None where the path has pieces of which no proof is possible.
    """
    segments, samples = segments_of(path), sample_path(path, grasp)
    if segments is None:
        return None
    places = places_along(path.geometry(), path.profile.s)
    arms = []
    for own, arm, X in zip(cell.columns, cell.arms, grasp.T_object_tool, strict=True):
        kinematics = ArmKinematics(arm)
        tool = path_at(tool_path(segments, samples, X), places)
        branch = check_trajectory(kinematics, tool, x[:, own[kinematics.columns]])
        arms.append(_arm_check(kinematics, branch, [branch], None))
    clearance = None
    if worst([arm.verdict for arm in arms]) is PathVerdict.CERTIFIED:
        trajectories = [arm.chosen.trajectory for arm in arms if arm.chosen is not None]
        clearance = scene.along(HeldTrajectory(cell, path, segments, trajectories, x[0]))
    return _result(cell, grasp, path, arms, cell.configuration(x[0]), clearance, scene, given=True)


def places_along(geometry: PathGeometry, s: Array) -> Array:
    """Places (K,) of a planned path (:mod:`coopqp.paths.joint_trajectories`) at s (K,) along its geometry [m]."""
    marks = geometry.marks
    piece = np.clip(np.searchsorted(marks, s, side="right") - 1, 0, len(marks) - 2)
    places = piece + (s - marks[piece]) / np.diff(marks)[piece]
    whole = np.round(places)
    return np.where(np.abs(places - whole) < _AT_MARK, whole, places)


def _result(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    arms: list[ArmCheck],
    start: Array | None,
    clearance: ClearanceCheck | None,
    scene: CollisionScene | None,
    *,
    given: bool,
) -> PathCheck:
    """The answer, from the results of the arms and of their distances."""
    verdict = worst([arm.verdict for arm in arms] + ([clearance.verdict] if clearance is not None else []))
    return PathCheck(
        verdict=verdict,
        intervals=tuple(
            UndecidedInterval(arm=arm.arm, start=float(a), end=float(b))
            for arm in arms
            if arm.chosen is not None and arm.verdict is PathVerdict.UNDECIDED
            for a, b in arm.chosen.undecided
        ),
        arms=tuple(arms),
        q_start=None if not given and verdict is PathVerdict.INFEASIBLE else start,
        cell=cell,
        grasp=grasp,
        path=path,
        given=given,
        clearance=clearance,
        scene=scene,
    )


def _clear(
    cell: RobotCell, grasp: Grasp, samples: PathSamples, arms: list[ArmCheck], scene: CollisionScene
) -> list[ArmCheck]:
    """Results with the best branches that keep clear of each other, if any do."""
    options = [[b for b in arm.branches if b.verdict is not PathVerdict.INFEASIBLE] for arm in arms]
    choice = clear_rows(cell, grasp, samples, [[b.q[0] for b in own] for own in options], scene)
    if choice is None:
        return arms
    return [replace(arm, chosen=own[i]) for arm, own, i in zip(arms, options, choice, strict=True)]


def _distances(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    samples: PathSamples,
    segments: Segments | None,
    arms: list[ArmCheck],
    scene: CollisionScene,
    rest: Array,
    *,
    any_start: bool,
) -> tuple[list[ArmCheck], ClearanceCheck]:
    """Distances along the arms' trajectories, or along others that their self-motion allows; and the arms on them."""

    def trajectory_of(arms: list[ArmCheck]) -> CellTrajectory:
        return HeldTrajectory(
            cell, path, segments, [arm.chosen.trajectory for arm in arms if arm.chosen is not None], rest
        )

    trajectory = trajectory_of(arms)
    found = scene.along(trajectory, any_start=any_start)
    if found.verdict is not PathVerdict.UNDECIDED or segments is None or not trajectory.complete or cell.groups:
        return arms, found
    other = scene.evading(trajectory)
    if other is None:
        return arms, found
    places, x = other
    evading: list[ArmCheck] = []
    for arm, model, own, X in zip(arms, cell.arms, cell.columns, grasp.T_object_tool, strict=True):
        kinematics = ArmKinematics(model)
        if kinematics.n <= 6:
            evading.append(arm)
            continue
        tool = path_at(tool_path(segments, samples, X), places)
        branch = check_trajectory(kinematics, tool, x[:, own[kinematics.columns]])
        evading.append(
            replace(arm, chosen=branch, branches=tuple(branch if b is arm.chosen else b for b in arm.branches))
        )
    better = scene.along(trajectory_of(evading), any_start=any_start)
    kept = all(new.verdict is old.verdict for new, old in zip(evading, arms, strict=True))
    return (evading, better) if kept and worst([better.verdict, found.verdict]) is found.verdict else (arms, found)


def _every_branch(
    kinematics: ArmKinematics, samples: PathSamples, X: pin.SE3, tool: ToolPath, seed_factor: int
) -> ArmCheck:
    """Check all branches of an arm, or the best ones of a redundant arm."""
    found = arm_on_path(kinematics, samples, X, near=np.empty((0, kinematics.n)), seed_factor=seed_factor)
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
    """Check the branch that begins at ``positions``."""
    starts = _exact_at_start(kinematics, tool, positions)
    branches = not_disproved(kinematics, tool, check_branches(kinematics, tool, starts))
    return _arm_check(kinematics, branches[0], branches, None)


def _exact_at_start(kinematics: ArmKinematics, tool: ToolPath, positions: Array) -> Array:
    """Exact joint positions (1, n) at the start of the path.

    Raises:
        InvalidInputError: they are not near it.
    """
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
    return exact.q


def _arm_check(
    kinematics: ArmKinematics,
    chosen: BranchCheck | None,
    branches: list[BranchCheck],
    found: ArmOnPath | None,
    *,
    why: str = "",
) -> ArmCheck:
    name = kinematics.arm.name
    reason = why
    if chosen is None and not why:
        assert found is not None
        reason = trouble(found)
    elif chosen is not None and chosen.verdict is PathVerdict.INFEASIBLE:
        best = max(branches, key=lambda branch: (branch.until, float(branch.margins.min())))
        reason = f"arm {name} {best.why}"
        if len(branches) > 1:
            reason += f" (the best of its {len(branches)} branches)"
        chosen = best
    return ArmCheck(
        arm=name,
        joints=kinematics.joints,
        slides=tuple(bool(x) for x in kinematics.slides),
        chosen=chosen,
        branches=tuple(branches),
        trouble=reason,
    )


def _joined(cell: RobotCell, grasp: Grasp, T_world_object: pin.SE3, arms: list[ArmCheck]) -> Array:
    """The configuration at which each arm is at the start of its chosen branch."""
    x = np.clip(np.zeros(cell.nv), cell.limits.lower, cell.limits.upper)
    for own, arm, check in zip(cell.columns, cell.arms, arms, strict=True):
        assert check.chosen is not None
        x[own[ArmKinematics(arm).columns]] = check.chosen.q[0]
    return exact_start(Chain(cell, grasp), T_world_object, x)
