"""Goals of a way: poses of the object, poses with free turns, and joint positions of one arm."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_scalar, as_vector
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.planning.route.tree import Pose, distance
from coopqp.spatial import Array, Placement, as_placement, as_placements

_AXES = {"rx": 0, "ry": 1, "rz": 2}
#: Angles of a free turn that are tried: not further apart than this [rad], and so many of all turns together at most.
_APART, _MOST = np.deg2rad(30.0), 64
#: Poses that differ by less are the same [m].
_SAME = 1e-9


@final
@dataclass(frozen=True, eq=False)
class FreeTurn:
    """A turn of the object about an axis of its own frame that a goal leaves free.

    Attributes:
        axis: ``"rx"``, ``"ry"`` or ``"rz"``.
        low, high: range of its angle from the goal's pose [rad].

    Raises:
        InvalidInputError, UnknownNameError: no such axis, or no range.
    """

    axis: Literal["rx", "ry", "rz"]
    low: float = -np.pi
    high: float = np.pi

    def __post_init__(self) -> None:
        if self.axis not in _AXES:
            raise UnknownNameError("axis", str(self.axis), _AXES, "FreeTurn")
        for name in ("low", "high"):
            angle = as_scalar(getattr(self, name), f"FreeTurn: {name}", low=-2.0 * np.pi, high=2.0 * np.pi)
            object.__setattr__(self, name, angle)
        if not self.low <= self.high:
            raise InvalidInputError("low is above high", "FreeTurn", "Give the lower angle first [rad].")

    def angles(self) -> Array:
        """Angles that are tried [rad], the ends of the range and the pose itself among them."""
        every = np.linspace(self.low, self.high, max(int(np.ceil((self.high - self.low) / _APART)) + 1, 2))
        return np.unique(np.append(every, 0.0) if self.low <= 0.0 <= self.high else every)


@final
@dataclass(frozen=True, eq=False)
class TurnedGoal:
    """A pose of the object with free turns; angles of their ranges are tried at most 30° apart.

    Attributes:
        T_world_object: the pose.
        free: its free turns, applied one after the other.
    """

    T_world_object: Placement
    free: Sequence[FreeTurn]

    def poses(self) -> list[pin.SE3]:
        """The poses that are tried."""
        T = as_placement(self.T_world_object, "TurnedGoal")
        grids = [turn.angles() for turn in self.free]
        count = int(np.prod([len(grid) for grid in grids]))
        every = list(itertools.product(*grids))
        if count > _MOST:  # every so many of them
            every = [every[i] for i in np.unique(np.linspace(0, count - 1, _MOST).astype(int))]
        out = []
        for angles in every:
            turned = T.rotation
            for turn, angle in zip(self.free, angles, strict=True):
                turned = turned @ np.asarray(pin.exp3(angle * np.eye(3)[_AXES[turn.axis]]))
            out.append(pin.SE3(turned, T.translation))
        return out


@final
@dataclass(frozen=True, eq=False)
class ArmGoal:
    """Joint positions of one arm, which give the object's pose.

    Attributes:
        arm: name of the arm.
        positions: of all its joints [rad or m].
    """

    arm: str
    positions: ArrayLike


class GoalPose(NamedTuple):
    """A pose that is tried, and an arm by its number with the positions that it has there, if it is given."""

    T: pin.SE3
    arm: int = -1
    positions: Array | None = None


def goal_poses(
    goal: Any, cell: RobotCell, grasp: Grasp, arms: Sequence[ArmKinematics], start: pin.SE3
) -> tuple[list[GoalPose], bool]:
    """The poses of a goal, those nearest to the start first, and whether there are no others.

    Raises:
        InvalidInputError, UnknownNameError: the goal is none.
    """
    where = "find_path: goal"
    if isinstance(goal, ArmGoal):
        k = cell.index(goal.arm)
        own = cell.v_slices[k]
        q = as_vector(goal.positions, own.stop - own.start, where)[arms[k].columns]
        tool = pin.SE3(arms[k].tool_poses(q[None])[0])
        return [GoalPose(tool * grasp.T_object_tool[k].inverse(), k, q)], True
    if isinstance(goal, TurnedGoal):
        poses, every = goal.poses(), False
    elif isinstance(goal, pin.SE3) or np.ndim(goal) == 2:
        poses, every = [as_placement(goal, where)], True
    else:
        poses, every = list(as_placements(goal, where)), True
    if not poses:
        raise InvalidInputError("no pose", where, "Give at least one.")
    if any(distance(Pose.of(start), Pose.of(T)) < _SAME for T in poses):
        raise InvalidInputError("the goal is the start", where, "Give another pose.")
    poses.sort(key=lambda T: distance(Pose.of(start), Pose.of(T)))
    return [GoalPose(T) for T in poses], every
