"""The parts of a ready task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.shapes import Body
from coopqp.paths.path import ObjectPath
from coopqp.shown import Shown
from coopqp.spatial import Array


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EngineSettings:
    """How a scenario runs in the physics engine; see :class:`coopqp.simulation.PhysicsPlant`.

    Attributes:
        disturbances: settings of :class:`coopqp.simulation.Disturbances`.
        options: settings of :class:`coopqp.simulation.PhysicsOptions`.
        forces: settings of :class:`coopqp.ForceOptions`, besides stiffness and payload; None for arms that do not
            monitor forces.
        controller: settings of :class:`coopqp.QPOptions`.
        torque_share: share of the joints' torques that load sharing plans with.
        palms: open palms in place of grips that do not let go: settings of a :class:`coopqp.forces.Grip` per arm.
        tolerances: of the verdict: settings of :class:`coopqp.simulation.Tolerances`. The object gives way to a
            squeeze.
        shares_load: the drives feed a load forward that :class:`coopqp.forces.LoadShare` shares.
        internal_force: largest internal force of an arm that is accepted [N]; None for any.
    """

    disturbances: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    forces: Mapping[str, Any] | None = None
    controller: Mapping[str, Any] = field(default_factory=dict)
    palms: Sequence[Mapping[str, Any]] | None = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    shares_load: bool = False
    torque_share: float = 1.0
    internal_force: float | None = None


@dataclass(frozen=True, eq=False)
class Scenario(Shown):
    """A ready task: a cell, a grasp, a path, a start and an object.

    Attributes:
        name: name of the scenario.
        cell, grasp, path: the arms, their grasp and the path of the object.
        q_start: configuration (nq,) at which the arms hold the object at the start of the path.
        dt: suitable length of a step [s].
        object_size: side lengths of the box that represents the object in pictures and in the physics engine [m].
        T_object_body: placement of the box's centre in the object frame.
        object_mass: mass of the object [kg].
        obstacles: bodies around the arms, in the world.
        engine: settings for the physics engine, if forces matter; None where joints follow their commands.
    """

    name: str
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    q_start: Array
    dt: float
    object_size: tuple[float, float, float] = (0.1, 0.1, 0.1)
    T_object_body: pin.SE3 = field(default_factory=lambda: pin.SE3(np.eye(3), np.zeros(3)))
    object_mass: float = 20.0
    obstacles: tuple[Body, ...] = ()
    engine: EngineSettings | None = None

    def __repr__(self) -> str:
        return f"Scenario({self.name}: {self.cell!r}, {self.path.duration:.4g} s in steps of {1e3 * self.dt:.4g} ms)"
