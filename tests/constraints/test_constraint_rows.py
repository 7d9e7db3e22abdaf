"""A user's own constraints: rows on joint velocities, and lines on the object's rate. They are those of the how-to."""

from __future__ import annotations

import copy
import dataclasses
import runpy
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden
from marks import slow_unless
from places import DOCS
from runs import built, limited
from user_paths import Opaque

from coopqp import (
    BindingLimit,
    ControlStep,
    InvalidInputError,
    Knot,
    LimitKind,
    LinePath,
    QPController,
    QPOptions,
    Rank,
    RateBound,
    RobotCell,
    ServoPath,
    Status,
    VelocityConstraint,
)
from coopqp.constraints.velocity import LabelledRows, Quiet
from coopqp.model import CellState
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.solvers import QpProblem, QpSolution, QpSolver, SolverStatus, make_solver
from coopqp.spatial import Array

EXAMPLE = runpy.run_path(str(DOCS / "examples" / "16_constraints.py"))
Box, SlowPoint, LittleEnergy = (EXAMPLE[name] for name in ("Box", "SlowPoint", "LittleEnergy"))
ACCELERATIONS = (np.inf, 5.0)
DT = 0.005
FAR = np.inf
BLOCKED = 150


class Torques:
    """Motor torques stay within bounds, |M q̈ + C q̇ + g| ≤ τ: a rate bound of two lines per joint."""

    name = "torques"

    def __init__(self, cell: RobotCell, largest: Array) -> None:
        self.model, self.data, self.largest = cell.model, cell.model.createData(), largest

    def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
        q, still = knot.state.q, np.zeros(self.model.nv)
        gravity = pin.rnea(self.model, self.data, q, still, still).copy()
        by_square = pin.rnea(self.model, self.data, q, knot.slope, knot.curvature) - gravity
        by_change = pin.rnea(self.model, self.data, q, still, knot.slope) - gravity
        return (
            np.concatenate([by_square, -by_square]),
            np.concatenate([by_change, -by_change]),
            np.concatenate([self.largest - gravity, self.largest + gravity]),
        )


class Told:
    """Rows that its owner makes."""

    def __init__(self, make: Callable[[CellState], Any], rank: Rank = Rank.LIMITS, name: str = "told") -> None:
        self.make, self.rank, self.name = make, rank, name

    def rows(self, state: CellState, dt: float) -> Any:
        return self.make(state)


class ToldLines:
    """Lines that its owner makes."""

    name = "told lines"

    def __init__(self, make: Callable[[Knot], Any]) -> None:
        self.make = make

    def lines(self, knot: Knot) -> Any:
        return self.make(knot)


class Sighted:
    """A certified constraint without rows; it keeps whether it was asked as one that nothing brakes ahead of."""

    name, rank = "sighted", Rank.CLEARANCE
    labels = (BindingLimit("", "", LimitKind.COLLISION),)

    def __init__(self, nv: int) -> None:
        self.quiet = self.quiet_ahead = Quiet(np.zeros(nv), np.zeros(nv), -1.0)
        self.blind: list[bool] = []

    def rows_by_label(self, q: Array, dt: float, *, blind: bool) -> LabelledRows:
        self.blind.append(blind)
        return LabelledRows(np.zeros((0, len(self.quiet.centre))), np.zeros(0), np.zeros(0), np.zeros(0, dtype=int))

    def rows(self, state: CellState, dt: float) -> Any:
        return self.rows_by_label(state.q, dt, blind=False)[:3]

    def check(self, q: Array) -> None:
        pass

    def tightened(self, rows: LabelledRows, q_next: Array, v: Array, dt: float) -> Array | None:
        return None

    def in_memory(self, memory: Any, *, ahead: bool = False) -> None:
        return None

    def stopping_pair(self, knot: Knot) -> int:
        return -1

    def evaded(self, q: Array, slope: Array) -> Array:
        return slope

    def measured(self, limit: BindingLimit, q: Array) -> BindingLimit:
        return limit

    def nearest(self, q: Array) -> None:
        return None

    def inside(self, q: Array) -> tuple[BindingLimit, ...]:
        return ()


@dataclasses.dataclass
class Run:
    """Steps of a run, and how well it went: rows beyond their bounds, the object off its path, arms apart [m]."""

    steps: list[ControlStep]
    excess: float = 0.0
    off: float = 0.0
    apart: float = 0.0

    @property
    def last(self) -> ControlStep:
        return self.steps[-1]

    @property
    def statuses(self) -> set[Status]:
        return {s.status for s in self.steps}


def drive(controller: QPController, steps: int, velocity: Array | float = 0.0) -> Run:
    """At most this number of steps: to the end of the path, or till the object has stood for :data:`BLOCKED` steps. The
    joints begin at a velocity (nv,)."""
    run, blocked = Run([]), 0
    before = np.zeros(controller.cell.nv) + velocity
    limits = controller.cell.limits
    of_rows = [c for c in controller.constraints if isinstance(c, VelocityConstraint)]
    for _ in range(steps):
        step = controller.step()
        v = step.velocity
        for constraint in of_rows:
            G, lower, upper = constraint.rows(step.state, step.dt)
            run.excess = max(run.excess, float((G @ v - upper).max()), float((lower - G @ v).max()))
        error = controller.path.pose(step.clock).actInv(controller.grasp.carried(step.state)[0])
        run.off = max(run.off, float(np.linalg.norm(error.translation)))
        run.apart = max(run.apart, float(controller.grasp.relative_errors(step.state)[:, :3].max()))
        assert (np.abs(v) <= limits.velocity + 1e-12).all()
        assert (np.abs(v - before) <= limits.acceleration * step.dt * (1.0 + 1e-9) + 1e-12).all()
        before = v
        run.steps.append(step)
        blocked = blocked + 1 if step.status is Status.BLOCKED else 0
        if step.finished or blocked == BLOCKED:
            break
    return run


def origin(task: Scenario, step: ControlStep) -> Array:
    return np.asarray(task.grasp.carried(CellState(task.cell, step.q_next))[0].translation)


def test_the_protocols_are_public() -> None:
    task = paper_lift()
    assert isinstance(Box(task.grasp, (-FAR,) * 3, (FAR,) * 3), VelocityConstraint)
    assert isinstance(LittleEnergy(task.grasp, 1.0, 1.0), RateBound)
    assert not isinstance(LittleEnergy(task.grasp, 1.0, 1.0), VelocityConstraint)


def test_constraints_are_told_whether_anything_brakes_ahead_of_them() -> None:
    task = paper_lift()
    unknown = dataclasses.replace(task, path=Opaque(task.path, known_ahead=False))
    for case, options, blind in ((task, {}, False), (task, {"preview": None}, True), (unknown, {}, True)):
        sighted = Sighted(task.cell.nv)
        controller = built(case, dt=DT, constraints=[sighted], **options)
        sighted.blind.clear()
        for _ in range(5):
            controller.step()
        assert sighted.blind == 5 * [blind]


# -- walls -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", ACCELERATIONS)
@pytest.mark.parametrize(
    "make",
    slow_unless(lambda make: make is dual_arm7, [paper_lift, dual_arm7, mixed_cell]),
    ids=lambda make: make.__name__,
)
def test_the_object_stops_at_a_wall(make: Callable[..., Scenario], acceleration: float) -> None:
    task = limited(make(time_law="quintic"), acceleration)
    start, goal = (task.path.pose(clock).translation for clock in (0.0, task.path.duration))
    wall = 0.5 * (start + goal)[2]
    run = drive(built(task, dt=DT, constraints=[Box(task.grasp, (-FAR,) * 3, (FAR, FAR, wall))]), 900)
    assert run.excess <= 1e-9
    assert run.off <= 1e-6
    assert run.apart <= 1e-6
    assert run.statuses == {Status.SLOWED, Status.TRACKING, Status.BLOCKED}
    (limit,) = run.last.binding
    assert (limit.kind, limit.name) == (LimitKind.CONSTRAINT, "box")
    assert "constraint box" in run.last.explain()
    away = [wall - origin(task, step)[2] for step in run.steps]
    assert min(away) >= -1e-6
    assert away[-1] <= 1e-3
    assert float(np.abs(run.last.velocity).max()) <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [np.inf, 5.0, 20.0])
def test_the_object_stops_at_any_wall(acceleration: float) -> None:
    """Walls on any side, paths of any direction and law; where the braking asked for is more than the joints have, the
    object still stops on its path."""
    rng = np.random.default_rng(0)
    for i in range(24):
        task = limited((paper_lift, dual_arm7, mixed_cell)[i % 3](), acceleration)
        start = task.path.pose(0.0)
        way = rng.standard_normal(3)
        way *= rng.uniform(0.05, 0.15) / np.linalg.norm(way)
        path = LinePath.displaced(
            start, translation=way, rotation=0.1 * rng.standard_normal(3), duration=float(rng.uniform(0.4, 2.0)),
            time_law="quintic" if i % 2 else "linear",
        )  # fmt: skip
        side = int(np.abs(way).argmax())
        low, high = np.full(3, -FAR), np.full(3, FAR)
        (high if way[side] > 0.0 else low)[side] = start.translation[side] + rng.uniform(0.2, 0.9) * way[side]
        box = Box(task.grasp, low, high, braking=float(10.0 ** rng.uniform(-1.0, 0.5)))
        run = drive(built(dataclasses.replace(task, path=path), dt=DT, constraints=[box]), 900)
        assert run.excess <= 1e-9, i
        assert run.apart <= 1e-6, i
        assert run.off <= 1e-6, i
        assert run.last.status is Status.BLOCKED, (i, run.last)
        assert any(b.name == "box" for b in run.last.binding), (i, run.last)


def test_a_wall_binds_by_name_on_the_way_to_a_target() -> None:
    task = paper_lift()
    start = task.path.pose(0.0)
    servo = dataclasses.replace(task, path=ServoPath(start, speed=0.1))
    controller = built(
        servo, dt=DT, constraints=[Box(task.grasp, (-FAR,) * 3, (FAR, FAR, start.translation[2] + 0.03))]
    )
    controller.retarget(pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 0.1])))
    run = drive(controller, 300)
    assert run.excess <= 1e-9
    assert run.apart <= 1e-6
    assert run.last.status is Status.BLOCKED
    assert [b.name for b in run.last.binding] == ["box"]
    assert origin(task, run.last)[2] - start.translation[2] == pytest.approx(0.03, abs=1e-3)


# -- speeds ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", ACCELERATIONS)
def test_an_elbow_keeps_its_speed(acceleration: float) -> None:
    task = limited(paper_lift(time_law="quintic", duration=0.8), acceleration)
    frame, most = "slave_1/joint_3", 0.08
    index, data = task.cell.model.getFrameId(frame), task.cell.model.createData()

    def speeds(run: Run) -> list[float]:
        found = []
        for step in run.steps:
            J = pin.computeFrameJacobian(task.cell.model, data, step.q, index, pin.LOCAL_WORLD_ALIGNED)
            found.append(float(np.linalg.norm(J[:3] @ step.velocity)))
        return found

    free = drive(built(task, dt=DT, constraints=[]), 2000)
    assert max(speeds(free)) > most
    run = drive(built(task, dt=DT, constraints=[SlowPoint(task.cell, frame, most)]), 2000)
    assert run.excess <= 1e-9
    assert run.off <= 1e-6
    assert run.apart <= 1e-6
    assert max(speeds(run)) <= most
    assert max(speeds(run)) >= 0.75 * most
    assert run.last.finished
    assert len(run.steps) > len(free.steps)
    slowed = [s for s in run.steps if s.binding and s.binding[0].kind is LimitKind.CONSTRAINT]
    assert {s.binding[0].name for s in slowed} == {f"speed of {frame}"}


@pytest.mark.parametrize("acceleration", ACCELERATIONS)
def test_the_object_keeps_its_energy(acceleration: float) -> None:
    task = limited(paper_lift(time_law="quintic"), acceleration)
    mass, most = 9.0, 0.05
    run = drive(built(task, dt=DT, constraints=[LittleEnergy(task.grasp, mass, most)]), 2000)
    energy = []
    for step in run.steps:
        v = task.grasp.carried(step.state)[0], task.grasp.carried(CellState(task.cell, step.q_next))[0]
        speed = float(np.linalg.norm(v[1].translation - v[0].translation)) / step.dt
        energy.append(0.5 * mass * speed**2)
    assert max(energy) <= most * 1.002
    assert max(energy) >= 0.95 * most
    assert run.off <= 1e-6
    assert run.last.finished
    assert any(b.name == "energy" for s in run.steps for b in s.binding)


def test_motors_keep_their_torques() -> None:
    """Faster, the paper's lift would need more than gravity and a fifth of what it takes at full rate."""
    task = limited(paper_lift(time_law="quintic", duration=0.6), 20.0)
    model, data = task.cell.model, task.cell.model.createData()

    def torques(run: Run) -> tuple[Array, Array]:
        found, gravity, before = [], [], np.zeros(model.nv)
        for step in run.steps:
            middle = task.cell.moved(step.q, 0.5 * step.dt * step.velocity)
            change = (step.velocity - before) / step.dt
            found.append(pin.rnea(model, data, middle, step.velocity, change).copy())
            gravity.append(pin.rnea(model, data, middle, np.zeros(model.nv), np.zeros(model.nv)).copy())
            before = step.velocity
        return np.abs(found).max(axis=0), np.abs(gravity).max(axis=0)

    free = drive(built(task, dt=DT, constraints=[]), 2000)
    full, gravity = torques(free)
    largest = gravity + 0.2 * (full - gravity) + 0.5
    run = drive(built(task, dt=DT, constraints=[Torques(task.cell, largest)]), 2000)
    found, _ = torques(run)
    assert (full > largest).any()
    assert (found <= largest + 0.02 * (full - gravity) + 0.05).all()
    assert run.off <= 1e-6
    assert run.last.finished
    assert any(b.name == "torques" for s in run.steps for b in s.binding)


# -- ranks -------------------------------------------------------------------------------------------------------------


def lifted_by_the_master(task: Scenario, speed: float, rank: Rank) -> Told:
    """The master's tool has to rise."""

    def make(state: CellState) -> tuple[Array, Array, Array]:
        G = np.zeros((1, task.cell.nv))
        G[:, task.cell.v_slices[0]] = state.jacobian(0, pin.LOCAL_WORLD_ALIGNED)[2]
        return G, np.array([speed]), np.array([FAR])

    return Told(make, rank)


@pytest.mark.parametrize("solver", ["auto", "daqp"])
def test_clearance_gives_way_before_the_arms_part_and_limits_never_do(solver: str) -> None:
    """The master has to rise faster than the slaves can follow."""
    task = paper_lift()
    speed = task.cell.limits.velocity.copy()
    speed[6:] = 1e-3
    task = limited(task, np.inf, velocity=speed)
    soft, hard = (
        built(task, dt=DT, constraints=[lifted_by_the_master(task, 0.05, rank)], solver=solver).step()
        for rank in (Rank.CLEARANCE, Rank.LIMITS)
    )
    for step, kept in ((soft, False), (hard, True)):
        rise = float(step.state.jacobian(0, pin.LOCAL_WORLD_ALIGNED)[2] @ step.velocity[:6])
        assert (rise >= 0.05 - 1e-9) == kept
        assert (step.given_up.chain > 1e-3) == kept
        assert (np.abs(step.velocity) <= speed).all()
    assert "told" in {b.name for b in soft.binding}


@pytest.mark.parametrize("rank", [Rank.CLEARANCE, Rank.LIMITS])
def test_the_object_leaves_its_path_for_either_rank(rank: Rank) -> None:
    task = paper_lift()
    controller = built(task, dt=DT, constraints=[lifted_by_the_master(task, 0.3, rank)])
    run = drive(controller, 20)
    assert run.excess <= 1e-9
    assert run.apart <= 1e-6
    assert run.last.given_up.off_path[0:3] != (0.0, 0.0, 0.0)


# -- what a user's code gets wrong -------------------------------------------------------------------------------------


def rows_of(nv: int) -> dict[str, Callable[[CellState], Any]]:
    def fail(state: CellState) -> Any:
        raise KeyError("no distance")

    class OwnError(Exception):
        pass

    def fail_oddly(state: CellState) -> Any:
        raise OwnError("no distance")

    one = np.ones(1)
    return {
        "raises": fail,
        "raises its own": fail_oddly,
        "None": lambda state: None,
        "two arrays": lambda state: (np.zeros((1, nv)), one),
        "words": lambda state: ("G", "lower", "upper"),
        "NaN in G": lambda state: (np.full((1, nv), np.nan), -one, one),
        "NaN bounds": lambda state: (np.zeros((1, nv)), -one, one * np.nan),
        "bounds crossed": lambda state: (np.zeros((1, nv)), one, -one),
        "too few columns": lambda state: (np.zeros((1, nv - 1)), -one, one),
        "transposed": lambda state: (np.zeros((nv, 2)), -np.ones(2), np.ones(2)),
        "too few bounds": lambda state: (np.zeros((2, nv)), -one, one),
        "bounds in columns": lambda state: (np.zeros((2, nv)), -np.ones((2, 1)), np.ones((2, 1))),
        "three axes": lambda state: (np.zeros((1, 1, nv)), -one, one),
        "1e300": lambda state: (np.full((1, nv), 1e300), -one, one),
        "complex": lambda state: (np.zeros((1, nv), complex), -one, one),
        "ragged": lambda state: ([[0.0], [0.0, 1.0]], -one, one),
        "65 rows": lambda state: (np.zeros((65, nv)), -np.ones(65), np.ones(65)),
    }


def lines_of() -> dict[str, Callable[[Knot], Any]]:
    def fail(knot: Knot) -> Any:
        raise KeyError("no torque")

    return {
        "lines raise": fail,
        "lines are None": lambda knot: None,
        "lines of NaN": lambda knot: (np.nan, 0.0, 1.0),
        "lines of two lengths": lambda knot: (np.ones(2), np.ones(1), np.ones(2)),
        "lines in a matrix": lambda knot: (np.ones((2, 2)), np.ones((2, 2)), np.ones((2, 2))),
    }


NONSENSE = [*rows_of(6), *lines_of()]


def nonsense(name: str, nv: int) -> Any:
    """A constraint that is right until its owner spoils it."""
    if name in lines_of():
        return ToldLines(lambda knot: (np.zeros(1), np.zeros(1), np.ones(1)))
    return Told(lambda state: (np.zeros((1, nv)), -np.ones(1), np.ones(1)))


def spoil(constraint: Any, name: str, nv: int) -> None:
    constraint.make = {**rows_of(nv), **lines_of()}[name]


@pytest.mark.parametrize("name", NONSENSE)
def test_nonsense_at_the_start_is_a_named_error(name: str) -> None:
    task = paper_lift()
    constraint = nonsense(name, task.cell.nv)
    spoil(constraint, name, task.cell.nv)
    controller = QPController(task.cell, task.grasp, task.path, dt=DT, constraints=[constraint])
    with pytest.raises(InvalidInputError, match="constraint"):
        controller.reset(task.q_start)


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_any_nonsense_in_motion_holds_by_name_until_it_ends(acceleration: float) -> None:
    task = limited(paper_lift(time_law="quintic", duration=1.0), acceleration)
    in_motion: dict[type, tuple[QPController, ControlStep]] = {}
    for name in NONSENSE:
        good = nonsense(name, task.cell.nv)
        if type(good) not in in_motion:
            controller = built(task, dt=DT, constraints=[Box(task.grasp, (-FAR,) * 3, (FAR,) * 3), good])
            in_motion[type(good)] = controller, drive(controller, 60).last
        controller, before = copy.deepcopy(in_motion[type(good)])
        constraint: Any = controller.constraints[1]
        spoil(constraint, name, task.cell.nv)
        held = []
        for _ in range(130):  # what is known ahead, 40 steps at least, was right
            step = controller.step()
            assert np.isfinite(step.velocity).all()
            assert (np.abs(step.velocity - before.velocity) <= task.cell.limits.acceleration * DT + 1e-9).all()
            held.append(step.status is Status.HOLDING)
            assert not held[-1] or constraint.name in step.reason or "constraints have" in step.reason, name
            before = step
        assert held[-1], name
        assert float(np.abs(before.velocity).max()) < 1e-6, name
        constraint.make = good.make
        run = drive(controller, 1000, before.velocity)
        assert run.last.finished, name


def test_rows_that_fail_hold_the_object_without_a_look_ahead_too() -> None:
    """Nothing else asks the constraint: the step itself has to hold, by name, while it fails."""
    task = limited(paper_lift(time_law="quintic"), 10.0)
    constraint = nonsense("raises its own", task.cell.nv)
    good = constraint.make
    controller = built(task, dt=DT, constraints=[constraint], preview=None)
    assert drive(controller, 40).statuses <= {Status.TRACKING, Status.SLOWED}
    spoil(constraint, "raises its own", task.cell.nv)
    for _ in range(30):
        step = controller.step()
        assert step.status is Status.HOLDING
        assert constraint.name in step.reason
    assert float(np.abs(step.velocity).max()) < 1e-9
    constraint.make = good
    assert Status.HOLDING not in drive(controller, 5).statuses


def test_what_is_no_constraint_is_refused() -> None:
    task = paper_lift()
    box = Box(task.grasp, (-FAR,) * 3, (FAR,) * 3)
    for bad, words in (
        (None, "name"),
        ("box", "name"),
        (Told(lambda state: None, name=""), "name"),
        (Told(lambda state: None, name=None), "name"),  # type: ignore[arg-type]
        (Told(lambda state: None, rank=Rank.COMFORT), "rank"),
        (Told(lambda state: None, rank="hard"), "rank"),  # type: ignore[arg-type]
        (dataclasses.make_dataclass("Empty", [("name", str, "empty")])(), "neither"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            QPController(task.cell, task.grasp, task.path, dt=DT, constraints=[box, bad])
    with pytest.raises(InvalidInputError, match="its name is 'box'"):
        QPController(task.cell, task.grasp, task.path, dt=DT, constraints=[box, copy.copy(box)])


def test_a_refused_reset_changes_nothing() -> None:
    task = limited(paper_lift(), 10.0)
    constraint = nonsense("raises", task.cell.nv)
    controller, other = (built(task, dt=DT, constraints=[c]) for c in (constraint, copy.copy(constraint)))
    drive(controller, 40)
    drive(other, 40)
    right = constraint.make
    spoil(constraint, "raises", task.cell.nv)
    with pytest.raises(InvalidInputError, match="constraint told"):
        controller.reset(task.q_start)
    constraint.make = right
    for _ in range(20):
        assert np.array_equal(controller.step().velocity, other.step().velocity)


# -- recorded steps, and copies ----------------------------------------------------------------------------------------


def all_kinds(task: Scenario) -> list[Any]:
    top = task.path.pose(task.path.duration).translation[2]
    arm = task.cell.arm_names[-1]
    frame = next(f.name for f in task.cell.model.frames if f.name.startswith(f"{arm}/") and f.name.endswith("joint_3"))
    return [
        Box(task.grasp, (-FAR,) * 3, (FAR, FAR, top - 0.05)),
        LittleEnergy(task.grasp, 9.0, 0.08),
        SlowPoint(task.cell, frame, 0.03),
        Torques(task.cell, np.full(task.cell.nv, 1e3)),
        lifted_by_the_master(task, -0.04, Rank.CLEARANCE),
    ]


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("acceleration", ACCELERATIONS)
@pytest.mark.parametrize("shortcut", [True, False])
def test_constraints_of_all_kinds_as_recorded(acceleration: float, shortcut: bool, golden: Golden) -> None:
    for make in (paper_lift, mixed_cell):
        task = limited(make(time_law="quintic"), acceleration)
        done = golden.of(built(task, dt=DT, constraints=all_kinds(task), shortcut=shortcut))
        rng, q = np.random.default_rng(0), None
        for i in range(250):
            step = done.take(q)
            q = task.cell.moved(step.q_next, rng.uniform(-1e-5, 1e-5, task.cell.nv)) if i > 100 else None


def test_a_deep_copy_has_constraints_of_its_own() -> None:
    task = limited(paper_lift(time_law="quintic"), 5.0)
    controller = built(task, dt=DT, constraints=all_kinds(task))
    drive(controller, 120)
    other = copy.deepcopy(controller)
    assert all(a is not b for a, b in zip(controller.constraints, other.constraints, strict=True))
    for _ in range(60):
        assert np.array_equal(controller.step().velocity, other.step().velocity)


# -- the brake -----------------------------------------------------------------------------------------------------


class Failing(QpSolver):
    """Works until ``broken``; then it has no answer."""

    name = "failing"

    def __init__(self) -> None:
        self.solver, self.broken = make_solver("daqp"), False
        self.settings = self.solver.settings

    def _forget(self) -> None:
        self.solver.reset()

    def _solve(self, problem: QpProblem, work: Any) -> Any:
        raise NotImplementedError

    def solve(self, problem: QpProblem) -> QpSolution:
        found = self.solver.solve(problem)
        nothing = np.full(problem.g.size, np.nan)
        return dataclasses.replace(found, status=SolverStatus.FAILED, x=nothing) if self.broken else found


def braked(rank: Rank, lower: Callable[[float], float]) -> tuple[float, float, ControlStep]:
    """The speed before and after the solver fails, along the present motion, and the step.

    A row asks for at least ``lower`` of the speed before.
    """
    task = paper_lift(time_law="quintic")
    cell = task.cell.with_limits(acceleration=5.0)
    way, least = np.zeros(cell.nv), [-np.inf]
    told = Told(lambda _: (way[None].copy(), np.array([least[0]]), np.array([np.inf])), rank)
    solver = Failing()
    options = QPOptions(shortcut=False, solver=solver)
    controller = QPController(cell, task.grasp, task.path, dt=DT, options=options, constraints=[told])
    controller.reset(task.q_start)
    for _ in range(200):
        step = controller.step()
    way[:] = step.velocity / np.linalg.norm(step.velocity)
    speed = float(np.linalg.norm(step.velocity))
    least[0], solver.broken = lower(speed), True
    step = controller.step()
    assert step.status is Status.HOLDING
    assert "no usable answer" in step.reason
    assert step.given_up.chain == 0.0
    assert (np.abs(step.velocity) <= cell.limits.velocity).all()
    return speed, float(way @ step.velocity), step


@pytest.mark.parametrize("rank", [Rank.LIMITS, Rank.CLEARANCE])
@pytest.mark.slow
def test_a_brake_without_a_solver_keeps_the_rows(rank: Rank) -> None:
    speed, free, hardest = braked(rank, lambda _: -np.inf)
    assert free < 0.97 * speed  # the brake without rows
    _, kept, _ = braked(rank, lambda speed: 0.99 * speed)
    assert 0.99 * speed - 1e-9 <= kept < speed
    _, beyond, step = braked(rank, lambda speed: 2.0 * speed)  # nothing keeps that one
    if rank is Rank.CLEARANCE:
        assert beyond >= kept - 1e-9  # it breaks the row by the least, and speeds up for nobody
    assert beyond <= 1.02 * speed
    _, idle, same = braked(rank, lambda speed: -speed)
    assert np.array_equal(same.velocity, hardest.velocity)
    assert idle == free
    assert step.rate <= 1.0
