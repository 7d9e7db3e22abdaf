"""The fused step: the NumPy kernel, the compiled kernel and the unfused step give the same controller."""

from __future__ import annotations

import dataclasses
import functools
import shutil
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from coopqp.control.core.reference import bound

from coopqp import (
    Array,
    CellState,
    Grasp,
    JointLimits,
    LinePath,
    ObjectPath,
    QPController,
    QPOptions,
    RankWeights,
    RobotCell,
    ServoPath,
    UnknownNameError,
    WaypointPath,
    available_kernels,
)
from coopqp.control import core as kernels
from coopqp.control.core import BorderArrays, Outcome, StepKernel, Workspace, make_border, make_kernel
from coopqp.control.forms import StepProgram, StepTerms
from coopqp.control.limits import LIMIT_TOLERANCE, VelocityBox
from coopqp.model.chain import Chain
from coopqp.scenarios import Scenario, at_limit, dual_arm7, mixed_cell, paper_lift, ring

pytestmark = pytest.mark.core

#: Largest difference of a joint velocity in closed loop [rad/s or m/s].
SAME = 1e-10
#: The kernels, and the compiled kernel with its arithmetic for processors without AVX2.
KERNELS = (*available_kernels(), *(["plain"] if "compiled" in available_kernels() else []))


@pytest.fixture(autouse=True)
def _plain_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    if "plain" not in KERNELS:
        return
    compiled = pytest.importorskip("coopqp.control.core.compiled")

    def plain(workspace: Workspace) -> StepKernel:
        made: StepKernel = compiled.CompiledKernel(workspace, plain=True)
        made.name = "plain"
        return made

    monkeypatch.setitem(kernels._KERNELS, "plain", plain)
    monkeypatch.setitem(kernels._BORDERS, "plain", functools.partial(compiled.CompiledBorder, plain=True))


def options_with(name: str, **options: Any) -> QPOptions:
    made = QPOptions(**options)
    object.__setattr__(made, "kernel", name)  # the options do not accept "plain"
    return made


def limited(**limits: Any) -> Callable[[], Scenario]:
    def make() -> Scenario:
        lift = paper_lift(time_law="quintic")
        return dataclasses.replace(lift, cell=lift.cell.with_limits(**limits))

    return make


def zigzag() -> Scenario:
    lift = paper_lift()
    middle = pin.SE3(lift.path.pose(1.0))
    middle.translation = middle.translation + np.array([0.02, 0.01, 0.0])
    poses = [lift.path.pose(0.0), middle, lift.path.pose(lift.path.duration)]
    return dataclasses.replace(lift, path=WaypointPath(poses, durations=[1.0, 1.5], time_law="linear"))


LIFTS: dict[str, tuple[Callable[[], Scenario], float]] = {
    "plain": (lambda: paper_lift(time_law="quintic"), 0.01),
    "jump at the ends": (lambda: paper_lift(time_law="linear"), 0.01),
    "zigzag": (zigzag, 0.01),
    "slowed by speed": (limited(velocity=0.05), 0.01),
    "slowed by acceleration": (limited(velocity=1.0, acceleration=0.1), 0.01),
    "acceleration": (limited(acceleration=5.0), 0.01),
    "at a limit": (at_limit, 0.01),
    "seven joints": (dual_arm7, 0.01),
    "mixed": (mixed_cell, 0.01),
    "ten arms": (lambda: ring(arms=10), 0.02),
}


def controllers(
    scenario: Scenario, dt: float, path: Callable[[], ObjectPath] | None = None, **options: Any
) -> list[QPController]:
    made = []
    for kernel in (*KERNELS, "none"):
        follow = scenario.path if path is None else path()
        made_of = options_with(kernel, **options)
        controller = QPController(scenario.cell, scenario.grasp, follow, dt=dt, options=made_of)
        controller.reset(scenario.q_start)
        assert controller.kernel == kernel
        made.append(controller)
    return made


def agree(loops: list[QPController], steps: int, inputs: Callable[[int, Array], dict[str, Any]] | None = None) -> float:
    """Run the loops side by side and compare their steps. Returns the lowest rate."""
    rng_state = [np.random.default_rng(5) for _ in loops]
    q = [c._q for c in loops]
    lowest = 1.0
    for i in range(steps):
        done = []
        for k, controller in enumerate(loops):
            given = {} if inputs is None else inputs(i, q[k] + 1e-5 * rng_state[k].standard_normal(len(q[k])))
            done.append(controller.step(**given))
            q[k] = done[k].q_next
        for other in done[1:]:
            np.testing.assert_allclose(other.velocity, done[0].velocity, rtol=0.0, atol=SAME, err_msg=f"step {i}")
            assert other.rate == pytest.approx(done[0].rate, abs=1e-8)
            assert other.status is done[0].status
        lowest = min(lowest, done[0].rate)
        if done[0].finished:
            break
    return lowest


@pytest.mark.parametrize("name", LIFTS)
def test_all_agree_in_closed_loop(name: str) -> None:
    make, dt = LIFTS[name]
    lowest = agree(controllers(make(), dt), 400)
    assert lowest < 0.9 or not name.startswith("slowed")


@pytest.mark.parametrize("robots", [("arm6c", "gantry7", "rx90l"), ("arm6c", "arm6c"), ("arm7", "arm7", "arm7")])
def test_all_agree_on_continuous_and_prismatic_joints(
    robots: tuple[str, ...], make_cell: Callable[..., RobotCell], random_q: Callable[..., Array]
) -> None:
    cell = make_cell(robots)
    q = random_q(cell, np.random.default_rng(3))
    tools = CellState(cell, q).T_world_tool
    path = LinePath.displaced(tools[0], translation=(0.01, -0.02, 0.015), rotation=(0.03, 0.02, -0.05), duration=2.0)
    scenario = Scenario("mixed", cell, Grasp(tuple(tools[0].actInv(X) for X in tools)), path, q, 0.01)
    assert cell.continuous.any() == ("arm6c" in robots)
    agree(controllers(scenario, 0.01), 200)


def test_all_agree_with_measurements_fed_back(paper: Scenario) -> None:
    agree(controllers(paper, 0.004), 200, lambda i, q: {"q_measured": q})


def test_all_agree_with_bad_input_in_between(paper: Scenario) -> None:
    def inputs(i: int, q: Array) -> dict[str, Any]:
        bad: Any = {20: np.full(18, np.nan), 21: "nonsense", 22: np.zeros(3), 60: q + 1.0}.get(i, q)
        return {"q_measured": bad if i > 10 else None, "dt": {40: np.nan, 41: -1.0, 42: 0.006}.get(i)}

    assert agree(controllers(paper, 0.004), 120, inputs) == 0.0


def test_all_agree_on_a_moving_target(paper: Scenario) -> None:
    """A path that is not known ahead and not a straight line."""
    start = paper.path.pose(0.0)
    loops = controllers(paper, 0.005, lambda: ServoPath(start))
    for i in range(4):
        target = pin.SE3(start.rotation, start.translation + 0.01 * np.sin([i, 2.0 * i, 3.0 * i]))
        for controller in loops:
            controller.retarget(target)
        agree(loops, 25)


@pytest.mark.parametrize(
    "options",
    [{"correction_speed": 1e-7, "correction_spin": 1e-7}, {"preview": None}, {"grasp_gain": 500.0, "path_gain": 0.0}],
    ids=["bounded corrections", "no preview", "gains"],
)
def test_all_agree_with_other_options(options: dict[str, Any], paper: Scenario) -> None:
    q = paper.q_start + 1e-4 * np.random.default_rng(4).standard_normal(18)
    agree(controllers(dataclasses.replace(paper, q_start=q), 0.005, **options), 150)


@pytest.mark.parametrize("name", LIFTS)
def test_the_kernels_qp_is_that_of_the_program(name: str) -> None:
    """Every step has a QP, built by the kernel and by the unfused step."""
    make, dt = LIFTS[name]
    task = make()
    loops = []
    for kernel in (*KERNELS, "none"):
        options = options_with(kernel, shortcut=False)
        controller = QPController(task.cell, task.grasp, task.path, dt=dt, options=options)
        controller.reset(task.q_start)
        assert controller.kernel == kernel
        loops.append(controller)
    agree(loops, 100)


@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell])
@pytest.mark.parametrize("acceleration", [np.inf, 20.0])
def test_all_agree_while_joints_are_led_back(make: Callable[[], Scenario], acceleration: float) -> None:
    """Three joints are outside their limits, in both directions: the size of the QP changes during the run."""
    task = make()
    # The cost of null-space motion is 1e-12 of the cost of recovery: rounding changes it a thousand times more.
    same = SAME if task.cell.nv == 6 * len(task.cell) else 1e-8
    limits = task.cell.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    q = task.cell.positions(task.q_start)
    lower[1], upper[4], upper[8] = q[1] + 2e-3, q[4] - 1e-3, q[8] - 5e-3
    speed = np.minimum(limits.velocity, 1.0)
    cell = task.cell.with_limits(lower=lower, upper=upper, velocity=speed, acceleration=acceleration)
    loops = controllers(dataclasses.replace(task, cell=cell), 0.005)
    solved = {0: 0, 1: 0, 2: 0, 3: 0}
    for _ in range(60):
        x = cell.positions(loops[0]._q)
        outside = int(((x < lower) | (x > upper)).sum())
        done = [loop.step() for loop in loops]
        for other in done[1:]:
            np.testing.assert_allclose(other.velocity, done[0].velocity, rtol=0.0, atol=same)
            assert other.status is done[0].status
            assert other.binding == done[0].binding
            np.testing.assert_allclose(other.given_up.off_path, done[0].given_up.off_path, rtol=0.0, atol=same)
            assert other.solver.status == done[0].solver.status
        solved[outside] += done[0].solver.status == "solved"
    assert solved[3] > 0
    assert solved[1] + solved[2] > 0


def test_a_kernel_that_is_not_there(paper: Scenario) -> None:
    with pytest.raises(UnknownNameError):
        QPController(paper.cell, paper.grasp, paper.path, dt=0.01, options=QPOptions(kernel="fpga"))


# -- one call ------------------------------------------------------------------------------------------------------


def random_workspace(cell: RobotCell, grasp: Grasp, shares: Array, q: Array, rng: np.random.Generator) -> Workspace:
    """A workspace with errors of any size, gains, flags, and velocities inside or outside the limits."""
    chain = Chain(cell, grasp)
    ws = Workspace(chain, shares, VelocityBox(cell))
    chain.place(q)
    chain.evaluate(q)
    reference = CellState(cell, q).T_world_tool[0] * grasp.T_object_tool[0].inverse()
    ws.set_pose(reference * pin.exp6(10.0 ** rng.uniform(-12, -1) * rng.standard_normal(6)))
    ws.along[:] = 10.0 ** rng.uniform(-3, 0) * rng.standard_normal(6)
    ws.measured[:] = 1e-3 * rng.standard_normal(6)
    ws.positions[:] = cell.positions(q)
    ws.v_prev[:] = 10.0 ** rng.uniform(-3, 0) * rng.standard_normal(cell.nv)
    h = 10.0 ** rng.uniform(-3, -1)
    ws.scalars[:8] = (
        h, rng.uniform(0, 20), rng.uniform(0, 20), rng.uniform(0.01, 0.2),
        rng.uniform(0.01, 0.2), rng.integers(2), rng.integers(2), h * rng.uniform(0.5, 2.0),
    )  # fmt: skip
    return ws


def random_problem(
    paper: Scenario, rng: np.random.Generator
) -> tuple[Workspace, Callable[[], Workspace], Array, float]:
    """A workspace, a function that builds an equal one, the configuration, and the rate cap."""
    cell = paper.cell
    if rng.integers(2):
        cell = cell.with_limits(velocity=10.0 ** rng.uniform(-2, 1), acceleration=10.0 ** rng.uniform(-1, 2))
    q = paper.q_start + 10.0 ** rng.uniform(-9, -2) * rng.standard_normal(18)
    shares = np.zeros((3, 6))
    shares[rng.integers(3, size=6), np.arange(6)] = 1.0  # each axis belongs to one random arm
    shares = [shares, np.full((3, 6), 1 / 3), np.eye(3)[0][:, None] * np.ones(6)][rng.integers(3)]
    predicted, seed = 1e-5 * rng.standard_normal((3, 6)), int(rng.integers(2**31))

    def make() -> Workspace:
        ws = random_workspace(cell, paper.grasp, shares, q, np.random.default_rng(seed))
        ws.predicted[:] = predicted
        return ws

    return make(), make, q, float(rng.uniform(0.2, 1.0))


@pytest.mark.slow
def test_kernels_agree_call_by_call(paper: Scenario, rng: np.random.Generator) -> None:
    """Outcome, velocity and the start of the next step agree with each other and with their definitions."""
    seen = set()
    for _ in range(600):
        _, make, q, cap = random_problem(paper, rng)
        results = []
        for name in KERNELS:
            ws = make()
            kernel = make_kernel(ws, name)
            assert kernel is not None
            positions, v_prev, predicted = ws.positions.copy(), ws.v_prev.copy(), ws.predicted.copy()
            outcome = Outcome(kernel.step(cap, 0.0, 0.0))
            seen.add(outcome)
            carried = paper.grasp.carried(CellState(paper.cell, q))
            expected = [pin.log6(pin.SE3(ws.R, ws.p).actInv(O)).vector for O in carried]
            np.testing.assert_allclose(ws.errors, expected, rtol=0.0, atol=1e-13)
            results.append((outcome, ws))
            if outcome == Outcome.OPEN:  # the state is unchanged
                for before, after in ((positions, ws.positions), (v_prev, ws.v_prev), (predicted, ws.predicted)):
                    np.testing.assert_array_equal(before, after)
                continue
            h, rate = ws.scalars[ws.DT], ws.result[ws.RATE]
            box = VelocityBox(ws.box._cell)
            box.update(positions, v_prev, h)
            assert (ws.velocity <= box.upper + LIMIT_TOLERANCE).all()
            assert (ws.velocity >= box.lower - LIMIT_TOLERANCE).all()
            if outcome == Outcome.NOMINAL:
                assert ws.result.tolist()[:3] == [cap, -1.0, 0.0]
            elif ws.result[ws.JOINT] >= 0:
                j = int(ws.result[ws.JOINT])
                side = box.upper if ws.result[ws.SIDE] > 0.0 else box.lower
                assert ws.velocity[j] == pytest.approx(side[j], abs=1e-8)
            # A v − σν corrects the errors
            twists = ws.chain.twists(ws.velocity) @ np.linalg.inv(ws.action).T - rate * ws.along
            np.testing.assert_allclose(ws.predicted, ws.errors + h * twists, rtol=0.0, atol=1e-8)
            np.testing.assert_allclose(ws.positions, positions + h * ws.velocity, rtol=0.0, atol=1e-14)
            ahead = ws.positions + 0.5 * h * (2.0 * ws.velocity - v_prev)
            np.testing.assert_allclose(ws.midpoint, ahead, rtol=0.0, atol=1e-14)
            np.testing.assert_array_equal(ws.v_prev, ws.velocity)
            assert ws.scalars[[ws.HAS_PREDICTED, ws.LAST_DT]].tolist() == [1.0, h]
            common = ws.measured if ws.scalars[ws.HAS_MEASURED] else (ws.shares * ws.errors).sum(axis=0)
            wanted = -ws.scalars[ws.PATH_GAIN] * common
            bound(wanted[None, :], ws.scalars[ws.SPEED], ws.scalars[ws.SPIN])
            assert ws.result[ws.CORRECTION] == pytest.approx(wanted @ wanted, rel=1e-9, abs=1e-11)
        for outcome, ws in results[1:]:
            first, reference = results[0]
            assert outcome == first
            if outcome != Outcome.OPEN:
                for field in ("velocity", "predicted", "positions", "midpoint"):
                    a, b = getattr(ws, field), getattr(reference, field)
                    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=field)
                np.testing.assert_allclose(ws.result[:3], reference.result[:3], rtol=1e-9, atol=1e-9)
    assert seen == set(Outcome)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell, lambda: ring(arms=5)])
def test_rows_are_those_of_the_program(name: str, make: Callable[[], Scenario], rng: np.random.Generator) -> None:
    """All entries are equal, except the bases of the null-spaces: only their spans are equal."""
    task = make()
    n, nv = len(task.cell), task.cell.nv
    counts = set()
    for _ in range(40):
        limits: dict[str, Any] = {"velocity": 10.0 ** rng.uniform(-2, 1), "acceleration": 10.0 ** rng.uniform(-1, 2)}
        cell = task.cell.with_limits(**limits) if rng.integers(2) else task.cell
        q = pin.integrate(cell.model, task.q_start, 10.0 ** rng.uniform(-9, -2) * rng.standard_normal(nv))
        ws = random_workspace(cell, task.grasp, np.full((n, 6), 1.0 / n), q, rng)
        chain, weights = ws.chain, RankWeights(rate=10.0 ** rng.uniform(-6, -2), length=rng.uniform(0.1, 1.0))
        program = StepProgram(chain, weights)
        ws.unit[:] = program.units
        ws.predicted[:] = 1e-5 * rng.standard_normal((n, 6))
        ws.null_along[:], ws.null_offset[:] = 1e-2 * rng.standard_normal((2, nv))
        for j in rng.choice(np.flatnonzero(np.isfinite(cell.limits.upper)), size=rng.integers(4), replace=False):
            ws.positions[j] = rng.choice([cell.limits.lower[j] - 1e-3, cell.limits.upper[j] + 1e-6])
        kernel = make_kernel(ws, name)
        assert kernel is not None
        cap = rng.uniform()
        outside = kernel.rows(cap, 0.0, 0.0)
        pose, h = pin.SE3(ws.R, ws.p), float(ws.scalars[ws.DT])
        box = VelocityBox(cell)
        box.update(ws.positions, ws.v_prev, h)
        chain.invert()
        terms = StepTerms(
            to_world=pose.action, along=ws.along, path_correction=ws.path, grasp_corrections=ws.grasp,
            offsets=ws.offsets, rate_cap=cap, null_along=chain.null_part(ws.null_along),
            null_offset=chain.null_part(ws.null_offset),
        )  # fmt: skip
        problem, base, B = program.condensed(terms, program.pieces(terms), box)
        own, close = ws.unit.size, {"rtol": 1e-9, "atol": 1e-10}
        np.testing.assert_array_equal(ws.outside[:outside], np.flatnonzero(box.outside))
        np.testing.assert_allclose(ws.recovery, box.recovery, rtol=1e-12)
        np.testing.assert_allclose(ws.base, base, **close)
        np.testing.assert_allclose(ws.columns[:, :9], B[:, :9], **close)
        mine, theirs = ws.columns[:, 9:] / ws.unit[9:], B[:, 9:own] / ws.unit[9:]
        np.testing.assert_allclose(mine @ mine.T, theirs @ theirs.T, **close)
        np.testing.assert_allclose(ws.rows * ws.norms[:, None], ws.columns, **close)
        np.testing.assert_allclose(ws.row_lower, problem.l, **close)
        np.testing.assert_allclose(ws.row_upper, problem.u, **close)
        counts.add(outside)
    assert len(counts) >= 3


@pytest.mark.parametrize("name", KERNELS)
def test_where_the_object_is_seen(name: str, paper: Scenario, rng: np.random.Generator) -> None:
    """Errors and the common error, relative to the path's pose or a given pose."""
    for _ in range(100):
        ws, _, q, _ = random_problem(paper, rng)
        kernel, clock = make_kernel(ws, name), float(rng.uniform(0.0, paper.path.duration))
        assert kernel is not None
        pose = pin.SE3(ws.R, ws.p)
        if rng.integers(2):
            pose = paper.path.pose(clock)
            ws.line[:], ws.scalars[ws.ON_LINE] = paper.path.line_at(clock, 0.0), 1.0
        assert kernel.observe(clock)
        carried = paper.grasp.carried(CellState(paper.cell, q))
        errors = np.array([pin.log6(pose.actInv(O)).vector for O in carried])
        np.testing.assert_allclose(ws.errors, errors, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(ws.common, (ws.shares * errors).sum(axis=0), rtol=0.0, atol=1e-12)
    ws.placements[-1] = np.nan
    assert not kernel.observe(clock)


def test_kernels_follow_lines_as_the_path_does(paper: Scenario, rng: np.random.Generator) -> None:
    for _ in range(200):
        turn = rng.standard_normal(3) * rng.choice([0.0, 1e-9, 1e-3, 1.0])
        law = ("linear", "quintic")[rng.integers(2)]
        path = LinePath.displaced(
            pin.exp6(rng.standard_normal(6)),
            translation=rng.standard_normal(3),
            rotation=turn,
            duration=2.0,
            time_law=law,
        )
        clock, span = float(rng.uniform(0.0, 2.0)), float(rng.choice([-1.0, 0.0, 1e-3, 0.1, 0.5]))
        along = path.increment(clock, span) if span > 0.0 else path.twist(clock) if span < 0.0 else np.zeros(6)
        for name in KERNELS:
            ws = Workspace(Chain(paper.cell, paper.grasp), np.full((3, 6), 1 / 3), VelocityBox(paper.cell))
            kernel = make_kernel(ws, name)
            assert kernel is not None
            assert kernel.follows_lines
            ws.line[:] = path.line_at(clock, span)
            ws.scalars[[ws.DT, ws.LAST_DT]] = 0.01
            ws.scalars[ws.ON_LINE] = 1.0
            kernel.step(1.0, clock, span)
            pose = path.pose(clock)
            np.testing.assert_allclose(ws.R, pose.rotation, rtol=0.0, atol=1e-14)
            np.testing.assert_allclose(ws.p, pose.translation, rtol=0.0, atol=1e-14)
            np.testing.assert_allclose(ws.along, along, rtol=0.0, atol=1e-11)


INPUTS = (
    "placements", "jacobian_T", "R", "p", "along", "measured", "positions", "v_prev", "predicted", "scalars", "line",
    "cap", "clock", "span",
)  # fmt: skip


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0])
@pytest.mark.parametrize("field", INPUTS)
@pytest.mark.parametrize("name", KERNELS)
def test_what_is_no_number_stays_open(
    name: str, field: str, value: float, paper: Scenario, rng: np.random.Generator
) -> None:
    for _ in range(10):
        ws, _, _, cap = random_problem(paper, rng)
        numbers = {"cap": cap, "clock": 0.5, "span": 0.01}
        ws.scalars[[ws.HAS_MEASURED, ws.HAS_PREDICTED]] = 1.0
        ws.line[:] = paper.path.line_at(0.0, 0.0)
        ws.line[20] = rng.integers(2)  # either time law
        ws.scalars[ws.ON_LINE] = field in ("line", "clock", "span")
        kernel = make_kernel(ws, name)
        assert kernel is not None
        if field in numbers:
            numbers[field] = value
        else:
            getattr(ws, field)[...] = value
        if field in ("R", "p"):
            ws.action[:] = value
        with np.errstate(all="raise" if np.isnan(value) else "ignore"):
            outcome = Outcome(kernel.step(*numbers.values()))
            rows = kernel.rows(*numbers.values())
        if not np.isfinite(value) and not (np.isinf(value) and field in ("clock", "span")):  # path end
            assert outcome == Outcome.OPEN
            assert rows == -1


@pytest.mark.parametrize("rows", [slice(None), slice(3, 5)], ids=["all", "two joints"])
@pytest.mark.parametrize("name", KERNELS)
def test_a_singular_arm_is_left_open(name: str, rows: slice, paper: Scenario, rng: np.random.Generator) -> None:
    for _ in range(20):
        ws, *_ = random_problem(paper, rng)
        ws.jacobian_T[rows] = 0.0
        kernel = make_kernel(ws, name)
        assert kernel is not None
        with np.errstate(all="raise"):
            assert kernel.step(1.0, 0.0, 0.0) == Outcome.OPEN
            assert kernel.rows(1.0, 0.0, 0.0) == -1


@pytest.mark.parametrize("name", KERNELS)
def test_a_joint_outside_its_limits_is_left_open(name: str, paper: Scenario) -> None:
    for side in (1.0, -1.0):
        chain = Chain(paper.cell, paper.grasp)
        ws = Workspace(chain, np.full((3, 6), 1 / 3), VelocityBox(paper.cell))
        chain.place(paper.q_start)
        chain.evaluate(paper.q_start)
        ws.set_pose(paper.path.pose(0.0))
        ws.scalars[:5] = 0.01, 1.0, 1.0, 0.1, 0.4
        ws.positions[:] = paper.q_start
        kernel = make_kernel(ws, name)
        assert kernel is not None
        assert kernel.step(1.0, 0.0, 0.0) == Outcome.NOMINAL
        limit = paper.cell.limits.upper if side > 0 else paper.cell.limits.lower
        ws.positions[4] = limit[4] + side * 1e-6
        assert kernel.step(1.0, 0.0, 0.0) == Outcome.OPEN


# -- the preview's borders ---------------------------------------------------------------------------------------------


def random_border(rng: np.random.Generator, joints: int) -> BorderArrays:
    a = 10.0 ** rng.uniform(-1, 2, size=joints)
    limits = JointLimits(
        np.full(joints, -1.0),
        np.full(joints, rng.choice([1.0, np.inf])),
        np.full(joints, np.inf),
        np.full(joints, np.inf),
    )
    border = BorderArrays(
        rng.standard_normal(joints),
        limits,
        per_speed=rng.uniform(0.0, 2.0, size=joints),
        per_bend=1.0 / (0.5 * a),
        acceleration=a,
        slope_change=rng.uniform(0.0, 0.1, size=joints),
        caps_speed=bool(rng.integers(2)),
    )
    border.before[:] = border.slope + 10.0 ** rng.uniform(-6, -1) * rng.standard_normal(joints)
    border.positions[:] = rng.uniform(-1.02, 1.02, size=joints)
    return border


@pytest.mark.parametrize("name", KERNELS)
def test_a_border_is_what_the_limits_leave(name: str, rng: np.random.Generator) -> None:
    """z_cap and the decrease of the rate agree with their definitions in docs/derivations.md."""
    for _ in range(300):
        b, h = random_border(rng, int(rng.integers(1, 20))), 10.0 ** rng.uniform(-3, -1)
        make_border(b, name).evaluate(h)
        fastest, change, by_speed, j_speed, by_bend, j_bend, cap, tightest, inside = b.result.tolist()
        bend = (b.slope - b.before) / h
        np.testing.assert_allclose(b.curvature, bend, rtol=1e-12)
        assert fastest == np.abs(b.slope).max()
        assert change == pytest.approx((np.abs(b.slope - b.before) - b.slope_change).max(), rel=1e-9, abs=1e-12)
        speed = np.maximum(np.abs(b.slope), np.abs(b.before))
        assert (by_speed, j_speed) == (pytest.approx((speed * b.per_speed).max()), (speed * b.per_speed).argmax())
        assert by_bend == pytest.approx((np.abs(bend) * b.per_bend).max())
        assert j_bend == (np.abs(bend) * b.per_bend).argmax()
        caps = [1.0, 1.0 / by_bend, 1.0 / by_speed**2 if b.caps_speed and by_speed > 0.0 else 1.0]
        assert cap == pytest.approx(min(caps))
        assert tightest == pytest.approx((speed / (b.acceleration - np.abs(bend) * cap)).max())
        assert inside == ((b.positions >= b.low) & (b.positions <= b.high)).all()


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("field", ["slope", "before"])
def test_a_border_that_is_no_number_says_so(name: str, field: str, rng: np.random.Generator) -> None:
    for j in range(6):
        b = random_border(rng, 6)
        getattr(b, field)[j] = np.nan
        make_border(b, name).evaluate(0.01)
        assert np.isnan(b.result[[b.CHANGE, b.SPEED_USE, b.BEND_USE, b.TIGHTEST]]).all()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler")
def test_where_there_is_a_compiler_the_kernel_is_compiled() -> None:
    """Without a compiler the build silently falls back to NumPy; no other test detects a missing kernel."""
    assert KERNELS[0] == "compiled"
