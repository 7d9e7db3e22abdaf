"""The preview: its caps agree with brute-force path timing; stops at limits, corners, ends and singularities."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from user_paths import Opaque

from coopqp import (
    InvalidInputError,
    LimitKind,
    ObjectPath,
    PreviewOptions,
    QPController,
    QPOptions,
    ServoPath,
    Status,
    WaypointPath,
)
from coopqp.model.chain import Chain
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, at_limit, dual_arm7, paper_lift
from coopqp.simulation import chain_error, path_error, tool_placements
from coopqp.spatial import Array

pytestmark = pytest.mark.core

DT = 0.002


# -- the caps ----------------------------------------------------------------------------------------------------------


# -- stops -------------------------------------------------------------------------------------------------------------


# -- corners, ends, standstill -----------------------------------------------------------------------------------------


def zigzag(start: pin.SE3) -> WaypointPath:
    shifts = ((0.0, 0.0, 0.0), (0.06, 0.0, 0.05), (0.0, 0.05, 0.0), (-0.05, 0.0, 0.05))
    poses = [pin.SE3(start.rotation, start.translation + np.array(s)) for s in shifts]
    return WaypointPath(poses, durations=[0.3, 0.3, 0.3], time_law=TimeLaw.LINEAR)


# -- the reference of redundant arms -----------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [0, 2, 4, 6, 7, 9, 13])
def test_redundant_arms_use_their_freedom_at_limits(joint: int) -> None:
    """A limit that least norm would meet half way: the arm moves past it, on its path and inside all limits."""
    task = dual_arm7(duration=1.5)
    wanted = run_through(task)[:, joint] - task.q_start[joint]
    lower, upper = task.cell.limits.lower.copy(), task.cell.limits.upper.copy()
    half_way = 0.5 * float(wanted[np.abs(wanted).argmax()])
    side = upper if half_way > 0.0 else lower
    side[joint] = task.q_start[joint] + half_way
    cell = task.cell.with_limits(lower=lower, upper=upper, acceleration=10.0)
    x = run_through(replace(task, cell=cell))
    assert (x <= cell.limits.upper + 1e-9).all()
    assert (x >= cell.limits.lower - 1e-9).all()
    O = Chain(cell, task.grasp)
    assert np.abs(O.errors(O.carried(x[-1]), task.path.pose(task.path.duration))).max() < 1e-6


def run_through(task: Scenario) -> Array:
    """Positions (T, nv) of a run that is finished."""
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished:
        steps.append(controller.step())
        assert len(steps) < 2000, steps[-1].explain()
    return np.array([s.q_next for s in steps])


# -- in the controller -------------------------------------------------------------------------------------------------


def test_an_object_that_stops_for_good_is_blocked_a_little_before() -> None:
    """From ten times the blocked rate on; until then it is slowed."""
    task = at_limit()
    controller = QPController(task.cell, task.grasp, task.path, dt=DT)
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(1500)]
    first = next(i for i, step in enumerate(steps) if step.status is Status.BLOCKED)
    assert steps[first].rate < 10.0 * controller.options.blocked_rate <= steps[first - 1].rate
    assert {step.status for step in steps[first:]} == {Status.BLOCKED}


def test_what_the_preview_is_for() -> None:
    """Under acceleration limits and without preview, the object leaves its path at a corner. The chain holds."""
    task = paper_lift()
    cell, path = task.cell.with_limits(acceleration=5.0), zigzag(task.path.pose(0.0))
    off_path = {}
    for preview in (PreviewOptions(), None):
        controller = QPController(cell, task.grasp, path, dt=DT, options=QPOptions(preview=preview))
        controller.reset(task.q_start)
        steps = [controller.step() for _ in range(600)]
        tools = tool_placements(cell, [s.q_next for s in steps])
        assert max(chain_error(T, task.grasp)[0] for T in tools) < 1e-6
        off_path[preview is None] = max(
            path_error(T, task.grasp, path, s.clock_next)[0] for T, s in zip(tools, steps, strict=True)
        )
    assert off_path[False] < 1e-6
    assert off_path[True] > 1e-3


def test_at_a_velocity_limit_the_rate_does_not_chatter() -> None:
    """One joint's speed slows most of the path. The rate changes direction only if the path requires it."""
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(velocity=0.35, acceleration=5.0))
    controller = QPController(task.cell, task.grasp, task.path, dt=DT)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished:
        steps.append(controller.step())
    rates = np.array([s.rate for s in steps])
    slowed = rates < 0.999
    assert slowed.mean() > 0.5
    change = np.diff(rates)[np.abs(np.diff(rates)) > 1e-4]
    assert (np.sign(change[1:]) != np.sign(change[:-1])).sum() <= 4
    acceleration = np.diff([s.velocity for s in steps], axis=0) / DT
    assert np.sqrt((acceleration**2).mean()) < 0.4  # of 5 rad/s²; 0.7 with chatter


@pytest.mark.parametrize("acceleration", [5.0, np.inf])
def test_the_object_keeps_its_path_at_corners(acceleration: float) -> None:
    task = paper_lift()
    cell, path = task.cell.with_limits(acceleration=acceleration), zigzag(task.path.pose(0.0))
    controller = QPController(cell, task.grasp, path, dt=DT)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < 3000:
        steps.append(controller.step())
    assert steps[-1].finished
    assert all(s.given_up.off_path == (0.0,) * 6 for s in steps)
    for tools, s in zip(tool_placements(cell, [s.q_next for s in steps]), steps, strict=True):
        assert path_error(tools, task.grasp, path, s.clock_next)[0] < 3e-6


def test_an_object_that_almost_stops_at_a_corner_can_go_on() -> None:
    """Where joints take a corner at less than 1e-3 of the rate."""
    task = paper_lift()
    start = task.path.pose(0.0)
    poses = [
        pin.SE3(start.rotation, start.translation + np.array(way)) for way in ([0, 0, 0], [0.01, 0, 0], [0, 0, 0.01])
    ]
    path = WaypointPath(poses, durations=[0.03, 0.03], time_law="linear")
    cell = task.cell.with_limits(acceleration=0.2)
    controller = QPController(cell, task.grasp, path, dt=0.0005)
    controller.reset(task.q_start)
    steps = [controller.step()]
    while not steps[-1].finished and len(steps) < 5000:
        steps.append(controller.step())
    assert steps[-1].finished
    assert min(s.rate for s in steps[20:]) < 1e-3
    assert {s.status for s in steps} <= {Status.SLOWED, Status.TRACKING}


class Fold(ObjectPath):
    """Out on a straight line and back on another, at full speed over the corner; it may not tell the corner."""

    def __init__(self, start: pin.SE3, angle: float, *, says: bool) -> None:
        self.duration, self._start, self._says = 1.3, start, says
        end = pin.SE3(start.rotation, start.translation + np.array([0.2, 0.0, 0.0]))
        self._law = WaypointPath([start, end], durations=[1.3])
        self._ways = np.array([[0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]])

    def pose(self, clock: float) -> pin.SE3:
        far = self._law.pose(clock).translation[0] - self._start.translation[0]
        way = min(far, 0.08) * self._ways[0] + max(far - 0.08, 0.0) * self._ways[1]
        return pin.SE3(self._start.rotation, self._start.translation + way)

    def twist(self, clock: float) -> Array:
        far = self._law.pose(clock).translation[0] - self._start.translation[0]
        speed = (self._start.rotation @ self._law.twist(clock)[:3])[0]
        return np.append(self._start.rotation.T @ self._ways[int(far >= 0.08)] * speed, np.zeros(3))

    def next_breakpoint(self, clock: float) -> float:
        if not self._says:
            return self.duration
        low, high = 0.0, self.duration  # clock of the corner
        for _ in range(60):
            middle = 0.5 * (low + high)
            far = self._law.pose(middle).translation[0] - self._start.translation[0]
            low, high = (middle, high) if far < 0.08 else (low, middle)
        return high if clock < high else self.duration


@pytest.mark.parametrize("angle", [0.2, 3.0])
def test_a_corner_that_a_users_path_does_not_tell_is_taken_like_a_told_one(angle: float) -> None:
    """An almost reversed one stopped the object for good, and was called an end of the reach."""
    task, times = paper_lift(), []
    cell = task.cell.with_limits(acceleration=5.0)
    for says in (True, False):
        path = Fold(task.path.pose(0.0), angle, says=says)
        controller = QPController(cell, task.grasp, path, dt=0.004)
        controller.reset(task.q_start)
        steps = [controller.step()]
        while not steps[-1].finished and len(steps) < 600:
            steps.append(controller.step())
        times.append(len(steps))
        assert steps[-1].finished
        assert {b.kind for s in steps for b in s.binding} <= {LimitKind.ACCELERATION, LimitKind.VELOCITY}
        for tools, s in zip(tool_placements(cell, [s.q_next for s in steps]), steps, strict=True):
            assert path_error(tools, task.grasp, path, s.clock_next)[0] < 3e-7
    assert abs(times[1] - times[0]) <= 1


class Looked:
    """A bound on the rate that bounds nothing, and keeps the clocks that it is asked for."""

    name = "looked"

    def __init__(self) -> None:
        self.clocks: list[float] = []

    def lines(self, knot: Any) -> tuple[Array, Array, Array]:
        self.clocks.append(knot.clock)
        return np.zeros(0), np.zeros(0), np.zeros(0)


def test_paths_that_are_not_known_ahead_have_no_preview() -> None:
    task = paper_lift()
    start = task.path.pose(0.0)
    paths: list[tuple[ObjectPath, bool]] = [
        (Opaque(task.path, known_ahead=False), False),
        (ServoPath(start), True),
        (task.path, True),
    ]
    for path, known in paths:
        looked = Looked()
        controller = QPController(task.cell, task.grasp, path, dt=DT, constraints=[looked])
        controller.reset(task.q_start)
        steps = [controller.step() for _ in range(20)]
        assert any(clock > 0.0 for clock in looked.clocks) is known
        if known:
            assert max(looked.clocks) > steps[-1].clock_next + 20 * DT
    controller = QPController(
        task.cell, task.grasp, task.path, dt=DT, options=QPOptions(preview=None), constraints=[looked]
    )
    controller.reset(task.q_start)
    looked.clocks.clear()  # reset asks once, to see whether it answers
    controller.step()
    assert not looked.clocks


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell", 0.0),
        ("cell", "long"),
        ("joint_step", -1.0),
        ("shortest", np.nan),
        ("rate_slope", np.inf),
        ("margin", 1.5),
        ("curvature_share", 0.0),
        ("singular_rate", 2.0),
        ("newton_steps", 0),
    ],
)
def test_bad_options(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"PreviewOptions: {name}"):
        PreviewOptions(**{name: value})
