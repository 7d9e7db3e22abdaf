"""A kinematic plant with disturbances, each against its closed form: lags, stalls, late commands, bases off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import cart

from coopqp import ControlStep, Grasp, HoldPath, InvalidInputError, RobotCell, Status
from coopqp.errors import UnknownNameError
from coopqp.simulation import Disturbances, DisturbedPlant, KinematicPlant, misplaced
from coopqp.spatial import Array

DT = 0.01


def at(*p: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(p))


CELL = RobotCell([cart("a"), cart("b", T_world_base=at(0.0, 1.0, 0.0))])
GRASP = Grasp((at(0.0, -0.5, 0.0), at(0.0, 0.5, 0.0)))
#: Positions of the joints that are commanded one after the other: two rails, two tables that turn beyond π.
X = np.cumsum(np.tile([0.02, 0.09, 0.01, -0.07], (60, 1)) * np.linspace(0.2, 1.0, 60)[:, None], axis=0)


def commands(xs: Sequence[Any] | Array = X) -> list[ControlStep]:
    """Steps to positions of the joints (T, 4)."""
    q, out = CELL.configuration(np.zeros(4)), []
    for x in xs:
        q_next = CELL.configuration(x)
        out.append(ControlStep(
            cell=CELL, grasp=GRASP, path=HoldPath(pin.SE3.Identity()), q=q, q_next=q_next, dt=DT, clock=0.0,
            velocity=pin.difference(CELL.model, q, q_next) / DT, clock_next=0.0, rate=1.0, status=Status.TRACKING,
        ))  # fmt: skip
        q = q_next
    return out


def followed(disturbances: Any = None, **more: Any) -> Array:
    """Real positions of the joints after each command (T, 4)."""
    plant = DisturbedPlant(CELL, GRASP, disturbances, **more)
    plant.reset(CELL.configuration(np.zeros(4)))
    out = []
    for step in commands():
        measured = plant.apply(step)
        np.testing.assert_array_equal(measured, plant.q)
        out.append(CELL.positions(plant.q))
    assert plant.time == pytest.approx(DT * len(X))
    return np.unwrap(np.array(out), axis=0)


def test_without_disturbances_the_joints_follow_exactly() -> None:
    np.testing.assert_allclose(followed(), X, atol=1e-12)
    plain = KinematicPlant(CELL)
    for step in commands():
        np.testing.assert_array_equal(plain.apply(step), step.q_next)


def test_an_arm_that_lags_solves_its_equation() -> None:
    """τ ẋ = target − x with a target that runs straight from command to command, solved in 100 small steps each."""
    tau, x, expected = 0.03, np.zeros(2), []
    before = np.zeros(2)
    for after in X[:, 2:]:
        for s in (np.arange(100) + 0.5) / 100:
            target = before + s * (after - before)
            x = target + (x - target) * np.exp(-DT / 100 / tau)
        before = after
        expected.append(x)
    found = followed({"lag": {"b": tau}})
    np.testing.assert_allclose(found[:, 2:], expected, atol=1e-6)
    np.testing.assert_allclose(found[:, :2], X[:, :2], atol=1e-12)
    np.testing.assert_allclose(followed({"lag": {"a": 0.0}}), X, atol=1e-12)


def test_an_arm_that_stalls_stays_from_then_on() -> None:
    found = followed({"stall": {"a": 0.2}})
    np.testing.assert_allclose(found[:20], X[:20], atol=1e-12)
    np.testing.assert_allclose(found[20:, :2], np.tile(X[19, :2], (40, 1)), atol=1e-9)
    np.testing.assert_allclose(found[:, 2:], X[:, 2:], atol=1e-12)
    lags_too = followed({"stall": {"a": 0.2}, "lag": {"b": 0.03}})
    np.testing.assert_allclose(lags_too[:, 2:], followed({"lag": {"b": 0.03}})[:, 2:], atol=1e-12)
    np.testing.assert_allclose(lags_too[:, :2], found[:, :2], atol=1e-12)


@pytest.mark.parametrize("late", [0.0, 0.004, 0.01, 0.035, 0.31])
def test_commands_arrive_as_late_as_told(late: float) -> None:
    """In between two commands the drive is between their places."""
    found = followed(command_latency={"b": late})
    time = DT * np.arange(61.0)
    known = np.vstack([np.zeros(4), X])
    expected = np.array([np.interp(time[1:] - late, time, column) for column in known.T]).T
    np.testing.assert_allclose(found[:, 2:], expected[:, 2:], atol=1e-9)
    np.testing.assert_allclose(found[:, :2], X[:, :2], atol=1e-12)


def test_a_base_that_is_off_parts_the_arms_as_they_turn() -> None:
    """The grip closes at the real tools: at first nothing is apart. A base that is turned by 0.1 rad drifts away."""
    off = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.1])), np.array([0.02, 0.0, 0.03]))
    plant = DisturbedPlant(CELL, GRASP, {"base_offset": {"b": off}})
    plant.reset(CELL.configuration(np.zeros(4)))
    np.testing.assert_allclose(plant.true_tools()[0].homogeneous, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(plant.true_tools()[1].homogeneous, (at(0.0, 1.0, 0.0) * off).homogeneous, atol=1e-15)
    np.testing.assert_allclose(plant.chain_error(), (0.0, 0.0), atol=1e-12)
    for step in commands([[0.2, 0.0, 0.2, 0.0]]):
        plant.apply(step)
    apart, angle = plant.chain_error()
    assert apart == pytest.approx(2.0 * 0.2 * np.sin(0.05))
    assert angle == pytest.approx(0.0, abs=1e-12)
    for step in commands([[0.0, 0.3, 0.0, 0.1]]):
        plant.apply(step)
    assert plant.chain_error()[1] == pytest.approx(0.2)


def test_a_reset_starts_anew() -> None:
    plant = DisturbedPlant(CELL, GRASP, {"lag": {"a": 0.1}, "stall": {"b": 0.0}}, command_latency={"a": 0.05})
    start = CELL.configuration([0.1, 0.2, 0.3, 0.4])
    for _ in range(2):
        np.testing.assert_array_equal(plant.reset(start), start)
        assert plant.time == 0.0
        for step in commands([[0.1, 0.2, 0.9, 0.4]] * 3):
            plant.apply(step)
        np.testing.assert_allclose(plant.q, start, atol=1e-9)
    assert DisturbedPlant.gripped is False


def test_measuring_again_at_rest_has_other_noise_and_moves_nothing() -> None:
    plant = DisturbedPlant(CELL, GRASP, {"encoder_noise": 1e-3, "dt_jitter": 0.1, "seed": 2})
    start = CELL.configuration([0.1, 0.2, 0.3, 0.4])
    first = plant.reset(start)
    more = [plant.measure() for _ in range(200)]
    assert not np.allclose(more[0], first, atol=1e-6)
    np.testing.assert_allclose(CELL.positions(CELL.average(more)), [0.1, 0.2, 0.3, 0.4], atol=2e-4)
    assert (plant.time, plant.q.tolist()) == (0.0, start.tolist())
    np.testing.assert_array_equal(plant.reset(start), first)
    assert {round(plant.period(1.0), 12) for _ in range(5)}.isdisjoint({1.0})
    assert DisturbedPlant(CELL, GRASP).period(0.3) == 0.3


def test_arms_and_values_that_are_wrong_are_named() -> None:
    for name in ("lag", "stall"):
        with pytest.raises(UnknownNameError, match="nobody"):
            DisturbedPlant(CELL, GRASP, {name: {"nobody": 0.1}})
    with pytest.raises(UnknownNameError, match="nobody"):
        DisturbedPlant(CELL, GRASP, command_latency={"nobody": 0.1})
    with pytest.raises(InvalidInputError, match=r"command_latency\['a'\]"):
        DisturbedPlant(CELL, GRASP, command_latency={"a": -0.1})
    for bad, said in (
        ({"encoder_noise": -1.0}, "encoder_noise"),
        ({"latency": -1.0}, "latency"),
        ({"growth_period": 0.0}, "growth_period"),
        ({"object_growth": 0.6}, "object_growth"),
        ({"object_growth": -0.5}, "object_growth"),
        ({"wrench_noise": -1.0}, "wrench_noise"),
        ({"wrench_bias": -1.0}, "wrench_bias"),
        ({"wrench_latency": np.nan}, "wrench_latency"),
        ({"drop_share": 1.0}, "drop_share"),
        ({"dt_jitter": 1.0}, "dt_jitter"),
        ({"wrench_drop_share": -0.1}, "wrench_drop_share"),
        ({"seed": -1}, "seed"),
        ({"lag": {"a": -1.0}}, r"lag\['a'\]"),
        ({"stall": {"a": "soon"}}, r"stall\['a'\]"),
        ({"wrench_gain": {"a": np.inf}}, r"wrench_gain\['a'\]"),
        ({"sensors": {"a": 3}}, r"sensors\['a'\]"),
        ({"base_offset": {"a": np.ones((4, 4))}}, r"base_offset\['a'\]"),
    ):
        with pytest.raises(InvalidInputError, match=said):
            Disturbances(**bad)
    edges = Disturbances(object_growth=0.5, drop_share=0.99, wrench_gain={"a": -2.0}, lag={"a": 0.0}, latency=0.0)
    assert edges.object_growth == 0.5


def test_a_misplaced_grasp_is_off_in_the_tool_s_frame() -> None:
    turned = pin.SE3(pin.exp3(np.array([0.3, 0.0, 0.0])), np.array([0.0, 0.5, 0.0]))
    grasp, off = Grasp((GRASP.T_object_tool[0], turned)), at(0.0, 0.01, 0.0)
    found = misplaced(CELL, grasp, {"b": off})
    assert found.T_object_tool[0] == grasp.T_object_tool[0]
    np.testing.assert_allclose(found.T_object_tool[1].homogeneous, (turned * off).homogeneous)
    with pytest.raises(UnknownNameError, match="nobody"):
        misplaced(CELL, grasp, {"nobody": off})
