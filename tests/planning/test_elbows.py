"""Elbows that the check of a path proves, and controllers that follow them."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from golden import Golden
from promise_cases.proofs import redundant_task

from coopqp import InvalidInputError, QPController, Status, check_path, simulate
from coopqp.paths.elbows import Elbows
from coopqp.planning import PathVerdict
from coopqp.scenarios import Scenario, dual_arm7


@pytest.mark.parametrize("seed", [45, 73, 160])
def test_elbows_that_are_proved_are_followed(seed: int, paper: Scenario) -> None:
    """Starts of redundant arms that are certified, and from which a controller's own rules are BLOCKED."""
    cell, grasp, path, q = redundant_task(np.random.default_rng([44, seed]))
    check = check_path(cell, grasp, path, q_start=q)
    assert check.verdict is PathVerdict.CERTIFIED
    led = check.led_path()
    assert led.elbows is not None
    assert led.elbows is not path.elbows
    controller = QPController(cell, grasp, led, dt=0.02)
    run = simulate(controller, q_start=q)
    assert run.finished
    assert not (run.status == Status.BLOCKED.code).any()
    x = np.array([cell.positions(row) for row in run.q])
    assert (x >= cell.limits.lower - 1e-6).all()
    assert (x <= cell.limits.upper + 1e-6).all()
    wished = np.array([led.elbows.at(clock)[0] for clock in run.clock.tolist()])
    assert np.abs(x - wished).max() < 0.05
    again = pickle.loads(pickle.dumps(led))
    np.testing.assert_array_equal(again.elbows.x, led.elbows.x)
    with pytest.raises(InvalidInputError, match="elbows are those of another cell"):
        QPController(paper.cell, paper.grasp, led, dt=0.02)


@pytest.mark.core
def test_elbows_are_followed_as_recorded(golden: Golden) -> None:
    task = dual_arm7(duration=1.0)
    led = check_path(task.cell, task.grasp, task.path, q_start=task.q_start).led_path()
    assert led.elbows is not None
    made = QPController(task.cell, task.grasp, led, dt=0.02)
    made.reset(task.q_start)
    golden.of(made).run(100)


def test_clocks_of_elbows_have_to_rise() -> None:
    x = np.zeros((3, 2))
    for clocks in ([0.0, 1.0, 1.0], [0.0, 1.0], [0.0, np.nan, 1.0]):
        with pytest.raises(InvalidInputError, match="the clocks do not rise"):
            Elbows.through(clocks, x)
    still = Elbows.through([0.0, 1.0, 2.0], [[0.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    np.testing.assert_allclose(still.at(1.5)[0], [1.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(still.at(1.5)[1], [1.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(still.at(9.0)[0], [2.0, 1.0])
