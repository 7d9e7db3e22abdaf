"""A5: if a solver fails in any way, temporarily or permanently, all arms brake together in the same step."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from checks import FAULTS, REST, Failure, FaultySolver, fails_now, judged, set_off
from runs import cooperative, limited

from coopqp import ObjectPath, ServoPath, Status
from coopqp.scenarios import Scenario, dual_arm7, fast_lift, five_joint_pair, mixed_cell, paper_lift, scara_pair
from coopqp.solvers import OsqpSettings, ProxqpSettings, SolverStatus, make_solver


def moving_target() -> tuple[Scenario, Any]:
    """Three arms on their way to a target, without look-ahead."""
    task = limited(paper_lift(), velocity=1.0, acceleration=5.0)
    start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
    return replace(task, path=ServoPath(start, speed=0.5, spin=1.0), dt=0.002), goal


def coming_back() -> tuple[Scenario, Any]:
    """Two joints of two arms start outside their limits."""
    task = limited(paper_lift(time_law="quintic"), velocity=1.0, acceleration=5.0)
    upper, lower = np.array(task.cell.limits.upper), np.array(task.cell.limits.lower)
    upper[2], lower[9] = task.q_start[2] - 0.1, task.q_start[9] + 0.1
    return replace(limited(task, upper=upper, lower=lower), dt=0.002), None


TASKS: dict[str, Callable[[], tuple[Scenario, Any]]] = {
    "three arms at their speed limits": lambda: (limited(fast_lift(), acceleration=5.0), None),
    "no acceleration limits": lambda: (fast_lift(), None),
    "redundant arms": lambda: (limited(dual_arm7(duration=1.0), acceleration=5.0), None),
    "four different arms": lambda: (limited(mixed_cell(duration=1.0), acceleration=5.0), None),
    "arms with four joints": lambda: (limited(scara_pair(duration=1.0), acceleration=5.0), None),
    "off the path past a corner": lambda: (limited(five_joint_pair(duration=1.0), acceleration=5.0), None),
    "a moving target": moving_target,
    "on the way back inside": coming_back,
}


@pytest.fixture(scope="module")
def failures(count: Callable[[int], int]) -> list[tuple[bool, Failure]]:
    """Every fault on one task, and one fault on all tasks, at several times; temporary and permanent."""
    rng, names = np.random.default_rng(5), list(TASKS)
    # of each task: when a solver fails, how, and whether for ever
    cases: dict[str, list[tuple[int, str, bool]]] = {}
    for _ in range(count(1)):
        shift = int(rng.integers(len(names)))
        runs = [(fault, names[(i + shift) % len(names)], at) for i, fault in enumerate(FAULTS) for at in (30, 120)]
        runs += [("answers NaN", name, at) for name in names for at in (1, 60, 200)]
        runs += [("answers NaN", "off the path past a corner", 300)]
        for fault, name, at in runs:
            for for_ever in (False, True):
                moment = at + int(rng.integers(20))
                cases.setdefault(name, []).append((moment, fault, for_ever))
    return [failure for name, of_run in cases.items() for failure in failed(name, of_run)]


def failed(name: str, cases: list[tuple[int, str, bool]]) -> Iterator[tuple[bool, Failure]]:
    """Copies of one run whose solver fails, each at its time."""
    task, goal = TASKS[name]()
    double = FaultySolver("daqp", FAULTS["answers NaN"])
    controller, steps = set_off(cooperative, task, double, goal), []
    for moment, fault, for_ever in sorted(cases):
        steps += [controller.step() for _ in range(moment - len(steps))]
        double.fault = FAULTS[fault]
        double.solver.reset()  # a copy shares the solver: no case begins from the answers of another
        yield for_ever, fails_now(task, copy.deepcopy(controller), double, steps, for_ever=for_ever)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_it_holds_within_the_same_step(failures: list[tuple[bool, Failure]], catalogue: Any) -> None:
    catalogue.row(
        "A5",
        "solver fails: steps with a failed solver that do not hold",
        cases=sum(f.hits for _, f in failures),
        measured=sum(not f.held or f.hits == 0 for _, f in failures),
        target=0,
        note=f"{len(FAULTS)} faults in {len(failures)} runs",
    )


@pytest.mark.slow
def test_it_comes_to_rest(failures: list[tuple[bool, Failure]], catalogue: Any) -> None:
    """In v/a + 2 dt; where no stop on the object's way is as short, in the time of the hardest one + 2 dt."""
    stopped = [f for for_ever, f in failures if for_ever]
    longer = [f for f in stopped if f.alone > 1.0]
    largest = max((f.alone for f in longer), default=1.0)
    catalogue.row(
        "A5",
        "solver fails for ever: time to rest, in multiples of v/a + 2 dt or of the hardest stop on the way + 2 dt",
        cases=len(stopped),
        measured=np.max([f.stopping for f in stopped]),
        target=1.0,
        note=f"in {len(longer)} cases the hardest stop on the way takes longer than v/a + 2 dt: {largest:.3g} times",
    )


@pytest.mark.slow
def test_the_arms_stay_together(failures: list[tuple[bool, Failure]], catalogue: Any) -> None:
    catalogue.row(
        "A5",
        "solver fails: growth of the chain error",
        cases=len(failures),
        measured=np.max([f.chain_mm for _, f in failures]),
        target=6e-4,
        unit="mm",
    )


@pytest.mark.slow
def test_limits_are_kept_and_the_clock_is_right(failures: list[tuple[bool, Failure]], catalogue: Any) -> None:
    catalogue.row(
        "A5",
        "solver fails: limits, continuity and clock violated",
        cases=len(failures),
        measured=sum(f.broken for _, f in failures),
        target=0,
    )


@pytest.mark.slow
def test_it_goes_on_when_the_solver_does(failures: list[tuple[bool, Failure]], catalogue: Any) -> None:
    catalogue.row(
        "A5",
        "solver recovers: steps until it goes on",
        cases=len(failures),
        measured=np.max([f.recovery for _, f in failures]),
        target=1,
    )


@pytest.mark.parametrize("fault", ["raises RuntimeError", "answers too few", "answers 2.1e9"])
def test_a_step_without_an_answer_tells_what_it_gave_up(fault: str) -> None:
    """No correction is done, the arms slow down along the path, and nothing is told of a solve that was none."""
    task = limited(fast_lift(), acceleration=5.0)
    double = FaultySolver("daqp", FAULTS[fault])
    controller = cooperative(task, shortcut=False, solver=double)
    controller.reset(task.q_start)
    before = [controller.step() for _ in range(40)][-1]
    double.broken = True
    step = controller.step()
    assert step.status is Status.HOLDING
    assert step.given_up.grasp == step.given_up.path == 1.0
    assert 0.0 < step.rate < before.rate
    if fault != "answers 2.1e9":
        assert (step.solver.status, step.solver.iterations, step.solver.time_s) == ("failed", 0, 0.0)


def test_only_the_first_qp_fails() -> None:
    """If it fails and the one whose chain may part succeeds, the motion continues normally."""
    task = limited(fast_lift(), acceleration=5.0)
    double = FaultySolver("daqp", FAULTS["answers NaN"], most=9)
    controller = cooperative(task, shortcut=False, solver=double)
    controller.reset(task.q_start)
    double.broken = True
    steps = [controller.step() for _ in range(100)]
    assert double.hits >= 100
    assert all(s.status in (Status.TRACKING, Status.SLOWED) for s in steps)
    assert all(s.given_up.chain < 1e-9 for s in steps)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "settings"),
    [
        ("proxqp", ProxqpSettings(max_iter=1, max_iter_in=1)),
        ("osqp", OsqpSettings(max_iter=1)),
    ],
)
def test_the_real_iteration_limit(solver: str, settings: Any) -> None:
    """With a cap of one iteration the solver fails at a limit: the arms brake and rest, and ``reason`` reports it.

    There is no preview, so the QP meets the limits.
    """
    task = limited(fast_lift(), acceleration=5.0)
    starved = make_solver(solver, settings)
    double = FaultySolver(solver, lambda _, problem: starved.solve(problem))
    controller = cooperative(task, shortcut=False, preview=None, solver=double)
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(100)]
    double.broken = True
    steps += [controller.step() for _ in range(200)]
    assert all(s.status is Status.HOLDING for s in steps[100:])
    assert all(SolverStatus.MAX_ITERATIONS.value in s.reason for s in steps[100:])
    assert np.abs(steps[-1].velocity).max() <= REST
    assert judged(task, steps).ok


def test_an_interrupt_is_not_swallowed() -> None:
    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    task = fast_lift()
    double = FaultySolver("daqp", interrupted)
    controller = cooperative(task, shortcut=False, solver=double)
    controller.reset(task.q_start)
    for broken in (True, False, True):  # the first step, and a later one
        double.broken = broken
        if broken:
            with pytest.raises(KeyboardInterrupt):
                controller.step()
        else:
            assert controller.step().status is not Status.HOLDING


class Interrupted(ObjectPath):
    """A user's path, and somebody who presses Ctrl-C while it is asked."""

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration, self.calls_left = path, path.duration, -1

    def _count(self) -> None:
        self.calls_left -= 1
        if self.calls_left == 0:
            raise KeyboardInterrupt

    def pose(self, clock: float) -> Any:
        self._count()
        return self._path.pose(clock)

    def twist(self, clock: float) -> Any:
        self._count()
        return self._path.twist(clock)


def test_an_interrupt_of_a_path_is_not_swallowed() -> None:
    """Whoever catches it can go on: neither the motion nor what is known ahead is broken."""
    task = replace(limited(paper_lift(time_law="quintic"), acceleration=5.0), dt=0.01)
    for calls in (1, 2, 3, 8, 30, 70):
        path = Interrupted(task.path)
        controller = cooperative(replace(task, path=path))
        controller.reset(task.q_start)
        steps = [controller.step() for _ in range(3)]
        path.calls_left, interrupts = calls, 0
        while not steps[-1].finished and len(steps) < 600:
            try:
                steps.append(controller.step())
            except KeyboardInterrupt:
                interrupts += 1
        assert interrupts == 1
        assert steps[-1].finished
        assert judged(task, steps).ok
    path.calls_left = 1
    with pytest.raises(KeyboardInterrupt):
        controller.reset(task.q_start)
