"""Targets beside bodies and with further rows: the core decides as an attempt in Python does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from coopqp import Clearance, CollisionScene, Knot, QPController, Rank
from coopqp.model import CellState
from coopqp.scenarios import elbow_and_knob, plate_and_post
from coopqp.spatial import Array


class Slower:
    """No joint faster than 0.3 rad/s."""

    name, rank = "slow joints", Rank.LIMITS

    def rows(self, state: Any, dt: float) -> Any:
        n = state.cell.nv
        return np.eye(n), np.full(n, -0.3), np.full(n, 0.3)


def _commands(make: Any, seed: int, *, rows: bool = False, **bound: Any) -> tuple[Array, list[bool]]:
    """Commanded configurations of a run by hand beside a body, and whether commands wait; ``bound`` to the core."""
    task, rng = make(), np.random.default_rng(seed)
    cell = task.cell.with_limits(acceleration=5.0)
    constraints = [Slower()] if rows else [Clearance(CollisionScene.of(task, cell=cell, margin=0.02))]
    controller = QPController(cell, task.grasp, task.path, dt=0.008, constraints=constraints)
    controller._loop._core.bind(**bound)
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


@pytest.mark.parametrize("make", [plate_and_post, elbow_and_knob])
def test_the_same_ways_are_taken_where_the_rows_of_bodies_come_from_python(make: Any) -> None:
    def fails(*_: Any) -> int:
        raise RuntimeError("nothing is known")

    q, waits = _commands(make, 1)
    asked, waited = _commands(make, 1, clear=fails, further_rows=fails, tightened=fails)
    assert waits == waited
    assert any(waits)
    assert not all(waits)
    np.testing.assert_allclose(q, asked, atol=1e-8)


def test_beside_rows_of_the_users_own_the_object_goes_over_in_motion() -> None:
    q, waits = _commands(elbow_and_knob, 1, rows=True)
    assert not all(waits)
    assert np.abs(np.diff(q[20:], axis=0)).max(axis=1).min() > 0.0


def _by_hand(
    make: Any, seed: int, watch: Callable[[QPController, Clearance], None], *, steps: int = 160
) -> tuple[QPController, Clearance]:
    """A run by a hand that trembles, beside a body, from where ``watch`` is called on."""
    task, rng = make(), np.random.default_rng(seed)
    cell = task.cell.with_limits(acceleration=5.0)
    clearance = Clearance(CollisionScene.of(task, cell=cell, margin=0.02))
    controller = QPController(cell, task.grasp, task.path, dt=0.004, constraints=[clearance])
    controller.reset(task.q_start)
    watch(controller, clearance)
    twist = rng.normal(size=6) * np.repeat([0.2, 0.3], 3)
    for i in range(steps):
        if i % 8 == 0:
            controller.jog(twist + 1e-3 * rng.normal(size=6), frame="world")
        controller.step()
    return controller, clearance


@pytest.mark.parametrize(("make", "seed", "stops"), [(plate_and_post, 4, True), (elbow_and_knob, 5, False)])
def test_the_core_stops_the_object_at_the_knots_where_the_definition_does(make: Any, seed: int, stops: bool) -> None:
    said: list[tuple[bool, bool]] = []

    def watch(controller: QPController, clearance: Clearance) -> None:
        definition, core, loop = Clearance(clearance.scene), clearance._native[1].stopping, controller._loop
        definition.check(controller.commanded)
        nv = loop.cell.nv

        def both(slot: int, span: float) -> int:
            found, numbers = core(slot, span), loop._core.node(slot)
            x, slope, curvature = (
                loop.at[f"node_{name}"][nv * slot : nv * slot + nv].copy()
                for name in ("positions", "slope", "curvature")
            )
            state = CellState(loop.cell, loop.cell.configuration(x))
            label = definition.stopping_pair(Knot(numbers.clock, state, slope, curvature, numbers.span))
            said.append((found >= 0, label >= 0))
            assert found != -1
            return found

        loop._core.bind(stopping=both)

    _by_hand(make, seed, watch)
    core, definition = np.array(said).T
    np.testing.assert_array_equal(core, definition)
    assert core.any() == stops
    assert not core.all()


@pytest.mark.core
def test_by_hand_the_core_asks_for_the_rows_of_bodies_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    own = Clearance.rows_by_label

    def counted(clearance: Clearance, *arguments: Any, **more: Any) -> Any:
        asked.append(arguments)
        return own(clearance, *arguments, **more)

    monkeypatch.setattr(Clearance, "rows_by_label", counted)
    clearance = _by_hand(plate_and_post, 4, lambda *_: asked.clear())[1]
    assert clearance.passes > 0  # rows were asked for
    assert not asked


@pytest.mark.core
def test_a_command_that_joints_forbid_looks_at_few_knots() -> None:
    knots: list[int] = []

    def watch(controller: QPController, clearance: Clearance) -> None:
        core, operator = clearance._native[1].stopping, controller._operator
        attempt, asked = operator.attempt, [0]

        def counted(slot: int, span: float) -> int:
            asked[0] += 1
            return core(slot, span)

        def attempts() -> None:
            asked[0] = 0
            attempt()
            if operator.wanted is not None:
                knots.append(asked[0])

        controller._loop._core.bind(stopping=counted)
        operator.attempt = attempts  # type: ignore[method-assign]

    _by_hand(plate_and_post, 2, watch, steps=400)
    assert len(knots) > 10
    assert np.median(knots) <= 8  # 6; the horizon would take some thirty for each of two tries
