"""The closed chain that arms and object form: kinematics of the object as every arm carries it.

Twists of the object are given in the *reference object frame* R: ``A_k v_k`` is the twist of the object as arm k
carries it. Jacobians ``J_k`` give twists at a point that moves with the object, in world axes: with the origin of R as
that point ``A_k = blockdiag(Rᵀ, Rᵀ) J_k``, for any grasp: the grasp only enters the poses. No singular value
depends on where the world's origin is. See docs/derivations.md; the core's counterpart is ``chain.cpp``.

Arms that share joints are one redundant arm, whose tools are those of all of them: its Jacobian has the rows of every
arm of the group, its least motion the least ``Σ (v_j / scale_j)²`` of all their joints, each counted once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.checks import read_only
from coopqp.core._core import LARGE_INVERSE, SINGULAR_FLOOR
from coopqp.model.cell import RobotCell, of_cell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array, twist_at


class Chain:
    """Kinematics of one cell and grasp; a workspace: each configuration replaces the one before.

    Attributes:
        moving_columns: per arm, the velocity coordinates that move its tool; only those count as its joints here.
        parts: what moves by itself: the arms of each group that share joints, and every other arm alone.
        part_columns: per part, the velocity coordinates that move its tools.
        scale: unit of each joint, its largest speed (nv,) [rad/s or m/s]; 1 for arms with six joints, whose inverse
            does not depend on it.
        redundancy: joints beyond six for each arm, summed over the parts.
        deficient: indices of arms with fewer than six joints.
        apart: indices of arms that follow their joints' own way and move no object: all their motion is null-space
            motion, and their view of the object is that of another arm.
        jacobians: J_k of each arm (6, n_k), after :meth:`evaluate`.
        inverses: (pseudo-)inverses of the parts' Jacobians (n, 6 K), K arms, after :meth:`invert`.
        singular: an arm was near a singularity there.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp = cell, grasp
        self.n_arms, self.nv = len(cell), cell.nv
        self._data = cell.model.createData()
        placed = zip(cell.T_joint_tool, grasp.T_object_tool, strict=True)
        self._held = [T * X.inverse() for T, X in placed]  # before the tools move on the object
        self._moved: Sequence[pin.SE3] = [pin.SE3.Identity()] * self.n_arms
        self.shift_grasp(np.zeros((self.n_arms, 6)))
        self.moving_columns, self.parts, self.part_columns = moving_columns(cell), parts(cell), part_columns(cell)
        self.scale = _joint_units(cell)
        self.redundancy = sum(self.further)
        self.apart: tuple[int, ...] = ()
        self.jacobians: list[Array] = []
        self.inverses: list[Array] = []
        self.singular = False

    @property
    def _parts_apart(self) -> list[int]:
        return [i for i, part in enumerate(self.parts) if part[0] in self.apart]

    @property
    def further(self) -> list[int]:
        """Joints of each part that its tools do not need."""
        return [max(len(c) - 6 * len(part), 0) for part, c in zip(self.parts, self.part_columns, strict=True)]

    @property
    def deficient(self) -> tuple[int, ...]:
        """See above."""
        return tuple(k for k, c in enumerate(self.moving_columns) if len(c) < 6 and k not in self.apart)

    def shift_grasp(self, shift: Array) -> None:
        """The tools hold the object shifted from now on: ``exp(d_k) M_k X_k`` for each d_k of (N, 6) [m, rad]."""
        self._shifted_by = [pin.exp6(-d) for d in shift]
        self.place(self._moved)

    def place(self, moved: Sequence[pin.SE3]) -> None:
        """The tools are at ``exp(d_k) M_k X_k`` from now on, with M_k of each arm in the object frame."""
        self._moved = moved
        placed = zip(self._held, moved, self._shifted_by, strict=True)
        self._T_joint_object = [Y * M.inverse() * back for Y, M, back in placed]

    # -- poses ---------------------------------------------------------------------------------------------------

    def carried(self, q: Array) -> list[pin.SE3]:
        """``O_k`` at ``q``: the pose of the object in the world as each arm carries it."""
        pin.forwardKinematics(self.cell.model, self._data, q)
        O = [self._data.oMi[j] * Y for j, Y in zip(self.cell.tool_joints, self._T_joint_object, strict=True)]
        for k in self.apart:
            O[k] = O[next(i for i in range(self.n_arms) if i not in self.apart)]
        return O

    @staticmethod
    def errors(O: Sequence[pin.SE3], reference: pin.SE3) -> Array:
        """``e_k = log(R⁻¹ O_k)``, shape (N, 6) [m, rad], from :meth:`carried` and the reference pose R."""
        return np.array([pin.log6(reference.actInv(own)).vector for own in O])

    # -- Jacobians -----------------------------------------------------------------------------------------------

    def evaluate(self, q: Array, about: Array) -> None:
        """Jacobians at ``q`` about a point ``about`` (3,) [m], in world axes."""
        J = pin.computeJointJacobians(self.cell.model, self._data, q).reshape(6, -1)  # flat for one joint
        J = twist_at(J, about)
        self.jacobians = [J[:, columns] for columns in self.moving_columns]
        for k in self.apart:
            self.jacobians[k] = np.zeros_like(self.jacobians[k])

    def linearise(self, q: Array, about: Array) -> None:
        """Evaluate the Jacobians at ``q`` about a point and invert them."""
        self.evaluate(q, about)
        self.invert()

    def part_jacobian(self, i: int) -> Array:
        """The Jacobian of a part (6 K, n): of its arm, or of all arms of its group one below the other."""
        return self.stacked(i, self.jacobians)

    def stacked(self, i: int, own: Sequence[Array]) -> Array:
        """Matrices (6, n_k) of all arms, or other rows per joint of theirs, as one for part ``i`` (6 K, n)."""
        arms = self.parts[i]
        if len(arms) == 1:
            return own[arms[0]]
        columns = self.part_columns[i]
        rows = np.zeros((len(arms), len(own[arms[0]]), len(columns)))
        for block, k in zip(rows, arms, strict=True):
            block[:, np.searchsorted(columns, self.moving_columns[k])] = own[k]
        return rows.reshape(-1, len(columns))

    def invert(self) -> None:
        """Invert the Jacobians.

        More joints than the tools need take the least Σ (v_j / scale_j)² that makes a twist; fewer follow a part of it.
        """
        units = [self.scale[columns] for columns in self.part_columns]
        self.inverses = [_inverse(self.part_jacobian(i), unit) for i, unit in enumerate(units)]
        for i in self._parts_apart:
            self.inverses[i] = np.zeros_like(self.inverses[i])
        self.singular = not all(np.abs(inverse).max() < LARGE_INVERSE for inverse in self.inverses)

    def joint_velocities(self, W: Array) -> Array:
        """Joint velocities (nv,) that carry the object at world twists ``W`` (N, 6), one per arm."""
        return self.joint_columns(W[:, :, None])[:, 0]

    def joint_columns(self, T: Array) -> Array:
        """Joint velocities (nv, c) for c object motions at once.

        ``T`` holds world twists, (6, c) where they are common to all arms, (N, 6, c) where each arm has its own.
        """
        out = np.zeros((self.nv, T.shape[-1]))
        own_twists = np.broadcast_to(T, (self.n_arms, *T.shape[-2:]))
        for arms, columns, inverse in zip(self.parts, self.part_columns, self.inverses, strict=True):
            twists = own_twists[arms[0]] if len(arms) == 1 else own_twists[list(arms)].reshape(6 * len(arms), -1)
            out[columns] = inverse @ twists
        return out

    def twists(self, v: Array) -> Array:
        """World twist of the object as each arm carries it, ``J_k v_k``, shape (N, 6)."""
        return np.array([J @ v[columns] for J, columns in zip(self.jacobians, self.moving_columns, strict=True)])

    def dense(self) -> Array:
        """World Jacobians of all arms as one block-diagonal matrix (6N, nv)."""
        out = np.zeros((self.n_arms, 6, self.nv))
        for k, (J, columns) in enumerate(zip(self.jacobians, self.moving_columns, strict=True)):
            out[k][:, columns] = J
        return out.reshape(-1, self.nv)

    def compliances(self, softness: Array) -> Array:
        """``J_k diag(softness) J_kᵀ``, (N, 6, 6): by how much the object gives way to a wrench on arm k.

        ``softness`` (nv,) is the joints' [rad/(N·m) or m/N]; twists and wrenches are in world axes. Joints that arms
        share are left out: see :meth:`shared_compliance`.
        """
        own = softness
        if self.cell.groups:
            own = softness.copy()
            own[self.cell.shared] = 0.0
        pairs = zip(self.jacobians, self.moving_columns, strict=True)
        return np.array([(J * own[columns]) @ J.T for J, columns in pairs])

    def shared_compliance(self, softness: Array, R: Array | None = None) -> Array | None:
        """The same of joints that arms share, (6 N, 6 N): arms k give way to wrenches on arms j; None without any.

        Twists and wrenches are in world axes, or in those of R (6, 6), of twists.
        """
        joints = self.cell.shared
        if not len(joints):
            return None
        J = self.dense()[:, joints]
        if R is not None:
            J = (R.T @ J.reshape(-1, 6, len(joints))).reshape(J.shape)
        return np.asarray((J * softness[joints]) @ J.T)

    def null_part(self, v: Array) -> Array:
        """The part of joint velocities ``v`` (nv,) that does not move the object: ``v − A⁺ A v``."""
        out = np.zeros(self.nv)
        for i, (inverse, columns) in enumerate(zip(self.inverses, self.part_columns, strict=True)):
            if self.further[i] or self.parts[i][0] in self.apart:
                out[columns] = v[columns] - inverse @ (self.part_jacobian(i) @ v[columns])
        return out


def _inverse(J: Array, unit: Array) -> Array:
    """Inverse (n, 6) of J (6, n), of least norm in the joints' units (n,); small singular values count as the floor."""
    U, s, Vt = np.linalg.svd(J * unit, full_matrices=False)
    return unit[:, None] * Vt.T / np.maximum(s, SINGULAR_FLOOR) @ U.T


@of_cell
def moving_columns(cell: RobotCell) -> tuple[npt.NDArray[np.intp], ...]:
    """Per arm, the velocity coordinates that move its tool (a gripper's fingers do not)."""
    columns = []
    for joint in cell.tool_joints:
        chain = [cell.model.joints[j].idx_v for j in cell.model.supports[joint] if j]
        columns.append(np.array(sorted(chain), dtype=np.intp))
    return tuple(columns)


def parts(cell: RobotCell) -> tuple[tuple[int, ...], ...]:
    """What moves by itself: the arms of each group that share joints, and every other arm alone, by its first arm."""
    grouped = {k for group in cell.groups for k in group}
    return tuple(sorted([*cell.groups, *((k,) for k in range(len(cell)) if k not in grouped)]))


@of_cell
def part_columns(cell: RobotCell) -> tuple[npt.NDArray[np.intp], ...]:
    """Per part, the velocity coordinates that move its tools."""
    columns = moving_columns(cell)
    return tuple(np.unique(np.concatenate([columns[k] for k in part])) for part in parts(cell))


@of_cell
def _joint_units(cell: RobotCell) -> Array:
    speed = np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0)
    units = np.ones(cell.nv)
    for part, columns in zip(parts(cell), part_columns(cell), strict=True):
        if len(columns) != 6 * len(part):
            units[columns] = speed[columns]
    return read_only(units)
