"""The driver ros2 with arms behind topics: of rclpy where COOPQP_ROS_PYTHON names a Python with it, else of Cyclone.

Each process of the tests has a domain of its own; nothing leaves the machine. The tests wait on states, not on clocks.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from places import CELL_FILES

from coopqp import InvalidInputError, QPController, load_cell_file
from coopqp.drivers import Command, ControlLoop, Ros2Driver
from coopqp.drivers.ros2 import Ros2Options, Ros2Robot
from coopqp.drivers.ros2_domain import OneSender
from coopqp.errors import MissingExtraError

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")]
PEER = Path(__file__).parents[1] / "support" / "ros2_peer.py"
ROS = os.environ.get("COOPQP_ROS_PYTHON", sys.executable)
DOMAIN = os.getpid() % 100 + 1


class Peer:
    def __init__(self, arms, lag=0.02):
        settings = json.dumps({"arms": arms, "domain": DOMAIN, "lag": lag})
        variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION":
                     "rmw_fastrtps_cpp"}  # fmt: skip
        self.process = subprocess.Popen(
            [ROS, str(PEER), settings], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=variables
        )
        assert self.process.stdout.readline().startswith("ready")

    def count(self):
        self.process.stdin.write("count\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.kill()
        self.process.communicate()


@pytest.fixture(autouse=True)
def stalls(monkeypatch):
    """The machine of the tests may stall for longer than a robot may."""
    pytest.importorskip("cyclonedds")
    monkeypatch.setattr("coopqp.drivers.process_link._SILENCE", 10.0)


def _until(driver, holds):
    """The first state that is as it should be; the suite's own limit ends a wait in vain."""
    while True:
        state = driver.read()
        if state is not None and holds(state):
            return state


@pytest.mark.parametrize("sends", ["trajectory", "forward"])
def test_an_arm_goes_where_it_is_sent(sends):
    peer = Peer({"left": [["p_a", "p_b"], [0.1, -0.2]], "right": [["a", "b"], [1.0, 2.0]]})
    topic = {"trajectory": "/left/joint_trajectory", "forward": "/left/commands"}[sends]
    driver = Ros2Driver(
        ("a", "b"),
        {"command_topic": topic, "sends": sends, "wrench_topic": "/left/wrench", "joint_prefix": "p_", "period": 0.004,
         "domain": DOMAIN, "localhost": True},
    )  # fmt: skip
    try:
        driver.connect()
        state = _until(driver, lambda s: s.wrench is not None and np.isfinite(s.wrench).all())
        np.testing.assert_allclose(state.q, [0.1, -0.2], atol=1e-12)
        np.testing.assert_allclose(state.wrench, [-1.5, 0, 0, 0, 0, 0.5])
        goal = np.array([0.12, -0.18])
        while np.abs(state.q - goal).max() > 1e-6:
            state = driver.read() or state
            driver.send(Command(goal, np.zeros(2), state.stamp + 0.02))
        counts = peer.count()
        assert counts["left"] > 0
        assert counts["right"] == 0
        driver.stop()
    finally:
        driver.close()
        peer.close()


def test_a_second_sender_of_a_robots_joints_is_ignored(capsys):
    from coopqp.drivers import ros2_messages as messages

    topic = {"states_topic": "/twice", "domain": DOMAIN, "localhost": True, "period": 0.004}
    robot = Ros2Robot(("a", "b"), Ros2Options(command_topic="/nobody", **topic))
    robot.connect()
    writers = [robot._participant.writer("/twice", messages.JointState) for _ in range(3)]

    def tell(k, names, value):
        writers[k].write(messages.JointState(name=list(names), position=[value] * len(names)))

    state = None
    while state is None:
        tell(2, "cd", 7.0)  # another robot's joints
        tell(0, "ab", 0.1)
        state = robot.read()
    while not robot._sender.refused:
        tell(1, "ab", 2.0)
        tell(0, "ab", 0.1)
        state = robot.read() or state
        np.testing.assert_array_equal(state.q, 0.1)
    assert "another sender tells the joints of this robot" in capsys.readouterr().err


def test_a_sender_that_is_silent_may_be_followed_by_another(monkeypatch):
    now, heard = 0.0, OneSender("targets", silence=0.25)
    monkeypatch.setattr("coopqp.drivers.ros2_domain.time.monotonic", lambda: now)

    def passes(sender):
        return heard.passes(SimpleNamespace(sample_info=SimpleNamespace(publication_handle=sender)))

    assert passes(1)
    assert not passes(2)
    now = 0.2
    assert passes(1)
    now = 0.44
    assert not passes(2)
    now = 0.46
    assert passes(2)
    assert not passes(1)
    assert heard.refused == 3


def test_two_arms_of_a_cell_file_finish(tmp_path):
    text = (CELL_FILES / "two_robots.toml").read_text().replace("duration_s = 2.0", "duration_s = 1.0")
    head, rest = text.split("[drivers.left]")[0], text[text.index("[grasp]") :]
    tables = [
        f'[drivers.{name}]\nkind = "ros2"\ncommand_topic = "/{name}/joint_trajectory"\njoint_prefix = "{name}_"\n'
        f"period = 0.004\nlag = 0.02\ndomain = {DOMAIN}\nlocalhost = true\n\n"
        for name in ("left", "right")
    ]
    file = tmp_path / "two.toml"
    file.write_text(head + "".join(tables) + rest)
    run = load_cell_file(file)
    s = run.scenario
    x = s.cell.positions(s.q_start)
    arms = {
        name: [[f"{name}_{joint.split('/')[1]}" for joint in s.cell.joint_names[own]], x[own].tolist()]
        for name, own in zip(s.cell.arm_names, s.cell.v_slices, strict=True)
    }
    peer, drivers = Peer(arms), run.drivers()
    # Topics tell no target, so what the grip would bear without one is told.
    controller = QPController(s.cell, s.grasp, s.path, dt=s.dt, options={"supervision": {"stiffness": 1e4}})
    loop = ControlLoop(controller, drivers, {"gone_after": 10.0, "give_up_after": 10.0})
    try:
        report = loop.run()
        counts = peer.count()
    finally:
        for driver in drivers.values():
            driver.close()
        peer.close()
    assert report.finished, report.reason
    assert report.acceleration <= 1.0 + 1e-9
    assert min(counts.values()) > 200
    assert report.apart < 0.02  # on a machine that may stall


def test_bad_settings_and_a_missing_package_are_said_before_anything_is_done(monkeypatch):
    for bad in ({"command_topic": ""}, {"command_topic": "left"}, {"domain": 300}, {"lag": -1.0}, {"sends": "else"},
                {"wrench_acts_on": "x"}):  # fmt: skip
        with pytest.raises(InvalidInputError):
            Ros2Driver(("a",), {"command_topic": "/a", **bad})
    with pytest.raises(InvalidInputError):
        Ros2Driver((), {"command_topic": "/a"})
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[ros2\]"):
        Ros2Driver(("a",), {"command_topic": "/a"})
