"""The common error: which arm's view of the object counts how much, on every axis."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coopqp import CommonError, InvalidInputError
from coopqp.errors import UnknownNameError
from coopqp.scenarios import Scenario


def test_the_leader_alone_defines_the_pose(paper: Scenario) -> None:
    for k, name in enumerate(paper.cell.arm_names):
        expected = np.outer(np.arange(3) == k, np.ones(6))
        np.testing.assert_array_equal(CommonError.leader(name).shares(paper.cell), expected)
        np.testing.assert_array_equal(CommonError.leader(k).shares(paper.cell), expected)
    np.testing.assert_array_equal(CommonError.leader().shares(paper.cell)[0], 1.0)


def test_without_a_leader_all_arms_count_alike(paper: Scenario) -> None:
    np.testing.assert_array_equal(CommonError.leaderless().shares(paper.cell), np.full((3, 6), 1.0 / 3.0))


def test_the_leader_positions_and_the_driver_turns(paper: Scenario) -> None:
    shares = CommonError.driver(leader=2, driver=paper.cell.arm_names[1]).shares(paper.cell)
    np.testing.assert_array_equal(shares, [[0] * 6, [0, 0, 0, 1, 1, 1], [1, 1, 1, 0, 0, 0]])


def test_any_weights_that_sum_to_one_are_taken(paper: Scenario, rng: np.random.Generator) -> None:
    W = rng.uniform(size=(3, 6))
    W[1] = 0.0
    W /= W.sum(axis=0)
    np.testing.assert_array_equal(CommonError.per_axis(W).shares(paper.cell), W)
    W[0, 5] += 0.9e-9
    CommonError.per_axis(W).shares(paper.cell)


@pytest.mark.parametrize(
    "weights",
    [
        np.full((2, 6), 0.5),
        np.full((3, 5), 1.0 / 3.0),
        np.full((3, 6), 0.5),
        np.full((3, 6), 1.0 / 3.0) + 1e-9,
        np.full((3, 6), np.nan),
        np.array([[1.5] * 6, [-0.5] * 6, [0.0] * 6]),
        np.outer([1.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0, 1.0, 0.5]),
        None,
        "equal",
        [[1.0], [0.0, 0.0]],
    ],
)
def test_what_are_no_weights(paper: Scenario, weights: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"CommonError\.per_axis: .*Give .*\(3, 6\)"):
        CommonError.per_axis(weights).shares(paper.cell)


def test_unknown_arms_are_named(paper: Scenario) -> None:
    for rule in (CommonError.leader("boss"), CommonError.driver(leader=0, driver="boss")):
        with pytest.raises(UnknownNameError, match="no arm named 'boss'"):
            rule.shares(paper.cell)


def test_arms_that_do_not_hold_have_no_share_and_the_others_all_of_it(paper: Scenario) -> None:
    W = np.array([[0.2, 0.5, 1.0, 0.0, 0.0, 0.0], [0.3, 0.5, 0.0, 1.0, 0.4, 0.0], [0.5, 0.0, 0.0, 0.0, 0.6, 1.0]])
    rule = CommonError.per_axis(W)
    np.testing.assert_array_equal(rule.shares_of(paper.cell, [True, True, True]), W)
    expected = [[0.4, 0.5, 1.0, 0.0, 0.0, 0.5], [0.6, 0.5, 0.0, 1.0, 1.0, 0.5], [0.0] * 6]
    np.testing.assert_allclose(rule.shares_of(paper.cell, [True, True, False]), expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rule.shares_of(paper.cell, [False, False, True]), np.outer([0, 0, 1], np.ones(6)))
    np.testing.assert_array_equal(rule.shares_of(paper.cell, [False] * 3), np.zeros((3, 6)))
    np.testing.assert_array_equal(rule.shares(paper.cell), W)  # what was given is as it was
