"""What an arm does in a phase of a program, and the motion of its tool on the object that follows."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_scalar, as_vector, require
from coopqp.errors import InvalidInputError
from coopqp.paths.grasp_motion import GraspPiece
from coopqp.paths.joint_path import JointPath
from coopqp.paths.moving_grasps import pieces_of
from coopqp.paths.path import LinePath, ObjectPath, WaypointPath
from coopqp.paths.time_law import TimeLaw, as_time_law
from coopqp.spatial import Array, Placement, as_placement

#: A tool may begin its work this far from where it is on the object [m, rad].
_AT_WORK = 1e-6
#: Shares of a phase's time in which a travelling tool retreats, and approaches.
_RETREAT = 0.25


@dataclass(frozen=True, eq=False)
class Span:
    """The time of a phase, and where a tool is when it begins.

    Attributes:
        start, duration: of the phase [s].
        X: the grasp's placement T_object_tool.
        M: by how much the tool has moved from there when the phase begins.
        where: of messages.
    """

    start: float
    duration: float
    X: pin.SE3
    M: pin.SE3
    where: str

    def pieces(self, S: ObjectPath, frame: pin.SE3) -> tuple[GraspPiece, ...]:
        """The pieces of a motion along S in the axes of a frame on the object."""
        return pieces_of(S, start=self.start, before=self.M, frame=frame, where=self.where)


class Role(abc.ABC):
    """What an arm does in a phase."""

    #: Whether it holds the object during the phase.
    holds: bool = True
    #: Whether it holds the object after the phase; None: as during it.
    holds_after: bool | None = None
    #: The duration that the role needs [s]; None for the phase's.
    duration: float | None = None

    @abc.abstractmethod
    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """The motion of the tool on the object during the phase; none where it rests there."""


@final
@dataclass(frozen=True)
class Holds(Role):
    """The arm holds the object, at rest on it."""

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        return ()


@final
@dataclass(frozen=True)
class Waits(Role):
    """The arm goes along with the object without holding it: it bears nothing, and has no share in its pose."""

    holds = False

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        return ()


@final
@dataclass(frozen=True, eq=False)
class Travels(Role):
    """The arm lets go, retreats, goes over and approaches: it holds the object again at another place after the phase.

    It rests on the object at both ends and between its three legs, so it begins and ends with the object's motion.

    Args:
        to: the new T_object_tool.
        retreat_m: way back along the tool's own z axis at both places [m].
        holds_after: whether it holds the object after the phase.
    """

    to: Placement
    retreat_m: float = 0.05
    holds_after: bool | None = True
    holds = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", as_placement(self.to, "Travels: to"))
        object.__setattr__(self, "retreat_m", as_scalar(self.retreat_m, "Travels: retreat_m", open_low=False))

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        back = pin.SE3(np.eye(3), np.array([0.0, 0.0, -self.retreat_m]))
        here, there = span.M * span.X, as_placement(self.to, "Travels: to")
        if not self.retreat_m:
            S: ObjectPath = LinePath(here, there, duration=span.duration)
        else:
            times = [_RETREAT * span.duration, (1.0 - 2.0 * _RETREAT) * span.duration, _RETREAT * span.duration]
            S = WaypointPath([here, here * back, there * back, there], durations=times)
        return span.pieces(S, pin.SE3.Identity())


@final
@dataclass(frozen=True, eq=False)
class Works(Role):
    """The tool works on the object: it follows a path on it, and does not hold it.

    Args:
        on: the path of the tool in the object frame, T_object_tool over the phase's clock. It begins where the tool is
            on the object when the phase begins.
    """

    on: ObjectPath
    holds = False

    def __post_init__(self) -> None:
        require(self.on, ObjectPath, "Works: on", "Give a path of T_object_tool, such as a WaypointPath.")
        object.__setattr__(self, "duration", float(self.on.duration))

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        away = np.asarray(pin.log6((span.M * span.X).actInv(self.on.pose(0.0))).vector)
        if np.abs(away).max() > _AT_WORK:
            raise InvalidInputError(
                f"its work begins {1e3 * np.linalg.norm(away[:3]):.3g} mm and "
                f"{np.rad2deg(np.linalg.norm(away[3:])):.3g}° from where the tool is on the object",
                span.where,
                "Begin the path there, or let the arm travel to its start in a phase before.",
            )
        return span.pieces(self.on, pin.SE3.Identity())


@final
@dataclass(frozen=True, eq=False)
class Follows(Role):
    """The tool follows a path in a frame on the object, from where it is: what a plan makes of the other roles.

    Args:
        on: the path of a frame; only its motion from its start counts.
        frame: the placement on the object in whose axes it is.
        holds: whether the arm holds the object meanwhile.
        holds_after: whether it does after the phase; None: as during it.
    """

    on: ObjectPath
    frame: Placement
    holds: bool = True
    holds_after: bool | None = None

    def __post_init__(self) -> None:
        require(self.on, ObjectPath, "Follows: on", "Give a path, such as a TimedPath.")
        object.__setattr__(self, "frame", as_placement(self.frame, "Follows: frame"))
        object.__setattr__(self, "duration", float(self.on.duration))

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        return span.pieces(self.on, as_placement(self.frame, "Follows: frame"))


@final
@dataclass(frozen=True, eq=False)
class Turns(Role):
    """The part of the object that the arm holds turns about a pin: an exact arc about it.

    Args:
        about: the pin: its point in the object frame (3,) [m], or a placement whose z axis is the pin's.
        angle: angle [rad].
        axis: direction of the pin in the object frame (3,); by default the z axis of ``about``.
        time_law: progress over the phase.
        holds: False for a tool that goes round without holding the object, as a torch around a seam.
    """

    about: Placement | ArrayLike
    angle: float
    axis: Sequence[float] | None = None
    time_law: TimeLaw | str = TimeLaw.QUINTIC
    holds: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", as_scalar(self.angle, "Turns: angle", low=-np.pi, high=np.pi))
        object.__setattr__(self, "time_law", as_time_law(self.time_law))
        object.__setattr__(self, "about", _pin(self.about))
        axis = (0.0, 0.0, 1.0) if self.axis is None else self.axis
        object.__setattr__(self, "axis", tuple(_unit(axis, "Turns: axis").tolist()))

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        frame = as_placement(self.about, "Turns: about")
        axis = np.asarray(self.axis)
        still = pin.SE3.Identity()
        turned = pin.SE3(pin.exp3(self.angle * axis), np.zeros(3))
        return span.pieces(LinePath(still, turned, duration=span.duration, time_law=self.time_law), frame)


@final
@dataclass(frozen=True, eq=False)
class Slides(Role):
    """The part of the object that the arm holds slides along an axis.

    Args:
        axis: direction in the object frame (3,).
        distance_m: how far [m].
        time_law: progress over the phase.
    """

    axis: Sequence[float]
    distance_m: float
    time_law: TimeLaw | str = TimeLaw.QUINTIC

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance_m", as_scalar(self.distance_m, "Slides: distance_m", low=-1e3))
        object.__setattr__(self, "time_law", as_time_law(self.time_law))
        object.__setattr__(self, "axis", tuple(_unit(self.axis, "Slides: axis").tolist()))

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        still = pin.SE3.Identity()
        moved = pin.SE3(np.eye(3), self.distance_m * np.asarray(self.axis))
        return span.pieces(LinePath(still, moved, duration=span.duration, time_law=self.time_law), still)


@final
@dataclass(frozen=True, eq=False)
class FollowsJoints(Role):
    """The arm does not hold the object, and follows a way of its joints: also to another branch, or past singularities.

    The way counts with its speeds and accelerations among the limits of all, ahead of the clock as well. Its tool goes
    where the joints lead it, and rests on the object after the phase where it is then. A moving object that the arm
    leaves, or joins, makes its joints jump: let the object rest at both ends of the phase, or it slows down there.

    Args:
        path: the way; it begins where the arm is when the phase begins, to within 1 mm and 1 mrad of its tool.
    """

    path: JointPath
    holds = False

    def __post_init__(self) -> None:
        require(self.path, JointPath, "FollowsJoints: path", "Give a JointPath(positions, durations).")
        object.__setattr__(self, "duration", self.path.duration)

    def pieces(self, span: Span) -> tuple[GraspPiece, ...]:
        """See :class:`Role`."""
        return ()


def _pin(value: Placement | ArrayLike) -> pin.SE3:
    if isinstance(value, pin.SE3) or np.shape(value) == (4, 4):
        return as_placement(value, "Turns: about")
    return pin.SE3(np.eye(3), as_vector(value, 3, "Turns: about"))


def _unit(value: ArrayLike, where: str) -> Array:
    v = as_vector(value, 3, where)
    size = float(np.linalg.norm(v))
    if not size > 1e-9:
        raise InvalidInputError("it has no direction", where, "Give a vector other than 0.")
    return v / size
