"""A gripped arm that stops, by the measured configurations alone, where neither wrenches nor stiffness are known.

A rigid grip drags every measured arm along: nothing parts the arms. But the object that they carry together then stands
elsewhere than its command, and not where it was a moment ago. Where servos lag, it does: its deviation is ``d = −τ V``
with one lag τ, which does not change. So bounds of τ are kept,

    ``lo, hi ← ∩ (b ∓ m) / |V|``,    b the part of −d along V,    m = floor + noise + κ a,

with the acceleration a, and a deviation that no τ within them explains is an arm that has stopped, or something that
the object touches. What 20 ms of lag do not explain in the first 0.2 s shows how soft the drives are, and is added to
m. The bounds, and what the deviation is at rest, drift by a share of the way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from coopqp.control.monitoring.options import SupervisionOptions
from coopqp.model.grasp import Grasp
from coopqp.native.constants import (
    HASTE_FILTER,
    LAG,
    LAG_FLOOR,
    LAG_FOLLOWS,
    LAG_HOLDS,
    LAG_LATE,
    LAG_LEARNS,
    LAG_SETTLES,
    LAG_SLOWEST,
    LARGEST_SLOPE,
    LET_GO,
    LONGEST_LAG,
    SERVO_PEAK,
)
from coopqp.spatial import Array, Flags

#: The sentence of an arm that is found.
OFF_LAG = "arm {arm} seems to have stopped in its grip: the arms are {mm:.2f} mm from where a lag could put them"

#: A late arm is looked for in this many samples before the last ones, at most.
_MOST_LATE = 200


def kept_samples(options: SupervisionOptions, dt: float) -> int:
    """Number of samples in which a stall is looked for, of length ``dt`` [s]: those of a lag beside stall_samples."""
    return 1 + (options.stall_samples or 1) + math.ceil(min(LAG / dt, _MOST_LATE) - 1e-9)


def least_told(commanded: Sequence[Array], starts: Sequence[int], samples: int) -> Array:
    """The least motion that each arm was commanded to make in so many samples, now or up to a lag ago (N,) [rad or m].

    One of these motions is what a late arm should have made: where it turns round, it is small.

    Args:
        commanded: positions of the joints in the samples that are kept, the last one at the end.
        starts: first joint of each arm.
        samples: number of samples in which an arm moves.
    """
    rows = np.array(commanded)
    each = np.maximum.reduceat(np.abs(rows[samples:] - rows[:-samples]), starts, axis=1)
    out: Array = each.min(axis=0)
    return out


def grasp_levers(grasp: Grasp, reach: float) -> Array:
    """Places of the grasps from their centre, over a reach (N, 3)."""
    points = np.array([X.translation for X in grasp.T_object_tool])
    out: Array = (points - points.mean(axis=0)) / reach
    return out


@final
class LagWatch:
    """Compares the deviation that all arms have with what a lag makes of it.

    Args:
        grasp: how the arms hold the object.
        reach: length of a turn of 1 rad at the grasps [m].
    """

    def __init__(self, grasp: Grasp, reach: float) -> None:
        self._levers = grasp_levers(grasp, reach)
        self.reset()

    def reset(self) -> None:
        """Forget."""
        self._base: Array | None = None
        self._told, self._way = np.zeros(6), np.zeros(6)
        self._low, self._high, self._hasty, self._suspects = 0.0, LONGEST_LAG, 0.0, False
        self._since, self._soft = 0.0, 0.0

    def take_over(self, shift: Array) -> None:
        """Other arms hold than before, and their deviation is another by ``shift`` (6,) [m]."""
        if self._base is not None:
            self._base = self._base + shift

    def look(
        self, deviation: Array, velocity: Array, noise: float, dt: float, *, holds: Flags, settled: bool
    ) -> tuple[float, int]:
        """Take one sample.

        Args:
            deviation: of all arms that hold, in lengths at the grasps (6,) [m].
            velocity: of the object as commanded, in the same way (6,) [m/s].
            noise: accepted deviation by noise, and by arms that part: their grips are not rigid [m].
            dt: time since the last sample [s].
            holds: which arms hold (N,).
            settled: there were samples enough to know the noise.

        Returns:
            How far the deviation is from what any lag explains [m], at most 0 where one does, and the arm whose grasp
            is the farthest.
        """
        change = (velocity - self._told) / (HASTE_FILTER + dt)
        self._told = self._told + dt * change
        hasty = 0.0 if self._suspects else math.sqrt(change @ change)
        self._hasty = max(hasty, self._hasty * SERVO_PEAK / (SERVO_PEAK + dt))
        speed = math.sqrt(velocity @ velocity)
        moves, rests = speed > LAG_SLOWEST, max(speed, math.sqrt(self._told @ self._told)) <= LAG_SLOWEST
        if self._base is None:  # what moves shows no deviation at rest
            self._base, self._since = (deviation.copy(), dt) if rests else (None, 0.0)
            return 0.0, -1
        if rests and math.sqrt(deviation @ deviation) <= LAG_FLOOR:  # the arms are where their commands are
            self._base = deviation.copy()
        base, off = self._base, deviation - self._base
        if moves:
            self._way = velocity / speed
        behind = -float(off @ self._way)
        if self._since < LAG_LEARNS:
            sags = off + min(max(behind, 0.0), LAG * speed) * self._way
            self._since, self._soft = self._since + dt, max(self._soft, math.sqrt(sags @ sags))
        lag = min(max(behind / speed, self._low), self._high) if moves else self._high
        margin = (
            (LET_GO if self._suspects else 1.0) * LAG_FLOOR
            + noise
            + self._soft
            + (LAG_LATE + lag * (LAG_FOLLOWS + 0.5 * lag)) * self._hasty
        )
        explained = min(max(behind, self._low * speed), self._high * speed)
        rest = off + explained * self._way
        excess = math.sqrt(rest @ rest) - margin
        self._suspects = excess > 0.0 and settled
        if self._suspects:
            at_grasps = rest[:3] + np.cross(rest[3:], self._levers)
            return excess, int(np.where(holds, np.einsum("ij,ij->i", at_grasps, at_grasps), -1.0).argmax())
        if moves:
            self._high = min(self._high + LARGEST_SLOPE * dt, LONGEST_LAG, max((behind + margin) / speed, 0.0))
            self._low = max(self._low - LARGEST_SLOPE * dt, (behind - margin) / speed, 0.0)
            if self._low > self._high:
                self._low = self._high = 0.5 * (self._low + self._high)
            behind = min(max(behind, self._low * speed), self._high * speed)
            rest = off + behind * self._way
            base += min(LARGEST_SLOPE * speed * dt / max(math.sqrt(rest @ rest), 1e-300), 1.0) * rest
        elif rests:
            base += dt / (LAG_SETTLES + dt) * off
        return 0.0, -1


def excess_cap(excess: float) -> float:
    """The rate that such an excess [m] leaves."""
    return min(max(1.0 - excess / LAG_HOLDS, 0.0), 1.0)
