"""The compiled core by itself: the memory it is given, the numbers in it, and its two arithmetics.

The golden runs and the oracle (tests/golden, tests/oracle) say what its steps are.
"""

from __future__ import annotations

import dataclasses
import gc
import re
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from places import ROOT
from runs import limited

from coopqp import (
    ControlStep,
    HoldPath,
    LinePath,
    ObjectPath,
    QPOptions,
    ServoPath,
    SupervisionOptions,
    WaypointPath,
)
from coopqp.control.core.loop import CoreLoop
from coopqp.control.step import decoding
from coopqp.control.step.constraint_set import Constraints
from coopqp.core import _core as native
from coopqp.model import CellState
from coopqp.model.chain import moving_columns
from coopqp.scenarios import Scenario, at_limit, dual_arm7, mixed_cell, paper_lift, ring
from coopqp.solvers import QpProblem, QpSolution, QpSolver, make_solver
from coopqp.spatial import Array

pytestmark = pytest.mark.core

#: The one that this processor runs, and the one that any can.
ARITHMETICS = ("auto", "plain")
NOMINAL, RATE_SEARCH, QP = range(len(native.OUTCOMES))
SCENARIOS = [paper_lift, dual_arm7, mixed_cell, at_limit]


def loop_of(
    task: Scenario,
    *,
    arithmetic: str = "auto",
    path: ObjectPath | None = None,
    dt: float | None = None,
    **options: Any,
) -> Any:
    """A loop at the start of the scenario."""
    loop = CoreLoop(
        task.cell,
        task.grasp,
        dt=dt or task.dt,
        options=QPOptions(**options),
        constraints=Constraints(task.cell, ()),
        arithmetic=arithmetic,
    )
    loop.follow(path or task.path)
    loop.start(task.q_start)
    loop.start_path()
    return loop


def core_of(loop: Any) -> Any:
    """The loop's core: ``step`` is a method of it."""
    return loop.step.__self__


def proposal(loop: Any, name: str) -> float:
    value: float = getattr(loop._proposal, name.lower())
    return value


# -- two arithmetics ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("shortcut", [True, False])
@pytest.mark.parametrize("make", [*SCENARIOS, lambda: ring(arms=5)])
def test_both_arithmetics_agree(make: Callable[[], Scenario], shortcut: bool, acceleration: float) -> None:
    task = limited(make(), acceleration=acceleration)
    rng, dt = np.random.default_rng(2), max(task.dt, 0.005)
    watched = SupervisionOptions(stiffness=2e4)
    loops = [loop_of(task, arithmetic=a, dt=dt, shortcut=shortcut, supervision=watched) for a in ARITHMETICS]
    q = None
    for i in range(120):
        done = [loop.step(q, None) for loop in loops]
        np.testing.assert_allclose(done[0].velocity, done[1].velocity, rtol=0.0, atol=1e-9, err_msg=f"step {i}")
        assert done[0].rate == pytest.approx(done[1].rate, abs=1e-8)
        assert done[0].status is done[1].status
        if i % 3 == 0:
            q = pin.integrate(task.cell.model, done[1].q_next, rng.uniform(-1e-5, 1e-5, task.cell.nv))


# -- what it computes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arithmetic", ARITHMETICS)
@pytest.mark.parametrize("make", [*SCENARIOS, lambda: ring(arms=5)])
def test_where_the_object_is_carried_and_how_it_moves(
    make: Callable[[], Scenario], arithmetic: str, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    """Poses are the grasp's, and Jacobians the twists about a point of those poses' changes."""
    task = make()
    cell, core, h = task.cell, core_of(loop_of(task, arithmetic=arithmetic)), 1e-6
    carried, jacobian, nothing = np.zeros(12 * len(cell)), np.zeros((cell.nv, 6)), np.zeros((cell.nv, 6))
    for _ in range(20):
        x, v, about = cell.positions(random_q(cell, rng)), rng.standard_normal(cell.nv), rng.standard_normal(3)
        core.linearise(x, about, carried, jacobian)
        expected = task.grasp.carried(CellState(cell, cell.configuration(x)))
        for one, O in zip(carried.reshape(-1, 12), expected, strict=True):
            np.testing.assert_allclose(one[:9].reshape(3, 3), O.rotation, rtol=0.0, atol=1e-13)
            np.testing.assert_allclose(one[9:], O.translation, rtol=0.0, atol=1e-13)
        ends = []
        for sign in (-1.0, 1.0):
            core.linearise(x + sign * h * v, about, carried, nothing)
            ends.append(carried.reshape(-1, 12).copy())
        point = pin.SE3(np.eye(3), about)
        for k, s in enumerate(cell.v_slices):
            before, after = (pin.SE3(e[k, :9].reshape(3, 3), e[k, 9:]) for e in ends)
            moved = pin.log6(point.inverse() * after * before.inverse() * point).vector / (2.0 * h)
            np.testing.assert_allclose(v[s] @ jacobian[s], moved, rtol=0.0, atol=1e-7)


def random_paths(rng: np.random.Generator) -> Iterator[ObjectPath]:
    for turn in (0.0, 1e-9, 1e-3, 1.0):
        for law in ("linear", "quintic"):
            poses = [pin.SE3.Random() for _ in range(2)]
            poses += [poses[1] * pin.exp6(np.concatenate([rng.standard_normal(3), turn * rng.standard_normal(3)]))]
            yield LinePath(poses[1], poses[2], duration=2.0, time_law=law)
            yield WaypointPath(poses, durations=[1.2, 0.8], time_law=law)
    yield HoldPath(pin.SE3.Random(), duration=2.0)
    servo = ServoPath(pin.SE3.Random(), speed=1.0, spin=2.0)
    servo.set_target(pin.SE3.Random(), clock=0.3)
    yield servo


@pytest.mark.parametrize("arithmetic", slow_but_first(ARITHMETICS))
def test_it_follows_paths_as_they_say(arithmetic: str, paper: Scenario, rng: np.random.Generator) -> None:
    pin.seed(5)
    for path in random_paths(rng):
        for clock in (0.3, 0.7, 1.195, 1.3, float(rng.uniform(0.3, 1.9))):
            loop = loop_of(paper, arithmetic=arithmetic, path=path, dt=0.01, preview=None)
            core = core_of(loop)
            core.start_path(clock, 1.0)
            core.observe(None, None)
            core.propose()
            pose, span = path.pose(clock), proposal(loop, "SPAN")
            assert 0.0 < span <= 0.01 + 1e-12  # less where the joints are slower than the path
            np.testing.assert_allclose(loop.at["pose"][:9].reshape(3, 3), pose.rotation, rtol=0.0, atol=1e-14)
            np.testing.assert_allclose(loop.at["pose"][9:], pose.translation, rtol=0.0, atol=1e-14)
            np.testing.assert_allclose(loop.at["along"], path.increment(clock, span), rtol=0.0, atol=1e-11)


class Shown(QpSolver):
    """ProxQP, that keeps the problems it is shown. It is the most exact solver."""

    name = "shown"

    def __init__(self) -> None:
        self.solver, self.problems = make_solver("proxqp"), list[QpProblem]()
        self.settings = self.solver.settings

    def solve(self, problem: QpProblem) -> QpSolution:
        copies = {f.name: getattr(problem, f.name).copy() for f in dataclasses.fields(problem)}
        self.problems.append(QpProblem(**copies))
        return self.solver.solve(problem)

    def _solve(self, problem: QpProblem, work: Any) -> Any:
        raise NotImplementedError("solve() asks ProxQP")

    def _forget(self) -> None:
        self.solver.reset()


def alike(a: QpProblem, b: QpProblem) -> None:
    """All is equal, for states that differ by rounding, but the bases of null-spaces: only their spans are."""
    close = {"rtol": 1e-7, "atol": 1e-7}
    for name in ("H", "g", "b", "l", "u", "lb", "ub"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), **close, err_msg=name)
    own = a.g.size - len(a.b)  # then those of joints that are led back
    for name in ("A", "C"):
        one, other = getattr(a, name), getattr(b, name)
        np.testing.assert_allclose(one[:, :9], other[:, :9], **close, err_msg=name)
        np.testing.assert_allclose(one[:, own:], other[:, own:], **close, err_msg=name)
    one, other = a.C[:, 9:own], b.C[:, 9:own]
    np.testing.assert_allclose(one @ one.T, other @ other.T, **close)


@pytest.mark.parametrize("arithmetic", ARITHMETICS)
def test_a_proposal_leaves_the_state_alone(arithmetic: str, paper: Scenario) -> None:
    """And a step moves it by the command."""
    task = limited(paper, velocity=0.1)
    loop = loop_of(task, arithmetic=arithmetic, dt=0.01)
    core = core_of(loop)
    kept = ("positions", "velocity", "before", "predicted", "drift", "correcting", "watch", "loop")
    for i in range(60):
        core.observe(None, None)
        before = {name: loop.at[name].copy() for name in kept}
        outcomes = {core.propose(), core.propose()}  # again, as after a veto
        assert len(outcomes) == 1
        for name in kept:
            np.testing.assert_array_equal(loop.at[name], before[name], err_msg=name)
        step = core.commit()
        np.testing.assert_array_equal(loop.at["velocity"], step.velocity)
        np.testing.assert_allclose(loop.at["positions"], before["positions"] + 0.01 * step.velocity, atol=1e-15)
        np.testing.assert_array_equal(loop.q, step.q_next)
        if i:
            np.testing.assert_array_equal(loop.at["before"], before["velocity"])
        assert loop.clock == step.clock_next


@pytest.mark.parametrize("arithmetic", ARITHMETICS)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_outside_its_limits_needs_a_qp(side: float, arithmetic: str, paper: Scenario) -> None:
    loop = loop_of(paper, arithmetic=arithmetic, dt=0.01)
    core = core_of(loop)
    core.observe(None, None)
    assert core.propose() == NOMINAL
    limits, x = paper.cell.limits, paper.q_start.copy()
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    (upper if side > 0.0 else lower)[4] = x[4] - side * 1e-6
    loop = loop_of(limited(paper, lower=lower, upper=upper), arithmetic=arithmetic, dt=0.01)
    core = core_of(loop)
    core.observe(None, None)
    assert core.propose() == QP
    assert proposal(loop, "OUTSIDE") == 1.0
    assert side * core.commit().velocity[4] <= 0.0


@pytest.mark.parametrize("arithmetic", ARITHMETICS)
@pytest.mark.parametrize(
    "angles",
    [{4: 0.0}, {2: 0.0}, dict.fromkeys(range(6), 0.0)],
    ids=["wrist", "elbow", "all"],
)
def test_a_singular_arm_is_answered_within_its_limits(
    angles: dict[int, float], arithmetic: str, paper: Scenario
) -> None:
    loop = loop_of(paper, arithmetic=arithmetic, preview=None)
    x = paper.q_start.copy()
    x[list(angles)] = list(angles.values())
    core_of(loop).start(x)
    core_of(loop).start_path(0.0, 1.0)
    step = loop.step(None, None)
    assert proposal(loop, "OUTCOME") in (RATE_SEARCH, QP)
    assert np.isfinite(step.velocity).all()
    assert np.abs(step.velocity).max() <= paper.cell.limits.velocity.max() + 1e-9


# -- numbers that are none ---------------------------------------------------------------------------------------------

#: What the core counts with: whole numbers, which only its own code writes.
COUNTS = {
    "arm_group", "q_index", "continuous", "history", "ahead", "lost", "travels",
}  # fmt: skip
HEADER = (ROOT / "coopqp" / "core" / "memory.h").read_text(encoding="utf-8")
#: Fields by their blocks, in their order.
BLOCKS = {
    block: re.findall(r"^    FIELD\([\w *]+, (\w+),", fields, re.MULTILINE)
    for block, fields in re.findall(r"^#define (\w+)_FIELDS\(FIELD\)(.*?)\n\n", HEADER, re.MULTILINE | re.DOTALL)
}


def numbers_of(struct: str) -> list[str]:
    """The members of a struct that are numbers, which come first."""
    body = re.sub(r"/\*.*?\*/", "", HEADER.partition(f"struct {struct} {{")[2].partition("\n};")[0], flags=re.DOTALL)
    lines = re.findall(r"^ *(\w+) (.*?);", body, re.MULTILINE)
    assert [kind for kind, _ in lines] == sorted((kind for kind, _ in lines), key=lambda kind: kind != "double")
    return [name for kind, names in lines if kind == "double" for name in names.split(", ")]


#: Fields that are structs, or many.
NAMED = {"options": "Options", "loop": "Loop", "watch": "Watch", "nodes": "Node"}


def places() -> Iterator[str]:
    """Every field of the constants and of the state, and every entry with a name."""
    for name in (*BLOCKS["CONFIG"], *BLOCKS["STATE"]):
        if name not in COUNTS:
            yield from [f"{name}/{number}" for number in numbers_of(NAMED[name])] if name in NAMED else [name]


def fill(loop: Any, place: str, value: float) -> None:
    name, _, entry = place.partition("/")
    if entry:
        count = loop.at["node_positions"].size // loop.cell.nv if name == "nodes" else 1
        loop.at[name].reshape(count, -1)[:, numbers_of(NAMED[name]).index(entry)] = value
    else:
        loop.at[name][:] = value


def safe(step: ControlStep, lower: Array, upper: Array) -> None:
    assert np.isfinite(step.velocity).all()
    assert np.isfinite(step.q_next).all()
    assert ((step.velocity >= lower - 1e-9) & (step.velocity <= upper + 1e-9)).all()
    assert 0.0 <= step.rate <= 1.0


@pytest.mark.parametrize("place", [*places()])
def test_a_number_that_is_none_is_never_commanded(place: str, paper: Scenario) -> None:
    """Wherever it stands: a step raises, asks for rows, or its command is finite and within the limits."""
    task = limited(paper, acceleration=10.0)
    speed = np.full(18, np.inf) if place == "speed" else task.cell.limits.velocity
    for arithmetic in ARITHMETICS:
        loop = loop_of(task, arithmetic=arithmetic, dt=0.005, supervision=SupervisionOptions(stiffness=2e4))
        q = None
        for _ in range(6):
            step = loop.step(q, None)
            q = step.q_next
        kept = {name: numbers.copy() for name, numbers in loop.at.items()}
        for value in (np.nan, np.inf, -np.inf, 1e300):
            for name, numbers in kept.items():
                loop.at[name][:] = numbers
            fill(loop, place, value)
            for measured in (None, q):
                try:
                    step = loop.step(measured, None)
                except ValueError:
                    break
                if step is None:
                    break
                safe(step, -speed, speed)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_measurement_that_is_none_holds(value: float, paper: Scenario) -> None:
    for arithmetic in ARITHMETICS:
        loop = loop_of(paper, arithmetic=arithmetic)
        for i in range(18):
            q = paper.q_start.copy()
            q[i] = value
            step = loop.step(q, None)
            assert step.status.name == "HOLDING"
            assert step.reason == f"joint {paper.cell.joint_names[i]} has no finite measured position"
            assert np.isfinite(step.velocity).all()
        assert loop.step(None, value).reason.startswith("dt is not accepted")


# -- memory and arguments ----------------------------------------------------------------------------------------------


#: Single numbers that rows of constraints read, and the structs that have them.
SINGLE = {"dt": "proposal", "quiet_slack": "loop", "quiet_approach": "loop", "quiet_ahead_slack": "loop"}
#: Arguments of a Core: arrays of the arms and the joints, then sizes.
Built = tuple[Any, ...]


def built(loop: Any) -> Built:
    """Arguments of a Core like the loop's own."""
    group, q_index, continuous = (loop.at[name].copy() for name in ("arm_group", "q_index", "continuous"))
    moves = np.zeros((len(loop.cell), loop.cell.nv))
    for k, columns in enumerate(moving_columns(loop.cell)):
        moves[k, columns] = 1.0
    return (moves.ravel(), group, q_index, continuous, loop.cell.nq, loop.at["unit"].size, 5, 64, False)


def core_with(arguments: Built, loop: Any) -> Any:
    """A core with the constants of a loop."""
    core = native.Core(*arguments)
    fields = core.fields()
    for name in BLOCKS["CONFIG"]:
        fields[name][:] = loop.at[name]
    return core


@pytest.mark.filterwarnings("ignore:nanobind:RuntimeWarning")
def test_a_core_is_built_once_and_before_it_is_used(paper: Scenario) -> None:
    arguments = built(loop_of(paper))
    core = native.Core(*arguments)
    with pytest.raises(TypeError):
        core.__init__(*arguments)
    raw = native.Core.__new__(native.Core)
    for call in (
        lambda: raw.step(None, None), lambda: raw.observe(None, None), lambda: raw.propose(), raw.commit,
        lambda: raw.advance(1, None), lambda: raw.start(np.zeros(18)),
        lambda: raw.start_path(0.0, 1.0), lambda: raw.bind(tell=None), raw.hold,
        lambda: raw.set_path(np.zeros(3), 1.0, False, False), raw.fields, lambda: raw.linearise(*[np.zeros(3)] * 4),
    ):  # fmt: skip
        with pytest.raises(TypeError):
            call()
    gc.collect()


def with_entry(things: tuple[Any, ...], i: int, thing: Any) -> tuple[Any, ...]:
    return (*things[:i], thing, *things[i + 1 :])


def test_sizes_that_do_not_fit_are_refused(paper: Scenario) -> None:
    arguments = built(loop_of(paper))
    for i, array in enumerate(arguments[:4]):
        for bad in (array[:-1].copy(), np.zeros(array.size + 1), np.zeros(0)):
            with pytest.raises(ValueError, match="fit"):
                native.Core(*with_entry(arguments, i, bad))
        for bad in (
            array.astype(np.float32), np.zeros(array.size, dtype=np.int64), np.zeros(2 * array.size)[::2],
            None, array.tolist(), b"", (0, 0),
        ):  # fmt: skip
            with pytest.raises((ValueError, TypeError, BufferError)):
                native.Core(*with_entry(arguments, i, bad))
    for i, bad in ((4, 17), (4, 37), (4, -1), (5, 8), (5, 10), (5, -9), (6, 0), (6, 10**9), (7, -1), (7, 10**9)):
        with pytest.raises(ValueError, match="fit"):
            native.Core(*with_entry(arguments, i, bad))
    for i in range(4, 8):
        for bad in (None, (), 2.5, 2**40):
            with pytest.raises((TypeError, OverflowError)):
                native.Core(*with_entry(arguments, i, bad))
    for bad in ((), arguments[:-1], (*arguments, 1)):
        with pytest.raises(TypeError):
            native.Core(*bad)


def test_fields_are_zero_at_first_and_do_not_overlap(paper: Scenario) -> None:
    fields = native.Core(*built(loop_of(paper))).fields()
    state = fields.pop("state")
    for name, struct in SINGLE.items():
        assert np.shares_memory(fields.pop(name), fields[struct])
    given = ("arm_group", "q_index", "continuous")
    assert not any(array.any() for name, array in fields.items() if name not in given)
    assert [*fields] == [name for block in BLOCKS.values() for name in block]
    for i, array in enumerate(fields.values()):
        array[:] = i
    assert all((array == i).all() for i, array in enumerate(fields.values()))
    for block, names in BLOCKS.items():
        assert all(np.shares_memory(fields[name], state) == (block == "STATE") for name in names if fields[name].size)


@pytest.mark.parametrize("make", [paper_lift, dual_arm7, lambda: ring(arms=5)])
def test_the_largest_least_distance_program_has_room(make: Callable[[], Scenario]) -> None:
    """All joints outside, all further rows soft, the chain may part: rows, bounds, multipliers, and 2 n (n + 3)."""
    fields = native.Core(*built(loop_of(make()))).fields()
    n, m = fields["x"].size, 2 * fields["command"].size + fields["further_owner"].size
    parted = 6 * fields["arm_group"].size  # unknowns where the chain may part
    assert fields["columns"].size == (m - fields["command"].size) * (fields["unit"].size + parted)
    assert fields["scratch"].size >= m * n + 2 * m + 2 * n + (m + n) + 2 * n * (n + 3)


@pytest.mark.parametrize(
    ("field", "value"),
    [("arm_group", 0.0), ("arm_group", 1.0), ("arm_group", 1e9), ("q_index", -1.0), ("q_index", 18.0),
     ("q_index", np.nan)],
)  # fmt: skip
def test_arms_that_do_not_lie_in_the_vectors_are_refused(field: str, value: float, paper: Scenario) -> None:
    arguments = built(loop_of(paper))
    which = ("moves", "arm_group", "q_index").index(field)
    for i in (0, -1):
        bad = arguments[which].copy()
        bad[i] = value
        with pytest.raises(ValueError, match="fit"):
            native.Core(*with_entry(arguments, which, bad))


def test_joints_that_do_not_fit_the_arms_are_refused(paper: Scenario) -> None:
    """An arm without joints, or without its own; joints of two arms that are no group, or after an arm's own."""
    arguments = built(loop_of(paper))
    moves, together = arguments[0].reshape(3, 18), np.zeros(3)
    none, all_of_one, both, late = (moves.copy() for _ in range(4))
    none[1] = 0.0
    all_of_one[:] = 1.0
    both[1, 0] = 1.0
    late[1, 5] = 1.0
    alone = arguments[1]
    wrong = ((none, alone), (all_of_one, together), (all_of_one, alone), (both, alone), (late, together))
    for bad, groups in wrong:
        with pytest.raises(ValueError, match="fit"):
            native.Core(bad.ravel(), groups, *arguments[2:])


def test_arguments_that_are_none_are_refused(paper: Scenario) -> None:
    """By an error of Python's, and the next step is as if nothing had been asked."""
    loop, other = loop_of(paper), loop_of(paper)
    core, q = core_of(loop), paper.q_start
    wrong: list[Any] = [q[:-1], q.astype(np.float32), q.tolist(), np.zeros(36)[::2], np.zeros((18, 2)), "q", 1.0, b"q"]
    for bad in wrong:
        for call in (
            lambda x=bad: core.start(x),
            lambda x=bad: core.advance(1, x), lambda x=bad: core.linearise(x, np.zeros(3), np.zeros(36), np.zeros(108)),
        ):  # fmt: skip
            with pytest.raises((ValueError, TypeError, BufferError)):
                call()
    for sizes in ((2, 36, 108), (3, 35, 108), (3, 36, 107)):
        with pytest.raises(ValueError, match="right length"):
            core.linearise(q, *(np.zeros(n) for n in sizes))
    frozen = np.zeros(36)
    frozen.flags.writeable = False
    with pytest.raises(TypeError):
        core.linearise(q, np.zeros(3), frozen, np.zeros(108))
    for call in (
        lambda: core.propose("one"), lambda: core.advance("one", None),
        lambda: core.advance(1, 2, 3),
        lambda: core.start_path("now", 1.0), lambda: core.start_path(0.0), lambda: core.bind(1),
    ):  # fmt: skip
        with pytest.raises(TypeError):
            call()
    statuses = decoding.STATUSES
    for bad in ((1, statuses), (ControlStep, ()), (ControlStep, [*statuses])):
        with pytest.raises(ValueError, match="a status of each code"):
            core.bind(**dict(zip(("step_type", "status_names"), bad, strict=True)))
    with pytest.raises(ValueError, match="nothing of that name"):
        core.bind(steps=None)
    core.bind(step_type=ControlStep, status_names=statuses)
    read_only = q.copy()
    read_only.flags.writeable = False
    assert core.linearise(read_only, np.zeros(3), np.zeros(36), np.zeros(108)) is None
    for _ in range(5):
        a, b = (one.step(read_only, None) for one in (loop, other))
        np.testing.assert_array_equal(a.velocity, b.velocity)


def test_paths_that_are_no_numbers_are_refused(paper: Scenario) -> None:
    core = core_of(loop_of(paper))
    good = paper.path.packed()
    for bad in (
        np.zeros(0), np.zeros(2), np.array([1.0, 0.0, 0.0]), good[:-1], np.array([1.0, 0.0, 1.0]),
        good.astype(np.float32),
        np.array([1.0, -1.0, 1.0, *good[3:]]), np.array([1.0, np.nan, 1.0, *good[3:]]), np.array([1.0, 0.0, np.nan]),
        np.array([1.0, 1e300, 1.0, *good[3:]]), np.array([1.0, 0.0, 1e300, *good[3:]]),
        np.array([1.0, 5.0, 1.0, *good[3:]]),
        None, "path",
    ):  # fmt: skip
        with pytest.raises((ValueError, TypeError)):
            core.set_path(bad, 1.0, False, False)
    core.set_path(good, paper.path.duration, True, False)  # the path that was refused has changed nothing
    core.bind(own_path=lambda clock, twist: False)
    core.set_path(np.array([1.0, 0.0, 0.0]), 1.0, False, True)
    assert core.step(None, None) is None or core.step(None, None).status.name == "HOLDING"


def test_motions_of_tools_that_are_no_numbers_are_refused(paper: Scenario) -> None:
    """Also ways of joints that end elsewhere than the numbers do, or belong to no arm."""
    core = core_of(loop_of(paper))
    still = [0.0, 0.0, 0.0, 1.0, *np.zeros(22)]  # no pieces, one contact
    way = [2.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0, 1.0, 0.0, 1.0, *np.zeros(24)]
    good = np.array([*still, 1.0, *way])
    for bad in (
        np.array(still), good[:-1], np.array([*good, 0.0]), np.array([*still, 2.0, *way]), np.array([*still, -1.0]),
        *(np.array([*still, 1.0, *way[:i], x, *way[i + 1 :]]) for i, x in ((0, 3), (0, np.nan), (6, 1), (6, 1e300))),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="no motion of tools"):
            core.set_grasps(bad)
    core.set_grasps(good)
    core.set_grasps(np.array([*still, 0.0]))
    core.set_grasps(None)


def test_steps_without_python_in_between_are_the_same(paper: Scenario) -> None:
    one, many = loop_of(paper, dt=0.005), loop_of(paper, dt=0.005)
    assert core_of(many).advance(50, None) == 50
    for _ in range(50):
        one.step(None, None)
    np.testing.assert_array_equal(one.q, many.q)
    assert one.clock == many.clock
    assert core_of(many).advance(0, None) == core_of(many).advance(-1, None) == 0


def test_a_loop_that_nobody_holds_is_freed(paper: Scenario) -> None:
    """It owns the core, which holds its methods."""
    loop = loop_of(paper)
    core_of(loop).bind(clear=loop._bound_node, further_rows=loop._bound_node, tightened=loop._bound_node)
    loop.step(None, None)
    known = weakref.ref(loop)
    del loop
    gc.collect()
    assert known() is None


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_functions_that_raise_count_as_failed_and_interrupts_end_the_call(paper: Scenario) -> None:
    core = core_of(loop_of(paper))
    for error, status in ((ValueError("no"), "HOLDING"), (KeyboardInterrupt(), None)):

        def own(clock: float, twist: int, error: BaseException = error) -> bool:
            raise error

        core.bind(own_path=own)
        core.set_path(np.array([1.0, 0.0, 0.0]), 1.0, False, True)
        if status is None:
            with pytest.raises(KeyboardInterrupt):
                core.step(None, None)
        else:
            assert core.step(None, None).status.name == status


def test_memory_lives_as_long_as_its_core_or_a_view(paper: Scenario) -> None:
    """The core keeps its memory: nothing else needs to. So does each view."""
    loop = loop_of(paper)
    core = core_with(built(loop), loop)
    core.set_path(paper.path.packed(), paper.path.duration, False, False)
    core.start(paper.q_start)
    core.start_path(0.0, 1.0)
    view = core.fields()["positions"]
    [np.full(100_000, np.nan) for _ in range(20)]  # would be written over what is free
    records = [core.step(None, None) for _ in range(5)]
    assert all(isinstance(record, bytes) for record in records)
    first = native.Record.NUMBERS
    assert all(np.isfinite(np.frombuffer(record)[first : first + 54]).all() for record in records)
    kept = view.copy()
    del core
    gc.collect()
    [np.full(100_000, np.nan) for _ in range(20)]
    np.testing.assert_array_equal(view, kept)
