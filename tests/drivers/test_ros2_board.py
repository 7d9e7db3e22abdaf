"""What a loop tells over ROS 2, and the targets it gets: with a node of rclpy where COOPQP_ROS_PYTHON names a Python.

Each process of the tests has a domain of its own. The tests wait on messages, not on clocks.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from places import CELL_FILES
from scipy.spatial.transform import Rotation

from coopqp import InvalidInputError, QPController
from coopqp.cli.main import main
from coopqp.drivers import ControlLoop, LoopOptions, Ros2Board
from coopqp.errors import MissingExtraError
from coopqp.scenarios import paper_lift

pytestmark = pytest.mark.slow
NODE = Path(__file__).parents[1] / "support" / "ros2_node.py"
ROS = os.environ.get("COOPQP_ROS_PYTHON", sys.executable)
TOPICS = {"status": "/diagnostics", "object": "/coopqp/object_pose", "target": "/hand"}
DOMAIN = 101 + os.getpid() % 100


class Node:
    """The other node, and what it has got."""

    def __init__(self):
        variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION":
                     "rmw_fastrtps_cpp"}  # fmt: skip
        self.process = subprocess.Popen(
            [ROS, str(NODE), json.dumps({**TOPICS, "domain": DOMAIN})],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=variables,
        )  # fmt: skip
        assert self.process.stdout.readline() == "ready\n"

    def next(self, kind):
        while True:
            said = json.loads(self.process.stdout.readline())
            if said[0] == kind:
                return said[1:]

    def send(self, T, frame="world"):
        self.process.stdin.write(json.dumps([frame, *pin.SE3ToXYZQUAT(T)]) + "\n")
        self.process.stdin.flush()

    def close(self):
        self.process.kill()
        self.process.communicate()


class Loop:
    """Stands for a control loop: keeps the hand's calls."""

    def __init__(self):
        task = paper_lift(time_law="quintic")
        self.controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
        self.controller.reset(task.q_start)
        self.called, self.came = [], threading.Event()

    def engage(self, T):
        self.called.append(("engage", T))
        self.came.set()

    def target(self, T):
        self.called.append(("target", T))
        self.came.set()


def test_statuses_and_poses_go_out_and_targets_come_in():
    pytest.importorskip("cyclonedds")
    loop, node = Loop(), Node()
    options = {"target_topic": TOPICS["target"], "domain": DOMAIN, "localhost": True}
    board = Ros2Board(loop, "lift", options)
    done = threading.Event()

    def steps():
        while not done.is_set():
            board.observe(loop.controller.step())
            done.wait(0.01)

    thread = threading.Thread(target=steps)
    thread.start()
    try:
        level, name, message, values = node.next("status")
        assert (level, name) == (0, "coopqp: lift")
        assert values["status"] in message.lower() or message
        assert set(values) == {"status", "clock", "rate", "cause"}
        frame, *numbers = node.next("object")
        assert frame == "world"
        path = loop.controller.path
        away = min(np.linalg.norm(path.pose(t).translation - numbers[:3]) for t in np.linspace(0, path.duration, 2000))
        assert away < 1e-3
        assert np.linalg.norm(numbers[3:]) == pytest.approx(1.0)
        hand = pin.SE3(Rotation.from_euler("z", 30.0, degrees=True).as_matrix(), np.array([0.1, 0.2, 0.3]))
        while not loop.came.wait(0.05):  # until the node has found the board
            node.send(pin.SE3.Identity(), frame="camera")
            node.send(hand)
        assert loop.called[0][0] == "engage"
        assert all(T.isApprox(hand, 1e-9) for _, T in loop.called)  # those of another frame are ignored
        assert board.targets >= 1
    finally:
        done.set()
        thread.join()
        board.close()
        node.close()


def test_bad_settings_and_a_missing_package_are_said_before_anything_is_done(monkeypatch):
    loop = SimpleNamespace()
    for bad in ({"status_topic": "x"}, {"target_topic": 3}, {"domain": 300}, {"frame": ""}):
        with pytest.raises(InvalidInputError):
            Ros2Board(loop, "lift", bad)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(MissingExtraError, match=r"coopqp\[ros2\]"):
        Ros2Board(loop, "lift")


def test_a_driven_cell_file_tells_how_it_is(tmp_path, capsys, monkeypatch):
    pytest.importorskip("cyclonedds")
    assert ControlLoop  # it takes the class of its options before that is replaced
    monkeypatch.setattr("coopqp.drivers.options.LoopOptions", partial(LoopOptions, gone_after=10.0))
    text = (CELL_FILES / "two_robots.toml").read_text().replace("duration_s = 2.0", "duration_s = 1.0")
    file = tmp_path / "two.toml"
    file.write_text(f"{text}\n[ros2]\ntarget_topic = '/hand'\ndomain = {DOMAIN}\nlocalhost = true\n")
    node, told = Node(), []

    def listen():
        while not told or told[-1][3]["status"] != "tracking":
            told.append(node.next("status"))

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        assert main(["drive", str(file), "--driver", "sim", "--enable", "two_robots", "--speed", "1"]) == 0
        listener.join()
    finally:
        node.close()
    assert told[-1][1] == "coopqp: two_robots"
    assert "finished after" in capsys.readouterr().out
