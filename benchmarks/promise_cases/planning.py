"""Plans of redundant arms whose elbows have to evade bodies, and their runs beside them.

The oracle asks Pinocchio and coal for the distances of the arms' own shapes from the bodies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp import (
    Arm,
    Clearance,
    CollisionScene,
    CoopqpError,
    Grasp,
    ObjectPath,
    QPController,
    RobotCell,
    WaypointPath,
    check_path,
    plan,
)
from coopqp.collision import Body, Sphere
from coopqp.planning import PathVerdict
from coopqp.scenarios import ROBOTS, robot_path
from promise_cases import Promise

Array = NDArray[np.float64]

_DT, _MARGIN = 0.002, 0.02
#: Bodies are no nearer than this at the start [m]; distances are asked every so many steps.
_CLEAR, _EVERY = 0.04, 10


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    yield from _evading(1 if quick else 30)


@dataclass(frozen=True)
class _Cell:
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    q: Array
    posts: list[tuple[float, Array]]  #: radius and centre of each
    scene: CollisionScene


def _evading(count: int) -> Iterator[Promise]:
    """Random cells in which a plan's elbows move otherwise than they would without bodies."""
    ran, seed, slowed, unlike, nearest = 0, 0, 0, 0, np.inf
    while ran < count:
        seed += 1
        try:
            task = random_cell(np.random.default_rng([77, seed]))
            check = check_path(task.cell, task.grasp, task.path, q_start=task.q, scene=task.scene)
            if not check.feasible:
                continue
            least = plan(task.cell, task.grasp, task.path, q_start=task.q).path
        except CoopqpError:
            continue
        try:
            made = plan(task.cell, task.grasp, task.path, q_start=task.q, scene=task.scene)
        except CoopqpError:
            ran, unlike = ran + 1, unlike + 1
            continue
        if made.path.keeps_clear and abs(made.path.duration - least.duration) < 1e-9:
            continue  # nothing is in the way
        ran += 1
        unlike += made.check is None or made.check.verdict is not PathVerdict.CERTIFIED
        rate, near = _run(task, made.path)
        slowed += rate < 1.0 - 1e-9
        nearest = min(nearest, near)
    yield Promise(f"plans whose elbows evade: not the verdict of the check, of {ran}", unlike, 0, "plans")
    yield Promise(f"plans whose elbows evade: slowed when run, of {ran}", slowed, 0, "plans")
    yield Promise("the same: how far inside the margin an arm comes to a body", 1e3 * (_MARGIN - nearest), 0, "mm")


def _run(task: _Cell, path: ObjectPath) -> tuple[float, float]:
    """The least rate of a run, and the least distance [m]; 0 where it does not finish."""
    controller = QPController(task.cell, task.grasp, path, dt=_DT, constraints=[Clearance(task.scene)])
    controller.reset(task.q)
    judge = _Distances(task)
    rate, near = 1.0, np.inf
    for i in range(round(3.0 * path.duration / _DT)):
        step = controller.step()
        rate = min(rate, step.rate)
        if i % _EVERY == 0:
            near = min(near, judge.least(step.q_next))
        if step.finished:
            return rate, near
    return 0.0, near


class _Distances:
    """Distances of the arms' links from the bodies, but for the pairs that the scene leaves out."""

    def __init__(self, task: _Cell) -> None:
        self._model, self._data = task.cell.model, task.cell.model.createData()
        geometry = task.cell.collision_model()
        geometry.removeAllCollisionPairs()
        left_out = {frozenset(pair) for pair in task.scene.ignored}
        links = [
            (k, str(self._model.frames[shape.parentFrame].name))
            for k, shape in enumerate(geometry.geometryObjects)
            if shape.parentJoint > 0
        ]
        for i, (radius, centre) in enumerate(task.posts):
            ball = pin.GeometryObject(f"post_{i}", 0, pin.SE3(np.eye(3), centre), coal.Sphere(radius))
            index = geometry.addGeometryObject(ball)
            for k, name in links:
                if frozenset((name, f"post_{i}")) not in left_out:
                    geometry.addCollisionPair(pin.CollisionPair(k, index))
        self._geometry, self._placed = geometry, geometry.createData()

    def least(self, q: Array) -> float:
        """The least distance at a configuration [m]."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)
        pin.computeDistances(self._geometry, self._placed)
        return float(min(result.min_distance for result in self._placed.distanceResults))


def random_cell(rng: np.random.Generator) -> _Cell:
    """One to three redundant arms, one or two lines, and spheres beside the arms."""
    arms, tools, q = [], [], []
    origin = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.5, 0.5, 3))
    for k in range(int(rng.integers(1, 4))):
        robot = str(rng.choice(("arm7", "gantry7", "arm7")))
        arm = Arm.from_urdf(f"a{k}", robot_path(robot), tool_frame=ROBOTS[robot].tool_frame)
        low, high = np.maximum(arm.limits.lower, -2.0), np.minimum(arm.limits.upper, 2.0)
        q.append(rng.uniform(low + 0.15 * (high - low), high - 0.15 * (high - low)))
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, q[-1])
        X = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
        arms.append(arm.placed(origin * X * data.oMf[arm.model.getFrameId(arm.tool_frame)].inverse()))
        tools.append(X)
    way = rng.normal(size=3)
    way *= rng.uniform(0.1, 0.4) / np.linalg.norm(way)
    turn = pin.exp3(0.4 * rng.normal(size=3) * rng.integers(0, 2))
    poses = [origin, pin.SE3(origin.rotation @ turn, origin.translation + way)]
    if rng.random() < 0.4:
        poses.append(pin.SE3(poses[1].rotation, poses[1].translation + 0.15 * rng.normal(size=3)))
    cell = RobotCell(arms).with_limits(acceleration=float(rng.choice([5.0, 10.0, 20.0])))
    grasp, start = Grasp(tuple(tools)), np.concatenate(q)
    path = WaypointPath(poses, durations=[3.0] * (len(poses) - 1))
    posts, scene = beside(rng, cell, grasp, start)
    return _Cell(cell, grasp, path, start, posts, scene)


def beside(
    rng: np.random.Generator, cell: RobotCell, grasp: Grasp, q: Array
) -> tuple[list[tuple[float, Array]], CollisionScene]:
    """Up to 15 spheres near the links, clear of them at the start, and the scene without links that touch anyway."""
    geometry, data = cell.collision_model(), cell.model.createData()
    placed = geometry.createData()
    pin.updateGeometryPlacements(cell.model, data, geometry, placed, q)
    moving = [i for i, shape in enumerate(geometry.geometryObjects) if shape.parentJoint > 0]
    drawn = []
    for _ in range(40):
        at = placed.oMg[int(rng.choice(moving))].translation + 0.25 * rng.normal(size=3)
        drawn.append((float(rng.uniform(0.02, 0.06)), at))

    def scene_of(posts: list[tuple[float, Array]], ignored: list[tuple[str, str]]) -> CollisionScene:
        bodies = [Body(f"post_{i}", Sphere(r), pin.SE3(np.eye(3), at)) for i, (r, at) in enumerate(posts)]
        return CollisionScene(cell=cell, grasp=grasp, margin=_MARGIN, obstacles=bodies, ignored=ignored)

    near = {n for p in scene_of(drawn, []).distances(q) if p.distance < _CLEAR for n in (p.first, p.second)}
    posts = [post for i, post in enumerate(drawn) if f"post_{i}" not in near][: int(rng.integers(4, 16))]
    touch = [(p.first, p.second) for p in scene_of(posts, []).distances(q) if p.distance < _CLEAR]
    return posts, scene_of(posts, touch)
