"""One arm with its base at some place: what its figures are where it follows its path and where it does not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from torsos import two_arms

from coopqp import Arm, Grasp, InvalidInputError, LinePath, Robot, RobotCell
from coopqp.model.batch import ArmKinematics
from coopqp.planning.arm_starts import arm_on_path
from coopqp.scenarios import mixed_cell, paper_lift
from coopqp.studies import CellPlaced, Goals, Placer

LIFT, MIXED = paper_lift(), mixed_cell()
TOOL = LIFT.path.pose(0.0) * LIFT.grasp.T_object_tool[0]
ALONE = RobotCell(list(LIFT.cell.arms)[:1])


def shifted(base: pin.SE3, *by: float) -> pin.SE3:
    return pin.SE3(base.rotation, base.translation + np.array(by))


def placer_of_one(arm: Arm, start: pin.SE3, rise: float = 0.2) -> Placer:
    path = LinePath.displaced(start, translation=(0.0, 0.0, rise), duration=1.0)
    return Placer(RobotCell([arm]), Grasp((pin.SE3.Identity(),)), path)


def limited(folder: Path, limits: str) -> Arm:
    """An arm whose first joint has these limits."""
    before, named, after = two_arms(()).partition('<joint name="left_0"')
    file = folder / "arm.urdf"
    file.write_text(before + named + after.replace('lower="-2.9" upper="2.9"', limits, 1), encoding="utf-8")
    return Arm.from_urdf("left", file, tool_frame="left_link_5", geometry=False)


def check_remedy(placer: Placer, base: pin.SE3, way: Any, words: str, *, steps: int = 1) -> None:
    """It helps, and so many steps of 2 cm less do not."""
    placed = placer.cell_at([base], quick=False)
    assert not placed.feasible
    (text,) = placer.remedies(placed)
    name, needs, length, cm, *told = text.split()
    assert (name, needs, cm, " ".join(told)) == (placer.cell.arm_names[0], "needs", "cm", words)
    step = 0.01 * float(length) * np.array(way)
    assert placer.arm(0, shifted(base, *step), quick=False).feasible
    assert not placer.arm(0, shifted(base, *(step - 0.02 * steps * np.array(way))), quick=False).feasible


@pytest.mark.parametrize(
    ("off", "way", "words"),
    [
        ((0.5, 0.0, 0.0), (-1.0, 0.0, 0.0), "more away from the object"),
        ((0.0, 0.0, 0.5), (0.0, 0.0, -1.0), "down"),
        ((0.9, 0.0, -1.3), (0.0, 0.0, 1.0), "up"),
        ((0.0, 0.7, 0.0), (0.0, 0.0, 0.0), "more toward the object"),
    ],
)
def test_a_remedy_says_where_the_base_is_to_go(off: Any, way: Any, words: str) -> None:
    placer = placer_of_one(ALONE.arms[0], TOOL)
    base = shifted(ALONE.arms[0].T_world_base, *off)
    if words == "more toward the object":
        held = TOOL.translation - base.translation
        way = np.array([*held[:2], 0.0]) / np.linalg.norm(held[:2])
    check_remedy(placer, base, way, words)


@pytest.mark.parametrize(
    ("limits", "way", "words"),
    [
        ('lower="0.15" upper="1.5"', (0.0, -1.0, 0.0), "to the right of it"),
        ('lower="-1.5" upper="-0.15"', (0.0, 1.0, 0.0), "to the left of it"),
    ],
)
def test_a_base_whose_arm_cannot_look_ahead_goes_aside(limits: str, way: Any, words: str, tmp_path: Path) -> None:
    base = pin.SE3(pin.utils.rotate("z", 2.0), np.array([0.3, -0.2, 0.1]))
    start = base * pin.SE3(np.eye(3), np.array([0.6, 0.3, 0.5]))  # straight ahead of the shoulder
    check_remedy(placer_of_one(limited(tmp_path, limits), start, 0.05), base, base.rotation @ way, words, steps=2)


def test_a_base_that_no_step_helps_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coopqp.studies.placing._FARTHEST", 0.06)
    placer = placer_of_one(ALONE.arms[0], TOOL)
    placed = placer.cell_at([shifted(ALONE.arms[0].T_world_base, -4.0, 0.0, 0.0)], quick=False)
    assert placer.remedies(placed) == ("master follows the path from nowhere within 0.06 m",)
    (arm,) = placed.arms
    assert arm.q.size == 0  # there is no branch at all
    assert (arm.tightest, arm.slides, arm.reach) == ("", False, 0.0)
    assert np.isnan(arm.margin)


@pytest.mark.parametrize(
    "off", [(-0.2, 0.0, 0.0), (0.0, 0.0, -0.4), (0.0, 0.0, 0.0), (0.6, 0.0, -0.2), (0.6, 0.0, 0.2)]
)
def test_an_arm_that_does_not_follow_has_the_figures_of_its_best_branch(off: tuple[float, float, float]) -> None:
    """The one that starts inside the limits, and of those the one that comes farthest."""
    placer = placer_of_one(ALONE.arms[0], TOOL, rise=0.9)
    base = shifted(ALONE.arms[0].T_world_base, *off)
    placed = placer.cell_at([base], quick=False)
    (arm,) = placed.arms
    kinematics = ArmKinematics(ALONE.arms[0].placed(base))
    found = arm_on_path(kinematics, placer.samples, pin.SE3.Identity(), near=np.empty((0, 6)))
    assert not found.feasible
    inside = [row for row in found.branches if row.inside] or list(found.branches)
    farthest = max(row.reached for row in inside)
    best = max((row for row in inside if row.reached == farthest), key=lambda row: row.margins.min())
    assert not arm.feasible
    assert arm.reach == pytest.approx(best.reached / 1.0 if best.inside else 0.0)
    assert arm.margin == pytest.approx(best.margins.min())
    assert arm.tightest == kinematics.joints[int(np.argmin(best.margins))]
    np.testing.assert_allclose(arm.q, best.q, atol=1e-6)
    assert (arm.sigma_min, arm.shares, arm.times.size) == (0.0, (0.0, 0.0), 0)
    assert arm.why
    assert placed.why == arm.why
    assert np.isnan(placed.time_s)
    assert np.isnan(placed.clearance)


def all_at(goals: Goals) -> CellPlaced:
    placer = Placer(MIXED.cell, MIXED.grasp, MIXED.path, goals=goals)
    return placer.cell_at([arm.T_world_base for arm in MIXED.cell.arms])


def test_shares_are_figures_divided_by_their_goals_and_the_joint_of_the_least_share_binds() -> None:
    usual, slide, turn = all_at(Goals()), all_at(Goals(margin_mm=1e5)), all_at(Goals(margin_deg=1e-3, sigma_min=0.5))
    for arm in usual.arms:
        assert not arm.slides
        assert arm.shares == pytest.approx((arm.sigma_min / 0.2, np.rad2deg(arm.margin) / 60.0))
    gantry = slide.arms[3]
    assert gantry.arm == "gantry7"
    assert gantry.slides
    assert gantry.tightest == "joint_1"
    assert gantry.shares == pytest.approx((gantry.sigma_min / 0.2, 1e3 * gantry.margin / 1e5))
    assert turn.arms[3].slides
    assert turn.arms[3].shares == pytest.approx((turn.arms[3].sigma_min / 0.5, 1e3 * turn.arms[3].margin / 100.0))
    assert turn.arms[3].margin < 2.0
    for arm in turn.arms[:3]:
        assert arm.shares == pytest.approx((arm.sigma_min / 0.5, np.rad2deg(arm.margin) / 1e-3))


def test_a_path_needs_an_end_and_a_grasp_for_each_arm() -> None:
    with pytest.raises(InvalidInputError):
        Placer(ALONE, LIFT.grasp, LIFT.path)


def test_robots_of_which_one_arm_follows_are_helped_as_a_whole(tmp_path: Path) -> None:
    file = tmp_path / "both.urdf"
    file.write_text(two_arms(()), encoding="utf-8")
    tools = {side: f"{side}_link_5" for side in ("left", "right")}
    cell = RobotCell([Robot(file, tools, name="both", geometry=False)])
    grasp = Grasp(tuple(pin.SE3(np.eye(3), np.array([0.0, y, 0.0])) for y in (0.2, -0.2)))
    path = LinePath(*(pin.SE3(np.eye(3), np.array([0.75, 0.55, z])) for z in (0.5, 0.6)), duration=1.0)
    placer = Placer(cell, grasp, path)
    placed = placer.cell_at([pin.SE3.Identity()] * 2)
    assert [arm.feasible for arm in placed.arms] == [True, False]
    (text,) = placer.remedies(placed)
    assert text.startswith("robot both needs ")
    assert [arm.robot for arm in placed.arms] == ["both", "both"]
