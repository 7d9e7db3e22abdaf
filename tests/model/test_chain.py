"""The chain: batched kinematics of the object poses of all arms, compared with states of a cell."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from torsos import robot_of

from coopqp import Arm, Grasp, RobotCell
from coopqp.control.monitoring.stress import whole_compliance
from coopqp.model import CellState
from coopqp.model.chain import SINGULAR_FLOOR, Chain
from coopqp.scenarios import Scenario, robot_path
from coopqp.spatial import adjoint, for_twists

Array = NDArray[np.float64]
FEW = settings(max_examples=settings().max_examples // 4)  # each example builds two cells
RandomQ = Callable[[RobotCell, np.random.Generator], Array]
CELLS = (
    ["rx90l"],
    ["arm7"],
    ["scara4"],
    ["rx90l", "rx90l", "rx90l"],
    ["arm7", "gantry7"],
    ["rx90l", "arm7", "rx90l"],  # groups whose columns are not contiguous
    ["arm5", "arm6c", "scara4", "arm5"],
    ["arm7", "rx90l", "scara4", "gantry7", "arm5", "arm6c"],
)


#: Where Jacobians are taken: any point will do [m].
ABOUT = np.array([0.4, -1.3, 0.7])


def to_point(about: Array) -> Array:
    """Twists at the world's origin to twists at a point, in world axes (6, 6)."""
    return adjoint(pin.SE3(np.eye(3), -about))


def tool_jacobian(state: CellState, k: int, about: Array = ABOUT) -> Array:
    """Jacobian of an arm about a point, in world axes."""
    return to_point(about) @ state.jacobian(k, pin.WORLD)


def turned(R: pin.SE3) -> Array:
    """Twists at the origin of R, in its axes, to world axes (6, 6)."""
    return adjoint(pin.SE3(R.rotation, np.zeros(3)))


def close(a: Any, b: Any, tolerance: float) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


@pytest.fixture(params=CELLS, ids="-".join)
def setting(request: pytest.FixtureRequest, make_cell: Any, random_q: RandomQ, rng: Any) -> tuple[Chain, Array]:
    """A chain with a random grasp, and a configuration away from singularities."""
    pin.seed(11)
    cell = make_cell(request.param, [pin.SE3.Random() for _ in request.param])
    q = next(q for q in (random_q(cell, rng) for _ in range(1000)) if CellState(cell, q).sigma_min.min() > 0.05)
    return Chain(cell, Grasp(tuple(pin.SE3.Random() for _ in request.param))), q


# -- poses and errors --------------------------------------------------------------------------------------------------


def test_carried_is_the_grasps(setting: tuple[Chain, Array], random_q: RandomQ, rng: Any) -> None:
    chain, _ = setting
    for _ in range(20):
        q = random_q(chain.cell, rng)
        O = chain.carried(q)
        for own, expected in zip(O, chain.grasp.carried(CellState(chain.cell, q)), strict=True):
            close(own.homogeneous, expected.homogeneous, 1e-14)


def test_an_answer_outlives_the_next_question(setting: tuple[Chain, Array], random_q: RandomQ, rng: Any) -> None:
    chain, q = setting
    first = chain.carried(q)
    kept = [own.copy() for own in first]
    chain.carried(random_q(chain.cell, rng))
    chain.linearise(random_q(chain.cell, rng), ABOUT)
    assert first == kept
    assert chain.carried(q) == kept


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.01, 0.1, 1.0, 2.5])
def test_errors_are_logs(setting: tuple[Chain, Array], size: float, rng: Any) -> None:
    """Tests small errors, large errors, and both together."""
    chain, q = setting
    O = chain.carried(q)
    for _ in range(10):
        xi = rng.normal(size=6)
        xi[3:] *= size / np.linalg.norm(xi[3:])
        R = O[0] * pin.exp6(pin.Motion(xi))
        errors = chain.errors(chain.carried(q), R)
        assert errors.shape == (chain.n_arms, 6)
        close(errors[0], -xi, 1e-11)
        for e, o in zip(errors, O, strict=True):
            close(e, pin.log6(R.actInv(o)).vector, 1e-11 * max(1.0, np.abs(e).max()))  # metres, and nearly half a turn


def test_a_latched_grasp_has_no_error(setting: tuple[Chain, Array], rng: Any) -> None:
    chain, q = setting
    R = pin.SE3.Random()
    latched = Chain(chain.cell, Grasp.from_configuration(chain.cell, q, R))
    assert np.abs(latched.errors(latched.carried(q), R)).max() < 1e-14
    moved = R * pin.exp6(pin.Motion(0.001 * rng.normal(size=6)))
    errors = latched.errors(latched.carried(q), moved)
    close(errors, np.tile(errors[0], (latched.n_arms, 1)), 1e-14)


def test_tiny_errors_are_logs_and_half_a_turn_is_none(setting: tuple[Chain, Array], rng: Any) -> None:
    chain, q = setting
    R = pin.SE3.Random()
    latched = Chain(chain.cell, Grasp.from_configuration(chain.cell, q, R))
    O = latched.carried(q)
    for axis in np.vstack([np.eye(6), -np.eye(6)]):
        xi = 5e-9 * axis + 1e-9 * rng.uniform(-1, 1, 6)
        close(latched.errors(O, R * pin.exp6(pin.Motion(xi))), np.tile(-xi, (latched.n_arms, 1)), 1e-14)
    for axis in np.eye(3):
        turned_round = R * pin.SE3(np.diag(2.0 * axis - 1.0), np.zeros(3))
        for e in latched.errors(O, turned_round):
            close(np.abs(e), np.concatenate([np.zeros(3), np.pi * axis]), 1e-7)


# -- Jacobians ---------------------------------------------------------------------------------------------------------


def test_jacobians_are_derivatives_of_what_is_carried(setting: tuple[Chain, Array], rng: Any) -> None:
    """A_k = blockdiag(Rᵀ, Rᵀ) J_k equals central differences of O_k for any grasp and any R, J about R's origin."""
    chain, q = setting
    cell, h = chain.cell, 1e-5
    R = pin.SE3.Random()
    for _ in range(3):
        v = rng.uniform(-1, 1, cell.nv)
        back, ahead = (chain.carried(pin.integrate(cell.model, q, x)) for x in (-h * v, h * v))
        chain.linearise(q, about=R.translation)
        twists = chain.twists(v)
        point = pin.SE3(np.eye(3), R.translation)
        close((chain.dense() @ v).reshape(-1, 6), twists, 1e-13)
        for k in range(chain.n_arms):
            displacement = ahead[k] * back[k].inverse()  # spatial
            at_point = point.inverse() * displacement * point
            close(pin.log6(at_point).vector / (2 * h), twists[k], 3e-9)
            seen = R.inverse() * displacement * R  # the same, in the reference frame
            close(pin.log6(seen).vector / (2 * h), turned(R).T @ twists[k], 3e-9)


def test_dense_is_the_arms_jacobians(setting: tuple[Chain, Array]) -> None:
    chain, q = setting
    chain.linearise(q, ABOUT)
    J, state = chain.dense(), CellState(chain.cell, q)
    assert J.shape == (6 * chain.n_arms, chain.nv)
    for k, s in enumerate(chain.cell.v_slices):
        block = J[6 * k : 6 * k + 6]
        close(block[:, s], tool_jacobian(state, k), 1e-14)
        assert not np.delete(block, np.arange(s.start, s.stop), axis=1).any()


def test_compliances_are_those_of_joints_in_series(setting: tuple[Chain, Array], rng: Any) -> None:
    """A wrench w bends joint j by softness_j (Jᵀ w)_j, and the object gives way by J times that."""
    chain, q = setting
    chain.linearise(q, ABOUT)
    softness, state = rng.uniform(0.1, 2.0, chain.nv), CellState(chain.cell, q)
    for k, arm in enumerate(chain.cell.v_slices):
        J, wrench = tool_jacobian(state, k), rng.normal(size=6)
        close(chain.compliances(softness)[k] @ wrench, J @ (softness[arm] * (J.T @ wrench)), 1e-12)


@pytest.mark.parametrize("torso", [(("prismatic", "0 0 1"),), (("prismatic", "1 0 0"), ("revolute", "0 1 0"))])
def test_compliances_of_shared_joints_are_those_of_the_whole_chain(torso: Any, tmp_path: Path, rng: Any) -> None:
    """Wrenches on all arms bend each joint by softness (Jᵀ w), with J of all tools: once for what arms share."""
    cell = RobotCell([robot_of(torso, tmp_path)])
    x = rng.uniform(-1.0, 1.0, cell.nv)
    q = cell.configuration(x)
    chain, softness = Chain(cell, grasp_at(cell, q)), rng.uniform(0.1, 2.0, cell.nv)
    chain.evaluate(q, ABOUT)
    J, h = np.empty((12, cell.nv)), 1e-6
    for j in range(cell.nv):
        step = h * (np.arange(cell.nv) == j)
        ends = [chain.carried(cell.configuration(x + side * step)) for side in (-1.0, 1.0)]
        for k, (before, after) in enumerate(zip(*ends, strict=True)):
            turn = pin.log3(after.rotation @ before.rotation.T) / (2.0 * h)
            middle = 0.5 * (before.translation + after.translation)
            line = (after.translation - before.translation) / (2.0 * h) + np.cross(turn, ABOUT - middle)
            J[6 * k : 6 * k + 6, j] = [*line, *turn]
    own, shared = chain.compliances(softness), chain.shared_compliance(softness)
    assert shared is not None
    whole = whole_compliance(own, shared)
    close(whole, J @ np.diag(softness) @ J.T, 1e-6)
    R = for_twists(pin.exp3(rng.normal(size=3)))
    turned = chain.shared_compliance(softness, R)
    close(turned, np.kron(np.eye(2), R).T @ shared @ np.kron(np.eye(2), R), 1e-12)
    # Wrenches that cancel leave a joint that all arms share alone.
    squeeze = rng.normal(size=6)
    close(shared @ np.concatenate([squeeze, -squeeze]), np.zeros(12), 1e-12)


def scale_of(chain: Chain, k: int) -> Array:
    """The unit of each joint of an arm: its speed limit."""
    speed = chain.cell.limits.velocity[chain.cell.v_slices[k]]
    return np.where(np.isfinite(speed), speed, 1.0)


def test_joint_velocities_are_a_right_inverse(setting: tuple[Chain, Array], rng: Any) -> None:
    """J v = W for six and seven joints; for fewer joints, the part of W that the arm can do."""
    chain, q = setting
    chain.linearise(q, ABOUT)
    assert not chain.singular
    state = CellState(chain.cell, q)
    for _ in range(10):
        W = rng.uniform(-1, 1, (chain.n_arms, 6))
        v = chain.joint_velocities(W)
        made = chain.twists(v)
        for k, s in enumerate(chain.cell.v_slices):
            J = tool_jacobian(state, k)
            if k in chain.deficient:
                close(made[k], J @ np.linalg.lstsq(J, W[k], rcond=None)[0], 1e-11)
                continue
            close(made[k], W[k], 1e-11)
            # The least Σ (v_j / speed_j)² of all joint velocities with this twist.
            D = np.diag(scale_of(chain, k))
            expected = D @ np.linalg.lstsq(J @ D, W[k], rcond=None)[0]
            close(v[s], expected, 1e-10)


def test_columns_are_velocities_of_common_twists(setting: tuple[Chain, Array], rng: Any) -> None:
    chain, q = setting
    chain.linearise(q, ABOUT)
    T = rng.uniform(-1, 1, (6, 4))
    columns = chain.joint_columns(T)
    assert columns.shape == (chain.nv, 4)
    for c in range(4):
        alone = chain.joint_velocities(np.tile(T[:, c], (chain.n_arms, 1)))
        close(columns[:, c], alone, 1e-12)


def with_fingers(robot: str, tool: str, folder: Path) -> Path:
    """The robot with two prismatic fingers beyond its tool frame."""
    finger = (
        '<link name="finger_{0}"/>'
        '<joint name="slide_{0}" type="prismatic"><parent link="{1}"/><child link="finger_{0}"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>'
    )
    file = folder / f"{robot}.urdf"
    text = robot_path(robot).read_text()
    file.write_text(text.replace("</robot>", finger.format(1, tool) + finger.format(2, tool) + "</robot>"))
    return file


def test_fingers_carry_nothing(tmp_path: Path, rng: Any) -> None:
    """Joints beyond the tool do not move the object and get no velocities."""
    file = with_fingers("rx90l", "flange", tmp_path)
    whole = RobotCell([Arm.from_urdf("a", file, tool_frame="flange", geometry=False)])
    lock = {"slide_1": 0.0, "slide_2": 0.0}
    plain = RobotCell([Arm.from_urdf("a", file, tool_frame="flange", geometry=False, locked_joints=lock)])
    assert (whole.nv, plain.nv) == (8, 6)
    chain, reference = Chain(whole, Grasp((np.eye(4),))), Chain(plain, Grasp((np.eye(4),)))
    q = np.array([0.2, 0.5, 0.8, 0.3, 0.6, 0.1])
    chain.linearise(np.concatenate([q, [0.05, 0.02]]), ABOUT)
    reference.linearise(q, ABOUT)
    W = rng.normal(size=(1, 6))
    v = chain.joint_velocities(W)
    close(v[:6], reference.joint_velocities(W), 1e-11)
    close(v[6:], np.zeros(2), 1e-12)
    close(chain.dense()[:, :6], reference.dense(), 1e-15)
    assert not chain.dense()[:, 6:].any()
    assert chain.redundancy == 0


# -- singularities ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "angles"),
    [
        ("rx90l", [0.1, 0.5, 0.7, 0.3, 0.0, 0.2]),  # wrist
        ("rx90l", [0.1, 0.5, 0.0, 0.3, 0.4, 0.2]),  # elbow stretched
        ("rx90l", [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),  # both, and the shoulder
        ("arm7", [0.0] * 7),
        ("gantry7", [0.0] * 7),
        ("arm6c", [0.0] * 6),
        ("scara4", [0.2, 0.0, 0.0, 0.1]),
        ("arm5", [0.0] * 5),
    ],
)
def test_at_a_singularity_the_inverse_stays_finite(make_cell: Any, robot: str, angles: list[float], rng: Any) -> None:
    cell = make_cell([robot])
    chain = Chain(cell, Grasp((np.eye(4),)))
    chain.linearise(cell.configuration(angles), ABOUT)
    assert chain.singular
    J = chain.dense()
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    weak = s < 1e-7
    assert weak.any()
    W = rng.uniform(-1, 1, (1, 6))
    v = chain.joint_velocities(W)
    assert np.isfinite(v).all()
    assert np.abs(v).max() <= 20.0 * np.abs(W).max() / SINGULAR_FLOOR
    # The arm does the possible part.
    possible = U[:, ~weak] @ (U[:, ~weak].T @ W[0])
    close(J @ chain.joint_velocities(possible[None]), possible, 1e-6)
    chain.linearise(cell.configuration(0.4 + np.array(angles)), ABOUT)  # must have no effect on the next call
    assert not chain.singular


@given(st.floats(-12.0, -0.5))
def test_towards_a_singularity_nothing_jumps(paper: Scenario, exponent: float) -> None:
    """At the transition from the plain to the floored inverse, both give the same velocities.

    A chain is near a singularity when a unit twist may ask 1e4 of a joint.
    """
    q = paper.q_start.copy()
    q[4] = 10.0**exponent
    chain = Chain(paper.cell, paper.grasp)
    chain.linearise(q, ABOUT)
    J = chain.dense()[:6, :6]
    W = np.tile([0.1, 0.2, 0.3, 0.1, -0.2, 0.3], (3, 1))
    v = chain.joint_velocities(W)[:6]
    s = np.linalg.svd(J, compute_uv=False)
    largest = float(np.abs(np.linalg.pinv(J, rcond=0.0)).max())
    assert chain.singular == (largest >= 1e4) or abs(largest - 1e4) < 1.0
    if s[-1] > 2.0 * SINGULAR_FLOOR:
        close(v, np.linalg.solve(J, W[0]), 1e-13 / s[-1] ** 2)
    assert np.abs(v).max() <= 1.0 / max(s[-1], SINGULAR_FLOOR)


# -- invariances -----------------------------------------------------------------------------------------------------


def commands(cell: RobotCell, grasp: Grasp, q: Array, R: pin.SE3, V: Array) -> Array:
    """Joint velocities that move the object with the twist V, expressed in the object frame R."""
    chain = Chain(cell, grasp)
    chain.linearise(q, about=R.translation)
    return chain.joint_velocities(np.tile(turned(R) @ V, (len(cell), 1)))


@FEW
@given(st.permutations(range(4)), st.integers(0, 1000))
def test_the_order_of_the_arms_does_not_matter(make_cell: Any, order: list[int], seed: int) -> None:
    pin.seed(12)
    rng = np.random.default_rng(seed)
    robots, bases = ["rx90l", "arm7", "rx90l", "arm6c"], [pin.SE3.Random() for _ in range(4)]
    cell = make_cell(robots, bases)
    shuffled = make_cell([robots[i] for i in order], [bases[i] for i in order])
    x, V, R = rng.uniform(0.3, 0.9, cell.nv), rng.normal(size=6), pin.SE3.Random()
    grasp = Grasp.from_configuration(cell, cell.configuration(x), R)
    y = np.concatenate([x[cell.v_slices[i]] for i in order])
    same = Grasp(tuple(grasp.T_object_tool[i] for i in order))
    v = commands(cell, grasp, cell.configuration(x), R, V)
    u = commands(shuffled, same, shuffled.configuration(y), R, V)
    expected = np.concatenate([v[cell.v_slices[i]] for i in order])
    close(u, expected, 1e-10 * max(1.0, np.abs(v).max()))


@FEW
@given(
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-10.0, 10.0)] * 3),
)
def test_the_world_frame_does_not_matter(make_cell: Any, turn: list[float], shift: list[float]) -> None:
    pin.seed(13)
    robots, bases = ["rx90l", "arm7", "scara4"], [pin.SE3.Random() for _ in range(3)]
    G = pin.SE3(pin.exp3(np.array(turn)), np.array(shift))
    cell, moved = make_cell(robots, bases), make_cell(robots, [G * T for T in bases])
    q = cell.configuration(np.linspace(0.3, 0.9, cell.nv))
    R, V = pin.SE3.Random(), np.array([0.1, -0.2, 0.3, 0.2, 0.1, -0.4])
    grasp = Grasp.from_configuration(cell, q, R)
    close(commands(cell, grasp, q, R, V)[:13], commands(moved, grasp, q, G * R, V)[:13], 1e-9)
    close(CellState(cell, q).sigma_min, CellState(moved, q).sigma_min, 1e-12)


def test_one_hundred_metres_from_the_origin(make_cell: Any) -> None:
    pin.seed(14)
    bases, G = [pin.SE3.Random()] * 2, pin.SE3(pin.exp3(np.array([0.3, 0.2, 1.0])), np.array([80.0, -60.0, 1.0]))
    near, far = make_cell(["rx90l", "arm7"], bases), make_cell(["rx90l", "arm7"], [G * T for T in bases])
    q, R, V = np.linspace(0.3, 0.9, 13), pin.SE3.Random(), np.full(6, 0.2)
    grasp = Grasp.from_configuration(near, q, R)
    close(commands(near, grasp, q, R, V), commands(far, grasp, q, G * R, V), 1e-10)


# -- arms that follow their joints' own way ----------------------------------------------------------------------------


def test_tools_that_move_on_the_object_and_shift_are_both_counted(make_cell: Any, random_q: RandomQ, rng: Any) -> None:
    """Each arm holds the object at exp(d) M X, whichever of M and d was told last."""
    pin.seed(4)
    cell = make_cell(["rx90l", "arm7"])
    grasp = Grasp((pin.SE3.Random(), pin.SE3.Random()))
    q, chain = random_q(cell, rng), Chain(cell, grasp)
    moved, shift = [pin.SE3.Random(), pin.SE3.Random()], 0.1 * rng.normal(size=(2, 6))
    both = [pin.exp6(d) * M * X for d, M, X in zip(shift, moved, grasp.T_object_tool, strict=True)]
    expected = Grasp(tuple(both)).carried(CellState(cell, q))
    other = Chain(cell, grasp)
    chain.shift_grasp(shift)
    chain.place(moved)
    other.place(moved)
    other.shift_grasp(shift)
    for O, P, T in zip(chain.carried(q), other.carried(q), expected, strict=True):
        close(O.homogeneous, T.homogeneous, 1e-12)
        close(P.homogeneous, T.homogeneous, 1e-12)


def test_redundant_arms_move_no_more_than_they_need(make_cell: Any, random_q: RandomQ, rng: Any) -> None:
    cell = make_cell(["arm7", "gantry7"])
    chain = Chain(cell, Grasp((np.eye(4), np.eye(4))))
    assert chain.redundancy == 2
    chain.linearise(random_q(cell, rng), ABOUT)
    scale = np.concatenate([scale_of(chain, k) for k in range(2)])
    v = chain.joint_velocities(rng.uniform(-1, 1, (2, 6)))
    cost = np.sum((v / scale) ** 2)
    for _ in range(50):
        spare = chain.null_part(rng.normal(size=cell.nv))
        assert np.sum(((v + spare) / scale) ** 2) > cost
        assert abs(spare @ (v / scale**2)) < 1e-12


@pytest.mark.parametrize("apart", [(0,), (1,), (3,), (0, 2), (1, 2, 3)])
def test_an_arm_apart_moves_no_object_and_the_others_as_without_it(
    apart: tuple[int, ...], make_cell: Any, random_q: RandomQ, rng: Any
) -> None:
    """Its view of the object is that of the first arm that is not apart; all its motion is its own."""
    pin.seed(2)
    robots = ["arm7", "rx90l", "gantry7", "arm5"]
    cell = make_cell(robots, [pin.SE3.Random() for _ in robots])
    q = next(q for q in (random_q(cell, rng) for _ in range(1000)) if CellState(cell, q).sigma_min.min() > 0.05)
    grasp = Grasp(tuple(pin.SE3.Random() for _ in robots))
    whole, chain = Chain(cell, grasp), Chain(cell, grasp)
    chain.apart = apart
    whole.linearise(q, ABOUT)
    chain.linearise(q, ABOUT)
    first = next(k for k in range(4) if k not in apart)
    seen = whole.carried(q)
    for k, O in enumerate(chain.carried(q)):
        assert seen[first if k in apart else k] == O
    W, v = rng.normal(size=(4, 6)), rng.normal(size=cell.nv)
    moved, expected = chain.joint_velocities(W), whole.joint_velocities(W)
    part, null = chain.null_part(v), whole.null_part(v)
    twists = chain.twists(v)
    for k, s in enumerate(cell.v_slices):
        if k in apart:
            assert not chain.jacobians[k].any()
            assert not moved[s].any()
            assert not twists[k].any()
            close(part[s], v[s], 0.0)
        else:
            close(moved[s], expected[s], 1e-13)
            close(twists[k], whole.twists(v)[k], 1e-13)
            close(part[s], null[s], 1e-13)
    assert chain.redundancy == whole.redundancy == 2, "what an arm has to spare does not depend on it"
    assert chain.deficient == (() if 3 in apart else (3,))
    assert not chain.singular


def test_units_are_the_speeds_of_arms_whose_inverse_depends_on_them(make_cell: Any) -> None:
    cell = make_cell(["arm7", "rx90l", "arm5"])
    velocity = np.linspace(0.5, 2.0, cell.nv)
    velocity[2] = np.inf
    chain = Chain(cell.with_limits(velocity=velocity), Grasp((np.eye(4),) * 3))
    expected = np.where(np.isfinite(velocity), velocity, 1.0)
    expected[cell.v_slices[1]] = 1.0
    close(chain.scale, expected, 0.0)
