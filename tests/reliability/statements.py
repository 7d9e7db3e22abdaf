"""What commands say of random cells: each case counts statements that are false. For the promises of `benchmarks`."""

from __future__ import annotations

import contextlib
import io
import os
import random
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import coal
import pinocchio as pin
from damage import damaged, inside

from coopqp import load_cell_file
from coopqp.cli import main as cli
from coopqp.files.cellfile.build import CellRun
from coopqp.files.cellfile.hints import unit_hints
from coopqp.simulation import evaluate, read_run

ROOT = Path(__file__).parents[2]
#: One arm that lifts a box; its start is found.
CELL = """
name = "said"
dt_s = 0.2
{above}
[[arms]]
name = "a"
robot = "{robot}"
base = {{ rpy_deg = [0, 0, {yaw}] }}
limits = {{ velocity_deg_per_s = 90.0 }}
[grasp]
kind = "tools"
tools.a = {{ rpy_deg = [0, 90, 0] }}
[path]
kind = "line"
start = {{ xyz_m = [{x}, 0, {z}] }}
displacement = {{ translation_m = [0, 0, 0.02] }}
duration_s = 0.4
[object]
size_m = {size}
centre = {{ xyz_m = {centre} }}
"""
#: Links nearer to the tool than so many joints hold the object: their distance counts for nothing.
_HOLDING = 2


def _cell(rng: random.Random, **given: object) -> str:
    size = [round(rng.uniform(0.05, 1.2), 3) for _ in range(3)]
    values = {
        "above": "", "robot": rng.choice(("arm7", "ur5", "panda", "xarm7")), "yaw": round(rng.uniform(-20.0, 20.0), 1),
        "x": round(rng.uniform(0.4, 0.55), 3), "z": round(rng.uniform(0.35, 0.55), 3), "size": size,
        "centre": [round(rng.uniform(-0.3, 0.3), 3), 0, 0],
    }  # fmt: skip
    return CELL.format(**{**values, **given})


def _overlapping(run: CellRun) -> set[str]:
    """Links that overlap the object by more than a millimetre at the start, by coal and Pinocchio alone."""
    s = run.scenario
    model, shapes = s.cell.model, s.cell.collision_model()
    data, placed = model.createData(), shapes.createData()
    pin.forwardKinematics(model, data, s.q_start)
    pin.updateGeometryPlacements(model, data, shapes, placed)
    T = s.path.pose(0.0) * s.T_object_body
    box, at = coal.Box(*s.object_size), coal.Transform3s(T.rotation, T.translation)
    chain = [int(j) for j in model.supports[s.cell.tool_joints[0]]]
    found = set()
    for shape, M in zip(shapes.geometryObjects, placed.oMg, strict=True):
        joint = int(shape.parentJoint)
        if joint in chain and len(chain) - 1 - chain.index(joint) < _HOLDING:
            continue
        geometry = shape.geometry
        if isinstance(geometry, coal.BVHModelBase):
            geometry.buildConvexHull(True, "Qt")
            geometry = geometry.convex
        answer = coal.DistanceResult()
        d = coal.distance(
            geometry, coal.Transform3s(M.rotation, M.translation), box, at, coal.DistanceRequest(), answer
        )
        if d < -1e-3:
            found.add(model.frames[shape.parentFrame].name)
    return found


def _clear(quick: bool, folder: Path) -> Iterator[tuple[str, float]]:
    """Runs that are called clear, or do not name a link, although it is inside the object."""
    rng, runs, overlaps, false = random.Random(4), 0, 0, 0
    for _ in range(6 if quick else 150):
        file = folder / "clear.toml"
        file.write_text(_cell(rng), encoding="utf-8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                run = load_cell_file(file)
            except Exception:  # out of reach, or the robot is not installed: another promise
                continue
            recording = run.run()
        inside_it = _overlapping(run)
        finding = evaluate(run.scenario.cell, recording, read_run(run.scenario.cell, recording))[5]
        runs, overlaps = runs + 1, overlaps + bool(inside_it)
        false += (finding.holds and bool(inside_it)) or any(link not in finding.answer for link in inside_it)
    assert runs
    yield f"'clear' with links inside the object: {overlaps} of {runs} runs", false


#: A change of a cell, and the exit status of `run`, `check` and `plan` then.
STATUSES: tuple[tuple[dict[str, object], dict[str, int]], ...] = (
    ({}, {"run": 0, "check": 0}),
    ({"x": 9.0}, {"run": 3, "check": 3, "view": 0}),
    ({"size": [0.9, 0.9, 0.9], "centre": [0, 0, 0]}, {"run": 4, "check": 0}),
    ({"size": [0.9, 0.9, 0.9], "centre": [0, 0, 0], "above": "collision = {}"}, {"run": 3, "check": 3}),
    ({"x": '"far"'}, {"run": 2, "check": 2, "view": 2}),
    ({"robot": "no_such"}, {"run": 2, "check": 2, "view": 2}),
    ({"above": "longest_s = 0.2"}, {"run": 4, "check": 0}),
    ({"above": "verdict = { chain_mm = -1.0 }"}, {"run": 2, "check": 2}),
    ({"above": "output = { folder = '../away' }"}, {"run": 2, "check": 2}),
)


def _statuses(folder: Path) -> Iterator[tuple[str, float]]:
    usual: dict[str, object] = {"robot": "arm7", "yaw": 0, "x": 0.5, "z": 0.5, "size": [0.05] * 3, "centre": [0, 0, 0]}
    asked = wrong = 0
    for changes, statuses in STATUSES:
        file = folder / "status.toml"
        file.write_text(_cell(random.Random(1), **{**usual, **changes}), encoding="utf-8")
        for command, status in statuses.items():
            more = ["--html", str(folder / "page.html"), "--force"] if command == "view" else []
            with contextlib.redirect_stderr(io.StringIO()):
                wrong += cli.main([command, str(file), "--quiet", *more]) != status
            asked += 1
    yield f"exit statuses that are wrong, of {asked}", wrong


#: A line in another unit than its key says.
UNITS = (
    "base = { rpy_deg = [0, 0, 3.14159] }", "base = { rpy_deg = [0, 1.5708, 0] }", "base = { xyz_m = [900, 0, 0] }",
    "positions_deg.a = [0.1, 0.52, -1.2, 1.9, 0.3, 0.25]", "size_m = [800, 1800, 40]", "alpha_m = 600", "dt_s = 2",
    "steps = 5\npath.duration_s = 3.0", "limits = { upper_deg = [3.14, 90] }",
)  # fmt: skip


def _units(folder: Path) -> Iterator[tuple[str, float]]:
    missed, file = 0, folder / "units.toml"
    for line in UNITS:
        file.write_text(line, encoding="utf-8")
        missed += not unit_hints(file)
    yield f"other units that are not asked about, of {len(UNITS)}", missed
    cells = list(ROOT.glob("coopqp/scenarios/cells/*.toml"))
    asked = sum(bool(unit_hints(cell)) for cell in cells)
    yield f"sound cells that are asked about, of {len(cells)}", asked


def statements(quick: bool) -> Iterator[tuple[str, float]]:
    """Cases, and how many statements are false; ``quick`` for a part of the cases."""
    with tempfile.TemporaryDirectory() as place, inside(place):
        yield from _clear(quick, Path(place))
        yield from _statuses(Path(place))
        yield from _units(Path(place))
    number = int(os.environ.get("COOPQP_DAMAGED_FILES", 200 if quick else 20_000))
    for kind, count, wrong in damaged(number):
        yield f"damaged {kind}: tracebacks in {count}", wrong
