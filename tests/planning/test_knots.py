"""Geometries of paths, and knots of the arms along them: exact derivatives, proved by differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first

from coopqp import HoldPath, LinePath, WaypointPath
from coopqp.errors import UnreachableError
from coopqp.model.batch import ArmKinematics
from coopqp.paths.geometry import PathGeometry, blended
from coopqp.planning.knots import ArmKnots, Following, Motion, arm_knots, follow, spread_knots
from coopqp.scenarios import Scenario, dual_arm7, five_joint_pair, mixed_cell, paper_lift

RNG = np.random.default_rng


def random_pose(rng: np.random.Generator, *, near: pin.SE3 | None = None, size: float = 1.0) -> pin.SE3:
    step = pin.exp6(pin.Motion(size * rng.uniform(-1.0, 1.0, 6)))
    return step if near is None else near * step


def waypoints(seed: int, count: int = 4) -> WaypointPath:
    rng = RNG(seed)
    return WaypointPath([random_pose(rng) for _ in range(count)], durations=rng.uniform(0.5, 2.0, count - 1))


def lines(path: WaypointPath) -> list:
    return [line for segment in path.segments if (line := segment.straight())]


@pytest.mark.parametrize("seed", range(6))
def test_twists_are_the_change_of_poses(seed: int) -> None:
    geometry = blended(lines(waypoints(seed)), distance=0.05, angle=0.1)
    assert geometry.corners == ()
    h = 1e-6
    s = RNG(seed).uniform(10.0 * h, geometry.length - 10.0 * h, 40)
    s = np.sort(s[np.abs(s[:, None] - geometry.marks).min(axis=1) > 2.0 * h])
    V, dV = geometry.twists(s)
    for i, at in enumerate(s):
        before, after, here = geometry.pose(at - h), geometry.pose(at + h), geometry.pose(at)
        change = (after.translation - before.translation) / (2.0 * h)
        turn = here.rotation @ pin.log3(before.rotation.T @ after.rotation) / (2.0 * h)
        np.testing.assert_allclose(V[i], np.concatenate([change, turn]), atol=1e-7)
        R, p = geometry.poses(np.array([at]))
        np.testing.assert_allclose(here.homogeneous[:3], np.hstack([R[0], p.T]), atol=1e-14)
        np.testing.assert_allclose(V[i], geometry.twist(at), atol=1e-13)
        np.testing.assert_allclose(dV[i], (geometry.twist(at + h) - geometry.twist(at - h)) / (2.0 * h), atol=1e-6)


@pytest.mark.parametrize("seed", slow_but_first(range(6)))
def test_blends_join_smoothly_and_stay_within_their_tolerance(seed: int) -> None:
    straight = lines(waypoints(seed))
    distance, angle = RNG(seed).uniform(1e-3, 0.2, 2)
    geometry = blended(straight, distance=distance, angle=angle)
    assert len(geometry.pieces) > len(straight)
    for before, after in zip(geometry.pieces[:-1], geometry.pieces[1:], strict=True):
        end, start = np.array([before.length]), np.zeros(1)
        for a, b in zip(
            (*before.poses(end), *before.twists(end)), (*after.poses(start), *after.twists(start)), strict=True
        ):
            np.testing.assert_allclose(a, b, atol=1e-12)
    R, p = geometry.poses(np.linspace(0.0, geometry.length, 400))
    dense = PathGeometry(tuple(straight)).poses(np.linspace(0.0, sum(x.length for x in straight), 8000))
    for rotation, origin in zip(R, p, strict=True):
        away = np.linalg.norm(dense[1] - origin, axis=1)
        turned = np.arccos(np.clip(0.5 * (np.einsum("ij,kij->k", rotation, dense[0]) - 1.0), -1.0, 1.0))
        assert (np.maximum(away / distance, turned / angle)).min() <= 1.0 + 5e-3
    corner_near = min(np.linalg.norm(p - x.p, axis=1).min() for x in straight[1:])
    assert corner_near <= distance


def test_the_geometry_of_a_path_goes_where_the_path_goes() -> None:
    path = waypoints(1)
    geometry = path.geometry()
    assert geometry is not None
    assert geometry.corners == (1, 2)
    assert len(geometry.stretches()) == 3
    s = np.linspace(0.0, geometry.length, 50)
    for at, clock in zip(s, path.clocks(s), strict=True):
        np.testing.assert_allclose(geometry.pose(at).homogeneous, path.pose(clock).homogeneous, atol=1e-12)
    assert HoldPath(np.eye(4)).geometry() is None
    assert LinePath(np.eye(4), np.eye(4), duration=1.0).geometry() is None


def test_collinear_lines_have_no_corner() -> None:
    a, step = random_pose(RNG(3)), np.array([0.1, 0.2, 0.3])
    poses = [pin.SE3(a.rotation, a.translation + k * step) for k in (0.0, 1.0, 2.5)]
    geometry = WaypointPath(poses, durations=[1.0, 1.0]).geometry()
    assert geometry is not None
    assert geometry.corners == ()


@pytest.mark.parametrize("build", [paper_lift, dual_arm7, mixed_cell])
def test_derivatives_of_the_joints_are_exact(build: object) -> None:
    """Six joints, seven, a continuous one, a rail: positions at refined knots give q′, and q′ gives q″."""
    scenario: Scenario = build()  # type: ignore[operator]
    cell, grasp = scenario.cell, scenario.grasp
    end = scenario.path.pose(scenario.path.duration)
    turned = random_pose(RNG(0), near=end, size=0.03)
    path = WaypointPath([scenario.path.pose(0.0), end, turned], durations=[1.0, 1.0])
    geometry = blended(lines(path), distance=0.01, angle=0.05)
    x0 = cell.positions(scenario.q_start)
    knots = follow(cell, grasp, geometry, x0, count=40)
    assert np.isin(geometry.marks, knots.s).all()
    assert (np.diff(knots.s) > 0.0).all()
    h = 2e-5 * geometry.length
    inner = knots.s[np.abs(knots.s[:, None] - geometry.marks).min(axis=1) > 2.0 * h]
    fine = np.unique(np.concatenate([knots.s, inner - h, inner + h]))
    at = np.searchsorted(fine, inner)
    here = np.searchsorted(knots.s, inner)
    for k, arm in enumerate(cell.arms):
        kinematics = ArmKinematics(arm)
        own = cell.v_slices[k].start + kinematics.columns
        found = arm_knots(kinematics, grasp.T_object_tool[k], Motion.of(geometry, fine), x0[own])
        assert found.reached == len(fine) - 1
        q, slope, curvature = (x[here][:, own] for x in (knots.q, knots.slope, knots.curvature))
        np.testing.assert_allclose(found.q[at], q, atol=1e-8)
        np.testing.assert_allclose((found.q[at + 1] - found.q[at - 1]) / (2.0 * h), slope, atol=1e-5)
        bend = (found.slope[at + 1] - found.slope[at - 1]) / (2.0 * h)
        np.testing.assert_allclose(bend, curvature, atol=2e-4 * np.abs(curvature).max())


def following(scenario: Scenario, geometry: PathGeometry) -> Following:
    return Following(scenario.cell, scenario.grasp, geometry, scenario.cell.positions(scenario.q_start))


@pytest.mark.parametrize("gather", [False, True])
@pytest.mark.parametrize("build", [paper_lift, dual_arm7, mixed_cell])
def test_knots_are_spread_evenly_over_the_joints_motion(build: object, gather: bool) -> None:
    """Each interval has its share of the way (30 %) and of the motion of the arm that moves most (70 %); s of a motion
    with bounded jerk goes from rest to rest like ``10 t³ − 15 t⁴ + 6 t⁵``."""
    scenario: Scenario = build()  # type: ignore[operator]
    cell, geometry = scenario.cell, scenario.path.geometry()
    assert geometry is not None
    assert len(geometry.pieces) == 1
    follower = following(scenario, geometry)
    s = follower.spread(31, gather=gather)
    assert s[[0, -1]] == pytest.approx([0.0, geometry.length])
    fine = np.linspace(0.0, geometry.length, 2001)
    unit = np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0)
    motion = np.abs(follower.at(fine).slope / unit).max(axis=1)
    moved = np.concatenate([[0.0], np.cumsum(0.5 * (motion[1:] + motion[:-1]))])
    done = np.interp(s, fine, 0.7 * moved / moved[-1] + 0.3 * fine / geometry.length)
    t = np.linspace(0.0, 1.0, 31)
    np.testing.assert_allclose(done, 10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5 if gather else t, atol=2e-3)


def test_short_pieces_have_their_share_of_the_knots() -> None:
    """They are looked at more closely, which is no reason to have more knots than 30 % by way and 70 % by motion."""
    scenario = paper_lift()
    start = scenario.path.pose(0.0)
    places = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.1, 0.0, 0.1), (0.1, 0.08, 0.12))
    poses = [pin.SE3(start.rotation, start.translation + np.array(p)) for p in places]
    geometry = blended(lines(WaypointPath(poses, durations=[1.0] * 3)), distance=0.003, angle=0.1)
    follower = following(scenario, geometry)
    fine = np.linspace(0.0, geometry.length, 4001)
    motion = np.abs(follower.at(fine).slope / scenario.cell.limits.velocity).max(axis=1)
    moved = np.concatenate([[0.0], np.cumsum(0.5 * (motion[1:] + motion[:-1]))])
    done = 0.7 * moved / moved[-1] + 0.3 * fine / geometry.length
    share = np.diff(np.interp(geometry.marks, fine, done))
    assert len(share) == 5
    assert share.min() < 0.3 * share.max()
    knots = np.histogram(follower.spread(1001), geometry.marks)[0] - 12  # each piece's own 11, and its first mark
    np.testing.assert_allclose(knots, 1000.0 * share, rtol=0.0, atol=8.0)


def test_a_way_of_few_joints_ends_where_they_cannot_make_the_motion() -> None:
    """Two arms of five joints turn an object about an axis that they have not, or lift it out of their reach."""
    scenario = five_joint_pair()
    start = scenario.path.pose(0.0)
    for step, end in (
        (pin.Motion(np.r_[0.0, 0.0, 0.0, 0.5, 0.3, 0.4]), "5 joints cannot make"),
        (pin.Motion(np.r_[0.0, 0.0, 3.0, 0.0, 0.0, 0.0]), "where its reach ends"),
    ):
        geometry = LinePath(start, start * pin.exp6(step), duration=1.0).geometry()
        assert geometry is not None
        with pytest.raises(UnreachableError, match=f"arm 'left' .* {end}"):
            following(scenario, geometry)


def test_the_way_ends_at_the_first_singularity() -> None:
    """The message has the share of a line upwards at which the arm that it names has its least singular value."""
    scenario = paper_lift()
    start = scenario.path.pose(0.0)
    goal = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 3.0]))
    geometry = LinePath(start, goal, duration=1.0).geometry()
    assert geometry is not None
    with pytest.raises(UnreachableError, match=r"arm 'master' .* to \d+ % of its way") as found:
        following(scenario, geometry)
    share = 0.01 * float(str(found.value).split(" %")[0].split()[-1])
    arm, q = ArmKinematics(scenario.cell.arms[0]), scenario.cell.positions(scenario.q_start)[None, :6]
    ways, least = np.linspace(0.0, 0.3, 61), []
    for way in ways:
        pose = geometry.pose(way * geometry.length) * scenario.grasp.T_object_tool[0]
        q = arm.solve(pose.homogeneous, q).q
        least.append(arm.singular_values(q)[0, -1])
    assert min(least) < 0.01
    assert share == pytest.approx(ways[int(np.argmin(least))], abs=0.02)


def test_knots_of_another_branch_are_not_taken() -> None:
    """Where a guess from other knots leads to an arm's other branch, the arm is followed from its start."""
    scenario = paper_lift()
    geometry = scenario.path.geometry()
    assert geometry is not None
    arm, X, own = ArmKinematics(scenario.cell.arms[0]), scenario.grasp.T_object_tool[0], scenario.cell.v_slices[0]
    s = np.linspace(0.0, geometry.length, 40)
    motion = Motion.of(geometry, s)
    q0 = scenario.cell.positions(scenario.q_start)[own][arm.columns]
    found = arm_knots(arm, X, motion, q0)
    flipped = found.q + np.array([0.0, 0.0, 0.0, np.pi, 0.0, -np.pi])
    flipped[:, 4] *= -1.0
    flipped[:, 0] += 0.1  # Newton's method still finds the flipped wrist
    flipped[0] = found.q[0]
    still = np.zeros_like(flipped)
    again = spread_knots(arm, X, motion, s, ArmKnots(flipped, still, still, found.reached))
    np.testing.assert_allclose(again.q, found.q, atol=1e-12)
