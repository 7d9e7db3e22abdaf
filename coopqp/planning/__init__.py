"""Ahead of the clock and before the motion: the path preview, starts, the check of a path, and timing.

Import names for users from here.
"""

from coopqp.planning.arm_starts import BranchAlongPath
from coopqp.planning.branch_checks import BranchCheck, PathVerdict
from coopqp.planning.check import ArmCheck, PathCheck, UndecidedInterval, check_path
from coopqp.planning.payload import Payload
from coopqp.planning.plan import Plan, plan
from coopqp.planning.remedies import Remedy, find_remedies
from coopqp.planning.starts import ArmStart, Start, find_start
from coopqp.planning.timing import time_path
from coopqp.task.geometry import PathGeometry
from coopqp.task.timed import SpeedProfile

__all__ = [
    "ArmCheck",
    "ArmStart",
    "BranchAlongPath",
    "BranchCheck",
    "PathCheck",
    "PathGeometry",
    "PathVerdict",
    "Payload",
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
