"""The check of a path before the motion, against dense samples of Pinocchio's kinematics that share no code with it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import (
    Arm,
    Grasp,
    ObjectPath,
    RobotCell,
    WaypointPath,
    robot_path,
)
from coopqp.planning import PathVerdict, check_path
from coopqp.scenarios import robot_arm

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict
LOOSE = np.deg2rad(0.3)


def arm_of(name: str) -> Arm:
    if name in ("rx90l", "arm6c", "gantry7", "arm7"):
        tool = "flange" if name == "rx90l" else "tool"
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

    def configuration(self, x: Any) -> Any:
        """Continuous joints are (cos, sin) in Pinocchio."""
        if not self.continuous.any():
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
            if np.abs(error).max() < 1e-10:
                return J, x
            x = x + (np.linalg.solve(J, error) if len(x) == 6 else np.linalg.lstsq(J, error, rcond=None)[0])
        return J, x if np.abs(error).max() < 1e-9 else None

    def follow(self, path: ObjectPath, X: pin.SE3, q: Any, samples: int = 1001) -> tuple[Any, Any]:
        """Joint positions and σ_min at samples of a path, from ``q``, up to the last that is reached without a jump."""
        x, rows, jacobians = q, [], []
        for clock in np.linspace(0.0, path.duration, samples):
            if len(rows) >= 3:
                x = 3.0 * rows[-1] - 3.0 * rows[-2] + rows[-3]
            J, x = self.reach(path.pose(clock) * X, x)
            if x is None or (rows and np.abs(x - rows[-1]).max() > 0.5):
                break
            rows.append(x)
            jacobians.append(J)
        return np.array(rows), np.linalg.svd(np.array(jacobians), compute_uv=False)[:, -1]


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
        for branch in check_path(cell, grasp, path).arms[0].branches:
            start = branch.q[0]
            if np.minimum(start - limits.lower, limits.upper - start).min() < -1e-9:
                assert branch.verdict is INFEASIBLE
                continue
            number = samples if branch.verdict is CERTIFIED else samples // 4
            q, sigma = oracle.follow(path, grasp.T_object_tool[0], start, number)
            margins = np.minimum(q - limits.lower, limits.upper - q).min(axis=0)
            follows = len(q) == number and margins.min() >= 0.0
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


def test_certified_branches_hold_at_dense_samples(rng: Any) -> None:
    count = judged(("rx90l", "ur5"), 16, rng, samples=301)
    assert count["loosest"] <= LOOSE
    assert count["undecided"] == 0


@pytest.mark.slow
def test_five_hundred_certified_branches_hold_at_a_thousand_samples(rng: Any) -> None:
    count = judged(("rx90l", "ur5", "ur10", "arm6c"), 500, rng)
    assert count["loosest"] <= LOOSE
    assert count["undecided"] <= 0.01 * count["feasible"]
