"""Braking together ahead of position limits, where nothing ahead of the object is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_but_first
from user_paths import Opaque

from coopqp import LimitKind, QPController, QPOptions, Status
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.native import available_kernels
from coopqp.scenarios import Scenario, at_limit

H = 0.002


def test_joints_that_brake_as_they_are_told_stop_inside_their_limits(paper: Scenario, rng: np.random.Generator) -> None:
    """They go on at one velocity and, once told, keep the share: none passes its limit or its acceleration."""
    cell = paper.cell.with_limits(acceleration=rng.uniform(2.0, 20.0, paper.cell.nv))
    box, limits = VelocityBox(cell), cell.limits
    stopped = 0
    for _ in range(12):
        x = rng.uniform(limits.lower, limits.upper)
        v = rng.uniform(-1.0, 1.0, cell.nv) * rng.uniform(0.1, 2.0)
        while (first := box.brake_share(x, v, H))[0] < 1.0:
            x = 0.5 * (x + 0.5 * (limits.lower + limits.upper))  # it begins where there is room
        assert first == (1.0, -1)
        for _ in range(3000):
            keep, joint = box.brake_share(x, v, H)
            assert 0.0 <= keep <= 1.0
            assert (joint >= 0) == (keep < 1.0)
            assert ((1.0 - keep) * np.abs(v) <= limits.acceleration * H * (1.0 + 1e-9)).all()
            v = keep * v
            x = x + H * v
            assert (x >= limits.lower).all()
            assert (x <= limits.upper).all()
            if not v.any():
                stopped += 1
                break
    assert stopped > 8
    assert box.brake_share(x, np.zeros(cell.nv), H) == (1.0, -1)


def test_the_joint_that_needs_the_braking_is_named(paper: Scenario) -> None:
    cell = paper.cell.with_limits(acceleration=5.0)
    box, limits = VelocityBox(cell), cell.limits
    middle = 0.5 * (limits.lower + limits.upper)
    for j, side in ((0, 1.0), (7, -1.0), (17, 1.0)):
        v = np.zeros(cell.nv)
        v[j], v[3] = side, 0.1
        stops = 0.5 / 5.0 / 0.8 + H  # way of speed 1 with 0.8 of the acceleration, after one more step
        for away, late in ((1.01 * stops, False), (0.99 * stops, True)):
            x = middle.copy()
            x[j] = limits.upper[j] - away if side > 0.0 else limits.lower[j] + away
            keep, joint = box.brake_share(x, v, H)
            assert (keep < 1.0) == late
            assert joint == (j if late else -1)


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
@pytest.mark.parametrize("known", [True, False])
def test_without_a_view_ahead_the_object_stops_on_its_path_at_a_limit(kernel: str, known: bool) -> None:
    """No preview, or a path that is not known ahead: all arms brake together before the joint is at its limit.

    That joint could stop at once; the others, which hold the same object, are slower to stop.
    """
    task = at_limit(acceleration=2.0)
    joint = task.cell.joint_names.index("master/joint_2")
    acceleration = np.where(np.arange(task.cell.nv) == joint, 40.0, 2.0)
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    options = QPOptions(kernel=kernel, preview=None) if known else QPOptions(kernel=kernel)
    path = task.path if known else Opaque(task.path, known_ahead=False)
    controller = QPController(task.cell, task.grasp, path, dt=task.dt, options=options)
    controller.reset(task.q_start)
    limits, v, named, rates = task.cell.limits, np.zeros(task.cell.nv), set(), []
    for _ in range(round(2.0 * task.path.duration / task.dt)):
        step = controller.step()
        assert (np.abs(step.velocity - v) <= limits.acceleration * task.dt * (1.0 + 1e-9)).all()
        v = step.velocity
        rates.append(step.rate)
        assert not any(step.given_up.off_path)
        assert np.abs(task.grasp.relative_errors(step.state)).max() < 1e-6
        named |= {(b.kind, b.arm, b.joint) for b in step.binding}
        if step.status is Status.BLOCKED:
            break
    assert step.status is Status.BLOCKED
    assert (LimitKind.POSITION, "master", "joint_2") in named
    x = task.cell.positions(step.q_next)
    assert np.minimum(x - limits.lower, limits.upper - x).min() > -1e-9
    assert np.minimum(x - limits.lower, limits.upper - x).min() < 0.02
    assert max(rates) > 0.5


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
@pytest.mark.parametrize("seeing", [True, False])
def test_an_override_is_reached_on_the_path_as_fast_as_the_joints_can(kernel: str, seeing: bool) -> None:
    """Up, down and up again: the rate moves one way, and some joint brakes with half its acceleration or more."""
    task = at_limit(margin=2.0, speed=0.6)
    options = QPOptions(kernel=kernel) if seeing else QPOptions(kernel=kernel, preview=None)
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)
    controller.reset(task.q_start)
    v, hardest = np.zeros(task.cell.nv), 0.0
    for share, steps in ((1.0, 150), (0.3, 100), (0.8, 100)):
        controller.set_override(share)
        rates = []
        for _ in range(steps):
            step = controller.step()
            use = np.abs(step.velocity - v) / (task.cell.limits.acceleration * task.dt)
            assert use.max() < 1.0 + 1e-9
            hardest = max(hardest, use.max()) if share == 0.3 else hardest
            assert not any(step.given_up.off_path)
            assert np.abs(task.grasp.relative_errors(step.state)).max() < 1e-6
            v = step.velocity
            rates.append(step.rate)
        change = np.diff(rates)
        assert (change <= 1e-9).all() if share == 0.3 else (change >= -1e-9).all()
        assert rates[-1] == pytest.approx(share, abs=1e-9)
    assert hardest > 0.5
