"""Ahead of the clock and before the motion: the path preview, and starts.

Import names for users from here.
"""

from coopqp.planning.arm_starts import BranchAlongPath
from coopqp.planning.starts import ArmStart, Start, find_start

__all__ = ["ArmStart", "BranchAlongPath", "Start", "find_start"]
