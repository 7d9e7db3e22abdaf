"""The check of a path before the motion, against dense samples of Pinocchio's kinematics that share no code with it."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import make_interp_spline
from scipy.linalg.lapack import dgesv
from user_paths import Opaque

from coopqp import (
    Arm,
    Grasp,
    HoldPath,
    InvalidInputError,
    LinePath,
    ObjectPath,
    RobotCell,
    ServoPath,
    WaypointPath,
    check_path,
    find_start,
    plan,
)
from coopqp.errors import NoStartError
from coopqp.model import CellState
from coopqp.planning import PathVerdict, find_remedies
from coopqp.planning.remedies import shifted, with_remedies
from coopqp.scenarios import (
    ROBOTS,
    Scenario,
    at_limit,
    at_singularity,
    mixed_cell,
    ring,
    robot_arm,
    robot_path,
    scara_pair,
)
from coopqp.simulation import chain_error, tool_placements

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict
LOOSE = np.deg2rad(0.3)


def arm_of(name: str) -> Arm:
    if name in ("rx90l", "arm6c", "gantry7", "arm7"):
        tool = ROBOTS[name].tool_frame
        return Arm.from_urdf(name, robot_path(name), tool_frame=tool, geometry=False)
    return robot_arm(name, geometry=False)


class Oracle:
    """One arm in Pinocchio."""

    def __init__(self, arm: Arm) -> None:
        self.arm, self.model, self.data = arm, arm.model, arm.model.createData()
        self.frame = arm.model.getFrameId(arm.tool_frame)
        joints = list(arm.model.joints)[1:]
        self.at = np.array([joint.idx_q for joint in joints])
        self.continuous = np.array([joint.nq > 1 for joint in joints])
        self.angles_only = not self.continuous.any()

    def configuration(self, x: Any) -> Any:
        """Continuous joints are (cos, sin) in Pinocchio."""
        if self.angles_only:
            return x
        q = np.empty(self.model.nq)
        q[self.at] = np.where(self.continuous, np.cos(x), x)
        q[self.at[self.continuous] + 1] = np.sin(x[self.continuous])
        return q

    def reach(self, T: pin.SE3, x: Any) -> tuple[Any, Any]:
        """Newton's method from ``x`` to a tool pose in the world: the Jacobian, and the joints or None."""
        target = self.arm.T_world_base.actInv(T)
        for _ in range(12):
            pin.computeJointJacobians(self.model, self.data, self.configuration(x))
            error = pin.log6(pin.updateFramePlacement(self.model, self.data, self.frame).actInv(target)).vector
            J = pin.getFrameJacobian(self.model, self.data, self.frame, pin.LOCAL)
            if error.dot(error) < 1e-20:
                return J, x
            # LAPACK itself: of a small system NumPy's solve takes five times as long.
            x = x + (dgesv(J, error)[2] if len(x) == 6 else np.linalg.lstsq(J, error, rcond=None)[0])
        return J, x if np.abs(error).max() < 1e-9 else None

    def walk(self, tools: Sequence[pin.SE3], guesses: Any) -> tuple[Any, Any]:
        """Joint positions and Jacobians at tool poses, up to the last reached without a jump.

        Newton's method starts at the guesses, and where they end at what the last three positions lead to.
        """
        rows, jacobians = [], []
        for i, T in enumerate(tools):
            if i < len(guesses):
                x = guesses[i]
            elif i >= 3:
                x = 3.0 * (rows[-1] - rows[-2]) + rows[-3]
            J, x = self.reach(T, x)
            if x is None:
                break
            rows.append(x)
            jacobians.append(J)
        jumps = np.append(np.abs(np.diff(rows, axis=0)).max(axis=1), np.inf) > 0.5
        n = int(jumps.argmax()) + 1
        return np.array(rows[:n]), np.array(jacobians[:n])

    def follow(self, tools: Sequence[pin.SE3], q: Any) -> tuple[Any, Any]:
        """Joint positions and σ_min at tool poses in the world, from ``q``, up to the last reached without a jump.

        A curve through every eighth position is a guess of the others that leaves little to Newton's method.
        """
        at, guesses = np.append(np.arange(0, len(tools) - 1, 8), len(tools) - 1), q[None]
        knots, _ = self.walk([tools[i] for i in at], guesses)
        if len(knots) == len(at):
            guesses = make_interp_spline(at, knots, k=5)(np.arange(len(tools)))
        rows, jacobians = self.walk(tools, guesses)
        squares = np.linalg.eigvalsh(jacobians @ jacobians.transpose(0, 2, 1))[:, 0]
        return rows, np.sqrt(np.maximum(squares, 0.0))


def tool_poses(path: ObjectPath, X: pin.SE3, samples: int) -> list[pin.SE3]:
    """Poses of a tool that holds the object at ``X``, at samples of a path."""
    return [path.pose(clock) * X for clock in np.linspace(0.0, path.duration, samples)]


def random_task(arm: Arm, rng: Any) -> tuple[RobotCell, Grasp, ObjectPath]:
    """A path that begins where the arm reaches, along one or two segments."""
    limits = arm.limits
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    placed = arm.placed(pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-1.0, 1.0, 3)))
    oracle = Oracle(arm)
    pin.framesForwardKinematics(arm.model, oracle.data, oracle.configuration(rng.uniform(low, high)))
    X = pin.SE3(pin.exp3(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.3, 0.3, 3))
    T = [placed.T_world_base * oracle.data.oMf[oracle.frame] * X.inverse()]
    for _ in range(rng.integers(1, 3)):
        turn = pin.exp3(rng.uniform(-0.6, 0.6, 3))
        T.append(pin.SE3(turn @ T[-1].rotation, T[-1].translation + rng.uniform(-0.2, 0.2, 3)))
    law = ("linear", "quintic")[rng.integers(2)]
    path = WaypointPath(T, durations=rng.uniform(0.5, 2.0, len(T) - 1), time_law=law)
    return RobotCell([placed]), Grasp((X,)), path


def judged(robots: tuple[str, ...], enough: int, rng: Any, samples: int = 1001) -> dict[str, Any]:
    """Check random tasks until enough branches are certified; compare every branch with dense samples."""
    count = {"certified": 0, "feasible": 0, "undecided": 0, "loosest": 0.0}
    for name in itertools.cycle(robots):
        cell, grasp, path = random_task(arm_of(name), rng)
        limits, oracle = cell.limits, Oracle(cell.arms[0])
        dense, coarse = (tool_poses(path, grasp.T_object_tool[0], n) for n in (samples, samples // 4))
        for branch in check_path(cell, grasp, path).arms[0].branches:
            start = branch.q[0]
            if np.minimum(start - limits.lower, limits.upper - start).min() < -1e-9:
                assert branch.verdict is INFEASIBLE
                continue
            tools = dense if branch.verdict is CERTIFIED else coarse
            q, sigma = oracle.follow(tools, start)
            margins = np.minimum(q - limits.lower, limits.upper - q).min(axis=0)
            follows = len(q) == len(tools) and margins.min() >= 0.0
            if branch.verdict is CERTIFIED:
                count["certified"] += 1
                assert follows, f"{name}: the branch from {start} does not follow the path"
                finite = np.isfinite(margins)
                loose = margins[finite] - branch.margins[finite]
                assert loose.min(initial=0.0) >= -1e-8
                assert 0.0 < branch.sigma_bound <= sigma.min() + 1e-9
                assert branch.sigma_min.min() <= 1.7 * sigma.min()
                count["loosest"] = max(count["loosest"], float(loose.max(initial=0.0)))
            if follows and sigma.min() >= 0.05 and margins.min() > 1e-4:
                assert branch.verdict in (CERTIFIED, UNDECIDED)
                count["feasible"] += 1
                count["undecided"] += int(branch.verdict is UNDECIDED)
        if count["certified"] >= enough:
            return count
    raise AssertionError


@pytest.mark.slow
def test_certified_branches_hold_at_dense_samples(rng: Any) -> None:
    count = judged(("rx90l", "ur5"), 10, rng, samples=201)
    assert count["loosest"] <= LOOSE
    assert count["undecided"] == 0


@pytest.mark.slow
def test_five_hundred_certified_branches_hold_at_a_thousand_samples(rng: Any) -> None:
    count = judged(("rx90l", "ur5", "ur10", "arm6c"), 500, rng)
    assert count["loosest"] <= LOOSE
    assert count["undecided"] <= 0.01 * count["feasible"]


# -- redundant arms ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["arm7", "gantry7"])
def test_the_motion_of_a_redundant_arm_that_is_proved_is_one_that_it_can_make(robot: str, rng: Any) -> None:
    """Between the samples of the answer the arm follows by short steps, inside its limits and with σ_min."""
    certified = 0
    for _ in range(6):
        cell, grasp, path = random_task(arm_of(robot), rng)
        limits, oracle = cell.limits, Oracle(cell.arms[0])
        for branch in check_path(cell, grasp, path).arms[0].branches[:2]:
            if branch.verdict is not CERTIFIED:
                continue
            certified += 1
            assert (np.diff(branch.clocks) > -1e-12).all()
            assert np.abs(np.diff(branch.q, axis=0)).max() < 0.5
            for clock in np.linspace(0.0, path.duration, 101):
                k = min(int(np.searchsorted(branch.clocks, clock, side="right")), len(branch.clocks) - 1)
                a, b = branch.clocks[k - 1], branch.clocks[k]
                guess = branch.q[k - 1] + (clock - a) / (b - a) * (branch.q[k] - branch.q[k - 1])
                J, x = oracle.reach(path.pose(clock) * grasp.T_object_tool[0], guess)
                assert x is not None
                assert np.abs(x - guess).max() < 0.05
                assert np.minimum(x - limits.lower, limits.upper - x).min() >= branch.margins.min() - 1e-3
                assert np.linalg.svd(J, compute_uv=False)[-1] >= branch.sigma_bound - 1e-3
    assert certified >= 4


def test_a_redundant_arm_is_led_away_from_its_limits() -> None:
    """A limit stands where the plain walk needs joint 3; the arm follows nevertheless, with a motion of its elbow."""
    cell, grasp, path = bar(arm_of("arm7"))
    verdicts = []
    for j, share in ((2, 0.6), (0, 0.4)):
        free = check_path(cell, grasp, path).arms[0].chosen
        assert free is not None
        moved = free.q[:, j] - free.q[0, j]
        far = float(moved[np.abs(moved).argmax()])
        lower, upper = (x.copy() for x in (cell.limits.lower, cell.limits.upper))
        (upper if far > 0.0 else lower)[j] = free.q[0, j] + share * far
        tight = cell.with_limits(lower=lower, upper=upper)
        check = check_path(tight, grasp, path, q_start=cell.configuration(free.q[0]))
        verdicts.append(check.verdict)
    assert verdicts == [CERTIFIED, UNDECIDED]
    assert "another motion of its elbow was not found, but is not excluded" in check.explain()


def test_a_redundant_arm_that_starts_on_a_limit_starts_inside() -> None:
    """It leaves the limits later, at joint 0: another motion of its elbow is not excluded."""
    cell, grasp, path = bar(arm_of("arm7"))
    free = check_path(cell, grasp, path).arms[0].chosen
    assert free is not None
    first, lower, upper = free.q[0], cell.limits.lower.copy(), cell.limits.upper.copy()
    moved = free.q[:, 0] - first[0]
    far = float(moved[np.abs(moved).argmax()])
    (upper if far > 0.0 else lower)[0] = first[0] + 0.4 * far
    away = free.q - first
    j = int(next(j for j in range(1, 7) if (away[:, j] >= 0.0).all() or (away[:, j] <= 0.0).all()))
    (lower if away[-1, j] > 0.0 else upper)[j] = first[j]
    check = check_path(cell.with_limits(lower=lower, upper=upper), grasp, path, q_start=cell.configuration(first))
    assert check.verdict is UNDECIDED
    assert "another motion of its elbow was not found, but is not excluded" in check.explain()


def test_a_redundant_arm_is_infeasible_where_it_has_no_configuration() -> None:
    cell, grasp, path = bar(arm_of("arm7"))
    away = LinePath.displaced(path.pose(0.0), translation=(3.0, 0.0, 0.0), duration=1.0)
    check = check_path(cell, grasp, away)
    assert check.verdict is INFEASIBLE
    assert "no configuration inside its limits reaches the pose" in check.explain()


def bar(arm: Arm) -> tuple[RobotCell, Grasp, LinePath]:
    """One arm that holds from above, and a path of 40 cm."""
    down = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    start = pin.SE3(np.eye(3), np.array([0.45, -0.15, 0.3]))
    path = LinePath.displaced(start, translation=(0.0, 0.35, 0.15), rotation=(0.2, 0.0, 0.4), duration=2.0)
    return RobotCell([arm]), Grasp((down,)), path


# -- near a wrist singularity ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("miss", [1e-3, 3e-4, 1e-5, 0.0])
def test_a_wrist_that_is_passed_closely_is_never_certified(miss: float) -> None:
    """Not with the longest tool that coopqp knows, either: σ_min is at most the miss times the lever."""
    task = at_singularity(miss=miss)
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    assert check.verdict is UNDECIDED
    assert {i.arm for i in check.intervals} == {"arm_1"}
    assert [arm.verdict for arm in check.arms[1:]] == [CERTIFIED, CERTIFIED]
    q, sigma = Oracle(task.cell.arms[0]).follow(
        tool_poses(task.path, task.grasp.T_object_tool[0], 2001), task.q_start[:6]
    )
    clocks = np.linspace(0.0, task.path.duration, 2001)[: len(q)]
    worst = clocks[sigma.argmin()]
    assert any(i.start <= worst <= i.end or abs(worst - i.start) < 2e-3 for i in check.intervals)


@pytest.mark.slow
def test_a_wrist_that_is_passed_at_some_distance_is_certified() -> None:
    for miss in (0.3, 0.1, 0.03):
        task = at_singularity(miss=miss)
        check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
        assert check.verdict is CERTIFIED
        _, sigma = Oracle(task.cell.arms[0]).follow(
            tool_poses(task.path, task.grasp.T_object_tool[0], 4001), task.q_start[:6]
        )
        branch = check.arms[0].chosen
        assert branch is not None
        assert branch.sigma_bound <= sigma.min() <= branch.sigma_min.min() + 1e-6


# -- verdicts ----------------------------------------------------------------------------------------------------------


def test_the_answer_is_complete(paper: Scenario) -> None:
    check = check_path(paper.cell, paper.grasp, paper.path)
    assert check.verdict is CERTIFIED
    assert check.feasible
    assert check.intervals == ()
    assert repr(check) == "PathCheck(certified; master: certified, slave_1: certified, slave_2: certified)"
    assert check.q_start is not None
    assert chain_error(tool_placements(paper.cell, [check.q_start])[0], paper.grasp)[0] < 1e-11
    np.testing.assert_allclose(check.q_start, find_start(paper.cell, paper.grasp, paper.path).q, rtol=0, atol=1e-9)
    said = check.explain().splitlines()
    assert said[0] == "The arms can follow the whole path: this is proved at every point of it."
    for arm, line in zip(check.arms, said[1:], strict=True):
        branch = arm.chosen
        assert branch is not None
        assert len(arm.branches) == 8
        np.testing.assert_allclose(branch.certified, [[0.0, paper.path.duration]])
        joint, angle = arm.joints[branch.tightest], np.rad2deg(branch.margins.min())
        assert f"2 of 8 branches follow the path; least margin {angle:.1f}° at {joint}" in line
        for other in arm.branches:
            assert (other.why == "") == (other.verdict is CERTIFIED)
        assert len(arm.table()) == 9
        product = np.prod(np.linalg.svd(state_jacobian(paper, branch.q[0], arm.arm), compute_uv=False))
        assert branch.manipulability[0] == pytest.approx(product)


def state_jacobian(task: Scenario, q: Any, arm: str) -> Any:
    whole = task.q_start.copy()
    whole[task.cell.v_slices[task.cell.index(arm)]] = q
    return CellState(task.cell, whole).jacobian(arm)


def test_the_proof_knows_no_time_law(paper: Scenario) -> None:
    starts = paper.path.start, paper.path.pose(3.0)
    kinds = ((3.0, "linear"), (3.0, "quintic"), (40.0, "linear"))
    laws = [LinePath(*starts, duration=duration, time_law=law) for duration, law in kinds]
    checks = [check_path(paper.cell, paper.grasp, path, q_start=paper.q_start) for path in laws]
    for check, path in zip(checks, laws, strict=True):
        for arm, other in zip(check.arms, checks[0].arms, strict=True):
            assert arm.chosen is not None
            assert other.chosen is not None
            np.testing.assert_allclose(arm.chosen.margins, other.chosen.margins, rtol=0, atol=1e-4)
            np.testing.assert_allclose(arm.chosen.certified, [[0.0, path.duration]], rtol=1e-12)
            for clock, q in zip(arm.chosen.clocks[::5], arm.chosen.q[::5], strict=True):
                X = paper.grasp.T_object_tool[paper.cell.index(arm.arm)]
                whole = paper.q_start.copy()
                whole[paper.cell.v_slices[paper.cell.index(arm.arm)]] = q
                T = tool_placements(paper.cell, [whole])[0][paper.cell.index(arm.arm)]
                assert np.abs(pin.log6(T.actInv(path.pose(clock) * X)).vector).max() < 1e-8


def test_where_there_is_no_proof_samples_are_said(paper: Scenario) -> None:
    check = check_path(paper.cell, paper.grasp, Opaque(paper.path))
    assert check.verdict is SAMPLED
    assert check.feasible
    assert "the proof knows lines, rounded corners" in check.explain()
    task = scara_pair()
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    assert check.verdict is SAMPLED
    assert "the proof needs six joints, and it has 4" in check.explain()
    tilted = LinePath.displaced(task.path.pose(0.0), rotation=(0.2, 0.0, 0.0), duration=1.0)
    check = check_path(task.cell, task.grasp, tilted, q_start=task.q_start)
    assert check.verdict is INFEASIBLE
    assert "until 0.00 s, where it would need a motion that 4 joints cannot make" in check.explain()
    with pytest.raises(NoStartError, match="a motion that 4 joints cannot make"):
        find_start(task.cell, task.grasp, tilted)
    servo = check_path(paper.cell, paper.grasp, ServoPath(paper.path.start), q_start=paper.q_start)
    assert servo.verdict is SAMPLED
    assert "judged at its start alone" in servo.explain()
    hold = check_path(paper.cell, paper.grasp, HoldPath(paper.path.start))
    assert hold.verdict is CERTIFIED


def test_a_planned_path_is_certified_and_so_are_rounded_corners(paper: Scenario) -> None:
    poses = [paper.path.pose(clock) for clock in (0.0, 1.5, 3.0)]
    poses[1] = pin.SE3(poses[1].rotation, poses[1].translation + np.array([0.05, 0.0, 0.0]))
    cell = paper.cell.with_limits(acceleration=5.0)
    corner = WaypointPath(poses, durations=[1.0, 1.0])
    planned = plan(cell, paper.grasp, corner, q_start=paper.q_start)
    check = check_path(cell, paper.grasp, planned.path, q_start=planned.q_start)
    assert check.verdict is CERTIFIED
    for arm in check.arms:
        assert arm.chosen is not None
        np.testing.assert_allclose(arm.chosen.certified, [[0.0, planned.path.duration]], rtol=0, atol=1e-9)
    rounded = plan(cell, paper.grasp, corner, q_start=paper.q_start, blend=0.005)
    assert check_path(cell, paper.grasp, rounded.path, q_start=rounded.q_start).verdict is CERTIFIED


def test_a_limit_on_the_way_is_named_with_joint_clock_and_amount() -> None:
    task = at_limit()
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    assert check.verdict is INFEASIBLE
    head, first = check.explain().splitlines()[:2]
    assert head == "The arms cannot follow the path from this start."
    assert first.startswith("arm master leaves the limits of joint_2 at 0.6")
    for k, arm in enumerate(check.arms):
        branch = arm.chosen
        assert branch is not None
        own = task.cell.v_slices[k]
        limits = task.cell.limits
        q, _ = Oracle(task.cell.arms[k]).follow(
            tool_poses(task.path, task.grasp.T_object_tool[k], 2001), task.q_start[own]
        )
        outside = ((q < limits.lower[own]) | (q > limits.upper[own])).any(axis=1)
        clocks = np.linspace(0.0, task.path.duration, 2001)
        assert branch.until == pytest.approx(clocks[outside.argmax()], abs=0.01)
    anywhere = check_path(task.cell, task.grasp, task.path)
    assert anywhere.q_start is None
    assert "from any start" in anywhere.explain()
    tight = task.cell.with_limits(upper=task.q_start - 1e-3, lower=task.q_start - 1.0)
    outside = check_path(tight, task.grasp, task.path, q_start=task.q_start)
    assert "starts 0.1° outside" in outside.explain()


def test_out_of_reach_is_infeasible(paper: Scenario) -> None:
    away = HoldPath(pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    check = check_path(paper.cell, paper.grasp, away)
    assert check.verdict is INFEASIBLE
    assert check.q_start is None
    assert "arm master does not reach its grasp at the start of the path" in check.explain()
    assert all(arm.branches == () and arm.chosen is None for arm in check.arms)
    for kind in ("elbow", "reach"):
        task = at_singularity(kind=kind)
        check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
        assert check.verdict is INFEASIBLE
        assert "where its reach ends or it is singular" in check.explain()


def test_a_start_that_does_not_hold_the_object_is_refused(paper: Scenario) -> None:
    q = paper.q_start.copy()
    q[8] += 0.02
    with pytest.raises(
        InvalidInputError, match=r"q_start: arm 'slave_1' is \d+\.\d mm and 1\.\d+° away from its grasp"
    ):
        check_path(paper.cell, paper.grasp, paper.path, q_start=q)
    for arguments in ({"q_start": q[:3]}, {"seed_factor": 0}, {"path": 3}, {"grasp": Grasp((np.eye(4),))}):
        with pytest.raises(InvalidInputError):
            check_path(**{"cell": paper.cell, "grasp": paper.grasp, "path": paper.path, **arguments})


def test_far_from_the_origin_the_answer_is_the_same(paper: Scenario) -> None:
    far = pin.SE3(np.eye(3), np.array([1e4, -2e3, 0.0]))
    cell = RobotCell([arm.placed(far * arm.T_world_base) for arm in paper.cell.arms])
    here, there = (
        check_path(
            c,
            paper.grasp,
            LinePath(T * paper.path.start, T * paper.path.pose(3.0), duration=3.0, time_law="linear"),
            q_start=paper.q_start,
        )
        for c, T in ((paper.cell, pin.SE3.Identity()), (cell, far))
    )
    assert there.verdict is CERTIFIED
    for a, b in zip(here.arms, there.arms, strict=True):
        assert a.chosen is not None
        assert b.chosen is not None
        np.testing.assert_allclose(b.chosen.margins, a.chosen.margins, rtol=0, atol=1e-6)


def test_every_arm_of_a_mixed_cell_is_certified() -> None:
    task = mixed_cell()
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    assert [arm.verdict for arm in check.arms] == [CERTIFIED] * len(task.cell)
    assert "the proof holds for one motion of their elbows" in check.explain()
    many = ring(arms=16)
    assert check_path(many.cell, many.grasp, many.path, q_start=many.q_start).verdict is CERTIFIED


# -- remedies ----------------------------------------------------------------------------------------------------------


def dense_check(check: Any) -> bool:
    """The start of a check against dense samples: all arms follow the whole path inside their limits."""
    for k, (arm, X) in enumerate(zip(check.cell.arms, check.grasp.T_object_tool, strict=True)):
        own = check.cell.v_slices[k]
        q, sigma = Oracle(arm).follow(tool_poses(check.path, X, 301), check.cell.positions(check.q_start)[own])
        if len(q) < 301 or np.minimum(q - arm.limits.lower, arm.limits.upper - q).min() < 0.0 or sigma.min() < 1e-3:
            return False
    return True


@pytest.mark.slow
def test_what_was_tried_in_vain_is_said(paper: Scenario) -> None:
    """A path far out of reach: each kind says why it is of no help, in words and in the record."""
    far = shifted(paper.path, np.array([0.0, 0.0, 9.0]))
    check = with_remedies(check_path(paper.cell, paper.grasp, far))
    assert check.remedies == ()
    first = paper.cell.arm_names[0]
    said = [line for line in check.explain().splitlines() if line.startswith("no remedy by ")]
    assert len(said) == 3
    assert f"no remedy by moving the path: arm {first} follows it at none of 130 places up to 0.5 m away." in said
    assert all(f"arm {first} follows" in line for line in said)
    assert check.record()["no_remedy"] == list(check.no_remedy)


def test_another_branch_is_the_remedy_for_a_start() -> None:
    task = at_singularity()
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    (remedy,) = find_remedies(check)
    assert remedy.kind == "branch"
    assert str(remedy) == "start arm arm_1 in another branch (certified)"
    assert dense_check(remedy.check)
    assert not dense_check(check)
    assert find_remedies(remedy.check) == ()


def cable_cell() -> tuple[RobotCell, Grasp, LinePath]:
    """Two RX-90L that face each other; a cable lets joints 4 and 6 of the left one turn by ±100° only."""
    down = np.diag([1.0, -1.0, -1.0])
    arms = [
        arm_of("rx90l").placed(pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0.0, 0.0])), name=name)
        for name, x, yaw in (("left", -1.1, 0.0), ("right", 1.1, np.pi))
    ]
    lower, upper = arms[0].limits.lower.copy(), arms[0].limits.upper.copy()
    lower[[3, 5]], upper[[3, 5]] = np.deg2rad([[-100], [100]])
    grasp = Grasp(tuple(pin.SE3(down, np.array([x, 0.0, 0.0])) for x in (-0.4, 0.4)))
    start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    path = LinePath.displaced(start, translation=(0.0, 0.2, 0.2), rotation=(0.0, 0.0, 0.3), duration=3.0)
    return RobotCell([arms[0].with_limits(lower=lower, upper=upper), arms[1]]), grasp, path


@pytest.mark.slow
def test_a_roll_of_the_tool_is_found() -> None:
    check = check_path(*cable_cell())
    assert check.verdict is INFEASIBLE
    remedies = find_remedies(check)
    assert remedies[0].kind == "roll"
    assert remedies[0].text == "roll the tool of arm left by 180°"
    np.testing.assert_allclose(remedies[0].roll, [np.pi, 0.0])
    for remedy in remedies:
        assert remedy.check.feasible
        assert dense_check(remedy.check)


@pytest.mark.slow
def test_a_shift_of_the_path_and_of_a_base_are_found(paper: Scenario) -> None:
    """The path leads the first arm out of its reach."""
    arm = paper.cell.arms[0]
    cell, grasp = RobotCell([arm]), Grasp(paper.grasp.T_object_tool[:1])
    far = LinePath.displaced(paper.path.start, translation=(0.0, 0.9, 0.25), duration=2.0)
    check = check_path(cell, grasp, far)
    assert check.verdict is INFEASIBLE
    remedies = {remedy.kind: remedy for remedy in find_remedies(check)}
    assert {"shift", "base"} <= set(remedies)
    shift, base = remedies["shift"], remedies["base"]
    np.testing.assert_allclose(shift.check.path.pose(1.0).translation - far.pose(1.0).translation, shift.shift)
    np.testing.assert_allclose(base.shift[0], -shift.shift)  # seen from the arm, both are the same
    moved = base.check.cell.arms[0].T_world_base.translation - arm.T_world_base.translation
    np.testing.assert_allclose(moved, base.shift[0])
    assert all(dense_check(remedy.check) for remedy in remedies.values())
    opaque = check_path(cell, grasp, Opaque(far))
    sampled = {remedy.kind: remedy for remedy in find_remedies(opaque)}["shift"]
    assert sampled.check.verdict is SAMPLED
    np.testing.assert_array_equal(sampled.shift, shift.shift)


def test_the_record_has_its_keys_and_is_plain() -> None:
    task = at_singularity()
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    record = json.loads(json.dumps(replace(check, remedies=find_remedies(check)).record(), allow_nan=False))
    assert list(record) == ["verdict", "intervals", "arms", "clearance", "remedies", "no_remedy", "q_start"]
    assert record["verdict"] == "UNDECIDED"
    assert record["intervals"][0]["arm"] == "arm_1"
    assert [arm["verdict"] for arm in record["arms"]] == ["UNDECIDED", "CERTIFIED", "CERTIFIED"]
    assert record["remedies"][0]["kind"] == "branch"
    np.testing.assert_allclose(record["q_start"], task.q_start, rtol=0, atol=1e-12)
