"""Torque-controlled drives: computed torque, and an observer of the errors of the drives' model.

Of the arms the drives know a mass matrix M̂(q) and ĥ(q, q̇) (Coriolis, centrifugal, gravity), and of the load the
wrenches ŵ that the tools should exert. With the tracking error e = q_ref − q the law is

    τ = M̂ (q̈_ref + 2ω ė + ω² e) + ĥ + Jᵀŵ − d̃.

An exact model leaves ë + 2ω ė + ω² e = 0 of an arm by itself. The observer filters the torque d that inverse
dynamics miss,

    d = M̂ q̈ + ĥ − (τ − Jᵀŵ),    d/dt d̂ = K (d − d̂),

with the time constant 1/K: wrong masses, friction, a load of another mass, and forces between the arms.

Arms on one object must not resist all of it. Forces between them move no joint, so integrators in the drives would wind
up on the first geometric error. Let c be the wrenches that the tools feel beyond ŵ. The drives leave the internal part
of c (:func:`coopqp.forces.internal_wrenches`) alone:

    d̃ = d̂ − Jᵀ internal(ĉ).

Without wrist sensors c is read from the joints, c = J̄ᵀ d (J̄ dynamically consistent). An arm whose weight is wrong then
counts as squeezing: its joints cannot tell. With sensors c = ŵ − w is measured: d − Jᵀc is then the error of the arm's
own model, which its own drives compensate.

Sources: Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, ch. 9; De Luca, Albu-Schäffer, Haddadin, Hirzinger
(2006), the observer of generalized momentum, here with M̂ q̈ by differences; Khatib (1987) for J̄.
"""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.forces.internal import internal_wrenches
from coopqp.model.cell import RobotCell
from coopqp.model.chain import part_columns, parts
from coopqp.model.grasp import Grasp
from coopqp.simulation.plants.physics_options import PhysicsOptions
from coopqp.spatial import Array

#: Smallest mobility of a tool, against the largest one, in which a wrench is read from torques.
_MOVABLE = 1e-6


@final
class TorqueDrives:
    """The law of torque-controlled drives, for all arms of a cell.

    Args:
        cell, grasp: the arms and the placements of their tools on the object, as the drives know them.
        options: ``servo``, bandwidths, ``wrist_sensors``, ``assumed_mass`` and gravity.
        armature: inertia of the drives at the joints (nv,), which they know.
        limits: largest torques (nv,); inf for none.

    Attributes:
        disturbance: d̂ (nv,) [N·m or N]; stays zero with ``"computed torque"``.
        feedback: the part of the last torques that is no feed-forward, M̂ (2ω ė + ω² e) − d̃ (nv,).
        limited: whether the last torques were cut to their limits (nv,).
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, options: PhysicsOptions, armature: Array, limits: Array) -> None:
        self._cell, self._grasp, self._armature, self._limits = cell, grasp, armature, limits
        self._rate, self._bandwidth = options.loop_bandwidth, options.observer_bandwidth
        self._observes, self._senses = options.servo == "disturbance observer", options.wrist_sensors
        self._model = cell.model.copy()
        for i, inertia in enumerate(cell.model.inertias):
            if inertia.mass > 0.0:  # the parameters, mass first, are multiples of it
                parameters = options.assumed_mass * inertia.toDynamicParameters()
                self._model.inertias[i] = pin.Inertia.FromDynamicParameters(parameters)
        self._model.gravity.linear = np.array(options.gravity) * bool(options.gravity_compensation)
        self._data = self._model.createData()
        #: What moves by itself: arms, and their joints.
        self._parts = [
            (arms, cell.v_slices[arms[0]] if len(arms) == 1 else columns)
            for arms, columns in zip(parts(cell), part_columns(cell), strict=True)
        ]
        n = len(cell)
        on_object = internal_wrenches(np.eye(6 * n).reshape(-1, n, 6), grasp)
        at_tools = [on_object[:, k] @ X.action for k, X in enumerate(grasp.T_object_tool)]
        self._internal = np.hstack(at_tools).T  # wrenches at the tools (6 N,) to their internal part there
        self.reset()

    def reset(self) -> None:
        """Forget what was observed."""
        n = self._cell.nv
        self.disturbance, self.feedback, self.limited = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
        self._felt, self._resisted = np.zeros((len(self._cell), 6)), np.zeros(n)
        self._before: tuple[Array, ...] | None = None

    def model_at(self, q: Array, v: Array) -> tuple[Array, Array]:
        """M̂ (nv, nv), the drives' inertia included, and ĥ (nv,) at a configuration (nq,) and velocities (nv,)."""
        upper = np.triu(pin.crba(self._model, self._data, q))
        M: Array = upper + np.triu(upper, 1).T + np.diag(self._armature)
        return M, np.array(pin.nonLinearEffects(self._model, self._data, q, v))

    def torque(self, q: Array, v: Array, error: Array, error_rate: Array, acceleration: Array, load: Array) -> Array:
        """τ (nv,) [N·m or N], within the limits.

        Args:
            q, v: measured configuration (nq,) and velocities (nv,).
            error, error_rate: e and ė (nv,).
            acceleration: q̈_ref (nv,).
            load: Jᵀŵ (nv,).
        """
        M, h = self.model_at(q, v)
        w = self._rate
        self.feedback = M @ (2.0 * w * error_rate + w * w * error) - self._resisted
        asked = M @ acceleration + h + load + self.feedback
        out: Array = np.clip(asked, -self._limits, self._limits)
        self.limited = np.abs(asked) > self._limits
        self._before = M, h, v, out, load
        return out

    def observe(self, q: Array, v: Array, dt: float, wrenches: Array) -> None:
        """Compare the motion by the last torques in ``dt`` seconds with the model.

        Args:
            q, v: configuration (nq,) and velocities (nv,) now.
            dt: time since the last torques [s].
            wrenches: of the arms on the object meanwhile, at the tools and in their axes (N, 6); only read with
                ``wrist_sensors``. NaN for an arm whose wrench is lost: it keeps the last one.
        """
        if not self._observes or self._before is None:
            return
        M, h, v_before, torque, load = self._before
        passed = -np.expm1(-self._bandwidth * dt)  # of a first-order filter
        d = M @ (v - v_before) / dt + h - (torque - load)
        self.disturbance = self.disturbance + passed * (d - self.disturbance)
        jacobians, to_wrench = self._tools(q, M)
        if self._senses:
            c = self._by_part(to_wrench, load) - wrenches
            self._felt = self._felt + passed * np.where(np.isnan(c), 0.0, c - self._felt)
        else:
            self._felt = self._by_part(to_wrench, self.disturbance)
        self._resisted = self.disturbance.copy()
        squeezes = (self._internal @ self._felt.ravel()).reshape(-1, 6)
        for (arms, s), J in zip(self._parts, jacobians, strict=True):
            self._resisted[s] -= J.T @ squeezes[list(arms)].ravel()

    def _by_part(self, to_wrench: list[Array], torque: Array) -> Array:
        """The wrenches at the tools (N, 6) of torques (nv,), with the maps of :meth:`_tools`."""
        out = np.empty((len(self._cell), 6))
        for (arms, s), A in zip(self._parts, to_wrench, strict=True):
            out[list(arms)] = (A @ torque[s]).reshape(-1, 6)
        return out

    def _tools(self, q: Array, M: Array) -> tuple[list[Array], list[Array]]:
        """J (6 K, n) of each part's K arms in their tools' axes, and J̄ᵀ (6 K, n): torques to wrenches at the tools."""
        pin.computeJointJacobians(self._model, self._data, q)
        jacobians, to_wrench = [], []
        for arms, s in self._parts:
            frames = [self._cell.tool_frames[k] for k in arms]
            J = np.vstack([pin.getFrameJacobian(self._model, self._data, frame, pin.LOCAL)[:, s] for frame in frames])
            move = np.linalg.solve(M[s][:, s], J.T)  # M⁻¹ Jᵀ
            jacobians.append(J)
            to_wrench.append(np.linalg.pinv(J @ move, rcond=_MOVABLE, hermitian=True) @ move.T)
        return jacobians, to_wrench
