"""Forces that relax while arms let go and attach: against the physics engine, and with sensors that read anything."""

from __future__ import annotations

import copy
import itertools
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from runs import limited_once

from coopqp import (
    ControlStep,
    ForceController,
    ForceOptions,
    InvalidInputError,
    LinePath,
    QPController,
    Status,
    simulate,
)
from coopqp.forces import Grip
from coopqp.planning import Payload
from coopqp.programs import Phase, Program, Travels
from coopqp.scenarios import Scenario, hand_over, palm_box, paper_lift, pliers
from coopqp.simulation import Disturbances, PhysicsPlant
from coopqp.spatial import Array

LIMIT = 5.0
#: Of wrenches that are made up.
PATIENT = {"slow_from": 80.0, "hold_from": 120.0, "move_below": 60.0}
#: Servos of an arm in the engine, as it has them by default [N·m/rad].
SERVOS = np.tile((1e5, 1e5, 5e4, 1e4, 1e4, 5e3), 3)


def regrasp(*, leads: bool = False, until: str | None = None, seconds: float = 1.0) -> Scenario:
    """Up with three arms; one of them goes over while two hold; up with three."""
    task = limited_once(lambda: paper_lift(time_law="quintic"), LIMIT)
    k = 0 if leads else 2
    X, here = task.grasp.T_object_tool[k], task.path.start
    there = X.translation + (np.array([0.0, 0.1, 0.0]) if leads else np.array([-0.1, 0.0, 0.0]))
    over = {task.cell.arm_names[k]: Travels(to=pin.SE3(X.rotation, there))}
    up = LinePath.displaced(here, translation=(0.0, 0.0, 0.05), duration=seconds)
    on = LinePath.displaced(up.goal, translation=(0.0, 0.0, 0.05), duration=seconds)
    phases = [
        Phase("up", path=up, until=until),
        Phase("over", arms=over, duration=1.5 * seconds),
        Phase("on", path=on),
    ]
    return replace(task, path=Program(task.cell, task.grasp, phases))


def minding(task: Scenario, **options: Any) -> ForceController:
    alone = {"supervision": {"slow_from": None}}  # no chain closes over what is measured here
    inner = QPController(task.cell, task.grasp, task.path, dt=0.004, options=alone)
    quick = {
        "stiffness": 1e5 if len(task.cell) < 3 else SERVOS,
        "presses": False,
        "check_time": 0.02,
        "sensor_tolerance": 1e3,
    }
    return ForceController(inner, quick | options)


# -- what is refused -------------------------------------------------------------------------------------------------


def test_arms_that_move_while_they_hold_are_refused_by_name() -> None:
    task = pliers()
    with pytest.raises(
        InvalidInputError, match="ForceController: controller: an arm moves on the object while it holds"
    ):
        minding(task)
    fixed = replace(task, path=paper_lift(time_law="quintic").path)
    made = minding(fixed)
    with pytest.raises(InvalidInputError, match=r"ForceController\.follow: path: an arm moves on the object while it"):
        made.follow(task.path)
    assert made.path is fixed.path


def test_palms_that_lose_the_object_while_an_arm_is_away_are_refused() -> None:
    task = palm_box()
    name = task.cell.arm_names[1]
    X = task.grasp.T_object_tool[1]
    away = Program(task.cell, task.grasp, [Phase("away", path=task.path, arms={name: Travels(to=X)})])
    palms = (Grip(kind="palm", friction=0.6, radius=0.05),) * 2
    payload = Payload(mass=task.object_mass, centre=task.T_object_body.translation)
    with pytest.raises(InvalidInputError, match=f"while only the palms of {task.cell.arm_names[0]} from"):
        minding(replace(task, path=away), palms=palms, squeeze=300.0, payload=payload)


# -- with sensors that read anything -----------------------------------------------------------------------------------


class Script:
    """Wrenches of arms whose grasps squeeze the object a little, and what an operator asks for."""

    def __init__(self, task: Scenario, seed: int, free: str) -> None:
        self.task, self.free, self.rng, self.own = task, free, np.random.default_rng(seed), np.random.default_rng(7)
        self.clock = 0.0  # of the last step, by which the grips have opened or closed
        self.push = self.rng.normal(size=(3, 6)) * np.array([6.0] * 3 + [1.0] * 3)

    def wrenches(self, made: ForceController) -> Array:
        """The push fades as the grasps give way; the sensor of an arm that does not hold reads anything."""
        w = self.push * np.exp(-1e3 * np.abs(made.shift)) + self.rng.normal(size=(3, 6))
        assert made.path.grasps is not None
        holds = np.array(made.path.grasps.holds(self.clock))
        anything = self.own.normal(size=(3, 6)) * 500.0
        w[~holds] = {"nothing": 0.0, "anything": anything[~holds], "lost": np.nan}[self.free]
        return w

    def operate(self, made: ForceController, i: int) -> None:
        kind = int(self.rng.integers(250))
        if kind < 4:
            made.set_override(float(self.rng.uniform(0.2, 1.0)))
        elif kind == 4:
            made.pause()
        elif kind in (5, 6, 7):
            made.resume()
        elif kind == 8 and i > 300:
            made.reverse(float(self.rng.uniform(0.0, made.controller.program_clock)))
        elif kind in (9, 10, 11):
            made.forward()


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "leads"), [(0, False), (1, True), (2, False), (3, True)])
def test_limits_hold_and_copies_go_on_through_phases(seed: int, leads: bool) -> None:
    """Random override, pauses, ways back: no jump of a command, whatever the sensor of a free arm reads."""
    task = regrasp(leads=leads, seconds=0.8)
    made, script = minding(task, **PATIENT), Script(task, seed, "anything")
    made.reset(task.q_start)
    others, q, speed = list[ForceController](), task.q_start, np.zeros(task.cell.nv)
    limits, shifted, free = task.cell.limits, 0.0, 0
    for i in range(3000):
        script.operate(made, i)
        w = script.wrenches(made)
        if i % 130 == 70:
            others = [copy.copy(made), copy.deepcopy(made), pickle.loads(pickle.dumps(made))][: 1 + i // 130 % 3]
        copied = [other.step(q, wrenches=w) for other in others]
        step = made.step(q, wrenches=w)
        for own in copied:
            np.testing.assert_array_equal(own.q_next, step.q_next)
            assert own.reason == step.reason
        others.clear()
        assert np.isfinite(step.q_next).all()
        assert (np.abs(step.velocity) <= limits.velocity * (1.0 + 1e-9)).all()
        assert np.abs(step.velocity - speed).max() <= LIMIT * step.dt * (1.0 + 1e-9)
        script.clock = step.clock
        q, speed, shifted = step.q_next, np.array(step.velocity), max(shifted, float(np.abs(made.shift).max()))
        free += not all(made.path.grasps.holds(step.clock))  # type: ignore[union-attr]
        if step.finished:
            break
    assert free > 100
    assert shifted > 1e-4


@pytest.mark.slow
def test_the_sensor_of_an_arm_that_does_not_hold_counts_for_nothing() -> None:
    task = regrasp(seconds=0.8)
    runs = []
    for free in ("nothing", "anything", "lost"):
        made, script = minding(task, **PATIENT), Script(task, 0, free)
        q, told = task.q_start, list[Any]()
        made.reset(q)
        for _ in range(600):
            step = made.step(q, wrenches=script.wrenches(made))
            q, script.clock = step.q_next, step.clock
            told.append((q.tobytes(), step.status, step.reason, made.shift.tobytes()))
        assert step.clock > 1.2, step.reason
        runs.append(told)
    assert runs[0] == runs[1] == runs[2]


@pytest.mark.core
def test_forces_where_arms_let_go_as_recorded(golden: Golden) -> None:
    task = regrasp(seconds=0.6)
    done, script = golden.of(minding(task, **PATIENT), 1e-8), Script(task, 3, "anything")
    done.controller.reset(task.q_start)
    q = task.q_start
    for _ in range(1500):
        step = done.take(q, wrenches=script.wrenches(done.controller))
        q, script.clock = step.q_next, step.clock
        if step.finished:
            break
    assert step.finished


def test_an_arm_that_presses_is_relaxed_before_it_lets_go_at_rest() -> None:
    """The object waits, and the reason says for what; a grasp that cannot give way further keeps it waiting."""
    task = regrasp(seconds=0.8)
    made, q = minding(task, reach=1e-5, move_below=10.0), task.q_start
    made.reset(q)
    (leaves, _), rng = made.path.grasps.changes, np.random.default_rng(0)  # type: ignore[union-attr]
    push = np.array([[0.0, -14.0, 0.0], [0.0] * 3, [0.0, 14.0, 0.0]])  # between the leader and the arm that leaves
    waited = 0
    for i in range(1000):
        w = 0.1 * rng.normal(size=(3, 6))
        if step_clock(made) > 0.2 and i < 700:
            w[:, :3] += np.array([X.rotation.T @ f for X, f in zip(task.grasp.T_object_tool, push, strict=True)])
        step = made.step(q, wrenches=w)
        q = step.q_next
        if "lets go" in step.reason:
            waited += 1
            assert "the arms relax before arm slave_2 lets go: " in step.reason
            assert step.rate == 0.0
            assert leaves - 3.0 * made.dt < step.clock < leaves
    assert waited > 100
    assert step.clock > leaves


def step_clock(made: ForceController) -> float:
    return made.controller.program_clock  # type: ignore[union-attr]


def test_an_arm_that_lets_go_after_a_gate_hands_its_load_over_before() -> None:
    task = regrasp(until="go", seconds=0.6)
    made, script, q = minding(task, **PATIENT), Script(task, 5, "anything"), task.q_start
    made.reset(q)
    for _ in range(400):
        step = made.step(q, wrenches=script.wrenches(made))
        q, script.clock = step.q_next, step.clock
    assert step.status is Status.WAITING
    holding = made._relaxation.holding
    assert (holding.holds, holding.bears) == ((True, True, True), (True, True, False))
    assert not holding.load_shares[12:].any()
    made.signal("go")
    for _ in range(900):
        step = made.step(q, wrenches=script.wrenches(made))
        q, script.clock = step.q_next, step.clock
    assert step.finished
    assert all(holding.bears)
    assert holding.load_shares[12:].any()


def test_a_grasp_comes_back_to_its_place_while_its_arm_is_free_and_begins_anew_where_it_attaches() -> None:
    task = regrasp(seconds=1.0)
    made, q = minding(task, **PATIENT), task.q_start
    made.reset(q)
    (leaves, attaches), rng = made.path.grasps.changes, np.random.default_rng(0)  # type: ignore[union-attr]
    push, shifts = np.array([[0.0, -40.0, 0.0], [0.0] * 3, [0.0, 40.0, 0.0]]), list[tuple[float, Array]]()
    for _ in range(1500):
        w = 0.1 * rng.normal(size=(3, 6))
        if 0.2 < step_clock(made) < leaves - 0.5:
            w[:, :3] += np.array([X.rotation.T @ f for X, f in zip(task.grasp.T_object_tool, push, strict=True)])
        step = made.step(q, wrenches=w)
        q = step.q_next
        shifts.append((step.clock, made.shift))
        if step.finished:
            break
    assert step.finished
    before = np.linalg.norm(next(d for clock, d in shifts[::-1] if clock < leaves)[2])
    free = np.array([np.linalg.norm(d[2]) for clock, d in shifts if leaves + 0.02 < clock < attaches])
    assert before > 1e-3
    assert (np.diff(free) <= 0.0).all()
    assert free[-1] < 1e-3 * before
    fastest = np.abs(np.diff([d[2, :3] for _, d in shifts], axis=0)).max() / made.dt
    assert fastest <= made.options.speed * (1.0 + 1e-9)
    moved = [np.abs(b - a).max() for (_, a), (_, b) in itertools.pairwise(shifts)]
    assert max(moved) <= made.options.spin * made.dt


# -- in the engine -----------------------------------------------------------------------------------------------------


def least_wrenches(points: Array, w: Array) -> Array:
    """What of wrenches at grasps (n, 6) the least ones do not carry (n, 3) [N]; 0.1 N·m counts as 1 N."""
    n = len(points)
    total, scale = np.zeros((6, 6 * n)), np.tile([1.0, 1.0, 1.0, 0.1, 0.1, 0.1], n)
    for k, (x, y, z) in enumerate(points):
        total[:, 6 * k : 6 * k + 6] = np.eye(6)
        total[3:, 6 * k : 6 * k + 3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    carried = scale[:, None] * np.linalg.pinv(total * scale) @ total @ w.ravel()
    inner: Array = (w.ravel() - carried).reshape(n, 6)[:, :3]
    return inner


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("base", ["", "slave_2"])
@pytest.mark.parametrize("make", [regrasp, hand_over])
def test_forces_in_the_engine_are_relaxed_again_after_each_change(make: Any, base: str) -> None:
    """With a base 1 mm and 0.1° off, as with none: QPController alone leaves 12 N, and cannot start with it."""
    pytest.importorskip("mujoco")
    task = make()
    axis = np.ones(3) / np.sqrt(3.0)
    off = pin.SE3(pin.exp3(np.deg2rad(0.1) * axis), 1e-3 * axis)
    plant = PhysicsPlant.of(task, disturbances=Disturbances(base_offset={base: off} if base else {}))
    payload = Payload(mass=task.object_mass, centre=task.T_object_body.translation)
    inner = QPController(task.cell, task.grasp, task.path, dt=0.004)
    made = ForceController(inner, ForceOptions(stiffness=SERVOS, payload=payload, presses=False))
    motion, rows, speed = task.path.grasps, list[tuple[float, float, float]](), np.zeros(task.cell.nv)
    (leaves, attaches), apart, borne = motion.changes, 0 if make is hand_over else 2, list[float]()

    def see(step: ControlStep) -> None:
        nonlocal speed
        assert np.abs(step.velocity - speed).max() <= LIMIT * step.dt * (1.0 + 1e-9)
        speed = np.array(step.velocity)
        w, held = plant.wrenches(), np.array(motion.holds(step.clock))
        forces = np.linalg.norm(w[:, :3], axis=1)
        if not held.all() and leaves + 0.01 < step.clock < attaches - 0.01:
            assert forces[apart] < 1.0  # its grip is open
            borne.append(w[held, 2].sum())
        points = np.array([X.translation for X in task.grasp.moved_by(motion.placements(step.clock)).T_object_tool])
        w[:, 3:] -= np.cross(points, w[:, :3])
        inner = np.linalg.norm(least_wrenches(points[held], w[held]), axis=1).max()
        rows.append((step.clock, forces.max(), float(inner)))

    recording = simulate(made, plant, q_start=task.q_start, observe=see, settle=1.0)
    assert recording.finished
    assert plant.gripped
    # The other arms bear the weight; an object that moves by 0.1 m/s changes its mean by 1.3 N in that time.
    assert np.mean(borne) == pytest.approx(9.81 * task.object_mass, rel=0.01)
    clock, force, internal = np.array(rows).T
    assert force[clock >= attaches].max() < 1.3 * force[clock < leaves - 0.01].max()
    assert internal[-1] < 2.0
    if make is regrasp:
        between = (clock > leaves + 0.05) & (clock < attaches)
        assert internal[between].max() < 5.0
    moved = task.path.grasp_at(task.grasp, task.path.duration).T_object_tool[apart]
    there = plant.T_world_object.actInv(plant.T_world_tool[apart])
    assert np.linalg.norm(there.translation - moved.translation) < 6e-3
