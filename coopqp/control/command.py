"""The interface of all controllers: ``reset(q)``, then ``step() → ControlStep`` in every period."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from coopqp.checks import read_only
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit
from coopqp.model.state import CellState
from coopqp.spatial import Array
from coopqp.task.path import ObjectPath


class Status(enum.Enum):
    """Status of a step. With every status but FAULT, the command advances or brakes the motion."""

    TRACKING = "tracking"  #: the object follows its path at full rate
    SLOWED = "slowed"  #: the object follows its path at a lower rate (σ < 1)
    BLOCKED = "blocked"  #: the object cannot move on (σ ≈ 0): a limit, a singularity, or out of reach
    HOLDING = "holding"  #: bad input, no solution, a stale clock or arms out of step: all arms brake together and rest
    FAULT = "fault"  #: latched: the arms rest until ``reset`` is called with the measured configuration

    @property
    def code(self) -> int:
        """Number of the status in recordings."""
        return _STATUS_ORDER.index(self)


_STATUS_ORDER = list(Status)


@dataclass(frozen=True, slots=True)
class SolverReport:
    """Result of the QP solver in a step; ``name`` is "none" if the step needed no QP."""

    name: str = "none"
    status: str = "not needed"
    iterations: int = 0
    residual: float = 0.0
    time_s: float = 0.0
    message: str = ""


NO_SOLVE = SolverReport()


@dataclass(frozen=True, slots=True)
class GivenUp:
    """The parts of each rank that higher ranks made impossible, in the order of rank.

    Attributes:
        chain: speed at which the arms part [m/s]; 0 unless the limits are infeasible.
        grasp: lost share of the grasp correction, 1 − ρ_g.
        off_path: object velocity off the path, the twist s in the reference object frame (6,) [m/s, rad/s].
        path: lost share of the path correction, 1 − ρ_p.
        rate: lost share of the path rate, 1 − σ.
        restricted: names of arms with fewer than six joints that cannot follow every object motion.
    """

    chain: float = 0.0
    grasp: float = 0.0
    off_path: tuple[float, ...] = (0.0,) * 6
    path: float = 0.0
    rate: float = 0.0
    restricted: tuple[str, ...] = ()


NOTHING = GivenUp()


@dataclass(frozen=True, eq=False)
class ControlStep:
    """The command of one step and its reason. Costly values are computed on access.

    The arrays are read-only; copy an array to change it.

    Attributes:
        q: commanded configuration at the start of the step (nq,).
        velocity: commanded joint velocities (nv,) [rad/s or m/s], constant over the step.
        q_next: commanded configuration at the end of the step (nq,); send it to position servos.
        dt: length of the step [s].
        clock, clock_next: the object's clock at the start and at the end of the step [s].
        rate: σ, the share of the nominal path rate.
        status, reason: status of the step, and the reason in words.
        binding: binding limits of the step.
        given_up: lost parts of each rank.
        solver: result of the QP solver.
        build_time_s: time to compute the step without the QP solver [s].
        finished: True if the object's clock has reached the end of the path.
    """

    cell: RobotCell = field(repr=False)
    grasp: Grasp = field(repr=False)
    path: ObjectPath = field(repr=False)
    q: Array
    velocity: Array
    q_next: Array
    dt: float
    clock: float
    clock_next: float
    rate: float
    status: Status
    reason: str = ""
    binding: tuple[BindingLimit, ...] = ()
    given_up: GivenUp = NOTHING
    solver: SolverReport = NO_SOLVE
    build_time_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("q", "velocity", "q_next"):
            _set(self, name, read_only(getattr(self, name)))

    @property
    def finished(self) -> bool:
        """True if the object's clock has reached the end of the path."""
        return self.clock_next >= self.path.duration

    @cached_property
    def state(self) -> CellState:
        """Kinematics at :attr:`q`."""
        return CellState(self.cell, self.q)

    @cached_property
    def arm_increments(self) -> Array:
        """Δ^k of Eq. (16) as commanded: displacement of each tool in its own frame during the step (N, 6) [m, rad]."""
        v = [self.velocity[s] for s in self.cell.v_slices]
        return np.array([self.state.jacobian(k) @ v[k] * self.dt for k in range(len(self.cell))])

    @cached_property
    def relative_errors(self) -> Array:
        """Distance [mm] and angle [deg] between the object poses of each pair of arms (0,1), (0,2), … (1,2) …"""
        e = self.grasp.relative_errors(self.state)
        return np.column_stack([1e3 * np.linalg.norm(e[:, :3], axis=1), np.rad2deg(np.linalg.norm(e[:, 3:], axis=1))])

    @property
    def sigma_min(self) -> Array:
        """Smallest singular value of each arm's tool Jacobian (N,)."""
        return self.state.sigma_min

    def explain(self) -> str:
        """A sentence with the status, the binding limits, the reason and the lost parts of the ranks."""
        where = f" ({'; '.join(str(b) for b in self.binding)})" if self.binding else ""
        rate = f" at {100 * self.rate:.3g} % of its rate" if self.status is Status.SLOWED else ""
        what = {
            Status.TRACKING: "The object follows its path",
            Status.SLOWED: "The object follows its path" + rate,
            Status.BLOCKED: "The object cannot go on",
            Status.HOLDING: "All arms brake together and hold",
            Status.FAULT: "Stopped until reset() is called with the measured configuration",
        }[self.status]
        parts = [what + where]
        if self.reason:
            parts.append(self.reason)
        g = self.given_up
        lost = []
        if g.chain > 0.0:
            lost.append(f"the arms part at {1e3 * g.chain:.3g} mm/s")
        if g.grasp > 1e-3:
            lost.append(f"{100 * g.grasp:.0f} % of the grasp correction")
        off = float(np.linalg.norm(g.off_path[:3]))
        if off > 1e-9:
            lost.append(f"{1e3 * off:.3g} mm/s off the path")
        if g.path > 1e-3:
            lost.append(f"{100 * g.path:.0f} % of the path correction")
        if g.restricted:
            lost.append(f"motions that {', '.join(g.restricted)} cannot follow")
        if lost:
            parts.append("given up: " + ", ".join(lost))
        return "; ".join(parts) + "."


def make_step(fields: dict[str, Any]) -> ControlStep:
    """Build a ControlStep from all its fields without the cost of constructor and copies. It keeps ``fields``."""
    step = _new(ControlStep)
    _set(step, "__dict__", fields)
    # The controller continues from these arrays: a change by the user must not move the arms.
    fields["velocity"].setflags(False)
    fields["q_next"].setflags(False)
    return step


_new, _set = object.__new__, object.__setattr__


class Controller(Protocol):
    """The protocol of the controllers of :func:`coopqp.simulation.simulate.simulate`."""

    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    dt: float

    def reset(self, q: Any) -> None:
        """Start at rest at a measured configuration (nq,), with the object's clock at 0.

        Raises:
            InvalidInputError: wrong shape, NaN, or the arms do not hold the object at ``q``.
        """
        ...

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        """Compute the command of one period. Run-time data never raise an error."""
        ...


#: Default of the largest accepted error of an arm at reset [m, rad].
START_TOLERANCE_M, START_TOLERANCE_RAD = 0.02, np.deg2rad(3.0)


def check_start(
    cell: RobotCell, grasp: Grasp, path: ObjectPath, q: Any, *, tolerance_m: float, tolerance_rad: float
) -> Array:
    """Check that the arms hold the object at the start of the path. Returns ``q`` (nq,) as a read-only array.

    Raises:
        InvalidInputError: an arm does not; the message names the arm and its distance from the path's start.
    """
    configuration = cell.check_configuration(q, "reset: q")
    start = path.pose(0.0)
    for name, O in zip(cell.arm_names, grasp.carried(CellState(cell, configuration)), strict=True):
        error = pin.log6(start.actInv(O)).vector
        d, a = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if d > tolerance_m or a > tolerance_rad:
            raise InvalidInputError(
                f"arm '{name}' holds the object {1e3 * d:.1f} mm and {np.rad2deg(a):.2f}° from the start of its path "
                f"(tolerance {1e3 * tolerance_m:g} mm, {np.rad2deg(tolerance_rad):.3g}°)",
                "reset: q",
                "Start where the arms meet the grasp (coopqp.model.inverse_kinematics), or widen the start tolerance.",
            )
    return read_only(configuration)
