"""A small software renderer in NumPy for the visual shapes of a cell.

It draws triangles with a perspective camera, a depth buffer, Lambert shading, and shadows on the floor z = 0. It needs
no window, no graphics card and no global state: the same arrays give the same picture everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.simulation.recording.bodies import SAND, read_bodies
from coopqp.spatial import Array

Indices = NDArray[np.intp]
Picture = NDArray[np.float32]

#: Number of sides of a drawn circle.
SEGMENTS = 36
#: Samples per pixel in each direction; they smooth the edges.
SAMPLES = 2
#: Number of candidate samples that are tested at once: as many as stay in a processor's cache.
CHUNK = 100_000
#: Distance of the camera in diagonals of the scene; gives a mild perspective.
CAMERA_DISTANCE = 2.2

#: Height of an arm's name above its highest joint, as a share of the size of the arm.
_ABOVE = 0.16
_GRID_M = 0.5
_FLOOR, _LINE = np.array([0.955, 0.96, 0.965], dtype=np.float32), np.array([0.86, 0.875, 0.89], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Solid:
    """A triangle mesh of one colour.

    Attributes:
        vertices: vertices in the world [m], shape (V, 3).
        triangles: indices of vertices, counter-clockwise seen from outside, shape (F, 3).
        colour: red, green and blue in [0, 1].
        name: of the body; may be empty.
    """

    vertices: Array
    triangles: Indices
    colour: tuple[float, float, float]
    name: str = ""

    def placed(self, T: pin.SE3) -> Solid:
        """The solid in another frame: ``T`` places its own frame there."""
        return replace(self, vertices=self.vertices @ T.rotation.T + T.translation)


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera that looks at ``target``.

    Attributes:
        target: point in the centre of the view [m], shape (3,).
        azimuth, elevation: direction from the target to the camera [deg]; azimuth from +x towards +y.
        distance: distance from the target [m].
    """

    target: Array
    azimuth: float
    elevation: float
    distance: float

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Unit vectors (3,) to the right and up in the picture, and from the target to the camera."""
        a, e = np.deg2rad(self.azimuth), np.deg2rad(self.elevation)
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return right, np.cross(back, right), back

    @property
    def light(self) -> Array:
        """Unit vector towards the light (3,): above, behind the viewer's left shoulder."""
        right, _, back = self.axes
        direction = -0.55 * right + 0.45 * back * (1.0, 1.0, 0.0) + np.array([0.0, 0.0, 0.85])
        return np.asarray(direction / np.linalg.norm(direction))

    @property
    def eye(self) -> Array:
        """Position of the camera (3,) [m]."""
        return np.asarray(self.target) + self.distance * self.axes[2]

    def project(self, points: Array) -> Array:
        """Project points (n, 3): right and up in units of the focal length, and inverse depth [1/m], (n, 3)."""
        right, up, back = self.axes
        offset = np.asarray(points) - self.eye
        inverse = 1.0 / np.maximum(-(offset @ back), 1e-3)
        return np.column_stack([(offset @ right) * inverse, (offset @ up) * inverse, inverse])

    def ray(self, x: Array, y: Array) -> Array:
        """Directions (…, 3) of the rays through image points."""
        right, up, back = self.axes
        return x[..., None] * right + y[..., None] * up - back


def box(size: Array) -> tuple[Array, Indices]:
    """A box around the origin with the given side lengths [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def revolved(radii: Array, heights: Array) -> tuple[Array, Indices]:
    """A solid of revolution about z, closed at both ends, with ``radii`` at rising ``heights`` [m]."""
    angle = np.arange(SEGMENTS) * (2.0 * np.pi / SEGMENTS)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(SEGMENTS)])
    rings = [r * circle + (0.0, 0.0, z) for r, z in zip(radii, heights, strict=True)]
    ends = [[0.0, 0.0, heights[0]], [0.0, 0.0, heights[-1]]]
    i, j = np.arange(SEGMENTS), np.roll(np.arange(SEGMENTS), -1)
    triangles = []
    for k in range(len(rings) - 1):
        a, b = k * SEGMENTS, (k + 1) * SEGMENTS
        triangles += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    bottom, last = len(rings) * SEGMENTS, (len(rings) - 1) * SEGMENTS
    triangles.append(np.column_stack([np.full(SEGMENTS, bottom), j, i]))
    triangles.append(np.column_stack([np.full(SEGMENTS, bottom + 1), last + i, last + j]))
    return np.vstack([*rings, ends]), np.vstack(triangles)


def mesh_of(shape: Any) -> tuple[Array, Indices] | None:
    """Vertices (V, 3) [m] and triangles (F, 3) of a coal shape; None for a shape without a surface to draw."""
    kind = type(shape).__name__
    if kind == "Box":
        return box(2.0 * np.asarray(shape.halfSide, dtype=float))
    if kind == "Cylinder":
        return revolved(np.full(2, shape.radius), shape.halfLength * np.array([-1.0, 1.0]))
    if kind == "Cone":
        return revolved(np.array([shape.radius, 0.0]), shape.halfLength * np.array([-1.0, 1.0]))
    if kind in ("Sphere", "Capsule", "Ellipsoid"):
        latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SEGMENTS // 2)
        unit_r, unit_z = np.cos(latitude), np.sin(latitude)
        if kind == "Ellipsoid":
            vertices, triangles = revolved(unit_r, unit_z)
            return vertices * np.asarray(shape.radii), triangles
        shift = np.copysign(shape.halfLength, latitude) if kind == "Capsule" else 0.0
        return revolved(shape.radius * unit_r, shape.radius * unit_z + shift)
    if kind.startswith("BVHModel"):
        triangles = np.array([[t[0], t[1], t[2]] for t in (shape.tri_indices(k) for k in range(shape.num_tris))])
        return np.asarray(shape.vertices()).reshape(-1, 3), triangles.reshape(-1, 3).astype(np.intp)
    return None


def cell_solids(
    cell: RobotCell, configurations: Sequence[Array], *, shapes: pin.GeometryModel | None = None
) -> list[list[Solid]]:
    """The shapes of all arms (by default the visual ones) at each configuration (T, nq), in the world.

    Raises:
        InvalidInputError: no arm has a shape to draw.
    """
    visual = cell.visual_model() if shapes is None else shapes
    data, placements = cell.model.createData(), visual.createData()
    meshes = []
    for k, item in enumerate(visual.geometryObjects):
        mesh = mesh_of(item.geometry)
        if mesh is not None:
            red, green, blue = (float(c) for c in np.asarray(item.meshColor)[:3])
            meshes.append((k, *mesh, (red, green, blue)))
    if not meshes:
        raise InvalidInputError("no arm has a shape to draw", "cell_solids", "Load the arms with geometry=True.")
    frames = []
    for q in configurations:
        pin.forwardKinematics(cell.model, data, np.asarray(q, dtype=float))
        pin.updateGeometryPlacements(cell.model, data, visual, placements)
        T = placements.oMg
        frames.append([Solid(v @ T[k].rotation.T + T[k].translation, f, c) for k, v, f, c in meshes])
    return frames


def name_places(cell: RobotCell, q: Array) -> Array:
    """Where the name of each arm stands (N, 3) [m]: above the highest of its joints and its tool."""
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, np.asarray(q, dtype=float))
    places = []
    for k, own in enumerate(cell.v_slices):
        joints = [data.oMi[j + 1].translation for j in range(own.start, own.stop)]
        points = np.array([*joints, data.oMf[cell.tool_frames[k]].translation])
        reach = float(np.linalg.norm(np.ptp([*points, cell.arms[k].T_world_base.translation], axis=0)))
        places.append(points[points[:, 2].argmax()] + [0.0, 0.0, _ABOVE * reach])
    return np.array(places)


def box_solid(size: tuple[float, float, float], T_world_box: pin.SE3, colour: tuple[float, float, float]) -> Solid:
    """A box with side lengths ``size`` [m] at a placement."""
    vertices, triangles = box(np.array(size))
    return Solid(vertices @ T_world_box.rotation.T + T_world_box.translation, triangles, colour)


def body_solids(metadata: Mapping[str, Any], key: str = "bodies", colour: Any = SAND) -> list[Solid]:
    """Bodies of a recording, from its metadata: those in the world, or (key ``"carried"``) in the object frame."""
    solids = []
    for name, geometry, T in read_bodies(metadata, key):
        mesh = mesh_of(geometry)
        if mesh is not None:
            solids.append(Solid(*mesh, colour, name).placed(T))
    return solids


def object_solids(
    metadata: Mapping[str, Any], size: Array, T_object_body: pin.SE3, colour: tuple[float, float, float]
) -> tuple[list[Solid], Array]:
    """The object of a recording in its frame: the bodies that its file calls carried, else a box.

    Args:
        metadata: of the recording.
        size, T_object_body: the box: side lengths (3,) [m], and its placement in the object frame.
        colour: of all of them.

    Returns:
        the solids; corners (8, 3) [m] of a box round them, in the order of :func:`box`.
    """
    whole = Solid(*box(size), colour, "object").placed(T_object_body)
    carried = body_solids(metadata, "carried", colour)
    if not carried:
        return [whole], whole.vertices
    points = np.vstack([solid.vertices for solid in carried])
    low, high = points.min(axis=0), points.max(axis=0)
    return carried, 0.5 * (low + high) + box(high - low)[0]


@dataclass(frozen=True, eq=False)
class View:
    """A camera and the drawn part of its image.

    Attributes:
        camera: the camera.
        left, right, bottom, top: edges of the picture, in units of the focal length.
    """

    camera: Camera
    left: float
    right: float
    bottom: float
    top: float

    @staticmethod
    def around(frames: Sequence[Sequence[Solid]], *, azimuth: float, elevation: float, margin: float = 0.03) -> View:
        """The smallest view from a direction [deg] of all solids of all frames, with a ``margin`` (a share)."""
        cloud = np.vstack([solid.vertices for frame in frames for solid in frame])
        low, high = cloud.min(axis=0), cloud.max(axis=0)
        camera = Camera(0.5 * (low + high), azimuth, elevation, CAMERA_DISTANCE * float(np.linalg.norm(high - low)))
        image = camera.project(cloud)[:, :2]
        (left, bottom), (right, top) = image.min(axis=0), image.max(axis=0)
        gap = margin * max(right - left, top - bottom)
        return View(camera, left - gap, right + gap, bottom - gap, top + gap)

    @property
    def aspect(self) -> float:
        """Width over height."""
        return (self.right - self.left) / (self.top - self.bottom)

    def pixels(self, points: Array, width: int, height: int) -> Array:
        """Column, row (from the top) [px] and inverse depth [1/m] of points (n, 3)."""
        image = self.camera.project(points)
        image[:, 0] = (image[:, 0] - self.left) * (width / (self.right - self.left))
        image[:, 1] = (self.top - image[:, 1]) * (height / (self.top - self.bottom))
        return image


def render(frames: Sequence[Sequence[Solid]], view: View, *, width: int) -> list[NDArray[np.uint8]]:
    """Draw closed solids and their shadows on a floor grid at z = 0, one picture per frame.

    Args:
        frames: the solids of each picture, at least one.
        view: the view; its aspect defines the height.
        width: width of the picture [px].

    Returns:
        Pictures (height, width, 3), sRGB.
    """
    shape = SAMPLES * max(1, round(width / view.aspect)), SAMPLES * width
    floor, shade = _floor(view, shape)
    return [_picture(solids, view, floor, shade) for solids in frames]


def _picture(solids: Sequence[Solid], view: View, floor: Picture, shade: Picture) -> NDArray[np.uint8]:
    rows, columns = floor.shape[:2]
    corners = np.vstack([solid.vertices[solid.triangles] for solid in solids])  # (F, 3, 3)
    counts = [len(solid.triangles) for solid in solids]
    colours = np.repeat([solid.colour for solid in solids], counts, axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    light = view.camera.light

    owner = np.full((rows, columns), -1, dtype=np.int32)
    facing = np.flatnonzero(np.einsum("fi,fi->f", normals, view.camera.eye - corners[:, 0]) > 0.0)
    _draw(view, corners, facing, owner)
    shadow = np.full((rows, columns), -1, dtype=np.int32)
    lit = np.flatnonzero(normals @ light > 0.0)
    _draw(view, corners - (corners[..., 2:] / light[2]) * light, lit, shadow)

    picture = np.where((shadow >= 0)[..., None], floor * shade, floor)
    hit = owner >= 0
    picture[hit] = _shaded(normals, colours, light)[owner[hit]]
    solid_of = np.append(np.repeat(np.arange(len(solids)), counts), -1)[owner]  # -1: nothing
    edge = np.zeros((rows, columns), dtype=bool)
    edge[:, 1:] |= solid_of[:, 1:] != solid_of[:, :-1]
    edge[1:] |= solid_of[1:] != solid_of[:-1]
    picture[edge] *= 0.62
    parts = [picture[i::SAMPLES, j::SAMPLES] for i in range(SAMPLES) for j in range(SAMPLES)]
    return np.asarray(np.clip(np.sum(parts, axis=0) * (255.0 / len(parts)), 0.0, 255.0) + 0.5, dtype=np.uint8)


def _draw(view: View, corners: Array, faces: Indices, owner: NDArray[np.int32]) -> None:
    """Write into ``owner`` (rows, columns) the front triangle of ``faces`` at each sample.

    ``corners`` (F, 3, 3) are in the world [m]. The depth test compares inverse depths, which are linear in the picture.
    """
    rows, columns = owner.shape
    image = view.pixels(corners[faces].reshape(-1, 3), columns, rows).reshape(-1, 3, 3).astype(np.float32)
    x, y, z = image[..., 0], image[..., 1], image[..., 2]
    ux, uy, vx, vy = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0], x[:, 2] - x[:, 0], y[:, 2] - y[:, 0]
    area = ux * vy - vx * uy
    x0 = np.clip(np.ceil(x.min(axis=1) - 0.5), 0, columns).astype(np.int32)
    y0 = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, rows).astype(np.int32)
    wide = np.maximum(np.clip(np.floor(x.max(axis=1) + 0.5), 0, columns).astype(np.int32) - x0, 0)
    high = np.maximum(np.clip(np.floor(y.max(axis=1) + 0.5), 0, rows).astype(np.int32) - y0, 0)
    count = np.where(np.abs(area) > 1e-6, wide * high, 0)
    kept = np.flatnonzero(count)
    scale = 1.0 / np.where(area == 0.0, 1.0, area)
    # Barycentric weights b, c and inverse depth are linear: value at (x0, y0), slope along x, slope along y.
    px, py = x0 + 0.5 - x[:, 0], y0 + 0.5 - y[:, 0]
    b, bx, by = (px * vy - py * vx) * scale, vy * scale, -vx * scale
    c, cx, cy = (py * ux - px * uy) * scale, -uy * scale, ux * scale
    depth = np.zeros(rows * columns, dtype=np.float32)
    flat = owner.reshape(-1)
    for batch in np.split(kept, np.flatnonzero(np.diff(np.cumsum(count[kept]) // CHUNK)) + 1):
        n = count[batch]
        t = np.repeat(batch.astype(np.int32), n)
        inside = np.arange(len(t), dtype=np.int32) - np.repeat((np.cumsum(n) - n).astype(np.int32), n)
        down = inside // wide[t]
        across = inside - down * wide[t]
        weight_b = b[t] + across * bx[t] + down * by[t]
        weight_c = c[t] + across * cx[t] + down * cy[t]
        seen = np.flatnonzero((weight_b >= 0.0) & (weight_c >= 0.0) & (weight_b + weight_c <= 1.0))
        t, weight_b, weight_c = t[seen], weight_b[seen], weight_c[seen]
        sample = (y0[t] + down[seen]) * columns + x0[t] + across[seen]
        value = (z[t, 0] + weight_b * (z[t, 1] - z[t, 0]) + weight_c * (z[t, 2] - z[t, 0])).astype(np.float32)
        np.maximum.at(depth, sample, value)
        front = value >= depth[sample]
        flat[sample[front]] = faces[t[front]]


def _shaded(normals: Array, colours: Array, light: Array) -> Array:
    """Colour of each triangle (F, 3) under a key light, a weak opposite light and the sky, with a slight gloss."""
    key = np.maximum(normals @ light, 0.0)
    fill = np.maximum(normals @ (light * (-1.0, -1.0, 0.2)), 0.0)
    brightness = 0.46 + 0.52 * key + 0.12 * fill + 0.10 * normals[:, 2]
    return np.clip(colours * brightness[:, None] + 0.10 * (key**6)[:, None], 0.0, 1.0)


def _floor(view: View, shape: tuple[int, int]) -> tuple[Picture, Picture]:
    """The floor (*shape, 3), a grid of half a metre that fades into white, and the factor of a shadow on it."""
    camera = view.camera
    step = (view.right - view.left) / shape[1]
    x = view.left + (np.arange(shape[1], dtype=np.float32) + 0.5) * step
    y = view.top - (np.arange(shape[0], dtype=np.float32) + 0.5) * ((view.top - view.bottom) / shape[0])
    ray = camera.ray(*np.meshgrid(x, y)).astype(np.float32)
    drop = np.minimum(ray[..., 2], -1e-6)
    reach = -camera.eye[2] / drop
    spot = [camera.eye[i] + reach * ray[..., i] for i in (0, 1)]
    slant = np.sqrt(np.sqrt(1.0 + x**2 + y[:, None] ** 2) / -drop)  # widen the lines across the view: they look thinner
    half = 0.45 * SAMPLES * step * reach * slant
    off_line = [np.abs((s / _GRID_M + 0.5) % 1.0 - 0.5) * _GRID_M for s in spot]
    line = np.minimum(off_line[0], off_line[1]) < half
    far = np.hypot(spot[0] - camera.target[0], spot[1] - camera.target[1]) / (camera.distance / CAMERA_DISTANCE)
    white = np.clip((far - 0.55) / 0.35, 0.0, 1.0)
    white[ray[..., 2] >= -1e-6] = 1.0
    white = white[..., None].astype(np.float32)
    colour = np.where(line[..., None], _LINE, _FLOOR)
    return colour + (1.0 - colour) * white, 1.0 - 0.2 * (1.0 - white)
