"""Supervision: what noise makes of the thresholds, whatever the length of a step."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp import QPController
from coopqp.controllers.supervision import Supervision, SupervisionOptions
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array


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


def test_an_arm_that_turns_round_late_has_not_stalled() -> None:
    """Seen late, an arm whose joints reverse stands while its command moves already, and others follow theirs."""
    cell = paper_lift().cell
    watch = Supervision(cell, SupervisionOptions())
    late, amplitude, still = 10, 0.05, np.zeros((3, 3))  # it turns with 2 rad/s²

    def at(t: float) -> Array:
        q = np.full(18, 0.3 * t)
        q[6:12] = amplitude * np.cos(2.0 * np.pi * t)  # slave_1 turns round at 0.5 s
        return q

    for i in range(1000):
        seen = watch.watch(at(1e-3 * max(i - late, 0)), at(1e-3 * i), still, still, 1e-3)
        assert not seen.hold, f"{i} ms: {seen.reason}"


@pytest.mark.parametrize("speed", [0.06, 0.3, 1.0])
def test_a_stall_is_known_once_it_opens_a_gap(speed: float) -> None:
    """Within the samples that it takes, and those in which a joint gets 0.5 mrad from its command."""
    watch = Supervision(paper_lift().cell, SupervisionOptions())
    still, stalls = np.zeros((3, 3)), 100
    for i in range(200):
        command = np.full(18, 1e-3 * i * speed)
        measured = command.copy()
        measured[12:] = 1e-3 * min(i, stalls) * speed
        seen = watch.watch(measured, command, still, still, 1e-3)
        if seen.hold:
            break
    assert i - stalls == max(4, np.ceil(0.5 / speed))
    assert seen.arm == 2
    assert "stalled" in seen.reason
