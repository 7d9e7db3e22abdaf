"""Joint targets, encoders and replays without an engine: interpolation, time warp, lags, stalls, noise, losses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from coopqp import CoopqpError, InvalidInputError, LinePath, Recording, RobotCell, simulate
from coopqp.errors import UnreachableError
from coopqp.model import CellState
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario
from coopqp.simulation import Disturbances, PhysicsOptions
from coopqp.simulation.plants.replay import Replay, exact_motion, recorded_motion
from coopqp.simulation.plants.sensors import Encoders
from coopqp.simulation.plants.targets import JointTargets
from coopqp.spatial import Array


def targets(cell: RobotCell, interpolation: Any = "cubic", lag: Any = (), stall: Any = ()) -> JointTargets:
    made = JointTargets(cell, interpolation=interpolation, lag=dict(lag), stall=dict(stall))
    made.reset(cell.configuration([0.0] * cell.nv))
    return made


def drive(made: JointTargets, cell: RobotCell, motion: Callable[[float], float], dt: float, steps: int) -> list[Array]:
    """Command every joint to ``motion``; sample the targets ten times per step: rows (t, x, v) of the first joint."""
    rows = []
    for i in range(steps):
        made.push(cell.configuration([motion((i + 1) * dt)] * cell.nv), dt)
        for s in range(10):
            t = (i + s / 10) * dt
            x, v = made.at(t)
            rows.append(np.array([t, x[0], v[0]]))
    return rows


@pytest.fixture(scope="module")
def cell(make_cell: Callable[..., RobotCell]) -> RobotCell:
    return make_cell(["rx90l", "arm6c"])


def test_targets_meet_the_commands(cell: RobotCell, rng: np.random.Generator) -> None:
    for interpolation in ("linear", "cubic"):
        made, end = targets(cell, interpolation), 0.0
        for dt in (0.001, 0.0075, 0.0003, 0.02):
            x = rng.uniform(-0.01, 0.01, cell.nv)
            made.push(cell.configuration(x), dt)
            end += dt
            np.testing.assert_allclose(made.at(end)[0], x, atol=1e-12)
        assert made.end == pytest.approx(end)
        assert not made.at(end + 1.0)[1].any()  # at rest after the last command


def test_accelerations_are_the_slope_of_velocities(cell: RobotCell, rng: np.random.Generator) -> None:
    """Inside each command; drives of an arm that lags or stands get none."""
    made, held, end, h = targets(cell), targets(cell, lag={"0_rx90l": 0.1}, stall={"1_arm6c": 0.0}), 0.0, 1e-7
    for dt in (0.001, 0.0075, 0.02):
        x = cell.configuration(rng.uniform(-0.01, 0.01, cell.nv))
        made.push(x, dt)
        held.push(x, dt)
        for t in end + dt * np.array([0.1, 0.5, 0.9]):
            slope = (made.at(t + h)[1] - made.at(t - h)[1]) / (2.0 * h)
            np.testing.assert_allclose(made.acceleration(t), slope, rtol=1e-5, atol=1e-4)
            assert not held.acceleration(t).any()
        end += dt
    assert not made.acceleration(end + 1.0).any()


@pytest.mark.parametrize(("interpolation", "order"), [("linear", 2), ("cubic", 3)])
def test_smooth_commands_are_met_to_that_order(cell: RobotCell, interpolation: str, order: int) -> None:
    def motion(t: float) -> float:
        return 0.1 * t**3 * np.cos(t)

    worst = []
    for steps in (50, 100):
        rows = np.array(drive(targets(cell, interpolation), cell, motion, 2.0 / steps, steps))
        late = rows[rows[:, 0] > 0.5]
        worst.append(np.abs(late[:, 1] - [motion(t) for t in late[:, 0]]).max())
    assert np.log2(worst[0] / worst[1]) > order - 0.15


def test_cubic_targets_have_a_continuous_velocity_that_is_their_derivative(
    cell: RobotCell, rng: np.random.Generator
) -> None:
    made, dt = targets(cell), 0.01
    t_end, step = 0.0, 1e-6
    for _ in range(20):
        before = made.at(t_end)[1]
        made.push(cell.configuration(rng.uniform(-0.1, 0.1, cell.nv)), dt)
        np.testing.assert_allclose(made.at(t_end)[1], before, atol=1e-9)
        for t in t_end + rng.uniform(0.1, 0.9, 3) * dt:
            difference = (made._segment.at(t + step)[0] - made._segment.at(t - step)[0]) / (2.0 * step)
            np.testing.assert_allclose(difference, made._segment.at(t)[1], rtol=1e-5, atol=1e-5)
        t_end += dt


def test_continuous_joints_go_on_past_half_a_turn(make_cell: Callable[..., RobotCell]) -> None:
    cell = make_cell(["arm6c"])
    made = targets(cell, "linear")
    assert cell.continuous.any()
    for i in range(60):
        made.push(cell.configuration(np.where(cell.continuous, 0.1 * (i + 1), 0.0)), 0.01)
    assert made.at(made.end)[0][cell.continuous] == pytest.approx(6.0)


def test_continuous_joints_rest_near_where_they_are(make_cell: Callable[..., RobotCell]) -> None:
    """At half a turn the same configuration is two positions, a turn apart: the servo's own is meant."""
    cell = make_cell(["arm6c"])
    x = np.where(cell.continuous, np.pi - 1e-9, 0.3)
    assert cell.continuous.any()
    near = x - 2.0 * np.pi * cell.continuous
    targets = JointTargets(cell, interpolation="cubic", lag={}, stall={})
    targets.reset(cell.configuration(x), near)
    np.testing.assert_allclose(targets.at(0.0)[0], near, atol=1e-12)


@pytest.mark.parametrize("lag", [2e-4, 1e-3, 5e-3, 0.02])
def test_a_lagging_arm_trails_by_its_time_constant(cell: RobotCell, lag: float) -> None:
    """At the speed of its target, also where the time constant is shorter than the time between two looks."""
    made = targets(cell, "linear", lag={"0_rx90l": lag})
    for i in range(300):
        made.push(cell.configuration([0.001 * (i + 1)] * cell.nv), 0.001)
        x, v = made.at(made.end)
    np.testing.assert_allclose(made.end - x[cell.v_slices[0]], lag, rtol=1e-6)
    np.testing.assert_allclose(v[cell.v_slices[0]], 1.0, rtol=1e-6)
    np.testing.assert_allclose(x[cell.v_slices[1]], made.end)


def test_a_stalled_arm_stays(cell: RobotCell) -> None:
    made = targets(cell, "linear", stall={"0_rx90l": 0.05})
    for i in range(20):
        made.push(cell.configuration([0.01 * (i + 1)] * cell.nv), 0.01)
        x, v = made.at(made.end)
    np.testing.assert_allclose(x[cell.v_slices[0]], 0.05, atol=1e-9)
    assert not v[cell.v_slices[0]].any()
    np.testing.assert_allclose(x[cell.v_slices[1]], 0.2)


# -- encoders ----------------------------------------------------------------------------------------------------------


def test_measurements_are_late_noisy_and_lost(cell: RobotCell) -> None:
    truth = [cell.configuration([1e-3 * i] * cell.nv) for i in range(400)]

    def seen(**disturbances: Any) -> Array:
        encoders = Encoders(cell, Disturbances(**disturbances))
        rows = [encoders.reset(truth[0]), *(encoders.read(q, 0.002) for q in truth[1:])]
        return np.array([cell.positions(q) for q in rows])

    true = np.array([cell.positions(q) for q in truth])
    np.testing.assert_array_equal(seen(), true)
    late = seen(latency=0.01)
    np.testing.assert_array_equal(late[5:], true[:-5])
    noise = seen(encoder_noise=1e-4) - true
    assert 9e-5 < np.abs(noise).max() <= 1e-4 + 1e-12
    for by_arm in (False, True):
        lossy = seen(drop_share=0.2, drops_by_arm=by_arm)
        lost = lossy[1:] == lossy[:-1]
        assert lost.mean() == pytest.approx(0.2, abs=0.05)
        assert (lost == lost[:, :1]).all() is np.bool_(not by_arm)
        for s in cell.v_slices:
            assert (lost[:, s] == lost[:, s][:, :1]).all()


def test_periods_vary_as_told(cell: RobotCell) -> None:
    encoders = Encoders(cell, Disturbances(dt_jitter=0.2))
    periods = np.array([encoders.period(0.01) for _ in range(1000)])
    assert 0.008 <= periods.min() < 0.0081 < 0.0119 < periods.max() <= 0.012
    assert Encoders(cell, Disturbances()).period(0.01) == 0.01


# -- replays -----------------------------------------------------------------------------------------------------------


def test_a_replay_passes_the_recorded_configurations(paper: Scenario, baseline: Callable[..., Recording]) -> None:
    recording = baseline(40)
    for interpolation in ("linear", "cubic"):
        motion = recorded_motion(paper.cell, recording, interpolation=interpolation)
        for tau, q in zip(recording.clock, recording.q_command, strict=True):
            np.testing.assert_allclose(motion(tau), q, atol=1e-12)
    replay = Replay(paper.cell, paper.grasp, paper.path, motion, dt=3.0 / 40)
    again = simulate(replay, q_start=paper.q_start)
    np.testing.assert_allclose(again.q_command, recording.q_command, atol=1e-9)
    assert again.finished


def test_a_warped_replay_starts_and_ends_at_rest_on_the_same_way(paper: Scenario) -> None:
    motion = exact_motion(paper.cell, paper.grasp, paper.path, paper.q_start)
    replay = Replay(paper.cell, paper.grasp, paper.path, motion, dt=0.01, time_law="quintic")
    run = simulate(replay, q_start=paper.q_start, settle=0.05)
    speed = np.abs(run.velocity).max(axis=1)
    assert speed[0] < 1e-3 > speed[-7]
    assert not speed[-5:].any()
    np.testing.assert_allclose(run.clock[:301], [3.0 * TimeLaw.QUINTIC.value_at(t / 3.0) for t in run.time[:301]])
    middle = paper.path.pose(run.clock[150])
    for O in paper.grasp.carried(CellState(paper.cell, run.q_command[150])):
        np.testing.assert_allclose(O.homogeneous, middle.homogeneous, atol=1e-9)


def test_a_replay_of_what_is_out_of_reach_or_at_rest_says_so(
    paper: Scenario, baseline: Callable[..., Recording]
) -> None:
    far = LinePath.displaced(paper.path.pose(0.0), translation=(0.0, 0.0, 5.0), duration=1.0)
    motion = exact_motion(paper.cell, paper.grasp, far, paper.q_start)
    with pytest.raises(UnreachableError, match="arm"):
        motion(1.0)
    still = dataclasses.replace(baseline(40), clock=np.zeros(41))
    with pytest.raises(InvalidInputError, match="never advances"):
        recorded_motion(paper.cell, still)


# -- settings ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"timestep": 0.0},
        {"timestep": np.nan},
        {"settle": -1.0},
        {"interpolation": "quadratic"},
        {"grips": "anywhere"},
        {"gravity": (0.0, 1.0)},
        {"weld_solref": (0.004,)},
        {"iterations": 0},
        {"tolerance": 0.0},
    ],
)
def test_bad_physics_options_are_named(settings: dict[str, Any]) -> None:
    with pytest.raises(CoopqpError):
        PhysicsOptions(**settings)


def test_servos_of_any_cell(mixed_cell: RobotCell, cell: RobotCell) -> None:
    servos = PhysicsOptions().servos(mixed_cell)
    assert len(servos.stiffness) == mixed_cell.nv
    assert (servos.damping / servos.stiffness < 0.04).all()
    np.testing.assert_allclose(PhysicsOptions().servos(cell).stiffness[:6], [1e5, 1e5, 5e4, 1e4, 1e4, 5e3])
    assert (PhysicsOptions(stiffness=2e4).servos(cell).stiffness == 2e4).all()
    for settings in ({"stiffness": 0.0}, {"damping": -1.0}, {"armature": -1.0}, {"stiffness": [1.0, 2.0]}):
        with pytest.raises(InvalidInputError):
            PhysicsOptions(**settings).servos(cell)
