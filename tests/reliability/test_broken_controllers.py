"""H: the checks of the catalogue applied to broken controllers. The checks must catch every one of them.

A check that accepts broken controllers proves nothing. All defects are realistic: a wrong limit, a brake without
effect, a failed solve used as a solution, shared memory that is overwritten. They are made around the controller: its
steps are falsified, or it is told something else than the judge knows.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from checks import (
    FAULTS,
    STOPPED,
    FaultySolver,
    box_stops,
    controller_overshoot,
    fenced_out,
    from_outside,
    judged,
    rough_steps,
    saturated,
    slows_together,
    solver_fails,
)
from runs import cooperative, drive, limited

from coopqp import ControlStep, ServoPath, Status
from coopqp.baselines import IndependentQPController, PseudoInverseController, PseudoInverseOptions
from coopqp.control.interface import amend
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.scenarios import Scenario, at_limit, at_singularity, fast_lift, mixed_cell, paper_lift
from coopqp.simulation import Monitor, Monitored, ViolationKind
from coopqp.solvers import SolverStatus

Spoil = Callable[[ControlStep, int], ControlStep]


class Spoiled:
    """A sound controller with spoiled commands."""

    def __init__(self, controller: Any, spoil: Spoil) -> None:
        self._inner, self._spoil, self._count = controller, spoil, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        self._count += 1
        return self._spoil(self._inner.step(q_measured, dt=dt), self._count)

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return copy.deepcopy(self._inner, memo)  # what the sound one would do from here on


class Sending(Spoiled):
    """Sends other velocities than a sound controller finds, and goes on from where these lead.

    ``velocity(step, v)`` of its step and of the velocities that were sent last (nv,).
    """

    def __init__(self, controller: Any, velocity: Callable[[ControlStep, Any], Any]) -> None:
        super().__init__(controller, lambda step, i: self._sent(step))
        self._velocity = velocity

    def reset(self, q: Any) -> None:
        self._inner.reset(q)
        self._q, self._v = np.array(q), np.zeros(self._inner.cell.nv)

    def _sent(self, step: ControlStep) -> ControlStep:
        q, self._v = self._q, self._velocity(step, self._v)
        self._q = step.cell.moved(q, step.dt * self._v)
        return step.replaced(q=q, velocity=self._v, q_next=self._q)


def spoiled(spoil: Spoil) -> Callable[..., Any]:
    return lambda task, **options: Spoiled(cooperative(task, **options), spoil)


def lift() -> Scenario:
    return replace(paper_lift(time_law="quintic"), dt=0.002)


def with_believed(**factors: float) -> Callable[..., Any]:
    """Controllers that take limits to be wider than they are, by a factor; positions by a margin [rad]."""

    def make(task: Scenario, **options: Any) -> Any:
        limits, margin = task.cell.limits, factors.get("position", 0.0)
        believed = limited(
            task,
            lower=np.array(limits.lower) - margin,
            upper=np.array(limits.upper) + margin,
            velocity=np.array(limits.velocity) * factors.get("velocity", 1.0),
            acceleration=np.array(limits.acceleration) * factors.get("acceleration", 1.0),
        )
        return cooperative(believed, **options)

    return make


# -- A1: commands ------------------------------------------------------------------------------------------------------


def as_it_is(step: ControlStep, **changes: Any) -> ControlStep:
    """A step with changed fields. It bypasses the constructor, which would correct the arrays."""
    other = step.replaced()
    amend(other, **changes)
    return other


def changed(step: ControlStep, name: str, j: int, by: float) -> ControlStep:
    """A step with one changed number."""
    value = np.array(getattr(step, name))
    value[j] = by if np.isnan(by) else value[j] + by
    return step.replaced(**{name: value})


def now_and_then(spoil: Callable[[ControlStep], ControlStep], every: int = 50) -> Spoil:
    return lambda step, i: spoil(step) if i % every == 0 else step


COMMANDS: dict[str, Spoil] = {
    "a velocity that is NaN": now_and_then(lambda s: changed(s, "velocity", 3, np.nan)),
    "a configuration that is NaN": now_and_then(lambda s: changed(s, "q_next", 7, np.nan)),
    "single precision": now_and_then(lambda s: as_it_is(s, velocity=s.velocity.astype(np.float32))),
    "one number missing": now_and_then(lambda s: as_it_is(s, velocity=s.velocity[:-1])),
    "a list": now_and_then(lambda s: as_it_is(s, q_next=s.q_next.tolist())),
    "a status that is none": now_and_then(lambda s: s.replaced(status="tracking")),
    "a configuration that the velocity does not lead to": now_and_then(lambda s: changed(s, "q_next", 2, 1e-7)),
    "a configuration that is not the last one": now_and_then(lambda s: changed(s, "q", 2, 1e-7)),
    "a speed above the limit": now_and_then(
        lambda s: changed(s, "velocity", 4, float(s.cell.limits.velocity[4] - s.velocity[4]) + 1e-6)
    ),
    "a clock that runs backwards": now_and_then(lambda s: s.replaced(clock_next=s.clock - 1e-6)),
    "a clock that runs at full rate all the time": lambda s, i: s.replaced(
        clock_next=min(s.clock + s.dt, s.path.duration), rate=s.rate
    ),
    "a rate above 1": now_and_then(lambda s: s.replaced(rate=1.0 + 1e-6)),
}


class OwnMemory:
    """Returns the same array in every step."""

    def __init__(self) -> None:
        self.memory: dict[int, Any] = {}

    def __call__(self, step: ControlStep, i: int) -> ControlStep:
        kept = self.memory.setdefault(step.velocity.size, np.empty_like(step.velocity))
        kept[:] = step.velocity
        return as_it_is(step, velocity=kept)


class Scribbler(Spoiled):
    """Writes into its input configuration."""

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        step = super().step(q_measured, dt=dt)
        if q_measured is not None:
            q_measured[0] += 1e-9
        return step


class Raising(Spoiled):
    """Uses every dt without a check."""

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        if dt is not None and not 0.0 < dt < 1.0:
            raise ValueError("dt")
        return super().step(q_measured, dt=dt)


def rough(make: Callable[..., Any], measured: float = 0.0) -> bool:
    """True if the check of A1 finds a violation: in a few steps, or in as many as the sound controller passes."""
    task = limited(paper_lift(), velocity=0.3)
    runs = (
        rough_steps(make, task, np.random.default_rng(3), steps, measured=measured, stretch=100)
        for steps in (400, 4000)
    )
    return any(run.violations for run in runs)


def kind(wrapper: Any) -> Callable[..., Any]:
    return lambda task, **options: wrapper(cooperative(task, **options), lambda step, i: step)


# -- A2 to A4: limits --------------------------------------------------------------------------------------------------


def exceeds(make: Callable[..., Any], limit: int) -> bool:
    """True if the check of A2 finds an excess of position, velocity or acceleration over its target."""
    task, goal = (fast_lift(), None) if limit == 1 else (limited(fast_lift(), acceleration=5.0), None)
    if limit == 0:
        task = at_limit(margin=0.1, acceleration=np.inf)
        start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
        task = replace(task, path=ServoPath(start, speed=0.4, spin=1.0))
    return bool(saturated(make(task), task, 0, 400, goal).excess[limit] > (1e-9, 1e-9, 1e-6)[limit])


#: How far joints start outside their limits [rad].
DEPTHS = {8: 0.02}


def returns_wrongly(make: Callable[..., Any]) -> bool:
    task = fenced_out(lift(), DEPTHS, velocity=1.0, acceleration=5.0)
    r = from_outside(make, task, DEPTHS)
    return r.outward > 1e-9 or r.growth > 1e-12 or r.ratio > 1.35 or r.chain_mm > 0.05 or r.failures > 0 or r.broken > 0


def with_the_range(low: float, high: float) -> Callable[..., Any]:
    """Controllers that take joints for free between these angles from where they start [rad]."""

    def make(task: Scenario, **options: Any) -> Any:
        lower, upper = np.array(task.cell.limits.lower), np.array(task.cell.limits.upper)
        x, joints = task.cell.positions(task.q_start), list(DEPTHS)
        lower[joints], upper[joints] = x[joints] + low, x[joints] + high
        return cooperative(limited(task, lower=lower, upper=upper), **options)

    return make


class NoBrakingDistance(VelocityBox):
    """Knows the limit, but ignores the braking distance."""

    def _stopping_speed(self, distance: Any, dt: float) -> Any:
        return distance / dt


class ContinuousBraking(VelocityBox):
    """Uses v²/(2a), without the distance of the present step."""

    def _stopping_speed(self, distance: Any, dt: float) -> Any:
        return np.sqrt(2.0 * self._acceleration * np.maximum(distance, 0.0))


def overshoots(box: Any) -> bool:
    return box_stops(np.random.default_rng(1), 0.002, 2000, "outward", box).overshoot > 1e-6


def goes_too_far(make: Callable[..., Any]) -> bool:
    return controller_overshoot(make, np.random.default_rng(2), 0.002, 3)[0] > 1e-6


def braking_weakly(task: Scenario) -> Sending:
    """Makes half of the accelerations that it plans to brake with."""

    def slower(step: ControlStep, v: Any) -> Any:
        least = np.abs(v) - 0.5 * task.cell.limits.acceleration * step.dt
        return np.where(np.abs(step.velocity) < least, np.sign(v) * least, step.velocity)

    return Sending(cooperative(task), slower)


# -- A5: a failed solver -----------------------------------------------------------------------------------------------


def fails_badly(make: Callable[..., Any] = cooperative, fault: str = "answers NaN") -> bool:
    """True if the check of A5 finds a defect, for a temporary or a permanent fault."""
    task = limited(fast_lift(), acceleration=5.0)
    for for_ever in (False, True):
        try:
            f = solver_fails(make, task, FAULTS[fault], at=120, for_ever=for_ever)
        except RuntimeError:  # raised by the test double: no step may raise
            return True
        if not f.held or f.stopping > 1.1 or f.chain_mm > 0.1 or f.broken or f.recovery > 1:
            return True
    return False


def braking(velocity: Callable[[ControlStep, Any], Any]) -> Callable[..., Any]:
    """Controllers that brake with other velocities, of their step and of what was sent last (nv,)."""

    def sent(step: ControlStep, v: Any) -> Any:
        return velocity(step, v) if step.status in STOPPED else step.velocity

    return lambda task, **options: Sending(cooperative(task, **options), sent)


def each_alone(step: ControlStep, v: Any) -> Any:
    return np.sign(v) * np.maximum(np.abs(v) - step.cell.limits.acceleration * step.dt, 0.0)


BRAKES: dict[str, Callable[..., Any]] = {
    "the last velocity is sent again": braking(lambda s, v: v.copy()),
    "a step to zero": braking(lambda s, v: np.zeros_like(v)),
    "every joint brakes alone": braking(each_alone),
    "nobody is told": spoiled(lambda s, i: s.replaced(status=Status.TRACKING) if s.status in STOPPED else s),
}


def believing(task: Scenario, *, solver: FaultySolver, **options: Any) -> Any:
    """Takes whatever a solver returns for a solution."""
    inner = FaultySolver(solver, lambda own, problem: replace(own.solve(problem), status=SolverStatus.SOLVED))
    inner.broken = True
    return cooperative(task, solver=inner, **options)


def raising_too(step: ControlStep, i: int) -> ControlStep:
    """What a solver raises is raised by the step."""
    if "it raised" in step.reason:
        raise RuntimeError(step.reason)
    return step


# -- A6 to A8, on the oracle -------------------------------------------------------------------------------------------


class Feedback(Spoiled):
    """Continues from the measured configuration without a check."""

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        step = super().step(q_measured, dt=dt)
        return step if q_measured is None else step.replaced(q_next=q_measured + step.velocity * step.dt)


def after_nan(controller: Any) -> tuple[set[ViolationKind], int]:
    """Violations and number of holding steps after one measured configuration with NaN."""
    watched = Monitored(controller, Monitor(controller.cell, controller.grasp))
    watched.reset(lift().q_start)
    q, held = lift().q_start, 0
    for i in range(50):
        step = watched.step(np.full_like(q, np.nan) if i == 20 else q)
        held += step.status is Status.HOLDING
        q = step.q_next
    return set(watched.verdict().counts), held


def stays_blocked(make: Callable[..., Any]) -> bool:
    """True if the joints do not move within 10 steps when a reachable target follows an unreachable one."""
    task = lift()
    start = task.path.pose(0.0)
    controller = make(replace(task, path=ServoPath(start)))
    controller.reset(task.q_start)
    away, near = (pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, up])) for up in (3.0, 0.05))
    controller.retarget(away)
    blocked = next((i for i in range(5000) if controller.step().status is Status.BLOCKED), None)
    if blocked is None:
        return True
    controller.retarget(near)
    return not any(np.abs(controller.step().velocity).max() > 1e-3 for _ in range(10))


def never_again() -> Spoil:
    """After the first blocked step, the command rests for ever."""
    rest: list[ControlStep] = []

    def spoil(step: ControlStep, i: int) -> ControlStep:
        if rest or step.status is Status.BLOCKED:
            rest.append(step)
            return rest[0].replaced(velocity=np.zeros_like(step.velocity), q_next=rest[0].q)
        return step

    return spoil


def tears(make: Callable[[Scenario], Any]) -> bool:
    """True if the monitor sees the arms part on the way to a stretched elbow."""
    task = at_singularity("elbow", 1, acceleration=np.inf)
    counts = judged(task, drive(make(task), 1200, start=task.q_start, rest=20), object_mm=1e9, object_deg=1e9).counts
    return ViolationKind.CHAIN in counts


def damped(task: Scenario) -> PseudoInverseController:
    options = PseudoInverseOptions(damping=0.05)
    return PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt, options=options)


def alone(task: Scenario) -> IndependentQPController:
    return IndependentQPController(task.cell, task.grasp, task.path, dt=task.dt)


# -- A9, A10 and the rest ----------------------------------------------------------------------------------------------


def unequal(spoil: Spoil) -> bool:
    """True if the check of A9 finds arms with different rates, or an object off its direction."""
    task = replace(paper_lift(duration=2.0), dt=0.002)
    found = slows_together(spoiled(spoil), task, 0.5, joint=13)
    return found.steps > 0 and (found.spread > 1e-6 or found.angle > 1.0)


def one_arm_faster(step: ControlStep, i: int) -> ControlStep:
    """The second arm moves at full rate while the others are slowed."""
    v = step.velocity.copy()
    v[step.cell.v_slices[2]] *= 1.0 + 2e-6
    return step.replaced(velocity=v)


def aside(step: ControlStep, i: int) -> ControlStep:
    """All arms move the object sideways by 2 % of its speed."""
    cell, data, v = step.cell, step.cell.model.createData(), step.velocity.copy()
    pin.computeJointJacobians(cell.model, data, step.q)
    pin.updateFramePlacements(cell.model, data)
    for f, s in zip(cell.tool_frames, cell.v_slices, strict=True):
        J = pin.getFrameJacobian(cell.model, data, f, pin.WORLD)[:, s]
        twist = J @ step.velocity[s]
        v[s] += np.linalg.solve(J, 0.02 * np.linalg.norm(twist) * np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return step.replaced(velocity=v)


def baseline_breaks() -> bool:
    task = fast_lift()
    controller = PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt)
    return {ViolationKind.VELOCITY, ViolationKind.CHAIN} <= set(
        judged(task, drive(controller, 300, start=task.q_start)).counts
    )


def off_the_path() -> bool:
    """The clock is ahead of the object."""
    task = lift()
    steps = [s.replaced(clock_next=s.clock_next + 0.1) for s in drive(cooperative(task), 200, start=task.q_start)]
    return ViolationKind.PATH in judged(task, steps).counts


def goes_on_while_holding() -> bool:
    task = lift()
    steps = [s.replaced(status=Status.HOLDING) for s in drive(cooperative(task), 200, start=task.q_start)]
    return ViolationKind.HOLDING in judged(task, steps).counts


def differs_between_runs() -> bool:
    """True if two runs of a controller with random numbers differ, as in row E."""

    def run() -> list[Any]:
        rng = np.random.default_rng()
        noisy = spoiled(lambda s, i: changed(s, "velocity", 0, float(rng.uniform(0.0, 1e-15))))
        return [s.velocity for s in drive(noisy(mixed_cell()), 20, start=mixed_cell().q_start)]

    return not np.array_equal(run(), run())


@dataclass(frozen=True)
class Broken:
    """A defect: its row in the catalogue, and a function that is True if the check of this row catches it."""

    row: str
    caught: Callable[[], bool]


BROKEN: dict[str, Broken] = {
    **{name: Broken("A1", lambda s=spoil: rough(spoiled(s))) for name, spoil in COMMANDS.items()},  # type: ignore[misc]
    "hands out its own memory": Broken("A1", lambda: rough(spoiled(OwnMemory()))),
    "writes into what it is given": Broken("A1", lambda: rough(kind(Scribbler), measured=0.5)),
    "raises for a bad dt": Broken("A1", lambda: rough(kind(Raising))),
    "believes in speeds 1e-8 higher": Broken("A2", lambda: exceeds(with_believed(velocity=1.0 + 1e-8), 1)),
    "believes in accelerations 1e-5 higher": Broken("A2", lambda: exceeds(with_believed(acceleration=1.0 + 1e-5), 2)),
    "believes in 2e-9 rad more": Broken("A2", lambda: exceeds(with_believed(position=2e-9), 0)),
    "does not see that a joint is outside": Broken("A3", lambda: returns_wrongly(with_believed(position=1.0))),
    "leads it further out": Broken("A3", lambda: returns_wrongly(with_the_range(0.3, 1.0))),
    "does not lead it back": Broken("A3", lambda: returns_wrongly(with_the_range(-1.0, 0.0))),
    "no braking distance": Broken("A4", lambda: overshoots(NoBrakingDistance)),
    "braking distance of continuous time": Broken("A4", lambda: overshoots(ContinuousBraking)),
    "limits 2e-6 rad too wide": Broken("A4", lambda: goes_too_far(with_believed(position=2e-6))),
    "brakes half as hard as it plans": Broken("A4", lambda: goes_too_far(braking_weakly)),
    **{name: Broken("A5", lambda m=make: fails_badly(m)) for name, make in BRAKES.items()},  # type: ignore[misc]
    "a failed solve is taken for an answer": Broken(
        "A5", lambda: fails_badly(believing, "status: failed, with an answer")
    ),
    "a solver that raises is not caught": Broken(
        "A5", lambda: fails_badly(spoiled(raising_too), "raises RuntimeError")
    ),
    "commands on from NaN": Broken("A6", lambda: ViolationKind.NOT_FINITE in after_nan(kind(Feedback)(lift()))[0]),
    "stays blocked": Broken("A7", lambda: stays_blocked(spoiled(never_again()))),
    "a damped inverse": Broken("A8", lambda: tears(damped)),
    "arms that know nothing of each other": Broken("A8", lambda: tears(alone)),
    "one arm slows a little less": Broken("A9", lambda: unequal(one_arm_faster)),
    "gives way sideways": Broken("A9", lambda: unequal(aside)),
    "the baseline": Broken("A10", baseline_breaks),
    "a clock ahead of the object": Broken("H", off_the_path),
    "goes on while holding": Broken("H", goes_on_while_holding),
    "random numbers": Broken("E", differs_between_runs),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_every_broken_controller_is_caught(catalogue: Any) -> None:
    missed = [name for name, broken in BROKEN.items() if not broken.caught()]
    rows = sorted({broken.row for broken in BROKEN.values()}, key=lambda r: (r[0], int(r[1:] or 0)))
    catalogue.row(
        "H",
        "controllers broken on purpose that a check lets pass",
        cases=len(BROKEN),
        measured=len(missed),
        target=0,
        note=f"for rows {', '.join(rows)}",
    )
    assert not missed


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_the_sound_one_is_not(catalogue: Any) -> None:
    """The real controller passes the same checks."""
    checks: dict[str, Callable[[], bool]] = {
        "A1": lambda: rough(cooperative, measured=0.3),
        "A2": lambda: any(exceeds(cooperative, limit) for limit in range(3)),
        "A3": lambda: returns_wrongly(cooperative),
        "A4": lambda: overshoots(VelocityBox) or goes_too_far(cooperative),
        "A5": lambda: any(map(fails_badly, (cooperative, braking(lambda step, v: step.velocity)))),
        "A6": lambda: after_nan(cooperative(lift())) != (set(), 1),
        "A7": lambda: stays_blocked(cooperative),
        "A8": lambda: tears(cooperative),
        "A9": lambda: unequal(lambda step, i: step),
    }
    caught = [row for row, check in checks.items() if check()]
    catalogue.row(
        "H", "the sound controller, caught by the same checks", cases=len(checks), measured=len(caught), target=0
    )
    assert not caught
