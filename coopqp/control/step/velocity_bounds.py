"""Velocity bounds of one step: position, velocity, acceleration and braking distance in one box.

The box ``lower ≤ v ≤ upper`` is never empty. From outside a position limit it only forbids going further out; the
way back in is a cost of the program. Where limits conflict, acceleration wins. The core has its own (``limits.cpp``);
this box is that of the controllers that it is compared with.
"""

from __future__ import annotations

import math

import numpy as np

from coopqp.core._core import (
    HELD_SHARE,
    HELD_SPEED,
    INSIDE,
    LARGEST_MOVE,
    RECOVERY_SHARE,
)
from coopqp.model.cell import JointLimits, RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
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
