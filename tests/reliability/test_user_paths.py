"""Row I7: paths of a user's own. A wrong one is refused when it is built; what it does later leads to a status."""

from __future__ import annotations

import copy
import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import cooperative, limited

from coopqp import (
    ControlStep,
    InvalidInputError,
    LimitKind,
    LinePath,
    ObjectPath,
    Status,
    check_path,
)
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation.evaluation.metrics import chain_errors, errors_from, object_poses, tool_matrices
from coopqp.spatial import Array

DT = 0.005
#: A hold is judged until the arms have stood for this number of steps, or for this number of steps in all.
STANDING, HELD = 30, 120


class Own(ObjectPath):
    """A path that does what its owner tells it, from a clock on."""

    def __init__(self, task: Scenario, *, known_ahead: bool = True) -> None:
        self.inner = task.path
        self.duration = task.path.duration
        self.known_ahead = known_ahead
        self.spoil: Callable[[float], Any] | None = None
        self.spoil_twist: Callable[[float], Any] | None = None
        self.since = 0.0

    def pose(self, clock: float) -> Any:
        if self.spoil is not None and clock >= self.since:
            return self.spoil(clock)
        return self.inner.pose(clock)

    def twist(self, clock: float) -> Any:
        if self.spoil_twist is not None and clock >= self.since:
            return self.spoil_twist(clock)
        return self.inner.twist(clock)


class OwnError(Exception):
    """An error that nothing but its owner knows."""


class Mute(Exception):  # noqa: N818
    def __str__(self) -> str:
        raise RuntimeError("no words")


def raising(error: BaseException) -> Callable[[float], Any]:
    def spoil(clock: float) -> Any:
        raise error

    return spoil


def broken(start: pin.SE3) -> dict[str, Callable[[float], Any]]:
    """What a path may do instead of returning a pose."""
    shear = start.homogeneous.copy()
    shear[0, 1] += 0.1
    nan = pin.SE3(start)
    nan.translation = np.array([np.nan, 0.0, 0.0])
    skewed = pin.SE3(start)
    skewed.rotation = 2.0 * np.eye(3)
    far = pin.SE3(start.rotation, np.array([1e12, 0.0, 0.0]))
    return {
        "raises": raising(RuntimeError("no data")),
        "raises its own": raising(OwnError("no data")),
        "raises without words": raising(Mute()),
        "divides by zero": lambda clock: 1.0 / 0.0,
        "runs out": lambda clock: [start][7],
        "None": lambda clock: None,
        "4x4": lambda clock: start.homogeneous,
        "a sheared matrix": lambda clock: shear,
        "NaN": lambda clock: nan,
        "not a rotation": lambda clock: skewed,
        "far away": lambda clock: far,
        "a word": lambda clock: "up",
        "three numbers": lambda clock: np.zeros(3),
    }


def broken_twists() -> dict[str, Callable[[float], Any]]:
    return {
        "twist raises": raising(OwnError("no data")),
        "twist is None": lambda clock: None,
        "twist is NaN": lambda clock: np.full(6, np.nan),
        "twist of three": lambda clock: np.zeros(3),
        "twist of 1e300": lambda clock: np.full(6, 1e300),
        "twist is a word": lambda clock: "up",
    }


def spoiled(path: Own, name: str) -> Own:
    start = path.inner.pose(0.0)
    path.spoil, path.spoil_twist = broken(start).get(name), broken_twists().get(name)
    assert path.spoil or path.spoil_twist
    return path


WAYS = [*broken(pin.SE3.Identity()), *broken_twists()]


# -- when it is built --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WAYS)
def test_a_broken_path_is_refused_when_it_is_built(name: str) -> None:
    task = paper_lift()
    for since in (0.0, 0.6 * task.path.duration):
        path = spoiled(Own(task), name)
        path.since = since
        with pytest.raises(InvalidInputError, match=r"QPController: path: .*path"):
            cooperative(task, path=path, dt=DT)


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan, "long", None])
def test_a_path_without_a_duration_is_refused(duration: Any) -> None:
    task = paper_lift()
    path = Own(task)
    path.duration = duration
    with pytest.raises(InvalidInputError, match="duration"):
        cooperative(task, path=path, dt=DT)


def test_a_duration_may_be_any_number() -> None:
    task = paper_lift()
    for duration in (np.float32(2.0), 2, np.int64(2), np.float64(2.0)):
        path = Own(task)
        path.duration = duration
        cooperative(task, path=path, dt=DT)


def test_a_path_whose_duration_raises_is_refused() -> None:
    class Strange(Own):
        duration = property(raising(OwnError("who knows")), lambda self, value: None)  # type: ignore[assignment, arg-type]

    with pytest.raises(InvalidInputError, match="OwnError: who knows"):
        cooperative(paper_lift(), path=Strange(paper_lift()), dt=DT)


def wrong_twists(path: ObjectPath) -> dict[str, Callable[[float], Array]]:
    """Twists that one gets wrong."""
    duration = path.duration

    def in_the_world(clock: float) -> Array:
        R = path.pose(clock).rotation
        return np.concatenate([R @ path.twist(clock)[:3], R @ path.twist(clock)[3:]])

    def swapped(clock: float) -> Array:
        return np.roll(path.twist(clock), 3)

    return {
        "in the world's axes": in_the_world,
        "angular part first": swapped,
        "backwards": lambda clock: -path.twist(clock),
        "per share of the duration": lambda clock: duration * path.twist(clock),
        "in millimetres": lambda clock: np.concatenate([1e3 * path.twist(clock)[:3], path.twist(clock)[3:]]),
        "in degrees": lambda clock: np.concatenate([path.twist(clock)[:3], np.rad2deg(path.twist(clock)[3:])]),
        "at rest": lambda clock: np.zeros(6),
        "without turning": lambda clock: np.concatenate([path.twist(clock)[:3], np.zeros(3)]),
    }


@pytest.mark.parametrize("name", wrong_twists(paper_lift().path))
def test_twists_that_are_not_those_of_the_poses_are_refused(name: str) -> None:
    for make in (paper_lift, dual_arm7, mixed_cell):
        task = make()
        start = pin.SE3(pin.exp3(np.array([0.3, 0.4, 1.5])) @ task.path.pose(0.0).rotation, np.zeros(3))
        inner = LinePath.displaced(start, translation=(0.1, 0.2, 0.3), rotation=(0.4, -0.2, 0.3), duration=2.5)
        path = Own(dataclasses.replace(task, path=inner))
        path.spoil_twist = wrong_twists(inner)[name]
        with pytest.raises(InvalidInputError, match="its poses change by"):
            cooperative(task, path=path, dt=DT)


def test_right_twists_are_accepted() -> None:
    """Also of paths that turn fast, stand still, have corners or noise, or jump here and there."""
    rng = np.random.default_rng(0)
    for make in (paper_lift, dual_arm7, mixed_cell):
        task = make()
        for law in ("linear", "quintic"):
            for turn in (0.0, 0.5, 3.0):
                for duration in (0.2, 3.0, 600.0):
                    line = LinePath.displaced(
                        task.path.pose(0.0), translation=0.3 * rng.standard_normal(3),
                        rotation=turn * rng.uniform(-1.0, 1.0, 3), duration=duration, time_law=law,
                    )  # fmt: skip
                    cooperative(task, path=Own(dataclasses.replace(task, path=line)), dt=DT)
        jumping = Own(task)
        jumping.since = 0.5 * task.path.duration
        jumping.spoil = lambda clock, task=task: task.path.pose(clock) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
        cooperative(task, path=jumping, dt=DT)


@pytest.mark.slow
def test_follow_refuses_a_broken_path_and_the_old_one_goes_on() -> None:
    task = limited(mixed_cell(), 10.0)
    moving = cooperative(task, path=task.path, dt=DT)
    moving.reset(task.q_start)
    for _ in range(40):
        moving.step()
    for name in (*WAYS, "no path"):
        controller, other = copy.deepcopy(moving), copy.deepcopy(moving)
        with pytest.raises(InvalidInputError, match="follow"):
            controller.follow(None if name == "no path" else spoiled(Own(task), name))  # type: ignore[arg-type]
        for _ in range(20):
            assert np.array_equal(controller.step().velocity, other.step().velocity), name


def test_reset_on_a_path_that_fails_by_then_is_a_named_error() -> None:
    task = paper_lift()
    path = Own(task)
    controller = cooperative(task, path=path, dt=DT)
    spoiled(path, "raises its own")
    with pytest.raises(InvalidInputError, match="OwnError: no data"):
        controller.reset(task.q_start)
    path.spoil = None
    controller.reset(task.q_start)
    assert controller.step().status is not Status.HOLDING


# -- in motion ---------------------------------------------------------------------------------------------------------


def judged(task: Scenario, steps: Sequence[ControlStep]) -> tuple[int, float]:
    """How many of the steps after the first are wrong, and how far the arms part in all of them [m].

    Right is a command that is finite and within its limits, and a stop that has a name.
    """
    limits = task.cell.limits
    q, v = np.array([s.q_next for s in steps]), np.array([s.velocity for s in steps])
    x, dt = np.array([task.cell.positions(row) for row in q]), np.array([[s.dt] for s in steps])
    good = np.isfinite(q).all(axis=1) & np.isfinite(v).all(axis=1) & (np.abs(v) <= limits.velocity + 1e-9).all(axis=1)
    good &= ((x <= limits.upper + 1e-9) & (x >= limits.lower - 1e-9)).all(axis=1)
    change = np.abs(np.diff(v, axis=0, prepend=v[:1]))
    good &= (change <= limits.acceleration * dt * (1.0 + 1e-6) + 1e-9).all(axis=1)
    stops = (Status.HOLDING, Status.BLOCKED, Status.FAULT)
    good &= [s.status not in stops or bool(s.reason or s.binding) for s in steps]
    apart = chain_errors(tool_matrices(task.cell, np.array([s.q for s in steps])), task.grasp)[0]
    return int((~good[1:]).sum()), float(apart.max())


@pytest.mark.slow
@pytest.mark.parametrize("known_ahead", [True, False])
def test_a_path_that_breaks_in_motion_holds_and_goes_on(known_ahead: bool, catalogue: Any) -> None:
    """It breaks at once, or from a clock ahead on, and is mended after the arms have come to rest."""
    wrong, cases, longest, chain = 0, 0, 0, 0.0
    for make, acceleration in ((paper_lift, np.inf), (paper_lift, 10.0), (mixed_cell, 10.0)):
        task = limited(make(), acceleration)
        moving = cooperative(task, path=Own(task, known_ahead=known_ahead), dt=DT)
        moving.reset(task.q_start)
        last = [moving.step() for _ in range(61)][-1]
        broken = list(itertools.product(WAYS, (0.0, 0.15)))
        for name, ahead in broken:
            controller = copy.deepcopy(moving)
            path = controller.path
            assert isinstance(path, Own)
            spoiled(path, name)
            path.since = last.clock_next + ahead
            steps, standing = [last], 0
            while standing < STANDING and len(steps) <= HELD:
                steps.append(controller.step())
                stands = steps[-1].status is Status.HOLDING and bool((np.abs(steps[-1].velocity) <= 1e-6).all())
                standing = standing + 1 if stands else 0
            if path.spoil_twist is None or known_ahead:  # else nobody asks for the twist
                wrong += not any(s.status is Status.HOLDING and "path" in s.reason for s in steps)
                wrong += not stands
            path.spoil = path.spoil_twist = None
            count = 0
            while steps[-1].status is not Status.TRACKING and count < 3000:
                steps.append(controller.step())
                count += 1
            bad, apart = judged(task, steps)
            wrong, chain = wrong + bad + (steps[-1].status is not Status.TRACKING), np.maximum(chain, apart)
            longest, cases = max(longest, count), cases + 1
    assert chain < 1e-5
    ahead = "known ahead" if known_ahead else "not known ahead"
    name = f"a user's path, {ahead}, breaks in motion and is mended: an exception, no reason, no end"
    note = f"at full rate again within {longest} steps; arms apart by {1e3 * chain:.2g} mm at most"
    catalogue.row("I7", name, cases=cases, measured=wrong, target=0, note=note)


@pytest.mark.slow
def test_a_path_that_fails_now_and_then(catalogue: Any, count: Any) -> None:
    """Every hundredth to third question has no answer."""
    rng, wrong, cases, held = np.random.default_rng(1), 0, 0, 0
    for i in range(count(12)):
        task = limited((paper_lift, mixed_cell, dual_arm7)[i % 3](), (np.inf, 10.0)[i // 3 % 2])
        path = Own(task, known_ahead=i % 5 != 0)
        controller = cooperative(task, path=path, dt=DT)
        controller.reset(task.q_start)
        steps = [controller.step()]
        often = float(rng.choice([0.01, 0.1, 0.3]))

        def spoil(clock: float, path: Own = path, often: float = often) -> Any:
            if rng.uniform() < often:
                raise OwnError("now and then")
            return path.inner.pose(clock)

        path.spoil = spoil
        steps += [controller.step() for _ in range(150)]
        wrong, cases = wrong + judged(task, steps)[0], cases + 150
        held += sum(s.status is Status.HOLDING for s in steps[1:])
    name = "a user's path fails now and then: an exception, a limit, no reason"
    catalogue.row("I7", name, cases=cases, measured=wrong, target=0, note=f"{held} steps held")


@pytest.mark.slow
def test_a_path_that_jumps_stops_by_name_or_is_caught_up_with(catalogue: Any) -> None:
    wrong, cases, chain = 0, 0, 0.0
    for make in (paper_lift, mixed_cell):
        for acceleration in (np.inf, 10.0):
            for size in (1e-4, 1e-3, 0.01, 0.1, 1.0, 100.0):
                task = limited(make(), acceleration)
                path = Own(task)
                path.since = 0.5 * task.path.duration
                jump = pin.SE3(pin.exp3(np.full(3, 0.3 * min(size, 1.0))), np.array([size, 0.0, 0.0]))
                path.spoil = lambda clock, task=task, jump=jump: jump * task.path.pose(clock)
                controller = cooperative(task, path=path, dt=DT)
                controller.reset(task.q_start)
                steps = [controller.step()]
                while len(steps) < 701 and not (len(steps) > 1 and steps[-1].finished):
                    steps.append(controller.step())
                bad, apart = judged(task, steps)
                wrong, chain, cases, last = wrong + bad, np.maximum(chain, apart), cases + 1, steps[-1]
                named = any(b.kind is LimitKind.PATH_JUMP for b in last.binding) or "jumps" in last.reason
                wrong += not (last.finished if size <= 1e-3 else named)
                if last.status is Status.HOLDING:  # a path known ahead is asked once for what is ahead
                    path.spoil, count = None, 0
                    while last.status is not Status.TRACKING and count < 300:
                        last, count = controller.step(), count + 1
                    wrong += last.status is not Status.TRACKING
    assert chain < 1e-5
    name = "a user's path that jumps by 0.1 mm to 100 m: an exception, a limit, no name"
    note = f"arms apart by {1e3 * chain:.2g} mm at most"
    catalogue.row("I7", name, cases=cases, measured=wrong, target=0, note=note)


class Kinked(ObjectPath):
    """Straight lines at full speed, without a word of the corners between them."""

    def __init__(self, start: pin.SE3, rng: np.random.Generator, *, slight: bool) -> None:
        self.duration, self._start = float(rng.uniform(0.8, 1.6)), start
        corners = np.sort(rng.uniform(0.1, 0.9, 3)) * self.duration
        self._clocks = np.concatenate([[0.0], corners, [self.duration]])
        self._ways = 0.1 * rng.normal(size=3) + (0.005 if slight else 0.1) * rng.normal(size=(4, 3))

    def pose(self, clock: float) -> pin.SE3:
        spent = np.clip(clock - self._clocks[:-1], 0.0, np.diff(self._clocks))
        return pin.SE3(self._start.rotation, self._start.translation + spent @ self._ways)

    def twist(self, clock: float) -> Array:
        i = int(np.searchsorted(self._clocks[1:-1], clock, side="right"))
        inside = 0.0 <= clock < self.duration
        return np.concatenate([inside * (self._start.rotation.T @ self._ways[i]), np.zeros(3)])


@pytest.mark.slow
def test_corners_that_are_not_told(catalogue: Any, count: Any) -> None:
    rng, wrong, off, chain, run = np.random.default_rng(11), 0, 0.0, 0.0, 0
    for i in range(count(12)):
        task = limited((paper_lift, mixed_cell, dual_arm7)[i % 3](), 5.0)
        path = Kinked(task.path.pose(0.0), rng, slight=i % 2 == 1)
        if not check_path(task.cell, task.grasp, path, q_start=task.q_start).feasible:
            continue
        controller, run = cooperative(task, path=path, dt=DT), run + 1
        controller.reset(task.q_start)
        steps = [controller.step()]
        while len(steps) < 1501 and not (len(steps) > 1 and steps[-1].finished):
            steps.append(controller.step())
        bad, apart = judged(task, steps)
        wrong, chain = wrong + bad, np.maximum(chain, apart)
        wrong += sum(s.status not in (Status.TRACKING, Status.SLOWED) for s in steps[1:])
        wrong += sum(any(b.kind in (LimitKind.REACH, LimitKind.SINGULARITY) for b in s.binding) for s in steps[1:])
        held = object_poses(tool_matrices(task.cell, np.array([s.q for s in steps])), task.grasp)
        wanted = np.array([path.pose(s.clock).homogeneous for s in steps])
        off = np.maximum(off, errors_from(held, wanted)[0].max())
        wrong += not steps[-1].finished
    name = "a user's path with corners that it does not tell: off the path"
    note = f"arms apart by {1e3 * chain:.2g} mm at most; {wrong} steps or runs that stop, or name a wrong cause"
    catalogue.row("I7", name, cases=run, measured=1e3 * off, target=0.001, unit="mm", note=note)
    assert wrong == 0
    assert chain < 1e-5
