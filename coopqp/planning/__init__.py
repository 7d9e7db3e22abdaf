"""Ahead of the clock and before the motion: the path preview, starts, the check of a path, and its timing.

Import names for users from here.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.paths.geometry import MotionBounds, PathGeometry, Piece
    from coopqp.paths.timed import SpeedProfile
    from coopqp.planning.arm_check import ArmCheck, UndecidedInterval
    from coopqp.planning.arm_starts import BranchAlongPath
    from coopqp.planning.branch_checks import BranchCheck, PathVerdict
    from coopqp.planning.check import PathCheck, check_path
    from coopqp.planning.clearance import ClearanceCheck
    from coopqp.planning.payload import Payload
    from coopqp.planning.planner import Plan, plan
    from coopqp.planning.remedies import Remedy, find_remedies
    from coopqp.planning.starts import ArmStart, Start, find_start
    from coopqp.planning.timing import time_path
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.planning.arm_check": "ArmCheck UndecidedInterval",
            "coopqp.planning.arm_starts": "BranchAlongPath",
            "coopqp.planning.branch_checks": "BranchCheck PathVerdict",
            "coopqp.planning.check": "PathCheck check_path",
            "coopqp.planning.clearance": "ClearanceCheck",
            "coopqp.planning.payload": "Payload",
            "coopqp.planning.planner": "Plan plan",
            "coopqp.planning.remedies": "Remedy find_remedies",
            "coopqp.planning.starts": "ArmStart Start find_start",
            "coopqp.planning.timing": "time_path",
            "coopqp.paths.geometry": "MotionBounds PathGeometry Piece",
            "coopqp.paths.timed": "SpeedProfile",
        },
    )

__all__ = [
    "ArmCheck",
    "ArmStart",
    "BranchAlongPath",
    "BranchCheck",
    "ClearanceCheck",
    "MotionBounds",
    "PathCheck",
    "PathGeometry",
    "PathVerdict",
    "Payload",
    "Piece",
    "Plan",
    "Remedy",
    "SpeedProfile",
    "Start",
    "UndecidedInterval",
    "check_path",
    "find_remedies",
    "find_start",
    "plan",
    "time_path",
]
