"""Self-motion that leads joints away from their limits, judged by Pinocchio's Jacobian and its singular vectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from cells import on_another_joint

from coopqp import Grasp, QPController, Robot, RobotCell, ServoPath, Status
from coopqp.control.lookahead.redundancy import LimitAvoidance
from coopqp.errors import MissingExtraError
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.native.constants import LIMIT_MARGIN, TURNING_WAY
from coopqp.scenarios import robot_data_path
from coopqp.simulation import tool_placements
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
    avoidance, led, contradicted = LimitAvoidance(chain), 0, 0
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
        # Sizes that bring each joint inside its bounds; the least of them, or the least excess where they contradict.
        unit = cell.limits.velocity[moved]
        ratios = np.sort(np.array([down - before, up - before])[:, moved] / (unit * way[moved]), axis=0)
        low, high = ratios[0].max(), ratios[1].min()
        if low <= high:
            assert size == pytest.approx(min(max(0.0, low), high), rel=1e-6, abs=1e-9)
            continue
        sizes = size + np.array([0.0, -1e-6, 1e-6])
        slopes = before[moved] + sizes[:, None] * (unit * way[moved])
        excess = (np.maximum(slopes - up[moved], down[moved] - slopes) / unit).max(axis=1)
        assert excess[0] <= excess[1:].min()
        contradicted += 1
    assert led > 30
    assert contradicted > 10


def test_an_object_comes_back_from_a_target_out_of_reach() -> None:
    """Two joints at their limits contradicted each other, and on the way back, too, one was led further out."""
    try:
        file = robot_data_path("g1_29dof_rev_1_0.urdf")
    except MissingExtraError:
        pytest.skip("the extra robots is not installed")
    joints = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
    legs = {f"{side}_{joint}_joint": 0.0 for side in ("left", "right") for joint in joints}
    tools = {"left": "left_wrist_yaw_link", "right": "right_wrist_yaw_link"}
    cell = RobotCell([Robot(file, tools, name="g1", geometry=False, acceleration_limits=10.0, locked_joints=legs)])
    q = cell.configuration([
        -0.84275, -0.20978, -0.26881, -1.11169, -0.14974, 0.76688, 1.4283, -0.70101, 0.15391, 0.51131, -1.20536,
        -0.36352, 1.44892, 1.06652, -0.33621, -0.11561, -0.2564,
    ])  # fmt: skip
    held = tool_placements(cell, [q])[0]
    start = pin.SE3(np.eye(3), np.mean([T.translation for T in held], axis=0))
    grasp = Grasp(tuple(start.inverse() * T for T in held))
    controller = QPController(cell, grasp, ServoPath(start, speed=0.3, spin=1.0), dt=0.004)
    controller.reset(q)
    controller.step()
    for target, status, angle in ((pin.exp3(np.array([0.0, 0.0, 3.0])), Status.BLOCKED, 132.0), (np.eye(3), None, 0.0)):
        controller.retarget(pin.SE3(target, start.translation))
        for _ in range(1500):
            step = controller.step()
        assert step.status is (status or Status.TRACKING)
        turned = np.rad2deg(np.linalg.norm(pin.log3(controller.path.pose(step.clock_next).rotation)))
        assert turned == pytest.approx(angle, abs=3.0)
