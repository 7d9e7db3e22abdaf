"""Velocity bounds of one step: position, velocity, acceleration and braking distance in one box.

The box ``lower ≤ v ≤ upper`` is never empty. From outside a position limit it only forbids going further out; the
way back in is a cost of the program (see :mod:`coopqp.control.step.formulations`). Where limits conflict, acceleration
wins. The core's counterpart is ``limits.cpp``.
"""

from __future__ import annotations

import math

import numpy as np

from coopqp.model.cell import JointLimits, RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.native.constants import (
    BRAKING_SHARE,
    HELD_SHARE,
    HELD_SPEED,
    INSIDE,
    LARGEST_MOVE,
    LIMIT_TOLERANCE,
    RECOVERY_SHARE,
    STILL_SLOPE,
)
from coopqp.spatial import Array


class VelocityBox:
    """The box of admissible joint velocities; a workspace that one controller owns.

    ``limits`` are the cell's, unless others are given.

    Attributes:
        lower, upper: the box, after :meth:`update` (nv,) [rad/s or m/s].
        outside: joints beyond a position limit (nv,); ``any_outside`` if there are some.
        recovery: velocities that lead those back in (nv,), 0 elsewhere.
        accelerates: some joint has an acceleration limit.
        unlimited: joints with neither a speed nor an acceleration limit (nv,).
    """

    def __init__(self, cell: RobotCell, limits: JointLimits | None = None) -> None:
        limits = self.limits = cell.limits if limits is None else limits
        self._names = [name.partition("/")[::2] for name in cell.joint_names]
        self._acceleration, self._fastest = limits.acceleration, limits.velocity
        self.accelerates = bool(np.isfinite(limits.acceleration).any())
        self.unlimited = ~np.isfinite(limits.acceleration) & ~np.isfinite(limits.velocity)
        self.lower, self.upper, self.recovery = np.zeros((3, cell.nv))
        self.outside, self.any_outside = np.zeros(cell.nv, dtype=bool), False

    def update(self, positions: Array, v_prev: Array, dt: float, *, hold: bool = False) -> None:
        """Compute the box for one step.

        Args:
            positions: one position per joint (nv,) [rad or m].
            v_prev: velocity of the previous step (nv,).
            dt: length of the step [s].
            hold: the arms are held: joints without limits brake.
        """
        limits = self.limits
        largest = np.full(v_prev.shape, LARGEST_MOVE / dt)
        if hold:
            largest = np.minimum(largest, np.maximum(HELD_SPEED, HELD_SHARE * np.abs(v_prev)))
        self._fastest = np.where(self.unlimited, largest, limits.velocity)
        up, down = limits.upper - positions, positions - limits.lower
        stops_up, stops_down = (self._stopping_speed(np.maximum(way, 0.0), dt) for way in (up, down))
        change = limits.acceleration * dt
        self.upper = np.clip(np.minimum(self._fastest, stops_up), v_prev - change, v_prev + change)
        self.lower = np.clip(-np.minimum(self._fastest, stops_down), v_prev - change, v_prev + change)
        self.outside = (up < 0.0) | (down < 0.0)
        self.any_outside = bool(self.outside.any())
        # The signed way back in, and a little further: a joint led to the limit itself would only approach it.
        way = np.where(up < 0.0, up - INSIDE, INSIDE - down)
        share = RECOVERY_SHARE * np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        back = np.clip(np.clip(way / dt, -share, share), self.lower, self.upper)
        self.recovery = np.where(self.outside, back, 0.0)

    def _stopping_speed(self, distance: Array, dt: float) -> Array:
        """Largest speed from which ``distance`` ≥ 0 suffices to stop: v dt + v²/(2a) = d; inf without limit."""
        a = self._acceleration
        with np.errstate(invalid="ignore"):
            # −a dt + √((a dt)² + 2 a d), written without cancellation
            braking = 2.0 * a * distance / (np.sqrt((a * dt) ** 2 + 2.0 * a * distance) + a * dt)
        return np.where(np.isfinite(a) & np.isfinite(distance), braking, distance / dt)

    def brake_share(self, positions: Array, v: Array, h: float) -> tuple[float, int]:
        """The share of their speed that joints keep if they brake together now, and the joint that needs it.

        1 and −1 if it suffices to brake together after this step. A joint's own braking distance is not enough: the
        others may be slower to stop, and they hold one object.
        """
        limits, speed = self.limits, np.abs(v)
        longest = float((speed / limits.acceleration).max())  # of the times that the joints need to stop
        if longest <= 0.0:
            return 1.0, -1
        planned = longest / BRAKING_SHARE
        room = np.where(v > 0.0, limits.upper - positions, positions - limits.lower)
        late = (speed * (h + 0.5 * planned) > room) & (room >= 0.0)
        if not late.any():
            return 1.0, -1
        times = np.full(room.shape, np.inf)
        times[late] = room[late] / speed[late]
        joint = int(times.argmin())
        return max(0.0, 1.0 - h / min(max(2.0 * (float(times[joint]) - h), longest), planned)), joint

    def stops_at_once(self, v: Array, h: float) -> bool:
        """Whether every joint can come to rest within a step."""
        return bool((np.abs(v) <= self.limits.acceleration * h).all())

    def kind_of(self, j: int, sign: float, v_prev: Array, dt: float) -> LimitKind:
        """Which limit makes the bound of joint ``j`` on the side of ``sign``."""
        bound = self.upper.item(j) if sign > 0 else self.lower.item(j)
        tolerance = 1e-9 * (1.0 + abs(bound))
        if abs(abs(bound) - self._fastest.item(j)) <= tolerance:
            return LimitKind.VELOCITY
        acceleration = self._acceleration.item(j)
        if acceleration < math.inf:
            change = (bound - v_prev.item(j)) * sign
            if abs(abs(change) - acceleration * dt) <= tolerance:
                return LimitKind.ACCELERATION
        return LimitKind.POSITION

    def binding(self, j: int, sign: float, v_prev: Array, dt: float) -> BindingLimit:
        """The limit of joint ``j`` on the side of ``sign``, by name."""
        arm, joint = self._names[j]
        return BindingLimit(arm, joint, self.kind_of(j, sign, v_prev, dt))


def rate_interval(base: Array, along: Array, lower: Array, upper: Array) -> tuple[float, float, int] | None:
    """Rates σ with ``lower ≤ base + σ along ≤ upper``: (low, high, joint that makes high); None if there are none."""
    still = np.abs(along) < STILL_SLOPE
    if np.any(still & ((base > upper + LIMIT_TOLERANCE) | (base < lower - LIMIT_TOLERANCE))):
        return None
    slope = np.where(still, 1.0, along)
    ends = np.stack([lower - base, upper - base]) / slope
    low, high = np.where(still, -np.inf, ends.min(axis=0)), np.where(still, np.inf, ends.max(axis=0))
    i, j = int(low.argmax()), int(high.argmin())
    lowest, highest = float(low[i]), float(high[j])
    # At standstill a rounding error of the box must not look like an empty interval.
    slack_low, slack_high = (LIMIT_TOLERANCE / abs(float(slope[k])) for k in (i, j))
    if lowest > highest:
        if lowest - slack_low > highest + slack_high:
            return None
        lowest = highest = 0.5 * (lowest + highest)
    if highest < 0.0 <= highest + slack_high:
        highest = 0.0
        lowest = min(lowest, 0.0)
    return lowest, highest, j
