"""One row of a study: a run, and its figures in one pass over its samples. Runs in the workers."""

from __future__ import annotations

import functools
import json
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from coopqp.collision.scene import CollisionScene
from coopqp.control.interface import ControlStep
from coopqp.errors import CoopqpError, StartWarning, said
from coopqp.files.cellfile.build import CellRun, build, controller_options
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.strict import build_options
from coopqp.model.cell import slides
from coopqp.model.grasp import Grasp
from coopqp.scenarios import SCENARIOS
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.evaluation.assessment import Tolerances, evaluate, why, worst_status
from coopqp.simulation.evaluation.closeness import with_clearance
from coopqp.simulation.evaluation.metrics import Readings, read_run
from coopqp.simulation.plants.disturbances import Disturbances
from coopqp.simulation.plants.kinematic import DisturbedPlant
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.simulate import simulate
from coopqp.spatial import Array
from coopqp.studies.drawing import disturbances
from coopqp.studies.study import ScenarioFile, Study
from coopqp.studies.table import FAILED, OK


class _TooLongError(CoopqpError):
    """A run took longer than the study allows."""


@functools.lru_cache(maxsize=4)
def _ready(scenario: str, folder: str, text: str) -> CellRun:
    """The run of a row without its disturbances, from its settings as JSON; built once in each worker."""
    data = json.loads(text)
    if not scenario:
        run = build(CellFile.model_validate(data), Path(folder))
        return replace(run, scene=run.scene if run.settings.collision is not None else None).led()
    settings = ScenarioFile.model_validate(data)
    task = SCENARIOS[scenario](**settings.scenario)
    dt = task.path.duration / settings.steps if settings.steps is not None else settings.dt_s or task.dt
    kind = str(settings.controller.kind)
    scene = CollisionScene.of(task) if task.obstacles else None
    return CellRun(
        replace(task, dt=dt),
        kind,
        controller_options(kind, settings.controller),
        settings.settle_s,
        settings.longest_s,
        settings,
        scene=scene,
        avoids=scene is not None and kind == "qp",
    ).led()


def build_row(study: Study, index: int) -> CellRun:
    """Build the run of a row, without its disturbances.

    Raises:
        CoopqpError: it cannot be built.
    """
    data, _ = study.data(study.row(index).values)
    return _ready(study.scenario, study.folder, json.dumps(data, sort_keys=True))


@final
@dataclass(frozen=True, eq=False)
class RowTask:
    """Runs rows of a study: what workers get."""

    study: Study

    def __call__(self, index: int) -> dict[str, Any]:
        """The columns of a row. Whatever the run raises is a row that failed, with its reason."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", StartWarning)  # the row has the figures
                return self._run(index)
        except Exception as error:
            return {"outcome": FAILED, "reason": " ".join(said(error).split())}

    def _run(self, index: int) -> dict[str, Any]:
        study = self.study
        row = study.row(index)
        _, amounts = study.settings(row.values)
        ready = build_row(study, index)
        s, settings = ready.scenario, ready.settings
        disturbed = disturbances(amounts, s.cell, seed=study.seed, draw=row.draw, repeat=row.repeat)
        plant = replace(ready, disturbances=disturbed).plant()
        truth: list[Array] = []
        end = time.monotonic() + study.timeout_s

        def observe(_: ControlStep) -> None:
            if isinstance(plant, DisturbedPlant):
                truth.append(plant.q)
            if time.monotonic() > end:
                raise _TooLongError(f"longer than {study.timeout_s:g} s of wall time (timeout_s)")

        recording = simulate(
            ready.controller(),
            plant,
            q_start=s.q_start,
            duration=ready.longest,
            settle=ready.settle,
            patience=settings.patience_s,
            observe=observe,
        )
        if ready.scene is not None:
            recording = with_clearance(recording, ready.scene, avoided=ready.avoids)
        readings = read_run(s.cell, recording)
        tolerances = build_options(Tolerances, settings.verdict)
        causes = why(evaluate(s.cell, recording, readings, tolerances=tolerances))
        return {
            "outcome": OK,
            "reason": "; ".join(causes),
            "status": worst_status(recording),
            "finished": "yes" if recording.finished else "no",
            "verdict": "no" if causes else "yes",
            **_figures(ready, recording, readings),
            **_truth(ready, disturbed, np.array([s.q_start, *truth])),
        }


def _figures(ready: CellRun, recording: Recording, readings: Readings) -> dict[str, Any]:
    cell = ready.scenario.cell
    x = cell.positions(recording.q_command)
    margin = np.minimum(x - cell.limits.lower, cell.limits.upper - x).min(axis=0)
    sliding = np.array(slides(cell))
    speed = (np.abs(recording.velocity) / cell.limits.velocity).max(initial=0.0)
    changes = np.diff(recording.velocity[:, ~sliding], axis=0)
    entry = recording.metadata.get("clearance")
    largest = {name: float(getattr(readings, name).max()) for name in
               ("eps_p_mm", "eps_o_deg", "chain_mm", "chain_deg", "object_mm", "object_deg")}  # fmt: skip
    return {
        **largest,
        "time_s": float(recording.time[-1]),
        "steps": recording.n_steps,
        "rate_min": float(recording.rate.min(initial=1.0)),
        "object_end_mm": float(readings.object_mm[-1]),
        "sigma_min": float(readings.sigma_min.min()),
        "margin_deg": float(np.rad2deg(margin[~sliding].min(initial=np.inf))),
        "margin_mm": float(1e3 * margin[sliding].min(initial=np.inf)),
        "speed_share": float(speed),
        "unrest_deg_per_s": float(np.rad2deg(np.sqrt(np.mean(changes**2)))) if changes.size else 0.0,
        "closest_mm": 1e3 * float((entry or {}).get("closest_m", float("nan"))),
    }


def _truth(ready: CellRun, disturbed: Disturbances | None, q: Array) -> dict[str, float]:
    """Largest errors of the chain where the disturbed arms really are (n, nq); NaN where the plant does not say it."""
    if len(q) < 2 or disturbed is None:
        return {"true_chain_mm": float("nan"), "true_chain_deg": float("nan")}
    cell = ready.scenario.cell
    tools = metrics.tool_matrices(cell, q)
    for k, arm in enumerate(cell.arms):
        if arm.name in disturbed.base_offset:
            base = arm.T_world_base
            tools[:, k] = (base * disturbed.base_offset[arm.name] * base.inverse()).homogeneous @ tools[:, k]
    held = Grasp(tuple(np.linalg.inv(tools[0, 0]) @ T for T in tools[0]))
    distance, angle = metrics.chain_errors(tools, held)
    return {"true_chain_mm": 1e3 * float(distance.max()), "true_chain_deg": float(np.rad2deg(angle.max()))}
