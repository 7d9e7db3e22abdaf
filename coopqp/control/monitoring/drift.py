"""Calibration errors of the cell and arms out of step: two causes of a deviation of one arm from the others.

If a base is not exactly at its modelled place, arms in a rigid grip seem to drift apart as the object moves and turns:
slowly, at rest as in motion. An arm that lags deviates by its speed times the lag. So the model of a deviation is
``d = b + c s`` with the speed s of the joints, a slow drift b and a constant lag c. A Kalman filter separates them. The
remainder d − b is out of step.
"""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.native.constants import (
    DRIFT_FLOOR,
    DRIFT_PERIOD,
    DRIFT_SAMPLE,
    GROWS,
    LAG,
    LARGEST_SLOPE,
    LEAST_LAG,
    SMOOTHING,
    WANDER,
)
from coopqp.spatial import Array, Flags


def from_others(holds: Flags) -> Array:
    """Maps values of the arms to their differences from the mean of the other arms that hold (N, N).

    Of an arm that does not hold it is 0, as of one that holds alone. ``holds`` (N,) tells which do.
    """
    n = int(holds.sum())
    out: Array = np.diag(holds.astype(float)) - np.outer(holds, holds) / max(n, 1)
    return out * (n / max(n - 1.0, 1.0) if n > 1 else 0.0)


def mean_where(holds: Flags, values: Array) -> Array:
    """The mean of the values (N, …) of the arms that hold; 0 where none does."""
    out: Array = values[holds].mean(axis=0) if holds.any() else np.zeros(values.shape[1:])
    return out


def carried_drift(values: Array, drift: Array, before: Flags, now: Flags) -> Array:
    """The drift (N, 6) of arms where others hold than before.

    With it those that go on are as far out of step as they were, and one that attaches is not.

    Args:
        values: of each arm (N, 6) [m].
        drift: of the values' differences from the mean of the others, until now (N, 6) [m].
        before, now: which arms hold (N,).
    """
    held, go_on = int(before.sum()), before & now
    base = (held - 1.0) / max(held, 1) * drift if held > 1 else np.zeros_like(drift)
    rest = mean_where(go_on, values - base)
    return from_others(now) @ np.where(go_on[:, None], base, values - rest)


@final
class Drift:
    """The drift of each arm from the others; all arms share the variances, since all have one speed.

    Args:
        n: arms.
        largest: largest tolerated drift of an arm along each axis [m].
    """

    def __init__(self, n: int, largest: float) -> None:
        self._n, self._largest = n, largest
        self.reset()

    def reset(self) -> None:
        """Forget drift and lag."""
        self._drift, self._lag, self._apart = np.zeros((3, self._n, 6))
        self._speed, self._since = 0.0, 0.0
        self._last: Array | None = None
        #: The motion of the arms in the last sample of rigid grips [rad or m].
        self.way = 0.0
        self._bb, self._bc, self._cc = 0.0, 0.0, LAG**2  # variances and covariance of drift and lag

    def take_over(self, deviation: Array, before: Flags, now: Flags) -> None:
        """Other arms hold than before: see :func:`carried_drift`. The lag is learnt anew.

        Args:
            deviation: of each arm from its command (N, 6) [m].
            before, now: which arms hold (N,).
        """
        drift = carried_drift(deviation, self._drift, before, now)
        self._drift = np.clip(drift, -self._largest, self._largest)
        self._lag, self._apart = np.zeros_like(self._lag), from_others(now) @ deviation
        self._cc, self._bc = LAG**2, 0.0

    def without(self, apart: Array, noise: float, commanded: Array, dt: float) -> Array:
        """Distances ``apart`` (N, 6) [m] without the drift.

        Args:
            apart: of each arm from the others.
            noise: root mean square of the noise in them [m].
            commanded: positions (nv,) [rad or m].
            dt: time since the last sample [s].
        """
        self._since += dt
        if self._last is None:
            self._last = commanded
        elif self._since >= DRIFT_PERIOD:
            way = float(np.abs(commanded - self._last).max())  # joints counted with a lever of 1 m
            self._last = commanded
            self._update(apart, noise, way / self._since, LARGEST_SLOPE * way, self._since)
            self._since = 0.0
        return apart - self._drift

    def followed(self, apart: Array, commanded: Array, dt: float) -> Array:
        """Distances without a drift that follows them at once, by a share of the arms' motion, and of time, at most.

        For rigid grips, whose distances are loop residuals: no lag is in them, but the object may grow.
        """
        way = 0.0 if self._last is None else float(np.abs(commanded - self._last).max())
        self._last, self.way = commanded, way
        off = apart - self._drift
        fastest = float(np.abs(off).max())
        self._drift = self._drift + off * min((LARGEST_SLOPE * way + GROWS * dt) / max(fastest, 1e-300), 1.0)
        self._drift = np.clip(self._drift, -self._largest, self._largest)
        return apart - self._drift

    def _update(self, apart: Array, noise: float, speed: float, most: float, dt: float) -> None:
        """One step of the filter; the drift grows by no more than ``most`` [m]."""
        new = dt / (SMOOTHING + dt)
        self._apart = self._apart + new * (apart - self._apart)
        self._speed += new * (speed - self._speed)
        s = self._speed
        self._bb += WANDER**2 * dt
        hb, hc = self._bb + self._bc * s, self._bc + self._cc * s  # P h with h = (1, s)
        scale = 1.0 / (hb + hc * s + (DRIFT_FLOOR**2 + noise**2) * DRIFT_SAMPLE / dt)
        innovation = self._apart - self._drift - s * self._lag
        change, drift = scale * hb * innovation, self._drift
        towards_zero = np.where(change * drift < 0.0, change, 0.0)
        shrunk = np.clip(towards_zero, -np.abs(drift), np.abs(drift))
        growth = change - shrunk
        fastest = float(np.abs(growth).max())
        too_fast = fastest > most
        if too_fast:
            growth *= most / fastest
        self._drift = np.clip(drift + shrunk + growth, -self._largest, self._largest)
        self._lag = self._lag + scale * hc * innovation
        self._bb = max(self._bb - scale * hb * hb, 0.0)
        self._bc -= scale * hb * hc
        self._cc = max(self._cc - scale * hc * hc, LEAST_LAG**2)
        if too_fast:  # for a drift: the lag may have changed
            self._cc = LAG**2
