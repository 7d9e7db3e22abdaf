"""Row I6: it does not matter where the world's origin is, nor how far the arms stand from each other."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ControlStep, Grasp, LinePath, QPController, QPOptions, RobotCell
from coopqp.scenarios import Scenario, at_limit, at_singularity, dual_arm7, mixed_cell, paper_lift

DT = 0.005
STEPS = 300


def line_of(task: Scenario) -> LinePath:
    assert isinstance(task.path, LinePath)
    return task.path


def elsewhere(task: Scenario, T: pin.SE3) -> Scenario:
    """The same cell and task at another place."""
    line = line_of(task)
    cell = RobotCell(arm.placed(T * arm.T_world_base) for arm in task.cell.arms)
    path = LinePath(T * line.start, T * line.goal, duration=line.duration, time_law=line.time_law)
    return dataclasses.replace(task, cell=cell, path=path)


def apart(task: Scenario, distance: float) -> Scenario:
    """The same arms along a longer object: each stands further from its middle, and does what it did."""
    T, line = task.path.pose(0.0), line_of(task)
    tools, arms = [], []
    middle = np.mean([X.translation for X in task.grasp.T_object_tool], axis=0)
    for X, arm in zip(task.grasp.T_object_tool, task.cell.arms, strict=True):
        out = X.translation - middle
        way = distance * out / np.linalg.norm(out)
        tools.append(pin.SE3(X.rotation, X.translation + way))
        shift = pin.SE3(np.eye(3), T.rotation @ way)
        arms.append(arm.placed(shift * arm.T_world_base))
    goal = pin.SE3(line.start.rotation, line.goal.translation)  # turned, far grasps would move far
    path = LinePath(line.start, goal, duration=line.duration, time_law=line.time_law)
    return dataclasses.replace(task, cell=RobotCell(arms), grasp=Grasp(tuple(tools)), path=path)


def run(task: Scenario, noise: float = 0.0, override: bool = False, **options: Any) -> list[ControlStep]:
    made = QPOptions(**options)
    controller = QPController(task.cell, task.grasp, task.path, dt=DT, options=made)
    controller.reset(task.q_start)
    rng, q, steps = np.random.default_rng(1), None, []
    for i in range(STEPS):
        if override and i % 10 == 0:
            controller.set_override(float(rng.choice([0.0, 0.3, 0.6, 1.0])))
        steps.append(controller.step(q))
        if noise:
            q = task.cell.moved(steps[-1].q_next, rng.uniform(-noise, noise, task.cell.nv))
    return steps


def compare(a: list[ControlStep], b: list[ControlStep]) -> tuple[float, int]:
    """Largest difference of joint velocities [rad/s or m/s], and how many steps say something else."""
    v, w = (np.array([step.velocity for step in steps]) for steps in (a, b))
    off = float(np.abs(v - w).max())
    return off, sum((x.status, x.binding) != (y.status, y.binding) for x, y in zip(a, b, strict=True))


def moving(first: list[ControlStep], steps: list[ControlStep]) -> list[ControlStep]:
    """The steps at which the first run's object moves: at rest a correction of 1e-9 rad/s may come a step later."""
    return [step for one, step in zip(first, steps, strict=True) if one.rate > 1e-9]


@pytest.mark.slow
def test_the_worlds_origin_is_somewhere_else(catalogue: Any, count: Any) -> None:
    rng = np.random.default_rng(0)
    makes = (
        paper_lift, dual_arm7, mixed_cell, lambda: at_limit(direction=(0.1, 0.05, 1.0)),
        lambda: at_singularity("elbow"), lambda: at_singularity(miss=0.1),
    )  # fmt: skip
    largest = {10.0: 0.0, 1e3: 0.0, 1e4: 0.0}
    other, cases, close = 0, 0, 0.0
    for make in makes:
        for acceleration in (np.inf, 10.0):
            task = make()
            task = dataclasses.replace(task, cell=task.cell.with_limits(acceleration=acceleration))
            for how in ({}, {"noise": 1e-4}, {"shortcut": False}, {"override": True}):
                here = run(task, **how)
                for distance in largest:
                    for _ in range(count(1)):
                        way = rng.standard_normal(3)
                        turn = pin.exp3(rng.uniform(-2.0, 2.0, 3))
                        T = pin.SE3(turn, distance * way / np.linalg.norm(way))
                        there = run(elsewhere(task, T), **how)
                        off, differ = compare(here, there)
                        largest[distance] = max(largest[distance], off)
                        if distance == 10.0:
                            close = max(close, compare(moving(here, here), moving(here, there))[0])
                        other, cases = other + differ, cases + STEPS
    name = "the world's origin 10 m to 10 km away"
    note = ", ".join(f"{off:.1e} at {distance:g} m" for distance, off in largest.items())
    what = f"{name}: other joint velocities"
    catalogue.row("I6", what, cases=cases, measured=max(largest.values()), target=1e-6, unit="rad/s", note=note)
    assert close < 1e-9
    assert largest[10.0] < 1e-8
    catalogue.row("I6", f"{name}: another status, or another cause", cases=cases, measured=other, target=0)


def test_the_arms_are_far_from_each_other(catalogue: Any) -> None:
    worst, other, cases, parted = 0.0, 0, 0, 0.0
    for make in (paper_lift, dual_arm7, mixed_cell):
        near = apart(make(), 0.0)
        for options in ({}, {"shortcut": False}):
            here = run(near, **options)
            for distance in (10.0, 100.0, 1000.0):
                task = apart(near, distance)
                there = run(task, **options)
                off, differ = compare(here, there)
                worst, other, cases = max(worst, off), other + differ, cases + STEPS
                points = [X.translation for X in task.grasp.T_object_tool]
                for step in there[::20]:
                    O = task.grasp.carried(step.state)
                    at = np.array([[T.act(p) for p in points] for T in O])
                    parted = max(parted, float(np.linalg.norm(at - at[0], axis=2).max()))
    name = "arms 10 m to 1 km from each other"
    note = f"at the grasps they part by {1e3 * parted:.1e} mm"
    what = f"{name}: other joint velocities"
    catalogue.row("I6", what, cases=cases, measured=worst, target=5e-9, unit="rad/s", note=note)
    catalogue.row("I6", f"{name}: another status, or another cause", cases=cases, measured=other, target=0)
