"""The step of arms that share joints: the same command as the full QP, and runs that keep the chain and the plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from torsos import held, lift_cell, robot_of

from coopqp import (
    Grasp,
    HoldPath,
    LinePath,
    QPController,
    RobotCell,
    ServoPath,
    Status,
    check_path,
    simulate,
)  # fmt: skip
from coopqp.control import RankWeights
from coopqp.control.step.braking_rows import BrakingRows
from coopqp.control.step.formulations import StepProgram, StepTerms
from coopqp.errors import InvalidInputError
from coopqp.model import CellState, Chain
from coopqp.solvers import make_solver
from coopqp.spatial import Array

TORSOS = (
    (("prismatic", "0 0 1"),),
    (("revolute", "0 0 1"),),
    (("prismatic", "0 0 1"), ("continuous", "0 0 1")),
)


class Box:
    """Bounds of all joints, as the program reads them."""

    def __init__(self, lower: Array, upper: Array) -> None:
        self.lower, self.upper = lower, upper
        self.outside, self.recovery = np.zeros(len(lower), dtype=bool), np.zeros(len(lower))
        self.any_outside = False


@pytest.mark.parametrize("torso", slow_but_first(TORSOS))
def test_the_command_is_that_of_the_full_qp(torso: tuple[tuple[str, str], ...], tmp_path: Path) -> None:
    """400 random QPs: base and null motions of the group, against the chain as equalities of all joints."""
    rng = np.random.default_rng(7)
    cell = RobotCell([robot_of(torso, tmp_path, velocity_limits={"torso_0": 0.3})])
    grasp = Grasp(tuple(pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3)) for _ in range(2)))
    chain, differences = Chain(cell, grasp), []
    program, solver = StepProgram(chain, RankWeights()), make_solver("daqp")
    while len(differences) < 400:
        q = cell.configuration(rng.uniform(-1.5, 1.5, cell.nv))
        chain.linearise(q, 0.4 * rng.normal(size=3))
        if min(np.linalg.svd(chain.part_jacobian(0), compute_uv=False)) < 0.05:
            continue
        along, path, grasps, offsets = (0.1 * rng.normal(size=shape) for shape in (6, 6, (2, 6), (2, 6)))
        null = [chain.null_part(0.1 * rng.normal(size=cell.nv)) for _ in range(2)]
        terms = StepTerms(
            pin.exp3(rng.normal(size=3)), along, 0.1 * path, 0.1 * grasps, 0.01 * offsets, 1.0, null[0], null[1]
        )
        pieces = program.pieces(terms)
        v = pieces.command(0.6) + chain.null_basis() @ (0.02 * rng.normal(size=chain.redundancy))
        size = 0.3 * np.abs(v) + 0.02
        box: Any = Box(v - size * rng.uniform(0.0, 1.0, cell.nv), v + size * rng.uniform(0.0, 1.0, cell.nv))
        problem, base, B = program.condensed(terms, pieces, box)
        own = solver.solve(problem)
        full = solver.solve(program.full(terms, box))
        if not (own.usable and full.usable):
            continue
        a, b = program.read_condensed(own.x, terms, base, B), program.read_full(full.x, terms)
        differences.append(np.abs(a.velocity - b.velocity).max())
        common = a.off_path + a.rate * along + a.path_share * terms.path_correction + terms.offsets
        wanted = common + a.grasp_share * terms.grasp_corrections
        np.testing.assert_allclose(chain.twists(a.velocity) @ terms.to_world, wanted, rtol=0, atol=1e-11)
    assert np.median(differences) < 1e-11
    assert max(differences) < 1e-7


def test_the_edge_of_a_group_has_its_gradient() -> None:
    cell, grasp = lift_cell()
    T = pin.SE3(np.eye(3), np.array([0.62, 0.05, 1.2]))
    q = held(cell, grasp, T, np.array([0.2]))
    rows = BrakingRows(Chain(cell, grasp), np.full(cell.nv, 5.0))

    def edge(q: Array) -> float:
        rows._chain.evaluate(q, T.translation)
        return float(rows._singular_edges(q, T.translation)[0][0])

    rows._chain.evaluate(q, T.translation)
    _, away = rows._singular_edges(q, T.translation)
    h = 1e-6
    slopes = [(edge(cell.moved(q, h * e)) - edge(cell.moved(q, -h * e))) / (2.0 * h) for e in np.eye(cell.nv)]
    np.testing.assert_allclose(away[0], slopes, rtol=0, atol=1e-6)


def rise(low: float, high: float, duration: float) -> LinePath:
    """A bar goes straight up [m]."""
    ends = [pin.SE3(np.eye(3), np.array([0.55, 0.0, z])) for z in (low, high)]
    return LinePath(ends[0], ends[1], duration=duration)


def test_a_run_follows_the_lift_that_the_check_proves() -> None:
    """Look-ahead on, 5 rad/s²: the chain holds, the path is kept, and the lift is where the check has it."""
    cell, grasp = lift_cell()
    path = rise(0.2, 1.7, 8.0)
    check = check_path(cell, grasp, path)
    assert check.verdict.value == "CERTIFIED"
    (way,) = check.shared
    assert not way.stands
    run = simulate(QPController(cell, grasp, check.led_path(), dt=0.02), q_start=check.q_start, duration=12.0)
    assert run.finished
    assert np.mean(run.status == Status.TRACKING.code) > 0.9
    errors = [np.abs(grasp.relative_errors(CellState(cell, q))[:, :3]).max() for q in run.q_command]
    assert max(errors) < 1e-7
    proved = check.proved_trajectory()
    assert proved is not None
    x = proved.positions(proved.places)[0]
    s = np.interp(run.clock, proved.clocks(proved.places), x[:, 0])
    assert np.abs(cell.positions(run.q_command)[:, 0] - s).max() < 0.02  # the run smooths it


def test_a_slow_lift_slows_the_object_and_keeps_the_chain() -> None:
    cell, grasp = lift_cell(velocity_limits={"lift": 0.02})
    check = check_path(cell, grasp, rise(0.2, 1.65, 4.0))
    assert check.feasible
    run = simulate(QPController(cell, grasp, check.led_path(), dt=0.02), q_start=check.q_start, duration=30.0)
    assert run.finished
    assert np.abs(np.diff(cell.positions(run.q_command)[:, 0])).max() <= 0.02 * 0.02 * (1.0 + 1e-9)
    errors = [np.abs(grasp.relative_errors(CellState(cell, q))[:, :3]).max() for q in run.q_command]
    assert max(errors) < 1e-6


def test_paths_not_known_ahead_and_operators_calls() -> None:
    """A servo target out of the lift's way, a pause, a new path: finite commands inside limits, the chain closed."""
    cell, grasp = lift_cell()
    start = pin.SE3(np.eye(3), np.array([0.55, 0.0, 0.9]))
    q = held(cell, grasp, start, np.array([0.3]))
    servo = ServoPath(start)
    controller = QPController(cell, grasp, servo, dt=0.01)
    controller.reset(q)
    controller.retarget(pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.3])), np.array([0.6, 0.1, 1.5])))
    worst, last = 0.0, q
    for number in range(300):
        if number == 100:
            controller.pause()
        if number == 150:
            controller.resume()
        if number == 250:
            controller.follow(HoldPath(grasp.carried(CellState(cell, last))[0]))
        step = controller.step()
        last = step.q_next
        assert (np.abs(step.velocity) <= cell.limits.velocity * (1.0 + 1e-9)).all()
        worst = max(worst, float(np.abs(grasp.relative_errors(CellState(cell, step.q_next))[:, :3]).max()))
    assert worst < 1e-5


def test_what_does_not_know_shared_joints_refuses_them() -> None:
    from coopqp.baselines import IndependentQPController, PseudoInverseController

    cell, grasp = lift_cell()
    path = rise(0.8, 0.9, 1.0)
    for make in (
        lambda: IndependentQPController(cell, grasp, path, dt=0.01),
        lambda: PseudoInverseController(cell, grasp, path, dt=0.01),
    ):
        with pytest.raises(InvalidInputError, match=r"share 'lift'.*Lock them"):
            make()
