"""CellState: placements, Jacobians, singular values and margins of one configuration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from coopqp import InvalidInputError, RobotCell
from coopqp.errors import UnknownNameError
from coopqp.model import CellState
from coopqp.scenarios import Scenario
from coopqp.spatial import adjoint

Array = NDArray[np.float64]
RandomQ = Callable[[RobotCell, np.random.Generator], Array]


def test_tools_are_where_pinocchios_frames_are(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    data = mixed_cell.model.createData()
    for _ in range(50):
        q = random_q(mixed_cell, rng)
        pin.framesForwardKinematics(mixed_cell.model, data, q)
        for T, frame in zip(CellState(mixed_cell, q).T_world_tool, mixed_cell.tool_frames, strict=True):
            np.testing.assert_allclose(T.homogeneous, data.oMf[frame].homogeneous, rtol=0, atol=1e-15)


def test_jacobians_are_derivatives(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    """Jacobians equal central differences of the tool's pose in its own frame; other arms do not move."""
    h = 1e-5
    for _ in range(2):
        q = random_q(mixed_cell, rng)
        state = CellState(mixed_cell, q)
        for k, s in enumerate(mixed_cell.v_slices):
            J = state.jacobian(k)
            assert J.shape == (6, s.stop - s.start)
            for j in range(mixed_cell.nv):
                e = np.zeros(mixed_cell.nv)
                e[j] = h
                ahead, back = (
                    CellState(mixed_cell, pin.integrate(mixed_cell.model, q, x)).T_world_tool[k] for x in (e, -e)
                )
                column = pin.log6(back.actInv(ahead)).vector / (2.0 * h)
                expected = J[:, j - s.start] if s.start <= j < s.stop else np.zeros(6)
                np.testing.assert_allclose(column, expected, rtol=0, atol=2e-9)


def test_jacobians_of_the_three_frames_agree(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    for _ in range(20):
        state = CellState(mixed_cell, random_q(mixed_cell, rng))
        for name, H in zip(mixed_cell.arm_names, state.T_world_tool, strict=True):
            local = state.jacobian(name)
            world = state.jacobian(name, pin.WORLD)
            aligned = state.jacobian(name, pin.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(world, adjoint(H) @ local, rtol=0, atol=1e-13)
            np.testing.assert_allclose(aligned, np.kron(np.eye(2), H.rotation) @ local, rtol=0, atol=1e-13)


def test_singular_values(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    for _ in range(20):
        state = CellState(mixed_cell, random_q(mixed_cell, rng))
        assert state.sigma_min.shape == (len(mixed_cell),)
        for k, values in enumerate(state.singular_values):
            J = state.jacobian(k)
            assert len(values) == min(J.shape)
            assert (np.diff(values) <= 0.0).all()
            eigenvalues = np.linalg.eigvalsh(J @ J.T)[::-1][: len(values)]
            np.testing.assert_allclose(values**2, eigenvalues, rtol=0, atol=1e-12)
            assert state.sigma_min[k] == values[-1]


def test_their_product_is_the_closed_form_of_the_rx90l(paper: Scenario, random_q: RandomQ, rng: Any) -> None:
    for _ in range(50):
        q = random_q(paper.cell, rng)
        for values, x in zip(CellState(paper.cell, q).singular_values, q.reshape(3, 6), strict=True):
            reach = abs(0.45 * np.sin(x[1]) + 0.65 * np.sin(x[1] + x[2]))
            expected = 0.45 * 0.65 * abs(np.sin(x[2])) * reach * abs(np.sin(x[4]))
            assert np.prod(values) == pytest.approx(expected, rel=1e-9, abs=1e-14)


def test_a_stretched_wrist_is_singular(paper: Scenario) -> None:
    q = paper.q_start.copy()
    q[10] = 0.0  # joint 5 of slave 1
    sigma = CellState(paper.cell, q).sigma_min
    assert sigma[1] < 1e-12
    assert min(sigma[0], sigma[2]) > 0.1


def test_margins_to_limits(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    low, high = mixed_cell.limits.lower, mixed_cell.limits.upper
    for _ in range(20):
        q = random_q(mixed_cell, rng)
        margins = CellState(mixed_cell, q).limit_margins
        assert (margins >= 0.0).all()
        assert margins[-1] == np.inf  # the continuous joint
        for j, x in enumerate(mixed_cell.positions(q)[:-1]):
            assert margins[j] == pytest.approx(min(x - low[j], high[j] - x), abs=1e-15)
    outside = mixed_cell.positions(q).copy()
    outside[3] = high[3] + 0.25
    margins = CellState(mixed_cell, mixed_cell.configuration(outside)).limit_margins
    assert margins[3] == pytest.approx(-0.25, abs=1e-14)


def test_the_world_does_not_matter_to_singular_values(make_cell: Callable[..., RobotCell], rng: Any) -> None:
    pin.seed(2)
    bases = [pin.SE3.Random(), pin.SE3.Random()]
    moved = [pin.SE3(pin.exp3(rng.normal(size=3)), 10.0 * rng.normal(size=3)) * T for T in bases]
    q = rng.uniform(-1, 1, 13)
    one, other = (CellState(make_cell(["rx90l", "arm7"], b), q) for b in (bases, moved))
    np.testing.assert_allclose(one.sigma_min, other.sigma_min, rtol=0, atol=1e-13)


def test_holding_a_state_means_a_fixed_configuration(paper: Scenario) -> None:
    q = paper.q_start.copy()
    state = CellState(paper.cell, q)
    before = state.jacobian(1).copy()
    q[:] = 0.0
    assert np.array_equal(state.q, paper.q_start)
    with pytest.raises(ValueError, match="read-only"):
        state.q[0] = 1.0
    state.jacobian(1)[:] = 0.0  # a copy
    CellState(paper.cell, np.zeros(18))  # another state of the same cell
    assert np.array_equal(state.jacobian(1), before)


def test_bad_input(paper: Scenario) -> None:
    for bad in ([0.0] * 17, np.full(18, np.nan), None, "q", np.zeros((18, 1))):
        with pytest.raises(InvalidInputError, match="CellState"):
            CellState(paper.cell, bad)
    state = CellState(paper.cell, paper.q_start)
    with pytest.raises(UnknownNameError, match="slave_3"):
        state.jacobian("slave_3")
    with pytest.raises(UnknownNameError, match="arm"):
        state.jacobian(3)
