"""An operator's calls from other threads, in random order: no step raises, and none takes long."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Clearance, CollisionScene, CoopqpError, InvalidInputError, LinePath, ObjectPath, QPController, plan
from coopqp.scenarios import Scenario, dual_arm7, elbow_and_knob, paper_lift
from promise_cases import Promise

_DT, _ACCELERATION = 0.002, 5.0
#: Share of the calls that come without a break, while steps are made.
_HOT = 0.1


def _random_call(c: QPController, start: ObjectPath, rng: np.random.Generator) -> None:
    """Any call of an operator, with values that are right or wrong."""
    clock = float(rng.uniform(-0.1, 1.1 * c.path.duration))
    pose = pin.SE3(pin.exp3(0.05 * rng.normal(size=3)), 0.02 * rng.normal(size=3))
    here = c.path.pose(c.program_clock)
    short = LinePath.displaced(here, translation=(0.0, 0.0, 0.02), duration=float(rng.uniform(0.2, 2.0)))
    calls: list[Callable[[], object]] = [
        c.pause, c.resume, c.resume, c.forward, c.forward, c.step_to_mark, c.return_to_path, c.return_to_path,
        c.release,
        lambda: c.set_override(float(rng.uniform(0.0, 1.0))), lambda: c.reverse(clock), lambda: c.run_to(clock),
        lambda: c.shift_path(pose, over=float(rng.uniform(0.01, 0.2))), lambda: c.gear(clock, speed=0.5),
        lambda: c.jog(0.1 * rng.normal(size=6), deadman_s=float(rng.uniform(0.01, 0.5))),
        lambda: c.engage(pose), lambda: c.target(pose), lambda: c.retarget(pose), lambda: c.jog([np.nan] * 6),
        lambda: c.follow(short) if rng.random() < 0.1 else c.follow(start, clock=0.0) if rng.random() < 0.1 else None,
    ]  # fmt: skip
    calls[int(rng.integers(len(calls)))]()


class _Caller(threading.Thread):
    """Makes random calls: so many after each order, or without a break."""

    def __init__(self, controller: QPController, seed: int) -> None:
        super().__init__(daemon=True)
        self._controller, self._start, self._rng = controller, controller.path, np.random.default_rng(seed)
        self.orders: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.made: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.wrong: list[str] = []

    def run(self) -> None:
        while (number := self.orders.get()) >= 0:
            for _ in range(number):
                try:
                    _random_call(self._controller, self._start, self._rng)
                except CoopqpError:  # a value that is refused to its caller
                    pass
                except Exception as error:
                    self.wrong.append(repr(error))
            self.made.put(number)


class _Steps:
    """Steps a controller, and times each."""

    def __init__(self, task: Scenario, path: ObjectPath, constraints: list[Any]) -> None:
        cell = task.cell.with_limits(acceleration=_ACCELERATION)
        self.controller = QPController(cell, task.grasp, path, dt=_DT, constraints=constraints)
        self._q, self._path = task.q_start, path
        self.raised, self.times = 0, list[float]()
        self._begin()

    def _begin(self) -> None:
        while True:  # another thread's path may come between
            self.controller.follow(self._path)
            try:
                self.controller.reset(self._q)
            except InvalidInputError:
                continue
            break
        self.controller.step()

    def step(self) -> None:
        """One step; the run begins again where the object has arrived."""
        began = time.thread_time()
        try:
            step = self.controller.step()
        except Exception:
            self.raised += 1
            return
        finally:
            self.times.append(time.thread_time() - began)
        if step.finished:
            self._begin()


def _called(name: str, steps: _Steps, calls: int) -> Iterator[Promise]:
    callers, rng, left = [_Caller(steps.controller, seed) for seed in (1, 2)], np.random.default_rng(0), calls
    for caller in callers:
        caller.start()
    while left > _HOT * calls:
        numbers = rng.integers(0, 3, size=2).tolist() if rng.random() < 0.5 else [0, 0]
        for caller, number in zip(callers, numbers, strict=True):
            caller.orders.put(number)
        left -= sum(caller.made.get() for caller in callers)
        steps.step()
    for caller in callers:
        caller.orders.put(left // 2)
    while any(caller.made.empty() for caller in callers):
        steps.step()
    for caller in callers:
        caller.orders.put(-1)
        caller.join()
    wrong = sum(len(caller.wrong) for caller in callers)
    case = f"{calls} calls from two threads, {name}"
    yield Promise(f"{case}: steps and calls that raise what they may not", float(steps.raised + wrong), 0.0, "")
    yield Promise(f"{case}: longest of {len(steps.times)} steps, CPU time", 1e3 * max(steps.times), 5.0, "ms")


def promises(quick: bool) -> Iterator[Promise]:
    """All promises of this kind."""
    calls = 200 if quick else 25_000
    for name, task in {"6 joints": paper_lift(), "7 joints": dual_arm7()}.items():
        yield from _called(name, _Steps(task, task.path, []), calls)
        if quick:
            return
    task = dual_arm7()
    cell = task.cell.with_limits(acceleration=_ACCELERATION)
    planned = plan(cell, task.grasp, task.path, q_start=task.q_start).path
    yield from _called("7 joints, planned", _Steps(task, planned, []), calls)
    task = elbow_and_knob()
    scene = CollisionScene.of(task, cell=task.cell.with_limits(acceleration=_ACCELERATION), margin=0.02)
    yield from _called("7 joints, beside a body", _Steps(task, task.path, [Clearance(scene)]), calls)
