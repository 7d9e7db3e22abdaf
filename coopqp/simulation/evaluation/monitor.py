"""An independent monitor: checks that commands keep the limits, the chain, the path and the controller's promises.

The monitor checks commands, and wrenches where it is given them, and shares no code with the controllers: kinematics
come directly from Pinocchio's frames and limits from the cell. Use it to test your own controller, after a run
(:func:`check_run`) or during one (:class:`Monitor`, :class:`coopqp.simulation.Monitored`).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, final

import numpy as np

from coopqp.checks import ArrayLike, as_options
from coopqp.collision.scene import CollisionScene
from coopqp.control.interface import ControlStep, Status
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.paths.moving_grasps import grasp_at
from coopqp.paths.path import ObjectPath
from coopqp.simulation.evaluation.assessment import Tolerances
from coopqp.simulation.evaluation.blocks import Block, faults_of, recorded_block, sound_steps
from coopqp.simulation.evaluation.closeness import Closeness
from coopqp.simulation.evaluation.metrics import object_gaps
from coopqp.simulation.evaluation.readings import check_recording
from coopqp.simulation.evaluation.violations import Verdict, Violation, ViolationKind, Worst
from coopqp.simulation.evaluation.wrench_bounds import WrenchBounds, excesses
from coopqp.simulation.evaluation.wrenches import read_loads
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array

#: Accepted errors of commands, whose arms turn together more closely than measured ones.
COMMANDED = Tolerances(chain_deg=math.degrees(1e-3), object_deg=math.degrees(1e-2))
#: Rounding of limits [rad, m, rad/s or m/s; a share for accelerations], of commands that must be equal, of margins [m].
POSITION, VELOCITY, ACCELERATION, SAME, MARGIN = 1e-9, 1e-9, 1e-6, 1e-9, 1e-6
#: Accepted braking time of all arms together along a curved path, as a multiple of the slowest joint's braking time.
_BRAKING_SLACK = 1.1


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
        self._second = np.triu_indices(len(cell), 1)[1]  # of each pair of two arms
        limits = cell.limits
        self._lower, self._upper = np.array(limits.lower), np.array(limits.upper)
        self._speed, self._acceleration = np.array(limits.velocity), np.array(limits.acceleration)
        self._accelerates = bool(np.isfinite(self._acceleration).any())
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
        self._counts: Counter[ViolationKind] = Counter()
        self._worst = Worst()
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
            for kind, arm, amount, unit in excesses(self._bounds, self.grasp, wrenches):
                self.report(kind, arm=self.cell.arm_names[arm] if arm >= 0 else "", amount=amount, detail=unit)
        return tuple(self._violations[before:])

    def observe_all(
        self, steps: Sequence[ControlStep], *, shifts: Sequence[Array] | None = None
    ) -> tuple[Violation, ...]:
        """Check consecutive steps at once, at a lower cost per step; return their stored violations (see ``keep``).

        Raises:
            InvalidInputError: not one shift (N, 6) for each step; nothing is then checked.
        """
        if shifts is not None:
            self._check_shifts(shifts, len(steps))
        before, formed = len(self._violations), 0
        for i, step in enumerate([*steps, None]):
            if step is not None and not faults_of(step, self.cell, 0, 0.0):
                continue
            if i > formed:
                self._check(self._block(steps[formed:i], None if shifts is None else shifts[formed:i]))
            if step is not None:
                self._refuse(step)
            formed = i + 1
        return tuple(self._violations[before:])

    def _check_shifts(self, shifts: Sequence[Array], steps: int) -> None:
        wanted = (len(self.cell), 6)
        if len(shifts) != steps or any(np.shape(shift) != wanted for shift in shifts):
            raise InvalidInputError(
                f"shapes {[np.shape(shift) for shift in shifts]}", "Monitor: shift", f"Give one {wanted} for each step."
            )

    def report(self, kind: ViolationKind, *, arm: str = "", amount: float = 0.0, detail: str = "") -> None:
        """Add a violation found by the caller to the verdict."""
        self._add(Violation(kind, max(self._steps - 1, 0), self._time, arm, "", amount, detail))

    def verdict(self) -> Verdict:
        """The verdict so far."""
        limits = self.cell.limits
        for name, kept in (("lower", self._lower), ("upper", self._upper), ("velocity", self._speed)):
            if not np.array_equal(getattr(limits, name), kept):
                self.report(ViolationKind.MUTATED, detail=f"the cell's limits: {name}")
        return Verdict(self._steps, tuple(self._violations), MappingProxyType(dict(self._counts)), self._worst)

    def _add(self, violation: Violation) -> None:
        self._counts[violation.kind] += 1
        if len(self._violations) < self._keep:
            self._violations.append(violation)

    def _refuse(self, step: ControlStep) -> None:
        """Count the faults of a step. It is checked no further, and the next one is not compared with it."""
        for fault in faults_of(step, self.cell, self._steps, self._time):
            self._add(fault)
        self._steps += 1
        self._lose()

    def _lose(self) -> None:
        """Forget the last step: after a malformed step the next one is not compared with it."""
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
        clocks = numbers["clock_next"].tolist()
        return Block(
            **numbers,
            holding=np.array([step.status in (Status.HOLDING, Status.FAULT) for step in steps]),
            same_path=np.array([a is b for a, b in zip(before, paths, strict=True)]),
            reference=np.array(self._references(paths, clocks, steps) if self._kinematics else []),
            duration=np.array([path.duration for path in paths]),
            shift=self._shifts(paths, clocks) if shifts is None else np.array(shifts),
        )

    def _shifts(self, paths: Sequence[ObjectPath], clocks: Sequence[float]) -> Array | None:
        """By how much tools have moved on the object at clocks of paths (T, N, 6); None where all rest on it."""
        if all(path.grasps is None for path in paths):
            return None
        still = np.zeros((len(self.cell), 6))
        both = zip(paths, clocks, strict=True)
        return np.array([still if path.grasps is None else path.grasps.shifts(clock) for path, clock in both])

    def _references(
        self, paths: Sequence[ObjectPath], clocks: Sequence[float], steps: Sequence[ControlStep]
    ) -> list[Array]:
        """Where paths ask for the object (4, 4); by hand no path does, and it is where the first arm holds it."""
        return [
            (
                path.pose(clock)
                if step.sense
                else grasp_at(self.grasp, path, clock).carried(CellState(self.cell, step.q_next))[0]
            ).homogeneous
            for path, clock, step in zip(paths, clocks, steps, strict=True)
        ]

    def check_recorded(self, recording: Recording) -> Verdict:
        """Check a run; see :func:`check_run`."""
        r = recording
        last = -2  # the last sound step
        for part in r.parts(r.n_steps):
            sound = sound_steps(r, part)
            end = part.start
            for good, run in itertools.groupby(sound.tolist()):
                i, end = end, end + len(list(run))
                if good:
                    self._check(recorded_block(r, i, end, goes_on=last == i - 1))
                    last = end - 1
                    continue
                for row in range(i, end):
                    self._add(Violation(ViolationKind.NOT_FINITE, row, float(r.time[row]), amount=np.nan))
                self._steps += end - i
                self._lose()
        self._check_loads(r)
        return self.verdict()

    def _check_loads(self, r: Recording) -> None:
        """Torques of joints, and in motion internal forces and palms, where the run was recorded with them."""
        loads = read_loads(self.cell, r)
        if loads is None:
            return
        arms = [(name, "") for name in self.cell.arm_names]
        moving = np.arange(len(loads.time))[:, None] >= loads.moves
        palms = np.zeros_like(loads.internal) if loads.palm_use is None else loads.palm_use
        for kind, excess, owners, unit in (
            (ViolationKind.TORQUE, loads.torque_use - 1.0, self._names, "share of the limit"),
            (ViolationKind.SQUEEZE, np.where(moving, loads.internal - loads.internal_limit, 0.0), arms, "N"),
            (ViolationKind.FRICTION, np.where(moving, palms - 1.0, 0.0), arms, "share of the friction"),
        ):
            for t, k in np.argwhere(excess > 0.0):
                arm, joint = owners[k]
                self._add(Violation(kind, int(t), float(loads.time[t]), arm, joint, float(excess[t, k]), unit))

    def _check(self, block: Block) -> None:
        steps = len(block.dt)
        ends = self._time + np.cumsum(block.dt)
        x, x_next = self._positions(block.q), self._positions(block.q_next)
        v_before = np.vstack([self._last_v, block.velocity[:-1]])
        self._check_positions(x, x_next, ends)
        self._check_rates(block, v_before, ends)
        self._check_continuity(block, x, x_next, ends)
        self._check_clock(block, ends)
        self._check_holding(block, v_before, ends)
        if self._kinematics:
            self._check_object(block, ends)
        if self._closeness is not None:
            self._check_clearance(self._closeness, block, ends)
        self._steps += steps
        self._moved = self._moved or bool((block.rate > 0.0).any())
        self._time = float(ends[-1])
        self._last_q, self._last_v = block.q_next[-1].copy(), block.velocity[-1].copy()
        self._last_clock = float(block.clock_next[-1])

    def _positions(self, q: Array) -> Array:
        """Joint positions (T, nv); continuous joints in (−π, π]."""
        x: Array = q[:, self._at]
        for j in self._turning:
            x[:, j] = np.arctan2(q[:, self._at[j] + 1], q[:, self._at[j]])
        return x

    def _check_positions(self, x: Array, x_next: Array, ends: Array) -> None:
        excess = np.maximum(x_next - self._upper, self._lower - x_next)
        before = np.maximum(x - self._upper, self._lower - x)
        outward = excess - np.maximum(before, 0.0)  # an outside joint must not move further out
        self._note(position=float(outward.max()))
        self._joints(ViolationKind.POSITION, outward, POSITION, ends)

    def _check_rates(self, block: Block, v_before: Array, ends: Array) -> None:
        excess = np.abs(block.velocity) - self._speed
        self._note(velocity=float(excess.max()))
        self._joints(ViolationKind.VELOCITY, excess, VELOCITY, ends)
        if self._accelerates:
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.abs(block.velocity - v_before) / (block.dt[:, None] * self._acceleration) - 1.0
            share[np.isnan(v_before)] = -1.0
            self._note(acceleration=float(share.max()))
            self._joints(ViolationKind.ACCELERATION, share, ACCELERATION, ends)

    def _check_continuity(self, block: Block, x: Array, x_next: Array, ends: Array) -> None:
        gap = np.abs(self._difference(x, x_next) - block.velocity * block.dt[:, None])
        self._joints(ViolationKind.CONTINUITY, gap, SAME, ends, "q_next is not q + v dt")
        before = np.vstack([block.q[:1] if self._last_q is None else self._last_q[None, :], block.q_next[:-1]])
        jump = np.abs(self._difference(self._positions(before), x))
        self._joints(ViolationKind.CONTINUITY, jump, SAME, ends, "q is not the last q_next")
        for j in self._turning:
            i = self._at[j]
            radius = np.abs(np.hypot(block.q_next[:, i], block.q_next[:, i + 1]) - 1.0)
            self._all(ViolationKind.CONTINUITY, radius - SAME, ends, "off the unit circle")

    def _difference(self, start: Array, end: Array) -> Array:
        d: Array = end - start
        if self._turning.size:
            t = self._turning
            d[:, t] = np.arctan2(np.sin(d[:, t]), np.cos(d[:, t]))
        return d

    def _check_clock(self, block: Block, ends: Array) -> None:
        rate, advance = block.rate, block.clock_next - block.clock
        self._all(ViolationKind.RATE, np.maximum(-rate, rate - 1.0) - SAME, ends, "σ in [0, 1]")
        self._all(ViolationKind.RATE, np.where(block.dt > 0.0, -1.0, 1.0), ends, "dt > 0")
        # On the way back the clock falls; by hand it stands.
        self._all(ViolationKind.CLOCK, -block.sense * advance - SAME, ends, "runs backwards")
        # The last step may advance the clock by less than σ dt.
        ended = block.clock_next >= block.duration
        miss = block.sense * advance - np.abs(block.sense) * rate * block.dt
        miss = np.where(ended, miss, np.abs(np.where(block.sense == 0.0, advance, miss)))
        self._all(ViolationKind.CLOCK, miss - SAME * (1.0 + block.clock_next), ends, "does not advance by σ dt")
        before = np.concatenate([[self._last_clock], block.clock_next[:-1]])
        self._all(
            ViolationKind.CLOCK, np.where(block.same_path, np.abs(block.clock - before), 0.0) - SAME, ends, "jumps"
        )

    def _check_holding(self, block: Block, v_before: Array, ends: Array) -> None:
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
            if over > SAME:
                self._add(Violation(ViolationKind.HOLDING, self._steps + i, float(ends[i]), amount=over, detail="σ"))

    def _check_object(self, block: Block, ends: Array) -> None:
        t = self.tolerances
        chain = len(self._second)
        distance, angle = object_gaps(self.cell, self.grasp, block.q_next, block.reference, block.shift)
        for kind, values, allowed, unit in (
            (ViolationKind.CHAIN, distance[:, :chain], 1e-3 * t.chain_mm, "m"),
            (ViolationKind.CHAIN, angle[:, :chain], math.radians(t.chain_deg), "rad"),
            (ViolationKind.PATH, distance[:, chain:], 1e-3 * t.object_mm, "m"),
            (ViolationKind.PATH, angle[:, chain:], math.radians(t.object_deg), "rad"),
        ):
            if values.size == 0:  # a single arm forms no chain
                continue
            largest = float(values.max())
            self._note(**{f"{'chain' if kind is ViolationKind.CHAIN else 'path'}_{unit}": largest})
            if largest <= allowed:
                continue
            worst = values.argmax(axis=1)
            for i in np.flatnonzero(~(values.max(axis=1) <= allowed)):
                k = self._second[worst[i]] if kind is ViolationKind.CHAIN else worst[i]
                amount = float(values[i, worst[i]] - allowed)
                arm = self.cell.arm_names[int(k)]
                self._add(Violation(kind, self._steps + int(i), float(ends[i]), arm, "", amount, f"[{unit}]"))

    def _check_clearance(self, closeness: Closeness, block: Block, ends: Array) -> None:
        if self._last_q is None or not np.array_equal(self._last_q, block.q[0]):
            closeness.start(block.q[0])
        q = np.vstack([block.q[:1], block.q_next])
        for i, pair, missing in closeness.watch(q, tolerance=MARGIN):
            self._note(clearance_m=missing)
            self._add(
                Violation(
                    ViolationKind.CLEARANCE,
                    self._steps + i,
                    float(ends[i]),
                    amount=missing - MARGIN,
                    detail=f"[m] {pair}",
                )
            )

    # -- findings ----------------------------------------------------------------------------------------------------

    def _note(self, **figures: float) -> None:
        w = self._worst
        if any(not value <= getattr(w, name) for name, value in figures.items()):
            self._worst = replace(w, **{name: float(np.maximum(getattr(w, name), x)) for name, x in figures.items()})

    def _joints(self, kind: ViolationKind, amounts: Array, allowed: float, ends: Array, detail: str = "") -> None:
        """Add a violation for every joint with an amount (T, nv) above ``allowed``."""
        if amounts.max() <= allowed:
            return
        for i, j in np.argwhere(~(amounts <= allowed)):
            arm, joint = self._names[j]
            self._add(Violation(kind, self._steps + int(i), float(ends[i]), arm, joint, float(amounts[i, j]), detail))

    def _all(self, kind: ViolationKind, amounts: Array, ends: Array, detail: str) -> None:
        """Add a violation of all arms for every amount (T,) above 0."""
        for i in np.flatnonzero(~(amounts <= 0.0)):
            self._add(Violation(kind, self._steps + int(i), float(ends[i]), amount=float(amounts[i]), detail=detail))


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
    monitor = Monitor(cell, recording.grasp, tolerances=tolerances, scene=scene)
    return monitor.check_recorded(recording)
