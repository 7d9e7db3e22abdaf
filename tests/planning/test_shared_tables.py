"""Ways of shared joints through tables of scores, against all ways that there are."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torsos import robot_of

from coopqp import RobotCell
from coopqp.model.batch import ArmKinematics
from coopqp.planning.on_shared import group_joints
from coopqp.planning.shared_way import SharedWay, _grid, _scores, _Search
from coopqp.scenarios import dual_arm7, mixed_cell
from coopqp.spatial import Array

#: Positions of one joint [m], its speed limit [m/s], and the samples of two segments and their clocks [s].
GRID = np.array([[0.0], [0.3], [0.6], [1.0]])
SPEED = 0.4
PLACES = np.array([0.0, 0.5, 1.0, 1.25, 2.0])
DURATION = np.array([0.5, 0.9, 0.2, 1.1])
NEIGHBOURS = [[1], [0, 2], [1, 3], [2]]
GOOD, FAIR = 0.1, 0.02


def search(at_start: float | None = None, speed: float = SPEED) -> _Search:
    first = None if at_start is None else np.array([at_start])
    return _Search(PLACES, DURATION, GRID, NEIGHBOURS, np.array([speed]), first)


def table(seed: int, low: float = -0.3) -> Array:
    return np.random.default_rng(seed).uniform(low, 1.0, (len(PLACES), len(GRID)))


def too_short(way: Sequence[int], spans: Array, peak: float) -> float:
    """Time that the joint needs beyond that of the path [s]; a way that moves less counts as a little quicker."""
    steps = np.array([abs(GRID[b, 0] - GRID[a, 0]) / SPEED for a, b in itertools.pairwise(way)])
    return float((np.maximum(peak * steps - spans, 0.0) + 1e-6 * steps).sum())


def the_best(found: list[tuple[float, float, Any]]) -> tuple[float, float] | None:
    """Time and score of the best of ways (time, score, way): the least time, and of nearly equal ones the score."""
    for wanted in (GOOD, FAIR):
        good = [(time, score) for time, score, _ in found if score >= wanted]
        if good:
            least = min(time for time, _ in good)
            return least, max(score for time, score in good if time <= 1.01 * least)
    return None


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("at_start", [None, 0.3])
def test_from_sample_to_sample_no_way_is_quicker_or_better(seed: int, at_start: float | None) -> None:
    S = table(seed)
    every = []
    for way in itertools.product(range(4), repeat=5):
        if (at_start is not None and way[0] != 1) or any(abs(a - b) > 1 for a, b in itertools.pairwise(way)):
            continue
        every.append((too_short(way, DURATION, 1.0), min(S[k, h] for k, h in enumerate(way)), way))
    expected, found = the_best(every), search(at_start).by_sample(S)
    assert (found is None) == (expected is None)
    if found is None or expected is None:
        return
    time, score, places, which = found
    np.testing.assert_array_equal(places, PLACES)
    assert score == pytest.approx(min(S[k, h] for k, h in enumerate(which)))
    assert time == pytest.approx(too_short(which.tolist(), DURATION, 1.0), abs=1e-9)
    assert time <= 1.01 * expected[0] + 1e-8
    assert score >= expected[1] - 1e-12
    assert at_start is None or which[0] == 1


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("at_start", [None, 0.3])
def test_along_segments_no_way_is_quicker_or_better(seed: int, at_start: float | None) -> None:
    """Joints move linearly over each segment, by the peak of a quintic law; a score is that of the nearest point."""
    S, marks = table(seed), [0, 2, 4]
    spans = np.array([DURATION[:2].sum(), DURATION[2:].sum()])

    def score_of(way: Sequence[int]) -> float:
        scores = []
        for (a, b), first, last in zip(itertools.pairwise(way), marks, marks[1:], strict=False):
            for k in range(first, last + 1):
                share = (PLACES[k] - PLACES[first]) / (PLACES[last] - PLACES[first])
                at = (1.0 - share) * GRID[a, 0] + share * GRID[b, 0]
                scores.append(S[k, int(np.abs(GRID[:, 0] - at).argmin())])
        return min(scores)

    starts = range(4) if at_start is None else [1]
    ways = [way for way in itertools.product(range(4), repeat=3) if way[0] in starts]
    expected = the_best([(too_short(way, spans, 1.875), score_of(way), way) for way in ways])
    found = search(at_start).by_segment(S)
    assert (found is None) == (expected is None)
    if found is None or expected is None:
        return
    time, score, places, which = found
    np.testing.assert_array_equal(places, [0.0, 1.0, 2.0])
    assert score == pytest.approx(score_of(which.tolist()))
    assert time == pytest.approx(too_short(which.tolist(), spans, 1.875), abs=1e-9)
    assert time <= 1.01 * expected[0] + 1e-8
    assert score >= expected[1] - 1e-12


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("at_start", [None, 0.6])
def test_where_they_stand_the_least_score_is_largest(seed: int, at_start: float | None) -> None:
    S = table(seed, low=0.0)
    rows = range(4) if at_start is None else [2]
    best = max(rows, key=lambda h: S[:, h].min())
    found = search(at_start).constant(S)
    if S[:, best].min() < GOOD:
        assert found is None
        return
    assert found is not None
    assert found[:2] == (0.0, S[:, best].min())
    np.testing.assert_array_equal(found[2], [0.0, 2.0])
    np.testing.assert_array_equal(found[3], [best, best])


def test_a_score_of_just_enough_is_enough() -> None:
    S = np.full((5, 4), -1.0)
    S[:, 2] = GOOD
    found = search().constant(S)
    assert found is not None
    assert found[1] == GOOD
    S[:, 2] = GOOD - 1e-9
    assert search().constant(S) is None
    assert search().by_sample(S) is not None
    S[3, 2] = FAIR - 1e-9
    assert search().by_sample(S) is None
    assert search().by_segment(S) is None


def test_where_no_way_is_good_they_stand_where_the_arms_get_furthest() -> None:
    S = np.full((5, 4), 0.5)
    S[2, 0] = S[4, 1] = S[1, 2] = S[0, 3] = -0.1
    time, score, places, which = search().as_far(S) or (0.0, 0.0, None, None)
    assert (time, score) == (1.0, -np.inf)  # one sample is missing
    np.testing.assert_array_equal(places, [0.0, 2.0])
    np.testing.assert_array_equal(which, [1, 1])
    assert (search(0.0).as_far(S) or (0.0,))[0] == 3.0
    assert search(1.0).as_far(S) is None  # not even at the start
    S[4, 1] = 0.0
    assert (search().as_far(S) or (9.0,))[0] == 0.0


def test_one_sample_is_no_way_to_move() -> None:
    one = _Search(np.zeros(1), np.zeros(0), GRID, NEIGHBOURS, np.array([SPEED]), None)
    S = np.array([[0.2, 0.4, 0.3, 0.1]])
    assert one.by_sample(S) is None
    assert one.by_segment(S) is None
    for found in (one.constant(S), one.as_far(S)):
        assert found is not None
        np.testing.assert_array_equal(found[2], [0.0])
        assert len(found[3]) == 1


def test_a_joint_without_a_speed_limit_crosses_its_range_in_a_second() -> None:
    S = np.full((5, 4), -1.0)
    S[:2, 0], S[2:, 3] = 0.5, 0.5
    S[1, :], S[2, :] = 0.5, 0.5
    found = search(speed=np.inf).by_segment(S)
    assert found is not None
    assert found[3].tolist() == [0, 3, 3]
    assert found[0] == pytest.approx(1.875 * 1.0 - 1.4, abs=1e-4)


def test_a_shared_way_is_linear_between_its_places() -> None:
    way = SharedWay((0, 1), np.array([0, 1]), np.array([0.0, 1.0, 3.0]), np.array([[0.0, 5.0], [1.0, 5.0], [0.0, 5.0]]))
    np.testing.assert_allclose(way.at(np.array([0.5, 2.0, 9.0])), [[0.5, 5.0], [0.5, 5.0], [0.0, 5.0]])
    assert not way.stands
    assert SharedWay((0,), np.array([0]), np.array([0.0, 1.0]), np.ones((2, 1))).stands


# -- the grid and the scores in it -------------------------------------------------------------------------------------

TORSOS = pytest.mark.parametrize(
    ("torso", "numbers", "ends"),
    [
        ((("revolute", "0 0 1"),), (13,), (2.9,)),
        ((("continuous", "0 0 1"),), (13,), (np.pi,)),
        ((("prismatic", "0 0 1"), ("continuous", "0 0 1")), (7, 7), (2.9, np.pi)),
        ((("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("revolute", "0 0 1")), (4, 4, 4), (2.9, 2.9, 2.9)),
    ],
)


@TORSOS
def test_a_grid_covers_the_range_of_each_joint_all_but_its_ends(
    torso: Any, numbers: Any, ends: Any, tmp_path: Path
) -> None:
    cell = RobotCell([robot_of(torso, tmp_path)])
    joints = group_joints(cell, cell.groups[0])
    assert len(joints) == len(torso)
    grid, neighbours = _grid(cell, joints, None)
    assert grid.shape == (np.prod(numbers), len(numbers))
    for own, number, end in zip(grid.T, numbers, ends, strict=True):
        axis = np.linspace(-end, end, number)
        axis[0], axis[-1] = -0.96 * end, 0.96 * end  # 2 % of the range inside
        np.testing.assert_allclose(np.unique(own), axis, atol=1e-12)
    index = np.column_stack([np.unique(own, return_inverse=True)[1] for own in grid.T])
    for i, near in enumerate(neighbours):
        away = np.abs(index - index[i]).sum(axis=1)
        assert sorted(near) == np.flatnonzero(away == 1).tolist()
    start = np.full(len(joints), 0.123)
    given, _ = _grid(cell, joints, start)
    assert given.shape[0] == np.prod([n + 1 for n in numbers])
    assert (given == start).all(axis=1).sum() == 1


def test_a_score_is_the_smaller_of_margin_and_singular_value_by_what_is_good() -> None:
    """A third of half a range, of no more than half a turn, is a good margin, and 0.2 a good σ_min."""
    for arm in (dual_arm7().cell.arms[0], mixed_cell().cell.arms[2]):
        kinematics = ArmKinematics(arm)
        rng = np.random.default_rng(4)
        low, high = np.maximum(kinematics.lower, -2.0), np.minimum(kinematics.upper, 2.0)
        q = rng.uniform(low, high, (3, 5, kinematics.n))
        q[1, 2] = np.nan
        found = _scores(kinematics, q)
        assert found[1, 2] == -np.inf
        for h, k in itertools.product(range(3), range(5)):
            if (h, k) == (1, 2):
                continue
            x = q[h, k]
            shares = [
                min(x[j] - kinematics.lower[j], kinematics.upper[j] - x[j])
                / min(0.5 * (kinematics.upper[j] - kinematics.lower[j]), np.pi)
                for j in np.flatnonzero(kinematics.bounded)
            ]
            sigma = np.linalg.svd(kinematics.jacobians(x[None])[0], compute_uv=False)[5]
            assert found[h, k] == pytest.approx(min(3.0 * min(shares), sigma / 0.2))
