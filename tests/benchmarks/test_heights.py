"""The search for heights that judges the planner: its kinematics beside Pinocchio's, and what it takes as connected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
from promise_cases.heights import Levels, TurningArm
from promise_cases.shared_cells import TORSOS, written


def test_an_arm_is_that_of_the_whole_robot_with_its_torso_at_zero(tmp_path: Path) -> None:
    model = pin.buildModelFromUrdf(str(written(TORSOS[0], tmp_path / "both.urdf")))
    arm, rng = TurningArm(model, "right_link_5", "torso_0"), np.random.default_rng(2)
    assert arm.stroke == (-0.3, 0.3)
    data, frame = model.createData(), model.getFrameId("right_link_5")
    rows = [model.joints[model.getJointId(f"right_{i}")].idx_v for i in range(6)]
    q = rng.uniform(arm.lower, arm.upper, (20, 6))
    T, J = arm.tools(q)
    for x, own, jacobian in zip(q, T, J, strict=True):
        whole = pin.neutral(model)
        whole[rows] = x
        expected = pin.computeFrameJacobian(model, data, whole, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.framesForwardKinematics(model, data, whole)
        np.testing.assert_allclose(own, data.oMf[frame].homogeneous, rtol=0, atol=1e-13)
        np.testing.assert_allclose(jacobian, expected[:, rows], rtol=0, atol=1e-13)
    near, good = arm.solved(T[0], q[:1] + 0.05, 25)
    assert good.all()
    np.testing.assert_allclose(arm.tools(near)[0][0], T[0], rtol=0, atol=1e-7)


def test_a_torso_at_rest_has_the_arm_go_upward_only() -> None:
    """Two islands of the first level; one ends at the second, whose other island leads on, and begins there."""
    links = [np.array([[0, 0]]), np.array([[1, 0]]), np.array([[0, 0]])]
    levels = Levels([2, 2, 1, 1], links)
    assert [levels.top(i) for i in range(4)] == [1, 3, 3, 3]
    assert levels.highest(0, 0) == 1
    assert levels.highest(0, 1) == 3
    down = Levels([1, 2, 1], [np.array([[0, 0], [0, 1]]), np.array([[1, 0]])])
    assert down.top(0) == down.highest(1, 1) == 2
    assert Levels([1], []).highest(0, 3) == 0
