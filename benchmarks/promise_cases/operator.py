"""An operator's calls: random ones in any order, back through what was travelled, by hand into limits, after a belt.

What judges chain and path is Pinocchio's forward kinematics of each arm's own model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Clearance, CollisionScene, ControlStep, LinePath, ObjectPath, QPController, Status, plan
from coopqp.scenarios import Scenario, dual_arm7, elbow_and_knob, mixed_cell, paper_lift, plate_and_post, ring
from coopqp.simulation import Closeness
from coopqp.spatial import Array
from promise_cases import Promise, made_again
from promise_cases.chain_cells import Oracle

_DT, _ACCELERATION, _DEADMAN = 0.002, 5.0, 0.1
_CELLS: dict[str, Callable[[], Scenario]] = {
    "three arms, 6 joints": paper_lift, "two arms, 7 joints": dual_arm7, "6 and 7 joints": mixed_cell,
    "5 arms": lambda: ring(arms=5), "8 arms": lambda: ring(arms=8),
}  # fmt: skip
_MARGIN = 0.02


@dataclass
class Seen:
    """What came of a run: distances of the arms' views of the object, and of them from where it should be [m]."""

    apart: float = 0.0
    off: list[float] = field(default_factory=list)
    statuses: set[Status] = field(default_factory=set)


class Hand:
    """A controller, the oracle of its cell, and what was seen so far."""

    def __init__(self, task: Scenario, *, path: ObjectPath | None = None, dt: float = _DT, **more: Any) -> None:
        self.cell = task.cell.with_limits(acceleration=_ACCELERATION)
        self.controller = QPController(self.cell, task.grasp, path or task.path, dt=dt, **more)
        self.controller.reset(task.q_start)
        self.seen, self.dt, self._oracle = Seen(), dt, Oracle(self.cell, task.grasp)

    def step(self) -> ControlStep:
        """One step, and a look at it."""
        step = self.controller.step()
        points = np.array(self._oracle.points(step.q_next))
        asked = self.controller.asked_pose or self.controller.path.pose(step.clock_next)
        self.seen.apart = max(self.seen.apart, float(np.linalg.norm(points[:, None] - points, axis=2).max()))
        self.seen.off.append(float(np.linalg.norm(points - asked.translation, axis=1).max()))
        self.seen.statuses.add(step.status)
        return step

    def until(self, done: Callable[[ControlStep], bool], most: int = 10_000) -> ControlStep:
        """Steps until one is as it should be, or so many."""
        for _ in range(most):
            step = self.step()
            if done(step):
                break
        return step


def _call(controller: QPController, rng: np.random.Generator) -> Array | None:
    """A random call; a twist where the operator leads by hand from now on."""
    now, end = controller.program_clock, controller.path.duration
    kind = int(rng.integers(10))
    if kind == 0:
        controller.pause()
    elif kind == 1:
        controller.resume()
    elif kind == 2:
        controller.set_override(float(rng.uniform(0.1, 1.0)))
    elif kind == 3:
        controller.reverse(float(rng.uniform(0.0, now)))
    elif kind == 4:
        controller.forward()
    elif kind == 5:
        controller.run_to(float(rng.uniform(0.0, end)))
    elif kind == 6:
        controller.step_to_mark()
    elif kind == 7 and now < end - 0.05:
        controller.shift_path(pin.exp6(rng.normal(size=6) * np.repeat([0.01, 0.02], 3)))
    elif kind == 8:
        return np.asarray(rng.normal(size=6) * np.repeat([0.1, 0.2], 3))
    else:
        controller.return_to_path()
    return None


def _anything(name: str, make: Callable[[], Scenario], path: ObjectPath | None, runs: int) -> Iterator[Promise]:
    apart = off = 0.0
    for seed in range(runs):
        hand, rng, by_hand, twist = Hand(make(), path=path), np.random.default_rng(seed), 0, None
        for i in range(2500):
            if by_hand > 0:
                by_hand -= 1
                if i % 10 == 0 and twist is not None:
                    hand.controller.jog(twist)
            elif rng.random() < 0.01:
                twist = _call(hand.controller, rng)
                by_hand = 0 if twist is None else int(rng.integers(20, 300))
            hand.step()
        apart, off = max(apart, hand.seen.apart), max(off, *hand.seen.off)
    yield Promise(f"anything in any order, {name}: chain", 1e6 * apart, 0.5, "µm")
    yield Promise(f"anything in any order, {name}: path", 1e6 * off, 0.5, "µm")


def _back(name: str, task: Scenario, bound: float, share: float = 0.7, **more: Any) -> Iterator[Promise]:
    hand = Hand(task, **more)
    there = share * hand.controller.path.duration
    hand.until(lambda step: step.clock > there)
    hand.controller.reverse()
    step = hand.until(lambda step: step.status is Status.PAUSED and step.clock == 0.0)
    away = np.abs(step.q_next - task.q_start).max() if step.clock == 0.0 else np.nan
    yield Promise(f"back to the start, {name}: joints", float(away), bound, "rad")


def _planned(task: Scenario) -> ObjectPath:
    cell = task.cell.with_limits(acceleration=_ACCELERATION)
    return plan(cell, task.grasp, task.path, q_start=task.q_start).path


def _scene(task: Scenario) -> CollisionScene:
    return CollisionScene.of(task, cell=task.cell.with_limits(acceleration=_ACCELERATION), margin=_MARGIN)


def _retrace() -> Iterator[Promise]:
    yield from _back("6 joints", paper_lift(), 1e-9)
    yield from _back("7 joints", dual_arm7(), 1e-4)
    for name, make, bound in (("6 joints", paper_lift, 1e-9), ("7 joints", dual_arm7, 1e-4)):
        task = make()
        planned = plan(
            task.cell.with_limits(acceleration=_ACCELERATION), task.grasp, task.path, q_start=task.q_start
        ).path
        yield from _back(f"{name}, planned", task, bound, path=planned)
    for name, task, bound in (("6 joints", plate_and_post(), 1e-9), ("7 joints", elbow_and_knob(), 1e-4)):
        yield from _back(f"{name}, beside a body", task, bound, constraints=[Clearance(_scene(task))], dt=0.004)


def _by_hand(runs: int) -> Iterator[Promise]:
    """Into limits and singularities, and at rest after the last command."""
    apart, off, late = 0.0, [], 0.0
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        hand = Hand(list(_CELLS.values())[seed % 3]())
        twist = rng.normal(size=6) * np.repeat([0.25, 0.4], 3)
        last = int(rng.integers(500, 1500))
        for i in range(last + 1):
            if i % 10 == 0 or i == last:
                hand.controller.jog(twist, frame="world")
            step = hand.step()
        hardest = float((np.abs(step.velocity) / _ACCELERATION).max())
        rows = [hand.cell.positions(step.q_next)]
        while np.abs(step.velocity).max() > 1e-4 and len(rows) < 5000:
            step = hand.step()
            rows.append(hand.cell.positions(step.q_next))
            hardest = max(hardest, float((np.abs(step.velocity) / _ACCELERATION).max()))
        rests_after = (len(rows) - 1) * _DT
        share = rests_after / (_DEADMAN + 1.3 * hardest + 0.02)
        if share > 0.9:  # the hardest stop on the way itself, which may take longer than that of one joint
            hardest = max(hardest, _hardest_stop(np.array(rows), _DEADMAN))
            share = rests_after / (_DEADMAN + 1.3 * hardest + 0.02)
        late = max(late, share)
        apart = max(apart, hand.seen.apart)
        off.append(max(hand.seen.off))
    yield Promise(f"{runs} jogs into limits and singularities: chain", 1e6 * apart, 0.5, "µm")
    yield Promise(
        f"{runs} jogs into limits and singularities: path, median of runs", 1e6 * float(np.median(off)), 0.1, "µm"
    )
    yield Promise(f"{runs} jogs into limits and singularities: path, largest", 1e6 * max(off), 1.0, "µm")
    yield Promise("at rest after the last command, of dead-man + 1.3 hardest stop + 20 ms", late, 1.0, "")


def _beside(runs: int) -> Iterator[Promise]:
    missing, times = -np.inf, []
    for seed in range(runs):
        rng, task = np.random.default_rng(seed), (plate_and_post, elbow_and_knob)[seed % 2]()
        scene = _scene(task)
        hand = Hand(task, constraints=[Clearance(scene)], dt=0.004)
        twist, commands = rng.normal(size=6) * np.repeat([0.2, 0.3], 3), np.empty((500, hand.cell.nq))
        tremor = rng.normal(size=(500, 6)) * 1e-3  # so that each command asks for another way
        for i in range(500):
            if i % 8 == 0:
                began = time.thread_time()
                hand.controller.jog(twist + tremor[i], frame="world")
                times.append(time.thread_time() - began)
            commands[i] = hand.step().q_next
        closest = Closeness(scene).closest(commands, np.linspace(0.0, 2.0, len(commands)))
        missing = max(missing, _MARGIN - closest.pair.distance) if closest else np.nan
    yield Promise(f"{runs} jogs beside bodies: missing from the margin", 1e6 * missing, 1.0, "µm")
    yield Promise("a jog command beside bodies, p99", 1e3 * float(np.percentile(times[2:], 99)), 1.0, "ms")


def _cost() -> Iterator[Promise]:
    times = []
    for make in (paper_lift, dual_arm7):
        hand = Hand(make())
        for i in range(2000):
            began = time.thread_time()
            hand.controller.jog([0.05 * np.sin(0.01 * i), 0.05 * np.cos(0.01 * i), 0.0, 0.0, 0.0, 0.1])
            times.append(time.thread_time() - began)
            hand.controller.step()
    yield Promise("a jog command, p99", 1e3 * float(np.percentile(times[100:], 99)), 0.5, "ms")


def _underway(task: Scenario, path: ObjectPath, *, back: bool) -> QPController:
    """A controller a few steps after its start, or on its way back from the middle of its path."""
    cell = task.cell.with_limits(acceleration=_ACCELERATION)
    controller = QPController(cell, task.grasp, path, dt=_DT)
    controller.reset(task.q_start)
    if back:
        while controller.program_clock < 0.6 * path.duration:
            controller.step()
        controller.reverse()
        while controller.step().sense > 0:
            pass
    for _ in range(20):
        controller.step()
    return controller


def _step_costs(rounds: int) -> Iterator[Promise]:
    """Medians of steps in the thread's own time, the kinds of paths in turn."""
    task = paper_lift()
    planned, line = _planned(task), task.path
    kinds = {"a line": (line, False), "a line, back": (line, True), "a plan": (planned, False),
             "a plan, back": (planned, True)}  # fmt: skip
    times: dict[str, list[float]] = {name: [] for name in kinds}
    for _ in range(rounds):
        for name, (path, back) in kinds.items():
            controller = _underway(task, path, back=back)
            for _ in range(8):
                began = time.thread_time()
                for _ in range(20):
                    controller.step()
                times[name].append(time.thread_time() - began)
    found = {name: float(np.median(values)) for name, values in times.items()}
    for name in list(found)[1:]:
        yield Promise(f"a step along {name}, over a line's", found[name] / found["a line"], 1.3, "")


def _belt() -> Iterator[Promise]:
    task, rng = mixed_cell(), np.random.default_rng(0)
    line = LinePath.displaced(
        task.path.pose(0.0), translation=(0.0, 0.1, 0.35), duration=8.0, time_law="linear"
    )  # fmt: skip
    hand, belt, lags = Hand(task, path=line), 0.0, []
    for i in range(5000):
        hand.controller.gear(belt + 2e-4 * rng.normal(), speed=0.7)
        belt += _DT * 0.7 * (1.0 + 0.2 * np.sin(np.pi * i * _DT))
        lags.append(belt - hand.step().clock_next)
    lag = 1e3 * np.array(lags[500:])
    yield Promise(
        "lag behind a belt at ±20 % speed and 0.2 ms of noise, rms", float(np.sqrt(np.mean(lag**2))), 1.0, "ms"
    )
    yield Promise("lag behind a belt at ±20 % speed and 0.2 ms of noise, worst", float(np.abs(lag).max()), 4.0, "ms")
    yield Promise("after a belt: chain", 1e6 * hand.seen.apart, 0.5, "µm")


def _stream() -> Iterator[Promise]:
    """A hand at 30 Hz with 0.2 mm of noise, silent for 1.2 s once, that leaps by 7 cm once; 500 Hz."""
    hand, rng = Hand(dual_arm7()), np.random.default_rng(1)
    begun, behind, excess, before = pin.SE3.Random(), [], 0.0, np.zeros(hand.cell.nv)
    hand.controller.engage(begun)
    start = hand.controller.path.pose(0.0).translation
    for i in range(5000):
        t = i * _DT
        way = np.array([0.06 * np.sin(1.3 * t), 0.05 * np.sin(0.9 * t), 0.05 * np.sin(0.7 * t)])
        way[0] += 0.07 * (t > 7.0)
        if i % 17 == 0 and not 3.0 < t < 4.2:
            pose = pin.SE3(begun.rotation, begun.translation + way + 2e-4 * rng.normal(size=3))
            hand.controller.target(pose)
        step = hand.step()
        excess = max(excess, float(np.abs(step.velocity - before).max() / _DT))
        before = step.velocity
        asked = hand.controller.asked_pose
        if asked is not None and not 3.0 < t < 5.0 and not 7.0 < t < 8.0:
            behind.append(float(np.linalg.norm(asked.translation - start - way)))
    yield Promise("a hand at 30 Hz: chain", 1e6 * hand.seen.apart, 0.05, "µm")
    yield Promise("a hand at 30 Hz: accelerations", excess, _ACCELERATION * (1.0 + 1e-6), "rad/s²")
    yield Promise("a hand at 30 Hz: object behind it", 1e3 * max(behind), 60.0, "mm")


def _stops(runs: int) -> Iterator[Promise]:
    """The time of a stop over the least possible along the path, with all joints' full acceleration."""
    worst = 0.0
    for seed in range(runs):
        rng, task = np.random.default_rng(seed), (paper_lift, mixed_cell)[seed % 2]()
        hand = Hand(task)
        clocks, rows = [0.0], [task.q_start]
        alone = hand.controller.__copy__()
        while not (step := alone.step()).finished:
            clocks.append(step.clock_next)
            rows.append(step.q_next)
        at = float(rng.uniform(0.2, 0.7)) * task.path.duration
        step = hand.until(lambda step, at=at: step.clock > at)  # type: ignore[misc]
        rate, clock, steps = step.rate, step.clock_next, 0
        hand.controller.reverse()
        while step.sense > 0 and step.rate > 0.0 and steps < 2000:
            step = hand.step()
            steps += 1
        least = _least_stop(np.array(clocks), np.array(rows), clock, rate)
        worst = max(worst, steps * _DT / least)
    yield Promise("a stop before going back, over the least time on the path", worst, 1.3, "")


def _hardest_stop(rows: Array, after: float) -> float:
    """Least time [s] to rest on the way of a run's configurations (T, nv), from a time on [s]; their length is it."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rows, axis=0), axis=1))])
    k = round(after / _DT)
    moves = np.concatenate([[True], np.diff(lengths) > 1e-6])
    if moves.sum() <= 5:  # it creeps: there is no spline of that
        return 0.0
    return _least_stop(lengths[moves], rows[moves], lengths[k], (lengths[k + 1] - lengths[k]) / _DT, spaced=5)


def _least_stop(clocks: Array, rows: Array, clock: float, rate: float, *, spaced: int = 10) -> float:
    """Least time [s] from a path speed to rest: at each clock the hardest braking by |q′σ̇ + q″σ²| ≤ a of all joints.

    The path's configurations (K, nq) at clocks (K,) come from a run of their own; every ``spaced`` one is a knot of
    their spline.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(clocks[::spaced], rows[::spaced])
    slope, curvature = spline.derivative(1), spline.derivative(2)
    h, t = 1e-4, 0.0
    while rate > 1e-3 and t < 5.0:
        s, c = slope(clock), curvature(clock)
        moving = np.abs(s) > 1e-9
        hardest = np.max((-_ACCELERATION * np.sign(s) - c * rate**2)[moving] / s[moving])
        rate, clock, t = rate + min(hardest, -1e-3) * h, clock + rate * h, t + h
    return t


def _replays(runs: int) -> Iterator[Promise]:
    """Runs with random calls, recorded, and made again in another process; some beside bodies, some with forces."""
    kinds = ["forces" if i % 8 == 3 else "bodies" if i % 4 == 1 else "free" for i in range(runs)]
    differ = sum(step is not None for step in made_again.elsewhere(list(zip(kinds, range(runs), strict=True))))
    yield Promise(f"{runs} recorded runs made again elsewhere: not the same bit for bit", differ, 0, "runs")


def promises(quick: bool) -> Iterator[Promise]:
    """See :mod:`promise_cases`."""
    for name, make in list(_CELLS.items())[: 2 if quick else None]:
        yield from _anything(name, make, None, 1 if quick else 6)
    for name, make in (("a plan, 6 joints", paper_lift), ("a plan, 7 joints", dual_arm7)):
        task = make()
        planned = plan(
            task.cell.with_limits(acceleration=_ACCELERATION), task.grasp, task.path, q_start=task.q_start
        ).path
        yield from _anything(name, make, planned, 1 if quick else 3)
    yield from _stops(2 if quick else 12)
    yield from _retrace()
    yield from _by_hand(3 if quick else 200)
    yield from _beside(2 if quick else 200)
    yield from _cost()
    yield from _step_costs(3 if quick else 12)
    yield from _replays(4 if quick else 50)
    yield from _belt()
    yield from _stream()
