"""Forces between the arms and the object, in an engine, with default options and from the first command on."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import (
    ForceController,
    ForceOptions,
    InvalidInputError,
    QPController,
    Status,
    SupervisionOptions,
)
from coopqp.planning import Payload
from coopqp.scenarios import paper_lift
from coopqp.simulation import Disturbances, PhysicsPlant
from coopqp.spatial import Array
from promise_cases import Promise

#: Servos of an arm in the engine: kp [N·m/rad] and kd [N·m·s/rad], as the engine has them by default.
STIFFNESS = (1e5, 1e5, 5e4, 1e4, 1e4, 5e3)
DAMPING = (3160.0, 3160.0, 1265.0, 167.0, 167.0, 71.0)
#: After the end of the path a force has this long to settle [s].
SETTLED = 1.0
DIAGONAL = np.ones(3) / np.sqrt(3.0)


def off(millimetres: float, degrees: float) -> pin.SE3:
    """A displacement along, and a turn about, the diagonal of a base's axes."""
    return pin.SE3(pin.exp3(np.deg2rad(degrees) * DIAGONAL), 1e-3 * millimetres * DIAGONAL)


def shares(points: Array) -> Array:
    """The part of forces and moments on a rigid body that least-norm loads at its grasps carry (6 N, 6 N).

    ``points`` are the places of the grasps (N, 3) [m]; a moment of 0.1 N·m counts as much as a force of 1 N.
    """
    n = len(points)
    total, scale = np.zeros((6, 6 * n)), np.tile([1.0, 1.0, 1.0, 0.1, 0.1, 0.1], n)
    for k, (x, y, z) in enumerate(points):
        total[:, 6 * k : 6 * k + 6] = np.eye(6)
        total[3:, 6 * k : 6 * k + 3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    found: Array = scale[:, None] * np.linalg.pinv(total * scale) @ total
    return found


@dataclass
class Run:
    """What a run showed: internal forces [N], statuses with times [s], when it began to move, and when it ended."""

    force: Array
    time: Array
    status: list[Status]
    reason: list[str]
    begins: float
    finished: float

    @property
    def peak(self) -> float:
        """The largest internal force [N]."""
        return float(self.force.max())

    @property
    def rest(self) -> float:
        """The largest from a second after the path's end on [N]; infinite if it was not reached."""
        late = self.time >= self.finished + SETTLED
        return float(self.force[late].max()) if late.any() else np.inf

    @property
    def false_words(self) -> int:
        """Steps in which an arm was named that followed its command."""
        words = ("out of step", "its wrench puts", "does not follow")
        return sum(any(word in said for word in words) for said in self.reason)

    @property
    def contacts(self) -> int:
        """Steps in which the object is said to touch something."""
        return sum("touches something" in said for said in self.reason)


def lift(
    duration: float, *, mass: float = 20.0, softer: float = 1.0, relax: bool = True, grips: str = "where they are",
    watch: float = SETTLED + 0.1, until: float = 13.0, stiffness_told: bool = False, **disturbances: Any,
) -> Run:  # fmt: skip
    """The paper's lift in the engine; without ``relax`` by the QPController alone."""
    task = replace(paper_lift(time_law="quintic", duration=duration), object_mass=mass)
    servos = {"stiffness": softer * np.tile(STIFFNESS, 3), "damping": np.sqrt(softer) * np.tile(DAMPING, 3)}
    plant = PhysicsPlant.of(task, options={"grips": grips, **servos}, disturbances=Disturbances(**disturbances))
    told = SupervisionOptions(stiffness=tuple(np.tile(STIFFNESS, 3))) if stiffness_told else SupervisionOptions()
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt, options={"supervision": told})
    payload = Payload(mass=mass, centre=task.T_object_body.translation)
    made = ForceController(inner, ForceOptions(stiffness=np.tile(STIFFNESS, 3), payload=payload))
    internal = np.eye(18) - shares(np.array([X.translation for X in task.grasp.T_object_tool]))
    controller: Any = made if relax else inner
    q = plant.reset(task.q_start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        controller.reset(q)
    force, time, status, reason, begins, ended, now = [], [], [], [], np.inf, np.inf, 0.0
    while now < min(until, ended + watch):
        step = controller.step(q, wrenches=plant.measured_wrenches()) if relax else controller.step(q)
        q = plant.apply(step)
        now += step.dt
        w = plant.wrenches()  # at the object's origin; at each grasp the moment is less
        for k, X in enumerate(task.grasp.T_object_tool):
            w[k, 3:] -= np.cross(X.translation, w[k, :3])
        force.append(float(np.linalg.norm((internal @ w.ravel()).reshape(3, 6)[:, :3], axis=1).max()))
        time.append(now)
        status.append(step.status)
        reason.append(step.reason)
        begins = now if step.rate > 0.0 and not np.isfinite(begins) else begins
        ended = now if step.finished and not np.isfinite(ended) else ended
    return Run(np.array(force), np.array(time), status, reason, begins, ended)


def lifts(quick: bool) -> Iterator[Promise]:
    """Nothing is off."""
    durations = (1.0,) if quick else (3.0, 2.0, 1.5, 1.0)
    for mass in (20.0,) if quick else (5.0, 20.0):
        runs = [lift(duration, mass=mass) for duration in durations]
        case = f"ForceController, {mass:g} kg, lifts of {', '.join(f'{d:g}' for d in durations)} s"
        yield Promise(f"{case}: largest force", max(run.peak for run in runs), 20.0, "N")
        yield Promise(f"{case}: force at rest", max(run.rest for run in runs), 5.0, "N")
        yield Promise(f"{case}: steps with a contact that is none", sum(run.contacts for run in runs), 0.0, "")
    fast, alone = lift(0.5), lift(0.5, relax=False)
    yield Promise("ForceController, lift of 0.5 s: force over QPController's", fast.peak / alone.peak, 1.5, "")
    yield Promise("ForceController, lift of 0.5 s: force at rest", fast.rest, 5.0, "N")
    yield Promise("QPController, lift of 0.5 s: force at rest", alone.rest, 5.0, "N")


def disturbed(quick: bool) -> Iterator[Promise]:
    """Other servos than told, lags of all arms, a base that is off."""
    lags = {"none": {}, "20 ms": dict.fromkeys(("master", "slave_1", "slave_2"), 0.02)}
    for duration in (3.0,) if quick else (3.0, 1.0):
        runs = []
        for softer in (0.3, 10.0) if quick else (0.3, 1.0, 3.0, 10.0):
            for lag in ("20 ms",) if quick else lags:
                for base in ("slave_2",) if quick else ("", "slave_2"):
                    bases = {base: off(1.0, 0.1)} if base else {}
                    runs.append(lift(duration, softer=softer, lag=lags[lag], base_offset=bases, wrench_latency=0.01))
        case = f"servos × 0.3 to 10, lag to 20 ms, base 1 mm off, lift of {duration:g} s"
        said = sum(run.false_words + run.contacts for run in runs)
        yield Promise(f"{case}: steps with a false word", said, 0.0, "")
        yield Promise(f"{case}: largest force", max(run.peak for run in runs), 30.0, "N")


def random_lift(number: int, *, alike: bool) -> Run:
    """A lift with random servos, mass, duration, lags of 0 to 20 ms, one for all or each its own, and a base off."""
    rng, arms = np.random.default_rng(900 + number), ("master", "slave_1", "slave_2")
    duration, mass = rng.uniform(1.0, 3.0), rng.uniform(5.0, 20.0)
    softer, lag = float(np.exp(rng.uniform(np.log(0.3), np.log(10.0)))), rng.uniform(0.0, 0.02)
    lags = {arm: float(lag if alike else rng.uniform(0.0, 0.02)) for arm in arms}
    way, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    base = {str(rng.choice(arms)): pin.SE3(pin.exp3(np.deg2rad(0.1) * turn), 1e-3 * way)}
    return lift(duration, mass=mass, softer=softer, lag=lags, base_offset=base, wrench_latency=0.01)


def random_lifts(quick: bool) -> Iterator[Promise]:
    """The same at random; what arms do that lag differently is stated, not promised."""
    number = 2 if quick else 60
    runs = [random_lift(i, alike=True) for i in range(number)]
    case = f"{number} random lifts of 1 to 3 s, such servos, lags and bases"
    yield Promise(f"{case}: steps with a false word", sum(run.false_words + run.contacts for run in runs), 0.0, "")
    yield Promise(f"{case}: largest force", max(run.peak for run in runs), 30.0, "N")
    runs = [random_lift(i, alike=False) for i in range(number)]
    case = f"{number} random lifts, each arm its own lag, no promise"
    yield Promise(f"{case}: with a false word", sum(run.false_words > 0 for run in runs), number, "")
    yield Promise(f"{case}: over 30 N", sum(run.peak > 30.0 for run in runs), number, "")


def starts(quick: bool) -> Iterator[Promise]:
    """A base that is off, from the first command on."""
    for grips, bound in (("where they are", 12.0), ("grasp", 30.0)):
        arms = ("slave_2",) if quick else ("master", "slave_1", "slave_2")
        peak = max(
            lift(3.0, grips=grips, base_offset={a: off(1.0, 0.1)}, wrench_latency=0.01, until=5.5).peak for a in arms
        )
        yield Promise(f"base 1 mm and 0.1° off, grips {grips}: from the first command on", peak, bound, "N")
    accepted = 0
    for arm in ("slave_2",) if quick else ("master", "slave_1", "slave_2"):
        try:
            lift(3.0, grips="grasp", base_offset={arm: off(20.0, 0.0)}, until=0.5)
            accepted += 1
        except InvalidInputError as error:
            accepted += "mm" not in str(error)
    yield Promise("bases 20 mm off: starts that are not refused by name", accepted, 0.0, "")


def stalls(quick: bool) -> Iterator[Promise]:
    """A gripped arm stops, at some times after the object has begun to move."""
    arms = ("master", "slave_1", "slave_2")
    begins, late = lift(2.0, until=6.0).begins, []
    for arm in arms[2:] if quick else arms:
        for after in (0.8,) if quick else (0.5, 0.8, 1.1, 1.4):
            at = begins + after
            late.append(found(lift(2.0, stall={arm: at}, until=at + 0.15), at))
    yield Promise("an arm of a ForceController stops: time until HOLDING", max(late), 25.0, "ms")
    rng, late = np.random.default_rng(12), []
    for i in range(3 if quick else 24):
        duration = float(rng.choice([1.0, 1.5, 2.0, 3.0]))
        at = duration * float(rng.uniform(0.25, 0.75))
        run = lift(duration, relax=False, stall={arms[i % 3]: at}, until=at + 0.15, stiffness_told=True)
        late.append(found(run, at))
    yield Promise("an arm of a QPController stops, stiffness told: time until HOLDING", max(late), 25.0, "ms")


def found(run: Run, at: float) -> float:
    """The time from a stop until a step says HOLDING [ms]; a step is made before its time has gone by."""
    held = [t for t, s in zip(run.time[:-1], run.status[1:], strict=True) if t >= at and s is Status.HOLDING]
    return 1e3 * (held[0] - at) if held else np.inf


def untold(duration: float, at: float | None, arm: str, rng: np.random.Generator) -> tuple[float, bool]:
    """A lift by a QPController that knows neither stiffness nor wrenches; an arm stops ``at`` a time, or none does.

    Servos, mass, lag, base, noise and accelerations are at random. Returns the time until HOLDING after that [s], and
    whether an arm was said to have stopped before.
    """
    task = replace(paper_lift(time_law="quintic", duration=duration), object_mass=float(rng.uniform(5.0, 20.0)))
    softer, lag = float(np.exp(rng.uniform(np.log(0.3), np.log(10.0)))), float(rng.choice([0.0, 0.005, 0.01, 0.02]))
    off_arm, accelerations = str(rng.choice(task.cell.arm_names)), (np.inf, 10.0, 30.0)
    cell = task.cell.with_limits(acceleration=accelerations[int(rng.integers(3))])
    disturbances = Disturbances(
        lag=dict.fromkeys(cell.arm_names, lag) if lag else {},
        base_offset={off_arm: off(1.0, 0.1)} if rng.random() < 0.5 else {},
        encoder_noise=1e-4 if rng.random() < 0.5 else 0.0,
        stall={} if at is None else {arm: at},
    )
    servos = {"stiffness": softer * np.tile(STIFFNESS, 3), "damping": np.sqrt(softer) * np.tile(DAMPING, 3)}
    plant = PhysicsPlant.of(task, options={"grips": "where they are", **servos}, disturbances=disturbances)
    made, q, now, false = QPController(cell, task.grasp, task.path, dt=task.dt), plant.reset(task.q_start), 0.0, False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made.reset(q)
    begin = np.inf if at is None else at
    while now < (duration + 0.5 if at is None else at + 0.2):
        step = made.step(q)
        if now >= begin and step.status is Status.HOLDING:
            return now - begin, false
        false |= now < begin and ("stopped" in step.reason or "stalled" in step.reason)
        q = plant.apply(step)
        now += step.dt
    return np.inf, false


def stalls_untold(quick: bool) -> Iterator[Promise]:
    """A gripped arm stops, seen by measured configurations alone."""
    rng, late, said, sound = np.random.default_rng(11), [], 0, 4 if quick else 32
    for i in range(4 if quick else 24):
        duration = float(rng.choice([1.0, 1.5, 2.0, 3.0]))
        arm = ("master", "slave_1", "slave_2")[i % 3]
        held, false = untold(duration, duration * float(rng.uniform(0.25, 0.75)), arm, rng)
        late.append(1e3 * held)
        said += false
    case = "an arm of a QPController stops, stiffness not told"
    yield Promise(f"{case}: time until HOLDING", max(late), 100.0, "ms")
    for _ in range(sound):
        said += untold(float(rng.choice([1.0, 1.5, 2.0, 3.0])), None, "", rng)[1]
    yield Promise(f"{case}: of {sound} without a stop and {len(late)} before it, said to have stopped", said, 1.0, "")


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    for part in (lifts, disturbed, random_lifts, starts, stalls, stalls_untold):
        yield from part(quick)
