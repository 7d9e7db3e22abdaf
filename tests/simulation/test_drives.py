"""Torque-controlled drives: the law against inverse dynamics and its linear limit, the observer, the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ForceController, Grasp, InvalidInputError, QPController, RobotCell, simulate
from coopqp.errors import UnknownNameError, UnreachableError
from coopqp.forces import internal_wrenches
from coopqp.model import CellState
from coopqp.scenarios import Scenario, palm_box, torque_lift
from coopqp.simulation import Disturbances, Monitored, PhysicsOptions, PhysicsPlant, engine_controller, engine_plant
from coopqp.simulation.plants.drives import TorqueDrives
from coopqp.spatial import Array

OBSERVER = {"servo": "disturbance observer"}
SENSED = {**OBSERVER, "wrist_sensors": True}


@pytest.fixture(scope="module")
def alone(lift: Scenario) -> RobotCell:
    """One arm, held by nothing."""
    return RobotCell([lift.cell.arms[0]])


def drives_of(cell: RobotCell, grasp: Grasp | None = None, armature: float = 1.0, **options: Any) -> TorqueDrives:
    held = Grasp(tuple(pin.SE3.Random() for _ in cell.arms)) if grasp is None else grasp
    made = PhysicsOptions(**{"servo": "computed torque", **options})
    return TorqueDrives(cell, held, made, np.full(cell.nv, armature), np.full(cell.nv, np.inf))


def with_armature(cell: RobotCell, armature: float) -> pin.Model:
    model = cell.model.copy()
    model.armature[:] = armature
    return model


# -- formulas ----------------------------------------------------------------------------------------------------------


def test_the_model_is_that_of_inverse_dynamics(
    mixed_cell: RobotCell, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    """M̂ a + ĥ is RNEA's; twice the mass takes twice the torque, the drives' own inertia aside."""
    for mass in (1.0, 2.0):
        drives = drives_of(mixed_cell, armature=0.7, assumed_mass=mass)
        for _ in range(20):
            q, v, a = random_q(mixed_cell, rng), *rng.normal(size=(2, mixed_cell.nv))
            M, h = drives.model_at(q, v)
            links = pin.rnea(mixed_cell.model, mixed_cell.model.createData(), q, v, a)
            np.testing.assert_allclose(M @ a + h, mass * links + 0.7 * a, rtol=1e-10, atol=1e-9)
            zero = np.zeros(mixed_cell.nv)
            np.testing.assert_allclose(drives.torque(q, v, zero, zero, a, zero), M @ a + h, rtol=1e-10, atol=1e-9)


def test_of_an_exact_model_the_error_decays_as_the_linear_equation_says(alone: RobotCell) -> None:
    """e = (1 + ω t) exp(−ω t) e₀, while the arm swings widely. Forward dynamics are Pinocchio's ABA."""
    model, w, dt = with_armature(alone, 1.0), 30.0, 1e-4
    data, drives = model.createData(), drives_of(alone, loop_bandwidth=w)
    rng = np.random.default_rng(4)
    middle, size = rng.normal(size=(2, alone.nv))
    off = 0.05 * rng.normal(size=alone.nv)
    q = middle - off
    v = 4.0 * size
    for i in range(1500):
        t = i * dt
        x, dx, ddx = middle + size * np.sin(4.0 * t), 4.0 * size * np.cos(4.0 * t), -16.0 * size * np.sin(4.0 * t)
        np.testing.assert_allclose(x - q, (1.0 + w * t) * np.exp(-w * t) * off, atol=1e-3 * np.abs(off).max() + 5e-5)
        a = pin.aba(model, data, q, v, drives.torque(q, v, x - q, dx - v, ddx, np.zeros(alone.nv)))
        q, v = q + dt * v + 0.5 * dt * dt * a, v + dt * a
    assert np.abs(x - q).max() < 0.1 * np.abs(off).max()


@pytest.mark.parametrize("K", [20.0, 80.0])
def test_a_constant_disturbance_is_estimated_with_the_time_constant(alone: RobotCell, K: float) -> None:
    """d̂ = (1 − exp(−K t)) d of an arm by itself, and then no error is left."""
    model, dt = with_armature(alone, 1.0), 5e-4
    data, drives = model.createData(), drives_of(alone, timestep=dt, observer_bandwidth=K, **OBSERVER)
    q_ref, d = np.array([0.1, 0.5, 1.2, 0.3, -0.5, 0.2]), np.array([30.0, -50.0, 20.0, 5.0, -3.0, 1.0])
    q, v, zero, most = q_ref.copy(), np.zeros(6), np.zeros(6), 0.0
    for i in range(700 if K < 50.0 else 500):
        np.testing.assert_allclose(drives.disturbance, (1.0 - np.exp(-K * i * dt)) * d, atol=0.01 * np.abs(d).max())
        torque = drives.torque(q, v, q_ref - q, -v, zero, zero)
        v = v + dt * pin.aba(model, data, q, v, torque + d)
        q = q + dt * v
        drives.observe(q, v, dt, np.zeros((1, 6)))
        most = max(most, float(np.abs(q - q_ref).max()))
    assert np.abs(q - q_ref).max() < 0.1 * most


def observed(lift: Scenario, d: Array, wrenches: Array | None = None, **options: Any) -> Array:
    """d̃ after arms at rest accelerated for long as by a disturbance ``d``, with wrenches at the tools (N, 6)."""
    drives = drives_of(lift.cell, lift.grasp, **options)
    q, zero = lift.q_start, np.zeros(lift.cell.nv)
    M, h = drives.model_at(q, zero)
    felt = np.zeros((len(lift.cell), 6)) if wrenches is None else wrenches
    for _ in range(5):
        torque = drives.torque(q, zero, zero, zero, zero, zero)
        drives.observe(q, np.linalg.solve(M, d + torque - h), 1.0, felt)  # in a second
    drives.torque(q, zero, zero, zero, zero, zero)
    return -drives.feedback


def to_torques(lift: Scenario, wrenches: Array) -> Array:
    """Jᵀ of wrenches at the tools, in their axes."""
    state = CellState(lift.cell, lift.q_start)
    return np.concatenate([state.jacobian(k).T @ w for k, w in enumerate(wrenches)])


def squeezing(lift: Scenario, rng: np.random.Generator) -> Array:
    """Wrenches at the tools (N, 6) that cancel on the object."""
    on_object = rng.normal(size=(len(lift.cell), 6))
    on_object -= on_object.mean(axis=0)
    return np.array([X.action.T @ w for X, w in zip(lift.grasp.T_object_tool, on_object, strict=True)])


def test_a_squeeze_is_left_alone_and_a_load_is_resisted(lift: Scenario, rng: np.random.Generator) -> None:
    """By virtual work: in any motion of the object with the arms d̃ does the work of the disturbance."""
    squeeze = to_torques(lift, squeezing(lift, rng))
    np.testing.assert_allclose(observed(lift, squeeze, **OBSERVER), 0.0, atol=1e-8)
    d = rng.normal(size=lift.cell.nv)
    resisted, state, twist = observed(lift, d, **OBSERVER), CellState(lift.cell, lift.q_start), rng.normal(size=6)
    tools = [X.actionInverse @ twist for X in lift.grasp.T_object_tool]
    motion = np.concatenate([np.linalg.solve(state.jacobian(k), V) for k, V in enumerate(tools)])
    np.testing.assert_allclose(resisted @ motion, d @ motion, rtol=1e-9)
    np.testing.assert_allclose(observed(lift, resisted, **OBSERVER), resisted, atol=1e-8)
    assert np.abs(observed(lift, d, servo="computed torque")).max() == 0.0


def test_wrist_sensors_tell_an_arm_s_own_error_from_a_squeeze(lift: Scenario, rng: np.random.Generator) -> None:
    """Each arm bears its own error alone; what the sensors feel of a squeeze is left alone; a load is shared."""
    own = rng.normal(size=lift.cell.nv)
    np.testing.assert_allclose(observed(lift, own, **SENSED), own, atol=1e-9)
    squeeze = squeezing(lift, rng)
    np.testing.assert_allclose(observed(lift, own - to_torques(lift, squeeze), squeeze, **SENSED), own, atol=1e-8)
    load = rng.normal(size=(len(lift.cell), 6))
    shared = load - np.array(
        [X.action.T @ w for X, w in zip(lift.grasp.T_object_tool, internal_wrenches(load, lift.grasp), strict=True)]
    )
    expected = own - to_torques(lift, shared)
    np.testing.assert_allclose(observed(lift, own - to_torques(lift, load), load, **SENSED), expected, atol=1e-8)


def test_a_lost_wrench_changes_nothing(lift: Scenario, rng: np.random.Generator) -> None:
    lost = np.full((len(lift.cell), 6), np.nan)
    own = rng.normal(size=lift.cell.nv)
    np.testing.assert_allclose(observed(lift, own, lost, **SENSED), own, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"servo": "sliding"}, "servo"),
        ({"servo": "computed torque", "loop_bandwidth": 300.0}, "loop_bandwidth"),
        ({"servo": "computed torque", "loop_bandwidth": 200.0, "assumed_mass": 1.5}, "assumed_mass"),
        ({**OBSERVER, "observer_bandwidth": 500.0}, "observer_bandwidth"),
        ({"servo": "computed torque", "timestep": 0.02}, "timestep"),
        ({**OBSERVER, "assumed_mass": 0.15}, "assumed_mass"),
        ({"assumed_mass": 0.0}, "assumed_mass"),
        ({"assumed_payload": -0.5}, "assumed_payload"),
        ({"observer_bandwidth": float("nan")}, "observer_bandwidth"),
    ],
)
def test_nonsense_and_bandwidths_beyond_the_rate_are_refused_by_name(options: dict[str, Any], named: str) -> None:
    with pytest.raises((InvalidInputError, UnknownNameError), match=named):
        PhysicsOptions(**options)
    if "bandwidth" in named and options.get("servo") and np.isfinite(list(options.values())[-1]):
        PhysicsOptions(**options, timestep=2e-4)  # a faster loop holds it


def swing(w: float, K: float, mass: float, h: float) -> float:
    """Largest eigenvalue of one step of a joint of mass 1 that the drives take for ``mass``; above 1 it swings up."""
    columns = []
    for x, v, d_hat in np.eye(3):
        torque = -mass * (2.0 * w * v + w * w * x) - d_hat
        faster = v + h * torque
        d = mass * (faster - v) / h - torque
        columns.append([x + h * faster, faster, d_hat - np.expm1(-K * h) * (d - d_hat)])
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max())


def test_what_is_accepted_is_stable_and_refused_settings_include_all_that_swing(rng: np.random.Generator) -> None:
    accepted, swings = 0, 0
    for _ in range(2000):
        w, K, mass = np.exp(rng.uniform(np.log([1.0, 1.0, 0.05]), np.log([900.0, 900.0, 4.0])))
        stable = swing(w, K, mass, 1e-3) < 1.0
        swings += not stable
        try:
            PhysicsOptions(loop_bandwidth=w, observer_bandwidth=K, assumed_mass=mass, **OBSERVER)
        except InvalidInputError:
            continue
        accepted += 1
        assert stable, (w, K, mass)
    assert min(accepted, swings) > 200


def test_late_wrenches_bad_limits_palms_and_minded_forces_are_refused(lift: Scenario) -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(InvalidInputError, match="wrench_latency"):
        PhysicsPlant.of(lift, options=SENSED, disturbances=Disturbances(wrench_latency=0.02))
    for torque_limits in (0.0, [1.0, 2.0]):
        with pytest.raises(InvalidInputError, match="torque_limits"):
            PhysicsPlant.of(lift, options={**OBSERVER, "torque_limits": torque_limits})
    box = palm_box()
    assert box.engine is not None
    with pytest.raises(InvalidInputError, match="palms"):
        engine_plant(replace(box, engine=replace(box.engine, options=OBSERVER)))
    minding = torque_lift()
    assert minding.engine is not None
    with pytest.raises(InvalidInputError, match="forces"):
        engine_controller(replace(minding, engine=replace(minding.engine, forces={})), engine_plant(minding))


def test_a_controller_that_minds_forces_is_refused_on_torques(lift: Scenario) -> None:
    """The run would end in HOLDING, for arms out of step or a sensor that "does not agree with its servos"."""
    pytest.importorskip("mujoco")
    plant = PhysicsPlant.of(lift, options=OBSERVER)
    inner = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
    made = ForceController(inner, {"stiffness": plant.stiffness})
    for controller in (made, Monitored(made)):
        with pytest.raises(InvalidInputError, match="torque-controlled drives"):
            simulate(controller, plant, q_start=lift.q_start)


# -- the engine --------------------------------------------------------------------------------------------------------


def held(lift: Scenario, **options: Any) -> tuple[PhysicsPlant, float, float]:
    """A plant that holds the plate for half a second: how far it sank [mm], the largest internal force [N]."""
    pytest.importorskip("mujoco")
    late = Disturbances(wrench_latency=0.005) if options.get("wrist_sensors") else None
    plant = PhysicsPlant.of(lift, options={"settle": 0.5, "hand_over": 0.0, **options}, disturbances=late)
    plant.reset(lift.q_start)
    off = plant.T_world_object.translation - lift.path.pose(0.0).translation
    internal = internal_wrenches(plant.sensed_wrenches(), lift.grasp)
    return plant, 1e3 * float(np.linalg.norm(off)), float(np.linalg.norm(internal[:, :3], axis=1).max())


@pytest.mark.slow
def test_at_rest_an_exact_model_holds_as_position_servos_do(lift: Scenario) -> None:
    for servo in ("position", "computed torque", "disturbance observer"):
        plant, sank, internal = held(lift, servo=servo)
        assert sank < 1e-3
        assert internal < 1.0
        np.testing.assert_allclose(plant.servo_torques, 0.0, atol=0.05)
        assert plant.limited_joints == ()


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.5, 1.5])
def test_the_observer_holds_what_computed_torque_lets_sink(lift: Scenario, off: float) -> None:
    """Wrong masses sink the plate by millimetres, and squeeze it; only sensors tell the drives of a squeeze."""
    _, sank, internal = held(lift, servo="computed torque", assumed_mass=off, assumed_payload=off)
    assert sank > 3.0
    _, sees, still = held(lift, assumed_mass=off, assumed_payload=off, **OBSERVER)
    assert sees < 0.01
    assert still > 20.0
    _, senses, relieved = held(lift, assumed_mass=off, assumed_payload=off, **SENSED)
    assert senses < 0.01
    assert relieved < 2.0 < internal


def test_torques_stay_within_their_limits_and_the_joints_are_named(lift: Scenario) -> None:
    """At an upper limit of half of what the second joint of the master needs, it is named, and sinks."""
    free, _, _ = held(lift, servo="computed torque")
    limits = np.full(lift.cell.nv, 400.0)
    limits[1] = 0.5 * abs(free.joint_torques[1])
    plant, sank, _ = held(lift, servo="computed torque", torque_limits=limits)
    np.testing.assert_array_less(np.abs(plant.joint_torques), limits * (1.0 + 1e-15))
    assert plant.limited_joints == (lift.cell.joint_names[1],)
    assert sank > 1.0


@pytest.mark.parametrize("servo", ["position", "computed torque"])
def test_a_command_beyond_all_torques_gets_the_feed_forward_of_rest(lift: Scenario, servo: str) -> None:
    """Load sharing has no answer to a joint that is to speed up at 1000 rad/s²; the plant goes on."""
    task = torque_lift(servo=servo, wrist_sensors=False, assumed_mass=1.0, assumed_payload=1.0)
    plant = engine_plant(task)
    q = plant.reset(task.q_start)
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    controller.reset(q)
    step = controller.step(q)
    with pytest.raises(UnreachableError):
        plant.load.share(q, joint_velocity=0.0 * step.velocity, joint_acceleration=np.full(task.cell.nv, 1e3))
    after = plant.apply(step.replaced(velocity=step.velocity + 7.5))
    np.testing.assert_allclose(after, q, atol=1e-3)
