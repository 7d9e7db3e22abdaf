"""The payload of the arms, and the joint torques that move it along a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import as_floats, as_scalar, as_vector, one_each
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.planning.knots import Knots
from coopqp.spatial import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Payload:
    """The object as a rigid body. Of N arms each carries an N-th of it, fixed to its tool.

    Attributes:
        mass: [kg].
        centre: centre of mass in the object frame (3,) [m].
        inertia: about the centre, in the axes of the object frame (3, 3) [kg·m²]; 0 by default.
        torque: largest torques of the cell's joints (nv,) [N·m or N], or one number; by default those of the models,
            where an entry of 0 means that the model has none.
    """

    mass: float
    centre: Any = (0.0, 0.0, 0.0)
    inertia: Any = None
    torque: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", as_scalar(self.mass, "Payload: mass", open_low=False))
        object.__setattr__(self, "centre", as_vector(self.centre, 3, "Payload: centre"))
        if self.inertia is not None:
            inertia = as_floats(self.inertia)
            if inertia.shape != (3, 3) or not np.allclose(inertia, inertia.T) or np.linalg.eigvalsh(inertia)[0] < 0.0:
                raise InvalidInputError(
                    "not a symmetric 3x3 matrix ≥ 0", "Payload: inertia", "Give it about the centre."
                )
            object.__setattr__(self, "inertia", inertia)

    def limits(self, cell: RobotCell) -> Array:
        """Largest torques (nv,), inf where there is none.

        Raises:
            InvalidInputError: numbers that are no limits.
        """
        if self.torque is None:
            model = np.asarray(cell.model.effortLimit, dtype=float)
            return np.where((model > 0.0) & (model < 1e9), model, np.inf)
        given = one_each(self.torque, cell.nv, "Payload: torque", finite=False)
        if not (given > 0.0).all():
            raise InvalidInputError("entries ≤ 0", "Payload: torque", f"Give one, or {cell.nv}.")
        return given


def torque_lines(cell: RobotCell, grasp: Grasp, payload: Payload, knots: Knots) -> tuple[Array, Array, Array]:
    """a, b, c (K, nv) with joint torques ``a s̈ + b ṡ² + c`` [N·m or N] at the knots.

    With inverse dynamics τ(q, v, v̇): ``c = τ(q, 0, 0)``, ``a = τ(q, 0, q′) − c``, ``b = τ(q, q′, q″) − c``.
    """
    model = cell.model.copy()
    inertia = np.zeros((3, 3)) if payload.inertia is None else payload.inertia
    n = len(cell)
    share = pin.Inertia(payload.mass / n, np.asarray(payload.centre), inertia / n)
    for joint, T, X in zip(cell.tool_joints, cell.T_joint_tool, grasp.T_object_tool, strict=True):
        model.inertias[joint] = model.inertias[joint] + (T * X.inverse()).act(share)
    data, zero = model.createData(), np.zeros(cell.nv)
    a, b, c = (np.empty_like(knots.q) for _ in range(3))
    for i, x in enumerate(knots.q):
        q = cell.configuration(x)
        c[i] = pin.rnea(model, data, q, zero, zero)
        a[i] = pin.rnea(model, data, q, zero, knots.slope[i])
        b[i] = pin.rnea(model, data, q, knots.slope[i], knots.curvature[i])
    return a - c, b - c, c
