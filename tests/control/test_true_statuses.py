"""A status is true: what is off its path is not said to follow it, and every stop and every odd start has a name."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import cooperative, limited
from user_paths import Jumping

from coopqp import (
    InvalidInputError,
    LimitKind,
    LinePath,
    ObjectPath,
    QPOptions,
    Recording,
    Status,
    simulate,
)
from coopqp.errors import StartWarning
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import object_error, tool_placements

DT = 0.005


def away(path: ObjectPath, distance: float) -> LinePath:
    """A path that starts somewhere else, without a jump of its own."""
    start = path.pose(0.0)
    T = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, distance]))
    return LinePath.displaced(T, translation=(0.0, 0.0, 0.05), duration=3.0)


def test_statuses_keep_their_numbers_and_have_an_order() -> None:
    names = ["TRACKING", "SLOWED", "BLOCKED", "HOLDING", "FAULT", "PAUSED", "OFF_PATH", "JOGGING", "WAITING"]
    assert [status.name for status in Status] == names
    assert [status.code for status in Status] == list(range(9))
    first = sorted(Status, key=lambda status: -status.precedence)
    moving = ["OFF_PATH", "JOGGING", "WAITING", "PAUSED", "BLOCKED", "SLOWED", "TRACKING"]
    assert [s.name for s in first] == ["FAULT", "HOLDING", *moving]


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_a_path_that_starts_away_is_off_path_until_the_object_is_back(acceleration: float) -> None:
    task = limited(paper_lift(), acceleration)
    controller = cooperative(task, dt=DT)
    controller.reset(task.q_start)
    controller.follow(away(task.path, 0.15))
    controller.pause()
    step = controller.step()
    assert step.status is Status.OFF_PATH
    assert step.explain().startswith("The object is 150.0 mm off its path")
    seen = [step.status]
    for _ in range(600):
        distance, _ = object_error(tool_placements(task.cell, [step.q])[0], task.grasp, step.path.pose(step.clock))
        assert (step.status is Status.OFF_PATH) == (distance > 1e-3)
        if step.status is Status.OFF_PATH:
            assert f"{1e3 * distance:.1f} mm" in step.reason
        step = controller.step()
        seen.append(step.status)
    assert seen[-1] is Status.PAUSED
    assert step.clock == 0.0
    controller.resume()
    assert {controller.step().status for _ in range(100)} == {Status.SLOWED, Status.TRACKING}


def test_the_distances_of_off_path_are_options() -> None:
    task = paper_lift()
    for options, expected in (
        ({"off_path_distance": 0.2}, Status.TRACKING),
        ({"off_path_distance": 0.1}, Status.OFF_PATH),
    ):
        controller = cooperative(task, dt=DT, **options)
        controller.reset(task.q_start)
        controller.follow(away(task.path, 0.15))
        assert controller.step().status is expected
    with pytest.raises(InvalidInputError, match="off_path_angle"):
        QPOptions(off_path_angle=0.0)


def test_a_turn_is_off_the_path_too() -> None:
    task = paper_lift()
    controller = cooperative(task, dt=DT)
    controller.reset(task.q_start)
    start = task.path.pose(0.0)
    turned = pin.SE3(start.rotation @ pin.exp3(np.array([0.0, 0.0, np.deg2rad(2.0)])), start.translation)
    controller.follow(LinePath.displaced(turned, translation=(0.0, 0.0, 0.05), duration=3.0))
    assert controller.step().explain().startswith("The object is 2.00° off its path")


# -- starts ------------------------------------------------------------------------------------------------------------


@pytest.mark.core
@pytest.mark.parametrize("size", [2e-5, 2e-4, 2e-3])
def test_an_odd_start_is_said_until_it_is_mended(size: float) -> None:
    task = paper_lift()
    q = task.cell.moved(task.q_start, size * np.random.default_rng(1).standard_normal(task.cell.nv))
    controller = cooperative(task, dt=DT)
    with pytest.warns(StartWarning, match="off its grasp"):
        controller.reset(q)
    first = controller.step()
    assert "off its grasp" in first.reason
    assert ("off its path" in first.reason) == (size > 1e-4)
    for _ in range(400):
        step = controller.step()
    assert (step.status, step.reason) == (Status.TRACKING, "")


def test_a_sound_start_says_nothing() -> None:
    for make in (paper_lift, mixed_cell, dual_arm7):
        task = make()
        controller = cooperative(task, dt=DT)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            controller.reset(task.q_start)
        assert controller.step().reason == ""


def test_a_start_outside_limits_is_warned_of_by_name() -> None:
    task = paper_lift()
    upper = task.cell.limits.upper.copy()
    upper[2] = task.cell.positions(task.q_start)[2] - 0.05
    task = dataclasses.replace(task, cell=task.cell.with_limits(upper=upper))
    controller = cooperative(task, dt=DT)
    with pytest.warns(StartWarning, match="started outside its limits: joint_3"):
        controller.reset(task.q_start)
    assert "outside" in controller.step().explain()


# -- in mid-path -------------------------------------------------------------------------------------------------------


@pytest.mark.core
def test_a_reset_in_mid_path_goes_on_there() -> None:
    task = limited(mixed_cell(), 5.0)
    controller = cooperative(task, dt=DT)
    controller.reset(task.q_start)
    for _ in range(300):
        step = controller.step()
    with pytest.raises(InvalidInputError, match="from the start of its path"):
        controller.reset(step.q_next)
    controller.reset(step.q_next, clock=step.clock_next)
    again = controller.step()
    assert again.clock == step.clock_next
    assert np.array_equal(again.q, step.q_next)
    assert again.status is Status.SLOWED
    with pytest.raises(InvalidInputError, match=r"from its path at 2.5 s"):
        controller.reset(step.q_next, clock=2.5)


@pytest.mark.core
def test_the_same_path_followed_again_from_where_it_is_changes_nothing() -> None:
    """Under acceleration limits a rate that starts again at 0 would part the arms."""
    task = limited(dual_arm7(), 5.0)
    plain, again = cooperative(task, dt=DT), cooperative(task, dt=DT)
    for controller in (plain, again):
        controller.reset(task.q_start)
    rng = np.random.default_rng(2)
    for _ in range(250):
        a, b = plain.step(), again.step()
        assert abs(a.rate - b.rate) < 1e-3
        assert a.status is b.status
        assert float(np.linalg.norm(task.grasp.relative_errors(b.state)[:, :3], axis=1).max()) < 1e-7
        if rng.uniform() < 0.2:
            again.follow(task.path, clock=b.clock_next)


@pytest.mark.parametrize("bad", [-1.0, 1e9, np.nan, "now", None])
def test_a_clock_that_is_not_on_the_path_is_a_named_error_and_changes_nothing(bad: Any) -> None:
    task = paper_lift()
    controller = cooperative(task, dt=DT)
    controller.reset(task.q_start)
    step = controller.step()
    for call in (lambda: controller.reset(task.q_start, clock=bad), lambda: controller.follow(task.path, clock=bad)):
        with pytest.raises(InvalidInputError, match="clock"):
            call()
    assert controller.step().clock == step.clock_next


# -- stops -------------------------------------------------------------------------------------------------------------


@pytest.mark.core
@pytest.mark.parametrize("size", [0.1, 5.0])
def test_a_jump_of_a_users_path_is_named_as_such(size: float) -> None:
    task = limited(paper_lift(), 10.0)
    task = dataclasses.replace(task, path=Jumping(task.path, 0.6 * task.path.duration, np.array([size, 0.0, 0.0])))
    controller = cooperative(task, dt=DT)
    controller.reset(task.q_start)
    for _ in range(700):
        step = controller.step()
    assert step.status is Status.BLOCKED or "jumps" in step.reason
    kinds = {limit.kind for limit in step.binding}
    assert kinds <= {LimitKind.PATH_JUMP}
    assert "jump" in step.explain()
    assert step.clock < 0.6 * task.path.duration


# -- notes -------------------------------------------------------------------------------------------------------------


class Nervous:
    """A controller whose operator changes the override at every step for a while."""

    def __init__(self, task: Scenario) -> None:
        self._inner = cooperative(task, dt=DT)
        self.cell, self.grasp, self.path, self.dt = task.cell, task.grasp, task.path, 0.005
        self._count = 0

    def reset(self, q: Any) -> None:
        self._inner.reset(q)

    def step(self, q: Any = None, *, dt: float | None = None) -> Any:
        self._count += 1
        if 100 <= self._count < 500:
            self._inner.set_override(1.0 if self._count % 2 else 0.9)
        return self._inner.step(q, dt=dt)


def test_notes_that_go_to_and_fro_are_one() -> None:
    task = paper_lift()
    run = simulate(Nervous(task), q_start=task.q_start)
    assert len(np.flatnonzero(np.diff(run.status))) > 300
    assert len(run.notes) <= 3
    note = next(note for note in run.notes if "in turn" in note)
    assert "SLOWED and TRACKING in turn" in note
    assert "override" in note
    assert note.partition(": ")[0].isdigit()


def test_a_run_does_not_end_because_of_a_pause() -> None:
    task = paper_lift()
    controller = cooperative(task, dt=DT)
    count = 0

    def hand(step: Any) -> None:
        nonlocal count
        count += 1
        if count == 100:
            controller.pause()
        if count == 400:  # longer than the patience of a run
            controller.resume()

    run = simulate(controller, q_start=task.q_start, observe=hand)
    assert run.finished
    assert Status.PAUSED in run.statuses


def test_a_recording_with_the_new_statuses_is_kept(tmp_path: Any) -> None:
    task = paper_lift()
    controller = cooperative(task, dt=DT)
    controller.pause()
    run = simulate(controller, q_start=task.q_start, duration=0.5)
    assert Recording.load(run.save(tmp_path / "run.npz")).statuses == [Status.PAUSED] * run.n_steps
