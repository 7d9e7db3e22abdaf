"""The load bounds the speed: lines that are safe and tight, a controller that slows, a timing that is the fastest."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from cells import box_of

from coopqp import (
    InvalidInputError,
    Knot,
    LinePath,
    QPController,
    RateBound,
    Status,
    inverse_kinematics,
    plan,
    simulate,
)
from coopqp.errors import UnreachableError
from coopqp.forces import Grip, LoadBound, LoadShare, load_use
from coopqp.model import CellState
from coopqp.planning import time_path
from coopqp.scenarios import Scenario
from coopqp.spatial import Array


def heavy(paper: Scenario, mass: float, **settings: Any) -> LoadShare:
    return LoadShare(paper.cell, paper.grasp, box_of(paper, mass), **{"internal_force": 50.0, **settings})


def knot_of(paper: Scenario, load: LoadShare, rng: np.random.Generator) -> Knot:
    """A knot in mid-lift with a random motion of the object."""
    q = inverse_kinematics(paper.cell, paper.grasp, paper.path.pose(1.0), paper.q_start)
    slope, curvature = load.joint_motion(q, twist=rng.uniform(-1, 1, 6), acceleration=rng.uniform(-1, 1, 6))
    return Knot(1.0, CellState(paper.cell, q), slope, curvature)


def carried(load: LoadShare, knot: Knot, z: float, change: float) -> bool:
    """Whether there is a share of the load at a rate and its change, under the cones themselves."""
    v, dv = knot.slope * np.sqrt(z), knot.slope * change + knot.curvature * z
    twist, acceleration = load.object_motion(knot.state.q, v, dv)
    try:
        shared = load.share(
            knot.state.q, twist=twist, acceleration=acceleration, joint_velocity=v, joint_acceleration=dv
        )
    except UnreachableError:  # too fast for the arms alone
        return False
    return shared.share > 1.0 - 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("palms", [False, True])
def test_every_point_within_the_lines_can_be_carried_and_few_beyond(
    paper: Scenario, rng: np.random.Generator, palms: bool
) -> None:
    grips = [Grip(kind="palm", friction=0.6, radius=0.1)] * 3 if palms else None
    load = heavy(paper, 20.0 if palms else 40.0, grips=grips, internal_force=300.0 if palms else 50.0)
    bound = LoadBound(load)
    for _ in range(2):
        knot = knot_of(paper, load, rng)
        corners = bound.polygon(knot)
        assert corners is not None
        a, b, c = bound.lines(knot)
        assert (c >= -1e-9).all()
        for weights in rng.dirichlet(np.full(len(corners), 0.3), 6):
            z, change = weights @ corners
            assert (a * z + b * change <= c + 1e-9 * np.abs(c).max()).all()
            assert carried(load, knot, z, change)
        assert carried(load, knot, 0.0, 0.0)
        beyond = [carried(load, knot, 1.12 * z, 1.12 * change) for z, change in corners if abs(z) + abs(change) > 1e-6]
        assert not any(beyond)
        for z, change in 1.001 * corners[np.abs(corners).sum(axis=1) > 1e-6]:
            assert (a * z + b * change > c * (1.0 - 1e-9)).any()


def test_a_bound_is_a_rate_bound_and_says_where_nothing_can_be_held(paper: Scenario, rng: np.random.Generator) -> None:
    load = heavy(paper, 40.0)
    assert isinstance(LoadBound(load), RateBound)
    assert LoadBound(load).name == "load"
    knot = knot_of(paper, load, rng)
    assert LoadBound(heavy(paper, 90.0)).polygon(knot) is None
    a, b, c = LoadBound(heavy(paper, 90.0)).lines(knot)
    assert (a, b, c) == (0.0, 0.0, -1.0)
    full, part = LoadBound(load).lines(knot)[2], LoadBound(load, share=0.9).lines(knot)[2]
    np.testing.assert_allclose(part, 0.9 * full)
    with pytest.raises(InvalidInputError, match="share"):
        LoadBound(load, share=1.5)
    with pytest.raises(InvalidInputError, match="LoadShare"):
        LoadBound("load")  # type: ignore[arg-type]


# -- the controller ----------------------------------------------------------------------------------------------------


def quick(paper: Scenario, duration: float) -> LinePath:
    return LinePath.displaced(
        paper.path.pose(0.0), translation=(0, 0, 0.3), rotation=(-0.7, 0, 0), duration=duration, time_law="quintic"
    )


@pytest.mark.slow
def test_a_payload_that_is_too_heavy_for_a_speed_slows_the_object_and_says_so(paper: Scenario) -> None:
    path, durations = quick(paper, 0.7), []
    cell = paper.cell.with_limits(acceleration=60.0)
    for mass in (5.0, 45.0):
        load = heavy(paper, mass)
        statuses: list[tuple[Status, str]] = []
        controller = QPController(cell, paper.grasp, path, dt=0.005, constraints=[LoadBound(load, share=0.95)])
        run = simulate(
            controller, q_start=paper.q_start, observe=lambda s, seen=statuses: seen.append((s.status, s.explain()))
        )
        assert run.finished
        durations.append(run.time[-1])
        slowed = [text for status, text in statuses if status is Status.SLOWED]
        assert any("constraint load" in text for text in slowed) == (mass == 45.0)
        use = load_use(load, run.time, run.q_command)
        assert use.feasible
        assert use.joint.max() <= 1.0 + 1e-9
    assert durations[0] == pytest.approx(0.7, abs=0.02)
    assert durations[1] > 1.2 * durations[0]


@pytest.mark.slow
def test_without_the_bound_the_same_payload_is_too_heavy(paper: Scenario) -> None:
    controller = QPController(paper.cell.with_limits(acceleration=60.0), paper.grasp, quick(paper, 0.7), dt=0.005)
    run = simulate(controller, q_start=paper.q_start)
    use = load_use(heavy(paper, 45.0), run.time, run.q_command)
    assert not use.feasible
    assert "too heavy from" in use.figures()


def test_an_object_that_cannot_be_held_does_not_start(paper: Scenario) -> None:
    bound = LoadBound(heavy(paper, 90.0))
    controller = QPController(paper.cell, paper.grasp, quick(paper, 2.0), dt=0.01, constraints=[bound])
    run = simulate(controller, q_start=paper.q_start, patience=0.3)
    assert not run.finished
    assert run.clock[-1] == 0.0
    assert "constraint load" in " ".join(run.notes)


# -- the timing --------------------------------------------------------------------------------------------------------


def carried_along(load: LoadShare, paper: Scenario, path: Any) -> Any:
    clocks, q = np.linspace(0.0, path.duration, 60), [paper.q_start]
    for clock in clocks[1:]:
        q.append(inverse_kinematics(paper.cell, paper.grasp, path.pose(clock), q[-1], limits=False))
    return load_use(load, clocks, np.array(q))


@pytest.mark.slow
def test_the_fastest_lifts_of_the_paper_s_cell(paper: Scenario) -> None:
    """By torque limits alone, 50 N of internal force: slower with each kilogram, and admissible all the way."""
    cell, durations = paper.cell.with_limits(velocity=1e3, acceleration=1e4), []
    for mass in (20.0, 40.0, 48.0, 53.0):
        load = LoadShare(cell, paper.grasp, box_of(paper, mass), internal_force=50.0)
        path = time_path(
            cell, paper.grasp, paper.path, q_start=paper.q_start, bounds=[LoadBound(load)], share=1.0, knots=60
        )
        durations.append(path.duration)
        assert {str(limit) for limit in path.profile.binding} == {"constraint load"}
        use = carried_along(load, paper, path)
        # The ends of a difference quotient reach over the start and the end, where the acceleration jumps.
        assert use.share[2:-2].min() > 0.995
        assert use.joint[2:-2].max() > 0.98
    np.testing.assert_allclose(durations, [0.325, 0.460, 0.571, 0.688], rtol=0.02)
    with pytest.raises(UnreachableError, match=r"to hold its share|cannot rest"):
        time_path(cell, paper.grasp, paper.path, q_start=paper.q_start, payload=box_of(paper, 53.0), knots=60)
    heaviest = LoadBound(LoadShare(cell, paper.grasp, box_of(paper, 90.0), internal_force=50.0))
    with pytest.raises(UnreachableError, match="load: the object cannot rest 0 m along the path"):
        time_path(cell, paper.grasp, paper.path, q_start=paper.q_start, bounds=[heaviest], knots=60)


@pytest.mark.slow
def test_a_bound_is_one_limit_among_others(paper: Scenario) -> None:
    cell = paper.cell.with_limits(acceleration=20.0)
    load = LoadShare(cell, paper.grasp, box_of(paper, 45.0), internal_force=50.0)
    common: Any = {"q_start": paper.q_start, "knots": 60}
    free = plan(cell, paper.grasp, paper.path, **common)
    bound = plan(cell, paper.grasp, paper.path, bounds=[LoadBound(load)], **common)
    assert bound.path.duration > 1.05 * free.path.duration
    names = set(bound.binding_times())
    assert "constraint load" in names
    assert any("acceleration" in name for name in names)
    with pytest.raises(InvalidInputError, match="jerk"):
        time_path(cell, paper.grasp, paper.path, bounds=[LoadBound(load)], jerk=100.0, **common)


def test_a_bound_of_one_s_own_counts_in_the_timing(paper: Scenario) -> None:
    """A limit of σ gives the time of a trapezoid without its ramps; a knot has the clock of a run at constant speed."""
    knots: list[Knot] = []

    class Slow:
        name = "slow"

        def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
            knots.append(knot)
            return np.array([1.0]), np.array([0.0]), np.array([0.1**2])  # σ ≤ 0.1

    cell = paper.cell.with_limits(acceleration=50.0)
    path = time_path(cell, paper.grasp, paper.path, q_start=paper.q_start, bounds=[Slow()], share=1.0, knots=60)
    assert path.duration == pytest.approx(paper.path.duration / 0.1, rel=0.05)
    clocks = np.array([knot.clock for knot in knots])
    assert (clocks.min(), clocks.max()) == pytest.approx((0.0, paper.path.duration))
    for last, knot in itertools.pairwise(knots):
        if knot.clock > last.clock:
            assert knot.span == pytest.approx(knot.clock - last.clock)
            between = knot.state.q - last.state.q
            np.testing.assert_allclose(between / knot.span, 0.5 * (knot.slope + last.slope), atol=1e-3)


@pytest.mark.parametrize("slowest", [0, 1, 2])
def test_the_bound_that_binds_is_named(paper: Scenario, slowest: int) -> None:
    class Slow:
        def __init__(self, k: int) -> None:
            self.name, self.rate = f"bound {k}", 0.05 if k == slowest else 0.1 + 0.1 * k

        def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
            return np.array([1.0]), np.array([0.0]), np.array([self.rate**2])

    cell = paper.cell.with_limits(acceleration=50.0)
    bounds = [Slow(k) for k in range(3)]
    path = time_path(cell, paper.grasp, paper.path, q_start=paper.q_start, bounds=bounds, share=1.0, knots=30)
    named = {limit.name for limit in path.profile.binding[5:-5] if limit is not None}
    assert named == {f"bound {slowest}"}


@pytest.mark.parametrize("duration", [1.0, 4.0])
def test_a_bound_in_joint_speeds_does_not_hang_on_the_path_s_own_time(paper: Scenario, duration: float) -> None:
    class Gentle:
        name = "gentle"

        def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
            return knot.slope[:6] ** 2, np.zeros(6), np.full(6, 0.1**2)  # |q̇| ≤ 0.1 rad/s

    cell = paper.cell.with_limits(acceleration=50.0)
    motion = LinePath(paper.path.pose(0.0), paper.path.pose(paper.path.duration), duration=duration)
    path = time_path(cell, paper.grasp, motion, q_start=paper.q_start, bounds=[Gentle()], share=1.0, knots=60)
    slow = cell.with_limits(velocity=np.where(np.arange(18) < 6, 0.1, cell.limits.velocity))
    own = time_path(slow, paper.grasp, motion, q_start=paper.q_start, share=1.0, knots=60)
    assert path.duration == pytest.approx(own.duration, rel=5e-3)  # speeds are refined between knots


def test_a_bound_that_fails_is_named(paper: Scenario) -> None:
    cell = paper.cell.with_limits(acceleration=50.0)

    class Bad:
        name = "bad"

        def __init__(self, c: Any) -> None:
            self.c = c

        def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
            return np.array([1.0]), np.array([0.0]), np.array([float(self.c)])

    for c, why in ((np.nan, "bad: its a, b and c are not finite"), ("one", "bad raised ValueError: could not convert")):
        with pytest.raises(InvalidInputError, match=why):
            time_path(cell, paper.grasp, paper.path, q_start=paper.q_start, bounds=[Bad(c)], knots=60)
