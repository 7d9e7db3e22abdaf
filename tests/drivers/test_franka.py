"""The driver franka: pylibfranka itself drives robots of franky-sim. The tests wait on states, not on clocks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp, InvalidInputError, LinePath, QPController, RobotCell
from coopqp.drivers import Command, Condition, ControlLoop, DriverError, FrankaDriver
from coopqp.errors import MissingExtraError
from coopqp.model.state import CellState
from coopqp.scenarios import robot_arm

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]
NAMES = tuple("abcdefg")
#: Where robots of franky-sim begin [rad].
START = np.array([0.0, 0.0, 0.0, -1.57, 0.0, 1.57, 0.785])
PROGRAM = shutil.which("franky-sim", path=str(Path(sys.executable).parent)) or shutil.which("franky-sim")


@pytest.fixture
def address():
    """Address of a simulated robot."""
    pytest.importorskip("pylibfranka")
    if PROGRAM is None:
        pytest.skip("franky-sim is not installed")
    here = os.getpid()
    found = f"127.100.{1 + here // 255 % 255}.{1 + here % 254}"
    command = [PROGRAM, "--hostname", found, "-s", "mujoco"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    while "Press Ctrl+C" not in process.stdout.readline():
        assert process.poll() is None
    yield found
    process.kill()
    process.communicate()


@pytest.fixture(autouse=True)
def stalls(monkeypatch):
    """The machine of the tests may stall for longer than a robot may."""
    monkeypatch.setattr("coopqp.drivers.process_link._SILENCE", 10.0)


def _until(driver, holds):
    """The first state that is as it should be; the suite's own limit ends a wait in vain."""
    while True:
        state = driver.read()
        if state is not None and holds(state):
            return state


def test_a_robot_stays_goes_where_it_is_sent_and_stops(address):
    driver = FrankaDriver(NAMES, {"address": address, "enforces_realtime": False})
    try:
        driver.connect()
        state = _until(driver, lambda s: True)
        np.testing.assert_allclose(state.q, START, atol=1e-3)
        np.testing.assert_allclose(state.target, START, atol=1e-3)
        assert state.condition is Condition.RUNNING
        begin, goal = state.q, state.q + 0.01
        for share in np.linspace(0.0, 1.0, 100):
            last = state
            state = _until(driver, lambda s, last=last: s.stamp > last.stamp)
            driver.send(Command(begin + share * (goal - begin), np.zeros(7), state.stamp + 0.004))
        while np.abs(state.q - goal).max() > 5e-4:
            state = driver.read() or state
            driver.send(Command(goal, np.zeros(7), state.stamp + 0.004))
        driver.stop()
        driver.stop()
    finally:
        driver.close()


def test_a_robot_is_driven_along_a_path(address):
    cell = RobotCell([robot_arm("panda", geometry=False, acceleration=5.0)])
    begin = CellState(cell, START).T_world_tool[0]
    end = pin.SE3(begin.rotation, begin.translation + np.array([0.0, 0.05, 0.08]))
    grasp = Grasp.from_configuration(cell, START, begin)
    controller = QPController(cell, grasp, LinePath(begin, end, duration=1.5, time_law="quintic"), dt=0.004)
    options = {"address": address, "enforces_realtime": False, "stamps_arrival": True}
    driver = FrankaDriver([joint.partition("/")[2] for joint in cell.joint_names], options)

    class Resumes:
        """Goes on after stops: the simulation stands where the machine stalls."""

        def take(self, *given):
            if loop.stands:
                loop.resume()

    loop = ControlLoop(controller, {"panda": driver}, {"gone_after": 10.0, "give_up_after": 10.0}, recorder=Resumes())
    try:
        report = loop.run()
        state = _until(driver, lambda s: True)
    finally:
        driver.close()
    assert report.finished, report.reason
    assert report.acceleration <= 1.0 + 1e-9
    reached = CellState(cell, state.q).T_world_tool[0]
    assert np.linalg.norm(reached.translation - end.translation) < 2e-3


def test_nobody_at_the_address():
    pytest.importorskip("pylibfranka")
    with pytest.raises(DriverError, match="cannot be driven"):
        FrankaDriver(NAMES, {"address": "127.0.0.99", "enforces_realtime": False}).connect()


def test_bad_settings_and_a_missing_package_are_said_before_anything_is_done(monkeypatch):
    for names, bad in ((NAMES[:6], {"address": "x"}), (NAMES, {}), (NAMES, {"address": "x", "gain": 500.0}),
                       (NAMES, {"address": "x", "lag": -1.0})):  # fmt: skip
        with pytest.raises(InvalidInputError):
            FrankaDriver(names, bad)
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[franka\]"):
        FrankaDriver(NAMES, {"address": "x"})
