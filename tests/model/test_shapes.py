"""Shapes and bodies: what they keep, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from coopqp.core._core import DEEPEST

from coopqp import InvalidInputError
from coopqp.model.shapes import MOST_TRIANGLES, Body, Box, Capsule, Cylinder, Hull, Mesh, NearPair, Sphere

TETRAHEDRON = np.vstack([np.zeros(3), np.eye(3)])

#: Each size of a shape: how the message calls it, and the shape with that size and 1 m for the others.
SIZES: dict[str, Any] = {
    "Box: size": lambda x: Box((1.0, 1.0, x)),
    "Sphere: radius": Sphere,
    "Cylinder: radius": lambda x: Cylinder(x, 1.0),
    "Cylinder: length": lambda x: Cylinder(1.0, x),
    "Capsule: radius": lambda x: Capsule(x, 1.0),
    "Capsule: length": lambda x: Capsule(1.0, x),
}


@pytest.mark.parametrize("where", SIZES)
def test_sizes_are_ten_micrometres_to_a_kilometre(where: str) -> None:
    for size in (1e-5, 1e3):
        SIZES[where](size)
    for size in (0.99e-5, 1e-9, 1.01e3):
        with pytest.raises(InvalidInputError, match=rf"{where}: {size:g} m.*metres, 1e-05 to 1000"):
            SIZES[where](size)
    for bad in (0.0, -0.5, np.nan, np.inf, "wide", None):
        with pytest.raises(InvalidInputError, match=where):
            SIZES[where](bad)


def test_sizes_are_kept_as_plain_numbers() -> None:
    assert Box([1, 2, 3]).size == (1.0, 2.0, 3.0)
    assert Cylinder(np.float64(0.5), 2) == Cylinder(0.5, 2.0)
    assert Sphere(0.5) != Sphere(0.6)
    for bad in ((1.0, 2.0), 1.0, "abc"):
        with pytest.raises(InvalidInputError, match="Box: size"):
            Box(bad)  # type: ignore[arg-type]


def test_a_hull_keeps_its_points_to_itself() -> None:
    given = TETRAHEDRON.copy()
    hull = Hull(given)
    given[0] = 9.0
    np.testing.assert_array_equal(hull.points, TETRAHEDRON)
    with pytest.raises(ValueError, match="read-only"):
        hull.points[0] = 9.0
    Hull(1e-4 * TETRAHEDRON)  # small, and still a body
    Hull(1e3 * TETRAHEDRON)
    Hull(np.resize(TETRAHEDRON, (MOST_TRIANGLES, 3)))


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (TETRAHEDRON[:3], r"shape \(3, 3\)\. Give an array \(n, 3\) of 4 to 100000 points"),
        (np.resize(TETRAHEDRON, (MOST_TRIANGLES + 1, 3)), r"shape \(100001, 3\)"),
        (np.zeros((5, 2)), r"shape \(5, 2\)"),
        (np.zeros((5, 4)), r"shape \(5, 4\)"),
        (np.zeros(12), r"shape \(12,\)"),
        ("points", "no numbers"),
        ([[0.0, 1.0], [2.0]], "no numbers"),
        (np.where(TETRAHEDRON == 1.0, np.nan, 0.0), "not finite, or too far"),
        (np.where(TETRAHEDRON == 1.0, -np.inf, 0.0), "not finite, or too far"),
        (-1.01e3 * TETRAHEDRON, "not finite, or too far"),
        (np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]), "one plane"),
        (TETRAHEDRON @ np.diag([1.0, 1.0, 1e-7]), "one plane"),
        (np.ones((4, 3)), "one plane"),
    ],
)
def test_what_is_no_hull(points: Any, says: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"Hull: points: .*{says}"):
        Hull(points)


def test_a_mesh_is_a_file_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "part.stl"
    file.write_text("solid part\nendsolid part\n")
    mesh = Mesh(str(file), np.array([1, -1, 2]))  # type: ignore[arg-type]  # a mirrored part is one, too
    assert mesh.file == file
    assert mesh.scale == (1.0, -1.0, 2.0)
    assert Mesh(file).scale == (1.0, 1.0, 1.0)
    for axis in range(3):
        with pytest.raises(InvalidInputError, match=r"Mesh: scale: a scale of 0"):
            Mesh(file, np.where(np.arange(3) == axis, 0.0, 1.0))  # type: ignore[arg-type]
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInputError, match=rf"no file other\.stl.*relative to {tmp_path}"):
        Mesh("other.stl")
    for bad in (tmp_path, 3, None, "x" * 5000, "a\0b"):
        with pytest.raises(InvalidInputError, match="Mesh: file: "):
            Mesh(bad)  # type: ignore[arg-type]


def test_a_body_has_a_name_a_shape_and_a_place() -> None:
    T = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    body = Body("post", Sphere(0.1), T.homogeneous)
    assert body.placement == T
    assert Body("post", Sphere(0.1)).placement == pin.SE3.Identity()
    for name in ("", None, 3, "two\nlines"):
        with pytest.raises(InvalidInputError, match=r"Body: name: .*not empty"):
            Body(name, Sphere(0.1))  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="Body 'post': shape"):
        Body("post", "sphere")  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="Body 'post': placement"):
        Body("post", Sphere(0.1), 2.0 * np.eye(4))


def test_a_near_pair_says_its_distance_in_millimetres() -> None:
    assert str(NearPair("post", "arm/link", -0.01234)) == "post and arm/link: -12.3 mm"
    assert str(NearPair("post", "arm/link", DEEPEST)) == "post and arm/link: overlap"  # no depth was found
