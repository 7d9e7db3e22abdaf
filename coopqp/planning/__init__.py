"""Ahead of the clock and before the motion: the path preview, starts, and the check of a path.

Import names for users from here.
"""

from coopqp.planning.arm_starts import BranchAlongPath
from coopqp.planning.branch_checks import BranchCheck, PathVerdict
from coopqp.planning.check import ArmCheck, PathCheck, UndecidedInterval, check_path
from coopqp.planning.remedies import Remedy, find_remedies
from coopqp.planning.starts import ArmStart, Start, find_start

__all__ = [
    "ArmCheck",
    "ArmStart",
    "BranchAlongPath",
    "BranchCheck",
    "PathCheck",
    "PathVerdict",
    "Remedy",
    "Start",
    "UndecidedInterval",
    "check_path",
    "find_remedies",
    "find_start",
]
