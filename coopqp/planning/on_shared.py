"""One arm of a group that shares joints: an arm by itself whose base these joints move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import Arm, RobotCell
from coopqp.model.joint_limits import LIMIT_FIELDS, JointLimits
from coopqp.paths.segments import Indices
from coopqp.spatial import Array

#: Tolerance of Newton's method [m, rad].
_EXACT = 1e-13


@final
class OnShared:
    """One arm of a group on its shared joints, as an arm by itself whose base they move.

    Args:
        arm: the arm, with what it shares.
        columns: of its joints in the cell, see :attr:`RobotCell.columns`.
        joints: velocity coordinates of the group's shared joints (S,).

    Attributes:
        whole: kinematics of the arm with the shared joints.
        alone: kinematics without them: with them where they are at zero.
    """

    def __init__(self, arm: Arm, columns: Indices, joints: Indices) -> None:
        self.whole = ArmKinematics(arm)
        self._which = np.searchsorted(joints, columns[self.whole.columns[self.whole.shared]])
        self.own = np.setdiff1d(np.arange(self.whole.n), self.whole.shared)
        model = arm.model
        self._arm, self._data = arm, model.createData()
        self._ids = [int(model.getJointId(self.whole.joints[j])) for j in self.whole.shared]
        stay = [model.joints[i].idx_v for i in range(1, model.njoints) if i not in self._ids]
        alone = replace(
            arm,
            model=pin.buildReducedModel(model, self._ids, pin.neutral(model)),
            limits=JointLimits(*(getattr(arm.limits, field)[stay] for field in LIMIT_FIELDS)),
            visual=None,
            collision=None,
            shared=(),
        )
        self.alone = ArmKinematics(alone)
        self._zero = self._carrier(np.zeros(len(self._ids)))

    def _carrier(self, s: Array) -> pin.SE3:
        """T_world_carrier: the last shared joint at positions of those that this arm shares."""
        model, q = self._arm.model, pin.neutral(self._arm.model)
        for i, x in zip(self._ids, s.tolist(), strict=True):
            joint = model.joints[i]
            q[joint.idx_q : joint.idx_q + joint.nq] = [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
        pin.forwardKinematics(model, self._data, q)
        return self._arm.T_world_base * self._data.oMi[self._ids[-1]]

    def shared(self, s: Array) -> Array:
        """Positions of the joints that this arm shares, of those of its group (M, S)."""
        return s[:, self._which]

    def seen(self, s: Array, poses: Array) -> Array:
        """Poses of the world (M, 4, 4) as the arm alone sees them, with the group's shared joints at ``s`` (M, S)."""
        rows = s[:, self._which]
        changes = np.r_[True, (np.diff(rows, axis=0) != 0.0).any(axis=1)]
        moved = np.empty_like(poses)
        T = np.eye(4)
        for i, row in enumerate(rows):
            if changes[i]:
                T = (self._zero * self._carrier(row).inverse()).homogeneous
            moved[i] = T @ poses[i]
        return moved

    def newton(self, rows: Array, guess: Array) -> tuple[Array, Array]:
        """Positions (M, n) of all joints that reach poses of the tool, with the shared joints as they are guessed.

        Args:
            rows: T_world_tool as rows of R (9), p (3), (M, 12).
            guess: positions of all joints (M, n).

        Returns:
            The positions, and residuals (M,) as :meth:`ArmKinematics.newton` has them.
        """
        poses = np.zeros((len(rows), 4, 4))
        poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:], 1.0
        s = np.zeros((len(rows), int(self._which.max()) + 1))
        s[:, self._which] = guess[:, self.whole.shared]
        q, residual = self.alone.newton(self.seen(s, poses), guess[:, self.own], tolerance=_EXACT, steps=12)
        return self.joined(s, q), residual

    def joined(self, s: Array, q: Array) -> Array:
        """Positions (M, n) of all joints, from those of the group's shared joints (M, S) and of the own ones."""
        out = np.empty((len(q), self.whole.n))
        out[:, self.whole.shared], out[:, self.own] = s[:, self._which], q
        return out


def group_joints(cell: RobotCell, group: Sequence[int]) -> Indices:
    """Velocity coordinates of the joints that arms of a group share (S,)."""
    every = np.unique(np.concatenate([cell.columns[k] for k in group]))
    return np.intersect1d(every, cell.shared)
