"""Error measures of a run, computed from configurations only, independently of the controllers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array
from coopqp.task.path import ObjectPath

#: Smaller errors [mm or deg] are rounding: texts say "below" instead of a number.
ROUNDING = 1e-9


def said(value: float, unit: str = "") -> str:
    """An error in words: three digits and the unit; "below 1e-9" for rounding, two digits below 1e-4."""
    value = float(value)
    if not math.isfinite(value):
        return "not finite"
    if 0.0 < abs(value) < ROUNDING:
        return f"below 1e-9{unit}"
    return (f"{value:.3g}" if value == 0.0 or abs(value) >= 1e-4 else f"{value:.1e}") + unit


def tool_placements(cell: RobotCell, configurations: ArrayLike) -> list[list[pin.SE3]]:
    """T_world_tool of every arm at every configuration (T, nq), directly from Pinocchio's frames."""
    data = cell.model.createData()
    out = []
    for q in _table(configurations, cell.nq, "configurations"):
        pin.framesForwardKinematics(cell.model, data, q)
        out.append([data.oMf[f].copy() for f in cell.tool_frames])
    return out


def _table(rows: Any, width: int, what: str) -> Array:
    """Return rows of ``width`` numbers as an array. NaN is allowed."""
    try:
        table = np.array(rows, dtype=float)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{what} are not rows of numbers ({error})", "metrics", "Give an array.") from error
    if table.size == 0:
        return np.empty((0, width))
    if table.ndim != 2 or table.shape[1] != width:
        raise InvalidInputError(
            f"{what} have shape {table.shape}, expected (T, {width})", "metrics", "Give one row per sample."
        )
    return table


def _check_arms(tools: Sequence[pin.SE3], grasp: Grasp) -> None:
    if len(tools) != len(grasp):
        raise InvalidInputError(
            f"{len(tools)} tools and a grasp of {len(grasp)} arms", "metrics", "Give the tools of one sample, all arms."
        )


def _angle(R: Array) -> float:
    """Angle of a rotation [rad], accurate near 0 and π."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(0.5 * np.linalg.norm(w), 0.5 * (np.trace(R) - 1.0)))


def relative_positioning_error(tools: Sequence[pin.SE3], grasp: Grasp) -> float:
    """ε_p of the paper [m]: root of the sum over pairs (j, i), j after i, of |p_ji − d_ji|² in tool frame i.

    The references d_ji follow from the grasp. For the paper's triangle they are [β, 0, 3α], [−β, 0, 3α], [2β, 0, 0].
    """
    _check_arms(tools, grasp)
    X = grasp.T_object_tool
    total = 0.0
    for i in range(len(tools)):
        for j in range(i + 1, len(tools)):
            p = tools[i].actInv(tools[j]).translation
            d = X[i].actInv(X[j]).translation
            total += float((p - d) @ (p - d))
    return float(np.sqrt(total))


def relative_orientation_error(tools: Sequence[pin.SE3], grasp: Grasp) -> float:
    """ε_o [rad]: like ε_p, with the angles between the relative tool orientations and those of the grasp."""
    _check_arms(tools, grasp)
    X = grasp.T_object_tool
    total = 0.0
    for i in range(len(tools)):
        for j in range(i + 1, len(tools)):
            R = tools[i].actInv(tools[j]).rotation
            R_ref = X[i].actInv(X[j]).rotation
            total += _angle(R_ref.T @ R) ** 2
    return float(np.sqrt(total))


def _largest(values: Iterable[Any]) -> float:
    """The largest value; 0 without values. NaN if any value is NaN, so that a broken run never looks perfect."""
    return float(np.max([0.0, *values]))


def chain_error(tools: Sequence[pin.SE3], grasp: Grasp) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between the object poses of any two arms."""
    _check_arms(tools, grasp)
    O = [T * X.inverse() for T, X in zip(tools, grasp.T_object_tool, strict=True)]
    pairs = [(O[i], O[j]) for i in range(len(O)) for j in range(i + 1, len(O))]
    return (
        _largest(np.linalg.norm(a.translation - b.translation) for a, b in pairs),
        _largest(_angle(a.rotation.T @ b.rotation) for a, b in pairs),
    )


def object_error(tools: Sequence[pin.SE3], grasp: Grasp, pose: pin.SE3, arm: int = 0) -> tuple[float, float]:
    """Distance [m] and angle [rad] between the object pose of ``arm`` and ``pose``. For the paper this is frame A."""
    _check_arms(tools, grasp)
    O = tools[arm] * grasp.T_object_tool[arm].inverse()
    return float(np.linalg.norm(O.translation - pose.translation)), _angle(O.rotation.T @ pose.rotation)


def path_error(tools: Sequence[pin.SE3], grasp: Grasp, path: ObjectPath, clock: float) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between any arm's object pose and the path's pose at ``clock``."""
    pose = path.pose(clock)
    errors = [object_error(tools, grasp, pose, k) for k in range(len(tools))]
    return _largest(e[0] for e in errors), _largest(e[1] for e in errors)


def limit_excess(cell: RobotCell, configurations: ArrayLike, velocities: Any) -> float:
    """Largest excess over any position [rad or m] or velocity limit [rad/s or m/s]; 0 if all limits are kept.

    Args:
        cell: cell with the limits.
        configurations, velocities: rows (nq,) and rows (nv,); both may be empty.
    """
    limits = cell.limits
    x = np.array([cell.positions(q) for q in _table(configurations, cell.nq, "configurations")])
    v = np.abs(_table(velocities, cell.nv, "velocities"))
    worst: list[Any] = []
    if len(x):
        worst += [(x - limits.upper).max(), (limits.lower - x).max()]
    if len(v):
        worst.append((v - limits.velocity).max())
    return _largest(worst)
