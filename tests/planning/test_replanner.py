"""A body comes into the way of an object in motion: it goes round without a stop, clear, or stops and says why."""

from __future__ import annotations

import itertools
import time
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from route_cases import at, two_ur10

from coopqp import (
    Clearance,
    CollisionScene,
    InvalidInputError,
    LinePath,
    QPController,
    Replanner,
    Status,
    inverse_kinematics,
)
from coopqp.collision import Body, Box
from coopqp.errors import CoopqpError
from coopqp.scenarios import Scenario

DT, MARGIN = 0.004, 0.01
AWAY, HERE = at((5.0, 0.0, 0.0)), at((0.0, 0.05, 0.36))


class Run(NamedTuple):
    """Rates, statuses, origins of the object (K, 3) [m] and the least distance of the block [m]."""

    rates: list[float]
    statuses: set[Status]
    least: float
    finished: bool
    end: pin.SE3
    chain: float


@pytest.fixture(autouse=True)
def _processor_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches count the time that they have run, and not that in which other programs did."""
    monkeypatch.setattr(time, "perf_counter", time.process_time)


@pytest.fixture(scope="module")
def cell() -> tuple[Any, Any, CollisionScene, LinePath, Any]:
    """Two UR10 that move a bar by 0.6 m in 2 s, and a block 0.4 m high."""
    arms, grasp, near = two_ur10()
    arms = arms.with_limits(acceleration=5.0)
    start, goal = at((0.0, -0.3, 0.55)), at((0.0, 0.3, 0.55))
    path = LinePath(start, goal, duration=2.0, time_law="linear")
    q = inverse_kinematics(arms, grasp, start, near)
    task = Scenario("two_ur10", arms, grasp, path, q, DT, object_size=(0.8, 0.06, 0.06), object_mass=3.0)
    scene = CollisionScene.of(task, moving=[Body("block", Box((0.1, 0.06, 0.4)), AWAY)], margin=MARGIN)
    return arms, grasp, scene, path, q


def controller_of(cell: Any) -> QPController:
    arms, grasp, scene, path, q = cell
    controller = QPController(arms, grasp, path, dt=DT, constraints=[Clearance(scene)])
    controller.reset(q)
    return controller


def run(cell: Any, controller: QPController, replanner: Replanner, *, place: pin.SE3, steps: int = 2500) -> Run:
    """The block is put to a place after 0.4 s."""
    standing = [cell[2].standing({"block": T}) for T in (AWAY, place)]
    rates, statuses, least, chain = [], set(), np.inf, 0.0
    for k in range(steps):
        T = AWAY if k < 100 else place
        replanner.move("block", T)
        step = controller.step()
        replanner.watch(step)
        least = min(least, standing[k >= 100].distances(step.q_next)[0].distance)
        chain = max(chain, step.commanded_apart)
        if k > 100:
            rates.append(step.rate)
            statuses.add(step.status)
        if step.finished:
            break
    end = controller.path.pose(step.clock_next)
    return Run(rates, statuses, least, step.finished, end, chain)


@pytest.mark.slow
def test_the_object_goes_round_a_body_in_its_way_without_a_stop(cell: Any) -> None:
    controller = controller_of(cell)
    replanner = Replanner(controller, cell[2], simulated=True)
    found = run(cell, controller, replanner, place=HERE)
    assert replanner.found == 1
    assert found.finished
    assert found.least >= MARGIN - 1e-4
    assert min(found.rates) > 0.05
    assert found.statuses <= {Status.TRACKING, Status.SLOWED}
    assert found.chain < 1e-6
    np.testing.assert_allclose(found.end.homogeneous, cell[3].goal.homogeneous, atol=1e-6)
    # The motion goes on: no jump of the rate that acceleration limits of 5 rad/s² would not allow.
    assert max(abs(b - a) for a, b in itertools.pairwise(found.rates)) < 0.2


@pytest.mark.slow
def test_a_body_beside_the_way_changes_nothing(cell: Any) -> None:
    controller = controller_of(cell)
    replanner = Replanner(controller, cell[2], simulated=True)
    found = run(cell, controller, replanner, place=at((0.0, 0.0, 0.2)))
    assert found.finished
    assert replanner.found == replanner.late == 0
    assert controller.path is cell[3]


@pytest.mark.slow
def test_where_the_goal_is_taken_the_object_stops_clear_and_the_body_is_named(cell: Any) -> None:
    controller = controller_of(cell)
    replanner = Replanner(controller, cell[2], simulated=True)
    found = run(cell, controller, replanner, place=at((0.0, 0.3, 0.4)), steps=700)
    assert not found.finished
    assert found.rates[-1] < 0.05
    assert found.least >= MARGIN - 1e-4
    assert replanner.found == 0
    assert set(replanner.blocked.split(" and ")) == {"object", "block"}


def test_a_thread_finds_a_way_for_an_object_that_rests_before_a_body(cell: Any) -> None:
    controller = controller_of(cell)
    with Replanner(controller, cell[2], lead=1e-3) as replanner:  # too short for a way in motion
        place = at((0.0, 0.0, 0.36))
        for k in itertools.count():
            replanner.move("block", place if k > 100 else AWAY)
            if replanner.watch(controller.step()):
                break
        assert replanner.found == 1
        rest = run(cell, controller, replanner, place=place)
    assert rest.finished
    assert rest.least >= MARGIN - 1e-4
    np.testing.assert_allclose(rest.end.homogeneous, cell[3].goal.homogeneous, atol=1e-6)


def test_what_goes_wrong_in_the_thread_is_told_where_the_steps_are_watched(
    cell: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = controller_of(cell)

    def broken(scene: CollisionScene, places: Any) -> CollisionScene:
        raise CoopqpError("broken")

    monkeypatch.setattr(CollisionScene, "standing", broken)

    def step_until_told(replanner: Replanner) -> None:
        while True:
            replanner.move("block", HERE)
            replanner.watch(controller.step())

    with Replanner(controller, cell[2]) as replanner, pytest.raises(CoopqpError, match="broken"):
        step_until_told(replanner)


def test_arguments_that_make_no_replanner_are_refused(cell: Any) -> None:
    controller = controller_of(cell)
    for options, scene, match in (({"lead": 0.0}, cell[2], "lead"), ({"clearance": -1.0}, cell[2], "clearance")):
        with pytest.raises(InvalidInputError, match=match):
            Replanner(controller, scene, **options)
    with pytest.raises(InvalidInputError, match="scene"):
        Replanner(controller, None)  # type: ignore[arg-type]
    with pytest.raises(CoopqpError, match="moving body"):
        Replanner(controller, cell[2], simulated=True).move("cart", HERE)
