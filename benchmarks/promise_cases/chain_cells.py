"""Random cells and motions for promises about the chain, and an oracle that knows Pinocchio and nothing of coopqp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp import Arm, ControlStep, Grasp, LinePath, ObjectPath, RobotCell, Status
from coopqp.scenarios import robot_arm
from coopqp.spatial import Array

SE3 = pin.SE3


@dataclass(frozen=True, eq=False)
class Task:
    """A cell at the start of a motion."""

    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    q: Array


def near(rng: np.random.Generator, reach: float, turn: float) -> pin.SE3:
    """A random placement up to a distance [m] and an angle [rad] away."""
    way, axis = rng.normal(size=3), rng.normal(size=3)
    way *= rng.uniform(0.3, 1.0) * reach / np.linalg.norm(way)
    axis *= rng.uniform(0.3, 1.0) * turn / np.linalg.norm(axis)
    return SE3(pin.exp3(axis), way)


def random_model(rng: np.random.Generator, joints: int) -> pin.Model:
    """A serial arm: each axis leans at random against the one before; one joint in five slides, the first never."""
    model, parent = pin.Model(), 0
    place = SE3(np.eye(3), np.array([0.0, 0.0, rng.uniform(0.1, 0.3)]))
    for j in range(joints):
        slides = j > 0 and rng.random() < 0.2
        joint = pin.JointModelPZ() if slides else pin.JointModelRZ()
        bound = 1.0 if slides else 3.0
        one = np.ones(1)
        parent = model.addJoint(parent, joint, place, f"j{j}", 100.0 * one, 2.0 * one, -bound * one, bound * one)
        turn = pin.rpy.rpyToMatrix(*rng.choice([-0.5, 0.0, 0.5], 3) * np.pi)
        place = SE3(turn, rng.uniform(0.1, 0.3) * turn[:, 2] + rng.uniform(-0.05, 0.05, 3))
    model.addFrame(pin.Frame("tool", parent, 0, place, pin.FrameType.OP_FRAME))
    return model


def smallest(cell: RobotCell, models: list[pin.Model], q: Array) -> float:
    """Smallest singular value of the arms' tool Jacobians."""
    least = []
    for model, own in zip(models, cell.q_slices, strict=True):
        data = model.createData()
        J = pin.computeFrameJacobian(model, data, q[own], model.getFrameId("tool"), pin.LOCAL)
        least.append(np.linalg.svd(J, compute_uv=False)[-1])
    return float(min(least))


def few_joints(seed: int, acceleration: float | None) -> Task:
    """Two or three arms, most of them with four or five joints, and a line that they cannot all follow."""
    rng = np.random.default_rng(seed)
    sizes = [int(rng.choice([4, 5])), *rng.choice([4, 5, 5, 6], rng.integers(1, 3)).tolist()]
    while True:
        models = [random_model(rng, n) for n in sizes]
        arms, grips, qs = [], [], []
        T_world_object = near(rng, 0.6, 1.0)
        for k, model in enumerate(models):
            q = np.array([rng.uniform(0.4 * lo, 0.4 * hi) for lo, hi in zip(
                model.lowerPositionLimit, model.upperPositionLimit, strict=True)])  # fmt: skip
            data = model.createData()
            pin.framesForwardKinematics(model, data, q)
            grip = near(rng, 0.25, 1.5)
            base = T_world_object * grip * data.oMf[model.getFrameId("tool")].inverse()
            limit = None if acceleration is None else np.full(model.nv, acceleration)
            arms.append(Arm.from_model(
                f"arm{k}", model, tool_frame="tool", T_world_base=base, acceleration_limits=limit))  # fmt: skip
            grips.append(grip)
            qs.append(q)
        cell, start = RobotCell(arms), np.concatenate(qs)
        if smallest(cell, models, start) > 0.05:
            break
    away = near(rng, 0.12, 0.4)
    path = LinePath.displaced(
        T_world_object, translation=away.translation, rotation=pin.log3(away.rotation), duration=rng.uniform(1.0, 2.0),
        time_law=str(rng.choice(["quintic", "linear"])),
    )  # fmt: skip
    return Task(cell, Grasp(tuple(grips)), path, start)


class Oracle:
    """Distance of the arms' views of the object, from each arm's own model."""

    def __init__(self, cell: RobotCell, grasp: Grasp) -> None:
        self._arms = []
        for arm, X, own in zip(cell.arms, grasp.T_object_tool, cell.q_slices, strict=True):
            frame = arm.model.getFrameId(arm.tool_frame)
            self._arms.append((arm.model, arm.model.createData(), frame, arm.T_world_base, X.inverse(), own))

    def points(self, q: Array) -> list[Array]:
        """The object's origin as each arm carries it [m]."""
        found = []
        for model, data, frame, base, to_object, own in self._arms:
            pin.framesForwardKinematics(model, data, q[own])
            found.append((base * data.oMf[frame] * to_object).translation)
        return found

    def apart(self, q: Array) -> float:
        """The largest distance of two of them [m]."""
        points = self.points(q)
        return max(float(np.linalg.norm(a - b)) for a in points for b in points)


@dataclass
class Run:
    """A run: the largest distance [m], the same outside of holds that name the commanded chain, and statuses."""

    apart: float
    unnamed: float
    statuses: dict[str, int]


def run(
    controller: object, task: Task, steps: int, every: int = 1, on: Callable[[ControlStep], None] | None = None
) -> Run:
    """Step until the path ends, or so often."""
    oracle = Oracle(task.cell, task.grasp)
    statuses: dict[str, int] = {}
    apart = unnamed = 0.0
    controller.reset(task.q)  # type: ignore[attr-defined]
    for i in range(steps):
        step = controller.step()  # type: ignore[attr-defined]
        statuses[step.status.value] = statuses.get(step.status.value, 0) + 1
        if i % every == 0 or step.finished:
            now = oracle.apart(step.q_next)
            apart = max(apart, now)
            if step.status is not Status.HOLDING or "commanded" not in (step.cause.value if step.cause else ""):
                unnamed = max(unnamed, now)
        if on is not None:
            on(step)
        if step.finished:
            break
    return Run(apart, unnamed, statuses)


#: Six- and seven-joint robots, and joints that stretch them out or bring two axes of the wrist in line at these angles.
ROBOTS = ("rx90l", "arm7", "irb1600", "kr16_2", "ur3_limited", "ur10_limited", "panda")
SINGULAR = {
    "rx90l": {2: np.pi / 2, 4: 0.0}, "irb1600": {4: 0.0}, "kr16_2": {4: 0.0}, "ur3_limited": {2: 0.0, 4: 0.0},
    "ur10_limited": {2: 0.0, 4: 0.0},
}  # fmt: skip


def long_steps(seed: int, robots: tuple[str, ...] = (), duration: float | None = None) -> Task:
    """Two or three robots, and a line of 0.1 to 0.3 m; in half of the cells an arm starts near a singularity."""
    rng = np.random.default_rng(seed)
    names = robots or tuple(str(x) for x in rng.choice(ROBOTS, rng.integers(2, 4)))
    T_world_object = near(rng, 0.6, 1.0)
    arms, grips, qs = [], [], []
    for k, name in enumerate(names):
        arm = robot_arm(name, name=f"arm{k}", geometry=False)
        low, high = (np.clip(x, -2.5, 2.5) for x in (arm.limits.lower, arm.limits.upper))
        q = rng.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)
        if k == 0 and rng.random() < 0.5 and name in SINGULAR:
            joint, at = list(SINGULAR[name].items())[rng.integers(len(SINGULAR[name]))]
            q[joint] = at + rng.uniform(0.02, 0.1) * rng.choice([-1.0, 1.0])
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, q)
        grip = near(rng, 0.25, 1.5)
        arms.append(
            arm.placed(T_world_object * grip * data.oMf[arm.model.getFrameId(arm.tool_frame)].inverse(), name=arm.name)
        )
        grips.append(grip)
        qs.append(q)
    away = near(rng, 0.3, 0.5)
    path = LinePath.displaced(
        T_world_object, translation=away.translation, rotation=pin.log3(away.rotation),
        duration=duration or rng.uniform(0.8, 2.0), time_law=str(rng.choice(["quintic", "linear"])),
    )  # fmt: skip
    return Task(RobotCell(arms), Grasp(tuple(grips)), path, np.concatenate(qs))
