"""Self-motion that leads joints away from their limits, judged by Pinocchio's Jacobian and its singular vectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from cells import on_another_joint

from coopqp import Grasp, RobotCell
from coopqp.control.lookahead.redundancy import LimitAvoidance
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.native.constants import LIMIT_MARGIN, TURNING_WAY
from coopqp.spatial import Array


def on_a_turntable() -> RobotCell:
    """An arm of eight joints, with other speeds for each."""
    arm = on_another_joint("arm", pin.JointModelRZ(), pin.SE3.Identity())
    return RobotCell([arm]).with_limits(velocity=np.linspace(0.5, 2.0, 8))


def self_motions(cell: RobotCell, q: Array) -> Array:
    """Orthonormal self-motions (n, n − 6) in units of the joints' speeds."""
    J = CellState(cell, q).jacobian(0) * cell.limits.velocity
    return np.linalg.svd(J)[2][6:].T


def wanted(cell: RobotCell, q: Array, slope: Array) -> tuple[Array, Array, Array]:
    """The bounds of the slopes as the class states them, and how far each slope is beyond them in its joint's unit."""
    speeds, x = cell.limits.velocity, cell.positions(q)
    S = (np.abs(slope) / speeds).max()
    up = S * speeds * (cell.limits.upper - x - LIMIT_MARGIN) / TURNING_WAY
    down = -S * speeds * (x - cell.limits.lower - LIMIT_MARGIN) / TURNING_WAY
    return down, up, np.maximum(slope - up, down - slope) / speeds


@pytest.mark.parametrize("robot", ["arm7", "eight joints"])
def test_the_joint_that_is_worst_off_is_led_away_by_the_least_self_motion(
    robot: str, make_cell: Callable[..., RobotCell], random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    cell = make_cell(["arm7"]) if robot == "arm7" else on_a_turntable()
    chain = Chain(cell, Grasp((pin.SE3.Identity(),)))
    avoidance, led = LimitAvoidance(chain), 0
    for _ in range(150):
        x = cell.positions(random_q(cell, rng))
        near = rng.random(cell.nv) < 0.4
        gaps = rng.uniform(0.0, 1.5 * TURNING_WAY, cell.nv)
        ends = np.where(rng.random(cell.nv) < 0.5, cell.limits.upper - gaps, cell.limits.lower + gaps)
        x = np.where(near & np.isfinite(ends), ends, x)
        q = cell.configuration(x)
        chain.evaluate(q, np.zeros(3))
        chain.invert()
        before = rng.normal(size=cell.nv) * cell.limits.velocity
        slope = avoidance.led_away(x, before)
        down, up, beyond = wanted(cell, q, before)
        own, changed = self_motions(cell, q), (slope - before) / cell.limits.velocity
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0:
            np.testing.assert_array_equal(slope, before)
            continue
        way = own @ own[worst]
        if way[worst] < 1e-3:
            continue
        led += 1
        assert np.abs(CellState(cell, q).jacobian(0) @ (slope - before)).max() < 1e-9
        size = changed @ way / (way @ way)
        np.testing.assert_allclose(changed, size * way, atol=1e-9)
        moved = np.abs(way) > 1e-3 * way[worst]
        # Sizes that bring each joint inside its bounds; the least of them, or the middle where they contradict.
        ratios = np.sort(np.array([down - before, up - before])[:, moved] / (cell.limits.velocity * way)[moved], axis=0)
        low, high = ratios[0].max(), ratios[1].min()
        assert size == pytest.approx(0.5 * (low + high) if low > high else min(max(0.0, low), high), rel=1e-6, abs=1e-9)
    assert led > 30
