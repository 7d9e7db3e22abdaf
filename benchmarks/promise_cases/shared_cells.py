"""Cells of robots whose arms share joints, and what judges their motions: one model of the whole robot.

The judge is one Pinocchio model, read from the URDF by itself.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Grasp, LinePath, QPController, Robot, RobotCell
from coopqp.planning import PathCheck
from coopqp.scenarios import robot_path
from coopqp.simulation import Recording
from coopqp.spatial import Array

#: Torsos of ten robots: kind and axis of each joint, from the base up.
TORSOS: tuple[tuple[tuple[str, str], ...], ...] = (
    (("prismatic", "0 0 1"),),
    (("revolute", "0 0 1"),),
    (("continuous", "0 0 1"),),
    (("revolute", "0 1 0"),),
    (("prismatic", "0 0 1"), ("revolute", "0 0 1")),
    (("revolute", "0 0 1"), ("revolute", "0 1 0")),
    (("continuous", "0 0 1"), ("prismatic", "0 0 1")),
    (("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("continuous", "0 0 1")),
    (("revolute", "0.6 0 0.8"),),
    (("revolute", "1 0 0"), ("revolute", "0 1 0"), ("revolute", "0 0 1")),
)
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
OFFSETS = ("0 0 0.1", "0 0 0.1", "0 0 0.4", "0.1 0 0", "0.35 0 0", "0.1 0 0")
SIDES = ("left", "right")


def _joint(name: str, kind: str, parent: str, child: str, axis: str, xyz: str) -> str:
    reach = {"prismatic": 'lower="-0.3" upper="0.3" ', "revolute": 'lower="-2.9" upper="2.9" ', "continuous": ""}[kind]
    speed = 0.3 if kind == "prismatic" else 2.0
    return (
        f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/><limit {reach}velocity="{speed}" effort="100"/></joint>'
    )


def written(torso: tuple[tuple[str, str], ...], file: Path) -> Path:
    """A URDF of a torso with two arms of six joints."""
    text, last = '<robot name="both"><link name="base"/>', "base"
    for i, (kind, axis) in enumerate(torso):
        text += _joint(f"torso_{i}", kind, last, f"chest_{i}", axis, "0 0 0.3")
        last = f"chest_{i}"
    for side, y in zip(SIDES, (0.3, -0.3), strict=True):
        before = last
        for i, (axis, xyz) in enumerate(zip(AXES, OFFSETS, strict=True)):
            place = f"0 {y} 0.4" if i == 0 else xyz
            text += _joint(f"{side}_{i}", "revolute", before, f"{side}_link_{i}", axis, place)
            before = f"{side}_link_{i}"
    file.write_text(text + "</robot>", encoding="utf-8")
    return file


def torso_cell(torso: tuple[tuple[str, str], ...], folder: Path) -> tuple[RobotCell, Grasp, Path]:
    file = written(torso, folder / "both.urdf")
    tools = {side: f"{side}_link_5" for side in SIDES}
    robot = Robot(file, tools, name="torso", geometry=False, acceleration_limits=5.0)
    return RobotCell([robot]), Grasp(tuple(pin.SE3(np.eye(3), np.array([0.0, y, 0.0])) for y in (0.2, -0.2))), file


def lift_cell(**options: Any) -> tuple[RobotCell, Grasp, Path]:
    tools = {side: f"{side}_tool" for side in SIDES}
    robot = Robot(robot_path("lift2"), tools, name="lift", geometry=False, acceleration_limits=5.0, **options)
    ends = ((0.3, 0.5 * np.pi), (-0.3, -0.5 * np.pi))
    grasp = Grasp(tuple(pin.SE3(pin.rpy.rpyToMatrix(a, 0.0, 0.0), np.array([0.0, y, 0.0])) for y, a in ends))
    return RobotCell([robot]), grasp, robot_path("lift2")


def random_motion(rng: np.random.Generator, folder: Path, *, lift: bool) -> tuple[RobotCell, Grasp, Path, LinePath]:
    """A bar that a lift, or a robot with a waist, moves somewhere: the cell, the grasp, the URDF and the path."""
    if lift:
        cell, grasp, file = lift_cell()
        start = np.array([rng.uniform(0.4, 0.65), rng.uniform(-0.15, 0.15), rng.uniform(0.2, 0.6)])
        way = rng.uniform(-1.0, 1.0, 3) * [0.1, 0.15, 0.0] + [0.0, 0.0, rng.uniform(0.9, 1.5)]
    else:
        cell, grasp, file = torso_cell(TORSOS[1], folder)
        start = np.array([rng.uniform(0.4, 0.6), rng.uniform(-0.1, 0.1), rng.uniform(0.6, 0.9)])
        way = rng.uniform(-1.0, 1.0, 3) * [0.15, 0.3, 0.4]
    turn = pin.exp3(rng.uniform(-0.3, 0.3, 3))
    return cell, grasp, file, LinePath(pin.SE3(np.eye(3), start), pin.SE3(turn, start + way), duration=6.0)


class Whole:
    """One model of the whole robot, and where each tool carries the object."""

    def __init__(self, cell: RobotCell, grasp: Grasp, file: Path) -> None:
        self._cell, self._grasp = cell, grasp
        self._model = pin.buildModelFromUrdf(str(file))
        self._data = self._model.createData()
        ids = [self._model.getJointId(name.partition("/")[2]) for name in cell.joint_names]
        self._joints = [self._model.joints[i] for i in ids]
        self._frames = [self._model.getFrameId(arm.tool_frame) for arm in cell.arms]

    def carried(self, x: Array) -> list[pin.SE3]:
        """The object as each arm carries it, at joint positions (nv,) of the cell."""
        q = pin.neutral(self._model)
        for joint, value in zip(self._joints, x.tolist(), strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        pin.framesForwardKinematics(self._model, self._data, q)
        tools = [self._data.oMf[f] for f in self._frames]
        return [T * X.inverse() for T, X in zip(tools, self._grasp.T_object_tool, strict=True)]

    def errors(self, check: PathCheck, count: int) -> int:
        """Samples of the proved motion that leave a limit or the path."""
        proved = check.proved_trajectory()
        assert proved is not None
        places = np.linspace(0.0, proved.places[-1], count)
        x, limits, bad = proved.positions(places)[0], self._cell.limits, 0
        for row, T in zip(x, proved.poses(places), strict=True):
            far = max(np.abs(O.homogeneous - T).max() for O in self.carried(row))
            bad += bool(far > 1e-9 or (row < limits.lower - 1e-9).any() or (row > limits.upper + 1e-9).any())
        return bad

    def run(self, recording: Recording) -> tuple[float, float]:
        """Largest distance of the arms' views of the object, and of them from the path [µm]."""
        apart = off = 0.0
        for row, T in zip(self._cell.positions(recording.q_command), recording.reference, strict=True):
            points = np.array([O.translation for O in self.carried(row)])
            apart = max(apart, float(np.linalg.norm(points[0] - points[1])))
            off = max(off, float(np.linalg.norm(points - np.asarray(T)[:3, 3], axis=1).max()))
        return 1e6 * apart, 1e6 * off


def say(what: str) -> None:
    """Say how far the group is."""
    print(f"{what} …", file=sys.stderr, flush=True)


def median_step(controller: QPController, steps: int, pause: float) -> float:
    """Median of the steps' times [µs], with a pause [s] before each."""
    times = []
    for _ in range(steps):
        if pause:
            time.sleep(pause)
        began = time.perf_counter_ns()
        controller.step()
        times.append(time.perf_counter_ns() - began)
    return float(np.median(times)) / 1e3
