"""Every equation of the paper, (1) to (17), in the printed matrix form, on random data.

The tests write the matrices out. In coopqp they are special cases of general transforms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from coopqp import Grasp, LinePath, Recording, RobotCell, inverse_kinematics
from coopqp.model import CellState
from coopqp.model.grasp import THETA, triangle_frames
from coopqp.paths.path import ScrewParameters
from coopqp.scenarios import Scenario
from coopqp.scenarios.paper import BASE_DISTANCE_H, BASE_OFFSET_B, slave_base
from coopqp.simulation import object_error, relative_orientation_error, relative_positioning_error, tool_placements
from coopqp.spatial import adjoint

Array = NDArray[np.float64]
EXACT = 1e-13
TRIALS = 300


@pytest.fixture(autouse=True)
def _seed() -> None:
    pin.seed(1)


def random_pose() -> Array:
    return np.array(pin.SE3.Random().homogeneous)


def hat(twist: Array) -> Array:
    """Δ of Eq. (13b) from [dx, dy, dz, dφx, dφy, dφz]."""
    x, y, z, a, b, c = twist
    return np.array([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]], dtype=float)


def vee(matrix: Array) -> Array:
    return np.array([*matrix[:3, 3], matrix[2, 1], matrix[0, 2], matrix[1, 0]])


def S(b: float, h: float) -> Array:
    """Eq. (3); S_1 with +b, S_2 with −b."""
    return np.array([[-1, 0, 0, h], [0, -1, 0, b], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)


def M(tau: float, p: Array, r: Array, phi: float) -> Array:
    """Eq. (7), entry by entry, with s, c, v as in the paper."""
    s, c, v = np.sin(tau * phi), np.cos(tau * phi), 1.0 - np.cos(tau * phi)
    rx, ry, rz = r
    return np.array(
        [
            [rx * rx * v + c, ry * rx * v - rz * s, rz * rx * v + ry * s, tau * p[0]],
            [rx * ry * v + rz * s, ry * ry * v + c, rz * ry * v - rx * s, tau * p[1]],
            [rx * rz * v - ry * s, ry * rz * v + rx * s, rz * rz * v + c, tau * p[2]],
            [0, 0, 0, 1],
        ]
    )


def close(a: Array, b: Array, tolerance: float = EXACT) -> None:
    np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance)


# -- (1) to (3): poses and bases -----------------------------------------------------------------------------------


def test_eq_1_is_a_placement(rng: np.random.Generator) -> None:
    for _ in range(TRIALS):
        A = pin.SE3.Random()
        n, o, a, p = A.rotation[:, 0], A.rotation[:, 1], A.rotation[:, 2], A.translation
        close(np.vstack([np.column_stack([n, o, a, p]), [0, 0, 0, 1]]), A.homogeneous)


def test_eq_2_pose_in_a_slaves_base_is_its_own_kinematics(
    paper: Scenario, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    cell = paper.cell
    for _ in range(30):
        q = random_q(cell, rng)
        state = CellState(cell, q)
        for k, sign in ((1, 1.0), (2, -1.0)):
            arm = cell.arms[k]
            data = arm.model.createData()
            pin.framesForwardKinematics(arm.model, data, q[cell.q_slices[k]])
            alone = data.oMf[arm.model.getFrameId(arm.tool_frame)].homogeneous
            base = S(sign * BASE_OFFSET_B, BASE_DISTANCE_H)
            close(alone, np.linalg.inv(base) @ state.T_world_tool[k].homogeneous)


def test_eq_3_bases_of_the_slaves(paper: Scenario, rng: np.random.Generator) -> None:
    for b, h in rng.uniform(-5.0, 5.0, (TRIALS, 2)):
        base = slave_base(b, h).homogeneous
        close(base, S(b, h), 0.0)
        close(base @ base, np.eye(4))  # each is its own inverse
    for k, b in ((1, BASE_OFFSET_B), (2, -BASE_OFFSET_B)):
        close(paper.cell.arms[k].T_world_base.homogeneous, S(b, BASE_DISTANCE_H), 0.0)
    close(paper.cell.arms[0].T_world_base.homogeneous, np.eye(4), 0.0)


def test_S_12_and_S_21_are_translations_along_y(rng: np.random.Generator) -> None:
    for b, h in rng.uniform(-5.0, 5.0, (TRIALS, 2)):
        S_12 = slave_base(b, h).actInv(slave_base(-b, h)).homogeneous
        S_21 = slave_base(-b, h).actInv(slave_base(b, h)).homogeneous
        expected = np.eye(4)
        expected[1, 3] = 2.0 * b
        close(S_12, expected)
        expected[1, 3] = -2.0 * b
        close(S_21, expected)
        close(S_12 @ S_21, np.eye(4))


# -- (4) to (6): grasp points --------------------------------------------------------------------------------------


def test_eq_5_theta_is_a_proper_involution() -> None:
    close(THETA, np.array([[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float), 0.0)
    close(THETA @ THETA, np.eye(4), 0.0)
    assert np.linalg.det(THETA) == pytest.approx(1.0, abs=1e-15)
    # Tool x = −x_A, tool y = z_A (the plate's normal), tool z = y_A (the approach direction).
    close(THETA[:3, :3], np.column_stack([-np.eye(3)[0], np.eye(3)[2], np.eye(3)[1]]), 0.0)


def test_eq_4_grasp_points_from_the_tools(
    paper: Scenario, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    K_B, K_C = triangle_frames(0.60, 0.30)
    for _ in range(30):
        state = CellState(paper.cell, random_q(paper.cell, rng))
        for T, O, K in zip(state.T_world_tool, paper.grasp.carried(state), (np.eye(4), K_B, K_C), strict=True):
            close(T.homogeneous @ THETA, O.homogeneous @ K)  # both sides give the grasp point's frame


def test_eq_6_frames_of_B_and_C(rng: np.random.Generator) -> None:
    for alpha, beta in rng.uniform(0.01, 2.0, (TRIALS, 2)):
        K_B, K_C = triangle_frames(alpha, beta)
        close(K_B, np.array([[-1, 0, 0, -beta], [0, -1, 0, 3 * alpha], [0, 0, 1, 0], [0, 0, 0, 1]]), 0.0)
        close(K_C, np.array([[-1, 0, 0, beta], [0, -1, 0, 3 * alpha], [0, 0, 1, 0], [0, 0, 0, 1]]), 0.0)
        close(K_B @ K_B, np.eye(4))
        close(K_C @ K_C, np.eye(4))
        centroid = (np.zeros(3) + K_B[:3, 3] + K_C[:3, 3]) / 3.0
        close(centroid, np.array([0.0, 2.0 * alpha, 0.0]), 1e-15)
        grasp = Grasp.triangle(alpha, beta)
        for X, K in zip(grasp.T_object_tool, (np.eye(4), K_B, K_C), strict=True):
            close(X.homogeneous, K @ THETA, 0.0)


# -- (7) to (10): the object's motion ------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["linear", "quintic"])
def test_eq_7_8_motion_of_A_entry_by_entry(law: str, rng: np.random.Generator) -> None:
    for _ in range(TRIALS):
        G0, duration = random_pose(), rng.uniform(0.1, 10.0)
        path = LinePath(G0, random_pose(), duration=duration, time_law=law)
        screw = path.screw
        assert np.linalg.norm(screw.r) == pytest.approx(1.0, abs=1e-14)
        for x in (0.0, 1.0, *rng.uniform(0.0, 1.0, 3)):
            tau = x if law == "linear" else 10 * x**3 - 15 * x**4 + 6 * x**5
            expected = G0 @ M(tau, screw.p, screw.r, screw.angle)
            close(path.pose(x * duration).homogeneous, expected, 1e-12)


def test_eq_8_A_moves_on_a_straight_line_about_a_fixed_axis(rng: np.random.Generator) -> None:
    for _ in range(100):
        start, goal = pin.SE3.Random(), pin.SE3.Random()
        path = LinePath(start, goal, duration=1.0, time_law="linear")
        axis = start.rotation @ path.screw.r  # in the world
        for tau in rng.uniform(0.0, 1.0, 3):
            T = path.pose(tau)
            close(T.translation, (1.0 - tau) * start.translation + tau * goal.translation)
            # The axis passes through A and is fixed in the world and in the body.
            close(T.rotation @ path.screw.r, axis)
            close(T.rotation @ start.rotation.T @ axis, axis)


def test_eq_9_reaches_the_goal() -> None:
    for _ in range(TRIALS):
        G0, G1 = random_pose(), random_pose()
        path = LinePath(G0, G1, duration=3.0)
        close(path.pose(3.0).homogeneous, G1)
        screw = ScrewParameters.between(G0, G1)
        close(G0 @ M(1.0, screw.p, screw.r, screw.angle), G1)


def eq_10(G0: Array, G1: Array) -> tuple[Array, float, Array]:
    """p, φ*, r of Eqs. (10a), (10b), (10c) as printed, without normalisation of r."""
    n0, o0, a0, p0 = G0[:3, 0], G0[:3, 1], G0[:3, 2], G0[:3, 3]
    n1, o1, a1, p1 = G1[:3, 0], G1[:3, 1], G1[:3, 2], G1[:3, 3]
    p = np.array([n0 @ (p1 - p0), o0 @ (p1 - p0), a0 @ (p1 - p0)])
    phi = np.arccos(np.clip(0.5 * (n0 @ n1 + o0 @ o1 + a0 @ a1 - 1.0), -1.0, 1.0))
    r = np.array([a0 @ o1 - o0 @ a1, n0 @ a1 - a0 @ n1, o0 @ n1 - n0 @ o1])
    return p, float(phi), r


def test_eq_10_displacement_angle_and_axis() -> None:
    for _ in range(TRIALS):
        G0, G1 = random_pose(), random_pose()
        p, phi, r = eq_10(G0, G1)
        screw = ScrewParameters.between(G0, G1)
        close(screw.p, p)
        if 0.1 < phi < np.pi - 0.1:  # near 0 and π arccos loses accuracy
            assert screw.angle == pytest.approx(phi, abs=1e-13)
            # (10c) as printed has the norm 2 sin φ*; M(t) needs the unit vector.
            assert np.linalg.norm(r) == pytest.approx(2.0 * np.sin(phi), abs=1e-13)
            close(screw.r, r / np.linalg.norm(r))
            if abs(2.0 * np.sin(phi) - 1.0) > 0.1:
                assert np.abs(G0 @ M(1.0, p, r, phi) - G1).max() > 1e-2, "an axis that is no unit vector turns wrong"


def axis_angle(r: Array, angle: float) -> pin.SE3:
    """A rotation by Rodrigues' formula, accurate also for angles near π."""
    return pin.SE3(M(1.0, np.zeros(3), r, angle)[:3, :3], np.zeros(3))


def random_axis(rng: np.random.Generator) -> Array:
    r = rng.normal(size=3)
    return np.asarray(r / np.linalg.norm(r))


def test_eq_10_no_rotation_skips_the_axis(rng: np.random.Generator) -> None:
    for _ in range(100):
        G0 = pin.SE3.Random()
        G1 = pin.SE3(G0.rotation, rng.normal(size=3))
        screw = ScrewParameters.between(G0, G1)
        assert screw.angle == pytest.approx(0.0, abs=1e-15)
        path = LinePath(G0, G1, duration=1.0, time_law="linear")
        close(path.pose(0.5).rotation, G0.rotation)
        close(path.pose(1.0).homogeneous, G1.homogeneous)
    same = ScrewParameters.between(G0, G0)
    assert same.angle == 0.0
    close(same.r, np.zeros(3), 0.0)
    close(same.p, np.zeros(3), 0.0)


def test_eq_10_half_a_turn_has_an_axis_of_either_sign(rng: np.random.Generator) -> None:
    axes = [*np.eye(3), np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0), *(random_axis(rng) for _ in range(200))]
    for r in axes:
        G0 = pin.SE3.Random()
        G1 = G0 * axis_angle(r, np.pi)
        _, _, printed = eq_10(G0.homogeneous, G1.homogeneous)
        assert np.linalg.norm(printed) < 1e-14, "(10c) vanishes at half a turn"
        screw = ScrewParameters.between(G0, G1)
        assert screw.angle == pytest.approx(np.pi, abs=1e-14)
        assert abs(screw.r @ r) == pytest.approx(1.0, abs=1e-14)
        close(LinePath(G0, G1, duration=2.0).pose(2.0).homogeneous, G1.homogeneous)


@pytest.mark.parametrize("exponent", range(1, 17))
def test_eq_10_keeps_its_digits_near_zero_and_near_half_a_turn(exponent: int, rng: np.random.Generator) -> None:
    small = 10.0**-exponent
    for _ in range(50):
        r, G0 = random_axis(rng), pin.SE3.Random()
        turned = pin.SE3(G0.rotation @ axis_angle(r, np.pi - small).rotation, rng.normal(size=3))
        screw = ScrewParameters.between(G0, turned)
        assert screw.angle == pytest.approx(np.pi - small, abs=1e-14)
        assert np.linalg.norm(screw.r) == pytest.approx(1.0, abs=1e-14)
        if small > 1e-14:
            assert screw.r @ r > 0.0, "below half a turn the sign is not free"
        close(np.abs(screw.r @ r), np.array(1.0), 1e-12)
        close(LinePath(G0, turned, duration=1.0).pose(1.0).homogeneous, turned.homogeneous)
        little = ScrewParameters.between(G0, G0 * axis_angle(r, small))
        assert little.angle == pytest.approx(small, abs=1e-15)


def test_arccos_of_eq_10b_loses_half_its_digits() -> None:
    r, small = np.array([0.0, 0.6, 0.8]), 1e-8
    for angle in (small, np.pi - small):
        _, printed, _ = eq_10(np.eye(4), axis_angle(r, angle).homogeneous)
        assert abs(printed - angle) > 1e-9
        assert ScrewParameters.between(np.eye(4), axis_angle(r, angle)).angle == pytest.approx(angle, abs=1e-15)


# -- (11), (12): the other grasp points and the tools ----------------------------------------------------------------


def test_eq_11_12_grasp_points_and_tools_in_their_own_bases(rng: np.random.Generator) -> None:
    for _ in range(TRIALS):
        alpha, beta, b, h = rng.uniform(0.1, 3.0, 4)
        G0, G1 = random_pose(), random_pose()
        path, grasp = LinePath(G0, G1, duration=1.0, time_law="linear"), Grasp.triangle(alpha, beta)
        tau = rng.uniform()
        motion = M(tau, path.screw.p, path.screw.r, path.screw.angle)
        K_B, K_C = triangle_frames(alpha, beta)
        bases = (pin.SE3.Identity(), slave_base(b, h), slave_base(-b, h))
        points = [G0 @ motion, S(b, h) @ G0 @ motion @ K_B, S(-b, h) @ G0 @ motion @ K_C]  # (8), (11)
        tools = [point @ THETA for point in points]  # (12)
        targets = grasp.tool_targets(path.pose(tau))
        for base, target, point, tool in zip(bases, targets, points, tools, strict=True):
            own = base.actInv(target).homogeneous
            close(own, tool, 1e-12)
            close(own @ THETA, point, 1e-12)


# -- (13) to (16): increments ----------------------------------------------------------------------------------------


def orders(error: Callable[[float], float], steps: Array) -> Array:
    errors = np.array([error(dt) for dt in steps])
    return np.log2(errors[:-1] / errors[1:])


def test_eq_13_14_are_first_order(rng: np.random.Generator) -> None:
    steps = 0.02 * 0.5 ** np.arange(5)
    for _ in range(30):
        path = LinePath(random_pose(), random_pose(), duration=1.0)
        grasp = Grasp.triangle(*rng.uniform(0.1, 1.0, 2))
        t = rng.uniform(0.2, 0.7)

        def object_remainder(dt: float, path: LinePath = path, t: float = t) -> float:
            G, G_next = path.pose(t).homogeneous, path.pose(t + dt).homogeneous
            return float(np.abs(G_next - G @ (np.eye(4) + hat(path.twist(t) * dt))).max())

        def arm_remainder(dt: float, path: LinePath = path, t: float = t, grasp: Grasp = grasp) -> float:
            now, then = grasp.tool_targets(path.pose(t)), grasp.tool_targets(path.pose(t + dt))
            deltas = grasp.arm_increments(path.twist(t) * dt)
            return max(
                float(np.abs(H1.homogeneous - H.homogeneous @ (np.eye(4) + hat(d))).max())
                for H, H1, d in zip(now, then, deltas, strict=True)
            )

        for remainder in (object_remainder, arm_remainder):
            assert orders(remainder, steps)[-1] == pytest.approx(2.0, abs=0.15)


def test_eq_15_16_as_matrices(rng: np.random.Generator) -> None:
    for _ in range(TRIALS):
        alpha, beta = rng.uniform(0.01, 2.0, 2)
        delta = rng.normal(size=6)
        K_B, K_C = triangle_frames(alpha, beta)
        printed = [
            THETA @ hat(delta) @ THETA,
            THETA @ K_B @ hat(delta) @ K_B @ THETA,
            THETA @ K_C @ hat(delta) @ K_C @ THETA,
        ]
        got = Grasp.triangle(alpha, beta).arm_increments(delta)
        close(got, np.array([vee(m) for m in printed]), 1e-13)


def test_the_18_component_lists_below_eq_16(rng: np.random.Generator) -> None:
    for _ in range(TRIALS):
        alpha, beta = rng.uniform(0.01, 2.0, 2)
        dx, dy, dz, fx, fy, fz = delta = rng.normal(size=6)
        master = [-dx, dz, dy, -fx, fz, fy]
        slave_1 = [dx - 3 * alpha * fz, dz + beta * fy + 3 * alpha * fx, -dy + beta * fz, fx, fz, -fy]
        slave_2 = [dx - 3 * alpha * fz, dz - beta * fy + 3 * alpha * fx, -dy - beta * fz, fx, fz, -fy]
        close(Grasp.triangle(alpha, beta).arm_increments(delta), np.array([master, slave_1, slave_2]), 1e-14)


def test_eq_16_is_exact_for_finite_motions_of_any_grasp(rng: np.random.Generator) -> None:
    for _ in range(TRIALS):
        grasp = Grasp(tuple(pin.SE3.Random() for _ in range(4)))
        delta = rng.normal(size=6)
        for X, arm_delta in zip(grasp.T_object_tool, grasp.arm_increments(delta), strict=True):
            left = X.inverse() * pin.exp6(pin.Motion(delta)) * X
            close(left.homogeneous, pin.exp6(pin.Motion(arm_delta)).homogeneous)
            close(arm_delta, adjoint(X.inverse()) @ delta)


# -- (17): the joints ------------------------------------------------------------------------------------------------


FRAMES = {
    "tool": (pin.LOCAL, lambda H: np.eye(6)),
    "tool, world axes": (pin.LOCAL_WORLD_ALIGNED, lambda H: np.kron(np.eye(2), H.rotation)),
    "world": (pin.WORLD, adjoint),
}


def test_eq_17_pairs_of_frames(paper: Scenario, random_q: Callable[..., Array], rng: np.random.Generator) -> None:
    cell = paper.cell
    for _ in range(20):
        state = CellState(cell, random_q(cell, rng))
        for k, H in enumerate(state.T_world_tool):
            dq = rng.normal(size=6)
            delta = state.jacobian(k) @ dq  # J_LOCAL δq = δ
            for frame, carry in FRAMES.values():
                close(state.jacobian(k, frame) @ dq, carry(H) @ delta, 1e-12)


def test_eq_17_body_increment_is_what_the_tool_does(
    paper: Scenario, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    cell = paper.cell
    for _ in range(20):
        q, dq = random_q(cell, rng), rng.normal(size=cell.nv)
        state = CellState(cell, q)
        for k, s in enumerate(cell.v_slices):
            expected = state.jacobian(k) @ dq[s]

            def remainder(
                h: float, k: int = k, q: Array = q, dq: Array = dq, expected: Array = expected, state: CellState = state
            ) -> float:
                moved = CellState(cell, q + h * dq).T_world_tool[k]
                made = pin.log6(state.T_world_tool[k].actInv(moved)).vector
                return float(np.abs(made - h * expected).max())

            assert orders(remainder, np.array([1e-3, 5e-4]))[0] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("right", FRAMES)
@pytest.mark.parametrize("jacobian", FRAMES)
def test_eq_17_a_wrong_pair_leaves_the_path(paper: Scenario, jacobian: str, right: str) -> None:
    """The lift arrives only if the Jacobian and the increment refer to the same frame."""
    cell, grasp, path = paper.cell, paper.grasp, paper.path
    steps, q = 60, paper.q_start.copy()
    frame, carry = FRAMES[jacobian][0], FRAMES[right][1]
    for i in range(steps):
        state = CellState(cell, q)
        deltas = grasp.arm_increments(path.increment(i * 3.0 / steps, 3.0 / steps) * 3.0 / steps)
        dq = [np.linalg.solve(state.jacobian(k, frame), carry(H) @ deltas[k]) for k, H in enumerate(state.T_world_tool)]
        q = q + np.concatenate(dq)
    worst = max(
        object_error(tools, grasp, path.pose(3.0), k)[0] for tools in tool_placements(cell, [q]) for k in range(3)
    )
    if jacobian == right:
        assert worst < 0.01
    else:
        assert worst > 0.2  # [m]


# -- the errors below Figure 5 ---------------------------------------------------------------------------------------


def test_reference_vectors_and_orientations(rng: np.random.Generator) -> None:
    for alpha, beta in rng.uniform(0.01, 2.0, (TRIALS, 2)):
        m, s1, s2 = Grasp.triangle(alpha, beta).T_object_tool
        close(m.actInv(s1).translation, np.array([beta, 0.0, 3.0 * alpha]), 1e-15)
        close(m.actInv(s2).translation, np.array([-beta, 0.0, 3.0 * alpha]), 1e-15)
        close(s1.actInv(s2).translation, np.array([2.0 * beta, 0.0, 0.0]), 1e-15)
        close(m.actInv(s1).rotation, np.diag([-1.0, 1.0, -1.0]), 1e-15)
        close(m.actInv(s2).rotation, np.diag([-1.0, 1.0, -1.0]), 1e-15)
        close(s1.actInv(s2).rotation, np.eye(3), 1e-15)


def test_errors_below_figure_5(rng: np.random.Generator) -> None:
    d = np.array([[0.3, 0.0, 1.8], [-0.3, 0.0, 1.8], [0.6, 0.0, 0.0]])
    R_ref = [np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.eye(3)]
    grasp = Grasp.triangle(0.6, 0.3)
    for _ in range(TRIALS):
        tools = [T * pin.exp6(pin.Motion(0.05 * rng.normal(size=6))) for T in grasp.tool_targets(pin.SE3.Random())]
        pairs = [tools[0].actInv(tools[1]), tools[0].actInv(tools[2]), tools[1].actInv(tools[2])]
        e_p = [np.linalg.norm(pair.translation - ref) for pair, ref in zip(pairs, d, strict=True)]
        e_o = [np.linalg.norm(pin.log3(ref.T @ pair.rotation)) for pair, ref in zip(pairs, R_ref, strict=True)]
        assert relative_positioning_error(tools, grasp) == pytest.approx(np.linalg.norm(e_p), abs=1e-14)
        assert relative_orientation_error(tools, grasp) == pytest.approx(np.linalg.norm(e_o), abs=1e-13)


# -- Step 1 and the fixture ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [40, 400])
def test_the_literal_increment_is_a_screw_that_ends_elsewhere(
    steps: int, paper: Scenario, baseline: Callable[..., Recording]
) -> None:
    """N equal body increments (p, φ* r)/N give exp((p, φ* r)) instead of M: 103 mm off for any N, unseen by ε_p."""
    screw = paper.path.screw
    gap = paper.path.start * pin.exp6(pin.Motion(np.concatenate([screw.p, screw.angle * screw.r])))
    assert 1e3 * np.linalg.norm(gap.translation - paper.path.goal.translation) == pytest.approx(103.0, rel=0.01)
    run = baseline(steps, increment="literal")
    tools = tool_placements(paper.cell, run.q[-1:])[0]
    drift = 1000.0 / steps / 10.0  # drift of the joint integration [mm]
    assert 1e3 * object_error(tools, paper.grasp, paper.path.goal)[0] == pytest.approx(103.0, abs=0.8 + drift)
    assert 1e3 * relative_positioning_error(tools, paper.grasp) < 400.0 / steps


def test_fixture_starts_exactly_and_keeps_its_margins(paper: Scenario, baseline: Callable[..., Recording]) -> None:
    cell: RobotCell = paper.cell
    expected = np.deg2rad(
        [0, 65.4, 76.0, 180, 51.3, -90, 13.8, 67.4, 71.9, -162.1, 50.7, -101.6, -13.8, 67.4, 71.9, 162.1, 50.7, -78.4]
    )
    close(paper.q_start, expected, np.deg2rad(0.06))
    start = pin.SE3(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.9, 0.0, 0.1]))
    close(paper.path.start.homogeneous, start.homogeneous, 0.0)
    for O in paper.grasp.carried(CellState(cell, paper.q_start)):
        close(O.homogeneous, start.homogeneous, 1e-11)
    # The whole lift by inverse kinematics: margins to the limits and to singularities.
    q, margin, sigma = paper.q_start, np.inf, np.inf
    clocks = np.linspace(0.0, 3.0, 61)
    for clock in clocks:
        q = inverse_kinematics(cell, paper.grasp, paper.path.pose(clock), q)
        state = CellState(cell, q)
        margin, sigma = min(margin, state.limit_margins.min()), min(sigma, state.sigma_min.min())
    assert np.rad2deg(margin) > 56.0
    assert sigma == pytest.approx(0.169, abs=2e-3)
    assert (np.abs(baseline(400).velocity) / cell.limits.velocity).max() < 0.09
