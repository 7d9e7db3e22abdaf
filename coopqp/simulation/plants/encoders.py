"""Encoders: joint positions with noise, latency and losses."""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.spatial import Array


@final
class Encoders:
    """Measured configurations under the noise, latency, losses and jitter of :class:`Disturbances`."""

    def __init__(self, cell: RobotCell, disturbances: Disturbances) -> None:
        self._cell, self._disturbances = cell, disturbances
        self.reset(pin.neutral(cell.model))

    def reset(self, q: Array) -> Array:
        """Start at rest at ``q`` (nq,), at time 0, with reseeded random numbers. Returns the measured configuration."""
        self._rng = np.random.default_rng(self._disturbances.seed)
        self._time = 0.0
        self._history: deque[tuple[float, Array]] = deque([(0.0, q)])
        self._seen = self._noisy(q)
        return self._seen

    def read(self, q: Array, dt: float) -> Array:
        """Measured configuration (nq,), ``dt`` seconds after the last reading, with the joints at ``q`` (nq,)."""
        d = self._disturbances
        self._time += dt
        self._history.append((self._time, q))
        while len(self._history) > 1 and self._history[1][0] <= self._time - d.latency + 1e-12:
            self._history.popleft()
        new = self._noisy(self._history[0][1])
        if d.drop_share > 0.0:
            lost = self._rng.random(len(self._cell)) < d.drop_share
            if not d.drops_by_arm:
                lost[:] = lost[0]
            for s in np.flatnonzero(lost):
                new[self._cell.q_slices[s]] = self._seen[self._cell.q_slices[s]]
        self._seen = new
        return new

    def period(self, nominal: float) -> float:
        """Length of the next step [s], with jitter."""
        jitter = self._disturbances.dt_jitter
        return nominal * (1.0 + float(self._rng.uniform(-jitter, jitter))) if jitter > 0.0 else nominal

    def _noisy(self, q: Array) -> Array:
        noise = self._disturbances.encoder_noise
        if noise == 0.0:
            return np.array(q)
        return np.asarray(pin.integrate(self._cell.model, q, self._rng.uniform(-noise, noise, self._cell.nv)))
