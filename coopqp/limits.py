"""Admissible joint velocities of one step: position, velocity, acceleration and braking distance in one box.

The box ``lower ≤ v ≤ upper`` is never empty. From outside a position limit it only forbids going further out; the
way back in is a cost of the program (see :mod:`coopqp.program`). Where limits conflict, acceleration wins.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from coopqp.cell import JointLimits, RobotCell
from coopqp.spatial import Array


class LimitKind(enum.Enum):
    """Which limit of a joint binds."""

    POSITION = "position"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    SINGULARITY = "singularity"
    REACH = "reach"
    PATH_END = "path end"
    OUT_OF_STEP = "out of step"


#: Velocities within this of a limit count as admissible, and are clipped [rad/s or m/s].
LIMIT_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class BindingLimit:
    """A limit that the step runs against.

    Attributes:
        arm: name of the arm; empty where the limit is the path's.
        joint: name of the joint, without the arm's prefix; empty where the limit is the whole arm's.
        kind: which limit.
    """

    arm: str
    joint: str
    kind: LimitKind

    def __str__(self) -> str:
        if not self.arm:
            return self.kind.value  # the path's own
        joint = f" joint {self.joint}" if self.joint else ""
        return f"arm {self.arm}{joint}: {self.kind.value}"


class VelocityBox:
    """The box of admissible joint velocities; a workspace that one controller owns.

    ``limits`` are the cell's, unless others are given.

    After :meth:`update`, ``lower`` and ``upper`` (nv,) [rad/s or m/s] hold the box, ``outside`` the joints beyond a
    position limit and ``recovery`` the velocity that leads those back in (0 elsewhere).
    """

    #: Share of a joint's speed at which it is led back from outside its limits.
    RECOVERY_SHARE = 0.2
    #: How far inside its limit such a joint is led [rad or m].
    INSIDE = 1e-5

    def __init__(self, cell: RobotCell, limits: JointLimits | None = None) -> None:
        limits = self.limits = cell.limits if limits is None else limits
        self._cell = cell
        self._speed = limits.velocity
        self._acceleration = limits.acceleration
        self._low, self._high = limits.lower, limits.upper
        self._bounded = np.flatnonzero(np.isfinite(limits.lower) | np.isfinite(limits.upper))
        self._braking = np.isfinite(limits.acceleration)
        self.accelerates = bool(self._braking.any())
        self.lower, self.upper = np.empty(cell.nv), np.empty(cell.nv)
        self.recovery = np.zeros(cell.nv)
        self.outside = np.zeros(cell.nv, dtype=bool)
        self._way_up, self._way_down = np.empty(cell.nv), np.empty(cell.nv)

    def update(self, positions: Array, v_prev: Array, dt: float) -> None:
        """Compute the box for one step.

        Args:
            positions: one position per joint (nv,) [rad or m].
            v_prev: velocity of the previous step (nv,).
            dt: length of the step [s].
        """
        up, down = self._way_up, self._way_down
        np.subtract(self._high, positions, out=up)  # distance left upwards; negative outside
        np.subtract(positions, self._low, out=down)
        np.logical_or(up < 0.0, down < 0.0, out=self.outside)
        self.upper[:] = np.minimum(self._speed, self._stopping_speed(up, dt))
        self.lower[:] = -np.minimum(self._speed, self._stopping_speed(down, dt))
        if self.accelerates:
            reach = self._acceleration * dt
            floor, ceiling = v_prev - reach, v_prev + reach
            np.clip(self.upper, floor, ceiling, out=self.upper)
            np.clip(self.lower, floor, ceiling, out=self.lower)
        self.recovery[:] = 0.0
        if self.outside.any():
            # The signed way back in, and a little further: a joint led to the limit itself would only approach it.
            way = np.where(self.outside, np.where(up < 0.0, up - self.INSIDE, self.INSIDE - down), 0.0)
            share = self.RECOVERY_SHARE * np.where(np.isfinite(self._speed), self._speed, 1.0)
            self.recovery[:] = np.clip(np.clip(way / dt, -share, share), self.lower, self.upper)

    def _stopping_speed(self, distance: Array, dt: float) -> Array:
        """Largest speed from which ``distance`` suffices to stop: v dt + v²/(2a) = d; 0 outside, inf without limit."""
        d = np.maximum(distance, 0.0)
        if not self.accelerates:
            speed: Array = d / dt
            return speed
        finite = self._braking & np.isfinite(d)
        a, d_finite = np.where(finite, self._acceleration, 1.0), np.where(finite, d, 1.0)
        step = a * dt
        # −a dt + √((a dt)² + 2 a d), written without cancellation
        braking = 2.0 * a * d_finite / (np.sqrt(step * step + 2.0 * a * d_finite) + step)
        return np.where(finite, braking, d / dt)

    def kind_of(self, j: int, sign: float, v_prev: Array, dt: float) -> LimitKind:
        """Which limit makes the bound of joint ``j`` on the side of ``sign``."""
        bound = self.upper[j] if sign > 0 else self.lower[j]
        tolerance = 1e-9 * (1.0 + abs(bound))
        if abs(abs(bound) - self._speed[j]) <= tolerance:
            return LimitKind.VELOCITY
        if np.isfinite(self._acceleration[j]):
            change = (bound - v_prev[j]) * sign
            if abs(abs(change) - self._acceleration[j] * dt) <= tolerance:
                return LimitKind.ACCELERATION
        return LimitKind.POSITION

    def binding(self, j: int, sign: float, v_prev: Array, dt: float) -> BindingLimit:
        """The limit of joint ``j`` on the side of ``sign``, by name."""
        arm, _, joint = self._cell.joint_names[j].partition("/")
        return BindingLimit(arm, joint, self.kind_of(j, sign, v_prev, dt))


def rate_interval(base: Array, along: Array, lower: Array, upper: Array) -> tuple[float, float, int] | None:
    """Rates σ with ``lower ≤ base + σ along ≤ upper``: (low, high, joint that makes high); None if there are none."""
    room_up, room_down = upper - base, lower - base
    still = np.abs(along) < 1e-12
    if still.any() and ((room_up < -LIMIT_TOLERANCE) | (room_down > LIMIT_TOLERANCE))[still].any():
        return None
    slope = np.where(still, 1.0, along)
    forward = slope > 0.0
    high = np.where(still, np.inf, np.where(forward, room_up, room_down) / slope)
    low = np.where(still, -np.inf, np.where(forward, room_down, room_up) / slope)
    # At standstill a rounding error of the box must not look like an empty interval.
    slack = np.where(still, 0.0, LIMIT_TOLERANCE / np.abs(slope))
    j = int(high.argmin())
    i = int(low.argmax())
    lowest, highest = float(low[i]), float(high[j])
    if lowest > highest:
        if lowest - slack[i] > highest + slack[j]:
            return None
        lowest = highest = 0.5 * (lowest + highest)
    if highest < 0.0 <= highest + slack[j]:
        highest = 0.0
        lowest = min(lowest, 0.0)
    return lowest, highest, j
