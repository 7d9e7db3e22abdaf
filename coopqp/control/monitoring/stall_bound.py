"""How far arms may part when one of them stalls bounds the speed of the object.

An arm that stalls is known n samples later; only then do the others brake together, in T = max |q̇|/a, and go on by v
T/2. So they part from it by ``v T/2 + n dt v`` at the grasps, v the speed of the fastest grasp, and rest n dt + T
after the stall; v and T are those of the moment when it is known. At the rate σ both are proportional to σ: the bound
of the distance is a quadratic for the largest σ.
"""

from __future__ import annotations

import math
from typing import Any, final

import numpy as np

from coopqp.checks import as_count, as_scalar, as_step
from coopqp.control.monitoring.options import SupervisionOptions
from coopqp.spatial import Array


@final
class StallBound:
    """A rate bound (:class:`coopqp.RateBound`) that keeps the arms within a distance when one of them stalls.

    Give it to ``QPController(constraints=[…])`` or ``coopqp.planning.time_path(bounds=[…])``. Between knots, and on
    curved paths, the arms may part by 5 % more.

    Args:
        distance: from the arm that stalls to where the others carry its grasp [m].
        dt: length of the controller's steps [s].
        samples: number of samples after which a stall is known; by default 5, as with default ``SupervisionOptions``.
        name: how ``ControlStep.binding`` calls it.

    Raises:
        InvalidInputError: bad arguments.
    """

    def __init__(self, distance: float, *, dt: float, samples: int | None = None, name: str = "stall") -> None:
        self.distance, self.dt = as_scalar(distance, "StallBound: distance"), as_step(dt, "StallBound: dt")
        known = 1 + (SupervisionOptions().stall_samples or 0) if samples is None else samples
        self.samples, self.name = as_count(known, "StallBound: samples"), name

    def lines(self, knot: Any) -> tuple[Array, Array, Array]:
        """``z ≤ σ²`` at a :class:`coopqp.Knot`, with the largest σ for which ``v T/2 + n dt v`` keeps the distance."""
        cell, slope = knot.state.cell, knot.slope
        speed = max(
            float(np.linalg.norm(knot.state.jacobian(k)[:3] @ slope[own])) for k, own in enumerate(cell.columns)
        )
        to_rest = float((np.abs(slope) / cell.limits.acceleration).max())
        known = self.samples * self.dt * speed  # distance per σ while the stall is not known
        if not known > 0.0:
            return np.zeros(0), np.zeros(0), np.zeros(0)
        rate = 2.0 * self.distance / (known + math.sqrt(known * known + 2.0 * speed * to_rest * self.distance))
        return np.ones(1), np.zeros(1), np.array([rate * rate])
