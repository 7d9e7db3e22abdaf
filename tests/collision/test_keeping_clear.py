"""What keeps bodies apart, piece by piece: bounds for bodies that move, pushes of the object, and evasion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from coopqp.core._core import BRAKING_SHARE, EVADES_EARLY

from coopqp import Clearance, CollisionScene, check_path
from coopqp.collision import Body, Box, Sphere
from coopqp.collision.distances import Distances, Gradient, LowerBounds
from coopqp.collision.evasion import EvadingSlopes, Evasion
from coopqp.collision.moving_bodies import MovingBodies
from coopqp.constraints.velocity import LabelledRows
from coopqp.model import CellState, LimitKind
from coopqp.paths.joint_trajectories import ArmTrajectory, HeldTrajectory
from coopqp.paths.segments import segments_of
from coopqp.planning import ClearanceCheck, PathVerdict
from coopqp.scenarios import Scenario, dual_arm7, elbow_and_knob, paper_lift
from coopqp.spatial import Array, as_placement

DT, STOPPING, XI = 0.004, 0.4, 5.0


def with_cart(scenario: Scenario) -> CollisionScene:
    cart = Body("cart", Sphere(0.1), pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])))
    return CollisionScene.of(scenario, margin=0.02, moving=[cart])


# -- bodies that move --------------------------------------------------------------------------------------------------


def lower_bounds(
    scene: CollisionScene, v: Array, twist: Array, clearances: Array, *, give_way: bool = False
) -> tuple[Array, Array, Array]:
    """Lower bounds of ḋ of some pairs with the cart, with their gradients and the speeds at which it closes in."""
    moving = MovingBodies(scene.built, approach=XI, give_way=give_way, stopping=STOPPING)
    rng, near = np.random.default_rng(4), moving.pairs[: len(clearances)]
    normals = rng.normal(size=(len(near), 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    gradient = Gradient(rng.normal(size=(len(near), scene.cell.nv)), normals, rng.normal(size=(len(near), 3)))
    place = pin.SE3(np.eye(3), np.array([0.3, 0.2, 0.1]))
    assert moving.tell("cart", place, twist, "") == scene.built.moving[0]
    x = scene.cell.positions(paper_lift().q_start)
    moving.follow(x, DT)
    moving.follow(x + DT * v, DT)
    lower = np.zeros(len(near))
    moving.bound(near, clearances, gradient, lower, DT)
    velocity = twist[:3] + np.cross(twist[3:], gradient.points - place.translation)
    return lower, gradient.rows, -(normals * velocity).sum(axis=1)


@pytest.mark.parametrize("acceleration", [np.inf, 2.0, 20.0])
@pytest.mark.parametrize("seed", range(4))
def test_arms_come_closer_to_a_body_as_fast_as_they_can_still_stop(seed: int, acceleration: float) -> None:
    lift, rng = paper_lift(), np.random.default_rng(seed)
    scene = with_cart(replace(lift, cell=lift.cell.with_limits(acceleration=acceleration)))
    v, twist = rng.uniform(-0.4, 0.4, lift.cell.nv), rng.uniform(-0.3, 0.3, 6)
    clearances = rng.uniform(-0.02, 0.5, 12)
    lower, G, closing = lower_bounds(scene, v, twist, clearances)
    slowest = np.abs(v).max() / acceleration  # time in which all joints rest
    for bound, g, u, c in zip(lower, G, np.maximum(closing, 0.0), clearances, strict=True):

        def allowed(s: float, g: Array = g, u: float = u, c: float = c) -> bool:
            in_time = s * (DT + 0.5 * STOPPING) + u * (DT + STOPPING) <= c
            if not slowest > 0.0:
                return in_time
            now = max(-float(g @ v), 0.0)
            a = now * BRAKING_SHARE / slowest
            braked = s <= now - a * DT + 1e-12
            return in_time or (braked and s**2 + 2.0 * u * s + 2.0 * a * (s + u) * DT <= 2.0 * a * c)

        s = -bound
        assert s >= 0.0
        assert s == 0.0 or allowed(s - 1e-7)
        assert not allowed(s + 1e-7)


def test_where_arms_give_way_they_retreat_with_the_body_up_to_half_a_metre_per_second() -> None:
    scene, twist = with_cart(paper_lift()), np.array([0.4, -0.7, 0.5, 0.3, 0.1, -0.2])
    clearances = np.linspace(-0.1, 0.3, 12)
    lower, _, closing = lower_bounds(scene, np.zeros(scene.cell.nv), twist, clearances, give_way=True)
    np.testing.assert_allclose(lower, np.minimum(closing - XI * clearances, 0.5))
    assert (lower == 0.5).any()
    assert (lower < 0.5).any()


def test_arms_that_were_put_elsewhere_stood_still() -> None:
    """A jump of the joints is no speed: the bounds are those of arms at rest."""
    lift = paper_lift()
    scene = with_cart(replace(lift, cell=lift.cell.with_limits(acceleration=2.0)))
    middle = (lift.path.pose(0.0) * lift.T_object_body).translation
    clearance = Clearance(scene, give_way=False)

    def rows(*before: Array) -> LabelledRows:
        for q in before:
            clearance.check(q)
            clearance.move("cart", pin.SE3(np.eye(3), middle + np.array([0.0, 0.0, 0.25])), (0, 0, -0.1, 0, 0, 0))
            found = clearance.rows_by_label(q, DT, blind=True)
        return found

    other = lift.cell.moved(lift.q_start, np.full(lift.cell.nv, 0.02))
    fresh, jumped = rows(lift.q_start), rows(other, lift.q_start)
    np.testing.assert_array_equal(fresh.which, jumped.which)
    np.testing.assert_allclose(fresh.lower, jumped.lower, atol=1e-12)


def test_joints_that_give_way_take_their_time_and_are_named() -> None:
    scene = with_cart(paper_lift())
    cell, clearance = scene.cell, Clearance(scene, give_way=True, stopping=STOPPING)
    moving = MovingBodies(scene.built, approach=XI, give_way=True, stopping=STOPPING)
    v, x = np.linspace(-0.2, 0.3, cell.nv), cell.positions(paper_lift().q_start)
    moving.follow(x, DT)
    moving.follow(x + DT * v, DT)
    G, pair = np.ones((1, cell.nv)), moving.pairs[:1]
    jump = cell.limits.velocity / STOPPING * DT
    slowest = float(v.sum() - jump.sum())
    kept = LabelledRows(G, np.array([slowest - 1e-9]), np.array([np.inf]), pair)
    assert moving.smooth(kept, DT) is kept  # they retreat fast enough without a jump
    found = moving.smooth(kept._replace(lower=np.array([slowest + 1e-9])), DT)
    np.testing.assert_allclose(found.G[1:], np.eye(cell.nv))
    np.testing.assert_allclose(found.lower[1:], v - jump)
    np.testing.assert_allclose(found.upper[1:], v + jump)
    named = [clearance.labels[k] for k in found.which[1:]]
    assert [f"{limit.arm}/{limit.joint}" for limit in named] == list(cell.joint_names)
    assert {limit.kind for limit in named} == {LimitKind.ACCELERATION}
    assert clearance.labels[found.which[0]].between == scene.built.labels[pair[0]]
    still = int(np.flatnonzero(~moving.moves)[0])
    assert moving.smooth(kept._replace(lower=np.array([9.0]), which=np.array([still])), DT).which.tolist() == [still]


def test_a_body_is_late_after_its_patience_and_no_more_once_it_is_told() -> None:
    moving = MovingBodies(with_cart(paper_lift()).built, approach=XI, give_way=False, stopping=STOPPING)
    late = [moving.grow_old(0.01, 0.03) for _ in range(6)]
    assert late == ["", "", "", "", "cart", "cart"]
    moving.tell("cart", pin.SE3.Identity(), np.zeros(6), "")
    assert moving.grow_old(0.01, 0.03) == ""


# -- pushes of the object ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("height", [0.03, 0.0, -0.02])
def test_an_object_is_pushed_off_a_body_just_as_far_as_is_required(height: float, first: bool) -> None:
    task = paper_lift()
    T = task.path.pose(0.0)
    box = T * task.T_object_body
    top = 0.5 * task.object_size[2]
    post = Body("post", Sphere(0.1), box * pin.SE3(np.eye(3), np.array([0.1, 0.05, top + 0.1 + height])))
    bodies = {"on_links": {}, "carried": [Body("object", Box(task.object_size), task.T_object_body)]}
    scene = CollisionScene.of(task, obstacles=[post], ignored=[(a, "*") for a in task.cell.arm_names], **bodies)
    k = scene.built.labels.index(("object", "post"))
    required = np.zeros(len(scene.built.labels))
    required[k] = 0.04
    along = np.array([1.0, 0.0, 0.0]) if first else np.array([0.0, 1.0, 0.0])
    pushed = scene.pushed(T, along, required)
    assert pushed is not None
    centre = (pushed * task.T_object_body).actInv(as_placement(post.placement, "post").translation)
    outside = np.maximum(np.abs(centre) - 0.5 * np.array(task.object_size), 0.0)
    assert 0.04 <= np.linalg.norm(outside) - 0.1 <= 0.0415
    assert abs(along @ (pushed.translation - T.translation)) < 1e-9
    again = scene.pushed(pushed, along, required)
    assert again is not None
    np.testing.assert_array_equal(again.homogeneous, pushed.homogeneous)
    required[k] = 3.0  # twelve pushes of 0.1 m do not get there
    assert scene.pushed(T, along, required) is None


def test_an_object_is_not_pushed_off_a_body_that_stands_in_its_line() -> None:
    """A ball before a ball at the object's origin: no push across the line, and no turn, leads away."""
    task = paper_lift()
    T = task.path.pose(0.0)
    balls = {"on_links": {}, "carried": [Body("ball", Sphere(0.1))]}
    post = Body("post", Sphere(0.1), pin.SE3(np.eye(3), T.translation + np.array([0.21, 0.0, 0.0])))
    scene = CollisionScene.of(task, obstacles=[post], ignored=[(a, "*") for a in task.cell.arm_names], **balls)
    required = np.full(len(scene.built.labels), 0.05)
    assert scene.pushed(T, np.array([1.0, 0.0, 0.0]), required) is None
    aside = scene.pushed(T, np.array([0.0, 0.0, 1.0]), required)
    assert aside is not None
    assert aside.translation[0] < T.translation[0] - 0.03


# -- evasion -----------------------------------------------------------------------------------------------------------


def test_only_arms_with_more_than_six_joints_evade_and_only_for_comfort() -> None:
    lift, dual = CollisionScene.of(paper_lift()).built, CollisionScene.of(elbow_and_knob()).built

    def begins(built: Any, comfort: float) -> float:
        found = EvadingSlopes(built, LowerBounds(built, Distances(built)), approach=XI, comfort=comfort)
        assert bool(found) == (found.begins > 0.0)
        return found.begins

    assert not Evasion(lift.cell)
    assert Evasion(dual.cell)
    assert begins(lift, 0.03) == begins(dual, 0.0) == begins(lift, 0.0) == 0.0
    assert begins(dual, 0.03) == pytest.approx(0.03 + EVADES_EARLY)


def test_the_basis_of_a_self_motion_moves_no_tool_and_counts_joints_by_their_speed() -> None:
    task, rng = dual_arm7(), np.random.default_rng(2)
    speed = rng.uniform(0.5, 3.0, task.cell.nv)
    cell = task.cell.with_limits(velocity=speed)
    N = Evasion(cell).basis(task.q_start)
    assert N.shape == (cell.nv, 2)
    state = CellState(cell, task.q_start)
    for k, own in enumerate(cell.v_slices):
        assert np.abs(state.jacobian(k) @ N[own]).max() < 1e-9
    scaled = N / speed[:, None]
    np.testing.assert_allclose(scaled.T @ scaled, np.eye(2), atol=1e-12)
    speed[::2] = np.inf  # counts as 1
    scaled = (
        Evasion(task.cell.with_limits(velocity=speed)).basis(task.q_start) / np.where(speed < 9.0, speed, 1.0)[:, None]
    )
    np.testing.assert_allclose(scaled.T @ scaled, np.eye(2), atol=1e-12)


def test_evading_slopes_do_not_depend_on_what_was_asked_before() -> None:
    task = elbow_and_knob()
    scene = CollisionScene.of(task, margin=0.02)
    built, rng = scene.built, np.random.default_rng(0)
    places = [task.cell.moved(task.q_start, rng.uniform(-0.25, 0.25, task.cell.nv)) for _ in range(12)]
    slopes = rng.normal(size=(12, task.cell.nv))

    def slopes_at(order: list[int], *, anew: bool) -> dict[int, Array]:
        found, evading = {}, None
        for i in order:
            if evading is None or anew:
                evading = EvadingSlopes(built, LowerBounds(built, Distances(built)), approach=XI, comfort=0.03)
            found[i] = evading.at(places[i], slopes[i])
        return found

    fresh = slopes_at(list(range(12)), anew=True)
    once, back = slopes_at(list(range(12)), anew=False), slopes_at(list(range(11, -1, -1)), anew=False)
    assert any((fresh[i] != slopes[i]).any() for i in fresh)  # some evade
    for i, slope in fresh.items():
        np.testing.assert_allclose(once[i], slope, atol=1e-9)
        np.testing.assert_allclose(back[i], slope, atol=1e-9)


# -- the check before the motion -----------------------------------------------------------------------------------


def test_a_scene_without_pairs_is_clear_and_says_so() -> None:
    task = paper_lift()
    scene = CollisionScene.of(task, ignored=[("*", "*")])
    found = check_path(task.cell, task.grasp, task.path, q_start=task.q_start, scene=scene).clearance
    assert found is not None
    assert found.verdict is PathVerdict.CERTIFIED
    assert found.pair is None
    assert found.stop is None
    assert found.proved == np.inf
    assert found.undecided.shape == (0, 2)
    assert len(found.clocks) == len(found.distances) == 0
    assert found.why == ""
    assert Clearance(scene).nearest(task.q_start) is None
    assert scene.distances(task.q_start) == ()


@pytest.fixture(scope="module")
def straight() -> tuple[Scenario, list[ArmTrajectory]]:
    """A lift along a straight line, and the ways of its arms."""
    task = paper_lift()
    found = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    return task, [arm.chosen.trajectory for arm in found.arms if arm.chosen is not None]


def passed(
    task: Scenario, ways: list[ArmTrajectory], share: float, margin: float, **changes: Any
) -> tuple[ClearanceCheck, float]:
    """A ball that is carried past another, which is 20 mm off; and the clock when it is nearest."""
    first, last = (task.path.pose(t).translation for t in (0.0, task.path.duration))
    side = np.cross(last - first, [1.0, 0.0, 0.0])
    nearest = first + share * (last - first)
    bob = Body("bob", Sphere(0.05))
    ball = Body("ball", Sphere(0.05), pin.SE3(np.eye(3), nearest + 0.12 * side / np.linalg.norm(side)))
    arms = [(arm, "*") for arm in task.cell.arm_names]
    scene = CollisionScene.of(task, carried=[bob], obstacles=[ball], margin=margin, ignored=arms, **changes)
    way = HeldTrajectory(task.cell, task.path, segments_of(task.path), ways, task.cell.positions(task.q_start))
    clocks = np.linspace(0.0, task.path.duration, 2001)
    at = np.argmin([np.linalg.norm(task.path.pose(float(t)).translation - nearest) for t in clocks])
    return scene.along(way), float(clocks[at])


@pytest.mark.parametrize("share", [0.137, 0.302, 0.437, 0.561, 0.713])
def test_what_is_proved_is_no_more_than_the_least_distance(
    share: float, straight: tuple[Scenario, list[ArmTrajectory]]
) -> None:
    found, clock = passed(*straight, share, 0.0)
    assert found.verdict is PathVerdict.CERTIFIED
    assert found.pair is not None
    assert {found.pair.first, found.pair.second} == {"ball", "bob"}
    assert 0.95 * found.pair.distance - 2e-4 <= found.proved <= 0.02 + 1e-9 <= found.pair.distance + 2e-9
    assert found.pair.distance == pytest.approx(0.02, rel=0.06)
    assert found.clock == pytest.approx(clock, abs=0.3)
    assert found.why == ""
    assert found.stop is None
    assert (np.diff(found.clocks) >= 0.0).all()
    assert found.distances.min() >= found.pair.distance - 1e-12


def test_a_margin_that_is_touched_is_not_decided_there_nor_beyond_the_end_of_a_way(
    straight: tuple[Scenario, list[ArmTrajectory]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("coopqp.collision.path_check._SHORTEST", 1e-4)  # it gives up sooner
    task, ways = straight
    half = len(ways[1].q) // 2
    short = replace(ways[1], places=ways[1].places[: half + 1], q=ways[1].q[: half + 1], rates=ways[1].rates[:half])
    ended, clock = passed(task, [ways[0], short, *ways[2:]], 0.2, 0.02 + 0.9e-6)
    assert ended.verdict is PathVerdict.UNDECIDED
    assert ended.proved == -np.inf
    assert len(ended.undecided) == 2
    low, high = ended.undecided[0]
    assert low - 2e-3 <= clock <= high + 2e-3
    assert high - low < 0.2
    said = f"it is not decided on {low:.4g}–{high:.4g} s whether "
    assert ended.why.startswith(said)
    assert {"ball", "bob"} <= set(ended.why.removeprefix(said).split())
    assert "keep their margin of 20 mm" in ended.why
    end = ended.undecided[1, 0]
    assert ended.undecided[1, 1] == task.path.duration
    assert ended.why.endswith(f"; from {end:.4g} s on nothing is judged, since the way of an arm ends there")
    alone, _ = passed(task, [ways[0], short, *ways[2:]], 0.2, 0.0)
    assert alone.why == ended.why.partition("; ")[2]
    np.testing.assert_allclose(alone.undecided, [[end, task.path.duration]])


def test_where_the_motion_of_an_arm_has_no_bound_its_distances_are_sampled(
    straight: tuple[Scenario, list[ArmTrajectory]],
) -> None:
    task, ways = straight
    blind = [replace(ways[0], rates=np.full_like(ways[0].rates, np.inf)), *ways[1:]]
    carried, _ = passed(task, blind, 0.437, 0.0)
    assert carried.verdict is PathVerdict.CERTIFIED  # the object's pose alone decides
    scene = CollisionScene.of(task, margin=0.0)
    segments, rest = segments_of(task.path), task.cell.positions(task.q_start)
    proved, sampled = (scene.along(HeldTrajectory(task.cell, task.path, segments, w, rest)) for w in (ways, blind))
    assert proved.verdict is PathVerdict.CERTIFIED
    assert sampled.verdict is PathVerdict.SAMPLED
    assert sampled.why == "Between them nothing is proved"
    assert sampled.proved == -np.inf
    assert sampled.pair is not None
    assert proved.pair is not None
    assert sampled.pair.distance == pytest.approx(proved.pair.distance, rel=0.05)
