"""One row of a study: its figures by a form that shares no code with them, and how its settings make its run."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import CollisionScene, RobotCell, simulate
from coopqp.baselines import PseudoInverseController
from coopqp.errors import StartWarning
from coopqp.scenarios import Scenario, paper_lift, plate_and_table, torso_lift
from coopqp.simulation import DisturbedPlant, KinematicPlant, Recording
from coopqp.spatial import Array
from coopqp.studies import Study, StudyError, load_study
from coopqp.studies.drawing import DisturbancesTable, disturbances
from coopqp.studies.row import RowTask, build_row

PSEUDO = 'controller = { kind = "pseudo_inverse" }\n'


def study_of(folder: Path, scenario: str, settings: str = "", more: str = "", head: str = "") -> Study:
    file = folder / "study.toml"
    text = f'name = "s"\nscenario = "{scenario}"\n{head}\n[set]\n{settings}\n{more}'
    file.write_text(text, encoding="utf-8")
    return load_study(file)


def tools_of(cell: RobotCell, q: Array) -> list[pin.SE3]:
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, q)
    return [data.oMf[frame].copy() for frame in cell.tool_frames]


def run_of(lift: Scenario, steps: int, plant: Any = None, **loop: Any) -> Recording:
    controller = PseudoInverseController(lift.cell, lift.grasp, lift.path, dt=lift.path.duration / steps)
    return simulate(controller, plant, q_start=lift.q_start, **loop)


@pytest.mark.parametrize(("build", "kind"), [(paper_lift, PSEUDO), (torso_lift, "")])
def test_margins_speeds_and_unrest_are_those_of_the_commands(build: Any, kind: str, tmp_path: Path) -> None:
    """With joints that slide and without."""
    study = study_of(tmp_path, build.__name__, f"steps = 12\n{kind}")
    row, ready = RowTask(study)(0), build_row(study, 0)
    lift = ready.scenario
    run = simulate(ready.controller(), q_start=lift.q_start)
    x, limits = lift.cell.positions(run.q_command), lift.cell.limits
    slides = np.array([name.endswith("/lift") for name in lift.cell.joint_names])
    room = np.minimum(x - limits.lower, limits.upper - x).min(axis=0)
    assert row["margin_deg"] == pytest.approx(np.rad2deg(room[~slides].min()))
    assert row["margin_mm"] == (pytest.approx(1e3 * room[slides].min()) if slides.any() else np.inf)
    assert row["speed_share"] == pytest.approx(np.max(np.abs(run.velocity) / limits.velocity))
    changes = np.diff(run.velocity[:, ~slides], axis=0)
    assert row["unrest_deg_per_s"] == pytest.approx(np.rad2deg(np.linalg.norm(changes) / np.sqrt(changes.size)))
    assert row["unrest_deg_per_s"] > 0.0
    assert row["rate_min"] == run.rate.min()
    assert row["time_s"] == run.time[-1]
    assert row["steps"] == run.n_steps >= 12
    assert np.isnan(row["true_chain_mm"])
    assert np.isnan(row["true_chain_deg"])
    assert np.isnan(row["closest_mm"])


def test_a_run_of_one_step_has_no_unrest(tmp_path: Path) -> None:
    row = RowTask(study_of(tmp_path, "paper_lift", f"steps = 1\n{PSEUDO}"))(0)
    assert (row["outcome"], row["steps"], row["unrest_deg_per_s"]) == ("ok", 1, 0.0)


def test_the_true_errors_are_those_of_arms_whose_bases_are_off(tmp_path: Path) -> None:
    """The object that the first arm holds moves with it; the others are compared with where it takes their grasps."""
    head = "seed = 5"
    more = "[disturbances]\nbase_offset_mm = 2.0\nbase_offset_deg = 1.0\nlag_s = 0.05"
    study = study_of(tmp_path, "paper_lift", f"steps = 10\n{PSEUDO}", more, head)
    row = RowTask(study)(0)
    lift = paper_lift()
    amounts = DisturbancesTable(base_offset_mm=2.0, base_offset_deg=1.0, lag_s=0.05)
    disturbed = disturbances(amounts, lift.cell, seed=5, draw=0, repeat=0)
    assert disturbed is not None
    plant, seen = DisturbedPlant(lift.cell, lift.grasp, disturbed), [lift.q_start]
    run = run_of(lift, 10, plant, observe=lambda _: seen.append(plant.q))
    assert len(seen) == run.n_steps + 1

    def object_poses(q: Array) -> list[pin.SE3]:
        poses = []
        for tool, arm in zip(tools_of(lift.cell, q), lift.cell.arms, strict=True):
            moved = disturbed.base_offset.get(arm.name, pin.SE3.Identity())
            poses.append(arm.T_world_base * moved * arm.T_world_base.actInv(tool))
        return poses

    first = object_poses(seen[0])
    held = [first[0].actInv(pose) for pose in first]
    far, turned = 0.0, 0.0
    for q in seen:
        objects = [tool * T.inverse() for tool, T in zip(object_poses(q), held, strict=True)]
        for one in objects:
            for other in objects:
                apart = one.actInv(other)
                far = max(far, float(np.linalg.norm(apart.translation)))
                turned = max(turned, float(np.linalg.norm(pin.log3(apart.rotation))))
    assert row["true_chain_mm"] == pytest.approx(1e3 * far, rel=1e-9)
    assert row["true_chain_deg"] == pytest.approx(np.rad2deg(turned), rel=1e-6)
    assert row["true_chain_mm"] > 0.1
    assert row["true_chain_mm"] != pytest.approx(row["chain_mm"], rel=1e-3)


def test_a_row_with_obstacles_tells_the_least_distance_whoever_controls(tmp_path: Path) -> None:
    task = plate_and_table()
    scene, run = CollisionScene.of(task), run_of(task, 20)
    row = RowTask(study_of(tmp_path, "plate_and_table", f"steps = 20\n{PSEUDO}"))(0)
    assert row["outcome"] == "ok"
    least = min(scene.distances(q)[0].distance for q in run.q_command)
    assert least < -0.01  # nothing keeps the plate off the table
    assert row["closest_mm"] <= 0.0
    assert row["verdict"] == "no"
    assert row["reason"]
    (tmp_path / "qp").mkdir()
    kept = RowTask(study_of(tmp_path / "qp", "plate_and_table", "steps = 60\nlongest_s = 3.0"))(0)
    assert kept["outcome"] == "ok"
    assert kept["closest_mm"] > 0.0  # the QP keeps it off


def test_settings_of_the_loop_reach_the_run(tmp_path: Path) -> None:
    def built(settings: str) -> Any:
        return build_row(study_of(tmp_path, "paper_lift", settings), 0)

    lift = paper_lift()
    assert built("").scenario.dt == lift.dt
    assert built("dt_s = 0.02").scenario.dt == 0.02
    assert built("steps = 50").scenario.dt == pytest.approx(lift.path.duration / 50)
    assert built("steps = 50\ndt_s = 0.02").scenario.dt == pytest.approx(lift.path.duration / 50)
    assert built("scenario = { duration = 2.0, h = 3.55 }").scenario.path.duration == 2.0
    assert (built("").settle, built("").longest, built("").controller_kind) == (0.0, None, "qp")
    made = built(f"settle_s = 0.25\nlongest_s = 9.0\n{PSEUDO}")
    assert (made.settle, made.longest, made.controller_kind) == (0.25, 9.0, "pseudo_inverse")
    settled = RowTask(study_of(tmp_path, "paper_lift", f"steps = 10\nsettle_s = 0.6\n{PSEUDO}"))(0)
    assert settled["time_s"] == pytest.approx(lift.path.duration + 0.6)
    short = RowTask(study_of(tmp_path, "paper_lift", f"steps = 10\nlongest_s = 0.9\n{PSEUDO}"))(0)
    assert short["time_s"] == pytest.approx(0.9)
    assert (short["finished"], settled["finished"]) == ("no", "yes")


def test_a_verdict_follows_its_tolerances_and_its_reason_names_what_is_exceeded(tmp_path: Path) -> None:
    rows = [
        RowTask(study_of(tmp_path, "paper_lift", f"steps = 40\n{PSEUDO}verdict = {{ {verdict} }}"))(0)
        for verdict in ("chain_mm = 1e3, chain_deg = 100.0, object_mm = 1e3, object_deg = 100.0", "chain_mm = 1e-3")
    ]
    assert [row["verdict"] for row in rows] == ["yes", "no"]
    assert rows[0]["reason"] == ""
    assert rows[1]["reason"].startswith("Do the arms agree on where the object is? No: arms ")
    assert rows[0]["eps_p_mm"] == rows[1]["eps_p_mm"]


def test_a_start_that_is_told_in_the_figures_is_no_warning(tmp_path: Path) -> None:
    study = study_of(tmp_path, "paper_lift", f"steps = 2\n{PSEUDO}scenario = {{ h = 3.0 }}")
    with warnings.catch_warnings():
        warnings.simplefilter("error", StartWarning)
        RowTask(study)(0)


def test_a_row_that_failed_tells_its_reason_in_one_line(tmp_path: Path) -> None:
    far = RowTask(study_of(tmp_path, "paper_lift", "scenario = { h = 9.0 }"))(0)
    assert set(far) == {"outcome", "reason"}
    assert far["outcome"] == "failed"
    assert far["reason"].startswith("UnreachableError: ")
    assert "\n" not in far["reason"]
    late = RowTask(study_of(tmp_path, "paper_lift", "steps = 5", head="timeout_s = 1e-6"))(0)
    assert "longer than 1e-06 s of wall time (timeout_s)" in late["reason"]
    with pytest.raises(StudyError):
        study_of(tmp_path, "paper_lift", "steps = 0")


def test_a_row_is_the_same_whichever_row_was_run_before(tmp_path: Path) -> None:
    more = "[axes]\nscenario.duration = [1.0, 2.0]\n[disturbances]\nencoder_noise_rad = 1e-4"
    study = study_of(tmp_path, "paper_lift", "steps = 20", more, "repeats = 2")
    forward, backward = [RowTask(study)(i) for i in range(4)], [RowTask(study)(i) for i in (3, 2, 1, 0)]
    assert repr(forward) == repr(backward[::-1])
    assert len({row["unrest_deg_per_s"] for row in forward}) == 4
    assert isinstance(build_row(study, 0).plant(), KinematicPlant)
    with pytest.raises(AttributeError):
        RowTask(study).study = study  # type: ignore[misc]
