"""Kinematics of the closed chain, by Pinocchio's frames alone: docs/derivations.md, "The closed chain".

Jacobians J_k give the twist of the object, as arm k carries it, at the origin of the reference pose R, in world axes;
``A_k = Ad(R⁻¹) J_k`` gives it in the axes of R.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

Array = Any


class ClosedChain:
    """Arms of a cell that hold one object.

    Args:
        cell: the arms; only its Pinocchio model, the frames of its tools and its limits are used.
        T_object_tool: places of the tools on the object, one for each arm.

    Attributes:
        columns: of each arm, the joints that move its tool.
        parts: arms that share joints, together, and all others alone: what is inverted by itself.
        units: of the joints, in which least motion is measured (nv,): their speeds where a part has joints to spare.
    """

    def __init__(self, cell: Any, T_object_tool: Sequence[pin.SE3]) -> None:
        self.model, self.frames, self.X = cell.model, list(cell.tool_frames), list(T_object_tool)
        self.data, self.nv, self.n = cell.model.createData(), cell.model.nv, len(self.frames)
        self.columns = [self._supports(frame) for frame in self.frames]
        self.parts = self._parts()
        self.units, speed = np.ones(self.nv), np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0)
        for part in self.parts:
            joints = self.joints(part)
            if len(joints) != 6 * len(part):
                self.units[joints] = speed[joints]

    def _supports(self, frame: int) -> list[int]:
        joint = self.model.frames[frame].parentJoint
        return sorted(self.model.joints[j].idx_v for j in self.model.supports[joint] if j)

    def _parts(self) -> list[list[int]]:
        parts: list[list[int]] = []
        for k, columns in enumerate(self.columns):
            same = [p for p in parts if any(set(columns) & set(self.columns[j]) for j in p)]
            parts = [p for p in parts if p not in same] + [[j for p in same for j in p] + [k]]
        return sorted(sorted(p) for p in parts)

    def joints(self, part: Sequence[int]) -> list[int]:
        """The joints that move the tools of a part."""
        return sorted({j for k in part for j in self.columns[k]})

    def moved(self, q: Array, way: Array) -> Array:
        """The configuration (nq,) after ways (nv,) of the joints [rad or m]."""
        return pin.integrate(self.model, q, way)

    def positions(self, q: Array) -> Array:
        """One position of each joint (nv,): an angle where q has a cosine and a sine."""
        x = np.empty(self.nv)
        for joint in self.model.joints[1:]:
            own = q[joint.idx_q : joint.idx_q + joint.nq]
            x[joint.idx_v] = np.arctan2(own[1], own[0]) if joint.nq == 2 else own[0]
        return x

    def carried(self, q: Array) -> list[pin.SE3]:
        """O_k, the object in the world as each arm carries it."""
        pin.framesForwardKinematics(self.model, self.data, q)
        return [self.data.oMf[f] * X.inverse() for f, X in zip(self.frames, self.X, strict=True)]

    def tool_jacobians(self, q: Array) -> list[Array]:
        """Jacobian (6, nv) of each tool at its own origin, in world axes."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        return [pin.getFrameJacobian(self.model, self.data, f, pin.LOCAL_WORLD_ALIGNED) for f in self.frames]

    def jacobians(self, q: Array, about: Array) -> Array:
        """J_k at a point that moves with the object and is now at ``about`` (3,), in world axes (N, 6, nv)."""
        J = np.array(self.tool_jacobians(q))
        for k, f in enumerate(self.frames):
            lever = about - self.data.oMf[f].translation
            J[k, :3] -= pin.skew(lever) @ J[k, 3:]
        return J

    def stacked(self, J: Array, part: Sequence[int]) -> Array:
        """The rows of all arms of a part, and its joints' columns (6 K, n)."""
        return J[list(part)].reshape(6 * len(part), -1)[:, self.joints(part)]

    def least_motion(self, J: Array, twists: Array) -> Array:
        """Joint velocities (nv, c) of least Σ (v_j / unit_j)² that make world twists (N, 6, c) of the object."""
        v = np.zeros((self.nv, twists.shape[2]))
        for part in self.parts:
            joints = self.joints(part)
            D = self.units[joints]
            U, s, Vt = np.linalg.svd(self.stacked(J, part) * D, full_matrices=False)
            wanted = twists[part].reshape(6 * len(part), -1)
            v[joints] = D[:, None] * (Vt.T @ ((U.T @ wanted) / np.maximum(s, 1e-6)[:, None]))
        return v

    def null_space(self, J: Array) -> Array:
        """Motions that leave the object at rest (nv, r), orthonormal in the joints' units."""
        basis = []
        for part in self.parts:
            joints = self.joints(part)
            A = self.stacked(J, part) * self.units[joints]
            for row in np.linalg.svd(A)[2][len(A) :]:
                basis.append(np.zeros(self.nv))
                basis[-1][joints] = self.units[joints] * row
        return np.array(basis).T.reshape(self.nv, len(basis))

    def followed(self, A: Array) -> list[tuple[int, Array]]:
        """Of arms with fewer than six joints: index, and projector (6, 6) on the twists that they can follow."""
        found = []
        for k, columns in enumerate(self.columns):
            if len(columns) < 6:
                U, s, _ = np.linalg.svd(A[k][:, columns], full_matrices=False)
                found.append((k, U[:, s > 1e-6] @ U[:, s > 1e-6].T))
        return found


def errors(O: Sequence[pin.SE3], R: pin.SE3) -> Array:
    """e_k = log(R⁻¹ O_k) of each arm (N, 6)."""
    return np.array([pin.log6(R.actInv(own)).vector for own in O])


def closing(twists: Array, ranges: Sequence[tuple[int, Array]]) -> Array:
    """Twists of the arms (N, 6), moved by the common one that brings them best into what each can follow."""
    lost = [(k, np.eye(6) - P) for k, P in ranges]
    w = -np.linalg.pinv(sum(L for _, L in lost), rcond=1e-3, hermitian=True) @ sum(L @ twists[k] for k, L in lost)
    moved = twists + w
    for k, P in ranges:
        moved[k] = P @ moved[k]
    return moved
