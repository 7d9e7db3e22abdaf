"""How close bodies come in a run: compared with balls whose distances are known in closed form."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at

from coopqp import CollisionScene, Recording, RobotCell
from coopqp.model import CellState
from coopqp.model.shapes import Body, Sphere
from coopqp.simulation import Closeness
from coopqp.simulation.evaluation.closeness import PARTS, with_clearance
from coopqp.spatial import Array

BALL = 0.05
RADII = {"near": 0.04, "far": 0.1}


@pytest.fixture(scope="module")
def cell(make_cell: Callable[..., RobotCell]) -> RobotCell:
    return make_cell(["arm7"])


@pytest.fixture
def curve(cell: RobotCell, rng: np.random.Generator) -> Callable[[int], Array]:
    """``curve(T)``: a curve of all joints with steps of up to a tenth of a radian (T, nq)."""

    def draw(samples: int) -> Array:
        t = 0.03 * np.arange(samples)[:, None]
        start, *waves = rng.uniform(-0.8, 0.8, (4, cell.nv))
        return np.array(
            [cell.configuration(x) for x in start + sum(w * np.sin((k + 1) * t) for k, w in enumerate(waves))]
        )

    return draw


def ball_at(cell: RobotCell, q: Array, *beside: float) -> Array:
    """Centre of the ball, at the tool's origin; or a place beside it."""
    place: Array = CellState(cell, q).T_world_tool[0].translation
    return place + np.array(beside or [0.0, 0.0, 0.0])


def scene_with(cell: RobotCell, q: Array, posts: dict[str, Array], **more: Any) -> CollisionScene:
    """A ball at the tool, and balls in the world."""
    obstacles = [Body(name, Sphere(RADII[name]), pin.SE3(np.eye(3), at)) for name, at in posts.items()]
    more = {"margin": 0.0, **more}
    balls = [Body("ball", Sphere(BALL))]
    return CollisionScene(cell=cell, grasp=grasp_at(cell, q), carried=balls, obstacles=obstacles, **more)


def gaps(cell: RobotCell, q: Array, posts: dict[str, Array]) -> dict[str, Array]:
    """Distances of the ball from each post at configurations [m]: centres less radii."""
    centres = np.array([ball_at(cell, row) for row in q])
    return {name: np.linalg.norm(centres - at, axis=1) - BALL - RADII[name] for name, at in posts.items()}


def finer(cell: RobotCell, q: Array) -> Array:
    """The configurations of a run with its quarters of steps between them."""
    rows = [q[0]]
    for a, b in itertools.pairwise(q):
        way = pin.difference(cell.model, a, b)
        rows += [pin.integrate(cell.model, a, (k + 1) / PARTS * way) for k in range(PARTS)]
    return np.array(rows)


def passed(cell: RobotCell, q: Array, posts: Sequence[tuple[str, int, float]]) -> dict[str, Array]:
    """Posts across the way of the ball at some samples, at a distance; behind it for a negative one."""
    found = {}
    for name, k, away in posts:
        across = np.cross(ball_at(cell, q[k + 1]) - ball_at(cell, q[k - 1]), [0.1, 0.2, 1.0])
        reach = away + np.copysign(BALL + RADII[name], away)
        found[name] = ball_at(cell, q[k]) + reach * across / np.linalg.norm(across)
    return found


def beside(cell: RobotCell, q: Array, away: float, name: str, rng: np.random.Generator) -> Array:
    """A place for a post at a distance from the ball at a configuration."""
    way = rng.normal(size=3)
    return ball_at(cell, q) + way / np.linalg.norm(way) * (away + BALL + RADII[name])


def test_the_least_distance_is_that_of_all_parts_of_all_steps(
    cell: RobotCell, curve: Callable[[int], Array], rng: np.random.Generator
) -> None:
    """Also between samples, with its time and its pair; distances of bodies that stay apart need no computation."""
    for samples in (2, 3, 6, 40) * 6:
        q = curve(samples)
        fine = finer(cell, q)
        middle = fine[int(rng.integers(len(fine)))]
        posts = {name: beside(cell, middle, rng.uniform(-0.02, 0.1), name, rng) for name in RADII}
        time = np.cumsum(rng.uniform(0.01, 0.1, samples))
        found = Closeness(scene_with(cell, q[0], posts)).closest(q, time)
        apart = gaps(cell, fine, posts)
        name = min(apart, key=lambda n: apart[n].min())
        assert found is not None
        assert found.pair.distance == pytest.approx(apart[name].min(), abs=2e-6)
        assert {found.pair.first, found.pair.second} == {"ball", name}
        at = np.interp(np.arange(len(fine)) / PARTS, np.arange(samples), time)
        there = apart[name][np.abs(at - found.time).argmin()]
        assert there == pytest.approx(found.pair.distance, abs=1e-9)
        assert found.margin == 0.0
        assert str(found).endswith(f" at {found.time:.3g} s")


def test_a_margin_counts_where_it_is_asked_for(cell: RobotCell, curve: Callable[[int], Array]) -> None:
    """One post is nearer, and the other is deeper inside its margin."""
    q = curve(20)
    posts = passed(cell, q, [("near", 9, 0.03), ("far", 10, -0.06)])
    apart = {name: d.min() for name, d in gaps(cell, finer(cell, q), posts).items()}
    margins = {("ball", "near"): 0.01, ("ball", "far"): 0.2}
    judge = Closeness(scene_with(cell, q[0], posts, margins=margins))
    plain, deep = judge.closest(q, np.arange(20.0)), judge.closest(q, np.arange(20.0), to_margin=True)
    assert plain is not None
    assert deep is not None
    assert apart["near"] < apart["far"]
    assert "near" in (plain.pair.first, plain.pair.second)
    assert plain.pair.distance == pytest.approx(apart["near"], abs=2e-6)
    assert plain.margin == 0.01
    assert "far" in (deep.pair.first, deep.pair.second)
    assert deep.pair.distance == pytest.approx(apart["far"], abs=2e-6)
    assert deep.margin == 0.2


def test_pairs_that_overlap_at_the_start_may_be_left_out(cell: RobotCell, curve: Callable[[int], Array]) -> None:
    q = curve(10)
    posts = {"near": ball_at(cell, q[0], 0.01, 0.0, 0.0)}
    alone = Closeness(scene_with(cell, q[0], posts))
    assert [set(pair) for pair in alone.overlapping(q[0])] == [{"ball", "near"}]
    assert alone.closest(q, np.arange(10.0), without_start=True) is None
    inside = alone.closest(q, np.arange(10.0))
    assert inside is not None
    assert inside.pair.distance < 0.0
    posts["far"] = ball_at(cell, q[5], 0.0, 0.2 + BALL + RADII["far"], 0.0)
    other = Closeness(scene_with(cell, q[0], posts)).closest(q, np.arange(10.0), without_start=True)
    assert other is not None
    assert "far" in (other.pair.first, other.pair.second)
    nobody = Closeness(scene_with(cell, q[0], posts, ignored=[("ball", name) for name in posts]))
    assert nobody.closest(q, np.arange(10.0)) is None


def test_distances_over_time_are_the_least_of_all_pairs(cell: RobotCell, curve: Callable[[int], Array]) -> None:
    q = curve(30)
    posts = {name: ball_at(cell, q[k], 0.05, 0.05, 0.3) for name, k in (("near", 4), ("far", 22))}
    judge = Closeness(scene_with(cell, q[0], posts))
    apart = gaps(cell, q, posts)
    np.testing.assert_allclose(judge.over_time(q), np.minimum(apart["near"], apart["far"]), atol=1e-9)
    for k in judge.pairs_without(()):
        name = next(n for n in judge.names(k) if n != "ball")
        np.testing.assert_allclose(judge.over_time(q, [k]), apart[name], atol=1e-9)
        assert [judge.at(row, k) for row in q] == pytest.approx(list(apart[name]), abs=1e-9)
    assert len(judge.pairs_without([("ball", "near"), ("near", "ball")])) == 1


@pytest.mark.parametrize("parts", [1, 3])
def test_steps_in_which_a_margin_is_missed_are_found(
    cell: RobotCell, curve: Callable[[int], Array], rng: np.random.Generator, parts: int
) -> None:
    """In one call or several; a pair that may start inside its margin is only to come no closer than it was."""
    found_any = 0
    for inside in ((), [("ball", "near")]) * 6:
        q = curve(25)
        posts = {"near": beside(cell, q[0], 0.01, "near", rng), "far": beside(cell, q[12], 0.03, "far", rng)}
        judge = Closeness(scene_with(cell, q[0], posts, margin=0.04, inside=inside))
        judge.start(q[0])
        found = []
        for cut in np.array_split(np.arange(24), parts):
            rows = q[cut[0] : cut[-1] + 2]
            found += [(int(cut[0]) + t, pair, missing) for t, pair, missing in judge.watch(rows, tolerance=1e-6)]
        apart = gaps(cell, finer(cell, q), posts)
        required = {"near": min(0.04, apart["near"][0]) if inside else 0.04, "far": 0.04}
        expected = {}
        for name, d in apart.items():
            for t in range(24):
                least = d[PARTS * t + 1 : PARTS * (t + 1) + 1].min()
                if least < required[name] - 1e-6:
                    expected[t, name] = required[name] - least
        told = {(t, next(n for n in (p.first, p.second) if n != "ball")): (p, missing) for t, p, missing in found}
        assert set(told) == set(expected)
        for at, (pair, missing) in told.items():
            end = apart[at[1]][PARTS * (at[0] + 1)]
            assert missing <= expected[at] + 1e-9
            assert missing >= required[at[1]] - end - 1e-9
            assert pair.distance == pytest.approx(required[at[1]] - missing)
        found_any += len(found)
    assert found_any > 20


def run_of(cell: RobotCell, q: Array, dt: float = 0.1) -> Recording:
    n = len(q)
    return Recording(
        time=dt * np.arange(float(n)), q=q, q_command=q, velocity=np.zeros((n - 1, cell.nv)),
        clock=dt * np.arange(float(n)), rate=np.ones(n - 1), status=np.zeros(n - 1),
        reference=np.tile(np.eye(4), (n, 1, 1)), T_object_tool=np.eye(4)[None], notes=(), metadata={"who": "me"},
    )  # fmt: skip


def test_a_recording_keeps_where_bodies_came_closest(cell: RobotCell, curve: Callable[[int], Array]) -> None:
    q = curve(31)
    posts = passed(cell, q, [("near", 8, 0.03), ("far", 24, 0.06)])
    scene = scene_with(cell, q[0], posts, margin=0.01)
    apart = gaps(cell, q, posts)
    assert all(d.min() > 0.0 for d in apart.values()), "the ball passes both"
    made = with_clearance(run_of(cell, q), scene, avoided=True)
    entry = made.metadata["clearance"]
    assert made.metadata["who"] == "me"
    closest = Closeness(scene).closest(q, made.time)
    assert closest is not None
    assert entry["closest_m"] == closest.pair.distance
    assert set(entry["between"]) == {closest.pair.first, closest.pair.second}
    assert (entry["time_s"], entry["margin_m"], entry["avoided"]) == (closest.time, 0.01, True)
    assert entry["left_out"] == []
    np.testing.assert_allclose(entry["times_s"], made.time)
    np.testing.assert_allclose(entry["distances_m"], np.minimum(apart["near"], apart["far"]), atol=1e-9)
    for row, pair, points, d in zip(q, entry["pairs"], entry["points_m"], entry["distances_m"], strict=True):
        a, b = np.array(points)
        assert np.linalg.norm(a - b) == pytest.approx(d, abs=1e-7)
        first, other = (a, b) if pair[0] == "ball" else (b, a)
        assert np.linalg.norm(first - ball_at(cell, row)) == pytest.approx(BALL, abs=1e-6)
        name = next(n for n in pair if n != "ball")
        assert np.linalg.norm(other - posts[name]) == pytest.approx(RADII[name], abs=1e-6)


def test_what_touched_first_is_named_since_it_touched(cell: RobotCell, curve: Callable[[int], Array]) -> None:
    """A shallow touch comes before a deep one: the verdict names the first."""
    q = curve(61)
    posts = {"near": ball_at(cell, q[15], 0.0, 0.0, BALL + RADII["near"] - 0.01)}
    posts["far"] = ball_at(cell, q[50], 0.0, 0.0, BALL + RADII["far"] - 0.06)
    scene = scene_with(cell, q[0], posts)
    apart = gaps(cell, q, posts)
    least = np.minimum(apart["near"], apart["far"])
    first = int(np.flatnonzero(least <= 0.0)[0])
    assert first > 0
    assert (least[first + 1] <= 0.0).all()
    entry = with_clearance(run_of(cell, q), scene, avoided=True).metadata["clearance"]
    name = "near" if apart["near"][first] <= 0.0 else "far"
    assert set(entry["between"]) == {"ball", name}
    assert entry["time_s"] == pytest.approx(0.1 * first)
    assert entry["closest_m"] == pytest.approx(
        min(d.min() for d in gaps(cell, finer(cell, q), posts).values()), abs=2e-6
    )


def test_overlaps_at_the_start_are_left_out_of_an_unguarded_run(cell: RobotCell, curve: Callable[[int], Array]) -> None:
    q = curve(20)
    posts = {"near": ball_at(cell, q[0], 0.0, 0.0, 0.02)}
    run = run_of(cell, q)
    only = with_clearance(run, scene_with(cell, q[0], posts), avoided=False).metadata["clearance"]
    assert set(only) - {"notes"} == {"avoided", "left_out"}
    assert [set(pair) for pair in only["left_out"]] == [{"ball", "near"}]
    guarded = with_clearance(run, scene_with(cell, q[0], posts), avoided=True).metadata["clearance"]
    assert guarded["left_out"] == []
    assert (guarded["time_s"], set(guarded["between"])) == (0.0, {"ball", "near"})
    posts |= passed(cell, q, [("far", 12, 0.4)])
    both = with_clearance(run, scene_with(cell, q[0], posts), avoided=False).metadata["clearance"]
    assert set(both["between"]) == {"ball", "far"}
    assert all("far" in pair for pair in both["pairs"])
    assert with_clearance(run, None, avoided=False) is run
    nobody = scene_with(cell, q[0], posts, ignored=[("ball", name) for name in posts])
    assert "clearance" not in with_clearance(run, nobody, avoided=False).metadata


def test_a_scene_in_which_no_two_bodies_keep_a_distance_has_nothing_to_tell(
    cell: RobotCell, curve: Callable[[int], Array]
) -> None:
    q = curve(5)
    judge = Closeness(scene_with(cell, q[0], {"near": ball_at(cell, q[2])}, ignored=[("ball", "near")]))
    judge.start(q[0])
    assert judge.watch(q, tolerance=1e-6) == []
    assert judge.closest(q, np.arange(5.0)) is None
