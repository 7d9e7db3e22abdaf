"""An arm that does not stand where its wrench puts its servos is named; what noise makes of that is accepted."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ForceController, HoldPath, QPController
from coopqp.forces import StressModel
from coopqp.model import CellState
from coopqp.scenarios import paper_lift

#: An arm this far from where its wrench puts its servos slows the object [m].
SLOWS = 6e-4
STIFF = 2e4  # [N·m/rad]


@pytest.mark.core
@pytest.mark.parametrize("margin", [0.0, 6.0])
def test_an_arm_is_named_where_its_servos_are_off_by_more_than_noise(margin: float) -> None:
    """It goes aside by 0.5 mm/s and nothing presses; noise is accepted as √(h / (2 T + h)) of it is let through."""
    task, size, slow = paper_lift(), 5e-5, 5e-4
    dt = T = task.dt
    watch = {"slow_from": 0.05, "hold_from": 0.06, "stall_samples": None, "filter_time": T, "noise_margin": margin}
    held = HoldPath(task.path.pose(0.0), duration=100.0)
    inner = QPController(task.cell, task.grasp, held, dt=dt, options={"supervision": watch})
    made = ForceController(inner, {"stiffness": STIFF, "check_time": 0.0, "presses": False})
    made.reset(task.q_start)
    model = StressModel(task.cell, task.grasp, stiffness=STIFF)
    q, columns = task.q_start, task.cell.columns[1]
    for i in range(400):
        state, x = CellState(task.cell, q), np.zeros(task.cell.nv)
        wrenches = model.estimate(q).wrenches  # of the object, as those of the presses at the start
        felt = np.array([X.action.T @ w for X, w in zip(task.grasp.T_object_tool, wrenches, strict=True)])
        for k in range(3):
            x[task.cell.columns[k]] = -state.jacobian(k).T @ felt[k] / STIFF
        aside = np.array([0.0, size * (-1.0) ** i, slow * dt * max(i - 60, 0)])
        tool = state.T_world_tool[1].rotation.T @ aside
        x[columns] += np.linalg.solve(state.jacobian(1), np.concatenate([tool, np.zeros(3)]))
        step = made.step(pin.integrate(task.cell.model, q, x), wrenches=felt)
        q = step.q_next
        if found := re.search(r"arm (\w+) is ([\d.]+) mm from where its wrench puts its servos", step.reason):
            break
    assert found
    assert found[1] == task.cell.arm_names[1]
    noise = 4.0 * size / np.sqrt(6.0)  # by second differences, which are 4 of it
    assert float(found[2]) == pytest.approx(1e3 * (SLOWS + margin * noise * np.sqrt(dt / (2.0 * T + dt))), abs=0.015)
