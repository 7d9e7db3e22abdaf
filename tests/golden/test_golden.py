"""The controller makes the steps that were recorded, with any input, on any path: see ``golden.py`` and ``record.py``.

A commit that changes what the controller does records the cases anew that change, and says why.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at, on_another_joint
from golden import Golden, Inputs, Run
from marks import slow_but_first, slow_unless
from odd_cells import ODD_CELLS, posture
from runs import hurried, limited_once
from tapes import DISTURBED, SAME, Tape, difference, from_bytes, same_words, to_bytes
from torsos import robot_of
from user_paths import Marked

from coopqp import (
    HoldPath,
    LimitKind,
    LinePath,
    ObjectPath,
    PostureOptions,
    PreviewOptions,
    QPController,
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


#: Modes whose runs part from themselves sooner or later, whatever made them differ first by 1e-14: an arm that follows
#: late is fed with what the late arm made the others do. They end before that shows.
PARTING = {"one arm lags": 100, "no drift let in": 100}


def run_in(golden: Golden, mode: str, task: Scenario, steps: int = 250, same: float = SAME) -> Run:
    options, inputs = MODES[mode]
    dt = coarse(task)
    run = golden.start(task, dt=dt, **options)
    run.same = same
    return run.run(min(steps, PARTING.get(mode, steps)), inputs(task, dt))


@pytest.mark.core
@pytest.mark.parametrize("mode", IN_SHORT)
def test_in_short(golden: Golden, mode: str) -> None:
    for name in ("paper_lift", "mixed_cell"):
        run_in(golden, mode, ready(name), 120)
    if "stalls" not in mode:
        assert run_in(golden, mode, ASKEW, 150).seen >= {Status.SLOWED}


#: What a mode shows within 70 steps, beside tracking.
SHOWS = {"one arm lags": Status.SLOWED, "no drift let in": Status.SLOWED, "samples corrupted": Status.HOLDING}
SHOWS |= dict.fromkeys(("uneven steps", "an arm stalls", "no watch of distances"), Status.HOLDING)
SHOWS |= {"forces watched, an arm stalls": Status.HOLDING}


@pytest.mark.core
@pytest.mark.parametrize("mode", [mode for mode in MODES if mode not in IN_SHORT])
def test_for_a_moment(golden: Golden, mode: str) -> None:
    acceleration = 5.0 if list(MODES).index(mode) % 2 else np.inf
    seen = run_in(golden, mode, limited_once(two_arms, acceleration), 70, same=DISTURBED).seen
    assert SHOWS.get(mode, Status.TRACKING) in seen


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 8.0])
def test_with_all_settings_changed(golden: Golden, acceleration: float) -> None:
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
    run = golden.start(
        task, dt=0.006, supervision=watch, weights=weights, shortcut=False, grasp_gain=12.0, path_gain=7.0,
        correction_speed=0.02, correction_spin=0.05, measurement_time=0.03, blocked_rate=5e-3,
        posture=PostureOptions(gain=0.7, centring=0.2, manipulability=0.05, speed_share=0.1),
        preview=PreviewOptions(cell=0.04, joint_step=0.08, margin=0.85, rate_slope=6.0, curvature_share=0.6),
        off_path_distance=2e-4, off_path_angle=1e-3,
    )  # fmt: skip
    run.same = DISTURBED
    given = noisy(task.cell, size=4e-4)
    run.ask(lambda c: c.set_override(0.9))
    for i in range(60):
        q, _ = given(i, run.told)
        if i == 40 and q is not None:
            q[0] += 0.15  # not believed
        run.take(q, {20: 0.002, 21: 0.0025, 22: 0.013, 23: 0.0119}.get(i))
    assert run.seen >= {Status.HOLDING, Status.SLOWED}
    assert run.lowest < 0.9


@pytest.mark.core
@pytest.mark.parametrize("preview", [None, PreviewOptions()], ids=["blind", "looking ahead"])
def test_stops_ahead_of_a_limit(golden: Golden, preview: PreviewOptions | None) -> None:
    task = hurried(dataclasses.replace(ASKEW, cell=ASKEW.cell.with_limits(acceleration=3.0)), 1.5)
    run = golden.start(task, dt=0.01, preview=preview)
    run.same = DISTURBED
    run.run(70)
    assert Status.SLOWED in run.seen
    assert run.lowest < 0.5


@pytest.mark.core
def test_measurements_of_any_kind_of_array(golden: Golden) -> None:
    """Lists, other numbers, arrays that are strided: what is measured is the same."""
    task = limited_once(two_arms, np.inf)
    run = golden.start(task, dt=0.01)
    kinds: list[Callable[[Array], Any]] = [
        list, tuple, np.float32, lambda q: np.repeat(q, 2)[::2], np.asfortranarray, lambda q: [*q, 0.0],
        lambda q: "far", lambda q: q.astype(object), lambda q: q[:-1], lambda q: q[None], lambda q: q[:, None],
    ]  # fmt: skip
    for kind in kinds:
        step = run.take()
        away = task.cell.moved(step.q_next, np.full(task.cell.nv, 1e-4))
        given = kind(away)
        run.take(given)
    assert Status.HOLDING in run.seen


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.core
@pytest.mark.parametrize("solver", ["ldp", "daqp"])
def test_with_another_solver_while_joints_are_led_back(golden: Golden, solver: str) -> None:
    task = halfway(limited_once(two_arms, np.inf), until=0.1)
    limits, q = task.cell.limits, task.cell.positions(task.q_start)
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[8] = q[1] + 2e-3, q[8] - 5e-3
    cell = task.cell.with_limits(lower=lower, upper=upper, velocity=np.minimum(limits.velocity, 1.0))
    run = golden.start(dataclasses.replace(task, cell=cell), dt=0.005, solver=solver, shortcut=False)
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
def test_what_an_operator_asks_for(golden: Golden, calls: str, acceleration: float) -> None:
    run = golden.start(hurried(limited_once(two_arms, acceleration), 1.5), dt=0.01)
    run.same = DISTURBED
    for i in range(75):
        if i in ASKED[calls]:
            run.ask(ASKED[calls][i])
        run.take()
        if i == 40:
            run.copied()
    assert run.lowest < 0.5 or calls == "aside"


#: Scenarios whose arms have fewer than six joints.
FEW_JOINTS = ("five_joint_pair", "five_joint_pins", "scara_pair")
#: Cells that always do.
IN_FULL = ("paper_lift", "mixed_cell", "dual_arm7", "at_limit")


def every_run() -> Iterator[Any]:
    """Each scenario of arms with six joints or more with each mode; of most a third of the modes in turn.

    Sanitized: those in three cells that it has not in short.
    """
    for i, name in enumerate(sorted(set(SCENARIOS) - {*LOADED, *PROGRAMS, *FEW_JOINTS})):
        for k, mode in enumerate(MODES):
            if name in IN_FULL or (i + k) % 3 == 0:
                sanitized = name in ("paper_lift", "mixed_cell", "at_limit") and mode not in IN_SHORT
                yield pytest.param(name, mode, marks=[pytest.mark.core] if sanitized else [])


def limited_runs() -> Iterator[Any]:
    """Three cells in each mode, with one of two accelerations in turn."""
    for i, make in enumerate((paper_lift, dual_arm7, mixed_cell)):
        for k, mode in enumerate(MODES):
            acceleration = (5.0, 10.0)[(i + k) % 2]
            yield pytest.param(make, mode, acceleration, id=f"{make.__name__}-{mode}-{acceleration}")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mode"), [*every_run()])
def test_on_every_scenario(golden: Golden, name: str, mode: str) -> None:
    if name != "at_limit":
        run_in(golden, mode, ready(name), 230)
        return
    seen = run_in(golden, mode, ASKEW, 150).seen
    assert seen >= {Status.SLOWED} or "stalls" in mode or "bound" in mode


@pytest.mark.slow
@pytest.mark.parametrize(("make", "mode", "acceleration"), [*limited_runs()])
def test_under_acceleration_limits(
    golden: Golden, make: Callable[[], Scenario], mode: str, acceleration: float
) -> None:
    run_in(golden, mode, limited_once(make, acceleration), 150 if "corrupted" in mode else 250, same=DISTURBED)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([5.0, 10.0]))
def test_under_acceleration_limits_in_short(golden: Golden, acceleration: float) -> None:
    for mode in IN_SHORT:
        run_in(golden, mode, limited_once(mixed_cell, acceleration), 100)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_with_other_settings_of_the_preview(golden: Golden, acceleration: float) -> None:
    """A gentler rise of the rate, more in reserve: the object starts later than with the defaults."""
    task = limited_once(paper_lift, acceleration)
    other = golden.start(
        task, dt=0.01, preview=PreviewOptions(rate_slope=3.0, margin=0.8, doubt=0.1, curvature_share=0.4)
    )
    other.run(100)
    usual = golden.start(task, dt=0.01)
    usual.run(100)
    if np.isfinite(acceleration):
        assert other.take().clock < usual.take().clock


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wrist", "elbow", "reach"])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_at_singularities(golden: Golden, kind: Any, acceleration: float) -> None:
    task = at_singularity(kind, 1, acceleration=acceleration)
    run = golden.start(task, dt=0.005)
    run.same = DISTURBED  # joints turn fast there
    assert run.run(600).lowest < 0.1 or kind == "wrist"
    near = golden.start(at_singularity("wrist", 2, miss=0.01, acceleration=acceleration), dt=0.005)
    near.same = DISTURBED
    near.run(600)


@pytest.mark.core
@pytest.mark.slow
def test_a_mark_beside_a_singularity_ends_the_way_past_it(golden: Golden) -> None:
    """What comes after a mark is not known before it: no way past the pole of a wrist leads over one."""
    task = at_singularity("wrist", 2, miss=5e-4, acceleration=10.0)
    for mark, passes in ((np.inf, True), (0.7487, False)):
        run = golden.start(task, path=lambda mark=mark: Marked(task.path, mark=mark * task.path.duration), dt=0.01)
        run.same = DISTURBED
        step = run.run(400).take()
        assert step.finished == passes
        assert (step.rate == 0.0 and step.binding[0].kind is LimitKind.SINGULARITY) != passes


# -- the judge -------------------------------------------------------------------------------------------------------


def more(array: Array, by: float) -> Array:
    return array + by * (np.arange(array.size) == 3)


#: Changes of one step, each just beyond what may differ.
LIES: list[dict[str, Callable[[Any], Any]]] = [
    {"velocity": lambda v: more(v, 1.3 * SAME)}, {"velocity": lambda v: more(v, np.nan)},
    {"q_next": lambda q: more(q, 1.3 * SAME)}, {"rate": lambda r: r - 110.0 * SAME}, {"rate": np.float64},
    {"clock_next": lambda t: t + 110.0 * SAME}, {"clock": np.float64}, {"dt": lambda dt: dt + 1e-12},
    {"status": lambda status: Status.SLOWED}, {"reason": lambda reason: "for fun"}, {"binding": lambda b: (*b, "one")},
    {"given_up": lambda g: dataclasses.replace(g, off_path=(0.0, 0.0, 0.0, 1.3 * SAME, 0.0, 0.0))},
    *(
        {"given_up": lambda g, name=name: dataclasses.replace(g, **{name: 1.1e4 * SAME})}
        for name in ("grasp", "path", "chain")
    ),
]  # fmt: skip


@pytest.mark.parametrize("lie", LIES, ids=lambda lie: next(iter(lie)))
def test_a_step_that_differs_is_seen(lie: dict[str, Callable[[Any], Any]]) -> None:
    run = Golden("", "").start(ready("paper_lift"), dt=0.01).run(6)
    (kept,), bounds = from_bytes(*to_bytes([Tape.of(run.steps)])), np.array(run.bounds)
    assert difference(Tape.of(run.steps), kept, bounds) is None
    step = run.steps[4]
    run.steps[4] = step.replaced(**{name: change(getattr(step, name)) for name, change in lie.items()})
    found = difference(Tape.of(run.steps), kept, bounds)
    assert found is not None
    assert found[0] == 4
    assert next(iter(lie)) in found[1] or "kinds of numbers" in found[1]


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [("0.42 of 3 mm", "0.43 of 3 mm", True), ("0.42 of 3 mm", "0.44 of 3 mm", False), ("arm at 1", "arms at 1", False)],
)
def test_numbers_in_sentences_may_be_rounded_to_either_side(one: str, other: str, same: bool) -> None:
    assert same_words(one, other) == same


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
def test_on_any_joints(
    golden: Golden, robots: tuple[str, ...], make_cell: Callable[..., RobotCell], random_q: Callable[..., Array]
) -> None:
    cell = make_cell(robots)
    task = held(cell, random_q(cell, np.random.default_rng(3)))
    for mode in ("nominal", "measured late, with noise", "always a QP"):
        run_in(golden, mode, task, 80)


@pytest.mark.core
def test_on_eight_joints(golden: Golden, random_q: Callable[..., Array]) -> None:
    beside = [pin.SE3(np.eye(3), np.array([0.0, 1.1 * k, 0.0])) for k in range(2)]
    rail, table = pin.JointModelPY(), pin.JointModelRZ()
    cell = RobotCell([on_another_joint("0", rail, beside[0]), on_another_joint("1", table, beside[1])])
    assert cell.nv == 16
    for mode in ("nominal", "measured late, with noise", "always a QP", "middle of the joints"):
        run_in(golden, mode, held(cell, random_q(cell, np.random.default_rng(6))), 80)


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
def test_on_joints_that_arms_share(golden: Golden, torso: str, how: tuple[str, float], tmp_path: Path) -> None:
    mode, acceleration = how
    run_in(
        golden,
        mode,
        on_a_torso(torso, tmp_path, acceleration),
        100,
        same=DISTURBED if np.isfinite(acceleration) else SAME,
    )


@pytest.mark.core
@pytest.mark.parametrize("torso", TORSOS)
def test_a_sample_that_is_sent_again_is_lost_to_arms_that_share_joints_unless_these_move(
    golden: Golden, torso: str, tmp_path: Path
) -> None:
    """An arm far off is a fault in the second sample that is new: three that repeat to the last bit are none."""
    task = on_a_torso(torso, tmp_path)
    watch = SupervisionOptions(joint_jump=2.0, stall_samples=None, noise_margin=0.0)
    for moving in (None, *range(len(TORSOS[torso]))):
        run = golden.start(task, dt=0.01, supervision=watch).run(10, noisy(task.cell, size=1e-9))
        x, found = task.cell.positions(run.told[-1]), []
        x[task.cell.v_slices[1]] += 0.1
        for _ in range(6):
            if moving is not None:
                x[moving] += 1e-9
            found.append(run.take(task.cell.configuration(x)).status is Status.FAULT)
        assert found.index(True) == (4 if moving is None else 1)


@pytest.mark.core
@pytest.mark.parametrize(
    "mode", slow_but_first(["nominal", "forces watched, an arm stalls", "always a QP", "one arm lags", "no preview"])
)
def test_on_a_group_beside_an_arm(golden: Golden, mode: str, tmp_path: Path) -> None:
    task = on_a_torso("lift", tmp_path, beside=True)
    assert task.cell.groups == ((1, 2),)
    run_in(golden, mode, task, 80)


@pytest.mark.core
@pytest.mark.parametrize(
    ("mode", "acceleration"), [("always a QP", 5.0), ("forces watched, an arm stalls", np.inf)], ids=["QP", "forces"]
)
@pytest.mark.parametrize("cell", ODD_CELLS)
def test_on_rows_of_joints_that_are_odd(
    golden: Golden, cell: str, mode: str, acceleration: float, tmp_path: Path
) -> None:
    """Joints between an arm's that move no tool, joints that some of a robot's arms share, many joints, screws."""
    made = ODD_CELLS[cell](tmp_path).with_limits(acceleration=acceleration)
    steps, same = (25, DISTURBED) if mode == "always a QP" else (70, SAME)
    run_in(golden, mode, held(made, posture(made)), steps, same=same)


@pytest.mark.core
def test_where_an_arm_is_singular_and_its_group_is_not(golden: Golden, tmp_path: Path) -> None:
    """The torso's three joints do what the left arm cannot; the object does not wait for it."""
    task = on_a_torso("three of a waist", tmp_path)
    q = task.cell.positions(task.q_start)
    q[task.cell.joint_names.index("left/left_4")] = 0.0  # the axes before and after it are one line
    run = golden.start(held(task.cell, task.cell.configuration(q)), dt=0.01)
    run.same = DISTURBED  # joints turn fast there
    assert run.run(120).lowest == 1.0


@pytest.mark.core
def test_where_all_arms_of_a_group_are_singular_and_it_is_not(golden: Golden, tmp_path: Path) -> None:
    task = on_a_torso("three of a waist", tmp_path)
    q = task.cell.positions(task.q_start)
    for name in ("left/left_4", "right/right_4"):
        q[task.cell.joint_names.index(name)] = 0.0
    run = golden.start(held(task.cell, task.cell.configuration(q)), dt=0.01)
    assert run.run(60).lowest == 1.0


def anywhere(cell: RobotCell, seed: int, duration: float) -> Scenario:
    """An object goes on half a metre from where the arms happen to be."""
    rng = np.random.default_rng([seed, 1])
    q = cell.configuration(rng.uniform(-1.3, 1.3, cell.nv))
    start, way, turn = CellState(cell, q).T_world_tool[0], rng.normal(size=3), rng.uniform(-0.5, 0.5, 3)
    path = LinePath.displaced(
        start, translation=0.5 * way / np.linalg.norm(way), rotation=turn, duration=duration, time_law="linear"
    )
    return Scenario("anywhere", cell, grasp_at(cell, q), path, q, 0.02)


@pytest.mark.core
def test_where_a_group_passes_a_singularity(golden: Golden, tmp_path: Path) -> None:
    """As slowly as joints ask for, and never to rest."""
    cell = RobotCell([robot_of(TORSOS["lift"], tmp_path)])
    for seed in (1, 2, 4):
        assert 0.2 < golden.start(anywhere(cell, seed, 1.0), dt=0.02).run(45).lowest < 0.6


@pytest.mark.core
def test_past_corners_behind_which_joints_are_at_their_speeds(golden: Golden) -> None:
    """They could change their speeds within a step; a corner is passed as slowly as what follows it."""
    task = two_arms()
    for seed, acceleration in ((3, 300.0), (7, 1000.0)):
        rng, places = np.random.default_rng(seed), [task.path.pose(0.0)]
        durations = rng.permutation([0.6, 0.12, 0.6, 0.1])
        for _ in durations:
            way = rng.normal(size=3)
            way *= rng.uniform(0.05, 0.2) / np.linalg.norm(way)
            places.append(places[-1] * pin.SE3(pin.exp3(0.3 * rng.normal(size=3)), way))
        path = WaypointPath(places, durations=durations, time_law="linear")
        run = golden.start(limited_once(two_arms, acceleration), path=lambda path=path: path, dt=0.02)  # type: ignore[misc]
        run.same = DISTURBED
        assert 0.0 < run.run(100).lowest < 0.5


@pytest.mark.core
def test_on_targets_that_change_beside_a_body(golden: Golden) -> None:
    """A new way is taken at the rate of the one before only if its first step keeps to it."""
    rng, task = np.random.default_rng(24), limited_once(two_arms, 10.0)
    start = task.path.pose(0.0)
    place = start.translation + 0.3 * rng.normal(size=3) + np.array([0.0, 0.0, 0.5])
    scene = CollisionScene.of(
        task, cell=task.cell, margin=0.0, obstacles=[Body("ball", Sphere(0.05), pin.SE3(np.eye(3), place))]
    )
    run = golden.start(task, path=lambda: ServoPath(start), dt=0.01, constraints=[Clearance(scene)])
    run.same = DISTURBED
    for i in range(120):
        if i % 12 == 5:
            goal = start * pin.SE3(pin.exp3(0.3 * rng.normal(size=3)), 0.15 * rng.normal(size=3))
            run.ask(lambda c, goal=goal: c.retarget(goal))  # type: ignore[misc]
        run.take()
    assert run.seen >= {Status.SLOWED, Status.BLOCKED}


@pytest.mark.core
def test_where_a_group_brakes_before_a_singularity_that_nothing_looks_for(golden: Golden, tmp_path: Path) -> None:
    cell = RobotCell([robot_of(TORSOS["lift"], tmp_path)]).with_limits(acceleration=4.0)
    for seed in (5, 15, 20):
        run = golden.start(anywhere(cell, seed, 2.0), dt=0.02, preview=None)
        run.same = DISTURBED
        assert 0.0 < run.run(60).lowest < 0.2


@pytest.mark.core
@pytest.mark.parametrize("mode", ["nominal", "measured late, with noise", "always a QP", "no preview"])
@pytest.mark.parametrize("acceleration", [5.0, np.inf])
def test_on_a_rail_under_arms_of_seven_joints(golden: Golden, mode: str, acceleration: float) -> None:
    task = ready("two_on_a_rail")
    task = dataclasses.replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    assert task.cell.nv == 15
    run_in(golden, mode, task, 50, same=DISTURBED if np.isfinite(acceleration) else SAME)


@pytest.mark.slow
@pytest.mark.core
def test_where_a_group_evades_a_body(golden: Golden) -> None:
    """A lid above two arms on a rail; each arm's self-motion keeps its elbow off it, and the rail stays out of that."""
    task = ready("two_on_a_rail")
    cell = task.cell.with_limits(acceleration=5.0)
    place = task.path.pose(0.0).translation + np.array([0.0, 0.0, 0.25])
    lid = Body("lid", Box((0.6, 0.6, 0.02)), pin.SE3(np.eye(3), place))
    scene = dataclasses.replace(CollisionScene.of(task, margin=0.02, obstacles=[lid]), cell=cell)
    run = golden.start(dataclasses.replace(task, cell=cell), dt=0.01, constraints=[Clearance(scene)])
    run.same = DISTURBED
    run.run(620)


@pytest.mark.slow
@pytest.mark.core
def test_led_as_the_check_proves_it(golden: Golden) -> None:
    """The lift's place along the path is that of the plan, with acceleration limits and without."""
    task = ready("torso_lift")
    path = check_path(task.cell, task.grasp, task.path).led_path()
    for acceleration in (5.0, np.inf):
        cell = task.cell.with_limits(acceleration=acceleration)
        run = golden.start(dataclasses.replace(task, cell=cell), path=lambda: path, dt=0.02)
        run.same = DISTURBED
        assert run.run(600).take().finished


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("joint", [4, 6, 9])
def test_while_redundant_arms_avoid_limits(golden: Golden, joint: int) -> None:
    task = dual_arm7(duration=1.0)
    limits, x = task.cell.limits, task.q_start
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[joint], upper[joint] = x[joint] - 0.05, x[joint] + 0.05
    for acceleration in (5.0, np.inf):
        cell = task.cell.with_limits(lower=lower, upper=upper, acceleration=acceleration)
        run_in(golden, "nominal", dataclasses.replace(task, cell=cell), 240)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["rx90l", "arm7"])
@pytest.mark.parametrize("arms", [2, 5, 12, 16])
def test_with_many_arms(golden: Golden, arms: int, robot: Any) -> None:
    task = ring(arms=arms, robot=robot)
    for mode in ("nominal", "one arm lags", "always a QP", "an arm stalls"):
        run_in(golden, mode, task, 120)


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
def test_while_joints_are_led_back(golden: Golden, make: Callable[[], Scenario], acceleration: float) -> None:
    """Three joints are outside their limits, in both directions: the size of the QP changes during the run."""
    task = halfway(make())
    limits, q = task.cell.limits, task.cell.positions(task.q_start)
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[4], upper[8] = q[1] + 2e-3, q[4] - 1e-3, q[8] - 5e-3
    speed = np.minimum(limits.velocity, 1.0)
    cell = task.cell.with_limits(lower=lower, upper=upper, velocity=speed, acceleration=acceleration)
    run = golden.start(dataclasses.replace(task, cell=cell), dt=0.005)
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
def test_from_a_start_off_the_grasp(golden: Golden, off: float, acceleration: float) -> None:
    for make in (paper_lift, mixed_cell):
        task = limited_once(make, acceleration)
        away = off * np.random.default_rng(4).standard_normal(task.cell.nv)
        golden.start(dataclasses.replace(task, q_start=task.cell.moved(task.q_start, away)), dt=0.005).run(150)


# -- paths -----------------------------------------------------------------------------------------------------------


def zigzag(task: Scenario, law: str) -> WaypointPath:
    low, middle, high = (pin.SE3(task.path.pose(s * task.path.duration)) for s in (0.0, 0.5, 1.0))
    middle.translation = middle.translation + np.array([0.02, 0.01, 0.0])
    return WaypointPath([low, middle, high, middle], durations=[1.0, 0.7, 0.8], time_law=law)


@pytest.mark.core
@pytest.mark.parametrize("law", slow_but_first(["linear", "quintic"]))
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_on_waypoints(golden: Golden, law: str, acceleration: float) -> None:
    task = limited_once(paper_lift, acceleration)
    run = golden.start(task, path=lambda: zigzag(task, law), dt=0.01)
    assert run.run(1000).take().finished


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_on_a_users_path_with_corners(golden: Golden, acceleration: float) -> None:
    for make in (paper_lift, mixed_cell):
        task = limited_once(make, acceleration)
        run = golden.start(task, path=lambda task=task: Marked(zigzag(task, "linear")), dt=0.01)
        assert run.run(1000, noisy(task.cell, size=1e-5)).take().finished


class Unsaid(Marked):
    """It does not tell its corners."""

    def next_breakpoint(self, clock: float) -> float:
        return self.duration


@pytest.mark.core
@pytest.mark.parametrize("make", slow_but_first([paper_lift, mixed_cell]))
def test_on_corners_that_a_user_does_not_tell(golden: Golden, make: Callable[[], Scenario]) -> None:
    task = limited_once(make, 5.0)
    run = golden.start(task, path=lambda: Unsaid(zigzag(task, "linear")), dt=0.01).run(40)
    for i in range(30):  # copies go on from any place within a search
        run.take()
        if i % 7 == 0:
            run.copied()
    assert run.run(1000, noisy(task.cell, size=1e-5)).take().finished


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_on_a_path_that_is_not_known_ahead(golden: Golden, acceleration: float) -> None:
    for make in (paper_lift, dual_arm7):
        task = limited_once(make, acceleration)
        run = golden.start(task, path=lambda task=task: Marked(zigzag(task, "quintic"), known_ahead=False), dt=0.005)
        run.run(250, noisy(task.cell, size=1e-5))
        assert run.seen >= {Status.TRACKING}


#: Modes of the inputs in which rows that brake all arms together are compared.
BLIND = ("nominal", "measured late, with noise", "one arm lags", "samples lost", "uneven steps")


@pytest.mark.slow
@pytest.mark.parametrize("mode", BLIND)
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_all_brake_together_where_a_path_that_is_not_known_ahead_runs_out_of_reach(
    golden: Golden, acceleration: float, mode: str
) -> None:
    """Of two cells one in turn."""
    options, inputs = MODES[mode]
    cells = ((paper_lift, (0.6, 0.2, 0.5)), (mixed_cell, (-0.3, 0.7, 0.1)))
    turn = (BLIND.index(mode) + bool(np.isfinite(acceleration))) % 2
    for make, way in (cells[turn],):
        task = limited_once(make, acceleration)
        line = LinePath.displaced(task.path.pose(0.0), translation=way, duration=1.6, time_law="quintic")
        run = golden.start(task, path=lambda line=line: Marked(line, known_ahead=False), dt=0.008, **options)
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
def test_while_a_users_path_fails(golden: Golden, acceleration: float, jump: float) -> None:
    task = limited_once(mixed_cell, acceleration)
    for known_ahead in (True, False):
        for ahead in (0.0, 0.1):
            # No multiple of a step is where a knot is: rounding would decide whether it is behind already.
            run = golden.start(task, path=lambda: Failing(task.path), dt=0.0047)
            run.controller.path.known_ahead = known_ahead
            run.controller.follow(run.controller.path)
            clock = run.run(77).take().clock_next + ahead
            path = run.controller.path
            assert isinstance(path, Failing)
            path.since, path.jump = clock, jump
            run.run(60, noisy(task.cell, size=1e-5))
            assert Status.HOLDING in run.seen or 0.0 < jump < 1.0
            path.since = np.inf
            run.run(60)


@pytest.mark.slow
@pytest.mark.core
def test_a_users_path_is_followed_like_the_librarys_own(golden: Golden) -> None:
    task = limited_once(paper_lift, 5.0)
    own = golden.start(task, path=lambda: Marked(zigzag(task, "linear")), dt=0.01)
    known = golden.start(task, path=lambda: zigzag(task, "linear"), dt=0.01)
    both = np.array([(own.take().velocity, known.take().velocity) for _ in range(300)])
    np.testing.assert_allclose(both[:, 0], both[:, 1], rtol=0.0, atol=1e-7)


@pytest.mark.core
@pytest.mark.slow
@pytest.mark.parametrize("make", [paper_lift, dual_arm7], ids=lambda make: make.__name__)
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_on_moving_targets(golden: Golden, acceleration: float, make: Callable[[], Scenario]) -> None:
    task = limited_once(make, acceleration)
    start, rng = task.path.pose(0.0), np.random.default_rng(8)
    run = golden.start(task, path=lambda: ServoPath(start), dt=0.005)
    run.same = DISTURBED
    for i in range(8):
        far = 0.6 if i == 4 else 0.05  # once out of reach
        target = pin.SE3(
            start.rotation @ pin.exp3(0.2 * rng.standard_normal(3)),
            start.translation + far * rng.standard_normal(3),
        )
        run.ask(lambda c, T=target: c.retarget(T))
        run.run(25 if i % 3 else 60, noisy(task.cell, size=1e-5) if i % 3 else None)
    assert run.seen >= {Status.TRACKING, Status.SLOWED} or not np.isfinite(acceleration)


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([10.0, np.inf]))
def test_on_targets_that_change_while_the_object_turns(golden: Golden, acceleration: float) -> None:
    """The object's frame is askew to the world, and both halves of its velocity are there as the way is changed."""
    task = limited_once(paper_lift, acceleration)
    start = task.path.pose(0.0)
    run = golden.start(task, path=lambda: ServoPath(start), dt=0.005)
    run.same = DISTURBED
    for turn, way in (((0.3, -0.2, 0.4), (0.02, 0.03, 0.05)), ((-0.2, 0.4, 0.1), (-0.03, 0.0, 0.04)), (None, None)):
        goal = start if turn is None else pin.SE3(start.rotation @ pin.exp3(np.array(turn)), start.translation + way)
        run.ask(lambda c, T=goal: c.retarget(T))
        run.run(30)
    assert run.seen >= {Status.TRACKING}


@pytest.mark.slow
@pytest.mark.core
def test_when_another_path_is_followed_in_motion(golden: Golden) -> None:
    for acceleration in (np.inf, 10.0):
        task = limited_once(mixed_cell, acceleration)
        run = golden.start(task, dt=0.005).run(150)
        for goal in (task.path.pose(0.0), task.path.pose(2.0), task.path.pose(0.5)):
            here = run.controller.path.pose(run.take().clock_next)
            run.ask(lambda c, a=here, b=goal: c.follow(LinePath(a, b, duration=1.0, time_law="linear")))
            run.run(90, noisy(task.cell, size=1e-5))


@pytest.mark.core
@pytest.mark.parametrize("turn", [2.0, 3.1, 3.3])
def test_where_the_object_is_turned_far_off_its_path(golden: Golden, turn: float) -> None:
    """Beyond 2.7 rad and across half a turn, too, with a measurement."""
    for make, acceleration in ((mixed_cell, 10.0), (paper_lift, np.inf)):
        task = limited_once(make, acceleration)
        start = task.path.pose(0.0)
        there = pin.SE3(start.rotation @ pin.exp3(np.array([0.0, 0.0, turn])), start.translation)
        run = golden.start(task, dt=0.005)
        run.ask(lambda c, a=there: c.follow(LinePath(a, a, duration=1.0, time_law="linear")))
        run.same = DISTURBED
        run.run(100, noisy(task.cell, size=1e-5))
        assert run.seen == {Status.OFF_PATH}


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [1e2, 1e3, 1e4, 1e6])
@pytest.mark.parametrize("dt", slow_but_first([0.06, 0.01]))
def test_finishes_however_far_joints_get_in_a_step(golden: Golden, acceleration: float, dt: float) -> None:
    task = limited_once(paper_lift, acceleration)
    start, rng = task.path.pose(0.0), np.random.default_rng(5)
    by = {"translation": rng.normal(size=3) * 0.05, "rotation": rng.normal(size=3) * 0.1}
    run = golden.start(task, path=lambda: LinePath.displaced(start, duration=0.8, **by), dt=dt)
    run.run(int(1.2 / dt))
    assert run.take().clock == 0.8


@pytest.mark.core
def test_after_a_fault_and_a_reset(golden: Golden) -> None:
    task = limited_once(paper_lift, 20.0)
    options = {"supervision": SupervisionOptions(joint_jump=2.0, stall_samples=None)}
    run = golden.start(task, dt=0.005, **options).run(60)
    arm = task.cell.q_slices[1]
    for _ in range(20):
        q = run.told[-1].copy()
        q[arm] += 0.1
        run.take(q)
    assert run.seen >= {Status.FAULT}
    run.run(40)
    assert run.take().status is Status.FAULT
    run.ask(lambda c: c.follow(LinePath(task.path.pose(0.0), task.path.pose(1.0), duration=2.0)))
    run.ask(lambda c: c.reset(task.q_start))
    run.seen.clear()
    run.run(120, noisy(task.cell))
    assert Status.FAULT not in run.seen


# -- what the core leaves to Python ----------------------------------------------------------------------------------


@pytest.mark.core
@pytest.mark.parametrize("solver", slow_but_first(["ldp", "daqp", "proxqp"]))
def test_with_any_solver(golden: Golden, solver: str) -> None:
    loose = 1e-6 if solver == "proxqp" else SAME
    for acceleration in (np.inf, 5.0):
        task = limited_once(at_limit, acceleration)
        run = golden.start(task, dt=0.005, shortcut=False, solver=solver)
        run.same = loose
        run.run(120)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.core
def test_where_the_chain_has_to_part(golden: Golden) -> None:
    """A joint that may hardly move, and one that comes back from outside: no answer keeps the chain.

    The arms start beside their grasps: of no correction at all the share that is lost is a matter of rounding.
    """
    task = paper_lift()
    limits, q = task.cell.limits, task.cell.positions(task.q_start)
    upper, speed = limits.upper.copy(), limits.velocity.copy()
    upper[2] = q[2] - 0.02
    speed[12:] = 1e-3
    cell = task.cell.with_limits(upper=upper, velocity=speed)
    start = cell.moved(task.q_start, 1e-5 * np.random.default_rng(2).standard_normal(cell.nv))
    run = golden.start(dataclasses.replace(task, cell=cell, q_start=start), dt=0.005)
    parted = max(step.given_up.chain for step in [run.take() for _ in range(60)])
    assert parted >= 0.0


@pytest.mark.core
@pytest.mark.parametrize("mode", slow_but_first(["always a QP", "nominal", "one arm lags", "uneven steps"]))
@pytest.mark.parametrize("name", FEW_JOINTS)
def test_arms_with_few_joints(golden: Golden, name: str, mode: str) -> None:
    for acceleration in (np.inf, 5.0):
        run_in(golden, mode, limited_once(functools.partial(ready, name), acceleration), 60, same=DISTURBED)


@pytest.mark.core
def test_arms_with_few_joints_away_from_a_path_that_they_cannot_follow(golden: Golden) -> None:
    """Two SCARAs are told to turn the object about any axis: the look-ahead slows it for what they can."""
    task = limited_once(functools.partial(ready, "scara_pair"), 10.0)
    for seed in (1, 5):
        rng = np.random.default_rng(seed)
        way, turn = 0.15 * rng.normal(size=3), 0.2 * rng.normal(size=3)
        path = LinePath.displaced(task.path.pose(0.0), translation=way, rotation=turn, duration=0.6, time_law="linear")
        run = golden.start(dataclasses.replace(task, path=path), dt=0.01)
        run.same = DISTURBED
        assert run.run(90).seen == {Status.OFF_PATH, Status.SLOWED}


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
def test_with_options_limits_and_inputs_at_random(golden: Golden, seed: int, make: Callable[[], Scenario]) -> None:
    rng = np.random.default_rng(100 + seed)
    task = limits_at_random(limited_once(make, np.inf), rng)
    dt = float(rng.choice([0.004, 0.008, 0.0113]))
    path = way_at_random(task, rng)
    run = golden.start(task, path=lambda: path, dt=dt, **options_at_random(rng))
    run.same = DISTURBED
    run.run(60, inputs_at_random(task, dt, rng))
    assert run.told


@pytest.mark.core
@pytest.mark.parametrize("acceleration", slow_but_first([7.0, np.inf]))
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
def test_on_targets_that_jump_about(golden: Golden, make: Callable[[], Scenario], acceleration: float) -> None:
    """Near, far, out of reach, the same once more, and back, each asked before the last is reached.

    With steps of 8 ms one of the answers lay on the edge at which it is repeated, and rounding chose.
    """
    task = limited_once(make, acceleration)
    start, rng = task.path.pose(0.0), np.random.default_rng(12)
    speed, spin = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0.2, 1.0))
    run = golden.start(task, path=lambda: ServoPath(start, speed=speed, spin=spin), dt=0.0093)
    run.same = DISTURBED
    goal = start
    for far, turn in ((0.001, 0.0), (0.05, 0.1), (0.0, 0.2), (0.7, 0.3), (None, None), (0.02, 0.0), (0.0, 0.0)):
        if far is not None:
            way, about = rng.standard_normal(3), rng.standard_normal(3)
            goal = pin.SE3(start.rotation @ pin.exp3(turn * about), start.translation + far * way)
        run.ask(lambda c, T=goal: c.retarget(T))
        run.run(int(rng.integers(5, 9)), noisy(task.cell, size=1e-5))
    assert run.seen >= {Status.TRACKING}


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [20.0, np.inf])
def test_targets_in_motion_where_joints_allow_the_override_and_not_the_full_rate(
    golden: Golden,
    acceleration: float,
) -> None:
    task = limited_once(two_arms, acceleration)
    task = dataclasses.replace(task, cell=task.cell.with_limits(velocity=0.1 * task.cell.limits.velocity))
    start, rng = task.path.pose(0.0), np.random.default_rng(3)
    run = golden.start(task, path=lambda: ServoPath(start, speed=0.3, spin=0.6), dt=0.008)
    run.same = DISTURBED
    run.ask(lambda c: c.set_override(0.7))
    for i in range(4):
        way, about = rng.standard_normal(3), rng.standard_normal(3)
        goal = pin.SE3(start.rotation @ pin.exp3(0.2 * about), start.translation + 0.1 * way)
        run.ask(lambda c, T=goal: c.retarget(T))
        step = run.take()
        assert i == 0 or "brakes before it goes over" not in step.reason
        run.run(int(rng.integers(4, 9)))
    assert run.take().rate == pytest.approx(0.7)


@pytest.mark.core
@pytest.mark.parametrize("kind", ["wrist", "elbow", "reach"])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_on_the_way_into_a_singularity(golden: Golden, kind: Any, acceleration: float) -> None:
    task = at_singularity(kind, 1, acceleration=acceleration)
    last = task.path.duration
    near = LinePath(task.path.pose(0.0), task.path.pose(last), duration=0.4 * last)
    run = golden.start(task, path=lambda: near, dt=0.012)
    run.same = DISTURBED
    run.run(90)
    assert run.lowest < 1.0


@pytest.mark.core
@pytest.mark.parametrize("known_ahead", [True, False])
@pytest.mark.parametrize("jump", [0.0, 1e-3, 1.0])
def test_where_a_users_path_fails_and_recovers(golden: Golden, jump: float, known_ahead: bool) -> None:
    task = limited_once(mixed_cell, 10.0)
    run = golden.start(task, path=lambda: Failing(task.path, known_ahead=known_ahead), dt=0.0097)
    clock = run.run(25).take().clock_next
    for since, steps in ((clock, 15), (np.inf, 15)):
        path = run.controller.path
        assert isinstance(path, Failing)
        path.since, path.jump = since, jump
        run.run(steps, noisy(task.cell, size=1e-5))
    assert Status.HOLDING in run.seen or jump > 0.0


@pytest.mark.core
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
@pytest.mark.parametrize("known_ahead", [True, False])
def test_on_corners_that_a_user_tells(golden: Golden, make: Callable[[], Scenario], known_ahead: bool) -> None:
    task = limited_once(make, 6.0)
    run = golden.start(task, path=lambda: Marked(zigzag(task, "linear"), known_ahead=known_ahead), dt=0.02)
    run.same = DISTURBED
    run.run(70, noisy(task.cell, size=1e-5))
    assert run.seen >= {Status.TRACKING}


@pytest.mark.core
def test_brakes_beside_a_corner_when_paused_there(golden: Golden) -> None:
    """Between two knots: joints bend on this side of the corner as they do here."""
    task = limited_once(mixed_cell, 5.0)
    run, clocks = golden.start(task, path=lambda: zigzag(task, "linear"), dt=0.02), []
    run.same = DISTURBED
    for _ in range(60):
        clocks.append(run.take().clock_next)
        if abs(clocks[-1] - 1.0) < 0.05:
            paused = run.beside()
            paused.ask(lambda c: c.pause())
            paused.run(3)
    assert clocks[0] < 0.9
    assert clocks[-1] > 1.03


@pytest.mark.core
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
def test_when_paths_of_all_kinds_follow_each_other_in_motion(golden: Golden, acceleration: float) -> None:
    task = limited_once(mixed_cell, acceleration)
    run = golden.start(task, dt=0.01).run(40)
    run.same = DISTURBED
    for kind in ("linear", "quintic", "hold", "waypoints"):
        here = run.controller.path.pose(run.take().clock_next)
        goal, path = task.path.pose(0.5), None
        if kind == "hold":
            path = HoldPath(here, duration=0.2)
        elif kind == "waypoints":
            path = WaypointPath([here, goal, here], durations=[0.3, 0.2], time_law="linear")
        follow: ObjectPath = path or LinePath(here, goal, duration=0.3, time_law=kind)
        run.ask(lambda c, path=follow: c.follow(path))
        run.run(22, noisy(task.cell, size=1e-5))


@pytest.mark.core
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("off", [1e-4, 2e-3])
@pytest.mark.parametrize("acceleration", [np.inf, 10.0])
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
def test_from_starts_beside_the_grasp(
    golden: Golden, make: Callable[[], Scenario], acceleration: float, off: float
) -> None:
    task = limited_once(make, acceleration)
    away = off * np.random.default_rng(14).standard_normal(task.cell.nv)
    run = golden.start(dataclasses.replace(task, q_start=task.cell.moved(task.q_start, away)), dt=0.007)
    run.same = DISTURBED
    run.run(60)
    assert max(np.abs(np.array(run.take().given_up.off_path))) < 0.1


@pytest.mark.core
@pytest.mark.parametrize("mode", ["nominal", "one arm lags", "always a QP"])
def test_with_five_arms(golden: Golden, mode: str) -> None:
    task = ring(arms=5)
    inputs = lagging(task.cell) if mode == "one arm lags" else None
    run: Run = golden.start(task, dt=0.02, shortcut=mode != "always a QP")
    run.run(60, inputs)


@pytest.mark.core
@pytest.mark.parametrize("make", SOME_CELLS, ids=lambda make: make.__name__)
def test_with_a_joint_that_is_locked(golden: Golden, make: Callable[[], Scenario]) -> None:
    """Its limits leave it almost no way: the object goes as far as that."""
    task = halfway(limited_once(make, np.inf))
    q, limits = task.cell.positions(task.q_start), task.cell.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[2], upper[2] = q[2] - 1e-3, q[2] + 1e-3
    for acceleration in (np.inf, 5.0):
        cell = task.cell.with_limits(lower=lower, upper=upper, acceleration=acceleration)
        run = golden.start(dataclasses.replace(task, cell=cell), dt=0.01)
        run.same = DISTURBED
        run.run(40)
