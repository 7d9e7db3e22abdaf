"""Bodies around the arms and on the object in a recording: what comes back is what stood there."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import cart

from coopqp import CollisionScene, Grasp, RobotCell
from coopqp.model.shapes import Body, Box, Capsule, Cylinder, Sphere
from coopqp.simulation import SceneError
from coopqp.simulation.recording import bodies
from coopqp.simulation.recording.bodies import SAND, describe_bodies, describe_carried, read_bodies
from coopqp.spatial import as_placement

CELL = RobotCell([cart("left"), cart("right", T_world_base=pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0])))])


def placed(seed: int) -> pin.SE3:
    T: pin.SE3 = pin.exp6(np.random.default_rng(seed).normal(size=6))
    return T


#: Grasps with the first tool turned and away from the object's frame.
GRASP = Grasp((placed(1), placed(2)))
OBSTACLES = (Body("post", Cylinder(0.1, 0.5), placed(3)), Body("ball", Sphere(0.2), placed(4)))
CARRIED = (Body("bar", Capsule(0.05, 0.7), placed(5)), Body("block", Box((0.1, 0.2, 0.3)), placed(6)))


@pytest.fixture
def scene() -> CollisionScene:
    return CollisionScene(
        cell=CELL,
        grasp=GRASP,
        carried=CARRIED,
        obstacles=OBSTACLES,
        on_links={"right/tool": [Body("lamp", Sphere(0.1))]},
    )


def read(scene: CollisionScene, key: str, box: Any = None) -> list[tuple[str, Any, pin.SE3]]:
    described = describe_bodies(scene) if key == "bodies" else describe_carried(scene, box)
    return read_bodies(json.loads(json.dumps({key: described})), key)


def test_what_stands_in_the_world_and_what_the_object_is_made_of_comes_back(scene: CollisionScene) -> None:
    """By names, shapes and places: in the world, and in the object's frame. What sits on links is neither."""
    for key, given in (("bodies", OBSTACLES), ("carried", CARRIED)):
        found = read(scene, key)
        assert [name for name, _, _ in found] == [body.name for body in given]
        for (_, _, T), body in zip(found, given, strict=True):
            np.testing.assert_allclose(T.homogeneous, as_placement(body.placement, "").homogeneous, atol=1e-12)
    (post, ball), (bar, block) = ([g for _, g, _ in read(scene, key)] for key in ("bodies", "carried"))
    assert (post.radius, post.halfLength, ball.radius) == pytest.approx((0.1, 0.25, 0.2))
    assert (bar.radius, bar.halfLength) == pytest.approx((0.05, 0.35))
    np.testing.assert_allclose(block.halfSide, [0.05, 0.1, 0.15])
    assert {tuple(entry["color"]) for entry in describe_bodies(scene)} == {(*SAND, 1.0)}


def test_of_an_object_that_is_its_box_nothing_more_is_told() -> None:
    size, T = (0.1, 0.2, 0.3), placed(6)
    box = {"size_m": list(size), "T_object_body": T.homogeneous.tolist()}
    for carried, entries in (
        ([Body("object", Box(size), T)], 0),
        ([Body("object", Box((0.1, 0.2, 0.31)), T)], 1),
        ([Body("object", Box(size), placed(7))], 1),
        ([Body("object", Sphere(0.1), T)], 1),
        ([Body("object", Box(size), T), Body("more", Sphere(0.1))], 2),
    ):
        made = CollisionScene(cell=CELL, grasp=GRASP, carried=carried, obstacles=OBSTACLES)
        assert len(describe_carried(made, box)) == entries
        assert len(describe_carried(made, None)) == len(carried)


def test_damaged_bodies_are_refused_by_name(scene: CollisionScene, monkeypatch: pytest.MonkeyPatch) -> None:
    assert read_bodies({}) == []
    assert read_bodies({"bodies": None}) == []
    (post, ball) = describe_bodies(scene)
    with_mesh = [{"kind": "mesh", "name": "x", "file": "/etc/passwd"}, post, {**ball, "kind": "Plane"}, ball]
    assert [name for name, _, _ in read_bodies({"bodies": with_mesh})] == ["post", "ball"]
    wrong: list[Any] = [3, [3], [{}], [{**post, "placement": "here"}], [{**post, "size": {}}]]
    for damaged in wrong:
        with pytest.raises(SceneError, match="the recording's bodies are damaged"):
            read_bodies({"bodies": damaged})
    with pytest.raises(SceneError, match="the recording's carried are damaged"):
        read_bodies({"carried": [{}]}, "carried")
    monkeypatch.setattr(bodies, "MAX_SHAPES", 2)
    assert len(read_bodies({"bodies": [post, ball]})) == 2
    with pytest.raises(SceneError, match="more than 2 bodies"):
        read_bodies({"bodies": [post, ball, ball]})
