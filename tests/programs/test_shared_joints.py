"""Programs of arms that share joints: phases and gates, along which all arms hold on."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from torsos import lift_cell

from coopqp import InvalidInputError, LinePath, QPController, check_path, simulate
from coopqp.model import CellState
from coopqp.paths.certificate import PathVerdict
from coopqp.programs import Phase, Program, Waits


def level(z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([0.55, 0.0, z]))


UP = Phase("up", LinePath(level(0.2), level(1.0), duration=4.0), until="go")
ON = Phase("on", LinePath(level(1.0), level(1.7), duration=4.0))


def test_phases_and_a_gate_are_proved_and_followed() -> None:
    cell, grasp = lift_cell()
    program = Program(cell, grasp, [UP, ON], signals={"go": 6.0})
    check = check_path(cell, grasp, program)
    assert check.verdict is PathVerdict.CERTIFIED
    assert [phase.name for phase in check.phases] == ["up", "on"]
    assert not check.shared[0].stands
    run = simulate(QPController(cell, grasp, check.led_path(), dt=0.01), q_start=check.q_start, duration=30.0)
    assert run.finished
    assert run.time[-1] == pytest.approx(10.0, abs=0.1)  # it waits for the signal, from 4 s to 6 s
    errors = [np.abs(grasp.relative_errors(CellState(cell, q))).max() for q in run.q_command[::10]]
    assert max(errors) < 1e-7


def test_arms_that_share_joints_do_not_let_go() -> None:
    cell, grasp = lift_cell()
    with pytest.raises(InvalidInputError, match=r"let go or move.*Arms that share joints hold on"):
        Program(cell, grasp, [UP, Phase("lets go", ON.path, {"left": Waits()})])
