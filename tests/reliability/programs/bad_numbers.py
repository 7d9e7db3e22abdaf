"""Steps of one solver's controllers on invalid numbers; prints the results as JSON.

``python bad_numbers.py SOLVER [TRIES]`` runs in a separate process, which the caller can end if a solver hangs.

A sound step follows each bad step and has to continue the motion. Times of several tries are more certain.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Cause, InvalidInputError, ObjectPath, QPController, QPOptions, ServoPath, Status
from coopqp.scenarios import Scenario, dual_arm7, fast_lift, scara_pair
from coopqp.simulation import Monitor
from coopqp.solvers import QpProblem, QpSolution, QpSolver, SolverSettings, make_solver

BAD = {"NaN": np.nan, "+inf": np.inf, "-inf": -np.inf}
#: Finite numbers at which solvers have been slow or have failed.
WILD = {"1e300": 1e300, "-1e300": -1e300, "1e25": 1e25, "1e15": 1e15, "1e-310": 1e-310}
#: Entries that mean "no bound".
ABSENT = {("u", "+inf"), ("ub", "+inf"), ("l", "-inf"), ("lb", "-inf")}
#: Arrays that replace arrays without rows.
ELSEWHERE = {"A": "C", "b": "g", "C": "A", "l": "lb", "u": "ub"}


@dataclass
class Tally:
    """The results of the cases."""

    cases: int = 0
    not_holding: list[str] = field(default_factory=list)
    not_going_on: list[str] = field(default_factory=list)
    raised: list[str] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    #: CPU time of the thread, for benchmarks/bad_numbers.py: the middle and the longest of the tries of each case.
    middle_ms: dict[str, float] = field(default_factory=dict)
    longest_ms: dict[str, float] = field(default_factory=dict)
    tries: int = 1

    def timed(self, case: str, tries_ms: list[float]) -> None:
        """Keep the times of one case; a name may come again, then the longer ones stay."""
        self.middle_ms[case] = max(statistics.median(tries_ms), self.middle_ms.get(case, 0.0))
        self.longest_ms[case] = max(max(tries_ms), self.longest_ms.get(case, 0.0))


class Poison(QpSolver):
    """A solver whose problems have one bad entry: every QP that a step may solve."""

    name, settings = "poison", SolverSettings()

    def __init__(self, solver: str) -> None:
        self._solver = make_solver(solver)
        self.entry: tuple[str, float, float] | None = None

    def _forget(self) -> None:
        self._solver.reset()

    def _solve(self, problem: QpProblem, work: Any) -> Any:
        raise NotImplementedError("solve() asks the other solver")

    def solve(self, problem: QpProblem) -> QpSolution:
        return self._solver.solve(self._poison(problem))

    def _poison(self, problem: QpProblem) -> QpProblem:
        if self.entry is None:
            return problem
        name, where, value = self.entry
        if not getattr(problem, name).size:
            name = ELSEWHERE[name]
        array = getattr(problem, name).copy()
        array.flat[int(where * array.size)] = value
        return replace(problem, **{name: array})


class Poisoned:
    """A controller with one bad entry in all QPs that a step may solve, if it has the solver for it."""

    def __init__(self, scenario: Scenario, options: QPOptions, *, limits_only: bool = False) -> None:
        self.controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, options=options)
        self.controller.reset(scenario.q_start)
        chain = {"chain_mm": 1e9, "chain_deg": 1e9} if limits_only else {}
        self._tolerances = {"object_mm": 1e9, "object_deg": 1e9, **chain}
        self.judge()
        self._poison = options.solver if isinstance(options.solver, Poison) else None

    def judge(self, path: ObjectPath | None = None) -> None:
        """Start a new monitor for the following steps."""
        self._monitor = Monitor(self.controller.cell, self.controller.grasp, path, tolerances=self._tolerances)
        self._steps: list[Any] = []

    def violations(self) -> list[str]:
        """Those of all steps."""
        self._monitor.observe_all(self._steps)
        return [str(violation) for violation in self._monitor.verdict().violations]

    def step(self, entry: tuple[str, float, float] | None = None, q: Any = None, dt: Any = None) -> Any:
        if self._poison is not None:
            self._poison.entry = entry
        began = time.thread_time()
        step = self.controller.step(q, dt=dt)
        self.took = time.thread_time() - began
        self._steps.append(step)
        return step


class SwitchedPath(ObjectPath):
    """A user-defined path with poses that can be spoiled; it is not known ahead."""

    known_ahead = False

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration, self.bad = path, path.duration, 0.0

    def pose(self, clock: float) -> pin.SE3:
        T = self._path.pose(clock)
        return T if self.bad == 0.0 else pin.SE3(T.rotation, T.translation + np.array([0.0, self.bad, 0.0]))

    def twist(self, clock: float) -> Any:
        return self._path.twist(clock)


def tried(
    tally: Tally, name: str, bad: Callable[[], tuple[Any, float]], sound: Callable[[], Any], *, holds: bool = True
) -> None:
    """Run one case: bad steps, each followed by a sound one."""
    tally.cases += 1
    took = []
    for _ in range(tally.tries):
        try:
            step, seconds = bad()
        except Exception as error:  # any exception is a failure
            tally.raised.append(f"{name}: {error!r}")
            return
        took.append(1e3 * seconds)
        if holds and not (step.status is Status.HOLDING and step.reason):
            tally.not_holding.append(f"{name}: {step.status.value}")
        after = sound()
        # An absurd number may have parted the arms within their limits: then they hold until they agree again.
        if after.status in (Status.HOLDING, Status.FAULT) and after.cause is not Cause.COMMANDED_CHAIN:
            tally.not_going_on.append(f"{name}: {after.reason}")
    tally.timed(name, took)


def qp_cases(solver: str, numbers: dict[str, float], tally: Tally, *, holds: bool) -> None:
    """Spoil one entry of each array of the QP."""
    rng = np.random.default_rng(6)
    for scenario in (fast_lift(), dual_arm7()):
        options = QPOptions(solver=Poison(solver), shortcut=False)
        for name in ("H", "g", "C", "l", "u", "lb", "ub"):  # A and b have no rows
            # Absurd data give an absurd optimum; the limits hold even then.
            one = Poisoned(scenario, options, limits_only=not holds)
            for _ in range(4):
                one.step()  # first steps for set-up and warm start
            for label, value in numbers.items():
                for where in rng.random(2):
                    entry = (name, float(where), value)
                    tried(
                        tally,
                        f"{scenario.name} {name} {label}",
                        lambda one=one, entry=entry: (one.step(entry), one.took),
                        one.step,
                        holds=holds and (name, label) not in ABSENT,
                    )
            tally.violations += one.violations()


def input_cases(solver: str, tally: Tally) -> None:
    """Spoil each entry of q, and dt."""
    for scenario in (fast_lift(), dual_arm7()):
        for acceleration in (np.inf, 5.0):
            task = replace(scenario, cell=scenario.cell.with_limits(acceleration=acceleration))
            one = Poisoned(task, QPOptions(solver=solver))
            for _ in range(4):
                one.step()
            for label, value in BAD.items():
                for i in range(0, task.cell.nq, 3):
                    q = task.q_start.copy()
                    q[i] = value
                    tried(tally, f"q[{i}] {label}", lambda q=q, one=one: (one.step(q=q), one.took), one.step)
                tried(tally, f"dt {label}", lambda v=value, one=one: (one.step(dt=v), one.took), one.step)
            tally.violations += one.violations()


def target_cases(solver: str, tally: Tally) -> None:
    """A bad target is refused and the old one stays; a path with bad poses is not followed."""
    scenario = fast_lift()
    start = scenario.path.pose(0.0)
    servo = replace(scenario, path=ServoPath(start))
    one = Poisoned(servo, QPOptions(solver=solver))
    one.controller.retarget(pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 0.1])))
    one.step()
    for label, value in BAD.items():
        for i in range(12):
            T = start.homogeneous.copy()
            T.flat[i] = value
            tally.cases += 1
            took = []
            for _ in range(tally.tries):
                began = time.thread_time()
                try:
                    one.controller.retarget(T)
                    tally.not_holding.append(f"target {label} [{i}] was taken")
                except InvalidInputError:
                    took.append(1e3 * (time.thread_time() - began))
            tally.timed(f"target {label} [{i}]", took or [0.0])
            if one.step().status not in (Status.TRACKING, Status.SLOWED):
                tally.not_going_on.append(f"target {label} [{i}]")
    tally.violations += one.violations()
    for make in (fast_lift, dual_arm7, scara_pair):
        scenario = make()
        path = SwitchedPath(scenario.path)
        one = Poisoned(replace(scenario, path=path), QPOptions(solver=solver))
        one.judge(scenario.path)  # judged with the unspoiled poses
        for _ in range(4):
            one.step()
        for label, value in BAD.items():

            def bad(one: Poisoned = one, path: SwitchedPath = path, value: float = value) -> tuple[Any, float]:
                path.bad = value
                step = one.step()
                path.bad = 0.0
                return step, one.took

            tried(tally, f"{scenario.name} path {label}", bad, one.step)


def main(solver: str, tries: int = 1) -> None:
    bad, wild = Tally(tries=tries), Tally(tries=tries)
    qp_cases(solver, BAD, bad, holds=True)
    input_cases(solver, bad)
    target_cases(solver, bad)
    qp_cases(solver, WILD, wild, holds=False)
    print()  # OSQP prints its own errors before this line
    print(json.dumps({"bad": vars(bad), "wild": vars(wild)}))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
