"""Random sequences of good and bad steps, resets, new grasps, other limits, new targets, and the loss of an arm.

After any sequence every command is finite, continues the last one and keeps the limits; the status is right, and while
the object is tracked the arms stay in step. The monitor of coopqp.simulation.evaluation.monitor judges.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
import pytest
from fuzzing import answer
from hypothesis import settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from coopqp import (
    ControlStep,
    CoopqpError,
    Grasp,
    LinePath,
    QPController,
    QPOptions,
    RobotCell,
    ServoPath,
    Status,
)
from coopqp.model import CellState
from coopqp.scenarios import Scenario, dual_arm7, fast_lift, mixed_cell
from coopqp.simulation import Monitor, Tolerances

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::coopqp.errors.StartWarning")
TASKS = (fast_lift(), dual_arm7(), mixed_cell())
#: Number of machines in CI, and largest number of rules of each.
MACHINES, RULES = 400, 12
#: Largest chain error of arms in step while the object is tracked at full rate [m].
IN_STEP = 1e-4

numbers = st.floats(-1.0, 1.0)
triples = st.tuples(*[numbers] * 3).map(np.array)


class AnyOrder(RuleBasedStateMachine):
    """One controller at a time, and the monitor of all its commands."""

    machines: ClassVar[int] = 0
    steps: ClassVar[int] = 0
    statuses: ClassVar[set[Status]] = set()

    @initialize(task=st.sampled_from(TASKS), limited=st.booleans(), solving=st.booleans(), servo=st.booleans())
    def build(self, task: Scenario, limited: bool, solving: bool, servo: bool) -> None:
        type(self).machines += 1
        self.cell, self.grasp = task.cell, task.grasp
        if limited:
            self.cell = self.cell.with_limits(acceleration=8.0)
        self.options = QPOptions(shortcut=not solving)
        self.object = task.path.pose(0.0)
        self.q = task.q_start
        self.path: Any = ServoPath(self.object) if servo else task.path
        self._new_controller(self.path)

    def _new_controller(self, path: Any) -> None:
        """Start a controller for the present cell and grasp at the present configuration, at rest."""
        controller = QPController(self.cell, self.grasp, path, dt=0.005, options=self.options)
        controller.reset(self.q)
        self.controller, self.path, self.clock = controller, path, 0.0
        self.monitor = Monitor(
            self.cell,
            self.grasp,
            tolerances=Tolerances(chain_mm=1e9, chain_deg=1e9, object_mm=1e9, object_deg=1e9),
        )

    def _take(self, step: ControlStep) -> None:
        cls = type(self)
        cls.steps += 1
        cls.statuses.add(step.status)
        self.monitor.observe(step)
        verdict = self.monitor.verdict()
        assert not verdict.counts, verdict
        assert step.explain()
        assert (step.reason != "") or step.status not in (Status.HOLDING, Status.FAULT)
        assert step.given_up.chain >= 0.0
        self.q, self.clock = step.q_next, step.clock_next
        O = self.grasp.carried(CellState(self.cell, step.q_next))
        self.object = O[0]
        known = not isinstance(self.path, ServoPath)
        if step.status is Status.TRACKING and known and step.given_up.chain == 0.0:
            apart = max(float(np.linalg.norm(a.translation - O[0].translation)) for a in O)
            assert apart < self._apart_before(step) + IN_STEP

    def _apart_before(self, step: ControlStep) -> float:
        O = self.grasp.carried(step.state)
        return max(float(np.linalg.norm(a.translation - O[0].translation)) for a in O)

    # -- steps ---------------------------------------------------------------------------------------------------------

    @rule(n=st.integers(1, 8))
    def step(self, n: int) -> None:
        for _ in range(n):
            self._take(self.controller.step())

    @rule(n=st.integers(1, 5), noise=st.sampled_from([0.0, 1e-5, 1e-3, 1e-2]), seed=st.integers(0, 1000))
    def step_measured(self, n: int, noise: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(n):
            v = noise * rng.standard_normal(self.cell.nv)
            self._take(self.controller.step(pin.integrate(self.cell.model, self.q, v)))

    @rule(value=st.sampled_from([np.nan, np.inf, -np.inf, 1e300, 1.0, None, "q"]), share=st.floats(0.0, 0.999))
    def step_with_bad_measurement(self, value: Any, share: float) -> None:
        q: Any = self.q.copy().tolist()
        q[int(share * len(q))] = value
        self._take(self.controller.step(q))

    @rule(dt=st.sampled_from([0.0, -0.005, np.nan, np.inf, 1e-12, 10.0, 0.001, 0.004, 0.006, 0.02, "soon", 10**400]))
    def step_of_odd_length(self, dt: Any) -> None:
        self._take(self.controller.step(dt=dt))

    # -- what changes between steps ------------------------------------------------------------------------------------

    @rule(shift=triples, turn=triples, size=st.sampled_from([0.0, 0.02, 0.2, 2.0]))
    def go_elsewhere(self, shift: Any, turn: Any, size: float) -> None:
        """Set a new target, or a new path from the present pose on the path."""
        goal = self.object * pin.SE3(pin.exp3(size * turn), size * shift)
        if isinstance(self.path, ServoPath):
            self.controller.retarget(goal)
        else:
            here = self.path.pose(self.clock)
            self.path, self.clock = LinePath(here, goal, duration=1.0), 0.0
            self.controller.follow(self.path)

    @rule(bad=st.sampled_from([2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan), None, 3.0]))
    def go_nowhere(self, bad: Any) -> None:
        assert answer(lambda: self.controller.retarget(bad) or True) is None
        assert answer(lambda: LinePath(self.object, bad, duration=1.0)) is None

    @rule()
    def reset(self) -> None:
        """Reset at the measured configuration, which may differ from the start of the path."""
        if answer(lambda: (self.controller.reset(self.q),)) is None:
            self._new_controller(ServoPath(self.object))
        self.clock = 0.0
        self.monitor.restart()

    @rule()
    def grasp_again(self) -> None:
        """Latch the grasp again at the present tool placements."""
        self.grasp = Grasp.from_configuration(self.cell, self.q, self.object)
        self._new_controller(ServoPath(self.object))

    @rule(offset=triples)
    def grasp_badly(self, offset: Any) -> None:
        """Assume a slightly wrong grasp: the controller corrects the chain error."""
        tools = list(self.grasp.T_object_tool)
        tools[-1] = pin.SE3(np.eye(3), 0.002 * offset) * tools[-1]
        grasp = Grasp(tuple(tools))
        before, self.grasp = self.grasp, grasp
        try:
            self._new_controller(ServoPath(self.object))
        except CoopqpError:  # the error is now too large
            self.grasp = before

    @rule(
        acceleration=st.sampled_from([np.inf, 3.0, 30.0]),
        speed=st.sampled_from([0.3, 1.0, 3.0]),
        room=st.floats(-0.02, 0.5),
    )
    def change_limits(self, acceleration: float, speed: float, room: float) -> None:
        """Set other limits, sometimes with joints outside."""
        x = self.cell.positions(self.q)
        bounded = np.isfinite(self.cell.limits.upper)
        upper = np.where(bounded, x + room, np.inf)
        lower = np.where(bounded, x - 0.7, -np.inf)
        self.cell = self.cell.with_limits(acceleration=acceleration, velocity=speed, lower=lower, upper=upper)
        self._new_controller(ServoPath(self.object))

    @precondition(lambda self: len(self.cell) > 1)
    @rule(which=st.integers(0, 3))
    def lose_an_arm(self, which: int) -> None:
        """Start a controller for the remaining arms."""
        k = which % len(self.cell)
        keep = [i for i in range(len(self.cell)) if i != k]
        q = np.concatenate([self.q[self.cell.q_slices[i]] for i in keep])
        self.cell = RobotCell([self.cell.arms[i] for i in keep])
        self.grasp = Grasp(tuple(self.grasp.T_object_tool[i] for i in keep))
        self.q = q
        self.object = self.grasp.carried(CellState(self.cell, q))[0]
        self._new_controller(ServoPath(self.object))


@pytest.mark.slow
def test_anything_in_any_order(catalogue: Any) -> None:
    scale = settings().max_examples / 200  # 1 in CI, 10 every night
    machine = type("Machine", (AnyOrder,), {"statuses": set()})
    run_state_machine_as_test(machine, settings=settings(max_examples=int(MACHINES * scale), stateful_step_count=RULES))
    assert machine.statuses >= {Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.HOLDING}
    catalogue.row(
        "C",
        "state machine: anything in any order",
        cases=machine.steps,
        measured=0,
        target=0,
        unit="failures",
        note=f"steps judged, in {machine.machines:,} sequences of up to {RULES} rules",
    )
