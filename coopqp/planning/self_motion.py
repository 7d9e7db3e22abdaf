"""The elbows of redundant arms, led along the motion that the check of a path proves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coopqp.checks import ArrayLike
from coopqp.errors import CoopqpError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.model.grasp import Grasp
from coopqp.model.posture import PostureOptions
from coopqp.paths.path import ObjectPath
from coopqp.planning.check import check_path

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene


def led_path(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    *,
    q_start: ArrayLike,
    posture: PostureOptions,
    scene: CollisionScene | None = None,
) -> ObjectPath:
    """The path with elbows as :meth:`PathCheck.led_path` has them, for a run from a start.

    The path itself without redundant arms; where a posture is asked for; where it has its elbows; and where nothing is
    proved.
    """
    own = path.elbows is not None or posture.asks
    if own or not path.known_ahead or all(len(columns) <= 6 for columns in moving_columns(cell)):
        return path
    try:
        return check_path(cell, grasp, path, q_start=q_start, scene=scene).led_path()
    except CoopqpError:  # a start that does not hold the object, for one: the run says so
        return path
