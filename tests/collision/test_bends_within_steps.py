"""A distance is not linear within a step: rows that led below the margin are tightened."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Clearance, CollisionScene, LinePath, QPController
from coopqp.collision import Body, Sphere
from coopqp.collision.distances import Distances
from coopqp.scenarios import ring


@pytest.mark.core
def test_no_step_leads_below_the_margin_where_the_object_turns() -> None:
    """The end of the object rises to a ball; with nothing that brakes ahead and long steps it arrives at full speed.

    Its height is ρ sin φ: by the slope alone it would come 0.1 mm too close.
    """
    task = ring(arms=2)
    start, size = task.path.pose(0.0), np.array(task.object_size)
    end = np.array([0.45 * size[0], 0.0, 0.5 * size[2] + 0.09])
    place = (start * task.T_object_body * pin.SE3(np.eye(3), end)).translation
    scene = CollisionScene.of(task, margin=0.01, obstacles=[Body("ball", Sphere(0.02), pin.SE3(np.eye(3), place))])
    path = LinePath.displaced(start, rotation=-start.rotation[:, 1], duration=0.6, time_law="linear")
    clearance = Clearance(scene, approach=1e3)
    controller = QPController(task.cell, task.grasp, path, dt=0.05, constraints=[clearance], options={"preview": None})
    controller.reset(task.q_start)
    probe = Distances(scene.built)
    left = [(probe.all(controller.step().q_next) - scene.built.margins).min() for _ in range(20)]
    assert min(left) < 1e-6, "it comes as close as it may"
    assert min(left) > -1e-9
