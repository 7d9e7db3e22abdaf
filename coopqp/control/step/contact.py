"""Contact that changes along a path: an arm that attaches has to be where it grasps, and is taken as it is then.

Where an arm attaches, its tool is compared with its place on the object, as the arms hold it that held it before. Too
far from it the arms hold, and the reason names the arm and the distance. Else the grip latches where the tool is:
nothing is corrected, and the object's measured pose goes on without a jump, though another set of arms makes it: the
core sees to that (``step.cpp``). A change at a clock is seen by a step that begins SAME_CLOCK before it; a start sees
those from so much before on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp, mean_pose
from coopqp.paths.grasp_motion import GraspMotion


def refused(
    cell: RobotCell, grasp: Grasp, motion: GraspMotion, carried: Sequence[pin.SE3], *, clock: float, taken: float
) -> str:
    """Why an arm may not attach, as a sentence; empty where all that do are where they grasp.

    Args:
        cell, grasp: the arms, and how they hold the object when the path begins.
        motion: how the tools move on the object along it, and who holds it.
        carried: poses of the object as each arm carries it, measured if they can be.
        clock, taken: the object's clock, and that up to which changes were taken [s].
    """
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
        place = motion.moved(k, clock) * grasp.T_object_tool[k]
        away = (held * place).actInv(carried[k] * place)
        far, turned = float(np.linalg.norm(away.translation)), float(np.linalg.norm(pin.log3(away.rotation)))
        if far > motion.attach_m or turned > motion.attach_rad:
            found.append((far, turned, cell.arm_names[k]))
    if not found:
        return ""
    far, turned, name = max(found)
    return (
        f"arm {name} is {1e3 * far:.2f} mm and {np.rad2deg(turned):.2f}° from its grasp where it attaches "
        f"(at most {1e3 * motion.attach_m:g} mm and {np.rad2deg(motion.attach_rad):.2g}°)"
    )
