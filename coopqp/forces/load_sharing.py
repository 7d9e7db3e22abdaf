"""Load sharing: which wrench does each arm exert, so that the object moves as asked and no limit is exceeded?

N grips with the components c (forces and torques in the tools' axes) exert the wrench ``f = G c`` on the object. With
the weighted pseudo-inverse G⁺ and an orthonormal basis B of the grips' internal wrenches, G B = 0,

    c = c₀ + B y,    c₀ = G⁺ f.

f follows from the object's motion (Newton, Euler); c₀ moves the object, ``B y`` only stresses it. The answer is the y
nearest to a target (zero by default) under

    τ = RNEA(q, q̇, q̈) + Jᵀ c    within the joints' torques,
    wrist wrenches, norms of forces and torques, friction cones of palms,
    |internal force|, |internal torque| of each arm at most as given.

Without active limits this is the closed form c₀. A limit on a norm is kept as a second-order cone, not as a polyhedron
(:mod:`coopqp.forces.cones`): the quadratic constraint of Zheng and Luh, and of Zaytsev's reference [38]. If the limits
leave no c for f, the largest ``share`` λ with an answer for ``λ f`` is found, and the limits that bind are named.

The split of forces into a moving and an internal part depends on the metric: forces in N, torques over ``length`` in
N, arms weighted by ``weights``. A cap on the internal part is mandatory: without it torque limits let the arms squeeze
the object with kilonewtons to carry a little more.

A joint that arms share bears what is behind it, and Bᵀ Σ f of all its arms: no internal force costs it anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, as_vector, read_only, require
from coopqp.errors import InvalidInputError, UnreachableError
from coopqp.forces.cones import Cone, Cones
from coopqp.forces.grips import Grip
from coopqp.forces.shared_load import SharedLoad
from coopqp.model.cell import RobotCell
from coopqp.model.chain import part_columns, parts
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.state import CellState
from coopqp.planning.payload import Payload
from coopqp.spatial import Array

#: A limit of which this share is used binds.
_BINDS = 1.0 - 1e-6
#: Part of a motion that an arm cannot do, and of a wrench that the grips cannot transmit, that counts as rounding.
_ROUNDING = 1e-6
#: Metric of torques against forces [m], as in the weights of the controllers.
LENGTH = 0.3


@dataclass(frozen=True, eq=False)
class _Motion:
    """Joints and object at one instant.

    Attributes:
        torque: RNEA of the arms (nv,).
        to_torque: maps the components c to joint torques (nv, nc).
        wrench: f, on the object in its own frame (6,).
    """

    torque: Array
    to_torque: Array
    wrench: Array


@final
class LoadShare:
    """Shares the wrench on an object among the arms that hold it.

    Args:
        cell, grasp: the arms, and how they hold the object. Gravity is ``cell.model``'s.
        payload: mass, centre and inertia of the object, and the torque limits of the joints.
        internal_force: largest norm of each arm's internal force [N]. Mandatory.
        internal_torque: largest norm of each arm's internal torque [N·m]; by default ``internal_force`` times
            ``length``.
        grips: what each grip transmits, and its limits; rigid without limits by default.
        weights: how much of the load each arm takes before limits bind (N,), > 0; alike by default.
        length: metric of torques against forces [m].

    Raises:
        InvalidInputError: bad numbers, or lists of another length than the arms.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        payload: Payload,
        *,
        internal_force: float,
        internal_torque: float | None = None,
        grips: Sequence[Grip] | None = None,
        weights: Any = None,
        length: float = LENGTH,
    ) -> None:
        grasp.check_arms(cell)
        require(payload, Payload, "LoadShare: payload", "Give a coopqp.planning.Payload.")
        n = len(cell)
        self.cell, self.grasp, self.payload = cell, grasp, payload
        self.length = as_scalar(length, "LoadShare: length")
        self.internal_force = as_scalar(internal_force, "LoadShare: internal_force")
        torque = self.internal_force * self.length if internal_torque is None else internal_torque
        self.internal_torque = as_scalar(torque, "LoadShare: internal_torque")
        self.grips = (Grip(),) * n if grips is None else tuple(grips)
        if len(self.grips) != n:
            raise InvalidInputError(f"{len(self.grips)} grips for {n} arms", "LoadShare: grips", "Give one per arm.")
        for k, grip in enumerate(self.grips):
            require(grip, Grip, f"LoadShare: grips[{k}]", "Give a coopqp.forces.Grip.")
        self.weights = read_only(np.ones(n) if weights is None else as_vector(weights, n, "LoadShare: weights"))
        if not (self.weights > 0.0).all():
            raise InvalidInputError(f"{self.weights.tolist()}", "LoadShare: weights", "Give numbers > 0.")
        self.torque_limits = read_only(payload.limits(cell))
        inertia = np.zeros((3, 3)) if payload.inertia is None else payload.inertia
        self._inertia = pin.Inertia(payload.mass, np.asarray(payload.centre), inertia)
        self._data = cell.model.createData()
        speed = cell.limits.velocity
        self._speed = np.where(np.isfinite(speed), speed, 1.0)
        self._span()
        self._fixed, self._names = self._grip_cones()

    def _span(self) -> None:
        """The grasp map in the metric, its pseudo-inverse, and the basis of internal wrenches."""
        scales, maps, self._own = [], [], list[slice]()
        at = 0
        for X, grip, weight in zip(self.grasp.T_object_tool, self.grips, self.weights, strict=True):
            m = grip.components
            scales.append(np.sqrt(weight) * np.array([1.0, 1.0, 1.0, *[self.length] * (m - 3)]))
            maps.append(X.actionInverse.T[:, :m])  # a wrench at the tool, carried to the object frame
            self._own.append(slice(at, at + m))
            at += m
        self._scale, self._map = np.concatenate(scales), np.hstack(maps)
        U, sizes, Vt = np.linalg.svd(self._map * self._scale)
        rank = int((sizes > 1e-9 * sizes[0]).sum())
        self._pinv = (Vt[:rank].T / sizes[:rank]) @ U[:, :rank].T
        self.free = Vt[rank:].T

    def _grip_cones(self) -> tuple[list[Cone], list[BindingLimit]]:
        """Limits of grips and internal wrenches in (y, λ), without the part of f; and the names of all limits."""
        cones, names = [], []
        for arm, grip, own in zip(self.cell.arm_names, self.grips, self._own, strict=True):
            for bound in grip.bounds():
                A = bound.A * self._scale[own]
                cones.append(Cone(A, np.zeros(len(A)), bound.b * self._scale[own], bound.d))
                names.append(BindingLimit(arm, "", bound.kind))
            internal = [(LimitKind.INTERNAL_FORCE, slice(0, 3), self.internal_force)]
            if grip.components == 6:
                internal.append((LimitKind.INTERNAL_TORQUE, slice(3, 6), self.internal_torque))
            for kind, part, cap in internal:
                A = np.diag(self._scale[own])[part]
                cones.append(Cone(A, np.zeros(3), np.zeros(grip.components), cap))
                names.append(BindingLimit(arm, "", kind))
        self._arm_of = [self.cell.index(name.arm) for name in names]
        for j in np.flatnonzero(np.isfinite(self.torque_limits)):
            arm, _, joint = self.cell.joint_names[j].partition("/")
            names.append(BindingLimit(arm, joint, LimitKind.TORQUE))
        return cones, names

    # -- the object and the arms ---------------------------------------------------------------------------------

    def wrench(self, R_world_object: Any, *, twist: Any = None, acceleration: Any = None) -> Array:
        """Wrench on the object that moves it as asked against gravity, at its origin and in its axes (6,) [N, N·m].

        Args:
            R_world_object: orientation of the object (3, 3).
            twist: twist of the object in its own frame (6,) [m/s, rad/s], as :meth:`coopqp.ObjectPath.twist`.
            acceleration: its derivative (6,) [m/s², rad/s²].
        """
        V = pin.Motion(_six(twist, "LoadShare.wrench: twist"))
        a = _six(acceleration, "LoadShare.wrench: acceleration")
        a[:3] -= np.asarray(R_world_object).T @ self.cell.model.gravity.linear
        return np.asarray((self._inertia * pin.Motion(a) + V.cross(self._inertia * V)).vector)

    def joint_motion(self, q: Any, *, twist: Any = None, acceleration: Any = None) -> tuple[Array, Array]:
        """Joint velocities and accelerations (nv,) with which the arms move the object as asked; least for redundancy.

        Args:
            q: configuration (nq,).
            twist, acceleration: as in :meth:`wrench`.

        Raises:
            UnreachableError: an arm cannot do the motion: a singularity, or fewer than six joints.
        """
        V = _six(twist, "LoadShare.joint_motion: twist")
        a = _six(acceleration, "LoadShare.joint_motion: acceleration")
        return self._joint_motion(CellState(self.cell, q), V, a)

    def object_motion(self, q: Any, joint_velocity: Any, joint_acceleration: Any) -> tuple[Array, Array]:
        """Twist and acceleration of the object (6,) in its own frame, as the first arm moves it.

        Args:
            q: configuration (nq,).
            joint_velocity, joint_acceleration: rates of the cell's joints (nv,) [rad/s or m/s, rad/s² or m/s²].
        """
        cell, data, where = self.cell, self._data, "LoadShare.object_motion"
        x = cell.check_configuration(q, f"{where}: q")
        v, dv = (as_vector(value, cell.nv, where) for value in (joint_velocity, joint_acceleration))
        pin.forwardKinematics(cell.model, data, x, v, dv)
        X, frame = self.grasp.T_object_tool[0].action, cell.tool_frames[0]
        V = pin.getFrameVelocity(cell.model, data, frame, pin.LOCAL).vector
        a = pin.getFrameAcceleration(cell.model, data, frame, pin.LOCAL).vector
        return X @ V, X @ a

    def _joint_motion(self, state: CellState, V: Array, a: Array) -> tuple[Array, Array]:
        cell, data = self.cell, self._data
        v, dv = np.zeros(cell.nv), np.zeros(cell.nv)
        if not (V.any() or a.any()):
            return v, dv
        to_tool = [X.actionInverse for X in self.grasp.T_object_tool]
        self._move_least(v, state, np.array([X @ V for X in to_tool]))
        pin.forwardKinematics(cell.model, data, state.q, v, dv)
        biases = [pin.getFrameAcceleration(cell.model, data, frame, pin.LOCAL).vector for frame in cell.tool_frames]
        self._move_least(dv, state, np.array([X @ a - bias for X, bias in zip(to_tool, biases, strict=True)]))
        return v, dv

    def _move_least(self, rates: Array, state: CellState, targets: Array) -> None:
        """Put in the least joint rates (nv,), each over its largest speed, with J_k rates = target_k (N, 6)."""
        J = self._jacobians(state)
        for arms, columns in zip(parts(self.cell), part_columns(self.cell), strict=True):
            own, target = J[list(arms)][:, :, columns].reshape(-1, len(columns)), targets[list(arms)].ravel()
            speed = self._speed[columns]
            found: Array = speed * np.linalg.lstsq(own * speed, target, rcond=1e-9)[0]
            off = np.abs(own @ found - target)
            if off.max() > _ROUNDING * (1.0 + np.abs(target).max()):
                name = self.cell.arm_names[arms[int(off.argmax()) // 6]]
                raise UnreachableError(f"arm {name} cannot move its tool as the object's motion asks.")
            rates[columns] = found

    def _jacobians(self, state: CellState) -> Array:
        """J of each tool in its own axes (N, 6, nv), 0 for joints that do not move it."""
        out = np.zeros((len(self.cell), 6, self.cell.nv))
        for k, columns in enumerate(self.cell.columns):
            out[k][:, columns] = state.jacobian(k)
        return out

    def _motion(self, q: Any, V: Array, a: Array, v: Array | None, dv: Array | None) -> _Motion:
        cell = self.cell
        state = CellState(cell, q)
        if v is None or dv is None:
            v, dv = self._joint_motion(state, V, a)
        torque = np.array(pin.rnea(cell.model, self._data, state.q, v, dv))
        to_torque = self.to_torques(state)
        R = (state.T_world_tool[0] * self.grasp.T_object_tool[0].inverse()).rotation
        return _Motion(torque, to_torque, self.wrench(R, twist=V, acceleration=a))

    def to_torques(self, state: CellState) -> Array:
        """Map of the grips' components c to joint torques, Jᵀ (nv, nc)."""
        out = np.zeros((self.cell.nv, len(self._scale)))
        for J, own in zip(self._jacobians(state), self._own, strict=True):
            out[:, own] = J[: own.stop - own.start].T
        return out

    # -- sharing -------------------------------------------------------------------------------------------------

    def share(
        self,
        q: Any,
        *,
        twist: Any = None,
        acceleration: Any = None,
        joint_velocity: Any = None,
        joint_acceleration: Any = None,
        internal: Any = None,
    ) -> SharedLoad:
        """The arms' wrenches and torques at one instant.

        Args:
            q: configuration (nq,). The object's orientation follows from the first arm.
            twist, acceleration: motion of the object (6,) in its own frame, as in :meth:`wrench`; rest by default.
            joint_velocity, joint_acceleration: rates of the arms' joints (nv,); by default from :meth:`joint_motion`.
            internal: wanted wrenches of the arms (N, 6) in the object frame [N, N·m], such as a squeeze; their internal
                part is met, or approached within the limits. Zero by default.

        Raises:
            InvalidInputError: bad arguments.
            UnreachableError: the grips cannot transmit the wrench at all, an arm cannot do the motion, or the limits
                leave nothing even without load.
            UndecidedError: a solver fails.
        """
        where, nv = "LoadShare.share", self.cell.nv
        V, a = _six(twist, f"{where}: twist"), _six(acceleration, f"{where}: acceleration")
        v = None if joint_velocity is None else as_vector(joint_velocity, nv, f"{where}: joint_velocity")
        dv = None if joint_acceleration is None else as_vector(joint_acceleration, nv, f"{where}: joint_acceleration")
        if (v is None) != (dv is None):
            raise InvalidInputError("one of joint_velocity and joint_acceleration is missing", where, "Give both.")
        motion = self._motion(q, V, a, v, dv)
        unit = max(1.0, float(np.linalg.norm(motion.wrench)))
        moving = self.moving_part(motion.wrench) / unit
        still = (motion.torque, np.zeros(len(moving)))
        cones = Cones(self.cones(still, [(np.zeros(nv), unit * moving)], motion.to_torque, unit))
        target = self.free.T @ (self._wanted(internal) / self._scale / unit)
        y, share = cones.nearest(target, 1.0), 1.0
        if y is None:
            found = cones.largest()
            if found is None:
                raise UnreachableError(self._why_nothing(motion))
            y, share = found
        return self._answer(motion, unit, share, moving, y, cones.use(y, share))

    def _wanted(self, internal: Any) -> Array:
        """Components of wanted wrenches (N, 6) in the object frame."""
        if internal is None:
            return np.zeros(len(self._scale))
        w = as_vector(np.ravel(internal), 6 * len(self.cell), "LoadShare.share: internal").reshape(-1, 6)
        parts = zip(self.grasp.T_object_tool, w, self._own, strict=True)
        return np.concatenate([(X.action.T @ row)[: own.stop - own.start] for X, row, own in parts])

    def moving_part(self, wrench: Array) -> Array:
        """c₀ of a wrench (6,), in the metric.

        Raises:
            UnreachableError: the grips cannot transmit it.
        """
        moving: Array = self._pinv @ wrench
        lost = wrench - self._map @ (self._scale * moving)
        if np.abs(lost).max() > _ROUNDING * max(1.0, float(np.abs(wrench).max())):
            raise UnreachableError(
                f"the grips cannot transmit the wrench {np.round(wrench, 3).tolist()} (object frame): "
                f"{np.round(lost, 3).tolist()} is left. Give one arm a rigid grip."
            )
        return moving

    def cones(
        self, constant: tuple[Array, Array], per: Sequence[tuple[Array, Array]], to_torque: Array, unit: float
    ) -> list[Cone]:
        """All limits as cones in (y, p), forces over ``unit``.

        Args:
            constant: torques of the arms (nv,), and c₀ of the wrench on the object in the metric, at p = 0.
            per: the same per unit of each parameter in p.
            to_torque: Jᵀ (nv, nc).
            unit: [N].
        """
        at_zero = constant[1] / unit
        whole = np.column_stack([self.free, *(moving / unit for _, moving in per)])
        inner = np.column_stack([self.free, np.zeros((len(at_zero), len(per)))])
        cones = []
        for cone, name, k in zip(self._fixed, self._names, self._arm_of, strict=False):
            own = self._own[k]
            stress = name.kind in (LimitKind.INTERNAL_FORCE, LimitKind.INTERNAL_TORQUE)
            part, first = (inner[own], np.zeros(len(cone.g))) if stress else (whole[own], at_zero[own])
            cones.append(Cone(cone.E @ part, cone.E @ first, cone.g @ part, cone.h / unit + float(cone.g @ first)))
        to_scaled = to_torque * self._scale
        rows, first = to_scaled @ whole, to_scaled @ at_zero + constant[0] / unit
        rows[:, len(rows[0]) - len(per) :] += np.column_stack([torque / unit for torque, _ in per])
        none = np.zeros(whole.shape[1])
        cones += [
            Cone(rows[j : j + 1], first[j : j + 1], none, self.torque_limits[j] / unit)
            for j in np.flatnonzero(np.isfinite(self.torque_limits))
        ]
        return cones

    def _answer(self, motion: _Motion, unit: float, share: float, moving: Array, y: Array, use: Array) -> SharedLoad:
        inner = unit * self._scale * (self.free @ y)
        c = unit * share * self._scale * moving + inner
        load_torques = motion.to_torque @ c
        n, joints = len(self.cell), np.flatnonzero(np.isfinite(self.torque_limits))
        joint_use, grip_use, internal_use = np.zeros(self.cell.nv), np.zeros(n), np.zeros(n)
        joint_use[joints] = use[len(use) - len(joints) :]
        for k, name, used in zip(self._arm_of, self._names, use, strict=False):
            kinds = (LimitKind.INTERNAL_FORCE, LimitKind.INTERNAL_TORQUE)
            of = internal_use if name.kind in kinds else grip_use
            of[k] = max(of[k], used)
        binds = _BINDS if share == 1.0 else min(_BINDS, use.max())  # far too much load leaves the solver less exact
        order = [i for i in np.argsort(-use.round(5), kind="stable") if use[i] >= binds]
        return SharedLoad(
            self._on_object(c),
            self._on_object(inner),
            motion.torque + load_torques,
            load_torques,
            share,
            joint_use,
            grip_use,
            internal_use,
            tuple(self._names[i] for i in order),
        )

    def _on_object(self, c: Array) -> Array:
        """Wrenches (N, 6) in the object frame from components in the tools' axes."""
        return np.array([self._map[:, own] @ c[own] for own in self._own])

    def _why_nothing(self, motion: _Motion) -> str:
        over = np.flatnonzero(np.abs(motion.torque) > self.torque_limits)
        if over.size:
            j = int(over[0])
            arm, _, joint = self.cell.joint_names[j].partition("/")
            return (
                f"arm {arm}: joint {joint} needs {abs(motion.torque[j]):.4g} N·m (or N) for the arm alone, and may "
                f"take {self.torque_limits[j]:.4g}. Move slower, or correct the limits."
            )
        return "the limits leave no wrenches even without load: the least squeeze exceeds the cap on internal forces."


def _six(value: Any, where: str) -> Array:
    return np.zeros(6) if value is None else as_vector(value, 6, where)
