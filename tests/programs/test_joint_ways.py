"""Arms that follow a way of their joints: what they follow, what counts ahead, and what is refused."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import limited_once

from coopqp import (
    ControlStep,
    HoldPath,
    InvalidInputError,
    LinePath,
    QPController,
    Status,
    check_path,
    find_start,
    inverse_kinematics,
)
from coopqp.errors import UnreachableError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import find_branches
from coopqp.paths import JointPath
from coopqp.planning import time_program
from coopqp.programs import FollowsJoints, Phase, Program, Travels, Waits
from coopqp.scenarios import dual_arm7, paper_lift

DT = 0.01
#: Joint 4 and 6 turn and joint 5 changes its sign: the wrist's other branch, with the same tool.
ELSEWHERE = np.deg2rad([20.0, -10.0, 15.0, 0.0, 20.0, 30.0])


def lift() -> Any:
    return limited_once(lambda: paper_lift(time_law="quintic"), 5.0)


def own(task: Any, q: Any) -> Any:
    """Positions of the third arm."""
    return task.cell.positions(q)[task.cell.columns[2]]


def out_and_back(task: Any, *, rests: bool = True, duration: float = 2.0) -> Program:
    """The third arm goes away by its joints and back, then waits, then all three lift."""
    x = own(task, task.q_start)
    way = JointPath([x, x + ELSEWHERE, x], duration)
    start = task.path.start
    over = None if rests else LinePath.displaced(start, translation=(0.0, 0.0, 0.05), duration=2 * duration)
    path = LinePath(start if over is None else over.goal, task.path.goal, duration=3.0)
    X = task.grasp.T_object_tool[2]
    phases = [
        Phase("go", arms={"slave_2": FollowsJoints(way)}, path=over),
        Phase("back", arms={"slave_2": Travels(to=X, retreat_m=0.0)}, duration=0.5),
        Phase("lift", path=path),
    ]
    return Program(task.cell, task.grasp, phases)


def started(task: Any, program: Program, **options: Any) -> QPController:
    controller = QPController(task.cell, task.grasp, program, dt=DT, options=options or None)
    controller.reset(task.q_start)
    return controller


def run(controller: QPController, most: int = 1500) -> list[ControlStep]:
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < most:
        steps.append(controller.step())
    return steps


def off(task: Any, program: Program, step: ControlStep, arms: tuple[int, ...]) -> float:
    """The largest distance of the tools of arms from where they belong on the path [m], by Pinocchio's frames."""
    data = task.cell.model.createData()
    pin.framesForwardKinematics(task.cell.model, data, step.q_next)
    pose, grasp = program.pose(step.clock_next), program.grasp_at(task.grasp, step.clock_next)
    places = [(pose * grasp.T_object_tool[k]).translation for k in arms]
    tools = [data.oMf[task.cell.tool_frames[k]].translation for k in arms]
    return max(float(np.linalg.norm(a - b)) for a, b in zip(places, tools, strict=True))


def off_way(task: Any, program: Program, steps: list[ControlStep]) -> float:
    """How far the third arm is from the first phase's way while it follows that [rad]."""
    way = program.phases[0].arms["slave_2"].path
    led = [step for step in steps if step.clock_next < way.duration - 1e-9]
    return max(float(np.abs(own(task, step.q_next) - way.at(step.clock_next)[0]).max()) for step in led)


def test_a_joint_path_goes_through_its_rows_and_rests_there() -> None:
    rows = np.array([[0.0, 1.0], [1.0, -1.0], [2.0, 0.5]])
    path = JointPath(rows, [1.0, 3.0])
    assert path.duration == 4.0
    for clock, row in ((0.0, 0), (1.0, 1), (4.0, 2)):
        x, v = path.at(clock)
        assert np.allclose(x, rows[row])
        assert np.allclose(v, 0.0)
    for clock in (0.3, 0.9, 2.2, 3.9):
        change = (path.at(clock + 1e-6)[0] - path.at(clock - 1e-6)[0]) / 2e-6
        assert np.allclose(path.at(clock)[1], change, atol=1e-6)
    through = JointPath.through([0.0, 0.5, 2.0], rows)
    assert np.allclose(through.at(0.5)[0], rows[1])
    assert np.allclose(through.at(0.0)[1], 0.0)
    assert np.allclose(through.at(2.0)[1], 0.0)
    change = (through.at(1.2 + 1e-6)[0] - through.at(1.2 - 1e-6)[0]) / 2e-6
    assert np.allclose(through.at(1.2)[1], change, atol=1e-6)


@pytest.mark.parametrize(
    ("positions", "durations"),
    [([[0.0, 1.0]], 1.0), ([[0.0], [1.0]], [1.0, 1.0]), ([[0.0], [np.nan]], 1.0), ([[0.0], [1.0]], 0.0), ([0.0], 1.0)],
)
def test_bad_joint_paths_are_refused(positions: Any, durations: Any) -> None:
    with pytest.raises(InvalidInputError, match="JointPath"):
        JointPath(positions, durations)


def test_an_arm_follows_its_joints_and_holds_again() -> None:
    task = lift()
    program = out_and_back(task)
    controller = started(task, program)
    steps = run(controller)
    assert steps[-1].finished
    assert off_way(task, program, steps) < 1e-6
    assert max(off(task, program, step, (0, 1)) for step in steps) < 5e-7
    assert max(off(task, program, step, (0, 1, 2)) for step in steps if step.clock_next > 5.0) < 5e-7
    limit = task.cell.limits.acceleration
    bend = np.diff([step.velocity for step in steps], axis=0) / DT
    assert (np.abs(bend) <= limit + 1e-6).all()
    assert program.spans[0].holding == ("master", "slave_1")


def test_it_counts_among_the_limits_ahead() -> None:
    """A way twice as fast as its joints may move is followed at half the path speed, at the joint that is named."""
    task = lift()
    speed = float(task.cell.limits.velocity[task.cell.columns[2]][0])
    seconds = float(ELSEWHERE[0]) * 1.875 / speed / 2.0  # the quintic's largest speed is 1.875 of the mean
    program = out_and_back(task, duration=max(seconds, 0.05))
    controller = started(task, program)
    steps = run(controller, most=4000)
    assert steps[-1].finished
    low, high = task.cell.limits.velocity, task.cell.limits.acceleration
    assert max(float((np.abs(step.velocity) / low).max()) for step in steps) <= 1.0 + 1e-9
    bend = np.diff([step.velocity for step in steps], axis=0) / DT
    assert (np.abs(bend) <= high + 1e-6).all()
    slow = [step for step in steps if step.status is Status.SLOWED]
    assert slow
    assert any(limit.arm == "slave_2" for step in slow for limit in step.binding)
    assert off_way(task, program, steps) < 2e-4  # the rate changes within a step


def test_it_goes_to_another_branch_through_a_singularity() -> None:
    """The wrist turns over: joint 5 passes 0, where no tool path could be followed."""
    task = lift()
    x = own(task, task.q_start)
    arm = task.cell.arms[2]
    kinematics = ArmKinematics(arm)
    tool = pin.SE3(kinematics.tool_poses(x[None])[0])
    branches = find_branches(kinematics, tool, near=x[None])
    flipped = [q for q, inside in zip(branches.q, branches.inside, strict=True) if inside and q[4] * x[4] < 0.0]
    assert flipped
    other = min(flipped, key=lambda q: float(np.abs(q - x).max()))
    phases = [
        Phase("over", arms={"slave_2": FollowsJoints(JointPath([x, other], 4.0))}),
        Phase("attach", arms={"slave_2": Travels(to=task.grasp.T_object_tool[2], retreat_m=0.0)}, duration=0.5),
        Phase("lift", path=LinePath.displaced(task.path.start, translation=(0.0, 0.0, 0.05), duration=2.0)),
    ]
    program = Program(task.cell, task.grasp, phases)
    steps = run(started(task, program), most=3000)
    assert steps[-1].finished
    assert np.abs(own(task, steps[-1].q_next) - other).max() < 0.3
    assert own(task, steps[-1].q_next)[4] * x[4] < 0.0
    assert max(off(task, program, step, (0, 1, 2)) for step in steps if step.clock_next > 4.6) < 5e-7


def test_the_object_moves_meanwhile_and_goes_back() -> None:
    task = lift()
    program = out_and_back(task, rests=False)
    controller = started(task, program)
    steps = [controller.step() for _ in range(150)]
    controller.reverse(0.2)
    steps += [controller.step() for _ in range(400)]
    assert steps[-1].status is Status.PAUSED
    assert abs(steps[-1].clock_next - 0.2) < 1e-6
    assert off_way(task, program, steps) < 1e-5
    again = pickle.loads(pickle.dumps(controller))
    for one in (controller, again):
        one.forward()
        assert run(one)[-1].finished
    assert max(off(task, program, step, (0, 1)) for step in steps) < 5e-7


def test_an_arm_in_another_branch_than_its_way_holds() -> None:
    task = lift()
    x = own(task, task.q_start)
    kinematics = ArmKinematics(task.cell.arms[2])
    branches = find_branches(kinematics, pin.SE3(kinematics.tool_poses(x[None])[0]), near=x[None])
    other = max(branches.q[branches.inside], key=lambda q: float(np.abs(q - x).max()))
    go = FollowsJoints(JointPath([other, other + 0.05], 1.0))
    phases = [Phase("go", arms={"slave_2": go}), Phase("up", path=task.path, arms={"slave_2": Waits()})]
    program = Program(task.cell, task.grasp, phases)
    controller = started(task, program)
    step = controller.step()
    assert step.status is Status.HOLDING
    assert "arm slave_2 is not on the way of its joints" in step.explain()


def test_what_does_not_fit_is_refused_when_it_is_built() -> None:
    task = lift()
    x = own(task, task.q_start)

    def built(rows: Any) -> Program:
        phases = [Phase("go", arms={"slave_2": FollowsJoints(JointPath(rows, 1.0))}), Phase("up", path=task.path)]
        return Program(task.cell, task.grasp, phases)

    with pytest.raises(InvalidInputError, match=r"'go', arm 'slave_2'.*5 joints, and the arm has 6"):
        built([x[:5], x[:5] + 0.1])
    with pytest.raises(InvalidInputError, match="out of its limits"):
        built([x, x + 10.0])
    with pytest.raises(InvalidInputError, match=r"begins .* mm and .* from where its tool is"):
        built([x + 0.1, x])
    with pytest.raises(InvalidInputError, match="does not hold the object when the phase begins"):
        built([x, x + 0.1])
    with pytest.raises(InvalidInputError, match="FollowsJoints: path"):
        FollowsJoints([[0.0]])  # type: ignore[arg-type]


@pytest.mark.parametrize("preview", [True, False])
@pytest.mark.parametrize("case", ["rests", "moves", "fast", "samples", "back"])
@pytest.mark.core
def test_arms_follow_their_joints_as_recorded(case: str, preview: bool, golden: Golden) -> None:
    task = lift()
    program = out_and_back(task, rests=case != "moves", duration={"fast": 0.8}.get(case, 2.0))
    if case == "samples":
        x, at = own(task, task.q_start), np.linspace(0.0, 1.0, 9)
        way = JointPath.through(3.0 * at, x + np.sin(np.pi * at)[:, None] * ELSEWHERE)
        back = {"slave_2": Travels(to=task.grasp.T_object_tool[2], retreat_m=0.0)}
        phases = [Phase("go", arms={"slave_2": FollowsJoints(way)}), Phase("back", arms=back, duration=0.5)]
        program = Program(task.cell, task.grasp, [*phases, Phase("lift", path=task.path)])
    options: dict[str, Any] = {} if preview else {"preview": None}
    done = golden.of(started(task, program, **options))
    for i in range(1200):
        if case == "back" and i == 120:
            done.ask(lambda controller: controller.reverse(0.2))
        elif case == "back" and i == 400:
            done.ask(lambda controller: controller.forward())
        step = done.take()
        if step.finished or step.status is Status.HOLDING:
            break
    assert step.finished or not preview


def test_a_seven_joint_arm_follows_its_joints(golden: Golden) -> None:
    """All seven are led; the null-space of the others goes on."""
    task = limited_once(dual_arm7, 5.0)
    x = task.cell.positions(task.q_start)[task.cell.columns[1]]
    way = JointPath([x, x + 0.15, x], 1.0)
    start = task.path.pose(0.0)
    up = LinePath.displaced(start, translation=(0.0, 0.0, 0.03), duration=2.0)
    name = task.cell.arm_names[1]
    travels = Travels(to=task.grasp.T_object_tool[1], retreat_m=0.0)
    phases = [
        Phase("go", arms={name: FollowsJoints(way)}, path=HoldPath(start, duration=2.0)),
        Phase("back", arms={name: travels}, duration=0.5),
        Phase("up", path=up),
    ]
    program = Program(task.cell, task.grasp, phases)
    steps = golden.of(started(task, program)).run(2000).steps
    assert steps[-1].finished
    led = [task.cell.positions(step.q_next)[task.cell.columns[1]] for step in steps if step.clock_next < 2.0]
    off = [np.abs(x - way.at(step.clock_next)[0]).max() for x, step in zip(led, steps, strict=False)]
    assert max(off) < 1e-6


def test_a_check_proves_it_phase_by_phase_and_names_what_does_not_fit() -> None:
    task = lift()
    check = check_path(task.cell, task.grasp, out_and_back(task), q_start=task.q_start)
    assert check.verdict.value == "CERTIFIED", check.explain()
    assert [phase.verdict.value for phase in check.phases if phase.verdict] == ["CERTIFIED"] * 3
    up = LinePath.displaced(task.path.start, translation=(0.0, 0.0, 0.1), duration=1.0)
    x = own(task, task.q_start)
    at = inverse_kinematics(task.cell, task.grasp, up.goal, task.q_start)
    kinematics = ArmKinematics(task.cell.arms[2])
    tool = pin.SE3(kinematics.tool_poses(own(task, at)[None])[0])
    branches = find_branches(kinematics, tool, near=x[None])
    other = max(branches.q[branches.inside], key=lambda q: float(np.abs(q - x).max()))
    for begins, verdict in ((own(task, at), "CERTIFIED"), (other, "INFEASIBLE")):
        go = {"slave_2": FollowsJoints(JointPath([begins, begins + 0.03], 1.0))}
        program = Program(task.cell, task.grasp, [Phase("up", path=up), Phase("go", arms=go)])
        check = check_path(task.cell, task.grasp, program, q_start=task.q_start)
        assert check.verdict.value == verdict, check.explain()
        step = run(started(task, program), most=400)[-1]
        assert step.finished is (verdict == "CERTIFIED")
        if verdict == "INFEASIBLE":
            assert "comes to the way of its joints with" in check.explain()
            (phase,) = (phase for phase in check.phases if phase.why)
            assert (phase.name, phase.arm) == ("go", "slave_2")
            assert step.status is Status.BLOCKED
            assert "slave_2" in step.explain()


def test_what_cannot_know_it_says_so() -> None:
    task = lift()
    program = out_and_back(task)
    for ask in (
        lambda: check_path(task.cell, task.grasp, program),
        lambda: find_start(task.cell, task.grasp, program),
    ):
        with pytest.raises(InvalidInputError, match="follows a way of its joints"):
            ask()


def test_speeds_of_a_way_are_kept_and_what_lies_beyond_its_rows_is_known() -> None:
    clocks, rows = [0.0, 0.5, 2.0], np.array([[0.0, 1.0], [1.0, -1.0], [2.0, -1.5]])
    speeds = np.array([[0.0, 0.0], [1.0, -0.4], [0.0, 0.0]])
    way = JointPath.through(clocks, rows, speeds)
    assert np.array_equal(way.at(0.5)[1], speeds[1])
    moved = way.begun(rows[0] + 1e-4)
    assert np.array_equal(moved.at(0.5)[1], speeds[1])
    assert np.allclose(moved.at(0.0)[0], rows[0] + 1e-4)
    fast = JointPath.through(clocks, rows, 20.0 * speeds)
    seen = np.array([fast.at(clock)[0] for clock in np.linspace(0.0, 2.0, 20_001).tolist()])
    assert np.allclose(fast.farthest.min(axis=0), seen.min(axis=0), atol=1e-6)
    assert np.allclose(fast.farthest.max(axis=0), seen.max(axis=0), atol=1e-6)
    assert seen[:, 0].max() > 2.1
    for wrong, why in ((speeds[:2], "shape"), (np.nan * speeds, "not finite")):
        with pytest.raises(InvalidInputError, match=why):
            JointPath.through(clocks, rows, wrong)


@pytest.mark.parametrize("samples", [False, True])
@pytest.mark.parametrize("rests", [False, True])
def test_a_plan_times_it_with_all_others(rests: bool, samples: bool) -> None:
    """Slow ways become as fast as the limits allow, rest at the same rows, and are proved and followed."""
    pytest.importorskip("toppra")
    task = lift()
    x = own(task, task.q_start)
    if samples:
        at = np.linspace(0.0, 1.0, 9)
        rows = x + np.sin(np.pi * at)[:, None] * ELSEWHERE
        way = JointPath.through(6.0 * at, rows)
    else:
        way = JointPath([x, x + ELSEWHERE, x], 3.0)
    start, goal = task.path.start, task.path.goal
    back = {"slave_2": Travels(to=task.grasp.T_object_tool[2], retreat_m=0.0)}
    phases = [
        Phase("go", arms={"slave_2": FollowsJoints(way)}),
        Phase("back", arms=back, duration=0.5),
        Phase("lift", path=LinePath(start, goal, duration=9.0)),
    ]
    if not rests:  # it goes on while the object moves: over one time law, or refused
        over = LinePath.displaced(start, translation=(0.0, 0.0, 0.05), duration=way.duration)
        phases[0] = Phase("go", arms={"slave_2": FollowsJoints(way)}, path=over)
        phases[2] = Phase("lift", path=LinePath(over.goal, goal, duration=9.0))
    program = Program(task.cell, task.grasp, phases)
    if not rests and not samples:
        with pytest.raises(InvalidInputError, match=r"phase 'go'.*Cut it in phases"):
            time_program(task.cell, task.grasp, program, q_start=task.q_start, knots=60)
        return
    planned = time_program(task.cell, task.grasp, program, q_start=task.q_start, knots=60)
    assert planned.duration < 0.5 * program.duration
    ways = [phase.arms["slave_2"].path for phase in planned.phases if "go" in phase.name]
    assert np.allclose(ways[0].rows[0], x, atol=1e-6)
    assert np.allclose(ways[-1].rows[-1], x, atol=1e-6)
    if not samples:
        assert np.allclose(ways[0].rows[-1], x + ELSEWHERE, atol=1e-9)
    check = check_path(task.cell, task.grasp, planned, q_start=task.q_start)
    assert check.verdict.value == "CERTIFIED", check.explain()
    steps = run(started(task, planned))
    assert steps[-1].finished
    assert len(steps) * DT < 1.1 * planned.duration + 0.1
    limit = task.cell.limits
    bend = np.diff([step.velocity for step in steps], axis=0) / DT
    assert (np.abs(bend) <= limit.acceleration + 1e-6).all()
    led = np.array([own(task, step.q_next) for step in steps if step.clock_next < planned.spans[-2].start])
    assert np.abs(led - x).max() > 0.9 * np.abs(ELSEWHERE).max()


def test_a_plan_names_a_way_that_begins_in_another_branch() -> None:
    pytest.importorskip("toppra")
    task = lift()
    x = own(task, task.q_start)
    kinematics = ArmKinematics(task.cell.arms[2])
    branches = find_branches(kinematics, pin.SE3(kinematics.tool_poses(x[None])[0]), near=x[None])
    other = max(branches.q[branches.inside], key=lambda q: float(np.abs(q - x).max()))
    go = {"slave_2": FollowsJoints(JointPath([other, other + 0.03], 1.0))}
    program = Program(
        task.cell, task.grasp, [Phase("go", arms=go), Phase("up", path=task.path, arms={"slave_2": Waits()})]
    )
    with pytest.raises(UnreachableError, match="'slave_2' does not come to the way of its joints in phase 'go'"):
        time_program(task.cell, task.grasp, program, q_start=task.q_start, knots=60)
