"""Planned programs: as fast as the limits allow in each phase, proved, and followed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import limited_once

from coopqp import InvalidInputError, LinePath, QPController, check_path, simulate
from coopqp.planning import time_path, time_program
from coopqp.programs import Phase, Program, Travels, Turns, Works
from coopqp.scenarios import paper_lift, pliers
from coopqp.simulation import check_run

pytest.importorskip("toppra")


def test_a_planned_program_is_followed_at_its_pace_and_proved() -> None:
    task = pliers()
    assert isinstance(task.path, Program)
    planned = time_program(task.cell, task.grasp, task.path, q_start=task.q_start, knots=80)
    assert planned.duration < 0.4 * task.path.duration
    assert [span.name for span in planned.spans] == ["open", "close"]
    assert check_path(task.cell, task.grasp, planned, q_start=task.q_start).verdict.value == "CERTIFIED"
    run = simulate(QPController(task.cell, task.grasp, planned, dt=0.004), q_start=task.q_start)
    assert run.finished
    assert run.time[-1] < 1.02 * planned.duration
    assert check_run(run, task.cell).ok
    used = np.abs(np.diff(run.velocity, axis=0) / 0.004).max() / 5.0
    assert 0.95 < used <= 1.0 + 1e-9


def test_a_phase_with_fixed_grasps_is_timed_as_its_path_is() -> None:
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    program = Program(task.cell, task.grasp, [Phase("lift", path=task.path)])
    planned = time_program(task.cell, task.grasp, program, q_start=task.q_start, knots=400)
    alone = time_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    assert planned.duration == pytest.approx(alone.duration, rel=2e-3)


def test_contact_and_gates_are_kept() -> None:
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    X = task.grasp.T_object_tool[2]
    there = pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0]))
    phases = [
        Phase("over", arms={"slave_2": Travels(to=there)}, duration=2.0, until="closed"),
        Phase("lift", path=task.path),
    ]
    program = Program(task.cell, task.grasp, phases, signals={"closed": 1.0})
    planned = time_program(task.cell, task.grasp, program, q_start=task.q_start, knots=60)
    assert [span.name for span in planned.spans] == ["over 1", "over 2", "over 3", "lift"]
    assert [span.until for span in planned.spans] == [None, None, "closed", None]
    assert [len(span.holding) for span in planned.spans] == [2, 2, 2, 3]
    assert program.grasps is not None
    assert planned.grasps is not None
    ends = [p.grasps.moved(2, p.duration).homogeneous for p in (program, planned) if p.grasps is not None]
    assert np.allclose(*ends, atol=1e-9)


def refused(phase: Phase, match: str, **limits: Any) -> None:
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    cell = task.cell.with_limits(**limits) if limits else task.cell
    with pytest.raises(InvalidInputError, match=match):
        time_program(cell, task.grasp, Program(cell, task.grasp, [phase]), q_start=task.q_start)


def test_what_cannot_be_timed_is_refused_by_name() -> None:
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    X = task.grasp.T_object_tool[2]
    short = LinePath(X, pin.SE3(X.rotation, X.translation + np.array([-0.05, 0.0, 0.0])), duration=1.0)
    refused(Phase("draw", path=task.path, arms={"slave_2": Works(on=short)}), "phase 'draw'.*Cut it")
    turn = Turns(about=(0.0, 0.8, 0.0), angle=0.1, time_law="linear")
    refused(Phase("turn", path=task.path, arms={"slave_2": turn}), "phase 'turn'.*one time law")
    refused(Phase("lift", path=task.path), "no acceleration limit", acceleration=np.inf)
