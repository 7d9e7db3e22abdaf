"""What a cell file builds: bodies, grasps, starts, searches, controllers, and drivers are those of the code."""

from __future__ import annotations

import warnings
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from pydantic import ValidationError

from coopqp import LinePath, QPController, QPOptions, TimedPath, WaypointPath, load_cell_file
from coopqp.drivers.sim import SimDriver
from coopqp.drivers.ur import UrDriver
from coopqp.errors import StartWarning, UndecidedError, UnknownNameError, UnreachableError
from coopqp.files import CellFileError
from coopqp.files.cellfile import example_path, load_cell_task
from coopqp.files.cellfile.build import CellRun, CellTask, load_search
from coopqp.files.cellfile.searched import SearchTask
from coopqp.files.cellfile.write import file_text
from coopqp.model import CellState
from coopqp.model.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from coopqp.paths.elbows import Elbows
from coopqp.paths.timed import SpeedProfile
from coopqp.planning import FreeTurn, TurnedGoal
from coopqp.planning.route.route import Route, RouteVerdict
from coopqp.simulation.plants.kinematic import KinematicPlant
from coopqp.simulation.plants.physics import PhysicsPlant
from coopqp.spatial import as_placement

#: One arm of six joints at the paper's place, with its grasp in the object frame.
ARM = {"name": "a", "robot": "rx90l", "geometry": False}
NEAR = [0.0, 40.0, 70.0, 0.0, 30.0, 0.0]
ONE: dict[str, Any] = {
    "name": "one",
    "arms": [ARM],
    "grasp": {"kind": "latched"},
    "start": {"positions_deg": {"a": NEAR}},
    "path": {"kind": "hold", "pose": {}, "duration_s": 1.0},
}
BALL: dict[str, Any] = {"name": "ball", "shape": "sphere", "radius_m": 0.1, "at": {"xyz_m": [0.0, 0.0, 5.0]}}
TWO: dict[str, Any] = ONE | {
    "arms": [ARM, ARM | {"name": "b", "base": {"xyz_m": [0.0, 3.0, 0.0]}}],
    "start": {"positions_deg": {"a": NEAR, "b": NEAR}},
}


def written(folder: Path, tables: dict[str, Any]) -> Path:
    file = folder / "cell.toml"
    file.write_text(file_text([], tables), encoding="utf-8")
    return file


# -- paths, grasps and starts ------------------------------------------------------------------------------------------

START = {"xyz_m": [0.5, 0.0, 0.5], "rpy_deg": [0, 0, 90]}


@pytest.mark.parametrize("law", ["quintic", "linear"])
def test_paths_of_a_file_are_those_of_the_code(law: str, tmp_path: Path) -> None:
    T = pin.SE3(pin.utils.rotate("z", np.pi / 2), np.array([0.5, 0.0, 0.5]))
    goal = pin.SE3(pin.utils.rotate("x", 0.1), np.array([0.5, 0.2, 0.5]))
    shift, turn = [0.1, 0.2, -0.1], [10.0, -20.0, 30.0]
    there = {"xyz_m": [0.5, 0.2, 0.5], "rpy_rad": [0.1, 0.0, 0.0]}
    line = {"kind": "line", "start": START, "duration_s": 3.0, "time_law": law}
    displacement = {"translation_m": shift, "rotation_vector_deg": turn}
    ways = {"kind": "waypoints", "poses": [START, there, START], "durations_s": [1.0, 2.0], "time_law": law}
    for table, wanted in (
        (line | {"goal": there}, LinePath(T, goal, duration=3.0, time_law=law)),
        (
            line | {"displacement": displacement},
            LinePath.displaced(T, translation=shift, rotation=np.deg2rad(turn), duration=3.0, time_law=law),
        ),
        (ways, WaypointPath([T, goal, T], durations=[1.0, 2.0], time_law=law)),
    ):
        path = load_cell_task(written(tmp_path, ONE | {"path": table})).path
        assert path.duration == 3.0
        for clock in (0.0, 0.4, 1.3, 2.2, 3.0):
            np.testing.assert_allclose(path.pose(clock).homogeneous, wanted.pose(clock).homogeneous, atol=1e-12)


def test_a_grasp_gives_way_in_the_unit_that_is_given(tmp_path: Path) -> None:
    free = [
        {"arm": "b", "axis": "rx", "range_deg": [-60, 30]},
        {"arm": "b", "axis": "ry", "range_rad": [-0.5, 0.25]},
        {"arm": "a", "axis": "z", "range_m": [-0.02, 0.01]},
    ]
    task = load_cell_task(written(tmp_path, TWO | {"grasp": {"kind": "latched", "free": free}}))
    names = [name for name in task.cell.joint_names if "free" in name]
    assert names == ["a/free_z", "b/free_rx", "b/free_ry"]
    own = [task.cell.joint_names.index(name) for name in names]
    np.testing.assert_allclose(task.cell.limits.lower[own], [-0.02, -np.pi / 3, -0.5])
    np.testing.assert_allclose(task.cell.limits.upper[own], [0.01, np.pi / 6, 0.25])
    assert task.q_start is not None
    x = task.cell.positions(task.q_start)
    np.testing.assert_allclose(x[own], 0.0)
    np.testing.assert_allclose(x[:6], np.deg2rad(NEAR))
    np.testing.assert_array_equal(task.exact_start(), task.q_start)  # a latched grasp fits the start


def test_a_latched_grasp_is_where_the_tools_are_when_the_path_begins(tmp_path: Path) -> None:
    """Of a line, of a search and of phases."""
    line: dict[str, Any] = {"kind": "line", "start": START, "duration_s": 1.0}
    line["displacement"] = {"translation_m": [0.0, 0.0, 0.1], "rotation_vector_deg": [0.0, 20.0, 0.0]}
    rest = [{"name": "rest", "duration_s": 1.0}, {"name": "line", "path": line}]
    plain = {key: value for key, value in ONE.items() if key != "path"}
    held = load_cell_task(written(tmp_path, ONE))
    assert held.q_start is not None
    tool = CellState(held.cell, held.q_start).T_world_tool[0]
    start = pin.SE3(pin.utils.rotate("z", np.pi / 2), np.array([0.5, 0.0, 0.5]))
    for task in (
        load_cell_task(written(tmp_path, ONE | {"path": line})),
        load_cell_task(written(tmp_path, plain | {"phases": rest})),
        load_search(written(tmp_path, ONE | {"path": SEARCH | {"start": START}, "collision": {"obstacles": [BALL]}}))[
            1
        ],
    ):
        found = task.grasp.T_object_tool[0]
        np.testing.assert_allclose(found.homogeneous, start.actInv(tool).homogeneous, atol=1e-12)


def test_the_first_arm_that_is_missing_is_named(tmp_path: Path) -> None:
    for tables, message in (
        (TWO | {"start": {"positions_rad": {"c": [0.0]}}}, r"no arm named 'c' in start\.positions_rad"),
        (TWO | {"start": {"positions_rad": {"b": NEAR}}}, r"start\.positions_rad: arm 'a' is missing\."),
        (TWO | {"grasp": {"kind": "tools", "tools": {}}}, r"grasp\.tools: arm 'a' is missing\."),
        (TWO | {"grasp": {"kind": "tools", "tools": {"a": {}}}}, r"grasp\.tools: arm 'b' is missing\."),
        (TWO | {"start": {"positions_rad": {"a": NEAR, "b": NEAR[:5]}}}, r"positions_rad\.b has 5 numbers for 6"),
        (TWO | {"start": {}}, r"a latched grasp follows from the start, .* give start\.positions_deg"),
        (TWO | {"grasp": {"kind": "triangle", "alpha_m": 1.0, "beta_m": 1.0}}, r"cell\.toml: "),
    ):
        with pytest.raises(CellFileError, match=message):
            load_cell_task(written(tmp_path, tables))


def task_near(away: float, joint: int, arm: dict[str, Any], x: list[float], folder: Path) -> CellTask:
    """A task whose start is away from where the grasp is by a joint's motion [rad or m]."""
    exact = load_cell_task(written(folder, ONE | {"arms": [arm], "start": {"positions_rad": {"a": x}}}))
    assert exact.q_start is not None
    q = exact.q_start.copy()
    q[joint] += away
    return replace(exact, q_start=q, start_is_near=True)


RAIL = {"name": "a", "robot": "gantry7", "geometry": False, "locked_joints_rad": {"joint_7": 0.3}}


@pytest.mark.parametrize(
    ("arm", "x", "joint", "near", "far", "said"),
    [
        (ARM, np.deg2rad(NEAR).tolist(), 1, 0.34, 0.36, r"start: arm a takes hold with joint_2 20\.6° from the pos"),
        (ARM, np.deg2rad(NEAR).tolist(), 2, -0.34, -0.36, r"start: arm a takes hold with joint_3 20\.6° from"),
        (RAIL, [0.1, 0.2, 0.5, 1.2, 0.3, -0.9], 0, 0.09, 0.11, r"arm a takes hold with joint_1 110\.0 mm from"),
    ],
)
def test_a_start_that_is_far_from_what_is_given_is_told(
    arm: dict[str, Any], x: list[float], joint: int, near: float, far: float, said: str, tmp_path: Path
) -> None:
    """And corrected: where the arm has six joints there is one configuration near."""
    task = task_near(near, joint, arm, x, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", StartWarning)
        found = task.exact_start()
    assert found is not None
    assert found.tolist() == pytest.approx(x, abs=1e-6)
    with pytest.warns(StartWarning, match=said):
        task_near(far, joint, arm, x, tmp_path).exact_start()


def test_a_start_that_is_exact_or_is_to_be_found_is_left_as_it_is(tmp_path: Path) -> None:
    given = np.deg2rad(NEAR)
    task = task_near(0.0, 0, ARM, given.tolist(), tmp_path)
    assert replace(task, start_is_near=False).exact_start() is task.q_start
    assert replace(task, q_start=None).exact_start() is None
    paper = load_cell_task(example_path("paper_lift"))
    assert paper.start_is_near
    assert paper.q_start is not None


def test_a_run_is_not_longer_than_ten_million_steps(tmp_path: Path) -> None:
    """At most ten times a million steps, rests at the end included."""
    fast = ONE | {"dt_s": 0.001}
    load_cell_file(written(tmp_path, fast | {"longest_s": 9000.0, "settle_s": 1000.0}))
    for more in ({"longest_s": 10_001.0}, {"longest_s": 9000.0, "settle_s": 1001.0}):
        with pytest.raises(CellFileError, match=r"a run of up to \d+ s in steps of 0.001 s is too long; raise dt_s"):
            load_cell_file(written(tmp_path, fast | more))
    tens = {"path": {"kind": "hold", "pose": {}, "duration_s": 1001.0}}
    with pytest.raises(CellFileError, match=r"a run of up to 10010 s in steps of 0.001 s"):
        load_cell_file(written(tmp_path, fast | tens))  # ten times the path


def test_a_step_is_given_or_a_share_of_the_path(tmp_path: Path) -> None:
    for more, dt in (({}, 0.002), ({"dt_s": 0.01}, 0.01), ({"steps": 250}, 0.004)):
        run = load_cell_file(written(tmp_path, ONE | more))
        assert run.scenario.dt == dt
    whole = load_cell_file(written(tmp_path, ONE | {"settle_s": 0.5, "longest_s": 7.0}))
    assert (whole.settle, whole.longest, whole.file) == (0.5, 7.0, tmp_path / "cell.toml")


def test_the_object_of_a_file_is_that_of_the_run(tmp_path: Path) -> None:
    box = {"size_m": [0.1, 0.2, 0.3], "centre": {"xyz_m": [0.0, 0.0, 0.15]}, "mass_kg": 3.0}
    ball = {"name": "ball", "shape": "sphere", "radius_m": 0.1, "at": {"xyz_m": [0.0, 0.0, 5.0]}}
    collision = {"obstacles": [ball], "avoid": False}
    run = load_cell_file(written(tmp_path, ONE | {"object": box, "collision": collision}))
    s = run.scenario
    assert (s.object_size, s.object_mass) == ((0.1, 0.2, 0.3), 3.0)
    np.testing.assert_array_equal(s.T_object_body.translation, [0.0, 0.0, 0.15])
    assert [body.name for body in s.obstacles] == ["ball"]
    assert not run.avoids
    assert run.scene is not None
    assert [body.name for body in run.scene.carried] == ["object"]
    assert run.metadata() == {
        "scenario": "one",
        "method": "qp",
        "object": {"size_m": [0.1, 0.2, 0.3], "T_object_body": s.T_object_body.homogeneous.tolist()},
        "settings": {**ONE, "object": box, "collision": collision},
    }
    assert load_cell_file(written(tmp_path, ONE | {"collision": {"obstacles": [ball]}})).avoids
    plain = load_cell_file(written(tmp_path, ONE))
    assert not plain.avoids
    assert plain.scenario.obstacles == ()


def test_a_run_is_as_long_as_the_file_says(tmp_path: Path) -> None:
    """The path, and what it settles; at most the longest; where the object is blocked, until patience ends."""
    short = ONE | {"dt_s": 0.01, "path": {"kind": "hold", "pose": {}, "duration_s": 0.05}}
    run = load_cell_file(written(tmp_path, short | {"settle_s": 0.03}))
    told: list[tuple[int, int]] = []
    steps: list[int] = []
    recording = run.run(progress=lambda step, of: told.append((step, of)), operate=lambda _, step: steps.append(step))
    assert recording.finished
    assert recording.time[-1] == pytest.approx(0.08)
    assert steps == list(range(recording.n_steps))
    assert told
    assert recording.metadata["scenario"] == "one"
    bounded = load_cell_file(written(tmp_path, short | {"longest_s": 0.03})).run()
    assert not bounded.finished
    assert bounded.time[-1] == pytest.approx(0.03)
    slowed = run.run(begun={"override": 0.5, "paused": False})
    assert slowed.time[-1] > 0.1
    narrow = {"lower_deg": [x - 0.5 for x in NEAR], "upper_deg": [x + 0.5 for x in NEAR]}
    line = {"kind": "line", "start": {}, "displacement": {"translation_m": [0.0, 0.1, 0.0]}, "duration_s": 1.0}
    blocked = ONE | {"dt_s": 0.01, "arms": [ARM | {"limits": narrow}], "path": line}
    ends = [
        load_cell_file(written(tmp_path, blocked | {"patience_s": patience})).run().time[-1] for patience in (0.1, 0.3)
    ]
    assert ends[1] - ends[0] == pytest.approx(0.2, abs=0.011)
    assert ends[1] < 5.0  # without patience it goes on for ten times the path


def test_a_controller_that_refuses_the_path_is_told_when_the_file_is_read(tmp_path: Path) -> None:
    with pytest.raises(CellFileError, match=r"cell\.toml: .*increment needs a path"):
        load_cell_file(written(tmp_path, ONE | {"controller": {"kind": "pseudo_inverse"}}))


def test_a_run_of_the_code_is_only_judged_unless_it_says_otherwise(tmp_path: Path) -> None:
    run = load_cell_file(written(tmp_path, ONE))
    plain = CellRun(run.scenario, "qp", QPOptions(), 0.0, None, run.settings)
    assert (plain.avoids, plain.disturbances, plain.stiffness, plain.scene, plain.file) == (False, *[None] * 4)


def test_bodies_that_are_avoided_are_rows_of_the_controller(tmp_path: Path) -> None:
    wall = BALL | {"at": {"xyz_m": [0.0, 0.0, 8.0]}}
    found = [
        load_cell_file(written(tmp_path, ONE | {"collision": {"obstacles": [wall], "avoid": avoid}})).run()
        for avoid in (True, False)
    ]
    assert [recording.metadata["clearance"]["avoided"] for recording in found] == [True, False]
    avoiding, judging = (
        load_cell_file(written(tmp_path, ONE | {"collision": {"obstacles": [wall], "avoid": avoid}})).controller()
        for avoid in (True, False)
    )
    assert isinstance(avoiding, QPController)
    assert isinstance(judging, QPController)
    assert len(avoiding.constraints) == len(judging.constraints) + 1


# -- bodies ------------------------------------------------------------------------------------------------------------


def test_bodies_of_a_file_are_those_of_the_code(tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n", encoding="utf-8"
    )
    (tmp_path / "a.srdf").write_text('<robot name="rx90l"/>', encoding="utf-8")
    at = {"xyz_m": [1.0, 2.0, 3.0], "rpy_deg": [0, 0, 90]}
    obstacles = [
        {"name": "table", "shape": "box", "size_m": [0.1, 0.2, 0.3], "at": at},
        {"name": "ball", "shape": "sphere", "radius_m": 0.4, "at": at},
        {"name": "tube", "shape": "cylinder", "radius_m": 0.1, "length_m": 0.5, "at": at},
        {"name": "pole", "shape": "capsule", "radius_m": 0.2, "length_m": 0.6, "at": at},
        {"name": "part", "shape": "mesh", "file": "part.obj", "scale": 0.5, "at": at},
    ]
    shell = {"name": "shell", "shape": "sphere", "radius_m": 0.05}
    collision = {
        "margin_m": 0.03,
        "obstacles": obstacles,
        "carried": [{"name": "load", "shape": "box", "size_m": [0.1, 0.1, 0.1]}],
        "on_links": [shell | {"link": "a/link_6"}, shell | {"name": "cap", "link": "a/link_6"}],
        "without": ["a/link_6"],
        "margins": [{"between": ["table", "a"], "margin_m": 0.2}, {"between": ["load", "ball"], "margin_m": 0.0}],
        "ignored": [["a", "tube"], ["load", "pole"]],
        "inside": [["part", "a"]],
        "srdf": {"a": "a.srdf"},
        "apart": 2,
        "object_apart": 4,
    }
    arm = {"name": "a", "robot": "rx90l"}
    scene = load_cell_task(written(tmp_path, ONE | {"arms": [arm], "collision": collision})).scene
    assert scene is not None
    shapes = {body.name: body.shape for body in scene.obstacles}
    assert isinstance(shapes["table"], Box)
    assert shapes["table"].size == (0.1, 0.2, 0.3)
    assert shapes["ball"] == Sphere(0.4)
    assert shapes["tube"] == Cylinder(0.1, 0.5)
    assert shapes["pole"] == Capsule(0.2, 0.6)
    part = shapes["part"]
    assert isinstance(part, Mesh)
    assert (part.file, part.scale) == (tmp_path / "part.obj", (0.5, 0.5, 0.5))
    for body in scene.obstacles:
        there = pin.SE3(pin.utils.rotate("z", np.pi / 2).round(), np.array([1.0, 2.0, 3.0]))
        np.testing.assert_array_equal(as_placement(body.placement, "").homogeneous, there.homogeneous)
    assert [body.name for body in scene.carried] == ["load"]
    assert [body.name for body in scene.on_links["a/link_6"]] == ["shell", "cap"]
    assert (scene.margin, scene.without) == (0.03, ("a/link_6",))
    assert scene.margins == {("table", "a"): 0.2, ("load", "ball"): 0.0}
    assert (scene.ignored, scene.inside) == ((("a", "tube"), ("load", "pole")), (("part", "a"),))
    assert scene.srdf == {"a": tmp_path / "a.srdf"}
    assert (scene.rules.apart, scene.rules.object_apart) == (2, 4)
    assert scene.decompose == ()


@pytest.mark.parametrize(
    ("collision", "message"),
    [
        ({"without": ["a/link_9"]}, "link_9"),
        ({"decompose": ["nothing"]}, "nothing"),
        ({"obstacles": [BALL], "ignored": [["a", "nothing"]]}, "nothing"),
        ({"srdf": {"a": "$NO_SUCH_FOLDER/a.srdf"}}, r"collision\.srdf\.a: the environment variable \$NO_SUCH_FOLDER"),
        (
            {"obstacles": [{"name": "part", "shape": "mesh", "file": "package://none/x.obj"}]},
            r"collision: body 'part': there is no package 'none'",
        ),
    ],
)
def test_a_wrong_body_is_named(collision: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(CellFileError, match=message):
        load_cell_task(written(tmp_path, ONE | {"collision": collision}))


# -- searches ----------------------------------------------------------------------------------------------------------

POST = {"name": "post", "shape": "sphere", "radius_m": 0.05, "at": {"xyz_m": [5.0, 0.0, 0.0]}}
TOOL: dict[str, Any] = {"xyz_m": [0.9, 0.0, 0.1], "rpy_deg": [0, 90, 0]}
SEARCH: dict[str, Any] = {"kind": "search", "start": TOOL, "goal": TOOL | {"xyz_m": [0.9, 0.1, 0.1]}}
SEARCHED: dict[str, Any] = ONE | {
    "grasp": {"kind": "tools", "tools": {"a": {}}}, "start": {}, "path": SEARCH, "collision": {"obstacles": [POST]},
}  # fmt: skip


def test_a_search_of_a_file_is_asked_as_its_table_says(tmp_path: Path) -> None:
    goal = TOOL | {"free": [{"axis": "rz"}, {"axis": "rx", "range_deg": [-30, 60]}]}
    region = {"low_m": [0.0, 0.1, 0.2], "high_m": [1.0, 1.1, 1.2]}
    more = {"clearance_m": 0.02, "time_limit_s": 3.0, "nodes": 70, "seed": 5, "speed_m_per_s": 0.5}
    path = SEARCH | {"goal": goal, "region": region} | more
    settings, search = load_search(written(tmp_path, SEARCHED | {"path": path}))
    assert settings.name == "one"
    assert search.options == {
        "region": [[0.0, 0.1, 0.2], [1.0, 1.1, 1.2]], "clearance": 0.02, "time_limit": 3.0, "nodes": 70, "seed": 5,
    }  # fmt: skip
    assert search.speed == 0.5
    np.testing.assert_array_equal(search.start.translation, [0.9, 0.0, 0.1])
    assert isinstance(search.goal, TurnedGoal)
    turns = [FreeTurn("rz", -np.pi, np.pi), FreeTurn("rx", -np.pi / 6, np.pi / 3)]
    for found, turn in zip(search.goal.free, turns, strict=True):
        assert found.axis == turn.axis
        assert [found.low, found.high] == pytest.approx([turn.low, turn.high])
    assert search.q_start is None
    assert search.scene is not None
    plain = load_search(written(tmp_path, SEARCHED))[1]
    assert plain.options == {"clearance": 0.0, "time_limit": 10.0, "nodes": 100_000, "seed": 0}
    assert isinstance(plain.goal, pin.SE3)
    np.testing.assert_array_equal(plain.goal.translation, [0.9, 0.1, 0.1])
    assert plain.speed == 0.25


def test_a_way_round_is_searched_between_the_ends_of_another_path(tmp_path: Path) -> None:
    line = {"kind": "line", "start": TOOL, "displacement": {"translation_m": [0.0, 0.1, 0.0]}, "duration_s": 2.0}
    _, search = load_search(written(tmp_path, SEARCHED | {"path": line}))
    assert isinstance(search.goal, pin.SE3)
    np.testing.assert_allclose(search.goal.translation - search.start.translation, [0.0, 0.1, 0.0], atol=1e-12)
    assert (search.options, search.speed) == ({}, 0.25)
    phases = [{"name": "p", "path": line}]
    tables = {key: value for key, value in SEARCHED.items() if key != "path"}
    for bad, message in (
        (tables | {"phases": phases}, "cell.toml: no way round is searched for phases: give the path of one phase"),
        ({key: value for key, value in SEARCHED.items() if key != "collision"}, r"add a table \[collision\] with obst"),
    ):
        with pytest.raises(CellFileError, match=message):
            load_search(written(tmp_path, bad))


def test_a_search_begins_at_the_start_that_is_given(tmp_path: Path) -> None:
    """Corrected where it is only near."""
    found = load_cell_file(written(tmp_path, SEARCHED | {"path": {"kind": "hold", "pose": TOOL, "duration_s": 1.0}}))
    exact = found.scenario.q_start
    for near in (True, False):
        given = {"positions_rad": {"a": (exact + 0.01).tolist()}, "inverse_kinematics": near}
        _, search = load_search(written(tmp_path, SEARCHED | {"start": given}))
        assert search.q_start is not None
        assert search.q_start.tolist() == pytest.approx((exact if near else exact + 0.01).tolist(), abs=1e-7)


def test_a_way_takes_the_time_that_its_speed_needs(tmp_path: Path) -> None:
    """Three times the speed is a third of the time, elbows included; the way stays, and what is proved of it."""
    _, search = load_search(written(tmp_path, SEARCHED))
    T = search.start
    line = LinePath(T, T * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2])), duration=1.0).geometry()
    assert line is not None
    profile = SpeedProfile(np.array([0.0, 0.1, line.length]), np.array([0.0, 0.25, 0.0]))
    x = np.zeros((2, 6))
    elbows = Elbows(np.array([0.0, profile.duration]), x, x + 1.0)
    way = TimedPath(line, profile, keeps_clear=True, elbows=elbows)
    path = replace(search, speed=1.5).path(Route(verdict=RouteVerdict.FOUND, path=way))
    assert path.duration == pytest.approx(way.duration / 3.0)
    assert path.profile.squares.max() == pytest.approx(2.25)
    assert path.keeps_clear
    assert path.elbows is not None
    np.testing.assert_allclose(path.elbows.clocks, elbows.clocks / 3.0)
    np.testing.assert_allclose(path.elbows.slopes, 3.0)
    for share in (0.0, 0.3, 1.0):
        ours, theirs = (p.pose(share * p.duration).homogeneous for p in (path, way))
        np.testing.assert_allclose(ours, theirs, atol=1e-12)
    plain = search.path(Route(verdict=RouteVerdict.FOUND, path=TimedPath(line, profile)))
    assert plain.elbows is None
    assert not plain.keeps_clear
    for verdict, kind in ((RouteVerdict.INFEASIBLE, UnreachableError), (RouteVerdict.NOT_FOUND, UndecidedError)):
        with pytest.raises(kind, match="too high"):
            search.path(Route(verdict=verdict, reason="too high"))


def test_what_a_file_makes_is_one_thing_and_stays_as_it_is(tmp_path: Path) -> None:
    """A copy is another key; nothing can be set."""
    run, task = load_cell_file(written(tmp_path, ONE)), load_cell_task(written(tmp_path, ONE))
    _, search = load_search(written(tmp_path, SEARCHED))
    for made, name in ((run, "settle"), (task, "name"), (search, "speed")):
        assert len({made, replace(made), made}) == 2
        with pytest.raises(FrozenInstanceError):
            setattr(made, name, getattr(made, name))
    with pytest.raises(ValidationError, match="frozen"):
        run.settings.name = "other"
    parts: list[Any] = [getattr(search, entry.name) for entry in fields(search)]
    make: Any = SearchTask
    with pytest.raises(TypeError):
        make(*parts)  # each has a name


# -- controllers and plants --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("solver", "settings", "name"),
    [
        ("proxqp", {"max_iter": 50}, "ProxqpSettings"),
        ("osqp", {"max_iter": 60}, "OsqpSettings"),
        ("daqp", {}, "DaqpSettings"),
        ("ldp", {}, "LdpSettings"),
        ("auto", {}, "LdpSettings"),
        (None, {}, "LdpSettings"),
        ("quadprog", {}, "GenericSettings"),
    ],
)
@pytest.mark.parametrize("kind", ["qp", "independent"])
def test_settings_of_a_solver_are_those_of_its_kind(
    kind: str, solver: str | None, settings: dict[str, Any], name: str, tmp_path: Path
) -> None:
    from coopqp.files.cellfile.build import controller_options, read

    chosen = {} if solver is None else {"solver": solver}
    tables = ONE | {"controller": {"kind": kind, "solver_settings": settings, **chosen}}
    options = controller_options(kind, read(written(tmp_path, tables)).controller)
    made = options.solver_settings
    if kind == "independent" and solver is None:
        assert type(made).__name__.lower() == f"{type(options)().solver}settings".replace("auto", "ldp")
    else:
        assert type(made).__name__ == name
    for key, value in settings.items():
        assert getattr(made, key) == value
    wrong = tables | {"controller": {"kind": kind, "solver_settings": {"options": 1}, **chosen}}
    with pytest.raises(UnknownNameError, match=r"no setting named 'options' in \w+Settings") as caught:
        controller_options(kind, read(written(tmp_path, wrong)).controller)
    assert "options" not in caught.value.available


def test_only_a_qp_that_looks_ahead_is_led(tmp_path: Path) -> None:
    for controller in (
        {"kind": "independent"},
        {"kind": "pseudo_inverse", "increment": "exact"},
        {"kind": "qp", "preview": False},
    ):
        run = load_cell_file(written(tmp_path, ONE | {"controller": controller}))
        assert run.led() is run
    run = load_cell_file(written(tmp_path, ONE))
    assert isinstance(run.options, QPOptions)
    assert run.led().scenario.q_start is run.scenario.q_start


def test_a_plant_is_what_the_file_says(tmp_path: Path) -> None:
    """Any cell may also be put into the engine, with default settings."""
    pytest.importorskip("mujoco")
    kinematic = load_cell_file(written(tmp_path, ONE))
    assert isinstance(kinematic.plant(), KinematicPlant)
    assert isinstance(kinematic.physics_plant(), PhysicsPlant)
    sensors = {"a": {"force_gain": -1.0, "delay_s": 0.01, "bias_force_n": [1.0, 2.0, 3.0]}}
    noisy = {"wrench_noise_n": 2.0, "wrench_drop_share": 0.1, "sensors": sensors, "seed": 7}
    physics = load_cell_file(written(tmp_path, ONE | {"plant": {"kind": "physics"}, "disturbances": noisy}))
    assert isinstance(physics.plant(), PhysicsPlant)
    found = physics.disturbances
    assert found is not None
    assert (found.wrench_noise, found.wrench_drop_share, found.seed) == (2.0, 0.1, 7)
    assert (found.sensors["a"].force_gain, found.sensors["a"].delay) == (-1.0, 0.01)
    np.testing.assert_array_equal(found.sensors["a"].bias, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    assert kinematic.disturbances is None


def test_known_sensors_are_those_of_the_arms_that_tell_them(tmp_path: Path) -> None:
    tables = TWO | {"arms": [TWO["arms"][0], TWO["arms"][1] | {"sensor": {"torque_gain": 1000.0}}]}
    run = load_cell_file(written(tmp_path, tables))
    assert list(run.sensors) == ["b"]
    assert run.sensors["b"].torque_gain == 1000.0
    dead = TWO | {"arms": [TWO["arms"][0] | {"sensor": {"force_gain": 0.0}}, TWO["arms"][1]]}
    with pytest.raises(CellFileError, match="the sensor of arm a is dead"):
        load_cell_file(written(tmp_path, dead))


# -- drivers -----------------------------------------------------------------------------------------------------------

UR = {"kind": "ur", "address": "192.0.2.1"}


def test_each_arm_has_the_driver_of_its_table(tmp_path: Path) -> None:
    pytest.importorskip("rtde_control")
    drivers = {"a": UR | {"period": 0.008}, "b": {"kind": "sim", "lag": 0.02}}
    run = load_cell_file(written(tmp_path, TWO | {"drivers": drivers}))
    made = run.drivers()
    assert list(made) == ["a", "b"]
    first, second = made["a"], made["b"]
    assert isinstance(first, UrDriver)
    assert isinstance(second, SimDriver)
    assert (first.period, second.lag) == (0.008, 0.02)
    assert first.joint_names == tuple(f"joint_{k}" for k in range(1, 7))
    simulated = run.drivers("sim")  # a table of another kind says nothing of it
    assert {name: driver.lag for name, driver in simulated.items()} == {"a": 0.01, "b": 0.02}
    assert all(isinstance(driver, SimDriver) for driver in simulated.values())
    with pytest.raises(UnknownNameError, match=r"no driver named 'ur' in drive\. Available: sim, engine"):
        run.drivers("ur")


def test_robots_in_the_engine_stand_for_all_drivers(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    run = load_cell_file(written(tmp_path, TWO | {"drivers": {"a": UR}}))
    robots = run.drivers("engine")
    assert list(robots) == ["a", "b"]
    assert all(robot.period == run.scenario.dt for robot in robots.values())


def test_wrong_drivers_are_named(tmp_path: Path) -> None:
    """Each error names the file, and what there is."""
    for drivers, message in (
        ({"c": UR}, r"cell\.toml: drivers: no arm named 'c'; arms: a, b\."),
        ({"a": UR}, r"cell\.toml: arm 'b' has no driver\. Give a table \[drivers\.b\], or --driver sim\."),
        ({"a": UR | {"gain": 1.0}, "b": UR}, r"cell\.toml: drivers\.a: UrOptions: gain is 1\."),
        ({"a": {"kind": "ur"}, "b": UR}, r"cell\.toml: drivers\.a: UrDriver: no address\."),
    ):
        run = load_cell_file(written(tmp_path, TWO | {"drivers": drivers}))
        with pytest.raises(CellFileError, match=message):
            run.drivers()


LIFT: dict[str, Any] = {
    "name": "lift",
    "robots": [{"name": "tower", "robot": "lift2", "geometry": False}],
    "arms": [{"name": name, "of": "tower", "tool_frame": f"{name}_tool"} for name in ("left", "right")],
    "grasp": {"kind": "latched"},
    "start": {"positions_deg": {"tower": [0.15], "left": NEAR, "right": NEAR}},
    "path": {"kind": "hold", "pose": {}, "duration_s": 1.0},
}


@pytest.mark.parametrize(
    ("drivers", "message"),
    [
        ({"other": {"kind": "sim"}}, "drivers: no robot or arm named 'other'; robots: tower; arms: left, right."),
        ({}, "robot 'tower' (tower/lift, left, right) has no driver. Give a table [drivers.tower], or --driver sim."),
        ({"left": UR}, "robot 'tower' (tower/lift, right) has no driver. Give a table [drivers.tower]"),
        (
            {"tower": UR},
            "drivers.tower: a driver 'ur' has one arm, and this robot has tower/lift, left, right. Give each arm a "
            "table of its own, [drivers.left], [drivers.right], and [drivers.tower] another kind for tower/lift.",
        ),
        (
            {"tower": UR, "right": UR},
            "drivers.tower: a driver 'ur' has one arm, and this robot has tower/lift, left. Give each arm a table of "
            "its own, [drivers.left], and [drivers.tower] another kind for tower/lift.",
        ),
        (
            {"tower": UR, "left": {"kind": "sim"}, "right": {"kind": "sim"}},
            "drivers.tower: a driver 'ur' has one arm, and this robot has tower/lift. Give [drivers.tower] another "
            "kind for tower/lift.",
        ),
    ],
)
def test_drivers_of_a_robot_with_two_arms_are_refused_with_a_remedy(
    drivers: dict[str, Any], message: str, tmp_path: Path
) -> None:
    run = load_cell_file(written(tmp_path, LIFT | {"drivers": drivers}))
    with pytest.raises(CellFileError) as caught:
        run.drivers()
    assert message in str(caught.value)


def test_a_robot_in_simulation_stands_at_the_start(tmp_path: Path) -> None:
    """Its driver has the lift and both arms, in the order of the cell."""
    run = load_cell_file(written(tmp_path, LIFT))
    (driver,) = run.drivers("sim").values()
    assert driver.joint_names[:2] == ("lift", "left_joint_1")
    assert len(driver.joint_names) == 13
    locked = LIFT | {"robots": [LIFT["robots"][0] | {"locked_joints_rad": {"lift": 0.15}}]}
    locked["start"] = {"positions_deg": {"left": NEAR, "right": NEAR}}
    alone = load_cell_file(written(tmp_path, locked | {"drivers": {"tower": UR}}))
    with pytest.raises(
        CellFileError, match=r"has one arm, and this robot has left, right\. Give each arm a table of i"
    ):
        alone.drivers()
    both = {"tower": {"kind": "sim"}, "left": {"kind": "sim"}, "right": {"kind": "sim"}}
    run = load_cell_file(written(tmp_path, locked | {"drivers": both}))
    with pytest.raises(CellFileError, match=r"drivers\.tower: every arm of this robot has a driver of its own\. Leave"):
        run.drivers()
