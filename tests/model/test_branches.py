"""All branches of an arm at a pose, against a closed form that knows nothing of them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import rx90l

from coopqp import Arm, Grasp, InvalidInputError, RobotCell, inverse_kinematics
from coopqp.errors import UnreachableError
from coopqp.model import CellState
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import Branches, all_turns, amount, find_branches, turns_inside
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
def test_all_branches_of_the_rx90l_and_no_other_solution(rng: Any) -> None:
    kinematics = ArmKinematics(rx90l(geometry=False))
    poses = kinematics.tool_poses(rng.uniform(-3.0, 3.0, (200, 6)))
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


# -- the search --------------------------------------------------------------------------------------------------------


def test_the_search_ends_when_a_round_finds_nothing_new(rng: Any) -> None:
    """Never with all twelve rounds of 64 seeds; out of reach after four."""
    kinematics = ArmKinematics(rx90l(geometry=False))
    for T in kinematics.tool_poses(kinematics.seeds(10, rng)):
        branches = find_branches(kinematics, T)
        assert 2 * 64 <= branches.seeds < 12 * 64
        assert branches.hits.min() >= 4, "each branch is found four times"
        assert branches.hits.sum() <= branches.seeds
        assert 0.0 <= branches.closest <= 1e-9
        np.testing.assert_array_equal(branches.sigma_min, kinematics.singular_values(branches.q)[:, -1])
    far = pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.42]))
    nothing = find_branches(kinematics, far)
    assert (len(nothing), nothing.seeds) == (0, 4 * 64)
    assert nothing.q.shape == nothing.margins.shape == (0, 6)
    assert nothing.sigma_min.shape == nothing.hits.shape == nothing.inside.shape == (0,)
    assert find_branches(kinematics, far, seed_factor=3).seeds == 3 * nothing.seeds
    assert find_branches(kinematics, far, quick=True).seeds == 64
    for bad in (0, -1, 1.5, "many"):
        with pytest.raises(InvalidInputError, match="find_branches: seed_factor"):
            find_branches(kinematics, far, seed_factor=bad)  # type: ignore[arg-type]


def test_seeds_that_are_near_come_beside_the_others(rng: Any) -> None:
    kinematics = ArmKinematics(rx90l(geometry=False))
    far, near = pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.42])), kinematics.seeds(5, rng)
    assert find_branches(kinematics, far, near=near, quick=True).seeds == 64 + 5
    assert find_branches(kinematics, far, near=near[:0], quick=True).seeds == 64
    seven = ArmKinematics(Arm.from_urdf("arm", robot_path("arm7"), tool_frame="tool", geometry=False))
    q = seven.middle + 0.3
    samples = find_branches(seven, pin.SE3(seven.tool_poses(q[None])[0]), near=q[None])
    assert seven.same(samples.q, q, within=1e-9).sum() == 1, "a redundant arm's own solution is among the samples"


def test_the_same_seed_finds_the_same(rng: Any) -> None:
    kinematics = ArmKinematics(Arm.from_urdf("arm", robot_path("arm7"), tool_frame="tool", geometry=False))
    T = pin.SE3(kinematics.tool_poses(kinematics.middle[None] + 0.2)[0])
    one, again, other = (find_branches(kinematics, T, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one.q, again.q)
    assert not np.array_equal(one.q[: len(other)], other.q[: len(one)])


def test_a_redundant_arm_has_samples_of_its_solutions() -> None:
    """As many as seeds arrive, each once, the one furthest inside first; all reach the pose."""
    kinematics = ArmKinematics(Arm.from_urdf("arm", robot_path("arm7"), tool_frame="tool", geometry=False))
    T = kinematics.tool_poses(kinematics.middle[None] + 0.2)[0]
    for options, seeds in (({}, 256), ({"quick": True}, 64), ({"seed_factor": 2}, 512)):
        samples = find_branches(kinematics, pin.SE3(T), **options)
        assert samples.seeds == seeds
        assert 0.5 * seeds < len(samples) <= seeds
        np.testing.assert_allclose(kinematics.tool_poses(samples.q), np.tile(T, (len(samples), 1, 1)), atol=2e-9)
        assert (np.diff(samples.margins.min(axis=1)) <= 0.0).all()


def test_of_very_many_solutions_those_furthest_inside_are_kept(rng: Any) -> None:
    kinematics = ArmKinematics(Arm.from_urdf("arm", robot_path("arm7"), tool_frame="tool", geometry=False))
    T, near = pin.SE3(kinematics.tool_poses(kinematics.middle[None] + 0.2)[0]), kinematics.seeds(600, rng)
    every = find_branches(kinematics, T, near=near, quick=True, seed_factor=4)
    kept = find_branches(kinematics, T, near=near, quick=True)
    assert len(kept) == 256
    assert len(every) > 300
    np.testing.assert_array_equal(kept.q, every.q[:256])
    np.testing.assert_array_equal(kept.margins, every.margins[:256])


def test_at_a_limit_is_inside() -> None:
    """By up to a billionth of a radian, for branches and for their whole turns."""
    margins = np.array([[0.1, -0.9e-9], [-1e-9, 0.1], [0.1, -1.1e-9], [np.inf, 0.0]])
    branches = Branches(np.zeros((4, 2)), np.ones(4, dtype=np.intp), margins, np.ones(4), 4, 0.0)
    np.testing.assert_array_equal(branches.inside, [True, True, False, True])
    kinematics = ArmKinematics(rx90l(geometry=False))
    for j in range(6):
        for end, sign in ((kinematics.lower[j], -1.0), (kinematics.upper[j], 1.0)):
            q = kinematics.middle.copy()
            q[j] = end + sign * 0.9e-9
            assert 0 in turns_inside(kinematics, q, q)[j]
            q[j] = end + sign * 1.1e-9
            assert 0 not in turns_inside(kinematics, q, q)[j]


def test_a_sliding_joint_has_no_turn_outside_its_limits() -> None:
    kinematics = ArmKinematics(Arm.from_urdf("arm", robot_path("gantry7"), tool_frame="tool", geometry=False))
    j = int(np.flatnonzero(kinematics.slides)[0])
    for place, choices in (
        (kinematics.lower[j] - 0.01, ()), (kinematics.upper[j] + 0.01, ()), (kinematics.upper[j], (0,)),
        (kinematics.lower[j] + 2.0 * np.pi, ()),
    ):  # fmt: skip
        q = kinematics.middle.copy()
        q[j] = place
        assert turns_inside(kinematics, q, q)[j] == choices
        assert len(all_turns(kinematics, q)) == (0 if not choices else 1)
        assert all_turns(kinematics, q).shape[1] == 7
    low, high = kinematics.middle.copy(), kinematics.middle.copy()
    high[j] = kinematics.upper[j] + 0.01
    assert turns_inside(kinematics, low, high)[j] == ()


def test_amounts_are_said_in_degrees_or_millimetres() -> None:
    assert amount(0.01234, slides=True) == "12.3 mm"
    assert amount(0.5 * np.pi, slides=False) == "90.0°"


# -- a cell inside its limits ------------------------------------------------------------------------------------------


def test_an_arm_outside_its_limits_takes_the_nearest_branch_inside(paper: Scenario) -> None:
    """Against all branches and turns, by the joint that goes furthest. The other arms stay."""
    cell, T = paper.cell, paper.path.pose(0.0)
    start = paper.q_start[6:12] + np.array([0.0, 0.0, 0.0, 0.1, 0.0, -0.2])
    lower, upper = np.full(6, -6.0), np.full(6, 6.0)
    if start[4] > 0.0:
        upper[4] = start[4] - 0.1
    else:
        lower[4] = start[4] + 0.1
    tight = RobotCell([cell.arms[0], cell.arms[1].with_limits(lower=lower, upper=upper), cell.arms[2]])
    q = inverse_kinematics(tight, paper.grasp, T, np.concatenate([paper.q_start[:6], start, paper.q_start[12:]]))
    assert holds(tight, paper.grasp, q, T) < 1e-11
    np.testing.assert_allclose(q[:6], paper.q_start[:6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(q[12:], paper.q_start[12:], rtol=0, atol=1e-9)
    assert CellState(tight, q).limit_margins.min() >= 0.0
    kinematics = ArmKinematics(tight.arms[1])
    branches = find_branches(kinematics, T * paper.grasp.T_object_tool[1], seed=3)
    away = [np.abs(x - start).max() for b in branches.q[branches.inside] for x in all_turns(kinematics, b)]
    assert len(away) > 10
    assert np.abs(q[6:12] - start).max() == pytest.approx(min(away), abs=1e-6)


def test_an_answer_that_is_only_near_names_its_own_joint(paper: Scenario) -> None:
    """With so large a tolerance that the start will do, and no branch at the pose itself."""
    cell = RobotCell([rx90l(geometry=False)])
    q = np.array([0.1, 0.2, cell.limits.upper[2] + 0.2, 0.3, 0.4, 0.5])
    far = pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.42]))
    grasp = Grasp((pin.SE3.Identity(),))
    with pytest.raises(UnreachableError, match=r"joint_3 would be 11\.5° outside \(the least of 0 branches from 257 "):
        inverse_kinematics(cell, grasp, far, q, tolerance=5.0)
    np.testing.assert_array_equal(inverse_kinematics(cell, grasp, far, q, tolerance=5.0, limits=False), q)


def test_an_error_of_a_nanometre_is_accepted_whatever_the_tolerance(paper: Scenario) -> None:
    q = inverse_kinematics(paper.cell, paper.grasp, paper.path.pose(0.0), paper.q_start, tolerance=0.0)
    assert holds(paper.cell, paper.grasp, q, paper.path.pose(0.0)) < 1e-9
    moved = paper.path.pose(0.0) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.9e-9]))
    inverse_kinematics(paper.cell, paper.grasp, moved, q, max_iter=0)
    moved = paper.path.pose(0.0) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.1e-6]))
    with pytest.raises(UnreachableError, match=r"0\.0 mm and 0\.00° remain after 0 iterations"):
        inverse_kinematics(paper.cell, paper.grasp, moved, q, max_iter=0)
