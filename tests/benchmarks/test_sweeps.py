"""The benchmark of sweeps: its records are complete, whatever the machine, and its reference finds the same figures."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sweeps
from figures_0_1 import figures_0_1

from coopqp import simulate
from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import Scenario, mixed_lift, paper_lift
from coopqp.simulation import Disturbances, DisturbedPlant, read_run


@pytest.mark.parametrize("lift", [paper_lift, mixed_lift])
def test_figures_are_those_of_version_0_1(lift: Callable[..., Scenario]) -> None:
    """Arms that part and sensors that lie, by a form that shares no code."""
    task = lift()
    controller = PseudoInverseController(task.cell, task.grasp, task.path, dt=20.0 * task.dt)
    plant = DisturbedPlant(task.cell, task.grasp, Disturbances(encoder_noise=1e-3, seed=3))
    run = simulate(controller, plant, q_start=task.q_start)
    found = read_run(task.cell, run)
    for name, expected in figures_0_1(task.cell, run).items():
        np.testing.assert_allclose(getattr(found, name), expected, rtol=0, atol=1e-10, err_msg=name)
        assert expected.max() > 1e-3


@pytest.mark.slow
def test_every_case_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = sweeps.Plan(loky=(20, 60), dask=(4, 10), scaling=(2, 6), rounds=1)
    monkeypatch.setattr(sweeps, "QUICK", small)
    monkeypatch.setattr(sweeps, "clustered", lambda *_: [])  # test_studies starts a cluster
    file = tmp_path / "sweeps.json"
    assert sweeps.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    records = json.loads(file.read_text(encoding="utf-8"))
    assert [tuple(r) for r in records] == [sweeps.KEYS] * 3
    assert all(math.isfinite(r["ratio"]) for r in records)  # so few rows cost less than a tick of the system's clock
    assert (tmp_path / "out" / "sweeps.md").is_file()
