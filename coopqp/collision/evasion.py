"""What redundant arms do with their freedom where bodies come close: they keep off, the object keeps to its path."""

from __future__ import annotations

from typing import final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

#: A motion that no row can be kept with breaks it by as much as costs what this much self-motion costs [1/m].
_YIELDS = 1e3
#: A self-motion that changes no distance by more than this does not help [m per unit of joint speed].
_HELPS = 1e-6


@final
class Evasion:
    """Least self-motion z with ``G (q′ + N z) ≥ lower``; where there is none, rows give way.

    N is an orthonormal basis of each arm's self-motion in units of its joints' speeds.

    Args:
        cell: whose redundant arms move.
    """

    def __init__(self, cell: RobotCell) -> None:
        from scipy.optimize import nnls  # not at the first step that needs it: it takes long to import

        self._nnls = nnls
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
        # Least distance by non-negative least squares [Lawson & Hanson, 1974]; each row has an unknown to give way by.
        A, b = A[helps], missing[helps]
        rows = np.hstack([A, np.eye(len(b)) / _YIELDS])
        system = np.vstack([rows.T, b])
        target = np.zeros(len(system))
        target[-1] = 1.0
        u = self._nnls(system, target)[0]
        rest = system @ u - target
        z = -rest[:-1] / rest[-1] if rest[-1] < 0.0 else np.zeros(len(rest) - 1)
        out: Array = slope + N @ z[: A.shape[1]]
        return out
