"""A collision scene in arrays: its shapes, its pairs, and how fast each joint can change their distances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.shapes import Body
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """A scene in arrays. P pairs of shapes.

    Attributes:
        cell: the arms.
        geometry: all shapes with their pairs, for the cell's model.
        names: name of each shape's body.
        labels: names of each pair's bodies.
        kinds: sign of each joint for each pair (P, nv): +1 where it moves the second body alone, −1 where it moves the
            first one alone, 0 where it moves both, or neither.
        reach: largest motion of a pair's distance per unit of joint motion (P, nv) [m/rad or 1].
        margins: margin of each pair (P,) [m].
        inside: pairs that may start inside their margin (P,).
        levers: largest distance of the object's points from its origin, for pairs of the object with a body that stands
            in the world (P,) [m]; infinite for others.
        moving_bodies: bodies whose place is told in motion.
        moving: number of the shape of each of them.
        notes: remarks on bodies by their names: hulls that are much larger than their meshes, and what convex parts
            leave out.
    """

    cell: RobotCell
    geometry: pin.GeometryModel
    names: tuple[str, ...]
    labels: tuple[tuple[str, str], ...]
    kinds: Array
    reach: Array
    margins: Array
    inside: Any
    levers: Array
    moving_bodies: tuple[Body, ...]
    moving: tuple[int, ...]
    notes: Mapping[str, str]

    @cached_property
    def second(self) -> Any:
        """Number of the second shape of each pair (P,)."""
        return np.array([int(pair.second) for pair in self.geometry.collisionPairs], dtype=int)

    @cached_property
    def moves(self) -> Any:
        """True for pairs with a moving body (P,)."""
        return np.isin(self.second, self.moving)
