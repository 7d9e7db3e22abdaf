"""Paths that are not known ahead, and arms that give way: all arms brake together.

Cells, lines and carts are random. What judges a run is Pinocchio's forward kinematics of each arm's own model, and for
distances Pinocchio's own collision query: nothing of the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import (
    Clearance,
    CollisionScene,
    ControlStep,
    Grasp,
    InvalidInputError,
    LinePath,
    ObjectPath,
    QPController,
    RobotCell,
    Status,
)
from coopqp.collision import Body, Box
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift, ring
from coopqp.spatial import Array
from promise_cases import Promise

#: Accelerations [rad/s² or m/s²] under which each case is run.
ACCELERATIONS = (5.0, 15.0, np.inf)
#: Steps of a path that is not known ahead, and the largest chain error [s], [m].
BLIND = ((0.001, 1e-6), (0.002, 1e-6), (0.008, 2e-5))
MARGIN = 0.02
#: Of the 60 carts: those that touched before there were rows that brake all arms together (2c39a1e8), by acceleration.
TOUCHED_BEFORE = {5.0: 16, 15.0: 9, np.inf: 10}
#: Of the 60 unknown paths where nothing binds: steps of 8 ms without these rows (2c37489a).
STEPS_WITHOUT = (
    109, 59, 122, 175, 63, 70, 66, 44, 144, 62, 73, 52, 54, 59, 89, 68, 112, 95, 69, 133, 39, 67, 44, 68, 84, 59, 71,
    66, 49, 71, 86, 123, 39, 90, 63, 60, 61, 42, 66, 168, 186, 57, 83, 86, 143, 117, 46, 47, 68, 117, 86, 70, 78, 100,
    119, 43, 74, 70, 57, 44,
)  # fmt: skip


class Unknown(ObjectPath):
    """A path that may not be asked ahead of the clock."""

    known_ahead = False

    def __init__(self, path: ObjectPath) -> None:
        self._path, self.duration = path, path.duration

    def pose(self, clock: float) -> pin.SE3:
        return self._path.pose(clock)

    def twist(self, clock: float) -> Array:
        return self._path.twist(clock)


class Oracle:
    """Where each arm holds the object, from its own model."""

    def __init__(self, cell: RobotCell, grasp: Grasp) -> None:
        self._arms = []
        for arm, X, part in zip(cell.arms, grasp.T_object_tool, cell.q_slices, strict=True):
            frame = arm.model.getFrameId(arm.tool_frame)
            self._arms.append((arm.model, arm.model.createData(), frame, arm.T_world_base, X.inverse(), part))

    def apart(self, q: Array) -> float:
        """Largest distance between the object's origins [m]."""
        origins = []
        for model, data, frame, base, held, part in self._arms:
            pin.framesForwardKinematics(model, data, q[part])
            origins.append((base * data.oMf[frame] * held).translation)
        return float(np.linalg.norm(np.array(origins) - origins[0], axis=1).max())


# -- paths that are not known ahead ------------------------------------------------------------------------------------

MAKERS: list[Callable[[], Scenario]] = [
    partial(ring, arms=2), dual_arm7, partial(ring, arms=3), mixed_cell, partial(ring, arms=2, robot="arm7"),
]  # fmt: skip


def line(number: int, acceleration: float, length: float) -> Scenario:
    """A random line of a length [m], at 0.1 to 0.5 m/s, turning."""
    rng = np.random.default_rng(4100 + number)
    task = MAKERS[number % len(MAKERS)]()
    way, turn = rng.normal(size=3), rng.normal(size=3)
    way *= length / np.linalg.norm(way)
    turn *= rng.uniform(0.0, 0.6) * length / np.linalg.norm(turn)
    path = LinePath.displaced(
        task.path.pose(0.0),
        translation=way,
        rotation=turn,
        duration=length / rng.uniform(0.1, 0.5),
        time_law="quintic" if number % 2 else "linear",
    )
    return replace(task, cell=task.cell.with_limits(acceleration=acceleration), path=path)


@dataclass(frozen=True)
class Blind:
    """A run along an unknown path: largest chain error [m], changes of status a second, end [s], finished."""

    chain: float
    changes: float
    time: float
    finished: bool


def blind(task: Scenario, dt: float) -> Blind:
    """Drive a path that is not known ahead until it ends, or for a time after the object has stopped."""
    controller = QPController(task.cell, task.grasp, Unknown(task.path), dt=dt)
    controller.reset(task.q_start)
    oracle, steps = Oracle(task.cell, task.grasp), list[ControlStep]()
    chain, still = 0.0, 0
    while len(steps) * dt < 3.0 * task.path.duration and still * dt < 1.0:
        step = controller.step()
        steps.append(step)
        chain = max(chain, oracle.apart(step.q_next))
        still = still + 1 if step.rate < 1e-3 else 0
        if step.finished:
            break
    changes = sum(a.status is not b.status for a, b in pairwise(steps))
    return Blind(chain, changes / max(len(steps) * dt, 1.0), len(steps) * dt, steps[-1].finished)


def unknown_paths(quick: bool) -> Iterator[Promise]:
    """Lines of 0.7 m: most end out of reach."""
    numbers = range(2 if quick else 16)
    for acceleration in ACCELERATIONS[::2] if quick else ACCELERATIONS:
        for dt, bound in BLIND[1:] if quick else BLIND:
            runs = [blind(line(i, acceleration, 0.7), dt) for i in numbers]
            case = f"unknown paths out of reach, {acceleration:g} rad/s², {1e3 * dt:g} ms"
            yield Promise(f"{case}: largest chain error", 1e6 * max(r.chain for r in runs), 1e6 * bound, "µm")
            yield Promise(f"{case}: changes of status", max(r.changes for r in runs), 2.0, "1/s")


def unhindered(quick: bool) -> Iterator[Promise]:
    """Lines of 0.15 m, all of which are finished: the time that the rows add."""
    dt, late = 0.008, []
    for number, steps in enumerate(STEPS_WITHOUT[:3] if quick else STEPS_WITHOUT):
        run = blind(line(number, ACCELERATIONS[number % 3], 0.15), dt)
        late.append(run.time / (steps * dt) - 1.0 if run.finished else np.inf)
    lost = float(np.quantile(late, 0.9))
    yield Promise("unknown paths where nothing binds: time lost, 90th percentile", lost, 0.02, "")


# -- arms that give way ------------------------------------------------------------------------------------------------

CART_MAKERS: list[Callable[[], Scenario]] = [
    partial(paper_lift, time_law="quintic"), partial(ring, arms=4), partial(ring, arms=2), dual_arm7,
    partial(ring, arms=2, robot="arm7"),
]  # fmt: skip


@dataclass(frozen=True)
class GaveWay:
    """A run beside a cart: largest chain error, least distance [m], steps in which the QP had no answer."""

    chain: float
    least: float
    held: int


def beside_cart(number: int, acceleration: float, *, dt: float = 0.004, rows: bool = True) -> GaveWay:
    """A cart that comes from a random side and goes on straight, through where the object was.

    ``rows`` is False for a controller without the rows that brake all arms together.
    """
    rng = np.random.default_rng(2000 + number)
    task = CART_MAKERS[number % len(CART_MAKERS)]()
    cell, middle = task.cell.with_limits(acceleration=acceleration), task.path.pose(0.0).translation
    while True:
        angle, speed, side = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.2, 0.45), rng.uniform(0.15, 0.3)
        way = np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.2, 0.2)])
        way /= np.linalg.norm(way)
        first = middle + np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.0, 0.3)]) - way
        cart = Body("cart", Box((side, side, side)), pin.SE3(np.eye(3), first))
        scene = CollisionScene.of(task, cell=cell, margin=MARGIN, moving=[cart])
        clearance = Clearance(scene, give_way=True)
        controller = QPController(cell, task.grasp, task.path, dt=dt, constraints=[clearance])
        try:
            controller.reset(task.q_start)
        except InvalidInputError:  # the cart begins inside an arm
            continue
        break
    if not rows:
        without_rows(controller)
    oracle, nearest = Oracle(cell, task.grasp), distance_to(scene)
    chain, least, held = 0.0, np.inf, 0
    for i in range(round(2.0 / speed / dt)):
        place = pin.SE3(np.eye(3), first + way * (speed * i * dt))
        clearance.move("cart", place, (*(way * speed), 0.0, 0.0, 0.0))
        step = controller.step()
        chain = max(chain, oracle.apart(step.q_next))
        held += step.status is Status.HOLDING and "QP" in step.reason  # others hold because bodies overlap
        if i % 10 == 0:
            least = min(least, nearest(step.q, place))
    return GaveWay(chain, least, held)


def without_rows(controller: QPController) -> None:
    """Switch off the rows that brake arms together while they give way, to compare with.

    No option does that, so this reaches into the loop.
    """
    loop: Any = controller._loop
    loop._memory.options.leaves_path = 0.0


def distance_to(scene: CollisionScene) -> Callable[[Array, pin.SE3], float]:
    """The least distance of the moving body from anything else, by Pinocchio's own queries [m]."""
    model, geometry = scene.cell.model, scene.built.geometry
    data, placed, (shape,) = model.createData(), geometry.createData(), scene.built.moving
    pairs = [k for k, pair in enumerate(geometry.collisionPairs) if shape in (pair.first, pair.second)]
    own = geometry.copy()

    def nearest(q: Array, place: pin.SE3) -> float:
        own.geometryObjects[shape].placement = place
        pin.updateGeometryPlacements(model, data, own, placed, q)
        placed.oMg[shape] = place
        return float(min(pin.computeDistance(own, placed, k).min_distance for k in pairs))

    return nearest


def giving_way(quick: bool) -> Iterator[Promise]:
    """Random carts: the chain, holds, and touches beside those before there were rows, and without them."""
    numbers = range(1 if quick else 60)
    for acceleration in ACCELERATIONS[:1] if quick else ACCELERATIONS:
        runs = [beside_cart(i, acceleration) for i in numbers]
        limited = np.isfinite(acceleration)  # else there are no rows
        without = [beside_cart(i, acceleration, rows=False) for i in numbers] if limited else runs
        case = f"give way to {len(runs)} carts, {acceleration:g} rad/s²"
        yield Promise(f"{case}: largest chain error", 1e3 * max(r.chain for r in runs), 0.1, "mm")
        yield Promise(f"{case}: steps HOLDING by the QP", sum(r.held for r in runs), 0.0, "")
        touched, touched_without = (sum(r.least <= 0.0 for r in some) for some in (runs, without))
        before = touched_without if quick else TOUCHED_BEFORE[acceleration]
        yield Promise(f"{case}: touched, {touched_without} without the rows", touched, before, "")
        inside = sum(r.least < MARGIN - 1e-3 for r in runs)
        yield Promise(f"{case}: margin not kept", inside, len(runs), "")


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    yield from unknown_paths(quick)
    yield from unhindered(quick)
    yield from giving_way(quick)
