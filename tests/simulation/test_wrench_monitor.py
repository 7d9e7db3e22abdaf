"""A monitor that judges wrenches step by step: as the figures of a run do, by another way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from coopqp import ForceController, InvalidInputError, QPController, simulate
from coopqp.forces import Grip, internal_wrenches, palm_use
from coopqp.planning import Payload
from coopqp.scenarios import Scenario, palm_box, paper_lift
from coopqp.simulation import (
    Disturbances,
    KinematicPlant,
    Monitor,
    Monitored,
    PhysicsPlant,
    Violation,
    ViolationKind,
    WrenchBounds,
    check_run,
)
from coopqp.spatial import Array


@pytest.fixture(scope="module")
def task() -> Scenario:
    return paper_lift(time_law="quintic")


Excesses = Callable[[WrenchBounds, Array], list[tuple[ViolationKind, int, float]]]


@pytest.fixture(scope="module")
def excesses(task: Scenario) -> Excesses:
    """What a monitor finds in wrenches while the object moves: the kind, the number of the arm, and the amount."""
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    controller.reset(task.q_start)
    first, second = controller.step(), controller.step()

    def found(bounds: WrenchBounds, wrenches: Array) -> list[tuple[ViolationKind, int, float]]:
        monitor = Monitor(task.cell, task.grasp, kinematics=False, wrenches=bounds)
        assert not monitor.observe(first)
        told = monitor.observe(second, wrenches=wrenches)
        return [(v.kind, task.cell.arm_names.index(v.arm), v.amount) for v in told]

    return found


@given(seed=st.integers(0, 10**6), size=st.sampled_from([0.1, 1.0, 30.0]), radius=st.sampled_from([0.0, 0.05]))
def test_what_is_too_much_is_what_the_reports_say(
    task: Scenario, excesses: Excesses, seed: int, size: float, radius: float
) -> None:
    rng = np.random.default_rng(seed)
    w = size * rng.normal(size=(3, 6))
    normal = rng.normal(size=3)
    palms = (Grip(kind="palm", friction=0.6, radius=radius, normal=normal),) * 3
    w[:, :3] += rng.choice([0.0, 20.0]) * palms[0].normal
    found = excesses(WrenchBounds(internal_force=10.0, palms=palms), w)
    sizes = np.linalg.norm(internal_wrenches(w, task.grasp)[:, :3], axis=1)
    squeezed = {arm: amount for kind, arm, amount in found if kind is ViolationKind.SQUEEZE}
    assert squeezed == pytest.approx({k: s - 10.0 for k, s in enumerate(sizes) if s > 10.0})
    slips = {arm: amount for kind, arm, amount in found if kind is ViolationKind.FRICTION}
    assert slips == pytest.approx({k: use - 1.0 for k, use in enumerate(palm_use(palms, w)) if use > 1.0})


def test_wrenches_count_while_the_object_moves_and_arms_are_named(task: Scenario) -> None:
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    monitor = Monitor(task.cell, task.grasp, wrenches={"internal_force": 20.0})
    controller.reset(task.q_start)
    pushed = np.zeros((3, 6))
    pushed[1, :3] = [0.0, 0.0, 50.0]

    def judged(wrenches: Any) -> tuple[Violation, ...]:
        return monitor.observe(controller.step(), wrenches=wrenches)

    assert not judged(pushed), "nothing has moved yet"
    found = judged(pushed)
    assert [(v.kind, v.arm, v.step) for v in found] == [(ViolationKind.SQUEEZE, "slave_1", 1)]
    largest = np.linalg.norm(internal_wrenches(pushed, task.grasp)[1, :3])
    assert found[0].amount == pytest.approx(largest - 20.0)
    assert not judged(None)
    pushed[2] = np.nan
    assert not judged(pushed), "a wrench did not come"
    assert [v.kind for v in judged(np.zeros((2, 6)))] == [ViolationKind.FORM]
    assert dict(monitor.verdict().counts) == {ViolationKind.SQUEEZE: 1, ViolationKind.FORM: 1}


def test_palms_are_judged_alone_and_bad_bounds_refused(task: Scenario, excesses: Excesses) -> None:
    palms = (Grip(kind="palm", friction=0.5),) * 3
    w = np.zeros((3, 6))
    w[:, 2], w[2, 0], w[0, :] = 100.0, 60.0, np.nan
    assert [found[:2] for found in excesses(WrenchBounds(palms=palms), w)] == [(ViolationKind.FRICTION, 2)]
    for bad in ({"internal_force": 0.0}, {"palms": (Grip(),) * 3}, {"palms": palms[:2]}):
        with pytest.raises(InvalidInputError):
            Monitor(task.cell, task.grasp, wrenches=bad)


def test_shifts_of_another_shape_are_refused_and_nothing_is_judged(task: Scenario) -> None:
    controller, monitor = QPController(task.cell, task.grasp, task.path, dt=task.dt), Monitor(task.cell, task.grasp)
    controller.reset(task.q_start)
    steps, good = [controller.step(), controller.step()], np.zeros((3, 6))
    nothing: Any = None
    for shifts in ([good], [nothing, good], [good, nothing], [good, good[:2]]):
        with pytest.raises(InvalidInputError, match="shift"):
            monitor.observe_all(steps, shifts=shifts)
    assert monitor.observe_all(steps, shifts=[good, good]) == ()
    assert monitor.verdict().steps == 2


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_a_controller_that_minds_wrenches_is_judged_as_its_recording_is(task: Scenario, excesses: Excesses) -> None:
    """A base off by 1 mm in the engine: grasps give way, and that is no parted chain; a tighter bound names the arm."""
    axis = np.ones(3) / np.sqrt(3.0)
    off = pin.SE3(pin.exp3(np.deg2rad(0.1) * axis), 1e-3 * axis)
    plant = PhysicsPlant.of(task, disturbances=Disturbances(base_offset={"slave_2": off}))
    payload = Payload(mass=plant.object_mass, centre=task.T_object_body.translation)
    inner = ForceController(
        QPController(task.cell, task.grasp, task.path, dt=task.dt),
        {"stiffness": plant.stiffness, "payload": payload, "presses": False},
    )
    tolerances = {"object_mm": 5.0}  # commands lead to where the measured object is on its path
    monitor = Monitor(task.cell, task.grasp, tolerances=tolerances, wrenches=WrenchBounds(internal_force=20.0))
    seen: list[Array] = []
    made = Monitored(inner, monitor)
    run = simulate(
        made, plant, q_start=task.q_start, duration=1.2, observe=lambda _: seen.append(plant.measured_wrenches())
    )
    live, whole = made.verdict(), check_run(run, task.cell, tolerances=monitor.tolerances)
    assert live.ok, live
    assert live.steps == run.n_steps
    assert live.worst.chain_m == pytest.approx(whole.worst.chain_m, rel=1e-9)
    assert np.abs(inner.shift).max() > 5e-4
    assert np.isfinite(seen).all()
    strict = WrenchBounds(internal_force=0.5)
    named = {arm for w in seen[-60:] for _, arm, _ in excesses(strict, w)}
    assert named, "some force is left"


def test_a_recording_names_the_palm_whose_friction_runs_out() -> None:
    task = palm_box()
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    run = simulate(controller, KinematicPlant(task.cell), q_start=task.q_start, duration=0.3)
    wrenches = np.zeros((run.n_steps, 2, 6))
    wrenches[:, :, 2] = 100.0
    wrenches[20, 1, 0] = 90.0
    palms = [{"kind": "palm", "friction": 0.6}] * 2
    loaded = replace(
        run,
        wrenches=wrenches,
        torques=np.zeros((run.n_steps, task.cell.nv)),
        metadata={**run.metadata, "load": {"palms": palms}},
    )
    assert check_run(run, task.cell).ok
    (found,) = check_run(loaded, task.cell).violations
    assert (found.kind, found.step, found.arm) == (ViolationKind.FRICTION, 20, task.cell.arm_names[1])
    assert found.amount == pytest.approx(0.5)
