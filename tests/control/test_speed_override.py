"""The reins: override, pause and resume at any step, on the path, within the limits."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import built, drive, fast_lift, hurried, limited

from coopqp import (
    BindingLimit,
    ControlStep,
    InvalidInputError,
    LimitKind,
    LinePath,
    QPController,
    ServoPath,
    Status,
    WaypointPath,
)
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift, ring
from coopqp.simulation.evaluation import metrics

DT = 0.002
#: Largest error of chain and path, from the commanded configuration [m].
EXACT = 0.5e-6
#: What a step calls the override.
OVERRIDE = BindingLimit("", "", LimitKind.OVERRIDE)
#: What an operator does at a step.
Hand = Callable[[QPController, int], None]


def random_hand(seed: int) -> Hand:
    """A new override at every step, and now and then a pause for a while."""
    rng = np.random.default_rng(seed)

    def act(controller: QPController, i: int) -> None:
        controller.set_override(float(rng.uniform()) if rng.uniform() < 0.9 else 0.0)
        if i % 120 == 60:
            controller.pause()
        if i % 120 == 100:
            controller.resume()

    return act


def errors_of(task: Scenario, steps: list[ControlStep]) -> tuple[float, float]:
    """Largest distances between arms, and between any arm's object and the path, as commanded [m]."""
    tools = metrics.tool_matrices(task.cell, np.array([s.q for s in steps]))
    references = np.array([s.path.pose(s.clock).homogeneous for s in steps])
    chain, _ = metrics.chain_errors(tools, task.grasp)
    path, _ = metrics.errors_from(metrics.object_poses(tools, task.grasp), references)
    return float(chain.max()), float(path.max())


def excess_of(task: Scenario, steps: list[ControlStep]) -> float:
    """Largest share of an acceleration limit, less 1."""
    v = np.array([np.zeros(task.cell.nv), *(s.velocity for s in steps)])
    dt = np.array([s.dt for s in steps])[:, None]
    return float((np.abs(np.diff(v, axis=0)) / dt / task.cell.limits.acceleration).max()) - 1.0


CELLS: dict[str, Callable[[], Scenario]] = {
    "paper": fast_lift,
    "mixed": mixed_cell,
    "two of seven joints": dual_arm7,
}


@pytest.mark.core
@pytest.mark.parametrize("name", CELLS)
def test_a_random_override_keeps_chain_path_and_limits(name: str) -> None:
    task = limited(CELLS[name](), 5.0)
    steps = drive(built(task, dt=DT), 400, before=random_hand(0))
    chain, path = errors_of(task, steps)
    assert chain < EXACT
    assert path < EXACT
    assert excess_of(task, steps) < 1e-6
    assert {s.status for s in steps} >= {Status.PAUSED, Status.SLOWED}
    assert {s.status for s in steps} <= {Status.PAUSED, Status.SLOWED, Status.TRACKING}


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["rx90l", "arm7"])
@pytest.mark.parametrize("arms", [2, 4, 8])
def test_a_random_override_keeps_chain_path_and_limits_of_many_arms(arms: int, robot: Any) -> None:
    task = limited(hurried(ring(arms=arms, robot=robot), 0.4), 5.0)
    for seed in range(2):
        steps = drive(built(task, dt=DT), 2000 // arms, before=random_hand(seed))
        chain, path = errors_of(task, steps)
        assert chain < EXACT
        assert path < EXACT
        assert excess_of(task, steps) < 1e-6


@pytest.mark.slow
def test_corners_are_passed_under_any_override() -> None:
    """Where the twist jumps the joints have nothing left to brake with."""
    task = limited(paper_lift(), 5.0)
    T = [task.path.pose(s * task.path.duration) for s in (0.0, 0.3, 0.1, 0.5)]
    task = dataclasses.replace(task, path=WaypointPath(T, durations=[0.6, 0.6, 0.9], time_law="linear"))
    for seed in range(3):
        steps = drive(built(task, dt=DT), 9000, before=random_hand(seed))
        chain, path = errors_of(task, steps)
        assert steps[-1].finished
        assert excess_of(task, steps) < 1e-6
        assert chain < EXACT
        assert path < 2e-6


@pytest.mark.slow
def test_a_stop_takes_hardly_longer_than_the_hardest_one() -> None:
    """The hardest stop brakes one joint with all it has, all the way along the path."""
    for when in (45, 120, 250):
        task = limited(fast_lift(), 5.0)
        controller = built(task, dt=DT)
        for _ in range(when):
            step = controller.step()
        hardest, count = braking_time(task, step), 0
        controller.pause()
        while step.status is not Status.PAUSED:
            step, count = controller.step(), count + 1
        assert 2e-3 * (count - 1) <= 1.1 * hardest


def braking_time(task: Scenario, step: ControlStep) -> float:
    """Of an object that stops along its path as fast as the accelerations allow, from a step on [s].

    q(τ) by inverse kinematics is q′ and q″ by differences; σ̇ is the least that keeps every joint's limit.
    """
    from coopqp import inverse_kinematics

    clock, rate, time, h, dt = step.clock_next, step.rate, 0.0, 1e-4, 1e-3
    cell, q = task.cell, step.q_next
    while rate > 0.0:
        there = [inverse_kinematics(cell, task.grasp, task.path.pose(clock + s * h), q) for s in (-1.0, 0.0, 1.0)]
        x = [cell.positions(p) for p in there]
        q, slope, bend = there[1], (x[2] - x[0]) / (2 * h), (x[2] - 2 * x[1] + x[0]) / h**2
        moves = np.abs(slope) > 1e-9
        fall = (cell.limits.acceleration + bend * np.sign(slope) * rate**2)[moves] / np.abs(slope[moves])
        rate_next = rate - float(fall.min()) * dt
        clock += 0.5 * (rate + max(rate_next, 0.0)) * dt
        time += dt if rate_next > 0.0 else dt * rate / (rate - rate_next)
        rate = rate_next
    return time


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("name", CELLS)
def test_any_override_as_recorded(name: str, acceleration: float, golden: Golden) -> None:
    task = limited(CELLS[name](), acceleration)
    for options in ({}, {"preview": None}):
        done, hand = golden.of(built(task, dt=0.005, **options), 1e-8), random_hand(3)
        for i in range(150):
            if i % 10 == 0 or i % 120 in (60, 100):
                hand(done.controller, i)
            done.take()


@pytest.mark.core
@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))])
def test_a_copy_keeps_the_reins(way: Callable[[QPController], QPController]) -> None:
    task = limited(dual_arm7(), 5.0)
    controller = built(task, dt=DT)
    controller.set_override(0.6)
    drive(controller, 60)
    controller.pause()
    drive(controller, 20)  # it brakes
    other = way(controller)
    assert (other.override, other.paused) == (0.6, True)
    for i in range(120):
        if i == 60:
            controller.resume(), other.resume()
        a, b = controller.step(), other.step()
        assert np.array_equal(a.velocity, b.velocity)
        assert (a.rate, a.status) == (b.rate, b.status)


def test_the_reins_hold_before_and_after_a_reset_and_a_new_path() -> None:
    for acceleration in (np.inf, 5.0):
        task = limited(paper_lift(), acceleration)
        controller = QPController(task.cell, task.grasp, task.path, dt=0.002)
        controller.pause()
        controller.set_override(0.5)
        for bad in (np.nan, -0.1, 1.5, "x"):
            with pytest.raises(InvalidInputError):
                controller.set_override(bad)
            with pytest.raises(InvalidInputError):
                controller.lower_rate(bad)
        assert copy.copy(controller).paused
        controller.reset(task.q_start)
        assert {controller.step().status for _ in range(20)} == {Status.PAUSED}
        controller.follow(task.path)
        assert {controller.step().status for _ in range(20)} == {Status.PAUSED}
        controller.reset(task.q_start)
        assert controller.step().status is Status.PAUSED
        controller.resume()
        steps = drive(controller, 100)
        assert steps[-1].rate == 0.5
        assert steps[-1].binding == (OVERRIDE,)
        assert "override" in steps[-1].explain()


def test_a_pause_stops_the_null_space_too_and_ends_smoothly() -> None:
    task = limited(dual_arm7(), 5.0)
    for options in ({}, {"preview": None}):
        controller = built(task, dt=DT, **options)
        steps = drive(controller, 300)
        controller.pause()
        steps += drive(controller, 300)
        assert steps[-1].status is Status.PAUSED
        assert float(np.abs(steps[-1].velocity).max()) < 1e-9
        controller.resume()
        steps += drive(controller, 300)
        assert steps[-1].status is Status.TRACKING
        assert excess_of(task, steps) < 1e-6


def test_a_servo_target_can_be_paused() -> None:
    """Nothing is known ahead: joints brake together from their present speed."""
    for acceleration in (np.inf, 5.0):
        task = limited(paper_lift(), acceleration)
        start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
        task = dataclasses.replace(task, path=ServoPath(start, speed=0.1))
        controller = built(task, dt=DT)
        controller.retarget(goal)
        steps = drive(controller, 200)
        controller.pause()
        steps += drive(controller, 300)
        assert steps[-1].status is Status.PAUSED
        assert float(np.abs(steps[-1].velocity).max()) < 1e-6
        stopped = steps[-1].clock
        controller.resume()
        steps = drive(controller, 300)
        assert steps[-1].status is Status.TRACKING
        assert steps[-1].clock > stopped


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("make", [paper_lift, dual_arm7])
def test_a_target_is_reached_without_a_jump(make: Callable[[], Scenario], acceleration: float) -> None:
    """From rest to rest: no joint changes its speed by more than an eighth of it in a step, or than its limit."""
    task = limited(make(), acceleration)
    start = task.path.pose(0.0)
    task = dataclasses.replace(task, path=ServoPath(start))
    controller = built(task, dt=DT)
    goal = start * pin.exp6(pin.Motion(np.array([0.02, 0.03, 0.04, 0.0, 0.0, 0.1])))
    controller.retarget(goal)
    steps = drive(controller, 400)
    velocities = np.array([np.zeros(task.cell.nv), *(step.velocity for step in steps)])
    limits, changes = task.cell.limits, np.abs(np.diff(velocities, axis=0))
    allowed = limits.velocity / 8.0 if np.isinf(acceleration) else limits.acceleration * controller.dt
    assert (changes <= allowed * (1.0 + 1e-9)).all()
    assert np.abs(pin.log6(controller.path.pose(steps[-1].clock_next).actInv(goal)).vector).max() < 1e-9
    assert steps[-1].rate == 1.0


@pytest.mark.parametrize("bad", [-0.1, 1.1, np.nan, np.inf, "half", None, [0.5]])
def test_a_bad_share_is_a_named_error_and_changes_nothing(bad: Any) -> None:
    controller = built(paper_lift(), dt=DT)
    controller.set_override(0.7)
    with pytest.raises(InvalidInputError, match="set_override"):
        controller.set_override(bad)
    assert controller.override == 0.7


@pytest.mark.core
def test_an_object_that_still_moves_is_not_said_to_be_paused() -> None:
    """Another path is followed right after a pause in motion: the clock stands, and the object brakes off the path."""
    task = paper_lift(duration=1.0, time_law="quintic")
    cell = task.cell.with_limits(acceleration=5.0)
    arm = cell.arms[0]
    data, frame = arm.model.createData(), arm.model.getFrameId(arm.tool_frame)

    def object_at(q: np.ndarray) -> Any:
        pin.framesForwardKinematics(arm.model, data, q[: arm.model.nq])
        return (arm.T_world_base * data.oMf[frame] * task.grasp.T_object_tool[0].inverse()).translation

    for steps_between in (0, 3):
        controller = QPController(cell, task.grasp, task.path, dt=0.002)
        controller.reset(task.q_start)
        for _ in range(250):
            step = controller.step()
        controller.pause()
        for _ in range(steps_between):
            step = controller.step()
        here = task.path.pose(step.clock_next)
        controller.follow(LinePath.displaced(here, translation=(0.1, 0.0, 0.0), duration=1.0))
        seen = []
        for _ in range(200):
            step = controller.step()
            seen.append(step.status)
            speed = np.linalg.norm(object_at(step.q_next) - object_at(step.q)) / step.dt
            assert step.status is not Status.PAUSED or speed < 2e-3
            assert step.status is not Status.SLOWED or step.binding
        assert seen[-1] in (Status.PAUSED, Status.OFF_PATH)
