"""A first cell for arms that nobody has placed yet: where their bases may stand, and how their tools hold the object.

Each arm is sampled once, with its tool pointing down. A sample says where the base has to stand for the tool to be at
its grasp in the middle of the path, and the arm is walked along the path from there. The arms share the height of the
object only, so N arms are N small searches; :class:`coopqp.studies.placing.Placer` then checks the best ones together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.errors import NoStartError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import Arm, RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.shapes import Body, Box
from coopqp.model.tool_guess import axis_out
from coopqp.paths.path import LinePath
from coopqp.spatial import Array
from coopqp.studies.placed import CellPlaced, Goals
from coopqp.studies.placing import Placer

#: Samples of an arm, and how far from straight down their tools may point before they are turned down [rad].
_SAMPLES, _TILT = 6000, math.radians(45.0)
#: Step of lengths [m], of turns [deg], how near to a height a sample has to be, and the highest that is tried [m].
_STEP, _TURN, _NEAR, _HIGHEST = 0.05, 5.0, 0.03, 2.5
#: Candidates of an arm that are walked at a height, heights that are tried, and cells that are checked at each.
_CANDIDATES, _HEIGHTS, _CELLS = 24, 4, 24
#: Poses of the walk, odd.
_POSES = 21
#: Share of a half side of the object, and length [m], that its grasps stay away from the edge.
_INSET_SHARE, _INSET = 0.25, 0.05
#: Rotation vectors [roll, pitch in degrees] that turn an axis of the tool down.
_DOWN = {
    (0.0, 0.0, 1.0): (180.0, 0.0), (0.0, 0.0, -1.0): (0.0, 0.0), (1.0, 0.0, 0.0): (0.0, 90.0),
    (-1.0, 0.0, 0.0): (0.0, -90.0), (0.0, 1.0, 0.0): (-90.0, 0.0), (0.0, -1.0, 0.0): (90.0, 0.0),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What the object does: a straight line with a turn about the vertical.

    Attributes:
        size: the object's box (3,) [m].
        translation: displacement (3,) [m].
        turn_deg: turn about the vertical [deg].
        duration: duration [s].
    """

    size: tuple[float, float, float]
    translation: tuple[float, float, float]
    turn_deg: float
    duration: float

    def path(self, height: float) -> LinePath:
        """The path from a height of the object's centre [m], above the world's origin."""
        start = pin.SE3(np.eye(3), np.array([0.0, 0.0, height]))
        turn = (0.0, 0.0, math.radians(self.turn_deg))
        return LinePath.displaced(start, translation=self.translation, rotation=turn, duration=self.duration)


@dataclass(frozen=True, kw_only=True)
class ArmDraft:
    """One arm as drafted: round numbers.

    Attributes:
        base_xyz, base_yaw_deg: where its base stands [m], and how it is turned about the vertical.
        tool_xyz, tool_rpy_deg: where its tool is on the object [m, deg].
        score: the smaller of its least σ_min and margin along the path, each divided by a good value.
    """

    base_xyz: tuple[float, float, float]
    base_yaw_deg: float
    tool_xyz: tuple[float, float, float]
    tool_rpy_deg: tuple[float, float, float]
    score: float

    @property
    def base(self) -> pin.SE3:
        """T_world_base."""
        return _pose(self.base_xyz, (0.0, 0.0, self.base_yaw_deg))

    @property
    def tool(self) -> pin.SE3:
        """T_object_tool."""
        return _pose(self.tool_xyz, self.tool_rpy_deg)


@dataclass(frozen=True, kw_only=True, eq=False)
class Draft:
    """A cell as drafted.

    Attributes:
        height: height of the object's centre at the start [m].
        arms: its arms.
        placed: what :class:`Placer` found for it; ``placed.arms[k].q`` is a start.
    """

    height: float
    arms: tuple[ArmDraft, ...]
    placed: CellPlaced


def _pose(xyz: Sequence[float], rpy_deg: Sequence[float]) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(np.deg2rad(rpy_deg)), np.array(xyz))


def reach(arm: Arm) -> float:
    """Largest distance of the tool from the base among samples [m]."""
    kinematics = ArmKinematics(arm.placed(pin.SE3.Identity()))
    points = kinematics.tool_poses(_inside(kinematics, 2000))[:, :3, 3]
    return float(np.linalg.norm(points, axis=1).max())


def _inside(kinematics: ArmKinematics, count: int) -> Array:
    """Random positions (count, n) inside the limits, turning joints within half a turn."""
    low = np.where(kinematics.slides, kinematics.lower, np.maximum(kinematics.lower, -np.pi))
    high = np.where(kinematics.slides, kinematics.upper, np.minimum(kinematics.upper, np.pi))
    low, high = np.maximum(low, -10.0), np.minimum(high, 10.0)  # sliding joints without limits
    return np.random.default_rng(0).uniform(low, np.maximum(low, high), (count, kinematics.n))


def _ahead(kinematics: ArmKinematics, q: Array) -> Array:
    """The same positions (M, n), with the first joint turned so that the tool is ahead of the base where it may be."""
    if kinematics.slides[0]:
        return q
    points = kinematics.tool_poses(q)[:, :2, 3]
    turned = q.copy()
    turned[:, 0] -= np.arctan2(points[:, 1], points[:, 0])
    turned = kinematics.nearest_turns(turned)
    may = kinematics.margins(turned)[:, 0] > 0.0
    return np.where(may[:, None], turned, q)


def draft(arms: Sequence[Arm], motion: Motion, *, goals: Goals | None = None) -> Draft:
    """Bases, grasps and a height for arms that are to move an object together.

    The arms stand around the object, the first one at its −x side; their tools point down at its upper side.

    Args:
        arms: the arms, at any place.
        motion: what the object is and does.
        goals: thresholds of a good placement.

    Raises:
        NoStartError: no placement was found; the message names the arms that are short and the remedy.
    """
    goals = goals or Goals()
    searches = [
        _ArmSearch(arm, motion, goals, angle=math.pi * (1.0 - 2.0 * k / len(arms))) for k, arm in enumerate(arms)
    ]
    lowest = _STEP * math.ceil(0.5 * motion.size[2] / _STEP + 1.0)
    levels = [round(float(h), 3) for h in np.arange(lowest, _HIGHEST, _STEP)]
    heights = [h for h in levels if min(search.best(h) for search in searches) > 0.0]
    heights.sort(key=lambda h: min(search.best(h) for search in searches), reverse=True)
    closest: CellPlaced | None = None
    for height in heights[:_HEIGHTS]:
        options = [search.at(height) for search in searches]
        at = [0] * len(arms)
        for _ in range(_CELLS):
            chosen = tuple(own[i] for own, i in zip(options, at, strict=True))
            placed = _placed(arms, chosen, motion, height, goals)
            low = _below_floor(arms, placed)
            if placed.feasible and not low:
                return Draft(height=height, arms=chosen, placed=placed)
            closest = closest if closest is not None and closest.rank >= placed.rank else placed
            # The next candidate of an arm that is in the way, of that one which loses least.
            guilty = low or _guilty(placed)
            further = [k for k in guilty if at[k] + 1 < len(options[k])]
            if not further:
                break
            at[max(further, key=lambda k: options[k][at[k] + 1].score)] += 1
    remedy = "Give a smaller object or a shorter path (--object, --move), or place the arms by hand."
    if closest is not None:
        why = closest.why or "an elbow is below the floor"
        raise NoStartError(tuple(arm.name for arm in arms), f"no place was found for the bases: {why}. {remedy}")
    names = [arm.name for arm in arms]
    never = [name for name, search in zip(names, searches, strict=True) if not any(map(search.best, levels))]
    short = never or names
    raise NoStartError(tuple(short), f"no height of the object suits {' and '.join(short)}. {remedy}")


def _guilty(placed: CellPlaced) -> list[int]:
    """The arms because of which a placement is impossible: those that do not follow the path, else those too close."""
    if not placed.follows:
        return [k for k, arm in enumerate(placed.arms) if not arm.feasible]
    near = {body.partition("/")[0] for body in placed.near}
    return [k for k, arm in enumerate(placed.arms) if arm.arm in near]


def _placed(arms: Sequence[Arm], chosen: Sequence[ArmDraft], motion: Motion, height: float, goals: Goals) -> CellPlaced:
    """The arms where they were drafted, checked along the whole path and for contacts."""
    cell = RobotCell([arm.placed(own.base) for arm, own in zip(arms, chosen, strict=True)])
    grasp = Grasp(tuple(own.tool for own in chosen))
    scene = CollisionScene(cell=cell, grasp=grasp, carried=[Body("object", Box(motion.size), pin.SE3.Identity())])
    placer = Placer(cell, grasp, motion.path(height), goals=goals, scene=scene)
    return placer.cell_at([own.base for own in chosen], quick=False)


def _below_floor(arms: Sequence[Arm], placed: CellPlaced) -> list[int]:
    """The arms that have a joint below the floor at the start."""
    low = []
    for k, (arm, base, found) in enumerate(zip(arms, placed.bases, placed.arms, strict=True)):
        if not found.feasible:
            continue
        data = arm.model.createData()
        pin.forwardKinematics(arm.model, data, RobotCell([arm]).configuration(positions_of(arm, found.q)))
        if min(float((base * T).translation[2]) for T in list(data.oMi)[1:]) < -1e-6:
            low.append(k)
    return low


def positions_of(arm: Arm, q: Array) -> Array:
    """Positions of all joints of an arm (nv,) [rad or m] from those of the joints that move its tool."""
    x: Array = np.clip(np.zeros(arm.model.nv), arm.limits.lower, arm.limits.upper)
    x[ArmKinematics(arm).columns] = q
    return x


class _ArmSearch:
    """Candidates of one arm.

    Args:
        arm: the arm.
        motion: what the object does.
        goals: thresholds of a good placement.
        angle: where around the object it stands [rad].
    """

    def __init__(self, arm: Arm, motion: Motion, goals: Goals, *, angle: float) -> None:
        self._kinematics = kinematics = ArmKinematics(arm.placed(pin.SE3.Identity()))
        self._motion, self._angle = motion, angle
        self._units = np.where(kinematics.slides, 1e-3 * goals.margin_mm, np.deg2rad(goals.margin_deg))
        self._sigma = goals.sigma_min
        self._grasp = _grasp_point(motion.size, angle)
        self._roll_pitch = _DOWN[axis_out(arm)]
        self._down = pin.rpy.rpyToMatrix(np.deg2rad([*self._roll_pitch, 0.0]))
        self._q, self._poses, self._scores = self._samples()
        self._found: dict[float, tuple[ArmDraft, ...]] = {}

    def best(self, height: float) -> float:
        """Score of the best candidate at a height of the object [m]; 0 without."""
        found = self.at(height)
        return found[0].score if found else 0.0

    def at(self, height: float) -> tuple[ArmDraft, ...]:
        """Candidates at a height of the object [m] that follow the path, the best first."""
        if height not in self._found:
            path = self._motion.path(height)
            object_poses = [path.pose(float(t)) for t in np.linspace(0.0, path.duration, _POSES)]
            middle = object_poses[_POSES // 2].act(self._grasp)
            near = np.flatnonzero(np.abs(self._poses[:, 2, 3] - middle[2]) < _NEAR)
            near = near[np.argsort(-self._scores[near], kind="stable")[:_CANDIDATES]]
            made = [self._candidate(int(i), object_poses, middle) for i in near]
            kept = sorted((own for own in made if own is not None), key=lambda own: -own.score)
            self._found[height] = tuple(kept)
        return self._found[height]

    def _samples(self) -> tuple[Array, Array, Array]:
        """Positions (M, n), T_base_tool (M, 4, 4) and scores (M,) with the tool straight down."""
        kinematics = self._kinematics
        q = _ahead(kinematics, _inside(kinematics, _SAMPLES))
        T = kinematics.tool_poses(q)
        out = self._down.T @ np.array([0.0, 0.0, -1.0])
        keep = -(T[:, 2, :3] @ out) > math.cos(_TILT)
        q, T = q[keep], T[keep]
        if not len(q):
            return q, T, np.empty(0)
        M = T[:, :3, :3] @ self._down.T
        heading = np.arctan2(M[:, 1, 0], M[:, 0, 0])
        turned = np.array([pin.utils.rotate("z", float(angle)) for angle in heading]).reshape(-1, 3, 3)
        T[:, :3, :3] = turned @ self._down
        solved = kinematics.solve(T, q)
        inside = solved.reached & (solved.margins.min(axis=1) > 0.0)
        scores = np.minimum(solved.sigma_min / self._sigma, (solved.margins / self._units).min(axis=1))
        return solved.q[inside], T[inside], scores[inside]

    def _candidate(self, i: int, object_poses: Sequence[pin.SE3], middle: Array) -> ArmDraft | None:
        """The base for which sample ``i`` holds the object in the middle of its path; None if it does not follow."""
        T_base_tool = self._poses[i]
        p = T_base_tool[:2, 3]
        away = math.atan2(p[1], p[0]) if np.linalg.norm(p) > 1e-3 else 0.0
        yaw = _round(math.degrees(self._angle + math.pi - away), _TURN)
        turn = pin.utils.rotate("z", math.radians(yaw))
        x, y, _ = middle - turn @ T_base_tool[:3, 3]
        M = turn @ T_base_tool[:3, :3] @ self._down.T
        halfway = object_poses[len(object_poses) // 2].rotation
        heading = math.degrees(math.atan2(M[1, 0], M[0, 0]) - math.atan2(halfway[1, 0], halfway[0, 0]))
        own = ArmDraft(
            base_xyz=(_round(x, _STEP), _round(y, _STEP), 0.0),
            base_yaw_deg=_wrapped(yaw),
            tool_xyz=tuple(round(float(v), 4) for v in self._grasp),  # type: ignore[arg-type]
            tool_rpy_deg=(*self._roll_pitch, _wrapped(_round(heading, _TURN))),
            score=0.0,
        )
        T_base_world = own.base.inverse()
        poses = np.array([(T_base_world * T * own.tool).homogeneous for T in object_poses])
        kinematics, half = self._kinematics, len(poses) // 2
        q, residual = kinematics.newton(poses[half], self._q[i][None])
        if residual[0] > 1e-6:
            return None
        back = kinematics.walk(poses[half::-1], q)
        if not back.complete[0]:
            return None
        way = kinematics.walk(poses, back.q[:, -1])
        if not way.complete[0]:
            return None
        margin = float((kinematics.margins(way.q[0]) / self._units).min())
        score = min(float(way.sigma_min.min()) / self._sigma, margin)
        if score <= 0.0:
            return None
        return ArmDraft(
            base_xyz=own.base_xyz, base_yaw_deg=own.base_yaw_deg, tool_xyz=own.tool_xyz, tool_rpy_deg=own.tool_rpy_deg,
            score=score,
        )  # fmt: skip


def _grasp_point(size: Sequence[float], angle: float) -> Array:
    """Where a tool holds the object's box: on its upper side, near the edge toward the arm (3,) [m]."""
    direction = np.array([math.cos(angle), math.sin(angle)])
    half = 0.5 * np.array(size)
    to_edge = min(h / abs(d) for h, d in zip(half[:2], direction, strict=True) if abs(d) > 1e-9)
    inside = to_edge - min(_INSET, _INSET_SHARE * to_edge)
    return np.array([*(np.round(inside * direction, 4) + 0.0), half[2]])


def _round(value: float, step: float) -> float:
    return round(round(value / step) * step, 6) + 0.0


def _wrapped(degrees: float) -> float:
    """The same turn in (−180, 180]."""
    return 180.0 - (180.0 - degrees) % 360.0 + 0.0
