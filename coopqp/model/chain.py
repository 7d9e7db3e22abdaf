"""The closed chain that arms and object form: batched kinematics of the object as every arm carries it.

One :class:`Chain` is a workspace over its own Pinocchio data. Placements and Jacobians are live, strided views of
Pinocchio's memory, and arms of equal joint count are handled in one batch, so a step costs no Python object per arm.

Twists of the object are given in the *reference object frame* R: ``A_k v_k`` is the twist of the object as arm k
carries it. Jacobians ``J_k`` give twists at a point that moves with the object, in world axes: with the origin of R as
that point ``A_k = blockdiag(Rᵀ, Rᵀ) J_k``, for any grasp: the grasp only enters the poses. No singular value
depends on where the world's origin is. See docs/derivations.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.checks import read_only
from coopqp.model.cell import RobotCell, of_cell
from coopqp.model.grasp import Grasp
from coopqp.native.constants import FAR_EDGE, LARGE_INVERSE
from coopqp.spatial import Array, largest, log6_rows

#: Singular values of A_k below this count as this in an inverse: limits and rate keep the command finite.
SINGULAR_FLOOR = 1e-6
_TINIEST = float(np.finfo(float).tiny)


#: Below this the logarithm of an error is its linear part, to rounding [m, rad].
_TINY = 1e-8


def _linear_log() -> Array:
    """Constant (12, 13): a placement's rows [Rᵀ; p] → [e, −e, −trace R], e = [p, vee(R − Rᵀ)/2]."""
    M = np.zeros((12, 13))
    M[9, 0] = M[10, 1] = M[11, 2] = 1.0
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        M[3 * i + j, 3 + axis], M[3 * j + i, 3 + axis] = 0.5, -0.5  # entry 3 i + j holds R[j, i]
    M[:, 6:12] = -M[:, :6]
    M[[0, 4, 8], 12] = -1.0
    return M


_LINEAR_LOG = _linear_log()


def _brackets() -> Array:
    """Constant K (6, 36): ``xᵀ (u K) y`` with u K as (6, 6) is ``u · [x, y]``, [x, y] the bracket of two twists."""
    K = np.zeros((6, 6, 6))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for a, b, sign in ((i, j, 1.0), (j, i, -1.0)):
            K[k, 3 + a, b] = K[k, a, 3 + b] = K[3 + k, 3 + a, 3 + b] = sign
    return K.reshape(6, 36)


_BRACKETS = _brackets()


@dataclass(frozen=True, eq=False)
class _Group:
    """Arms of the same number of joints."""

    joints: int
    arms: Array  # indices of the arms (m,)
    columns: Array  # their velocity coordinates (m, joints)
    scale: Array  # unit of each joint [rad/s or m/s], (m, joints, 1)
    metric: Array  # its square: the metric of redundant arms
    span: slice | None  # the same columns as one slice, where they are contiguous


@dataclass(frozen=True, eq=False)
class _Order:
    """The order of a cell's joints."""

    tools: slice | npt.NDArray[np.int64]  # the joints that carry the tools
    groups: tuple[_Group, ...]
    still: npt.NDArray[np.intp] | None  # velocity coordinates that move no tool
    scale: Array  # unit of each joint [rad/s or m/s], (nv,)


class Chain:
    """Batched kinematics of one cell and grasp.

    Attributes:
        moving_columns: per arm, the velocity coordinates that move its tool; only those count as its joints here.
        redundancy: joints beyond six, summed over the arms.
        deficient: indices of arms with fewer than six joints.
        place: update the joint placements at a configuration.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp = cell, grasp
        self.n_arms, self.nv = len(cell), cell.nv
        data = cell.model.createData()
        pin.computeJointJacobians(cell.model, data, pin.neutral(cell.model))
        # Pinocchio's own functions: a call in between would cost as much as an arm.
        self.place: Callable[[Array], object] = partial(pin.forwardKinematics, cell.model, data)
        self._place_columns = partial(pin.computeJointJacobians, cell.model, data)
        self._placements = _live_placements(cell.model, data)
        # (nv, 6), a live view about the world's origin, and the same about a point; of one joint, J is flat
        self._world_JT = data.J.T.reshape(-1, 6)
        self._JT, self._shift = np.zeros_like(self._world_JT), np.eye(6)
        # O_k = T_world_joint · Y_k with constant Y_k; the transpose suits Pinocchio's column-major memory.
        self.Y_transposed = np.empty((self.n_arms, 4, 4))
        self.shift_grasp(np.zeros((self.n_arms, 6)))
        self.moving_columns = moving_columns(cell)
        order = _order_of(cell)
        self._tools, self._groups, self._still, self.scale = order.tools, order.groups, order.still, order.scale
        self.redundancy = sum(max(g.joints - 6, 0) * len(g.arms) for g in self._groups)
        self.deficient = tuple(int(k) for g in self._groups if g.joints < 6 for k in g.arms)
        self.inverses: list[Array] = []
        self.singular = False

    def shift_grasp(self, shift: Array) -> None:
        """The tools hold the object shifted from now on: ``exp(d_k) X_k`` for each d_k of (N, 6) [m, rad]."""
        placed = zip(self.Y_transposed, self.cell.T_joint_tool, self.grasp.T_object_tool, shift, strict=True)
        for Y, T, X, d in placed:
            Y[:] = (T * X.inverse() * pin.exp6(-d)).homogeneous.T

    # -- poses ---------------------------------------------------------------------------------------------------

    def carried(self, q: Array) -> Array:
        """``O_k`` at ``q`` for every arm, shape (N, 4, 3): rows 0–2 are the rotation transposed, row 3 the origin."""
        self.place(q)
        O: Array = self.Y_transposed @ self._placements[self._tools]
        return O

    def errors(self, O: Array, reference: pin.SE3) -> Array:
        """``e_k = log(R⁻¹ O_k)``, shape (N, 6) [m, rad], from :meth:`carried` and the reference pose R."""
        R, origin = reference.rotation, np.zeros((4, 3))
        origin[3] = reference.translation.dot(R)
        # Rows transposed: (O_Rᵀ) R = (Rᵀ O_R)ᵀ. Of small matrices dot costs half of what @ does.
        D = O.dot(R) - origin
        linear: Array = D.reshape(-1, 12).dot(_LINEAR_LOG)
        if largest(linear) <= _TINY:  # so are all errors, and none is half a turn
            return linear[:, :6]
        return log6_rows(linear, D[:, :3].transpose(0, 2, 1))

    # -- Jacobians -----------------------------------------------------------------------------------------------

    def evaluate(self, q: Array, about: Array) -> None:
        """Jacobians at ``q`` about a point ``about`` (3,) [m], in world axes."""
        self._place_columns(q)
        world = self._world_JT
        x, y, z = about.tolist()
        # [about]×: ω × about is added to the linear part
        self._shift[3, 1], self._shift[3, 2], self._shift[4, 2] = -z, y, -x
        self._shift[4, 0], self._shift[5, 0], self._shift[5, 1] = z, -y, x
        np.dot(world, self._shift, out=self._JT)

    def linearise(self, q: Array, about: Array) -> None:
        """Evaluate the Jacobians at ``q`` about a point and invert them."""
        self.evaluate(q, about)
        self.invert()

    def invert(self) -> None:
        """Invert the Jacobians.

        After it :attr:`inverses` holds, per group, the transposed (weighted pseudo-)inverses (m, 6, joints).
        """
        self.singular = False
        self.inverses = [self._invert(g) for g in self._groups]

    def rows(self) -> Array:
        """Jᵀ (nv, 6) of the last :meth:`evaluate`, a live view."""
        rows: Array = self._JT
        return rows

    def jacobian_rows(self, g: _Group) -> Array:
        """Transposed world Jacobians of a group, (m, joints, 6)."""
        if g.span is not None:
            rows: Array = self._JT[g.span].reshape(-1, g.joints, 6)
        else:
            rows = self._JT[g.columns]
        return rows

    def _invert(self, g: _Group) -> Array:
        JT = self.jacobian_rows(g)
        if g.joints == 6:
            try:
                inverse: Array = np.asarray(np.linalg.inv(JT), dtype=np.float64)
            except np.linalg.LinAlgError:
                return self._floored(g)
            if largest(np.abs(inverse)) < LARGE_INVERSE:
                return inverse
            return self._floored(g)
        return self._least_squares(g) if g.joints < 6 else self._redundant(g)

    def _least_squares(self, g: _Group) -> Array:
        """Inverse on the twists that arms with few joints can do; the rest of a twist is lost."""
        inverse = self._svd_inverse(g)
        self.singular = self.singular or not np.abs(inverse).max() < LARGE_INVERSE
        return inverse

    def _redundant(self, g: _Group) -> Array:
        """Weighted right inverse: least Σ (v_j / scale_j)² among the joint velocities that make the twist."""
        JT = self.jacobian_rows(g)
        weighted = (JT * g.metric).transpose(0, 2, 1)
        try:
            gram = np.linalg.inv(weighted @ JT)
        except np.linalg.LinAlgError:
            return self._floored(g)
        inverse: Array = gram @ weighted
        if largest(np.abs(inverse)) < LARGE_INVERSE:
            return inverse
        return self._floored(g)

    def _floored(self, g: _Group) -> Array:
        """Inverse of arms that are near a singularity."""
        self.singular = True
        return self._svd_inverse(g)

    def _svd_inverse(self, g: _Group) -> Array:
        """Inverse from the singular value decomposition, small singular values floored."""
        JT = self.jacobian_rows(g) * g.scale
        U, s, Vt = np.linalg.svd(JT, full_matrices=False)  # JT (m, joints, 6) = U s Vᵀ
        inverse: Array = np.einsum("mrk,mr,mjr->mkj", Vt, 1.0 / np.maximum(s, SINGULAR_FLOOR), U * g.scale)
        return inverse

    def joint_velocities(self, W: Array, out: Array) -> Array:
        """Joint velocities (nv,) that carry the object at world twists ``W`` (N, 6), one per arm."""
        if self._still is not None:
            out[self._still] = 0.0
        for g, inverse in zip(self._groups, self.inverses, strict=True):
            if self._still is None and len(self._groups) == 1:
                np.matmul(W[:, None, :], inverse, out=out.reshape(self.n_arms, 1, g.joints))
            else:
                out[g.columns] = (W[g.arms, None, :] @ inverse)[:, 0, :]
        return out

    def joint_columns(self, T: Array) -> Array:
        """Joint velocities (nv, c) for c object motions at once.

        ``T`` holds world twists, (6, c) where they are common to all arms, (N, 6, c) where each arm has its own.
        """
        columns = T.shape[-1]
        if self._still is None and len(self._groups) == 1:
            product: Array = self.inverses[0].transpose(0, 2, 1) @ T
            return product.reshape(self.nv, columns)
        out = np.zeros((self.nv, columns))
        for g, inverse in zip(self._groups, self.inverses, strict=True):
            out[g.columns] = inverse.transpose(0, 2, 1) @ (T if T.ndim == 2 else T[g.arms])
        return out

    def twists(self, v: Array) -> Array:
        """World twist of the object as each arm carries it, ``J_k v_k``, shape (N, 6)."""
        out = np.empty((self.n_arms, 6))
        for g in self._groups:
            out[g.arms] = (v[g.columns][:, None, :] @ self.jacobian_rows(g))[:, 0, :]
        return out

    def edges(self) -> Array:
        """Joint motion (nv,) that takes each arm to where its reach ends, to first order [rad or m].

        With the least eigenvalue λ of J Jᵀ and its eigenvector u, joint motion ``v = Jᵀ u`` moves the object
        least, by ``J v = λ u``, and ``h = uᵀ (∂J/∂q v) v`` is how that changes: brackets of the joints' twists. At
        ``−λ/h`` times v the object turns back. Other singularities are passed without: h is 0 there, the edge far.
        """
        out = np.full(self.nv, FAR_EDGE)
        for g in self._groups:
            if g.joints < 6:
                continue
            JT = self.jacobian_rows(g)
            values, vectors = np.linalg.eigh(JT.transpose(0, 2, 1) @ JT)
            least, u = np.maximum(values[:, 0], 0.0), vectors[:, :, :1]
            v = JT @ u  # (m, joints, 1)
            own = v * JT  # twist that each joint makes
            before = own.cumsum(axis=1) - own  # twist of the links before it
            h = np.einsum("kij,kij->k", before @ (u[:, :, 0] @ _BRACKETS).reshape(-1, 6, 6), own)
            size = np.maximum(np.abs(h), least * np.sqrt(least) / FAR_EDGE + _TINIEST)
            out[g.columns] = (-least / np.copysign(size, h))[:, None] * v[:, :, 0]
        return out

    def compliances(self, softness: Array) -> Array:
        """``J_k diag(softness) J_kᵀ``, (N, 6, 6): by how much the object gives way to a wrench on arm k.

        ``softness`` (nv,) is the joints' [rad/(N·m) or m/N]; twists and wrenches are in world axes.
        """
        out = np.empty((self.n_arms, 6, 6))
        for g in self._groups:
            rows = self.jacobian_rows(g)
            out[g.arms] = rows.transpose(0, 2, 1) @ (softness[g.columns][:, :, None] * rows)
        return out

    def null_part(self, v: Array) -> Array:
        """The part of joint velocities ``v`` (nv,) that does not move the object: ``v − A⁺ A v``."""
        out = np.zeros(self.nv)
        for g, inverse in zip(self._groups, self.inverses, strict=True):
            if g.joints > 6:
                u = v[g.columns][:, None, :]
                out[g.columns] = (u - u @ self.jacobian_rows(g) @ inverse)[:, 0, :]
        return out

    def null_basis(self) -> Array:
        """Basis of the motions that leave the object at rest, (nv, redundancy), orthonormal in the joints' units."""
        basis = np.zeros((self.nv, self.redundancy))
        c = 0
        for g in self._groups:
            extra = g.joints - 6
            if extra > 0:
                U = np.linalg.svd(self.jacobian_rows(g) * g.scale)[0]
                for i in range(len(g.arms)):
                    basis[g.columns[i], c : c + extra] = g.scale[i] * U[i, :, 6:]
                    c += extra
        return basis

    def admissible_twists(self, to_reference: Array) -> tuple[Array, list[tuple[int, Array]]]:
        """The object motions that arms with fewer than six joints allow.

        Args:
            to_reference: ``Ad(R⁻¹)`` (6, 6).

        Returns:
            (Z, ranges): orthonormal basis Z (6, d) of the object twists that every arm can follow, in the reference
            frame, and for each deficient arm its index and the projector (6, 6) on its own twists.
        """
        ranges = []
        forbidden = np.zeros((6, 6))
        for g in self._groups:
            if g.joints >= 6:
                continue
            A = to_reference @ self.jacobian_rows(g).transpose(0, 2, 1)
            for i, k in enumerate(g.arms):
                U, s, _ = np.linalg.svd(A[i], full_matrices=False)
                U = U[:, s > SINGULAR_FLOOR]
                P = U @ U.T
                ranges.append((int(k), P))
                forbidden += np.eye(6) - P
        eigenvalues, vectors = np.linalg.eigh(forbidden)
        return vectors[:, eigenvalues < 1e-8], ranges

    def dense(self) -> Array:
        """World Jacobians of all arms as one block-diagonal matrix (6N, nv)."""
        J = np.zeros((6 * self.n_arms, self.nv))
        for g in self._groups:
            rows = self.jacobian_rows(g)
            for i, k in enumerate(g.arms):
                J[6 * k : 6 * k + 6, g.columns[i]] = rows[i].T
        return J


def _live_placements(model: pin.Model, data: pin.Data) -> Array:
    """A strided view of ``data.oMi[1:]``: (joints, 4, 3), rows 0–2 the rotation transposed, row 3 the origin."""
    first = data.oMi[1].rotation
    gap = data.oMi[2].rotation.ctypes.data - first.ctypes.data if model.njoints > 2 else 96
    view = np.lib.stride_tricks.as_strided(first.T, shape=(model.njoints - 1, 4, 3), strides=(gap, 24, 8))
    told = np.array([data.oMi[j].homogeneous.T for j in range(1, model.njoints)])
    if not np.array_equal(view, told[:, :, :3]):
        raise RuntimeError("Pinocchio's memory layout of placements is not the expected one")
    return view


def _spaced(index: npt.NDArray[np.int64]) -> slice | npt.NDArray[np.int64]:
    """Rising indices as a slice where they are evenly spaced: it makes a view, an array copies."""
    steps = np.diff(index, append=index[-1] + 1) if len(index) == 1 else np.diff(index)
    if steps[0] > 0 and (steps == steps[0]).all():
        return slice(int(index[0]), int(index[-1]) + 1, int(steps[0]))
    return index


@of_cell
def moving_columns(cell: RobotCell) -> tuple[npt.NDArray[np.intp], ...]:
    """Per arm, the velocity coordinates that move its tool (a gripper's fingers do not)."""
    columns = []
    for joint in cell.tool_joints:
        chain = [cell.model.joints[j].idx_v for j in cell.model.supports[joint] if j]
        columns.append(np.array(sorted(chain), dtype=np.intp))
    return tuple(columns)


@of_cell
def _order_of(cell: RobotCell) -> _Order:
    moving = moving_columns(cell)
    still = np.setdiff1d(np.arange(cell.nv), np.concatenate(moving))
    groups, scale = _group_arms(cell, moving), np.ones(cell.nv)
    for g in groups:
        scale[g.columns] = g.scale[:, :, 0]
    tools = _spaced(np.array(cell.tool_joints, dtype=np.int64) - 1)
    return _Order(tools, groups, still if still.size else None, read_only(scale))


def _group_arms(cell: RobotCell, moving: tuple[npt.NDArray[np.intp], ...]) -> tuple[_Group, ...]:
    speed = np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0)
    groups = []
    sizes = [len(columns) for columns in moving]
    for n in sorted(set(sizes)):
        arms = np.array([k for k, size in enumerate(sizes) if size == n])
        columns = np.array([moving[k] for k in arms])
        flat = columns.ravel()
        contiguous = bool(np.all(np.diff(flat) == 1)) if len(flat) > 1 else True
        span = slice(int(flat[0]), int(flat[-1]) + 1) if contiguous else None
        # Six-joint arms have one inverse, for any metric.
        scale = speed[columns][:, :, None] if n != 6 else np.ones((len(arms), n, 1))
        groups.append(_Group(n, arms, columns, scale, scale**2, span))
    return tuple(groups)
