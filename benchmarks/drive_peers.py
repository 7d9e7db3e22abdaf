"""Cases of ``drive.py`` in real time, against what robots really speak: ROS 2 nodes of rclpy, RTDE, franky-sim.

Each says what it lacks where its peer is not there, and is then left out. They judge the machine's timing, too.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from drive_runs import CELL, DT, LIFT, Row

from coopqp import Grasp, LinePath, QPController, RobotCell, WaypointPath, simulate
from coopqp.drivers import Command, ControlLoop, FrankaDriver, LoopOptions, Ros2Driver, SimDriver, UrDriver
from coopqp.drivers.bag_recorder import BagRecorder
from coopqp.drivers.process import prepare_process
from coopqp.drivers.report import LoopReport
from coopqp.errors import StiffnessWarning
from coopqp.model.state import CellState
from coopqp.scenarios import robot_arm
from coopqp.spatial import Array

ROOT = Path(__file__).resolve().parents[1]
SUPPORT = ROOT / "tests" / "support"
#: A Python with rclpy.
ROS = os.environ.get("COOPQP_ROS_PYTHON", "")
NEEDS_ROS = "COOPQP_ROS_PYTHON has to name a Python with rclpy"
DOMAIN = 60
#: How long the last commands' echoes are waited for [s].
_UNDER_WAY = 0.5


class MissingPeerError(Exception):
    """What a case needs is not on this machine."""


def _joints(k: int) -> list[str]:
    return [joint.partition("/")[2] for joint in CELL.joint_names[CELL.v_slices[k]]]


@contextlib.contextmanager
def _node(script: Path, settings: dict[str, Any]) -> Iterator[subprocess.Popen[str]]:
    if not ROS:
        raise MissingPeerError(NEEDS_ROS)
    variables = {
        **os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"
    }  # fmt: skip
    process = subprocess.Popen(
        [ROS, "-O", str(script), json.dumps(settings)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=variables,
    )  # fmt: skip
    with contextlib.suppress(PermissionError):  # as a robot's own controllers run
        os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(40))
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield process
    finally:
        process.kill()
        process.communicate()


def _counts(process: subprocess.Popen[str]) -> dict[str, int]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write("count\n")
    process.stdin.flush()
    found: dict[str, int] = json.loads(process.stdout.readline())
    return found


def _ros_drivers(more: dict[str, Any]) -> dict[str, Ros2Driver]:
    return {
        name: Ros2Driver(
            _joints(k),
            {"command_topic": f"/{name}/joint_trajectory", "domain": DOMAIN, "localhost": True, "period": DT,
             **{key: value.format(name=name) if isinstance(value, str) else value for key, value in more.items()}},
        )
        for k, name in enumerate(CELL.arm_names)
    }  # fmt: skip


def echo(number: int = 5000) -> Iterator[Row]:
    """Three arms at 500 Hz over DDS to rclpy: from a command until its echo is read."""
    arms = {name: _joints(k) for k, name in enumerate(CELL.arm_names)}
    with _node(ROOT / "benchmarks" / "peers" / "ros2_echo.py", {"arms": arms, "domain": DOMAIN}) as node:
        drivers = _ros_drivers({"states_topic": "/{name}/states"})
        try:
            ages = _ages(drivers, number)
            counts = _counts(node)
        finally:
            for driver in drivers.values():
                driver.close()
    p50, p99 = np.percentile(ages, [50.0, 99.0])
    yield Row("three arms over DDS to rclpy, command to echo: p50", 1e3 * float(p50), 4.5, "ms")
    yield Row("three arms over DDS to rclpy, command to echo: p99", 1e3 * float(p99), 8.0, "ms")
    lost = float(sum(number - count for count in counts.values()))
    yield Row(f"the same: commands lost of {len(arms) * number}", lost, 0.0, "1")


def _ages(drivers: dict[str, Ros2Driver], number: int) -> Array:
    prepare_process(realtime=50, lock_memory=True, core=None)
    for driver in drivers.values():
        driver.connect()
    sent, ages = np.zeros(number + 1), list[float]()
    seen = dict.fromkeys(drivers, 0)
    deadline = time.monotonic()
    for i in range(1, number + 1):
        deadline += DT if i < number else _UNDER_WAY
        sent[i] = time.monotonic()
        for driver in drivers.values():
            driver.send(Command(np.full(len(driver.joint_names), 1e-6 * i), np.zeros(6), time.time()))
        while time.monotonic() < deadline:
            for name, driver in drivers.items():
                state = driver.read()
                at = 0 if state is None else round(1e6 * float(state.q[0]))
                if at > seen[name]:
                    ages.append(time.monotonic() - sent[at])
                    seen[name] = at
            time.sleep(1e-4)
    return np.array(ages)


def _lifts(duration: float) -> WaypointPath:
    """The lift, up and down again and again."""
    begin, end = LIFT.path.pose(0.0), LIFT.path.pose(LIFT.path.duration)
    number = max(1, round(duration / (2.0 * LIFT.path.duration)))
    return WaypointPath([begin, *([end, begin] * number)], durations=[LIFT.path.duration] * (2 * number))


def minutes(duration: float = 600.0) -> Iterator[Row]:
    """Three arms over DDS to rclpy for minutes: what is lost."""
    x = CELL.positions(LIFT.q_start)
    arms = {
        name: [[f"{name}_{joint}" for joint in _joints(k)], x[own].tolist()]
        for k, (name, own) in enumerate(zip(CELL.arm_names, CELL.v_slices, strict=True))
    }
    settings = {"arms": arms, "domain": DOMAIN, "lag": 0.02, "period": DT, "wrenches": False}
    with _node(SUPPORT / "ros2_peer.py", settings) as node:
        drivers = _ros_drivers({"joint_prefix": "{name}_", "lag": 0.02})
        controller = QPController(
            CELL, LIFT.grasp, _lifts(duration), dt=DT, options={"supervision": {"stiffness": 1e4}}
        )
        loop = ControlLoop(controller, drivers, LoopOptions(realtime=50, lock_memory=True))
        try:
            report = loop.run()
            counts = _counts(node)
        finally:
            for driver in drivers.values():
                driver.close()
    case = f"{report.time / 60.0:.1f} minutes over DDS to rclpy, {3 * report.commands} commands"
    lost = sum(report.commands - count for count in counts.values()) if report.finished else np.nan
    yield Row(f"{case}: lost", float(lost), 0.0, "1")
    holding = report.statuses.get("holding", 0) / max(1, sum(report.statuses.values()))
    yield Row(f"{case}: steps HOLDING", 100.0 * holding, 0.1, "%")


class _Apart:
    """Distance of the arms in periods that are not late, from what they measure."""

    def __init__(self, cell: RobotCell, grasp: Grasp, period: float = DT) -> None:
        self._cell, self._grasp, self._last = cell, grasp, -np.inf
        self._longest = 1.5 * period
        self.found: list[float] = []
        self._number = 0

    def take(self, moment: float, measured: Array, sent: Array, step: Any, clock: float) -> None:
        late, self._last = moment - self._last > self._longest, moment
        self._number += 1
        if late or self._number % 5 or np.isnan(measured).any():
            return
        errors = self._grasp.relative_errors(CellState(self._cell, self._cell.configuration_of(measured)))
        self.found.append(float(np.linalg.norm(errors[:, :3], axis=1).max()))


def _on_sim(recorder: Any, lead: Callable[[ControlLoop], Any] | None = None) -> LoopReport:
    x = CELL.positions(LIFT.q_start)
    drivers = {
        name: SimDriver(_joints(k), x[own], {"lag": lag})
        for k, (name, own, lag) in enumerate(zip(CELL.arm_names, CELL.v_slices, (0.007, 0.032, 0.047), strict=True))
    }
    loop = ControlLoop(QPController(CELL, LIFT.grasp, LIFT.path, dt=DT), drivers, {"realtime": 50}, recorder=recorder)
    with contextlib.ExitStack() as ending:
        for driver in drivers.values():
            ending.callback(driver.close)
        if lead is not None:
            ending.callback(lead(loop).close)
        warnings.simplefilter("ignore", StiffnessWarning)
        return loop.run()


def real_time() -> Iterator[Row]:
    """A lift at 0.19 m/s on simulated robots in processes of their own, lags told."""
    apart = _Apart(CELL, LIFT.grasp)
    report = _on_sim(apart)
    found = 1e3 * np.array(apart.found) if report.finished else np.array([np.nan])
    yield Row("three robots in real time: apart, median", float(np.median(found)), 0.03, "mm")
    yield Row("three robots in real time: apart outside of late periods", float(found.max()), 0.5, "mm")


def late(number: int = 6) -> Iterator[Row]:
    """Periods that begin half a period late: bare, and with a bag and the operator's page, by turns."""
    shares: dict[str, list[float]] = {"bare": [], "seen": []}
    missing = 0
    for _ in range(number):
        seen, lost = _seen()
        missing += lost
        for name, report in (("bare", _on_sim(None)), ("seen", seen)):
            shares[name].append(100.0 * report.late / report.periods if report.finished else np.nan)
    bare, over = float(np.median(shares["bare"])), float(np.median(shares["seen"]))
    yield Row("late by half a period with recorder and page, over bare", over - bare, 0.1, "%")
    yield Row("the same, bare", bare, 100.0, "%")
    yield Row("the same: records lost", float(missing), 0.0, "1")


def _seen() -> tuple[LoopReport, int]:
    """A run with a bag and the operator's page, and how many records were lost."""
    from coopqp.visualization.jog.link import PageLink

    with tempfile.TemporaryDirectory() as folder:
        bag = BagRecorder(CELL.joint_names, Path(folder) / "bag")

        def lead(loop: ControlLoop) -> PageLink:
            still = QPController(CELL, LIFT.grasp, LIFT.path, dt=DT)
            start = simulate(still, q_start=LIFT.q_start, duration=DT, metadata={"scenario": "lift", "object": None})
            link = PageLink(_Watched(loop), start, port=0, sticks=True)
            loop.shows.append(link.observe)
            return link

        report = _on_sim(bag, lead)
        return report, bag.close()[0]


class _Watched:
    """A loop that a page shows and does not lead."""

    def __init__(self, loop: ControlLoop) -> None:
        self.controller = loop.controller

    def call(self, *call: Any, **named: Any) -> None:
        """Nothing is called."""

    def lateness(self, last: int) -> None:
        """It stands in the report."""


def ur(number: int = 1000) -> Iterator[Row]:
    """ur_rtde and a stand-in that speaks RTDE: commands that arrive."""
    sys.path.append(str(SUPPORT))
    try:
        from ur_robots import UrStub  # type: ignore[import-not-found]
    finally:
        sys.path.remove(str(SUPPORT))
    stub = UrStub("127.60.0.1", [0.1] * 6)
    driver = UrDriver("abcdef", {"address": stub.address})
    try:
        driver.connect()
        state, goal, sent = driver.read(), 0.1, 0
        before = stub.servoed()
        while sent < number:
            new = driver.read()
            if new is not None and (state is None or new.stamp > state.stamp):
                state, goal, sent = new, goal + 1e-5, sent + 1
                driver.send(Command(np.full(6, goal), np.zeros(6), state.stamp + 0.004))
            time.sleep(1e-4)
        while state is None or abs(state.target[0] - goal) > 1e-9:  # type: ignore[index]
            state = driver.read() or state
        arrived = stub.servoed() - before
    finally:
        driver.close()
        stub.close()
    yield Row(f"ur_rtde and its stand-in: missing of {number} servoJ", float(max(0, number - arrived)), 0.0, "1")


#: Where robots of franky-sim begin [rad].
_PANDA = np.array([0.0, 0.0, 0.0, -1.57, 0.0, 1.57, 0.785])


@contextlib.contextmanager
def _franky(addresses: Sequence[str]) -> Iterator[None]:
    program = shutil.which("franky-sim", path=str(Path(sys.executable).parent)) or shutil.which("franky-sim")
    if program is None:
        raise MissingPeerError("franky-sim has to be installed (pip install franky-sim)")
    with contextlib.ExitStack() as ending:
        for address in addresses:
            process = subprocess.Popen(
                [program, "--hostname", address, "-s", "mujoco"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                text=True,
            )  # fmt: skip
            ending.callback(process.communicate)
            ending.callback(process.kill)
            assert process.stdout is not None
            while "Press Ctrl+C" not in process.stdout.readline():
                assert process.poll() is None
        yield


def frankas() -> Iterator[Row]:
    """Two robots of franky-sim, by pylibfranka, carry a bar."""
    turn = pin.SE3(pin.exp3(np.array([0.0, 0.0, np.pi])), np.array([1.3, 0.0, 0.0]))
    arms = [
        robot_arm("panda", name="left", geometry=False, acceleration=5.0),
        robot_arm("panda", name="right", geometry=False, acceleration=5.0, T_world_base=turn),
    ]
    cell = RobotCell(arms)
    q = np.concatenate([_PANDA, _PANDA])
    tools = CellState(cell, q).T_world_tool
    begin = pin.SE3(np.eye(3), 0.5 * (tools[0].translation + tools[1].translation))
    end = pin.SE3(np.eye(3), begin.translation + np.array([0.0, 0.05, 0.1]))
    grasp = Grasp.from_configuration(cell, q, begin)
    controller = QPController(cell, grasp, LinePath(begin, end, duration=3.0, time_law="quintic"), dt=0.004)
    addresses = ("127.100.60.1", "127.100.60.2")
    apart = _Apart(cell, grasp, controller.dt)
    with _franky(addresses):
        drivers = {
            name: FrankaDriver(
                [joint.partition("/")[2] for joint in cell.joint_names[own]],
                {"address": address, "enforces_realtime": False, "stamps_arrival": True},
            )
            for name, own, address in zip(cell.arm_names, cell.v_slices, addresses, strict=True)
        }
        try:
            report = ControlLoop(controller, drivers, {"gone_after": 1.0}, recorder=apart).run()
        finally:
            for driver in drivers.values():
                driver.close()
    found = 1e3 * np.array(apart.found) if report.finished else np.array([np.nan])
    yield Row("two Frankas in franky-sim: apart", float(found.max()), 1.0, "mm")


#: What a full run adds.
PEERS: tuple[Callable[[], Iterator[Row]], ...] = (real_time, late, ur, frankas, echo, minutes)
