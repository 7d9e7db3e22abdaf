"""Ahead of the clock and before the motion: the path preview, starts, and timing.

Import names for users from here.
"""

from coopqp.planning.arm_starts import BranchAlongPath
from coopqp.planning.payload import Payload
from coopqp.planning.plan import Plan, plan
from coopqp.planning.starts import ArmStart, Start, find_start
from coopqp.planning.timing import time_path
from coopqp.task.geometry import PathGeometry
from coopqp.task.timed import SpeedProfile

__all__ = [
    "ArmStart",
    "BranchAlongPath",
    "PathGeometry",
    "Payload",
    "Plan",
    "SpeedProfile",
    "Start",
    "find_start",
    "plan",
    "time_path",
]
