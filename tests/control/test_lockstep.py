"""The compiled core and the plain definition are one controller: the same steps, with any input, on any path."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at, on_another_joint
from hypothesis import settings
from marks import slow_but_first, slow_unless
from runs import hurried, limited_once
from torsos import robot_of
from user_paths import Marked

from coopqp import (
    ControlStep,
    HoldPath,
    LimitKind,
    LinePath,
    ObjectPath,
    PostureOptions,
    PreviewOptions,
    QPController,
    QPOptions,
    RobotCell,
    ServoPath,
    Status,
    SupervisionOptions,
    WaypointPath,
    check_path,
)
from coopqp.collision import Body, Box, Clearance, CollisionScene, Sphere
from coopqp.control import RankWeights
from coopqp.model import CellState
from coopqp.native import available_kernels
from coopqp.scenarios import (
    LOADED,
    PROGRAMS,
    SCENARIOS,
    Scenario,
    at_limit,
    at_singularity,
    dual_arm7,
    mixed_cell,
    paper_lift,
    ring,
    scenario,
)
from coopqp.spatial import Array

if "compiled" not in available_kernels():
    pytest.skip("there is no compiled core here", allow_module_level=True)

#: Largest difference of joint velocities [rad/s or m/s].
SAME = 1e-9
#: The same at a stop: there the rate is the root of what rounding leaves.
SAME_AT_REST = 1e-8
#: The same in fast turns and near singularities.
DISTURBED = 5e-8
#: A step hands on by how much the last ones differed, magnified where the rate falls to what the slowest joint can do.
MAGNIFIED = 2.0
#: Nothing may grow beyond this in a run [rad/s or m/s].
GROWN = 1e-6
#: What one sample of a run feeds to a step: the measured configuration (nq,) or None, and dt.
Inputs = Callable[[int, list[Array]], tuple[Any, Any]]


def pair(task: Scenario, *, path: Callable[[], ObjectPath] | None = None, dt: float = 0.0, **options: Any) -> Pair:
    """The compiled controller and the plain one, at the start of the scenario."""
    made = []
    for kernel in ("compiled", "plain"):
        given = QPOptions(kernel=kernel, **options)
        follow = task.path if path is None else path()
        made.append(QPController(task.cell, task.grasp, follow, dt=dt or task.dt, options=given))
    assert made[0].kernel == "compiled", "the core leaves this robot to the plain definition: nothing is compared"
    for controller in made:
        controller.reset(task.q_start)
    return Pair(*made)


@dataclasses.dataclass
class Pair:
    """Two controllers that have to agree."""

    compiled: QPController
    plain: QPController
    same: float = SAME
    told: list[Array] = dataclasses.field(default_factory=list)
    seen: set[Status] = dataclasses.field(default_factory=set)
    lowest: float = 1.0
    made: list[tuple[ControlStep, ControlStep]] = dataclasses.field(default_factory=list)
    parted: tuple[float, float] = (0.0, 0.0)

    def step(self, q: Any = None, dt: Any = None) -> ControlStep:
        """One step of both, compared."""
        step = self.take(q, dt)
        self.compare()
        return step

    def run(self, steps: int, inputs: Inputs | None = None) -> Pair:
        """Steps until the path ends, or so many; then all of them are compared."""
        for i in range(steps):
            q, dt = (None, None) if inputs is None else inputs(i, self.told)
            if self.take(q, dt).finished:
                break
        self.compare()
        return self

    def both(self, call: Callable[[QPController], None]) -> None:
        call(self.compiled)
        call(self.plain)

    def take(self, q: Any = None, dt: Any = None) -> ControlStep:
        """One step of both, to be compared with the others later."""
        a, b = self.compiled.step(q, dt=dt), self.plain.step(q, dt=dt)
        self.made.append((a, b))
        self.told.append(b.q_next)
        return b

    def compare(self) -> None:
        """Compare the steps that were made since the last time."""
        if not self.made:
            return
        (one, other), same = zip(*self.made, strict=True), self.same
        self.made = []
        rates = [b.rate for b in other]
        inherited = self._inherited(one, other)
        near = np.where(np.array(rates) < 1e-6, max(same, SAME_AT_REST), same) + inherited
        same = same + inherited
        self._near(one, other, "velocity", near[:, None])
        self._near(one, other, "q_next", same[:, None])
        self._near(one, other, "commanded_apart", 10.0 * same)
        for name in ("rate", "clock_next"):
            self._near(one, other, name, 100.0 * same)
        for name in ("status", "cause", "binding", "reason", "dt"):
            mine, its = ([getattr(step, name) for step in steps] for steps in (one, other))
            assert mine == its, self.where(one, other, [x != y for x, y in zip(mine, its, strict=True)], name)
        for name in ("rate", "clock", "clock_next", "dt", "finished"):  # a recording writes them as JSON
            mine, its = ([type(getattr(step, name)) for step in steps] for steps in (one, other))
            assert mine == its, self.where(one, other, [x is not y for x, y in zip(mine, its, strict=True)], name)
        one_lost, its_lost = ([step.given_up for step in steps] for steps in (one, other))
        self._near(one_lost, its_lost, "off_path", same[:, None], one, other)
        for name in ("rate", "grasp", "path", "chain"):
            self._near(one_lost, its_lost, name, 1e4 * same, one, other)
        self.seen.update(b.status for b in other)
        self.lowest = min(self.lowest, *rates)

    def _inherited(self, one: Sequence[ControlStep], other: Sequence[ControlStep]) -> Array:
        """What each step may differ by because the last one did: a joint at its limit makes up in one step for what its
        positions differ by."""
        turn = np.array([0.0, *(np.abs(a.velocity - b.velocity).max() for a, b in zip(one, other, strict=True))])
        place = np.array([0.0, *(np.abs(a.q_next - b.q_next).max() for a, b in zip(one, other, strict=True))])
        turn[0], place[0] = self.parted
        self.parted = turn[-1], place[-1]
        handed = MAGNIFIED * turn[:-1] + place[:-1] / np.array([step.dt for step in other])
        return np.minimum(handed, GROWN)

    def _near(self, mine: Sequence[Any], its: Sequence[Any], name: str, near: Any, *steps: Sequence[Any]) -> None:
        """The numbers of that name differ by so much at most; of a number that is none no comparison is true."""
        a, b = (np.array([getattr(x, name) for x in both]) for both in (mine, its))
        close = np.abs(a - b) <= near
        assert close.all(), self.where(*(steps or (mine, its)), ~close.reshape(len(close), -1).all(axis=1), name)

    def where(self, one: Sequence[ControlStep], other: Sequence[ControlStep], apart: Any, what: str) -> str:
        """The first step of which ``apart`` is true, in words."""
        i = int(np.argmax(apart))
        return f"step {len(self.told) - len(one) + i}, {what}: {one[i].explain()} / {other[i].explain()}"


#: A ready scenario, built once.
ready = functools.cache(scenario)


def coarse(task: Scenario) -> float:
    """A step with which 250 steps cover the scenario's path [s]."""
    return float(np.clip(task.path.duration / 200.0, task.dt, 0.01))


# -- the inputs of a run ---------------------------------------------------------------------------------------------


def noisy(cell: RobotCell, *, size: float = 1e-4, late: int = 1) -> Inputs:
    """Measured with noise, some samples late."""
    rng = np.random.default_rng(0)

    def give(i: int, told: list[Array]) -> tuple[Any, Any]:
        if len(told) <= late:
            return None, None
        return pin.integrate(cell.model, told[-1 - late], rng.uniform(-size, size, cell.nv)), None

    return give


def lagging(cell: RobotCell, samples: int = 3) -> Inputs:
    """The last arm is some samples behind the others."""

    def give(i: int, told: list[Array]) -> tuple[Any, Any]:
        if len(told) <= samples:
            return None, None
        q, last = told[-1].copy(), cell.q_slices[-1]
        q[last] = told[-1 - samples][last]
        return q, None

    return give


def stalling(cell: RobotCell, when: int = 60, until: int = 10**9) -> Inputs:
    """The first arm stands from one sample on, until another."""
    kept: list[Array] = []

    def give(i: int, told: list[Array]) -> tuple[Any, Any]:
        if not told:
            return None, None
        q, first = told[-1].copy(), cell.q_slices[0]
        if when <= i < until:
            kept.append(q[first].copy())
            q[first] = kept[0]
        return q, None

    return give


def dropping(cell: RobotCell) -> Inputs:
    """Samples are lost: all of them for a few steps, or those of one arm."""
    rng, kept = np.random.default_rng(3), []

    def give(i: int, told: list[Array]) -> tuple[Any, Any]:
        if not told or rng.uniform() < 0.2:
            return None, None
        q = pin.integrate(cell.model, told[-1], rng.uniform(-1e-5, 1e-5, cell.nv))
        if kept and rng.uniform() < 0.3:
            arm = cell.q_slices[int(rng.integers(len(cell)))]
            q[arm] = kept[-1][arm]
        kept.append(q)
        return q, None

    return give


def corrupted(cell: RobotCell) -> Inputs:
    """Some samples are no numbers, no configurations, or far off."""
    rng = np.random.default_rng(4)

    def give(i: int, told: list[Array]) -> tuple[Any, Any]:
        if not told:
            return None, None
        q = told[-1].copy()
        far = q + 1.0 + np.arange(cell.nq)
        bad = [np.full(cell.nq, np.nan), "nonsense", q[:3], far, [*q[:-1], np.inf], q.astype(complex)]
        if i % 9 == 8:
            return bad[i // 9 % 6], None
        if i % 9 == 4:
            q[int(rng.integers(cell.nq))] += 10.0 ** rng.uniform(-5.0, 0.0)
        return (q.tolist() if i % 9 == 1 else q), None

    return give


def uneven(cell: RobotCell, nominal: float) -> Inputs:
    """Steps of varying length, some of them out of range."""
    rng = np.random.default_rng(5)

    def give(i: int, told: list[Array]) -> tuple[Any, Any]:
        bad = {10: np.nan, 11: -1.0, 12: 0.0, 13: 1e9, 30: "soon", 31: np.inf, 32: 6.0 * nominal, 33: 0.05 * nominal}
        dt = bad.get(i % 60, nominal * float(rng.uniform(0.2, 3.0)))
        return (None if i % 3 else told[-1] if told else None), dt

    return give


def two_arms() -> Scenario:
    """The smallest ring."""
    return ring(arms=2)


#: Straight up, two arms would meet the same limit at once, and rounding would choose the one that is named.
ASKEW = at_limit(direction=(0.1, 0.05, 1.0))
MODES: dict[str, tuple[dict[str, Any], Callable[[Scenario, float], Inputs | None]]] = {
    "nominal": ({}, lambda t, dt: None),
    "measured late, with noise": ({}, lambda t, dt: noisy(t.cell)),
    "one arm lags": ({}, lambda t, dt: lagging(t.cell)),
    "an arm stalls": ({}, lambda t, dt: stalling(t.cell)),
    "an arm stalls for a while": ({}, lambda t, dt: stalling(t.cell, until=90)),
    "forces watched": (
        {"supervision": SupervisionOptions(stiffness=2e4, servo_delay=0.01)},
        lambda t, dt: noisy(t.cell, size=2e-4),
    ),
    "forces watched, an arm stalls": (
        {"supervision": SupervisionOptions(stiffness=2e4, slow_from=None, stall_samples=None)},
        lambda t, dt: stalling(t.cell),
    ),
    "always a QP": ({"shortcut": False}, lambda t, dt: None),
    "always a QP, measured": ({"shortcut": False}, lambda t, dt: noisy(t.cell)),
    "samples lost": ({}, lambda t, dt: dropping(t.cell)),
    "samples corrupted": ({}, lambda t, dt: corrupted(t.cell)),
    "uneven steps": ({}, lambda t, dt: uneven(t.cell, dt)),
    "no preview": ({"preview": None}, lambda t, dt: None),
    "short-sighted": ({"preview": PreviewOptions(newton_steps=2)}, lambda t, dt: None),
    "no watch of distances": (
        {"supervision": SupervisionOptions(slow_from=None, recovery_time=0.0)}, lambda t, dt: stalling(t.cell)
    ),
    "no drift let in": ({"supervision": SupervisionOptions(let_in=0.0)}, lambda t, dt: lagging(t.cell)),
    "corrections at their bound": ({"correction_speed": 1e-7, "correction_spin": 1e-7}, lambda t, dt: None),
    "large gains": ({"grasp_gain": 500.0, "path_gain": 0.0}, lambda t, dt: noisy(t.cell)),
    "middle of the joints": (
        {"posture": PostureOptions(gain=0.5, centring=0.3, manipulability=0.1)}, lambda t, dt: None
    ),
}  # fmt: skip


#: Modes that show the most.
IN_SHORT = ("nominal", "measured late, with noise", "an arm stalls for a while", "always a QP")


def run_in(mode: str, task: Scenario, steps: int = 250, same: float = SAME) -> Pair:
    options, inputs = MODES[mode]
    dt = coarse(task)
    run = pair(task, dt=dt, **options)
    run.same = same
    return run.run(steps, inputs(task, dt))


@pytest.mark.core
@pytest.mark.parametrize("mode", IN_SHORT)
def test_both_agree_in_short(mode: str) -> None:
    for name in ("paper_lift", "mixed_cell"):
        run_in(mode, ready(name), 120)
    if "stalls" not in mode:
        assert run_in(mode, ASKEW, 150).seen >= {Status.SLOWED}


#: What a mode shows within 70 steps, beside tracking.
SHOWS = {"one arm lags": Status.SLOWED, "no drift let in": Status.SLOWED, "samples corrupted": Status.HOLDING}
SHOWS |= dict.fromkeys(("uneven steps", "an arm stalls", "no watch of distances"), Status.HOLDING)
SHOWS |= {"forces watched, an arm stalls": Status.HOLDING}


@pytest.mark.core
@pytest.mark.parametrize("mode", [mode for mode in MODES if mode not in IN_SHORT])
def test_both_agree_for_a_moment(mode: str) -> None:
    acceleration = 5.0 if list(MODES).index(mode) % 2 else np.inf
    seen = run_in(mode, limited_once(two_arms, acceleration), 70, same=DISTURBED).seen
    assert SHOWS.get(mode, Status.TRACKING) in seen


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 8.0])
def test_both_agree_with_all_settings_changed(acceleration: float) -> None:
    """A setting that only one of them takes would part them."""
    task = hurried(limited_once(dual_arm7, acceleration), 0.8)
    watch = SupervisionOptions(
        slow_from=2e-4, hold_from=9e-4, let_in=1e-3, noise_margin=2.0, recovery_time=0.05, filter_time=4e-3,
        stall_samples=3, stall_share=0.3, silent_time=0.02, dt_range=(0.4, 2.0), joint_jump=0.1, apart_from=1e-3,
        stiffness=tuple(np.linspace(2e3, 4e4, task.cell.nv)), force_limit=400.0, servo_delay=5e-3,
    )  # fmt: skip
    weights = RankWeights(
        chain=1e7, off_path=2e4, recovery=5e5, grasp=2.0, path=3e-2, rate=2e-4, posture=4e-6, length=0.2
    )
    run = pair(
        task, dt=0.006, supervision=watch, weights=weights, shortcut=False, grasp_gain=12.0, path_gain=7.0,
        correction_speed=0.02, correction_spin=0.05, measurement_time=0.03, blocked_rate=5e-3,
        posture=PostureOptions(gain=0.7, centring=0.2, manipulability=0.05, speed_share=0.1),
        preview=PreviewOptions(cell=0.04, joint_step=0.08, margin=0.85, rate_slope=6.0, curvature_share=0.6),
        off_path_distance=2e-4, off_path_angle=1e-3,
    )  # fmt: skip
    run.same = DISTURBED
    given = noisy(task.cell, size=4e-4)
    run.both(lambda c: c.set_override(0.9))
    for i in range(60):
        q, _ = given(i, run.told)
        if i == 40 and q is not None:
            q[0] += 0.15  # not believed
        run.take(q, {20: 0.002, 21: 0.0025, 22: 0.013, 23: 0.0119}.get(i))
    run.compare()
    assert run.seen >= {Status.HOLDING, Status.SLOWED}
    assert run.lowest < 0.9


@pytest.mark.core
@pytest.mark.parametrize("preview", [None, PreviewOptions()], ids=["blind", "looking ahead"])
def test_both_stop_ahead_of_a_limit(preview: PreviewOptions | None) -> None:
    task = hurried(dataclasses.replace(ASKEW, cell=ASKEW.cell.with_limits(acceleration=3.0)), 1.5)
    run = pair(task, dt=0.01, preview=preview)
    run.same = DISTURBED
    run.run(70)
    assert Status.SLOWED in run.seen
    assert run.lowest < 0.5


@pytest.mark.core
def test_both_take_measurements_of_any_kind_of_array() -> None:
    """Lists, other numbers, arrays that are strided: what is measured is the same."""
    task = limited_once(two_arms, np.inf)
    run = pair(task, dt=0.01)
    kinds: list[Callable[[Array], Any]] = [
        list, tuple, np.float32, lambda q: np.repeat(q, 2)[::2], np.asfortranarray, lambda q: [*q, 0.0],
        lambda q: "far", lambda q: q.astype(object), lambda q: q[:-1], lambda q: q[None], lambda q: q[:, None],
    ]  # fmt: skip
    for kind in kinds:
        step = run.take()
        away = task.cell.moved(step.q_next, np.full(task.cell.nv, 1e-4))
        given = kind(away)
        run.take(given)
    run.compare()
    assert Status.HOLDING in run.seen


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.core
@pytest.mark.parametrize("solver", ["ldp", "daqp"])
def test_both_agree_with_another_solver_while_joints_are_led_back(solver: str) -> None:
    task = halfway(limited_once(two_arms, np.inf), until=0.1)
    limits, q = task.cell.limits, task.cell.positions(task.q_start)
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[8] = q[1] + 2e-3, q[8] - 5e-3
    cell = task.cell.with_limits(lower=lower, upper=upper, velocity=np.minimum(limits.velocity, 1.0))
    run = pair(dataclasses.replace(task, cell=cell), dt=0.005, solver=solver, shortcut=False)
    run.same = 1e-7
    run.run(20)
    assert (cell.positions(run.told[0]) < lower).any()


def lead(controller: QPController, i: int) -> None:
    """The hand that leads the object moves askew."""
    controller.target(pin.SE3(np.eye(3), 3e-4 * i * np.ones(3)))


def belt(controller: QPController, i: int) -> None:
    """The belt goes faster than it was told to."""
    controller.gear(0.006 * i, speed=0.4)


UP = np.array([0.0, 0.0, 0.05, 0.0, 0.1, 0.0])
#: Calls of an operator by the number of the step ahead of which each is made.
ASKED: dict[str, dict[int, Callable[[QPController], Any]]] = {
    "pause and resume": {20: lambda c: c.pause(), 45: lambda c: c.resume(), 60: lambda c: c.set_override(0.3)},
    "back and on": {25: lambda c: c.reverse(0.02), 60: lambda c: c.forward()},
    "to a clock and back": {10: lambda c: c.run_to(0.2), 50: lambda c: c.run_to(0.1)},
    "by hand and back": {
        10: lambda c: c.pause(), **{i: lambda c: c.jog(UP, frame="world") for i in range(25, 50, 5)},
        65: lambda c: c.return_to_path(),
    },
    "led by a hand": {
        **{0: lambda c: c.engage(pin.SE3.Identity())},
        **{i: functools.partial(lead, i=i) for i in range(5, 35, 5)},
        60: lambda c: c.release(),
    },
    "with a belt": {i: functools.partial(belt, i=i) for i in range(5, 60, 2)},
    "aside": {15: lambda c: c.shift_path(pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.01])), np.array([0.0, 2e-3, 0.0])))},
}  # fmt: skip


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([8.0, np.inf]))
@pytest.mark.parametrize("calls", ASKED)
def test_both_do_what_an_operator_asks_for(calls: str, acceleration: float) -> None:
    run = pair(hurried(limited_once(two_arms, acceleration), 1.5), dt=0.01)
    run.same = DISTURBED
    for i in range(75):
        if i in ASKED[calls]:
            run.both(ASKED[calls][i])
        run.take()
        if i == 40:
            run.compiled, run.plain = copy.deepcopy(run.compiled), copy.deepcopy(run.plain)
    run.compare()
    assert run.lowest < 0.5 or calls == "aside"


#: Cells of other robots, whose meshes are read.
OTHER_ROBOTS = ("panda_bar", "ur5_table")


@pytest.mark.parametrize(
    "name", slow_unless(lambda name: name not in OTHER_ROBOTS, sorted(set(SCENARIOS) - set(LOADED)))
)
def test_the_core_takes_every_cell(name: str) -> None:
    task = ready(name)
    assert QPController(task.cell, task.grasp, task.path, dt=task.dt).kernel == "compiled"


#: Whether every scenario meets every mode.
NIGHTLY = settings.get_current_profile_name() == "nightly"
#: Cells that always do.
IN_FULL = ("paper_lift", "mixed_cell", "dual_arm7", "at_limit")


def every_run() -> Iterator[Any]:
    """Each scenario that the core takes with each mode; of most a third of the modes in turn, all of them at night.

    Sanitized: those in three cells that it has not in short.
    """
    for i, name in enumerate(sorted(set(SCENARIOS) - {*LOADED, *PROGRAMS})):
        for k, mode in enumerate(MODES):
            if name in IN_FULL or (i + k) % 3 == 0 or NIGHTLY:
                sanitized = name in ("paper_lift", "mixed_cell", "at_limit") and mode not in IN_SHORT
                yield pytest.param(name, mode, marks=[pytest.mark.core] if sanitized else [])


def limited_runs() -> Iterator[Any]:
    """Three cells in each mode, with one of two accelerations in turn; at night with both."""
    for i, make in enumerate((paper_lift, dual_arm7, mixed_cell)):
        for k, mode in enumerate(MODES):
            for acceleration in (5.0, 10.0) if NIGHTLY else ((5.0, 10.0)[(i + k) % 2],):
                yield pytest.param(make, mode, acceleration, id=f"{make.__name__}-{mode}-{acceleration}")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mode"), [*every_run()])
def test_both_agree_on_every_scenario(name: str, mode: str) -> None:
    if name != "at_limit":
        run_in(mode, ready(name), 250)
        return
    seen = run_in(mode, ASKEW, 150).seen
    assert seen >= {Status.SLOWED} or "stalls" in mode or "bound" in mode


@pytest.mark.slow
@pytest.mark.parametrize(("make", "mode", "acceleration"), [*limited_runs()])
def test_both_agree_under_acceleration_limits(make: Callable[[], Scenario], mode: str, acceleration: float) -> None:
    run_in(mode, limited_once(make, acceleration), 150 if "corrupted" in mode else 250, same=DISTURBED)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([5.0, 10.0]))
def test_both_agree_under_acceleration_limits_in_short(acceleration: float) -> None:
    for mode in IN_SHORT:
        run_in(mode, limited_once(mixed_cell, acceleration), 100)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_both_agree_with_other_settings_of_the_preview(acceleration: float) -> None:
    """A gentler rise of the rate, more in reserve: the object starts later than with the defaults, in both alike."""
    task = limited_once(paper_lift, acceleration)
    other = pair(task, dt=0.01, preview=PreviewOptions(rate_slope=3.0, margin=0.8, doubt=0.1, curvature_share=0.4))
    other.run(100)
    usual = pair(task, dt=0.01)
    usual.run(100)
    if np.isfinite(acceleration):
        assert other.plain.step().clock < usual.plain.step().clock


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wrist", "elbow", "reach"])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_both_agree_at_singularities(kind: Any, acceleration: float) -> None:
    task = at_singularity(kind, 1, acceleration=acceleration)
    run = pair(task, dt=0.005)
    run.same = DISTURBED  # joints turn fast there
    assert run.run(600).lowest < 0.1 or kind == "wrist"
    near = pair(at_singularity("wrist", 2, miss=0.01, acceleration=acceleration), dt=0.005)
    near.same = DISTURBED
    near.run(600)


@pytest.mark.core
@pytest.mark.slow
def test_a_mark_beside_a_singularity_ends_the_way_past_it() -> None:
    """What comes after a mark is not known before it: no way past the pole of a wrist leads over one."""
    task = at_singularity("wrist", 2, miss=5e-4, acceleration=10.0)
    for mark, passes in ((np.inf, True), (0.7487, False)):
        run = pair(task, path=lambda mark=mark: Marked(task.path, mark=mark * task.path.duration), dt=0.01)
        run.same = DISTURBED
        step = run.run(400).plain.step()
        assert step.finished == passes
        assert (step.rate == 0.0 and step.binding[0].kind is LimitKind.SINGULARITY) != passes


# -- the judge -------------------------------------------------------------------------------------------------------


def more(array: Array, by: float) -> Array:
    return array + by * (np.arange(array.size) == 3)


#: Changes of one step, each just beyond what may differ.
LIES: list[dict[str, Callable[[Any], Any]]] = [
    {"velocity": lambda v: more(v, 1.1 * SAME)}, {"velocity": lambda v: more(v, np.nan)},
    {"q_next": lambda q: more(q, 1.1 * SAME)}, {"rate": lambda r: r - 110.0 * SAME}, {"rate": np.float64},
    {"clock_next": lambda t: t + 110.0 * SAME}, {"clock": np.float64}, {"dt": lambda dt: np.nextafter(dt, 1.0).item()},
    {"status": lambda status: Status.SLOWED}, {"reason": lambda reason: "for fun"}, {"binding": lambda b: (*b, "")},
    {"given_up": lambda g: dataclasses.replace(g, off_path=(0.0, 0.0, 0.0, 1.1 * SAME, 0.0, 0.0))},
    *(
        {"given_up": lambda g, name=name: dataclasses.replace(g, **{name: 1.1e4 * SAME})}
        for name in ("rate", "grasp", "path", "chain")
    ),
]  # fmt: skip


@pytest.mark.parametrize("lie", LIES, ids=lambda lie: next(iter(lie)))
def test_a_step_that_differs_is_seen(lie: dict[str, Callable[[Any], Any]]) -> None:
    run = pair(ready("paper_lift"), dt=0.01).run(3)
    for _ in range(3):
        run.take()
    a, b = run.made[1]
    run.made[1] = a, b.replaced(**{name: change(getattr(b, name)) for name, change in lie.items()})
    with pytest.raises(AssertionError, match="step 4, "):
        run.compare()


# -- cells -----------------------------------------------------------------------------------------------------------


def held(cell: RobotCell, q: Array) -> Scenario:
    """The arms hold one object where they happen to be."""
    start = CellState(cell, q).T_world_tool[0]
    path = LinePath.displaced(start, translation=(0.01, -0.02, 0.015), rotation=(0.03, 0.02, -0.05), duration=2.0)
    return Scenario("held", cell, grasp_at(cell, q), path, q, 0.01)


ROBOTS = [
    ("rx90l",), ("arm7",), ("arm6c",), ("gantry7",), ("arm6c", "gantry7", "rx90l"), ("arm6c", "arm6c"),
    ("arm7", "arm7", "arm7"), ("gantry7", "arm7", "arm6c", "rx90l"),
]  # fmt: skip


@pytest.mark.core
@pytest.mark.parametrize("robots", slow_unless(lambda robots: robots is ROBOTS[0], ROBOTS), ids="-".join)
def test_both_agree_on_any_joints(
    robots: tuple[str, ...], make_cell: Callable[..., RobotCell], random_q: Callable[..., Array]
) -> None:
    cell = make_cell(robots)
    task = held(cell, random_q(cell, np.random.default_rng(3)))
    for mode in ("nominal", "measured late, with noise", "always a QP"):
        run_in(mode, task, 80)


@pytest.mark.core
def test_both_agree_on_eight_joints(random_q: Callable[..., Array]) -> None:
    beside = [pin.SE3(np.eye(3), np.array([0.0, 1.1 * k, 0.0])) for k in range(2)]
    rail, table = pin.JointModelPY(), pin.JointModelRZ()
    cell = RobotCell([on_another_joint("0", rail, beside[0]), on_another_joint("1", table, beside[1])])
    assert cell.nv == 16
    for mode in ("nominal", "measured late, with noise", "always a QP", "middle of the joints"):
        run_in(mode, held(cell, random_q(cell, np.random.default_rng(6))), 80)


#: Joints that two arms of six joints share: kind and axis of each.
TORSOS = {
    "lift": (("prismatic", "0 0 1"),),
    "waist": (("revolute", "0 0 1"),),
    "lift and turntable": (("prismatic", "0 0 1"), ("continuous", "0 0 1")),
    "three of a waist": (("revolute", "1 0 0"), ("continuous", "0 1 0"), ("revolute", "0 0 1")),
}
#: How they are stepped, and with which accelerations.
ON_TORSOS = (
    ("nominal", np.inf), ("nominal", 5.0), ("always a QP", 5.0), ("measured late, with noise", np.inf),
    ("an arm stalls for a while", 5.0), ("samples lost", np.inf), ("no preview", 5.0), ("middle of the joints", np.inf),
    ("forces watched", 5.0), ("forces watched, an arm stalls", np.inf),
)  # fmt: skip


def on_a_torso(torso: str, folder: Path, acceleration: float = np.inf, *, beside: bool = False) -> Scenario:
    """Two arms that share joints hold an object where they happen to be; with a third arm of its own, or without."""
    rng, robot = np.random.default_rng(len(torso)), robot_of(TORSOS[torso], folder)
    cell = RobotCell([on_another_joint("0", pin.JointModelRZ(), pin.SE3.Identity()), robot] if beside else [robot])
    cell = cell.with_limits(acceleration=acceleration)
    return held(cell, cell.configuration(rng.uniform(-0.6, 0.6, cell.nv) + 0.3))


@pytest.mark.core
@pytest.mark.parametrize("how", slow_but_first(ON_TORSOS))
@pytest.mark.parametrize("torso", TORSOS)
def test_both_agree_on_joints_that_arms_share(torso: str, how: tuple[str, float], tmp_path: Path) -> None:
    mode, acceleration = how
    run_in(mode, on_a_torso(torso, tmp_path, acceleration), 100, same=DISTURBED if np.isfinite(acceleration) else SAME)


@pytest.mark.core
@pytest.mark.parametrize("torso", TORSOS)
def test_a_sample_that_is_sent_again_is_lost_to_arms_that_share_joints_unless_these_move(
    torso: str, tmp_path: Path
) -> None:
    """An arm far off is a fault in the second sample that is new: three that repeat to the last bit are none."""
    task = on_a_torso(torso, tmp_path)
    watch = SupervisionOptions(joint_jump=2.0, stall_samples=None, noise_margin=0.0)
    for moving in (None, *range(len(TORSOS[torso]))):
        run = pair(task, dt=0.01, supervision=watch).run(10, noisy(task.cell, size=1e-9))
        x, found = task.cell.positions(run.told[-1]), []
        x[task.cell.v_slices[1]] += 0.1
        for _ in range(6):
            if moving is not None:
                x[moving] += 1e-9
            found.append(run.take(task.cell.configuration(x)).status is Status.FAULT)
        run.compare()
        assert found.index(True) == (4 if moving is None else 1)


@pytest.mark.core
@pytest.mark.parametrize(
    "mode", slow_but_first(["nominal", "forces watched, an arm stalls", "always a QP", "one arm lags", "no preview"])
)
def test_both_agree_on_a_group_beside_an_arm(mode: str, tmp_path: Path) -> None:
    task = on_a_torso("lift", tmp_path, beside=True)
    assert task.cell.groups == ((1, 2),)
    run_in(mode, task, 80)


@pytest.mark.core
def test_both_agree_where_an_arm_is_singular_and_its_group_is_not(tmp_path: Path) -> None:
    """The torso's three joints do what the left arm cannot; the object does not wait for it."""
    task = on_a_torso("three of a waist", tmp_path)
    q = task.cell.positions(task.q_start)
    q[task.cell.joint_names.index("left/left_4")] = 0.0  # the axes before and after it are one line
    run = pair(held(task.cell, task.cell.configuration(q)), dt=0.01)
    run.same = DISTURBED  # joints turn fast there
    assert run.run(120).lowest == 1.0


@pytest.mark.core
@pytest.mark.parametrize("mode", ["nominal", "measured late, with noise", "always a QP", "no preview"])
@pytest.mark.parametrize("acceleration", [5.0, np.inf])
def test_both_agree_on_a_rail_under_arms_of_seven_joints(mode: str, acceleration: float) -> None:
    task = ready("two_on_a_rail")
    task = dataclasses.replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    assert task.cell.nv == 15
    run_in(mode, task, 50, same=DISTURBED if np.isfinite(acceleration) else SAME)


@pytest.mark.slow
@pytest.mark.core
def test_both_agree_where_a_group_evades_a_body() -> None:
    """A lid above two arms on a rail; each arm's self-motion keeps its elbow off it, and the rail stays out of that."""
    task = ready("two_on_a_rail")
    cell = task.cell.with_limits(acceleration=5.0)
    place = task.path.pose(0.0).translation + np.array([0.0, 0.0, 0.25])
    lid = Body("lid", Box((0.6, 0.6, 0.02)), pin.SE3(np.eye(3), place))
    scene = dataclasses.replace(CollisionScene.of(task, margin=0.02, obstacles=[lid]), cell=cell)
    made = []
    for kernel in ("compiled", "plain"):
        options, clearance = QPOptions(kernel=kernel), Clearance(scene)
        made.append(QPController(cell, task.grasp, task.path, dt=0.01, options=options, constraints=[clearance]))
        made[-1].reset(task.q_start)
    assert made[0].kernel == "compiled"
    Pair(*made, same=DISTURBED).run(620)


@pytest.mark.slow
@pytest.mark.core
def test_both_are_led_as_the_check_proves_it() -> None:
    """The lift's place along the path is that of the plan, with acceleration limits and without."""
    task = ready("torso_lift")
    path = check_path(task.cell, task.grasp, task.path).led_path()
    for acceleration in (5.0, np.inf):
        cell = task.cell.with_limits(acceleration=acceleration)
        run = pair(dataclasses.replace(task, cell=cell), path=lambda: path, dt=0.02)
        run.same = DISTURBED
        assert run.run(600).plain.step().finished


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("joint", [4, 6, 9])
def test_both_agree_while_redundant_arms_avoid_limits(joint: int) -> None:
    task = dual_arm7(duration=1.0)
    limits, x = task.cell.limits, task.q_start
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[joint], upper[joint] = x[joint] - 0.05, x[joint] + 0.05
    for acceleration in (5.0, np.inf):
        cell = task.cell.with_limits(lower=lower, upper=upper, acceleration=acceleration)
        run_in("nominal", dataclasses.replace(task, cell=cell), 400)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["rx90l", "arm7"])
@pytest.mark.parametrize("arms", [2, 5, 12, 16])
def test_both_agree_with_many_arms(arms: int, robot: Any) -> None:
    task = ring(arms=arms, robot=robot)
    for mode in ("nominal", "one arm lags", "always a QP", "an arm stalls"):
        run_in(mode, task, 120)


def halfway(task: Scenario, until: float = 0.5) -> Scenario:
    """The second half of a scenario's path. Its start has no symmetry, which rounding could break either way."""
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    controller.reset(task.q_start)
    step = controller.step()
    while step.clock_next < until * task.path.duration:
        step = controller.step()
    here, goal = task.path.pose(step.clock_next), task.path.pose(task.path.duration)
    path = LinePath(here, goal, duration=0.5 * task.path.duration)
    return dataclasses.replace(task, path=path, q_start=step.q_next)


# -- starts ----------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.core
@pytest.mark.parametrize("make", [paper_lift, dual_arm7, mixed_cell], ids=lambda make: make.__name__)
@pytest.mark.parametrize("acceleration", slow_but_first([20.0, np.inf]))
def test_both_agree_while_joints_are_led_back(make: Callable[[], Scenario], acceleration: float) -> None:
    """Three joints are outside their limits, in both directions: the size of the QP changes during the run."""
    task = halfway(make())
    limits, q = task.cell.limits, task.cell.positions(task.q_start)
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[4], upper[8] = q[1] + 2e-3, q[4] - 1e-3, q[8] - 5e-3
    speed = np.minimum(limits.velocity, 1.0)
    cell = task.cell.with_limits(lower=lower, upper=upper, velocity=speed, acceleration=acceleration)
    run = pair(dataclasses.replace(task, cell=cell), dt=0.005)
    if cell.nv > 6 * len(cell):
        run.same = 1e-8  # null-space motion costs 1e-12 of what recovery does: rounding changes it more
    run.run(60)
    x = cell.positions(run.told[0])
    assert ((x < lower) | (x > upper)).any()


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("off", [1e-4, 1e-3])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_both_agree_from_a_start_off_the_grasp(off: float, acceleration: float) -> None:
    for make in (paper_lift, mixed_cell):
        task = limited_once(make, acceleration)
        away = off * np.random.default_rng(4).standard_normal(task.cell.nv)
        pair(dataclasses.replace(task, q_start=task.cell.moved(task.q_start, away)), dt=0.005).run(150)


# -- paths -----------------------------------------------------------------------------------------------------------


def zigzag(task: Scenario, law: str) -> WaypointPath:
    low, middle, high = (pin.SE3(task.path.pose(s * task.path.duration)) for s in (0.0, 0.5, 1.0))
    middle.translation = middle.translation + np.array([0.02, 0.01, 0.0])
    return WaypointPath([low, middle, high, middle], durations=[1.0, 0.7, 0.8], time_law=law)


@pytest.mark.core
@pytest.mark.parametrize("law", slow_but_first(["linear", "quintic"]))
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_both_agree_on_waypoints(law: str, acceleration: float) -> None:
    task = limited_once(paper_lift, acceleration)
    run = pair(task, path=lambda: zigzag(task, law), dt=0.01)
    assert run.run(1000).plain.step().finished


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_both_agree_on_a_users_path_with_corners(acceleration: float) -> None:
    for make in (paper_lift, mixed_cell):
        task = limited_once(make, acceleration)
        run = pair(task, path=lambda task=task: Marked(zigzag(task, "linear")), dt=0.01)
        assert run.run(1000, noisy(task.cell, size=1e-5)).plain.step().finished


class Unsaid(Marked):
    """It does not tell its corners."""

    def next_breakpoint(self, clock: float) -> float:
        return self.duration


@pytest.mark.core
@pytest.mark.parametrize("make", slow_but_first([paper_lift, mixed_cell]))
def test_both_agree_on_corners_that_a_user_does_not_tell(make: Callable[[], Scenario]) -> None:
    task = limited_once(make, 5.0)
    run = pair(task, path=lambda: Unsaid(zigzag(task, "linear")), dt=0.01).run(40)
    for i in range(30):  # copies go on from any place within a search
        run.take()
        if i % 7 == 0:
            run.compiled, run.plain = copy.deepcopy(run.compiled), copy.deepcopy(run.plain)
    assert run.run(1000, noisy(task.cell, size=1e-5)).plain.step().finished


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_both_agree_on_a_path_that_is_not_known_ahead(acceleration: float) -> None:
    for make in (paper_lift, dual_arm7):
        task = limited_once(make, acceleration)
        run = pair(task, path=lambda task=task: Marked(zigzag(task, "quintic"), known_ahead=False), dt=0.005)
        run.run(250, noisy(task.cell, size=1e-5))
        assert run.seen >= {Status.TRACKING}


#: Modes of the inputs in which rows that brake all arms together are compared.
BLIND = ("nominal", "measured late, with noise", "one arm lags", "samples lost", "uneven steps")


@pytest.mark.slow
@pytest.mark.parametrize("mode", BLIND)
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_both_brake_together_where_a_path_that_is_not_known_ahead_runs_out_of_reach(
    acceleration: float, mode: str
) -> None:
    """Of two cells one in turn; at night both."""
    options, inputs = MODES[mode]
    cells = ((paper_lift, (0.6, 0.2, 0.5)), (mixed_cell, (-0.3, 0.7, 0.1)))
    turn = (BLIND.index(mode) + bool(np.isfinite(acceleration))) % 2
    for make, way in cells if NIGHTLY else (cells[turn],):
        task = limited_once(make, acceleration)
        line = LinePath.displaced(task.path.pose(0.0), translation=way, duration=1.6, time_law="quintic")
        run = pair(task, path=lambda line=line: Marked(line, known_ahead=False), dt=0.008, **options)
        run.same = DISTURBED
        run.run(220, inputs(task, 0.008))
        assert run.lowest < 0.9
        assert np.abs(run.told[-1] - run.told[0]).max() > 0.1


class Failing(Marked):
    """It fails, or jumps, from a clock on, while its owner says so."""

    since, jump = np.inf, 0.0

    def pose(self, clock: float) -> pin.SE3:
        if clock < self.since:
            return super().pose(clock)
        if not self.jump:
            raise LookupError("no data")
        return pin.SE3(np.eye(3), np.full(3, self.jump)) * super().pose(clock)


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("jump", [0.0, 1e-3, 1.0])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_both_agree_while_a_users_path_fails(acceleration: float, jump: float) -> None:
    task = limited_once(mixed_cell, acceleration)
    for known_ahead in (True, False):
        for ahead in (0.0, 0.1):
            # No multiple of a step is where a knot is: rounding would decide whether it is behind already.
            run = pair(task, path=lambda: Failing(task.path), dt=0.0047)
            for controller in (run.compiled, run.plain):
                controller.path.known_ahead = known_ahead
                controller.follow(controller.path)
            clock = run.run(77).plain.step().clock_next + ahead
            run.compiled.step()
            for path in (run.compiled.path, run.plain.path):
                assert isinstance(path, Failing)
                path.since, path.jump = clock, jump
            run.run(60, noisy(task.cell, size=1e-5))
            assert Status.HOLDING in run.seen or 0.0 < jump < 1.0
            for path in (run.compiled.path, run.plain.path):
                path.since = np.inf
            run.run(60)


@pytest.mark.slow
@pytest.mark.core
def test_a_users_path_is_followed_like_the_librarys_own() -> None:
    task = limited_once(paper_lift, 5.0)
    own = pair(task, path=lambda: Marked(zigzag(task, "linear")), dt=0.01)
    known = pair(task, path=lambda: zigzag(task, "linear"), dt=0.01)
    both = np.array([(own.take().velocity, known.take().velocity) for _ in range(300)])
    own.compare()
    known.compare()
    np.testing.assert_allclose(both[:, 0], both[:, 1], rtol=0.0, atol=1e-7)


@pytest.mark.core
@pytest.mark.slow
@pytest.mark.parametrize("make", [paper_lift, dual_arm7], ids=lambda make: make.__name__)
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_both_agree_on_moving_targets(acceleration: float, make: Callable[[], Scenario]) -> None:
    task = limited_once(make, acceleration)
    start, rng = task.path.pose(0.0), np.random.default_rng(8)
    run = pair(task, path=lambda: ServoPath(start), dt=0.005)
    run.same = DISTURBED
    for i in range(8):
        far = 0.6 if i == 4 else 0.05  # once out of reach
        target = pin.SE3(
            start.rotation @ pin.exp3(0.2 * rng.standard_normal(3)),
            start.translation + far * rng.standard_normal(3),
        )
        run.both(lambda c, T=target: c.retarget(T))
        run.run(25 if i % 3 else 60, noisy(task.cell, size=1e-5) if i % 3 else None)
    assert run.seen >= {Status.TRACKING, Status.SLOWED} or not np.isfinite(acceleration)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([10.0, np.inf]))
def test_both_agree_on_targets_that_change_while_the_object_turns(acceleration: float) -> None:
    """The object's frame is askew to the world, and both halves of its velocity are there as the way is changed."""
    task = limited_once(paper_lift, acceleration)
    start = task.path.pose(0.0)
    run = pair(task, path=lambda: ServoPath(start), dt=0.005)
    run.same = DISTURBED
    for turn, way in (((0.3, -0.2, 0.4), (0.02, 0.03, 0.05)), ((-0.2, 0.4, 0.1), (-0.03, 0.0, 0.04)), (None, None)):
        goal = start if turn is None else pin.SE3(start.rotation @ pin.exp3(np.array(turn)), start.translation + way)
        run.both(lambda c, T=goal: c.retarget(T))
        run.run(30)
    assert run.seen >= {Status.TRACKING}


@pytest.mark.slow
@pytest.mark.core
def test_both_agree_when_another_path_is_followed_in_motion() -> None:
    for acceleration in (np.inf, 10.0):
        task = limited_once(mixed_cell, acceleration)
        run = pair(task, dt=0.005).run(150)
        for goal in (task.path.pose(0.0), task.path.pose(2.0), task.path.pose(0.5)):
            here = run.plain.path.pose(run.plain.step().clock_next)
            run.compiled.step()
            run.both(lambda c, a=here, b=goal: c.follow(LinePath(a, b, duration=1.0, time_law="linear")))
            run.run(90, noisy(task.cell, size=1e-5))


@pytest.mark.core
@pytest.mark.parametrize("turn", [2.0, 3.1, 3.3])
def test_both_agree_where_the_object_is_turned_far_off_its_path(turn: float) -> None:
    """Beyond 2.7 rad and across half a turn, too, with a measurement."""
    for make, acceleration in ((mixed_cell, 10.0), (paper_lift, np.inf)):
        task = limited_once(make, acceleration)
        start = task.path.pose(0.0)
        there = pin.SE3(start.rotation @ pin.exp3(np.array([0.0, 0.0, turn])), start.translation)
        run = pair(task, dt=0.005)
        run.both(lambda c, a=there: c.follow(LinePath(a, a, duration=1.0, time_law="linear")))
        run.same = DISTURBED
        run.run(100, noisy(task.cell, size=1e-5))
        assert run.seen == {Status.OFF_PATH}


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [1e2, 1e3, 1e4, 1e6])
@pytest.mark.parametrize("dt", slow_but_first([0.06, 0.01]))
def test_both_agree_and_finish_however_far_joints_get_in_a_step(acceleration: float, dt: float) -> None:
    task = limited_once(paper_lift, acceleration)
    start, rng = task.path.pose(0.0), np.random.default_rng(5)
    by = {"translation": rng.normal(size=3) * 0.05, "rotation": rng.normal(size=3) * 0.1}
    run = pair(task, path=lambda: LinePath.displaced(start, duration=0.8, **by), dt=dt)
    run.run(int(1.2 / dt))
    assert run.plain.step().clock == 0.8


@pytest.mark.core
def test_both_agree_after_a_fault_and_a_reset() -> None:
    task = limited_once(paper_lift, 20.0)
    options = {"supervision": SupervisionOptions(joint_jump=2.0, stall_samples=None)}
    run = pair(task, dt=0.005, **options).run(60)
    arm = task.cell.q_slices[1]
    for _ in range(20):
        q = run.told[-1].copy()
        q[arm] += 0.1
        run.step(q)
    assert run.seen >= {Status.FAULT}
    run.run(40)
    assert run.step().status is Status.FAULT
    run.both(lambda c: c.follow(LinePath(task.path.pose(0.0), task.path.pose(1.0), duration=2.0)))
    run.both(lambda c: c.reset(task.q_start))
    run.seen.clear()
    run.run(120, noisy(task.cell))
    assert Status.FAULT not in run.seen


# -- what the core leaves to Python ----------------------------------------------------------------------------------


@pytest.mark.core
@pytest.mark.parametrize("solver", slow_but_first(["ldp", "daqp", "proxqp"]))
def test_both_agree_with_any_solver(solver: str) -> None:
    loose = 1e-6 if solver == "proxqp" else SAME
    for acceleration in (np.inf, 5.0):
        task = limited_once(at_limit, acceleration)
        a, b = (
            QPController(
                task.cell, task.grasp, task.path, dt=0.005, options=QPOptions(kernel=k, shortcut=False, solver=solver)
            )
            for k in ("compiled", "plain")
        )
        a.reset(task.q_start)
        b.reset(task.q_start)
        steps = [(a.step(), b.step()) for _ in range(120)]
        velocities = np.array([(one.velocity, other.velocity) for one, other in steps])
        np.testing.assert_allclose(velocities[:, 0], velocities[:, 1], rtol=0.0, atol=loose)
        assert all(one.status is other.status for one, other in steps)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.core
def test_both_agree_where_the_chain_has_to_part() -> None:
    """A joint that may hardly move, and one that comes back from outside: no answer keeps the chain."""
    task = paper_lift()
    limits, q = task.cell.limits, task.cell.positions(task.q_start)
    upper, speed = limits.upper.copy(), limits.velocity.copy()
    upper[2] = q[2] - 0.02
    speed[12:] = 1e-3
    cell = task.cell.with_limits(upper=upper, velocity=speed)
    run = pair(dataclasses.replace(task, cell=cell), dt=0.005)
    parted = max(step.given_up.chain for step in [run.take() for _ in range(60)])
    run.compare()
    assert parted >= 0.0


FEW_JOINTS = ("conveyor", "five_joint_pair", "positioner", "scara_pair")


@pytest.mark.core
@pytest.mark.parametrize("name", FEW_JOINTS)
def test_both_agree_on_arms_with_few_joints(name: str) -> None:
    for mode in MODES if NIGHTLY else IN_SHORT:
        run_in(mode, ready(name), 100)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [8.0, np.inf])
@pytest.mark.parametrize("name", ["five_joint_pair", "scara_pair"])
@pytest.mark.parametrize("beside", [False, True])
def test_both_agree_where_few_joints_cannot_follow_the_path(beside: bool, name: str, acceleration: float) -> None:
    """Nothing is known ahead of a path that leaves what the arms can do. Beside a body a step is answered twice."""
    task = limited_once(SCENARIOS[name], acceleration)
    start = task.path.pose(0.0)
    path = LinePath.displaced(start, translation=(0.03, 0.05, 0.06), rotation=(0.3, 0.0, 0.1), duration=2.0)
    ball = Body("ball", Sphere(0.03), pin.SE3(np.eye(3), path.pose(1.2).translation + np.array([0.03, 0.05, 0.05])))
    scene = CollisionScene.of(task, margin=0.02, obstacles=[ball])
    made = []
    for kernel in ("compiled", "plain"):
        constraints = [Clearance(scene)] if beside else []
        options = QPOptions(kernel=kernel)
        made.append(QPController(task.cell, task.grasp, path, dt=0.008, options=options, constraints=constraints))
        made[-1].reset(task.q_start)
    Pair(*made, same=DISTURBED).run(130)


# -- at random, in short -----------------------------------------------------------------------------------------------


#: Cells of six and of seven joints an arm.
SOME_CELLS = (paper_lift, mixed_cell, dual_arm7)


def options_at_random(rng: np.random.Generator) -> dict[str, Any]:
    """Every option of the step, within sensible bounds."""
    supervision = SupervisionOptions(
        slow_from=float(rng.uniform(5e-5, 4e-4)),
        hold_from=float(rng.uniform(5e-4, 2e-3)),
        let_in=float(rng.uniform(0.0, 0.006)),
        noise_margin=float(rng.uniform(1.0, 6.0)),
        recovery_time=float(rng.uniform(0.0, 0.2)),
        apart_from=float(rng.uniform(5e-5, 4e-4)),
        stall_samples=int(rng.integers(2, 8)),
        stall_share=float(rng.uniform(0.1, 0.5)),
        silent_time=float(rng.uniform(0.01, 0.06)),
        filter_time=float(rng.uniform(0.0, 0.01)),
        stiffness=float(rng.uniform(5e3, 5e4)) if rng.uniform() < 0.5 else None,
        force_limit=float(rng.uniform(50.0, 300.0)),
        servo_delay=float(rng.uniform(0.0, 0.02)),
    )
    preview = PreviewOptions(
        cell=float(rng.uniform(0.01, 0.04)),
        joint_step=float(rng.uniform(0.01, 0.04)),
        slope_step=float(rng.uniform(0.05, 0.2)),
        margin=float(rng.uniform(0.7, 0.98)),
        curvature_share=float(rng.uniform(0.2, 0.8)),
        doubt=float(rng.uniform(0.05, 0.5)),
        rate_slope=float(rng.uniform(2.0, 12.0)),
        newton_steps=int(rng.integers(2, 41)),
    )
    return {
        "grasp_gain": float(rng.uniform(0.0, 40.0)),
        "path_gain": float(rng.uniform(0.0, 40.0)),
        "correction_speed": float(rng.choice([1e-4, 0.01, 0.1])),
        "correction_spin": float(rng.choice([1e-3, 0.05, 0.4])),
        "measurement_time": float(rng.uniform(0.005, 0.05)),
        "blocked_rate": float(rng.choice([1e-3, 0.05])),
        "shortcut": bool(rng.uniform() < 0.7),
        "supervision": supervision,
        "preview": preview if rng.uniform() < 0.8 else None,
        "posture": PostureOptions(
            gain=float(rng.uniform(0.0, 2.0)),
            centring=float(rng.uniform(0.0, 0.5)),
            manipulability=float(rng.choice([0.0, 0.2])),
            speed_share=float(rng.uniform(0.1, 0.5)),
        ),
    }


def limits_at_random(task: Scenario, rng: np.random.Generator) -> Scenario:
    """Limits around the start, some of them so near that they bind; an acceleration of each joint, or of none."""
    cell, q = task.cell, task.cell.positions(task.q_start)
    limits = cell.limits
    near = np.where(rng.uniform(size=cell.nv) < 0.2, 0.02, 1.0) * rng.uniform(0.5, 1.5, cell.nv)
    side = rng.uniform(size=cell.nv) < 0.5
    changed: dict[str, Any] = {
        "lower": np.where(side, np.maximum(limits.lower, q - near), limits.lower),
        "upper": np.where(side, limits.upper, np.minimum(limits.upper, q + near)),
        "velocity": np.minimum(limits.velocity, rng.uniform(0.1, 2.0, cell.nv)),
    }
    if rng.uniform() < 0.7:
        changed["acceleration"] = rng.uniform(2.0, 30.0, cell.nv)
    return dataclasses.replace(task, cell=cell.with_limits(**changed))


def inputs_at_random(task: Scenario, dt: float, rng: np.random.Generator) -> Inputs:
    cell = task.cell
    kinds: list[Callable[[], Inputs]] = [
        lambda: noisy(cell, size=float(rng.uniform(1e-6, 3e-4)), late=int(rng.integers(0, 4))),
        lambda: lagging(cell, int(rng.integers(1, 6))),
        lambda: stalling(cell, 25, 45),
        lambda: dropping(cell),
        lambda: corrupted(cell),
        lambda: uneven(cell, dt),
    ]
    return kinds[int(rng.integers(len(kinds)))]()


def way_at_random(task: Scenario, rng: np.random.Generator) -> WaypointPath:
    """Short pieces in all directions, with turns and with corners; one of them stands."""
    poses = [task.path.pose(0.0)]
    for _ in range(3):
        here, moved, turned = poses[-1], 0.02 * rng.standard_normal(3), 0.05 * rng.standard_normal(3)
        poses.append(pin.SE3(here.rotation @ pin.exp3(turned), here.translation + moved))
    poses.insert(2, poses[1])
    law = ("linear", "quintic")[int(rng.integers(2))]
    return WaypointPath(poses, durations=[*rng.uniform(0.1, 0.4, 4)], time_law=law)


@pytest.mark.core
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
@pytest.mark.parametrize("seed", range(8))
def test_both_agree_with_options_limits_and_inputs_at_random(seed: int, make: Callable[[], Scenario]) -> None:
    rng = np.random.default_rng(100 + seed)
    task = limits_at_random(limited_once(make, np.inf), rng)
    dt = float(rng.choice([0.004, 0.008, 0.0113]))
    path = way_at_random(task, rng)
    run = pair(task, path=lambda: path, dt=dt, **options_at_random(rng))
    run.same = DISTURBED
    run.run(60, inputs_at_random(task, dt, rng))
    assert run.told


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([8.0, np.inf]))
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
def test_both_agree_on_targets_that_jump_about(make: Callable[[], Scenario], acceleration: float) -> None:
    """Near, far, out of reach, the same once more, and back, each asked before the last is reached."""
    task = limited_once(make, acceleration)
    start, rng = task.path.pose(0.0), np.random.default_rng(12)
    speed, spin = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0.2, 1.0))
    run = pair(task, path=lambda: ServoPath(start, speed=speed, spin=spin), dt=0.008)
    run.same = DISTURBED
    goal = start
    for far, turn in ((0.001, 0.0), (0.05, 0.1), (0.0, 0.2), (0.7, 0.3), (None, None), (0.02, 0.0), (0.0, 0.0)):
        if far is not None:
            way, about = rng.standard_normal(3), rng.standard_normal(3)
            goal = pin.SE3(start.rotation @ pin.exp3(turn * about), start.translation + far * way)
        run.both(lambda c, T=goal: c.retarget(T))
        run.run(int(rng.integers(5, 9)), noisy(task.cell, size=1e-5))
    assert run.seen >= {Status.TRACKING}


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [20.0, np.inf])
def test_both_take_targets_in_motion_where_joints_allow_the_override_and_not_the_full_rate(
    acceleration: float,
) -> None:
    task = limited_once(two_arms, acceleration)
    task = dataclasses.replace(task, cell=task.cell.with_limits(velocity=0.1 * task.cell.limits.velocity))
    start, rng = task.path.pose(0.0), np.random.default_rng(3)
    run = pair(task, path=lambda: ServoPath(start, speed=0.3, spin=0.6), dt=0.008)
    run.same = DISTURBED
    run.both(lambda c: c.set_override(0.7))
    for i in range(4):
        way, about = rng.standard_normal(3), rng.standard_normal(3)
        goal = pin.SE3(start.rotation @ pin.exp3(0.2 * about), start.translation + 0.1 * way)
        run.both(lambda c, T=goal: c.retarget(T))
        step = run.take()
        assert i == 0 or "brakes before it goes over" not in step.reason
        run.run(int(rng.integers(4, 9)))
    assert run.plain.step().rate == pytest.approx(0.7)


@pytest.mark.core
@pytest.mark.parametrize("kind", ["wrist", "elbow", "reach"])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_both_agree_on_the_way_into_a_singularity(kind: Any, acceleration: float) -> None:
    task = at_singularity(kind, 1, acceleration=acceleration)
    last = task.path.duration
    near = LinePath(task.path.pose(0.0), task.path.pose(last), duration=0.4 * last)
    run = pair(task, path=lambda: near, dt=0.012)
    run.same = DISTURBED
    run.run(90)
    assert run.lowest < 1.0


@pytest.mark.core
@pytest.mark.parametrize("known_ahead", [True, False])
@pytest.mark.parametrize("jump", [0.0, 1e-3, 1.0])
def test_both_agree_where_a_users_path_fails_and_recovers(jump: float, known_ahead: bool) -> None:
    task = limited_once(mixed_cell, 10.0)
    run = pair(task, path=lambda: Failing(task.path, known_ahead=known_ahead), dt=0.0097)
    clock = run.run(25).plain.step().clock_next
    run.compiled.step()
    for since, steps in ((clock, 15), (np.inf, 15)):
        for path in (run.compiled.path, run.plain.path):
            assert isinstance(path, Failing)
            path.since, path.jump = since, jump
        run.run(steps, noisy(task.cell, size=1e-5))
    assert Status.HOLDING in run.seen or jump > 0.0


@pytest.mark.core
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
@pytest.mark.parametrize("known_ahead", [True, False])
def test_both_agree_on_corners_that_a_user_tells(make: Callable[[], Scenario], known_ahead: bool) -> None:
    task = limited_once(make, 6.0)
    run = pair(task, path=lambda: Marked(zigzag(task, "linear"), known_ahead=known_ahead), dt=0.02)
    run.same = DISTURBED
    run.run(70, noisy(task.cell, size=1e-5))
    assert run.seen >= {Status.TRACKING}


@pytest.mark.core
def test_both_brake_alike_beside_a_corner_when_paused_there() -> None:
    """Between two knots: joints bend on this side of the corner as they do here."""
    task = limited_once(mixed_cell, 5.0)
    run, clocks = pair(task, path=lambda: zigzag(task, "linear"), dt=0.02), []
    run.same = DISTURBED
    for _ in range(60):
        clocks.append(run.take().clock_next)
        if abs(clocks[-1] - 1.0) < 0.05:
            paused = Pair(*(copy.deepcopy(controller) for controller in (run.compiled, run.plain)), same=DISTURBED)
            paused.both(lambda c: c.pause())
            paused.run(3)
    run.compare()
    assert clocks[0] < 0.9
    assert clocks[-1] > 1.03


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_both_agree_when_paths_of_all_kinds_follow_each_other_in_motion(acceleration: float) -> None:
    task = limited_once(mixed_cell, acceleration)
    run = pair(task, dt=0.01).run(40)
    run.same = DISTURBED
    for kind in ("linear", "quintic", "hold", "waypoints"):
        here = run.plain.path.pose(run.plain.step().clock_next)
        run.compiled.step()
        goal, path = task.path.pose(0.5), None
        if kind == "hold":
            path = HoldPath(here, duration=0.2)
        elif kind == "waypoints":
            path = WaypointPath([here, goal, here], durations=[0.3, 0.2], time_law="linear")
        follow: ObjectPath = path or LinePath(here, goal, duration=0.3, time_law=kind)
        run.both(lambda c, path=follow: c.follow(path))
        run.run(22, noisy(task.cell, size=1e-5))


@pytest.mark.core
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("off", [1e-4, 2e-3])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
def test_both_agree_from_starts_beside_the_grasp(make: Callable[[], Scenario], acceleration: float, off: float) -> None:
    task = limited_once(make, acceleration)
    away = off * np.random.default_rng(14).standard_normal(task.cell.nv)
    run = pair(dataclasses.replace(task, q_start=task.cell.moved(task.q_start, away)), dt=0.007)
    run.same = DISTURBED
    run.run(60)
    assert max(np.abs(np.array(run.plain.step().given_up.off_path))) < 0.1


@pytest.mark.core
@pytest.mark.parametrize("mode", ["nominal", "one arm lags", "always a QP"])
def test_both_agree_with_five_arms(mode: str) -> None:
    task = ring(arms=5)
    inputs = lagging(task.cell) if mode == "one arm lags" else None
    run: Pair = pair(task, dt=0.02, shortcut=mode != "always a QP")
    run.run(60, inputs)


@pytest.mark.core
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
def test_both_agree_with_a_joint_that_is_locked(make: Callable[[], Scenario]) -> None:
    """Its limits leave it almost no way: the object goes as far as that."""
    task = halfway(limited_once(make, np.inf))
    q, limits = task.cell.positions(task.q_start), task.cell.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[2], upper[2] = q[2] - 1e-3, q[2] + 1e-3
    for acceleration in (np.inf, 5.0):
        cell = task.cell.with_limits(lower=lower, upper=upper, acceleration=acceleration)
        run = pair(dataclasses.replace(task, cell=cell), dt=0.01)
        run.same = DISTURBED
        run.run(40)
