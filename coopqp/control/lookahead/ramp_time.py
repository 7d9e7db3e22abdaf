"""Ramp times: how long the joints take for a change of the object's motion."""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.control.lookahead.options import PlanLimits, PreviewOptions
from coopqp.core._core import CHANGE_SHARE, LARGEST_JUMP
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array


@final
class RampTime:
    """Times in which the joints change the object's motion.

    Args:
        cell, grasp: the arms, and how they hold the object.
        options: of the preview; None for the defaults.
        dt: nominal length of a step [s].
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, options: PreviewOptions | None, *, dt: float) -> None:
        self._cell, self._grasp = cell, grasp
        self._chain: Chain | None = None
        plan = PlanLimits.of(cell, options or PreviewOptions(), dt=dt)
        self._acceleration = CHANGE_SHARE * plan.acceleration
        limits = cell.limits
        speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        jumpy = ~np.isfinite(limits.acceleration)
        #: Time in which joints without acceleration limits stop from their full speed (nv,) [s]; 0 for the others.
        self.stops: Array = np.where(jumpy, speed / self._acceleration, 0.0)
        self._jump = np.where(jumpy, LARGEST_JUMP * speed, np.inf)

    def at(self, q: Array, T_world_object: pin.SE3) -> Array:
        """Seconds that each joint takes for a change by one unit (nv, 6) [s per m/s, s per rad/s], in world axes."""
        chain = self._chain = self._chain or Chain(self._cell, self._grasp)
        chain.linearise(q, about=T_world_object.translation)
        times: Array = chain.joint_columns(np.eye(6)) / self._acceleration[:, None]
        return times

    def admits(self, change: Array) -> bool:
        """Whether no joint without acceleration limit jumps in a step that changes the velocities so (nv,)."""
        return bool((np.abs(change) <= self._jump).all())
