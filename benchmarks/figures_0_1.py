"""The figures of a run as version 0.1 computed them: one sample, one pair of arms, one 3-vector at a time.

A reference for the cost and for the values of :func:`coopqp.simulation.read_run`: Pinocchio's placements and frame
Jacobians, and NumPy's SVD, no formula of coopqp.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp import Recording, RobotCell

Array = npt.NDArray[np.float64]
Tools = Sequence[pin.SE3]


def figures_0_1(cell: RobotCell, run: Recording) -> dict[str, Array]:
    """The fields of :class:`coopqp.simulation.Readings` by name."""
    X = tuple(pin.SE3(T) for T in run.T_object_tool)
    commanded, measured = placements(cell, run.q_command), placements(cell, run.q)
    chain = np.array([chain_error(T, X) for T in commanded])
    poses = [pin.SE3(M) for M in run.reference]
    away = np.array(
        [
            np.max([object_error(T, X, pose, k) for k in range(len(X))], axis=0)
            for T, pose in zip(measured, poses, strict=True)
        ]
    )
    return {
        "eps_p_mm": np.array([1e3 * positioning_error(T, X) for T in commanded]),
        "eps_o_deg": np.array([np.rad2deg(orientation_error(T, X)) for T in commanded]),
        "chain_mm": 1e3 * chain[:, 0],
        "chain_deg": np.rad2deg(chain[:, 1]),
        "object_mm": 1e3 * away[:, 0],
        "object_deg": np.rad2deg(away[:, 1]),
        "sigma_min": np.array([sigma_min(cell, q) for q in run.q_command]),
    }


def placements(cell: RobotCell, configurations: Array) -> list[Tools]:
    """T_world_tool of every arm at every configuration."""
    data = cell.model.createData()
    out: list[Tools] = []
    for q in configurations:
        pin.framesForwardKinematics(cell.model, data, q)
        out.append([data.oMf[f].copy() for f in cell.tool_frames])
    return out


def sigma_min(cell: RobotCell, q: Array) -> Array:
    """Smallest singular value of each arm's tool Jacobian (N,)."""
    data = cell.model.createData()
    q = cell.check_configuration(q, "figures_0_1")
    pin.computeJointJacobians(cell.model, data, q)
    _tools = [data.oMi[j] * T for j, T in zip(cell.tool_joints, cell.T_joint_tool, strict=True)]  # unused, but its cost
    jacobians = [pin.getFrameJacobian(cell.model, data, f, pin.LOCAL) for f in cell.tool_frames]
    own = zip(jacobians, cell.v_slices, strict=True)
    return np.array([np.linalg.svd(J[:, s], compute_uv=False)[-1] for J, s in own])


def pairs(n: int) -> Iterator[tuple[int, int]]:
    return ((i, j) for i in range(n) for j in range(i + 1, n))


def angle(R: Array) -> float:
    """Angle of a rotation [rad], accurate near 0 and π."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(0.5 * np.linalg.norm(w), 0.5 * (np.trace(R) - 1.0)))


def positioning_error(T: Tools, X: Tools) -> float:
    """ε_p [m]."""
    total = 0.0
    for i, j in pairs(len(T)):
        p, d = T[i].actInv(T[j]).translation, X[i].actInv(X[j]).translation
        total += float((p - d) @ (p - d))
    return float(np.sqrt(total))


def orientation_error(T: Tools, X: Tools) -> float:
    """ε_o [rad]."""
    total = 0.0
    for i, j in pairs(len(T)):
        R, R_grasp = T[i].actInv(T[j]).rotation, X[i].actInv(X[j]).rotation
        total += angle(R_grasp.T @ R) ** 2
    return float(np.sqrt(total))


def chain_error(T: Tools, X: Tools) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between the object poses of two arms."""
    O: list[Any] = [tool * x.inverse() for tool, x in zip(T, X, strict=True)]
    apart = [(O[i], O[j]) for i, j in pairs(len(O))]
    return (
        float(np.max([0.0, *(np.linalg.norm(a.translation - b.translation) for a, b in apart)])),
        float(np.max([0.0, *(angle(a.rotation.T @ b.rotation) for a, b in apart)])),
    )


def object_error(T: Tools, X: Tools, pose: pin.SE3, arm: int) -> tuple[float, float]:
    """Distance [m] and angle [rad] between the object pose of an arm and the path."""
    O = T[arm] * X[arm].inverse()
    return float(np.linalg.norm(O.translation - pose.translation)), angle(O.rotation.T @ pose.rotation)
