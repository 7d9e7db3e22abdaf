"""Settings of the preview, and the limits that it plans with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.checks import as_count, keep_scalars
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

#: A joint without acceleration limit is planned to reach full speed in this many steps, and so is the rate.
_STEPS_TO_FULL_SPEED = 22
#: Under acceleration limits this share of the largest change of the rate is planned with.
_SHARE_OF_SLOPE = 0.9


@dataclass(frozen=True, kw_only=True)
class PreviewOptions:
    """Settings of the preview.

    Attributes:
        cell: longest interval between knots [s of the clock].
        joint_step: largest joint motion between knots [rad or m].
        slope_step: largest change of a joint's slope between knots, as a share of the largest slope and of its speed.
        shortest: intervals between knots are not halved below this [s].
        margin: η, share of velocity and acceleration limits that is planned with where acceleration is limited.
        curvature_share: κ, share for z = σ² of a further constraint that bounds z and σ̇ at once; and of the planned
            accelerations, where no acceleration is limited.
        doubt: share of the differences of q″ at a knot that stands for what the path does between knots.
        rate_slope: σ̇_max, largest change of the rate [1/s], where acceleration is limited.
        singular_rate: a rate cap below this, while joint speeds still rise, ends the path there, unless they fall
            again before it is below 0.3 of this.
        newton_steps: the chain's Newton steps that one control step may take. Where these are too few to see as far as
            the object needs to stop, it slows down.
    """

    cell: float = 0.02
    joint_step: float = 0.02
    slope_step: float = 0.1
    shortest: float = 1e-6
    margin: float = 0.95
    curvature_share: float = 0.5
    doubt: float = 0.3
    rate_slope: float = 10.0
    singular_rate: float = 1e-2
    newton_steps: int = 40

    def __post_init__(self) -> None:
        keep_scalars(self, "cell", "joint_step", "slope_step", "shortest", "rate_slope")
        keep_scalars(self, "margin", "curvature_share", "singular_rate", high=1.0)
        keep_scalars(self, "doubt", open_low=False)
        object.__setattr__(self, "newton_steps", as_count(self.newton_steps, "PreviewOptions: newton_steps"))

    def slope(self, *, accelerates: bool, dt: float) -> float:
        """Largest change of the rate [1/s] of joints with or without acceleration limits."""
        return self.rate_slope if accelerates else 1.0 / (_STEPS_TO_FULL_SPEED * dt)


@dataclass(frozen=True, eq=False)
class PlanLimits:
    """The limits that the path ahead is planned with.

    Attributes:
        speed, acceleration: of each joint (nv,).
        jump: change of velocity that a joint can take within one step, at a corner or at the path's end (nv,).
        slope_change: change of slope between knots that is always allowed (nv,).
        slope_cap: largest change of the rate [1/s].
        accelerates: some joint has an acceleration limit.
    """

    speed: Array
    acceleration: Array
    jump: Array
    slope_change: Array
    slope_cap: float
    accelerates: bool

    @staticmethod
    def of(cell: RobotCell, options: PreviewOptions, *, dt: float) -> PlanLimits:
        """A share of the cell's limits.

        A joint without acceleration limit may still not change its velocity so fast that a step's linearisation fails:
        it is planned with a change of full speed in a number of steps, and without speed cap, which the step itself
        finds. A jump of its velocity is the step's business.
        """
        limits, finite = cell.limits, np.isfinite(cell.limits.acceleration)
        speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        planned, accelerates = options.margin * limits.acceleration, bool(finite.any())
        slope_cap = options.slope(accelerates=accelerates, dt=dt)
        return PlanLimits(
            np.where(finite, options.margin, 1.0) * limits.velocity,
            np.where(finite, planned, speed / (_STEPS_TO_FULL_SPEED * dt)),
            np.where(finite, planned, np.inf) * dt,
            options.slope_step * speed,
            _SHARE_OF_SLOPE * slope_cap if accelerates else slope_cap,
            accelerates,
        )
