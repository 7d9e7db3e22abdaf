"""The bodies, margins and pairs of a cell file are those of the scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from places import CELL_FILES

from coopqp import CollisionScene, load_cell_file
from coopqp.collision.scene import DEFAULT_MARGIN
from coopqp.files import CellFileError
from coopqp.model.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from coopqp.spatial import as_placement

BAR = (CELL_FILES / "bar.toml").read_text(encoding="utf-8").partition("[collision]")[0].partition("[[collision")[0]


@pytest.fixture
def scene(tmp_path: Path) -> Callable[[str], CollisionScene]:
    """The scene of a file whose collision table is given."""

    def of(text: str) -> CollisionScene:
        file = tmp_path / "cell.toml"
        file.write_text(f"{BAR}\n{text}", encoding="utf-8")
        made = load_cell_file(file).scene
        assert made is not None
        return made

    return of


BODIES = """
[collision]
margin_m = 0.02
without = ["left/link_1"]
ignored = [["ball", "rod"]]
inside = [["pill", "ball"]]
decompose = ["lump"]
apart = 3
object_apart = 4
margins = [{ between = ["ball", "pill"], margin_m = 0.07 }, { between = ["rod", "*"], margin_m = 0.0 }]
[[collision.obstacles]]
name = "ball"
shape = "sphere"
radius_m = 0.1
at.xyz_m = [0.0, 3.0, 1.0]
[[collision.obstacles]]
name = "rod"
shape = "cylinder"
radius_m = 0.2
length_m = 0.5
at = { xyz_m = [0.0, -3.0, 0.0], rpy_deg = [90, 0, 0] }
[[collision.obstacles]]
name = "block"
shape = "box"
size_m = [0.1, 0.2, 0.3]
at.xyz_m = [3.0, 3.0, 0.0]
[[collision.obstacles]]
name = "lump"
shape = "mesh"
file = "lump.stl"
scale = 2.0
at.xyz_m = [-3.0, 3.0, 0.0]
[[collision.carried]]
name = "pill"
shape = "capsule"
radius_m = 0.01
length_m = 0.1
[[collision.on_links]]
name = "camera"
shape = "sphere"
radius_m = 0.03
link = "left/link_3"
at.xyz_m = [0.0, 0.0, 0.2]
[[collision.on_links]]
name = "lamp"
shape = "sphere"
radius_m = 0.02
link = "left/link_3"
at.xyz_m = [0.0, 0.1, 0.2]
"""
TETRAHEDRON = (
    "solid t\n"
    + "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {p}\n" for p in face) + "endloop\nendfacet\n"
        for face in (
            ("0 0 0", "0 1 0", "1 0 0"),
            ("0 0 0", "1 0 0", "0 0 1"),
            ("0 0 0", "0 0 1", "0 1 0"),
            ("1 0 0", "0 1 0", "0 0 1"),
        )
    )
    + "endsolid t\n"
)


def test_the_scene_has_the_bodies_and_pairs_of_the_file(scene: Callable[[str], CollisionScene], tmp_path: Path) -> None:
    (tmp_path / "lump.stl").write_text(TETRAHEDRON)
    made = scene(BODIES)
    ball, rod, block, lump = made.obstacles
    assert [body.name for body in made.obstacles] == ["ball", "rod", "block", "lump"]
    assert ball.shape == Sphere(0.1)
    assert rod.shape == Cylinder(0.2, 0.5)
    assert isinstance(block.shape, Box)
    assert block.shape.size == (0.1, 0.2, 0.3)
    assert isinstance(lump.shape, Mesh)
    assert (Path(lump.shape.file), lump.shape.scale) == (tmp_path / "lump.stl", (2.0, 2.0, 2.0))
    np.testing.assert_array_equal(as_placement(ball.placement, "").translation, [0.0, 3.0, 1.0])
    np.testing.assert_array_equal(as_placement(rod.placement, "").rotation, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    (pill,) = made.carried
    assert (pill.name, pill.shape) == ("pill", Capsule(0.01, 0.1))
    assert {link: [body.name for body in bodies] for link, bodies in made.on_links.items()} == {
        "left/link_3": ["camera", "lamp"]
    }
    assert made.margin == 0.02
    assert dict(made.margins) == {("ball", "pill"): 0.07, ("rod", "*"): 0.0}
    assert [tuple(pair) for pair in made.ignored] == [("ball", "rod")]
    assert [tuple(pair) for pair in made.inside] == [("pill", "ball")]
    assert (tuple(made.without), tuple(made.decompose)) == (("left/link_1",), ("lump",))
    assert (made.rules.apart, made.rules.object_apart) == (3, 4)


def test_without_other_bodies_the_object_is_its_box_and_keeps_the_default(
    scene: Callable[[str], CollisionScene],
) -> None:
    made = scene("[collision]\n")
    (box,) = made.carried
    assert isinstance(box.shape, Box)
    assert (box.name, box.shape.size) == ("object", (0.60, 0.05, 0.05))
    assert (made.margin, dict(made.margins), made.obstacles) == (DEFAULT_MARGIN, {}, ())


BALL = '[[collision.obstacles]]\nname = "b"\nshape = "sphere"\nradius_m = 0.1\nat.xyz_m = [0, 3, 0]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BALL.replace("radius_m", "size_m"), "collision.obstacles[0].size_m: give a list, not 0.1"),
        (BALL.replace("radius_m = 0.1", ""), "collision.obstacles[0]: a sphere takes radius_m"),
        (BALL.replace("sphere", "cylinder"), "collision.obstacles[0]: a cylinder takes length_m and radius_m"),
        (BALL.replace("sphere", "box"), "a box takes size_m"),
        (BALL.replace("sphere", "mesh"), "a mesh takes file"),
        (BALL.replace("sphere", "spere"), "there is no 'spere'; did you mean 'sphere'?"),
        (BALL + "scale = 0\n", "scale"),
        (f'[collision]\nignored = [["b"]]\n{BALL}', "collision.ignored[0]: give at least 2 entries, not 1"),
        (f'[collision]\ninside = [["b", "c", "d"]]\n{BALL}', "collision.inside[0]: give at most 2 entries, not 3"),
        (f"[collision]\nmargin_m = -0.1\n{BALL}", "collision.margin_m: must be greater than or equal to 0, not -0.1"),
        (f"[collision]\nmargin_m = 10.5\n{BALL}", "collision.margin_m: must be less than or equal to 10, not 10.5"),
        (f"[collision]\napart = 0\n{BALL}", "collision.apart: must be greater than or equal to 1, not 0"),
        (f'[collision]\nmargins = [{{ between = ["b", "x"], margin_m = 0 }}]\n{BALL}', "'x'"),
        (f'[controller]\nkind = "independent"\n{BALL}', "collision.avoid: only the controller qp avoids"),
        (f'[collision]\nsrdf.lef = "a.srdf"\n{BALL}', "lef"),
        (f'[collision]\nsrdf.left = "$NOWHERE_AT_ALL/a.srdf"\n{BALL}', "collision.srdf.left: the environment variable"),
    ],
)
def test_a_wrong_body_or_pair_is_named(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    base = BAR.partition("[controller]")[0] if "[controller]" in text else BAR
    file.write_text(f"{base}\n{text}", encoding="utf-8")
    with pytest.raises(CellFileError) as caught:
        load_cell_file(file)
    assert message in str(caught.value)


def test_another_controller_may_be_judged_beside_bodies(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    base = BAR.partition("[controller]")[0]
    text = f'{base}[controller]\nkind = "independent"\n[collision]\navoid = false\n{BALL}'
    file.write_text(text, encoding="utf-8")
    run = load_cell_file(file)
    assert not run.avoids
    assert run.scene is not None
    assert [body.name for body in run.scene.obstacles] == ["b"]
