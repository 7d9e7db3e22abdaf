"""Long steps keep the chain, and joints without limits do not run away."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from marks import slow_but_first
from promise_cases import chain_cells

from coopqp import ControlStep, LinePath, ObjectPath, QPController, QPOptions, Status, WaypointPath
from coopqp.errors import MissingExtraError
from coopqp.scenarios import at_singularity, dual_arm7, mixed_cell, paper_lift
from coopqp.spatial import Array


@pytest.mark.parametrize(("dt", "bound"), [(0.02, 20e-6), (0.04, 50e-6), (0.06, 150e-6)])
def test_leaving_a_singularity_in_long_steps(dt: float, bound: float) -> None:
    """One linearisation parted the arms by 0.06 to 0.6 mm here."""
    for task in (at_singularity(), at_singularity("elbow")):
        given = chain_cells.Task(task.cell, task.grasp, task.path, task.q_start)
        made = QPController(task.cell, task.grasp, task.path, dt=dt)
        assert chain_cells.run(made, given, int(1.2 * task.path.duration / dt)).apart <= bound / 10.0


@pytest.mark.parametrize("seed", slow_but_first(range(4)))
def test_random_cells_in_long_steps(seed: int) -> None:
    try:
        task = chain_cells.long_steps(seed, ("ur3_limited", "panda") if seed % 2 == 0 else ("rx90l", "irb1600", "arm7"))
    except MissingExtraError:
        pytest.skip("the extra robots is not installed")
    for dt, bound in ((0.02, 20e-6), (0.04, 50e-6), (0.06, 150e-6)):
        made = QPController(task.cell, task.grasp, task.path, dt=dt)
        assert chain_cells.run(made, task, int(2.0 * task.path.duration / dt)).apart <= bound


@pytest.mark.parametrize("dt", [0.004, 0.01, 0.04])
def test_the_object_is_on_its_path_where_joints_bound_its_rate(dt: float) -> None:
    """Steps that took another share of the clock than expected led it off short waypoints by 3 to 700 µm."""
    task, rng = paper_lift(), np.random.default_rng(3)
    cell, start = task.cell.with_limits(acceleration=5.0), task.path.pose(0.0)
    poses = [start, *(start * chain_cells.near(rng, 0.02, 0.05) for _ in range(6))]
    path = WaypointPath(poses, durations=[0.03, 0.2, 0.03, 0.04, 0.3, 0.03], time_law="quintic")
    made = QPController(cell, task.grasp, path, dt=dt)
    made.reset(task.q_start)
    oracle, off, apart = chain_cells.Oracle(cell, task.grasp), 0.0, 0.0
    for _ in range(int(8.0 / dt)):
        step = made.step()
        points = np.array(oracle.points(step.q_next))
        off = max(off, float(np.abs(points - path.pose(step.clock_next).translation).max()))
        apart = max(apart, float(np.abs(points - points[0]).max()))
        if step.finished:
            break
    assert step.finished
    assert off < 1e-6
    assert apart < 1e-6


# -- joints without limits ---------------------------------------------------------------------------------------------


class Blind(ObjectPath):
    """A path that is not known ahead."""

    known_ahead = False

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration = path, path.duration

    def pose(self, clock: float) -> chain_cells.SE3:
        return self._path.pose(clock)

    def twist(self, clock: float) -> Array:
        return self._path.twist(clock)


@pytest.mark.parametrize("kind", slow_but_first(["elbow", "reach"]))
def test_joints_without_limits_do_not_run_away(kind: str) -> None:
    task, dt = at_singularity(kind), 0.004
    cell = task.cell.with_limits(velocity=np.inf, acceleration=np.inf)
    task = dataclasses.replace(task, cell=cell, path=Blind(task.path))
    made = QPController(cell, task.grasp, task.path, dt=dt)
    steps: list[ControlStep] = []
    given = chain_cells.Task(cell, task.grasp, task.path, task.q_start)
    run = chain_cells.run(made, given, 500, on=steps.append)
    speeds = np.array([np.abs(step.velocity).max() for step in steps])
    assert speeds.max() * dt <= 0.05 * (1.0 + 1e-12)
    held = np.array([step.status is Status.HOLDING for step in steps])
    for i in np.flatnonzero(held[1:]) + 1:
        assert speeds[i] <= max(1.0, 0.5 * speeds[i - 1]) * (1.0 + 1e-9)
    assert run.apart < 2e-3


@pytest.mark.parametrize("dt", [0.04, 0.06])
def test_joints_without_limits_move_by_the_cap_in_a_step_and_no_further(dt: float) -> None:
    """Straight ways at 1.5 m/s without look-ahead: one joint is at the cap, and all arms slow down for it."""
    rng, at_cap = np.random.default_rng(3), 0
    for make in (paper_lift, dual_arm7, mixed_cell):
        task, way = make(), rng.normal(size=3)
        cell = task.cell.with_limits(velocity=np.inf, acceleration=np.inf)
        way *= 0.15 / np.linalg.norm(way)
        path = LinePath.displaced(task.path.pose(0.0), translation=way, duration=0.1, time_law="linear")
        made = QPController(cell, task.grasp, path, dt=dt, options=QPOptions(preview=None))
        made.reset(task.q_start)
        for _ in range(12):
            step = made.step()
            moved = float(np.abs(step.velocity).max()) * step.dt
            assert moved <= 0.05 * (1.0 + 1e-12)
            if moved > 0.05 * (1.0 - 1e-9):
                at_cap += 1
                assert step.rate < 1.0
            assert step.commanded_apart < 2e-5
    assert at_cap >= 3
