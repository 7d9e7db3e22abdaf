"""Phases of a cell file are the program that one would write in code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import HoldPath, LinePath, TimedPath, WaypointPath
from coopqp.files import CellFileError
from coopqp.files.cellfile import load_cell_task
from coopqp.files.cellfile.write import file_text
from coopqp.paths.joint_path import JointPath
from coopqp.paths.timed import SpeedProfile
from coopqp.programs import Program
from coopqp.programs.roles import Follows, FollowsJoints, Holds, Slides, Travels, Turns, Waits, Works
from coopqp.scenarios import Scenario
from coopqp.spatial import Array

#: Where the tool of slave_2 holds, and the object's pose at the start.
X = {"xyz_m": [0.3, 1.8, 0.0], "rpy_deg": [90, 0, 0]}
BEGIN = {"xyz_m": [0.9, 0.0, 0.1], "rpy_deg": [0, 0, -90]}
UPWARD = np.array([0.0, 0.0, 1.0])
LINE: dict[str, Any] = {"kind": "line", "duration_s": 2.0}
UP = LINE | {"displacement": {"translation_m": [0.0, 0.0, 0.15], "rotation_vector_deg": [0.0, 0.0, 20.0]}}


def tables(phases: list[Any], **more: Any) -> dict[str, Any]:
    """The paper's arms and grasp, with phases."""
    arms = [("master", 0.0, 0.0, 0), ("slave_1", 3.6, 0.5, 180), ("slave_2", 3.6, -0.5, 180)]
    return {
        "name": "phases",
        "arms": [
            {"name": name, "robot": "rx90l", "geometry": False, "base": {"xyz_m": [x, y, 0.0], "rpy_deg": [0, 0, yaw]}}
            for name, x, y, yaw in arms
        ],
        "grasp": {"kind": "triangle", "alpha_m": 0.6, "beta_m": 0.3},
        "phases": phases,
        **more,
    }


def program_of(folder: Path, phases: list[Any], **more: Any) -> Program:
    """The program of a file with phases; no start is searched."""
    file = folder / "phases.toml"
    file.write_text(file_text([], tables(phases, **more)), encoding="utf-8")
    path = load_cell_task(file).path
    assert isinstance(path, Program)
    return path


def placed(T: Any) -> Array:
    return np.asarray(T.homogeneous)


def same_path(ours: Any, theirs: Any) -> None:
    assert type(ours) is type(theirs)
    assert ours.duration == pytest.approx(theirs.duration)
    for clock in np.linspace(0.0, theirs.duration, 7).tolist():
        np.testing.assert_allclose(placed(ours.pose(clock)), placed(theirs.pose(clock)), atol=1e-12)


def timed(length: float, share: float | None) -> TimedPath:
    """A way up by a length [m], from the object's pose at the start."""
    T = start_pose()
    line = LinePath(T, T * pin.SE3(np.eye(3), np.array([0.0, 0.0, length])), duration=1.0).geometry()
    assert line is not None
    s = np.linspace(0.0, line.length, 3)
    return TimedPath(line, SpeedProfile(s, np.array([0.0, 0.01, 0.0])), planned_share=share)


def table_of(path: TimedPath) -> dict[str, Any]:
    record = path.record()
    share = {} if path.planned_share is None else {"planned_share": path.planned_share}
    return {"kind": "timed", "pieces": record["pieces"], "s_m": record["s"], "squares": record["squares"], **share}


def start_pose() -> pin.SE3:
    return pin.SE3(pin.utils.rotate("z", -np.pi / 2), np.array([0.9, 0.0, 0.1]))


# -- what an arm does ------------------------------------------------------------------------------------------------


def test_roles_of_a_file_are_those_of_the_code(tmp_path: Path) -> None:
    poses = [X, X | {"xyz_m": [0.3, 1.8, 0.05]}]
    away = {"xyz_m": [0.2, 1.8, 0.0], "rpy_deg": [90, 0, 0]}
    frame = {"xyz_m": [0.1, 0.2, 0.3], "rpy_rad": [0.0, 0.0, 0.4]}
    hold = {"kind": "hold", "pose": {"xyz_m": [1.0, 2.0, 3.0]}, "duration_s": 0.25}
    turns = {"kind": "turns", "about_m": [0.0, 0.8, 0.1]}
    phases: list[dict[str, Any]] = [
        {"name": "lift", "path": UP | {"start": BEGIN}},
        {"name": "waits", "duration_s": 0.5, "until": "go", "arms": {"slave_2": {"kind": "waits"}}},
        {"name": "works", "arms": {"slave_2": {"kind": "works", "poses": poses, "durations_s": [1.5]}}},
        {
            "name": "back",
            "arms": {
                "slave_2": {"kind": "works", "poses": poses[::-1], "durations_s": [0.5], "time_law": "linear"},
                "master": {"kind": "holds"},
            },
        },
        {"name": "travels", "duration_s": 1.0, "arms": {"slave_2": {"kind": "travels", "to": away}}},
        {"name": "near", "duration_s": 1.0, "arms": {"slave_2": {"kind": "travels", "to": X, "retreat_m": 0.01}}},
        {"name": "open", "duration_s": 2.0, "arms": {"slave_1": turns | {"angle_deg": 9.0}}},
        {
            "name": "tilt", "duration_s": 2.0,
            "arms": {"slave_1": turns | {"angle_rad": -0.1, "axis": [0.0, 3.0, 4.0], "holds": False}},
        },
        {"name": "slide", "duration_s": 1.0, "arms": {
            "slave_2": {"kind": "slides", "axis": [0.0, 0.0, 2.0], "distance_m": -0.02}, "slave_1": {"kind": "waits"}}},
        {"name": "rest", "arms": {
            "slave_2": {"kind": "follows", "frame": frame, "path": hold, "holds": False, "holds_after": True},
            "slave_1": {"kind": "waits"}}},
    ]  # fmt: skip
    program = program_of(tmp_path, phases, signals_s={"go": 3.0}, attach={"distance_mm": 3.0, "angle_deg": 0.5})
    assert [phase.name for phase in program.phases] == [phase["name"] for phase in phases]
    assert [phase.until for phase in program.phases] == [None, "go", *[None] * 8]
    assert [phase.seconds for phase in program.phases] == [2.0, 0.5, 1.5, 0.5, 1.0, 1.0, 2.0, 2.0, 1.0, 0.25]
    assert program.signals == {"go": 3.0}
    assert (program.attach_m, program.attach_rad) == pytest.approx((0.003, np.deg2rad(0.5)))
    roles = {phase.name: phase.arms for phase in program.phases}
    assert roles["lift"] == {}
    assert roles["waits"] == {"slave_2": Waits()}
    assert isinstance(roles["back"]["master"], Holds)
    X2 = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([0.3, 1.8, 0.0]))
    up = pin.SE3(X2.rotation, X2.translation + 0.05 * UPWARD)
    for name, law, wanted in (("works", "quintic", [X2, up]), ("back", "linear", [up, X2])):
        role = roles[name]["slave_2"]
        assert isinstance(role, Works)
        assert role.duration is not None
        same_path(role.on, WaypointPath(wanted, durations=[role.duration], time_law=law))
    for name, x, retreat in (("travels", 0.2, 0.05), ("near", 0.3, 0.01)):
        role = roles[name]["slave_2"]
        assert isinstance(role, Travels)
        np.testing.assert_allclose(placed(role.to), placed(pin.SE3(X2.rotation, np.array([x, 1.8, 0.0]))), atol=1e-12)
        assert role.retreat_m == retreat
    for name, angle, axis, holds in (
        ("open", np.deg2rad(9.0), (0.0, 0.0, 1.0), True),
        ("tilt", -0.1, (0.0, 0.6, 0.8), False),
    ):
        role = roles[name]["slave_1"]
        assert isinstance(role, Turns)
        assert role.angle == pytest.approx(angle)
        assert role.holds is holds
        assert role.axis == pytest.approx(axis)
        np.testing.assert_allclose(placed(role.about), placed(pin.SE3(np.eye(3), np.array([0.0, 0.8, 0.1]))))
    slide = roles["slide"]["slave_2"]
    assert isinstance(slide, Slides)
    assert (slide.axis, slide.distance_m) == ((0.0, 0.0, 1.0), -0.02)
    follow = roles["rest"]["slave_2"]
    assert isinstance(follow, Follows)
    assert (follow.holds, follow.holds_after) == (False, True)
    same_path(follow.on, HoldPath(pin.SE3(np.eye(3), np.array([1.0, 2.0, 3.0])), duration=0.25))
    wanted_frame = pin.SE3(pin.utils.rotate("z", 0.4), np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(placed(follow.frame), placed(wanted_frame), atol=1e-12)


def test_a_way_of_joints_is_that_of_the_code(tmp_path: Path, paper: Scenario) -> None:
    """In degrees and in radians; straight from row to row, or through them with speeds."""
    x = paper.cell.positions(paper.q_start)
    given = {name: x[own].tolist() for name, own in paper.cell.blocks.items()}
    here = np.array(given["slave_2"])
    rows, times = np.array([here, here + 0.2, here - 0.1, here]), [0.4, 0.5, 0.6]
    speeds = np.array([0.0 * here, 0.3 + 0.0 * here, 0.0 * here - 0.1, 0.0 * here])
    role = {"kind": "follows_joints", "durations_s": times}
    phases = [
        {"name": "deg", "arms": {"slave_2": role | {"positions_deg": np.rad2deg(rows).tolist()}}},
        {"name": "rad", "arms": {"slave_2": role | {"positions_rad": rows.tolist()}}},
        {
            "name": "speeds",
            "arms": {"slave_2": role | {"positions_rad": rows.tolist(), "speeds_rad_per_s": speeds.tolist()}},
        },
        {"name": "rest", "path": UP | {"start": BEGIN}, "arms": {"slave_2": {"kind": "waits"}}},
    ]
    start = {"positions_rad": given, "inverse_kinematics": False}
    deg, rad, fast, _ = program_of(tmp_path, phases, start=start).phases
    straight = JointPath(rows, times)
    through = JointPath.through([0.0, 0.4, 0.9, 1.5], rows, speeds)
    for phase, way in ((deg, straight), (rad, straight), (fast, through)):
        made = phase.arms["slave_2"]
        assert isinstance(made, FollowsJoints)
        assert phase.seconds == pytest.approx(1.5)
        for clock in np.linspace(0.0, 1.5, 16).tolist():
            np.testing.assert_allclose(made.path.at(clock), way.at(clock), atol=1e-9)


# -- the object's path -------------------------------------------------------------------------------------------------


def test_a_line_begins_where_the_phase_before_ends(tmp_path: Path) -> None:
    """Also behind phases in which the object rests."""
    goal = {"xyz_m": [0.9, 0.1, 0.3], "rpy_deg": [0, 0, -70]}
    phases = [
        {"name": "up", "path": UP | {"start": BEGIN}},
        {"name": "rest", "duration_s": 0.5},
        {"name": "up again", "path": UP | {"time_law": "linear"}},
        {"name": "over", "path": LINE | {"goal": goal}},
    ]
    first, rest, second, last = program_of(tmp_path, phases).phases
    start = start_pose()
    turn = pin.exp3(np.array([0.0, 0.0, np.deg2rad(20.0)]))
    lifted = pin.SE3(turn @ start.rotation, start.translation + 0.15 * UPWARD)
    same_path(first.path, LinePath(start, lifted, duration=2.0))
    assert rest.path is None
    higher = pin.SE3(turn @ lifted.rotation, lifted.translation + 0.15 * UPWARD)
    same_path(second.path, LinePath(lifted, higher, duration=2.0, time_law="linear"))
    end = pin.SE3(pin.utils.rotate("z", np.deg2rad(-70.0)), np.array([0.9, 0.1, 0.3]))
    same_path(last.path, LinePath(higher, end, duration=2.0))


@pytest.mark.parametrize(
    ("shares", "kept"), [([0.9], 0.9), ([0.9, 0.7], 0.7), ([0.7, 0.9], 0.7), ([0.9, None], None), ([None], None)]
)
def test_a_program_was_planned_with_the_least_share_of_its_phases(
    shares: list[float | None], kept: float | None, tmp_path: Path
) -> None:
    """None if something that moves was not planned; what rests does not count."""
    path = timed(0.1, shares[0])
    tool = {"kind": "follows", "frame": {}}
    still = {"kind": "hold", "pose": {}, "duration_s": 1.0}
    motions = [tool | {"path": table_of(timed(0.02, share))} for share in shares[1:]]
    phases = [
        {"name": "up", "path": table_of(path)},
        {"name": "rest", "duration_s": 0.5, "arms": {"slave_1": {"kind": "holds"}}},
        {"name": "still", "arms": {"slave_1": tool | {"path": still}}},
        *({"name": f"motion {k}", "arms": {"slave_2": motion}} for k, motion in enumerate(motions)),
    ]
    assert program_of(tmp_path, phases).planned_share == kept
    moves = {"kind": "slides", "axis": [0.0, 0.0, 1.0], "distance_m": 0.01}
    more = [*phases, {"name": "slide", "duration_s": 1.0, "arms": {"slave_2": moves}}]
    assert program_of(tmp_path, more).planned_share is None


def test_a_program_of_rests_was_not_planned(tmp_path: Path) -> None:
    """Nothing in it moves."""
    path = {"kind": "waypoints", "poses": [BEGIN, BEGIN], "durations_s": [1.0]}
    assert program_of(tmp_path, [{"name": "stay", "path": path}]).planned_share is None


SEARCH = {"kind": "search", "goal": BEGIN}
NO_BODIES = r"phases 'a': path: it is searched, and no bodies are known\. Add a table \[collision\]"


@pytest.mark.parametrize(
    ("phases", "more", "message"),
    [
        ([{"name": "a", "path": UP}], {}, r"phases 'a': path: its line has no start\. .* needs start"),
        ([{"name": "a", "path": SEARCH}], {}, r"phases 'a': path: its search has no start\. .* needs start"),
        ([{"name": "a", "duration_s": 1.0}], {}, r"phases: no phase has a path\. Give one a path, of kind line"),
        ([{"name": "a", "path": SEARCH | {"start": BEGIN}}], {}, NO_BODIES),
        (
            [{"name": "a", "path": SEARCH | {"start": BEGIN, "goal": BEGIN | {"free": [{"axis": "rx"}]}}}],
            {"collision": {}},
            r"phases 'a': path: its goal has free turns\. Give a goal without",
        ),
        (
            [
                {"name": "a", "path": UP | {"start": BEGIN}},
                {
                    "name": "b",
                    "arms": {
                        "slave_2": {"kind": "follows_joints", "positions_rad": [[0.0] * 5] * 2, "durations_s": [1.0]}
                    },
                },
            ],
            {},
            r"arms\.slave_2\.positions_rad has 5 numbers for 6 joints",
        ),
    ],
)
def test_a_phase_that_cannot_be_built_is_named(
    phases: list[Any], more: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(CellFileError, match=message):
        program_of(tmp_path, phases, **more)


def test_a_search_in_a_phase_begins_where_the_phase_before_ends(tmp_path: Path) -> None:
    """And the phase after it where it ends; with the speed and the start that its table gives."""
    high = BEGIN | {"xyz_m": [0.9, 0.0, 0.3]}
    over = BEGIN | {"xyz_m": [0.9, 0.02, 0.3]}
    search = {"kind": "search", "nodes": 20, "speed_m_per_s": 0.05}
    ball = {"name": "ball", "shape": "sphere", "radius_m": 0.1, "at": {"xyz_m": [0.0, 3.0, 0.0]}}
    phases = [
        {"name": "first", "path": search | {"start": BEGIN, "goal": high}},
        {"name": "second", "path": search | {"goal": over, "speed_m_per_s": 0.1}},
        {"name": "third", "path": LINE | {"displacement": {"translation_m": [0.0, 0.0, -0.05]}}},
    ]
    program = program_of(tmp_path, phases, collision={"obstacles": [ball]})
    ends = [program.pose(span.end).translation for span in program.spans]
    np.testing.assert_allclose(ends, [[0.9, 0.0, 0.3], [0.9, 0.02, 0.3], [0.9, 0.02, 0.25]], atol=1e-9)
    np.testing.assert_allclose(program.pose(0.0).translation, [0.9, 0.0, 0.1], atol=1e-9)
    for span, speed in zip(program.spans, (0.05, 0.1), strict=False):
        clocks = np.linspace(span.start, span.end, 30)[1:-1].tolist()
        fastest = max(float(np.linalg.norm(program.twist(clock)[:3])) for clock in clocks)
        assert 0.5 * speed < fastest <= speed + 1e-9
