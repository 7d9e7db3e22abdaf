"""Open palms: friction in closed form, refusals, and a box that is lifted by friction alone in the engine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ForceController, ForceOptions, InvalidInputError, QPController, simulate
from coopqp.forces import Grip, least_squeeze, palm_use, squeeze_needed
from coopqp.scenarios import Scenario, palm_box
from coopqp.simulation import PhysicsPlant, WrenchBounds, engine_controller, engine_plant
from coopqp.simulation.engine import box_payload

PALM = Grip(kind="palm", friction=0.6, radius=0.06)


@pytest.fixture(scope="module")
def task() -> Scenario:
    return palm_box()


def test_a_palm_uses_what_the_cone_says() -> None:
    """Force across over μ times force along; turning counts by ⅔ r; tilting by r; no pressing holds nothing."""
    press = np.array([0.0, 0.0, 100.0, 0.0, 0.0, 0.0])
    for across, used in (
        ([30.0, 40.0, 0.0, 0.0, 0.0, 0.0], 50.0 / 60.0),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 1.2], 1.2 / (0.04 * 60.0)),
        ([0.0, 0.0, 0.0, 3.0, 0.0, 0.0], 0.5),
        ([0.0, 0.0, -100.0, 0.0, 0.0, 0.0], None),
    ):
        found = palm_use([PALM], np.array([press + across]))[0]
        assert found == (pytest.approx(used) if used is not None else np.inf) or (used is None and not found < 1.0)


@pytest.mark.parametrize("mass", [5.0, 20.0])
def test_the_least_squeeze_carries_the_weight_by_friction(task: Scenario, mass: float) -> None:
    """Two palms that face each other: m g / 2 μ each, whatever the box's turn about the vertical."""
    weight = np.array([0.0, 0.0, 9.81 * mass, 0.0, 0.0, 0.0])
    least = least_squeeze([PALM, PALM], task.grasp, [weight])
    assert least == pytest.approx(0.5 * 9.81 * mass / 0.6, rel=1e-3)
    beside = weight + 2.0 * np.eye(6)[4]  # the centre of mass is nearer to one palm: it bears more
    assert least_squeeze([PALM, PALM], task.grasp, [beside]) > least + 1.0
    sideways = Grip(kind="palm", friction=0.6, radius=0.06, normal=(1.0, 0.0, 0.0))
    with pytest.raises(InvalidInputError, match="do not balance"):
        least_squeeze([PALM, sideways], task.grasp, [weight])


def test_the_squeeze_that_is_needed_uses_all_friction() -> None:
    """Whatever the wrenches: with that normal force and the same load across, the busiest palm is at its limit."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        wrenches = rng.normal(size=(3, 6)) * [30.0, 30.0, 30.0, 0.3, 0.3, 0.3]
        wrenches[:, 2] = rng.uniform(1.0, 200.0, 3)
        needed = squeeze_needed([PALM] * 3, wrenches)
        wrenches[:, 2] = needed
        assert palm_use([PALM] * 3, wrenches).max() == pytest.approx(1.0)
    wrenches[1, 2] = 0.0
    assert squeeze_needed([PALM] * 3, wrenches) == np.inf


def made(task: Scenario, **options: Any) -> ForceController:
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    settings = {"stiffness": 1e4, "payload": box_payload(task), "palms": (PALM, PALM), **options}
    return ForceController(inner, ForceOptions(**settings))


def test_palms_that_would_lose_the_object_are_refused(task: Scenario) -> None:
    with pytest.raises(InvalidInputError, match=r"press with 163 N, and need 163\.5 N at least.*Give 196 N"):
        made(task, squeeze=163.0)
    assert made(task, squeeze=164.0).options.squeeze == 164.0
    with pytest.raises(InvalidInputError, match="most_squeeze is 150 N, squeeze 200 N"):
        made(task, squeeze=200.0, most_squeeze=150.0)
    with pytest.raises(InvalidInputError, match="a squeeze without palms"):
        ForceOptions(stiffness=1e4, most_squeeze=150.0)
    with pytest.raises(InvalidInputError, match="Say what they hold"):
        made(task, squeeze=200.0, payload=None)
    with pytest.raises(InvalidInputError, match="1 palms for 2 arms"):
        made(task, squeeze=200.0, palms=(PALM,))
    with pytest.raises(InvalidInputError, match="no palm along an axis"):
        ForceOptions(stiffness=1e4, palms=(Grip(), PALM), squeeze=200.0)
    with pytest.raises(InvalidInputError, match="along their normals"):
        ForceOptions(stiffness=1e4, palms=(PALM, PALM), squeeze=200.0, directions=np.ones((2, 6)))
    with pytest.raises(InvalidInputError, match="other directions than 0 and 1"):
        made(task, palms=None, directions=0.5 * np.ones((2, 6)))
    one: Any = PALM
    for build in (lambda: ForceOptions(stiffness=1e4, palms=one, squeeze=200.0), lambda: WrenchBounds(palms=one)):
        with pytest.raises(InvalidInputError, match="palms: a Grip"):
            build()
    pytest.importorskip("mujoco")
    with pytest.raises(InvalidInputError, match="no palm for each arm"):
        PhysicsPlant.of(task, palms=(PALM,))
    with pytest.raises(InvalidInputError, match="palms: a Grip"):
        PhysicsPlant.of(task, palms=one)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")  # a base is off
def test_a_box_is_lifted_by_friction_alone() -> None:
    """With 1.2 times the least squeeze, real contacts, and a base off by 1 mm and 0.1°: it slips by 1 mm at most."""
    pytest.importorskip("mujoco")
    task = palm_box(base_off=True)
    plant = engine_plant(task)
    controller = engine_controller(task, plant)
    run = simulate(controller, plant, q_start=task.q_start, settle=0.3, loads=True)
    assert run.finished
    assert run.wrenches is not None
    assert plant.slip() < 1e-3
    assert plant.gripped
    moving = run.wrenches[run.rate > 0.0][:, :, 2]
    assert moving.min() > 163.5
    assert moving.max() < 320.0
    end = task.path.pose(task.path.duration)
    assert np.linalg.norm(plant.T_world_object.translation - end.translation) < 4e-3


@pytest.mark.slow
def test_a_palm_without_enough_friction_in_the_world_stops_before_it_lifts() -> None:
    """What is asked for is checked against the model; what is felt slows and stops the object."""
    pytest.importorskip("mujoco")
    task = palm_box(most_squeeze=200.0)
    assert task.engine is not None
    heavier = replace(task, object_mass=23.9)  # 195 N at least, where 200 N press
    plant = engine_plant(heavier)
    run = simulate(engine_controller(task, plant), plant, q_start=task.q_start, duration=3.0, loads=True)
    assert plant.gripped
    assert plant.slip() < 1e-3
    assert not run.finished
    assert "friction" in run.notes[-1]
    assert isinstance(plant.T_world_object, pin.SE3)


@pytest.mark.slow
def test_palms_press_harder_where_friction_runs_out() -> None:
    """A box heavier than said, 1.02 times the least squeeze: it is lifted, and slips by 1 mm at most."""
    pytest.importorskip("mujoco")
    task = palm_box()
    plant = engine_plant(replace(task, object_mass=23.9))
    run = simulate(engine_controller(task, plant), plant, q_start=task.q_start, settle=0.3, loads=True)
    assert run.finished
    assert plant.gripped
    assert plant.slip() < 1e-3
    assert run.wrenches is not None
    assert 1.15 * 195.4 < run.wrenches[-1][:, 2].mean() < 260.0
