"""``coopqp drive``: what it reads and refuses without --enable, and a run with it, on simulated robots."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from functools import partial

import pytest
from places import CELL_FILES

from coopqp import Recording, load_cell_file
from coopqp.cli.main import main
from coopqp.drivers import LoopOptions
from coopqp.files.cellfile import CellFileError

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]
TWO = CELL_FILES / "two_robots.toml"


@pytest.fixture
def quick(tmp_path):
    """The example, faster."""
    file = tmp_path / "two_robots.toml"
    file.write_text(TWO.read_text().replace("duration_s = 2.0", "duration_s = 0.8"))
    return file


def test_a_dry_run_says_what_it_reads_and_sends_nothing(quick, capsys, monkeypatch):
    from coopqp.cli import drive
    from coopqp.drivers import SimDriver

    sent = []
    monkeypatch.setattr(SimDriver, "send", lambda self, command: sent.append(command))
    monkeypatch.setattr(drive, "_READING", 0.2)
    assert main(["drive", str(quick), "--speed", "1"]) == 0
    said = capsys.readouterr().out
    assert not sent
    for words in ("left", "right", "from the start [mrad]", "in simulation, in real time: finished", "late p50"):
        assert words in said
    assert said.rstrip().endswith("nothing would be refused")


def test_a_dry_run_says_what_would_be_refused(quick, capsys, monkeypatch):
    from coopqp.cli import drive

    monkeypatch.setattr(drive, "_READING", 0.05)
    quick.write_text(quick.read_text().replace(", acceleration_deg_per_s2 = 600", ""))
    assert main(["drive", str(quick)]) == 3
    out, err = capsys.readouterr()
    assert "acceleration limits" in err
    assert "would be refused" in out
    assert main(["drive", str(quick), "--enable", "two_robots"]) == 3


def test_a_dry_run_that_does_not_finish_says_so_and_fails(quick, capsys, monkeypatch):
    from coopqp.cli import drive
    from coopqp.drivers.loop import ControlLoop

    monkeypatch.setattr(drive, "_READING", 0.05)
    monkeypatch.setattr(ControlLoop, "_drain", lambda loop: loop._end("out of reach", failed=True))
    assert main(["drive", str(quick), "--speed", "1"]) == 4
    out, err = capsys.readouterr()
    assert "in simulation the run did not finish: out of reach" in err
    assert out.rstrip().endswith("nothing would be refused, but the run would not finish")


@pytest.fixture
def patient(monkeypatch):
    """The machine of the tests may stall for longer than a robot may."""
    import coopqp.drivers.loop  # noqa: F401  # which keeps the class itself

    monkeypatch.setattr("coopqp.drivers.options.LoopOptions", partial(LoopOptions, gone_after=10.0))


@pytest.mark.usefixtures("patient")
def test_an_enabled_run_finishes_and_is_recorded(quick, capsys, tmp_path):
    file = tmp_path / "run.npz"
    given = ["drive", str(quick), "--enable", "two_robots", "--speed", "1", "--record", str(file)]
    assert main(given) == 0
    said = capsys.readouterr().out
    assert "the path takes" in said
    assert "finished after" in said
    assert Recording.load(file).metadata["plant"] == "robots"
    assert main(given) == 2  # the file is there


def test_bad_input_is_refused_before_anything_is_started(quick, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("coopqp.drivers.sim.SimDriver.connect", lambda self: pytest.fail("connected"))
    text = quick.read_text()
    for given, words in (
        (["--enable", "another"], "the cell's name is 'two_robots'"),
        (["--speed", "0"], "--speed"),
        (["--speed", "1.5"], "--speed"),
        (["--record", "x.npz"], "without --enable"),
        (["--enable", "two_robots", "--record", "x.mcap"], ".npz"),
        (["--enable", "two_robots", "--record", str(quick.parent)], "exists"),
    ):
        assert main(["drive", str(quick), *given]) == 2, given
        assert words in capsys.readouterr().err
    for change, words in (
        (("[drivers.right]", "[drivers.other]"), "no arm named 'other'"),
        (('kind = "sim"\nperiod = 0.004\nlag = 0.010', 'kind = "simm"'), "simm"),
        (("loss = 0.001", "loss = 1.0"), "two_robots.toml: drivers.right: SimOptions: loss"),
    ):
        assert change[0] in text
        quick.write_text(text.replace(*change))
        assert main(["drive", str(quick)]) == 2
        assert words in capsys.readouterr().err
    quick.write_text(text[: text.index("[drivers.right]")] + text[text.index("[grasp]") :])
    assert main(["drive", str(quick)]) == 2
    assert "arm 'right' has no driver" in capsys.readouterr().err


# -- a robot whose arms share a lift -----------------------------------------------------------------------------------


@pytest.fixture
def lift(tmp_path):
    """Two arms on a lift, faster; the file names no drivers."""
    text = (CELL_FILES / "torso_lift.toml").read_text()
    file = tmp_path / "torso_lift.toml"
    file.write_text(text.replace("duration_s = 8.0", "duration_s = 3.0"))
    return file


@pytest.mark.usefixtures("patient")
def test_a_robot_with_a_lift_is_driven_as_it_is_run(lift, capsys, tmp_path, monkeypatch):
    from coopqp.cli import drive

    monkeypatch.setattr(drive, "_READING", 0.05)
    assert main(["drive", str(lift)]) == 2
    assert "robot 'lift' (lift/lift, left, right) has no driver. Give a table [drivers.lift]" in capsys.readouterr().err
    lift.write_text(lift.read_text() + '\n[drivers.lift]\nkind = "sim"\nlag = 0.02\n')
    assert main(["drive", str(lift), "--speed", "1"]) == 0
    said = capsys.readouterr().out
    for words in ("from the start [mrad]", "from the start [mm]", "nothing would be refused", "lags lift 20 ms"):
        assert words in said
    file = tmp_path / "run.npz"
    assert main(["drive", str(lift), "--enable", "torso_lift", "--speed", "1", "--record", str(file)]) == 0
    run = Recording.load(file)
    # As `coopqp run`: without the check's motion of the lift it would stay at its place.
    assert run.q[-1, 0] - run.q[0, 0] > 0.15


def test_wrong_drivers_of_a_robot_are_refused_with_the_right_names(lift, capsys, monkeypatch):
    monkeypatch.setattr("coopqp.drivers.sim.SimDriver.connect", lambda self: pytest.fail("connected"))
    text, sim, ur = lift.read_text(), 'kind = "sim"\n', 'kind = "ur"\naddress = "192.0.2.1"\n'
    for tables, words in (
        ({"lft": sim}, "drivers: no robot or arm named 'lft'; robots: lift; arms: left, right."),
        ({"left": sim}, "robot 'lift' (lift/lift, right) has no driver. Give a table [drivers.lift]"),
        ({"lift": ur}, "drivers.lift: a driver 'ur' has one arm, and this robot has lift/lift, left, right. Give each "
         "arm a table of its own, [drivers.left], [drivers.right], and [drivers.lift] another kind for "
         "lift/lift."),
        ({"lift": ur, "left": sim, "right": sim}, "drivers.lift: a driver 'ur' has one arm"),
        ({"lift": 'kind = "franka"\naddress = "192.0.2.1"\n'}, "a driver 'franka' has one arm"),
    ):  # fmt: skip
        lift.write_text(text + "".join(f"\n[drivers.{name}]\n{table}" for name, table in tables.items()))
        assert main(["drive", str(lift)]) == 2
        assert words in capsys.readouterr().err


def test_arms_of_a_robot_may_have_drivers_beside_that_of_their_lift(lift):
    text = lift.read_text()
    tables = "".join(f'\n[drivers.{name}]\nkind = "sim"\n' for name in ("right", "lift"))
    lift.write_text(text + tables)
    drivers = load_cell_file(lift).drivers()
    names = {name: driver.joint_names for name, driver in drivers.items()}
    assert names["right"] == tuple(f"right_joint_{i}" for i in range(1, 7))
    assert names["lift"] == ("lift", *(f"left_joint_{i}" for i in range(1, 7)))
    # Without a joint that arms share the robot is as two arms: each has a driver, or the robot.
    lift.write_text(text.replace('robot = "lift2"', 'robot = "lift2"\nlocked_joints_rad = { lift = 0.4 }').replace(
        "limits.lift = { acceleration_rad_per_s2 = 0.5 }", "").replace("translation_m = [0.0, 0.0, 1.5]",
        "translation_m = [0.0, 0.0, 0.3]").replace("0.55, 0.0, 0.20", "0.55, 0.0, 0.8"))  # fmt: skip
    assert list(load_cell_file(lift).drivers("sim")) == ["left", "right"]
    lift.write_text(lift.read_text() + '\n[drivers.lift]\nkind = "sim"\n')
    (robot,) = load_cell_file(lift).drivers().values()
    assert len(robot.joint_names) == 12
    lift.write_text(lift.read_text() + "".join(f'[drivers.{a}]\nkind = "sim"\n' for a in ("left", "right")))
    with pytest.raises(CellFileError, match=r"drivers\.lift: every arm of this robot has a driver of its own"):
        load_cell_file(lift).drivers()


@pytest.mark.usefixtures("patient")
def test_a_stop_that_nobody_can_resume_ends_the_run_and_is_said(quick, capsys):
    """Commands that come a second late: the robot stands, though told to move."""
    quick.write_text(quick.read_text().replace("latency = 0.0005", "latency = 1.0"))
    assert main(["drive", str(quick), "--enable", "two_robots", "--speed", "1"]) == 4
    assert re.search("robot '(left|right)' has stopped, and all arms stand", capsys.readouterr().err)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_brakes_together_and_ends_with_its_status(tmp_path, number, status):
    """A terminal signals the whole group of processes; robots whose processes die of it would stop each by itself."""
    record = tmp_path / "new" / "run.npz"
    with subprocess.Popen(
        [sys.executable, "-u", "-c", "import sys; from coopqp.cli.start import main; sys.exit(main())", "drive",
         str(TWO), "--enable", "two_robots", "--record", str(record)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as run:  # fmt: skip
        line = run.stdout.readline()
        assert "the path takes" in line
        os.killpg(run.pid, number)
        rest, errors = run.stdout.read(), run.stderr.read()
    assert run.returncode == status
    assert "interrupted" in rest
    assert "Traceback" not in errors
    assert "no step was made" in errors or not Recording.load(record).finished
