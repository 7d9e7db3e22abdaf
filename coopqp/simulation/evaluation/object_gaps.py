"""Distances between the object poses of any two arms, and from each to the path."""

from __future__ import annotations

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.simulation.evaluation import metrics
from coopqp.spatial import Array

#: Number of pairs of placements that are compared at once; bounds the memory.
_LARGEST_TABLE = 200_000


def object_gaps(cell: RobotCell, grasp: Grasp, q: Array, reference: Array, shift: Array | None) -> tuple[Array, Array]:
    """Distances [m] and angles [rad] (T, P + N): first of the P pairs of two arms, then of each arm and the path.

    Args:
        cell, grasp: the arms, and how they hold.
        q: configurations (T, nq).
        reference: poses of the path (T, 4, 4).
        shift: motion of the grasps (T, N, 6) [m, rad]; None where they stay.
    """
    poses = metrics.object_poses(metrics.without_shift(metrics.tool_matrices(cell, q), grasp, shift), grasp)
    rows = max(1, _LARGEST_TABLE // (len(cell) * (len(cell) + 1) // 2))
    found = []
    for part in (slice(start, start + rows) for start in range(0, len(q), rows)):
        pairs = zip(metrics.gaps(poses[part]), metrics.errors_from(poses[part], reference[part]), strict=True)
        found.append([np.hstack(both) for both in pairs])
    distance, angle = (np.vstack(parts) for parts in zip(*found, strict=True))
    return distance, angle
