"""Null-space motion of redundant arms: the wanted velocities; the motion never disturbs the object."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import (
    ControlStep,
    HoldPath,
    InvalidInputError,
    PostureOptions,
    QPController,
    QPOptions,
)
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import chain_error, limit_excess, path_error, tool_placements


def run(task: Scenario, options: PostureOptions, **others: Any) -> list[ControlStep]:
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005, options=QPOptions(posture=options, **others))
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished:
        steps.append(controller.step())
    return steps


def disturbance(task: Scenario, steps: list[ControlStep]) -> tuple[float, float]:
    """Largest chain and path error of a run [m]."""
    tools = tool_placements(task.cell, [s.q_next for s in steps])
    return (
        max(chain_error(T, task.grasp)[0] for T in tools),
        max(path_error(T, task.grasp, task.path, s.clock_next)[0] for T, s in zip(tools, steps, strict=True)),
    )


# -- the wanted velocities ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [("gain", -1.0), ("centring", np.nan), ("manipulability", np.inf), ("speed_share", 0.0), ("speed_share", 1.1)],
)
def test_bad_options(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"PostureOptions: {name}"):
        PostureOptions(**{name: value})


@pytest.mark.parametrize(
    ("options", "asks"),
    [
        ({}, False),
        ({"speed_share": 0.5}, False),
        ({"gain": 0.0}, True),
        ({"gain": 2.0}, True),
        ({"centring": 0.1}, True),
        ({"manipulability": 0.1}, True),
        ({"manipulability": 1.0}, True),
        ({"target": np.zeros(14)}, True),
    ],
)
def test_a_goal_is_asked_for_if_it_is_not_the_default_one(options: dict[str, Any], asks: bool) -> None:
    assert PostureOptions(**options).asks is asks


def test_a_target_that_is_no_configuration() -> None:
    task = paper_lift()
    options = QPOptions(posture=PostureOptions(target=np.zeros(3)))
    with pytest.raises(InvalidInputError, match="PostureOptions: target"):
        QPController(task.cell, task.grasp, task.path, dt=task.dt, options=options)


# -- the object never notices ------------------------------------------------------------------------------------------

WISHES = {
    "none": PostureOptions(gain=0.0),
    "posture": PostureOptions(gain=2.0),
    "centring": PostureOptions(gain=0.0, centring=1.0),
    "manipulability": PostureOptions(gain=0.0, manipulability=1.0),
    "all, fast": PostureOptions(gain=5.0, centring=5.0, manipulability=1.0, speed_share=0.8),
}


@pytest.mark.slow
@pytest.mark.parametrize("preview", [True, False])
@pytest.mark.parametrize("make", [dual_arm7, mixed_cell])
def test_null_space_motion_does_not_move_the_object(make: Any, preview: bool) -> None:
    """Chain and path hold for every posture goal, and the goals have an effect."""
    ends = {}
    for name, wish in WISHES.items():
        task = make(duration=1.5)
        steps = run(task, wish, **({} if preview else {"preview": None}))
        chain, path = disturbance(task, steps)
        assert chain < 1e-7, name
        assert path < 1e-7, name
        assert limit_excess(task.cell, [s.q_next for s in steps], [s.velocity for s in steps]) == 0.0
        ends[name] = task.cell.positions(steps[-1].q_next)
    rest = ends.pop("none")
    for name, end in ends.items():
        assert np.abs(end - rest).max() > 1e-3, name


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("preview", [True, False])
def test_the_arms_go_to_their_posture_while_the_object_rests(preview: bool, acceleration: float) -> None:
    """Elbows turn about the lines from shoulders to wrists; the tools do not move."""
    task = dual_arm7()
    swung = task.q_start.copy()
    swung[[0, 7]] += 0.5  # the arms can approach this target only by turning their elbows
    cell = task.cell.with_limits(acceleration=acceleration)
    task = replace(task, cell=cell, path=HoldPath(task.path.pose(0.0), duration=3.0))
    steps = run(task, PostureOptions(gain=2.0, target=swung), **({} if preview else {"preview": None}))
    chain, path = disturbance(task, steps)
    assert chain < 1e-6
    assert path < 1e-6
    assert np.abs(steps[-1].q_next - task.q_start).max() > 0.05
    assert np.linalg.norm(steps[-1].q_next - swung) < np.linalg.norm(task.q_start - swung)
    assert np.abs(steps[-1].velocity).max() < 0.05 * np.max([np.abs(s.velocity).max() for s in steps])
