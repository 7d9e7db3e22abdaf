"""The physics plant agrees with Pinocchio and its own sensors; the forces of the paper's lift in newtons."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at

from coopqp import (
    Arm,
    CoopqpError,
    Grasp,
    HoldPath,
    InvalidInputError,
    ObjectPath,
    QPController,
    QPOptions,
    Recording,
    RobotCell,
    SupervisionOptions,
    WaypointPath,
    simulate,
)
from coopqp.baselines import PseudoInverseController
from coopqp.control import Controller
from coopqp.errors import MissingExtraError, ModelError
from coopqp.forces import StressModel, at_tools
from coopqp.model import CellState
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import Disturbances, PhysicsError, PhysicsOptions, PhysicsPlant, misplaced
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.plants.replay import Motion, Replay, exact_motion, recorded_motion
from coopqp.spatial import Array

#: A base with an error of 1 mm and 0.1°, a grasp with an error of 2 mm.
BASE_OFF = pin.SE3(pin.exp3(np.deg2rad(0.1) * np.ones(3) / np.sqrt(3)), 1e-3 * np.ones(3) / np.sqrt(3))
GRASP_OFF = pin.SE3(np.eye(3), 2e-3 * np.ones(3) / np.sqrt(3))
SAME = pin.SE3.Identity()
#: A base error of a millimetre gives a measured spread of a millimetre, which must not stop the motion.
TOLERANT = QPOptions(supervision=SupervisionOptions(slow_from=0.005, hold_from=0.01))

MJCF = """<mujoco model="small">
  <compiler angle="radian"/>
  <worldbody><body name="pedestal">
    <geom type="box" size=".1 .1 .1"/>
    <body name="link1" pos="0 0 .3">
      <joint name="a" type="hinge" axis="0 0.6 0.8" range="-2 2" limited="true" pos=".1 0 0"/>
      <geom type="capsule" size=".05 .1"/>
      <body name="link2" pos=".4 0 0" euler=".3 .2 .1">
        <joint name="b" type="hinge" axis="0 1 0"/><geom type="box" size=".05 .1 .02"/>
        <body name="link3" pos=".2 0 0">
          <joint name="c" type="slide" axis="1 0 0" range="0 .2" limited="true"/>
          <geom type="sphere" size=".05"/><site name="tool" pos=".1 0 0"/>
        </body>
      </body>
    </body>
  </body></worldbody>
</mujoco>"""


def plant_of(cell: RobotCell, q: Array, **options: Any) -> PhysicsPlant:
    """A plant with arms that hold a small box at their present tool placements."""
    return PhysicsPlant(
        cell, grasp_at(cell, q), object_size=(0.1, 0.2, 0.3), object_mass=3.0, options=PhysicsOptions(**options)
    )


# -- the model ---------------------------------------------------------------------------------------------------------


def joints_of(plant: PhysicsPlant) -> list[int]:
    """Indices of the joints in the engine's velocities."""
    return [plant.mj_model.joint(name).dofadr[0] for name in plant.cell.joint_names]


def engine_mass_matrix(plant: PhysicsPlant) -> Array:
    m, d = plant.mj_model, plant.mj_data
    columns = []
    for unit in np.eye(m.nv):
        column = np.zeros(m.nv)
        mujoco.mj_mulM(m, d, column, unit)
        columns.append(column)
    joints = joints_of(plant)
    return np.array(columns).T[np.ix_(joints, joints)]


def assert_same_robots(cell: RobotCell, q: Array, rng: np.random.Generator) -> None:
    """Kinematics, inertia and bias forces agree with Pinocchio."""
    plant = plant_of(cell, q, armature=0.0, settle=0.0, hand_over=0.0)
    plant.reset(q)
    for T, expected in zip(plant.T_world_tool, CellState(cell, q).T_world_tool, strict=True):
        np.testing.assert_allclose(T.homogeneous, expected.homogeneous, atol=1e-12)
    upper = np.triu(pin.crba(cell.model, cell.model.createData(), q))
    expected_mass = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(engine_mass_matrix(plant), expected_mass, atol=1e-5)
    v = rng.uniform(-1.0, 1.0, cell.nv)
    plant.mj_data.qvel[joints_of(plant)] = v
    mujoco.mj_forward(plant.mj_model, plant.mj_data)
    bias = pin.nonLinearEffects(cell.model, cell.model.createData(), q, v)
    np.testing.assert_allclose(plant.mj_data.qfrc_bias[joints_of(plant)], bias, atol=1e-4)


def test_the_engine_s_robots_are_pinocchio_s(
    mixed_cell: RobotCell, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    for _ in range(5):
        assert_same_robots(mixed_cell, random_q(mixed_cell, rng), rng)


def test_an_mjcf_arm_comes_through_its_pinocchio_model(tmp_path: Path, rng: np.random.Generator) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(MJCF)
    arm = Arm.from_mjcf("small", file, tool_frame="tool", velocity_limits=1.0)
    cell = RobotCell([arm, arm.placed(pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.0])), name="other")])
    assert_same_robots(cell, cell.configuration([0.3, -0.4, 0.1, 0.5, 0.2, 0.05]), rng)


def test_a_screw_joint_is_refused() -> None:
    model = pin.Model()
    joint = model.addJoint(
        0, pin.JointModelHelicalUnaligned(np.array([0.0, 0.0, 1.0]), 0.1), pin.SE3.Identity(), "screw"
    )
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    cell = RobotCell([Arm.from_model("odd", model, tool_frame="tip", velocity_limits=1.0)])
    with pytest.raises(ModelError, match=r"odd.*screw"):
        plant_of(cell, cell.configuration([0.0]))


def test_a_real_base_is_off_where_it_is_told(paper: Scenario) -> None:
    plant = PhysicsPlant.of(
        paper, options=PhysicsOptions(settle=0.0), disturbances=Disturbances(base_offset={"slave_1": BASE_OFF})
    )
    plant.reset(paper.q_start)
    base = paper.cell.arms[1].T_world_base
    model = CellState(paper.cell, paper.q_start).T_world_tool
    expected = [model[0], base * BASE_OFF * base.inverse() * model[1], model[2]]
    for T, E in zip(plant.T_world_tool, expected, strict=True):
        np.testing.assert_allclose(T.translation, E.translation, atol=2e-3)
    off = PhysicsPlant.of(
        paper,
        options=PhysicsOptions(settle=0.0, hand_over=0.0),
        disturbances=Disturbances(base_offset={"slave_1": BASE_OFF}),
    )
    off.reset(paper.q_start)
    for T, E in zip(off.T_world_tool, expected, strict=True):
        np.testing.assert_allclose(T.homogeneous, E.homogeneous, atol=1e-12)


# -- forces ------------------------------------------------------------------------------------------------------------


def test_at_rest_the_arms_share_the_weight_and_press_nothing(paper: Scenario) -> None:
    plant = PhysicsPlant.of(paper)
    q = plant.reset(paper.q_start)
    np.testing.assert_allclose(q, paper.q_start, atol=1e-6)
    weight = 20.0 * 9.81
    forces = np.array([plant.T_world_object.rotation @ w[:3] for w in plant.wrenches()])
    np.testing.assert_allclose(forces, [[0, 0, weight / 2], [0, 0, weight / 4], [0, 0, weight / 4]], atol=1e-3)
    np.testing.assert_allclose(at_tools(plant.wrenches(), paper.grasp)[:, 3:], 0.0, atol=1e-3)  # no moment at a grasp
    np.testing.assert_allclose(plant.servo_torques, 0.0, atol=1e-3)  # feed-forward carries all of the weight
    without = PhysicsPlant.of(paper, options=PhysicsOptions(load_feed_forward=False, hand_over=0.0))
    sagged = without.reset(paper.q_start)
    assert 1e-4 < np.abs(sagged - paper.q_start).max() < 1e-2
    forces = np.array([without.T_world_object.rotation @ w[:3] for w in without.wrenches()])
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, weight], atol=1e-3)


@pytest.mark.parametrize("shares", [(0.5, 0.5), None])
def test_a_load_off_the_line_between_two_grasps_is_carried_too(
    make_cell: Callable[..., RobotCell], random_q: Callable[..., Array], rng: np.random.Generator, shares: Any
) -> None:
    """Forces alone cannot balance the load: the arms share the rest of the moment as torques."""
    cell = make_cell(["arm7", "rx90l"])
    q = random_q(cell, rng)
    plant = plant_of(cell, q, load_shares=shares)
    np.testing.assert_allclose(cell.positions(plant.reset(q)), cell.positions(q), atol=2e-5)


def test_a_released_object_falls(paper: Scenario) -> None:
    plant = PhysicsPlant.of(paper)
    q = plant.reset(paper.q_start)
    hold = simulate_steps(plant, paper, q, 5)
    start = plant.T_world_object.translation[2]
    plant.release()
    assert not plant.wrenches().any()
    simulate_steps(plant, paper, hold, 20, dt=0.01)
    fallen = start - plant.T_world_object.translation[2]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.2**2, rel=0.02)
    plant.reset(paper.q_start)  # the object is held again
    assert plant.T_world_object.translation[2] == pytest.approx(start, abs=1e-6)
    assert np.abs(plant.wrenches()).max() > 10.0


def simulate_steps(plant: PhysicsPlant, scenario: Scenario, q: Array, steps: int, dt: float = 0.005) -> Array:
    """Hold ``q`` for some steps."""
    replay = Replay(scenario.cell, scenario.grasp, HoldPath(scenario.path.pose(0.0)), lambda _: q, dt=dt)
    for _ in range(steps):
        q_measured = plant.apply(replay.step())
    return q_measured


def test_weld_forces_are_what_force_torque_sensors_read(paper: Scenario, baseline: Callable[..., Recording]) -> None:
    plant = PhysicsPlant.of(paper)
    replay = Replay(paper.cell, paper.grasp, paper.path, recorded_motion(paper.cell, baseline(40)), dt=0.01)
    readings: list[tuple[Array, Array]] = []

    def read(_: Any) -> None:
        readings.append((at_tools(plant.wrenches(), paper.grasp), plant.sensed_wrenches()))

    simulate(replay, plant, q_start=paper.q_start, observe=read)
    welds, sensors = (np.array(x) for x in zip(*readings, strict=True))
    assert np.abs(welds[:, :, :3]).max() > 1000.0
    assert np.abs(welds[:, :, 3:]).max() > 50.0
    for part in (slice(0, 3), slice(3, 6)):
        size = np.abs(welds[:, :, part]).max()
        np.testing.assert_allclose(sensors[:, :, part], welds[:, :, part], atol=1e-4 * size)


# -- time --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.0075, 0.0031, 0.001, 0.0004])
def test_any_step_ends_where_it_was_told(paper: Scenario, dt: float) -> None:
    """A step may have any length, also below the engine's step."""
    plant = PhysicsPlant.of(paper)
    motion = exact_motion(paper.cell, paper.grasp, paper.path, paper.q_start)
    replay = Replay(paper.cell, paper.grasp, paper.path, motion, dt=dt, time_law="quintic")
    run = simulate(replay, plant, q_start=paper.q_start, duration=0.3)
    assert plant.time == pytest.approx(run.time[-1])
    assert plant.mj_data.time == pytest.approx(1.5 + run.time[-1])  # settling, hand-over, the run
    np.testing.assert_allclose(plant.positions, run.q_command[-1], atol=1e-4)  # inertia at the start


@pytest.mark.slow
def test_two_runs_are_the_same_and_noise_has_its_seed(paper: Scenario) -> None:
    def run(**disturbances: Any) -> Array:
        plant = PhysicsPlant.of(paper, disturbances=Disturbances(**disturbances))
        controller = QPController(paper.cell, paper.grasp, paper_lift(time_law="quintic").path, dt=0.0075)
        return simulate(controller, plant, q_start=paper.q_start, duration=0.3).q

    np.testing.assert_array_equal(run(), run())
    noisy = run(encoder_noise=1e-4, drops_by_arm=True, drop_share=0.05, seed=3)
    np.testing.assert_array_equal(noisy, run(encoder_noise=1e-4, drops_by_arm=True, drop_share=0.05, seed=3))
    assert np.abs(noisy - run(encoder_noise=1e-4, drops_by_arm=True, drop_share=0.05, seed=4)).max() > 1e-5


def test_reading_changes_nothing(paper: Scenario, baseline: Callable[..., Recording]) -> None:
    motion = recorded_motion(paper.cell, baseline(40))
    runs = []
    for observe in (False, True):
        plant = PhysicsPlant.of(paper)
        replay = Replay(paper.cell, paper.grasp, paper.path, motion, dt=0.01)
        watch = (lambda _, p=plant: p.wrenches()) if observe else None
        runs.append(simulate(replay, plant, q_start=paper.q_start, duration=0.5, observe=watch).q)
    np.testing.assert_array_equal(runs[0], runs[1])


# -- the paper's lift in newtons ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """Wrenches of one replay at each millisecond (T, N, 6), and the recording."""

    wrenches: Array
    recording: Recording


@pytest.fixture(scope="module")
def physics(paper: Scenario) -> Callable[[Motion], Run]:
    """Replay a motion of the lift in the engine with steps of 1 ms and a quintic time warp."""
    plant = PhysicsPlant.of(paper)

    def play(motion: Motion) -> Run:
        wrenches: list[Array] = []
        replay = Replay(paper.cell, paper.grasp, paper.path, motion, dt=1e-3, time_law="quintic")
        recording = simulate(
            replay, plant, q_start=paper.q_start, settle=0.2, observe=lambda _: wrenches.append(plant.wrenches())
        )
        return Run(np.array(wrenches), recording)

    return play


@pytest.fixture(scope="module")
def reference(paper: Scenario, physics: Callable[[Motion], Run]) -> Run:
    """The lift by exact inverse kinematics at every step of the engine."""
    return physics(exact_motion(paper.cell, paper.grasp, paper.path, paper.q_start))


@pytest.fixture(scope="module")
def lifted(
    paper: Scenario, physics: Callable[[Motion], Run], baseline: Callable[..., Recording]
) -> dict[tuple[str, int], Run]:
    """The commands of both controllers for N = 40 and 400, replayed in the engine."""
    runs = {}
    for n in (40, 400):
        qp = QPController(paper.cell, paper.grasp, paper.path, dt=paper.path.duration / n)
        for name, commands in (("pseudo-inverse", baseline(n)), ("qp", simulate(qp, q_start=paper.q_start))):
            runs[name, n] = physics(recorded_motion(paper.cell, commands))
    return runs


def added_force(run: Run, reference: Run) -> Array:
    """ΔF: magnitude of the force difference to the reference run (T, N) [N]."""
    return np.asarray(np.linalg.norm((run.wrenches - reference.wrenches)[:, :, :3], axis=2))


@pytest.mark.slow
def test_the_baseline_presses_as_hard_as_expected(lifted: dict[tuple[str, int], Run], reference: Run) -> None:
    assert added_force(lifted["pseudo-inverse", 400], reference).max() == pytest.approx(187.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "ratio"), [(400, 0.02), (40, 0.05)])
def test_the_qp_presses_a_small_share_of_what_the_baseline_does(
    lifted: dict[tuple[str, int], Run], reference: Run, steps: int, ratio: float
) -> None:
    qp, baseline = (added_force(lifted[name, steps], reference).max() for name in ("qp", "pseudo-inverse"))
    assert qp <= ratio * baseline


@pytest.mark.slow
@pytest.mark.parametrize("steps", [40, 400])
def test_within_a_baseline_run_force_follows_the_paper_s_measure(
    paper: Scenario, lifted: dict[tuple[str, int], Run], reference: Run, steps: int
) -> None:
    run = lifted["pseudo-inverse", steps]
    tools = metrics.tool_placements(paper.cell, run.recording.q_command[1::10])
    measure = [metrics.relative_positioning_error(T, paper.grasp) for T in tools]
    force = added_force(run, reference)[::10].max(axis=1)
    assert np.corrcoef(measure, force)[0, 1] >= 0.99
    assert 1e-3 * force[-1] / measure[-1] == pytest.approx(215.0, rel=0.02)  # N/mm


@pytest.mark.slow
@pytest.mark.parametrize("steps", [40, 400])
def test_the_stress_estimate_is_the_engine_s(
    paper: Scenario, lifted: dict[tuple[str, int], Run], reference: Run, steps: int
) -> None:
    run = lifted["pseudo-inverse", steps]
    added = (run.wrenches - reference.wrenches)[::10]
    plant = PhysicsPlant.of(paper)
    model = StressModel(paper.cell, paper.grasp, stiffness=plant.stiffness)
    estimate = model.history(run.recording.q_command[1::10])
    for part in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(added[:, :, part], axis=2).max()
        assert np.linalg.norm((estimate - added)[:, :, part], axis=2).max() <= 0.05 * size
        assert np.linalg.norm((estimate - added)[-1, :, part], axis=1).max() <= 0.015 * size  # at rest
    q, q_reference = run.recording.q[-1], reference.recording.q[-1]
    servos = model.from_servos(run.recording.q_command[-1], q)
    servos -= model.from_servos(reference.recording.q_command[-1], q_reference)
    assert np.linalg.norm((servos - added[-1])[:, :3], axis=1).max() <= 0.002 * np.linalg.norm(added[-1, :, :3])


@pytest.mark.slow
def test_the_same_loop_runs_on_either_plant(paper: Scenario) -> None:
    """With feedback of the measured state, the internal forces are tiny and the object reaches its goal."""
    lift = paper_lift(time_law="quintic")

    def controller(kind: type) -> Controller:
        made: Controller = kind(lift.cell, lift.grasp, lift.path, dt=lift.dt)
        return made

    ideal = simulate(controller(QPController), q_start=lift.q_start)
    plant = PhysicsPlant.of(lift)
    real = simulate(controller(QPController), plant, q_start=lift.q_start)
    assert ideal.finished
    assert real.finished
    assert real.n_steps == ideal.n_steps
    np.testing.assert_allclose(real.q[-1], ideal.q[-1], atol=5e-5)
    goal = lift.path.pose(lift.path.duration)
    assert (
        np.linalg.norm(pin.log6(goal.actInv(plant.T_world_object)).vector) < 5e-5
    )  # [m, rad], at the last instant of the motion
    stress = {}
    weight = np.array([98.1, 49.05, 49.05])
    for kind in (QPController, PseudoInverseController):
        simulate(controller(kind), plant, q_start=lift.q_start, settle=0.2)
        stress[kind] = np.abs(np.linalg.norm(plant.wrenches()[:, :3], axis=1) - weight).max()
    assert stress[QPController] < 0.1
    assert stress[PseudoInverseController] > 50.0


# -- closed on the measured state --------------------------------------------------------------------------------------


def internal_force(plant: PhysicsPlant, scenario: Scenario) -> float:
    """Largest force at a grasp beyond its share of the weight [N]."""
    R = plant.T_world_object.rotation
    shares = 20.0 * 9.81 * np.array([0.5, 0.25, 0.25])[:, None] * R[2]
    return float(np.linalg.norm(plant.wrenches()[:, :3] - shares, axis=1).max())


def closed_loop(
    path: ObjectPath, *, latched: bool, base: pin.SE3 = SAME, grip: pin.SE3 = SAME, dt: float = 0.005
) -> tuple[Array, Recording]:
    """Internal force at every step [N] and the recording, with an error of the first slave's base or grip."""
    lift = paper_lift()
    plant = PhysicsPlant.of(
        lift,
        real_grasp=misplaced(lift.cell, lift.grasp, {"slave_1": grip}),
        disturbances=Disturbances(base_offset={"slave_1": base}),
    )
    grasp = lift.grasp
    if latched:
        grasp = Grasp.from_configuration(lift.cell, plant.reset(lift.q_start), nominal=lift.grasp)
    controller = QPController(lift.cell, grasp, path, dt=dt, options=TOLERANT)
    forces: list[float] = []
    recording = simulate(
        controller, plant, q_start=lift.q_start, observe=lambda _: forces.append(internal_force(plant, lift))
    )
    return np.array(forces), recording


@pytest.mark.slow
@pytest.mark.parametrize("latched", [True, False])
@pytest.mark.parametrize("off", [{"base": BASE_OFF}, {"grip": GRASP_OFF}], ids=["base", "grip"])
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_held_for_ten_seconds_the_force_stays(paper: Scenario, off: dict[str, pin.SE3], latched: bool) -> None:
    force, recording = closed_loop(HoldPath(paper.path.pose(0.0), duration=10.0), latched=latched, **off)
    assert recording.finished
    second = len(force) // 10
    early, late = force[second : 2 * second].max(), force[-second:].max()
    assert late <= 1.01 * early + 0.05
    assert force.max() < (60.0 if latched else 300.0)
    assert late < (2.0 if latched else 300.0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_lifted_and_lowered_for_ten_seconds_the_force_does_not_wind_up(paper: Scenario) -> None:
    low, high = paper.path.pose(0.0), paper.path.pose(paper.path.duration)
    path = WaypointPath([low, high] * 3 + [low], durations=[10.0 / 6.0] * 6)
    force, recording = closed_loop(path, latched=True, base=BASE_OFF)
    assert recording.finished
    assert recording.metadata["failures"] == 0
    third = len(force) // 3
    cycles = [force[max(i * third, 200) : (i + 1) * third].max() for i in range(3)]  # after the first second
    assert cycles[0] < 120.0
    assert cycles[2] <= 1.01 * cycles[0]


# -- what is refused ---------------------------------------------------------------------------------------------------


def test_without_mujoco_the_extra_is_named(paper: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[mujoco\]"):
        PhysicsPlant.of(paper)


@pytest.mark.parametrize(
    "settings",
    [
        {"object_size": (1.0, 1.0)},
        {"object_size": (1.0, 1.0, 0.0)},
        {"object_mass": 0.0},
        {"object_mass": np.nan},
        {"T_object_body": 2.0 * np.eye(4)},
        {"options": PhysicsOptions(load_shares=(0.5, 0.4, 0.2))},
        {"options": PhysicsOptions(load_shares=(0.5, 0.5))},
        {"disturbances": Disturbances(lag={"slave": 0.01})},
        {"disturbances": Disturbances(stall={"slave": 0.01})},
        {"disturbances": Disturbances(base_offset={"slave": BASE_OFF})},
        {"real_grasp": Grasp((SAME,))},
    ],
)
def test_bad_settings_are_named(paper: Scenario, settings: dict[str, Any]) -> None:
    with pytest.raises(CoopqpError):
        PhysicsPlant(paper.cell, paper.grasp, **{"object_size": (1.0, 1.0, 0.1), "object_mass": 1.0, **settings})


def test_a_bad_configuration_is_named(paper: Scenario) -> None:
    with pytest.raises(InvalidInputError, match="reset"):
        PhysicsPlant.of(paper).reset(np.zeros(3))


def test_a_diverged_engine_is_an_error_not_a_result(
    paper: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # the engine leaves a log
    unstable = PhysicsOptions(weld_solimp=(0.9999, 0.9999, 0.001, 0.5, 2.0), damping=1e-9, timestep=0.05, armature=0.0)
    with pytest.raises(PhysicsError, match="diverged"):
        simulate_steps(plant := PhysicsPlant.of(paper, options=unstable), paper, plant.reset(paper.q_start), 50)


def test_the_model_can_be_taken_elsewhere(paper: Scenario) -> None:
    model = mujoco.MjModel.from_xml_string(PhysicsPlant.of(paper).xml())
    assert model.nv == 24
    assert model.ngeom > 20
