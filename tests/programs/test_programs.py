"""Programs: gates and signals, hand-over, regrasp, contact, and what is refused when one is built."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import limited_once

from coopqp import ControlStep, Grasp, HoldPath, InvalidInputError, LinePath, QPController, Status, check_path
from coopqp.errors import UnknownNameError
from coopqp.forces import ForceOptions
from coopqp.programs import Holds, Phase, Program, Travels, Turns, Waits, Works
from coopqp.scenarios import PROGRAMS, paper_lift
from coopqp.simulation import check_run, simulate

GATE = 1.0


def lift() -> Any:
    return limited_once(lambda: paper_lift(time_law="linear"), 5.0)


def two_halves(**more: Any) -> tuple[Any, Program]:
    """The paper's lift at even speed, cut in two phases with a gate between them."""
    task = lift()
    middle = task.path.pose(GATE)
    first = LinePath(task.path.start, middle, duration=GATE, time_law="linear")
    second = LinePath(middle, task.path.goal, duration=2.0, time_law="linear")
    phases = [Phase("up", path=first, until="closed"), Phase("on", path=second)]
    return task, Program(task.cell, task.grasp, phases, **more)


def started(task: Any, program: Program, dt: float = 0.005) -> QPController:
    controller = QPController(task.cell, task.grasp, program, dt=dt)
    controller.reset(task.q_start)
    return controller


def run(controller: QPController, most: int = 4000) -> list[ControlStep]:
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < most:
        steps.append(controller.step())
    return steps


def off_path(task: Any, program: Program, step: ControlStep) -> float:
    """The largest distance of a tool from its place on the path [m], by Pinocchio's frames."""
    data = task.cell.model.createData()
    pin.framesForwardKinematics(task.cell.model, data, step.q_next)
    placed = program.grasp_at(task.grasp, step.clock_next).T_object_tool
    tools = [data.oMf[frame].translation for frame in task.cell.tool_frames]
    pose = program.pose(step.clock_next)
    return max(float(np.linalg.norm((pose * X).translation - p)) for X, p in zip(placed, tools, strict=True))


def test_a_signal_in_time_leaves_the_path_speed_unbroken() -> None:
    task, program = two_halves()
    controller = started(task, program)
    whole = started(task, Program(task.cell, task.grasp, [Phase("up", path=task.path)]))
    controller.signal("closed")
    for _ in range(450):
        assert abs(controller.step().rate - whole.step().rate) < 1e-4


def test_a_late_signal_lets_the_object_go_on_from_where_it_is() -> None:
    task, program = two_halves()
    controller = started(task, program)
    rates = []
    for _ in range(2000):
        rates.append(controller.step().rate)
        if len(rates) > 10 and rates[-1] < 0.5 * max(rates):
            break
    controller.signal("closed")
    after = [controller.step() for _ in range(20)]
    assert min(step.rate for step in after) > 0.9 * rates[-1]
    assert after[-1].rate > rates[-1]
    assert run(controller)[-1].finished


def test_without_its_signal_the_object_rests_at_the_gate_and_says_for_what_it_waits() -> None:
    task, program = two_halves()
    controller = started(task, program)
    steps = run(controller, most=600)
    assert steps[-1].status is Status.WAITING
    assert "closed" in steps[-1].reason
    assert abs(steps[-1].clock_next - GATE) < 1e-9
    assert max(off_path(task, program, step) for step in steps) < 5e-7
    for way in (copy.copy, lambda c: pickle.loads(pickle.dumps(c))):
        assert way(controller).step().status is Status.WAITING
    controller.signal("closed")
    assert run(controller)[-1].finished


def test_an_operator_goes_back_from_a_gate_and_comes_again() -> None:
    task, program = two_halves()
    controller = started(task, program)
    run(controller, most=600)
    controller.reverse(0.4)
    steps = [controller.step() for _ in range(500)]
    assert steps[-1].status is Status.PAUSED
    assert abs(steps[-1].clock_next - 0.4) < 1e-6
    controller.forward()
    steps = run(controller, most=600)
    assert steps[-1].status is Status.WAITING
    controller.pause()
    controller.signal("closed")
    steps = [controller.step() for _ in range(100)]
    assert abs(steps[-1].clock_next - GATE) < 1e-6
    controller.resume()
    assert run(controller)[-1].finished


def test_signals_come_by_themselves_a_time_after_the_start_and_a_reset_shuts_the_gates() -> None:
    task, program = two_halves(signals={"closed": 2.5})
    controller = started(task, program)
    for _ in range(2):
        steps = run(controller)
        assert steps[-1].finished
        waited = [i for i, step in enumerate(steps) if step.status is Status.WAITING]
        assert waited
        assert abs(0.005 * waited[-1] - 2.5) < 0.02
        controller.reset(task.q_start)
    with pytest.raises(UnknownNameError, match="opened"):
        controller.signal("opened")


def handed(at_rest: bool, *, leader: bool = False) -> tuple[Any, Program]:
    """An arm lets go and holds the plate elsewhere, 10 cm along its edge, while two others carry it."""
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    name = "master" if leader else "slave_2"
    k = task.cell.arm_names.index(name)
    X = task.grasp.T_object_tool[k]
    there = pin.SE3(X.rotation, X.translation + np.array([0.0, 0.1 if leader else -0.1, 0.0]))
    travel = {name: Travels(to=there, retreat_m=0.05)}
    middle = LinePath(task.path.start, task.path.goal, duration=3.0)
    if at_rest:
        phases = [Phase("over", arms=travel, duration=2.0), Phase("lift", path=middle)]
    else:
        phases = [Phase("over", path=middle, arms=travel), Phase("rest", duration=0.2)]
    return task, Program(task.cell, task.grasp, phases)


@pytest.mark.parametrize("at_rest", [True, False])
@pytest.mark.parametrize("leader", [False, True])
def test_an_arm_grasps_again_while_two_others_carry(at_rest: bool, leader: bool) -> None:
    task, program = handed(at_rest, leader=leader)
    assert len(program.spans[0].holding) == 2
    assert len(program.spans[1].holding) == 3
    controller = started(task, program)
    steps = run(controller)
    assert steps[-1].finished
    assert max(off_path(task, program, step) for step in steps) < 5e-7
    assert min(step.rate for step in steps[20:]) > 0.8


def test_only_arms_that_hold_define_the_objects_pose() -> None:
    task, program = handed(at_rest=True)
    controller = started(task, program)
    for _ in range(100):
        controller.step()
    shares = controller.options.common_error.shares_of(task.cell, (True, True, False))
    assert np.allclose(shares.sum(axis=0), 1.0)
    assert (shares[2] == 0.0).all()
    assert program.grasps is not None
    assert program.grasps.holds(0.5) == (True, True, False)
    assert program.grasps.holds(2.0) == (True, True, True)


def test_a_run_of_a_program_finishes_by_default() -> None:
    task, program = two_halves(signals={"closed": 1.6})
    recording = simulate(QPController(task.cell, task.grasp, program, dt=0.005), q_start=task.q_start)
    assert recording.metadata["finished"]
    assert check_run(recording, task.cell).ok


def refused(*phases: Phase, match: str) -> None:
    task = lift()
    with pytest.raises(InvalidInputError, match=match):
        Program(task.cell, task.grasp, phases)


def test_a_program_that_cannot_be_is_refused_when_it_is_built() -> None:
    task = lift()
    path, X = task.path, task.grasp.T_object_tool[1]
    away = HoldPath(path.pose(3.0) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])))
    everywhere = dict.fromkeys(task.cell.arm_names, Waits())
    refused(match="no phase")
    refused(Phase("a", path=path), Phase("a", duration=1.0), match="two phases")
    refused(Phase("a", path=path), Phase("b", path=away), match="phase 'b'.*100 mm")
    refused(Phase("a", path=path, arms=everywhere), match="no arm holds the object")
    refused(Phase("a", path=path, arms={"master": Waits()}), Phase("b", duration=1.0), match="arm 'master'.*not hold")
    refused(Phase("a", duration=1.0), match="no phase has a path")
    refused(Phase("a"), match="how long")
    seam = LinePath(X * pin.SE3(np.eye(3), np.array([0.01, 0.0, 0.0])), X, duration=1.0)
    refused(Phase("a", path=path, arms={"slave_1": Works(on=seam)}), match="slave_1.*10 mm")
    long = LinePath(X, X, duration=9.0)
    refused(Phase("a", path=path, arms={"slave_1": Works(on=long)}), match=r"9 s.* 3 s")
    with pytest.raises(UnknownNameError, match="left"):
        Program(task.cell, task.grasp, [Phase("a", path=path, arms={"left": Holds()})])
    with pytest.raises(UnknownNameError, match="gate"):
        Program(task.cell, task.grasp, [Phase("a", path=path)], signals={"gate": 1.0})
    with pytest.raises(InvalidInputError, match="direction"):
        Turns(about=(0.0, 0.0, 0.0), angle=0.1, axis=(0.0, 0.0, 0.0))


def test_forces_are_taken_where_arms_let_go_before_they_move() -> None:
    from coopqp import ForceController

    task, program = handed(at_rest=True)
    controller = QPController(task.cell, task.grasp, program, dt=0.005)
    assert ForceController(controller, ForceOptions(stiffness=1e5)).path is program
    assert isinstance(program.grasp_at(task.grasp, 1.0), Grasp)


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_scenario_that_is_a_program_runs_to_its_end(name: str) -> None:
    task = PROGRAMS[name]()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    recording = simulate(controller, q_start=task.q_start)
    assert recording.metadata["finished"]
    assert check_run(recording, task.cell).ok
    assert check_path(task.cell, task.grasp, task.path, q_start=task.q_start).feasible


@pytest.mark.core
@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_as_recorded(name: str, golden: Golden) -> None:
    task = PROGRAMS[name]()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    controller.reset(task.q_start)
    golden.of(controller, 1e-8).run(150)


def test_the_leader_leaves_an_object_that_moves_and_the_path_speed_stays() -> None:
    task = PROGRAMS["hand_over"]()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.002)
    controller.reset(task.q_start)
    steps = run(controller)
    assert steps[-1].finished
    assert min(step.rate for step in steps if 0.3 < step.clock < 2.8) > 0.8
    assert max(off_path(task, task.path, step) for step in steps) < 5e-7  # type: ignore[arg-type]


def test_the_way_back_waits_until_tools_rest_where_the_object_does() -> None:
    task = PROGRAMS["pliers"]()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
    controller.reset(task.q_start)
    while controller.program_clock < 3.8:  # the object rests, and two tools close the part
        controller.step()
    controller.reverse(2.0)
    steps = [controller.step() for _ in range(200)]
    assert max(step.given_up.chain for step in steps) == 0.0
    assert max(off_path(task, task.path, step) for step in steps) < 5e-7  # type: ignore[arg-type]
    assert steps[-1].sense == -1
