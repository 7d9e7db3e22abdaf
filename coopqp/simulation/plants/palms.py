"""Palms that press on the object: the stand below it, and the load that passes from the stand to the drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_tuple
from coopqp.errors import InvalidInputError
from coopqp.forces.grips import Grip
from coopqp.simulation.plants.mujoco_cell import MujocoCell
from coopqp.simulation.plants.mujoco_model import STAND, STAND_HALF, quaternion, require_mujoco

#: Time in which the drives take the load over from the stand, once all palms press with their least squeeze [s].
_TAKES = 0.3


def as_palms(palms: Sequence[Grip], arms: int) -> tuple[Grip, ...]:
    """Check ``palms``: one palm per arm."""
    out = as_tuple(palms, "PhysicsPlant: palms", "Give one Grip per arm.")
    if len(out) != arms or any(not isinstance(p, Grip) or p.kind != "palm" for p in out):
        raise InvalidInputError("no palm for each arm", "PhysicsPlant: palms", 'Give Grip(kind="palm", …).')
    return out


@final
class Palms:
    """The palms of a cell, and the stand.

    Args:
        grips: one palm per arm.
        engine: the cell in the engine.
        T_object_body: placement of the box's centre in the object frame.
        height: height of the box [m].

    Attributes:
        taken: share of the load that the drives feed forward, 0 to 1.
    """

    def __init__(self, grips: tuple[Grip, ...], engine: MujocoCell, T_object_body: pin.SE3, height: float) -> None:
        self._grips, self._engine = grips, engine
        self._T_object_stand = T_object_body * pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * height - STAND_HALF]))
        self._geom, self._body = engine.model.geom(STAND).id, engine.model.body(STAND).id
        self._placed: list[pin.SE3] | None = None  # tools on the object when the stand let it go
        self.taken = 0.0

    def reset(self, T_world_object: pin.SE3) -> None:
        """Put the stand below the object."""
        m, stand = self._engine.model, T_world_object * self._T_object_stand
        m.body_pos[self._body], m.body_quat[self._body] = stand.translation, quaternion(stand.rotation)
        m.body_sameframe[self._body] = require_mujoco().mjtSameFrame.mjSAMEFRAME_NONE
        m.geom_contype[self._geom], m.geom_conaffinity[self._geom] = 1, 2
        self._placed, self.taken = None, 0.0

    def step(self, dt: float, rate: float) -> None:
        """Begin a command: the drives take the load over while all palms press, wholly once the object moves."""
        if self._placed is not None:
            return
        pressed = zip(self._grips, self._engine.sensed_wrenches(), strict=True)
        if all(w[:3] @ palm.normal > palm.squeeze for palm, w in pressed):
            self.taken = min(self.taken + dt / _TAKES, 1.0)
        if rate > 0.0:
            m = self._engine.model
            self.taken, self._placed = 1.0, self._engine.T_object_tool
            m.geom_contype[self._geom] = m.geom_conaffinity[self._geom] = 0

    @property
    def touch(self) -> bool:
        """True while every palm touches the object."""
        return bool((np.linalg.norm(self._engine.sensed_wrenches()[:, :3], axis=1) > 1e-6).all())

    def slip(self) -> float:
        """Largest slip of a palm along the object since the stand let it go [m]; 0 before."""
        if self._placed is None:
            return 0.0
        far = 0.0
        for palm, before, now in zip(self._grips, self._placed, self._engine.T_object_tool, strict=True):
            way, normal = now.translation - before.translation, before.rotation @ palm.normal
            far = max(far, float(np.linalg.norm(way - (way @ normal) * normal)))
        return far
