"""What coopqp writes as a cell file: any tables read back the same, and paths lead to the same files from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import CELL_FILES

from coopqp import TimedPath, load_cell_file
from coopqp.files import CellFileError
from coopqp.files.cellfile.build import CellRun
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.sensors import (
    DisturbancesTable,
    SensorTable,
    build_disturbances,
    build_sensor,
    sensor_table,
)
from coopqp.files.cellfile.text import read_tables
from coopqp.files.cellfile.write import file_text, settings_of, timed_text
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.scenarios import robot_path

RICH: dict[str, Any] = {
    "path": {"kind": "timed", "s_m": [0.1 * k for k in range(60)], "pieces": [[1.0, -0.0], [1e-300, 1e22]]},
    "name": 'a "b" \\ é\t',
    "yes": True,
    "no": False,
    "whole": 3,
    "float": 0.1 + 0.2,
    "none": [],
    "phases": [
        {"name": "p", "arms": {"left arm": {"kind": "waits"}, "right.arm": {"kind": "holds"}}},
        {"name": "q", "arms": {}, "path": {"binding": [{"from_s": 0.0}, {"from_s": 1.0}]}},
    ],
    "signals_s": {"slave 2 closed": 1.0},
    "names": [f"name {k}" for k in range(40)],
}


def test_tables_read_back_the_same_with_the_long_ones_last(tmp_path: Path) -> None:
    text = file_text(["a head", "of two lines"], RICH)
    assert text.startswith("# a head\n# of two lines\n")
    file = tmp_path / "cell.toml"
    file.write_text(text, encoding="utf-8")
    read = read_tables(file)
    assert read == RICH
    assert type(read["whole"]) is int
    assert str(read["path"]["pieces"][0][1]) == "-0.0"
    assert text.index("[signals_s]") < text.index("[path]") < text.index("[[phases]]")
    lines = text.splitlines()
    assert max(map(len, lines)) <= 120
    assert sum(line.startswith("  0.") for line in lines) < 10  # numbers share lines


TIMED = TimedPath.of_record(
    {
        "pieces": [[0, 1, 0, -1, 0, 0, 0, 0, 1, 0.9, 0, 0.1, 0, 0, 0, 0, 0, 0.05, 1.0]],
        "s": [0.0, 0.5, 1.0],
        "squares": [0.0, 1.0, 0.0],
        "planned_share": 0.9,
        "keeps_clear": False,
        "binding": [{"from_s": 0.5, "to_s": 1.5, "arm": "master", "joint": "joint_2", "limit": "velocity"}],
    }
)


def test_a_file_with_a_timed_path_reads_back_to_the_same_numbers_from_another_folder(tmp_path: Path) -> None:
    """Also its models, and the folders of its packages."""
    models, into = tmp_path / "given" / "models", tmp_path / "far" / "away"
    models.mkdir(parents=True)
    into.mkdir(parents=True)
    (models / "mine.urdf").write_bytes(robot_path("rx90l").read_bytes())
    text = (CELL_FILES / "paper_lift.toml").read_text(encoding="utf-8")
    own = 'urdf = "models/mine.urdf"\ntool_frame = "flange"\npackage_dirs = ["models"]\ngeometry = false'
    file = tmp_path / "given" / "cell.toml"
    file.write_text(text.replace('robot = "rx90l"', own, 1), encoding="utf-8")
    given = load_cell_file(file)
    for dt in (None, 0.004):
        s = given.scenario
        out = into / "cell.toml"
        out.write_text(
            timed_text(given.settings, s.cell, s.q_start, TIMED, "one line", folder=file.parent, into=into, dt=dt),
            encoding="utf-8",
        )
        again = load_cell_file(out)
        assert out.read_text(encoding="utf-8").startswith("# one line\n")
        arm = again.settings.arms[0]
        assert (into / str(arm.urdf)).resolve() == (models / "mine.urdf").resolve()
        assert not Path(str(arm.urdf)).is_absolute()
        assert [(into / d).resolve() for d in arm.package_dirs] == [models.resolve()]
        np.testing.assert_array_equal(again.scenario.q_start, s.q_start)
        assert isinstance(again.scenario.path, TimedPath)
        assert again.scenario.path.record() == TIMED.record()
        assert again.scenario.path.planned_share == 0.9
        assert not again.settings.start.inverse_kinematics
        assert again.scenario.dt == (dt or 0.002)
        assert again.settings.steps is None


def test_the_settings_of_a_run_are_those_of_its_file_or_of_the_file_that_is_given(tmp_path: Path) -> None:
    tables = read_tables(CELL_FILES / "paper_lift.toml")
    found, folder = settings_of({"settings": tables}, None)
    assert found == CellFile.model_validate(tables)
    assert folder is None
    found, folder = settings_of({}, CELL_FILES / "bar.toml")
    assert (found.name, folder) == (load_bar().settings.name, CELL_FILES)
    with pytest.raises(CellFileError, match=r"not one of a cell file.*--cell"):
        settings_of({}, None)
    with pytest.raises(CellFileError, match=r"own cell file: grasp: is missing\. Give a corrected one with --cell\."):
        settings_of({"settings": {key: value for key, value in tables.items() if key != "grasp"}}, None)


def load_bar() -> CellRun:
    return load_cell_file(CELL_FILES / "bar.toml")


TURNED = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
SENSORS = [
    WristSensor(),
    WristSensor(reads="b", rotation=TURNED, force_gain=-1.1, torque_gain=1e3, bias=[0.1, 2, 3, 4, 5, 6.7], delay=0.03),
]


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_wrist_sensor_reads_back_from_its_table(sensor: WristSensor) -> None:
    table = sensor_table(sensor)
    again = build_sensor(SensorTable.model_validate(table))
    assert ("reads" in table, "axes" in table) == (sensor.reads is not None, sensor.reads is not None)
    assert (again.reads, again.force_gain, again.torque_gain, again.delay) == (
        sensor.reads, sensor.force_gain, sensor.torque_gain, sensor.delay,
    )  # fmt: skip
    np.testing.assert_array_equal(again.rotation, sensor.rotation)
    np.testing.assert_array_equal(again.bias, sensor.bias)


def test_disturbances_of_a_file_are_those_of_the_plant() -> None:
    quiet = build_disturbances(DisturbancesTable())
    assert (quiet.wrench_noise, quiet.wrench_drop_share, dict(quiet.sensors), quiet.seed) == (0.0, 0.0, {}, 0)
    tables = {"a": sensor_table(SENSORS[1])}
    loud = build_disturbances(
        DisturbancesTable.model_validate(
            {"wrench_noise_n": 2.0, "wrench_drop_share": 0.1, "sensors": tables, "seed": 5}
        )
    )
    assert (loud.wrench_noise, loud.wrench_drop_share, loud.seed) == (2.0, 0.1, 5)
    assert loud.sensors["a"].reads == "b"
    np.testing.assert_array_equal(loud.sensors["a"].bias, SENSORS[1].bias)
