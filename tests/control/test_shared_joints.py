"""The step of arms that share joints: the same command as the full QP, and runs that keep the chain and the plan."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from torsos import held, lift_cell

from coopqp import (
    HoldPath,
    LinePath,
    QPController,
    ServoPath,
    Status,
    check_path,
    simulate,
)  # fmt: skip
from coopqp.errors import InvalidInputError
from coopqp.model import CellState


def rise(low: float, high: float, duration: float) -> LinePath:
    """A bar goes straight up [m]."""
    ends = [pin.SE3(np.eye(3), np.array([0.55, 0.0, z])) for z in (low, high)]
    return LinePath(ends[0], ends[1], duration=duration)


def test_a_run_follows_the_lift_that_the_check_proves() -> None:
    """Look-ahead on, 5 rad/s²: the chain holds, the path is kept, and the lift is where the check has it."""
    cell, grasp = lift_cell()
    path = rise(0.2, 1.7, 8.0)
    check = check_path(cell, grasp, path)
    assert check.verdict.value == "CERTIFIED"
    (way,) = check.shared
    assert not way.stands
    run = simulate(QPController(cell, grasp, check.led_path(), dt=0.02), q_start=check.q_start, duration=12.0)
    assert run.finished
    assert np.mean(run.status == Status.TRACKING.code) > 0.9
    errors = [np.abs(grasp.relative_errors(CellState(cell, q))[:, :3]).max() for q in run.q_command]
    assert max(errors) < 1e-7
    proved = check.proved_trajectory()
    assert proved is not None
    x = proved.positions(proved.places)[0]
    s = np.interp(run.clock, proved.clocks(proved.places), x[:, 0])
    assert np.abs(cell.positions(run.q_command)[:, 0] - s).max() < 0.02  # the run smooths it


def test_a_slow_lift_slows_the_object_and_keeps_the_chain() -> None:
    cell, grasp = lift_cell(velocity_limits={"lift": 0.02})
    check = check_path(cell, grasp, rise(0.2, 1.65, 4.0))
    assert check.feasible
    run = simulate(QPController(cell, grasp, check.led_path(), dt=0.02), q_start=check.q_start, duration=30.0)
    assert run.finished
    assert np.abs(np.diff(cell.positions(run.q_command)[:, 0])).max() <= 0.02 * 0.02 * (1.0 + 1e-9)
    errors = [np.abs(grasp.relative_errors(CellState(cell, q))[:, :3]).max() for q in run.q_command]
    assert max(errors) < 1e-6


def test_paths_not_known_ahead_and_operators_calls() -> None:
    """A servo target out of the lift's way, a pause, a new path: finite commands inside limits, the chain closed."""
    cell, grasp = lift_cell()
    start = pin.SE3(np.eye(3), np.array([0.55, 0.0, 0.9]))
    q = held(cell, grasp, start, np.array([0.3]))
    servo = ServoPath(start)
    controller = QPController(cell, grasp, servo, dt=0.01)
    controller.reset(q)
    controller.retarget(pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.3])), np.array([0.6, 0.1, 1.5])))
    worst, last = 0.0, q
    for number in range(300):
        if number == 100:
            controller.pause()
        if number == 150:
            controller.resume()
        if number == 250:
            controller.follow(HoldPath(grasp.carried(CellState(cell, last))[0]))
        step = controller.step()
        last = step.q_next
        assert (np.abs(step.velocity) <= cell.limits.velocity * (1.0 + 1e-9)).all()
        worst = max(worst, float(np.abs(grasp.relative_errors(CellState(cell, step.q_next))[:, :3]).max()))
    assert worst < 1e-5


def test_what_does_not_know_shared_joints_refuses_them() -> None:
    from coopqp.baselines import IndependentQPController, PseudoInverseController

    cell, grasp = lift_cell()
    path = rise(0.8, 0.9, 1.0)
    for make in (
        lambda: IndependentQPController(cell, grasp, path, dt=0.01),
        lambda: PseudoInverseController(cell, grasp, path, dt=0.01),
    ):
        with pytest.raises(InvalidInputError, match=r"share 'lift'.*Lock them"):
            make()
