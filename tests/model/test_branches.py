"""All branches of an arm at a pose, against a closed form that knows nothing of them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import rx90l

from coopqp import Arm, Grasp, RobotCell, inverse_kinematics
from coopqp.errors import UnreachableError
from coopqp.model import CellState
from coopqp.model.batch import ArmKinematics, batch_kernels
from coopqp.model.branches import all_turns, find_branches, turns_inside
from coopqp.scenarios import Scenario, robot_path

UPPER_ARM, FOREARM, SHOULDER, WRIST = 0.450, 0.650, 0.420, 0.085


def rot(axis: str, angle: float) -> Any:
    return pin.utils.rotate(axis, angle)


def closed_form(T: Any) -> list[Any]:
    """All solutions of T = Tz(d) Rz(q1) Ry(q2) Tz(a) Ry(q3) Rz(q4) Tz(b) Ry(q5) Tz(w) Rz(q6), the RX-90L's."""
    R, p = T[:3, :3], T[:3, 3]
    centre = p - WRIST * R[:, 2] - [0.0, 0.0, SHOULDER]
    reach2 = centre @ centre
    found = []
    for side, elbow, flip in itertools.product((0, 1), (1.0, -1.0), (1.0, -1.0)):
        q1 = np.arctan2(centre[1], centre[0]) + side * np.pi
        x = np.hypot(centre[0], centre[1]) * (1.0 - 2.0 * side)
        cosine = (reach2 - UPPER_ARM**2 - FOREARM**2) / (2.0 * UPPER_ARM * FOREARM)
        if abs(cosine) > 1.0:
            continue
        q3 = elbow * np.arccos(cosine)
        q2 = np.arctan2(x, centre[2]) - np.arctan2(FOREARM * np.sin(q3), UPPER_ARM + FOREARM * np.cos(q3))
        M = (rot("z", q1) @ rot("y", q2 + q3)).T @ R
        q5 = flip * np.arctan2(np.hypot(M[0, 2], M[1, 2]), M[2, 2])
        q4 = np.arctan2(flip * M[1, 2], flip * M[0, 2])
        q6 = np.arctan2(flip * M[2, 1], -flip * M[2, 0])
        found.append(np.array([q1, q2, q3, q4, q5, q6]))
    return found


def test_the_closed_form_is_right(rng: Any) -> None:
    kinematics = ArmKinematics(rx90l(geometry=False))
    for T in kinematics.tool_poses(rng.uniform(-3.0, 3.0, (50, 6))):
        solutions = closed_form(T)
        assert len(solutions) == 8
        np.testing.assert_allclose(kinematics.tool_poses(np.array(solutions)), np.tile(T, (8, 1, 1)), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", batch_kernels())
def test_all_branches_of_the_rx90l_and_no_other_solution(kernel: Any, rng: Any) -> None:
    kinematics = ArmKinematics(rx90l(geometry=False), kernel=kernel)
    poses = kinematics.tool_poses(rng.uniform(-3.0, 3.0, (200 if kernel == "compiled" else 20, 6)))
    for T in poses:
        branches, expected = find_branches(kinematics, T), closed_form(T)
        match = np.array([kinematics.same(branches.q, q, within=1e-4) for q in expected])
        assert (match.sum(axis=1) == 1).all(), "every solution of the closed form is found, once"
        assert (match.sum(axis=0) == 1).all(), "nothing else is found"
        assert branches.hits.sum() <= branches.seeds
        assert branches.closest <= 1e-9


def test_out_of_reach_there_are_none_and_the_rest_is_said() -> None:
    far = pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.42]))
    branches = find_branches(ArmKinematics(rx90l(geometry=False)), far)
    assert len(branches) == 0
    assert 0.1 < branches.closest < 3.0


def test_the_one_furthest_inside_comes_first(rng: Any) -> None:
    kinematics = ArmKinematics(rx90l(geometry=False))
    for T in kinematics.tool_poses(kinematics.seeds(20, rng)):
        branches = find_branches(kinematics, T)
        least = branches.margins.min(axis=1)
        assert (np.diff(least) <= 0.0).all()
        np.testing.assert_array_equal(branches.inside, least >= -1e-9)
        np.testing.assert_array_equal(branches.margins, kinematics.margins(branches.q))


def test_whole_turns_are_all_listed(rng: Any) -> None:
    """Against counting: joints 4 and 6 span ±270°, so an angle has one or two turns in them."""
    kinematics = ArmKinematics(rx90l(geometry=False))
    low, high = kinematics.lower, kinematics.upper
    for q in rng.uniform(low, high, (100, 6)):
        turned = [[x + 2.0 * np.pi * k for k in range(-3, 4)] for x in q]
        fit = [[x for x in xs if low[j] <= x <= high[j]] for j, xs in enumerate(turned)]
        expected = {tuple(np.round(x, 9)) for x in itertools.product(*fit)}
        got = all_turns(kinematics, q + 2.0 * np.pi * rng.integers(-1, 2, 6))
        assert {tuple(np.round(x, 9)) for x in got} == expected


def test_a_motion_needs_room_for_all_of_it() -> None:
    kinematics = ArmKinematics(rx90l(geometry=False))
    low, high = np.zeros(6), np.zeros(6)
    low[3], high[3] = -1.0, 3.0  # joint 4 spans ±270°
    assert turns_inside(kinematics, low, high)[3] == (0,)
    low[3], high[3] = 3.0, 4.0
    assert turns_inside(kinematics, low, high)[3] == (-1, 0)
    low[3], high[3] = -5.0, 5.0
    assert turns_inside(kinematics, low, high)[3] == ()


def test_sliding_and_continuous_joints_have_one_turn() -> None:
    for robot, tool in (("gantry7", "tool"), ("arm6c", "tool")):
        arm = Arm.from_urdf("arm", robot_path(robot), tool_frame=tool, geometry=False)
        kinematics = ArmKinematics(arm)
        choices = turns_inside(kinematics, kinematics.middle, kinematics.middle)
        for j in np.flatnonzero(kinematics.slides | kinematics.continuous):
            assert choices[j] == (0,)


# -- inverse kinematics of a cell inside its limits --------------------------------------------------------------------


def holds(cell: RobotCell, grasp: Grasp, q: Any, T: pin.SE3) -> float:
    return max(float(np.abs(pin.log6(T.actInv(O)).vector).max()) for O in grasp.carried(CellState(cell, q)))


@pytest.mark.slow
def test_inverse_kinematics_prefers_what_is_inside_limits(paper: Scenario, rng: Any) -> None:
    """From any start whose own answer is outside limits, the answer is inside and holds the object."""
    cell, grasp, T = paper.cell, paper.grasp, paper.path.start
    changed = 0
    for _ in range(40):
        start = rng.uniform(cell.limits.lower, cell.limits.upper)
        try:
            free = inverse_kinematics(cell, grasp, T, start, limits=False)
        except UnreachableError:
            continue
        q = inverse_kinematics(cell, grasp, T, start)
        assert CellState(cell, q).limit_margins.min() >= -1e-8
        assert holds(cell, grasp, q, T) < 1e-11
        if CellState(cell, free).limit_margins.min() >= 0.0:
            np.testing.assert_array_equal(q, free)
        else:
            changed += 1
    assert changed > 3


def test_the_joint_that_would_be_outside_is_named(paper: Scenario) -> None:
    """With joint 3 of one arm limited away from every solution, the message says by how much."""
    cell = RobotCell(
        [
            paper.cell.arms[0],
            paper.cell.arms[1].with_limits(
                lower=[-2.7, -2.3, -0.4, -4.7, -1.8, -4.7], upper=[2.7, 2.3, 0.4, 4.7, 2, 4.7]
            ),
            paper.cell.arms[2],
        ]
    )
    x = np.abs(paper.q_start[8])  # joint 3 of that arm: ± this in every branch
    with pytest.raises(UnreachableError) as caught:
        inverse_kinematics(cell, paper.grasp, paper.path.start, paper.q_start)
    assert f"arm '{cell.arm_names[1]}' reaches its grasp only outside its limits: joint_3 would be " in str(
        caught.value
    )
    assert f"{np.rad2deg(x - 0.4):.1f}° outside" in str(caught.value)
    assert "Roll its tool" in str(caught.value)
    q = inverse_kinematics(cell, paper.grasp, paper.path.start, paper.q_start, limits=False)
    np.testing.assert_allclose(q, paper.q_start, atol=1e-9)
