"""Arms that share joints on a path: the best way of these joints, and the branches of each arm along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import pinocchio as pin

from coopqp.constraints.samples import PathSamples
from coopqp.model.cell import RobotCell
from coopqp.paths.segments import Segments
from coopqp.planning.arm_starts import ArmOnPath, arm_on_shared
from coopqp.planning.on_shared import OnShared
from coopqp.planning.shared_way import FEW, MOST_SAMPLES, SharedWay, places_of, ways_at
from coopqp.spatial import Array


@final
@dataclass(frozen=True, eq=False)
class GroupOnPath:
    """The arms of a group on a path, with the joints that they share on one way.

    Attributes:
        way: of the shared joints.
        s: their positions at the samples of the path (K, S) [rad or m].
        arms: the branches of each arm on this way, the one first for which the way was chosen.
    """

    way: SharedWay
    s: Array
    arms: tuple[ArmOnPath, ...]

    @property
    def feasible(self) -> bool:
        """All arms follow the whole path on this way."""
        return all(arm.branches and arm.branches[0].feasible for arm in self.arms)


def group_on_path(
    cell: RobotCell,
    arms: Sequence[OnShared],
    group: tuple[int, ...],
    samples: PathSamples,
    segments: Segments | None,
    offsets: Sequence[pin.SE3],
    *,
    quick: bool = False,
) -> GroupOnPath | None:
    """The arms of a group on the best way of their shared joints.

    Args:
        cell: the cell, whose limits count.
        arms: the arms of the group, at bases from which the samples are seen.
        group: their indices.
        samples: the path.
        segments: its segments; None if it has none.
        offsets: T_object_tool of each arm of the group.
        quick: a first look, at few samples of the path alone: ways may be missing.

    Returns:
        Where no way is good for the whole path, the one on which the arms get furthest; None where there is none at
        all.
    """
    poses = [samples.tool_poses(X) for X in offsets]
    at_samples = places_of(samples, segments)
    found: GroupOnPath | None = None
    for way, starts in ways_at(cell, arms, group, samples, segments, poses, (FEW,) if quick else (MOST_SAMPLES, FEW)):
        s = way.at(at_samples)
        made = [arm_on_shared(arm, samples, T, s, own) for arm, T, own in zip(arms, poses, starts, strict=True)]
        this = GroupOnPath(way, s, tuple(made))
        if this.feasible:
            return this
        found = found or this
    return found
