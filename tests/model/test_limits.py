"""Names of limits, and what joint limits accept."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp import BindingLimit, InvalidInputError, JointLimits, LimitKind, RobotCell


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (BindingLimit("left", "elbow", LimitKind.VELOCITY), "arm left joint elbow: velocity"),
        (BindingLimit("left", "", LimitKind.REACH), "arm left: reach"),
        (BindingLimit("", "", LimitKind.PATH_END), "path end"),
        (BindingLimit("", "", LimitKind.CONSTRAINT, name="no spill"), "constraint no spill"),
        (BindingLimit("left", "elbow", LimitKind.CONSTRAINT, name="no spill"), "constraint no spill"),
        (BindingLimit("", "", LimitKind.COLLISION, between=("post", "left/hand")), "post and left/hand"),
        (
            BindingLimit("", "", LimitKind.COLLISION, between=("post", "left/hand"), distance=0.0123),
            "post and left/hand: 12.3 mm",
        ),
        (
            BindingLimit("", "", LimitKind.COLLISION, between=("post", "left/hand"), distance=0.0),
            "post and left/hand: 0.0 mm",
        ),
    ],
)
def test_a_limit_says_which_it_is(limit: BindingLimit, says: str) -> None:
    assert str(limit) == says


def test_bodies_that_come_near_are_one_limit_at_any_distance() -> None:
    near, nearer = (
        BindingLimit("", "", LimitKind.COLLISION, between=("post", "hand"), distance=d) for d in (0.02, 0.01)
    )
    assert near == nearer
    assert near != BindingLimit("", "", LimitKind.COLLISION, between=("post", "arm"), distance=0.02)


def test_a_cell_names_the_limit_of_a_joint(mixed_cell: RobotCell) -> None:
    for j, name in enumerate(mixed_cell.joint_names):
        limit = mixed_cell.joint_limit(j, LimitKind.POSITION)
        assert (f"{limit.arm}/{limit.joint}", limit.kind) == (name, LimitKind.POSITION)


def test_limits_are_taken_up_to_the_last_that_make_sense() -> None:
    limits = JointLimits([-1e9, -np.inf], [1e9, np.inf], [1e-6, np.inf], [1e9, 1e-6])  # type: ignore[arg-type]
    np.testing.assert_array_equal(limits.lower, [-1e9, -np.inf])
    np.testing.assert_array_equal(limits.acceleration, [1e9, 1e-6])
    other = limits.replace(lower=[-1.0, 0.0], velocity=3.0)
    np.testing.assert_array_equal(other.lower, [-1.0, 0.0])
    np.testing.assert_array_equal(other.velocity, [3.0, 3.0])
    np.testing.assert_array_equal(other.upper, limits.upper)
    np.testing.assert_array_equal(limits.velocity, [1e-6, np.inf])


@pytest.mark.parametrize(
    ("field", "values", "says"),
    [
        ("lower", [0.0, -1.1e9], "lower has entries beyond 1e\\+09. Give inf"),
        ("upper", [1.1e9, 1.0], "upper has entries beyond"),
        ("velocity", [1.0, 1.1e9], "velocity has entries beyond"),
        ("acceleration", [1.0, 2.0, 3.0], r"acceleration has shape \(3,\) or NaN, expected \(2,\)"),
        ("upper", [1.0, np.nan], r"upper has shape \(2,\) or NaN"),
        ("upper", [1.0, 0.0], r"joint 1: position limits \[0, 0\] are empty or reversed"),
        ("upper", [-0.5, 1.0], r"joint 0: position limits \[0, -0\.5\]"),
        ("velocity", [1.0, 0.9e-6], "joint 1: velocity limit 9e-07, acceleration limit 2: .*at least 1e-06"),
        ("acceleration", [-1.0, 1.0], "joint 0: velocity limit 1, acceleration limit -1: both must be > 0"),
        ("lower", "low", "lower is not a vector of numbers"),
    ],
)
def test_a_bad_limit_is_named_with_its_joint(field: str, values: object, says: str) -> None:
    good = {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "velocity": [1.0, 1.0], "acceleration": [2.0, 2.0]}
    with pytest.raises(InvalidInputError, match=f"^JointLimits: {says}"):
        JointLimits(**{**good, field: values})  # type: ignore[arg-type]


def test_limits_of_no_joint_are_none() -> None:
    with pytest.raises(InvalidInputError, match="One number per joint"):
        JointLimits(*np.zeros((4, 0)))
