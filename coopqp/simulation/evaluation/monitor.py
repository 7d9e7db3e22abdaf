"""An independent monitor: checks that commands keep the limits, the chain, the path and the controller's promises.

The monitor checks commands, and wrenches where it is given them, and shares no code with the controllers: kinematics
come directly from Pinocchio's frames and limits from the cell. Use it to test your own controller, after a run
(:func:`check_run`) or during one (:class:`Monitor`, :class:`coopqp.simulation.Monitored`).
"""

from __future__ import annotations

import copy
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, final

import numpy as np

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_floats, as_options
from coopqp.collision.scene import CollisionScene
from coopqp.control.interface import Controller, ControlStep, Status
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.joint_limits import LIMIT_FIELDS
from coopqp.paths.path import ObjectPath
from coopqp.simulation.evaluation.assessment import Tolerances
from coopqp.simulation.evaluation.closeness import Closeness
from coopqp.simulation.evaluation.metrics import acceleration_use, check_recording, held_poses, object_gaps, outside
from coopqp.simulation.evaluation.violations import Check, Verdict, Violation, ViolationKind, Worst, owners
from coopqp.simulation.evaluation.wrenches import WrenchBounds, friction_use, internal_forces, read_loads, wrench_checks
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array, Flags

#: Accepted errors of commands, whose arms turn together more closely than measured ones.
COMMANDED = Tolerances(chain_deg=math.degrees(1e-3), object_deg=math.degrees(1e-2))
#: Rounding of limits [rad, m, rad/s or m/s; a share for accelerations], of commands that must be equal, of margins [m].
POSITION, VELOCITY, ACCELERATION, SAME, MARGIN = 1e-9, 1e-9, 1e-6, 1e-9, 1e-6
#: Accepted braking time of all arms together along a curved path, as a multiple of the slowest joint's braking time.
_BRAKING_SLACK = 1.1


@dataclass(frozen=True, eq=False)
class Block:
    """T consecutive steps as arrays."""

    q: Array  # (T, nq)
    q_next: Array  # (T, nq)
    velocity: Array  # (T, nv)
    dt: Array  # (T,)
    clock: Array  # (T,)
    clock_next: Array  # (T,)
    rate: Array  # (T,)
    sense: Array  # (T,): 1 along the path, −1 back, 0 away from it, by hand
    holding: Flags  # (T,)
    same_path: Flags  # (T,): the clock continues from the step before
    reference: Array  # (T, 4, 4): pose of the path at clock_next
    duration: Array  # (T,)
    shift: Array | None = None  # (T, N, 6): of the grasps at q_next


@final
class Monitor:
    """Checks the commands of one controller, step by step or many steps at once.

    Args:
        cell: cell with the true limits and kinematics, even if the controller assumes others.
        grasp: intended placements of the tools on the object.
        path: path of the object; by default the path in each step.
        tolerances: accepted errors of commands; :data:`COMMANDED` by default, also for what a dictionary leaves out.
        keep: number of violations stored with details; all are counted.
        kinematics: also check the chain and the path; this doubles the cost of a step.
        scene: also check the distances of its bodies, in steps and between them, by another way than a controller's.
        wrenches: also check the wrenches that :meth:`observe` is given, from the first motion of the object on.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath | None = None,
        *,
        tolerances: Tolerances | Mapping[str, Any] | None = None,
        keep: int = 50,
        kinematics: bool = True,
        scene: CollisionScene | None = None,
        wrenches: WrenchBounds | Mapping[str, Any] | None = None,
    ) -> None:
        grasp.check_arms(cell)
        self._bounds = None if wrenches is None else as_options(WrenchBounds, wrenches, "Monitor: wrenches")
        if self._bounds is not None:
            self._bounds.check_arms(len(cell))
        self._closeness = None if scene is None else Closeness(scene)
        self.cell, self.grasp, self.path = cell, grasp, path
        self.tolerances = as_options(Tolerances, tolerances, "Monitor: tolerances")
        if tolerances is None or isinstance(tolerances, Mapping):
            self.tolerances = replace(COMMANDED, **(tolerances or {}))
        self._keep, self._kinematics = keep, kinematics
        self._limits = copy.deepcopy(cell.limits)
        self._accelerates = bool(np.isfinite(self._limits.acceleration).any())
        self._joints, self._arms = owners(cell)
        self._second = [self._arms[k] for k in np.triu_indices(len(cell), 1)[1]]  # of each pair of two arms
        self.reset()

    def reset(self) -> None:
        """Forget everything. The next step starts from rest."""
        self._steps, self._time = 0, 0.0
        self._violations: list[Violation] = []
        self._counts: Counter[ViolationKind] = Counter()
        self._worst: dict[str, float] = {}
        self.restart()

    def restart(self) -> None:
        """Let the next step start from rest at any configuration. Earlier violations are kept."""
        self._last_q: Array | None = None
        self._last_v = np.zeros(self.cell.nv)
        self._last_clock, self._held = 0.0, 0.0
        self._last_path: ObjectPath | None = None
        self._moved = False

    # -- judging -----------------------------------------------------------------------------------------------------

    def observe(
        self, step: ControlStep, *, wrenches: ArrayLike | None = None, shift: Array | None = None
    ) -> tuple[Violation, ...]:
        """Check one step; return its violations.

        Args:
            step: the step.
            wrenches: wrenches of the arms on the object that the controller was given for the step, each at the origin
                and in the axes of its tool (N, 6) [N, N·m]; checked by the monitor's ``wrenches``.
            shift: motion by which each grasp has given way in the step, in the object frame (N, 6) [m, rad]:
                :attr:`coopqp.ForceController.shift`.

        Raises:
            InvalidInputError: a shift of another shape; nothing is then checked.
        """
        before, moved = len(self._violations), self._moved
        self.observe_all([step], shifts=None if shift is None else [shift])
        if self._bounds is not None and wrenches is not None and moved:
            self._check_wrenches(self._bounds, wrenches)
        return tuple(self._violations[before:])

    def observe_all(
        self, steps: Sequence[ControlStep], *, shifts: Sequence[Array] | None = None
    ) -> tuple[Violation, ...]:
        """Check consecutive steps at once, at a lower cost per step; return their stored violations (see ``keep``).

        Raises:
            InvalidInputError: not one shift (N, 6) for each step; nothing is then checked.
        """
        wanted = (len(self.cell), 6)
        if shifts is not None and (len(shifts) != len(steps) or any(np.shape(shift) != wanted for shift in shifts)):
            raise InvalidInputError(
                f"shapes {[np.shape(shift) for shift in shifts]}", "Monitor: shift", f"Give one {wanted} for each step."
            )
        before, judged = len(self._violations), 0
        for i, step in enumerate([*steps, None]):
            faults = [] if step is None else list(faults_of(step, self.cell))
            if i > judged and (faults or step is None):
                self._check(self._block(steps[judged:i], None if shifts is None else shifts[judged:i]))
            for kind, detail, owner in faults:
                amount = 0.0 if kind is ViolationKind.FORM else np.nan
                self._add(kind, self._steps, self._time, owner.partition("/")[::2], amount, detail)
            if faults:
                self._lose(1)
                judged = i + 1
        return tuple(self._violations[before:])

    def report(self, kind: ViolationKind, *, arm: str = "", amount: float = 0.0, detail: str = "") -> None:
        """Add a violation found by the caller to the verdict."""
        self._add(kind, max(self._steps - 1, 0), self._time, (arm, ""), amount, detail)

    def verdict(self) -> Verdict:
        """The verdict so far."""
        for name in LIMIT_FIELDS:
            if not np.array_equal(getattr(self.cell.limits, name), getattr(self._limits, name)):
                self.report(ViolationKind.MUTATED, detail=f"the cell's limits: {name}")
        return Verdict(self._steps, tuple(self._violations), MappingProxyType(dict(self._counts)), Worst(**self._worst))

    def _add(
        self, kind: ViolationKind, step: int, time: float, who: tuple[str, str], amount: float, detail: str
    ) -> None:
        self._counts[kind] += 1
        if len(self._violations) < self._keep:
            self._violations.append(Violation(kind, step, time, *who, amount, detail))

    def _lose(self, steps: int) -> None:
        """Count malformed steps. They are checked no further, and the next one is not compared with them."""
        self._steps += steps
        self._last_q, self._last_path = None, None
        self._last_v, self._held = np.full(self.cell.nv, np.nan), 0.0

    def _block(self, steps: Sequence[ControlStep], shifts: Sequence[Array] | None) -> Block:
        """Consecutive sound steps as arrays."""
        paths = [step.path if self.path is None else self.path for step in steps]
        before, self._last_path = [self._last_path, *paths[:-1]], paths[-1]
        numbers = {
            name: np.array([getattr(step, name) for step in steps])
            for name in ("q", "q_next", "velocity", "dt", "clock", "clock_next", "rate", "sense")
        }
        at = list(zip(paths, numbers["clock_next"].tolist(), strict=True))
        if shifts is None and any(path.grasps is not None for path in paths):  # tools move on the object
            still = np.zeros((len(self.cell), 6))
            shifts = [still if path.grasps is None else path.grasps.shifts(clock) for path, clock in at]
        shift = None if shifts is None else np.array(shifts)
        reference = np.array([path.pose(clock).homogeneous for path, clock in at] if self._kinematics else [])
        by_hand = numbers["sense"] == 0  # no path asks for the object: it is where the first arm holds it
        if self._kinematics and by_hand.any():
            moved = None if shift is None else shift[by_hand]
            reference[by_hand] = held_poses(self.cell, self.grasp, numbers["q_next"][by_hand], moved)[:, 0]
        return Block(
            **numbers,
            holding=np.array([step.status in (Status.HOLDING, Status.FAULT) for step in steps]),
            same_path=np.array([a is b for a, b in zip(before, paths, strict=True)]),
            reference=reference,
            duration=np.array([path.duration for path in paths]),
            shift=shift,
        )

    def check_recorded(self, recording: Recording) -> Verdict:
        """Check a run; see :func:`check_run`."""
        r, goes_on = recording, False
        for part in r.parts(r.n_steps):
            end = part.start
            for sound, run in itertools.groupby(_sound(r, part).tolist()):
                start, end = end, end + len(list(run))
                if sound:
                    self._check(_recorded(r, start, end, goes_on=goes_on))
                else:
                    for row in range(start, end):
                        self._add(ViolationKind.NOT_FINITE, row, float(r.time[row]), ("", ""), np.nan, "")
                    self._lose(end - start)
                goes_on = sound
        loads = read_loads(self.cell, r)
        for check in [] if loads is None else loads.checks(self.cell):
            self._judge(check, r.time[1:], 0)
        return self.verdict()

    def _check(self, b: Block) -> None:
        ends = self._time + np.cumsum(b.dt)
        for check in self._checks(b):
            self._judge(check, ends, self._steps)
        if self._closeness is not None:
            self._check_clearance(self._closeness, b, ends)
        self._steps += len(ends)
        self._moved = self._moved or bool((b.rate > 0.0).any())
        self._time = float(ends[-1])
        self._last_q, self._last_v = b.q_next[-1].copy(), b.velocity[-1].copy()
        self._last_clock = float(b.clock_next[-1])

    def _judge(self, check: Check, ends: Array, first: int) -> None:
        """Note the largest value of a check, and a violation for each that is too large.

        Args:
            check: the check of consecutive steps.
            ends: times of their ends (T,) [s].
            first: number of the first of them.
        """
        kind, values, bound, who, detail, rounding, worst, largest_only = check
        if not values.size:  # a single arm forms no chain
            return
        values, largest = values.reshape(len(ends), -1), float(values.max())
        if worst:
            self._worst[worst] = float(np.maximum(self._worst.get(worst, -np.inf), largest))
        if largest <= bound + rounding:
            return
        found = np.argwhere(~(values <= bound + rounding))
        if largest_only:
            found = np.array([(i, values[i].argmax()) for i in np.unique(found[:, 0])])
        for i, k in found.tolist():
            owner = who[k] if who else ("", "")
            self._add(kind, first + i, float(ends[i]), owner, float(values[i, k] - bound), detail)

    def _checks(self, b: Block) -> Iterator[Check]:
        """What steps are to keep."""
        kinds, cell, limits, joints = ViolationKind, self.cell, self._limits, self._joints
        x, x_next = cell.positions(b.q), cell.positions(b.q_next)
        v_before = np.vstack([self._last_v, b.velocity[:-1]])
        further = outside(limits, x_next) - np.maximum(outside(limits, x), 0.0)  # a joint outside may come back
        yield Check(kinds.POSITION, further, 0.0, joints, "", POSITION, "position")
        yield Check(kinds.VELOCITY, np.abs(b.velocity) - limits.velocity, 0.0, joints, "", VELOCITY, "velocity")
        if self._accelerates:
            excess = acceleration_use(limits, b.velocity, v_before, b.dt) - 1.0
            excess[np.isnan(v_before)] = -1.0
            yield Check(kinds.ACCELERATION, excess, 0.0, joints, "", ACCELERATION, "acceleration")
        gap = np.abs(self._difference(x, x_next) - b.velocity * b.dt[:, None])
        yield Check(kinds.CONTINUITY, gap, 0.0, joints, "q_next is not q + v dt", SAME)
        before = np.vstack([b.q[:1] if self._last_q is None else self._last_q, b.q_next[:-1]])
        jump = np.abs(self._difference(cell.positions(before), x))
        yield Check(kinds.CONTINUITY, jump, 0.0, joints, "q is not the last q_next", SAME)
        if not cell.euclidean:
            cosines = cell.position_index[cell.continuous]
            radius = np.hypot(b.q_next[:, cosines], b.q_next[:, cosines + 1])
            yield Check(kinds.CONTINUITY, np.abs(radius - 1.0), SAME, detail="off the unit circle")
        yield Check(kinds.RATE, np.maximum(-b.rate, b.rate - 1.0), SAME, detail="σ in [0, 1]")
        yield Check(kinds.RATE, np.where(b.dt > 0.0, 0.0, 1.0), detail="dt > 0")
        advance = b.clock_next - b.clock
        # On the way back the clock falls; by hand it stands.
        yield Check(kinds.CLOCK, -b.sense * advance, SAME, detail="runs backwards")
        # The last step may advance the clock by less than σ dt.
        miss = b.sense * advance - np.abs(b.sense) * b.rate * b.dt
        miss = np.where(b.clock_next >= b.duration, miss, np.abs(np.where(b.sense == 0.0, advance, miss)))
        yield Check(kinds.CLOCK, miss - SAME * (1.0 + b.clock_next), detail="does not advance by σ dt")
        jump = b.clock - np.concatenate([[self._last_clock], b.clock_next[:-1]])
        yield Check(kinds.CLOCK, np.where(b.same_path, np.abs(jump), 0.0), SAME, detail="jumps")
        yield Check(kinds.HOLDING, self._overdue(b, v_before), 0.0, detail="σ", rounding=SAME)
        if not self._kinematics:
            return
        t, pairs = self.tolerances, len(self._second)
        distance, angle = object_gaps(cell, self.grasp, b.q_next, b.reference, b.shift)
        for kind, who, part, m, rad in (
            (kinds.CHAIN, self._second, slice(pairs), 1e-3 * t.chain_mm, math.radians(t.chain_deg)),
            (kinds.PATH, self._arms, slice(pairs, None), 1e-3 * t.object_mm, math.radians(t.object_deg)),
        ):
            name = kind.name.lower()
            yield Check(kind, distance[:, part], m, who, "[m]", 0.0, f"{name}_m", largest_only=True)
            yield Check(kind, angle[:, part], rad, who, "[rad]", 0.0, f"{name}_rad", largest_only=True)

    def _difference(self, start: Array, end: Array) -> Array:
        """Displacement of joints (T, nv) [rad or m]; of continuous ones the shorter way."""
        d: Array = end - start
        if not self.cell.euclidean:
            turns = d[:, self.cell.continuous]
            d[:, self.cell.continuous] = np.arctan2(np.sin(turns), np.cos(turns))
        return d

    def _overdue(self, b: Block, v_before: Array) -> Array:
        """σ (T,) where a holding object should rest: the braking time of its slowest joint is over; else 0."""
        over = np.zeros(len(b.dt))
        for i, holding in enumerate(b.holding.tolist()):
            if not holding:
                self._held = 0.0
                continue
            if self._held == 0.0:
                fastest = np.nan_to_num(np.abs(v_before[i]) / self._limits.acceleration).max()
                self._may_take = _BRAKING_SLACK * float(fastest) + 2.0 * float(b.dt[i])
            self._held += float(b.dt[i])
            if self._held > self._may_take + 1e-9:
                over[i] = b.rate[i]
        return over

    def _check_wrenches(self, bounds: WrenchBounds, wrenches: ArrayLike) -> None:
        """A wrench may be missing (NaN): its palm is not checked then, and no internal force."""
        try:
            w = as_floats(wrenches)
        except NOT_NUMBERS:
            w = np.zeros(0)
        if w.shape != (len(self.cell), 6):
            self.report(ViolationKind.FORM, detail=f"wrenches of shape ({len(self.cell)}, 6)")
            return
        came = np.isfinite(w).all(axis=1)
        internal = internal_forces(self.grasp, w) if came.all() else np.zeros(len(w))
        used = None if bounds.palms is None else np.where(came, friction_use(bounds.palms, w), 0.0)
        for check in wrench_checks(self.cell, internal, bounds.internal_force, used):
            self._judge(check, np.array([self._time]), self._steps - 1)

    def _check_clearance(self, closeness: Closeness, b: Block, ends: Array) -> None:
        if self._last_q is None or not np.array_equal(self._last_q, b.q[0]):
            closeness.start(b.q[0])
        for i, pair, missing in closeness.watch(np.vstack([b.q[:1], b.q_next]), tolerance=MARGIN):
            self._worst["clearance_m"] = max(self._worst.get("clearance_m", 0.0), missing)
            missing -= MARGIN
            self._add(ViolationKind.CLEARANCE, self._steps + i, float(ends[i]), ("", ""), missing, f"[m] {pair}")


def faults_of(step: ControlStep, cell: RobotCell) -> Iterator[tuple[ViolationKind, str, str]]:
    """Wrong shapes and types of a step, and numbers that are not finite: kind, explanation, name of the joint."""
    form, not_finite = ViolationKind.FORM, ViolationKind.NOT_FINITE
    for name, size in (("q", cell.nq), ("q_next", cell.nq), ("velocity", cell.nv)):
        value = getattr(step, name)
        if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != (size,):
            yield form, f"{name} of shape ({size},)", ""
        elif not np.isfinite(value).all():
            bad = int(np.isfinite(value).argmin())
            yield not_finite, f"{name}[{bad}]", cell.joint_names[bad] if name == "velocity" else ""
    for name in ("dt", "clock", "clock_next", "rate"):
        value = getattr(step, name)
        if not isinstance(value, float):
            yield form, f"{name} is no float", ""
        elif not math.isfinite(value):
            yield not_finite, name, ""
    if step.sense not in (-1, 0, 1):
        yield form, "sense is not -1, 0 or 1", ""
    if not isinstance(step.status, Status) or not isinstance(step.reason, str):
        yield form, "status or reason", ""


def _sound(r: Recording, part: slice) -> Flags:
    """Whether the numbers of steps are finite."""
    samples = slice(part.start, part.stop + 1)
    sound = np.isfinite(r.q_command[samples]).all(axis=1) & np.isfinite(r.clock[samples])
    sound &= np.isfinite(r.time[samples])
    return sound[:-1] & sound[1:] & np.isfinite(r.velocity[part]).all(axis=1) & np.isfinite(r.rate[part])


def _recorded(r: Recording, start: int, end: int, *, goes_on: bool) -> Block:
    """Steps from ``start`` up to ``end``; ``goes_on``: the first one continues the step before."""
    cut, ends = slice(start, end), slice(start + 1, end + 1)
    status, clock, clock_next, steps = r.status[cut], r.clock[cut], r.clock[ends], np.arange(start, end)
    return Block(
        q=r.q_command[cut],
        q_next=r.q_command[ends],
        velocity=r.velocity[cut],
        dt=np.diff(r.time[start : end + 1]),
        clock=clock,
        clock_next=clock_next,
        rate=r.rate[cut],
        sense=np.where(status == Status.JOGGING.code, 0.0, np.where(clock_next < clock, -1.0, 1.0)),
        holding=np.isin(status, (Status.HOLDING.code, Status.FAULT.code)),
        same_path=(steps > start) | goes_on,
        reference=r.reference[ends],
        duration=np.full(len(steps), float(r.metadata.get("duration") or np.inf)),
        shift=None if r.shift is None else r.shift[cut],
    )


def check_run(
    recording: Recording,
    cell: RobotCell,
    *,
    tolerances: Tolerances | Mapping[str, Any] | None = None,
    scene: CollisionScene | None = None,
) -> Verdict:
    """Check a recorded run by its commands, and by its loads where they were recorded.

    Args:
        recording: the run, which starts at rest.
        cell: cell with the true limits and kinematics.
        tolerances: as for :class:`Monitor`.
        scene: bodies whose distances are checked, too.

    Raises:
        InvalidInputError: a recording of another cell.
    """
    check_recording(cell, recording)
    return Monitor(cell, recording.grasp, tolerances=tolerances, scene=scene).check_recorded(recording)


@final
class Monitored:
    """A controller with a monitor. The monitor checks every step, and detects changes of the caller's arrays.

    A controller that needs wrenches gets them. The monitor sees them, too, and by how much the grasps give way.

    Args:
        controller: the checked controller; use its other methods directly.
        monitor: the monitor; by default a new one for the controller's cell and grasp.
    """

    def __init__(self, controller: Controller, monitor: Monitor | None = None) -> None:
        self.controller = controller
        self.cell, self.grasp, self.dt = controller.cell, controller.grasp, controller.dt
        self.monitor = monitor or Monitor(controller.cell, controller.grasp)
        self._inner: Any = controller
        self.needs_wrenches = bool(getattr(controller, "needs_wrenches", False))
        self.needs_servos = bool(getattr(controller, "needs_servos", False))
        self._last: tuple[dict[str, Any], dict[str, Array]] = {}, {}

    @property
    def path(self) -> ObjectPath:
        """The controller's path."""
        return self.controller.path

    @property
    def shift(self) -> Array:
        """Motion by which each grasp has given way (N, 6) [m, rad], for a controller with such a motion."""
        return self._inner.shift

    def reset(self, q: ArrayLike) -> None:
        """Reset the controller. The monitor keeps its violations."""
        given = {"q of reset": q}
        kept = _copies(given)
        self.controller.reset(q)
        self._unchanged(given, kept)
        self.monitor.restart()
        self._last = {}, {}

    def step(
        self, q_measured: ArrayLike | None = None, *, wrenches: ArrayLike | None = None, dt: float | None = None
    ) -> ControlStep:
        """Compute and check the controller's step."""
        given = {"q_measured": q_measured, "wrenches": wrenches}
        kept = _copies(given)
        more = {"wrenches": wrenches} if self.needs_wrenches else {}
        step: ControlStep = self._inner.step(q_measured, dt=dt, **more)
        self._unchanged(given, kept)
        self.monitor.observe(step, wrenches=wrenches, shift=getattr(self, "shift", None))
        self._unchanged(*self._last)
        made = {f"{name} of the step before": getattr(step, name) for name in ("q", "velocity", "q_next")}
        self._last = made, _copies(made)
        return step

    def verdict(self) -> Verdict:
        """The verdict so far."""
        return self.monitor.verdict()

    def _unchanged(self, now: Mapping[str, Any], before: Mapping[str, Array]) -> None:
        for what, kept in before.items():
            if not np.array_equal(now[what], kept, equal_nan=kept.dtype.kind == "f"):
                self.monitor.report(ViolationKind.MUTATED, detail=what)


def _copies(values: Mapping[str, Any]) -> dict[str, Array]:
    return {name: value.copy() for name, value in values.items() if isinstance(value, np.ndarray)}
