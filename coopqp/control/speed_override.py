"""Speed override and pause: the largest path speed that an operator allows.

The object gets there as fast as the joints can follow: each step may lower the rate σ by D dt at most, with D from the
knots ahead (:meth:`coopqp.control.lookahead.preview.PathPreview.brake`) or, where nothing is known ahead, from the
joints' present velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coopqp.spatial import Array


@dataclass(eq=False)
class SpeedOverride:
    """Override and pause, set by the operator, and the share of the null-space motion that has followed.

    Attributes:
        override: largest rate.
        paused: the object is asked to rest until it is resumed.
        ease: share of the null-space motion that the path does not need; it stops while paused.
    """

    override: float = 1.0
    paused: bool = False
    ease: float = 1.0

    @property
    def share(self) -> float:
        """The largest rate: the override, 0 while paused."""
        return 0.0 if self.paused else self.override

    def started(self, blocked_rate: float) -> SpeedOverride:
        """The same at rest: a start ends neither a pause nor an override."""
        return SpeedOverride(self.override, self.paused, 0.0 if self.share < blocked_rate else 1.0)

    def advance(self, blocked_rate: float, change: float) -> None:
        """Raise or lower the share of the null-space motion by one step's amount."""
        if self.share < blocked_rate:
            self.ease = max(self.ease - change, 0.0)
        elif self.ease < 1.0:
            self.ease = min(self.ease + change, 1.0)


def brake_without_horizon(velocity: Array, acceleration: Array, rate: float) -> float:
    """The fastest fall of the rate where nothing is known ahead [1/s]: all joints brake together, on a straight path.

    Args:
        velocity: of the joints (nv,) [rad/s or m/s].
        acceleration: the share of the joints' acceleration limits that may be used (nv,) [rad/s² or m/s²].
        rate: σ of the last step.
    """
    tightest = float((np.abs(velocity) / acceleration).max())
    return rate / tightest if tightest > 0.0 else np.inf
