"""Row B, in mm: the chain errors due to disturbances. Only the commands hold the arms together here.

Every figure is the largest chain error of the plant's *true* configuration over all samples, with the default
supervision, at 1 kHz and an object peak speed of 0.25 m/s. Row B in newtons is in ``test_disturbances_physics.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import (
    ControlStep,
    Grasp,
    InvalidInputError,
    LimitKind,
    LinePath,
    ObjectPath,
    QPController,
    Status,
    WaypointPath,
    inverse_kinematics,
)
from coopqp.control import StallBound
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.simulation import Disturbances, DisturbedPlant, misplaced
from coopqp.simulation.evaluation.metrics import chain_errors
from coopqp.spatial import Array

DT = 1e-3
SPEED = 0.25
#: Number of readings at rest for the averaged start: 0.1 s.
READINGS = 100
#: A base error of 1 mm and 0.1°, along and about one axis.
AXIS = np.ones(3) / np.sqrt(3.0)
BASE_OFF = pin.SE3(pin.exp3(np.deg2rad(0.1) * AXIS), 1e-3 * AXIS)


def peak_speed(path: ObjectPath) -> float:
    """Peak speed of the object frame [m/s]."""
    return max(float(np.linalg.norm(path.twist(t)[:3])) for t in np.linspace(0.0, path.duration, 201))


def at_speed(make: Callable[..., Scenario]) -> Scenario:
    """The scenario with a duration that gives the peak speed :data:`SPEED`."""
    slow = make(time_law=TimeLaw.QUINTIC, duration=3.0)
    task = make(time_law=TimeLaw.QUINTIC, duration=3.0 * peak_speed(slow.path) / SPEED)
    assert peak_speed(task.path) == pytest.approx(SPEED, rel=1e-6)
    return task


@pytest.fixture(scope="module")
def tasks() -> list[Scenario]:
    """Three arms with six joints, two arms with seven joints, and a mixture of robots."""
    return [at_speed(make) for make in (paper_lift, dual_arm7, mixed_cell)]


@dataclass(frozen=True)
class Run:
    """One run: chain error of the true configuration at every sample [mm], the same at the grasps, the steps."""

    chain: Array
    grasps: Array
    steps: list[ControlStep]

    @property
    def chain_mm(self) -> float:
        return float(self.chain.max())

    @property
    def grasps_mm(self) -> float:
        return float(self.grasps.max())

    @property
    def smooth(self) -> bool:
        """True if the run finished and never held."""
        return self.steps[-1].finished and not any(s.status in (Status.HOLDING, Status.FAULT) for s in self.steps)


def apart(tools: Array, grasp: Grasp, grip: Grasp) -> Array:
    """Largest distance between the positions of any grasp according to any two arms, at every sample (T,) [m].

    ``tools`` (T, N, 4, 4) are held by ``grip``; ``grasp`` tells where the grasps are on the object.
    """
    O = tools @ np.array([X.inverse().homogeneous for X in grip.T_object_tool])
    points = np.array([X.translation for X in grasp.T_object_tool]).T
    seen = O[..., :3, :3] @ points + O[..., :3, 3:]
    distances = np.linalg.norm(seen[:, :, None] - seen[:, None], axis=3)
    return np.asarray(distances.max(axis=(1, 2, 3)))


def drive(
    task: Scenario,
    disturbances: Disturbances | None = None,
    *,
    grasp: Grasp | None = None,
    command_latency: Mapping[str, float] | None = None,
    readings: int = READINGS,
    longest: float | None = None,
    constraints: Sequence[Any] = (),
) -> Run:
    """Start from an average of readings at rest, then run one loop with all disturbances."""
    held = task.grasp if grasp is None else grasp
    plant = DisturbedPlant(task.cell, held, disturbances, command_latency=command_latency)
    controller = QPController(task.cell, held, task.path, dt=DT, constraints=constraints)
    rest = [plant.reset(task.q_start), *(plant.measure() for _ in range(readings - 1))]
    q = rest[-1]
    controller.reset(task.cell.average(rest))
    first, steps = plant.true_tools(), []
    tools = [[T.homogeneous for T in first]]
    grip = Grasp(tuple(held.T_object_tool[0] * first[0].inverse() * T for T in first))
    end = 10.0 * task.path.duration if longest is None else longest
    while plant.time < end and not (steps and steps[-1].finished):
        steps.append(controller.step(q, dt=plant.period(DT)))
        q = plant.apply(steps[-1])
        tools.append([T.homogeneous for T in plant.true_tools()])
    placed = np.array(tools)
    chain = chain_errors(placed, grip)[0]
    assert abs(chain[-1] - plant.chain_error()[0]) < 1e-12
    return Run(1e3 * chain, 1e3 * apart(placed, held, grip), steps)


# -- signals -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "target"), [(1e-4, 0.2), (1e-3, 1.0)])
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_encoder_noise(tasks: list[Scenario], catalogue: Any, count: Any, noise: float, target: float) -> None:
    seeds = range(count(2))
    runs = [drive(task, Disturbances(encoder_noise=noise, seed=seed)) for task in tasks for seed in seeds]
    assert all(run.smooth for run in runs)
    single = max(drive(task, Disturbances(encoder_noise=noise), readings=1, longest=0.1).chain_mm for task in tasks)
    catalogue.row(
        "B",
        f"encoder noise ±{noise:g} rad",
        cases=sum(len(run.steps) for run in runs),
        measured=max(run.chain_mm for run in runs),
        target=target,
        unit="mm",
        note=f"from the start, the mean of {READINGS} readings; from one reading {single:.2g} mm",
    )


@pytest.mark.slow
@pytest.mark.parametrize("latency", [0.002, 0.005, 0.010])
def test_late_measurements(tasks: list[Scenario], catalogue: Any, latency: float) -> None:
    """All measurements and all commands have the latency."""
    runs = []
    for task in tasks:
        late = dict.fromkeys(task.cell.arm_names, latency)
        disturbances = Disturbances(latency=latency)
        runs += [drive(task, disturbances), drive(task, disturbances, command_latency=late)]
    assert all(run.smooth for run in runs)
    cases = sum(len(run.steps) for run in runs)
    chain = max(run.chain_mm for run in runs)
    name = f"measurements, and commands, late by {1e3 * latency:g} ms"
    catalogue.row("B", name, cases=cases, measured=chain, target=1e-6, unit="mm")


@pytest.mark.slow
def test_lost_samples(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    runs = [
        drive(task, Disturbances(drop_share=0.05, drops_by_arm=by_arm, seed=seed))
        for task in tasks
        for by_arm in (False, True)
        for seed in range(count(1))
    ]
    assert all(run.smooth for run in runs)
    cases, chain = sum(len(run.steps) for run in runs), max(run.chain_mm for run in runs)
    catalogue.row("B", "5 % of the samples lost", cases=cases, measured=chain, target=1e-5, unit="mm")


@pytest.mark.slow
def test_periods_that_vary(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    runs = [drive(task, Disturbances(dt_jitter=0.2, seed=seed)) for task in tasks for seed in range(count(1))]
    for run in runs:
        lengths = [s.dt for s in run.steps]
        assert min(lengths) < 0.81 * DT
        assert max(lengths) > 1.19 * DT
    assert all(run.smooth for run in runs)
    cases, chain = sum(len(run.steps) for run in runs), max(run.chain_mm for run in runs)
    catalogue.row("B", "periods that vary by ±20 %", cases=cases, measured=chain, target=1e-5, unit="mm")


# -- where the arms stand and hold -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_base_that_is_off_for_ten_minutes(catalogue: Any, count: Any) -> None:
    """The object is lifted by 0.3 m and lowered for ten minutes. The error due to the base does not grow with time."""
    lift, minutes = paper_lift(), count(10)
    low = lift.path.pose(0.0)
    high = pin.SE3(low.rotation, low.translation + np.array([0.0, 0.0, 0.3]))
    half = 0.3 * 1.875 / SPEED  # the peak of a quintic law is 1.875 times its mean
    turns = round(60.0 * minutes / half)
    path = WaypointPath(
        [high if i % 2 else low for i in range(turns + 1)], durations=[half] * turns, time_law=TimeLaw.QUINTIC
    )
    plant = DisturbedPlant(lift.cell, lift.grasp, Disturbances(base_offset={"slave_1": BASE_OFF}))
    controller = QPController(lift.cell, lift.grasp, path, dt=DT)
    controller.reset(plant.reset(lift.q_start))
    chain, tick = [], 0
    step = controller.step()
    while not step.finished:
        plant.apply(step)
        if tick % 25 == 0:  # every 25th sample is enough
            chain.append(1e3 * plant.chain_error()[0])
        step = controller.step()  # the encoders do not see a base error
        assert step.status is Status.TRACKING
        tick += 1
    assert tick >= 59_900 * minutes
    assert np.abs(step.q_next - lift.q_start).max() < 1e-6 or turns % 2
    cycle = round(2.0 * half / DT / 25)
    drift = abs(max(chain[-2 * cycle :]) - max(chain[: 2 * cycle]))
    where = f"base off by 1 mm and 0.1°, 0.3 m up and down for {minutes} min"
    catalogue.row("B", where, cases=tick, measured=max(chain), target=0.6, unit="mm")
    catalogue.row("B", f"{where}: drift", cases=tick, measured=drift, target=1e-9, unit="mm")


@pytest.mark.slow
def test_a_base_that_is_off_and_a_turn(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    """A turn of the object causes a geometric error that encoders cannot see. The control adds nothing to it."""
    added, whole, cases = 0.0, 0.0, 0
    for task in tasks:
        ideal = drive(task)
        for arm in task.cell.arm_names[1 : 2 + count(1)]:
            off = Disturbances(base_offset={arm: BASE_OFF}, encoder_noise=1e-6)
            plant = DisturbedPlant(task.cell, task.grasp, Disturbances(base_offset={arm: BASE_OFF}))
            plant.reset(task.q_start)
            geometry = [0.0]
            for step in ideal.steps:
                plant.apply(step)
                geometry.append(1e3 * plant.chain_error()[0])
            run = drive(task, off)
            assert run.smooth
            assert len(run.chain) == len(geometry)
            added = max(added, float(np.abs(run.chain - geometry).max()))
            whole, cases = max(whole, max(geometry)), cases + len(run.steps)
    catalogue.row(
        "B",
        "base off by 1 mm and 0.1°, turned by 40°: beyond geometry",
        cases=cases,
        measured=added,
        target=0.003,
        unit="mm",
        note=f"geometry alone makes {whole:.2g} mm of it; calibrate, or turn less",
    )


def offset(rng: np.random.Generator, distance: float, angle: float) -> pin.SE3:
    """A placement error of this distance [m] and angle [rad] in a random direction."""
    axes = rng.normal(size=(2, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return pin.exp6(np.concatenate([distance * axes[0], angle * axes[1]]))


def test_a_grasp_that_is_off(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    """The grasp error is 2 mm and latched when the grips close; the first arm then defines the object pose."""
    rng, runs = np.random.default_rng(1), []
    for task in tasks:
        for arm in task.cell.arm_names[1 : 1 + count(1)]:
            real = misplaced(task.cell, task.grasp, {arm: offset(rng, 2e-3, 0.0)})
            q = inverse_kinematics(task.cell, real, task.path.pose(0.0), task.q_start)
            grasp = Grasp.from_configuration(task.cell, q, nominal=task.grasp)
            run = drive(replace(task, q_start=q), grasp=grasp)
            assert run.smooth
            runs.append(run)
    cases, chain = sum(len(run.steps) for run in runs), max(run.chain_mm for run in runs)
    catalogue.row("B", "grasp off by 2 mm, latched", cases=cases, measured=chain, target=1e-6, unit="mm")


def test_a_grasp_too_far_off_is_refused(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    rng, wrong, cases = np.random.default_rng(2), 0, 0
    for task in (tasks[0], tasks[1]):  # arms with at least six joints
        for _ in range(count(50)):
            arm = str(rng.choice(task.cell.arm_names[1:]))
            far = bool(rng.integers(2))
            turned = bool(rng.integers(2))
            excess = float(rng.uniform(1.001, 1.5) if far else rng.uniform(0.3, 0.999))
            off = offset(rng, *((0.0, np.deg2rad(excess)) if turned else (5e-3 * excess, 0.0)))
            q = inverse_kinematics(
                task.cell, misplaced(task.cell, task.grasp, {arm: off}), task.path.pose(0.0), task.q_start
            )
            try:
                Grasp.from_configuration(task.cell, q, nominal=task.grasp)
                refused = False
            except InvalidInputError as error:
                refused = f"'{arm}'" in str(error)
            wrong, cases = wrong + (refused is not far), cases + 1
    catalogue.row(
        "B", "grasp off by more than 5 mm or 1° refused, less accepted", cases=cases, measured=wrong, target=0
    )


# -- arms out of step --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_arm_that_lags(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    runs = [
        drive(task, Disturbances(lag={arm: 0.01})) for task in tasks for arm in task.cell.arm_names[1 : 1 + count(1)]
    ]
    assert all(run.smooth for run in runs)
    slowed = [s for run in runs for s in run.steps if s.status is Status.SLOWED]
    assert slowed
    assert all(b.kind is LimitKind.OUT_OF_STEP for s in slowed for b in s.binding)
    cases, chain = sum(len(run.steps) for run in runs), max(run.chain_mm for run in runs)
    grasps = max(run.grasps_mm for run in runs)
    note = f"the object is slowed; at full rate {1e3 * SPEED * 0.01:.2g} mm"
    name = "an arm that lags by 10 ms"
    catalogue.row("B", name, cases=cases, measured=chain, target=1.0, unit="mm", note=note)
    catalogue.row("B", f"{name}: at the grasps", cases=cases, measured=grasps, target=1.0, unit="mm")


@pytest.mark.slow
def test_an_arm_that_lags_while_the_object_only_turns(tasks: list[Scenario], catalogue: Any) -> None:
    """The object turns about its origin, which does not move: only the grasps part."""
    lift, cases, worst = tasks[0], 0, 0.0
    for axis in np.eye(3)[:2]:
        path = LinePath.displaced(
            lift.path.pose(0.0), rotation=np.deg2rad(-15.0) * axis, duration=1.0, time_law=TimeLaw.QUINTIC
        )
        run = drive(replace(lift, path=path), Disturbances(lag={"slave_1": 0.01}), longest=3.0)
        worst, cases = max(worst, run.grasps_mm), cases + len(run.steps)
    name, note = "an arm that lags by 10 ms, the object turning: at the grasps", "at full rate 9 mm"
    catalogue.row("B", name, cases=cases, measured=worst, target=1.0, unit="mm", note=note)


@pytest.mark.slow
def test_an_arm_whose_commands_come_late(tasks: list[Scenario], catalogue: Any) -> None:
    late = (0.002, 0.005, 0.010)
    runs = [drive(task, command_latency={task.cell.arm_names[-1]: delay}) for task in tasks[1:] for delay in late]
    assert all(run.smooth for run in runs)
    cases, chain = sum(len(run.steps) for run in runs), max(run.chain_mm for run in runs)
    name = "an arm whose commands come 2, 5, 10 ms later than the others'"
    catalogue.row("B", name, cases=cases, measured=chain, target=1.0, unit="mm")


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1e-4], ids=["quiet", "noisy"])
def test_an_arm_that_stalls(tasks: list[Scenario], catalogue: Any, noise: float) -> None:
    """The arm stalls at the highest speed (0.25 mm per sample) and, without noise, at 30 % of the path's time."""
    latest, worst, cases = 0, 0.0, 0
    for task in tasks:
        for k, arm in enumerate(task.cell.arm_names):
            for share in (0.5,) if noise else (0.3, 0.5):
                when = DT * round(share * task.path.duration / DT)
                stall = Disturbances(stall={arm: when}, encoder_noise=noise, seed=k)
                run = drive(task, stall, longest=when + 0.3)
                first = round(when / DT)  # first command that is not executed
                held = next(i for i, s in enumerate(run.steps) if s.status is Status.HOLDING)
                step = run.steps[held]
                assert step.binding[0].arm == arm
                assert arm in step.reason
                latest = max(latest, held - first)  # samples since the stall at the decision
                worst, cases = max(worst, run.grasps_mm), cases + 1
                after = run.steps[held:]
                assert all(s.status is Status.HOLDING for s in after)
                assert np.abs(after[-1].velocity).max() < 1e-6
    kind = f"an arm that stalls{', encoder noise ±0.0001 rad' if noise else ''}"
    catalogue.row("B", f"{kind}: samples until it is known", cases=cases, measured=latest, target=5)
    catalogue.row("B", f"{kind}: apart at the grasps", cases=cases, measured=worst, target=3.0, unit="mm")


@pytest.mark.slow
def test_an_arm_that_stalls_under_acceleration_limits(catalogue: Any, count: Any) -> None:
    """The others part from it while it is not known (5 dt at speed v), and then while they brake together (v T/2)."""
    rng, worst, farthest, cases = np.random.default_rng(7), 0.0, 0.0, count(24)
    for i in range(cases):
        make = (paper_lift, dual_arm7, mixed_cell)[i % 3]
        slow = make(time_law=TimeLaw.QUINTIC, duration=3.0)
        task = make(time_law=TimeLaw.QUINTIC, duration=3.0 * peak_speed(slow.path) / float(rng.uniform(0.1, 0.6)))
        cell = task.cell.with_limits(acceleration=float(rng.uniform(5.0, 20.0)))
        task = replace(task, cell=cell)
        first = round(float(rng.uniform(0.25, 0.6)) * task.path.duration / DT)  # command that is not executed
        stall = Disturbances(stall={str(rng.choice(cell.arm_names)): first * DT})
        run = drive(task, stall, readings=1, longest=first * DT + 1.0)
        held = next(k for k, s in enumerate(run.steps) if s.status in (Status.HOLDING, Status.FAULT))
        assert 0 < held - first <= 5
        assert np.abs(run.steps[-1].velocity).max() < 1e-6
        before = run.steps[held - 1]  # the last at full speed: v and T when the stall is known
        to_stop = float((np.abs(before.velocity) / cell.limits.acceleration).max())
        fastest = np.array([np.abs(s.velocity).max() for s in run.steps[first:]])
        resting = int(np.argmax(fastest < 0.01 * np.abs(before.velocity).max()))  # samples from the stall to rest
        assert resting * DT <= 1.05 * (to_stop + 5.0 * DT)
        poses = [task.grasp.carried(s.state)[0] for s in run.steps[held - 1 : held + 1]]
        points = [X.translation for X in task.grasp.T_object_tool]
        speed = max(float(np.linalg.norm(poses[1].act(p) - poses[0].act(p))) for p in points) / DT
        expected = 1e3 * speed * (0.5 * to_stop + 5.0 * DT)
        worst, farthest = max(worst, run.grasps_mm / expected), max(farthest, run.grasps_mm)
    catalogue.row(
        "I5",
        "an arm that stalls, 5 to 20 rad/s², 0.1 to 0.6 m/s: apart at the grasps, of v T/2 + 5 dt v",
        cases=cases,
        measured=worst,
        target=1.05,
        note=f"v: speed of the grasps, T: max |q̇|/a of the joints; {farthest:.0f} mm at most",
    )


@pytest.mark.slow
def test_arms_part_by_no_more_than_a_stall_bound(catalogue: Any, count: Any) -> None:
    """5 to 20 rad/s², asked for 0.3 to 0.6 m/s: the object slows down to what the distance allows."""
    rng, worst, cases = np.random.default_rng(8), 0.0, count(9)
    for i in range(cases):
        make, distance = (paper_lift, dual_arm7, mixed_cell)[i % 3], float(rng.uniform(0.003, 0.01))
        slow = make(time_law=TimeLaw.QUINTIC, duration=3.0)
        task = make(time_law=TimeLaw.QUINTIC, duration=3.0 * peak_speed(slow.path) / float(rng.uniform(0.3, 0.6)))
        cell = task.cell.with_limits(acceleration=float(rng.uniform(5.0, 20.0)))
        when = round(float(rng.uniform(0.6, 1.0)) * task.path.duration / DT) * DT
        stall = Disturbances(stall={str(rng.choice(cell.arm_names)): when})
        bound = StallBound(distance, dt=DT)
        run = drive(replace(task, cell=cell), stall, readings=1, longest=when + 0.5, constraints=[bound])
        assert any("stall" in str(b) for s in run.steps for b in s.binding)
        assert run.steps[-1].status is Status.HOLDING
        worst = max(worst, 1e-3 * run.grasps_mm / distance)
    name = "an arm that stalls, with a StallBound of 3 to 10 mm: apart at the grasps, of that distance"
    catalogue.row("I5", name, cases=cases, measured=worst, target=1.05)


def test_an_arm_that_stands_and_goes_on(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    """Measured where they are told to be from then on, the arms go on too; a fault, once they were far apart, stays."""
    rng, longest, faults, cases = np.random.default_rng(4), 0, 0, count(12)
    accelerations = ((None, 20.0), (5.0, 20.0), (12.0, 12.0))  # rad/s² (m/s²): with limits, braking goes on for a while
    for i in range(cases):
        task = tasks[i % 3]
        limit = accelerations[i % 3][i // 3 % 2]
        cell = task.cell if limit is None else task.cell.with_limits(acceleration=limit)
        controller = QPController(cell, task.grasp, task.path, dt=DT)
        controller.reset(task.q_start)
        arm = cell.q_slices[int(rng.integers(len(cell)))]
        begin = round(float(rng.uniform(0.3, 0.7)) * task.path.duration / DT)
        end = begin + round(float(rng.uniform(0.1, 1.0 if i % 2 else 2.0)) / DT)
        q, held = task.q_start, 0
        for tick in range(end + 10_000):
            step = controller.step(q)
            held = held + 1 if step.status is Status.HOLDING and tick > end else 0
            longest = max(longest, held)
            if step.finished or step.status is Status.FAULT or held > 2000:
                break
            stands = q[arm] if begin <= tick < end else None
            q = step.q_next.copy()
            if stands is not None:
                q[arm] = stands
        faults += step.status is Status.FAULT
        assert step.finished or step.status is Status.FAULT or held
    assert faults < cases / 2
    name = "an arm that stands for 0.1 to 2 s and goes on: held after it"
    note = f"{faults} of them were 20 mm apart before they had braked: a fault"
    catalogue.row("I4", name, cases=cases, measured=longest * DT, target=0.4, unit="s", note=note)


@pytest.mark.slow
def test_one_corrupted_sample(tasks: list[Scenario], catalogue: Any, count: Any) -> None:
    """One joint of one sample is off, from 10 µrad to half a turn; nothing else is."""
    rng, wrong, longest, cases = np.random.default_rng(9), 0, 0, count(30)
    for i in range(cases):
        task = tasks[i % 3]
        cell = task.cell
        controller = QPController(cell, task.grasp, task.path, dt=DT)
        controller.reset(task.q_start)
        size = float(rng.uniform(0.1, 0.299) if i // 3 % 2 else 10.0 ** rng.uniform(-5.0, 0.5))
        off = np.zeros(cell.nv)
        off[rng.integers(cell.nv)] = rng.choice([-1.0, 1.0]) * size
        when = int(rng.integers(1, round(0.9 * task.path.duration / DT)))
        q, statuses = task.q_start, []
        while len(statuses) < 10_000:
            step = controller.step(q)
            statuses.append(step.status)
            if step.finished or step.status is Status.FAULT:
                break
            q = cell.moved(step.q_next, off if len(statuses) == when else np.zeros(cell.nv))
        wrong += not step.finished
        longest = max(longest, statuses.count(Status.HOLDING))
    name, note = "one corrupted sample: a fault, or no end", f"held for {longest} steps at most"
    catalogue.row("I9", name, cases=cases, measured=wrong, target=0, note=note)
