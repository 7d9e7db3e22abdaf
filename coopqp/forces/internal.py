"""Internal wrenches: the part of the arms' wrenches that does not move the load, and its estimate by deformations.

A commanded configuration that does not fit the grasp deflects the servos; the object stays rigid. With the servo
stiffness ``Kp`` (diagonal, per joint), arm k lets the object yield by ``C_k = A_k Kp⁻¹ A_kᵀ`` per unit of wrench. The
object settles at ``ō``, where the wrenches ``w_k = K_k (e_k − ō)`` with ``K_k = C_k⁻¹`` cancel.
:meth:`StressModel.estimate` computes them from the commands only. The model is static: it omits the forces of the
servos' velocity gain while the stress changes. :meth:`StressModel.from_servos` reads the stress from the servo
deflection, ``A_k⁻ᵀ Kp (q_cmd − q_meas)``, and :meth:`StressModel.from_torques` from joint torques.

Wrenches are ``[force; torque]`` [N, N·m] of arm k on the object, at the origin and in the axes of the object frame.
:func:`at_tools` transforms them to the tools. Units of the stiffness: N·m/rad (revolute), N/m (prismatic).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_floats, as_vector, one_each, read_only
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import parts
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Array, Placement, as_placement

#: Metric of torques against forces in the load's shares [m]: short, so that forces carry the load where they can.
SHARE_LENGTH = 0.1

#: Largest condition number of an invertible compliance. Beyond it the arm is near a singularity or has few joints.
_LARGEST_CONDITION = 1e10


def internal_wrenches(wrenches: ArrayLike, grasp: Grasp) -> Array:
    """The part of the arms' wrenches that does not move the object, in its frame (…, N, 6) [N, N·m].

    Args:
        wrenches: wrench of each arm on the object, at the origin and in the axes of its tool (…, N, 6) [N, N·m].
        grasp: the placements of the tools.

    Raises:
        InvalidInputError: not one wrench per arm.
    """
    w, n = as_floats(wrenches), len(grasp)
    if w.shape[-2:] != (n, 6):
        raise InvalidInputError(f"wrenches of shape {w.shape}", "internal_wrenches", f"Give one per arm, (…, {n}, 6).")
    to_object, shares = load_shares(grasp)
    internal_of = (np.eye(6 * n) - shares @ np.tile(np.eye(6), n)) @ to_object
    return (w.reshape(-1, 6 * n) @ internal_of.T).reshape(w.shape)


def load_shares(grasp: Grasp) -> tuple[Array, Array]:
    """Maps: wrenches at the tools to the object frame (6 N, 6 N), and S, the load to its shares there (6 N, 6)."""
    n = len(grasp)
    scale = np.tile([1.0] * 3 + [SHARE_LENGTH] * 3, n)
    to_object = np.zeros((6 * n, 6 * n))
    for k, X in enumerate(grasp.T_object_tool):
        to_object[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = X.actionInverse.T
    scaled = to_object.reshape(n, 6, 6 * n).sum(axis=0) * scale  # of full rank: its pseudo-inverse is Aᵀ (A Aᵀ)⁻¹
    shares: Array = to_object @ (scale[:, None] * np.linalg.solve(scaled @ scaled.T, scaled).T)
    return to_object, shares


@dataclass(frozen=True, eq=False)
class InternalStress:
    """An estimate of the wrenches that cancel within the object.

    Attributes:
        wrenches: w_k, the wrench of each arm on the object in the object frame (N, 6) [N, N·m]; their sum is zero.
        errors: e_k, the object pose of arm k relative to the object pose of the first arm, in the object frame (N, 6)
            [m, rad]. Only differences matter: any common reference gives the same wrenches.
        settled: ō, the settled object pose relative to the object pose of the first arm (6,) [m, rad].
    """

    wrenches: Array
    errors: Array
    settled: Array

    @property
    def forces(self) -> Array:
        """Magnitude of the force at each grasp (N,) [N]."""
        return np.asarray(np.linalg.norm(self.wrenches[:, :3], axis=1))

    @property
    def largest(self) -> float:
        """Largest force at a grasp [N]."""
        return float(self.forces.max())


@final
class StressModel:
    """Elastic model of the closed chain: rigid object and links, compliant servos.

    Args:
        cell: the arms.
        grasp: the grasp.
        stiffness: Kp of the joint servos [N·m/rad or N/m], a scalar or one number per joint (nv,), > 0.

    Raises:
        InvalidInputError: a bad stiffness, or a grasp with another number of arms.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, *, stiffness: Any) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp = cell, grasp
        self.stiffness = per_joint(stiffness, cell.nv, "StressModel: stiffness")

    def estimate(self, q_command: ArrayLike, *, T_world_object: Placement | None = None) -> InternalStress:
        """Estimate the stress that a commanded configuration builds up.

        Args:
            q_command: commanded configuration (nq,).
            T_world_object: frame R of the errors and wrenches; by default the object pose of the first arm.

        Raises:
            InvalidInputError: bad configuration or placement.
        """
        state = CellState(self.cell, q_command)
        O = self.grasp.carried(state)
        R = O[0] if T_world_object is None else as_placement(T_world_object, "StressModel: T_world_object")
        to_R = R.actInv(O[0]).action  # errors relative to O₀ are small; then transform to R
        errors = np.array([to_R @ pin.log6(O[0].actInv(o)).vector for o in O])
        compliances = []
        for k, s in enumerate(self.cell.v_slices):
            A = self._twist_map(state, k, R)
            if self.cell.groups:
                A = A[:, np.isin(self.cell.columns[k], self.cell.shared, invert=True)]
            compliances.append((A / self.stiffness[s]) @ A.T)
        wrenches, settled = _equilibrium(np.array(compliances), errors, self._shared_compliance(state, R))
        return InternalStress(wrenches, errors, settled)

    def _shared_compliance(self, state: CellState, R: pin.SE3) -> Array | None:
        """Compliance of the joints that arms share (6 N, 6 N); None without such joints."""
        cell = self.cell
        if not cell.groups:
            return None
        A = np.zeros((len(cell), 6, cell.nv))
        for k, columns in enumerate(cell.columns):
            A[k][:, columns] = self._twist_map(state, k, R)
        B = A[:, :, cell.shared].reshape(-1, len(cell.shared))
        return np.asarray((B / self.stiffness[cell.shared]) @ B.T)

    def history(self, q_commands: ArrayLike) -> Array:
        """Wrenches (T, N, 6) along commanded configurations (T, nq), each as in :meth:`estimate`."""
        rows = np.atleast_2d(np.asarray(q_commands, dtype=float))
        return np.array([self.estimate(q).wrenches for q in rows]).reshape(-1, len(self.cell), 6)

    def from_servos(self, q_command: ArrayLike, q_measured: ArrayLike) -> Array:
        """Wrenches (N, 6) of the arms on the object, from servo deflection; see :meth:`from_torques`.

        At rest the result is exact. In motion it omits the velocity term of the servos and lags by kd/kp.

        Args:
            q_command, q_measured: configurations (nq,) at the same time.
        """
        command = self.cell.check_configuration(q_command, "StressModel.from_servos: q_command")
        measured = self.cell.check_configuration(q_measured, "StressModel.from_servos: q_measured")
        return self.from_torques(measured, self.stiffness * pin.difference(self.cell.model, measured, command))

    def from_torques(self, q_measured: ArrayLike, torques: ArrayLike) -> Array:
        """Wrenches (N, 6) of the arms on the object, from joint torques, in the object frame of the first arm.

        Leave the feed-forward torques (gravity of the arms, shares of the load) out of ``torques``; the wrenches then
        exclude them, too. An arm with fewer than six joints shows only the components that its joints feel. For an arm
        with more joints, and for arms that share some, together, the result is the least-squares solution.

        Args:
            q_measured: measured configuration (nq,).
            torques: joint torques or forces (nv,) [N·m or N].
        """
        state = CellState(self.cell, q_measured)
        torque = as_vector(torques, self.cell.nv, "StressModel.from_torques: torques")
        R = self.grasp.carried(state)[0]
        out = np.empty((len(self.cell), 6))
        for arms in parts(self.cell):
            joints = np.unique(np.concatenate([self.cell.columns[k] for k in arms]))
            A = np.zeros((len(joints), len(arms), 6))
            for i, k in enumerate(arms):
                A[np.searchsorted(joints, self.cell.columns[k]), i] = self._twist_map(state, k, R).T
            felt = np.linalg.lstsq(A.reshape(len(joints), -1), torque[joints], rcond=1e-9)[0]
            out[list(arms)] = felt.reshape(-1, 6)
        return out

    def _twist_map(self, state: CellState, k: int, R: pin.SE3) -> Array:
        """A_k (6, n_k): maps the joint velocities of arm k to the object twist in the frame R."""
        return R.actInv(state.T_world_tool[k]).action @ state.jacobian(k)


def at_tools(wrenches: ArrayLike, grasp: Grasp) -> Array:
    """Transform wrenches (N, 6) on the object from the object frame to each tool's origin and axes."""
    w = np.asarray(wrenches, dtype=float)
    if w.shape != (len(grasp), 6):
        raise InvalidInputError(
            f"wrenches of shape {w.shape}, expected ({len(grasp)}, 6)", "at_tools", "Give one wrench per arm."
        )
    return np.array([X.action.T @ row for X, row in zip(grasp.T_object_tool, w, strict=True)])


def _equilibrium(C: Array, e: Array, shared: Array | None = None) -> tuple[Array, Array]:
    """Wrenches (N, 6) and ō (6,) from compliances (N, 6, 6), and of shared joints (6 N, 6 N), and errors (N, 6)."""
    n = len(C)
    if shared is None and np.linalg.cond(C).max() < _LARGEST_CONDITION:
        K = np.linalg.inv(C)
        settled = np.linalg.solve(K.sum(axis=0), np.einsum("kij,kj->i", K, e))
        return np.einsum("kij,kj->ki", K, e - settled), settled
    # An arm is rigid in some direction, or arms share joints: solve C w + ō = e, Σ w_k = 0, with the least wrenches.
    unit = float(np.trace(C.sum(axis=0))) / (6 * n)  # scales all entries to one magnitude
    M = np.zeros((6 * n + 6, 6 * n + 6))
    if shared is not None:
        M[:-6, :-6] = shared / unit
    for k in range(n):
        rows = slice(6 * k, 6 * k + 6)
        M[rows, rows] += C[k] / unit
        M[rows, 6 * n :] = M[6 * n :, rows] = np.eye(6)
    x = np.linalg.lstsq(M, np.concatenate([e.ravel(), np.zeros(6)]), rcond=1e-12)[0]
    return x[: 6 * n].reshape(n, 6) / unit, x[6 * n :]


def per_joint(value: Any, n: int, where: str) -> Array:
    """Stiffness of each joint (n,) from one number or n, finite and > 0."""
    out = one_each(value, n, where)
    if not (out > 0.0).all():
        raise InvalidInputError(f"{out.tolist()} must be > 0", where, "Give the servos' stiffness.")
    return read_only(out)
