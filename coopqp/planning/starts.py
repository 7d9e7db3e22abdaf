"""A start for every arm: the branch, the whole turns and the roll of the tool that stay inside limits along a path.

With the object's path given, each arm follows its own tool's path, so each arm is searched by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_count, as_floats, as_scalar
from coopqp.constraints.samples import PathSamples, sample_path
from coopqp.errors import InvalidInputError, NoStartError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import amount
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import newton
from coopqp.paths.moving_grasps import HOLD_ON, refuse_motion, refuse_ways
from coopqp.paths.path import ObjectPath
from coopqp.paths.segments import segments_of
from coopqp.planning.arm_starts import ArmOnPath, BranchAlongPath, arm_on_path, rolled, trouble
from coopqp.planning.on_shared import OnShared, group_joints
from coopqp.planning.shared_starts import group_on_path
from coopqp.shown import Brief
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Rolls of the tool that are tried for a remedy [deg], the most usual first.
_ROLLS = ((180.0,), (90.0, -90.0), (45.0, -45.0, 135.0, -135.0), tuple(np.arange(-165.0, 180.0, 30.0)))
_MOST_ALTERNATIVES = 8
#: Most branches of each arm that are tried where arms have to keep clear of each other.
_MOST_OPTIONS = 24


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ArmStart(Brief):
    """The start of one arm.

    Attributes:
        arm: its name.
        joints: names of the joints that move its tool, n of them.
        slides: True for prismatic joints.
        chosen: the branch at which it starts.
        branches: all branches at the start of the path, the best first; those of redundant arms are samples.
    """

    arm: str
    joints: tuple[str, ...]
    slides: tuple[bool, ...]
    chosen: BranchAlongPath
    branches: tuple[BranchAlongPath, ...]

    @property
    def tightest_joint(self) -> str:
        """The joint with the least margin along the path."""
        return self.joints[self.chosen.tightest]

    @property
    def margin(self) -> float:
        """Margin of that joint [rad or m]."""
        return float(self.chosen.margins.min())

    @property
    def clock(self) -> float:
        """Clock of that margin [s]."""
        return float(self.chosen.clocks[self.chosen.tightest])


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Start(Brief):
    """A configuration from which all arms follow a path inside their limits.

    Attributes:
        q: the configuration (nq,).
        grasp: the grasp, with rolled tools where allowed.
        arms: result for each arm.
        clocks: clocks of the samples (K,) [s].
        margins: least margin of each joint along the path (nv,) [rad or m]; inf without limits.
        sigma_min: smallest singular value of each arm's tool Jacobian along the path (K, N).
        alternatives: other starts with the same grasp, one arm changed in each, the best first.
        clear: whether all margins are kept at samples of the path; None without a scene.
    """

    q: Array
    grasp: Grasp
    arms: tuple[ArmStart, ...]
    clocks: Array
    margins: Array
    sigma_min: Array
    alternatives: tuple[Array, ...]
    clear: bool | None = None

    def explain(self) -> str:
        """A line per arm: the tightest joint with its margin, σ_min, and the number of branches."""
        lines = []
        for a in self.arms:
            feasible = sum(b.feasible for b in a.branches)
            roll = f", tool rolled by {np.rad2deg(a.chosen.roll):.0f}°" if a.chosen.roll else ""
            margin = "none: its joints have no limits"
            if np.isfinite(a.margin):
                size = amount(a.margin, slides=a.slides[a.chosen.tightest])
                margin = f"{size} at {a.tightest_joint} ({a.clock:.2f} s)"
            lines.append(
                f"arm {a.arm}: {feasible} of {len(a.branches)} branches follow the path{roll}; least margin {margin}; "
                f"σ_min {a.chosen.sigma_min.min():.3f}"
            )
        if self.clear is False:
            lines.append("no start was found that keeps all margins along the path")
        return "\n".join(lines)


def check_scene(cell: RobotCell, scene: CollisionScene | None, where: str) -> None:
    """Refuse a scene of other arms.

    Raises:
        InvalidInputError: it is of another cell, or is no scene.
    """
    if scene is None:
        return
    if not callable(getattr(scene, "along", None)):
        raise InvalidInputError(f"a {type(scene).__name__}", where, "Give a CollisionScene.")
    if scene.cell is not cell:
        raise InvalidInputError("a scene of another cell", where, "Give the cell that the scene was made of.")


def find_start(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    *,
    free_roll: Mapping[str, Sequence[float]] | None = None,
    q_near: ArrayLike | None = None,
    scene: CollisionScene | None = None,
    seed_factor: int = 1,
) -> Start:
    """Find a start configuration from which every arm follows the whole path inside its limits.

    All branches of each arm at the start of the path are found and walked along the path; the one with the largest
    margins and singular values is taken. A path without an end, or not known ahead, is checked by its start alone.

    Args:
        cell, grasp, path: the arms, their grasps and the object's path.
        free_roll: angles [rad] by which an arm's tool may be turned about its own z axis, by the arm's name; 0 is
            always allowed. The grasp in the answer has the turned tools.
        q_near: further seed (nq,); positions of joints that do not move a tool are taken from it.
        scene: the bodies that keep distances, a :class:`coopqp.CollisionScene` of the same cell: a start is
            preferred from which all margins are kept along the path. Not together with ``free_roll``.
        seed_factor: multiplies the number of seeds.

    Raises:
        NoStartError: an arm has none. The message names the arm, the joint, by how much, and a remedy.
        InvalidInputError: bad arguments.
        UnknownNameError: no such arm.
    """
    grasp.check_arms(cell)
    seed_factor = as_count(seed_factor, "find_start: seed_factor")
    check_scene(cell, scene, "find_start: scene")
    if scene is not None and free_roll:
        raise InvalidInputError("free_roll and a scene", "find_start", "A scene is of one grasp: give one of both.")
    if cell.groups:
        refuse_motion(path, "find_start: path", HOLD_ON)
    refuse_ways(path, "find_start: path", "Give the start: where the way begins decides its branch.")
    rolls = _checked_rolls(cell, free_roll or {})
    samples = sample_path(path, grasp)
    near = None if q_near is None else cell.positions(cell.check_configuration(q_near, "find_start: q_near"))
    found: list[tuple[ArmOnPath, BranchAlongPath]] = []
    troubles: list[tuple[str, str]] = []
    grouped = _of_groups(cell, grasp, path, samples)
    for k, arm in enumerate(cell.arms):
        kinematics = ArmKinematics(arm)
        if k in grouped:
            rows = grouped[k]
            if rows is None or not rows.feasible:
                troubles.append((arm.name, _NO_WAY.format(arm=arm.name)))
            else:
                found.append((rows, rows.branches[0]))
            continue
        own = samples.of_arm(k)
        seeds = np.empty((0, kinematics.n)) if near is None else near[None, cell.columns[k][kinematics.columns]]
        tries = [
            arm_on_path(kinematics, own, grasp.T_object_tool[k], roll=roll, seed_factor=seed_factor, near=seeds)
            for roll in rolls[k]
        ]
        best = max(tries, key=lambda t: t.feasible[0].score if t.feasible else -np.inf)
        if best.feasible:
            found.append((best, best.feasible[0]))
        else:
            remedy = _remedy(kinematics, own, grasp.T_object_tool[k], rolls[k])
            troubles.append((arm.name, f"{trouble(tries[0])}; {remedy}"))
    if troubles:
        raise NoStartError(tuple(name for name, _ in troubles), ". ".join(text for _, text in troubles) + ".")
    clear = None
    if scene is not None and not cell.groups:
        options = [[row.q for row in arm.feasible[:_MOST_OPTIONS]] for arm, _ in found]
        choice = clear_rows(cell, grasp, samples, options, scene)
        clear = choice is not None
        if choice is not None:
            found = [(arm, arm.feasible[i]) for (arm, _), i in zip(found, choice, strict=True)]
    return replace(_put_together(cell, grasp, samples, found, near), clear=clear)


#: Why arms that share joints have no start, and what helps.
_NO_WAY = (
    "arm {arm} has no start from which all arms that share joints with it follow the path; move the robot or the path, "
    "or hold the object elsewhere"
)


def _of_groups(cell: RobotCell, grasp: Grasp, path: ObjectPath, samples: PathSamples) -> dict[int, ArmOnPath | None]:
    """Branches of arms that share joints, by their indices, the chosen one first; None where there is no way."""
    out: dict[int, ArmOnPath | None] = {}
    segments = segments_of(path)
    for group in cell.groups:
        joints = group_joints(cell, group)
        arms = [OnShared(cell.arms[k], cell.columns[k], joints) for k in group]
        found = group_on_path(cell, arms, group, samples, segments, [grasp.T_object_tool[k] for k in group])
        out |= dict.fromkeys(group) if found is None else dict(zip(group, found.arms, strict=True))
    return out


def clear_rows(
    cell: RobotCell, grasp: Grasp, samples: PathSamples, options: Sequence[Sequence[Array]], scene: CollisionScene
) -> tuple[int, ...] | None:
    """Index of one start (n,) per arm, so that all margins are kept; None if there are none. The best come first."""
    if not all(map(len, options)):
        return None
    trajectories = []
    for k, (arm, own, X, starts) in enumerate(zip(cell.arms, cell.columns, grasp.T_object_tool, options, strict=True)):
        kinematics = ArmKinematics(arm)
        walks = kinematics.walk(samples.of_arm(k).tool_poses(X), np.array(starts).reshape(-1, kinematics.n))
        rest = np.clip(np.zeros(len(own)), cell.limits.lower[own], cell.limits.upper[own])
        trajectory = np.tile(rest, (*walks.q.shape[:2], 1))
        trajectory[:, :, kinematics.columns] = walks.q
        trajectories.append(trajectory)
    return scene.clear_choice(trajectories)


def _put_together(
    cell: RobotCell,
    grasp: Grasp,
    samples: PathSamples,
    found: list[tuple[ArmOnPath, BranchAlongPath]],
    near: Array | None,
) -> Start:
    """The start of the whole cell."""
    x = np.clip(np.zeros(cell.nv), cell.limits.lower, cell.limits.upper) if near is None else near.copy()
    columns = [own[arm.kinematics.columns] for own, (arm, _) in zip(cell.columns, found, strict=True)]
    margins = np.minimum(x - cell.limits.lower, cell.limits.upper - x)
    tools = []
    for own, X, (_, row) in zip(columns, grasp.T_object_tool, found, strict=True):
        x[own], margins[own] = row.q, row.margins
        tools.append(rolled(X, row.roll))
    held = Grasp(tuple(tools))
    chain = Chain(cell, held)
    others = [(row.score, k, row) for k, (arm, best) in enumerate(found) for row in arm.feasible if row is not best]
    others.sort(key=lambda other: -other[0])
    alternatives = []
    for _, k, row in others[:_MOST_ALTERNATIVES]:
        changed = x.copy()
        changed[columns[k]] = row.q
        alternatives.append(exact_start(chain, samples.poses[0], changed))
    return Start(
        q=exact_start(chain, samples.poses[0], x),
        grasp=held if any(row.roll for _, row in found) else grasp,
        arms=tuple(
            ArmStart(
                arm=name,
                joints=arm.kinematics.joints,
                slides=tuple(arm.kinematics.slides.tolist()),
                chosen=row,
                branches=arm.branches,
            )
            for name, (arm, row) in zip(cell.arm_names, found, strict=True)
        ),
        clocks=samples.clocks,
        margins=margins,
        sigma_min=np.column_stack([row.sigma_min for _, row in found]),
        alternatives=tuple(alternatives),
    )


def exact_start(chain: Chain, T_world_object: pin.SE3, positions: Array) -> Array:
    """The configuration (nq,) at joint positions (nv,), with the last errors of the grasps removed."""
    return newton(chain, T_world_object, chain.cell.configuration(positions), tolerance=1e-13, max_iter=3)[0]


def _checked_rolls(cell: RobotCell, free_roll: Mapping[str, Sequence[float]]) -> list[tuple[float, ...]]:
    """Rolls of each arm's tool [rad], 0 first."""
    rolls: list[tuple[float, ...]] = [(0.0,)] * len(cell)
    for name, angles in free_roll.items():
        where = f"find_start: free_roll['{name}']"
        try:
            numbers = np.atleast_1d(as_floats(angles))
        except NOT_NUMBERS as error:
            raise InvalidInputError("not a list of angles", where, "Give angles [rad].") from error
        checked = [as_scalar(a, where, low=-2.0 * np.pi, high=2.0 * np.pi, open_low=False) for a in numbers.ravel()]
        rolls[cell.index(name)] = (0.0, *(a for a in checked if a))
    return rolls


def _remedy(kinematics: ArmKinematics, samples: PathSamples, X: pin.SE3, tried: tuple[float, ...]) -> str:
    """Remedy for an arm without a start."""
    nowhere = np.empty((0, kinematics.n))

    def look(roll: float) -> ArmOnPath:
        return arm_on_path(kinematics, samples, X, roll=roll, near=nowhere, quick=True)

    for angles in _ROLLS:
        tries = [
            (on_path.feasible[0].score, angle)
            for angle in angles
            if np.deg2rad(angle) not in tried and (on_path := look(float(np.deg2rad(angle)))).feasible
        ]
        if tries:
            return f"roll its tool by {max(tries)[1]:.0f}°"
    return "move its base or the path, or hold the object elsewhere"
