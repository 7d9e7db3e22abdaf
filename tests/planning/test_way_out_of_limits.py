"""What is said of an arm that leaves its limits, or has no start."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.model.batch import ArmKinematics
from coopqp.planning import PathVerdict
from coopqp.planning.arm_starts import ArmOnPath, BranchAlongPath, rolled, trouble
from coopqp.planning.branch_checks import BranchCheck, ToolPath, check_trajectory
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array


@pytest.fixture(scope="module")
def arm() -> ArmKinematics:
    return ArmKinematics(paper_lift().cell.arms[0])


def judged(arm: ArmKinematics, q: Array, clocks: Array, *, end: float | None = None) -> BranchCheck:
    """The verdict on joint positions at clocks, without a proof between them."""
    poses = arm.tool_poses(q)
    last = float(clocks[-1]) if end is None else end
    return check_trajectory(
        arm, ToolPath(clocks, poses, np.eye(4), None, np.zeros(0, dtype=np.intp), np.zeros(0), last), q
    )


def bent(arm: ArmKinematics, count: int) -> Array:
    """Away from singularities and limits."""
    return np.tile(arm.middle + np.array([0.1, 0.4, 0.5, 0.3, 0.8, 0.2]), (count, 1))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_where_a_joint_leaves_its_limits_lies_between_two_samples(arm: ArmKinematics, side: float) -> None:
    q, clocks = bent(arm, 5), np.array([0.0, 0.5, 1.0, 2.0, 3.0])
    end = arm.upper[0] if side > 0.0 else arm.lower[0]
    q[:, 0] = end - side * np.array([0.5, 0.4, 0.3, -0.1, -0.2])
    found = judged(arm, q, clocks)
    assert found.verdict is PathVerdict.INFEASIBLE
    assert found.until == pytest.approx(1.75)
    assert found.why == f"leaves the limits of {arm.joints[0]} at 1.75 s (it would be 11.5° outside at 3.00 s)"
    assert found.margins[0] == pytest.approx(-0.2)
    assert found.margin_clocks[0] == 3.0
    assert found.tightest == 0
    assert not len(found.undecided)


def test_a_start_outside_is_told_by_its_own_amount(arm: ArmKinematics) -> None:
    q = bent(arm, 3)
    q[:, 1] = arm.upper[1] + np.array([0.1, 0.3, -0.1])
    found = judged(arm, q, np.arange(3.0))
    assert (found.verdict, found.until) == (PathVerdict.INFEASIBLE, 0.0)
    assert found.why == f"starts 5.7° outside {arm.joints[1]}"


def test_samples_inside_are_followed_and_nothing_is_proved(arm: ArmKinematics) -> None:
    q, clocks = bent(arm, 4), np.arange(4.0)
    q[:, 2] += [0.0, 0.2, 0.1, 0.0]
    found = judged(arm, q, clocks)
    assert found.verdict is PathVerdict.SAMPLED
    assert found.why.startswith("is followed at samples: the proof knows lines, rounded corners")
    assert found.until == 3.0
    assert found.sigma_bound == 0.0
    np.testing.assert_allclose(found.sigma_min, arm.singular_values(q)[:, -1])
    np.testing.assert_allclose(found.manipulability, arm.singular_values(q).prod(axis=1))
    np.testing.assert_allclose(found.margins, arm.margins(q).min(axis=0))
    at_start = judged(arm, q[:1], clocks[:1], end=0.0)
    assert at_start.why == "is judged at its start alone: the path has no end, or is not known ahead"


def test_about_a_singular_sample_nothing_is_decided(arm: ArmKinematics) -> None:
    """From the sample before it to the one after."""
    q, clocks = bent(arm, 6), np.array([0.0, 1.0, 1.5, 2.0, 3.0, 4.0])
    q[2, 4] = 0.0  # the wrist is straight
    found = judged(arm, q, clocks)
    assert found.verdict is PathVerdict.UNDECIDED
    np.testing.assert_array_equal(found.undecided, [[1.0, 2.0]])
    assert found.why.startswith("is not decided on 1–2 s: it is nearly singular there (σ_min ")
    q[5, 4] = 0.0
    ends = judged(arm, q, clocks)
    np.testing.assert_array_equal(ends.undecided, [[1.0, 2.0], [3.0, 4.0]])
    assert "on 1–2 s and on 1 more intervals: " in ends.why
    q[4, 4] = 0.0
    np.testing.assert_array_equal(judged(arm, q, clocks).undecided, [[1.0, 4.0]])


# -- arms without a start ----------------------------------------------------------------------------------------------


def row(**changes: Any) -> BranchAlongPath:
    values: dict[str, Any] = {
        "roll": 0.0,
        "q": np.zeros(6),
        "hits": 3,
        "reached": 2.0,
        "complete": True,
        "margins": np.array([np.inf, 1.0, 0.3, 0.5, 2.0, 3.0]),
        "clocks": np.array([0.0, 0.1, 1.256, 0.3, 0.4, 0.5]),
        "sigma_min": np.array([0.4, 0.1234, 0.3]),
        "score": 0.6,
    }
    return BranchAlongPath(**{**values, **changes})


def outside(amount: float, **changes: Any) -> BranchAlongPath:
    return row(margins=np.array([np.inf, 1.0, -amount, 0.5, 2.0, 3.0]), **changes)


def test_a_branch_is_feasible_that_is_whole_inside_and_regular() -> None:
    assert row().feasible
    assert row().tightest == 2
    assert not row(complete=False).feasible
    assert not outside(0.1).feasible
    assert not outside(0.1).inside
    assert not row(sigma_min=np.array([0.4, 1e-4, 0.3])).feasible


START = np.zeros(6)


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([], "arm {arm} does not reach its grasp at the start of the path (0.012 m or rad remain)"),
        ([outside(0.3, clocks=START), outside(0.2, clocks=START)], "arm {arm} starts 11.5° outside {joint}"),
        (
            [outside(0.3), outside(0.1), outside(0.05, clocks=START)],
            "arm {arm} goes 5.7° outside {joint} at 1.26 s of the path",
        ),
        (
            [row(complete=False, reached=1.5, end="there"), row(complete=False, reached=0.5, end="here")],
            "arm {arm} follows the path until 1.50 s, there",
        ),
        (
            [row(complete=False), row(sigma_min=np.array([0.4, 2e-4, 0.3]))],
            "arm {arm} is singular on the path (σ_min 0.0002)",
        ),
    ],
)
def test_why_an_arm_has_no_start_is_told_of_its_best_branch(
    arm: ArmKinematics, rows: list[BranchAlongPath], text: str
) -> None:
    said = trouble(ArmOnPath(arm, tuple(rows), 0.0123))
    assert said == text.format(arm=arm.arm.name, joint=arm.joints[2])


def test_feasible_branches_keep_their_order(arm: ArmKinematics) -> None:
    rows = (row(), outside(0.1), replace(row(), score=0.1))
    assert ArmOnPath(arm, rows, 0.0).feasible == (rows[0], rows[2])


def test_a_roll_turns_a_tool_about_its_own_z_axis() -> None:
    T = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([1.0, 2.0, 3.0]))
    turned = rolled(T, 0.5 * np.pi)
    np.testing.assert_allclose(turned.translation, T.translation)
    np.testing.assert_allclose(turned.rotation[:, 2], T.rotation[:, 2], atol=1e-12)
    np.testing.assert_allclose(turned.rotation[:, 0], T.rotation[:, 1], atol=1e-12)
    np.testing.assert_array_equal(rolled(T, 0.0).homogeneous, T.homogeneous)
