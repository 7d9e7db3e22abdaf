"""Errors of a run over time, from its recording only.

The errors between the arms use the *commanded* configurations: once the object is gripped, servo deflection hides these
errors in the measured ones. The object pose uses the *measured* ones.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from coopqp.errors import InvalidInputError
from coopqp.model.batch import singular_values
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array, cross


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
    samples = len(recording.time)
    errors: dict[str, Array] = {}
    for part in recording.parts(samples):
        read = read_part(cell, recording, part)
        for name in (field.name for field in fields(Readings)):
            values = getattr(read, name)
            errors.setdefault(name, np.empty((samples, *values.shape[1:])))[part] = values
    return Readings(**errors)


def read_part(cell: RobotCell, recording: Recording, part: slice) -> Readings:
    """:func:`read_run` for some samples of a recording that fits the cell."""
    grasp = recording.grasp
    q, q_command = recording.q[part], recording.q_command[part]
    tools, J = metrics.tools_and_jacobians(cell, q_command)
    sigma = _sigma_min(cell, J, tools)
    shift = recording.shift_at(part)
    commanded = metrics.without_shift(tools, grasp, shift)
    agreed = held = metrics.object_poses(commanded, grasp)
    if not np.array_equal(q, q_command):
        held = metrics.object_poses(metrics.without_shift(metrics.tool_matrices(cell, q), grasp, shift), grasp)
    chain_m, chain_rad = metrics.gaps(agreed)
    object_m, object_rad = metrics.errors_from(held, recording.reference[part])
    return Readings(
        eps_p_mm=1e3 * metrics.positioning_errors(commanded, grasp),
        eps_o_deg=np.rad2deg(metrics.orientation_errors(chain_rad)),
        chain_mm=1e3 * chain_m.max(axis=1, initial=0.0),
        chain_deg=np.rad2deg(chain_rad.max(axis=1, initial=0.0)),
        object_mm=1e3 * object_m.max(axis=1),
        object_deg=np.rad2deg(object_rad.max(axis=1)),
        sigma_min=sigma,
    )


def _sigma_min(cell: RobotCell, J: Array, tools: Array) -> Array:
    """Smallest singular value of each arm's tool Jacobian (T, N); NaN where its entries (T, nv, 6) are not finite.

    Joints that the arms of a group share count: an arm may be singular by itself where they move it on.
    """
    sigma = np.full((len(J), len(cell)), np.nan)
    good = np.isfinite(J).all(axis=(1, 2))
    for k, own in enumerate(cell.columns):
        rows = J[good][:, own]
        first = [cell.arm_of_joint(j) for j in own]
        if any(other != k for other in first):
            points = tools[good][:, :, :3, 3]
            rows[..., :3] += cross(rows[..., 3:], points[:, k, None] - points[:, first])
        sigma[good, k] = singular_values(rows)[:, -1]
    return sigma
