"""Poses along a path, as close to each other as the motion of the tools needs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.model.grasp import Grasp
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array, as_placement

#: Largest motion of a tool between samples [m, rad].
_DISTANCE, _ANGLE = 0.02, 0.05
#: Least pieces of a segment, and how often a piece is halved.
_PIECES, _HALVINGS = 8, 7
#: Breakpoints that are all among the samples; of further ones those that are this share of the duration apart.
_MARKS = 10_000


@dataclass(frozen=True, eq=False)
class PathSamples:
    """A path at K clocks.

    Attributes:
        clocks: the clocks (K,) [s]; the first 10 000 breakpoints and both ends are among them.
        poses: T_world_object at each.
        motion: how the tools move on the object; None where they rest on it.
    """

    clocks: Array
    poses: tuple[pin.SE3, ...]
    motion: GraspMotion | None = None

    def of_arm(self, k: int) -> PathSamples:
        """The path as arm k sees it, whose tool rests on what it carries: ``T_world_object M_k``."""
        if self.motion is None:
            return self
        placed = zip(self.poses, self.clocks.tolist(), strict=True)
        return PathSamples(self.clocks, tuple(T * self.motion.moved(k, clock) for T, clock in placed))

    def tool_poses(self, T_object_tool: pin.SE3) -> Array:
        """T_world_tool of one arm at each clock (K, 4, 4)."""
        return np.array([T.homogeneous for T in self.poses]) @ T_object_tool.homogeneous


def sample_path(path: ObjectPath, grasp: Grasp) -> PathSamples:
    """Sample a path; where it has no end or is not known ahead, only its start."""
    if not (np.isfinite(path.duration) and path.known_ahead and path.duration > 0.0):
        return PathSamples(np.zeros(1), (as_placement(path.pose(0.0), "the path's pose at 0 s"),))
    motion = path.grasps if path.grasps is not None and path.grasps.moves else None
    marks = [0.0]
    while marks[-1] < path.duration:
        least = 1e-9 if len(marks) < _MARKS else path.duration / _MARKS
        marks.append(min(max(path.next_breakpoint(marks[-1]), marks[-1] + least), path.duration))
    if motion is not None:
        ends = {end for pieces in motion.arms for piece in pieces for end in (piece.start, piece.end)}
        marks = sorted({*marks, *(end for end in ends if 0.0 < end < path.duration)})
    clocks: list[float] = []
    poses: list[pin.SE3] = []

    def pose(clock: float) -> pin.SE3:
        return as_placement(path.pose(clock), f"the path's pose at {clock:g} s")

    def fill(a: float, T: pin.SE3, b: float, U: pin.SE3, halvings: int) -> None:
        """Samples in (a, b]."""
        if halvings > 0 and (_is_far(T, U, grasp) if motion is None else _tools_far(T, U, grasp, motion, a, b)):
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
    return PathSamples(np.array(clocks), tuple(poses), motion)


def _tools_far(T: pin.SE3, U: pin.SE3, grasp: Grasp, motion: GraspMotion, a: float, b: float) -> bool:
    """Whether a tool that moves on the object is far at ``b`` from where it is at ``a`` [s]."""
    before, after = grasp.moved_by(motion.placements(a)), grasp.moved_by(motion.placements(b))
    for X, Y in zip(before.T_object_tool, after.T_object_tool, strict=True):
        way = (T * X).actInv(U * Y)
        if np.linalg.norm(way.translation) > _DISTANCE or np.linalg.norm(pin.log3(way.rotation)) > _ANGLE:
            return True
    return False


def _is_far(T: pin.SE3, U: pin.SE3, grasp: Grasp) -> bool:
    if np.linalg.norm(pin.log3(T.rotation.T @ U.rotation)) > _ANGLE:
        return True
    return any(np.linalg.norm(T.act(X.translation) - U.act(X.translation)) > _DISTANCE for X in grasp.T_object_tool)
