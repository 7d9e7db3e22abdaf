"""Convex shapes, and bodies: a shape with a name and a place. For what arms carry and what stands around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_floats, as_vector, keep_scalars, read_only, require
from coopqp.core._core import DEEPEST
from coopqp.errors import InvalidInputError, has_controls, shown
from coopqp.model.limits import BindingLimit
from coopqp.model.meshes import MOST_BYTES
from coopqp.reading import open_file
from coopqp.spatial import Array, Placement, as_placement

#: Sizes of shapes [m].
LEAST_SIZE, LARGEST_SIZE = 1e-5, 1e3
#: Largest number of triangles or corners of one mesh.
MOST_TRIANGLES = 100_000


@final
@dataclass(frozen=True, eq=False)
class Box:
    """A box about its centre.

    Attributes:
        size: side lengths [m], (3,).
    """

    size: Sequence[float]

    def __post_init__(self) -> None:
        size = as_vector(self.size, 3, "Box: size")
        for length in size:
            _check_size(float(length), "Box: size")
        object.__setattr__(self, "size", tuple(size.tolist()))


@final
@dataclass(frozen=True)
class Sphere:
    """A sphere about its centre.

    Attributes:
        radius: [m].
    """

    radius: float

    def __post_init__(self) -> None:
        _keep_sizes(self, "radius")


@final
@dataclass(frozen=True)
class Cylinder:
    """A cylinder about the z axis.

    Attributes:
        radius, length: [m].
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _keep_sizes(self, "radius", "length")


@final
@dataclass(frozen=True)
class Capsule:
    """A cylinder about the z axis with half a sphere at both ends.

    Attributes:
        radius: [m].
        length: between the centres of the half spheres [m].
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _keep_sizes(self, "radius", "length")


@final
@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of points.

    Attributes:
        points: (n, 3) [m], four or more that do not lie in one plane.
    """

    points: Array

    def __post_init__(self) -> None:
        try:
            points = as_floats(self.points)
        except NOT_NUMBERS as error:
            raise InvalidInputError("points that are no numbers", "Hull: points", "Give an array (n, 3).") from error
        if points.ndim != 2 or points.shape[1] != 3 or not 4 <= len(points) <= MOST_TRIANGLES:
            raise InvalidInputError(
                f"shape {points.shape}", "Hull: points", f"Give an array (n, 3) of 4 to {MOST_TRIANGLES} points."
            )
        if not np.isfinite(points).all() or np.abs(points).max() > LARGEST_SIZE:
            raise InvalidInputError(
                "points that are not finite, or too far away", "Hull: points", "Give finite numbers in metres."
            )
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if not spread[2] > 1e-6 * max(spread[0], LEAST_SIZE):
            raise InvalidInputError("all points lie in one plane", "Hull: points", "Give points of a body.")
        object.__setattr__(self, "points", read_only(points))


@final
@dataclass(frozen=True, eq=False)
class Mesh:
    """The convex hull of a mesh file (STL, DAE, OBJ).

    Attributes:
        file: its path.
        scale: factors of its axes (3,); where they are 1 the file is in metres, or in the unit that a DAE tells.
    """

    file: str | Path
    scale: Sequence[float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        scale = as_vector(self.scale, 3, "Mesh: scale")
        if not (np.abs(scale) > 0.0).all():
            raise InvalidInputError("a scale of 0", "Mesh: scale", "Give factors other than 0.")
        try:
            file = Path(self.file)
            open_file(file, MOST_BYTES).close()
        except TypeError as error:
            raise InvalidInputError(f"{shown(self.file)} is no path", "Mesh: file", "Give the file's name.") from error
        except FileNotFoundError as error:
            raise InvalidInputError(
                f"there is no file {error.filename}", "Mesh: file", f"Paths are relative to {Path.cwd()}."
            ) from error
        except OSError as error:
            raise InvalidInputError(
                f"cannot read {error.filename}: {error.strerror}", "Mesh: file", "Give the path of a mesh."
            ) from error
        object.__setattr__(self, "file", file)
        object.__setattr__(self, "scale", tuple(scale.tolist()))


Shape: TypeAlias = Box | Sphere | Cylinder | Capsule | Hull | Mesh


@final
@dataclass(frozen=True, eq=False)
class Body:
    """A shape with a name and a place.

    Attributes:
        name: how limits and messages call it; several bodies of one name count as one.
        shape: its geometry.
        placement: of the shape, in the frame of its carrier: the world, the object, a link.
    """

    name: str
    shape: Shape
    placement: Placement = field(default_factory=lambda: pin.SE3.Identity())

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name or has_controls(self.name):
            raise InvalidInputError(f"its name is {shown(self.name)}", "Body: name", "Give plain text, not empty.")
        require(self.shape, (Box, Sphere, Cylinder, Capsule, Hull, Mesh), f"Body '{self.name}': shape", "Give a shape.")
        object.__setattr__(self, "placement", as_placement(self.placement, f"Body '{self.name}': placement"))


@final
@dataclass(frozen=True)
class NearPair:
    """Two bodies and how near they are.

    Attributes:
        first, second: their names.
        distance: between their surfaces; negative where they overlap [m].
    """

    first: str
    second: str
    distance: float

    def __str__(self) -> str:
        apart = f"{1e3 * self.distance:.1f} mm" if self.distance > DEEPEST else "overlap"
        return f"{self.first} and {self.second}: {apart}"


def by_depth(distance: float, form: str = ".1f") -> str:
    """How deep bodies overlap, in words: " by 3.4 mm" of the distance −0.0034 m, "" where no depth was found."""
    return f" by {-1e3 * distance:{form}} mm" if distance > DEEPEST else ""


def too_close(inside: tuple[BindingLimit, ...]) -> str:
    """A sentence: the two bodies that are deepest inside their margin; empty without any."""
    if not inside:
        return ""
    others = len(inside) - 1
    more = f", and {others} other pair{'s' * (others > 1)}" if others else ""
    names, distance = " and ".join(inside[0].between), inside[0].distance or 0.0
    if distance < 0.0:
        return f"{names} overlap{by_depth(distance)}{more}"
    return f"{names} are {1e3 * distance:.1f} mm from each other, inside their margin{more}"


def _keep_sizes(shape: Any, *names: str) -> None:
    keep_scalars(shape, *names)
    for name in names:
        _check_size(getattr(shape, name), f"{type(shape).__name__}: {name}")


def _check_size(size: float, where: str) -> None:
    if not LEAST_SIZE <= size <= LARGEST_SIZE:
        raise InvalidInputError(f"{size:g} m", where, f"Give metres, {LEAST_SIZE:g} to {LARGEST_SIZE:g}.")
