"""What a ForceController says and does, stage by stage: sensors that are compared, causes, operators, refusals."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Cause, ForceController, HoldPath, InvalidInputError, QPController, Status, inverse_kinematics
from coopqp.baselines import PseudoInverseController
from coopqp.errors import StartWarning
from coopqp.forces import internal_wrenches
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array

LIFT, DT = paper_lift(time_law="quintic"), 0.01
START = LIFT.q_start


def made(**options: Any) -> ForceController:
    alone = {"supervision": {"slow_from": None}}  # the wrenches do not answer motions
    inner = QPController(LIFT.cell, LIFT.grasp, LIFT.path, dt=DT, options=alone)
    out = ForceController(inner, {"stiffness": 1e5, "presses": False, "check_time": 0.1, **options})
    out.reset(START)
    return out


class Felt:
    """Wrenches of a controller's arms with a force between the first two, and a little noise: else it is no reading."""

    def __init__(self, controller: ForceController) -> None:
        self.controller, self.q, self.rng = controller, START, np.random.default_rng(0)

    def go(self, steps: int, force: float = 0.0) -> Any:
        to_tool = [X.action.T for X in LIFT.grasp.T_object_tool]
        push = np.zeros((3, 6))
        push[0, 0], push[1, 0] = force, -force
        for _ in range(steps):
            w = np.array([A @ f for A, f in zip(to_tool, push, strict=True)])
            step = self.controller.step(self.q, wrenches=w + 1e-3 * self.rng.normal(size=(3, 6)))
            self.q = step.q_next
        return step

    def until(self, words: str, force: float = 0.0, most: int = 400) -> Any:
        for _ in range(most):
            step = self.go(1, force)
            if words in step.reason:
                return step
        raise AssertionError(step.reason)


def off(size: float, arm: int) -> Array:
    """Wrenches of which one arm's internal force is this large, the largest [N]."""
    rng = np.random.default_rng(arm)
    while True:
        w = np.zeros((3, 6))
        w[arm, :3] = rng.normal(size=3)
        forces = np.linalg.norm(internal_wrenches(w, LIFT.grasp)[:, :3], axis=1)
        if forces.argmax() == arm:
            return np.asarray(size / forces[arm] * w)


@pytest.mark.parametrize("arm", range(3))
def test_the_sensor_that_differs_most_from_its_servos_is_named(arm: int) -> None:
    """By the mean over the time of the comparison, beyond the tolerance; then the object is held."""
    for size, fine in ((11.8, True), (12.3, False)):
        controller, rng = made(sensor_tolerance=12.0), np.random.default_rng(0)
        steps = 0
        while steps < 30:
            steps += 1
            step = controller.step(START, wrenches=off(size, arm) + 1e-3 * rng.normal(size=(3, 6)))
            if step.status is Status.HOLDING:
                break
        assert (step.status is not Status.HOLDING) == fine
    name = LIFT.cell.arm_names[arm]
    assert f"the force sensor of arm {name} does not agree with its servos: " in step.reason
    assert "N apart (tolerance 12 N)" in step.reason
    assert step.cause is Cause.SENSOR
    assert steps * DT == pytest.approx(0.1, abs=0.025)
    assert controller.step(START, wrenches=np.zeros((3, 6))).status is Status.HOLDING, "until it is reset"
    controller.reset(START)
    assert controller.step(START, wrenches=off(1.0, arm)).status is Status.PAUSED


def test_stages_are_told_one_after_another_with_their_causes() -> None:
    felt, seen = Felt(made()), list[tuple[str, Status, Cause | None]]()
    for _ in range(300):
        step = felt.go(1)
        words = step.reason.partition(":")[0]
        if not seen or seen[-1][0] != words:
            seen.append((words, step.status, step.cause))
        if step.rate >= 1.0 and not step.reason:
            break
    assert [words for words, *_ in seen[:3]] == [
        "the sensors are compared with the servos",
        "the arms press each other a little, to learn how stiff they are and what the sensors read",
        "the arms relax before the object moves",
    ]
    assert [(status, cause) for _, status, cause in seen[:3]] == [
        (Status.PAUSED, Cause.SENSOR), (Status.PAUSED, Cause.LIMIT), (Status.PAUSED, Cause.LIMIT),
    ]  # fmt: skip
    assert step.status is Status.TRACKING
    assert step.cause is None


def test_an_object_off_its_path_waits_for_its_arms_before_it_is_led_back() -> None:
    """PAUSED until it moves, with its distance in the reason; a simulation would end a run that stands OFF_PATH."""
    pose = LIFT.path.pose(0.0) * pin.SE3(pin.exp3(np.deg2rad([0.0, 0.0, 0.3])), np.zeros(3))
    felt = Felt(made())
    felt.q = inverse_kinematics(LIFT.cell, LIFT.grasp, pose, START)
    with pytest.warns(StartWarning, match="off its path"):
        felt.controller.reset(felt.q)
    step, waited = felt.go(1), 0
    while step.rate == 0.0:
        assert (step.status, step.cause in (Cause.SENSOR, Cause.LIMIT)) == (Status.PAUSED, True)
        assert step.reason.endswith("off its path") or "off its path; " in step.reason
        step, waited = felt.go(1), waited + 1
    assert waited > 50
    assert step.status is Status.OFF_PATH
    assert felt.go(300).status is Status.TRACKING


@pytest.mark.parametrize("missing", ["q_measured", "wrenches"])
def test_what_is_missing_for_the_comparison_is_told_after_five_steps_more(missing: str) -> None:
    controller, told = made(silent_time=9.0), -1
    lost = np.random.default_rng(0).normal(size=(3, 6))
    if missing == "wrenches":
        lost[2] = np.nan
    for i in range(40):
        step = controller.step(None if missing == "q_measured" else START, wrenches=lost)
        if "cannot be compared" in step.reason:
            told = i
            break
    assert told * DT == pytest.approx(0.15, abs=0.021)
    assert step.status is Status.PAUSED
    assert step.cause is Cause.SENSOR


def test_an_internal_force_slows_the_object_and_holds_it_no_more_when_it_is_gone() -> None:
    """With its size and the arm, from slow_from on."""
    felt = Felt(made(slow_from=20.0, hold_from=50.0, dead_band=200.0, move_below=15.0))
    for _ in range(400):
        step = felt.go(1)
        if step.rate == 1.0:
            break
    assert step.rate == 1.0
    assert "slower" not in felt.go(25, 15.0).reason
    step = felt.go(25, 40.0)
    assert 0.0 < step.rate < 0.8
    assert step.reason.endswith("(slower from 20 N on)")
    assert "40 N at the grasp of arm " in step.reason
    assert step.status is Status.SLOWED
    assert step.cause is Cause.LIMIT
    assert copy.deepcopy(felt).go(25, 15.0).reason.endswith("(slower from 20 N on); the rate rises")
    np.testing.assert_allclose(np.linalg.norm(felt.controller.internal[:2, :3], axis=1), 40.0, rtol=0.02)
    felt.controller.pause()
    step = felt.go(40, 40.0)
    assert (step.status, step.cause) == (Status.PAUSED, Cause.OPERATOR)
    assert felt.controller.paused
    felt.controller.resume()
    assert felt.go(40).rate > 0.5
    assert not felt.controller.paused


def test_the_override_that_is_asked_for_is_kept_while_forces_allow_less() -> None:
    felt = Felt(made())
    felt.controller.set_override(0.4)
    assert felt.go(1).rate == 0.0
    assert felt.controller.override == 0.4
    for _ in range(300):
        step = felt.go(1)
        if step.rate > 0.39:
            break
    assert step.rate == pytest.approx(0.4)
    assert felt.controller.override == 0.4
    for share in (-0.1, 1.1, np.nan):
        with pytest.raises(InvalidInputError, match="set_override: share"):
            felt.controller.set_override(share)
    felt.controller.set_override(0.0)
    assert felt.go(40).rate == 0.0
    other = copy.copy(felt.controller)
    assert (other.override, other.dt, other.grasp) == (0.0, DT, LIFT.grasp)


def test_what_only_a_qp_controller_can_do_is_refused_by_name() -> None:
    inner = PseudoInverseController(LIFT.cell, LIFT.grasp, LIFT.path, dt=DT)
    controller = ForceController(inner, {"stiffness": 1e5})
    controller.reset(START)
    for call in (controller.pause, controller.resume, lambda: controller.follow(LIFT.path)):
        with pytest.raises(InvalidInputError, match="PseudoInverseController"):
            call()
    with pytest.raises(InvalidInputError, match="PseudoInverseController"):
        controller.reset(START, clock=0.5)
    assert (controller.paused, controller.asked_pose, controller.take_events()) == (False, None, [])
    controller.set_override(0.3)
    assert controller.override == 0.3
    with pytest.raises(InvalidInputError, match="ForceController: controller"):
        ForceController("controller", {"stiffness": 1e5})  # type: ignore[arg-type]


def test_a_start_that_is_refused_changes_nothing() -> None:
    felt = Felt(made())
    felt.until("relax")
    other = copy.copy(felt.controller)
    away = START.copy()
    away[7] += 0.2
    for q, more in ((away, {}), (np.zeros(3), {}), (START, {"clock": -1.0}), (START, {"commanded": np.zeros(2)})):
        with pytest.raises(InvalidInputError):
            felt.controller.reset(q, **more)
    w = np.random.default_rng(5).normal(size=(3, 6))
    for _ in range(3):
        step, kept = felt.controller.step(felt.q, wrenches=w), other.step(felt.q, wrenches=w)
        np.testing.assert_array_equal(step.q_next, kept.q_next)
        assert step.reason == kept.reason


def test_a_start_in_mid_path_goes_on_from_there() -> None:
    """Where the arms hold the object is where their grasps begin: as shifts of at most their reach."""
    controller, clock = made(), 0.5 * LIFT.path.duration
    held = HoldPath(LIFT.path.pose(0.0), duration=9.0)
    inner = QPController(LIFT.cell, LIFT.grasp, held, dt=DT)
    resting = ForceController(inner, {"stiffness": 1e5})
    q = START.copy()
    q[6:12] += 2e-4
    with pytest.warns(StartWarning):
        resting.reset(q)
    moved = resting.shift
    assert 1e-5 < np.abs(moved).max() < 2e-3
    state = copy.copy(resting).step(q, wrenches=np.zeros((3, 6)))
    np.testing.assert_allclose(state.q_next, q, atol=1e-9)
    there = inverse_kinematics(LIFT.cell, LIFT.grasp, LIFT.path.pose(clock), START)
    controller.reset(there, clock=clock)
    step = controller.step(there, wrenches=np.zeros((3, 6)))
    assert step.clock == clock
    np.testing.assert_allclose(step.q_next, there, atol=1e-6)
