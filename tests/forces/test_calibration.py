"""Calibration: bases and grips come back from closed chains, what they leave open is said, and the engine agrees."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at

from coopqp import (
    CoopqpError,
    Grasp,
    InvalidInputError,
    QPController,
    QPOptions,
    Recording,
    RobotCell,
    SupervisionOptions,
    inverse_kinematics,
    load_cell_file,
    simulate,
)
from coopqp.cli.main import main
from coopqp.errors import UnreachableError
from coopqp.files import example_path
from coopqp.forces import (
    Calibration,
    CalibrationError,
    CalibrationOptions,
    calibrate,
    determining_motion,
    undetermined_by,
)
from coopqp.forces.loop_residual import Closure
from coopqp.model import CellState
from coopqp.planning import PathVerdict
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import Disturbances, DisturbedPlant, PhysicsPlant, calibrate_runs, chain_error
from coopqp.spatial import Array

NOISE = 1e-4  # rad
#: A base that is off by 1 mm and 0.1°.
BASE_OFF = pin.SE3(pin.exp3(np.deg2rad(0.1) * np.ones(3) / np.sqrt(3)), 1e-3 * np.ones(3) / np.sqrt(3))


def drawn(rng: np.random.Generator, arms: int, share: float = 0.7) -> Array:
    """Errors of all bases and grips."""
    return share * CalibrationOptions().prior(arms) * rng.standard_normal(12 * arms)


def with_errors(cell: RobotCell, grasp: Grasp, x: Array) -> tuple[RobotCell, Grasp]:
    """The cell and the grasp as they really are."""
    b, g = x.reshape(len(cell), 2, 6).transpose(1, 0, 2)
    arms = [arm.placed(arm.T_world_base * pin.exp6(v)) for arm, v in zip(cell.arms, b, strict=True)]
    return RobotCell(arms), Grasp(tuple(X * pin.exp6(v) for X, v in zip(grasp.T_object_tool, g, strict=True)))


def turned(start: pin.SE3, turns: Array, shifts: Array) -> list[pin.SE3]:
    """Poses turned about world axes at the origin of the object, and shifted."""
    pairs = zip(turns, shifts, strict=True)
    return [pin.SE3(pin.exp3(w) @ start.rotation, start.translation + p) for w, p in pairs]


def held(cell: RobotCell, grasp: Grasp, poses: list[pin.SE3], q: Array) -> Array:
    """Configurations (T, nq) at which the arms really hold the object."""
    return np.array([q := inverse_kinematics(cell, grasp, pose, q) for pose in poses])


def parted_mm(cell: RobotCell, grasp: Grasp, q: Array) -> float:
    """How far the arms part in a model, at the worst of configurations."""
    return 1e3 * max(chain_error(list(CellState(cell, x).T_world_tool), grasp)[0] for x in q)


def two_axes(start: pin.SE3, n: int = 40) -> list[pin.SE3]:
    u = np.linspace(0.0, 2.0 * np.pi, n)
    turns = np.column_stack([-0.35 + 0.35 * np.cos(u), 0.1 * np.sin(2.0 * u), 0.1 * np.sin(u)])
    return turned(start, turns, np.outer(0.1 - 0.1 * np.cos(u), [0, 0, 1]))


def one_axis(start: pin.SE3, n: int = 40) -> list[pin.SE3]:
    u = np.linspace(0.0, 1.0, n)
    return turned(start, np.outer(u, [-0.7, 0, 0]), np.outer(u, [0, 0, 0.3]))


def any_motion(start: pin.SE3, rng: np.random.Generator, n: int = 5) -> list[pin.SE3]:
    turn, shift = rng.uniform(-1, 1, 3) * [0.25, 0.08, 0.12], rng.uniform(-0.08, 0.08, 3)
    u = np.linspace(0.0, 1.0, n)
    return turned(start, np.outer(u, turn), np.outer(u, [*shift[:2], abs(shift[2])]))


@dataclass(frozen=True)
class Case:
    """A calibration with the truth at hand."""

    found: Calibration
    cell: RobotCell
    grasp: Grasp


@pytest.fixture(scope="module")
def calibrated(paper: Scenario) -> Callable[..., Case]:
    def run(motion: Callable[..., list[pin.SE3]], rng: np.random.Generator, noise: float = NOISE) -> Case:
        cell, grasp = with_errors(paper.cell, paper.grasp, drawn(rng, 3))
        q = held(cell, grasp, motion(paper.path.pose(0.0)), paper.q_start)
        measured = q + rng.uniform(-noise, noise, q.shape)
        return Case(calibrate(paper.cell, paper.grasp, measured, options={"encoder_noise": NOISE}), cell, grasp)

    return run


# -- the mathematics ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robots", [("rx90l", "arm7"), ("arm7", "arm6c", "gantry7", "arm5")])
def test_the_jacobian_is_that_of_finite_differences(
    robots: tuple[str, ...],
    make_cell: Callable[..., RobotCell],
    random_q: Callable[..., Array],
    rng: np.random.Generator,
) -> None:
    cell = make_cell(robots)
    grasp = grasp_at(cell, random_q(cell, rng))
    closure = Closure(cell, grasp, np.array([random_q(cell, rng) for _ in range(3)]), rng.uniform(1e-4, 1e-3, cell.nv))
    x, h = 0.1 * rng.standard_normal(12 * len(cell)), 1e-6
    J = closure.jacobian(x)
    numeric = np.column_stack(
        [(closure.residuals(x + h * e) - closure.residuals(x - h * e)) / (2 * h) for e in np.eye(len(x))]
    )
    np.testing.assert_allclose(J, numeric, atol=2e-5 * np.abs(J).max())


def test_errors_do_not_see_how_the_world_and_the_object_are_placed(paper: Scenario, rng: np.random.Generator) -> None:
    """All bases moved together, and all grips: closure is the same, and the correction relative to the first arm 0."""
    q = held(paper.cell, paper.grasp, one_axis(paper.path.pose(0.0), 3), paper.q_start)
    closure, small = Closure(paper.cell, paper.grasp, q, np.full(18, 1e-4)), 1e-3 * rng.standard_normal((2, 6))
    x = np.zeros((3, 2, 6))
    for k, (arm, X) in enumerate(zip(paper.cell.arms, paper.grasp.T_object_tool, strict=True)):
        x[k, 0] = pin.log6(arm.T_world_base.inverse() * pin.exp6(small[0]) * arm.T_world_base).vector
        x[k, 1] = pin.log6(X.inverse() * pin.exp6(small[1]) * X).vector
    np.testing.assert_allclose(closure.errors(x.ravel()), 0.0, atol=1e-9)
    np.testing.assert_allclose(closure.gauge() @ x.ravel(), 0.0, atol=1e-9)
    bases, tools = closure.corrected(x.ravel())
    for B, arm in zip(bases, paper.cell.arms, strict=True):
        assert B.isApprox(arm.T_world_base, 1e-9)
    for X, nominal in zip(tools, paper.grasp.T_object_tool, strict=True):
        assert X.isApprox(nominal, 1e-9)


def test_residuals_of_noise_alone_have_unit_variance(paper: Scenario, rng: np.random.Generator) -> None:
    q = held(paper.cell, paper.grasp, two_axes(paper.path.pose(0.0)), paper.q_start)
    noisy = q + NOISE * rng.standard_normal(q.shape)
    residuals = Closure(paper.cell, paper.grasp, noisy, np.full(18, NOISE)).residuals(np.zeros(36))
    assert np.mean(residuals**2) == pytest.approx(1.0, abs=0.2)


# -- what comes back ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tilts_about_two_axes_determine_all_bases_and_grips(
    calibrated: Callable[..., Case], paper: Scenario, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    case = calibrated(two_axes, rng)
    assert case.found.undetermined == ()
    assert case.found.determined_share == 1.0
    before = after = 0.0
    for _ in range(8):
        q = held(case.cell, case.grasp, any_motion(paper.path.pose(0.0), rng), paper.q_start)
        before = max(before, parted_mm(paper.cell, paper.grasp, q))
        after = max(after, parted_mm(case.found.cell, case.found.grasp, q))
    assert before > 5.0  # mm
    assert after <= 0.25
    # The true placements relative to the first arm, within four standard deviations.
    master, thing = case.cell.arms[0].T_world_base, case.grasp.T_object_tool[0]
    for k, arm in enumerate(case.found.corrections, start=1):
        pairs = (
            (paper.cell.arms[0].T_world_base * master.inverse() * case.cell.arms[k].T_world_base,
             case.found.cell.arms[k].T_world_base, arm.base_deviation),
            (paper.grasp.T_object_tool[0] * thing.inverse() * case.grasp.T_object_tool[k],
             case.found.grasp.T_object_tool[k], arm.grip_deviation),
        )  # fmt: skip
        for true, found, deviation in pairs:
            assert (np.abs(pin.log6(found.actInv(true)).vector) <= 4.0 * deviation).all()


def test_ideal_encoders_bring_everything_back(calibrated: Callable[..., Case], rng: np.random.Generator) -> None:
    case = calibrated(two_axes, rng, noise=0.0)
    assert case.found.before[:, 0].max() > 1e-3
    assert case.found.after[:, 0].max() < 2e-5  # the prior pulls a little


def test_a_model_that_fits_stays_as_it_is(paper: Scenario) -> None:
    q = held(paper.cell, paper.grasp, two_axes(paper.path.pose(0.0), 10), paper.q_start)
    found = calibrate(paper.cell, paper.grasp, q)
    for arm in found.corrections:
        np.testing.assert_allclose([arm.base, arm.grip], 0.0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [two_axes, one_axis])
def test_noise_corrects_nothing(
    paper: Scenario, motion: Callable[..., list[pin.SE3]], rng: np.random.Generator
) -> None:
    """Of a model that fits no arm is corrected; of one arm that is off, that arm alone."""
    q = held(paper.cell, paper.grasp, motion(paper.path.pose(0.0)), paper.q_start)
    for _ in range(5):
        found = calibrate(paper.cell, paper.grasp, q + rng.uniform(-NOISE, NOISE, q.shape))
        assert not any(arm.significant for arm in found.corrections)
        assert found.explain().count("no more than its own uncertainty") == 2
        np.testing.assert_array_equal(found.after, found.before)
        assert all(a.T_world_base == b.T_world_base for a, b in zip(found.cell.arms, paper.cell.arms, strict=True))
        assert found.slip is None
    errors = drawn(rng, 3)
    errors[:24] = 0.0
    cell, grasp = with_errors(paper.cell, paper.grasp, errors)
    measured = held(cell, grasp, motion(paper.path.pose(0.0)), paper.q_start)
    found = calibrate(paper.cell, paper.grasp, measured + rng.uniform(-NOISE, NOISE, q.shape))
    assert [arm.significant for arm in found.corrections] == [False, True]
    assert found.after[:, 0].max() < 0.5 * found.before[:, 0].max()


def slipping(paper: Scenario, size: float, rng: np.random.Generator) -> Array:
    """Measured configurations (80, nq) of a run in which a grip slips by a size [m] at sample 53."""
    poses = two_axes(paper.path.pose(0.0), 80)
    slipped = pin.exp6(np.array([0.0, 0.0, size, 0.0, 0.0, 0.0]))
    tools = list(paper.grasp.T_object_tool)
    later = Grasp((*tools[:2], tools[2] * slipped))
    q = held(paper.cell, paper.grasp, poses[:53], paper.q_start)
    q = np.concatenate([q, held(paper.cell, later, poses[53:], q[-1])])
    return q + rng.uniform(-NOISE, NOISE, q.shape)


@pytest.mark.slow
def test_a_slip_is_told(paper: Scenario, rng: np.random.Generator) -> None:
    """Bases and grips cannot explain both parts, though the noise hides each sample."""
    size = 3e-4
    found = calibrate(paper.cell, paper.grasp, slipping(paper, size, rng))
    assert found.slip is not None
    sample, shift = found.slip
    assert abs(sample - 53) <= 6
    assert 0.3 * size < shift < 2.0 * size
    assert "did a grip slip?" in found.explain()
    with pytest.raises(CalibrationError, match="not closed"):
        calibrate(paper.cell, paper.grasp, slipping(paper, 2e-3, rng))


def assert_no_harm(case: Case, paper: Scenario, rng: np.random.Generator, motions: int) -> None:
    done = 0
    while done < motions:
        try:
            q = held(case.cell, case.grasp, any_motion(paper.path.pose(0.0), rng, 3), paper.q_start)
        except UnreachableError:
            continue
        done += 1
        before, after = parted_mm(paper.cell, paper.grasp, q), parted_mm(case.found.cell, case.found.grasp, q)
        assert after <= 1.05 * before


def test_one_axis_leaves_a_shift_along_it_open_and_does_no_harm(
    calibrated: Callable[..., Case], paper: Scenario, rng: np.random.Generator
) -> None:
    """Along the axis of all turns a base and a grip can be exchanged. Here it is x of the bases and z of the tools."""
    case = calibrated(one_axis, rng)
    assert sorted(case.found.undetermined) == [
        "shift of the grip of slave_1 along z with +1.0 shift of the base of slave_1 along x",
        "shift of the grip of slave_2 along z with +1.0 shift of the base of slave_2 along x",
    ]
    assert case.found.determined_share == pytest.approx(22.0 / 24.0)
    assert all(name in case.found.explain() for name in case.found.undetermined)
    for arm in case.found.corrections:  # what is open keeps its prior deviation
        assert arm.base_deviation[0] > 1.8e-3
        assert arm.grip_deviation[2] > 1.8e-3
    assert_no_harm(case, paper, rng, 10)


@pytest.mark.slow
def test_one_axis_does_no_harm_on_200_motions(
    calibrated: Callable[..., Case], paper: Scenario, rng: np.random.Generator
) -> None:
    assert_no_harm(calibrated(one_axis, rng), paper, rng, 200)


def test_the_motion_that_would_determine_it_is_found_and_checked(paper: Scenario) -> None:
    motion = determining_motion(paper.cell, paper.grasp, paper.q_start)
    assert motion.check.verdict is PathVerdict.CERTIFIED
    assert np.count_nonzero(motion.tilts) >= 2
    assert motion.undetermined == ()
    q = [inverse_kinematics(paper.cell, paper.grasp, motion.path.pose(t), paper.q_start)
         for t in np.linspace(0.0, motion.path.duration, 9)]  # fmt: skip
    assert parted_mm(paper.cell, paper.grasp, np.array(q)) < 1e-5
    lift = held(paper.cell, paper.grasp, one_axis(paper.path.pose(0.0)), paper.q_start)
    assert len(undetermined_by(paper.cell, paper.grasp, lift)) == 2


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"largest": 2.0}, "determining_motion: largest"), ({"largest": 0.0}, "determining_motion: largest"),
        ({"duration": 0.0}, "determining_motion: duration"), ({"duration": math.nan}, "determining_motion: duration"),
        ({"options": {"nonsense": 1}}, "determining_motion: options"),
    ],
)  # fmt: skip
def test_bad_arguments_of_the_motion_are_named(paper: Scenario, wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(CoopqpError, match=named):
        determining_motion(paper.cell, paper.grasp, paper.q_start, **wrong)


def test_a_motion_for_another_number_of_arms_is_refused(paper: Scenario) -> None:
    two = Grasp(paper.grasp.T_object_tool[:2])
    with pytest.raises(InvalidInputError, match="2"):
        determining_motion(paper.cell, two, paper.q_start)


def test_a_chain_that_is_not_closed_is_refused(paper: Scenario, rng: np.random.Generator) -> None:
    q = held(paper.cell, paper.grasp, two_axes(paper.path.pose(0.0)), paper.q_start)
    slipped = q.copy()
    slipped[20:, 6:12] += 0.002 * rng.standard_normal(6)  # one arm slips on the way
    with pytest.raises(CalibrationError, match=r"not closed: .* part by [\d.]+ mm"):
        calibrate(paper.cell, paper.grasp, slipped)
    once = q.copy()
    once[7, 3] += 0.01  # one sample is another
    with pytest.raises(CalibrationError, match="sample 7"):
        calibrate(paper.cell, paper.grasp, once)


def test_bad_arguments(paper: Scenario) -> None:
    for q, said in (([paper.q_start], "two or more"), ("none", "no numbers"), ([[1.0, 2.0]] * 3, "configurations")):
        with pytest.raises(InvalidInputError, match=said):
            calibrate(paper.cell, paper.grasp, q)
    alone = RobotCell(paper.cell.arms[:1])
    with pytest.raises(InvalidInputError, match="one arm"):
        calibrate(alone, Grasp(paper.grasp.T_object_tool[:1]), [paper.q_start[:6]] * 3)
    with pytest.raises(InvalidInputError, match="encoder_noise"):
        calibrate(paper.cell, paper.grasp, [paper.q_start] * 3, options={"encoder_noise": 0.0})
    with pytest.raises(InvalidInputError, match="no recordings"):
        calibrate_runs([])


# -- recordings and the engine -----------------------------------------------------------------------------------------


def plant_of(lift: Scenario, arm: str, noise: float, seed: int) -> PhysicsPlant:
    disturbances = Disturbances(base_offset={arm: BASE_OFF}, encoder_noise=noise, seed=seed)
    return PhysicsPlant.of(lift, disturbances=disturbances)


def lifted(lift: Scenario, plant: PhysicsPlant, cell: RobotCell, grasp: Grasp) -> tuple[Recording, Array]:
    """A lift with a model on a plant, and the wrenches at its end."""
    q = inverse_kinematics(cell, grasp, lift.path.pose(0.0), lift.q_start)
    # The first run squeezes: it must not be stopped for what it is to measure.
    tolerant = QPOptions(supervision=SupervisionOptions(slow_from=0.005, hold_from=0.01, stall_samples=10_000))
    controller = QPController(cell, grasp, lift.path, dt=lift.dt, options=tolerant)
    run = simulate(controller, plant, q_start=q, settle=0.3)
    assert run.finished
    return run, plant.wrenches()


@pytest.fixture(scope="module")
def engine() -> Scenario:
    return paper_lift(time_law="quintic")


@pytest.fixture(scope="module")
def at_rest(engine: Scenario) -> Array:
    """Wrenches at the end of the lift with everything where the model has it."""
    return lifted(engine, PhysicsPlant.of(engine), engine.cell, engine.grasp)[1]


@pytest.fixture(scope="module")
def squeezed(engine: Scenario) -> tuple[Recording, Array]:
    """The lift with the worst base off, and ideal encoders."""
    return lifted(engine, plant_of(engine, "slave_2", 0.0, 0), engine.cell, engine.grasp)


def force(wrenches: Array, at_rest: Array) -> float:
    """Largest force at a grasp beyond the load [N]."""
    return float(np.linalg.norm((wrenches - at_rest)[:, :3], axis=1).max())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_after_one_lift_the_next_one_squeezes_no_more(
    engine: Scenario, at_rest: Array, squeezed: tuple[Recording, Array]
) -> None:
    run, wrenches = squeezed
    assert force(wrenches, at_rest) > 200.0  # N
    found = calibrate_runs([run], cell=engine.cell)
    _, after = lifted(engine, plant_of(engine, "slave_2", 0.0, 1), found.cell, found.grasp)
    assert force(after, at_rest) <= 1.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize(("noise", "most"), [(0.0, 1.0), (NOISE, 15.0)])
@pytest.mark.parametrize("arm", ["master", "slave_1", "slave_2"])
def test_each_base_off_in_turn(engine: Scenario, at_rest: Array, arm: str, noise: float, most: float) -> None:
    run, before = lifted(engine, plant_of(engine, arm, noise, 0), engine.cell, engine.grasp)
    assert force(before, at_rest) > 100.0
    found = calibrate_runs([run], cell=engine.cell)
    _, after = lifted(engine, plant_of(engine, arm, noise, 1), found.cell, found.grasp)
    assert force(after, at_rest) <= most


@pytest.mark.slow
def test_runs_without_a_grip_are_refused(paper: Scenario, squeezed: tuple[Recording, Array]) -> None:
    run = squeezed[0]
    assert run.metadata["gripped"] is True
    assert run.metadata["plant"] == "PhysicsPlant"
    for plant in (None, DisturbedPlant(paper.cell, paper.grasp)):
        loose = simulate(QPController(paper.cell, paper.grasp, paper.path, dt=0.1), plant, q_start=paper.q_start)
        with pytest.raises(CalibrationError, match="held no object"):
            calibrate_runs([loose], gripped=True)
    silent = replace(run, metadata={key: value for key, value in run.metadata.items() if key != "gripped"})
    with pytest.raises(CalibrationError, match="does not say"):
        calibrate_runs([silent])
    assert calibrate_runs([silent], gripped=True, options={"samples": 20}).samples.size == 20
    other = replace(run, T_object_tool=run.T_object_tool + 1e-6)
    with pytest.raises(CalibrationError, match="another grasp"):
        calibrate_runs([run, other])
    with pytest.raises(InvalidInputError, match="other arms"):
        calibrate_runs([run], cell=RobotCell(paper.cell.arms[:2]))


def test_an_open_grip_is_seen(engine: Scenario) -> None:
    plant = PhysicsPlant.of(engine)
    plant.reset(engine.q_start)
    assert plant.gripped
    plant.release()
    assert not plant.gripped


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_writes_a_cell_file_that_runs(
    tmp_path: Path, squeezed: tuple[Recording, Array], capsys: pytest.CaptureFixture[str]
) -> None:
    file, out, picture, figures = (
        tmp_path / name for name in ("run.npz", "better.toml", "closure.png", "figures.json")
    )
    squeezed[0].save(file)
    given = ["calibrate", str(file), "--out", str(out)]
    assert main([*given, "--quiet"]) == 2  # a run of a program has no cell file
    assert "--cell" in capsys.readouterr().err
    more = ["--cell", str(example_path("paper_lift")), "--picture", str(picture), "--json", str(figures)]
    assert main([*given, *more]) == 0
    said = capsys.readouterr().out
    assert "closure: 4.32 mm" in said
    assert "not determined by this motion" in said
    assert "tilts of the object" in said
    assert "determines all of it" in said
    assert picture.stat().st_size > 20_000
    record = json.loads(figures.read_text())
    assert record["closure_mm"]["before"] > 4.0 > 0.01 > record["closure_mm"]["after"]
    assert [arm["arm"] for arm in record["arms"]] == ["slave_1", "slave_2"]
    made = load_cell_file(out)
    found = calibrate_runs([squeezed[0]])
    for arm, expected in zip(made.scenario.cell.arms, found.cell.arms, strict=True):
        np.testing.assert_allclose(arm.T_world_base.homogeneous, expected.T_world_base.homogeneous, atol=1e-15)
    for X, Y in zip(made.scenario.grasp.T_object_tool, found.grasp.T_object_tool, strict=True):
        np.testing.assert_allclose(X.homogeneous, Y.homogeneous, atol=1e-15)
    assert (
        chain_error(list(CellState(made.scenario.cell, made.scenario.q_start).T_world_tool), made.scenario.grasp)[0]
        < 1e-9
    )
    assert main([*given, *more]) == 2  # nothing is overwritten
    assert "--force" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_takes_the_cell_file_from_a_recording_of_one(
    tmp_path: Path, squeezed: tuple[Recording, Array]
) -> None:
    from coopqp.files.cellfile.build import read

    tables = read(example_path("paper_lift")).model_dump(mode="json", exclude_none=True, exclude_unset=True)
    run = replace(squeezed[0], metadata={**squeezed[0].metadata, "settings": tables})
    run.save(tmp_path / "run.npz")
    (tmp_path / "sub").mkdir()
    out = tmp_path / "sub" / "better.toml"
    assert main(["calibrate", str(tmp_path / "run.npz"), "--out", str(out), "--quiet"]) == 0
    assert load_cell_file(out).scenario.cell.arm_names == ("master", "slave_1", "slave_2")


@pytest.mark.slow
def test_the_command_refuses_with_status_2(
    tmp_path: Path, paper: Scenario, squeezed: tuple[Recording, Array], capsys: pytest.CaptureFixture[str]
) -> None:
    loose = simulate(QPController(paper.cell, paper.grasp, paper.path, dt=0.1), q_start=paper.q_start)
    loose.save(tmp_path / "loose.npz")
    torn = squeezed[0].q.copy()
    torn[200:, 8] += 0.003
    replace(squeezed[0], q=torn).save(tmp_path / "torn.npz")
    (tmp_path / "text.npz").write_text("no recording")
    cell = ["--cell", str(example_path("paper_lift"))]
    for name, said in (
        ("loose.npz", "held no object"),
        ("torn.npz", "not closed"),
        ("text.npz", "not a coopqp recording"),
        ("gone.npz", "gone.npz"),
    ):
        out = tmp_path / "out.toml"
        assert main(["calibrate", str(tmp_path / name), "--out", str(out), *cell]) == 2
        assert said in capsys.readouterr().err
        assert not out.exists()
    assert main(["calibrate", str(tmp_path / "torn.npz"), "--out", str(tmp_path / "out.yaml")]) == 2
    assert ".toml" in capsys.readouterr().err
