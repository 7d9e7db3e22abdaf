"""Supervision: what noise makes of the thresholds, whatever the length of a step."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp import QPController
from coopqp.scenarios import paper_lift


@pytest.mark.parametrize("steps", [40, 41, 400])
def test_the_noise_margin_stays_a_number_for_long_steps(steps: int) -> None:
    lift = paper_lift()
    rng = np.random.default_rng(0)
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.path.duration / steps)
    controller.reset(lift.q_start)
    q = lift.q_start
    for _ in range(steps):
        step = controller.step(q + rng.uniform(-1e-4, 1e-4, size=q.size))
        q = step.q_next
        assert np.isfinite(controller._supervision._noise).all()
        assert (controller._supervision._noise >= 0.0).all()
