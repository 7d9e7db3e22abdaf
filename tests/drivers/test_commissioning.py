"""Wrist sensors commissioned through drivers: robots in the physics engine, which feel each other through the plate."""

from __future__ import annotations

import numpy as np
import pytest
from places import CELL_FILES

from coopqp import load_cell_file
from coopqp.cli.main import main
from coopqp.drivers import DriverError, ManualTime, SimulatedRobot, commission_sensors_by_drivers

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]
WRONG = "\n[disturbances.sensors.slave_1]\naxes = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]\nforce_gain = 2.0\n"


@pytest.fixture
def file(tmp_path):
    pytest.importorskip("mujoco")
    text = (CELL_FILES / "lift_in_engine.toml").read_text()
    limits = 'robot = "rx90l"\nlimits = { acceleration_deg_per_s2 = 600 }'
    found = tmp_path / "lift.toml"
    found.write_text(text.replace('robot = "rx90l"', limits) + WRONG)
    return found


def test_robots_without_wrenches_are_refused(file):
    run, time = load_cell_file(file), ManualTime()
    s = run.scenario
    x = s.cell.positions(s.q_start)
    robots = {
        name: SimulatedRobot([joint.partition("/")[2] for joint in s.cell.joint_names[own]], x[own], time=time)
        for name, own in zip(s.cell.arm_names, s.cell.v_slices, strict=True)
    }
    with pytest.raises(DriverError, match="tells no wrench"):
        commission_sensors_by_drivers(s, robots, stiffness=run.stiffness, time=time)


def test_the_command_asks_for_the_cells_name(file, capsys):
    for given, words in ((["--driver", "engine"], "go together"), (["--enable", "x"], "go together"),
                         (["--driver", "engine", "--enable", "x"], "'lift_in_engine'")):  # fmt: skip
        assert main(["sensors", str(file), *given]) == 2
        assert words in capsys.readouterr().err


def test_the_command_finds_a_wrong_sensor_through_drivers(file, capsys, monkeypatch):
    """In its own time: the engine's robots take the loop's."""
    from coopqp.drivers import commissioning

    time = ManualTime()
    monkeypatch.setattr("coopqp.files.cellfile.build.MonotonicTime", lambda: time)
    press = commissioning.commission_sensors_by_drivers
    monkeypatch.setattr(
        commissioning, "commission_sensors_by_drivers", lambda *given, **more: press(*given, time=time, **more)
    )
    out = file.with_name("out.toml")
    assert main(["sensors", str(file), "--driver", "engine", "--enable", "lift_in_engine", "--out", str(out)]) == 4
    said = capsys.readouterr().out
    assert all(name in said for name in ("master", "slave_1", "slave_2"))
    found = load_cell_file(out).sensors
    assert found["slave_1"].force_gain == pytest.approx(2.0, rel=0.05)
    np.testing.assert_allclose(found["slave_1"].rotation, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=0.1)
    for name in ("master", "slave_2"):
        assert found[name].force_gain == 1.0
        np.testing.assert_array_equal(found[name].rotation, np.eye(3))
