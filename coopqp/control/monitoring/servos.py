"""Arms whose servos do not stand where their wrenches say, and distances of arms whose grasps give way.

An arm of compliance C that pushes the object with ``w`` beside what its drives are fed forward stands ``C w / ρ`` off
its command, with ρ the servos' real stiffness over the given one. Where it stands elsewhere,

    ``r_k = away_k + C_k (w_k − S_k load) / ρ``,

its servos do not hold it: it has stalled, or its grip slips. A lag that all arms have is in the mean of the others.
Arms that share joints move each other by these: ``Σ_j C_kj (w_j − S_j load)`` is in the place of the second term.

Where the relaxation moves the grasps by d, a rigid grip keeps the arms from following, and the distance of the arms as
measured from as commanded parts by −d. So the arms are out of step by ``a_k = away_k + (d_k − d_k(reset))`` only. That
alone does not see a stalled arm, whose forces are relaxed; the servos do.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, final

import numpy as np

from coopqp.control.core.force_memory import RELAXING, SENSORS_FINE, minding_scalars, minding_views
from coopqp.control.monitoring.drift import carried_drift, from_others
from coopqp.control.monitoring.noise import noise_seen
from coopqp.native.constants import (
    CONTACT_ROOM,
    CONTACT_WAY,
    FEW_SAMPLES,
    HASTE_FILTER,
    LARGEST_SLOPE,
    NOISE_TIME,
    SERVO_HOLDS,
    SERVO_LATE,
    SERVO_PEAK,
    SERVO_SLOWS,
    SOFTEST,
)
from coopqp.spatial import Array, Flags


@final
class ServoWatch:
    """The comparison with the wrenches, in the memory of the relaxation (:class:`coopqp.forces.Relaxation`).

    Args:
        memory: numbers of :data:`coopqp.native.layout.Minding`, and the vectors behind them.
        names: of the arms.
        groups: arms that share joints, the indices of each group.
    """

    def __init__(self, memory: Array, names: tuple[str, ...], groups: Sequence[tuple[int, ...]] = ()) -> None:
        self._scalars, self._names, n = minding_scalars(memory), names, len(names)
        self._pairs = [pair for group in groups for pair in itertools.permutations(group, 2)]
        self._views = minding_views(memory, n)

    def take_over(self, before: Flags, now: Flags) -> None:
        """Other arms hold than before (N,)."""
        x = self._views
        x["off_drift"][:] = carried_drift(x["off_servos"], x["off_drift"], before, now)

    @property
    def minds(self) -> bool:
        """Whether the grips are rigid, so that there is something to compare."""
        return len(self._names) > 1 and self._scalars.rigid != 0.0

    @property
    def touches(self) -> bool:
        """Whether the object touches something."""
        return bool(self._scalars.touches)

    @property
    def backs(self) -> bool:
        """Whether the object goes back from what it touches."""
        return bool(self._scalars.backs and self._scalars.sensor_fault == SENSORS_FINE)

    def way_back(self, rotation: Array, common: Array, dt: float) -> Array:
        """The twist of the object that goes back, in its own frame (6,) [m/s, rad/s].

        Args:
            rotation: of the object on its path (3, 3).
            common: the object's error (6,) [m, rad].
            dt: length of the step [s].
        """
        way: Array = rotation.T @ self._views["push"][3]
        speed = _back_within_room(self._scalars, float(way @ common[:3]), dt)
        return np.concatenate([speed * way, np.zeros(3)])

    @property
    def corrects(self) -> float:
        """Share of the path correction that is made: none before the arms have relaxed."""
        share: float = self._scalars.corrects
        return share

    @property
    def shift(self) -> Array:
        """The motion by which each grasp has given way since the start, in the object frame (N, 6) [m, rad]."""
        moved: Array = self._views["shift"] - self._views["held"]
        return moved

    def hasten(self, velocity: Array, filtered: Array, dt: float) -> float:
        """The largest acceleration of a joint of late [rad/s² or m/s²].

        ``filtered`` (nv,) follows the commanded velocities (nv,) [rad/s or m/s] of a sample ``dt`` [s] after the last:
        the acceleration is filtered, so that a single step of arms that relax is none.
        """
        change = (velocity - filtered) / (HASTE_FILTER + dt)
        filtered += dt * change
        m = self._scalars
        # While an arm is suspected the object slows down for that very reason, which must not excuse the arm.
        seen = 0.0 if m.suspected else float(np.abs(change).max())
        found: float = max(seen, m.haste * SERVO_PEAK / (SERVO_PEAK + dt))
        m.haste = found
        return found

    def watch(
        self,
        away: Array,
        lengths: Array,
        rotation: Array,
        hasty: float,
        *,
        holds: Flags,
        way: float,
        dt: float,
        filter_time: float,
        margin: float,
    ) -> tuple[float, int, float]:
        """Compare one sample.

        Args:
            away: of the object as each arm carries it, measured from commanded, in its own frame (N, 6) [m, rad].
            lengths: turns displacements of the object into lengths at the grasps (6, 6).
            rotation: of the object (3, 3).
            hasty: the largest acceleration of late [rad/s² or m/s²].
            holds: which arms hold the object (N,): these are compared.
            way: of the arms since the last sample [rad or m].
            dt, filter_time: time since the last sample, time constant of the filter [s].
            margin: noise floor, in root mean squares.

        Returns:
            The rate cap, the arm that is farthest from where its servos should stand, and its distance [m].
        """
        m, x = self._scalars, self._views
        if m.stage < RELAXING or m.sensor_fault != SENSORS_FINE:
            return 1.0, -1, 0.0
        off = (away + self._bent(rotation)) @ lengths
        fresh = dt / (filter_time + dt)
        noise = math.sqrt(dt / (2.0 * filter_time + dt)) * m.servo_noise  # this may be the first of a stall
        samples = m.servo_samples = min(m.servo_samples + 1.0, NOISE_TIME / dt)
        m.servo_noise = noise_seen(off, x["off_last"], x["off_step"], x["off_noise"], samples, holds)
        x["off_servos"] += fresh * (off - x["off_servos"])
        if samples < FEW_SAMPLES:
            return 1.0, -1, 0.0
        apart = from_others(holds) @ x["off_servos"]
        drifted = apart - x["off_drift"]  # where the load is shared otherwise
        x["off_drift"] += min(LARGEST_SLOPE * way / max(float(np.abs(drifted).max()), 1e-300), 1.0) * drifted
        apart = apart - x["off_drift"]
        far = np.linalg.norm(apart, axis=1)
        arm = int(far.argmax())
        # Softer servos than given deflect more for the same force; what their damping makes of it is as much larger.
        soft = min(max(m.stiffer, SOFTEST), 1.0)
        worst = soft * (float(far[arm]) - margin * noise) - SERVO_LATE * hasty
        m.suspected = worst > SERVO_SLOWS
        return min(max((SERVO_HOLDS - worst) / (SERVO_HOLDS - SERVO_SLOWS), 0.0), 1.0), arm, float(far[arm])

    def _bent(self, rotation: Array) -> Array:
        """Deflections of the servos under the wrenches, with the other sign (N, 6) [m, rad]."""
        m, x = self._scalars, self._views
        load = rotation.T @ np.array([m.weight_x, m.weight_y, m.weight_z])
        pushed = (x["unfed_of"] @ x["felt"].ravel() - x["carries"] @ load).reshape(-1, 6)
        own = np.einsum("kikj->kij", x["compliances"])
        bent: Array = np.einsum("kij,kj->ki", own, pushed) / max(m.stiffer, SOFTEST)
        for k, other in self._pairs:  # what one arm pushes moves the joints that the other shares with it
            bent[k] += x["compliances"][k, :, other] @ pushed[other] / max(m.stiffer, SOFTEST)
        return bent


def _back_within_room(m: Any, far: float, dt: float) -> float:
    """The speed at which an object goes back that is ``far`` from its path in that direction [m], in limited room."""
    if math.isnan(m.back_from):
        m.back_from = far
    room = CONTACT_ROOM + CONTACT_WAY * m.back_speed - (far - m.back_from)
    return float(min(m.backs, max(room, 0.0) / dt))
