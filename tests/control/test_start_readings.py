"""A start from several readings at rest, and from what the robots hold."""

from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ForceController, InvalidInputError, QPController, simulate
from coopqp.errors import StiffnessWarning
from coopqp.scenarios import paper_lift, scara_pair, torso_lift
from coopqp.simulation import Disturbances, DisturbedPlant

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")


@pytest.mark.parametrize("make", [paper_lift, scara_pair])
def test_a_start_takes_the_mean_of_readings(make: object) -> None:
    task = make()  # type: ignore[operator]
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    noise = np.random.default_rng(3).normal(scale=1e-5, size=(50, task.cell.nv))
    readings = [pin.integrate(task.cell.model, task.q_start, row) for row in noise]
    controller.reset(np.array(readings))
    mean = pin.integrate(task.cell.model, task.q_start, noise.mean(axis=0))
    np.testing.assert_allclose(controller.step().q, mean, atol=1e-12)
    controller.reset(readings)
    np.testing.assert_allclose(controller.step().q, mean, atol=1e-12)


@pytest.mark.parametrize(
    "readings", [np.zeros((0, 18)), np.zeros((1, 18)), np.zeros((3, 17)), [[0.0] * 18, [0.0] * 17]]
)
def test_bad_readings_are_refused(readings: object) -> None:
    task = paper_lift()
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    with pytest.raises(InvalidInputError):
        controller.reset(readings)  # type: ignore[arg-type]


def test_commands_go_on_from_what_the_robots_hold() -> None:
    task = paper_lift()
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    sagging = task.q_start + 1e-4
    controller.reset(sagging, commanded=task.q_start)
    step = controller.step(sagging)
    np.testing.assert_array_equal(step.q, task.q_start)
    with pytest.raises(InvalidInputError, match=r"master/joint_1 is measured 1 rad .* from its command"):
        controller.reset(task.q_start + np.eye(18)[0], commanded=task.q_start)
    np.testing.assert_array_equal(controller.step(sagging).q, step.q_next)  # nothing was changed


def test_a_simulated_start_is_a_mean() -> None:
    task = paper_lift()
    plant = DisturbedPlant(task.cell, task.grasp, disturbances=Disturbances(encoder_noise=1e-4))
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    run = simulate(controller, plant, q_start=task.q_start, duration=2.0 * task.dt)
    assert np.abs(run.q_command[0] - task.q_start).max() < 0.3e-4  # one reading: up to 1e-4


def test_only_arms_that_are_measured_are_asked_for_their_stiffness() -> None:
    task = paper_lift()
    q, options = task.q_start, {}
    made = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)
    told = {**options, "supervision": {"stiffness": 1e5}}
    watched = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=told)
    with pytest.warns(StiffnessWarning, match="stiffness_nm_per_rad"):
        made.reset([q, q])
    with pytest.warns(StiffnessWarning) as caught:
        made.reset(q, commanded=q)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made.reset(q)
        made.step(q)
        simulate(made, q_start=q, duration=2.0 * task.dt)
        watched.reset([q, q])
        ForceController(made, {"stiffness": 1e5}).reset(q, commanded=q)  # forces are minded: they show it


def test_where_arms_share_joints_the_stiffness_that_is_asked_for_is_taken() -> None:
    task = torso_lift()
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    with pytest.warns(StiffnessWarning, match=r"SupervisionOptions\(stiffness"):
        controller.reset(task.q_start, commanded=task.q_start)
    options = {"supervision": {"stiffness": [1e6, *[1e5] * 12]}}
    told = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told.reset(task.q_start, commanded=task.q_start)
