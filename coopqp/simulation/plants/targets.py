"""Joint targets of the servos: interpolated between commands, with lag or stall on request."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.simulation.plants.physics_options import Interpolation
from coopqp.spatial import Array

#: Largest difference of equal times [s].
_SAME_TIME = 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class _Segment:
    """One command: a cubic (or a line) from position and velocity at ``start`` to position and velocity at ``end``."""

    start: float
    end: float
    x0: Array
    v0: Array
    x1: Array
    v1: Array
    straight: bool
    _shape: tuple[Array, Array, Array] = field(init=False)  # the mean velocity, and how far v0 and v1 are from it

    def __post_init__(self) -> None:
        mean = (self.x1 - self.x0) / (self.end - self.start)
        object.__setattr__(self, "_shape", (mean, self.v0 - mean, self.v1 - mean))

    def at(self, t: float) -> tuple[Array, Array]:
        """Position and velocity at ``t``. After the end: the last position, at rest."""
        h = self.end - self.start
        if t > self.end + 1e-6 * h:
            return self.x1, np.zeros_like(self.x1)
        s = min(max((t - self.start) / h, 0.0), 1.0)
        mean, bend, twist = self._shape
        x, v = self.x0 + (s * h) * mean, mean
        if not self.straight:
            r = 1.0 - s
            x += (h * s * r * r) * bend - (h * s * s * r) * twist
            v = mean + (r * (1.0 - 3.0 * s)) * bend + (s * (3.0 * s - 2.0)) * twist
        return x, v

    def acceleration(self, t: float) -> Array:
        """Acceleration at ``t``; zero on a line and after the end."""
        h = self.end - self.start
        if self.straight or t > self.end + 1e-6 * h:
            return np.zeros_like(self.x1)
        s = min(max((t - self.start) / h, 0.0), 1.0)
        _, bend, twist = self._shape
        return ((6.0 * s - 4.0) * bend + (6.0 * s - 2.0) * twist) / h


@final
class JointTargets:
    """Target positions and velocities (nv,) over time, from commands that arrive one by one.

    There is one position per joint [rad or m]. Positions of continuous joints count beyond ±π.

    A cubic segment starts with the end velocity of the last segment. Its end velocity is extrapolated from the mean
    velocities of both segments: smooth commands are interpolated to third order, without the next command.
    """

    def __init__(
        self, cell: RobotCell, *, interpolation: Interpolation, lag: Mapping[str, float], stall: Mapping[str, float]
    ) -> None:
        self._cell, self._straight = cell, interpolation == "linear"
        self._lag = [(cell.v_slices[cell.index(name)], tau) for name, tau in lag.items() if tau > 0.0]
        self._stall = [(cell.v_slices[cell.index(name)], time) for name, time in stall.items()]
        self.reset(pin.neutral(cell.model))

    def reset(self, q: Array, near: Array | None = None) -> None:
        """Rest at the configuration ``q`` (nq,) at time 0.

        Continuous joints are within half a turn of ``near`` (nv,), or in (−π, π].
        """
        self._q = np.array(q)
        x = self._cell.positions(self._q)
        if near is not None:
            own = self._cell.continuous
            x[own] += 2.0 * np.pi * np.round((near[own] - x[own]) / (2.0 * np.pi))
        zero = np.zeros_like(x)
        self._segment = _Segment(-1.0, 0.0, x, zero, x, zero, True)
        self._mean, self._span = zero, 1.0
        self._lagged, self._last, self._last_time = x.copy(), x.copy(), 0.0  # _last: targets without lag at that time
        self._frozen: dict[int, Array] = {}

    @property
    def end(self) -> float:
        """End time of the last command [s]."""
        return self._segment.end

    def push(self, q_next: Array, dt: float) -> None:
        """Add a command: reach ``q_next`` (nq,) in ``dt`` seconds."""
        last = self._segment
        # Start at the last target, even if the controller starts at another (the measured) configuration.
        way = pin.difference(self._cell.model, self._q, q_next)
        mean = way / dt
        slope = (mean - self._mean) / (0.5 * (dt + self._span))
        self._segment = _Segment(
            last.end, last.end + dt, last.x1, last.v1, last.x1 + way, mean + 0.5 * dt * slope, self._straight
        )
        self._mean, self._span, self._q = mean, dt, np.array(q_next)

    def at(self, t: float) -> tuple[Array, Array]:
        """Position and velocity (nv,) at ``t`` [s] within the last command. ``t`` must not decrease between calls."""
        x, v = self._segment.at(t)
        if self._lag or self._stall:
            x, v = x.copy(), v.copy()
        passed, self._last_time = t - self._last_time, t
        for s, tau in self._lag:  # ẋ = (target − x) / τ with a linear target since the last call
            now = x[s].copy()
            if passed > 0.0:
                behind = tau / passed * (now - self._last[s])  # in the long run
                self._lagged[s] = now - behind + np.exp(-passed / tau) * (self._lagged[s] - self._last[s] + behind)
            self._last[s] = now
            x[s], v[s] = self._lagged[s], (now - self._lagged[s]) / tau
        for s, time in self._stall:
            if t >= time - _SAME_TIME:
                x[s] = self._frozen.setdefault(s.start, x[s].copy())
                v[s] = 0.0
        return x, v

    def acceleration(self, t: float) -> Array:
        """Acceleration (nv,) at ``t`` [s] within the last command; zero for arms with lag, and for stalled ones."""
        a = self._segment.acceleration(t)
        for s, _ in self._lag:
            a[s] = 0.0
        for s, time in self._stall:
            if t >= time - _SAME_TIME:
                a[s] = 0.0
        return a
