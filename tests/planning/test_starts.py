"""Starts: what is found follows the path inside limits; where a far larger search finds one, so does find_start."""

from __future__ import annotations

import copy
import itertools
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import one_arm_file
from user_cells import CELLS, build

from coopqp import (
    Arm,
    Grasp,
    HoldPath,
    InvalidInputError,
    LinePath,
    QPController,
    RobotCell,
    WaypointPath,
    find_start,
    load_cell_file,
    simulate,
)
from coopqp.constraints.samples import sample_path
from coopqp.errors import NoStartError, StartWarning, UnknownNameError, UnreachableError
from coopqp.files import CellFileError
from coopqp.model import CellState
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import find_branches
from coopqp.planning.arm_starts import arm_on_path
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift, robot_path, scara_pair

TASKS = {"mixed_cell": mixed_cell, "dual_arm7": dual_arm7, "scara_pair": scara_pair}


def chain_error(cell: RobotCell, grasp: Grasp, q: Any, T: pin.SE3) -> float:
    return max(float(np.abs(pin.log6(T.actInv(O)).vector).max()) for O in grasp.carried(CellState(cell, q)))


def exhaustive(arm: Arm, X: pin.SE3, path: Any, rng: Any) -> bool:
    """Whether twenty times as many seeds find a way of the arm: every turn of every solution, walked in 200 steps.

    The seeds are tried in parts, until one finds a way.
    """
    kinematics = ArmKinematics(arm)
    redundant = kinematics.n > 6
    poses = np.array([(path.pose(c) * X).homogeneous for c in np.linspace(0.0, path.duration, 201)])
    seeds = kinematics.seeds(20 * 256 if redundant else 20 * 192, rng)
    walked = np.empty((0, kinematics.n))
    for part in np.array_split(seeds, 40):
        answer = kinematics.solve(poses[0], part)
        starts = answer.q[answer.reached]
        if redundant:
            starts = kinematics.nearest_turns(starts)
            starts = starts[kinematics.margins(starts).min(axis=1) >= 0.0][: 1000 - len(walked)]
        before = len(walked)
        for q in starts:
            if redundant or not kinematics.same(walked, q, within=1e-5).any():
                walked = np.vstack([walked, q])
        if len(walked) > before and way_inside(kinematics, poses, walked[before:]):
            return True
    return False


def way_inside(kinematics: ArmKinematics, poses: Any, starts: Any) -> bool:
    """Whether a way from one of these starts is inside the limits at some turn, and away from singularities."""
    ways, reached = kinematics.trajectories(poses, starts)
    for way in ways[reached == len(poses) - 1]:
        fits = []
        for j in range(kinematics.n):
            turned = [way[:, j] + 2.0 * np.pi * k * bool(kinematics.turns[j]) for k in range(-3, 4)]
            fits.append(any((t >= kinematics.lower[j]).all() and (t <= kinematics.upper[j]).all() for t in turned))
        if all(fits) and kinematics.singular_values(way).min() >= 1e-3:
            return True
    return False


def check(cell: RobotCell, path: Any, start: Any) -> None:
    """The promises of a Start."""
    assert chain_error(cell, start.grasp, start.q, path.pose(0.0)) < 1e-11
    assert CellState(cell, start.q).limit_margins.min() >= -1e-8
    assert start.margins.min() >= -1e-8
    assert start.sigma_min.shape == (len(start.clocks), len(cell))
    np.testing.assert_allclose(start.sigma_min[0], CellState(cell, start.q).sigma_min, rtol=0, atol=1e-9)
    np.testing.assert_array_less(
        start.margins.clip(None, 1e3), CellState(cell, start.q).limit_margins.clip(None, 1e3) + 1e-7
    )
    for other in start.alternatives:
        assert chain_error(cell, start.grasp, other, path.pose(0.0)) < 1e-11
        assert CellState(cell, other).limit_margins.min() >= -1e-8
        assert np.abs(other - start.q).max() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, id=name.replace(", ", "+").replace(" ", "_")) for name in CELLS])
def test_a_start_is_found_wherever_a_far_larger_search_finds_one(name: str, rng: Any) -> None:
    """The cell as a user would build it, and with its arms moved and its tools rolled at random."""
    for variant in range(6):
        cell, grasp, path = build(name, rng if variant else None)
        possible = [
            arm.name
            for arm, X in zip(cell.arms, grasp.T_object_tool, strict=True)
            if exhaustive(arm, X, path, np.random.default_rng(variant))
        ]
        if len(possible) == len(cell):
            check(cell, path, find_start(cell, grasp, path))
            continue
        with pytest.raises(NoStartError) as caught:
            find_start(cell, grasp, path)
        assert set(caught.value.arms) == set(cell.arm_names) - set(possible)


@pytest.mark.parametrize("task", TASKS)
def test_a_run_from_the_start_found_tracks_the_whole_path(task: str) -> None:
    scenario = TASKS[task]()
    start = find_start(scenario.cell, scenario.grasp, scenario.path)
    check(scenario.cell, scenario.path, start)
    run = simulate(QPController(scenario.cell, start.grasp, scenario.path, dt=0.01), q_start=start.q)
    assert run.finished
    positions = np.array([scenario.cell.positions(q) for q in run.q])
    margins = np.minimum(positions - scenario.cell.limits.lower, scenario.cell.limits.upper - positions).min(axis=0)
    six = np.concatenate([np.full(s.stop - s.start, s.stop - s.start <= 6) for s in scenario.cell.v_slices])
    finite = six & np.isfinite(start.margins)  # a redundant arm may move its elbow otherwise
    np.testing.assert_allclose(start.margins[finite], margins[finite], rtol=0, atol=2e-3)


def test_margins_along_the_path_are_those_of_a_finer_walk(paper: Scenario) -> None:
    start = find_start(paper.cell, paper.grasp, paper.path)
    for k, (arm, found) in enumerate(zip(paper.cell.arms, start.arms, strict=True)):
        kinematics = ArmKinematics(arm)
        clocks = np.linspace(0.0, paper.path.duration, 1001)
        poses = np.array([(paper.path.pose(c) * start.grasp.T_object_tool[k]).homogeneous for c in clocks])
        margins = kinematics.margins(kinematics.walk(poses, found.chosen.q[None]).q[0])
        np.testing.assert_allclose(found.chosen.margins, margins.min(axis=0), rtol=0, atol=1e-3)
        assert found.margin == found.chosen.margins.min()
        assert found.tightest_joint == kinematics.joints[int(margins.min(axis=0).argmin())]
        assert found.clock == pytest.approx(clocks[margins.min(axis=1).argmin()], abs=0.1)


def test_of_all_branches_the_one_with_the_largest_margins_is_taken(paper: Scenario) -> None:
    start = find_start(paper.cell, paper.grasp, paper.path)
    for found in start.arms:
        scores = [branch.score for branch in found.branches if branch.feasible]
        assert found.chosen.score == max(scores)
        assert len(found.branches) == 8
    degrees = np.rad2deg(start.arms[0].margin)
    assert (
        f"of 8 branches follow the path; least margin {degrees:.1f}° at {start.arms[0].tightest_joint} ("
        in start.explain()
    )


def test_turns_are_chosen_for_the_whole_path() -> None:
    """Joint 6 of the RX-90L (±270°) turns by 300° along the path: only a start beyond −30° leaves room for it."""
    arm = Arm.from_urdf("arm", _rx90l(), tool_frame="flange", geometry=False)
    kinematics = ArmKinematics(arm)
    q = np.array([0.2, 0.3, 1.3, 0.1, 0.9, 0.0])
    for roll in (1.0, 2.0, 3.0, -2.5):
        q[5] = roll
        T = pin.SE3(kinematics.tool_poses(q[None])[0])
        steps = [T * pin.SE3(pin.exp3(np.array([0.0, 0.0, np.deg2rad(a)])), np.zeros(3)) for a in range(0, 301, 60)]
        path = WaypointPath(steps, durations=[1.0] * 5)
        start = find_start(RobotCell([arm]), Grasp((np.eye(4),)), path)
        assert start.margins[5] >= 0.0
        assert -np.deg2rad(270.0) <= start.q[5] <= np.deg2rad(-30.0)
        assert np.sin(start.q[5] - roll) == pytest.approx(0.0, abs=1e-9)


def _rx90l() -> Path:
    return Path(robot_path("rx90l"))


# -- where there is none ---------------------------------------------------------------------------------------------


def rolled_cell(roll: float) -> tuple[RobotCell, Grasp, HoldPath, float]:
    """One arm whose last joint is limited to ±2.5 rad, at a pose that needs the last joint at ``roll``."""
    arm = Arm.from_urdf("right", _rx90l(), tool_frame="flange", geometry=False).with_limits(
        lower=[-1.5, -2.3, -0.1, -1.5, -1.8, -2.5], upper=[1.5, 2.3, 2.4, 1.5, 2.0, 2.5]
    )
    q = np.array([0.2, 0.3, 1.3, 0.1, 0.9, roll])
    T = pin.SE3(ArmKinematics(arm).tool_poses(q[None])[0])
    return RobotCell([arm]), Grasp((np.eye(4),)), HoldPath(T), roll


def test_a_start_outside_is_named_with_joint_amount_and_a_remedy() -> None:
    cell, grasp, path, _ = rolled_cell(np.pi)
    with pytest.raises(NoStartError) as caught:
        find_start(cell, grasp, path)
    assert (
        str(caught.value) == f"arm right starts {np.rad2deg(np.pi - 2.5):.1f}° outside joint_6; roll its tool by 180°."
    )
    assert caught.value.arms == ("right",)
    assert isinstance(caught.value, UnreachableError)
    same = pickle.loads(pickle.dumps(caught.value))
    assert (same.arms, str(same)) == (caught.value.arms, str(caught.value))


def test_a_free_roll_is_the_remedy() -> None:
    cell, grasp, path, _ = rolled_cell(np.pi)
    start = find_start(cell, grasp, path, free_roll={"right": [np.pi]})
    assert start.arms[0].chosen.roll == np.pi
    check(cell, path, start)
    expected = grasp.T_object_tool[0] * pin.SE3(pin.utils.rotate("z", np.pi), np.zeros(3))
    np.testing.assert_allclose(start.grasp.T_object_tool[0].homogeneous, expected.homogeneous, atol=1e-12)
    assert "tool rolled by 180°" in start.explain()
    cell, grasp, path, _ = rolled_cell(0.3)
    assert find_start(cell, grasp, path).grasp is grasp


def test_a_limit_in_mid_path_is_named_with_its_clock(paper: Scenario) -> None:
    """The limits of joint 1 end where the path's second half needs it."""
    cell, grasp = RobotCell(paper.cell.arms[:1]), Grasp(paper.grasp.T_object_tool[:1])
    far = LinePath(paper.path.start, paper.path.start * pin.SE3(np.eye(3), np.array([0.0, 5.0, 0.0])), duration=2.0)
    with pytest.raises(NoStartError, match=r"arm master follows the path until \d\.\d\d s, where its reach ends"):
        find_start(cell, grasp, far)
    free = find_start(cell, grasp, paper.path)
    walk = [branch for branch in free.arms[0].branches if branch.feasible]
    tight = paper.cell.arms[0].with_limits(
        lower=np.minimum.reduce([b.q for b in walk]) - 0.01, upper=np.maximum.reduce([b.q for b in walk]) + 0.01
    )
    with pytest.raises(NoStartError, match=r"arm master goes \d+\.\d° outside joint_\d at \d\.\d\d s of the path; "):
        find_start(RobotCell([tight]), grasp, paper.path)


def test_every_arm_without_a_start_is_named(paper: Scenario) -> None:
    away = pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0]))
    arms = [arm.placed(away * arm.T_world_base) if k != 1 else arm for k, arm in enumerate(paper.cell.arms)]
    with pytest.raises(NoStartError) as caught:
        find_start(RobotCell(arms), paper.grasp, paper.path)
    assert caught.value.arms == ("master", "slave_2")
    assert "arm master does not reach its grasp at the start of the path" in str(caught.value)
    assert "move its base or the path" in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ({"free_roll": {"nobody": [1.0]}}, UnknownNameError, "nobody"),
        ({"free_roll": {"master": ["round"]}}, InvalidInputError, r"free_roll\['master'\]"),
        ({"free_roll": {"master": [np.nan]}}, InvalidInputError, r"free_roll\['master'\]"),
        ({"q_near": np.zeros(3)}, InvalidInputError, "q_near"),
        ({"seed_factor": 0}, InvalidInputError, "seed_factor"),
        ({"grasp": Grasp((np.eye(4),))}, InvalidInputError, "1 placements for 3 arms"),
    ],
)
def test_bad_input(paper: Scenario, arguments: dict[str, Any], error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says):
        find_start(**{"cell": paper.cell, "grasp": paper.grasp, "path": paper.path, **arguments})


def test_the_same_question_has_the_same_answer(paper: Scenario) -> None:
    one, other = (find_start(paper.cell, paper.grasp, paper.path) for _ in range(2))
    np.testing.assert_array_equal(one.q, other.q)
    near = find_start(paper.cell, paper.grasp, paper.path, q_near=paper.q_start)
    np.testing.assert_allclose(near.q, one.q, rtol=0, atol=1e-9)


# -- samples ---------------------------------------------------------------------------------------------------------


def test_samples_contain_ends_and_breakpoints_and_are_close_to_each_other(paper: Scenario, rng: Any) -> None:
    poses = [paper.path.start * pin.exp6(pin.Motion(rng.uniform(-0.4, 0.4, 6))) for _ in range(4)]
    path = WaypointPath(poses, durations=[1.0, 0.3, 2.0])
    samples = sample_path(path, paper.grasp)
    assert {0.0, 1.0, 1.3, 3.3} <= set(np.round(samples.clocks, 12))
    assert (np.diff(samples.clocks) > 0.0).all()
    for X in paper.grasp.T_object_tool:
        tools = samples.tool_poses(X)
        for a, b in itertools.pairwise(tools):
            assert np.linalg.norm(a[:3, 3] - b[:3, 3]) <= 0.0201
            assert np.linalg.norm(pin.log3(a[:3, :3].T @ b[:3, :3])) <= 0.0501
    for clock, pose in zip(samples.clocks, samples.poses, strict=True):
        np.testing.assert_array_equal(pose.homogeneous, path.pose(clock).homogeneous)


# -- in use ----------------------------------------------------------------------------------------------------------


def test_simulate_finds_a_start(paper: Scenario) -> None:
    run = simulate(QPController(paper.cell, paper.grasp, paper.path, dt=0.02))
    np.testing.assert_array_equal(run.q[0], find_start(paper.cell, paper.grasp, paper.path).q)
    assert run.finished
    far = HoldPath(pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    with pytest.raises(NoStartError, match="arm master does not reach"):
        simulate(QPController(paper.cell, paper.grasp, far, dt=0.02), duration=1.0)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_a_start_outside_limits_is_said_until_the_arm_is_inside(paper: Scenario) -> None:
    """The limit of one joint is 1° on the inner side of its start, or 20°."""
    for degrees, comes_inside in ((1.0, True), (20.0, False)):
        upper = paper.cell.limits.upper.copy()
        upper[8] = paper.q_start[8] - np.deg2rad(degrees)
        cell = paper.cell.with_limits(upper=upper)
        controller = QPController(cell, paper.grasp, HoldPath(paper.path.start), dt=0.01)
        controller.reset(paper.q_start)
        first = controller.step()
        said = f"arm slave_1 started outside its limits: joint_3 is {degrees:.1f}° outside"
        assert said in first.reason
        assert said in first.explain()
        twin = copy.deepcopy(controller)
        steps = [controller.step() for _ in range(200)]
        for step in steps:
            outside = cell.positions(step.q)[8] - upper[8] > 1e-9
            assert ("outside its limits: joint_3" in step.reason) == outside
        again = [twin.step() for _ in range(200)]
        assert [s.reason for s in again] == [s.reason for s in steps]
        np.testing.assert_array_equal([s.q_next for s in again], [s.q_next for s in steps])
        inside = "outside" not in steps[-1].reason
        assert inside or not comes_inside


def test_a_start_inside_limits_is_not_spoken_of(paper: Scenario) -> None:
    controller = QPController(paper.cell, paper.grasp, paper.path, dt=0.01)
    controller.reset(paper.q_start)
    assert all(controller.step().reason == "" for _ in range(5))


HOLD = """kind = "hold"
pose = {{ xyz_m = [{x}, 0.1, 0.6], rpy_deg = [0, 120, 0] }}"""


def cell_file(folder: Path, *, x: float = 0.7, **others: str) -> Path:
    return Path(one_arm_file(folder, HOLD.format(x=x), **others))


@pytest.mark.parametrize("start", ["", 'start = "auto"'])
def test_a_cell_file_without_a_start_has_one_found(tmp_path: Path, start: str) -> None:
    task = load_cell_file(cell_file(tmp_path, start=start)).scenario
    np.testing.assert_array_equal(task.q_start, find_start(task.cell, task.grasp, task.path).q)


def test_a_start_that_is_corrected_far_is_said(tmp_path: Path) -> None:
    found = np.rad2deg(load_cell_file(cell_file(tmp_path)).scenario.q_start)
    for away, said in ((15.0, []), (-25.0, ["arm a takes hold with joint_1 25.0° from the positions that are given"])):
        near = found + np.array([away, 0.0, 0.0, 0.0, 0.0, 0.0])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            run = load_cell_file(cell_file(tmp_path, start=f"start = {{ positions_deg = {{ a = {near.tolist()} }} }}"))
        np.testing.assert_allclose(run.scenario.q_start, np.deg2rad(found), atol=1e-8)
        assert [str(w.message).partition(": ")[2].partition(";")[0] for w in caught] == said
        assert all(w.category is StartWarning for w in caught)


def test_a_cell_file_without_a_start_says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(CellFileError, match=r"one\.toml: a latched grasp .*: give start\.positions_deg or"):
        load_cell_file(cell_file(tmp_path, grasp="latched"))
    with pytest.raises(CellFileError, match=r"one\.toml: arm a does not reach its grasp .*; move its base"):
        load_cell_file(cell_file(tmp_path, x=5.0))
    with pytest.raises(CellFileError, match=r'start: give a table or "auto"'):
        load_cell_file(cell_file(tmp_path, start='start = "home"'))


def test_starts_of_a_redundant_arm_are_also_led_away_from_its_limits() -> None:
    """Its elbow may stand anywhere; an arm of six joints has its branches alone."""
    for make, redundant in ((dual_arm7, True), (paper_lift, False)):
        task = make()
        samples, X = sample_path(task.path, task.grasp), task.grasp.T_object_tool[0]
        kinematics, near = ArmKinematics(task.cell.arms[0]), task.q_start[None, task.cell.q_slices[0]]
        found = find_branches(kinematics, samples.tool_poses(X)[0], near=near)
        rows = arm_on_path(kinematics, samples, X, near=near).branches
        for row in rows:
            assert kinematics.solve(samples.tool_poses(X)[:1], row.q[None], steps=1).residual[0] < 1e-8
        others = [row.q for row in rows if np.abs(found.q - row.q).max(axis=1).min() > 1e-3]
        assert bool(others) is redundant
        if redundant:
            room = kinematics.margins(np.array(others)).min(axis=1)
            assert room.min() > np.median(kinematics.margins(found.q).min(axis=1))
