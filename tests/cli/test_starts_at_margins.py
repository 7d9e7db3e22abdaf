"""Starts on a margin, and inside one where a cell allows it: what is certified runs, a way is searched from there."""

from __future__ import annotations

from pathlib import Path

import pytest

from coopqp import Recording, find_path, load_cell_file
from coopqp.cli import main as cli

ARMS = "".join(
    f'[[arms]]\nname = "{name}"\nrobot = "arm7"\nbase = {{ xyz_m = [{x}, 0.0, 0.0], rpy_deg = [0, 0, {turn}] }}\n'
    "limits = { acceleration_deg_per_s2 = 600 }\n"
    for name, x, turn in (("left", -0.8, 0), ("right", 0.8, 180))
)
TASK = """
[grasp]
kind = "tools"
tools.left = { xyz_m = [-0.30, 0.0, 0.0], rpy_deg = [0, 150, 0] }
tools.right = { xyz_m = [0.30, 0.0, 0.0], rpy_deg = [0, 150, 180] }
[object]
size_m = [0.60, 0.05, 0.05]
mass_kg = 1.2
[path]
kind = "line"
duration_s = 2
start = { xyz_m = [0.0, -0.15, 0.30] }
goal = { xyz_m = [0.0, -0.15, 0.45] }
"""
#: The object is this far above a table, whose margin is 10 mm, and has to get over a post [m].
BODIES = """
[collision]
margin_m = 0.01
inside = {inside}
[[collision.obstacles]]
name = "table"
shape = "box"
size_m = [0.4, 0.6, 0.02]
at = {{ xyz_m = [0, 0, {z}] }}
[[collision.obstacles]]
name = "post"
shape = "box"
size_m = [0.05, 0.05, 0.1]
at = {{ xyz_m = [0, 0, 0.32] }}
"""


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def written(gap: float, *, inside: bool) -> str:
    bodies = BODIES.format(inside='[["object", "table"]]' if inside else "[]", z=round(0.265 - gap, 4))
    Path("cell.toml").write_text('name = "table"\n' + ARMS + TASK + bodies, encoding="utf-8")
    return "cell.toml"


@pytest.mark.parametrize("gap", [0.001, pytest.param(-0.002, marks=pytest.mark.slow)])
def test_a_pair_that_may_start_inside_its_margin_is_certified_and_runs(
    gap: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also one that overlaps at first: it comes no closer. Without leave both are refused."""
    file = written(gap, inside=True)
    assert cli.main(["check", file]) == 0
    assert f"closest {1e3 * gap:.3g} mm" in capsys.readouterr().out
    assert cli.main(["run", file, "--quiet", "--out", "out"]) == 0
    (recording,) = Path("out").rglob("*.npz")
    judged = Recording.load(recording).metadata["clearance"]
    assert judged["margin_m"] == pytest.approx(max(gap, 0.0), abs=1e-5)
    assert cli.main(["check", written(gap, inside=False), "--quiet"]) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "inside"), [(0.01, False), (0.001, True), (0.012, False), (0.02, False)])
def test_a_way_is_found_from_a_start_at_a_margin(gap: float, inside: bool) -> None:
    run = load_cell_file(written(gap, inside=inside))
    scenario, scene = run.scenario, run.scene
    start, goal = scenario.path.pose(0.0), scenario.path.pose(0.0)
    goal.translation[1] = 0.15
    route = find_path(scenario.cell, scenario.grasp, start, goal, scene, nodes=300, time_limit=60.0)
    assert route.check is not None
    assert route.check.verdict.value == "CERTIFIED"
