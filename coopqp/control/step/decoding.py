"""From a record of numbers to words: statuses, limits by name, reasons as sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np

from coopqp.constraints.cause import Cause, cause_of_limits
from coopqp.control.interface import NO_SOLVE, NOTHING, ControlStep, GivenUp, SolverReport, Status, amend, off_path
from coopqp.control.monitoring.options import SupervisionOptions
from coopqp.control.operator.way import Way
from coopqp.control.step.constraint_set import Constraints
from coopqp.core import _core
from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.model.grasp import Grasp
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import NearPair, too_close
from coopqp.paths.guarded import jump
from coopqp.spatial import Array

_KINDS = {code: LimitKind[name] for code, name in enumerate(_core.LIMIT_KINDS) if name != "NONE"}
_REASONS = {name: code for code, name in enumerate(_core.REASONS)}
#: Causes of reasons, by their codes: the arms, nothing that slows, or an input that cannot be used.
_BY_ARMS = (
    "OUT_OF_STEP_BY", "WAS_OUT_OF_STEP", "STALLED", "ALL_STALLED", "FORCE", "HANGS_BEHIND", "OFF_SERVOS", "OFF_LAG",
    "FORCE_GROWS",
)  # fmt: skip
CAUSES = {code: Cause.TRACKING if name in _BY_ARMS else Cause.INPUT for name, code in _REASONS.items()} | {
    _REASONS["CHAIN_APART"]: None,
    _REASONS["TOUCHING"]: Cause.CONTACT,
    _REASONS["CHAIN_PARTED"]: Cause.COMMANDED_CHAIN,
    _REASONS["UNSOLVED"]: Cause.SOLVER,
}
STATUSES = tuple(Status[name.replace("FAULTED", "FAULT")] for name in _core.STATUSES)


@final
class RecordReader:
    """Puts the numbers of the records of one controller on one path into words, for its steps.

    Args:
        cell, grasp: of the controller.
        way: what it follows.
        solver: name of the solver that a QP step used.
        constraints: the further constraints.
        dt: nominal length of a step [s].
        supervision: its thresholds.

    Attributes:
        nq, nv: sizes of a configuration and of a velocity.
        q_at, velocity_at, q_next_at, dt_at, clock_at, clock_next_at: where each value begins in a record [bytes].
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        way: Way,
        *,
        solver: str,
        constraints: Constraints,
        dt: float,
        supervision: SupervisionOptions,
    ) -> None:
        self.cell, self.grasp, self.way, self.path = cell, grasp, way, way.program
        #: Statuses of steps, in the order of the core's codes.
        self.statuses = tuple(way.status(status) for status in STATUSES)
        self._solver, self._constraints = solver, constraints
        self._restricted = tuple(
            cell.arm_names[k] for k, columns in enumerate(moving_columns(cell)) if len(columns) < 6
        )
        self._force_limit, self._dt_range = supervision.force_limit, [share * dt for share in supervision.dt_range]
        record = _core.Record
        self._q: int = record.NUMBERS
        velocity = self._q + cell.nq
        q_next = velocity + cell.nv
        self._off_path = q_next + cell.nq
        self.nq, self.nv = cell.nq, cell.nv
        self.q_at, self.velocity_at, self.q_next_at = 8 * self._q, 8 * velocity, 8 * q_next
        self.dt_at, self.clock_at, self.clock_next_at = record.dt_at, record.clock_at, record.clock_next_at

    def read(self, record: bytes, name: str) -> Any:
        """Value of the attribute ``name`` of :class:`coopqp.ControlStep`."""
        if name in ("cell", "grasp"):
            return getattr(self, name)
        if name == "build_time_s":
            return 0.0
        if name == "sense":
            return self.way.sense
        return getattr(self, f"_read_{name}")(_core.Record.of(record), np.frombuffer(record))

    def _read_reason(self, s: Any, r: Array) -> str:
        distance, angle = s.away, s.turned
        away = off_path(distance, angle) if distance > 0.0 or angle > 0.0 else ""
        holds = STATUSES[int(s.status)] in (Status.HOLDING, Status.FAULT)
        near = "" if holds else too_close(self._constraints.inside(self._q_of(r)))
        return "; ".join(filter(None, (away, self._read_code(s), near)))

    def _read_code(self, s: Any) -> str:
        code = int(s.reason)
        if code == _REASONS["NO_REASON"]:
            return ""
        given = s.reason_index, s.reason_a, s.reason_b
        if code == _REASONS["BAD_DT"]:
            return f"dt is not accepted: {given[1]:g} s is outside [{self._dt_range[0]:g}, {self._dt_range[1]:g}] s"
        return reason(self.cell, self._force_limit, code, *given)

    def _read_commanded_apart(self, s: Any, r: Array) -> float:
        return float(s.apart)

    def _read_cause(self, s: Any, r: Array) -> Cause | None:
        if s.braked:
            return Cause.SOLVER
        status, code = STATUSES[int(s.status)], int(s.reason)
        watched = CAUSES[code] if code else None
        binding = self._read_binding(s, r)
        return self.way.cause(status, cause_of(status, watched, binding, measured=s.measured != 0.0), binding)

    def _read_binding(self, s: Any, r: Array) -> tuple[BindingLimit, ...]:
        begin = self._off_path + 6
        entries = r[begin : begin + 4 * int(s.bindings)].reshape(-1, 4)
        binding = tuple(self.limit(*(int(x) for x in entry)) for entry in entries)
        if not self._constraints:
            return binding
        q = self._q_of(r)
        return tuple(dict.fromkeys((*self._constraints.inside(q), *self._constraints.measured(binding, q))))

    def _q_of(self, r: Array) -> Array:
        return r[self._q : self._q + self.nq]

    def _read_clearance(self, s: Any, r: Array) -> NearPair | None:
        return self._constraints.nearest(self._q_of(r))

    @staticmethod
    def put_words(
        step: ControlStep, code: int, said: Mapping[int, str], *, report: SolverReport | None, held_by: Cause
    ) -> None:
        """Put into a step what numbers do not describe.

        Args:
            step: made with the reason of this code.
            said: reasons in words, by their codes.
            report: what a solver of the user's says of it; None if none was asked.
            held_by: the cause of a hold by a constraint.
        """
        values: dict[str, Any] = {} if report is None else {"solver": report}
        braked = report is not None and code == _REASONS["UNSOLVED"]
        fault = unsolved(report) if braked else said.get(code, "")
        if fault and step.status is Status.OFF_PATH:  # how far it is off comes first
            fault = f"{step.reason.partition('; ')[0]}; {fault}"
        if fault:
            values["reason"] = fault
        if code == _REASONS["CONSTRAINT_FAILED"]:
            values["cause"] = held_by
        amend(step, **values)

    def limit(self, kind: int, arm: int, joint: int, constraint: int) -> BindingLimit:
        """A limit by name."""
        if constraint >= 0:
            return self._constraints.labels[constraint]
        if joint >= 0:
            return self.cell.joint_limit(joint, _KINDS[kind])
        return BindingLimit(self.cell.arm_names[arm] if arm >= 0 else "", "", _KINDS[kind])

    def _read_given_up(self, s: Any, r: Array) -> GivenUp:
        off_path = tuple(r[self._off_path : self._off_path + 6].tolist())
        lost, parting = [1.0 - share for share in (s.grasp_share, s.path_share, s.rate)], s.parting
        if not (any(lost) or any(off_path) or parting or self._restricted):
            return NOTHING
        return GivenUp(
            chain=parting, grasp=lost[0], off_path=off_path, path=lost[1], rate=lost[2], restricted=self._restricted
        )

    def _read_solver(self, s: Any, r: Array) -> SolverReport:
        if s.outcome != _core.OUTCOMES.index("QP"):
            return NO_SOLVE
        return SolverReport(self._solver, "solved", int(s.iterations))


_BOTH = (_REASONS["CHAIN_APART"], _REASONS["CHAIN_PARTED"])


def unsolved(report: SolverReport | None) -> str:
    """Why the arms brake, with what a solver of the user's says."""
    if report is None or report.name == "ldp":
        return "the QP has no usable answer; braking"
    return f"the QP has no usable answer ({': '.join(filter(None, (report.status, report.message)))}); braking"


_PARTED = "arms {arm} and {other} are commanded {mm:.2g} mm apart"
#: The sentence of each reason, by the joint or arm i and two numbers a and b. Those of :func:`reason` have their own.
_SENTENCES = {
    "UNSOLVED": unsolved(None),
    "NO_REASON": "",
    "TOUCHING": "the arms hold",
    "OFF_CIRCLE": "q_measured[{i}] and [{next}] are no cosine and sine (norm {a:.3g})",
    "JUMPED": "joint {joint} is measured {a:.3g} rad (or m) from its command",
    "ALL_STALLED": "no arm is seen to follow its command (all have stopped, or measurements are stale)",
    "PATH_FAILED": "the path has no pose at its clock {a:.6g} s",
    "LOOK_AHEAD_FAILED": "the path ahead of its clock {a:.6g} s cannot be asked",
    "CONSTRAINT_FAILED": "a constraint cannot be asked",
    "CHAIN_APART": _PARTED,
    "CHAIN_PARTED": _PARTED,
    "OUT_OF_STEP_BY": "arm {arm} is {mm:.2f} mm out of step with the others",
    "WAS_OUT_OF_STEP": "arm {arm} was out of step",
    "STALLED": "arm {arm} does not follow its command (stalled)",
    "FORCE": "{a:.0f} N at the grasp of arm {arm} by its servos (limit {limit:g} N)",
    "FORCE_GROWS": "{a:.0f} N at the grasp of arm {arm} by its servos, soon {b:.0f} N (limit {limit:g} N)",
    "OFF_SERVOS": "arm {arm} is {mm:.2f} mm from where its wrench puts its servos",
    "OFF_LAG": "arm {arm} seems to have stopped in its grip: the arms are {mm:.2f} mm from where a lag could put them",
    "HANGS_BEHIND": (
        "arm {arm} does not follow its command: it hangs {mm:.2g} mm behind, and the others pull it with {b:.0f} N"
    ),
}


def reason(cell: RobotCell, force_limit: float, code: int, index: float, a: float, b: float) -> str:
    """The sentence of a reason of :data:`_core.REASONS`."""
    if code == _REASONS["PATH_JUMPS"]:
        return jump(b, a)
    if code == _REASONS["OFF_WAY"]:
        name = cell.joint_names[int(b)]
        arm = name.partition("/")[0]
        return f"arm {arm} is not on the way of its joints: {name} is {a:.3g} rad (or m) off"
    i, other = int(index), int(b) if code in _BOTH else 0
    if code == _REASONS["NOT_FINITE"]:
        return _unmeasured(cell, i)
    arm, joint = (names[i] if i < len(names) else "" for names in (cell.arm_names, cell.joint_names))
    words = {"arm": arm, "joint": joint, "other": cell.arm_names[other], "limit": force_limit}
    return _SENTENCES[_core.REASONS[code]].format(i=i, next=i + 1, a=a, b=b, mm=1e3 * a, **words)


def _unmeasured(cell: RobotCell, i: int) -> str:
    """The reason for entry i of a measured configuration that is no number."""
    joint = int(np.searchsorted(cell.position_index, i, side="right")) - 1
    return f"joint {cell.joint_names[max(joint, 0)]} has no finite measured position"


def cause_of(
    status: Status, watched: Cause | None, binding: tuple[BindingLimit, ...], *, measured: bool
) -> Cause | None:
    """Why a status is not TRACKING; None if it is.

    Args:
        status: of the step.
        watched: cause of what the supervision found; None if it found nothing. A hold without one is the solver's.
        binding: limits that the step runs against.
        measured: measurements have a share in the object's distance from its path.
    """
    if status is Status.TRACKING:
        return None
    if status is Status.PAUSED:
        return Cause.OPERATOR
    if status in (Status.HOLDING, Status.FAULT):
        return watched or Cause.SOLVER
    # Without a limit the bound on the rate's rise slows the object, and a path that it was given away from it is far.
    rest = Cause.LIMIT if status is not Status.OFF_PATH else Cause.TRACKING if measured else Cause.INPUT
    return cause_of_limits(binding) or watched or rest
