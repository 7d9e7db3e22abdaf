"""Braking together ahead of position limits, where nothing ahead of the object is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from user_paths import Opaque

from coopqp import LimitKind, QPController, QPOptions, Status
from coopqp.scenarios import at_limit


@pytest.mark.parametrize("known", [True, False])
def test_without_a_view_ahead_the_object_stops_on_its_path_at_a_limit(known: bool) -> None:
    """No preview, or a path that is not known ahead: all arms brake together before the joint is at its limit.

    That joint could stop at once; the others, which hold the same object, are slower to stop.
    """
    task = at_limit(acceleration=2.0)
    joint = task.cell.joint_names.index("master/joint_2")
    acceleration = np.where(np.arange(task.cell.nv) == joint, 40.0, 2.0)
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    options = QPOptions(preview=None) if known else QPOptions()
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


@pytest.mark.parametrize("seeing", [True, False])
def test_an_override_is_reached_on_the_path_as_fast_as_the_joints_can(seeing: bool) -> None:
    """Up, down and up again: the rate moves one way, and some joint brakes with half its acceleration or more."""
    task = at_limit(margin=2.0, speed=0.6)
    options = QPOptions() if seeing else QPOptions(preview=None)
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
