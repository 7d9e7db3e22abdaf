"""Null-space motion of redundant arms: the wanted velocities; the motion never disturbs the object."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import rx90l
from torsos import lift_cell

from coopqp import (
    ControlStep,
    HoldPath,
    InvalidInputError,
    PostureOptions,
    QPController,
    QPOptions,
    RobotCell,
)
from coopqp.model import CellState
from coopqp.model.chain import moving_columns
from coopqp.model.posture import Posture
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import chain_error, limit_excess, path_error, tool_placements
from coopqp.spatial import Array


def posture_of(cell: RobotCell, q: Array, **options: Any) -> Posture:
    posture = Posture(cell, PostureOptions(**options))
    posture.reset(q)
    return posture


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


def test_at_the_target_nothing_is_wanted(rng: np.random.Generator) -> None:
    task = dual_arm7()
    posture = posture_of(task.cell, task.q_start)
    assert np.all(posture.velocity(task.q_start) == 0.0)
    q = task.q_start + rng.normal(size=14) * 1e-3
    assert np.allclose(posture.velocity(q), task.q_start - q, atol=1e-15)
    assert np.allclose(posture_of(task.cell, task.q_start, gain=3.0).velocity(q), 3.0 * (task.q_start - q), atol=1e-15)


def test_a_target_of_ones_own_stays(rng: np.random.Generator) -> None:
    task = mixed_cell()
    target = task.cell.configuration(task.cell.positions(task.q_start) + rng.normal(size=26) * 1e-3)
    posture = posture_of(task.cell, task.q_start, target=target)
    assert np.all(posture.velocity(target) == 0.0)


def test_arms_of_six_joints_have_no_freedom(rng: np.random.Generator) -> None:
    task = mixed_cell()
    posture = posture_of(task.cell, task.q_start, centring=1.0, manipulability=0.1)
    v = posture.velocity(pin.integrate(task.cell.model, task.q_start, rng.normal(size=26) * 0.1))
    for s in task.cell.v_slices:
        assert np.all(v[s] == 0.0) == (s.stop - s.start == 6)


def test_the_wish_is_bounded_by_a_share_of_every_speed(rng: np.random.Generator) -> None:
    task = dual_arm7()
    posture = posture_of(task.cell, task.q_start, gain=100.0, speed_share=0.1)
    v = posture.velocity(task.q_start + rng.normal(size=14))
    assert np.abs(v / task.cell.limits.velocity).max() == pytest.approx(0.1)
    free = task.cell.with_limits(velocity=np.inf)  # an infinite limit counts as 1 rad/s
    v = posture_of(free, task.q_start, gain=100.0).velocity(task.q_start + 1.0)
    assert np.abs(v).max() == pytest.approx(0.2)


@pytest.mark.parametrize(("wish", "wanted"), [(0.99, 0.99), (1.01, 1.0), (1.9, 1.0), (50.0, 1.0)])
def test_a_wish_is_shortened_only_beyond_its_share(wish: float, wanted: float) -> None:
    """In units of the share of the joint that asks for most of its own; the direction stays."""
    task = dual_arm7()
    away = 1e-3 * np.linspace(-1.0, 1.0, 14)
    most = np.abs(away / task.cell.limits.velocity).max()
    posture = posture_of(task.cell, task.q_start, gain=wish * 0.2 / most)
    v = posture.velocity(task.q_start - away)
    np.testing.assert_allclose(v, wanted * 0.2 / most * away, rtol=1e-9)


def test_centring_leads_to_the_middle_of_bounded_joints() -> None:
    task = dual_arm7()
    lower = task.cell.limits.lower.copy()
    lower[0] = -np.inf
    cell = task.cell.with_limits(lower=lower)
    middle = 0.5 * (task.cell.limits.lower + task.cell.limits.upper)
    v = posture_of(cell, task.q_start, gain=0.0, centring=0.01).velocity(task.q_start)
    assert v[0] == 0.0
    assert np.allclose(v[1:], 0.01 * (middle - task.q_start)[1:], atol=1e-15)


def test_manipulability_rises_along_its_gradient(rng: np.random.Generator) -> None:
    task = mixed_cell()
    posture = posture_of(task.cell, task.q_start, gain=0.0, manipulability=0.05, speed_share=1.0)

    def manipulability(q: Array, k: int) -> float:
        J = CellState(task.cell, q).jacobian(k)
        return float(np.sqrt(np.linalg.det(J @ J.T)))

    v = posture.velocity(task.q_start)
    for k, s in enumerate(task.cell.v_slices):
        if s.stop - s.start <= 6:
            continue
        direction = rng.normal(size=task.cell.nv)
        direction[[j for j in range(task.cell.nv) if not s.start <= j < s.stop]] = 0.0
        h = 1e-4
        ends = [manipulability(pin.integrate(task.cell.model, task.q_start, x * direction), k) for x in (h, -h)]
        assert v[s] @ direction[s] / 0.05 == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-4, abs=1e-6)


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


def test_before_a_start_nothing_is_wanted_and_weights_change_at_once() -> None:
    task = dual_arm7()
    away = task.q_start + 1e-3
    posture = Posture(task.cell, PostureOptions())
    np.testing.assert_array_equal(posture.velocity(away), 0.0)
    posture.reset(task.q_start)
    np.testing.assert_allclose(posture.velocity(away), -1e-3, rtol=1e-9)
    posture.take(PostureOptions(gain=0.0))
    np.testing.assert_array_equal(posture.velocity(away), 0.0)
    posture.take(PostureOptions(gain=1e6, speed_share=0.1))
    assert np.abs(posture.velocity(away) / task.cell.limits.velocity).max() == pytest.approx(0.1)
    posture.take(PostureOptions(gain=0.0, manipulability=0.01))
    assert np.abs(posture.velocity(away)).max() > 0.0
    posture.reset(away)
    posture.take(PostureOptions(gain=2.0))
    np.testing.assert_array_equal(posture.velocity(away), 0.0)


def test_joints_that_arms_share_have_a_posture_and_the_others_of_a_group_too(rng: np.random.Generator) -> None:
    """Beside them an arm of six joints has none."""
    group, _ = lift_cell()
    cell = RobotCell([rx90l(geometry=False, T_world_base=pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0]))), *group.arms])
    q = cell.configuration(np.zeros(cell.nv))
    v = posture_of(cell, q).velocity(cell.moved(q, np.full(cell.nv, -1e-3)))
    alone = cell.v_slices[0]
    np.testing.assert_array_equal(v[alone], 0.0)
    moving = np.unique(np.concatenate(moving_columns(cell)[1:]))
    np.testing.assert_allclose(v[moving], 1e-3, rtol=1e-9)
    assert len(moving) == 13


def test_a_target_that_is_no_configuration() -> None:
    with pytest.raises(InvalidInputError, match="PostureOptions: target"):
        Posture(paper_lift().cell, PostureOptions(target=np.zeros(3)))


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
