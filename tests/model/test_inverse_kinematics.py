"""Closed-chain inverse kinematics: every arm arrives on the start's branch, or an error names the arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from coopqp import Grasp, InvalidInputError, RobotCell, inverse_kinematics
from coopqp.errors import UnreachableError
from coopqp.model import CellState
from coopqp.scenarios import Scenario

Array = NDArray[np.float64]
RandomQ = Callable[[RobotCell, np.random.Generator], Array]


def worst_error(cell: RobotCell, grasp: Grasp, q: Array, T: pin.SE3) -> float:
    return max(np.abs(pin.log6(T.actInv(O)).vector).max() for O in grasp.carried(CellState(cell, q)))


@given(st.integers(0, 2**32 - 1))
def test_every_arm_arrives(paper: Scenario, seed: int) -> None:
    """Poses around the lift, from starts with errors of up to 0.1 rad per joint."""
    rng = np.random.default_rng(seed)
    T = paper.path.pose(rng.uniform(0.0, 3.0)) * pin.exp6(pin.Motion(0.05 * rng.uniform(-1, 1, 6)))
    q = inverse_kinematics(paper.cell, paper.grasp, T, paper.q_start + rng.uniform(-0.1, 0.1, 18))
    assert worst_error(paper.cell, paper.grasp, q, T) < 1e-11
    assert np.abs(q - paper.q_start).max() < 2.0, "the same branch"


def test_a_solution_stays_where_it_is(paper: Scenario) -> None:
    q = inverse_kinematics(paper.cell, paper.grasp, paper.path.start, paper.q_start)
    np.testing.assert_allclose(q, paper.q_start, rtol=0, atol=1e-11)
    again = inverse_kinematics(paper.cell, paper.grasp, paper.path.start, q)
    assert np.array_equal(again, inverse_kinematics(paper.cell, paper.grasp, paper.path.start, q))


def test_all_kinds_of_arms_at_once(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    """Redundant arms and arms with four and five joints, at poses that they can reach."""
    found = 0
    for _ in range(20):
        q, T = random_q(mixed_cell, rng), pin.SE3.Random()
        if CellState(mixed_cell, q).sigma_min.min() < 0.02:
            continue
        grasp = Grasp.from_configuration(mixed_cell, q, T)
        near = pin.integrate(mixed_cell.model, q, rng.uniform(-0.05, 0.05, mixed_cell.nv))
        before = near.copy()
        got = inverse_kinematics(mixed_cell, grasp, T, near)
        assert worst_error(mixed_cell, grasp, got, T) < 1e-11
        assert np.array_equal(near, before), "the start is the caller's"
        assert np.hypot(*got[-2:]) == pytest.approx(1.0, abs=1e-12)  # the continuous joint
        assert np.abs(pin.difference(mixed_cell.model, q, got)).max() < 1.0
        found += 1
    assert found > 5


def test_arms_do_not_depend_on_each_other(make_cell: Callable[..., RobotCell], rng: Any) -> None:
    bases = [pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0]))]
    both = make_cell(["rx90l", "arm7"], bases)
    q = rng.uniform(0.3, 0.8, 13)
    grasp = Grasp.from_configuration(both, q, np.eye(4))
    T = pin.exp6(pin.Motion(np.full(6, 0.01)))
    together = inverse_kinematics(both, grasp, T, q)
    for k, s in enumerate(both.q_slices):
        alone = RobotCell([both.arms[k]])
        own = inverse_kinematics(alone, Grasp(grasp.T_object_tool[k : k + 1]), T, q[s])
        np.testing.assert_allclose(together[s], own, rtol=0, atol=1e-9)


@pytest.mark.parametrize("arm", [0, 1, 2])
def test_an_arm_out_of_reach_is_named(paper: Scenario, arm: int) -> None:
    """Only one arm has a grasp point 20 m away; the others arrive."""
    placements = list(paper.grasp.T_object_tool)
    placements[arm] = pin.SE3(np.eye(3), np.array([0.0, 0.0, 20.0])) * placements[arm]
    with pytest.raises(UnreachableError, match=f"arm '{paper.cell.arm_names[arm]}' does not reach") as caught:
        inverse_kinematics(paper.cell, Grasp(tuple(placements)), paper.path.start, paper.q_start)
    assert "mm" in str(caught.value)
    assert "another start" in str(caught.value)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("distance", [2.0, 50.0, 1e6, 1e300, 1e308])
def test_an_object_out_of_reach(paper: Scenario, distance: float) -> None:
    far = pin.SE3(np.eye(3), np.array([0.0, 0.0, distance]))
    with pytest.raises(UnreachableError, match="does not reach its grasp"):
        inverse_kinematics(paper.cell, paper.grasp, far, paper.q_start)


def test_too_few_iterations(paper: Scenario) -> None:
    goal = paper.path.goal
    with pytest.raises(UnreachableError, match="after 2 iterations"):
        inverse_kinematics(paper.cell, paper.grasp, goal, paper.q_start, max_iter=2)
    with pytest.raises(UnreachableError, match="after 0 iterations"):
        inverse_kinematics(paper.cell, paper.grasp, goal, paper.q_start, max_iter=0)
    inverse_kinematics(paper.cell, paper.grasp, goal, paper.q_start, max_iter=2, tolerance=0.5)


def test_a_pose_that_four_joints_cannot_turn_to(make_cell: Callable[..., RobotCell]) -> None:
    cell = make_cell(["rx90l", "scara4"])
    q = cell.configuration([0.3, 0.6, 0.7, 0.2, 0.5, 0.1, 0.3, 0.5, -0.05, 0.2])
    grasp = Grasp.from_configuration(cell, q, np.eye(4))
    with pytest.raises(UnreachableError, match="arm '1_scara4'"):
        inverse_kinematics(cell, grasp, pin.SE3(pin.exp3(np.array([0.1, 0.0, 0.0])), np.zeros(3)), q)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"T_world_object": 2 * np.eye(4)}, "inverse_kinematics: T_world_object"),
        ({"T_world_object": None}, "inverse_kinematics: T_world_object"),
        ({"T_world_object": np.full((4, 4), np.nan)}, "inverse_kinematics: T_world_object"),
        ({"q_start": np.zeros(6)}, "inverse_kinematics: q_start"),
        ({"q_start": np.full(18, np.inf)}, "inverse_kinematics: q_start"),
        ({"q_start": "home"}, "inverse_kinematics: q_start"),
        ({"tolerance": np.nan}, "inverse_kinematics: tolerance"),
        ({"tolerance": -1.0}, "inverse_kinematics: tolerance"),
        ({"grasp": Grasp((np.eye(4),))}, "1 placements for 3 arms"),
    ],
)
def test_bad_input(paper: Scenario, arguments: dict[str, Any], says: str) -> None:
    good = {
        "cell": paper.cell, "grasp": paper.grasp, "T_world_object": paper.path.start, "q_start": paper.q_start,
    }  # fmt: skip
    with pytest.raises(InvalidInputError) as caught:
        inverse_kinematics(**{**good, **arguments})
    assert says in str(caught.value)
