"""Joints at their limits while the object rests or creeps: does a command shake a joint to and fro?

**The rule.** A joint's acceleration is at its bound where it is beyond 5 % of its limit. It changes sign where it goes
from beyond +5 % to beyond −5 % or back, whatever lies in between. Counted are the changes in the last second of a run
in which the object is BLOCKED, PAUSED or SLOWED to less than a tenth of its path speed throughout; a joint that brakes
and comes to rest makes one or two. Accelerations are the differences of what was commanded; nothing of the controller
judges them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp import ControlStep, Grasp, LinePath, QPController, Robot, RobotCell, Status
from coopqp.scenarios import robot_arm, robot_path
from coopqp.spatial import Array
from promise_cases import Promise
from promise_cases.chain_cells import Task, near

PERIODS = (0.001, 0.002, 0.004, 0.008, 0.01, 0.02, 0.04)
#: Share of a joint's acceleration limit beyond which it is at its bound, and of the path speed below which an object
#: creeps.
AT_BOUND, CREEPS = 0.05, 0.1
_SETTLES, _COUNTED = 3.0, 1.0  # [s]
_RESTS = (Status.BLOCKED, Status.PAUSED, Status.SLOWED)


def sign_changes(velocities: Array, limits: Array, dt: float) -> Array:
    """Sign changes of each joint's acceleration at its bound (nv,) along velocities (T, nv), by the rule above."""
    share = np.diff(velocities, axis=0) / (dt * limits)
    changes = np.zeros(share.shape[1], dtype=int)
    for j, column in enumerate(share.T):
        signs = np.sign(column[np.abs(column) > AT_BOUND])
        changes[j] = int((signs[1:] != signs[:-1]).sum())
    return changes


@dataclass(frozen=True)
class Shaken:
    """What came of a run: the most sign changes of a joint in its last second, the joint, and the statuses then.

    ``rests`` if the object rested or crept throughout that second.
    """

    changes: int
    joint: str
    statuses: frozenset[Status]
    rests: bool


def shaken(task: Task, dt: float, *, pause_at: float = np.inf, **options: object) -> Shaken:
    """Run until some seconds after the path should have ended; the operator pauses at a time [s]."""
    controller = QPController(task.cell, task.grasp, task.path, dt=dt, **options)  # type: ignore[arg-type]
    controller.reset(task.q)
    count = round(_COUNTED / dt)
    steps: list[ControlStep] = []
    for i in range(round((task.path.duration + _SETTLES) / dt)):
        if i * dt >= pause_at > (i - 1) * dt:
            controller.pause()
        steps.append(controller.step())
    last = steps[-count - 1 :]
    changes = sign_changes(np.array([step.velocity for step in last]), task.cell.limits.acceleration, dt)
    rests = all(step.status in _RESTS and step.rate < CREEPS for step in last)
    worst = int(changes.argmax())
    return Shaken(int(changes[worst]), task.cell.joint_names[worst], frozenset(s.status for s in last), rests)


def _pair(rng: np.random.Generator) -> tuple[RobotCell, Grasp, pin.SE3, Array]:
    """Two or three robots around an object; arms of seven joints often with the elbow in the arm's plane."""
    names = [str(x) for x in rng.choice(("arm7", "arm7", "panda", "rx90l", "irb1600"), rng.integers(2, 4))]
    T_world_object, arms, grips, qs = near(rng, 0.6, 1.0), [], [], []
    for k, name in enumerate(names):
        arm = robot_arm(name, name=f"arm{k}", geometry=False)
        low, high = (np.clip(x, -2.5, 2.5) for x in (arm.limits.lower, arm.limits.upper))
        q = rng.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)
        if name == "arm7" and rng.random() < 0.6:
            turn, lean, bent, wrist = (rng.uniform(*ends) for ends in ((-60, 60), (5, 45), (60, 110), (20, 60)))
            q = np.deg2rad([turn, lean, 0.0, bent, 0.0, wrist, 0.0])
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, q)
        grip = near(rng, 0.25, 1.5)
        held = T_world_object * grip * data.oMf[arm.model.getFrameId(arm.tool_frame)].inverse()
        arms.append(arm.placed(held, name=arm.name))
        grips.append(grip)
        qs.append(q)
    return RobotCell(arms), Grasp(tuple(grips)), T_world_object, np.concatenate(qs)


def _shared(rng: np.random.Generator) -> tuple[RobotCell, Grasp, pin.SE3, Array]:
    """Two arms on a lift, or on a rail, which is slow in most cells."""
    robot, joint = (("lift2", "lift"), ("rail2", "rail"))[rng.integers(2)]
    speeds = {joint: float(np.exp(rng.uniform(np.log(0.003), np.log(0.3))))}
    tools = {side: f"{side}_tool" for side in ("left", "right")}
    made = Robot(
        robot_path(robot), tools, name=robot, geometry=False, acceleration_limits=5.0, velocity_limits=speeds
    )  # fmt: skip
    cell = RobotCell([made])
    low, high = (np.clip(x, -2.0, 2.0) for x in (cell.limits.lower, cell.limits.upper))
    q = cell.configuration(rng.uniform(0.7 * low + 0.3 * high, 0.3 * low + 0.7 * high))
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, q)
    placed = [data.oMf[frame].copy() for frame in cell.tool_frames]
    start = pin.SE3(np.eye(3), np.mean([T.translation for T in placed], axis=0))
    return cell, Grasp(tuple(start.inverse() * T for T in placed)), start, q


def cell_at_limits(seed: int) -> tuple[Task, float, float]:
    """A random cell whose joints are near, at or up to 2 mrad outside their limits; a period, and when it is paused."""
    rng = np.random.default_rng(seed)
    cell, grasp, start, q = (_shared if seed % 3 == 2 else _pair)(rng)
    x, lower, upper = cell.positions(q), cell.limits.lower.copy(), cell.limits.upper.copy()
    for j in rng.choice(cell.nv, rng.integers(1, 4), replace=False).tolist():
        room = (-rng.uniform(0.0, 0.002), 0.0, rng.uniform(0.0, 0.05))[rng.integers(3)]
        if rng.random() < 0.5:
            upper[j] = x[j] + room
        else:
            lower[j] = x[j] - room
    cell = cell.with_limits(lower=lower, upper=upper, acceleration=float(rng.choice([2.0, 5.0, 10.0, 30.0])))
    away = near(rng, 0.4, 2.0)
    path = LinePath.displaced(
        start, translation=away.translation, rotation=pin.log3(away.rotation), duration=float(rng.uniform(1.0, 3.0)),
        time_law=str(rng.choice(["quintic", "linear"])),
    )  # fmt: skip
    pause_at = float(rng.uniform(0.0, path.duration)) if rng.random() < 0.25 else np.inf
    return Task(cell, grasp, path, q), float(rng.choice(PERIODS)), pause_at


def promises(quick: bool) -> Iterator[Promise]:
    """See :mod:`promise_cases`."""
    count = 12 if quick else 300
    found = [shaken(task, dt, pause_at=pause_at) for task, dt, pause_at in map(cell_at_limits, range(count))]
    resting = [run for run in found if run.rests]
    shaking = sum(run.changes > 2 for run in resting)
    yield Promise(
        f"{count} cells at limits, {len(resting)} at rest or creeping: joints that shake", shaking, 0, "cells"
    )
    worst = max((run.changes for run in resting), default=0)
    yield Promise("the same: sign changes of an acceleration at its bound in the last second", worst, 2, "")
