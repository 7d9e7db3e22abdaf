"""Settings of the preview, and the limits that it plans with."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from coopqp.checks import Doc, as_count, documented, keep_scalars
from coopqp.core._core import STEPS_TO_FULL_SPEED
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

#: Planned share of the largest change of the rate, under acceleration limits.
_SHARE_OF_SLOPE = 0.9
#: An arm's joints would take this many steps to the end of its reach.
_STEPS_TO_EDGE = 2
#: Shortest interval between grid points, as a share of the path's duration.
_SHORTEST_SHARE = 1e-5


@documented
@dataclass(frozen=True, kw_only=True)
class PreviewOptions:
    """Settings of the preview."""

    cell: Annotated[float, Doc("longest interval between grid points [s of the clock]")] = 0.02
    joint_step: Annotated[float, Doc("largest joint motion between grid points [rad or m]")] = 0.02
    slope_step: Annotated[
        float, Doc("largest change of a joint's slope between grid points, as a share of its largest slope and speed")
    ] = 0.1
    shortest: Annotated[
        float,
        Doc("intervals between grid points are not halved below this [s], nor below 1e-5 of the path's duration"),
    ] = 1e-6
    margin: Annotated[
        float, Doc("η, share of velocity and acceleration limits that is planned with where acceleration is limited")
    ] = 0.95
    curvature_share: Annotated[
        float,
        Doc(
            "κ: a further constraint that bounds z = σ² and σ̇ at once leaves this share of its bound to z; and the "
            "path's curvature takes this share of the planned accelerations, where no acceleration is limited"
        ),
    ] = 0.5
    doubt: Annotated[
        float, Doc("share of the differences of q″ at a grid point that stands for what the path does between them")
    ] = 0.3
    rate_slope: Annotated[float, Doc("σ̇_max, largest change of the rate [1/s], where acceleration is limited")] = 10.0
    singular_rate: Annotated[
        float,
        Doc(
            "a rate cap below this, while joint speeds still rise, ends the path there, unless they fall "
            "again before it is below 0.3 of this"
        ),
    ] = 1e-2
    newton_steps: Annotated[
        int,
        Doc(
            "the chain's Newton steps that one control step may take. Where these are too few to see as "
            "far as the object needs to stop, it slows down"
        ),
    ] = 40

    def __post_init__(self) -> None:
        keep_scalars(self, "cell", "joint_step", "slope_step", "shortest", "rate_slope")
        keep_scalars(self, "margin", "curvature_share", "singular_rate", high=1.0)
        keep_scalars(self, "doubt", open_low=False)
        object.__setattr__(self, "newton_steps", as_count(self.newton_steps, "PreviewOptions: newton_steps"))

    def along(self, duration: float) -> PreviewOptions:
        """These settings on a path of a duration [s]."""
        return replace(self, shortest=min(self.shortest, _SHORTEST_SHARE * duration)) if duration > 0.0 else self

    def slope(self, *, accelerates: bool, dt: float) -> float:
        """Largest change of the rate [1/s] of joints with or without acceleration limits."""
        return self.rate_slope if accelerates else 1.0 / (STEPS_TO_FULL_SPEED * dt)


@dataclass(frozen=True, eq=False)
class PlanLimits:
    """Planning limits of the path ahead.

    Attributes:
        speed, acceleration: of each joint (nv,).
        jump: change of velocity that a joint can take within one step, at a corner or at the path's end (nv,).
        slope_change: change of slope between grid points that is always allowed (nv,).
        slope_cap: largest change of the rate [1/s].
        room: motion of each joint in two steps, from rest or at full speed, whichever is less: the least distance of
            an arm from the end of its reach (nv,).
        accelerates: some joint has an acceleration limit.
    """

    speed: Array
    acceleration: Array
    jump: Array
    slope_change: Array
    slope_cap: float
    room: Array
    accelerates: bool

    @staticmethod
    def of(cell: RobotCell, options: PreviewOptions, *, dt: float) -> PlanLimits:
        """The shares of a cell's limits that the look-ahead plans with.

        A joint without acceleration limit may still not change its velocity so fast that a step's linearisation fails:
        it is planned with a change of full speed in a number of steps, and without speed cap, which the step itself
        finds. A jump of its velocity is the step's business.
        """
        limits, finite = cell.limits, np.isfinite(cell.limits.acceleration)
        speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        planned, accelerates = options.margin * limits.acceleration, bool(finite.any())
        acceleration, time = np.where(finite, planned, speed / (STEPS_TO_FULL_SPEED * dt)), _STEPS_TO_EDGE * dt
        slope_cap = options.slope(accelerates=accelerates, dt=dt)
        return PlanLimits(
            np.where(finite, options.margin, 1.0) * limits.velocity,
            acceleration,
            np.where(finite, planned, np.inf) * dt,
            options.slope_step * speed,
            _SHARE_OF_SLOPE * slope_cap if accelerates else slope_cap,
            np.minimum(0.5 * acceleration * time, limits.velocity) * time,
            accelerates,
        )
