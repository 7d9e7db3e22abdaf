"""Time laws: progress along a segment of a path."""

from __future__ import annotations

import enum

import numpy as np

from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.spatial import Array


class TimeLaw(enum.Enum):
    """Progress along a segment: share u(x) of the way as a function of the share x of the time, both in [0, 1]."""

    LINEAR = "linear"  #: u = x, the paper's τ = t/t_f; the velocity jumps at the start and at the end
    QUINTIC = "quintic"  #: u = 10x³ − 15x⁴ + 6x⁵; velocity and acceleration are zero at both ends

    def value_at(self, x: float) -> float:
        """u(x), clamped to [0, 1]."""
        if x <= 0.0:
            return 0.0
        if x >= 1.0:
            return 1.0
        if x != x:
            raise InvalidInputError("the clock is NaN", "ObjectPath", "Give a finite time [s].")
        return x if self is TimeLaw.LINEAR else min(1.0, x * x * x * (10.0 + x * (6.0 * x - 15.0)))  # rounding

    def slope_at(self, x: float) -> float:
        """du/dx; 0 outside [0, 1)."""
        if x < 0.0 or x >= 1.0:
            return 0.0
        return 1.0 if self is TimeLaw.LINEAR else 30.0 * x * x * (1.0 - x) * (1.0 - x)

    def inverse(self, u: Array) -> Array:
        """x at shares u of the way (K,). u(x) is the regularised incomplete beta function of (3, 3)."""
        from scipy.special import betaincinv  # takes long to import

        inside: Array = np.clip(u, 0.0, 1.0)
        return inside if self is TimeLaw.LINEAR else np.asarray(betaincinv(3.0, 3.0, inside))


def as_time_law(value: TimeLaw | str) -> TimeLaw:
    """A TimeLaw from its name."""
    if isinstance(value, TimeLaw):
        return value
    try:
        return TimeLaw(value)
    except ValueError:
        raise UnknownNameError("time law", str(value), (law.value for law in TimeLaw)) from None
