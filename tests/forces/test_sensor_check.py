"""Presses at rest, and the check of the sensors by them: on servos in closed form, as stiff as told or otherwise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coopqp import Cause, ControlStep, ForceController, HoldPath, QPController, Status
from coopqp.forces import SensorJudgement
from coopqp.forces.presses import MOST_MOTION, PressPlan, balancing, of_grip
from coopqp.forces.sensor_check import SensorCheck
from coopqp.model import CellState
from coopqp.scenarios import paper_lift, ring
from coopqp.spatial import Array

LIFT, STIFF, DT = paper_lift(), 2e4, 0.02
#: Load that the drives carry [N, N·m], and a stress of the arms at rest, as places of the grasps [m, rad].
LOAD = np.array([0.0, 0.0, 200.0, 0.0, 0.0, 0.0])
STRESS = 1e-5 * np.array([[0.0] * 6, [3.0, -2.0, 1.0, 0.0, 2.0, 1.0], [1.0, 2.0, -2.0, 1.0, 0.0, -1.0]])
TO_TOOLS = np.array([X.action.T for X in LIFT.grasp.T_object_tool])
_STATE = CellState(LIFT.cell, LIFT.q_start)
JACOBIANS = np.array([_STATE.jacobian(k) for k in range(3)])
TWISTS = np.array([X.action @ J for X, J in zip(LIFT.grasp.T_object_tool, JACOBIANS, strict=True)])
SOFT = TWISTS @ TWISTS.swapaxes(1, 2) / STIFF


class Start:
    """Arms at rest that press, and the check of their sensors.

    Args:
        stiffer: real stiffness of the servos over the one that is told, of each arm.
        gains, noise: of each sensor; noise [N, N·m].
        late: steps by which wrenches are late.
        grows: wrench by which the servos of the first arm push more each second, as told (6,) [N/s, N·m/s].
        silent: no wrench comes at all.
    """

    def __init__(
        self, *, stiffer: Any = 1.0, gains: Any = 1.0, noise: float = 0.0, grows: Any = None, silent: bool = False,
        known: bool = True, tolerance: float = 10.0, latest: float = 0.03, late: int = 0,
    ) -> None:  # fmt: skip
        real = np.broadcast_to(np.asarray(stiffer, dtype=float), 3)
        self.G, self.real = of_grip(SOFT / real[:, None, None]), real
        self.gains = np.broadcast_to(np.asarray(gains, dtype=float), 3)
        self.noise, self.silent, self.late = noise, silent, late
        self.grows = np.zeros(6) if grows is None else np.asarray(grows, dtype=float)
        self.rng, self.time, self.shifts, self.told = np.random.default_rng(3), 0.0, [np.zeros((3, 6))], list[Array]()
        self.check = SensorCheck(
            LIFT.cell, LIFT.grasp, softness=np.full(18, 1.0 / STIFF), q=LIFT.q_start, load=LOAD if known else None,
            tolerance=tolerance, latest=latest,
        )  # fmt: skip
        maps = np.hstack([X.actionInverse.T for X in LIFT.grasp.T_object_tool])
        metric = np.tile([1.0] * 3 + [100.0] * 3, 3)
        self.carried = (maps.T @ np.linalg.solve((maps / metric) @ maps.T, LOAD) / metric).reshape(3, 6)

    def go(self) -> Array:
        """One step: the next places of the grasps."""
        at = STRESS + self.shifts[-1]
        pushed = np.einsum("kij,kj->ki", TO_TOOLS, (self.G @ at.ravel()).reshape(3, 6))
        moved = np.concatenate([np.linalg.solve(A, d) for A, d in zip(TWISTS, at, strict=True)])
        bent = np.concatenate([J.T @ w / (STIFF * r) for J, w, r in zip(JACOBIANS, pushed, self.real, strict=True)])
        bent[:6] += JACOBIANS[0].T @ self.grows * self.time / STIFF
        self.told.append(self.gains[:, None] * (pushed + self.carried) + self.noise * self.rng.normal(size=(3, 6)))
        wrenches = None if self.silent else self.told[max(len(self.told) - 1 - self.late, 0)]
        commanded = LIFT.q_start + moved
        self.time += DT
        self.shifts.append(self.check.press(wrenches, commanded, commanded - bent, DT))
        return self.shifts[-1]

    def judged(self) -> SensorJudgement:
        for _ in range(300):
            self.go()
            if self.check.judgement is not None:
                return self.check.judgement
        raise AssertionError("no judgement")


# -- the presses -----------------------------------------------------------------------------------------------------


def softness(arms: int) -> Array:
    rng = np.random.default_rng(arms)
    half = rng.normal(size=(arms, 6, 6)) * np.array([1.0] * 3 + [3.0] * 3)[:, None]
    return np.asarray(1e-6 * half @ half.swapaxes(1, 2) + 1e-6 * np.eye(6))


@pytest.mark.parametrize("arms", [1, 2, 3, 5])
def test_wrenches_of_a_grip_are_those_of_springs_on_a_free_object(arms: int) -> None:
    """The object settles where the springs' wrenches cancel; also with joints that arms share."""
    rng, C = np.random.default_rng(0), softness(arms)
    half = rng.normal(size=(6 * arms, 3))
    for shared in (None, 1e-5 * half @ half.T):
        whole = np.zeros((6 * arms, 6 * arms)) if shared is None else shared.copy()
        for k, own in enumerate(C):
            whole[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += own
        K, together = np.linalg.inv(whole), np.tile(np.eye(6), (arms, 1))
        d = rng.normal(size=6 * arms)
        settled = np.linalg.solve(together.T @ K @ together, together.T @ K @ d)
        w = K @ (d - together @ settled)
        np.testing.assert_allclose(of_grip(C, shared) @ d, w, atol=2e-3 * np.abs(K @ d).max())
    np.testing.assert_allclose(of_grip(C, np.zeros((6 * arms, 6 * arms))), of_grip(C), rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("arm", range(3))
def test_the_others_balance_a_push_with_the_least_wrenches(arm: int) -> None:
    push = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    w = (balancing(LIFT.grasp, arm) @ push).reshape(3, 6)
    np.testing.assert_array_equal(w[arm], push)
    others = [k for k in range(3) if k != arm]
    maps = np.hstack([LIFT.grasp.T_object_tool[k].actionInverse.T for k in others])
    metric = np.tile([1.0] * 3 + [100.0] * 3, 2)
    load = -LIFT.grasp.T_object_tool[arm].actionInverse.T @ push
    least = maps.T @ np.linalg.solve((maps / metric) @ maps.T, load) / metric
    np.testing.assert_allclose(w[others].ravel(), least, atol=1e-9)


@pytest.mark.parametrize("arms", [2, 3, 4])
@pytest.mark.parametrize("with_shared", [False, True])
def test_each_arm_presses_in_turn_along_ways_that_are_square_to_each_other(arms: int, with_shared: bool) -> None:
    """At least six presses in all; the first comes before them, a fifth as large. 6 N, and 1 N·m beside it."""
    grasp, C = ring(arms=arms).grasp, softness(arms)
    half = np.random.default_rng(1).normal(size=(6 * arms, 2))
    shared = 1e-6 * half @ half.T if with_shared else None
    plan = PressPlan(grasp, C, shared)
    each = {2: 3, 3: 2, 4: 2}[arms]
    assert plan.ways.shape == (1 + each * arms, arms, 6)
    np.testing.assert_allclose(plan.ways[0], 0.2 * plan.ways[1])
    assert plan.ends_first == pytest.approx(0.72)
    assert plan.duration == pytest.approx(0.4 + 0.52 * len(plan.ways))
    whole = np.zeros((6 * arms, 6 * arms)) if shared is None else shared
    to_object = np.zeros((6 * arms, 6 * arms))
    for k, X in enumerate(grasp.T_object_tool):
        own = slice(6 * k, 6 * k + 6)
        whole = whole + np.kron(np.diag(np.eye(arms)[k]), C[k])
        to_object[own, own] = X.actionInverse.T
    pushes = np.linalg.solve(whole @ to_object, plan.ways[1:].reshape(-1, 6 * arms).T).T.reshape(each, arms, arms, 6)
    for k in range(arms):
        pressed, all_of = pushes[:, k, k], pushes[:, k]
        forces, torques = pressed[:, :3], pressed[:, 3:]
        np.testing.assert_allclose(np.linalg.norm(forces, axis=1) / np.linalg.norm(torques, axis=1), 6.0)
        for part in (forces, torques):
            unit = part / np.linalg.norm(part, axis=1)[:, None]
            np.testing.assert_allclose(unit @ unit.T, np.eye(each), atol=1e-9)
        for i in range(each):
            np.testing.assert_allclose(all_of[i].ravel(), balancing(grasp, k) @ pressed[i], atol=1e-8)


def test_a_press_goes_to_one_side_and_as_far_to_the_other_and_back() -> None:
    """Smoothly, and only the presses after the first have the size that is asked for."""
    plan = PressPlan(LIFT.grasp, softness(3))
    for t in (-1.0, 0.0, 0.2, 0.2 + 0.52 * len(plan.ways), plan.duration, 9.0):
        np.testing.assert_allclose(plan.shift(t, 1.0), 0.0, atol=1e-15)
    for i, way in enumerate(plan.ways):
        start, size = 0.2 + 0.52 * i, 0.5 if i else 1.0
        times = np.linspace(0.0, 0.52, 53)[1:-1]
        side = [plan.shift(start + t, 0.5).ravel() @ way.ravel() / (way.ravel() @ way.ravel()) / size for t in times]
        np.testing.assert_allclose(side, -np.array(side[::-1]), atol=1e-9)
        np.testing.assert_allclose(np.array(side)[(times > 0.1605) & (times < 0.1795)], 1.0)
        assert side[7] == pytest.approx(0.5), "half way in half the time"
        assert np.abs(np.diff(side)).max() < 2.0 * 1.9 * 0.01 / 0.16
        assert max(side) <= 1.0


# -- the check -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(("stiffer", "close"), [((2.5, 2.5, 2.5), 0.05), ((2.0, 2.5, 3.2), 2.0)])
def test_right_sensors_and_the_stiffness_of_each_arm_are_found(stiffer: Any, close: float, known: bool) -> None:
    """By arms that hold a load under stress of 25 N; nothing of that is taken for a bias."""
    judgement = Start(stiffer=stiffer, known=known).judged()
    assert judgement.fine, judgement.explain()
    np.testing.assert_allclose(judgement.stiffer * judgement.arms_stiffer, stiffer, rtol=5e-3)
    for found in judgement.findings:
        np.testing.assert_allclose(found.bias, 0.0, atol=close)
        np.testing.assert_allclose(found.drift, 0.0, atol=0.03)
        assert found.force_gain == pytest.approx(1.0, abs=1e-3)


def test_what_servos_push_more_and_more_is_no_drift_of_sensors() -> None:
    """Servos that push against nothing, by 1 N more each second: the sensor that does not say so drifts back."""
    found = Start(grows=[0.0, 1.0, 0.0, 0.0, 0.0, 0.1]).judged().findings
    np.testing.assert_allclose(found[0].drift, [0.0, -1.0, 0.0, 0.0, 0.0, -0.1], atol=0.02)
    np.testing.assert_allclose([f.drift for f in found[1:]], 0.0, atol=0.02)
    np.testing.assert_allclose(found[0].bias, 2.0 * found[0].drift, atol=0.1)  # in the middle of 4 s


@pytest.mark.parametrize(("late", "accepted"), [(1, True), (2, False)])
def test_a_sensor_may_be_as_late_as_the_loop_bears(late: int, accepted: bool) -> None:
    judgement = Start(late=late, latest=0.03).judged()
    assert judgement.fine == accepted
    np.testing.assert_allclose([f.delay for f in judgement.findings], late * DT, atol=2e-3)


@pytest.mark.parametrize(("excess", "agree"), [(0.22, True), (0.28, False)])
def test_sensors_agree_if_what_they_read_cancels_within_the_object(excess: float, agree: bool) -> None:
    """By the net force beside all forces that the presses cause, below 15 %; then no sensor has a gain of its own."""
    gains = np.array([1.0, 1.0 + excess, 1.0])
    start = Start(gains=gains)
    judgement = start.judged()
    read = np.array(start.told)[: round(4.04 / DT)] - start.told[0]
    forces = np.einsum("kij,tkj->tki", [X.actionInverse.T for X in LIFT.grasp.T_object_tool], read)[..., :3]
    share = np.sqrt(forces.sum(axis=1).var(axis=0).sum() / forces.var(axis=0).sum())
    assert (share < 0.15) == agree
    expected = np.ones(3) if agree else gains
    np.testing.assert_allclose([f.force_gain for f in judgement.findings], expected, atol=2e-3)


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ({}, 1.0), ({"stiffer": 2.5}, 0.4), ({"stiffer": 2.5, "noise": 0.5}, 0.4), ({"stiffer": 0.8}, 1.25),
        ({"stiffer": 0.2}, 2.0), ({"stiffer": 60.0}, 0.05), ({"silent": True}, 1.0), ({"gains": 0.0}, 2.0),
        ({"gains": (1.0, 0.0, -1.0)}, 1.0),
    ],
)  # fmt: skip
def test_presses_are_as_strong_as_meant_also_with_other_servos(given: dict[str, Any], size: float) -> None:
    """By what most sensors hear of the first one, which is small; within limits where that is little or too much."""
    start, plan = Start(**given), PressPlan(LIFT.grasp, SOFT)
    shifts = []
    for i in range(round(1.6 / DT)):
        assert start.check.began == (i * DT > 0.2 + 1e-9)
        shifts.append(start.go())
    times = DT * np.arange(1, len(shifts) + 1)
    first = [plan.shift(t, 1.0) for t in times if t < 0.71]
    np.testing.assert_allclose(shifts[: len(first)], first, atol=1e-12)
    after = np.array([plan.shift(t, 1.0) for t in times if t > 0.73])
    own = np.array(shifts)[len(shifts) - len(after) :]
    assert (own * after).sum() / (after * after).sum() == pytest.approx(size, rel=0.06 if "noise" in given else 0.03)
    assert np.linalg.norm(np.array(shifts)[..., :3], axis=2).max() <= 2.0 * MOST_MOTION


@pytest.mark.parametrize("stiffer", [1.0, 2.5])
def test_forces_that_grow_by_themselves_disturb_a_check(stiffer: float) -> None:
    """From 20 N on that the servos push more than at the start, beside the presses; as told before the first press."""
    for rate in (10.0, 25.0):
        start, seen = Start(stiffer=stiffer, grows=[0.0, 0.6 * rate, 0.8 * rate, 0.0, 0.0, 0.0]), 0.0
        for _ in range(round(3.0 / DT)):
            start.go()
            if start.check.disturbed:
                seen = start.time - DT  # of what is heard
                break
        ready = 20.0 / rate / stiffer if stiffer == 1.0 or 20.0 / rate > 0.72 else 20.0 / rate
        assert seen == pytest.approx(max(ready, 0.0) if stiffer == 1.0 else max(ready, 0.72 - DT), abs=3.5 * DT)
    assert not Start().check.disturbed


# -- in the controller -----------------------------------------------------------------------------------------------


def started(
    *, gains: Any = 1.0, late: int = 1, grows: float = 0.0, stiffer: float = 1.0
) -> tuple[ForceController, list[ControlStep]]:
    """A controller whose arms press at rest on servos in closed form, until they relax or stop; its steps."""
    held = HoldPath(LIFT.path.pose(0.0), duration=100.0)
    options = {"supervision": {"slow_from": None}}
    inner = QPController(LIFT.cell, LIFT.grasp, held, dt=DT, options=options)
    made = ForceController(inner, {"stiffness": STIFF, "delay": 0.02, "relax_time": 0.12})
    made.reset(LIFT.q_start)
    G, q, told, steps = of_grip(SOFT / stiffer), LIFT.q_start, list[Array](), list[ControlStep]()
    size = np.broadcast_to(np.asarray(gains, dtype=float), 3)[:, None]
    for i in range(280):
        moved = (q - LIFT.q_start).reshape(3, 6)
        at = np.einsum("kij,kj->ki", TWISTS, moved) + STRESS
        at[1, 1] += grows * i * DT
        pushed = np.einsum("kij,kj->ki", TO_TOOLS, (G @ at.ravel()).reshape(3, 6))
        bent = np.concatenate([J.T @ w / (STIFF * stiffer) for J, w in zip(JACOBIANS, pushed, strict=True)])
        told.append(size * pushed)
        steps.append(made.step(q - bent, wrenches=told[max(i - late, 0)]))
        q = steps[-1].q_next
        if made.sensors is not None and len(steps) > 230:
            break
    return made, steps


def test_a_controller_takes_what_the_presses_find() -> None:
    """The stiffness of all servos; then the arms relax from where they were, and the object begins to move."""
    made, steps = started(stiffer=1.8)
    assert made.sensors is not None
    assert made.sensors.fine, made.sensors.explain()
    assert made.stiffer == pytest.approx(1.8, rel=0.03)
    assert made.stiffer == made.sensors.stiffer
    assert any("relax before the object moves" in step.reason for step in steps)
    assert not any("more slowly" in step.reason or step.status is Status.HOLDING for step in steps)


def test_a_controller_says_what_is_wrong_with_a_sensor_and_holds_the_object() -> None:
    made, steps = started(gains=(1.0, -1.0, 1.0))
    assert made.sensors is not None
    assert [finding.fine for finding in made.sensors.findings] == [True, False, True]
    assert steps[-1].status is Status.HOLDING
    assert steps[-1].cause is Cause.SENSOR
    assert made.sensors.explain() in steps[-1].reason
    assert "the sensor of arm slave_1: its forces and torques have the wrong sign" in steps[-1].reason


@pytest.mark.parametrize(("late", "slower"), [(4, True), (9, False)])
def test_a_controller_relaxes_more_slowly_for_late_wrenches_up_to_a_limit(late: int, slower: bool) -> None:
    """80 ms late, they are relaxed slowly; 180 ms late, the object is held."""
    made, steps = started(late=late)
    assert made.sensors is not None
    assert made.sensors.latest == pytest.approx(late * DT, abs=2e-3)
    told = [step.reason for step in steps if "forces relax more slowly" in step.reason]
    assert bool(told) == slower
    assert (steps[-1].status is Status.HOLDING) != slower
    assert "its wrenches come" in (told[-1] if told else steps[-1].reason)


def test_where_forces_grow_by_themselves_a_controller_compares_sensors_at_rest() -> None:
    """Without a judgement; the reasons say so one after another."""
    made, steps = started(grows=2e-3)
    assert made.sensors is None
    words = [step.reason.partition(":")[0] for step in steps]
    pressed = words.index(next(text for text in words if text.startswith("the arms press")))
    assert "the sensors are compared with the servos" in words[pressed:]
