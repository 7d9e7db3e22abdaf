"""Scenarios in the physics engine: the plant, the controller and the run that a scenario's ``engine`` describes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.control.interface import Controller
from coopqp.control.options import QPOptions
from coopqp.control.qp import QPController
from coopqp.errors import InvalidInputError
from coopqp.forces.force_controller import ForceController
from coopqp.forces.force_options import ForceOptions
from coopqp.forces.grips import Grip
from coopqp.forces.load_sharing import LoadShare
from coopqp.paths.scenario import EngineSettings, Scenario
from coopqp.planning.payload import Payload
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.simulation.plants.physics import PhysicsPlant
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.simulate import ProgressCallback, simulate


def box_payload(scenario: Scenario, torque_share: float = 1.0) -> Payload:
    """The object of a scenario as a homogeneous box, and a share of the joints' torques."""
    box = scenario.T_object_body.act(pin.Inertia.FromBox(scenario.object_mass, *scenario.object_size))
    made = Payload(mass=box.mass, centre=box.lever, inertia=box.inertia)
    return made if torque_share == 1.0 else replace(made, torque=torque_share * made.limits(scenario.cell))


def engine_plant(scenario: Scenario) -> PhysicsPlant:
    """The plant that a scenario runs on in the engine.

    Raises:
        MissingExtraError: mujoco is not installed.
    """
    given = scenario.engine or EngineSettings()
    load = None
    if given.shares_load:
        load = LoadShare(
            scenario.cell,
            scenario.grasp,
            box_payload(scenario, given.torque_share),
            internal_force=given.internal_force or np.inf,
        )
    return PhysicsPlant.of(
        scenario,
        options=given.options,
        disturbances=Disturbances(**given.disturbances),
        load=load,
        palms=_palms(given),
    )


def _palms(given: EngineSettings) -> tuple[Grip, ...] | None:
    return None if given.palms is None else tuple(Grip(**one) for one in given.palms)


def engine_controller(scenario: Scenario, plant: PhysicsPlant) -> Controller:
    """The controller that a scenario runs with in the engine.

    Raises:
        InvalidInputError: arms on torque-controlled drives are to monitor forces.
    """
    given = scenario.engine or EngineSettings()
    if given.forces is not None and not plant.servoed:
        raise InvalidInputError(
            f"forces are monitored through servos, not drives by {plant.options.servo}",
            f"scenario {scenario.name}: engine",
            'Give servo="position", or forces=None.',
        )
    made = QPController(
        scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, options=QPOptions(**given.controller)
    )
    if given.forces is None:
        return made
    settings = {"stiffness": plant.stiffness, "payload": box_payload(scenario), "palms": _palms(given), **given.forces}
    return ForceController(made, ForceOptions(**settings))


def run_in_engine(
    scenario: Scenario,
    *,
    plant: PhysicsPlant | None = None,
    progress: ProgressCallback | None = None,
    metadata: dict[str, Any] | None = None,
) -> Recording:
    """Run a scenario in the engine, with wrenches and torques; the object rests for half a second at the end.

    The entry ``load`` of the metadata: ``torque_limits``, largest torques of the joints (null for none), and
    ``internal_force``, the largest accepted internal force of an arm [N] (null for any); ``palms``.

    Args:
        scenario: the scenario.
        plant: the plant; :func:`engine_plant` by default.
        progress, metadata: as in :func:`coopqp.simulate`.

    Raises:
        MissingExtraError: mujoco is not installed.
    """
    plant = engine_plant(scenario) if plant is None else plant
    limits = box_payload(scenario).limits(scenario.cell)
    given = scenario.engine or EngineSettings()
    load = {
        "torque_limits": [float(x) if np.isfinite(x) else None for x in limits],
        "internal_force": given.internal_force,
        "palms": None if given.palms is None else [dict(palm) for palm in given.palms],
    }
    return simulate(
        engine_controller(scenario, plant),
        plant,
        q_start=scenario.q_start,
        settle=0.5,
        loads=True,
        progress=progress,
        metadata={**(metadata or {}), "load": load, "settings": {"verdict": dict(given.tolerances)}},
    )
