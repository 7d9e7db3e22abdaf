"""Supervision: the effect of noise on the thresholds is independent of the length of a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coopqp import InvalidInputError, QPController, Status, SupervisionOptions
from coopqp.scenarios import paper_lift

pytestmark = pytest.mark.core


@pytest.mark.slow
@pytest.mark.parametrize("steps", [40, 41, 100, 400])
def test_the_noise_margin_stays_a_number_for_long_steps(steps: int) -> None:
    """Noise holds no step, whoever runs it, and after it the watch still sees an arm that is not where it should be."""
    lift = paper_lift()
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.path.duration / steps)
    controller.reset(lift.q_start)
    q, rng = lift.q_start, np.random.default_rng(0)
    for _ in range(steps):
        step = controller.step(q + rng.uniform(-1e-4, 1e-4, size=q.size))
        q = step.q_next
        assert step.status is Status.TRACKING, step.explain()
    if steps < 100:
        return  # such steps are too long to tell arms that are apart from noise
    for _ in range(10):
        step = controller.step(q + np.repeat([0.0, 0.01, 0.0], 6) + rng.uniform(-1e-4, 1e-4, size=q.size))
    assert step.status is Status.HOLDING
    assert "arm slave_1" in step.reason


@pytest.mark.parametrize(
    "options",
    [
        {"stiffness": 0.0},
        {"stiffness": np.nan},
        {"stiffness": (1e5, -1.0)},
        {"stiffness": 1e5, "force_limit": 0.0},
        {"stiffness": 1e5, "servo_delay": -1e-3},
    ],
)
def test_bad_stiffness_and_limits_are_named(options: dict[str, Any]) -> None:
    with pytest.raises(InvalidInputError, match="SupervisionOptions"):
        SupervisionOptions(**options)


NOT_POSITIVE = (0.0, -1.0, np.nan, np.inf, None, "far", [1.0])
NEGATIVE = NOT_POSITIVE[1:]


@pytest.mark.parametrize(
    ("option", "bad", "good"),
    [
        *((name, NOT_POSITIVE, (1.0, 1e-9)) for name in ("fault_from", "silent_time", "joint_jump", "force_limit")),
        ("hold_from", NOT_POSITIVE, (0.00025, 1.0)),
        ("slow_from", (*NOT_POSITIVE[:4], 0.0008), (None, 1e-9, 0.00075)),
        *(
            (name, NEGATIVE, (0.0, 1.0))
            for name in ("servo_delay", "filter_time", "noise_margin", "recovery_time", "let_in")
        ),
        ("stall_share", (*NOT_POSITIVE, 1.1), (1e-9, 1.0)),
        ("stall_samples", (0, -1, 1.5, "four", 10_001), (None, 1, 10_000)),
        ("dt_range", (0.5, (0.5,), (0.0, 5.0), (1.1, 5.0), (0.1, 0.9), (0.1, np.inf), None), ((1.0, 1.0), (0.1, 9.0))),
    ],
)  # fmt: skip
def test_an_option_out_of_range_is_named(option: str, bad: tuple[Any, ...], good: tuple[Any, ...]) -> None:
    for value in bad:
        with pytest.raises(InvalidInputError, match=f"SupervisionOptions: {option}"):
            SupervisionOptions(**{option: value})
    for value in good:
        assert getattr(SupervisionOptions(**{option: value}), option) == value
