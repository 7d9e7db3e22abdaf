"""The interface of all controllers: ``reset(q)``, then ``step() → ControlStep`` in every period."""

from __future__ import annotations

import enum
import math
import operator
import struct
from dataclasses import dataclass
from typing import Any, Protocol, final

import numpy as np

from coopqp.checks import ArrayLike, read_only
from coopqp.constraints.cause import Cause
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit
from coopqp.model.shapes import NearPair
from coopqp.model.state import CellState
from coopqp.paths.moving_grasps import grasp_at
from coopqp.paths.path import ObjectPath
from coopqp.shown import Shown
from coopqp.spatial import Array


class Status(enum.Enum):
    """Status of a step. With every status but FAULT, the command advances or brakes the motion."""

    TRACKING = "tracking"  #: the object follows its path at full rate
    SLOWED = "slowed"  #: the object follows its path at a lower rate (σ < 1)
    BLOCKED = "blocked"  #: the object cannot move on (σ ≈ 0): a limit, a singularity, or out of reach
    HOLDING = "holding"  #: bad input, no solution, a stale clock or arms out of step: all arms brake together and rest
    FAULT = "fault"  #: latched: the arms rest until ``reset`` is called with the measured configuration
    PAUSED = "paused"  #: the object rests on its path because its operator paused it, or set the override to 0
    OFF_PATH = "off path"  #: the object is further from its path than ``off_path_distance`` or ``off_path_angle``
    JOGGING = "jogging"  #: the operator leads the object by hand, or it rests where the operator has led it
    WAITING = "waiting"  #: the object rests on its path at a gate, until a signal comes

    @property
    def code(self) -> int:
        """Number of the status in recordings."""
        return _STATUS_ORDER.index(self)

    @property
    def precedence(self) -> int:
        """Among several statuses that apply, the highest precedence wins; 0 for TRACKING."""
        return _PRECEDENCE.index(self)


_STATUS_ORDER = list(Status)
_PRECEDENCE = (
    Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.PAUSED, Status.WAITING, Status.JOGGING, Status.OFF_PATH,
    Status.HOLDING, Status.FAULT,
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


_set = object.__setattr__
_from_buffer, _FLOAT = np.frombuffer, np.dtype(np.float64)
_unpacked = struct.Struct("d").unpack_from


def _array(name: str, size: str, meaning: str) -> Any:
    """An array in the record, or among the values of a step without one."""
    place = operator.attrgetter(size, f"{name}_at")

    def read(step: ControlStep) -> Array:
        context = step._context
        if context is None:
            value: Array = step._values[name]
            return value
        return _from_buffer(step._record, _FLOAT, *place(context))

    return property(read, doc=meaning)


def _clock(name: str, meaning: str) -> Any:
    """A clock of the program, by that of what is followed in the record, or among the values of a step without one."""
    place = operator.attrgetter(f"{name}_at", "way")

    def read(step: ControlStep) -> float:
        context = step._context
        if context is None:
            value: float = step._values[name]
            return value
        at, way = place(context)
        program_clock: float = way.origin + way.sense * _unpacked(step._record, at)[0]
        return program_clock

    return property(read, doc=meaning)


def _number(name: str, meaning: str) -> Any:
    """A number in the record, or among the values of a step without one."""
    place = operator.attrgetter(f"{name}_at")

    def read(step: ControlStep) -> float:
        context = step._context
        value: float = step._values[name] if context is None else _unpacked(step._record, place(context))[0]
        return value

    return property(read, doc=meaning)


@final
class ControlStep(Shown):
    """The command of one step, and the reason for it.

    The core hands out a record of numbers: an attribute is read from it when asked for. Arrays are
    read-only; copy one to change it.

    Attributes:
        q: commanded configuration at the start of the step (nq,).
        velocity: commanded joint velocities (nv,) [rad/s or m/s], constant over the step.
        q_next: commanded configuration at the end of the step (nq,); send it to position servos.
        dt: length of the step [s].
        clock, clock_next: the object's clock on its program at both ends [s]; it falls on the way back, and stands
            while the operator leads the object by hand.
        sense: 1 along the program, −1 on the way back, 0 away from it, by hand.
        rate: σ, share of the nominal path rate.
        status, reason: the result of the step, in a word and in a sentence.
        cause: why the status is not TRACKING, for programs; None while it is.
        binding: limits that the step runs against.
        given_up: the parts that each rank gave up.
        solver: result of the QP solver.
        commanded_apart: the largest distance of an arm's view of the object from the others' at :attr:`q` [m]: at the
            grasps, turns included, without what is left of the start's mismatch and of shifts of the grasps. NaN for
            controllers that do not watch it.
        clearance: the bodies nearest to their margin at :attr:`q`, and their distance; None without a
            :class:`coopqp.Clearance`. It is measured when it is asked for.
        build_time_s: time to compute the step without the solve [s]; 0 where it is not measured.
        finished: the object's clock has reached the end of its path.
    """

    __slots__ = ("_context", "_record", "_values", "rate", "status")

    cell: RobotCell
    grasp: Grasp
    rate: float
    status: Status
    reason: str
    cause: Cause | None
    binding: tuple[BindingLimit, ...]
    given_up: GivenUp
    solver: SolverReport
    commanded_apart: float
    clearance: NearPair | None
    build_time_s: float
    sense: int

    # Loops read these at every step: properties spare them the detour through __getattr__.
    q: Array = _array("q", "nq", "Commanded configuration at the start of the step (nq,).")
    velocity: Array = _array("velocity", "nv", "Commanded joint velocities (nv,) [rad/s or m/s].")
    q_next: Array = _array("q_next", "nq", "Commanded configuration at the end of the step (nq,).")
    dt: float = _number("dt", "Length of the step [s].")
    clock: float = _clock("clock", "The object's clock on its program at the start of the step [s].")
    clock_next: float = _clock("clock_next", "The object's clock on its program at the end of the step [s].")

    @property
    def path(self) -> ObjectPath:
        """The object's program."""
        context = self._context
        value: ObjectPath = self._values["path"] if context is None else context.path
        return value

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
        cause: Cause | None = None,
        binding: tuple[BindingLimit, ...] = (),
        given_up: GivenUp = NOTHING,
        solver: SolverReport = NO_SOLVE,
        commanded_apart: float = math.nan,
        clearance: NearPair | None = None,
        build_time_s: float = 0.0,
        sense: int = 1,
    ) -> None:
        values = dict(locals())  # a copy: debuggers write into locals()
        del values["self"]
        for name in ("q", "velocity", "q_next"):
            if values[name].flags.writeable:
                values[name] = read_only(values[name])
        _set(self, "_values", values)
        _set(self, "_context", None)
        _set(self, "rate", rate)
        _set(self, "status", status)

    def __getattr__(self, name: str) -> Any:
        # Python calls this for missing attributes only. The core fills in the record, rate and status, and as the
        # context the RecordReader that puts the record into words.
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
        v = [self.velocity[own] for own in self.cell.columns]
        return np.array([self.state.jacobian(k) @ v[k] * self.dt for k in range(len(self.cell))])

    @property
    def relative_errors(self) -> Array:
        """Distance [mm] and angle [deg] between the object poses of each pair of arms (0,1), (0,2), … (1,2) …"""
        e = grasp_at(self.grasp, self.path, self.clock).relative_errors(self.state)
        return np.column_stack([1e3 * np.linalg.norm(e[:, :3], axis=1), np.rad2deg(np.linalg.norm(e[:, 3:], axis=1))])

    @property
    def sigma_min(self) -> Array:
        """Smallest singular value of each arm's tool Jacobian (N,)."""
        return self.state.sigma_min

    def explain(self) -> str:
        """A sentence with the status, the binding limits, the reason and the lost parts of the ranks."""
        where = f" ({'; '.join(str(b) for b in self.binding)})" if self.binding else ""
        rate = f" at {100 * self.rate:.3g} % of its rate" if self.status is Status.SLOWED else ""
        follows = "The object goes back along its path" if self.sense < 0 else "The object follows its path"
        slowed = "The object waits on its path" if self.rate < _WAITS else follows + rate
        what = {
            Status.TRACKING: follows,
            Status.SLOWED: slowed,
            Status.BLOCKED: "The object cannot go on",
            Status.HOLDING: "All arms brake together and hold",
            Status.FAULT: "Stopped until reset() is called with the measured configuration",
            Status.PAUSED: "Paused: the object rests on its path",
            Status.OFF_PATH: "The object is off its path",
            Status.JOGGING: "The operator leads the object",
            Status.WAITING: "The object waits at a gate",
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
_FIELDS = (*ControlStep.__annotations__, "path")


def _restored(values: dict[str, Any]) -> ControlStep:
    return ControlStep(**values)


def amend(step: ControlStep, **values: Any) -> None:
    """Change the words, the status or the rate of a step before anyone sees it."""
    for name in ("status", "rate"):
        if name in values:
            _set(step, name, values[name])
    step._values.update(values)


def off_path(distance: float, angle: float) -> str:
    """A sentence: how far the object is off its path, by a distance [m] and an angle [rad], each unless it is 0."""
    parts = [f"{1e3 * distance:.1f} mm"] if distance > 0.0 else []
    parts += [f"{np.rad2deg(angle):.2f}°"] if angle > 0.0 else []
    return f"the object is {' and '.join(parts)} off its path"


class Controller(Protocol):
    """The protocol of the controllers of :func:`coopqp.simulate`."""

    cell: RobotCell
    grasp: Grasp
    dt: float

    @property
    def path(self) -> ObjectPath:
        """The object's path."""
        ...

    def reset(self, q: ArrayLike) -> None:
        """Start at rest at a measured configuration (nq,), or the mean of readings (n, nq), with the clock at 0.

        Raises:
            InvalidInputError: wrong shape, NaN, or the arms do not hold the object at ``q``.
        """
        ...

    def step(self, q_measured: ArrayLike | None = None, *, dt: float | None = None) -> ControlStep:
        """Compute the command of one period. Run-time data never raise an error."""
        ...


def short_text(controller: Controller) -> str:
    """The parts of a controller, for its ``repr``."""
    arms = f"{len(controller.cell)} arm{'s' * (len(controller.cell) != 1)}"
    return f"{type(controller).__name__}({arms}, dt {controller.dt:g} s, {controller.path!r})"
