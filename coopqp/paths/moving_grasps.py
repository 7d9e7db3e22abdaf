"""Grasps along a path on which tools move on the object: where they are, pieces of their motion, and refusals."""

from __future__ import annotations

import math

import pinocchio as pin

from coopqp.core._core import SEGMENT
from coopqp.errors import InvalidInputError
from coopqp.model.grasp import Grasp
from coopqp.paths.grasp_motion import LAWS, GraspPiece
from coopqp.paths.path import ObjectPath


def grasp_at(grasp: Grasp, path: ObjectPath, clock: float) -> Grasp:
    """How the tools are placed on the object at a clock [s] of a path that begins with a grasp."""
    return grasp if path.grasps is None else grasp.moved_by(path.grasps.placements(clock))


#: The remedy where arms share joints.
HOLD_ON = "Arms that share joints hold on all the time: give a path without such motion, or lock these joints."


def refuse_motion(path: ObjectPath, where: str, remedy: str) -> None:
    """Refuse a path along which tools move on the object, or let it go.

    Raises:
        InvalidInputError: it is one.
    """
    motion = getattr(path, "grasps", None)
    if motion is not None and (motion.moves or not all(all(holds) for _, holds in motion.contact)):
        raise InvalidInputError("arms let go or move on the object along this path", where, remedy)


def refuse_moving_holds(path: ObjectPath, where: str, remedy: str) -> None:
    """Refuse a path along which an arm moves on the object while it holds it.

    Raises:
        InvalidInputError: it is one.
    """
    motion = getattr(path, "grasps", None)
    if motion is not None and not motion.holding_fixed:
        raise InvalidInputError("an arm moves on the object while it holds it", where, remedy)


def refuse_ways(path: ObjectPath, where: str, remedy: str) -> None:
    """Refuse a path along which an arm follows a way of its joints, or let it go.

    Raises:
        InvalidInputError: it is one.
    """
    motion = getattr(path, "grasps", None)
    if motion is not None and motion.leads:
        raise InvalidInputError("an arm follows a way of its joints along this path", where, remedy)


def pieces_of(S: ObjectPath, *, start: float, before: pin.SE3, frame: pin.SE3, where: str) -> tuple[GraspPiece, ...]:
    """The pieces of a motion along a path S from a clock on.

    Args:
        S: the path of a frame, relative to ``frame``; only its motion from its start counts.
        start: the clock at which it begins [s].
        before: M where it begins.
        frame: A, the placement on the object in whose axes S is.
        where: of messages.

    Raises:
        InvalidInputError: S is not made of segments whose numbers the core knows.
    """
    numbers = S.packed() if math.isfinite(S.duration) else None
    rows = None if numbers is None else numbers[3 + int(numbers[1]) :][: SEGMENT * int(numbers[2])]
    if rows is None or not all(row[20] in LAWS for row in rows.reshape(-1, SEGMENT)):
        raise InvalidInputError(
            f"a {type(S).__name__} is not made of straight segments",
            where,
            "Give a LinePath, a WaypointPath, a HoldPath, or a Section of one.",
        )
    B = S.pose(0.0).inverse() * frame.inverse() * before
    made = []
    for row in rows.reshape(-1, SEGMENT):
        if row[18] < S.duration - 1e-12:
            segment = row.copy()
            segment[18] += start
            made.append(GraspPiece(frame, B, segment))
    return tuple(made)
