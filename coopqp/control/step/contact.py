"""Contact that changes along a path: an arm that attaches has to be where it grasps, and is taken as it is then.

Where an arm attaches, its tool is compared with its place on the object, as the arms hold it that held it before. Too
far from it the arms hold, and the reason names the arm and the distance. Else the grip latches where the tool is:
nothing is corrected, and the object's measured pose goes on without a jump, though another set of arms makes it. A
change at a clock is seen by a step that begins SAME_CLOCK before it; a start sees those from so much before on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.core._core import SAME_CLOCK
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp, mean_pose
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.spatial import Array, Flags


@final
class Contact:
    """The changes of contact along the path that a loop follows.

    Args:
        cell, grasp: the arms, and how they hold the object when the path begins.
        motion: how the tools move on the object along it, and who holds it.

    Attributes:
        clocks: of the changes, rising [s].
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, motion: GraspMotion) -> None:
        self._cell, self._grasp, self._motion = cell, grasp, motion
        self.clocks = motion.changes

    def due(self, clock: float, taken: float) -> bool:
        """Whether a change up to a clock is not taken yet; those up to ``taken`` are [s]."""
        return any(taken < at <= clock + SAME_CLOCK for at in self.clocks)

    def ahead(self, clock: float) -> float:
        """Time to the next change after a clock [s]; infinite without one."""
        return min((at - clock for at in self.clocks if at > clock + SAME_CLOCK), default=np.inf)

    def refused(self, clock: float, taken: float, carried: Sequence[pin.SE3]) -> str:
        """Why an arm may not attach, as a sentence; empty where all that do are where they grasp.

        Args:
            clock, taken: the object's clock, and that up to which changes were taken [s].
            carried: poses of the object as each arm carries it, measured if they can be.
        """
        motion, names = self._motion, self._cell.arm_names
        before, now = motion.holds(max(taken, 0.0)), motion.holds(clock)
        kept = [k for k in range(len(carried)) if before[k] and now[k]]
        new = [k for k in range(len(carried)) if now[k] and not before[k]]
        if not kept or not new:
            return ""
        shares = np.zeros((len(carried), 6))
        shares[kept] = 1.0 / len(kept)
        held = mean_pose(carried, shares)
        found = []
        for k in new:
            place = motion.moved(k, clock) * self._grasp.T_object_tool[k]
            away = (held * place).actInv(carried[k] * place)
            far, turned = float(np.linalg.norm(away.translation)), float(np.linalg.norm(pin.log3(away.rotation)))
            if far > motion.attach_m or turned > motion.attach_rad:
                found.append((far, turned, names[k]))
        if not found:
            return ""
        far, turned, name = max(found)
        return (
            f"arm {name} is {1e3 * far:.2f} mm and {np.rad2deg(turned):.2f}° from its grasp where it attaches "
            f"(at most {1e3 * motion.attach_m:g} mm and {np.rad2deg(motion.attach_rad):.2g}°)"
        )


def filter_time(time: float, holds: Array | Flags | Sequence[bool]) -> float:
    """Time constant [s] of the filter of the measured object error while h of N arms hold (N,): T (N/h)².

    The path correction takes up to ``K / (2 ω (1 + ω² T²))`` from the damping ratio of a mode at ω in which the object
    swings on its arms, with the gain K. Fewer arms hold it less stiffly, with ω² smaller by h/N: for ω T > 1/3 the
    share that is taken does not grow then.
    """
    fewer = len(holds) / float(np.sum(holds))
    return fewer * fewer * time


def handed(shares: Array, before: Array, away: Array) -> Array:
    """What keeps the mean of the arms' deviations (N, 6) as it was (6,) where their shares (N, 6) change."""
    kept: Array = ((before - shares) * away).sum(axis=0)
    return kept
