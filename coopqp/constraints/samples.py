"""Poses along a path, as close to each other as the motion of the tools needs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.model.grasp import Grasp
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array, as_placement

#: Largest motion of a tool between samples [m, rad].
_DISTANCE, _ANGLE = 0.02, 0.05
#: Least pieces of a segment, and how often a piece is halved.
_PIECES, _HALVINGS = 8, 7


@dataclass(frozen=True, eq=False)
class PathSamples:
    """A path at K clocks.

    Attributes:
        clocks: the clocks (K,) [s]; breakpoints and both ends are among them.
        poses: T_world_object at each.
    """

    clocks: Array
    poses: tuple[pin.SE3, ...]

    def tool_poses(self, T_object_tool: pin.SE3) -> Array:
        """T_world_tool of one arm at each clock (K, 4, 4)."""
        return np.array([T.homogeneous for T in self.poses]) @ T_object_tool.homogeneous


def sample_path(path: ObjectPath, grasp: Grasp) -> PathSamples:
    """Sample a path; where it has no end or is not known ahead, only its start."""
    if not (np.isfinite(path.duration) and path.known_ahead and path.duration > 0.0):
        return PathSamples(np.zeros(1), (as_placement(path.pose(0.0), "the path's pose at 0 s"),))
    marks = [0.0]
    while marks[-1] < path.duration and len(marks) < 10_000:
        marks.append(min(max(path.next_breakpoint(marks[-1]), marks[-1] + 1e-9), path.duration))
    clocks: list[float] = []
    poses: list[pin.SE3] = []

    def pose(clock: float) -> pin.SE3:
        return as_placement(path.pose(clock), f"the path's pose at {clock:g} s")

    def fill(a: float, T: pin.SE3, b: float, U: pin.SE3, halvings: int) -> None:
        """Samples in (a, b]."""
        if halvings > 0 and _is_far(T, U, grasp):
            m = 0.5 * (a + b)
            V = pose(m)
            fill(a, T, m, V, halvings - 1)
            fill(m, V, b, U, halvings - 1)
            return
        clocks.append(b)
        poses.append(U)

    clocks.append(0.0)
    poses.append(pose(0.0))
    for start, end in itertools.pairwise(marks):
        for a, b in itertools.pairwise(np.linspace(start, end, _PIECES + 1).tolist()):
            fill(a, poses[-1], b, pose(b), _HALVINGS)
    return PathSamples(np.array(clocks), tuple(poses))


def _is_far(T: pin.SE3, U: pin.SE3, grasp: Grasp) -> bool:
    if np.linalg.norm(pin.log3(T.rotation.T @ U.rotation)) > _ANGLE:
        return True
    return any(np.linalg.norm(T.act(X.translation) - U.act(X.translation)) > _DISTANCE for X in grasp.T_object_tool)
