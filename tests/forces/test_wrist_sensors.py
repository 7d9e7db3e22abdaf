"""Wrist sensors by presses: what is wrong with a sensor is found, whatever it is; and the command that does it."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first
from places import CELL_FILES

from coopqp import InvalidInputError, load_cell_file
from coopqp.cli.main import main
from coopqp.errors import UnknownNameError
from coopqp.files import example_path
from coopqp.forces import WristSensor
from coopqp.forces.presses import MOST_MOTION, MOST_TORQUE, PRESS_FORCE, PressPlan, balancing, of_grip
from coopqp.forces.sensor_findings import SensorJudgement, judge
from coopqp.forces.sensor_fit import SensorFit, cheapest
from coopqp.forces.wrist_sensor import SensorMaps
from coopqp.scenarios import Scenario, paper_lift, ring
from coopqp.spatial import Array

LIFT = paper_lift()
DT, NOISE, LATE = 0.005, 1.0, 0.01


TO_TOOLS = np.array([X.action.T for X in LIFT.grasp.T_object_tool])


def pressed(stiffer: tuple[float, ...] = (1.0, 1.0, 1.0)) -> tuple[Array, Array, Array, Array]:
    """Times (T,), motions (T, 3, 6), wrenches at the tools (T, 3, 6), and the compliance of an arm that is told."""
    rng = np.random.default_rng(5)
    ways = np.linalg.qr(rng.normal(size=(3, 6, 6)))[0]
    soft = ways @ np.diag([1e-5, 2e-5, 5e-6, 1e-5, 5e-5, 2e-5]) @ ways.swapaxes(1, 2)
    plan = PressPlan(LIFT.grasp, soft)
    times = np.arange(0.0, plan.duration, DT)
    motions = np.array([plan.shift(t, 1.0) for t in times])
    objects = motions.reshape(len(times), -1) @ of_grip(soft / np.array(stiffer)[:, None, None]).T
    return times, motions, np.einsum("kij,tkj->tki", TO_TOOLS, objects.reshape(motions.shape)), soft


def fitted(
    sensors: dict[str, WristSensor], seed: int, stiffer: tuple[float, ...] = (1.0, 1.0, 1.0), lead: float = 0.0
) -> SensorFit:
    """What is found of sensors that read otherwise, with noise, where arms are stiffer than told, and damped."""
    times, motions, wrenches, soft = pressed(stiffer)
    wrenches = wrenches + lead * np.gradient(wrenches, times, axis=0)
    rng, maps = np.random.default_rng(seed), SensorMaps(LIFT.cell, sensors)
    late = round(LATE / DT)
    heard = wrenches[np.maximum(np.arange(len(times)) - late, 0)]
    readings = np.array([maps.readings(w) for w in heard])
    readings += NOISE * np.array([1.0] * 3 + [0.1] * 3) * rng.normal(size=readings.shape)
    fit = SensorFit(times, readings, motions, soft, TO_TOOLS)
    while not fit.go_on():
        pass
    return fit


def found(sensors: dict[str, WristSensor], seed: int, stiffer: tuple[float, ...] = (1.0, 1.0, 1.0)) -> SensorJudgement:
    """What is said about them."""
    still = np.zeros((3, 6))
    return judge(
        fitted(sensors, seed, stiffer), LIFT.grasp, LIFT.cell.arm_names, servos=still, servo_slopes=still, weight=None,
        unbalanced=1.0, tolerance=10.0, latest=0.028,
    )  # fmt: skip


def turned(degrees: float) -> Array:
    return np.asarray(pin.exp3(np.deg2rad(degrees) * np.array([0.0, 1.0, 0.0])))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        ({"force_gain": -1.0, "torque_gain": -1.0}, "wrong sign"),
        ({"torque_gain": -1.0}, "its torques have the wrong sign"),
        ({"torque_gain": 0.0}, "its torques are dead"),
        ({"torque_gain": 1000.0}, "N·mm"),
        ({"rotation": turned(30.0)}, "turned by"),
        ({"force_gain": 0.5, "torque_gain": 0.5}, "times the real ones"),
    ],
)
def test_what_is_wrong_with_a_sensor_is_found(sensor: dict[str, Any], said: str) -> None:
    judgement = found({"slave_1": WristSensor(**sensor)}, 1)
    assert not judgement.fine
    assert said in judgement.findings[1].explain()
    assert [f.fine for f in judgement.findings] == [True, False, True], judgement.explain()


@pytest.mark.slow
def test_what_noise_leaves_of_dead_torques_is_no_torque() -> None:
    """A gain of 1e-4 made 1 N·m of noise a load of 10 kN·m, and the other sensors read 94 N too much."""
    for gain in (1e-4, 1e-2):
        judgement = found({"slave_1": WristSensor(torque_gain=gain)}, 1)
        assert [f.fine for f in judgement.findings] == [True, False, True], judgement.explain()
        assert "its torques are dead" in judgement.explain()


@pytest.mark.slow
def test_swapped_sensors_are_found_and_right_ones_are_right() -> None:
    swap = {"slave_1": WristSensor(reads="slave_2"), "slave_2": WristSensor(reads="slave_1")}
    assert [f.sits_at for f in found(swap, 2).findings] == ["master", "slave_2", "slave_1"]
    right = found({}, 3)
    assert right.fine, right.explain()
    assert [f.delay for f in right.findings] == pytest.approx([LATE] * 3, abs=0.004)
    assert right.explain() == "all sensors are right"


@pytest.mark.slow
@pytest.mark.parametrize("lead", [0.0, 0.032, 0.3])
def test_damping_makes_no_arm_stiffer(lead: float) -> None:
    """Servos of a tenth of their stiffness, with damping for all of it, lead by 0.3 s: they had been 27 % stiffer."""
    fit = fitted({}, 6, lead=lead)
    assert fit.gains == pytest.approx(np.ones((3, 2)), abs=0.1)
    assert fit.delays == pytest.approx([LATE] * 3, abs=0.01)
    assert fit.lead == pytest.approx(lead, abs=0.1 * lead + 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("arm", range(3))
@pytest.mark.parametrize("factor", slow_but_first([0.3, 3.0]))
def test_an_arm_that_is_softer_than_told_is_no_wrong_sensor(arm: int, factor: float) -> None:
    """It was: "its torques are 0.41 times the real ones"."""
    stiffer = tuple(factor if k == arm else 1.0 for k in range(3))
    right = found({}, 4, stiffer)
    assert right.fine, right.explain()
    relative = fitted({}, 4, stiffer).stiffer
    assert relative[arm] / np.median(relative) == pytest.approx(factor, rel=0.15)
    wrong = found({LIFT.cell.arm_names[arm]: WristSensor(torque_gain=0.4)}, 4, stiffer)
    assert "its torques are 0." in wrong.findings[arm].explain()
    assert sum(not finding.fine for finding in wrong.findings) == 1


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_cheapest_permutation(n: int) -> None:
    costs = np.random.default_rng(n).normal(size=(n, n))
    orders = list(itertools.permutations(range(n)))
    sums = [sum(costs[k, a] for k, a in enumerate(order)) for order in orders]
    assert tuple(cheapest(costs)) == orders[int(np.argmin(sums))]


@pytest.mark.parametrize("task", [LIFT, ring(arms=2), ring(arms=5)], ids=lambda task: task.name)
def test_presses_cancel_within_the_object_and_are_small(task: Scenario) -> None:
    to_object = np.array([X.actionInverse.T for X in task.grasp.T_object_tool])
    w = (balancing(task.grasp, 1) @ np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])).reshape(-1, 6)
    np.testing.assert_allclose(np.einsum("kij,kj->i", to_object, w), 0.0, atol=1e-9)
    soft = np.tile(np.diag([1e-5] * 3 + [1e-4] * 3), (len(task.grasp), 1, 1))
    plan = PressPlan(task.grasp, soft)
    presses = np.einsum("kij,tkj->tki", np.linalg.inv(soft @ to_object), plan.ways)
    sizes = np.linalg.norm(presses.reshape(len(presses), -1, 2, 3), axis=3).max(axis=1)
    far = np.linalg.norm(plan.ways[:, :, :3], axis=2).max(axis=1)
    shares = np.array([sizes[:, 0] / PRESS_FORCE, sizes[:, 1] / MOST_TORQUE, far / MOST_MOTION])
    np.testing.assert_allclose(shares[:, 1:].max(axis=0), 1.0)
    assert shares[:, 0].max() < 0.3


def test_known_sensors_are_corrected_and_bad_ones_refused() -> None:
    sensors = {
        "slave_1": WristSensor(reads="slave_2", rotation=turned(90.0), force_gain=-2.0, bias=np.arange(6.0)),
        "slave_2": WristSensor(reads="slave_1", torque_gain=1000.0),
    }
    maps, w = SensorMaps(LIFT.cell, sensors), np.random.default_rng(0).normal(size=(3, 6))
    np.testing.assert_allclose(maps.wrenches(maps.readings(w)), w, atol=1e-12)
    with pytest.raises(InvalidInputError, match="two sensors read the same arm"):
        SensorMaps(LIFT.cell, {"slave_1": WristSensor(reads="slave_2")})
    with pytest.raises(UnknownNameError):
        SensorMaps(LIFT.cell, {"slave_9": WristSensor()})
    with pytest.raises(InvalidInputError, match="is dead"):
        SensorMaps(LIFT.cell, {"slave_1": WristSensor(force_gain=0.0)}).check()
    with pytest.raises(InvalidInputError, match="rotation"):
        WristSensor(rotation=2.0 * np.eye(3))


# -- the command -------------------------------------------------------------------------------------------------------

REAL = """
[disturbances]
wrench_noise_n = 1.0

[disturbances.sensors.slave_1]
reads = "slave_2"

[disturbances.sensors.slave_2]
reads = "slave_1"
force_gain = -1.0
bias_force_n = [0.0, 0.0, 20.0]
"""


@pytest.mark.slow
def test_the_command_writes_what_it_finds_and_is_then_content(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    text = (CELL_FILES / "lift_in_engine.toml").read_text()
    file, out, figures = tmp_path / "cell.toml", tmp_path / "better.toml", tmp_path / "figures.json"
    file.write_text(text + REAL)
    assert main(["sensors", str(file), "--out", str(out), "--json", str(figures)]) == 4
    assert "it reads the wrenches of arm slave_2" in capsys.readouterr().out
    assert [row["reads"] for row in json.loads(figures.read_text())["sensors"]] == ["master", "slave_2", "slave_1"]
    assert load_cell_file(out).sensors["slave_2"].reads == "slave_1"
    assert main(["sensors", str(out)]) == 0
    assert "right" in capsys.readouterr().out
    assert main(["sensors", str(file), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


def test_the_command_refuses_with_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sensors", str(tmp_path / "gone.toml")]) == 2
    assert "gone.toml" in capsys.readouterr().err
    assert main(["sensors", str(example_path("paper_lift")), "--out", str(tmp_path / "out.yaml")]) == 2
    assert ".toml" in capsys.readouterr().err
