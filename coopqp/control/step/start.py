"""Starts: do the arms hold the object at the beginning of its path, deviations worth a warning, and the first rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, read_only
from coopqp.errors import InvalidInputError
from coopqp.model.branches import AT_LIMIT, amount
from coopqp.model.cell import RobotCell, slides
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.paths.elbows import Elbows
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.moving_grasps import HOLD_ON, grasp_at, refuse_motion
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array

#: Default of the largest accepted error of an arm at reset [m, rad].
START_TOLERANCE_M, START_TOLERANCE_RAD = 0.02, np.deg2rad(3.0)
#: Smallest deviation from grasp or path that a start reports [m, rad].
_REPORTED_FROM = 5e-5, np.deg2rad(5e-3)
#: A path with a square of its speed below this rests [m²/s²].
_RESTS = 1e-12


def check_path(cell: RobotCell, path: ObjectPath, constraints: Sequence[Any], *, shifted: bool, relaxes: bool) -> None:
    """Refuse a path that is another cell's, or one whose tools move where they cannot.

    Args:
        cell, constraints: of the controller.
        shifted: the grasps were shifted, which give way to forces if ``relaxes``.

    Raises:
        InvalidInputError: see above.
    """
    elbows, grasps, where = getattr(path, "elbows", None), getattr(path, "grasps", None), "QPController: path"
    if isinstance(elbows, Elbows) and elbows.x.shape[1:] != (cell.nv,):
        raise InvalidInputError("its elbows are those of another cell", where, "Give this cell's.")
    if cell.groups:
        refuse_motion(path, where, HOLD_ON)
    if not isinstance(grasps, GraspMotion):
        return
    if len(grasps) != len(cell):
        raise InvalidInputError("its grasps are those of another cell", where, "Give this cell's.")
    if grasps.arms[0] and any(hasattr(constraint, "scene") for constraint in constraints):
        raise InvalidInputError(
            f"the tool of arm '{cell.arm_names[0]}' moves on the object, and a scene places the object by it",
            "QPController: constraints",
            "Let the first arm of the cell hold the object at rest on it, or give no Clearance.",
        )
    if shifted and not (relaxes and grasps.holding_fixed):
        raise InvalidInputError("its tools move on the object, and the grasps were shifted", where, "Shift them back.")


def check_start(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    q: ArrayLike,
    *,
    tolerance_m: float = START_TOLERANCE_M,
    tolerance_rad: float = START_TOLERANCE_RAD,
    clock: float = 0.0,
) -> Array:
    """Check that the arms hold the object where the path is at ``clock`` [s].

    Returns:
        ``q`` (nq,), or the mean of its rows (n, nq), as a read-only array.

    Raises:
        InvalidInputError: an arm does not; the message names the arm and its distance from the path.
    """
    configuration = cell.at_rest(q, "reset: q")
    guarded = GuardedPath(path)
    start = guarded.pose(clock)
    if start is None:
        raise InvalidInputError(guarded.problem, "reset", "A path needs a pose where it starts.")
    where = f"its path at {clock:g} s" if clock > 0.0 else "the start of its path"
    grasp = grasp_at(grasp, path, clock)
    for name, O in zip(cell.arm_names, grasp.carried(CellState(cell, configuration)), strict=True):
        error = pin.log6(start.actInv(O)).vector
        d, a = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if d > tolerance_m or a > tolerance_rad:
            raise InvalidInputError(
                f"arm '{name}' holds the object {1e3 * d:.1f} mm and {np.rad2deg(a):.2f}° from {where} "
                f"(tolerance {1e3 * tolerance_m:g} mm, {np.rad2deg(tolerance_rad):.3g}°)",
                "reset: q",
                "Start where the arms meet the grasp (coopqp.inverse_kinematics, coopqp.find_start), or widen "
                "the start tolerance.",
            )
    return read_only(configuration)


def held_command(cell: RobotCell, q: Array, commanded: ArrayLike, largest: float) -> Array:
    """The configuration (nq,) that the robots hold, checked against the measured one.

    Args:
        cell: the arms.
        q: measured configuration (nq,).
        commanded: what the robots' controllers hold (nq,).
        largest: largest distance of a joint from its command that is believed [rad or m].

    Raises:
        InvalidInputError: it is no configuration, or a joint is measured elsewhere.
    """
    held = cell.check_configuration(commanded, "reset: commanded")
    away = np.abs(pin.difference(cell.model, held, q))
    worst = int(away.argmax())
    if away[worst] > largest:
        raise InvalidInputError(
            f"joint {cell.joint_names[worst]} is measured {away[worst]:.3g} rad (or m) from its command",
            "reset: commanded",
            "Give the targets that the robots hold at the time of the measurement, in the order of cell.joint_names.",
        )
    return held


def start_warning(cell: RobotCell, grasp: Grasp, shares: Array, pose: pin.SE3 | None, q: Array) -> tuple[str, ...]:
    """Sentences about joints outside limits, arms off the grasp, an object off its path; empty if all is well.

    Args:
        cell, grasp: the arms, and how they hold the object.
        shares: of the arms in the common error (N, 6).
        pose: the path's; None to judge the grasp only.
        q: configuration (nq,).
    """
    warnings = [_outside_limits(cell, q)]
    O = grasp.carried(CellState(cell, q))
    reference = O[0] if pose is None else pose
    errors = np.array([pin.log6(reference.actInv(other)).vector for other in O])
    common = (shares * errors).sum(axis=0)
    off = errors - common
    worst = (
        np.linalg.norm(off[:, :3], axis=1) / _REPORTED_FROM[0] + np.linalg.norm(off[:, 3:], axis=1) / _REPORTED_FROM[1]
    )
    arm = int(worst.argmax())
    if _off(off[arm]):
        warnings.append(f"arm {cell.arm_names[arm]} started off its grasp: it is {_off(off[arm])} off")
    if pose is not None and _off(common):
        warnings.append(f"the object started off its path: it is {_off(common)} off")
    return tuple(filter(None, warnings))


def _outside_limits(cell: RobotCell, q: Array) -> str:
    """The arm and the joint that is furthest outside its position limits, in words; empty if all are inside."""
    x, limits = cell.positions(q), cell.limits
    excess = np.maximum(limits.lower - x, x - limits.upper)
    j = int(excess.argmax())
    if not excess[j] > AT_LIMIT:
        return ""
    arm, _, joint = cell.joint_names[j].partition("/")
    outside = amount(float(excess[j]), slides=slides(cell)[j])
    return f"arm {arm} started outside its limits: {joint} is {outside} outside"


def _off(error: Array) -> str:
    """A distance and an angle in words; empty if both are below ``_REPORTED_FROM``."""
    d, a = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    parts = [f"{1e3 * d:.2f} mm"] if d > _REPORTED_FROM[0] else []
    parts += [f"{np.rad2deg(a):.2f}°"] if a > _REPORTED_FROM[1] else []
    return " and ".join(parts)


def rate_into(rate: float, now: Array, ahead: Array, *, length: float) -> float | None:
    """The rate on another path that comes closest to the object's present motion; None if it starts from rest.

    Args:
        rate: σ on the present path.
        now, ahead: twists of both paths at rate 1, in the object's own frame (6,) [m/s, rad/s]; or of the object and of
            all tools on it (1 + N, 6).
        length: weighs rotation against translation [m].
    """
    metric = np.array([1.0] * 3 + [length**2] * 3)
    before, square = float(np.vdot(now, metric * now)), float(np.vdot(ahead, metric * ahead))
    if rate == 0.0 or (square < _RESTS <= before):
        return None
    if before < _RESTS and square < _RESTS:  # both rest at any rate
        return rate
    return min(max(rate * float(np.vdot(ahead, metric * now)) / square, 0.0), 1.0)
