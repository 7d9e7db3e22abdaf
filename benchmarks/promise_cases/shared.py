"""Joints that arms share: one command, one proof for all arms, a group at a singularity, runs with a torso.

What judges a run is one Pinocchio model of the whole robot, read from the URDF by itself. Steps are those of the
default kernel. The group takes some minutes, most of them for the checks of the random motions; it says how far it is.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, InvalidInputError, LinePath, QPController, Robot, RobotCell, check_path, simulate
from coopqp.model import Chain
from coopqp.planning import PathCheck
from coopqp.scenarios import SHARED_JOINTS, robot_path, scenario
from coopqp.simulation import Recording
from coopqp.spatial import Array
from promise_cases import Promise

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


def _written(torso: tuple[tuple[str, str], ...], file: Path) -> Path:
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


def _torso_cell(torso: tuple[tuple[str, str], ...], folder: Path) -> tuple[RobotCell, Grasp, Path]:
    file = _written(torso, folder / "both.urdf")
    tools = {side: f"{side}_link_5" for side in SIDES}
    robot = Robot(file, tools, name="torso", geometry=False, acceleration_limits=5.0)
    return RobotCell([robot]), Grasp(tuple(pin.SE3(np.eye(3), np.array([0.0, y, 0.0])) for y in (0.2, -0.2))), file


def _lift_cell(**options: Any) -> tuple[RobotCell, Grasp, Path]:
    tools = {side: f"{side}_tool" for side in SIDES}
    robot = Robot(robot_path("lift2"), tools, name="lift", geometry=False, acceleration_limits=5.0, **options)
    ends = ((0.3, 0.5 * np.pi), (-0.3, -0.5 * np.pi))
    grasp = Grasp(tuple(pin.SE3(pin.rpy.rpyToMatrix(a, 0.0, 0.0), np.array([0.0, y, 0.0])) for y, a in ends))
    return RobotCell([robot]), grasp, robot_path("lift2")


class _Whole:
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


def _followed(check: PathCheck, *, dt: float = 0.01, longest: float = 30.0) -> Recording:
    controller = QPController(check.cell, check.grasp, check.led_path(), dt=dt)
    return simulate(controller, q_start=check.q_start, duration=longest)


def _rise(low: float, high: float, duration: float) -> LinePath:
    ends = [pin.SE3(np.eye(3), np.array([0.55, 0.0, z])) for z in (low, high)]
    return LinePath(ends[0], ends[1], duration=duration)


def _say(what: str) -> None:
    """How far the group is."""
    print(f"{what} …", file=sys.stderr, flush=True)


def promises(quick: bool) -> Iterator[Promise]:
    """The cases, with fixed seeds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield from _robots(folder, TORSOS[:3] if quick else TORSOS)
        yield from _singular(folder)
        yield from _lift()
        yield from _scenarios()
        yield from _cost(5 if quick else 25)
        yield from _random(folder, 6 if quick else 100)


def _robots(folder: Path, torsos: tuple[tuple[tuple[str, str], ...], ...]) -> Iterator[Promise]:
    """Dual-arm URDFs, given as two arms and as one robot."""
    wrong = 0
    for number, torso in enumerate(torsos):
        _say(f"robot {number + 1} of {len(torsos)}")
        cell, grasp, file = _torso_cell(torso, folder)
        tools = {side: f"{side}_link_5" for side in SIDES}
        try:
            RobotCell([Arm.from_urdf(side, file, tool_frame=frame, geometry=False) for side, frame in tools.items()])
            wrong += 1  # two commands for one joint
        except InvalidInputError:
            pass
        goal = pin.SE3(pin.exp3(np.array([0.1, 0.0, 0.2])), np.array([0.6, 0.1, 0.3 * len(torso) + 0.7]))
        start = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.3 * len(torso) + 0.5]))
        check = check_path(cell, grasp, LinePath(start, goal, duration=3.0))
        if check.feasible:
            wrong += bool(_Whole(cell, grasp, file).errors(check, 100))
    case = f"motions that one robot cannot make, certified, {len(torsos)} dual-arm URDFs"
    yield Promise(case, wrong, 0.0, "motions")


def _singular(folder: Path) -> Iterator[Promise]:
    """A group at configurations at which one arm is singular by itself."""
    rng, cell = np.random.default_rng(7), _torso_cell(TORSOS[6], folder)[0]
    grasp = Grasp(tuple(pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3)) for _ in range(2)))
    chain, worst, D = Chain(cell, grasp), 0.0, np.diag(cell.limits.velocity)
    for _ in range(20):
        x = rng.uniform(-1.0, 1.0, cell.nv)
        x[cell.joint_names.index("left/left_4")] = 0.0  # the axes before and after it are one line
        chain.linearise(cell.configuration(x), np.array([0.4, 0.0, 0.8]))
        W, A = rng.normal(size=(2, 6)), chain.dense()
        worst = max(worst, float(np.abs(chain.joint_velocities(W) - D @ np.linalg.pinv(A @ D) @ W.ravel()).max()))
    yield Promise("one arm singular, its group not: against the group's pseudo-inverse", worst, 1e-6, "rad/s")


def _lift() -> Iterator[Promise]:
    """A lift whose arms do not reach both ends of a path at one height; one that keeps up, and one that does not."""
    for speed, duration, bound in ((0.1, 8.0, 0.1), (0.02, 4.0, 1.0)):
        cell, grasp, file = _lift_cell(velocity_limits={"lift": speed})
        check = check_path(cell, grasp, _rise(0.2, 1.7, duration))
        run = _followed(check)
        apart, off = _Whole(cell, grasp, file).run(run)
        case = f"a lift of {speed:g} m/s, 1.5 m in {duration:g} s"
        yield Promise(f"{case}: runs that do not finish", float(not run.finished), 0.0, "runs")
        yield Promise(f"{case}: chain", apart, bound, "µm")
        yield Promise(f"{case}: object off its path", off, bound, "µm")


#: The robots of the scenarios, and the files of their models.
ROBOTS = {"torso_lift": "lift2", "two_on_a_rail": "rail2"}
_TOOLS = {side: f"{side}_tool" for side in SIDES}


def _scenarios() -> Iterator[Promise]:
    """Scenarios of arms that share a joint, at 5 rad/s², led as the check proves it."""
    for name in SHARED_JOINTS:
        task = scenario(name)
        cell = task.cell.with_limits(acceleration=np.minimum(task.cell.limits.acceleration, 5.0))
        check = check_path(cell, task.grasp, task.path)
        run = _followed(check, dt=task.dt)
        apart, off = _Whole(cell, task.grasp, robot_path(ROBOTS[name])).run(run)
        yield Promise(f"{name} at 5 rad/s²: runs that do not finish", float(not run.finished), 0.0, "runs")
        yield Promise(f"{name} at 5 rad/s²: chain", apart, 0.1, "µm")
        yield Promise(f"{name} at 5 rad/s²: object off its path", off, 1.0, "µm")


def _cost(rounds: int) -> Iterator[Promise]:
    """A step of arms that share a joint over one of the same arms with that joint locked, in turn."""
    for name in SHARED_JOINTS:
        task = scenario(name)
        (shared,) = task.cell.shared.tolist()
        joint, place = task.cell.joint_names[shared].partition("/")[2], task.cell.positions(task.q_start)[shared]
        locked = Robot(robot_path(ROBOTS[name]), _TOOLS, name=name, locked_joints={joint: place})
        alone = RobotCell([locked]).with_limits(acceleration=np.delete(task.cell.limits.acceleration, shared))
        cells = ((task.cell, task.q_start), (alone, np.delete(task.q_start, shared)))
        here = task.path.pose(0.0)
        for pacing, pause in (("hot", 0.0), ("1 kHz", 1e-3)):
            times = np.zeros((rounds, len(cells)))
            for row in times:
                for i, (cell, q) in enumerate(cells):
                    path = LinePath.displaced(
                        here, translation=(0.0, 0.05, 0.05), rotation=(0.0, 0.0, 0.1), duration=2.0
                    )
                    controller = QPController(cell, task.grasp, path, dt=0.005)
                    controller.reset(q)
                    row[i] = _median_step(controller, 300, pause)
            ratio = float(np.median(times[:, 0] / times[:, 1]))
            case = f"{name}: step, its shared joint over the same arms without, {pacing}"
            yield Promise(f"{case} ({np.median(times[:, 0]):.1f} µs)", ratio, 1.3, "")


def _median_step(controller: QPController, steps: int, pause: float) -> float:
    """Median of the steps' times [µs], with a pause [s] before each."""
    times = []
    for _ in range(steps):
        if pause:
            time.sleep(pause)
        began = time.perf_counter_ns()
        controller.step()
        times.append(time.perf_counter_ns() - began)
    return float(np.median(times)) / 1e3


def _random(folder: Path, count: int) -> Iterator[Promise]:
    """Random motions of a bar by a lift and by a robot with a waist, and the same at fixed heights."""
    rng = np.random.default_rng(11)
    unfinished = wrong = certified = lost = fixed_ones = moving_ones = 0
    apart = 0.0
    heights = np.linspace(0.05, 0.55, 5)
    for number in range(count):
        _say(f"random motion {number + 1} of {count}")
        lift = number % 2 == 0
        if lift:
            cell, grasp, file = _lift_cell()
            start = np.array([rng.uniform(0.4, 0.65), rng.uniform(-0.15, 0.15), rng.uniform(0.2, 0.6)])
            way = rng.uniform(-1.0, 1.0, 3) * [0.1, 0.15, 0.0] + [0.0, 0.0, rng.uniform(0.9, 1.5)]
        else:
            cell, grasp, file = _torso_cell(TORSOS[1], folder)
            start = np.array([rng.uniform(0.4, 0.6), rng.uniform(-0.1, 0.1), rng.uniform(0.6, 0.9)])
            way = rng.uniform(-1.0, 1.0, 3) * [0.15, 0.3, 0.4]
        turn = pin.exp3(rng.uniform(-0.3, 0.3, 3))
        path = LinePath(pin.SE3(np.eye(3), start), pin.SE3(turn, start + way), duration=6.0)
        check = check_path(cell, grasp, path)
        good = check.feasible
        if lift:
            some = any(check_path(*_lift_cell(**_at(h))[:2], path).feasible for h in heights.tolist())
            fixed_ones, moving_ones = fixed_ones + some, moving_ones + good
            lost += some and not good
        if good:
            certified += 1
            whole = _Whole(cell, grasp, file)
            wrong += whole.errors(check, 60)
            run = _followed(check)
            unfinished += not run.finished
            apart = max(apart, whole.run(run)[0])
    yield Promise(
        f"random motions of a bar ({count}): proved at a fixed height, not with the lift", lost, 0.0, "motions"
    )
    ratio = fixed_ones / max(moving_ones, 1)
    yield Promise(
        f"the same ({fixed_ones} : {moving_ones}): proved at fixed heights over with it", ratio, 1.0 / 1.2, ""
    )
    yield Promise(f"the same, {certified} certified: samples that break what is proved", wrong, 0.0, "samples")
    yield Promise(f"the same, {certified} certified: runs that do not finish", unfinished, 0.0, "runs")
    yield Promise(f"the same, {certified} certified: chain", apart, 1.0, "µm")


def _at(height: float) -> dict[str, dict[str, float]]:
    """Limits that hold the lift at a height."""
    return {"lower_limits": {"lift": height - 1e-6}, "upper_limits": {"lift": height + 1e-6}}
