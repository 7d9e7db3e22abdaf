"""How long a search took, and how many poses it tried, as a route tells it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from coopqp import CollisionScene, InvalidInputError, find_path, inverse_kinematics
from coopqp.collision import Body, Box
from coopqp.planning import Route, RouteVerdict
from coopqp.scenarios import dual_arm7

TASK = dual_arm7()
START, GOAL = (pin.SE3(np.eye(3), np.array([0.0, y, 0.3])) for y in (-0.1, 0.1))


def searched(body: Body, *, off: float = 0.0, nodes: int = 40, goal: pin.SE3 = GOAL) -> tuple[Route, float]:
    q = inverse_kinematics(TASK.cell, TASK.grasp, START, TASK.q_start)
    x = TASK.cell.positions(q)
    x[0] += off
    scene = CollisionScene.of(replace(TASK, obstacles=(body,)))
    began = time.perf_counter()
    route = find_path(TASK.cell, TASK.grasp, START, goal, scene, q_start=TASK.cell.configuration(x), nodes=nodes)
    return route, time.perf_counter() - began


def block(*p: float, size: tuple[float, float, float] = (0.1, 0.1, 0.1)) -> Body:
    return Body("block", Box(size), pin.SE3(np.eye(3), np.array(p)))


def test_a_straight_way_needs_no_search() -> None:
    route, took = searched(block(0.0, 0.0, 2.0))
    assert route.verdict is RouteVerdict.STRAIGHT
    assert route.nodes == 0
    assert route.trees == ()
    assert 0.0 < route.first_s <= route.total_s <= took
    assert route.refused == ()
    assert route.length == pytest.approx(0.2)


def test_a_search_that_finds_nothing_tells_how_far_and_how_long_it_looked() -> None:
    route, took = searched(block(0.0, 0.0, 0.3, size=(0.3, 0.03, 2.0)))
    assert route.verdict is RouteVerdict.NOT_FOUND
    assert 0.0 < route.first_s == route.total_s <= took
    assert f"No way in {route.total_s:.1f} s and {route.nodes} poses; nothing is proved" in route.reason
    assert 2 <= route.nodes <= 50
    assert 2 <= route.nodes - sum(map(len, route.trees)) <= 8  # an edge to each node but the roots
    for edges in route.trees:
        assert edges.shape[1:] == (2, 3)
        assert np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).max(initial=0.0) <= 0.1 + 1e-6


def test_an_end_that_is_impossible_is_told_at_once() -> None:
    route, took = searched(block(0.0, 0.1, 0.3))
    assert route.verdict is RouteVerdict.INFEASIBLE
    assert route.reason.startswith("The goal is impossible: ")
    assert 0.0 < route.first_s == route.total_s <= took


def test_a_start_may_be_off_by_a_hundredth() -> None:
    assert searched(block(0.0, 0.0, 2.0), off=0.004)[0].found
    with pytest.raises(InvalidInputError, match="q_start: it does not hold the object at the start"):
        searched(block(0.0, 0.0, 2.0), off=0.1)
