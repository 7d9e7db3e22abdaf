"""Base placement: the paper's b and h, and their reason; figures against forms that share no code with them."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from places import DOCS

from coopqp import CollisionScene, QPController, find_start, simulate
from coopqp.cli import main as cli
from coopqp.collision import Body, Sphere
from coopqp.scenarios import paper_lift
from coopqp.studies import CellPlaced, Goals, Placer, StudyError, load_place_study

LIFT = paper_lift()
EXAMPLE = DOCS / "examples" / "studies" / "h_and_b.toml"


@pytest.fixture(scope="module")
def placer() -> Placer:
    return Placer.of(LIFT)


def at(placer: Placer, h: float, b: float) -> CellPlaced:
    turned = np.diag([-1.0, -1.0, 1.0])
    slaves = [pin.SE3(turned, np.array([h, y, 0.0])) for y in (b, -b)]
    return placer.cell_at([pin.SE3.Identity(), *slaves])


def test_fixture_f_has_the_figures_of_the_paper_cell(placer: Placer) -> None:
    found = at(placer, 3.60, 0.50)
    assert found.feasible
    assert min(arm.sigma_min for arm in found.arms) == pytest.approx(0.1686, abs=5e-4)
    assert np.rad2deg(min(arm.margin for arm in found.arms)) == pytest.approx(56.38, abs=0.05)
    assert found.score == pytest.approx(0.843, abs=5e-4)
    np.testing.assert_allclose(np.concatenate([arm.q for arm in found.arms]), LIFT.q_start, atol=1e-6)


@pytest.mark.slow
def test_why_the_papers_b_and_h(placer: Placer) -> None:
    """The slaves stand in a ring about their grasps, outside of each other; F is on the plateau of the joint margin."""
    assert not at(placer, 3.00, 0.50).follows  # too near to the plate: joint_3 at its limit
    assert "joint_3" in at(placer, 3.00, 0.50).explain()
    assert not at(placer, 3.85, 0.50).follows  # out of reach
    for h, b in ((3.60, 0.15), (3.60, 0.05), (2.60, 0.80)):
        assert at(placer, h, b).follows
        assert at(placer, h, b).touches
    best = max((at(placer, h, b) for h in (3.48, 3.53, 3.58) for b in (0.60, 0.66, 0.72, 0.76)), key=lambda p: p.rank)
    assert best.score == pytest.approx(0.940, abs=1e-3)  # the master's margin, which no h and b change
    assert min(best.arms, key=lambda arm: min(arm.shares)).arm == "master"


def test_figures_are_those_of_the_cell_built_there(placer: Placer) -> None:
    """A cell of its own at another h and b: its start, its distances, and the joints of its lift."""
    h, b = 3.50, 0.45
    found, built = at(placer, h, b), paper_lift(h=h, b=b)
    x = np.concatenate([arm.q for arm in found.arms])
    starts = find_start(built.cell, built.grasp, built.path)
    branches = [row for arm in starts.arms for row in arm.branches if row.feasible]
    assert all(any(np.allclose(row.q, arm.q, atol=1e-6) for row in branches) for arm in found.arms)
    controller = QPController(built.cell, built.grasp, built.path, dt=0.03)
    run = simulate(controller, q_start=built.cell.configuration(x))
    scene, q = CollisionScene.of(built), built.cell.positions(run.q_command)
    assert min(scene.distances(row)[0].distance for row in run.q_command[::4]) == pytest.approx(
        found.clearance, abs=1e-3
    )
    room = np.minimum(q - built.cell.limits.lower, built.cell.limits.upper - q)
    assert room.min() == pytest.approx(min(arm.margin for arm in found.arms), abs=1e-3)
    # Driven at constant speed, the lift takes the time at which some joint is at its limit all the time; not less.
    share = np.abs(np.diff(q, axis=0)).max(axis=0) / (0.03 * built.cell.limits.velocity)
    assert found.time_s <= LIFT.path.duration * share.max() + 1e-9
    assert found.time_s >= max(arm.time_s for arm in found.arms)


@pytest.mark.parametrize("seed", range(3))
def test_moving_all_bases_and_the_path_together_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = pin.SE3(pin.utils.rotate("z", float(rng.uniform(-3, 3))), rng.normal(size=3))
    path = type(LIFT.path)(T * LIFT.path.pose(0.0), T * LIFT.path.pose(3.0), duration=3.0, time_law="linear")
    here, there = (Placer(LIFT.cell, LIFT.grasp, p) for p in (LIFT.path, path))
    bases = [arm.T_world_base for arm in LIFT.cell.arms]
    a, b = here.cell_at(bases), there.cell_at([T * base for base in bases])
    np.testing.assert_allclose([arm.shares for arm in a.arms], [arm.shares for arm in b.arms], atol=1e-6)
    assert a.time_s == pytest.approx(b.time_s, abs=1e-9)


def test_remedies_are_the_shortest_that_help_and_are_said_by_direction(placer: Placer) -> None:
    found = at(placer, 3.90, 0.50)
    assert not found.feasible
    texts = placer.remedies(found)
    assert [text.split()[0] for text in texts] == ["slave_1", "slave_2"]
    for k, text in enumerate(texts, start=1):
        _, needs, length, cm, *way = text.split()
        assert (needs, cm) == ("needs", "cm")
        assert " ".join(way) == "more toward the object"
        base = found.bases[k]
        held = np.mean(placer.samples.tool_poses(LIFT.grasp.T_object_tool[k])[:, :3, 3], axis=0) - base.translation
        toward = np.array([*held[:2], 0.0]) / np.linalg.norm(held[:2])

        def follows(metres: float) -> bool:
            return placer.arm(k, pin.SE3(base.rotation, base.translation + metres * toward), quick=False).feasible  # noqa: B023

        assert follows(0.01 * float(length))
        assert not follows(0.01 * float(length) - 0.02)


@pytest.mark.parametrize(("h", "y", "z"), [(3.6, 0.5, 0.9), pytest.param(3.6, 1.5, 0.0, marks=pytest.mark.slow)])
def test_no_other_direction_helps_sooner_than_the_remedy(h: float, y: float, z: float) -> None:
    placer = Placer(LIFT.cell, LIFT.grasp, LIFT.path)
    bases = [arm.T_world_base for arm in LIFT.cell.arms]
    base = bases[1] = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([h, y, z]))
    placed = placer.cell_at(bases, quick=False)
    assert [arm.feasible for arm in placed.arms] == [True, False, True]
    (text,) = placer.remedies(placed)
    name, needs, length, cm, *way = text.split()
    assert (name, needs, cm) == ("slave_1", "needs", "cm")
    held = placer.samples.tool_poses(LIFT.grasp.T_object_tool[1])[:, :3, 3].mean(axis=0) - base.translation
    toward = np.array([*held[:2], 0.0]) / np.linalg.norm(held[:2])
    up = np.array([0.0, 0.0, 1.0])
    left = np.cross(up, toward)
    ways = {
        "more toward the object": toward, "more away from the object": -toward, "to the left of it": left,
        "to the right of it": -left, "up": up, "down": -up,
    }  # fmt: skip

    def follows(step: Any) -> bool:
        return placer.arm(1, pin.SE3(base.rotation, base.translation + step), quick=False).feasible

    far = 0.01 * float(length)
    assert follows(far * ways[" ".join(way)])
    assert not any(follows((far - 0.02) * step) for step in ways.values())


def test_what_stands_on_a_base_moves_with_it() -> None:
    """A ball on the base of an arm, whatever it is called, beside the object's path."""
    frame = next(f.name for f in LIFT.cell.model.frames if f.parentJoint == 0 and f.name.startswith("slave_1/"))
    moved = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([3.55, 0.45, 0.0]))
    bases = [LIFT.cell.arms[0].T_world_base, moved, LIFT.cell.arms[2].T_world_base]
    centre = (LIFT.path.pose(0.0) * LIFT.T_object_body).translation + np.array([0.0, 0.9, 0.0])
    at = moved.actInv(centre)
    ball = Body("ball", Sphere(0.05), pin.SE3(np.eye(3), at))
    scene = CollisionScene.of(LIFT, on_links={frame: [ball]}, ignored=[(arm, "*") for arm in LIFT.cell.arm_names])
    assert set(map(frozenset, scene.pairs)) == {frozenset(("ball", "object"))}
    placer = Placer(LIFT.cell, LIFT.grasp, LIFT.path, scene=scene)
    half, distances = 0.5 * np.array(LIFT.object_size), []
    for T in placer.samples.poses:
        away = np.abs((T * LIFT.T_object_body).actInv(centre)) - half
        distances.append(float(np.linalg.norm(np.maximum(away, 0.0))) - 0.05)
    found = placer.cell_at(bases)
    assert found.follows
    assert set(found.near) == {"ball", "object"}
    assert found.clearance == pytest.approx(min(distances), abs=1e-6)
    assert found.near_s == pytest.approx(placer.samples.clocks[int(np.argmin(distances))])


def test_goals_make_the_score() -> None:
    bases = [arm.T_world_base for arm in LIFT.cell.arms]
    strict = Placer(LIFT.cell, LIFT.grasp, LIFT.path, goals=Goals(sigma_min=0.4, margin_deg=20.0)).cell_at(bases)
    assert strict.score == pytest.approx(0.16856 / 0.4, abs=1e-3)
    assert np.isnan(strict.clearance)


SMALL = """
name = "one way"
scenario = "paper_lift"
seed = 1
distances = false
axes = {{ {axes} }}
[[bases]]
arm = "slave_1"
xyz_m = ["h", {y}, {z}]
[[bases]]
arm = "slave_2"
xyz_m = ["h", -0.5, 0]
yaw_deg = 180
"""


def study(folder: Path, axes: str, y: Any = 0.5, z: Any = 0) -> Path:
    file = folder / "place.toml"
    file.write_text(SMALL.format(axes=axes, y=y, z=z), encoding="utf-8")
    return file


def test_bases_stand_where_axes_and_numbers_say(tmp_path: Path) -> None:
    axes = "h = { low = 3.0, high = 4.0, number = 3, now = 3.6 }, b = { low = -1.0, high = 1.0, number = 2 }"
    made = load_place_study(study(tmp_path, axes, y='"-b"', z='"b"'))
    master, first, second = made.bases({"h": 3.5, "b": 0.4})
    np.testing.assert_array_equal(master.homogeneous, LIFT.cell.arms[0].T_world_base.homogeneous)
    np.testing.assert_allclose(first.translation, [3.5, -0.4, 0.4])
    np.testing.assert_allclose(first.rotation, LIFT.cell.arms[1].T_world_base.rotation)  # as built
    np.testing.assert_allclose(second.translation, [3.5, -0.5, 0.0])
    np.testing.assert_array_equal(second.rotation, np.diag([-1.0, -1.0, 1.0]))  # exactly half a turn
    assert made.units == {"h": "m", "b": "m"}
    assert made.axes["h"].values == [3.0, 3.5, 4.0]
    assert made.now is None  # nothing says where b is now
    told: list[tuple[int, int]] = []
    found = made.map(lambda i, n: told.append((i, n)))
    assert told == [(i, 6) for i in range(1, 7)]
    assert [tuple(placed.values.values()) for placed in found] == [(h, b) for h in (3.0, 3.5, 4.0) for b in (-1.0, 1.0)]


def test_a_yaw_that_is_an_axis_is_an_angle_and_now_is_as_built(tmp_path: Path) -> None:
    file = study(tmp_path, "h = { low = 3.0, high = 4.0, now = 3.6 }, turn = { low = -9.0, high = 9.0, now = 0.0 }")
    text = file.read_text(encoding="utf-8").replace("yaw_deg = 180", 'yaw_deg = "-turn"')
    file.write_text(text, encoding="utf-8")
    made = load_place_study(file)
    assert made.units == {"h": "m", "turn": "deg"}
    np.testing.assert_allclose(
        made.bases({"h": 3.6, "turn": 9.0})[2].rotation, pin.utils.rotate("z", np.deg2rad(-9.0)), atol=1e-12
    )
    now = made.now
    assert now is not None
    assert now.values == {"h": 3.6, "turn": 0.0}
    np.testing.assert_allclose(now.bases[2].translation, [3.6, -0.5, 0.0])


@pytest.mark.slow
def test_the_command_writes_a_map_and_says_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = study(tmp_path, "h = { low = 3.5, high = 3.9, number = 5, now = 3.9 }")
    out = tmp_path / "out"
    assert cli.main(["place", str(file), "--out", str(out)]) == 3  # as built it is impossible
    printed = capsys.readouterr().out
    assert "as built: h = 3.9: impossible" in printed
    assert "slave_1 needs" in printed
    with (out / "map.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["h"]) for row in rows] == pytest.approx([3.5, 3.6, 3.7, 3.8, 3.9])
    assert float(rows[1]["slave_2.sigma_min"]) == pytest.approx(0.1686, abs=5e-4)
    record = json.loads((out / "place.json").read_text(encoding="utf-8"))
    assert record["best"]["feasible"]
    assert len(record["remedies"]) == 2
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")
    assert cli.main(["place", str(file), "--out", str(out)]) == 2  # it is there already
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_the_command_says_why_no_placement_is_possible(
    quiet: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = study(tmp_path, "h = { low = 3.9, high = 4.0, number = 2, now = 4.0 }")
    assert cli.main(["place", str(file), *quiet]) == 3
    printed = capsys.readouterr()
    built, nowhere = printed.err.strip().splitlines()[-2:]
    assert built.startswith("coopqp: as built the cell is impossible: h = 4: arm slave_")
    assert nowhere.startswith("coopqp: no placement is possible; nearest to it: h = 3.9: arm slave_")
    assert any(text in nowhere for text in ("does not reach its grasp", "of the path", "follows the path until"))
    assert bool(printed.out) is not bool(quiet)


def test_bodies_that_come_too_close_are_named_with_their_place_and_time() -> None:
    bases = [arm.T_world_base for arm in LIFT.cell.arms]
    placer = Placer(LIFT.cell, LIFT.grasp, LIFT.path, goals=Goals(clearance_mm=5000.0), scene=CollisionScene.of(LIFT))
    placed = placer.cell_at(bases)
    assert not placed.feasible
    told = f"{1e3 * placed.clearance:.0f} mm at {placed.near_s:.2f} s of the path"
    assert placed.why == f"{' and '.join(placed.near)} come inside their margin of 5000 mm: {told}"
    assert placed.why in placed.explain()
    assert 0.0 <= placed.near_s <= LIFT.path.duration
    assert placer.cell_at([T * pin.SE3(np.eye(3), np.array([0.0, 0.0, -9.0])) for T in bases]).why.count("arm ") == 3


def test_a_search_keeps_the_best_of_what_it_asked(tmp_path: Path) -> None:
    axes = "h = { low = 3.5, high = 3.7 }, y = { low = 0.4, high = 0.7 }"
    made = load_place_study(study(tmp_path, axes, '"y"'))
    asked: list[tuple[int, int]] = []
    found = made.search(lambda done, total: asked.append((done, total)), generations=0)
    assert found.feasible
    assert 3.5 <= dict(found.values)["h"] <= 3.7
    assert asked[-1] == (len(asked), len(asked))
    assert [done for done, _ in asked] == sorted(done for done, _ in asked)
    assert asked[0][0] == 1
    assert asked[-1][0] <= asked[-1][1]
    assert len({total for _, total in asked}) == 1


@pytest.mark.slow
def test_a_search_over_three_numbers_is_as_good_as_a_grid(tmp_path: Path) -> None:
    axes = "h = { low = 3.3, high = 3.8 }, y = { low = 0.3, high = 0.8 }, z = { low = -0.3, high = 0.3 }"
    made = load_place_study(study(tmp_path, axes, '"y"', '"z"'))
    grid = max(
        (made.at({"h": h, "y": y, "z": z}) for h in (3.4, 3.5, 3.6) for y in (0.4, 0.6) for z in (-0.1, 0.0, 0.1)),
        key=lambda placed: placed.rank,
    )
    asked: list[int] = []
    found = made.search(lambda done, total: asked.append(total), generations=6)
    assert found.rank[0] >= grid.rank[0] - 1e-3
    again = load_place_study(study(tmp_path, axes, '"y"', '"z"')).search(generations=6)
    assert dict(again.values) == dict(found.values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('"h"', '"k"'), "no axis named 'k'"),
        (("slave_2", "slave_3"), "Did you mean 'slave_2'?"),
        (("slave_2", "slave_1"), "an arm has two tables"),
        (("paper_lift", "paper_left"), "Did you mean 'paper_lift'?"),
        (("low = 3.5", "low = 4.5"), "axes.h: low must be below high"),
    ],
)
def test_a_bad_study_is_refused_by_name(change: tuple[str, str], said: str, tmp_path: Path) -> None:
    file = study(tmp_path, "h = { low = 3.5, high = 3.9, number = 5 }")
    file.write_text(file.read_text(encoding="utf-8").replace(*change), encoding="utf-8")
    with pytest.raises(StudyError, match=r"place\.toml") as caught:
        load_place_study(file)
    assert said in str(caught.value)


def test_the_example_is_the_papers_cell() -> None:
    now = load_place_study(EXAMPLE).now
    assert now is not None
    for base, arm in zip(now.bases, LIFT.cell.arms, strict=True):
        np.testing.assert_array_equal(base.homogeneous, arm.T_world_base.homogeneous)
