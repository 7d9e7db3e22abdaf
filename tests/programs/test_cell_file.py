"""Programs in a cell file: from phases to a run that reports by phase, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from coopqp import TimedPath, load_cell_file
from coopqp.cli.main import main
from coopqp.files import CellFileError
from coopqp.files.cellfile.build import CellRun
from coopqp.files.cellfile.write import planned_program_text
from coopqp.planning import time_program
from coopqp.programs import Program
from coopqp.programs.roles import Follows, FollowsJoints
from coopqp.simulation import evaluate, read_run
from coopqp.spatial import as_placement

ARM = """
[[arms]]
name = "{name}"
robot = "rx90l"
geometry = false
base = {{ xyz_m = [{x}, {y}, 0.0], rpy_deg = [0, 0, {yaw}] }}
limits.acceleration_rad_per_s2 = 5.0
"""
ARMS = "".join(
    ARM.format(name=name, x=x, y=y, yaw=yaw)
    for name, x, y, yaw in (("master", 0.0, 0.0, 0), ("slave_1", 3.6, 0.5, 180), ("slave_2", 3.6, -0.5, 180))
)
CELL = f"""
name = "regrasp"
dt_s = 0.01
{ARMS}
[grasp]
kind = "triangle"
alpha_m = 0.6
beta_m = 0.3

[[phases]]
name = "lift"
[phases.path]
kind = "line"
start = {{ xyz_m = [0.9, 0.0, 0.1], rpy_deg = [0, 0, -90] }}
displacement = {{ translation_m = [0.0, 0.0, 0.15] }}
duration_s = 2.0

[[phases]]
name = "regrasp"
duration_s = 1.5
until = "slave_2 closed"
[phases.arms.slave_2]
kind = "travels"
to = {{ xyz_m = [0.2, 1.8, 0.0], rpy_deg = [90, 0, 0] }}

[[phases]]
name = "open"
path = {{ kind = "line", displacement = {{ translation_m = [0.0, 0.0, 0.1] }}, duration_s = 2.0 }}
[phases.arms.slave_1]
kind = "turns"
about_m = [0.0, 0.8, 0.0]
angle_deg = 4.0
[phases.arms.slave_2]
kind = "slides"
axis = [1.0, 0.0, 0.0]
distance_m = 0.02
[phases.arms.master]
kind = "works"
poses = [{{ rpy_deg = [-90, 180, 0] }}, {{ xyz_m = [0.0, 0.03, 0.0], rpy_deg = [-90, 180, 0] }}]
durations_s = [1.0]

[signals_s]
"slave_2 closed" = 4.0
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "cell.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_phases_of_a_cell_file_run_and_are_reported(tmp_path: Path) -> None:
    task = load_cell_file(written(tmp_path, CELL))
    program = task.scenario.path
    assert isinstance(program, Program)
    assert [span.name for span in program.spans] == ["lift", "regrasp", "open"]
    assert program.spans[2].holding == ("slave_1", "slave_2")
    recording = task.run()
    assert recording.finished
    assert [phase["name"] for phase in recording.metadata["phases"]] == ["lift", "regrasp", "open"]
    findings = evaluate(task.scenario.cell, recording, read_run(task.scenario.cell, recording))
    (phases,) = (finding for finding in findings if finding.question == "Did all phases end?")
    assert phases.holds
    assert re.search(r"lift 2\S* s; regrasp 1\.5\d* s, then waiting 0\.\d+ s; open 2\S* s", phases.answer), (
        phases.answer
    )


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('kind = "travels"', 'kind = "travel"', "there is no 'travel'; did you mean 'travels'"),
        ('[phases.arms.slave_2]\nkind = "travels"', '[phases.arms.left]\nkind = "travels"', "left"),
        ("angle_deg = 4.0", "", "angle"),
        ("duration_s = 1.5", "", "regrasp.*how long"),
        ('"slave_2 closed" = 4.0', '"closed" = 4.0', "closed"),
        ('name = "open"', 'name = "lift"', "two phases are named 'lift'"),
        ("xyz_m = [0.0, 0.03, 0.0], rpy_deg", "xyz_m = [0.0, 0.03], rpy_deg", "phases"),
        ("start = { xyz_m = [0.9, 0.0, 0.1], rpy_deg = [0, 0, -90] }", "", "first path of a program needs start"),
        ("[grasp]", '[controller]\nkind = "independent"\n[grasp]', "only the controller qp"),
    ],
)
def test_a_bad_phase_is_refused_by_name(tmp_path: Path, old: str, new: str, match: str) -> None:
    assert old in CELL
    with pytest.raises(CellFileError, match=match):
        load_cell_file(written(tmp_path, CELL.replace(old, new, 1)))


def test_a_file_has_a_path_or_phases(tmp_path: Path) -> None:
    path = '[path]\nkind = "hold"\npose = { xyz_m = [0.9, 0.0, 0.1] }\nduration_s = 1.0\n'
    with pytest.raises(CellFileError, match="path or phases, not both"):
        load_cell_file(written(tmp_path, CELL + path))
    with pytest.raises(CellFileError, match="path is missing"):
        load_cell_file(written(tmp_path, CELL.partition("[[phases]]")[0]))


PINS = """
name = "pins"
dt_s = 0.01
[[arms]]
name = "left"
robot = "arm5"
geometry = false
base = { xyz_m = [-0.73, 0.0, 0.0] }
[[arms]]
name = "right"
robot = "arm5"
geometry = false
base = { xyz_m = [0.73, 0.0, 0.0], rpy_deg = [0, 0, 180] }
[grasp]
kind = "tools"
tools.left = { xyz_m = [-0.25, 0.0, 0.0], rpy_deg = [0, 90, 0] }
tools.right = { xyz_m = [0.25, 0.0, 0.0], rpy_deg = [180, 90, 0] }
free = [
  { arm = "left", axis = "rx", range_deg = [-60, 60] },
  { arm = "right", axis = "rx", range_deg = [-60, 60] },
]
[start]
positions_deg = { left = [0, 10, 115, -35, 0], right = [0, 10, 115, -35, 0] }
[path]
kind = "line"
start = { xyz_m = [0.0, 0.0, 0.25] }
displacement = { translation_m = [0.02, 0.03, 0.05], rotation_vector_deg = [5, 3, 11] }
duration_s = 3.0
"""


def test_grasps_of_a_cell_file_give_way(tmp_path: Path) -> None:
    task = load_cell_file(written(tmp_path, PINS))
    assert task.scenario.cell.joint_names[5] == "left/free_rx"
    assert task.run().finished


def test_a_loose_object_ends_with_status_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, PINS.replace('axis = "rx"', 'axis = "rz"'))
    for command in ("check", "run"):
        assert main([command, str(file)]) == 3
        assert "the object is loose" in capsys.readouterr().err.lower()
    bad = PINS.replace("range_deg = [-60, 60]", "range_m = [-0.1, 0.1]", 1)
    with pytest.raises(CellFileError, match="axis 'rx' takes range_deg or range_rad"):
        load_cell_file(written(tmp_path, bad))


def test_an_arm_follows_its_joints_in_a_phase_of_a_cell_file(tmp_path: Path) -> None:
    """From a start that the file gives; the other phases stay as they are."""
    first = load_cell_file(written(tmp_path, CELL)).scenario
    degrees = np.rad2deg(first.q_start)
    starts = ", ".join(
        f"{name} = {[round(x, 6) for x in degrees[own].tolist()]}"
        for name, own in zip(first.cell.arm_names, first.cell.v_slices, strict=True)
    )
    arms = "\n".join(CELL.partition("[[phases]]")[0].splitlines())
    here = [round(x, 6) for x in degrees[first.cell.v_slices[2]].tolist()]
    there = [x + 5.0 for x in here]
    phases = f"""
[start]
positions_deg = {{ {starts} }}
[attach]
distance_mm = 1.0
[[phases]]
name = "aside"
[phases.arms.slave_2]
kind = "follows_joints"
positions_deg = [{here}, {there}, {here}]
durations_s = [0.5, 0.5]
[[phases]]
name = "back"
duration_s = 0.5
[phases.arms.slave_2]
kind = "travels"
to = {{ xyz_m = [0.3, 1.8, 0.0], rpy_deg = [90, 0, 0] }}
[[phases]]
name = "lift"
[phases.path]
kind = "line"
start = {{ xyz_m = [0.9, 0.0, 0.1], rpy_deg = [0, 0, -90] }}
displacement = {{ translation_m = [0.0, 0.0, 0.05] }}
duration_s = 1.0
"""
    task = load_cell_file(written(tmp_path, arms + phases))
    program = task.scenario.path
    assert isinstance(program, Program)
    assert (program.attach_m, program.attach_rad) == pytest.approx((0.001, 0.02))
    assert program.spans[0].holding == ("master", "slave_1")
    recording = task.run()
    assert recording.finished
    asked = recording.q_command[50][first.cell.columns[2]]
    assert np.abs(asked - np.deg2rad(there)).max() < 2e-2
    pytest.importorskip("toppra")
    cell, grasp, q_start = task.scenario.cell, task.scenario.grasp, task.scenario.q_start
    planned = time_program(cell, grasp, program, q_start=q_start, knots=60)
    text = planned_program_text(task, planned, folder=tmp_path, into=tmp_path)
    again = load_cell_file(written(tmp_path, text)).scenario.path
    assert isinstance(again, Program)
    assert [span.name for span in again.spans] == [span.name for span in planned.spans]
    assert [span.name for span in again.spans][:2] == ["aside 1", "aside 2"]
    assert again.duration == pytest.approx(planned.duration, abs=1e-9)
    for clock in np.linspace(0.0, planned.spans[1].end, 20)[:-1].tolist():
        ways = [path.grasps.leading(2, clock) for path in (planned, again) if path.grasps is not None]
        assert np.allclose(*(way.at(clock) for way in ways if way is not None), atol=1e-9)
    bad = phases.replace(f"[{here}, {there}, {here}]", f"[{here[:5]}, {there[:5]}]").replace("[0.5, 0.5]", "[0.5]")
    with pytest.raises(CellFileError, match=r"arms\.slave_2\.positions_deg has 5 numbers for 6 joints"):
        load_cell_file(written(tmp_path, arms + bad))


COLLISION = '[[collision.obstacles]]\nname = "ball"\nshape = "sphere"\nradius_m = 0.1\nat.xyz_m = [0.0, 3.0, 0.0]\n'


def test_a_phase_of_a_cell_file_searches_its_way(tmp_path: Path) -> None:
    search = """path = { kind = "search", speed_m_per_s = 0.1, nodes = 50, goal = GOAL }"""
    goal = "{ xyz_m = [0.9, 0.05, 0.25], rpy_deg = [0, 0, -90] }"
    lift = CELL.partition('\n[[phases]]\nname = "regrasp"')[0]
    text = lift + f'\n[[phases]]\nname = "over"\n{search.replace("GOAL", goal)}\n{COLLISION}'
    program = load_cell_file(written(tmp_path, text)).scenario.path
    assert isinstance(program, Program)
    assert np.allclose(program.pose(program.duration).translation, [0.9, 0.05, 0.25])
    assert max(np.linalg.norm(program.twist(c)[:3]) for c in np.linspace(2.01, program.duration, 50)) <= 0.1 + 1e-6
    for old, new, match in (
        (COLLISION, "", "no bodies are known"),
        (goal, goal.replace("}", ", free = [{ axis = 'rz' }] }"), "free turns"),
    ):
        with pytest.raises(CellFileError, match=match):
            load_cell_file(written(tmp_path, text.replace(old, new)))


def test_a_body_in_the_way_ends_the_check_of_phases(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command asks for distances too, and names the phase."""
    beam = (
        '\n[[collision.obstacles]]\nname = "beam"\nshape = "box"\nsize_m = [0.1, 0.1, 0.1]\n'
        "at = { xyz_m = [0.95, 0.0, 0.27] }\n"
    )
    cell = re.sub(r"\[phases.arms.master\]\n(.+\n)*", "", CELL)  # a scene places the object by the first arm's tool
    file = written(tmp_path, cell + beam)
    assert main(["check", str(file)]) == 3
    said = capsys.readouterr().out
    assert "distances: not checked" not in said
    assert "beam come inside their margin" in said
    assert re.search(r"phase \w+ \(.*\): infeasible; .* and beam", said)


def test_what_is_not_looked_at_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first arm, whose tool places the object in a scene, waits and holds again: no distances are told."""
    beam = '\n[[collision.obstacles]]\nname = "beam"\nshape = "sphere"\nradius_m = 0.1\nat = { xyz_m = [0, 0, 5] }\n'
    file, said = written(tmp_path, CELL + beam), "distances: not checked, since the tool of arm 'master' moves on"
    assert main(["check", str(file)]) == 0
    assert said in capsys.readouterr().out
    assert main(["check", str(file), "--quiet"]) == 0
    assert said in capsys.readouterr().err


@pytest.mark.slow
def test_a_whole_program_is_planned_from_its_file_and_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is written reads back to the same program: phases, contact, gates, and the motions of the tools."""
    pytest.importorskip("toppra")
    pytest.importorskip("matplotlib")
    file = written(tmp_path, CELL.partition("[phases.arms.master]")[0] + "\n[signals_s]\n'slave_2 closed' = 1.0\n")
    assert main(["plan", str(file), "--out", str(tmp_path / "planned")]) == 0
    said = capsys.readouterr().out
    assert "phase: open" in said
    assert "CERTIFIED" in said
    given, planned = load_cell_file(file), load_cell_file(tmp_path / "planned" / "plan.toml")
    program = planned.scenario.path
    assert isinstance(program, Program)
    assert [span.name for span in program.spans] == ["lift", "regrasp 1", "regrasp 2", "regrasp 3", "open"]
    assert program.spans[3].until == "slave_2 closed"
    assert program.duration < 0.7 * given.scenario.path.duration
    assert program.planned_share == 0.98
    assert program.grasps is not None
    assert given.scenario.path.grasps is not None
    for k in range(3):
        ends = [p.grasps.moved(k, p.duration).homogeneous for p in (program, given.scenario.path) if p.grasps]
        assert np.allclose(*ends, atol=1e-9)
    recording = planned.run()
    assert recording.finished
    assert recording.time[-1] < 1.03 * max(program.duration, 1.0) + 0.5
    assert main(["plan", str(file), "--out", str(tmp_path / "other"), "--torques"]) == 2
    assert "--torques is for files with a path" in capsys.readouterr().err


def test_phases_in_the_engine_let_go_and_attach_but_open_no_part(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    engine = CELL.replace("[grasp]", '[plant]\nkind = "physics"\n[grasp]', 1)
    with pytest.raises(CellFileError, match="moves on the object while it holds it, and the object is rigid"):
        load_cell_file(written(tmp_path, engine))
    closed = engine.partition('\n[[phases]]\nname = "open"')[0] + "\n[signals_s]\n'slave_2 closed' = 2.0\n"
    recording = load_cell_file(written(tmp_path, closed)).run()
    assert recording.finished
    assert recording.metadata["gripped"]


# -- timed programs that are written -----------------------------------------------------------------------------------

#: From rest to rest in 2 s, a piece as ``coopqp plan`` writes it.
TIMED = """kind = "timed"
{share}pieces = [[{piece}]]
s_m = [0.0, 0.5, 1.0]
squares = [0.0, 1.0, 0.0]
binding = [{{ from_s = 0.5, to_s = 1.5, arm = "master", joint = "joint_2", limit = "acceleration" }}]
"""
LIFT = "0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.9, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.05, 1.0"
OUT, BACK = (
    f"1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, {y}, 0.0, 0.0, 0.0, 0.0, 0.0, {step}, 0.0, 1.0"
    for y, step in ((0.0, 0.05), (0.05, -0.05))
)
STILL = "{ xyz_m = [0.0, 0.05, 0.0], rpy_deg = [90, 0, 0] }"


def timed(piece: str, share: float | None = None) -> str:
    return TIMED.format(piece=piece, share="" if share is None else f"planned_share = {share}\n")


def follows(path: str, more: str = "") -> str:
    arm = 'kind = "follows"\nframe.xyz_m = [0.3, 1.8, 0.0]'
    return f"[phases.arms.slave_2]\n{arm}\n{more}\n[phases.arms.slave_2.path]\n{path}"


PHASES = f"""
[attach]
distance_mm = 3.0
angle_deg = 2.0
[signals_s]
closed = 4.0
[[phases]]
name = "lift"
[phases.path]
{timed(LIFT, 0.9)}
[[phases]]
name = "out"
duration_s = 2.0
{follows(timed(OUT, 0.8), "holds = false")}
[[phases]]
name = "rest"
duration_s = 0.25
{follows(f'kind = "hold"{chr(10)}pose = {STILL}{chr(10)}duration_s = 0.25', "holds = false")}
[[phases]]
name = "back"
duration_s = 2.0
until = "closed"
{follows(timed(BACK, 0.95), "holds = false" + chr(10) + "holds_after = true")}
[phases.arms.slave_1]
kind = "waits"
"""
ARMS_AND_GRASP = CELL.partition("[[phases]]")[0]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> CellRun:
    return load_cell_file(written(tmp_path_factory.mktemp("program"), ARMS_AND_GRASP + PHASES))


def program_of(run: CellRun) -> Program:
    assert isinstance(run.scenario.path, Program)
    return run.scenario.path


def again(run: CellRun, folder: Path) -> Program:
    text = planned_program_text(run, program_of(run), folder=folder, into=folder)
    read = load_cell_file(written(folder, text))
    np.testing.assert_array_equal(read.scenario.q_start, run.scenario.q_start)
    assert read.scenario.dt == run.scenario.dt == 0.01
    return program_of(read)


def test_a_program_of_timed_phases_reads_back_the_same(run: CellRun, tmp_path: Path) -> None:
    first = program_of(run)
    second = again(run, tmp_path)
    assert [(p.name, p.until) for p in second.phases] == [
        ("lift", None), ("out", None), ("rest", None), ("back", "closed"),
    ]  # fmt: skip
    assert (second.attach_m, second.attach_rad) == (first.attach_m, first.attach_rad) == (0.003, np.deg2rad(2.0))
    assert dict(second.signals) == {"closed": 4.0}
    assert [s.holding for s in second.spans] == [s.holding for s in first.spans]
    for a, b in zip(first.phases, second.phases, strict=True):
        assert b.seconds == a.seconds
        assert isinstance(a.path, TimedPath) == isinstance(b.path, TimedPath)
        if isinstance(a.path, TimedPath) and isinstance(b.path, TimedPath):
            assert b.path.record() == a.path.record()
        assert {k: type(v) for k, v in b.arms.items()} == {k: type(v) for k, v in a.arms.items()}
        for x, y in zip(a.arms.values(), b.arms.values(), strict=True):
            assert y.holds == x.holds
            if isinstance(x, Follows) and isinstance(y, Follows):
                assert y.holds_after == x.holds_after
                np.testing.assert_array_equal(
                    as_placement(y.frame, "").homogeneous, as_placement(x.frame, "").homogeneous
                )
                np.testing.assert_array_equal(y.on.pose(0.2).homogeneous, x.on.pose(0.2).homogeneous)
    assert [r.holds_after for p in second.phases for r in p.arms.values() if isinstance(r, Follows)] == [
        None, None, True,
    ]  # fmt: skip


def test_a_program_is_planned_with_the_least_share_of_its_motions(run: CellRun, tmp_path: Path) -> None:
    assert program_of(run).planned_share == again(run, tmp_path).planned_share == 0.8
    untold = PHASES.replace("planned_share = 0.95\n", "")
    assert program_of(load_cell_file(written(tmp_path, ARMS_AND_GRASP + untold))).planned_share is None


def test_a_way_of_joints_reads_back_with_its_speeds(run: CellRun, tmp_path: Path) -> None:
    """In motion where it passes, at rest where no speeds are given."""
    s = run.scenario
    names = s.cell.arm_names
    here = {name: s.q_start[own].tolist() for name, own in s.cell.blocks.items()}
    there = [x + 0.05 for x in here["slave_2"]]
    rows = f"positions_rad = [{here['slave_2']}, {there}, {here['slave_2']}]\ndurations_s = [0.5, 0.5]"
    start = "[start.positions_rad]\n" + "\n".join(f"{name} = {here[name]}" for name in names)
    lift = f'\n[[phases]]\nname = "lift"\n[phases.path]\n{timed(LIFT)}\n[phases.arms.slave_2]\nkind = "waits"\n'
    for k, speeds in enumerate(("", f"\nspeeds_rad_per_s = [{[0.0] * 6}, {[0.1] * 6}, {[0.0] * 6}]")):
        way = f'\n[[phases]]\nname = "aside"\n[phases.arms.slave_2]\nkind = "follows_joints"\n{rows}{speeds}\n'
        given = load_cell_file(written(tmp_path, ARMS_AND_GRASP + start + way + lift))
        folder = tmp_path / str(k)
        folder.mkdir()
        (a, b) = (p.phases[0].arms["slave_2"] for p in (program_of(given), again(given, folder)))
        assert isinstance(a, FollowsJoints)
        assert isinstance(b, FollowsJoints)
        np.testing.assert_allclose(b.path.at(0.5), [there, [0.1 if speeds else 0.0] * 6], atol=1e-12)
        for clock in np.linspace(0.0, 1.0, 9).tolist():
            np.testing.assert_array_equal(b.path.at(clock), a.path.at(clock))
