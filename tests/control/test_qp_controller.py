"""The cooperative QP controller: its promises for any cell, frame, order of arms and units."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import with_mismatch
from marks import slow_but_first, slow_unless
from runs import built, drive

from coopqp import (
    Arm,
    CommonError,
    ControlStep,
    Grasp,
    HoldPath,
    InvalidInputError,
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
    WaypointPath,
    inverse_kinematics,
)
from coopqp.baselines import IndependentQPController, PseudoInverseController
from coopqp.control import RankWeights
from coopqp.errors import UnknownNameError
from coopqp.paths import TimeLaw
from coopqp.scenarios import (
    LOADED,
    PROGRAMS,
    SCENARIOS,
    Scenario,
    at_limit,
    at_singularity,
    dual_arm7,
    fast_lift,
    five_joint_pair,
    mixed_cell,
    paper_lift,
    ring,
    scara_pair,
)
from coopqp.scenarios.paper import three_rx90l
from coopqp.simulation import (
    chain_error,
    limit_excess,
    object_error,
    path_error,
    relative_positioning_error,
    tool_placements,
)
from coopqp.spatial import Array

pytestmark = pytest.mark.core

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"
MM = 1e-3


def run(task: Scenario, *, longest: int = 6000, **options: Any) -> list[ControlStep]:
    """Until the path is finished or the object has stopped for 20 steps."""
    return drive(built(task, **options), longest, rest=20)


def chain_of(task: Scenario, steps: Sequence[ControlStep]) -> Array:
    """Chain error after each step [m]."""
    return np.array([chain_error(T, task.grasp)[0] for T in tool_placements(task.cell, [s.q_next for s in steps])])


def off_path(task: Scenario, steps: Sequence[ControlStep]) -> Array:
    """Path error after each step [m]."""
    tools = tool_placements(task.cell, [s.q_next for s in steps])
    return np.array([path_error(T, task.grasp, s.path, s.clock_next)[0] for T, s in zip(tools, steps, strict=True)])


def excess(task: Scenario, steps: Sequence[ControlStep]) -> float:
    return limit_excess(task.cell, [steps[0].q, *(s.q_next for s in steps)], [s.velocity for s in steps])


def acceleration_used(task: Scenario, steps: Sequence[ControlStep]) -> float:
    """Largest used share of an acceleration limit, including the start from rest."""
    v = np.array([np.zeros(task.cell.nv), *(s.velocity for s in steps)])
    return float((np.abs(np.diff(v, axis=0)) / (steps[0].dt * task.cell.limits.acceleration)).max())


# -- invariance --------------------------------------------------------------------------------------------------------


def a_task_in_another_world(task: Scenario, W: pin.SE3) -> Scenario:
    path = task.path
    assert isinstance(path, LinePath)
    return replace(
        task,
        cell=RobotCell([arm.placed(W * arm.T_world_base) for arm in task.cell.arms]),
        path=LinePath(W * path.start, W * path.goal, duration=path.duration, time_law=path.time_law),
    )


@pytest.mark.parametrize("shortcut", [True, False])
@pytest.mark.parametrize("scenario", [fast_lift, dual_arm7, mixed_cell, at_limit])
def test_the_world_frame_does_not_matter(scenario: Callable[..., Scenario], shortcut: bool) -> None:
    task = scenario()
    pin.seed(3)
    moved = a_task_in_another_world(task, pin.SE3.Random())
    pairs = zip(
        run(task, dt=0.005, longest=200, shortcut=shortcut),
        run(moved, dt=0.005, longest=200, shortcut=shortcut),
        strict=True,
    )
    for a, b in pairs:
        assert np.abs(a.velocity - b.velocity).max() < 2e-7
        assert a.rate == pytest.approx(b.rate, abs=1e-7)
        assert a.status is b.status


@pytest.mark.parametrize("scenario", [fast_lift, at_limit, dual_arm7])
def test_the_unit_of_time_does_not_matter(scenario: Callable[..., Scenario]) -> None:
    """With all speeds, limits and gains ten times slower, the configurations of the steps are the same."""
    task, slow = scenario(), 10.0
    path = task.path
    assert isinstance(path, LinePath)
    limits = task.cell.limits
    slowed = replace(
        task,
        cell=task.cell.with_limits(velocity=limits.velocity / slow, acceleration=limits.acceleration / slow**2),
        path=LinePath(path.start, path.goal, duration=path.duration * slow, time_law=path.time_law),
    )
    o, p = QPOptions(), PreviewOptions()
    scaled = {
        "grasp_gain": o.grasp_gain / slow,
        "path_gain": o.path_gain / slow,
        "correction_speed": o.correction_speed / slow,
        "correction_spin": o.correction_spin / slow,
        "posture": PostureOptions(gain=PostureOptions().gain / slow),
        "preview": PreviewOptions(cell=p.cell * slow, shortest=p.shortest * slow, rate_slope=p.rate_slope / slow),
        "weights": RankWeights(off_path=o.weights.off_path * slow**2, recovery=o.weights.recovery * slow**2),
    }
    a_steps = run(task, dt=0.004, longest=250)
    b_steps = run(slowed, dt=0.004 * slow, longest=250, **scaled)
    for a, b in zip(a_steps, b_steps, strict=True):
        assert np.abs(a.q_next - b.q_next).max() < 2e-6
        assert a.rate == pytest.approx(b.rate, abs=2e-4)


# -- one behaviour by every way of solving -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "alike"),
    [(fast_lift, 2e-5), (five_joint_pair, 2e-5), (mixed_cell, 1e-3)],
    ids=["six", "five", "mixed"],
)
def test_shortcut_and_solver_change_nothing_that_matters(scenario: Callable[..., Scenario], alike: float) -> None:
    """The null-space motion of redundant arms may differ; the other arms and the object move alike."""
    task = scenario()
    task = replace(task, cell=task.cell.with_limits(velocity=np.minimum(task.cell.limits.velocity, 0.3)))
    reference = run(task, dt=0.01, longest=120)
    bound = np.concatenate([np.arange(s.start, s.stop) for s in task.cell.v_slices if s.stop - s.start <= 6])
    ways: list[dict[str, Any]] = [{"shortcut": False}]
    ways += [{"shortcut": False, "solver": name} for name in ("proxqp", "osqp")]
    for way in ways:
        steps = run(task, dt=0.01, longest=120, **way)
        for a, b in zip(reference, steps, strict=True):
            assert np.abs(a.velocity - b.velocity)[bound].max() < alike, way
            assert a.rate == pytest.approx(b.rate, abs=5.0 * alike), way
        assert chain_of(task, steps).max() < 1e-2 * MM, way
        assert excess(task, steps) == 0.0, way


def test_a_target_that_moves_is_followed_by_any_solver() -> None:
    task, start = paper_lift(), paper_lift().path.pose(0.0)

    def followed(**options: Any) -> list[ControlStep]:
        controller = built(replace(task, path=ServoPath(start, speed=0.1)), dt=0.01, **options)
        steps = []
        for i in range(100):
            if i % 7 == 0:
                controller.retarget(start * pin.SE3(np.eye(3), 0.08 * np.sin([i / 40, i / 15, i / 23])))
            steps.append(controller.step())
        return steps

    for a, b in zip(followed(), followed(shortcut=False, solver="proxqp"), strict=True):
        assert np.abs(a.q_next - b.q_next).max() < 1e-6


# -- whose view of the object counts -----------------------------------------------------------------------------------

SHIFT, TURN = (0.002, -0.003, 0.001), (0.004, 0.002, -0.003)


def views(task: Scenario, steps: Sequence[ControlStep], arm: int) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between an arm's object pose and the path."""
    errors = [
        object_error(T, task.grasp, task.path.pose(s.clock_next), arm)
        for T, s in zip(tool_placements(task.cell, [s.q_next for s in steps]), steps, strict=True)
    ]
    return max(e[0] for e in errors), max(e[1] for e in errors)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("master", [0, 1, 2])
def test_master_slave_the_object_is_where_the_master_carries_it(master: int) -> None:
    """The slaves correct all of a mismatch; the master's object pose never leaves the path."""
    task = with_mismatch(paper_lift(time_law=TimeLaw.QUINTIC), 1, SHIFT, TURN)
    if master == 1:  # the master itself starts off the path by its own mismatch: let the path start at its view
        task = replace(
            task,
            path=LinePath.displaced(
                task.path.pose(0.0) * pin.SE3(pin.exp3(np.array(TURN, dtype=float)), np.array(SHIFT)).inverse(),
                translation=(0.0, 0.0, 0.3),
                duration=3.0,
            ),
        )
    steps = run(task, common_error=CommonError.leader(master))
    d, a = views(task, steps, master)
    assert d < 1e-3 * MM
    assert a < 1e-6
    assert chain_of(task, steps)[-1] < 1e-6 * MM


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_leaderless_all_arms_give_way_alike() -> None:
    task = with_mismatch(paper_lift(time_law=TimeLaw.QUINTIC), 1, SHIFT)
    steps = run(task, common_error=CommonError.leaderless(), path_gain=0.0)
    at_end = [views(task, steps[-1:], k)[0] for k in range(3)]
    assert np.ptp(at_end) < 1e-5 * MM
    assert at_end[0] == pytest.approx(np.linalg.norm(SHIFT) / 3.0, rel=0.02)  # they meet at the mean pose
    corrected = run(task, common_error=CommonError.leaderless())
    assert off_path(task, corrected)[-1] < 1e-5 * MM  # the path gain then leads the object back


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_driver_orients_and_master_positions() -> None:
    """The paper's mode I: the master determines the object's position, the driver its orientation."""
    task = with_mismatch(paper_lift(time_law=TimeLaw.QUINTIC), 0, (0, 0, 0), TURN)
    task = with_mismatch(task, 2, SHIFT)
    strategy = CommonError.driver(leader="master", driver="slave_2")
    steps = run(task, common_error=strategy, path_gain=0.0)
    positions, angles = zip(*(views(task, steps, k) for k in range(3)), strict=True)
    assert positions[0] < 0.05 * MM  # second order in the mismatch
    assert angles[2] < 1e-5
    assert angles[0] > 0.8 * np.linalg.norm(TURN)
    assert positions[2] > 0.8 * np.linalg.norm(SHIFT)
    assert chain_of(task, steps)[-1] < 1e-6 * MM
    # With only a master, the driver turns to the master's orientation.
    other = run(task, common_error=CommonError.leader("master"), path_gain=0.0)
    assert views(task, other, 0)[1] == pytest.approx(np.linalg.norm(TURN), rel=0.02)
    assert views(task, other[-1:], 2)[1] == pytest.approx(np.linalg.norm(TURN), rel=0.02)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_weights_per_axis_are_what_the_strategies_are_made_of() -> None:
    task = with_mismatch(paper_lift(), 1, SHIFT, TURN)
    weights = np.zeros((3, 6))
    weights[0] = 1.0
    a = run(task, longest=50, common_error=CommonError.per_axis(weights))
    b = run(task, longest=50, common_error=CommonError.leader())
    assert all(np.array_equal(x.velocity, y.velocity) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize(
    "weights", [np.ones((3, 6)), np.eye(6), -np.ones((3, 6)), "all", np.full((3, 6), np.nan), [[1.0] * 6, [0.0] * 6]]
)
def test_weights_that_do_not_fit(weights: Any) -> None:
    with pytest.raises(InvalidInputError, match="CommonError"):
        built(paper_lift(), common_error=CommonError.per_axis(weights))
    with pytest.raises(UnknownNameError, match="Did you mean 'slave_1'"):
        built(paper_lift(), common_error=CommonError.leader("slave1"))


# -- drift and its correction ------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_a_step_never_corrects_more_than_the_whole_error() -> None:
    """K dt ≤ 1: with an absurd gain the mismatch is zero after one step and stays zero."""
    task = paper_lift()
    task = replace(task, path=HoldPath(task.path.pose(0.0), duration=0.05))
    task = with_mismatch(task, 1, (5e-5, 0.0, 0.0))
    steps = run(task, dt=0.002, grasp_gain=1e9, path_gain=1e9, correction_speed=10.0, correction_spin=10.0)
    errors = chain_of(task, steps)
    assert errors[0] < 1e-8
    assert errors.max() < 1e-8


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("gain", [2.0, 20.0, 100.0])
def test_the_mismatch_decays_with_the_gain(gain: float) -> None:
    task = paper_lift()
    task = replace(task, path=HoldPath(task.path.pose(0.0), duration=0.2))
    task = with_mismatch(task, 1, (1e-4, -2e-4, 1e-4))
    errors = chain_of(task, run(task, dt=0.002, grasp_gain=gain))
    ratio = errors[10:60] / errors[9:59]
    assert np.abs(ratio - (1.0 - gain * 0.002)).max() < 2e-3


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_without_gain_the_mismatch_stays() -> None:
    task = with_mismatch(paper_lift(time_law=TimeLaw.QUINTIC), 1, SHIFT)
    errors = chain_of(task, run(task, grasp_gain=0.0, path_gain=0.0))
    assert errors[-1] == pytest.approx(np.linalg.norm(SHIFT), rel=1e-3)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize(("speed", "spin"), [(0.01, 1.0), (1.0, 0.01)])
def test_corrections_are_bounded(speed: float, spin: float) -> None:
    task = paper_lift()
    task = replace(task, path=HoldPath(task.path.pose(0.0), duration=0.3))
    task = with_mismatch(task, 1, (0.004, 0.0, 0.0), (0.0, 0.006, 0.0))
    steps = run(task, dt=0.002, correction_speed=speed, correction_spin=spin)
    T = tool_placements(task.cell, [steps[0].q, *(s.q_next for s in steps)])
    O = [t[1] * task.grasp.T_object_tool[1].inverse() for t in T]
    moved = np.array([pin.log6(a.actInv(b)).vector for a, b in itertools.pairwise(O)]) / 0.002
    fastest = np.linalg.norm(moved[:, :3], axis=1).max() / speed, np.linalg.norm(moved[:, 3:], axis=1).max() / spin
    assert max(fastest) == pytest.approx(1.0, rel=0.01)


def order_of_accuracy(numbers: Sequence[int]) -> Array:
    """ε_p [m] of the paper's lift in N steps."""
    task = paper_lift()
    figures = []
    for N in numbers:
        steps = run(task, dt=3.0 / N)
        tools = tool_placements(task.cell, [s.q_next for s in steps])
        figures.append(max(relative_positioning_error(T, task.grasp) for T in tools))
    return np.array(figures)


@pytest.mark.slow
def test_half_the_step_divides_the_drift_by_eight() -> None:
    """It is of third order in the step."""
    errors = order_of_accuracy((200, 400, 800))  # longer steps are linearised twice by themselves
    assert np.all(errors[:-1] / errors[1:] > 7.0)


@pytest.mark.parametrize(("steps", "bound"), [(40, 0.003), (400, 3e-6), (1000, 2e-7)])
def test_drift_of_the_papers_lift(steps: int, bound: float) -> None:
    """The paper's open question, complete elimination of cumulative errors, in figures [mm]."""
    task = paper_lift()
    made = run(task, dt=3.0 / steps)
    tools = tool_placements(task.cell, [s.q_next for s in made])
    assert 1e3 * max(relative_positioning_error(T, task.grasp) for T in tools) < bound
    assert len(made) == steps
    assert all(s.status is Status.TRACKING for s in made)


# -- the object's clock ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("time_law", TimeLaw)
def test_the_final_pose_is_held(time_law: TimeLaw, acceleration: float) -> None:
    task = paper_lift(time_law=time_law, duration=1.0)
    task = replace(task, cell=task.cell.with_limits(acceleration=acceleration), dt=0.002)
    controller = built(task)
    steps = drive(controller, rest=20)
    assert steps[-1].finished
    assert steps[-1].clock_next == 1.0
    after = [controller.step() for _ in range(200)]
    assert all(s.finished and s.clock_next == 1.0 for s in after)
    assert all(s.status is Status.TRACKING for s in after[5:])
    assert np.abs(after[-1].velocity).max() < 1e-6
    goal = task.path.pose(1.0)
    for T in tool_placements(task.cell, [s.q_next for s in after]):
        assert max(object_error(T, task.grasp, goal, k)[0] for k in range(3)) < 1e-3 * MM
    assert acceleration_used(task, steps + after) < 1.0 + 1e-6 or np.isinf(acceleration)


def test_the_clock_advances_by_the_rate() -> None:
    task = fast_lift()
    steps = run(task)
    assert steps[-1].finished
    for s in steps[:-1]:
        assert s.clock_next - s.clock == pytest.approx(s.rate * s.dt, abs=1e-12)
    assert len(steps) > 1.5 * task.path.duration / task.dt
    assert max(off_path(task, steps)) < 1e-3 * MM


def test_the_length_of_a_step_may_vary(rng: np.random.Generator) -> None:
    task = paper_lift(time_law=TimeLaw.QUINTIC, duration=1.0)
    task = replace(task, cell=task.cell.with_limits(acceleration=10.0), dt=0.002)
    controller = built(task)
    steps: list[ControlStep] = []
    while not steps or not steps[-1].finished:
        steps.append(controller.step(dt=float(rng.uniform(0.0016, 0.0024))))
    assert chain_of(task, steps).max() < 1e-3 * MM
    assert off_path(task, steps).max() < 1e-2 * MM
    assert sum(s.status is Status.HOLDING for s in steps) == 0


# -- another path ------------------------------------------------------------------------------------------------------


def test_follow_goes_on_from_a_standstill() -> None:
    task = at_limit()
    controller = built(task)
    steps = drive(controller, rest=20)
    assert steps[-1].status is Status.BLOCKED
    stuck = steps[-1]
    controller.follow(LinePath(task.path.pose(stuck.clock_next), task.path.pose(0.0), duration=1.0))
    back = drive(controller, rest=20)
    assert back[-1].finished
    everything = [*steps, *back]
    assert chain_of(task, everything).max() < 1e-3 * MM
    assert off_path(task, everything).max() < 1e-3 * MM
    assert excess(task, everything) == 0.0
    assert acceleration_used(task, everything) < 1.0 + 1e-6
    assert np.abs(back[-1].q_next - task.q_start).max() < 1e-6


@pytest.mark.parametrize("lift", [0.031153846153846153, 0.035, 0.03538461538461538, 0.038, 0.045])
def test_where_a_path_comes_to_rest_in_a_step_the_clock_goes_on_at_once(lift: float) -> None:
    """The end of a piece that is much too quick: joints that reach it within a step reach it at the full rate."""
    task = fast_lift()
    start = task.path.pose(0.0)
    there = pin.SE3(start.rotation, start.translation + lift * np.array([0.0, 0.0, 1.0]))
    path = WaypointPath([start, there, there], durations=[0.01, 0.5], time_law="linear")
    cell = task.cell.with_limits(acceleration=np.full(task.cell.nv, np.inf))
    controller = QPController(cell, task.grasp, path, dt=0.008, options=QPOptions(preview=None))
    controller.reset(task.q_start)
    rates = [controller.step().rate for _ in range(60)]
    first = next(i for i, rate in enumerate(rates) if rate > 1.0 - 1e-9)
    assert all(rate < 0.2 for rate in rates[:first]), rates
    assert all(rate > 1.0 - 1e-9 for rate in rates[first:]), rates


# -- singularities that are only passed --------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("miss", slow_but_first([0.1, 0.01, 0.003]))
def test_a_path_that_passes_near_a_singularity_is_completed(miss: float, acceleration: float) -> None:
    task = at_singularity("wrist", 1, miss=miss, acceleration=acceleration)
    steps = run(task)
    assert steps[-1].finished
    assert chain_of(task, steps).max() < 5e-3 * MM
    assert off_path(task, steps).max() < 5e-3 * MM
    assert excess(task, steps) == 0.0
    rates = np.array([s.rate for s in steps])
    assert rates[-1] > 0.9 or np.isfinite(acceleration)


@pytest.mark.slow
def test_a_horizon_that_grows_too_slowly_only_slows_the_object() -> None:
    """The preview may do only few Newton steps per control step, but needs many."""
    task = at_singularity("wrist", 1, miss=0.003, acceleration=5.0)
    for newton_steps in (1, 3):
        steps = run(task, preview=PreviewOptions(newton_steps=newton_steps))
        assert steps[-1].finished
        assert chain_of(task, steps).max() < 5e-3 * MM
        assert off_path(task, steps).max() < 5e-3 * MM
        assert excess(task, steps) == 0.0
        assert acceleration_used(task, steps) < 1.0 + 1e-6
        assert all(s.status in (Status.TRACKING, Status.SLOWED) for s in steps)


# -- the measured configuration ----------------------------------------------------------------------------------------


def test_a_deflected_arm_does_not_wind_up_the_command(rng: np.random.Generator) -> None:
    """The servos of one arm have a constant deflection under the grip, which no command can change."""
    task = paper_lift()
    task = replace(task, path=HoldPath(task.path.pose(0.0), duration=10.0), dt=0.004)
    controller = built(task, common_error=CommonError.leaderless())
    deflection = np.zeros(18)
    deflection[6:12] = rng.normal(size=6) * 1e-4
    q, steps = task.q_start, []
    for _ in range(2000):
        steps.append(controller.step(q + deflection))
        q = steps[-1].q_next
    assert chain_of(task, steps).max() < 1e-4 * MM  # the commands of all arms agree on the object
    assert np.abs(steps[-1].velocity).max() < 1e-6  # the command comes to rest
    assert np.abs(q - task.q_start).max() < 2e-3


def test_the_object_goes_where_it_should_be_as_measured() -> None:
    """A measured displacement that is common to all arms is corrected."""
    task = paper_lift()
    start = task.path.pose(0.0)
    task = replace(task, path=HoldPath(start, duration=10.0), dt=0.004)
    shifted = pin.SE3(start.rotation, start.translation + np.array([2e-4, -3e-4, 1e-4]))
    offset = inverse_kinematics(task.cell, task.grasp, shifted, task.q_start) - task.q_start
    controller = built(task)
    measured = task.q_start + offset
    for _ in range(500):
        measured = controller.step(measured).q_next + offset
    (tools,) = tool_placements(task.cell, [measured])
    assert path_error(tools, task.grasp, task.path, 0.0)[0] < 1e-3 * MM


def test_a_perfect_measurement_changes_nothing() -> None:
    task = fast_lift()
    blind, seeing = built(task), built(task)
    q = task.q_start
    for _ in range(200):
        a, b = blind.step(), seeing.step(q)
        assert np.abs(a.velocity - b.velocity).max() < 1e-8
        q = b.q_next


# -- arms of any number, with any joints and limits --------------------------------------------------------------------


@pytest.mark.parametrize("arms", slow_unless(lambda arms: arms < 12, [1, 2, 5, 12, 16]))
def test_any_number_of_arms(arms: int) -> None:
    task = ring(arms=max(arms, 2))
    if arms == 1:
        q = task.q_start[task.cell.q_slices[0]]
        task = replace(task, cell=RobotCell(task.cell.arms[:1]), grasp=Grasp(task.grasp.T_object_tool[:1]), q_start=q)
    task = replace(task, cell=task.cell.with_limits(velocity=0.15))
    steps = run(task, dt=0.01)
    assert steps[-1].finished
    assert min(s.rate for s in steps) < 0.95  # the limits bind
    assert chain_of(task, steps[::20]).max() < 5e-3 * MM
    assert off_path(task, steps[::20]).max() < 1e-2 * MM
    assert excess(task, steps) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [scara_pair, five_joint_pair])
def test_arms_with_few_joints_are_named_and_restrict_the_object(scenario: Callable[..., Scenario]) -> None:
    task = scenario()
    steps = run(task, dt=0.005)
    assert steps[-1].finished
    assert steps[-1].given_up.restricted == ("left", "right")
    assert chain_of(task, steps).max() < 1e-3 * MM
    assert off_path(task, steps).max() < 1e-3 * MM
    assert "motions that left, right cannot follow" in steps[-1].explain()


@pytest.mark.slow
@pytest.mark.parametrize("scenario", [scara_pair, five_joint_pair])
def test_arms_with_few_joints_brake_together_ahead_of_a_limit(
    scenario: Callable[..., Scenario], rng: np.random.Generator
) -> None:
    task = scenario()
    x = task.cell.positions(task.q_start)
    for _ in range(6):
        margin = rng.uniform(0.1, 0.4, task.cell.nv)
        way = rng.normal(size=3) * (1.0, float(scenario is scara_pair), 1.0)  # only SCARA bases turn
        way /= np.linalg.norm(way)
        path = LinePath.displaced(task.path.pose(0.0), translation=way, duration=4.0, time_law="linear")
        limited = task.cell.with_limits(lower=x - margin, upper=x + margin, acceleration=5.0)
        blocked = replace(task, cell=limited, path=path, dt=0.002)
        steps = run(blocked)
        assert steps[-1].status is Status.BLOCKED
        assert steps[-1].binding[0].kind is LimitKind.POSITION
        assert chain_of(blocked, steps).max() < 1e-3 * MM
        assert off_path(blocked, steps).max() < 1e-3 * MM
        assert excess(blocked, steps) == 0.0
        assert acceleration_used(blocked, steps) < 1.0 + 1e-6


@pytest.mark.slow
def test_a_path_that_arms_with_few_joints_cannot_follow_is_not_previewed() -> None:
    """The path begins without tilt. At the tilt, the object moves on without it, off its path."""
    task = scara_pair()
    start = task.path.pose(0.0)
    shifted = pin.SE3(start.rotation, start.translation + np.array([0.05, 0.0, 0.02]))
    tilted = pin.SE3(start.rotation @ pin.exp3(np.array([0.3, 0.0, 0.0])), start.translation)
    path = WaypointPath([start, shifted, tilted], durations=[1.0, 1.0], time_law="quintic")
    task = replace(task, path=path, cell=task.cell.with_limits(acceleration=5.0))
    steps = run(task, dt=0.002)
    assert steps[-1].finished
    assert chain_of(task, steps).max() < 1e-3 * MM
    assert {s.status for s in steps} == {Status.TRACKING, Status.OFF_PATH}
    assert steps[-1].status is Status.OFF_PATH
    assert "17.19° off its path" in steps[-1].reason  # 0.3 rad


def test_what_arms_with_few_joints_cannot_do_is_left_out() -> None:
    """The arms leave the impossible tilt out, do the rest of the motion, and keep the chain."""
    task = scara_pair(tilt=0.1)
    steps = run(task, dt=0.01)
    assert steps[-1].finished
    assert chain_of(task, steps).max() < 1e-2 * MM
    (tools,) = tool_placements(task.cell, [steps[-1].q_next])
    carried = tools[0] * task.grasp.T_object_tool[0].inverse()
    goal = task.path.pose(task.path.duration)
    assert np.abs(carried.translation - goal.translation).max() < 5 * MM
    assert abs(carried.rotation[2, 2] - 1.0) < 1e-9  # still level
    heading = pin.log3(carried.rotation)[2]
    assert heading == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize(
    "scenario", slow_unless(lambda make: make is not scara_pair, [paper_lift, dual_arm7, mixed_cell, scara_pair])
)
def test_limits_may_be_missing(scenario: Callable[..., Scenario]) -> None:
    task = scenario()
    free = task.cell.with_limits(lower=-np.inf, upper=np.inf, velocity=np.inf, acceleration=np.inf)
    task = replace(task, cell=free)
    steps = run(task, dt=0.005)
    assert steps[-1].finished
    assert chain_of(task, steps).max() < 1e-3 * MM
    assert all(s.rate == 1.0 for s in steps)


def test_limits_may_be_missing_for_some_joints() -> None:
    """Every third joint without acceleration limit, every fourth without speed limit, every fifth without range."""
    task = paper_lift(time_law=TimeLaw.QUINTIC, duration=1.0)
    acceleration, velocity = np.full(18, 5.0), np.full(18, 0.8)
    lower, upper = task.cell.limits.lower.copy(), task.cell.limits.upper.copy()
    acceleration[::3], velocity[::4], lower[::5], upper[::5] = np.inf, np.inf, -np.inf, np.inf
    cell = task.cell.with_limits(acceleration=acceleration, velocity=velocity, lower=lower, upper=upper)
    task = replace(task, cell=cell, dt=0.002)
    steps = run(task)
    assert steps[-1].finished
    assert chain_of(task, steps).max() < 1e-3 * MM
    assert off_path(task, steps).max() < 1e-3 * MM
    assert excess(task, steps) == 0.0
    assert acceleration_used(task, steps) < 1.0 + 1e-6


def test_an_arm_may_have_joints_that_do_not_move_its_tool() -> None:
    """Such joints, e.g. the fingers of a gripper, do not move."""
    task = dual_arm7()
    arm = task.cell.arms[0]
    model = pin.Model(arm.model)
    flange = model.frames[model.getFrameId("tool")]
    finger = model.addJoint(flange.parentJoint, pin.JointModelPX(), flange.placement, "finger")
    model.lowerPositionLimit[-1], model.upperPositionLimit[-1] = 0.0, 0.05
    model.velocityLimit = np.append(model.velocityLimit[:-1], 0.1)
    assert finger == 8
    gripper = Arm.from_model("left", model, tool_frame="tool", T_world_base=arm.T_world_base)
    cell = RobotCell([gripper, task.cell.arms[1]])
    q = np.insert(task.q_start, 7, 0.02)
    task = replace(task, cell=cell, q_start=q)
    steps = run(task, dt=0.01)
    assert steps[-1].finished
    assert chain_of(task, steps).max() < 1e-3 * MM
    assert all(abs(s.velocity[7]) < 1e-9 for s in steps)


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_redundant_arms_come_back_from_outside(acceleration: float) -> None:
    """Redundancy could move these joints alone; every solver must handle it."""
    for j in (0, 2, 4, 6):
        task = dual_arm7()
        upper = task.cell.limits.upper.copy()
        upper[j] = task.q_start[j] - 0.01
        task = replace(task, cell=task.cell.with_limits(upper=upper, acceleration=acceleration))
        steps = run(task, dt=0.002, longest=200)
        inside = [i for i, s in enumerate(steps) if s.q_next[j] <= upper[j]]
        assert inside, task.cell.joint_names[j]
        assert inside[0] < 50
        assert all(s.status not in (Status.HOLDING, Status.FAULT) for s in steps)
        assert chain_of(task, steps).max() < 0.05 * MM


# -- what a step tells -------------------------------------------------------------------------------------------------


def test_a_step_tells_what_binds() -> None:
    steps = run(fast_lift(), longest=20)
    slow = steps[-1]
    assert slow.status is Status.SLOWED
    assert slow.binding[0].kind is LimitKind.VELOCITY
    assert slow.binding[0].joint.startswith("joint_")
    assert slow.given_up.rate == pytest.approx(1.0 - slow.rate)
    text = slow.explain()
    assert str(slow.binding[0]) in text
    assert "% of its rate" in text
    blocked = run(at_limit())[-1]
    assert blocked.explain().startswith(f"The object cannot go on ({blocked.binding[0]}")


@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_readings_of_a_step_are_those_of_the_metrics() -> None:
    task = with_mismatch(paper_lift(), 1, SHIFT, TURN)
    controller = built(task)
    for _ in range(3):
        step = controller.step()
        (tools,) = tool_placements(task.cell, [step.q])
        distance, angle = chain_error(tools, task.grasp)
        assert step.relative_errors.shape == (3, 2)
        assert step.relative_errors[:, 1].max() == pytest.approx(np.rad2deg(angle), rel=1e-6)
        assert step.relative_errors[:, 0].max() == pytest.approx(1e3 * distance, rel=0.01)
        assert step.sigma_min.shape == (3,)
        after = tool_placements(task.cell, [step.q_next])[0]
        for k, increment in enumerate(step.arm_increments):
            made = pin.log6(tools[k].actInv(after[k])).vector
            assert np.abs(made - increment).max() < 1e-4 * max(1.0, np.abs(made).max())


def test_inputs_are_not_changed() -> None:
    task = paper_lift()
    q = task.q_start.copy()
    measured = q.copy()
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    controller.reset(q)
    steps = []
    for _ in range(5):
        steps.append(controller.step(measured))
        kept = steps[0].q_next.copy()
        measured = steps[-1].q_next.copy()
    assert np.array_equal(q, task.q_start)
    assert np.array_equal(steps[0].q_next, kept)  # later steps do not write into earlier ones
    assert not np.array_equal(steps[0].velocity, steps[-1].velocity)


def test_runs_repeat_to_the_last_bit() -> None:
    for scenario in (fast_lift, dual_arm7):
        task = scenario()
        controller = built(task, shortcut=False)
        first = drive(controller, 60, rest=20)
        controller.reset(task.q_start)
        second = drive(controller, 60, rest=20)
        assert all(np.array_equal(a.velocity, b.velocity) for a, b in zip(first, second, strict=True))


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"grasp_gain": -1.0}, InvalidInputError),
        ({"path_gain": np.nan}, InvalidInputError),
        ({"correction_speed": 0.0}, InvalidInputError),
        ({"blocked_rate": "slow"}, InvalidInputError),
        ({"solver": "simplex"}, UnknownNameError),
    ],
)
def test_bad_options(options: dict[str, Any], error: type[Exception]) -> None:
    task = paper_lift()
    with pytest.raises(error):
        QPController(task.cell, task.grasp, task.path, dt=task.dt, options=QPOptions(**options))


@pytest.mark.parametrize("name", ["kernel", "form", "iterations"])
def test_options_of_version_0_2_are_refused_with_what_to_do(name: str) -> None:
    task = paper_lift()
    for give in (lambda given: QPOptions(**given), lambda given: given):
        with pytest.raises(InvalidInputError, match=rf"{name} is no longer an option\. Leave it out: "):
            QPController(task.cell, task.grasp, task.path, dt=task.dt, options=give({name: "auto"}))


@pytest.mark.parametrize("dt", [0.0, -0.001, np.nan, np.inf, "fast", None])
def test_bad_steps(dt: Any) -> None:
    task = paper_lift()
    with pytest.raises(InvalidInputError, match="QPController: dt"):
        QPController(task.cell, task.grasp, task.path, dt=dt)


def test_a_start_that_does_not_hold_the_object() -> None:
    task = paper_lift()
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    with pytest.raises(InvalidInputError, match="step before reset"):
        controller.step()
    q = task.q_start.copy()
    q[7] += 0.1
    with pytest.raises(InvalidInputError, match="arm 'slave_1' holds the object"):
        controller.reset(q)
    with pytest.raises(InvalidInputError, match="reset: q"):
        controller.reset(q[:-1])
    controller.reset(task.q_start)
    assert controller.step().status is Status.TRACKING


def test_a_grasp_for_another_number_of_arms() -> None:
    with pytest.raises(InvalidInputError, match="Grasp"):
        QPController(three_rx90l(), Grasp((pin.SE3.Identity(),)), paper_lift().path, dt=0.01)


@pytest.mark.slow
def test_every_scenario_runs() -> None:
    """A quick test of all scenarios: 60 coarse steps each without failures, with a closed chain."""
    for name, build in SCENARIOS.items() - LOADED.items() - PROGRAMS.items():
        task = build()
        path: ObjectPath = task.path
        steps = run(task, dt=max(task.dt, path.duration / 200), longest=60)
        assert all(s.status not in (Status.HOLDING, Status.FAULT) for s in steps), name
        assert chain_of(task, steps).max() < 0.05 * MM, name
        assert excess(task, steps) == 0.0, name


CONTROLLERS: list[Callable[..., Any]] = [
    QPController,
    PseudoInverseController,
    IndependentQPController,
]


@pytest.mark.parametrize("make", CONTROLLERS)
def test_a_result_cannot_be_changed_behind_the_controllers_back(make: Callable[..., Any]) -> None:
    task = paper_lift()
    controller = make(task.cell, task.grasp, task.path, dt=task.dt)
    start = task.q_start.copy()
    controller.reset(start)
    start += 1.0
    for _ in range(3):
        step = controller.step()
        for array in (step.q, step.velocity, step.q_next):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
    np.testing.assert_allclose(step.q, task.q_start, atol=0.01)


@pytest.mark.parametrize("make", [QPController, IndependentQPController])
def test_steps_in_milliseconds_are_refused_with_a_hint(make: Any) -> None:
    task = dual_arm7()
    with pytest.raises(InvalidInputError, match=r"steps of 2 s are too long .*milliseconds\. Give seconds: 0\.002\."):
        make(task.cell, task.grasp, task.path, dt=2)
    make(task.cell, task.grasp, task.path, dt=0.5)
