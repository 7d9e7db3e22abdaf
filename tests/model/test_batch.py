"""Batch kinematics of one arm: Pinocchio is the reference, and NumPy for what is made of poses and Jacobians."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from coopqp import Arm, InvalidInputError, RobotCell, scenarios
from coopqp.core import _core
from coopqp.errors import ModelError
from coopqp.model.batch import (
    ArmKinematics,
    BatchSolutions,
    pose_matrices,
    pose_rows,
    singular_values,
)
from coopqp.scenarios import robot_path

pytestmark = pytest.mark.core

ROBOTS = ("rx90l", "arm7", "gantry7", "scara4", "arm5", "arm6c")


def arm_of(robot: str, seed: int = 0) -> Arm:
    pin.seed(seed)
    tool = scenarios.ROBOTS[robot].tool_frame
    return Arm.from_urdf("arm", robot_path(robot), tool_frame=tool, geometry=False, T_world_base=pin.SE3.Random())


ARMS = {robot: arm_of(robot) for robot in ROBOTS}
KINEMATICS = {robot: ArmKinematics(ARMS[robot]) for robot in ROBOTS}


def pinocchio_says(arm: Arm, x: Any) -> tuple[Any, Any]:
    """T_world_tool and the tool's Jacobian in world axes."""
    cell = RobotCell([arm])
    data = cell.model.createData()
    pin.computeJointJacobians(cell.model, data, cell.configuration(x))
    pin.updateFramePlacements(cell.model, data)
    J = pin.getFrameJacobian(cell.model, data, cell.tool_frames[0], pin.LOCAL_WORLD_ALIGNED)
    return data.oMf[cell.tool_frames[0]].homogeneous, np.array(J)


@pytest.mark.parametrize("robot", ROBOTS)
def test_poses_jacobians_and_singular_values_are_those_of_pinocchio(robot: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot]
    q = kinematics.seeds(20, rng)
    T, J, s = kinematics.tool_poses(q), kinematics.jacobians(q), kinematics.singular_values(q)
    for i, x in enumerate(q):
        pose, jacobian = pinocchio_says(ARMS[robot], x)
        np.testing.assert_allclose(T[i], pose, rtol=0, atol=1e-13)
        np.testing.assert_allclose(J[i], jacobian, rtol=0, atol=1e-13)
        np.testing.assert_allclose(s[i], np.linalg.svd(jacobian, compute_uv=False), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("shape", [(1, 1), (6, 1), (2, 5), (6, 6), (5, 64), (64, 6), (70, 6)])
def test_singular_values_of_any_matrices(shape: tuple[int, int], rng: Any) -> None:
    A = rng.normal(size=(9, *shape))
    A[3] = 0.0
    A[5, :, -1] *= 1e-9
    found = singular_values(A)
    np.testing.assert_allclose(found, np.linalg.svd(A, compute_uv=False), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("robot", ROBOTS)
def test_singular_values_do_not_depend_on_what_else_is_asked(robot: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot]
    q = kinematics.seeds(21, rng)
    q[7] = 0.0  # singular
    alone = np.concatenate([kinematics.singular_values(x[None]) for x in q])
    np.testing.assert_array_equal(kinematics.singular_values(q), alone)


def test_joints_are_those_of_the_model_with_their_ranges_and_speeds() -> None:
    """Seven joints of which one has one end, and of which two have no speed; six with a continuous one; a gantry."""
    arm = ARMS["arm7"]
    speeds = np.array([1.0, np.inf, 2.0, 0.5, np.inf, 1.5, 4.0])
    lower = np.where(np.arange(7) == 3, -np.inf, arm.limits.lower)
    kinematics = ArmKinematics(arm.with_limits(lower=lower, velocity=speeds))
    np.testing.assert_array_equal(kinematics.columns, range(7))
    np.testing.assert_array_equal(kinematics.bounded, np.arange(7) != 3)
    middle = np.where(kinematics.bounded, 0.5 * (arm.limits.lower + arm.limits.upper), 0.0)
    np.testing.assert_array_equal(kinematics.middle, middle)
    np.testing.assert_array_equal(kinematics.scale, [1.0, 1.0, 2.0, 0.5, 1.0, 1.5, 4.0])
    assert kinematics.turns.all()
    round_and_round = KINEMATICS["arm6c"]
    np.testing.assert_array_equal(round_and_round.turns, [True] * 5 + [False])
    np.testing.assert_array_equal(round_and_round.bounded, [True] * 5 + [False])
    assert round_and_round.middle[5] == 0.0
    gantry = KINEMATICS["gantry7"]
    names = [joint.shortname() for joint in list(ARMS["gantry7"].model.joints)[1:]]
    np.testing.assert_array_equal(gantry.slides, [name.startswith("JointModelP") for name in names])
    np.testing.assert_array_equal(gantry.turns, ~gantry.slides)
    assert 0 < gantry.slides.sum() < gantry.n


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_nearest_turn_is_the_one_with_the_most_room(robot: str, rng: Any) -> None:
    """Against trying five turns either way; without limits the one nearest to zero. Sliding joints stay."""
    kinematics = KINEMATICS[robot]
    q = rng.uniform(-15.0, 15.0, (30, kinematics.n))
    got = kinematics.nearest_turns(q)
    turned = q[..., None] + 2.0 * np.pi * np.arange(-5, 6)
    for j in range(kinematics.n):
        if kinematics.slides[j]:
            np.testing.assert_array_equal(got[:, j], q[:, j])
            continue
        middle = 0.5 * (kinematics.lower[j] + kinematics.upper[j]) if kinematics.bounded[j] else 0.0
        away = np.abs(turned[:, j] - middle)
        expected = np.take_along_axis(turned[:, j], away.argmin(axis=1)[:, None], axis=1)[:, 0]
        np.testing.assert_allclose(got[:, j], expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(kinematics.nearest_turns(q[3]), got[3])


def test_positions_are_the_same_up_to_whole_turns_of_every_joint() -> None:
    """Of a gantry: what slides by 2π m, or is away in one joint of all, is somewhere else."""
    kinematics = KINEMATICS["gantry7"]
    q = np.linspace(-0.3, 0.4, 7)
    turning, sliding = int(np.flatnonzero(~kinematics.slides)[0]), int(np.flatnonzero(kinematics.slides)[0])
    cases = []
    for j, change, same in (
        (turning, 2.0 * np.pi, True), (turning, -6.0 * np.pi + 0.9e-3, True), (turning, np.pi, False),
        (turning, 2.0 * np.pi - 0.9e-3, True), (turning, 1.1e-3, False), (sliding, 0.9e-3, True),
        (sliding, 2.0 * np.pi, False), (sliding, -1.1e-3, False),
    ):  # fmt: skip
        other = q.copy()
        other[j] += change
        cases.append(other)
        assert bool(kinematics.same(q, other, within=1e-3)) is same
    found = kinematics.same(np.array(cases), q, within=1e-3)
    np.testing.assert_array_equal(found, [True, True, False, True, False, True, False, False])


@pytest.mark.parametrize("robot", ROBOTS)
def test_seeds_are_half_inside_the_limits_and_half_at_any_angle(robot: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot]
    q = kinematics.seeds(2000, rng)
    low, high = (
        np.where(kinematics.bounded, kinematics.lower, -np.pi),
        np.where(kinematics.bounded, kinematics.upper, np.pi),
    )
    assert ((q >= low) & (q <= high))[:1000].all()
    for j in range(kinematics.n):
        ends = (low[j], high[j]) if kinematics.slides[j] else (-np.pi, np.pi)
        for seen, (a, b) in ((q[:1000, j], (low[j], high[j])), (q[1000:, j], ends)):
            assert a <= seen.min() < a + 0.02 * (b - a)
            assert b - 0.02 * (b - a) < seen.max() <= b
            assert abs(seen.mean() - 0.5 * (a + b)) < 0.05 * (b - a)
    assert kinematics.seeds(3, rng).shape == (3, kinematics.n)


@pytest.mark.parametrize("robot", ROBOTS)
def test_derivatives_are_those_of_a_way_of_the_joints(robot: str, rng: Any) -> None:
    """The tool follows the way q + s u: q′ moves it so, and q″ is the change of q′; without freedom they are u, 0."""
    kinematics, h = KINEMATICS[robot], 1e-6
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


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_nearby_pose_is_reached(robot: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot]
    q = kinematics.seeds(300, rng)
    T = kinematics.tool_poses(q)
    answer = kinematics.solve(T, q + rng.uniform(-0.1, 0.1, q.shape))
    assert answer.reached.all()
    np.testing.assert_allclose(kinematics.tool_poses(answer.q), T, rtol=0, atol=2e-9)
    np.testing.assert_array_equal(answer.sigma_min, kinematics.singular_values(answer.q)[:, -1])
    np.testing.assert_array_equal(answer.margins, kinematics.margins(answer.q))


def test_reached_is_said_of_poses_that_are_reached_and_of_no_others(rng: Any) -> None:
    """From any seed: a convergence that is claimed is checked against the poses themselves."""
    kinematics = KINEMATICS["rx90l"]
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
    kinematics = KINEMATICS["rx90l"]
    q = kinematics.seeds(1, rng)
    start = q.copy()
    start[0, 5] += np.pi + rng.choice([0.0, 1e-12, -1e-9, 1e-3])
    answer = kinematics.solve(kinematics.tool_poses(q), start)
    assert np.isfinite(answer.q).all()
    assert answer.reached.all() or answer.sigma_min[0] < 0.05


def newton(kinematics: ArmKinematics, T: Any, x: Any, *, steps: int, longest: float, damping: float) -> tuple[Any, Any]:
    """Positions (n,) and largest error after damped Newton's steps: v = W² Jᵀ (J W² Jᵀ + (damping |e|² + …) 1)⁻¹ e."""
    W = kinematics.scale**2 / kinematics.scale.max() ** 2 if kinematics.n > 6 else np.ones(kinematics.n)
    for i in range(steps + 1):
        at = kinematics.tool_poses(x[None])[0]
        e = np.concatenate([T[:3, 3] - at[:3, 3], pin.log3(T[:3, :3] @ at[:3, :3].T)])
        if i == steps or np.abs(e).max() <= 1e-9:
            break
        J = kinematics.jacobians(x[None])[0]
        G = J * W @ J.T
        v = W * (J.T @ np.linalg.solve(G + (damping * e @ e + 1e-15 * np.trace(G)) * np.eye(6), e))
        x = x + min(1.0, longest / np.abs(v).max()) * v
    return x, np.abs(e).max()


@pytest.mark.parametrize("robot", ROBOTS)
def test_steps_are_those_of_a_damped_newton_method(robot: str, rng: Any) -> None:
    """With the weights of a redundant arm's joints, damped by 1e-2 of the error's square, at most 1 rad or m long."""
    kinematics = KINEMATICS[robot]
    T, start = kinematics.tool_poses(kinematics.seeds(60, rng)), kinematics.seeds(60, rng)
    for steps in (0, 1, 2, 3):
        found = kinematics.solve(T, start, steps=steps)
        for k, (pose, x) in enumerate(zip(T, start, strict=True)):
            q, away = newton(kinematics, pose, x, steps=steps, longest=1.0, damping=1e-2)
            np.testing.assert_allclose(found.q[k], q, rtol=0, atol=1e-6)
            assert found.residual[k] == pytest.approx(away, rel=1e-6, abs=1e-9)


def walked(kinematics: ArmKinematics, T: Any, ahead: Any, x: Any, halvings: int = 12) -> Any:
    """Positions (n,) at the next pose by undamped steps; None where they leap or pass a singularity in every half."""
    q, away = newton(kinematics, ahead, x, steps=12, longest=0.3, damping=0.0)
    passed = kinematics.n == 6 and np.prod(np.linalg.det(kinematics.jacobians([x, q]))) < 0.0
    if away <= 1e-9 and np.abs(q - x).max() <= 0.3 and not passed:
        return q
    if not halvings:
        return None
    middle = T.copy()
    middle[:3, :3] = pin.exp3(0.5 * pin.log3(ahead[:3, :3] @ T[:3, :3].T)) @ T[:3, :3]
    middle[:3, 3] = 0.5 * (T[:3, 3] + ahead[:3, 3])
    half = walked(kinematics, T, middle, x, halvings - 1)
    return half if half is None else walked(kinematics, middle, ahead, half, halvings - 1)


@pytest.mark.parametrize("robot", ROBOTS)
def test_walks_go_on_by_small_steps_each_halved_where_it_has_to_be(robot: str, rng: Any) -> None:
    kinematics = KINEMATICS[robot]
    q = kinematics.seeds(1, rng)[0]
    way = kinematics.tool_poses(q + np.linspace(0.0, 0.9, 5)[:, None] * rng.uniform(-1.0, 1.0, kinematics.n))
    starts = kinematics.solve(way[:1], kinematics.seeds(20, rng))
    starts_q = starts.q[starts.reached][:6]
    found = kinematics.walk(way, starts_q)
    for k, start in enumerate(starts_q):
        expected = [start]
        for T, ahead in itertools.pairwise(way):
            after = walked(kinematics, T, ahead, expected[-1])
            if after is None:
                break
            expected.append(after)
        assert found.reached[k] == len(expected) - 1
        np.testing.assert_allclose(found.q[k, : len(expected)], expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("robot", ROBOTS)
def test_derivatives_are_those_of_any_motion_of_the_tool(robot: str, rng: Any) -> None:
    """J q′ = V and J q″ + J′ q′ = V′ with J′ by differences, by least squares of fewer than six joints."""
    kinematics, h = KINEMATICS[robot], 1e-6
    q, (V, dV) = kinematics.seeds(60, rng), rng.uniform(-1.0, 1.0, (2, 60, 6))
    q = q[kinematics.singular_values(q)[:, -1] > 0.05]
    V, dV = V[: len(q)], dV[: len(q)]
    slope, curvature = kinematics.derivatives(q, V, dV)
    J = kinematics.jacobians(q)
    dJ = (kinematics.jacobians(q + h * slope) - kinematics.jacobians(q - h * slope)) / (2.0 * h)
    rest = dV - np.einsum("kij,kj->ki", dJ, slope)
    if kinematics.n >= 6:
        np.testing.assert_allclose(np.einsum("kij,kj->ki", J, slope), V, rtol=0, atol=1e-10)
        np.testing.assert_allclose(np.einsum("kij,kj->ki", J, curvature), rest, rtol=1e-6, atol=1e-6)
    else:
        least = np.linalg.pinv(J)
        np.testing.assert_allclose(slope, np.einsum("kij,kj->ki", least, V), rtol=0, atol=1e-11)
        np.testing.assert_allclose(curvature, np.einsum("kij,kj->ki", least, rest), rtol=1e-6, atol=1e-5)


def test_a_walk_follows_its_poses_without_a_jump(rng: Any) -> None:
    """Two poses 0.8 rad of every joint apart: what happens between them is found by halving."""
    kinematics = KINEMATICS["rx90l"]
    q = np.array([0.3, 0.4, 1.2, 0.5, 0.8, -0.4])
    fine = q + np.linspace(0.0, 1.0, 50)[:, None] * np.array([0.8, 0.3, -0.4, 0.5, 0.3, 0.8])
    poses = kinematics.tool_poses(fine)
    walk = kinematics.walk(poses, q[None])
    assert walk.complete.all()
    np.testing.assert_allclose(walk.q[0], fine, rtol=0, atol=1e-7)
    coarse = kinematics.walk(poses[[0, 25, 49]], q[None])
    assert coarse.complete.all()
    np.testing.assert_allclose(coarse.q[0], fine[[0, 25, 49]], rtol=0, atol=1e-7)


def test_a_walk_ends_before_a_singularity_and_where_the_reach_ends() -> None:
    kinematics = KINEMATICS["rx90l"]
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


def test_walks_of_many_starts_are_those_of_each(rng: Any) -> None:
    """From branches of the first pose at once, and from a start that is not at it."""
    kinematics = KINEMATICS["rx90l"]
    q = np.array([0.3, 0.4, 1.2, 0.5, 0.8, -0.4])
    poses = kinematics.tool_poses(q + np.linspace(0.0, 1.0, 6)[:, None] * np.array([0.5, 0.2, -0.3, 0.4, 0.2, 0.5]))
    starts = kinematics.solve(poses[:1], kinematics.seeds(40, rng))
    starts_q = np.vstack([starts.q[starts.reached][:6], q + 0.5])
    together = kinematics.walk(poses, starts_q)
    assert together.complete.any()
    assert not together.complete[-1], "its start is not at the first pose, and its second pose is too far"
    np.testing.assert_array_equal(together.complete, together.reached == 5)
    np.testing.assert_array_equal(together.q[:, 0], starts_q)
    for i, start in enumerate(starts_q):
        alone = kinematics.walk(poses, start[None])
        np.testing.assert_allclose(alone.q[0], together.q[i], rtol=0, atol=1e-9)
        assert alone.reached[0] == together.reached[i]
        np.testing.assert_array_equal(together.sigma_min[i], kinematics.singular_values(together.q[i])[:, -1])
        for k in range(together.reached[i] + 1, 6):
            np.testing.assert_array_equal(together.q[i, k], together.q[i, together.reached[i]])
    single = kinematics.walk(poses[:1], starts_q)
    assert single.complete.all()
    assert (single.reached == 0).all()


def test_options_of_newtons_method_are_kept(rng: Any) -> None:
    """Without steps the start comes back with its distance; a step of a joint is no longer than told."""
    kinematics = KINEMATICS["rx90l"]
    start = kinematics.seeds(20, rng)
    pose = kinematics.tool_poses(start[:1] + 0.5)
    here = kinematics.solve(pose, start, steps=0)
    np.testing.assert_array_equal(here.q, start)
    for i, T in enumerate(kinematics.tool_poses(start)):
        turn = pin.log3(pose[0, :3, :3] @ T[:3, :3].T)
        away = np.abs([*(pose[0, :3, 3] - T[:3, 3]), *turn]).max()
        assert here.residual[i] == pytest.approx(away, abs=1e-9)
    for longest in (0.01, 0.3):
        for steps in (1, 3):
            moved = np.abs(kinematics.newton(pose, start, steps=steps, longest=longest)[0] - start).max(axis=1)
            assert moved.max() <= steps * longest * (1.0 + 1e-12)
            assert moved.max() > 0.9 * longest
    q, residual = kinematics.newton(pose, start[:1], tolerance=1e-3, steps=40)
    assert residual[0] <= 1e-3
    closer = kinematics.solve(pose, start[:1])
    assert closer.residual[0] <= 1e-9 < residual[0], "it ends where the tolerance is reached"
    np.testing.assert_allclose(closer.q, q, rtol=0, atol=0.1)
    assert (kinematics.solve(pose, start, tolerance=10.0).q == start).all()


def test_the_core_writes_all_of_its_results(rng: Any) -> None:
    """Whatever the arrays held before."""
    kinematics = KINEMATICS["rx90l"]
    q = np.array([[0.3, 0.4, 1.2, 0.5, 0.8, -0.4], [1.0, 0.3, 1.0, 0.5, 0.8, -0.4]])
    poses = np.full((2, 12), np.nan)
    J = np.full((2, 6, 6), np.nan)
    _core.place(kinematics.numbers, q, poses, J)
    np.testing.assert_array_equal(poses, pose_rows(kinematics.tool_poses(q)))
    np.testing.assert_array_equal(J.transpose(0, 2, 1), kinematics.jacobians(q))
    way = np.repeat(poses[:1], 2, axis=0)
    way[1, 9:] += 5.0  # out of reach: none comes further than its start
    walked, reached = np.full((2, 2, 6), np.nan), np.full(2, 7.0)
    walked[:, 0] = q
    _core.walk(kinematics.numbers, way, walked, reached, 1e-9, 0.3, 3)
    np.testing.assert_array_equal(reached, 0.0)
    np.testing.assert_array_equal(walked, np.repeat(q[:, None], 2, axis=1))


def test_an_answer_is_reached_up_to_a_nanometre() -> None:
    residual = np.array([0.0, 1e-9, 1.01e-9, np.inf])
    answers = BatchSolutions(np.zeros((4, 6)), residual, np.zeros(4), np.zeros((4, 6)))
    np.testing.assert_array_equal(answers.reached, [True, True, False, False])


def test_poses_may_be_given_as_placements_matrices_or_rows(rng: Any) -> None:
    kinematics = KINEMATICS["rx90l"]
    q = kinematics.seeds(4, rng)
    T = kinematics.tool_poses(q)
    rows = pose_rows(T)
    np.testing.assert_array_equal(rows[:, :9].reshape(-1, 3, 3), T[:, :3, :3])
    np.testing.assert_array_equal(rows[:, 9:], T[:, :3, 3])
    expected = kinematics.newton(T, q + 0.05)[0]
    for poses in (rows, [pin.SE3(M) for M in T], list(T), np.asfortranarray(T)):
        np.testing.assert_allclose(kinematics.newton(poses, q + 0.05)[0], expected, rtol=0, atol=1e-9)
    for pose in (rows[:1], pin.SE3(T[0]), T[0], T[:1], [T[0]]):
        np.testing.assert_allclose(kinematics.newton(pose, q[:1] + 0.05)[0], expected[:1], rtol=0, atol=1e-9)
        many = kinematics.newton(pose, np.repeat(q[:1] + 0.05, 3, axis=0))[0]
        np.testing.assert_allclose(many, np.repeat(expected[:1], 3, axis=0), rtol=0, atol=1e-9)
    assert pose_matrices(T, "here") is T
    np.testing.assert_array_equal(pose_matrices(pin.SE3(T[0]), "here"), T[:1])


@pytest.mark.parametrize(
    ("at", "value"),
    [((0, 0), 1.1), ((1, 1), 1.1), ((0, 1), 0.1), ((2, 2), -1.0), ((2, 0), 0.1), ((0, 3), np.nan), ((2, 3), np.inf),
     ((3, 0), 0.1), ((3, 3), 2.0)],
)  # fmt: skip
def test_a_matrix_that_is_no_pose_is_named_by_its_index(at: tuple[int, int], value: float) -> None:
    poses = np.repeat(np.eye(4)[None], 5, axis=0)
    poses[3][at] = value
    with pytest.raises(InvalidInputError, match=r"^somewhere\[3\]"):
        pose_matrices(poses, "somewhere")
    poses[3] = np.eye(4)
    poses[3][0, 1], poses[3][1, 0] = 1e-10, -1e-10  # rounding
    assert pose_matrices(poses, "somewhere") is poses


def test_a_redundant_walk_takes_the_shortest_way_in_units_of_the_joints_speeds(rng: Any) -> None:
    kinematics = KINEMATICS["arm7"]
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
    kinematics = KINEMATICS["rx90l"]
    pose = np.eye(4)
    for q in (np.zeros(6), np.zeros((2, 5)), np.full((1, 6), np.nan)):
        with pytest.raises(InvalidInputError, match="joint positions of shape"):
            kinematics.solve(pose, q)
    with pytest.raises(InvalidInputError, match="3 poses for 2 starts"):
        kinematics.solve(np.repeat(pose[None], 3, axis=0), np.zeros((2, 6)))
    with pytest.raises(InvalidInputError, match=r"poses\[1\]"):
        kinematics.solve([pose, 2.0 * pose], np.zeros((2, 6)))
    for poses, starts in (
        ([], np.zeros((2, 6))),
        (np.zeros((0, 12)), np.zeros((2, 6))),
        ([pose] * 2, np.zeros((1, 6))),
    ):
        with pytest.raises(InvalidInputError, match=rf"arm 'arm': poses: {len(poses)} poses for {len(starts)} starts"):
            kinematics.solve(poses, starts)
    with pytest.raises(InvalidInputError, match="arm 'arm'"):
        kinematics.walk([], np.zeros((1, 6)))
    with pytest.raises(InvalidInputError, match=r"shape \(M, 6\), got shape \(2, 5\).*joint_1, joint_2, .*joint_6\."):
        kinematics.tool_poses(np.zeros((2, 5)))


def test_an_arm_whose_joints_neither_turn_nor_slide_is_named() -> None:
    model = pin.Model()
    joint = model.addJoint(
        0, pin.JointModelHelicalUnaligned(np.array([0.0, 0.0, 1.0]), 0.1), pin.SE3.Identity(), "screw"
    )
    model.addFrame(pin.Frame("tool", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    arm = Arm.from_model("drill", model, tool_frame="tool", lower_limits=-1.0, upper_limits=1.0, velocity_limits=1.0)
    with pytest.raises(
        ModelError, match=r"^arm 'drill': joint screw neither turns about an axis nor slides along one$"
    ):
        ArmKinematics(arm)


def test_starts_are_not_changed() -> None:
    kinematics = KINEMATICS["rx90l"]
    q = np.full((3, 6), 0.3)
    kinematics.solve(np.eye(4), q)
    assert (q == 0.3).all()
