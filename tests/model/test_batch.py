"""Batch kinematics of one arm: Pinocchio is the reference; the compiled and the NumPy kernel give the same answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from coopqp import Arm, InvalidInputError, RobotCell, scenarios
from coopqp.errors import UnknownNameError
from coopqp.model.batch import ArmKinematics, batch_kernels, singular_values
from coopqp.scenarios import robot_path

pytestmark = pytest.mark.core

ROBOTS = ("rx90l", "arm7", "gantry7", "scara4", "arm5", "arm6c")
KERNELS = batch_kernels()


def arm_of(robot: str, seed: int = 0) -> Arm:
    pin.seed(seed)
    tool = scenarios.ROBOTS[robot].tool_frame
    return Arm.from_urdf("arm", robot_path(robot), tool_frame=tool, geometry=False, T_world_base=pin.SE3.Random())


ARMS = {robot: arm_of(robot) for robot in ROBOTS}
KINEMATICS = {(robot, kernel): ArmKinematics(ARMS[robot], kernel=kernel) for robot in ROBOTS for kernel in KERNELS}
CASES = [pytest.param(robot, kernel, id=f"{robot}-{kernel}") for robot in ROBOTS for kernel in KERNELS]


def pinocchio_says(arm: Arm, x: Any) -> tuple[Any, Any]:
    """T_world_tool and the tool's Jacobian in world axes."""
    cell = RobotCell([arm])
    data = cell.model.createData()
    pin.computeJointJacobians(cell.model, data, cell.configuration(x))
    pin.updateFramePlacements(cell.model, data)
    J = pin.getFrameJacobian(cell.model, data, cell.tool_frames[0], pin.LOCAL_WORLD_ALIGNED)
    return data.oMf[cell.tool_frames[0]].homogeneous, np.array(J)


@pytest.mark.parametrize(("robot", "kernel"), CASES)
def test_poses_jacobians_and_singular_values_are_those_of_pinocchio(robot: str, kernel: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot, kernel]
    q = kinematics.seeds(20, rng)
    T, J, s = kinematics.tool_poses(q), kinematics.jacobians(q), kinematics.singular_values(q)
    for i, x in enumerate(q):
        pose, jacobian = pinocchio_says(ARMS[robot], x)
        np.testing.assert_allclose(T[i], pose, rtol=0, atol=1e-13)
        np.testing.assert_allclose(J[i], jacobian, rtol=0, atol=1e-13)
        np.testing.assert_allclose(s[i], np.linalg.svd(jacobian, compute_uv=False), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("shape", [(1, 1), (6, 1), (2, 5), (6, 6), (5, 64), (64, 6), (70, 6)])
def test_singular_values_of_any_matrices(kernel: str, shape: tuple[int, int], rng: Any) -> None:
    A = rng.normal(size=(9, *shape))
    A[3] = 0.0
    A[5, :, -1] *= 1e-9
    found = singular_values(A, kernel=KINEMATICS["rx90l", kernel].kernel)
    np.testing.assert_allclose(found, np.linalg.svd(A, compute_uv=False), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("robot", ROBOTS)
def test_singular_values_do_not_depend_on_what_else_is_asked(robot: str, rng: Any) -> None:
    for kernel in KERNELS:
        kinematics = KINEMATICS[robot, kernel]
        q = kinematics.seeds(21, rng)
        q[7] = 0.0  # singular
        alone = np.concatenate([kinematics.singular_values(x[None]) for x in q])
        np.testing.assert_array_equal(kinematics.singular_values(q), alone)


@pytest.mark.parametrize(("robot", "kernel"), CASES)
def test_derivatives_are_those_of_a_way_of_the_joints(robot: str, kernel: str, rng: Any) -> None:
    """The tool follows the way q + s u: q′ moves it so, and q″ is the change of q′; without freedom they are u, 0."""
    kinematics, h = KINEMATICS[robot, kernel], 1e-6
    q, u = kinematics.seeds(20, rng), rng.uniform(-1.0, 1.0, (20, kinematics.n))

    def twists(s: float) -> Any:
        return np.einsum("kij,kj->ki", kinematics.jacobians(q + s * u), u)

    V, dV = twists(0.0), (twists(h) - twists(-h)) / (2.0 * h)
    good = kinematics.singular_values(q)[:, -1] > 0.02
    slope, curvature = (x[good] for x in kinematics.derivatives(q, V, dV))
    np.testing.assert_allclose(
        np.einsum("kij,kj->ki", kinematics.jacobians(q[good]), slope), V[good], rtol=0, atol=1e-11
    )
    if kinematics.n <= 6:
        np.testing.assert_allclose(slope, u[good], rtol=0, atol=1e-10)
        np.testing.assert_allclose(curvature, 0.0, atol=1e-6)
        return
    beside = [kinematics.derivatives(q[good] + s * slope, (V + s * dV)[good], dV[good])[0] for s in (h, -h)]
    np.testing.assert_allclose(curvature, (beside[0] - beside[1]) / (2.0 * h), rtol=1e-5, atol=1e-5)
    null = np.linalg.svd(kinematics.jacobians(q[good]))[2][:, -1]
    np.testing.assert_allclose(np.einsum("kj,kj->k", slope / kinematics.scale**2, null), 0.0, atol=1e-9)


@pytest.mark.parametrize(("robot", "kernel"), CASES)
def test_every_nearby_pose_is_reached(robot: str, kernel: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot, kernel]
    q = kinematics.seeds(300, rng)
    T = kinematics.tool_poses(q)
    answer = kinematics.solve(T, q + rng.uniform(-0.1, 0.1, q.shape))
    assert answer.reached.all()
    np.testing.assert_allclose(kinematics.tool_poses(answer.q), T, rtol=0, atol=2e-9)
    np.testing.assert_array_equal(answer.sigma_min, kinematics.singular_values(answer.q)[:, -1])
    np.testing.assert_array_equal(answer.margins, kinematics.margins(answer.q))


@pytest.mark.parametrize("kernel", KERNELS)
def test_reached_is_said_of_poses_that_are_reached_and_of_no_others(kernel: str, rng: Any) -> None:
    """From any seed: a convergence that is claimed is checked against the poses themselves."""
    kinematics = KINEMATICS["rx90l", kernel]
    T = kinematics.tool_poses(kinematics.seeds(400, rng))
    T[::4, :3, 3] += rng.uniform(-2.0, 2.0, (100, 3))  # a part of these is out of reach
    answer = kinematics.solve(T, kinematics.seeds(400, rng))
    away = np.abs(kinematics.tool_poses(answer.q) - T).max(axis=(1, 2))
    assert (away[answer.reached] < 2e-9).all()
    assert (away[~answer.reached] > 1e-10).all()
    assert 300 <= answer.reached.sum() < 400


@given(st.integers(0, 2**32 - 1))
def test_half_a_turn_and_near_it_is_no_obstacle(seed: int) -> None:
    """Seeds whose tool is turned by exactly or almost π from the pose."""
    rng = np.random.default_rng(seed)
    for kernel in KERNELS:
        kinematics = KINEMATICS["rx90l", kernel]
        q = kinematics.seeds(1, rng)
        start = q.copy()
        start[0, 5] += np.pi + rng.choice([0.0, 1e-12, -1e-9, 1e-3])
        answer = kinematics.solve(kinematics.tool_poses(q), start)
        assert np.isfinite(answer.q).all()
        assert answer.reached.all() or answer.sigma_min[0] < 0.05


@pytest.mark.skipif(len(KERNELS) < 2, reason="one kernel")
@pytest.mark.parametrize("robot", ROBOTS)
def test_both_kernels_agree(robot: str, rng: Any) -> None:
    """In lockstep: the same steps from the same starts, and the same walks."""
    one, other = (KINEMATICS[robot, kernel] for kernel in KERNELS)
    q = one.seeds(100, rng)
    T, start = one.tool_poses(q), one.seeds(100, rng)
    for steps in (0, 1, 2, 3):
        a, b = one.solve(T, start, steps=steps), other.solve(T, start, steps=steps)
        np.testing.assert_allclose(a.q, b.q, rtol=0, atol=1e-6)
        np.testing.assert_allclose(a.residual, b.residual, rtol=1e-6, atol=1e-9)
    V, dV = rng.uniform(-1.0, 1.0, (2, 100, 6))
    for mine, others in zip(one.derivatives(q, V, dV), other.derivatives(q, V, dV), strict=True):
        np.testing.assert_allclose(mine, others, rtol=1e-6, atol=1e-6 * np.abs(others).max())
    way = one.tool_poses(q[0] + np.linspace(0.0, 0.4, 9)[:, None] * rng.uniform(-1.0, 1.0, one.n))
    starts = one.solve(way[:1], one.seeds(20, rng))
    starts_q = starts.q[starts.reached]
    a_walk, b_walk = one.walk(way, starts_q), other.walk(way, starts_q)
    np.testing.assert_array_equal(a_walk.reached, b_walk.reached)
    np.testing.assert_allclose(a_walk.q, b_walk.q, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_walk_follows_its_poses_without_a_jump(kernel: str, rng: Any) -> None:
    """Two poses 0.8 rad of every joint apart: what happens between them is found by halving."""
    kinematics = KINEMATICS["rx90l", kernel]
    q = np.array([0.3, 0.4, 1.2, 0.5, 0.8, -0.4])
    fine = q + np.linspace(0.0, 1.0, 50)[:, None] * np.array([0.8, 0.3, -0.4, 0.5, 0.3, 0.8])
    poses = kinematics.tool_poses(fine)
    walk = kinematics.walk(poses, q[None])
    assert walk.complete.all()
    np.testing.assert_allclose(walk.q[0], fine, rtol=0, atol=1e-7)
    coarse = kinematics.walk(poses[[0, 25, 49]], q[None])
    assert coarse.complete.all()
    np.testing.assert_allclose(coarse.q[0], fine[[0, 25, 49]], rtol=0, atol=1e-7)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_walk_ends_before_a_singularity_and_where_the_reach_ends(kernel: str) -> None:
    kinematics = KINEMATICS["rx90l", kernel]
    through = np.array([0.3, 0.4, 1.2, 0.5, 0.0, -0.4]) + np.linspace(-0.3, 0.31, 40)[:, None] * np.eye(6)[4]
    walk = kinematics.walk(kinematics.tool_poses(through), through[:1])
    assert not walk.complete[0]
    assert walk.reached[0] <= 19  # joint 5 passes 0 behind this pose: the wrist is singular there
    q = np.array([0.3, 0.4, 1.2, 0.5, 0.8, -0.4])
    poses = np.repeat(kinematics.tool_poses(q[None]), 30, axis=0)
    poses[:, :3, 3] += np.linspace(0.0, 3.0, 30)[:, None] * [1.0, 0.0, 0.0]
    away = kinematics.walk(poses, q[None])
    assert 0 < away.reached[0] < 29
    assert (away.q[0, away.reached[0] :] == away.q[0, -1]).all()


def test_a_redundant_walk_takes_the_shortest_way_in_units_of_the_joints_speeds(rng: Any) -> None:
    kinematics = KINEMATICS["arm7", KERNELS[0]]
    q = kinematics.middle + 0.3
    poses = kinematics.tool_poses(q + np.linspace(0.0, 1e-4, 2)[:, None] * rng.uniform(-1.0, 1.0, 7))
    step = np.diff(kinematics.walk(poses, q[None]).q[0], axis=0)[0]
    speed = ARMS["arm7"].limits.velocity
    null = np.linalg.svd(kinematics.jacobians(q[None])[0])[2][-1]
    assert abs((step / speed**2) @ null) < 1e-6 * np.linalg.norm(step)


def test_only_joints_that_move_the_tool_count() -> None:
    """A gripper's fingers stay out of it."""
    cell_arm = arm_of("arm7")
    shorter = Arm.from_model("arm", cell_arm.model, tool_frame=cell_arm.model.names[4], velocity_limits=1.0)
    kinematics = ArmKinematics(shorter)
    assert kinematics.n == 4
    assert kinematics.joints == tuple(cell_arm.model.names)[1:5]


def test_bad_input_is_named() -> None:
    kinematics = KINEMATICS["rx90l", KERNELS[0]]
    pose = np.eye(4)
    for q in (np.zeros(6), np.zeros((2, 5)), np.full((1, 6), np.nan)):
        with pytest.raises(InvalidInputError, match="joint positions of shape"):
            kinematics.solve(pose, q)
    with pytest.raises(InvalidInputError, match="3 poses for 2 starts"):
        kinematics.solve(np.repeat(pose[None], 3, axis=0), np.zeros((2, 6)))
    with pytest.raises(InvalidInputError, match=r"poses\[1\]"):
        kinematics.solve([pose, 2.0 * pose], np.zeros((2, 6)))
    with pytest.raises(UnknownNameError, match="kernel"):
        ArmKinematics(ARMS["rx90l"], kernel="fast")  # type: ignore[arg-type]


def test_starts_are_not_changed() -> None:
    kinematics = KINEMATICS["rx90l", KERNELS[0]]
    q = np.full((3, 6), 0.3)
    kinematics.solve(np.eye(4), q)
    assert (q == 0.3).all()
