"""A QP for each arm alone, for comparison: each arm follows its own grasp within its own limits.

This corresponds to one soft task per arm. Nothing couples the arms, and the object's clock runs at its nominal rate. If
one arm falls behind, the arms pull the object apart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, Doc, as_options, as_scalar, as_step, documented, keep_scalars, require
from coopqp.constraints.cause import Cause
from coopqp.control.interface import NO_SOLVE, ControlStep, GivenUp, SolverReport, Status, short_text
from coopqp.control.lock import Lock, alone
from coopqp.control.step.start import check_start
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit
from coopqp.paths.moving_grasps import refuse_motion
from coopqp.paths.path import ObjectPath
from coopqp.solvers.base import QpSolver
from coopqp.solvers.choice import make_solver
from coopqp.solvers.problem import QpProblem, QpSolution
from coopqp.spatial import Array, adjoint, for_twists

#: Cost that makes every problem strictly convex [m²]. It is small: the resulting error is in the range of micrometres.
_REGULARISATION = 1e-8
#: Weight of the return of a joint from outside its limits, relative to a tracking error of 1 m/s [(m/s)²/(rad/s)²].
_RECOVERY = 1e4
#: Largest accepted excess of a solution over a limit [rad/s or m/s]; it is clipped. A larger one is a failure.
_RESIDUE = 1e-5


@documented
@dataclass(frozen=True, kw_only=True)
class IndependentQPOptions:
    """Settings of the QP with independent arms."""

    solver: Annotated[
        str | QpSolver,
        Doc(
            "name of the QP solver, as for the controller qp; one is kept per arm. A program may also give a solver "
            "object, which serves all arms"
        ),
    ] = "auto"
    solver_settings: Annotated[Any, Doc("settings of the solver of that name")] = None
    gain: Annotated[float, Doc("of every arm's error [1/s]; a step never corrects more than the whole error")] = 20.0
    correction_speed: Annotated[float, Doc("largest speed of the correction [m/s]")] = 0.1
    correction_spin: Annotated[float, Doc("largest angular speed of the correction [rad/s]")] = 0.4
    length: Annotated[float, Doc("characteristic length that weighs rotation against translation [m]")] = 0.3
    damping: Annotated[float, Doc("λ_max [m] of the damping λ² = λ_max² (1 − (σ_min/σ_0)²) for σ_min < σ_0")] = 0.02
    damping_from: Annotated[float, Doc("σ_0, the smallest singular value of the tool Jacobian without damping")] = 0.02

    def __post_init__(self) -> None:
        keep_scalars(self, "correction_speed", "correction_spin", "length", "damping_from")
        keep_scalars(self, "gain", "damping", open_low=False)


@final
class IndependentQPController:
    """Solves ``min ‖A_k v_k − (ν + c_k)‖² + λ_k² ‖v_k‖²`` within the joint limits for each arm, without coupling.

    Args:
        cell, grasp, path: the arms, their grasp and the path of the object.
        dt: nominal length of a step [s], 0.5 at most.
        options: settings, or a dictionary of them.

    Raises:
        InvalidInputError: bad settings.
        UnknownNameError: no such solver.
        MissingExtraError: the solver's package is not installed.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        *,
        dt: float,
        options: IndependentQPOptions | Mapping[str, Any] | None = None,
    ) -> None:
        require(grasp, Grasp, "IndependentQPController: grasp", "Give a Grasp of the placements.")
        grasp.check_arms(cell)
        refuse_motion(path, "IndependentQPController: path", "Give it to a QPController.")
        cell.refuse_shared("IndependentQPController")
        self._lock = Lock()
        self.cell, self.grasp, self.path = cell, grasp, path
        self.dt = as_step(dt, "IndependentQPController: dt")
        o = self.options = as_options(IndependentQPOptions, options, "IndependentQPController: options")
        self._chain, self._box = Chain(cell, grasp), VelocityBox(cell)
        self._solvers = [make_solver(o.solver, o.solver_settings) for _ in cell.arms]
        self._shared = isinstance(o.solver, QpSolver)
        self._to_tool = [adjoint(X.inverse()) for X in grasp.T_object_tool]
        self._metric = np.array([1.0] * 3 + [o.length**2] * 3)
        self._q, self._v = pin.neutral(cell.model), np.zeros(cell.nv)
        self._clock, self._started = 0.0, False

    def __repr__(self) -> str:
        return short_text(self)

    @alone
    def reset(self, q: ArrayLike) -> None:
        """Start at rest at ``q`` (nq,), with the object's clock at 0. Errors as in :class:`Controller`."""
        self._q = check_start(self.cell, self.grasp, self.path, q)
        self._v = np.zeros(self.cell.nv)
        self._clock, self._started = 0.0, True
        for solver in self._solvers:
            solver.reset()

    @alone
    def step(self, q_measured: ArrayLike | None = None, *, dt: float | None = None) -> ControlStep:
        """One step from the commanded configuration. ``q_measured`` is not used.

        With an invalid ``dt``, or if the QP of an arm fails, the step brakes.
        """
        if not self._started:
            raise InvalidInputError("step before reset", "IndependentQPController", "Call reset(q) first.")
        began = time.perf_counter()
        h, reason = self.dt, ""
        if dt is not None:
            try:
                h = as_scalar(dt, "step: dt")
            except InvalidInputError as error:
                reason = str(error).rstrip(".")
        self._box.update(self.cell.positions(self._q), self._v, h)
        if reason:
            return self._finish(h, np.zeros(self.cell.nv), self._clock, began, reason)
        span = min(h, self.path.duration - self._clock)
        A, wanted = self._tasks(h, span)
        v, reports = np.zeros(self.cell.nv), []
        for k, s in enumerate(self.cell.v_slices):
            if self._shared:
                self._solvers[k].reset()
            solution = self._solvers[k].solve(self._problem(k, A[k], wanted[k]))
            reports.append(solution)
            if not self._believable(solution, s):
                reason = f"the QP of arm '{self.cell.arm_names[k]}' has no usable answer ({solution.status.value})"
                return self._finish(h, np.zeros(self.cell.nv), self._clock, began, reason, reports)
            v[s] = solution.x
        residues = np.array([A[k] @ v[s] - wanted[k] for k, s in enumerate(self.cell.v_slices)])
        parting = float(np.linalg.norm(residues[:, :3], axis=1).max())
        clock = self._clock + span
        if self.path.duration - clock < 1e-9 * self.path.duration:
            clock = self.path.duration
        return self._finish(h, v, clock, began, "", reports, parting)

    def _tasks(self, h: float, span: float) -> tuple[list[Array], Array]:
        """A_k at the predicted midpoint of the step, and ν + c_k (N, 6). Twists are in the reference object frame."""
        o, chain, path = self.options, self._chain, self.path
        reference = path.pose(self._clock)
        errors = chain.errors(chain.carried(self._q), reference)
        wanted: Array = -min(o.gain, 1.0 / h) * errors
        for c in wanted:
            excess = max(np.linalg.norm(c[:3]) / o.correction_speed, np.linalg.norm(c[3:]) / o.correction_spin)
            if excess > 1.0:
                c /= excess
        if span > 0.0:
            wanted += path.increment(self._clock, span) * (span / h)
        middle = pin.integrate(self.cell.model, self._q, 0.5 * h * self._v)
        chain.evaluate(middle, about=reference.translation)
        J, R = chain.dense(), reference.rotation
        to_reference = for_twists(R.T)
        return [to_reference @ J[6 * k : 6 * k + 6, s] for k, s in enumerate(self.cell.v_slices)], wanted

    def _problem(self, k: int, A: Array, wanted: Array) -> QpProblem:
        o, box, s = self.options, self._box, self.cell.v_slices[k]
        n = s.stop - s.start
        smallest = float(np.linalg.svd(self._to_tool[k] @ A, compute_uv=False)[-1])
        damping = o.damping**2 * max(0.0, 1.0 - (smallest / o.damping_from) ** 2)
        weighted = A.T * self._metric
        H, g = weighted @ A, -weighted @ wanted
        H[range(n), range(n)] += damping + _REGULARISATION + _RECOVERY * box.outside[s]
        g -= _RECOVERY * box.recovery[s] * box.outside[s]
        none, empty = np.zeros((0, n)), np.zeros(0)
        return QpProblem(
            H=H, g=g, A=none, b=empty, C=none, l=empty, u=empty, lb=box.lower[s].copy(), ub=box.upper[s].copy()
        )

    def _believable(self, solution: QpSolution, s: slice) -> bool:
        """True if the solution exists, is finite, and violates the box by no more than ``_RESIDUE``."""
        if not solution.usable:
            return False
        excess = np.maximum(solution.x - self._box.upper[s], self._box.lower[s] - solution.x)
        return bool(excess.max() <= _RESIDUE)  # False for NaN

    def _finish(
        self,
        h: float,
        v: Array,
        clock: float,
        began: float,
        reason: str,
        solutions: Sequence[QpSolution] = (),
        parting: float = 0.0,
    ) -> ControlStep:
        box, report = self._box, NO_SOLVE
        v = np.clip(v, box.lower, box.upper)
        if solutions:
            worst = next((s for s in solutions if not s.usable), solutions[-1])
            report = SolverReport(
                self._solvers[0].name,
                worst.status.value,
                sum(s.iterations for s in solutions),
                0.0,
                math.fsum(s.solve_time_s for s in solutions),
            )
        step = ControlStep(
            cell=self.cell,
            grasp=self.grasp,
            path=self.path,
            q=self._q,
            velocity=v,
            q_next=np.asarray(pin.integrate(self.cell.model, self._q, h * v)),
            dt=h,
            clock=self._clock,
            clock_next=clock,
            rate=0.0 if reason else 1.0,
            status=Status.HOLDING if reason else Status.TRACKING,
            reason=reason,
            cause=(Cause.SOLVER if solutions else Cause.INPUT) if reason else None,
            binding=self._binding(v, h),
            given_up=GivenUp(chain=parting) if parting > 1e-6 else GivenUp(),
            solver=report,
            build_time_s=time.perf_counter() - began - report.time_s,
        )
        self._q, self._v, self._clock = step.q_next, v, clock
        return step

    def _binding(self, v: Array, h: float) -> tuple[BindingLimit, ...]:
        return tuple(
            self._box.binding(int(j), sign, self._v, h)
            for sign, bound in ((1.0, self._box.upper), (-1.0, self._box.lower))
            for j in np.flatnonzero(np.abs(v - bound) <= 1e-9)
        )
