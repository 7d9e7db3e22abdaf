"""Distances in the check before the motion, against dense samples of other kinematics and the judge's own distances."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_unless
from places import BAR
from user_paths import Opaque

from coopqp import (
    Clearance,
    CollisionScene,
    InvalidInputError,
    LinePath,
    QPController,
    check_path,
    find_start,
    load_cell_file,
    simulate,
)
from coopqp.cli import main as cli
from coopqp.collision import Body, Box, Sphere
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.paths.joint_trajectories import HeldTrajectory
from coopqp.paths.segments import segments_of
from coopqp.planning import PathCheck, PathVerdict, find_remedies
from coopqp.scenarios import (
    Scenario,
    dual_arm7,
    elbow_and_knob,
    mixed_cell,
    paper_lift,
    plate_and_post,
    plate_and_table,
    random_posts,
    ring,
)
from coopqp.simulation import Closeness
from coopqp.visualization.check_plots import check_figure

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict


def checked(task: Scenario, scene: CollisionScene | None = None, *, start: bool = True, **changes: Any) -> PathCheck:
    scene = CollisionScene.of(task, **{"margin": 0.02, **changes}) if scene is None else scene
    return check_path(task.cell, task.grasp, task.path, q_start=task.q_start if start else None, scene=scene)


def followed(task: Scenario, samples: int) -> tuple[Any, Any]:
    """Clocks, and configurations of the whole chain by Newton's method from one to the next."""
    chain, q, rows = Chain(task.cell, task.grasp), task.q_start, []
    clocks = np.linspace(0.0, task.path.duration, samples)
    for clock in clocks:
        q, errors = newton(chain, task.path.pose(clock), q, tolerance=1e-11, max_iter=20)
        assert np.abs(errors).max() < 1e-9
        rows.append(q)
    return clocks, np.array(rows)


# -- the proof -----------------------------------------------------------------------------------------------------


def test_a_path_beyond_the_reach_is_infeasible_among_bodies_too() -> None:
    """From any start no branch is left whose distances could be looked at."""
    task = plate_and_post()
    away = task.path.pose(0.0)
    path = LinePath(away, pin.SE3(away.rotation, away.translation + np.array([0.0, 0.0, 9.0])), duration=5.0)
    check = checked(replace(task, path=path), start=False)
    assert check.verdict is INFEASIBLE
    assert check.clearance is None
    assert "its reach ends" in check.explain()


@pytest.mark.parametrize("seed", slow_unless(lambda seed: seed == 3, range(5)))
def test_what_is_proved_holds_at_dense_samples(seed: int) -> None:
    task = random_posts(seed, arms=3)
    scene = CollisionScene.of(task, margin=0.005)
    found = checked(task, scene).clearance
    clocks, q = followed(task, 301)
    closest = Closeness(scene).closest(q, clocks)
    assert found is not None
    assert found.pair is not None
    assert closest is not None
    d = closest.pair.distance
    if found.verdict is CERTIFIED:
        assert found.proved + 0.005 <= d + 1e-8
        assert found.proved + 0.005 >= 0.95 * d - 1e-3  # and it is not much less
        assert found.pair.distance == pytest.approx(d, rel=0.06, abs=1e-3)
    assert (found.verdict is CERTIFIED) == (d > 0.005)


@pytest.mark.slow
@pytest.mark.parametrize("task", [paper_lift(), ring(arms=2)], ids=lambda task: task.name)
def test_a_margin_is_certified_up_to_the_least_distance_and_not_beyond(task: Scenario) -> None:
    # 20 µm on either side of what the judge finds, with its own search between samples
    task = replace(task, obstacles=(Body("ball", Sphere(0.05), _aside(task)),))
    between = ("object", "ball")
    others = [(a, b) for a, b in CollisionScene.of(task).pairs if {a, b} != set(between)]
    scene = CollisionScene.of(task, margin=0.0, ignored=others)
    clocks, q = followed(task, 401)
    closest = Closeness(scene).closest(q, clocks)
    assert closest is not None
    least = closest.pair.distance
    assert least > 1e-3
    assert checked(task, replace(scene, margin=least - 2e-5)).verdict is CERTIFIED
    beyond = checked(task, replace(scene, margin=least + 2e-5))
    assert beyond.verdict is INFEASIBLE
    assert beyond.clearance is not None
    assert beyond.clearance.stopped_by is not None
    assert {beyond.clearance.stopped_by.first, beyond.clearance.stopped_by.second} == set(between)
    assert "object and ball" in beyond.explain()


@pytest.mark.parametrize("share", [0.437, 0.561])
def test_a_ball_that_is_passed_between_samples_is_seen(share: float) -> None:
    """The least distance of two balls, one carried along a straight line, is known in closed form."""
    task = paper_lift()
    first, last = (task.path.pose(t).translation for t in (0.0, task.path.duration))
    along = (last - first) / np.linalg.norm(last - first)
    side = np.cross(along, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    near = 0.12
    ball = Body("ball", Sphere(0.05), pin.SE3(np.eye(3), first + share * (last - first) + near * side))
    arms = [(arm, "*") for arm in task.cell.arm_names]

    def answer(margin: float) -> PathCheck:
        bob = Body("bob", Sphere(0.05))
        return checked(task, CollisionScene.of(task, carried=[bob], obstacles=[ball], margin=margin, ignored=arms))

    clear = answer(near - 0.1 - 5e-4)
    assert clear.clearance is not None
    assert clear.clearance.verdict is CERTIFIED
    ways = [arm.chosen.trajectory for arm in clear.arms if arm.chosen is not None]
    way = HeldTrajectory(task.cell, task.path, segments_of(task.path), ways, task.cell.positions(task.q_start))
    samples = [task.path.pose(float(t)).translation for t in way.clocks(way.places)]
    at_samples = min(float(np.linalg.norm(p - ball.placement.translation)) for p in samples) - 0.1
    margin = 0.5 * (at_samples + near - 0.1)
    assert margin > near - 0.1 + 1e-6
    inside = answer(margin).clearance
    assert inside is not None
    assert inside.verdict is INFEASIBLE
    assert inside.pair is not None
    assert {inside.pair.first, inside.pair.second} == {"ball", "bob"}
    assert near - 0.1 - 1e-9 < inside.pair.distance < margin


def _aside(task: Scenario) -> pin.SE3:
    """Aside of the object in the middle of its path."""
    middle = task.path.pose(0.4 * task.path.duration) * task.T_object_body
    return middle * pin.SE3(np.eye(3), np.array([0.5 * task.object_size[0] + 0.08, 0.02, 0.0]))


@pytest.mark.parametrize("task", [plate_and_post(post="box"), plate_and_table(tilt=0.1)], ids=lambda task: task.name)
def test_the_check_names_pair_and_place_at_which_the_controller_stops(task: Scenario) -> None:
    scene = CollisionScene.of(task, margin=0.02)
    found = checked(task, scene)
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, constraints=[Clearance(scene)])
    steps: list[Any] = []
    run = simulate(controller, q_start=task.q_start, patience=0.2, observe=steps.append)
    assert found.verdict is INFEASIBLE
    assert found.clearance is not None
    assert found.clearance.stopped_by is not None
    assert found.clearance.stop == pytest.approx(run.clock[-1], abs=2e-3)
    by = found.clearance.stopped_by
    assert {by.first, by.second} == set(steps[-1].binding[0].between)
    assert by.distance == pytest.approx(0.02, abs=1e-4)


def test_beyond_the_end_of_an_arms_way_nothing_is_proved() -> None:
    task = paper_lift()
    found = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    ways = [arm.chosen.trajectory for arm in found.arms if arm.chosen is not None]
    segments, rest = segments_of(task.path), task.cell.positions(task.q_start)
    scene = CollisionScene.of(task, margin=0.005)
    whole = scene.along(HeldTrajectory(task.cell, task.path, segments, ways, rest))
    assert whole.verdict is CERTIFIED
    half = len(ways[1].q) // 2
    ways[1] = replace(ways[1], places=ways[1].places[: half + 1], q=ways[1].q[: half + 1], rates=ways[1].rates[:half])
    part = HeldTrajectory(task.cell, task.path, segments, ways, rest)
    ended = scene.along(part)
    assert ended.verdict is UNDECIDED
    end = float(part.clocks(part.places[-1:])[0])
    np.testing.assert_allclose(ended.undecided, [[end, task.path.duration]], rtol=0, atol=1e-12)
    assert f"from {end:.4g} s on nothing is judged" in ended.explain()
    assert "proved" not in ended.explain()
    assert ended.proved == -np.inf


@pytest.mark.parametrize("task", [mixed_cell(), dual_arm7(), ring(arms=3)], ids=lambda task: task.name)
def test_joints_stay_within_the_motion_that_is_proved(task: Scenario, rng: Any) -> None:
    found = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    ways = [arm.chosen.trajectory for arm in found.arms if arm.chosen is not None]
    way = HeldTrajectory(task.cell, task.path, segments_of(task.path), ways, task.cell.positions(task.q_start))
    assert way.complete
    chain = Chain(task.cell, task.grasp)
    for i in rng.choice(len(way.places) - 1, 12, replace=False):
        low, high = np.sort(rng.uniform(way.places[i], way.places[i + 1], 2))
        places = np.linspace(low, high, 9)
        x, solved = way.positions(places)
        assert solved.all()
        bound = way.motion(np.array([low]), np.array([high]))[0]
        assert np.isfinite(bound).all()
        assert (np.abs(np.diff(x, axis=0)).sum(axis=0) <= bound + 1e-9).all()
        for row, clock in zip(x[::4], way.clocks(places)[::4], strict=True):
            errors = chain.errors(chain.carried(task.cell.configuration(row)), task.path.pose(float(clock)))
            assert np.abs(errors).max() < 1e-8


@pytest.mark.slow
def test_without_a_proof_of_the_arms_distances_are_sampled() -> None:
    lift = paper_lift(time_law="quintic")
    task = replace(lift, path=Opaque(lift.path))
    found = checked(task)
    assert found.verdict is SAMPLED
    assert found.clearance is not None
    assert found.clearance.verdict is SAMPLED
    assert found.clearance.proved == -np.inf
    proved = checked(lift)
    assert proved.verdict is CERTIFIED
    assert proved.clearance is not None
    assert found.clearance.pair is not None
    assert proved.clearance.pair is not None
    assert found.clearance.pair.distance == pytest.approx(proved.clearance.pair.distance, abs=1e-3)
    post = plate_and_post()
    stopped = checked(replace(post, path=Opaque(post.path)))
    assert stopped.verdict is INFEASIBLE
    assert stopped.clearance is not None
    assert stopped.clearance.stop == pytest.approx(checked(post).clearance.stop, abs=1e-3)  # type: ignore[union-attr]


def test_a_start_inside_the_margin_is_named_and_may_be_allowed() -> None:
    lift = paper_lift(time_law="quintic")
    middle = (lift.path.pose(0.0) * lift.T_object_body).translation
    below = Body("lid", Box((0.3, 0.3, 0.05)), pin.SE3(np.eye(3), middle - np.array([0.0, 0.0, 0.053])))
    task = replace(lift, obstacles=(below,))
    found = checked(task)
    assert found.verdict is INFEASIBLE
    assert "object and lid start 8 mm apart, inside their margin" in found.explain()
    assert checked(task, inside=[("object", "lid")]).verdict is CERTIFIED


# -- redundant arms --------------------------------------------------------------------------------------------------


def test_the_proof_holds_for_a_motion_of_the_elbow_that_evades() -> None:
    task = elbow_and_knob()
    scene = CollisionScene.of(task, margin=0.02)
    found = checked(task, scene)
    assert found.verdict is CERTIFIED
    ways = [arm.chosen.trajectory for arm in found.arms if arm.chosen is not None]
    way = HeldTrajectory(task.cell, task.path, segments_of(task.path), ways, task.cell.positions(task.q_start))
    places = np.linspace(0.0, way.places[-1], 201)
    q = np.array([task.cell.configuration(row) for row in way.positions(places)[0]])
    closest = Closeness(scene).closest(q, way.clocks(places))
    assert closest is not None
    assert found.clearance is not None
    assert closest.pair.distance >= 0.02 + found.clearance.proved - 1e-8
    # Without evasion the elbow would come inside.
    clocks, straight = followed(task, 101)
    unled = Closeness(scene).closest(straight, clocks)
    assert unled is not None
    assert unled.pair.distance < 0.02


@pytest.mark.slow
def test_an_elbow_that_finds_no_way_is_not_decided() -> None:
    task = elbow_and_knob()
    scene = CollisionScene.of(task, margin=0.02)
    elbow = task.cell.model.getFrameId("left/link_4")
    data = task.cell.model.createData()
    rows = followed(task, 3)[1]
    pin.framesForwardKinematics(task.cell.model, data, rows[1])
    # A ball about the elbow in mid-path that no self-motion leaves.
    ball = Body("ball", Sphere(0.15), pin.SE3(np.eye(3), np.array(data.oMf[elbow].translation)))
    near = replace(scene, obstacles=[ball], inside=[("ball", "*")])
    found = checked(task, near)
    assert found.verdict is UNDECIDED
    assert found.clearance is not None
    assert len(found.clearance.undecided)
    assert "another motion of its elbow" in found.explain().lower()


# -- branches --------------------------------------------------------------------------------------------------------


def _in_the_way() -> tuple[Scenario, CollisionScene]:
    """A ball at the elbow of the arm with six joints in a mixed cell, as the start without a scene has it."""
    task = mixed_cell()
    start = find_start(task.cell, task.grasp, task.path)
    model, data = task.cell.model, task.cell.model.createData()
    pin.forwardKinematics(model, data, start.q)
    shoulder, elbow = (data.oMi[model.getJointId(f"arm6c/joint_{j}")].translation for j in (2, 3))
    ball = Body("ball", Sphere(0.03), pin.SE3(np.eye(3), np.array(0.3 * shoulder + 0.7 * elbow)))
    others = [(arm, body) for arm in ("rx90l", "arm7", "gantry7") for body in ("*",)]
    return task, CollisionScene.of(task, obstacles=[ball], margin=0.005, ignored=[*others, ("arm6c", "object")])


def test_of_several_ways_the_first_that_keeps_its_margin_is_chosen() -> None:
    task = paper_lift()
    first, *others = task.cell.arm_names
    x = task.cell.positions(task.q_start)
    ways = [np.tile(x[own], (2, 3, 1)) for own in task.cell.v_slices]
    ways[0][1, :, 0] += 0.6  # the second way of the first arm: turned aside
    tool = CellState(task.cell, task.q_start).T_world_tool[0].translation
    ball = Body("ball", Sphere(0.02), pin.SE3(np.eye(3), tool + np.array([0.0, 0.0, 0.2])))

    def scene(margin: float) -> CollisionScene:
        ignored = [(arm, "*") for arm in others]
        margins = {("ball", first): margin}
        return CollisionScene.of(task, carried=[], obstacles=[ball], margin=0.0, margins=margins, ignored=ignored)

    near = min(pair.distance for pair in scene(0.0).distances(task.q_start) if "ball" in (pair.first, pair.second))
    aside = scene(0.0).distances(task.cell.configuration(np.concatenate([ways[0][1, 0], *(w[0, 0] for w in ways[1:])])))
    far = min(pair.distance for pair in aside if "ball" in (pair.first, pair.second))
    assert 0.0 < near < 0.9 * far
    assert scene(0.9 * near).clear_choice(ways) == (0, 0, 0)
    assert scene(1.05 * near).clear_choice(ways) == (1, 0, 0)
    assert scene(1.05 * far).clear_choice(ways) is None


@pytest.mark.slow
def test_a_start_is_found_that_keeps_clear() -> None:
    task, scene = _in_the_way()
    free = find_start(task.cell, task.grasp, task.path)
    assert free.clear is None
    assert scene.distances(free.q)[0].distance < 0.005
    found = find_start(task.cell, task.grasp, task.path, scene=scene)
    assert found.clear
    assert scene.distances(found.q)[0].distance >= 0.005
    answer = checked(task, scene, start=False)
    assert answer.verdict is CERTIFIED
    given = check_path(task.cell, task.grasp, task.path, q_start=free.q, scene=scene)
    assert given.verdict is INFEASIBLE
    remedy = find_remedies(given)[0]
    assert remedy.kind == "branch"
    assert remedy.check.clearance is not None
    assert remedy.check.clearance.verdict is CERTIFIED


def test_where_no_branch_is_clear_it_is_said() -> None:
    post = plate_and_post()
    scene = CollisionScene.of(post, margin=0.02)
    found = find_start(post.cell, post.grasp, post.path, scene=scene)
    assert found.clear is False
    assert "no start was found that keeps all margins" in found.explain()
    assert checked(post, scene, start=False).verdict is INFEASIBLE


def test_what_no_other_start_avoids_is_named_first() -> None:
    task = plate_and_post()
    cell, start = task.cell, find_start(task.cell, task.grasp, task.path)
    data = cell.model.createData()
    pin.forwardKinematics(cell.model, data, start.q)
    shoulder, elbow = (data.oMi[cell.model.getJointId(f"slave_1/joint_{j}")].translation for j in (2, 3))
    ball = Body("ball", Sphere(0.03), pin.SE3(np.eye(3), np.array(0.3 * shoulder + 0.7 * elbow)))
    scene = CollisionScene.of(task, obstacles=[*task.obstacles, ball], margin=0.005)
    given = check_path(cell, task.grasp, task.path, q_start=start.q, scene=scene).clearance
    assert given is not None
    assert given.stopped_by is not None
    assert given.stopped_by.second == "ball"  # here and now
    found = checked(task, scene, start=False).clearance
    assert found is not None
    assert found.stopped_by is not None
    assert (found.stopped_by.first, found.stopped_by.second) == ("object", "post")


@pytest.mark.slow
def test_a_moved_path_is_a_remedy_for_distances() -> None:
    found = find_remedies(checked(plate_and_post(), margin=0.01))
    assert [remedy.kind for remedy in found] == ["shift"]
    assert found[0].check.clearance is not None
    assert found[0].check.clearance.verdict is CERTIFIED


def test_bad_arguments_are_named() -> None:
    task, other = paper_lift(), paper_lift()
    scene = CollisionScene.of(other)
    with pytest.raises(InvalidInputError, match="another cell"):
        checked(task, scene)
    with pytest.raises(InvalidInputError, match="CollisionScene"):
        check_path(task.cell, task.grasp, task.path, scene="all")  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="free_roll"):
        find_start(other.cell, other.grasp, other.path, scene=scene, free_roll={"master": [1.0]})


# -- words, files, pictures ------------------------------------------------------------------------------------------


def test_the_command_judges_distances(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = tmp_path / "check.json"
    assert cli.main(["check", "plate_and_post", "--json", str(record)]) == 3
    said = capsys.readouterr().out
    assert "The arms cannot follow the path and keep their distances from this start." in said
    assert "distances: object and post come inside their margin at 2.0" in said
    found = json.loads(record.read_text(encoding="utf-8"))["clearance"]
    assert found["verdict"] == "INFEASIBLE"
    assert found["stopped_by"]["between"] == ["object", "post"]
    assert found["proved_m"] is None
    assert len(found["clocks_s"]) == len(found["distances_m"]) > 10
    assert cli.main(["check", "elbow_and_knob"]) == 0
    assert "all margins are kept, which is proved; closest 23 mm, left/link_3 and knob" in capsys.readouterr().out


TABLE = """
[collision]
margin_m = 0.005
ignored = [["left", "right"]]

[[collision.obstacles]]
name = "post"
shape = "capsule"
radius_m = 0.03
length_m = 0.1
at = {{ xyz_m = [0.0, 0.1, {height}] }}
"""


@pytest.mark.parametrize(("height", "status"), [(0.54, 3), pytest.param(3.0, 0, marks=pytest.mark.slow)])
def test_a_cell_file_with_bodies_is_judged_as_it_runs(
    height: float, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bar.toml"
    file.write_text(BAR.read_text(encoding="utf-8") + TABLE.format(height=height), encoding="utf-8")
    assert cli.main(["check", str(file)]) == status
    assert "distances: " in capsys.readouterr().out
    assert load_cell_file(file).run().finished == (status == 0)


@pytest.mark.slow
def test_the_picture_shows_the_least_distance() -> None:
    found = checked(plate_and_post())
    panel = check_figure(found).axes[-1]
    assert found.clearance is not None
    assert panel.get_title() == "distances: infeasible; closest object and post"
    assert np.min(panel.lines[0].get_ydata()) < 0.0
    assert np.allclose(panel.lines[1].get_ydata(), 20.0)
    lift = paper_lift()
    free = check_path(lift.cell, lift.grasp, lift.path, q_start=lift.q_start)
    assert len(check_figure(free).axes) == 9
