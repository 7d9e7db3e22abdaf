"""Shapes and pairs of a scene: what a file or an entry must be, what is refused, and how far a shape reaches."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, CollisionScene, InvalidInputError, RobotCell
from coopqp.collision import Body, Box, Capsule, Cylinder, Hull, Mesh, PairRules, Sphere, coal_geometry
from coopqp.collision.coal_geometry import convex, core_shape, geometry_of, hull_of, reach_of
from coopqp.collision.convex_shapes import convex_parts
from coopqp.collision.distances import new_request
from coopqp.collision.pairs import Names, as_pair, ignored_line, pairs_said, srdf_pairs
from coopqp.errors import UnknownNameError
from coopqp.scenarios import plate_and_post
from coopqp.simulation.recording.scene import describe_cell, read_cell
from coopqp.spatial import Array

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
#: Two triangles of each face of the unit cube.
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip


def obj(file: Path, corners: Array = CORNERS, faces: Any = FACES) -> Path:
    """An OBJ of triangles."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
    file.write_text("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]) + "\n", encoding="utf-8")
    return file


def stl(file: Path) -> Path:
    """A binary STL of the unit cube."""
    rows = np.zeros(len(FACES), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = CORNERS[FACES]
    file.write_bytes(b"\0" * 80 + np.uint32(len(FACES)).tobytes() + rows.tobytes())
    return file


# -- pairs -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", ["ab", b"ab", 3, None, (), ("a",), ("a", "b", "c")])
def test_what_is_no_pair_of_names_is_refused(entry: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"is no pair of names.*\(\"object\", \"post\"\)") as caught:
        as_pair(entry, "CollisionScene: ignored")
    assert "CollisionScene: ignored" in str(caught.value)
    assert as_pair(["a", "b"], "") == ("a", "b")


@pytest.mark.parametrize("name", ["apart", "object_apart"])
@pytest.mark.parametrize("value", [-1, 1.5, "2", None])
def test_pair_rules_are_counts(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"PairRules: {name}"):
        PairRules(**{name: value})


def test_patterns_stand_for_a_body_the_links_of_an_arm_or_all() -> None:
    names = Names(["left/a", "left/b", "leftover/a", "post", "post"], ["left", "leftover"])
    assert names.names == ("left/a", "left/b", "leftover/a", "post")
    assert names.matching("left", "") == {"left/a", "left/b"}
    assert names.matching("post", "") == {"post"}
    assert names.matching("*", "") == set(names.names)
    assert names.pairs([("left", "post")], "") == {frozenset(("left/a", "post")), frozenset(("left/b", "post"))}
    assert names.pairs([], "") == set()
    with pytest.raises(UnknownNameError, match=r"no body named 'pots' in scene\. Did you mean 'post'") as caught:
        names.matching("pots", "scene")
    assert "left" in str(caught.value)


def test_pairs_are_told_in_words_and_as_a_line_of_a_cell_file() -> None:
    pairs = [("a", "object"), ("b", "object"), ("c", "tür")]
    assert pairs_said(pairs) == "a and b with object, c with tür"
    assert ignored_line(pairs) == 'ignored = [["a", "object"], ["b", "object"], ["c", "tür"]]'


def test_an_srdf_is_read_from_text_and_file_alike(tmp_path: Path) -> None:
    text = (
        '<robot name="r"><disable_collisions link1="a" link2="b"/><disable_collision link1="c" link2="d"/>'
        '<disable_collisions link1="e"/><group name="g"/></robot>'
    )
    file = tmp_path / "r.srdf"
    file.write_text(text, encoding="utf-8")
    assert srdf_pairs(text, "") == srdf_pairs(file, "") == srdf_pairs(str(file), "") == [("a", "b"), ("c", "d")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nowhere.srdf", "there is no file nowhere.srdf"),
        ("<sdf/>", "its root is <sdf>, not <robot>"),
        ("<robot>", "no readable SRDF"),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot name="&a;"/>', "XML entities"),
    ],
)
def test_what_is_no_srdf_is_refused(text: str, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said) as caught:
        srdf_pairs(text, "the place")
    assert "the place" in str(caught.value)


def test_an_srdf_that_is_too_large_is_refused_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "r.srdf"
    file.write_text('<robot name="r"/>', encoding="utf-8")
    monkeypatch.setattr("coopqp.collision.pairs.MAX_DESCRIPTION_BYTES", 17)
    assert srdf_pairs(file, "") == []
    monkeypatch.setattr("coopqp.collision.pairs.MAX_DESCRIPTION_BYTES", 16)
    with pytest.raises(InvalidInputError, match=r"cannot read .*r\.srdf: it is larger than 16 bytes"):
        srdf_pairs(file, "")


def dae(file: Path, unit: str) -> Path:
    """A tetrahedron with sides of 1 along the axes."""
    numbers = '<float_array id="n" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>'
    axes = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    places = f'<accessor source="#n" count="4" stride="3">{axes}</accessor>'
    mesh = (
        f'<mesh><source id="p">{numbers}<technique_common>{places}</technique_common></source><vertices id="v">'
        '<input semantic="POSITION" source="#p"/></vertices><triangles count="4"><input semantic="VERTEX" source="#v" '
        'offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh>'
    )
    node = '<visual_scene id="s"><node id="k"><instance_geometry url="#g"/></node></visual_scene>'
    file.write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset>{unit}<up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g">{mesh}</geometry>'
        f"</library_geometries><library_visual_scenes>{node}</library_visual_scenes><scene><instance_visual_scene "
        'url="#s"/></scene></COLLADA>'
    )
    return file


# -- meshes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.5, 2.0, 3.0)])
@pytest.mark.parametrize("make", [obj, stl])
def test_a_mesh_of_a_convex_body_is_its_own_hull(
    make: Callable[[Path], Path], scale: tuple[float, float, float], tmp_path: Path
) -> None:
    mesh = geometry_of(Mesh(make(tmp_path / f"cube.{make.__name__}"), scale=scale), "")
    hull, factor = convex(mesh, "")
    assert factor == pytest.approx(1.0)
    assert hull.computeVolume() == pytest.approx(np.prod(scale))
    assert {tuple(p) for p in hull.points().round(6).tolist()} == {tuple(p) for p in (CORNERS * scale).tolist()}
    assert convex(hull, "") == (hull, 1.0)


@pytest.mark.parametrize(
    ("make", "limit", "said"),
    [
        (stl, 11, r"cube\.stl has 12 triangles.*Reduce it to 11 or fewer"),  # by its header
        (obj, 11, "a mesh of 12 triangles.*Reduce it to 11 or fewer"),
        (obj, 12, ""),
        (stl, 12, ""),
    ],
)
def test_a_mesh_of_too_many_triangles_is_refused(
    make: Callable[[Path], Path], limit: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = Mesh(make(tmp_path / f"cube.{make.__name__}"))
    monkeypatch.setattr(coal_geometry, "MOST_TRIANGLES", limit)
    if not said:
        assert convex(geometry_of(mesh, ""), "")[0].num_points == 8
        return
    with pytest.raises(InvalidInputError, match=said):
        convex(geometry_of(mesh, "the rock"), "the rock")


def test_a_mesh_of_too_many_corners_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = geometry_of(Mesh(obj(tmp_path / "cube.obj", faces=FACES[:4])), "")
    monkeypatch.setattr(coal_geometry, "MOST_TRIANGLES", 7)
    assert mesh.num_tris < 7 < mesh.num_vertices
    with pytest.raises(InvalidInputError, match="Reduce it to 7 or fewer"):
        convex(mesh, "")


@pytest.mark.parametrize(("unit", "side"), [("", 1.0), ('<unit name="inch" meter="0.0254"/>', 0.0254),
                                            ("<unit meter='1e-3' name='mm'/>", 0.001)])  # fmt: skip
def test_a_dae_is_in_its_unit(unit: str, side: float, tmp_path: Path) -> None:
    """As RViz and others show it: a body of a cell, a link of a URDF, and a link of a recording."""
    file = dae(tmp_path / "corner.dae", unit)
    assert np.abs(geometry_of(Mesh(file, scale=(2.0, 1.0, 1.0)), "").vertices()).max(axis=0).tolist() == pytest.approx(
        [2.0 * side, side, side]
    )
    shape = f'<geometry><mesh filename="{file}" scale="2 1 1"/></geometry>'
    link = f'<link name="t"><visual>{shape}</visual><collision>{shape}</collision></link>'
    limit = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
    joint = f'<joint name="j" type="revolute"><parent link="b"/><child link="t"/><axis xyz="0 0 1"/>{limit}</joint>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="r"><link name="b"/>{link}{joint}</robot>')
    cell = RobotCell([Arm.from_urdf("a", tmp_path / "arm.urdf", tool_frame="t")])
    told = read_cell({"scene": json.loads(json.dumps(describe_cell(cell)))}, meshes=True)
    for shapes in (cell.arms[0].visual, cell.arms[0].collision, told.arms[0].visual):
        assert shapes is not None
        (found,) = shapes.geometryObjects
        assert np.abs(found.geometry.vertices()).max(axis=0).tolist() == pytest.approx([2.0 * side, side, side])


@pytest.mark.parametrize("unit", ["0", "-1", "nan", "x"])
def test_a_dae_of_no_unit_is_refused(unit: str, tmp_path: Path) -> None:
    file = dae(tmp_path / "corner.dae", f'<unit meter="{unit}"/>')
    with pytest.raises(InvalidInputError, match=r"corner\.dae is no readable mesh"):
        geometry_of(Mesh(file), "the rock")


def test_mesh_files_that_are_too_large_or_none_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "cube.obj"
    file.write_text("no mesh at all", encoding="utf-8")
    with pytest.raises(
        InvalidInputError, match=r"cube\.obj is no readable mesh \(.+\).*Give an STL, DAE or OBJ"
    ) as bad:
        geometry_of(Mesh(file), "the rock")
    assert "\n" not in str(bad.value)
    assert "Hint" not in str(bad.value)
    monkeypatch.setattr(coal_geometry, "MOST_BYTES", obj(file).stat().st_size)
    assert geometry_of(Mesh(file), "").num_tris == len(FACES)
    monkeypatch.setattr(coal_geometry, "MOST_BYTES", file.stat().st_size - 1)
    with pytest.raises(InvalidInputError, match=r"cannot read .*cube\.obj: it is larger than"):
        geometry_of(Mesh(file), "")


@pytest.mark.parametrize(
    ("geometry", "said"),
    [
        (coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), "a Halfspace.*Give a box"),
        (coal.Sphere(0.0), r"a Sphere with sizes \[0\.0\]"),
        (coal.Box(1.0, 2.0, 0.0), r"a Box with sizes \[0\.5, 1\.0, 0\.0\]"),
        (coal.Cylinder(0.5, np.inf), r"a Cylinder with sizes \[0\.5, inf\]"),
        (coal.Cone(-0.5, 2.0), r"a Cone with sizes \[-0\.5, 1\.0\]"),
        (coal.Ellipsoid(1.0, 0.0, 2.0), r"a Ellipsoid with sizes \[1\.0, 0\.0, 2\.0\]"),
    ],
)
def test_shapes_without_end_or_volume_are_refused(geometry: Any, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said) as caught:
        convex(geometry, "link 'a'")
    assert "link 'a'" in str(caught.value)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (CORNERS[:4], "not in one plane"),
        (CORNERS[[0, 1, 2, 0]], "not in one plane"),
        (np.zeros((5, 3)), "not in one plane"),
        (CORNERS[:2], "not in one plane"),
        (CORNERS * [1.0, 1.0, 1e-9] + 3.0, "not in one plane"),
        (np.full((4, 3), np.nan), "not finite"),
    ],
)
def test_points_without_a_hull_are_refused(points: Array, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        hull_of(points, "")


def test_a_flat_mesh_is_refused_by_the_name_of_its_body(tmp_path: Path) -> None:
    floor = Body("floor", Mesh(obj(tmp_path / "floor.obj", CORNERS[:4], [[0, 1, 3], [0, 3, 2]])))
    with pytest.raises(InvalidInputError, match=r"Body 'floor': corners without a hull.*not in one plane"):
        CollisionScene.of(plate_and_post(), obstacles=[floor])
    thin = hull_of(CORNERS * [1.0, 1.0, 1e-5], "")
    assert thin.computeVolume() == pytest.approx(1e-5)


# -- how far shapes reach ----------------------------------------------------------------------------------------------


def surface(geometry: Any, rng: np.random.Generator) -> Array:
    """Points of a shape that are farthest in directions of its frame (n, 3)."""
    ways = rng.normal(size=(4000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    match type(geometry).__name__:
        case "Sphere":
            return geometry.radius * ways
        case "Capsule":
            return geometry.radius * ways + np.sign(ways[:, 2:]) * [0.0, 0.0, geometry.halfLength]
        case "Ellipsoid":
            return ways * geometry.radii
        case "Box":
            return np.sign(ways) * geometry.halfSide
        case "Cylinder":
            rim = ways[:, :2] / np.linalg.norm(ways[:, :2], axis=1)[:, None] * geometry.radius
            return np.c_[rim, np.sign(ways[:, 2]) * geometry.halfLength]
        case _:
            return np.array(geometry.points())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("geometry", "loose"),
    [
        (geometry_of(Sphere(0.2), ""), 0.0),
        (geometry_of(Capsule(0.1, 0.8), ""), 0.0),
        (geometry_of(Box((0.2, 0.5, 0.9)), ""), 0.0),
        (geometry_of(Hull(CORNERS * [0.2, 0.5, 0.9]), ""), 0.0),
        (geometry_of(Cylinder(0.1, 0.8), ""), 0.1),
        (coal.Ellipsoid(0.1, 0.2, 0.4), 0.4),
    ],
    ids=lambda value: type(value).__name__,
)
def test_no_point_of_a_shape_is_farther_than_its_reach(geometry: Any, loose: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    farthest = np.linalg.norm(surface(geometry, rng) @ T.rotation.T + T.translation, axis=1).max()
    reach = reach_of(geometry, T.rotation, T.translation)
    assert farthest - 1e-9 <= reach <= farthest + loose + 2e-3


@pytest.mark.parametrize(
    ("geometry", "half", "radius"),
    [
        (coal.Box(0.2, 0.4, 0.6), (0.1, 0.2, 0.3), 0.0),
        (coal.Sphere(0.2), (0.0, 0.0, 0.0), 0.2),
        (coal.Capsule(0.1, 0.6), (0.0, 0.0, 0.3), 0.1),
        (coal.Cylinder(0.1, 0.6), (0.1, 0.0, 0.3), 0.0),
        (coal.Ellipsoid(0.1, 0.2, 0.3), (0.1, 0.2, 0.3), 0.0),  # its box
        (coal.Cone(0.1, 0.6), (0.1, 0.1, 0.3), 0.0),
    ],
    ids=lambda value: type(value).__name__,
)
def test_the_core_of_a_shape_fills_it_or_its_box(geometry: Any, half: Any, radius: float) -> None:
    core = core_shape(geometry)
    np.testing.assert_allclose(core.half, half, atol=1e-12)
    assert core.radius == pytest.approx(radius)
    np.testing.assert_allclose(core.centre, np.zeros(3), atol=1e-12)
    assert core.corners.shape == (0, 3)


# -- convex parts ------------------------------------------------------------------------------------------------------


class Decomposer(SimpleNamespace):
    """Stands for CoACD; it keeps what it was asked, and gives the parts that it is told to."""

    def __init__(self, parts: list[Array]) -> None:
        super().__init__(asked=[], parts=parts, Mesh=lambda corners, faces: (corners, faces))

    def set_log_level(self, level: str) -> None:
        assert level == "error"

    def run_coacd(self, mesh: Any, *, threshold: float, seed: int) -> list[tuple[Array, None]]:
        if not isinstance(self.parts, list):
            raise RuntimeError("it is open")
        self.asked.append((*mesh, threshold, seed))
        return [(part, None) for part in self.parts]


@pytest.fixture
def decomposer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Decomposer:
    pytest.importorskip("platformdirs")
    made = Decomposer([CORNERS])
    monkeypatch.setitem(sys.modules, "coacd", made)
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda *_, **__: str(tmp_path / "cache"))
    return made


def kept(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache" / "convex").glob("*"))


def test_corners_that_an_stl_repeats_are_one(decomposer: Decomposer) -> None:
    unused = np.array([[9.0, 9.0, 9.0]])
    repeated = np.concatenate([unused, CORNERS[FACES].reshape(-1, 3)])
    convex_parts(repeated, 1.0 + np.arange(36.0).reshape(-1, 3), "")
    ((corners, faces, _, _),) = decomposer.asked
    assert len(corners) == 8
    np.testing.assert_array_equal(corners[faces], CORNERS[FACES])


def test_parts_are_kept_and_are_those_of_one_mesh(decomposer: Decomposer, tmp_path: Path) -> None:
    first = convex_parts(CORNERS, FACES, "")
    again = convex_parts(CORNERS, FACES, "")
    assert len(decomposer.asked) == len(kept(tmp_path)) == 1
    np.testing.assert_array_equal(first.geometries[0].points(), again.geometries[0].points())
    assert first.uncovered == again.uncovered == 0.0
    convex_parts(2.0 * CORNERS, FACES, "")
    convex_parts(CORNERS, FACES[:-1], "")
    assert len(decomposer.asked) == len(kept(tmp_path)) == 3


@pytest.mark.parametrize(
    "parts",
    [[], [CORNERS[:3]], [CORNERS[:, :2]], [CORNERS.ravel()], [np.full((8, 3), np.inf)], [CORNERS, CORNERS[:2]]],
    ids=["none", "few", "flat", "row", "endless", "one bad"],
)
def test_damaged_parts_are_made_anew(parts: list[Array], decomposer: Decomposer, tmp_path: Path) -> None:
    convex_parts(CORNERS, FACES, "")
    (file,) = kept(tmp_path)
    np.savez(file, *parts)
    found = convex_parts(CORNERS, FACES, "")
    assert len(decomposer.asked) == 2
    assert len(found.geometries) == 1
    convex_parts(CORNERS, FACES, "")
    assert len(decomposer.asked) == 2


def test_parts_that_cannot_be_kept_are_parts_all_the_same(decomposer: Decomposer, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file where the folder would be", encoding="utf-8")
    for count in (1, 2):
        assert len(convex_parts(CORNERS, FACES, "").geometries) == 1
        assert len(decomposer.asked) == count


@pytest.mark.parametrize("missed", range(7))
def test_what_the_parts_leave_out_is_measured_at_seven_places_of_a_triangle(
    missed: int, decomposer: Decomposer
) -> None:
    a, b, c = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.2], [0.3, 1.4, 0.0]])
    places = [a, b, c, (a + b + c) / 3.0, (a + b) / 2.0, (b + c) / 2.0, (a + c) / 2.0]
    missing = places.pop(missed)
    half = 0.05
    decomposer.parts = [place + half * (2.0 * CORNERS - 1.0) for place in places]
    found = convex_parts(np.array([a, b, c]), np.array([[0, 1, 2]]), "")
    away = min(np.abs(missing - place).max() - half for place in places)  # from the planes of cubes
    assert found.uncovered == pytest.approx(away)
    assert len(found.geometries) == 6


def test_meshes_without_parts_are_refused(decomposer: Decomposer) -> None:
    decomposer.parts = []
    with pytest.raises(InvalidInputError, match=r"the mesh has no convex parts.*Close it") as caught:
        convex_parts(CORNERS, FACES, "Body 'rock'")
    assert "Body 'rock'" in str(caught.value)
    decomposer.parts = None
    with pytest.raises(InvalidInputError, match=r"the mesh cannot be decomposed \(it is open\)"):
        convex_parts(CORNERS, FACES, "Body 'rock'")


def test_parts_that_miss_their_mesh_are_named(decomposer: Decomposer, tmp_path: Path) -> None:
    two = np.concatenate([CORNERS, CORNERS + np.array([3.0, 0.0, 0.0])])
    file = obj(tmp_path / "two.obj", 0.1 * two, np.concatenate([FACES, FACES + 8]))
    rock = Body("rock", Mesh(file), pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    task = plate_and_post()
    decomposer.parts = [0.1 * two[:8], 0.1 * two[8:]]
    scene = CollisionScene.of(task, obstacles=[rock], decompose=["rock"])
    assert scene.notes == ()
    assert scene.built.names.count("rock") == 2
    assert {pair for pair in scene.pairs if "rock" in pair} == {
        pair for pair in CollisionScene.of(task, obstacles=[rock]).pairs if "rock" in pair
    }
    for file in kept(tmp_path):
        file.unlink()
    decomposer.parts = [0.1 * two[:8], 0.1 * two[8:] - [0.0, 0.0, 0.003]]
    scene = CollisionScene.of(task, obstacles=[rock], decompose=["rock"])
    assert scene.notes == ("the 2 convex parts of rock miss its mesh by 3 mm",)


# -- how deep bodies overlap -----------------------------------------------------------------------------------------


def random_shape(rng: np.random.Generator) -> Any:
    """A convex body of a few decimetres."""
    radius, length = rng.uniform(0.03, 0.1), rng.uniform(0.1, 0.4)
    kind = int(rng.integers(4))
    if kind == 3:
        return hull_of(rng.normal(size=(30, 3)) * rng.uniform(0.03, 0.15), "hull")
    made = (coal.Cylinder(radius, length), coal.Capsule(radius, length), coal.Box(*rng.uniform(0.05, 0.3, 3)))
    return made[kind]


def test_bodies_that_overlap_touch_once_they_are_moved_apart_by_their_depth() -> None:
    rng, overlaps = np.random.default_rng(3), 0
    pin.seed(3)
    for _ in range(3000):
        shapes = [random_shape(rng) for _ in range(2)]
        turns = [pin.SE3.Random().rotation for _ in range(2)]
        first, second = rng.uniform(-0.15, 0.15, (2, 3))
        found = []
        for _ in range(2):
            result = coal.DistanceResult()
            places = [coal.Transform3s(R, p) for R, p in zip(turns, (first, second), strict=True)]
            found.append(coal.distance(shapes[0], places[0], shapes[1], places[1], new_request(), result))
            if found[0] >= 0.0:
                break
            second = second - found[0] * result.normal
        if found[0] < 0.0:
            overlaps += 1
            assert found[0] > -0.6
            assert abs(found[1]) < 1e-5
    assert overlaps > 1000
