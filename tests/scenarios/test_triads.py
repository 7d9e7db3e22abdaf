"""The paper's lift by other triads: it ends, the chain stays closed, and the baseline drifts as the paper's does."""

from __future__ import annotations

import numpy as np
import pytest
from marks import slow_but_first

from coopqp import QPController, simulate
from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import abb_lift, kuka_lift, mixed_lift, paper_lift
from coopqp.simulation import evaluate, read_run
from coopqp.studies import Placer

#: Baseline's ε_p at N = 400 [mm], least σ_min, and least joint margin [deg]; see docs/howto/bases.md.
TRIADS = {
    "paper_lift": (paper_lift, 0.871, 0.169, 56.4),
    "kuka_lift": (kuka_lift, 0.844, 0.210, 65.5),
    "abb_lift": (abb_lift, 0.988, 0.175, 54.3),
    "mixed_lift": (mixed_lift, 0.968, 0.175, 55.0),
}


@pytest.mark.parametrize("name", slow_but_first(TRIADS))
def test_the_lift_ends_and_the_baseline_drifts_as_with_the_papers_arms(name: str) -> None:
    make, drift, *_ = TRIADS[name]
    lift = make()
    finest = {}
    for kind in (PseudoInverseController, QPController):
        run = simulate(kind(lift.cell, lift.grasp, lift.path, dt=lift.dt), q_start=lift.q_start)
        readings = read_run(lift.cell, run)
        assert run.finished
        finest[kind] = readings
        if kind is QPController:
            assert all(finding.holds for finding in evaluate(lift.cell, run, readings))
    assert finest[PseudoInverseController].eps_p_mm.max() == pytest.approx(drift, abs=1e-3)
    assert finest[QPController].chain_mm.max() < 1e-3  # 1 µm; 1.6e-6 mm were measured
    # The drift is of first order: half the steps, twice the drift.
    coarse = PseudoInverseController(lift.cell, lift.grasp, lift.path, dt=2.0 * lift.dt)
    twice = read_run(lift.cell, simulate(coarse, q_start=lift.q_start)).eps_p_mm.max()
    assert twice == pytest.approx(2.0 * drift, rel=0.02)


@pytest.mark.parametrize("name", TRIADS)
def test_bases_stand_where_arms_are_well_conditioned_and_nothing_touches(name: str) -> None:
    make, _, sigma, margin = TRIADS[name]
    lift = make()
    found = Placer.of(lift).cell_at([arm.T_world_base for arm in lift.cell.arms])
    assert found.feasible
    assert min(arm.sigma_min for arm in found.arms) == pytest.approx(sigma, abs=1e-3)
    assert np.rad2deg(min(arm.margin for arm in found.arms)) == pytest.approx(margin, abs=0.1)
    np.testing.assert_allclose(np.concatenate([arm.q for arm in found.arms]), lift.q_start, atol=1e-6)
