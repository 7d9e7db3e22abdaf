"""The monitor finds each fault of a step where it is made, and none in sound steps; single, many, and recorded ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at

from coopqp import ControlStep, HoldPath, LinePath, ObjectPath, Recording, RobotCell, Status
from coopqp.control.interface import amend
from coopqp.model import CellState
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.moving_grasps import pieces_of
from coopqp.simulation import Monitor, Monitored, Violation, ViolationKind, check_run
from coopqp.spatial import Array

DT = 0.01
Cell = tuple[RobotCell, Array]


@pytest.fixture(scope="module")
def pair(make_cell: Callable[..., RobotCell]) -> Cell:
    """An arm with continuous joints and one without, with accelerations of 5, and a configuration."""
    cell = make_cell(["arm6c", "rx90l"], velocity=2.0, acceleration=5.0)
    return cell, cell.configuration(np.linspace(-0.5, 0.6, cell.nv))


def steps_of(cell: RobotCell, q: Array, velocities: Array, path: ObjectPath | None = None) -> list[ControlStep]:
    """Sound steps along a path that rests, whose joints move at given velocities (T, nv)."""
    grasp, steps = grasp_at(cell, q), []
    path = path or HoldPath(pin.SE3.Identity(), duration=10.0)
    for i, v in enumerate(np.asarray(velocities, dtype=float)):
        q_next = cell.moved(q, DT * v)
        steps.append(
            ControlStep(
                cell=cell, grasp=grasp, path=path, q=q, velocity=v, q_next=q_next, dt=DT, clock=DT * i,
                clock_next=DT * (i + 1), rate=1.0, status=Status.TRACKING,
            )
        )  # fmt: skip
        q = q_next
    return steps


def ramp(cell: RobotCell, j: int, peak: float, acceleration: float = 4.0) -> Array:
    """Velocities of one joint up to a peak and back to rest."""
    n = math.ceil(peak / (acceleration * DT))
    up = np.linspace(0.0, peak, n + 1)[1:]
    out = np.zeros((2 * n, cell.nv))
    out[:, j] = [*up, *up[-2::-1], 0.0]
    return out


def judge(cell: RobotCell, q: Array, steps: list[ControlStep]) -> Monitor:
    monitor = Monitor(cell, grasp_at(cell, q), kinematics=False)
    monitor.observe_all(steps)
    return monitor


def violations(monitor: Monitor) -> tuple[Violation, ...]:
    return monitor.verdict().violations


def test_sound_steps_are_kept_and_their_figures_are_those_of_the_motion(pair: Cell) -> None:
    cell, q = pair
    verdict = judge(cell, q, steps_of(cell, q, ramp(cell, 7, 0.8))).verdict()
    assert verdict.ok
    assert verdict.steps == 40
    assert verdict.worst.velocity == pytest.approx(0.8 - 2.0)
    assert verdict.worst.acceleration == pytest.approx(4.0 / 5.0 - 1.0)
    assert str(verdict).startswith("kept: 40 steps; ")
    assert not Monitor(cell, grasp_at(cell, q)).verdict().ok, "nothing was checked"


def test_a_continuous_joint_may_turn_through_half_a_turn(pair: Cell) -> None:
    cell, _ = pair
    j = next(int(joint.idx_v) for joint in cell.model.joints if joint.nq == 2)
    q = cell.configuration(np.where(np.arange(cell.nv) == j, math.pi - 0.05, 0.1))
    assert judge(cell, q, steps_of(cell, q, ramp(cell, j, 0.8))).verdict().ok
    steps = steps_of(cell, q, np.zeros((3, cell.nv)))
    at = int(next(joint.idx_q for joint in cell.model.joints if joint.nq == 2))
    shorter = np.array(q)
    shorter[at : at + 2] *= 0.99
    (found,) = violations(judge(cell, q, [*steps[:2], steps[2].replaced(q_next=shorter)]))
    assert (found.kind, found.detail, found.step) == (ViolationKind.CONTINUITY, "off the unit circle", 2)
    assert found.amount == pytest.approx(0.01, rel=1e-6)


def changed(values: Array, j: int, by: float) -> Array:
    out = np.array(values)
    out[j] += by
    return out


def as_it_is(step: ControlStep, **changes: Any) -> ControlStep:
    """A step with fields that the constructor would correct or refuse."""
    other = step.replaced()
    amend(other, **changes)
    return other


K = ViolationKind
FAULTS: list[tuple[Callable[[ControlStep], ControlStep], ViolationKind, float, str]] = [
    (lambda s: s.replaced(rate=1.25, clock_next=s.clock + 1.25 * DT), K.RATE, 0.25, "σ in [0, 1]"),
    (lambda s: s.replaced(rate=0.5), K.CLOCK, 0.5 * DT, "does not advance by σ dt"),
    (lambda s: s.replaced(clock_next=s.clock + 0.5 * DT), K.CLOCK, 0.5 * DT, "does not advance by σ dt"),
    (lambda s: s.replaced(rate=0.0, sense=0), K.CLOCK, DT, "does not advance by σ dt"),
    (lambda s: s.replaced(clock=s.clock + 0.5, clock_next=s.clock_next + 0.5), K.CLOCK, 0.5, "jumps"),
    (lambda s: s.replaced(q_next=changed(s.q_next, 9, 1e-4)), K.CONTINUITY, 1e-4, "q_next is not q + v dt"),
]


@pytest.mark.parametrize(("spoil", "kind", "amount", "detail"), FAULTS)
def test_each_fault_of_the_last_step_is_found_with_its_amount(
    pair: Cell, spoil: Callable[[ControlStep], ControlStep], kind: ViolationKind, amount: float, detail: str
) -> None:
    cell, q = pair
    steps = steps_of(cell, q, np.zeros((6, cell.nv)))
    for parts in ([[*steps[:5], spoil(steps[5])]], [[s] for s in [*steps[:5], spoil(steps[5])]]):
        monitor = Monitor(cell, grasp_at(cell, q), kinematics=False)
        for part in parts:
            monitor.observe_all(part)
        (found,) = violations(monitor)
        assert (found.kind, found.step, found.detail) == (kind, 5, detail)
        assert found.amount == pytest.approx(amount, rel=1e-6)
        assert found.time == pytest.approx(6 * DT)


@pytest.mark.parametrize("dt", [0.0, -DT])
def test_a_step_without_a_length_is_found(pair: Cell, dt: float) -> None:
    cell, q = pair
    steps = steps_of(cell, q, np.zeros((2, cell.nv)))
    still = steps[1].replaced(dt=dt, clock_next=steps[1].clock, rate=0.0)
    (found,) = [v for v in violations(judge(cell, q, [steps[0], still])) if v.kind is K.RATE]
    assert (found.step, found.amount, found.detail) == (1, 1.0, "dt > 0")
    assert found.time == pytest.approx(DT + dt)


def test_limits_of_a_joint_are_judged_with_their_amounts(pair: Cell) -> None:
    cell, q = pair
    fast = np.zeros((4, cell.nv))
    fast[1:3, 8] = -2.5  # from rest in one step, and back
    found = violations(judge(cell, q, steps_of(cell, q, fast)))
    assert [(v.kind, v.step, v.arm, v.joint) for v in found if v.kind is K.VELOCITY] == [
        (K.VELOCITY, 1, "1_rx90l", "joint_3"), (K.VELOCITY, 2, "1_rx90l", "joint_3")
    ]  # fmt: skip
    assert [(v.step, v.joint) for v in found if v.kind is K.ACCELERATION] == [(1, "joint_3"), (3, "joint_3")]
    np.testing.assert_allclose([v.amount for v in found if v.kind is K.VELOCITY], 0.5)
    np.testing.assert_allclose([v.amount for v in found if v.kind is K.ACCELERATION], 2.5 / (5.0 * DT) - 1.0)
    assert len(found) == 4


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_outside_may_come_back_and_not_move_on(pair: Cell, side: float) -> None:
    cell, q = pair
    j = 10
    end = cell.limits.upper[j] if side > 0.0 else cell.limits.lower[j]
    x = np.array(cell.positions(q))
    x[j] = end + side * 0.02
    outside = cell.configuration(x)
    inwards, outwards = (steps_of(cell, outside, direction * side * ramp(cell, j, 0.04)) for direction in (-1.0, 1.0))
    assert judge(cell, outside, inwards).verdict().ok
    found = violations(judge(cell, outside, outwards[:1]))
    assert [(v.kind, v.step, v.joint) for v in found] == [(K.POSITION, 0, "joint_5")]
    assert found[0].amount == pytest.approx(0.04 * DT)


def test_sound_steps_around_malformed_ones_are_judged_all_the_same(pair: Cell) -> None:
    """In one call as in one call for each; a malformed step is counted, and the next is not compared with it."""
    cell, q = pair
    good = steps_of(cell, q, np.zeros((9, cell.nv)))
    fast = np.zeros(cell.nv)
    fast[0] = 0.2
    bad = [
        good[0],
        as_it_is(good[1], velocity=np.full(cell.nv, np.nan)),
        good[2].replaced(rate=2.0, clock_next=good[2].clock + 2 * DT),
        as_it_is(good[3], q_next=good[3].q_next[:-1]),
        as_it_is(good[4], dt=1),
        good[5].replaced(velocity=fast, q_next=cell.moved(q, DT * fast)),
        good[6],
        as_it_is(good[7], rate=math.inf),
    ]
    whole, single = (Monitor(cell, grasp_at(cell, q), kinematics=False) for _ in range(2))
    told = whole.observe_all(bad)
    one_by_one = [v for step in bad for v in single.observe(step)]
    assert list(map(str, told)) == list(map(str, one_by_one))
    assert whole.verdict().steps == single.verdict().steps == 8
    assert [(v.kind, v.step) for v in told] == [
        (K.NOT_FINITE, 1), (K.RATE, 2), (K.FORM, 3), (K.FORM, 4), (K.ACCELERATION, 6), (K.CONTINUITY, 6),
        (K.NOT_FINITE, 7),
    ]  # fmt: skip
    assert told[0].detail == "velocity[0]"
    assert (told[0].arm, told[0].joint) == ("0_arm6c", cell.joint_names[0].partition("/")[2])
    assert told[2].detail == f"q_next of shape ({cell.nq},)"
    assert told[3].detail == "dt is no float"
    assert told[-1].detail == "rate"


@pytest.mark.parametrize(
    ("changes", "detail"),
    [
        ({"sense": 2}, "sense is not -1, 0 or 1"),
        ({"status": "tracking"}, "status or reason"),
        ({"reason": None}, "status or reason"),
        ({"clock": 1}, "clock is no float"),
        ({"clock_next": np.float32(0.5)}, "clock_next is no float"),
        ({"q": [0.0]}, "q of shape"),
    ],
)
def test_the_wrong_form_of_a_step_is_named(pair: Cell, changes: dict[str, Any], detail: str) -> None:
    cell, q = pair
    (step,) = steps_of(cell, q, np.zeros((1, cell.nv)))
    (found,) = Monitor(cell, grasp_at(cell, q)).observe(as_it_is(step, **changes))
    assert found.kind is K.FORM
    assert found.detail.startswith(detail)


def test_a_holding_object_must_rest_once_its_joints_could_brake(pair: Cell) -> None:
    """From 1 rad/s at 5 rad/s² the braking time is 0.2 s: after 1.1 times that and two steps, σ must be 0."""
    cell, q = pair
    steps = steps_of(cell, q, np.vstack([ramp(cell, 7, 1.0)[:25], np.full((40, cell.nv), 0.0)]))
    moving = np.zeros((40, cell.nv))
    moving[:, 7] = 1.0
    on = steps_of(cell, steps[24].q_next, moving)
    held = [s.replaced(clock=s.clock + 0.25, clock_next=s.clock_next + 0.25, status=Status.HOLDING) for s in on]
    found = violations(judge(cell, q, [*steps[:25], *held]))
    assert {v.kind for v in found} == {K.HOLDING}
    assert [v.step for v in found] == list(range(25 + 24, 65))
    assert {v.amount for v in found} == {1.0}
    free = [s.replaced(status=Status.TRACKING) if i == 20 else s for i, s in enumerate(held)]
    assert [v.step for v in violations(judge(cell, q, [*steps[:25], *free]))] == []


def test_violations_are_counted_beyond_those_that_are_kept_and_forgotten_at_a_reset(pair: Cell) -> None:
    cell, q = pair
    steps = [s.replaced(rate=1.5, clock_next=s.clock + 1.5 * DT) for s in steps_of(cell, q, np.zeros((1, cell.nv)))] * 5
    monitor = Monitor(cell, grasp_at(cell, q), kinematics=False, keep=3)
    for step in steps:
        monitor.observe(step)
        monitor.restart()
    verdict = monitor.verdict()
    assert (verdict.steps, len(verdict.violations), dict(verdict.counts)) == (5, 3, {K.RATE: 5})
    assert [v.step for v in verdict.violations] == [0, 1, 2]
    np.testing.assert_allclose([v.time for v in verdict.violations], [DT, 2 * DT, 3 * DT])
    assert "violated: 5 x rate out of range; 5 steps;" in str(verdict)
    assert "step 1 (0.0200 s): rate out of range, 0.5 too much (σ in [0, 1])" in str(verdict)
    monitor.report(K.MUTATED, arm="0_arm6c", amount=2.0, detail="by hand")
    assert monitor.verdict().counts[K.MUTATED] == 1
    monitor.reset()
    assert (monitor.verdict().steps, monitor.verdict().counts) == (0, {})
    for step in steps_of(cell, q, np.zeros((3, cell.nv))):
        monitor.report(K.MUTATED, detail=f"at {monitor.verdict().steps}")
        monitor.observe(step)
    told = [(v.detail, v.step, round(v.time, 9)) for v in monitor.verdict().violations]
    assert told == [("at 0", 0, 0.0), ("at 1", 0, DT), ("at 2", 1, 2 * DT)]


# -- arms and the object -----------------------------------------------------------------------------------------------


def test_arms_that_part_and_an_object_off_its_path_are_named(pair: Cell) -> None:
    cell, q = pair
    grasp = grasp_at(cell, q)
    T = CellState(cell, q).T_world_tool[0]
    path = HoldPath(T, duration=10.0)  # the frame of the object is that of the first tool
    away = HoldPath(pin.SE3(T.rotation, T.translation + np.array([0.0, 0.0, 3e-3])), duration=10.0)
    steps = steps_of(cell, q, np.zeros((3, cell.nv)), path)
    assert not Monitor(cell, grasp).observe_all(steps)
    off = Monitor(cell, grasp, away)
    found = off.observe_all(steps)
    assert {(v.kind, v.detail) for v in found} == {(K.PATH, "[m]")}
    assert [v.step for v in found] == [0, 1, 2]
    np.testing.assert_allclose([v.amount for v in found], 2e-3, atol=1e-9)
    assert off.verdict().worst.path_m == pytest.approx(3e-3)
    moved = np.zeros((3, cell.nv))
    moved[1:, -1] = 0.04, 0.0  # the flange of the second arm turns by 0.4 mrad
    wide = Monitor(cell, grasp, path, tolerances={"object_mm": 1e3, "object_deg": 90.0, "chain_deg": 0.01})
    parted = wide.observe_all(steps_of(cell, q, moved, path))
    assert [(v.kind, v.step, v.arm, v.detail) for v in parted if v.detail == "[rad]"] == [
        (K.CHAIN, 1, "1_rx90l", "[rad]"), (K.CHAIN, 2, "1_rx90l", "[rad]")
    ]  # fmt: skip
    assert wide.verdict().worst.chain_rad == pytest.approx(4e-4, rel=1e-6)
    assert parted[-1].amount == pytest.approx(4e-4 - math.radians(0.01), rel=1e-5)


class Sliding(ObjectPath):
    """The object rests while the tool of the second arm slides on it."""

    duration = 10.0

    def __init__(self, pose: pin.SE3, slide: pin.SE3) -> None:
        self._pose = pose
        same = pin.SE3.Identity()
        way = LinePath(same, slide, duration=0.02)
        pieces = pieces_of(way, start=0.0, before=same, frame=same, where="")
        self.grasps = GraspMotion(((), pieces), ((0.0, (True, True)),))

    def pose(self, clock: float) -> pin.SE3:
        """Where the object rests."""
        return self._pose

    def twist(self, clock: float) -> Array:
        """Zero."""
        return np.zeros(6)


def test_a_tool_that_is_to_move_on_the_object_is_judged_where_it_is_then(pair: Cell) -> None:
    cell, q = pair
    now = grasp_at(cell, q)
    slide = pin.SE3(pin.exp3(np.array([0.0, 0.1, 0.0])), np.array([0.01, 0.0, 0.02]))
    first = replace(now, T_object_tool=(now.T_object_tool[0], slide.inverse() * now.T_object_tool[1]))
    path = Sliding(CellState(cell, q).T_world_tool[0], slide)
    steps = steps_of(cell, q, np.zeros((5, cell.nv)), path)
    found = Monitor(cell, first).observe_all(steps)
    assert {v.step for v in found} == {0}, "the tool is there from the end of the second step on"
    assert {v.arm for v in found} == {"1_rx90l"}


# -- recorded runs -----------------------------------------------------------------------------------------------------


def recorded(cell: RobotCell, q: Array, steps: int = 12, **changes: Any) -> Recording:
    """A run at rest whose clock goes on."""
    pose = CellState(cell, q).T_world_tool[0].homogeneous
    time, rows = DT * np.arange(steps + 1.0), np.tile(q, (steps + 1, 1))
    made = Recording(
        time=time, q=rows, q_command=rows, velocity=np.zeros((steps, cell.nv)), clock=time, rate=np.ones(steps),
        status=np.zeros(steps), reference=np.tile(pose, (steps + 1, 1, 1)),
        T_object_tool=np.array([X.homogeneous for X in grasp_at(cell, q).T_object_tool]), notes=(), metadata={},
    )  # fmt: skip
    return replace(made, **changes)


@pytest.mark.parametrize(
    ("name", "row", "lost"),
    [
        ("q_command", 5, {4, 5}),
        ("clock", 5, {4, 5}),
        ("time", 5, {4, 5}),
        ("velocity", 5, {5}),
        ("rate", 5, {5}),
        ("q_command", 0, {0}),
        ("clock", 12, {11}),
    ],
)
def test_steps_of_a_recording_that_are_no_numbers_are_found_and_the_others_judged(
    pair: Cell, name: str, row: int, lost: set[int]
) -> None:
    cell, q = pair
    rate = np.ones(12)
    rate[8] = 1.5  # and a fault of a sound step
    run = recorded(cell, q, rate=rate)
    values = np.array(getattr(run, name))
    values.reshape(len(values), -1)[row, -1] = np.nan
    changes: dict[str, Any] = {name: values}
    verdict = check_run(replace(run, **changes), cell)
    assert {v.step for v in verdict.violations if v.kind is K.NOT_FINITE} == lost
    assert {v.kind for v in verdict.violations} == {K.NOT_FINITE, K.RATE, K.CLOCK}
    assert {v.step for v in verdict.violations if v.kind is not K.NOT_FINITE} == {8}
    assert verdict.steps == 12


def test_a_recorded_clock_may_fall_on_the_way_back_and_stand_by_hand(pair: Cell) -> None:
    """Its steps back are as long as those ahead; a clock that moves by hand is a fault."""
    cell, q = pair
    clock = DT * np.array([0, 1, 2, 3, 4, 4, 4, 3, 2, 1, 0, 0, 0], dtype=float)
    status = np.zeros(12)
    status[4:6] = status[10:] = Status.JOGGING.code
    run = recorded(cell, q, clock=clock, status=status)
    assert check_run(run, cell).ok
    short = clock.copy()
    short[9:] = 1.5 * DT, 0.5 * DT, 0.5 * DT, 0.5 * DT
    found = check_run(replace(run, clock=short), cell).violations
    assert [(v.kind, v.step) for v in found] == [(K.CLOCK, 8)]
    assert found[0].amount == pytest.approx(0.5 * DT)
    drifted = clock.copy()
    drifted[6] += 1e-4
    assert {(v.kind, v.step) for v in check_run(replace(run, clock=drifted), cell).violations} == {
        (K.CLOCK, 5), (K.CLOCK, 6)
    }  # fmt: skip


def test_a_recorded_hold_must_come_to_rest_and_the_last_step_may_be_short(pair: Cell) -> None:
    cell, q = pair
    status = np.zeros(12)
    status[3:8] = Status.HOLDING.code
    run = recorded(cell, q, status=status)
    assert {(v.kind, v.step) for v in check_run(run, cell).violations} == {(K.HOLDING, step) for step in range(5, 8)}
    clock = np.array(recorded(cell, q).clock)
    clock[-1] -= 0.4 * DT
    ends = recorded(cell, q, clock=clock, metadata={"duration": float(clock[-1])})
    assert check_run(ends, cell).ok
    assert {v.step for v in check_run(replace(ends, metadata={}), cell).violations} == {11}


# -- a monitored controller --------------------------------------------------------------------------------------------


class Repeating:
    """A controller at rest that writes all its steps into the same memory after a reset, or always."""

    dt = DT
    path = HoldPath(pin.SE3.Identity(), duration=10.0)

    def __init__(self, cell: RobotCell, q: Array, *, always: bool) -> None:
        self.cell, self.grasp, self._always = cell, grasp_at(cell, q), always
        self._shared = np.array(q)
        self._count = 0

    def reset(self, q: Any) -> None:
        self._shared[:] = q
        self._count = 0

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        q = self._shared if self._always or self._count == 0 else self._shared.copy()
        (step,) = steps_of(self.cell, q, np.zeros((1, self.cell.nv)), self.path)
        made = step.replaced(clock=DT * self._count, clock_next=DT * (self._count + 1))
        amend(made, q=q)
        self._count += 1
        return made


def test_steps_from_before_a_reset_may_be_written_over(pair: Cell) -> None:
    cell, q = pair
    tolerances = dict.fromkeys(("chain_mm", "chain_deg", "object_mm", "object_deg"), 1e9)
    made = Repeating(cell, q, always=True)
    watched = Monitored(made, Monitor(cell, made.grasp, tolerances=tolerances))
    x = np.array(cell.positions(q))
    for k in range(3):
        watched.reset(cell.configuration(x + 0.01 * k))
        watched.step()
    assert watched.verdict().ok
    watched.step()
    made.reset(q)  # not through the monitor: the last step is changed behind its back
    watched.step()
    counts = watched.verdict().counts
    assert counts[K.MUTATED] == 1
    assert [v.detail for v in watched.verdict().violations if v.kind is K.MUTATED] == ["q of the step before"]
