"""Figures of arms and of a cell whose bases stand at some places, and thresholds of a good placement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, documented, keep_scalars
from coopqp.model.branches import amount
from coopqp.spatial import Array


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
        robot: name of the robot on whose base it stands; empty for an arm on a base of its own.
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
    robot: str
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
        shared: where joints that arms share are along the path, in words, for each group of arms.
    """

    values: Mapping[str, float]
    bases: tuple[pin.SE3, ...]
    arms: tuple[ArmPlaced, ...]
    clearance: float
    near: tuple[str, str]
    near_s: float
    goals: Goals
    shared: tuple[str, ...] = ()

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
        """A line for each arm, one for each group that shares joints, one for the cell."""
        lines = [arm.explain() for arm in self.arms]
        lines += [f"joints that arms share: {where}." for where in self.shared]
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
            "shared": list(self.shared),
            "bases": {
                arm.robot or arm.arm: {"matrix": base.homogeneous.tolist()}
                for arm, base in zip(self.arms, self.bases, strict=True)
            },
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
