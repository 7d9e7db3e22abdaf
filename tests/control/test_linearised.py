"""Parts of the linearised step: averages by shares, and corrections that are bounded by one factor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coopqp import LinePath, QPController, QPOptions
from coopqp.control.step.linearised import bounded, mean_error
from coopqp.model.chain import Chain
from coopqp.scenarios import paper_lift


def test_the_mean_is_that_of_each_axis_by_the_shares(rng: np.random.Generator) -> None:
    shares, errors = rng.uniform(size=(4, 6)), rng.normal(size=(4, 6))
    np.testing.assert_allclose(mean_error(shares, errors), (shares * errors).sum(axis=0), atol=1e-14)


@pytest.mark.parametrize(("speed", "spin"), [(0.1, 0.5), (0.5, 0.1), (1e-3, 2.0), (3.0, 3.0)])
@pytest.mark.parametrize("shape", [(6,), (3, 6)])
def test_corrections_are_bounded_by_one_factor_and_no_more_than_needed(
    speed: float, spin: float, shape: tuple[int, ...], rng: np.random.Generator
) -> None:
    shrunk = kept = 0
    for size in np.geomspace(1e-4, 30.0, 40):
        twists = size * rng.normal(size=shape) * np.repeat(rng.choice([[1.0, 1.0], [1.0, 0.01], [0.01, 1.0]]), 3)
        out = bounded(twists, speed, spin)
        use = np.array(
            [np.linalg.norm(out[..., :3], axis=-1).max() / speed, np.linalg.norm(out[..., 3:], axis=-1).max() / spin]
        )
        factor = out.ravel() @ twists.ravel() / (twists.ravel() @ twists.ravel())
        np.testing.assert_allclose(out, factor * twists, rtol=1e-12, atol=1e-300)
        assert use.max() <= 1.0 + 1e-12
        if factor < 1.0 - 1e-12:
            assert use.max() == pytest.approx(1.0)
            shrunk += 1
        else:
            np.testing.assert_array_equal(out, twists)
            kept += 1
    assert shrunk > 3
    assert kept > 3


def test_the_first_step_is_linearised_until_its_way_is_known_in_any_unit_of_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A short way takes fewer linearisations, each further step one; a slow path in long steps takes as many."""
    task, times, linearise = paper_lift(), [0], Chain.linearise

    def counted(chain: Chain, *args: Any, **options: Any) -> None:
        times[0] += 1
        linearise(chain, *args, **options)

    monkeypatch.setattr(Chain, "linearise", counted)
    cell = task.cell.with_limits(velocity=np.inf, acceleration=np.inf)
    for duration, expected in ((0.5, 4), (10.0, 3), (100.0, 2)):
        for unit in (1.0, 10.0, 100.0):
            path = LinePath(task.path.pose(0.0), task.path.pose(5.0), duration=duration * unit, time_law="linear")
            options = QPOptions(kernel="plain", preview=None)
            controller = QPController(cell, task.grasp, path, dt=0.002 * unit, options=options)
            controller.reset(task.q_start)
            for number in (expected, 1):
                times[0] = 0
                controller.step()
                assert times[0] == number, (duration, unit)
