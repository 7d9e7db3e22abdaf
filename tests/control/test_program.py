"""The QP of a step: the condensed form, the full form and the ray agree; the form with slack."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from coopqp import InvalidInputError, QPController, QPOptions
from coopqp.control import RankWeights
from coopqp.scenarios import (
    paper_lift,
)
from coopqp.solvers import QpSolver, SolverSettings

# -- condensed against full --------------------------------------------------------------------------------------------


# -- the ray -----------------------------------------------------------------------------------------------------------


# -- the form whose chain may part -------------------------------------------------------------------------------------


# -- arms with few joints, weights -------------------------------------------------------------------------------------


class Raising(QpSolver):
    """Raises, whatever it is asked."""

    name = "raising"
    settings = SolverSettings()

    def solve(self, problem: Any) -> Any:
        raise RuntimeError("no licence")

    def _solve(self, problem: Any, work: Any) -> Any:
        raise NotImplementedError

    def _forget(self) -> None:
        pass


def test_what_a_solver_raises_is_reported() -> None:
    task = paper_lift()
    options = QPOptions(solver=Raising(), shortcut=False)
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01, options=options)
    controller.reset(task.q_start)
    step = controller.step()
    report = step.solver
    assert (report.name, report.status, report.iterations, report.time_s) == ("raising", "failed", 0, 0.0)
    assert "no licence" in report.message
    assert "no licence" in step.reason
    assert np.abs(step.velocity).max() < 1e-9  # the arms stay at rest, but for the rounding of the grasp


def test_ratios_of_at_least_100_keep_the_ranks_apart() -> None:
    w = RankWeights()
    for upper, lower in itertools.pairwise((w.chain, w.recovery, w.off_path, w.grasp, w.path, w.rate, w.posture)):
        assert upper >= 99.9 * lower
    assert w.clearance == w.recovery
    assert w.posture >= 1e-14 * w.chain  # solvers manage no more
    assert 0.1 <= w.length <= 1.0


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(RankWeights)])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "much"])
def test_weights_must_be_positive(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"RankWeights: {name}"):
        RankWeights(**{name: value})
