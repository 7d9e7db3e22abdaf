"""Where bases may stand: figures of each arm and of the cell at placements of the bases, given the object's path.

Given the path, each arm follows its own tool's path, so arms are checked apart: to move the path by D is to move each
base by −D. Only distances and the common time couple them. N bases are N small searches. The arms of a robot stand on
one base; those that share joints are checked together, along the best way of these joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.constraints.samples import PathSamples, sample_path
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.moving_grasps import refuse_motion
from coopqp.paths.path import ObjectPath
from coopqp.paths.scenario import Scenario
from coopqp.paths.segments import segments_of
from coopqp.planning.arm_starts import ArmOnPath, BranchAlongPath, arm_on_path, trouble
from coopqp.planning.on_shared import OnShared, group_joints
from coopqp.planning.shared_check import stands_at
from coopqp.planning.shared_starts import group_on_path
from coopqp.planning.shared_way import SharedWay, places_of
from coopqp.spatial import Array
from coopqp.studies.placed import ArmPlaced, CellPlaced, Goals

#: Distances of a remedy [m]: steps, and the longest.
_STEP, _FARTHEST = 0.02, 1.0
#: Bases of the arms of one robot that differ by no more than this are one [m, and rotation matrix entries].
_SAME = 1e-9


class _Placed(NamedTuple):
    """Arms that are checked together: what was found for each by its number, and the way of the joints they share."""

    arms: Mapping[int, ArmPlaced]
    way: SharedWay | None = None


@final
class Placer:
    """Checks placements of the bases of one task.

    Args:
        cell, grasp, path: the task.
        goals: thresholds of a good placement.
        scene: bodies whose distances count; None for none.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        *,
        goals: Goals | None = None,
        scene: CollisionScene | None = None,
    ) -> None:
        grasp.check_arms(cell)
        refuse_motion(path, "Placer: path", "Place the bases for each phase by itself.")
        self.cell, self.grasp, self.goals = cell, grasp, goals or Goals()
        self.samples, self._segments = sample_path(path, grasp), segments_of(path)
        if len(self.samples.clocks) < 2:
            raise InvalidInputError("the path is not known ahead", "Placer: path", "Give one with an end.")
        at_origin = [arm.placed(pin.SE3.Identity()) for arm in cell.arms]
        self.arms = [ArmKinematics(arm) for arm in at_origin]
        self._near = [np.empty((0, arm.n)) for arm in self.arms]
        self._on_shared = {
            k: OnShared(at_origin[k], cell.columns[k], group_joints(cell, group))
            for group in cell.groups
            for k in group
        }
        self._group = {k: group for group in cell.groups for k in group}
        self._found: dict[tuple[int, bytes], _Placed] = {}
        self._distances = None if scene is None or not scene.built.labels else _MovedDistances(scene)

    @staticmethod
    def of(scenario: Scenario, *, goals: Goals | None = None) -> Placer:
        """The placer of a scenario, with the distances of its arms, its object and its obstacles."""
        return Placer(
            scenario.cell, scenario.grasp, scenario.path, goals=goals, scene=CollisionScene.of(scenario)
        )  # fmt: skip

    def arm(self, k: int, base: pin.SE3, *, quick: bool = True) -> ArmPlaced:
        """Arm ``k`` with its base at ``base``, T_world_base. ``quick``: branches may be missing.

        Arms that share joints with it are on the same base.
        """
        return self._placed(k, base, quick=quick).arms[k]

    def _placed(self, k: int, base: pin.SE3, *, quick: bool) -> _Placed:
        """Arm ``k`` and those that share joints with it, with their base at ``base``."""
        group = self._group.get(k, (k,))
        key = group[0], np.round(base.homogeneous[:3], 9).tobytes() + bytes([quick])
        if key not in self._found:
            T_base_world = base.inverse()
            moved = PathSamples(self.samples.clocks, tuple(T_base_world * T for T in self.samples.poses))
            self._found[key] = (
                self._together(group, moved, quick=quick) if len(group) > 1 else self._alone(k, moved, quick=quick)
            )
        return self._found[key]

    def _alone(self, k: int, moved: PathSamples, *, quick: bool) -> _Placed:
        found = arm_on_path(self.arms[k], moved, self.grasp.T_object_tool[k], near=self._near[k], quick=quick)
        return _Placed({k: self._result(k, found, moved, None)})

    def _together(self, group: tuple[int, ...], moved: PathSamples, *, quick: bool) -> _Placed:
        arms, offsets = [self._on_shared[k] for k in group], [self.grasp.T_object_tool[k] for k in group]
        found = group_on_path(self.cell, arms, group, moved, self._segments, offsets, quick=quick)
        if found is None:
            return _Placed({k: self._nowhere(k) for k in group})
        made = zip(group, found.arms, strict=True)
        return _Placed({k: self._result(k, on_path, moved, found.way) for k, on_path in made}, found.way)

    def _nowhere(self, k: int) -> ArmPlaced:
        """The result for an arm that has no way with those that share joints with it."""
        names = self.cell.arm_names
        others = " and ".join(names[j] for j in self._group[k] if j != k)
        why = f"arm {names[k]} and {others}, which share joints, reach their grasps at the start of the path nowhere"
        return self._impossible(k, None, f"{why} together")

    def _impossible(self, k: int, best: BranchAlongPath | None, why: str) -> ArmPlaced:
        kinematics, end = self.arms[k], float(self.samples.clocks[-1])
        return ArmPlaced(
            arm=self.cell.arm_names[k],
            robot=self.cell.arms[k].robot,
            feasible=False,
            reach=best.reached / end if best is not None and best.inside else 0.0,
            sigma_min=0.0,
            margin=float("nan") if best is None else float(best.margins.min()),
            tightest="" if best is None else kinematics.joints[best.tightest],
            slides=best is not None and bool(kinematics.slides[best.tightest]),
            times=np.empty(0),
            q=np.empty(0) if best is None else best.q,
            shares=(0.0, 0.0),
            why=why,
        )

    def _result(self, k: int, found: ArmOnPath, moved: PathSamples, way: SharedWay | None) -> ArmPlaced:
        kinematics = found.kinematics
        if not found.feasible:
            best = max(found.branches, key=lambda row: (row.inside, row.reached, row.margins.min()), default=None)
            return self._impossible(k, best, trouble(found))
        row = max(found.feasible, key=lambda row: tuple(sorted(round(s, 6) for s in self._shares(kinematics, row))))
        q = self._along(k, moved.tool_poses(self.grasp.T_object_tool[k]), row.q, way)
        speed = kinematics.arm.limits.velocity[kinematics.columns]
        j = int(np.argmin(row.margins / self._units(kinematics)))
        return ArmPlaced(
            arm=self.cell.arm_names[k],
            robot=self.cell.arms[k].robot,
            feasible=True,
            reach=1.0,
            sigma_min=float(row.sigma_min.min()),
            margin=float(row.margins[j]),
            tightest=kinematics.joints[j],
            slides=bool(kinematics.slides[j]),
            times=(np.abs(np.diff(q, axis=0)) / speed).max(axis=1),
            q=row.q,
            shares=self._shares(kinematics, row),
            why="",
        )

    def _along(self, k: int, poses: Array, q: Array, way: SharedWay | None) -> Array:
        """Positions (K, n) of an arm at the origin along poses of its tool (K, 4, 4), from ``q`` (n,) on."""
        if way is None:
            return self.arms[k].trajectories(poses, q[None])[0][0]
        arm = self._on_shared[k]
        s = way.at(places_of(self.samples, self._segments))
        return arm.joined(s, arm.alone.trajectories(arm.seen(s, poses), q[None, arm.own])[0][0])

    def _units(self, kinematics: ArmKinematics) -> Array:
        """Margins that are good (n,) [rad or m]."""
        return np.where(kinematics.slides, 1e-3 * self.goals.margin_mm, np.deg2rad(self.goals.margin_deg))

    def _shares(self, kinematics: ArmKinematics, row: BranchAlongPath) -> tuple[float, float]:
        margin = float((row.margins / self._units(kinematics)).min())
        return float(row.sigma_min.min()) / self.goals.sigma_min, margin

    def cell_at(
        self, bases: Sequence[pin.SE3], *, values: Mapping[str, float] | None = None, quick: bool = True
    ) -> CellPlaced:
        """The cell with its bases at these places, T_world_base of each arm: one for all arms of a robot.

        Raises:
            InvalidInputError: the arms of a robot on several bases.
        """
        for first, *others in self.cell.bases:
            if any(np.abs(bases[k].homogeneous - bases[first].homogeneous).max() > _SAME for k in others):
                raise InvalidInputError(
                    f"the arms of robot '{self.cell.arms[first].robot}' on several bases",
                    "Placer: bases",
                    "Give all its arms the same: the base of a robot moves as a whole.",
                )
        found = [self._placed(k, base, quick=quick) for k, base in enumerate(bases)]
        arms = tuple(placed.arms[k] for k, placed in enumerate(found))
        ways = [placed.way for placed in found]
        clearance, near, near_s = float("nan"), ("", ""), float("nan")
        if self._distances is not None and all(arm.feasible for arm in arms):
            clearance, near, sample = self._distances.least(bases, self._way(bases, arms, ways))
            near_s = float(self.samples.clocks[sample])
        stand = [way for group in self.cell.groups if (way := ways[group[0]]) is not None]
        return CellPlaced(
            values=dict(values or {}),
            bases=tuple(bases),
            arms=arms,
            clearance=clearance,
            near=near,
            near_s=near_s,
            goals=self.goals,
            shared=tuple(stands_at(self.cell, way) for way in stand),
        )

    def _way(self, bases: Sequence[pin.SE3], arms: Sequence[ArmPlaced], ways: Sequence[SharedWay | None]) -> Array:
        """Joint positions of the cell along the path (K, nv)."""
        cell = self.cell
        rest = np.clip(np.zeros(cell.nv), cell.limits.lower, cell.limits.upper)
        x = np.tile(rest, (len(self.samples.clocks), 1))
        for k, (base, arm, way) in enumerate(zip(bases, arms, ways, strict=True)):
            poses = np.linalg.inv(base.homogeneous) @ self.samples.tool_poses(self.grasp.T_object_tool[k])
            x[:, cell.columns[k][self.arms[k].columns]] = self._along(k, poses, arm.q, way)
        return x

    def remedies(self, placed: CellPlaced) -> tuple[str, ...]:
        """Remedies for arms that do not follow the path from their places: the shortest way of each base, checked."""
        return tuple(
            self._remedy(stand, placed) for stand in self.cell.bases if not all(placed.arms[k].feasible for k in stand)
        )

    def _remedy(self, stand: tuple[int, ...], placed: CellPlaced) -> str:
        first, base = self.cell.arms[stand[0]], placed.bases[stand[0]]
        name = f"robot {first.robot}" if first.robot else first.name
        tools = [self.samples.tool_poses(self.grasp.T_object_tool[k])[:, :3, 3] for k in stand]
        held = np.concatenate(tools).mean(axis=0) - base.translation
        toward = np.array([held[0], held[1], 0.0])
        length = np.linalg.norm(toward)
        toward = toward / length if length > 1e-6 else base.rotation[:, 0]
        left, up = np.array([-toward[1], toward[0], 0.0]), np.array([0.0, 0.0, 1.0])
        ways = (
            ("more toward the object", toward), ("more away from the object", -toward), ("to the left of it", left),
            ("to the right of it", -left), ("up", up), ("down", -up),
        )  # fmt: skip

        def follow(there: pin.SE3, *, quick: bool) -> list[ArmPlaced]:
            """The arms with their base there; the last one is the first that does not follow the path."""
            made: list[ArmPlaced] = []
            for k in stand:
                made.append(self.arm(k, there, quick=quick))
                if not made[-1].feasible:
                    break
            return made

        for distance in np.arange(_STEP, _FARTHEST + 1e-9, _STEP):
            moved = [
                (follow(pin.SE3(base.rotation, base.translation + distance * d), quick=True), text) for text, d in ways
            ]
            good = [
                (tuple(sorted(share for arm in arms for share in arm.shares)), text, i)
                for i, (arms, text) in enumerate(moved)
                if arms[-1].feasible
            ]
            for _, text, i in sorted(good, key=lambda found: found[0], reverse=True):
                there = pin.SE3(base.rotation, base.translation + distance * ways[i][1])
                if follow(there, quick=False)[-1].feasible:
                    return f"{name} needs {100.0 * distance:.0f} cm {text}"
        return f"{name} follows the path from nowhere within {_FARTHEST:g} m"


@final
class _MovedDistances:
    """Distances of a scene whose bases move: the model and its shapes are moved, not built anew."""

    def __init__(self, scene: CollisionScene) -> None:
        self.cell, built = scene.cell, scene.built
        self.model, self.geometry = scene.cell.model.copy(), built.geometry.copy()
        self.data, self.placed = self.model.createData(), self.geometry.createData()
        self.labels = built.labels
        joints = list(self.model.joints)
        roots = [j for j in range(1, self.model.njoints) if self.model.parents[j] == 0]
        self.roots = [
            (j, scene.cell.arm_of_joint(joints[j].idx_v), self.model.jointPlacements[j].copy()) for j in roots
        ]
        # Links of a base are an arm's, or a robot's whose arms share joints.
        owners = {scene.cell.arms[group[0]].robot: group[0] for group in scene.cell.groups}
        owners |= {name: k for k, name in enumerate(scene.cell.arm_names)}
        shapes = list(self.geometry.geometryObjects)
        links = [self.model.frames[shape.parentFrame].name.partition("/")[0] for shape in shapes]
        self.shapes = [
            (i, owners[link], shape.placement.copy())
            for i, (link, shape) in enumerate(zip(links, shapes, strict=True))
            if shape.parentJoint == 0 and shape.parentFrame and link in owners  # else it stands in the world
        ]

    def least(self, bases: Sequence[pin.SE3], way: Array) -> tuple[float, tuple[str, str], int]:
        """Least distance [m] along a way (K, nv), between which bodies, and at which sample of the way."""
        moves = [base * arm.T_world_base.inverse() for base, arm in zip(bases, self.cell.arms, strict=True)]
        for joint, arm, placement in self.roots:
            self.model.jointPlacements[joint] = moves[arm] * placement
        for shape, arm, placement in self.shapes:
            self.geometry.geometryObjects[shape].placement = moves[arm] * placement
        least, pair, at = np.inf, 0, 0
        for sample, x in enumerate(way):
            q = self.cell.configuration(x)
            pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.placed, q)
            pin.computeDistances(self.geometry, self.placed)
            distances = [result.min_distance for result in self.placed.distanceResults]
            k = int(np.argmin(distances))
            if distances[k] < least:
                least, pair, at = float(distances[k]), k, sample
        return max(least, -1.0), self.labels[pair], at
