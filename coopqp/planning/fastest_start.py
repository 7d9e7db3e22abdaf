"""The start with the shortest motion among the branches found.

With the object's path given each arm follows its own tool, and the arms meet only in the common time: the cell is as
slow as its slowest arm, to 2 % in the cells that were tried. So the branches of each arm are timed by themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coopqp.errors import UndecidedError, UnreachableError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.paths.geometry import PathGeometry
from coopqp.planning.arm_starts import BranchAlongPath
from coopqp.planning.starts import ArmStart, Start, exact_start
from coopqp.planning.timing import time_path
from coopqp.spatial import Array

#: Knots of a timing for comparison, and the share within which times count as equal.
_KNOTS, _EQUAL = 60, 1e-3


def faster_start(cell: RobotCell, geometry: PathGeometry, start: Start, count: int) -> Start:
    """The start at which the slowest arm is at the branch that makes it fastest, of ``count`` branches of each arm.

    They are spread from the best branch to the last. The other arms are at the best branch at which they are no slower
    than that arm. Payload, further bounds and jerk play no part.
    """
    rows, times = [], []
    for k, arm in enumerate(start.arms):
        own = [arm.chosen, *(b for b in arm.branches if b.feasible and b is not arm.chosen)]
        own = [b for b in own if b.roll == arm.chosen.roll]
        own = [own[i] for i in np.unique(np.linspace(0, len(own) - 1, count).astype(int))]
        rows.append(own)
        times.append(np.array([_time(cell, k, start, row, geometry) for row in own]))
    slowest = max(float(own.min()) for own in times)
    if not np.isfinite(slowest):
        return start
    chosen = [
        own[int((t <= max(slowest, float(t.min())) * (1.0 + _EQUAL)).argmax())]
        for own, t in zip(rows, times, strict=True)
    ]
    return _from_branches(cell, start, chosen, geometry)


def _time(cell: RobotCell, k: int, start: Start, row: BranchAlongPath, geometry: PathGeometry) -> float:
    """Shortest time of arm k by itself on a branch [s]; infinite where it cannot be timed."""
    own, limits = cell.v_slices[k], cell.limits
    alone = RobotCell([cell.arms[k]]).with_limits(
        lower=limits.lower[own], upper=limits.upper[own],
        velocity=limits.velocity[own], acceleration=limits.acceleration[own],
    )  # fmt: skip
    x = _placed(cell, start.q, [(k, row)])[own]
    grasp = Grasp((start.grasp.T_object_tool[k],))
    try:
        return time_path(alone, grasp, geometry, q_start=alone.configuration(x), knots=_KNOTS).duration
    except (UnreachableError, UndecidedError):
        return np.inf


def _placed(cell: RobotCell, q: Array, rows: list[tuple[int, BranchAlongPath]]) -> Array:
    """Joint positions (nv,) at q (nq,), with arms at branches."""
    x = cell.positions(q)
    for k, row in rows:
        x[cell.v_slices[k].start + ArmKinematics(cell.arms[k]).columns] = row.q
    return x


def _from_branches(cell: RobotCell, start: Start, rows: list[BranchAlongPath], geometry: PathGeometry) -> Start:
    arms: list[ArmStart] = [replace(arm, chosen=row) for arm, row in zip(start.arms, rows, strict=True)]
    margins = start.margins.copy()
    for k, row in enumerate(rows):
        margins[cell.v_slices[k].start + ArmKinematics(cell.arms[k]).columns] = row.margins
    q = exact_start(Chain(cell, start.grasp), geometry.pose(0.0), _placed(cell, start.q, list(enumerate(rows))))
    return replace(
        start, q=q, arms=tuple(arms), margins=margins, sigma_min=np.column_stack([row.sigma_min for row in rows])
    )
