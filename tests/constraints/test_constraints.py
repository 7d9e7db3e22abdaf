"""Constraints of a user's own: rows and lines hold, the object brakes ahead of them, and what goes wrong has a name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first

from coopqp import (
    ControlStep,
    Grasp,
    InvalidInputError,
    Knot,
    LimitKind,
    QPController,
    QPOptions,
    Rank,
    Status,
)
from coopqp.control import StallBound
from coopqp.model import CellState
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import chain_error, tool_placements
from coopqp.solvers import available_solvers
from coopqp.spatial import Array

ACCELERATIONS = pytest.mark.parametrize("acceleration", slow_but_first([5.0, np.inf]))


class Box:
    """Keeps the object's origin, as the first arm holds it, below a height of the world."""

    def __init__(self, grasp: Grasp, top: float, rank: Rank = Rank.LIMITS) -> None:
        self.name, self.rank, self.X, self.top = "ceiling", rank, grasp.T_object_tool[0].inverse(), top

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        p = (state.T_world_tool[0] * self.X).translation
        J = state.jacobian(0, pin.WORLD)
        G = np.zeros((1, state.cell.nv))
        G[0, state.cell.v_slices[0]] = (J[:3] - pin.skew(p) @ J[3:])[2]
        return G, np.array([-np.inf]), np.array([(self.top - p[2]) / dt])


def elbow(state: CellState, frame: str = "slave_1/joint_4") -> Array:
    """Jacobian of an elbow in world axes (3, nv)."""
    model = state.cell.model
    data = model.createData()
    return np.asarray(
        pin.computeFrameJacobian(model, data, state.q, model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED)[:3]
    )


class ElbowSpeed:
    """Keeps each component of an elbow's velocity below a bound [m/s]."""

    name, rank = "elbow", Rank.LIMITS

    def __init__(self, most: float) -> None:
        self.most = most

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        return elbow(state), np.full(3, -self.most), np.full(3, self.most)


class Speed:
    """Keeps joint 2 of the master slower than a speed: (q′σ)² ≤ most²."""

    name = "slow joint"

    def __init__(self, most: float) -> None:
        self.most = most

    def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
        return knot.slope[1:2] ** 2, np.zeros(1), np.array([self.most**2])


class Rows:
    """Rows on the first joint that a test chooses."""

    def __init__(self, lower: Any, upper: Any, rank: Rank = Rank.LIMITS) -> None:
        self.name, self.rank, self.lower, self.upper = "rows", rank, lower, upper
        self.broken: Any = None

    def rows(self, state: CellState, dt: float) -> Any:
        if isinstance(self.broken, Exception):
            raise self.broken
        if self.broken is not None:
            return self.broken
        G = np.zeros((len(self.lower), state.cell.nv))
        G[:, 0] = 1.0
        return G, np.array(self.lower), np.array(self.upper)


def made(lift: Scenario, *constraints: Any, acceleration: float = np.inf, **options: Any) -> QPController:
    cell = lift.cell.with_limits(acceleration=acceleration) if np.isfinite(acceleration) else lift.cell
    controller = QPController(
        cell, lift.grasp, lift.path, dt=0.002, options=QPOptions(**options), constraints=constraints
    )
    controller.reset(lift.q_start)
    return controller


def worth(controller: QPController, step: ControlStep) -> tuple[float, float]:
    """How far the arms are apart [m], and the largest error of the object from its path [m, rad]."""
    lift = controller
    apart, _ = chain_error(tool_placements(lift.cell, [step.q_next])[0], lift.grasp)
    O = lift.grasp.carried(CellState(lift.cell, step.q_next))[0]
    return apart, float(np.abs(pin.log6(lift.path.pose(step.clock_next).actInv(O)).vector).max())


@ACCELERATIONS
def test_the_object_brakes_ahead_of_a_wall_and_stays_on_its_path(acceleration: float) -> None:
    lift = paper_lift(duration=1.5)
    top = lift.path.pose(0.0).translation[2] + 0.2
    controller = made(lift, Box(lift.grasp, top), acceleration=acceleration)
    for _ in range(900):
        step = controller.step()
        apart, off = worth(controller, step)
        height = lift.grasp.carried(CellState(lift.cell, step.q_next))[0].translation[2]
        assert height <= top + 1e-9
        assert apart <= 1e-6
        assert off <= 1e-6
    assert step.status is Status.BLOCKED
    assert height >= top - 1e-4
    assert [(b.kind, b.name) for b in step.binding] == [(LimitKind.CONSTRAINT, "ceiling")]
    assert "constraint ceiling" in step.explain()


@pytest.mark.slow
@ACCELERATIONS
def test_a_slow_elbow_slows_the_object_on_its_path(acceleration: float) -> None:
    lift = paper_lift(duration=1.5)
    controller = made(lift, ElbowSpeed(0.03), acceleration=acceleration)
    named, lowest = False, 1.0
    for _ in range(3000):
        step = controller.step()
        assert np.abs(elbow(CellState(lift.cell, step.q)) @ step.velocity).max() <= 0.03 + 1e-8
        apart, off = worth(controller, step)
        assert apart <= 1e-6
        assert off <= 1e-6
        named = named or any(b.name == "elbow" for b in step.binding)
        lowest = min(lowest, step.rate) if step.clock > 0.2 else lowest
        if step.finished:
            break
    assert step.finished
    assert named
    assert lowest < 0.9


class Scaled:
    """Rows of another constraint, in other units."""

    def __init__(self, other: ElbowSpeed | Box, scale: float, rank: Rank) -> None:
        self.other, self.scale, self.name, self.rank = other, scale, other.name, rank

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        G, lower, upper = (self.scale * x for x in self.other.rows(state, dt))
        return G, lower, upper


@pytest.mark.parametrize("rank", [Rank.LIMITS, Rank.CLEARANCE])
@ACCELERATIONS
def test_rows_in_tiny_units_bind_as_they_say(acceleration: float, rank: Rank, rng: Any) -> None:
    """Whatever their scale, the elbow keeps its speed; where they have lost their digits they are refused by name."""
    lift = paper_lift(duration=1.5, time_law="linear")
    for scale in (1e-14, 10.0 ** -float(rng.uniform(4.0, 250.0))):
        controller = made(lift, Scaled(ElbowSpeed(0.03), scale, rank), acceleration=acceleration)
        named = False
        for _ in range(60):
            step = controller.step()
            assert np.abs(elbow(CellState(lift.cell, step.q)) @ step.velocity).max() <= 0.03 + 1e-8
            named = named or any(b.name == "elbow" for b in step.binding)
        assert named
    with pytest.raises(InvalidInputError, match="constraint elbow: the largest entry of row 0"):
        made(lift, Scaled(ElbowSpeed(0.03), 1e-300, rank)).reset(lift.q_start)


def test_a_rate_bound_holds_along_the_whole_path() -> None:
    lift = paper_lift(duration=1.5)
    controller = made(lift, Speed(0.2), acceleration=5.0)
    fastest, named = 0.0, False
    for _ in range(4000):
        step = controller.step()
        fastest = max(fastest, abs(float(step.velocity[1])))
        named = named or any(b.name == "slow joint" for b in step.binding)
        if step.finished:
            break
    assert step.finished
    assert named
    assert 0.18 <= fastest <= 0.2 * 1.01  # linear between knots


@ACCELERATIONS
def test_a_stall_bound_keeps_the_distance_by_which_arms_may_part(acceleration: float) -> None:
    """v T/2 + 5 dt v of every step, with the grasps' speed v and the time T in which all joints stop."""
    lift, distance = paper_lift(duration=0.7, time_law="quintic"), 0.01 if np.isfinite(acceleration) else 0.002
    controller = made(lift, StallBound(distance, dt=lift.dt), acceleration=acceleration)
    controller.reset(lift.q_start)
    step, farthest, named = controller.step(), 0.0, set()
    while not step.finished:
        grasps = [step.state.jacobian(k)[:3] @ step.velocity[own] for k, own in enumerate(lift.cell.v_slices)]
        speed, to_rest = np.linalg.norm(grasps, axis=1).max(), np.abs(step.velocity).max() / acceleration
        farthest = max(farthest, speed * (0.5 * to_rest + 5.0 * lift.dt))
        named |= {str(b) for b in step.binding if b.kind is LimitKind.CONSTRAINT}
        step = controller.step()
    assert 0.95 * distance < farthest < 1.05 * distance
    assert named == {"constraint stall"}
    for arguments in ({"distance": 0.0, "dt": 0.01}, {"distance": 0.01, "dt": -1.0}):
        with pytest.raises(InvalidInputError, match="StallBound"):
            StallBound(**arguments)


def test_rows_of_the_rank_clearance_give_way_before_the_arms_part() -> None:
    lift = paper_lift(duration=1.5)
    contradiction = Rows([-np.inf, 0.1], [-0.1, np.inf], Rank.CLEARANCE)
    controller = made(lift, contradiction)
    for _ in range(100):
        step = controller.step()
        assert step.given_up.chain == 0.0
        assert step.status is not Status.HOLDING
        assert worth(controller, step)[0] <= 1e-6
    assert any(b.name == "rows" for b in step.binding)


def test_rows_of_the_rank_limits_are_never_broken_by_more_than_rounding() -> None:
    lift = paper_lift(duration=1.5)
    controller = made(lift, Rows([-0.02], [0.02]), preview=None)
    for _ in range(300):
        assert abs(float(controller.step().velocity[0])) <= 0.02 + 1e-8


@pytest.mark.parametrize("solver", slow_but_first(sorted({"ldp", "daqp"} & set(available_solvers()), reverse=True)))
@pytest.mark.parametrize("shortcut", [True, False])
def test_rows_hold_with_any_solver_and_without_the_shortcut(solver: str, shortcut: bool) -> None:
    lift = paper_lift(duration=1.5)
    controller = made(lift, ElbowSpeed(0.03), solver=solver, shortcut=shortcut)
    for _ in range(150):
        step = controller.step()
        assert np.abs(elbow(CellState(lift.cell, step.q)) @ step.velocity).max() <= 0.03 + 1e-7
        assert worth(controller, step)[0] <= 1e-6


@pytest.mark.parametrize(
    "broken", [ValueError("no"), None, (1, 2, 3), (np.full((1, 18), np.nan), np.zeros(1), np.zeros(1)), "rows"]
)
def test_a_constraint_that_fails_holds_by_name_until_it_answers_again(broken: Any) -> None:
    lift = paper_lift(duration=1.5)
    constraint = Rows([-9.0], [9.0])
    controller = made(lift, constraint, acceleration=10.0)
    for _ in range(100):
        controller.step()
    constraint.broken = broken if broken is not None else (np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    held = [controller.step() for _ in range(60)]
    assert all(step.status is Status.HOLDING and "rows" in step.reason for step in held)
    assert np.abs(held[-1].velocity).max() <= 1e-5
    assert worth(controller, held[-1])[0] <= 1e-6
    constraint.broken = None
    after = [controller.step() for _ in range(100)]
    assert after[-1].status in (Status.SLOWED, Status.TRACKING)


def test_what_is_no_constraint_is_refused_by_name() -> None:
    lift = paper_lift(duration=1.5)
    bad = Rows([-1.0], [1.0])
    bad.rank = Rank.PATH
    for item in (object(), bad):
        with pytest.raises(InvalidInputError, match=r"constraints\[0\]"):
            made(lift, item)
    bad = Rows([1.0], [-1.0])
    with pytest.raises(InvalidInputError, match="rows"):
        made(lift, bad)
