"""Internal stress: it agrees with an independent minimum of elastic energy and with statics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at

import coopqp.forces.internal
from coopqp import Grasp, InvalidInputError, RobotCell
from coopqp.forces import StressModel, at_tools
from coopqp.model import CellState
from coopqp.scenarios import Scenario
from coopqp.spatial import Array

#: Cells of arms with 6, 7, and fewer joints.
ROBOTS = [("rx90l", "rx90l", "rx90l"), ("arm7", "rx90l"), ("arm7", "arm6c", "gantry7"), ("rx90l", "arm5", "scara4")]


def least_energy(model: StressModel, q: Array, R: pin.SE3) -> Array:
    """Wrenches (N, 6) at the least ½ Σ δqᵀ Kp δq of all deflections with which the arms meet at one pose.

    The unknowns are y = Kp^½ δq and the pose o. The multipliers of e_k + A_k δq_k = o are the wrenches.
    """
    cell, state = model.cell, CellState(model.cell, q)
    n, nv = len(cell), cell.nv
    e = np.array([pin.log6(R.actInv(o)).vector for o in model.grasp.carried(state)])
    A, root = np.zeros((6 * n, nv + 6)), np.sqrt(model.stiffness.mean())  # scales all entries to one magnitude
    for k, s in enumerate(cell.v_slices):
        columns = R.actInv(state.T_world_tool[k]).action @ state.jacobian(k)
        A[6 * k : 6 * k + 6, s] = columns * root / np.sqrt(model.stiffness[s])
        A[6 * k : 6 * k + 6, nv:] = -np.eye(6)
    H = np.diag(np.concatenate([np.ones(nv), np.zeros(6)]))
    kkt = np.block([[H, A.T], [A, np.zeros((6 * n, 6 * n))]])
    x = np.linalg.solve(kkt, np.concatenate([np.zeros(nv + 6), -e.ravel() * root]))
    return x[nv + 6 :].reshape(n, 6) * root


@pytest.mark.parametrize("robots", ROBOTS[:3])
def test_the_object_settles_where_the_elastic_energy_is_least(
    robots: tuple[str, ...],
    make_cell: Callable[..., RobotCell],
    random_q: Callable[..., Array],
    rng: np.random.Generator,
) -> None:
    cell = make_cell(robots)
    for _ in range(20):
        q = random_q(cell, rng)
        model = StressModel(cell, grasp_at(cell, q), stiffness=rng.uniform(5e3, 1e5, cell.nv))
        q_command = pin.integrate(cell.model, q, rng.uniform(-1e-3, 1e-3, cell.nv))
        stress = model.estimate(q_command)
        R = model.grasp.carried(CellState(cell, q_command))[0]
        expected = least_energy(model, q_command, R)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(stress.wrenches, expected, atol=1e-6 * scale)
        np.testing.assert_allclose(stress.wrenches.sum(axis=0), 0.0, atol=1e-8 * scale)
        assert stress.largest == pytest.approx(np.linalg.norm(stress.wrenches[:, :3], axis=1).max())


def test_a_command_that_fits_the_grasp_presses_nothing(paper: Scenario) -> None:
    stress = StressModel(paper.cell, paper.grasp, stiffness=1e5).estimate(paper.q_start)
    assert stress.largest < 1e-5
    np.testing.assert_allclose(stress.settled, 0.0, atol=1e-11)


def test_a_rotation_about_a_grasp_is_seen_where_the_paper_s_measure_is_blind(paper: Scenario) -> None:
    """ε_p = 0 for a turn about a tool's origin; the stress is not."""
    state = CellState(paper.cell, paper.q_start)
    twist = np.zeros(6)
    twist[4] = 1e-3
    s = paper.cell.v_slices[1]
    q = paper.q_start.copy()
    q[s] += np.linalg.solve(state.jacobian(1), twist)
    stress = StressModel(paper.cell, paper.grasp, stiffness=[1e5, 1e5, 5e4, 1e4, 1e4, 5e3] * 3).estimate(q)
    assert 5.0 < stress.largest < 50.0  # per mrad


def test_arms_with_few_joints_take_the_least_wrench_that_holds_the_balance(
    make_cell: Callable[..., RobotCell], random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    cell = make_cell(ROBOTS[3])
    q = random_q(cell, rng)
    model = StressModel(cell, grasp_at(cell, q), stiffness=2e4)
    stress = model.estimate(pin.integrate(cell.model, q, rng.uniform(-1e-3, 1e-3, cell.nv)))
    scale = np.abs(stress.wrenches).max()
    assert scale > 1.0
    np.testing.assert_allclose(stress.wrenches.sum(axis=0), 0.0, atol=1e-6 * scale)
    # The deflections due to the wrenches bring every arm to the same pose.
    state = CellState(cell, q)
    R = model.grasp.carried(state)[0]
    for k, s in enumerate(cell.v_slices):
        A = R.actInv(state.T_world_tool[k]).action @ state.jacobian(k)
        reached = stress.errors[k] - A @ (A.T @ stress.wrenches[k] / model.stiffness[s])
        np.testing.assert_allclose(reached, stress.settled, atol=2e-5)  # Jacobian at q instead of at the command


def test_both_ways_to_solve_agree(paper: Scenario, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    model = StressModel(paper.cell, paper.grasp, stiffness=rng.uniform(5e3, 1e5, paper.cell.nv))
    q = paper.q_start + rng.uniform(-1e-3, 1e-3, paper.cell.nq)
    direct = model.estimate(q)
    monkeypatch.setattr(coopqp.forces.internal, "_LARGEST_CONDITION", 0.0)
    general = model.estimate(q)
    np.testing.assert_allclose(general.wrenches, direct.wrenches, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(general.settled, direct.settled, atol=1e-10)


def test_the_reference_moves_the_point_that_wrenches_refer_to(paper: Scenario, rng: np.random.Generator) -> None:
    model = StressModel(paper.cell, paper.grasp, stiffness=5e4)
    q = paper.q_start + rng.uniform(-1e-4, 1e-4, paper.cell.nq)
    O = paper.path.pose(0.0)
    shift = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.4, -0.2]))
    here, there = (model.estimate(q, T_world_object=T).wrenches for T in (O, O * shift))
    expected = here @ np.asarray(shift.action)  # row by row Ad(shift)ᵀ w
    size = np.abs(expected).max()
    np.testing.assert_allclose(there, expected, atol=5e-3 * size)  # the path's pose is not exactly the first arm's
    assert np.abs(there - here).max() > 0.2 * size


@pytest.mark.parametrize("robots", ROBOTS[:3])
def test_servo_deflection_shows_the_wrenches_that_cause_it(
    robots: tuple[str, ...],
    make_cell: Callable[..., RobotCell],
    random_q: Callable[..., Array],
    rng: np.random.Generator,
) -> None:
    cell = make_cell(robots)
    for _ in range(10):
        q = random_q(cell, rng)
        grasp, state = grasp_at(cell, q), CellState(cell, q)
        model = StressModel(cell, grasp, stiffness=rng.uniform(5e3, 1e5, cell.nv))
        wrenches = rng.uniform(-50.0, 50.0, (len(cell), 6))
        torque = np.concatenate([state.jacobian(k).T @ w for k, w in enumerate(at_tools(wrenches, grasp))])
        q_command = pin.integrate(cell.model, q, torque / model.stiffness)
        np.testing.assert_allclose(model.from_torques(q, torque), wrenches, atol=1e-6)
        np.testing.assert_allclose(model.from_servos(q_command, q), wrenches, atol=1e-6)


def test_at_tools_keeps_the_power(paper: Scenario, rng: np.random.Generator) -> None:
    wrenches, twist = rng.normal(size=(3, 6)), rng.normal(size=6)
    for X, w, w_tool in zip(paper.grasp.T_object_tool, wrenches, at_tools(wrenches, paper.grasp), strict=True):
        assert w_tool @ (X.inverse().action @ twist) == pytest.approx(w @ twist)


def test_history_is_row_by_row(paper: Scenario, rng: np.random.Generator) -> None:
    model = StressModel(paper.cell, paper.grasp, stiffness=5e4)
    rows = paper.q_start + rng.uniform(-1e-4, 1e-4, (3, paper.cell.nq))
    history = model.history(rows)
    assert history.shape == (3, 3, 6)
    np.testing.assert_array_equal(history[2], model.estimate(rows[2]).wrenches)


def test_bad_input_is_named(paper: Scenario) -> None:
    for stiffness in (0.0, -1.0, np.nan, np.inf, [1.0, 2.0], "stiff"):
        with pytest.raises(InvalidInputError, match="stiffness"):
            StressModel(paper.cell, paper.grasp, stiffness=stiffness)
    with pytest.raises(InvalidInputError):
        StressModel(paper.cell, Grasp(paper.grasp.T_object_tool[:2]), stiffness=1.0)
    model = StressModel(paper.cell, paper.grasp, stiffness=1e4)
    with pytest.raises(InvalidInputError):
        model.estimate(paper.q_start[:-1])
    with pytest.raises(InvalidInputError):
        model.from_torques(paper.q_start, np.zeros(3))
    with pytest.raises(InvalidInputError, match="at_tools"):
        at_tools(np.zeros((2, 6)), paper.grasp)
