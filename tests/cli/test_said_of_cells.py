"""What commands say about a cell is true: nothing that was not judged is called clear, and a refusal has its status."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from convex import core_of, distance
from matplotlib.image import imread
from places import CELL_FILES

from coopqp import InvalidInputError, Recording, load_cell_file
from coopqp.cli import main as cli
from coopqp.cli.check import glance_at
from coopqp.cli.terminal import Reporter
from coopqp.files.cellfile.hints import load_hints, unit_hints
from coopqp.visualization import cell_overview as glance
from coopqp.visualization.cell_overview import shortfall
from coopqp.visualization.cell_viewer import CellViewer

CELL = """
name = "said"
steps = {steps}
[[arms]]
name = "a"
robot = "arm7"
[grasp]
kind = "tools"
tools.a = {{ rpy_deg = [0, 90, 0] }}
[path]
kind = "line"
start = {{ xyz_m = [{x}, 0, 0.5] }}
displacement = {{ translation_m = [{dx}, 0, 0.02] }}
duration_s = 0.6
[object]
size_m = {size}
{more}
"""


#: A start near x = 0.5.
NEAR = "positions_deg.a = [0, 23, 0, 122, 0, -55, 0]"


def cell(
    file: str, *, x: float = 0.5, dx: float = 0.0, size: Any = (0.05, 0.05, 0.05), steps: int = 6, more: str = ""
) -> str:
    Path(file).write_text(CELL.format(x=x, dx=dx, size=list(size), steps=steps, more=more), encoding="utf-8")
    return file


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder of its own; pictures are small."""
    monkeypatch.chdir(tmp_path)
    draw = glance.render
    monkeypatch.setattr(glance, "render", lambda scene, view, *, width: draw(scene, view, width=min(width, 60)))


def overlapping(file: str) -> set[str]:
    """Links that overlap the object at the start, by the judge's distances and Pinocchio's places."""
    task = load_cell_file(file).scenario
    arm = task.cell.collision_model()
    data, placed = task.cell.model.createData(), arm.createData()
    pin.forwardKinematics(task.cell.model, data, task.q_start)
    pin.updateGeometryPlacements(task.cell.model, data, arm, placed)
    T, box = task.path.pose(0.0) * task.T_object_body, core_of(coal.Box(*task.object_size))
    found = set()
    for shape, at in zip(arm.geometryObjects, placed.oMg, strict=True):
        link = task.cell.model.frames[shape.parentFrame].name
        core = core_of(shape.geometry)
        if distance(core, box, at.rotation, at.translation, T.rotation, T.translation) <= 0.0:
            found.add(link)
    return found


def test_what_overlaps_at_the_start_is_never_called_clear(capsys: pytest.CaptureFixture[str]) -> None:
    """`run` and `check` name each link inside the object, and offer the line that allows it."""
    assert cli.main(["run", cell("fits.toml")]) == 0
    assert "yes  Did all keep clear?" in capsys.readouterr().out
    file = cell("inside.toml", size=(0.8, 0.8, 0.8))
    inside = overlapping(file)
    assert cli.main(["run", file]) == 4
    printed = capsys.readouterr()
    assert "yes  Did all keep clear?" not in printed.out
    offered = json.loads(re.findall(r"^  ignored = (.*)$", printed.err, flags=re.M)[0])
    named = {first for first, second in offered if second == "object"}
    assert named
    assert named <= inside
    assert all(link in printed.out for link in named)
    assert cli.main(["check", file]) == 0
    said = capsys.readouterr().out
    assert all(link in said for link in named)
    assert json.loads(re.findall(r"^  ignored = (.*)$", said, flags=re.M)[0]) == offered
    lines = f"[collision]\navoid = false\nignored = {json.dumps(offered)}"
    assert cli.main(["run", cell("allowed.toml", size=(0.8, 0.8, 0.8), more=lines)]) == 0
    assert "yes  Did all keep clear?" in capsys.readouterr().out


@pytest.mark.slow
def test_a_start_too_close_is_impossible_and_every_pair_is_offered(capsys: pytest.CaptureFixture[str]) -> None:
    file = cell("kept.toml", size=(0.8, 0.8, 0.8), more="[collision]")
    for command in ("run", "check"):
        assert cli.main([command, file, "--quiet"]) == 3
    said = capsys.readouterr().err
    pairs = json.loads(re.findall(r"collision\.ignored = (\[\[.*\]\])\.", said)[0])
    lines = f"[collision]\nignored = {json.dumps(pairs)}"
    assert cli.main(["run", cell("allowed.toml", size=(0.8, 0.8, 0.8), more=lines), "--quiet"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, {"run": 0, "check": 0, "plan": 0}),
        ({"x": 3.0}, {"run": 3, "check": 3, "plan": 3}),
        ({"dx": 1.5}, {"run": 3, "check": 3, "plan": 3}),
        ({"more": "[verdict]\nchain_mm = 0.1\nobject_mm = 0.0"}, {"run": 2, "check": 2, "plan": 2}),
        ({"more": f"[start]\n{NEAR}", "x": 3.0}, {"run": 3, "check": 3, "plan": 3}),
    ],
)  # fmt: skip
def test_the_exit_status_says_how_it_ended(changes: dict[str, Any], status: dict[str, int]) -> None:
    more = changes.pop("more", "")
    file = cell("one.toml", **changes, more=more)
    for command, wanted in status.items():
        if command == "plan":
            text = Path(file).read_text(encoding="utf-8")
            limited = text.replace('robot = "arm7"', 'robot = "arm7"\nlimits = { acceleration_deg_per_s2 = 300 }')
            Path(file).write_text(limited, encoding="utf-8")
        more_words = ["--out", "planned"] if command == "plan" else []
        assert cli.main([command, file, "--quiet", *more_words]) == wanted, command


# -- a cell that cannot hold its object ------------------------------------------------------------------------------


def test_a_cell_out_of_reach_is_drawn_and_its_figures_are_true(capsys: pytest.CaptureFixture[str]) -> None:
    """The gap is the distance of tool and grasp; no configuration of the arm comes outside its reach."""
    file = cell("far.toml", x=1.6)
    assert cli.main(["run", file]) == 3
    printed = capsys.readouterr()
    assert "out/said/reach.png" in printed.out
    assert "does not reach its grasp" in printed.err
    assert imread("out/said/reach.png").shape[1] > 800
    found, _ = glance_at(file, Reporter())
    model, arm = found.check.cell.model, found.check.cell.arms[0]
    data, rng = model.createData(), np.random.default_rng(3)
    pin.framesForwardKinematics(model, data, found.q)
    tool = data.oMf[found.check.cell.tool_frames[0]].translation.copy()
    wanted = (found.check.path.pose(0.0) * found.check.grasp.T_object_tool[0]).translation
    np.testing.assert_allclose(found.grasps()["a"], wanted)
    assert found.short["a"] == pytest.approx(np.linalg.norm(tool - wanted), rel=1e-9)
    reach, away = found.reaches["a"], []
    for _ in range(2000):
        q = rng.uniform(np.maximum(arm.limits.lower, -np.pi), np.minimum(arm.limits.upper, np.pi))
        pin.framesForwardKinematics(model, data, q)
        away.append(np.linalg.norm(data.oMf[found.check.cell.tool_frames[0]].translation - reach.centre))
    assert 0.9 * reach.radius < max(away) <= reach.radius + 1e-6
    assert np.linalg.norm(wanted - reach.centre) > reach.radius
    assert "beyond its reach" in shortfall(found, "a")
    np.testing.assert_allclose(np.linalg.norm(reach.ring(0.5) - reach.centre, axis=1), reach.radius, rtol=1e-12)


@pytest.mark.slow
def test_a_way_that_ends_is_shown_where_it_ends() -> None:
    found, _ = glance_at(cell("half.toml", dx=1.5), Reporter())
    assert 0.0 < found.clock < 0.6
    assert found.short["a"] < 1e-3
    assert found.lines()[0] == "INFEASIBLE"


@pytest.mark.slow
def test_view_shows_a_cell_before_it_runs_and_runs_it_when_asked(capsys: pytest.CaptureFixture[str]) -> None:
    file = cell("seen.toml", size=(0.8, 0.8, 0.8))
    assert cli.main(["view", file, "--html", "page.html", "--quiet"]) == 0
    page = Path("page.html").read_text(encoding="utf-8")
    assert "said: CERTIFIED" in page
    assert "overlap at the start" in page
    found, more = glance_at(file, Reporter())
    refused = [True]

    def run(progress: Any) -> Recording:
        progress(1, 2)
        if refused.pop() if refused else False:
            raise InvalidInputError("no such cell", "run", "Give another.")
        return load_cell_file(file).run()

    with CellViewer(found, run, more=more, port=0) as shown:
        assert shown.update(0.1) == 0
        shown._press()
        assert shown.update(0.1) == 0
        assert "no such cell" in shown._text.content
        shown._press()
        shown.update(0.1)
        assert shown.stage.recording.n_steps >= 6
        assert shown.update(0.35) > 0
    capsys.readouterr()


# -- units -------------------------------------------------------------------------------------------------------------


def hints(text: str) -> list[str]:
    Path("asked.toml").write_text(text, encoding="utf-8")
    return unit_hints(Path("asked.toml"))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("base = { rpy_deg = [0, 0, 3.14159] }", "radians"),
        ("base = { rpy_deg = [1.5708, 0, 0] }", "radians"),
        ("positions_deg.left = [0.1, 0.52, -1.2, 1.9, 0.3, 0.25, 0.4]", "positions_rad.left"),
        ("base = { xyz_m = [600, 0, 0] }", "millimetres"),
        ("size_m = [800, 1800, 40]", "millimetres"),
        ("alpha_m = 600", "millimetres"),
        ("dt_s = 2.0", "milliseconds"),
        ("steps = 10\npath.duration_s = 3.0", "takes 0.3 s"),
        ("collision.obstacles = [{ size_m = [500, 500, 40] }]", "millimetres"),
        ("locked_joints_deg = { finger = 1.5708 }", "radians"),
        ("limits = { upper_deg = [3.14, 90] }", "radians"),
    ],
)
def test_another_unit_is_asked_about(line: str, said: str) -> None:
    assert any(said in hint for hint in hints(line))


@pytest.mark.parametrize(
    "line",
    [
        "base = { rpy_deg = [0, 0, 180], xyz_m = [3.6, 0.5, 0] }",
        "positions_deg.a = [0, 0, 0, 0, 0, 0]",
        "positions_deg.a = [1, 2, 3, 4, 5, 6]",
        "positions_rad.a = [3.14159, 1.5708]",
        "collision.obstacles = [{ size_m = [100, 100, 0.1], at = { xyz_m = [0, 0, -0.05] } }]",
        "dt_s = 0.05",
        "steps = 400\npath.durations_s = [1.0, 2.0]",
        "steps = 'x'\npath = 3",
        "not TOML",
    ],
)
def test_what_may_be_meant_is_not_asked_about(line: str) -> None:
    assert hints(line) == []


def test_no_cell_of_the_pages_is_asked_about() -> None:
    files = list(CELL_FILES.glob("*.toml"))
    assert len(files) > 6
    assert [hint for file in files for hint in unit_hints(file)] == []


@pytest.mark.slow
def test_a_mass_beyond_the_torques_is_asked_about(capsys: pytest.CaptureFixture[str]) -> None:
    text = (CELL_FILES / "lift_in_engine.toml").read_text(encoding="utf-8")
    heavy = re.sub(r"mass_kg = [\d.]+", "mass_kg = 9000", text)
    assert heavy != text
    assert not load_hints(load_cell_file(CELL_FILES / "lift_in_engine.toml"))
    Path("heavy.toml").write_text(heavy, encoding="utf-8")
    (said,) = load_hints(load_cell_file("heavy.toml"))
    assert "kilograms" in said
    assert "torque" in said


def test_hints_come_before_the_refusal_that_they_explain(capsys: pytest.CaptureFixture[str]) -> None:
    file = cell("mm.toml", x=500.0)
    assert cli.main(["run", file]) == 3
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "coopqp: hint: path.start.xyz_m is [500, 0, 0.5]: are these millimetres? It is in metres."
    assert lines[-1].startswith("coopqp: error: mm.toml: arm a does not reach")
