"""A gripped arm that stops, by the measured configurations alone, where neither wrenches nor stiffness are known.

A rigid grip drags every measured arm along: nothing parts the arms. But the object that they carry together then stands
elsewhere than its command, and not where it was a moment ago. Where servos lag, it does: its deviation is ``d = −τ V``
with one lag τ, which does not change. So bounds of τ are kept,

    ``lo, hi ← ∩ (b ∓ m) / |V|``,    b the part of −d along V,    m = floor + noise + κ a,

with the acceleration a, and a deviation that no τ within them explains is an arm that has stopped, or something that
the object touches. The bounds, and what the deviation is at rest, drift by a share of the way.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from coopqp.control.core import layout
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

_FLOOR, _HOLDS, _LATE, _SLOWEST, _LONGEST, _SETTLES = (
    layout.CONSTANTS[name]
    for name in ("LAG_FLOOR", "LAG_HOLDS", "LAG_LATE", "LAG_SLOWEST", "LONGEST_LAG", "LAG_SETTLES")
)
_SLOPE, _PEAK, _FILTER, _LET_GO = (
    layout.CONSTANTS[name] for name in ("LARGEST_SLOPE", "SERVO_PEAK", "HASTE_FILTER", "LET_GO")
)
#: The sentence of an arm that is found.
OFF_LAG = "arm {arm} seems to have stopped in its grip: the arms are {mm:.2f} mm from where a lag could put them"


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
        self._low, self._high, self._hasty, self._suspects = 0.0, _LONGEST, 0.0, False

    def look(self, deviation: Array, velocity: Array, noise: float, dt: float, *, settled: bool) -> tuple[float, int]:
        """Take one sample.

        Args:
            deviation: of all arms, in lengths at the grasps (6,) [m].
            velocity: of the object as commanded, in the same way (6,) [m/s].
            noise: accepted deviation by noise, and by arms that part: their grips are not rigid [m].
            dt: time since the last sample [s].
            settled: there were samples enough to know the noise.

        Returns:
            How far the deviation is from what any lag explains [m], at most 0 where one does, and the arm whose grasp
            is the farthest.
        """
        change = (velocity - self._told) / (_FILTER + dt)
        self._told = self._told + dt * change
        hasty = 0.0 if self._suspects else math.sqrt(change @ change)
        self._hasty = max(hasty, self._hasty * _PEAK / (_PEAK + dt))
        base = self._base = deviation.copy() if self._base is None else self._base
        speed, off = math.sqrt(velocity @ velocity), deviation - base
        moves = speed > _SLOWEST
        if moves:
            self._way = velocity / speed
        behind = -float(off @ self._way)
        lag = min(max(behind / speed, 0.0), _LONGEST) if moves else 0.0
        margin = (_LET_GO if self._suspects else 1.0) * _FLOOR + noise + (_LATE + 0.5 * lag * lag) * self._hasty
        explained = min(max(behind, self._low * speed), self._high * speed)
        rest = off + explained * self._way
        excess = math.sqrt(rest @ rest) - margin
        self._suspects = excess > 0.0 and settled
        if self._suspects:
            at_grasps = rest[:3] + np.cross(rest[3:], self._levers)
            return excess, int(np.einsum("ij,ij->i", at_grasps, at_grasps).argmax())
        if moves:
            self._high = min(self._high + _SLOPE * dt, _LONGEST, max((behind + margin) / speed, 0.0))
            self._low = max(self._low - _SLOPE * dt, (behind - margin) / speed, 0.0)
            if self._low > self._high:
                self._low = self._high = 0.5 * (self._low + self._high)
            behind = min(max(behind, self._low * speed), self._high * speed)
            rest = off + behind * self._way
            base += min(_SLOPE * speed * dt / max(math.sqrt(rest @ rest), 1e-300), 1.0) * rest
        else:
            base += dt / (_SETTLES + dt) * off
        return 0.0, -1


def excess_cap(excess: float) -> float:
    """The rate that such an excess [m] leaves."""
    return min(max(1.0 - excess / _HOLDS, 0.0), 1.0)
