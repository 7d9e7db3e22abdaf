"""The software renderer: closed meshes of the right size, projection, and occlusion."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from coopqp import Arm, InvalidInputError, RobotCell
from coopqp.scenarios import robot_path
from coopqp.visualization.renderer import Solid, View, box_solid, cell_solids, mesh_of, render

Array = NDArray[np.float64]

VOLUMES: dict[str, tuple[Any, float]] = {
    "box": (coal.Box(1.0, 2.0, 3.0), 6.0),
    "cylinder": (coal.Cylinder(0.5, 2.0), np.pi * 0.5),
    "cone": (coal.Cone(0.5, 2.0), np.pi * 0.5 / 3.0),
    "sphere": (coal.Sphere(0.5), np.pi / 6.0),
    "capsule": (coal.Capsule(0.5, 2.0), np.pi * 0.5 + np.pi / 6.0),
    "ellipsoid": (coal.Ellipsoid(0.5, 1.0, 2.0), 4.0 / 3.0 * np.pi),
}


def volume(vertices: Array, triangles: NDArray[np.intp]) -> float:
    """Signed volume. It equals the solid's volume only if the mesh is closed and faces outwards."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("name", VOLUMES)
def test_meshes_are_closed_face_outwards_and_have_the_shape_s_volume(name: str) -> None:
    shape, expected = VOLUMES[name]
    mesh = mesh_of(shape)
    assert mesh is not None
    vertices, triangles = mesh
    assert volume(vertices, triangles) == pytest.approx(expected, rel=0.03)
    edges = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward = {(a, b) for a, b in edges.tolist()}
    assert len(forward) == len(edges)
    assert all((b, a) in forward for a, b in forward)  # every edge is shared, in opposite directions


def test_triangle_meshes_are_read() -> None:
    model = coal.BVHModelOBBRSS()
    model.beginModel(2, 4)
    model.addVertices(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    model.addTriangle(np.array([0.0, 0, 0]), np.array([0.0, 1, 0]), np.array([1.0, 0, 0]))
    model.endModel()
    mesh = mesh_of(model)
    assert mesh is not None
    assert mesh[0][mesh[1]].shape == (1, 3, 3)


def test_shapes_without_a_surface_are_left_out() -> None:
    assert mesh_of(coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)) is None


def cube(x: float, y: float, z: float, size: float, colour: tuple[float, float, float]) -> Solid:
    return box_solid((size, size, size), pin.SE3(np.eye(3), np.array([x, y, z])), colour)


def test_the_nearer_solid_hides_the_farther_whatever_the_order() -> None:
    red, blue = cube(1.0, 0.0, 0.5, 0.8, (1.0, 0.0, 0.0)), cube(-1.0, 0.0, 0.5, 0.8, (0.0, 0.0, 1.0))
    view = View.around([[red, blue]], azimuth=0.0, elevation=5.0)  # from +x: red is in front
    pictures = render([[red, blue], [blue, red]], view, width=120)
    assert np.array_equal(pictures[0], pictures[1])
    height, width = pictures[0].shape[:2]
    r, _, b = pictures[0][height // 2, width // 2].astype(int)
    assert r > 100 > b


def test_a_solid_covers_the_pixels_it_projects_to() -> None:
    solid = cube(0.0, 0.0, 0.5, 1.0, (0.0, 0.0, 0.0))
    view = View.around([[solid]], azimuth=30.0, elevation=30.0, margin=0.2)
    (picture,) = render([[solid]], view, width=400)
    rows, columns = np.nonzero(picture.max(axis=2) < 60)
    points = view.pixels(solid.vertices, picture.shape[1], picture.shape[0])
    assert columns.min() == pytest.approx(points[:, 0].min(), abs=1.5)
    assert columns.max() == pytest.approx(points[:, 0].max(), abs=1.5)
    assert rows.min() == pytest.approx(points[:, 1].min(), abs=1.5)
    assert rows.max() == pytest.approx(points[:, 1].max(), abs=1.5)


def test_everything_is_in_the_picture() -> None:
    solids = [cube(0.3, -2.0, 0.5, 0.5, (0.5, 0.5, 0.5)), cube(4.0, 1.0, 2.0, 0.7, (0.5, 0.5, 0.5))]
    for azimuth in (0.0, 77.0, 200.0):
        view = View.around([solids], azimuth=azimuth, elevation=35.0, margin=0.0)
        points = np.vstack([view.pixels(s.vertices, 100, 50) for s in solids])
        np.testing.assert_allclose([points[:, 0].min(), points[:, 0].max()], [0.0, 100.0], atol=1e-9)
        np.testing.assert_allclose([points[:, 1].min(), points[:, 1].max()], [0.0, 50.0], atol=1e-9)


def test_shapes_move_with_the_joints() -> None:
    cell = RobotCell([Arm.from_urdf("a", robot_path("rx90l"), tool_frame="flange")])
    straight = cell.configuration([0.0] * 6)
    bent = cell.configuration([0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, 0.0])
    up, forward = (np.vstack([s.vertices for s in frame]) for frame in cell_solids(cell, [straight, bent]))
    reach = 0.45 + 0.65 + 0.085
    assert up[:, 2].max() == pytest.approx(0.42 + reach, abs=0.01)
    assert forward[:, 0].max() == pytest.approx(reach, abs=0.01)


def test_arms_without_shapes_are_refused() -> None:
    cell = RobotCell([Arm.from_urdf("a", robot_path("rx90l"), tool_frame="flange", geometry=False)])
    with pytest.raises(InvalidInputError, match="geometry=True"):
        cell_solids(cell, [cell.configuration([0.0] * 6)])
