"""An independent monitor: checks that commands keep the limits, the chain, the path and the controller's promises.

The monitor judges the commands only and shares no code with the controllers: kinematics come directly from Pinocchio's
frames and limits from the cell. Use it to test your own controller, after a run (:func:`check_run`) or during one
(:class:`Monitor`, :class:`Monitored`).
"""

from __future__ import annotations

import enum
import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias, final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.checks import ArrayLike, as_options, keep_scalars
from coopqp.collision.scene import CollisionScene
from coopqp.control.command import Controller, ControlStep, Status
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.simulation.closeness import Closeness
from coopqp.simulation.loads import read_loads
from coopqp.simulation.recording import Recording
from coopqp.spatial import Array
from coopqp.task.path import ObjectPath

Flags: TypeAlias = npt.NDArray[np.bool_]


class Breach(enum.Enum):
    """Kind of a violation."""

    FORM = "wrong shape or type"
    NOT_FINITE = "not finite"
    POSITION = "position limit"
    VELOCITY = "velocity limit"
    ACCELERATION = "acceleration limit"
    CONTINUITY = "does not continue the last command"
    CLOCK = "clock and rate disagree"
    RATE = "rate out of range"
    HOLDING = "not at rest while holding"
    CHAIN = "arms out of step"
    PATH = "off the path"
    CLEARANCE = "too close"
    TORQUE = "torque limit"
    SQUEEZE = "internal force"
    MUTATED = "data were modified"


#: Accepted braking time of all arms together along a curved path, as a multiple of the slowest joint's braking time.
_BRAKING_SLACK = 1.1
#: Tolerances that cannot be switched off.
_REQUIRED = ("position", "velocity", "acceleration", "consistency", "clearance_m")
#: Number of pairs of placements that are compared at once; bounds the memory.
_LARGEST_TABLE = 200_000


@dataclass(frozen=True, slots=True)
class Violation:
    """One violation.

    Attributes:
        breach: kind of the violation.
        step: number of the step since the monitor's reset.
        time: time at the end of the step since the reset [s].
        arm, joint: names of the arm and the joint; empty if the violation concerns all.
        amount: excess over the allowed value [rad, m, rad/s, m/s; a share of the limit for accelerations].
        detail: explanation in words.
    """

    breach: Breach
    step: int
    time: float
    arm: str = ""
    joint: str = ""
    amount: float = 0.0
    detail: str = ""

    def __str__(self) -> str:
        who = f" {self.arm}{'/' if self.joint else ''}{self.joint}" if self.arm else ""
        more = f" ({self.detail})" if self.detail else ""
        return f"step {self.step} ({self.time:.4f} s):{who} {self.breach.value}, {self.amount:.3g} too much{more}"


@dataclass(frozen=True, kw_only=True)
class MonitorTolerances:
    """Accepted deviations. None switches a check of the chain or the path off.

    Attributes:
        position: excess over a position limit [rad or m]; for a joint that is already outside, the further excess.
        velocity: excess over a velocity limit [rad/s or m/s].
        acceleration: excess over an acceleration limit, as a share of the limit.
        consistency: difference of commands that must be equal [rad or m; s for clocks].
        chain_m, chain_rad: difference of the commanded object poses of any two arms [m, rad].
        path_m, path_rad: difference of any arm's commanded object pose and the path at the object's clock [m, rad].
        clearance_m: how much closer bodies come than their margin [m].
    """

    position: float = 1e-9
    velocity: float = 1e-9
    acceleration: float = 1e-6
    consistency: float = 1e-9
    chain_m: float | None = 1e-4
    chain_rad: float | None = 1e-3
    path_m: float | None = 1e-3
    path_rad: float | None = 1e-2
    clearance_m: float = 1e-6

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if getattr(self, name) is not None or name in _REQUIRED:
                keep_scalars(self, name, open_low=False)


@dataclass(frozen=True, kw_only=True)
class Worst:
    """The largest values of a run, inside or outside the tolerances. A negative excess is the distance to the limit.

    Attributes:
        position, velocity: excess over a limit [rad or m, rad/s or m/s]; −inf without limits.
        acceleration: excess over a limit, as a share of the limit.
        chain_m, chain_rad, path_m, path_rad, clearance_m: as in :class:`MonitorTolerances`.
    """

    position: float = -np.inf
    velocity: float = -np.inf
    acceleration: float = -np.inf
    chain_m: float = 0.0
    chain_rad: float = 0.0
    path_m: float = 0.0
    path_rad: float = 0.0
    clearance_m: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """The result of a monitor.

    Attributes:
        steps: number of judged steps.
        violations: the first violations, at most ``keep`` of :class:`Monitor`.
        counts: total number of violations of each kind.
        worst: the largest values.
    """

    steps: int
    violations: tuple[Violation, ...] = ()
    counts: Mapping[Breach, int] = field(default_factory=lambda: MappingProxyType({}))
    worst: Worst = field(default_factory=Worst)

    @property
    def ok(self) -> bool:
        """True if at least one step was judged and nothing was violated."""
        return self.steps > 0 and not self.counts

    def __str__(self) -> str:
        w = self.worst
        figures = (
            f"{self.steps} steps; chain ≤ {1e3 * w.chain_m:.3g} mm, {np.rad2deg(w.chain_rad):.3g}°; "
            f"path ≤ {1e3 * w.path_m:.3g} mm, {np.rad2deg(w.path_rad):.3g}°"
        )
        if not self.counts:
            return f"kept: {figures}"
        kinds = ", ".join(f"{n} x {breach.value}" for breach, n in self.counts.items())
        return f"violated: {kinds}; {figures}\n" + "\n".join(f"  {v}" for v in self.violations)


@dataclass(frozen=True, eq=False)
class _Block:
    """T consecutive steps as arrays."""

    q: Array  # (T, nq)
    q_next: Array  # (T, nq)
    velocity: Array  # (T, nv)
    dt: Array  # (T,)
    clock: Array  # (T,)
    clock_next: Array  # (T,)
    rate: Array  # (T,)
    holding: Flags  # (T,)
    same_path: Flags  # (T,): the clock continues from the step before
    reference: Array  # (T, 4, 4): pose of the path at clock_next
    duration: Array  # (T,)
    shift: Array | None = None  # (T, N, 6): of the grasps at q_next


#: q, q_next, velocity, dt, clock, clock_next, rate, status and path of a step, and the step.
_Row: TypeAlias = tuple[Array, Array, Array, float, float, float, float, Status, ObjectPath, ControlStep]
_FLOAT = np.dtype(np.float64)


@final
class Monitor:
    """Judges the commands of one controller, step by step or many steps at once.

    Args:
        cell: cell with the true limits and kinematics, even if the controller assumes others.
        grasp: intended placements of the tools on the object.
        path: path of the object; by default the path in each step.
        tolerances: accepted deviations.
        keep: number of violations stored with details; all are counted.
        kinematics: also judge the chain and the path; this doubles the cost of a step.
        scene: also judge the distances of its bodies, in steps and between them, by another way than a controller's.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath | None = None,
        *,
        tolerances: MonitorTolerances | Mapping[str, Any] | None = None,
        keep: int = 50,
        kinematics: bool = True,
        scene: CollisionScene | None = None,
    ) -> None:
        grasp.check_arms(cell)
        self._closeness = None if scene is None else Closeness(scene)
        self.cell, self.grasp, self.path = cell, grasp, path
        self.tolerances = as_options(MonitorTolerances, tolerances, "Monitor: tolerances")
        self._keep, self._kinematics = keep, kinematics
        self._data = cell.model.createData()
        self._shape_q, self._shape_v = (cell.nq,), (cell.nv,)
        self._inverse_grasp = np.array([X.inverse().homogeneous for X in grasp.T_object_tool])
        limits = cell.limits
        self._lower, self._upper = np.array(limits.lower), np.array(limits.upper)
        self._speed, self._acceleration = np.array(limits.velocity), np.array(limits.acceleration)
        self._accelerates = bool(np.isfinite(self._acceleration).any())
        n = len(cell)
        first, second = np.triu_indices(n, 1)
        self._first, self._second = np.append(first, np.arange(n)), np.append(second, np.full(n, n))
        self._pairs = len(self._first)
        self._names = [name.partition("/")[::2] for name in cell.joint_names]
        joints = list(cell.model.joints)[1:]
        self._turning = np.array([joint.idx_v for joint in joints if joint.nq == 2], dtype=int)
        self._at = np.empty(cell.nv, dtype=int)
        for joint in joints:
            self._at[joint.idx_v] = joint.idx_q
        self.reset()

    def reset(self) -> None:
        """Forget everything. The next step starts from rest."""
        self._steps, self._time = 0, 0.0
        self._violations: list[Violation] = []
        self._counts: Counter[Breach] = Counter()
        self._worst = Worst()
        self.restart()

    def restart(self) -> None:
        """Let the next step start from rest at any configuration. Earlier violations are kept."""
        self._last_q: Array | None = None
        self._last_v = np.zeros(self.cell.nv)
        self._last_clock, self._held = 0.0, 0.0
        self._last_path: ObjectPath | None = None

    # -- judging -----------------------------------------------------------------------------------------------------

    def observe(self, step: ControlStep) -> tuple[Violation, ...]:
        """Judge one step; return its violations."""
        return self.observe_all([step])

    def observe_all(self, steps: Sequence[ControlStep]) -> tuple[Violation, ...]:
        """Judge consecutive steps at once, at a lower cost per step; return their stored violations (see ``keep``)."""
        before = len(self._violations)
        formed: list[_Row] = []
        for step in steps:
            row = self._read(step)
            if row is not None:
                formed.append(row)
            else:
                self._judge_rows(formed)
                self._refuse(step)
                formed = []
        self._judge_rows(formed)
        return tuple(self._violations[before:])

    def report(self, breach: Breach, *, arm: str = "", amount: float = 0.0, detail: str = "") -> None:
        """Add a violation found by the caller to the verdict."""
        self._add(Violation(breach, max(self._steps - 1, 0), self._time, arm, "", amount, detail))

    def verdict(self) -> Verdict:
        """The verdict so far."""
        limits = self.cell.limits
        for name, kept in (("lower", self._lower), ("upper", self._upper), ("velocity", self._speed)):
            if not np.array_equal(getattr(limits, name), kept):
                self.report(Breach.MUTATED, detail=f"the cell's limits: {name}")
        return Verdict(self._steps, tuple(self._violations), MappingProxyType(dict(self._counts)), self._worst)

    def _add(self, violation: Violation) -> None:
        self._counts[violation.breach] += 1
        if len(self._violations) < self._keep:
            self._violations.append(violation)

    def _read(self, step: ControlStep) -> _Row | None:
        """The values of a step; None if shapes or types are wrong. Numbers may be none."""
        q, q_next, velocity, status = step.q, step.q_next, step.velocity, step.status
        dt, clock, clock_next, rate = step.dt, step.clock, step.clock_next, step.rate
        formed = (
            type(q) is type(q_next) is type(velocity) is np.ndarray
            and q.dtype is q_next.dtype is velocity.dtype is _FLOAT
            and q.shape == q_next.shape == self._shape_q
            and velocity.shape == self._shape_v
            and type(dt) is type(clock) is type(clock_next) is type(rate) is float
            and isinstance(status, Status)
            and isinstance(step.reason, str)
        )
        if not formed and self._faults(step):
            return None
        return q, q_next, velocity, dt, clock, clock_next, rate, status, step.path, step

    def _refuse(self, step: ControlStep) -> None:
        """Count the faults of a step. It is judged no further, and the next one is not compared with it."""
        for fault in self._faults(step):
            self._add(fault)
        self._steps += 1
        self._lose()

    def _faults(self, step: ControlStep) -> list[Violation]:
        """Wrong shapes and types of the next step, and numbers that are not finite."""
        faults, number, now = [], self._steps, self._time
        for name, size in (("q", self.cell.nq), ("q_next", self.cell.nq), ("velocity", self.cell.nv)):
            value = getattr(step, name)
            if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != (size,):
                faults.append(Violation(Breach.FORM, number, now, detail=f"{name} of shape ({size},)"))
            elif not np.isfinite(value).all():
                bad = int(np.flatnonzero(~np.isfinite(value))[0])
                arm, joint = self._names[bad] if name == "velocity" else ("", "")
                faults.append(Violation(Breach.NOT_FINITE, number, now, arm, joint, np.nan, f"{name}[{bad}]"))
        for name in ("dt", "clock", "clock_next", "rate"):
            value = getattr(step, name)
            if not isinstance(value, float):
                faults.append(Violation(Breach.FORM, number, now, detail=f"{name} is no float"))
            elif not np.isfinite(value):
                faults.append(Violation(Breach.NOT_FINITE, number, now, amount=np.nan, detail=name))
        if not isinstance(step.status, Status) or not isinstance(step.reason, str):
            faults.append(Violation(Breach.FORM, number, now, detail="status or reason"))
        return faults

    def _lose(self) -> None:
        """Forget the last step: after a malformed step the next one is not compared with it."""
        self._last_q, self._last_path = None, None
        self._last_v, self._held = np.full(self.cell.nv, np.nan), 0.0

    def _judge_rows(self, rows: Sequence[_Row]) -> None:
        if not rows:
            return
        q, q_next, velocity, dt, clock, clock_next, rate, status, own, steps = zip(*rows, strict=True)
        arrays = [np.concatenate(values).reshape(len(rows), -1) for values in (q, q_next, velocity)]
        numbers = np.array([dt, clock, clock_next, rate])
        sound = np.isfinite(numbers).all(axis=0)
        for values in arrays:
            sound &= np.isfinite(values).all(axis=1)
        if not sound.all():
            for good, run in itertools.groupby(range(len(rows)), sound.__getitem__):
                if good:
                    self._judge_rows([rows[i] for i in run])
                    continue
                for i in run:
                    self._refuse(steps[i])
            return
        paths = own if self.path is None else (self.path,) * len(rows)
        before = (self._last_path, *paths[:-1])
        self._last_path = paths[-1]
        poses = [p.pose(c).homogeneous for p, c in zip(paths, clock_next, strict=True)] if self._kinematics else []
        block = _Block(
            q=arrays[0],
            q_next=arrays[1],
            velocity=arrays[2],
            dt=numbers[0],
            clock=numbers[1],
            clock_next=numbers[2],
            rate=numbers[3],
            holding=np.array([s is Status.HOLDING or s is Status.FAULT for s in status]),
            same_path=np.array([a is b for a, b in zip(before, paths, strict=True)]),
            reference=np.array(poses),
            duration=np.array([p.duration for p in paths]),
        )
        self._judge(block)

    def judge_recording(self, recording: Recording) -> Verdict:
        """Judge a run; see :func:`check_run`."""
        r = recording
        last = -2  # the last sound step
        for part in r.parts(r.n_steps):
            sound = self._sound(r, part)
            end = part.start
            for good, run in itertools.groupby(sound.tolist()):
                i, end = end, end + len(list(run))
                if good:
                    self._judge(self._block(r, i, end, goes_on=last == i - 1))
                    last = end - 1
                    continue
                for row in range(i, end):
                    self._add(Violation(Breach.NOT_FINITE, row, float(r.time[row]), amount=np.nan))
                self._steps += end - i
                self._lose()
        self._judge_loads(r)
        return self.verdict()

    def _judge_loads(self, r: Recording) -> None:
        """Torques of joints, and the internal force of each arm in motion, where the run was recorded with them."""
        loads = read_loads(self.cell, r)
        if loads is None:
            return
        for t, j in np.argwhere(loads.torque_use > 1.0):
            arm, _, joint = self.cell.joint_names[j].partition("/")
            excess = float(loads.torque_use[t, j] - 1.0)
            self._add(Violation(Breach.TORQUE, int(t), float(loads.time[t]), arm, joint, excess, "share of the limit"))
        squeezed = loads.internal > loads.internal_limit
        squeezed[: loads.moves] = False
        for t, k in np.argwhere(squeezed):
            excess = float(loads.internal[t, k] - loads.internal_limit)
            self._add(Violation(Breach.SQUEEZE, int(t), float(loads.time[t]), self.cell.arm_names[k], "", excess, "N"))

    @staticmethod
    def _sound(r: Recording, part: slice) -> Flags:
        """Whether the numbers of steps are finite."""
        samples = slice(part.start, part.stop + 1)
        sound = np.isfinite(r.q_command[samples]).all(axis=1) & np.isfinite(r.clock[samples])
        sound &= np.isfinite(r.time[samples])
        steps: Flags = sound[:-1] & sound[1:] & np.isfinite(r.velocity[part]).all(axis=1) & np.isfinite(r.rate[part])
        return steps

    @staticmethod
    def _block(r: Recording, start: int, end: int, *, goes_on: bool) -> _Block:
        cut, ends = slice(start, end), slice(start + 1, end + 1)
        same_path = np.full(end - start, True)
        same_path[0] = goes_on
        return _Block(
            q=r.q_command[cut],
            q_next=r.q_command[ends],
            velocity=r.velocity[cut],
            dt=np.diff(r.time[start : end + 1]),
            clock=r.clock[cut],
            clock_next=r.clock[ends],
            rate=r.rate[cut],
            holding=np.isin(r.status[cut], (Status.HOLDING.code, Status.FAULT.code)),
            same_path=same_path,
            reference=r.reference[ends],
            duration=np.full(end - start, float(r.metadata.get("duration") or np.inf)),
            shift=None if r.shift is None else r.shift[cut],
        )

    def _judge(self, block: _Block) -> None:
        steps = len(block.dt)
        ends = self._time + np.cumsum(block.dt)
        x, x_next = self._positions(block.q), self._positions(block.q_next)
        v_before = np.vstack([self._last_v, block.velocity[:-1]])
        self._judge_positions(x, x_next, ends)
        self._judge_rates(block, v_before, ends)
        self._judge_continuity(block, x, x_next, ends)
        self._judge_clock(block, ends)
        self._judge_holding(block, v_before, ends)
        if self._kinematics:
            self._judge_object(block, ends)
        if self._closeness is not None:
            self._judge_clearance(self._closeness, block, ends)
        self._steps += steps
        self._time = float(ends[-1])
        self._last_q, self._last_v = block.q_next[-1].copy(), block.velocity[-1].copy()
        self._last_clock = float(block.clock_next[-1])

    def _positions(self, q: Array) -> Array:
        """Joint positions (T, nv); continuous joints in (−π, π]."""
        x: Array = q[:, self._at]
        for j in self._turning:
            x[:, j] = np.arctan2(q[:, self._at[j] + 1], q[:, self._at[j]])
        return x

    def _judge_positions(self, x: Array, x_next: Array, ends: Array) -> None:
        excess = np.maximum(x_next - self._upper, self._lower - x_next)
        before = np.maximum(x - self._upper, self._lower - x)
        outward = excess - np.maximum(before, 0.0)  # an outside joint must not move further out
        self._note(position=float(outward.max()))
        self._joints(Breach.POSITION, outward, self.tolerances.position, ends)

    def _judge_rates(self, block: _Block, v_before: Array, ends: Array) -> None:
        excess = np.abs(block.velocity) - self._speed
        self._note(velocity=float(excess.max()))
        self._joints(Breach.VELOCITY, excess, self.tolerances.velocity, ends)
        if self._accelerates:
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.abs(block.velocity - v_before) / (block.dt[:, None] * self._acceleration) - 1.0
            share[np.isnan(v_before)] = -1.0
            self._note(acceleration=float(share.max()))
            self._joints(Breach.ACCELERATION, share, self.tolerances.acceleration, ends)

    def _judge_continuity(self, block: _Block, x: Array, x_next: Array, ends: Array) -> None:
        gap = np.abs(self._difference(x, x_next) - block.velocity * block.dt[:, None])
        self._joints(Breach.CONTINUITY, gap, self.tolerances.consistency, ends, "q_next is not q + v dt")
        before = np.vstack([block.q[:1] if self._last_q is None else self._last_q[None, :], block.q_next[:-1]])
        jump = np.abs(self._difference(self._positions(before), x))
        self._joints(Breach.CONTINUITY, jump, self.tolerances.consistency, ends, "q is not the last q_next")
        for j in self._turning:
            i = self._at[j]
            radius = np.abs(np.hypot(block.q_next[:, i], block.q_next[:, i + 1]) - 1.0)
            self._all(Breach.CONTINUITY, radius - self.tolerances.consistency, ends, "off the unit circle")

    def _difference(self, start: Array, end: Array) -> Array:
        d: Array = end - start
        if self._turning.size:
            t = self._turning
            d[:, t] = np.arctan2(np.sin(d[:, t]), np.cos(d[:, t]))
        return d

    def _judge_clock(self, block: _Block, ends: Array) -> None:
        slack = self.tolerances.consistency
        rate, advance = block.rate, block.clock_next - block.clock
        self._all(Breach.RATE, np.maximum(-rate, rate - 1.0) - slack, ends, "σ in [0, 1]")
        self._all(Breach.RATE, np.where(block.dt > 0.0, -1.0, 1.0), ends, "dt > 0")
        self._all(Breach.CLOCK, -advance - slack, ends, "runs backwards")
        # The last step may advance the clock by less than σ dt.
        ended = block.clock_next >= block.duration
        miss = np.where(ended, advance - rate * block.dt, np.abs(advance - rate * block.dt))
        self._all(Breach.CLOCK, miss - slack * (1.0 + block.clock_next), ends, "does not advance by σ dt")
        before = np.concatenate([[self._last_clock], block.clock_next[:-1]])
        self._all(Breach.CLOCK, np.where(block.same_path, np.abs(block.clock - before), 0.0) - slack, ends, "jumps")

    def _judge_holding(self, block: _Block, v_before: Array, ends: Array) -> None:
        """A holding controller must come to rest within the braking time of the slowest joint."""
        if not block.holding.any():
            self._held = 0.0
            return
        for i, holding in enumerate(block.holding):
            if not holding:
                self._held = 0.0
                continue
            if self._held == 0.0:
                fastest = np.nan_to_num(np.abs(v_before[i]) / self._acceleration).max()
                self._may_take = _BRAKING_SLACK * float(fastest) + 2.0 * float(block.dt[i])
            self._held += float(block.dt[i])
            over = float(block.rate[i]) if self._held > self._may_take + 1e-9 else 0.0
            if over > self.tolerances.consistency:
                self._add(Violation(Breach.HOLDING, self._steps + i, float(ends[i]), amount=over, detail="σ"))

    def _judge_object(self, block: _Block, ends: Array) -> None:
        t = self.tolerances
        chain = self._pairs - len(self.cell)  # first the pairs of two arms, then those of arm and reference
        distance, angle = self._apart(block)
        for breach, values, allowed, unit in (
            (Breach.CHAIN, distance[:, :chain], t.chain_m, "m"),
            (Breach.CHAIN, angle[:, :chain], t.chain_rad, "rad"),
            (Breach.PATH, distance[:, chain:], t.path_m, "m"),
            (Breach.PATH, angle[:, chain:], t.path_rad, "rad"),
        ):
            if values.size == 0:  # a single arm forms no chain
                continue
            largest = float(values.max())
            self._note(**{f"{'chain' if breach is Breach.CHAIN else 'path'}_{unit}": largest})
            if allowed is None or largest <= allowed:
                continue
            worst = values.argmax(axis=1)
            for i in np.flatnonzero(~(values.max(axis=1) <= allowed)):
                k = self._second[worst[i]] if breach is Breach.CHAIN else worst[i]
                amount = float(values[i, worst[i]] - allowed)
                arm = self.cell.arm_names[int(k)]
                self._add(Violation(breach, self._steps + int(i), float(ends[i]), arm, "", amount, f"[{unit}]"))

    def _judge_clearance(self, closeness: Closeness, block: _Block, ends: Array) -> None:
        if self._last_q is None or not np.array_equal(self._last_q, block.q[0]):
            closeness.start(block.q[0])
        q, allowed = np.vstack([block.q[:1], block.q_next]), self.tolerances.clearance_m
        for i, pair, missing in closeness.watch(q, tolerance=allowed):
            self._note(clearance_m=missing)
            self._add(
                Violation(
                    Breach.CLEARANCE, self._steps + i, float(ends[i]), amount=missing - allowed, detail=f"[m] {pair}"
                )
            )

    def _apart(self, block: _Block) -> tuple[Array, Array]:
        """Distances [m] and angles [rad] (T, pairs) between the arms' object poses, and from each to the reference."""
        steps, n = len(block.dt), len(self.cell)
        distance, angle = np.empty((steps, self._pairs)), np.empty((steps, self._pairs))
        T = np.empty((steps, n + 1, 4, 4))
        T[:, :n] = self._carried(block.q_next)
        if block.shift is not None:
            T[:, :n] = T[:, :n] @ np.array([[pin.exp6(-d).homogeneous for d in row] for row in block.shift])
        T[:, n] = block.reference
        rows = max(1, _LARGEST_TABLE // self._pairs)
        for start in range(0, steps, rows):
            part = T[start : start + rows]
            D = part[:, self._first] - part[:, self._second]
            np.sqrt(np.einsum("tpi,tpi->tp", D[..., :3, 3], D[..., :3, 3]), out=distance[start : start + rows])
            # ‖A − B‖ = 2√2 sin(θ/2) is accurate near 0
            half = np.sqrt(np.einsum("tpij,tpij->tp", D[..., :3, :3], D[..., :3, :3]) / 8.0)
            angle[start : start + rows] = 2.0 * np.arcsin(np.minimum(half, 1.0))
        return distance, angle

    def _carried(self, q: Array) -> Array:
        """Object pose according to each arm, placements (T, N, 4, 4)."""
        cell, data = self.cell, self._data
        frames = cell.tool_frames
        T = np.empty((len(q), len(frames), 4, 4))
        for i, configuration in enumerate(q):
            pin.framesForwardKinematics(cell.model, data, configuration)
            for k, f in enumerate(frames):
                T[i, k] = data.oMf[f].homogeneous
        carried: Array = T @ self._inverse_grasp
        return carried

    # -- findings ----------------------------------------------------------------------------------------------------

    def _note(self, **figures: float) -> None:
        w = self._worst
        if any(not value <= getattr(w, name) for name, value in figures.items()):
            known = {name: getattr(w, name) for name in w.__dataclass_fields__}
            known.update({name: float(np.maximum(known[name], value)) for name, value in figures.items()})
            self._worst = Worst(**known)

    def _joints(self, breach: Breach, amounts: Array, allowed: float, ends: Array, detail: str = "") -> None:
        """Add a violation for every joint with an amount (T, nv) above ``allowed``."""
        if amounts.max() <= allowed:
            return
        for i, j in np.argwhere(~(amounts <= allowed)):
            arm, joint = self._names[j]
            self._add(Violation(breach, self._steps + int(i), float(ends[i]), arm, joint, float(amounts[i, j]), detail))

    def _all(self, breach: Breach, amounts: Array, ends: Array, detail: str) -> None:
        """Add a violation of all arms for every amount (T,) above 0."""
        for i in np.flatnonzero(~(amounts <= 0.0)):
            self._add(Violation(breach, self._steps + int(i), float(ends[i]), amount=float(amounts[i]), detail=detail))


@final
class Monitored:
    """A controller with a monitor. The monitor judges every step, and detects changes of the caller's arrays.

    Args:
        controller: the judged controller; use its other methods directly.
        monitor: the monitor; by default a new one for the controller's cell and grasp.
    """

    def __init__(self, controller: Controller, monitor: Monitor | None = None) -> None:
        self.controller = controller
        self.cell, self.grasp, self.dt = controller.cell, controller.grasp, controller.dt
        self.monitor = monitor or Monitor(controller.cell, controller.grasp)
        self._last: ControlStep | None = None
        self._kept: tuple[Array, ...] = ()

    @property
    def path(self) -> ObjectPath:
        """The controller's path."""
        return self.controller.path

    def reset(self, q: ArrayLike) -> None:
        """Reset the controller. The monitor keeps its violations."""
        kept = _copy(q)
        self.controller.reset(q)
        self._unchanged(q, kept, "q of reset")
        self.monitor.restart()
        self._last = None

    def step(self, q_measured: ArrayLike | None = None, *, dt: float | None = None) -> ControlStep:
        """Compute and judge the controller's step."""
        kept = _copy(q_measured)
        step = self.controller.step(q_measured, dt=dt)
        self._unchanged(q_measured, kept, "q_measured")
        self.monitor.observe(step)
        last = self._last
        if last is not None:
            for name, value in zip(("q", "velocity", "q_next"), self._kept, strict=True):
                self._unchanged(getattr(last, name), value, f"{name} of the step before")
        self._last, self._kept = step, (_copy(step.q), _copy(step.velocity), _copy(step.q_next))
        return step

    def verdict(self) -> Verdict:
        """The verdict so far."""
        return self.monitor.verdict()

    def _unchanged(self, now: Any, before: Any, what: str) -> None:
        if isinstance(before, np.ndarray) and not np.array_equal(now, before, equal_nan=before.dtype.kind == "f"):
            self.monitor.report(Breach.MUTATED, detail=what)


def _copy(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value


def check_run(
    recording: Recording,
    cell: RobotCell,
    *,
    tolerances: MonitorTolerances | None = None,
    scene: CollisionScene | None = None,
) -> Verdict:
    """Judge a recorded run by its commands.

    Args:
        recording: the run, which starts at rest.
        cell: cell with the true limits and kinematics.
        tolerances: accepted deviations.
        scene: bodies whose distances are judged, too.

    Raises:
        InvalidInputError: a recording of another cell.
    """
    r = recording
    if (r.q_command.shape[1], r.velocity.shape[1], len(r.T_object_tool)) != (cell.nq, cell.nv, len(cell)):
        raise InvalidInputError(
            f"a recording with nq = {r.q_command.shape[1]}, nv = {r.velocity.shape[1]} and {len(r.T_object_tool)} "
            f"arms for a cell with nq = {cell.nq}, nv = {cell.nv} and {len(cell)} arms",
            "check_run",
            "Give the cell that the run was made with.",
        )
    monitor = Monitor(cell, r.grasp, tolerances=tolerances, scene=scene)
    return monitor.judge_recording(r)
