"""A plan sees obstacles: its verdict is that of the check, and nothing is written that does not keep clear."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from places import BAR

from coopqp import (
    Clearance,
    CollisionScene,
    InvalidInputError,
    QPController,
    TimedPath,
    check_path,
    plan,
    simulate,
)
from coopqp.cli.main import main
from coopqp.collision import Body, Box
from coopqp.errors import UnreachableError
from coopqp.paths.geometry import Straight, blended
from coopqp.planning import PathVerdict
from coopqp.planning.planner import some_timing
from coopqp.scenarios import Scenario, elbow_and_knob, forearms, plate_and_post

pytest.importorskip("toppra")


def cornered(paper: Scenario) -> tuple[Scenario, list[Straight], CollisionScene]:
    """Up and then aside, about an edge that stands in the corner, 25 mm from both lines."""
    T = paper.path.pose(0.0)
    lines, way = [], ((0.0, 0.0, 0.2), (0.0, 0.25, 0.0))
    for own in way:
        lines.append(Straight(T.rotation, T.translation, np.zeros(3), np.array(own), 0.2))
        T = pin.SE3(T.rotation, T.translation + np.array(own))
    corner = lines[1].p
    size = np.array([0.02, 0.05, 0.05])
    place = corner + np.array([0.0, 1.0, -1.0]) * (0.025 + 0.5 * size[1])
    task = replace(paper, cell=paper.cell.with_limits(acceleration=5.0))
    scene = CollisionScene(
        cell=task.cell, grasp=task.grasp, margin=0.01, carried=[Body("grain", Box((0.02, 0.02, 0.02)))],
        obstacles=[Body("edge", Box(tuple(size)), pin.SE3(np.eye(3), place))],
    )  # fmt: skip
    others = [pair for pair in scene.pairs if set(pair) != {"grain", "edge"}]
    return task, lines, replace(scene, ignored=others)


def test_the_largest_clear_tolerance_of_blends_is_offered(paper: Scenario) -> None:
    """The tolerance in the message works, and a slightly larger one does not, by a count of its own."""
    task, lines, scene = cornered(paper)
    poses = [pin.SE3(line.R, line.p) for line in lines]
    poses.append(pin.SE3(lines[1].R, lines[1].p + lines[1].way))
    with pytest.raises(UnreachableError, match=r"infeasible.*grain and edge come inside their margin") as caught:
        plan(task.cell, task.grasp, poses, q_start=task.q_start, scene=scene, blend=0.08)
    found = re.search(r"blends of at most ([\d.]+) mm", str(caught.value))
    assert found is not None
    largest = 1e-3 * float(found[1])
    made = plan(task.cell, task.grasp, poses, q_start=task.q_start, scene=scene, blend=largest)
    assert made.check is not None
    assert made.check.verdict is PathVerdict.CERTIFIED
    assert made.check.path is made.path
    # The corner of the grain's box goes along the blend, and the box of the edge has a corner: the distance by hand.
    for tolerance, clear in ((largest, True), (largest + 0.02 * 0.08, False)):
        geometry = blended(lines, distance=tolerance, angle=tolerance / 0.3)
        p = geometry.poses(np.linspace(0.0, geometry.length, 4001))[1] - lines[1].p
        away = np.hypot(np.maximum(0.015 - p[:, 1], 0.0), np.maximum(0.015 + p[:, 2], 0.0))
        assert bool(away.min() >= 0.01) is clear


def test_a_plan_past_a_corner_that_is_too_close_anyway_offers_nothing(paper: Scenario) -> None:
    task, lines, scene = cornered(paper)
    poses = [pin.SE3(line.R, line.p) for line in lines]
    poses.append(pin.SE3(lines[1].R, lines[1].p + lines[1].way))
    near = replace(scene, margin=0.045)
    with pytest.raises(UnreachableError, match="Without rounding its corners off it does not keep clear, either"):
        plan(task.cell, task.grasp, poses, q_start=task.q_start, scene=near, blend=0.02)


def test_the_verdict_of_a_plan_is_that_of_the_check() -> None:
    task = plate_and_post()
    cell = task.cell.with_limits(acceleration=5.0)
    scene = CollisionScene.of(replace(task, cell=cell))
    check = check_path(cell, task.grasp, task.path, q_start=task.q_start, scene=scene)
    assert check.verdict is PathVerdict.INFEASIBLE
    with pytest.raises(UnreachableError, match="the plan is infeasible: distances"):
        plan(cell, task.grasp, task.path, q_start=task.q_start, scene=scene)


def test_a_plan_beside_bodies_is_tracked_at_full_rate() -> None:
    """Within the comfort of the controller's clearance, but outside the margin: elbows move as they were planned."""
    task = forearms()
    cell = task.cell.with_limits(acceleration=5.0)
    scene = CollisionScene.of(replace(task, cell=cell))
    made = plan(cell, task.grasp, task.path, q_start=task.q_start, scene=scene, knots=150)
    assert made.check is not None
    assert made.check.verdict is PathVerdict.CERTIFIED
    assert made.path.keeps_clear
    again = TimedPath.of_record(json.loads(json.dumps(made.path.record())))
    assert again.keeps_clear
    slowed = []
    for path in (again, TimedPath.of_record({**made.path.record(), "keeps_clear": False})):
        controller = QPController(cell, task.grasp, path, dt=0.01, constraints=[Clearance(scene)])
        run = simulate(controller, q_start=made.q_start)
        slowed.append(int((np.asarray(run.rate) < 1.0 - 1e-9).sum()))
    assert slowed[0] == 0
    assert slowed[1] > 0  # evading, it would be


def test_elbows_that_have_to_evade_are_planned_to() -> None:
    """Their least motion would touch the knob: another one is timed, and the run follows it at full rate."""
    task = elbow_and_knob()
    cell = task.cell.with_limits(acceleration=5.0)
    scene = CollisionScene.of(replace(task, cell=cell))
    made = plan(cell, task.grasp, task.path, q_start=task.q_start, scene=scene, knots=80)
    assert made.check is not None
    assert made.check.verdict is PathVerdict.CERTIFIED
    path = TimedPath.of_record(json.loads(json.dumps(made.path.record())))
    assert path.keeps_clear
    assert path.elbows is not None
    assert made.path.elbows is not None
    np.testing.assert_array_equal(path.elbows.packed(), made.path.elbows.packed())
    controller = QPController(cell, task.grasp, path, dt=0.004, constraints=[Clearance(scene)])
    run = simulate(controller, q_start=made.q_start)
    assert run.finished
    assert (np.asarray(run.rate) >= 1.0 - 1e-9).all()
    assert min(pair.distance for q in run.q[::10] for pair in scene.distances(q)) >= scene.margin
    x = np.array([cell.positions(q) for q in run.q])
    led = np.array([path.elbows.at(clock)[0] for clock in run.clock.tolist()])
    assert np.abs(x - led).max() < 1e-4
    least = plan(cell, task.grasp, task.path, q_start=task.q_start, knots=80).path
    assert least.elbows is not None
    assert np.abs(least.elbows.at(least.duration)[0] - path.elbows.at(path.duration)[0]).max() > 0.01
    assert least.duration < path.duration


def test_a_damaged_motion_of_elbows_is_refused() -> None:
    task = forearms()
    x = [task.cell.positions(task.q_start).tolist()] * 2
    path = some_timing(
        blended([Straight(np.eye(3), np.zeros(3), np.zeros(3), np.ones(3), 1.0)], distance=0.0, angle=0.0)
    )
    for clocks, slopes in (([0.0, 0.0], x), ([0.0, 1.0], x[:1]), ([0.0, 1.0], [[np.nan] * len(x[0])] * 2)):
        record = {**path.record(), "elbows": {"clocks": clocks, "x": x, "slopes": slopes}}
        with pytest.raises(InvalidInputError, match="Elbows"):
            TimedPath.of_record(record)
    with pytest.raises(InvalidInputError, match="the record of a timed path is damaged"):
        TimedPath.of_record({**path.record(), "elbows": {"clocks": [0.0, 1.0]}})


def test_a_scene_of_other_arms_and_starts_beside_a_scene_are_refused(paper: Scenario) -> None:
    task, lines, scene = cornered(paper)
    path = some_timing(blended(lines, distance=0.01, angle=0.1))
    with pytest.raises(InvalidInputError, match="a scene of another cell"):
        plan(paper.cell, paper.grasp, path, q_start=task.q_start, scene=scene)
    with pytest.raises(InvalidInputError, match="starts to compare beside a scene"):
        plan(task.cell, task.grasp, path, scene=scene, starts=3)


POST = """
[collision]
obstacles = [ { name = "post", shape = "box", size_m = [0.1, 0.1, 0.2], at = { xyz_m = [0.0, Y, 0.55] } } ]
"""


@pytest.mark.parametrize(("y", "status"), [("0.1", 3), pytest.param("1.5", 0, marks=pytest.mark.slow)])
def test_the_command_has_the_statuses_of_check(
    y: str, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "cell.toml", tmp_path / "plan"
    text = re.sub(r"(?ms)^\[collision\].*?(?=^\[|\Z)", "", BAR.read_text(encoding="utf-8"))
    file.write_text(text + POST.replace("Y", y), encoding="utf-8")
    assert main(["check", str(file), "--json", str(tmp_path / "check.json"), "--quiet"]) == status
    capsys.readouterr()
    assert main(["plan", str(file), "--out", str(out)]) == status
    said = capsys.readouterr()
    assert (out / "plan.toml").exists() is (status == 0)
    verdict = json.loads((tmp_path / "check.json").read_text())["verdict"]
    if status:
        assert f"the plan is {verdict.lower()}: distances:" in said.err
    else:
        assert f"\n{verdict}\n" in said.out
