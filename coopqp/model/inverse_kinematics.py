"""Closed-chain inverse kinematics: the configuration at which every arm carries the object at one pose.

Newton's method solves ``log(O_k⁻¹ R) = 0`` for all arms at once. The start of a task, the periodic reset of the
baseline and the path preview (with warm starts) use it.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_scalar
from coopqp.core._core import LONGEST_STEP
from coopqp.errors import UnreachableError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import AT_LIMIT, all_turns, amount, find_branches
from coopqp.model.cell import Arm, RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array, Placement, as_placement, for_twists

_LAST = threading.local()


def newton(chain: Chain, target: pin.SE3, q: Array, *, tolerance: float, max_iter: int) -> tuple[Array, Array]:
    """Iterate from ``q``; returns the last configuration and its errors (N, 6) with respect to ``target``."""
    R, about = target.rotation, target.translation
    errors = chain.errors(chain.carried(q), target)
    for _ in range(max_iter):
        if np.abs(errors).max() <= tolerance:
            break
        chain.linearise(q, about)
        step = chain.joint_velocities(-errors @ for_twists(R).T)
        largest = np.abs(step).max()
        if not np.isfinite(largest):
            break
        if largest > LONGEST_STEP:
            step *= LONGEST_STEP / largest
        q = pin.integrate(chain.cell.model, q, step)
        errors = chain.errors(chain.carried(q), target)
    return q, errors


def inverse_kinematics(
    cell: RobotCell,
    grasp: Grasp,
    T_world_object: Placement,
    q_start: ArrayLike,
    *,
    tolerance: float = 1e-12,
    max_iter: int = 100,
    limits: bool = True,
) -> Array:
    """Find a configuration (nq,) near ``q_start`` at which all arms carry the object at ``T_world_object``.

    Args:
        cell: the cell.
        grasp: the grasp.
        T_world_object: pose of the object.
        q_start: start configuration (nq,); it decides the branch (elbow up or down …).
        tolerance: largest accepted error [m, rad]; errors up to 1e-9 are always accepted.
        max_iter: largest number of Newton iterations.
        limits: an arm that ends outside its position limits takes the nearest branch inside them. False ignores them.

    Raises:
        InvalidInputError: bad pose or ``q_start``.
        UnreachableError: an arm does not reach its grasp, or only outside its limits. The message names the arm and
            the remaining distance, or the joint and how far it would be outside.
    """
    target = as_placement(T_world_object, "inverse_kinematics: T_world_object")
    q0 = cell.check_configuration(q_start, "inverse_kinematics: q_start")
    tolerance = as_scalar(tolerance, "inverse_kinematics: tolerance", open_low=False)
    chain = _chain(cell, grasp)
    q, errors = newton(chain, target, q0, tolerance=tolerance, max_iter=max_iter)
    _check_reached(cell, errors, tolerance, max_iter)
    if limits:
        x = cell.positions(q)
        moved = [k for k in range(len(cell)) if _is_outside(cell, x, chain.moving_columns[k])]
        for k in moved:
            x[chain.moving_columns[k]] = _inside_limits(cell.arms[k], target * grasp.T_object_tool[k], x, q0, cell, k)
        if moved:
            q, errors = newton(chain, target, cell.configuration(x), tolerance=tolerance, max_iter=max_iter)
            _check_reached(cell, errors, tolerance, max_iter)
    return q


def _chain(cell: RobotCell, grasp: Grasp) -> Chain:
    """The chain of a cell and a grasp: this thread's last one if it fits. To make one takes longer than to use it."""
    last: Chain | None = getattr(_LAST, "chain", None)
    if last is None or last.cell is not cell or last.grasp is not grasp:
        last = _LAST.chain = Chain(cell, grasp)
    return last


def _check_reached(cell: RobotCell, errors: Array, tolerance: float, max_iter: int) -> None:
    worst = int(np.abs(errors).max(axis=1).argmax())
    if not np.abs(errors[worst]).max() <= max(tolerance, 1e-9):
        d, a = np.linalg.norm(errors[worst, :3]), np.linalg.norm(errors[worst, 3:])
        raise UnreachableError(
            f"arm '{cell.arm_names[worst]}' does not reach its grasp: {1e3 * d:.1f} mm and {np.rad2deg(a):.2f}° remain "
            f"after {max_iter} iterations. Move its base or the object, or give another start."
        )


def _is_outside(cell: RobotCell, x: Array, columns: Any) -> bool:
    low, high = cell.limits.lower[columns], cell.limits.upper[columns]
    return bool(((x[columns] < low - AT_LIMIT) | (x[columns] > high + AT_LIMIT)).any())


def _inside_limits(arm: Arm, T_world_tool: pin.SE3, x: Array, q0: Array, cell: RobotCell, k: int) -> Array:
    """The branch of an arm inside its limits that is nearest to the start, (n,)."""
    kinematics = ArmKinematics(arm)
    columns = cell.columns[k][kinematics.columns]
    start = cell.positions(q0)[columns]
    branches = find_branches(kinematics, T_world_tool, near=x[None, columns])
    inside = [q for b in branches.q[branches.inside] for q in all_turns(kinematics, b)]
    if inside:
        return min(inside, key=lambda q: float(np.abs(q - start).max()))
    # The branch with the smallest excess over its limits.
    margins = branches.margins if len(branches) else kinematics.margins(x[None, columns])
    j = int(margins[0].argmin())
    raise UnreachableError(
        f"arm '{arm.name}' reaches its grasp only outside its limits: {kinematics.joints[j]} would be "
        f"{amount(-margins[0, j], slides=bool(kinematics.slides[j]))} outside (the least of {len(branches)} branches "
        f"from {branches.seeds} seeds). Roll its tool, or move its base or the object."
    )
