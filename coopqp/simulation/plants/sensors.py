"""What a plant measures: joint positions and wrenches with noise, latency and losses."""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.forces.wrist_sensor import SensorMaps, WristSensor
from coopqp.model.cell import RobotCell
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.spatial import Array

#: Ratio of torques to forces, for noise and bias [m].
_LEVER = 0.1


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


@final
class WrenchSensors:
    """Measured wrenches under the noise, bias, latency, losses and gains of :class:`Disturbances`."""

    def __init__(self, cell: RobotCell, disturbances: Disturbances) -> None:
        d = self._disturbances = disturbances
        self._size = np.array([1.0] * 3 + [_LEVER] * 3)
        self._gain = np.array([d.wrench_gain.get(name, 1.0) for name in cell.arm_names])[:, None]
        self._arms = len(cell)
        self._maps = SensorMaps(cell, d.sensors)
        own = [d.sensors.get(name, WristSensor()).delay for name in cell.arm_names]
        self._late = d.wrench_latency + np.array(own)
        self.reset()

    def reset(self) -> None:
        """Start at time 0 with reseeded random numbers."""
        self._rng = np.random.default_rng([self._disturbances.seed, 1])
        self._bias = self._disturbances.wrench_bias * self._size * self._directions()
        self._history: deque[tuple[float, Array]] = deque()

    def _directions(self) -> Array:
        """Random directions of length 1, for forces and torques (N, 6)."""
        parts = self._rng.normal(size=(self._arms, 2, 3))
        return (parts / np.linalg.norm(parts, axis=2, keepdims=True)).reshape(-1, 6)

    def read(self, wrenches: Array, time: float) -> Array:
        """Measured wrenches (N, 6) [N, N·m] at a time [s], from the real ones; NaN for an arm whose wrench is lost."""
        d = self._disturbances
        self._history.append((time, self._maps.readings(wrenches)))
        while len(self._history) > 1 and self._history[1][0] <= time - self._late.max() + 1e-12:
            self._history.popleft()
        out = self._gain * self._heard(time) + self._bias
        if d.wrench_noise > 0.0:
            out = out + d.wrench_noise * self._size * self._rng.normal(size=(self._arms, 6))
        if d.wrench_drop_share > 0.0:
            out[self._rng.random(self._arms) < d.wrench_drop_share] = np.nan
        return np.array(out)

    def _heard(self, time: float) -> Array:
        """The readings (N, 6) that have arrived at a time, each as late as its sensor is."""
        times = np.array([at for at, _ in self._history])
        last = np.searchsorted(times, time - self._late + 1e-12, side="right") - 1
        return np.array([self._history[i][1][k] for k, i in enumerate(np.maximum(last, 0))])
