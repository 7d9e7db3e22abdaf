"""Admissible joint velocities of one step: position, velocity, acceleration and braking distance in one box.

The box ``lower ≤ v ≤ upper`` is never empty. From outside a position limit it only forbids going further out; the
way back in is a cost of the program (see :mod:`coopqp.control.step.formulations`). Where limits conflict, acceleration
wins.
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
from coopqp.spatial import Array, largest

#: In place of an infinite position limit, where inf / inf would be NaN.
_FAR = 1e100
#: Factor on a joint's braking way that covers rounding.
_AMPLE = 1.001
#: Slope in place of 0 for a joint that stands still: a limit's tolerance over it is beyond _FAR.
_TINY = 1e-200


class VelocityBox:
    """The box of admissible joint velocities; a workspace that one controller owns.

    ``limits`` are the cell's, unless others are given.

    After :meth:`update`, ``lower`` and ``upper`` (nv,) [rad/s or m/s] hold the box, ``outside`` the joints beyond a
    position limit (``any_outside`` if there are some) and ``recovery`` the velocity that leads those back in (0
    elsewhere).
    """

    def __init__(self, cell: RobotCell, limits: JointLimits | None = None) -> None:
        limits = self.limits = cell.limits if limits is None else limits
        n = cell.nv
        self._cell = cell
        self._names = [name.partition("/")[::2] for name in cell.joint_names]
        self._speed = limits.velocity
        self._acceleration = limits.acceleration
        self._braking = np.isfinite(limits.acceleration)
        #: Joints with neither limit.
        self.unlimited = np.logical_not(self._braking | np.isfinite(limits.velocity))
        self._any_unlimited = bool(self.unlimited.any())
        self._fastest = self._speed
        self.accelerates, self._all_brake = bool(self._braking.any()), bool(self._braking.all())
        self._braking_gain = 2.0 * limits.acceleration
        self._room, self._room_dt = 0.0, 0.0
        # Rows: upwards, and downwards with all signs turned. Buffers, for NumPy's calls cost more than its arithmetic.
        ends = np.stack([limits.upper, -limits.lower])
        self._top, self._bottom = np.clip(ends, -_FAR, _FAR) if self._all_brake else ends
        self._ways, self._bounds, self._work, self._v = (np.empty((2, n)) for _ in range(4))
        self._ways_flat = self._ways.reshape(-1)
        self._way_up, self._way_down = self._ways
        self._reach, self._reach2, self._reach_dt = np.zeros(n), np.zeros(n), 0.0
        self.lower, self.upper = np.empty(n), self._bounds[0]
        self.recovery = np.zeros(n)
        self.outside = np.zeros(n, dtype=bool)
        self.any_outside = False

    def update(self, positions: Array, v_prev: Array, dt: float, *, hold: bool = False) -> None:
        """Compute the box for one step.

        Args:
            positions: one position per joint (nv,) [rad or m].
            v_prev: velocity of the previous step (nv,).
            dt: length of the step [s].
            hold: the arms are held: joints without limits brake.
        """
        if self._any_unlimited:
            most = np.full(self._speed.shape, LARGEST_MOVE / dt)
            if hold:
                np.minimum(most, np.maximum(HELD_SPEED, HELD_SHARE * np.abs(v_prev)), out=most)
            self._fastest = np.where(self.unlimited, most, self._speed)
        ways, bounds = self._ways, self._bounds
        np.subtract(self._top, positions, out=self._way_up)
        np.add(self._bottom, positions, out=self._way_down)
        least = self._ways_flat.item(self._ways_flat.argmin())
        inside = least >= 0.0  # not so for NaN
        if least > self._braking_room(dt):
            bounds[:] = self._fastest
        else:
            np.minimum(self._fastest, self._stopping_speed(ways if inside else np.maximum(ways, 0.0), dt), out=bounds)
        if self.accelerates:
            self._keep_reach(dt)
            v, work = self._v, self._work
            v[0] = v_prev
            np.negative(v_prev, out=v[1])
            np.maximum(bounds, np.subtract(v, self._reach, out=work), out=bounds)
            np.minimum(bounds, np.add(v, self._reach, out=work), out=bounds)
        np.negative(bounds[1], out=self.lower)
        if self.any_outside:
            self.recovery[:], self.outside[:], self.any_outside = 0.0, False, False
        if not inside:
            self._lead_back(dt)

    def _lead_back(self, dt: float) -> None:
        up, down = self._ways
        np.logical_or(up < 0.0, down < 0.0, out=self.outside)
        # The signed way back in, and a little further: a joint led to the limit itself would only approach it.
        way = np.where(self.outside, np.where(up < 0.0, up - INSIDE, INSIDE - down), 0.0)
        share = RECOVERY_SHARE * np.where(np.isfinite(self._speed), self._speed, 1.0)
        self.recovery[:] = np.clip(np.clip(way / dt, -share, share), self.lower, self.upper) * self.outside
        self.any_outside = bool(self.outside.any())

    def _keep_reach(self, dt: float) -> None:
        """Largest changes of velocity in one step."""
        if dt != self._reach_dt:
            self._reach, self._reach_dt = self._acceleration * dt, dt
            self._reach2 = self._reach * self._reach

    def _braking_room(self, dt: float) -> float:
        """Way to a limit [rad or m] beyond which no joint has to brake, as fast as it may be, in steps up to ``dt``."""
        if dt > self._room_dt:
            finite = np.isfinite(self._speed)
            speed = np.where(finite, self._speed, 1.0)
            ways = np.where(finite, speed * dt + speed * speed / self._braking_gain, math.inf)
            self._room, self._room_dt = _AMPLE * largest(ways), dt
        return self._room

    def _stopping_speed(self, distance: Array, dt: float) -> Array:
        """Largest speed from which ``distance`` ≥ 0 suffices to stop: v dt + v²/(2a) = d; inf without limit.

        ``distance`` has joints along its last axis, and is finite where all of them have an acceleration limit.
        """
        if not self.accelerates:
            speed: Array = distance / dt
            return speed
        # −a dt + √((a dt)² + 2 a d), written without cancellation
        if self._all_brake:
            self._keep_reach(dt)
            gain = self._braking_gain * distance
            root = np.sqrt(self._reach2 + gain)
            root += self._reach
            gain /= root
            return gain
        finite = self._braking & np.isfinite(distance)
        a, d = np.where(finite, self._acceleration, 1.0), np.where(finite, distance, 1.0)
        step = a * dt
        braking = 2.0 * a * d / (np.sqrt(step * step + 2.0 * a * d) + step)
        return np.where(finite, braking, distance / dt)

    def brake_share(self, positions: Array, v: Array, h: float) -> tuple[float, int]:
        """1 if all joints, braking together after this step, stop inside their limits; else the share of their speed
        that they keep if they do so now, and the joint that needs it.

        A joint's own braking distance is not enough: the others may be slower to stop, and they hold one object.
        """
        limits, speed = self.limits, np.abs(v)
        longest = largest(speed / limits.acceleration)  # of the times that the joints need to stop
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
    first, last = lower - base, upper - base
    still = np.abs(along) < STILL_SLOPE
    slope = along
    if np.count_nonzero(still):
        # Inside, with the tolerance, they allow any rate, and outside none.
        room = LIMIT_TOLERANCE * still
        first -= room
        last += room
        slope = np.where(still, _TINY, along)
    first /= slope
    last /= slope
    low, high = np.minimum(first, last), np.maximum(first, last)
    i, j = int(low.argmax()), int(high.argmin())
    lowest, highest = low.item(i), high.item(j)
    if lowest > _FAR or highest < -_FAR:
        return None
    lowest, highest = (-math.inf if lowest < -_FAR else lowest), (math.inf if highest > _FAR else highest)
    # At standstill a rounding error of the box must not look like an empty interval.
    slack = LIMIT_TOLERANCE / abs(slope.item(j))
    if lowest > highest:
        if lowest - LIMIT_TOLERANCE / abs(slope.item(i)) > highest + slack:
            return None
        lowest = highest = 0.5 * (lowest + highest)
    if highest < 0.0 <= highest + slack:
        highest = 0.0
        lowest = min(lowest, 0.0)
    return lowest, highest, j
