"""The checks behind the rows of the catalogue: each runs controllers from ``make`` and returns figures.

The maker of the controllers is an argument. So test_broken_controllers.py can apply the same checks to broken
controllers as the other tests apply to sound ones.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from coopqp.core._core import RECOVERY_SHARE
from runs import built, drive, limited

from coopqp import (
    Cause,
    ControlStep,
    HoldPath,
    JointLimits,
    LinePath,
    ObjectPath,
    QPController,
    ServoPath,
    Status,
    WaypointPath,
    inverse_kinematics,
)
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.errors import UnreachableError
from coopqp.model import CellState
from coopqp.scenarios import Scenario, at_limit
from coopqp.simulation import Monitor, Verdict
from coopqp.solvers import QpProblem, QpSolution, QpSolver, SolverStatus, make_solver

Array: TypeAlias = npt.NDArray[np.float64]
#: ``make(task, **options)`` builds a controller for a scenario.
Maker: TypeAlias = Callable[..., Any]
#: Tolerances of a verdict without checks of chain and path, which are only measured.
WIDE: dict[str, Any] = dict.fromkeys(("chain_mm", "chain_deg", "object_mm", "object_deg"), 1e9)


def judged(task: Scenario, steps: Iterable[ControlStep], **tolerances: Any) -> Verdict:
    """The monitor's verdict on a run from rest."""
    monitor = Monitor(task.cell, task.grasp, tolerances=tolerances)
    monitor.observe_all(list(steps))
    return monitor.verdict()


# -- A4: stopping distance ---------------------------------------------------------------------------------------------

#: Motions of a joint towards its limit: at the outer bound of the box, at random in the box, or from bound to bound.
DRIVES = ("outward", "random", "bang")


@dataclass(frozen=True)
class Stopping:
    """Largest excesses over position [rad], velocity [rad/s] and acceleration limits (as a share), at least 0."""

    overshoot: float
    velocity: float
    acceleration: float
    unused: float  # largest unused share of a joint's way to the limit


def box_stops(rng: np.random.Generator, dt: float, n: int, how: str, box_of: Any = VelocityBox) -> Stopping:
    """``n`` joints at random distances from a limit; half of them at the largest speed from which they can stop."""
    acceleration = 10.0 ** rng.uniform(-0.5, 2.5, n)
    braking_steps = 10.0 ** rng.uniform(-1.5, 2.0, n)
    v = acceleration * dt * braking_steps
    distance = v * dt + 0.5 * v * v / acceleration
    distance *= 1.0 + np.where(rng.uniform(size=n) < 0.5, 0.0, rng.uniform(0.0, 0.2, n))
    speed = np.where(rng.uniform(size=n) < 0.5, np.inf, v * rng.uniform(1.0, 2.0, n))
    up = rng.uniform(size=n) < 0.5  # side of the limit
    low, high = np.where(up, -1e3, 0.0), np.where(up, 0.0, 1e3)
    cell: Any = _Joints(JointLimits(low, high, speed, acceleration), n)
    box, x, v = box_of(cell), np.where(up, -distance, distance), np.where(up, v, -v)
    overshoot = velocity = used = 0.0
    for _ in range(130):  # then the slowest have stopped
        box.update(x, v, dt)
        share = {"outward": up * 1.0, "random": rng.uniform(size=n), "bang": rng.integers(0, 2, n) * 1.0}[how]
        v_next = box.lower + share * (box.upper - box.lower)
        velocity = max(velocity, float((np.abs(v_next) - speed).max()))
        used = max(used, float((np.abs(v_next - v) / (acceleration * dt)).max()))
        x, v = x + v_next * dt, v_next
        overshoot = max(overshoot, float(np.maximum(x - high, low - x).max()))
    return Stopping(overshoot, velocity, max(used - 1.0, 0.0), float((np.abs(x) / distance).max()))


@dataclass(frozen=True)
class _Joints:
    """The parts of a cell that a box uses, for joints without a cell."""

    limits: JointLimits
    nv: int

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(f"arm/{j}" for j in range(self.nv))


def controller_overshoot(make: Maker, rng: np.random.Generator, dt: float, runs: int) -> tuple[float, int, int]:
    """Three arms run into their joint limits: along a path, after a moving target, or during a forced hold.

    Returns the largest overshoot [rad], the number of steps, and the number of steps with a joint at its limit.
    """
    worst, steps, touching = -np.inf, 0, 0
    for run in range(runs):
        task = at_limit(
            direction=tuple(rng.normal(size=3)),
            rotation=tuple(rng.normal(size=3) * (run % 2)),
            margin=rng.uniform(0.02, 0.12, size=18),
            speed=float(rng.uniform(0.1, 0.6)),
            acceleration=float(10.0 ** rng.uniform(0.0, 1.5)),
        )
        task = replace(task, dt=dt)
        moving = run % 3 == 1
        if moving:
            start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
            task = replace(task, path=ServoPath(start, speed=0.4, spin=1.0))
        controller = make(task)
        controller.reset(task.q_start)
        if moving:
            controller.retarget(goal)
        done = []
        for i in range(int(1.0 / dt)):
            holds = run % 3 == 2 and i * dt > 0.1 and i % 7 == 0
            done.append(controller.step(dt=np.nan if holds else None))
        low, high = task.cell.limits.lower, task.cell.limits.upper
        x = np.array([s.q_next for s in done])
        over = np.maximum(x - high, low - x)
        worst = max(worst, float(over.max()))
        touching += int((over.max(axis=1) > -1e-4).sum())
        steps += len(done)
    return worst, steps, touching


# -- A5: a solver that fails -------------------------------------------------------------------------------------------

#: Joints slower than this are at rest [rad/s]; the remaining motion corrects errors of micrometres.
REST = 1e-4
#: Statuses of a step after a solver failure.
STOPPED = (Status.HOLDING, Status.FAULT)


class FaultySolver(QpSolver):
    """Works until ``broken``, then returns ``fault(solver, problem)`` for QPs of up to ``most`` unknowns."""

    def __init__(self, solver: str, fault: Callable[[QpSolver, QpProblem], Any], *, most: float = math.inf) -> None:
        self.solver, self.fault = make_solver(solver), fault
        self.name, self.settings = self.solver.name, self.solver.settings
        self.broken, self.hits, self._most = False, 0, most

    def _forget(self) -> None:
        self.solver.reset()

    def _solve(self, problem: QpProblem, work: Any) -> Any:
        raise NotImplementedError("solve() asks the other solver")

    def solve(self, problem: QpProblem) -> Any:
        if not self.broken or problem.g.size > self._most:
            return self.solver.solve(problem)
        self.hits += 1
        return self.fault(self.solver, problem)


def _raising(error: type[Exception]) -> Callable[[QpSolver, QpProblem], Any]:
    def fault(solver: QpSolver, problem: QpProblem) -> Any:
        raise error("the solver is broken")

    return fault


def _answering(value: Any, status: SolverStatus = SolverStatus.SOLVED) -> Callable[[QpSolver, QpProblem], Any]:
    """A fault that returns a solution full of ``value``."""

    def fault(solver: QpSolver, problem: QpProblem) -> QpSolution:
        return replace(solver.solve(problem), x=np.full(problem.g.size, value), status=status)

    return fault


#: Faults of a solver. One real solver fills its memory with 2.1e9.
FAULTS: dict[str, Callable[[QpSolver, QpProblem], Any]] = {
    **{f"raises {e.__name__}": _raising(e) for e in (RuntimeError, ValueError, ZeroDivisionError, MemoryError)},
    **{f"raises {e.__name__}": _raising(e) for e in (KeyError, TypeError, OSError, AssertionError, AttributeError)},
    "returns nothing": lambda solver, problem: None,
    "returns a bare array": lambda solver, problem: np.zeros(problem.g.size),
    "answers NaN": _answering(np.nan),
    "answers inf": _answering(np.inf),
    "answers 2.1e9": _answering(2.1e9),
    "answers -2.1e9": _answering(-2.1e9),
    "answers too few": lambda solver, problem: replace(solver.solve(problem), x=np.zeros(1)),
    "answers no array": lambda solver, problem: replace(solver.solve(problem), x=None),
    **{f"status: {s.value}": _answering(np.nan, s) for s in SolverStatus if s is not SolverStatus.SOLVED},
    "status: failed, with an answer": _answering(0.0, SolverStatus.FAILED),
}


@dataclass(frozen=True)
class Failure:
    """The result of a solver failure.

    Attributes:
        held: True if the step of the failure already reports it.
        hits: number of steps with a failed call.
        stopping: time until all joints rest; NaN if the solver recovered. Its unit is that of the slowest joint alone
            plus two steps, or of the hardest stop on the object's way plus two steps where that takes longer.
        alone: the same, always in the unit of the slowest joint alone.
        chain_mm: growth of the chain error [mm].
        recovery: number of steps until the status changes after the solver's recovery.
        broken: number of other broken promises: limits, continuity, clock.
    """

    held: bool
    hits: int
    stopping: float
    alone: float
    chain_mm: float
    recovery: float
    broken: int


def solver_fails(
    make: Maker,
    task: Scenario,
    fault: Callable[[QpSolver, QpProblem], Any],
    *,
    at: int,
    for_ever: bool,
    goal: Any = None,
) -> Failure:
    """Run a controller with a QP in every step, whose solver fails after ``at`` steps in every form of the QP."""
    double = FaultySolver("daqp", fault)
    controller = set_off(make, task, double, goal)
    return fails_now(task, controller, double, [controller.step() for _ in range(at)], for_ever=for_ever)


def set_off(make: Maker, task: Scenario, solver: FaultySolver, goal: Any = None) -> QPController:
    """A controller with a QP in every step that begins a task, or goes to a moving target."""
    controller: QPController = make(task, shortcut=False, solver=solver)
    controller.reset(task.q_start)
    if goal is not None:
        controller.retarget(goal)
    return controller


def fails_now(
    task: Scenario, controller: QPController, double: FaultySolver, steps: list[ControlStep], *, for_ever: bool
) -> Failure:
    """The solver of a controller fails after the ``steps`` that it has done."""
    monitor, at = Monitor(task.cell, task.grasp, tolerances=WIDE), len(steps)
    monitor.observe_all(steps)
    chain_before, steps = monitor.verdict().worst.chain_m, list(steps)
    v, dt, limits = steps[-1].velocity, task.dt, task.cell.limits
    alone, whole = float(np.max(np.abs(v) / limits.acceleration)), copy.deepcopy(controller)
    double.hits = 0
    double.broken = True
    steps.append(controller.step())
    held, hits = steps[-1].status in STOPPED, int(double.hits > 0)
    stopping, relative, recovery = np.nan, np.nan, 0.0
    if for_ever:
        longest = int(3.0 * alone / dt) + 10
        while np.abs(steps[-1].velocity).max() > REST and len(steps) < at + longest:
            before_it = double.hits
            steps.append(controller.step())
            held, hits = held and steps[-1].status in STOPPED, hits + (double.hits > before_it)
        stopped = bool(np.abs(steps[-1].velocity).max() <= REST)
        took = (len(steps) - 1 - at) * dt if stopped else np.inf
        stopping = relative = took / (alone + 2.0 * dt)
        double.broken = False  # the copy shares it
        if np.isfinite(took) and relative > 1.0:
            stopping = min(relative, took / (hardest_stop(whole, steps[at - 1]) + 2.0 * dt))
    double.broken = False
    after = [controller.step() for _ in range(30)]
    recovery = next((i + 1.0 for i, s in enumerate(after) if s.status not in STOPPED), np.inf)
    monitor.observe_all([*steps[at:], *after])
    verdict = monitor.verdict()
    growth = 1e3 * (verdict.worst.chain_m - chain_before)
    return Failure(held, hits, stopping, relative, growth, recovery, sum(verdict.counts.values()))


def hardest_stop(controller: QPController, last: ControlStep) -> float:
    """Shortest time in which all joints come to rest on the way that the controller would go on [s].

    Step by step the object goes on by as little as the joints' accelerations allow.

    Args:
        controller: before the stop.
        last: its last step.
    """
    from scipy.interpolate import CubicSpline

    cell, h = controller.cell, controller.dt
    clocks, table = [last.clock_next], [cell.positions(last.q_next)]
    for _ in range(1000):
        step = controller.step()
        if step.clock_next > clocks[-1] + 1e-6:
            clocks.append(step.clock_next)
            table.append(cell.positions(step.q_next))
        if step.finished or step.status in STOPPED:
            break
    way, acceleration = CubicSpline(clocks, np.array(table)), cell.limits.acceleration
    clock, x, v, rate, count = clocks[0], table[0], last.velocity, last.rate, 0
    while np.abs(v).max() > REST:
        rates = np.linspace(0.0, rate, 2001)
        moved = (way(np.minimum(clock + rates * h, clocks[-1])) - x) / h
        allowed = (np.abs(moved - v) <= acceleration * h * (1.0 + 1e-9)).all(axis=1)
        if not allowed.any():
            return 0.0  # it cannot stop on its way: nothing is known
        i = int(allowed.argmax())
        clock, rate, v, count = min(clock + rates[i] * h, clocks[-1]), float(rates[i]), moved[i], count + 1
        x = x + v * h
    return count * h


# -- A1: any command ---------------------------------------------------------------------------------------------------

#: Number of steps that are judged at once.
BLOCK = 1000


@dataclass
class Commands:
    """Random steps.

    Attributes:
        steps: number of judged steps.
        violations: number by kind: form, finiteness, limits, continuity, clock, modified data; and exceptions.
        statuses: number of steps with each status.
    """

    steps: int = 0
    violations: Counter[str] = field(default_factory=Counter)
    statuses: Counter[Status] = field(default_factory=Counter)


def rough_steps(
    make: Maker, task: Scenario, rng: np.random.Generator, steps: int, *, measured: float, stretch: int = BLOCK
) -> Commands:
    """Run one controller with random events, and judge every command.

    The events are new paths and targets (too fast, unreachable), varying and invalid lengths of steps, resets,
    overrides, pauses; and in a share ``measured`` of the time measured configurations with noise, jumps, NaN. The next
    event follows after at most ``stretch`` steps.
    """
    result, monitor = Commands(), Monitor(task.cell, task.grasp, tolerances=WIDE, kinematics=False)
    limits = [np.array(getattr(task.cell.limits, name)) for name in ("lower", "upper", "velocity", "acceleration")]
    block: list[ControlStep] = []
    handed: list[tuple[Array, bytes]] = []
    told: list[Any] = []  # the arrays of the steps as they were handed out
    kept: list[bytes] = []  # and their contents then

    def judge() -> None:
        if not block:
            return
        monitor.observe_all(block)
        again, before = [part for step in block for part in _arrays(step)], b"".join(kept)
        result.violations["mutated"] += (_bytes(told) != before) + (_bytes(again) != before)
        result.violations["mutated"] += sum(a.tobytes() != b for a, b in handed)
        result.statuses.update(s.status for s in block)
        result.steps += len(block)
        for done in (block, told, kept, handed):
            done.clear()

    q = np.array(task.q_start)
    controller, hand = make(task), np.random.default_rng(steps)
    controller.reset(q)
    while result.steps + len(block) < steps:
        mode = rng.choice(["plain", "dt", "measured"], p=[0.8 * (1.0 - measured), 0.2 * (1.0 - measured), measured])
        _take_the_reins(controller, hand)
        noise, wild, faulty = 10.0 ** rng.uniform(-6.0, -3.0), rng.uniform() < 0.3, False
        for _ in range(min(int(rng.integers(1, stretch)), BLOCK - len(block))):
            argument, dt = None, None
            if mode == "dt":
                dt = rng.choice(_LENGTHS) if wild else task.dt * float(rng.uniform(0.5, 2.0))
            elif mode == "measured":
                argument = _measured(task, q, rng, noise, wild)
                handed.append((argument, argument.tobytes()))
            try:
                step = controller.step(argument, dt=dt)
            except Exception as error:
                result.violations[f"raised {type(error).__name__}"] += 1
                break
            block.append(step)
            arrays = _arrays(step)
            told += arrays
            kept.append(_bytes(arrays))
            if getattr(arrays[2], "shape", None) == q.shape:
                q = arrays[2]
            faulty = step.status is Status.FAULT
            if faulty:
                break
        if len(block) == BLOCK:
            judge()
        if not np.isfinite(q).all():
            q = np.array(task.q_start)
        _interfere(controller, task, q, rng, judge, monitor, faulty=faulty)
    judge()
    verdict = monitor.verdict()
    result.violations.update({kind.name: n for kind, n in verdict.counts.items()})
    for name, before in zip(("lower", "upper", "velocity", "acceleration"), limits, strict=True):
        result.violations["mutated"] += not np.array_equal(getattr(task.cell.limits, name), before)
    result.violations += Counter()  # drops zeros
    return result


def _take_the_reins(controller: Any, rng: np.random.Generator) -> None:
    """Sometimes another override, a short pause, or the end of one."""
    if not hasattr(controller, "set_override"):  # broken on purpose, by a wrapper
        return
    if rng.uniform() < 0.2:
        controller.set_override(float(rng.choice([1.0, 0.6, 0.2, 0.0], p=[0.7, 0.1, 0.1, 0.1])))
    if rng.uniform() < 0.05:
        controller.pause()
    elif rng.uniform() < 0.7:
        controller.resume()


def _arrays(step: ControlStep) -> tuple[Any, ...]:
    return step.q, step.velocity, step.q_next


def _bytes(parts: Sequence[Any]) -> bytes:
    """The contents of a command's arrays, bit for bit."""
    try:
        return b"".join(parts)  # takes arrays as they are
    except (TypeError, ValueError, BufferError):  # a broken controller's are none
        return b"".join(np.asarray(part).tobytes() for part in parts)


#: Invalid and extreme lengths of a step.
_LENGTHS = np.array([0.0, -1.0, np.nan, np.inf, 1e-12, 1e9])


def _measured(task: Scenario, q: Array, rng: np.random.Generator, noise: float, wild: bool) -> Array:
    """The commanded configuration with errors of an encoder."""
    moved = rng.uniform(-noise, noise, task.cell.nv)
    if wild and rng.uniform() < 0.2:
        moved[rng.integers(task.cell.nv)] += rng.choice([0.01, 0.2, -1.0])
    argument = np.array(pin.integrate(task.cell.model, q, moved))
    if wild and rng.uniform() < 0.05:
        argument[rng.integers(task.cell.nq)] = rng.choice([np.nan, np.inf, 1e300])
    return argument


def random_path(rng: np.random.Generator, start: pin.SE3) -> ObjectPath:
    """A path from ``start``: slow or much too fast, near or out of reach, smooth or with corners."""

    def away(T: pin.SE3) -> pin.SE3:
        size = 10.0 ** rng.uniform(-3.0, 0.0)
        return T * pin.exp6(size * rng.normal(size=6) * np.array([0.3, 0.3, 0.3, 1.0, 1.0, 1.0]))

    duration, law = float(10.0 ** rng.uniform(-1.0, 1.0)), str(rng.choice(["linear", "quintic"]))
    kind = rng.integers(3)
    if kind == 0:
        return ServoPath(start, speed=float(10.0 ** rng.uniform(-2.0, 0.5)), spin=float(10.0 ** rng.uniform(-2.0, 0.5)))
    if kind == 1:
        return LinePath(start, away(start), duration=duration, time_law=law)
    middle = away(start)
    return WaypointPath([start, middle, away(middle)], durations=[duration, 0.5 * duration], time_law=law)


def _interfere(
    controller: Any,
    task: Scenario,
    q: Array,
    rng: np.random.Generator,
    judge: Callable[[], None],
    monitor: Monitor,
    *,
    faulty: bool,
) -> None:
    """Set a new path or target, or reset at the present configuration; after a fault always reset."""
    here = task.grasp.carried(CellState(task.cell, q))[0]
    if not faulty and isinstance(controller.path, ServoPath) and rng.uniform() < 0.7:
        controller.retarget(here * pin.exp6(10.0 ** rng.uniform(-3.0, 0.0) * rng.normal(size=6)))
    elif not faulty and rng.uniform() < 0.7:
        controller.follow(random_path(rng, here))
    elif faulty or rng.uniform() < 0.3:
        judge()
        controller.follow(HoldPath(here))
        controller.reset(q)
        monitor.restart()


# -- A2: limits --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Saturated:
    """A run at the limits.

    Attributes:
        excess: largest excess over a position [rad or m], velocity [rad/s or m/s] and acceleration limit (a share), at
            least 0.
        steps, touching, qps: numbers of judged steps, of steps with a joint at a speed or acceleration limit or within
            0.1 mrad of the end of its range, and of steps with a QP.
        broken: number of broken promises of any kind.
    """

    excess: Array
    steps: int
    touching: int
    qps: int
    broken: int


def saturated(controller: Any, task: Scenario, start: int, steps: int, goal: Any = None) -> Saturated:
    """Judge a run; count the steps at a limit from step ``start``."""
    controller.reset(task.q_start)
    if goal is not None:
        controller.retarget(goal)
    done = [controller.step() for _ in range(start + steps)]
    verdict, limits = judged(task, done, **WIDE), task.cell.limits
    x = np.array([task.cell.positions(s.q_next) for s in done])
    v = np.array([s.velocity for s in done])
    change = np.abs(np.diff(v, axis=0, prepend=np.zeros((1, v.shape[1]))))
    at_limit = (np.abs(v) > 0.94 * limits.velocity) | (change > 0.9 * limits.acceleration * task.dt)
    at_limit |= (x > limits.upper - 1e-4) | (x < limits.lower + 1e-4)
    worst = verdict.worst
    return Saturated(
        np.maximum([worst.position, worst.velocity, worst.acceleration], 0.0),
        steps,
        int(at_limit[start:].any(axis=1).sum()),
        sum(s.solver.name != "none" for s in done[start:]),
        sum(verdict.counts.values()),
    )


# -- A3: a start outside the limits ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Return:
    """The return of joints to their limits.

    Attributes:
        outward: largest outward velocity of a joint outside [rad/s], at least 0.
        growth: largest growth of the distance from a limit in one step [rad], at least 0.
        ratio: time until all joints are inside, relative to the time of the slowest joint alone; inf if they stay out.
        chain_mm: largest chain error [mm].
        failures: number of holding steps, but for those that hold because the commands parted the arms.
        broken: number of other broken promises: limits, continuity, clock.
        steps: number of steps of the run.
    """

    outward: float
    growth: float
    ratio: float
    chain_mm: float
    failures: int
    broken: int
    steps: int


def fenced_out(task: Scenario, depths: dict[int, float], **limits: Any) -> Scenario:
    """Move position limits so that the joints start outside by these distances [rad]; positive means above."""
    upper, lower = np.array(task.cell.limits.upper), np.array(task.cell.limits.lower)
    for j, depth in depths.items():
        x = task.cell.positions(task.q_start)[j]
        if depth > 0.0:
            upper[j] = x - depth
        else:
            lower[j] = x - depth
    return limited(task, lower=lower, upper=upper, **limits)


def alone_inside(depth: float, speed: float, acceleration: float) -> float:
    """Time [s] of a single joint for ``depth`` from rest at the recovery speed."""
    if 0.5 * speed * speed / acceleration < depth:
        return depth / speed + 0.5 * speed / acceleration
    return float(np.sqrt(2.0 * depth / acceleration))


def ideal_return(task: Scenario, depths: dict[int, float], motion: dict[int, float] | None = None) -> float:
    """Time [s] for joints outside to return, each as fast as alone, and for other joints to move by ``motion``."""
    speed, acceleration = (
        np.asarray(x, dtype=float) for x in (task.cell.limits.velocity, task.cell.limits.acceleration)
    )
    slow = RECOVERY_SHARE * speed
    back = [alone_inside(abs(d), float(slow[j]), float(acceleration[j])) for j, d in depths.items()]
    others = [alone_inside(abs(d), float(speed[j]), float(acceleration[j])) for j, d in (motion or {}).items() if d]
    return max(back + others)


def from_outside(
    make: Maker, task: Scenario, depths: dict[int, float], ideal: float | None = None, **options: Any
) -> Return:
    """Run a task with joints outside by these distances, until 0.1 s after their latest return."""
    limits, cell, dt = task.cell.limits, task.cell, task.dt
    ideal = ideal_return(task, depths) if ideal is None else ideal
    controller = make(task, **options)
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(int((1.6 * ideal + 0.1) / dt))]
    x = np.array([cell.positions(q) for q in (steps[0].q, *(s.q_next for s in steps))])
    v = np.array([s.velocity for s in steps])
    above, below = x - limits.upper, limits.lower - x
    excess = np.maximum(np.maximum(above, below), 0.0)
    leading_out = np.where(above[:-1] > 0.0, v, np.where(below[:-1] > 0.0, -v, 0.0))
    inside = np.flatnonzero(excess.max(axis=1) <= 0.0)
    verdict = judged(task, steps, **WIDE)
    return Return(
        outward=max(0.0, float(leading_out.max())),
        growth=max(0.0, float(np.diff(excess, axis=0).max())),
        ratio=float(inside[0] * dt / ideal) if inside.size else np.inf,
        chain_mm=1e3 * verdict.worst.chain_m,
        failures=sum(s.status in STOPPED and s.cause is not Cause.COMMANDED_CHAIN for s in steps),
        broken=sum(verdict.counts.values()),
        steps=len(steps),
    )


def shifted_together(
    rng: np.random.Generator, task: Scenario, size: float, joints: int
) -> tuple[dict[int, float], dict[int, float]]:
    """Distances of joints of several arms outside their limits, with one object motion that leads all of them back.

    Args:
        size: approximate largest distance [rad].
        joints: number of joints, spread over the arms.

    Returns:
        The distances, and the displacement of the other joints by the object motion.
    """
    cell, start = task.cell, task.path.pose(0.0)
    chosen: list[int] = []
    for k in range(joints):
        s = cell.v_slices[k % len(cell)]
        left = [j for j in range(s.start, s.stop) if j not in chosen and not cell.continuous[j]]
        chosen.append(int(rng.choice(left)))
    while True:
        twist, scale = rng.normal(size=6) * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]), 1e-3
        for _ in range(2):
            try:
                q = inverse_kinematics(cell, task.grasp, start * pin.exp6(scale * twist), task.q_start)
            except UnreachableError:
                break
            motion = pin.difference(cell.model, task.q_start, q)
            scale *= size / np.abs(motion[chosen]).max()
        else:
            if np.abs(motion[chosen]).max() <= 1.5 * size:
                break
    # A joint that the motion moves down starts above its limit.
    depths = {j: -float(motion[j]) for j in chosen if abs(motion[j]) > 1e-4}
    return depths, {j: float(d) for j, d in enumerate(motion) if j not in depths}


# -- A9: one joint saturates -------------------------------------------------------------------------------------------

#: Smallest object speed at which shares of the speed are judged [m/s]; 1 rad counts as 0.3 m.
MOVING = 1e-3
_WEIGHTS = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])


@dataclass(frozen=True)
class Sharing:
    """The slowing of all arms while one joint is at its limit.

    Attributes:
        spread: largest difference between the arms' rates along the path.
        angle: largest angle between the path and the object motion of any arm [deg].
        steps: number of steps with a joint at its limit.
        chain_mm: largest chain error of the run [mm].
    """

    spread: float
    angle: float
    steps: int
    chain_mm: float


def needed_speeds(task: Scenario) -> Array:
    """Largest speed of each joint along the path without limits (nv,) [rad/s]."""
    free = limited(task, velocity=100.0)
    return np.asarray(np.abs([s.velocity for s in drive(built(free), 5000)]).max(axis=0))


def slows_together(
    make: Maker, task: Scenario, share: float, *, joint: int | None = None, peak: Array | None = None, **options: Any
) -> Sharing:
    """Set speed limits to a share of the needed speed: of one joint, or of all (a share for the fastest joint).

    ``peak`` are the task's :func:`needed_speeds` where they are known.
    """
    peak = needed_speeds(task) if peak is None else peak
    speed = np.array(task.cell.limits.velocity)
    if joint is None:
        speed *= share * float((peak / speed).max())
    else:
        speed[joint] = share * peak[joint]
    cut = limited(task, velocity=speed)
    steps = drive(make(cut, **options), 10_000, start=task.q_start, rest=5)
    saturated = []
    for s in steps:
        fast = np.linalg.norm(_WEIGHTS * s.path.twist(s.clock)) * s.rate > MOVING
        part = 1.0 - 1e-6 if not np.isfinite(cut.cell.limits.acceleration).any() else 0.94  # a preview plans with 95 %
        at_limit = np.abs(s.velocity) >= part * speed
        if fast and s.rate < 1.0 and (at_limit.any() if joint is None else at_limit[joint]):
            saturated.append(s)
    rates, angles = arm_rates(cut, saturated)
    return Sharing(
        float(np.ptp(rates, axis=1).max(initial=0.0)),
        float(np.rad2deg(angles).max(initial=0.0)),
        len(saturated),
        1e3 * judged(cut, steps, **WIDE).worst.chain_m,
    )


def arm_rates(task: Scenario, steps: list[ControlStep]) -> tuple[Array, Array]:
    """Each arm's rate along the path (T, N), and the angle between its object motion and the path (T, N) [rad].

    The values come from Pinocchio's Jacobians at the midpoints of the steps.
    """
    cell, model, data = task.cell, task.cell.model, task.cell.model.createData()
    wanted, twists = np.empty((len(steps), 6)), np.empty((len(steps), len(cell), 6))
    for i, step in enumerate(steps):
        path, v = step.path, step.velocity
        J = pin.computeJointJacobians(model, data, pin.integrate(model, step.q, 0.5 * step.dt * v))
        start, middle = path.pose(step.clock), path.pose(0.5 * (step.clock + step.clock_next)).actionInverse
        moved = pin.log6(start.actInv(path.pose(step.clock_next))).vector
        wanted[i] = middle @ start.action @ moved / (step.clock_next - step.clock)
        # At the world's origin all arms' tools and joints have the twists of one rigid body each.
        twists[i] = np.array([J[:, s] @ v[s] for s in cell.v_slices]) @ middle.T
    wanted, twists = _WEIGHTS * wanted, _WEIGHTS * twists
    length = np.linalg.norm(wanted, axis=1)[:, None]
    rates = np.einsum("tni,ti->tn", twists, wanted) / length**2
    aside = np.linalg.norm(twists - rates[..., None] * wanted[:, None], axis=2)
    return rates, np.arctan2(aside, rates * length)
