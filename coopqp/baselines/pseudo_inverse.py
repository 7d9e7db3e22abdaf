"""The paper's algorithm, Steps 0–5: it transforms each object increment to each arm and solves for the arm's joints.

The algorithm is open loop and ignores limits. It is the baseline.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, Doc, as_count, as_options, as_scalar, as_vector, documented, keep_scalars, require
from coopqp.constraints.cause import Cause
from coopqp.control.interface import ControlStep, Status, short_text
from coopqp.control.lock import Lock, alone
from coopqp.control.step.start import check_start
from coopqp.errors import InvalidInputError, UnknownNameError, UnreachableError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.model.state import CellState
from coopqp.paths.moving_grasps import refuse_motion
from coopqp.paths.path import LinePath, ObjectPath
from coopqp.spatial import Array

Increment = Literal["rotated", "literal", "exact"]
Integration = Literal["euler", "midpoint"]
#: The algorithm has no other reason to hold than the length of a step, and rests if it is told to.
_CAUSES = {Status.HOLDING: Cause.INPUT, Status.PAUSED: Cause.OPERATOR}


@documented
@dataclass(frozen=True, kw_only=True)
class PseudoInverseOptions:
    """Variants of the paper's algorithm."""

    increment: Annotated[
        Increment,
        Doc(
            'division of the total displacement (Step 1). "rotated": δφ = r φ*/N and δp_k = Rot(r, −τ_k '
            'φ*) p/N, which follows G(0)M(τ) to first order. "literal": the constant body increment (p, '
            'φ* r)/N, a screw with another end pose. "exact": log(M(τ)⁻¹ M(τ + dτ)), for any path'
        ),
    ] = "rotated"
    integration: Annotated[
        Integration, Doc('"euler" evaluates the Jacobian at the start of the step, "midpoint" in its middle')
    ] = "euler"
    reset_every: Annotated[
        int | None,
        Doc(
            "number of steps between resets by inverse kinematics of the path's pose (the paper's future "
            "work); None for no resets"
        ),
    ] = None
    damping: Annotated[
        float, Doc("λ_max of the damped pseudo-inverse, λ² = λ_max² (1 − (σ_min/σ_0)²) for σ_min < σ_0")
    ] = 0.0
    damping_from: Annotated[float, Doc("σ_0, the smallest singular value without damping")] = 0.05

    def __post_init__(self) -> None:
        if self.increment not in ("rotated", "literal", "exact"):
            raise UnknownNameError("increment", str(self.increment), ("rotated", "literal", "exact"))
        if self.integration not in ("euler", "midpoint"):
            raise UnknownNameError("integration", str(self.integration), ("euler", "midpoint"))
        if self.reset_every is not None:
            object.__setattr__(self, "reset_every", as_count(self.reset_every, "PseudoInverseOptions: reset_every"))
        keep_scalars(self, "damping", open_low=False)
        keep_scalars(self, "damping_from")


@final
class PseudoInverseController:
    """Steps 0–5 of the paper for any number of arms; see :class:`PseudoInverseOptions` for its variants.

    Args:
        cell, grasp, path: the arms, their grasp and the path of the object.
        dt: length of a step [s]; the paper's N increments correspond to ``dt = t_f / N``.
        options: variants of the algorithm.

    Raises:
        InvalidInputError: ``"rotated"`` or ``"literal"`` without a :class:`LinePath`.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        *,
        dt: float,
        options: PseudoInverseOptions | Mapping[str, Any] | None = None,
    ) -> None:
        require(grasp, Grasp, "PseudoInverseController: grasp", "Give a Grasp of the placements.")
        grasp.check_arms(cell)
        refuse_motion(path, "PseudoInverseController: path", "Give it to a QPController.")
        cell.refuse_shared("PseudoInverseController")
        self._lock = Lock()
        self.cell, self.grasp, self.path = cell, grasp, path
        self.dt = as_scalar(dt, "PseudoInverseController: dt")
        self.options = as_options(PseudoInverseOptions, options, "PseudoInverseController: options")
        if self.options.increment != "exact" and not isinstance(path, LinePath):
            raise InvalidInputError(
                f"the paper's '{self.options.increment}' increment needs a LinePath, got {type(path).__name__}",
                "PseudoInverseController",
                "Use increment='exact' for other paths.",
            )
        self._q = pin.neutral(cell.model)
        self._clock, self._count, self._started = 0.0, 0, False
        self._override = 1.0
        #: The memory of what relaxes the forces between the arms; None if nothing does.
        self.forces: Array | None = None
        self._shift, self._held = np.zeros((len(cell), 6)), np.zeros((len(cell), 6))

    # -- the interface for ForceController -----------------------------------------------------------------------

    @property
    def shares(self) -> Array:
        """Share of each arm in the object's pose (N, 6): the first arm defines it, and nothing corrects the others."""
        out = np.zeros((len(self.cell), 6))
        out[0] = 1.0
        return out

    @property
    def override(self) -> float:
        """The speed override: the wanted rate σ."""
        return self._override

    @alone
    def set_override(self, share: float) -> None:
        """Set the speed override from the next step on: 1 for the path's own speed, 0 for rest.

        Raises:
            InvalidInputError: not a number from 0 to 1; the old one stays.
        """
        self._override = as_scalar(share, "set_override: share", open_low=False, high=1.0)

    @alone
    def shift_grasp(self, shift: ArrayLike) -> None:
        """Hold the object at shifted places of the tools from the next step on, as the QP's ``shift_grasp``.

        The tools go there in one step.

        Raises:
            InvalidInputError: not six finite numbers per arm.
        """
        n = len(self.cell)
        self._shift = as_vector(np.ravel(np.asarray(shift, dtype=float)), 6 * n, "shift_grasp").reshape(n, 6).copy()

    def take_shift(self, shift: Array) -> Callable[[], bool]:
        """As :meth:`shift_grasp`, for a shift that its owner goes on to change in place; see the QP's."""

        def taken() -> bool:
            if not np.isfinite(shift).all():
                return False
            self._shift = shift.copy()
            return True

        return taken

    def bind_forces(
        self, memory: Array, *, before_forces: Callable[..., None], after_forces: Callable[..., None], **_: Any
    ) -> Callable[..., ControlStep]:
        """A step with wrenches, as the QP's."""

        def step(q_measured: Any, dt: Any, wrenches: Any) -> ControlStep:
            self._lock.hold()
            try:
                before_forces(q_measured, dt, wrenches)
                made = self.step(q_measured, dt=dt)
                after_forces(made)
            finally:
                self._lock.release()
            return made

        self.forces = memory
        return step

    def lower_rate(self, share: float) -> None:
        """See :meth:`set_override`."""
        self.set_override(share)

    def accepted_dt(self, dt: Any) -> float:
        """Length of the next step [s]: the nominal one where ``dt`` is None or no length."""
        try:
            return self.dt if dt is None else as_scalar(dt, "dt")
        except InvalidInputError:
            return self.dt

    @property
    def reference(self) -> pin.SE3:
        """Pose of the path at the end of the last step."""
        return self.path.pose(self._clock)

    @property
    def commanded(self) -> Array:
        """Commanded configuration at the end of the last step (nq,)."""
        return self._q

    def __repr__(self) -> str:
        return short_text(self)

    @alone
    def reset(self, q: ArrayLike) -> None:
        """Step 0: start at ``q`` (nq,), with the object's clock at 0. Errors as in :class:`Controller`."""
        self._q = check_start(self.cell, self.grasp, self.path, q)
        self._clock, self._count, self._started = 0.0, 0, True
        self._held = self._shift

    @alone
    def step(self, q_measured: ArrayLike | None = None, *, dt: float | None = None) -> ControlStep:
        """Steps 3–5. The algorithm is open loop: ``q_measured`` is not used.

        With an invalid ``dt`` the arms hold. If the arms cannot reach the pose of a periodic reset, the reset is
        skipped and ``reason`` reports it.
        """
        if not self._started:
            raise InvalidInputError("step before reset", "PseudoInverseController", "Call reset(q) first.")
        began = time.perf_counter()
        try:
            h = self.dt if dt is None else as_scalar(dt, "step: dt")
        except InvalidInputError as error:
            return self._result(self._q, self._clock, self.dt, began, Status.HOLDING, str(error).rstrip("."))
        clock = self._clock
        share = min(self._override * h, max(self.path.duration - clock, 0.0))
        arm_increments = self.grasp.arm_increments(self._object_increment(clock, share))  # Step 3, Eq. (16)
        if self._shift is not self._held:  # the grasps have moved on the object, as the tools have to
            for X, moved, increment in zip(
                self.grasp.T_object_tool, self._shift - self._held, arm_increments, strict=True
            ):
                increment += X.actionInverse @ moved
            self._held = self._shift
        dq = self._joint_increment(self._q, arm_increments)  # Step 4, Eq. (17)
        if self.options.integration == "midpoint":
            dq = self._joint_increment(pin.integrate(self.cell.model, self._q, 0.5 * dq), arm_increments)
        q_next = pin.integrate(self.cell.model, self._q, dq)  # Step 5
        clock_next = self._end_of_step(clock, share)
        self._count += 1
        every, reason = self.options.reset_every, ""
        if every is not None and self._count % every == 0:
            try:
                q_next = inverse_kinematics(self.cell, self.grasp, self.path.pose(clock_next), q_next, limits=False)
            except UnreachableError as error:
                reason = f"no periodic reset: {error}".rstrip(".")
        status = Status.TRACKING if self._override else Status.PAUSED
        step = self._result(q_next, clock_next, h, began, status, reason)
        self._q, self._clock = q_next, clock_next
        return step

    def _result(
        self, q_next: Array, clock_next: float, h: float, began: float, status: Status, reason: str
    ) -> ControlStep:
        return ControlStep(
            cell=self.cell,
            grasp=self.grasp,
            path=self.path,
            q=self._q,
            velocity=pin.difference(self.cell.model, self._q, q_next) / h,
            q_next=q_next,
            dt=h,
            clock=self._clock,
            clock_next=clock_next,
            rate=self._override if status is Status.TRACKING else 0.0,
            status=status,
            reason=reason,
            cause=_CAUSES.get(status),
            build_time_s=time.perf_counter() - began,
        )

    def _end_of_step(self, clock: float, share: float) -> float:
        """Clock at the end of a step. Within 1e-9 of the end it is set to the end: rounding of N · dt adds no step."""
        end = clock + share
        return self.path.duration if self.path.duration - end < 1e-9 * self.path.duration else end

    def _object_increment(self, clock: float, share: float) -> Array:
        """Δ of Eq. (13): the object's body-frame increment during ``share`` seconds (6,) [m, rad]."""
        if share <= 0.0:
            return np.zeros(6)
        if self.options.increment == "exact" or not isinstance(self.path, LinePath):
            return self.path.increment(clock, share) * share
        path, law = self.path, self.path.time_law
        u, u_end = (law.value_at(t / path.duration) for t in (clock, clock + share))
        p, turn = path.screw.p, path.screw.angle * path.screw.r
        if self.options.increment == "rotated":
            p = pin.exp3(-u * turn) @ p
        return np.concatenate([p, turn]) * (u_end - u)

    def _joint_increment(self, q: Array, arm_increments: Array) -> Array:
        """Step 4 for every arm: solve J δq = Δ^k in the tool frame."""
        state = CellState(self.cell, q)
        dq = np.empty(self.cell.nv)
        for k, s in enumerate(self.cell.v_slices):
            J = state.jacobian(k)
            U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
            damping = self.options.damping**2 * max(0.0, 1.0 - (sigma[-1] / self.options.damping_from) ** 2)
            inverse = sigma / (sigma**2 + damping) if damping else 1.0 / np.maximum(sigma, 1e-12)
            dq[s] = Vt.T @ (inverse * (U.T @ arm_increments[k]))
        return dq
