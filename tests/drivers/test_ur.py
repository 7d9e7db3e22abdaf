"""The driver ur: ur_rtde itself drives stand-ins that speak RTDE. The tests wait on states, not on clocks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from places import CELL_FILES
from ur_robots import UrStub

from coopqp import InvalidInputError, QPController, load_cell_file
from coopqp.cli.main import main
from coopqp.drivers import Command, Condition, ControlLoop, DriverError, LoopOptions, UrDriver
from coopqp.drivers.ur import condition_of
from coopqp.errors import MissingExtraError

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]
NAMES = tuple("abcdef")


@pytest.fixture(scope="module")
def two_urs(tmp_path_factory):
    """A cell file of two UR10, with its drivers, and the addresses that this process may use."""
    pytest.importorskip("rtde_control")
    here = os.getpid()
    addresses = [f"127.{1 + here // 65025 % 120}.{1 + here // 255 % 255}.{1 + here % 254}", ""]
    addresses[1] = f"127.{128 + here // 65025 % 120}.{1 + here // 255 % 255}.{1 + here % 254}"
    text = (CELL_FILES / "two_ur10.toml").read_text().replace("duration_s = 3.0", "duration_s = 2.0")
    for k, name in enumerate(load_cell_file(CELL_FILES / "two_ur10.toml").scenario.cell.arm_names):
        text += f'\n[drivers.{name}]\nkind = "ur"\naddress = "{addresses[k]}"\nperiod = 0.004\n'
    file = tmp_path_factory.mktemp("ur") / "two_ur10.toml"
    file.write_text(text)
    return file, addresses


@pytest.fixture(autouse=True)
def stalls(monkeypatch):
    """The machine of the tests may stall for longer than a robot may."""
    monkeypatch.setattr("coopqp.drivers.process_link._SILENCE", 10.0)
    monkeypatch.setattr("coopqp.drivers.options.LoopOptions", partial(LoopOptions, gone_after=10.0))


@pytest.fixture
def robots(two_urs):
    file, addresses = two_urs
    s = load_cell_file(file).scenario
    x = s.cell.positions(s.q_start)
    stubs = [UrStub(address, x[own]) for address, own in zip(addresses, s.cell.v_slices, strict=True)]
    yield stubs
    for stub in stubs:
        stub.close()


@pytest.fixture
def robot(two_urs):
    stub = UrStub(two_urs[1][0], [0.1] * 6)
    driver = UrDriver(NAMES, {"address": stub.address, "tells_wrench": True})
    driver.connect()
    yield driver, stub
    driver.close()
    stub.close()


def _until(driver, holds):
    """The first state that is as it should be; the suite's own limit ends a wait in vain."""
    while True:
        state = driver.read()
        if state is not None and holds(state):
            return state


def test_a_robot_goes_where_it_is_sent_and_says_how_it_is(robot):
    driver, stub = robot
    state = _until(driver, lambda s: True)
    np.testing.assert_allclose(state.q, 0.1, atol=1e-12)
    np.testing.assert_allclose(state.target, 0.1, atol=1e-12)
    # A turn of 90° about z: (1, 2, 3) in the base's axes is (2, −1, 3) in the tool's; the arm's wrench is the other.
    np.testing.assert_allclose(state.wrench, [-2.0, 1.0, -3.0, -5.0, 4.0, -6.0], atol=1e-12)
    last = state
    while np.abs(last.q - 0.11).max() > 1e-6:
        last = driver.read() or last
        driver.send(Command(np.full(6, 0.11), np.zeros(6), last.stamp + 0.01))
    for order, condition in (("protective", Condition.PROTECTIVE), ("release", Condition.RUNNING),
                             ("slider 0", Condition.STOPPED)):  # fmt: skip
        stub.order(order)
        state = _until(driver, lambda s, condition=condition: s.condition is condition)
    stub.order("slider 0.5")
    assert _until(driver, lambda s: s.scaling == 0.5).condition is Condition.RUNNING
    stub.order("estop")
    _until(driver, lambda s: s.condition is Condition.FAULT)


def test_every_command_arrives_once_and_a_stop_ends_the_program(robot):
    driver, stub = robot
    state, goal = _until(driver, lambda s: True), 0.1
    for number in range(105):
        state = _until(driver, lambda s, last=state: s.stamp > last.stamp)
        goal += 1e-4 if number < 100 else 0.0  # a curve through commands is at the last one where they rest
        driver.send(Command(np.full(6, goal), np.zeros(6), state.stamp + 0.004))
    state = _until(driver, lambda s: np.abs(s.target - goal).max() < 1e-9)
    assert stub.servoed() >= 100
    driver.stop()
    driver.stop()
    _until(driver, lambda s: s.condition is Condition.FAULT)  # its program is at its end
    before = stub.servoed()
    driver.send(Command(np.full(6, 0.5), np.zeros(6), state.stamp + 1.0))
    state = _until(driver, lambda s: True)
    _until(driver, lambda s, last=state: s.stamp > last.stamp + 0.02)
    assert stub.servoed() == before


def test_two_robots_are_driven_from_the_command_line(two_urs, robots, capsys):
    assert main(["drive", str(two_urs[0]), "--enable", "two_ur10", "--speed", "1"]) == 0
    said = capsys.readouterr().out
    assert "finished after" in said
    assert "lags left 30 ms, right 30 ms" in said
    assert all(stub.servoed() > 100 for stub in robots)


class _Events:
    """Things that happen in certain periods of a run."""

    def __init__(self, *events):
        self.number, self.events, self.seen = 0, dict(events), []

    def take(self, moment, measured, sent, step, clock):
        self.number += 1
        if self.number in self.events:
            self.events[self.number]()


def _loop(file, recorder, gone_after=10.0):
    run = load_cell_file(file)
    s = run.scenario
    controller = QPController(s.cell, s.grasp, s.path, dt=s.dt)
    drivers = run.drivers()
    return ControlLoop(controller, drivers, {"gone_after": gone_after}, recorder=recorder), drivers


def test_a_protective_stop_brings_both_to_rest_and_the_run_goes_on_by_hand(two_urs, robots):
    events = _Events()
    loop, drivers = _loop(two_urs[0], events)
    events.events = {150: lambda: robots[1].order("protective")}
    stand = events.take

    def take(*given):
        stand(*given)
        if loop.stands and not events.seen:
            events.seen.append("stands")
            robots[1].order("release")
        if events.seen and loop.stands:
            loop.resume()  # in vain until the robot says that it is released

    events.take = take
    try:
        report = loop.run()
    finally:
        for driver in drivers.values():
            driver.close()
    assert report.finished, report.reason
    assert report.stops == 1
    assert report.acceleration <= 1.0 + 1e-9


def test_a_robot_that_is_killed_ends_the_run(two_urs, robots):
    events = _Events((100, lambda: robots[0].process.send_signal(signal.SIGKILL)))
    loop, drivers = _loop(two_urs[0], events, gone_after=0.3)
    try:
        report = loop.run()
    finally:
        for driver in drivers.values():
            driver.close()
    assert not report.finished
    assert "robot 'left' told no state" in report.reason


_LOOP = """
import sys
import numpy as np
from coopqp.drivers import Command, UrDriver
driver = UrDriver("abcdef", {"address": sys.argv[1]})
driver.connect()
number, state = 0, None
while True:
    new = driver.read()
    if new is not None:
        number, state = number + 1, new
        driver.send(Command(np.full(6, 0.1 + 1e-4 * number), np.zeros(6), state.stamp + 0.004))
        if number == 50:
            print("moves", flush=True)
"""


def test_a_loop_that_is_killed_leaves_no_robot_moving(two_urs):
    """By kill −9: the robot's own process sees it, stops the robot and ends its program."""
    stub = UrStub(two_urs[1][0], [0.1] * 6)
    loop = subprocess.Popen([sys.executable, "-c", _LOOP, stub.address], stdout=subprocess.PIPE, text=True)
    try:
        assert loop.stdout.readline() == "moves\n"
        assert stub.runs()
        loop.kill()
        while stub.runs():
            pass
        before = stub.servoed()
        assert before >= 40
        assert stub.servoed() == before
    finally:
        loop.kill()
        loop.communicate()
        stub.close()


def test_nobody_at_the_address(two_urs):
    with pytest.raises(DriverError, match="cannot be driven"):
        UrDriver(NAMES, {"address": "127.0.0.99"}).connect()


def test_bad_settings_and_a_missing_package_are_said_before_anything_is_done(monkeypatch):
    for names, bad in ((NAMES[:5], {"address": "x"}), (NAMES, {"address": ""}), (NAMES, {"address": "x", "gain": 5.0}),
                       (NAMES, {"address": "x", "lookahead": 0.01})):  # fmt: skip
        with pytest.raises(InvalidInputError):
            UrDriver(names, bad)
    monkeypatch.setitem(sys.modules, "rtde_receive", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[ur\]"):
        UrDriver(NAMES, {"address": "x"})


@pytest.mark.parametrize(
    ("safety", "runtime", "slider", "condition"),
    [(1, 2, 1.0, "RUNNING"), (2, 2, 0.3, "RUNNING"), (1, 4, 1.0, "STOPPED"), (1, 2, 0.0, "STOPPED"),
     (5, 2, 1.0, "STOPPED"), (3, 4, 1.0, "PROTECTIVE"), (7, 2, 1.0, "FAULT"), (1, 1, 1.0, "FAULT")],
)  # fmt: skip
def test_conditions(safety, runtime, slider, condition):
    assert condition_of(safety, runtime, slider) is Condition[condition]
