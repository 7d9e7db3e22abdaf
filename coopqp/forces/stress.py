"""Internal stress without a sensor: what the arms press into the object, from joint positions and servo stiffness.

A commanded configuration that does not fit the grasp bends the servos, not the object. With the servo stiffness
``Kp`` (diagonal, per joint) the object as arm k carries it gives way by ``C_k = A_k Kp⁻¹ A_kᵀ`` per unit of wrench,
so the object settles at ``ō`` where the wrenches ``w_k = K_k (e_k − ō)``, ``K_k = C_k⁻¹``, cancel. This is what
:meth:`StressModel.estimate` computes, from commands alone. It is a static model: while the stress changes, what the
servos' velocity gain adds is left out. :meth:`StressModel.from_servos` reads the stress from the servo deflection
instead, ``A_k⁻ᵀ Kp (q_cmd − q_meas)``, :meth:`StressModel.from_torques` from joint torques.

Wrenches are ``[force; torque]`` [N, N·m], what arm k does to the object, at the origin and in the axes of the object
frame; :func:`at_tools` carries them to the tools. Units of the stiffness: N·m/rad (revolute), N/m (prismatic).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_floats, as_vector, read_only
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Array, Placement, as_placement

#: A compliance worse conditioned than this is not inverted: the arm is near a singularity, or has few joints.
_LARGEST_CONDITION = 1e10


@dataclass(frozen=True, eq=False)
class InternalStress:
    """An estimate of the wrenches that cancel within the object.

    Attributes:
        wrenches: w_k, (N, 6) [N, N·m], of each arm on the object, in the object frame; they sum to zero.
        errors: e_k, (N, 6) [m, rad]: where arm k would carry the object, from where the first arm would; in the
            object frame. (Only differences count, so any common reference serves.)
        settled: ō, (6,) [m, rad]: where the object settles between them, likewise.
    """

    wrenches: Array
    errors: Array
    settled: Array

    @property
    def forces(self) -> Array:
        """Size of the force at each grasp, (N,) [N]."""
        return np.asarray(np.linalg.norm(self.wrenches[:, :3], axis=1))

    @property
    def largest(self) -> float:
        """Largest force at a grasp [N]."""
        return float(self.forces.max())


@final
class StressModel:
    """Elastic model of the closed chain: stiff object and links, compliant servos.

    Args:
        cell: the arms.
        grasp: where they hold the object.
        stiffness: Kp of the joint servos [N·m/rad or N/m], a scalar or one number per joint (nv,), > 0.

    Raises:
        InvalidInputError: a bad stiffness, or a grasp of another number of arms.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, *, stiffness: Any) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp = cell, grasp
        self.stiffness = _per_joint(stiffness, cell.nv, "StressModel: stiffness")

    def estimate(self, q_command: Any, *, T_world_object: Placement | None = None) -> InternalStress:
        """Stress that a commanded configuration (nq,) builds up.

        Args:
            q_command: commanded configuration.
            T_world_object: frame R that errors and wrenches are given in; where the first arm carries the object by
                default.

        Raises:
            InvalidInputError: bad configuration or placement.
        """
        state = CellState(self.cell, q_command)
        O = self.grasp.carried(state)
        R = O[0] if T_world_object is None else as_placement(T_world_object, "StressModel: T_world_object")
        to_R = R.actInv(O[0]).action  # errors from O₀, where they are small, then carried to R
        errors = np.array([to_R @ pin.log6(O[0].actInv(o)).vector for o in O])
        compliances = []
        for k, s in enumerate(self.cell.v_slices):
            A = self._twist_map(state, k, R)
            compliances.append((A / self.stiffness[s]) @ A.T)
        wrenches, settled = _equilibrium(np.array(compliances), errors)
        return InternalStress(wrenches, errors, settled)

    def history(self, q_commands: Any) -> Array:
        """Wrenches (T, N, 6) along commanded configurations (T, nq); row by row as :meth:`estimate`."""
        rows = np.atleast_2d(np.asarray(q_commands, dtype=float))
        return np.array([self.estimate(q).wrenches for q in rows]).reshape(-1, len(self.cell), 6)

    def from_servos(self, q_command: Any, q_measured: Any) -> Array:
        """Wrenches (N, 6) of the arms on the object, from servo deflection; see :meth:`from_torques`.

        At rest this is exact. In motion the servos' velocity term is left out: the reading lags by kd/kp.

        Args:
            q_command, q_measured: configurations (nq,) at the same time.
        """
        command = self.cell.check_configuration(q_command, "StressModel.from_servos: q_command")
        measured = self.cell.check_configuration(q_measured, "StressModel.from_servos: q_measured")
        return self.from_torques(measured, self.stiffness * pin.difference(self.cell.model, measured, command))

    def from_torques(self, q_measured: Any, torques: Any) -> Array:
        """Wrenches (N, 6) of the arms on the object that joint torques hold up, in the first arm's object frame.

        What is fed forward to the servos (gravity of the arms, a share of the load) is to be left out of the torques,
        and then of the wrenches. An arm with fewer than six joints shows only what its joints feel; with more, the
        answer is that of least squares.

        Args:
            q_measured: configuration (nq,).
            torques: of the joints (nv,) [N·m or N].
        """
        state = CellState(self.cell, q_measured)
        torque = as_vector(torques, self.cell.nv, "StressModel.from_torques: torques")
        R = self.grasp.carried(state)[0]
        return np.array(
            [
                np.linalg.lstsq(self._twist_map(state, k, R).T, torque[s], rcond=1e-9)[0]
                for k, s in enumerate(self.cell.v_slices)
            ]
        )

    def _twist_map(self, state: CellState, k: int, R: pin.SE3) -> Array:
        """A_k (6, n_k): joint velocities of arm k to the twist of the object it carries, in the frame R."""
        A: Array = R.actInv(state.T_world_tool[k]).action @ state.jacobian(k)
        return A


def at_tools(wrenches: Any, grasp: Grasp) -> Array:
    """Wrenches (N, 6) on the object, given in the object frame, at each tool's origin in the tool's own axes."""
    w = np.asarray(wrenches, dtype=float)
    if w.shape != (len(grasp), 6):
        raise InvalidInputError(
            f"wrenches of shape {w.shape}, expected ({len(grasp)}, 6)", "at_tools", "Give one wrench per arm."
        )
    return np.array([X.action.T @ row for X, row in zip(grasp.T_object_tool, w, strict=True)])


def _equilibrium(C: Array, e: Array) -> tuple[Array, Array]:
    """Wrenches (N, 6) and ō (6,) from compliances (N, 6, 6) and errors (N, 6)."""
    n = len(C)
    if np.linalg.cond(C).max() < _LARGEST_CONDITION:
        K = np.linalg.inv(C)
        settled = np.linalg.solve(K.sum(axis=0), np.einsum("kij,kj->i", K, e))
        return np.einsum("kij,kj->ki", K, e - settled), settled
    # Some arm is rigid in a direction: solve C_k w_k + ō = e_k, Σ w_k = 0; the least wrench where it is undetermined.
    unit = float(np.trace(C.sum(axis=0))) / (6 * n)  # so that all entries are of one size
    M = np.zeros((6 * n + 6, 6 * n + 6))
    for k in range(n):
        rows = slice(6 * k, 6 * k + 6)
        M[rows, rows] = C[k] / unit
        M[rows, 6 * n :] = M[6 * n :, rows] = np.eye(6)
    x = np.linalg.lstsq(M, np.concatenate([e.ravel(), np.zeros(6)]), rcond=1e-12)[0]
    return x[: 6 * n].reshape(n, 6) / unit, x[6 * n :]


def _per_joint(value: Any, n: int, where: str) -> Array:
    try:
        out = np.array(np.broadcast_to(as_floats(value), (n,)))
    except NOT_NUMBERS as error:
        raise InvalidInputError("cannot be read as numbers", where, f"Give one number or {n}.") from error
    if not (np.isfinite(out).all() and (out > 0.0).all()):
        raise InvalidInputError(f"{out.tolist()} must be finite and > 0", where, "Give the servos' stiffness.")
    return read_only(out)
