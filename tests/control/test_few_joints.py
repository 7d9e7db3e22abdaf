"""Arms with fewer than six joints make only what is possible for all of them, and stay together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from marks import slow_but_first
from promise_cases import chain_cells

from coopqp import LinePath, QPController
from coopqp.control.step.linearised import closing
from coopqp.scenarios import Scenario, five_joint_pair, scara_pair

#: As far as the arms may be apart, as commanded [m].
TOGETHER = 5e-5


def projector(rng: np.random.Generator, rank: int) -> np.ndarray:
    Q, _ = np.linalg.qr(rng.normal(size=(6, rank)))
    return Q @ Q.T


@pytest.mark.parametrize("ranks", [(5, 5), (4, 5), (5, 5, 5), (5, 3)])
def test_twists_are_closed_by_a_common_one(ranks: tuple[int, ...], rng: np.random.Generator) -> None:
    """What a common twist and one of each arm's own make can be followed; their differences stay."""
    ranges = [(k, projector(rng, rank)) for k, rank in enumerate(ranks)]
    own = np.array([P @ rng.normal(size=6) for _, P in ranges] + [rng.normal(size=6)])  # the last arm has six joints
    wanted = own + rng.normal(size=6)
    kept = wanted.copy()
    closed = closing(wanted, ranges)
    np.testing.assert_array_equal(wanted, kept)
    np.testing.assert_allclose(closed - closed[0], wanted - wanted[0], atol=1e-9)
    for k, P in ranges:
        np.testing.assert_allclose(P @ closed[k], closed[k], atol=1e-12)


def test_what_no_common_twist_closes_is_taken_away(rng: np.random.Generator) -> None:
    P = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 1.0])  # two arms that tilt nothing
    wanted = rng.normal(size=(2, 6))
    closed = closing(wanted, [(0, P), (1, P)])
    np.testing.assert_allclose((closed - closed[0])[1], P @ (wanted[1] - wanted[0]), atol=1e-12)
    assert np.abs(closed).max() < 2.0 * np.abs(wanted).max()


@pytest.mark.parametrize("rotation", slow_but_first([(0.0, 0.0, 0.3), (0.3, 0.0, 0.0), (0.0, 0.3, 0.0)]))
@pytest.mark.parametrize("make", slow_but_first([scara_pair, five_joint_pair]))
def test_a_path_that_they_cannot_follow_does_not_part_them(
    make: Callable[[], Scenario], rotation: tuple[float, float, float]
) -> None:
    """Version 0.1 parted them by 0.26 m."""
    task, dt = make(), 0.008
    path = LinePath.displaced(
        task.path.pose(0.0), translation=(0.03, 0.05, 0.06), rotation=rotation, duration=2.0, time_law="quintic"
    )
    given = chain_cells.Task(task.cell, task.grasp, path, task.q_start)
    made = chain_cells.run(QPController(task.cell, task.grasp, path, dt=dt), given, 300)
    assert made.apart <= TOGETHER


@pytest.mark.parametrize("acceleration", slow_but_first([5.0, None]))
@pytest.mark.parametrize("seed", slow_but_first([2, 0, 4]))
def test_random_arms_stay_together(seed: int, acceleration: float | None) -> None:
    """Of the definition alone: the core leaves arms with few joints to it."""
    task, dt = chain_cells.few_joints(seed, acceleration), 0.008
    steps = int(1.1 * task.path.duration / dt)
    made = chain_cells.run(QPController(task.cell, task.grasp, task.path, dt=dt), task, steps, every=2)
    assert made.apart <= TOGETHER
