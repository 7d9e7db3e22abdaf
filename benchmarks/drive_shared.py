"""Cases of ``drive.py`` with robots whose arms share joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from drive_runs import DT, Row, drive, halt, kill, limit, release, resume, time_of

from coopqp import Arm, Grasp, Robot, RobotCell
from coopqp.drivers.robots import driven_joints
from coopqp.model.state import CellState
from coopqp.paths.path import LinePath
from coopqp.paths.scenario import Scenario
from coopqp.planning import check_path
from coopqp.scenarios import dual_arm7, robot_path, torso_lift, two_on_a_rail
from coopqp.spatial import Array


def _led(scenario: Scenario) -> Scenario:
    """The scenario along the motion of its shared joints that is proved."""
    s = scenario
    return replace(s, path=check_path(s.cell, s.grasp, s.path, q_start=s.q_start).led_path())


def _tower(duration: float = 14.0) -> Scenario:
    """A lift with two arms, and an arm beside it, raise a bar by 1.4 m at up to 0.19 m/s."""
    tools, limits = {side: f"{side}_tool" for side in ("left", "right")}, {"acceleration_limits": 10.0}
    faces = pin.SE3(pin.utils.rotate("z", np.pi), np.array([1.65, 0.0, 0.4]))
    east = Arm.from_urdf("east", robot_path("kr16_2"), tool_frame="flange", T_world_base=faces, **limits)  # type: ignore[arg-type]
    cell = RobotCell([Robot(robot_path("lift2"), tools, name="tower", **limits), east])  # type: ignore[arg-type]
    placed = ((90, 0, 0.0, 0.3), (-90, 0, 0.0, -0.3), (0, -90, 0.05, 0.0))
    grasp = Grasp(
        tuple(pin.SE3(pin.rpy.rpyToMatrix(*np.deg2rad([r, p, 0.0])), np.array([x, y, 0.0])) for r, p, x, y in placed)
    )
    start = pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.2]))
    path = LinePath.displaced(start, translation=(0.0, 0.0, 1.4), duration=duration)
    check = check_path(cell, grasp, path)
    assert check.q_start is not None
    return Scenario("tower", cell, grasp, check.led_path(), check.q_start, dt=DT)


def _by_urdf(urdf: str, scenario: Scenario, rows: Array) -> Array:
    """Distance between the tools from what the object makes of them, by one Pinocchio model of the URDF (T,) [m]."""
    model = pin.buildModelFromUrdf(str(robot_path(urdf)))
    data = model.createData()
    left, right = scenario.grasp.T_object_tool
    joints = [model.joints[model.getJointId(name.partition("/")[2])] for name in scenario.cell.joint_names]
    found = []
    for x in rows:
        q = pin.neutral(model)
        for joint, value in zip(joints, x, strict=True):
            turns = joint.nq == 2  # a continuous joint
            q[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if turns else value
        pin.framesForwardKinematics(model, data, q)
        a, b = (data.oMf[model.getFrameId(f"{side}_tool")] for side in ("left", "right"))
        found.append(np.linalg.norm(((a * left.inverse() * right).inverse() * b).translation))
    return np.array(found)


def shared_joints() -> Iterator[Row]:
    """Robots with shared joints: a lift and a rail with two arms each as one robot."""
    alone = dual_arm7()
    alone = replace(alone, cell=alone.cell.with_limits(acceleration=10.0))
    for name, urdf, s in (
        ("one robot, two arms on a lift", "lift2", _led(torso_lift())),
        ("one robot, two arms on a rail", "rail2", _led(two_on_a_rail())),
        ("beside them, two arms on their own", "", alone),
    ):
        run = drive((0.040,) * len(driven_joints(s.cell)), told=False, scenario=s)
        yield Row(f"{name}, lag 40 ms learnt: time", time_of(run), s.path.duration + 0.2, "s")
        apart = 1e3 * (_by_urdf(urdf, s, run.q[::5]) if urdf else run.apart())
        yield Row(f"{name}, lag 40 ms learnt: apart, median", float(np.median(apart)), 0.03, "mm")
        yield Row(f"{name}, lag 40 ms learnt: apart", float(apart.max()), 0.5, "mm")


def beside_a_lift() -> Iterator[Row]:
    """A lift with two arms as one robot, and an arm beside it: slower than told, stopped, killed."""
    s, name = _tower(), "two arms on a lift and an arm beside it"
    free = drive((0.007, 0.047), told=False, scenario=s)
    yield Row(f"{name}, lags 7, 47 ms learnt: time", time_of(free), s.path.duration + 0.2, "s")
    yield Row(f"{name}, lags 7, 47 ms learnt: apart", 1e3 * float(free.apart().max()), 0.5, "mm")
    middle = 0.45 * s.path.duration
    for k, (robot, own) in enumerate(driven_joints(s.cell).items()):
        peak = float(np.linalg.norm(np.diff(free.q[:, own], axis=0), axis=1).max()) / DT
        events = [(middle, limit(k, 0.5 * peak)), (middle + 1.5, limit(k, None))]
        run = drive((0.0, 0.0), scenario=s, events=events)
        yield Row(f"{name}, {robot} at 50 %: time", time_of(run), s.path.duration + 0.9, "s")
        yield Row(f"{name}, {robot} at 50 %: apart", 1e3 * float(run.apart().max()), 2.5, "mm")
        at = int(np.searchsorted(free.time, middle))
        moves = (free.sent[at + 1] - free.sent[at]) / DT
        state = CellState(s.cell, s.cell.configuration_of(free.q[at]))
        v = max(float(np.linalg.norm(state.jacobian(i)[:3] @ moves[of])) for i, of in enumerate(s.cell.columns))
        braking = 0.5 * v * float((np.abs(moves) / s.cell.limits.acceleration).max())
        events = [(middle, halt(k)), (middle + 2.0, release(k)), (middle + 2.2, resume)]
        run = drive((0.0, 0.0), scenario=s, events=events)
        yield Row(
            f"{name}, {robot} stops for 2 s: apart", 1e3 * float(run.apart().max()), 1e3 * (braking + 0.001), "mm"
        )
        stands = (run.time[::5] >= middle + 0.5) & (run.time[::5] < middle + 2.0)
        settled = float(run.apart()[stands].max()) if run.report.finished else np.nan
        yield Row(f"{name}, {robot} stops for 2 s: apart after 0.5 s", 1e3 * settled, 0.3, "mm")
        run = drive((0.0, 0.0), scenario=s, events=[(middle, kill(k))])
        held = float(run.time[np.argmax(run.holding)]) - middle
        yield Row(f"{name}, {robot} is killed: HOLDING after", 1e3 * held, 15.0, "ms")
