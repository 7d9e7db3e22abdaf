"""A way round: it is found, clear and the same again; what is impossible is named; what is not found is not denied."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement, pairwise
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
import route_cases
import route_shelves
from marks import slow_but_first
from path_samples import samples_of

from coopqp import (
    CollisionScene,
    InvalidInputError,
    JointLimits,
    LinePath,
    QPController,
    find_path,
    inverse_kinematics,
)
from coopqp.collision import Body, Box, Capsule
from coopqp.collision.distances import Distances
from coopqp.collision.edges import STEP, columns_of, limits_with
from coopqp.model import CellState
from coopqp.model.batch import ArmKinematics
from coopqp.paths.geometry import blended
from coopqp.planning import ArmGoal, FreeTurn, PathVerdict, Route, RouteVerdict, TurnedGoal
from coopqp.planning.route.duration import estimated_duration
from coopqp.planning.route.sampling import rounded
from coopqp.planning.route.tree import Pose, distance, part_of
from coopqp.scenarios import dual_arm7

#: Poses in the trees that end a search in a test.
NODES = 600


def search(problem: route_cases.Problem, **options: Any) -> Route:
    cell, grasp, start, goal, scene, q_start = problem
    return find_path(cell, grasp, start, scene=scene, **{"goal": goal, "q_start": q_start, "nodes": NODES, **options})


@pytest.fixture(scope="module")
def posts() -> tuple[route_cases.Problem, Route]:
    problem = route_cases.posts3()
    return problem, search(problem)


def two_arms(obstacles: list[Body]) -> route_cases.Problem:
    """Two seven-joint arms carry their bar by 0.2 m to the side."""
    task = dual_arm7()
    start, goal = (pin.SE3(np.eye(3), np.array([0.0, y, 0.3])) for y in (-0.1, 0.1))
    q_start = inverse_kinematics(task.cell, task.grasp, start, task.q_start)
    return route_cases.Problem(
        task.cell, task.grasp, start, goal, CollisionScene.of(task, obstacles=obstacles), q_start
    )


def test_a_way_round_two_posts_is_found_proved_and_rounded(posts: tuple[route_cases.Problem, Route]) -> None:
    problem, route = posts
    assert route.verdict is RouteVerdict.FOUND
    assert route.found
    assert route.path is not None
    assert route.check is not None
    assert route.check.verdict is PathVerdict.CERTIFIED
    for clock, T in ((0.0, problem.start), (route.path.duration, problem.goal)):
        np.testing.assert_allclose(route.path.pose(clock).homogeneous, T.homogeneous, atol=1e-9)
    geometry = route.path.geometry()
    assert geometry is not None
    assert len(geometry.pieces) > 2
    assert not geometry.corners, "the object need not rest on its way"


def test_along_the_way_all_arms_hold_the_object_and_nothing_comes_inside_its_margin(
    posts: tuple[route_cases.Problem, Route],
) -> None:
    # The oracle: inverse kinematics of the whole chain and coal, at samples of the path.
    problem, route = posts
    assert route.path is not None
    assert route.check is not None
    assert route.check.q_start is not None
    q, distances = route.check.q_start, Distances(problem.scene.built)
    for clock in np.linspace(0.0, route.path.duration, 60):
        q = inverse_kinematics(problem.cell, problem.grasp, route.path.pose(clock), q, limits=False)
        x = problem.cell.positions(q)
        assert (x >= problem.cell.limits.lower).all()
        assert (x <= problem.cell.limits.upper).all()
        assert (distances.all(q) >= problem.scene.built.margins - 1e-6).all()


def test_the_same_seed_gives_the_same_way_bit_for_bit(posts: tuple[route_cases.Problem, Route]) -> None:
    problem, route = posts
    again = search(problem)
    assert route.path is not None
    assert again.path is not None
    np.testing.assert_array_equal(again.path.profile.s, route.path.profile.s)
    np.testing.assert_array_equal(again.joints, route.joints)


def over_a_post() -> route_cases.Problem:
    return two_arms([Body("post", Capsule(0.03, 0.3), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.12])))])


@pytest.mark.parametrize("make", slow_but_first([over_a_post, route_cases.peg]))
def test_ways_over_an_obstacle_are_found(make: Any) -> None:
    route = search(make())
    assert route.verdict is RouteVerdict.FOUND
    assert route.check is not None
    assert route.check.verdict is PathVerdict.CERTIFIED


def test_without_a_start_one_is_found() -> None:
    problem = route_cases.posts3()
    route = search(problem, q_start=None)
    assert route.verdict is RouteVerdict.FOUND


def test_a_free_straight_way_is_taken() -> None:
    problem = two_arms([Body("far", Box((0.1, 0.1, 0.1)), pin.SE3(np.eye(3), np.array([0.0, 0.0, 2.0])))])
    route = search(problem)
    assert route.verdict is RouteVerdict.STRAIGHT
    assert route.length == pytest.approx(0.2)


def test_a_scene_without_pairs_is_in_nobodys_way() -> None:
    task = dual_arm7()
    bodies = (*task.cell.arm_names, "object")
    free = CollisionScene.of(task, ignored=list(combinations_with_replacement(bodies, 2)))
    assert not free.built.labels
    start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
    for q_start in (None, task.q_start):
        route = find_path(task.cell, task.grasp, start, goal, free, q_start=q_start, nodes=100)
        assert route.verdict is RouteVerdict.STRAIGHT


def test_a_wall_is_not_found_a_way_round_and_nothing_is_claimed() -> None:
    problem = two_arms([Body("wall", Box((0.3, 0.03, 2.0)), pin.SE3.Identity())])
    route = search(problem, nodes=60)
    assert route.verdict is RouteVerdict.NOT_FOUND
    assert not route.found
    assert "nothing is proved" in route.reason
    assert "wall" in route.reason
    with pytest.raises(InvalidInputError, match="no way"):
        route.timed()


def test_a_goal_inside_a_body_is_named() -> None:
    problem = two_arms([Body("block", Box((0.1, 0.05, 0.1)), pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.3])))])
    route = search(problem)
    assert route.verdict is RouteVerdict.INFEASIBLE
    assert route.reason == "The goal is impossible: object and block come inside their margin."


def test_a_goal_out_of_reach_names_the_arm() -> None:
    problem = two_arms([Body("far", Box((0.1, 0.1, 0.1)), pin.SE3(np.eye(3), np.array([0.0, 0.0, 5.0])))])
    route = search(problem._replace(goal=pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.3]))))
    assert route.verdict is RouteVerdict.INFEASIBLE
    assert "arm left does not reach its grasp" in route.reason


def test_a_start_inside_a_margin_is_named() -> None:
    problem = two_arms([Body("block", Box((0.1, 0.05, 0.1)), pin.SE3(np.eye(3), np.array([0.0, -0.1, 0.3])))])
    route = search(problem)
    assert route.verdict is RouteVerdict.INFEASIBLE
    assert route.reason.startswith("The start is impossible: object and block")


def test_of_several_goals_one_that_is_impossible_is_left_out(posts: tuple[route_cases.Problem, Route]) -> None:
    problem = posts[0]
    route = search(problem, goal=[problem.goal * pin.SE3(np.eye(3), np.array([0.0, 0.0, 3.0])), problem.goal])
    assert route.verdict is RouteVerdict.FOUND
    assert route.path is not None
    np.testing.assert_allclose(route.path.pose(route.path.duration).translation, problem.goal.translation, atol=1e-9)


def test_a_goal_may_leave_a_turn_free() -> None:
    problem = over_a_post()
    goal = TurnedGoal(problem.goal, [FreeTurn("rx", -0.2, 0.2)])
    route = search(problem, goal=goal)
    assert route.found
    assert route.path is not None
    end = route.path.pose(route.path.duration)
    np.testing.assert_allclose(end.translation, problem.goal.translation, atol=1e-9)
    turn = pin.log3(problem.goal.rotation.T @ end.rotation)
    assert abs(turn[0]) <= 0.2 + 1e-9
    np.testing.assert_allclose(turn[1:], 0.0, atol=1e-9)
    with pytest.raises(InvalidInputError, match="low is above high"):
        FreeTurn("rx", 0.2, -0.2)


def test_joint_positions_of_one_arm_are_a_goal(posts: tuple[route_cases.Problem, Route]) -> None:
    problem, known = posts
    assert known.joints is not None
    own = problem.cell.v_slices[1]
    q = known.joints[-1, own]
    route = search(problem, goal=ArmGoal("slave_1", q))
    assert route.verdict is RouteVerdict.FOUND
    assert route.joints is not None
    np.testing.assert_allclose(route.joints[-1, own], q, atol=1e-6)
    outside = search(problem, goal=ArmGoal("slave_1", q + 10.0))
    assert outside.verdict is RouteVerdict.INFEASIBLE
    assert "arm slave_1" in outside.reason


def test_who_watches_can_end_the_search() -> None:
    asked: list[int] = []
    problem = two_arms([Body("wall", Box((0.3, 0.03, 2.0)), pin.SE3.Identity())])
    route = search(problem, nodes=None, watch=lambda nodes: asked.append(nodes) or len(asked) > 5)
    assert route.verdict is RouteVerdict.NOT_FOUND
    assert len(asked) == 6


def test_clearance_is_kept_beyond_the_margins(posts: tuple[route_cases.Problem, Route]) -> None:
    route = search(posts[0], clearance=0.004)
    assert route.check is not None
    assert route.check.clearance is not None
    assert route.check.verdict is PathVerdict.CERTIFIED
    assert route.check.clearance.margin == pytest.approx(0.014)


def test_arguments_that_make_no_search_are_refused(posts: tuple[route_cases.Problem, Route]) -> None:
    problem = posts[0]
    for options, match in (
        ({"region": [[0, 0, 0], [1, 1]]}, "region"),
        ({"region": [[1, 1, 1], [0, 0, 0]]}, "low corner"),
        ({"region": [[0, 0, 0], [0.1, 0.1, 0.1]]}, "outside"),
        ({"nodes": 0}, "nodes"),
        ({"goal": problem.start}, "the goal is the start"),
        ({"goal": []}, "no pose"),
        ({"time_limit": -1.0}, "time_limit"),
        ({"clearance": -0.1}, "clearance"),
        ({"q_start": np.zeros(problem.cell.nq)}, "q_start"),
    ):
        with pytest.raises(InvalidInputError, match=match):
            search(problem, **options)


@pytest.mark.core
@pytest.mark.parametrize(
    ("ends_by", "narrow", "sigma_min"), [("reach", 10.0, 0.02), ("limit", 0.15, 0.02), ("singular", 10.0, 0.2)]
)
def test_edges_end_where_arms_or_distances_end_and_keep_both_between_their_samples(
    ends_by: str, narrow: float, sigma_min: float
) -> None:
    """Against kinematics of each arm alone, and distances by coal at a hundred places between two samples."""
    problem = route_cases.posts3()
    cell, grasp, scene = problem.cell, problem.grasp, problem.scene
    x = cell.positions(problem.q_start)
    required, _ = scene.required_at(x[None])
    usual = limits_with(cell, x[None], required)
    lower, upper = np.maximum(usual.lower, x - narrow), np.minimum(usual.upper, x + narrow)
    limits = replace(usual, lower=lower, upper=upper, sigma_min=sigma_min)
    arms = [ArmKinematics(arm) for arm in cell.arms]
    edges, offsets = scene.edges(arms, grasp, limits), [np.array(X.homogeneous) for X in grasp.T_object_tool]
    distances, levers = Distances(scene.built), scene.required_at(x[None])[1]

    def margins(x: Any) -> Any:
        """Distance less what is required (P,)."""
        return distances.all(cell.configuration(x)) - required

    def followed(a: Any, b: Any, x: Any) -> tuple[str, int, Any]:
        """What stops the arms between two poses, which are rows, as Stop has it; joint positions at the second one."""
        found, T = x.copy(), [Pose.of_row(row).placement().homogeneous for row in (a, b)]
        for arm, own, X in zip(arms, columns_of(cell, arms), offsets, strict=True):
            q, reached = arm.trajectories(np.array(T) @ X, x[None, own])
            found[own] = q[0, 1]
            if not reached[0]:
                return "reach", own[0], found
            outside = (found[own] < limits.lower[own]) | (found[own] > limits.upper[own])
            if outside.any():
                return "limit", own[outside.argmax()], found
            if arm.singular_values(q[:, 1])[0, -1] < limits.sigma_min:
                return "singular", own[0], found
        return "", 0, found

    rooms = edges.rooms(x)
    np.testing.assert_allclose(rooms, margins(x), atol=1e-4)
    rng = np.random.default_rng(0)
    kinds, stoppers, sharp = set(), set(), 0
    for _ in range(12):
        goal = problem.start * pin.exp6(pin.Motion(rng.uniform(-1.0, 1.0, 6) * [0.3, 0.3, 0.3, 0.5, 0.5, 0.5]))
        a, b = Pose.of(problem.start), Pose.of(goal)
        steps = int(np.ceil(distance(a, b) / STEP))
        rows, way = edges.line(a.row(), b.row(), steps), (pin.log3(a.R.T @ b.R), b.p - a.p)
        np.testing.assert_allclose(rows, [part_of(a, b, i / steps).row() for i in range(steps + 1)], atol=1e-12)
        motion = np.tile([np.linalg.norm(way[1]) / steps, np.linalg.norm(way[0]) / steps], (steps, 1))
        one = edges.walk(rows, motion, x, rooms)
        kinds.add(one.stop.kind)
        n = len(one.positions)
        for i, (before, after) in enumerate(pairwise(one.positions)):
            kind, _, found = followed(rows[i], rows[i + 1], before)
            assert not kind
            np.testing.assert_allclose(after, found, atol=1e-7)
            far = margins(after)
            assert (one.rooms[i + 1] <= far + 1e-6).all()
            assert (far >= limits.spare - 1e-6).all()
            if (far < 2.0 * limits.spare).any() or i == n - 2:
                between = [margins(part) for part in np.linspace(before, after, 100)]
                assert np.min(between) >= -1e-6
        # The object alone, and the arms alone, get at least as far as both together.
        objects, alone = edges.object_along(rows, motion, rooms), edges.arms_along(rows, x)
        assert objects >= n
        assert len(alone) >= n
        np.testing.assert_array_equal(alone[:n], one.positions)
        if len(alone) < len(rows):
            assert followed(rows[len(alone) - 1], rows[len(alone)], alone[-1])[0]
        of_object = np.array([margins(x)[np.isfinite(levers)].min() for x in alone[: objects + 1]])
        assert (of_object[:objects] >= limits.spare.min() - 1e-6).all()
        if len(of_object) > objects:
            assert of_object[objects] < limits.spare.max() + 1e-6
        by_object = one.stop.kind == "pair" and bool(np.isfinite(levers[one.stop.number]))
        stoppers.add((by_object, objects < len(rows)))
        if one.stop.kind == "pair":
            last, k = one.positions[-1], one.stop.number
            kind, _, found = followed(rows[n - 1], rows[n], last)
            assert not kind
            ahead = np.array([margins(part) for part in np.linspace(last, found, 100)])[:, k]
            assert ahead.min() < limits.spare[k] + 1e-6
            before, after = (Pose.of_row(row) for row in rows[n - 1 : n + 1])
            for beyond in (5e-5, -5e-5) if sharp < 6 else ():  # to there it goes, and no further
                low, high = 0.0, 1.0
                for _ in range(20):
                    share = 0.5 * (low + high)
                    there = part_of(before, after, share).row()
                    room = (margins(followed(rows[n - 1], there, last)[2]) - limits.spare).min()
                    low, high = (share, high) if room > beyond else (low, share)
                if 0.01 < share < 0.99:
                    stop = edges.walk(
                        np.array([rows[n - 1], there]), share * motion[n - 1 : n], last, one.rooms[-1]
                    ).stop
                    assert stop.kind == ("" if beyond > 0.0 else "pair")
                    sharp += 1
        elif one.stop.kind:
            assert (one.stop.kind, one.stop.number) == followed(rows[n - 1], rows[n], one.positions[-1])[:2]
        else:
            assert n == len(rows)
    assert {"pair", ends_by} <= kinds
    assert sharp >= 2
    assert {(True, True), (False, False)} <= stoppers


@pytest.mark.core
def test_samples_of_rounded_corners_are_those_of_the_geometry() -> None:
    problem = route_cases.posts3()
    x = problem.cell.positions(problem.q_start)
    limits = limits_with(problem.cell, x[None], problem.scene.required_at(x[None])[0])
    edges = problem.scene.edges([ArmKinematics(arm) for arm in problem.cell.arms], problem.grasp, limits)
    rng = np.random.default_rng(3)
    for corners in (0, 1, 2, 5, 40):
        poses = [Pose(rng.normal(size=3), np.asarray(pin.exp3(rng.normal(size=3)))) for _ in range(corners + 2)]
        deviations = rng.choice([0.0, 1e-3, 0.05, 10.0], corners)
        if corners == 2:  # a corner that is none, and one of which no way is left
            poses[2] = Pose(2.0 * poses[1].p - poses[0].p, poses[1].R @ poses[0].R.T @ poses[1].R)
        geometry = rounded(poses, deviations)
        found = edges.samples(np.array([pose.row() for pose in poses]), deviations)
        for one, other in zip(found, samples_of(geometry), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-10)
        R, p = geometry.poses(found.s)
        np.testing.assert_allclose(found.poses, np.hstack([R.reshape(-1, 9), p]), atol=1e-8)


def test_a_pose_is_pushed_off_bodies_across_the_line_and_not_along_it() -> None:
    # The oracle: coal's distances of the whole scene, the arms placed by inverse kinematics.
    problem = two_arms([Body("beam", Box((0.3, 0.05, 0.3)), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.18])))])
    cell, scene, along = problem.cell, problem.scene, np.array([0.0, 1.0, 0.0])
    required, levers = scene.required_at(cell.positions(problem.q_start)[None])
    inside = pin.SE3(pin.utils.rotate("x", 0.05), np.array([0.0, 0.0, 0.325]))
    pushed = scene.pushed(inside, along, required)
    assert pushed is not None
    assert abs((pushed.translation - inside.translation) @ along) < 1e-12
    assert pushed.translation[2] > inside.translation[2]
    q = inverse_kinematics(cell, problem.grasp, pushed, problem.q_start, limits=False)
    away = Distances(scene.built).all(q) - required
    assert away[np.isfinite(levers)].min() >= 0.0


@pytest.mark.filterwarnings("error")
def test_a_depth_that_coal_does_not_find_pushes_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = route_cases.pillar()
    required, _ = problem.scene.required_at(problem.q_start[None])
    found = coal.distance
    monkeypatch.setattr("coal.distance", lambda *given: found(*given) - np.finfo(float).max)
    assert problem.scene.pushed(problem.start, np.array([0.0, 1.0, 0.0]), required) is None


@pytest.mark.parametrize(("way", "fastest", "acceleration"), [(0.5, 2.0, 3.0), (4.0, 1.0, 2.0)])
def test_the_estimated_duration_of_one_joint_is_that_of_its_trapezoid(
    way: float, fastest: float, acceleration: float
) -> None:
    limits = JointLimits(*(np.array([x]) for x in (-9.0, 9.0, fastest, acceleration)))
    s = np.linspace(0.0, 1.0, 400)
    ramp = fastest**2 / acceleration
    exact = 2.0 * np.sqrt(way / acceleration) if way < ramp else way / fastest + fastest / acceleration
    assert estimated_duration(limits, s, way * s[:, None]) == pytest.approx(exact, rel=0.02)


def test_samples_of_all_pieces_at_once_are_those_of_each_and_the_object_moves_no_further_between_them() -> None:
    rng = np.random.default_rng(3)
    poses = [pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(4)]
    lines = [line for a, b in pairwise(poses) if (line := LinePath(a, b, duration=1.0).straight())]
    geometry = blended(lines, distance=np.array([0.1, 0.3]), angle=np.ones(2))
    s, rows, motion = samples_of(geometry)
    assert np.isin(geometry.marks, s).all()
    R, p = geometry.poses(s)
    np.testing.assert_allclose(rows, np.hstack([R.reshape(-1, 9), p]), atol=1e-12)
    # The oracle: lengths of chains of short chords between samples.
    fine = np.linspace(s[:-1], s[1:], 30)
    for k, (low, high) in enumerate(pairwise(s)):
        R, p = geometry.poses(fine[:, k])
        way = np.linalg.norm(np.diff(p, axis=0), axis=1).sum()
        turn = sum(np.linalg.norm(pin.log3(a.T @ b)) for a, b in pairwise(R))
        assert low < high
        assert way <= motion[k, 0] + 1e-9
        assert turn <= motion[k, 1] + 1e-9


def test_corners_are_rounded_off_within_their_own_distances() -> None:
    poses = [pin.SE3(np.eye(3), np.array(p, dtype=float)) for p in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 1, 0))]
    lines = [line for a, b in pairwise(poses) if (line := LinePath(a, b, duration=1.0).straight())]
    distances = np.array([0.05, 0.0])
    geometry = blended(lines, distance=distances, angle=np.ones(2))
    _, p = geometry.poses(np.linspace(0.0, geometry.length, 2000))
    nearest = [np.linalg.norm(p - corner.translation, axis=1).min() for corner in poses[1:3]]
    assert 0.0 < nearest[0] <= 0.05 * np.sqrt(2.0) + 1e-9
    assert nearest[1] < 1e-3


def over_shelves() -> tuple[Any, Any]:
    """A problem, and a way with a motion of the elbows that is proved."""
    problem = route_shelves.problem(("bottom", "top"))
    route = search(problem, nodes=3000)
    assert route.verdict is RouteVerdict.FOUND
    assert route.path is not None
    assert route.check is not None
    assert route.check.verdict is PathVerdict.CERTIFIED
    assert route.path.elbows is not None
    return problem, route


def test_elbows_go_over_to_others_where_their_least_motion_does_not_get_through() -> None:
    problem, route = over_shelves()
    cell, x = problem.cell, problem.cell.positions(problem.q_start)
    for k, (arm, held) in enumerate(zip(route.check.arms, problem.grasp.T_object_tool, strict=True)):
        way, own = arm.chosen, cell.columns[k]
        np.testing.assert_allclose(way.q[0], x[own], atol=1e-6)
        assert np.abs(np.diff(way.q, axis=0)).max() < 0.5
        for clock, q in zip(way.clocks[::20], way.q[::20], strict=True):
            x[own] = q
            tool = CellState(cell, cell.configuration(x)).T_world_tool[k]
            np.testing.assert_allclose(tool.homogeneous, (route.path.pose(clock) * held).homogeneous, atol=1e-6)


@pytest.mark.slow
def test_a_controller_follows_elbows_that_go_over() -> None:
    problem, route = over_shelves()
    cell, scene = problem.cell, problem.scene
    # The oracle: a run of a controller, its distances by coal, its chain by Pinocchio.
    for planned in (route.path, route.timed().path):
        controller = QPController(cell, problem.grasp, planned, dt=0.01)
        controller.reset(problem.q_start)
        for k in range(3000):
            step = controller.step()
            if k % 5 == 0:
                assert scene.distances(step.q_next)[0].distance >= 0.01 - 1e-4
            assert step.commanded_apart < 1e-5
            if step.finished:
                break
        assert step.finished
    assert planned.duration < route.path.duration * 1.1
