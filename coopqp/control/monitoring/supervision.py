"""Supervision: comparison of measured with commanded configurations.

An arm that lags or stalls pulls on the object that the others carry on. The supervision compares, for every arm, the
measured with the commanded pose of the object that it carries, and slows the object before the arms part too far.
Deviations common to all arms do not count: they only displace the object. The core's counterpart is ``watch.cpp``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coopqp.checks import NOT_NUMBERS, as_floats, as_scalar
from coopqp.constraints.cause import Cause
from coopqp.control.monitoring.drift import Drift, from_others, mean_where
from coopqp.control.monitoring.lag import OFF_LAG, LagWatch, excess_cap, kept_samples, least_told
from coopqp.control.monitoring.noise import noise_seen
from coopqp.control.monitoring.options import SupervisionOptions
from coopqp.control.monitoring.servos import ServoWatch
from coopqp.control.monitoring.stress import StressWatch
from coopqp.control.monitoring.watch import Watch, fall_gently
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.model.grasp import Grasp
from coopqp.native.constants import (
    CAUGHT_UP,
    CAUGHT_UP_SHARE,
    CIRCLE_TOLERANCE,
    EQUALLY_FAR,
    FAULT_SAMPLES,
    FEW_SAMPLES,
    FOLLOWS,
    LET_GO,
    MOST_LOST,
    NOISE_TIME,
    STILL_COMMAND,
)
from coopqp.spatial import Array, Flags, skew


def as_number(value: Any) -> float:
    """A float; NaN if the value is not a number."""
    try:
        return float(value)
    except NOT_NUMBERS:
        return math.nan


def unmeasured(cell: RobotCell, i: int) -> str:
    """The reason for entry i of a measured configuration that is no number."""
    joint = int(np.searchsorted(cell.position_index, i, side="right")) - 1
    return f"joint {cell.joint_names[max(joint, 0)]} has no finite measured position"


def refused_dt(dt: float, low: float, high: float) -> str:
    """Why a length of a step is not accepted [s]."""
    return f"dt is not accepted: {dt:g} s is outside [{low:g}, {high:g}] s"


#: Least distance between a grasp and the grasps' centre that counts [m].
_LEAST_REACH = 0.1


@dataclass(eq=False)
class _State:
    """What one sample hands to the next; deviations are lengths at the grasps (N, 6) [m].

    Attributes:
        deviation, away, step: of each arm from its command: filtered, in the last sample, and its last change.
        noise, samples: mean square of second differences (N,) [m²], and the number of samples that it is taken over.
        cap, arm: rate cap of the last sample, and the arm that made it, −1 for none.
        stalled, widest: arms that have stalled (N,), and how far they were from their commands at most [rad or m].
        past: positions of the moving joints, measured and commanded, of the last samples.
        silence: time since an arm was last seen to follow its command [s].
        drift, lag: of the arms from each other, and the common one; quiet: what noise makes of that one [m].
        commanded: positions in the last sample (nv,); None before the first.
        numbers, repeated: measured numbers of the last sample, and how often each arm's were repeated (N,).
        held: arms that held (N,).
        far: samples in a row in which an arm was as far from the others as a fault needs.
        pressed: the arms press too hard on the object.
        velocity: commanded velocities of the joints, filtered (nv,).
    """

    deviation: Array
    away: Array
    step: Array
    noise: Array
    stalled: Flags
    widest: Array
    repeated: npt.NDArray[np.intp]
    held: Flags
    past: deque[tuple[Array, Array]]
    drift: Drift
    lag: LagWatch
    velocity: Array
    quiet: float = 0.0
    samples: float = 0.0
    cap: float = 1.0
    arm: int = -1
    silence: float = 0.0
    commanded: Array | None = None
    numbers: Array | None = None
    far: int = 0
    pressed: bool = False


class Supervision:
    """The watch of one controller, with steps of about ``dt`` [s].

    Attributes:
        holds: which arms hold the object (N,).
        servos: compares with the wrenches where forces are monitored; None where they are not.
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, options: SupervisionOptions, *, dt: float = math.inf) -> None:
        self._cell, self._options = cell, options
        self._grasp, self._kept = grasp, kept_samples(options, dt)
        self._stress = _stress_watch(cell, grasp, options)
        self._continuous = np.flatnonzero(cell.continuous)
        n = len(cell)
        self.hold(np.ones(n, dtype=bool))
        columns = moving_columns(cell)
        self._starts = np.cumsum([0, *(len(c) for c in columns[:-1])]).tolist()
        #: The joints that move the tools, arm by arm.
        self._moving = np.concatenate(columns)
        self._at_grasps = grasp_lengths(grasp)
        self._numbers, self._first_numbers = _numbers_of(cell, columns)
        self.servos: ServoWatch | None = None
        self.reset()

    def hold(self, holds: Flags) -> None:
        """Say which arms hold the object from now on (N,): these are compared with each other."""
        self.holds, self._from_others = holds, from_others(holds)

    def reset(self) -> None:
        """Forget."""
        n, still = len(self._cell), np.zeros((len(self._cell), 6))
        self._s = _State(
            deviation=still,
            away=still.copy(),
            step=still.copy(),
            noise=np.zeros(n),
            stalled=np.zeros(n, dtype=bool),
            widest=np.zeros(n),
            repeated=np.zeros(n, dtype=np.intp),
            held=np.zeros(n, dtype=bool),
            past=deque(maxlen=self._kept),
            drift=Drift(n, self._options.let_in),
            lag=LagWatch(self._grasp, self._at_grasps.item(5, 5)),
            velocity=np.zeros(self._cell.nv),
        )
        if self._stress is not None:
            self._stress.reset()

    def memory(self) -> Any:
        """The state of a copy."""
        return self._s, None if self._stress is None else self._stress.memory()

    def restore(self, memory: Any) -> None:
        """Go on from a copy of what :meth:`memory` returned."""
        self._s, stress = memory
        if self._stress is not None:
            self._stress.restore(stress)

    def accept_dt(self, dt: Any, nominal: float) -> str:
        """Empty, or why ``dt`` is not accepted."""
        low, high = (share * nominal for share in self._options.dt_range)
        try:
            as_scalar(dt, "dt", low=low, high=high, open_low=False)
        except InvalidInputError:
            return refused_dt(as_number(dt), low, high)
        return ""

    def accept_measurement(self, q: Any, q_command: Array) -> tuple[Array, str]:
        """The measured configuration as an array, and why it is not believed (empty if it is)."""
        measured, trouble = as_configuration(self._cell, q)
        if measured is None:
            return q_command, trouble
        away = measured - q_command
        worst = int(np.abs(away).argmax())  # NaN wins
        if not math.isfinite(away.item(worst)):
            return q_command, unmeasured(self._cell, worst)
        for i in self._cell.position_index[self._continuous].tolist():
            radius = math.hypot(measured.item(i), measured.item(i + 1))
            if abs(radius - 1.0) > CIRCLE_TOLERANCE:
                return q_command, f"q_measured[{i}] and [{i + 1}] are no cosine and sine (norm {radius:.3g})"
            if radius != 1.0:
                measured = measured.copy() if measured is q else measured  # the caller's array stays as it is
                measured[i : i + 2] /= radius
        if self._continuous.size:
            commanded = self._cell.positions(q_command)
            away = self._positions(measured, commanded) - commanded
            worst = int(np.abs(away).argmax())
        far = abs(away.item(worst))
        if far > self._options.joint_jump:
            return q_command, f"joint {self._cell.joint_names[worst]} is measured {far:.3g} rad (or m) from its command"
        return measured, ""

    def _positions(self, q: Array, near: Array | None) -> Array:
        """One position per joint (nv,) [rad or m]; those of continuous joints within half a turn of ``near`` (nv,)."""
        x = self._cell.positions(q)
        if near is not None:
            own = self._continuous
            x[own] += 2.0 * np.pi * np.round((near[own] - x[own]) / (2.0 * np.pi))
        return x

    def watch(
        self,
        measured: Array,
        commanded: Array,
        away: Array,
        dt: float,
        velocity: Array | None = None,
        rotation: Array | None = None,
        twist: Array | None = None,
    ) -> Watch:
        """Compare one sample.

        Args:
            measured, commanded: configurations at the same time (nq,).
            away: of the object as each arm carries it, measured from commanded, in its own frame (N, 6) [m, rad].
            dt: time since the last sample [s].
            velocity, rotation: commanded velocities of the joints (nv,) and rotation of the object (3, 3); only where
                forces are monitored.
            twist: commanded twist of the object in its own frame (6,) [m/s, rad/s]; without it no lag is looked for.
        """
        o, s, result = self._options, self._s, Watch()
        servos = self.servos if self.servos is not None and self.servos.minds else None
        x_commanded = s.commanded = self._positions(commanded, s.commanded)
        x_measured = self._positions(measured, x_commanded)
        if len(away) > 1 and o.slow_from is not None:
            at_grasps = (away if servos is None else away + servos.shift) @ self._at_grasps
            lost = self._keep_where_lost(measured, at_grasps)
            if (self.holds != s.held).any():
                self._take_over()
            self._watch_distances(x_commanded, at_grasps, lost, dt, result, rigid=servos is not None)
        if servos is not None:
            fall_gently(result, s.cap, dt)
        if servos is not None and o.slow_from is not None and velocity is not None and rotation is not None:
            self._watch_servos(servos, away, velocity, rotation, dt, result)
        if o.stall_samples is not None:
            self._watch_stall(x_measured, x_commanded, dt, result, rigid=servos is not None)
        if self._stress is not None:
            self._watch_stress(self._stress, measured, commanded, dt, result)
        several = self.holds.sum() > 1
        if several and twist is not None and self.servos is None and self._stress is None and o.slow_from is not None:
            self._watch_lag(twist, dt, result)
        if o.recovery_time > 0.0:
            allowed = s.cap + dt / o.recovery_time
            if allowed < result.rate_cap:
                result.rate_cap = allowed
                if not result.reason:
                    result.arm, result.reason = s.arm, f"arm {self._cell.arm_names[s.arm]} was out of step"
            s.cap, s.arm = result.rate_cap, result.arm
        result.cause = Cause.TRACKING if result.reason else None
        if self.servos is not None and self.servos.touches and not result.fault:
            return Watch.holding("the arms hold", Cause.CONTACT)
        return result

    def _take_over(self) -> None:
        """Other arms hold than in the sample before."""
        s, now = self._s, self.holds
        s.lag.take_over(mean_where(now, s.deviation) - mean_where(s.held, s.deviation))
        s.drift.take_over(s.deviation, s.held, now)
        if self.servos is not None:
            self.servos.take_over(s.held, now)
        s.held = now

    def _keep_where_lost(self, measured: Array, away: Array) -> Flags:
        """Arms that have lost this sample (N,): their numbers equal the sample before to the last bit.

        Their rows of ``away`` become those of the last sample.
        """
        s, numbers = self._s, measured[self._numbers]
        lost = np.zeros(len(away), dtype=bool)
        if s.numbers is not None:
            same = np.logical_and.reduceat(numbers == s.numbers, self._first_numbers)
            s.repeated = (s.repeated + 1) * same
            lost = same & (s.repeated <= MOST_LOST)
            away[lost] = s.away[lost]
        s.numbers = numbers
        return lost

    def _watch_distances(
        self, commanded: Array, away: Array, lost: Flags, dt: float, result: Watch, *, rigid: bool
    ) -> None:
        """Deviation of each arm from the mean of the others that slows or stops the object."""
        o, s = self._options, self._s
        assert o.slow_from is not None
        keep = o.filter_time / (o.filter_time + dt)
        s.deviation = s.deviation + (1.0 - keep) * (away - s.deviation)
        passed = math.sqrt((1.0 - keep) / (1.0 + keep))  # share of the noise
        s.samples = min(s.samples + 1.0, NOISE_TIME / dt)
        noise = passed * noise_seen(away, s.away, s.step, s.noise, s.samples, self.holds)
        apart = out_of_step = self._from_others @ s.deviation
        if o.let_in > 0.0 and rigid:
            out_of_step = s.drift.followed(apart, commanded, dt)
        elif o.let_in > 0.0:
            out_of_step = s.drift.without(apart, noise, commanded, dt)
        self._count_far(away, self._from_others @ away - (apart - out_of_step), lost)
        distances = np.linalg.norm(out_of_step, axis=1)
        worst = float(distances.max()) - o.noise_margin * noise
        s.quiet = o.noise_margin * noise / math.sqrt(max(self.holds.sum(), 1)) + max(worst, 0.0)
        if worst <= o.slow_from or s.samples < FEW_SAMPLES:
            return
        # Two arms are always equally far from each other: blame the arm that is farther from its command.
        own = np.where(distances >= 0.99 * distances.max(), np.linalg.norm(s.deviation, axis=1), -1.0)
        candidates = own > own.max() - EQUALLY_FAR  # of these the one that was named last, or the first
        arm = result.arm = s.arm if s.arm >= 0 and candidates[s.arm] else int(candidates.argmax())
        result.hold = worst >= o.hold_from
        result.fault = worst >= o.fault_from and s.far >= FAULT_SAMPLES
        result.rate_cap = 0.0 if result.hold else (o.hold_from - worst) / (o.hold_from - o.slow_from)
        result.reason = f"arm {self._cell.arm_names[arm]} is {1e3 * distances[arm]:.2f} mm out of step with the others"

    def _count_far(self, away: Array, unfiltered: Array, lost: Flags) -> None:
        """Count the samples in a row in which an arm is as far from the others as a fault needs.

        A sample that the arm farthest from its command has lost says nothing.
        """
        if not lost[np.where(self.holds, np.linalg.norm(away, axis=1), -1.0).argmax()]:
            far = np.square(unfiltered).sum(axis=1).max() >= self._options.fault_from**2
            self._s.far = self._s.far + 1 if far else 0

    def _watch_stall(self, measured: Array, commanded: Array, dt: float, result: Watch, *, rigid: bool) -> None:
        """An arm that stands while another follows has stalled; where none follows, signals may just be late.

        Of arms in rigid grips whose forces are monitored their wrenches say more: here, only whether all have stopped.
        """
        o, s = self._options, self._s
        s.past.append((measured[self._moving], commanded[self._moving]))
        samples = o.stall_samples or 1
        (x0, command0), (x, command) = s.past[max(len(s.past) - 1 - samples, 0)], s.past[-1]
        asked, moved, gap = np.maximum.reduceat(np.abs([command - command0, x - x0, command - x]), self._starts, axis=1)
        s.widest = np.where(s.stalled, np.maximum(s.widest, gap), s.widest)
        s.stalled = s.stalled & (gap >= np.maximum(CAUGHT_UP, CAUGHT_UP_SHARE * s.widest))
        moving = asked > STILL_COMMAND
        # With less of a gap it is not stalled but late; so it is where it turns round a little later than told.
        stands = moving & (moved < o.stall_share * asked) & (gap >= CAUGHT_UP)
        if len(s.past) > samples and stands.any():
            least = least_told([row for _, row in s.past], self._starts, samples)
            stands &= (least > STILL_COMMAND) & (moved < o.stall_share * least)
        if len(s.past) > samples and stands.any():
            follows = bool((moving & (moved > FOLLOWS * asked)).any())
            s.silence = 0.0 if follows else s.silence + dt
            if follows or s.silence > o.silent_time:
                s.widest = np.where(stands & ~s.stalled, 0.0, s.widest)
                s.stalled = s.stalled | stands
        else:
            s.silence = 0.0
        if s.stalled.all() if rigid else s.stalled.any():
            result.rate_cap, result.hold, result.arm = 0.0, True, int(s.stalled.argmax())
            result.reason = f"arm {self._cell.arm_names[result.arm]} does not follow its command (stalled)"
            if s.stalled.all():
                result.reason = "no arm is seen to follow its command (all have stopped, or measurements are stale)"

    def _watch_servos(
        self, servos: ServoWatch, away: Array, velocity: Array, rotation: Array, dt: float, result: Watch
    ) -> None:
        """Arms whose servos do not stand where their wrenches say slow the object; one that has stalled holds it."""
        o = self._options
        hasty = servos.hasten(velocity, self._s.velocity, dt)
        cap, arm, far = servos.watch(
            away,
            self._at_grasps,
            rotation,
            hasty,
            holds=self.holds,
            way=self._s.drift.way,
            dt=dt,
            filter_time=o.filter_time,
            margin=o.noise_margin,
        )
        if cap >= 1.0:
            return
        reason = f"arm {self._cell.arm_names[arm]} is {1e3 * far:.2f} mm from where its wrench puts its servos"
        found = Watch(cap, hold=cap == 0.0, arm=arm, reason=reason, cause=Cause.TRACKING)
        if cap > 0.0:
            fall_gently(found, self._s.cap, dt)
        if found.rate_cap < result.rate_cap:
            result.lower(found)

    def _watch_lag(self, twist: Array, dt: float, result: Watch) -> None:
        """Arms that are where no lag would put them all slow the object, and hold it."""
        s = self._s
        velocity, settled = twist @ self._at_grasps, s.samples >= FEW_SAMPLES
        excess, arm = s.lag.look(
            mean_where(self.holds, s.deviation), velocity, s.quiet, dt, holds=self.holds, settled=settled
        )
        cap = excess_cap(excess)
        if arm >= 0 and cap < result.rate_cap:
            reason = OFF_LAG.format(arm=self._cell.arm_names[arm], mm=1e3 * excess)
            result.lower(Watch(cap, hold=cap == 0.0, arm=arm, reason=reason, cause=Cause.TRACKING))

    def _watch_stress(self, stress: StressWatch, measured: Array, commanded: Array, dt: float, result: Watch) -> None:
        """Arms that press too hard on the object, or soon will, hold it until they press less than half as hard."""
        limit, s = self._options.force_limit, self._s
        stress.read(measured, commanded, dt, self.holds)
        most = int(stress.forces.argmax())
        force = float(stress.forces[most])
        soon = stress.soon(most, limit)
        s.pressed = soon >= (LET_GO * limit if s.pressed else limit)
        if not s.pressed:
            return
        result.rate_cap, result.hold, names = 0.0, True, self._cell.arm_names
        if stress.behind < 0:
            result.arm = most
            grows = f", soon {soon:.0f} N" if force < limit <= soon else ""
            result.reason = f"{force:.0f} N at the grasp of arm {names[most]} by its servos{grows} (limit {limit:g} N)"
        else:
            result.arm = stress.behind
            result.reason = (
                f"arm {names[result.arm]} does not follow its command: it hangs {1e3 * stress.gap:.2g} mm behind, "
                f"and the others pull it with {stress.pull:.0f} N"
            )


def _numbers_of(cell: RobotCell, columns: tuple[npt.NDArray[np.intp], ...]) -> tuple[npt.NDArray[np.intp], list[int]]:
    """Where in a configuration the numbers of the joints that move each arm's tool stand; where each arm's begin."""
    numbers = []
    for own in columns:
        index = [[i, i + 1] if cell.continuous[j] else [i] for j, i in zip(own, cell.position_index[own], strict=True)]
        numbers.append(np.concatenate(index).astype(np.intp))
    return np.concatenate(numbers), np.cumsum([0, *(len(n) for n in numbers[:-1])]).tolist()


def as_configuration(cell: RobotCell, q: Any) -> tuple[Array | None, str]:
    """A measured configuration as an array (nq,), or None and the fault of its type or shape."""
    try:
        measured = q if type(q) is np.ndarray and q.dtype == np.float64 else as_floats(q)
    except NOT_NUMBERS:
        return None, f"q_measured is {type(q).__name__}, not {cell.nq} numbers"
    if measured.shape != (cell.nq,):
        return None, f"q_measured must have shape ({cell.nq},), got {measured.shape}"
    return np.ascontiguousarray(measured), ""


def grasp_lengths(grasp: Grasp) -> Array:
    """Lᵀ (6, 6): ``d @ Lᵀ`` are the lengths at the grasps [m] of displacements d (…, 6) of the object [m, rad].

    The first three are the displacement of the grasps' centre, the others the turn times the largest distance of a
    grasp from it: if one arm turns the object, the grasps part by this length.
    """
    points = np.array([X.translation for X in grasp.T_object_tool])
    centre = points.mean(axis=0)
    reach = max(float(np.linalg.norm(points - centre, axis=1).max()), _LEAST_REACH)
    L = np.eye(6)
    L[:3, 3:] = -skew(centre)
    L[3:, 3:] *= reach
    return L.T


def _stress_watch(cell: RobotCell, grasp: Grasp, options: SupervisionOptions) -> StressWatch | None:
    if options.stiffness is None:
        return None
    size = np.size(options.stiffness)
    if size not in (1, cell.nv):
        raise InvalidInputError(
            f"{size} numbers for {cell.nv} joints",
            "SupervisionOptions: stiffness",
            "Give one number, or one per joint.",
        )
    stiffness = np.broadcast_to(np.asarray(options.stiffness, dtype=float), (cell.nv,))
    return StressWatch(cell, grasp, stiffness=stiffness, delay=options.servo_delay, filter_time=options.filter_time)
