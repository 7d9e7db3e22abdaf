"""An object that is turned far off its path: the arms stay together, whatever the angle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first

from coopqp import Grasp, LinePath, QPController, QPOptions, RobotCell, Status
from coopqp.control.step.views import errors_after, view_errors, ways_between
from coopqp.model import CellState
from coopqp.native import available_kernels
from coopqp.scenarios import Scenario, dual_arm7, ring
from coopqp.spatial import Array

#: Turns off the path [rad]: at the second one the logarithm's slope is 1 off, and further on more.
TURNS = (1.1, 1.9, 2.6, 3.1)


def random_twists(rng: np.random.Generator, size: float) -> Array:
    return size * rng.normal(size=(3, 6))


@pytest.mark.parametrize("turn", TURNS)
def test_ways_lead_errors_to_where_they_lead_the_views(turn: float, rng: np.random.Generator) -> None:
    """By exponentials of Pinocchio alone, in the axes of the reference and about its origin."""
    for _ in range(10):
        axis = rng.normal(size=3)
        R = pin.exp6(rng.normal(size=6))
        first = pin.SE3(pin.exp3(turn * axis / np.linalg.norm(axis)), rng.normal(size=3))
        E = [pin.exp6(d) * first for d in random_twists(rng, 1e-5)]
        errors = view_errors([R * X for X in E], R, R * E[0])
        np.testing.assert_allclose(errors[0], pin.log6(E[0]).vector, atol=1e-12)
        for k, X in enumerate(E):
            np.testing.assert_allclose(errors[k] - errors[0], pin.log6(X * E[0].inverse()).vector, atol=1e-12)
        ways = rng.normal(size=6) * 1e-2 + random_twists(rng, 1e-5)
        moved = [pin.exp6(w) * X for w, X in zip(ways, E, strict=True)]
        later = view_errors([R * X for X in moved], R, R * moved[0])
        np.testing.assert_allclose(errors_after(errors, ways), later, atol=3e-6)  # the ways' length times the errors'
        np.testing.assert_allclose(ways_between(errors, later), ways, atol=3e-6)
        np.testing.assert_allclose(ways_between(errors, errors_after(errors, ways)), ways, atol=1e-12)


def test_ways_go_on_across_half_a_turn() -> None:
    """There the logarithm jumps from one side to the other."""
    errors = np.tile([0.1, 0.2, 0.3, 0.0, 0.0, np.pi - 1e-3], (2, 1))
    ways = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, turn] for turn in (2e-3, 2.001e-3)])
    later = errors_after(errors, ways)
    assert (later[:, 5] < -3.0).all()
    np.testing.assert_allclose(ways_between(errors, later), ways, atol=1e-12)
    np.testing.assert_allclose(later[1] - later[0], ways[1] - ways[0], atol=1e-12)


def apart(cell: RobotCell, grasp: Grasp, q: Array) -> float:
    """Largest distance between the object's origins as the arms carry it [m], by Pinocchio."""
    tools = zip(CellState(cell, q).T_world_tool, grasp.T_object_tool, strict=True)
    origins = np.array([(T * X.inverse()).translation for T, X in tools])
    return float(np.linalg.norm(origins - origins[0], axis=1).max())


def turned(object_pose: pin.SE3, path: LinePath) -> float:
    """How far it is turned off the path's start [rad]."""
    return float(np.linalg.norm(pin.log3(path.pose(0.0).rotation.T @ object_pose.rotation)))


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
@pytest.mark.parametrize("acceleration", [5.0, np.inf])
@pytest.mark.parametrize("make", [partial(ring, arms=2), dual_arm7])
@pytest.mark.parametrize("turn", TURNS)
def test_the_arms_stay_together_on_their_way_to_a_path_that_is_turned_far_away(
    kernel: str, acceleration: float, make: Callable[[], Scenario], turn: float
) -> None:
    task = make()
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    start, dt = task.path.pose(0.0), 0.004
    there = pin.SE3(start.rotation @ pin.exp3(np.array([0.0, 0.0, turn])), start.translation)
    path = LinePath.displaced(there, translation=(0.02, 0.0, 0.0), duration=5.0)
    controller = QPController(task.cell, task.grasp, task.path, dt=dt, options=QPOptions(kernel=kernel))
    controller.reset(task.q_start)
    controller.follow(path)
    steps = [controller.step() for _ in range(200)]
    assert {step.status for step in steps} == {Status.OFF_PATH}
    assert max(apart(task.cell, task.grasp, step.q_next) for step in steps) < 1e-6
    assert max(step.commanded_apart for step in steps) < 1e-6
    after = CellState(task.cell, steps[-1].q_next).T_world_tool[0] * task.grasp.T_object_tool[0].inverse()
    assert turned(start, path) - turned(after, path) > 0.2
