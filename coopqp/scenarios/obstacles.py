"""Scenarios with something in the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.errors import UnknownNameError
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.model.shapes import Body, Box, Capsule, Shape, Sphere
from coopqp.paths.path import LinePath
from coopqp.paths.scenario import Scenario
from coopqp.scenarios.cells import dual_arm7, mixed_cell, ring
from coopqp.scenarios.paper import paper_lift
from coopqp.scenarios.stations import Station, moved, put_together
from coopqp.scenarios.units import Radians, Seconds
from coopqp.spatial import Array


def plate_and_post(*, post: Literal["capsule", "box"] = "capsule", duration: Seconds = 3.0) -> Scenario:
    """Three RX-90L lift the paper's plate towards a post that hangs above it: the plate has to stop below it.

    Args:
        post: shape of the post.
        duration: duration of the path [s].

    Raises:
        UnknownNameError: another shape.
    """
    shapes: dict[str, Shape] = {"capsule": Capsule(0.05, 0.30), "box": Box((0.10, 0.08, 0.40))}
    if post not in shapes:
        raise UnknownNameError("post", str(post), shapes, "plate_and_post")
    lift = paper_lift(duration=duration, time_law="quintic")
    middle = (lift.path.pose(0.0) * lift.T_object_body).translation
    T = pin.SE3(pin.utils.rotate("y", 0.15), middle + np.array([0.0, 0.1, 0.42]))
    return replace(lift, name="plate_and_post", obstacles=(Body("post", shapes[post], T),))


def plate_and_table(*, tilt: Radians = 0.0, duration: Seconds = 3.0) -> Scenario:
    """Three RX-90L put the paper's plate down where a table is too high: the plate has to stop above it.

    Args:
        tilt: turn of the table about the x axis [rad].
        duration: duration of the path [s].
    """
    lift = paper_lift()
    low = lift.path.pose(0.0)
    top = pin.SE3(low.rotation, low.translation + np.array([0.0, 0.0, 0.2]))
    q_top = inverse_kinematics(lift.cell, lift.grasp, top, lift.q_start)
    path = LinePath.displaced(top, translation=(0.0, 0.0, -0.2), duration=duration)
    middle = (low * lift.T_object_body).translation
    T_table = pin.SE3(pin.utils.rotate("x", tilt), middle + np.array([0.0, 0.0, 0.03]))
    table = Body("table", Box((0.5, 0.5, 0.05)), T_table)
    return replace(lift, name="plate_and_table", path=path, q_start=q_top, obstacles=(table,))


def elbow_and_knob(*, duration: Seconds = 3.0) -> Scenario:
    """Two seven-joint arms move a bar past a knob at the side of an elbow, which evades it.

    Args:
        duration: duration of the path [s].
    """
    pair = dual_arm7(duration=duration)
    knob = Body("knob", Sphere(0.03), pin.SE3(np.eye(3), np.array([-0.69, -0.118, 0.60])))
    return replace(pair, name="elbow_and_knob", obstacles=(knob,))


def elbows(*, duration: Seconds = 3.0) -> Scenario:
    """Two seven-joint arms side by side turn a short bar until their elbows would touch; they evade each other.

    Args:
        duration: duration of the path [s].
    """
    return _side_by_side("elbows", 0.11, 2.0, (-0.20, -0.16, 0.17), (-0.45, -0.03, 1.0), duration)


def forearms(*, duration: Seconds = 3.0) -> Scenario:
    """Two seven-joint arms side by side carry a short bar away, and their forearms come close.

    Args:
        duration: duration of the path [s].
    """
    return _side_by_side("forearms", 0.08, 9.0, (0.24, -0.11, 0.12), (-0.09, -0.47, 0.65), duration)


def _side_by_side(
    name: str, half: float, yaw: float, translation: Sequence[float], rotation: Sequence[float], duration: float
) -> Scenario:
    """Two seven-joint arms that face one way, at ``half`` [m] from the middle of a bar, turned in by a yaw [deg]."""
    path = moved(0.30, translation, rotation, duration)
    stations = [Station("arm7", arm, (0.0, y), turn) for arm, y, turn in (("left", half, -yaw), ("right", -half, yaw))]
    return put_together(name, stations, path, object_size=(0.05, 2.0 * half, 0.05), object_mass=1.5)


def random_posts(seed: int = 0, *, arms: int = 2, posts: int = 2) -> Scenario:
    """A cell of 2 (seven joints), 3 (six), 4 (mixed) or 8 arms with posts at random places among them.

    Args:
        seed: seed of the random numbers, for the posts and the path.
        arms: number of arms.
        posts: number of posts.

    Raises:
        UnknownNameError: another number of arms.
    """
    cells: dict[int, Callable[[], Scenario]] = {
        2: dual_arm7,
        3: lambda: _open_ring(3),
        4: mixed_cell,
        8: lambda: _open_ring(8),
    }
    if arms not in cells:
        raise UnknownNameError("number of arms", str(arms), map(str, cells), "random_posts")
    rng, base = np.random.default_rng(seed), cells[arms]()
    start = base.path.pose(0.0)
    path = LinePath.displaced(
        start,
        translation=rng.uniform(-0.12, 0.12, 3) + np.array([0.0, 0.0, 0.06]),
        rotation=rng.uniform(-0.15, 0.15, 3),
        duration=2.0,
    )
    found: list[Body] = []
    while len(found) < posts:
        post = _post(rng, start.translation, f"post_{len(found) + 1}")
        scene = CollisionScene.of(base, obstacles=[post], margin=0.0)
        near = min(pair.distance for pair in scene.distances(base.q_start) if post.name in (pair.first, pair.second))
        if near > _CLEAR:
            found.append(post)
    return replace(base, name="random_posts", path=path, obstacles=tuple(found))


#: Posts stand at least this far from all else at the start [m].
_CLEAR = 0.02


def _post(rng: np.random.Generator, about: Array, name: str) -> Body:
    """A capsule or a box at a random place about a point [m]."""
    angle, distance = rng.uniform(0.0, 2.0 * np.pi), 0.6 * np.sqrt(rng.random())
    away = np.array([np.cos(angle) * distance, np.sin(angle) * distance, rng.uniform(-0.1, 0.5)])
    turn = np.asarray(pin.exp3(rng.normal(size=3)))
    shape: Shape = (
        Capsule(rng.uniform(0.02, 0.05), rng.uniform(0.05, 0.4))
        if rng.random() < 0.5
        else Box(rng.uniform(0.03, 0.2, 3).tolist())
    )
    return Body(name, shape, pin.SE3(turn, about + away))


def _open_ring(arms: int) -> Scenario:
    """A ring whose object is a box inside it."""
    made = ring(arms=arms)
    width, depth, height = made.object_size
    return replace(made, object_size=(0.6 * width, 0.6 * depth, height))
