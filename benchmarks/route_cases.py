"""Problems of routes.py: the straight way is blocked in each, and a way round exists but for the walls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin

from coopqp import CollisionScene, Grasp, LinePath, RobotCell, inverse_kinematics
from coopqp.collision import Body, Box, Capsule
from coopqp.scenarios import Scenario, panda_bar, paper_lift, random_posts, ring, robot_arm
from coopqp.spatial import Array

#: Acceleration limit of joints without one, for the duration of a way [rad/s²].
ACCELERATION = 5.0

_NO_TURN = np.eye(3)


class Problem(NamedTuple):
    """A search: arms that hold an object, its poses at start and goal, the bodies, and the start (nq,)."""

    cell: RobotCell
    grasp: Grasp
    start: pin.SE3
    goal: pin.SE3
    scene: CollisionScene
    q_start: Array


def at(p: Sequence[float], R: Array = _NO_TURN) -> pin.SE3:
    return pin.SE3(R, np.array(p, dtype=float))


def _problem(
    task: Scenario, start: pin.SE3, goal: pin.SE3, obstacles: Sequence[Body], carried: Sequence[Body] | None = None
) -> Problem:
    arms = [
        arm if np.isfinite(arm.limits.acceleration).all() else arm.with_limits(acceleration=ACCELERATION)
        for arm in task.cell.arms
    ]
    task = replace(task, cell=RobotCell(arms))
    more = {} if carried is None else {"carried": carried}
    scene = CollisionScene.of(task, obstacles=obstacles, **more)
    q_start = inverse_kinematics(task.cell, task.grasp, start, task.q_start)
    return Problem(task.cell, task.grasp, start, goal, scene, q_start)


def posts3() -> Problem:
    """Three RX-90L carry the paper's plate past two posts."""
    task = paper_lift()
    R = task.path.pose(0.0).rotation
    posts = [Body(f"post_{i}", Capsule(0.04, 0.5), at((x, 0.28, 0.02))) for i, x in ((1, 1.35), (2, 2.3))]
    return _problem(task, at((0.9, -0.2, 0.10), R), at((0.9, 0.2, 0.35), R), posts)


def _bar(obstacles: Sequence[Body]) -> Problem:
    """Two Pandas carry a bar of 1 m across."""
    return _problem(panda_bar(), at((0.0, -0.3, 0.3)), at((0.0, 0.3, 0.3)), obstacles)


def pillar() -> Problem:
    """A bar over a pillar."""
    return _bar([Body("pillar", Capsule(0.05, 0.6), at((0.0, 0.0, 0.15)))])


def _beams(sill: pin.SE3, lintel: pin.SE3) -> list[Body]:
    size = Box((0.3, 0.08, 0.6))
    return [Body("sill", size, sill), Body("lintel", size, lintel)]


def window() -> Problem:
    """A bar between two beams."""
    return _bar(_beams(at((0.0, 0.0, 0.15)), at((0.0, 0.0, 0.86))))


def slot() -> Problem:
    """A bar through a tilted slot with 7 mm to spare a side."""
    P = at((0.0, 0.0, 0.45), pin.utils.rotate("y", 0.25))
    return _bar(_beams(P * at((0.0, 0.0, -0.34)), P * at((0.0, 0.0, 0.34))))


def wall() -> Problem:
    """A wall without an opening: there is no way."""
    return _bar([Body("wall", Box((0.3, 0.08, 2.4)), at((0.0, 0.0, 0.6)))])


def peg(arms: int = 4) -> Problem:
    """Arms of a ring lower a frame of four beams over a turned block; frame and block grow with the ring."""
    task = ring(arms=arms)
    k = max(1.0, arms * 0.5 / (2.0 * np.pi) / 0.5)
    beams = [
        ((0.6, 0.1), (0.0, 0.25)),
        ((0.6, 0.1), (0.0, -0.25)),
        ((0.1, 0.4), (0.25, 0.0)),
        ((0.1, 0.4), (-0.25, 0.0)),
    ]
    carried = [Body("object", Box((k * a, k * b, 0.05)), at((k * x, k * y, 0.0))) for (a, b), (x, y) in beams]
    R = pin.utils.rotate("z", float(np.deg2rad(12.0)))
    block = Body("block", Box((0.4 * k - 0.06, 0.4 * k - 0.06, 0.4)), at((0.0, 0.0, 0.02), R))
    return _problem(task, at((-0.12, -0.08, 0.32)), at((0.0, 0.0, 0.16), R), [block], carried)


def two_ur10() -> tuple[RobotCell, Grasp, Array]:
    """Two UR10 that face each other 2.3 m apart and hold a bar at ±0.4 m, and positions near a start, elbows up."""
    forward_sideways = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    arms, tools = [], []
    for name, side, yaw in (("left", -1.0, 0.0), ("right", 1.0, np.pi)):
        turn = pin.utils.rotate("z", yaw)
        arms.append(robot_arm("ur10", name=name, T_world_base=at((side * 1.15, 0.0, 0.0), turn)))
        tools.append(at((side * 0.4, 0.0, 0.0), turn @ forward_sideways))
    return RobotCell(arms), Grasp(tuple(tools)), np.deg2rad(np.tile([-15.1, -86.1, 103.6, -17.6, 74.9, 0.0], 2))


def shelf() -> Problem:
    """Two UR10 take a bar from under a board to above it."""
    cell, grasp, near = two_ur10()
    start = at((0.0, 0.25, 0.48))
    path = LinePath(start, at((0.0, 0.3, 0.80)), duration=3.0)
    task = Scenario("two_ur10", cell, grasp, path, near, 0.002, object_size=(0.8, 0.06, 0.06), object_mass=3.0)
    return _problem(task, start, path.goal, [Body("board", Box((0.5, 0.5, 0.03)), at((0.0, 0.3, 0.64)))])


#: Problems by name.
PROBLEMS: dict[str, Callable[[], Problem]] = {
    "posts3": posts3,
    "pillar": pillar,
    "window": window,
    "shelf": shelf,
    "peg": peg,
    "slot": slot,
    "peg8": lambda: peg(8),
}


def random_scene(seed: int) -> Problem:
    """Two to eight arms among three random posts, and a random goal: there may be no way, or a straight one."""
    arms = (2, 3, 4)[seed % 3]
    task = random_posts(seed, arms=arms, posts=3)
    rng = np.random.default_rng(seed)
    start = task.path.pose(0.0)
    goal = pin.SE3(start.rotation @ pin.exp3(rng.uniform(-0.3, 0.3, 3)), start.translation + rng.uniform(-0.2, 0.2, 3))
    return _problem(task, start, goal, task.obstacles)


def impossible() -> dict[str, Problem]:
    """Goals that are impossible: inside a body, and out of reach; and a start inside a margin."""
    inside = pillar()
    far = posts3()
    block = Body("block", Box((0.1, 0.1, 0.1)), inside.start)
    return {
        "goal inside the pillar": inside._replace(goal=at((0.0, 0.0, 0.3))),
        "goal out of reach": far._replace(goal=far.goal * at((0.0, 0.0, 2.0))),
        "start inside a block": inside._replace(
            scene=CollisionScene(cell=inside.cell, grasp=inside.grasp, carried=inside.scene.carried, obstacles=[block])
        ),
    }
