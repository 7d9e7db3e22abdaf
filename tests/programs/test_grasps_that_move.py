"""Tools that move on the object: their formulas, recorded steps, and how far arms are apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import limited_once

from coopqp import Grasp, InvalidInputError, LinePath, QPController, WaypointPath, check_path
from coopqp.baselines import PseudoInverseController
from coopqp.paths import Section
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.moving_grasps import pieces_of
from coopqp.planning import plan
from coopqp.planning.tools_on_object import ToolPiece
from coopqp.programs import Phase, Program, Slides, Turns, Works
from coopqp.scenarios import paper_lift
from coopqp.simulation import Monitor, check_run, read_run, simulate
from coopqp.simulation.simulate import RunRecorder

PIN = (0.0, 0.8, 0.0)


def pose(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-1.0, 1.0, 3))


def motion_of(rng: np.random.Generator) -> GraspMotion:
    """Arm 0 rests, arm 1 turns and slides, arm 2 goes through waypoints and begins late."""
    first = pieces_of(
        LinePath(pose(rng), pose(rng), duration=1.0), start=0.2, before=pin.SE3.Identity(), frame=pose(rng), where=""
    )
    way = WaypointPath([pose(rng) for _ in range(3)], durations=[0.4, 0.7], time_law="linear")
    second = pieces_of(way, start=1.5, before=pin.SE3.Identity(), frame=pose(rng), where="")
    again = pieces_of(
        LinePath(pose(rng), pose(rng), duration=0.5), start=2.0, before=first[-1].pose(9.0), frame=pose(rng), where=""
    )
    return GraspMotion(((), (*first, *again), second), ((0.0, (True,) * 3), (1.0, (True, False, True))))


def pliers(limited: Any = None, *, angle: float = np.deg2rad(5.0)) -> tuple[Any, Program]:
    """The paper's lift by three arms, while two of them open the part by ± an angle about a pin, and close it again."""
    task = limited or limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    opens = {"slave_1": Turns(about=PIN, angle=angle), "slave_2": Turns(about=PIN, angle=-angle)}
    shuts = {"slave_1": Turns(about=PIN, angle=-angle), "slave_2": Turns(about=PIN, angle=angle)}
    phases = [Phase("open", path=task.path, arms=opens), Phase("close", duration=2.0, arms=shuts)]
    return task, Program(task.cell, task.grasp, phases)


def apart(task: Any, program: Program, q: Any, clock: float) -> float:
    """The largest distance of an arm's view of the object from its path [m], from Pinocchio's frames alone.

    The grasps follow from the phases' angles, not from the program's own numbers.
    """
    data = task.cell.model.createData()
    pin.framesForwardKinematics(task.cell.model, data, q)
    u = np.array([min(clock / 3.0, 1.0), max(clock - 3.0, 0.0) / 2.0])
    u = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    turn = np.deg2rad(5.0) * (u[0] - u[1])
    away = 0.0
    for frame, X, sign in zip(task.cell.tool_frames, task.grasp.T_object_tool, (0.0, 1.0, -1.0), strict=True):
        R = pin.utils.rotate("z", sign * turn)
        M = pin.SE3(R, np.array(PIN) - R @ np.array(PIN))
        O = data.oMf[frame] * (M * X).inverse()
        away = max(away, float(np.linalg.norm(program.pose(clock).actInv(O).translation)))
    return away


def test_a_tools_twist_on_the_object_is_the_change_of_its_placement(rng: np.random.Generator) -> None:
    motion, h = motion_of(rng), 1e-6
    for clock in rng.uniform(0.0, 3.0, 30):
        if min(abs(clock - mark) for mark in (0.2, 1.2, 1.5, 1.9, 2.0, 2.5, 2.6)) < 1e-3:
            continue
        found = motion.twists(float(clock))
        for k in range(3):
            before, after = motion.moved(k, clock - h), motion.moved(k, clock + h)
            change = pin.log6(after * before.inverse()).vector / (2.0 * h)
            assert np.allclose(found[k], change, atol=1e-6 * max(1.0, np.abs(change).max()))


def test_pieces_follow_each_other_without_a_jump(rng: np.random.Generator) -> None:
    motion = motion_of(rng)
    for mark in (0.2, 1.2, 1.5, 1.9, 2.0, 2.5, 2.6):
        for k in range(3):
            jump = motion.moved(k, mark - 1e-9).actInv(motion.moved(k, mark + 1e-9))
            assert np.abs(pin.log6(jump).vector).max() < 1e-7
    assert [round(mark, 9) for mark in motion.breakpoints] == [1.5, 1.9, 2.6]  # where linear pieces begin and end


@pytest.mark.parametrize(("begin", "end"), [(0.3, 2.4), (2.4, 0.3), (2.8, 0.0), (2.55, 2.7)])
def test_a_section_moves_the_tools_as_the_whole_does(rng: np.random.Generator, begin: float, end: float) -> None:
    motion = motion_of(rng)
    part, sense = motion.section(begin, end), 1.0 if end > begin else -1.0
    for u in rng.uniform(0.0, abs(end - begin), 20):
        clock = begin + sense * u
        for k in range(3):
            assert np.allclose(part.moved(k, u).homogeneous, motion.moved(k, clock).homogeneous, atol=1e-12)
        assert np.allclose(part.twists(u), sense * motion.twists(clock), atol=1e-9)
        assert part.holds(u) == motion.holds(clock)


def test_bounds_of_a_tool_that_moves_on_a_moving_object_hold(rng: np.random.Generator) -> None:
    for _ in range(10):
        segments = [LinePath(pose(rng), pose(rng), duration=1.0).segment(0.0) for _ in range(2)]
        piece = ToolPiece(segments[0], pose(rng), segments[1], pose(rng), 0.2, 0.9)
        s, h = rng.uniform(0.05, 0.95, 6), 1e-4

        def at(s: Any, piece: ToolPiece = piece) -> Any:
            R, p = piece.poses(s)
            return [pin.SE3(a, b) for a, b in zip(R, p, strict=True)]

        V, dV = piece.twists(s)
        (before, middle, after) = (at(s + step) for step in (-h, 0.0, h))
        for i in range(len(s)):
            linear = (after[i].translation - before[i].translation) / (2.0 * h)
            angular = pin.log3(after[i].rotation @ before[i].rotation.T) / (2.0 * h)
            assert np.allclose(V[i], [*linear, *angular], atol=1e-6)
            assert np.allclose(middle[i].homogeneous, at(s)[i].homogeneous)
        change = (piece.twists(s + h)[0] - piece.twists(s - h)[0]) / (2.0 * h)
        assert np.allclose(dV, change, atol=1e-6)
        bend = (piece.twists(s + h)[1] - piece.twists(s - h)[1]) / (2.0 * h)
        bounds = piece.bounds(s - 0.01, s + 0.01)
        assert (np.linalg.norm(V[:, :3], axis=1) <= bounds.way + 1e-9).all()
        assert (np.linalg.norm(V[:, 3:], axis=1) <= bounds.turn + 1e-9).all()
        assert (np.linalg.norm(bend[:, :3], axis=1) <= bounds.way_change + 1e-5).all()
        assert (np.linalg.norm(bend[:, 3:], axis=1) <= bounds.turn_change + 1e-5).all()


def test_two_arms_open_a_part_while_a_third_lifts_it() -> None:
    task, program = pliers()
    controller = QPController(task.cell, task.grasp, program, dt=0.005)
    monitor = Monitor(task.cell, task.grasp)
    controller.reset(task.q_start)
    rng, away, done = np.random.default_rng(3), 0.0, False
    steps = []
    for i in range(3000):
        if i % 97 == 50:
            controller.set_override(float(rng.uniform(0.5, 1.0)))
        if i == 200:
            controller.pause()
        if i == 260:
            controller.resume()
        if i == 420:
            controller.reverse(0.8)
        step = controller.step()
        if step.status.name == "PAUSED" and i > 480:
            controller.forward()
        steps.append(step)
        away = max(away, apart(task, program, step.q_next, step.clock_next))
        done = step.finished
        if done:
            break
    assert done
    monitor.observe_all(steps)
    assert away < 5e-7
    assert monitor.verdict().ok, monitor.verdict()


@pytest.mark.core
def test_tools_that_move_as_recorded(golden: Golden) -> None:
    task, program = pliers()
    controller = QPController(task.cell, task.grasp, program, dt=0.006)
    controller.reset(task.q_start)
    done = golden.of(controller)
    asked = {120: lambda made: made.set_override(0.3), 220: lambda made: made.reverse()}
    for i in range(350):
        if i in asked:
            done.ask(asked[i])
        if i == 150:
            done.copied()
        done.take(done.controller.commanded + 1e-5 * np.sin(0.1 * i + np.arange(task.cell.nq)))


def test_a_path_check_proves_tools_that_move_and_names_the_phase_where_they_cannot() -> None:
    task, program = pliers()
    check = check_path(task.cell, task.grasp, program, q_start=task.q_start)
    assert check.verdict.value == "CERTIFIED"
    assert [phase.verdict.value for phase in check.phases if phase.verdict] == ["CERTIFIED", "CERTIFIED"]
    wide = pliers(task, angle=np.deg2rad(40.0))[1]
    check = check_path(task.cell, task.grasp, wide, q_start=task.q_start)
    assert not check.feasible
    first = check.phases[0]
    assert (first.name, first.verdict.value if first.verdict else "") == ("open", "INFEASIBLE")
    assert first.arm in task.cell.arm_names
    assert "phase open" in check.explain()
    assert check.phases[1].verdict is None


def test_a_run_on_which_tools_move_is_recorded_and_judged() -> None:
    task, program = pliers()
    recording = simulate(QPController(task.cell, task.grasp, program, dt=0.01), q_start=task.q_start)
    assert recording.metadata["finished"]
    assert recording.shift is not None
    assert np.abs(recording.shift[299, 1]).max() > 0.08  # opened by 5°
    assert read_run(task.cell, recording).chain_mm.max() < 1e-3
    assert check_run(recording, task.cell).ok
    placed = program.grasp_at(task.grasp, 3.0).T_object_tool
    for X, Y in zip(recording.grasps_at(300), placed, strict=True):
        assert np.allclose(X.homogeneous, Y.homogeneous, atol=1e-9)


def test_a_program_that_an_operator_shifts_is_recorded_as_one() -> None:
    task, program = pliers()
    controller = QPController(task.cell, task.grasp, program, dt=0.01)
    controller.reset(task.q_start)
    recorder = RunRecorder(controller, task.q_start)
    recorder.take(controller.step(), task.q_start)
    controller.shift_path(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01])))
    recorder.take(controller.step(), task.q_start)
    assert recorder.recording({}).metadata["phases"] == program.record()


def test_a_tool_that_works_on_a_carried_part_stays_on_it() -> None:
    task = limited_once(lambda: paper_lift(time_law="quintic"), 5.0)
    X = task.grasp.T_object_tool[2]
    there = pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.05, 0.0]))
    seam = WaypointPath([X, there, X], durations=[1.0, 1.0])
    work = Phase("draw", path=task.path, arms={"slave_2": Works(on=seam)})
    program = Program(task.cell, task.grasp, [work])
    assert program.spans[0].holding == ("master", "slave_1")
    controller = QPController(task.cell, task.grasp, program, dt=0.005)
    controller.reset(task.q_start)
    data, away = task.cell.model.createData(), 0.0
    for _ in range(1000):
        step = controller.step()
        pin.framesForwardKinematics(task.cell.model, data, step.q_next)
        tool = data.oMf[task.cell.tool_frames[2]]
        wanted = program.pose(step.clock_next) * seam.pose(step.clock_next)
        away = max(away, float(np.linalg.norm(tool.translation - wanted.translation)))
        assert step.relative_errors.max() < 1e-3
        if step.finished:
            break
    assert step.finished
    assert away < 5e-7
    part = Section(program, 0.5, 1.5)
    assert part.grasps is not None
    assert program.grasps is not None
    assert np.allclose(part.grasps.moved(2, 0.25).homogeneous, program.grasps.moved(2, 0.75).homogeneous)


def test_what_does_not_know_moving_tools_refuses_them_by_name() -> None:
    task, program = pliers()
    controller = QPController(task.cell, task.grasp, program, dt=0.01)
    with pytest.raises(InvalidInputError, match="move on the object"):
        PseudoInverseController(task.cell, task.grasp, program, dt=0.01)
    with pytest.raises(InvalidInputError, match="move on the object"):
        controller.shift_grasp(np.zeros((3, 6)))
    with pytest.raises(InvalidInputError, match="move on the object"):
        plan(task.cell, task.grasp, program)
    other = QPController(task.cell, task.grasp, task.path, dt=0.01)
    other.shift_grasp(np.full((3, 6), 1e-4))
    with pytest.raises(InvalidInputError, match="shifted"):
        other.follow(program)
    two = Grasp(task.grasp.T_object_tool[:2])
    with pytest.raises(InvalidInputError):
        QPController(task.cell, two, program, dt=0.01)
    sliding = Program(task.cell, task.grasp, [Phase("a", path=task.path, arms={"slave_1": Slides((0, 0, 1), 0.05)})])
    assert sliding.grasps is not None
    assert np.allclose(sliding.grasps.moved(1, 9.0).translation, [0.0, 0.0, 0.05])
