"""Where bases may stand: figures of each arm and of the cell at placements of the bases, given the object's path.

Given the path, each arm follows its own tool's path, so arms are checked apart: to move the path by D is to move each
base by −D. Only distances and the common time couple them. N bases are N small searches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, documented, keep_scalars
from coopqp.collision.scene import CollisionScene
from coopqp.constraints.samples import PathSamples, sample_path
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import amount
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.moving_grasps import refuse_motion
from coopqp.paths.path import ObjectPath
from coopqp.paths.scenario import Scenario
from coopqp.planning.arm_starts import ArmOnPath, BranchAlongPath, arm_on_path, trouble
from coopqp.spatial import Array

#: Distances of a remedy [m]: steps, and the longest.
_STEP, _FARTHEST = 0.02, 1.0


@documented
@dataclass(frozen=True, kw_only=True)
class Goals:
    """Thresholds of a good placement. A share is a figure divided by its threshold."""

    sigma_min: Annotated[float, Doc("smallest singular value of an arm's tool Jacobian")] = 0.2
    margin_deg: Annotated[float, Doc("distance of turning joints from their position limits [deg]")] = 60.0
    margin_mm: Annotated[float, Doc("distance of sliding joints from their position limits [mm]")] = 100.0
    clearance_mm: Annotated[float, Doc("distance of bodies; a placement with less is impossible [mm]")] = 10.0

    def __post_init__(self) -> None:
        keep_scalars(self, "sigma_min", "margin_deg", "margin_mm")
        keep_scalars(self, "clearance_mm", open_low=False, high=1e4)


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmPlaced:
    """One arm with its base at one place.

    Attributes:
        arm: its name.
        feasible: it follows the whole path inside its limits and away from singularities.
        reach: share of the path that it follows.
        sigma_min: smallest singular value of its tool's Jacobian along the path; 0 where it does not follow it.
        margin: least distance of a joint from its limits [rad or m], negative outside; NaN without any branch.
        tightest: that joint.
        slides: whether it slides.
        times: least time of each part of the path by the speed limits (K−1,) [s]; empty if not feasible.
        q: joint positions at the start (n,) [rad or m]; empty if there is no branch.
        shares: σ_min and margin divided by their thresholds; arms are compared by the smaller share, then by the other.
        why: why it does not follow the path; empty if it does.
    """

    arm: str
    feasible: bool
    reach: float
    sigma_min: float
    margin: float
    tightest: str
    slides: bool
    times: Array
    q: Array
    shares: tuple[float, ...]
    why: str

    @property
    def time_s(self) -> float:
        """Least time for the path by this arm's speed limits alone [s]; NaN if it cannot follow it."""
        return float(self.times.sum()) if self.feasible else float("nan")

    def explain(self) -> str:
        """One line."""
        if not self.feasible:
            return f"{self.why}."
        margin = amount(self.margin, slides=self.slides)
        return (
            f"arm {self.arm}: σ_min {self.sigma_min:.3f}, least margin {margin} at {self.tightest}, "
            f"by speed limits alone {self.time_s:.2f} s"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class CellPlaced:
    """A cell with its bases at one set of places.

    Attributes:
        values: the numbers that say where the bases stand.
        bases: T_world_base of each arm.
        arms: what was found for each arm.
        clearance: least distance of bodies along the path [m]; NaN without a scene, or if an arm does not follow.
        near: the bodies at this distance.
        near_s: the path's clock where they do [s].
        goals: thresholds of a good placement.
    """

    values: Mapping[str, float]
    bases: tuple[pin.SE3, ...]
    arms: tuple[ArmPlaced, ...]
    clearance: float
    near: tuple[str, str]
    near_s: float
    goals: Goals

    @property
    def follows(self) -> bool:
        """All arms follow the path; contacts do not count."""
        return all(arm.feasible for arm in self.arms)

    @property
    def touches(self) -> bool:
        """Bodies come too close."""
        return bool(1e3 * self.clearance < self.goals.clearance_mm)

    @property
    def feasible(self) -> bool:
        """All arms follow the path, and nothing comes too close."""
        return self.follows and not self.touches

    @property
    def score(self) -> float:
        """Least share of all arms; NaN where the placement is impossible."""
        return min(min(arm.shares) for arm in self.arms) if self.feasible else float("nan")

    @property
    def rank(self) -> tuple[float, ...]:
        """Order of placements, the largest is the best: the shares of all arms from the smallest on."""
        if not self.feasible:
            so_far = float(np.mean([arm.reach for arm in self.arms]))
            return (-2.0 + so_far if not self.follows else -1.0 + min(self.clearance, 0.0),)
        return tuple(round(share, 6) for share in sorted(share for arm in self.arms for share in arm.shares))

    @property
    def time_s(self) -> float:
        """Least time for the path by the speed limits of all arms [s]: at each part the slowest arm counts."""
        if not self.follows:
            return float("nan")
        return float(np.max([arm.times for arm in self.arms], axis=0).sum())

    @property
    def why(self) -> str:
        """Why the placement is impossible: the arms that do not follow the path, the worst first; else the bodies."""
        lost = sorted((arm for arm in self.arms if not arm.feasible), key=lambda arm: arm.reach)
        if lost or not self.touches:
            return "; ".join(arm.why for arm in lost)
        margin, bodies = f"{self.goals.clearance_mm:g} mm", " and ".join(self.near)
        if self.clearance <= 0.0:
            return f"{bodies} touch at {self.near_s:.2f} s of the path"
        return f"{bodies} come inside their margin of {margin}: {self._closest}"

    @property
    def _closest(self) -> str:
        return f"{1e3 * self.clearance:.0f} mm at {self.near_s:.2f} s of the path"

    def explain(self) -> str:
        """A line for each arm, one for the cell."""
        lines = [arm.explain() for arm in self.arms]
        if self.follows:
            worst = min(self.arms, key=lambda arm: min(arm.shares))
            binding = "σ_min" if worst.shares[0] <= worst.shares[1] else "margin"
            lines.append(
                f"cell: by speed limits alone {self.time_s:.2f} s (accelerations: coopqp plan); "
                f"{worst.arm}'s {binding} is {min(worst.shares):.2f} of good"
            )
        if np.isfinite(self.clearance):
            lines.append(f"{self.why}." if self.touches else f"closest: {' and '.join(self.near)}, {self._closest}")
        return "\n".join(lines)

    def record(self) -> dict[str, Any]:
        """Plain data for JSON."""

        def number(x: float) -> float | None:
            return float(x) if np.isfinite(x) else None

        return {
            "values": dict(self.values),
            "feasible": self.feasible,
            "score": number(self.score),
            "time_s": number(self.time_s),
            "clearance_m": number(self.clearance),
            "near": list(self.near),
            "near_s": number(self.near_s),
            "why": self.why,
            "arms": [
                {
                    "name": arm.arm,
                    "feasible": arm.feasible,
                    "reach": arm.reach,
                    "sigma_min": arm.sigma_min,
                    "margin": number(arm.margin),
                    "tightest": arm.tightest,
                    "time_s": number(arm.time_s),
                    "q_start": arm.q.tolist(),
                    "why": arm.why,
                }
                for arm in self.arms
            ],
        }


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
        cell.refuse_shared("Placer")
        self.cell, self.grasp, self.goals = cell, grasp, goals or Goals()
        self.samples = sample_path(path, grasp)
        if len(self.samples.clocks) < 2:
            raise InvalidInputError("the path is not known ahead", "Placer: path", "Give one with an end.")
        self.arms = [ArmKinematics(arm.placed(pin.SE3.Identity())) for arm in cell.arms]
        self._near = [np.empty((0, arm.n)) for arm in self.arms]
        self._found: dict[tuple[int, bytes], ArmPlaced] = {}
        self._distances = None if scene is None or not scene.built.labels else _MovedDistances(scene)

    @staticmethod
    def of(scenario: Scenario, *, goals: Goals | None = None) -> Placer:
        """The placer of a scenario, with the distances of its arms, its object and its obstacles."""
        return Placer(
            scenario.cell, scenario.grasp, scenario.path, goals=goals, scene=CollisionScene.of(scenario)
        )  # fmt: skip

    def arm(self, k: int, base: pin.SE3, *, quick: bool = True) -> ArmPlaced:
        """Arm ``k`` with its base at ``base``, T_world_base. ``quick``: branches may be missing."""
        key = k, np.round(base.homogeneous[:3], 9).tobytes() + bytes([quick])
        if key not in self._found:
            T_base_world = base.inverse()
            moved = PathSamples(self.samples.clocks, tuple(T_base_world * T for T in self.samples.poses))
            X = self.grasp.T_object_tool[k]
            found = arm_on_path(self.arms[k], moved, X, near=self._near[k], quick=quick)
            self._found[key] = self._result(found, moved.tool_poses(X))
        return self._found[key]

    def _result(self, found: ArmOnPath, poses: Array) -> ArmPlaced:
        kinematics, name = found.kinematics, found.kinematics.arm.name
        if not found.feasible:
            best = max(found.branches, key=lambda row: (row.inside, row.reached, row.margins.min()), default=None)
            end = float(self.samples.clocks[-1])
            return ArmPlaced(
                arm=name,
                feasible=False,
                reach=best.reached / end if best is not None and best.inside else 0.0,
                sigma_min=0.0,
                margin=float("nan") if best is None else float(best.margins.min()),
                tightest="" if best is None else kinematics.joints[best.tightest],
                slides=best is not None and bool(kinematics.slides[best.tightest]),
                times=np.empty(0),
                q=np.empty(0) if best is None else best.q,
                shares=(0.0, 0.0),
                why=trouble(found),
            )
        row = max(found.feasible, key=lambda row: tuple(sorted(round(s, 6) for s in self._shares(kinematics, row))))
        q = kinematics.trajectories(poses, row.q[None])[0][0]
        speed = kinematics.arm.limits.velocity[kinematics.columns]
        j = int(np.argmin(row.margins / self._units(kinematics)))
        return ArmPlaced(
            arm=name,
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

    def _units(self, kinematics: ArmKinematics) -> Array:
        """Margins that are good (n,) [rad or m]."""
        return np.where(kinematics.slides, 1e-3 * self.goals.margin_mm, np.deg2rad(self.goals.margin_deg))

    def _shares(self, kinematics: ArmKinematics, row: BranchAlongPath) -> tuple[float, float]:
        margin = float((row.margins / self._units(kinematics)).min())
        return float(row.sigma_min.min()) / self.goals.sigma_min, margin

    def cell_at(
        self, bases: Sequence[pin.SE3], *, values: Mapping[str, float] | None = None, quick: bool = True
    ) -> CellPlaced:
        """The cell with its bases at these places, T_world_base of each arm."""
        arms = tuple(self.arm(k, base, quick=quick) for k, base in enumerate(bases))
        clearance, near, near_s = float("nan"), ("", ""), float("nan")
        if self._distances is not None and all(arm.feasible for arm in arms):
            clearance, near, sample = self._distances.least(bases, self._way(bases, arms))
            near_s = float(self.samples.clocks[sample])
        return CellPlaced(
            values=dict(values or {}),
            bases=tuple(bases),
            arms=arms,
            clearance=clearance,
            near=near,
            near_s=near_s,
            goals=self.goals,
        )

    def _way(self, bases: Sequence[pin.SE3], arms: Sequence[ArmPlaced]) -> Array:
        """Joint positions of the cell along the path (K, nv)."""
        cell, ways = self.cell, []
        for base, own, kinematics, X, arm in zip(
            bases, cell.v_slices, self.arms, self.grasp.T_object_tool, arms, strict=True
        ):
            poses = np.linalg.inv(base.homogeneous) @ self.samples.tool_poses(X)
            rest = np.clip(np.zeros(own.stop - own.start), cell.limits.lower[own], cell.limits.upper[own])
            way = np.tile(rest, (len(poses), 1))
            way[:, kinematics.columns] = kinematics.trajectories(poses, arm.q[None])[0][0]
            ways.append(way)
        return np.hstack(ways)

    def remedies(self, placed: CellPlaced) -> tuple[str, ...]:
        """Remedies for arms that do not follow the path from their places: the shortest way of each base, checked."""
        return tuple(self._remedy(k, placed) for k, arm in enumerate(placed.arms) if not arm.feasible)

    def _remedy(self, k: int, placed: CellPlaced) -> str:
        name, base = placed.arms[k].arm, placed.bases[k]
        held = self.samples.tool_poses(self.grasp.T_object_tool[k])[:, :3, 3].mean(axis=0) - base.translation
        toward = np.array([held[0], held[1], 0.0])
        length = np.linalg.norm(toward)
        toward = toward / length if length > 1e-6 else base.rotation[:, 0]
        left, up = np.array([-toward[1], toward[0], 0.0]), np.array([0.0, 0.0, 1.0])
        ways = (
            ("more toward the object", toward), ("more away from the object", -toward), ("to the left of it", left),
            ("to the right of it", -left), ("up", up), ("down", -up),
        )  # fmt: skip
        for distance in np.arange(_STEP, _FARTHEST + 1e-9, _STEP):
            moved = [(self.arm(k, pin.SE3(base.rotation, base.translation + distance * d)), text) for text, d in ways]
            good = [(arm.shares, text, i) for i, (arm, text) in enumerate(moved) if arm.feasible]
            for _, text, i in sorted(good, key=lambda found: tuple(sorted(found[0])), reverse=True):
                there = pin.SE3(base.rotation, base.translation + distance * ways[i][1])
                if self.arm(k, there, quick=False).feasible:
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
        arm_of = [name.partition("/")[0] for name in scene.cell.joint_names]
        joints = list(self.model.joints)
        roots = [j for j in range(1, self.model.njoints) if self.model.parents[j] == 0]
        self.roots = [
            (j, scene.cell.index(arm_of[joints[j].idx_v]), self.model.jointPlacements[j].copy()) for j in roots
        ]
        self.shapes = [
            (i, scene.cell.index(name.partition("/")[0]), self.geometry.geometryObjects[i].placement.copy())
            for i, name in enumerate(built.names)
            if self.geometry.geometryObjects[i].parentJoint == 0 and name.partition("/")[0] in scene.cell.arm_names
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
