"""Closed-chain inverse kinematics: the configuration at which every arm carries the object at one pose.

Newton's method solves ``log(O_k⁻¹ R) = 0`` for all arms at once. The start of a task, the periodic reset of the
baseline and the path preview (with warm starts) use it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.errors import UnreachableError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array, Placement, as_placement

#: Largest Newton step of a joint [rad or m]; longer steps are scaled down.
_LONGEST_STEP = 0.5


def newton(chain: Chain, target: pin.SE3, q: Array, *, tolerance: float, max_iter: int) -> tuple[Array, Array]:
    """Iterate from ``q``; returns the last configuration and its errors (N, 6) with respect to ``target``."""
    R, about = target.rotation, target.translation
    velocity = np.empty(chain.nv)
    errors = chain.errors(chain.carried(q), target)
    for _ in range(max_iter):
        if np.abs(errors).max() <= tolerance:
            break
        chain.linearise(q, about)
        step = chain.joint_velocities(np.hstack([-errors[:, :3] @ R.T, -errors[:, 3:] @ R.T]), velocity)
        largest = np.abs(step).max()
        if not np.isfinite(largest):
            break
        if largest > _LONGEST_STEP:
            step *= _LONGEST_STEP / largest
        q = pin.integrate(chain.cell.model, q, step)
        errors = chain.errors(chain.carried(q), target)
    return q, errors


def inverse_kinematics(
    cell: RobotCell,
    grasp: Grasp,
    T_world_object: Placement,
    q_start: Any,
    *,
    tolerance: float = 1e-12,
    max_iter: int = 100,
) -> Array:
    """Find a configuration (nq,) near ``q_start`` at which all arms carry the object at ``T_world_object``.

    Args:
        cell: the cell.
        grasp: the grasp.
        T_world_object: pose of the object.
        q_start: start configuration (nq,); it decides the branch (elbow up or down …).
        tolerance: largest accepted error [m, rad]; errors up to 1e-9 are always accepted.
        max_iter: largest number of Newton iterations.

    Raises:
        InvalidInputError: bad pose or ``q_start``.
        UnreachableError: an arm does not reach its grasp. The message names the arm and the remaining distance.
    """
    target = as_placement(T_world_object, "inverse_kinematics: T_world_object")
    q0 = cell.check_configuration(q_start, "inverse_kinematics: q_start")
    tolerance = as_scalar(tolerance, "inverse_kinematics: tolerance", open_low=False)
    q, errors = newton(Chain(cell, grasp), target, q0, tolerance=tolerance, max_iter=max_iter)
    worst = int(np.abs(errors).max(axis=1).argmax())
    if not np.abs(errors[worst]).max() <= max(tolerance, 1e-9):
        d, a = np.linalg.norm(errors[worst, :3]), np.linalg.norm(errors[worst, 3:])
        raise UnreachableError(
            f"arm '{cell.arm_names[worst]}' does not reach its grasp: {1e3 * d:.1f} mm and {np.rad2deg(a):.2f}° remain "
            f"after {max_iter} iterations. Move its base or the object, or start from another q_start."
        )
    return q
