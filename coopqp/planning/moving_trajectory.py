"""Joint trajectories of all arms where tools move on the object: each along its own tool's path, on one clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.paths.joint_trajectories import ArmTrajectory, CellTrajectory
from coopqp.paths.path import ObjectPath
from coopqp.paths.segments import Segments
from coopqp.spatial import Array, as_placement


@final
class MovingTrajectory(CellTrajectory):
    """As :class:`CellTrajectory`; its places are clocks [s].

    Args:
        cell, path: the arms, and the object's path.
        arms: the trajectory of each arm along its tool's path.
        tools: the segments of each tool's path, which tell places at clocks; None where it is known at samples alone.
        rest: positions (nv,) of joints that move no tool.
    """

    def __init__(
        self,
        cell: RobotCell,
        path: ObjectPath,
        arms: Sequence[ArmTrajectory],
        tools: Sequence[Segments | None],
        rest: Array,
    ) -> None:
        super().__init__(cell, path, arms, rest)
        self._tools = tuple(tools)
        every = [
            arm.places if tool is None or len(arm.places) == 1 else tool.clocks(*tool.split(arm.places))
            for tool, arm in zip(self._tools, self._arms, strict=True)
        ]
        end = min(float(clocks[-1]) for clocks in every)
        clocks = np.unique(np.concatenate([np.minimum(clocks, path.duration) for clocks in every]))
        clocks = clocks[np.append(True, np.diff(clocks) > 1e-9)]
        self.places = clocks[clocks <= end]
        self.complete = end >= path.duration - 1e-6

    def clocks(self, places: Array) -> Array:
        """See :meth:`CellTrajectory.clocks`: the places themselves."""
        return places

    def poses(self, places: Array) -> Array:
        """See :meth:`CellTrajectory.poses`."""
        return np.array([as_placement(self._path.pose(u), "path").homogeneous for u in places.tolist()])

    def seen_by(self, k: int, places: Array, T_world_object: Array) -> tuple[Array, Array]:
        """See :meth:`CellTrajectory.seen_by`."""
        tool = self._tools[k]
        at = self._own(self._arms[k], tool, places)
        if tool is not None:
            return at, tool.poses(*tool.split(at))
        motion = self._path.grasps
        assert motion is not None
        return at, T_world_object @ np.array([motion.moved(k, u).homogeneous for u in places.tolist()])

    def reached(self, x: Array, T_world_object: Array) -> Array | None:
        """None: what an arm reaches is its tool's path, not the object."""
        return None

    def motion(self, low: Array, high: Array) -> Array:
        """See :meth:`CellTrajectory.motion`."""
        out = np.zeros((len(low), self.cell.nv))
        for columns, arm, tool in zip(self._columns, self._arms, self._tools, strict=True):
            out[:, columns] = arm.motion(self._own(arm, tool, low), self._own(arm, tool, high))
        return out

    def _own(self, arm: ArmTrajectory, tool: Segments | None, clocks: Array) -> Array:
        """Places of an arm at clocks (M,); at those of its own places exactly these."""
        places = clocks if tool is None or tool.where is None else tool.where(clocks)
        near = arm.places[np.clip(np.searchsorted(arm.places, places), 0, len(arm.places) - 1)]
        before = arm.places[np.clip(np.searchsorted(arm.places, places) - 1, 0, len(arm.places) - 1)]
        nearest = np.where(np.abs(near - places) < np.abs(before - places), near, before)
        return np.where(np.abs(nearest - places) < 1e-7, nearest, places)
