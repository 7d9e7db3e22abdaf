"""Joints at their limits while the object rests or creeps: no command shakes a joint to and fro."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, Grasp, LinePath, QPController, Robot, RobotCell, Status
from coopqp.errors import StartWarning
from coopqp.model import JointLimits
from coopqp.scenarios import paper_lift, robot_path
from coopqp.spatial import Array

DT = 0.004


def at(x: float, yaw: float) -> pin.SE3:
    return pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0.0, 0.0]))


def held(cell: RobotCell, q: Array) -> tuple[pin.SE3, Grasp]:
    """An object between the tools, and how they hold it there."""
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, q)
    tools = [data.oMf[frame].copy() for frame in cell.tool_frames]
    start = pin.SE3(np.eye(3), np.mean([tool.translation for tool in tools], axis=0))
    return start, Grasp(tuple(start.inverse() * tool for tool in tools))


def sign_changes(velocities: Array, limits: JointLimits, dt: float) -> int:
    """The most changes of sign of a joint's acceleration, among those beyond 5 % of its limit."""
    share = np.diff(velocities, axis=0) / (dt * limits.acceleration)
    changes = []
    for column in share.T:
        signs = np.sign(column[np.abs(column) > 0.05])
        changes.append(int((signs[1:] != signs[:-1]).sum()))
    return max(changes)


@pytest.mark.parametrize("outside", [0.001, 0.0, 0.002])
def test_an_elbow_in_the_plane_of_its_arm_rests_beside_a_joint_at_its_limit(outside: float) -> None:
    arms = [
        Arm.from_urdf(
            name, robot_path("arm7"), tool_frame="tool", T_world_base=base, geometry=False, acceleration_limits=10.0
        )
        for name, base in (("left", at(-0.7, 0.0)), ("right", at(0.7, np.pi)))
    ]
    cell = RobotCell(arms)
    q = cell.configuration(np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2))
    upper = cell.limits.upper.copy()
    upper[1] = np.deg2rad(14) - outside
    cell = cell.with_limits(upper=upper)
    start, grasp = held(cell, q)
    path = LinePath.displaced(start, translation=(0, 0, -0.1), rotation=(0, 0, 0.2), duration=2.0)
    controller = QPController(cell, grasp, path, dt=DT)
    if outside:
        with pytest.warns(StartWarning):
            controller.reset(q)
    else:
        controller.reset(q)
    steps = [controller.step() for _ in range(500)]
    assert steps[-1].status is Status.BLOCKED
    assert sign_changes(np.array([s.velocity for s in steps[-250:]]), cell.limits, DT) <= 2
    assert np.abs(steps[-1].velocity).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.013, 0.005])
def test_arms_on_a_slow_lift_creep_on_smoothly_at_the_end_of_their_reach(speed: float) -> None:
    robot = Robot(
        robot_path("lift2"), {"left": "left_tool", "right": "right_tool"}, name="lift", geometry=False,
        acceleration_limits=10.0, velocity_limits={"lift": speed},
    )  # fmt: skip
    cell = RobotCell([robot])
    left = [0.849847, -0.869325, 0.375118, 1.684444, 1.503335, -1.927767]
    right = [-3.271353, 1.988752, -1.743981, 1.438375, 4.22404, -1.485846]
    q = cell.configuration([0.224418, *left, *right])
    start, grasp = held(cell, q)
    path = LinePath.displaced(start, translation=(0, 0, 0), rotation=(2.0, 0, 0), duration=2.0)
    controller = QPController(cell, grasp, path, dt=0.002)
    controller.reset(q)
    steps = [controller.step() for _ in range(3000)]
    assert steps[-1].status is Status.SLOWED
    velocities = np.array([s.velocity for s in steps[-1000:]])
    share = np.diff(velocities, axis=0) / (0.002 * cell.limits.acceleration)
    assert np.sqrt((share**2).mean(axis=0)).max() < 0.05


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_the_object_goes_on_where_its_path_leads_a_joint_back_inside(acceleration: float) -> None:
    """Only a joint that goes further out ends what is known ahead."""
    task = paper_lift()
    cell, joint = task.cell.with_limits(acceleration=acceleration), 17
    lower = cell.limits.lower.copy()
    lower[joint] = cell.positions(task.q_start)[joint] + 0.5  # the path moves it by 1.25
    controller = QPController(cell.with_limits(lower=lower), task.grasp, task.path, dt=0.01)
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(50)]
    assert steps[-1].clock_next > 0.4
    assert cell.positions(steps[0].q_next)[joint] < lower[joint]
    assert steps[-1].rate == pytest.approx(1.0, abs=1e-12)
