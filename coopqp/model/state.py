"""Kinematics of a cell at one configuration, computed once when a CellState is built."""

from __future__ import annotations

import threading
import weakref
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import read_only
from coopqp.model.cell import RobotCell, standing
from coopqp.spatial import Array

_WORKSPACES = threading.local()


def workspace(cell: RobotCell) -> pin.Data:
    """Pinocchio's memory for a cell, one in each thread; to make it takes longer than to use it."""
    if not hasattr(_WORKSPACES, "of_cell"):
        _WORKSPACES.of_cell = weakref.WeakKeyDictionary()
    made: weakref.WeakKeyDictionary[RobotCell, pin.Data] = _WORKSPACES.of_cell
    if cell not in made:
        made[cell] = cell.model.createData()
    return made[cell]


class CellState:
    """Kinematics of a cell at one configuration, read-only.

    Args:
        cell: the cell.
        q: configuration, shape (nq,) [rad or m]; copied.

    Attributes:
        T_world_tool: placement of each tool in the world, a tuple of :class:`pinocchio.SE3`.

    Raises:
        InvalidInputError: wrong shape or entries that are not finite.
    """

    def __init__(self, cell: RobotCell, q: Any) -> None:
        self.cell = cell
        self.q = read_only(cell.check_configuration(q, "CellState"))
        data = workspace(cell)
        J = pin.computeJointJacobians(cell.model, data, self.q)  # twists at the world's origin, flat for one joint
        self._J = np.array(J).reshape(6, -1)
        self.T_world_tool = tuple(data.oMi[j] * X for j, X in zip(cell.tool_joints, cell.T_joint_tool, strict=True))

    def _own(self, k: int) -> Any:
        return self.cell.columns[k] if self.cell.groups else self.cell.v_slices[k]  # a slice makes no copy

    def jacobian(self, arm: str | int, frame: pin.ReferenceFrame = pin.LOCAL) -> Array:
        """Jacobian J of an arm's tool, shape (6, n): tool twist = J · joint velocities of the arm.

        Joints that do not move the tool have zeros.

        ``frame`` selects the frame of the twist: LOCAL (the tool frame), LOCAL_WORLD_ALIGNED, or WORLD.
        """
        k = self.cell.index(arm)
        J, T = self._J[:, self._own(k)], self.T_world_tool[k]
        if (still := standing(self.cell)[k]).size:
            J = J.copy()
            J[:, still] = 0.0
        if frame == pin.WORLD:
            return J.copy()
        seen = T if frame == pin.LOCAL else pin.SE3(np.eye(3), T.translation)
        return np.asarray(seen.actionInverse @ J)

    @cached_property
    def singular_values(self) -> tuple[Array, ...]:
        """Singular values of each arm's tool Jacobian (LOCAL; metres and radians), descending."""
        return tuple(
            np.asarray(np.linalg.svd(self.jacobian(k), compute_uv=False), dtype=float) for k in range(len(self.cell))
        )

    @cached_property
    def sigma_min(self) -> Array:
        """Smallest singular value of each arm's tool Jacobian, shape (N,).

        An arm with n < 6 joints has n singular values: the value refers to the motions that the arm can do.
        """
        return np.array([s[-1] for s in self.singular_values])

    @cached_property
    def limit_margins(self) -> Array:
        """Distance of each joint to its nearer position limit (nv,) [rad or m]; negative outside, inf without limit."""
        x, limits = self.cell.positions(self.q), self.cell.limits
        return np.minimum(x - limits.lower, limits.upper - x)
