"""Self-motion that leads joints away from their limits, judged by Pinocchio's Jacobian and its singular vectors."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp, LinePath, QPController, Robot, RobotCell, ServoPath, Status
from coopqp.errors import MissingExtraError
from coopqp.scenarios import robot_arm, robot_data_path
from coopqp.simulation import tool_placements
from coopqp.spatial import Array


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
