"""The controller's steps are those of the reference, which shares no code with it: see ``reference.py``.

Nothing is known ahead, so both choose the path speed. What the look-ahead chooses is held by other tests.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at
from marks import slow_unless
from reference import Reference, Settings
from runs import hurried, limited

from coopqp import Arm, Grasp, LinePath, QPController, QPOptions, RobotCell
from coopqp.model import CellState
from coopqp.scenarios import Scenario, robot_path, scenario
from coopqp.solvers import QpSolver

#: Largest difference of joint velocities [rad/s or m/s]; gradients of the reference are differences.
SAME = 1e-8
#: The same where braking together binds: its rows are scaled by the gradient of a singular value.
BRAKING = 1e-6


def shifted(task: Scenario) -> Scenario:
    """The first arm holds the object 5 mm and 0.6° off its grasp."""
    tools = list(task.grasp.T_object_tool)
    tools[0] = pin.SE3(pin.exp3(np.array([0.0, 0.01, 0.0])), np.array([0.004, 0.0, 0.003])) * tools[0]
    return replace(task, grasp=Grasp(tuple(tools)))


def pinned(task: Scenario) -> Scenario:
    """The first six joints stand 0.1 mrad from both of their limits."""
    x = task.cell.positions(task.q_start)
    lower, upper = task.cell.limits.lower.copy(), task.cell.limits.upper.copy()
    lower[:6], upper[:6] = x[:6] - 1e-4, x[:6] + 1e-4
    return limited(task, lower=lower, upper=upper)


def in_plane(outside: float) -> Scenario:
    """Two arms of seven joints with their elbows next to the planes of the arms; one joint is outside its limit [rad].

    Its slope along the self-motion is next to 0, and changes on the way: what the limit wants is far away.
    """
    bases = {"left": (-0.7, 0.0), "right": (0.7, np.pi)}
    cell = RobotCell(
        Arm.from_urdf(
            name, robot_path("arm7"), tool_frame="tool", geometry=False,
            T_world_base=pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0.0, 0.0])),
        )
        for name, (x, yaw) in bases.items()
    )  # fmt: skip
    q = cell.configuration(np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2) + 0.01 * np.arange(14) % 0.03)
    upper = cell.limits.upper.copy()
    upper[1] = q[1] - outside
    cell, grasp = cell.with_limits(upper=upper), grasp_at(cell, q)
    start = CellState(cell, q).T_world_tool[0] * grasp.T_object_tool[0].inverse()
    path = LinePath.displaced(start, translation=(0.0, 0.0, -0.1), rotation=(0.0, 0.0, 0.2), duration=2.0)
    return Scenario("in_plane", cell, grasp, path, q, 0.004)


class Failing(QpSolver):
    """It has no answer: all arms brake."""

    name, settings = "failing", None  # type: ignore[assignment]

    def _solve(self, problem: Any, work: Any) -> Any:
        raise ValueError("it never has one")

    def _forget(self) -> None:
        pass


#: Of each case the scenario, the acceleration of all joints, the period [s] and options.
CASES: dict[str, tuple[Any, float, float, dict[str, Any]]] = {
    "three arms": (lambda: scenario("paper_lift"), np.inf, 0.01, {}),
    "three arms, accelerations": (lambda: hurried(scenario("paper_lift"), 0.4), 3.0, 0.004, {}),
    "always a QP": (lambda: scenario("fast_lift"), 3.0, 0.01, {"shortcut": False}),
    "up to a limit": (lambda: scenario("at_limit"), np.inf, 0.01, {}),
    "up to a limit, accelerations": (lambda: scenario("at_limit"), 5.0, 0.01, {}),
    "past a singularity": (lambda: scenario("at_singularity"), 3.0, 0.01, {"shortcut": False}),
    "seven joints": (lambda: scenario("dual_arm7"), 5.0, 0.01, {"shortcut": False}),
    "six and seven joints": (lambda: scenario("mixed_cell"), np.inf, 0.01, {"shortcut": False}),
    "arms off their grasp": (lambda: shifted(scenario("paper_lift")), 5.0, 0.01, {}),
    "arms off their grasp, pinned": (lambda: pinned(shifted(scenario("dual_arm7"))), np.inf, 0.01, {}),
    "five joints": (lambda: scenario("five_joint_pair"), 5.0, 0.01, {"shortcut": False}),
    "four joints": (lambda: scenario("scara_pair"), 3.0, 0.01, {"shortcut": False}),
    "five joints and pins": (lambda: scenario("five_joint_pins"), 3.0, 0.01, {"shortcut": False}),
    "a torso": (lambda: scenario("torso_lift"), 3.0, 0.01, {"shortcut": False}),
    "a rail": (lambda: scenario("two_on_a_rail"), 3.0, 0.01, {}),
    "an elbow beside a limit": (lambda: in_plane(1e-3), 10.0, 0.004, {"shortcut": False}),
    "an elbow farther beside a limit": (lambda: in_plane(2e-3), 5.0, 0.003, {}),
    "no solver has an answer": (lambda: pinned(shifted(scenario("dual_arm7"))), 5.0, 0.01, {"solver": Failing()}),
}
QUICK = {
    "an elbow beside a limit",
    "three arms",
    "three arms, accelerations",
    "always a QP",
    "seven joints",
    "a torso",
    "four joints",
}


def both(task: Scenario, dt: float, **options: Any) -> tuple[QPController, Reference]:
    """The controller and the reference at the start of a scenario."""
    controller = QPController(task.cell, task.grasp, task.path, dt=dt, options=QPOptions(preview=None, **options))
    controller.reset(task.q_start)
    settings = Settings(shortcut=options.get("shortcut", True), fails="solver" in options)
    tools = task.grasp.T_object_tool
    return controller, Reference(task.cell, tools, task.path, task.q_start, dt=dt, settings=settings)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.core
@pytest.mark.parametrize("case", slow_unless(QUICK.__contains__, CASES))
def test_a_step_is_that_of_the_reference(case: str) -> None:
    make, acceleration, dt, options = CASES[case]
    controller, reference = both(limited(make(), acceleration), dt, **options)
    bent = 0
    for _ in range(80):
        step, expected = controller.step(), reference.step()
        same = BRAKING if "limit" in case else SAME
        np.testing.assert_allclose(step.velocity, expected.v, atol=same, rtol=0.0, err_msg=step.explain())
        assert step.rate == pytest.approx(expected.rate, abs=100.0 * same)
        assert step.clock_next == pytest.approx(expected.clock_next, abs=same)
        bent += expected.answer.bent
        if step.finished:
            break
    assert (bent >= 3) == ("elbow" in case)
