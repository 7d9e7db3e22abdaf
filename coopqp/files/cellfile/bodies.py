"""The table ``collision`` of a cell file: bodies, margins, pairs, and the scene that they make."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import pinocchio as pin
from annotated_types import Ge, Le, Len
from pydantic import Field, model_validator

from coopqp.collision.pairs import PairRules
from coopqp.collision.scene import DEFAULT_MARGIN, CollisionScene
from coopqp.files.cellfile.basic import MAX_ARMS, FilePath, Metres, Name, PlacementTable, Sides
from coopqp.files.cellfile.paths import resolve
from coopqp.files.cellfile.strict import Table, problem
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.shapes import Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere

#: Largest accepted number of bodies, and of pairs in a list.
MAX_BODIES, MAX_PAIRS = 1000, 1000

Margin = Annotated[float, Ge(0.0), Le(10.0)]
Pair = Annotated[list[Name], Len(2, 2)]
Pairs = Annotated[list[Pair], Len(0, MAX_PAIRS)]
Joints = Annotated[int, Ge(1), Le(100)]
_SIZES: dict[str, tuple[str, ...]] = {
    "box": ("size_m",),
    "sphere": ("radius_m",),
    "cylinder": ("radius_m", "length_m"),
    "capsule": ("radius_m", "length_m"),
    "mesh": ("file",),
}


class BodyTable(Table):
    """A body: a shape with a name and a place. Cylinders and capsules lie along their z axis."""

    name: Name = Field(description="how limits and messages call it")
    shape: Literal["box", "sphere", "cylinder", "capsule", "mesh"] = Field(description="its shape")
    size_m: Sides | None = Field(default=None, description="side lengths of a box")
    radius_m: Metres | None = Field(default=None, description="radius of a sphere, cylinder or capsule")
    length_m: Metres | None = Field(
        default=None, description="length of a cylinder; of a capsule between the centres of its ends"
    )
    file: FilePath | None = Field(
        default=None, description="mesh file; its convex hull is taken, or its parts (decompose)"
    )
    scale: Annotated[float, Ge(1e-6), Le(1e6)] = Field(default=1.0, description="factor of a mesh")
    at: PlacementTable = Field(default_factory=PlacementTable, description="placement of the shape")

    @model_validator(mode="after")
    def _fits(self) -> BodyTable:
        given = {key for keys in _SIZES.values() for key in keys if getattr(self, key) is not None}
        needed = set(_SIZES[self.shape])
        if given != needed:
            raise problem(f"a {self.shape} takes {' and '.join(sorted(needed))}")
        return self


class LinkBodyTable(BodyTable):
    """A body on a link, e.g. the capsule of a gripper."""

    link: Name = Field(description="the link, as arm/link; the body is placed in its frame")


class MarginTable(Table):
    """Another margin for a pair."""

    between: Pair = Field(description="two names: bodies, an arm for all its links, or *")
    margin_m: Margin = Field(description="distance that is kept")


class CollisionTable(Table):
    """What the arms and the object keep away from, and how far."""

    avoid: bool = Field(default=True, description="the controller keeps the margins; false: the run is only judged")
    margin_m: Margin = Field(default=DEFAULT_MARGIN, description="distance that is kept")
    obstacles: Annotated[list[BodyTable], Len(0, MAX_BODIES)] = Field(
        default=[], description="bodies that stand in the world"
    )
    carried: Annotated[list[BodyTable], Len(0, MAX_BODIES)] | None = Field(
        default=None, description='bodies of the object, in its frame (default: its box, named "object")'
    )
    on_links: Annotated[list[LinkBodyTable], Len(0, MAX_BODIES)] = Field(default=[], description="bodies on links")
    without: Annotated[list[Name], Len(0, MAX_BODIES)] = Field(
        default=[], description="links whose own shapes are left out"
    )
    margins: Annotated[list[MarginTable], Len(0, MAX_PAIRS)] = Field(default=[], description="margins of pairs")
    ignored: Pairs = Field(default=[], description="pairs that may touch")
    inside: Pairs = Field(default=[], description="pairs that may start inside their margin")
    decompose: Annotated[list[Name], Len(0, MAX_BODIES)] = Field(
        default=[], description="bodies whose meshes count as their convex parts, not as one hull"
    )
    srdf: Annotated[dict[Name, FilePath], Len(0, MAX_ARMS)] = Field(
        default={}, description="SRDF files by arm: pairs that they disable are left out"
    )
    apart: Joints = Field(default=PairRules().apart, description="links of an arm count from so many joints apart")
    object_apart: Joints = Field(
        default=PairRules().object_apart,
        description="the object and links that hold it count from so many joints apart",
    )


def build_scene(
    table: CollisionTable,
    cell: RobotCell,
    grasp: Grasp,
    box: Body,
    folder: Path,
    placement: Callable[[PlacementTable], pin.SE3],
) -> CollisionScene:
    """The scene that a table describes; errors name the body or the key.

    Args:
        table: what the file says.
        cell, grasp: the arms, and how they hold.
        box: the object, if the table names no other bodies that are carried.
        folder: paths in the file are relative to it.
        placement: the placement that a table describes.
    """
    carried = [box] if table.carried is None else [_body(body, folder, placement) for body in table.carried]
    on_links: dict[str, list[Body]] = {}
    for body in table.on_links:
        on_links.setdefault(body.link, []).append(_body(body, folder, placement))
    return CollisionScene(
        cell=cell,
        grasp=grasp,
        carried=carried,
        obstacles=[_body(body, folder, placement) for body in table.obstacles],
        on_links=on_links,
        without=table.without,
        margin=table.margin_m,
        margins={(m.between[0], m.between[1]): m.margin_m for m in table.margins},
        ignored=[(a, b) for a, b in table.ignored],
        inside=[(a, b) for a, b in table.inside],
        decompose=table.decompose,
        srdf={arm: resolve(file, folder, f"collision.srdf.{arm}") for arm, file in table.srdf.items()},
        rules=PairRules(apart=table.apart, object_apart=table.object_apart),
    )


def _body(table: BodyTable, folder: Path, placement: Callable[[PlacementTable], pin.SE3]) -> Body:
    return Body(table.name, _shape(table, folder), placement(table.at))


def _shape(table: BodyTable, folder: Path) -> Shape:
    if table.shape == "box":
        return Box(table.size_m or ())
    if table.shape == "mesh":
        file = resolve(str(table.file), folder, f"collision: body '{table.name}'")
        return Mesh(file, (table.scale,) * 3)
    radius = table.radius_m or 0.0
    if table.shape == "sphere":
        return Sphere(radius)
    kind = Cylinder if table.shape == "cylinder" else Capsule
    return kind(radius, table.length_m or 0.0)
