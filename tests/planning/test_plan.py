"""A start and the fastest way: in a program, and by ``coopqp plan`` as a cell file that ``coopqp run`` takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from places import BAR

from coopqp import (
    Grasp,
    InvalidInputError,
    LinePath,
    QPController,
    RobotCell,
    TimedPath,
    WaypointPath,
    load_cell_file,
    plan,
    simulate,
)
from coopqp.cli.main import main
from coopqp.errors import NoStartError
from coopqp.planning import time_path
from coopqp.scenarios import Scenario, dual_arm7
from coopqp.visualization import write_speed_profile


def task(acceleration: float = 5.0) -> tuple[Scenario, Any]:
    scenario = dual_arm7()
    return scenario, scenario.cell.with_limits(acceleration=acceleration)


def corner(scenario: Scenario) -> list[pin.SE3]:
    start = scenario.path.pose(0.0)
    up = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.05, 0.15]))
    across = pin.SE3(pin.rpy.rpyToMatrix(0.15, 0.0, 0.2), up.translation + np.array([0.05, 0.1, 0.0]))
    return [start, up, across]


# -- in a program ----------------------------------------------------------------------------------------------------


def test_a_plan_has_a_start_and_says_what_binds() -> None:
    scenario, cell = task()
    made = plan(cell, scenario.grasp, scenario.path)
    assert made.start is not None
    np.testing.assert_array_equal(made.q_start, made.start.q)
    same = time_path(cell, scenario.grasp, scenario.path, q_start=made.q_start)
    assert made.path.record() == same.record()
    times = made.binding_times()
    assert list(times.values()) == sorted(times.values(), reverse=True)
    assert sum(times.values()) == pytest.approx(made.path.duration)
    assert made.explain().splitlines()[0] == f"{made.path.duration:.3f} s from rest to rest"
    assert next(iter(times)) in made.explain()


@pytest.mark.slow
def test_a_plan_may_take_the_fastest_of_several_starts() -> None:
    scenario, cell = task()
    usual = plan(cell, scenario.grasp, scenario.path, knots=100)
    fast = plan(cell, scenario.grasp, scenario.path, knots=100, starts=6)
    assert usual.start is not None
    assert fast.start is not None
    alone = []  # each arm's own time from the same starts: the cell is no faster, and not much slower
    for start in (usual.start, fast.start):
        times = []
        for k, own in enumerate(cell.v_slices):
            one = RobotCell([cell.arms[k]]).with_limits(acceleration=cell.limits.acceleration[own])
            q = one.configuration(cell.positions(start.q)[own])
            grasp = Grasp((scenario.grasp.T_object_tool[k],))
            times.append(time_path(one, grasp, scenario.path, q_start=q, knots=100).duration)
        alone.append(max(times))
    assert alone[1] <= alone[0] * 1.001
    assert alone[1] * 0.999 <= fast.path.duration <= 1.03 * alone[1]
    assert fast.path.duration <= 1.001 * usual.path.duration
    assert (fast.start.margins > 0.0).all()
    assert "branches follow the path" in fast.start.explain()
    with pytest.raises(InvalidInputError, match="starts"):
        plan(cell, scenario.grasp, scenario.path, q_start=usual.q_start, starts=2)


def test_waypoints_are_passed_within_the_tolerance_and_faster_than_with_a_rest() -> None:
    scenario, cell = task()
    way = corner(scenario)
    rest = plan(cell, scenario.grasp, way, q_start=scenario.q_start)
    round_ = plan(cell, scenario.grasp, way, q_start=scenario.q_start, blend=0.01, blend_angle=0.05)
    assert round_.path.duration < 0.9 * rest.path.duration
    assert rest.path.geometry().corners == (1,)
    assert round_.path.geometry().corners == ()
    clocks = np.linspace(0.0, round_.path.duration, 2000)
    poses = [round_.path.pose(t) for t in clocks]
    nearest = min(poses, key=lambda T: float(np.linalg.norm(T.translation - way[1].translation)))
    assert np.linalg.norm(nearest.translation - way[1].translation) <= 0.01
    assert np.linalg.norm(pin.log3(nearest.rotation.T @ way[1].rotation)) <= 0.05 + 1e-3
    for T, expected in ((poses[0], way[0]), (poses[-1], way[2])):
        np.testing.assert_allclose(T.homogeneous, expected.homogeneous, atol=1e-9)
    run = simulate(QPController(cell, scenario.grasp, round_.path, dt=0.004), q_start=round_.q_start)
    assert run.finished
    assert (run.rate == 1.0).all()


def test_a_path_of_waypoints_and_its_placements_are_the_same() -> None:
    scenario, cell = task()
    way = corner(scenario)
    path = WaypointPath(way, durations=[1.0, 2.0])
    a, b = (plan(cell, scenario.grasp, x, q_start=scenario.q_start, knots=100) for x in (way, path))
    assert a.path.record() == b.path.record()


def test_bad_plans_are_refused() -> None:
    scenario, cell = task()
    pose = scenario.path.pose(0.0)
    for path in ([], [pose], [pose, pose], [pose, "there"]):
        with pytest.raises(InvalidInputError):
            plan(cell, scenario.grasp, path, q_start=scenario.q_start)
    with pytest.raises(InvalidInputError, match="blend"):
        plan(cell, scenario.grasp, scenario.path, q_start=scenario.q_start, blend=-1.0)


@pytest.mark.slow
def test_a_plan_without_a_start_is_refused_by_name() -> None:
    scenario, cell = task()
    pose = scenario.path.pose(0.0)
    far = pin.SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, 3.0]))
    with pytest.raises(NoStartError, match="arm left"):
        plan(cell, scenario.grasp, LinePath(pose, far, duration=1.0))


@pytest.mark.slow
def test_the_speed_profile_is_drawn(tmp_path: Path) -> None:
    scenario, cell = task()
    path = plan(cell, scenario.grasp, scenario.path, q_start=scenario.q_start).path
    assert write_speed_profile(path, tmp_path / "speed.png", dpi=60).stat().st_size > 5000
    bare = TimedPath.of_record({**path.record(), "binding": []})  # without the names of limits
    assert write_speed_profile(bare, tmp_path / "bare.svg").stat().st_size > 5000


# -- on the command line ---------------------------------------------------------------------------------------------


def bar_with(tmp_path: Path, **changes: str) -> Path:
    text = BAR.read_text(encoding="utf-8")
    for old, new in changes.items():
        found = {"acceleration": ", acceleration_deg_per_s2 = 600", "height": "[0.0, 0.10, 0.45]"}[old]
        assert found in text
        text = text.replace(found, new)
    file = tmp_path / "cell.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.slow
def test_a_plan_is_a_cell_file_that_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan"
    assert main(["plan", str(BAR), "--out", str(out), "--blend-mm", "10"]) == 0
    said = capsys.readouterr().out
    assert "s (1.0" in said
    assert "binds: arm left joint joint_5: velocity" in said
    assert {file.name for file in out.iterdir()} == {"plan.toml", "speed.png"}
    task, given = load_cell_file(out / "plan.toml"), load_cell_file(BAR)
    assert isinstance(task.scenario.path, TimedPath)
    assert task.scenario.dt == given.scenario.dt
    # The numbers are those of the plan, to the last bit.
    made = plan(
        given.scenario.cell, given.scenario.grasp, given.scenario.path, q_start=given.scenario.q_start, blend=0.01
    )
    assert task.scenario.path.record() == made.path.record()
    assert task.scenario.path.profile.binding == made.path.profile.binding
    sections = task.settings.path.binding
    assert sections[0].from_s == 0.0
    assert sections[-1].to_s == made.path.duration
    assert {s.limit for s in sections} == {"velocity", "acceleration"}
    assert "[[path.binding]]" in (out / "plan.toml").read_text(encoding="utf-8")
    np.testing.assert_array_equal(task.scenario.q_start, made.q_start)
    # Nothing is overwritten.
    assert main(["plan", str(BAR), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["plan", str(BAR), "--out", str(out), "--force", "--quiet"]) == 0
    assert not capsys.readouterr().out
    assert main(["run", str(out / "plan.toml"), "--out", str(tmp_path / "run"), "--quiet"]) == 0


@pytest.mark.slow
def test_the_command_compares_starts_of_a_file_without_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = BAR.read_text(encoding="utf-8")
    file = tmp_path / "bar.toml"
    file.write_text(text[: text.index("[start]")] + text[text.index("[object]") :], encoding="utf-8")
    durations = []
    for starts in ("1", "8"):
        out = tmp_path / starts
        assert main(["plan", str(file), "--out", str(out), "--starts", starts, "--quiet"]) == 0
        durations.append(load_cell_file(out / "plan.toml").scenario.path.duration)
    assert durations[1] < 0.97 * durations[0]
    for wrong, says in ((BAR, "--starts is for files without a table 'start'"), (file, "starts: 0 is no whole number")):
        assert main(["plan", str(wrong), "--out", str(tmp_path / "b"), "--starts", "3" if wrong is BAR else "0"]) == 2
        assert says in capsys.readouterr().err


def test_exit_statuses(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    out = str(tmp_path / "plan")
    assert main(["plan", str(tmp_path / "none.toml"), "--out", out]) == 2
    assert main(["plan", str(bar_with(tmp_path, acceleration="")), "--out", out]) == 2
    said = capsys.readouterr().err
    assert "a plan needs acceleration limits: arms left, right have none. Add to [[arms]]" in said
    assert "with_limits" not in said
    assert main(["plan", str(BAR), "--out", out, "--share", "2"]) == 2
    assert main(["plan", str(bar_with(tmp_path, height="[0.0, 0.10, 4.0]")), "--out", out]) == 3
    assert "coopqp: no plan: arm" in capsys.readouterr().err
    import coopqp.planning.timing as timing
    from coopqp.errors import UndecidedError

    def fails(*_: Any) -> Any:
        raise UndecidedError("it failed")

    monkeypatch.setattr(timing, "fastest", fails)
    assert main(["plan", str(BAR), "--out", out]) == 4
    assert "it failed" in capsys.readouterr().err
    assert not (tmp_path / "plan").exists()


def test_paths_of_models_lead_from_the_new_folder(tmp_path: Path) -> None:
    """A cell file with URDF files of its own can be planned into any folder."""
    from coopqp.scenarios import robot_path

    robot = tmp_path / "cell" / "robots" / "arm.urdf"
    robot.parent.mkdir(parents=True)
    robot.write_bytes(Path(robot_path("arm7")).read_bytes())
    text = BAR.read_text(encoding="utf-8").replace('robot = "arm7"', 'urdf = "robots/arm.urdf"\ntool_frame = "tool"')
    file = tmp_path / "cell" / "bar.toml"
    file.write_text(text, encoding="utf-8")
    out = tmp_path / "elsewhere" / "deep"
    assert main(["plan", str(file), "--out", str(out), "--quiet"]) == 0
    again = load_cell_file(out / "plan.toml")
    assert isinstance(again.scenario.path, TimedPath)
    assert "../../cell/robots/arm.urdf" in (out / "plan.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_steps_of_the_file_become_its_length_of_a_step(tmp_path: Path) -> None:
    text = "\n".join(["steps = 400" if line == "dt_s = 0.005" else line for line in BAR.read_text().splitlines()])
    file = tmp_path / "cell.toml"
    file.write_text(text, encoding="utf-8")
    assert main(["plan", str(file), "--out", str(tmp_path / "plan"), "--torques", "--jerk", "3000", "--quiet"]) == 0
    assert load_cell_file(tmp_path / "plan" / "plan.toml").scenario.dt == load_cell_file(file).scenario.dt
