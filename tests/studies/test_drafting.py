"""A first cell for arms that nobody has placed: round numbers that a whole check of the cell confirms."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from torsos import two_arms

from coopqp import Arm, Grasp, RobotCell, check_path
from coopqp.errors import NoStartError
from coopqp.model.batch import ArmKinematics
from coopqp.scenarios import dual_arm7, paper_lift
from coopqp.studies import Goals
from coopqp.studies.drafting import ArmDraft, Draft, Motion, draft, positions_of, reach

MOTION = Motion(size=(0.4, 0.3, 0.1), translation=(0.05, 0.0, 0.2), turn_deg=20.0, duration=4.0)
ARMS = list(paper_lift().cell.arms)[:2]


@pytest.fixture(scope="module", autouse=True)
def few_samples() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("coopqp.studies.drafting._SAMPLES", 1000)
        yield


@pytest.fixture(scope="module")
def drafted() -> Draft:
    return draft(ARMS, MOTION)


def multiple(value: float, step: float) -> bool:
    return abs(value / step - round(value / step)) < 1e-6


def test_the_path_of_a_motion_rises_and_turns_about_the_vertical() -> None:
    path = MOTION.path(0.7)
    assert path.duration == 4.0
    np.testing.assert_allclose(path.pose(0.0).homogeneous, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.7])).homogeneous)
    np.testing.assert_allclose(path.pose(4.0).translation, [0.05, 0.0, 0.9], atol=1e-12)
    np.testing.assert_allclose(path.pose(4.0).rotation, pin.utils.rotate("z", np.deg2rad(20.0)), atol=1e-12)


def test_a_draft_has_round_numbers_and_its_tools_on_the_upper_side(drafted: Draft) -> None:
    assert multiple(drafted.height, 0.05)
    assert drafted.height >= 0.5 * MOTION.size[2] + 0.05 - 1e-9
    sides = [np.array([-1.0, 0.0]), np.array([1.0, 0.0])]  # the first arm stands at the object's −x side
    for own, side in zip(drafted.arms, sides, strict=True):
        assert all(multiple(v, 0.05) for v in own.base_xyz)
        assert own.base_xyz[2] == 0.0
        assert multiple(own.base_yaw_deg, 5.0)
        assert -180.0 < own.base_yaw_deg <= 180.0
        assert multiple(own.tool_rpy_deg[2], 5.0)
        assert own.tool_xyz[2] == pytest.approx(0.05)
        # 50 mm inside the edge toward the arm
        np.testing.assert_allclose(own.tool_xyz[:2], side * (0.2 - 0.05), atol=1e-9)
        assert own.base.translation[:2] @ side > 0.4
        np.testing.assert_allclose(own.tool.rotation @ [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], atol=1e-9)
        np.testing.assert_allclose(own.base.rotation, pin.utils.rotate("z", np.deg2rad(own.base_yaw_deg)), atol=1e-12)
        # It faces the object.
        ahead = own.base.rotation[:2, 0]
        assert ahead @ -side > 0.0


def test_a_draft_is_a_cell_that_follows_the_path(drafted: Draft) -> None:
    assert drafted.placed.feasible
    cell = RobotCell([arm.placed(own.base) for arm, own in zip(ARMS, drafted.arms, strict=True)])
    grasp, path = Grasp(tuple(own.tool for own in drafted.arms)), MOTION.path(drafted.height)
    x = np.concatenate([positions_of(arm, at.q) for arm, at in zip(ARMS, drafted.placed.arms, strict=True)])
    q = cell.configuration(x)
    assert check_path(cell, grasp, path, q_start=q).feasible
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, q)
    for k, own in enumerate(drafted.arms):
        tool = data.oMf[cell.tool_frames[k]]
        np.testing.assert_allclose(tool.homogeneous, (path.pose(0.0) * own.tool).homogeneous, atol=1e-6)
    assert min(T.translation[2] for T in list(data.oMi)[1:]) > -1e-6  # nothing is below the floor
    for own, at in zip(drafted.arms, drafted.placed.arms, strict=True):
        assert own.score == pytest.approx(min(at.shares), rel=0.05)
    assert drafted.placed.score == pytest.approx(min(own.score for own in drafted.arms), rel=0.05)


def test_scores_are_shares_of_the_goals(drafted: Draft) -> None:
    (own,) = draft(ARMS[:1], MOTION, goals=Goals(sigma_min=1e-3, margin_deg=30.0)).arms
    (half,) = draft(ARMS[:1], MOTION, goals=Goals(sigma_min=1e-3, margin_deg=60.0)).arms
    assert own.score == pytest.approx(2.0 * half.score)
    assert own.base_xyz == half.base_xyz


def test_a_motion_beyond_all_arms_is_refused_by_their_names() -> None:
    far = Motion(size=(0.4, 0.3, 0.1), translation=(9.0, 0.0, 0.0), turn_deg=0.0, duration=4.0)
    with pytest.raises(NoStartError, match=r"no height of the object suits master.*Give a smaller object") as caught:
        draft(ARMS[:1], far)
    assert caught.value.arms == ("master",)


@pytest.mark.parametrize("arm", [ARMS[0], dual_arm7().cell.arms[0]], ids=["six joints", "seven joints"])
def test_the_reach_of_an_arm_is_that_of_other_samples(arm: Arm) -> None:
    rng, data = np.random.default_rng(7), arm.model.createData()
    cell = RobotCell([arm.placed(pin.SE3.Identity())])
    low, high = np.maximum(arm.limits.lower, -np.pi), np.minimum(arm.limits.upper, np.pi)
    frame, farthest = cell.tool_frames[0], 0.0
    data = cell.model.createData()
    for x in rng.uniform(low, high, (1000, cell.nv)):
        pin.framesForwardKinematics(cell.model, data, cell.configuration(x))
        farthest = max(farthest, float(np.linalg.norm(data.oMf[frame].translation)))
    assert reach(arm) == pytest.approx(farthest, rel=0.03)
    assert reach(arm.placed(pin.SE3(np.eye(3), np.array([3.0, 2.0, 1.0])))) == reach(arm)


def test_arms_stand_evenly_around_the_object() -> None:
    arms = list(paper_lift().cell.arms)
    found = draft(arms, MOTION)
    centre = MOTION.path(found.height).pose(2.0).translation[:2]
    for own, degrees in zip(found.arms, (180.0, 60.0, -60.0), strict=True):
        x, y = np.array(own.base_xyz[:2]) - centre
        away = (np.rad2deg(np.arctan2(y, x)) - degrees + 180.0) % 360.0 - 180.0
        assert abs(away) < 25.0
        held = np.rad2deg(np.arctan2(own.tool_xyz[1], own.tool_xyz[0]))
        assert (held - degrees + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=0.1)
    assert found.placed.feasible


def test_arms_that_would_come_too_close_wherever_they_stand_are_refused_with_the_reason() -> None:
    with pytest.raises(NoStartError, match=r"no place was found for the bases: .* come inside their margin of 5000 mm"):
        draft(ARMS, MOTION, goals=Goals(clearance_mm=5000.0))


def limited(arm: Arm, joint: int, lower: float, upper: float) -> Arm:
    low, high = arm.limits.lower.copy(), arm.limits.upper.copy()
    low[joint], high[joint] = lower, upper
    return replace(arm, limits=arm.limits.replace(lower=low, upper=high))


def test_an_arm_whose_first_joint_may_not_point_ahead_is_turned_as_a_whole() -> None:
    """It stands at the object's −x side all the same."""
    found = draft([limited(ARMS[0], 0, 0.6, 2.6)], MOTION)
    assert found.placed.feasible
    (own,) = found.arms
    x, y = np.array(own.base_xyz[:2]) - MOTION.path(found.height).pose(2.0).translation[:2]
    assert abs(np.rad2deg(np.arctan2(y, -x))) < 25.0
    tool = MOTION.path(found.height).pose(2.0) * own.tool
    ahead = np.arctan2(*(tool.translation - own.base.translation)[1::-1]) - np.deg2rad(own.base_yaw_deg)
    assert 0.4 < (ahead + np.pi) % (2.0 * np.pi) - np.pi < 2.8


def test_no_elbow_is_below_the_floor(tmp_path: Path) -> None:
    """Where the upper arm has to hang down there is no place; else the first joint itself may be on the floor."""
    arm = one_arm(tmp_path, on="0 0 0")
    assert draft([arm], SMALL).placed.feasible
    with pytest.raises(NoStartError, match="no place was found for the bases: an elbow is below the floor"):
        draft([limited(arm, 1, 2.0, 2.9)], SMALL)


def test_drafts_and_motions_do_not_change(drafted: Draft) -> None:
    for thing, field in ((MOTION, "turn_deg"), (drafted.arms[0], "score"), (drafted, "height")):
        values: Any = thing
        with pytest.raises(FrozenInstanceError):
            setattr(values, field, 1.0)
    with pytest.raises(TypeError):
        ArmDraft((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)  # type: ignore[misc]


def test_a_placement_is_good_from_these_goals_on() -> None:
    assert Goals() == Goals(sigma_min=0.2, margin_deg=60.0, margin_mm=100.0, clearance_mm=10.0)


@pytest.mark.parametrize("axis", [tuple(row) for row in np.concatenate([np.eye(3), -np.eye(3)]).tolist()])
def test_the_axis_out_of_a_tool_points_down(axis: tuple[float, float, float], tmp_path: Path) -> None:
    x, y, z = 0.12 * np.array(axis)
    tool = (
        '<link name="tool"/><joint name="hand" type="fixed"><parent link="left_link_5"/><child link="tool"/>'
        f'<origin xyz="{x} {y} {z}"/></joint></robot>'
    )
    file = tmp_path / "arm.urdf"
    ball = '<link name="base"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
    text = two_arms(()).replace('<link name="base"/>', ball).replace("</robot>", tool)
    file.write_text(text, encoding="utf-8")
    arm = Arm.from_urdf("left", file, tool_frame="tool")
    (own,) = draft([arm], Motion(size=(0.1, 0.1, 0.1), translation=(0.0, 0.0, 0.02), turn_deg=0.0, duration=1.0)).arms
    np.testing.assert_allclose(own.tool.rotation @ np.array(axis), [0.0, 0.0, -1.0], atol=1e-9)
    assert all(multiple(angle, 90.0) for angle in own.tool_rpy_deg[:2])


SMALL = Motion(size=(0.1, 0.1, 0.1), translation=(0.0, 0.0, 0.02), turn_deg=0.0, duration=1.0)


def one_arm(folder: Path, name: str = "left", *, ball: float = 0.05, on: str = "0 0.3 0.4", **limits: str) -> Arm:
    """The left arm of a torso: radius of its base [m], place of its first joint [m], limits of joints [rad]."""
    body = f'<link name="base"><collision><geometry><sphere radius="{ball}"/></geometry></collision></link>'
    text = two_arms(()).replace('<link name="base"/>', body).replace('xyz="0 0.3 0.4"', f'xyz="{on}"')
    for joint, limit in limits.items():
        before, named, after = text.partition(f'<joint name="{joint}"')
        text = before + named + after.replace('lower="-2.9" upper="2.9"', limit, 1)
    file = folder / f"{name}.urdf"
    file.write_text(text, encoding="utf-8")
    return Arm.from_urdf(name, file, tool_frame="left_link_5")


def seen_from_grasp(found: Draft, motion: Motion) -> list[float]:
    """Directions from the arms' grasps, in the middle of the path, to their bases [deg]."""
    middle = motion.path(found.height).pose(0.5 * motion.duration)
    away = [own.base.translation - middle.act(own.tool.translation) for own in found.arms]
    return [float(np.rad2deg(np.arctan2(y, x))) for x, y, _ in away]


def test_a_wrist_of_little_room_turns_from_one_side_to_the_other(tmp_path: Path) -> None:
    """The tool is turned to the object as it is halfway, so that a wrist of ±1 rad follows a turn of 80°."""
    arm = one_arm(tmp_path, left_3='lower="-1" upper="1"', left_5='lower="-1" upper="1"')
    motion = Motion(size=(0.1, 0.1, 0.1), translation=(0.0, 0.0, 0.02), turn_deg=80.0, duration=1.0)
    found = draft([arm], motion)
    assert found.placed.feasible
    assert abs(found.placed.arms[0].q[5]) < 1.0
    assert found.arms[0].score > 0.3


def test_bases_that_touch_at_the_best_places_are_given_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coopqp.studies.drafting._HIGHEST", 0.9)
    motion = Motion(size=(0.4, 0.3, 0.1), translation=(0.0, 0.0, 0.1), turn_deg=20.0, duration=1.0)
    narrow = draft([one_arm(tmp_path, name) for name in ("one", "two")], motion)
    wide = draft([one_arm(tmp_path, name, ball=0.8) for name in ("one", "two")], motion)
    assert narrow.height == wide.height
    assert narrow.arms != wide.arms
    assert wide.placed.feasible
    assert wide.placed.score < narrow.placed.score


def test_the_first_candidate_is_as_good_as_all(monkeypatch: pytest.MonkeyPatch) -> None:
    (best,) = draft(ARMS[:1], SMALL).arms
    monkeypatch.setattr("coopqp.studies.drafting._CANDIDATES", 1)
    assert draft(ARMS[:1], SMALL).arms == (best,)


@pytest.mark.parametrize("goals", [Goals(), Goals(sigma_min=5.0)], ids=["margins bind", "σ_min binds"])
def test_the_score_of_an_arm_is_the_worst_along_its_path(goals: Goals) -> None:
    """At 21 poses from the start on, by the kinematics of the arm in its place."""
    found = draft(ARMS, MOTION, goals=goals)
    path = MOTION.path(found.height)
    for arm, own, at in zip(ARMS, found.arms, found.placed.arms, strict=True):
        kinematics = ArmKinematics(arm.placed(own.base))
        poses = np.array([(path.pose(t) * own.tool).homogeneous for t in np.linspace(0.0, 4.0, 21)])
        q = kinematics.trajectories(poses, at.q[None])[0][0]
        sigma = np.linalg.svd(kinematics.jacobians(q), compute_uv=False)[:, -1].min()
        margin = np.minimum(q - kinematics.lower, kinematics.upper - q).min()
        assert own.score == pytest.approx(min(sigma / goals.sigma_min, np.rad2deg(margin) / goals.margin_deg), rel=1e-6)


@pytest.mark.parametrize(
    ("size", "tools"),
    [
        ((0.4, 0.3, 0.1), [(-0.15, 0.0, 0.05), (0.15, 0.0, 0.05)]),  # 50 mm inside the edge
        ((0.24, 0.3, 0.2046), [(-0.09, 0.0, 0.1023), (0.09, 0.0, 0.1023)]),  # a quarter of the half side
    ],
)
def test_grasps_stay_away_from_the_edges(size: Any, tools: Any) -> None:
    motion = Motion(size=size, translation=(0.0, 0.0, 0.1), turn_deg=0.0, duration=2.0)
    found = draft(ARMS, motion)
    assert [own.tool_xyz for own in found.arms] == tools
    assert found.height >= 0.5 * size[2] + 0.05 - 1e-9


def test_the_reach_of_a_sliding_arm_is_within_its_limits_or_ten_metres(tmp_path: Path) -> None:
    text = (
        '<robot name="rail"><link name="base"/><link name="cart"/><link name="tool"/>'
        '<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>'
        '<limit {limits} velocity="1" effort="100"/></joint><joint name="turn" type="revolute"><parent link="cart"/>'
        '<child link="tool"/><origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="100"/></joint></robot>'
    )
    for limits, farthest in (('lower="0.1" upper="0.4"', 0.9), ('lower="-0.2" upper="0"', 0.5),
                             ('lower="-200" upper="200"', 10.5), ('lower="-200" upper="0"', 9.5)):  # fmt: skip
        file = tmp_path / "rail.urdf"
        file.write_text(text.format(limits=limits), encoding="utf-8")
        assert reach(Arm.from_urdf("rail", file, tool_frame="tool")) == pytest.approx(farthest, abs=0.02)
