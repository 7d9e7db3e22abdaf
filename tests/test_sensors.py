"""Wrist sensors by presses: what is wrong with a sensor is found, whatever it is; and the command that does it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import InvalidInputError, load_cell_file
from coopqp.cli.main import main
from coopqp.errors import UnknownNameError
from coopqp.files import example_path
from coopqp.forces import WristSensor
from coopqp.forces.presses import PressPlan, balanced
from coopqp.forces.sensor_findings import judge
from coopqp.forces.sensor_fit import SensorFit
from coopqp.forces.wrist_sensor import SensorMaps
from coopqp.scenarios import paper_lift
from coopqp.spatial import Array

LIFT = paper_lift()
DT, NOISE, LATE = 0.005, 1.0, 0.01


def pressed() -> tuple[Array, Array]:
    """Times (T,) and wrenches of the presses at the tools (T, 3, 6), of arms whose compliances are the same."""
    soft = np.tile(np.diag([1e-5] * 3 + [1e-4] * 3), (3, 1, 1))
    plan = PressPlan(LIFT.grasp, soft)
    times = np.arange(0.0, plan.duration, DT)
    shifts = np.array([plan.shift(t, 1.0) for t in times])
    objects = np.linalg.solve(soft, shifts[..., None])[..., 0]
    return times, np.array([[X.action.T @ w for X, w in zip(LIFT.grasp.T_object_tool, row, strict=True)]
                            for row in objects])  # fmt: skip


def found(sensors: dict[str, WristSensor], seed: int) -> Any:
    """What is said about sensors that read otherwise, with noise."""
    times, wrenches = pressed()
    rng, maps = np.random.default_rng(seed), SensorMaps(LIFT.cell, sensors)
    late = round(LATE / DT)
    heard = wrenches[np.maximum(np.arange(len(times)) - late, 0)]
    readings = np.array([maps.readings(w) for w in heard])
    readings += NOISE * np.array([1.0] * 3 + [0.1] * 3) * rng.normal(size=readings.shape)
    fit = SensorFit(times, readings, wrenches)
    while not fit.go_on():
        pass
    still = np.zeros((3, 6))
    return judge(
        fit, LIFT.grasp, LIFT.cell.arm_names, servos=still, servo_slopes=still, weight=None, unbalanced=1.0,
        tolerance=10.0, latest=0.028,
    )  # fmt: skip


def turned(degrees: float) -> Array:
    return np.asarray(pin.exp3(np.deg2rad(degrees) * np.array([0.0, 1.0, 0.0])))


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
    assert judgement.findings[0].fine
    assert judgement.findings[2].fine


def test_swapped_sensors_are_found_and_right_ones_are_right() -> None:
    swap = {"slave_1": WristSensor(reads="slave_2"), "slave_2": WristSensor(reads="slave_1")}
    assert [f.sits_at for f in found(swap, 2).findings] == ["master", "slave_2", "slave_1"]
    right = found({}, 3)
    assert right.fine, right.explain()
    assert [f.delay for f in right.findings] == pytest.approx([LATE] * 3, abs=0.004)
    assert right.explain() == "all sensors are right"


def test_presses_cancel_within_the_object() -> None:
    w = balanced(LIFT.grasp, 1, np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]))
    np.testing.assert_allclose(w.sum(axis=0), 0.0, atol=1e-9)


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
    text = (Path(__file__).parents[1] / "docs" / "examples" / "cells" / "lift_in_engine.toml").read_text()
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
