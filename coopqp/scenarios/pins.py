"""Bars on pins: grasps that give way about an axis, so that arms make motions that rigid grips do not allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from coopqp.model.free_directions import freed_cell
from coopqp.paths.scenario import Scenario
from coopqp.scenarios.stations import facing, moved, put_together
from coopqp.scenarios.units import Radians, Seconds


def _on_pins(task: Scenario, swing: float) -> Scenario:
    """The task with a hinge about the x axis of each tool, which is upright at the start."""
    grasp = task.grasp
    for name in task.cell.arm_names:
        grasp = grasp.freed(name, "rx", range=(-swing, swing))
    freed = freed_cell(task.cell, grasp)
    q_start = freed.configuration(task.cell.positions(task.q_start))
    return replace(task, cell=freed.cell, grasp=freed.grasp, q_start=q_start)


def five_joint_pins(*, duration: Seconds = 3.0) -> Scenario:
    """Two five-joint arms hold a bar on upright pins: with a hinge each they make every motion of it.

    Args:
        duration: duration of the path.
    """
    path = moved(0.25, (0.02, 0.03, 0.05), (0.10, 0.05, 0.20), duration)
    bar = put_together("five_joint_pins", facing("arm5", 0.25), path, object_size=(0.50, 0.04, 0.04), object_mass=1.0)
    return _on_pins(bar, 1.2)


def bar_with_pins(*, yaw: Radians = 1.5, duration: Seconds = 5.0) -> Scenario:
    """Two RX-90L turn a bar on upright pins about the vertical, further than with rigid grips.

    Args:
        yaw: angle of the bar.
        duration: duration of the path.
    """
    path = moved(0.35, (0.0, 0.0, 0.05), (0.0, 0.0, yaw), duration)
    bar = put_together("bar_with_pins", facing("rx90l", 0.30), path, object_size=(0.60, 0.05, 0.05), object_mass=5.0)
    pins = _on_pins(bar, 2.0)
    driven = np.where(np.isin(np.arange(pins.cell.nv), (6, 13)), np.inf, 5.0)
    return replace(pins, cell=pins.cell.with_limits(acceleration=driven))
