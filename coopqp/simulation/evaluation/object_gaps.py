"""Distances between the object poses of any two arms, and from each to the path: by Pinocchio's frames only."""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

#: Number of pairs of placements that are compared at once; bounds the memory.
_LARGEST_TABLE = 200_000


@final
class ObjectGaps:
    """Distances and angles between object poses.

    Args:
        cell, grasp: the arms, and how they hold.

    Attributes:
        first, second: indices of the arms of each pair; N stands for the path. The pairs with the path come last.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp) -> None:
        self.cell, self._data = cell, cell.model.createData()
        self._inverse_grasp = np.array([X.inverse().homogeneous for X in grasp.T_object_tool])
        n = len(cell)
        first, second = np.triu_indices(n, 1)
        self.first, self.second = np.append(first, np.arange(n)), np.append(second, np.full(n, n))

    def of(self, q: Array, reference: Array, shift: Array | None) -> tuple[Array, Array]:
        """Distances [m] and angles [rad] (T, pairs) at configurations (T, nq).

        Args:
            q: configurations (T, nq).
            reference: poses of the path (T, 4, 4).
            shift: motion of the grasps (T, N, 6) [m, rad]; None where they stay.
        """
        pairs = len(self.first)
        steps, n = len(q), len(self.cell)
        distance, angle = np.empty((steps, pairs)), np.empty((steps, pairs))
        T = np.empty((steps, n + 1, 4, 4))
        T[:, :n] = self._carried(q)
        if shift is not None:
            T[:, :n] = T[:, :n] @ np.array([[pin.exp6(-d).homogeneous for d in row] for row in shift])
        T[:, n] = reference
        rows = max(1, _LARGEST_TABLE // pairs)
        for start in range(0, steps, rows):
            part = T[start : start + rows]
            D = part[:, self.first] - part[:, self.second]
            np.sqrt(np.einsum("tpi,tpi->tp", D[..., :3, 3], D[..., :3, 3]), out=distance[start : start + rows])
            # ‖A − B‖ = 2√2 sin(θ/2) is accurate near 0
            half = np.sqrt(np.einsum("tpij,tpij->tp", D[..., :3, :3], D[..., :3, :3]) / 8.0)
            angle[start : start + rows] = 2.0 * np.arcsin(np.minimum(half, 1.0))
        return distance, angle

    def _carried(self, q: Array) -> Array:
        """Object pose according to each arm, placements (T, N, 4, 4)."""
        cell, data = self.cell, self._data
        frames = cell.tool_frames
        T = np.empty((len(q), len(frames), 4, 4))
        for i, configuration in enumerate(q):
            pin.framesForwardKinematics(cell.model, data, configuration)
            for k, f in enumerate(frames):
                T[i, k] = data.oMf[f].homogeneous
        carried: Array = T @ self._inverse_grasp
        return carried
