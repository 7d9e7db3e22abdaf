"""A4: a joint stops inside its limit from every state from which it can."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from checks import DRIVES, box_stops, controller_overshoot
from runs import cooperative

STEPS = (0.001, 0.002, 0.01)  # [s]
OVERSHOOT = 1e-12  # [rad]


@pytest.mark.slow
@pytest.mark.parametrize("dt", STEPS)
def test_any_choice_from_the_box_stops_inside(
    dt: float, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    n = count(40_000)
    found = {how: box_stops(rng, dt, n, how) for how in DRIVES}
    catalogue.row(
        "A4",
        f"stopping distance, dt = {1e3 * dt:g} ms: overshoot",
        cases=n * len(DRIVES),
        measured=max(s.overshoot for s in found.values()),
        target=OVERSHOOT,
        unit="rad",
    )
    assert max(s.velocity for s in found.values()) <= 1e-12
    assert max(s.acceleration for s in found.values()) <= 1e-9
    # The box is not too narrow: joints that move outward arrive at the limit.
    assert found["outward"].unused < 0.05


@pytest.mark.parametrize("dt", [*(pytest.param(dt, marks=pytest.mark.slow) for dt in STEPS[:-1]), STEPS[-1]])
def test_the_controllers_own_commands_stop_inside(
    dt: float, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    worst, steps, touching = controller_overshoot(cooperative, rng, dt, count(12))
    assert touching > 0.1 * steps
    catalogue.row(
        "A4",
        f"three arms into their limits, dt = {1e3 * dt:g} ms: overshoot",
        cases=steps,
        measured=max(worst, 0.0),
        target=OVERSHOOT,
        unit="rad",
        note=f"{100 * touching / steps:.0f} % of the steps within 0.1 mrad of a limit",
    )
