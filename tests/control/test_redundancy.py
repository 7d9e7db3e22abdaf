"""Self-motion that leads joints away from their limits, judged by Pinocchio's Jacobian and its singular vectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from cells import on_another_joint

from coopqp import Grasp, LinePath, QPController, Robot, RobotCell, ServoPath, Status
from coopqp.control.lookahead.redundancy import LimitAvoidance
from coopqp.errors import MissingExtraError
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.native.constants import LIMIT_MARGIN, TURNING_WAY
from coopqp.scenarios import robot_arm, robot_data_path
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


def bend(cell: RobotCell, q: Array, motion: Array, joint: int) -> float:
    """The second derivative of a joint's position along a self-motion (nv,), by finite differences of poses kept."""
    data, frame, h = cell.model.createData(), cell.tool_frames[0], 2e-4
    pin.framesForwardKinematics(cell.model, data, q)
    held, ends = data.oMf[frame].copy(), []
    for side in (h, -h):
        moved = cell.moved(q, side * motion)
        for _ in range(4):
            J = pin.computeFrameJacobian(cell.model, data, moved, frame, pin.LOCAL) * cell.limits.velocity
            pin.framesForwardKinematics(cell.model, data, moved)
            off = pin.log6(data.oMf[frame].actInv(held)).vector
            moved = cell.moved(moved, cell.limits.velocity * (np.linalg.pinv(J) @ off))
        ends.append(pin.difference(cell.model, q, moved)[joint])
    return float(sum(ends)) / h**2


@pytest.mark.parametrize("robot", ["arm7", "eight joints"])
def test_the_joint_that_is_worst_off_is_led_away_by_the_least_self_motion(
    robot: str, make_cell: Callable[..., RobotCell], random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    cell = make_cell(["arm7"]) if robot == "arm7" else on_a_turntable()
    chain = Chain(cell, Grasp((pin.SE3.Identity(),)))
    avoidance, led, contradicted, bending = LimitAvoidance(chain), 0, 0, 0
    for _ in range(250):
        x = cell.positions(random_q(cell, rng))
        near = rng.random(cell.nv) < 0.4
        if robot == "arm7" and rng.random() < 0.8:
            x[2], near[1] = 0.05 * rng.normal(), True  # the elbow near its arm's plane, where joint_2 bends
        gaps = rng.uniform(0.0, 1.5 * TURNING_WAY, cell.nv)
        ends = np.where(rng.random(cell.nv) < 0.5, cell.limits.upper - gaps, cell.limits.lower + gaps)
        x = np.where(near & np.isfinite(ends), ends, x)
        q = cell.configuration(x)
        chain.evaluate(q, np.zeros(3))
        chain.invert()
        before = rng.normal(size=cell.nv) * cell.limits.velocity
        slope = avoidance.led_away(x, before)
        down, up, beyond = wanted(cell, q, before)
        basis, changed = self_motions(cell, q), (slope - before) / cell.limits.velocity
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0:
            np.testing.assert_array_equal(slope, before)
            continue
        way, side = basis @ basis[worst], -1.0 if before[worst] > up[worst] else 1.0
        if way[worst] < 1e-8:
            continue
        way /= np.sqrt(way[worst])
        assert np.abs(CellState(cell, q).jacobian(0) @ (slope - before)).max() < 1e-9
        size = changed @ way / (way @ way)
        np.testing.assert_allclose(changed, size * way, atol=1e-9 * max(1.0, abs(size)))
        # The slope with which the joint wins back its way to the limit as it bends; a larger one where it cannot.
        left = x[worst] - cell.limits.lower[worst] if side > 0.0 else cell.limits.upper[worst] - x[worst]
        own, won = way[worst], 2.0 * side * bend(cell, q, cell.limits.velocity * way, worst) * left
        won /= cell.limits.velocity[worst] ** 2
        lever = max(own, np.sqrt(won)) if won > 0.0 else own - won / own
        if lever < 0.03:
            continue
        led, bending = led + 1, bending + (won > own**2)
        moved = np.abs(way) > 1e-3 * lever
        moved[worst] = True
        way[worst] = lever
        # Sizes that bring each joint inside its bounds; the least of them, or the least excess where they contradict.
        unit = cell.limits.velocity[moved]
        ratios = np.sort(np.array([down - before, up - before])[:, moved] / (unit * way[moved]), axis=0)
        low, high = ratios[0].max(), ratios[1].min()
        if low <= high:
            assert size == pytest.approx(min(max(0.0, low), high), rel=1e-5, abs=1e-9)
            continue
        sizes = size + np.array([0.0, -1e-3, 1e-3]) * max(1.0, abs(size))
        slopes = before[moved] + sizes[:, None] * (unit * way[moved])
        excess = (np.maximum(slopes - up[moved], down[moved] - slopes) / unit).max(axis=1)
        assert excess[0] <= excess[1:].min()
        contradicted += 1
    assert bending > (4 if robot == "arm7" else 0)
    assert led > 30
    assert contradicted > 10


def finishes(cell: RobotCell, grasp: Grasp, path: LinePath, q: Array) -> bool:
    """Whether the path is run to its end by default."""
    controller = QPController(cell, grasp, path, dt=0.004)
    controller.reset(q)
    return any(controller.step().finished for _ in range(round(2.0 * path.duration / 0.004)))


@pytest.mark.parametrize("room", [0.02, 0.001])
@pytest.mark.parametrize("elbow", [0.05, 0.0, -0.01])
def test_an_elbow_in_its_arms_plane_is_turned_out_of_it(elbow: float, room: float) -> None:
    bases = (
        pin.SE3(np.eye(3), np.array([-0.7, 0.0, 0.0])),
        pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([0.7, 0.0, 0.0])),
    )
    cell = RobotCell(
        [robot_arm("arm7", name=f"arm{k}", T_world_base=base, geometry=False) for k, base in enumerate(bases)]
    )
    x = np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2)
    x[2] = elbow
    lower = cell.limits.lower.copy()
    lower[1] = x[1] - room
    cell = cell.with_limits(lower=lower, acceleration=10.0)
    q = cell.configuration(x)
    held = tool_placements(cell, [q])[0]
    start = pin.SE3(np.eye(3), np.mean([T.translation for T in held], axis=0))
    path = LinePath.displaced(start, translation=(0, 0.1, 0.1), rotation=(0, 0, 0.2), duration=2.0)
    assert finishes(cell, Grasp(tuple(start.inverse() * T for T in held)), path, q)


def in_its_plane(name: str, seed: int, j: int, room: float) -> tuple[RobotCell, Grasp, LinePath, Array]:
    """Two arms with their elbows in their planes, and a limit of joint j this far ahead of its start [rad]."""
    rng = np.random.default_rng(seed)
    T_world_object = pin.SE3(pin.exp3(0.3 * rng.normal(size=3)), 0.2 * rng.normal(size=3))
    arms, grips, xs = [], [], []
    for k in range(2):
        arm = robot_arm(name, name=f"arm{k}", geometry=False)
        low, high = np.clip([arm.limits.lower, arm.limits.upper], -2.5, 2.5)
        x = np.zeros(7)
        x[[0, 1, 3, 5]] = np.deg2rad([rng.uniform(*ends) for ends in ((-60, 60), (-45, 45), (50, 110), (20, 70))])
        x = np.where((x < low) | (x > high), -x, x)
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, x)
        grip = pin.SE3(pin.exp3(0.8 * rng.normal(size=3)), 0.15 * rng.normal(size=3))
        held = T_world_object * grip * data.oMf[arm.model.getFrameId(arm.tool_frame)].inverse()
        arms.append(arm.placed(held, name=arm.name))
        grips.append(grip)
        xs.append(x)
    way = {"translation": 0.08 * rng.normal(size=3), "rotation": 0.15 * rng.normal(size=3)}
    cell, q = RobotCell(arms), np.concatenate(xs)
    lower, upper = cell.limits.lower.copy(), cell.limits.upper.copy()
    (upper if room > 0.0 else lower)[j] = q[j] + room
    path = LinePath.displaced(T_world_object, **way, duration=2.0)
    return cell.with_limits(lower=lower, upper=upper, acceleration=10.0), Grasp(tuple(grips)), path, q


#: Robots, seeds, joints and the room to their limits: a joint that bends back wins less and less by an elbow's turn.
IN_PLANES = (("arm7", 9, 5, 0.0974), ("arm7", 10, 12, 0.0436), ("panda", 6, 12, 0.024), ("panda", 7, 1, 0.1776))


@pytest.mark.parametrize(("robot", "seed", "joint", "room"), IN_PLANES)
def test_an_elbow_is_not_turned_ever_faster_for_nothing(robot: str, seed: int, joint: int, room: float) -> None:
    try:
        task = in_its_plane(robot, seed, joint, room)
    except MissingExtraError:
        pytest.skip("the extra robots is not installed")
    assert finishes(*task)


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
