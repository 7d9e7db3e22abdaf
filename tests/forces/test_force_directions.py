"""Position or force, per arm and direction: places stay, and what minds forces relaxes in the time said."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first

from coopqp import ForceController, Grasp, HoldPath, QPController, Status, simulate
from coopqp.forces import StressModel
from coopqp.forces.admittance import yields_in_part
from coopqp.model import CellState
from coopqp.planning import Payload
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import Disturbances, PhysicsPlant, misplaced
from coopqp.spatial import Array

NONE, ALL = (0,) * 6, (1,) * 6
#: A master, and slaves that mind all; one direction each; some, other ones per arm.
KINDS: dict[str, tuple[Sequence[int], ...]] = {
    "slaves": (NONE, ALL, ALL),
    "along": (NONE, (0, 0, 1, 0, 0, 0), (0, 0, 1, 0, 0, 0)),
    "mixed": (NONE, (1, 1, 0, 0, 0, 1), (0, 0, 1, 1, 1, 1)),
}
OFF = pin.SE3(pin.exp3(1e-4 * np.array([1.0, -0.5, 1.0])), 1e-4 * np.array([3.0, -2.0, 3.0]))


@pytest.fixture(scope="module")
def task() -> Scenario:
    return paper_lift(time_law="quintic")


def own(task: Scenario, twists: Array) -> Array:
    """Twists in the object frame (N, 6) in the axes of each tool."""
    return np.array([X.actionInverse @ d for X, d in zip(task.grasp.T_object_tool, twists, strict=True)])


def apart(task: Scenario, shift: Array, q: Array) -> Array:
    """How far each tool is commanded from its shifted place, as the first arm holds the object, in its axes (N, 6)."""
    moved = Grasp(tuple(pin.exp6(d) * X for d, X in zip(shift, task.grasp.T_object_tool, strict=True)))
    O = moved.carried(CellState(task.cell, q))
    return own(task, np.array([-pin.log6(O[0].actInv(o)).vector for o in O]))


@pytest.mark.parametrize("kind", KINDS)
def test_all_that_is_minded_decays_with_the_relax_time(task: Scenario, kind: str) -> None:
    """On an elastic chain, with servos that are as told; the object and all positions stay where they are."""
    mind = np.array(KINDS[kind], dtype=float)
    model = StressModel(task.cell, misplaced(task.cell, task.grasp, {"slave_2": OFF}), stiffness=2e4)
    held = HoldPath(task.path.pose(0.0), duration=100.0)
    T, options = 0.3, {"delay": 0.0, "filter_time": 0.0, "dead_band": 0.0, "ramp_time": 1e-9, "speed": 9.0, "spin": 9.0}
    made = ForceController(
        QPController(task.cell, task.grasp, held, dt=task.dt),
        {"stiffness": 2e4, "directions": mind, "relax_time": T, "sensor_tolerance": 1e3, "check_time": 0.0, **options},
    )
    made.reset(task.q_start)
    q, sizes, shifts = task.q_start, [], []
    for _ in range(150):
        found = model.estimate(q).wrenches
        wrenches = np.array([X.action.T @ w for X, w in zip(model.grasp.T_object_tool, found, strict=True)])
        step = made.step(q, wrenches=wrenches)
        q = step.q_next
        if "relax" in step.reason or sizes:
            sizes.append(float(np.linalg.norm(made.internal)))
            shifts.append(made.shift)
    assert sizes[0] > 3.0
    t = task.dt * np.arange(60)
    np.testing.assert_allclose(np.array(sizes[1:61]) / sizes[1], np.exp(-t / (made.stiffer * T)), rtol=0.06)
    stays = 1.0 - mind
    assert max(np.abs(own(task, d - shifts[0]) * stays).max() for d in shifts) < 1e-9
    assert np.abs(apart(task, made.shift, q) * stays).max() < 1e-6
    O = task.grasp.carried(CellState(task.cell, q))[0]
    assert np.abs(pin.log6(held.pose(0.0).actInv(O)).vector).max() < 1e-6


def test_with_all_directions_it_is_what_the_servos_yield() -> None:
    """For forces that cancel, up to a common motion, and what servos do not model: C w."""
    rng, n = np.random.default_rng(0), 3
    half = rng.normal(size=(n, 6, 6))
    C = 1e-4 * np.einsum("kij,klj->kil", half, half)
    w = rng.normal(size=(n, 6))
    w[2] = -w[0] - w[1]
    answered = (yields_in_part(C, np.eye(6 * n)) @ w.ravel()).reshape(n, 6)
    direct = np.einsum("kij,kj->ki", C, w)
    np.testing.assert_allclose(answered - answered[0], direct - direct[0], atol=1e-5 * np.abs(direct).max())


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("kind", slow_but_first(KINDS))
def test_in_the_engine_forces_relax_and_positions_stay(task: Scenario, kind: str) -> None:
    """A base off by 1 mm and 0.1°: what is minded relaxes, position-controlled directions keep to 1 µm; it goes on."""
    mind, axis = np.array(KINDS[kind], dtype=float), np.ones(3) / np.sqrt(3.0)
    off = pin.SE3(pin.exp3(np.deg2rad(0.1) * axis), 1e-3 * axis)
    plant = PhysicsPlant.of(task, disturbances=Disturbances(wrench_latency=0.01, base_offset={"slave_2": off}))
    payload = Payload(mass=plant.object_mass, centre=task.T_object_body.translation)
    made = ForceController(
        QPController(task.cell, task.grasp, task.path, dt=task.dt),
        {"stiffness": plant.stiffness, "payload": payload, "directions": mind},
    )
    seen: list[Any] = []
    run = simulate(
        made,
        plant,
        q_start=task.q_start,
        duration=1.8,
        observe=lambda step: seen.append((step.q_next, made.shift, step.status, made.internal)),
    )
    stays, first = 1.0 - mind, seen[0][1]
    assert max(np.abs(own(task, shift - first) * stays).max() for _, shift, _, _ in seen) < 1e-6
    assert max(np.abs(apart(task, shift, q) * stays).max() for q, shift, _, _ in seen[::5]) < 1e-6
    moving = [internal for (*_, internal), rate in zip(seen, run.rate, strict=True) if rate > 0.0]
    assert max(np.linalg.norm(internal[:, :3], axis=1).max() for internal in moving) < 10.0
    assert not {status for _, _, status, _ in seen} & {Status.HOLDING, Status.FAULT}
    assert run.clock[-1] > 0.6, run.notes[-1]
