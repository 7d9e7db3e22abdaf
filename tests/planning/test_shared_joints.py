"""Before the motion of arms that share joints: where these are, one proof for all arms, starts, remedies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_unless
from torsos import held, lift_cell, robot_of

from coopqp import (
    CollisionScene,
    Grasp,
    InvalidInputError,
    LinePath,
    QPController,
    RobotCell,
    WaypointPath,
    check_path,
    find_start,
    plan,
    simulate,
)
from coopqp.errors import NoStartError
from coopqp.model import CellState
from coopqp.paths.certificate import PathVerdict, follows
from coopqp.planning.check import PathCheck
from coopqp.planning.remedies import with_remedies
from coopqp.planning.shared_way import _Search
from coopqp.planning.timing import time_path

WAIST = (("revolute", "0 0 1"),)


def level(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def rise(low: float, high: float, x: float = 0.55) -> LinePath:
    """A bar goes straight up [m]."""
    return LinePath(level(x, 0.0, low), level(x, 0.0, high), duration=8.0)


def violations(check: PathCheck, count: int = 400) -> int:
    """Samples of the proved motion that leave a limit or the path, or at which an arm has another place of a joint."""
    cell, proved = check.cell, check.proved_trajectory()
    assert proved is not None
    places = np.linspace(0.0, proved.places[-1], count)
    x, solved = proved.positions(places)
    bad = ~solved | (x < cell.limits.lower - 1e-9).any(axis=1) | (x > cell.limits.upper + 1e-9).any(axis=1)
    for i, (row, T) in enumerate(zip(x, proved.poses(places), strict=True)):
        tools = CellState(cell, cell.configuration(row)).T_world_tool
        for own, X in zip(tools, check.grasp.T_object_tool, strict=True):
            bad[i] |= np.abs(own.homogeneous - T @ X.homogeneous).max() > 1e-9
    return int(bad.sum())


@pytest.mark.parametrize(("low", "high", "moves"), [(0.6, 1.45, False), (0.2, 1.7, True)])
def test_all_arms_prove_the_same_motion_of_the_lift(low: float, high: float, *, moves: bool) -> None:
    cell, grasp = lift_cell()
    check = check_path(cell, grasp, rise(low, high))
    assert check.verdict is PathVerdict.CERTIFIED
    (way,) = check.shared
    assert way.stands is not moves
    assert "joints that arms share: lift/lift" in check.explain()
    for arm in check.arms:
        assert arm.chosen is not None
        s = arm.chosen.trajectory.q[:, 0]
        np.testing.assert_allclose(s, way.at(arm.chosen.trajectory.places)[:, 0], rtol=0, atol=1e-15)
    assert violations(check) == 0


@pytest.mark.slow
def test_no_height_is_enough_for_what_the_lift_makes_possible() -> None:
    for height in np.linspace(0.02, 0.58, 5):
        cell, grasp = lift_cell(lower_limits={"lift": height - 1e-3}, upper_limits={"lift": height + 1e-3})
        assert not check_path(cell, grasp, rise(0.2, 1.75)).feasible
    cell, grasp = lift_cell()
    assert check_path(cell, grasp, rise(0.2, 1.75)).feasible


def test_corners_and_a_given_start() -> None:
    cell, grasp = lift_cell()
    path = WaypointPath([level(0.55, 0.0, 0.3), level(0.55, 0.05, 1.0), level(0.5, 0.0, 1.7)], durations=[4.0, 4.0])
    check = check_path(cell, grasp, path)
    assert check.verdict is PathVerdict.CERTIFIED
    assert violations(check) == 0
    assert check.q_start is not None
    again = check_path(cell, grasp, path, q_start=check.q_start)
    assert again.verdict is PathVerdict.CERTIFIED
    assert again.shared[0].s[0] == pytest.approx(check.shared[0].s[0], abs=1e-9)
    with pytest.raises(InvalidInputError, match="away from its grasp"):
        check_path(cell, grasp, path, q_start=held(cell, grasp, level(0.55, 0.0, 0.5), np.array([0.3])))


def test_a_start_is_one_of_all_arms() -> None:
    cell, grasp = lift_cell()
    start = find_start(cell, grasp, rise(0.2, 1.7))
    assert np.abs(grasp.relative_errors(CellState(cell, start.q))).max() < 1e-9
    for arm in start.arms:
        assert arm.chosen.q[0] == pytest.approx(cell.positions(start.q)[0], abs=1e-9)
    with pytest.raises(NoStartError, match="no start from which all arms that share joints"):
        find_start(cell, grasp, rise(0.2, 1.7, x=3.0))


@pytest.mark.slow
def test_what_is_not_proved_is_not_said_to_be_impossible() -> None:
    cell, grasp = lift_cell()
    check = check_path(cell, grasp, rise(0.2, 1.9))
    assert check.verdict is PathVerdict.UNDECIDED
    far = check_path(cell, grasp, rise(0.9, 1.5, x=1.2))
    assert far.verdict is PathVerdict.INFEASIBLE
    remedies = with_remedies(far).remedies
    assert {remedy.kind for remedy in remedies} == {"shift", "base"}
    (base,) = (remedy for remedy in remedies if remedy.kind == "base")
    assert "robot lift" in base.text
    assert base.check.verdict is PathVerdict.CERTIFIED
    bases = [arm.T_world_base.homogeneous for arm in base.check.cell.arms]
    np.testing.assert_array_equal(bases[0], bases[1])


def test_a_plan_counts_the_limits_of_the_lift() -> None:
    """It is followed at every step, and a slow lift makes it slower."""
    pytest.importorskip("toppra")
    durations = []
    for speed in (0.1, 0.04):
        cell, grasp = lift_cell(velocity_limits={"lift": speed})
        made = plan(cell, grasp, rise(0.2, 1.7))
        durations.append(made.path.duration)
        run = simulate(QPController(cell, grasp, made.path, dt=0.01), q_start=made.q_start, duration=20.0)
        assert run.finished
        assert run.time[-1] <= made.path.duration + 0.011
        errors = [np.abs(grasp.relative_errors(CellState(cell, q))[:, :3]).max() for q in run.q_command]
        assert max(errors) < 1e-6
    assert durations[1] > 0.2 / 0.04 > durations[0] > 0.2 / 0.1
    with pytest.raises(InvalidInputError, match=r"share 'lift'.*Lock them"):
        plan(cell, grasp, rise(0.8, 1.0), starts=3)
    with pytest.raises(InvalidInputError, match=r"time_path: .*share 'lift'|share 'lift'"):
        time_path(cell, grasp, rise(0.8, 1.0), q_start=made.q_start)


def test_links_of_the_lift_keep_their_distance_once() -> None:
    cell, grasp = lift_cell(geometry=True)
    scene = CollisionScene(cell=cell, grasp=grasp, margin=0.02)
    check = check_path(cell, grasp, rise(0.6, 1.45), scene=scene)
    assert check.verdict is PathVerdict.CERTIFIED
    assert check.clearance is not None
    assert check.clearance.margin > 0.02 or check.clearance.proved > 0.0


def test_the_time_of_the_shared_joint_comes_first() -> None:
    """A table with a narrow quick way and a wide slow one: the quick one, unless it is too narrow."""
    heights = np.linspace(0.0, 1.0, 5)[:, None]
    beside = [[i for i in (h - 1, h + 1) if 0 <= i < 5] for h in range(5)]
    search = _Search(np.linspace(0.0, 1.0, 3), np.ones(2), heights, beside, np.array([0.25]), None)
    table = np.full((3, 5), -np.inf)
    table[0, :2], table[1, 1:4], table[2, 2:] = 0.9, 0.9, 0.9
    assert search.constant(table) is None
    found = search.by_sample(table)
    assert found is not None
    assert found[3].tolist() == [1, 1, 2] or found[3].tolist() == [1, 2, 2]
    table[:, 1] = 0.5
    found = search.constant(table)
    assert found is not None
    assert found[1] == 0.5
    assert set(found[3].tolist()) == {1}


@pytest.mark.parametrize("seed", slow_unless(lambda seed: seed < 1, range(10)))
def test_certified_motions_finish(seed: int, tmp_path: Path) -> None:
    """Random bar motions with a lift, and with a revolute waist: what is certified is followed to its end."""
    rng = np.random.default_rng(seed)
    if seed % 2:
        cell, grasp = lift_cell()
        start = level(rng.uniform(0.4, 0.65), rng.uniform(-0.15, 0.15), rng.uniform(0.4, 1.2))
    else:
        cell = RobotCell([robot_of(WAIST, tmp_path, acceleration_limits=5.0)])
        grasp = Grasp((pin.SE3(np.eye(3), np.array([0.0, 0.2, 0.0])), pin.SE3(np.eye(3), np.array([0.0, -0.2, 0.0]))))
        start = level(rng.uniform(0.4, 0.6), rng.uniform(-0.1, 0.1), rng.uniform(0.6, 0.9))
    turn = pin.exp3(rng.uniform(-0.4, 0.4, 3))
    goal = pin.SE3(turn, start.translation + rng.uniform(-1.0, 1.0, 3) * [0.15, 0.3, 0.5])
    check = check_path(cell, grasp, LinePath(start, goal, duration=3.0))
    if not follows(check.verdict):
        return
    assert violations(check, 100) == 0
    run = simulate(QPController(cell, grasp, check.led_path(), dt=0.01), q_start=check.q_start, duration=20.0)
    assert run.finished
    errors = [np.abs(grasp.relative_errors(CellState(cell, q))[:, :3]).max() for q in run.q_command]
    assert max(errors) < 1e-6
