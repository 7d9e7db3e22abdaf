"""Error measures of configurations and of whole runs, computed independently of the controllers.

The errors between the arms use the *commanded* configurations: once the object is gripped, servo deflection hides these
errors in the measured ones. The object pose uses the *measured* ones.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike
from coopqp.errors import InvalidInputError
from coopqp.model.batch import singular_values
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.joint_limits import JointLimits
from coopqp.model.state import workspace
from coopqp.paths.path import ObjectPath
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array, cross

#: Smaller errors [mm or deg] are rounding: texts say "below" instead of a number.
ROUNDING = 1e-9
#: Number of pairs of placements that are compared at once; bounds the memory.
_LARGEST_TABLE = 200_000


def error_text(value: float, unit: str = "") -> str:
    """An error in words: three digits and the unit; "below 1e-9" for rounding, two digits below 1e-4."""
    value = float(value)
    if not math.isfinite(value):
        return "not finite"
    if 0.0 < abs(value) < ROUNDING:
        return f"below 1e-9{unit}"
    return (f"{value:.3g}" if value == 0.0 or abs(value) >= 1e-4 else f"{value:.1e}") + unit


def tool_placements(cell: RobotCell, configurations: ArrayLike) -> list[list[pin.SE3]]:
    """T_world_tool of every arm at every configuration (T, nq)."""
    tools = tool_matrices(cell, _table(configurations, cell.nq, "configurations"))
    return [[pin.SE3(T) for T in row] for row in tools]


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


def _stacked(tools: Sequence[pin.SE3], grasp: Grasp) -> Array:
    """The tools of one sample as matrices (N, 4, 4)."""
    if len(tools) != len(grasp):
        raise InvalidInputError(
            f"{len(tools)} tools and a grasp of {len(grasp)} arms", "metrics", "Give the tools of one sample, all arms."
        )
    return _matrices(tools)


def _matrices(placements: Sequence[pin.SE3]) -> Array:
    return np.array([T.homogeneous for T in placements])


# -- stacks of samples: T_world_tool (…, N, 4, 4) ----------------------------------------------------------------------


def tool_matrices(cell: RobotCell, configurations: Array) -> Array:
    """T_world_tool (T, N, 4, 4) at configurations (T, nq)."""
    data, model = workspace(cell), cell.model
    return _tools(cell, configurations, lambda i, q: pin.forwardKinematics(model, data, q))


def tools_and_jacobians(cell: RobotCell, configurations: Array) -> tuple[Array, Array]:
    """T_world_tool (T, N, 4, 4) at configurations (T, nq), and transposed Jacobians (T, nv, 6).

    A row is the twist that a joint gives to what it moves, in world axes, at the world's origin.
    """
    data, model = workspace(cell), cell.model
    J = np.empty((len(configurations), 6, cell.nv))

    def compute(i: int, q: Array) -> None:
        J[i] = pin.computeJointJacobians(model, data, q)

    return _tools(cell, configurations, compute), np.ascontiguousarray(J.transpose(0, 2, 1))


def _tools(cell: RobotCell, configurations: Array, compute: Callable[[int, Array], object]) -> Array:
    """T_world_tool (T, N, 4, 4); ``compute`` places the joints in the workspace of the cell."""
    carriers = [workspace(cell).oMi[j] for j in cell.tool_joints]  # they move along with the data
    T = np.empty((len(configurations), len(carriers), 4, 4))
    for i, q in enumerate(configurations):
        compute(i, q)
        for k, carrier in enumerate(carriers):
            T[i, k] = carrier.homogeneous
    return T @ _matrices(cell.T_joint_tool)


@functools.cache
def _pairs(n: int) -> tuple[Any, Any]:
    """Indices i < j of all pairs of n arms."""
    return np.triu_indices(n, 1)


def _angles(R: Array) -> Array:
    """Angles (…) of rotations (…, 3, 3) [rad], accurate near 0 and π."""
    x, y, z = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    trace = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2]
    return np.arctan2(0.5 * np.sqrt(x * x + y * y + z * z), 0.5 * (trace - 1.0))


def _apart(A: Array, B: Array) -> tuple[Array, Array]:
    """Distances [m] and angles [rad] between placements (…, 4, 4)."""
    R = np.swapaxes(A[..., :3, :3], -1, -2) @ B[..., :3, :3]
    distance: Array = np.sqrt(((A[..., :3, 3] - B[..., :3, 3]) ** 2).sum(axis=-1))
    return distance, _angles(R)


def _positions(T: Array) -> Array:
    """Positions (…, P, 3) of tool j in the frame of tool i < j, for all pairs."""
    (i, j), p = _pairs(T.shape[-3]), T[..., :3, 3]
    apart = p[..., j, :] - p[..., i, :]
    return (apart[..., None, :] @ T[..., i, :3, :3])[..., 0, :]


@np.errstate(invalid="ignore")  # infinite positions have no difference
def without_shift(tools: Array, grasp: Grasp, shift: Array | None) -> Array:
    """Tools (T, N, 4, 4) with grasps that have given way by a shift (T, N, 6), as if they had not: T X⁻¹ exp(−d) X."""
    if shift is None:
        return tools
    back = np.array([[pin.exp6(-d).homogeneous for d in row] for row in shift]).reshape(tools.shape)
    X = _matrices(grasp.T_object_tool)
    return tools @ np.linalg.inv(X) @ back @ X


def positioning_errors(tools: Array, grasp: Grasp) -> Array:
    """ε_p (…) [m], see :func:`relative_positioning_error`."""
    off = _positions(tools) - _positions(_matrices(grasp.T_object_tool))
    return np.sqrt((off * off).sum(axis=(-2, -1)))


@np.errstate(invalid="ignore")
def object_poses(tools: Array, grasp: Grasp) -> Array:
    """Object pose of each arm (…, N, 4, 4)."""
    return tools @ _matrices([X.inverse() for X in grasp.T_object_tool])


@np.errstate(invalid="ignore")
def gaps(poses: Array) -> tuple[Array, Array]:
    """Distances [m] and angles [rad] (…, P) between the object poses (…, N, 4, 4) of all pairs of arms."""
    i, j = _pairs(poses.shape[-3])
    return _apart(poses[..., i, :, :], poses[..., j, :, :])


@np.errstate(invalid="ignore")
def errors_from(poses: Array, references: Array) -> tuple[Array, Array]:
    """Distances [m] and angles [rad] (…, N) between the object poses (…, N, 4, 4) and references (…, 4, 4)."""
    return _apart(poses, references[..., None, :, :])


def orientation_errors(angles: Array) -> Array:
    """ε_o (…) [rad] from the angles (…, P) of :func:`gaps`.

    With R_ij = R_iᵀ R_j of two tools and X_ij of their grasps, X_ijᵀ R_ij is as far from 1 as X_i R_ij X_jᵀ, which
    turns one arm's object pose into the other's.
    """
    return np.sqrt((angles * angles).sum(axis=-1))


def chain_errors(tools: Array, grasp: Grasp) -> tuple[Array, Array]:
    """Largest distance [m] and angle [rad] (…) between the object poses of any two arms."""
    distance, angle = gaps(object_poses(tools, grasp))
    return distance.max(axis=-1, initial=0.0), angle.max(axis=-1, initial=0.0)


def held_poses(cell: RobotCell, grasp: Grasp, q: Array, shift: Array | None) -> Array:
    """Object pose of each arm (T, N, 4, 4) at configurations (T, nq), with grasps that have given way (T, N, 6)."""
    return object_poses(without_shift(tool_matrices(cell, q), grasp, shift), grasp)


def object_gaps(cell: RobotCell, grasp: Grasp, q: Array, reference: Array, shift: Array | None) -> tuple[Array, Array]:
    """Distances [m] and angles [rad] (T, P + N): first of the P pairs of two arms, then of each arm and the path.

    Args:
        cell, grasp: the arms, and how they hold.
        q: configurations (T, nq).
        reference: poses of the path (T, 4, 4).
        shift: motion of the grasps (T, N, 6) [m, rad]; None where they stay.
    """
    poses = held_poses(cell, grasp, q, shift)
    rows = max(1, _LARGEST_TABLE // (len(cell) * (len(cell) + 1) // 2))
    found = []
    for part in (slice(start, start + rows) for start in range(0, len(q), rows)):
        pairs = zip(gaps(poses[part]), errors_from(poses[part], reference[part]), strict=True)
        found.append([np.hstack(both) for both in pairs])
    distance, angle = (np.vstack(parts) for parts in zip(*found, strict=True))
    return distance, angle


# -- one sample --------------------------------------------------------------------------------------------------------


def relative_positioning_error(tools: Sequence[pin.SE3], grasp: Grasp) -> float:
    """ε_p of the paper [m]: root of the sum over pairs (j, i), j after i, of |p_ji − d_ji|² in tool frame i.

    The references d_ji follow from the grasp. For the paper's triangle they are [β, 0, 3α], [−β, 0, 3α], [2β, 0, 0].
    """
    return float(positioning_errors(_stacked(tools, grasp), grasp))


def relative_orientation_error(tools: Sequence[pin.SE3], grasp: Grasp) -> float:
    """ε_o [rad]: like ε_p, with the angles between the relative tool orientations and the grasp's."""
    return float(orientation_errors(gaps(object_poses(_stacked(tools, grasp), grasp))[1]))


def chain_error(tools: Sequence[pin.SE3], grasp: Grasp) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between the object poses of any two arms."""
    distance, angle = chain_errors(_stacked(tools, grasp), grasp)
    return float(distance), float(angle)


def object_error(tools: Sequence[pin.SE3], grasp: Grasp, pose: pin.SE3, arm: int = 0) -> tuple[float, float]:
    """Distance [m] and angle [rad] between the object pose of ``arm`` and ``pose``. For the paper this is frame A."""
    distance, angle = errors_from(object_poses(_stacked(tools, grasp), grasp), pose.homogeneous)
    return float(distance[arm]), float(angle[arm])


def path_error(tools: Sequence[pin.SE3], grasp: Grasp, path: ObjectPath, clock: float) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between any arm's object pose and the path's pose at ``clock``."""
    distance, angle = errors_from(object_poses(_stacked(tools, grasp), grasp), path.pose(clock).homogeneous)
    return float(distance.max()), float(angle.max())


def outside(limits: JointLimits, x: Array) -> Array:
    """How far joint positions (…, nv) are outside the nearer of their limits [rad or m]; negative inside."""
    return np.maximum(x - limits.upper, limits.lower - x)


def acceleration_use(limits: JointLimits, v: Array, v_before: Array, dt: Array) -> Array:
    """Share of each joint's largest acceleration (T, nv) that steps of lengths dt (T,) [s] use.

    Args:
        limits: the limits.
        v, v_before: velocities in each step, and in the one before (T, nv) [rad/s or m/s].
        dt: lengths of the steps (T,) [s].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(v - v_before) / (dt[:, None] * limits.acceleration)


def limit_excess(cell: RobotCell, configurations: ArrayLike, velocities: Any) -> float:
    """Largest excess over any position [rad or m] or velocity limit [rad/s or m/s]; 0 if all limits are kept.

    Args:
        cell: cell with the limits.
        configurations, velocities: rows (nq,) and rows (nv,); both may be empty.

    Returns:
        The excess; NaN if any row has NaN, so that a broken run never looks perfect.
    """
    x = cell.positions(_table(configurations, cell.nq, "configurations"))
    v = np.abs(_table(velocities, cell.nv, "velocities"))
    excesses = outside(cell.limits, x), v - cell.limits.velocity
    return float(np.max([excess.max(initial=0.0) for excess in excesses]))


# -- runs --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Readings:
    """Errors at every sample of a run, shape (T+1,) unless stated otherwise.

    Attributes:
        eps_p_mm, eps_o_deg: the paper's ε_p [mm] and ε_o [deg].
        chain_mm, chain_deg: largest distance [mm] and angle [deg] between the object poses of any two arms.
        object_mm, object_deg: largest distance [mm] and angle [deg] between any arm's object pose and the path.
        sigma_min: smallest singular value of each arm's tool Jacobian, (T+1, N).
    """

    eps_p_mm: Array
    eps_o_deg: Array
    chain_mm: Array
    chain_deg: Array
    object_mm: Array
    object_deg: Array
    sigma_min: Array


def check_recording(cell: RobotCell, recording: Recording) -> None:
    """Raise InvalidInputError unless the recording fits the cell."""
    q, v, n = recording.q.shape[1], recording.velocity.shape[1], len(recording.T_object_tool)
    if (q, v, n) != (cell.nq, cell.nv, len(cell)):
        raise InvalidInputError(
            f"a recording with nq = {q}, nv = {v} and {n} arms for a cell with nq = {cell.nq}, nv = {cell.nv} and "
            f"{len(cell)} arms",
            "recording",
            "Use the cell that the run was made with.",
        )


def read_run(cell: RobotCell, recording: Recording) -> Readings:
    """Compute the errors of a run at every sample.

    Raises:
        InvalidInputError: the recording is from another cell.
    """
    check_recording(cell, recording)
    read = [read_part(cell, recording, part) for part in recording.parts(len(recording.time))]
    return Readings(*(np.concatenate([getattr(part, field.name) for part in read]) for field in fields(Readings)))


def read_part(cell: RobotCell, recording: Recording, part: slice) -> Readings:
    """:func:`read_run` for some samples of a recording that fits the cell."""
    grasp = recording.grasp
    q, q_command = recording.q[part], recording.q_command[part]
    tools, J = tools_and_jacobians(cell, q_command)
    sigma = _sigma_min(cell, J, tools)
    shift = recording.shift_at(part)
    commanded = without_shift(tools, grasp, shift)
    agreed = held = object_poses(commanded, grasp)
    if not np.array_equal(q, q_command):
        held = held_poses(cell, grasp, q, shift)
    chain_m, chain_rad = gaps(agreed)
    object_m, object_rad = errors_from(held, recording.reference[part])
    return Readings(
        eps_p_mm=1e3 * positioning_errors(commanded, grasp),
        eps_o_deg=np.rad2deg(orientation_errors(chain_rad)),
        chain_mm=1e3 * chain_m.max(axis=1, initial=0.0),
        chain_deg=np.rad2deg(chain_rad.max(axis=1, initial=0.0)),
        object_mm=1e3 * object_m.max(axis=1),
        object_deg=np.rad2deg(object_rad.max(axis=1)),
        sigma_min=sigma,
    )


def _sigma_min(cell: RobotCell, J: Array, tools: Array) -> Array:
    """Smallest singular value of each arm's tool Jacobian (T, N); NaN where a sample is not finite.

    Joints that the arms of a group share count: an arm may be singular by itself where they move it on.
    """
    sigma = np.full((len(J), len(cell)), np.nan)
    good = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(tools).all(axis=(1, 2, 3))
    for k, own in enumerate(cell.columns):
        rows = J[good][:, own]
        rows[..., :3] += cross(rows[..., 3:], tools[good, k, None, :3, 3])
        sigma[good, k] = singular_values(rows)[:, -1]
    return sigma
