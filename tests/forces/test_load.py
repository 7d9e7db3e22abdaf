"""Load sharing: the closed form, rigid-body dynamics, friction, limits, and the engine say the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import box_of
from scipy.optimize import linprog, minimize

from coopqp import Grasp, InvalidInputError, LimitKind, RobotCell, simulate
from coopqp.errors import UnknownNameError, UnreachableError
from coopqp.forces import Grip, LoadShare, load_use
from coopqp.model import CellState
from coopqp.planning import Payload
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import PhysicsOptions, PhysicsPlant, Replay, exact_motion
from coopqp.spatial import Array

ROBOTS = ("rx90l", "arm6c", "arm7", "gantry7")
LENGTH = 0.3


@dataclass(frozen=True)
class Case:
    """A random cell that holds a random object in motion."""

    cell: RobotCell
    grasp: Grasp
    payload: Payload
    q: Array
    twist: Array
    acceleration: Array


@pytest.fixture(scope="session")
def random_case(make_cell: Callable[..., RobotCell], random_q: Callable[..., Array]) -> Callable[..., Case]:
    def draw(rng: np.random.Generator) -> Case:
        names = rng.choice(ROBOTS, int(rng.integers(2, 7)))
        bases = [pin.SE3(pin.exp3(rng.uniform(-3, 3, 3)), rng.uniform(-2, 2, 3)) for _ in names]
        cell = make_cell(names, bases, velocity=rng.uniform(1.0, 3.0))
        while CellState(cell, q := random_q(cell, rng)).sigma_min.min() < 0.03:
            pass
        T_object = pin.SE3(pin.exp3(rng.uniform(-3, 3, 3)), rng.uniform(-1, 1, 3))
        grasp = Grasp(tuple(T_object.actInv(T) for T in CellState(cell, q).T_world_tool))
        half = rng.standard_normal((3, 3))
        payload = Payload(
            mass=rng.uniform(1, 80), centre=rng.uniform(-0.5, 0.5, 3), inertia=half @ half.T, torque=np.inf
        )
        return Case(cell, grasp, payload, q, rng.uniform(-1, 1, 6), rng.uniform(-5, 5, 6))

    return draw


def newton_euler(case: Case, R: Array) -> Array:
    """Force, and moment about the origin, on the object in its own axes: cross products, no spatial algebra."""
    v, w, dv, dw = case.twist[:3], case.twist[3:], case.acceleration[:3], case.acceleration[3:]
    c, J, m = np.asarray(case.payload.centre), np.asarray(case.payload.inertia), case.payload.mass
    origin = dv + np.cross(w, v)  # the derivative of a twist in moving axes leaves this out
    force = m * (origin + np.cross(dw, c) + np.cross(w, np.cross(w, c)) - R.T @ [0.0, 0.0, -9.81])
    return np.concatenate([force, J @ dw + np.cross(w, J @ w) + np.cross(c, force)])


def closed_form(case: Case, f: Array) -> Array:
    """Wrenches (N, 6) in the object frame: the weighted pseudo-inverse W⁻¹Gᵀ(G W⁻¹Gᵀ)⁻¹ f of the grasp map."""
    maps = []
    for X in case.grasp.T_object_tool:
        r, R = X.translation, X.rotation
        lever = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
        maps.append(np.block([[R, np.zeros((3, 3))], [lever @ R, R]]))
    G = np.hstack(maps)
    W = np.tile([1.0, 1.0, 1.0, LENGTH**-2, LENGTH**-2, LENGTH**-2], len(maps))  # of ½ Σ |f|² + |m / length|²
    c = (G / W).T @ np.linalg.solve((G / W) @ G.T, f)
    return np.array([A @ part for A, part in zip(maps, c.reshape(-1, 6), strict=True)])


def torques(case: Case, wrenches: Array, v: Array, dv: Array) -> Array:
    """Inverse dynamics with the reactions −w as external forces on the joints that carry the tools."""
    forces = [pin.Force.Zero() for _ in range(case.cell.model.njoints)]
    carriers = zip(case.cell.tool_joints, case.cell.T_joint_tool, case.grasp.T_object_tool, wrenches, strict=True)
    for joint, T, X, w in carriers:
        forces[joint] = (T * X.inverse()).act(pin.Force(-w))
    return np.asarray(pin.rnea(case.cell.model, case.cell.model.createData(), case.q, v, dv, forces))


def assert_closed_form(case: Case) -> None:
    load = LoadShare(case.cell, case.grasp, case.payload, internal_force=1e9, length=LENGTH)
    shared = load.share(case.q, twist=case.twist, acceleration=case.acceleration)
    O = case.grasp.carried(CellState(case.cell, case.q))[0]
    f = newton_euler(case, O.rotation)
    scale = np.linalg.norm(f)
    np.testing.assert_allclose(shared.wrenches.sum(axis=0), f, rtol=0, atol=1e-10 * scale)
    np.testing.assert_allclose(shared.wrenches, closed_form(case, f), rtol=0, atol=1e-10 * scale)
    v, dv = load.joint_motion(case.q, twist=case.twist, acceleration=case.acceleration)
    expected = torques(case, shared.wrenches, v, dv)
    np.testing.assert_allclose(shared.torques, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    assert shared.feasible
    np.testing.assert_allclose(shared.internal, 0.0, atol=1e-10 * scale)


def test_without_limits_the_shares_are_the_closed_form_and_torques_those_of_inverse_dynamics(
    random_case: Callable[..., Case], rng: np.random.Generator
) -> None:
    for _ in range(15):
        assert_closed_form(random_case(rng))


@pytest.mark.slow
def test_of_a_thousand_random_cells(random_case: Callable[..., Case], rng: np.random.Generator) -> None:
    for _ in range(1000):
        assert_closed_form(random_case(rng))


def test_the_joints_move_as_the_object_is_asked_to(random_case: Callable[..., Case], rng: np.random.Generator) -> None:
    """Positions from a twist that changes, differentiated twice, are the joint motion."""
    for _ in range(10):
        case, h = random_case(rng), 1e-4
        load = LoadShare(case.cell, case.grasp, case.payload, internal_force=1e9)
        v, dv = load.joint_motion(case.q, twist=case.twist, acceleration=case.acceleration)
        V, a = load.object_motion(case.q, v, dv)
        np.testing.assert_allclose(V, case.twist, atol=1e-9)
        np.testing.assert_allclose(a, case.acceleration, atol=1e-9)
        twists = []
        for t in (-h, h):  # by the last arm, which was not asked
            q = pin.integrate(case.cell.model, case.q, t * v + 0.5 * t * t * dv)
            J, k = CellState(case.cell, q).jacobian(len(case.cell) - 1), case.cell.v_slices[-1]
            twists.append(case.grasp.T_object_tool[-1].action @ J @ (v + t * dv)[k])
        scale = 1.0 + np.abs(dv).max() ** 2
        np.testing.assert_allclose((twists[1] - twists[0]) / (2 * h), a, atol=1e-5 * scale)


def test_an_internal_target_is_met_without_a_trace_in_the_motion(
    random_case: Callable[..., Case], rng: np.random.Generator
) -> None:
    for _ in range(10):
        case = random_case(rng)
        load = LoadShare(case.cell, case.grasp, case.payload, internal_force=1e9)
        free = load.share(case.q)
        wanted = rng.standard_normal((len(case.cell), 6)) * 20.0
        shared = load.share(case.q, internal=wanted)
        scale = np.abs(free.wrenches).max() + np.abs(wanted).max()
        np.testing.assert_allclose(shared.internal.sum(axis=0), 0.0, atol=1e-10 * scale)
        np.testing.assert_allclose(shared.wrenches - shared.internal, free.wrenches, atol=1e-9 * scale)
        again = load.share(case.q, internal=shared.internal)  # what is internal already stays
        np.testing.assert_allclose(again.internal, shared.internal, atol=1e-9 * scale)


@pytest.mark.slow
def test_limits_are_kept_and_the_largest_share_is_that_of_a_linear_program(
    random_case: Callable[..., Case], rng: np.random.Generator
) -> None:
    """Torque and wrist limits are linear: a linear program in the wrenches themselves, without null space, decides."""
    infeasible = 0
    for _ in range(25):
        case = random_case(rng)
        n = len(case.cell)
        alone = np.abs(torques(case, np.zeros((n, 6)), np.zeros(case.cell.nv), np.zeros(case.cell.nv)))
        limits = alone + rng.uniform(20.0, 300.0, case.cell.nv)
        wrist = rng.uniform(50.0, 400.0, 6)
        payload = Payload(mass=case.payload.mass, centre=case.payload.centre, torque=limits)
        load = LoadShare(case.cell, case.grasp, payload, internal_force=1e6, grips=[Grip(wrench=wrist)] * n)
        shared = load.share(case.q)
        assert (np.abs(shared.torques) <= limits * (1 + 1e-7) + 1e-7).all()
        f = load.wrench(case.grasp.carried(CellState(case.cell, case.q))[0].rotation)
        np.testing.assert_allclose(shared.wrenches.sum(axis=0), shared.share * f, atol=1e-7 * np.linalg.norm(f))
        state = CellState(case.cell, case.q)
        G = np.hstack([np.linalg.inv(X.action).T for X in case.grasp.T_object_tool])
        Jt = np.zeros((case.cell.nv, 6 * n))
        for k, s in enumerate(case.cell.v_slices):
            Jt[s, 6 * k : 6 * k + 6] = state.jacobian(k).T
        own = torques(case, np.zeros((n, 6)), np.zeros(case.cell.nv), np.zeros(case.cell.nv))
        found = linprog(
            np.append(np.zeros(6 * n), -1.0),
            A_ub=np.column_stack([np.vstack([Jt, -Jt]), np.zeros(2 * len(own))]),
            b_ub=np.r_[limits - own, limits + own],
            A_eq=np.column_stack([G, -f]), b_eq=np.zeros(6),
            bounds=[(-x, x) for x in np.tile(wrist, n)] + [(0.0, 1.0)],
        )  # fmt: skip
        assert found.status == 0
        assert shared.share == pytest.approx(-found.fun, abs=2e-6)
        if not shared.feasible:
            infeasible += 1
            assert shared.binding
            assert {b.kind for b in shared.binding} <= {LimitKind.TORQUE, LimitKind.WRIST}
            assert "carry" in shared.explain()
            assert str(shared.binding[0]) in shared.explain()
    assert 3 < infeasible < 25


def palms(**more: Any) -> list[Grip]:
    return [Grip(kind="palm", friction=0.6, **more)] * 3


def test_points_with_friction_squeeze_as_much_as_coulomb_asks(paper: Scenario) -> None:
    """The master carries half of 20 kg by friction alone: 98.1 N / 0.6. No less holds it, and nothing asks for more."""
    load = LoadShare(paper.cell, paper.grasp, box_of(paper, 20.0), internal_force=1e3, grips=palms())
    shared = load.share(paper.q_start)
    assert shared.feasible
    w = shared.wrenches
    assert w[0, 1] == pytest.approx(0.5 * 20.0 * 9.81 / 0.6, rel=1e-6)
    np.testing.assert_allclose(w[1:, 1], -0.5 * w[0, 1], rtol=1e-6)
    assert shared.grip_use == pytest.approx(1.0, abs=1e-6)
    assert {b.kind for b in shared.binding} == {LimitKind.FRICTION}
    less = LoadShare(paper.cell, paper.grasp, box_of(paper, 20.0), internal_force=0.9 * w[0, 1], grips=palms())
    lost = less.share(paper.q_start)
    assert lost.share == pytest.approx(0.9, abs=1e-5)
    assert {b.kind for b in lost.binding} >= {LimitKind.FRICTION, LimitKind.INTERNAL_FORCE}


def test_forces_under_cones_are_those_of_a_general_optimiser(paper: Scenario, rng: np.random.Generator) -> None:
    """SLSQP on the cones themselves, with the wrenches as unknowns, finds no smaller ones."""
    grips = [Grip(kind="palm", friction=0.5, radius=0.08, squeeze=120.0), Grip(force=90.0), Grip(kind="torque-free")]
    load = LoadShare(paper.cell, paper.grasp, box_of(paper, 20.0, torque=np.inf), internal_force=200.0, grips=grips)
    for _ in range(3):
        a = rng.uniform(-2.0, 2.0, 6)
        shared = load.share(paper.q_start, acceleration=a)
        assert shared.feasible
        f = load.wrench(paper.path.pose(0.0).rotation, acceleration=a) / 100.0  # the oracle's units: 100 N
        G = np.hstack([X.actionInverse.T for X in paper.grasp.T_object_tool])[:, :15]
        scale = np.r_[np.tile([1, 1, 1, LENGTH, LENGTH, LENGTH], 2), 1, 1, 1]
        moving = np.linalg.pinv(G * scale) @ f

        def inner(x: Array, moving: Array = moving, scale: Array = scale) -> list[float]:
            d = scale * (x - moving)
            caps = [2.0**2 - d[i : i + 3] @ d[i : i + 3] for i in (0, 6, 12)]
            return [*caps, *(0.6**2 - d[i : i + 3] @ d[i : i + 3] for i in (3, 9))]

        def palm(x: Array, scale: Array = scale) -> list[float]:
            fx, fy, fn, mx, my, mn = (scale * x)[:6]
            slip = fx * fx + fy * fy + (mn / (2 / 3 * 0.08)) ** 2
            return [(0.5 * fn) ** 2 - slip, (0.08 * fn) ** 2 - mx * mx - my * my, fn - 1.2]

        rules: list[Any] = [
            {"type": "eq", "fun": lambda x, G=G, scale=scale, f=f: G @ (scale * x) - f},
            {"type": "ineq", "fun": inner},
            {"type": "ineq", "fun": palm},
            {"type": "ineq", "fun": lambda x: 0.9**2 - x[6:9] @ x[6:9]},
        ]
        x0 = moving.copy()
        x0[2] = 1.5
        best = minimize(lambda x: 0.5 * x @ x, x0, jac=lambda x: x, constraints=rules, method="SLSQP",
                        options={"ftol": 1e-11, "maxiter": 500})  # fmt: skip
        assert best.success, best.message
        c = 100.0 * scale * best.x
        expected = [X.actionInverse.T[:, : len(part)] @ part
                    for X, part in zip(paper.grasp.T_object_tool, (c[:6], c[6:12], c[12:]), strict=True)]  # fmt: skip
        np.testing.assert_allclose(shared.wrenches, expected, atol=2e-3)


def test_a_torque_free_grip_exerts_none(paper: Scenario) -> None:
    grips = [Grip(), Grip(kind="torque-free"), Grip(kind="torque-free")]
    load = LoadShare(paper.cell, paper.grasp, box_of(paper, 20.0), internal_force=50.0, grips=grips)
    shared = load.share(paper.q_start, acceleration=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    for X, w in zip(paper.grasp.T_object_tool[1:], shared.wrenches[1:], strict=True):
        np.testing.assert_allclose((X.action.T @ w)[3:], 0.0, atol=1e-9)
    pair = RobotCell(paper.cell.arms[:2])
    held = Grasp(paper.grasp.T_object_tool[:2])
    points = LoadShare(pair, held, box_of(paper, 20.0), internal_force=50.0, grips=[Grip(kind="torque-free")] * 2)
    with pytest.raises(UnreachableError, match="cannot transmit the wrench"):
        points.share(paper.q_start[:12], acceleration=[0, 0, 0, 1, 1, 1])


def test_weights_move_the_load_and_nothing_else(paper: Scenario) -> None:
    even, uneven = (
        LoadShare(paper.cell, paper.grasp, box_of(paper, 20.0), internal_force=1e6, weights=w).share(paper.q_start)
        for w in (None, [1.0, 100.0, 1.0])
    )
    assert uneven.wrenches[1, 2] > even.wrenches[1, 2] + 20.0
    np.testing.assert_allclose(uneven.wrenches.sum(axis=0), even.wrenches.sum(axis=0), atol=1e-9)


def test_the_load_is_linear_in_mass_and_does_not_depend_on_where_the_cell_stands(paper: Scenario) -> None:
    turn = pin.SE3(pin.utils.rotate("z", 0.7), np.array([5.0, -3.0, 0.0]))  # about gravity
    moved = RobotCell([arm.placed(turn * arm.T_world_base) for arm in paper.cell.arms])
    one, two, elsewhere = (
        LoadShare(cell, paper.grasp, box_of(paper, mass), internal_force=50.0).share(
            paper.q_start, twist=[0, 0, 0.1, 0, 0, 1]
        )
        for cell, mass in ((paper.cell, 10.0), (paper.cell, 20.0), (moved, 10.0))
    )
    np.testing.assert_allclose(two.wrenches, 2.0 * one.wrenches, atol=1e-9)
    np.testing.assert_allclose(elsewhere.wrenches, one.wrenches, atol=1e-9)
    np.testing.assert_allclose(elsewhere.torques, one.torques, atol=1e-9)


# -- the heavy lift ----------------------------------------------------------------------------------------------------


def test_53_kg_are_lifted_within_50_n_of_internal_force_and_not_by_equal_shares() -> None:
    lift = paper_lift(time_law="quintic", duration=6.0)
    time = np.linspace(0.0, 6.0, 31)
    motion = exact_motion(lift.cell, lift.grasp, lift.path, lift.q_start)
    q = np.array([motion(t) for t in time])
    load = LoadShare(lift.cell, lift.grasp, box_of(lift, 53.0), internal_force=50.0)
    use = load_use(load, time, q)
    assert use.feasible
    assert use.joint.max() <= 1.0 + 1e-9
    assert use.internal.max() <= 1.0 + 1e-9
    np.testing.assert_allclose(np.abs(use.torques) / load.torque_limits, use.joint, atol=1e-9)
    whole, still, limits = np.zeros(6), np.zeros(lift.cell.nv), load.torque_limits
    for x, clock in zip(q, time, strict=True):
        whole = load.wrench(lift.path.pose(clock).rotation)
        equal = np.tile(whole / 3.0, (3, 1))  # a third of the force at each grip, and of the moment that this leaves
        levers = [np.cross(X.translation, whole[:3] / 3.0) for X in lift.grasp.T_object_tool]
        equal[:, 3:] = levers + (whole[3:] - np.sum(levers, axis=0)) / 3.0
        case = Case(lift.cell, lift.grasp, load.payload, x, np.zeros(6), np.zeros(6))
        assert (np.abs(torques(case, equal, still, still)) / limits).max() > 1.05
    figures = use.figures()
    assert figures["load carried"] == "100.0 %"
    assert "too heavy from" not in figures


def test_a_load_that_is_too_heavy_is_said_when_and_why() -> None:
    lift = paper_lift(time_law="quintic", duration=6.0)
    time = np.linspace(0.0, 6.0, 4)
    motion = exact_motion(lift.cell, lift.grasp, lift.path, lift.q_start)
    load = LoadShare(lift.cell, lift.grasp, box_of(lift, 90.0), internal_force=50.0)
    use = load_use(load, time, np.array([motion(t) for t in time]))
    assert not use.feasible
    assert "0.00 s on (arm" in use.figures()["too heavy from"]
    assert use.share[0] * 90.0 == pytest.approx(65.1, abs=0.5)


# -- the engine --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_engine_exerts_the_wrenches_that_are_fed_forward() -> None:
    lift = paper_lift(time_law="quintic", duration=1.2)
    load = LoadShare(lift.cell, lift.grasp, box_of(lift, 20.0), internal_force=50.0)
    motion, off = exact_motion(lift.cell, lift.grasp, lift.path, lift.q_start), []
    for shared in (None, load):
        plant, wrenches = PhysicsPlant.of(lift, load=shared), []
        controller = Replay(lift.cell, lift.grasp, lift.path, motion, dt=0.006)
        run = simulate(
            controller, plant, q_start=lift.q_start, observe=lambda _, p=plant, w=wrenches: w.append(p.wrenches())
        )
        wanted = load_use(load, run.time, run.q_command).wrenches
        off.append(np.linalg.norm((np.array(wrenches) - wanted[1:])[:, :, :3], axis=2).max())
    assert off[1] < 5.0  # N
    assert off[0] > 4.0 * off[1]


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "error", "said"),
    [
        ({"kind": "glued"}, UnknownNameError, "kind of grip"),
        ({"kind": "palm"}, InvalidInputError, "friction"),
        ({"friction": 0.6}, InvalidInputError, "belong to"),
        ({"kind": "palm", "friction": -1.0}, InvalidInputError, "friction"),
        ({"kind": "palm", "friction": 0.6, "normal": (0, 0, 0)}, InvalidInputError, "normal"),
        ({"kind": "palm", "friction": 0.6, "squeeze": -5.0}, InvalidInputError, "squeeze"),
        ({"force": 0.0}, InvalidInputError, "force"),
        ({"wrench": [1, 2, 3]}, InvalidInputError, "six"),
        ({"wrench": "much"}, InvalidInputError, "six"),
    ],
)
def test_bad_grips(settings: dict[str, Any], error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        Grip(**settings)


def test_bad_settings_of_load_sharing(paper: Scenario) -> None:
    args: Any = (paper.cell, paper.grasp, box_of(paper, 20.0))
    with pytest.raises(TypeError, match="internal_force"):
        LoadShare(*args)  # the cap is mandatory
    for settings, said in (
        ({"internal_force": 0.0}, "internal_force"),
        ({"internal_force": 1.0, "grips": [Grip()]}, "one per arm"),
        ({"internal_force": 1.0, "grips": [1, 2, 3]}, "grips"),
        ({"internal_force": 1.0, "weights": [1, 1]}, "weights"),
        ({"internal_force": 1.0, "weights": [1, 1, 0]}, "weights"),
    ):
        with pytest.raises(InvalidInputError, match=said):
            LoadShare(*args, **settings)
    load = LoadShare(*args, internal_force=50.0)
    with pytest.raises(InvalidInputError, match="Give both"):
        load.share(paper.q_start, joint_velocity=np.zeros(18))
    with pytest.raises(InvalidInputError, match="twist"):
        load.share(paper.q_start, twist=[1, 2])
    with pytest.raises(InvalidInputError, match="three samples"):
        load_use(load, [0.0, 1.0], [paper.q_start] * 2)
    weak = LoadShare(*args[:2], box_of(paper, 20.0, torque=5.0), internal_force=50.0)
    with pytest.raises(UnreachableError, match="for the arm alone"):
        weak.share(paper.q_start)
    tight = LoadShare(*args, internal_force=50.0, grips=palms(squeeze=500.0))
    with pytest.raises(UnreachableError, match="least squeeze"):
        tight.share(paper.q_start)
    with pytest.raises(InvalidInputError, match="gravity"):
        PhysicsPlant.of(paper, load=load, options=PhysicsOptions(gravity=(0, 0, -1.6)))


@pytest.mark.parametrize("mass", [200.0, 1e3, 1e4, 1e5])
def test_a_load_that_is_far_too_heavy_names_what_binds(make_cell: Callable[..., RobotCell], mass: float) -> None:
    cell = make_cell(["arm7"])
    q = cell.configuration([0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0])
    grasp = Grasp((pin.SE3.Identity(),))
    payload = Payload(mass=mass, inertia=0.01 * mass * np.eye(3), torque=50.0)
    shared = LoadShare(cell, grasp, payload, internal_force=1e9).share(q)
    assert not shared.feasible
    assert shared.binding
    assert shared.binding[0].kind is LimitKind.TORQUE
