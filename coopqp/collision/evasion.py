"""Self-motion of redundant arms near bodies: the arms keep clear, the object stays on its path."""

from __future__ import annotations

from typing import final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

#: A row that is broken by 1/YIELDS costs as much as a self-motion of 1. With 1000 arms swung past posts at many times
#: their speeds, along slopes that the look-ahead cannot follow.
YIELDS = 50.0
#: Accepted violation of a row; DAQP's default is 1e-6.
_TOLERANCE = 1e-10
#: A self-motion that changes no distance by more than this does not help [m per unit of joint speed].
_HELPS = 1e-6


@final
class Evasion:
    """Least self-motion z with ``G (q′ + N z) ≥ lower``. If no z keeps all rows, each may be broken at a cost.

    N is an orthonormal basis of each arm's self-motion in units of its joints' speeds.

    Args:
        cell: the arms, of which the redundant ones move.
    """

    def __init__(self, cell: RobotCell) -> None:
        import daqp

        self._solve = daqp.solve
        self._cell, self._data = cell, cell.model.createData()
        speed = cell.limits.velocity
        self._scale = np.where(np.isfinite(speed), speed, 1.0)
        self._arms = [k for k, own in enumerate(cell.v_slices) if own.stop - own.start > 6]

    def __bool__(self) -> bool:
        return bool(self._arms)

    def basis(self, q: Array) -> Array:
        """N (nv, z) at a configuration (nq,)."""
        model, cell = self._cell.model, self._cell
        pin.computeJointJacobians(model, self._data, q)
        columns: list[Array] = []
        for k in self._arms:
            own = cell.v_slices[k]
            J = np.asarray(pin.getFrameJacobian(model, self._data, cell.tool_frames[k], pin.LOCAL))[:, own]
            scale = self._scale[own]
            rest: npt.NDArray[np.float64] = np.linalg.svd(J * scale)[2][6:]
            for row in rest:
                column = np.zeros(cell.nv)
                column[own] = row * scale
                columns.append(column)
        return np.array(columns).T

    def slope(self, q: Array, slope: Array, G: Array, lower: Array) -> Array:
        """q′ (nv,) with the least self-motion at ``q`` (nq,)."""
        missing = lower - G @ slope
        if not (missing > 0.0).any():
            return slope
        N = self.basis(q)
        A = G @ N
        helps = np.abs(A).max(axis=1) > _HELPS
        if not helps.any():
            return slope
        # A least-distance problem; each row has an unknown to give way by, so it has a solution.
        A, b = A[helps], missing[helps]
        m, n = len(b), len(b) + A.shape[1]
        rows = np.hstack([A, np.eye(m) / YIELDS])
        free, inequality = np.full(m, np.inf), np.zeros(m, dtype=np.intc)
        z, _, flag, _ = self._solve(np.eye(n), np.zeros(n), rows, free, b, inequality, primal_tol=_TOLERANCE)
        if flag != 1:
            return slope
        out: Array = slope + N @ z[: A.shape[1]]
        return out
