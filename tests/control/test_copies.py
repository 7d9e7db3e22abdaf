"""A copy of a controller goes on bit for bit where the original stands, and shares nothing with it that changes."""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_unless
from processes import output
from runs import built, limited

from coopqp import (
    ControlStep,
    InvalidInputError,
    LinePath,
    ObjectPath,
    QPController,
    ServoPath,
    Status,
    SupervisionOptions,
    WaypointPath,
)
from coopqp.scenarios import Scenario, at_limit, at_singularity, dual_arm7, five_joint_pair, mixed_cell, paper_lift
from coopqp.spatial import Array

DT = 0.005
WAYS: dict[str, Callable[[QPController], QPController]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda controller: pickle.loads(pickle.dumps(controller)),
}
#: Feeds of a run: the measured configuration of step i, from the commands so far.
Feed = Callable[[int, list[Array]], Any]


def same(a: ControlStep, b: ControlStep) -> bool:
    """Bit for bit."""
    arrays = all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("q", "velocity", "q_next"))
    names = ("clock", "clock_next", "dt", "rate", "status", "reason", "binding", "given_up")
    return arrays and all(getattr(a, name) == getattr(b, name) for name in names)


def noisy(task: Scenario) -> Feed:
    noise = np.random.default_rng(0).uniform(-1e-4, 1e-4, (210, task.cell.nv))

    def feed(i: int, told: list[Array]) -> Any:
        return None if not told else task.cell.moved(told[-1], noise[i])

    return feed


def pushed(task: Scenario, when: int = 30, far: float = 0.1) -> Feed:
    """From one step on, one arm is seen far away."""

    def feed(i: int, told: list[Array]) -> Any:
        if not told:
            return None
        q = told[-1].copy()
        if i >= when:
            q[task.cell.q_slices[-1]] += far
        return q

    return feed


def zigzag(task: Scenario) -> WaypointPath:
    low, high = task.path.pose(0.0), task.path.pose(task.path.duration)
    middle = pin.SE3(low.rotation, low.translation + np.array([0.03, -0.02, 0.05]))
    return WaypointPath([low, middle, high], durations=[0.5, 1.5], time_law="linear")


RUNS: dict[str, Callable[[], tuple[QPController, Feed | None]]] = {
    "nominal": lambda: (built(paper_lift(), dt=DT), None),
    "looking ahead": lambda: (built(limited(mixed_cell(), 5.0), dt=DT), None),
    "corners": lambda: (built(limited(paper_lift(), 5.0), dt=DT, path=zigzag(paper_lift())), None),
    "slowed and blocked": lambda: (built(at_limit(), dt=DT), None),
    "past a singularity": lambda: (built(at_singularity(miss=0.02), dt=DT), None),
    "measured": lambda: (built(mixed_cell(), dt=DT), noisy(mixed_cell())),
    "always a QP": lambda: (built(limited(dual_arm7(), 10.0), dt=DT, shortcut=False), noisy(dual_arm7())),
    "held": lambda: (built(paper_lift(), dt=DT), pushed(paper_lift(), far=2e-3)),
    "in fault": lambda: (built(paper_lift(), dt=DT), pushed(paper_lift())),
    "forces": lambda: (
        built(paper_lift(), dt=DT, supervision=SupervisionOptions(stiffness=2e4)), pushed(paper_lift(), far=5e-3)
    ),
    "few joints": lambda: (built(five_joint_pair(), dt=DT), None),
}  # fmt: skip


def drive(controller: QPController, feed: Feed | None, begin: int, steps: int, told: list[Array]) -> list[ControlStep]:
    found = []
    for i in range(begin, begin + steps):
        found.append(controller.step(None if feed is None else feed(i, told)))
        told = [found[-1].q_next]
    return found


@pytest.mark.core
@pytest.mark.parametrize("run", slow_unless(lambda run: run in ("looking ahead", "measured", "always a QP"), RUNS))
def test_a_copy_goes_on_bit_for_bit(run: str) -> None:
    controller, feed = RUNS[run]()
    told: list[Array] = []
    ways = list(WAYS.values())
    for turn, begin in enumerate(range(0, 210, 14)):
        other = ways[turn % 3](controller)
        mine = drive(controller, feed, begin, 14, told)
        theirs = drive(other, feed, begin, 14, told)
        assert all(map(same, mine, theirs)), (run, begin)
        told = [mine[-1].q_next]
        controller = other if turn % 2 else controller


@pytest.mark.slow
@pytest.mark.parametrize("run", RUNS)
def test_a_copy_at_every_step_goes_on_bit_for_bit(run: str) -> None:
    """The preview grows in pieces of a Newton step: every piece is a place to copy at."""
    controller, feed = RUNS[run]()
    told: list[Array] = []
    for i in range(120):
        other = copy.copy(controller)
        step = drive(controller, feed, i, 1, told)[0]
        assert same(step, drive(other, feed, i, 1, told)[0]), (run, i)
        told = [step.q_next]
        if i % 3 == 0:
            controller = other


@pytest.mark.slow
@pytest.mark.parametrize("run", ["looking ahead", "corners", "past a singularity", "measured", "held"])
def test_copying_leaves_the_original_alone(run: str) -> None:
    watched, feed = RUNS[run]()
    alone, _ = RUNS[run]()
    told: list[Array] = []
    for i in range(150):
        a, b = drive(watched, feed, i, 1, told)[0], drive(alone, feed, i, 1, told)[0]
        assert same(a, b), i
        told = [a.q_next]
        copy.copy(watched)


def test_a_copy_after_another_path_and_after_other_targets() -> None:
    task = limited(mixed_cell(), 10.0)
    controller = built(task, dt=DT)
    here = drive(controller, None, 0, 80, [])[-1]
    controller.follow(LinePath(task.path.pose(here.clock_next), task.path.pose(0.0), duration=1.0))
    other = copy.deepcopy(controller)
    assert all(map(same, drive(controller, None, 0, 60, []), drive(other, None, 0, 60, [])))

    start = task.path.pose(0.0)
    servo = built(task, dt=DT, path=ServoPath(start))
    for target in (0.02, -0.03, 5.0):
        servo.retarget(pin.SE3(start.rotation, start.translation + target))
        other = pickle.loads(pickle.dumps(servo))
        assert all(map(same, drive(servo, None, 0, 25, []), drive(other, None, 0, 25, [])))


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_shares_nothing_that_changes(way: str) -> None:
    """What the one does next, even a new target or a fault, does not reach the other."""
    task = limited(paper_lift(), 10.0)
    start = task.path.pose(0.0)
    controller = built(task, dt=DT, path=ServoPath(start))
    controller.retarget(pin.SE3(start.rotation, start.translation + 0.05))
    drive(controller, None, 0, 20, [])
    kept = WAYS[way](controller)
    expected = drive(WAYS[way](controller), None, 0, 40, [])
    controller.retarget(pin.SE3(start.rotation, start.translation - 0.05))
    told = [drive(controller, None, 0, 10, [])[-1].q_next]
    drive(controller, pushed(task, 0), 0, 30, told)
    controller.follow(task.path)
    assert all(map(same, drive(kept, None, 0, 40, []), expected))


class Swaying(ObjectPath):
    """A user's path that its owner may shift, and break."""

    duration = 4.0

    def __init__(self, start: pin.SE3) -> None:
        self._start, self.shift, self.broken = start, 0.0, False

    def pose(self, clock: float) -> pin.SE3:
        if self.broken:
            raise RuntimeError("no data")
        x = 0.02 * (1.0 - np.cos(clock)) + self.shift
        return pin.SE3(self._start.rotation, self._start.translation + np.array([0.0, 0.0, x]))

    def twist(self, clock: float) -> Array:
        return np.concatenate([self._start.rotation.T @ np.array([0.0, 0.0, 0.02 * np.sin(clock)]), np.zeros(3)])


def test_a_deep_copy_has_its_own_path() -> None:
    task = limited(paper_lift(), 10.0)
    path = Swaying(task.path.pose(0.0))
    controller = built(task, dt=DT, path=path)
    drive(controller, None, 0, 30, [])
    shallow, deep = copy.copy(controller), copy.deepcopy(controller)
    assert shallow.path is path
    assert deep.path is not path
    path.broken = True
    for holding in (controller, shallow):
        assert holding.step().status is Status.HOLDING
    assert deep.step().status is not Status.HOLDING


def test_a_controller_whose_path_fails_can_be_copied() -> None:
    task = limited(paper_lift(), 10.0)
    path = Swaying(task.path.pose(0.0))
    controller = built(task, dt=DT, path=path)
    drive(controller, None, 0, 30, [])
    path.broken = True
    assert drive(controller, None, 0, 5, [])[-1].status is Status.HOLDING
    other = copy.copy(controller)
    assert all(map(same, drive(controller, None, 0, 20, []), drive(other, None, 0, 20, [])))
    path.broken = False
    assert all(map(same, drive(controller, None, 0, 20, []), drive(other, None, 0, 20, [])))


def test_a_copy_before_the_first_reset_has_to_be_reset() -> None:
    task = paper_lift()
    fresh = QPController(task.cell, task.grasp, task.path, dt=0.005)
    other = pickle.loads(pickle.dumps(fresh))
    with pytest.raises(InvalidInputError, match="reset"):
        other.step()
    other.reset(task.q_start)
    fresh.reset(task.q_start)
    assert same(fresh.step(), other.step())


@pytest.mark.parametrize("solver", ["daqp", "proxqp", "osqp"])
def test_a_copy_with_another_solver_agrees_up_to_its_accuracy(solver: str) -> None:
    task = limited(paper_lift(), 5.0)
    controller = built(task, dt=DT, shortcut=False, solver=solver)
    drive(controller, None, 0, 40, [])
    other = copy.copy(controller)
    for a, b in zip(drive(controller, None, 0, 40, []), drive(other, None, 0, 40, []), strict=True):
        np.testing.assert_allclose(a.velocity, b.velocity, rtol=0.0, atol=1e-6)
        assert a.status is b.status


def test_a_debugger_changes_no_step() -> None:
    """Up to Python 3.12 one that looked at local variables wrote into the step, and its q was the caller's array."""
    lift = paper_lift()
    q, still = np.array(lift.q_start), np.zeros(lift.cell.nv)
    plain = ControlStep(
        cell=lift.cell, grasp=lift.grasp, path=lift.path, q=q, velocity=still, q_next=q.copy(), dt=0.01,
        clock=0.0, clock_next=0.01, rate=1.0, status=Status.TRACKING,
    )  # fmt: skip

    def looks(frame: Any, *_: Any) -> Any:
        return looks if frame.f_locals is not None else None

    before = sys.gettrace()
    sys.settrace(looks)
    try:
        traced = plain.replaced(q=q)
    finally:
        sys.settrace(before)
    assert set(traced._values) == set(plain._values)
    assert not traced.q.flags.writeable


def test_a_copy_that_version_0_2_made_is_refused() -> None:
    state = built(paper_lift(), dt=DT).__getstate__()
    del state["version"]  # its memory may be as long as ours
    other = object.__new__(QPController)
    with pytest.raises(InvalidInputError, match=r"its memory is of another version\. Build and reset a new one"):
        other.__setstate__(state)


@pytest.mark.slow
@pytest.mark.parametrize("run", ["looking ahead", "measured", "in fault"])
def test_another_process_goes_on_with_the_same_bits(run: str, tmp_path: Path) -> None:
    controller, feed = RUNS[run]()
    told = [s.q_next for s in drive(controller, feed, 0, 60, [])][-1:]
    (tmp_path / "controller").write_bytes(pickle.dumps((controller, told[0])))
    program = (
        "import pickle, sys, numpy as np\n"
        f"controller, q = pickle.loads(open({str(tmp_path / 'controller')!r}, 'rb').read())\n"
        "steps = []\n"
        "for i in range(60):\n"
        "    steps.append(controller.step(q if i % 2 else None))\n"
        "    q = steps[-1].q_next\n"
        f"np.save({str(tmp_path / 'found.npy')!r}, [np.concatenate([s.velocity, s.q_next]) for s in steps])\n"
    )
    output("-c", program)
    q, expected = told[0], []
    for i in range(60):
        step = controller.step(q if i % 2 else None)
        q = step.q_next
        expected.append(np.concatenate([step.velocity, step.q_next]))
    assert np.array_equal(np.load(tmp_path / "found.npy"), expected)
