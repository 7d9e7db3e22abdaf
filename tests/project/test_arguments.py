"""Arguments of the API: what is meaningful is accepted, the rest is refused by name before anything is changed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import (
    Arm,
    CoopqpError,
    Grasp,
    HoldPath,
    InvalidInputError,
    LinePath,
    PreviewOptions,
    QPController,
    QPOptions,
    RobotCell,
    ServoPath,
    WaypointPath,
    inverse_kinematics,
    load_cell_file,
    simulate,
)
from coopqp.baselines import (
    IndependentQPController,
    IndependentQPOptions,
    PseudoInverseController,
    PseudoInverseOptions,
)
from coopqp.control import RankWeights
from coopqp.scenarios import Scenario, paper_lift, robot_arm, robot_path
from coopqp.simulation import DisturbedPlant, KinematicPlant, Monitor, PhysicsPlant, describe_object, evaluate, read_run
from coopqp.simulation.evaluation.monitor import COMMANDED
from coopqp.solvers import OsqpSettings, ProxqpSettings, make_solver
from coopqp.spatial import adjoint
from coopqp.visualization import export_html, write_report

LIFT = paper_lift()
CELL, GRASP, PATH = LIFT.cell, LIFT.grasp, LIFT.path
MATRIX = LIFT.path.pose(0.0).homogeneous


def controller(**changes: Any) -> QPController:
    parts = {"cell": CELL, "grasp": GRASP, "path": PATH, "dt": 0.0075, **changes}
    return QPController(parts.pop("cell"), parts.pop("grasp"), parts.pop("path"), **parts)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: controller(dt="0.01"), "dt: not a number"),
        (lambda: controller(dt=True), "dt: not a number"),
        (lambda: QPOptions(grasp_gain="20"), "grasp_gain: not a number"),  # type: ignore[arg-type]
        (lambda: simulate(QPController), "the class QPController itself"),  # type: ignore[arg-type]
        (lambda: simulate(None), "simulate: controller: a NoneType"),  # type: ignore[arg-type]
        (lambda: robot_arm("arm7", locked_joints=["joint_1"]), "Give a dictionary"),  # type: ignore[arg-type]
        (lambda: Arm.from_urdf("a", robot_path("arm7"), tool_frame="tool", locked_joints=["joint_1"]), "dictionary"),  # type: ignore[arg-type]
        (lambda: write_report(None, "r.html"), "report: recording: a NoneType"),  # type: ignore[arg-type]
        (lambda: export_html(3, "v.html"), "viewer: recording: a int"),  # type: ignore[arg-type]
        (lambda: load_cell_file(3), "load_cell_file: path: a int"),  # type: ignore[arg-type]
    ],
)
def test_what_is_none_of_it_is_refused_by_name(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(InvalidInputError, match=re.escape(words)):
        call()


def test_options_may_be_a_dictionary() -> None:
    given = {"grasp_gain": 10, "preview": {"newton_steps": 2}, "weights": {"posture": 1e-5}}
    options = QPOptions(grasp_gain=10, preview=PreviewOptions(newton_steps=2), weights=RankWeights(posture=1e-5))
    made = controller(options=given).options
    for name in ("grasp_gain", "path_gain", "preview", "weights", "supervision"):
        assert getattr(made, name) == getattr(options, name)
    assert controller(options={}).options.grasp_gain == QPOptions().grasp_gain
    assert given == {"grasp_gain": 10, "preview": {"newton_steps": 2}, "weights": {"posture": 1e-5}}
    pseudo = PseudoInverseController(CELL, GRASP, PATH, dt=0.01, options={"reset_every": 10})
    assert pseudo.options == PseudoInverseOptions(reset_every=10)
    alone = IndependentQPController(CELL, GRASP, PATH, dt=0.01, options={"gain": 10})
    assert alone.options == IndependentQPOptions(gain=10.0)
    assert Monitor(CELL, GRASP, tolerances={"chain_mm": 1.0}).tolerances == replace(COMMANDED, chain_mm=1.0)
    assert DisturbedPlant(CELL, GRASP, {"encoder_noise": 1e-4}).disturbances.encoder_noise == 1e-4
    recording = simulate(controller(), q_start=LIFT.q_start, duration=0.02)
    readings = read_run(CELL, recording)
    assert not evaluate(CELL, recording, readings, tolerances={"object_mm": 1e-12})[-1].holds


def test_the_physics_plant_takes_a_dictionary() -> None:
    assert PhysicsPlant.of(LIFT, options={"timestep": 0.002}).options.timestep == 0.002


def test_solvers_are_names_or_objects_and_settings_may_be_a_dictionary() -> None:
    assert controller(options=QPOptions(solver=make_solver("daqp"))).solver == "daqp"
    assert controller(options={"solver": "daqp"}).solver == "daqp"
    settings = {"max_iter": 50}
    solver: Any = make_solver("proxqp", settings)
    assert solver.settings == ProxqpSettings(max_iter=50)
    controller(options={"solver": "proxqp", "solver_settings": settings})


@pytest.mark.parametrize("dt", [np.float32(0.5), np.float64(0.5), np.array(0.5)])
def test_any_number_is_a_length_of_a_step(dt: Any) -> None:
    assert controller(dt=dt).dt == 0.5


@pytest.mark.parametrize("dt", [2, np.float32(2.0), np.int64(2), np.array(2.0)])
def test_whole_numbers_are_milliseconds_and_no_length_of_a_step(dt: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"milliseconds\. Give seconds: 0\.002"):
        controller(dt=dt)


def test_a_matrix_is_a_placement() -> None:
    """Wherever a placement is wanted: as an array or as a list."""
    same = HoldPath(MATRIX, duration=1.0).pose(0.0).homogeneous
    for T in (MATRIX, MATRIX.tolist()):
        np.testing.assert_array_equal(HoldPath(T, duration=1.0).pose(0.0).homogeneous, same)
        LinePath(T, T, duration=1.0)
        LinePath.displaced(T, translation=(0.0, 0.0, 0.1), rotation=(0.0, 0.0, 0.0), duration=1.0)
        WaypointPath([T, T], durations=[1.0])
        ServoPath(T)
        Grasp([T, T])
        Grasp.from_configuration(CELL, LIFT.q_start, T)
        describe_object((1.0, 1.0, 1.0), T)
        CELL.arms[0].placed(T)
        robot_arm("arm7", T_world_base=T)
        replace(LIFT, T_object_body=T)
        inverse_kinematics(CELL, GRASP, T, LIFT.q_start)
        np.testing.assert_array_equal(adjoint(T), LIFT.path.pose(0.0).action)


#: Wrong arguments, and what the error says: the argument, what it is, and what to give.
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "a number as options": (lambda: controller(options=3), r"QPController: options: a int. Give QPOptions\(…\)"),
    "the class of options": (lambda: controller(options=QPOptions), "QPController: options: the class itself"),
    "other options": (lambda: controller(options=PseudoInverseOptions()), "options: a PseudoInverseOptions"),
    "an unknown option": (lambda: controller(options={"grasp_gian": 1}), "Did you mean 'grasp_gain'"),
    "a key that is no text": (lambda: controller(options={3: 1}), "no option named '3'"),
    "a bad option": (lambda: controller(options={"grasp_gain": "fast"}), "QPOptions: grasp_gain: not a number"),
    "an unknown part": (lambda: controller(options={"preview": {"cel": 1}}), "QPOptions: preview"),
    "a common error by name": (lambda: QPOptions(common_error="leaderless"), "common_error is a str"),  # type: ignore[arg-type]
    "a number as solver": (lambda: controller(options={"solver": 3}), "Give a solver's name or a QpSolver"),
    "settings of another solver": (
        lambda: controller(options={"solver": "proxqp", "solver_settings": OsqpSettings()}),
        r"a OsqpSettings. Give ProxqpSettings\(…\)",
    ),
    "an unknown setting": (lambda: make_solver("proxqp", {"eps": 1}), "no option named 'eps'"),
    "a text as dt": (lambda: controller(dt="soon"), "QPController: dt: not a number"),
    "no dt": (lambda: controller(dt=None), "QPController: dt: not a number"),
    "an arm as cell": (lambda: controller(cell=CELL.arms[0]), "cell: a Arm. Give a RobotCell"),
    "a list as grasp": (lambda: controller(grasp=[MATRIX] * 3), "QPController: grasp: a list. Give a Grasp"),
    "a matrix as path": (lambda: controller(path=MATRIX), "the path is a ndarray. Give an ObjectPath"),
    "a number as constraints": (lambda: controller(constraints=3), "constraints: a int"),
    "an arm as arms": (lambda: RobotCell(CELL.arms[0]), "RobotCell: a Arm. Give a list of Arm"),  # type: ignore[arg-type]
    "one matrix as grasp": (lambda: Grasp(MATRIX), "a placement must be 4x4"),
    "a scenario as controller": (lambda: simulate(LIFT, q_start=LIFT.q_start), "simulate: controller: a Scenario"),  # type: ignore[arg-type]
    "a number as plant": (lambda: simulate(controller(), 3, q_start=LIFT.q_start), "simulate: plant: a int"),  # type: ignore[arg-type]
    "a number as cell": (lambda: KinematicPlant(3), "KinematicPlant: cell: a int"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused_by_name(case: str) -> None:
    build, message = REFUSED[case]
    with pytest.raises(CoopqpError, match=message):
        build()


@pytest.mark.parametrize("path", [None, MATRIX, "line", LinePath], ids=["none", "matrix", "text", "class"])
def test_a_path_that_is_none_changes_nothing(path: Any, paper: Scenario) -> None:
    """``follow`` checks before it changes anything: the run goes on bit for bit."""
    made, same = controller(), controller()
    for each in (made, same):
        each.reset(paper.q_start)
        each.step()
    with pytest.raises(InvalidInputError, match=re.escape("follow: the path is a ")):
        made.follow(path)
    for _ in range(5):
        np.testing.assert_array_equal(made.step().q_next, same.step().q_next)
