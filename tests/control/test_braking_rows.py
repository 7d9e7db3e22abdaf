"""Rows that brake all arms together, where no look-ahead covers the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from promise_cases.braking import ACCELERATIONS, beside_cart, blind, line
from user_paths import Opaque

from coopqp import LimitKind, LinePath, PreviewOptions, QPController, QPOptions, Status
from coopqp.constraints.velocity import Rows
from coopqp.control.lookahead.options import PlanLimits
from coopqp.control.step.braking_rows import BrakingRows, bend, least_singular_value
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.native import available_kernels
from coopqp.scenarios import Scenario, dual_arm7, five_joint_pair, mixed_cell, paper_lift, ring
from coopqp.spatial import Array

H = 0.002
CELLS = [partial(ring, arms=2), dual_arm7, mixed_cell, five_joint_pair]


def tool_twist(task: Scenario, q: Array, k: int, columns: Array, v: Array, at: Array) -> Array:
    """Twist of arm k's tool at a point of it, given in the tool's frame, by Pinocchio (6,)."""
    state = CellState(task.cell, q)
    T = state.T_world_tool[k]
    to_point = pin.SE3(T.rotation, T.act(at))
    local = T.actInv(to_point).toActionMatrixInverse() @ state.jacobian(k) @ v[task.cell.v_slices[k]]
    return np.concatenate([T.rotation @ local[:3], T.rotation @ local[3:]])


@pytest.mark.parametrize("make", CELLS)
def test_the_gradient_of_a_singularity_and_the_bend_are_their_differences(
    make: Callable[[], Scenario], rng: np.random.Generator
) -> None:
    task = make()
    cell, chain, eps = task.cell, Chain(task.cell, task.grasp), 1e-6
    for _ in range(3):
        q, v = cell.configuration(rng.uniform(-1.5, 1.5, cell.nv)), rng.normal(size=cell.nv)
        state = CellState(cell, q)
        for k, columns in enumerate(chain.moving_columns):
            T = state.T_world_tool[k]
            chain.evaluate(q, T.translation)
            sigma, gradient = least_singular_value(chain.jacobians[k])
            assert sigma == pytest.approx(state.sigma_min[k], abs=1e-12)
            around = [
                [CellState(cell, cell.moved(q, sign * eps * np.eye(cell.nv)[j])).sigma_min[k] for sign in (1.0, -1.0)]
                for j in columns
            ]
            np.testing.assert_allclose(gradient, np.subtract(*np.transpose(around)) / (2.0 * eps), atol=2e-8)
            at = rng.normal(size=3)
            chain.evaluate(q, T.act(at))
            after, before = (tool_twist(task, cell.moved(q, sign * eps * v), k, columns, v, at) for sign in (1.0, -1.0))
            np.testing.assert_allclose(bend(chain.jacobians[k], v[columns]), (after - before) / (2.0 * eps), atol=2e-7)


def braking(task: Scenario) -> BrakingRows:
    plan = PlanLimits.of(task.cell, PreviewOptions(), dt=H)
    return BrakingRows(Chain(task.cell, task.grasp), plan.acceleration)


def rows_at(task: Scenario, q: Array, v: Array) -> Rows:
    return braking(task).rows(q, v, H, task.path.pose(0.0).translation)


@pytest.mark.parametrize("acceleration", [3.0, np.inf])
@pytest.mark.parametrize("make", CELLS)
def test_joints_that_rest_or_brake_together_keep_all_rows(
    make: Callable[[], Scenario], acceleration: float, rng: np.random.Generator
) -> None:
    task = make()
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    cell, bound = task.cell, 0
    hardest = PlanLimits.of(cell, PreviewOptions(), dt=H).acceleration
    for _ in range(20):
        lower, upper = np.maximum(cell.limits.lower, -1.5), np.minimum(cell.limits.upper, 1.5)
        q, v = cell.configuration(rng.uniform(lower, upper)), rng.normal(size=cell.nv) * rng.uniform(0.01, 2.0)
        rows = rows_at(task, q, v)
        keep = 1.0 - H / max(float((np.abs(v) / hardest).max()), H)
        for share in (0.0, keep):
            v_next = share * v
            assert (rows.G @ v_next <= rows.upper + 1e-12).all()
            assert (rows.G @ v_next >= rows.lower - 1e-12).all()
        bound += len(rows)
    assert bound > 20


def test_an_arm_near_its_singularity_and_a_joint_near_its_limit_are_named() -> None:
    task = ring(arms=2)
    cell, rows = task.cell, braking(task)
    x = cell.positions(task.q_start)
    x[4], x[6] = 1e-3, cell.limits.upper[6] - 1e-3  # a wrist that is stretched, and a joint of the other arm
    v = np.full(cell.nv, 0.1)
    found = rows.rows(cell.configuration(x), v, H, task.path.pose(0.0).translation)
    named = [rows.labels[-1 - owner] for owner in found.owner]
    assert (cell.arm_names[0], LimitKind.SINGULARITY) in [(limit.arm, limit.kind) for limit in named]
    joint = found.owner.tolist().index(-1 - len(cell) - 6)
    assert f"{named[joint].arm}/{named[joint].joint}" == cell.joint_names[6]
    assert named[joint].kind is LimitKind.POSITION
    # This close no speed is left but that of joints that brake together.
    v_max = float(cell.limits.velocity[6])
    assert found.upper[joint] < 0.1 < v_max
    assert found.lower[joint] < -0.1


def out_of_reach(number: int, acceleration: float) -> Scenario:
    """A line that ends where not all arms reach, known only while it is followed."""
    rng = np.random.default_rng(700 + number)
    task = [partial(ring, arms=2), dual_arm7, mixed_cell][number % 3]()
    way = rng.normal(size=3)
    path = LinePath.displaced(
        task.path.pose(0.0), translation=1.2 * way / np.linalg.norm(way), duration=2.4, time_law="quintic"
    )
    cell = task.cell.with_limits(acceleration=acceleration)
    return replace(task, cell=cell, path=Opaque(path, known_ahead=False))


def apart(task: Scenario, q: Array) -> float:
    """Largest distance between the object's origins as the arms carry it [m], by Pinocchio."""
    state = CellState(task.cell, q)
    tools = zip(state.T_world_tool, task.grasp.T_object_tool, strict=True)
    origins = np.array([(T * X.inverse()).translation for T, X in tools])
    return float(np.linalg.norm(origins - origins[0], axis=1).max())


@pytest.mark.parametrize("kernel", slow_but_first(available_kernels()))
@pytest.mark.parametrize(("number", "acceleration"), [(0, np.inf), (1, 5.0)])
def test_a_path_that_is_not_known_ahead_runs_out_of_reach_and_the_arms_stay_together(
    kernel: str, number: int, acceleration: float
) -> None:
    task, dt = out_of_reach(number, acceleration), 0.008
    controller = QPController(task.cell, task.grasp, task.path, dt=dt, options=QPOptions(kernel=kernel))
    controller.reset(task.q_start)
    steps = [controller.step() for _ in range(300)]
    assert steps[-1].status in (Status.BLOCKED, Status.SLOWED)
    assert not any(step.status is Status.HOLDING for step in steps)
    assert max(apart(task, step.q_next) for step in steps) < 2e-5
    changes = sum(a.status is not b.status for a, b in pairwise(steps))
    assert changes <= 2.0 * len(steps) * dt
    assert {limit.kind for step in steps[-20:] for limit in step.binding} & {LimitKind.SINGULARITY, LimitKind.POSITION}


@pytest.mark.parametrize("number", slow_but_first([6, 9, 29]))
def test_rows_take_no_time_where_the_bend_leaves_enough_of_the_accelerations(number: int) -> None:
    task, dt = line(number, ACCELERATIONS[number % 3], 0.15), 0.008
    run, before = (blind(task, dt, kernel="plain", rows=rows) for rows in (True, False))
    assert run.finished
    assert before.finished
    assert run.time <= 1.03 * before.time
    assert run.chain < 1e-6


@pytest.mark.parametrize("kernel", available_kernels())
def test_where_the_path_is_known_ahead_there_are_no_rows(kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the arms are off it."""

    def never(*_: object) -> Rows:
        raise AssertionError("a known path asked for them")

    monkeypatch.setattr(BrakingRows, "rows", never)
    task = paper_lift()
    task = replace(task, cell=task.cell.with_limits(acceleration=3.0))
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=QPOptions(kernel=kernel))
    controller.reset(task.q_start)
    for i in range(200):
        late = None if i < 20 else task.cell.moved(controller.commanded, np.full(task.cell.nv, 2e-4))
        step = controller.step(late)
        for limit in step.binding:
            assert limit.kind is not LimitKind.SINGULARITY
    assert step.clock_next > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("number", [67, 146])
def test_arms_that_could_stay_clear_of_a_cart_are_not_slowed_by_their_bend_until_it_touches(number: int) -> None:
    """Without any rows they stay 20 mm away, and together."""
    run = beside_cart(number, 15.0)
    assert run.least > 0.01
    assert run.chain < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(("number", "acceleration"), [(79, 15.0), (83, 15.0), (133, 5.0)])
def test_arms_stay_together_where_a_cart_pushes_on_after_it_has_touched(number: int, acceleration: float) -> None:
    run = beside_cart(number, acceleration)
    assert run.least < 0.0
    assert run.chain < 1e-5
