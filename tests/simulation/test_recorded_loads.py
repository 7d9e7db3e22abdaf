"""Runs that were recorded with forces and torques: files, figures, verdicts, the monitor; scenarios in the engine."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from coopqp import InvalidInputError, QPController, Recording, simulate
from coopqp.cli.main import main
from coopqp.errors import StartWarning
from coopqp.scenarios import LOADED, Scenario, paper_lift
from coopqp.simulation import KinematicPlant, PhysicsPlant, ViolationKind, check_run, evaluate, read_run, run_in_engine
from coopqp.simulation.evaluation.assessment import run_figures

#: The encoders of an arm whose base is off tell another place than that of its grasp.
OFF = {"base_off_lift": ["arm slave_2 started off its grasp"]}
LOAD = {"load": {"torque_limits": None, "internal_force": 1000.0}}


@pytest.fixture(scope="module")
def task() -> Scenario:
    return paper_lift(time_law="quintic", duration=0.3)


@pytest.fixture(scope="module")
def run(task: Scenario) -> Recording:
    pytest.importorskip("mujoco")
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    return simulate(controller, PhysicsPlant.of(task), q_start=task.q_start, loads=True, metadata=LOAD)


def verdict(task: Scenario, run: Recording) -> dict[str, bool]:
    return {f.question: f.holds for f in evaluate(task.cell, run, read_run(task.cell, run))}


def test_what_is_recorded_is_what_the_engine_says(task: Scenario, run: Recording) -> None:
    """The wrenches sum up to what moves the plate; the drives bear the arms and the plate, as RNEA says at rest."""
    assert run.wrenches is not None
    assert run.torques is not None
    R = task.path.pose(0.0).rotation
    total = sum(X.actionInverse.T @ w for X, w in zip(task.grasp.T_object_tool, run.wrenches[0], strict=True))
    weight = 9.81 * task.object_mass
    np.testing.assert_allclose((R @ total[:3]), [0.0, 0.0, weight], atol=0.05 * weight)
    model, q = task.cell.model, run.q[0]
    expected = pin.computeGeneralizedGravity(model, model.createData(), q)
    J = pin.computeJointJacobians(model, data := model.createData(), q)
    pin.updateFramePlacements(model, data)
    for s, frame, w in zip(task.cell.v_slices, task.cell.tool_frames, run.wrenches[0], strict=True):
        expected[s] += pin.getFrameJacobian(model, data, frame, pin.LOCAL)[:, s].T @ w
    assert J.shape == (6, task.cell.nv)
    np.testing.assert_allclose(run.torques[0], expected, atol=0.03 * np.abs(expected).max())


def test_a_file_keeps_forces_and_runs_without_them_have_none(run: Recording, task: Scenario, tmp_path: Path) -> None:
    shifted = replace(run, shift=np.zeros((run.n_steps, 3, 6)))
    again = Recording.load(shifted.save(tmp_path / "run.npz"))
    for name in ("wrenches", "torques", "shift"):
        np.testing.assert_array_equal(getattr(again, name), getattr(shifted, name))
    bare = replace(run, wrenches=None, torques=None)
    assert Recording.load(bare.save(tmp_path / "bare.npz")).wrenches is None
    assert "torque, most used" not in run_figures(task.cell, bare, read_run(task.cell, bare))
    with pytest.raises(InvalidInputError, match="has no forces"):
        simulate(
            QPController(task.cell, task.grasp, task.path, dt=0.01),
            KinematicPlant(task.cell),
            q_start=task.q_start,
            loads=True,
        )


def test_torques_and_squeezing_beyond_their_limits_are_told(task: Scenario, run: Recording) -> None:
    """Where the verdict says no, the monitor has found a kind, and else none."""
    asked = "Do the arms carry the load?", "Is the object held without squeezing?"
    assert all(verdict(task, run)[question] for question in asked)
    assert run.torques is not None
    most = np.abs(run.torques).max(axis=0)
    tight = [float(0.9 * x) if j == 1 else None for j, x in enumerate(most)]
    for load, question, kind in (
        ({"torque_limits": tight, "internal_force": None}, asked[0], ViolationKind.TORQUE),
        ({"torque_limits": None, "internal_force": 1e-3}, asked[1], ViolationKind.SQUEEZE),
    ):
        bad = replace(run, metadata={**run.metadata, "load": load})
        answers = verdict(task, bad)
        assert [q for q in asked if not answers[q]] == [question]
        found = check_run(bad, task.cell)
        assert found.counts[kind] > 0
    assert check_run(run, task.cell).ok


def test_arms_that_give_way_are_judged_at_the_grasps_that_they_hold(task: Scenario, run: Recording) -> None:
    """A constant shift of the commands' grasps, undone in the record, is no error of the chain; said wrongly, it is."""
    d = np.array([np.zeros(6), [1e-3, 0, 0, 0, 2e-3, 0], [0, -2e-3, 0, 1e-3, 0, 0]])
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    controller.shift_grasp(d)
    controller.reset(task.q_start)
    moved = simulate(controller, q_start=run.q[0], duration=2.0, settle=1.0)
    assert not verdict(task, moved)["Do the arms agree on where the object is?"]
    said = replace(moved, shift=np.tile(d, (moved.n_steps, 1, 1)))
    readings = read_run(task.cell, said)
    assert readings.chain_mm[-1] < 1e-3
    assert readings.object_mm[-1] < 1e-2
    assert check_run(said, task.cell).worst.chain_m < 5e-3


@pytest.mark.slow
def test_the_command_runs_scenarios_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a folder of that name lies around; other names are files."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scara_pair").mkdir()
    assert main(["run", "scara_pair", "--quiet", "--out", "there"]) == 0
    assert Recording.load(tmp_path / "there" / "recording.npz").finished
    assert main(["run", "no_such_cell", "--quiet"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", LOADED)
def test_scenarios_with_loads_hold_all_that_their_verdict_asks(name: str) -> None:
    pytest.importorskip("mujoco")
    scenario = LOADED[name]()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", StartWarning)
        run = run_in_engine(scenario)
    starts = [str(warning.message) for warning in told if issubclass(warning.category, StartWarning)]
    assert [text.partition(":")[0] for text in starts] == OFF.get(name, [])
    assert run.finished
    assert all(verdict(scenario, run).values())
    figures = run_figures(scenario.cell, run, read_run(scenario.cell, run))
    ends = "internal force" if scenario.engine is None or scenario.engine.palms is None else "squeeze"
    assert {"torque, most used", f"{ends} at the end"} <= set(figures)
