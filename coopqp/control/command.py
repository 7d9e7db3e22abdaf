"""The interface of all controllers: ``reset(q)``, then ``step() → ControlStep`` in every period."""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import Any, Protocol, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, read_only
from coopqp.errors import InvalidInputError
from coopqp.lazy import Shown
from coopqp.model.branches import AT_LIMIT, amount
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import NearPair
from coopqp.model.state import CellState
from coopqp.spatial import Array
from coopqp.task.guarded import GuardedPath
from coopqp.task.path import ObjectPath


class Status(enum.Enum):
    """Status of a step. With every status but FAULT, the command advances or brakes the motion."""

    TRACKING = "tracking"  #: the object follows its path at full rate
    SLOWED = "slowed"  #: the object follows its path at a lower rate (σ < 1)
    BLOCKED = "blocked"  #: the object cannot move on (σ ≈ 0): a limit, a singularity, or out of reach
    HOLDING = "holding"  #: bad input, no solution, a stale clock or arms out of step: all arms brake together and rest
    FAULT = "fault"  #: latched: the arms rest until ``reset`` is called with the measured configuration
    PAUSED = "paused"  #: the object rests on its path because its operator paused it, or set the override to 0
    OFF_PATH = "off path"  #: the object is further from its path than ``off_path_distance`` or ``off_path_angle``

    @property
    def code(self) -> int:
        """Number of the status in recordings."""
        return _STATUS_ORDER.index(self)

    @property
    def precedence(self) -> int:
        """Of several statuses that apply the one with the highest precedence is said; 0 for TRACKING."""
        return _PRECEDENCE.index(self)


_STATUS_ORDER = list(Status)
_PRECEDENCE = (
    Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.PAUSED, Status.OFF_PATH, Status.HOLDING, Status.FAULT,
)  # fmt: skip


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


class StepReader(Protocol):
    """Reads what a record does not say in words; one per controller and path.

    Attributes:
        path: of the controller.
        nq, nv: numbers of a configuration, and of joint velocities.
        q_at, velocity_at, q_next_at, dt_at, clock_at, clock_next_at: where they begin in a record [bytes].
    """

    path: ObjectPath
    nq: int
    nv: int
    q_at: int
    velocity_at: int
    q_next_at: int
    dt_at: int
    clock_at: int
    clock_next_at: int

    def read(self, record: bytes, name: str) -> Any:
        """Value of the attribute ``name`` of :class:`ControlStep`."""
        ...


@final
class ControlStep(Shown):
    """The command of one step, and the reason for it.

    A compiled controller hands out a record of numbers: an attribute is read from it when asked for. Arrays are
    read-only; copy one to change it.

    Attributes:
        q: commanded configuration at the start of the step (nq,).
        velocity: commanded joint velocities (nv,) [rad/s or m/s], constant over the step.
        q_next: commanded configuration at the end of the step (nq,); send it to position servos.
        dt: length of the step [s].
        clock, clock_next: the object's clock at both ends [s].
        rate: σ, share of the nominal path rate.
        status, reason: what the step is worth, in a word and in a sentence.
        binding: limits that the step runs against.
        given_up: what each rank gave up.
        solver: how the QP went.
        clearance: the bodies nearest to their margin at :attr:`q`, and their distance; None without a
            :class:`coopqp.collision.Clearance`. It is measured when it is asked for.
        build_time_s: time to compute the step without the solve [s]; 0 where it is not measured.
        finished: the object's clock has reached the end of its path.
    """

    __slots__ = ("_context", "_record", "_values", "rate", "status")

    cell: RobotCell
    grasp: Grasp
    rate: float
    status: Status
    reason: str
    binding: tuple[BindingLimit, ...]
    given_up: GivenUp
    solver: SolverReport
    clearance: NearPair | None
    build_time_s: float

    # Loops read these at every step: they do not go the way of __getattr__.

    @property
    def path(self) -> ObjectPath:
        """The path that the step follows."""
        context = self._context
        value: ObjectPath = self._values["path"] if context is None else context.path
        return value

    @property
    def q(self) -> Array:
        """Commanded configuration at the start of the step (nq,)."""
        context = self._context
        if context is None:
            value: Array = self._values["q"]
            return value
        return _from_buffer(self._record, _FLOAT, context.nq, context.q_at)

    @property
    def velocity(self) -> Array:
        """Commanded joint velocities (nv,) [rad/s or m/s]."""
        context = self._context
        if context is None:
            value: Array = self._values["velocity"]
            return value
        return _from_buffer(self._record, _FLOAT, context.nv, context.velocity_at)

    @property
    def q_next(self) -> Array:
        """Commanded configuration at the end of the step (nq,)."""
        context = self._context
        if context is None:
            value: Array = self._values["q_next"]
            return value
        return _from_buffer(self._record, _FLOAT, context.nq, context.q_next_at)

    @property
    def dt(self) -> float:
        """Length of the step [s]."""
        context = self._context
        if context is None:
            value: float = self._values["dt"]
            return value
        number: float = _unpacked(self._record, context.dt_at)[0]
        return number

    @property
    def clock(self) -> float:
        """The object's clock at the start of the step [s]."""
        context = self._context
        if context is None:
            value: float = self._values["clock"]
            return value
        number: float = _unpacked(self._record, context.clock_at)[0]
        return number

    @property
    def clock_next(self) -> float:
        """The object's clock at the end of the step [s]."""
        context = self._context
        if context is None:
            value: float = self._values["clock_next"]
            return value
        number: float = _unpacked(self._record, context.clock_next_at)[0]
        return number

    def __init__(
        self,
        *,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        q: Array,
        velocity: Array,
        q_next: Array,
        dt: float,
        clock: float,
        clock_next: float,
        rate: float,
        status: Status,
        reason: str = "",
        binding: tuple[BindingLimit, ...] = (),
        given_up: GivenUp = NOTHING,
        solver: SolverReport = NO_SOLVE,
        clearance: NearPair | None = None,
        build_time_s: float = 0.0,
    ) -> None:
        values = dict(locals())  # a debugger writes into the other one
        del values["self"]
        for name in ("q", "velocity", "q_next"):
            if values[name].flags.writeable:
                values[name] = read_only(values[name])
        _put(self, values)

    def __getattr__(self, name: str) -> Any:
        # Only for what is not there yet: C leaves all but the record, the context, rate and status to be read.
        if name == "_values":
            empty: dict[str, Any] = {}
            _set(self, "_values", empty)
            return empty
        values = self._values
        if name not in values:
            if name not in _FIELDS:
                raise AttributeError(f"a ControlStep has no '{name}'")
            values[name] = self._context.read(self._record, name)
        return values[name]

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a ControlStep is read-only: {name} stays; replaced({name}=…) makes another step")

    def replaced(self, **changes: Any) -> ControlStep:
        """The same step with other values."""
        return ControlStep(**{**{name: getattr(self, name) for name in _FIELDS}, **changes})

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, ({name: getattr(self, name) for name in _FIELDS},)

    def __repr__(self) -> str:
        return f"ControlStep({self.status.name}, rate {self.rate:.4g}, clock {self.clock:.6g} s, {self.explain()!r})"

    @property
    def finished(self) -> bool:
        """True if the object's clock has reached the end of the path."""
        return self.clock_next >= self.path.duration

    @property
    def state(self) -> CellState:
        """Kinematics at :attr:`q`."""
        values = self._values
        if "state" not in values:
            values["state"] = CellState(self.cell, self.q)
        state: CellState = values["state"]
        return state

    @property
    def arm_increments(self) -> Array:
        """Δ^k of Eq. (16) as commanded: displacement of each tool in its own frame during the step (N, 6) [m, rad]."""
        v = [self.velocity[s] for s in self.cell.v_slices]
        return np.array([self.state.jacobian(k) @ v[k] * self.dt for k in range(len(self.cell))])

    @property
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
        slowed = "The object waits on its path" if self.rate < _WAITS else "The object follows its path" + rate
        what = {
            Status.TRACKING: "The object follows its path",
            Status.SLOWED: slowed,
            Status.BLOCKED: "The object cannot go on",
            Status.HOLDING: "All arms brake together and hold",
            Status.FAULT: "Stopped until reset() is called with the measured configuration",
            Status.PAUSED: "Paused: the object rests on its path",
            Status.OFF_PATH: "The object is off its path",
        }[self.status]
        reasons = [self.reason] if self.reason else []
        if self.status is Status.OFF_PATH and reasons:  # its reason begins with the distance
            distance, _, rest = self.reason.partition("; ")
            what, reasons = distance[:1].upper() + distance[1:], [rest] if rest else []
        parts = [what + where, *reasons]
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


#: An object that is slowed to less than this rate waits.
_WAITS = 1e-6
_set = object.__setattr__
_from_buffer, _FLOAT = np.frombuffer, np.dtype(np.float64)
_unpacked = struct.Struct("d").unpack_from
_FIELDS = (*ControlStep.__annotations__, "path", "q", "velocity", "q_next", "dt", "clock", "clock_next")


def _put(step: ControlStep, values: dict[str, Any]) -> None:
    _set(step, "_values", values)
    _set(step, "_context", None)
    _set(step, "rate", values["rate"])
    _set(step, "status", values["status"])


def _restored(values: dict[str, Any]) -> ControlStep:
    return ControlStep(**values)


def amend(step: ControlStep, **values: Any) -> None:
    """Put words into a step that nobody has seen yet, or another status."""
    if "status" in values:
        _set(step, "status", values["status"])
    step._values.update(values)


def brakes_for_target(step: ControlStep) -> None:
    """Say that a target that moves slows the object down in this step, and no operator."""
    if step.status in (Status.SLOWED, Status.PAUSED):
        binding = tuple(b for b in step.binding if b.kind is not LimitKind.OVERRIDE)
        reason = "; ".join(filter(None, (step.reason, "the object brakes before it goes over to its new target")))
        amend(step, status=Status.SLOWED, binding=binding, reason=reason)


def off_path(distance: float, angle: float) -> str:
    """That the object is off its path by a distance [m] or an angle [rad], in words; what is 0 is not said."""
    parts = [f"{1e3 * distance:.1f} mm"] if distance > 0.0 else []
    parts += [f"{np.rad2deg(angle):.2f}°"] if angle > 0.0 else []
    return f"the object is {' and '.join(parts)} off its path"


def outside_limits(cell: RobotCell, q: Array) -> str:
    """The arm and the joint that is furthest outside its position limits, in words; empty if all are inside."""
    x, limits = cell.positions(q), cell.limits
    excess = np.maximum(limits.lower - x, x - limits.upper)
    j = int(excess.argmax())
    if not excess[j] > AT_LIMIT:
        return ""
    arm, _, joint = cell.joint_names[j].partition("/")
    slides = "P" in cell.model.joints[j + 1].shortname()[len("JointModel") :][:1]
    return f"arm {arm} started outside its limits: {joint} is {amount(float(excess[j]), slides=slides)} outside"


class Controller(Protocol):
    """The protocol of the controllers of :func:`coopqp.simulation.simulate.simulate`."""

    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    dt: float

    def reset(self, q: ArrayLike) -> None:
        """Start at rest at a measured configuration (nq,), with the object's clock at 0.

        Raises:
            InvalidInputError: wrong shape, NaN, or the arms do not hold the object at ``q``.
        """
        ...

    def step(self, q_measured: ArrayLike | None = None, *, dt: float | None = None) -> ControlStep:
        """Compute the command of one period. Run-time data never raise an error."""
        ...


def short_text(controller: Controller) -> str:
    """What a controller is made of, for its ``repr``."""
    arms = f"{len(controller.cell)} arm{'s' * (len(controller.cell) != 1)}"
    return f"{type(controller).__name__}({arms}, dt {controller.dt:g} s, {controller.path!r})"


#: Default of the largest accepted error of an arm at reset [m, rad].
START_TOLERANCE_M, START_TOLERANCE_RAD = 0.02, np.deg2rad(3.0)


def check_start(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath,
    q: ArrayLike,
    *,
    tolerance_m: float,
    tolerance_rad: float,
    clock: float = 0.0,
) -> Array:
    """Check that the arms hold the object where the path is at ``clock`` [s]. Returns ``q`` (nq,) as a read-only array.

    Raises:
        InvalidInputError: an arm does not; the message names the arm and its distance from the path.
    """
    configuration = cell.check_configuration(q, "reset: q")
    guarded = GuardedPath(path)
    start = guarded.pose(clock)
    if start is None:
        raise InvalidInputError(guarded.problem, "reset", "A path needs a pose where it starts.")
    where = f"its path at {clock:g} s" if clock > 0.0 else "the start of its path"
    for name, O in zip(cell.arm_names, grasp.carried(CellState(cell, configuration)), strict=True):
        error = pin.log6(start.actInv(O)).vector
        d, a = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if d > tolerance_m or a > tolerance_rad:
            raise InvalidInputError(
                f"arm '{name}' holds the object {1e3 * d:.1f} mm and {np.rad2deg(a):.2f}° from {where} "
                f"(tolerance {1e3 * tolerance_m:g} mm, {np.rad2deg(tolerance_rad):.3g}°)",
                "reset: q",
                "Start where the arms meet the grasp (coopqp.inverse_kinematics, coopqp.planning.find_start), or widen "
                "the start tolerance.",
            )
    return read_only(configuration)
