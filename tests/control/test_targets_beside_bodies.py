"""Targets beside bodies and with further rows: the core decides as the definition does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coopqp import Clearance, CollisionScene, QPController, Rank
from coopqp.native import available_kernels
from coopqp.scenarios import elbow_and_knob, plate_and_post
from coopqp.spatial import Array


class Slower:
    """No joint faster than 0.3 rad/s."""

    name, rank = "slow joints", Rank.LIMITS

    def rows(self, state: Any, dt: float) -> Any:
        n = state.cell.nv
        return np.eye(n), np.full(n, -0.3), np.full(n, 0.3)


def _commands(make: Any, seed: int, *, rows: bool) -> tuple[Array, list[bool]]:
    """Commanded configurations of a run by hand beside a body, and whether a command waits."""
    task, rng = make(), np.random.default_rng(seed)
    cell = task.cell.with_limits(acceleration=5.0)
    constraints = [Slower()] if rows else [Clearance(CollisionScene.of(task, cell=cell, margin=0.02))]
    controller = QPController(cell, task.grasp, task.path, dt=0.008, constraints=constraints)
    controller.reset(task.q_start)
    q, waits = [], []
    for i in range(200):
        if i % 40 == 0:
            twist = rng.normal(size=6) * np.repeat([0.2, 0.3], 3)
        if i % 5 == 0:
            controller.jog(twist, frame="world")
            waits.append(controller._operator.wanted is not None)
        q.append(controller.step().q_next)
    return np.array(q), waits


@pytest.mark.skipif("compiled" not in available_kernels(), reason="it compares kernels")
@pytest.mark.parametrize(("make", "rows"), [(plate_and_post, False), (elbow_and_knob, False), (elbow_and_knob, True)])
def test_the_core_takes_the_ways_that_the_definition_takes(
    make: Any, rows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    from coopqp.control.core.compiled import CompiledLoop  # needs the core

    taken: list[bool | None] = []
    own = CompiledLoop.retarget_motion

    def counted(loop: Any, *arguments: Any) -> bool | None:
        taken.append(own(loop, *arguments))
        return taken[-1]

    monkeypatch.setattr(CompiledLoop, "retarget_motion", counted)
    q, waits = _commands(make, 1, rows=rows)
    assert None not in taken  # the core has decided
    assert True in taken
    monkeypatch.setattr(CompiledLoop, "retarget_motion", lambda *_: None)
    by_definition, waited = _commands(make, 1, rows=rows)
    assert waits == waited
    np.testing.assert_allclose(q, by_definition, atol=1e-8)
