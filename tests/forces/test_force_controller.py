"""Forces that relax: against an elastic chain in closed form, and in the engine with sensors that fail."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from golden import Golden, Run
from hypothesis import given, strategies as st

from coopqp import (
    Cause,
    ControlStep,
    ForceController,
    ForceOptions,
    Grasp,
    HoldPath,
    InvalidInputError,
    LinePath,
    QPController,
    RobotCell,
    Status,
    WaypointPath,
    inverse_kinematics,
    simulate,
)
from coopqp.baselines import PseudoInverseController
from coopqp.control.core.force_memory import relaxation_scalars, relaxation_size
from coopqp.core import _core
from coopqp.errors import StartWarning
from coopqp.forces import Grip, LoadShare, StressModel, internal_wrenches
from coopqp.model import CellState
from coopqp.planning import Payload
from coopqp.scenarios import Scenario, palm_box, paper_lift, torso_lift
from coopqp.simulation import Disturbances, KinematicPlant, PhysicsPlant, misplaced
from coopqp.spatial import Array

STIFF = 2e4
OFF = pin.SE3(pin.exp3(1e-4 * np.array([1.0, -0.5, 1.0])), 1e-4 * np.array([3.0, -2.0, 3.0]))


@pytest.fixture(scope="module")
def task() -> Scenario:
    return paper_lift(time_law="quintic")


@given(st.tuples(*[st.floats(-50.0, 50.0)] * 24))
def test_what_the_load_takes_is_not_internal_and_what_cancels_is(task: Scenario, numbers: list[float]) -> None:
    """With the least wrenches at the tools that carry a load, torques at a tenth of a metre, nothing is internal."""
    X, load, free = task.grasp.T_object_tool, np.array(numbers[:6]), np.array(numbers[6:]).reshape(3, 6)
    maps = np.hstack([x.actionInverse.T for x in X])
    metric = np.tile([1.0] * 3 + [100.0] * 3, 3)  # of squared torques against squared forces
    least = (maps.T @ np.linalg.solve((maps / metric) @ maps.T, load)) / metric
    np.testing.assert_allclose(internal_wrenches(least.reshape(3, 6), task.grasp), 0.0, atol=1e-9)
    free[2] = -X[2].action.T @ sum(x.actionInverse.T @ w for x, w in zip(X[:2], free[:2], strict=True))
    there = [x.actionInverse.T @ w for x, w in zip(X, free, strict=True)]
    np.testing.assert_allclose(internal_wrenches(least.reshape(3, 6) + free, task.grasp), there, atol=1e-8)


class Elastic:
    """A cell whose bases or grips are elsewhere, with elastic servos, in closed form; wrenches come late."""

    def __init__(self, cell: RobotCell, grasp: Grasp, *, late: int, stiffness: float = STIFF) -> None:
        self.model, self.grasp = StressModel(cell, grasp, stiffness=stiffness), grasp
        self.past: list[Array] = []
        self.late = late

    def answer(self, commanded: Array) -> tuple[Array, Array]:
        """Where the arms are, and the wrenches at their tools, late."""
        found = self.model.estimate(commanded).wrenches
        now = np.array([X.action.T @ w for X, w in zip(self.grasp.T_object_tool, found, strict=True)])
        self.past.append(now)
        cell, state = self.model.cell, CellState(self.model.cell, commanded)
        bent = np.concatenate([state.jacobian(k).T @ w for k, w in enumerate(now)]) / self.model.stiffness
        return pin.integrate(cell.model, commanded, -bent), self.past[max(0, len(self.past) - 1 - self.late)]


def relaxed(
    task: Scenario, *, late: int, steps: int, off: pin.SE3 = OFF, **options: Any
) -> tuple[Array, ForceController]:
    """Forces of an object at rest that one arm grips elsewhere, from where the arms begin to relax; and what did it."""
    real = misplaced(task.cell, task.grasp, {"slave_2": off})
    world = Elastic(task.cell, real, late=late)
    held = HoldPath(task.path.pose(0.0), duration=100.0)
    controller = QPController(task.cell, task.grasp, held, dt=task.dt)
    made = ForceController(controller, {"stiffness": STIFF, "check_time": 0.0, "presses": False, **options})
    made.reset(task.q_start)
    commanded, forces = task.q_start, []
    for _ in range(steps):
        measured, wrenches = world.answer(commanded)
        step = made.step(measured, wrenches=wrenches)
        assert step.status is not Status.HOLDING or "further" in step.reason, step.reason
        commanded = step.q_next
        if "press" not in step.reason and "compared" not in step.reason:
            forces.append(np.linalg.norm(world.past[-1][:, :3], axis=1).max())
    return np.array(forces), made


def test_a_force_decays_with_the_relax_time_whatever_the_arms_stand_like(task: Scenario) -> None:
    """On an elastic chain the loop is one integrator: e^(−t/T), with no filter, delay or dead band."""
    T = 0.3
    free = {"delay": 0.0, "filter_time": 0.0, "dead_band": 0.0, "ramp_time": 1e-9, "speed": 9.0, "spin": 9.0}
    forces, made = relaxed(task, late=0, steps=200, relax_time=T, **free)
    assert forces[0] > 10.0
    assert made.stiffer == pytest.approx(1.0, abs=0.1)
    times = task.dt * np.arange(60)
    np.testing.assert_allclose(forces[1:61] / forces[1], np.exp(-times / (made.stiffer * T)), rtol=0.05)
    moved = np.linalg.norm(made.shift[:, :3], axis=1)
    assert moved[0] < 1e-12, "the first arm defines the object"


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_the_loop_is_stable_up_to_the_delay_that_it_allows(task: Scenario, share: float) -> None:
    """With a dead band of 0, nothing hides what swings."""
    T, late = 0.06, 1
    delay = share * (0.5 * T / 1.0 - task.dt)
    late = int(delay / task.dt)
    forces, _ = relaxed(
        task, late=late, steps=400, relax_time=T, delay=delay, softness_doubt=1.0, dead_band=0.0, filter_time=0.0
    )
    assert forces[0] > 10.0
    assert forces[-50:].max() < 1e-3 * forces[0]


def test_a_setting_with_which_forces_would_swing_is_refused(task: Scenario) -> None:
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    with pytest.raises(InvalidInputError, match=r"would swing.*Give a relax_time of at least 0\.0825 s"):
        ForceController(controller, {"stiffness": 1e4, "relax_time": 0.06, "delay": 0.02})
    least = {"stiffness": 1e4, "relax_time": 0.0825, "delay": 0.02}
    assert ForceController(controller, least).options.relax_time == 0.0825
    with pytest.raises(InvalidInputError, match="Give the stiffness of the joint servos"):
        ForceController(controller, {})
    with pytest.raises(InvalidInputError, match="Slow down first"):
        ForceOptions(stiffness=1e4, slow_from=50.0, hold_from=40.0)
    with pytest.raises(InvalidInputError, match="payload"):
        ForceOptions(stiffness=1e4, payload=20.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("factor", [3.0, 10.0])
def test_servos_stiffer_than_said_are_learned_before_the_object_moves(task: Scenario, factor: float) -> None:
    _, made = relaxed(task, late=1, steps=200, off=pin.SE3.Identity(), stiffness=STIFF / factor)
    assert made.stiffer == pytest.approx(factor, rel=0.1)


# -- what is told --------------------------------------------------------------------------------------------------


def test_wrenches_that_do_not_come_hold_the_object_with_the_name_of_the_arm(task: Scenario) -> None:
    made = ForceController(QPController(task.cell, task.grasp, task.path, dt=task.dt), {"stiffness": STIFF})
    made.reset(task.q_start)
    wrenches = np.zeros((3, 6))
    wrenches[1] = np.nan
    for _ in range(10):
        step = made.step(task.q_start, wrenches=wrenches)
    assert step.status is Status.HOLDING
    assert "no new wrench of arm slave_1 for" in step.reason
    made.reset(task.q_start)
    assert made.step(task.q_start, wrenches=np.zeros((3, 6))).status is Status.PAUSED


def test_without_measured_configurations_the_reason_says_what_is_missing(task: Scenario) -> None:
    made = ForceController(QPController(task.cell, task.grasp, task.path, dt=task.dt), {"stiffness": STIFF})
    made.reset(task.q_start)
    for _ in range(20 + round(made.options.check_time / task.dt)):
        step = made.step(wrenches=np.zeros((3, 6)))
    assert step.status is Status.PAUSED
    assert "give q_measured" in step.reason
    assert "q_measured" not in made.step(task.q_start, wrenches=np.zeros((3, 6))).reason


def test_wrenches_of_another_shape_are_refused_before_anything_changes(task: Scenario) -> None:
    made = ForceController(QPController(task.cell, task.grasp, task.path, dt=task.dt), {"stiffness": STIFF})
    made.reset(task.q_start)
    with pytest.raises(InvalidInputError, match=r"Give one per arm, \(3, 6\)"):
        made.step(task.q_start, wrenches=np.zeros((2, 6)))
    with pytest.raises(InvalidInputError, match="has no force sensors"):
        simulate(made, KinematicPlant(task.cell), q_start=task.q_start)


def test_a_grasp_out_of_reach_holds_the_object(task: Scenario) -> None:
    _, made = relaxed(task, late=0, steps=150, reach=1e-4)
    step = made.step(task.q_start, wrenches=made._relaxation.seen)
    assert step.status is Status.HOLDING
    assert "cannot give way any further" in step.reason
    assert np.linalg.norm(made.shift[:, :3], axis=1).max() <= 1e-4 * (1.0 + 1e-12)


@pytest.mark.parametrize("how", [copy.copy, copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made))])
@pytest.mark.parametrize(("steps", "presses"), [(5, True), (40, True), (40, False), (80, False), (150, False)])
def test_a_copy_goes_on_bit_for_bit(how: Callable[[Any], Any], steps: int, presses: bool, task: Scenario) -> None:
    """In each stage; under noise, the arms press whatever they feel."""
    made = ForceController(
        QPController(task.cell, task.grasp, task.path, dt=task.dt), {"stiffness": 1e5, "presses": presses}
    )
    made.reset(task.q_start)
    rng, q = np.random.default_rng(steps), task.q_start
    for _ in range(steps):
        q = made.step(q, wrenches=rng.normal(size=(3, 6))).q_next
    other, original = how(made), made.controller
    for _ in range(10):
        wrenches = rng.normal(size=(3, 6))
        step, copied = made.step(q, wrenches=wrenches), other.step(q, wrenches=wrenches)
        np.testing.assert_array_equal(copied.q_next, step.q_next)
        assert copied.reason == step.reason
        q = step.q_next
    assert other.controller is not original


def test_a_length_of_a_step_that_is_refused_moves_no_grasp_further(task: Scenario) -> None:
    """A clock that leaps by 50 s let the grasps give way by 9.6 mm in one step; short numbers count as others do."""
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(inner, {"stiffness": 1e5, "check_time": 0.0, "presses": False})
    made.reset(task.q_start)
    q, push, rng = task.q_start, np.zeros((3, 6)), np.random.default_rng(0)
    push[:2, 0] = 60.0, -60.0
    for _ in range(200):  # what never changes while the arms move is no reading
        q = made.step(q, wrenches=0.1 * push + 1e-3 * rng.normal(size=(3, 6))).q_next

    def given(dt: Any) -> Array:
        other = copy.copy(made)
        other.step(q, wrenches=push, dt=dt)
        return other.shift

    nominal = given(None)
    assert np.abs(nominal - made.shift).max() > 0.0
    for dt in (50.0, 1e9, -1.0, np.nan, np.inf, "1"):
        np.testing.assert_array_equal(given(dt), nominal)
    half = np.float32(0.5 * task.dt)
    np.testing.assert_array_equal(given(half), given(float(half)))
    assert np.abs(given(half) - nominal).max() > 0.0


# -- the controller's grasp ----------------------------------------------------------------------------------------


def test_arms_follow_a_grasp_that_moves(task: Scenario) -> None:
    """The chain closes at the new placements; a copy goes on bit for bit; zeros lead back."""
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    controller.reset(task.q_start)
    shift = np.array([1e-3 * np.array([k, -k, 0.5 * k, 0.3 * k, 0.0, k]) for k in range(3)])
    new = [pin.exp6(d) * X for d, X in zip(shift, task.grasp.T_object_tool, strict=True)]
    controller.step()
    controller.shift_grasp(shift)
    copied = None
    for i in range(60):
        step = controller.step()
        if i == 30:
            copied = copy.copy(controller)
        elif copied is not None:
            np.testing.assert_array_equal(copied.step().q_next, step.q_next)
    O = Grasp(tuple(new)).carried(CellState(task.cell, step.q_next))
    assert max(np.abs(pin.log6(O[0].actInv(o)).vector).max() for o in O) < 1e-6
    controller.shift_grasp(np.zeros((3, 6)))
    for _ in range(150):
        step = controller.step()
    assert step.relative_errors.max() < 3e-6
    for bad in (shift[:2], np.full((3, 6), np.nan)):
        with pytest.raises(InvalidInputError, match="shift_grasp"):
            controller.shift_grasp(bad)


def test_the_tools_of_the_pseudo_inverse_follow_a_grasp_that_moves(task: Scenario) -> None:
    """At rest: what counts is where the tools are on the object, and the first arm's share leaves the object there."""
    controller = PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt)
    controller.reset(task.q_start)
    controller.set_override(0.0)
    d = np.array([np.zeros(6), [1e-4, -2e-4, 3e-4, 1e-4, 0, 2e-4], [0, 1e-4, 0, 0, -2e-4, 0]])
    for share in np.linspace(0.1, 1.0, 10):
        controller.shift_grasp(share * d)
        step = controller.step()
    assert step.status is Status.PAUSED
    there = Grasp(tuple(pin.exp6(x) * X for x, X in zip(d, task.grasp.T_object_tool, strict=True)))
    O = there.carried(CellState(task.cell, step.q_next))
    assert max(np.abs(pin.log6(task.path.pose(0.0).actInv(o)).vector).max() for o in O) < 1e-7


@pytest.mark.core
def test_a_grasp_that_moves_as_recorded(task: Scenario, golden: Golden) -> None:
    made = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made.reset(task.q_start)
    done, rng = golden.of(made), np.random.default_rng(0)
    for _ in range(40):
        shift = 1e-4 * rng.normal(size=(3, 6))
        done.ask(lambda controller, shift=shift: controller.shift_grasp(shift))
        done.take()


#: Cases that take longer than others, and their steps.
LONG = {"palms": 340, "on a lift": 700}
FAULTS = ("none", "noise", "lost", "late", "silent", "wrong", "out of reach", "palms", "lags", "on a lift")


def fed(
    made: ForceController, case: str, steps: int, *, start: Array, as_lists: bool = False, done: Run | None = None
) -> list[Any]:
    """Commands, statuses and reasons of scripted samples, with copies in between."""
    rng, q, late, out = np.random.default_rng(0), start, np.zeros((len(made.cell), 6)), []
    push = np.random.default_rng(1).normal(size=late.shape)
    for i in range(steps):
        drawn, missing = rng.normal(size=late.shape), rng.random(len(late)) < 0.1
        w = (0.5 + 15.0 * (case == "noise" and i > 180)) * drawn + (case == "wrong") * 40.0 * push
        if case == "palms":
            w[:, 2] += 200.0 if i > 20 else 0.0
            w[:, 1] += min(max(i - 210.0, 0.0), 120.0)
        if case == "out of reach":
            w += min(i, 60) * push
        w, late = (late, w) if case == "late" else (w, late)
        if case == "lost":
            w[missing] = np.nan
        given = None if (case == "silent" and i > 150) or (case == "lost" and i % 9 == 0) else w
        dt = (None, 0.8 * made.dt, -1.0, 1.2 * made.dt, 1)[i % 5] if case == "lags" else None
        if as_lists:
            step = made.step(q.tolist(), wrenches=None if given is None else given.tolist(), dt=dt)
        else:
            step = made.step(q, wrenches=given, dt=dt)
        q = step.q_next if done is None else done.add(step).q_next
        out.append((q.tobytes(), step.rate, step.status, step.reason, made.shift.tobytes()))
        if i % 90 == 80:
            made = copy.copy(made) if i % 180 > 90 else pickle.loads(pickle.dumps(made))
    return out


def scripted(case: str) -> tuple[ForceController, Array]:
    options: dict[str, Any] = {"stiffness": 1e5, "presses": False, "check_time": 0.02, "sensor_tolerance": 25.0}
    task = palm_box() if case == "palms" else paper_lift(time_law="quintic")
    if case == "on a lift":
        task, options["stiffness"] = torso_lift(), [1e6, *[1e5] * 12]
    if case == "palms":
        palms = (Grip(kind="palm", friction=0.6, radius=0.05),) * 2
        payload = Payload(mass=20.0, centre=task.T_object_body.translation)
        options |= {"palms": palms, "squeeze": 200.0, "most_squeeze": 210.0, "payload": payload}
        options |= {"sensor_tolerance": 1e4, "stiffness": 1e4}
    if case == "out of reach":
        options |= {"reach": 2e-5}
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(inner, options)
    made.reset(task.q_start)
    return made, task.q_start


WORDS = {
    "none": "", "noise": "slower from", "lost": "", "late": "", "silent": "no new wrench of arm", "lags": "",
    "wrong": "does not agree", "out of reach": "cannot give way", "palms": "of the friction", "on a lift": "",
}  # fmt: skip


@pytest.mark.core
@pytest.mark.parametrize("case", [pytest.param(case, marks=[pytest.mark.slow] * (case == "palms")) for case in FAULTS])
def test_a_step_is_the_same_whether_python_takes_part_or_not(case: str) -> None:
    """Lists keep a step out of the core: every command and every word is the same, to the last bit."""
    steps = LONG.get(case, 230)
    (made, start), (other, _) = scripted(case), scripted(case)
    whole = fed(made, case, steps, start=start)
    assert whole == fed(other, case, steps, start=start, as_lists=True)
    assert any(WORDS[case] in words and status is not Status.FAULT for _, _, status, words, _ in whole)
    assert case in ("wrong", "out of reach") or max(rate for _, rate, *_ in whole) > 0.0, "the object moved"


@pytest.mark.core
@pytest.mark.slow
@pytest.mark.parametrize("case", FAULTS)
def test_steps_with_wrenches_as_recorded(case: str, golden: Golden) -> None:
    made, start = scripted(case)
    same = 5e-8 if case == "noise" else 1e-8  # noise carries roundings into the rate
    fed(made, case, LONG.get(case, 230), start=start, done=golden.of(made, same))


@pytest.mark.core
def test_the_haste_of_joints_is_that_of_what_is_commanded(task: Scenario) -> None:
    """As a path begins it rises, and once its speed is constant it is forgotten."""
    there = task.path.pose(0.0)
    line = LinePath.displaced(there, translation=(0.0, 0.0, 0.3), duration=2.0, time_law="linear")
    made = ForceController(
        QPController(task.cell, task.grasp, line, dt=0.01), {"stiffness": 1e5, "presses": False, "check_time": 0.0}
    )
    made.reset(task.q_start)
    rng, q, haste, seen = np.random.default_rng(0), task.q_start, relaxation_scalars(made._relaxation.memory), []
    for _ in range(100):
        step = made.step(q, wrenches=0.5 * rng.normal(size=(3, 6)))
        q = step.q_next
        seen.append(haste.joint_acceleration)
    assert step.rate == 1.0
    assert max(seen) > 5.0 * seen[-1]


@pytest.mark.core
def test_two_that_mind_forces_over_one_controller_keep_their_memories_apart() -> None:
    (made, q), (alone, _) = scripted("none"), scripted("none")
    other = ForceController(made.controller, {"stiffness": 1e5})
    rng, own = np.random.default_rng(0), q
    for _ in range(150):
        wrenches = 0.5 * rng.normal(size=(3, 6))
        step, told = made.step(q, wrenches=wrenches), alone.step(own, wrenches=wrenches)
        q, own = step.q_next, told.q_next
        assert (step.reason, q.tobytes()) == (told.reason, own.tobytes())
    assert step.rate > 0.0
    assert not other.internal.any()


@pytest.mark.core
def test_memory_of_another_size_is_refused_by_the_core() -> None:
    relax, allow, memory = _core.relax, _core.allow, np.zeros(relaxation_size(3))
    for call in (
        lambda: relax(memory, 2, None, 0.1),
        lambda: relax(memory, 3, np.zeros(18), 0.1),
        lambda: relax(memory, 3, np.zeros((6, 3)), 0.1),
        lambda: relax(memory, 65, None, 0.1),
        lambda: allow(memory[:-1], 3, 0.1),
        lambda: allow(memory[::2], 1, 0.1),
    ):
        with pytest.raises((ValueError, TypeError)):
            call()
    assert not memory.any()


# -- in the engine -------------------------------------------------------------------------------------------------


def lifted(
    task: Scenario, *, run: float = 2.0, presses: bool = True, **disturbances: Any
) -> tuple[Array, Any, ForceController]:
    """Internal force at each step of the lift's first seconds (T,) [N]; the run; the controller."""
    plant = PhysicsPlant.of(task, disturbances=Disturbances(wrench_latency=0.01, **disturbances))
    payload = Payload(mass=plant.object_mass, centre=task.T_object_body.translation)
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(controller, {"stiffness": plant.stiffness, "payload": payload, "presses": presses})
    forces: list[float] = []

    def read(_: Any) -> None:
        internal = internal_wrenches(plant.sensed_wrenches(), task.grasp)
        forces.append(float(np.linalg.norm(internal[:, :3], axis=1).max()))

    found = simulate(made, plant, q_start=task.q_start, duration=run, observe=read)
    return np.array(forces), found, made


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_an_arm_whose_base_is_off_squeezes_no_more(task: Scenario) -> None:
    """286 N without (``benchmarks/forces.py``)."""
    axis = np.ones(3) / np.sqrt(3.0)
    off = pin.SE3(pin.exp3(np.deg2rad(0.1) * axis), 1e-3 * axis)
    forces, run, _ = lifted(task, run=6.0, base_offset={"slave_2": off})
    assert run.clock[-1] > 1.0
    assert forces.max() < 30.0
    assert forces[run.rate > 0.0].max() < 20.0


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "apart"), [(-1.0, 98), (0.0, 49), (2.0, 49)])
def test_a_sensor_that_tells_something_else_is_found_at_rest(task: Scenario, gain: float, apart: int) -> None:
    """Also without presses. A reading that never changes is no reading, without noise."""
    noise = {"wrench_noise": 0.1} if gain == 0.0 else {}
    _, run, made = lifted(task, run=0.6, presses=False, wrench_gain={"slave_2": gain}, **noise)
    assert run.statuses[-1] is Status.HOLDING
    assert f"the force sensor of arm slave_2 does not agree with its servos: {apart} N" in run.notes[-1]
    assert run.clock[-1] == 0.0
    np.testing.assert_allclose(made.shift, 0.0, atol=1e-6)


@pytest.mark.slow
def test_a_controller_of_a_user_gets_wrenches_if_it_says_so(task: Scenario) -> None:
    """What wraps a controller is asked as the one within."""

    class Wrapped:
        needs_wrenches = True

        def __init__(self, inner: ForceController) -> None:
            self.cell, self.grasp, self.path, self.dt = inner.cell, inner.grasp, inner.path, inner.dt
            self.reset, self.step = inner.reset, inner.step

    plant = PhysicsPlant.of(task)
    inner = ForceController(QPController(task.cell, task.grasp, task.path, dt=task.dt), {"stiffness": plant.stiffness})
    reasons: list[str] = []
    simulate(
        Wrapped(inner), plant, q_start=task.q_start, duration=0.3, observe=lambda step: reasons.append(step.reason)
    )
    assert "the arms press each other a little" in reasons[-1]


# -- with the default supervision ------------------------------------------------------------------------------------


def by_default(
    duration: float, *, until: float = 9.0, presses: bool = True, softer: float = 1.0, **disturbances: Any
) -> tuple[Array, list[Any], float]:
    """A lift from the first command on: the internal force (T,) [N], steps, and when the path ended [s]."""
    task = paper_lift(time_law="quintic", duration=duration)
    options: dict[str, Any] = {"grips": "where they are", "timestep": 2e-3}
    told = PhysicsPlant.of(task, options=options).stiffness
    if softer != 1.0:
        options |= {"stiffness": softer * told, "timestep": 5e-4}
    plant = PhysicsPlant.of(task, disturbances=Disturbances(**disturbances), options=options)
    payload = Payload(mass=plant.object_mass, centre=task.T_object_body.translation)
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(inner, {"stiffness": told, "payload": payload, "presses": presses})
    q, forces, steps, now, ended = plant.reset(task.q_start), [], [], 0.0, np.inf
    made.reset(q)
    while now < min(until, ended):
        step = made.step(q, wrenches=plant.measured_wrenches())
        q, now = plant.apply(step), now + step.dt
        felt = internal_wrenches(plant.sensed_wrenches(), task.grasp)[:, :3]
        forces.append(np.linalg.norm(felt, axis=1).max())
        steps.append(step)
        ended = now if step.finished else ended
    return np.array(forces), steps, ended


@pytest.mark.slow
@pytest.mark.parametrize("softer", [0.3, 3.0])
def test_other_servos_than_told_lift_slowly_at_first(softer: float) -> None:
    """Relaxation and the rate chased each other: 60 N, and the drift went on past the path's end."""
    forces, steps, ended = by_default(1.0, presses=False, softer=softer, wrench_latency=0.01)
    assert np.isfinite(ended)
    assert forces.max() < 30.0
    rates = [step.rate for step in steps if step.clock > 0.0]
    assert rates[0] <= 0.25
    assert not [step.reason for step in steps if "out of step" in step.reason or "its wrench" in step.reason]


@pytest.mark.slow
@pytest.mark.parametrize(("duration", "most"), [(1.0, 20.0), (0.5, 273.0)])
def test_a_cell_without_any_error_is_not_squeezed(duration: float, most: float) -> None:
    """The supervision took the relaxation's own parting for arms out of step: 497 N, and the path was not finished."""
    forces, steps, ended = by_default(duration)
    assert np.isfinite(ended)
    assert forces.max() < most
    assert not [step.reason for step in steps if "out of step" in step.reason or "its wrench" in step.reason]


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["master", "slave_2"])
def test_an_arm_that_stops_in_its_grip_is_named_by_its_wrench(arm: str) -> None:
    _, steps, _ = by_default(2.0, until=1.23, presses=False, stall={arm: 1.2})
    before = [step for step in steps if step.status is Status.HOLDING]
    assert before, "within 25 ms"
    assert f"arm {arm} is" in before[0].reason
    assert "from where its wrench puts its servos" in before[0].reason
    assert before[0].cause is Cause.TRACKING


@pytest.mark.slow
def test_late_wrenches_are_named_and_relaxed_more_slowly(task: Scenario) -> None:
    """Told 10 ms and really 120: they would swing (``test_the_loop_is_stable_up_to_the_delay_that_it_allows``)."""
    world = Elastic(task.cell, misplaced(task.cell, task.grasp, {"slave_2": OFF}), late=round(0.12 / task.dt))
    held = HoldPath(task.path.pose(0.0), duration=100.0)
    inner = QPController(task.cell, task.grasp, held, dt=task.dt)
    made = ForceController(inner, {"stiffness": STIFF, "presses": True, "delay": 0.01})
    made.reset(task.q_start)
    commanded, steps, forces = task.q_start, [], []
    for _ in range(950):
        measured, wrenches = world.answer(commanded)
        steps.append(made.step(measured, wrenches=wrenches))
        commanded = steps[-1].q_next
        forces.append(float(np.linalg.norm(world.past[-1][:, :3], axis=1).max()))
    assert not any(step.status is Status.HOLDING for step in steps)
    named = [step.reason for step in steps if "relax more slowly" in step.reason]
    assert named
    assert "the sensor of arm slave_1: its wrenches come" in named[0]
    assert made.sensors is not None
    assert made.sensors.latest == pytest.approx(0.12, abs=0.02)
    assert forces[-1] < 3.0 < 10.0 < forces[0]


@pytest.mark.slow
def test_samples_lost_at_random_are_no_silence_but_none_at_all_are(task: Scenario) -> None:
    """In steps of 7.5 ms, seven lost ones in a row are 52 ms: of 30 % lost ones they come in one start of three."""
    world = Elastic(task.cell, task.grasp, late=1)
    held, rng = HoldPath(task.path.pose(0.0), duration=100.0), np.random.default_rng(3)
    made = ForceController(QPController(task.cell, task.grasp, held, dt=task.dt), {"stiffness": STIFF})
    made.reset(task.q_start)
    commanded, runs = task.q_start, np.zeros((2, 3), dtype=int)  # of lost ones in a row, now and the longest
    for i in range(1000):
        measured, wrenches = world.answer(commanded)
        lost = rng.random(3) < 0.3
        lost[1] |= i >= 900
        runs[0] = np.where(lost, runs[0] + 1, 0)
        runs[1] = np.maximum(runs[1], runs[0])
        step = made.step(measured, wrenches=np.where(lost[:, None], np.nan, wrenches))
        commanded = step.q_next
        if step.status is Status.HOLDING:
            break
    assert made.sensors is not None
    assert [finding.lost for finding in made.sensors.findings] == pytest.approx([0.3] * 3, abs=0.06)
    assert 900 < i < 920
    assert "no new wrench of arm slave_1" in step.reason
    assert runs[1].max() * task.dt > made.options.silent_time


@pytest.mark.slow
@pytest.mark.parametrize("softer", [(0.1, 0.1, 0.1), (1.0, 1.0, 0.3), (2.0, 1.0, 1.0)])
def test_presses_find_how_stiff_each_arm_is_and_blame_no_sensor(softer: tuple[float, ...]) -> None:
    """They had: a sensor with 14 N too much at rest, or with torques that were 0.41 times the real ones."""
    task = paper_lift(time_law="quintic")
    told = PhysicsPlant.of(task)
    each = np.repeat(softer, 6)
    options = {"grips": "where they are", "stiffness": each * told.stiffness, "timestep": 5e-4}
    options["damping"] = np.sqrt(each) * np.tile([3160.0, 3160.0, 1265.0, 167.0, 167.0, 71.0], 3)
    plant = PhysicsPlant.of(task, options=options, disturbances=Disturbances(wrench_latency=0.01, wrench_noise=0.5))
    payload = Payload(mass=task.object_mass, centre=task.T_object_body.translation)
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(inner, {"stiffness": told.stiffness, "payload": payload, "presses": True})
    q = plant.reset(task.q_start)
    made.reset(q)
    for _ in range(800):
        step = made.step(q, wrenches=plant.measured_wrenches())
        if made.sensors is not None:
            break
        q = plant.apply(step)
    assert made.sensors is not None
    assert made.sensors.fine, made.sensors.explain()
    assert step.status is not Status.HOLDING
    np.testing.assert_allclose(made.sensors.stiffer * made.sensors.arms_stiffer, softer, rtol=0.3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_presses_blame_no_sensor_for_a_payload_that_is_told_wrong(task: Scenario) -> None:
    """The servos bear the rest: half of it had been a gain of 2 of all sensors."""
    half = Payload(mass=0.5 * task.object_mass, centre=task.T_object_body.translation)
    load = LoadShare(task.cell, task.grasp, half, internal_force=50.0)
    plant = PhysicsPlant.of(task, load=load, disturbances=Disturbances(wrench_latency=0.01))
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(inner, {"stiffness": plant.stiffness, "payload": half, "presses": True})
    found = simulate(made, plant, q_start=task.q_start, duration=4.6)
    assert made.sensors is not None
    assert made.sensors.fine, made.sensors.explain()
    assert Status.HOLDING not in found.statuses


@pytest.mark.slow
def test_forces_that_grow_by_themselves_end_the_presses(task: Scenario) -> None:
    """As of a plate that grows warm: pressed for 4 s without relaxing, its arms squeezed it with 169 N."""
    held = HoldPath(task.path.pose(0.0), duration=100.0)
    inner = QPController(task.cell, task.grasp, held, dt=task.dt)
    made = ForceController(inner, {"stiffness": STIFF, "presses": True})
    made.reset(task.q_start)
    commanded, forces, late = task.q_start, [], np.zeros((3, 6))
    for i in range(300):
        if i % 10 == 0:  # the grip of one arm wanders by 0.5 mm a second
            wandered = pin.SE3(np.eye(3), np.array([0.0, 5e-4 * task.dt * i, 0.0]))
            world = Elastic(task.cell, misplaced(task.cell, task.grasp, {"slave_2": wandered}), late=0)
        measured, wrenches = world.answer(commanded)
        step = made.step(measured, wrenches=late)
        commanded, late = step.q_next, wrenches
        forces.append(float(np.linalg.norm(wrenches[:, :3], axis=1).max()))
    assert made.sensors is None
    assert max(forces) < 60.0
    assert forces[-1] < 10.0


class Pushed:
    """A ForceController whose object is pushed: by wrenches of arms that carry the payload, less the push."""

    def __init__(self, task: Scenario, *, mass: float = 20.0, path: Any = None, acceleration: Any = None):
        self.payload, self.mass = Payload(mass=20.0, centre=task.T_object_body.translation), mass
        scale = np.tile([1.0, 1.0, 1.0, 0.1, 0.1, 0.1], 3)  # as the load is shared, so that nothing is internal
        total = np.hstack([X.actionInverse.T for X in task.grasp.T_object_tool])
        self.shares = scale[:, None] * np.linalg.pinv(total * scale)
        self.rng, self.path = np.random.default_rng(0), path or task.path
        cell = task.cell if acceleration is None else task.cell.with_limits(acceleration=acceleration)
        options = {"supervision": {"slow_from": None}}
        inner = QPController(cell, task.grasp, self.path, dt=task.dt, options=options)
        # The wrenches do not answer presses.
        told = {"stiffness": STIFF, "payload": self.payload, "sensor_tolerance": 1e3, "presses": False}
        self.made = ForceController(inner, told)
        self.made.reset(task.q_start)
        self.cell, self.grasp, self.q, self.steps = cell, task.grasp, task.q_start, list[Any]()

    def go(self, steps: int, push: Any = (0.0, 0.0, 0.0)) -> Any:
        """Some steps; returns the last."""
        for _ in range(steps):
            R = self.path.pose(self.steps[-1].clock if self.steps else 0.0).rotation
            force = R.T @ (np.array([0.0, 0.0, 9.81 * self.mass]) - push)
            felt = (self.shares @ np.r_[force, np.cross(self.payload.centre, force)]).reshape(3, 6)
            felt += 0.02 * self.rng.normal(size=(3, 6))
            self.steps.append(self.made.step(self.q, wrenches=felt))
            self.q = self.steps[-1].q_next
        return self.steps[-1]

    def at(self) -> Array:
        """Where the first arm holds the object."""
        out: Array = (CellState(self.cell, self.q).T_world_tool[0] * self.grasp.T_object_tool[0].inverse()).translation
        return out


@pytest.mark.parametrize("way", [(0.0, 0.0, 1.0), (-0.6, 0.0, 0.8)])
def test_a_push_on_the_object_holds_it_with_the_direction(way: Any, task: Scenario) -> None:
    """Also an object of another mass than told. It goes back, and rests until it is told to go on."""
    for mass in (20.0, 12.0):
        world = Pushed(task, mass=mass)
        step = world.go(300)
        assert step.status is Status.TRACKING, step.reason
        before = world.at()
        step = world.go(3, 60.0 * np.array(way))
        assert step.status is Status.HOLDING
        assert step.cause is Cause.CONTACT
        step = world.go(20)
        assert "N have pushed it towards " + ("+z" if way[2] == 1.0 else "(-0.6, 0.0, 0.8)") in step.reason
        np.testing.assert_allclose(step.velocity, 0.0, atol=1e-6)
        assert 0.0 < (world.at() - before) @ way < 2e-3
    step = world.go(150)
    assert (step.status, step.cause) == (Status.HOLDING, Cause.CONTACT)
    world.made.resume()
    step = world.go(20)
    assert step.status is not Status.HOLDING
    assert step.rate > 0.0


@pytest.mark.parametrize("acceleration", [None, 10.0])
def test_an_object_that_meets_something_goes_back_the_way_it_came(acceleration: Any, task: Scenario) -> None:
    """Against the push, not along it; within the limits, with the arms together, and no farther than there is room."""
    start = task.path.pose(0.0)
    down = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, -0.08]))
    world = Pushed(task, path=WaypointPath([start, down], durations=[1.0]), acceleration=acceleration)
    while world.go(1).clock < 0.5:
        pass
    before = world.at()
    step = world.go(80, [40.0, 0.0, 60.0])
    assert step.cause is Cause.CONTACT
    assert max(step.commanded_apart for step in world.steps) < 1e-5
    limit = 1.0 + 1e-9
    assert all(np.abs(step.velocity / world.cell.limits.velocity).max() < limit for step in world.steps)
    moved = world.at() - before
    assert 0.02 < moved[2] < 0.02 + 0.2 * 0.15
    np.testing.assert_allclose(step.velocity, 0.0, atol=1e-6)
    assert abs(moved[0]) < 1e-3


def test_what_holds_otherwise_does_not_go_back(task: Scenario) -> None:
    """Wrenches that do not come any more say nothing of the push."""
    world = Pushed(task)
    world.go(300)
    step = world.go(3, [0.0, 0.0, 60.0])
    assert step.cause is Cause.CONTACT
    for _ in range(40):
        step = world.made.step(world.q)
        world.q = step.q_next
    assert (step.status, step.cause) == (Status.HOLDING, Cause.SENSOR)
    np.testing.assert_allclose(step.velocity, 0.0, atol=1e-6)


def test_a_contact_limit_needs_to_know_the_payload() -> None:
    with pytest.raises(InvalidInputError, match="contact_limit without a payload"):
        ForceOptions(stiffness=1e5, contact_limit=30.0)
    assert ForceOptions(stiffness=1e5, contact_limit=np.inf).contact_limit == np.inf


def test_a_grip_out_of_reach_is_refused_by_name(task: Scenario) -> None:
    """Held at 1.3 N it was pulled to 1379 N."""
    X = [*task.grasp.T_object_tool]
    X[1] = pin.SE3(X[1].rotation, X[1].translation + np.array([0.0, 0.0, 0.012]))
    made = ForceController(QPController(task.cell, Grasp(X), task.path, dt=task.dt), {"stiffness": STIFF})
    with pytest.raises(InvalidInputError, match=r"arm slave_1 holds the object 12\.0 mm .* out of reach \(10 mm"):
        made.reset(task.q_start)


def test_the_object_stays_where_it_is_until_the_arms_have_relaxed(task: Scenario) -> None:
    """Off its path, the first command pulled it there with 68 N."""
    off = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-3])) * task.path.pose(0.0)
    q = inverse_kinematics(task.cell, task.grasp, off, task.q_start)
    inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(inner, {"stiffness": STIFF})
    with pytest.warns(StartWarning, match="off its path"):
        made.reset(q)
    for _ in range(20):
        step = made.step(q, wrenches=np.zeros((3, 6)))
    np.testing.assert_allclose(step.q_next, q, atol=1e-9)


# -- an operator ---------------------------------------------------------------------------------------------------


def test_back_by_hand_and_on_while_forces_are_relaxed(task: Scenario) -> None:
    """The operator's calls are those of the controller within; the arms go on to relax."""
    cell = task.cell.with_limits(acceleration=5.0)
    world = Elastic(cell, misplaced(cell, task.grasp, {"slave_2": OFF}), late=1)
    controller = QPController(cell, task.grasp, task.path, dt=task.dt)
    made = ForceController(controller, {"stiffness": STIFF, "check_time": 0.0, "presses": False})
    made.reset(task.q_start)
    commanded, seen = task.q_start, []

    def until(done: Callable[[ControlStep], bool]) -> ControlStep:
        nonlocal commanded
        for _ in range(4000):
            measured, wrenches = world.answer(commanded)
            step = made.step(measured, wrenches=wrenches)
            commanded = step.q_next
            seen.append(step.status)
            if done(step):
                return step
        raise AssertionError(step)

    until(lambda step: step.clock > 0.5)
    made.reverse(0.1)
    until(lambda step: step.status is Status.PAUSED and step.clock == 0.1)
    made.forward()
    until(lambda step: step.clock > 0.4)
    made.jog([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], deadman_s=0.5)
    until(lambda step: step.status is Status.JOGGING and step.rate > 0.5)
    until(lambda step: step.status is Status.JOGGING and not step.rate > 0.0)
    made.return_to_path()
    until(lambda step: step.sense == 1)
    belt = made.controller.program_clock
    for i in range(200):
        made.gear(belt + 0.3 * i * task.dt, speed=0.3)
        until(lambda step: True)
    made.set_override(1.0)
    until(lambda step: step.finished)
    assert Status.HOLDING not in seen
    forces = np.linalg.norm(world.past[-1][:, :3], axis=1).max()
    assert forces < 0.3 * np.linalg.norm(world.past[0][:, :3], axis=1).max()
